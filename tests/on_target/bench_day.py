#!/usr/bin/env python3
"""The host's side of a day on the bench (docs/bench.md): moves a board without motors, and judges what can be judged.

    pip install pyserial numpy             # numpy only for `stops` with a logic analyser
    python3 tests/on_target/bench_day.py PORT edges HZ PULSE
    python3 tests/on_target/bench_day.py PORT jogs MINUTES
    python3 tests/on_target/bench_day.py PORT stops N [--hz HZ] [--pulse PULSE] [--no-analyser]
    python3 tests/on_target/bench_day.py PORT settings N [--disturbed]
    python3 tests/on_target/bench_day.py PORT beam
    python3 tests/on_target/bench_day.py PORT lines N
    python3 tests/on_target/bench_day.py PORT reopen N

PORT is a serial port, such as /dev/ttyACM0 or COM5, or an address such as socket://127.0.0.1:2399. So the program can
be tried without a board: `oxmill serve --tcp 2399 --board nucleo_f446re`.

 * `edges`: moves X back and forth at HZ steps a second with pulses of PULSE us, under a flood of `?`, until Ctrl-C. For
   the oscilloscope.
 * `jogs`: repeats the jog of step 4 of docs/bench.md back and forth, under a flood of `?`, and compares `MPos` after
   each jog.
 * `stops`: stops a jog N times (0x85, `!`, 0x18) at random moments, and compares the edges at step X with `MPos`. The
   edges come from a logic analyser with sigrok's driver fx2lafw at 12 MS/s, read by sigrok-cli: D0 at step X, D1 at
   direction X, ground at ground. With `--no-analyser` it stops in the same way, but compares nothing.
 * `settings`: changes `$100` N times, with a `?` every 20 ms. `--disturbed` is for a line that somebody disturbs
   meanwhile: changes that are refused or not answered are counted and sent again.
 * `beam`: moves X in laser mode, with S1000 and S0 in turn every millimetre, until Ctrl-C. For the oscilloscope.
 * `lines`: sends N lines at once during a move of 12 s, more than the board can take, and counts the answers.
 * `reopen`: closes the port N times in the middle of an answer, and opens it again.

The program changes settings of the board; `$RST=*` restores the defaults. The exit status is 0 if no fault was found.
"""

import argparse
import collections
import random
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time

BAUD = 115_200
# $100 of `edges` and `stops`, steps/mm: a step is 0.001 mm, the last digit of MPos.
STEPS = 1_000
# $120 of `edges` and `stops`, mm/s^2: the maximum rate is reached within about 50 ms.
ACCELERATION = 20_000
# Slowest jog of `stops`, steps/s.
SLOWEST_HZ = 1_000
# Distance from MPos 0 beyond which `stops` jogs back, mm.
FARTHEST = 1_000
# Time between two `?` of `settings`, s.
ASKED_EVERY = 0.02
# Maximum delay of the analyser's samples, s.
BEHIND = 0.3
CANCEL, HOLD, RESET = b"\x85", b"!", b"\x18"
TAKE = "sigrok-cli -d fx2lafw -c samplerate=12m -C D0,D1 --continuous -O binary".split()


def opened(name):
    """Opens a serial port or an address; exits with a message if that fails."""
    try:
        import serial
    except ImportError:
        sys.exit("pyserial is missing: pip install pyserial")
    try:
        return serial.serial_for_url(name, BAUD, timeout=0.01)
    except serial.SerialException as error:
        sys.exit(f"{name} cannot be opened: {error}")


class Board:
    """A board at a port, with the lines that it has sent and that nobody has read yet."""

    def __init__(self, name):
        self.name = name
        self.port = opened(name)
        self.begun = b""
        self.lines = collections.deque()
        # The board's last messages, for error reports.
        self.messages = collections.deque(maxlen=3)
        # Skip the greeting that a board sends when the port opens.
        self.hear(0.3)
        self.reset()

    def read(self):
        """Reads for 10 ms; returns the number of bytes."""
        received = self.port.read(4096)
        *lines, self.begun = (self.begun + received).split(b"\n")
        for line in lines:
            text = line.decode("ascii", "replace").strip()
            if re.match(r"ALARM:(?!3$)|\[CRASH", text):
                sys.exit(f"the board reports {text}")
            self.lines.append(text)
            if text.startswith("[MSG"):
                self.messages.append(text)
        return len(received)

    def hear(self, seconds):
        """Reads for this many seconds and discards what arrives."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.read()
        self.lines.clear()

    def wait(self, pattern, seconds=10):
        """Drops lines until one matches the pattern; returns the match. Exits after `seconds` without such a line."""
        end, dropped = time.monotonic() + seconds, collections.deque(maxlen=5)
        while True:
            while self.lines:
                line = self.lines.popleft()
                if found := re.match(pattern, line):
                    return found
                dropped.append(line)
            if time.monotonic() > end:
                sys.exit(f"no {pattern!r} within {seconds} s; the last lines: {list(dropped)}")
            self.read()

    def send(self, line):
        """Sends a line and waits for its answer; exits if the answer is not `ok`."""
        self.port.write(line.encode() + b"\n")
        answer = self.wait(r"ok$|error:\d+").group()
        if answer != "ok":
            sys.exit(" ".join([f"{line}: {answer}", *self.messages]))

    def status(self):
        """Returns the state and the machine position of X, mm."""
        self.port.write(b"?")
        found = self.wait(r"<(\w+).*?MPos:(-?[\d.]+)")
        return found[1], float(found[2])

    def reset(self):
        """Resets the controller, and unlocks it if it is locked afterwards."""
        self.port.write(RESET)
        self.wait("Grbl")
        if self.status()[0] == "Alarm":
            self.send("$X")

    def at_rest(self, seconds=30):
        """Waits until the machine is idle, resuming it if it is held. Returns the machine position of X."""
        end = time.monotonic() + seconds
        while True:
            state, x = self.status()
            if state == "Idle":
                return x
            if state == "Hold":
                self.port.write(b"~")
            if time.monotonic() > end:
                sys.exit(f"still in the state {state} after {seconds} s")
            time.sleep(0.02)

    def set_up(self, steps, rate, acceleration, pulse):
        """Sets steps/mm, acceleration, maximum rate and step pulse.

        `$110` is low until the end: a step rate above the board's maximum, even for a moment, would lock motion.
        """
        for line in ("$10=1", "$32=0", "$110=60", f"$0={pulse:g}", f"$100={steps}", f"$120={acceleration}", f"$110={rate:g}"):
            self.send(line)
            print(line)

    def flood(self, seconds):
        """Requests reports for some time, faster than the board can send them."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            self.port.write(b"?" * 8)
            self.read()
            self.lines.clear()


class Analyser:
    """Counts rising edges at D0 (step X): up while D1 (direction X) is low, down while it is high."""

    def __init__(self):
        try:
            import numpy
        except ImportError:
            sys.exit("numpy is missing: pip install numpy (or --no-analyser, which compares nothing)")
        if shutil.which(TAKE[0]) is None:
            sys.exit(
                "sigrok-cli is missing, which reads the logic analyser: install the package sigrok-cli of your system, "
                "or https://sigrok.org/wiki/Downloads (or --no-analyser, which compares nothing)"
            )
        self.numpy = numpy
        self.net = 0
        self.samples = 0
        self.log = tempfile.TemporaryFile()
        self.process = subprocess.Popen(TAKE, stdout=subprocess.PIPE, stderr=self.log)
        threading.Thread(target=self.count, daemon=True).start()
        time.sleep(2)
        self.check()

    def count(self):
        last = None
        # `read1` does not wait for a full block, so the count is always current.
        while block := self.process.stdout.read1(1 << 16):
            bits = self.numpy.frombuffer(block, self.numpy.uint8)
            before = bits[0] & 1 if last is None else last
            step = self.numpy.concatenate(([before], bits & 1)).astype(self.numpy.int8)
            back = bits[self.numpy.flatnonzero(self.numpy.diff(step) == 1)] >> 1 & 1
            self.net += len(back) - 2 * int(back.sum())
            self.samples += len(bits)
            last = step[-1]

    def check(self):
        """Exits if no samples arrive, or if they have stopped."""
        if self.process.poll() is None and self.samples:
            return
        self.process.kill()
        self.log.seek(0)
        said = self.log.read().decode(errors="replace").strip()
        sys.exit(f"sigrok-cli gives no samples, or no more: {said or 'it says nothing'}. Command: {' '.join(TAKE)}")


def edges(board, hz, pulse):
    rate = 60 * hz / STEPS
    board.set_up(STEPS, rate, ACCELERATION, pulse)
    print(f"{hz:g} steps/s, to and fro, under a flood of `?`; Ctrl-C ends it")
    x = hz / STEPS
    jogs = 0
    try:
        while True:
            board.send(f"$J=G91 G21 X{x:.3f} F{rate:.1f}")
            board.flood(1)
            board.at_rest()
            jogs, x = jogs + 1, -x
    except KeyboardInterrupt:
        board.port.write(CANCEL)
        board.hear(0.3)
        print(f"\nended after {jogs} jogs, at MPos {board.at_rest():.3f}")


def jogs(board, minutes):
    board.set_up(250, 500, 10, 10)
    end, x, count = time.monotonic() + 60 * minutes, 5, 0
    begin = board.at_rest()
    while time.monotonic() < end:
        board.send(f"$J=G91 G21 X{x} F240")
        board.flood(1.5)
        where, count = board.at_rest(), count + 1
        wanted = begin + max(x, 0)
        if abs(where - wanted) > 0.002:
            sys.exit(f"jog {count}: at MPos {where:.3f} instead of {wanted:.3f}")
        x = -x
    print(f"{count} jogs, MPos right after each")


def stops(board, number, hz, pulse, compares):
    analyser = Analyser() if compares else None
    if not compares:
        print("NO ANALYSER: nothing is compared. This run shows only that the board stops and answers.")
    board.set_up(STEPS, 60 * hz / STEPS, ACCELERATION, pulse)
    where = board.at_rest()
    bad = 0
    for k in range(number):
        begin, before = where, analyser.net if analyser else 0
        rate = hz if k % 2 == 0 else random.uniform(min(SLOWEST_HZ, hz), hz)
        way = random.choice((-1, 1)) if abs(begin) < FARTHEST else -1 if begin > 0 else 1
        stop = random.choice((CANCEL, HOLD, RESET))
        # The jog is as long as the distance covered in one second at its rate.
        board.send(f"$J=G91 G21 X{way * rate / STEPS:.3f} F{60 * rate / STEPS:.3f}")
        time.sleep(random.uniform(0, 0.9))
        if stop == RESET:
            board.reset()
        else:
            board.port.write(stop)
        where = board.at_rest()
        told = f"{k + 1:4} {stop!r:8} {rate:9.0f} steps/s  MPos {where:11.3f}"
        if not analyser:
            print(told, " edges: not compared")
            continue
        time.sleep(BEHIND)
        analyser.check()
        off = analyser.net - before - round((where - begin) * STEPS)
        bad += off != 0
        print(told, f" edges off by {off}" if off else " edges agree")
    if not analyser:
        print(f"{number} stops, each answered; NOTHING COMPARED (--no-analyser)")
        return
    analyser.process.terminate()
    print(f"{bad} of {number} stops with a difference")
    if bad:
        sys.exit(1)


def beam(board):
    for line in ("$30=1000", "$32=1", "$33=100000", "$0=1", "$110=5000", "$120=2000", "G91 G21 G1 F2400 M3 S0"):
        board.send(line)
        print(line)
    print("X1 S1000 and X1 S0 in turn, to and fro; Ctrl-C ends it")
    try:
        while True:
            for way in [1] * 50 + [-1] * 50:
                board.send(f"X{way} S1000")
                board.send(f"X{way} S0")
    except KeyboardInterrupt:
        board.reset()
        board.send("$32=0")
        print("\nended, $32=0")


def lines(board, number):
    board.set_up(250, 500, 10, 10)
    board.at_rest()
    board.send("G91 G21 G1 X20 F100")
    board.port.write(b"G4 P0.001\n" * number)
    for k in range(number):
        answer = board.wait(r"ok$|error:\d+", 60).group()
        if answer != "ok":
            sys.exit(f"line {k + 1} of {number}: {answer}")
    board.hear(0.5)
    print(f"{number} lines, each answered with ok; MPos {board.at_rest():.3f}")


def reopen(board, number):
    for k in range(number):
        board.port.write(b"$$\n")
        board.port.read(random.randrange(1, 400))
        board.port.close()
        time.sleep(random.uniform(0.02, 0.3))
        board.port, board.begun = opened(board.name), b""
        board.lines.clear()
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            board.read()
        # The first line can have lost its beginning on the host's side.
        if old := [line for line in list(board.lines)[1:] if line.startswith("$")]:
            sys.exit(f"opening {k + 1}: the old answer goes on: {old[:3]}")
        board.lines.clear()
        board.send("G4 P0")
    print(f"{number} times closed and opened, the old answer gone each time")


def settings(board, number, is_disturbed):
    asked = told = refused = 0
    pause, heard = 0.0, time.monotonic()
    value = ""
    k = 0
    while k < number:
        value = f"{250 + k % 1000 / 1000:.3f}"
        board.port.write(f"$100={value}\n".encode())
        begin, answer = time.monotonic(), None
        while answer is None:
            board.port.write(b"?")
            asked += 1
            end = time.monotonic() + ASKED_EVERY
            while time.monotonic() < end:
                if board.read():
                    now = time.monotonic()
                    pause, heard = max(pause, now - heard), now
            told += sum(line.startswith("<") for line in board.lines)
            answer = next((line for line in board.lines if re.match(r"ok$|error:", line)), None)
            board.lines.clear()
            if answer not in ("ok", None) or time.monotonic() > begin + 5:
                if not is_disturbed:
                    sys.exit(f"change {k + 1}, $100={value}: {answer or 'no answer within 5 s'}")
                # End the line that may have arrived in part, so that the next change starts a new line.
                board.port.write(b"\n")
                board.hear(0.3)
                refused += 1
                break
        else:
            k += 1
    board.hear(0.5)
    board.port.write(b"$$\n")
    stored = float(board.wait(r"\$100=([\d.]+)")[1])
    print(f"{number} changes; {asked} `?`, {told} reports; longest pause {pause * 1000:.0f} ms")
    if is_disturbed:
        print(f"{refused} lines refused or not answered, and sent again")
    print(f"now power off and on: `$$` must list $100={value}")
    if stored != float(value):
        sys.exit(f"`$$` lists $100={stored}")


def arguments():
    parser = argparse.ArgumentParser(
        description=__doc__.split("\n", 1)[0], epilog="More: docs/bench.md, and the beginning of this file."
    )
    parser.add_argument("port", metavar="PORT", help="/dev/ttyACM0, COM5, socket://127.0.0.1:2399")
    tasks = parser.add_subparsers(dest="task", required=True)
    task = tasks.add_parser("edges", help="X to and fro, until Ctrl-C")
    task.add_argument("hz", metavar="HZ", type=float, help="steps/s")
    task.add_argument("pulse", metavar="PULSE", type=float, help="$0, us")
    task = tasks.add_parser("jogs", help="the jog of step 4, again and again")
    task.add_argument("minutes", metavar="MINUTES", type=float)
    task = tasks.add_parser("stops", help="random stops, edges compared with MPos")
    task.add_argument("number", metavar="N", type=int)
    task.add_argument("--hz", type=float, default=490_000, help="greatest rate, steps/s (490000)")
    task.add_argument("--pulse", type=float, default=1, help="$0, us (1)")
    task.add_argument("--no-analyser", action="store_true", help="stop, but compare nothing")
    task = tasks.add_parser("settings", help="changes of $100 under `?`")
    task.add_argument("number", metavar="N", type=int)
    task.add_argument("--disturbed", action="store_true", help="send refused changes again, and count them")
    tasks.add_parser("beam", help="laser mode, S1000 and S0 in turn, until Ctrl-C")
    task = tasks.add_parser("lines", help="lines at once during a long move")
    task.add_argument("number", metavar="N", type=int)
    task = tasks.add_parser("reopen", help="the port closed in the middle of an answer, and opened again")
    task.add_argument("number", metavar="N", type=int)
    return parser.parse_args()


def main():
    given = arguments()
    board = Board(given.port)
    if given.task == "edges":
        edges(board, given.hz, given.pulse)
    elif given.task == "jogs":
        jogs(board, given.minutes)
    elif given.task == "stops":
        stops(board, given.number, given.hz, given.pulse, not given.no_analyser)
    elif given.task == "settings":
        settings(board, given.number, given.disturbed)
    elif given.task == "beam":
        beam(board)
    elif given.task == "lines":
        lines(board, given.number)
    else:
        reopen(board, given.number)


if __name__ == "__main__":
    try:
        main()
    except KeyboardInterrupt:
        sys.exit("interrupted")
