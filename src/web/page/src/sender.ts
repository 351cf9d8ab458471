// Sends lines by Grbl's protocol over any link. Counts characters, so that the controller's receive buffer never
// overflows. Realtime commands go out at once, before waiting lines.

export interface Link {
  write(bytes: Uint8Array): void;
  /** Called with output of the machine. */
  onsaid: (text: string) => void;
  /** Called when the connection is lost. */
  onlost: (why: string) => void;
  close(): Promise<void> | void;
  /** Whether the machine is just being powered up, so that a welcome message will follow. */
  readonly greets?: boolean;
}

/** A status report; positions in mm. */
export interface Status {
  state: string;
  machine: number[];
  work: number[];
  fields: Record<string, string>;
}

/** Bytes of the realtime commands, as in Grbl. */
export const REALTIME = {
  status: 0x3f, hold: 0x21, resume: 0x7e, reset: 0x18, door: 0x84, jogCancel: 0x85,
  feed100: 0x90, feedPlus: 0x91, feedMinus: 0x92, rapid100: 0x95, rapid50: 0x96, rapid25: 0x97,
  spindle100: 0x99, spindlePlus: 0x9a, spindleMinus: 0x9b, spindleStop: 0x9e,
  feedPlus1: 0x93, feedMinus1: 0x94, spindlePlus1: 0x9c, spindleMinus1: 0x9d,
} as const;

/** Maximum time until a controller sends its welcome after a reset, ms. */
const LONGEST_RESET = 2000;
/** Maximum time until a controller sends its welcome after power-up, ms. */
const LONGEST_START = 60_000;
/** Pause after an unexpected welcome message, ms. No line is written during the pause. */
const SETTLING = 300;
/** Number of linear axes: X, Y and Z. */
const LINEAR = 3;
/** Assumed size of the receive buffer if the controller does not report it, bytes. */
const SMALLEST_BUFFER = 128;

const UNCHECKED = "with checked lines each line has a number, a length and a checksum, and this page sends plain ones";

/** The answer to a line, and the output between the previous answer and this one. */
export interface Answer { answer: string; said: string[] }
interface Command { text: string; quiet: boolean; answered: (answer: Answer) => void }
interface Sent { length: number; line?: number; command?: Command; said: string[] }

export class Sender {
  onstatus: (status: Status) => void = () => {};
  onmessage: (text: string) => void = () => {};
  onprogress: () => void = () => {};
  onrefused: (line: number, answer: string) => void = () => {};
  /** Called when a job ends before its last line. `line`: the last line that was sent. If the machine was reset,
   * `line` is the last line that was answered. */
  onstopped: (line: number, why: string) => void = () => {};
  /** Called when the machine restarts without a reset by this sender: after a reset button, a supply dip or a reset by
   * another host. */
  ongreeting: () => void = () => {};
  /** Lines of the job. */
  lines: string[] = [];
  /** Number of answered lines of the job. */
  done = 0;
  /** Size of the controller's receive buffer, bytes. */
  room = SMALLEST_BUFFER;
  /** Millimetres per unit in which the controller reports positions (`$13`). */
  unit = 1;
  /** Whether the machine supports tape marks (`%`), which Grbl's dialect does not have. */
  hasTapeMarks = false;
  private next = 0;
  /** Indices of the first and the last line with words: not empty, no tape mark, and not beginning with a comment. */
  private firstWords = 0;
  private lastWords = 0;
  private stopped = false;
  private resetting = false;
  private silence?: ReturnType<typeof setTimeout>;
  private readonly commands: Command[] = [];
  private flight: Sent[] = [];
  private received = "";
  private offset: number[] = [];

  constructor(private readonly link: Link) {
    link.onsaid = text => this.receive(text);
    if (link.greets) this.expectGreeting(LONGEST_START);
  }

  /** `true` while lines of a job are still to be sent or answered. */
  get busy(): boolean {
    return this.done < this.lines.length;
  }

  realtime(command: number): void {
    this.link.write(new Uint8Array([command]));
  }

  /** Number of lines of the job that have been sent. */
  get sent(): number {
    return this.next;
  }

  /** Sends a line between those of the job. Returns its answer with the output before it. With `quiet`, `onmessage`
   * receives only lines that begin with `[MSG:`, `ALARM:` or `Grbl `. */
  ask(text: string, quiet = false): Promise<Answer> {
    const why = unsendable(text);
    if (why) return Promise.resolve({ answer: `not sent: ${why}`, said: [] });
    return new Promise(resolve => {
      this.commands.push({ text, quiet, answered: resolve });
      this.pump();
    });
  }

  /** Like `ask`, but returns only the answer. */
  async command(text: string): Promise<string> {
    return (await this.ask(text)).answer;
  }

  /** `true` if the sender has no work. Only queries may still be waiting or unanswered. */
  get free(): boolean {
    return !this.busy && this.flight.every(({ command }) => command?.quiet) && this.commands.every(({ quiet }) => quiet);
  }

  /** Starts a job. Throws if earlier lines are unanswered, or if a line cannot be sent unchanged. Then nothing of the
   * job is sent. */
  stream(text: string): void {
    if (!this.free) throw new Error("the lines before it are not answered yet");
    const lines = text.replace(/^\uFEFF/, "").split(/\r\n|\r|\n/);
    if (lines.at(-1) === "") lines.pop();
    for (const [index, line] of lines.entries()) {
      const why = unsendable(line);
      if (why) throw new Error(`line ${index + 1}: ${why}`);
    }
    this.lines = lines;
    const hasWords = (line: string) => !TAPE_MARK.test(line) && !/^\s*([(;]|$)/.test(line);
    [this.firstWords, this.lastWords] = [lines.findIndex(hasWords), lines.findLastIndex(hasWords)];
    [this.next, this.done, this.stopped] = [0, 0, false];
    this.pump();
  }

  /** Resets the controller. The controller then discards everything that was sent before. */
  reset(): void {
    this.realtime(REALTIME.reset);
    this.forget();
    this.expectGreeting(LONGEST_RESET);
    this.onprogress();
  }

  /** Stops sending the job and the waiting lines. Lines already sent are still answered. */
  private stop(why: string): void {
    for (const command of this.commands.splice(0)) command.answered({ answer: `not sent: ${why}`, said: [] });
    if (!this.busy || this.stopped) return;
    this.stopped = true;
    this.lines.length = this.next;
    this.onstopped(this.next, why);
  }

  /** Removes all lines and commands, after the controller has discarded them. Unanswered commands get the answer
   * `reset`. */
  private forget(): void {
    const commands = [...this.flight.splice(0).map(sent => sent.command), ...this.commands.splice(0)];
    for (const command of commands) command?.answered({ answer: "reset", said: [] });
    this.lines = [];
    [this.next, this.done, this.stopped] = [0, 0, false];
  }

  /** Writes no line until the controller's welcome message, but waits at most `longest` ms. Answers that arrive before
   * the welcome belong to discarded lines. */
  private expectGreeting(longest: number): void {
    this.resetting = true;
    this.pause(longest);
  }

  private pause(ms: number): void {
    clearTimeout(this.silence);
    this.silence = setTimeout(() => this.go(), ms);
  }

  private go(): void {
    clearTimeout(this.silence);
    this.silence = undefined;
    this.resetting = false;
    this.pump();
  }

  private greeted(): void {
    if (this.resetting) return this.go();
    const line = this.done;
    const cut = this.busy;
    this.forget();
    // Pause, because an answer to a discarded line may still arrive.
    this.pause(SETTLING);
    if (cut) this.onstopped(line, "the machine was reset");
    this.ongreeting();
  }

  private get used(): number {
    return this.flight.reduce((sum, sent) => sum + sent.length, 0);
  }

  private pump(): void {
    while (this.silence === undefined) {
      const command = this.commands[0];
      const text = command?.text ?? this.lines[this.next];
      if (text === undefined) return;
      if (!command && TAPE_MARK.test(text) && !this.isBetweenPrograms(this.next)) {
        // Do not send this tape mark. It counts as answered.
        this.next++;
        this.done++;
        continue;
      }
      const bytes = plain(text);
      if (this.flight.length && this.used + bytes.length > this.room) return;
      if (command) this.commands.shift();
      this.flight.push({ length: bytes.length, line: command ? undefined : ++this.next, command, said: [] });
      this.link.write(bytes);
    }
  }

  /** Returns `true` if the tape mark at this index separates two programs of the file. The machine must get this
   * mark. */
  private isBetweenPrograms(index: number): boolean {
    return this.hasTapeMarks && this.firstWords < index && index < this.lastWords;
  }

  private receive(text: string): void {
    this.received += text;
    const lines = this.received.split("\n");
    this.received = lines.pop() ?? "";
    for (const line of lines) {
      try {
        this.line(line.trim());
      } catch (error) {
        // If displaying one line fails, the answers after it must still be counted.
        console.error(error);
      }
    }
    this.pump();
    this.onprogress();
  }

  private line(line: string): void {
    if (line === "") return;
    if (line === "ok" || line.startsWith("error:")) {
      const sent = this.flight.shift();
      if (sent?.line !== undefined) {
        this.done++;
        if (line !== "ok") this.refuse(sent.line, line);
      }
      sent?.command?.answered({ answer: line, said: sent.said });
    } else if (line.startsWith("<")) {
      this.onstatus(this.status(line));
    } else {
      const buffer = /^\[OPT:[^,]*,\d+,(\d+)/.exec(line);
      if (buffer) this.room = Number(buffer[1]);
      if (line.startsWith("ALARM:") && !this.resetting) this.stop(line);
      if (/^Grbl(HAL)? /.test(line)) this.greeted();
      const [asked] = this.flight;
      if (asked?.command) asked.said.push(line);
      if (!asked?.command?.quiet || /^(\[MSG:|ALARM:|Grbl(HAL)? )/.test(line)) this.onmessage(line);
    }
  }

  /** Ends the job after a rejected line. The lines after it rely on the effect of the rejected line. */
  private refuse(line: number, answer: string): void {
    this.onrefused(line, answer);
    if (!this.busy || this.stopped) return;
    this.realtime(REALTIME.hold);
    this.stop(`line ${line} was refused (${answer})`);
  }

  private status(line: string): Status {
    const [state, ...parts] = line.slice(1, -1).split("|");
    const fields = Object.fromEntries(parts.map(part => part.split(":", 2) as [string, string]));
    const numbers = (text?: string) => text?.split(",").map(Number);
    this.offset = numbers(fields.WCO) ?? this.offset;
    const machine = numbers(fields.MPos) ?? numbers(fields.WPos)?.map((v, i) => v + (this.offset[i] ?? 0)) ?? [0, 0, 0];
    const work = machine.map((v, i) => v - (this.offset[i] ?? 0));
    // Rotary axes are reported in degrees, whatever the unit.
    const mm = (v: number, axis: number) => (axis < LINEAR ? v * this.unit : v);
    return { state, machine: machine.map(mm), work: work.map(mm), fields };
  }
}

/** Whether the line switches on checked lines (docs/senders.md), which this page does not support. */
function beginsChecks(text: string): boolean {
  return /^\$LC=ON([A-Z]{4})?$/i.test(text.replace(/\([^)]*\)|;.*|\s/g, ""));
}

/** A `%` followed only by comments. */
const TAPE_MARK = /^\s*%\s*(\([^()]*(\)\s*|$))*(;.*)?$/;

/** Returns the reason why a line must not be sent: it has a character that cannot be sent unchanged, or it switches on
 * checked lines. */
function unsendable(text: string): string | undefined {
  const found = foreign(text);
  if (found === undefined) return beginsChecks(text) ? UNCHECKED : undefined;
  const code = (found.codePointAt(0) as number).toString(16).toUpperCase().padStart(4, "0");
  const shown = /\p{C}/u.test(found) ? "" : `"${found}" `;
  return `${shown}(U+${code}) has no place outside comments`;
}

/** Returns the first character outside comments that cannot be sent or would be a realtime command. Machines differ:
 * some end a comment at the first `)`, others match nested parentheses. Only text that is a comment for both counts as
 * one. */
function foreign(text: string): string | undefined {
  let [first, pairs] = [false, 0];
  for (const character of text) {
    if (character === "(") [first, pairs] = [true, pairs + 1];
    else if (character === ")") [first, pairs] = [false, Math.max(0, pairs - 1)];
    else if (first) continue;
    else if (character === ";" && pairs === 0) return undefined;
    else if (!/[\x21-\x7e]|[^\S\uFEFF]/.test(character) || "!?~".includes(character)) return character;
  }
  return undefined;
}

/** Returns the bytes to send for a line. Non-ASCII characters, and those that would be realtime commands, become
 * spaces. */
function plain(text: string): Uint8Array<ArrayBuffer> {
  return new TextEncoder().encode(text.replace(/[^\x20-\x7e]|[!?~]/g, " ").trimEnd() + "\n") as Uint8Array<ArrayBuffer>;
}
