// The screenshots of the README must match this page. Pixels differ between browsers, so the texts of the page and the
// sources of its look are compared.
import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { join } from "node:path";
import { FOLDER, look, ready, SCENES, sha256, TAKEN } from "./scenes.mjs";

const AGAIN = "take the screenshots again, and look at them: cargo xtask web --pictures";

export async function screenshots_are_of_this_page(browser) {
  const taken = JSON.parse(readFileSync(TAKEN, "utf8"));
  assert.deepEqual(Object.keys(taken.pictures), Object.keys(SCENES), AGAIN);
  assert.equal(taken.look, look(), `style or drawing have changed: ${AGAIN}`);
  for (const [name, scene] of Object.entries(SCENES)) {
    assert.equal(sha256(readFileSync(join(FOLDER, name))), taken.pictures[name].sha256, `${name} is another picture: ${AGAIN}`);
    const { page, says } = await ready(browser, scene);
    assert.deepEqual(says, taken.pictures[name].says, `${name}: ${AGAIN}`);
    await page.context().close();
  }
}
