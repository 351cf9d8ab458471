"""Holds, resets and stops: the pulses must end in time, and the reported position must be that of the pins."""

import os
from itertools import pairwise
from random import Random

from ..board import Failure
from ..models import timer
from ..models.dma import NDTR
from ..models.timer import EGR, SMCR
from ..scope import Scope
from .bench import HOLD_S, TRIP_S, US, byte_stop_s, fast, moving, us
from .stepping import at_full_rate

CALL_CYCLES = 140
"""Maximum cycles from the call of an idle step task for a stop until no more step events can begin: less than 2 us on
all boards."""

SERIAL_S = 100e-6
"""Maximum time from the last bit of a command that stops the machine until the serial task runs. The longest runs of
the tasks with higher priority can come first."""


def hold(bench):
    """`!` must brake along a ramp, `~` must continue, and no step may be lost."""
    bench.boot()
    fast(bench, 1000)
    board, hz = bench.board, bench.wiring.core_hz
    scope = Scope(board)
    moving(bench, way=20)
    speed, acceleration = 50_000, 1_000_000
    board.begins[board.serial].clear()
    heard = bench.host.send(b"!")
    board.run(until=lambda: board.now > heard, limit=0.001)
    board.run(seconds=0.001)
    called = next((at - heard for at in board.begins[board.serial] if at >= heard), hz) / hz
    if called > SERIAL_S:
        raise Failure(f"the serial task is called {us(called)} after `!`")
    bench.wait_state("Hold:0", 2)
    steps = [step.at for step in scope.steps()]
    later = [at for at in steps if at > heard]
    intervals = [(b - a) / hz for a, b in pairwise(later)]
    # Single intervals have jitter. So this test looks for the first twenty intervals that are on average 1 % longer
    # than at full speed, and takes their start as the start of the ramp.
    begin = next((k for k in range(len(intervals) - 20) if sum(intervals[k : k + 20]) > 20.2 / speed), None)
    if begin is None:
        raise Failure("there is no ramp")
    took = (later[-1] - later[begin]) / hz
    distance = len(later) - begin
    latency = (later[begin] - heard) / hz
    ideal = speed**2 / 2 / acceleration
    yield f"the serial task is called {us(called)} after `!`"
    yield f"ramp begins {latency * 1e3:.2f} ms after `!`, takes {took * 1e3:.2f} ms and {distance} steps (v²/2a = {ideal:.0f})"
    if latency > HOLD_S or abs(distance / ideal - 1) > 0.03:
        raise Failure("the hold does not brake as it should")
    bench.at_rest(0.05)
    bench.host.send(b"~")
    bench.wait_state("Idle", 3)
    if scope.counts() != [20_000, 0, 0]:
        raise Failure(f"after the hold X is at {scope.counts()}")
    yield "`~` goes on to the programmed place"


def stops(bench):
    """0x18 and a limit switch must stop the pulses in time, at several times during a motion."""
    bench.boot()
    fast(bench, 1000)
    bench.settings(s21=1)
    board, hz = bench.board, bench.wiring.core_hz
    worst = {"0x18": 0.0, "limit": 0.0}
    allowed = {"0x18": byte_stop_s(bench), "limit": TRIP_S}
    for feed, phase in ((3000, 0.0), (3000, 7.3e-6), (3000, 31e-6), (60, 123.4e-6), (6000, 49.9e-6)):
        for what in ("0x18", "limit"):
            bench.ask("$X")
            scope = Scope(board)
            moving(bench, feed)
            board.run(seconds=phase)
            if what == "0x18":
                heard = bench.host.send(b"\x18")
            else:
                heard = board.now
                board.drive(bench.wiring.limits[0], 0)
            after = len(bench.host.text)
            board.run(seconds=0.01)
            if board.now <= heard:
                raise Failure("the stop was not heard in time")
            rising = [step.at for step in scope.steps()]
            if not rising:
                raise Failure("nothing moved before the stop")
            late = max(0.0, (rising[-1] - heard) / hz)
            worst[what] = max(worst[what], late)
            if what == "0x18":
                bench.wait_text("Grbl 1.1h", 0.5, after)
            else:
                bench.wait_text("ALARM:1", 0.5, after)
                board.drive(bench.wiring.limits[0], None)
                bench.host.send(b"\x18")
                bench.wait_text("Grbl 1.1h", 0.5, after)
            bench.at_rest(0.02)
            place = float(bench.status().split("MPos:")[1].split(",")[0])
            counted = sum(scope.counts())
            if abs(place * 1000 - counted - bench.__dict__.setdefault("origin", 0)) > 0.5:
                raise Failure(f"{what}: reported X{place}, {counted} pulses since X{bench.origin / 1000}")
            bench.origin = round(place * 1000)
            if late > allowed[what]:
                raise Failure(f"{what} at F{feed}: pulses for another {us(late)}, allowed {us(allowed[what])}")
    for what, late in worst.items():
        yield f"{what:>5}: pulses end at most {us(late)} after it is heard, allowed {us(allowed[what])}; places as reported"


class StopWatch:
    """Records two numbers for each stop: the cycles from the call of the step task until no event can begin, and the
    DMA count, which tells the slot of the event ring (the DMA buffer of step events) at that time. `halts` counts how
    often the output ended, by a stop or because the ring ran dry."""

    def __init__(self, board):
        self.board, self.called, self.stopped, self.halts, self.halted_at = board, None, [], 0, None
        pulses, tim5, edges = board.peripherals[board.wiring.pulse_timer], board.peripherals["TIM5"], board.dma[1]
        to_pulses, to_tim5, left = pulses.write, tim5.write, 0x10 + 0x18 * board.wiring.pulse_stream + NDTR

        def call(offset, value):
            if offset == EGR and value & 16:
                self.called = board.now
            elif offset == timer.CCR2:
                # A run of the step task has ended, so forget the call that started it. A later run can notice a stop
                # before it is called for that stop, and must not be timed from the old call.
                self.called = None
            to_tim5(offset, value)

        def stop(offset, value):
            if offset == SMCR and pulses.values[SMCR] & 7 and not value & 7:
                self.halts += 1
                self.halted_at = board.now
                if self.called:
                    self.stopped.append((board.now - self.called, edges.values[left]))
                self.called = None
            to_pulses(offset, value)

        pulses.write, tim5.write = stop, call


def ring_stops(bench):
    """Sends 0x18 at random times during motions at up to the safe rate, so that stops come at many slots of the ring:
    the reported position must equal the steps output."""
    bench.boot()
    board, hz, random = bench.board, bench.wiring.core_hz, Random(64)
    rate = at_full_rate(bench, 50_000)
    worst, place, watch, most = 0, 0, StopWatch(board), int(os.environ.get("OXMILL_RANDOM_STOPS", "48"))
    for k in range(most):
        bench.ask("$X")
        # Discard the edges of the previous stop, because a long run would need too much memory.
        board.edges.clear()
        scope, watch.halts = Scope(board), 0
        sign = "-" if k % 2 else ""
        bench.ask(f"G91 G1 X{sign}100 Y{sign}77 Z{sign}55 F{rate * 1.378:.0f}" if k % 4 < 2 else f"G91 G1 X{sign}100 F{rate}")
        # A motion begins after 2 ms, and is at speed after another 10 ms, with an event every 2.04 us at 490 kHz. Some
        # of the stops come during the acceleration or at its beginning.
        early = (1.5e-3, 2.6e-3) if k % 8 == 7 else (2.5e-3, 9e-3)
        board.run(seconds=random.uniform(*early) if k % 2 else 0.013 + random.uniform(0, 140 * US))
        after = len(bench.host.text)
        heard = bench.host.send(b"\x18")
        bench.wait_text("Grbl 1.1h", 0.5, after)
        bench.at_rest(0.005)
        rising = [step.at for step in scope.steps()]
        worst = max([worst] + [(at - heard) / hz for at in rising[-1:]])
        place += scope.counts()[0]
        told = round(float(bench.status().split("MPos:")[1].split(",")[0]) * 1000)
        if told != place:
            raise Failure(f"stop {k + 1}: X{told} is told after {place} steps")
        if watch.halts > 1:
            raise Failure(f"stop {k + 1}: before it the ring ran dry, and the motion was begun again")
    cycles = max(cycles for cycles, _ in watch.stopped)
    slowest = cycles / hz
    places = len({left for _, left in watch.stopped})
    yield (
        f"{most} stops, half of them at {bench.wiring.safe_step_hz} steps/s, at {places} of 128 places of the ring: counts exact; at most {us(slowest)} "
        f"from the call, pulses end at most {us(max(worst, 0))} after the byte"
    )
    # Number of different slots that random stops hit on average: 22 for 24 stops, 40 for 48.
    if places < min(30, most // 2):
        raise Failure("too few places: this proves little")
    if cycles > CALL_CYCLES:
        raise Failure(f"a stop takes {cycles} cycles from the call")
    if worst > byte_stop_s(bench):
        raise Failure("pulses after the stop")
    yield from stops_with_backlash(bench, random, rate, most // 2)


def zigzag_stops(bench):
    """Sends 0x18 at random times in a zigzag, when several changes of direction are queued: the reported position of
    each axis must equal the steps output in the direction of its pin."""
    bench.boot()
    board, random, places, changes = bench.board, Random(5), [0, 0, 0], 0
    at_full_rate(bench)
    bench.settings(s11=5)
    lines = "".join(f"X.0{3 + k % 3} Y{'-' * (k % 2)}.02{1 + k % 2} Z{'-' * (k % 3 == 0)}.02\n" for k in range(120))
    most = 12
    for k in range(most):
        bench.ask("$X")
        board.edges.clear()
        scope, after = Scope(board), len(bench.host.text)
        # The first move is slow, so that all lines have arrived before the fast moves begin.
        bench.host.stream(f"G91 G1 F60 X.3\nF6000 X2\n{lines}")
        bench.wait(lambda: bench.host.all_answered, 1, "the last answer")
        bench.wait(lambda: len(board.edges) > 2 * 2300, 1, "the zigzag")
        board.run(seconds=random.uniform(0.005, 0.045))
        bench.host.send(b"\x18")
        bench.wait_text("Grbl 1.1h", 0.5, after)
        bench.at_rest(0.005)
        _, _, setups, holds = scope.read()
        changes += len(setups)
        places = [place + moved for place, moved in zip(places, scope.counts(), strict=True)]
        told = [round(float(place) * 1000) for place in bench.status().split("MPos:")[1].split("|")[0].split(",")[:3]]
        if told != places:
            raise Failure(f"stop {k + 1}: {told} is told, and the motors are at {places}")
        if setups and (min(setups) < 10 * US or min(holds) < bench.wiring.least_pulse_us * US):
            raise Failure(f"stop {k + 1}: set-up {us(min(setups))}, hold {us(min(holds))}")
    yield f"{most} stops in a zigzag with {changes} changes of direction: counts of all axes exact"
    if changes < 20 * most:
        raise Failure("few changes of direction: this proves little")


def stops_with_backlash(bench, random, rate, most):
    """With backlash, the reported position must be that of the tool, which lags the motor by the backlash. The backlash
    was taken up long before the stop."""
    board, slack = bench.board, 20
    bench.ask("$X")
    bench.settings(s160=slack / 1000)
    for k in range(most):
        bench.ask("$X")
        bench.ask("G91 G1 X-1 F6000")
        bench.wait_state("Idle", 2)
        begun = round(float(bench.status().split("MPos:")[1].split(",")[0]) * 1000)
        board.edges.clear()
        scope = Scope(board)
        bench.ask(f"G1 X100 F{rate}")
        board.run(seconds=random.uniform(0.006, 0.013))
        after = len(bench.host.text)
        bench.host.send(b"\x18")
        bench.wait_text("Grbl 1.1h", 0.5, after)
        bench.at_rest(0.005)
        told = round(float(bench.status().split("MPos:")[1].split(",")[0]) * 1000)
        tool = begun + scope.counts()[0] - slack
        if told != tool:
            raise Failure(f"stop {k + 1} with backlash: X{told} is told, the tool is at {tool}")
    yield f"{most} stops with a backlash of {slack} steps: the tool is where it is told"


def lines_at_stops(bench):
    """Emergency stops while each line lasts only 0.2 ms: the reported line must be that of the last step, even if that
    line began after the last run of the step task."""
    bench.boot()
    board, random = bench.board, Random(21)
    fast(bench, 10_000)
    bench.settings(s11=0.1, s912=1)
    # Small turns prevent the lines from being joined.
    job = "".join(f"N{line}X.02Y{'-' * (line % 2)}.002\n" for line in range(1, 121))
    stops, wrong, runs = 14, [], []
    for _ in range(stops):
        bench.ask("$X")
        board.edges.clear()
        scope = Scope(board)
        bench.host.stream(f"G91G1F400X1\nF6000\n{job}")
        bench.wait(lambda: len(board.edges) > 2 * 2200, 1, "lines at speed")
        board.run(seconds=random.uniform(0, 10e-3))
        after = len(bench.host.text)
        board.drive(bench.wiring.reset, 0)
        bench.wait_text("Reset to continue", 0.5, after)
        told = int(bytes(bench.host.text[after:]).decode().split("line ")[1].split("]")[0])
        steps = scope.counts()[0] - 1000
        last = scope.steps()[-1].at
        runs.append(last - max(entry for entry, _ in board.step_runs if entry < last))
        # A line begins with the last step of the previous line, so after this step both line numbers are right.
        if told not in (steps // 20 + 1, max(steps - 1, 0) // 20 + 1):
            wrong.append((told, steps / 20))
        board.drive(bench.wiring.reset, None)
        board.run(seconds=0.001)
        after = len(bench.host.text)
        bench.host.send(b"\x18")
        bench.wait_text("to unlock", 0.5, after)
    yield f"{stops} emergency stops, up to {us(max(runs) / bench.wiring.core_hz)} after a run of the step task: {stops - len(wrong)} told with their line"
    if wrong:
        raise Failure(f"the line that is told is not the last: {wrong}")
