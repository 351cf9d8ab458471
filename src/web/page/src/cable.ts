// Tests whether the connection is fast enough, by simulating the job at several baud rates.
import { $, button, clock, count, el, minutes, onclick } from "./dom";
import type { Streamed } from "./engine";
import * as firmware from "./firmware";
import type { JobPanel, Page } from "./page";

/** Rates that are tested, in bits per second. */
const BAUDS = [9_600, 19_200, 38_400, 57_600, 115_200, 250_000, 1_000_000];
/** If a job takes more than this factor times its time on an unlimited link, the link is too slow: the machine waits
 * for lines. */
const WAITS = 1.005;

export class Cable implements JobPanel {
  private running?: AbortController;

  constructor(private readonly page: Page) {
    onclick("test-cable", () => void this.test());
  }

  clear(): void {
    this.running?.abort(new Error("the job or its settings have changed"));
    body().replaceChildren();
    $("cable-note").textContent = "";
    $("waits").hidden = true;
  }

  private async test(): Promise<void> {
    const streamed: Streamed[] = [];
    this.clear();
    const { signal } = (this.running = new AbortController());
    $<HTMLButtonElement>("test-cable").disabled = true;
    $("test-cable").title = "The job is being sent.";
    try {
      const bauds = [...BAUDS, 0];
      await firmware.each(bauds.map(baud => () => firmware.stream(this.page.order({ baud }), this.page.job.bytes, signal)), (index, one) => {
        streamed[index] = one;
        this.draw(bauds, streamed);
      });
      this.conclude(streamed, streamed[bauds.length - 1].forecast_s);
    } catch (error) {
      if (!signal.aborted) $("cable-note").textContent = (error as Error).message;
    }
    $<HTMLButtonElement>("test-cable").disabled = false;
    $("test-cable").title = "";
  }

  private conclude(streamed: Streamed[], free: number): void {
    const enough = BAUDS.findIndex((_, index) => streamed[index].forecast_s <= free * WAITS);
    $("cable-note").className = enough < 0 ? "finding bad" : "finding good";
    $("cable-note").textContent = enough < 0 ? "At each of these rates the machine runs out of lines and waits." : `Use ${BAUDS[enough].toLocaleString("en")} baud or more. From there on the machine never waits for lines.${BAUDS[enough] <= 115_200 ? " The usual 115,200 is enough." : ""}`;
    const slower = enough < 0 ? BAUDS.length - 1 : enough - 1;
    if (slower < 0) return;
    $("waits").hidden = false;
    $("waits-title").textContent = `Where it waits longest at ${BAUDS[slower].toLocaleString("en")} baud`;
    $("waits-list").replaceChildren(...streamed[slower].lost.slice(0, 5).map(({ line, seconds }) =>
      el("li", {}, button(`Line ${line.toLocaleString("en")}`, () => this.page.player.goToLine(line), "link"), el("span", { textContent: `${seconds.toFixed(2)} s` }))));
  }

  private draw(bauds: number[], streamed: Streamed[]): void {
    const free = streamed[bauds.length - 1]?.forecast_s;
    const longest = Math.max(...streamed.filter(Boolean).map(one => one.forecast_s));
    body().replaceChildren(...bauds.map((baud, index) => {
      const one = streamed[index];
      const waits = one !== undefined && free !== undefined && one.forecast_s > free * WAITS;
      const bar = el("i");
      if (one) bar.style.width = `${(one.forecast_s / longest) * 100}%`;
      const row = el("tr", { className: waits ? "waits" : "" }, el("td", { textContent: baud ? baud.toLocaleString("en") : "no limit" }), el("td", {}, ...(one ? [bar] : [])),
        el("td", { className: "n", textContent: waits ? clock(one.forecast_s - free) : one && free !== undefined ? "none" : "" }), el("td", { className: "n", textContent: one ? minutes(one.forecast_s) : "…" }));
      row.dataset.baud = String(baud);
      row.dataset.seconds = String(one?.forecast_s ?? "");
      row.title = waits ? count(one.lost.length, "line") : "";
      return row;
    }));
  }
}

const body = (): HTMLElement => $("cable-table").querySelector("tbody") as HTMLElement;
