// The card of the job on the machine: before the start, during the run, and after an alarm or a stop.
import { $, allow, button, clock, el, icon, minutes, onclick, say } from "./dom";
import type { Machine, Trouble } from "./machine";
import type { Page } from "./page";
import { type Finding, type Grade, Preflight } from "./preflight";

const ICONS: Record<Grade, string> = { yes: "check", look: "warn", ask: "warn", wait: "turn", no: "cross" };
/** Distance that Z is lifted after a stop, mm. */
const LIFT = 10;

export interface Continuing {
  /** Opens the panel that continues a job at a line. */
  from(line: number): void;
}

export class RunCard {
  private readonly preflight: Preflight;
  /** Key of the findings that the user has confirmed. Other findings need another confirmation. */
  private agreed = "";
  private shown = "";

  constructor(private readonly machine: Machine, private readonly page: Page, private readonly continuing: Continuing) {
    this.preflight = new Preflight(machine, page, () => this.update());
    onclick("start", () => this.start());
    for (const made of document.querySelectorAll<HTMLElement>("#hold-row [data-realtime]")) {
      made.addEventListener("click", () => machine.realtime(made.dataset.realtime as "hold" | "resume"));
    }
    machine.onchange(() => this.update());
    this.update();
  }

  /** Call when the job or its verdict has changed. */
  jobChanged(): void {
    this.agreed = "";
    this.update();
  }

  /** Returns why the job cannot start; empty if it can. `asked`: `true` if the user may start the job in spite of the
   * reason. */
  private get hindered(): { why?: string; asked?: boolean } {
    const { machine } = this;
    if (machine.whyNotAtRest !== undefined) return { why: machine.whyNotAtRest };
    const found = this.preflight.findings();
    const no = found.find(({ grade }) => grade === "no") ?? found.find(({ grade }) => grade === "wait");
    if (no) return { why: `Off: ${no.text.charAt(0).toLowerCase()}${no.text.slice(1)}.` };
    const asks = found.filter(({ grade }) => grade === "ask");
    if (asks.length && this.agreed !== keyOf(asks)) return { why: `${asks.map(({ text }) => text).join(". ")}.`, asked: true };
    return machine.isAtRest ? {} : { why: "Waiting for the machine to be at rest." };
  }

  /** The job that was stopped or finished, if it is still the open job. */
  private get ended(): Pick<Machine, "stopped" | "finished"> {
    const { stopped, finished } = this.machine;
    const { name } = this.page.job;
    return { stopped: stopped?.job.name === name ? stopped : undefined, finished: finished?.name === name ? finished : undefined };
  }

  private start(): void {
    const { machine, page } = this;
    try {
      if (!page.checked) throw new Error("the job is not checked");
      machine.start(page.job, page.checked);
    } catch (error) {
      machine.onnote(`Nothing of the job is sent: ${(error as Error).message}`);
    }
    this.update();
  }

  private update(): void {
    const { machine } = this;
    const { phase, running, trouble } = machine;
    const { stopped, finished } = this.ended;
    this.preflight.update();
    $("jobcard").classList.toggle("held", phase === "hold" || phase === "door");
    const going = running !== undefined;
    const steps = trouble && (phase === "alarm" || trouble.positionLost || stopped) && !going ? this.steps(trouble) : undefined;
    const [title, key, body]: [string, string, () => (Node | string)[]] =
      running ? [phase === "hold" ? "Hold" : phase === "stopping" ? "Stopping" : "Running", "running", () => this.running()]
        : steps ? ["Get going again", `steps ${JSON.stringify([trouble, stopped?.line, machine.homed, phase])}`, () => steps]
          : stopped ? ["Stopped", `stopped ${stopped.line} ${stopped.why} ${phase} ${machine.homed} ${stopped.lifted}`, () => this.stopped()]
            : finished ? ["Done", `finished ${finished.took}`, () => this.finished()]
              : ["Next job", `next ${this.page.job.name} ${JSON.stringify(this.preflight.findings())} ${this.agreed}`, () => this.next()];
    say("jobcard-title", title);
    if (key !== this.shown) {
      this.shown = key;
      $("jobcard-body").replaceChildren(...body());
    }
    if (running) this.tick();
    this.controls(going);
  }

  private controls(going: boolean): void {
    const { machine, page } = this;
    const { phase } = machine;
    const hindered = this.hindered;
    const start = $<HTMLButtonElement>("start");
    const { stopped, finished } = this.ended;
    const instead = !going && (stopped !== undefined || (machine.trouble !== undefined && phase === "alarm") || finished !== undefined);
    start.hidden = going;
    start.classList.toggle("go", !instead);
    const time = page.checked ? ` · ${minutes(page.checked.summary.forecast_s)}` : "";
    const text = finished ? `Start it again${time}` : stopped ? `Start again from line 1${time}` : `Start job${time}`;
    if (start.textContent !== text) start.replaceChildren(icon("play"), text);
    allow(start, hindered.why);
    const why = $("start-why");
    const reason = going ? "" : hindered.why ?? "";
    if (why.dataset.reason !== `${reason}${hindered.asked}`) {
      why.dataset.reason = `${reason}${hindered.asked}`;
      why.replaceChildren(reason, ...(hindered.asked ? [" ", button("Run anyway", () => this.agree(), "link")] : []));
    }
    const holds = ["run", "jog", "door"].includes(phase) || (phase === "idle" && going);
    const [hold, resume] = [...$("hold-row").children] as HTMLElement[];
    allow(hold, holds ? undefined : machine.isConnected ? "Nothing moves." : "Connect a machine first.", "Space");
    allow(resume, phase === "hold" || phase === "door" ? undefined : machine.isConnected ? "Nothing is held." : "Connect a machine first.", "Space");
    resume.classList.toggle("go", phase === "hold");
    const turning = /[SC]/.test(machine.accessories);
    $("hold-why").textContent = phase === "hold" && machine.pause ? duty(machine.pause)
      : phase === "hold" ? turning ? "The spindle is still turning: keep your hands away." : "Held. Resume goes on; Stop ends the job."
        : phase === "door" ? "The safety door is open: close it, then press Resume." : going ? "Space holds and resumes. The spindle keeps turning in Hold." : "";
    $("hold-row").hidden = !going && !["run", "hold", "door", "jog", "stopping"].includes(phase) && machine.isConnected;
  }

  /** Call when the user starts the job in spite of the findings that need confirmation. */
  private agree(): void {
    this.agreed = keyOf(this.preflight.findings().filter(({ grade }) => grade === "ask"));
    this.update();
    $("start").focus();
  }

  private next(): (Node | string)[] {
    const list = el("ul", { className: "checks" }, ...this.preflight.findings().map(finding => this.finding(finding)));
    return [el("p", { className: "title", textContent: this.page.job.name || "No job" }), list];
  }

  private finding({ grade, text, more, line }: Finding): HTMLElement {
    const item = el("li", { className: grade }, icon(ICONS[grade]), el("span", {}, text, ...(more ? [el("small", { textContent: more })] : [])));
    if (line !== undefined) item.append(button("Show", () => this.page.player.goToLine(line), "link"));
    return item;
  }

  private running(): (Node | string)[] {
    const row = (name: string, id: string) => [el("dt", { textContent: name }), el("dd", { id })];
    return [el("span", { className: "left" }, el("span", { id: "run-left-time" }), el("small", { textContent: " left" })),
      el("div", { className: "part", role: "progressbar", "aria-label": "Part of the job that is done", "aria-valuemin": "0", "aria-valuemax": "100", id: "run-part" }, el("i")),
      el("dl", {}, ...row("Done", "run-done"), ...row("Ends at", "run-end"), ...row("Line", "run-line"), ...row("Now", "run-now"))];
  }

  /** Updates the figures that change with each report. */
  private tick(): void {
    const { running, overrides, status } = this.machine;
    if (!running) return;
    const { follower, job, summary } = running;
    const left = follower.left({ feed: Math.max(0.01, overrides[0] / 100), rapid: Math.max(0.01, overrides[1] / 100) });
    const part = follower.end ? follower.time / follower.end : 0;
    const speed = this.machine.isSimulated ? this.machine.times : 1;
    say("run-left-time", minutes(left));
    $("run-part").setAttribute("aria-valuenow", String(Math.round(part * 100)));
    ($("run-part").firstElementChild as HTMLElement).style.width = `${part * 100}%`;
    say("run-done", `${Math.round(part * 100)} % · ${minutes(follower.time)} of ${minutes(summary.forecast_s)}`);
    say("run-end", new Date(Date.now() + (left / speed) * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" }));
    say("run-line", `${follower.line.toLocaleString("en")} of ${job.lines.length.toLocaleString("en")}`);
    const [feed = 0, spindle = 0] = (status?.fields.FS ?? "").split(",").map(Number);
    say("run-now", `${Math.round(feed).toLocaleString("en")} mm/min${spindle ? ` · S ${spindle.toLocaleString("en")}` : ""}`);
  }

  private finished(): (Node | string)[] {
    const done = this.machine.finished;
    if (!done) return [];
    const row = (name: string, value: string) => [el("dt", { textContent: name }), el("dd", { textContent: value })];
    const close = button("Next job", () => {
      this.machine.finished = undefined;
      this.update();
    });
    return [el("p", { className: "title", textContent: `${done.name} is finished` }),
      el("dl", {}, ...row("Took", `${clock(done.took)}${done.times > 1 ? ` at ${done.times} ×` : ""}`), ...row("Forecast", clock(done.forecast)), ...row("Holds", String(done.holds))), el("div", { className: "actions" }, close)];
  }

  private stopped(): (Node | string)[] {
    const { machine } = this;
    const { stopped, phase } = machine;
    if (!stopped) return [];
    const why = stopped.why === "stopped" ? "You have stopped it." : `It has ended: ${stopped.why}.`;
    const actions = el("div", { className: "actions" });
    const position = machine.isConnected && machine.settings[22] === 1 && machine.homed === false;
    if (!machine.isConnected) actions.append(el("p", { className: "why", textContent: "Connect the machine again, home it, and look at the work zero. Then continue." }));
    else if (position) {
      actions.append(button("Home", () => void machine.line("$H"), "btn go"), el("p", { className: "why", textContent: "The position may be wrong. Home first, then continue." }));
    } else {
      const lift = button(`Lift Z by ${LIFT} mm`, () => {
        stopped.lifted = true;
        void machine.sequence([`$J=G91 G21 Z${LIFT} F${Math.max(1, Math.min(500, machine.settings[112] ?? 500))}`]);
      });
      allow(lift, machine.whyNotAtRest);
      actions.append(lift);
    }
    const go = button(`Continue from line ${stopped.line.toLocaleString("en")}…`, () => this.continuing.from(stopped.line), position ? "btn" : "btn go");
    if (phase === "hold" || phase === "stopping") allow(go, "Resume or stop the machine first.");
    actions.append(go, button("Dismiss", () => {
      machine.stopped = undefined;
      this.update();
    }));
    return [el("p", { className: "title", textContent: `Stopped at line ${stopped.line.toLocaleString("en")}` }),
      el("p", { className: "note", textContent: `${stopped.job.name}: ${why} ${minutes(stopped.seconds)} of the job are done.` }), actions];
  }

  /** Returns the steps that the user has to take after an alarm, as a list. Only the first open step has buttons. */
  private steps(trouble: Trouble): Node[] {
    const { machine } = this;
    const { phase, stopped } = machine;
    const unlocked = phase !== "alarm";
    const steps: { text: string; more?: string; done: boolean; buttons: HTMLElement[] }[] = [];
    const atSwitch = machine.status?.fields.Pn?.match(/[XYZAB]/g) ?? [];
    steps.push({ text: trouble.code === undefined ? "The machine is locked" : "Look at the machine", more: unlocked ? undefined : trouble.advice, done: unlocked,
      buttons: [...(trouble.code === undefined && machine.settings[22] !== 0 ? [button("Home", () => void machine.line("$H"), "btn go")] : []),
        button(trouble.code === undefined ? "Unlock" : "It is safe: unlock", () => void machine.unlock(), trouble.code === undefined && machine.settings[22] !== 0 ? "btn" : "btn go")] });
    if (trouble.code === 1) {
      steps.push({ text: "Jog off the switch", more: unlocked ? `Jog ${trouble.limits || atSwitch.join(", ") || "the axis"} away from its switch.` : undefined, done: unlocked && atSwitch.length === 0, buttons: [] });
    }
    if (trouble.positionLost) {
      const home = button("Home", () => void machine.line("$H"), "btn go");
      allow(home, machine.settings[22] === 0 ? "Homing is switched off ($22)." : undefined);
      const sure = button("I know where it is", () => {
        machine.trouble = undefined;
        this.update();
      });
      steps.push({ text: machine.settings[22] === 0 ? "Set the work zero again" : "Home", more: unlocked ? "The position may be wrong until then." : undefined, done: false, buttons: machine.settings[22] === 0 ? [sure] : [home, sure] });
    }
    if (stopped) steps.push({ text: `Continue from line ${stopped.line.toLocaleString("en")}`, done: false, buttons: [button("Continue…", () => this.continuing.from(stopped.line), "btn go")] });
    const now = steps.findIndex(({ done }) => !done);
    const list = el("ol", { className: "steplist" }, ...steps.map(({ text, more, done, buttons }, index) =>
      el("li", { className: done ? "done" : index === now ? "now" : "" }, el("b", { textContent: text }), ...(index === now && more ? [el("small", { textContent: more })] : []), ...(index === now ? buttons : []))));
    return [...(trouble.code === undefined ? [] : [el("p", { className: "title", textContent: `Alarm ${trouble.code}: ${trouble.text}` })]), list];
  }
}

/** Returns what the user has to do in a pause. T0 means no tool: the spindle stays empty. */
function duty(pause: string): string {
  if (pause.startsWith("First tool measured")) return "First tool measured. Work zero set with it? Yes: Resume. No: Stop, set zero, start again.";
  return `${pause}: ${pause.endsWith(" T0") ? "take it out" : "put it in"}, then press Resume.`;
}

const keyOf = (findings: Finding[]): string => findings.map(({ text }) => text).join();
