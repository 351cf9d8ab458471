#!/usr/bin/env python3
"""Streams jobs by the Python library grbl-streamer to the simulator over a pseudo terminal, and checks where they end.

    cargo build --release
    bash tests/senders/install
    target/tools/senders/python/bin/python tests/senders/with_grbl_streamer.py [--program target/release/oxmill] [--dialect grbl]

The library counts characters, sends `?` five times a second during a job, and overrides the feed by changing F words.
"""

import time

import machine
from grbl_streamer import GrblStreamer

# This feed lies between two feeds of the job, so it is not one of the job's own F words.
FEED = "F123.0"


class Library:
    def __init__(self):
        self.errors = []
        self.completed = self.booted = self.states = 0
        self.starts = self.is_next_ok_the_last = False
        self.streamer = GrblStreamer(self.event)
        self.streamer.setup_logging()

    def event(self, name, *data):
        """Handles events of the library, in its threads."""
        if name == "on_job_completed":
            self.completed += 1
        elif name == "on_boot":
            self.booted += 1
        elif name == "on_read" and data[0].startswith("[GC:"):
            self.states += 1
        elif name == "on_error":
            self.errors.append(data)
        elif name == "on_read" and data[0].startswith("$N1="):
            self.is_next_ok_the_last = self.starts
        elif name == "on_rx_buffer_percent" and self.is_next_ok_the_last:
            # The library has handled the last `ok`.
            self.starts = self.is_next_ok_the_last = False
            self.streamer.job_run()

    def open(self, port):
        # The machine sends two greetings: when its port is opened, and when the library resets it. At each greeting the
        # library drops its job. So wait for the answer to a line sent now, which comes after both greetings.
        self.states = 0
        self.streamer.cnect(port)
        machine.wait("for the library to be answered", self.is_answered)
        self.streamer.poll_start()
        self.wait_for("Idle")

    def is_answered(self):
        # At a greeting the library drops one received line, so the request may have to be repeated.
        self.streamer.get_gcode_parser_state()
        time.sleep(0.3)
        return self.states > 0

    def wait_for(self, state):
        machine.wait(f"for the library to know {state}", lambda: self.streamer.cmode == state)

    def close(self):
        self.streamer.disconnect()

    def start(self):
        # The library sends lines without a lock in two threads: in the thread that starts a job and, from the first
        # `ok` on, in the receiving thread. It also mistakes the answer to one of its own requests for an answer to the
        # job. So start the job in the receiving thread, after everything else has been answered. This is at the `ok`
        # after `$N1=`, which is the last line of the listing of `$N`.
        self.streamer.poll_stop()
        self.streamer.job_new()
        self.streamer.set_feed_override(False)
        self.streamer.load_file(str(machine.JOB))
        self.completed, self.errors = 0, []
        self.starts = True
        self.streamer.send_immediately("$N")
        machine.wait("for the job to be started", lambda: not self.starts)
        self.streamer.poll_start()

    def hold(self):
        self.streamer.hold()
        self.wait_for("Hold:0")

    def resume(self):
        self.streamer.resume()

    def override(self):
        self.streamer.set_feed_override(True)
        self.streamer.request_feed(123)

    def check_override(self, notes):
        if not any(FEED in line for line in notes[0]) or not any("|FS:123," in report for report in notes[3]):
            raise machine.Failed("the feed was not overridden")

    def reset(self):
        booted = self.booted
        # Without this call the library would send lines after the reset until it sees the greeting, and they would be
        # rejected.
        self.streamer.job_halt()
        self.streamer.softreset()
        machine.wait("for the library to see the greeting", lambda: self.booted > booted)

    def unlock(self):
        machine.wait("for the library to know the state", lambda: self.streamer.cmode in ("Alarm", "Idle"))
        self.streamer.killalarm()
        self.wait_for("Idle")

    def is_done(self):
        if self.errors:
            raise machine.Failed(f"the library was told {self.errors}")
        return self.completed > 0 and self.streamer.cmode == "Idle"

    def place(self):
        return self.streamer.cmpos


machine.main({"grbl-streamer 2.0.2": Library})
