// Tests the loading of firmware into a board. The boot loader is a model in this file, after ST's UM0391 and AN3156.
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { readFileSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { join } from "node:path";
import { open, tab } from "./browser.mjs";
import { checksum, dfu, elements, FLASH } from "./dfufile.mjs";
import { BLACKPILL, site } from "./imagesite.mjs";
import { folder, oxmill, page as file, root } from "./program.mjs";

const axe = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const F411 = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg";
const F401 = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,01*128Kg";

const noise = (length, seed) => Uint8Array.from({ length }, (_, at) => (at * 31 + seed * 17 + (at >> 8)) & 255);
/** The two parts of an image. `PROGRAM` starts at sector 3, and its length is not a multiple of 4 bytes. `VECTORS` is
 * for sector 0. */
const PROGRAM = noise(150_001, 3), VECTORS = noise(9_000, 5);
const IMAGE = dfu([[FLASH + 0xc000, PROGRAM], [FLASH, VECTORS]]);

/** Installs a model of a boot loader in the page. This function runs in the page. */
function bootLoader({ layout, failAt, breakAt, unnamed, lostAt, failsErase }) {
  const [IDLE, SYNC, BUSY, DOWNLOAD_IDLE, MANIFEST, UPLOAD_IDLE, ERROR] = [2, 3, 4, 5, 7, 9, 10];
  const flash = globalThis.flash ?? new Uint8Array(512 * 1024).fill(0x5a);
  const model = { flash, erased: [], written: [], read: [], started: false, state: ERROR, code: 11 };
  Object.assign(globalThis, { flash, model });
  const sizes = [16, 16, 16, 16, 64, 128, 128, 128].map(kib => kib * 1024);
  const sectors = sizes.map((size, index) => ({ address: sizes.slice(0, index).reduce((sum, one) => sum + one, 0), size }));
  let pending, address = 0, writes = 0;
  const stall = { status: "stall" };
  const fail = code => Object.assign(model, { state: ERROR, code });
  const carryOut = () => {
    const { block, data } = pending;
    pending = undefined;
    const at = data.length === 5 && new DataView(data.buffer, data.byteOffset).getUint32(1, true) - 0x0800_0000;
    if (block === 0 && data[0] === 0x21) address = at;
    else if (block === 0 && data[0] === 0x41) {
      const sector = sectors.find(one => one.address <= at && at < one.address + one.size);
      if (!sector) return fail(8);
      if (failsErase) return fail(11);
      model.erased.push(sector.address);
      flash.fill(0xff, sector.address, sector.address + sector.size);
    } else if (block >= 2) {
      const from = address + (block - 2) * 2048;
      if (++writes === failAt) return fail(3);
      if (writes === lostAt) {
        // From here on the device does not answer.
        model.started = true;
        throw new Error("The device was disconnected.");
      }
      model.written.push(from);
      // Programming clears bits and sets none.
      data.forEach((byte, index) => (flash[from + index] &= byte));
      if (breakAt !== undefined && from <= breakAt && breakAt < from + data.length) flash[breakAt] ^= 1;
    } else return fail(1);
    model.state = BUSY;
  };
  const device = {
    configuration: null,
    async open() {},
    async close() {},
    async selectConfiguration() {
      device.configuration = { interfaces: [{ interfaceNumber: 0, alternates: [
        { alternateSetting: 1, interfaceClass: 0xfe, interfaceSubclass: 1, interfaceName: "@Option Bytes  /0x1FFFC000/01*016 e" },
        { alternateSetting: 0, interfaceClass: 0xfe, interfaceSubclass: 1, interfaceName: unnamed ? undefined : layout }] }] };
    },
    async claimInterface() {},
    async selectAlternateInterface(_, alternate) {
      model.alternate = alternate;
    },
    async controlTransferOut({ request, value }, data) {
      if (model.started) throw new Error("The device was disconnected.");
      if (request === 4 && model.state === ERROR) Object.assign(model, { state: IDLE, code: 0 });
      else if (request === 6 && model.state !== ERROR) model.state = IDLE;
      else if (request === 1 && [IDLE, DOWNLOAD_IDLE].includes(model.state)) {
        pending = { block: value, data: new Uint8Array(data.buffer.slice(data.byteOffset, data.byteOffset + data.byteLength)) };
        model.state = pending.data.length === 0 && value === 0 ? MANIFEST : SYNC;
      } else {
        fail(14);
        return stall;
      }
      return { status: "ok" };
    },
    async controlTransferIn({ requestType, request, value }, length) {
      if (model.started) throw new Error("The device was disconnected.");
      if (requestType === "standard" && value >> 8 === 2) return { status: "ok", data: new DataView(Uint8Array.of(9, 2, 27, 0, 1, 1, 0, 0xc0, 50, 9, 4, 0, 0, 0, 0xfe, 1, 2, 4, 9, 0x21, 0x0b, 255, 0, 0, 8, 0x1a, 1).buffer) };
      if (requestType === "standard") {
        if (value !== 0x0304) return stall;
        const text = new DataView(new ArrayBuffer(2 + 2 * layout.length));
        [...layout].forEach((letter, index) => text.setUint16(2 + 2 * index, letter.charCodeAt(0), true));
        return { status: "ok", data: text };
      }
      if (request === 3) {
        if (model.state === SYNC) carryOut();
        else if (model.state === BUSY) model.state = DOWNLOAD_IDLE;
        else if (model.state === MANIFEST) model.started = true;
        return { status: "ok", data: new DataView(Uint8Array.of(model.state === ERROR ? model.code : 0, 1, 0, 0, model.state, 0).buffer) };
      }
      if (request !== 2 || ![IDLE, UPLOAD_IDLE].includes(model.state) || value < 2) {
        fail(14);
        return stall;
      }
      model.state = UPLOAD_IDLE;
      const from = address + (value - 2) * 2048;
      model.read.push(from);
      return { status: "ok", data: new DataView(flash.slice(from, from + length).buffer) };
    },
  };
  Object.defineProperty(navigator, "usb", { configurable: true, value: {
    async requestDevice({ filters }) {
      model.filters = filters;
      return device;
    } } });
}

/** Chooses a file in the open dialog. Returns what the dialog then says about the file. */
async function choose(page, bytes, name = "blackpill_f411.dfu") {
  await page.setInputFiles("#firmware-file", { name, mimeType: "application/octet-stream", buffer: bytes });
  await page.waitForFunction(() => document.getElementById("firmware-note").textContent !== "");
  return page.textContent("#firmware-note");
}

async function dialog(browser, model) {
  const { page, faults } = await open(browser, file);
  await page.evaluate(bootLoader, model);
  await tab(page, "run");
  await page.click("#open-firmware");
  return { page, faults };
}

const GO = "text=Choose the boot loader and load…";

/** Loads the chosen file. Returns the last note of the page (`said`), what the model has recorded, and the first 8
 * bytes of its flash (`begin`). */
async function loaded(page) {
  await page.click(GO);
  await page.waitForFunction(() => document.querySelector("#firmware-note.finding") !== null && !/ %$/.test(document.getElementById("firmware-note").textContent));
  const seen = await page.evaluate(() => ({ ...model, flash: undefined, begin: [...flash.slice(0, 8)] }));
  return { said: await page.textContent("#firmware-note"), ...seen };
}

const bytesAt = (page, from, length) => page.evaluate(([from, length]) => [...flash.slice(from, from + length)], [from, length]);

export async function firmware_is_loaded_read_back_and_started(browser) {
  const { page, faults } = await dialog(browser, { layout: F411 });
  assert(await page.locator(GO).isDisabled(), "there is no file yet");
  assert.match(await choose(page, IMAGE), /^Oxmill for blackpill_f411, 155 KiB\. It has no pin table: /);
  const { said, erased, written, read, started, alternate, filters } = await loaded(page);
  assert.match(said, /^Oxmill for blackpill_f411 is loaded and was read back without a difference\. The settings of the board are kept\./);
  assert.deepEqual([started, alternate, filters], [true, 0, [{ vendorId: 0x0483, productId: 0xdf11 }]]);
  assert.deepEqual(erased, [0, 0xc000, 0x1_0000, 0x2_0000], "the sector of the vector table first, those of the settings not");
  assert.equal(written.at(-1), 0, "the vector table last");
  assert.equal(read.indexOf(0), read.length - 1, "after everything else was read back");
  assert.equal(new Set(written).size, written.length);
  assert.deepEqual(await bytesAt(page, 0, VECTORS.length), [...VECTORS]);
  assert.deepEqual(await bytesAt(page, 0xc000, PROGRAM.length), [...PROGRAM]);
  assert((await bytesAt(page, 0x4000, 0x8000)).every(byte => byte === 0x5a), "the settings are kept");
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  assert.deepEqual(violations.map(({ id, nodes }) => `${id}: ${nodes[0].html}`), []);
  assert.deepEqual(faults, []);
}

export async function an_interrupted_load_leaves_no_program_that_starts(browser) {
  const { page } = await dialog(browser, { layout: F411, failAt: 40 });
  await choose(page, IMAGE);
  const first = await loaded(page);
  assert.match(first.said, /cannot write at 0x0801d800 \(status 3\).* The board has no program now and starts nothing: load it again\./);
  assert.deepEqual([first.started, first.begin], [false, Array(8).fill(0xff)]);
  // The boot loader reports its error until a request clears it. The next attempt must send this request.
  await page.evaluate(bootLoader, { layout: F411 });
  const second = await loaded(page);
  assert.match(second.said, /is loaded/);
  assert.deepEqual(await bytesAt(page, 0, VECTORS.length), [...VECTORS]);
}

export async function a_cable_that_is_pulled_leaves_no_program_that_starts(browser) {
  const { page } = await dialog(browser, { layout: F411, lostAt: 60 });
  await choose(page, IMAGE);
  const { said, begin } = await loaded(page);
  assert.match(said, /^The device was disconnected\. The board has no program now and starts nothing.* by BOOT0 and NRST\.$/);
  assert.deepEqual(begin, Array(8).fill(0xff));
}

export async function a_protected_chip_stays_as_it_is(browser) {
  const { page } = await dialog(browser, { layout: F411, failsErase: true });
  await choose(page, IMAGE);
  const { said, begin } = await loaded(page);
  assert.match(said, /protected against reading and writing\. Nothing was changed\.$/);
  assert.deepEqual(begin, Array(8).fill(0x5a));
}

/** Some systems do not pass the names of interfaces on. */
export async function the_sectors_are_found_without_a_name_of_the_interface(browser) {
  const { page } = await dialog(browser, { layout: F411, unnamed: true });
  await choose(page, IMAGE);
  assert.match((await loaded(page)).said, /is loaded/);
}

export async function firmware_that_reads_back_differently_does_not_start(browser) {
  const { page } = await dialog(browser, { layout: F411, breakAt: 0xc000 + 70_000 });
  await choose(page, IMAGE);
  const { said, started, begin } = await loaded(page);
  assert.match(said, /^What was read back at 0x0801d000 is not what was written\. The board has no program now/);
  assert.deepEqual([started, begin], [false, Array(8).fill(0xff)]);
}

export async function files_that_are_no_firmware_for_the_chip_are_refused(browser) {
  const { page } = await dialog(browser, { layout: F401 });
  const damaged = Buffer.from(IMAGE);
  damaged[5_000] ^= 1;
  const foreign = Buffer.from(IMAGE);
  foreign.set([0, 0], foreign.length - 14);
  foreign.writeUInt32LE(checksum(foreign.subarray(0, -4)), foreign.length - 4);
  for (const [bytes, wanted] of [
    [Buffer.from("G21 G90\nG0 X1\n".repeat(50)), /^This is no \.dfu file of DfuSe\.$/],
    [damaged, /damaged: its checksum is wrong/],
    [IMAGE.subarray(0, 4_000), /damaged: its checksum is wrong/],
    [foreign, /not for the boot loader of an STM32/],
    [dfu([[FLASH + 0xc000, PROGRAM]]), /nothing is at the start of the flash/],
    [dfu([[FLASH, VECTORS], [FLASH + 8_000, VECTORS]]), /its elements overlap/],
    [dfu([[FLASH, VECTORS], [FLASH + 0xc002, VECTORS]]), /its elements overlap/],
  ]) {
    assert.match(await choose(page, bytes), wanted);
    assert(await page.locator(GO).isDisabled());
  }
  // An F401 has 256 KiB of flash. This image reaches beyond.
  await choose(page, dfu([[FLASH + 0x3_f000, noise(8_192, 1)], [FLASH, VECTORS]]));
  const { said, erased, begin } = await loaded(page);
  assert.match(said, /does not fit into the chip: it has no flash at 0x08040000.* Nothing was changed\.$/);
  assert.deepEqual([erased, begin], [[], Array(8).fill(0x5a)]);
}

export async function without_webusb_the_page_says_so(browser) {
  const { page } = await open(browser, file, { prepare: page => page.addInitScript(() => delete Navigator.prototype.usb) });
  await tab(page, "run");
  await page.click("#open-firmware");
  await page.click("text=Other pins than those of the board");
  assert(await page.locator("#firmware-nousb").isVisible());
  assert(await page.locator(GO).isDisabled());
  // In such a browser, an image and a pin table can still be combined and saved.
  await choose(page, BLACKPILL);
  assert.match(await page.textContent("#firmware-note"), /^Oxmill for blackpill_f411, /);
  assert(await page.locator("text=Save this image").isEnabled());
}

const TABLE = readFileSync(join(root, "boards/tables/blackpill_f411.toml"), "utf8");
/** A pin table of one's own: another name, and two pins exchanged. */
const MINE = TABLE.replace('name = "blackpill_f411"', 'name = "my_mill"').replace('flood = "B8"', 'flood = "B5"').replace('hold = "B5"', 'hold = "B8"');

const note = page => page.textContent("#firmware-note");
const says = (page, wanted) => page.waitForFunction(wanted => RegExp(wanted).test(document.getElementById("firmware-note").textContent), wanted);
const choosePins = (page, text) => page.setInputFiles("#firmware-pins", { name: "mine.toml", mimeType: "text/plain", buffer: Buffer.from(text) });
const saved = async (page, name) => {
  const [download] = await Promise.all([page.waitForEvent("download"), page.click(`text=${name}`)]);
  return readFileSync(await download.path());
};

export async function a_site_offers_the_images_that_it_carries(browser) {
  const { url, release, stop } = await site();
  try {
    const { page, faults } = await open(browser, url);
    assert.match(await page.getAttribute("meta[http-equiv=Content-Security-Policy]", "content"), /connect-src 'self';/);
    await page.evaluate(bootLoader, { layout: F411 });
    await tab(page, "run");
    await page.click("#open-firmware");
    await page.waitForFunction(() => document.querySelectorAll("#firmware-board option").length === 5);
    await page.selectOption("#firmware-board", "spider_f446");
    await says(page, "^The site does not give firmware/spider_f446\\.dfu \\(404\\)$");
    assert(await page.locator(GO).isDisabled());
    await page.selectOption("#firmware-board", "octopus_f446");
    await says(page, "^The site gives another image than that of octopus_f446\\.$");
    assert(await page.locator(GO).isDisabled());
    // An image that arrives late does not replace an image that was chosen after it.
    await page.selectOption("#firmware-board", "skr2_f407");
    await says(page, "^Getting the image…$");
    await page.selectOption("#firmware-board", "blackpill_f411");
    await says(page, "^Oxmill for blackpill_f411, \\d+ KiB\\.$");
    release();
    await page.waitForTimeout(300);
    assert.match(await note(page), /^Oxmill for blackpill_f411, \d+ KiB\.$/);
    assert.match((await loaded(page)).said, /^Oxmill for blackpill_f411 is loaded/);
    // A file that the user chooses replaces the board's image.
    await choose(page, dfu([[FLASH, VECTORS]], "Another firmware"));
    await says(page, "^Another firmware, 9 KiB\\. It has no pin table: it is firmware of another project\\.$");
    assert.equal(await page.inputValue("#firmware-board"), "");
    assert.deepEqual(faults.filter(fault => !/404/.test(fault)), []);
  } finally {
    stop();
  }
}

/** Some servers answer every request with their own page, and others with a list of another form. */
export async function a_list_of_images_that_is_none_is_left_alone(browser) {
  for (const list of ["<!doctype html>", "{}", '[{"board":"../x","title":"X"},{"board":1},null]']) {
    const { url, stop } = await site(list);
    try {
      const { page, faults } = await open(browser, url);
      await page.evaluate(bootLoader, { layout: F411 });
      await tab(page, "run");
      await page.click("#open-firmware");
      await page.waitForFunction(() => document.querySelectorAll("#firmware-board option").length === 1);
      assert(await page.locator("#firmware-board").isHidden());
      assert.deepEqual(faults, []);
    } finally {
      stop();
    }
  }
}

/** The single-file page carries no images, and requests none. */
export async function the_single_file_offers_no_images(browser) {
  const { page, faults } = await dialog(browser, { layout: F411 });
  await page.waitForFunction(() => document.querySelectorAll("#firmware-board option").length === 1);
  assert(await page.locator("#firmware-board").isHidden());
  assert.equal(await page.evaluate(() => document.activeElement.id), "firmware-file");
  assert.deepEqual(faults, []);
}

/** The page checks a pin table and writes it into an image. The bytes are the same as from `oxmill board write`. */
export async function pins_are_changed_without_a_compiler(browser) {
  const { page, faults } = await dialog(browser, { layout: F411 });
  const OWN = "^Oxmill for blackpill_f411, \\d+ KiB\\.$";
  await page.click("text=Other pins than those of the board");
  await choose(page, BLACKPILL);
  await says(page, OWN);
  assert.equal((await saved(page, "Save the board's pin table")).toString(), TABLE);
  await choosePins(page, MINE);
  await says(page, "^Oxmill for blackpill_f411, \\d+ KiB\\. With the pins of my_mill\\.$");
  const changed = await saved(page, "Save this image");
  writeFileSync(join(folder, "mine.toml"), MINE);
  const written = spawnSync(oxmill, ["board", "write", join(root, "target/boards/blackpill_f411.dfu"), join(folder, "mine.toml"), "-o", join(folder, "mine.dfu")], { encoding: "utf8" });
  assert.equal(written.status, 0, written.stderr);
  assert(changed.equals(readFileSync(join(folder, "mine.dfu"))), "the same bytes as from the program");
  assert(!changed.equals(BLACKPILL));
  assert.match((await loaded(page)).said, /is loaded and was read back without a difference\. With the pins of my_mill\./);
  const [vectors] = elements(changed).filter(({ address }) => address === FLASH);
  assert.deepEqual(await bytesAt(page, 0, vectors.bytes.length), [...vectors.bytes]);
  // All faults are listed, with their lines; nothing can be loaded or saved.
  const refused = async (text, wanted) => {
    await choosePins(page, text);
    await says(page, wanted);
    assert(await page.locator(GO).isDisabled());
    assert(await page.locator("text=Save this image").isDisabled());
  };
  await refused(MINE.replace('mist = "B9"', 'mist = "B5"').replace('probe = "B15"', 'probe = "C20"'), "^The pin table has faults:\\nline \\d+: .*B5.*\\nline \\d+: .*C20");
  await refused(MINE.replace('image = "blackpill_f411"', 'image = "blackpill_f401"').replace('chip = "STM32F411CE"', 'chip = "STM32F401CC"'), "^the table is for another image");
  await refused(" ".repeat(70_000), "^mine\\.toml is too large to be a pin table\\.$");
  // A changed table with the name of the board would be taken for the board's own table.
  await choosePins(page, MINE.replace("my_mill", "blackpill_f411"));
  await says(page, "^Oxmill for blackpill_f411, \\d+ KiB\\. blackpill_f411 is the name of another pin table: give yours a name of its own\\.$");
  await page.click("text=Use the board's own pins");
  await says(page, OWN);
  assert(await page.locator(GO).isEnabled());
  // If an image that was saved with other pins is opened again, the page names its pin table.
  await choose(page, changed);
  await says(page, "With the pins of my_mill\\.$");
  await page.click("text=Save the board's pin table");
  await says(page, "^The pins of my_mill are no pin table of this page");
  await page.evaluate(axe);
  const { violations } = await page.evaluate(() => globalThis.axe.run());
  assert.deepEqual(violations.map(({ id, nodes }) => `${id}: ${nodes[0].html}`), []);
  assert.deepEqual(faults, []);
}
