// Runs the `oxmill` program of this host, for comparison: the page must give the same results.
import assert from "node:assert/strict";
import { execFileSync, spawn, spawnSync } from "node:child_process";
import { mkdtempSync, readdirSync, readFileSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";

export const root = join(dirname(fileURLToPath(import.meta.url)), "../../../..");
export const page = join(root, "target/web/oxmill.html");
export const wasm = join(root, "target/web/oxmill.wasm");
export const oxmill = join(root, "target/release/oxmill");
export const folder = mkdtempSync(join(tmpdir(), "oxmill-page-"));

/** Settings of a small mill. */
export const MILL = { 110: 5000, 111: 5000, 112: 2000, 120: 300, 121: 300, 122: 200 };
export const BOARDS = ["desk", "blackpill_f411", "nucleo_f446re"];
/** Asserts that two summaries are equal, except for the name of the job and the duration of the check. */
export const same = (a, b, what) => assert.deepEqual({ ...a, host_s: 0, job: "" }, { ...b, host_s: 0, job: "" }, what);

export const examples = () => readdirSync(join(root, "examples")).filter(name => name.endsWith(".nc"));
export const example = name => readFileSync(join(root, "examples", name), "utf8");

function options({ board = "desk", settings = {}, dialect, work_zero }) {
  const set = Object.entries(settings).flatMap(([number, value]) => ["--set", `${number}=${value}`]);
  return ["--board", board, ...set, ...(dialect ? ["--dialect", dialect] : []), ...(work_zero ? [`--work-zero=${work_zero}`] : [])];
}

function write(name, text) {
  const file = join(folder, name);
  writeFileSync(file, text);
  return file;
}

/** Returns the output of `oxmill run --json`. */
export function run(name, text, order = {}) {
  const done = spawnSync(oxmill, ["run", write(name, text), "--json", ...options(order)], { encoding: "utf8", maxBuffer: 1 << 26 });
  if (!done.stdout) throw new Error(done.stderr);
  return JSON.parse(done.stdout);
}

/** Returns the output of `oxmill resume`. */
export function resumed(name, text, more) {
  return execFileSync(oxmill, ["resume", write(name, text), ...more], { encoding: "utf8", stdio: ["ignore", "pipe", "ignore"] });
}

/** Runs a job with a trace of all steps. Returns a function that gives the machine position, mm, at a time in s after
 * the first step. */
export function traced(name, text, order, steps_per_mm) {
  const csv = join(folder, "trace.csv");
  execFileSync(oxmill, ["run", write(name, text), "--trace", csv, ...options(order)], { stdio: "ignore" });
  const rows = readFileSync(csv, "utf8").trim().split("\n").slice(1).map(row => row.split(",").slice(0, 4).map(Number));
  return seconds => (rows.findLast(row => row[0] <= seconds) ?? [0, 0, 0, 0]).slice(1).map(v => v / steps_per_mm);
}

/** Starts the firmware as a Grbl device on a TCP port. */
export async function serve(order, speed, link = ["--tcp", "127.0.0.1:0"]) {
  const child = spawn(oxmill, ["serve", ...link, "--speed", speed, ...options(order)]);
  const port = await new Promise((resolve, reject) => {
    child.stdout.once("data", data => resolve(parseInt(String(data).trim().split(":").pop(), 10)));
    child.once("error", reject);
  });
  return { port, stop: () => child.kill() };
}
