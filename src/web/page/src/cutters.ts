// Cutters that a CAM program has written into its comments.
import type { Cutter } from "./material";

/** Lines from the start that are looked through. */
const HEAD = 4000;

/** Words that stand beside the size of a cutter. */
const CUTTER = /\bD(?:ia(?:meter)?)?\.?\s*[=:]|\bDia|Ø|mill\b|drill|cutter|\bbit\b|ball|flat|flute|\btool\b|\bT\s*#?\d/i;

/** Comments of a line, without their marks. */
const comments = (line: string): string => [...line.matchAll(/\(([^)]*)\)|;(.*)$/g)].map(found => found[1] ?? found[2]).join(" ");

/** What a comment says of a cutter, if it says how wide it is. */
export function cutterIn(text: string): Cutter | undefined {
  const number = "(\\d+(?:[.,]\\d+)?)";
  const value = (found: RegExpExecArray | null) => (found ? Number(found[1].replace(",", ".")) : undefined);
  const inch = new RegExp(`${number}\\s*(?:in\\b|inch|")`, "i").exec(text);
  const fraction = /\b(\d+)\/(\d+)\s*(?:in\b|inch|")?/i.exec(text);
  // The tip of a pointed cutter is told by its width, and where that is.
  const diameter = /\bwide\b|\btip\b/i.test(text) ? undefined : value(new RegExp(`\\bD(?:ia(?:meter)?)?\\.?\\s*[=:]?\\s*${number}`, "i").exec(text))
    ?? (inch ? (value(inch) as number) * 25.4 : fraction ? (Number(fraction[1]) / Number(fraction[2])) * 25.4 : undefined)
    ?? value(new RegExp(`(?:^|\\s|Ø)${number}\\s*mm\\b`, "i").exec(text));
  const angle = value(new RegExp(`${number}\\s*(?:°|deg)`, "i").exec(text)) ?? value(new RegExp(`TAPER\\s*=\\s*${number}`, "i").exec(text));
  const isPointed = angle !== undefined && angle > 0 && angle < 179 && !/drill/i.test(text);
  const isV = /v[- ]?bit|v[- ]?carv/i.test(text) || (isPointed && (CUTTER.test(text) || /engrav|chamfer|\bV\b/i.test(text)));
  const isBall = /ball/i.test(text);
  // A length alone is the one of anything.
  if (diameter === undefined ? !(isV && isPointed) : !(isV || CUTTER.test(text))) return undefined;
  const width = diameter ?? 6;
  if (!(width > 0 && width <= 1000)) return undefined;
  return { shape: isV ? "v" : isBall ? "ball" : "flat", diameter: width, angle: isV && angle !== undefined && angle > 0 ? Math.min(179, angle) : 60 };
}

/** Cutters by tool, as far as comments tell: one with the tool's number in it, or the one that stands before a change to it. */
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
  // Without a change of tools there is one cutter, that of tool 0.
  if (Object.keys(found).length === 0 && last) found[0] = last;
  return found;
}
