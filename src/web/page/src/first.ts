// The start page, where the user chooses a machine and a job. Each sample shows its time on the chosen machine.
import { $, el, minutes } from "./dom";
import * as firmware from "./firmware";
import type { Page } from "./page";
import { outline } from "./player";
import { PRESETS, summary, travel } from "./presets";
import type { Settings } from "./settings";

/** Displayed name of each sample, by file name. */
const NAMES: Record<string, string> = { "five_circles.nc": "Five circles", "house.nc": "House", "pocket_mm.nc": "Pocket", "pocket_inch.nc": "Pocket, inch", "pcb_isolation.nc": "Circuit board" };

export class FirstVisit {
  private running?: AbortController;
  private readonly times = new Map<string, HTMLElement>();
  private drawn = false;

  constructor(private readonly page: Page, private readonly settings: Settings, openImport: () => void) {
    for (const preset of PRESETS) $("machines").append(this.card(preset.id, preset.name, summary(number => preset.values[number] ?? settings.default(number) ?? 0), travel(number => preset.values[number] ?? settings.default(number) ?? 0), () => settings.choose(preset.id)));
    $("machines").append(this.card("own", "My own", "import its $$, a backup or a FluidNC file, or read it by USB", "", openImport));
    $("machines").addEventListener("keydown", event => this.move(event));
    for (const [name, text] of Object.entries(firmware.examples)) {
      const time = el("span", { textContent: "…" });
      this.times.set(name, time);
      const made = el("button", { type: "button", className: "sample", title: name }, el("i"), el("b", { textContent: NAMES[name] ?? name }), time);
      made.dataset.sample = name;
      made.addEventListener("click", () => page.open(name, new TextEncoder().encode(text)));
      $("samples").append(made);
    }
    settings.onchange(() => this.update());
    this.update();
  }

  private card(id: string, name: string, line: string, size: string, act: () => void): HTMLElement {
    const made = el("button", { type: "button", className: "machine", role: "radio" }, el("i"), el("b", { textContent: name }), el("em", { textContent: size }), el("small", { textContent: line }));
    made.dataset.machine = id;
    made.addEventListener("click", act);
    return made;
  }

  /** Arrow keys select the next or the previous machine, as in all radio groups. */
  private move(event: KeyboardEvent): void {
    const step = { ArrowDown: 1, ArrowRight: 1, ArrowUp: -1, ArrowLeft: -1 }[event.key];
    if (!step) return;
    event.preventDefault();
    const cards = [...$("machines").children] as HTMLElement[];
    const next = cards[(cards.indexOf(document.activeElement as HTMLElement) + step + cards.length) % cards.length];
    next.focus();
    if (next.dataset.machine !== "own") next.click();
  }

  private get chosen(): string {
    return this.settings.changes().length ? "own" : this.settings.preset.id;
  }

  update(): void {
    for (const card of $("machines").children as Iterable<HTMLElement> & HTMLCollection) {
      const chosen = (card as HTMLElement).dataset.machine === this.chosen;
      card.setAttribute("aria-checked", String(chosen));
      (card as HTMLElement).tabIndex = chosen ? 0 : -1;
    }
    $("machine-source").textContent = this.chosen === "own" ? "Your own settings, kept in this browser." : this.settings.preset.source;
    this.drawn = false;
    if ($("app").dataset.workspace === "first") void this.forecast();
  }

  /** Call when the start page is shown: makes the forecasts that are missing. */
  show(): void {
    if (!this.drawn) void this.forecast();
  }

  /** Call when another page is shown: stops pending forecasts. */
  hide(): void {
    this.running?.abort(new Error("the start page is left"));
  }

  private async forecast(): Promise<void> {
    this.drawn = true;
    this.running?.abort(new Error("another machine was chosen"));
    const { signal } = (this.running = new AbortController());
    for (const time of this.times.values()) time.textContent = "…";
    const order = { ...this.page.order({ path: true }), work_zero: undefined };
    try {
      await firmware.each(Object.entries(firmware.examples).map(([name, text]) => async () => {
        const { summary, path } = await firmware.check({ ...order, name }, new TextEncoder().encode(text), signal);
        const time = this.times.get(name) as HTMLElement;
        time.textContent = summary.errors.length || summary.alarm ? "does not run" : minutes(summary.forecast_s);
        if (path) time.parentElement?.firstElementChild?.replaceWith(outline(path, 92, 56));
      }), () => {});
    } catch (error) {
      if (signal.aborted) {
        // The missing forecasts are made when the start page is shown again.
        if (this.running?.signal === signal) this.drawn = false;
        return;
      }
      for (const time of this.times.values()) if (time.textContent === "…") time.textContent = "";
      $("machine-source").textContent = (error as Error).message;
    }
  }
}
