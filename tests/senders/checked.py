#!/usr/bin/env python3
"""Streams jobs in checked lines to the simulator over a link that damages bytes, and compares the steps.

    cargo build --release
    python3 tests/senders/checked.py [--rate N] [--plain] [--seed N] [JOB.nc ...]

Between the sender (`examples/checked_sender.py`) and the machine one byte in N (1,000), both ways, has one bit flipped, is
dropped, is doubled or comes late. Passes if each job ends where it does over a clean link, each motor with as many pulses. Whether
also their order is the same is only told: a machine that has to wait for lines joins short moves in other places. `--plain` also
sends each job a line at a time without checks, to show what is lost then; that cannot fail.
"""

import argparse
import random
import socket
import sys
import threading
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "examples"))
import checked_sender  # noqa: E402

import machine  # noqa: E402

JOBS = [f"tests/jobs/{name}.nc" for name in ["chords", "helix", "increments", "jerk", "lines", "relief"]]
JOBS += [f"examples/{name}.nc" for name in ["pcb_isolation", "pocket_inch", "pocket_mm", "relief"]]
# Long enough that a late byte is seen, short enough that nobody waits.
LATE = 0.02


class Line:
    """A link that damages bytes, between a port of its own and the machine's."""

    def __init__(self, address, rate, seed):
        self.rate = rate
        self.faults = {"flipped": 0, "dropped": 0, "doubled": 0, "late": 0}
        host, port = address.rsplit(":", 1)
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
    """Sends a job in checked lines; what it says of it."""
    sender = checked_sender.Sender(link, lines, tell=lambda text: None)
    sender.run()
    return ", ".join(f"{count} {name}" for name, count in sender.counts.items())


def plain(link, lines):
    """Sends a job as a patient sender without checks does: a line, its answer, the next line."""
    received, late = b"", 0
    errors = 0
    for _, text in [(0, "")] + lines:
        link.send(text.encode("ascii") + b"\n")
        until = time.monotonic() + 2
        while time.monotonic() < until:
            *answers, received = (received + link.receive(0.05)).split(b"\n")
            errors += sum(answer.startswith(b"error") for answer in answers)
            if any(answer.startswith((b"ok", b"error")) for answer in answers):
                break
        else:
            late += 1
    return f"{errors} errors, {late} answers lost"


def run(options, lines, send, rate, seed):
    """The steps of a job, what its sender says, and the faults of the link."""
    with machine.Machine(options.program, "--tcp", "127.0.0.1:0", "--speed", "max") as mill:
        line = Line(mill.address, rate, seed)
        link = checked_sender.Tcp(line.address)
        begin = time.monotonic()
        try:
            said = send(link, lines)
        except checked_sender.Stopped as why:
            said = f"stopped: {why}"
        seconds = time.monotonic() - begin
        steps = mill.rest().split(" order ")
        link.socket.close()
        line.close()
        return steps, said, line.faults, seconds


def main():
    parser = argparse.ArgumentParser(description="Jobs in checked lines over a link that damages bytes.")
    parser.add_argument("jobs", nargs="*", default=[str(ROOT / job) for job in JOBS])
    parser.add_argument("--rate", type=int, default=1000, help="one byte in so many has a fault")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--plain", action="store_true", help="also without checks")
    parser.add_argument("--program", default=str(ROOT / "target/release/oxmill"))
    options = parser.parse_args()
    failed = []
    all_faults = 0
    for n, job in enumerate(options.jobs):
        name, lines = str(Path(job).resolve()).removeprefix(f"{ROOT}/"), checked_sender.program(job)
        wanted, said, _, clean = run(options, lines, checked, 0, 0)
        if "stopped" in said:
            sys.exit(f"{name} over a clean link: {said}")
        steps, said, faults, seconds = run(options, lines, checked, options.rate, options.seed + 2 * n)
        is_same = steps[0] == wanted[0] and "stopped" not in said
        all_faults += sum(faults.values())
        order = "same" if steps == wanted else "other"
        outcome = f"ok, {order} order" if is_same else f"FAILED\n  {wanted[0]}\n  {steps[0]}"
        rates = f"{len(lines) / seconds:.0f} lines/s ({len(lines) / clean:.0f} over a clean link)"
        print(f"{name}: {len(lines)} lines, {rates} ... {outcome}")
        print(f"  {', '.join(f'{count} {fault}' for fault, count in faults.items())}; {said}", flush=True)
        if not is_same:
            failed.append(name)
        if options.plain:
            steps, said, faults, seconds = run(options, lines, plain, options.rate, options.seed + 2 * n)
            outcome = "the same steps" if steps[0] == wanted[0] else "OTHER STEPS"
            print(f"  without checks: {outcome}, {len(lines) / seconds:.0f} lines/s; {said}", flush=True)
    print(f"checked lines: {len(options.jobs) - len(failed)} of {len(options.jobs)} jobs made the same steps")
    if all_faults == 0:
        sys.exit("the link had no fault: nothing was tested")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
