// Builds the page: one self-contained HTML file, and the same page as a site that can be installed. `cargo xtask web`
// builds the module and then calls this.
import { build } from "esbuild";
import { createHash } from "node:crypto";
import { mkdirSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { brotliCompressSync, constants } from "node:zlib";

const here = dirname(fileURLToPath(import.meta.url));
const root = join(here, "../../..");
const target = join(root, "target/web");
/** Examples that are built into the page. The others can be dropped onto it. */
const EXAMPLES = ["five_circles.nc", "house.nc", "pocket_mm.nc", "pocket_inch.nc", "pcb_isolation.nc"];

const bundle = async (entry, define = {}) => {
  const options = { define, entryPoints: [join(here, "src", entry)], bundle: true, minify: true, write: false, format: "iife", target: "es2022" };
  return (await build(options)).outputFiles[0].text;
};
// Escape `</script`, which would end the `script` element.
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
const whole = page.replace("<script></script>", () => script(app));
writeFileSync(join(target, "oxmill.html"), whole);

// The same page as a site that a browser can install. Manifest and service worker must be separate files.
const icon = `<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 64"><rect width="64" height="64" fill="#12161c"/><circle cx="32" cy="32" r="14" fill="none" stroke="#58a2ff" stroke-width="9"/><path d="M32 13v12M32 39v12M13 32h12M39 32h12" stroke="#12161c" stroke-width="3"/></svg>\n`;
const manifest = {
  name: "Oxmill", short_name: "Oxmill", description: "Checks, forecasts and runs G-code", id: "./", start_url: "./", scope: "./", display: "standalone", background_color: "#f3f4f6", theme_color: "#12161c",
  icons: [{ src: "icon.svg", type: "image/svg+xml", sizes: "any", purpose: "any" }, { src: "icon.svg", type: "image/svg+xml", sizes: "any", purpose: "maskable" }],
  file_handlers: [{ action: "./", accept: { "text/x-gcode": [".nc", ".ngc", ".gcode", ".gc", ".tap", ".cnc"] } }], launch_handler: { client_mode: "focus-existing" },
};
// The site may connect to the server that it comes from, to load firmware images.
const POLICY = [["worker-src blob:;", "worker-src blob: 'self'; manifest-src 'self';"], ["img-src data:;", "img-src data: 'self';"], ["connect-src 'none';", "connect-src 'self';"]];
const ICON = '<link rel="icon"';
if (![ICON, ...POLICY.map(([from]) => from)].every(part => whole.includes(part))) throw new Error("index.html has no place for the manifest");
const files = {
  "index.html": POLICY.reduce((text, [from, to]) => text.replace(from, to), whole).replace(ICON, `<link rel="manifest" href="oxmill.webmanifest">\n<meta name="oxmill-offline" content="offline.js">\n<meta name="oxmill-firmware" content="firmware.json">\n<meta name="theme-color" content="#12161c">\n${ICON}`),
  "oxmill.webmanifest": `${JSON.stringify(manifest, undefined, 1)}\n`,
  "icon.svg": icon,
};
const version = createHash("sha256").update(Object.values(files).join("\0")).digest("hex").slice(0, 16);
files["offline.js"] = await bundle("offline.ts", { VERSION: JSON.stringify(version), FILES: JSON.stringify(["./", "oxmill.webmanifest", "icon.svg"]) });
rmSync(join(target, "site"), { recursive: true, force: true });
mkdirSync(join(target, "site"), { recursive: true });
// This list of firmware images is empty. `cargo xtask dist` packs the images that it has built, with their list.
files["firmware.json"] = "[]\n";
for (const [name, text] of Object.entries(files)) writeFileSync(join(target, "site", name), text);

/** A compressed size may grow by this factor. More growth must be accepted with `OXMILL_SIZES=accept`. */
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
