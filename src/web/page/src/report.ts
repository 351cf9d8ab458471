// The verdict, the facts and the refused lines of a job.
import { $, clock, el } from "./dom";
import type { Summary } from "./engine";

/** Refused lines that are shown. */
const SHOWN = 200;

const count = (number: number, name: string) => `${number.toLocaleString("en")} ${name}${number === 1 ? "" : "s"}`;

export function showReport(summary: Summary, goTo: (line: number) => void): void {
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
  facts(summary);
  $("errors").replaceChildren(...list(summary, goTo));
  const said = new Set([...summary.messages, ...summary.notes]);
  $("messages").replaceChildren(...[...said].map(textContent => el("li", { textContent })));
}

function bar(summary: Summary): void {
  const parts = [["feed", summary.feed_s, "--scale-1"], ["rapids", summary.rapid_s, "--rapid"], ["standing", summary.standing_s, "--scale-4"]] as const;
  const whole = summary.forecast_s || 1;
  $("bar").replaceChildren(...parts.map(([, seconds, color]) => {
    const part = el("i");
    part.style.cssText = `width:${(seconds / whole) * 100}%;background:var(${color})`;
    return part;
  }));
  $("bar").setAttribute("aria-label", parts.map(([name, seconds]) => `${name} ${clock(seconds)}`).join(", "));
}

function facts(summary: Summary): void {
  const { min, max } = summary.extents_mm;
  const offset = summary.position_mm.map((at, axis) => at - summary.work_position_mm[axis]);
  const rows: [string, string][] = [
    ["at feed", clock(summary.feed_s)],
    ["in rapids", clock(summary.rapid_s)],
    ["standing", clock(summary.standing_s)],
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

function list(summary: Summary, goTo: (line: number) => void): HTMLElement[] {
  const items = summary.errors.slice(0, SHOWN).map(error => {
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
      el("small", { textContent: alarm.advice }));
    button.addEventListener("click", () => goTo(alarm.line ?? 1));
    items.push(el("li", {}, button));
  }
  const more = summary.errors.length + summary.more_errors - SHOWN;
  if (more > 0) items.push(el("li", { textContent: `and ${more} more` }));
  if (items.length === 0) items.push(el("li", { className: "none", textContent: "Nothing." }));
  return items;
}
