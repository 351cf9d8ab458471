// Opens files: accepts programs; for anything else, returns one sentence with the reason.

export interface Refusal { head: string; text: string }
export type Opened = { bytes: Uint8Array; text: string } | Refusal;

/** Maximum size of a file, in bytes. A larger file would fill the memory of the tab. */
const LARGEST = 512 * 2 ** 20;
/** First bytes of files that users may take for programs. */
const SIGNATURES: [string, number[]][] = [
  ["a picture (PNG)", [0x89, 0x50, 0x4e, 0x47]], ["a picture (JPEG)", [0xff, 0xd8, 0xff]], ["a PDF", [0x25, 0x50, 0x44, 0x46]], ["a ZIP archive", [0x50, 0x4b, 3, 4]],
  ["a GZIP archive", [0x1f, 0x8b]], ["a picture (GIF)", [0x47, 0x49, 0x46, 0x38]], ["a program for Windows", [0x4d, 0x5a, 0x90]], ["a program for Linux", [0x7f, 0x45, 0x4c, 0x46]],
];
/** Number of bytes that are examined to tell text from binary. */
const LOOKED_AT = 65_536;

const size = (bytes: number): string => (bytes < 1024 ? `${bytes} bytes` : bytes < 2 ** 20 ? `${(bytes / 1024).toFixed(1)} KB` : `${(bytes / 2 ** 20).toFixed(1)} MB`);

export const tooLarge = (name: string, bytes: number): Refusal | undefined =>
  bytes > LARGEST ? { head: "This file is too large.", text: `${name} has ${size(bytes)}; this page reads up to ${size(LARGEST)}. No line of it was checked: use the program oxmill check.` } : undefined;

export function read(name: string, bytes: Uint8Array): Opened {
  if (bytes.length === 0) return { head: "This file is empty.", text: `${name} has 0 bytes. Was it saved by the CAM program, or is it still being written?` };
  const found = SIGNATURES.find(([, begin]) => begin.every((byte, index) => bytes[index] === byte));
  if (found) return { head: "This is not a G-code file.", text: `${name} looks like ${found[0]} (${size(bytes.length)}). No line of it was checked.` };
  const encoding = bytes[0] === 0xff && bytes[1] === 0xfe ? "utf-16le" : bytes[0] === 0xfe && bytes[1] === 0xff ? "utf-16be" : "utf-8";
  if (encoding !== "utf-8") {
    // Return the text as UTF-8, because the check must read the bytes that would be sent to the machine.
    const text = new TextDecoder(encoding).decode(bytes);
    return { bytes: new TextEncoder().encode(text), text };
  }
  if (bytes.subarray(0, LOOKED_AT).includes(0)) return { head: "This is not a G-code file.", text: `${name} has bytes in it that no text has (${size(bytes.length)}). No line of it was checked.` };
  return { bytes, text: new TextDecoder().decode(bytes) };
}

export const linesOf = (text: string): string[] => {
  const lines = text.split(/\r\n|\r|\n/);
  if (lines.at(-1) === "") lines.pop();
  return lines;
};
