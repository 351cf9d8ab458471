// The dialog that loads firmware into a board over USB (WebUSB). The image comes from the site, or from a .dfu file of
// a release or of `cargo fw`. The image keeps its own pin table, or gets one that the user has chosen.
import { allow, button, el, onclick, save, say } from "./dom";
import { type Firmware, load, LOADER, parse, type Usb, type UsbDevice } from "./dfu";
import { Dialog } from "./dialogs";
import type { Pins } from "./engine";
import { checkPins, pinsIn, pinsOf, writePins } from "./firmware";
import type { Machine } from "./machine";

/** Maximum size of a firmware file, in bytes: twice the flash of the largest chip. */
const LARGEST = 4 * 2 ** 20;
/** Maximum size of a pin table, in bytes. */
const LARGEST_TABLE = 2 ** 16;
/** Flash that holds the settings: sectors 1 and 2. */
const SETTINGS = { from: 0x0800_4000, to: 0x0800_c000 };
const DOING = { erase: "Erasing", write: "Writing", verify: "Reading back" };

/** An image that the site carries. `board`: the board's name, such as blackpill_f411; `title`: the name that the user
 * sees. */
interface Image { board: string; title: string }

/** Returns the browser's WebUSB interface; `undefined` in a browser without WebUSB. */
const usb = (): Usb | undefined => (navigator as { usb?: Usb }).usb;

/** Gets a file of the site. The browser checks a cached copy with the server first, because page, list and images must
 * be of one release. */
async function download(name: string): Promise<Response> {
  const answer = await fetch(name, { cache: "no-cache" }).catch(() => undefined);
  if (!answer?.ok) throw new Error(`The site does not give ${name}${answer ? ` (${answer.status})` : ": is the network there?"}`);
  return answer;
}

/** Returns the images that the site carries. The single-file page, and a site without a network, have none. */
async function carried(): Promise<Image[]> {
  const list = document.querySelector<HTMLMetaElement>("meta[name=oxmill-firmware]")?.content;
  if (!list) return [];
  const images: unknown = await download(list).then(answer => answer.json()).catch(() => []);
  return Array.isArray(images) ? images.filter(image => typeof image?.board === "string" && /^\w+$/.test(image.board) && typeof image.title === "string") : [];
}

async function contents(file: File, largest: number, what: string): Promise<Uint8Array> {
  if (file.size > largest) throw new Error(`${file.name} is too large to be ${what}.`);
  return new Uint8Array(await file.arrayBuffer());
}

/** An image or a pin table that the user has chosen, and that is then downloaded or read from a file. */
class Choice<T> {
  value?: T;
  /** Why the value could not be read or downloaded. */
  why?: string;
  isComing = false;
  private count = 0;

  constructor(private readonly changed: () => void) {}

  get isMade(): boolean {
    return this.isComing || this.value !== undefined || this.why !== undefined;
  }

  /** Sets the value to the result of `get`, unless the user makes another choice in the meantime. Without `get`, clears
   * the choice. */
  async take(get?: () => Promise<T>): Promise<void> {
    const count = ++this.count;
    [this.value, this.why, this.isComing] = [undefined, undefined, get !== undefined];
    this.changed();
    if (!get) return;
    const [value, why] = await get().then(value => [value, undefined] as const, (error: Error) => [undefined, error.message] as const);
    if (count !== this.count) return;
    [this.value, this.why, this.isComing] = [value, why, false];
    this.changed();
  }
}

/** An image that can be loaded. `name`: the name in its pin table; `pins`: the pin table that the user has chosen. */
interface Ready { firmware: Firmware; bytes: Uint8Array; name: string; pins?: Pins }

export class LoadFirmware {
  private readonly dialog: Dialog;
  private readonly board = el("select", { id: "firmware-board", "aria-label": "Board" });
  private readonly boards = el("span", { hidden: true }, "Choose your board: ", this.board, " or a file of your own. ");
  private readonly file = el("input", { type: "file", accept: ".dfu", id: "firmware-file", "aria-label": "Firmware file" });
  private readonly pinsFile = el("input", { type: "file", accept: ".toml", id: "firmware-pins", "aria-label": "Pin table" });
  private readonly ownPins = button("Save the board's pin table", () => this.savePins());
  private readonly noPins = button("Use the board's own pins", () => void this.pins.take());
  private readonly saver = button("Save this image", () => this.ready && save(`${this.ready.name}.dfu`, this.ready.bytes));
  private readonly otherPins = el("details", { id: "firmware-other-pins" }, el("summary", { textContent: "Other pins than those of the board" }),
    el("p", { className: "note" }, "Save the pin table of the board, change its name and its pins with a text editor, and choose it here. It is checked before anything is loaded. Nothing can check where your wires are: test each output before the spindle has power."),
    this.ownPins, this.pinsFile, this.noPins, this.saver);
  private readonly loader = button("Start the boot loader of the connected board", () => void this.restart());
  private readonly go = button("Choose the boot loader and load…", () => void this.load(), "btn primary");
  private readonly bar = el("progress", { id: "firmware-progress", max: 1, value: 0, hidden: true, "aria-label": "Progress" });
  private readonly note = el("p", { className: "note", id: "firmware-note", role: "status" });
  private readonly about = el("p", { className: "note", id: "firmware-connected" });
  private readonly cancel = button("Cancel", () => void this.device?.close());
  private readonly image = new Choice<Uint8Array>(() => this.combine());
  /** The text of the pin table that the user has chosen. */
  private readonly pins = new Choice<string>(() => this.combine());
  /** The chosen image with the chosen pin table, if neither has a fault. */
  private ready?: Ready;
  private device?: UsbDevice;
  private isLoading = false;
  private isRestarting = false;
  private images?: Promise<Image[]>;
  private hasPreselected = false;
  /** Name of the connected board, or of the one connected last, as the board reports it; empty if unknown. */
  private connected = "";

  constructor(private readonly machine: Machine) {
    const steps = el("ol", { className: "steps" },
      el("li", {}, "Switch off the supply of motors and spindle. In the boot loader, outputs are not driven."),
      el("li", {}, this.boards, "Choose the file for your board, such as blackpill_f411.dfu: ", this.file, this.about, this.otherPins),
      el("li", {}, "Start the boot loader: hold BOOT0, press and release NRST, release BOOT0. Firmware of Oxmill does it on a command: ", this.loader),
      el("li", {}, "Load: your browser asks which device. It is called STM32 BOOTLOADER. ", this.go));
    const none = el("p", { className: "finding bad", id: "firmware-nousb", hidden: usb() !== undefined },
      "This browser has no WebUSB. Chrome and Edge have it; dfu-util loads the same file from a command line.");
    const help = el("details", {}, el("summary", { textContent: "The browser lists no device" }), el("ul", {},
      el("li", { textContent: "Linux: allow access once. sudo tee /etc/udev/rules.d/50-stm32-dfu.rules <<< 'SUBSYSTEM==\"usb\", ATTR{idVendor}==\"0483\", ATTR{idProduct}==\"df11\", MODE=\"0666\"', then plug the board in again." }),
      el("li", { textContent: "Windows: give the device STM32 BOOTLOADER the driver WinUSB, with the program Zadig." }),
      el("li", { textContent: "Use a cable with data wires, and a port of the computer itself." })));
    this.dialog = new Dialog("firmware-dialog", "Load firmware into a board", [none, steps, this.bar, this.note, this.cancel, help], true);
    this.dialog.actions();
    onclick("open-firmware", () => {
      this.show();
      this.dialog.open();
      void this.offer();
    });
    this.board.addEventListener("change", () => this.choose(this.board.value));
    this.file.addEventListener("change", () => {
      const file = taken(this.file);
      if (!file) return;
      this.board.value = "";
      void this.image.take(() => contents(file, LARGEST, "firmware"));
    });
    this.pinsFile.addEventListener("change", () => {
      const file = taken(this.pinsFile);
      if (file) void this.pins.take(async () => new TextDecoder().decode(await contents(file, LARGEST_TABLE, "a pin table")));
    });
    machine.onchange(() => this.dialog.isOpen && this.follow());
    addEventListener("beforeunload", event => this.isLoading && event.preventDefault());
  }

  /** Offers the images that the site carries. */
  private async offer(): Promise<void> {
    const first = this.images === undefined;
    const images = await (this.images ??= carried());
    if (first) {
      this.board.replaceChildren(new Option("Choose…", ""), ...images.map(({ board, title }) => new Option(title, board)));
      this.boards.hidden = images.length === 0;
    }
    this.follow();
    // The network may be available next time: request the list again then.
    if (images.length === 0) this.images = undefined;
  }

  /** Updates the dialog after a change of the machine. Preselects the image of the connected board, but only once. */
  private follow(): void {
    const name = this.machine.isSerial ? this.machine.boardName : this.connected;
    if (name !== this.connected && !this.isLoading) {
      this.connected = name;
      this.combine();
    }
    if (this.machine.isSerial && !this.image.isMade && !this.hasPreselected && name && [...this.board.options].some(({ value }) => value === name)) {
      this.hasPreselected = true;
      this.board.value = name;
      this.choose(name);
    }
    this.show();
  }

  /** Gets the image of a board from the site. */
  private choose(board: string): void {
    void this.image.take(board === "" ? undefined : async () => {
      const bytes = new Uint8Array(await (await download(`firmware/${board}.dfu`)).arrayBuffer());
      if (pinsIn(bytes) !== board) throw new Error(`The site gives another image than that of ${board}.`);
      return bytes;
    });
  }

  /** The reason why firmware cannot be loaded or saved now; `undefined` if it can. */
  private get whyNot(): string | undefined {
    if (this.isLoading) return "Firmware is being loaded.";
    if (this.ready) return undefined;
    return this.image.value ? "The image or the pin table has a fault." : "Choose a board or a file first.";
  }

  private show(): void {
    // Forget the restart: a board that has disconnected sends no answer to it.
    if (!this.machine.isConnected) this.isRestarting = false;
    allow(this.loader, this.isLoading ? "Firmware is being loaded." : !this.machine.isSerial ? "No board is connected." : this.isRestarting ? "The board restarts." : undefined);
    this.cancel.hidden = !this.isLoading;
    this.dialog.isHeld = this.isLoading;
    allow(this.go, usb() ? this.whyNot : "This browser has no WebUSB: use Chrome or Edge, or dfu-util.");
    say(this.go, this.warning ? "Choose the boot loader and load it all the same…" : "Choose the boot loader and load…");
    this.file.disabled = this.board.disabled = this.pinsFile.disabled = this.noPins.disabled = this.isLoading;
    allow(this.ownPins, this.image.value ? undefined : "Choose a board or a file first.");
    allow(this.saver, this.whyNot);
    this.noPins.hidden = !this.pins.isMade;
    if (this.pins.isMade) this.otherPins.open = true;
    this.about.hidden = !this.machine.isSerial && !this.connected;
    say(this.about, this.connected ? `The board that ${this.machine.isSerial ? "is" : "was"} connected: ${this.connected}.` : "The connected board does not say which board it is.");
  }

  private tell(text: string, isGood?: boolean): void {
    this.note.className = isGood === undefined ? "note" : `finding ${isGood ? "good" : "bad"}`;
    say(this.note, text);
  }

  /** Combines image and pin table into `ready`, and shows what they are, or what is wrong with them. */
  private combine(): void {
    this.ready = undefined;
    const { image, pins } = this;
    try {
      if (image.why) throw new Error(image.why);
      const own = image.value && parse(image.value);
      if (pins.why) throw new Error(pins.why);
      const table = pins.value === undefined ? undefined : readTable(pins.value);
      if (image.isComing || pins.isComing) {
        this.tell(image.isComing ? "Getting the image…" : "Reading the pin table…");
      } else if (own && image.value) {
        const bytes = table && pins.value !== undefined ? writePins(pins.value, image.value) : image.value;
        const firmware = table ? parse(bytes) : own;
        this.ready = { firmware, bytes, name: pinsIn(bytes) ?? "firmware", pins: table };
        this.describe(this.ready);
      } else {
        this.tell(table ? `The pin table of ${table.name}: no fault in ${table.pins} pins. It is for the image ${table.image}.` : "");
      }
    } catch (error) {
      this.tell((error as Error).message, false);
    }
    this.show();
  }

  private describe({ firmware, pins }: Ready): void {
    const bytes = firmware.ranges.reduce((all, one) => all + one.bytes.length, 0);
    const settings = keepsSettings(firmware) ? "" : " It overwrites the settings of the board.";
    const isProjects = pins && this.pins.value !== pinsOf(pins.name) && pinsOf(pins.name) !== undefined;
    const rename = isProjects ? ` ${pins.name} is the name of another pin table: give yours a name of its own.` : "";
    this.tell(`${firmware.name}, ${(bytes / 1024).toFixed(0)} KiB.${this.withPins}${rename}${settings}${this.warning}`, this.warning ? false : undefined);
  }

  /** A sentence about the pin table of the firmware. Empty if the name of the firmware already names the table's
   * board. */
  private get withPins(): string {
    const { ready } = this;
    if (!ready || ready.firmware.name === `Oxmill for ${ready.name}`) return "";
    return ready.name === "firmware" ? " It has no pin table: it is firmware of another project." : ` With the pins of ${ready.name}.`;
  }

  /** A warning if the firmware is for another board than the connected one; otherwise empty. The image of the
   * connected board with other pins, chosen by the user, causes no warning. */
  private get warning(): string {
    const { ready, connected } = this;
    if (!ready || !connected || ready.name === connected) return "";
    if (ready.pins && this.image.value && pinsIn(this.image.value) === connected) return "";
    return ` The board that was connected calls itself ${connected}. On the wrong board, an output can start a motor or the spindle.`;
  }

  private savePins(): void {
    const name = this.image.value && pinsIn(this.image.value);
    const table = name && pinsOf(name);
    if (table) save(`${name}.toml`, table);
    else this.tell(name ? `The pins of ${name} are no pin table of this page: take the file that they were made from.` : "This image has no pin table.", false);
  }

  /** Restarts the connected board into its boot loader, and disconnects. The boot loader listens on all its links, so
   * the page's status requests would disturb it. */
  private async restart(): Promise<void> {
    this.isRestarting = true;
    this.show();
    const answer = await this.machine.line("$DFU");
    if (answer === "ok") {
      this.machine.leave();
      this.tell(`The board is in its boot loader now. Continue with step 4.${this.warning}`, this.warning ? false : undefined);
    } else {
      const meaning = this.machine.meanings?.(answer);
      this.tell(`The board stays as it is: ${meaning ?? answer} Its messages are in the console. Or use BOOT0 and NRST.`, false);
    }
    this.isRestarting = false;
    this.show();
  }

  private async load(): Promise<void> {
    const { ready } = this;
    if (!ready || this.isLoading) return;
    const { firmware } = ready;
    const pins = ready.pins ? ` With the pins of ${ready.name}.` : "";
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
      this.connected = "";
      this.tell(`${firmware.name} is loaded and was read back without a difference.${pins}${settings} The board starts it now; if not, press NRST.`, true);
    } catch (error) {
      this.tell((error as Error).message, false);
    }
    this.device = undefined;
    this.isLoading = false;
    this.bar.hidden = true;
    this.show();
  }
}

/** Returns `true` if loading the firmware does not erase the flash that holds the settings. */
const keepsSettings = ({ ranges }: Firmware): boolean => ranges.every(({ address, bytes }) => address >= SETTINGS.to || address + bytes.length <= SETTINGS.from);

function readTable(text: string): Pins {
  try {
    return checkPins(text);
  } catch (error) {
    throw new Error(`The pin table has faults:\n${(error as Error).message}`);
  }
}

/** Returns the chosen file of an input. Empties the input, so that the same file can be chosen again. */
function taken(input: HTMLInputElement): File | undefined {
  const [file] = input.files ?? [];
  input.value = "";
  return file;
}
