// Finds cutters that a CAM program has described in comments.
import type { Cutter } from "./material";

/** Number of lines from the start that are searched. */
const HEAD = 4000;

/** Words that occur beside the size of a cutter. */
const CUTTER = /\bD(?:ia(?:meter)?)?\.?\s*[=:]|\bDia|Ø|mill\b|drill|cutter|\bbit\b|ball|flat|flute|\btool\b|\bT\s*#?\d/i;

/** The text of a line's comments, without their delimiters. */
const comments = (line: string): string => [...line.matchAll(/\(([^)]*)\)|;(.*)$/g)].map(found => found[1] ?? found[2]).join(" ");

/** Returns the cutter that a comment describes, if the comment gives its width. */
export function cutterIn(text: string): Cutter | undefined {
  const number = "(\\d+(?:[.,]\\d+)?)";
  const value = (found: RegExpExecArray | null) => (found ? Number(found[1].replace(",", ".")) : undefined);
  const inch = new RegExp(`${number}\\s*(?:in\\b|inch|")`, "i").exec(text);
  const fraction = /\b(\d+)\/(\d+)\s*(?:in\b|inch|")?/i.exec(text);
  // `wide` and `tip` give the width of a pointed cutter's tip, not its diameter.
  const diameter = /\bwide\b|\btip\b/i.test(text) ? undefined : value(new RegExp(`\\bD(?:ia(?:meter)?)?\\.?\\s*[=:]?\\s*${number}`, "i").exec(text))
    ?? (inch ? (value(inch) as number) * 25.4 : fraction ? (Number(fraction[1]) / Number(fraction[2])) * 25.4 : undefined)
    ?? value(new RegExp(`(?:^|\\s|Ø)${number}\\s*mm\\b`, "i").exec(text));
  const angle = value(new RegExp(`${number}\\s*(?:°|deg)`, "i").exec(text)) ?? value(new RegExp(`TAPER\\s*=\\s*${number}`, "i").exec(text));
  const isPointed = angle !== undefined && angle > 0 && angle < 179 && !/drill/i.test(text);
  const isV = /v[- ]?bit|v[- ]?carv/i.test(text) || (isPointed && (CUTTER.test(text) || /engrav|chamfer|\bV\b/i.test(text)));
  const isBall = /ball/i.test(text);
  // A length alone is not sufficient: the comment must also have a word for a cutter.
  if (diameter === undefined ? !(isV && isPointed) : !(isV || CUTTER.test(text))) return undefined;
  const width = diameter ?? 6;
  if (!(width > 0 && width <= 1000)) return undefined;
  return { shape: isV ? "v" : isBall ? "ball" : "flat", diameter: width, angle: isV && angle !== undefined && angle > 0 ? Math.min(179, angle) : 60 };
}

/** Returns the cutters by tool number. If a comment names a tool, it describes the cutter of that tool. Otherwise it
 * describes the cutter of the next tool change. */
export function cuttersOf(lines: string[]): Record<number, Cutter> {
  const found: Record<number, Cutter> = {};
  let last: Cutter | undefined;
  for (const line of lines.slice(0, HEAD)) {
    const text = comments(line);
    const cutter = text ? cutterIn(text) : undefined;
    const named = /\bT(?:ool)?\s*[#:]?\s*(\d+)\b/i.exec(text);
    if (cutter && named) found[Number(named[1])] ??= cutter;
    else if (cutter) last = cutter;
    const code = line.replace(/\([^)]*\)|;.*$/g, "");
    const change = /\bT(\d+)\b/i.exec(code);
    if (change && last) {
      found[Number(change[1])] ??= last;
      last = undefined;
    }
  }
  // Without a tool change there is one cutter, that of tool 0.
  if (Object.keys(found).length === 0 && last) found[0] = last;
  return found;
}
