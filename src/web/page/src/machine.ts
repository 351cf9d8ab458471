// The machine that the page drives: its connection, what it reports, and what may be ordered of it.
import type { Meaning, Summary } from "./engine";
import { Follower } from "./follow";
import { every, PageLink, SerialLink } from "./links";
import type { Checked } from "./firmware";
import type { Job } from "./page";
import { type Answer, type Link, REALTIME, Sender, type Status } from "./sender";
import { parseSettings } from "./settings";
import { brakingTime, Stopping } from "./stopping";
import { workZero } from "./engine";

/** How often the machine is asked for its state, ms. */
const POLL = 200;
/** A machine that has said nothing for so long may be gone, and is, ms. */
const SILENT = 2000;
const GONE = 6000;

export type Phase = "none" | "connecting" | "idle" | "jog" | "home" | "run" | "hold" | "stopping" | "alarm" | "door" | "sleep" | "check" | "silent" | "lost";

/** A job that is under way, or was. */
export interface Running {
  job: Job;
  summary: Summary;
  follower: Follower;
  /** When it began, by the page's clock, ms. */
  began: number;
  holds: number;
}
/** A job that has ended before its last line. */
export interface Stopped { job: Job; line: number; seconds: number; why: string; at: number[]; lifted?: boolean }
/** A job that has come to its end. */
export interface Finished { name: string; took: number; forecast: number; holds: number; times: number }
/** An alarm, from its report until the machine may work again. */
export interface Trouble { code?: number; text: string; advice: string; at: number[]; line?: number; limits: string; unlocked: boolean; positionLost: boolean }

export class Machine {
  sender?: Sender;
  status?: Status;
  /** What the machine has said of its settings. */
  settings: Record<string, number> = {};
  /** Words of `$G`, and what `$#` tells of offsets and tools. */
  modes: string[] = [];
  stored: string[] = [];
  /** Whether it has been homed, if that is known. */
  homed?: boolean;
  running?: Running;
  stopped?: Stopped;
  finished?: Finished;
  trouble?: Trouble;
  /** What M6 or another pause waits for. */
  pause = "";
  firmware = "";
  /** Overrides of feed, rapids and spindle in percent; what is on: S, C, F, M. */
  overrides = [100, 100, 100];
  accessories = "";
  onsay: (text: string, kind?: string) => void = () => {};
  onnote: (text: string) => void = () => {};
  private link?: Link;
  private endPoll = () => {};
  private stopping?: Stopping;
  /** How often Stop was pressed, or a connection ended: what was begun before goes no further. */
  stopCalls = 0;
  private heard = 0;
  private reported = 0;
  /** Why there is no connection any more, if it was lost. */
  private lostWhy = "";
  /** Reports in a row that said that the machine does nothing, with no line under way. */
  private rests = 0;
  /** Modes and offsets may have changed, and are being asked for. */
  private stale = true;
  private asking = false;
  private limits = "";
  private readonly listeners: (() => void)[] = [];
  private waiting: ((status: Status) => void)[] = [];

  constructor(private readonly alarms: Meaning[]) {}

  /** Calls after each report, and whenever something has changed. */
  onchange(call: () => void): void {
    this.listeners.push(call);
  }

  changed(): void {
    for (const call of this.listeners) call();
  }

  get phase(): Phase {
    if (!this.sender) return this.lostWhy ? "lost" : "none";
    if (!this.status) return "connecting";
    const quiet = performance.now() - this.heard;
    if (quiet > GONE) return "lost";
    if (this.stopping) return "stopping";
    if (quiet > SILENT) return "silent";
    switch (this.status.state.split(":")[0]) {
      case "Alarm": return "alarm";
      case "Hold": return "hold";
      case "Door": return "door";
      case "Home": return "home";
      case "Jog": return "jog";
      case "Check": return "check";
      case "Sleep": return "sleep";
      case "Run": return "run";
      default: return this.sender.busy ? "run" : "idle";
    }
  }

  get isConnected(): boolean {
    return this.sender !== undefined;
  }

  /** Whether bytes still reach the machine, as far as the page knows. */
  get isReached(): boolean {
    return this.isConnected && this.phase !== "lost";
  }

  /** Seconds since the machine has said something. */
  get silence(): number {
    return (performance.now() - this.heard) / 1000;
  }

  /** Letters of its axes, by the places that it reports. */
  get axes(): string[] {
    return [..."XYZABC"].slice(0, Math.max(3, this.status?.machine.length ?? 3));
  }

  get isSimulated(): boolean {
    return this.link instanceof PageLink;
  }

  /** Whether the position that is shown can be trusted. */
  get isUnsure(): boolean {
    return this.trouble?.positionLost ?? false;
  }

  /** The coordinate system in force, from 1 for G54 on; 0 for one that is not known. */
  get system(): number {
    const word = this.modes.find(mode => /^G5[4-9](\.[1-3])?$/.test(mode));
    return word === undefined ? 0 : Number(word.slice(1, 3)) - 53 + Number(word.split(".")[1] ?? 0);
  }

  /** Whether a program that moves by jogs or lines of its own may move now; if not, why. */
  get whyNot(): string | undefined {
    switch (this.phase) {
      case "none": return "Connect a machine first.";
      case "connecting": return "Waiting for the first answer of the machine.";
      case "silent": return "The machine does not answer.";
      case "lost": return "No connection.";
      case "run": return this.running ? "Off while a job runs." : "Off while the machine moves.";
      case "hold": return "Off in Hold: resume or stop first.";
      case "stopping": return "The machine is slowing down.";
      case "home": return "Off while the machine homes.";
      case "alarm": return "Off in an alarm: unlock or home first.";
      case "door": return "Off while the safety door is open.";
      case "sleep": return "The machine sleeps: press Stop to reset it.";
      case "check": return "The machine only checks ($C): send $C to end that.";
      default: return undefined;
    }
  }

  /** As `whyNot`, and a jog has to be over. */
  get whyNotAtRest(): string | undefined {
    return this.phase === "jog" ? "Off while the machine jogs." : this.whyNot;
  }

  /** Whether a job may begin: a single report may be older than the last move, and what a line has changed is known. */
  get isAtRest(): boolean {
    return this.rests >= 2 && !this.stale && !this.asking;
  }

  /** Sends a line and shows it. */
  async line(text: string): Promise<string> {
    return (await this.ask(text)).answer;
  }

  /** As `line`, with what was said before the answer. */
  async ask(text: string): Promise<Answer> {
    const { sender } = this;
    if (!sender) return { answer: "not sent: no machine is connected", said: [] };
    this.onsay(text, "sent");
    const answered = await sender.ask(text);
    this.onsay(answered.answer, answered.answer === "ok" ? "" : "wrong");
    this.stale = true;
    if (answered.answer === "ok") this.after(text.trim().toUpperCase());
    // A setting may decide on the unit of reports, or on speeds.
    if (/^\s*\$(\d|RST)/i.test(text)) await this.readSettings();
    this.changed();
    return answered;
  }

  /** Sends a line that only asks; nothing of it is shown. */
  query(text: string): Promise<Answer> {
    return this.sender?.ask(text, true) ?? Promise.resolve({ answer: "not sent: no machine is connected", said: [] });
  }

  realtime(command: keyof typeof REALTIME): void {
    if (command === "hold" && this.running && this.phase === "run") this.running.holds++;
    this.sender?.realtime(REALTIME[command]);
  }

  /** What is typed: a realtime command has no line. */
  typed(text: string): void {
    const command = ({ "!": "hold", "~": "resume", "?": "status" } as const)[text.trim()];
    if (command === undefined) return void this.line(text);
    this.onsay(text, "sent");
    this.realtime(command);
  }

  /** A report that was made from now on. */
  async report(): Promise<Status | undefined> {
    if (!this.sender) return undefined;
    const next = new Promise<Status>(resolve => this.waiting.push(resolve));
    this.realtime("status");
    return next;
  }

  /** What was answered has consequences. */
  private after(line: string): void {
    if (/^\$H/.test(line)) {
      this.homed = true;
      this.trouble = undefined;
    }
    if (line === "$X" && this.trouble) {
      this.trouble.unlocked = true;
      if (!this.trouble.positionLost) this.trouble = undefined;
    }
    // Places have other names than homing gave them.
    if (/^\$(3|23|10\d|904|930)=/.test(line)) this.homed = undefined;
  }

  private async greet(): Promise<void> {
    const { said } = await this.ask("$I");
    this.firmware = said.map(line => /^\[(?:FIRMWARE|VER):(.*?):?\]$/.exec(line)?.[1]).filter(Boolean).at(-1) ?? "";
    await this.readSettings();
    this.stale = true;
    this.changed();
  }

  /** Reads the settings of the machine, which refuses that in motion. Gives whether it did so. */
  async readSettings(): Promise<boolean> {
    const { sender } = this;
    if (!sender) return false;
    const { answer, said } = await sender.ask("$$", true);
    if (answer !== "ok" || this.sender !== sender) return false;
    this.settings = parseSettings(said.join("\n"));
    sender.unit = this.settings[13] === 1 ? 25.4 : 1;
    this.changed();
    return true;
  }

  /** Asks for modes, offsets and tools. */
  private async refresh(): Promise<void> {
    const { sender } = this;
    if (!sender) return;
    [this.stale, this.asking] = [false, true];
    const modes = await sender.ask("$G", true);
    const stored = await sender.ask("$#", true);
    if (this.sender !== sender) return;
    this.asking = false;
    const words = /\[GC:([^\]]*)\]/.exec(modes.said.join(" "))?.[1];
    if (words) this.modes = words.split(" ");
    if (stored.answer === "ok") this.stored = stored.said;
    this.changed();
  }

  attach(link: Link): void {
    this.link = link;
    const sender = (this.sender = new Sender(link));
    [this.status, this.running, this.stopped, this.finished, this.trouble, this.homed] = [undefined, undefined, undefined, undefined, undefined, undefined];
    [this.lostWhy, this.pause, this.firmware, this.modes, this.stored, this.settings] = ["", "", "", [], [], {}];
    this.heard = performance.now();
    [this.stale, this.asking] = [true, false];
    link.onlost = why => this.link === link && this.lost(why);
    sender.onstatus = status => this.heardStatus(status);
    sender.onmessage = text => this.message(text);
    sender.onrefused = (line, answer) => this.onsay(`line ${line}: ${answer}`, "wrong");
    sender.onstopped = (line, why) => this.jobStopped(line, why);
    sender.ongreeting = () => {
      this.pause = "";
      void this.greet();
    };
    sender.onprogress = () => {
      if (!sender.free) this.rests = 0;
    };
    this.onnote("");
    this.endPoll = every(POLL, () => {
      sender.realtime(REALTIME.status);
      if (this.silence * 1000 > SILENT) this.changed();
    });
    void this.greet();
    this.changed();
  }

  /** Disconnects; a machine that moves is held. A homing cycle takes no hold, and ends at its switches. */
  leave(): void {
    const homes = this.phase === "home";
    const moves = this.moves();
    if (moves) this.realtime("hold");
    this.detach();
    this.onnote(homes ? "Disconnected. The machine is homing, and goes on with it." : moves ? "Disconnected. The machine was moving, and is held." : "Disconnected.");
  }

  /** Whether the machine has something to do: all lines may be answered while it still moves. */
  moves(): boolean {
    return this.sender !== undefined && (this.sender.busy || /^(Run|Jog|Home)/.test(this.status?.state ?? ""));
  }

  /** A connection that has failed in one direction may still work in the other. */
  private lost(why: string): void {
    const moves = this.moves();
    if (moves) this.realtime("hold");
    const running = this.running;
    if (running) this.end(running, "the connection was lost");
    this.detach();
    this.lostWhy = why;
    this.onnote(`The machine is gone${moves ? " in motion, and is held if it still hears that" : ""}: ${why}`);
    this.changed();
  }

  private detach(): void {
    this.endPoll();
    this.stopping?.cancel();
    void this.link?.close();
    [this.link, this.sender, this.status, this.stopping, this.running] = [undefined, undefined, undefined, undefined, undefined];
    this.rests = 0;
    this.stopCalls++;
    this.changed();
  }

  /** A lost connection has been taken note of. */
  dismissLost(): void {
    this.lostWhy = "";
    this.changed();
  }

  /** How many times faster than real time a simulated machine is. */
  speed(times: number): void {
    if (this.link instanceof PageLink) this.link.speed(times);
  }

  get isSerial(): boolean {
    return this.link instanceof SerialLink;
  }

  private heardStatus(status: Status): void {
    const now = performance.now();
    const passed = this.reported ? (now - this.reported) / 1000 : 0;
    [this.heard, this.reported] = [now, now];
    const before = this.status?.state.split(":")[0];
    this.status = status;
    const name = status.state.split(":")[0];
    this.rests = this.sender?.free && /^(Idle|Check)$/.test(name) ? this.rests + 1 : 0;
    const overrides = status.fields.Ov?.split(",").map(Number);
    if (overrides) [this.overrides, this.accessories] = [overrides, status.fields.A ?? ""];
    if (name !== "Hold") this.pause = "";
    if (name === "Alarm" && !this.trouble) this.locked();
    if (before === "Alarm" && name !== "Alarm" && this.trouble && !this.trouble.unlocked) this.trouble = undefined;
    for (const call of this.waiting.splice(0)) call(status);
    this.stopping?.report(status);
    this.follow(name, passed);
    if (this.rests >= 2 && this.stale && !this.asking) void this.refresh();
    this.changed();
  }

  /** Takes the job on by a report. */
  private follow(name: string, passed: number): void {
    const { running, sender, status } = this;
    if (!running || !sender || !status) return;
    // A simulated machine may be faster than the page's clock.
    const speed = this.isSimulated ? this.times : 1;
    const moving = name === "Run" || (name === "Idle" && sender.busy);
    if (moving) running.follower.report(status.work, passed * speed * Math.max(1, this.overrides[0] / 100), sender.sent || Infinity);
    if (this.rests >= 2) {
      running.follower.finish();
      const took = (performance.now() - running.began) / 1000;
      this.finished = { name: running.job.name, took, forecast: running.summary.forecast_s, holds: running.holds, times: speed };
      this.running = undefined;
      this.stale = true;
    }
  }

  /** Times real time of a simulated machine. */
  times = 1;

  private message(text: string): void {
    this.onsay(text, text.startsWith("ALARM:") ? "wrong" : "");
    const limit = /^\[MSG:Limit switch ([A-Z]+) at/.exec(text);
    if (limit) this.limits = limit[1];
    const pause = /^\[MSG:(Tool change.*|First tool measured.*)\]$/.exec(text);
    if (pause) this.pause = pause[1];
    if (/^\[MSG:'\$H'\|'\$X' to unlock\]$/.test(text)) this.homed = false;
    const alarm = /^ALARM:(\d+)/.exec(text);
    if (!alarm) return;
    const meaning = this.alarms.find(({ code }) => code === Number(alarm[1]));
    const positionLost = /position (may be|is) lost/.test(meaning?.text ?? "position may be lost");
    const line = this.running ? this.running.follower.line : this.stopped?.line;
    this.trouble = { code: Number(alarm[1]), text: meaning?.text ?? "an alarm that this page does not know", advice: meaning?.advice ?? "Look it up in the manual of the controller.",
      at: this.status?.work ?? [], line, limits: this.limits, unlocked: false, positionLost };
    this.limits = "";
    if (positionLost) this.homed = this.homed === undefined && this.settings[22] !== 1 ? undefined : false;
    if (this.running) this.end(this.running, `alarm ${alarm[1]}: ${this.trouble.text}`);
    this.changed();
  }

  /** The machine is locked, and has not said by which alarm: since it was switched on, or since a reset. */
  private locked(): void {
    this.trouble = { text: "the machine is locked until it is homed or unlocked", advice: "Home it, or unlock it if you know where it is.",
      at: this.status?.work ?? [], limits: "", unlocked: false, positionLost: this.homed === false };
  }

  private jobStopped(line: number, why: string): void {
    this.onsay(`The job has ended: ${why}. Its lines up to ${line} have been sent.`, "wrong");
    if (this.running) this.end(this.running, why);
    this.onnote(/refused/.test(why) ? `The job has ended: ${why}. The machine is held: Stop drops what it has received, Resume carries it out.` : `The job has ended: ${why}.`);
  }

  /** A job has ended before its last line. */
  private end({ job, follower }: Running, why: string): void {
    this.stopped ??= { job, line: Math.max(1, follower.line), seconds: follower.time, why, at: this.status?.work ?? [] };
    this.running = undefined;
    this.stale = true;
  }

  /** Starts a job that was checked. Throws, and sends nothing of it, if it cannot be sent as it is. */
  start(job: Job, { summary, path }: Checked): void {
    const { sender } = this;
    if (!sender || !this.isAtRest) throw new Error("the machine is not idle");
    sender.stream(job.text);
    this.rests = 0;
    [this.stopped, this.finished, this.trouble] = [undefined, undefined, undefined];
    if (path) this.running = { job, summary, follower: new Follower(path, workZero(summary)), began: performance.now(), holds: 0 };
    this.onnote("");
    this.changed();
  }

  /** Stops whatever moves: a jog by its own end, all else by braking and a reset at rest. Pressed again, it resets at once. */
  stop(): void {
    const { sender } = this;
    if (!sender) return;
    this.stopCalls++;
    const { phase } = this;
    if (this.stopping) return this.stopping.again();
    if (phase === "jog" && !sender.busy) {
      sender.realtime(REALTIME.jogCancel);
      return;
    }
    const reset = (atRest: boolean) => {
      this.stopping = undefined;
      this.pause = "";
      this.rests = 0;
      this.stale = true;
      this.onnote(atRest ? "Stopped. Spindle and coolant are off." : "Reset in motion: the position may be lost.");
      this.changed();
    };
    // Nothing moves, or a homing cycle does, which takes no hold.
    if (["idle", "alarm", "home", "sleep", "check", "connecting"].includes(phase)) {
      if (this.running) this.end(this.running, "stopped");
      sender.reset();
      return reset(phase !== "home");
    }
    if (this.running) this.end(this.running, "stopped");
    this.stopping = new Stopping(sender, brakingTime(this.settings, this.axes.length), reset);
    if (this.status && /^(Hold:0|Door:[01])/.test(this.status.state)) this.stopping.report(this.status);
    this.changed();
  }

  /** Lines one after the other, until one is refused or Stop is pressed. Gives what went wrong, if something did. */
  async sequence(lines: string[]): Promise<string | undefined> {
    const calls = this.stopCalls;
    for (const line of lines) {
      if (this.stopCalls !== calls) return "stopped";
      const answer = await this.line(line);
      if (answer !== "ok") return this.explain(answer);
    }
    return this.stopCalls === calls ? undefined : "stopped";
  }

  /** An answer in words. */
  explain(answer: string): string {
    return this.meanings?.(answer) ?? answer;
  }

  /** Texts of errors. */
  meanings?: (answer: string) => string | undefined;

  /** Unlocks after an alarm. An alarm has to be reset first. */
  async unlock(): Promise<void> {
    if (this.trouble?.code !== undefined) this.sender?.reset();
    await this.line("$X");
  }
}
