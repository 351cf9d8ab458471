// What if: runs the whole job again with other settings.
import { $, clock, el, minutes, onclick } from "./dom";
import type { Summary } from "./engine";
import * as firmware from "./firmware";
import type { JobPanel, Page } from "./page";

/** A parameter that can be varied. `numbers`: its settings; `parts`: the multiples of the present values that are
 * tried; `least`: the value to multiply if the present value is 0. */
interface Parameter { name: string; unit: string; numbers: number[]; parts: number[]; least: number }
const PARTS = [0.25, 0.5, 1, 2, 4, 8];
const PARAMETERS: Parameter[] = [
  { name: "Acceleration X, Y ($120, $121)", unit: "mm/s²", numbers: [120, 121], parts: PARTS, least: 10 },
  { name: "Acceleration Z ($122)", unit: "mm/s²", numbers: [122], parts: PARTS, least: 10 },
  { name: "Fastest rate X, Y ($110, $111)", unit: "mm/min", numbers: [110, 111], parts: PARTS, least: 100 },
  { name: "Fastest rate Z ($112)", unit: "mm/min", numbers: [112], parts: PARTS, least: 100 },
  { name: "Junction deviation ($11)", unit: "mm", numbers: [11], parts: PARTS, least: 0.005 },
  { name: "Acceleration in curves ($917)", unit: "%", numbers: [917], parts: [0.5, 0.75, 1, 1.5, 2, 4], least: 10 },
  { name: "Jerk X, Y ($220, $221)", unit: "mm/s³", numbers: [220, 221], parts: [0, 0.25, 0.5, 1, 2, 4], least: 10_000 },
];
/** A higher value gains little if it saves less than this fraction of the time. */
const LITTLE = 0.04;

/** Returns `part` times the present value `today`, rounded to three digits. If `today` is 0, returns a multiple of
 * `least`. With `part` 1, returns `today` unrounded. */
function partOf(today: number, part: number, least: number): number {
  if (part === 1 && today > 0) return today;
  return Number(((today > 0 ? today : least) * part).toPrecision(3));
}

/** Returns the reason why a forecast does not cover the whole job; `undefined` if it does. */
function whyNot({ errors, alarm, complete, messages }: Summary): string | undefined {
  if (errors.length === 0 && !alarm && complete) return undefined;
  const locked = messages.find(message => message.startsWith("[MSG:Motion is locked"));
  return locked ?? (alarm ? `the job ends in ALARM:${alarm.code}` : errors.length ? "the job has errors" : "the job does not come to its end");
}

interface Results { parameter: Parameter; values: number[][]; today: number[]; times: number[]; failures: string[] }

const valueOf = ({ parameter }: Results, value: number[]): string =>
  value.every(one => one === 0) ? "no limit" : `${[...new Set(value)].map(one => one.toLocaleString("en", { maximumFractionDigits: 6 })).join(" / ")} ${parameter.unit}`;

export class WhatIf implements JobPanel {
  private running?: AbortController;

  constructor(private readonly page: Page) {
    $("parameter").append(...PARAMETERS.map(({ name }, value) => el("option", { textContent: name, value: String(value) })));
    onclick("vary", () => void this.vary());
  }

  clear(): void {
    this.running?.abort(new Error("the job or its settings have changed"));
    body().replaceChildren();
    $("whatif-note").textContent = "";
  }

  private async vary(): Promise<void> {
    const parameter = PARAMETERS[Number($<HTMLSelectElement>("parameter").value)];
    const today = parameter.numbers.map(number => this.page.settings.value(number));
    const values = parameter.parts.map(part => today.map(now => partOf(now, part, parameter.least)));
    const results: Results = { parameter, values, today, times: [], failures: [] };
    this.running?.abort(new Error("another forecast has begun"));
    const { signal } = (this.running = new AbortController());
    $<HTMLButtonElement>("vary").disabled = true;
    $("vary").title = "The forecast is being made.";
    $("whatif-note").textContent = "";
    this.draw(results);
    try {
      await firmware.each(values.map(value => async () => {
        const settings = Object.fromEntries(parameter.numbers.map((number, axis) => [String(number), value[axis]]));
        try {
          const { summary } = await firmware.check(this.page.order({ settings }), this.page.job.bytes, signal);
          return whyNot(summary) ?? summary.forecast_s;
        } catch (error) {
          if (signal.aborted) throw error;
          return (error as Error).message;
        }
      }), (index, result) => {
        if (typeof result === "number") results.times[index] = result;
        else results.failures[index] = result;
        this.draw(results);
      });
      $("whatif-note").textContent = finding(results);
    } catch (error) {
      if (!signal.aborted) $("whatif-note").textContent = (error as Error).message;
    }
    $<HTMLButtonElement>("vary").disabled = false;
    $("vary").title = "";
  }

  private draw(results: Results): void {
    const { values, times, failures, today } = results;
    const longest = Math.max(...times.filter(time => time > 0));
    const now = times[nowOf(results)];
    body().replaceChildren(...values.map((value, index) => {
      const time = times[index];
      const isNow = value.every((one, axis) => one === today[axis]);
      const bar = el("i");
      if (time) bar.style.width = `${(time / longest) * 100}%`;
      const change = time !== undefined && now !== undefined && !isNow ? time - now : 0;
      const className = isNow ? "now" : change > 0 ? "worse" : "";
      const name = el("td", {}, valueOf(results, value), ...(isNow ? [el("small", { textContent: "now" })] : []));
      const cells = failures[index] !== undefined ? [el("td", { colSpan: 3, className: "failed", textContent: failures[index] })]
        : [el("td", {}, ...(time ? [bar] : [])), el("td", { className: "n", textContent: time === undefined ? "…" : minutes(time) }),
          el("td", { className: `n${change < 0 ? " gain" : ""}`, textContent: Math.abs(change) < 0.5 ? "" : `${change > 0 ? "+" : "−"}${minutes(Math.abs(change))}` })];
      const row = el("tr", { className }, name, ...cells);
      row.dataset.seconds = String(time ?? "");
      return row;
    }));
  }
}

const nowOf = ({ values, today }: Results): number => values.findIndex(value => value.every((one, axis) => one === today[axis]));

/** Returns a sentence that names the value beyond which little is gained. */
function finding(results: Results): string {
  const { values, times } = results;
  const now = times[nowOf(results)];
  const whole = `${values.length} whole jobs were run.`;
  if (now === undefined) return whole;
  // From the slowest to the fastest, find the first value that is little slower than the fastest.
  const order = times.map((time, index) => ({ time, index })).filter(({ time }) => time > 0).toSorted((a, b) => b.time - a.time);
  const best = order.at(-1);
  const knee = order.find(({ time }) => best !== undefined && time - best.time < LITTLE * now);
  if (!knee || now - knee.time < LITTLE * now) return `Other values save little: at most ${clock(Math.max(0, now - (best?.time ?? now)))}. ${whole}`;
  return `${valueOf(results, values[knee.index])} saves ${clock(now - knee.time)}. Beyond that little is gained. Try on your machine what it does without losing steps. ${whole}`;
}

const body = (): HTMLElement => $("whatif-table").querySelector("tbody") as HTMLElement;
