// Connects a machine: at a serial port, simulated in the page, or behind a page served by `oxmill serve --web`.
import { $, el, onclick, say } from "./dom";
import { PageLink, SerialLink, serial, servedMachine, SocketLink } from "./links";
import type { Machine } from "./machine";
import type { Page } from "./page";

/** Rates of a board's serial port: the default, and the choices of $931. Over USB the rate has no effect. */
const BAUDS = [115_200, 230_400, 250_000, 460_800, 500_000, 921_600, 1_000_000];
/** Hardware of the simulated machine: a switch at the positive end of each axis, and a probe plate below Z. */
const FITTED = {
  switch: ["x", "y", "z"].map(axis => ({ axis, at_mm: 20, side: "positive", bounce_us: 900 })),
  plate: { axis: "z", at_mm: -12.5, side: "negative" },
};

export function listenToConnections(machine: Machine, page: Page): void {
  $("baud").append(...BAUDS.map(baud => el("option", { value: String(baud), textContent: `${baud.toLocaleString("en")} baud` })));
  const none = serial() === undefined;
  $("noserial").hidden = !none;
  $<HTMLButtonElement>("connect").disabled = $<HTMLSelectElement>("baud").disabled = none;
  $("connect").title = none ? "This browser has no Web Serial." : "";
  const open = async (link: () => Promise<SerialLink | SocketLink>) => {
    try {
      machine.attach(await link());
    } catch (error) {
      machine.onnote((error as Error).message);
    }
  };
  onclick("power", () => {
    // Homing is on, because each linear axis of the simulated machine has a switch.
    const settings: Record<string, number> = { "22": 1, ...page.settings.values() };
    const steps_per_mm = [100, 101, 102].map(number => page.settings.value(number));
    machine.attach(new PageLink(page.order({ settings, work_zero: undefined, machine: { ...FITTED, steps_per_mm } })));
    machine.times = Number($<HTMLSelectElement>("times").value);
    machine.speed(machine.times);
    void machine.line("$X");
  });
  onclick("connect", () => void open(() => SerialLink.open(Number($<HTMLSelectElement>("baud").value))));
  const served = servedMachine();
  $("served").hidden = served === undefined;
  onclick("served", () => void open(() => SocketLink.open(served as string)));
  onclick("leave", () => machine.leave());
  onclick("watch", async () => {
    await machine.line("$922=2");
    await machine.line("$923=0.5");
  });
  $("times").addEventListener("change", () => {
    machine.times = Number($<HTMLSelectElement>("times").value);
    machine.speed(machine.times);
  });
  const update = () => {
    $("connectcard").hidden = machine.isConnected;
    $("leave").hidden = !machine.isConnected;
    $("times-field").hidden = !machine.isSimulated;
    $("silent").hidden = !(machine.isSerial && machine.settings[922] === 0);
    const place = machine.isSimulated ? "A simulated machine in this page" : machine.isSerial ? "A board at a serial port" : "The machine of the program behind this page";
    say("port-info", machine.isConnected ? `${place}${machine.firmware ? `: ${machine.firmware}` : ""}.` : "No machine is connected.");
  };
  machine.onchange(update);
  update();
  // Leaving the page puts a moving machine into a hold.
  addEventListener("pagehide", () => machine.moves() && machine.realtime("hold"));
  addEventListener("beforeunload", event => machine.moves() && event.preventDefault());
}
