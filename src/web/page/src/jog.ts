// Jogging: by steps or while a button is held, in all directions, by buttons or keys.
import { $, allow, el, icon, press, say } from "./dom";
import type { Machine } from "./machine";
import { REALTIME } from "./sender";
import { units } from "./units";

/** Duration of each move of a held jog, s. */
const JOG_SECONDS = 0.2;
/** Maximum number of moves of a held jog that are sent and, by the last report, not yet done. If the page crashes, the
 * machine makes only these moves. */
const JOGS_AHEAD = 3;
/** Steps in the displayed unit. */
const STEPS = { mm: [0.001, 0.01, 0.1, 1, 10], inch: [0.0005, 0.005, 0.05, 0.5] };
/** Jogging by keys is switched off after this time without a jog, ms. */
const FORGETFUL = 5 * 60_000;

/** Direction of each axis that a jog moves, by axis letter. */
export type Way = Record<string, 1 | -1>;
const WAYS: { way: Way; turn: number; label: string }[] = [
  { way: { X: -1, Y: 1 }, turn: -45, label: "" }, { way: { Y: 1 }, turn: 0, label: "Y+" }, { way: { X: 1, Y: 1 }, turn: 45, label: "" },
  { way: { X: -1 }, turn: -90, label: "X−" }, { way: { X: 1 }, turn: 90, label: "X+" },
  { way: { X: -1, Y: -1 }, turn: -135, label: "" }, { way: { Y: -1 }, turn: 180, label: "Y−" }, { way: { X: 1, Y: -1 }, turn: 135, label: "" },
];

const named = (way: Way): string => Object.entries(way).map(([axis, sign]) => `${axis} to ${sign > 0 ? "plus" : "minus"}`).join(" and ");

export class JogPanel {
  /** The step in mm; 0 = jog for as long as a button is held. */
  private step = 1;
  private pads: HTMLButtonElement[] = [];
  private axes = "";
  /** Identifies the button or key that is held to jog; `undefined` if none is held. */
  private jogging?: object;
  /** Resolved when the last held jog has ended. */
  private jogged = Promise.resolve();
  private used = 0;

  constructor(private readonly machine: Machine) {
    for (const button of $("feeds").querySelectorAll<HTMLElement>("button")) {
      button.addEventListener("click", () => this.chooseFeed(Number(button.dataset.share)));
    }
    $("jog-feed").addEventListener("change", () => press($("feeds").children, () => false));
    $("key-jog").addEventListener("change", () => (this.used = performance.now()));
    units.onchange(() => {
      this.buildSteps();
      this.chooseFeed();
    });
    this.buildSteps();
    this.build(["X", "Y", "Z"]);
    machine.onchange(() => this.update());
    addEventListener("blur", () => this.end());
    this.update();
  }

  /** Whether arrow keys jog. */
  get keys(): boolean {
    return $<HTMLInputElement>("key-jog").checked;
  }

  switchKeysOff(): void {
    $<HTMLInputElement>("key-jog").checked = false;
  }

  /** Changes to the next larger step (`by` is 1) or to the next smaller step (`by` is -1). */
  changeStep(by: number): void {
    const steps = STEPS[units.name].map(step => step * units.size);
    const at = steps.findIndex(step => Math.abs(step - this.step) < 1e-9);
    this.chooseStep(steps[Math.max(0, Math.min(steps.length - 1, (at < 0 ? 3 : at) + by))]);
  }

  private chooseStep(step: number): void {
    this.step = step;
    this.buildSteps();
  }

  private buildSteps(): void {
    const button = (step: number, text: string, className = "") => {
      const made = el("button", { type: "button", textContent: text, className, "aria-pressed": Math.abs(step - this.step) < 1e-9 });
      made.addEventListener("click", () => this.chooseStep(step));
      return made;
    };
    const hold = button(0, "Hold", "hold-step");
    hold.title = "Moves as long as you hold the button";
    $("steps").replaceChildren(...STEPS[units.name].map(step => button(step * units.size, String(step))), hold);
    const own = document.getElementById("own-step") as HTMLInputElement | null;
    if (own) own.value = this.step ? String(Number((this.step / units.size).toFixed(5))) : "hold";
    const name = document.getElementById("step-unit");
    if (name) name.textContent = units.name;
    say("jog-unit", `${units.name === "mm" ? "mm" : "in"}/min`);
    this.update();
  }

  /** Sets the feed to a share of the maximum rate; without `share`, shows the chosen share in the new unit. */
  private chooseFeed(share?: number): void {
    const chosen = share ?? Number($("feeds").querySelector<HTMLElement>('[aria-pressed="true"]')?.dataset.share ?? 0);
    if (!chosen) return;
    const rate = Math.min(this.machine.settings[110] ?? 1000, this.machine.settings[111] ?? 1000);
    $<HTMLInputElement>("jog-feed").value = String(Number(((rate * chosen) / units.size).toFixed(units.name === "mm" ? 0 : 2)));
    press($("feeds").children, button => Number(button.dataset.share) === chosen);
  }

  /** Returns the typed feed, limited to the maximum of these axes, in mm/min. */
  private feed(way: Way): number {
    const typed = units.parse($<HTMLInputElement>("jog-feed").value) ?? 1;
    const most = Object.keys(way).map(axis => this.machine.settings[110 + "XYZABC".indexOf(axis)] ?? Infinity);
    // On a diagonal, each axis moves at only a part of the feed, so the feed can be higher.
    return Math.max(1, Math.min(typed, Math.min(...most) * Math.sqrt(most.length)));
  }

  private build(axes: string[]): void {
    this.axes = axes.join("");
    this.pads = [];
    const pad = (way: Way, turn: number, label: string, column: number, row: number) => {
      const arrow = icon("arrow");
      arrow.style.transform = `rotate(${turn}deg)`;
      const made = el("button", { type: "button", className: "btn mc", "aria-label": `jog ${named(way)}` }, arrow, label);
      made.style.gridArea = `${row} / ${column}`;
      this.listen(made, way);
      this.pads.push(made);
      return made;
    };
    const own = el("input", { type: "text", inputMode: "decimal", id: "own-step", "aria-label": "Step of your own" });
    own.addEventListener("change", () => {
      const step = units.parse(own.value);
      if (step !== undefined && step > 0 && step <= 1000) this.chooseStep(step);
      else this.buildSteps();
    });
    const middle = el("div", { className: "mid" }, own, el("span", { id: "step-unit" }));
    middle.style.gridArea = "2 / 2";
    const places = [[1, 1], [2, 1], [3, 1], [1, 2], [3, 2], [1, 3], [2, 3], [3, 3]];
    const others = axes.slice(2).flatMap((axis, index) => {
      const label = el("div", { className: "mid", textContent: axis });
      label.style.gridArea = `2 / ${5 + index}`;
      return [pad({ [axis]: 1 }, 0, `${axis}+`, 5 + index, 1), label, pad({ [axis]: -1 }, 180, `${axis}−`, 5 + index, 3)];
    });
    $("pads").classList.toggle("four", axes.length > 3);
    $("pads").replaceChildren(...WAYS.map(({ way, turn, label }, index) => pad(way, turn, label, places[index][0], places[index][1])), middle, ...others);
    this.buildSteps();
  }

  private listen(button: HTMLButtonElement, way: Way): void {
    const begin = (event: Event, fine: boolean) => {
      event.preventDefault();
      button.focus();
      this.press(way, fine ? this.step / 10 : this.step);
    };
    button.addEventListener("pointerdown", event => {
      if (event.button !== 0 || button.disabled) return;
      button.setPointerCapture(event.pointerId);
      begin(event, event.shiftKey);
    });
    button.addEventListener("keydown", event => {
      if (!event.repeat && (event.key === " " || event.key === "Enter")) begin(event, event.shiftKey);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "keyup", "blur"]) button.addEventListener(end, () => this.end());
  }

  /** Makes a step, or jogs until `end` is called. */
  press(way: Way, step = this.step): void {
    this.used = performance.now();
    if (this.machine.whyNot !== undefined) return;
    if (step > 0) return void this.single(way, step);
    if (this.jogging) return;
    const press = (this.jogging = {});
    this.jogged = this.jogged.then(() => this.hold(way, press));
  }

  /** Handles a jog key: makes one step or, if `held` (with Shift), jogs until the key is released. */
  key(way: Way, held: boolean): void {
    if (held) this.press(way, 0);
    else this.press(way, this.step || STEPS[units.name][2] * units.size);
  }

  private async single(way: Way, step: number): Promise<void> {
    const words = Object.entries(way).map(([axis, sign]) => `${axis}${Number((sign * step).toFixed(5))}`);
    const { machine } = this;
    if (machine.settings[110] === undefined) await machine.readSettings();
    const text = `$J=G91 G21 ${words.join(" ")} F${Number(this.feed(way).toFixed(1))}`;
    const answer = await machine.sender?.command(text);
    if (answer && answer !== "ok") this.refused(text, answer);
    else say("jog-why", "");
  }

  private refused(text: string, answer: string): void {
    this.machine.onsay(`${text}: ${answer}`, "wrong");
    say("jog-why", `Not done: ${this.machine.explain(answer)}`);
  }

  /** Sends short jogs while the button is held. */
  private async hold(way: Way, press: object): Promise<void> {
    const { machine } = this;
    const { sender } = machine;
    const held = () => this.jogging === press && machine.sender === sender;
    // Request the settings if they are unknown: a machine in motion may have refused the first request.
    if (sender && held() && machine.settings[110] === undefined) await machine.readSettings();
    if (!sender || !held()) return;
    const axes = Object.keys(way).map(axis => "XYZABC".indexOf(axis));
    const feed = this.feed(way);
    const distance = Number(((feed / 60) * JOG_SECONDS / Math.sqrt(axes.length)).toFixed(3)) || 0.001;
    const text = `$J=G91 G21 ${Object.entries(way).map(([axis, sign]) => `${axis}${sign < 0 ? "-" : ""}${distance.toFixed(3)}`).join(" ")} F${Number(feed.toFixed(1))}`;
    const at = () => machine.status?.machine[axes[0]] ?? 0;
    const from = at();
    for (let sent = 0; held(); ) {
      // The machine answers when a jog is planned, not when it is done. Only the reports show the progress.
      if (sent * distance >= Math.abs(at() - from) + JOGS_AHEAD * distance) {
        await new Promise(resolve => setTimeout(resolve, 20));
        continue;
      }
      sent++;
      const answer = await sender.command(text);
      // Cancel once more: a jog that was being sent at the release of the button can arrive after the first jog
      // cancel.
      if (!held() && machine.sender === sender) sender.realtime(REALTIME.jogCancel);
      if (answer !== "ok") {
        this.refused(text, answer);
        break;
      }
    }
    if (held()) this.end();
  }

  end(): void {
    if (!this.jogging) return;
    this.jogging = undefined;
    this.machine.sender?.realtime(REALTIME.jogCancel);
  }

  private update(): void {
    const { machine } = this;
    if (machine.axes.join("") !== this.axes && machine.status) this.build(machine.axes);
    if (this.keys && performance.now() - this.used > FORGETFUL) this.switchKeysOff();
    const why = machine.whyNot;
    // End the jog here, because a disabled button does not report its release.
    if (why) this.end();
    if (why && machine.phase !== "jog") this.switchKeysOff();
    $("jog-card").hidden = !machine.isConnected;
    for (const pad of this.pads) allow(pad, why);
    for (const button of $("steps").children) allow(button as HTMLElement, why, button.classList.contains("hold-step") ? "Moves as long as you hold the button" : "");
    for (const button of $("feeds").children) allow(button as HTMLElement, why);
    allow($("jog-feed"), why);
    const own = document.getElementById("own-step");
    if (own) allow(own, why);
    allow($("key-jog"), why);
    if (why) say("jog-why", why);
    else if (/^Off |^Connect|^Waiting|^The machine/.test($("jog-why").textContent ?? "")) say("jog-why", "");
    if (machine.settings[110] !== undefined && $("feeds").dataset.of !== String(machine.settings[110])) {
      $("feeds").dataset.of = String(machine.settings[110]);
      this.chooseFeed(0.4);
    }
  }
}

