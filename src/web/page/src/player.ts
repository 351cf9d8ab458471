// The picture with its time: scrubber, play, speed chart and the lines of the job.
import type { App } from "./app";
import { $, clock, css, el } from "./dom";
import { type Path, ROW, type Summary, workZero } from "./engine";
import type { Material } from "./material";
import { Picture } from "./picture";
import { SHADE } from "./shaders";
import { beginOfLine, type Coloring, endOf, isRapid, lineOf, placeAt, rowAt, shades } from "./track";

/** Height of a line in the list, px, and the greatest height that browsers draw. */
const LINE = 18;
const TALLEST = 15_000_000;

const NO_PATH: Path = { rows: new Float32Array(0), lines: new Uint32Array(0), tools: new Uint32Array(0) };

export class Player {
  readonly picture?: Picture;
  /** The time that is shown, s, and the line that the tool is at. */
  time = 0;
  line = 0;
  /** The same path from above, once it was asked for. */
  private second?: Picture;
  private machine?: number[];
  private material?: Material;
  private path?: Path;
  private summary?: Summary;
  private playing = false;
  private readonly scrub = $<HTMLInputElement>("scrub");
  private readonly list = $("lines");
  private readonly chart = $<HTMLCanvasElement>("chart");

  constructor(private readonly app: App) {
    try {
      this.picture = new Picture($<HTMLCanvasElement>("view"));
      this.picture.onpaint = () => this.mark();
      this.picture.onpick = row => this.seek(this.path ? this.path.rows[row * ROW + 5] : 0);
    } catch (error) {
      $("nopicture").hidden = false;
      $("nopicture").textContent = `No picture: ${(error as Error).message}. Check and forecast work without it.`;
      $("tools").hidden = true;
      $("legend").hidden = true;
    }
    this.listen();
  }

  show(path: Path, summary: Summary): void {
    this.path = path;
    this.summary = summary;
    this.picture?.show(path, this.color(), workZero(summary));
    this.showSecond();
    this.limits();
    this.scrub.max = String(endOf(path));
    ($("lines-all") as HTMLElement).style.height = `${Math.min(TALLEST, this.app.job.lines.length * LINE)}px`;
    this.seek(endOf(path));
    this.drawChart();
  }

  /** No path: its job was not checked. */
  clear(): void {
    if (this.playing) this.play();
    this.summary = this.path = undefined;
    [this.time, this.line] = [0, 0];
    this.scrub.max = "0";
    $("clock").textContent = "";
    for (const picture of [this.picture, this.second]) picture?.show(NO_PATH, new Float32Array(0));
    this.list.scrollTop = 0;
    this.mark();
    this.drawLines();
    this.drawChart();
    this.drawCursor();
  }

  /** Shows a time of the job. */
  seek(seconds: number): void {
    if (!this.path) return;
    const end = endOf(this.path);
    this.time = Math.max(0, Math.min(end, seconds));
    this.scrub.value = String(this.time);
    this.line = this.path.lines.length ? lineOf(this.path, rowAt(this.path, this.time)) : 0;
    $("clock").textContent = `${clock(this.time)} of ${clock(end)}`;
    for (const picture of [this.picture, this.second]) {
      if (!picture) continue;
      picture.now = this.time >= end ? Infinity : this.time;
      picture.draw();
    }
    this.scrollTo(this.line || 1);
    this.drawLines();
    this.drawCursor();
  }

  /** Shows the time at which a line begins. */
  goToLine(line: number): void {
    if (!this.path) return;
    this.seek(beginOfLine(this.path, line));
    this.line = line;
    this.scrollTo(line);
    this.drawLines();
  }

  /** Colours of the rows, and the legend for them. */
  private color(): Float32Array {
    const coloring = $<HTMLSelectElement>("coloring").value as Coloring;
    const made = shades(this.path as Path, coloring);
    $("scale-low").textContent = made.legend.low;
    $("scale-high").textContent = made.legend.high;
    $("plunges").hidden = coloring !== "kind";
    $("scale").classList.toggle("kinds", coloring === "kind");
    for (const crash of this.material?.crashes ?? []) for (const row of crash.rows) made.shades[row] = SHADE.crash;
    return made.shades;
  }

  /** Shows what is left of a block, with rapids through it in red; or the path alone again. */
  showBlock(material?: Material, withPath = false): void {
    if (!material && !this.material) return;
    this.material = material;
    $("crash-key").hidden = !material?.crashes.length;
    for (const picture of [this.picture, this.second]) {
      if (!picture || !this.path) continue;
      picture.withPath = withPath;
      picture.shade(this.color());
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
    this.second.show(this.path, this.color(), workZero(this.summary));
    this.second.withPath = this.picture?.withPath ?? false;
    this.second.block(this.material);
    this.second.look(0, Math.PI / 2);
  }

  private limits(): void {
    if (!this.path) return;
    const travel = [130, 131, 132].map(number => this.app.settings.value(number));
    const shown = $<HTMLInputElement>("limits").checked;
    // Homing names the travel so, whichever ends have the switches.
    const box = shown ? { low: travel.map(v => -v) as [number, number, number], high: [0, 0, 0] as [number, number, number] } : undefined;
    for (const picture of [this.picture, this.second]) picture?.limits(box);
  }

  /** Shows where the machine is that is driven, mm; without a place there is none. */
  showMachine(place?: number[]): void {
    this.machine = place;
    this.mark();
  }

  /** Puts the marks where the tool of the job and the machine are. */
  private mark(): void {
    const tool = this.path?.lines.length ? this.picture?.place(placeAt(this.path, this.time)) : undefined;
    const machine = this.machine && this.picture?.place(this.machine);
    for (const [id, at] of [["tool", tool], ["machine-at", machine]] as const) {
      $(id).hidden = !at;
      if (at) [$(id).style.left, $(id).style.top] = [`${at[0]}px`, `${at[1]}px`];
    }
  }

  private play(): void {
    if (!this.path) return;
    this.playing = !this.playing;
    const button = $("play");
    button.innerHTML = this.playing ? "&#9208;" : "&#9654;";
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

  private scrollTo(line: number): void {
    const scale = this.scale();
    const at = (line - 1) * LINE * scale;
    const { scrollTop, clientHeight } = this.list;
    if (at < scrollTop || at + LINE > scrollTop + clientHeight) this.list.scrollTop = at - clientHeight / 2 + LINE / 2;
  }

  /** What a pixel of a line is in the list, where all lines would be taller than a browser draws. */
  private scale(): number {
    return Math.min(1, TALLEST / Math.max(1, this.app.job.lines.length * LINE));
  }

  /** The lines that are in sight. */
  private drawLines(): void {
    const { lines } = this.app.job;
    const first = Math.max(0, Math.floor(this.list.scrollTop / LINE / this.scale()) - 1);
    const digits = String(lines.length).length;
    const refused = new Set(this.summary?.errors.map(error => error.line));
    const all = $("lines-all");
    const drawn = new Map([...all.children].map(line => [line.id, line as HTMLElement]));
    const shown = lines.slice(first, first + Math.ceil(this.list.clientHeight / LINE) + 3).map((text, index) => {
      const number = first + index + 1;
      const id = `line-${number}`;
      const line = drawn.get(id) ?? el("div", { role: "option", id });
      line.className = refused.has(number) ? "line refused" : "line";
      line.setAttribute("aria-selected", String(number === this.line));
      line.textContent = `${String(number).padStart(digits)}  ${text}`;
      line.style.top = `${first * LINE * this.scale() + index * LINE}px`;
      line.dataset.line = String(number);
      return line;
    });
    // What stays in sight stays in the document: an element that is taken out of it between press and release is not clicked.
    for (const line of drawn.values()) if (!shown.includes(line)) line.remove();
    for (const [index, line] of shown.entries()) if (all.children[index] !== line) all.insertBefore(line, all.children[index] ?? null);
    if (shown.some(line => line.id === `line-${this.line}`)) this.list.setAttribute("aria-activedescendant", `line-${this.line}`);
    else this.list.removeAttribute("aria-activedescendant");
  }

  private drawChart(): void {
    const { chart, path } = this;
    const ratio = devicePixelRatio || 1;
    [chart.width, chart.height] = [Math.max(1, chart.clientWidth * ratio), Math.max(1, chart.clientHeight * ratio)];
    const pen = chart.getContext("2d");
    if (!pen || !path) return;
    const end = endOf(path) || 1;
    const feeds = new Float32Array(chart.width);
    const rapids = new Float32Array(chart.width);
    let most = 0;
    for (let row = 1; row < path.lines.length; row++) {
      const [speed, began, ended] = [3, 4, 5].map(part => path.rows[row * ROW + part]);
      const rapid = isRapid(path, row);
      if (!rapid) most = Math.max(most, speed);
      const into = rapid ? rapids : feeds;
      const last = Math.min(chart.width - 1, Math.floor((ended / end) * chart.width));
      for (let x = Math.max(0, Math.floor((began / end) * chart.width)); x <= last; x++) into[x] = Math.max(into[x], speed);
    }
    most = most || Math.max(...rapids) || 1;
    const height = chart.height - 14 * ratio;
    for (const [values, color] of [[rapids, "--rapid"], [feeds, "--scale-1"]] as const) {
      pen.fillStyle = css(color);
      for (let x = 0; x < chart.width; x++) {
        const tall = Math.min(1, values[x] / most) * height;
        if (tall > 0) pen.fillRect(x, chart.height - tall, 1, tall);
      }
    }
    pen.fillStyle = css("--soft");
    pen.font = `${11 * ratio}px system-ui, sans-serif`;
    pen.fillText(`path speed, up to ${(most * 60).toFixed(0)} mm/min at feed; rapids in grey`, 2 * ratio, 10 * ratio);
  }

  /** The time on the chart: its background, so that the curve need not be drawn again. */
  private drawCursor(): void {
    const part = this.path ? (this.time / (endOf(this.path) || 1)) * 100 : 0;
    this.chart.style.background = `linear-gradient(90deg, transparent calc(${part}% - 1px), var(--bad) calc(${part}% - 1px) calc(${part}% + 1px), transparent calc(${part}% + 1px))`;
  }

  private listen(): void {
    const { picture } = this;
    this.scrub.addEventListener("input", () => this.seek(Number(this.scrub.value)));
    $("play").addEventListener("click", () => this.play());
    $("coloring").addEventListener("change", () => {
      if (!this.path) return;
      picture?.shade(this.color());
      this.second?.shade(this.color());
    });
    $("two").addEventListener("change", () => {
      this.showSecond();
      this.limits();
      this.seek(this.time);
      // The first view has another width from now on.
      picture?.fit();
    });
    $("limits").addEventListener("change", () => this.limits());
    $("fit").addEventListener("click", () => picture?.fit());
    for (const button of document.querySelectorAll<HTMLElement>("[data-look]")) {
      const [turn, height] = (button.dataset.look ?? "").split(",").map(Number);
      button.addEventListener("click", () => picture?.look(turn, height));
    }
    this.list.addEventListener("scroll", () => this.drawLines());
    this.list.addEventListener("click", event => {
      const line = (event.target as HTMLElement).dataset.line;
      if (line) this.goToLine(Number(line));
    });
    this.list.addEventListener("keydown", event => {
      const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 5, PageUp: -5, Home: -Infinity, End: Infinity }[event.key];
      if (!step) return;
      event.preventDefault();
      this.goToLine(Math.max(1, Math.min(this.app.job.lines.length, this.line + step)));
    });
    this.chart.addEventListener("click", event => {
      if (this.path) this.seek((event.offsetX / this.chart.clientWidth) * endOf(this.path));
    });
    addEventListener("resize", () => {
      this.drawChart();
      picture?.draw();
    });
  }
}
