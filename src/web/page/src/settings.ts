// The settings of the forecast. Numbers, names, units and ranges come from the firmware's own table and are not
// repeated here.
import type { Description, Setting } from "./engine";
import type { Values } from "./page";
import { type Preset, PRESETS } from "./presets";

const STORED = "oxmill settings";
const STORED_PRESET = "oxmill machine";

/** Parses the output of `$$` into numbers and values. In grblHAL's dialect (`$900=3`), the values of `$10` and `$22`
 * have more bits than Oxmill's settings. The additional bits are dropped. */
export function parseSettings(text: string): Record<string, number> {
  const values: Record<string, number> =
    Object.fromEntries([...text.matchAll(/^\s*\$(\d+)=(-?[\d.]+)(?=[\s(;]|$)/gm)].map(match => [match[1], Number(match[2])]));
  if (values[900] === 3) {
    for (const [number, own] of [[10, 3], [22, 1]]) if (number in values) values[number] &= own;
  }
  return values;
}

export class Settings implements Values {
  /** The chosen machine. */
  preset: Preset;
  /** Work zero X, Y, Z in mm of machine coordinates. If all are given, the machine is homed before its job. */
  zero: (number | undefined)[] = [undefined, undefined, undefined];
  private changed: Record<string, number>;
  private readonly table: Map<number, Setting>;
  private readonly listeners: (() => void)[] = [];

  constructor(description: Description) {
    this.table = new Map(description.settings.map(setting => [setting.number, setting]));
    const kept = stored(STORED);
    this.preset = PRESETS.find(({ id }) => id === stored(STORED_PRESET)) ?? PRESETS[0];
    this.changed = this.known(Object(kept ?? this.preset.values));
  }

  /** `true` if this browser has settings from an earlier visit. */
  get isKept(): boolean {
    return stored(STORED) !== null;
  }

  onchange(call: () => void): void {
    this.listeners.push(call);
  }

  values(): Record<string, number> {
    return { ...this.changed };
  }

  value(number: number): number {
    return this.changed[number] ?? this.default(number) ?? 0;
  }

  /** Returns the preset's value of a setting. */
  presetValue(number: number): number {
    return this.preset.values[number] ?? this.default(number) ?? 0;
  }

  isChanged(number: number): boolean {
    return this.value(number) !== this.presetValue(number);
  }

  /** Returns the numbers of the settings that differ from the preset. */
  changes(): number[] {
    return [...this.table.keys()].filter(number => this.isChanged(number));
  }

  workZero(): number[] | undefined {
    return this.zero.every(value => value !== undefined) ? (this.zero as number[]) : undefined;
  }

  setZero(zero: (number | undefined)[]): void {
    this.zero = zero;
    this.tell();
  }

  replace(values: Record<string, number>): void {
    this.changed = this.known(values);
    this.keep();
    this.tell();
  }

  set(number: number, value: number): void {
    this.replace({ ...this.changed, [number]: value });
  }

  /** Selects another machine with its settings. */
  choose(id: string): void {
    this.preset = PRESETS.find(preset => preset.id === id) ?? this.preset;
    this.replace(this.preset.values);
  }

  default(number: number): number | undefined {
    return this.table.get(number)?.default;
  }

  /** Returns `values` without default values and without settings that this firmware does not have. Another version of
   * the page may have stored such settings. */
  private known(values: Record<string, number>): Record<string, number> {
    const entries = Object.entries(values).filter(([number, value]) => Number.isFinite(value) && this.default(Number(number)) !== undefined);
    return Object.fromEntries(entries.filter(([number, value]) => value !== this.default(Number(number))));
  }

  private tell(): void {
    for (const call of this.listeners) call();
  }

  private keep(): void {
    try {
      localStorage.setItem(STORED, JSON.stringify(this.changed));
      localStorage.setItem(STORED_PRESET, JSON.stringify(this.preset.id));
    } catch {
      // Without storage, the settings are lost when the page is closed.
    }
  }
}

function stored(name: string): unknown {
  try {
    return JSON.parse(localStorage.getItem(name) ?? "null");
  } catch {
    return null;
  }
}
