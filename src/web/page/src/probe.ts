// Probing: the top, an edge, a corner or the middle of a hole becomes work zero.
import { $, allow, button, el, onclick, press, typed } from "./dom";
import { Dialog } from "./dialogs";
import type { Machine } from "./machine";

/** Distance that the tool retracts after a contact, mm. */
const BACK = 2;
/** Distance that the tool moves down beside a corner plate, mm. Before this move, the tool is 2 * BACK above the
 * plate. */
const BESIDE = 8;

type Kind = "z" | "edge" | "corner" | "hole";
const KINDS: Record<Kind, [name: string, text: string]> = {
  z: ["Z", "Finds the top of the work with a touch plate, and sets Z. Put the plate under the cutter."],
  edge: ["Edge", "Finds a side of the work, and sets X or Y there. Put the cutter beside the side, below its upper edge."],
  corner: ["Corner", "Finds the top and two sides with a corner plate, and sets X, Y and Z. Put the cutter over the plate, near its corner."],
  hole: ["Hole", "Finds the middle of a hole, and sets X and Y there. Put the cutter into the hole."],
};
/** Directions in which the tool can move to find an edge. */
const EDGES = ["X+", "X-", "Y+", "Y-"] as const;
const CORNERS: Record<string, [number, number]> = { "front left": [1, 1], "front right": [-1, 1], "back left": [1, -1], "back right": [-1, -1] };

/** Error that is thrown to end a probing cycle early. */
class Ended extends Error {}

export class ProbePanel {
  private readonly dialog: Dialog;
  private kind: Kind = "z";
  private readonly text = el("p", { className: "intro" });
  private readonly kinds = el("div", { className: "seg mc", role: "group", "aria-label": "What to find" });
  private readonly contact = el("p", { id: "probe-contact", className: "finding", role: "status" });
  private readonly go = button("Probe now", () => void this.probe(), "btn go");
  /** Whether the probe circuit was seen closed. */
  private closed = false;
  /** Whether the probe circuit was seen open after it was seen closed. */
  private opened = false;
  /** `stopCalls` of the machine when the cycle began. If the two differ, Stop was pressed or the connection ended. */
  private stops = 0;

  constructor(private readonly machine: Machine) {
    const field = (id: string, label: string, value: string, kinds: Kind[]) => {
      const made = el("label", { className: "field" }, label, el("input", { type: "text", inputMode: "decimal", id, value }));
      made.dataset.kinds = kinds.join(" ");
      return made;
    };
    const choice = (id: string, label: string, options: readonly string[], kinds: Kind[]) => {
      const made = el("label", { className: "field" }, label, el("select", { id }, ...options.map(textContent => el("option", { textContent }))));
      made.dataset.kinds = kinds.join(" ");
      return made;
    };
    for (const [kind, [name]] of Object.entries(KINDS)) {
      const made = el("button", { type: "button", textContent: name });
      made.dataset.kind = kind;
      made.addEventListener("click", () => this.choose(kind as Kind));
      this.kinds.append(made);
    }
    this.go.id = "probe";
    this.dialog = new Dialog("probe-dialog", "Probe", [
      this.kinds, this.text,
      el("div", { className: "fieldrow" }, choice("probe-edge", "The tool moves", EDGES, ["edge"]), choice("probe-corner", "Corner", Object.keys(CORNERS), ["corner"]),
        field("plate", "Plate thickness, mm", "10", ["z", "corner"]), field("plate-side", "Plate at the side, mm", "0", ["edge", "corner"]),
        field("probe-cutter", "Cutter diameter, mm", "3", ["edge", "corner"]), field("probe-depth", "Search at most, mm", "25", ["z", "edge", "corner", "hole"]),
        field("probe-feed", "Speed, mm/min", "100", ["z", "edge", "corner", "hole"])),
      this.contact,
    ]);
    this.dialog.actions(this.go);
    onclick("open-probe", () => {
      [this.closed, this.opened] = [false, false];
      this.choose(this.kind);
      this.dialog.open();
    });
    machine.onchange(() => this.update());
    this.choose("z");
  }

  private choose(kind: Kind): void {
    this.kind = kind;
    this.text.textContent = KINDS[kind][1];
    press(this.kinds.children, ({ dataset }) => dataset.kind === kind);
    for (const field of this.dialog.element.querySelectorAll<HTMLElement>("[data-kinds]")) field.hidden = !field.dataset.kinds?.split(" ").includes(kind);
    this.update();
  }

  private update(): void {
    const { machine } = this;
    allow($("open-probe"), machine.whyNotAtRest);
    if (!this.dialog.isOpen) return;
    const touching = machine.status?.fields.Pn?.includes("P") ?? false;
    if (touching) this.closed = true;
    else if (this.closed) this.opened = true;
    const tried = this.closed && this.opened && !touching;
    this.contact.className = tried ? "finding good" : "finding warn";
    this.contact.textContent = touching ? "The probe is in contact: take it off."
      : tried ? "The probe answers: it was closed, and is open again." : "Touch the plate to the cutter once to test the circuit. You can probe without this test, but a broken cable then goes unnoticed.";
    const turning = /[SC]/.test(machine.accessories) ? "Stop the spindle first." : undefined;
    allow(this.go, machine.whyNotAtRest ?? turning ?? (touching ? "The probe is in contact already." : undefined));
  }

  /** Sends a line of the cycle. Returns the output before the answer. Throws after a Stop or a rejected line, which
   * ends the cycle. */
  private async send(line: string): Promise<string[]> {
    const { machine } = this;
    const stopped = () => machine.stopCalls !== this.stops;
    if (stopped()) throw new Ended("Stopped: nothing is set.");
    const { answer, said } = await machine.ask(line);
    if (stopped() || answer === "reset") throw new Ended("Stopped: nothing is set.");
    if (answer !== "ok") throw new Ended(`Nothing is set: ${machine.explain(answer)}`);
    return said;
  }

  /** Moves an axis until the probe touches, at most `most` mm. `way`: 1 or -1; `feed` in mm/min. Returns the contact
   * position in machine coordinates, mm; `undefined` without contact. */
  private async touch(axis: number, way: number, most: number, feed: number): Promise<number | undefined> {
    const said = await this.send(`G38.3 ${"XYZ"[axis]}${Number((way * most).toFixed(3))} F${feed}`);
    const found = /\[PRB:([^\]]*):([01])\]/.exec(said.join(" "));
    const scale = this.machine.settings[13] === 1 ? 25.4 : 1;
    return found?.[2] === "1" ? Number(found[1].split(",")[axis]) * scale : undefined;
  }

  private async find(axis: number, way: number, most: number, feed: number): Promise<number> {
    const found = await this.touch(axis, way, most, feed);
    if (found === undefined) throw new Ended(`No contact within ${most} mm: the work zero is as it was.`);
    await this.move({ [axis]: -way * BACK });
    return found;
  }

  /** Moves by rapid. `by`: distance for each axis, mm. */
  private async move(by: Record<number, number>): Promise<void> {
    await this.send(`G0 ${Object.entries(by).map(([axis, mm]) => `${"XYZ"[Number(axis)]}${Number(mm.toFixed(3))}`).join(" ")}`);
  }

  /** Moves an axis by `mm` where nothing should be in the way. A contact ends the cycle. */
  private async guarded(axis: number, mm: number, feed: number): Promise<void> {
    if ((await this.touch(axis, Math.sign(mm), Math.abs(mm), feed)) !== undefined) throw new Ended("The tool has touched something on its way: the work zero is as it was.");
  }

  /** Waits until the machine is at rest, by a short dwell. Returns the machine position, mm. */
  private async here(): Promise<number[]> {
    await this.send("G4 P0.05");
    const status = await this.machine.report();
    if (!status) throw new Ended("The machine is gone: nothing is set.");
    return status.machine;
  }

  /** Sets work zero. `places`: the machine position that becomes 0, mm, for each axis number. */
  private async setZero(places: Record<number, number>): Promise<void> {
    const here = await this.here();
    const words = Object.entries(places).map(([axis, place]) => `${"XYZ"[Number(axis)]}${Number((here[Number(axis)] - place).toFixed(4))}`);
    await this.send(`G10 L20 P0 ${words.join(" ")}`);
  }

  /** Runs a probing cycle. Restores the units and modes afterwards, even if the cycle fails. */
  private async probe(): Promise<void> {
    const { machine } = this;
    this.dialog.close();
    if (machine.status?.fields.Pn?.includes("P")) return machine.onnote("The probe is in contact already: nothing is probed.");
    this.stops = machine.stopCalls;
    const modes = (await machine.query("$G")).said.join(" ").match(/\bG(20|21|90|91|93|94|95)\b/g);
    if (!modes) return machine.onnote("The machine does not tell its modes: nothing is probed.");
    machine.onnote("");
    try {
      await this.send("G21 G91 G94");
      await this.cycle(Math.max(0.1, typed("probe-depth") ?? 25), Math.max(1, typed("probe-feed") ?? 100));
      machine.onnote("The work zero is set.");
    } catch (error) {
      if (!(error instanceof Ended)) throw error;
      machine.onnote(error.message);
    }
    await machine.line(modes.join(" "));
  }

  private async cycle(depth: number, feed: number): Promise<void> {
    const plate = typed("plate") ?? 0;
    const beside = (typed("probe-cutter") ?? 0) / 2 + (typed("plate-side") ?? 0);
    switch (this.kind) {
      case "z":
        return this.setZero({ 2: (await this.find(2, -1, depth, feed)) - plate });
      case "edge": {
        const [axis, way] = [$<HTMLSelectElement>("probe-edge").value[0] === "X" ? 0 : 1, $<HTMLSelectElement>("probe-edge").value[1] === "+" ? 1 : -1];
        return this.setZero({ [axis]: (await this.find(axis, way, depth, feed)) + way * beside });
      }
      case "hole": {
        const places: Record<number, number> = {};
        for (const axis of [0, 1]) {
          const one = await this.find(axis, 1, depth, feed);
          const other = await this.find(axis, -1, 2 * depth, feed);
          places[axis] = (one + other) / 2;
          // Move to the middle, from which the other axis is probed.
          await this.move({ [axis]: places[axis] - (other + BACK) });
        }
        return this.setZero(places);
      }
      case "corner": {
        const ways = CORNERS[$<HTMLSelectElement>("probe-corner").value];
        const places: Record<number, number> = { 2: (await this.find(2, -1, depth, feed)) - plate };
        const start = await this.here();
        for (const axis of [0, 1]) {
          // Start above the plate. Go outward past its side, down beside it, and back until contact. Then return to
          // the start.
          await this.move({ 2: BACK });
          await this.move({ [axis]: -ways[axis] * depth });
          await this.guarded(2, -BESIDE, feed * 2);
          places[axis] = (await this.find(axis, ways[axis], depth, feed)) + ways[axis] * beside;
          await this.move({ 2: BESIDE });
          await this.move({ [axis]: start[axis] - (await this.here())[axis] });
          await this.move({ 2: -BACK });
        }
        return this.setZero(places);
      }
    }
  }
}
