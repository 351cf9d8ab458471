#!/usr/bin/env python3
"""Streams jobs in the two ways that Grbl's documents describe, and checks where they end. One way counts the characters
in a receive buffer of 128 bytes; the other sends a line at a time.

    cargo build --release
    python3 tests/senders/streaming.py [--program target/release/oxmill] [--dialect grbl]

This tests the machine: it must answer every line, in order, act on realtime commands at once, and work with Grbl's buffer size.
No dependencies.
"""

import os
import re
import select
import threading
import time
import tty
from collections import deque

import machine

BUFFER = 128


class Streamer:
    """Sends lines while the unanswered bytes fit into the buffer; `window` limits the number of unanswered lines."""

    def __init__(self, window):
        self.window = window
        self.port = None
        self.job = [line for line in map(str.strip, machine.JOB.read_text().splitlines()) if line]

    def open(self, path):
        self.port = os.open(path, os.O_RDWR | os.O_NOCTTY)
        tty.setraw(self.port)
        self.to_send, self.under_way, self.answered = deque(), deque(), 0
        self.greeted = self.locked = False
        self.state, self.report, self.unread = "", "", b""
        self.lock = threading.Lock()
        self.thread = threading.Thread(target=self.serve, args=(self.port,), daemon=True)
        self.thread.start()
        machine.wait("for the greeting", lambda: self.greeted)

    def close(self):
        port, self.port = self.port, None
        self.thread.join()
        os.close(port)

    def serve(self, port):
        """Reads answers, requests a report ten times a second, and fills the buffer."""
        asked = 0
        while self.port is not None:
            if select.select([port], [], [], 0.05)[0]:
                *lines, self.unread = (self.unread + os.read(port, 4096)).split(b"\n")
                for line in lines:
                    self.hear(line.decode("ascii").strip())
            if time.monotonic() - asked > 0.1:
                asked = time.monotonic()
                os.write(port, b"?")
            with self.lock:
                self.fill(port)

    def fill(self, port):
        while self.to_send and len(self.under_way) < self.window:
            line = self.to_send[0] + "\n"
            if sum(self.under_way) + len(line) > BUFFER:
                break
            self.to_send.popleft()
            self.under_way.append(len(line))
            os.write(port, line.encode("ascii"))

    def hear(self, line):
        if line == "ok" or line.startswith("error"):
            with self.lock:
                # If all lines have been answered, this raises an exception: the machine has sent one answer too many.
                self.under_way.popleft()
                self.answered += 1
        elif line.startswith("<"):
            self.report = line
            self.state = re.split(r"[|:]", line[1:])[0]
        elif line.startswith("Grbl "):
            self.greeted = True
            with self.lock:
                self.under_way.clear()

    def realtime(self, byte):
        os.write(self.port, byte)

    def start(self):
        with self.lock:
            self.answered = 0
            self.to_send.extend(self.job)

    def hold(self):
        self.realtime(b"!")
        machine.wait("for the report of a hold", lambda: self.state == "Hold")

    def override(self):
        self.realtime(b"\x91")

    def check_override(self, notes):
        machine.checks_feed_override(notes)

    def resume(self):
        self.realtime(b"~")

    def reset(self):
        with self.lock:
            self.to_send.clear()
        self.greeted = False
        self.realtime(b"\x18")
        machine.wait("for the greeting after a reset", lambda: self.greeted)

    def unlock(self):
        with self.lock:
            self.answered = 0
            self.to_send.append("$X")
        machine.wait("for the answer to $X", lambda: self.answered == 1)

    def is_done(self):
        return self.answered == len(self.job) and self.state == "Idle"

    def place(self):
        told = re.search(r"MPos:([^|]*)", self.report)
        return [float(number) for number in told[1].split(",")]


machine.main({"characters counted": lambda: Streamer(BUFFER), "a line at a time": lambda: Streamer(1)})
