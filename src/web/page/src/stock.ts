// The material panel: cutters, a block, and what the job leaves of it.
import { cuttersOf } from "./cutters";
import { $, el, onclick } from "./dom";
import { type Path, type Summary, workZero } from "./engine";
import * as firmware from "./firmware";
import { type Block, blockOf, type Cutter, cutterOf, type Material, type Shape } from "./material";
import type { JobPanel, Page } from "./page";
import { endOf } from "./track";

/** Delay before the block is computed for a time that the user has selected, ms. Selecting another time starts the
 * delay again. */
const QUIET = 120;
/** Maximum number of rapids through material in the list. */
const SHOWN = 200;
const NEW: Cutter = { shape: "flat", diameter: 3, angle: 60 };

export class MaterialPanel implements JobPanel {
  material?: Material;
  private cutters: Record<number, Cutter> = {};
  /** Cutters that the user has chosen for the job `name`. */
  private chosen: Record<number, Cutter> = {};
  private name = "";
  private path?: Path;
  /** Work zero in machine coordinates, mm. */
  private zero = [0, 0, 0];
  /** Whether the job turns the axis A. If so, the block is not checked: its model has only X, Y and Z. */
  private turns = false;
  private running?: AbortController;
  /** Aborts the computation of the block at an earlier time than the end of the job. */
  private following?: AbortController;
  private timer?: ReturnType<typeof setTimeout>;
  /** `true` after the user has typed a size of the block. A change of the cutter then does not change the block. */
  private typed = false;

  constructor(private readonly page: Page) {
    for (const [end, name] of [["low", "from"], ["high", "to"]]) {
      $("box").append(el("tr", {}, el("th", { scope: "row", textContent: name }), ...[0, 1, 2].map(axis =>
        el("td", {}, el("input", { type: "number", step: "any", id: `block-${end}-${axis}`, "aria-label": `Block ${name} ${"XYZ"[axis]}, mm` })))));
    }
    $("box").addEventListener("change", () => (this.typed = true));
    $("cutter-tool").addEventListener("change", () => this.showCutter());
    for (const id of ["shape", "diameter", "angle"]) $(id).addEventListener("change", () => this.readCutter());
    onclick("own-block", () => this.ownBlock());
    onclick("cut", () => void this.cut());
    onclick("no-block", () => this.clear());
    $("with-path").addEventListener("change", () => this.showBlock());
    $("show-block").addEventListener("change", () => this.showBlock());
  }

  /** Prepares the panel for a job that has been checked. */
  show(path: Path, summary: Summary): void {
    this.path = path;
    this.zero = workZero(summary);
    // The fourth motor turns A, unless it is the second motor of another axis.
    this.turns = (summary.pulses[3] ?? 0) > 0 && this.page.settings.value(930) >= 4;
    const { name, lines } = this.page.job;
    if (name !== this.name) this.chosen = {};
    this.name = name;
    const tools = [...new Set(path.tools.subarray(1))];
    const written = cuttersOf(lines);
    const known = Object.values(written);
    // A job without tool changes has one cutter. If the comments describe exactly one cutter, take that one.
    if (tools.every(tool => tool === 0) && known.length === 1) [written[0]] = known;
    this.cutters = {};
    for (const tool of tools) this.cutters[tool] = this.chosen[tool] ?? written[tool] ?? { ...NEW };
    $("cutter-from").textContent = tools.some(tool => written[tool] && !this.chosen[tool]) ? "from the comments of the job" : "";
    $("cutter-row").hidden = tools.length < 2;
    $("cutter-tool").replaceChildren(...tools.map(tool => el("option", { value: String(tool), textContent: `T${tool}` })));
    this.typed = false;
    this.showCutter();
    this.ownBlock();
  }

  /** Removes the results of the previous job. */
  clear(): void {
    this.running?.abort(new Error("the job has changed"));
    this.following?.abort(new Error("the job has changed"));
    clearTimeout(this.timer);
    this.material = undefined;
    this.page.player?.showBlock();
    $("crashes").replaceChildren();
    this.note("", "");
    $("block-label").hidden = true;
    $<HTMLButtonElement>("no-block").disabled = true;
    $("no-block").title = "There is no block yet.";
  }

  /** Shows the block at a time of the job, s, after a delay of `QUIET`. */
  at(seconds: number): void {
    const { material, path } = this;
    this.following?.abort(new Error("another time is shown"));
    clearTimeout(this.timer);
    if (!material || !path || !$<HTMLInputElement>("show-block").checked) return;
    if (seconds >= endOf(path)) return this.showBlock();
    this.timer = setTimeout(async () => {
      const { signal } = (this.following = new AbortController());
      try {
        const part = await firmware.cutBlock(path, this.cutters, material.block, seconds, signal, () => {});
        // Always show the crashes of the whole job, not only those up to this time.
        if (this.material === material) this.page.player.showBlock({ ...part, crashes: material.crashes }, $<HTMLInputElement>("with-path").checked);
      } catch (error) {
        if (!signal.aborted) throw error;
      }
    }, QUIET);
  }

  private note(text: string, tone: string): void {
    $("material-note").textContent = text;
    $("material-note").className = `finding ${tone}`;
  }

  private showBlock(): void {
    this.page.player.showBlock($<HTMLInputElement>("show-block").checked ? this.material : undefined, $<HTMLInputElement>("with-path").checked);
  }

  private get tool(): number {
    return Number($<HTMLSelectElement>("cutter-tool").value || 0);
  }

  private showCutter(): void {
    const { shape, diameter, angle } = cutterOf(this.cutters, this.tool);
    $<HTMLSelectElement>("shape").value = shape;
    $<HTMLInputElement>("diameter").value = String(diameter);
    $<HTMLInputElement>("angle").value = String(angle);
    $("angle-part").hidden = shape !== "v";
  }

  private readCutter(): void {
    const number = (id: string, least: number, most: number, old: number) => {
      const value = Number($<HTMLInputElement>(id).value);
      return value >= least && value <= most ? value : old;
    };
    const old = cutterOf(this.cutters, this.tool);
    this.cutters[this.tool] = this.chosen[this.tool] = {
      shape: $<HTMLSelectElement>("shape").value as Shape,
      diameter: number("diameter", 0.01, 1000, old.diameter),
      angle: number("angle", 1, 179, old.angle),
    };
    this.showCutter();
    if (!this.typed) this.ownBlock();
  }

  private ownBlock(): void {
    if (!this.path) return;
    const block = blockOf(this.path, this.cutters, this.zero[2]);
    for (const end of ["low", "high"] as const) {
      for (const axis of [0, 1, 2]) $<HTMLInputElement>(`block-${end}-${axis}`).value = String(Number((block[end][axis] - this.zero[axis]).toFixed(3)));
    }
    this.typed = false;
  }

  private async cut(): Promise<void> {
    const ends = (["low", "high"] as const).map(end => [0, 1, 2].map(axis => Number($<HTMLInputElement>(`block-${end}-${axis}`).value) + this.zero[axis]));
    const block: Block = { low: ends[0], high: ends[1] };
    if (!this.path) return;
    this.clear();
    if (block.low.some((low, axis) => !(low < block.high[axis]))) {
      return this.note("The block has no size: each value in the first row has to be below the one in the second.", "bad");
    }
    const running = (this.running = new AbortController());
    const progress = $<HTMLProgressElement>("cutting");
    progress.hidden = false;
    try {
      const material = await firmware.cutBlock(this.path, this.cutters, block, Infinity, running.signal, part => (progress.value = part));
      this.material = material;
      this.list(material);
      $<HTMLButtonElement>("no-block").disabled = false;
      $("no-block").title = "";
      $("block-label").hidden = false;
      $<HTMLInputElement>("show-block").checked = true;
      this.showBlock();
    } catch (error) {
      if (!running.signal.aborted) this.note((error as Error).message, "bad");
    }
    // A newer run may have replaced this one. The progress bar then belongs to the newer run.
    if (this.running === running) progress.hidden = true;
  }

  private list({ crashes, removed, cell }: Material): void {
    const number = crashes.length;
    const figures = `${(removed / 1000).toFixed(2)} cm³ cut away; a height for each ${cell.toFixed(2)} mm.`;
    if (this.turns) this.note("Not checked: this job turns the A axis. The block model knows X, Y and Z only. The path and the time are right.", "warn");
    else if (number) this.note(`${number} rapid${number === 1 ? "" : "s"} through material. ${figures}`, "bad");
    else this.note(`No rapid goes through material. ${figures}`, "good");
    if (this.turns) return;
    $("crashes").replaceChildren(...crashes.slice(0, SHOWN).map(({ line, depth, seconds }) => {
      const button = el("button", { type: "button" }, `line ${line}: rapid ${depth.toFixed(2)} mm deep in material`,
        el("code", { textContent: this.page.job.lines[line - 1] ?? "" }));
      button.addEventListener("click", () => {
        this.page.player.goToLine(line);
        this.page.player.seek(seconds);
      });
      return el("li", {}, button);
    }));
    if (number > SHOWN) $("crashes").append(el("li", { textContent: `and ${number - SHOWN} more` }));
  }
}
