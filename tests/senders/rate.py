#!/usr/bin/env python3
"""Measures how fast the simulator's server takes short lines over TCP from a sender that counts characters. Also shows
whether a job of 50,000 lines a second takes longer than its motion.

    cargo build --release
    python3 tests/senders/rate.py [--program target/release/oxmill] [--lines 100000]

The lines are chords of 0.02 mm on a large circle, at 1000 mm/s. `--speed max` runs without a clock and shows the
server's maximum rate. With the clock of the host the job cannot be faster than its motion, and is slower if the server
limits it. The test checks that each line is answered with `ok`, and that the final position is that of `oxmill run`;
times are printed, not checked. This program shares the processors with the server. No dependencies.
"""

import argparse
import json
import math
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque

# A machine with belts, because ball screws would need too many steps at this speed.
MACHINE = {100: 80, 101: 80, 110: 60000, 111: 60000, 120: 5000, 121: 5000}
RADIUS_MM, CHORD_MM, FEED = 200, 0.02, 60000


def program_lines(count):
    """Yields a circle of `count` chords, then the way back to its start."""
    yield f"G90 G1 F{FEED}\n"
    for k in range(count):
        angle = k * CHORD_MM / RADIUS_MM
        yield f"G1X{RADIUS_MM * (math.cos(angle) - 1):.3f}Y{RADIUS_MM * math.sin(angle):.3f}\n"


def settings():
    return [word for number, value in MACHINE.items() for word in ("--set", f"{number}={value}")]


def motion(program, lines):
    """Runs the lines in simulated time. Returns the duration of the motion, s, and the end position, mm."""
    with tempfile.NamedTemporaryFile("w", suffix=".nc") as job:
        job.writelines(lines)
        job.flush()
        said = subprocess.run([program, "run", job.name, "--json", *settings()], check=True, capture_output=True, text=True)
    report = json.loads(said.stdout)
    return report["moving_s"], report["position_mm"]


def stream(port, lines, window):
    """Sends lines while they fit into the window; returns when all have been answered."""
    under_way, used, unread, waiting = deque(), 0, b"", deque(line.encode() for line in lines)
    while waiting or under_way:
        ready = []
        while waiting and used + len(waiting[0]) <= window:
            ready.append(waiting.popleft())
            under_way.append(len(ready[-1]))
            used += under_way[-1]
        port.sendall(b"".join(ready))
        received = port.recv(1 << 16)
        if not received:
            sys.exit("the server has closed the connection")
        *answers, unread = (unread + received).split(b"\n")
        for answer in answers:
            if answer.startswith(b"error"):
                sys.exit(f"a line is answered with {answer.decode()}")
            if answer.startswith(b"ok"):
                used -= under_way.popleft()


def rest(port):
    """Waits for the end of the motion; returns the position."""
    said = b""
    while True:
        port.sendall(b"?")
        time.sleep(0.01)
        said = (said + port.recv(1 << 16))[-1000:]
        if found := re.findall(rb"<Idle\|MPos:([^|>]+)", said):
            return [float(value) for value in found[-1].split(b",")]


def serve(program, speed, lines, window):
    """Streams the lines to a new server. Returns the time until the last answer, the time until rest (both in s, from
    the first line on), and the end position, mm."""
    command = [program, "serve", "--tcp", "0", "--speed", speed, *settings()]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as server:
        try:
            address = server.stdout.readline().split()[1].rsplit(":", 1)
            port = socket.create_connection((address[0], int(address[1])))
            port.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while b"$H" not in (welcome := port.recv(1 << 16)) and b"help" not in welcome:
                pass
            begin = time.monotonic()
            stream(port, lines, window)
            answered = time.monotonic() - begin
            place = rest(port)
            return answered, time.monotonic() - begin, place
        finally:
            server.kill()


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--program", default="target/release/oxmill")
    parser.add_argument("--lines", type=int, default=100_000)
    wanted = parser.parse_args()
    lines = list(program_lines(wanted.lines))
    seconds, place = motion(wanted.program, lines)
    print(f"{len(lines)} lines, {seconds:.2f} s of motion: {len(lines) / seconds:.0f} lines/s")
    for speed, window in (("max", 128), ("max", 1024), ("1", 128), ("1", 1024)):
        answered, ended, at = serve(wanted.program, speed, lines, window)
        print(f"--speed {speed}, window of {window} bytes: {len(lines) / answered:.0f} lines/s; the job took {ended / seconds:.2f} of its motion")
        if any(abs(a - b) > 0.002 for a, b in zip(at, place, strict=False)):
            sys.exit(f"ends at {at}, and not at {place}")


if __name__ == "__main__":
    main()
