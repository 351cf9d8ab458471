// Check, forecast and picture, compared with the `oxmill` program of this host.
import assert from "node:assert/strict";
import { checked, isAt, open, openJob, tab } from "./browser.mjs";
import { BOARDS, example, examples, MILL, page as file, run, same, traced } from "./program.mjs";

/** Sets settings and waits for the check with them. */
async function settings(page, values) {
  await page.evaluate(values => {
    oxmill.app.settings.replace(values);
    oxmill.app.checked = undefined;
  }, values);
  return checked(page);
}

export async function every_example_is_as_in_the_program(browser) {
  const { page, faults } = await open(browser, file);
  for (const name of examples()) {
    for (const board of BOARDS) {
      const order = { board, settings: MILL };
      const found = await page.evaluate(([text, order]) => oxmill.check(text, order), [example(name), order]);
      same(found, run(name, example(name), order), `${name} on ${board}`);
    }
  }
  assert.deepEqual(faults, []);
}

/** Chooses a file and a board and types settings, like a user. */
export async function what_the_page_shows_is_what_the_program_says(browser) {
  const { page, faults } = await open(browser, file);
  const text = example("pcb_isolation.nc");
  await openJob(page, "pcb_isolation.nc", text);
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await tab(page, "settings");
  await page.selectOption("#board", "blackpill_f411");
  await checked(page);
  await tab(page, "settings");
  const typed = async (number, value) => {
    await page.evaluate(() => (oxmill.app.checked = undefined));
    await page.fill(`[aria-label^="$${number} "]`, String(value));
    await page.keyboard.press("Tab");
    return checked(page);
  };
  await typed(110, 6000);
  const found = await typed(120, 500);
  const expected = run("pcb_isolation.nc", text, { board: "blackpill_f411", settings: { 110: 6000, 120: 500 } });
  same(found, expected);
  // The page shows the same figures to the user.
  const whole = Math.round(expected.forecast_s);
  assert.equal(await page.textContent("#verdict-time"), `${Math.floor(whole / 60)} min ${whole % 60} s`);
  assert.match(await page.textContent("#verdict"), /^Ready to run.*All 1,745 lines are accepted\. Travel is not checked/);
  const facts = await page.locator("#facts").evaluate(list => Object.fromEntries([...list.querySelectorAll("dt")].map(name => [name.textContent, name.nextSibling.textContent])));
  assert.equal(facts.Time, `${expected.forecast_s} s`);
  assert.match(facts.Time, /^\d+\.\d{6,} s$/);
  assert.deepEqual([facts.Trace, facts.Lines], [expected.trace_hash, expected.lines.toLocaleString("en")]);
  const { min, max } = expected.extents_mm;
  for (const [axis, name] of ["X", "Y", "Z"].entries()) assert.equal(facts[`Machine ${name}, mm`], `${min[axis].toFixed(3)} to ${max[axis].toFixed(3)}`);
  // A value that the firmware rejects is named, and the job does not count as checked.
  await page.fill('[aria-label^="$0 "]', "256");
  await page.keyboard.press("Tab");
  await page.waitForFunction(() => document.getElementById("refused").textContent.includes("error:6"));
  assert(await page.evaluate(() => oxmill.app.checked === undefined));
  // The results of the previous check are gone, for this job and for a newly opened one.
  for (const id of ["facts", "kinds", "errors", "messages", "warnings", "bar", "clock"]) assert.equal(await page.textContent(`#${id}`), "", id);
  assert.equal(await colorsOn(page, "view"), 0);
  await page.setInputFiles("#file", { name: "other.nc", mimeType: "text/plain", buffer: Buffer.from("G0 X1\n") });
  await page.waitForFunction(() => document.getElementById("verdict").textContent.startsWith("Do not runNot checked"));
  assert.equal(await page.textContent("#facts"), "");
  assert.match(await page.textContent("#lines-all"), /1G0 X1/);
  assert.deepEqual(faults, []);
}

export async function refused_lines_are_listed_with_what_helps(browser) {
  const { page, faults } = await open(browser, file);
  const jobs = {
    "bad.nc": "G21 G90\nG0 X10\nG999\nG1 Y10\nG1 X20 F600 Q3\n(ok)\nG2 X30 Y30 I1 J1\n",
    "crlf.nc": "\uFEFFG21\r\nG0 X1\r\nbad\r\n\r\nG0 X2\rG0 Y1\r\n",
    "alarm.nc": "G21 F100\nG38.2 Z-1\nG0 X5\n",
    "remarks.nc": "(Äußere Kontur, wow!)\nG0 X1\n",
    "open.nc": "o100 sub\nG0 X1\n",
    "words.nc": "<script>alert(1)</script>\n&amp;\n",
  };
  for (const [name, text] of Object.entries(jobs)) {
    const found = await openJob(page, name, text);
    same(found, run(name, text), name);
    const shown = await page.locator("#errors button").allInnerTexts();
    const alike = found.errors.length > Math.max(10, found.lines / 2) ? 1 : 0;
    assert.equal(shown.length, found.errors.length + (found.alarm ? 1 : 0) + alike, name);
    const said = await page.locator("#warnings li").allInnerTexts();
    for (const { line, text } of found.warnings) assert(said.some(remark => remark.trim() === `Line ${line}: ${text}`), `${name}: ${said}`);
    assert.equal(found.warnings.length, name === "remarks.nc" ? 1 : 0, name);
    for (const [index, error] of found.errors.entries()) {
      for (const part of [`line ${error.line}`, `error:${error.code}`, error.text, error.advice]) assert(shown[index].toLowerCase().includes(part.toLowerCase()), `${name}: ${shown[index]}`);
    }
  }
  // The page accepts these files as text. The firmware's check rejects them.
  for (const [name, bytes, what] of [["control.nc", [0x47, 0x30, 1, 2, 3, 10], "a binary file"], ["blank.nc", [0xef, 0xbb, 0xbf, 32, 13, 10], "empty"]]) {
    await page.setInputFiles("#file", { name, mimeType: "text/plain", buffer: Buffer.from(bytes) });
    await page.waitForFunction(what => document.getElementById("verdict").textContent.includes(`Not checkedthe job is not read: it is ${what}`), what);
    assert(await page.locator("#to-run").isDisabled());
  }
  await openJob(page, "alarm.nc", jobs["alarm.nc"]);
  assert.match(await page.locator("#errors button").last().innerText(), /^Alarm 5: [^]*\nline 2\nG38\.2 Z-1\n/);
  assert(await page.locator("#to-run").isDisabled());
  assert.equal(await page.textContent("#to-run-why"), "Off: the job ends in alarm 5.");
  // The list begins with a remark that most lines are rejected. All errors but the first five are folded. Unfolded,
  // the list ends with the number of errors that the report leaves out.
  await openJob(page, "many.nc", "bad\n".repeat(1005));
  assert.match(await page.locator("#errors button").first().innerText(), /^This does not look like G-code/);
  assert.equal(await page.locator("#errors .more button").innerText(), "and 1,000 more");
  await page.locator("#errors .more button").click();
  assert.equal(await page.locator("#errors > li > button").count(), 1001);
  assert.equal(await page.locator("#errors li").last().innerText(), "and 5 more");
  await openJob(page, "bad.nc", jobs["bad.nc"]);
  await page.locator("#errors button").nth(2).click();
  assert.match(await page.locator("#lines [aria-selected=true]").innerText(), /G1 X20 F600 Q3/);
  assert.deepEqual(faults, []);
}

/** After homing, the firmware's soft limits accept a job that fits into the travel and stop one that does not. */
export async function soft_limits_act_on_a_homed_machine(browser) {
  const { page, faults } = await open(browser, file);
  const own = { ...MILL, 20: 1, 22: 1, 130: 60, 131: 50, 132: 40 };
  await settings(page, own);
  const text = "G21 G90 F600\nG0 X0 Y0 Z0\nG1 X10\nG0 X31\nG0 X5\n";
  assert.equal((await openJob(page, "limits.nc", text)).alarm, null);
  await tab(page, "settings");
  assert.match(await page.textContent("#work-zero-note"), /Not homed: soft limits/);
  const at = async (...place) => {
    for (const [axis, value] of place.entries()) {
      await page.fill(`[aria-label="Work zero ${"XYZ"[axis]}, machine mm"]`, String(value));
      await page.keyboard.press("Tab");
    }
    // A check may have started before all three values were typed, and ended meanwhile. So check again.
    await page.evaluate(() => void oxmill.app.check());
    const found = await checked(page);
    same(found, run("limits.nc", text, { settings: own, work_zero: place }));
    return found;
  };
  const inside = await at(-40, -20, -10);
  assert.deepEqual([inside.alarm, inside.position_mm], [null, [-35, -20, -10]]);
  const outside = await at(-30, -20, -10);
  assert.deepEqual([outside.alarm.code, outside.alarm.line], [2, 4]);
  assert.match(await page.textContent("#verdict"), /Do not run yetThe job ends in alarm 2/);
  assert.match(await page.locator("#errors button").innerText(), /^Alarm 2: [^]*line 4/);
  // The reason why homing is not possible is shown, and nothing counts as checked.
  await page.evaluate(() => oxmill.app.settings.set(22, 0));
  await page.waitForFunction(() => document.getElementById("verdict").textContent.includes("homing is needed ($22=1)"));
  await page.fill('[aria-label="Work zero Y, machine mm"]', "");
  await page.keyboard.press("Tab");
  assert.equal((await checked(page)).alarm, null);
  assert.match(await page.textContent("#work-zero-note"), /X, Y and Z are needed/);
  assert.deepEqual(faults, []);
}

export async function a_million_lines_are_checked_within_bounds(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, { ...MILL, 120: 1000, 121: 1000, 122: 1000 });
  const body = example("relief.nc").split("\n").filter(line => !/M30|M2|%/.test(line)).join("\n");
  const text = Array(17).fill(body).join("\n");
  const opened = openJob(page, "million.nc", text);
  // The path so far is visible long before the verdict.
  const early = await page.waitForFunction(() => oxmill.app.job.name === "million.nc" && (oxmill.app.checked ? "checked" : oxmill.app.player.picture.path.count > 1000 && "drawn"));
  assert.equal(await early.jsonValue(), "drawn");
  const found = await opened;
  assert(found.lines > 1_000_000 && found.complete && found.errors.length === 0, JSON.stringify(found).slice(0, 300));
  const { memory, rows } = await page.evaluate(() => ({ memory: oxmill.app.checked.memory, rows: oxmill.app.checked.path.lines.length }));
  assert(memory < 300 * 2 ** 20, `${memory} bytes`);
  assert(rows > 10_000 && rows <= 300_000, `${rows} rows`);
  // The list of lines is not taller than a browser draws, and still shows the last line.
  await page.evaluate(() => oxmill.app.player.goToLine(oxmill.app.job.lines.length));
  assert(await page.locator(`#line-${found.lines}`).isVisible());
  assert.deepEqual(faults, []);
}

/** If a job is checked while the picture is hidden, the view fits the job as soon as the picture becomes visible. */
export async function the_picture_fits_when_it_comes_into_sight(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "square.nc", "G21 G91 F6000\nG1 X50\nG1 Y50\nG1 X-50\nG1 Y-50\n");
  const middle = () => page.evaluate(() => {
    const { clientWidth, clientHeight } = document.getElementById("view");
    const [x, y] = oxmill.app.player.picture.place([25, 25, 0]);
    return [x / clientWidth, y / clientHeight];
  });
  const before = await middle();
  await tab(page, "settings");
  await settings(page, { ...MILL, 121: 55 });
  await tab(page, "run");
  await page.waitForFunction(() => Number.isFinite(oxmill.app.player.picture.place([25, 25, 0])[0]));
  for (const [axis, part] of (await middle()).entries()) assert(Math.abs(part - before[axis]) < 0.05, `${await middle()} and ${before}`);
  assert.deepEqual(faults, []);
}

export async function the_picture_is_where_the_machine_was(browser) {
  const { page, faults } = await open(browser, file);
  const order = { settings: MILL };
  await settings(page, MILL);
  const text = example("five_circles.nc");
  const found = await openJob(page, "five_circles.nc", text);
  const at = traced("five_circles.nc", text, order, 250);
  for (const part of [0.1, 0.33, 0.5, 0.77, 1]) {
    const seconds = part * found.forecast_s;
    const place = await page.evaluate(seconds => {
      oxmill.app.player.seek(seconds);
      return oxmill.placeAt(oxmill.app.checked.path, oxmill.app.player.time);
    }, seconds);
    const expected = at(seconds);
    for (let axis = 0; axis < 3; axis++) assert(Math.abs(place[axis] - expected[axis]) < 0.06, `${seconds} s: ${place} and ${expected}`);
  }
  // Line 29 cuts the circle: shortly after its start, the page still shows line 29.
  await page.evaluate(() => oxmill.app.player.goToLine(29));
  await isAt(page, 29);
  await page.evaluate(() => oxmill.app.player.seek(oxmill.app.player.time + 0.001));
  assert.equal(await page.evaluate(() => oxmill.app.player.line), 29);
  // Pixels of the path have colours of the scale. At an earlier time of the job, fewer pixels have them.
  const colored = () => colorsOn(page, "view");
  await page.evaluate(() => oxmill.app.player.seek(Infinity));
  const whole = await colored();
  await page.evaluate(() => oxmill.app.player.seek(oxmill.app.player.time / 3));
  const part = await colored();
  assert(whole > 300 && part > 20 && part < whole / 2, `${whole}, ${part}`);
  // A click on the path selects its line.
  await page.evaluate(() => {
    oxmill.app.player.picture.look(0, 1.5707);
    oxmill.app.player.goToLine(29);
  });
  await page.waitForTimeout(100);
  const row = await page.evaluate(() => {
    const { lines } = oxmill.app.checked.path;
    const rows = [...lines.keys()].filter(row => lines[row] % 2 ** 30 === 29);
    const { rows: all } = oxmill.app.checked.path;
    const middle = rows[Math.floor(rows.length / 2)];
    return oxmill.app.player.picture.place([0, 1, 2].map(axis => all[middle * 6 + axis]));
  });
  await page.evaluate(() => oxmill.app.player.seek(0));
  await page.locator("#view").click({ position: { x: row[0], y: row[1] } });
  assert.equal(await page.evaluate(() => oxmill.app.player.line), 29);
  assert.deepEqual(faults, []);
}

/** With "limits" checked, the edges of the travel are drawn. Without it, the view is as before. */
export async function the_limits_are_drawn_where_the_travel_ends(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, { ...MILL, 20: 1, 22: 1, 130: 60, 131: 50, 132: 40 });
  await openJob(page, "small.nc", "G21 G91\nG1 X-20 Y-20 Z-20 F600\n");
  // Wait until the view no longer changes: the picture is drawn again when its element gets its size.
  const view = () => page.evaluate(async () => {
    const now = () => JSON.stringify(oxmill.app.player.picture.camera);
    let before;
    do {
      before = now();
      for (let frame = 0; frame < 3; frame++) await new Promise(requestAnimationFrame);
    } while (now() !== before);
    return before;
  });
  const [without, colors] = [await view(), await colorsOn(page, "view")];
  await page.check("#limits");
  // Look at the middles of three edges below the grid. The grid itself is fainter.
  const edges = [];
  for (const place of [[-60, -50, -20], [0, -25, -40], [-30, 0, -40]]) edges.push(await inkAt(page, place));
  assert(edges.every(ink => ink > 60), `${edges}`);
  assert(await colorsOn(page, "view") > colors + 500);
  // The box of the limits is wider than the path: the view shows all of it.
  const corner = await page.evaluate(() => oxmill.app.player.picture.place([-60, -50, -40]));
  const size = await page.locator("#view").boundingBox();
  assert(corner[0] > 0 && corner[0] < size.width && corner[1] > 0 && corner[1] < size.height, `${corner}`);
  await page.uncheck("#limits");
  assert.equal(await view(), without);
  assert.equal(await colorsOn(page, "view"), colors);
  // With $932=1, machine zero is where homing ends. X then reaches from 0 to its travel minus the pull-off ($27).
  await settings(page, { ...MILL, 20: 1, 22: 1, 23: 1, 27: 2, 130: 60, 131: 50, 132: 40, 932: 1 });
  await openJob(page, "small.nc", "G21 G91\nG1 X20 Y-20 Z-20 F600\n");
  await page.check("#limits");
  await view();
  for (const place of [[58, -48, -20], [58, -24, -38], [29, 0, -38]]) assert(await inkAt(page, place) > 60, `${place}`);
  assert.deepEqual(faults, []);
}

/** If a setting needs a higher step rate than the board's, the job is rejected with the message of `oxmill run`. */
export async function a_setting_out_of_reach_is_named(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, { ...MILL, 110: 1e6 });
  const text = "G21 G90\nG1 X10 F600\n";
  const found = await openJob(page, "reach.nc", text);
  const expected = run("reach.nc", text, { settings: { ...MILL, 110: 1e6 } });
  same(found, expected);
  const why = "Motion is locked until you correct this setting: $110";
  assert(expected.messages.some(message => message.includes(why)), `${expected.messages}`);
  assert((await page.locator("#messages").innerText()).includes(why));
  assert.match(await page.locator("#errors button").first().innerText(), /error:9[^]*line 2/);
  // The message stands above the rejected lines. So a long list does not hide it.
  assert(await page.evaluate(() => document.getElementById("messages").compareDocumentPosition(document.getElementById("errors")) & Node.DOCUMENT_POSITION_FOLLOWING));
  await settings(page, MILL);
  assert.equal(await page.textContent("#messages"), "");
  assert.deepEqual(faults, []);
}

/** Returns the greatest difference in colour from the background, 0 to 255, of the pixels near a position in the first
 * view. */
const inkAt = (page, place) => page.evaluate(async place => {
  const canvas = document.getElementById("view");
  await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
  const gl = canvas.getContext("webgl2");
  const [x, y] = oxmill.app.player.picture.place(place).map(at => Math.round(at * devicePixelRatio));
  const [box, ground] = [new Uint8Array(7 * 7 * 4), new Uint8Array(4)];
  gl.readPixels(x - 3, canvas.height - y - 4, 7, 7, gl.RGBA, gl.UNSIGNED_BYTE, box);
  gl.readPixels(1, canvas.height - 2, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, ground);
  return Math.max(...box.map((value, at) => Math.abs(value - ground[at % 4])));
}, place);

export async function the_axes_are_at_work_zero(browser) {
  const { page, faults } = await open(browser, file);
  // From the front, the axis Z is the only line above the grid.
  await openJob(page, "offset.nc", "G21 G90 G10 L2 P1 X30 Y10 Z20\nG1 X-40 Y-5 Z-30 F6000\nG1 X40\n");
  await page.click("text=Front");
  await page.evaluate(() => oxmill.app.player.seek(0));
  const [there, apart] = [await inkAt(page, [30, 10, 30]), await inkAt(page, [0, 0, 30])];
  assert(there > 8 && apart === 0, `${there}, ${apart}`);
  assert.match(await page.textContent("#facts"), /Work zero at30.000, 10.000, 20.000/);
  assert.deepEqual(faults, []);
}

/** Returns the number of pixels on a canvas that have a colour of the scale. */
const colorsOn = (page, id) => page.evaluate(async id => {
  const canvas = document.getElementById(id);
  await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
  const gl = canvas.getContext("webgl2");
  const pixels = new Uint8Array(canvas.width * canvas.height * 4);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
  let count = 0;
  for (let i = 0; i < pixels.length; i += 4) count += Math.max(...pixels.subarray(i, i + 3)) - Math.min(...pixels.subarray(i, i + 3)) > 80 ? 1 : 0;
  return count;
}, id);

export async function two_views_show_one_time(browser) {
  const { page, faults } = await open(browser, file);
  await page.check("#two");
  await page.evaluate(() => oxmill.app.player.seek(Infinity));
  const whole = [await colorsOn(page, "view"), await colorsOn(page, "second")];
  await page.evaluate(() => oxmill.app.player.seek(oxmill.app.player.time / 4));
  const part = [await colorsOn(page, "view"), await colorsOn(page, "second")];
  for (const view of [0, 1]) assert(whole[view] > 200 && part[view] > 0 && part[view] < whole[view] / 2, `${whole}, ${part}`);
  await openJob(page, "line.nc", "G21 G91\nG1 X50 Y5 F600\n");
  assert(await colorsOn(page, "second") > 50);
  // Both views show the limits.
  const without = await colorsOn(page, "second");
  await page.check("#limits");
  assert(await colorsOn(page, "second") > without + 300);
  await page.uncheck("#two");
  assert(await page.locator("#second").isHidden());
  assert.deepEqual(faults, []);
}

/** The settings of each parameter in the list of the page, in its order, and the multiples of the present values that
 * are tried. The jerk is 0 at present: its values are absolute. */
const PARTS = [0.25, 0.5, 1, 2, 4, 8];
const VARIED = [
  { numbers: [120, 121], parts: PARTS }, { numbers: [122], parts: PARTS }, { numbers: [110, 111], parts: PARTS }, { numbers: [112], parts: PARTS },
  { numbers: [11], parts: PARTS }, { numbers: [917], parts: [0.5, 0.75, 1, 1.5, 2, 4] },
  { numbers: [220, 221], parts: [0, 2500, 5000, 10_000, 20_000, 40_000], absolute: true },
];

/** If a job has no forecast time, the table shows the reason. The message at the end of a program is not a reason. */
export async function a_job_without_a_time_has_a_reason_instead(browser) {
  const { page, faults } = await open(browser, file);
  const shown = async (text, settings = {}) => {
    await page.evaluate(settings => {
      oxmill.app.checked = undefined;
      oxmill.app.settings.replace(settings);
    }, settings);
    // Wait for this check: it could abort the forecast.
    await checked(page);
    await openJob(page, "without.nc", text);
    await page.click("#vary");
    await page.waitForFunction(() => document.getElementById("whatif-note").textContent.includes("whole jobs"));
    return page.locator("#whatif-table tbody tr .failed").allInnerTexts();
  };
  await tab(page, "whatif");
  assert.deepEqual(new Set(await shown("G21 G90\nG1 X1 F500\nG999\nM30\n")), new Set(["the job has errors"]));
  assert.deepEqual(new Set(await shown("M3 S1\nG38.2 Z-1 F100\nM30\n")), new Set(["the job ends in ALARM:5"]));
  assert.match((await shown("G1 X1 F500\nM30\n", { 100: 0 }))[0], /^\[MSG:Motion is locked/);
  assert.deepEqual(faults, []);
}

/** Varies each parameter. X and Y have different present values. Most values have more than three digits, so that
 * rounding would change them. */
export async function forecasts_are_those_of_single_runs(browser) {
  const { page, faults } = await open(browser, file);
  const text = "G21 G91 F1200\nG0 X9 Z2\nG1 X12 Y3\nG2 X8 Y8 J8\nG1 X-3 Z-4\nG1 Y7\nG0 X-20 Z2\n";
  const own = { ...MILL, 11: 0.0125, 110: 5001, 112: 1234.5, 120: 123.5, 121: 246.5, 122: 101.5, 917: 100 };
  await settings(page, own);
  await openJob(page, "varied.nc", text);
  await tab(page, "whatif");
  assert.equal(await page.locator("#parameter option").count(), VARIED.length);
  for (const [index, { numbers, parts, absolute }] of VARIED.entries()) {
    await page.selectOption("#parameter", String(index));
    await page.click("#vary");
    await page.waitForFunction(() => !document.getElementById("vary").disabled && document.querySelectorAll("#whatif-table tr[data-seconds]").length === 6);
    const shown = await page.locator("#whatif-table tbody tr").evaluateAll(rows => rows.map(row => [row.cells[0].textContent, Number(row.dataset.seconds), row.className]));
    const now = absolute ? 0 : parts.indexOf(1);
    assert.deepEqual(shown.map(([, , name]) => name), parts.map((_, part) => (part === now ? "now" : shown[part][1] > shown[now][1] ? "worse" : "")), numbers.join());
    for (const [row, [name, seconds]] of shown.entries()) {
      const value = number => (absolute ? parts[row] : parts[row] === 1 ? own[number] : Number((own[number] * parts[row]).toPrecision(3)));
      const varied = Object.fromEntries(numbers.map(number => [number, value(number)]));
      const found = run("varied.nc", text, { settings: { ...own, ...varied } });
      if (found.errors.length) assert(!seconds, `$${numbers} ${name}`);
      else assert.equal(seconds, found.forecast_s, `$${numbers} ${name}`);
    }
  }
  assert(await page.evaluate(() => document.getElementById("whatif-note").textContent.includes("6 whole jobs")));
  assert.deepEqual(faults, []);
}

export async function a_slow_link_is_told(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, { ...MILL, 120: 1000, 121: 1000, 122: 1000 });
  const text = example("relief.nc").split("\n").slice(0, 8000).join("\n");
  await openJob(page, "relief.nc", text);
  await tab(page, "cable");
  await page.click("#test-cable");
  await page.waitForFunction(() => document.getElementById("cable-note").textContent !== "", null, { timeout: 600_000 });
  const rows = await page.locator("#cable-table tbody tr").evaluateAll(all =>
    all.map(row => ({ baud: Number(row.dataset.baud), seconds: Number(row.dataset.seconds), waits: row.className === "waits", pauses: row.cells[2].textContent })));
  const of = baud => rows.find(row => row.baud === baud);
  assert(of(9600).waits && /\d/.test(of(9600).pauses) && of(9600).seconds > 1.5 * of(0).seconds, JSON.stringify(rows));
  assert(!of(115200).waits && of(115200).pauses === "none" && !of(0).waits, JSON.stringify(rows));
  const enough = rows.find(row => !row.waits).baud;
  assert((await page.textContent("#cable-note")).startsWith(`Use ${enough.toLocaleString("en")} baud or more.`));
  const place = page.locator("#waits-list button").last();
  const line = Number((await place.innerText()).replace("Line ", "").replace(",", ""));
  await place.click();
  await isAt(page, line);
  assert.deepEqual(faults, []);
}

export async function time_is_shown_by_kind_and_by_tool(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, { ...MILL, 394: 1.5 });
  const text = "G21 G91\nM3 S1000\nG4 P2\nT1 M6\nG1 X3 F600\nT2 M6\nG0 X-3\nG4 P1\n";
  const found = await openJob(page, "tools.nc", text);
  same(found, run("tools.nc", text, { settings: { ...MILL, 394: 1.5 } }));
  assert.deepEqual(found.tools.map(row => row.tool), [0, 1, 2]);
  const close = (a, b) => assert(Math.abs(a - b) < 1e-4, `${a} ${b}`);
  close(found.dwell_s, 3);
  close(found.spin_up_s, 1.5);
  const kinds = Object.fromEntries(await page.locator("#kinds li").evaluateAll(rows => rows.map(row => [row.firstChild.textContent, row.querySelector("b").textContent])));
  assert.deepEqual([kinds["Pauses (G4)"], kinds["Waiting for the spindle"], kinds["Cutting: lines"], kinds.Rapids], ["3.00 s", "1.50 s", `${found.feed_s.toFixed(2)} s`, `${found.rapid_s.toFixed(2)} s`]);
  const rows = await page.locator("#by-tool tbody tr").evaluateAll(all => all.map(row => [...row.cells].map(cell => cell.textContent)));
  const cell = seconds => (seconds ? `${seconds.toFixed(2)} s` : "–");
  assert.deepEqual(rows, found.tools.map(row => [`T${row.tool}`, cell(row.feed_s), cell(row.rapid_s), cell(row.dwell_s), cell(row.spin_up_s)]));
  // A job with one tool has no table.
  await openJob(page, "one.nc", "G21 G91\nG1 X3 F600\n");
  assert(await page.locator("#by-tool-part").isHidden());
  assert.deepEqual(faults, []);
}

/** In each colouring (kind, tool, line), every row of the path has the shade of its program line. */
export async function arcs_plunges_rapids_and_tools_are_told_apart(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "kinds.nc", "G21 G91\nG0 X5\nG1 Z-1 F600\nG1 X5\nG2 X5 Y5 J5\nT3 M6\nG1 Y5\n");
  const shown = coloring => page.evaluate(coloring => {
    const select = document.getElementById("coloring");
    select.value = coloring;
    select.dispatchEvent(new Event("change"));
    const { path } = oxmill.app.checked;
    const { shades } = oxmill.app.player.picture;
    const found = {};
    path.lines.forEach((line, row) => row && (found[line % 2 ** 30] ??= new Set()).add(Number(shades[row].toFixed(3))));
    return Object.fromEntries(Object.entries(found).map(([line, of]) => [line, [...of]]));
  }, coloring);
  assert.deepEqual(await shown("kind"), { 2: [-1], 3: [-2], 4: [0.2], 5: [0.8], 7: [0.2] });
  const marks = () => page.locator("#legend-marks li").allInnerTexts();
  assert.deepEqual((await marks()).slice(0, 4), ["line", "arc", "plunge", "rapid"]);
  assert.deepEqual(await shown("tool"), { 2: [-1], 3: [0], 4: [0], 5: [0], 7: [1] });
  assert.deepEqual([await page.textContent("#scale-low"), await page.textContent("#scale-high")], ["T0", "T3"]);
  // By line: the line number divided by that of the last line.
  assert.deepEqual(await shown("line"), { 2: [-1], 3: [0.429], 4: [0.571], 5: [0.714], 7: [1] });
  assert.deepEqual([await page.textContent("#scale-low"), await page.textContent("#scale-high")], ["line 1", "line 7"]);
  assert.deepEqual(faults, []);
}

/** With colours for the acceleration, the ends of a straight move have the machine's acceleration, and its middle has
 * 0. */
export async function acceleration_has_the_colours_of_its_value(browser) {
  const { page, faults } = await open(browser, file);
  await settings(page, MILL);
  await openJob(page, "straight.nc", "G21 G91\nG1 X50 F3000\n");
  const before = await colorsOn(page, "view");
  const rows = () => page.evaluate(() => ({ shades: [...oxmill.app.player.picture.shades], rows: [...oxmill.app.checked.path.rows] }));
  const bySpeed = (await rows()).shades;
  await page.selectOption("#coloring", "acceleration");
  const { shades, rows: path } = await rows();
  const legend = await page.textContent("#scale-high");
  assert.match(await page.textContent("#legend-caption"), /mm\/s²$/);
  const most = parseFloat(legend);
  assert(most > 0.8 * MILL[120] && most < 1.2 * MILL[120], legend);
  assert.notDeepEqual(shades, bySpeed);
  const cruise = shades.filter((_, row) => row > 1 && path[row * 6 + 3] > 49.9);
  assert(cruise.length > 0 && cruise.every(shade => shade < 0.05), `${cruise}`);
  assert(shades.filter(shade => shade > 0.7).length > 1, `${shades}`);
  const after = await colorsOn(page, "view");
  assert(before > 50 && after > 50 && before !== after, `${before} and ${after} pixels`);
  assert.deepEqual(faults, []);
}
