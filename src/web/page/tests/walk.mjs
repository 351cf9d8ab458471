// A newcomer's way through the page, from the choice of a machine to a job that is stopped and continued. It runs in
// Chromium and in Firefox. So it uses only functions that Playwright and Puppeteer share.
import assert from "node:assert/strict";
import { PATIENCE } from "./browser.mjs";

/** Waits until a condition holds. Polls, because Firefox's own waiting needs `eval`, which the page's policy
 * forbids. */
export async function until(page, condition, argument) {
  const end = Date.now() + PATIENCE;
  while (!await page.evaluate(condition, argument)) {
    if (Date.now() > end) assert.fail(`never: ${condition} ${argument ?? ""}; the state is ${await page.evaluate(() => oxmill.app.machine.status?.state)}, the card says ${await page.evaluate(() => document.getElementById("jobcard").innerText)}`);
    await new Promise(resolve => setTimeout(resolve, 100));
  }
}

/** Runs from the first visit on, in a browser without stored data. */
export async function walk(page) {
  const say = id => page.evaluate(id => document.getElementById(id).innerText, id);
  const phase = wanted => until(page, wanted => oxmill.app.machine.phase === wanted, wanted);
  const work = () => page.evaluate(() => oxmill.app.machine.status.work);
  const rest = () => until(page, () => oxmill.app.machine.isAtRest);
  // Find and press the button in one evaluation: its card can be rebuilt between two.
  const press = text => until(page, text => {
    const button = [...document.querySelectorAll("#jobcard-body button, #start-why button")].find(one => one.innerText.startsWith(text) && !one.disabled);
    button?.click();
    return Boolean(button);
  }, text);
  const started = async () => {
    await until(page, () => {
      document.querySelector("#start-why button")?.click();
      return !document.getElementById("start").disabled;
    });
    await page.click("#start");
    await phase("run");
  };

  await page.click('[data-machine="shapeoko3"]');
  await page.click('[data-sample="pocket_mm.nc"]');
  await until(page, () => document.getElementById("verdict").innerText.includes("Ready to run") && oxmill.app.checked);
  assert.match(await say("verdict"), /All 465 lines are accepted/);
  await page.click("#to-run");
  // Power a machine up, home it, move the tool over the workpiece, and zero it there.
  await page.click("#power");
  await phase("idle");
  await until(page, () => !document.getElementById("home").disabled);
  await page.click("#home");
  await until(page, () => oxmill.app.machine.homed && oxmill.app.machine.isAtRest);
  await page.click("#steps button:nth-of-type(5)");
  for (const [way, axis] of [["X to minus", 0], ["Y to minus", 1], ["Z to minus", 2]]) {
    const before = await work();
    await page.click(`[aria-label="jog ${way}"]`);
    await until(page, ([axis, wanted]) => Math.abs(oxmill.app.machine.status.work[axis] - wanted) < 0.01, [axis, before[axis] - 10]);
  }
  await rest();
  await page.click("#zero-all");
  await until(page, () => oxmill.app.machine.status.work.every(at => Math.abs(at) < 0.001));
  // Start the job, hold and resume it, and stop it on its way.
  await started();
  await until(page, () => oxmill.app.machine.status.state === "Run" && oxmill.app.machine.running?.follower.line > 16);
  await page.click('[data-realtime="hold"]');
  await until(page, () => oxmill.app.machine.status.state === "Hold:0");
  assert.match(await say("jobcard-title"), /Hold/i);
  await page.click('[data-realtime="resume"]');
  await phase("run");
  // The simulated machine runs at 20 times real time, to save time; later, in the rest of the job, at 100 times.
  const times = value => page.evaluate(value => {
    const select = document.getElementById("times");
    select.value = value;
    select.dispatchEvent(new Event("change"));
  }, value);
  await times("20");
  await until(page, () => oxmill.app.machine.running?.follower.time > 0.15 * oxmill.app.machine.running?.follower.end);
  const at = await page.evaluate(() => {
    const { follower } = oxmill.app.machine.running;
    document.getElementById("stop").dispatchEvent(new PointerEvent("pointerdown", { button: 0, bubbles: true }));
    return follower.line;
  });
  await until(page, () => oxmill.app.machine.stopped && oxmill.app.machine.phase === "idle");
  const line = await page.evaluate(() => oxmill.app.machine.stopped.line);
  assert(line >= at && line > 20, `stopped at line ${line}, it was at ${at}`);
  assert.match(await say("jobcard-body"), new RegExp(`^Stopped at line ${line}`));
  const [, , z] = await work();
  await press("Lift Z");
  await until(page, z => Math.abs(oxmill.app.machine.status.work[2] - z - 10) < 0.01, z);
  await rest();
  // Open the rest of the job as a job of its own, and run it to its end.
  await press("Continue from line");
  assert.equal(await page.evaluate(() => document.getElementById("from-line").value), String(line));
  await until(page, () => document.getElementById("prologue").textContent !== "");
  await page.click("#load-rest");
  await until(page, line => oxmill.app.job.name === `pocket_mm-from-${line}.nc` && oxmill.app.checked, line);
  assert.deepEqual(await page.evaluate(() => oxmill.app.checked.summary.errors), []);
  await page.click("#to-run");
  await until(page, () => /^Start job/.test(document.getElementById("start").innerText.trim()));
  await times("100");
  await started();
  await until(page, () => oxmill.app.machine.finished && oxmill.app.machine.isAtRest);
  assert.match(await say("jobcard-body"), /^pocket_mm-from-\d+\.nc is finished/);
  assert.equal(await page.evaluate(() => document.querySelectorAll("#console .wrong").length), 0);
  const end = await work();
  assert(Math.abs(end[0]) < 0.01 && Math.abs(end[1]) < 0.01, `${end}`);
}
