// Takes the screenshots of the README in headless Chromium, and records what they were taken of.
import { writeFileSync } from "node:fs";
import { join } from "node:path";
import { launch } from "./browser.mjs";
import { FOLDER, look, ready, SCENES, sha256, TAKEN } from "./scenes.mjs";

const browser = await launch();
const pictures = {};
for (const [name, scene] of Object.entries(SCENES)) {
  const { page, says } = await ready(browser, scene);
  await scene.go(page);
  // Wait until the view is at rest and shows all of a long path.
  await page.waitForTimeout(1500);
  const picture = await page.screenshot();
  writeFileSync(join(FOLDER, name), picture);
  pictures[name] = { sha256: sha256(picture), says };
  console.log(`docs/pictures/${name}`);
}
writeFileSync(TAKEN, `${JSON.stringify({ look: look(), pictures }, undefined, 1)}\n`);
await browser.close();
