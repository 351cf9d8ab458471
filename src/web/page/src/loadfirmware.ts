// The dialog that loads firmware into a board over USB (WebUSB): the images that the site carries, or a .dfu file of a
// release or of `cargo fw`.
import { allow, button, el, onclick, save, say } from "./dom";
import { type Firmware, load, LOADER, parse, type Usb, type UsbDevice } from "./dfu";
import { Dialog } from "./dialogs";
import type { Pins } from "./engine";
import { checkPins, pinsOf, writePins } from "./firmware";
import type { Machine } from "./machine";

/** Maximum size of a file, in bytes: the flash of the largest chip, twice. */
const LARGEST = 4 * 2 ** 20;
/** Maximum size of a pin table, in bytes. */
const LARGEST_TABLE = 2 ** 16;
/** Flash that holds the settings: sectors 1 and 2. */
const SETTINGS = { from: 0x0800_4000, to: 0x0800_c000 };
const DOING = { erase: "Erasing", write: "Writing", verify: "Reading back" };

/** An image that the site carries. */
interface Image { board: string; title: string; file: string }

/** Returns the browser's access to USB devices, if it has any. */
const usb = (): Usb | undefined => (navigator as { usb?: Usb }).usb;

/** Returns the images that the site carries. The single-file page, and a site without a network, have none. */
async function carried(): Promise<Image[]> {
  const list = document.querySelector<HTMLMetaElement>("meta[name=oxmill-firmware]")?.content;
  if (!list) return [];
  return fetch(list).then(answer => (answer.ok ? answer.json() : []), () => []);
}

/** Gets an image from the site. */
async function download({ file }: Image): Promise<Uint8Array> {
  const answer = await fetch(file).catch(() => undefined);
  if (!answer?.ok) throw new Error(`The site does not give ${file}${answer ? ` (${answer.status})` : ": is the network there?"}`);
  return new Uint8Array(await answer.arrayBuffer());
}

/** Reads a file, which has to be smaller than `largest` bytes. */
async function contents(file: File, largest: number, what: string): Promise<Uint8Array> {
  if (file.size > largest) throw new Error(`This file is too large to be ${what}.`);
  return new Uint8Array(await file.arrayBuffer());
}

/** Returns the board that an image is for, by the image's own name; `undefined` for an image of another project. */
const boardOf = ({ name }: Firmware): string | undefined => /^Oxmill for (\w+)$/.exec(name)?.[1];

export class LoadFirmware {
  private readonly dialog: Dialog;
  private readonly board = el("select", { id: "firmware-board", "aria-label": "Board" });
  private readonly boards = el("span", { hidden: true }, "Choose your board: ", this.board, " or a file of your own. ");
  private readonly file = el("input", { type: "file", accept: ".dfu", id: "firmware-file", "aria-label": "Firmware file" });
  private readonly pinsFile = el("input", { type: "file", accept: ".toml", id: "firmware-pins", "aria-label": "Pin table" });
  private readonly ownPins = button("Save the board's pin table", () => this.savePins());
  private readonly noPins = button("Use the board's own pins", () => this.forgetPins());
  private readonly saver = button("Save this image", () => this.saveImage());
  private readonly loader = button("Start the boot loader of the connected board", () => void this.restart());
  private readonly go = button("Choose the boot loader and load…", () => void this.load(), "btn primary");
  private readonly bar = el("progress", { id: "firmware-progress", max: 1, value: 0, hidden: true, "aria-label": "Progress" });
  private readonly note = el("p", { className: "note", id: "firmware-note", role: "status" });
  private readonly cancel = button("Cancel", () => void this.device?.close());
  /** The chosen image, as it is in its file. */
  private image?: Uint8Array;
  /** Text of the chosen pin table. */
  private pins?: string;
  /** What is to be loaded: the chosen image, with the chosen pin table. */
  private firmware?: Firmware;
  /** The chosen pin table, if it has no faults. */
  private table?: Pins;
  private device?: UsbDevice;
  private isLoading = false;
  private isRestarting = false;
  /** Number of the last choice of a board or a file. */
  private choices = 0;
  private images: Image[] = [];
  /** Name of the board that was connected last, as it gives it itself. */
  private connected?: string;

  constructor(private readonly machine: Machine) {
    const pins = el("details", { id: "firmware-other-pins" }, el("summary", { textContent: "Other pins than those of the board" }),
      el("p", { className: "note" }, "Save the pin table of the board, change it with a text editor, and choose it here. It is checked before anything is loaded."),
      el("p", { className: "actions-row" }, this.ownPins, this.pinsFile, this.noPins, this.saver));
    const steps = el("ol", { className: "steps" },
      el("li", {}, "Switch off the supply of motors and spindle. In the boot loader, outputs are not driven."),
      el("li", {}, this.boards, "The file for your board, such as blackpill_f411.dfu: ", this.file, pins),
      el("li", {}, "Start the boot loader: hold BOOT0, press and release NRST, release BOOT0. Firmware of Oxmill does it on a command: ", this.loader),
      el("li", {}, "Load: your browser asks which device. It is called STM32 BOOTLOADER. ", this.go));
    const help = el("details", {}, el("summary", { textContent: "The browser lists no device" }), el("ul", {},
      el("li", { textContent: "Linux: allow access once. sudo tee /etc/udev/rules.d/50-stm32-dfu.rules <<< 'SUBSYSTEM==\"usb\", ATTR{idVendor}==\"0483\", ATTR{idProduct}==\"df11\", MODE=\"0666\"', then plug the board in again." }),
      el("li", { textContent: "Windows: give the device STM32 BOOTLOADER the driver WinUSB, with the program Zadig." }),
      el("li", { textContent: "Use a cable with data wires, and a port of the computer itself." })));
    this.dialog = new Dialog("firmware-dialog", "Load firmware into a board", [steps, this.bar, this.note, this.cancel, help], true);
    this.dialog.actions();
    onclick("open-firmware", () => {
      this.show();
      this.dialog.open();
      void this.prepare();
    });
    this.board.addEventListener("change", () => this.choose());
    this.file.addEventListener("change", () => {
      const [file] = this.file.files ?? [];
      this.board.value = "";
      void this.take(async () => file && contents(file, LARGEST, "firmware"));
    });
    this.pinsFile.addEventListener("change", () => void this.takePins());
    machine.onchange(() => this.dialog.isOpen && this.show());
    addEventListener("beforeunload", event => this.isLoading && event.preventDefault());
  }

  /** Why nothing can be loaded now; `undefined` if something can. */
  private get whyNot(): string | undefined {
    if (!usb()) return "This browser has no WebUSB: use Chrome or Edge, or dfu-util.";
    if (this.isLoading) return "Firmware is being loaded.";
    if (!this.image) return "Choose a board or a file first.";
    return this.firmware ? undefined : "The image or the pin table has a fault.";
  }

  private show(): void {
    // A board that is gone does not answer.
    if (!this.machine.isConnected) this.isRestarting = false;
    allow(this.loader, !this.machine.isSerial ? "No board is connected." : this.isRestarting ? "The board restarts." : undefined);
    this.cancel.hidden = !this.isLoading;
    this.dialog.isHeld = this.isLoading;
    allow(this.go, this.whyNot);
    this.go.textContent = this.warning ? "Choose the boot loader and load it all the same…" : "Choose the boot loader and load…";
    this.file.disabled = this.board.disabled = this.pinsFile.disabled = this.isLoading;
    allow(this.ownPins, this.image ? undefined : "Choose a board or a file first.");
    allow(this.saver, this.firmware ? undefined : this.image ? "The image or the pin table has a fault." : "Choose a board or a file first.");
    this.noPins.hidden = this.pins === undefined;
    this.noPins.disabled = this.isLoading;
    if (!usb() && !this.image) this.tell("This browser has no WebUSB. Chrome and Edge have it; dfu-util loads the same file from a command line.", false);
  }

  private tell(text: string, isGood?: boolean): void {
    this.note.className = isGood === undefined ? "note" : `finding ${isGood ? "good" : "bad"}`;
    say(this.note, text);
  }

  /** Finds out which images there are, and which board is connected; chooses the image for that board. */
  private async prepare(): Promise<void> {
    if (this.images.length === 0) {
      this.images = await carried();
      this.board.replaceChildren(new Option("Choose…", ""), ...this.images.map(({ board, title }) => new Option(title, board)));
      this.boards.hidden = this.images.length === 0;
    }
    if (!this.machine.isSerial || this.machine.whyNotAtRest) return;
    const { choices } = this;
    const { said } = await this.machine.query("$I+");
    this.connected = said.map(line => /^\[BOARD:(\w+)\]$/.exec(line)?.[1]).find(Boolean);
    if (choices !== this.choices) return;
    if (this.image) {
      this.combine();
    } else if (this.images.some(({ board }) => board === this.connected)) {
      this.board.value = this.connected ?? "";
      this.choose();
    }
  }

  /** Gets the image of the chosen board. */
  private choose(): void {
    const image = this.images.find(({ board }) => board === this.board.value);
    this.file.value = "";
    void this.take(async () => image && download(image), image?.board);
  }

  /** Takes an image, which must be for `board` if that is given. */
  private async take(get: () => Promise<Uint8Array | undefined>, board?: string): Promise<void> {
    const choice = ++this.choices;
    this.image = undefined;
    this.combine();
    try {
      const image = await get();
      if (choice !== this.choices) return;
      const firmware = image && parse(image);
      if (firmware && board !== undefined && boardOf(firmware) !== board) throw new Error(`The site gives another image than that of ${board}: ${firmware.name}.`);
      this.image = image;
      this.combine();
    } catch (error) {
      if (choice === this.choices) this.tell((error as Error).message, false);
    }
  }

  /** Takes the chosen pin table. */
  private async takePins(): Promise<void> {
    const choice = ++this.choices;
    const [file] = this.pinsFile.files ?? [];
    try {
      const text = file && new TextDecoder().decode(await contents(file, LARGEST_TABLE, "a pin table"));
      if (choice !== this.choices) return;
      this.pins = text;
    } catch (error) {
      if (choice !== this.choices) return;
      this.forgetPins();
      this.tell((error as Error).message, false);
      return;
    }
    this.combine();
  }

  private forgetPins(): void {
    this.pinsFile.value = "";
    this.pins = undefined;
    this.combine();
  }

  private savePins(): void {
    const board = this.image && boardOf(parse(this.image));
    try {
      save(`${board}.toml`, pinsOf(board ?? ""));
    } catch {
      this.tell(`This page does not know the board of this image${board ? `, ${board}` : ""}. A release that has the image has its pin table, too.`, false);
    }
  }

  private saveImage(): void {
    if (!this.image) return;
    const name = this.table?.name ?? boardOf(parse(this.image)) ?? "firmware";
    save(`${name}.dfu`, this.table && this.pins !== undefined ? writePins(this.pins, this.image) : this.image);
  }

  /** Puts image and pin table together, and says what they are. */
  private combine(): void {
    this.firmware = this.table = undefined;
    try {
      const table = this.pins === undefined ? undefined : checkPins(this.pins);
      if (this.image) {
        const firmware = parse(table && this.pins !== undefined ? writePins(this.pins, this.image) : this.image);
        this.firmware = firmware;
        this.table = table;
        const bytes = firmware.stretches.reduce((all, one) => all + one.bytes.length, 0);
        const pins = table ? ` With the pins of ${table.name}, ${table.pins} of them.` : "";
        const settings = keepsSettings(firmware) ? "" : " It overwrites the settings of the board.";
        this.tell(`${firmware.name}, ${(bytes / 1024).toFixed(0)} KiB.${pins}${settings}${this.warning}`, this.warning ? false : undefined);
      } else {
        this.tell(table ? `The pin table of ${table.name}: no fault in ${table.pins} pins. It is for the image ${table.image}.` : "");
      }
    } catch (error) {
      this.tell(this.pins === undefined ? (error as Error).message : `The pin table: ${(error as Error).message}`, false);
    }
    this.show();
  }

  /** A warning if the firmware is for another board than the connected one; empty otherwise. */
  private get warning(): string {
    const wanted = this.table?.name ?? (this.firmware && boardOf(this.firmware));
    if (!this.firmware || !this.connected || wanted === this.connected) return "";
    return ` The board that was connected calls itself ${this.connected}. On the wrong board, an output can start a motor or the spindle.`;
  }

  /** Sends the connected board into its boot loader, and leaves the board: reports that are asked for would disturb a
   * boot loader that listens on all its links. */
  private async restart(): Promise<void> {
    this.isRestarting = true;
    this.show();
    const answer = await this.machine.line("$DFU");
    if (answer === "ok") {
      this.machine.leave();
      this.tell("The board is in its boot loader now. Continue with step 4.");
    } else {
      const meaning = this.machine.meanings?.(answer);
      this.tell(`The board stays as it is: ${meaning ?? answer} Its messages are in the console. Or use BOOT0 and NRST.`, false);
    }
    this.isRestarting = false;
    this.show();
  }

  private async load(): Promise<void> {
    const firmware = this.firmware;
    if (!firmware || this.isLoading) return;
    this.isLoading = true;
    this.show();
    try {
      this.device = await (usb() as Usb).requestDevice({ filters: [LOADER] }).catch(() => undefined);
      if (!this.device) throw new Error("No device was chosen. Is the board in its boot loader?");
      this.bar.hidden = false;
      await load(this.device, firmware, (what, done, of) => {
        this.bar.value = done / of;
        this.tell(`${DOING[what]}: ${Math.floor((100 * done) / of)} %`);
      });
      const settings = keepsSettings(firmware) ? " The settings of the board are kept." : "";
      this.tell(`${firmware.name} is loaded and was read back without a difference.${settings} The board starts it now; if not, press NRST.`, true);
    } catch (error) {
      this.tell((error as Error).message, false);
    }
    this.device = undefined;
    this.isLoading = false;
    this.bar.hidden = true;
    this.show();
  }
}

/** Whether firmware leaves the sectors of the settings as they are. */
const keepsSettings = ({ stretches }: Firmware): boolean => stretches.every(({ address, bytes }) => address >= SETTINGS.to || address + bytes.length <= SETTINGS.from);
