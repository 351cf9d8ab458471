// Checks a job with the firmware, compiled to WebAssembly, as a program of your own would: oxmill.wasm has no imports,
// so Node.js needs no package for it.
//
//     node examples/module.mjs target/web/oxmill.wasm JOB.nc [110=5000 ...]
//
// Prints the summary as `oxmill run JOB.nc --json` does. The functions of the module are described in src/web/lib.rs.
import { readFileSync } from "node:fs";
import { stderr, argv, exit } from "node:process";

const [wasm, name, ...pairs] = argv.slice(2);
if (name === undefined || pairs.some(pair => !/^\d+=-?[\d.]+$/.test(pair))) {
  console.error("usage: node examples/module.mjs target/web/oxmill.wasm JOB.nc [110=5000 ...]");
  exit(2);
}
const load = async () => (await WebAssembly.instantiate(readFileSync(wasm))).instance;
const { exports } = await load().catch(error => {
  console.error(`${wasm}: ${error.message}`);
  exit(2);
});

/** Returns a text that the module has prepared. The module returns addresses as signed numbers. */
const text = what => {
  const [at, length] = [exports[`oxmill_${what}`](), exports[`oxmill_${what}_len`]()].map(value => value >>> 0);
  return new TextDecoder().decode(new Uint8Array(exports.memory.buffer, at, length));
};

function put(bytes) {
  const at = exports.oxmill_input(bytes.length) >>> 0;
  new Uint8Array(exports.memory.buffer, at, bytes.length).set(bytes);
}

function check(order, job) {
  put(Buffer.concat([Buffer.from(JSON.stringify(order)), Buffer.from([0]), job]));
  if (exports.oxmill_check_begin() !== 0) throw new Error(text("output"));
  for (let part; (part = exports.oxmill_check_advance(100_000)) <= 1000; ) stderr.write(`${Math.floor(part / 10)} %\r`);
  put(Buffer.from(order.name));
  exports.oxmill_check_summary();
  return JSON.parse(text("output"));
}

try {
  const settings = Object.fromEntries(pairs.map(pair => pair.split("=")).map(([number, value]) => [number, Number(value)]));
  const summary = check({ name, board: "blackpill_f411", settings }, readFileSync(name));
  console.log(JSON.stringify(summary, undefined, 2));
  exit(summary.errors.length || summary.alarm || !summary.complete ? 1 : 0);
} catch (error) {
  // A panic of the firmware ends the instance and leaves its message as the text `panic`.
  console.error(text("panic") || error.message);
  exit(2);
}
