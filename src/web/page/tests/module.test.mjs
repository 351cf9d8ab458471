// Tests the WebAssembly module without the page, as other programs use it.
import assert from "node:assert/strict";
import { spawnSync } from "node:child_process";
import { existsSync, readFileSync, writeFileSync } from "node:fs";
import { join } from "node:path";
import { example, folder, page, root, run, same, wasm } from "./program.mjs";

const encode = text => new TextEncoder().encode(text);

async function instance() {
  const module = await WebAssembly.compile(readFileSync(wasm));
  assert.deepEqual(WebAssembly.Module.imports(module), [], "the module needs nothing");
  const { exports: x } = await WebAssembly.instantiate(module, {});
  return {
    x,
    put(bytes) {
      const at = x.oxmill_input(bytes.length);
      new Uint8Array(x.memory.buffer, at, bytes.length).set(bytes);
    },
    output: () => new TextDecoder().decode(new Uint8Array(x.memory.buffer, x.oxmill_output(), x.oxmill_output_len())),
  };
}

export async function any_program_can_use_the_module() {
  const { x, put, output } = await instance();
  assert.equal(x.oxmill_abi(), 2);
  const text = example("house.nc");
  put(encode(`${JSON.stringify({ board: "nucleo_f446re", settings: { 110: 4000 } })}\0${text}`));
  assert.equal(x.oxmill_check_begin(), 0, output());
  let last = 0;
  for (let part; (part = x.oxmill_check_advance(1000)) <= 1000; last = part) assert(part >= last, "progress never falls");
  put(encode("house.nc"));
  assert.equal(x.oxmill_check_summary(), 0);
  const expected = run("house.nc", text, { board: "nucleo_f446re", settings: { 110: 4000 } });
  assert.deepEqual({ ...JSON.parse(output()), host_s: 0 }, { ...expected, host_s: 0 });
}

/** Python with the packages that tests/senders/install has installed. */
const PYTHON = join(root, "target/tools/senders/python/bin/python");

/** The example programs call the module without a browser and get the same values. */
export async function examples_of_programs_call_the_module() {
  const callers = [["node", "module.mjs"], [PYTHON, "module.py"]];
  const runs = ([by, caller], ...rest) => spawnSync(by, [join(root, "examples", caller), wasm, ...rest], { encoding: "utf8", maxBuffer: 1 << 26 });
  for (const caller of callers) {
    if (caller[0] === PYTHON && !existsSync(PYTHON)) {
      console.log("skipped: examples/module.py (bash tests/senders/install)");
      continue;
    }
    const good = runs(caller, join(root, "examples/house.nc"), "110=4000");
    assert.equal(good.status, 0, good.stderr);
    same(JSON.parse(good.stdout), run("house.nc", example("house.nc"), { board: "blackpill_f411", settings: { 110: 4000 } }), caller[1]);
    const bad = join(folder, "module.nc");
    writeFileSync(bad, "G21\nG999\n");
    const refused = runs(caller, bad);
    assert.deepEqual([refused.status, JSON.parse(refused.stdout).errors[0].line], [1, 2]);
    const wrong = runs(caller, bad, "7=1");
    assert.deepEqual([wrong.status, wrong.stdout], [2, ""]);
    assert.match(wrong.stderr, /was refused with error:3/);
    for (const more of [[join(folder, "none.nc")], [bad, "110"], [bad, "110=x"], [bad, "110="], []]) {
      const { status, stdout } = runs(caller, ...more);
      assert.deepEqual([status, stdout], [2, ""], `${caller[1]} ${more}`);
    }
    assert.equal(spawnSync(caller[0], [join(root, "examples", caller[1]), bad, bad], { stdio: "ignore" }).status, 2);
  }
}

export async function each_setting_is_described() {
  const { x, output } = await instance();
  assert.equal(x.oxmill_describe(), 0);
  const { settings } = JSON.parse(output());
  assert(settings.length > 80, `${settings.length}`);
  for (const setting of settings) {
    assert.deepEqual(Object.keys(setting).sort(), ["axis", "default", "explanation", "grbl", "group", "kind", "labels", "max", "min", "name", "number", "title", "unit", "values"]);
    assert.match(setting.explanation, /^[A-Z].{20,}\.$/, `$${setting.number}`);
  }
}

export async function settings_of_other_controllers_are_read() {
  const { x, put, output } = await instance();
  put(encode("$10=511\n$100=80.5\n$481=0\n"));
  assert.equal(x.oxmill_import(), 0, output());
  const result = JSON.parse(output());
  assert.deepEqual([result.what, result.taken.map(({ number, value }) => [number, value])], ["grblHAL", [[10, 3], [100, 80.5]]]);
  assert.deepEqual(result.left.map(({ text, line }) => [text, line]), [["$481=0", 3]]);
  put(encode("M92 X80\n"));
  assert.equal(x.oxmill_import(), 1);
  assert.match(output(), /neither the output of \$\$/);
}

export async function refusals_and_panics_have_a_text() {
  const { x, put, output } = await instance();
  for (const [order, why] of [["{", "not understood"], ['{"board":"toaster"}', "the boards are"], ['{"settings":{"7":1}}', "error:3"]]) {
    put(encode(`${order}\0G0 X0\n`));
    assert.equal(x.oxmill_check_begin(), 1);
    assert.match(output(), new RegExp(why));
  }
  // A panic leaves its text, both after other calls and in the first call of an instance.
  for (const one of [x, (await instance()).x]) {
    assert.throws(() => one.oxmill_fail(), WebAssembly.RuntimeError);
    const text = () => new TextDecoder().decode(new Uint8Array(one.memory.buffer, one.oxmill_panic(), one.oxmill_panic_len()));
    assert.match(text(), /oxmill_fail was called/);
    // The instance has ended: each further call traps instead of answering.
    assert.throws(() => one.oxmill_describe(), WebAssembly.RuntimeError);
    assert.match(text(), /already.*borrowed/);
  }
}

export async function the_page_is_one_file_with_a_policy() {
  const html = readFileSync(page, "utf8");
  assert.match(html, /Content-Security-Policy[^>]*default-src 'none'[^>]*connect-src 'none'/);
  assert(!/<(script|link|img|iframe)[^>]+(src|href)="(?!data:)/.test(html.replace(/<script>[^]*?<\/script>/g, "")), "nothing is loaded");
}
