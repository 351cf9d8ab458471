"""Runs the suite `loopback` of tests/on_target on an emulated board: `python -m virtual_board.loopback BOARD ELF`, as
`cargo xtask virtual` does.

With correct wiring the suite must pass. It must also fail, for the right reason, with a missing wire, with swapped
wires, and with wires that lose, delay or stretch pulses. The suite's log is read from the RTT buffer, as a debug probe
does, and printed by `defmt-print`.
"""

import subprocess
import sys
import time

from .board import Board, Failure, Image
from .parts import BOARDS

LONGEST_S = 3.0
"""Emulated time, s, after which an unfinished suite is ended."""
CONTROL_BLOCK = "_SEGGER_RTT"
BUFFER, SIZE, WRITTEN, READ = 28, 32, 36, 40
"""Offsets, in the RTT control block, of the words of the first up-channel (defmt-rtt, `Header` and `Channel`)."""


def wires(wiring):
    """Returns the wires as {output: input} for STEP X, DIR X and STEP Y, independently of the suite's own table."""
    return {wiring.step[0]: "B6", wiring.direction[0]: "B7", wiring.step[1]: "B8"}


class Wires:
    """Carries each change of an output to its input. `late(output, pulse, level)` returns the seconds by which an edge
    is delayed, or None to lose it; pulses count from 1."""

    def __init__(self, board, wires, late):
        self.board, self.wires, self.late = board, wires, late
        self.pulses = dict.fromkeys(wires, 0)
        self.under_way = []
        board.watchers.append(self.edge)

    def edge(self, edge):
        _, port, pin, level = edge
        output = f"{port}{pin}"
        if output not in self.wires or level not in (0, 1, None):
            return
        self.pulses[output] += level == 1
        late = self.late(output, self.pulses[output], level) if self.late else 0
        if late:
            self.under_way.append((self.board.now + self.board.cycles(late), self.wires[output], level))
        elif late is not None:
            self.board.drive(self.wires[output], level)

    def deliver(self):
        """Delivers the delayed edges that are due."""
        for entry in [entry for entry in self.under_way if entry[0] <= self.board.now]:
            self.under_way.remove(entry)
            self.board.drive(*entry[1:])


def run(wiring, image, elf, wires, late=None):
    """Runs the suite on a board that was just switched on. Returns its status and its log."""
    board = Board(wiring, image)
    board.has_debugger = True
    connected = Wires(board, wires, late)
    block = image.symbols[CONTROL_BLOCK]
    log = bytearray()

    def drain():
        size, written, read = (board.word(block + offset) for offset in (SIZE, WRITTEN, READ))
        if size > 0x10000 or written >= size or read >= size:
            return  # Not set up yet.
        data = board.read_memory(board.word(block + BUFFER), size)
        log.extend(data[read:written] if read <= written else data[read:] + data[:written])
        board.write_memory(block + READ, written.to_bytes(4, "little"))

    # `board.seconds()` does not begin at 0, because the emulated processor's clock continues from one board to the
    # next.
    start = board.seconds()
    while board.ended is None and board.seconds() - start < LONGEST_S:
        end = board.now + board.cycles(0.001)
        while board.now < end and board.ended is None:
            due = min([entry[0] for entry in connected.under_way], default=end)
            if late:
                # Run in short steps, because an edge that starts during a step is delivered only after the step.
                due = min(due, board.now + board.cycles(1e-6))
            board.run(cycles=max(1, min(due, end) - board.now))
            connected.deliver()
        drain()
    printed = subprocess.run(
        ["defmt-print", "-e", elf, "--log-format", "{s}"], input=bytes(log), capture_output=True, check=False
    )
    return board.ended, printed.stdout.decode(errors="replace").splitlines() + printed.stderr.decode().splitlines()


def cases(wiring):
    """Yields name, wires, function that delays edges, expected status, and words that one line of the log must
    contain."""
    right = wires(wiring)
    step_x, direction_x, step_y = right
    yield "wired", right, None, 0, ("all tests passed!",)
    for output, name in ((step_x, "STEP X"), (direction_x, "DIR X"), (step_y, "STEP Y")):
        without = {a: b for a, b in right.items() if a != output}
        yield f"without the wire of {name}", without, None, 101, (f"no edge of {name} at",)
    swapped = {**right, step_x: right[step_y], step_y: right[step_x]}
    yield "wires of STEP X and STEP Y swapped", swapped, None, 101, ("edges of STEP X come at",)

    # The check of the wires takes 12 pulses of X and 4 of Y, so pulse 40 belongs to the train at 1 kHz.
    def lost(output, pulse, level):
        return None if output == step_y and pulse == 40 else 0

    def wide(output, pulse, level):
        return 6e-6 if output == step_x and pulse == 40 and level == 0 else 0

    def skewed(output, pulse, level):
        return 2e-6 if output == step_y and pulse > 4 else 0

    def late(output, pulse, level):
        return 20e-6 if output == step_x and pulse == 40 else 0

    def drifting(output, pulse, level):
        return 0.1e-6 * (pulse - 12) if output == step_x and pulse > 12 else 0

    def turned_late(output, pulse, level):
        return 15e-6 if output == direction_x and pulse > 1 else 0

    yield "a pulse lost", right, lost, 101, ("STEP Y: 118 edges for 60 pulses",)
    yield "a pulse 6 us too long", right, wide, 101, ("pulse of X", "BEYOND")
    yield "Y 2 us behind X", right, skewed, 101, ("Y behind X", "BEYOND")
    yield "a pulse 20 us late", right, late, 101, ("period too long by", "BEYOND")
    yield "each pulse later than the one before", right, drifting, 101, ("last pulse but one late by", "BEYOND")
    yield "directions 15 us late", right, turned_late, 101, ("direction before pulse", "BEYOND")


def main(board, elf, *wanted):
    wiring, image = BOARDS[board], Image(elf)
    failed = passed = 0
    print(f"\nloop-back suite on the virtual board {board}", flush=True)
    for name, connections, late, status, words in cases(wiring):
        if wanted and name not in wanted:
            continue
        begin, lines, outcome = time.monotonic(), [], "ok"
        try:
            ended, lines = run(wiring, image, elf, connections, late)
            if ended != status or not any(all(word in line for word in words) for line in lines):
                wanted_words = " ... ".join(words)
                raise Failure(f"status {ended}; wanted: {status} and `{wanted_words}`\n  " + "\n  ".join(lines))
            passed += 1
        except Failure as failure:
            outcome, failed = f"FAILED\n  {failure}", failed + 1
        print(f"case {name} ... {outcome} ({time.monotonic() - begin:.1f} s)")
        for line in lines:
            if outcome == "ok" and (all(word in line for word in words) or not status and line.startswith("|")):
                print(f"  {line}", flush=True)
    print(f"loop-back {board}: {passed} passed, {failed} failed", flush=True)
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
