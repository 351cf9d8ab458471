// Manual control of spindle and coolant while no job uses them.
import { $, allow, el, onclick, press, say, typed } from "./dom";
import type { Machine } from "./machine";

export class SpindlePanel {
  constructor(private readonly machine: Machine) {
    onclick("spindle-start", () => void machine.line(`M3 S${Math.max(0, Math.round(typed("rpm") ?? 0))}`));
    onclick("spindle-stop", () => void machine.line("M5"));
    for (const button of document.querySelectorAll<HTMLElement>("[data-coolant]")) {
      button.addEventListener("click", () => void machine.line(button.dataset.coolant as string));
    }
    machine.onchange(() => this.update());
    this.update();
  }

  private update(): void {
    const { machine } = this;
    const { accessories, status } = machine;
    const why = machine.whyNotAtRest;
    const turns = /[SC]/.test(accessories);
    const speed = Number(status?.fields.FS?.split(",")[1] ?? 0);
    allow($("rpm"), why);
    allow($("spindle-start"), why);
    allow($("spindle-stop"), why ?? (turns ? undefined : "The spindle is off."));
    const coolant = document.querySelectorAll<HTMLElement>("[data-coolant]");
    for (const button of coolant) allow(button, why);
    press(coolant, ({ dataset }) => (dataset.coolant === "M7" && /M/.test(accessories)) || (dataset.coolant === "M8" && /F/.test(accessories)) || (dataset.coolant === "M9" && !/[FM]/.test(accessories)));
    const most = machine.settings[30];
    const now = turns ? `Turns ${/C/.test(accessories) ? "counterclockwise" : "clockwise"}${speed ? ` at ${speed.toLocaleString("en")} rpm` : ""}.` : "";
    say("spindle-why", machine.running ? `The job has them now. ${now}` : why ?? (now || (most ? `At most ${most.toLocaleString("en")} rpm ($30).` : "")));
    const modes = machine.modes.join(" ");
    if ($("modes").dataset.shown === modes) return;
    $("modes").dataset.shown = modes;
    $("modes").replaceChildren(...machine.modes.map(mode => el("code", { textContent: mode })));
  }
}
