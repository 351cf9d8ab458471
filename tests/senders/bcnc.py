#!/usr/bin/env python3
"""Streams jobs from bCNC, in its window, to the simulator over a pseudo terminal, and checks where they end.

    cargo build --release
    bash tests/senders/install
    target/tools/senders/python/bin/python tests/senders/bcnc.py [--program target/release/oxmill] [--dialect grbl]

This runs the real bCNC from its `main`: window, buttons, and the thread that counts characters and reads answers and
reports. The window is on a display in memory (Xvfb). The test triggers the same events as the buttons of bCNC. Any
message box that bCNC shows is a fault. Needs Linux, Xvfb, and Python with tkinter.
"""

import importlib.util
import os
import queue
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path
from tkinter import messagebox

import machine

found = importlib.util.find_spec("bCNC")
if found is None or found.origin is None:
    sys.exit("bCNC is missing: bash tests/senders/install")
sys.path.append(str(Path(found.origin).parent))
# bCNC keeps its settings in the home folder. A temporary home folder leaves the settings of the user unchanged.
HOME = tempfile.mkdtemp()
os.environ["HOME"] = HOME
# Disable the message box about updates, and the server for phones.
(Path(HOME) / ".bCNC").write_text("[bCNC]\ncheckinterval = 0\nlastcheck = 1\n[Connection]\npendant = 0\nopenserial = 0\n")


def display():
    """Starts a display in memory and returns its name, such as `:1`. The display ends with its last window."""
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x1024x24", "-nolisten", "tcp", "-terminate"]
    subprocess.Popen(command, pass_fds=[writing], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as told:
        return f":{told.readline().strip()}"


class Window:
    """bCNC's window. The scenario runs in another thread, and hands its actions to the window's thread by `do`."""

    def __init__(self):
        self.application = None
        self.boxes = []
        # Number of jobs started, and number of jobs after which bCNC has cleaned up. To clean up, bCNC sends hold,
        # reset and `$X` in another thread.
        self.started = self.cleaned = 0
        self.to_do = queue.Queue()

    def run_actions(self):
        """Runs the actions in `to_do`. The window's timer calls this method every 20 ms."""
        while not self.to_do.empty():
            action, done = self.to_do.get()
            try:
                done.put(action())
            except Exception as why:
                done.put(why)
        self.application.after(20, self.run_actions)

    def do(self, action):
        if self.boxes:
            raise machine.Failed(f"bCNC shows a box: {self.boxes}")
        done = queue.Queue()
        self.to_do.put((action, done))
        outcome = done.get(timeout=machine.PATIENCE)
        if isinstance(outcome, Exception):
            raise outcome
        return outcome

    def event(self, name):
        self.do(lambda: self.application.event_generate(name))

    def open(self, port):
        def press():
            bmain.Page.frames["Serial"].portCombo.set(port)
            self.application.openClose()

        self.do(press)
        machine.wait("for bCNC to see the machine idle", lambda: CNC.vars["state"] == "Idle")

    def close(self):
        self.do(self.application.openClose)

    def start(self):
        machine.wait("for bCNC to be answered", self.is_answered)
        self.do(lambda: self.application.load(str(machine.JOB)))
        self.started += 1
        self.event("<<Run>>")

    def is_answered(self):
        """Returns whether bCNC gets answers, so that the greeting of the last reset has arrived. bCNC drops a job that
        is started before the greeting."""
        CNC.vars["G"] = []
        self.do(self.application.viewState)
        time.sleep(0.3)
        return CNC.vars["G"] != []

    def hold(self):
        self.event("<<FeedHold>>")
        machine.wait("for bCNC to show the hold", lambda: CNC.vars["state"].startswith("Hold"))

    def resume(self):
        self.event("<<Resume>>")

    def override(self):
        """Moves the slider of the feed override to 110 %."""
        state = bmain.Page.frames["State"]

        def slide():
            state.overrideCombo.set("Feed")
            state.override.set(110)
            state.overrideChange()

        self.do(slide)
        machine.wait("for bCNC to know the override", lambda: CNC.vars["OvFeed"] == 110)

    def check_override(self, notes):
        machine.checks_feed_override(notes)

    def reset(self):
        self.do(self.application.softReset)
        # After a soft reset bCNC still considers the job running. Its Stop button ends the job and resets the machine
        # again.
        self.event("<<Stop>>")

    def unlock(self):
        machine.wait("for bCNC to end the run", self.ended)
        self.do(self.application.unlock)
        machine.wait("for bCNC to clean up", self.is_done)

    def ended(self):
        return not self.application.running

    def is_done(self):
        return not self.application.running and self.cleaned == self.started and CNC.vars["state"] == "Idle"

    def place(self):
        return [CNC.vars[name] for name in ("mx", "my", "mz")]

    def show(self, options):
        """Runs bCNC in this thread, and the scenario in another one."""

        class Application(bmain.Application):
            def mainloop(self, *_):
                window.application = self
                self.after(20, window.run_actions)
                threading.Thread(target=machine.main, args=({"bCNC in its window": lambda: window}, options), daemon=True).start()
                super().mainloop()

            def jobDone(self):
                super().jobDone()
                window.cleaned += 1

        window = self
        bmain.Application = Application
        for box in ("showinfo", "showwarning", "showerror", "askquestion", "askyesno", "askokcancel"):
            setattr(messagebox, box, lambda *said, **_: self.boxes.append(said))
        start.main()


if __name__ == "__main__":
    os.environ["DISPLAY"] = display()
    from bCNC import __main__ as start

    # Must be imported first: it installs the translation function that the other modules use.
    import Helpers  # noqa: F401
    import bmain
    from CNC import CNC

    options = machine.arguments()
    # Remove the arguments of this test, because bCNC parses `sys.argv` itself.
    del sys.argv[1:]
    Window().show(options)
