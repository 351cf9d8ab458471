// The service worker of the site: stores the page for offline use. Each version of the page has its own service worker
// file.
export {};

interface Extended extends Event { waitUntil(done: Promise<unknown>): void }
interface Fetched extends Event { request: Request; respondWith(answer: Promise<Response>): void }
const worker = globalThis as unknown as { skipWaiting(): Promise<void>; clients: { claim(): Promise<void> }; addEventListener(kind: string, call: (event: Event) => void): void };

/** A hash of the site's files: each version of the page has another one. */
declare const VERSION: string;
declare const FILES: string[];
const PREFIX = "oxmill-";
const kept = `${PREFIX}${VERSION}`;

worker.addEventListener("install", event => {
  // Load the files from the server. The browser's cache may have them from an earlier version.
  const all = FILES.map(file => new Request(file, { cache: "reload" }));
  (event as Extended).waitUntil(caches.open(kept).then(cache => cache.addAll(all)).then(() => worker.skipWaiting()));
});

worker.addEventListener("activate", event => {
  const old = caches.keys().then(names => Promise.all(names.filter(other => other.startsWith(PREFIX) && other !== kept).map(other => caches.delete(other))));
  (event as Extended).waitUntil(old.then(() => worker.clients.claim()));
});

worker.addEventListener("fetch", event => {
  const { request } = event as Fetched;
  const answer = caches.open(kept).then(cache => cache.match(request, { ignoreSearch: true }));
  (event as Fetched).respondWith(answer.then(found => found ?? fetch(request)));
});
