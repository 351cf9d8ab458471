// Checks before a job starts: a job that would fail cannot be started.
import { hindrance, type Order, type Path, type Summary } from "./engine";
import * as firmware from "./firmware";
import type { Machine } from "./machine";
import type { Page } from "./page";
import { storedLines } from "./tooltable";
import { isRapid, lineOf } from "./track";

/** `yes`: fine. `look`: worth a look. `ask`: needs confirmation. `wait`: not known yet. `no`: the job would fail. */
export type Grade = "yes" | "look" | "ask" | "wait" | "no";
export interface Finding { grade: Grade; text: string; more?: string; line?: number }

/** Delay of a trial after the last change, ms. A trial checks the job with the machine's own settings. */
const QUIET = 250;

export class Preflight {
  /** Result of simulating the job with the settings, offsets and tools of the connected machine. */
  private trial?: { key: string; summary?: Summary; why?: string };
  private running?: AbortController;
  private timer?: ReturnType<typeof setTimeout>;
  private wanted = "";

  constructor(private readonly machine: Machine, private readonly page: Page, private readonly onchange: () => void) {}

  /** Returns the order for a trial with the values that the machine has reported. */
  private order(): Order {
    const { machine, page } = this;
    const known = new Set(page.description.settings.map(({ number }) => number));
    const settings = Object.fromEntries(Object.entries(machine.settings).filter(([number]) => known.has(Number(number))));
    const offset = machine.status ? machine.status.machine.map((v, axis) => v - (machine.status?.work[axis] ?? 0)).slice(0, 3).map(v => Number(v.toFixed(3))) : [];
    const work_zero = machine.homed && settings[22] === 1 ? offset : undefined;
    const stored = storedLines(machine.stored, machine.settings[13] === 1 ? 25.4 : 1);
    return { ...page.order(), settings, work_zero, stored };
  }

  /** Tries the job with the present state of the machine, if the machine is at rest and anything has changed. */
  update(): void {
    const { machine, page } = this;
    if (!page.checked || !machine.isAtRest || Object.keys(machine.settings).length === 0 || machine.phase !== "idle") return;
    const order = this.order();
    const key = JSON.stringify([order, page.job.name, page.job.bytes.length, page.checked.summary.order_hash]);
    if (key === this.wanted) return;
    this.wanted = key;
    this.running?.abort(new Error("something has changed"));
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.tryOut(order, key), QUIET);
  }

  private async tryOut(order: Order, key: string): Promise<void> {
    const { signal } = (this.running = new AbortController());
    try {
      const { summary } = await firmware.check(order, this.page.job.bytes, signal);
      this.trial = { key, summary };
    } catch (error) {
      if (signal.aborted) return;
      this.trial = { key, why: (error as Error).message };
    }
    this.onchange();
  }

  findings(): Finding[] {
    const { machine, page } = this;
    const { checked } = page;
    if (!page.job.name) return [{ grade: "no", text: "No job is open", more: "Open a G-code file, or a sample." }];
    if (!checked) return [{ grade: "wait", text: "The job is not checked", more: "Wait for the verdict, or look at it in Check." }];
    const hindered = hindrance(checked.summary);
    const found: Finding[] = [hindered ? { grade: "no", text: sentence(hindered.text), more: hindered.more, line: hindered.line } : { grade: "yes", text: "Every line is accepted" }];
    if (!machine.isConnected) return found;
    found.push(...this.homing(), ...this.zero(), ...this.fits());
    if (checked.path) found.push(...spindleFindings(checked.path, machine.settings[32] === 1));
    return found;
  }

  private homing(): Finding[] {
    const { machine } = this;
    if (machine.settings[22] === 0) return [{ grade: "look", text: "Not homed: homing is off ($22)", more: "Nothing watches the travel." }];
    if (machine.homed) return [{ grade: "yes", text: "Homed" }];
    if (machine.homed === undefined) return [{ grade: "look", text: "Homed? This page has not seen it", more: "Home the machine if you are not sure." }];
    return [{ grade: "ask", text: "Not homed", more: "The machine does not know where it is, and nothing watches the travel." }];
  }

  private zero(): Finding[] {
    const { machine } = this;
    const { status } = machine;
    if (!status) return [];
    const none = [0, 1, 2].filter(axis => Math.abs(status.machine[axis] - status.work[axis]) < 1e-6);
    if (none.length === 0) return [{ grade: "yes", text: "Work zero set in X, Y and Z" }];
    // Without homing, machine zero is where the machine was switched on. Users often take that place as work zero.
    const homed = machine.homed === true;
    const axes = none.map(axis => "XYZ"[axis]).join(", ");
    return [{ grade: homed ? "ask" : "look", text: `Work zero is not set in ${axes}`, more: homed ? "It is where the machine was homed: at its end of travel." : "It is where the machine was switched on." }];
  }

  /** Returns the findings of the trial, which used the settings of the real machine. The forecast may use other
   * settings. */
  private fits(): Finding[] {
    const { trial, wanted, page } = this;
    const own = page.checked?.summary;
    if (Object.keys(this.machine.settings).length === 0) return [{ grade: "look", text: "The machine does not tell its settings", more: "The job was checked with those of the forecast only." }];
    if (!trial || trial.key !== wanted) return [{ grade: "wait", text: "The job is being tried with the settings of this machine" }];
    if (trial.why) return [{ grade: "look", text: "The job cannot be tried with the settings of this machine", more: trial.why }];
    const { errors, alarm, complete, messages } = trial.summary as Summary;
    if (alarm) return [{ grade: "no", text: alarm.code === 2 ? "The job leaves the travel of this machine" : `On this machine the job ends in alarm ${alarm.code}`, more: `${alarm.line ? `Line ${alarm.line}: ` : ""}${alarm.text}. ${alarm.advice}`, line: alarm.line ?? undefined }];
    const [error] = errors;
    if (error && !own?.errors.length) return [{ grade: "no", text: "This machine would refuse a line", more: `Line ${error.line}: ${error.text}. ${error.advice}`, line: error.line }];
    if (!complete) return own?.complete ? [{ grade: "no", text: "On this machine the job does not come to its end" }] : [];
    const empty = messages.some(message => message.startsWith("[MSG:No tool is in the table"));
    const tools: Finding[] = empty ? [{ grade: "look", text: "The tool table is empty", more: "The job takes lengths of tools from it (G43): all of them are 0." }] : [];
    const watched = this.machine.settings[20] === 1 && this.machine.homed === true;
    return [{ grade: watched ? "yes" : "look", text: watched ? "The job fits the travel from here" : "The travel is not watched", more: watched ? undefined : "Soft limits ($20) act on a homed machine only." }, ...tools];
  }
}

const sentence = (text: string): string => text.charAt(0).toUpperCase() + text.slice(1);

/** For each path that was examined: the first row that cuts with the spindle on, and `true` if any row cuts. */
const looked = new WeakMap<Path, { first?: number; feeds: boolean }>();

/** Returns findings on whether the spindle or the laser is on when the job cuts. `laser`: `true` in laser mode
 * (`$32`). */
export function spindleFindings(path: Path, laser: boolean): Finding[] {
  let found = looked.get(path);
  if (!found) {
    found = { feeds: false };
    for (let row = 1; row < path.lines.length && found.first === undefined; row++) {
      if (isRapid(path, row)) continue;
      found.feeds = true;
      if (path.speeds[row] > 0) found.first = row;
    }
    looked.set(path, found);
  }
  const { first } = found;
  if (first === undefined) return found.feeds ? [{ grade: "look", text: laser ? "The laser is never on" : "The job never switches the spindle on", more: laser ? undefined : "Switch it on by hand, if it is to turn." }] : [];
  const line = lineOf(path, first);
  return [{ grade: "look", text: `Starts the ${laser ? "laser" : "spindle"} for line ${line.toLocaleString("en")}`, more: laser ? "Are your glasses on?" : `S${path.speeds[first].toLocaleString("en")}: is the cutter clamped?`, line }];
}
