// The screenshots of the README, taken in headless Chromium.
import { writeFileSync } from "node:fs";
import { launch, open, openJob } from "./browser.mjs";
import { example, MILL, page as file } from "./program.mjs";

const FOLDER = new URL("../../../../docs/pictures/", import.meta.url);

async function take(page, name) {
  await page.waitForTimeout(500);
  writeFileSync(new URL(name, FOLDER), await page.screenshot());
  console.log(`docs/pictures/${name}`);
}

async function forecast(browser) {
  const { page } = await open(browser, file, { viewport: { width: 1440, height: 810 } });
  await page.evaluate(values => oxmill.app.settings.replace(values), MILL);
  await openJob(page, "relief.nc", example("relief.nc"));
  await page.click("#tab-whatif");
  await page.click("#vary");
  await page.waitForFunction(() => document.getElementById("whatif-note").textContent.includes("whole jobs"));
  await page.evaluate(() => {
    const scrub = document.getElementById("scrub");
    scrub.value = Number(scrub.max) * 0.62;
    scrub.dispatchEvent(new Event("input", { bubbles: true }));
  });
  await take(page, "page.png");
}

async function machine(browser) {
  const { page } = await open(browser, file, { viewport: { width: 1366, height: 768 }, colorScheme: "dark" });
  await page.evaluate(values => oxmill.app.settings.replace(values), MILL);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await page.click("#tab-machine");
  await page.click("#power");
  await page.waitForFunction(() => oxmill.app.machine.status?.state === "Idle");
  await page.click("#start");
  await page.waitForFunction(() => (oxmill.app.machine.status?.machine[2] ?? 0) < -0.1, null, { timeout: 120_000 });
  await page.waitForTimeout(4000);
  await take(page, "machine.png");
}

const browser = await launch();
await forecast(browser);
await machine(browser);
await browser.close();
