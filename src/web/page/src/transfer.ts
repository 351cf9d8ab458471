// Settings of the machine that is driven, and those of the forecast: which of them differ, and how they go to the machine.
import type { Setting } from "./engine";

/** What a machine tells of a value has this many decimals at least: a smaller difference cannot be seen. */
const DECIMALS = 3;

export interface Difference { setting: Setting; there: number; here: number }

/** Settings that both have, with other values. */
export function differences(table: Setting[], there: Record<string, number>, here: (number: number) => number): Difference[] {
  const all = table.filter(({ number }) => number in there).map(setting => ({ setting, there: there[setting.number], here: here(setting.number) }));
  return all.filter(one => Math.abs(one.there - one.here) > 0.5 * 10 ** -DECIMALS + 1e-9);
}

/** Writes settings, and says what became of them. One may have to wait for another, as soft limits for homing: what is refused is tried once more behind the rest. */
export async function written(lines: string[], write: (line: string) => Promise<string>): Promise<string> {
  let left = lines;
  for (let tries = 0; tries < 2; tries++) {
    const refused: string[] = [];
    for (const line of left) {
      const answer = await write(line);
      // A machine that was reset, or is in an alarm, is written no further.
      if (answer !== "ok" && !answer.startsWith("error:")) return `The machine has stopped it: ${answer}. Look at the differences again.`;
      if (answer !== "ok") refused.push(line);
    }
    left = refused;
  }
  const done = `${lines.length - left.length} of ${lines.length} settings are written.`;
  return left.length ? `${done} Refused: ${left.join(", ")}` : done;
}
