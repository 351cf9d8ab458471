// What if: the whole job again, with other settings, or over a slow link.
import type { App } from "./app";
import { $, clock, el } from "./dom";
import type { Streamed, Summary } from "./engine";
import * as firmware from "./firmware";

/** What may be varied: the settings that a value goes to, and the parts of today's values that are tried. */
interface Parameter { name: string; unit: string; numbers: number[]; parts: number[]; least: number }
const PARTS = [0.25, 0.5, 1, 2, 4, 8];
const PARAMETERS: Parameter[] = [
  { name: "acceleration of X and Y ($120, $121)", unit: "mm/s²", numbers: [120, 121], parts: PARTS, least: 10 },
  { name: "acceleration of Z ($122)", unit: "mm/s²", numbers: [122], parts: PARTS, least: 10 },
  { name: "maximum rate of X and Y ($110, $111)", unit: "mm/min", numbers: [110, 111], parts: PARTS, least: 100 },
  { name: "maximum rate of Z ($112)", unit: "mm/min", numbers: [112], parts: PARTS, least: 100 },
  { name: "junction deviation ($11)", unit: "mm", numbers: [11], parts: PARTS, least: 0.005 },
  { name: "acceleration in curves ($917)", unit: "%", numbers: [917], parts: [0.5, 0.75, 1, 1.5, 2, 4], least: 10 },
  { name: "jerk of X and Y ($220, $221)", unit: "mm/s³", numbers: [220, 221], parts: [0, 0.25, 0.5, 1, 2, 4], least: 10_000 },
];
/** Bits per second that are tried. */
export const BAUDS = [9_600, 19_200, 38_400, 57_600, 115_200, 250_000, 1_000_000];
/** A job that takes longer than this part of its time without a limit is starved. */
const STARVED = 1.005;

/** A part of today's value of an axis, rounded unless it is today's itself; of the least where there is none today. */
function partOf(today: number, part: number, least: number): number {
  if (part === 1 && today > 0) return today;
  return Number(((today > 0 ? today : least) * part).toPrecision(3));
}

/** Why the time of a job is none of the whole job, if it is not. */
function whyNot({ errors, alarm, complete, messages }: Summary): string | undefined {
  if (errors.length === 0 && !alarm && complete) return undefined;
  const locked = messages.find(message => message.startsWith("[MSG:Motion is locked"));
  return locked ?? (alarm ? `the job ends in ALARM:${alarm.code}` : errors.length ? "the job has errors" : "the job does not come to its end");
}

export class ForecastPanels {
  private running?: AbortController;

  constructor(private readonly app: App) {
    $("parameter").append(...PARAMETERS.map(({ name }, value) => el("option", { textContent: name, value: String(value) })));
    $("vary").addEventListener("click", () => void this.vary());
    $("starve").addEventListener("click", () => void this.starve());
  }

  /** Another job, or other settings: what was forecast is void. */
  clear(): void {
    this.running?.abort(new Error("the job or its settings have changed"));
    for (const id of ["whatif-table", "link-table"]) body(id).replaceChildren();
    for (const id of ["whatif-note", "link-note"]) $(id).textContent = "";
  }

  private begin(button: string): AbortSignal {
    this.running?.abort(new Error("another forecast has begun"));
    this.running = new AbortController();
    $<HTMLButtonElement>(button).disabled = true;
    return this.running.signal;
  }

  private async vary(): Promise<void> {
    const parameter = PARAMETERS[Number($<HTMLSelectElement>("parameter").value)];
    const today = parameter.numbers.map(number => this.app.settings.value(number));
    const values = parameter.parts.map(part => today.map(now => partOf(now, part, parameter.least)));
    const times: number[] = [];
    const failures: string[] = [];
    const began = performance.now();
    const signal = this.begin("vary");
    body("whatif-table").replaceChildren();
    try {
      await firmware.each(values.map(value => async () => {
        const settings = Object.fromEntries(parameter.numbers.map((number, axis) => [String(number), value[axis]]));
        try {
          const { summary } = await firmware.check(this.app.order({ settings }), this.app.job.bytes, signal);
          return whyNot(summary) ?? summary.forecast_s;
        } catch (error) {
          if (signal.aborted) throw error;
          return (error as Error).message;
        }
      }), (index, result) => {
        if (typeof result === "number") times[index] = result;
        else failures[index] = result;
        this.bars(parameter, values, times, failures, today);
      });
      $("whatif-note").textContent = `${values.length} whole jobs in ${((performance.now() - began) / 1000).toFixed(1)} s.`;
    } catch (error) {
      if (!signal.aborted) $("whatif-note").textContent = (error as Error).message;
    }
    $<HTMLButtonElement>("vary").disabled = false;
  }

  private bars(parameter: Parameter, values: number[][], times: number[], failures: string[], today: number[]): void {
    const longest = Math.max(...times.filter(time => time > 0));
    body("whatif-table").replaceChildren(...values.map((value, index) => {
      const bar = el("i");
      if (times[index]) bar.style.width = `${(times[index] / longest) * 100}%`;
      const each = [...new Set(value)].map(one => one.toLocaleString("en", { maximumFractionDigits: 6 })).join(" / ");
      const name = value.every(one => one === 0) ? "no limit" : `${each} ${parameter.unit}`;
      const result = failures[index] ?? (times[index] === undefined ? "…" : clock(times[index]));
      const row = el("tr", { className: value.every((one, axis) => one === today[axis]) ? "now" : "" }, el("td", { textContent: name }),
        el("td", { textContent: result }), el("td", {}, ...(times[index] ? [bar] : [])));
      row.dataset.seconds = String(times[index] ?? "");
      return row;
    }));
  }

  private async starve(): Promise<void> {
    const streamed: Streamed[] = [];
    const signal = this.begin("starve");
    body("link-table").replaceChildren();
    try {
      const bauds = [...BAUDS, 0];
      await firmware.each(bauds.map(baud => () => firmware.stream(this.app.order({ baud }), this.app.job.bytes, signal)), (index, one) => {
        streamed[index] = one;
        this.links(bauds, streamed);
      });
      const free = streamed[bauds.length - 1].forecast_s;
      const slowest = BAUDS.find((_, index) => streamed[index].forecast_s <= free * STARVED);
      $("link-note").textContent = slowest ? `From ${slowest} baud on the job is not starved.` : "All of these starve the job.";
    } catch (error) {
      if (!signal.aborted) $("link-note").textContent = (error as Error).message;
    }
    $<HTMLButtonElement>("starve").disabled = false;
  }

  private links(bauds: number[], streamed: Streamed[]): void {
    const free = streamed[bauds.length - 1]?.forecast_s;
    body("link-table").replaceChildren(...bauds.map((baud, index) => {
      const one = streamed[index];
      const starved = one && free && one.forecast_s > free * STARVED;
      const places = el("td");
      for (const { line, seconds } of starved ? one.lost.slice(0, 3) : []) {
        const button = el("button", { type: "button", textContent: `line ${line}`, title: `${seconds} s` });
        button.addEventListener("click", () => this.app.player.goToLine(line));
        places.append(button, " ");
      }
      const row = el("tr", { className: starved ? "starved" : "" }, el("td", { textContent: baud ? baud.toLocaleString("en") : "no limit" }),
        el("td", { textContent: one ? clock(one.forecast_s) : "…" }), places);
      row.dataset.baud = String(baud);
      row.dataset.seconds = String(one?.forecast_s ?? "");
      return row;
    }));
  }
}

const body = (table: string): HTMLElement => $(table).querySelector("tbody") as HTMLElement;
