#!/usr/bin/env python3
"""Streams jobs by the Python library pygrbl-streamer to the simulator over a pseudo terminal, and checks where they end.

    cargo build --release
    bash tests/senders/install
    target/tools/senders/python/bin/python tests/senders/with_pygrbl_streamer.py [--program target/release/oxmill] [--dialect grbl]

The library counts characters, requests no report while it sends a job, and has no overrides: Grbl's override byte is sent by its
method `realtime`.
"""

import re
import threading

import machine
from pygrbl_streamer import GrblStreamer, State


class Library:
    def __init__(self):
        self.errors = []
        self.outcome = None
        self.thread = None

    def open(self, port):
        self.streamer = GrblStreamer(port)
        self.streamer.error_callback = self.errors.append
        self.streamer.connect()

    def close(self):
        self.streamer.disconnect()

    def start(self):
        self.outcome = None
        self.thread = threading.Thread(target=self.stream, daemon=True)
        self.thread.start()

    def stream(self):
        self.outcome = self.streamer.send_file(str(machine.JOB))

    def hold(self):
        self.streamer.pause()
        if self.streamer.state is not State.PAUSED:
            raise machine.Failed(f"paused, the library is {self.streamer.state}")

    def resume(self):
        self.streamer.resume()

    def override(self):
        self.streamer.realtime(b"\x91")
        machine.wait("for the library to be told the override", self.is_overridden)

    def is_overridden(self):
        self.look()
        return "|Ov:110," in self.streamer.last_status.get("raw", "")

    def look(self):
        self.streamer.realtime(b"?")

    def check_override(self, notes):
        machine.checks_feed_override(notes)

    def reset(self):
        if not self.streamer.reset(unlock=False):
            machine.wait("for the library to know the alarm", lambda: self.streamer.state is State.ALARM)
        self.thread.join()
        if self.outcome is not False:
            raise machine.Failed("the library takes a job that was reset for complete")

    def unlock(self):
        if not self.streamer.unlock():
            raise machine.Failed("the library could not unlock")

    def is_done(self):
        if self.errors:
            raise machine.Failed(f"the library was told {self.errors}")
        return self.outcome is True and self.streamer.state is State.IDLE

    def place(self):
        told = re.search(r"MPos:([^|]*)", self.streamer.last_status["raw"])
        return [float(number) for number in told[1].split(",")]


machine.main({"pygrbl-streamer 1.0.5": Library})
