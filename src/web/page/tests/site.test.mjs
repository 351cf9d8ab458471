// Tests the page from a web server: as a single file, as a site that can be installed, and in Firefox if that exists.
import assert from "node:assert/strict";
import { existsSync, readdirSync, readFileSync } from "node:fs";
import { createServer } from "node:http";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import puppeteer from "puppeteer-core";
import { checked, open, openJob, PATIENCE, ready, tab } from "./browser.mjs";
import { until, walk } from "./walk.mjs";
import { BOARDS, example, examples, MILL, page as file, root, run, same } from "./program.mjs";

const FIREFOX = [process.env.OXMILL_FIREFOX, "/usr/bin/firefox-esr", "/usr/bin/firefox"].find(path => path && existsSync(path));

/** A plain web server: it serves the page, and records all requests for anything else. */
async function site() {
  const others = [];
  const server = createServer((request, response) => {
    const known = request.url === "/oxmill.html";
    if (!known) others.push(request.url);
    response.writeHead(known ? 200 : 404, { "content-type": "text/html; charset=utf-8" });
    response.end(known ? readFileSync(file) : "");
  });
  await new Promise(listening => server.listen(0, "127.0.0.1", listening));
  return { url: `http://127.0.0.1:${server.address().port}/oxmill.html`, others, stop: () => server.close() };
}

export async function the_page_is_the_same_as_a_site(browser) {
  const { url, others, stop } = await site();
  try {
    const { page, faults } = await open(browser, url);
    // Once loaded, the page does not need the server any more.
    stop();
    const text = example("pocket_mm.nc");
    same(await openJob(page, "pocket_mm.nc", text), run("pocket_mm.nc", text), "from a web server");
    await tab(page, "run");
    assert(await page.locator("#served").isHidden(), "no machine is behind this server");
    await page.click("#power");
    await page.waitForFunction(() => /^Idle/.test(oxmill.app.machine.status?.state ?? ""), null, { timeout: PATIENCE });
    const connected = await page.evaluate(url => fetch(url).then(() => true, () => false), url);
    assert.equal(connected, false, "the policy holds");
    assert.deepEqual(faults.filter(fault => !/Content Security Policy/.test(fault)), []);
    assert.deepEqual(others, []);
  } finally {
    stop();
  }
}

/** Serves the folder of the site. `change` replaces the site by another version of it. */
async function folder() {
  const at = join(root, "target/web/site");
  const types = { html: "text/html; charset=utf-8", js: "text/javascript", svg: "image/svg+xml", webmanifest: "application/manifest+json" };
  const files = Object.fromEntries(readdirSync(at).map(name => [`/${name}`, readFileSync(join(at, name), "utf8")]));
  const server = createServer((request, response) => {
    const name = request.url === "/" ? "/index.html" : request.url;
    response.writeHead(name in files ? 200 : 404, { "content-type": types[name.split(".").pop()] ?? "text/plain" });
    response.end(files[name] ?? "");
  });
  await new Promise(listening => server.listen(0, "127.0.0.1", listening));
  const stop = () => {
    server.close();
    server.closeAllConnections();
  };
  const change = () => {
    files["/index.html"] = files["/index.html"].replace("<title>", "<title>Another version of ");
    files["/offline.js"] = files["/offline.js"].replace(/[0-9a-f]{16}/, "0123456789abcdef");
  };
  return { url: `http://127.0.0.1:${server.address().port}/`, stop, change };
}

/** As an installed app, the site opens offline, updates to the next version, and opens G-code files. */
export async function the_site_can_be_installed_and_opens_without_a_network(browser) {
  const { url, stop, change } = await folder();
  try {
    const prepare = page => page.addInitScript(() => Object.defineProperty(globalThis, "launchQueue", { value: { setConsumer: call => (globalThis.launch = call) } }));
    const { page, faults } = await open(browser, url, { prepare });
    const devtools = await page.context().newCDPSession(page);
    const { errors, data } = await devtools.send("Page.getAppManifest");
    assert.deepEqual([errors, JSON.parse(data).name], [[], "Oxmill"]);
    const { installabilityErrors } = await devtools.send("Page.getInstallabilityErrors");
    // The tests use a context without storage, which counts as incognito.
    assert.deepEqual(installabilityErrors.map(({ errorId }) => errorId).filter(id => id !== "in-incognito"), []);
    const kept = () => page.evaluate(async () => [(await caches.keys()).length, Boolean(navigator.serviceWorker.controller)]);
    await page.waitForFunction(() => navigator.serviceWorker.controller?.state === "activated", null, { timeout: PATIENCE });
    assert.deepEqual(await kept(), [1, true]);
    // A later visit finds another version.
    change();
    const first = await page.evaluate(() => caches.keys());
    await page.evaluate(async () => (await navigator.serviceWorker.getRegistration()).update());
    await page.waitForFunction(async first => {
      const names = await caches.keys();
      return names.length === 1 && names[0] !== first;
    }, first[0], { timeout: PATIENCE });
    await page.waitForFunction(() => navigator.serviceWorker.controller?.state === "activated", null, { timeout: PATIENCE });
    const end = Date.now() + PATIENCE;
    for (let title = ""; !title.startsWith("Another version"); title = await page.title()) {
      assert(Date.now() < end, title);
      await page.reload();
      await ready(page, true);
    }
    stop();
    await page.reload();
    await ready(page);
    assert.match(await page.title(), /^Another version/);
    const text = example("pocket_mm.nc");
    await page.evaluate(text => {
      oxmill.app.checked = undefined;
      launch({ files: [{ getFile: async () => new File([text], "launched.nc") }] });
    }, text);
    same(await checked(page, "launched.nc"), run("launched.nc", text), "without a network");
    assert.deepEqual(faults, []);
  } finally {
    stop();
  }
}

/** Starts Firefox (the build of Debian or of Mozilla) through WebDriver BiDi. If no Firefox is installed, prints a
 * message and returns `undefined`. The caller then skips its test. */
async function firefox() {
  if (FIREFOX) return puppeteer.launch({ browser: "firefox", executablePath: FIREFOX, protocolTimeout: PATIENCE, defaultViewport: null, args: ["--width=1440", "--height=1000"] });
  console.log("skipped: no Firefox is installed (Debian: firefox-esr)");
}

/** Opens a page in Firefox; records faults. */
async function opened(browser, place) {
  const page = await browser.newPage();
  const faults = [];
  page.on("pageerror", error => faults.push(`error: ${error.message}`));
  page.on("console", message => ["error", "warn"].includes(message.type()) && faults.push(`console: ${message.text()}`));
  await page.goto(place);
  await until(page, () => Boolean(globalThis.oxmill?.app));
  return { page, faults };
}

export async function firefox_says_the_same() {
  const browser = await firefox();
  if (!browser) return;
  const { url, others, stop } = await site();
  try {
    for (const place of [pathToFileURL(file).href, url]) {
      const { page, faults } = await opened(browser, place);
      for (const name of place === url ? ["pocket_mm.nc"] : examples()) {
        for (const board of BOARDS) {
          const order = { board, settings: MILL };
          const found = await page.evaluate((text, order) => oxmill.check(text, order), example(name), order);
          same(found, run(name, example(name), order), `${name} on ${board}`);
        }
      }
      await tab(page, "run");
      await page.click("#power");
      await until(page, () => /^Idle/.test(oxmill.app.machine.status?.state ?? ""));
      assert.deepEqual(faults, []);
      await page.close();
    }
    assert.deepEqual(others, []);
  } finally {
    await browser.close();
    stop();
  }
}

/** Repeats `a_newcomer_comes_from_a_job_to_its_end` in Firefox. */
export async function firefox_goes_from_a_job_to_its_end() {
  const browser = await firefox();
  if (!browser) return;
  try {
    const { page, faults } = await opened(browser, pathToFileURL(file).href);
    await walk(page);
    assert.deepEqual(faults, []);
  } finally {
    await browser.close();
  }
}
