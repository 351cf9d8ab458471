// How the page is used: by keys alone, on a telephone, without WebGL, without a serial port, by a screen reader.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { checked, launch, open, openJob } from "./browser.mjs";
import { example, page as file } from "./program.mjs";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** Something in each panel that a job, a run or a fault can put there. */
const FILLED = {
  settings: async page => {
    await page.click("#settings summary");
    await page.fill('[aria-label^="$0 "]', "256");
    await page.keyboard.press("Tab");
    await page.waitForFunction(() => document.getElementById("refused").textContent !== "");
    assert(await page.locator("#settings-table tr.changed").count() > 0);
    await page.evaluate(() => (oxmill.app.checked = undefined));
    await page.click("#defaults");
    await checked(page);
  },
  whatif: async page => {
    await page.click("#vary");
    await page.waitForFunction(() => document.getElementById("whatif-note").textContent.includes("whole jobs"));
  },
  link: async page => {
    await page.click("#starve");
    await page.waitForFunction(() => document.getElementById("link-note").textContent !== "");
  },
  material: async page => {
    await page.click("#cut");
    await page.waitForFunction(() => document.querySelectorAll("#crashes button").length === 1);
    await page.selectOption("#shape", "v");
  },
  machine: async page => {
    await page.click("#power");
    await page.waitForFunction(() => /^Idle/.test(oxmill.app.machine.status?.state ?? ""));
    await page.evaluate(() => oxmill.app.machine.line("G999"));
  },
};

export async function a_screen_reader_finds_nothing_serious(browser) {
  for (const [colorScheme, width] of [["light", 1440], ["dark", 1440], ["light", 390], ["dark", 390]]) {
    const { page } = await open(browser, file, { colorScheme, viewport: { width, height: 900 } });
    await page.evaluate(axe);
    const audit = async where => {
      const { violations } = await page.evaluate(() => axe.run());
      const grave = violations.filter(found => ["serious", "critical"].includes(found.impact));
      assert.deepEqual(grave.map(found => `${where}: ${found.id}: ${found.nodes[0].html}`), [], `${colorScheme}, ${width} px`);
    };
    // Two tools, a refused line, an alarm, a message, and a rapid through material.
    await openJob(page, "bad.nc", "G21 G90 F600\n(MSG,hello)\nM3 S1000\nG4 P1\nT1 M6\nG0 Z2\nG1 Z-2\nG1 X20\nG999\nT2 M6\nG0 Y10\nG38.2 Z-9\n");
    for (const part of ["#errors strong", "#by-tool td", "#messages li"]) assert(await page.locator(part).count() > 0, part);
    for (const coloring of ["kind", "tool"]) await page.selectOption("#coloring", coloring);
    for (const [tab, fill] of Object.entries(FILLED)) {
      await page.click(`#tab-${tab}`);
      await audit(`${tab}, empty`);
      await fill(page);
      await audit(tab);
    }
    await page.context().close();
  }
}

export async function keys_are_enough(browser) {
  const { page, faults } = await open(browser, file);
  const reach = async id => {
    for (let i = 0; i < 400; i++) {
      if (await page.evaluate(id => document.activeElement?.id === id, id)) return;
      await page.keyboard.press("Tab");
    }
    assert.fail(`#${id} is not reached`);
  };
  await reach("example");
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.keyboard.press("ArrowDown");
  await page.waitForFunction(() => oxmill.app.checked && oxmill.app.job.name === "house.nc");
  await reach("view");
  const turn = () => page.evaluate(() => oxmill.app.player.picture.camera.turn);
  const before = await turn();
  await page.keyboard.press("ArrowRight");
  assert(await turn() > before);
  await reach("scrub");
  await page.keyboard.press("Home");
  assert.equal(await page.evaluate(() => oxmill.app.player.time), 0);
  await reach("lines");
  await page.keyboard.press("ArrowDown");
  await page.keyboard.press("ArrowDown");
  assert((await page.evaluate(() => oxmill.app.player.line)) > 1);
  await reach("tab-settings");
  await page.keyboard.press("ArrowRight");
  assert(await page.locator("#whatif").isVisible());
  assert.deepEqual(faults, []);
}

export async function a_telephone_shows_all_of_it(browser) {
  const { page, faults } = await open(browser, file, { viewport: { width: 390, height: 844 } });
  for (const tab of ["settings", "whatif", "link", "material", "machine"]) {
    await page.click(`#tab-${tab}`);
    if (tab === "machine") await page.click("#power");
    assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 390, tab);
    const panel = await page.locator("[role=tabpanel]:visible").evaluate(panel => [panel.scrollWidth, panel.clientWidth]);
    assert(panel[0] <= panel[1], `${tab}: ${panel}`);
  }
  assert.deepEqual(faults, []);
}

export async function check_and_forecast_do_without_webgl() {
  const browser = await launch(["--disable-3d-apis"]);
  try {
    const { page, faults } = await open(browser, file);
    assert(await page.locator("#nopicture").isVisible());
    const found = await openJob(page, "house.nc", example("house.nc"));
    assert(found.complete);
    await page.evaluate(() => oxmill.app.player.goToLine(5));
    assert.equal(await page.evaluate(() => oxmill.app.player.line), 5);
    assert.deepEqual(faults.filter(fault => !/WebGL/i.test(fault)), []);
  } finally {
    await browser.close();
  }
}

export async function a_browser_without_serial_ports_says_so(browser) {
  const prepare = page => page.addInitScript(() => Object.defineProperty(navigator, "serial", { configurable: true, get: () => undefined }));
  const { page, faults } = await open(browser, file, { prepare });
  await page.click("#tab-machine");
  assert(await page.locator("#noserial").isVisible());
  assert(await page.locator("#connect").isDisabled());
  assert(await page.locator("#power").isEnabled());
  assert.deepEqual(faults, []);
}

export async function the_same_file_again_is_checked_again(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "a.nc", "G21\nG0 X1\n");
  const found = await openJob(page, "a.nc", "G21\nG0 X2\n");
  assert.equal(found.position_mm[0], 2);
  // A browser tells of a file only if another one was chosen before.
  assert.equal(await page.inputValue("#file"), "");
  assert.deepEqual(faults, []);
}

export async function a_job_is_played_at_a_thousand_times_its_speed(browser) {
  const { page, faults } = await open(browser, file);
  const { forecast_s } = await openJob(page, "long.nc", "G21 G91\nG1 X3000 F60\nG1 X-3000\n");
  await page.selectOption("#rate", "1000");
  const began = performance.now();
  await page.click("#play");
  await page.waitForFunction(end => oxmill.app.player.time > 0 && oxmill.app.player.time < end, forecast_s);
  await page.waitForFunction(() => document.getElementById("play").getAttribute("aria-label") === "Play");
  const took = (performance.now() - began) / 1000;
  assert(forecast_s > 5900 && took > 0.9 * forecast_s / 1000 && took < forecast_s / 2, `${forecast_s} s in ${took} s`);
  assert(Math.abs(await page.evaluate(() => oxmill.app.player.time) - forecast_s) < 0.1);
  assert.deepEqual(faults, []);
}

/** Two fingers on the picture, as a touch screen tells of them. */
export async function fingers_turn_and_zoom_the_picture(browser) {
  const { page, faults } = await open(browser, file, { viewport: { width: 390, height: 844 } });
  const fingers = await page.context().newCDPSession(page);
  const touch = (type, ...points) => fingers.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  await page.locator("#view").scrollIntoViewIfNeeded();
  const box = await page.locator("#view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const camera = () => page.evaluate(() => ({ ...oxmill.app.player.picture.camera }));
  const before = await camera();
  await touch("touchStart", [x, y]);
  await touch("touchMove", [x + 60, y]);
  await touch("touchEnd");
  const turned = await camera();
  assert.notEqual(turned.turn, before.turn);
  const size = () => page.evaluate(() => {
    const [a, b] = [[0, 0, 0], [10, 0, 0]].map(place => oxmill.app.player.picture.place(place));
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  });
  const small = await size();
  await touch("touchStart", [x - 20, y], [x + 20, y]);
  for (const far of [30, 45, 60]) await touch("touchMove", [x - far, y], [x + far, y]);
  await touch("touchEnd");
  assert(await size() > 1.5 * small, `${small} and ${await size()}`);
  assert.deepEqual(faults, []);
}

export async function settings_of_a_machine_are_pasted(browser) {
  const { page, faults } = await open(browser, file);
  await page.click("#settings summary");
  await page.fill("#paste", "<Idle|MPos:0,0,0>\n$100=80.000\n$120=123.5\n$99999=1\nok\n");
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.click("#take");
  await checked(page);
  assert.deepEqual(await page.evaluate(() => oxmill.app.settings.values()), { 100: 80, 120: 123.5 });
  assert.equal(await page.inputValue('[aria-label^="$120 "]'), "123.5");
  // A row tells number, name, unit and range.
  await page.fill("#find", "120");
  assert.match(await page.locator("#settings-table tr.changed:visible").first().innerText(), /120\s+X-axis acceleration[^]*mm\/s[^]*new 10/);
  assert.deepEqual(faults, []);
}
