// Tabs according to the accessibility guidelines: arrow keys switch between tabs, and only the panel of the chosen tab
// is visible.
import { $ } from "./dom";

const all = (list: HTMLElement): HTMLElement[] => [...list.querySelectorAll<HTMLElement>("[role=tab]")];

/** Shows the panel of a tab. */
export function choose(id: string): void {
  for (const one of all($(id).closest("[role=tablist]") as HTMLElement)) {
    const chosen = one.id === id;
    one.setAttribute("aria-selected", String(chosen));
    one.tabIndex = chosen ? 0 : -1;
    $(one.getAttribute("aria-controls") ?? "").hidden = !chosen;
    if (chosen) one.dispatchEvent(new CustomEvent("chosen", { bubbles: true, detail: id }));
  }
}

export function tabs(id: string): void {
  const list = $(id);
  for (const tab of all(list)) {
    tab.tabIndex = tab.getAttribute("aria-selected") === "true" ? 0 : -1;
    tab.addEventListener("click", () => choose(tab.id));
    tab.addEventListener("keydown", event => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (!step) return;
      event.preventDefault();
      const seen = all(list).filter(one => one.offsetParent !== null);
      const next = seen[(seen.indexOf(tab) + step + seen.length) % seen.length];
      choose(next.id);
      next.focus();
    });
  }
}
