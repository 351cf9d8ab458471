// How the page is used: by keys alone, on a telephone, without WebGL, without a serial port, by a screen reader.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { launch, open, openJob } from "./browser.mjs";
import { example, page as file } from "./program.mjs";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

export async function a_screen_reader_finds_nothing_serious(browser) {
  for (const colorScheme of ["light", "dark"]) {
    const { page } = await open(browser, file, { colorScheme });
    await openJob(page, "bad.nc", "G21\nG999\nG1 X1 F100\n");
    await page.evaluate(axe);
    for (const tab of ["settings", "whatif", "link", "material", "machine"]) {
      await page.click(`#tab-${tab}`);
      if (tab === "machine") await page.click("#power");
      const { violations } = await page.evaluate(() => axe.run());
      const grave = violations.filter(found => ["serious", "critical"].includes(found.impact));
      assert.deepEqual(grave.map(found => `${tab}: ${found.id}: ${found.nodes[0].html}`), [], colorScheme);
    }
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
