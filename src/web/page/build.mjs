// Makes the page: one HTML file that needs nothing else. Called by `cargo xtask web`, which has built the module.
import { build } from "esbuild";
import { mkdirSync, readFileSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { brotliCompressSync, constants } from "node:zlib";

const here = dirname(fileURLToPath(import.meta.url));
const root = join(here, "../../..");
const target = join(root, "target/web");
/** Examples that are part of the page. The others can be dropped on it. */
const EXAMPLES = ["five_circles.nc", "house.nc", "pocket_mm.nc", "pocket_inch.nc", "pcb_isolation.nc"];

const bundle = async entry => {
  const options = { entryPoints: [join(here, "src", entry)], bundle: true, minify: true, write: false, format: "iife", target: "es2022" };
  return (await build(options)).outputFiles[0].text;
};
// `</script` would end the element that a script is in.
const script = text => `<script>${text.replaceAll("</script", "<\\/script")}</script>`;

const wasm = readFileSync(join(target, "oxmill.wasm"));
const data = {
  wasm: wasm.toString("base64"),
  worker: await bundle("worker.ts"),
  examples: Object.fromEntries(EXAMPLES.map(name => [name, readFileSync(join(root, "examples", name), "utf8")])),
};
const page = readFileSync(join(here, "src/index.html"), "utf8")
  .replace("/*STYLE*/", () => readFileSync(join(here, "src/style.css"), "utf8"))
  .replace("<!--SCRIPT-->", () => script(`globalThis.OXMILL=${JSON.stringify(data)}`) + script(""));
const app = await bundle("app.ts");
mkdirSync(target, { recursive: true });
writeFileSync(join(target, "oxmill.html"), page.replace("<script></script>", () => script(app)));

/** Sizes may grow by this part before somebody has to accept it. */
const TOLERANCE = 1.02;
const sizes = join(here, "sizes.txt");
const measured = { "oxmill.wasm": wasm, "oxmill.html": readFileSync(join(target, "oxmill.html")) };
const rows = Object.entries(measured).map(([name, bytes]) => {
  const packed = brotliCompressSync(bytes, { params: { [constants.BROTLI_PARAM_SIZE_HINT]: bytes.length } }).length;
  return { name, raw: bytes.length, packed };
});
for (const { name, raw, packed } of rows) console.log(`${join(target, name)}: ${raw} bytes, ${packed} with brotli`);
const head = readFileSync(sizes, "utf8").split("\n").filter(line => line.startsWith("#"));
if (process.env.OXMILL_SIZES === "accept") {
  writeFileSync(sizes, [...head, ...rows.map(({ name, raw, packed }) => `${name} ${raw} ${packed}`), ""].join("\n"));
} else if (process.env.OXMILL_SIZES === "check") {
  for (const { name, packed } of rows) {
    const line = readFileSync(sizes, "utf8").split("\n").find(row => row.startsWith(`${name} `));
    const expected = Number(line?.split(" ")[2] ?? 0);
    if (packed > expected * TOLERANCE) {
      console.error(`${name} has grown from ${expected} to ${packed} bytes; if that is right: OXMILL_SIZES=accept cargo xtask web`);
      process.exit(1);
    }
  }
}
