// The tests of the page, in headless Chromium, from the disk. Names of tests as arguments; without any, all.
import assert from "node:assert/strict";
import { launch } from "./browser.mjs";
import * as check from "./check.test.mjs";
import * as machine from "./machine.test.mjs";
import * as material from "./material.test.mjs";
import * as module from "./module.test.mjs";
import * as sender from "./sender.test.mjs";
import * as pictures from "./pictures.test.mjs";
import * as site from "./site.test.mjs";
import * as use from "./use.test.mjs";

const wanted = process.argv.slice(2);
const tests = Object.entries({ ...module, ...check, ...machine, ...material, ...pictures, ...sender, ...site, ...use }).filter(([name]) => wanted.length === 0 || wanted.includes(name));
assert(tests.length > 0, "no test of this name");
// Two at a time, each in a browser of its own, whose pages are closed behind each test: tests wait as much as they work.
const waiting = [...tests];
let failed = 0;
async function lane() {
  const browser = await launch();
  for (let next = waiting.shift(); next; next = waiting.shift()) {
    const [name, test] = next;
    const began = performance.now();
    try {
      await test(browser);
      console.log(`ok      ${name} (${((performance.now() - began) / 1000).toFixed(1)} s)`);
    } catch (error) {
      failed++;
      console.log(`FAILED  ${name}\n${error.stack}`);
    }
    for (const context of browser.contexts()) await context.close();
  }
  await browser.close();
}
await Promise.all([lane(), lane()]);
console.log(`${tests.length - failed} of ${tests.length} tests passed`);
process.exit(failed ? 1 : 0);
