// The machine: simulated in the page, and behind a serial port at which the firmware on this host answers.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import net from "node:net";
import { join } from "node:path";
import { open, openJob, PATIENCE, tab } from "./browser.mjs";
import { site } from "./imagesite.mjs";
import { example, MILL, page as file, root, run, serve } from "./program.mjs";

const state = (page, wanted) => page.waitForFunction(wanted => new RegExp(wanted).test(oxmill.app.machine.status?.state ?? ""), wanted, { timeout: PATIENCE });
const place = page => page.evaluate(() => oxmill.app.machine.status.machine);
const near = (a, b) => assert(a.every((v, i) => Math.abs(v - b[i]) < 0.011), `${a} and ${b}`);
/** Waits until all lines are answered and the machine has reported that it is idle. Then another job can start. */
const jobDone = page => page.waitForFunction(() => oxmill.app.machine.finished && oxmill.app.machine.isAtRest, null, { timeout: PATIENCE });
/** Enables the host timeout of the machine. The button moves until the findings above it are complete, so wait for
 * them. */
const watch = async page => {
  await page.waitForFunction(() => oxmill.app.machine.isAtRest && !document.querySelector(".checks .wait"), null, { timeout: PATIENCE });
  await page.click("#watch");
  await page.waitForFunction(() => document.getElementById("silent").hidden);
};
/** Confirms all questions, such as that the machine is not homed, and starts the open job. */
const start = async page => {
  await allowed(page);
  await page.click("#start");
};
const times = async (page, value) => {
  await page.click("#pill");
  await page.selectOption("#times", value);
  await page.click("#pill");
};
const probe = async page => {
  await page.click("#open-probe");
  await page.click("#probe");
};
const allowed = async page => {
  await page.waitForFunction(() => oxmill.app.machine.isAtRest && (!document.getElementById("start").disabled || document.querySelector("#start-why button")), null, { timeout: PATIENCE });
  const agree = page.locator("#start-why button");
  if (await agree.count()) await agree.click();
};

async function powered(browser) {
  const opened = await open(browser, file);
  const { page } = opened;
  await page.evaluate(values => oxmill.app.settings.replace(values), MILL);
  await tab(page, "run");
  await page.click("#power");
  await state(page, "^Idle");
  return opened;
}

export async function a_machine_in_the_page_does_the_job(browser) {
  const { page, faults } = await powered(browser);
  const text = example("house.nc");
  const found = await openJob(page, "house.nc", text);
  assert(await page.evaluate(() => oxmill.app.machine.sender.room) >= 255, "the buffer is told by $I");
  await times(page, "100");
  await start(page);
  await state(page, "^Run");
  await jobDone(page);
  near(await place(page), found.position_mm);
  // The clock shows the end of the job. The last report in motion may be earlier.
  const clocks = await page.evaluate(() => ["clock", "clock-end"].map(id => document.getElementById(id).textContent));
  assert.equal(`of ${clocks[0]}`, clocks[1]);
  assert.equal(await page.locator("#console .wrong").count(), 0);
  assert.deepEqual(faults, []);
}

export async function a_job_that_is_started_twice_runs_once(browser) {
  const { page, faults } = await powered(browser);
  await openJob(page, "short.nc", "G21 G91\nG1 X3 F300\n");
  await allowed(page);
  const press = () => page.evaluate(() => {
    const start = document.getElementById("start");
    start.click();
    start.disabled = false;
    start.click();
    start.disabled = true;
  });
  await press();
  // All lines are answered immediately, but the machine still moves for 0.6 s: a second start must do nothing.
  await state(page, "^Run");
  await press();
  await jobDone(page);
  near(await place(page), [3, 0, 0]);
  assert.deepEqual(faults, []);
}

export async function hold_resume_overrides_and_reset_act(browser) {
  const { page, faults } = await powered(browser);
  await openJob(page, "long.nc", "G21 G91\nG1 X200 F300\nG1 X-200\n");
  await start(page);
  await state(page, "^Run");
  for (const [index, name, percent] of [[0, "feedMinus", 90], [1, "rapid25", 25], [2, "spindlePlus", 110], [2, "spindle100", 100], [0, "feed100", 100]]) {
    await page.click(`[data-realtime=${name}]`);
    await page.waitForFunction(([index, text]) => document.getElementById(`override-${index}`).textContent === text, [index, `${percent} %`]);
  }
  await page.click("[data-realtime=hold]");
  await state(page, "^Hold:0");
  const held = await place(page);
  await page.waitForTimeout(300);
  near(await place(page), held);
  await page.click("[data-realtime=resume]");
  await state(page, "^Run");
  // The machine brakes before the reset: its position stays valid, and it need not be unlocked.
  await page.click("#stop");
  await state(page, "^Idle");
  assert.equal(await page.evaluate(() => oxmill.app.machine.sender.lines.length), 0);
  assert.deepEqual(faults, []);
}

/** The page does not support checked lines. So it does not send `$LC=ON`, neither from the console nor from a job. It
 * also sends no character that would be changed on its way. */
export async function lines_that_the_page_cannot_send_are_refused_before_the_job(browser) {
  const { page, faults } = await powered(browser);
  const wrong = () => page.locator("#console .wrong").allInnerTexts();
  await page.click("#tab-log");
  for (const typed of ["$LC=ON", "$LC=ONQKNP", " $lc = on ; as the other sender does"]) {
    await page.fill("#command", typed);
    await page.press("#command", "Enter");
  }
  await page.waitForFunction(() => document.querySelectorAll("#console .wrong").length === 3);
  for (const answer of await wrong()) assert.match(answer, /^not sent: with checked lines each line has a number/);
  for (const [line, why] of [["$LC=ON", /with checked lines each line has a number/], ["G1 X\u22122 F600", /"\u2212" \(U\+2212\) has no place/]]) {
    await openJob(page, "refused.nc", `G21 G91\n${line}\nG1 X2 F600\n`);
    // Call `start` directly, because the button does not start a job that the firmware rejects.
    const start = () => page.evaluate(() => {
      try {
        oxmill.app.machine.start(oxmill.app.job, oxmill.app.checked);
      } catch (error) {
        return error.message;
      }
    });
    await page.waitForFunction(() => oxmill.app.machine.isAtRest && oxmill.app.machine.sender.free);
    assert.match(await start(), why);
    assert.match(await start(), /^line 2: /, "for the same again");
    assert.equal(await page.evaluate(() => oxmill.app.machine.sender.lines.length), 0);
  }
  assert.equal(await page.evaluate(() => oxmill.app.machine.line("$LC=OFF")), "ok");
  assert.deepEqual(faults, []);
}

export async function jogs_last_as_long_as_the_button_is_held(browser) {
  const { page, faults } = await powered(browser);
  const from = await place(page);
  await page.click("#steps .hold-step");
  const button = await page.getByRole("button", { name: "jog X to plus", exact: true }).boundingBox();
  await page.mouse.move(button.x + 10, button.y + 10);
  await page.mouse.down();
  await state(page, "^Jog");
  await page.waitForFunction(from => oxmill.app.machine.status.machine[0] > from + 2, from[0]);
  await page.mouse.up();
  await state(page, "^Idle");
  const to = await place(page);
  await page.waitForTimeout(500);
  near(await place(page), to);
  assert.equal(await page.locator("#console .wrong").count(), 0);
  assert.deepEqual(faults, []);
}

export async function a_jog_ends_however_the_button_is_left(browser) {
  const { page, faults } = await powered(browser);
  await page.click("#tab-log");
  await page.click("#steps .hold-step");
  const button = page.getByRole("button", { name: "jog Y to minus", exact: true });
  // Type a feed that the axis cannot reach. The jogs must use the axis' maximum rate, and the number of jogs sent ahead
  // must not grow.
  await page.evaluate(() => oxmill.app.machine.line("$111=600"));
  await page.fill("#jog-feed", "60000");
  const key = name => [() => page.keyboard.down(name), () => page.keyboard.up(name)];
  const pointer = (type, more = {}) => () => button.dispatchEvent(type, { pointerId: 1, button: 0, bubbles: true, ...more });
  const leavings = [key("Enter"), key(" "), [key("Enter")[0], () => page.evaluate(() => dispatchEvent(new Event("blur")))], [key(" ")[0], () => page.focus("#command")]];
  for (const [begin, end] of leavings) {
    await button.focus();
    const from = (await place(page))[1];
    await begin();
    await page.waitForFunction(from => oxmill.app.machine.status.machine[1] < from - 1, from);
    await end();
    const left = (await place(page))[1];
    await state(page, "^Idle");
    const to = await place(page);
    // `left` is up to one report interval old. After it, the axis may move for this interval, and then by the jogs
    // that were sent ahead.
    assert(left - to[1] < 10, `${left} to ${to[1]}`);
    await page.waitForTimeout(300);
    near(await place(page), to);
    await page.keyboard.up("Enter");
    await page.keyboard.up(" ");
  }
  // Another mouse button does not jog.
  await page.evaluate(() => (Element.prototype.setPointerCapture = () => {}));
  const at = await place(page);
  await pointer("pointerdown", { button: 2 })();
  await page.waitForTimeout(300);
  near(await place(page), at);
  await pointer("pointerdown")();
  await state(page, "^Jog");
  await pointer("pointercancel")();
  await state(page, "^Idle");
  assert.equal(await page.locator("#console .wrong").count(), 0);
  assert.deepEqual(faults, []);
}

export async function positions_are_in_millimetres_whatever_the_machine_reports_in(browser) {
  const { page, faults } = await powered(browser);
  await times(page, "10");
  const line = text => page.evaluate(text => oxmill.app.machine.line(text), text);
  await line("G21 G91 G0 X-5 Y3");
  await page.waitForFunction(() => document.getElementById("at-0").textContent === "\u22125.000");
  await page.click("#dro [aria-label*='work zero of Y']");
  await page.waitForFunction(() => document.getElementById("work-1").value === "0.000");
  await line("$13=1");
  await line("G4 P0.5");
  // Inches are reported with four decimals: 0.0001 inch is 0.0025 mm.
  near(await place(page), [-5, 3, 0]);
  near(await page.evaluate(() => oxmill.app.machine.status.work), [-5, 0, 0]);
  assert.deepEqual(faults, []);
}

export async function a_probe_that_finds_nothing_changes_no_zero_and_no_mode(browser) {
  const { page, faults } = await powered(browser);
  await times(page, "10");
  const line = text => page.evaluate(text => oxmill.app.machine.line(text), text);
  await line("G21 G90 G0 Z15");
  await line("G20");
  const note = wanted => page.waitForFunction(wanted => new RegExp(wanted).test(document.getElementById("machine-note").textContent), wanted, { timeout: PATIENCE });
  await probe(page);
  await note("No contact within 25 mm");
  await state(page, "^Idle");
  const modes = (await page.evaluate(() => oxmill.app.machine.sender.ask("$G"))).said.join();
  assert.match(modes, /G20 G90/);
  near(await page.evaluate(() => oxmill.app.machine.status.work), [0, 0, -10]);
  // A probe that is already in contact would cause an alarm.
  await line("G21 G38.2 Z-20 F300");
  await state(page, "^Idle");
  await page.waitForFunction(() => oxmill.app.machine.status.fields.Pn?.includes("P"));
  await page.click("#open-probe");
  await page.waitForFunction(() => document.getElementById("probe").disabled);
  assert.equal(await page.getAttribute("#probe", "title"), "The probe is in contact already.");
  assert.equal(await page.locator("#console .wrong").count(), 0);
  assert.deepEqual(faults, []);
}

export async function the_console_takes_realtime_commands(browser) {
  const { page, faults } = await powered(browser);
  await page.click("#tab-log");
  const type = async text => {
    await page.fill("#command", text);
    await page.press("#command", "Enter");
  };
  await page.evaluate(() => oxmill.app.settings.replace({ ...oxmill.app.settings.values(), 120: 321 }));
  await type("G91 G1 X19 F100");
  await state(page, "^Run");
  // In motion, a machine does not list its settings, so the settings of the forecast stay.
  await tab(page, "settings");
  await page.click("#read");
  await page.waitForFunction(() => /does not tell its settings/.test(document.getElementById("settings-note").textContent));
  await tab(page, "run");
  assert.equal(await page.evaluate(() => oxmill.app.settings.value(120)), 321);
  await type("!");
  await state(page, "^Hold");
  await type("~");
  await state(page, "^Run");
  await times(page, "10");
  await state(page, "^Idle");
  await tab(page, "settings");
  await page.click("#read");
  await page.waitForFunction(() => oxmill.app.settings.value(120) !== 321);
  assert.equal(await page.locator("#console .wrong").count(), 0);
  assert.deepEqual(faults, []);
}

export async function homing_and_probing_find_switch_and_plate(browser) {
  const { page, faults } = await powered(browser);
  await times(page, "10");
  await probe(page);
  await page.waitForFunction(() => [...document.querySelectorAll("#console div")].some(line => /^G10 L20 P0 Z1[12]/.test(line.textContent)), null, { timeout: PATIENCE });
  await state(page, "^Idle");
  await page.waitForFunction(() => Math.abs(oxmill.app.machine.status.work[2] - 12) < 0.01, null, { timeout: PATIENCE });
  await page.click("#home");
  await state(page, "^Home");
  await state(page, "^Idle");
  near(await place(page), [-1, -1, -1]);
  // The forecast adopts the settings that the machine reports.
  await page.evaluate(() => oxmill.app.machine.line("$120=777"));
  await tab(page, "settings");
  await page.click("#read");
  await page.waitForFunction(() => oxmill.app.settings.value(120) === 777);
  assert.deepEqual(faults, []);
}

/** Simulates a serial port in the browser, connected to a TCP port. */
async function fakeSerial(page, port) {
  const socket = net.connect(port, "127.0.0.1");
  // `lengths`: the bytes of each line that was sent and is not answered yet. These lines fill the board's receive
  // buffer. Realtime commands need no space in it.
  const wire = (socket.wire = { lengths: [], most: 0, realtime: [], said: "" });
  socket.on("data", data => {
    const lines = (wire.said + data).split("\n");
    wire.said = lines.pop();
    for (const line of lines) if (/^(ok|error:)/.test(line)) wire.lengths.shift();
  });
  await page.exposeFunction("__write", bytes => {
    if (bytes.length === 1 && bytes[0] !== 10) wire.realtime.push(bytes[0]);
    else wire.lengths.push(bytes.length);
    wire.most = Math.max(wire.most, wire.lengths.reduce((a, b) => a + b, 0));
    socket.write(Buffer.from(bytes));
  });
  await page.exposeFunction("__listen", () => {
    // A reopened port receives only bytes that arrive after it was reopened.
    socket.off("data", wire.hear ?? (() => {}));
    // A transfer to the page takes time on a busy computer. Bytes that arrive meanwhile are sent with the next
    // transfer.
    const heard = [];
    let telling = false;
    wire.hear = async data => {
      heard.push(...data);
      if (telling) return;
      for (telling = true; heard.length; ) await page.evaluate(bytes => __said(bytes), heard.splice(0)).catch(() => {});
      telling = false;
    };
    socket.on("data", wire.hear);
    wire.lengths.length = 0;
  });
  await page.addInitScript(() => {
    const made = { opened: undefined, closed: false };
    globalThis.__port = made;
    const port = {
      async open(options) {
        [made.opened, made.closed] = [options, false];
        this.readable = new ReadableStream({ start(to) {
          globalThis.__said = bytes => to.enqueue(new Uint8Array(bytes));
          globalThis.__unplug = (why = "NetworkError") => to.error(new DOMException("The device has been lost.", why));
        } });
        // A write does not wait for the other side: a serial port has a buffer of its own.
        this.writable = new WritableStream({ write: bytes => void __write([...bytes]) });
        await __listen();
      },
      async close() { made.closed = true; },
    };
    Object.defineProperty(navigator, "serial", { configurable: true, get: () => ({ requestPort: async () => port }) });
  });
  return socket;
}

/** Opens a page with a board at a serial port: the firmware on this host, at the given speed. */
async function connected(browser, speed, test, place = file) {
  const order = { board: "blackpill_f411", settings: MILL };
  const device = await serve(order, speed);
  let socket;
  const { page, faults } = await open(browser, place, { prepare: async page => (socket = await fakeSerial(page, device.port)) });
  try {
    await tab(page, "run");
    await page.click("#connect");
    await state(page, "^Idle");
    await test(page, order, socket.wire, socket);
    assert.deepEqual(faults, []);
  } finally {
    socket.destroy();
    device.stop();
  }
}

export async function a_board_at_a_serial_port_does_the_job(browser) {
  await connected(browser, "max", async (page, order, wire) => {
    assert.equal(await page.evaluate(() => __port.opened.baudRate), 115200);
    const text = example("pocket_mm.nc");
    await openJob(page, "pocket_mm.nc", text);
    await start(page);
    await jobDone(page);
    near(await place(page), run("pocket_mm.nc", text, order).position_mm);
    assert(wire.most <= 255, `${wire.most} bytes were under way`);
    // A rejected line during a job is named, and the job ends in a hold. The firmware rejects M62 here, because this
    // board has no such output. The board of the forecast has one.
    await openJob(page, "bad.nc", `G21 G91\nG1 X2 F600\nM62 P0\n${"G1 X2\n".repeat(200)}`);
    await start(page);
    await page.waitForFunction(() => [...document.querySelectorAll("#console .wrong")].some(line => line.textContent === "line 3: error:133"));
    await state(page, "^Hold");
    assert.match(await page.locator("#machine-note").innerText(), /The job has ended: line 3 was refused .*press Stop to drop the lines it has received/);
    const sent = await page.evaluate(() => oxmill.app.machine.sender.lines.length);
    assert(sent < 203, `${sent} lines were sent`);
    assert(await page.locator("#start").isDisabled());
    await page.click("#stop");
    await page.waitForFunction(() => /^(Idle|Alarm)/.test(oxmill.app.machine.status.state));
  });
}

export async function a_connected_board_is_sent_into_its_boot_loader(browser) {
  await connected(browser, "max", async page => {
    await page.click("#open-firmware");
    const restart = page.locator("text=Start the boot loader of the connected board");
    await restart.click();
    const says = text => page.waitForFunction(text => document.getElementById("firmware-note").textContent.startsWith(text), text);
    // The firmware on this host answers `error:3`, because it has no boot loader.
    await says("The board stays as it is: ");
    await page.evaluate(() => (oxmill.app.machine.line = async line => (line === "$DFU" ? "ok" : "error:20")));
    await restart.click();
    await says("The board is in its boot loader now");
  });
}

/** The connected board reports its name: the page chooses the image of this board, and warns of another image. */
export async function firmware_for_another_board_is_named(browser) {
  const { url, stop } = await site();
  try {
    await connected(browser, "max", async page => {
      const says = wanted => page.waitForFunction(wanted => RegExp(wanted).test(document.getElementById("firmware-note").textContent), wanted);
      await page.waitForFunction(() => oxmill.app.machine.boardName === "blackpill_f411");
      await page.click("#open-firmware");
      await says("^Oxmill for blackpill_f411, \\d+ KiB\\.$");
      assert.equal(await page.inputValue("#firmware-board"), "blackpill_f411");
      assert.equal(await page.textContent("#firmware-connected"), "The board that is connected: blackpill_f411.");
      // Other pins in the image of the connected board cause no warning. The image of another board does.
      const mine = readFileSync(join(root, "boards/tables/blackpill_f411.toml"), "utf8").replace('"blackpill_f411"', '"my_mill"');
      await page.setInputFiles("#firmware-pins", { name: "mine.toml", mimeType: "text/plain", buffer: Buffer.from(mine) });
      await says("With the pins of my_mill\\.$");
      const [download] = await Promise.all([page.waitForEvent("download"), page.click("text=Save this image")]);
      await page.click("text=Use the board's own pins");
      await page.setInputFiles("#firmware-file", await download.path());
      await says("With the pins of my_mill\\. The board that was connected calls itself blackpill_f411\\. On the wrong board, ");
      assert.equal(await page.locator("text=load it all the same…").count(), 1);
      assert.equal(await page.inputValue("#firmware-board"), "");
    }, url);
  } finally {
    stop();
  }
}

export async function a_board_is_reached_at_its_own_baud_rate(browser) {
  const order = { board: "nucleo_f446re", settings: MILL };
  const device = await serve(order, "max");
  let socket;
  const { page, faults } = await open(browser, file, { prepare: async page => (socket = await fakeSerial(page, device.port)) });
  try {
    await tab(page, "run");
    await page.selectOption("#baud", "1000000");
    await page.click("#connect");
    await state(page, "^Idle");
    assert.equal(await page.evaluate(() => __port.opened.baudRate), 1_000_000);
    assert(await page.locator("#baud").isHidden());
    assert.deepEqual(faults, []);
  } finally {
    socket.destroy();
    device.stop();
  }
}

export async function a_board_obeys_with_full_buffers_and_may_be_unplugged(browser) {
  await connected(browser, "1", async (page, order, wire) => {
    await openJob(page, "long.nc", `G21 G91\n${"G1 X0.5 F60\nG1 X-0.5\n".repeat(400)}`);
    await start(page);
    await state(page, "^Run");
    // The queue of blocks is full long before the job ends. Then the line buffer fills. The unanswered bytes never
    // exceed the size of this buffer.
    for (let waited = 0; wire.most <= 200 && waited < PATIENCE; waited += 10) await page.waitForTimeout(10);
    assert(wire.most <= 255 && wire.most > 200, `${wire.most} bytes were under way`);
    await page.click("[data-realtime=hold]");
    await state(page, "^Hold");
    assert(await page.evaluate(() => oxmill.app.machine.sender.busy), "the job is not done");
    await page.click("#stop");
    await state(page, "^Idle");
    assert.equal(await page.evaluate(() => oxmill.app.machine.sender.busy), false);
    // If the board is unplugged during a job, the page reports it and closes the port. A board can be connected again.
    await start(page);
    await state(page, "^Run");
    await page.evaluate(() => __unplug());
    await page.waitForFunction(() => /^Connection lost/.test(document.getElementById("machine-note").textContent) && __port.closed);
    await page.click("#connect");
    await state(page, "^(Run|Hold)");
    await page.click("#stop");
    await state(page, "^(Idle|Alarm)");
    assert.equal(await page.evaluate(() => oxmill.app.machine.sender.busy), false);
  });
}

export async function buttons_send_their_realtime_commands(browser) {
  await connected(browser, "1", async (page, order, wire) => {
    const bytes = { feedMinus: 0x92, feedMinus1: 0x94, feed100: 0x90, feedPlus1: 0x93, feedPlus: 0x91, rapid25: 0x97, rapid50: 0x96, rapid100: 0x95,
      spindleMinus: 0x9b, spindleMinus1: 0x9d, spindle100: 0x99, spindlePlus1: 0x9c, spindlePlus: 0x9a, hold: 0x21, resume: 0x7e };
    const names = await page.locator("[data-realtime]").evaluateAll(buttons => buttons.map(button => button.dataset.realtime));
    assert.deepEqual(names.toSorted(), Object.keys(bytes).toSorted());
    const commands = () => wire.realtime.filter(byte => byte !== 0x3f);
    const sends = async name => {
      const before = commands().length;
      await page.click(`[data-realtime=${name}]`);
      for (let waited = 0; commands().length === before && waited < PATIENCE; waited += 5) await page.waitForTimeout(5);
      assert.deepEqual(commands().slice(before), [bytes[name]], name);
    };
    for (const name of names.filter(name => !["hold", "resume"].includes(name))) await sends(name);
    await openJob(page, "long.nc", "G21 G91\nG1 X50 F60\n");
    await start(page);
    await state(page, "^Run");
    await sends("hold");
    await state(page, "^Hold:0");
    await sends("resume");
    await state(page, "^Run");
    await page.click("#stop");
    await state(page, "^Idle");
    await page.click("#steps .hold-step");
    const button = await page.getByRole("button", { name: "jog X to plus", exact: true }).boundingBox();
    await page.mouse.move(button.x + 5, button.y + 5);
    await page.mouse.down();
    await state(page, "^Jog");
    await page.mouse.up();
    // The machine can be idle for a moment between two short jogs. So wait for the jog cancel.
    for (let waited = 0; !wire.realtime.includes(0x85) && waited < PATIENCE; waited += 5) await page.waitForTimeout(5);
    assert(wire.realtime.includes(0x85), "a jog cancel");
    await state(page, "^Idle");
  });
}

export async function a_board_that_is_left_in_motion_is_held(browser) {
  await connected(browser, "1", async (page, order, wire) => {
    // On a UART, the machine can monitor its host by a timeout; enable this.
    await watch(page);
    const settings = (await page.evaluate(() => oxmill.app.machine.sender.ask("$$"))).said.join("\n");
    assert.match(settings, /^\$922=2(\.0*)?$/m);
    assert.match(settings, /^\$923=0\.50*$/m);
    await openJob(page, "long.nc", "G21 G91\nG1 X50 F60\n");
    await start(page);
    await state(page, "^Run");
    await page.click("#pill");
    await page.click("#leave");
    await page.waitForFunction(() => __port.closed);
    assert.equal(wire.realtime.at(-1), 0x21);
    assert.match(await page.locator("#machine-note").innerText(), /is held/);
    await page.click("#connect");
    await state(page, "^Hold");
    assert(await page.locator("#silent").isHidden());
  });
}

/** The browser reports a damaged byte and stops reading, but bytes still reach the machine. */
export async function a_board_that_cannot_be_heard_any_more_is_held(browser) {
  await connected(browser, "1", async (page, order, wire) => {
    await openJob(page, "long.nc", "G21 G91\nG1 X50 F60\n");
    await start(page);
    await state(page, "^Run");
    await page.evaluate(() => __unplug("FramingError"));
    await page.waitForFunction(() => __port.closed);
    assert.equal(wire.realtime.at(-1), 0x21);
    assert.match(await page.locator("#machine-note").innerText(), /Connection lost in motion \(a hold was sent; check that it stops\): FramingError/);
    await page.click("#connect");
    await state(page, "^Hold");
  });
}

export async function a_machine_that_is_left_while_it_homes_is_not_said_to_be_held(browser) {
  const { page, faults } = await powered(browser);
  await page.click("#home");
  await state(page, "^Home");
  await page.click("#pill");
    await page.click("#leave");
  assert.equal(await page.locator("#machine-note").innerText(), "Disconnected. The machine is homing, and goes on with it.");
  assert.deepEqual(faults, []);
}

export async function a_page_that_goes_leaves_the_machine_in_a_hold(browser) {
  await connected(browser, "1", async (page, order, wire) => {
    await openJob(page, "long.nc", "G21 G91\nG1 X50 F60\n");
    await start(page);
    await state(page, "^Run");
    // Send the events that a page gets when it is closed. In a real closing, it depends on the browser whether the
    // last byte is still sent.
    assert(await page.evaluate(() => !dispatchEvent(new Event("beforeunload", { cancelable: true }))), "the user is asked");
    await page.evaluate(() => dispatchEvent(new Event("pagehide")));
    await state(page, "^Hold");
    assert(wire.realtime.includes(0x21));
  });
}

/** Ends the process of a page, as a browser fault or a lack of memory would: no code of the page runs any more. */
async function crash(page) {
  const gone = new Promise(resolve => page.once("crash", resolve));
  const browser = await page.context().newCDPSession(page);
  void browser.send("Page.crash").catch(() => {});
  await gone;
}

/** On a UART, only the machine's host timeout notices the crash. */
export async function a_tab_that_crashes_leaves_a_board_that_watches_in_a_hold(browser) {
  await connected(browser, "1", async (page, order, wire, socket) => {
    await watch(page);
    await openJob(page, "long.nc", "G21 G91\nG1 X100 F60\n");
    await start(page);
    await state(page, "^Run");
    const commands = wire.realtime.length;
    await crash(page);
    let said = "";
    socket.on("data", data => (said += data));
    // Wait before each `?`: every byte restarts the host timeout, and the machine holds only after this timeout.
    for (let tries = 0; !/<Hold:0/.test(said) && tries < 30; tries++) {
      await new Promise(resolve => setTimeout(resolve, 2500));
      socket.write("?");
      await new Promise(resolve => setTimeout(resolve, 300));
    }
    assert.match(said, /\[MSG:The host is silent\]/);
    assert.match(said, /<Hold:0\|MPos:\d\.|<Hold:0\|MPos:\d\d\./);
    assert(!wire.realtime.slice(commands).includes(0x21), "the page has sent no hold");
  });
}

export async function settings_go_to_the_machine_when_they_have_been_looked_at(browser) {
  await connected(browser, "max", async (page, order) => {
    await tab(page, "settings");
    const note = wanted => page.waitForFunction(wanted => new RegExp(wanted).test(document.getElementById("settings-note").textContent), wanted, { timeout: PATIENCE });
    const there = async () => (await page.evaluate(() => oxmill.app.machine.sender.ask("$$"))).said.join("\n");
    await page.click("#read");
    await page.waitForFunction(() => oxmill.app.settings.value(110) === 5000);
    await page.click("#compare");
    await note("has all of these settings already");
    assert(await page.locator("#differences").isHidden());
    await page.evaluate(() => oxmill.app.settings.replace({ ...oxmill.app.settings.values(), 11: 0.0125, 20: 1, 22: 1, 120: 321.5 }));
    await page.click("#compare");
    const rows = page.locator("#differences tbody tr");
    await rows.first().waitFor();
    const shown = await rows.evaluateAll(all => all.map(row => [...row.cells].map(cell => cell.textContent)));
    assert.deepEqual(shown.map(([name, machine, forecast]) => [name.split(" ").at(-1), machine, forecast]),
      [["$11", "0.01 mm", "0.0125 mm"], ["$20", "0", "1"], ["$22", "0", "1"], ["$120", "300 mm/s2", "321.5 mm/s2"]]);
    for (const [name] of shown) assert.match(name, /^[A-Z][a-z-]/);
    assert.match(await there(), /^\$120=300\.000$/m, "nothing is written before");
    await page.click("#write");
    await note("^4 of 4 settings are written");
    for (const row of [/^\$11=0\.013$/m, /^\$20=1$/m, /^\$22=1$/m, /^\$120=321\.500$/m]) assert.match(await there(), row);
    assert(await page.locator("#differences").isHidden());
    await page.click("#compare");
    await note("has all of these settings already");
    // A setting that the machine rejects is named, and unchanged settings are not written.
    await page.evaluate(() => oxmill.app.settings.set(0, 256));
    await page.click("#compare");
    await page.click("#write");
    await note("^0 of 1 settings are written. Refused: \\$0=256");
    await page.click("#compare");
    await page.click("#keep");
    assert(await page.locator("#differences").isHidden());
    assert.match(await there(), /^\$0=10(\.0+)?$/m);
    // A machine in Grbl's dialect has no message that tells its dialect. Its settings show it: it lists only those of
    // Grbl.
    await page.evaluate(() => oxmill.app.machine.line("$900=0"));
    await page.click("#read");
    await page.waitForFunction(() => oxmill.app.settings.value(900) === 0 && oxmill.app.settings.value(120) === 321.5);
    // In Grbl's dialect, soft limits ($20) are rejected with error:10 while homing ($22) is off. Settings are written
    // in the order of their numbers, so $20 fails at first.
    for (const value of [0, 1]) {
      await page.evaluate(value => oxmill.app.settings.replace({ ...oxmill.app.settings.values(), 20: value, 22: value }), value);
      await page.click("#compare");
      await page.click("#write");
      await note("^2 of 2 settings are written");
    }
    assert.deepEqual(await page.locator("#console .wrong").allInnerTexts(), ["error:6", "error:6", "error:10"]);
    assert.match(await there(), /^\$20=1$[^]*^\$22=1$/m);
  });
}

/** Tries to open a WebSocket with the headers of a browser. Returns the status of the answer. */
const upgrade = (port, headers) => new Promise((resolve, reject) => {
  const socket = net.connect(port, "127.0.0.1");
  const all = { Host: `127.0.0.1:${port}`, Origin: `http://127.0.0.1:${port}`, Connection: "Upgrade", Upgrade: "websocket",
    "Sec-WebSocket-Version": "13", "Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", ...headers };
  const lines = Object.entries(all).filter(([, value]) => value !== undefined).map(([name, value]) => `${name}: ${value}\r\n`);
  socket.once("data", data => {
    resolve(Number(String(data).split(" ")[1]));
    socket.destroy();
  });
  socket.once("error", reject);
  socket.write(`GET /machine HTTP/1.1\r\n${lines.join("")}\r\n`);
});

export async function a_served_page_drives_the_machine_and_no_other_does(browser) {
  const order = { board: "blackpill_f411", settings: MILL };
  const device = await serve(order, "max", ["--web", "0", "--page", file]);
  const url = `http://127.0.0.1:${device.port}/`;
  try {
    const { page, faults } = await open(browser, url);
    await tab(page, "run");
    await page.click("#served");
    await state(page, "^Idle");
    const text = example("pocket_mm.nc");
    await openJob(page, "pocket_mm.nc", text);
    await start(page);
    await jobDone(page);
    near(await place(page), run("pocket_mm.nc", text, order).position_mm);
    // A second page gets a message.
    const second = await open(browser, url);
    await tab(second.page, "run");
    await second.page.click("#served");
    await second.page.waitForFunction(() => document.getElementById("console").textContent.includes("Another host has the machine"));
    await page.click("#pill");
    await page.click("#leave");
    assert(await page.locator("#served").isVisible());
    assert.deepEqual([...faults, ...second.faults], []);
    // Requests from pages of other sites, or with other host names that resolve to this computer, are rejected.
    assert.equal(await upgrade(device.port, { Origin: "http://evil.example" }), 403);
    assert.equal(await upgrade(device.port, { Origin: "null" }), 403);
    assert.equal(await upgrade(device.port, { Origin: undefined }), 403);
    assert.equal(await upgrade(device.port, { Origin: `http://127.0.0.1:${device.port}.evil.example` }), 403);
    assert.equal(await upgrade(device.port, { Host: `evil.example:${device.port}`, Origin: `http://evil.example:${device.port}` }), 403);
    assert.equal(await upgrade(device.port, {}), 101);
    assert.equal((await fetch(`${url}nothing`)).status, 404);
  } finally {
    device.stop();
  }
}

/** The program that serves the page notices the crash, as the firmware does on USB. */
export async function a_tab_that_crashes_leaves_the_machine_in_a_hold(browser) {
  const device = await serve({ settings: MILL }, "1", ["--web", "0", "--page", file]);
  const url = `http://127.0.0.1:${device.port}/`;
  try {
    const first = await open(browser, url);
    await tab(first.page, "run");
    await first.page.click("#served");
    await state(first.page, "^Idle");
    await openJob(first.page, "long.nc", "G21 G91\nG1 X100 F60\n");
    await start(first.page);
    await state(first.page, "^Run");
    await crash(first.page);
    const { page, faults } = await open(browser, url);
    await tab(page, "run");
    await page.click("#served");
    await state(page, "^Hold:0");
    const held = await place(page);
    assert(held[0] > 0 && held[0] < 90, `${held}`);
    await page.waitForTimeout(500);
    near(await place(page), held);
    assert.deepEqual([...first.faults, ...faults], []);
  } finally {
    device.stop();
  }
}
