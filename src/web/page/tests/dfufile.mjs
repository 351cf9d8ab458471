// .dfu files for the tests.

export const FLASH = 0x0800_0000;

/** Returns the CRC-32 of DFU, which lacks the final inversion. */
export function checksum(bytes) {
  let crc = ~0;
  for (const byte of bytes) for (let bit = 0, one = crc ^ byte; bit < 8; bit++) crc = one = (one >>> 1) ^ (one & 1 ? 0xedb88320 : 0);
  return crc >>> 0;
}

/** Makes a .dfu file. `elements`: pairs of an address and the bytes at this address. */
export function dfu(elements, name = "Oxmill for blackpill_f411") {
  const word = value => [value & 255, (value >>> 8) & 255, (value >>> 16) & 255, value >>> 24];
  const body = elements.flatMap(([address, bytes]) => [...word(address), ...word(bytes.length), ...bytes]);
  const target = [...Buffer.from("Target"), 0, 1, 0, 0, 0, ...Buffer.from(name.padEnd(255, "\0")), ...word(body.length), ...word(elements.length), ...body];
  const whole = [...Buffer.from("DfuSe"), 1, ...word(11 + target.length), 1, ...target, 0xff, 0xff, 0x11, 0xdf, 0x83, 0x04, 0x1a, 0x01, ...Buffer.from("UFD"), 16];
  return Buffer.from([...whole, ...word(checksum(whole))]);
}

/** Returns the elements of a .dfu file with one target. */
export function elements(file) {
  const found = [];
  for (let at = 11 + 274; at < file.length - 16; ) {
    const [address, length] = [file.readUInt32LE(at), file.readUInt32LE(at + 4)];
    found.push({ address, bytes: file.subarray(at + 8, at + 8 + length) });
    at += 8 + length;
  }
  return found;
}
