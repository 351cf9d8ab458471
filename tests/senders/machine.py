"""The common parts of the sender tests: a simulated machine, a wire that records what sender and machine send, and the
scenario that each sender must pass.

A test defines a class with the actions of a sender's buttons (`open`, `start`, `hold`, ...) and calls `main`. The wire records
everything sent in both directions; the positions of the motors are read from the simulator's pin port. Needs Linux and
Python 3.10.
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
# 1,745 lines: three times the machine's look-ahead, so that a held job still has lines to send.
JOB = ROOT / "examples/pcb_isolation.nc"
# Speed relative to real time; at 1 the job takes half an hour.
SPEED = "200"
# Maximum wait, s, for something that must happen. No check depends on how long it takes.
PATIENCE = 120
# Maximum number of attempts to reset a job during motion. The test fails if none of them succeeds.
RESETS = 5
REALTIME = set(b"!?~\x18\x19") | set(range(0x80, 0x100))


# Functions to call when the program ends.
END = []


class Failed(Exception):
    """A fault of the sender or the machine."""


def wait(what, condition):
    """Waits until `condition()` is true. After PATIENCE seconds raises `Failed` with the text `what`."""
    until = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > until:
            raise Failed(f"waited in vain {what}")
        time.sleep(0.02)


class Machine:
    """A running simulator, with a connection to its pin port, which reports the step outputs."""

    def __init__(self, program, *link):
        command = [program, "serve", *link, "--pins", "127.0.0.1:0"]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        self.address = self.process.stdout.readline().split()[1]
        pins = self.process.stderr.readline().split()[-1].rsplit(":", 1)
        self.pins = socket.create_connection((pins[0], int(pins[1])), timeout=PATIENCE)
        self.answers = self.pins.makefile()
        # Send a first request now, because the server closes a connection that has sent nothing for a minute.
        self.steps()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.pins.close()
        self.process.kill()
        self.process.communicate()

    def steps(self):
        """Returns the simulator's report of motor positions, pulses, and the order of all steps."""
        self.pins.sendall(b"steps\n")
        told = self.answers.readline().strip()
        if not told.startswith("steps "):
            raise Failed(f"the machine does not tell its steps but `{told}`")
        return told

    def motors(self):
        """Returns the net steps of each motor since the start, and the sum of pulses of all motors."""
        words = self.steps().split()
        return [int(word) for word in words[1:4]], sum(int(word) for word in words[5:8])

    def rest(self):
        """Waits until nothing moves and returns the result of `steps`."""
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
    """A pseudo terminal that a sender opens as its serial port. Passes bytes to and from the machine's port, and
    records lines, answers, realtime commands and reports."""

    def __init__(self, address):
        self.address = address
        self.master, end = os.openpty()
        tty.setraw(end)
        self.port = os.ttyname(end)
        # Close this end of the pseudo terminal: the machine's port must be open only while the sender has it open.
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
        """Called when a sender has opened the port: no answers are pending yet."""
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
                    # The machine will not answer the lines sent before the reset, nor the unfinished line.
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
        """Returns the current lengths of all records: a mark for the method `since`."""
        with self.lock:
            return len(self.lines), len(self.answers), len(self.realtime), len(self.reports), len(self.told)

    def show(self):
        """Prints the last entries of all records."""
        print(f"  {self.owed} answers owed, {self.resets} greetings", flush=True)
        for kind in ("lines", "answers", "realtime", "reports", "told"):
            print(f"  last {kind}: {list(getattr(self, kind)[-8:])}", flush=True)

    def since(self, mark):
        """Returns lines, answers, realtime commands, reports and other output recorded after a mark."""
        with self.lock:
            notes = (self.lines, self.answers, self.realtime, self.reports, self.told)
            return [list(note[begin:]) if note is not self.realtime else bytes(note[begin:]) for note, begin in zip(notes, mark, strict=True)]


def forecast(program, job):
    """Returns the summary of `oxmill run` for a job: among others lines, steps, pulses and end position."""
    said = subprocess.run([program, "run", job, "--json"], capture_output=True, text=True, check=False)
    summary = json.loads(said.stdout)
    if not summary["complete"] or summary["errors"]:
        raise Failed(f"{job}: oxmill run: {summary['errors'] or 'not complete'}")
    return summary


class Scenario:
    """Runs three jobs with a sender: one held and resumed, one reset in the middle, and one after a reconnection."""

    def __init__(self, sender, machine, wire, expected):
        self.sender, self.machine, self.wire, self.expected = sender, machine, wire, expected

    def begin(self, what):
        """Starts the job and waits until a third of its steps have been made."""
        wait("for all answers", lambda: self.wire.owed == 0)
        self.what, self.begun = what, self.wire.mark()
        pulses = self.machine.motors()[1]
        self.third = pulses + sum(self.expected["pulses"]) // 3
        self.sender.start()
        wait(f"for a third of the job ({what})", lambda: self.machine.motors()[1] > self.third)

    def hold(self):
        """Holds the job, changes the feed override at rest, and resumes."""
        self.sender.hold()
        held = self.machine.rest()
        if self.wire.since(self.begun)[1].count("ok") >= self.expected["lines"]:
            raise Failed("the job was over before it was held")
        # No step may occur within the next half second. A running job would make thousands of steps in this time.
        time.sleep(0.5)
        if self.machine.steps() != held:
            raise Failed("the machine moves in a hold")
        self.sender.override()
        self.sender.resume()
        wait("for the machine to go on after a hold", lambda: self.machine.steps() != held)

    def end(self):
        """Waits for the end of the job, and compares the position that the sender shows with that of the motors."""
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
        """Resets during a job, and makes the machine ready for the next job. Returns whether the machine was moving,
        which raises ALARM:3. On a busy host the machine can also be waiting for lines between two moves; then a reset
        raises no alarm."""
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
        """Returns whether a report has shown the job running. Calls the sender's method `look` first, if there is one:
        a sender that does not poll by itself requests a report there."""
        if hasattr(self.sender, "look"):
            self.sender.look()
        return any(report.startswith("<Run|") for report in self.wire.since(self.begun)[3])

    def reset_in_motion(self):
        """Starts the job and resets it; repeats this until a reset has occurred during motion."""
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
    """Checks that a feed override was sent and reported."""
    if b"\x91" not in notes[2] or not any("Ov:110,100,100" in report for report in notes[3]):
        raise Failed("no report tells the feed override")


def arguments():
    parser = argparse.ArgumentParser(description="Streams jobs to the simulator, and checks where they end.")
    parser.add_argument("--program", default=str(ROOT / "target/release/oxmill"))
    parser.add_argument("--dialect", default="oxmill", choices=["oxmill", "grbl"])
    return parser.parse_args()


def run_scenario(options, name, make):
    """Runs the scenario with the sender that `make` returns."""
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
    """Runs the scenario with each of the senders, given by name, and exits: with status 1 if one of them failed."""
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
    # Threads of a sender may still be waiting for the port, so do not wait for them.
    os._exit(code)
