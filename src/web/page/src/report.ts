// The verdict, the facts and the refused lines of a job.
import { $, clock, el } from "./dom";
import { type Summary, workZero } from "./engine";

const count = (number: number, name: string) => `${number.toLocaleString("en")} ${name}${number === 1 ? "" : "s"}`;

export function showReport(summary: Summary, lines: string[], goTo: (line: number) => void): void {
  const errors = summary.errors.length + summary.more_errors;
  const good = errors === 0 && !summary.alarm && summary.complete;
  const verdict = good
    ? "Every line is accepted."
    : [errors ? `${count(errors, "line")} refused.` : "", summary.alarm ? `Ends in ALARM:${summary.alarm.code}.` : "",
      !summary.complete && !summary.alarm ? "Not taken to the end." : ""].filter(Boolean).join(" ");
  $("verdict").replaceChildren(
    el("span", { className: "big", textContent: clock(summary.forecast_s) }),
    el("span", { className: good ? "good" : "bad", textContent: verdict }),
    ...(errors ? [el("small", { textContent: " The time is that of the job without the refused lines." })] : []),
  );
  bar(summary);
  byTool(summary);
  facts(summary);
  $("errors").replaceChildren(...list(summary, lines, goTo));
  const warnings = summary.warnings.map(({ line, text }) => `line ${line}: ${text}`);
  if (summary.more_warnings > 0) warnings.push(`and ${count(summary.more_warnings, "more warning")}`);
  const said = new Set([...warnings, ...summary.messages, ...summary.notes]);
  $("messages").replaceChildren(...[...said].map(textContent => el("li", { textContent })));
}

/** No figures of a job that was not checked. */
export function clearReport(): void {
  for (const id of ["bar", "kinds", "facts", "errors", "messages"]) $(id).replaceChildren();
  $("bar").setAttribute("aria-label", "time by kind");
  $("by-tool").hidden = true;
}

/** Parts of the forecast: name, seconds and colour. What is no kind of its own is a rest. */
export function kinds(summary: Summary): (readonly [string, number, string])[] {
  const rest = summary.standing_s - summary.dwell_s - summary.spin_up_s;
  return [["feed", summary.feed_s, "--scale-1"], ["rapids", summary.rapid_s, "--rapid"], ["dwell", summary.dwell_s, "--scale-4"],
    ["spindle", summary.spin_up_s, "--scale-5"], ["other", rest < 0.0005 ? 0 : rest, "--line"]];
}

function bar(summary: Summary): void {
  const parts = kinds(summary).filter(([name, seconds]) => seconds > 0 || name === "feed" || name === "rapids");
  const whole = summary.forecast_s || 1;
  const colored = (color: string, width = "") => {
    const part = el("i");
    part.style.cssText = `${width}background:var(${color})`;
    return part;
  };
  $("bar").replaceChildren(...parts.map(([, seconds, color]) => colored(color, `width:${(seconds / whole) * 100}%;`)));
  $("bar").setAttribute("aria-label", parts.map(([name, seconds]) => `${name} ${clock(seconds)}`).join(", "));
  $("kinds").replaceChildren(...parts.map(([name, seconds, color]) => el("li", {}, colored(color), `${name} ${clock(seconds)}`)));
}

/** A row for each tool, if there are several. */
function byTool({ tools }: Summary): void {
  $("by-tool").hidden = tools.length < 2;
  const cell = (seconds: number) => el("td", { textContent: seconds ? clock(seconds) : "–" });
  ($("by-tool").querySelector("tbody") as HTMLElement).replaceChildren(...tools.map(row =>
    el("tr", {}, el("th", { scope: "row", textContent: `T${row.tool}` }), cell(row.feed_s), cell(row.rapid_s), cell(row.dwell_s), cell(row.spin_up_s))));
}

function facts(summary: Summary): void {
  const { min, max } = summary.extents_mm;
  const offset = workZero(summary);
  const rows: [string, string][] = [
    ["time", `${summary.forecast_s} s`],
    ["lines", summary.lines.toLocaleString("en")],
    ["path at feed", `${(summary.distance_mm - summary.rapid_distance_mm).toFixed(1)} mm`],
    ["path of rapids", `${summary.rapid_distance_mm.toFixed(1)} mm`],
    ...["X", "Y", "Z"].map((axis, i) => [`machine ${axis}, mm`, `${min[i].toFixed(3)} to ${max[i].toFixed(3)}`] as [string, string]),
    ...(offset.some(v => Math.abs(v) > 1e-6) ? [["work zero at", offset.map(v => v.toFixed(3)).join(", ")] as [string, string]] : []),
    ["peak speed", `${(summary.peak_speed_mm_s * 60).toFixed(0)} mm/min`],
    ["peak acceleration", `${summary.peak_acceleration_mm_s2.toFixed(0)} mm/s²`],
    ["step pulses", summary.pulses.reduce((a, b) => a + b, 0).toLocaleString("en")],
    ["trace", summary.trace_hash],
    ["checked in", `${summary.host_s.toFixed(2)} s`],
  ];
  $("facts").replaceChildren(...rows.flatMap(([name, value]) => [el("dt", { textContent: name }), el("dd", { textContent: value })]));
}

function list(summary: Summary, lines: string[], goTo: (line: number) => void): HTMLElement[] {
  const items = summary.errors.map(error => {
    const button = el("button", { type: "button" },
      el("span", {}, `line ${error.line}: `, el("strong", { textContent: `error:${error.code}` }), ` ${error.text}`),
      el("code", { textContent: error.source || "(empty)" }), el("small", { textContent: error.advice }));
    button.addEventListener("click", () => goTo(error.line));
    return el("li", {}, button);
  });
  const { alarm } = summary;
  if (alarm) {
    const place = alarm.line === null ? "" : `line ${alarm.line}: `;
    const button = el("button", { type: "button" }, el("span", {}, place, el("strong", { textContent: `ALARM:${alarm.code}` }), ` ${alarm.text}`),
      ...(alarm.line === null ? [] : [el("code", { textContent: lines[alarm.line - 1] ?? "" })]),
      el("small", { textContent: alarm.advice }));
    button.addEventListener("click", () => goTo(alarm.line ?? 1));
    items.push(el("li", {}, button));
  }
  if (summary.more_errors > 0) items.push(el("li", { textContent: `and ${summary.more_errors} more` }));
  if (items.length === 0) items.push(el("li", { className: "none", textContent: "Nothing." }));
  return items;
}
