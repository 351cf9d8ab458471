// Reads settings of other controllers: the output of `$$` of Grbl and grblHAL, and configuration files of FluidNC.
// Reports what each line becomes.
import type { Setting } from "./engine";

export interface Taken { number: number; value: number; from: string }
export interface Import {
  what: string;
  taken: Taken[];
  /** Lines that are not imported, each with the reason. */
  left: { text: string; why: string }[];
}

/** Numbers from here on are Oxmill's own settings. */
const OWN = 900;
/** Settings that are on or off in Oxmill, but bit masks in grblHAL, whose bit 0 is on or off. */
const FIRST_BIT = new Set([21, 22]);
/** Settings that are left out because they affect only the reports or the wiring of another board, with the reason. */
const OF_THE_BOARD = new Map([[10, "it decides on reports only"], [37, "another board's wiring"]]);

export function readImport(text: string, table: Setting[]): Import {
  return /^\s*axes:\s*$/m.test(text) ? fluidNc(text) : dump(text, table);
}

function dump(text: string, table: Setting[]): Import {
  const known = new Map(table.map(setting => [setting.number, setting]));
  const rows = [...text.matchAll(/^\s*\$(\d+)=([^\r\n]*)/gm)].map(found => ({ number: Number(found[1]), written: found[2].trim(), line: found[0].trim() }));
  const hal = rows.some(({ number }) => number > 132 && number < OWN && !known.has(number)) && !rows.some(({ number }) => number >= OWN);
  const made: Import = { what: rows.some(({ number }) => number >= OWN) ? "Oxmill" : hal ? "grblHAL" : "Grbl", taken: [], left: [] };
  for (const { number, written, line } of rows) {
    const value = /^-?(\d+\.?\d*|\.\d+)(?=[\s(;]|$)/.exec(written)?.[0];
    const setting = known.get(number);
    if (value === undefined) made.left.push({ text: line, why: "no number" });
    else if (hal && OF_THE_BOARD.has(number)) made.left.push({ text: line, why: OF_THE_BOARD.get(number) as string });
    else if (!setting) made.left.push({ text: line, why: hal ? "grblHAL's own: Oxmill has no such setting" : "no such setting" });
    else {
      const own = hal && FIRST_BIT.has(number) ? Number(value) & 1 : hal && setting.kind === "switch" ? Math.min(1, Number(value)) : Number(value);
      made.taken.push({ number, value: own, from: line });
    }
  }
  return made;
}

/** Keys of an axis in FluidNC's files, with the setting number for X. */
const AXIS_KEYS: Record<string, number> = { steps_per_mm: 100, max_rate_mm_per_min: 110, acceleration_mm_per_sec2: 120, max_travel_mm: 130 };
const KEYS: Record<string, number> = { junction_deviation_mm: 11, arc_tolerance_mm: 12, report_inches: 13 };

/** Reads a FluidNC file. It is YAML; reading its keys and values by indentation is sufficient. */
function fluidNc(text: string): Import {
  const made: Import = { what: "FluidNC", taken: [], left: [] };
  const path: { indent: number; key: string }[] = [];
  let [homingAxes, softAxes, negative] = [0, 0, 0];
  for (const raw of text.split(/\r\n|\r|\n/)) {
    const found = /^(\s*)([A-Za-z_]\w*):\s*(.*?)\s*(?:#.*)?$/.exec(raw);
    if (!found) continue;
    const [indent, key, value] = [found[1].length, found[2], found[3]];
    while (path.length && path[path.length - 1].indent >= indent) path.pop();
    path.push({ indent, key });
    if (value === "") continue;
    const keys = path.map(part => part.key);
    const axis = keys[0] === "axes" && keys.length > 2 ? "xyza".indexOf(keys[1]) : -1;
    const from = `${keys.join("/")}: ${value}`;
    const number = Number(value);
    if (axis >= 0 && keys.length === 3 && key in AXIS_KEYS && Number.isFinite(number)) made.taken.push({ number: AXIS_KEYS[key] + axis, value: number, from });
    else if (axis >= 0 && key === "soft_limits") softAxes |= value === "true" ? 1 << axis : 0;
    else if (axis >= 0 && keys[2] === "homing" && key === "cycle") homingAxes |= number > 0 ? 1 << axis : 0;
    else if (axis >= 0 && keys[2] === "homing" && key === "positive_direction") negative |= value === "false" ? 1 << axis : 0;
    else if (axis === 0 && keys[2] === "homing" && key === "feed_mm_per_min" && Number.isFinite(number)) made.taken.push({ number: 24, value: number, from });
    else if (axis === 0 && keys[2] === "homing" && key === "seek_mm_per_min" && Number.isFinite(number)) made.taken.push({ number: 25, value: number, from });
    else if (axis === 0 && keys.at(-1) === "pulloff_mm" && Number.isFinite(number)) made.taken.push({ number: 27, value: number, from });
    else if (keys.length === 1 && key in KEYS) made.taken.push({ number: KEYS[key], value: value === "true" ? 1 : value === "false" ? 0 : number, from });
    else made.left.push({ text: from, why: "pins and parts of another board" });
  }
  if (homingAxes) made.taken.push({ number: 22, value: 1, from: "axes/…/homing/cycle" }, { number: 23, value: negative, from: "axes/…/homing/positive_direction" });
  if (softAxes && homingAxes) made.taken.push({ number: 20, value: 1, from: "axes/…/soft_limits" });
  return made;
}
