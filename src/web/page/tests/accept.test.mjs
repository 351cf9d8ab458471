// What the page promises to a user at a machine: one test per promise.
import assert from "node:assert/strict";
import { checked, open, openJob, PATIENCE, tab } from "./browser.mjs";
import { example, page as file } from "./program.mjs";

const SIZES = [[1440, 900], [1024, 768], [390, 844]];
const BAD = "G21 G90\nG1 X10 F600\nG999\nG1 Y10\n";

/** Connects a simulated machine that follows the test's instructions. The machine records the lines and the realtime
 * commands that it receives; `now` is the time at which a command arrived. Its settings are those of a small mill. */
const attach = (page, more = {}) => page.evaluate(more => {
  const settings = { 13: 0, 20: 0, 21: 0, 22: 1, 30: 10000, 32: 0, 110: 3000, 111: 3000, 112: 600, 120: 300, 121: 300, 122: 100, 130: 300, 131: 180, 132: 45, 922: 1, ...more.settings };
  const fake = (globalThis.fake = {
    state: "Idle", at: [-10, -20, -5], offset: [-100, -50, -20], fields: "|FS:0,0|Ov:100,100,100", lines: [], commands: [], greets: false, answers: true,
    onsaid() {}, onlost() {}, close() {},
    say(text) { this.onsaid(`${text}\r\n`); },
    report() { this.say(`<${this.state}|MPos:${this.at}|WCO:${this.offset}${this.fields}>`); },
    write(bytes) {
      if (bytes.length === 1 && bytes[0] !== 10) {
        if (bytes[0] === 0x3f) return void (this.answers && this.report());
        this.commands.push({ byte: bytes[0], now: performance.now() });
        this.oncommand?.(bytes[0]);
        return;
      }
      const line = new TextDecoder().decode(bytes).trim();
      this.lines.push(line);
      if (line === "$$") for (const [number, value] of Object.entries(settings)) this.say(`$${number}=${value}`);
      if (line === "$G") this.say("[GC:G0 G54 G17 G21 G90 G94 M5 M9 T0 F0 S0]");
      if (line === "$I") this.say("[VER:1.1h.20260101:]\r\n[OPT:V,16,128]");
      if (this.holdsAnswers) return;
      this.say(this.online?.(line) ?? "ok");
    },
  });
  oxmill.app.machine.attach(fake);
}, more);
const idle = page => page.waitForFunction(() => oxmill.app.machine.isAtRest && oxmill.app.machine.settings[110] && oxmill.app.machine.modes.length, null, { timeout: PATIENCE });
const lines = page => page.evaluate(() => fake.lines.filter(line => !/^\$([$G#]|I\+?)$/.test(line)));
const commands = page => page.evaluate(() => fake.commands.map(({ byte }) => byte));

/** Opens the page with a machine that is homed, zeroed and at rest. */
async function withMachine(browser, more = {}) {
  const opened = await open(browser, file, more);
  await tab(opened.page, "run");
  await attach(opened.page, more);
  await idle(opened.page);
  await opened.page.evaluate(() => (oxmill.app.machine.homed = true));
  return opened;
}

/** Starts the open job on a machine that accepts all lines and stays at the position that the test sets. */
async function running(page) {
  await page.waitForFunction(() => !document.getElementById("start").disabled, null, { timeout: PATIENCE });
  await page.evaluate(() => {
    fake.state = "Run";
    document.getElementById("start").click();
  });
  await page.waitForFunction(() => oxmill.app.machine.phase === "run");
}

/** Functions that bring the page into each of its states, as a user would. */
const STATES = {
  first: page => page.evaluate(() => oxmill.app.go("first")),
  check: page => tab(page, "whatif"),
  refused: async page => {
    await openJob(page, "bad.nc", BAD);
    await tab(page, "whatif");
  },
  settings: page => tab(page, "settings"),
  none: page => tab(page, "run"),
  idle: async page => {
    await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
    await tab(page, "run");
    await attach(page);
    await idle(page);
    await page.evaluate(() => (oxmill.app.machine.homed = true));
  },
  run: running,
  hold: page => page.evaluate(async () => {
    fake.state = "Hold:0";
    await oxmill.app.machine.report();
  }),
  stopped: async page => {
    await page.evaluate(() => {
      fake.oncommand = byte => byte === 0x18 && (fake.state = "Idle", fake.say("Grbl 1.1h ['$' for help]"));
      oxmill.app.machine.stop();
    });
    await page.waitForFunction(() => oxmill.app.machine.stopped && oxmill.app.machine.phase === "idle");
  },
  alarm: page => page.evaluate(async () => {
    fake.state = "Alarm";
    fake.say("ALARM:1");
    await oxmill.app.machine.report();
  }),
};

export async function nothing_scrolls_sideways_in_any_state(browser) {
  for (const [width, height] of SIZES) {
    const { page, faults, context } = await open(browser, file, { viewport: { width, height } });
    for (const [name, reach] of Object.entries(STATES)) {
      await reach(page);
      for (const part of width < 700 && (await page.evaluate(() => document.getElementById("app").dataset.workspace)) === "run" ? ["control", "job", "picture", "more"] : [""]) {
        if (part) await page.click(`.parts [data-part=${part}]`);
        assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), width, `${name} ${part} at ${width}`);
        if (width >= 700) assert(await page.evaluate(() => document.documentElement.scrollHeight <= innerHeight), `${name} at ${width}: the page itself scrolls`);
      }
    }
    assert.deepEqual(faults, []);
    await context.close();
  }
}

export async function controls_of_the_machine_are_large_enough_for_a_hand(browser) {
  for (const [width, height] of SIZES) {
    const { page, context } = await withMachine(browser, { viewport: { width, height } });
    for (const part of width < 700 ? ["control", "job", "more"] : [""]) {
      if (part) await page.click(`.parts [data-part=${part}]`);
      const small = await page.evaluate(() => [...document.querySelectorAll("#pads button, #steps button, #feeds button, .dro .btn, .grid4 .btn, #macros button, #start, #hold-row button, .spindle .btn, [data-coolant], .over button, .stop")]
        .filter(one => one.offsetParent && one.getBoundingClientRect().height < 43.9).map(one => `${one.textContent} ${one.getBoundingClientRect().height}`));
      assert.deepEqual(small, [], `${width} ${part}`);
    }
    await context.close();
  }
}

export async function stop_is_in_reach_everywhere(browser) {
  for (const [width, height] of SIZES) {
    const { page, context } = await withMachine(browser, { viewport: { width, height } });
    const reached = where => page.evaluate(where => {
      const stop = [...document.querySelectorAll(".stop")].find(one => one.offsetParent);
      const { left, top, width, height } = stop.getBoundingClientRect();
      const found = document.elementFromPoint(left + width / 2, top + height / 2);
      return stop.contains(found) && !stop.disabled ? "" : `${where}: ${found?.outerHTML.slice(0, 100)}`;
    }, where);
    for (const workspace of ["check", "run", "settings", "first"]) {
      await page.evaluate(workspace => oxmill.app.go(workspace), workspace);
      assert.equal(await reached(`${workspace} at ${width}`), "");
    }
    await page.evaluate(() => oxmill.app.go("run"));
    for (const opener of ["open-probe", "edit-macros", "open-tools", "keys-button"]) {
      await page.evaluate(id => document.getElementById(id).click(), opener);
      assert(await page.locator(".dialog:visible").count() === 1, opener);
      assert.equal(await reached(`${opener} at ${width}`), "");
      await page.keyboard.press("Escape");
      assert(await page.locator(".dialog:visible").count() === 0, opener);
    }
    await context.close();
  }
}

export async function a_job_that_would_be_refused_does_not_start(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "bad.nc", BAD);
  await page.waitForFunction(() => document.getElementById("start-why").textContent !== "");
  assert(await page.locator("#start").isDisabled());
  assert.equal(await page.textContent("#start-why"), "Off: 1 line would be refused.");
  await tab(page, "whatif");
  assert(await page.locator("#to-run").isDisabled());
  assert.equal(await page.textContent("#to-run-why"), "Off: 1 line would be refused.");
  assert.deepEqual(faults, []);
}

/** For a file that is not a job, the page shows one sentence, and nothing on the page looks as if a job had been
 * checked. */
export async function files_that_are_no_jobs_get_a_sentence(browser) {
  const { page, faults } = await open(browser, file);
  const give = async (name, bytes) => {
    await page.setInputFiles("#file", { name, mimeType: "", buffer: Buffer.from(bytes) });
    await page.waitForFunction(name => document.getElementById("name").textContent === name, name);
    return page.textContent("#verdict");
  };
  const refused = { "empty.nc": [[], /This file is empty\.empty\.nc has 0 bytes/], "photo.nc": [[0x89, 0x50, 0x4e, 0x47, 13, 10, 26, 10, 0, 0], /photo\.nc looks like a picture \(PNG\)/], "data.nc": [[71, 49, 0, 1, 2], /has bytes in it that no text has/] };
  for (const [name, [bytes, text]] of Object.entries(refused)) {
    assert.match(await give(name, bytes), text);
    assert.match(await page.getAttribute("#verdict-card", "class"), /bad/);
    assert.equal(await page.locator("#verdict-time:visible, #problems:visible, #time-card:visible, #legend:visible").count(), 0, name);
    assert(await page.locator("#nothing").isVisible() && await page.locator("#to-run").isDisabled(), name);
  }
  // A UTF-16 file is a valid program.
  const found = await openJob(page, "wide.nc", Buffer.from("\uFEFFG21 G91\nG1 X3 F300\n", "utf16le"));
  assert.deepEqual([found.errors, found.position_mm[0]], [[], 3]);
  assert(await page.locator("#nothing").isHidden());
  assert.deepEqual(faults, []);
}

export async function the_job_is_named_in_the_bar(browser) {
  const { page } = await open(browser, file);
  await openJob(page, "my part.nc", "G21 G91\nG1 X3 F300\n");
  for (const workspace of ["check", "run", "settings"]) {
    await page.evaluate(workspace => oxmill.app.go(workspace), workspace);
    assert.equal(await page.locator("#name").innerText(), "my part.nc");
  }
  assert(!(await page.locator("body").innerText()).includes("No file chosen"));
}

export async function clock_picture_chart_and_lines_follow_the_machine(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await running(page);
  const job = await page.evaluate(() => {
    const { path, summary } = oxmill.app.checked;
    return { end: summary.forecast_s, zero: summary.position_mm.map((at, axis) => at - summary.work_position_mm[axis]), at: [0.03, 0.05, 0.08].map(part => ({ seconds: part * summary.forecast_s, place: oxmill.placeAt(path, part * summary.forecast_s) })) };
  });
  for (const { seconds, place } of job.at) {
    // Change both values at once: a report in between would give another position on the path.
    await page.evaluate(([place, zero]) => ([fake.at, fake.offset] = [place.map((v, axis) => v - zero[axis]), [0, 0, 0]]), [place, job.zero]);
    await page.waitForFunction(place => {
      const at = oxmill.placeAt(oxmill.app.checked.path, oxmill.app.player.time);
      return Math.hypot(...at.map((v, axis) => v - place[axis])) < 0.5;
    }, place, { timeout: PATIENCE });
    const shown = await page.evaluate(() => ({ time: oxmill.app.player.time, follower: oxmill.app.machine.running.follower.time, line: oxmill.app.player.line, chart: Number(document.getElementById("chart").getAttribute("aria-valuenow")),
      selected: Number(document.querySelector("#lines [aria-selected=true]").dataset.line), clock: document.getElementById("clock").textContent, left: document.getElementById("run-left-time").textContent, now: oxmill.app.player.picture.now }));
    assert.deepEqual([shown.chart, shown.follower, shown.now, shown.selected], [shown.time, shown.time, shown.time, shown.line], `${seconds} s`);
    const of = text => text.split(":").reduce((sum, part) => sum * 60 + Number(part), 0);
    assert(Math.abs(of(shown.clock) + of(shown.left) - Math.round(job.end)) <= 1, `${shown.clock} and ${shown.left} of ${job.end} s`);
    assert.equal(shown.clock, await page.textContent("#clock"));
  }
  // Another feed override changes the remaining time, but not the progress.
  const left = () => page.evaluate(() => oxmill.app.machine.running.follower.left({ feed: oxmill.app.machine.overrides[0] / 100, rapid: 1 }));
  const before = await left();
  await page.evaluate(() => (fake.fields = "|FS:0,0|Ov:50,100,100"));
  await page.waitForFunction(() => oxmill.app.machine.overrides[0] === 50);
  assert(await left() > 1.3 * before);
  assert(await page.locator("#play").isDisabled());
  assert(await page.locator("#follow-label").isVisible());
  assert.deepEqual(faults, []);
}

export async function a_step_is_one_jog_and_keys_jog_only_when_they_are_switched_on(browser) {
  const { page, faults } = await withMachine(browser);
  await page.click("#steps button:has-text('0.1')");
  await page.getByRole("button", { name: "jog X to plus", exact: true }).click();
  await page.waitForFunction(() => fake.lines.some(line => line.startsWith("$J")));
  assert.deepEqual(await lines(page), ["$J=G91 G21 X0.1 F1200"]);
  const sent = async act => {
    const before = (await lines(page)).length;
    await act();
    await page.waitForTimeout(300);
    return (await lines(page)).slice(before);
  };
  await page.getByRole("button", { name: "jog X to minus and Y to plus", exact: true }).waitFor();
  assert.deepEqual(await sent(() => page.getByRole("button", { name: "jog X to minus and Y to plus", exact: true }).click()), ["$J=G91 G21 X-0.1 Y0.1 F1200"]);
  await page.locator("body").click({ position: { x: 700, y: 20 } });
  assert.deepEqual(await sent(() => page.keyboard.press("ArrowLeft")), [], "switched off");
  await page.check("#key-jog", { force: true });
  assert.deepEqual(await sent(() => page.keyboard.press("ArrowLeft")), ["$J=G91 G21 X-0.1 F1200"]);
  assert.deepEqual(await sent(() => page.keyboard.press("PageUp")), ["$J=G91 G21 Z0.1 F600"]);
  await page.focus("#jog-feed");
  assert.deepEqual(await sent(() => page.keyboard.press("ArrowLeft")), [], "in a field");
  // Jog by a custom step, finer than a hundredth.
  await page.fill("#own-step", "0.025");
  await page.press("#own-step", "Enter");
  await page.keyboard.press("Tab");
  assert.deepEqual(await sent(() => page.getByRole("button", { name: "jog Z to minus", exact: true }).click()), ["$J=G91 G21 Z-0.025 F600"]);
  // Leaving the window switches jogging by keys off.
  await page.evaluate(() => dispatchEvent(new Event("blur")));
  assert.equal(await page.isChecked("#key-jog"), false);
  assert.deepEqual(faults, []);
}

export async function zero_is_set_in_the_system_that_is_in_force(browser) {
  const { page, faults } = await withMachine(browser);
  await page.click("#zero-xy");
  await page.click("#zero-all");
  await page.click("#dro [aria-label*='zero of Z']");
  await page.fill("#work-0", "12.5");
  await page.press("#work-0", "Enter");
  await page.waitForFunction(() => fake.lines.filter(line => line.startsWith("G10")).length === 4);
  assert.deepEqual(await lines(page), ["G10 L20 P1 X0 Y0", "G10 L20 P1 X0 Y0 Z0", "G10 L20 P1 Z0", "G10 L20 P1 X12.5"]);
  // The tool can be sent to Z0 only above X0 Y0. On the way to X0 Y0, Z is lifted first.
  assert(await page.locator("#go-z").isDisabled());
  await page.click("#go-xy");
  await page.waitForFunction(() => fake.lines.filter(line => line.startsWith("$J")).length === 2);
  assert.match((await lines(page)).at(-2), /^\$J=G90 G21 Z\d/);
  assert.equal((await lines(page)).at(-1), "$J=G90 G21 X0 Y0 F3000");
  assert.deepEqual(faults, []);
}

export async function stop_brakes_first_and_resets_at_rest(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await running(page);
  const stop = () => page.evaluate(() => {
    fake.commands.length = 0;
    const began = performance.now();
    document.getElementById("stop").dispatchEvent(new PointerEvent("pointerdown", { button: 0, bubbles: true }));
    return began;
  });
  // Do all of this in one evaluation: the page must handle no timer in between.
  const braking = await page.evaluate(() => {
    fake.commands.length = 0;
    const began = performance.now();
    document.getElementById("stop").dispatchEvent(new PointerEvent("pointerdown", { button: 0, bubbles: true }));
    const first = [...fake.commands];
    fake.state = "Hold:1";
    fake.report();
    const second = [...fake.commands];
    fake.oncommand = byte => byte === 0x18 && (fake.state = "Idle", fake.say("Grbl 1.1h ['$' for help]"));
    fake.state = "Hold:0";
    fake.report();
    return { took: first[0].now - began, first: first.map(({ byte }) => byte), second: second.map(({ byte }) => byte) };
  });
  assert(braking.took < 50, "at once");
  assert.deepEqual([braking.first, braking.second], [[0x21], [0x21]], "it is still braking");
  await page.waitForFunction(() => fake.commands.length === 2);
  assert.deepEqual(await commands(page), [0x21, 0x18]);
  await page.waitForFunction(() => oxmill.app.machine.phase === "idle");
  assert.match(await page.textContent("#jobcard-body"), /^Stopped at line \d+/);
  // A machine that does not come to rest is reset all the same: after the time to brake from 3000 mm/min at 300 mm/s2,
  // plus half a second.
  await page.evaluate(() => {
    fake.oncommand = undefined;
    fake.state = "Run";
  });
  await page.waitForFunction(() => oxmill.app.machine.phase === "run");
  await stop();
  await page.waitForFunction(() => fake.commands.length === 2, null, { timeout: PATIENCE });
  const [hold, reset] = await page.evaluate(() => fake.commands);
  assert.deepEqual([hold.byte, reset.byte], [0x21, 0x18]);
  assert(reset.now - hold.now >= 3000 / 60 / 300 * 1000 + 490, `${reset.now - hold.now} ms`);
  // A jog is only cancelled.
  await page.evaluate(() => (fake.state = "Jog"));
  await page.waitForFunction(() => oxmill.app.machine.phase === "jog");
  await stop();
  assert.deepEqual(await commands(page), [0x85]);
  // A homing cycle ignores a hold, so Stop resets immediately.
  await page.evaluate(() => (fake.state = "Home"));
  await page.waitForFunction(() => oxmill.app.machine.phase === "home");
  await stop();
  assert.deepEqual(await commands(page), [0x18]);
  assert.deepEqual(faults, []);
}

export async function after_an_alarm_one_step_at_a_time_is_open(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await running(page);
  await page.evaluate(async () => {
    fake.state = "Alarm";
    fake.say("[MSG:Limit switch X at machine -3.000,0.000,0.000]\r\nALARM:1");
    await oxmill.app.machine.report();
  });
  assert.match(await page.locator("#banner").innerText(), /^Alarm 1: a limit switch tripped[^]*at line \d+\. Its position may be wrong until it is homed\. No line is sent\./);
  const steps = () => page.locator(".steplist li").evaluateAll(all => all.map(step => [step.className, step.querySelector("b").textContent]));
  assert.deepEqual((await steps()).map(([state, text]) => [state, text.replace(/\d+/, "N")]), [["now", "Look at the machine"], ["", "Jog off the switch"], ["", "Home"], ["", "Continue from line N"]]);
  assert(await page.locator("#start").isDisabled());
  await page.evaluate(() => (fake.oncommand = byte => byte === 0x18 && fake.say("Grbl 1.1h ['$' for help]\r\n[MSG:'$H'|'$X' to unlock]")));
  await page.evaluate(() => (fake.online = line => (line === "$X" ? ((fake.state = "Idle"), "ok") : "ok")));
  await page.click(".steplist .now button");
  await page.waitForFunction(() => oxmill.app.machine.phase === "idle");
  assert.deepEqual((await steps()).map(([state]) => state), ["done", "done", "now", ""]);
  await page.click(".steplist .now button:has-text('Home')");
  await page.waitForFunction(() => document.getElementById("jobcard-title").textContent === "Stopped");
  assert(await page.locator("#banner").isHidden());
  const line = Number(/line ([\d,]+)/.exec(await page.textContent("#jobcard-body"))[1].replace(",", ""));
  await page.click("#jobcard-body button:has-text('Continue from line')");
  assert(await page.locator("#continue").isVisible());
  assert.equal(await page.inputValue("#from-line"), String(line));
  await page.waitForFunction(() => document.getElementById("prologue").textContent !== "", null, { timeout: PATIENCE });
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.click("#load-rest");
  assert.deepEqual((await checked(page, `pocket_mm-from-${line}.nc`)).errors, []);
  assert.deepEqual(faults, []);
}

export async function a_lost_connection_is_said_and_stop_says_what_to_do_instead(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await running(page);
  await page.evaluate(() => (fake.answers = false));
  await page.waitForFunction(() => document.getElementById("state").textContent === "No answer");
  await page.waitForFunction(() => oxmill.app.machine.phase === "lost", null, { timeout: PATIENCE });
  await page.waitForFunction(() => document.querySelector("#banner b")?.textContent.startsWith("No answer from the board for"));
  assert(await page.locator("#stop").isDisabled());
  assert.equal(await page.getAttribute("#stop", "title"), "No connection: use the emergency stop of the machine.");
  // When the machine answers again, everything is as before.
  await page.evaluate(() => (fake.answers = true));
  await page.waitForFunction(() => oxmill.app.machine.phase === "run" && document.getElementById("banner").hidden && !document.getElementById("stop").disabled);
  // Pull the cable.
  await page.evaluate(() => fake.onlost("the port is closed"));
  assert.equal(await page.textContent("#state"), "Connection lost");
  assert.match(await page.textContent("#jobcard-body"), /Stopped at line \d+/);
  assert(await page.locator("#connectcard").isVisible());
  assert.deepEqual(faults, []);
}

export async function what_is_switched_off_says_why(browser) {
  const { page } = await open(browser, file);
  for (const [name, reach] of Object.entries(STATES)) {
    await reach(page);
    const mute = await page.evaluate(() => [...document.querySelectorAll("button:disabled, input:disabled, select:disabled")].filter(one => one.offsetParent && !one.title && !one.closest(".block")?.querySelector(".why:not(:empty)"))
      .map(one => one.id || one.ariaLabel || one.textContent));
    assert.deepEqual(mute, [], name);
  }
}

export async function headings_and_live_regions_are_as_they_should_be(browser) {
  const { page } = await open(browser, file);
  for (const workspace of ["first", "check", "run", "settings"]) {
    await page.evaluate(workspace => oxmill.app.go(workspace), workspace);
    assert.equal(await page.evaluate(() => [...document.querySelectorAll("h1")].filter(one => one.offsetParent).length), 1, workspace);
  }
  assert.equal(await page.getAttribute("#verdict", "aria-live"), "polite");
  assert.equal(await page.getAttribute("#banner", "role"), "alert");
}

export async function words_are_those_that_people_use(browser) {
  const { page } = await open(browser, file);
  const found = new Set();
  for (const reach of Object.values(STATES)) {
    await reach(page);
    for (const word of (await page.locator("body").innerText()).match(/\b(link|rest|take away|desk|starved?)\b/gi) ?? []) found.add(word.toLowerCase());
  }
  // Two of these words are allowed: "desk" is a board of the simulator, and "rest" means the rest of a job.
  assert.deepEqual([...found].filter(word => !["desk", "rest"].includes(word)), []);
}

export async function settings_are_one_row_for_all_axes(browser) {
  const { page } = await open(browser, file);
  await tab(page, "settings");
  const rows = await page.locator("#settings-table tr.row").evaluateAll(all => all.map(row => ({ name: row.querySelector("th").firstChild.textContent, inputs: [...row.querySelectorAll("td[data-axis] input")].map(input => input.ariaLabel.split(" ")[0]),
    seen: row.getBoundingClientRect().bottom <= innerHeight && row.offsetParent !== null })));
  const of = name => rows.find(row => row.name === name).inputs.slice(0, 3);
  assert.deepEqual([of("Maximum rate"), of("Acceleration"), of("Maximum travel")], [["$110", "$111", "$112"], ["$120", "$121", "$122"], ["$130", "$131", "$132"]]);
  const seen = rows.filter(row => row.seen).length;
  assert(seen >= 14, `${seen} settings are seen`);
  // A changed value is marked and can be reverted.
  await page.fill('[aria-label^="$121 "]', "55");
  await page.keyboard.press("Tab");
  await page.click('[data-filter="changed"]');
  assert.deepEqual(await page.locator("#settings-table tr.row:visible th").evaluateAll(all => all.map(head => head.firstChild.textContent)), ["Acceleration"]);
  await page.click("#inspect button:has-text('Back to the preset')");
  assert.equal(await page.locator("#settings-table tr.row:visible").count(), 0);
  assert.equal(await page.evaluate(() => oxmill.app.settings.value(121)), 10);
}

export async function settings_of_other_controllers_become_these(browser) {
  const { page, faults } = await open(browser, file);
  await tab(page, "settings");
  const taken = async text => {
    await page.click("#open-import");
    await page.fill("#paste", text);
    const rows = await page.locator("#import-table tbody tr").allInnerTexts();
    const note = await page.textContent("#take-note");
    await page.click("#take");
    return { rows, note, values: await page.evaluate(() => oxmill.app.settings.values()) };
  };
  const hal = await taken("$10=511\n$22=3\n$110=4000.000\n$120=350.000\n$384=0\n$481=0\n");
  assert.match(hal.note, /^grblHAL: 5 settings, 2 lines are not taken/);
  assert.deepEqual(hal.values, { 10: 3, 22: 1, 110: 4000, 120: 350 });
  assert(hal.rows.some(row => row.startsWith("$384=0") && row.includes("a reset always forgets G92")));
  const fluid = await taken("board: x\narc_tolerance_mm: 0.004\naxes:\n  shared_stepper_disable_pin: gpio.13\n  x:\n    steps_per_mm: 80\n    max_rate_mm_per_min: 6000 # fast\n    acceleration_mm_per_sec2: 250\n    max_travel_mm: 400\n    soft_limits: true\n    homing:\n      cycle: 2\n      positive_direction: false\n  y:\n    steps_per_mm: 81\n");
  assert.deepEqual(fluid.values, { 12: 0.004, 20: 1, 22: 1, 23: 1, 44: 1, 45: 0, 100: 80, 101: 81, 110: 6000, 120: 250, 130: 400 });
  assert(fluid.rows.some(row => row.startsWith("axes/shared_stepper_disable_pin") && row.includes("not taken")));
  // A backup restores the values.
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#backup")]);
  const text = await (await import("node:fs/promises")).readFile(await download.path(), "utf8");
  await page.evaluate(() => oxmill.app.settings.choose("new"));
  assert.deepEqual((await taken(text)).values, fluid.values);
  assert.deepEqual(faults, []);
}

export async function the_scrubber_is_wide_enough_and_the_console_is_seen(browser) {
  for (const [width, least] of [[1024, 400], [390, 240]]) {
    const { page, context } = await open(browser, file, { viewport: { width, height: 800 } });
    const box = await page.locator("#chart").boundingBox();
    assert(box.width >= least, `${box.width} at ${width}`);
    await context.close();
  }
  const { page } = await withMachine(browser);
  await page.click("#tab-log");
  const box = await page.locator("#command").boundingBox();
  assert(box.y + box.height <= 900);
}

export async function the_legend_names_what_is_drawn(browser) {
  const { page } = await open(browser, file);
  await openJob(page, "kinds.nc", "G21 G91\nG0 X5\nG1 Z-1 F600\nG1 X5\nG2 X5 Y5 J5\n");
  // The legend is drawn with the picture, a moment after the check.
  const shows = marks => page.waitForFunction(marks => [...document.querySelectorAll("#legend-marks li")].map(mark => mark.innerText).join() === marks, marks.join());
  await shows(["rapid", "work zero"]);
  await page.uncheck("#show-rapids");
  await page.waitForFunction(() => !document.getElementById("legend-marks").textContent.includes("rapid"));
  await page.evaluate(() => oxmill.app.player.seek(1));
  await page.check("#limits");
  await page.waitForFunction(() => document.getElementById("legend-marks").textContent.includes("travel"));
  await shows(["time", "work zero", "travel"]);
  await openJob(page, "bad.nc", BAD);
  await shows(["work zero", "refused line", "travel"]);
  await page.selectOption("#coloring", "power");
  assert.equal(await page.textContent("#legend-caption"), "Spindle or laser power, S");
}

export async function the_power_of_a_laser_has_a_colour(browser) {
  const { page } = await open(browser, file);
  await openJob(page, "laser.nc", "G21 G91 F600\nM4 S1000\nG1 X5\nS500\nG1 Y5\nM5\nG1 X-5\n");
  await page.selectOption("#coloring", "power");
  const shades = await page.evaluate(() => {
    const { lines } = oxmill.app.checked.path;
    return Object.fromEntries([...lines].map((line, row) => [line % 2 ** 30, Number(oxmill.app.player.picture.shades[row].toFixed(2))]).slice(1));
  });
  assert.deepEqual(shades, { 3: 1, 5: 0.5, 7: 0 });
}

export async function the_first_time_is_that_of_the_machine_that_is_chosen(browser) {
  const { page, faults } = await open(browser, file, { first: true });
  assert(await page.locator("#first h1").isVisible());
  assert.equal(await page.getAttribute('[data-machine="3018"]', "aria-checked"), "true");
  const timed = () => page.waitForFunction(() => /\d:\d\d/.test(document.querySelector('[data-sample="five_circles.nc"] span').textContent) && document.querySelector('[data-sample="five_circles.nc"] span').textContent, null, { timeout: PATIENCE })
    .then(found => found.jsonValue());
  const slow = await timed();
  await page.click('[data-machine="shapeoko3"]');
  assert.match(await page.textContent("#machine-source"), /defaults\.h, DEFAULTS_SHAPEOKO_3/);
  const fast = await timed();
  assert.notEqual(fast, slow);
  await page.click('[data-sample="five_circles.nc"]');
  const found = await checked(page, "five_circles.nc");
  assert.equal(await page.textContent("#machine-name"), "Shapeoko 3");
  assert.equal(fast, `${Math.floor(Math.round(found.forecast_s) / 60)}:${String(Math.round(found.forecast_s) % 60).padStart(2, "0")}`);
  assert.deepEqual(faults, []);
}

export async function inches_are_everywhere_or_nowhere(browser) {
  const { page, faults } = await withMachine(browser);
  const step = () => page.evaluate(() => oxmill.app.player.picture.lattice.step);
  assert.equal(await page.inputValue("#work-0"), "90.000");
  const before = await step();
  await page.click('[data-unit="inch"]');
  assert.equal(await page.inputValue("#work-0"), "3.5433");
  assert.deepEqual(await page.locator("#steps button").allInnerTexts(), ["0.0005", "0.005", "0.05", "0.5", "Hold"]);
  assert.equal(await page.textContent("#jog-unit"), "in/min");
  assert.equal(await page.inputValue("#jog-feed"), "47.24");
  await page.waitForFunction(() => document.getElementById("legend-caption").textContent.endsWith("in/min"));
  const after = await step();
  assert(Math.abs(after / 25.4 - 10 ** Math.round(Math.log10(after / 25.4))) < 1e-9 && after !== before, `${before} ${after}`);
  await page.click("#steps button:has-text('0.5')");
  await page.getByRole("button", { name: "jog X to plus", exact: true }).click();
  await page.waitForFunction(() => fake.lines.some(line => line.startsWith("$J")));
  assert.match((await lines(page)).at(-1), /^\$J=G91 G21 X12\.7 F1199\.9$|^\$J=G91 G21 X12\.7 F1200(\.\d)?$/);
  await page.click('[data-unit="mm"]');
  assert.equal(await page.inputValue("#work-0"), "90.000");
  assert.deepEqual(faults, []);
}

export async function a_job_that_turns_gets_no_verdict_on_its_material(browser) {
  const { page, faults } = await open(browser, file);
  await page.evaluate(() => {
    oxmill.app.checked = undefined;
    oxmill.app.settings.set(930, 4);
  });
  await checked(page);
  const found = await openJob(page, "rotary.nc", "G21 G91 F600\nG1 Z-1\nG1 X5 A90\nG0 Z5\n");
  assert.deepEqual(found.errors, []);
  await tab(page, "material");
  await page.click("#cut");
  await page.waitForFunction(() => document.getElementById("material-note").textContent !== "", null, { timeout: PATIENCE });
  assert.match(await page.textContent("#material-note"), /^Not checked: this job turns the A axis/);
  assert.match(await page.getAttribute("#material-note", "class"), /warn/);
  assert(!/good/.test(await page.getAttribute("#material-note", "class")));
  assert.deepEqual(faults, []);
}

/** A job that would fail cannot be started. If there are only questions, such as about a missing homing, the user can
 * confirm them. */
export async function nothing_starts_that_would_fail(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "tool.nc", "G21 G90 G10 L1 P5 Z1\nG43 H5\nG0 X1\n");
  await tab(page, "run");
  await attach(page, { settings: { 20: 1, 22: 1 } });
  await idle(page);
  const checks = () => page.locator(".checks li").evaluateAll(all => all.map(item => [item.className, item.querySelector("span").firstChild.textContent]));
  // The machine is not homed, so the travel is not checked, and the page asks before the start.
  await page.evaluate(() => (oxmill.app.machine.homed = false));
  await page.waitForFunction(() => document.getElementById("start-why").textContent.startsWith("Not homed"), null, { timeout: PATIENCE });
  assert(await page.locator("#start").isDisabled());
  await page.click("#start-why button");
  await page.waitForFunction(() => !document.getElementById("start").disabled);
  // The machine is homed, and from its work zero the job leaves the travel.
  await page.evaluate(() => {
    oxmill.app.machine.homed = true;
    fake.offset = [-0.5, -50, -20];
  });
  await page.waitForFunction(() => document.getElementById("start-why").textContent.includes("leaves the travel"), null, { timeout: PATIENCE });
  assert((await checks()).some(([grade, text]) => grade === "no" && text === "The job leaves the travel of this machine"));
  assert.deepEqual(await page.evaluate(() => [document.getElementById("start").disabled, document.getElementById("start-why").innerHTML]), [true, "Off: the job leaves the travel of this machine."]);
  await page.evaluate(() => (fake.offset = [-100, -50, -20]));
  await page.waitForFunction(() => !document.getElementById("start").disabled, null, { timeout: PATIENCE });
  assert((await checks()).some(([grade, text]) => grade === "yes" && text === "The job fits the travel from here"), JSON.stringify(await checks()));
  assert(!(await checks()).some(([, text]) => text === "The tool table is empty"));
  // The job needs a tool. On a machine without tools the page warns; on a machine with other tools it refuses the job.
  await openJob(page, "needs.nc", "G21 G90\nG43 H5\nG0 X1\n");
  await page.waitForFunction(() => [...document.querySelectorAll(".checks li.look")].some(item => item.textContent.startsWith("The tool table is empty")) && !document.getElementById("start").disabled, null, { timeout: PATIENCE });
  await page.evaluate(() => {
    fake.online = line => (line === "$#" ? (fake.say("[T:4|0,0,1.5|0]"), "ok") : "ok");
    void oxmill.app.machine.line("G4 P0");
  });
  await page.waitForFunction(() => document.getElementById("start-why").textContent === "Off: this machine would refuse a line.", null, { timeout: PATIENCE });
  assert.deepEqual(faults, []);
}

/** An edited line is checked immediately, and the whole job can be saved. */
export async function a_line_is_edited_in_place(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "edit.nc", BAD);
  assert.match(await page.textContent("#verdict"), /1 line would be refused/);
  await page.click("#line-3");
  await page.click("#edit-line");
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.fill("#line-3 input", "G1 X20");
  await page.keyboard.press("Enter");
  const found = await checked(page, "edit.nc");
  assert.deepEqual([found.errors, found.position_mm.slice(0, 2)], [[], [20, 10]]);
  assert.match(await page.textContent("#verdict"), /Ready to run/);
  assert.match(await page.locator("#lines [aria-selected=true]").innerText(), /^3\s+G1 X20/);
  const [download] = await Promise.all([page.waitForEvent("download"), page.click("#save-job")]);
  assert.equal(await (await import("node:fs/promises")).readFile(await download.path(), "utf8"), BAD.replace("G999", "G1 X20"));
  assert.deepEqual(faults, []);
}

/** A cutter that the CAM program has described in a comment is used. */
export async function cutters_are_read_from_comments(browser) {
  const { page } = await open(browser, file);
  await openJob(page, "cam.nc", "(T3 D=3.175 CR=0. - ZMIN=-1. - flat end mill)\n(Tool 4: 60 deg V-bit 6 mm)\nG21 G91 F600\nT3 M6\nG1 Z-1\nG1 X5\nT4 M6\nG1 X5\n");
  await tab(page, "material");
  await page.selectOption("#cutter-tool", "3");
  assert.deepEqual([await page.inputValue("#shape"), await page.inputValue("#diameter")], ["flat", "3.175"]);
  await page.selectOption("#cutter-tool", "4");
  assert.deepEqual([await page.inputValue("#shape"), await page.inputValue("#diameter"), await page.inputValue("#angle")], ["v", "6", "60"]);
  // A job without tool changes uses the only cutter that its comments describe. A cutter that the user has chosen
  // stays while this job is edited. Another job does not get it.
  const shown = async () => [await page.inputValue("#shape"), await page.inputValue("#diameter")];
  await openJob(page, "one.nc", "(T1 D=6. CR=0. - ZMIN=-6. - flat end mill)\nG21 G91 F600\nT1\nG1 Z-1\nG1 X5\n");
  assert.deepEqual(await shown(), ["flat", "6"]);
  await page.selectOption("#shape", "ball");
  await page.evaluate(() => oxmill.app.check());
  assert.deepEqual(await shown(), ["ball", "6"]);
  // A comment with only a length or an angle, beside a move, does not describe a cutter.
  await openJob(page, "other.nc", "G21 G91 F600\nG1 Z-1 (down by 1 mm)\n(turned by 60 deg)\nG1 X5\n");
  assert.deepEqual(await shown(), ["flat", "3"]);
}

/** Gives the fake machine a workpiece. `touches`: an expression in x, y and z (machine position, mm) that is true
 * while the tool touches the workpiece. */
const withWork = (page, touches) => page.evaluate(touches => {
  const inside = new Function("x", "y", "z", `return ${touches};`);
  fake.online = line => {
    const words = Object.fromEntries([...line.matchAll(/([XYZ])(-?[\d.]+)/g)].map(([, axis, value]) => ["XYZ".indexOf(axis), Number(value)]));
    if (/^G0 /.test(line)) fake.at = fake.at.map((at, axis) => at + (words[axis] ?? 0));
    if (inside(...fake.at)) fake.crashed = line;
    if (!/^G38\.3/.test(line)) return "ok";
    const length = Math.hypot(...Object.values(words));
    const from = [...fake.at];
    let found = false;
    for (let way = 0; way <= length && !found; way += 0.01) {
      fake.at = from.map((at, axis) => at + ((words[axis] ?? 0) / length) * way);
      found = inside(...fake.at);
    }
    // A machine needs a short distance to stop.
    const contact = [...fake.at];
    fake.at = fake.at.map((at, axis) => at + (found ? Math.sign(words[axis] ?? 0) * 0.02 : 0));
    fake.say(`[PRB:${contact.map(at => at.toFixed(3))}:${Number(found)}]`);
    if (found && Math.max(...fake.at.map((at, axis) => Math.abs(at - contact[axis]))) > 0.05) fake.crashed = line;
    return "ok";
  };
}, touches);

/** Each probing cycle finds the work zero on a workpiece of known size, without driving into it. */
export async function edges_corners_and_holes_are_found(browser) {
  const { page, faults } = await withMachine(browser);
  const probed = async (kind, fields, touches, from) => {
    await withWork(page, touches);
    await page.evaluate(from => {
      [fake.at, fake.lines.length, fake.crashed] = [from, 0, undefined];
    }, from);
    await page.waitForFunction(x => oxmill.app.machine.isAtRest && oxmill.app.machine.status.machine[0] === x, from[0]);
    await page.click("#open-probe");
    await page.click(`#probe-dialog [data-kind=${kind}]`);
    for (const [id, value] of Object.entries(fields)) {
      if (id === "probe-edge" || id === "probe-corner") await page.selectOption(`#${id}`, value);
      else await page.fill(`#${id}`, value);
    }
    await page.click("#probe");
    await page.waitForFunction(() => fake.lines.includes("G21 G90 G94"), null, { timeout: PATIENCE });
    const { at, lines, crashed } = await page.evaluate(() => ({ at: fake.at, lines: fake.lines, crashed: fake.crashed }));
    const set = lines.find(line => line.startsWith("G10"));
    // Work zero in machine coordinates, as the G10 line sets it.
    const zero = Object.fromEntries([...(set ?? "").matchAll(/([XYZ])(-?[\d.]+)/g)].map(([, axis, value]) => [axis, at["XYZ".indexOf(axis)] - Number(value)]));
    return { zero, crashed, note: await page.textContent("#machine-note") };
  };
  const near = ({ zero }, wanted) => {
    assert.deepEqual(Object.keys(zero).toSorted(), Object.keys(wanted).toSorted());
    for (const [axis, place] of Object.entries(wanted)) assert(Math.abs(zero[axis] - place) < 0.03, `${axis}: ${zero[axis]} instead of ${place}`);
  };
  // The hole is 20 mm by 12 mm, with its middle at -50, -40. The cutter has a radius of 1.5 mm, so its middle can move
  // by 8.5 mm to each side in X, and by 4.5 mm in Y.
  const hole = await probed("hole", { "probe-depth": "15" }, "Math.abs(x + 50) >= 8.5 || Math.abs(y + 40) >= 4.5", [-47, -38, -10]);
  near(hole, { X: -50, Y: -40 });
  // The left side of a workpiece at X -30, with a cutter of 3 mm.
  const edge = await probed("edge", { "probe-edge": "X+", "probe-cutter": "3", "plate-side": "0" }, "x >= -31.5", [-40, 0, -10]);
  near(edge, { X: -30 });
  // The corner of a workpiece at -30, -20, -15, with a plate of 10 mm on it and 5 mm at its sides.
  for (const [corner, sx, sy] of [["front left", 1, 1], ["back right", -1, -1]]) {
    const plate = `z <= -5 && ${sx} * (x + 30) >= -6.5 && ${sy} * (y + 20) >= -6.5`;
    const found = await probed("corner", { "probe-corner": corner, plate: "10", "plate-side": "5", "probe-cutter": "3", "probe-depth": "25" }, plate, [-30 + sx * 3, -20 + sy * 3, 0]);
    near(found, { Z: -15, X: -30, Y: -20 });
  }
  // Without a contact, nothing is set.
  const none = await probed("edge", { "probe-edge": "Y-", "probe-depth": "5" }, "false", [-40, 0, -10]);
  assert.deepEqual([none.zero, none.note], [{}, "No contact within 5 mm: the work zero is as it was."]);
  for (const { crashed } of [hole, edge, none]) assert.equal(crashed, undefined);
  assert.deepEqual(faults, []);
}

export async function a_probing_cycle_that_is_stopped_moves_no_more(browser) {
  const { page, faults } = await withMachine(browser);
  for (const at of ["G38.3", "G0", "G4"]) {
    await withWork(page, "z <= -15");
    await page.evaluate(at => {
      [fake.at, fake.lines.length, fake.state] = [[-10, -20, -5], 0, "Idle"];
      const { online } = fake;
      let stopped = false;
      fake.online = line => {
        const answer = online(line);
        if (line.startsWith(at) && !stopped) {
          stopped = true;
          fake.oncommand = byte => byte === 0x18 && fake.say("Grbl 1.1h ['$' for help]");
          fake.state = "Hold:0";
          oxmill.app.machine.stop();
          fake.report();
          fake.state = "Idle";
        }
        return answer;
      };
    }, at);
    await page.waitForFunction(() => oxmill.app.machine.isAtRest);
    await page.click("#open-probe");
    await page.click("#probe-dialog [data-kind=z]");
    await page.click("#probe");
    await page.waitForFunction(() => document.getElementById("machine-note").textContent === "Stopped: nothing is set.", null, { timeout: PATIENCE });
    await page.waitForFunction(() => oxmill.app.machine.isAtRest);
    await page.waitForTimeout(300);
    const sent = await lines(page);
    const behind = sent.slice(sent.findIndex(line => line.startsWith(at)) + 1).filter(line => !/^(G\d+ ?)+$/.test(line));
    assert.deepEqual(behind, [], `${at}: ${sent}`);
  }
  assert.deepEqual(faults, []);
}

/** Macros, tools, spindle and coolant send the right lines. A macro with a wrong line is rejected before it is
 * saved. */
export async function macros_tools_spindle_and_outline_send_their_lines(browser) {
  const { page, faults } = await withMachine(browser);
  const sent = async act => {
    const before = (await lines(page)).length;
    await act();
    await page.waitForTimeout(400);
    return (await lines(page)).slice(before);
  };
  await page.fill("#rpm", "8000");
  assert.deepEqual(await sent(() => page.click("#spindle-start")), ["M3 S8000"]);
  assert.deepEqual(await sent(() => page.click('[data-coolant="M8"]')), ["M8"]);
  await page.evaluate(() => (fake.fields = "|FS:0,8000|Ov:100,100,100|A:SF"));
  await page.waitForFunction(() => document.querySelector('[data-coolant="M8"]').getAttribute("aria-pressed") === "true");
  assert(await page.locator("#outline").isDisabled(), "the spindle turns");
  assert.deepEqual(await sent(() => page.click("#spindle-stop")), ["M5"]);
  await page.evaluate(() => (fake.fields = "|FS:0,0|Ov:100,100,100|A:"));
  await openJob(page, "square.nc", "G21 G90 F600\nG0 Z8\nG0 X10 Y5\nG1 Z-1\nG1 X30\nG1 Y25\nG0 Z8\n");
  await page.waitForFunction(() => !document.getElementById("outline").disabled);
  const round = await sent(() => page.click("#outline"));
  assert.equal(round.length, 6);
  assert(Number(/^\$J=G90 G21 Z([\d.]+) F/.exec(round[0])[1]) >= 8, round[0]);
  assert.deepEqual(round.slice(1).map(line => /X(\S+) Y(\S+)/.exec(line).slice(1).map(Number)), [[0, 0], [30, 0], [30, 25], [0, 25], [0, 0]]);
  // At first there are no macros. A macro that the firmware rejects is not saved; one that it accepts is.
  assert.equal(await page.locator("#macros button").count(), 0);
  await page.click("#edit-macros");
  await page.fill("#macro-name", "Away");
  await page.fill("#macro-lines", "G53 G0 Z-2\nG999");
  await page.click("#macro-dialog button:has-text('Keep')");
  await page.waitForFunction(() => /^Not kept\. Line 2: /.test(document.getElementById("macro-note").textContent));
  await page.fill("#macro-lines", "G53 G0 Z-2\nM5");
  await page.click("#macro-dialog button:has-text('Keep')");
  await page.waitForFunction(() => document.querySelectorAll("#macros button").length === 1);
  assert.deepEqual(await sent(() => page.click("#macros button")), ["G53 G0 Z-2", "M5"]);
  await page.click("#open-tools");
  await page.fill("#tool-number", "5");
  await page.fill("#tool-length", "12.5");
  assert.deepEqual(await sent(() => page.click("#tool-dialog button:has-text('Put in')")), ["G10 L1 P5 Z12.5"]);
  await page.click("#tool-dialog button:has-text('Close')");
  assert.deepEqual(faults, []);
}

export async function on_a_telephone_a_job_that_starts_is_shown(browser) {
  const { page, faults } = await withMachine(browser, { viewport: { width: 390, height: 844 } });
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await page.click(".parts [data-part=control]");
  await running(page);
  assert(await page.locator("#run-left-time").isVisible());
  // If the user then chooses another part, the page stays there.
  await page.click(".parts [data-part=picture]");
  await page.evaluate(() => oxmill.app.machine.report());
  assert(await page.locator("#view").isVisible());
  const [legend, follow] = await Promise.all(["#legend", "#follow-label"].map(part => page.locator(part).boundingBox()));
  assert(follow.y + follow.height <= legend.y, "nothing lies over the legend");
  assert.deepEqual(faults, []);
}

/** A line may change what the page knows of the machine. So Start is disabled from the answer until the page has
 * received modes and offsets again. Then Start stays enabled. */
export async function start_waits_for_what_a_line_has_changed(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await page.waitForFunction(() => !document.getElementById("start").disabled, null, { timeout: PATIENCE });
  const off = await page.evaluate(async () => {
    // Delay the answers, as a cable does, but not the reports.
    const { say } = fake;
    fake.say = text => (text.startsWith("<") ? say.call(fake, text) : setTimeout(() => say.call(fake, text), 30));
    const start = document.getElementById("start");
    globalThis.seen = [];
    new MutationObserver(() => seen.at(-1) !== start.disabled && seen.push(start.disabled)).observe(start, { attributes: true, attributeFilter: ["disabled"] });
    fake.online = line => (line.startsWith("G10") && (fake.offset = [-90, -40, -20]), "ok");
    await oxmill.app.machine.line("G10 L20 P1 X10 Y10");
    return start.disabled;
  });
  assert(off, "right behind the answer");
  await page.waitForFunction(() => seen.at(-1) === false, null, { timeout: PATIENCE });
  const reports = await page.evaluate(() => {
    globalThis.reports = 0;
    oxmill.app.machine.onchange(() => reports++);
    return reports;
  });
  await page.waitForFunction(from => reports >= from + 8, reports, { timeout: PATIENCE });
  assert.deepEqual(await page.evaluate(() => seen), [true, false]);
  assert.deepEqual(faults, []);
}

/** If the machine falls silent, its buttons are disabled and do not report their release. The jog must end
 * nevertheless. */
export async function a_held_jog_ends_when_its_button_is_switched_off(browser) {
  const { page, faults } = await withMachine(browser);
  const jogs = async () => (await lines(page)).filter(line => line.startsWith("$J")).length;
  await page.click("#steps .hold-step");
  await page.getByRole("button", { name: "jog X to plus", exact: true }).hover();
  await page.mouse.down();
  await page.waitForFunction(() => fake.lines.some(line => line.startsWith("$J")));
  await page.evaluate(() => (fake.answers = false));
  await page.waitForFunction(() => fake.commands.some(({ byte }) => byte === 0x85), null, { timeout: PATIENCE });
  assert.match(await page.evaluate(() => oxmill.app.machine.phase), /silent|lost/);
  // When the machine answers again, no button counts as held.
  const before = await jogs();
  await page.mouse.up();
  await page.evaluate(() => ([fake.answers, fake.at] = [true, [0, -20, -5]]));
  await idle(page);
  await page.waitForFunction(() => !document.querySelector("#pads button").disabled);
  assert.equal(await jogs(), before);
  assert.deepEqual(faults, []);
}

/** Keys that move or zero the machine ask first. Keys that are typed into a field do not act on the machine. */
export async function keys_drive_the_machine(browser) {
  const { page, faults } = await withMachine(browser);
  await openJob(page, "pocket_mm.nc", example("pocket_mm.nc"));
  await page.evaluate(() => document.activeElement.blur());
  const yes = async () => {
    await page.waitForFunction(() => !document.getElementById("ask").hidden);
    for (let i = 0; i < 5 && (await page.evaluate(() => document.activeElement.textContent)) !== "Yes"; i++) await page.keyboard.press("Tab");
    await page.keyboard.press("Enter");
    await page.waitForFunction(() => document.getElementById("ask").hidden);
  };
  await page.keyboard.press("z");
  assert.deepEqual(await lines(page), [], "asks first");
  await yes();
  await page.keyboard.press("h");
  await yes();
  await page.waitForFunction(() => fake.lines.includes("$H"));
  assert.deepEqual(await lines(page), ["G10 L20 P1 X0 Y0", "$H"]);
  // In a field, keys are text; while a dialog is open, keys do not reach the machine.
  await page.keyboard.press("/");
  for (const key of ["z", "h", "[", " "]) await page.keyboard.press(key);
  assert.equal(await page.inputValue("#command"), "zh[ ");
  assert(await page.locator("#ask").isHidden());
  await page.evaluate(() => document.activeElement.blur());
  assert.deepEqual(await commands(page), []);
  // Enter on the button starts the job; Space holds and resumes it; Esc stops it.
  await page.waitForFunction(() => !document.getElementById("start").disabled, null, { timeout: PATIENCE });
  await page.focus("#start");
  // Let the machine run from the first line on, and not earlier: Start is disabled while it runs.
  await page.evaluate(() => (fake.online = line => (line.startsWith("$") || (fake.state = "Run"), "ok")));
  await page.keyboard.press("Enter");
  await page.waitForFunction(() => oxmill.app.machine.phase === "run" && oxmill.app.machine.running);
  await page.keyboard.press(" ");
  await page.evaluate(() => (fake.state = "Hold:0"));
  await page.waitForFunction(() => oxmill.app.machine.phase === "hold");
  await page.keyboard.press(" ");
  await page.keyboard.press("[");
  await page.keyboard.press("]");
  assert.deepEqual(await commands(page), [0x21, 0x7e, 0x92, 0x91]);
  await page.evaluate(() => (fake.oncommand = byte => byte === 0x18 && (fake.state = "Idle", fake.say("Grbl 1.1h ['$' for help]"))));
  await page.keyboard.press("Escape");
  await page.waitForFunction(() => oxmill.app.machine.phase === "idle" && oxmill.app.machine.stopped);
  assert.deepEqual((await commands(page)).slice(4), [0x21, 0x18]);
  assert.deepEqual(faults, []);
}
