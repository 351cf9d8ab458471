#!/usr/bin/env python3
"""Streams jobs by the server of cncjs to the simulator over a pseudo terminal, and checks where they end.

    cargo build --release
    bash tests/senders/install
    target/tools/senders/python/bin/python tests/senders/cncjs.py [--program target/release/oxmill] [--dialect grbl]

This runs the server that the package installs, which opens the port with its own serial library. The test takes the
place of the web page and uses the page's interface: a token by HTTP, then commands and events over socket.io. Needs
Node.js 18 or later.
"""

import os
import re
import subprocess
import tempfile
import threading

import machine
import requests
import socketio

SERVER = machine.ROOT / "target/tools/senders/cncjs/node_modules/cncjs/bin/cncjs"


def start_server():
    """Starts a server on a free port of the loopback; returns its process and its address."""
    home = tempfile.mkdtemp()
    command = ["node", SERVER, "--host", "127.0.0.1", "--port", "0", "--config", f"{home}/cncrc", "--controller", "Grbl", "-v"]
    process = subprocess.Popen(command, env={**os.environ, "HOME": home}, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    for line in process.stdout:
        told = re.search(r"Starting the server at .*(http://127\.0\.0\.1:\d+)", line)
        if told:
            # Keep reading the pipe: the server would block when the pipe is full.
            threading.Thread(target=process.stdout.read, daemon=True).start()
            return process, told[1]
    raise machine.Failed("the server of cncjs does not start")


class Page:
    """Takes the place of cncjs's web page: sends commands to the server and receives the server's events."""

    def __init__(self):
        self.process, address = start_server()
        machine.END.append(self.process.kill)
        token = requests.post(f"{address}/api/signin", json={}, timeout=machine.PATIENCE).json()["token"]
        self.state, self.settings, self.workflow, self.progress, self.told = {}, {}, "", {}, []
        self.client = socketio.Client()
        self.client.on("controller:state", self.hear_state)
        self.client.on("controller:settings", lambda _, settings: self.settings.update(settings))
        self.client.on("workflow:state", self.hear_workflow)
        self.client.on("sender:status", self.progress.update)
        self.client.on("serialport:read", self.told.append)
        self.client.connect(f"{address}?token={token}")

    def hear_state(self, _, state):
        self.state = state

    def hear_workflow(self, state):
        self.workflow = state

    def active(self):
        return self.state.get("status", {}).get("activeState")

    def call(self, event, *what):
        fault = self.client.call(event, what, timeout=machine.PATIENCE)
        if fault:
            raise machine.Failed(f"cncjs: {event}: {fault}")

    def command(self, *what):
        self.client.emit("command", (self.port, *what))

    def open(self, port):
        self.port = port
        self.state = {}
        self.call("open", port, {"controllerType": "Grbl", "baudrate": 115200})
        machine.wait("for cncjs to see the machine idle", lambda: self.active() == "Idle")
        machine.wait("for cncjs to know the settings", lambda: "$132" in self.settings.get("settings", {}))

    def close(self):
        self.call("close", self.port)

    def start(self):
        self.command("gcode:load", machine.JOB.name, machine.JOB.read_text())
        machine.wait("for cncjs to load the job", lambda: self.progress.get("name") == machine.JOB.name)
        self.command("gcode:start")
        machine.wait("for cncjs to run", lambda: self.workflow == "running")

    def hold(self):
        self.command("gcode:pause")
        machine.wait("for cncjs to show the hold", lambda: self.workflow == "paused" and self.active() == "Hold")

    def resume(self):
        self.command("gcode:resume")

    def override(self):
        self.command("feedOverride", 10)
        machine.wait("for cncjs to know the override", lambda: self.state["status"].get("ov", [None])[0] == 110)

    def check_override(self, notes):
        machine.checks_feed_override(notes)

    def reset(self):
        self.command("reset")
        machine.wait("for cncjs to show the reset", lambda: self.active() in ("Alarm", "Idle") and self.workflow == "idle")

    def unlock(self):
        self.command("unlock")
        machine.wait("for cncjs to see the machine idle", lambda: self.active() == "Idle")

    def is_done(self):
        faults = [line for line in self.told if line.startswith("error")]
        if faults:
            raise machine.Failed(f"cncjs was told {faults}")
        return self.workflow == "idle" and self.active() == "Idle" and self.progress["received"] in (0, self.progress["total"])

    def place(self):
        return [float(self.state["status"]["mpos"][axis]) for axis in "xyz"]


machine.main({"cncjs 1.11.5": Page})
