// The position of the machine: work and machine coordinates of each axis, and the work zero.
import { $, allow, el, onclick, press, say } from "./dom";
import type { Machine } from "./machine";
import { type Unit, units } from "./units";

const SYSTEMS = ["G54", "G55", "G56", "G57", "G58", "G59"];
/** Maximum distance from X0 Y0 at which the tool may move down to Z0, mm. */
const OVER_ZERO = 0.5;

export class PositionPanel {
  private rows: { letter: string; work: HTMLInputElement; at: HTMLElement; zero: HTMLButtonElement }[] = [];

  /** `safeHeight` returns the lowest Z in work coordinates at which nothing is in the way. */
  constructor(private readonly machine: Machine, private readonly safeHeight: () => number) {
    $("system").append(...SYSTEMS.map((textContent, index) => el("option", { textContent, value: String(index + 1) })));
    $("system").addEventListener("change", () => void machine.line(SYSTEMS[Number($<HTMLSelectElement>("system").value) - 1]));
    for (const button of document.querySelectorAll<HTMLElement>("[data-unit]")) button.addEventListener("click", () => units.choose(button.dataset.unit as Unit));
    units.onchange(() => this.update());
    onclick("zero-xy", () => this.zero(["X", "Y"]));
    onclick("zero-all", () => this.zero(machine.axes));
    onclick("go-xy", () => void this.go("xy"));
    onclick("go-z", () => void this.go("z"));
    machine.onchange(() => this.update());
    this.update();
  }

  /** Sets the work zero of these axes to the present position. */
  zero(axes: string[]): void {
    void this.machine.line(`G10 L20 P${this.machine.system} ${axes.map(axis => `${axis}0`).join(" ")}`);
  }

  /** Sets the work zero of an axis such that `text`, as typed, becomes the work coordinate of the present position. */
  private async name(axis: string, text: string): Promise<void> {
    const value = axis < "X" ? Number(text.replace(",", ".")) : units.parse(text);
    this.update();
    if (value === undefined || !Number.isFinite(value)) return;
    // The machine reads numbers in its active unit, G20 or G21.
    const unit = axis >= "X" && this.machine.modes.includes("G20") ? 25.4 : 1;
    await this.machine.line(`G10 L20 P${this.machine.system} ${axis}${Number((value / unit).toFixed(5))}`);
  }

  private async go(where: "xy" | "z"): Promise<void> {
    const { machine } = this;
    const feed = (axis: number) => Math.max(1, machine.settings[110 + axis] ?? 500);
    const height = Math.max(this.safeHeight(), machine.status?.work[2] ?? 0);
    const jogs = where === "xy"
      ? [`$J=G90 G21 Z${height.toFixed(3)} F${feed(2)}`, `$J=G90 G21 X0 Y0 F${Math.min(feed(0), feed(1))}`]
      : [`$J=G90 G21 Z0 F${Math.max(1, Math.round(feed(2) / 4))}`];
    const why = await machine.sequence(jogs);
    if (why && why !== "stopped") machine.onnote(`Not done: ${why}`);
  }

  private build(letters: string[]): void {
    this.rows = letters.map(letter => {
      const work = el("input", { type: "text", inputMode: "decimal", "aria-label": `Work ${letter}: type a value to set the work position here`, id: `work-${"XYZABC".indexOf(letter)}` });
      const zero = el("button", { type: "button", className: "btn mc", textContent: `Zero ${letter}`, "aria-label": `Zero ${letter}: set work zero of ${letter} here` });
      zero.addEventListener("click", () => this.zero([letter]));
      work.addEventListener("change", () => {
        const text = work.value;
        work.blur();
        void this.name(letter, text);
      });
      work.addEventListener("focus", () => work.select());
      work.addEventListener("keydown", event => {
        if (event.key === "Escape") work.blur();
      });
      return { letter, work, at: el("span", { id: `at-${"XYZABC".indexOf(letter)}` }), zero };
    });
    $("dro").replaceChildren(...this.rows.map(({ letter, work, at, zero }) => el("tr", {}, el("th", { scope: "row", textContent: letter }),
      el("td", { className: "work n" }, work), el("td", { className: "at n" }, at), el("td", {}, zero))));
  }

  private update(): void {
    const { machine } = this;
    const { axes, status } = machine;
    if (axes.join() !== this.rows.map(row => row.letter).join()) this.build(axes);
    $("dro-card").hidden = !machine.isConnected;
    $("dro-card").classList.toggle("unsure", machine.isUnsure);
    for (const [axis, row] of this.rows.entries()) {
      const shown = (value = 0) => (row.letter < "X" ? `${value.toFixed(3)}°` : units.length(value));
      const value = shown(status?.work[axis]);
      if (document.activeElement !== row.work && row.work.value !== value) row.work.value = value;
      say(row.at, shown(status?.machine[axis]));
      allow(row.work, machine.whyNotAtRest, "Type a value to set the work position here");
      allow(row.zero, machine.whyNotAtRest);
    }
    press(document.querySelectorAll("[data-unit]"), button => button.dataset.unit === units.name);
    if (machine.system > 0) $<HTMLSelectElement>("system").value = String(machine.system);
    const why = machine.whyNotAtRest;
    for (const id of ["system", "zero-xy", "zero-all", "go-xy"]) allow($(id), why);
    $("go-xy").title ||= "Lifts Z to the safe height first";
    const [x = 0, y = 0] = status?.work ?? [];
    const away = Math.abs(x) > OVER_ZERO || Math.abs(y) > OVER_ZERO ? "Only over X0 Y0: use Go to XY 0 first." : undefined;
    allow($("go-z"), why ?? away);
    say("dro-why", machine.isUnsure ? "The position may be wrong until the machine is homed." : "");
  }
}
