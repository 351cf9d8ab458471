// The tool table of the machine: lengths by tool number, as reported by `$#`.
import { $, allow, button, el, onclick, typed } from "./dom";
import { Dialog } from "./dialogs";
import type { Machine } from "./machine";

export interface Tool { number: number; offset: number[] }

/** Returns the tools in the output of `$#`. */
export const toolsOf = (stored: string[]): Tool[] =>
  stored.flatMap(line => {
    const found = /^\[T:(\d+)\|([^\]|]*)(?:\|[^\]]*)?\]$/.exec(line);
    return found ? [{ number: Number(found[1]), offset: found[2].split(",").map(Number) }] : [];
  });

/** Returns lines that set the same offsets and tools on another machine. `stored`: output of `$#`; `unit`: mm per unit
 * of its lengths. */
export function storedLines(stored: string[], unit: number): string[] {
  const words = (values: string) => values.split(",").slice(0, 4).map((value, axis) => `${"XYZA"[axis]}${Number((Number(value) * (axis < 3 ? unit : 1)).toFixed(4))}`).join(" ");
  const systems = stored.flatMap(line => {
    const found = /^\[G5([4-9])(?:\.([1-3]))?:([^\]]*)\]$/.exec(line);
    return found ? [`G10 L2 P${Number(found[1]) - 3 + Number(found[2] ?? 0)} ${words(found[3])}`] : [];
  });
  const tools = stored.flatMap(line => {
    const found = /^\[T:(\d+)\|([^\]|]*)(?:\|[^\]]*)?\]$/.exec(line);
    return found ? [`G10 L1 P${found[1]} ${words(found[2])}`] : [];
  });
  return [...systems, ...tools];
}

export class ToolTable {
  private readonly dialog: Dialog;
  private readonly body = el("tbody");
  private readonly note = el("p", { className: "note", id: "tool-note", role: "status" });

  constructor(private readonly machine: Machine) {
    const head = el("thead", {}, el("tr", {}, ...["Tool", "Length, mm", ""].map(textContent => el(textContent ? "th" : "td", { textContent }))));
    const field = (id: string, text: string) => el("label", { className: "field" }, text, el("input", { type: "text", inputMode: "decimal", id }));
    this.dialog = new Dialog("tool-dialog", "Tool table", [
      el("p", { className: "intro", textContent: "G43 H5 takes the length of tool 5 from this table. The machine keeps it." }),
      el("table", { className: "plain", id: "tool-table" }, head, this.body),
      el("div", { className: "fieldrow" }, field("tool-number", "Number"), field("tool-length", "Length, mm"), button("Put in", () => void this.put())),
      this.note,
    ]);
    this.dialog.actions();
    onclick("open-tools", () => {
      this.show();
      this.dialog.open();
    });
    machine.onchange(() => {
      allow($("open-tools"), machine.whyNotAtRest);
      if (this.dialog.isOpen) this.show();
    });
  }

  /** Millimetres per unit in which the machine reads lengths: 25.4 with G20, otherwise 1. */
  private get unit(): number {
    return this.machine.modes.includes("G20") ? 25.4 : 1;
  }

  private async put(): Promise<void> {
    const [number, length] = [typed("tool-number"), typed("tool-length")];
    if (number === undefined || length === undefined || number < 1 || number !== Math.trunc(number)) return void (this.note.textContent = "A tool has a whole number from 1 on, and a length.");
    await this.order(`G10 L1 P${number} Z${Number((length / this.unit).toFixed(5))}`);
  }

  private async order(line: string): Promise<void> {
    const answer = await this.machine.line(line);
    this.note.textContent = answer === "ok" ? "" : `Not done: ${this.machine.explain(answer)}`;
  }

  private show(): void {
    const tools = toolsOf(this.machine.stored);
    const key = JSON.stringify(tools);
    if (this.body.dataset.key === key) return;
    this.body.dataset.key = key;
    this.body.replaceChildren(...tools.map(({ number, offset }) => el("tr", {}, el("td", { textContent: `T${number}` }), el("td", { textContent: (offset[2] ?? 0).toFixed(3) }),
      el("td", { className: "n" }, button("Take out", () => void this.order(`G10 L1 P${number}`), "link")))));
    if (tools.length === 0) this.body.append(el("tr", {}, el("td", { colSpan: 3, textContent: "No tool is in it." })));
  }
}
