// Loads firmware into a board over USB, by the boot loader in the ROM of an STM32 (DfuSe: ST's UM0391 and AN3156). If
// loading is interrupted, the board must not start half a program. So the sector with the vector table is erased first,
// and the block with the vector table is written last, after everything else.

/** A range of flash, and the bytes to write there. */
export interface FlashRange { address: number; bytes: Uint8Array }
/** Contents of a .dfu file: its own name, such as `Oxmill for blackpill_f411`, and its ranges. */
export interface Firmware { name: string; ranges: FlashRange[] }
/** A sector of flash that can be erased and written. */
export interface Sector { address: number; size: number }
/** Progress: what is being done, and how much of it, in bytes. */
export type Progress = (what: "erase" | "write" | "verify", done: number, of: number) => void;

/** The parts of WebUSB that are used here. */
export interface UsbDevice {
  open(): Promise<void>;
  close(): Promise<void>;
  selectConfiguration(value: number): Promise<void>;
  claimInterface(number: number): Promise<void>;
  selectAlternateInterface(number: number, alternate: number): Promise<void>;
  controlTransferOut(setup: UsbRequest, data: BufferSource): Promise<{ status: string }>;
  controlTransferIn(setup: UsbRequest, length: number): Promise<{ status: string; data?: DataView }>;
  readonly configuration: { interfaces: { interfaceNumber: number; alternates: UsbAlternate[] }[] } | null;
}
interface UsbRequest { requestType: "class" | "standard"; recipient: "interface" | "device"; request: number; value: number; index: number }
interface UsbAlternate { alternateSetting: number; interfaceClass: number; interfaceSubclass: number; interfaceName?: string }
/** The browser's access to USB devices. */
export interface Usb { requestDevice(options: { filters: { vendorId: number; productId: number }[] }): Promise<UsbDevice> }

/** USB vendor and product number of ST's boot loader. */
export const LOADER = { vendorId: 0x0483, productId: 0xdf11 };
/** Start of flash, with the vector table. */
const FLASH = 0x0800_0000;
/** Size of a block if the boot loader reports no valid size (all STM32F4: 2048 bytes). */
const BLOCK = 2048;

// Requests and states of DFU 1.1, and commands of DfuSe.
const DNLOAD = 1, UPLOAD = 2, GETSTATUS = 3, CLRSTATUS = 4, ABORT = 6;
const IDLE = 2, BUSY = 4, DOWNLOAD_IDLE = 5, ERROR = 10;
/** Status `errVENDOR` of DFU, a vendor-specific error. ST's boot loader reports a protected flash with it. */
const VENDOR = 11;
/** Maximum time of one command, ms. Erasing the largest sector takes at most 4 s (data sheets). */
const LONGEST = 10_000;
const SET_ADDRESS = 0x21, ERASE = 0x41;
/** Number of the first block of data. Blocks 0 and 1 are commands. */
const FIRST_BLOCK = 2;

const text = (bytes: Uint8Array): string => new TextDecoder().decode(bytes);
const word = (bytes: Uint8Array, at: number): number => new DataView(bytes.buffer, bytes.byteOffset).getUint32(at, true);
const hex = (address: number): string => `0x${address.toString(16).padStart(8, "0")}`;

/** Returns the CRC-32 of DFU, which lacks the final inversion. */
function checksum(bytes: Uint8Array): number {
  let crc = 0xffff_ffff;
  for (const byte of bytes) {
    crc ^= byte;
    for (let bit = 0; bit < 8; bit++) crc = (crc >>> 1) ^ (crc & 1 ? 0xedb8_8320 : 0);
  }
  return crc >>> 0;
}

/** Reads a .dfu file. Throws an error with one sentence if the file is not a .dfu file, is damaged, or is not for an
 * STM32. */
export function parse(file: Uint8Array): Firmware {
  if (file.length < 11 + 274 + 16 || text(file.subarray(0, 5)) !== "DfuSe") throw new Error("This is no .dfu file of DfuSe.");
  if (checksum(file.subarray(0, -4)) !== word(file, file.length - 4)) throw new Error("This .dfu file is damaged: its checksum is wrong. Get it again.");
  const suffix = file.subarray(-16);
  if (suffix[4] !== 0x83 || suffix[5] !== 0x04 || suffix[2] !== 0x11 || suffix[3] !== 0xdf) throw new Error("This .dfu file is not for the boot loader of an STM32.");
  const target = file.subarray(11, -16);
  const broken = new Error("This .dfu file is damaged: an element of it is cut off.");
  if (file[10] !== 1 || text(target.subarray(0, 6)) !== "Target" || target[6] !== 0) throw new Error("This .dfu file is not the firmware of a single board.");
  const ranges: FlashRange[] = [];
  let at = 274;
  for (let left = word(target, 270); left > 0; left--) {
    if (at + 8 > target.length) throw broken;
    const [address, size] = [word(target, at), word(target, at + 4)];
    if (at + 8 + size > target.length || size === 0) throw broken;
    ranges.push({ address, bytes: target.subarray(at + 8, at + 8 + size) });
    at += 8 + size;
  }
  if (at !== target.length) throw broken;
  ranges.sort((a, b) => a.address - b.address);
  ranges.forEach(({ address }, index) => {
    const before = ranges[index - 1];
    if (address % 4 !== 0 || (before && before.address + Math.ceil(before.bytes.length / 4) * 4 > address)) throw new Error("This .dfu file is damaged: its elements overlap.");
  });
  if (!ranges.some(({ address }) => address === FLASH)) throw new Error("This .dfu file has no program: nothing is at the start of the flash.");
  return { name: text(target.subarray(11, 11 + 255)).replace(/\0.*$/s, ""), ranges };
}

/** Reads the name of the boot loader's interface, such as `@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg`.
 * Returns the sectors that can be erased and written. */
export function sectorsOf(name: string): Sector[] {
  const sectors: Sector[] = [];
  const parts = name.split("/").slice(1);
  for (let part = 0; part + 1 < parts.length; part += 2) {
    let address = Number(parts[part]);
    for (const group of parts[part + 1].split(",")) {
      const found = /^\s*(\d+)\*(\d+)([ BKM])([a-g])\s*$/.exec(group);
      if (!found || !Number.isFinite(address)) return [];
      const size = Number(found[2]) * { " ": 1, B: 1, K: 1024, M: 1024 * 1024 }[found[3] as "B"];
      for (let number = 0; number < Number(found[1]); number++, address += size) {
        // The letter is a sum of 1 (readable), 2 (erasable) and 4 (writable); `a` is 1, and `g` is 7.
        if (found[4] === "g") sectors.push({ address, size });
      }
    }
  }
  return sectors;
}

/** The error that is thrown if the boot loader answers that it cannot carry out a command. */
class Refused extends Error {}

/** An open USB connection to the boot loader of one board, and the commands of DfuSe. */
class Loader {
  private constructor(private readonly device: UsbDevice, private readonly number: number, readonly sectors: Sector[], readonly block: number) {}

  /** Opens the device and selects its flash (a USB alternate setting). Closes the device if that fails. */
  static async open(device: UsbDevice): Promise<Loader> {
    await device.open();
    try {
      return await Loader.opened(device);
    } catch (error) {
      await device.close().catch(() => {});
      throw error;
    }
  }

  private static async opened(device: UsbDevice): Promise<Loader> {
    if (!device.configuration) await device.selectConfiguration(1);
    const descriptor = await descriptorOf(device, 0x0200, 0, 512);
    for (const { interfaceNumber, alternates } of device.configuration?.interfaces ?? []) {
      for (const { interfaceClass, interfaceSubclass, alternateSetting, interfaceName } of alternates) {
        // Some systems do not report the name. Then read it from the device.
        const name = interfaceName ?? (await nameOf(device, descriptor, interfaceNumber, alternateSetting));
        const sectors = sectorsOf(name);
        if (interfaceClass !== 0xfe || interfaceSubclass !== 1 || !sectors.some(({ address }) => address === FLASH)) continue;
        await device.claimInterface(interfaceNumber);
        await device.selectAlternateInterface(interfaceNumber, alternateSetting);
        const loader = new Loader(device, interfaceNumber, sectors, blockSize(descriptor));
        await loader.rest();
        return loader;
      }
    }
    throw new Error("This device is no boot loader with a flash.");
  }

  private async out(request: number, value: number, data: Uint8Array = new Uint8Array()): Promise<void> {
    const { status } = await this.device.controlTransferOut({ requestType: "class", recipient: "interface", request, value, index: this.number }, data as BufferSource);
    if (status !== "ok") throw new Error(`The boot loader refuses request ${request} (${status}).`);
  }

  private async in(request: number, value: number, length: number): Promise<Uint8Array> {
    const { status, data } = await this.device.controlTransferIn({ requestType: "class", recipient: "interface", request, value, index: this.number }, length);
    if (status !== "ok" || !data) throw new Error(`The boot loader refuses request ${request} (${status}).${request === UPLOAD ? " Is the chip protected against reading?" : ""}`);
    return new Uint8Array(data.buffer, data.byteOffset, data.byteLength);
  }

  private async status(): Promise<{ code: number; wait: number; state: number }> {
    const bytes = await this.in(GETSTATUS, 0, 6);
    return { code: bytes[0], wait: bytes[1] | (bytes[2] << 8) | (bytes[3] << 16), state: bytes[4] };
  }

  /** Brings the boot loader from any state to its idle state. */
  async rest(): Promise<void> {
    for (const until = Date.now() + LONGEST; Date.now() < until; ) {
      const { state, wait } = await this.status();
      if (state === IDLE) return;
      if (state === BUSY) await new Promise(done => setTimeout(done, wait));
      else await this.out(state === ERROR ? CLRSTATUS : ABORT, 0);
    }
    throw new Error("The boot loader does not come to rest: press NRST with BOOT0 held, and try again.");
  }

  /** Waits until the last command or block has been carried out. Throws `Refused` if that fails. */
  private async carriedOut(what: string): Promise<void> {
    let status = await this.status();
    for (const until = Date.now() + LONGEST; status.state === BUSY && Date.now() < until; status = await this.status()) {
      await new Promise(done => setTimeout(done, status.wait));
    }
    if (status.state !== DOWNLOAD_IDLE) throw new Refused(`The boot loader cannot ${what} (status ${status.code}).${status.code === VENDOR ? " The chip is protected against reading and writing." : ""}`);
  }

  private async command(code: number, address: number, what: string): Promise<void> {
    const bytes = new Uint8Array(5);
    bytes[0] = code;
    new DataView(bytes.buffer).setUint32(1, address, true);
    await this.out(DNLOAD, 0, bytes);
    await this.carriedOut(what);
  }

  erase(sector: Sector): Promise<void> {
    return this.command(ERASE, sector.address, `erase the sector at ${hex(sector.address)}`);
  }

  /** Writes one block, and waits until the boot loader has carried this out. */
  async write(address: number, bytes: Uint8Array): Promise<void> {
    const what = `write at ${hex(address)}`;
    await this.command(SET_ADDRESS, address, what);
    await this.out(DNLOAD, FIRST_BLOCK, bytes);
    await this.carriedOut(what);
  }

  /** Reads `length` bytes, at most one block. Afterwards the boot loader is in its idle state. */
  async read(address: number, length: number): Promise<Uint8Array> {
    await this.command(SET_ADDRESS, address, `read at ${hex(address)}`);
    await this.rest();
    const bytes = await this.in(UPLOAD, FIRST_BLOCK, length);
    await this.rest();
    return bytes;
  }

  /** Starts the program. The device leaves the bus, so the last answers may be missing. */
  async leave(): Promise<void> {
    await this.command(SET_ADDRESS, FLASH, "start the program");
    await this.out(DNLOAD, 0).catch(() => {});
    await this.status().catch(() => {});
  }

  async close(): Promise<void> {
    await this.device.close().catch(() => {});
  }
}

/** Returns a descriptor of the device; empty if the device does not give it. */
async function descriptorOf(device: UsbDevice, value: number, index: number, length: number): Promise<DataView> {
  const none = new DataView(new ArrayBuffer(0));
  return device.controlTransferIn({ requestType: "standard", recipient: "device", request: 6, value, index }, length).then(({ data }) => data ?? none, () => none);
}

/** Calls `call` with the offset, length and type of each descriptor within a configuration descriptor. */
function parts(descriptor: DataView, call: (at: number, length: number, type: number) => void): void {
  for (let at = 0; at + 2 <= descriptor.byteLength; at += descriptor.getUint8(at)) {
    const length = descriptor.getUint8(at);
    if (length < 2 || at + length > descriptor.byteLength) return;
    call(at, length, descriptor.getUint8(at + 1));
  }
}

/** Returns the size of a block from the functional descriptor of DFU (type 0x21, bytes 5 and 6). */
function blockSize(descriptor: DataView): number {
  let size = BLOCK;
  parts(descriptor, (at, length, type) => {
    if (type === 0x21 && length >= 7) size = descriptor.getUint16(at + 5, true);
  });
  return size >= 64 && size <= 4096 && size % 4 === 0 ? size : BLOCK;
}

/** Returns the name of an alternate setting, from its interface descriptor (type 4) and its string descriptor; empty if
 * it has none. */
async function nameOf(device: UsbDevice, descriptor: DataView, number: number, alternate: number): Promise<string> {
  let index = 0;
  parts(descriptor, (at, length, type) => {
    if (type === 4 && length >= 9 && descriptor.getUint8(at + 2) === number && descriptor.getUint8(at + 3) === alternate) index = descriptor.getUint8(at + 8);
  });
  if (index === 0) return "";
  const text = await descriptorOf(device, 0x0300 | index, 0x0409, 255);
  const letters = Array.from({ length: Math.max(0, Math.floor((text.byteLength - 2) / 2)) }, (_, letter) => text.getUint16(2 + 2 * letter, true));
  return String.fromCharCode(...letters);
}

/** Cuts ranges into blocks of at most `size` bytes. Fills each range up to whole words with 0xff, the value of erased
 * flash. */
function blocksOf(ranges: FlashRange[], size: number): FlashRange[] {
  return ranges.flatMap(({ address, bytes }) => {
    const whole = new Uint8Array(Math.ceil(bytes.length / 4) * 4).fill(0xff);
    whole.set(bytes);
    return Array.from({ length: Math.ceil(whole.length / size) }, (_, index) => ({ address: address + index * size, bytes: whole.subarray(index * size, (index + 1) * size) }));
  });
}

/** Sentence for the user about a board whose vector table is erased. */
const GONE = "The board has no program now and starts nothing: load it again. If it was switched off since, start its boot loader by BOOT0 and NRST.";

/** Returns a function that throws an error again, with a sentence about the board. */
const rethrowWith = (about: string) => (error: Error): never => {
  throw new Error(`${error.message} ${about}`.trim());
};

/** Calls `act` with each part, one after the other. Reports the progress in bytes: `size` returns the number of bytes
 * of a part. */
async function each<T>(parts: T[], size: (part: T) => number, what: Parameters<Progress>[0], progress: Progress, act: (part: T, isFirst: boolean) => Promise<void>): Promise<void> {
  const all = parts.reduce((sum, part) => sum + size(part), 0);
  let done = 0;
  for (const part of parts) {
    progress(what, done, all);
    await act(part, done === 0);
    done += size(part);
  }
  progress(what, done, all);
}

/** Loads firmware into a board, reads it back, and starts it. Sectors that the firmware does not touch, such as those
 * of the settings, keep their contents. An error says what has happened, and what the board does now. */
export async function load(device: UsbDevice, { ranges }: Firmware, progress: Progress): Promise<void> {
  const loader = await Loader.open(device);
  try {
    const end = ({ address, bytes }: FlashRange) => address + bytes.length;
    const overlaps = (sector: Sector) => ranges.some(range => range.address < sector.address + sector.size && sector.address < end(range));
    const touched = loader.sectors.filter(overlaps).sort((a, b) => a.address - b.address);
    const blocks = blocksOf(ranges, loader.block);
    const isInside = (at: number) => touched.some(({ address, size }) => address <= at && at < address + size);
    for (const at of blocks.flatMap(({ address, bytes }) => [address, address + bytes.length - 1])) {
      if (!isInside(at)) throw new Error(`This firmware does not fit into the chip: it has no flash at ${hex(at)}. Is the file for another board? Nothing was changed.`);
    }
    const write = async ({ address, bytes }: FlashRange) => {
      await loader.write(address, bytes).catch(rethrowWith(GONE));
    };
    const verify = async ({ address, bytes }: FlashRange, otherwise: string) => {
      const there = await loader.read(address, bytes.length).catch(rethrowWith(otherwise));
      if (there.length !== bytes.length || there.some((byte, index) => byte !== bytes[index])) throw new Error(`What was read back at ${hex(address)} is not what was written. ${otherwise}`.trim());
    };
    const size = ({ bytes }: FlashRange) => bytes.length;
    await each(touched, ({ size }) => size, "erase", progress, async (sector, isFirst) => {
      await loader.erase(sector).catch(error => rethrowWith(isFirst && error instanceof Refused ? "Nothing was changed." : GONE)(error));
    });
    // Write the block with the vector table only after everything else has been read back, so that an unverified
    // program cannot start.
    const [vectors, others] = [blocks.filter(({ address }) => address === FLASH), blocks.filter(({ address }) => address !== FLASH)];
    await each(others, size, "write", progress, write);
    await each(others, size, "verify", progress, block => verify(block, GONE));
    await each(vectors, size, "write", progress, write);
    await each(vectors, size, "verify", progress, async block => {
      try {
        await verify(block, "");
      } catch (error) {
        const isErased = await loader.erase(touched[0]).then(() => true, () => false);
        throw rethrowWith(isErased ? GONE : "Do not start the board: load it again.")(error as Error);
      }
    });
    // The program is complete. Ignore errors of this request: the device leaves the bus.
    await loader.leave().catch(() => {});
  } finally {
    await loader.close();
  }
}
