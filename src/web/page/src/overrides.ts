// The panel for the overrides of feed, rapids and spindle: its buttons, the values that the machine reports, and the
// effect on the time of the job.
import { $, allow, clock, el, onclick, press, say } from "./dom";
import type { Machine } from "./machine";
import type { REALTIME } from "./sender";

type Command = keyof typeof REALTIME;
const ROWS: { name: string; buttons: [Command, string, string][] }[] = [
  { name: "Feed", buttons: [["feedMinus", "−10", "feed 10 % less"], ["feedMinus1", "−1", "feed 1 % less"], ["feed100", "100", "feed at 100 %"], ["feedPlus1", "+1", "feed 1 % more"], ["feedPlus", "+10", "feed 10 % more"]] },
  { name: "Rapids", buttons: [["rapid25", "25 %", "rapids at 25 %"], ["rapid50", "50 %", "rapids at 50 %"], ["rapid100", "100 %", "rapids at 100 %"]] },
  { name: "Spindle", buttons: [["spindleMinus", "−10", "spindle 10 % less"], ["spindleMinus1", "−1", "spindle 1 % less"], ["spindle100", "100", "spindle at 100 %"], ["spindlePlus1", "+1", "spindle 1 % more"], ["spindlePlus", "+10", "spindle 10 % more"]] },
];

export class OverridesPanel {
  private readonly values: HTMLElement[] = [];
  private readonly buttons: HTMLButtonElement[] = [];

  constructor(private readonly machine: Machine) {
    for (const [index, { name, buttons }] of ROWS.entries()) {
      const value = el("b", { id: `override-${index}`, textContent: "100 %" });
      const group = el("div", { className: "seg mc", role: "group", "aria-label": name });
      for (const [command, text, label] of buttons) {
        const made = el("button", { type: "button", textContent: text, "aria-label": label, "data-realtime": command });
        made.addEventListener("click", () => machine.realtime(command));
        group.append(made);
        this.buttons.push(made);
      }
      this.values.push(value);
      $("over").append(el("div", {}, el("span", {}, name, value), group));
    }
    onclick("over-100", () => {
      for (const command of ["feed100", "rapid100", "spindle100"] as const) machine.realtime(command);
    });
    machine.onchange(() => this.update());
    this.update();
  }

  private update(): void {
    const { machine } = this;
    const why = machine.isReached ? machine.phase === "alarm" ? "Nothing moves in an alarm." : undefined : machine.isConnected ? "No connection." : "Connect a machine first.";
    for (const button of this.buttons) {
      allow(button, why);
      const rapid = /^rapid(\d+)$/.exec(button.dataset.realtime ?? "")?.[1];
      if (rapid) press([button], () => machine.overrides[1] === Number(rapid));
    }
    allow($("over-100"), why);
    for (const [index, value] of this.values.entries()) {
      const percent = machine.overrides[index] ?? 100;
      say(value, `${percent} %`);
      (value.closest("div") as HTMLElement).classList.toggle("changed", percent !== 100);
    }
    say("over-why", why ?? this.effect());
  }

  /** Returns how much time the overrides save or cost in the rest of the job. */
  private effect(): string {
    const { running, overrides } = this.machine;
    if (!running) return "";
    const [feed, rapid] = overrides.map(percent => Math.max(0.01, percent / 100));
    const difference = running.follower.left({ feed: 1, rapid: 1 }) - running.follower.left({ feed, rapid });
    if (Math.abs(difference) < 1) return "";
    return `These overrides ${difference > 0 ? "save" : "cost"} ${clock(Math.abs(difference))} of what is left.`;
  }
}
