// The sender alone, without a page: what it writes to its link, and what it makes of the answers.
import assert from "node:assert/strict";
import { build } from "esbuild";
import { fileURLToPath } from "node:url";

const entry = fileURLToPath(new URL("../src/sender.ts", import.meta.url));
const bundled = (await build({ entryPoints: [entry], bundle: true, write: false, format: "esm" })).outputFiles[0].text;
const { Sender } = await import(`data:text/javascript;base64,${Buffer.from(bundled).toString("base64")}`);

/** A sender with a link that keeps what is written; realtime commands apart. */
function connected() {
  const link = { lines: [], realtime: [], onsaid: () => {}, onlost: () => {}, close: () => {},
    write: bytes => bytes.length === 1 && bytes[0] !== 0x0a ? link.realtime.push(bytes[0]) : link.lines.push(Buffer.from(bytes).toString("latin1").trimEnd()) };
  const sender = new Sender(link);
  const refused = [];
  sender.onrefused = (line, answer) => refused.push(`${line} ${answer}`);
  return { link, sender, refused, say: text => link.onsaid(`${text}\r\n`) };
}

export async function a_line_is_sent_as_it_is_or_not_at_all() {
  const faulty = ["G1 X\u22125", "G1 X1?0", "G1 X1!0", "G1 X1~0", "G1 X\uFF15", "G1 X1\x180", "(a) X\u22125", "(a (b) \u2212 c)", "(a (b) ; c) X\u22125", "G1\uFEFFX1"];
  for (const line of faulty) {
    const { sender, link } = connected();
    assert.throws(() => sender.stream(`G21\n${line}\nG0 X0\n`), /^Error: line 2: .*\(U\+[0-9A-F]{4}\) has no place outside comments/, line);
    assert.match(await sender.command(line), /^not sent: /);
    assert.deepEqual([link.lines, link.realtime, sender.busy], [[], [], false], line);
  }
  const { sender, link } = connected();
  sender.stream("\uFEFF%\n% (end) (of) ; it\nG1\tX1\u00A02 (\u539F ! ~) Y2 ; \u2212?\n%G1 X5\n");
  assert.deepEqual(link.lines, ["G1 X1 2 (     ) Y2 ;", "%G1 X5"]);
}
