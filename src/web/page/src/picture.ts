// The tool path in three dimensions, drawn with WebGL 2.
import { Camera, type Vector } from "./camera";
import { rgb } from "./dom";
import { type Path, ROW } from "./engine";
import type { Material } from "./material";
import { BLOCK_FRAGMENT, BLOCK_VERTEX, FRAGMENT, VERTEX } from "./shaders";

/** Number of floats that the graphics processor gets for each row: position, start and end time, shade. */
const STRIDE = 6;
/** Paths up to this number of rows are always drawn as thick lines. Longer paths are drawn as a strip of thin lines
 * while the view moves. */
const QUICK = 20_000;
/** Maximum number of rows drawn while the view moves. */
const MOVING = 60_000;
/** Like `MOVING`, for paths whose thick lines take longer than `SLOW`. */
const MOVING_SLOWLY = 10_000;
/** Thick lines are not drawn if they would take longer than this, ms. */
const SLOW = 250;
/** Number of rows that are drawn to measure the time of one row. */
const TRIED = 4_000;
/** After this time without a move, a view counts as at rest, ms. */
const REST = 200;
/** Like `REST`, for paths whose thick lines take longer than `SLOW`, ms. */
const REST_SLOWLY = 700;
/** Directions of the arrow keys, right and up. */
const ARROWS: Record<string, readonly [number, number]> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
/** Distance that an arrow key with Shift moves the picture, CSS pixels. */
const PAN = 40;
/** Maximum number of quads of a block drawn at rest. */
const QUADS = 250_000;
/** Maximum number of quads of a block drawn while the view moves. */
const QUADS_MOVING = 40_000;

interface Lines { thick: WebGLVertexArrayObject; thin: WebGLVertexArrayObject; buffer: WebGLBuffer; count: number }
/** The path with fewer rows, for a moving view. */
interface Thinned { array: WebGLVertexArrayObject; indices: WebGLBuffer; count: number }

interface Box { low: Vector; high: Vector }

export class Picture {
  readonly camera = new Camera();
  /** Time up to which the path is drawn as done, s. */
  now = Infinity;
  /** Called after each redraw. */
  onpaint = () => {};
  /** Called when the user clicks a row. */
  onpick: (row: number) => void = () => {};
  /** Whether rapids are drawn. */
  rapids = true;
  /** Millimetres per unit of the grid. */
  unit = 1;
  /** The grid in work coordinates, mm: start and end along X and Y, and its step. */
  lattice = { from: [0, 0], to: [0, 0], step: 10 };
  /** If a block is shown: `true` draws the whole path, `false` only the rapids through material. */
  withPath = false;
  private readonly gl: WebGL2RenderingContext;
  private readonly lineProgram: WebGLProgram;
  private readonly blockProgram: WebGLProgram;
  private readonly heights: WebGLTexture;
  private readonly nothing: WebGLVertexArrayObject;
  private material?: Material;
  private readonly uniforms: Record<string, WebGLUniformLocation | null> = {};
  private readonly path: Lines;
  private readonly thinned: Thinned;
  private readonly grid: Lines;
  private readonly box: Lines;
  private rows: Float32Array = new Float32Array(0);
  private shades: Float32Array = new Float32Array(0);
  private zero: Vector = [0, 0, 0];
  private low: Vector = [0, 0, 0];
  private high: Vector = [1, 1, 1];
  /** The limits of the machine's travel; `undefined` while they are hidden. */
  private travel?: Box;
  private asked = false;
  /** Time to draw one row as a thick line, ms; `undefined` until it is measured. */
  private perRow?: number;
  private lastMove = -Infinity;
  private later?: ReturnType<typeof setTimeout>;
  /** `true` after the view was fitted to its canvas. A hidden canvas has no size, so the view cannot be fitted to
   * it. */
  private fits = false;

  constructor(private readonly canvas: HTMLCanvasElement) {
    const gl = canvas.getContext("webgl2", { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!gl) throw new Error("this browser has no WebGL 2");
    this.gl = gl;
    this.lineProgram = this.program(VERTEX, FRAGMENT);
    this.blockProgram = this.program(BLOCK_VERTEX, BLOCK_FRAGMENT);
    for (const name of ["view", "pixel", "width", "strip", "now", "plain", "ink", "rapid", "plunge", "crash", "future", "only", "rapids", "scale"]) {
      this.uniforms[name] = gl.getUniformLocation(this.lineProgram, name);
    }
    this.heights = gl.createTexture();
    this.nothing = gl.createVertexArray();
    this.path = this.lines(1);
    this.thinned = { array: this.path.thin, indices: gl.createBuffer(), count: 0 };
    this.grid = this.lines(2);
    this.box = this.lines(2);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
    this.listen();
    new ResizeObserver(() => (this.fits ? this.draw() : this.fit())).observe(canvas);
  }

  /** Shows a path, with the axes at its work zero. */
  show(path: Path, shades: Float32Array, zero: Vector = [0, 0, 0]): void {
    this.rows = path.rows;
    this.zero = zero;
    const count = path.lines.length;
    [this.low, this.high] = [[Infinity, Infinity, Infinity], [-Infinity, -Infinity, -Infinity]];
    for (let i = 0; i < count; i++) {
      for (let axis = 0; axis < 3; axis++) {
        this.low[axis] = Math.min(this.low[axis], path.rows[i * ROW + axis]);
        this.high[axis] = Math.max(this.high[axis], path.rows[i * ROW + axis]);
      }
    }
    if (count === 0) [this.low, this.high] = [[0, 0, 0], [10, 10, 10]];
    // Remove the block and the limits of the previous path.
    this.material = this.travel = undefined;
    this.load(this.box, new Float32Array(0));
    this.shade(shades);
    this.load(this.grid, this.gridLines());
    this.fit();
  }

  /** Colours the path: a number from 0 to 1 for each row, or one of SHADE. */
  shade(shades: Float32Array): void {
    this.shades = shades;
    const data = new Float32Array(shades.length * STRIDE);
    for (let i = 0; i < shades.length; i++) {
      data.set(this.rows.subarray(i * ROW, i * ROW + 3), i * STRIDE);
      data[i * STRIDE + 3] = this.rows[i * ROW + 4];
      data[i * STRIDE + 4] = this.rows[i * ROW + 5];
      data[i * STRIDE + 5] = shades[i];
    }
    this.load(this.path, data);
    this.thin();
    this.draw();
  }

  /** Selects the rows for a moving view: every n-th row, and each row at which rapids and feeds change. */
  private thin(): void {
    const { gl, shades, thinned } = this;
    const stride = Math.ceil(shades.length / (this.thickIsSlow ? MOVING_SLOWLY : MOVING));
    thinned.count = 0;
    if (stride < 2) return;
    const kept: number[] = [];
    for (let row = 0; row < shades.length; row++) {
      const turns = row + 1 === shades.length || (shades[row] < 0) !== (shades[row + 1] < 0);
      if (row % stride === 0 || turns) kept.push(row);
    }
    gl.bindVertexArray(thinned.array);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, thinned.indices);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(kept), gl.STATIC_DRAW);
    gl.bindVertexArray(null);
    thinned.count = kept.length;
  }

  /** Shows what a job leaves of its block. Without `material`, removes the block. */
  block(material?: Material): void {
    const gl = this.gl;
    const first = material && !this.material;
    this.material = material;
    if (material) {
      gl.bindTexture(gl.TEXTURE_2D, this.heights);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.R32F, material.nx, material.ny, 0, gl.RED, gl.FLOAT, material.heights);
      // Without an extension, WebGL does not interpolate float textures.
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.NEAREST);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MAG_FILTER, gl.NEAREST);
    }
    if (first) this.fit();
    this.draw();
  }

  /** Shows the limits of the machine, or removes them. */
  limits(box?: Box): void {
    if (!box && !this.travel) return;
    this.travel = box;
    const edges: number[] = [];
    if (box) {
      const corner = (bits: number): Vector => [0, 1, 2].map(axis => (bits >> axis & 1 ? box.high : box.low)[axis]) as Vector;
      for (let bits = 0; bits < 8; bits++) {
        for (let axis = 0; axis < 3; axis++) if (!(bits >> axis & 1)) edges.push(...segment(corner(bits), corner(bits | 1 << axis)));
      }
    }
    this.load(this.box, new Float32Array(edges));
    this.fit();
  }

  /** Fits the view to everything that is drawn: the path, a block, the limits. */
  fit(): void {
    const boxes = [this.material?.block, this.travel].filter(box => box !== undefined);
    const low = this.low.map((value, axis) => Math.min(value, ...boxes.map(box => box.low[axis]))) as Vector;
    const high = this.high.map((value, axis) => Math.max(value, ...boxes.map(box => box.high[axis]))) as Vector;
    const { clientWidth, clientHeight } = this.canvas;
    this.fits = clientWidth > 0;
    if (!this.fits) return;
    this.camera.fit(low, high, clientWidth, clientHeight);
    this.draw();
  }

  /** Changes the unit of the grid. `unit`: its size in mm. */
  measureIn(unit: number): void {
    this.unit = unit;
    this.load(this.grid, this.gridLines());
    this.draw();
  }

  /** Position of work zero, mm of machine coordinates. */
  get workZero(): Vector {
    return this.zero;
  }

  /** Shows the path as done up to a time. */
  showTime(now: number): void {
    // Where drawing is slow, a change of time is drawn like a moving view: with fewer rows.
    if (now !== this.now && this.thickIsSlow) this.lastMove = performance.now();
    this.now = now;
    this.draw();
  }

  private get thickIsSlow(): boolean {
    return (this.perRow ?? 0) * this.path.count > SLOW;
  }

  /** The time until a view counts as at rest, ms. */
  private get rest(): number {
    return this.thickIsSlow ? REST_SLOWLY : REST;
  }

  look(turn: number, height: number): void {
    this.camera.look(turn, height);
    this.draw();
  }

  draw(): void {
    if (this.asked) return;
    this.asked = true;
    requestAnimationFrame(() => {
      this.asked = false;
      this.paint();
    });
  }

  /** Returns where a point in machine coordinates (mm) appears on the canvas, in CSS pixels; `undefined` behind the
   * camera. */
  place(at: number[]): [number, number] | undefined {
    const seen = this.camera.project(at);
    return seen && [seen[0] * this.canvas.clientWidth, seen[1] * this.canvas.clientHeight];
  }

  private program(vertex: string, fragment: string): WebGLProgram {
    const gl = this.gl;
    const program = gl.createProgram();
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]] as const) {
      const shader = gl.createShader(kind) as WebGLShader;
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader) ?? "a shader failed");
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "no program");
    return program;
  }

  /** Makes a buffer for rows, and two vertex arrays that read the buffer. `thick` draws a quad between each two
   * neighbouring rows, `thin` draws all rows as a line strip. `rows`: the distance from quad to quad in rows, 1 for a
   * path and 2 for separate lines. */
  private lines(rows: number): Lines {
    const gl = this.gl;
    const buffer = gl.createBuffer();
    const size = STRIDE * 4;
    const array = (thick: boolean) => {
      const made = gl.createVertexArray();
      gl.bindVertexArray(made);
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      const next = thick ? size : 0;
      const parts = [[0, 3, 0], [1, 2, 12], [2, 3, next], [3, 2, next + 12], [4, 1, next + 20]] as const;
      for (const [location, length, offset] of parts) {
        gl.enableVertexAttribArray(location);
        gl.vertexAttribPointer(location, length, gl.FLOAT, false, thick ? size * rows : size, offset);
        if (thick) gl.vertexAttribDivisor(location, 1);
      }
      return made;
    };
    return { thick: array(true), thin: array(false), buffer, count: 0 };
  }

  private load(lines: Lines, data: Float32Array): void {
    const gl = this.gl;
    gl.bindBuffer(gl.ARRAY_BUFFER, lines.buffer);
    gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
    lines.count = data.length / STRIDE;
  }

  /** Returns the lines of the grid and of the axes. The grid lies under the path, at the height of work zero. */
  private gridLines(): Float32Array {
    const { low, high, zero } = this;
    const step = this.unit * 10 ** Math.floor(Math.log10((Math.hypot(high[0] - low[0], high[1] - low[1]) || 10) / this.unit / 3));
    const from = [0, 1].map(axis => Math.floor((low[axis] - zero[axis]) / step - 1) * step);
    const to = [0, 1].map(axis => Math.ceil((high[axis] - zero[axis]) / step + 1) * step);
    this.lattice = { from, to, step };
    const all: number[] = [];
    const line = (...ends: [Vector, Vector]) => all.push(...segment(...(ends.map(end => end.map((v, axis) => v + zero[axis])) as [Vector, Vector])));
    for (let x = from[0]; x <= to[0] + step / 2; x += step) line([x, from[1], 0], [x, to[1], 0]);
    for (let y = from[1]; y <= to[1] + step / 2; y += step) line([from[0], y, 0], [to[0], y, 0]);
    for (const axis of [0, 1, 2]) {
      const tip: Vector = [0, 0, 0];
      tip[axis] = step * 1.5;
      for (let twice = 0; twice < 2; twice++) line([0, 0, 0], tip);
    }
    return new Float32Array(all);
  }

  private paint(): void {
    const { gl, canvas, uniforms } = this;
    const ratio = devicePixelRatio || 1;
    const [width, height] = [Math.max(1, Math.round(canvas.clientWidth * ratio)), Math.max(1, Math.round(canvas.clientHeight * ratio))];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.clearColor(...rgb("--sheet"), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const view = this.camera.view(width / height);
    if (this.material) this.paintBlock(view, this.material);
    else gl.disable(gl.DEPTH_TEST);
    gl.useProgram(this.lineProgram);
    gl.uniformMatrix4fv(uniforms.view, false, view);
    gl.uniform1i(uniforms.only, this.material && !this.withPath ? 1 : 0);
    gl.uniform1i(uniforms.rapids, this.rapids ? 1 : 0);
    gl.uniform2f(uniforms.pixel, 2 / width, 2 / height);
    gl.uniform1i(uniforms.plain, 1);
    gl.uniform1i(uniforms.strip, 0);
    gl.uniform1f(uniforms.width, 0.7 * ratio);
    gl.uniform4f(uniforms.ink, ...rgb("--grid"), 1);
    // Draw no grid with a block: the grid would seem to float inside the block.
    if (!this.material) this.separate(this.grid);
    gl.uniform4f(uniforms.ink, ...rgb("--accent"), 0.8);
    this.separate(this.box);
    this.paintPath(ratio);
    this.onpaint();
  }

  private paintBlock(view: Float32Array, { block, nx, ny }: Material): void {
    const { gl } = this;
    const program = this.blockProgram;
    const at = (name: string) => gl.getUniformLocation(program, name);
    const moving = performance.now() - this.lastMove < REST;
    if (moving) setTimeout(() => this.draw(), REST);
    const stride = Math.max(1, Math.ceil(Math.sqrt((nx * ny) / (moving ? QUADS_MOVING : QUADS))));
    const quads = [nx, ny].map(count => Math.floor((count + stride - 2) / stride) + 2);
    gl.useProgram(program);
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    // The offset keeps the path visible on the surface that it has cut.
    gl.enable(gl.POLYGON_OFFSET_FILL);
    gl.polygonOffset(1, 2);
    gl.uniformMatrix4fv(at("view"), false, view);
    gl.uniform2i(at("size"), nx, ny);
    gl.uniform1i(at("stride"), stride);
    gl.uniform4f(at("frame"), block.low[0], block.low[1], block.high[0], block.high[1]);
    gl.uniform1f(at("bottom"), block.low[2]);
    gl.uniform1f(at("top"), block.high[2]);
    gl.uniform3f(at("fresh"), ...rgb("--block"));
    gl.uniform3f(at("cutColor"), ...rgb("--block-cut"));
    gl.bindTexture(gl.TEXTURE_2D, this.heights);
    gl.bindVertexArray(this.nothing);
    gl.drawArrays(gl.TRIANGLES, 0, quads[0] * quads[1] * 6);
    gl.disable(gl.POLYGON_OFFSET_FILL);
  }

  private paintPath(ratio: number): void {
    const { gl, uniforms, path } = this;
    gl.uniform1i(uniforms.plain, 0);
    gl.uniform3f(uniforms.rapid, ...rgb("--rapid"));
    gl.uniform3f(uniforms.plunge, ...rgb("--plunge"));
    gl.uniform3f(uniforms.crash, ...rgb("--bad"));
    gl.uniform3f(uniforms.future, ...rgb("--sheet"));
    gl.uniform3fv(uniforms.scale, [0, 1, 2, 3, 4, 5].flatMap(i => rgb(`--scale-${i}`)));
    gl.uniform1f(uniforms.now, Math.min(this.now, 3e38));
    gl.uniform1f(uniforms.width, 1.1 * ratio);
    if (path.count < 2) return;
    const moving = performance.now() - this.lastMove < this.rest;
    if (path.count > QUICK && !moving && this.perRow === undefined) {
      this.perRow = this.tryThick();
      this.thin();
      // The measurement has drawn into the picture: draw again.
      return this.draw();
    }
    if (path.count > QUICK && (moving || this.thickIsSlow)) {
      gl.uniform1i(uniforms.strip, 1);
      gl.bindVertexArray(path.thin);
      if (moving && this.thinned.count) gl.drawElements(gl.LINE_STRIP, this.thinned.count, gl.UNSIGNED_INT, 0);
      else gl.drawArrays(gl.LINE_STRIP, 0, path.count);
      if (!moving) return;
      clearTimeout(this.later);
      this.later = setTimeout(() => this.draw(), this.rest);
      return;
    }
    gl.bindVertexArray(path.thick);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, path.count - 1);
  }

  /** Draws some rows as thick lines to measure the time. Returns the time per row, ms. */
  private tryThick(): number {
    const { gl, path } = this;
    const wait = (): number => {
      gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
      return performance.now();
    };
    const [begun, waited] = [wait(), wait()];
    gl.bindVertexArray(path.thick);
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, TRIED);
    return (wait() - waited - (waited - begun)) / TRIED;
  }

  /** Draws separate lines: each pair of rows has the two ends of a line. */
  private separate(lines: Lines): void {
    const gl = this.gl;
    gl.bindVertexArray(lines.thick);
    if (lines.count > 1) gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, lines.count / 2);
  }

  /** Returns the drawn row nearest to a position on the canvas within `within` pixels; -1 if there is none. */
  private nearest(x: number, y: number, within = 12): number {
    let [best, found] = [within * within, -1];
    for (let i = 1; i < this.shades.length; i++) {
      for (const part of [0.5, 1]) {
        const at = [0, 1, 2].map(axis => this.rows[(i - 1) * ROW + axis] * (1 - part) + this.rows[i * ROW + axis] * part);
        const seen = this.place(at);
        const off = seen ? (seen[0] - x) ** 2 + (seen[1] - y) ** 2 : Infinity;
        if (off < best) [best, found] = [off, i];
      }
    }
    return found;
  }

  private moved(): void {
    this.lastMove = performance.now();
    this.draw();
  }

  private listen(): void {
    const { canvas, camera } = this;
    const down = new Map<number, [number, number]>();
    let travelled = 0;
    canvas.addEventListener("pointerdown", event => {
      canvas.setPointerCapture(event.pointerId);
      down.set(event.pointerId, [event.clientX, event.clientY]);
      travelled = 0;
    });
    canvas.addEventListener("pointercancel", event => down.delete(event.pointerId));
    canvas.addEventListener("pointerup", event => {
      down.delete(event.pointerId);
      const frame = canvas.getBoundingClientRect();
      const row = travelled < 4 ? this.nearest(event.clientX - frame.left, event.clientY - frame.top) : -1;
      if (row > 0) this.onpick(row);
    });
    canvas.addEventListener("contextmenu", event => event.preventDefault());
    canvas.addEventListener("pointermove", event => {
      const was = down.get(event.pointerId);
      if (!was) return;
      const [dx, dy] = [event.clientX - was[0], event.clientY - was[1]];
      travelled += Math.abs(dx) + Math.abs(dy);
      const other = [...down].find(([id]) => id !== event.pointerId)?.[1];
      if (other) {
        const apart = (at: [number, number]) => Math.hypot(at[0] - other[0], at[1] - other[1]);
        const now = apart([event.clientX, event.clientY]);
        if (now > 1) camera.distance *= apart(was) / now;
        camera.pan(dx / 2, dy / 2, canvas.clientHeight);
      } else if (event.buttons & 6 || event.shiftKey) camera.pan(dx, dy, canvas.clientHeight);
      else camera.look(camera.turn - dx * 0.008, camera.height + dy * 0.008);
      down.set(event.pointerId, [event.clientX, event.clientY]);
      this.moved();
    });
    canvas.addEventListener("wheel", event => {
      event.preventDefault();
      camera.distance *= Math.exp(event.deltaY * 0.001);
      this.moved();
    }, { passive: false });
    canvas.addEventListener("keydown", event => {
      const arrow = ARROWS[event.key];
      const turnOrPan = ([x, y]: readonly [number, number]) => {
        if (event.shiftKey) camera.pan(x * PAN, -y * PAN, canvas.clientHeight);
        else camera.look(camera.turn + x * 0.1, camera.height + y * 0.1);
      };
      const keys: Record<string, () => void> = {
        "+": () => (camera.distance *= 0.9),
        "-": () => (camera.distance /= 0.9),
        "0": () => this.fit(),
      };
      if (arrow) keys[event.key] = () => turnOrPan(arrow);
      if (!keys[event.key]) return;
      keys[event.key]();
      event.preventDefault();
      this.moved();
    });
  }
}

/** Returns a straight line as two rows. Times and shade are 0. */
function segment(from: Vector, to: Vector): number[] {
  const row = (at: Vector) => [...at, 0, 0, 0];
  return [...row(from), ...row(to)];
}
