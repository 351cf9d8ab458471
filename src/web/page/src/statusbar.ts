// The bar that is always visible: the state of the machine, Stop, and the banner of an alarm or a lost connection.
import { $, button, el, icon, onclick, say } from "./dom";
import type { Machine, Phase } from "./machine";
import type { Page } from "./page";

type Tone = "none" | "idle" | "good" | "warn" | "bad";
const PILLS: Record<Phase, [text: string, tone: Tone]> = {
  none: ["Not connected", "none"], connecting: ["Connecting", "none"], idle: ["Idle", "idle"], jog: ["Jog", "good"], home: ["Homing", "good"], run: ["Running", "good"],
  hold: ["Hold", "warn"], stopping: ["Stopping", "warn"], alarm: ["Locked", "bad"], door: ["Door", "warn"], sleep: ["Sleep", "warn"], check: ["Check mode", "warn"],
  silent: ["No answer", "warn"], lost: ["Connection lost", "bad"],
};

export class StatusBar {
  private shown = "";

  constructor(private readonly machine: Machine, private readonly page: Page) {
    for (const id of ["stop", "stop-below"]) {
      // Stop acts on press: it must work even if the hand slips off the button.
      $(id).addEventListener("pointerdown", event => event.button === 0 && machine.stop());
      $(id).addEventListener("click", event => event.detail === 0 && machine.stop());
    }
    const menu = $("pill-menu");
    const show = (open: boolean) => {
      menu.hidden = !open;
      $("pill").setAttribute("aria-expanded", String(open));
    };
    onclick("pill", () => show(Boolean(menu.hidden)));
    onclick("leave", () => show(false));
    document.addEventListener("pointerdown", event => {
      if (!menu.contains(event.target as Node) && !$("pill").contains(event.target as Node)) show(false);
    });
    menu.addEventListener("keydown", event => {
      if (event.key !== "Escape" || machine.moves()) return;
      event.stopPropagation();
      show(false);
      $("pill").focus();
    });
    machine.onchange(() => this.update());
    this.update();
  }

  private update(): void {
    const { machine } = this;
    const { phase, running, trouble } = machine;
    let [text, tone, more]: [string, Tone, string] = [...PILLS[phase], ""];
    if (phase === "run" && running) text = `Running ${Math.round((running.follower.time / (running.follower.end || 1)) * 100)} %`;
    if (phase === "alarm" && trouble?.code !== undefined) text = `Alarm ${trouble.code}`;
    if (phase === "idle" && machine.stopped?.job.name === this.page.job.name) [text, tone] = ["Stopped", "warn"];
    if (phase === "idle" && trouble?.positionLost) [text, tone, more] = ["Unlocked", "warn", "home it"];
    else if (phase === "idle" && machine.homed) more = "homed";
    if (phase === "hold" && machine.pause) more = "waits for you";
    say("state", text);
    say("state-more", more);
    $("pill").dataset.tone = tone;
    $("to-connect").hidden = machine.isConnected;
    for (const id of ["stop", "stop-below"]) {
      const stop = $<HTMLButtonElement>(id);
      stop.hidden = !machine.isConnected && phase !== "lost";
      stop.disabled = !machine.isReached;
      stop.title = machine.isReached ? "Slows down, then drops the job. Pressed again: resets at once. Esc" : "No connection: use the emergency stop of the machine.";
    }
    this.banner();
  }

  private banner(): void {
    const { machine } = this;
    const { phase, trouble } = machine;
    const [head, text, action] = ((): [string, string, HTMLElement?] => {
      if (phase === "alarm" && trouble?.code !== undefined) {
        const place = trouble.at.length ? ` near ${trouble.at.slice(0, 3).map((v, axis) => `${"XYZ"[axis]} ${v.toFixed(1)}`).join(" ")}` : "";
        const certain = trouble.positionLost ? "Its position may be wrong until it is homed." : "Its position is kept.";
        return [`Alarm ${trouble.code}: ${trouble.text}.`, `The machine has stopped${place}${trouble.line ? `, at line ${trouble.line.toLocaleString("en")}` : ""}. ${certain} No line is sent.`];
      }
      if (phase === "lost" && machine.isConnected) {
        return [`No answer from the board for ${Math.round(machine.silence)} s. This page cannot stop it.`, "Use the emergency stop of the machine if it still moves. Stop is off until the connection is back.", button("Disconnect", () => machine.leave())];
      }
      if (phase === "lost") {
        return ["The connection is lost. This page cannot stop the machine.", "Use the emergency stop of the machine if it still moves. Connect it again to see where it is: nothing is sent that moves it.",
          button("Connect again", () => {
            this.page.go("run");
            machine.dismissLost();
          }, "btn go")];
      }
      return ["", ""];
    })();
    const key = `${head.replace(/\d+ s\b/, "")}${text}`;
    $("banner").hidden = head === "";
    if (key === this.shown) {
      const title = $("banner").querySelector("b");
      if (title && title.textContent !== head) title.textContent = head;
      return;
    }
    this.shown = key;
    if (head) $("banner").replaceChildren(icon("warn"), el("div", {}, el("b", { textContent: head }), el("span", { textContent: text })), ...(action ? [action] : []));
    else $("banner").replaceChildren();
  }
}
