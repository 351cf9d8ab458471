#!/usr/bin/env python3
"""Streams a job from bCNC to the simulator over a pseudo terminal, without a display, and checks where it ends.

    python3 -m venv target/bcnc && target/bcnc/bin/pip install bCNC
    cargo build --release
    target/bcnc/bin/python tests/senders/bcnc.py [JOB.nc ...]

What is tested is bCNC's own code: loading and compiling the file (`GCode`), opening the port, the character-counting
thread (`Sender.serialIO`) and the reading of answers and reports (`controllers/GRBL1`). Only its window is left out;
`run` below is what the window's Run button does, without the drawing.

Passes if bCNC comes to the end of each job, saw no error and no alarm, and believes the machine to be where
`oxmill run` leaves it. Needs Linux or macOS, and Python with tkinter (bCNC imports it).
"""

import builtins
import importlib.util
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
OXMILL = ROOT / "target/release/oxmill"
JOBS = ["examples/five_circles.nc", "tests/jobs/arcs.nc", "tests/jobs/lines.nc", "tests/jobs/relief.nc"]
# Times faster than life; the bytes on the line are as many.
SPEED = "8"
PATIENCE = 600

found = importlib.util.find_spec("bCNC")
if found is None or found.origin is None:
    sys.exit("bCNC is missing: pip install bCNC")
BCNC = Path(found.origin).parent
for folder in ["", "lib", "controllers", "plugins"]:
    sys.path.insert(0, str(BCNC / folder))

# bCNC reads and writes its settings in the user's folder; a test has one of its own.
HOME = tempfile.mkdtemp()
os.environ["HOME"] = HOME

# bCNC installs its translation as a builtin before it imports the rest.
builtins._ = str
import Utils  # noqa: E402

Utils.prgpath = str(BCNC)
Utils.loadConfiguration(True)
import Sender  # noqa: E402
from CNC import CNC, WAIT  # noqa: E402


class Headless(Sender.Sender):
    """bCNC without its window."""

    def disable(self):
        pass

    def enable(self):
        pass

    def checkStop(self):
        return self._stop

    def run(self):
        """The Run button."""
        self.cleanAfter = True
        self.initRun()
        self._runLines = sys.maxsize
        self._gcount = 0
        CNC.vars["running"] = True
        CNC.vars["_OvChanged"] = True
        paths = self.gcode.compile(self.queue, self.checkStop)
        if not paths:
            sys.exit("bCNC finds nothing to run")
        self._runLines = len(paths) + 1
        self.queue.put((WAIT,))

    def wait(self, condition, what):
        """Waits as the window's timer does: reads the log and ends the run when all lines have been executed."""
        until = time.time() + PATIENCE
        while not condition():
            if time.time() > until:
                sys.exit(f"bCNC waits in vain: {what}; state {CNC.vars['state']}, {self._gcount} of {self._runLines}")
            while not self.log.empty():
                kind, text = self.log.get_nowait()
                if kind == Sender.Sender.MSG_ERROR or "error:" in str(text) or "ALARM" in str(text):
                    sys.exit(f"bCNC was told {text!r}")
            if self.running and self._gcount >= self._runLines:
                self.runEnded()
            time.sleep(0.05)


def stream(job):
    options = ["--dialect", "grbl"]
    plain = subprocess.run([OXMILL, "run", ROOT / job, "--json", *options], capture_output=True, text=True, check=False)
    summary = json.loads(plain.stdout)
    if plain.returncode != 0:
        sys.exit(f"{job}: oxmill run: {summary['errors']}")
    with tempfile.TemporaryDirectory() as folder:
        port = f"{folder}/mill"
        mill = subprocess.Popen([OXMILL, "serve", "--pty", port, "--speed", SPEED, *options], stdout=subprocess.PIPE)
        try:
            mill.stdout.readline()
            bcnc = Headless()
            bcnc.gcode.load(str(ROOT / job))
            bcnc.open(port, 115200)
            bcnc.wait(lambda: CNC.vars["state"] == "Idle", "for the machine to be idle")
            began = time.time()
            bcnc.run()
            bcnc.wait(lambda: not bcnc.running, "for the end of the job")
            bcnc.wait(lambda: CNC.vars["state"] == "Idle", "for rest")
            # One more report, to be sure that it is the last.
            time.sleep(0.5)
            believed = [CNC.vars[name] for name in ("mx", "my", "mz")]
            took = time.time() - began
            lines = bcnc._gcount
            bcnc.close()
        finally:
            mill.kill()
            mill.wait()
    expected = summary["position_mm"]
    if any(abs(a - b) > 0.0006 for a, b in zip(believed, expected, strict=True)):
        sys.exit(f"{job}: bCNC believes {believed}, the machine should be at {expected}")
    print(f"{job}: {lines} lines in {took:.1f} s, ended at {believed}")


for name in sys.argv[1:] or JOBS:
    stream(name)
print("bCNC: all jobs ran to their end")
# bCNC's threads may still wait for a port that is gone.
os._exit(0)
