"""Runs a long job on one board: `python -m virtual_board.soak BOARD ELF SCRIPT ANSWERS REPORT [WALL]`, as `cargo xtask
soak BOARD` does.

Executes the codes of SCRIPT (`xtask/src/script.rs`). Writes the board's output to ANSWERS. At the end of each record
(code `N`) writes a line to REPORT: the time, the steps counted at the step outputs, and the stack. xtask, which wrote
the script, judges both files. After WALL seconds of real time the run ends at the next line of REPORT.
"""

import struct
import sys
import time

from .board import Image
from .cases.bench import Bench
from .parts import BOARDS
from .scope import Scope

PATIENCE_S = 120


class Player:
    def __init__(self, bench, answers, report):
        self.bench, self.answers, self.report = bench, answers, report
        self.base = len(bench.host.answers)
        self.written = len(bench.host.text)
        self.begin = bench.board.now
        self.net = [0, 0, 0]
        self.scope = Scope(bench.board)
        self.said = 0

    def seconds(self):
        board = self.bench.board
        return board.seconds(board.now) - board.seconds(self.begin)

    def count(self):
        board = self.bench.board
        self.net = [a + b for a, b in zip(self.net, self.scope.counts(), strict=True)]
        # Discard the edges: a job may take hours.
        del board.edges[:], board.step_runs[:]
        self.scope = Scope(board)

    def note(self):
        host = self.bench.host
        self.count()
        text = bytes(host.text[self.written :])
        self.said += len(text)
        self.answers.write(text)
        del host.text[:], host.lines[:], host.answers[:]
        self.written = self.base = 0
        used, size = self.bench.board.stack_used()
        steps = ",".join(str(steps) for steps in self.net)
        self.report.write(f"note bytes={self.said} at={round(self.seconds() * 1000)} steps={steps} stack={used} of {size}\n")
        self.answers.flush()
        self.report.flush()

    def play(self, codes, wall):
        bench, at, end = self.bench, 0, time.monotonic() + wall
        while at < len(codes):
            code, at = codes[at : at + 1], at + 1
            number = 0
            if code == b"S":
                (length,) = struct.unpack_from("<H", codes, at)
                at += 2
                bench.host.send(codes[at : at + length])
                at += length
            elif code in b"AWIEH":
                (number,) = struct.unpack_from("<I", codes, at)
                at += 4
            if code == b"A":
                bench.wait(lambda wanted=number: len(bench.host.answers) - self.base >= wanted, PATIENCE_S, "answers")
            elif code == b"W":
                bench.board.run(seconds=number / 1000)
            elif code == b"I":
                while not bench.status().startswith("<Idle"):
                    bench.board.run(seconds=number / 1000)
            elif code == b"H":
                bench.host.order("close")
                bench.board.run(seconds=number / 1000 + 0.005)
                bench.host.order("open")
                bench.wait(lambda: bench.host.open, 1.0, "the port")
                bench.board.run(seconds=0.02)
            elif code == b"R":
                self.base = len(bench.host.answers)
            elif code == b"N":
                self.note()
                if time.monotonic() > end:
                    return
            elif code == b"E" and self.seconds() >= number / 1000:
                return


def main(board, elf, script, answers, report, wall="inf"):
    bench = Bench(BOARDS[board], Image(elf), None)
    if bench.wiring.usb:
        bench.boot_with_usb()
    else:
        bench.boot()
    with open(script, "rb") as codes, open(answers, "wb") as said, open(report, "w", encoding="ascii") as notes:
        Player(bench, said, notes).play(codes.read(), float(wall))


if __name__ == "__main__":
    main(*sys.argv[1:])
