// Helpers for elements of the page, and formatting of figures for users.

export const $ = <T extends HTMLElement = HTMLElement>(id: string): T => {
  const found = document.getElementById(id);
  if (!found) throw new Error(`the page has no #${id}`);
  return found as T;
};

type Child = Node | string;

/** Makes an element with properties and children. Names with a hyphen, `role` and `for` are set as attributes. */
export function el<K extends keyof HTMLElementTagNameMap>(tag: K, more: Record<string, unknown> = {}, ...children: Child[]): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(more)) {
    if (name.includes("-") || name === "role" || name === "for") made.setAttribute(name, String(value));
    else (made as unknown as Record<string, unknown>)[name] = value;
  }
  made.append(...children);
  return made;
}

/** Makes a button that calls `act` when it is clicked. */
export function button(text: string, act: () => void, className = "btn"): HTMLButtonElement {
  const made = el("button", { type: "button", className, textContent: text });
  made.addEventListener("click", act);
  return made;
}

/** Makes an icon. `name`: its id in the page without `i-`. `size`: a further CSS class. */
export function icon(name: string, size = ""): SVGSVGElement {
  const made = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  made.setAttribute("class", `ic ${size}`.trim());
  const use = document.createElementNS("http://www.w3.org/2000/svg", "use");
  use.setAttribute("href", `#i-${name}`);
  made.append(use);
  return made;
}

/** Calls `act` when the element with this id is clicked. */
export const onclick = (id: string, act: () => void): void => $(id).addEventListener("click", act);

/** Shows a text if it differs from the present one: unchanged elements cost the browser nothing. */
export function say(where: string | HTMLElement, text: string): void {
  const shown = typeof where === "string" ? $(where) : where;
  if (shown.textContent !== text) shown.textContent = text;
}

/** Disables a control and shows the reason; without a reason, enables it. */
export function allow(control: HTMLElement, why?: string, hint = ""): void {
  const off = why !== undefined;
  if ((control as HTMLButtonElement).disabled !== off) (control as HTMLButtonElement).disabled = off;
  if (control.title !== (why ?? hint)) control.title = why ?? hint;
}

/** Marks the chosen button of a group as pressed (`aria-pressed`), and the others as not pressed. */
export function press(buttons: Iterable<Element>, chosen: (button: HTMLElement) => boolean): void {
  for (const one of buttons) {
    const pressed = String(chosen(one as HTMLElement));
    if (one.getAttribute("aria-pressed") !== pressed) one.setAttribute("aria-pressed", pressed);
  }
}

/** Formats a duration with units, such as `12.34 s`, `2 min 3 s` or `1 h 2 min 3 s`. */
export function clock(seconds: number): string {
  if (seconds < 60) return `${seconds.toFixed(2)} s`;
  const whole = Math.round(seconds);
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, whole % 60];
  return h ? `${h} h ${m} min ${s} s` : `${m} min ${s} s`;
}

/** Formats a duration like a clock, such as `2:03` or `1:02:03`. */
export function minutes(seconds: number): string {
  const whole = Math.max(0, Math.round(seconds));
  const [h, m, s] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60, String(whole % 60).padStart(2, "0")];
  return h ? `${h}:${String(m).padStart(2, "0")}:${s}` : `${m}:${s}`;
}

/** A number with a noun, in the plural where needed, such as `3 lines`. */
export const count = (number: number, name: string): string => `${number.toLocaleString("en")} ${name}${number === 1 ? "" : "s"}`;

export const css = (name: string): string => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** Returns a colour of the style sheet as three numbers from 0 to 1. */
export function rgb(name: string): [number, number, number] {
  const hex = css(name).replace("#", "");
  return [0, 2, 4].map(at => parseInt(hex.slice(at, at + 2), 16) / 255) as [number, number, number];
}

/** Makes the browser save a file with this name and contents, as a download. */
export function save(name: string, contents: string | Uint8Array): void {
  const type = typeof contents === "string" ? "text/plain" : "application/octet-stream";
  const link = el("a", { href: URL.createObjectURL(new Blob([contents as BlobPart], { type })), download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

/** Returns the number that the user has typed into a field, if it is one. A comma counts as a decimal point. */
export function typed(id: string): number | undefined {
  const text = $<HTMLInputElement>(id).value.trim().replace(",", ".");
  const value = Number(text);
  return text !== "" && Number.isFinite(value) ? value : undefined;
}
