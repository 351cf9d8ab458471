// Millimetres or inches for display and input. Everything else is in millimetres.
export type Unit = "mm" | "inch";

const STORED = "oxmill unit";
const listeners: (() => void)[] = [];
let unit: Unit = stored();

function stored(): Unit {
  try {
    return localStorage.getItem(STORED) === "inch" ? "inch" : "mm";
  } catch {
    return "mm";
  }
}

export const units = {
  get name(): Unit {
    return unit;
  },
  /** Millimetres per unit. */
  get size(): number {
    return unit === "mm" ? 1 : 25.4;
  },
  choose(to: Unit): void {
    unit = to;
    try {
      localStorage.setItem(STORED, to);
    } catch {
      // Without storage, the unit is lost when the page is closed.
    }
    for (const call of listeners) call();
  },
  onchange(call: () => void): void {
    listeners.push(call);
  },
  /** Formats a length for display. */
  length(mm: number, decimals = unit === "mm" ? 3 : 4): string {
    const text = (mm / this.size).toFixed(decimals);
    return Number(text) === 0 ? text.replace("-", "") : text.replace("-", "\u2212");
  },
  /** Converts a typed length to millimetres; `undefined` if it is not a number. */
  parse(text: string): number | undefined {
    const value = Number(text.trim().replace(",", ".").replace("\u2212", "-"));
    return text.trim() !== "" && Number.isFinite(value) ? value * this.size : undefined;
  },
};
