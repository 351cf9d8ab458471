// Macros: lines with a name. The firmware checks the lines before they are saved.
import { $, allow, button, el, onclick } from "./dom";
import { Dialog } from "./dialogs";
import * as firmware from "./firmware";
import type { Machine } from "./machine";
import type { Page } from "./page";

export interface Macro { name: string; lines: string }
const STORED = "oxmill macros";

export class Macros {
  private all = stored();
  private readonly dialog: Dialog;
  private readonly list = el("div", { className: "grid3" });
  private readonly name = el("input", { type: "text", id: "macro-name" });
  private readonly text = el("textarea", { id: "macro-lines", rows: 6, spellcheck: false });
  private readonly note = el("p", { className: "note", id: "macro-note", role: "status" });
  /** Index of the macro being edited; -1 for a new one. */
  private at = -1;

  constructor(private readonly machine: Machine, private readonly page: Page) {
    this.dialog = new Dialog("macro-dialog", "Macros", [this.list, el("label", { className: "field" }, "Name", this.name), el("label", { className: "field" }, "Lines", this.text), this.note]);
    this.dialog.actions(button("Remove", () => this.remove()), button("Keep", () => void this.keep(), "btn go"));
    onclick("edit-macros", () => {
      this.edit(0);
      this.dialog.open();
    });
    machine.onchange(() => this.update());
    this.show();
  }

  private edit(at: number): void {
    this.at = at < this.all.length ? at : -1;
    const macro = this.all[this.at] ?? { name: "", lines: "" };
    [this.name.value, this.text.value, this.note.textContent] = [macro.name, macro.lines, ""];
    this.list.replaceChildren(...this.all.map(({ name }, index) => button(name, () => this.edit(index))), button("New", () => this.edit(this.all.length)));
  }

  private remove(): void {
    if (this.at >= 0) this.all.splice(this.at, 1);
    this.store();
    this.edit(0);
  }

  /** Saves the typed macro if the firmware accepts each line. */
  private async keep(): Promise<void> {
    const macro = { name: this.name.value.trim(), lines: this.text.value.trim() };
    if (!macro.name || !macro.lines) return void (this.note.textContent = "A macro needs a name and lines.");
    this.note.textContent = "Checking";
    // Do not check lines with `$`: they are for the real machine only. Blank them, so that line numbers stay.
    const program = macro.lines.split("\n").map(line => (line.trim().startsWith("$") ? "" : line)).join("\n");
    const { summary } = await firmware.check({ ...this.page.order(), name: macro.name }, new TextEncoder().encode(program));
    const [error] = summary.errors;
    if (error) return void (this.note.textContent = `Not kept. Line ${error.line}: ${error.text}. ${error.advice}`);
    if (this.at < 0) this.all.push(macro);
    else this.all[this.at] = macro;
    this.store();
    this.dialog.close();
  }

  private store(): void {
    try {
      localStorage.setItem(STORED, JSON.stringify(this.all));
    } catch {
      // Without storage, the macros are lost when the page is closed.
    }
    this.show();
  }

  private show(): void {
    $("macros").replaceChildren(...this.all.map(({ name, lines }) => {
      const made = button(name, () => void this.run(lines), "btn mc");
      made.dataset.lines = lines;
      return made;
    }), ...(this.all.length ? [] : [el("p", { className: "why", textContent: "No macro yet: lines of your own, sent at a press." })]));
    this.update();
  }

  private async run(lines: string): Promise<void> {
    const why = await this.machine.sequence(lines.split("\n").map(line => line.trim()).filter(Boolean));
    if (why && why !== "stopped") this.machine.onnote(`The macro has ended: ${why}`);
  }

  private update(): void {
    for (const made of $("macros").querySelectorAll("button")) allow(made, this.machine.whyNotAtRest, made.dataset.lines);
  }
}

function stored(): Macro[] {
  try {
    const kept: unknown = JSON.parse(localStorage.getItem(STORED) ?? "null");
    if (Array.isArray(kept)) return kept.filter(one => typeof one?.name === "string" && typeof one?.lines === "string");
  } catch {
    // Another page may have stored these data: ignore them.
  }
  // There are no predefined macros: what is safe depends on the machine.
  return [];
}
