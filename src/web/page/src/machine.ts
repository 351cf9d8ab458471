// The machine: in the page, or a real board at a serial port, with the same code.
import type { App } from "./app";
import { $, el } from "./dom";
import { every, PageLink, SerialLink, serial, servedMachine, SocketLink } from "./links";
import { type Answer, type Link, REALTIME, Sender, type Status } from "./sender";
import { parseSettings } from "./settings";
import { offer, tellsGrblsOnly, written } from "./transfer";

/** How often the machine is asked for its state, ms. */
const POLL = 200;
/** A held jog is sent as moves of this duration, three of them ahead of the last report: a page that dies stops behind them. */
const JOG_SECONDS = 0.2;
const JOGS_AHEAD = 3;
/** Rates of a board's serial port: the usual one, and what $931 may choose. Over USB they mean nothing. */
const BAUDS = [115_200, 230_400, 250_000, 460_800, 500_000, 921_600, 1_000_000];
/** How far the probe goes down, mm. */
const PROBE_DEPTH = 25;
/** The setting that is the dialect: 0 is Grbl's. */
const DIALECT = 900;
/** Lines that the console keeps. */
const KEPT = 400;

/** What is fitted to the machine in the page: a switch at the positive end of each axis, and a plate below Z. */
const FITTED = {
  switch: ["x", "y", "z"].map(axis => ({ axis, at_mm: 20, side: "positive", bounce_us: 900 })),
  plate: { axis: "z", at_mm: -12.5, side: "negative" },
};

const html = `
<p>A machine in this page, with limit switches and a probe plate; or a board at a serial port. Both are driven by the same code.</p>
<div class="row">
  <button id="power" type="button">Machine in the page</button>
  <span id="port"><button id="connect" type="button">Connect a board</button>
    <label for="baud">at</label> <select id="baud" title="the board's $931; over USB it means nothing">${BAUDS.map(baud => `<option value="${baud}">${baud} baud</option>`).join("")}</select></span>
  <button id="served" type="button" class="go" hidden>Simulated machine</button>
  <button id="leave" type="button" hidden>Disconnect</button>
</div>
<p id="noserial" hidden>This browser has no Web Serial: Chromium, Chrome, Edge and Firefox of today have it.</p>
<p id="machine-note" role="status"></p>
<p id="silent" hidden>On a UART the machine cannot see that this browser has crashed, and would carry out what it has received.
  <button id="watch" type="button">Hold after 2 s of silence</button></p>
<div id="live" hidden>
  <div class="row"><span id="state" class="state">?</span><span id="sent"></span>
    <label for="times">time</label><select id="times"><option value="1">1 ×</option><option value="10">10 ×</option><option value="100">100 ×</option></select></div>
  <div class="dro" id="dro"></div>
  <div class="row">
    <button id="start" type="button" class="go">Run job</button>
    <button type="button" data-realtime="hold">Hold</button>
    <button type="button" data-realtime="resume">Resume</button>
    <button id="reset" type="button" class="stop">Reset</button>
  </div>
  <div class="row">
    <button type="button" data-line="$H">Home</button>
    <button type="button" data-line="$X">Unlock</button>
  </div>
  <div class="row">
    <button id="probe" type="button">Probe Z</button>
    <span><label for="plate">plate</label> <input id="plate" type="number" value="10" step="any" style="width:70px" aria-label="thickness of the plate in mm"> mm</span>
  </div>
  <div class="row"><span>Settings</span>
    <button id="read" type="button" aria-label="settings to forecast">to forecast</button>
    <button id="compare" type="button" aria-label="settings to machine">to machine</button>
  </div>
  <div id="differences" hidden>
    <table aria-label="Settings that differ"><thead><tr><th scope="col">$</th><th scope="col">Setting</th><th scope="col">machine</th><th scope="col">forecast</th></tr></thead><tbody></tbody></table>
    <div class="row"><button id="write" type="button" class="go"></button><button id="keep" type="button">Leave it as it is</button></div>
  </div>
  <h2>Jog: hold to move</h2>
  <div class="jog" id="jog"></div>
  <div class="row"><label for="jog-feed">at</label><input id="jog-feed" type="number" value="400" min="1" step="any" style="width:80px"><span>mm/min</span></div>
  <h2>Overrides</h2>
  <div class="overrides">
    <span>Feed</span><b id="override-0">100 %</b><button type="button" data-realtime="feedMinus" aria-label="feed 10 % less">−</button><button type="button" data-realtime="feed100" aria-label="feed at 100 %">100</button><button type="button" data-realtime="feedPlus" aria-label="feed 10 % more">+</button>
    <span>Rapids</span><b id="override-1">100 %</b><button type="button" data-realtime="rapid25" aria-label="rapids at 25 %">25</button><button type="button" data-realtime="rapid50" aria-label="rapids at 50 %">50</button><button type="button" data-realtime="rapid100" aria-label="rapids at 100 %">100</button>
    <span>Spindle</span><b id="override-2">100 %</b><button type="button" data-realtime="spindleMinus" aria-label="spindle 10 % less">−</button><button type="button" data-realtime="spindle100" aria-label="spindle at 100 %">100</button><button type="button" data-realtime="spindlePlus" aria-label="spindle 10 % more">+</button>
  </div>
  <h2>Console</h2>
  <div class="console" id="console" role="log" tabindex="0" aria-label="Console"></div>
  <div class="row"><label for="command">Line</label><input id="command" type="text" spellcheck="false" autocomplete="off"></div>
</div>`;

export class MachinePanel {
  sender?: Sender;
  status?: Status;
  private link?: Link;
  private endPoll = () => {};
  /** The button or key that is held to jog, and the end of the last such jog. */
  private jogging?: object;
  private jogged = Promise.resolve();
  /** What the machine has said of its settings. */
  private settings: Record<string, number> = {};
  /** Reports in a row that said that the machine does nothing, with no line under way. */
  private rests = 0;

  constructor(private readonly app: App) {
    $("machine").innerHTML = html;
    for (const [axis, name] of ["X", "Y", "Z"].entries()) {
      const zero = el("button", { type: "button", textContent: "0", "aria-label": `0: set work zero of ${name} here` });
      zero.addEventListener("click", () => void this.line(`G10 L20 P0 ${name}0`));
      $("dro").append(el("b", { textContent: name }), el("span", { className: "work", id: `work-${axis}`, textContent: "0.000" }),
        el("span", { className: "at", id: `at-${axis}`, textContent: "0.000" }), zero);
    }
    for (const way of ["X-", "Y-", "Z-", "X+", "Y+", "Z+"]) $("jog").append(this.jogButton(way));
    $("noserial").hidden = serial() !== undefined;
    $<HTMLButtonElement>("connect").disabled = serial() === undefined;
    this.listen();
  }

  /** Sends a line and shows it. */
  async line(text: string): Promise<string> {
    return (await this.ask(text)).answer;
  }

  private async ask(text: string): Promise<Answer> {
    if (!this.sender) return { answer: "", said: [] };
    this.say(text, "sent");
    const answered = await this.sender.ask(text);
    this.say(answered.answer, answered.answer === "ok" ? "" : "wrong");
    // A setting may decide on the unit of reports, or on speeds.
    if (/^\s*\$(\d|RST)/i.test(text)) await this.readSettings();
    return answered;
  }

  /** What is typed: a realtime command has no line. */
  private typed(text: string): void {
    const command = { "!": REALTIME.hold, "~": REALTIME.resume, "?": REALTIME.status }[text.trim()];
    if (command === undefined) return void this.line(text);
    this.say(text, "sent");
    this.sender?.realtime(command);
  }

  private async greet(): Promise<void> {
    await this.line("$I");
    await this.readSettings();
  }

  /** Reads the settings of the machine, which refuses that in motion. Gives whether it did so. */
  private async readSettings(): Promise<boolean> {
    const { sender, link } = this;
    if (!sender) return false;
    const { answer, said } = await sender.ask("$$", true);
    if (answer !== "ok" || this.sender !== sender) return false;
    this.settings = parseSettings(said.join("\n"));
    sender.unit = this.settings[13] === 1 ? 25.4 : 1;
    $("silent").hidden = !(link instanceof SerialLink && this.settings[922] === 0);
    return true;
  }

  private attach(link: Link): void {
    this.link = link;
    const sender = (this.sender = new Sender(link));
    link.onlost = why => this.link === link && this.lost(why);
    sender.onstatus = status => this.show(status);
    sender.onmessage = text => this.say(text);
    sender.onrefused = (line, answer) => this.say(`line ${line}: ${answer}`, "wrong");
    sender.onstopped = (line, why) => this.jobStopped(line, why);
    sender.ongreeting = () => void this.greet();
    sender.onprogress = () => {
      $("sent").textContent = sender.lines.length ? `${sender.done} of ${sender.lines.length} lines` : "";
      if (!sender.free) this.rests = 0;
      this.allow();
    };
    $("live").hidden = $("leave").hidden = false;
    $("power").hidden = $("port").hidden = $("served").hidden = true;
    $<HTMLSelectElement>("times").disabled = !(link instanceof PageLink);
    this.note("");
    this.endPoll = every(POLL, () => sender.realtime(REALTIME.status));
    void this.greet();
  }

  /** Disconnects; a machine that moves is held. A homing cycle takes no hold, and ends at its switches. */
  private leave(): void {
    const homes = /^Home/.test(this.status?.state ?? "");
    const moves = this.moves();
    if (moves) this.sender?.realtime(REALTIME.hold);
    this.detach(homes ? "Disconnected. The machine is homing, and goes on with it." : moves ? "Disconnected. The machine was moving, and is held." : "Disconnected.");
  }

  /** A link that has failed in one direction may still work in the other. */
  private lost(why: string): void {
    const moves = this.moves();
    if (moves) this.sender?.realtime(REALTIME.hold);
    this.detach(`The machine is gone${moves ? " in motion, and is held if it still hears that" : ""}: ${why}`);
  }

  private detach(why: string): void {
    this.endPoll();
    void this.link?.close();
    this.link = this.sender = this.status = this.jogging = undefined;
    [this.settings, this.rests] = [{}, 0];
    $("live").hidden = $("leave").hidden = $("silent").hidden = $("differences").hidden = true;
    this.app.player.showMachine();
    $("power").hidden = $("port").hidden = false;
    $("served").hidden = servedMachine() === undefined;
    this.note(why);
  }

  private show(status: Status): void {
    this.status = status;
    const name = status.state.split(":")[0];
    this.rests = this.sender?.free && /^(Idle|Check)$/.test(name) ? this.rests + 1 : 0;
    this.allow();
    $("state").textContent = status.state;
    $("state").className = `state ${name}`;
    for (let axis = 0; axis < 3; axis++) {
      $(`work-${axis}`).textContent = (status.work[axis] ?? 0).toFixed(3);
      $(`at-${axis}`).textContent = (status.machine[axis] ?? 0).toFixed(3);
    }
    this.app.player.showMachine(status.machine);
    for (const [index, part] of (status.fields.Ov?.split(",") ?? []).slice(0, 3).entries()) $(`override-${index}`).textContent = `${part} %`;
  }

  /** A job may begin when the one before is done: a single report may be older than its last move. */
  private allow(): void {
    $<HTMLButtonElement>("start").disabled = this.rests < 2;
  }

  private jobStopped(line: number, why: string): void {
    const text = `The job has ended: ${why}. Its lines up to ${line} have been sent.`;
    this.say(text, "wrong");
    this.note(/refused/.test(why) ? `${text} The machine is held: Reset drops what it has received, Resume carries it out.` : text);
  }

  /** Whether the machine has something to do: all lines may be answered while it still moves. */
  private moves(): boolean {
    return this.sender !== undefined && (this.sender.busy || /^(Run|Jog|Home)/.test(this.status?.state ?? ""));
  }

  private say(text: string, kind = ""): void {
    const console_ = $("console");
    console_.append(el("div", { className: kind, textContent: text }));
    while (console_.childNodes.length > KEPT) console_.firstChild?.remove();
    console_.scrollTop = console_.scrollHeight;
  }

  private jogButton(way: string): HTMLElement {
    const button = el("button", { type: "button", textContent: way, "aria-label": `jog ${way.replace("-", " to minus").replace("+", " to plus")}, hold` });
    const begin = (event: Event) => {
      event.preventDefault();
      if (!this.jogging) this.beginJog(way);
    };
    button.addEventListener("pointerdown", event => {
      if (event.button !== 0) return;
      button.setPointerCapture(event.pointerId);
      begin(event);
    });
    button.addEventListener("keydown", event => {
      if (!event.repeat && (event.key === " " || event.key === "Enter")) begin(event);
    });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture", "keyup", "blur"]) button.addEventListener(end, () => this.endJog());
    return button;
  }

  private beginJog(way: string): void {
    const press = (this.jogging = {});
    this.jogged = this.jogged.then(() => this.jog(way, press));
  }

  /** Short jogs one after the other, as long as the button is held. */
  private async jog(way: string, press: object): Promise<void> {
    const { sender } = this;
    const held = () => this.jogging === press && this.sender === sender;
    // A machine that does as it is told has its settings; one that has refused them may give them now.
    if (sender && held() && this.settings[110] === undefined) await this.readSettings();
    if (!sender || !held()) return;
    const axis = "XYZ".indexOf(way[0]);
    // What is typed may be more than the axis can do.
    const feed = Math.min(Math.max(1, Number($<HTMLInputElement>("jog-feed").value) || 1), this.settings[110 + axis] ?? Infinity);
    const distance = ((feed / 60) * JOG_SECONDS).toFixed(3);
    const text = `$J=G91 G21 ${way[0]}${way[1] === "-" ? "-" : ""}${distance} F${feed}`;
    const at = () => this.status?.machine[axis] ?? 0;
    const from = at();
    for (let sent = 0; held(); ) {
      // Answers come when a jog is planned, not when it is done: the reports tell how far it has come.
      if (sent * Number(distance) >= Math.abs(at() - from) + JOGS_AHEAD * Number(distance)) {
        await new Promise(resolve => setTimeout(resolve, 20));
        continue;
      }
      sent++;
      const answer = await sender.command(text);
      // A line that was on its way when the button was released came behind the end of the jog on some machines.
      if (!held() && this.sender === sender) sender.realtime(REALTIME.jogCancel);
      if (answer !== "ok") {
        this.say(`${text}: ${answer}`, "wrong");
        break;
      }
    }
    if (held()) this.endJog();
  }

  private endJog(): void {
    if (!this.jogging) return;
    this.jogging = undefined;
    this.sender?.realtime(REALTIME.jogCancel);
  }

  private start(): void {
    try {
      if (this.rests < 2) throw new Error("the machine is not idle");
      this.sender?.stream(this.app.job.text);
      this.rests = 0;
      this.allow();
      this.note("");
    } catch (error) {
      this.note(`Nothing of the job is sent: ${(error as Error).message}`);
    }
  }

  /** Sets the work zero by a plate of known thickness. The units and modes of before are in force again behind it, whatever becomes of it. */
  private async probe(): Promise<void> {
    if (this.status?.fields.Pn?.includes("P")) return void this.note("The probe is in contact already: nothing is probed.");
    const modes = (await this.ask("$G")).said.join(" ").match(/\bG(20|21|90|91|93|94|95)\b/g);
    if (!modes) return void this.note("The machine does not tell its modes: nothing is probed.");
    this.note("");
    const { answer, said } = await this.ask(`G21 G91 G94 G38.3 Z-${PROBE_DEPTH} F100`);
    if (answer !== "ok") this.note(`Nothing is probed: ${answer}`);
    else if (!/\[PRB:[^\]]*:1\]/.test(said.join(" "))) this.note(`No contact within ${PROBE_DEPTH} mm: the work zero is as it was.`);
    else if ((await this.line(`G10 L20 P0 Z${Number($<HTMLInputElement>("plate").value)}`)) === "ok") await this.line("G0 Z2");
    await this.line(modes.join(" "));
  }

  private async settingsToForecast(): Promise<void> {
    if (!(await this.readSettings())) return this.note("The machine does not tell its settings now: the forecast keeps those that it has.");
    this.note("");
    const { description } = this.app;
    this.app.settings.replace(tellsGrblsOnly(description.settings, this.settings) ? { ...this.settings, [DIALECT]: 0 } : this.settings);
  }

  /** Shows what of the forecast's settings the machine has otherwise, to be written to it. */
  private async settingsToMachine(): Promise<void> {
    $("differences").hidden = true;
    if (!(await this.readSettings())) return this.note("The machine does not tell its settings now: nothing is written.");
    const { description, settings } = this.app;
    const differ = offer(description.settings, this.settings, number => settings.value(number), lines => void this.write(lines));
    this.note(differ ? "" : "The machine has all of these settings already.");
  }

  private async write(lines: string[]): Promise<void> {
    const { sender } = this;
    if (!sender) return;
    const done = await written(lines, async line => {
      this.say(line, "sent");
      const answer = await sender.command(line);
      this.say(answer, answer === "ok" ? "" : "wrong");
      return answer;
    });
    if (this.sender !== sender) return;
    await this.readSettings();
    this.note(done);
  }

  private note(text: string): void {
    $("machine-note").textContent = text;
  }

  private listen(): void {
    $("power").addEventListener("click", () => {
      const settings: Record<string, number> = { "22": 1, ...this.app.settings.values() };
      const steps_per_mm = [100, 101, 102].map(number => this.app.settings.value(number));
      this.attach(new PageLink(this.app.order({ settings, machine: { ...FITTED, steps_per_mm } })));
      void this.line("$X");
    });
    $("connect").addEventListener("click", async () => {
      try {
        this.attach(await SerialLink.open(Number($<HTMLSelectElement>("baud").value)));
      } catch (error) {
        this.note((error as Error).message);
      }
    });
    const served = servedMachine();
    $("served").hidden = served === undefined;
    $("served").addEventListener("click", async () => {
      try {
        this.attach(await SocketLink.open(served as string));
      } catch (error) {
        this.note((error as Error).message);
      }
    });
    $("leave").addEventListener("click", () => this.leave());
    $("watch").addEventListener("click", async () => {
      await this.line("$922=2");
      await this.line("$923=0.5");
    });
    $("start").addEventListener("click", () => this.start());
    $("reset").addEventListener("click", () => this.sender?.reset());
    $("probe").addEventListener("click", () => void this.probe());
    $("read").addEventListener("click", () => void this.settingsToForecast());
    $("compare").addEventListener("click", () => void this.settingsToMachine());
    $("keep").addEventListener("click", () => ($("differences").hidden = true));
    $("times").addEventListener("change", () => {
      if (this.link instanceof PageLink) this.link.speed(Number($<HTMLSelectElement>("times").value));
    });
    for (const button of $("machine").querySelectorAll<HTMLElement>("[data-realtime]")) {
      button.addEventListener("click", () => this.sender?.realtime(REALTIME[button.dataset.realtime as keyof typeof REALTIME]));
    }
    for (const button of $("machine").querySelectorAll<HTMLElement>("[data-line]")) {
      button.addEventListener("click", () => void this.line(button.dataset.line as string));
    }
    const command = $<HTMLInputElement>("command");
    command.addEventListener("keydown", event => {
      if (event.key !== "Enter" || !command.value) return;
      this.typed(command.value);
      command.value = "";
    });
    // A page that goes leaves the machine in a hold.
    addEventListener("pagehide", () => this.moves() && this.sender?.realtime(REALTIME.hold));
    addEventListener("beforeunload", event => this.moves() && event.preventDefault());
    addEventListener("blur", () => this.endJog());
  }
}
