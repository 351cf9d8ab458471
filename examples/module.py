#!/usr/bin/env python3
"""Checks a job with the firmware, compiled to WebAssembly, as a program of your own would: oxmill.wasm has no imports.

    pip install wasmtime
    python3 examples/module.py target/web/oxmill.wasm JOB.nc [110=5000 ...]

Prints the summary as `oxmill run JOB.nc --json` does. The functions of the module are described in src/web/lib.rs.
"""

import json
import sys

from wasmtime import Instance, Module, Store, Trap, WasmtimeError


class Refused(Exception):
    """Says why the module refused a job, or why the module ended."""


class Oxmill:
    """An instance of the module. It checks one job at a time."""

    def __init__(self, path):
        self.store = Store()
        self.exports = Instance(self.store, Module.from_file(self.store.engine, path), []).exports(self.store)

    def call(self, name, *arguments):
        """Calls an exported function; `name` is without the prefix `oxmill_`."""
        try:
            return self.exports[f"oxmill_{name}"](self.store, *arguments)
        except Trap as trap:
            # A panic of the firmware ends the instance and leaves its message as the text `panic`.
            raise Refused(self.text("panic") or str(trap)) from trap

    def text(self, name):
        memory, functions = self.exports["memory"], [self.exports[f"oxmill_{part}"] for part in (name, f"{name}_len")]
        # The module returns addresses as signed numbers.
        at, length = (function(self.store) & 0xFFFFFFFF for function in functions)
        return bytes(memory.read(self.store, at, at + length)).decode()

    def put(self, data):
        at = self.call("input", len(data)) & 0xFFFFFFFF
        self.exports["memory"].write(self.store, data, at)

    def check(self, job, **order):
        """Returns the summary of a job as a dictionary. `order`: see src/web/lib.rs."""
        self.put(json.dumps(order).encode() + b"\0" + job)
        if self.call("check_begin"):
            raise Refused(self.text("output"))
        while (part := self.call("check_advance", 100_000)) <= 1000:
            print(f"{part / 10:.0f} %", end="\r", file=sys.stderr)
        self.put(order.get("name", "").encode())
        self.call("check_summary")
        return json.loads(self.text("output"))


def main(module, name, *pairs):
    try:
        with open(name, "rb") as file:
            job = file.read()
        settings = {number: float(value) for number, value in (pair.split("=") for pair in pairs)}
        summary = Oxmill(module).check(job, name=name, board="blackpill_f411", settings=settings)
    except (Refused, OSError, ValueError, WasmtimeError) as why:
        print(why, file=sys.stderr)
        return 2
    print(json.dumps(summary, indent=2))
    return 1 if summary["errors"] or summary["alarm"] or not summary["complete"] else 0


if len(sys.argv) < 3:
    print("usage: module.py OXMILL.wasm JOB.nc [110=5000 ...]", file=sys.stderr)
    sys.exit(2)
sys.exit(main(*sys.argv[1:]))
