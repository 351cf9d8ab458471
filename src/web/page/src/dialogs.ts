// Dialogs. They are not modal: the bar with Stop stays above them.
import { $, button, el } from "./dom";

export class Dialog {
  readonly element: HTMLElement;
  /** While `true`, `close` has no effect, for example while firmware is loaded. */
  isHeld = false;
  private before?: HTMLElement;

  constructor(id: string, title: string, body: (Node | string)[], wide = false) {
    const heading = el("h2", { id: `${id}-title`, textContent: title });
    this.element = el("div", { id, className: wide ? "dialog wide" : "dialog", role: "dialog", hidden: true, tabIndex: -1, "aria-labelledby": heading.id }, heading, ...body);
    $("dialogs").append(this.element);
    dialogs.push(this);
  }

  get isOpen(): boolean {
    return !this.element.hidden;
  }

  open(): void {
    closeDialogs();
    this.before = document.activeElement as HTMLElement;
    this.element.hidden = false;
    $("scrim").hidden = false;
    const fields = [...this.element.querySelectorAll<HTMLElement>("input:not(:disabled), select, textarea")];
    (fields.find(field => field.checkVisibility()) ?? this.element).focus();
  }

  close(): void {
    if (!this.isOpen || this.isHeld) return;
    this.element.hidden = true;
    $("scrim").hidden = true;
    this.before?.focus();
  }

  /** Appends the row of buttons. The first one closes the dialog: it is called Close if it is alone, otherwise Cancel.
   * */
  actions(...more: Node[]): HTMLElement {
    const row = el("div", { className: "actions-row" }, button(more.length ? "Cancel" : "Close", () => this.close()), ...more);
    this.element.append(row);
    return row;
  }
}

const dialogs: Dialog[] = [];

export const openDialog = (): Dialog | undefined => dialogs.find(dialog => dialog.isOpen);

export function closeDialogs(): void {
  for (const dialog of dialogs) dialog.close();
}

export function listenToDialogs(): void {
  $("scrim").addEventListener("click", closeDialogs);
}
