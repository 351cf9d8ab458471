// Calls the WebAssembly module: bytes in, bytes out. src/web/lib.rs describes its interface.

export interface Order {
  name?: string;
  board?: string;
  dialect?: string;
  settings?: Record<string, number>;
  path?: boolean;
  machine?: object;
  /** Work zero of G54 in mm of machine coordinates. If it is given, the machine is homed before its job. */
  work_zero?: number[];
  /** Lines that the machine executes before its job, to set its offsets and tools. */
  stored?: string[];
  baud?: number;
  resume?: Resume;
}

/** Where a job is resumed, like the options of `oxmill resume`. `clearance` in mm, `plunge` in mm/min, `spin_up` in
 * s. */
export interface Resume { line: number; clearance?: number; plunge?: number; spin_up?: number }
/** The program that does the rest of a job. `line`: line of the job at which the rest begins; `prologue`: lines that
 * were added before it, to restore the state. */
export interface Rest { program: string; line: number; lines: number; prologue: string[] }

export interface LineError { line: number; code: number; text: string; source: string; advice: string }
/** A line that is accepted but may not do what was intended. */
export interface Warning { line: number; text: string }
export interface AlarmReport { code: number; text: string; line: number | null; advice: string }

export interface ToolTime { tool: number; feed_s: number; rapid_s: number; dwell_s: number; spin_up_s: number }

/** The output of `oxmill run --json`: docs/json.md. */
export interface Summary {
  job: string; board: string; dialect: string; lines: number; errors: LineError[]; more_errors: number; warnings: Warning[]; more_warnings: number;
  alarm: AlarmReport | null; complete: boolean; notes: string[]; messages: string[];
  forecast_s: number; feed_s: number; rapid_s: number; standing_s: number; dwell_s: number; spin_up_s: number; tools: ToolTime[];
  position_mm: number[]; work_position_mm: number[]; pulses: number[];
  distance_mm: number; rapid_distance_mm: number; extents_mm: { min: number[]; max: number[] }; travel_mm: { min: [number, number, number]; max: [number, number, number] };
  peak_speed_mm_s: number; peak_acceleration_mm_s2: number; trace_hash: string; order_hash: string; host_s: number;
}

/** Returns the reason why a job does not run to its end: `text` describes it, `line` is its line, and `more` is the
 * firmware's explanation. Returns `undefined` if the job is complete. */
export function hindrance({ errors, more_errors, alarm, complete }: Summary): { text: string; line?: number; more?: string } | undefined {
  const refused = errors.length + more_errors;
  const [first] = errors;
  // Name the alarm, unless a line before the alarm was rejected. Rejected lines after an alarm only follow from the
  // alarm.
  if (alarm && !(first && first.line < (alarm.line ?? 0))) return { text: `the job ends in alarm ${alarm.code}`, line: alarm.line ?? undefined, more: alarm.text };
  if (refused) return { text: `${refused.toLocaleString("en")} line${refused === 1 ? "" : "s"} would be refused`, line: first.line, more: `Line ${first.line}: ${first.text}` };
  return complete ? undefined : { text: "the job does not come to its end" };
}

/** Returns the position of work zero at the end of a job, in mm of machine coordinates. */
export const workZero = (summary: Summary): [number, number, number] =>
  summary.position_mm.map((at, axis) => at - summary.work_position_mm[axis]) as [number, number, number];

/** Numbers per row: x, y, z in mm, speed in mm/s, start and end in s. */
export const ROW = 6;
export const RAPID = 0x80000000;
export const ARC = 0x40000000;
/** The path of the tool in rows. A row is a straight piece from the position of the previous row to its own, with ROW
 * numbers in `rows`. `lines`: the line number of each row, with the bit RAPID or ARC set for these moves. `speeds`: S
 * of each row; 0 while the spindle is off. */
export interface Path { rows: Float32Array; lines: Uint32Array; tools: Uint32Array; speeds: Uint32Array }

export interface Streamed { baud: number; forecast_s: number; complete: boolean; errors: number; lost: { line: number; seconds: number }[] }

export interface Setting {
  number: number; name: string; unit: string; kind: string; min: number | null; max: number | null;
  values: string; default: number; grbl: boolean; axis: string | null;
  /** What the setting does, and when to change it. */
  explanation: string;
  /** `title`: the name without its axis, the same for all axes. `labels`: the names of the choices, or of the bits,
   * from 0 on. */
  title: string; group: string; labels: string[];
}
export interface Meaning { code: number; text: string; advice: string }
export interface Description {
  version: string; boards: { name: string; step_clock_hz: number }[]; settings: Setting[]; errors: Meaning[]; alarms: Meaning[];
}

/** A setting that results from an entry in a settings file of another controller. `from`: this entry; `line`: its line
 * in the file. */
export interface Taken { number: number; value: number; name: string; unit: string; from: string; line: number }
export interface Import {
  what: string;
  taken: Taken[];
  /** Entries that are not taken, each with the reason. */
  left: { text: string; why: string; line: number }[];
}

/** A pin table without faults. `name`: the board's name; `image`: the firmware image that the table is for; `pins`:
 * the number of its pins. */
export interface Pins { name: string; image: string; pins: number }

interface Exports {
  memory: WebAssembly.Memory;
  oxmill_abi(): number;
  oxmill_input(length: number): number;
  oxmill_output(): number;
  oxmill_output_len(): number;
  oxmill_describe(): number;
  oxmill_check_begin(): number;
  oxmill_check_advance(rounds: number): number;
  oxmill_check_seconds(): number;
  oxmill_check_summary(): number;
  oxmill_path(): number;
  oxmill_path_rows(): number;
  oxmill_path_lines(): number;
  oxmill_path_tools(): number;
  oxmill_path_speeds(): number;
  oxmill_stream_begin(): number;
  oxmill_stream_advance(ms: number): number;
  oxmill_stream_summary(): number;
  oxmill_resume(): number;
  oxmill_import(): number;
  oxmill_pins_file(): number;
  oxmill_pins_check(): number;
  oxmill_pins_in(): number;
  oxmill_pins_write(): number;
  oxmill_machine_begin(): number;
  oxmill_machine_turn(us: number): number;
  oxmill_machine_pin(): number;
  oxmill_panic_len(): number;
  oxmill_panic(): number;
}

const ABI = 2;
const DONE = 1001;
const encode = (text: string) => new TextEncoder().encode(text);

export class Engine {
  private constructor(private readonly wasm: Exports) {}

  static async start(module: WebAssembly.Module): Promise<Engine> {
    const wasm = (await WebAssembly.instantiate(module, {})).exports as unknown as Exports;
    if (wasm.oxmill_abi() !== ABI) throw new Error("the module and the page are not of one build");
    return new Engine(wasm);
  }

  describe(): Description {
    return JSON.parse(this.call(() => this.wasm.oxmill_describe()));
  }

  /** Runs a job through the controller. `progress` is called from time to time with the part of the file that has been
   * read, 0 to 1. */
  check(order: Order, job: Uint8Array, progress: (part: number) => void = () => {}): Summary {
    this.put(encode(JSON.stringify(order)), new Uint8Array(1), job);
    this.call(() => this.wasm.oxmill_check_begin());
    this.toTheEnd(() => this.wasm.oxmill_check_advance(16384), progress);
    this.put(encode(order.name ?? ""));
    return JSON.parse(this.call(() => this.wasm.oxmill_check_summary()));
  }

  /** Returns the path of the last check, or during a check the path so far. The order of the check must have
   * `path`. */
  path(): Path {
    const count = this.guard(() => this.wasm.oxmill_path());
    // The module returns addresses as signed numbers; make them unsigned.
    const [rows, lines, tools, speeds] = [this.wasm.oxmill_path_rows(), this.wasm.oxmill_path_lines(), this.wasm.oxmill_path_tools(), this.wasm.oxmill_path_speeds()].map(at => at >>> 0);
    const { buffer } = this.wasm.memory;
    return {
      rows: new Float32Array(buffer, rows, count * ROW).slice(),
      lines: new Uint32Array(buffer, lines, count).slice(),
      tools: new Uint32Array(buffer, tools, count).slice(),
      speeds: new Uint32Array(buffer, speeds, count).slice(),
    };
  }

  stream(order: Order, job: Uint8Array): Streamed {
    this.put(encode(JSON.stringify(order)), new Uint8Array(1), job);
    this.call(() => this.wasm.oxmill_stream_begin());
    this.toTheEnd(() => this.wasm.oxmill_stream_advance(1000), () => {});
    return JSON.parse(this.call(() => this.wasm.oxmill_stream_summary()));
  }

  resume(order: Order, job: Uint8Array): Rest {
    this.put(encode(JSON.stringify(order)), new Uint8Array(1), job);
    return JSON.parse(this.call(() => this.wasm.oxmill_resume()));
  }

  /** Throws an error if the text is not of a known form. */
  importSettings(text: string): Import {
    this.put(encode(text));
    return JSON.parse(this.call(() => this.wasm.oxmill_import()));
  }

  /** Returns the file with the pin table of a board; empty if there is no such board. */
  pinsOf(board: string): string {
    this.put(encode(board));
    return this.call(() => this.wasm.oxmill_pins_file());
  }

  /** Returns the board name in the pin table of an image; empty if the image has no pin table. */
  pinsIn(image: Uint8Array): string {
    this.put(image);
    return this.call(() => this.wasm.oxmill_pins_in());
  }

  /** Checks a pin table. Throws an error with all its faults, a line each. */
  checkPins(table: string): Pins {
    this.put(encode(table));
    return JSON.parse(this.call(() => this.wasm.oxmill_pins_check()));
  }

  /** Writes a pin table into an image. */
  writePins(table: string, image: Uint8Array): Uint8Array {
    this.put(encode(table), new Uint8Array(1), image);
    return this.bytes(() => this.wasm.oxmill_pins_write()).slice();
  }

  powerUp(order: Order): string {
    this.put(encode(JSON.stringify(order)));
    return this.call(() => this.wasm.oxmill_machine_begin());
  }

  turn(bytes: Uint8Array, microseconds: number): string {
    this.put(bytes);
    return this.call(() => this.wasm.oxmill_machine_turn(microseconds));
  }

  pin(line: string): string {
    this.put(encode(line));
    return this.call(() => this.wasm.oxmill_machine_pin());
  }

  /** Size of the module's memory, in bytes. */
  memory(): number {
    return this.wasm.memory.buffer.byteLength;
  }

  private toTheEnd(advance: () => number, progress: (part: number) => void): void {
    let shown = performance.now();
    for (;;) {
      const part = this.guard(advance);
      if (part === DONE) return;
      if (performance.now() - shown > 50) {
        shown = performance.now();
        progress(part / 1000);
      }
    }
  }

  private put(...parts: Uint8Array[]): void {
    let at = this.guard(() => this.wasm.oxmill_input(parts.reduce((sum, part) => sum + part.length, 0)));
    for (const part of parts) {
      new Uint8Array(this.wasm.memory.buffer, at, part.length).set(part);
      at += part.length;
    }
  }

  private call(exported: () => number): string {
    return new TextDecoder().decode(this.bytes(exported));
  }

  /** Calls the module. Returns its output, which is valid until the next call. */
  private bytes(exported: () => number): Uint8Array {
    const status = this.guard(exported);
    const [at, length] = [this.wasm.oxmill_output(), this.wasm.oxmill_output_len()];
    if (status !== 0) throw new Error(this.text(at, length));
    return new Uint8Array(this.wasm.memory.buffer, at >>> 0, length >>> 0);
  }

  private guard(exported: () => number): number {
    try {
      return exported() >>> 0;
    } catch (trap) {
      const text = this.text(this.wasm.oxmill_panic(), this.wasm.oxmill_panic_len());
      throw new Error(text || String(trap), { cause: trap });
    }
  }

  private text(at: number, length: number): string {
    return new TextDecoder().decode(new Uint8Array(this.wasm.memory.buffer, at >>> 0, length >>> 0));
  }
}
