// The settings panel: X, Y and Z of a setting in one row, groups, search, differences, and an explanation of each
// setting.
import { $, allow, button, clock, el, onclick, press, save, say } from "./dom";
import { Dialog } from "./dialogs";
import type { Description, Import, Setting } from "./engine";
import * as firmware from "./firmware";
import type { Machine } from "./machine";
import type { Page } from "./page";
import { PRESETS, summary } from "./presets";
import type { Settings } from "./settings";
import { choose } from "./tabs";
import { differences, written } from "./transfer";

type Filter = "all" | "changed" | "differs";
interface Row { title: string; settings: Setting[]; perAxis: boolean; element: HTMLTableRowElement; text: string }
/** Groups that come first, because they affect the time. The others follow in the firmware's order. */
const FIRST_GROUPS = ["Axes", "Motion", "Homing", "Limits"];
/** Number of the setting `$930`: how many axes the machine has. */
const AXES = 930;
/** Number of the setting `$900`: the dialect. The value 0 means Grbl. */
const DIALECT = 900;

export class SettingsPanel {
  private readonly rows: Row[] = [];
  private readonly inputs = new Map<number, HTMLInputElement | HTMLSelectElement>();
  private chosen?: Row;
  private filter: Filter = "all";
  private readonly import_: Dialog;
  private readonly write: Dialog;
  private readonly preview = el("tbody");
  private imported?: Import;
  private readonly place = [...$("work-zero").querySelectorAll("input")];
  private readonly inline = el("tr", { className: "inline-about" });

  constructor(private readonly description: Description, private readonly settings: Settings, private readonly machine: Machine, private readonly page: Page) {
    for (const board of description.boards) $("board").append(el("option", { textContent: board.name }));
    $("preset").append(...PRESETS.map(({ id, name }) => el("option", { value: id, textContent: name })));
    $("preset").addEventListener("change", () => settings.choose($<HTMLSelectElement>("preset").value));
    this.buildTable();
    [this.import_, this.write] = [this.buildImport(), this.buildWrite()];
    for (const input of this.place) input.addEventListener("change", () => this.readPlace());
    for (const made of document.querySelectorAll<HTMLElement>("[data-filter]")) {
      made.addEventListener("click", () => {
        this.filter = made.dataset.filter as Filter;
        this.find();
      });
    }
    $("find").addEventListener("input", () => this.find());
    onclick("defaults", () => settings.choose(settings.preset.id));
    onclick("backup", () => this.backup());
    onclick("read", () => void this.fromMachine());
    onclick("compare", () => void this.toMachine());
    settings.onchange(() => this.refresh());
    machine.onchange(() => this.update());
    this.refresh();
    this.about(this.rows[0]);
  }

  // The table

  private buildTable(): void {
    const byGroup = new Map<string, Map<string, Setting[]>>();
    for (const setting of this.description.settings) {
      const group = byGroup.get(setting.group) ?? byGroup.set(setting.group, new Map()).get(setting.group) as Map<string, Setting[]>;
      // A homing cycle belongs to no single axis. So each of these settings has its own row.
      const key = setting.axis && setting.kind !== "axes" ? setting.title : setting.name;
      group.set(key, [...(group.get(key) ?? []), setting]);
    }
    const groups = [...byGroup.keys()].toSorted((a, b) => order(a) - order(b));
    const body = $("settings-table").querySelector("tbody") as HTMLElement;
    for (const group of groups) {
      const head = el("tr", { className: "group", id: `group-${group.replaceAll(" ", "-")}` }, el("td", { colSpan: 6, textContent: group }));
      const rows = [...(byGroup.get(group) as Map<string, Setting[]>)].map(([title, settings]) => this.row(title, settings));
      body.append(head, ...rows.map(row => row.element));
      this.rows.push(...rows);
      const made = el("button", { type: "button" }, group, el("span", { textContent: String(rows.length) }));
      made.addEventListener("click", () => {
        for (const one of $("groups").children) one.toggleAttribute("aria-current", one === made);
        head.scrollIntoView({ block: "start" });
      });
      $("groups").append(made);
    }
    $("groups").firstElementChild?.toggleAttribute("aria-current", true);
  }

  private row(title: string, settings: Setting[]): Row {
    const perAxis = settings.length > 1 || (settings[0].axis !== null && settings[0].kind !== "axes");
    const [first] = settings;
    const numbers = perAxis ? `$${first.number}–${settings.filter(({ axis }) => axis !== "A").at(-1)?.number}` : `$${first.number}`;
    const head = el("th", { scope: "row" }, title, el("small", { textContent: numbers }));
    const cells = ["X", "Y", "Z", "A"].map((axis, index) => {
      const setting = perAxis ? settings.find(one => one.axis === axis) : index === 0 ? first : undefined;
      const cell = el("td", { className: axis === "A" ? "n a-only" : "n" });
      if (!setting) return cell;
      if (perAxis) cell.dataset.axis = axis;
      cell.append(this.input(setting));
      return cell;
    });
    const element = el("tr", { className: "row" }, head, ...cells, el("td", { className: "unit", textContent: first.unit === "mask" ? "" : first.unit }));
    const row = { title, settings, perAxis, element, text: settings.map(one => `$${one.number} ${one.name} ${one.unit} ${one.explanation}`).join(" ").toLowerCase() };
    element.addEventListener("focusin", () => this.about(row));
    element.addEventListener("click", () => this.about(row));
    return row;
  }

  private input(setting: Setting): HTMLElement {
    const label = `$${setting.number} ${setting.name}`;
    const { labels } = setting;
    if (setting.kind === "switch") {
      const input = el("input", { type: "checkbox", "aria-label": label });
      input.addEventListener("change", () => this.settings.set(setting.number, input.checked ? 1 : 0));
      this.inputs.set(setting.number, input);
      return el("label", { className: "switch" }, input, el("i"));
    }
    if (setting.kind === "whole" && setting.unit !== "mask" && labels.length > 1) {
      const select = el("select", { "aria-label": label }, ...labels.map((textContent, value) => el("option", { textContent, value: String(value) })));
      select.addEventListener("change", () => this.settings.set(setting.number, Number(select.value)));
      this.inputs.set(setting.number, select);
      return select;
    }
    const input = el("input", { type: "text", inputMode: "decimal", "aria-label": label });
    input.addEventListener("change", () => {
      const value = Number(input.value.trim().replace(",", "."));
      if (input.value.trim() !== "" && Number.isFinite(value)) this.settings.set(setting.number, value);
      else this.refresh();
    });
    this.inputs.set(setting.number, input);
    return input;
  }

  private refresh(): void {
    const { settings } = this;
    for (const [number, input] of this.inputs) {
      const value = settings.value(number);
      if (input instanceof HTMLInputElement && input.type === "checkbox") input.checked = value !== 0;
      else input.value = String(value);
      input.closest("td")?.classList.toggle("changed", settings.isChanged(number));
    }
    $("settings-table").classList.toggle("four", settings.value(AXES) > 3);
    const changes = settings.changes().length;
    const line = `${settings.preset.name === "" ? "" : "Preset"}${changes ? ` · ${changes} value${changes === 1 ? "" : "s"} changed by you` : ""}`;
    say("settings-name", $("machine-name").textContent = settings.preset.name);
    say("settings-line", line);
    say("machine-line", summary(number => settings.value(number)) + (changes ? ` · ${changes} changed` : ""));
    $<HTMLSelectElement>("preset").value = settings.preset.id;
    allow($("defaults"), changes ? undefined : "Nothing differs from the preset.");
    this.tellPlace();
    this.find();
    if (this.chosen) this.about(this.chosen);
    this.update();
  }

  private find(): void {
    const text = $<HTMLInputElement>("find").value.trim().toLowerCase();
    const differ = new Set(differences(this.description.settings, this.machine.settings, number => this.settings.value(number)).map(({ setting }) => setting.number));
    const shown = (row: Row) => row.text.includes(text) && (this.filter === "all" || row.settings.some(({ number }) => (this.filter === "changed" ? this.settings.isChanged(number) : differ.has(number))));
    for (const row of this.rows) row.element.hidden = !shown(row);
    for (const head of $("settings-table").querySelectorAll<HTMLElement>("tr.group")) {
      let next = head.nextElementSibling as HTMLElement | null;
      let any = false;
      for (; next && !next.classList.contains("group"); next = next.nextElementSibling as HTMLElement | null) any ||= !next.hidden && next !== this.inline;
      head.hidden = !any;
    }
    press(document.querySelectorAll("[data-filter]"), ({ dataset }) => dataset.filter === this.filter);
    (document.querySelector('[data-filter="changed"]') as HTMLElement).textContent = `Changed ${this.settings.changes().length}`;
    say("differs", `Differs from machine ${differ.size}`);
  }

  /** Shows the details of a setting. */
  private about(row: Row): void {
    this.chosen?.element.classList.remove("chosen");
    this.chosen = row;
    row.element.classList.add("chosen");
    const [first] = row.settings;
    const seen = row.settings.filter(({ axis }) => axis !== "A" || this.settings.value(AXES) > 3);
    const value = (number: number) => String(this.settings.value(number));
    const there = (number: number) => (this.machine.settings[number] === undefined ? "–" : String(this.machine.settings[number]));
    const line = (name: string, of: (number: number) => string) => el("tr", {}, el("th", { scope: "row", textContent: name }), ...seen.map(({ number }) => el("td", { className: "n", textContent: of(number) })));
    const { checked } = this.page;
    const back = button("Back to the preset", () => this.settings.replace({ ...this.settings.values(), ...Object.fromEntries(row.settings.map(({ number }) => [number, this.settings.presetValue(number)])) }));
    allow(back, row.settings.some(({ number }) => this.settings.isChanged(number)) ? undefined : "It has the preset's value.");
    $("inspect").replaceChildren(
      el("h2", { textContent: row.title }), el("p", { className: "why", textContent: `${row.settings.map(({ number }) => `$${number}`).join(", ")}${first.unit && first.unit !== "mask" ? ` · ${first.unit}` : ""}` }),
      el("p", { className: "explanation", textContent: first.explanation }),
      ...(row.perAxis && checked ? [el("h3", { textContent: `What it does to ${this.page.job.name}` }), el("p", { textContent: `${clock(checked.summary.forecast_s)} with these settings.` }),
        button("See what if", () => {
          this.page.go("check");
          choose("tab-whatif");
        }, "link")] : []),
      ...(first.unit === "mask" && !row.perAxis ? [el("h3", { textContent: "What is switched on" }), this.bits(first)] : []),
      el("h3", { textContent: "Values" }),
      el("table", {}, ...(row.perAxis ? [el("thead", {}, el("tr", {}, el("td"), ...seen.map(({ axis }) => el("th", { scope: "col", className: "n", textContent: axis ?? "" }))))] : []),
        el("tbody", {}, line("Here", value), line("Preset", number => String(this.settings.presetValue(number))), ...(this.machine.isConnected ? [line("Machine", there)] : []))),
      el("h3", { textContent: "Limits" }), el("p", { textContent: `${first.values || "Any number"}. A new board has ${first.default}.` }), back);
    this.inline.replaceChildren(el("td", { colSpan: 6, textContent: first.explanation }));
    if (matchMedia("(max-width: 1199px)").matches) row.element.after(this.inline);
    else this.inline.remove();
  }

  private bits(setting: Setting): HTMLElement {
    const value = this.settings.value(setting.number);
    return el("div", { className: "bits" }, ...setting.labels.map((label, bit) => {
      const input = el("input", { type: "checkbox", checked: (value >> bit & 1) === 1 });
      input.addEventListener("change", () => this.settings.set(setting.number, input.checked ? value | 1 << bit : value & ~(1 << bit)));
      return el("label", { className: "chk" }, input, label);
    }));
  }

  // The work zero

  private readPlace(): void {
    this.settings.setZero(this.place.map(input => {
      const value = Number(input.value.trim().replace(",", "."));
      return input.value.trim() === "" || !Number.isFinite(value) ? undefined : value;
    }));
  }

  private tellPlace(): void {
    for (const [axis, input] of this.place.entries()) if (document.activeElement !== input) input.value = this.settings.zero[axis] === undefined ? "" : String(this.settings.zero[axis]);
    $("work-zero-note").textContent = this.settings.workZero() ? "The machine is homed before the job: soft limits ($20) act. Homing has to be on ($22)."
      : this.place.some(input => input.value !== "") ? "Not homed: X, Y and Z are needed." : "Not homed: soft limits do not act. Enter X, Y and Z to home before the job.";
  }

  // Import, backup

  private buildImport(): Dialog {
    const text = el("textarea", { id: "paste", rows: 8, spellcheck: false, "aria-label": "What $$ prints, or a configuration of FluidNC" });
    const file = el("input", { type: "file", id: "import-file", className: "vh", tabIndex: -1, "aria-hidden": "true" });
    const take = button("Take over", () => this.take(), "btn go");
    take.id = "take";
    const dialog = new Dialog("import-dialog", "Import settings", [
      el("p", { className: "intro" }, "Paste what a controller prints for ", el("code", { textContent: "$$" }), " (Oxmill, Grbl, grblHAL), a backup, or the configuration file of FluidNC."), text,
      el("p", {}, button("Choose a file", () => file.click()), file), el("p", { id: "take-note", className: "note", role: "status" }),
      el("table", { className: "plain", id: "import-table" }, el("thead", {}, el("tr", {}, ...["It says", "It becomes", "Value"].map(textContent => el("th", { scope: "col", textContent })))), this.preview),
    ], true);
    dialog.actions(take);
    onclick("open-import", () => dialog.open());
    text.addEventListener("input", () => this.look(text.value));
    file.addEventListener("change", async () => {
      text.value = (await file.files?.[0]?.text()) ?? "";
      file.value = "";
      this.look(text.value);
    });
    return dialog;
  }

  /** Shows the result of an import before it is applied. */
  private look(text: string): void {
    let note = "";
    this.imported = undefined;
    try {
      this.imported = text.trim() === "" ? undefined : firmware.importSettings(text);
    } catch (error) {
      note = `Not read: ${(error as Error).message}`;
    }
    const { what = "", taken = [], left = [] } = this.imported ?? {};
    this.preview.replaceChildren(...taken.map(({ number, value, name, unit, from }) =>
      el("tr", {}, el("td", { textContent: from }), el("td", { textContent: `$${number} ${name}` }), el("td", { className: "n", textContent: `${value} ${unit}` }))),
      ...left.map(({ text, why }) => el("tr", {}, el("td", { textContent: text }), el("td", { colSpan: 2, className: "why", textContent: `not taken: ${why}` }))));
    say("take-note", taken.length ? `${what}: ${taken.length} settings, ${left.length} lines are not taken.` : note);
  }

  /** Applies the pasted settings; changes nothing if none can be used. */
  private take(): void {
    this.look($<HTMLTextAreaElement>("paste").value);
    const { taken = [], left = [] } = this.imported ?? {};
    const note = (taken.length ? `${taken.length} settings are taken over.` : "Nothing is taken over: a setting has a line of the form $110=500.")
      + (left.length ? ` Not understood: ${left.map(({ text }) => text).join(", ").slice(0, 200)}` : "");
    say("take-note", note);
    if (taken.length === 0) return;
    this.settings.replace(Object.fromEntries(taken.map(({ number, value }) => [number, value])));
    say("settings-note", note);
    this.import_.close();
  }

  private backup(): void {
    const lines = this.description.settings.map(({ number, name }) => `$${number}=${this.settings.value(number)} (${name.replace(/[()]/g, "")})`);
    save(`oxmill-settings-${this.settings.preset.id}.txt`, `; Settings of Oxmill ${this.description.version}: import this file to restore them.\n${lines.join("\n")}\n`);
  }

  // The machine

  private update(): void {
    const { machine } = this;
    const why = machine.isConnected ? machine.whyNotAtRest : "Connect a machine first.";
    // Leave the buttons enabled in motion. The machine then refuses the request, and the page shows a note.
    allow($("read"), machine.isConnected ? undefined : why);
    allow($("compare"), machine.isConnected ? undefined : why);
    $("differs").hidden = !machine.isConnected;
    const differ = machine.isConnected ? differences(this.description.settings, machine.settings, number => this.settings.value(number)).length : 0;
    say("differs", `Differs from machine ${differ}`);
    say("compare", differ ? `Write ${differ} change${differ === 1 ? "" : "s"}…` : "Write to machine…");
    if (!machine.isConnected && this.filter === "differs") {
      this.filter = "all";
      this.find();
    }
  }

  private note(text: string): void {
    say("settings-note", text);
  }

  private async fromMachine(): Promise<void> {
    const { machine } = this;
    if (!(await machine.readSettings())) return this.note("The machine does not tell its settings now: the forecast keeps those that it has.");
    const grbl = this.description.settings.some(one => one.grbl && one.number in machine.settings) && !this.description.settings.some(one => !one.grbl && one.number in machine.settings);
    this.settings.replace(grbl ? { ...machine.settings, [DIALECT]: 0 } : machine.settings);
    this.note("The forecast has the settings of the machine.");
  }

  private buildWrite(): Dialog {
    const dialog = new Dialog("differences", "Write these settings to the machine?", [
      el("table", { className: "plain", "aria-label": "Settings that differ" }, el("thead", {}, el("tr", {}, ...["Setting", "On the machine", "New"].map((textContent, index) => el("th", { scope: "col", className: index ? "n" : "", textContent })))), el("tbody")),
      el("p", { className: "why", textContent: "The board keeps them. The old values stay in the console of this page." }),
    ]);
    const write = button("Write them", () => {}, "btn go");
    write.id = "write";
    const row = dialog.actions(write);
    row.firstElementChild?.setAttribute("id", "keep");
    return dialog;
  }

  /** Shows the settings that differ between forecast and machine, and offers to write them to the machine. */
  private async toMachine(): Promise<void> {
    const { machine, settings } = this;
    if (!(await machine.readSettings())) return this.note("The machine does not tell its settings now: nothing is written.");
    const found = differences(this.description.settings, machine.settings, number => settings.value(number));
    if (found.length === 0) return this.note("The machine has all of these settings already.");
    this.note("");
    const withUnit = (value: number, { unit }: Setting) => `${value}${unit && unit !== "mask" ? ` ${unit}` : ""}`;
    (this.write.element.querySelector("tbody") as HTMLElement).replaceChildren(...found.map(({ setting, there, here }) =>
      el("tr", {}, el("th", { scope: "row" }, setting.name, " ", el("small", { textContent: `$${setting.number}` })), el("td", { className: "n", textContent: withUnit(there, setting) }), el("td", { className: "n", textContent: withUnit(here, setting) }))));
    $("write").onclick = () => {
      this.write.close();
      void this.writeAll(found.map(({ setting, here }) => `$${setting.number}=${here}`));
    };
    this.write.open();
  }

  private async writeAll(lines: string[]): Promise<void> {
    const { machine } = this;
    const { sender } = machine;
    if (!sender) return;
    const done = await written(lines, async line => {
      machine.onsay(line, "sent");
      const answer = await sender.command(line);
      machine.onsay(answer, answer === "ok" ? "" : "wrong");
      return answer;
    });
    if (machine.sender !== sender) return;
    await machine.readSettings();
    this.note(done);
    this.find();
  }
}

const order = (group: string): number => (FIRST_GROUPS.includes(group) ? FIRST_GROUPS.indexOf(group) : FIRST_GROUPS.length);
