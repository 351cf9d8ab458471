// Finds where a machine is in its job. A report gives the machine's position. The path gives the times at which the
// job is at this position.
import { type Path, ROW } from "./engine";
import { endOf, isRapid, lineOf, placeAt, rowAt } from "./track";

/** Maximum progress of the job between two reports, as a multiple of the expected progress. Overrides at most double a
 * speed. */
const FASTEST = 2.2;
/** Seconds of the job that are searched beyond the maximum progress. */
const SLACK = 1;
/** A machine that is nearer to the path than this counts as on the path, mm. */
const NEAR = 0.3;
/** Like `NEAR`, for the second search, mm. The second search covers all lines that were sent. */
const ASTRAY = 1;
/** Weight of time in the search, mm per s: a match that is 1 s off the expected time counts as 0.02 mm farther away.
 * If the path passes a position twice, or rests there, this weight selects the time. */
const SECOND = 0.02;

export interface Overrides { feed: number; rapid: number }

export class Follower {
  /** Time within the job, s. */
  time = 0;
  /** Total seconds of feed moves up to the end of each row. */
  private readonly feed: Float32Array;
  /** Total seconds of rapids up to the end of each row. */
  private readonly rapid: Float32Array;

  /** `zero`: position of work zero in the coordinates of the path, mm. */
  constructor(readonly path: Path, private readonly zero: number[]) {
    const count = path.lines.length;
    [this.feed, this.rapid] = [new Float32Array(count), new Float32Array(count)];
    for (let row = 1; row < count; row++) {
      const took = path.rows[row * ROW + 5] - path.rows[row * ROW + 4];
      const rapid = isRapid(path, row);
      this.feed[row] = this.feed[row - 1] + (rapid ? 0 : took);
      this.rapid[row] = this.rapid[row - 1] + (rapid ? took : 0);
    }
  }

  get end(): number {
    return endOf(this.path);
  }

  /** The line that the machine is executing. */
  get line(): number {
    return Math.max(1, this.path.lines.length ? lineOf(this.path, rowAt(this.path, this.time)) : 0);
  }

  /** Processes a report: work position (mm), seconds since the last report, and the last line that was sent. */
  report(work: number[], passed: number, sent: number): void {
    const { path, zero } = this;
    if (path.lines.length < 2) return;
    const at = [0, 1, 2].map(axis => work[axis] + zero[axis]);
    const expected = Math.min(this.end, this.time + passed);
    // If the machine is not found near the expected time, search everything that was sent.
    if (!this.look(at, expected, Math.min(this.end, this.time + passed * FASTEST + SLACK), sent, SECOND, NEAR)) this.look(at, expected, this.end, sent, 0, ASTRAY);
  }

  /** Searches the path from the present time to `until` for the position `at`. If the path comes within `within` mm of
   * `at`, sets `time` to the time of the best match, and returns `true`. */
  private look(at: number[], expected: number, until: number, sent: number, second: number, within: number): boolean {
    const { path } = this;
    let [best, found, off]: [number, number, number] = [Infinity, this.time, Infinity];
    const look = (seconds: number) => {
      const place = placeAt(path, seconds);
      const apart = Math.hypot(...place.map((v, axis) => v - at[axis]));
      const cost = apart + Math.abs(seconds - expected) * second;
      if (cost < best) [best, found, off] = [cost, seconds, apart];
    };
    look(this.time);
    look(expected);
    for (let row = rowAt(path, this.time); row < path.lines.length && path.rows[row * ROW + 4] <= until; row++) {
      if (lineOf(path, row) > sent) break;
      const [began, ended] = [path.rows[row * ROW + 4], path.rows[row * ROW + 5]];
      const [from, to] = [Math.max(began, this.time), Math.min(ended, until)];
      look(Math.min(until, Math.max(this.time, began)));
      if (to <= from) continue;
      // `part`: the point of this straight row that is nearest to the machine, as a fraction of the row.
      const a = [0, 1, 2].map(axis => path.rows[(row - 1) * ROW + axis]);
      const way = [0, 1, 2].map(axis => path.rows[row * ROW + axis] - a[axis]);
      const length2 = way.reduce((sum, v) => sum + v * v, 0);
      const part = length2 > 0 ? way.reduce((sum, v, axis) => sum + v * (at[axis] - a[axis]), 0) / length2 : 1;
      look(Math.min(to, Math.max(from, began + Math.max(0, Math.min(1, part)) * (ended - began))));
      look(to);
    }
    if (off < within) this.time = found;
    return off < within;
  }

  finish(): void {
    this.time = this.end;
  }

  /** Returns the remaining seconds of the job with these overrides. An override of 1 is 100 %. */
  left({ feed, rapid }: Overrides): number {
    const { path, time } = this;
    const count = path.lines.length;
    if (count < 2) return 0;
    const row = rowAt(path, time);
    const begun = Math.max(0, Math.min(time, path.rows[row * ROW + 5]) - path.rows[row * ROW + 4]);
    const [feedDone, rapidDone] = [this.feed, this.rapid].map((sums, kind) =>
      (row > 0 ? sums[row - 1] : 0) + (isRapid(path, row) === (kind === 1) ? begun : 0));
    const [feedLeft, rapidLeft] = [this.feed[count - 1] - feedDone, this.rapid[count - 1] - rapidDone];
    const standing = Math.max(0, this.end - time - feedLeft - rapidLeft);
    return feedLeft / feed + rapidLeft / rapid + standing;
  }
}
