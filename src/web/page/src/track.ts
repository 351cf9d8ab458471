// Evaluates the rows of a path. No row is interpreted as G-code: positions, times and lines come from the firmware.
import { ARC, type Path, RAPID, ROW } from "./engine";
import { SHADE } from "./shaders";

export type Coloring = "speed" | "acceleration" | "power" | "kind" | "depth" | "tool" | "line";
/** The meaning of the scale, and the labels of its marks from left to right. Without labels there is no scale. */
export interface Legend { caption: string; ticks: string[] }
/** Number of marks on a scale. */
const TICKS = 5;

export const isRapid = (path: Path, row: number): boolean => path.lines[row] >= RAPID;
export const lineOf = (path: Path, row: number): number => path.lines[row] % ARC;
export const isArc = (path: Path, row: number): boolean => path.lines[row] % RAPID >= ARC;
export const endOf = (path: Path): number => (path.lines.length ? path.rows[(path.lines.length - 1) * ROW + 5] : 0);

/** Returns the first row that has not ended at a time. */
export function rowAt(path: Path, seconds: number): number {
  let [low, high] = [0, Math.max(0, path.lines.length - 1)];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (path.rows[middle * ROW + 5] < seconds) low = middle + 1;
    else high = middle;
  }
  return low;
}

/** Returns the time at which the moves of a line start, s. For a line without moves, returns the start of the next
 * move. If no move follows, returns the end of the job. */
export function beginOfLine(path: Path, line: number): number {
  const row = rowOfLine(path, line);
  return row === undefined ? endOf(path) : path.rows[row * ROW + 4];
}

/** Returns the position of the tool at a time. */
export function placeAt(path: Path, seconds: number): number[] {
  const row = rowAt(path, seconds);
  const before = Math.max(0, row - 1);
  const [began, ended] = [path.rows[row * ROW + 4], path.rows[row * ROW + 5]];
  const part = ended > began ? Math.max(0, Math.min(1, (seconds - began) / (ended - began))) : 1;
  return [0, 1, 2].map(axis => {
    const from = path.rows[before * ROW + axis];
    return from + (path.rows[row * ROW + axis] - from) * part;
  });
}

/** Returns the first row of a line. If the line has no rows, takes the next line that has some; `undefined` if no line
 * has. */
function rowOfLine(path: Path, line: number): number | undefined {
  let [best, found]: [number, number | undefined] = [Infinity, undefined];
  for (let row = 1; row < path.lines.length; row++) {
    const of = lineOf(path, row);
    if (of >= line && of < best) {
      [best, found] = [of, row];
      if (of === line) break;
    }
  }
  return found;
}

const length = (path: Path, row: number) =>
  Math.hypot(...[0, 1, 2].map(axis => path.rows[row * ROW + axis] - path.rows[(row - 1) * ROW + axis]));

/** Returns `true` for a plunge: a feed move down, with at least 98 % of its length in Z. */
export function isPlunge(path: Path, row: number): boolean {
  if (row === 0 || isRapid(path, row)) return false;
  const down = path.rows[(row - 1) * ROW + 2] - path.rows[row * ROW + 2];
  return down > 1e-4 && down > 0.98 * length(path, row);
}

/** Returns the change of speed from the previous row to this one, as an acceleration without sign, mm/s². */
function acceleration(path: Path, row: number): number {
  if (row < 2) return 0;
  const middle = (of: number) => (path.rows[of * ROW + 4] + path.rows[of * ROW + 5]) / 2;
  const time = middle(row) - middle(row - 1);
  return time > 0 ? Math.abs(path.rows[row * ROW + 3] - path.rows[(row - 1) * ROW + 3]) / time : 0;
}

/** Returns the upper end of a scale: 99.5 % of the positive values are not above it. A few much larger values must not
 * set the scale. */
function top(values: number[], part = 0.995): number {
  const sorted = values.filter(value => value > 0).sort((a, b) => a - b);
  return sorted[Math.min(sorted.length - 1, Math.floor(sorted.length * part))] || 1;
}

/** Returns the shade of each row (0 to 1 on the scale, or one of `SHADE`), and the legend. `zero`: height of work
 * zero, mm; `inch`: `true` for a legend in inches. */
export function shades(path: Path, coloring: Coloring, zero = 0, inch = false): { shades: Float32Array; legend: Legend } {
  const count = path.lines.length;
  const made = new Float32Array(count);
  const feeds = Array.from({ length: count }, (_, row) => row).filter(row => row > 0 && !isRapid(path, row));
  // The tools in the order of use.
  const tools = [...new Set(feeds.map(row => path.tools[row]))];
  const value = {
    speed: (row: number) => path.rows[row * ROW + 3],
    acceleration: (row: number) => acceleration(path, row),
    power: (row: number) => path.speeds[row],
    depth: (row: number) => Math.max(0, zero - path.rows[row * ROW + 2]),
    line: (row: number) => lineOf(path, row),
    tool: (row: number) => tools.indexOf(path.tools[row]),
    kind: () => 0,
  }[coloring];
  const greatest = () => feeds.reduce((most, row) => Math.max(most, value(row)), 0) || 1;
  const most = coloring === "kind" ? 1 : coloring === "tool" ? Math.max(1, tools.length - 1) : coloring === "acceleration" || coloring === "line" ? top(feeds.map(value)) : greatest();
  for (let row = 0; row < count; row++) {
    if (isRapid(path, row)) made[row] = SHADE.rapid;
    else if (coloring === "kind" && isPlunge(path, row)) made[row] = SHADE.plunge;
    else if (coloring === "kind" && isArc(path, row)) made[row] = SHADE.arc;
    else made[row] = coloring === "kind" ? SHADE.line : Math.min(1, value(row) / most);
  }
  const size = inch ? 25.4 : 1;
  const unit = inch ? "in" : "mm";
  const scale = (all: number) => Array.from({ length: TICKS }, (_, tick) => Number(((all * tick) / (TICKS - 1)).toPrecision(3)).toLocaleString("en"));
  const legend: Legend = {
    speed: { caption: `Speed of the cutter, ${unit}/min`, ticks: scale((most * 60) / size) },
    acceleration: { caption: `Change of speed, ${unit}/s²`, ticks: scale(most / size) },
    power: { caption: "Spindle or laser power, S", ticks: scale(most) },
    depth: { caption: `Depth below work zero, ${unit}`, ticks: scale(most / size) },
    line: { caption: "Order in the job", ticks: ["line 1", `line ${most}`] },
    tool: { caption: "Tool", ticks: tools.length > 1 ? [`T${tools[0]}`, `T${tools.at(-1)}`] : tools.map(tool => `T${tool}`) },
    kind: { caption: "Kind of move", ticks: [] },
  }[coloring];
  return { shades: made, legend };
}
