// Ways to use the page: by keys alone, on a telephone, without WebGL, without a serial port, with a screen reader.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { checked, isAt, launch, open, openJob, tab, timeOf } from "./browser.mjs";
import { example, page as file, root } from "./program.mjs";
import { walk } from "./walk.mjs";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");

/** Functions that fill each panel with the results of a job, a run or a fault. The audit then sees more than empty
 * panels. */
const FILLED = {
  settings: async page => {
    await page.fill('[aria-label^="$0 "]', "256");
    await page.keyboard.press("Tab");
    await page.waitForFunction(() => document.getElementById("refused").textContent !== "");
    assert(await page.locator("#settings-table td.changed").count() > 0);
    await page.click("#open-import");
    await page.fill("#paste", "$110=500\n$999=1\n");
  },
  whatif: async page => {
    await page.evaluate(() => {
      oxmill.app.checked = undefined;
      oxmill.app.settings.choose("new");
    });
    await checked(page);
    await page.click("#vary");
    await page.waitForFunction(() => document.getElementById("whatif-note").textContent.includes("whole jobs"));
  },
  cable: async page => {
    await page.click("#test-cable");
    await page.waitForFunction(() => document.getElementById("cable-note").textContent !== "");
  },
  material: async page => {
    await page.click("#cut");
    await page.waitForFunction(() => document.querySelectorAll("#crashes button").length === 1);
    await page.selectOption("#shape", "v");
  },
  continue: async page => {
    await page.fill("#from-line", "8");
    await page.click("#this-line");
  },
  run: async page => {
    await page.evaluate(() => document.getElementById("power").click());
    await page.waitForFunction(() => /^Idle/.test(oxmill.app.machine.status?.state ?? ""));
    await page.evaluate(() => oxmill.app.machine.line("G999"));
  },
};

export async function axe_finds_nothing(browser) {
  for (const [colorScheme, width] of [["light", 1440], ["dark", 1440], ["light", 1024], ["light", 390], ["dark", 390]]) {
    // Reduce motion: without this, a button that was just enabled would still be changing its colour.
    const { page } = await open(browser, file, { colorScheme, reducedMotion: "reduce", viewport: { width, height: 900 } });
    await page.evaluate(axe);
    const audit = async where => {
      const { violations } = await page.evaluate(() => axe.run());
      assert.deepEqual(violations.map(found => `${where}: ${found.id}: ${found.nodes[0].html}`), [], `${colorScheme}, ${width} px`);
    };
    // This job has two tools, a rejected line, an alarm, a message, and a rapid through material.
    await openJob(page, "bad.nc", "G21 G90 F600\n(MSG,hello)\nM3 S1000\nG4 P1\nT1 M6\nG0 Z2\nG1 Z-2\nG1 X20\nG999\nT2 M6\nG0 Y10\nG38.2 Z-9\n");
    for (const part of ["#errors .h", "#by-tool td", "#messages li"]) assert(await page.locator(part).count() > 0, part);
    for (const coloring of ["kind", "tool"]) await page.selectOption("#coloring", coloring);
    for (const [name, fill] of Object.entries(FILLED)) {
      await page.keyboard.press("Escape");
      await tab(page, name);
      await audit(`${name}, empty`);
      await fill(page);
      await audit(name);
    }
    await page.evaluate(() => oxmill.app.go("first"));
    await audit("first");
    await page.context().close();
  }
}

/** The walk checks a job, jogs and zeroes the machine, runs and holds the job, stops it, and continues it. */
export async function a_newcomer_comes_from_a_job_to_its_end(browser) {
  const { page, faults } = await open(browser, file, { first: true });
  await walk(page);
  assert.deepEqual(faults, []);
}

export async function keys_are_enough(browser) {
  const { page, faults } = await open(browser, file, { first: true });
  const reach = async found => {
    for (let i = 0; i < 400; i++) {
      if (await page.evaluate(found => document.activeElement?.matches(found), found)) return;
      await page.keyboard.press("Tab");
    }
    assert.fail(`${found} is not reached`);
  };
  await reach('[data-machine="3018"]');
  await page.keyboard.press("ArrowDown");
  assert.equal(await page.getAttribute('[data-machine="shapeoko3"]', "aria-checked"), "true");
  await reach('[data-sample="house.nc"]');
  await page.keyboard.press("Enter");
  await checked(page, "house.nc");
  await reach("#view");
  const turn = () => page.evaluate(() => oxmill.app.player.picture.camera.turn);
  const before = await turn();
  await page.keyboard.press("ArrowRight");
  assert(await turn() > before);
  await reach("#chart");
  await page.keyboard.press("Home");
  assert.equal(await page.evaluate(() => oxmill.app.player.time), 0);
  await page.keyboard.press("Shift+ArrowRight");
  assert.equal(await page.evaluate(() => oxmill.app.player.time), 10);
  await page.keyboard.press("Home");
  await reach("#lines");
  for (let i = 0; i < 8; i++) await page.keyboard.press("ArrowDown");
  await isAt(page, 8);
  await reach("#tab-whatif");
  await page.keyboard.press("ArrowRight");
  assert(await page.locator("#cable").isVisible());
  await page.keyboard.press("3");
  assert(await page.locator("#settings").isVisible());
  await page.keyboard.press("?");
  assert(await page.locator("#keys-dialog").isVisible());
  await page.keyboard.press("Escape");
  assert(await page.locator("#keys-dialog").isHidden());
  assert.deepEqual(faults, []);
}

export async function a_telephone_shows_all_of_it(browser) {
  const { page, faults } = await open(browser, file, { viewport: { width: 390, height: 844 } });
  const wide = async where => assert.equal(await page.evaluate(() => document.documentElement.scrollWidth), 390, where);
  for (const name of ["whatif", "cable", "material", "continue", "settings", "run"]) {
    await tab(page, name);
    await wide(name);
    if (["settings", "run"].includes(name)) continue;
    const panel = await page.locator("#check-right [role=tabpanel]:visible").evaluate(panel => [panel.scrollWidth, panel.clientWidth]);
    assert(panel[0] <= panel[1], `${name}: ${panel}`);
  }
  await page.click("#power");
  for (const part of ["control", "job", "picture", "more"]) {
    await page.click(`.parts [data-part=${part}]`);
    await wide(part);
  }
  await page.click("#brand");
  await wide("first");
  assert.deepEqual(faults, []);
}

export async function check_and_forecast_do_without_webgl() {
  const browser = await launch(["--disable-3d-apis"]);
  try {
    const { page, faults } = await open(browser, file);
    assert(await page.locator("#nopicture").isVisible());
    const found = await openJob(page, "house.nc", example("house.nc"));
    assert(found.complete);
    await page.evaluate(() => oxmill.app.player.goToLine(8));
    await isAt(page, 8);
    assert.deepEqual(faults.filter(fault => !/WebGL/i.test(fault)), []);
  } finally {
    await browser.close();
  }
}

export async function a_browser_without_serial_ports_says_so(browser) {
  const prepare = page => page.addInitScript(() => Object.defineProperty(navigator, "serial", { configurable: true, get: () => undefined }));
  const { page, faults } = await open(browser, file, { prepare });
  await tab(page, "run");
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
  // A browser reports a chosen file only if the choice changes. So the field must be empty again.
  assert.equal(await page.inputValue("#file"), "");
  assert.deepEqual(faults, []);
}

export async function a_job_is_played_at_a_thousand_times_its_speed(browser) {
  const { page, faults } = await open(browser, file);
  const { forecast_s } = await openJob(page, "long.nc", "G21 G91\nG1 X3000 F60\nG1 X-3000\n");
  await page.selectOption("#rate", "1000");
  const began = performance.now();
  // Returns the wall time and the job time, s, at two frames that are at least 1 s apart.
  const between = page.evaluate(() => new Promise(done => {
    let first;
    let before;
    // This callback runs before the player's callback. So the player's time is still that of the previous frame.
    const look = now => {
      const at = [before / 1000, oxmill.app.player.time];
      before = now;
      const playing = document.getElementById("play").ariaLabel === "Pause";
      if (!first && playing && at[1] > 0) first = at;
      if (first && (at[0] - first[0] >= 1 || !playing)) done([first, at]);
      else requestAnimationFrame(look);
    };
    requestAnimationFrame(look);
  }));
  await page.click("#play");
  const [from, to] = await between;
  const rate = (to[1] - from[1]) / (to[0] - from[0]);
  assert(to[1] < forecast_s && Math.abs(rate - 1000) < 1, `${from} to ${to} of ${forecast_s} s`);
  await page.waitForFunction(() => document.getElementById("play").getAttribute("aria-label") === "Play");
  const took = (performance.now() - began) / 1000;
  assert(forecast_s > 5900 && took > 0.9 * forecast_s / 1000, `${forecast_s} s in ${took} s`);
  assert(Math.abs(await page.evaluate(() => oxmill.app.player.time) - forecast_s) < 0.1);
  assert.deepEqual(faults, []);
}

/** After a file that cannot be read, such as a folder, the page must neither show nor run the previous job. */
export async function a_file_that_cannot_be_read_is_named(browser) {
  const { page, faults } = await open(browser, file);
  await page.evaluate(() => {
    const folder = new File([], "folder");
    folder.arrayBuffer = () => Promise.reject(new DOMException("It could not be found.", "NotFoundError"));
    dispatchEvent(Object.assign(new Event("drop"), { dataTransfer: { files: [folder] } }));
  });
  await page.waitForFunction(() => document.getElementById("verdict").textContent.includes("This file cannot be read.It could not be found."));
  assert.deepEqual(await page.evaluate(() => [document.getElementById("name").textContent, oxmill.app.job.text, oxmill.app.checked === undefined]), ["folder", "", true]);
  assert.equal(await page.locator("#facts dd").count(), 0);
  await openJob(page, "after.nc", "G21 G91\nG1 X1 F600\n");
  assert.deepEqual(faults, []);
}

export async function a_dropped_file_is_checked(browser) {
  const { page, faults } = await open(browser, file);
  const drop = (kind, more) => page.evaluate(([kind, more]) => {
    const dataTransfer = new DataTransfer();
    dataTransfer.items.add(new File(["G21 G90\nG1 X7 F600\n"], "dropped.nc"));
    if (more) oxmill.app.checked = undefined;
    const event = new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true });
    document.getElementById("stage").dispatchEvent(event);
    return [event.defaultPrevented, document.body.classList.contains("over-drop")];
  }, [kind, more]);
  assert.deepEqual(await drop("dragover"), [true, true]);
  assert.deepEqual(await drop("drop", true), [true, false]);
  const found = await checked(page, "dropped.nc");
  assert.deepEqual(found.position_mm, [7, 0, 0]);
  assert.equal(await page.textContent("#name"), "dropped.nc");
  assert.deepEqual(faults, []);
}

const FAULTY = "G21 G90\nG1 X10 F600\nG999\nG1 Y10\nG1 X20 Q3\nG1 X0\n";

export async function refused_lines_are_reached_by_keys(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "faulty.nc", FAULTY);
  await page.focus("#play");
  await page.evaluate(() => document.getElementById("check-left").focus());
  const focused = () => page.evaluate(() => document.activeElement.closest("#errors")?.textContent ? document.activeElement.textContent : "");
  await page.keyboard.press("Tab");
  assert.match(await focused(), /error:20[^]*line 3/);
  await page.keyboard.press("Tab");
  assert.match(await focused(), /error:[^]*line 5/);
  await page.keyboard.press("Enter");
  // The rejected line moves nothing. So the page shows the time at which the next line begins.
  const { shown, begins } = await timeOf(page, 6);
  assert(begins > 0 && Math.abs(shown - begins) < 1e-6, `${shown} ${begins}`);
  assert.match(await page.locator("#lines [aria-selected=true]").innerText(), /^\s*5\s/);
  assert.deepEqual(faults, []);
}

export async function a_line_that_is_clicked_is_shown(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "faulty.nc", FAULTY);
  for (const line of [4, 6]) {
    await page.click(`#line-${line}`);
    await isAt(page, line);
  }
  // A click must also count if the list is redrawn while the button is down.
  const box = await page.locator("#line-4").boundingBox();
  await page.mouse.move(box.x + 20, box.y + 9);
  await page.mouse.down();
  await page.evaluate(() => document.getElementById("lines").dispatchEvent(new Event("scroll")));
  await page.mouse.up();
  await isAt(page, 4);
  assert.deepEqual(faults, []);
}

/** A line that moves nothing is shown at the start of the next move. If no move follows, it is shown at the end of the
 * job. */
export async function the_last_lines_are_at_the_end(browser) {
  const { page, faults } = await open(browser, file);
  const { forecast_s } = await openJob(page, "end.nc", "G21 G91\nG1 X9 F600\nM5\nG1 X-9\nM9\nG999\nM30\n");
  const shown = () => page.evaluate(() => oxmill.app.player.time);
  for (const line of [5, 6, 7]) {
    await page.evaluate(() => oxmill.app.player.seek(0));
    await page.click(`#line-${line}`);
    assert(Math.abs(await shown() - forecast_s) < 0.01, `line ${line}: ${await shown()} of ${forecast_s} s`);
    assert.match(await page.locator("#lines [aria-selected=true]").innerText(), new RegExp(`^\\s*${line}\\s`));
  }
  await page.click("#line-3");
  await isAt(page, 4, 3);
  // Keys go to the first and to the last line.
  await page.focus("#lines");
  await page.keyboard.press("Home");
  assert.equal(await shown(), 0);
  await page.keyboard.press("End");
  assert(Math.abs(await shown() - forecast_s) < 0.01);
  await page.locator("#errors button").click();
  assert(Math.abs(await shown() - forecast_s) < 0.01, "a refused line behind the last move");
  assert.deepEqual(faults, []);
}

/** Returns a checksum of all pixel colours of the first view, once it is at rest. */
const pixels = page => page.evaluate(async () => {
  const canvas = document.getElementById("view");
  await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
  const gl = canvas.getContext("webgl2");
  const all = new Uint8Array(canvas.width * canvas.height * 4);
  gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, all);
  return all.reduce((sum, value) => (Math.imul(sum, 31) + value) | 0, 0);
});

/** Mouse, wheel and keys change the picture: its pixels, its camera, and where two positions appear. */
export async function mouse_and_keys_turn_move_and_zoom_the_picture(browser) {
  const { page, faults } = await open(browser, file);
  await openJob(page, "square.nc", "G21 G91 F6000\nG1 X50\nG1 Y50\nG1 X-50\nG1 Y-50\n");
  const box = await page.locator("#view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const look = async () => ({ pixels: await pixels(page), ...await page.evaluate(() => {
    const { camera } = oxmill.app.player.picture;
    const [middle, corner] = [[25, 25, 0], [0, 0, 0]].map(place => oxmill.app.player.picture.place(place));
    return { turn: camera.turn, height: camera.height, middle, size: camera.distance, corner };
  }) });
  const drag = async (dx, dy, button = "left") => {
    await page.mouse.move(x, y);
    await page.mouse.down({ button });
    await page.mouse.move(x + dx, y + dy, { steps: 3 });
    await page.mouse.up({ button });
  };
  const near = (a, b, within = 1) => Math.abs(a - b) <= within;
  const turned = (was, is) => is.turn !== was.turn && is.size === was.size && near(is.middle[0], was.middle[0]) && near(is.middle[1], was.middle[1]);
  const moved = (dx, dy) => (was, is) => is.turn === was.turn && is.height === was.height && near(is.middle[0] - was.middle[0], dx) && near(is.middle[1] - was.middle[1], dy);
  const sized = sign => (was, is) => is.turn === was.turn && Math.sign(was.size - is.size) === sign && near(is.middle[0], was.middle[0]);
  const key = name => () => page.keyboard.press(name);
  const steps = [
    ["drag", () => drag(60, 0), turned], ["drag with the right button", () => drag(50, 30, "right"), moved(50, 30)], ["Fit", () => page.click("#fit"), () => true],
    ["drag with Shift", async () => {
      await page.keyboard.down("Shift");
      await drag(-40, 20);
      await page.keyboard.up("Shift");
    }, moved(-40, 20)], ["0", key("0"), (was, is) => near(is.middle[0], box.width / 2) && near(is.middle[1], box.height * 0.44, box.height * 0.03)],
    ["wheel", () => page.mouse.wheel(0, -200), sized(1)], ["wheel back", () => page.mouse.wheel(0, 300), sized(-1)],
    ["+", key("+"), sized(1)], ["-", key("-"), sized(-1)], ["-", key("-"), sized(-1)],
    ["ArrowRight", key("ArrowRight"), turned], ["ArrowUp", key("ArrowUp"), (was, is) => is.height > was.height && is.turn === was.turn],
    ["Shift+ArrowRight", key("Shift+ArrowRight"), moved(40, 0)], ["Shift+ArrowUp", key("Shift+ArrowUp"), moved(0, -40)],
    ["Shift+ArrowLeft", key("Shift+ArrowLeft"), moved(-40, 0)], ["Shift+ArrowDown", key("Shift+ArrowDown"), moved(0, 40)],
  ];
  await page.focus("#view");
  let was = await look();
  for (const [name, act, holds] of steps) {
    await act();
    if (name === "Fit") await page.focus("#view");
    const is = await look();
    assert(is.pixels !== was.pixels, `${name}: the picture is the same`);
    assert(holds(was, is), `${name}: ${JSON.stringify([was, is])}`);
    was = is;
  }
  assert.deepEqual(faults, []);
}

export async function the_theme_is_chosen_by_its_button(browser) {
  const { page, faults } = await open(browser, file);
  const paper = () => page.evaluate(() => getComputedStyle(document.getElementById("stage")).backgroundColor);
  const seen = async () => [await paper(), await pixels(page)];
  const light = await seen();
  await page.click("#theme");
  const dark = await seen();
  assert.deepEqual([light[0], dark[0]], ["rgb(255, 255, 255)", "rgb(20, 24, 30)"]);
  assert.notEqual(dark[1], light[1], "the picture");
  await page.click("#theme");
  assert.deepEqual(await seen(), light);
  assert.deepEqual(faults, []);
}

/** On a touch screen, one finger turns the picture, and two fingers zoom it. */
export async function fingers_turn_and_zoom_the_picture(browser) {
  const { page, faults } = await open(browser, file, { viewport: { width: 390, height: 844 } });
  const fingers = await page.context().newCDPSession(page);
  const touch = (type, ...points) => fingers.send("Input.dispatchTouchEvent", { type, touchPoints: points.map(([x, y], id) => ({ x, y, id })) });
  await page.locator("#view").scrollIntoViewIfNeeded();
  const box = await page.locator("#view").boundingBox();
  const [x, y] = [box.x + box.width / 2, box.y + box.height / 2];
  const camera = () => page.evaluate(() => ({ ...oxmill.app.player.picture.camera }));
  const before = await camera();
  await touch("touchStart", [x, y]);
  await touch("touchMove", [x + 60, y]);
  await touch("touchEnd");
  const turned = await camera();
  assert.notEqual(turned.turn, before.turn);
  const size = () => page.evaluate(() => {
    const [a, b] = [[0, 0, 0], [10, 0, 0]].map(place => oxmill.app.player.picture.place(place));
    return Math.hypot(a[0] - b[0], a[1] - b[1]);
  });
  const small = await size();
  await touch("touchStart", [x - 20, y], [x + 20, y]);
  for (const far of [30, 45, 60]) await touch("touchMove", [x - far, y], [x + far, y]);
  await touch("touchEnd");
  assert(await size() > 1.5 * small, `${small} and ${await size()}`);
  assert.deepEqual(faults, []);
}

export async function settings_of_a_machine_are_pasted(browser) {
  const { page, faults } = await open(browser, file);
  await tab(page, "settings");
  await page.click("#open-import");
  // A typing mistake must not replace the present settings by default values.
  await page.evaluate(() => oxmill.app.settings.set(121, 77));
  for (const slip of ["", "110=5\nok\n", "$120=1,5\n$121=1e2\n"]) {
    await page.fill("#paste", slip);
    await page.click("#take");
    assert.match(await page.locator("#take-note").innerText(), /^Nothing is taken over/, slip);
    assert.equal(await page.evaluate(() => oxmill.app.settings.value(121)), 77, slip);
  }
  await page.fill("#paste", "<Idle|MPos:0,0,0>\n$100=80.000 (a remark)\n$120=123.5\n$122=x\n$99999=1\nok\n");
  assert.deepEqual(await page.locator("#import-table tbody tr").allInnerTexts().then(rows => rows.map(row => row.split("\t"))),
    [["$100=80.000 (a remark)", "$100 X-axis resolution", "80 steps/mm"], ["$120=123.5", "$120 X-axis acceleration", "123.5 mm/s2"], ["$122=x", "not taken: no number"], ["$99999=1", "not taken: no such setting"]]);
  await page.evaluate(() => (oxmill.app.checked = undefined));
  await page.click("#take");
  await checked(page);
  assert.deepEqual(await page.evaluate(() => oxmill.app.settings.values()), { 100: 80, 120: 123.5 });
  assert.equal(await page.locator("#settings-note").innerText(), "2 settings are taken over. Not understood: $122=x, $99999=1");
  // A reload restores the settings. Settings that this firmware does not have are dropped: another version of the page
  // may have stored them.
  const reloaded = async (kept, wanted) => {
    await page.evaluate(kept => localStorage.setItem("oxmill settings", kept), kept);
    await page.reload();
    await page.waitForFunction(() => globalThis.oxmill?.app);
    assert.deepEqual(await page.evaluate(() => oxmill.app.settings.values()), wanted, kept);
  };
  for (const kept of ["7", '{"99999":1,"100":"x"}', '{"100":250}']) await reloaded(kept, {});
  // Invalid stored data are ignored. The settings are then those of the chosen machine, here a new board.
  for (const kept of ["null", "{"]) await reloaded(kept, {});
  await reloaded('{"100":80,"120":123.5}', { 100: 80, 120: 123.5 });
  await tab(page, "settings");
  assert.equal(await page.inputValue('[aria-label^="$120 "]'), "123.5");
  // A row has X, Y and Z, with the differing value marked; the explanation is shown once, beside it.
  await page.fill("#find", "120");
  const row = page.locator("#settings-table tr.row:visible").first();
  assert.match(await row.innerText(), /Acceleration\s*\$120–122[^]*mm\/s2/);
  assert.deepEqual(await row.locator("input").evaluateAll(all => all.map(input => [input.value, input.closest("td").classList.contains("changed")])), [["123.5", true], ["10", false], ["10", false], ["10", false]]);
  await page.fill("#find", "gantry");
  const found = page.locator("#settings-table tr.row:visible");
  assert.match(await found.innerText(), /^Axis with two motors\s*\$905/);
  await found.click();
  assert.match(await page.locator("#inspect .explanation").innerText(), /second motor with its own pins, such as a gantry with a motor on each side\./);
  await page.fill("#find", "");
  const book = readFileSync(join(root, "docs/settings.md"), "utf8");
  for (const row of await page.locator("#settings-table tr.row").all()) {
    await row.click({ position: { x: 20, y: 10 } });
    const sentence = await page.locator("#inspect .explanation").innerText();
    assert(sentence && book.includes(`| ${sentence} |`), sentence);
  }
  assert.deepEqual(faults, []);
}

/** Returns the bytes that the browser uses for the page after garbage collection: script objects and the module.
 * Returns the minimum of three measurements, because background work can hold memory for a moment. */
const memory = async (page, devtools) => {
  let least = Infinity;
  for (let time = 0; time < 3; time++) {
    if (time > 0) await page.waitForTimeout(200);
    await devtools.send("HeapProfiler.collectGarbage");
    const { metrics } = await devtools.send("Performance.getMetrics");
    least = Math.min(least, metrics.find(({ name }) => name === "JSHeapUsedSize").value);
  }
  return least + await page.evaluate(() => oxmill.app.checked.memory);
};

/** After a leak, even the smallest measurement of the last five jobs would be above the smallest of the first five.
 * Single measurements differ by a tenth, because the browser frees memory when it likes. */
export async function ten_jobs_take_no_more_memory_than_five(browser) {
  const { page, faults } = await open(browser, file);
  const devtools = await page.context().newCDPSession(page);
  await devtools.send("Performance.enable");
  const text = example("relief.nc");
  const held = [];
  for (let job = 0; job < 10; job++) {
    await openJob(page, `job-${job}.nc`, text);
    held.push(await memory(page, devtools));
  }
  const [first, last] = [Math.min(...held.slice(0, 5)), Math.min(...held.slice(5))];
  assert(last < 1.05 * first && last > 1e6, `${held}`);
  assert.deepEqual(faults, []);
}
