// Simulates cutting: what the cutters of a job leave of a block, and which rapids go through material. The result is a
// height map. Each height is exact for the middle of its cell. Draws nothing.
import { ARC, type Path, RAPID, ROW } from "./engine";

export type Shape = "flat" | "ball" | "v";
/** Diameter in mm; `angle` is the full angle of a V, in degrees. */
export interface Cutter { shape: Shape; diameter: number; angle: number }
/** A block of material before it is cut, in mm of machine coordinates. */
export interface Block { low: number[]; high: number[] }
/** A rapid that went through material. `rows`: its rows of the path; `seconds`: its start, s; `depth`: its maximum
 * depth in the material, mm. */
export interface Crash { line: number; rows: number[]; seconds: number; depth: number }
export interface Material {
  block: Block; cell: number; nx: number; ny: number; heights: Float32Array; crashes: Crash[];
  /** Removed volume, mm³. */
  removed: number;
}

/** Maximum number of cells in the map. */
const CELLS = 360_000;
/** Maximum number of cells that are examined for all moves together, which takes a second or two. */
const WORK = 80_000_000;
const SMALLEST_CELL = 0.02;
/** How far a rapid may enter material, sideways and downwards, without counting as a crash, mm. The path of a long job
 * is no more accurate than this. */
export const SLACK = 0.05;
/** Rows between two progress reports. */
const ROWS_AT_A_TIME = 2000;
/** Maximum number of cells along a side: every graphics processor supports a texture of this size. */
const LONGEST = 4000;

/** Returns the edge length of a cell that keeps the map and the work within their limits. */
export function cellFor(path: Path, cutters: Record<number, Cutter>, block: Block): number {
  const area = (block.high[0] - block.low[0]) * (block.high[1] - block.low[1]);
  let swept = 0;
  for (let row = 1; row < path.lines.length; row++) {
    const radius = cutterOf(cutters, path.tools[row]).diameter / 2;
    const at = row * ROW;
    const way = Math.hypot(path.rows[at] - path.rows[at - ROW], path.rows[at + 1] - path.rows[at - ROW + 1]);
    swept += (way + 2 * radius) * 2 * radius;
  }
  const longest = Math.max(block.high[0] - block.low[0], block.high[1] - block.low[1]);
  return Math.max(SMALLEST_CELL, Math.sqrt(area / CELLS), Math.sqrt(swept / WORK), longest / LONGEST);
}

export const cutterOf = (cutters: Record<number, Cutter>, tool: number): Cutter => cutters[tool] ?? cutters[0] ?? { shape: "flat", diameter: 3, angle: 60 };

/** Returns the block that a job seems to be cut from: the extents of its cuts below work zero, plus the cutter's
 * radius. */
export function blockOf(path: Path, cutters: Record<number, Cutter>, zero: number): Block {
  const [low, high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
  const take = (below: number) => {
    for (let row = 1; row < path.lines.length; row++) {
      if (path.lines[row] >= RAPID) continue;
      for (const at of [(row - 1) * ROW, row * ROW]) {
        if (path.rows[at + 2] >= below) continue;
        const radius = cutterOf(cutters, path.tools[row]).diameter / 2;
        for (let axis = 0; axis < 3; axis++) {
          const more = axis < 2 ? radius : 0;
          low[axis] = Math.min(low[axis], path.rows[at + axis] - more);
          high[axis] = Math.max(high[axis], path.rows[at + axis] + more);
        }
      }
    }
  };
  take(zero - 1e-4);
  const top = low[2] < Infinity;
  if (!top) take(Infinity);
  if (low[2] === Infinity) return { low: [-10, -10, zero - 5], high: [10, 10, zero] };
  const outward = (value: number, way: number) => way * Math.ceil(way * value * 10 - 1e-3) / 10;
  return {
    low: low.map((value, axis) => outward(axis < 2 ? value : value - 1, -1)),
    high: [outward(high[0], 1), outward(high[1], 1), top ? zero : high[2]],
  };
}

/** Cuts a block with the moves of a job up to the time `until`, s. A move lowers each cell to the lowest height that
 * the cutter had above the cell. The profile of the cutter is convex. Therefore a formula with the slope of the move
 * gives the point at which the cutter is lowest above a cell. */
export function cut(path: Path, cutters: Record<number, Cutter>, block: Block, cell: number, progress: (part: number) => void = () => {}, until = Infinity): Material {
  const nx = Math.max(1, Math.round((block.high[0] - block.low[0]) / cell));
  const ny = Math.max(1, Math.round((block.high[1] - block.low[1]) / cell));
  const [dx, dy] = [(block.high[0] - block.low[0]) / nx, (block.high[1] - block.low[1]) / ny];
  const heights = new Float32Array(nx * ny).fill(block.high[2]);
  const crashes: Crash[] = [];
  const { rows } = path;
  for (let row = 1; row < path.lines.length && path.rows[row * ROW + 4] < until; row++) {
    if (row % ROWS_AT_A_TIME === 0) progress(row / path.lines.length);
    const [from, to] = [(row - 1) * ROW, row * ROW];
    const rapid = path.lines[row] >= RAPID;
    const cutter = cutterOf(cutters, path.tools[row]);
    const whole = cutter.diameter / 2;
    const radius = rapid ? whole - Math.min(SLACK, whole / 10) : whole;
    let [ax, ay, az, bx, by, bz] = [rows[from], rows[from + 1], rows[from + 2], rows[to], rows[to + 1], rows[to + 2]];
    if (Math.min(az, bz) >= block.high[2]) continue;
    const length = Math.hypot(bx - ax, by - ay);
    if (length < 1e-6) {
      // In a move straight up or down, only the lower end matters: use it for both ends.
      [az, bz] = [Math.min(az, bz), Math.min(az, bz)];
    }
    const [ux, uy] = length < 1e-6 ? [1, 0] : [(bx - ax) / length, (by - ay) / length];
    const slope = length < 1e-6 ? 0 : (bz - az) / length;
    const cone = cutter.shape === "v" ? 1 / Math.tan((cutter.angle * Math.PI) / 360) : 0;
    let deepest = 0;
    const first = Math.max(0, Math.ceil((Math.min(ay, by) - radius - block.low[1]) / dy - 0.5));
    const last = Math.min(ny - 1, Math.floor((Math.max(ay, by) + radius - block.low[1]) / dy - 0.5));
    for (let j = first; j <= last; j++) {
      const y = block.low[1] + (j + 0.5) * dy;
      // `begin` and `end`: the part of the move in which the cutter reaches this row of cells, in mm from the start of
      // the move.
      let [begin, end] = [0, length];
      if (Math.abs(uy) > 1e-9) {
        const [one, other] = [(y - radius - ay) / uy, (y + radius - ay) / uy];
        begin = Math.max(begin, Math.min(one, other));
        end = Math.min(end, Math.max(one, other));
      }
      const [left, right] = [ax + ux * begin, ax + ux * end];
      const i0 = Math.max(0, Math.ceil((Math.min(left, right) - radius - block.low[0]) / dx - 0.5));
      const i1 = Math.min(nx - 1, Math.floor((Math.max(left, right) + radius - block.low[0]) / dx - 0.5));
      for (let i = i0; i <= i1; i++) {
        const [px, py] = [block.low[0] + (i + 0.5) * dx - ax, y - ay];
        const along = px * ux + py * uy;
        const aside2 = (px * uy - py * ux) ** 2;
        const reach2 = radius * radius - aside2;
        if (reach2 < 0) continue;
        const reach = Math.sqrt(reach2);
        // The part of the move on which the cutter is over the cell: from `nearest` to `farthest`.
        const nearest = Math.max(0, along - reach);
        const farthest = Math.min(length, along + reach);
        if (nearest > farthest) continue;
        let at: number;
        let above: number;
        if (cutter.shape === "flat") {
          at = slope > 0 ? nearest : farthest;
          above = 0;
        } else if (cutter.shape === "ball") {
          const round = Math.sqrt(Math.max(0, whole * whole - aside2));
          at = Math.min(farthest, Math.max(nearest, along - (slope * round) / Math.sqrt(1 + slope * slope)));
          above = whole - Math.sqrt(Math.max(0, whole * whole - aside2 - (along - at) ** 2));
        } else {
          const part = slope / cone;
          const off = Math.abs(part) >= 1 ? Math.sign(part) * Infinity : (part * Math.sqrt(aside2)) / Math.sqrt(1 - part * part);
          at = Math.min(farthest, Math.max(nearest, along - off));
          above = cone * Math.sqrt(aside2 + (along - at) ** 2);
        }
        const height = az + slope * at + above;
        const cellAt = j * nx + i;
        const was = heights[cellAt];
        if (height >= was) continue;
        if (rapid) deepest = Math.max(deepest, was - Math.max(height, block.low[2]));
        heights[cellAt] = height < block.low[2] ? block.low[2] : height;
      }
    }
    if (deepest > SLACK) {
      const line = path.lines[row] % ARC;
      const before = crashes.at(-1);
      // A rapid can have several rows of the path: merge their collisions.
      if (before && before.line === line && (before.rows.at(-1) as number) >= row - 2) {
        before.depth = Math.max(before.depth, deepest);
        before.rows.push(row);
      } else crashes.push({ line, rows: [row], seconds: rows[to + 4], depth: deepest });
    }
  }
  let left = 0;
  for (const height of heights) left += block.high[2] - height;
  return { block, cell: Math.max(dx, dy), nx, ny, heights, crashes, removed: left * dx * dy };
}
