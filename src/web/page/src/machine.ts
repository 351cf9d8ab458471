// The machine that the page drives: its connection, its reports, and which commands are possible.
import type { Meaning, Summary } from "./engine";
import { Follower } from "./follow";
import { every, PageLink, SerialLink } from "./links";
import type { Checked } from "./firmware";
import type { Job } from "./page";
import { type Answer, type Link, REALTIME, Sender, type Status } from "./sender";
import { parseSettings } from "./settings";
import { brakingTime, Stopping } from "./stopping";
import { workZero } from "./engine";

/** Interval between status requests, ms. */
const POLL = 200;
/** After this time without output, the machine counts as not responding, ms. */
const SILENT = 2000;
/** Number of the setting for the dialect (`$900`). The value 0 means Grbl. */
const DIALECT = 900;
/** After this time without output, the connection counts as lost, ms. */
const GONE = 6000;

export type Phase = "none" | "connecting" | "idle" | "jog" | "home" | "run" | "hold" | "stopping" | "alarm" | "door" | "sleep" | "check" | "silent" | "lost";

export interface Running {
  job: Job;
  summary: Summary;
  follower: Follower;
  /** Start time on the page's clock, ms. */
  began: number;
  holds: number;
}
/** A job that ended before its last line. `line` and `seconds`: the line and the time that the job had reached; `at`:
 * the work position there, mm; `lifted`: `true` after the user has lifted Z. */
export interface Stopped { job: Job; line: number; seconds: number; why: string; at: number[]; lifted?: boolean }
/** A completed job. `took` and `forecast`: its real and its expected duration, s; `times`: speed of a simulated
 * machine, as a multiple of real time. */
export interface Finished { name: string; took: number; forecast: number; holds: number; times: number }
/** An alarm, from its report until the machine can work again. `at`: the work position, mm; `limits`: letters of the
 * axes whose limit switches tripped. */
export interface Trouble { code?: number; text: string; advice: string; at: number[]; line?: number; limits: string; unlocked: boolean; positionLost: boolean }

export class Machine {
  sender?: Sender;
  status?: Status;
  /** The settings that the machine has reported. */
  settings: Record<string, number> = {};
  /** Words of `$G`. */
  modes: string[] = [];
  /** Lines of `$#`: offsets and tools. */
  stored: string[] = [];
  /** `true` if the machine has been homed, `false` if not, `undefined` if the page does not know. */
  homed?: boolean;
  running?: Running;
  stopped?: Stopped;
  finished?: Finished;
  trouble?: Trouble;
  /** The message of the pause in progress, such as a tool change (M6). */
  pause = "";
  firmware = "";
  /** Name of the board, as the machine gives it; empty if it gives none. */
  boardName = "";
  /** Overrides of feed, rapids and spindle, in percent. */
  overrides = [100, 100, 100];
  /** Letters for what is on, as in the field `A:` of a report: S spindle clockwise, C counterclockwise, F flood, M
   * mist. */
  accessories = "";
  onsay: (text: string, kind?: string) => void = () => {};
  onnote: (text: string) => void = () => {};
  private link?: Link;
  private endPoll = () => {};
  private stopping?: Stopping;
  /** Number of presses of Stop and of ended connections. A sequence of lines ends when this number changes. */
  stopCalls = 0;
  private receivedAt = 0;
  private reported = 0;
  /** Why the connection was lost, if it was. */
  private lostWhy = "";
  /** Number of reports in a row in which the machine was idle and no line was pending. */
  private rests = 0;
  /** `true` if modes and offsets may have changed and must be requested. */
  private stale = true;
  /** `true` while the answer to the request for modes and offsets is missing. */
  private asking = false;
  private limits = "";
  private readonly listeners: (() => void)[] = [];
  private waiting: ((status: Status) => void)[] = [];

  constructor(private readonly alarms: Meaning[]) {}

  /** Calls `call` after each report and each change. */
  onchange(call: () => void): void {
    this.listeners.push(call);
  }

  changed(): void {
    for (const call of this.listeners) call();
  }

  get phase(): Phase {
    if (!this.sender) return this.lostWhy ? "lost" : "none";
    if (!this.status) return "connecting";
    const quiet = performance.now() - this.receivedAt;
    if (quiet > GONE) return "lost";
    if (this.stopping) return "stopping";
    if (quiet > SILENT) return "silent";
    switch (this.status.state.split(":")[0]) {
      case "Alarm": return "alarm";
      case "Hold": case "Tool": return "hold";
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

  /** Whether the page is connected and the connection does not count as lost. */
  get isReached(): boolean {
    return this.isConnected && this.phase !== "lost";
  }

  /** Seconds since the last output of the machine. */
  get silence(): number {
    return (performance.now() - this.receivedAt) / 1000;
  }

  /** Letters of the machine's axes, according to the number of reported positions. */
  get axes(): string[] {
    return [..."XYZABC"].slice(0, Math.max(3, this.status?.machine.length ?? 3));
  }

  get isSimulated(): boolean {
    return this.link instanceof PageLink;
  }

  /** `true` if the displayed position may be wrong, as after an alarm in motion. */
  get isUnsure(): boolean {
    return this.trouble?.positionLost ?? false;
  }

  /** The coordinate system in force, from 1 for G54; 0 if unknown. */
  get system(): number {
    const word = this.modes.find(mode => /^G5[4-9](\.[1-3])?$/.test(mode));
    return word === undefined ? 0 : Number(word.slice(1, 3)) - 53 + Number(word.split(".")[1] ?? 0);
  }

  /** The reason why the page must not send jogs or lines of its own now; `undefined` if it may. */
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

  /** Like `whyNot`, but a jog in progress also is a reason. */
  get whyNotAtRest(): string | undefined {
    return this.phase === "jog" ? "Off while the machine jogs." : this.whyNot;
  }

  /** `true` if the machine is at rest, so that a job can start. Two reports in a row must say so, because a single
   * report can be older than the last move. Modes and offsets must also be known. */
  get isAtRest(): boolean {
    return this.rests >= 2 && !this.stale && !this.asking;
  }

  /** Sends a line, shows it in the console, and returns its answer. */
  async line(text: string): Promise<string> {
    return (await this.ask(text)).answer;
  }

  /** Like `line`, but also returns the output before the answer. */
  async ask(text: string): Promise<Answer> {
    const { sender } = this;
    if (!sender) return { answer: "not sent: no machine is connected", said: [] };
    this.onsay(text, "sent");
    const answered = await sender.ask(text);
    this.onsay(answered.answer, answered.answer === "ok" ? "" : "wrong");
    this.stale = true;
    if (answered.answer === "ok") this.after(text.trim().toUpperCase());
    // Read all settings again: a changed setting can change the unit of reports, or speeds.
    if (/^\s*\$(\d|RST)/i.test(text)) await this.readSettings();
    this.changed();
    return answered;
  }

  /** Sends a query, which is not shown in the console. */
  query(text: string): Promise<Answer> {
    return this.sender?.ask(text, true) ?? Promise.resolve({ answer: "not sent: no machine is connected", said: [] });
  }

  realtime(command: keyof typeof REALTIME): void {
    if (command === "hold" && this.running && this.phase === "run") this.running.holds++;
    this.sender?.realtime(REALTIME[command]);
  }

  /** Sends typed text: `!`, `~` or `?` alone as a realtime command, anything else as a line. */
  typed(text: string): void {
    const command = ({ "!": "hold", "~": "resume", "?": "status" } as const)[text.trim()];
    if (command === undefined) return void this.line(text);
    this.onsay(text, "sent");
    this.realtime(command);
  }

  /** Requests a report and returns it. */
  async report(): Promise<Status | undefined> {
    if (!this.sender) return undefined;
    const next = new Promise<Status>(resolve => this.waiting.push(resolve));
    this.realtime("status");
    return next;
  }

  /** Updates the state after a line was accepted. */
  private after(line: string): void {
    if (/^\$H/.test(line)) {
      this.homed = true;
      this.trouble = undefined;
    }
    if (line === "$X" && this.trouble) {
      this.trouble.unlocked = true;
      if (!this.trouble.positionLost) this.trouble = undefined;
    }
    // A change of these settings invalidates the coordinates that homing has set.
    if (/^\$(3|23|10\d|904|930)=/.test(line)) this.homed = undefined;
  }

  private async greet(): Promise<void> {
    const { said } = await this.ask("$I");
    this.firmware = said.map(line => /^\[(?:FIRMWARE|VER):(.*?):?\]$/.exec(line)?.[1]).filter(Boolean).at(-1) ?? "";
    const { said: options } = await this.query("$I+");
    this.boardName = options.map(line => /^\[BOARD:(.+)\]$/.exec(line)?.[1]).find(Boolean) ?? "";
    await this.readSettings();
    this.stale = true;
    this.changed();
  }

  /** Requests the settings, which the machine does not list in motion. Returns whether the machine listed them. */
  async readSettings(): Promise<boolean> {
    const { sender } = this;
    if (!sender) return false;
    const { answer, said } = await sender.ask("$$", true);
    if (answer !== "ok" || this.sender !== sender) return false;
    this.settings = parseSettings(said.join("\n"));
    sender.unit = this.settings[13] === 1 ? 25.4 : 1;
    sender.hasTapeMarks = (this.settings[DIALECT] ?? 0) !== 0;
    this.changed();
    return true;
  }

  /** Requests modes, offsets and tools. */
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
    [this.lostWhy, this.pause, this.firmware, this.boardName, this.modes, this.stored, this.settings] = ["", "", "", "", [], [], {}];
    this.receivedAt = performance.now();
    [this.stale, this.asking] = [true, false];
    link.onlost = why => this.link === link && this.lost(why);
    sender.onstatus = status => this.receiveStatus(status);
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

  /** Disconnects, and puts a moving machine into a hold. A homing cycle ignores the hold and ends at its switches. */
  leave(): void {
    const homes = this.phase === "home";
    const moves = this.moves();
    if (moves) this.realtime("hold");
    this.detach();
    this.onnote(homes ? "Disconnected. The machine is homing, and goes on with it." : moves ? "Disconnected. The machine was moving, and is held." : "Disconnected.");
  }

  /** Returns `true` if the machine has work. It can still move after all lines have been answered. */
  moves(): boolean {
    return this.sender !== undefined && (this.sender.busy || /^(Run|Jog|Home)/.test(this.status?.state ?? ""));
  }

  /** Handles a lost connection. Commands may still reach the machine, although its answers are lost. So a moving
   * machine is put into a hold. */
  private lost(why: string): void {
    const moves = this.moves();
    if (moves) this.realtime("hold");
    const running = this.running;
    if (running) this.end(running, "the connection was lost");
    this.detach();
    this.lostWhy = why;
    this.onnote(`Connection lost${moves ? " in motion (a hold was sent; check that it stops)" : ""}: ${why}`);
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

  /** Call when the user has acknowledged the loss of the connection. */
  dismissLost(): void {
    this.lostWhy = "";
    this.changed();
  }

  /** Sets the speed of a simulated machine as a multiple of real time. */
  speed(times: number): void {
    if (this.link instanceof PageLink) this.link.speed(times);
  }

  get isSerial(): boolean {
    return this.link instanceof SerialLink;
  }

  private receiveStatus(status: Status): void {
    const now = performance.now();
    const passed = this.reported ? (now - this.reported) / 1000 : 0;
    [this.receivedAt, this.reported] = [now, now];
    const before = this.status?.state.split(":")[0];
    this.status = status;
    const name = status.state.split(":")[0];
    this.rests = this.sender?.free && /^(Idle|Check)$/.test(name) ? this.rests + 1 : 0;
    const overrides = status.fields.Ov?.split(",").map(Number);
    if (overrides) [this.overrides, this.accessories] = [overrides, status.fields.A ?? ""];
    if (name !== "Hold" && name !== "Tool") this.pause = "";
    if (name === "Alarm" && !this.trouble) this.locked();
    if (before === "Alarm" && name !== "Alarm" && this.trouble && !this.trouble.unlocked) this.trouble = undefined;
    for (const call of this.waiting.splice(0)) call(status);
    this.stopping?.report(status);
    this.follow(name, passed);
    if (this.rests >= 2 && this.stale && !this.asking) void this.refresh();
    this.changed();
  }

  /** Updates the progress of the job from a report. */
  private follow(name: string, passed: number): void {
    const { running, sender, status } = this;
    if (!running || !sender || !status) return;
    // A simulated machine may run faster than real time.
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

  /** Speed of a simulated machine as a multiple of real time. */
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

  /** Handles a machine that is locked without an alarm, as after power-up or a reset. */
  private locked(): void {
    this.trouble = { text: "the machine is locked until it is homed or unlocked", advice: "Home it, or unlock it if you know where it is.",
      at: this.status?.work ?? [], limits: "", unlocked: false, positionLost: this.homed === false };
  }

  private jobStopped(line: number, why: string): void {
    this.onsay(`The job has ended: ${why}. Its lines up to ${line} have been sent.`, "wrong");
    if (this.running) this.end(this.running, why);
    this.onnote(/refused/.test(why) ? `The job has ended: ${why}. The machine is in Hold: press Stop to drop the lines it has received, Resume to run them.` : `The job has ended: ${why}.`);
  }

  /** Records that a job ended before its last line. Sends nothing. */
  private end({ job, follower }: Running, why: string): void {
    this.stopped ??= { job, line: Math.max(1, follower.line), seconds: follower.time, why, at: this.status?.work ?? [] };
    this.running = undefined;
    this.stale = true;
  }

  /** Starts a checked job. If the job cannot be sent unchanged, throws and sends nothing of it. */
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

  /** Stops any motion. A jog is cancelled. Anything else is braked, and the machine is reset at rest. A second press
   * resets at once. */
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
    // Reset at once: either nothing moves, or the machine is homing and would ignore a hold.
    if (["idle", "alarm", "home", "sleep", "check", "connecting"].includes(phase)) {
      if (this.running) this.end(this.running, "stopped");
      sender.reset();
      return reset(phase !== "home");
    }
    if (this.running) this.end(this.running, "stopped");
    this.stopping = new Stopping(sender, brakingTime(this.settings, this.axes.length), reset);
    if (this.status && /^(Hold:0|Tool|Door:[01])/.test(this.status.state)) this.stopping.report(this.status);
    this.changed();
  }

  /** Sends lines one after the other, until one is rejected or Stop is pressed. Returns what went wrong; `undefined`
   * if all were accepted. */
  async sequence(lines: string[]): Promise<string | undefined> {
    const calls = this.stopCalls;
    for (const line of lines) {
      if (this.stopCalls !== calls) return "stopped";
      const answer = await this.line(line);
      if (answer !== "ok") return this.explain(answer);
    }
    return this.stopCalls === calls ? undefined : "stopped";
  }

  /** Returns the explanation of an answer, or the answer itself if it has none. */
  explain(answer: string): string {
    return this.meanings?.(answer) ?? answer;
  }

  /** Returns the explanation of an answer such as `error:9`; `undefined` for other answers. Set by the page at its
   * start. */
  meanings?: (answer: string) => string | undefined;

  /** Unlocks the machine; resets it first if there was an alarm. */
  async unlock(): Promise<void> {
    if (this.trouble?.code !== undefined) this.sender?.reset();
    await this.line("$X");
  }
}
