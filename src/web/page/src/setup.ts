// Setup of a machine: homing, unlocking, the outline of the job.
import { $, allow, button, el, onclick, say } from "./dom";
import { Dialog } from "./dialogs";
import type { Summary } from "./engine";
import { workZero } from "./engine";
import type { Machine } from "./machine";
import type { Page } from "./page";

/** Minimum safe height above work zero, mm. */
const LEAST = 5;
/** Safe height above work zero if there is no job, mm. */
const NO_JOB = 10;

/** Returns minimum and maximum work coordinates of a job. */
export function extents(summary: Summary): { min: number[]; max: number[] } {
  const zero = workZero(summary);
  const { min, max } = summary.extents_mm;
  return { min: min.map((v, axis) => v - zero[axis]), max: max.map((v, axis) => v - zero[axis]) };
}

export class SetupPanel {
  private readonly ask: Dialog;
  private readonly question = el("p");
  private asked = () => {};

  constructor(private readonly machine: Machine, private readonly page: Page) {
    this.ask = new Dialog("ask", "Are you sure?", [this.question]);
    this.ask.actions(button("Yes", () => {
      this.ask.close();
      this.asked();
    }, "btn go"));
    onclick("home", () => void machine.line("$H"));
    onclick("unlock", () => void machine.unlock());
    onclick("outline", () => void this.outline());
    machine.onchange(() => this.update());
    this.update();
  }

  /** Asks for confirmation of an action that was triggered by a key. */
  confirm(question: string, act: () => void): void {
    this.question.textContent = question;
    this.asked = act;
    this.ask.open();
  }

  /** Returns the lowest safe Z in work coordinates, mm: the highest Z of the job, but at least `LEAST`. Clamps are not
   * taken into account. */
  safeHeight(): number {
    const { checked } = this.page;
    return checked ? Math.max(LEAST, extents(checked.summary).max[2]) : NO_JOB;
  }

  /** Why homing is not possible; `undefined` if it is possible. */
  get whyNoHome(): string | undefined {
    const { machine } = this;
    if (machine.settings[22] === 0) return "Homing is switched off ($22).";
    return machine.phase === "alarm" ? undefined : machine.whyNotAtRest;
  }

  private async outline(): Promise<void> {
    const { machine, page } = this;
    if (!page.checked) return;
    const { min, max } = extents(page.checked.summary);
    const feed = Math.max(1, Math.min(machine.settings[110] ?? 500, machine.settings[111] ?? 500));
    const at = (x: number, y: number) => `$J=G90 G21 X${x.toFixed(3)} Y${y.toFixed(3)} F${feed}`;
    const height = Math.max(this.safeHeight(), machine.status?.work[2] ?? 0);
    const corners = [at(min[0], min[1]), at(max[0], min[1]), at(max[0], max[1]), at(min[0], max[1]), at(min[0], min[1])];
    const why = await machine.sequence([`$J=G90 G21 Z${height.toFixed(3)} F${Math.max(1, machine.settings[112] ?? 500)}`, ...corners]);
    if (why && why !== "stopped") machine.onnote(`The outline is not shown: ${why}`);
  }

  private update(): void {
    const { machine, page } = this;
    allow($("home"), this.whyNoHome, "Finds the limit switches (H)");
    const locked = machine.phase === "alarm" ? undefined : machine.isConnected ? "The machine is not locked." : "Connect a machine first.";
    allow($("unlock"), locked, "Unlocks after an alarm without homing");
    const turning = /[SC]/.test(machine.accessories) ? "Stop the spindle first." : undefined;
    allow($("outline"), machine.whyNotAtRest ?? (page.checked ? turning : "Open a job first."), "Goes round the job at the safe height, spindle off");
    say("setup-why", machine.phase === "idle" ? turning ?? "" : machine.phase === "alarm" ? "" : machine.whyNotAtRest ?? "");
  }
}
