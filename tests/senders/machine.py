"""A simulated machine for the tests of senders, the wire between both, and the scenario that each sender has to pass.

A test has a class with what a sender's buttons do (`open`, `start`, `hold`, ...) and calls `main`. The wire records all that the
sender says and is answered; where the motors are is asked of the simulator, on its pin port. Needs Linux, and Python 3.10.
"""

import argparse
import json
import os
import select
import socket
import subprocess
import tempfile
import threading
import time
import traceback
import tty
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# 1,745 lines: three times what the machine looks ahead, so that a job that is held has lines to come.
JOB = ROOT / "examples/pcb_isolation.nc"
# Times faster than life; the job takes half an hour at 1.
SPEED = "200"
# Seconds after which something that has to happen counts as missed. No check depends on how long anything takes.
PATIENCE = 120
# Resets in the middle of a job of which one has to come in motion.
RESETS = 5
REALTIME = set(b"!?~\x18\x19") | set(range(0x80, 0x100))


# What has to be ended with the program.
END = []


class Failed(Exception):
    """What a sender or the machine did wrong."""


def wait(what, condition):
    """Waits until a condition holds."""
    until = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > until:
            raise Failed(f"waited in vain {what}")
        time.sleep(0.02)


class Machine:
    """A simulator, and the port on which it tells what its step outputs have done."""

    def __init__(self, program, *link):
        command = [program, "serve", *link, "--pins", "127.0.0.1:0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.address = self.process.stdout.readline().split()[1]
        pins = self.process.stderr.readline().split()[-1].rsplit(":", 1)
        self.pins = socket.create_connection((pins[0], int(pins[1])), timeout=PATIENCE)
        self.answers = self.pins.makefile()
        # One that says nothing for a minute is turned away.
        self.steps()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.pins.close()
        self.process.kill()
        self.process.communicate()

    def steps(self):
        """Motor positions and pulses, and the order of all steps, as the simulator tells them."""
        self.pins.sendall(b"steps\n")
        told = self.answers.readline().strip()
        if not told.startswith("steps "):
            raise Failed(f"the machine does not tell its steps but `{told}`")
        return told

    def motors(self):
        """Net steps of each motor since the start, and pulses of all motors."""
        words = self.steps().split()
        return [int(word) for word in words[1:4]], sum(int(word) for word in words[5:8])

    def rest(self):
        """What `steps` tells once nothing moves any more."""
        before, same, until = None, 0, time.monotonic() + PATIENCE
        while time.monotonic() < until:
            now = self.steps()
            same = same + 1 if now == before else 0
            if same == 4:
                return now
            before = now
            time.sleep(0.2)
        raise Failed("the machine does not come to rest")


class Wire:
    """A serial port for a sender, joined to the machine's; notes lines, answers and realtime commands on their way."""

    def __init__(self, address):
        self.address = address
        self.master, end = os.openpty()
        tty.setraw(end)
        self.port = os.ttyname(end)
        # The machine's port is open while the sender has this one open.
        os.close(end)
        self.lock = threading.Lock()
        self.is_open = False
        self.times_opened = 0
        self.lines, self.answers, self.realtime, self.reports = [], [], bytearray(), []
        self.told = []
        self.owed = 0
        self.resets = 0
        self.partial = {"sent": b"", "received": b""}
        threading.Thread(target=self.carry, daemon=True).start()

    def carry(self):
        machine = None
        while True:
            look = select.poll()
            look.register(self.master, select.POLLIN)
            if machine is not None:
                look.register(machine, select.POLLIN)
            seen = dict(look.poll(20))
            closed = bool(seen.get(self.master, 0) & select.POLLHUP) and not seen[self.master] & select.POLLIN
            if closed and machine is not None:
                os.close(machine)
                machine, self.is_open = None, False
            elif not closed and machine is None:
                machine = os.open(self.address, os.O_RDWR | os.O_NOCTTY)
                self.begin()
            if machine is None:
                time.sleep(0.002)
                continue
            if seen.get(self.master, 0) & select.POLLIN:
                self.pass_on(self.master, machine, self.sent)
            if seen.get(machine, 0) & select.POLLIN:
                self.pass_on(machine, self.master, self.received)

    def begin(self):
        """A sender has opened the port: what it is owed begins at nothing."""
        with self.lock:
            self.partial = {"sent": b"", "received": b""}
            self.owed = self.resets = 0
            self.is_open = True
            self.times_opened += 1

    def pass_on(self, source, sink, note):
        try:
            data = os.read(source, 4096)
        except OSError:
            return
        with self.lock:
            note(data)
        while data:
            data = data[os.write(sink, data) :]

    def sent(self, data):
        for byte in data:
            if byte in REALTIME:
                self.realtime.append(byte)
                if byte == 0x18:
                    # What had been sent before is not answered any more, nor what was begun.
                    self.resets += 1
                    self.owed = 0
                    self.partial["sent"] = b""
            elif byte == 0x0A:
                self.lines.append(self.partial["sent"].decode("latin-1").rstrip("\r"))
                self.partial["sent"] = b""
                self.owed += 1
            else:
                self.partial["sent"] += bytes([byte])

    def received(self, data):
        *lines, self.partial["received"] = (self.partial["received"] + data).split(b"\n")
        for line in (line.decode("latin-1").rstrip("\r") for line in lines):
            if line.startswith("<"):
                self.reports.append(line)
            elif line.startswith("Grbl "):
                self.resets = max(0, self.resets - 1)
                self.told.append(line)
            elif line == "ok" or line.startswith("error"):
                if self.resets == 0:
                    self.answers.append(line)
                    self.owed -= 1
            elif line:
                self.told.append(line)

    def mark(self):
        """Where the notes are now; for `since`."""
        with self.lock:
            return len(self.lines), len(self.answers), len(self.realtime), len(self.reports), len(self.told)

    def show(self):
        """Prints the last of all notes."""
        print(f"  {self.owed} answers owed, {self.resets} greetings", flush=True)
        for kind in ("lines", "answers", "realtime", "reports", "told"):
            print(f"  last {kind}: {list(getattr(self, kind)[-8:])}", flush=True)

    def since(self, mark):
        """Lines, answers, realtime commands, reports and other answers after a mark."""
        with self.lock:
            notes = (self.lines, self.answers, self.realtime, self.reports, self.told)
            return [list(note[begin:]) if note is not self.realtime else bytes(note[begin:]) for note, begin in zip(notes, mark, strict=True)]


def forecast(program, job):
    """What `oxmill run` says of a job."""
    said = subprocess.run([program, "run", job, "--json"], capture_output=True, text=True, check=False)
    summary = json.loads(said.stdout)
    if not summary["complete"] or summary["errors"]:
        raise Failed(f"{job}: oxmill run: {summary['errors'] or 'not complete'}")
    return summary


class Scenario:
    """A sender that runs a job held and resumed, one reset in the middle, and one after a new connection."""

    def __init__(self, sender, machine, wire, expected):
        self.sender, self.machine, self.wire, self.expected = sender, machine, wire, expected

    def begin(self, what):
        """Starts the job and waits until a third of it has been carried out."""
        wait("for all answers", lambda: self.wire.owed == 0)
        self.what, self.begun = what, self.wire.mark()
        pulses = self.machine.motors()[1]
        self.third = pulses + sum(self.expected["pulses"]) // 3
        self.sender.start()
        wait(f"for a third of the job ({what})", lambda: self.machine.motors()[1] > self.third)

    def hold(self):
        """Holds in the middle, changes the feed while all is at rest, and goes on."""
        self.sender.hold()
        held = self.machine.rest()
        if self.wire.since(self.begun)[1].count("ok") >= self.expected["lines"]:
            raise Failed("the job was over before it was held")
        # Not one step in a time in which a job that goes on makes thousands.
        time.sleep(0.5)
        if self.machine.steps() != held:
            raise Failed("the machine moves in a hold")
        self.sender.override()
        self.sender.resume()
        wait("for the machine to go on after a hold", lambda: self.machine.steps() != held)

    def end(self):
        """Waits for the end of the job, and compares what the sender believes with what the motors have done."""
        wait(f"for the sender to be done ({self.what})", self.sender.is_done)
        self.machine.rest()
        wait("for all answers", lambda: self.wire.owed == 0)
        lines, answers, _, _, told = self.wire.since(self.begun)
        errors = [answer for answer in answers if answer != "ok"] + [line for line in told if line.startswith("ALARM")]
        if errors:
            raise Failed(f"{self.what}: {errors}")
        steps = self.machine.motors()[0]
        if steps != self.expected["steps"]:
            raise Failed(f"{self.what}: the motors are at {steps}, forecast {self.expected['steps']}")
        wait(f"for the sender to know the place, {self.expected['position_mm']}, not {self.sender.place()}", self.knows)
        print(f"  {self.what}: {len(lines)} lines, {len(answers)} answers, motors at {steps}", flush=True)

    def knows(self):
        place = self.sender.place()
        return place is None or all(abs(a - b) < 0.0006 for a, b in zip(place, self.expected["position_mm"], strict=True))

    def reset(self):
        """Resets in the middle of a job, with the machine reported as running; whether it was moving. The machine has to be ready for
        the next job. A sender that is slow on a busy host lets the machine wait for lines, and a reset between two moves raises no
        alarm."""
        before = self.wire.mark()
        self.sender.reset()
        self.machine.rest()
        wait("for the greeting", lambda: any(line.startswith("Grbl ") for line in self.wire.since(before)[4]))
        self.sender.unlock()
        wait("for all answers", lambda: self.wire.owed == 0)
        told = self.wire.since(before)[4]
        was_moving = "ALARM:3" in told
        if was_moving != any("Unlocked" in line for line in told):
            raise Failed(f"a reset is told as {told}")
        greeting = next(place for place, line in enumerate(told) if line.startswith("Grbl "))
        if was_moving and told.index("ALARM:3") > greeting:
            raise Failed(f"the alarm of a reset is told behind the greeting: {told}")
        if self.machine.motors()[0] == self.expected["steps"]:
            raise Failed("the job was over before it was reset")
        moment = "in motion" if was_moving else "between two moves"
        print(f"  {self.what}, {moment}: motors at {self.machine.motors()[0]}", flush=True)
        return was_moving

    def runs(self):
        """Whether a report has told that the machine runs the job. A sender that asks for none by itself has a `look` that does."""
        if hasattr(self.sender, "look"):
            self.sender.look()
        return any(report.startswith("<Run|") for report in self.wire.since(self.begun)[3])

    def reset_in_motion(self):
        """Starts the job and resets it, again until a reset has come while the machine moved."""
        for _ in range(RESETS):
            self.begin("reset in the middle")
            wait("for the machine to be reported as running", self.runs)
            if self.reset():
                return
            self.reconnect()
        raise Failed(f"none of {RESETS} resets in the middle of a job came in motion")

    def reconnect(self):
        self.sender.close()
        wait("for the port to be closed", lambda: not self.wire.is_open)
        before = self.wire.times_opened
        self.sender.open(self.wire.port)
        if self.wire.times_opened != before + 1:
            raise Failed("the port was not opened again")

    def run(self):
        opened = self.wire.mark()
        self.sender.open(self.wire.port)
        self.begin("held, feed overridden, resumed")
        self.hold()
        self.end()
        self.sender.check_override(self.wire.since(self.begun))
        self.reset_in_motion()
        self.reconnect()
        self.begin("after a reset and a new connection")
        self.end()
        self.sender.close()
        lines, _, realtime, reports, _ = self.wire.since(opened)
        asked = sorted({line for line in lines if line.startswith("$")})
        wanted = ", ".join(f"`{line}`" for line in asked) or "no `$` command"
        kinds = " ".join(f"{byte:02X}" for byte in sorted(set(realtime)))
        print(f"  asked for {wanted}; realtime {kinds}; {len(reports)} reports", flush=True)


def checks_feed_override(notes):
    """An override of the machine was sent, taken and reported."""
    if b"\x91" not in notes[2] or not any("Ov:110,100,100" in report for report in notes[3]):
        raise Failed("no report tells the feed override")


def arguments():
    parser = argparse.ArgumentParser(description="Streams jobs to the simulator, and checks where they end.")
    parser.add_argument("--program", default=str(ROOT / "target/release/oxmill"))
    parser.add_argument("--dialect", default="oxmill", choices=["oxmill", "grbl"])
    return parser.parse_args()


def run_scenario(options, name, make):
    """Runs the scenario with the sender that `make` makes."""
    print(f"{name}, in the dialect {options.dialect}:", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        link = ["--pty", f"{folder}/mill", "--speed", SPEED, "--dialect", options.dialect]
        with Machine(options.program, *link) as machine:
            wire = Wire(machine.address)
            try:
                Scenario(make(), machine, wire, forecast(options.program, JOB)).run()
            except Exception:
                wire.show()
                raise


def main(senders, options=None):
    """Runs the scenario with each of the senders, by name, and ends the program: with 1 if one of them failed."""
    options = options or arguments()
    try:
        for name, make in senders.items():
            run_scenario(options, name, make)
    except Exception as why:
        if not isinstance(why, Failed):
            traceback.print_exc()
        print(f"FAILED: {why}", flush=True)
        leave(1)
    print("ok", flush=True)
    leave(0)


def leave(code):
    for end in END:
        end()
    # Threads of a sender may still wait for the port.
    os._exit(code)
