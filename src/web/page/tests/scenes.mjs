// The screenshots of the README: how the page gets to each scene, and which parts of it are the same on every computer.
import { createHash } from "node:crypto";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { open, openJob, tab } from "./browser.mjs";
import { example, MILL, page as file, root } from "./program.mjs";

export const FOLDER = join(root, "docs/pictures");
/** This file records the checksum and the page's text of each picture, and a checksum of the sources of the look. */
export const TAKEN = join(FOLDER, "taken.json");
/** Sources that determine the look. The texts of the page are compared separately. */
const LOOK = ["index.html", "style.css", "camera.ts", "chart.ts", "overlay.ts", "picture.ts", "shaders.ts"];
/** Elements that differ from run to run. */
const RESTLESS = ".dro, #console, #pill { visibility: hidden }";

/** The scenes. `set` prepares the page; `go` does what remains to be done until the picture is taken. */
export const SCENES = {
  "page.png": {
    options: { viewport: { width: 1440, height: 900 } },
    async set(page) {
      await page.evaluate(values => oxmill.app.settings.replace(values), MILL);
      await openJob(page, "relief.nc", example("relief.nc"));
      await tab(page, "whatif");
      await page.click("#vary");
      await page.waitForFunction(() => document.getElementById("whatif-note").textContent.includes("whole jobs"));
      await page.evaluate(() => oxmill.app.player.seek(oxmill.app.player.time * 0.62));
      // The legend names the mark for the time only after the picture has been drawn.
      await page.waitForFunction(() => document.getElementById("legend-marks").textContent.includes("time"));
    },
    async go() {},
  },
  "machine.png": {
    options: { viewport: { width: 1440, height: 900 }, colorScheme: "dark" },
    async set(page) {
      await page.evaluate(values => oxmill.app.settings.replace(values), MILL);
      await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
      await tab(page, "run");
      await page.click("#power");
      await page.waitForFunction(() => document.querySelector("#start-why button"));
      await page.click("#start-why button");
      await page.waitForFunction(() => document.querySelector(".checks")?.textContent.includes("travel is not watched") && !document.getElementById("start").disabled);
    },
    async go(page) {
      await page.click("#start");
      const times = value => page.evaluate(value => {
        const select = document.getElementById("times");
        select.value = value;
        select.dispatchEvent(new Event("change"));
      }, value);
      await times("20");
      await page.waitForFunction(() => oxmill.app.machine.running.follower.time > 0.4 * oxmill.app.machine.running.follower.end, null, { timeout: 120_000 });
      await times("1");
    },
  },
};

/** Opens and prepares the page of a scene; returns the page and its text. */
export async function ready(browser, { options, set }) {
  const { page } = await open(browser, file, options);
  await set(page);
  const says = await page.evaluate(restless => {
    const style = document.createElement("style");
    style.textContent = restless;
    document.head.append(style);
    const text = document.body.innerText;
    style.remove();
    return text;
  }, RESTLESS);
  // The duration of the check depends on this computer.
  const lines = says.replace(/(Checked in\s+)[\d.]+ s/g, "$1").split("\n").map(line => line.trim());
  return { page, says: lines.filter(Boolean) };
}

export const sha256 = bytes => createHash("sha256").update(bytes).digest("hex");
export const look = () => sha256(LOOK.map(name => readFileSync(join(root, "src/web/page/src", name), "utf8")).join("\0"));
