// The settings that a forecast is made with, from the firmware's own table: number, name, unit and range are never written here again.
import type { Description, Setting } from "./engine";
import type { Values } from "./page";
import { type Preset, PRESETS } from "./presets";

const STORED = "oxmill settings";
const STORED_PRESET = "oxmill machine";

/** `$$` of a machine as numbers and values. */
export function parseSettings(text: string): Record<string, number> {
  return Object.fromEntries([...text.matchAll(/^\s*\$(\d+)=(-?[\d.]+)(?=[\s(;]|$)/gm)].map(match => [match[1], Number(match[2])]));
}

export class Settings implements Values {
  /** The machine that was chosen. */
  preset: Preset;
  /** Work zero in mm of machine coordinates, for a machine that is homed before its job. */
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

  /** Whether a person has chosen a machine here before. */
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

  /** What the preset has. */
  presetValue(number: number): number {
    return this.preset.values[number] ?? this.default(number) ?? 0;
  }

  isChanged(number: number): boolean {
    return this.value(number) !== this.presetValue(number);
  }

  /** Numbers that differ from the preset. */
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

  /** Another machine, with its settings. */
  choose(id: string): void {
    this.preset = PRESETS.find(preset => preset.id === id) ?? this.preset;
    this.replace(this.preset.values);
  }

  default(number: number): number | undefined {
    return this.table.get(number)?.default;
  }

  /** Those that this firmware has, and that differ from a new controller: another page may have kept others. */
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
      // A page without storage forgets.
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
