// The keyboard: what each key does, and the map that shows it.
import { $, button, el, onclick } from "./dom";
import { closeDialogs, Dialog, openDialog } from "./dialogs";
import { type JogPanel, type Way } from "./jog";
import type { Machine } from "./machine";
import type { Page, Workspace } from "./page";
import type { Player } from "./player";
import type { PositionPanel } from "./position";
import type { SetupPanel } from "./setup";
import { choose } from "./tabs";

const MAP: [head: string, rows: [text: string, ...keys: string[]][]][] = [
  ["Anywhere", [["Stop the machine", "Esc"], ["Hold, resume", "Space"], ["Check, Run, Settings", "1", "2", "3"], ["Open a job", "O"], ["This map", "?"]]],
  ["Jog, while “Arrow keys” is on", [["X, Y", "←", "→", "↑", "↓"], ["Z", "Page Up", "Page Down"], ["A", ",", "."], ["Step smaller, larger", "−", "+"], ["Keep moving until released", "Shift + key"]]],
  ["Machine", [["Home (asks)", "H"], ["Zero X Y (asks)", "Z"], ["Feed −10 %, +10 %", "[", "]"], ["Console line", "/"]]],
  ["Picture and time", [["3D, top, front, right", "F1", "F2", "F3", "F4"], ["Fit", "0"], ["Play, pause", "P"], ["One line back, on", "J", "K"], ["Turn, when the picture has the focus", "arrows"], ["Second by second, when the chart has it", "←", "→"]]],
];
const JOGS: Record<string, Way> = {
  ArrowLeft: { X: -1 }, ArrowRight: { X: 1 }, ArrowUp: { Y: 1 }, ArrowDown: { Y: -1 }, PageUp: { Z: 1 }, PageDown: { Z: -1 }, ",": { A: -1 }, ".": { A: 1 }, "<": { A: -1 }, ">": { A: 1 },
};

interface Parts { machine: Machine; page: Page; player: Player; jog: JogPanel; position: PositionPanel; setup: SetupPanel; workspace: () => Workspace }

export function listenToKeys({ machine, page, player, jog, position, setup, workspace }: Parts): void {
  const map = new Dialog("keys-dialog", "Keyboard map", [
    el("div", { className: "keymap" }, ...MAP.flatMap(([head, rows]) => [el("h3", { textContent: head }), ...rows.map(([text, ...keys]) =>
      el("div", {}, el("span", { textContent: text }), el("span", {}, ...keys.map(key => el("kbd", { textContent: key })))))])),
    el("p", { className: "why", textContent: "Letters do nothing while you type in a field. Jog keys work only while “Arrow keys” is on in the Jog card." }),
    el("div", { className: "actions-row" }, button("Close", () => map.close(), "btn go")),
  ], true);
  onclick("keys-button", () => map.open());
  onclick("first-keys", () => map.open());
  let held: ReturnType<typeof setTimeout> | undefined;
  const release = () => {
    clearTimeout(held);
    held = undefined;
    jog.end();
  };
  const moves = () => machine.moves() || ["hold", "stopping", "door"].includes(machine.phase);
  document.addEventListener("keydown", event => {
    const target = event.target as HTMLElement;
    const inField = target.matches("input:not([type=checkbox]), select, textarea");
    if (event.key === "Escape") {
      if (openDialog() && !moves()) return closeDialogs();
      if (inField && !moves()) return;
      if (machine.isConnected) {
        event.preventDefault();
        machine.stop();
      }
      return;
    }
    if (inField || event.ctrlKey || event.metaKey || event.altKey) return;
    if (openDialog()) return;
    const way = JOGS[event.key];
    if (way && jog.keys && workspace() === "run" && machine.whyNot === undefined) {
      event.preventDefault();
      event.stopPropagation();
      if (event.repeat) return;
      if (event.shiftKey) return jog.key(way, true);
      jog.key(way, false);
      return;
    }
    const onControl = target.matches("button, a, summary, [role=slider], [role=application], [role=listbox]");
    const keys: Record<string, () => void> = {
      "1": () => page.go("check"), "2": () => page.go("run"), "3": () => page.go("settings"),
      o: () => $("file").click(), "?": () => map.open(), p: () => player.togglePlay(), j: () => player.step(-1), k: () => player.step(1),
      F1: () => player.look(0), F2: () => player.look(1), F3: () => player.look(2), F4: () => player.look(3),
      "[": () => machine.realtime("feedMinus"), "]": () => machine.realtime("feedPlus"),
      "/": () => {
        choose("tab-log");
        $("command").focus();
      },
    };
    if (!target.matches("[role=application]")) keys["0"] = () => player.fit();
    if (jog.keys) Object.assign(keys, { "-": () => jog.changeStep(-1), "+": () => jog.changeStep(1) });
    if (machine.whyNotAtRest === undefined) keys.z = () => setup.confirm("Set the work zero of X and Y where the tool is now?", () => position.zero(["X", "Y"]));
    if (setup.whyNoHome === undefined && machine.isConnected) keys.h = () => setup.confirm("Home the machine now? It moves to its switches.", () => void machine.line("$H"));
    if (!onControl || machine.running) keys[" "] = () => machine.realtime(machine.phase === "hold" ? "resume" : "hold");
    if (event.key === " " && !machine.isConnected) return;
    const act = keys[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!act) return;
    event.preventDefault();
    act();
  }, { capture: true });
  document.addEventListener("keyup", event => event.key in JOGS && release());
  addEventListener("blur", () => {
    release();
    jog.switchKeysOff();
  });
}

