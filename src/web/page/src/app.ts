// The page: a job, the settings that it is checked with, and the panels that show what the firmware makes of it.
import { $, el } from "./dom";
import type { Description, Order, Path, Summary } from "./engine";
import * as firmware from "./firmware";
import { MachinePanel } from "./machine";
import { MaterialPanel } from "./stock";
import { ResumePanel } from "./resume";
import { Player } from "./player";
import { placeAt } from "./track";
import { SettingsPanel } from "./settings";
import { clearReport, showReport } from "./report";
import { ForecastPanels } from "./forecast";
import { tabs } from "./tabs";

/** How long nothing may change before a job is checked with new settings, ms. */
const QUIET = 150;

export interface Job { name: string; bytes: Uint8Array; text: string; lines: string[] }
const NO_JOB: Job = { name: "", bytes: new Uint8Array(0), text: "", lines: [] };

export class App {
  job = NO_JOB;
  checked?: firmware.Checked;
  readonly settings: SettingsPanel;
  readonly player: Player;
  readonly forecasts: ForecastPanels;
  readonly machine: MachinePanel;
  readonly material: MaterialPanel;
  readonly rest: ResumePanel;
  private running?: AbortController;
  private timer?: ReturnType<typeof setTimeout>;

  constructor(readonly description: Description) {
    $("version").textContent = `Oxmill ${description.version}`;
    for (const board of description.boards) $("board").append(el("option", { textContent: board.name }));
    for (const name of Object.keys(firmware.examples)) $("example").append(el("option", { textContent: name }));
    this.settings = new SettingsPanel(description, () => this.soon());
    this.player = new Player(this);
    this.forecasts = new ForecastPanels(this);
    this.machine = new MachinePanel(this);
    this.material = new MaterialPanel(this);
    this.rest = new ResumePanel(this);
    tabs();
    theme();
    this.listen();
  }

  /** What a check is made with. */
  order(more: Order = {}): Order {
    const board = $<HTMLSelectElement>("board").value;
    return { name: this.job.name, board, work_zero: this.settings.workZero(), ...more, settings: { ...this.settings.values(), ...more.settings } };
  }

  open(name: string, bytes: Uint8Array): void {
    const text = new TextDecoder().decode(bytes);
    this.job = { name, bytes, text, lines: text.split(/\r\n|\r|\n/) };
    if (this.job.lines.at(-1) === "") this.job.lines.pop();
    $("name").textContent = name;
    this.clear("Checking");
    void this.check();
  }

  /** A file that cannot be read is no job, and leaves none of before. */
  private unread(name: string, why: string): void {
    this.running?.abort(new Error("another file was chosen"));
    clearTimeout(this.timer);
    this.job = { ...NO_JOB, name };
    this.checked = undefined;
    $("name").textContent = name;
    $<HTMLProgressElement>("progress").hidden = true;
    this.forecasts.clear();
    this.material.clear();
    this.rest.clear();
    this.clear(el("span", { className: "bad", textContent: `Not read: ${why}` }));
  }

  /** Checks the job, once nothing has changed for a while. */
  soon(): void {
    clearTimeout(this.timer);
    this.timer = setTimeout(() => void this.check(), QUIET);
  }

  async check(): Promise<void> {
    this.running?.abort(new Error("a newer check has begun"));
    const running = (this.running = new AbortController());
    this.checked = undefined;
    this.forecasts.clear();
    this.material.clear();
    this.rest.clear();
    const progress = $<HTMLProgressElement>("progress");
    progress.hidden = false;
    progress.value = 0;
    try {
      const checked = await firmware.check(this.order({ path: true }), this.job.bytes, running.signal, part => (progress.value = part));
      $("refused").textContent = "";
      this.show(checked.summary, checked.path as Path);
      this.checked = checked;
    } catch (error) {
      if (running.signal.aborted) return;
      const why = (error as Error).message;
      if (why.startsWith("$")) $("refused").textContent = why;
      this.clear(el("span", { className: "bad", textContent: `Not checked: ${why}` }));
    }
    progress.hidden = true;
  }

  /** Shows nothing of another job, or of other settings. */
  private clear(verdict: string | HTMLElement): void {
    $("verdict").replaceChildren(verdict);
    clearReport();
    this.player.clear();
  }

  private show(summary: Summary, path: Path): void {
    showReport(summary, this.job.lines, line => this.player.goToLine(line));
    this.player.show(path, summary);
    this.material.show(path, summary);
  }

  private listen(): void {
    const example = $<HTMLSelectElement>("example");
    const file = $<HTMLInputElement>("file");
    const openFile = async (chosen?: File) => {
      if (!chosen) return;
      example.selectedIndex = -1;
      try {
        this.open(chosen.name, new Uint8Array(await chosen.arrayBuffer()));
      } catch (error) {
        this.unread(chosen.name, (error as Error).message);
      }
    };
    const openExample = () => this.open(example.value, new TextEncoder().encode(firmware.examples[example.value]));
    example.addEventListener("change", openExample);
    $("board").addEventListener("change", () => void this.check());
    file.addEventListener("change", async () => {
      await openFile(file.files?.[0]);
      // The same file again, edited, is a change, too.
      file.value = "";
    });
    addEventListener("dragover", event => {
      event.preventDefault();
      $("drop").classList.add("over");
    });
    addEventListener("dragleave", () => $("drop").classList.remove("over"));
    addEventListener("drop", event => {
      event.preventDefault();
      $("drop").classList.remove("over");
      void openFile(event.dataTransfer?.files[0]);
    });
    openExample();
  }
}

/** Light or dark: as the system has it, until a person chooses. */
function theme(): void {
  const dark = matchMedia("(prefers-color-scheme: dark)");
  const set = (to: boolean) => {
    document.documentElement.dataset.theme = to ? "dark" : "light";
    dispatchEvent(new Event("resize"));
  };
  set(dark.matches);
  dark.addEventListener("change", () => set(dark.matches));
  $("theme").addEventListener("click", () => set(document.documentElement.dataset.theme !== "dark"));
}

/** For programs: the object that `oxmill run --json` prints. */
async function check(text: string, options: Order = {}): Promise<Summary> {
  return (await firmware.check(options, new TextEncoder().encode(text))).summary;
}

async function main(): Promise<void> {
  try {
    await firmware.load();
    const app = new App(await firmware.describe());
    Object.assign(globalThis, { oxmill: { check, app, placeAt } });
  } catch (error) {
    $("verdict").textContent = `The firmware could not be loaded: ${(error as Error).message}`;
  }
}
void main();
