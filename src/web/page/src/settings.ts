// The settings, from the firmware's own table: number, name, unit and range are never written here again.
import { $, el } from "./dom";
import type { Description, Setting } from "./engine";

const STORED = "oxmill settings";

/** `$$` of a machine as numbers and values. */
export function parseSettings(text: string): Record<string, number> {
  return Object.fromEntries([...text.matchAll(/^\s*\$(\d+)=(-?[\d.]+)(?=[\s(;]|$)/gm)].map(match => [match[1], Number(match[2])]));
}

export function rangeOf(setting: Setting): string {
  return [setting.unit === "mask" ? "" : setting.unit, setting.values, `new ${setting.default}`].filter(Boolean).join(", ");
}

export class SettingsPanel {
  private changed: Record<string, number>;
  private readonly inputs = new Map<number, HTMLInputElement>();
  private readonly taken = el("p", { id: "take-note", role: "status" });
  private readonly place = [...$("work-zero").querySelectorAll("input")];

  constructor(readonly description: Description, private readonly onchange: () => void) {
    this.changed = this.known(stored());
    const body = $("settings-table").querySelector("tbody") as HTMLElement;
    // What decides on time comes first.
    const weight = (setting: Setting) => (setting.axis && setting.kind !== "axes" ? 0 : 1);
    const rows = [...description.settings].sort((a, b) => weight(a) - weight(b) || a.number - b.number);
    body.append(...rows.map(setting => this.row(setting)));
    $("find").addEventListener("input", () => this.find($<HTMLInputElement>("find").value));
    $("defaults").addEventListener("click", () => this.replace({}));
    $("take").after(this.taken);
    $("take").addEventListener("click", () => this.take($<HTMLTextAreaElement>("paste").value));
    for (const input of this.place) {
      input.addEventListener("change", () => {
        this.tellPlace();
        this.onchange();
      });
    }
    this.tellPlace();
    this.refresh();
  }

  /** The work zero in mm of machine coordinates, if the machine is homed before its job. */
  workZero(): number[] | undefined {
    return this.place.every(input => input.value !== "") ? this.place.map(input => Number(input.value)) : undefined;
  }

  private tellPlace(): void {
    $("work-zero-note").textContent = this.workZero() ? "The machine is homed before the job: soft limits ($20) act. Homing has to be on ($22)."
      : this.place.some(input => input.value !== "") ? "Not homed: X, Y and Z are needed." : "Not homed: soft limits do not act. Give a place to have it homed before the job.";
  }

  /** Settings that differ from those of a new controller. */
  values(): Record<string, number> {
    return { ...this.changed };
  }

  value(number: number): number {
    return this.changed[number] ?? this.description.settings.find(setting => setting.number === number)?.default ?? 0;
  }

  replace(values: Record<string, number>): void {
    this.changed = this.known(values);
    this.refresh();
    this.onchange();
  }

  /** Takes over what a machine has said, and tells what of it could not be; if that is all, nothing is changed. */
  private take(text: string): void {
    const values = Object.entries(parseSettings(text)).filter(([number, value]) => Number.isFinite(value) && this.default(Number(number)) !== undefined);
    const known = new Set(values.map(([number]) => number));
    const others = [...text.matchAll(/^\s*\$(\d+)=.*$/gm)].filter(match => !known.has(match[1] ?? "")).map(match => match[0].trim());
    this.taken.textContent = (values.length ? `${values.length} settings are taken over.` : "Nothing is taken over: a setting has a line of the form $110=500.")
      + (others.length ? ` Not understood: ${others.join(", ").slice(0, 200)}` : "");
    if (values.length) this.replace(Object.fromEntries(values));
  }

  set(number: number, value: number): void {
    this.replace({ ...this.changed, [number]: value });
  }

  /** Those that this firmware has, and that differ from a new controller: another page may have kept others. */
  private known(values: Record<string, number>): Record<string, number> {
    const entries = Object.entries(values).filter(([number, value]) => Number.isFinite(value) && this.default(Number(number)) !== undefined);
    return Object.fromEntries(entries.filter(([number, value]) => value !== this.default(Number(number))));
  }

  private default(number: number): number | undefined {
    return this.description.settings.find(setting => setting.number === number)?.default;
  }

  private row(setting: Setting): HTMLElement {
    const label = `$${setting.number} ${setting.name}`;
    const input = el("input", { type: "number", step: "any", "aria-label": label });
    input.addEventListener("change", () => {
      if (input.value !== "") this.set(setting.number, Number(input.value));
    });
    this.inputs.set(setting.number, input);
    const row = el("tr", {}, el("th", { scope: "row", textContent: String(setting.number) }),
      el("td", {}, setting.name, el("small", { textContent: rangeOf(setting) }), el("small", { className: "explanation", textContent: setting.explanation })),
      el("td", {}, input));
    row.dataset.text = `${label} ${setting.unit} ${setting.explanation}`.toLowerCase();
    return row;
  }

  private refresh(): void {
    for (const [number, input] of this.inputs) {
      input.value = String(this.value(number));
      input.closest("tr")?.classList.toggle("changed", String(number) in this.changed);
    }
    try {
      localStorage.setItem(STORED, JSON.stringify(this.changed));
    } catch {
      // A page without storage forgets.
    }
  }

  private find(text: string): void {
    for (const input of this.inputs.values()) {
      const row = input.closest("tr") as HTMLElement;
      row.hidden = !(row.dataset.text ?? "").includes(text.toLowerCase());
    }
  }
}

function stored(): Record<string, number> {
  try {
    return Object(JSON.parse(localStorage.getItem(STORED) ?? "{}"));
  } catch {
    return {};
  }
}
