// The rest of an interrupted job as a self-contained program: from which line on, and how the tool moves there.
import { $, onclick, save } from "./dom";
import type { Resume } from "./engine";
import * as firmware from "./firmware";
import type { Job, JobPanel, Page } from "./page";
import { choose } from "./tabs";

export class ContinuePanel implements JobPanel {
  private running?: AbortController;

  constructor(private readonly page: Page) {
    onclick("write-rest", () => void this.write(save));
    onclick("load-rest", () => void this.write((name, text) => page.open(name, new TextEncoder().encode(text))));
    onclick("this-line", () => {
      input("from-line").value = String(Math.max(1, page.player.line));
      void this.preview();
    });
    for (const id of ["from-line", "clearance", "plunge", "spin-up"]) input(id).addEventListener("change", () => void this.preview());
  }

  clear(): void {
    this.running?.abort(new Error("the job or its settings have changed"));
    this.draw("", []);
  }

  /** Opens the panel for a job that stopped at a line. */
  from(job: Job, line: number): void {
    if (this.page.job !== job) this.page.open(job.name, job.bytes);
    input("from-line").value = String(line);
    this.page.go("check");
    choose("tab-continue");
    void this.preview();
    $("load-rest").focus();
  }

  private async rest(done: (name: string, program: string) => void): Promise<void> {
    this.running?.abort(new Error("another line was chosen"));
    const { signal } = (this.running = new AbortController());
    const { name, bytes } = this.page.job;
    try {
      const rest = await firmware.resume(this.page.order({ resume: resumeOptions() }), bytes, signal);
      this.draw(`First the lines shown above, then line ${rest.line.toLocaleString("en")} to line ${rest.lines.toLocaleString("en")}.`, rest.prologue);
      done(`${name.replace(/\.[^.]*$/, "")}-from-${rest.line}.nc`, rest.program);
    } catch (error) {
      if (!signal.aborted) this.draw((error as Error).message, []);
    }
  }

  private async preview(): Promise<void> {
    if (this.page.job.name) await this.rest(() => {});
  }

  private async write(done: (name: string, program: string) => void): Promise<void> {
    this.draw("Writing", []);
    await this.rest(done);
  }

  private draw(note: string, prologue: string[]): void {
    $("continue-note").textContent = note;
    $("prologue").textContent = prologue.join("\n");
    $("prologue-part").hidden = prologue.length === 0;
  }
}

const input = (id: string): HTMLInputElement => $<HTMLInputElement>(id);

/** Returns the typed values; fields left blank are omitted. */
function resumeOptions(): Resume {
  const typed = (id: string) => (input(id).value === "" ? undefined : input(id).valueAsNumber);
  const whole = (id: string) => Math.max(0, Math.trunc(typed(id) ?? 0));
  return { line: whole("from-line"), clearance: typed("clearance"), plunge: typed("plunge"), spin_up: Math.min(600, whole("spin-up")) };
}
