// Chart of the speed over the time of a job, also used as the scrubber.
import { $, clock, css, minutes, rgb } from "./dom";
import { type Path, ROW } from "./engine";
import { endOf, isRapid } from "./track";

const RAMP = [0, 1, 2, 3, 4, 5].map(index => `--scale-${index}`);
/** Number of colours between the slowest and the fastest feed. */
const SHADES = 24;
/** Space for the times below the curve, CSS pixels. */
const FOOT = 16;
/** Possible distances between time marks, s. */
const MARKS = [1, 2, 5, 10, 30, 60, 120, 300, 600, 1800, 3600, 7200, 18_000, 36_000];

export class Chart {
  /** Called with the time that the user selects, s. */
  onseek: (seconds: number) => void = () => {};
  /** Times of rejected lines in s, drawn as strokes across the chart. */
  refused: number[] = [];
  private readonly canvas = $<HTMLCanvasElement>("chart");
  private readonly curve = document.createElement("canvas");
  private path?: Path;
  private time = 0;
  private live = false;

  constructor() {
    const { canvas } = this;
    const seek = (event: PointerEvent) => {
      const frame = canvas.getBoundingClientRect();
      this.onseek(((event.clientX - frame.left) / frame.width) * this.end);
    };
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      seek(event);
    });
    canvas.addEventListener("pointermove", event => event.buttons && canvas.hasPointerCapture(event.pointerId) && seek(event));
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      this.onseek(this.time + event.deltaY * 0.01);
    }, { passive: false });
    canvas.addEventListener("keydown", event => {
      const by = event.shiftKey ? 10 : 1;
      const to = { ArrowLeft: this.time - by, ArrowRight: this.time + by, Home: 0, End: this.end, PageUp: this.time + 10, PageDown: this.time - 10 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      event.stopPropagation();
      this.onseek(to);
    });
    new ResizeObserver(() => this.redraw()).observe(canvas);
  }

  private get end(): number {
    return this.path ? endOf(this.path) : 0;
  }

  show(path?: Path): void {
    this.path = path;
    this.canvas.setAttribute("aria-valuemax", String(this.end));
    this.redraw();
  }

  /** Moves the marker to a time, in s. `live`: `true` if the time is the progress of a machine; the marker is then
   * green. */
  at(time: number, live: boolean): void {
    [this.time, this.live] = [time, live];
    this.canvas.setAttribute("aria-valuenow", String(time));
    this.canvas.setAttribute("aria-valuetext", `${clock(time)} of ${clock(this.end)}`);
    this.paint();
  }

  /** Redraws the curve after a change of job, size or colours. */
  redraw(): void {
    const { canvas, curve, path } = this;
    const ratio = devicePixelRatio || 1;
    [curve.width, curve.height] = [Math.max(1, Math.round(canvas.clientWidth * ratio)), Math.max(1, Math.round((canvas.clientHeight - FOOT) * ratio))];
    const pen = curve.getContext("2d");
    if (pen && path && path.lines.length > 1) drawCurve(pen, path, this.end || 1);
    this.paint();
  }

  private paint(): void {
    const { canvas, curve } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
    const pen = canvas.getContext("2d");
    if (!pen || !this.path || !width || this.end === 0) return;
    const x = (this.time / this.end) * width;
    // Draw the part of the job that lies ahead fainter.
    pen.globalAlpha = 0.3;
    pen.drawImage(curve, 0, 0);
    pen.globalAlpha = 1;
    if (x * ratio >= 1) {
      pen.clearRect(0, 0, x * ratio, curve.height);
      pen.drawImage(curve, 0, 0, x * ratio, curve.height, 0, 0, x * ratio, curve.height);
    }
    pen.scale(ratio, ratio);
    const bottom = height - FOOT;
    pen.font = `11px ${css("--sans")}`;
    pen.fillStyle = css("--ink-3");
    pen.textAlign = "center";
    const step = MARKS.find(step => (step / this.end) * width > 64) ?? this.end;
    for (let time = step; time < this.end - step / 4; time += step) {
      pen.fillRect((time / this.end) * width, bottom, 1, 4);
      pen.fillText(minutes(time), (time / this.end) * width, height - 2);
    }
    pen.fillStyle = css("--bad");
    for (const time of this.refused) pen.fillRect((time / this.end) * width - 1, 0, 2, bottom);
    pen.fillStyle = css("--ink");
    pen.fillRect(Math.min(width - 2, Math.max(0, x - 1)), 0, 2, bottom);
    pen.beginPath();
    pen.arc(Math.min(width - 7, Math.max(7, x)), bottom, 5, 0, 2 * Math.PI);
    pen.fillStyle = css("--surface");
    pen.fill();
    pen.lineWidth = 3;
    pen.strokeStyle = css(this.live ? "--good" : "--ink");
    pen.stroke();
  }
}

function drawCurve(pen: CanvasRenderingContext2D, path: Path, end: number): void {
  const { width, height } = pen.canvas;
  const [feeds, rapids] = [new Float32Array(width), new Float32Array(width)];
  let most = 0;
  for (let row = 1; row < path.lines.length; row++) {
    const [speed, began, ended] = [path.rows[row * ROW + 3], path.rows[row * ROW + 4], path.rows[row * ROW + 5]];
    const rapid = isRapid(path, row);
    if (!rapid) most = Math.max(most, speed);
    const into = rapid ? rapids : feeds;
    const last = Math.min(width - 1, Math.floor((ended / end) * width));
    for (let x = Math.max(0, Math.floor((began / end) * width)); x <= last; x++) into[x] = Math.max(into[x], speed);
  }
  most = most || Math.max(...rapids) || 1;
  const colors = Array.from({ length: SHADES }, (_, index) => mixed(index / (SHADES - 1)));
  const rapidColor = css("--rapid");
  for (let x = 0; x < width; x++) {
    for (const [value, color] of [[rapids[x], rapidColor], [feeds[x], colors[Math.min(SHADES - 1, Math.floor((feeds[x] / most) * SHADES))]]] as const) {
      const tall = Math.min(1, value / most) * (height - 2);
      if (tall <= 0) continue;
      pen.fillStyle = color;
      pen.fillRect(x, height - tall, 1, tall);
    }
  }
}

/** Returns the colour for a speed. `part`: the speed as a fraction of the fastest feed, 0 to 1. */
function mixed(part: number): string {
  const at = Math.min(4, Math.floor(part * 5));
  const [from, to] = [rgb(RAMP[at]), rgb(RAMP[at + 1])];
  return `rgb(${from.map((value, index) => Math.round((value + (to[index] - value) * (part * 5 - at)) * 255)).join()})`;
}
