// A site that carries images of boards, for the tests.
import { readFileSync } from "node:fs";
import { createServer } from "node:http";
import { join } from "node:path";
import { root } from "./program.mjs";

/** The real image of a board, as `cargo fw` has made it. */
export const BLACKPILL = readFileSync(join(root, "target/boards/blackpill_f411.dfu"));

/** Serves the page as a site that lists four images. One of them is missing, one is that of another board, and one is
 * sent only when `release` is called. */
export async function site(list) {
  const images = ["blackpill_f411", "spider_f446", "octopus_f446", "skr2_f407"].map(board => ({ board, title: `Board ${board}` }));
  const files = {
    "/": ["text/html; charset=utf-8", readFileSync(join(root, "target/web/site/index.html"))],
    "/offline.js": ["text/javascript", readFileSync(join(root, "target/web/site/offline.js"))],
    "/firmware.json": ["application/json", list ?? JSON.stringify(images)],
    "/firmware/blackpill_f411.dfu": ["application/octet-stream", BLACKPILL],
    "/firmware/octopus_f446.dfu": ["application/octet-stream", BLACKPILL],
    "/firmware/skr2_f407.dfu": ["application/octet-stream", BLACKPILL],
  };
  let release;
  const released = new Promise(resolve => (release = resolve));
  const server = createServer(async (request, response) => {
    const [type, bytes] = files[request.url] ?? ["text/plain", ""];
    if (/skr2/.test(request.url)) await released;
    response.writeHead(request.url in files ? 200 : 404, { "content-type": type });
    response.end(bytes);
  });
  await new Promise(listening => server.listen(0, "127.0.0.1", listening));
  return { url: `http://127.0.0.1:${server.address().port}/`, release, stop: () => server.close(() => {}) };
}
