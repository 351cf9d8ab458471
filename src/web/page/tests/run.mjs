// Runs the tests of the page in headless Chromium, from the disk. Arguments: names of tests; without any, all.
import assert from "node:assert/strict";
import { launch } from "./browser.mjs";
import * as accept from "./accept.test.mjs";
import * as check from "./check.test.mjs";
import * as firmware from "./firmware.test.mjs";
import * as machine from "./machine.test.mjs";
import * as material from "./material.test.mjs";
import * as module from "./module.test.mjs";
import * as sender from "./sender.test.mjs";
import * as resume from "./resume.test.mjs";
import * as pictures from "./pictures.test.mjs";
import * as site from "./site.test.mjs";
import * as use from "./use.test.mjs";

const wanted = process.argv.slice(2);
const all = { ...accept, ...module, ...check, ...firmware, ...machine, ...material, ...pictures, ...resume, ...sender, ...site, ...use };
for (const name of wanted) assert(name in all, `there is no test ${name}`);
const tests = Object.entries(all).filter(([name]) => wanted.length === 0 || wanted.includes(name));
const browser = await launch();
let failed = 0;
for (const [name, test] of tests) {
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
console.log(`${tests.length - failed} of ${tests.length} tests passed`);
process.exit(failed ? 1 : 0);
