"""Runs the cases on one board: `python -m virtual_board BOARD ELF OXMILL [CASE ...]`, as `cargo xtask virtual` does.

Runs all cases if none is named; `-CASE` excludes a case. Options: `--profile` also prints where the cycles went;
`--reading NAME` uses the second reading of a fact that the manuals leave open (models/readings.py).
"""

import sys
import time
from pathlib import Path

from . import profile
from .board import Failure, Image
from .cases import KNOWN, all_cases
from .cases.bench import STACK_LEFT, Bench, LeftOut
from .models import readings
from .parts import BOARDS


def chosen(cases, names):
    """Returns the named cases, or all if none is named, without those that have a `-` before their name."""
    known = {name for name, _ in cases}
    if unknown := {name.removeprefix("-") for name in names} - known:
        sys.exit(f"there are no such cases: {', '.join(sorted(unknown))}")
    wanted = [name for name in names if not name.startswith("-")] or known
    return [(name, case) for name, case in cases if name in wanted and f"-{name}" not in names]


def main(board, elf, oxmill, *names):
    bench = Bench(BOARDS[board], Image(elf), oxmill)
    root = Path(__file__).resolve().parents[2]
    failed = passed = missing = known = 0
    if is_profiled := "--profile" in names:
        profile.begin()
        names = [name for name in names if name != "--profile"]
    reading = ""
    if "--reading" in names:
        at = names.index("--reading")
        readings.choose(name := names[at + 1])
        names, reading = [*names[:at], *names[at + 2 :]], f", reading {name}"
    print(f"\nvirtual board {board} ({bench.wiring.part.name}{reading})", flush=True)
    for name, case in chosen(all_cases(root), names):
        begin, lines, outcome = time.monotonic(), [], "ok"
        bench.origin, bench.case = 0, name
        try:
            lines.extend(case(bench))
            bench.note_stack()
            passed += 1
            if (board, name) in KNOWN:
                outcome = "ok, although it is on the list of known faults: take it off"
        except Failure as failure:
            if (board, name) in KNOWN:
                outcome = f"known fault: {KNOWN[board, name]}\n  {failure}"
                known += 1
            else:
                outcome, failed = f"FAILED\n  {failure}", failed + 1
        except LeftOut as why:
            outcome = f"left out: {why}"
            missing += 1
        print(f"case {name} ... {outcome} ({time.monotonic() - begin:.1f} s)")
        for line in lines:
            print(f"  {line}", flush=True)
    if is_profiled:
        print("\n".join(profile.table(bench.image)))
    used, size, where = bench.deepest
    print(f"deepest stack of all cases: {used} of {size} bytes ({where})")
    if size - used < STACK_LEFT:
        print(f"FAILED: less than {STACK_LEFT} bytes of the stack are left")
        failed += 1
    print(f"virtual board {board}{reading}: {passed} passed, {failed} failed, {known} known faults, {missing} left out", flush=True)
    return 1 if failed or not passed else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
