// Calls the firmware's WebAssembly module. Each long task runs in a worker of its own. Short calls run on the page
// itself.
import { type Description, Engine, type Import, type Order, type Path, type Pins, type Rest, type Streamed, type Summary } from "./engine";
import type { Block, Cutter, Material } from "./material";
import type { Task } from "./worker";

declare const OXMILL: { wasm: string; worker: string; examples: Record<string, string> };
export const examples = OXMILL.examples;

export interface Checked { summary: Summary; path?: Path; memory: number }

let module: WebAssembly.Module;
let engine: Engine;
const source = URL.createObjectURL(new Blob([OXMILL.worker], { type: "text/javascript" }));

export async function load(): Promise<void> {
  const text = atob(OXMILL.wasm);
  // A loop takes a tenth of the time of `Uint8Array.from` with a function.
  const bytes = new Uint8Array(text.length);
  for (let at = 0; at < text.length; at++) bytes[at] = text.charCodeAt(at);
  module = await WebAssembly.compile(bytes);
  engine = await Engine.start(module);
}

/** Translates the settings of another controller into settings of Oxmill. Throws an error if the format of the text is
 * unknown. */
export const importSettings = (text: string): Import => engine.importSettings(text);

/** Returns the file with the pin table of a board of this project. */
export const pinsOf = (board: string): string | undefined => engine.pinsOf(board) || undefined;
/** Returns the board name in the pin table of an image, if the image has a pin table. */
export const pinsIn = (image: Uint8Array): string | undefined => engine.pinsIn(image) || undefined;
/** Checks a pin table. Throws an error with all its faults, a line each. */
export const checkPins = (table: string): Pins => engine.checkPins(table);
/** Writes a pin table into an image. Throws an error with the reason if the table is for another image. */
export const writePins = (table: string, image: Uint8Array): Uint8Array => engine.writePins(table, image);

export function worker(): Worker {
  const made = new Worker(source);
  made.postMessage({ task: "module", module } satisfies Task);
  return made;
}

type Answer = { is: string; part: number; why: string; path?: Path };

/** Runs a task in a worker of its own. The worker ends after the task, or when `signal` aborts. `is`: the kind of
 * message that carries the result. */
function run<T extends Answer>(task: Task, is: string, signal?: AbortSignal, progress?: (part: number) => void, sketch?: (path: Path) => void): Promise<T> {
  return new Promise((resolve, reject) => {
    const one = worker();
    const end = () => one.terminate();
    signal?.addEventListener("abort", () => {
      end();
      reject(signal.reason);
    });
    one.onmessage = ({ data }: MessageEvent<T>) => {
      if (data.is === "progress") progress?.(data.part);
      if (data.is === "sketch" && data.path) sketch?.(data.path);
      if (data.is === is) {
        end();
        resolve(data);
      }
      if (data.is === "failed") {
        end();
        reject(new Error(data.why));
      }
    };
    one.onerror = event => {
      end();
      reject(new Error(event.message));
    };
    one.postMessage(task);
  });
}

export async function describe(): Promise<Description> {
  return (await run<Answer & { description: Description }>({ task: "describe" }, "described")).description;
}

/** Checks a job. `sketch` receives the path so far if the check takes long. */
export function check(order: Order, job: Uint8Array, signal?: AbortSignal, progress?: (part: number) => void, sketch?: (path: Path) => void): Promise<Checked> {
  return run<Answer & Checked>({ task: "check", order, job }, "checked", signal, progress, sketch);
}

export async function stream(order: Order, job: Uint8Array, signal?: AbortSignal): Promise<Streamed> {
  return (await run<Answer & { streamed: Streamed }>({ task: "stream", order, job }, "streamed", signal)).streamed;
}

export async function resume(order: Order, job: Uint8Array, signal?: AbortSignal): Promise<Rest> {
  return (await run<Answer & { rest: Rest }>({ task: "resume", order, job }, "resumed", signal)).rest;
}

/** Computes the shape of a block after the moves of a job up to the time `until`, s. The computation takes seconds.
 * Therefore it runs in a worker. */
export async function cutBlock(path: Path, cutters: Record<number, Cutter>, block: Block, until: number, signal: AbortSignal, progress: (part: number) => void): Promise<Material> {
  return (await run<Answer & { material: Material }>({ task: "material", path, cutters, block, until }, "material", signal, progress)).material;
}

/** Runs tasks in as many workers at a time as there are cores, at most four. */
export async function each<T>(tasks: (() => Promise<T>)[], done: (index: number, result: T) => void): Promise<void> {
  let next = 0;
  const lanes = Math.max(1, Math.min(navigator.hardwareConcurrency || 2, 4, tasks.length));
  await Promise.all(Array.from({ length: lanes }, async () => {
    while (next < tasks.length) {
      const index = next++;
      done(index, await tasks[index]());
    }
  }));
}
