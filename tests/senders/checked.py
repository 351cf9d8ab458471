#!/usr/bin/env python3
"""Streams jobs in checked lines to the simulator over a link that damages bytes; compares the steps with a clean run.

    cargo build --release
    python3 tests/senders/checked.py [--rate N] [--plain] [--seed N] [JOB.nc ...]

Between the sender (`examples/checked_sender.py`) and the machine, in both directions, one byte in N (default 1,000) is
damaged: it has a flipped bit, is dropped, is doubled or arrives late. A job passes if

 * according to its answers, the machine has accepted each line once and in order,
 * each motor makes the same steps, in the same order and directions, as over a clean link,
 * at each step of a motor, the step count of every other motor is that of the clean run, or one step off,
 * spindle, coolant and the outputs of the program are the same at each step (not after the last one).

The test reads the steps from a replay (`replay --trace`) of a recording (`serve --record`). The replay must make the
steps of the run. Each line without an N word gets one, because the machine does not join lines with different N words
to one move. So the moves do not depend on how long the machine waits for a line. The order in which two motors step
depends on the speed, by one step at most (`motion::dda`).

`--plain` also sends each job line by line without checks, to show the resulting errors; this part cannot fail.
"""

import argparse
import json
import random
import socket
import subprocess
import sys
import tempfile
import threading
import time
from array import array
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples"))
import checked_sender  # noqa: E402

import machine  # noqa: E402

JOBS = [f"tests/jobs/{name}.nc" for name in ["chords", "helix", "increments", "jerk", "lines", "relief"]]
JOBS += [f"examples/{name}.nc" for name in ["pcb_isolation", "pocket_inch", "pocket_mm", "relief"]]
# Session letters of the checked lines, the same in each run.
SESSION = "QKNP"
# Delay of a late byte, s: long enough to have an effect, short enough not to cause a timeout.
LATE = 0.02
# Number of consecutive timeouts of 2 s after which a sender without checks gives up.
GIVEN_UP = 20
# Number of steps by which a motor may be ahead of another motor or behind it, compared with the clean run.
ORDER = 1


class Line:
    """A link that damages bytes: the sender connects to the link's port, and the link connects to the machine's
    port."""

    def __init__(self, address, rate, seed):
        self.rate = rate
        self.faults = {"flipped": 0, "dropped": 0, "doubled": 0, "late": 0}
        host, port = address.rsplit(":", 1)
        # Everything that the machine has sent, without damage.
        self.said = bytearray()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        self.machine = socket.create_connection((host, int(port)))
        threading.Thread(target=self.carry, args=(seed,), daemon=True).start()

    def carry(self, seed):
        sender = self.listener.accept()[0]
        for source, sink, chance in [
            (sender, self.machine, random.Random(seed)),
            (self.machine, sender, random.Random(seed + 1)),
        ]:
            threading.Thread(target=self.pass_on, args=(source, sink, chance), daemon=True).start()

    def pass_on(self, source, sink, chance):
        try:
            while data := source.recv(256):
                if source is self.machine:
                    self.said += data
                out = bytearray()
                for byte in data:
                    fault = chance.choice(list(self.faults)) if self.rate and chance.randrange(self.rate) == 0 else None
                    if fault:
                        self.faults[fault] += 1
                    if fault == "late":
                        sink.sendall(out)
                        out.clear()
                        time.sleep(LATE)
                    sent = byte ^ 1 << chance.randrange(8) if fault == "flipped" else byte
                    out += bytes([sent]) * {"dropped": 0, "doubled": 2}.get(fault, 1)
                sink.sendall(out)
        except OSError:
            pass
        finally:
            sink.close()

    def close(self):
        self.listener.close()
        self.machine.close()


def checked(link, lines):
    """Sends a job in checked lines; returns the sender's counts."""
    sender = checked_sender.Sender(link, lines, tell=lambda text: None, session=SESSION)
    sender.run()
    return ", ".join(f"{count} {name}" for name, count in sender.counts.items())


def plain(link, lines):
    """Sends a job line by line without checks, and waits up to 2 s for each answer. Returns a summary."""
    received, late = b"", 0
    errors = 0
    unanswered = 0
    for number, text in [(0, "")] + lines:
        link.send(text.encode("ascii") + b"\n")
        until = time.monotonic() + 2
        while time.monotonic() < until:
            *answers, received = (received + link.receive(0.05)).split(b"\n")
            errors += sum(answer.startswith(b"error") for answer in answers)
            if any(answer.startswith((b"ok", b"error")) for answer in answers):
                unanswered = 0
                break
        else:
            late += 1
            unanswered += 1
            if unanswered == GIVEN_UP:
                # The machine no longer answers, for example because a damaged byte has become a feed hold.
                return f"{errors} errors, {late} answers lost; no answers any more at line {number}"
    return f"{errors} errors, {late} answers lost"


def numbered(lines):
    """Returns the lines with an N word added where it is allowed and missing."""
    return [(n, text if text[0] in "N%/$" else f"N{n}{text}") for n, text in lines]


def taken_once(said, count):
    """Returns None if the machine's answers show that each line was accepted once and in order; else the fault."""
    taken = None
    for line in said.decode("ascii", "replace").split("\n"):
        answer = checked_sender.answer_in(line.strip("\r"), SESSION, taken or 0)
        if answer == (0, "ok") and not taken:
            # The answer to `$LC=ON`. The sender may have repeated this command, so the answer can come twice.
            taken = 0
        elif answer and answer[1] == "ok":
            if taken is None or answer[0] != taken + 1:
                return f"`ok` with the number {answer[0]} behind {taken} lines"
            taken += 1
        elif answer and answer[1] not in ("known", "error:129"):
            return f"`{answer[1]}` behind {taken} lines"
    return None if taken == count else f"{taken} lines taken of {count}"


def alike(one, other):
    """Returns the length of the common start of two sequences."""
    pairs = enumerate(zip(one, other, strict=False))
    return next((n for n, (a, b) in pairs if a != b), min(len(one), len(other)))


class StepTrace:
    """Steps and outputs that a trace file (CSV, written by `replay --trace`) lists."""

    def __init__(self, file):
        names = file.readline().strip().split(",")
        motors = range(len(names) - 5)
        # For each motor: the direction of each of its steps, and the step counts of all motors at that step.
        self.steps = [array("b") for _ in motors]
        self.others = [[array("l") for _ in motors] for _ in motors]
        self.outputs = []
        place, made = [0 for _ in motors], [0 for _ in motors]
        for row in file:
            words = row.rstrip("\n").split(",")
            if words[-4]:
                self.outputs.append((tuple(made), words[-4:]))
            now = [int(word) for word in words[1:-4]]
            moved = [motor for motor in motors if now[motor] != place[motor]]
            for motor in moved:
                made[motor] += 1
            for motor in moved:
                self.steps[motor].append(now[motor] - place[motor])
                for other in motors:
                    self.others[motor][other].append(made[other])
            place = now
        self.ends_at = place

    def differs(self, wanted):
        """Returns the first difference from another trace, or None; the order of steps may differ by `ORDER`."""
        for motor, (steps, wanted_steps) in enumerate(zip(self.steps, wanted.steps, strict=True)):
            if steps != wanted_steps:
                same = alike(steps, wanted_steps)
                return f"motor {motor}: {len(steps)} steps, {len(wanted_steps)} over a clean link, the first {same} alike"
        if self.order(wanted) > ORDER:
            return f"order of the motors: {self.order(wanted)} steps off"
        if self.outputs != wanted.outputs:
            same = alike(self.outputs, wanted.outputs)
            return f"outputs: {self.outputs[same:][:1]}, {wanted.outputs[same:][:1]} over a clean link"
        return None

    def order(self, wanted):
        """Returns the greatest difference of a motor's step count from that in the trace `wanted`, compared at each
        step of each motor. Both traces must have the same steps of each motor."""
        pairs = [pair for mine, its in zip(self.others, wanted.others, strict=True) for pair in zip(mine, its, strict=True)]
        return max((max(map(abs, map(int.__sub__, mine, its)), default=0) for mine, its in pairs), default=0)


def read_trace(program, recording):
    """Replays a recording and returns the trace. Fails if the replay makes other steps than the run."""
    trace = f"{recording}.csv"
    played = subprocess.run([program, "replay", recording, "--trace", trace], capture_output=True, text=True, check=False)
    # Status 1: lines of the job are rejected.
    if played.returncode not in (0, 1):
        raise machine.Failed(f"the recording does not play to the steps of the run: {played.stderr}")
    with open(trace) as file:
        return StepTrace(file)


class Run:
    """A job that has been sent: the sender's summary, faults in the answers, faults of the link, and the steps."""

    def __init__(self, options, lines, send, rate, seed):
        with tempfile.TemporaryDirectory() as folder:
            recording = f"{folder}/job.rec"
            with machine.Machine(
                options.program, "--tcp", "127.0.0.1:0", "--speed", "max", "--record", recording
            ) as mill:
                self.send(mill, lines, send, rate, seed)
            self.trace = read_trace(options.program, recording)
        self.wrong = self.stopped or taken_once(self.said, self.count)
        if not self.wrong and self.trace.ends_at[:3] != self.motor_positions():
            self.wrong = f"the recording ends at {self.trace.ends_at}, the run at {self.motor_positions()}"

    def send(self, mill, lines, send, rate, seed):
        line = Line(mill.address, rate, seed)
        link = checked_sender.Tcp(line.address)
        begin = time.monotonic()
        self.stopped = None
        try:
            self.told = send(link, lines)
        except checked_sender.Stopped as why:
            self.told = self.stopped = f"stopped: {why}"
        self.rate = len(lines) / (time.monotonic() - begin)
        self.motors = mill.rest().split(" order ")[0]
        self.said = bytes(line.said)
        self.count = len(lines)
        self.faults = line.faults
        link.socket.close()
        line.close()

    def motor_positions(self):
        return [int(word) for word in self.motors.split()[1:4]]


def plain_outcome(run, clean):
    """Returns the effect of sending without checks: for each motor, the errors in its position and in its number of steps."""
    off = [a - b for a, b in zip(run.motor_positions(), clean.motor_positions(), strict=True)]
    pulses = [len(a) - len(b) for a, b in zip(run.trace.steps, clean.trace.steps, strict=True)]
    if run.trace.differs(clean.trace) is None:
        return "the same steps"
    return f"OTHER STEPS, ends {off} steps off, {pulses} steps more or less"


def left_at_the_end(program):
    """Checks that the sender program waits for the end of the last move: if it exited earlier, the machine would hold.
    Returns the fault, or None."""
    with tempfile.TemporaryDirectory() as folder:
        job = f"{folder}/job.nc"
        Path(job).write_text("G1 X5 F1000\nX1\nX7\n")
        with machine.Machine(program, "--tcp", "127.0.0.1:0", "--speed", "10") as mill:
            sender = [sys.executable, ROOT / "examples/checked_sender.py", job, "--tcp", mill.address]
            sent = subprocess.run(sender, capture_output=True, text=True, timeout=machine.PATIENCE, check=False)
            motors = mill.motors()[0]
        run = subprocess.run([program, "run", job, "--json"], capture_output=True, check=True)
    wanted = json.loads(run.stdout)["steps"]
    if sent.returncode or motors != wanted:
        return f"the sender has ended with {sent.returncode}, the motors at {motors} instead of {wanted}: {sent.stderr}"
    return None


def dead(until):
    """Simulates a machine that sends the answers in `until`, then nothing. The sender must give up within 10 s. Returns
    the fault, or None."""
    near, far = socket.socketpair()
    link = checked_sender.Tcp.__new__(checked_sender.Tcp)
    link.socket = near
    sender = checked_sender.Sender(link, [(1, "G1X1F100")] * 3, session=SESSION)
    patience, checked_sender.SILENCE = checked_sender.SILENCE, 2.0
    far.sendall("".join(f"{answer}\r\n" for answer in until).encode())
    begin, why = time.monotonic(), None
    try:
        sender.run()
        sender.rest()
    except checked_sender.Stopped as stopped:
        why = str(stopped)
    checked_sender.SILENCE = patience
    waited = time.monotonic() - begin
    near.close()
    far.close()
    if why is None or "said nothing" not in why or waited > 10:
        return f"a silent machine: {why}, after {waited:.1f} s"
    return None


def held(program):
    """Checks that the sender reports a machine that holds because another host left during its job. Returns the fault,
    or None."""
    told = []
    with machine.Machine(program, "--tcp", "127.0.0.1:0") as mill:
        host, _, port = mill.address.rpartition(":")
        with socket.create_connection((host, int(port))) as first:
            first.sendall(b"G1 X50 F100\n")
            while b"ok" not in first.recv(4096):
                pass
        link = checked_sender.Tcp(mill.address)
        sender = checked_sender.Sender(link, [(1, "G1X1F100")], tell=told.append)
        silence, checked_sender.SILENCE = checked_sender.SILENCE, 3.0
        why = None
        try:
            sender.run()
        except checked_sender.Stopped as stopped:
            why = str(stopped)
        checked_sender.SILENCE = silence
        link.socket.close()
    if "the machine is in Hold: Enter resumes" not in told or why is None or "it holds" not in why:
        return f"a machine that holds: {told}, {why}"
    return None


def answer(number):
    """Returns the checked answer `ok` with a line number."""
    return checked_sender.checked(SESSION, number, "ok")


def main():
    parser = argparse.ArgumentParser(description="Jobs in checked lines over a link that damages bytes.")
    parser.add_argument("jobs", nargs="*", default=[str(ROOT / job) for job in JOBS])
    parser.add_argument("--rate", type=int, default=1000, help="one byte in so many has a fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true", help="also without checks")
    parser.add_argument("--program", default=str(ROOT / "target/release/oxmill"))
    options = parser.parse_args()
    for test in (left_at_the_end, held):
        if wrong := test(options.program):
            sys.exit(wrong)
    for until in ([answer(0)], [answer(0), answer(1)], [answer(number) for number in range(4)] + ["ok"]):
        if wrong := dead(until):
            sys.exit(wrong)
    failed = []
    all_faults = 0
    for n, job in enumerate(options.jobs):
        name, lines = str(Path(job).resolve()).removeprefix(f"{ROOT}/"), numbered(checked_sender.program(job))
        clean = Run(options, lines, checked, 0, 0)
        if clean.wrong:
            sys.exit(f"{name} over a clean link: {clean.wrong}")
        run = Run(options, lines, checked, options.rate, options.seed + 2 * n)
        wrong = run.wrong or run.trace.differs(clean.trace)
        all_faults += sum(run.faults.values())
        order = run.trace.order(clean.trace) if not wrong else 0
        outcome = f"FAILED: {wrong}" if wrong else "ok" + (f", order of motors within {order} step" if order else "")
        steps = sum(len(steps) for steps in run.trace.steps)
        print(f"{name}: {len(lines)} lines, {steps} steps, {run.rate:.0f} lines/s ({clean.rate:.0f} over a clean link) ... {outcome}")
        print(f"  {', '.join(f'{count} {fault}' for fault, count in run.faults.items())}; {run.told}", flush=True)
        if wrong:
            failed.append(name)
        if options.plain:
            run = Run(options, lines, plain, options.rate, options.seed + 2 * n)
            print(f"  without checks: {plain_outcome(run, clean)}, {run.rate:.0f} lines/s; {run.told}", flush=True)
    print(f"checked lines: {len(options.jobs) - len(failed)} of {len(options.jobs)} jobs were carried out as over a clean link")
    if all_faults == 0:
        sys.exit("the link had no fault: nothing was tested")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
