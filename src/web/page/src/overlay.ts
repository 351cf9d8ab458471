// Draws over the picture: axes with their letters, numbers along the grid, and marks for tool, machine and rejected
// lines.
import { css } from "./dom";
import type { Picture } from "./picture";
import { units } from "./units";

/** Maximum count of numbers along one side of the grid. */
const NUMBERS = 14;
/** Minimum distance between two numbers, px. */
const APART = 26;

/** The marks, in mm of machine coordinates. */
export interface Marks {
  /** Position of the job at the displayed time. */
  tool?: number[];
  /** Position of the machine. */
  machine?: number[];
  /** Whether the machine works normally and its position is certain. */
  machineIsFine?: boolean;
  refused: number[][];
}

type Place = [number, number];

export class Overlay {
  constructor(private readonly canvas: HTMLCanvasElement) {}

  draw(picture: Picture, marks: Marks, withGrid: boolean): void {
    const { canvas } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [canvas.clientWidth, canvas.clientHeight];
    [canvas.width, canvas.height] = [Math.max(1, Math.round(width * ratio)), Math.max(1, Math.round(height * ratio))];
    const pen = canvas.getContext("2d");
    if (!pen || !width) return;
    pen.scale(ratio, ratio);
    if (withGrid) numbers(pen, picture, [width, height]);
    axes(pen, picture);
    for (const at of marks.refused) {
      const place = picture.place(at);
      if (place) cross(pen, place);
    }
    const tool = marks.tool && picture.place(marks.tool);
    if (tool) ring(pen, tool);
    const machine = marks.machine && picture.place(marks.machine);
    if (machine) cutter(pen, machine, css(marks.machineIsFine ? "--good" : "--warn"), picture.camera.height > 1.4);
  }
}

function numbers(pen: CanvasRenderingContext2D, picture: Picture, [width, height]: Place): void {
  const { from, to, step } = picture.lattice;
  const zero = picture.workZero;
  pen.fillStyle = css("--ink-3");
  pen.font = `11px ${css("--sans")}`;
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  // Omit numbers that the edge would cut off.
  const write = (text: string, [x, y]: Place) => {
    const half = pen.measureText(text).width / 2;
    if (x >= half && x <= width - half && y >= 6 && y <= height - 6) pen.fillText(text, x, y);
  };
  for (const axis of [0, 1]) {
    const across = 1 - axis;
    const aside = from[across] - step * 0.45;
    const at = (value: number) => {
      const place = [0, 0, 0];
      [place[axis], place[across]] = [value, aside];
      return picture.place(place.map((v, index) => v + zero[index]));
    };
    const steps = Math.round((to[axis] - from[axis]) / step);
    const [one, other] = [at(from[axis]), at(to[axis])];
    if (!one || !other) continue;
    const length = Math.hypot(one[0] - other[0], one[1] - other[1]);
    const every = [1, 2, 5, 10, 20, 50].find(count => steps / count <= NUMBERS && (length / steps) * count >= APART);
    if (every === undefined) continue;
    for (let index = Math.ceil(from[axis] / step / every) * every; index <= Math.floor(to[axis] / step + 1e-6); index += every) {
      const place = at(index * step);
      if (place) write(String(Number(((index * step) / units.size).toFixed(4))).replace("-", "−"), place);
    }
  }
  const corner = picture.place([to[0] + step * 1.1 + zero[0], from[1] - step * 0.45 + zero[1], zero[2]]);
  if (corner && picture.camera.height > 0.2) write(units.name === "mm" ? "mm" : "in", corner);
}

function axes(pen: CanvasRenderingContext2D, picture: Picture): void {
  const zero = picture.workZero;
  const origin = picture.place(zero);
  if (!origin) return;
  for (const [axis, letter] of ["X", "Y", "Z"].entries()) {
    const tip = zero.map((v, index) => v + (index === axis ? picture.lattice.step * 1.5 : 0));
    const end = picture.place(tip);
    if (!end || Math.hypot(end[0] - origin[0], end[1] - origin[1]) < 8) continue;
    const turn = Math.atan2(end[1] - origin[1], end[0] - origin[0]);
    pen.strokeStyle = pen.fillStyle = css(`--axis-${axis}`);
    pen.lineWidth = 2.5;
    pen.beginPath();
    pen.moveTo(...origin);
    pen.lineTo(...end);
    pen.stroke();
    pen.beginPath();
    for (const [far, off] of [[7, 0], [5, 2.2], [5, -2.2]]) pen.lineTo(end[0] + far * Math.cos(turn + off), end[1] + far * Math.sin(turn + off));
    pen.fill();
    pen.font = `700 13px ${css("--sans")}`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.fillText(letter, end[0] + 16 * Math.cos(turn), end[1] + 16 * Math.sin(turn));
  }
  disc(pen, origin, 5, css("--surface"));
  pen.lineWidth = 2;
  pen.strokeStyle = pen.fillStyle = css("--ink");
  pen.stroke();
  for (const from of [0, Math.PI]) {
    pen.beginPath();
    pen.moveTo(...origin);
    pen.arc(...origin, 5, from, from + Math.PI / 2);
    pen.fill();
  }
}

function disc(pen: CanvasRenderingContext2D, at: Place, radius: number, color: string): void {
  pen.beginPath();
  pen.arc(...at, radius, 0, 2 * Math.PI);
  pen.fillStyle = color;
  pen.fill();
}

function ring(pen: CanvasRenderingContext2D, at: Place): void {
  disc(pen, at, 6, css("--surface"));
  pen.lineWidth = 3;
  pen.strokeStyle = css("--ink");
  pen.stroke();
}

function cross(pen: CanvasRenderingContext2D, [x, y]: Place): void {
  for (const [width, color] of [[7, "--sheet"], [3.5, "--bad"]] as const) {
    pen.lineWidth = width;
    pen.strokeStyle = css(color);
    pen.beginPath();
    for (const way of [1, -1]) {
      pen.moveTo(x - 6, y - 6 * way);
      pen.lineTo(x + 6, y + 6 * way);
    }
    pen.stroke();
  }
}

function cutter(pen: CanvasRenderingContext2D, at: Place, color: string, fromAbove: boolean): void {
  pen.lineWidth = 1.5;
  pen.strokeStyle = css("--sheet");
  if (fromAbove) {
    disc(pen, at, 8, color);
    pen.stroke();
    return disc(pen, at, 2, css("--sheet"));
  }
  pen.fillStyle = color;
  pen.beginPath();
  for (const [x, y] of [[0, 0], [-6, -15], [-6, -38], [6, -38], [6, -15]]) pen.lineTo(at[0] + x, at[1] + y);
  pen.closePath();
  pen.fill();
  pen.stroke();
}
