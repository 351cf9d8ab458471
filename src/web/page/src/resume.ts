// The panel for the rest of a job that was broken off: from which line on, and how the tool goes there.
import type { App } from "./app";
import { $, el } from "./dom";
import type { Resume } from "./engine";
import * as firmware from "./firmware";

export class ResumePanel {
  private running?: AbortController;

  constructor(private readonly app: App) {
    $("write-rest").addEventListener("click", () => void this.write());
    $("this-line").addEventListener("click", () => (input("rest-line").value = String(Math.max(1, app.player.line))));
  }

  /** Another job, or other settings: what was written is void. */
  clear(): void {
    this.running?.abort(new Error("the job or its settings have changed"));
    this.show("", []);
  }

  private async write(): Promise<void> {
    this.running?.abort(new Error("another line was chosen"));
    const { signal } = (this.running = new AbortController());
    const { name, bytes } = this.app.job;
    this.show("Writing", []);
    try {
      const rest = await firmware.resume(this.app.order({ resume: wish() }), bytes, signal);
      this.show(`Line ${rest.line} of ${rest.lines} and what follows, behind these lines:`, rest.prologue);
      save(`${name.replace(/\.[^.]*$/, "")}-from-${rest.line}.nc`, rest.program);
    } catch (error) {
      if (!signal.aborted) this.show((error as Error).message, []);
    }
  }

  private show(note: string, prologue: string[]): void {
    $("rest-note").textContent = note;
    $("prologue").textContent = prologue.join("\n");
    $("prologue").hidden = prologue.length === 0;
  }
}

const input = (id: string): HTMLInputElement => $<HTMLInputElement>(id);

/** What is typed; what is left blank is left out. */
function wish(): Resume {
  const typed = (id: string) => (input(id).value === "" ? undefined : input(id).valueAsNumber);
  const whole = (id: string) => Math.max(0, Math.trunc(typed(id) ?? 0));
  return { line: whole("rest-line"), clearance: typed("clearance"), plunge: typed("plunge"), spin_up: Math.min(600, whole("spin-up")) };
}

/** Gives a person a file. */
function save(name: string, text: string): void {
  const link = el("a", { href: URL.createObjectURL(new Blob([text], { type: "text/plain" })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}
