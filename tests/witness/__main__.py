"""Runs the firmware in labwired and prints the result for each of the firmware's beliefs about the hardware (see
`beliefs.py`): `python -m witness BOARD ELF FOLDER`, as `cargo xtask witness` does.

With `--faults` as the last argument it runs images with faults instead: a wrong clock, a wrong flash key, and wrong DMA
channels for steps and for the UART. Each fault must be detected.
"""

import sys
import time
from pathlib import Path

from virtual_board.parts import BOARDS

from . import chip, image
from .beliefs import ACTS, BELIEFS, NOT_MODELLED, clock, greets, keys, moments, served
from .machine import Broken, Machine

UARTS = {"nucleo_f411re": "usart2", "blackpill_f411": "usart1"}
KEY, CHANNEL_6, CHANNEL_5 = 0x4567_0123, 0x0C03_5100, 0x0A03_5100
STREAMS = {"usart2": 0x0800_0450, "usart1": 0x0800_2C00}
"""For each UART, the value of CR, with channel 4, of a DMA stream that serves it: the sending stream, or the
stream that receives while flash is written."""


def faults(place):
    """Yields (name, image, (constant in it, replacement) or None, belief that must fail, beliefs to check up to that
    one)."""
    stream, own = STREAMS[place.uart], place.elf
    yield "a crystal of another board", own.with_stem(f"{own.stem}-crystal"), None, clock, (greets, clock)
    yield "a wrong flash key", own, (KEY, KEY ^ 1), keys, (keys,)
    yield "steps by the requests of channel 5", own, (CHANNEL_6, CHANNEL_5), moments, (greets, moments)
    yield "the UART by the requests of channel 5", own, (stream, stream ^ 1 << 25), served, (greets, served)


class Place:
    """Files and chip description of a board."""

    def __init__(self, name, elf, folder):
        self.board, self.uart, self.elf, self.folder = BOARDS[name], UARTS[name], elf, folder
        folder.mkdir(parents=True, exist_ok=True)
        buttons = {"probe": self.board.probe, "limit_x": self.board.limits[0]}
        self.chip = chip.derived(self.board.core_hz)
        whole = chip.with_plain_registers(self.chip, "dma2") if self.uart == "usart1" else self.chip
        self.systems = {
            "whole": chip.write(folder, "whole", whole, buttons),
            "keys": chip.write(folder, "keys", chip.with_plain_registers(whole, "flash_ctrl"), buttons),
        }

    def fit(self, elf=None, fault=None):
        """Writes the image, or another one, optionally with a fault. Returns the numbers of replacements."""
        return image.fitted(elf or self.elf, self.folder / "firmware.elf", fault)

    def machine(self, check):
        """Returns a chip, not started yet, that suits this check."""
        system = self.systems["keys" if check is keys else "whole"]
        return Machine(self.folder / "firmware.elf", self.chip, system, self.uart)


def witness(place):
    """Checks each belief. Returns how many do not hold."""
    pairs, _ = place.fit()
    broken = 0
    print(f"\n{place.board.name} in labwired; {pairs} pairs of LDREXH and STREXH replaced\n\n| belief | source | by | seen |\n|---|---|---|---|")
    with place.machine(greets) as machine:
        for title, how, source, check in BELIEFS:
            try:
                if check is keys:
                    with place.machine(keys) as other:
                        seen = keys(other, place.board)
                else:
                    seen = check(machine, place.board)
            except Broken as why:
                broken, seen = broken + 1, f"DOES NOT HOLD: {why}"
            print(f"| {title} | {source} | {how} | {seen} |", flush=True)
            if check is greets and broken:
                print("Nothing more can be tried.")
                break
    return broken


def try_faults(place):
    """Tries each fault. Returns how many are not detected."""
    titles = {check: title for title, _, _, check in BELIEFS}
    missed = 0
    for name, elf, fault, wanted, checks in faults(place):
        _, sites = place.fit(elf, fault)
        seen = None
        with place.machine(checks[0]) as machine:
            for check in checks:
                try:
                    check(machine, place.board)
                except Broken as why:
                    seen = check, why
                    break
        what = f"fault: {name}" + (f" ({fault[0]:#x} becomes {fault[1]:#x}, {sites} times):" if fault else ":")
        if seen and seen[0] is wanted:
            print(f"{what} seen, {titles[wanted]}: {seen[1]}", flush=True)
        else:
            missed += 1
            print(f"{what} NOT SEEN, {f'but another belief: {titles[seen[0]]}: {seen[1]}' if seen else 'all holds'}", flush=True)
    return missed


def main(name, elf, folder, *options):
    begin = time.monotonic()
    place = Place(name, Path(elf), Path(folder))
    if "--faults" in options:
        failed = try_faults(place)
        told = "all faults seen" if not failed else f"{failed} faults not seen"
    else:
        failed = witness(place)
        acting = sum(how == ACTS for _, how, _, _ in BELIEFS)
        told = f"{len(BELIEFS) - failed} of {len(BELIEFS)} beliefs hold, {acting} of them by what labwired does"
        print("\nNot witnessed, because labwired does not model it:")
        for title, instead in NOT_MODELLED:
            print(f"- {title} ({instead})")
    print(f"\nwitness {name}: {told} ({time.monotonic() - begin:.0f} s)", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
