// The page: a job, the settings that it is checked with, and the panels that show the results of the firmware.
import { Cable } from "./cable";
import { listenToConnections } from "./connect";
import { listenToConsole } from "./console";
import { ContinuePanel } from "./continue";
import { closeDialogs, listenToDialogs } from "./dialogs";
import { $, allow, count, onclick } from "./dom";
import { type Description, hindrance, type Order, type Path, type Summary } from "./engine";
import * as firmware from "./firmware";
import { keepOffline, onlaunch } from "./installed";
import { FirstVisit } from "./first";
import { JogPanel } from "./jog";
import { linesOf, read, type Refusal, tooLarge } from "./jobfile";
import { listenToKeys } from "./keys";
import { LoadFirmware } from "./loadfirmware";
import { Machine } from "./machine";
import { Macros } from "./macros";
import { OverridesPanel } from "./overrides";
import { type JobPanel, NO_JOB, type Page, type Workspace } from "./page";
import { Player } from "./player";
import { PositionPanel } from "./position";
import { ProbePanel } from "./probe";
import { RunCard } from "./runcard";
import { Settings } from "./settings";
import { SettingsPanel } from "./settingspanel";
import { SetupPanel } from "./setup";
import { SpindlePanel } from "./spindle";
import { StatusBar } from "./statusbar";
import { MaterialPanel } from "./stock";
import { ToolTable } from "./tooltable";
import { placeAt } from "./track";
import { units } from "./units";
import { clearVerdict, showPlain, showVerdict } from "./verdict";
import { WhatIf } from "./whatif";
import { Workspaces } from "./workspaces";

/** How long settings must stay unchanged before a job is checked with them, ms. */
const QUIET = 150;

export class App implements Page {
  job = NO_JOB;
  checked?: firmware.Checked;
  readonly settings: Settings;
  readonly machine: Machine;
  readonly player: Player;
  readonly material: MaterialPanel;
  readonly continue: ContinuePanel;
  private readonly workspaces: Workspaces;
  private readonly panels: JobPanel[];
  private readonly runCard: RunCard;
  private readonly first: FirstVisit;
  private running?: AbortController;
  private timer?: ReturnType<typeof setTimeout>;
  /** Number of the line that the user edited last; it is selected again after the check. 0 if none. */
  private keptLine = 0;

  constructor(readonly description: Description) {
    $("version").textContent = `Oxmill ${description.version}`;
    $("loading").hidden = true;
    listenToDialogs();
    this.settings = new Settings(description);
    this.machine = new Machine(description.alarms);
    this.machine.meanings = answer => {
      const found = description.errors.find(({ code }) => answer === `error:${code}`);
      return found && `${found.text}. ${found.advice}`;
    };
    this.workspaces = new Workspaces(() => {
      closeDialogs();
      if (this.workspaces?.now === "first") this.first?.show();
      else this.first?.hide();
    });
    listenToConsole(this.machine);
    const settingsPanel = new SettingsPanel(description, this.settings, this.machine, this);
    this.player = new Player(this, this.machine);
    this.material = new MaterialPanel(this);
    this.continue = new ContinuePanel(this);
    this.player.ontime = seconds => this.material.at(seconds);
    this.panels = [new WhatIf(this), new Cable(this), this.material, this.continue];
    listenToConnections(this.machine, this);
    new StatusBar(this.machine, this);
    const setup = new SetupPanel(this.machine, this);
    const position = new PositionPanel(this.machine, () => setup.safeHeight());
    const jog = new JogPanel(this.machine);
    new OverridesPanel(this.machine);
    new SpindlePanel(this.machine);
    new ProbePanel(this.machine);
    new Macros(this.machine, this);
    new ToolTable(this.machine);
    new LoadFirmware(this.machine);
    this.runCard = new RunCard(this.machine, this, { from: line => this.continue.from(this.machine.stopped?.job ?? this.job, line) });
    this.first = new FirstVisit(this, this.settings, () => $("open-import").click());
    this.settings.onchange(() => this.soon());
    let runs = false;
    this.machine.onchange(() => {
      // When a job starts, show its card, which may be hidden on a telephone.
      if (this.machine.running && !runs) this.workspaces.part("job");
      runs = this.machine.running !== undefined;
    });
    listenToKeys({ machine: this.machine, page: this, player: this.player, jog, position, setup, workspace: () => this.workspaces.now });
    void settingsPanel;
    this.theme();
    this.listen();
    this.clearJob();
    // If the user has chosen a machine before, skip the start page.
    if (this.settings.isKept) this.go("check");
    else this.first.show();
  }

  go(workspace: Workspace): void {
    this.workspaces.go(workspace);
  }

  order(more: Order = {}): Order {
    const board = $<HTMLSelectElement>("board").value;
    return { name: this.job.name, board, work_zero: this.settings.workZero(), ...more, settings: { ...this.settings.values(), ...more.settings } };
  }

  open(name: string, bytes: Uint8Array): void {
    const found = read(name, bytes);
    if ("head" in found) return this.refuse(name, found);
    this.job = { name, bytes: found.bytes, text: found.text, lines: linesOf(found.text) };
    this.keptLine = 0;
    this.showName(count(this.job.lines.length, "line"));
    $("save-job").hidden = true;
    if (this.workspaces.now === "first" || this.workspaces.now === "settings") this.go("check");
    this.clear();
    showPlain("Checking");
    void this.check();
  }

  /** Shows why a file is not a job, and removes the previous job. */
  private refuse(name: string, { head, text }: Refusal): void {
    this.running?.abort(new Error("another file was chosen"));
    clearTimeout(this.timer);
    this.job = { ...NO_JOB, name };
    this.checked = undefined;
    this.showName("not a job");
    $<HTMLProgressElement>("progress").hidden = true;
    if (this.workspaces.now === "first" || this.workspaces.now === "settings") this.go("check");
    this.clear();
    showPlain(head, text, "bad");
    $("nothing").hidden = false;
    this.allowRun();
  }

  private showName(size: string): void {
    $("name").textContent = this.job.name;
    $("job-size").textContent = `${size} · open another`;
    $("jobchip").hidden = false;
  }

  private clearJob(): void {
    this.clear();
    $("nothing").hidden = false;
    showPlain("No job is open", "Drop a G-code file anywhere on this page, or try a sample.");
    this.allowRun();
  }

  /** Replaces a line of the job, and checks the job again. */
  private edit(line: number, text: string): void {
    const lines = [...this.job.lines];
    lines[line - 1] = text;
    const whole = `${lines.join("\n")}\n`;
    this.job = { name: this.job.name, bytes: new TextEncoder().encode(whole), text: whole, lines };
    this.keptLine = line;
    $("job-size").textContent = `${count(lines.length, "line")} · edited`;
    $("save-job").hidden = false;
    void this.check();
  }

  /** Checks the job when its settings have stayed unchanged for `QUIET` ms. */
  soon(): void {
    clearTimeout(this.timer);
    if (this.job.lines.length) this.timer = setTimeout(() => void this.check(), QUIET);
  }

  async check(): Promise<void> {
    if (this.job.lines.length === 0 && this.job.bytes.length === 0) return;
    this.running?.abort(new Error("a newer check has begun"));
    const running = (this.running = new AbortController());
    this.checked = undefined;
    for (const panel of this.panels) panel.clear();
    this.allowRun();
    const progress = $<HTMLProgressElement>("progress");
    // Show the progress bar only after 200 ms, because a small job needs none.
    const slow = setTimeout(() => (progress.hidden = running.signal.aborted), 200);
    progress.value = 0;
    try {
      const checked = await firmware.check(this.order({ path: true }), this.job.bytes, running.signal, part => (progress.value = part), path => running.signal.aborted || this.sketch(path));
      $("refused").textContent = "";
      this.show(checked.summary, checked.path as Path);
      this.checked = checked;
    } catch (error) {
      if (running.signal.aborted) return clearTimeout(slow);
      const why = (error as Error).message;
      if (why.startsWith("$")) $("refused").textContent = why;
      this.clear();
      showPlain("Not checked", why, "bad");
    }
    clearTimeout(slow);
    progress.hidden = true;
    this.runCard.jobChanged();
    this.allowRun();
  }

  private sketch(path: Path): void {
    $("nothing").hidden = true;
    this.player.sketch(path);
  }

  /** Clears the results of the previous job or settings. */
  private clear(): void {
    clearVerdict();
    for (const panel of this.panels) panel.clear();
    this.player.clear();
    $("nothing").hidden = true;
    this.runCard?.jobChanged();
  }

  private show(summary: Summary, path: Path): void {
    this.showFigures(summary, path);
    $("nothing").hidden = true;
    this.player.show(path, summary);
    for (const panel of this.panels) panel.show?.(path, summary);
    if (this.keptLine) this.player.goToLine(this.keptLine);
  }

  private showFigures(summary: Summary, path: Path): void {
    showVerdict(summary, path, {
      lines: this.job.lines,
      travelIsChecked: this.settings.workZero() !== undefined && this.settings.value(20) === 1,
      goTo: line => this.player.goToLine(line),
      giveZero: () => {
        this.go("settings");
        $("work-zero").querySelector("input")?.focus();
      },
    });
  }

  /** Enables the button that leads to the machine, or disables it and shows why the job cannot run. */
  private allowRun(): void {
    const { summary } = this.checked ?? {};
    const hindered = summary && hindrance(summary);
    const why = !summary ? this.job.lines.length ? "Off until the job is checked." : "Open a job first." : hindered && `Off: ${hindered.text}.`;
    allow($("to-run"), why);
    $("to-run-why").textContent = why ?? "";
  }

  private listen(): void {
    this.player.program.onedit = (line, text) => this.edit(line, text);
    const file = $<HTMLInputElement>("file");
    const openFile = async (chosen?: File) => {
      if (!chosen) return;
      const large = tooLarge(chosen.name, chosen.size);
      if (large) return this.refuse(chosen.name, large);
      try {
        this.open(chosen.name, new Uint8Array(await chosen.arrayBuffer()));
      } catch (error) {
        this.refuse(chosen.name, { head: "This file cannot be read.", text: (error as Error).message });
      }
    };
    onclick("brand", () => this.go("first"));
    onclick("jobchip", () => file.click());
    onclick("nothing-file", () => file.click());
    onclick("to-run", () => this.go("run"));
    $("board").addEventListener("change", () => void this.check());
    units.onchange(() => this.checked?.path && this.showFigures(this.checked.summary, this.checked.path));
    file.addEventListener("change", async () => {
      await openFile(file.files?.[0]);
      // Choosing the same file again must count as a change: the file may have been edited.
      file.value = "";
    });
    const over = (shown: boolean) => document.body.classList.toggle("over-drop", shown);
    addEventListener("dragover", event => {
      event.preventDefault();
      over(true);
    });
    addEventListener("dragleave", event => event.relatedTarget === null && over(false));
    addEventListener("drop", event => {
      event.preventDefault();
      over(false);
      void openFile(event.dataTransfer?.files[0]);
    });
    onlaunch(openFile);
  }

  /** Sets up the light and the dark theme. The page takes the theme of the system, at the start and whenever the system
   * changes. The button switches the theme in between. */
  private theme(): void {
    const dark = matchMedia("(prefers-color-scheme: dark)");
    const set = (to: boolean) => {
      document.documentElement.dataset.theme = to ? "dark" : "light";
      this.player.recolor();
    };
    set(dark.matches);
    dark.addEventListener("change", () => set(dark.matches));
    onclick("theme", () => set(document.documentElement.dataset.theme !== "dark"));
  }
}

/** For scripts: checks a job and returns the object that `oxmill run --json` prints. */
async function check(text: string, options: Order = {}): Promise<Summary> {
  return (await firmware.check(options, new TextEncoder().encode(text))).summary;
}

async function main(): Promise<void> {
  try {
    await firmware.load();
    const app = new App(await firmware.describe());
    keepOffline();
    Object.assign(globalThis, { oxmill: { check, app, placeAt, examples: firmware.examples } });
  } catch (error) {
    $("loading").hidden = false;
    $("loading").textContent = `The firmware could not be loaded: ${(error as Error).message}`;
  }
}
void main();
