// The list of the job's lines; only visible lines are in the document. A line can be edited.
import { $, allow, el, onclick, save } from "./dom";
import type { Page } from "./page";

/** Height of a line, px. */
const LINE = 22;
/** Maximum height of an element that browsers draw, px. */
const TALLEST = 15_000_000;

export class Program {
  /** Called with a line that the user clicks. */
  onpick: (line: number) => void = () => {};
  /** Called with a line and its new text. */
  onedit: (line: number, text: string) => void = () => {};
  refused = new Set<number>();
  warned = new Set<number>();
  /** Why editing is disabled, if it is. */
  locked?: string;
  private line = 0;
  /** Number of the last line that was sent to the machine; 0 without a machine. The machine still executes `line`, and
   * has received the lines up to `sent`. */
  private sent = 0;
  private editing = 0;
  private readonly list = $("lines");

  constructor(private readonly page: Page) {
    const { list } = this;
    list.addEventListener("scroll", () => this.draw());
    new ResizeObserver(() => this.draw()).observe(list);
    list.addEventListener("click", event => {
      const line = (event.target as HTMLElement).closest<HTMLElement>("[data-line]")?.dataset.line;
      if (line && !(event.target instanceof HTMLInputElement)) this.onpick(Number(line));
    });
    list.addEventListener("dblclick", event => {
      const line = (event.target as HTMLElement).closest<HTMLElement>("[data-line]")?.dataset.line;
      if (line) this.edit(Number(line));
    });
    list.addEventListener("keydown", event => {
      if (event.target !== list) return;
      if (event.key === "Enter") return this.edit(this.line);
      const step = { ArrowDown: 1, ArrowUp: -1, PageDown: 5, PageUp: -5, Home: -Infinity, End: Infinity }[event.key];
      if (!step) return;
      event.preventDefault();
      event.stopPropagation();
      this.onpick(Math.max(1, Math.min(page.job.lines.length, this.line + step)));
    });
    onclick("edit-line", () => this.edit(this.line));
    onclick("save-job", () => save(page.job.name, page.job.text));
  }

  /** Shows another job, or a changed text of the job. */
  show(): void {
    ($("lines-all") as HTMLElement).style.height = `${Math.min(TALLEST, this.page.job.lines.length * LINE)}px`;
    this.editing = 0;
    this.draw();
  }

  top(): void {
    this.list.scrollTop = 0;
  }

  /** Marks a line. `sent`: number of the last line that was sent, while the machine runs the job; otherwise 0.
   * `follow`: `true` scrolls to the line. */
  mark(line: number, sent = 0, follow = true): void {
    [this.line, this.sent] = [line, sent];
    if (follow) this.scrollTo(line || 1);
    this.draw();
  }

  private edit(line: number): void {
    if (line < 1 || line > this.page.job.lines.length || this.locked) return;
    this.editing = line;
    this.scrollTo(line);
    this.draw();
    const input = $("lines-all").querySelector("input");
    input?.focus();
    input?.setSelectionRange(input.value.length, input.value.length);
  }

  private endEdit(text?: string): void {
    const line = this.editing;
    if (!line) return;
    this.editing = 0;
    if (text !== undefined && text !== this.page.job.lines[line - 1]) this.onedit(line, text);
    this.draw();
    this.list.focus();
  }

  private scrollTo(line: number): void {
    const at = (line - 1) * LINE * this.scale();
    const { scrollTop, clientHeight } = this.list;
    if (at < scrollTop || at + LINE > scrollTop + clientHeight) this.list.scrollTop = at - clientHeight / 2 + LINE / 2;
  }

  /** Returns the scale of the list. It is below 1 if the list at full height would be taller than browsers draw. */
  private scale(): number {
    return Math.min(1, TALLEST / Math.max(1, this.page.job.lines.length * LINE));
  }

  draw(): void {
    const { lines } = this.page.job;
    const first = Math.max(0, Math.floor(this.list.scrollTop / LINE / this.scale()) - 1);
    const digits = String(lines.length).length;
    const all = $("lines-all");
    const drawn = new Map([...all.children].map(line => [line.id, line as HTMLElement]));
    const shown = lines.slice(first, first + Math.ceil(this.list.clientHeight / LINE) + 3).map((text, index) => {
      const number = first + index + 1;
      const id = `line-${number}`;
      const line = drawn.get(id) ?? el("div", { role: "option", id });
      const ahead = this.sent > 0 && number > this.line && number <= this.sent;
      const name = this.refused.has(number) ? "line refused" : this.warned.has(number) ? "line warned" : ahead ? "line sent" : "line";
      if (line.className !== name) line.className = name;
      line.setAttribute("aria-selected", String(number === this.line));
      const note = number === this.line && this.sent > 0 ? "machine is here" : number === this.sent && ahead ? "sent up to here" : "";
      this.fill(line, number, digits, text, note);
      line.style.top = `${first * LINE * this.scale() + index * LINE}px`;
      line.dataset.line = String(number);
      return line;
    });
    // Keep visible elements in the document: a browser reports no click if the pressed element is removed before the
    // release.
    for (const line of drawn.values()) if (!shown.includes(line)) line.remove();
    for (const [index, line] of shown.entries()) if (all.children[index] !== line) all.insertBefore(line, all.children[index] ?? null);
    if (shown.some(line => line.id === `line-${this.line}`)) this.list.setAttribute("aria-activedescendant", `line-${this.line}`);
    else this.list.removeAttribute("aria-activedescendant");
    allow($("edit-line"), this.locked ?? (this.line > 0 ? undefined : "Choose a line first."), "Or press Enter, or click it twice");
  }

  private fill(line: HTMLElement, number: number, digits: number, text: string, note: string): void {
    const key = `${this.editing === number}${note}${text}`;
    if (line.dataset.shown === key) return;
    line.dataset.shown = key;
    const label = el("span", { textContent: String(number).padStart(digits) });
    if (this.editing === number) {
      const input = el("input", { type: "text", value: text, spellcheck: false, "aria-label": `Line ${number}` });
      input.addEventListener("keydown", event => {
        event.stopPropagation();
        if (event.key === "Enter") this.endEdit(input.value);
        if (event.key === "Escape") this.endEdit();
      });
      input.addEventListener("blur", () => this.endEdit(input.value));
      return line.replaceChildren(label, input);
    }
    line.replaceChildren(label, document.createTextNode(text), ...(note ? [el("em", { textContent: note })] : []));
  }
}
