// The sender alone, without a page: what it writes to its link, and how it handles the answers.
import assert from "node:assert/strict";
import { build } from "esbuild";
import { fileURLToPath } from "node:url";

const entry = fileURLToPath(new URL("../src/sender.ts", import.meta.url));
const bundled = (await build({ entryPoints: [entry], bundle: true, write: false, format: "esm" })).outputFiles[0].text;
const { Sender } = await import(`data:text/javascript;base64,${Buffer.from(bundled).toString("base64")}`);

/** Returns a sender with a link that records what is written: lines in `lines`, realtime commands in `realtime`. */
function connected() {
  const link = { lines: [], realtime: [], onsaid: () => {}, onlost: () => {}, close: () => {},
    write: bytes => bytes.length === 1 && bytes[0] !== 0x0a ? link.realtime.push(bytes[0]) : link.lines.push(Buffer.from(bytes).toString("latin1").trimEnd()) };
  const sender = new Sender(link);
  const refused = [];
  sender.onrefused = (line, answer) => refused.push(`${line} ${answer}`);
  const stopped = [];
  sender.onstopped = (line, why) => stopped.push(`${line} ${why}`);
  return { link, sender, refused, stopped, say: text => link.onsaid(`${text}\r\n`) };
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

export async function a_tape_mark_between_two_programs_is_sent() {
  for (const [hasTapeMarks, marks] of [[true, ["%"]], [false, []]]) {
    const { sender, link, say } = connected();
    sender.hasTapeMarks = hasTapeMarks;
    sender.stream("%\nO1\nM30\n%\n(next)\nO2\nM30\n% (end)\n(no more)\n");
    assert.deepEqual(link.lines, ["O1", "M30", ...marks, "(next)", "O2", "M30", "(no more)"]);
    for (const _ of link.lines) say("ok");
    assert.deepEqual([sender.busy, sender.done], [false, 9]);
  }
}

export async function a_second_job_is_refused_until_the_first_is_answered() {
  const { sender, link, say } = connected();
  sender.stream("G91\nG0 X1\n");
  assert.throws(() => sender.stream("G91\nG0 X1\n"), /not answered yet/);
  say("ok");
  assert.throws(() => sender.stream("G0 X3\n"), /not answered yet/);
  say("ok");
  sender.stream("G0 X2\n");
  assert.deepEqual(link.lines, ["G91", "G0 X1", "G0 X2"]);
}

/** Returns a sender in the middle of a job of 40 lines, after two answers. The lines in flight fill a buffer of 128
 * bytes. */
function inMidJob() {
  const all = connected();
  all.sender.stream("G1 X1 F100\n".repeat(40));
  assert.equal(all.link.lines.length, 11);
  all.say("ok\r\nok");
  assert.equal(all.link.lines.length, 13);
  return all;
}

export async function a_refused_line_holds_the_machine_and_ends_the_job() {
  const { sender, link, refused, stopped, say } = inMidJob();
  say("error:20");
  assert.deepEqual([link.lines.length, link.realtime, stopped], [13, [0x21], ["13 line 3 was refused (error:20)"]]);
  for (let line = 4; line < 13; line++) say("ok");
  assert(sender.busy);
  say("error:33");
  assert(!sender.busy && sender.free);
  assert.deepEqual([refused, link.realtime.length, stopped.length], [["3 error:20", "13 error:33"], 1, 1]);
  // If the last line of a job is rejected, no line follows, so the machine is not held.
  sender.stream("G1 X1\nG999\n");
  say("ok\r\nerror:20");
  assert.deepEqual([refused[2], link.realtime.length, stopped.length], ["2 error:20", 1, 1]);
}

export async function an_alarm_ends_the_job() {
  const { sender, link, stopped, say } = inMidJob();
  const waiting = sender.command("G0 Z5 (a line for which there is no room)");
  say("ALARM:1");
  assert.equal(await waiting, "not sent: ALARM:1");
  for (let line = 3; line <= 13; line++) say("error:9");
  assert.deepEqual([link.lines.length, link.realtime, stopped, sender.free], [13, [], ["13 ALARM:1"], true]);
}

export async function a_reset_that_the_page_did_not_order_ends_the_job() {
  const { sender, link, stopped, say } = inMidJob();
  let greetings = 0;
  sender.ongreeting = () => greetings++;
  say("\r\nGrbl 1.1h ['$' for help]");
  assert.deepEqual([sender.lines, sender.free, stopped, greetings], [[], true, ["2 the machine was reset"], 1]);
  // An answer to an old line may still arrive. It must not count for a later line.
  const unlocked = sender.command("$X");
  say("ok");
  assert.equal(link.lines.length, 13);
  await new Promise(resolve => setTimeout(resolve, 400));
  assert.deepEqual(link.lines.slice(13), ["$X"]);
  say("ok");
  assert.equal(await unlocked, "ok");
  // A reset by the sender itself also ends the job. The next line then waits for the welcome message, and no longer.
  sender.stream("G4 P1\n");
  sender.reset();
  const after = sender.command("$X");
  say("ok\r\nALARM:3");
  assert.deepEqual([link.realtime, link.lines.slice(14)], [[0x18], ["G4 P1"]]);
  say("Grbl 1.1h ['$' for help]");
  assert.deepEqual([link.lines.slice(15), greetings], [["$X"], 1]);
  say("ok");
  assert.equal(await after, "ok");
}

export async function answers_count_whatever_becomes_of_what_is_shown() {
  const { sender, say } = connected();
  const { error } = console;
  const told = [];
  console.error = failure => told.push(failure.message);
  sender.onstatus = () => { throw new Error("not shown"); };
  sender.stream("G4 P1\n");
  say("<Idle|MPos:0.000,0.000,0.000|Ov:100,100,100,100>\r\nok");
  console.error = error;
  assert.deepEqual([sender.free, told], [true, ["not shown"]]);
}

export async function what_is_said_before_an_answer_is_told_with_it() {
  const { sender, say } = connected();
  const messages = [];
  sender.onmessage = text => messages.push(text);
  const [modes, settings, again] = [sender.ask("$G"), sender.ask("$$", true), sender.ask("$$")];
  say("[GC:G0 G54]\r\nok\r\n$13=1\r\n[MSG:Caution]\r\nok\r\n$13=0\r\nok");
  assert.deepEqual(await modes, { answer: "ok", said: ["[GC:G0 G54]"] });
  assert.deepEqual(await settings, { answer: "ok", said: ["$13=1", "[MSG:Caution]"] });
  assert.deepEqual(await again, { answer: "ok", said: ["$13=0"] });
  assert.deepEqual(messages, ["[GC:G0 G54]", "[MSG:Caution]", "$13=0"]);
  const reports = [];
  sender.onstatus = status => reports.push([...status.machine, ...status.work]);
  sender.unit = 25.4;
  say("<Idle|MPos:1.0000,2.0000,0.0000|FS:0,0|WCO:0.5000,0.0000,0.0000>");
  assert.deepEqual(reports, [[25.4, 50.8, 0, 12.7, 50.8, 0]]);
}
