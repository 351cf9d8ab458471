// The legend of the picture: its colour scale, and only the kinds of marks that are drawn.
import { $, el } from "./dom";
import type { Legend } from "./track";

export interface Key { text: string; kind: "" | "dashed" | "dot" | "cutter" | "cross" | "zero" | "solid"; color: string }

export function showLegend(legend: Legend, keys: Key[]): void {
  const shown = JSON.stringify([legend, keys]);
  if ($("legend").dataset.shown === shown) return;
  $("legend").dataset.shown = shown;
  $("legend-caption").textContent = legend.caption;
  $("scale").hidden = legend.ticks.length === 0;
  $("ticks").replaceChildren(...legend.ticks.map((textContent, index) =>
    el("span", { textContent, id: index === 0 ? "scale-low" : index === legend.ticks.length - 1 ? "scale-high" : "" })));
  $("legend-marks").replaceChildren(...keys.map(({ text, kind, color }) => {
    const mark = el("i", { className: `key ${kind}` });
    mark.style.color = `var(${color})`;
    return el("li", {}, mark, text);
  }));
}
