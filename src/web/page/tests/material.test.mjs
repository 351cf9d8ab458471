// What cutters leave of a block, compared with geometry worked out by hand; and the material panel in the page.
import assert from "node:assert/strict";
import { build } from "esbuild";
import { join } from "node:path";
import { open, openJob, tab } from "./browser.mjs";
import { example, page as file, root } from "./program.mjs";

const bundled = await build({ entryPoints: [join(root, "src/web/page/src/material.ts")], bundle: true, write: false, format: "esm", target: "es2022" });
const { cut, cellFor, blockOf } = await import(`data:text/javascript;base64,${Buffer.from(bundled.outputFiles[0].text).toString("base64")}`);

const RAPID = 2 ** 31;
const FLAT = { shape: "flat", diameter: 6, angle: 60 };
const BALL = { shape: "ball", diameter: 6, angle: 60 };
const V = { shape: "v", diameter: 6, angle: 60 };
/** Returns a path through positions [x, y, z], mm. A fourth number 1 makes the move to a position a rapid. Each move
 * takes 1 s, and the move to position i has line number i. */
function through(places, tool = 0) {
  const rows = Float32Array.from(places.flatMap(([x, y, z], i) => [x, y, z, 1, i, i + 1]));
  return { rows, lines: Uint32Array.from(places, (place, i) => i + (place[3] ? RAPID : 0)), tools: new Uint32Array(places.length).fill(tool), speeds: new Uint32Array(places.length) };
}
const BLOCK = { low: [-10, -10, -5], high: [30, 10, 0] };
const CELL = 0.1;
const made = (places, cutter, block = BLOCK, cell = CELL) => cut(through(places), { 0: cutter }, block, cell);
/** Returns the height of the cell whose middle is nearest. */
const at = (material, x, y) => {
  const { block, nx, ny, heights } = material;
  const index = (value, axis, count) => Math.round(((value - block.low[axis]) / (block.high[axis] - block.low[axis])) * count - 0.5);
  return heights[index(y, 1, ny) * nx + index(x, 0, nx)];
};
const close = (a, b, within = 1e-5) => assert(Math.abs(a - b) <= within, `${a} and ${b}`);

export async function a_flat_cutter_leaves_a_slot_of_its_width() {
  const slot = made([[0, 0, -1], [20, 0, -1]], FLAT);
  for (const [y, z] of [[0.05, -1], [2.95, -1], [-2.95, -1], [3.05, 0], [-3.05, 0]]) close(at(slot, 10.05, y), z);
  // The ends are round: nothing is cut at the corner of the surrounding square.
  close(at(slot, 22.95, 0.05), -1);
  close(at(slot, 22.95, 2.95), 0);
  const area = 20 * 6 + Math.PI * 9;
  close(slot.removed, area, area * 0.005);
  // A cut that is deeper than the block stops at the bottom of the block.
  close(at(made([[0, 0, -9], [20, 0, -9]], FLAT), 10, 0), -5);
  // Up a slope of one half, the leading edge of the cutter determines the height: it passes a cell first, and lowest.
  close(at(made([[0, 0, -5], [10, 0, 0]], FLAT), 6.05, 0.05), -5 + (6.05 - Math.sqrt(9 - 0.05 ** 2)) / 2);
}

export async function a_ball_leaves_cusps() {
  const passes = made([[0, 0, -1], [20, 0, -1], [20, 1, -1], [0, 1, -1]], BALL, { low: [-10, -10.05, -5], high: [30, 10.05, 0] });
  // Between two passes 1 mm apart, the cusp is R - sqrt(R^2 - (1/2)^2) high.
  close(at(passes, 10.05, 0.5), -1 + 3 - Math.sqrt(9 - 0.25));
  close(at(passes, 10.05, 0), -1);
  // On a slope of 45 degrees, the ball touches beside its tip: R (sqrt(2) - 1) below the line of the tip.
  close(at(made([[0, 0.05, -4.5], [4, 0.05, -0.5]], BALL), 2.25, 0.05), -4.5 + 2.25 - 3 * (Math.SQRT2 - 1));
}

export async function a_v_leaves_a_groove() {
  const groove = made([[0, 0.05, -2], [20, 0.05, -2]], V);
  const slope = 1 / Math.tan(Math.PI / 6);
  for (const off of [0, 0.5, 1]) close(at(groove, 10.05, 0.05 + off), -2 + off * slope);
  // At its top, the groove is 2 * depth * tan(30 deg) = 2.309 mm wide.
  const cells = Array.from({ length: 200 }, (_, j) => at(groove, 10.05, -9.95 + j / 10)).filter(height => height < 0).length;
  close(cells * CELL, 2 * 2 * Math.tan(Math.PI / 6), 2 * CELL);
  // Straight down, the cutter leaves a cone.
  const cone = made([[5.05, 0.05, 1], [5.05, 0.05, -2]], V);
  close(at(cone, 5.05, 0.05), -2);
  close(at(cone, 5.85, 0.65), -2 + 1 * slope);
}

export async function rapids_through_material_are_found() {
  const lines = places => made(places, FLAT).crashes.map(crash => crash.line);
  // These rapids do not crash: above the block, along a slot and then straight up, and beside the block.
  assert.deepEqual(lines([[0, 0, 5], [10, 0, 5, 1], [10, 0, 0, 1]]), []);
  assert.deepEqual(lines([[0, 0, 1], [0, 0, -1], [20, 3.3, -1], [0, 0, -1, 1], [0, 0, 5, 1]]), []);
  assert.deepEqual(lines([[50, 0, 1], [50, 0, -1, 1], [50, 5, -1, 1]]), []);
  // These rapids crash: sideways out of a slot, straight down, and across the block on a slope.
  const found = made([[0, 0, 1], [0, 0, -2], [20, 0, -2], [20, 8, -2, 1], [20, 8, 5, 1]], FLAT).crashes;
  assert.deepEqual(found.map(crash => crash.line), [3]);
  close(found[0].depth, 2);
  assert.equal(found[0].seconds, 3);
  assert.deepEqual(lines([[0, 0, 1], [0, 0, -1, 1]]), [1]);
  assert.deepEqual(lines([[-20, 0, 1], [40, 0, -1, 1]]), [1]);
  for (const cutter of [BALL, V]) assert.deepEqual(made([[0, 0, 1], [0, 0, -1, 1]], cutter).crashes.map(crash => crash.line), [1]);
}

export async function map_and_work_have_bounds() {
  const wide = { low: [0, 0, -1], high: [2000, 2000, 0] };
  const cell = cellFor(through([[0, 0, 1], [1, 0, 1]]), { 0: FLAT }, wide);
  const { nx, ny } = cut(through([[0, 0, 1], [1, 0, 1]]), { 0: FLAT }, wide, cell);
  assert(nx * ny <= 400_000, `${nx} x ${ny}`);
  // No side has more cells than a texture may have.
  const thin = { low: [0, 0, -1], high: [2000, 1, 0] };
  const narrow = cut(through([[0, 0, 1], [1, 0, 1]]), { 0: FLAT }, thin, cellFor(through([[0, 0, 1], [1, 0, 1]]), { 0: FLAT }, thin));
  assert(narrow.nx <= 4096 && narrow.ny >= 1, `${narrow.nx} x ${narrow.ny}`);
  const long = through(Array.from({ length: 100_000 }, (_, i) => [i % 20, (i >> 8) % 7, -1]));
  assert(cellFor(long, { 0: FLAT }, BLOCK) > 2 * cellFor(through([[0, 0, 0], [1, 0, 0]]), { 0: FLAT }, BLOCK));
  // Each tool has its own cutter.
  const two = through([[0, 0, -1], [10, 0, -1], [20, 0, -1]], 0);
  two.tools[2] = 7;
  const material = cut(two, { 0: { ...FLAT, diameter: 2 }, 7: FLAT }, BLOCK, CELL);
  close(at(material, 5.05, 2.05), 0);
  close(at(material, 15.05, 2.05), -1);
  // The block of a job: its cuts below zero, plus the radius around them and 1 mm below them.
  assert.deepEqual(blockOf(through([[0, 0, 5], [5, 2, 5, 1], [5, 2, -3], [20, 4, -3]]), { 0: FLAT }, 0), { low: [2, -1, -4], high: [23, 7, 0] });
}

const cutNow = async page => {
  await tab(page, "material");
  await page.click("#cut");
  await page.waitForFunction(() => oxmill.app.material.material && document.getElementById("cutting").hidden);
  return page.evaluate(() => {
    const { material } = oxmill.app.material;
    return { removed: material.removed, crashes: material.crashes.map(({ line, depth }) => ({ line, depth })), block: material.block };
  });
};

export async function the_page_lists_rapids_through_material(browser) {
  const { page, faults } = await open(browser, file);
  // This program has a mistake: it does not lift the tool before the rapid.
  const text = "G21 G90 F600\nG0 Z2\nG1 Z-2\nG1 X20\nG0 Y10\nG0 Z2\nG0 X0 Y0\n";
  await openJob(page, "crash.nc", text);
  await tab(page, "material");
  await page.fill("#diameter", "6");
  await page.keyboard.press("Tab");
  assert.equal(await page.inputValue("#block-low-0"), "-3");
  // The page proposes a block for the job. The slot has round ends, and the rapid cuts the corners that remain in this
  // block.
  const found = await cutNow(page);
  assert.deepEqual(found.crashes.map(crash => crash.line), [5]);
  await page.fill("#block-high-1", "20");
  await page.keyboard.press("Tab");
  const crashed = await cutNow(page);
  assert.deepEqual(crashed.crashes.map(crash => crash.line), [5]);
  close(crashed.crashes[0].depth, 2, 1e-3);
  const item = page.locator("#crashes button");
  assert.match(await item.innerText(), /^line 5: rapid 2\.00 mm deep[^]*G0 Y10/);
  assert.match(await page.textContent("#material-note"), /^1 rapid through material/);
  // The item has the focus by keys and leads to its line. The picture shows this line in red.
  await item.focus();
  await page.keyboard.press("Enter");
  assert.equal(await page.evaluate(() => oxmill.app.player.line), 5);
  assert((await page.locator("#legend-marks li").allInnerTexts()).includes("rapid through material"));
  const shades = await page.evaluate(() => {
    const { path } = oxmill.app.checked;
    return [...new Set([...path.lines].flatMap((line, row) => (line % 2 ** 30 === 5 ? [oxmill.app.player.picture.shades[row]] : [])))];
  });
  assert(shades.includes(-3), String(shades));
  // If the tool is lifted first, there is no crash; and no result of the first job remains.
  await openJob(page, "lifted.nc", "G21 G90 F600\nG0 Z2\nG1 Z-2\nG1 X20\nG0 Z2\nG0 X0 Y10\n");
  assert.equal(await page.locator("#crashes button").count(), 0);
  assert.equal(await page.textContent("#material-note"), "");
  assert.deepEqual((await cutNow(page)).crashes, []);
  assert.deepEqual(faults, []);
}

export async function a_sound_job_has_no_rapid_through_material(browser) {
  const { page, faults } = await open(browser, file);
  for (const name of ["pocket_mm.nc", "drilling.nc", "pcb_isolation.nc"]) {
    await openJob(page, name, example(name));
    const { removed, crashes } = await cutNow(page);
    assert.deepEqual(crashes, [], name);
    assert(removed > 0, name);
    assert.match(await page.textContent("#material-note"), /^No rapid goes through material/);
  }
  // The block is drawn: its colour appears, and disappears when the block is removed.
  const brown = () => page.evaluate(async () => {
    await new Promise(done => requestAnimationFrame(() => requestAnimationFrame(done)));
    const canvas = document.getElementById("view");
    const gl = canvas.getContext("webgl2");
    const pixels = new Uint8Array(canvas.width * canvas.height * 4);
    gl.readPixels(0, 0, canvas.width, canvas.height, gl.RGBA, gl.UNSIGNED_BYTE, pixels);
    let count = 0;
    for (let i = 0; i < pixels.length; i += 4) count += pixels[i] > pixels[i + 2] + 25 && pixels[i] > pixels[i + 1] && pixels[i] - pixels[i + 1] < 60 ? 1 : 0;
    return count;
  });
  const shown = await brown();
  await page.click("#no-block");
  const gone = await brown();
  assert(shown > 10_000 && gone < shown / 10, `${shown} ${gone}`);
  await page.fill("#block-high-2", "-100");
  await page.click("#cut");
  assert.match(await page.textContent("#material-note"), /has no size/);
  assert.deepEqual(faults, []);
}
