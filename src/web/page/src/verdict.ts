// Shows the verdict, the problems and the figures of a job.
import { $, button, clock, count, el, icon, minutes } from "./dom";
import { hindrance, type LineError, type Path, ROW, type Summary, workZero } from "./engine";
import { extents } from "./setup";
import { isArc, isPlunge, isRapid } from "./track";
import { units } from "./units";

/** Number of problems that are listed before the rest is folded. */
const SHOWN = 5;

type Tone = "good" | "warn" | "bad" | "";

/** Shows a sentence instead of a verdict, because no job has been checked. */
export function showPlain(head: string, text = "", tone: Tone = ""): void {
  $("verdict-card").className = `verdict ${tone}`;
  const parts: HTMLElement[] = [];
  if (tone === "bad") parts.push(el("span", { className: "say" }, icon("cross"), "Do not run"));
  parts.push(el("span", { className: "head", textContent: head }));
  if (text) parts.push(el("p", { textContent: text }));
  $("verdict").replaceChildren(...parts);
}

export interface Context {
  lines: string[];
  /** Whether soft limits are in effect, because the machine is homed before the job. */
  travelIsChecked: boolean;
  goTo: (line: number) => void;
  giveZero: () => void;
}

export function showVerdict(summary: Summary, path: Path, context: Context): void {
  const hindered = hindrance(summary);
  const warnings = summary.warnings.length + summary.more_warnings;
  const tone: Tone = hindered ? "bad" : warnings ? "warn" : "good";
  const time = el("span", { className: "big", textContent: clock(summary.forecast_s), id: "verdict-time" });
  const travel = context.travelIsChecked ? "the job fits the travel of your machine." : "";
  const parts: (Node | string)[] = [];
  if (!hindered) {
    parts.push(el("span", { className: "say" }, icon(tone === "good" ? "check" : "warn"), tone === "good" ? "Ready to run" : `Runs, with ${count(warnings, "remark")}`), time,
      el("p", {}, `All ${count(summary.lines, "line")} ${summary.lines === 1 ? "is" : "are"} accepted${travel ? `, and ${travel}` : "."}`,
        ...(travel ? [] : [" Travel is not checked: no work zero is given. ", button("Give one", context.giveZero, "link")])));
  } else {
    const { text, line } = hindered;
    parts.push(el("span", { className: "say" }, icon("cross"), "Do not run yet"), el("span", { className: "head", textContent: capital(text) }),
      el("p", { textContent: [line ? `The machine would stop at line ${line.toLocaleString("en")}.` : "", summary.forecast_s > 0 ? `Without the rejected lines the job takes ${clock(summary.forecast_s)}.` : ""].filter(Boolean).join(" ") }));
  }
  $("verdict-card").className = `verdict ${tone}`;
  $("verdict").replaceChildren(...parts);
  problems(summary, context);
  remarks(summary, context);
  shares(summary, path);
  byTool(summary);
  size(summary);
  facts(summary);
}

/** Clears the figures, because the job has not been checked. */
export function clearVerdict(): void {
  for (const id of ["bar", "kinds", "facts", "errors", "messages", "warnings"]) $(id).replaceChildren();
  $("bar").setAttribute("aria-label", "Time by kind");
  for (const id of ["by-tool-part", "problems", "said", "time-card", "size-card"]) $(id).hidden = true;
}

/** Returns the parts of the forecast that are not 0: name, seconds and colour. The path tells how the feed time
 * divides into lines, arcs and plunges. */
export function kinds(summary: Summary, path: Path): (readonly [string, number, string])[] {
  let [lines, arcs, plunges] = [0, 0, 0];
  for (let row = 1; row < path.lines.length; row++) {
    if (isRapid(path, row)) continue;
    const took = path.rows[row * ROW + 5] - path.rows[row * ROW + 4];
    if (isPlunge(path, row)) plunges += took;
    else if (isArc(path, row)) arcs += took;
    else lines += took;
  }
  // The times in the path are rounded. Scale them, so that their sum is the firmware's feed time.
  const whole = lines + arcs + plunges || 1;
  const [line, arc, plunge] = [lines, arcs, plunges].map(part => (part / whole) * summary.feed_s);
  const other = summary.standing_s - summary.dwell_s - summary.spin_up_s;
  const all = [["Cutting: lines", line, "--scale-1"], ["Cutting: arcs", arc, "--scale-4"], ["Plunges", plunge, "--plunge"], ["Rapids", summary.rapid_s, "--rapid"],
    ["Pauses (G4)", summary.dwell_s, "--scale-2"], ["Waiting for the spindle", summary.spin_up_s, "--scale-5"], ["Standing", other < 0.0005 ? 0 : other, "--line-2"]] as const;
  return all.filter(([, seconds]) => seconds > 0);
}

function shares(summary: Summary, path: Path): void {
  const parts = kinds(summary, path);
  $("time-card").hidden = parts.length === 0;
  const whole = summary.forecast_s || 1;
  const colored = (color: string, width = "") => {
    const part = el("i");
    part.style.cssText = `${width}background:var(${color})`;
    return part;
  };
  const percent = (seconds: number) => {
    const share = (seconds / whole) * 100;
    return share > 0 && share < 1 ? "< 1 %" : `${Math.round(share)} %`;
  };
  const time = (seconds: number) => (seconds < 60 ? `${seconds.toFixed(2)} s` : minutes(seconds));
  $("bar").replaceChildren(...parts.map(([, seconds, color]) => colored(color, `width:${(seconds / whole) * 100}%;`)));
  $("bar").setAttribute("aria-label", parts.map(([name, seconds]) => `${name} ${clock(seconds)}`).join(", "));
  $("kinds").replaceChildren(...parts.map(([name, seconds, color]) =>
    el("li", {}, el("span", {}, colored(color), name), el("b", { textContent: time(seconds) }), el("em", { textContent: percent(seconds) }))));
}

/** Fills the table of times by tool. It is hidden if the job has fewer than two tools. */
function byTool({ tools }: Summary): void {
  $("by-tool-part").hidden = tools.length < 2;
  const cell = (seconds: number) => el("td", { className: "n", textContent: seconds ? seconds < 60 ? `${seconds.toFixed(2)} s` : minutes(seconds) : "–" });
  ($("by-tool").querySelector("tbody") as HTMLElement).replaceChildren(...tools.map(row =>
    el("tr", {}, el("th", { scope: "row", textContent: `T${row.tool}` }), cell(row.feed_s), cell(row.rapid_s), cell(row.dwell_s), cell(row.spin_up_s))));
}

function size(summary: Summary): void {
  const { min, max } = extents(summary);
  $("size-card").hidden = !(summary.distance_mm > 0);
  $("size-unit").textContent = `size, ${units.name === "mm" ? "mm" : "in"}`;
  const decimals = units.name === "mm" ? 2 : 3;
  ($("size").querySelector("tbody") as HTMLElement).replaceChildren(...["X", "Y", "Z"].map((axis, i) =>
    el("tr", {}, el("th", { scope: "row", textContent: axis }), ...[min[i], max[i], max[i] - min[i]].map(value => el("td", { textContent: units.length(value, decimals) })))));
}

function facts(summary: Summary): void {
  const { min, max } = summary.extents_mm;
  const offset = workZero(summary);
  const rows: [string, string][] = [
    ["Time", `${summary.forecast_s} s`],
    ["Lines", summary.lines.toLocaleString("en")],
    ["Path at feed", `${(summary.distance_mm - summary.rapid_distance_mm).toFixed(1)} mm`],
    ["Path of rapids", `${summary.rapid_distance_mm.toFixed(1)} mm`],
    ...["X", "Y", "Z"].map((axis, i) => [`Machine ${axis}, mm`, `${min[i].toFixed(3)} to ${max[i].toFixed(3)}`] as [string, string]),
    ...(offset.some(v => Math.abs(v) > 1e-6) ? [["Work zero at", offset.map(v => v.toFixed(3)).join(", ")] as [string, string]] : []),
    ["Top speed", `${(summary.peak_speed_mm_s * 60).toFixed(0)} mm/min`],
    ["Top acceleration", `${summary.peak_acceleration_mm_s2.toFixed(0)} mm/s²`],
    ["Step pulses", summary.pulses.reduce((a, b) => a + b, 0).toLocaleString("en")],
    ["Trace", summary.trace_hash],
    ["Checked in", `${summary.host_s.toFixed(2)} s`],
  ];
  $("facts").replaceChildren(...rows.flatMap(([name, value]) => [el("dt", { textContent: name }), el("dd", { textContent: value })]));
}

/** Returns the text of a line. If exactly one word can be the faulty one, underlines this word. */
function marked(source: string, error?: LineError): HTMLElement {
  const code = el("code");
  const unknown = error && /^(the command is unknown|the word is known)/.test(error.text) ? /\b[GM]\d+(\.\d+)?\b/gi : undefined;
  const words = unknown ? [...source.matchAll(unknown)] : [];
  const [word] = words;
  if (words.length !== 1 || word.index === undefined) code.textContent = source || "(empty)";
  else code.append(source.slice(0, word.index), el("mark", { textContent: word[0] }), source.slice(word.index + word[0].length));
  return code;
}

const capital = (text: string): string => text.charAt(0).toUpperCase() + text.slice(1);

function problems(summary: Summary, { lines, goTo }: Context): void {
  const items: HTMLElement[] = [];
  const entry = (line: number | null, head: string, code: HTMLElement | undefined, more: string) => {
    const made = el("button", { type: "button" }, el("span", { className: "h" }, head, el("span", { textContent: line === null ? "" : `line ${line.toLocaleString("en")}` })), ...(code ? [code] : []), el("small", { textContent: more }));
    made.addEventListener("click", () => goTo(line ?? 1));
    return el("li", {}, made);
  };
  if (summary.errors.length + summary.more_errors > Math.max(10, summary.lines / 2)) {
    const [error] = summary.errors;
    items.push(entry(error.line, "This does not look like G-code", marked(error.source, error), `More than half of the lines are refused. The first: ${error.text} (error:${error.code}).`));
  }
  const all = [
    ...summary.errors.map(error => () => entry(error.line, `${capital(error.text)} (error:${error.code})`, marked(error.source, error), error.advice)),
    ...(summary.alarm ? [() => entry(summary.alarm?.line ?? null, `Alarm ${summary.alarm?.code}: ${summary.alarm?.text}`,
      summary.alarm?.line ? marked(lines[summary.alarm.line - 1] ?? "") : undefined, summary.alarm?.advice ?? "")] : []),
  ];
  items.push(...all.slice(0, SHOWN).map(make => make()));
  if (all.length > SHOWN || summary.more_errors) {
    const rest = all.length - SHOWN;
    const fold = el("li", { className: "more" });
    const end = summary.more_errors ? el("li", { className: "more", textContent: `and ${summary.more_errors.toLocaleString("en")} more` }) : undefined;
    fold.append(button(`and ${(Math.max(0, rest) + summary.more_errors).toLocaleString("en")} more`, () => fold.replaceWith(...all.slice(SHOWN).map(make => make()), ...(end ? [end] : [])), "link"));
    items.push(fold);
  }
  $("errors").replaceChildren(...items);
  $("problems").hidden = items.length === 0;
}

function remarks(summary: Summary, { goTo }: Context): void {
  const shown = summary.warnings.slice(0, 200);
  const rest = summary.warnings.length + summary.more_warnings - shown.length;
  const warnings = shown.map(({ line, text }) => el("li", {}, icon("warn", "sm"), button(`Line ${line.toLocaleString("en")}: ${text}`, () => goTo(line), "link")));
  if (rest > 0) warnings.push(el("li", { className: "more", textContent: `and ${rest.toLocaleString("en")} more` }));
  $("warnings").replaceChildren(...warnings);
  // The end of the program is not worth a message.
  const said = new Set([...summary.messages, ...summary.notes].filter(message => message !== "[MSG:Pgm End]"));
  $("messages").replaceChildren(...[...said].map(textContent => el("li", { textContent })));
  $("said").hidden = warnings.length + said.size === 0;
}
