// Runs the firmware in a worker: whole jobs, or one machine in real time.
import { Engine, type Order, type Path } from "./engine";
import { type Block, cellFor, cut, type Cutter } from "./material";

export type Task =
  | { task: "module"; module: WebAssembly.Module }
  | { task: "describe" }
  | { task: "check"; order: Order; job: Uint8Array }
  | { task: "stream"; order: Order; job: Uint8Array }
  | { task: "resume"; order: Order; job: Uint8Array }
  | { task: "material"; path: Path; cutters: Record<number, Cutter>; block: Block; until: number }
  | { task: "power"; order: Order }
  | { task: "send"; bytes: Uint8Array }
  | { task: "pin"; line: string }
  | { task: "speed"; times: number };

const worker = globalThis as unknown as { postMessage(message: unknown, transfer?: Transferable[]): void; onmessage: unknown };
/** Interval at which the machine is advanced to the page's clock, ms. */
const PERIOD = 4;
/** Time that the machine runs with each batch of received bytes, ms of machine time. */
const SLICE = 2;
/** A check sends the path so far after this time, ms. Then it sends the path each time that its run time has
 * doubled. */
const SKETCH = 500;
/** Maximum time between two ticks that the machine makes up for, ms. The system can suspend a worker for longer. */
const MOST = 100;

let module: WebAssembly.Module;
let machine: Engine | undefined;
let speed = 1;
let last = 0;
const pending: Uint8Array[] = [];

const buffers = ({ rows, lines, tools, speeds }: Path): Transferable[] => [rows.buffer, lines.buffer, tools.buffer, speeds.buffer];

function tick(): void {
  const now = performance.now();
  const passed = Math.min(now - last, MOST);
  last = now;
  let said = "";
  for (let left = passed * speed; left > 0 && machine; left -= SLICE) {
    const bytes = pending.shift() ?? new Uint8Array(0);
    said += machine.turn(bytes, Math.round(Math.min(left, SLICE) * 1000));
    // If the simulation is slow, send the output now, so that a host can react in time.
    if (said && speed > 1 && performance.now() - now > PERIOD * 4) break;
  }
  if (said) worker.postMessage({ is: "said", text: said });
}

async function carryOut(task: Task): Promise<void> {
  switch (task.task) {
    case "module":
      module = task.module;
      return;
    case "describe":
      worker.postMessage({ is: "described", description: (await Engine.start(module)).describe() });
      return;
    case "check": {
      const began = performance.now();
      const engine = await Engine.start(module);
      let sketch = SKETCH;
      const summary = engine.check(task.order, task.job, part => {
        worker.postMessage({ is: "progress", part });
        if (!task.order.path || performance.now() - began < sketch) return;
        const path = engine.path();
        worker.postMessage({ is: "sketch", path }, buffers(path));
        sketch = 2 * (performance.now() - began);
      });
      const path = task.order.path ? engine.path() : undefined;
      summary.host_s = (performance.now() - began) / 1000;
      worker.postMessage({ is: "checked", summary, path, memory: engine.memory() }, path ? buffers(path) : []);
      return;
    }
    case "stream":
      worker.postMessage({ is: "streamed", streamed: (await Engine.start(module)).stream(task.order, task.job) });
      return;
    case "resume":
      worker.postMessage({ is: "resumed", rest: (await Engine.start(module)).resume(task.order, task.job) });
      return;
    case "material": {
      const { path, cutters, block, until } = task;
      const progress = (part: number) => worker.postMessage({ is: "progress", part });
      const material = cut(path, cutters, block, cellFor(path, cutters, block), progress, until);
      worker.postMessage({ is: "material", material }, [material.heights.buffer]);
      return;
    }
    case "power": {
      machine = await Engine.start(module);
      const greeting = machine.powerUp(task.order);
      worker.postMessage({ is: "said", text: greeting });
      last = performance.now();
      setInterval(() => {
        try {
          tick();
        } catch (error) {
          machine = undefined;
          worker.postMessage({ is: "failed", why: String((error as Error).message) });
        }
      }, PERIOD);
      return;
    }
    case "send":
      pending.push(task.bytes);
      return;
    case "pin":
      machine?.pin(task.line);
      return;
    case "speed":
      speed = task.times;
  }
}

worker.onmessage = async ({ data }: { data: Task }) => {
  try {
    await carryOut(data);
  } catch (error) {
    worker.postMessage({ is: "failed", why: (error as Error).message });
  }
};
