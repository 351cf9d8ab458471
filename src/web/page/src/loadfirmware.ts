// The dialog that loads firmware into a board over USB (WebUSB), from a .dfu file of a release or of `cargo fw`.
import { allow, button, el, onclick, say } from "./dom";
import { type Firmware, load, LOADER, parse, type Usb, type UsbDevice } from "./dfu";
import { Dialog } from "./dialogs";
import type { Machine } from "./machine";

/** Maximum size of a file, in bytes: the flash of the largest chip, twice. */
const LARGEST = 4 * 2 ** 20;
/** Flash that holds the settings: sectors 1 and 2. */
const SETTINGS = { from: 0x0800_4000, to: 0x0800_c000 };
const DOING = { erase: "Erasing", write: "Writing", verify: "Reading back" };

/** Returns the browser's access to USB devices, if it has any. */
const usb = (): Usb | undefined => (navigator as { usb?: Usb }).usb;

export class LoadFirmware {
  private readonly dialog: Dialog;
  private readonly file = el("input", { type: "file", accept: ".dfu", id: "firmware-file", "aria-label": "Firmware file" });
  private readonly loader = button("Start the boot loader of the connected board", () => void this.restart());
  private readonly go = button("Choose the boot loader and load…", () => void this.load(), "btn primary");
  private readonly bar = el("progress", { id: "firmware-progress", max: 1, value: 0, hidden: true, "aria-label": "Progress" });
  private readonly note = el("p", { className: "note", id: "firmware-note", role: "status" });
  private readonly cancel = button("Cancel", () => void this.device?.close());
  private firmware?: Firmware;
  private device?: UsbDevice;
  private isLoading = false;
  private isRestarting = false;
  /** Number of the last choice of a file. */
  private choices = 0;

  constructor(private readonly machine: Machine) {
    const steps = el("ol", { className: "steps" },
      el("li", {}, "Switch off the supply of motors and spindle. In the boot loader, outputs are not driven."),
      el("li", {}, "Choose the file for your board, such as blackpill_f411.dfu: ", this.file),
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
    });
    this.file.addEventListener("change", () => void this.read());
    machine.onchange(() => this.dialog.isOpen && this.show());
    addEventListener("beforeunload", event => this.isLoading && event.preventDefault());
  }

  private show(): void {
    // A board that is gone does not answer.
    if (!this.machine.isConnected) this.isRestarting = false;
    allow(this.loader, !this.machine.isSerial ? "No board is connected." : this.isRestarting ? "The board restarts." : undefined);
    this.cancel.hidden = !this.isLoading;
    this.dialog.isHeld = this.isLoading;
    allow(this.go, !usb() ? "This browser has no WebUSB: use Chrome or Edge, or dfu-util." : !this.firmware ? "Choose a file first." : this.isLoading ? "Firmware is being loaded." : undefined);
    this.file.disabled = this.isLoading;
    if (!usb()) this.tell("This browser has no WebUSB. Chrome and Edge have it; dfu-util loads the same file from a command line.", false);
  }

  private tell(text: string, isGood?: boolean): void {
    this.note.className = isGood === undefined ? "note" : `finding ${isGood ? "good" : "bad"}`;
    say(this.note, text);
  }

  private async read(): Promise<void> {
    const choice = ++this.choices;
    this.firmware = undefined;
    const [file] = this.file.files ?? [];
    this.tell("");
    try {
      if (file && file.size > LARGEST) throw new Error("This file is too large to be firmware.");
      const firmware = file && parse(new Uint8Array(await file.arrayBuffer()));
      if (choice !== this.choices) return;
      this.firmware = firmware;
      if (firmware) {
        const bytes = firmware.stretches.reduce((all, one) => all + one.bytes.length, 0);
        this.tell(`${firmware.name}, ${(bytes / 1024).toFixed(0)} KiB.${keepsSettings(firmware) ? "" : " It overwrites the settings of the board."}`);
      }
    } catch (error) {
      if (choice === this.choices) this.tell((error as Error).message, false);
    }
    this.show();
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
