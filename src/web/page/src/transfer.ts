// Settings of the connected machine and of the forecast: finds the differences and writes them to the machine.
import type { Setting } from "./engine";

/** Minimum number of decimals with which machines report a value. Smaller differences can come from rounding, so they
 * do not count. */
const DECIMALS = 3;

export interface Difference { setting: Setting; there: number; here: number }

/** Returns the settings of the table whose values in the machine (`there`) and in the forecast (`here`) differ. */
export function differences(table: Setting[], there: Record<string, number>, here: (number: number) => number): Difference[] {
  const all = table.filter(({ number }) => number in there).map(setting => ({ setting, there: there[setting.number], here: here(setting.number) }));
  return all.filter(one => Math.abs(one.there - one.here) > 0.5 * 10 ** -DECIMALS + 1e-9);
}

/** Writes settings and returns a summary. A setting may depend on another one: soft limits need homing. So rejected
 * settings are tried once more after the others. */
export async function written(lines: string[], write: (line: string) => Promise<string>): Promise<string> {
  let left = lines;
  for (let tries = 0; tries < 2; tries++) {
    const refused: string[] = [];
    for (const line of left) {
      const answer = await write(line);
      // An answer that is neither `ok` nor an error comes from this page's sender: the machine was reset, or the line
      // could not be sent. Stop writing.
      if (answer !== "ok" && !answer.startsWith("error:")) return `The machine has stopped it: ${answer}. Look at the differences again.`;
      if (answer !== "ok") refused.push(line);
    }
    left = refused;
  }
  const done = `${lines.length - left.length} of ${lines.length} settings are written.`;
  return left.length ? `${done} Refused: ${left.join(", ")}` : done;
}
