// A page in headless Chromium for the tests: loaded from the disk, with all faults recorded.
import assert from "node:assert/strict";
import { chromium } from "playwright-core";
import { pathToFileURL } from "node:url";

const PROGRAMS = { executablePath: process.env.OXMILL_CHROMIUM ?? "/usr/bin/chromium" };
// Enable WebGL without a graphics processor. Compose the rest of the page without WebGL, which saves a third of the
// time. Switch off network requests of the browser itself.
const ARGUMENTS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--disable-gpu-compositing", "--disable-background-networking",
  "--disable-component-update", "--disable-sync", "--no-first-run", "--disable-quic"];

export async function launch(more = []) {
  return chromium.launch({ ...PROGRAMS, args: [...ARGUMENTS, ...more] });
}

/** Maximum time for a check, ms. It allows for a busy computer. */
export const PATIENCE = Number(process.env.OXMILL_PATIENCE ?? 600_000);

/** Opens the page; `faults` collects everything that must not happen. */
export async function open(browser, file, { viewport = { width: 1440, height: 900 }, colorScheme = "light", reducedMotion = "no-preference", prepare, first = false } = {}) {
  const context = await browser.newContext({ viewport, colorScheme, reducedMotion });
  context.setDefaultTimeout(PATIENCE);
  const page = await context.newPage();
  const faults = [];
  page.on("pageerror", error => faults.push(`error: ${error.message}`));
  page.on("console", message => ["error", "warning"].includes(message.type()) && !/GPU stall|GL Driver/.test(message.text()) && faults.push(`console: ${message.text()}`));
  const own = file.startsWith("http") ? file : "file:";
  page.on("request", request => /^(blob|data):/.test(request.url()) || request.url().startsWith(own) || faults.push(`request: ${request.url()}`));
  await prepare?.(page);
  await page.goto(file.startsWith("http") ? file : pathToFileURL(file).href);
  await ready(page, first);
  return { page, faults, context };
}

/** Waits for the page. Except on a first visit, selects a new board as the machine and closes the start page. */
export async function ready(page, first = false) {
  await page.waitForFunction(() => globalThis.oxmill?.app, null, { timeout: PATIENCE });
  if (first) return;
  await page.evaluate(() => {
    oxmill.app.go("check");
    oxmill.app.settings.choose("new");
    oxmill.app.open("five_circles.nc", new TextEncoder().encode(oxmill.examples["five_circles.nc"]));
  });
  await checked(page);
}

/** Opens a tab of Check, or the workspace Run or Settings. */
export async function tab(page, name) {
  if (["run", "settings"].includes(name)) return page.evaluate(name => oxmill.app.go(name), name);
  await page.evaluate(() => oxmill.app.go("check"));
  await page.click(`#tab-${name}`);
}

/** Waits until the displayed job has been checked; returns its summary. */
export async function checked(page, name = "") {
  // Wait and take the summary in one evaluation, because another check can begin immediately afterwards.
  const found = await page.waitForFunction(name => globalThis.oxmill?.app.checked && oxmill.app.job.name.startsWith(name) && oxmill.app.checked.summary,
    name, { timeout: PATIENCE });
  return found.jsonValue();
}

/** Loads a job into the page. */
export async function openJob(page, name, text) {
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.setInputFiles("#file", { name, mimeType: "text/plain", buffer: Buffer.from(text) });
  return checked(page, name);
}

/** Returns two times in s: `shown` is displayed by the page; `begins` is the start of a line by the rows of the
 * path. */
export const timeOf = (page, line) => page.evaluate(line => {
  const { lines, rows } = oxmill.app.checked.path;
  const row = lines.findIndex((of, row) => row > 0 && of % 2 ** 30 === line);
  return { shown: oxmill.app.player.time, begins: rows[row * 6 + 4] };
}, line);

/** Asserts that the page shows the start time of `line`, and that line `chosen` is selected in the list. `line` must
 * start later than 0 s. */
export async function isAt(page, line, chosen = line) {
  const { shown, begins } = await timeOf(page, line);
  assert(begins > 0 && Math.abs(shown - begins) < 1e-6, `line ${line} begins at ${begins} s; ${shown} s is shown`);
  assert.match(await page.locator("#lines [aria-selected=true]").innerText(), new RegExp(`^\\s*${chosen}\\s`));
}
