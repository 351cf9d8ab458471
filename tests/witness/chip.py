"""Description of the chip for labwired: the package's own STM32F411, changed with other facts from the same package.

* RCC gates: in the package's STM32F411 only four peripherals need a clock from RCC. Here each peripheral needs the
  enable bit that ST's SVD names after it (`GPIOAEN`, `TIM5EN`): without it the peripheral ignores writes.
* DMA1 and DMA2 are stubs in that STM32F411. This chip uses the stream controller model of the package's STM32F401.
* In labwired only an "advanced" timer has the bits CC1G to CC4G of EGR. According to RM0383 TIM2 to TIM5 have them
  (TIMx_EGR), so TIM5 is declared advanced; so is TIM1, which really is.
* OTG_FS is a stub in that STM32F411. This chip uses the package's STM32L476 model of the same core's registers, at the
  same address and with the same interrupt.
* A stream of the DMA model counts an item when it is switched on, although none was requested. On a board whose UART is
  served by an interrupt, the firmware takes the count of that UART's DMA2 stream as received bytes after it has written
  flash. On such a board DMA2 is therefore plain memory: registers that keep written values.
* System memory at 0x1FFF7000, which holds the part's number, is plain memory.
"""

from pathlib import Path

import labwired
import yaml

CONFIGS = Path(labwired.__file__).parent / "configs"
CHIPS = CONFIGS / "chips"
SCHEMAS = CONFIGS / "peripherals" / "stm32f411"
GATES = ("AHB1ENR", "APB1ENR", "APB2ENR")


def _load(path):
    return yaml.safe_load(path.read_text())


def fields(peripheral):
    """Returns offset and fields (name: (lowest bit, mask)) of each register, by ST's names."""
    registers = {}
    for register in _load(SCHEMAS / f"{peripheral}.yaml")["registers"]:
        bits = {f["name"]: (f["bit_range"][1], (2 << f["bit_range"][0] - f["bit_range"][1]) - 1) for f in register["fields"]}
        registers[register["id"]] = (register["address_offset"], bits)
    return registers


def bases(chip):
    """Returns the address of each peripheral."""
    return {peripheral["id"]: peripheral["base_address"] for peripheral in chip["peripherals"]}


def derived(core_hz):
    """Returns the chip's description."""
    chip = _load(CHIPS / "stm32f411ceu6.yaml")
    streams = {p["id"]: p for p in _load(CHIPS / "stm32f401.yaml")["peripherals"] if p["id"].startswith("dma")}
    rcc = fields("rcc")
    chip["cpu_hz"] = core_hz
    for peripheral in chip["peripherals"]:
        name = peripheral["id"]
        config = peripheral.setdefault("config", {})
        if name.startswith("dma"):
            peripheral["type"] = streams[name]["type"]
            config.update({key: value for key, value in streams[name]["config"].items() if key != "debug_schema"})
        if name in ("tim1", "tim5"):
            config["advanced"] = True
        if "debug_schema" in config:
            config["debug_schema"] = str((CHIPS / config["debug_schema"]).resolve())
        for register in GATES:
            if bit := rcc[register][1].get(f"{name.upper()}EN"):
                peripheral["clock"] = {"reg": register.lower(), "bit": bit[0]}
    usb = next(p for p in _load(CHIPS / "stm32l476.yaml")["peripherals"] if p["type"] == "usb_otg")
    del usb["config"]
    chip["peripherals"] = [p for p in chip["peripherals"] if not p["id"].startswith("otg")] + [usb]
    chip["memory_regions"] = [{"name": "system", "base": 0x1FFF_7000, "size": "4KB"}]
    return chip


def with_plain_registers(chip, name):
    """Returns the same chip with plain memory in place of a peripheral's registers."""
    peripheral = next(p for p in chip["peripherals"] if p["id"] == name)
    memory = {"name": name, "base": peripheral["base_address"], "size": peripheral["size"]}
    others = [p for p in chip["peripherals"] if p is not peripheral]
    return chip | {"peripherals": others, "memory_regions": [*chip["memory_regions"], memory]}


def write(folder, name, chip, buttons):
    """Writes the files of chip and system; `buttons` are inputs (name: pin such as "C7") that a test presses. Returns
    the path of the system."""
    (folder / f"{name}-chip.yaml").write_text(yaml.safe_dump(chip, sort_keys=False))
    system = {
        "name": "witness",
        "chip": f"{name}-chip.yaml",
        "external_devices": [],
        "board_io": [
            {"id": name, "kind": "button", "peripheral": f"gpio{pin[0].lower()}", "pin": int(pin[1:]), "signal": "input", "active_high": False}
            for name, pin in buttons.items()
        ],
    }
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(system, sort_keys=False))
    return path
