// The panel of the material: cutters, a block, and what is left of it.
import type { App } from "./app";
import { $, el } from "./dom";
import type { Path, Summary } from "./engine";
import * as firmware from "./firmware";
import { type Block, blockOf, type Cutter, cutterOf, type Material, type Shape } from "./material";

/** Rapids through material that are listed. */
const SHOWN = 200;
const NEW: Cutter = { shape: "flat", diameter: 3, angle: 60 };

export class MaterialPanel {
  material?: Material;
  private cutters: Record<number, Cutter> = { 0: { ...NEW } };
  private path?: Path;
  private zero = 0;
  private running?: AbortController;
  /** The block was typed in: it stays when the cutter changes. */
  private typed = false;

  constructor(private readonly app: App) {
    for (const [axis, name] of ["X", "Y", "Z"].entries()) {
      const input = (end: string) => el("input", { type: "number", step: "any", id: `block-${end}-${axis}`, "aria-label": `${end} ${name} of the block` });
      $("box").append(el("b", { textContent: name }), input("low"), input("high"));
    }
    $("box").addEventListener("change", () => (this.typed = true));
    $("cutter-tool").addEventListener("change", () => this.showCutter());
    for (const id of ["shape", "diameter", "angle"]) $(id).addEventListener("change", () => this.readCutter());
    $("own-block").addEventListener("click", () => this.ownBlock());
    $("cut").addEventListener("click", () => void this.cut());
    $("no-block").addEventListener("click", () => this.clear());
    $("with-path").addEventListener("change", () => this.app.player.showBlock(this.material, $<HTMLInputElement>("with-path").checked));
  }

  /** A job has been checked. */
  show(path: Path, summary: Summary): void {
    this.path = path;
    this.zero = summary.position_mm[2] - summary.work_position_mm[2];
    const tools = [...new Set(path.tools.subarray(1))];
    for (const tool of tools) this.cutters[tool] ??= { ...NEW };
    $("cutter-row").hidden = tools.length < 2;
    $("cutter-tool").replaceChildren(...tools.map(tool => el("option", { value: String(tool), textContent: `T${tool}` })));
    this.typed = false;
    this.showCutter();
    this.ownBlock();
  }

  /** What was cut is not of this job. */
  clear(): void {
    this.running?.abort(new Error("the job has changed"));
    this.material = undefined;
    this.app.player?.showBlock();
    $("crashes").replaceChildren();
    $("material-note").textContent = "";
    $<HTMLButtonElement>("no-block").disabled = true;
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
    this.cutters[this.tool] = {
      shape: $<HTMLSelectElement>("shape").value as Shape,
      diameter: number("diameter", 0.01, 1000, old.diameter),
      angle: number("angle", 1, 179, old.angle),
    };
    this.showCutter();
    if (!this.typed) this.ownBlock();
  }

  private ownBlock(): void {
    if (!this.path) return;
    const block = blockOf(this.path, this.cutters, this.zero);
    for (const end of ["low", "high"] as const) {
      for (const axis of [0, 1, 2]) $<HTMLInputElement>(`block-${end}-${axis}`).value = String(Number(block[end][axis].toFixed(3)));
    }
    this.typed = false;
  }

  private async cut(): Promise<void> {
    const ends = (["low", "high"] as const).map(end => [0, 1, 2].map(axis => Number($<HTMLInputElement>(`block-${end}-${axis}`).value)));
    const block: Block = { low: ends[0], high: ends[1] };
    if (!this.path) return;
    this.clear();
    if (block.low.some((low, axis) => !(low < block.high[axis]))) {
      $("material-note").textContent = "The block has no size: each left value has to be below the right one.";
      return;
    }
    const running = (this.running = new AbortController());
    const progress = $<HTMLProgressElement>("cutting");
    progress.hidden = false;
    try {
      const material = await firmware.cutBlock(this.path, this.cutters, block, running.signal, part => (progress.value = part));
      this.material = material;
      this.list(material);
      $<HTMLButtonElement>("no-block").disabled = false;
      this.app.player.showBlock(material, $<HTMLInputElement>("with-path").checked);
    } catch (error) {
      if (!running.signal.aborted) $("material-note").textContent = (error as Error).message;
    }
    // A run that another has taken the place of leaves the bar to that.
    if (this.running === running) progress.hidden = true;
  }

  private list({ crashes, removed, cell }: Material): void {
    const number = crashes.length;
    const verdict = number ? `${number} rapid${number === 1 ? "" : "s"} through material.` : "No rapid goes through material.";
    $("material-note").textContent = `${verdict} ${(removed / 1000).toFixed(2)} cm³ cut away; a height for each ${cell.toFixed(2)} mm. The end of the job is shown, whatever the time.`;
    $("crashes").replaceChildren(...crashes.slice(0, SHOWN).map(({ line, depth, seconds }) => {
      const button = el("button", { type: "button" }, `line ${line}: rapid ${depth.toFixed(2)} mm deep in material`,
        el("code", { textContent: this.app.job.lines[line - 1] ?? "" }));
      button.addEventListener("click", () => {
        this.app.player.goToLine(line);
        this.app.player.seek(seconds);
      });
      return el("li", {}, button);
    }));
    if (number > SHOWN) $("crashes").append(el("li", { textContent: `and ${number - SHOWN} more` }));
  }
}
