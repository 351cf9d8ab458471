"""Bursts of realtime commands: none is lost, and reports come in time."""

import math
import tempfile
from pathlib import Path

from ..board import Failure
from ..scope import Scope
from .bench import JOB_SETTINGS, fast, moving, simulated, us
from .patching import hang, unpatch

ANSWER_S = 20e-3
"""Maximum time, s, from a `?` to the first byte of its report, after a burst of overrides. The burst makes the
controller replan a full queue."""


def flood(bench):
    """Sends more realtime commands than their queue holds while the control task hangs. The last one stops the machine
    and must not be lost: after 0x18 or 0x85 the machine must reset, after `!` it must hold."""
    for last, name in ((b"\x18", "0x18"), (b"\x85", "0x85"), (b"!", "!")):
        bench.boot()
        board, host = bench.board, bench.host
        fast(bench, 1000)
        moving(bench)
        after = len(host.text)
        hang(bench)
        # Each `?` is followed by another command, because the firmware drops a `?` that directly follows an unanswered
        # `?`.
        host.send(45 * b"?\x91" + last)
        board.run(seconds=0.012)
        unpatch(bench)
        if last == b"!":
            bench.wait_state("Hold:0", 1)
            yield "90 commands and !: held"
            continue
        bench.wait_text("Grbl 1.1h", 1, after)
        # The loss is reported when the next byte arrives.
        host.send("\n")
        board.run(seconds=0.01)
        bench.ask("$X")
        bench.ask("G21")
        yield f"90 commands and {name}: a reset, and the link goes on"

FASTER, SLOWER = 9 * b"\x91" + 8 * b"\x93", 9 * b"\x92" + 8 * b"\x94"
"""Overrides from 100 to 198 percent and back, in steps of ten and then of one percent."""


def override_bursts(bench):
    """Sends overrides back to back while the look-ahead is full of short chords on a circle: the step queue must not
    run dry, no step may be lost, and `?` must be answered in time with the present override."""
    angles = [k * 0.1 / 5 for k in range(1, 901)]
    job = "G90 G1 F1200\n" + "".join(f"X{5 * math.sin(angle):.3f}Y{5 - 5 * math.cos(angle):.3f}\n" for angle in angles)
    for jerk in (0, 10_000):
        bench.boot()
        board, host = bench.board, bench.host
        settings = JOB_SETTINGS | {"s10": 3, "s220": jerk, "s221": jerk}
        bench.settings(**settings)
        scope, answers = Scope(board), len(host.answers)
        bench.forget_masks()
        host.stream(job)
        while blocks_free(status := bench.status()) > 8:
            if not status.startswith("<Run") or host.all_answered:
                raise Failure(f"the ring never got full: {status}")
            board.run(seconds=0.02)
        worst, free, bursts = 0.0, 0, 0
        for k in range(8):
            for burst, percent in ((FASTER, 198), (SLOWER, 100)):
                late, status = answered_behind(bench, burst)
                if not status.startswith("<Run") or overrides_of(bench, status) != f"{percent},100,100":
                    raise Failure(f"after a burst to {percent} %: {status}")
                worst, free, bursts = max(worst, late), max(free, blocks_free(status)), bursts + 1
                board.run(seconds=0.005 + 0.0071 * k)
        if host.all_answered:
            raise Failure("the job was over before the last burst: this proves nothing")
        bench.wait(lambda host=host: host.all_answered, 20, "the last answer")
        bench.wait_state("Idle", 20)
        if any(answer != "ok" for answer in host.answers[answers:]) or host.has_said("ALARM") or host.has_said("lost"):
            raise Failure(f"{set(host.answers[answers:])}; {bytes(host.text[-200:])!r}")
        if board.resets or board.usart.overruns:
            raise Failure(f"{len(board.resets)} resets, {board.usart.overruns} overruns")
        steps = same_steps(bench, scope, job, settings)
        mask, where = bench.longest_mask()
        yield f"$220={jerk}: {bursts} bursts of 17 with at most {free} blocks free, `?` answered after at most {worst * 1e3:.1f} ms; {steps} steps as in the simulator; longest time masked {us(mask)} ({where})"
        if worst > ANSWER_S:
            raise Failure(f"`?` was answered after {worst * 1e3:.1f} ms, allowed {ANSWER_S * 1e3:.0f} ms")


def blocks_free(status):
    return int(status.split("Bf:")[1].split(",")[0])


def overrides_of(bench, status):
    """Returns the overrides from the first report that includes them."""
    for _ in range(4):
        if "|Ov:" in status:
            return status.split("|Ov:")[1].rstrip(">").split("|")[0]
        status = bench.status()
    return status


def answered_behind(bench, burst):
    """Sends commands and a `?`. Returns the time in s from the last bit of `?` to the first bit of its report, and the
    report."""
    host, hz = bench.host, bench.wiring.core_hz
    before = len(host.lines)
    heard = host.send(burst + b"?")
    bench.wait(lambda: any(text.startswith("<") and at > heard for at, text in host.lines[before:]), 0.5, "a status report")
    at, text = next((at, text) for at, text in host.lines[before:] if text.startswith("<") and at > heard)
    return (at - heard) / hz - 10 * (len(text) + 2) / host.baud, text


def same_steps(bench, scope, job, settings):
    """Checks that the steps of each axis are those of the simulator, whatever the overrides were. Returns their
    number."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "job.nc"
        file.write_text(job)
        expected, end = simulated(bench, file, settings)
    steps = [(step.axes, step.negative) for step in scope.steps()]
    if scope.counts() != list(end):
        raise Failure(f"the motors are at {scope.counts()} and not at {end}")
    count = 0
    for axis in range(2):
        turned, wanted = ([negative >> axis & 1 for axes, negative in events if axes >> axis & 1] for events in (steps, expected))
        if turned != wanted:
            raise Failure(f"axis {axis} makes {len(turned)} steps, in the simulator {len(wanted)}")
        count += len(turned)
    return count
