// Shows one time of the job in the picture, the chart and the list of lines. While the machine runs the job, the
// machine sets this time. Otherwise the user sets it.
import { Chart } from "./chart";
import { $, icon, minutes, say } from "./dom";
import { type Path, ROW, type Summary, workZero } from "./engine";
import { type Key, showLegend } from "./legend";
import type { Machine } from "./machine";
import type { Material } from "./material";
import { Overlay } from "./overlay";
import type { Page, Timeline } from "./page";
import { Picture } from "./picture";
import { Program } from "./program";
import { SHADE } from "./shaders";
import { beginOfLine, type Coloring, endOf, isArc, isPlunge, isRapid, type Legend, lineOf, placeAt, rowAt, shades } from "./track";
import { units } from "./units";

const NO_PATH: Path = { rows: new Float32Array(0), lines: new Uint32Array(0), tools: new Uint32Array(0), speeds: new Uint32Array(0) };
/** Maximum number of rejected lines that are marked in the picture. */
const MARKED = 50;

export class Player implements Timeline {
  readonly picture?: Picture;
  readonly program: Program;
  time = 0;
  line = 0;
  /** Called when another time is shown, for the state of the block at that time. */
  ontime: (seconds: number) => void = () => {};
  /** The second view, from above; `undefined` until it is shown the first time. */
  private second?: Picture;
  private machinePlace?: number[];
  /** Position and state of the machine when its mark in the picture was last drawn. */
  private seen = "";
  /** Line, last sent line and follow mode, as they were when the list was last marked. */
  private marked = "";
  private live = false;
  private material?: Material;
  private path?: Path;
  private summary?: Summary;
  private legend: Legend = { caption: "", ticks: [] };
  private refused: number[][] = [];
  /** Kinds of moves in the path. */
  private has = { rapid: false, arc: false, plunge: false, line: false };
  private playing = false;
  private readonly chart = new Chart();
  private readonly overlay = new Overlay($<HTMLCanvasElement>("marks"));

  constructor(private readonly page: Page, private readonly machine: Machine) {
    this.program = new Program(page);
    this.program.onpick = line => this.goToLine(line);
    this.chart.onseek = seconds => this.seek(seconds);
    try {
      this.picture = new Picture($<HTMLCanvasElement>("view"));
      this.picture.onpaint = () => this.mark();
      this.picture.onpick = row => this.seek(this.path ? this.path.rows[row * ROW + 5] : 0);
    } catch (error) {
      $("nopicture").hidden = false;
      say("nopicture", `No picture: ${(error as Error).message}. Check and forecast work without it.`);
      $("tools").hidden = $("legend").hidden = $("marks").hidden = true;
    }
    this.listen();
    machine.onchange(() => this.followMachine());
  }

  show(path: Path, summary: Summary): void {
    this.path = path;
    this.summary = summary;
    const kinds = { rapid: false, arc: false, plunge: false, line: false };
    for (let row = 1; row < path.lines.length; row++) kinds[isRapid(path, row) ? "rapid" : isPlunge(path, row) ? "plunge" : isArc(path, row) ? "arc" : "line"] = true;
    this.has = kinds;
    const times = summary.errors.slice(0, MARKED).map(({ line }) => beginOfLine(path, line));
    this.refused = path.lines.length > 1 ? times.map(time => placeAt(path, time)) : [];
    this.chart.refused = times;
    this.program.refused = new Set(summary.errors.map(error => error.line));
    this.program.warned = new Set(summary.warnings.map(warning => warning.line));
    if (this.picture) {
      this.picture.unit = units.size;
      this.picture.show(path, this.color(), workZero(summary));
    }
    this.showSecond();
    this.limits();
    this.program.show();
    this.chart.show(path);
    this.seek(endOf(path));
  }

  /** Shows the path of a job as far as its check has progressed. */
  sketch(path: Path): void {
    if (this.path || !this.picture || path.lines.length < 2) return;
    this.picture.unit = units.size;
    this.picture.now = Infinity;
    this.picture.show(path, shades(path, "speed").shades);
  }

  /** Removes the path, because the job has not been checked. */
  clear(): void {
    if (this.playing) this.play();
    this.summary = this.path = undefined;
    [this.time, this.line, this.refused] = [0, 0, []];
    this.chart.refused = [];
    [this.program.refused, this.program.warned] = [new Set(), new Set()];
    say("clock", $("clock-end").textContent = "");
    for (const picture of [this.picture, this.second]) picture?.show(NO_PATH, new Float32Array(0));
    this.program.top();
    this.program.show();
    this.program.mark(0);
    this.mark();
    this.chart.show();
    this.chart.at(0, false);
  }

  seek(seconds: number): void {
    if (!this.path || this.live) return;
    this.showTime(seconds);
    this.program.mark(this.line);
  }

  goToLine(line: number): void {
    if (!this.path || this.live) return this.program.mark(line);
    this.seek(beginOfLine(this.path, line));
    this.line = line;
    this.program.mark(line);
  }

  /** Shows a time of the job, s, in picture, chart and clock. */
  private showTime(seconds: number): void {
    if (!this.path) return;
    const end = endOf(this.path);
    this.time = Math.max(0, Math.min(end, seconds));
    this.line = this.path.lines.length ? lineOf(this.path, rowAt(this.path, this.time)) : 0;
    say("clock", minutes(this.time));
    say("clock-end", `of ${minutes(end)}`);
    this.chart.at(this.time, this.live);
    this.ontime(this.time);
    for (const picture of [this.picture, this.second]) {
      if (!picture) continue;
      picture.showTime(this.time >= end ? Infinity : this.time);
    }
  }

  /** Marks the machine's position in the picture after each change of the machine. While the machine runs the open
   * job, also shows the time and the line that it has reached. */
  private followMachine(): void {
    const { machine, path } = this;
    const { running, status, sender } = machine;
    const place = status?.machine;
    const own = this.summary ? workZero(this.summary) : [0, 0, 0];
    // The machine's work zero may differ from that of the job. So add the machine's work coordinates to the job's work
    // zero.
    this.machinePlace = place && status ? [0, 1, 2].map(axis => status.work[axis] + own[axis]) : undefined;
    const live = running !== undefined && path !== undefined && running.job === this.page.job;
    if (live !== this.live) {
      this.live = live;
      if (live && this.playing) this.play();
      $("follow-label").hidden = !live;
      ($("play") as HTMLButtonElement).disabled = live;
      $("play").title = live ? "Off: the time follows the machine." : "Play (P)";
      $("rate").hidden = live;
      this.marked = "";
      if (live) this.showTime(running?.follower.time ?? 0);
      if (!live && path) {
        // Show a completed job at its end: the last report may be older.
        this.showTime(machine.finished ? endOf(path) : this.time);
        this.program.mark(this.line);
      }
      this.program.locked = live ? "Off while the job runs." : undefined;
      this.program.draw();
    }
    if (live && running) {
      if (running.follower.time !== this.time) this.showTime(running.follower.time);
      const marked = `${this.line} ${sender?.sent} ${this.followsMachine}`;
      if (marked !== this.marked) this.program.mark(this.line, sender?.sent ?? 0, this.followsMachine);
      this.marked = marked;
    }
    say("dock-note", live ? "Follows the machine." : "Click a line to see its place.");
    // Draw the marks again only if the machine has moved or its state has changed.
    const seen = `${this.machinePlace} ${machine.phase} ${machine.isUnsure}`;
    if (seen !== this.seen) this.mark();
    this.seen = seen;
  }

  private get followsMachine(): boolean {
    return $<HTMLInputElement>("follow").checked;
  }

  private color(): Float32Array {
    const coloring = $<HTMLSelectElement>("coloring").value as Coloring;
    const zero = this.summary ? workZero(this.summary)[2] : 0;
    const made = shades(this.path as Path, coloring, zero, units.name === "inch");
    this.legend = made.legend;
    for (const crash of this.material?.crashes ?? []) for (const row of crash.rows) made.shades[row] = SHADE.crash;
    return made.shades;
  }

  /** Returns the legend entries for what is drawn. */
  private keys(): Key[] {
    const { picture, material, has } = this;
    if (!picture || !this.path) return [];
    const keys: Key[] = [];
    const path = !material || picture.withPath;
    if ($<HTMLSelectElement>("coloring").value === "kind" && path) {
      if (has.line) keys.push({ text: "line", kind: "", color: "--scale-1" });
      if (has.arc) keys.push({ text: "arc", kind: "", color: "--scale-4" });
      if (has.plunge) keys.push({ text: "plunge", kind: "", color: "--plunge" });
    }
    if (has.rapid && picture.rapids && path) keys.push({ text: "rapid", kind: "dashed", color: "--rapid" });
    if (material?.crashes.length) keys.push({ text: "rapid through material", kind: "", color: "--bad" });
    if (this.toolIsShown) keys.push({ text: "time", kind: "dot", color: "--ink" });
    if (this.machinePlace) keys.push({ text: this.live ? "machine now" : "machine", kind: "cutter", color: this.machineIsFine ? "--good" : "--warn" });
    keys.push({ text: "work zero", kind: "zero", color: "--ink" });
    if (this.refused.length) keys.push({ text: "refused line", kind: "cross", color: "--bad" });
    if ($<HTMLInputElement>("limits").checked) keys.push({ text: "travel", kind: "", color: "--accent" });
    if (material) keys.push({ text: "block", kind: "solid", color: "--block" }, { text: "cut", kind: "solid", color: "--block-cut" });
    return keys;
  }

  /** `true` if the tool is marked in the picture. At the end of a job it is not: the whole path is visible there. */
  private get toolIsShown(): boolean {
    return this.path !== undefined && !this.live && this.path.lines.length > 1 && this.time < endOf(this.path);
  }

  private get machineIsFine(): boolean {
    return ["idle", "run", "jog", "home"].includes(this.machine.phase) && !this.machine.isUnsure;
  }

  /** Shows what is left of a block, with the rapids through it in red. Without a block, shows only the path. */
  showBlock(material?: Material, withPath = false): void {
    if (!material && !this.material) return;
    const sameJob = material && this.material && material.crashes === this.material.crashes;
    this.material = material;
    for (const picture of [this.picture, this.second]) {
      if (!picture || !this.path) continue;
      picture.withPath = withPath;
      if (!sameJob) picture.shade(this.color());
      picture.block(material);
    }
  }

  /** Shows or hides the view from above. */
  private showSecond(): void {
    const shown = $<HTMLInputElement>("two").checked && this.picture !== undefined;
    $("second").hidden = !shown;
    $("picture").classList.toggle("two", shown);
    if (!shown || !this.path || !this.summary) return;
    if (!this.second) {
      this.second = new Picture($<HTMLCanvasElement>("second"));
      this.second.onpick = row => this.seek(this.path ? this.path.rows[row * ROW + 5] : 0);
    }
    this.second.unit = units.size;
    this.second.show(this.path, this.color(), workZero(this.summary));
    this.second.withPath = this.picture?.withPath ?? false;
    this.second.rapids = this.picture?.rapids ?? true;
    this.second.block(this.material);
    this.second.look(0, Math.PI / 2);
  }

  private limits(): void {
    if (!this.path || !this.summary) return;
    const { min: low, max: high } = this.summary.travel_mm;
    const box = $<HTMLInputElement>("limits").checked ? { low, high } : undefined;
    for (const picture of [this.picture, this.second]) picture?.limits(box);
  }

  private mark(): void {
    if (!this.picture) return;
    const tool = this.toolIsShown && this.path ? placeAt(this.path, this.time) : undefined;
    this.overlay.draw(this.picture, { tool, machine: this.machinePlace, machineIsFine: this.machineIsFine, refused: this.refused }, !this.material);
    showLegend(this.legend, this.keys());
    $("legend").hidden = this.path === undefined;
  }

  private play(): void {
    if (!this.path || (this.live && !this.playing)) return;
    this.playing = !this.playing;
    const button = $("play");
    button.replaceChildren(icon(this.playing ? "hold" : "play"));
    button.setAttribute("aria-label", this.playing ? "Pause" : "Play");
    if (this.playing && this.time >= endOf(this.path)) this.seek(0);
    let last: number | undefined;
    const step = (now: number) => {
      if (!this.playing || !this.path) return;
      const passed = last === undefined ? 0 : (now - last) / 1000;
      last = now;
      this.seek(this.time + passed * Number($<HTMLSelectElement>("rate").value));
      if (this.time >= endOf(this.path)) this.play();
      else requestAnimationFrame(step);
    };
    if (this.playing) requestAnimationFrame(step);
  }

  /** Redraws everything after a change of colours. */
  recolor(): void {
    this.chart.redraw();
    if (!this.path) return this.picture?.draw();
    const made = this.color();
    for (const picture of [this.picture, this.second]) picture?.shade(made);
    this.mark();
  }

  /** Starts or stops playing (key P). Does nothing while the machine runs the job. */
  togglePlay(): void {
    if (!this.live) this.play();
  }

  step(lines: number): void {
    if (this.path) this.goToLine(Math.max(1, Math.min(this.page.job.lines.length, this.line + lines)));
  }

  look(view: number): void {
    document.querySelectorAll<HTMLElement>("[data-look]")[view]?.click();
  }

  fit(): void {
    this.picture?.fit();
  }

  private listen(): void {
    const { picture } = this;
    $("play").addEventListener("click", () => this.play());
    $("coloring").addEventListener("change", () => this.recolor());
    $("two").addEventListener("change", () => {
      this.showSecond();
      this.limits();
      this.seek(this.time);
      // Showing or hiding the second view has changed the width of the first.
      picture?.fit();
    });
    $("show-rapids").addEventListener("change", () => {
      for (const one of [picture, this.second]) {
        if (!one) continue;
        one.rapids = $<HTMLInputElement>("show-rapids").checked;
        one.draw();
      }
    });
    $("limits").addEventListener("change", () => this.limits());
    $("fit").addEventListener("click", () => picture?.fit());
    units.onchange(() => {
      for (const one of [picture, this.second]) one?.measureIn(units.size);
      if (this.path) this.recolor();
    });
    for (const button of document.querySelectorAll<HTMLElement>("[data-look]")) {
      const [turn, height] = (button.dataset.look ?? "").split(",").map(Number);
      button.addEventListener("click", () => {
        picture?.look(turn, height);
        picture?.fit();
      });
    }
  }
}

/** Returns the outline of a path from above, scaled to a small picture. */
export function outline(path: Path, width: number, height: number): SVGSVGElement {
  const points: [number, number][] = [];
  const [low, high] = [[Infinity, Infinity], [-Infinity, -Infinity]];
  for (let row = 0; row < path.lines.length; row++) {
    const at: [number, number] = [path.rows[row * ROW], path.rows[row * ROW + 1]];
    points.push(at);
    for (const axis of [0, 1]) [low[axis], high[axis]] = [Math.min(low[axis], at[axis]), Math.max(high[axis], at[axis])];
  }
  const scale = Math.min((width - 4) / (high[0] - low[0] || 1), (height - 4) / (high[1] - low[1] || 1));
  const offset = [0, 1].map(axis => ([width, height][axis] - (high[axis] - low[axis]) * scale) / 2);
  let d = "";
  for (let row = 1; row < points.length; row++) {
    const [x, y] = [offset[0] + (points[row][0] - low[0]) * scale, height - offset[1] - (points[row][1] - low[1]) * scale];
    d += `${isRapid(path, row) || d === "" ? "M" : "L"}${x.toFixed(1)} ${y.toFixed(1)}`;
  }
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("viewBox", `0 0 ${width} ${height}`);
  made.setAttribute("aria-hidden", "true");
  const line = document.createElementNS("http://www.w3.org/2000/svg", "path");
  line.setAttribute("d", d || "M0 0");
  made.append(line);
  return made;
}

