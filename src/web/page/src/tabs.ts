// Tabs as the accessibility guidelines describe them: arrow keys move, one panel is shown.

export function tabs(): void {
  const all = [...document.querySelectorAll<HTMLElement>("[role=tab]")];
  const choose = (tab: HTMLElement) => {
    for (const one of all) {
      const chosen = one === tab;
      one.setAttribute("aria-selected", String(chosen));
      one.tabIndex = chosen ? 0 : -1;
      (document.getElementById(one.getAttribute("aria-controls") ?? "") as HTMLElement).hidden = !chosen;
    }
    tab.focus();
  };
  for (const [index, tab] of all.entries()) {
    tab.addEventListener("click", () => choose(tab));
    tab.addEventListener("keydown", event => {
      const step = { ArrowRight: 1, ArrowLeft: -1 }[event.key];
      if (step) choose(all[(index + step + all.length) % all.length]);
    });
  }
}
