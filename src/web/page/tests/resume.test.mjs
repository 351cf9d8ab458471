// The rest of an interrupted job, compared with the `oxmill` program of this host.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { open, openJob, tab } from "./browser.mjs";
import { example, page as file, resumed } from "./program.mjs";

export async function the_rest_of_a_job_is_that_of_the_program(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await tab(page, "continue");
  const written = async more => {
    for (const [id, value] of Object.entries(more)) await page.fill(`#${id}`, value);
    const [download] = await Promise.all([page.waitForEvent("download"), page.click("#write-rest")]);
    return [download.suggestedFilename(), readFileSync(await download.path(), "utf8")];
  };
  const [name, text] = await written({ "from-line": "200" });
  assert.equal(name, "pocket_mm-from-200.nc");
  assert.equal(text, resumed("pocket_mm.nc", example("pocket_mm.nc"), ["--line", "200"]));
  assert.match(await page.textContent("#continue-note"), /^First the lines shown above, then line 200 to line 465\.$/);
  assert.match(await page.textContent("#prologue"), /^G21 G90 G94 G17 G54\nM5 M9\n/);
  const [, other] = await written({ "from-line": "300", clearance: "12.5", plunge: "60", "spin-up": "2" });
  assert.equal(other, resumed("pocket_mm.nc", example("pocket_mm.nc"), ["--line", "300", "--clearance", "12.5", "--plunge", "60", "--spin-up", "2"]));
  // The button takes the line that is selected in the picture.
  await page.evaluate(() => oxmill.app.player.goToLine(150));
  await page.click("#this-line");
  assert.equal(await page.inputValue("#from-line"), "150");
  // The reason why the job cannot be resumed is shown.
  await page.fill("#from-line", "466");
  await page.click("#write-rest");
  await page.waitForFunction(() => document.getElementById("continue-note").textContent.includes("there is no line 466"));
  assert(await page.locator("#prologue").isHidden());
  // After another job is opened, no result of the previous job remains.
  await openJob(page, "other.nc", "G21 G91\nX1\nX2\n");
  assert.equal(await page.textContent("#continue-note"), "");
  await page.fill("#from-line", "3");
  await page.click("#write-rest");
  await page.waitForFunction(() => document.getElementById("continue-note").textContent.includes("X at this line depends"));
  assert.deepEqual(faults, []);
}
