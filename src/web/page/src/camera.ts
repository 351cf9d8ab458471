// A camera that orbits a target. Positions are in mm.

export type Vector = [number, number, number];
const HALF_ANGLE = 0.35;
const STEEPEST = 1.5707;
/** The target is shown this far above the middle of the view, because the legend is at the bottom. A fraction of half
 * the view's height. */
const LIFT = 0.12;
/** For a view lower than `height` pixels, in which the legend covers a larger part: `lift` replaces `LIFT`, and the
 * camera is `farther` times as far away. */
const LOW = { height: 420, lift: 0.3, farther: 1.2 };

export class Camera {
  /** Turn around Z from the front, radians. */
  turn = -0.6;
  /** Elevation above the table, radians. */
  height = 0.7;
  distance = 100;
  target: Vector = [0, 0, 0];
  private lift = LIFT;
  private right: Vector = [1, 0, 0];
  private up: Vector = [0, 0, 1];
  private matrix = new Float32Array(16);

  look(turn: number, height: number): void {
    this.turn = turn;
    this.height = Math.max(-STEEPEST, Math.min(STEEPEST, height));
  }

  /** Moves the camera so that the box from `low` to `high` is completely visible. `width`, `height`: size of the view
   * in pixels. */
  fit(low: Vector, high: Vector, width: number, height: number): void {
    const aspect = width / Math.max(1, height);
    const isLow = height > 0 && height < LOW.height;
    this.lift = isLow ? LOW.lift : LIFT;
    this.target = low.map((l, i) => (l + high[i]) / 2) as Vector;
    const size = Math.hypot(...high.map((h, i) => h - low[i])) || 10;
    // Leave room for the legend and the numbers along the grid.
    this.distance = (size * 0.58) / Math.tan(HALF_ANGLE) / Math.min(1, aspect * 0.85) * (isLow ? LOW.farther : 1);
  }

  /** Moves the picture by `dx` pixels to the right and by `dy` pixels down. `viewHeight`: height of the view, in
   * pixels, which gives the scale. */
  pan(dx: number, dy: number, viewHeight: number): void {
    const scale = (2 * this.distance * Math.tan(HALF_ANGLE)) / viewHeight;
    this.target = this.target.map((t, i) => t + (-this.right[i] * dx + this.up[i] * dy) * scale) as Vector;
  }

  /** Returns the matrix of view and perspective, column by column, as WebGL expects. `aspect`: width of the view
   * divided by its height. */
  view(aspect: number): Float32Array {
    const { turn, height, distance, target } = this;
    const [sin, cos] = [Math.sin(turn), Math.cos(turn)];
    const level = Math.cos(height);
    const back: Vector = [level * sin, -level * cos, Math.sin(height)];
    const eye = target.map((t, i) => t + distance * back[i]);
    const right: Vector = [cos, sin, 0];
    const up: Vector = [
      back[1] * right[2] - back[2] * right[1],
      back[2] * right[0] - back[0] * right[2],
      back[0] * right[1] - back[1] * right[0],
    ];
    [this.right, this.up] = [right, up];
    const f = 1 / Math.tan(HALF_ANGLE);
    const [near, far] = [distance / 100, distance * 30];
    const rows = [right.map(v => (v * f) / aspect), up.map(v => v * f), back];
    const m = this.matrix;
    for (let column = 0; column < 3; column++) {
      m[column * 4] = rows[0][column];
      m[column * 4 + 1] = rows[1][column];
      const z = rows[2][column];
      m[column * 4 + 2] = (z * (far + near)) / (near - far);
      m[column * 4 + 3] = -z;
    }
    const dot = (row: number[]) => -row.reduce((sum, v, i) => sum + v * eye[i], 0);
    const z = dot(rows[2]);
    m[12] = dot(rows[0]);
    m[13] = dot(rows[1]);
    m[14] = (z * (far + near)) / (near - far) + (2 * far * near) / (near - far);
    m[15] = -z;
    for (let column = 0; column < 4; column++) m[column * 4 + 1] += this.lift * m[column * 4 + 3];
    return m;
  }

  /** Returns where a position is visible, as fractions of the view from its top left; `undefined` behind the camera. */
  project([x, y, z]: number[]): [number, number] | undefined {
    const m = this.matrix;
    const w = m[3] * x + m[7] * y + m[11] * z + m[15];
    if (w <= 0) return undefined;
    return [
      0.5 + (0.5 * (m[0] * x + m[4] * y + m[8] * z + m[12])) / w,
      0.5 - (0.5 * (m[1] * x + m[5] * y + m[9] * z + m[13])) / w,
    ];
  }
}
