// The console: lines that were sent, their answers, and a line to type.
import { $, el, onclick } from "./dom";
import type { Machine } from "./machine";

/** Maximum number of lines in the console. */
const KEPT = 400;

export function listenToConsole(machine: Machine): void {
  const shown = $("console");
  machine.onsay = (text, kind = "") => {
    const atEnd = shown.scrollTop + shown.clientHeight >= shown.scrollHeight - 8;
    shown.append(el("div", { className: kind, textContent: text }));
    while (shown.childNodes.length > KEPT) shown.firstChild?.remove();
    if (atEnd) shown.scrollTop = shown.scrollHeight;
  };
  machine.onnote = text => ($("machine-note").textContent = text);
  const command = $<HTMLInputElement>("command");
  const history: string[] = [];
  let at = 0;
  const send = () => {
    if (!command.value || !machine.isConnected) return;
    history.push(command.value);
    at = history.length;
    machine.typed(command.value);
    command.value = "";
  };
  onclick("send", send);
  command.addEventListener("keydown", event => {
    if (event.key === "Enter") send();
    const step = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (step === undefined || history.length === 0) return;
    event.preventDefault();
    at = Math.max(0, Math.min(history.length, at + step));
    command.value = history[at] ?? "";
  });
  machine.onchange(() => {
    const off = machine.isConnected ? undefined : "Connect a machine first.";
    command.disabled = off !== undefined;
    $<HTMLButtonElement>("send").disabled = off !== undefined;
    $("send").title = command.title = off ?? "";
  });
}
