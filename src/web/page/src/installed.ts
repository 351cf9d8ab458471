// The page as an app that a browser has installed from a site: it works offline, and G-code files open in it.

interface Launched { files: readonly { getFile(): Promise<File> }[] }
interface LaunchQueue { setConsumer(call: (launched: Launched) => void): void }

/** Lets the site's service worker store the page for offline use. The single-file page has no service worker. */
export function keepOffline(): void {
  const script = document.querySelector<HTMLMetaElement>("meta[name=oxmill-offline]")?.content;
  // Browsers have no `serviceWorker` for a page that came from another computer by http.
  if (script) navigator.serviceWorker?.register(script).catch(error => console.warn(`not kept for times without a network: ${error}`));
}

/** Calls `call` with each file that the system opens with the app. */
export function onlaunch(call: (file: File) => Promise<void>): void {
  const queue = (globalThis as unknown as { launchQueue?: LaunchQueue }).launchQueue;
  queue?.setConsumer(async ({ files: [handle] }) => {
    if (handle) await call(await handle.getFile());
  });
}
