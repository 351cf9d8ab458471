// Machines for forecasts, with the sources of their values.

export interface Preset { id: string; name: string; values: Record<string, number>; source: string }

/** Makes settings from values for X, Y and Z: resolution (steps/mm), maximum rate (mm/min), acceleration (mm/s²) and
 * travel (mm). `more`: other settings. */
function machine(steps: number[], rate: number[], acceleration: number[], travel: number[], more: Record<string, number> = {}): Record<string, number> {
  const each = (first: number, values: number[]) => values.map((value, axis) => [String(first + axis), value]);
  return { ...Object.fromEntries([...each(100, steps), ...each(110, rate), ...each(120, acceleration), ...each(130, travel)]), ...more };
}

export const PRESETS: Preset[] = [
  { id: "3018", name: "3018 router", values: machine([800, 800, 800], [1000, 1000, 600], [30, 30, 30], [300, 180, 45], { 30: 10_000 }),
    source: "Resolution, rates and acceleration: the $$ that 3018 boards print, as their owners have published it; travel: the maker's data (300 × 180 × 45 mm)." },
  { id: "shapeoko3", name: "Shapeoko 3", values: machine([40, 40, 40], [5000, 5000, 5000], [400, 400, 400], [425, 465, 80], { 11: 0.02, 30: 10_000 }),
    source: "Grbl 1.1, defaults.h, DEFAULTS_SHAPEOKO_3." },
  { id: "longmill", name: "LongMill MK2 30×30", values: machine([200, 200, 200], [4000, 4000, 3000], [300, 300, 200], [792, 845, 114.3], { 30: 30_000 }),
    source: "Travel: gSender's list of machines; rates: lists of other programs. The acceleration is assumed (300 and 200 mm/s²): import the $$ of yours." },
  { id: "xcarve", name: "X-Carve 1000 mm", values: machine([40, 40, 188.947], [8000, 8000, 500], [500, 500, 50], [740, 790, 100], { 11: 0.02, 30: 10_000 }),
    source: "Grbl 1.1, defaults.h, DEFAULTS_X_CARVE_1000MM." },
  { id: "printnc", name: "PrintNC", values: machine([160, 160, 1600], [8500, 7000, 180], [400, 400, 100], [420, 420, 20], { 30: 24_000, 31: 6000 }),
    source: "g2core, settings_PrintNC.h: one builder's machine, with a 1 mm screw on Z. It is limited by jerk, so the acceleration is assumed (400 and 100 mm/s²): import the $$ of yours." },
  { id: "new", name: "New Oxmill board", values: {}, source: "What a board has before anything is set: slow and careful." },
];

/** A machine's maximum rate and acceleration, in one line. */
export const summary = (value: (number: number) => number): string => `${value(110).toLocaleString("en")} mm/min · ${value(120).toLocaleString("en")} mm/s²`;
export const travel = (value: (number: number) => number): string => `${[130, 131, 132].map(number => value(number).toLocaleString("en")).join(" × ")} mm`;
