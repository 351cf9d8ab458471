"""What must hold on the virtual boards. Each case gets a board that was just switched on, prints what it measured, and
fails with a `Failure`."""

import csv
import json
import math
import os
import subprocess
import tempfile
from itertools import pairwise
from pathlib import Path
from random import Random

from .board import Board, Failure
from .host import Host
from .models import timer
from .models.dma import M0AR, NDTR
from .models.otg import EPENA, NAKSTS, OUT
from .models.timer import EGR, SMCR
from .parts import MHZ
from .scope import Scope, steady
from .usb import UsbHost

US = 1e-6
JITTER_S = 0.1 * US
"""How far a period may be off: edges wait for other transfers of DMA, and for nothing that the program does."""
SAMPLE_S, FILTER_SAMPLES = 50 * US, 8
STOP_S = 20 * US
"""From the moment a stop is known to the last rising edge."""
RUN_CYCLES = 4450
"""How long a byte may wait for a run of the step task, besides (`run_cycles` in profiles.rs)."""
HOLD_S = 25e-3
"""From `!` to the beginning of the ramp."""
TRIP_S = FILTER_SAMPLES * SAMPLE_S + SAMPLE_S + STOP_S
"""From a contact to the last rising edge: the filter, up to a sample before it begins, and the stop."""
ANSWER_S = 20e-3
"""From a `?` behind a burst of overrides, with which a full queue is planned, to the first byte of its report."""
STACK_LEFT = 4096
"""Bytes of the stack that no case may have used."""
CALL_CYCLES = 140
"""From the call of the step task to where no event begins any more, when it is not running: less than 2 us on all boards."""
BEHIND_CYCLES = 400
"""From there to where the beam is off: a change of power that is about to come is awaited."""
LINES_S = {"blackpill_f411": 4200, "blackpill_f401": 2800}
"""Short lines a second that a board takes over USB while it moves."""
UART_LINES_S = {"blackpill_f411": 3000, "blackpill_f401": 2000, "nucleo_f446re": 5500, "nucleo_f411re": 3700, "nucleo_f401re": 2500}
"""The same over the UART at its greatest rate."""
LATEST_PULSE_END_S = 0.15 * US
"""How much longer than $0 a pulse may be: its end is a transfer of DMA, which may wait for others."""


class Bench:
    """A board with a host, and what the cases share."""

    def __init__(self, wiring, image, oxmill):
        self.wiring, self.image, self.oxmill = wiring, image, oxmill
        self.masked = {}
        self.board, self.deepest = None, (0, 0, "")
        self.case = ""
        self.fresh()

    def fresh(self):
        """Another board, not yet running."""
        self.note_stack()
        self.board = Board(self.wiring, self.image)
        self.host = Host(self.board)
        return self.board

    def note_stack(self):
        """Keeps the deepest stack; a board that was made to fail says nothing of it."""
        if self.board is not None and not self.board.faults_expected:
            used, size = self.board.stack_used()
            self.deepest = max(self.deepest, (used, size, self.case))

    def boot(self):
        self.fresh()
        self.wait_text("Grbl 1.1h", 1.0)
        self.wait_text("\r\n", 0.1, after=len(self.host.text))
        self.forget_masks()

    def boot_with_usb(self):
        """Another board, with a host that has opened its USB port. The host at the UART is `uart`."""
        self.fresh()
        self.uart, self.host = self.host, UsbHost(self.board)
        self.wait(lambda: self.host.is_set_up, 1.0, "the set-up of the USB device")
        self.board.run(seconds=0.02)
        self.host.order("open")
        self.wait_text("Grbl 1.1h ['$' for help]\r\n", 0.1)
        self.forget_masks()

    # Time and text.

    def wait(self, condition, limit, what):
        if not self.board.run(until=condition, limit=limit):
            raise Failure(f"{what} did not come within {limit} s; the board has said {bytes(self.host.text[-300:])!r}")

    def wait_text(self, text, limit, after=0):
        self.wait(lambda: self.host.has_said(text, after), limit, repr(text))

    def ask(self, line, limit=1.0):
        """Sends a line and waits for its answer; the lines up to it."""
        begin, answers = len(self.host.lines), len(self.host.answers)
        self.host.send(line + "\n")
        self.wait(lambda: len(self.host.answers) > answers, limit, f"an answer to {line}")
        if self.host.answers[-1] != "ok":
            raise Failure(f"{line} was answered by {self.host.answers[-1]}")
        return [text for _, text in self.host.lines[begin:]]

    def settings(self, **values):
        for name, value in values.items():
            self.ask(f"${name[1:]}={value}")
        # Whatever the store does ahead of need, it does now.
        self.board.run(seconds=0.01)

    def status(self):
        after = len(self.host.lines)
        self.host.send(b"?")
        self.wait(lambda: any(line.startswith("<") for _, line in self.host.lines[after:]), 0.2, "a status report")
        return next(line for _, line in self.host.lines[after:] if line.startswith("<"))

    def wait_state(self, state, limit):
        """Polls like a sender; the report that had the state."""
        for _ in range(round(limit / 0.02)):
            status = self.status()
            if status.startswith(f"<{state}"):
                return status
            self.board.run(seconds=0.02)
        raise Failure(f"the state is {status} and not {state} after {limit} s")

    def at_rest(self, seconds):
        """Runs for a time in which nothing may step."""
        scope = Scope(self.board)
        self.board.run(seconds=seconds)
        if scope.steps():
            raise Failure("a step came at rest")

    # Masks.

    def forget_masks(self):
        self.board.state.masked_longest = 0

    def longest_mask(self):
        """Longest time with interrupts masked since the last question, in s, and where it ended."""
        state = self.board.state
        cycles, where = state.masked_longest, self.image.place(state.slowest_to)
        state.masked_longest = 0
        return cycles / self.board.clocks[-1][2], where


def us(seconds):
    return f"{seconds / US:.2f} us"


def boot(bench):
    """The welcome line, and outputs that never leave their safe levels on the way there."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    cycle, line = next(entry for entry in bench.host.lines if entry[1])
    if not line.startswith("Grbl 1.1h ['$' for help]"):
        raise Failure(f"the first line is {line!r}")
    if board.clocks[-1][2] != wiring.core_hz:
        raise Failure(f"the core runs at {board.clocks[-1][2]} Hz and not at {wiring.core_hz}")
    coolant = (wiring.flood, wiring.mist)
    safe = {name: 0 for name in (*wiring.step, wiring.spindle, wiring.spindle_direction, *coolant, *wiring.program_outputs)}
    safe[wiring.enable] = 1
    for at, port, pin, level in board.edges:
        wanted = safe.get(f"{port}{pin}")
        if wanted is not None and level in (0, 1) and level != wanted:
            raise Failure(f"P{port}{pin} was {level} at {board.seconds(at):.6f} s")
    first = min(board.seconds(at) for at, port, pin, level in board.edges if f"{port}{pin}" in safe and level in (0, 1))
    used, size = board.stack_used()
    if duty(board):
        raise Failure("the spindle's PWM is on")
    yield f"clock {wiring.core_hz / 1e6:.0f} MHz; outputs driven from {first * 1e3:.2f} ms after reset, safe from then on"
    yield f"welcome line complete {board.seconds(cycle) * 1e3:.1f} ms after reset, {board.usart.baud():.0f} baud"
    yield f"stack at the start: {used} of {size} bytes"
    if used > size - 1024:
        raise Failure("less than 1 KiB of the stack is left")


def duty(board):
    """Share of the time that the spindle's PWM is high; 0 where its pin is not driven by the timer."""
    if board.shown(board.wiring.pwm) != "AF":
        return 0
    return board.peripherals["TIM3"].duty(2)


JOB_SETTINGS = {"s110": 3000, "s111": 3000, "s112": 3000, "s120": 1000, "s121": 1000, "s122": 1000}


def in_simulator(bench, job, settings, *options):
    """Runs a job in the simulator, as this board; what it says."""
    command = [bench.oxmill, "run", str(job), "--board", bench.wiring.name, *options]
    for name, value in settings.items():
        command += ["--set", f"{name[1:]}={value}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Failure(f"the simulator failed: {done.stderr}")
    return done.stdout


def simulated(bench, job, settings=JOB_SETTINGS):
    """(axes, negative) of each step event of the job in the simulator."""
    with tempfile.TemporaryDirectory() as folder:
        trace = Path(folder) / "trace.csv"
        in_simulator(bench, job, settings, "--trace", str(trace))
        rows, before = [], (0, 0, 0)
        with open(trace, newline="") as file:
            for row in csv.DictReader(file):
                place = tuple(int(row[axis]) for axis in "xyz")
                change = [b - a for a, b in zip(before, place, strict=True)]
                before = place
                if any(change):
                    axes = sum(1 << k for k, c in enumerate(change) if c)
                    rows.append((axes, sum(1 << k for k, c in enumerate(change) if c < 0)))
    return rows, before


def streamed(bench, job):
    """A job by character counting: the steps of the simulator, in its order."""
    bench.boot()
    bench.settings(**JOB_SETTINGS)
    scope, host, board = Scope(bench.board), bench.host, bench.board
    board.refill_stack()
    bench.forget_masks()
    lines = len(host.answers)
    text = Path(job).read_text()
    begin = board.now
    host.stream(text)
    bench.wait(lambda: host.all_answered, 60, "the last answer")
    bench.wait_state("Idle", 60)
    errors = [answer for answer in host.answers[lines:] if answer != "ok"]
    if "splines" in bench.wiring.left_out and "error:141" in errors:
        raise LeftOut("this board has no room for splines")
    if errors:
        raise Failure(f"answers: {errors}")
    if board.usart.overruns or host.has_said("lost"):
        raise Failure("received bytes were lost")
    steps = [(step.axes, step.negative) for step in scope.steps()]
    expected, end = simulated(bench, job)
    if scope.counts() != list(end):
        raise Failure(f"the motors are at {scope.counts()} and not at {end}")
    first = next((k for k, (a, b) in enumerate(zip(steps, expected, strict=False)) if a != b), None)
    if first is not None or len(steps) != len(expected):
        raise Failure(f"step {first} of {len(steps)} differs from the simulator's {len(expected)} steps")
    mask, where = bench.longest_mask()
    used, size = board.stack_used()
    yield f"{Path(job).name}: {len(steps)} step events as in the simulator, ends at {end}, {(board.now - begin) / bench.wiring.core_hz:.2f} s"
    yield f"longest time masked {us(mask)} ({where}); stack {used} of {size} bytes"




def fast(bench, acceleration, pulse_us=2):
    """1000 steps/mm, and axes as fast as the board's safe rate and the pulse allow. A greater rate would be refused."""
    rate = int(bench.wiring.greatest_hz(pulse_us)) * 60 // 1000
    bench.settings(s0=pulse_us, s110=rate, s111=rate, s112=rate)
    bench.settings(s100=1000, s101=1000, s102=1000, s120=acceleration, s121=acceleration, s122=acceleration)


def hard(bench, acceleration):
    """An acceleration that brings a board of a greater rate than 490 kHz to it in the same time, mm/s²."""
    return round(acceleration * max(1, bench.wiring.safe_step_hz / 490_000))


def pulses(bench):
    """Width, direction set-up and period at 1, 10, 50 and 100 kHz (or the safe rate), all three axes together; and with the
    longest pulse, which is longer than the time between ticks of which not each makes a step."""
    yield from at_rates(bench, (1_000, 60, 10), (10_000, 400, 10), (50_000, 2500, 10), (100_000, 5000, 2), (3_000, 180, 255))


def safe_rate(bench):
    """The same with the shortest pulse at the rate that the board calls safe, together and with three rates, of which none divides
    another."""
    safe, pulse_us = bench.wiring.safe_step_hz, bench.wiring.least_pulse_us
    acceleration = hard(bench, 6_000)
    steps = round((1.1 * safe**2 / acceleration / 1000 + 2000) / 9) * 9
    for ways in ((1, 1, 1), (9, 7, 5)):
        yield from at_rates(bench, (safe, steps, pulse_us), acceleration=acceleration, ways=ways)


def disturbed(bench):
    """At the safe rate, interrupts masked for 20 us at random moments, and a USB host that floods: no period is off."""
    if bench.wiring.usb:
        with_usb(bench)
    else:
        bench.boot()
    random, masks = Random(20), 0

    def disturb():
        nonlocal masks
        bench.board.run(seconds=random.uniform(60, 400) * US)
        bench.board.mask(20 * US)
        masks += 1

    lines = yield from flooded_at_safe_rate(bench, disturb)
    yield f"masked {masks} times for 20 us, {lines} lines meanwhile{' over USB' if bench.wiring.usb else ''}"


def fast_flood(bench):
    """At the safe rate, a host that floods the UART at its greatest rate: no period is off, and no byte is lost."""
    bench.boot()
    bench.ask(f"$931={FAST_BAUD}")
    restart_at(bench, FAST_BAUD)
    lines = yield from flooded_at_safe_rate(bench, lambda: bench.board.run(seconds=200 * US))
    yield f"{lines} lines meanwhile at {bench.board.usart.baud():.0f} baud, {bench.host.bytes_sent} bytes"
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")


def flooded_at_safe_rate(bench, meanwhile):
    """The safe rate under a flood of lines and status requests; how many lines there were."""
    safe, pulse_us = bench.wiring.safe_step_hz, bench.wiring.least_pulse_us
    acceleration = hard(bench, 6_000)
    asked = len(bench.host.answers)

    def flood():
        nonlocal asked
        meanwhile()
        if len(bench.host.answers) >= asked - 5:
            asked += 20
            bench.host.send("(a)\n" * 20 + "?" * 5)

    steps = round((1.1 * safe**2 / acceleration / 1000 + 9000 * safe / 490_000) / 9) * 9
    yield from at_rates(bench, (safe, steps, pulse_us), acceleration=acceleration, ways=(9, 7, 5), meanwhile=flood, boots=False)
    return asked


def tight(bench):
    """Longer pulses at the greatest rate that the settings allow with them."""
    for pulse_us in (0.6, 0.9, 1.1, 2, 2.5, 3, 4, 5, 6, 7, 9, 10):
        if pulse_us < bench.wiring.least_pulse_us:
            continue
        rate = round(bench.wiring.greatest_hz(pulse_us))
        acceleration = max(3_000, round(rate / 100 * 3))
        yield from at_rates(bench, (rate, round(1.1 * rate**2 / acceleration / 1000) + 1000, pulse_us), acceleration=acceleration)


def at_rates(bench, *rates, acceleration=3_000, ways=(1, 1, 1), meanwhile=None, boots=True):
    """Back and forth at each (steps/s, steps one way, $0), the axes with these shares of the first one's steps."""
    if boots:
        bench.boot()
    board, hz = bench.board, bench.wiring.core_hz
    safe = bench.wiring.safe_step_hz
    fast(bench, acceleration)
    for wanted, steps, pulse_us in rates:
        rate = min(wanted, safe)
        greatest = round(min(rate * 1.001, safe) * 60 / 1000, 3)
        bench.settings(s0=2, s110=greatest, s111=greatest, s112=greatest)
        bench.settings(s0=pulse_us, s29=10)
        bench.forget_masks()
        scope = Scope(board)
        x, y, z = (steps * share / ways[0] / 1000 for share in ways)
        feed = rate / 1000 * 60 * sum((share / ways[0]) ** 2 for share in ways) ** 0.5
        for sign in ("", "-"):
            bench.ask(f"G91 G1 X{sign}{x:.3f} Y{sign}{y:.3f} Z{sign}{z:.3f} F{feed:.4f}")
        if meanwhile:
            end = board.seconds() + 2 * (steps / rate + rate / 1000 / acceleration)
            while board.seconds() < end:
                meanwhile()
            board.run(seconds=0.1)
        bench.wait_state("Idle", 5)
        events, widths, setups, holds = scope.read()
        # Those of the fastest axis: at low rates the others step between its steps, too.
        events = [event for event in events if event.axes & 1]
        if scope.counts() != [0, 0, 0] or len(events) != 2 * steps:
            raise Failure(f"{rate} steps/s: {len(events)} steps, ends at {scope.counts()}")
        least, most = min(widths), max(widths)
        ramp = round(1.05 * rate**2 / 2 / (1000 * acceleration)) + 5
        found = steady(events[:steps], hz, 1 / rate, ramp)
        mask, where = bench.longest_mask()
        line = f"{rate:>7} steps/s: $0={pulse_us} width {us(least)} to {us(most)}; $29=10 set-up from {us(min(setups))}, hold from {us(min(holds))}"
        if found is None:
            raise Failure(f"{line}: the rate is never reached")
        busy, longest = step_load(board, events[ramp].at, events[steps - ramp].at)
        yield f"{line}; period error {us(found['period_error'])}, drift over {found['steps']} steps {us(found['drift'])}, masked {us(mask)} ({where}); step task {busy:.0%}, longest run {longest} cycles"
        # A pulse below 1 us is followed by a pause as short.
        latest = LATEST_PULSE_END_S if pulse_us >= 1 else JITTER_S
        if least < pulse_us * US or most > pulse_us * US + latest:
            raise Failure(f"pulse width {us(least)} to {us(most)} with $0={pulse_us}")
        if min(setups) < 10 * US:
            raise Failure(f"direction set-up {us(min(setups))} with $29=10")
        if min(holds) < pulse_us * US:
            raise Failure(f"a direction changes {us(min(holds))} after the edge of a step, within its pulse")
        if found["drift"] > 2 * US:
            raise Failure(f"the period drifts by {us(found['drift'])} over {found['steps']} steps")
        if found["period_error"] > JITTER_S:
            raise Failure(f"a period is off by {us(found['period_error'])}, whatever is masked it may be {us(JITTER_S)}")
        bench.ask("G90")


def step_load(board, begin, end):
    """Share of the processor that the step task takes between two cycles, and its longest run there."""
    runs = [(entry, left) for entry, left in board.step_runs if begin <= entry < end]
    return sum(left - entry for entry, left in runs) / (end - begin), max(left - entry for entry, left in runs)


def moving(bench, feed=3000, way=100):
    """Begins a long move of X and waits until it is at speed."""
    bench.ask(f"G91 G1 X{way} F{feed}")
    bench.board.run(seconds=feed / 60 / 1000 + 0.05)


def hard_start(bench):
    """From rest with 10 m/s², several times: the step task must not outrun what is prepared for it."""
    bench.boot()
    fast(bench, 10_000)
    rate = min(6006, int(bench.wiring.greatest_hz(5)) * 60 // 1000)
    bench.settings(s0=2, s110=rate, s111=rate, s112=rate)
    bench.settings(s0=5)
    for attempt in range(8):
        bench.board.run(seconds=attempt * 7e-6)
        way = f"{'-' if attempt % 2 else ''}4"
        # A sender asks for the state as soon as it has the answer, in the midst of the first segments.
        bench.ask(f"G91 G1 X{way} Y{way} Z{way} F{rate * 3**0.5:.4f}")
        bench.status()
        bench.board.run(seconds=0.005)
        if not bench.host.has_said("ALARM"):
            bench.host.send(b"!")
            bench.board.run(seconds=0.04)
            bench.host.send(b"\x18")
            bench.board.run(seconds=0.02)
            bench.ask("$X")
        else:
            raise Failure(f"start {attempt + 1} of 8: {next(text for _, text in bench.host.lines if 'ALARM' in text)}")
    yield "8 starts with 10 m/s², none ran dry"


def laser_start(bench):
    """From rest so hard that many segments begin, each with a power of its own (M4), before the first step."""
    bench.boot()
    fast(bench, 10_000)
    bench.settings(s100=1280, s110=9000, s30=1000, s31=0, s32=1)
    bench.settings(s120=15_000)
    scope = Scope(bench.board)
    bench.ask("G91 M4 S800 F9000")
    for _ in range(6):
        bench.ask("G1 X2")
        bench.wait_state("Idle", 1)
    yield f"6 starts with 15 m/s² and 1280 steps/mm: {scope.counts()[0]} steps"
    if scope.counts() != [6 * 2560, 0, 0] or bench.host.has_said("ALARM"):
        raise Failure(f"the motor is at {scope.counts()}: {bytes(bench.host.text[-200:])}")


BEAM_S = 0.2 * US
"""Between the edge of the step that begins a segment and the change of its power."""


class BeamWatch:
    """The changes of the PWM's compare register, whoever writes it."""

    def __init__(self, board):
        self.board, self.pwm = board, board.peripherals["TIM3"]
        self.changes = []
        """(cycle, share of the period)."""
        self.last = self.pwm.values[timer.CCR2]
        by_program, by_dma = self.pwm.write, self.pwm.store_by_dma

        def write(offset, value):
            by_program(offset, value)
            self.note(board.now)

        def store(offset, value, at):
            by_dma(offset, value, at)
            self.note(at)

        self.pwm.write, self.pwm.store_by_dma = write, store

    def note(self, at):
        value = self.pwm.values[timer.CCR2]
        if value != self.last:
            self.last = value
            self.changes.append((at, value / (self.pwm.values[timer.ARR] + 1)))


def raster(bench):
    """A laser draws rows of 20 pixels/mm at 12 m/min, each pixel of another power: it changes with the edge of the step that begins
    the pixel, also while interrupts are masked at random moments. And it is off after a stop, wherever that comes."""
    bench.boot()
    fast(bench, 10_000)
    bench.settings(s100=80, s110=12_000, s30=1000, s31=0, s32=1)
    yield from raster_rows(bench, "M3", 1, 0.0)
    yield from raster_rows(bench, "M4", 1, 20 * US)
    yield from raster_starts(bench)
    yield from raster_stops(bench)


def raster_rows(bench, mode, rows, masked_s):
    """Rows, each with a way without power at both ends that is long enough for the speed, and for the pixels to come."""
    board, hz, random = bench.board, bench.wiring.core_hz, Random(12)
    scope, beam, pixels, masks = Scope(board), BeamWatch(board), 70, 0
    begins = []
    """The step with which each pixel begins, and its share."""
    for row in range(rows):
        shares = [0]
        while len(shares) <= pixels:
            share = random.choice((0, 1000, random.randrange(50, 950)))
            if share != shares[-1] and (share or 1 < len(shares) < pixels):
                shares.append(share)
        # With the step that brings the tool to its edge.
        first = row * (80 * (14 + 4) + 4 * pixels) + 80 * 14 - 1
        begins += [(first + 4 * k, share / 1000) for k, share in enumerate([*shares[1:], 0])]
        text = "".join(f"X.05S{share}\n" for share in shares[1:])
        bench.host.stream(f"G91G1F12000{mode}\nX14S0\n{text}X4S0\n")
        if masked_s:
            bench.wait(lambda row=row: len(beam.changes) > row * (pixels + 1), 0.2, "the first pixel")
        while masked_s and len(beam.changes) < len(begins):
            board.run(seconds=random.uniform(60, 400) * US)
            board.mask(masked_s)
            masks += 1
        bench.wait(lambda: bench.host.all_answered, 5, "the last answer")
        bench.wait_state("Idle", 5)
    steps = scope.steps()
    if len(beam.changes) != len(begins):
        raise Failure(f"{mode}: power changes {len(beam.changes)} times and not {len(begins)}")
    late = []
    for (step, share), (at, shown) in zip(begins, beam.changes, strict=True):
        if abs(share - shown) > 0.01:
            raise Failure(f"{mode}: power is {shown:.4f} and not {share} at step {step}")
        late.append((at - steps[step].at) / hz)
    pixel = (steps[begins[2][0]].at - steps[begins[1][0]].at) / hz
    exact = sum(abs(by) <= BEAM_S for by in late)
    yield (
        f"{mode}, pixels of {us(pixel)}, masked {masks} times for {us(masked_s)}: {exact} of {len(late)} changes of power at their step, "
        f"{us(min(late))} to {us(max(late))} from its edge"
    )
    if exact < len(late) * (0.97 if masked_s else 1) or min(late) < -BEAM_S or max(late) > pixel / 4:
        raise Failure("power does not change with its step")


def raster_starts(bench):
    """Interrupts are masked where a motion begins, up to and beyond its first step: it is put off, and each step has the power that it
    has else."""
    bench.settings(s110=6_000)
    bench.settings(s100=1280)
    board, hz = bench.board, bench.wiring.core_hz
    clock, beam = board.peripherals["TIM2"], BeamWatch(board)

    def away():
        return (clock.values[timer.CCR2] - clock.count() & 0xFFFF_FFFF) * clock.cycles / hz

    def start(until_s=None):
        """When the first step comes after the first segment is to begin, when the first power after that, and the power right behind
        each step."""
        board.run(seconds=0.002)
        scope, known = Scope(board), len(beam.changes)
        bench.host.send("G91G1X.1F6000M4S1000\n")
        # The step task has itself called 450 us before the first event.
        bench.wait(lambda: 1.3e-3 < away() < 1.6e-3, 0.1, "the first segment")
        first = board.now + (away() + 450 * US) * hz
        if until_s is not None:
            board.run(seconds=(first - board.now) / hz - 460 * US)
            board.mask(460 * US + until_s)
        board.run(seconds=0.004)
        bench.wait_state("Idle", 0.5)
        steps = [step.at for step in scope.steps()]
        changes = [*beam.changes[known:], (1 << 62, 0.0)]
        powers, shown = [], 0.0
        for at in steps:
            while changes[0][0] < at + BEAM_S * hz:
                shown = changes.pop(0)[1]
            powers.append(shown)
        return (steps[0] - first) / hz, (beam.changes[known][0] - steps[0]) / hz, powers

    planned, lights, usual = start()
    delays = []
    for until in (-200, -40, 2, 30):
        came, _, powers = start(planned + until * US)
        delays.append(came - planned)
        if powers != usual:
            step = next(k for k, (a, b) in enumerate(zip(powers, usual, strict=True)) if a != b)
            raise Failure(f"masked until {until} us from the first step: power is {powers[step]} at step {step + 1}, else {usual[step]}")
    for until in (-4, 4):
        stand_once(board, until * US)
        came, early, powers = start()
        delays.append(came - planned)
        if powers != usual or early < lights - BEAM_S:
            raise Failure(f"stood until {until} us from the first event: power comes {us(-early)} before the first step, else {us(-lights)}")
    yield f"{len(delays)} starts with interrupts masked, put off by {us(min(delays))} to {us(max(delays))}: each of {len(usual)} steps with its power"
    if max(delays) < US or len(set(usual)) < 5:
        raise Failure("no start was put off, or power was always the same: this proves nothing")


def raster_stops(bench):
    """0x18 so that the beam goes off right before, at and behind the moment of a change, and emergency stops."""
    bench.settings(s100=80, s30=10, s912=1)
    board, hz, random = bench.board, bench.wiring.core_hz, Random(18)
    clock, beam, worst, near, takes = board.peripherals["TIM2"], BeamWatch(board), {}, [], None
    watch, behind = StopWatch(board), 0
    # The host's line is free again before the first of these pixels.
    row = "G91G1F6000M3S0\nX.6\n" + "".join(f"X.05S{2 + 6 * (k % 2)}\n" for k in range(10)) + "X9S7\n"
    for k in range(15):
        what = "emergency stop" if k % 5 == 4 else "0x18"
        bench.ask("$X")
        bench.host.send(row)
        goal = len(beam.changes) + 2 + k % 4

        def away():
            return (clock.values[timer.CCR3] - clock.count() & 0xFFFF_FFFF) * clock.cycles

        def is_due(goal=goal):
            return beam.last and len(beam.changes) >= goal and 150 * US < away() / hz < 450 * US and bench.host.free_at < board.now

        bench.wait(is_due, 0.1, "a change of power that is due")
        moment = board.now + away()
        if what == "0x18":
            # The last bit of a byte is read 9.5 bits after it begins. From there it takes as long as it took at least so far: the
            # first three tell.
            lead = 40 * US * hz if k < 3 else takes + 240 - 30 * k
            heard = bench.host.send(b"\x18", at=moment - 9.5 / 115_200 * hz - lead)
        else:
            board.run(seconds=random.uniform(0, 400) * US)
            heard = board.now
            board.drive(bench.wiring.reset, 0)
        board.run(seconds=0.002)
        after = [(at, share) for at, share in beam.changes if at > heard]
        off = next((at for at, share in after if share == 0), None)
        if off is None or after[-1][0] > off:
            raise Failure(f"{what} {k + 1}: after it power is {after}")
        if what == "0x18":
            takes = min(takes or off - heard, off - heard)
        near.append(off - moment)
        behind = max(behind, off - watch.halted_at)
        worst[what] = max(worst.get(what, 0), (off - heard) / hz)
        if what != "0x18":
            board.drive(bench.wiring.reset, None)
            board.run(seconds=0.001)
            bench.host.send("\x18")
        board.run(seconds=0.001)
    yield (
        f"off at most {us(worst['0x18'])} after 0x18, {us(worst['emergency stop'])} after the contact of an emergency stop, and nothing behind it; "
        f"at most {us(behind / hz)} after the last edge that was let out"
    )
    if not any(-250 < cycles < 0 for cycles in near) or not any(0 < cycles < 250 for cycles in near):
        raise Failure("no stop came right before a change, or right behind one: this proves nothing")
    if worst["0x18"] > STOP_S + RUN_CYCLES / hz or worst["emergency stop"] > TRIP_S + RUN_CYCLES / hz:
        raise Failure("the beam is off too late")
    if behind > BEHIND_CYCLES:
        raise Failure("the beam burns where the tool is about to stand while undone events are counted")


def turns(bench):
    """Directions change in full motion: a zigzag whose corners are passed at speed; with long set-up times that put ticks
    off. Those behind come later by as much: none comes closer to the one before it than was planned."""
    for pulse_us, setup_us in ((2, 10), (1, 60), (1, 200), (4, 60)):
        bench.boot()
        fast(bench, 10_000, pulse_us)
        bench.settings(s29=setup_us, s11=5)
        scope = Scope(bench.board)
        zigzag = "\n".join(f"X0.2 Y{'-' if k % 2 else ''}0.05 Z{'-' if k % 2 else ''}0.05" for k in range(40))
        bench.host.stream("G91 G1 F4600\n" + zigzag)
        bench.wait(lambda: bench.host.all_answered, 5, "the last answer")
        bench.wait_state("Idle", 5)
        events, widths, setups, holds = scope.read()
        hz = bench.wiring.core_hz
        fastest = min((b.at - a.at) / hz for a, b in pairwise(events))
        yield f"$0={pulse_us}: {len(setups)} changes of direction, set-up from {us(min(setups))} with $29={setup_us}, hold from {us(min(holds))}; pulses from {us(min(widths))}, shortest period {us(fastest)}"
        if scope.counts() != [8000, 0, 0] or len(setups) < 39:
            raise Failure(f"the motors are at {scope.counts()} after {len(setups)} changes of direction")
        if min(setups) < setup_us * US or min(holds) < pulse_us * US:
            raise Failure("a direction output changes too late, or within a pulse")
        if min(widths) < pulse_us * US or fastest < (pulse_us + min(pulse_us, 1.9)) * US:
            raise Failure("a pulse or the pause after it is too short")
        if fastest > 20 * US:
            raise Failure("the corners were not passed at speed: this proves nothing")
        # X has 0.2 mm of the path's 0.2 mm * sqrt(1 + 2/16), and a step is 0.001 mm.
        planned = 60 / 4600 / 1000 * (1 + 2 / 16) ** 0.5
        if fastest < planned - JITTER_S:
            raise Failure(f"a step comes {us(fastest)} after the one before, {us(planned)} are planned")


def called_at_turns(bench):
    """Calls of other tasks right before ticks, in a zigzag that turns at every corner: no direction changes within a pulse."""
    for pulse_us, lead_us in ((10, 1.0), (10, 2.5), (10, 3.75), (2, 1.0), (2, 2.5)):
        bench.boot()
        fast(bench, 10_000)
        feed = 3000
        bench.settings(s110=1.2 * feed, s111=1.2 * feed, s112=1.2 * feed)
        bench.settings(s0=pulse_us, s29=0, s11=50)
        board, scope, mhz = bench.board, Scope(bench.board), bench.wiring.core_hz // MHZ
        lines = [f"X{0.007 + 0.001 * (k % 3):.3f} Y{'-' if k % 2 else ''}{0.007 + 0.001 * (k % 3):.3f}" for k in range(150)]
        bench.host.stream(f"G91 G1 F{feed}\n" + "\n".join(lines))
        board.run(seconds=0.02)
        clock = board.peripherals["TIM2"]
        calls, patience = 0, 0
        while calls < 250 and patience < 4000:
            ahead = clock.until_tick()
            if ahead is None or ahead < lead_us * mhz:
                board.run(cycles=5 * mhz)
                patience += 1
                continue
            board.run(cycles=int(ahead - lead_us * mhz))
            clock.write(EGR, 1 << 4)
            calls += 1
            board.run(cycles=int((lead_us + 2) * mhz))
        bench.wait(lambda: bench.host.all_answered, 5, "the last answer")
        bench.wait_state("Idle", 5)
        _, widths, setups, holds = scope.read()
        line = f"$0={pulse_us}, {calls} calls {lead_us} us before a tick, {len(holds)} turns: hold from {us(min(holds))}, set-up from {us(min(setups))}"
        if min(holds) < pulse_us * US or min(setups) < 1.9 * US or len(holds) < 100:
            raise Failure(line)
        yield line


def hold(bench):
    """`!` brakes along a ramp, `~` goes on, and no step is lost."""
    bench.boot()
    fast(bench, 1000)
    board, hz = bench.board, bench.wiring.core_hz
    scope = Scope(board)
    moving(bench, way=20)
    speed, acceleration = 50_000, 1_000_000
    heard = bench.host.send(b"!")
    bench.wait_state("Hold:0", 2)
    steps = [step.at for step in scope.steps()]
    later = [at for at in steps if at > heard]
    intervals = [(b - a) / hz for a, b in pairwise(later)]
    # Single intervals carry the jitter of the interrupt: the ramp begins where twenty of them are longer by 1 % on average.
    begin = next((k for k in range(len(intervals) - 20) if sum(intervals[k : k + 20]) > 20.2 / speed), None)
    if begin is None:
        raise Failure("there is no ramp")
    took = (later[-1] - later[begin]) / hz
    distance = len(later) - begin
    latency = (later[begin] - heard) / hz
    ideal = speed**2 / 2 / acceleration
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
    """0x18 and a limit switch stop the pulses in time, at several moments of a motion."""
    bench.boot()
    fast(bench, 1000)
    bench.settings(s21=1)
    board, hz = bench.board, bench.wiring.core_hz
    worst = {"0x18": 0.0, "limit": 0.0}
    allowed = {"0x18": STOP_S, "limit": TRIP_S}
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


def at_full_rate(bench, acceleration=10_000):
    """X as fast as the board calls safe, with the shortest pulse: 490 mm/s or more, after 49 ms of 10,000 mm/s²."""
    safe = bench.wiring.safe_step_hz
    fast(bench, hard(bench, acceleration))
    rate = safe * 60 // 1000
    # The pulse first: with a longer one the rate would be refused.
    bench.settings(s0=bench.wiring.least_pulse_us)
    bench.settings(s110=rate)
    return rate


class StopWatch:
    """From the call of the step task to where no event begins any more, and the place of the ring at which that was. `halts`: how
    often that was, for a stop or because the ring ran dry."""

    def __init__(self, board):
        self.board, self.called, self.stopped, self.halts, self.halted_at = board, None, [], 0, None
        tim1, tim2, edges = board.peripherals["TIM1"], board.peripherals["TIM2"], board.dma[1]
        to_tim1, to_tim2 = tim1.write, tim2.write

        def call(offset, value):
            if offset == EGR and value & 16:
                self.called = board.now
            elif offset == timer.CCR2:
                # A run has ended: the call before it is not the one for a stop, which a later run may see before it is called.
                self.called = None
            to_tim2(offset, value)

        def stop(offset, value):
            if offset == SMCR and tim1.values[SMCR] & 7 and not value & 7:
                self.halts += 1
                self.halted_at = board.now
                if self.called:
                    self.stopped.append((board.now - self.called, edges.values[0x10 + 0x18 + NDTR]))
                self.called = None
            to_tim1(offset, value)

        tim1.write, tim2.write = stop, call


def ring_stops(bench):
    """0x18 at random moments up to the safe rate, at every place of the ring: what is reported has come out, to the step."""
    bench.boot()
    board, hz, random = bench.board, bench.wiring.core_hz, Random(64)
    rate = at_full_rate(bench, 50_000)
    worst, place, watch, most = 0, 0, StopWatch(board), int(os.environ.get("OXMILL_RANDOM_STOPS", "48"))
    for k in range(most):
        bench.ask("$X")
        # A long run would keep all edges there have ever been.
        board.edges.clear()
        scope, watch.halts = Scope(board), 0
        sign = "-" if k % 2 else ""
        bench.ask(f"G91 G1 X{sign}100 Y{sign}77 Z{sign}55 F{rate * 1.378:.0f}" if k % 4 < 2 else f"G91 G1 X{sign}100 F{rate}")
        # At speed after 2 ms of waiting and 10 of acceleration; an event each 2.04 us. Some on the way there, or while it begins.
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
    # Of 24 stops at random 22 places are to be expected, of 48 40.
    if places < min(30, most // 2):
        raise Failure("too few places: this proves little")
    if cycles > CALL_CYCLES:
        raise Failure(f"a stop takes {cycles} cycles from the call")
    if worst > STOP_S + RUN_CYCLES / hz:
        raise Failure("pulses after the stop")
    yield from stops_with_backlash(bench, random, rate, most // 2)


def stops_with_backlash(bench, random, rate, most):
    """The tool is told where it is: behind the motor by the slack, which has been taken up long before."""
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


def masked_long(bench):
    """Interrupts are masked for longer than events are ahead: slow moves go on later, with no step lost and none too soon; at
    rates at which motors would not follow the machine stops and says so."""
    bench.boot()
    board, hz = bench.board, bench.wiring.core_hz
    fast(bench, 10_000)
    for step_hz, masked_s in ((1_000, 1500 * US), (5_000, 750 * US)):
        bench.ask("G90 G1 X0 F3000")
        bench.wait_state("Idle", 5)
        scope = Scope(board)
        steps = step_hz // 5
        bench.ask(f"G1 X{steps / 1000} F{step_hz * 60 / 1000}")
        board.run(seconds=0.005)
        for k in range(12):
            board.run(seconds=(3700 + 137 * k) * US)
            board.mask(masked_s)
        bench.wait_state("Idle", 5)
        rising = [step.at for step in scope.steps()]
        between = [(b - a) / hz for a, b in pairwise(rising[10:-10])]
        yield f"masked 12 times for {us(masked_s)} at {step_hz} steps/s: {len(rising)} steps, {us(min(between))} to {us(max(between))} from one to the next"
        if scope.counts() != [steps, 0, 0]:
            raise Failure(f"the motors are at {scope.counts()}")
        if min(between) < 1 / step_hz - JITTER_S:
            raise Failure("a step comes too soon")
        if max(between) > 1 / step_hz + masked_s + 150 * US:
            raise Failure("a step comes later than the mask and a new beginning explain")
        if max(between) < 1 / step_hz + 100 * US:
            raise Failure("the ring never ran dry: this proves nothing")
    place = round(float(bench.status().split("MPos:")[1].split(",")[0]) * 1000)
    rate = at_full_rate(bench)
    scope = Scope(board)
    after = len(bench.host.text)
    bench.ask(f"G91 G1 X60 F{rate}")
    board.run(seconds=0.054)
    board.mask(200 * US)
    bench.wait_text("ALARM:100", 0.1, after)
    bench.at_rest(0.005)
    told = round(float(bench.status().split("MPos:")[1].split(",")[0]) * 1000)
    counted = place + scope.counts()[0]
    yield f"masked for 200 us at {bench.wiring.safe_step_hz} steps/s: ALARM:100 after {scope.counts()[0]} steps"
    if told != counted:
        raise Failure(f"X{told} is told after {counted} steps")


def late_segments(bench):
    """The control task hangs until the step task has nothing left but the events that are ahead. A segment that comes then is taken in
    at once, and not when the last of these are coming out: interrupts that are masked behind it put no step off."""

    def late(released_s=None):
        """The step that comes last, and the longest time between two, if the control task goes on so long before that."""
        bench.boot()
        board, hz = bench.board, bench.wiring.core_hz
        fast(bench, 10_000)
        moving(bench, 6_000)
        scope, after, begin = Scope(board), len(bench.host.text), board.now
        hang(bench)
        if released_s is None:
            board.run(seconds=0.05)
            return scope.steps()[-1].at - begin
        board.run(seconds=(last - released_s * hz) / hz)
        unpatch(bench)
        board.run(seconds=100 * US)
        board.mask(200 * US)
        board.run(seconds=0.02)
        rising = [step.at for step in scope.steps()]
        said = bytes(bench.host.text[after:])
        if b"ALARM" in said:
            raise Failure(f"released {us(released_s)} before the last step: {said!r}")
        return max(b - a for a, b in pairwise(rising)) / hz

    last = late()
    longest = {before: late(before * US) for before in (280, 265, 250)}
    yield f"a segment up to {min(longest)} us before the last step, and interrupts masked behind it: at most {us(max(longest.values()))} between two steps"
    if max(longest.values()) > 10 * US + JITTER_S:
        raise Failure(f"steps were put off: {longest}")


def stand_once(board, until):
    """The processor stands as the next motion is about to begin, until so long after the first event."""
    tim2, moments = board.peripherals["TIM2"], board.dma[0]
    write = moments.write

    def and_stand(offset, value):
        write(offset, value)
        if offset == 0x10 + 0x18 * 5 + M0AR:
            moments.write = write
            away = (board.word(value) - tim2.count() & 0xFFFF_FFFF) * tim2.cycles / board.clocks[-1][2]
            board.stall(away + until)

    moments.write = and_stand


def waiting_line(bench):
    """A line that comes a byte at a time in a hold: its last bytes are gathered in the serial task, and once the control task has
    taken the first, nothing but that calls it: no answer is on its way out and no byte comes."""
    bench.boot()
    board, host = bench.board, bench.host
    for line in ("G1X.01F600", "G1X.125F600"):
        before = len(host.answers)
        for text in ("!", line + "\n"):
            host.send(text)
            board.run(seconds=0.05)
        if len(host.answers) != before:
            raise Failure("a hold takes lines: this proves nothing")
        # The watchdog calls the task, too, but seldom.
        resumed = board.seconds(host.send("~"))
        bench.wait(lambda wanted=before + 1: len(host.answers) >= wanted, 1, f"the answer to {line}")
        took = board.seconds(host.lines[-1][0]) - resumed
        yield f"{line} is answered {took * 1e3:.2f} ms after the end of a hold"
        if took > 2e-3:
            raise Failure("its last bytes have waited")
        if host.answers[before:] != ["ok"]:
            raise Failure(f"answers: {host.answers[before:]}")
        board.run(seconds=0.5)


def late_starts(bench):
    """Interrupts are masked right before a motion begins: it begins later, whole, and nothing is said about it."""
    bench.boot()
    board = bench.board
    fast(bench, 10_000)

    tim2, hz = board.peripherals["TIM2"], bench.wiring.core_hz

    def start(before_s=None, masked_s=0.0, stands_until=None):
        """How long after the first event the first step comes."""
        # Until the next, and all there is to do at rest is done.
        board.run(seconds=0.002)
        scope, after = Scope(board), len(bench.host.text)
        bench.host.send("G91 G1 X0.02 F3000\n")

        def away():
            return (tim2.values[timer.CCR2] - tim2.count() & 0xFFFF_FFFF) * tim2.cycles / hz

        # The step task has itself called 450 us before the first event, which is 2 ms after the first segment.
        bench.wait(lambda: 1.3e-3 < away() < 1.6e-3, 0.1, "the first segment")
        begin = away() + 450 * US
        moment = board.now + begin * hz
        if stands_until is not None:
            stand_once(board, stands_until)
        if before_s is not None:
            board.run(seconds=begin - before_s)
            board.mask(masked_s)
        board.run(seconds=0.004)
        bench.wait_state("Idle", 0.5)
        said = bytes(bench.host.text[after:])
        if scope.counts() != [20, 0, 0] or b"ALARM" in said:
            raise Failure(f"masked for {us(masked_s)} {us(before_s or 0)} before: the motor is at {scope.counts()}; {said!r}")
        return (scope.steps()[0].at - moment) / hz

    usual = [start() for _ in range(3)]
    if max(usual) - min(usual) > US:
        raise Failure(f"starts that nothing disturbs differ: {', '.join(map(us, usual))}")
    harmless = [start(6 * k * US, 100 * US) - max(usual) for k in range(1, 81)]
    if max(harmless) > US:
        raise Failure(f"masked for 100 us up to 480 us before, a start is put off by {us(max(harmless))}")
    # Masked from before the task is called, or while it makes the first events, to right before or after the moment itself, and
    # to right after the first step: the first event is at one of these, or in between.
    delays = {}
    for before in range(200, 500, 6):
        for end in (-60 * US, -2 * US, 5 * US, max(usual) + 5 * US):
            delays[before, end] = start(before * US, before * US + end) - max(usual)
    later = [delay for delay in delays.values() if delay > 0.1 * US]
    yield (
        f"masked for 100 us before the first step: 80 of 80 in time; for up to {us(max(usual) + 505 * US)}: {len(later)} of {len(delays)} put off, "
        f"by {us(max(later, default=0))} at most; no step lost"
    )
    if not 5 < len(later) < len(delays):
        raise Failure("no start was late, or all were: this proves nothing")
    again = {end: start(stands_until=end) - max(usual) for end in (k * 0.25 * US for k in range(-40, 41))}
    late = [delay for delay in again.values() if delay > 0.1 * US]
    yield f"stopped while it begins, to 10 us before and after the first step: {len(late)} of {len(again)} put off, by {us(max(late, default=0))} at most"
    if not 5 < len(late) < len(again) or max(late) > 45 * US:
        raise Failure("no start was begun again, or all were, or too late")
    for (before, end), delay in delays.items():
        if delay > max(end, 0) + 250 * US:
            raise Failure(f"masked from {before} us before to {us(end)} after the first moment, put off by {us(delay)}")


def miscounts(bench):
    """A trigger that TIM1 misses, a request too many, an error of a stream: the motion ends soon, and ALARM:103 says why."""

    def miss(tim1):
        trigger = tim1.trigger

        def once(at):
            tim1.trigger = trigger

        tim1.trigger = once

    faults = {
        "a trigger is missed": lambda board: miss(board.peripherals["TIM1"]),
        "a request too many": lambda board: board.dma[1].ask("TIM1_CH1", board.now + 1),
        "a stream's error": lambda board: board.dma[1].values.__setitem__(0, board.dma[1].values[0] | 1 << 9),
        "an error of the moments": lambda board: board.dma[0].values.__setitem__(4, board.dma[0].values[4] | 1 << 9),
    }
    for what, inject in faults.items():
        bench.boot()
        board, scope = bench.board, Scope(bench.board)
        moving(bench)
        begin, after = board.now, len(bench.host.text)
        inject(board)
        bench.wait_text("ALARM:103", 0.1, after)
        late = max(0, scope.steps()[-1].at - begin) / bench.wiring.core_hz
        bench.at_rest(0.005)
        if not bench.status().startswith("<Alarm"):
            raise Failure(f"{what}: {bench.status()}")
        yield f"{what}: ALARM:103, steps for another {us(late)}"
        if late > 2e-3:
            raise Failure(f"{what}: steps for another {us(late)}")


def error_of(bench, line):
    """The error that a line is answered by."""
    answers = len(bench.host.answers)
    bench.host.send(line + "\n")
    bench.wait(lambda: len(bench.host.answers) > answers, 1, f"an answer to {line}")
    return bench.host.answers[-1]


def trips(bench):
    """Limit, emergency stop ($912), reset button and driver fault end the pulses without the control task, which hangs."""
    wiring = bench.wiring
    for what, pin, settings in (
        ("limit switch", wiring.limits[1], {"s21": 1}),
        ("emergency stop", wiring.reset, {"s912": 1}),
        ("reset button", wiring.reset, {}),
        ("driver fault", wiring.driver_fault, {}),
    ):
        worst = 0
        for phase in (0.0, 17e-6, 49e-6):
            bench.boot()
            board = bench.board
            fast(bench, 1000)
            bench.settings(**settings)
            scope = Scope(board)
            moving(bench)
            board.run(seconds=phase)
            hang(bench)
            begin = board.now
            board.drive(pin, 0)
            # Less than what is queued lasts: it would go on.
            board.run(seconds=0.006)
            rising = [step.at for step in scope.steps()]
            worst = max(worst, (rising[-1] - begin) / wiring.core_hz)
        if worst > TRIP_S:
            raise Failure(f"{what}: pulses for another {us(worst)}, allowed {us(TRIP_S)}")
        yield f"{what}: pulses end at most {us(worst)} after its contact, allowed {us(TRIP_S)}; the control task stood still"


def emergency_stop(bench):
    """Pressed in full motion: all off, drivers on, latched, reported with place and line; and not trusted afterwards."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    bench.settings(s912=1)
    fast(bench, 1000)
    all_on(bench)
    scope = Scope(board)
    bench.ask("N42 G91 G1 X100 F3000")
    board.run(seconds=0.1)
    begin, after = board.now, len(host.text)
    board.drive(wiring.reset, 0)
    bench.wait_text("Reset to continue", 0.5, after)
    late = (scope.steps()[-1].at - begin) / wiring.core_hz
    off = us_off(bench, begin)
    if late > TRIP_S or board.level(wiring.enable) != 0:
        raise Failure(f"pulses for another {us(late)}, enable output {board.level(wiring.enable)}")
    said = bytes(host.text[after:]).decode()
    place = scope.counts()[0] / 1000
    if "ALARM:101" not in said or f"[MSG:Emergency stop at machine {place:.3f},0.000,0.000, line 42]" not in said:
        raise Failure(f"at X{place}: {said!r}")
    bench.at_rest(0.1)
    after = len(host.text)
    host.send(b"\x18")
    bench.wait_text("'$H'|'$X' to unlock", 0.5, after)
    if b"ALARM:101" not in host.text[after:]:
        raise Failure("a reset does not tell that the emergency stop is still active")
    for line, answer in (("$X", "error:50"), ("G0 X0", "error:9")):
        if error_of(bench, line) != answer:
            raise Failure(f"{line} was answered by {host.answers[-1]}")
    board.drive(wiring.reset, None)
    board.run(seconds=0.01)
    if not any("may be lost" in line for line in bench.ask("$X")):
        raise Failure("the position is trusted after a stop at speed")
    yield f"last rising edge {us(late)} after the contact, spindle and coolant off after {off}; told with line and place"


def lines_at_stops(bench):
    """Emergency stops in lines of 0.2 ms: the line that is told is the one that the last step belongs to, also where it has begun
    since the step task was called last."""
    bench.boot()
    board, random = bench.board, Random(21)
    fast(bench, 10_000)
    bench.settings(s11=0.1, s912=1)
    # Small turns keep lines from being joined.
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
        # A line begins with the last step of the one before it.
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


def noise(bench):
    """Disturbances of a limit pin shorter than the filter: nothing stops, and each is counted. And resistors."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    bench.settings(s21=1)
    fast(bench, 1000)
    bench.ask("G91 G1 X20 F3000")
    lengths = [120 * US, 200 * US, 330 * US] * 10
    for k, length in enumerate(lengths):
        board.drive(wiring.limits[0], 0)
        board.run(seconds=length)
        board.drive(wiring.limits[0], None)
        # A sample may wait for a run of the step task: a shorter pause might not be seen.
        board.run(seconds=(110 + 37 * k % 60) * US)
    bench.wait_state("Idle", 3)
    shown = {line[5:].split(",")[0]: line[:-1].split(",")[1:] for line in bench.ask("$PINS") if line.startswith("[PIN:")}
    counts = {name: int(fields[-1].split()[-1]) for name, fields in shown.items()}
    yield f"{len(lengths)} disturbances of 120 to 330 us on the X limit: no stop; $PINS counts {counts['limit X']}"
    if counts.pop("limit X") != len(lengths) or any(counts.values()):
        raise Failure(f"$PINS says {shown}")
    names = {"limit X", "limit Y", "limit Z", "second limit", "probe", "door", "hold", "start", "reset", "driver fault"}
    names |= {f"input {number}" for number, _ in enumerate(wiring.program_inputs)}
    if set(shown) != names | ({"at speed"} if wiring.at_speed else set()):
        raise Failure(f"$PINS shows {sorted(shown)}")
    bench.ask("$PINS=0")
    bench.settings(s21=0, s18=1, s910=2)
    board.run(seconds=0.01)
    pulls = []
    for pin in (*wiring.limits, wiring.probe):
        gpio, number = board.pin(pin)
        pulls.append(gpio.values[0x0C] >> 2 * number & 3)
    if pulls != [0, 2, 1, 1]:
        raise Failure(f"PUPDR of the limits and the probe: {pulls}")
    line = next(line for line in bench.ask("$PINS") if "limit Y" in line)
    if line != "[PIN:limit Y,low,active,active low,pull-down,noise 0]":
        raise Failure(line)
    yield "resistors: none ($18), pull-down ($910) and pull-up as set"


def probe(bench):
    """The place of a contact is that of the step at which it comes, and braking begins there."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    fast(bench, 1000)
    acceleration, worst = 1_000_000, 0
    for feed, wait in ((600, 0.31), (3000, 0.2), (60, 0.5001), (6000, 0.1777)):
        scope = Scope(board)
        before = scope_of_z(bench)
        host.send(f"G91 G38.2 Z-30 F{feed}\n")
        board.run(seconds=wait)
        contact, after = board.now, len(host.lines)
        board.drive(wiring.probe, 0)
        bench.wait(lambda after=after: any(line.startswith("[PRB:") for _, line in host.lines[after:]), 2, "the probe's report")
        board.drive(wiring.probe, None)
        report = next(line for _, line in host.lines[after:] if line.startswith("[PRB:"))
        latched = round(float(report.split(":")[1].split(",")[2]) * 1000)
        steps = [step.at for step in scope.steps()]
        at_contact = before - sum(1 for at in steps if at <= contact)
        end = before - len(steps)
        overshoot = latched - end
        bound = (feed / 60 * 1000) ** 2 / 2 / acceleration + 1
        # The pin is looked at after the step of a tick: the one that is under way, or the next.
        if not 0 <= at_contact - latched <= 1 or not report.endswith(":1]"):
            raise Failure(f"F{feed}: contact after step {at_contact}, latched {latched}: {report}")
        # The ramp's series, in single precision, may be a step or two longer in 5000 (84 MHz).
        if not 0 <= overshoot <= 1.0005 * bound + 1:
            raise Failure(f"F{feed}: {overshoot} steps beyond the contact, v²/2a + 1 = {bound:.0f}")
        worst = max(worst, at_contact - latched)
        bench.wait_state("Idle", 1)
        yield f"F{feed}: latched at step {latched} (contact after {at_contact}), then {overshoot} steps, v²/2a + 1 = {bound:.0f}"


def scope_of_z(bench):
    """Where Z stands by the report, in steps."""
    return round(float(bench.status().split("MPos:")[1].split("|")[0].split(",")[2]) * 1000)


def flood(bench):
    """More realtime commands than their queue holds while the control task stands still, the last of them a reset: obeyed."""
    for last, name in ((b"\x18", "0x18"), (b"\x85", "0x85"), (b"!", "!")):
        bench.boot()
        board, host = bench.board, bench.host
        fast(bench, 1000)
        moving(bench)
        after = len(host.text)
        hang(bench)
        host.send(90 * b"?" + last)
        board.run(seconds=0.012)
        unpatch(bench)
        if last == b"!":
            bench.wait_state("Hold:0", 1)
            yield "90 times ? and !: held"
            continue
        bench.wait_text("Grbl 1.1h", 1, after)
        # The byte after the loss says so.
        host.send("\n")
        board.run(seconds=0.01)
        bench.ask("$X")
        bench.ask("G21")
        yield f"90 times ? and {name}: a reset, and the link goes on"


FASTER, SLOWER = 9 * b"\x91" + 8 * b"\x93", 9 * b"\x92" + 8 * b"\x94"
"""From 100 to 198 percent and back, ten and then one at a time."""


def override_bursts(bench):
    """Overrides back to back while the ring is full of short chords on a circle: nothing runs dry, no step is lost, and `?`
    is answered in time with the override that holds."""
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
    """Of the first report that tells them."""
    for _ in range(4):
        if "|Ov:" in status:
            return status.split("|Ov:")[1].rstrip(">").split("|")[0]
        status = bench.status()
    return status


def answered_behind(bench, burst):
    """Sends commands and a `?`: s from its last bit to the first of the report, and the report."""
    host, hz = bench.host, bench.wiring.core_hz
    before = len(host.lines)
    heard = host.send(burst + b"?")
    bench.wait(lambda: any(text.startswith("<") and at > heard for at, text in host.lines[before:]), 0.5, "a status report")
    at, text = next((at, text) for at, text in host.lines[before:] if text.startswith("<") and at > heard)
    return (at - heard) / hz - 10 * (len(text) + 2) / host.baud, text


def same_steps(bench, scope, job, settings):
    """The steps of each axis are those of the simulator, whatever the overrides were. How many."""
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


def left_loader(bench):
    """The chip's boot loader jumps into the program, as a host may order (`:leave` of dfu-util), with its own vectors and clocks: the
    program starts over from a reset."""
    for resets_clocks in (False, True):
        board = bench.fresh()
        board.jump_from_loader(resets_clocks)
        begin = board.seconds()
        bench.wait_text("Grbl 1.1h", 1.0)
        if [why for _, why in board.resets] != ["software"]:
            raise Failure(f"resets: {board.resets}")
        if board.clocks[-1][2] != bench.wiring.core_hz:
            raise Failure(f"the core runs at {board.clocks[-1][2]} Hz")
        if any(at < board.resets[0][0] and level in (0, 1) for at, _, _, level in board.edges):
            raise Failure("an output was driven before the reset")
        yield f"left with clocks {'reset' if resets_clocks else 'on'}: reset after {us(board.seconds(board.resets[0][0]) - begin)}"


def lost_clock(bench):
    """The oscillator fails in full motion with the spindle on, also while interrupts are masked: everything safe at once, and the cause
    is told once there is a clock again."""
    for masked in (False, True):
        bench.boot()
        board = bench.board
        busy(bench)
        scope = Scope(board)
        board.core.write("primask", int(masked))
        begin = board.now
        board.rcc.lose_hse()
        bench.wait(lambda board=board: board.resets, 0.1, "a reset")
        board.rcc.hse_stands = False
        rising = [step.at for step in scope.steps()]
        late = board.seconds(max([begin, *rising])) - board.seconds(begin)
        off = us_off(bench, begin)
        if late > STOP_S:
            raise Failure(f"pulses for another {us(late)}")
        tell(bench, "clock failure")
        yield f"clock lost{', interrupts masked' * masked}: spindle off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def low_at_power_up(bench):
    """A supply that is low from the beginning raises no edge; one that rises slowly is no failure."""
    board = bench.fresh()
    board.set_supply(2.7)
    board.run(seconds=0.12)
    board.set_supply(3.3)
    bench.wait_text("Grbl 1.1h", 1)
    board.run(seconds=0.02)
    if board.resets or bench.host.has_said("failure"):
        raise Failure("a supply that takes 120 ms to rise counts as a failure")
    board = bench.fresh()
    board.set_supply(2.7)
    board.run(seconds=1.2)
    if board.resets or bench.host.has_said("Grbl"):
        raise Failure("the firmware runs on a supply of 2.7 V")
    board.set_supply(3.3)
    tell(bench, "oltage")
    yield f"2.7 V for 120 ms: no failure; for 1.2 s: not started before the supply was good; {cause(bench)}"


def overflowed(bench):
    """The stack runs out of its memory in full motion with the spindle on: everything safe, and the cause is told."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    busy(bench)
    scope = Scope(board)
    patch(bench, control_body(bench.image), b"\xff\xb4\xfd\xe7")  # push {r0-r7}; b .-2
    board.faults_expected = True
    bench.wait(lambda: board.faults, 0.1, "the fault")
    at = board.faults[0][0]
    board.run(seconds=0.001)
    late = max(0, max((step.at for step in scope.steps()), default=0) - at) / wiring.core_hz
    if late > STOP_S:
        raise Failure(f"pulses for {us(late)} after the overflow")
    off = us_off(bench, at)
    bench.wait(lambda: board.resets, 1, "a reset")
    unpatch(bench)
    tell(bench, "stack overflow")
    yield f"spindle and coolant off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def failed_twice(bench):
    """A second failure while the first one is being logged: a reset, and the first one is told."""
    bench.boot()
    board, image = bench.board, bench.image
    names = [start for start, _, name in image.functions if "stm32f4" in name and "restart" in name]
    if not names:
        raise Failure("the image has no function that logs a failure")
    busy(bench)
    board.faults_expected = True
    hang(bench)
    first = bench.patched
    patch(bench, names[0], b"\x00\xde")  # udf
    bench.wait(lambda: board.resets, 3, "a reset")
    unpatch(bench)
    put(bench, *first)
    if not board.faults:
        raise Failure("nothing failed for the second time: this proves nothing")
    tell(bench, "stuck task")
    yield f"{cause(bench)}"


def settings_write(bench):
    """Settings written and sectors erased while lines keep coming: each byte is answered for; all survives a power cycle."""
    bench.boot()
    board, host = bench.board, bench.host
    before, operations, erases = len(host.answers), board.flash.operations, board.flash.erases
    # Until a sector is full and the next one has been erased.
    lines = [f"${130 + k % 3}={200 + k}.5" if k % 8 else "G4P0" for k in range(1600)]
    bench.forget_masks()
    host.stream("\n".join(lines))
    bench.wait(lambda: host.all_answered, 20, "the last answer")
    board.run(seconds=0.5)
    answers = host.answers[before:]
    if answers != ["ok"] * len(lines) or board.usart.overruns or host.has_said("lost"):
        raise Failure(f"{answers.count('ok')} of {len(lines)} answered ok, {board.usart.overruns} overruns: {answers[-3:]}")
    if board.flash.erases == erases:
        raise Failure("no sector was erased: this proves nothing")
    mask, where = bench.longest_mask()
    yield f"{len(lines)} lines, {board.flash.operations - operations} flash operations, {board.flash.erases - erases} of them erases, no byte lost; longest time masked {us(mask)} ({where})"
    shown = bench.ask("$$")
    board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    again = bench.ask("$$")
    shown, again = ([line for line in text if line.startswith("$")] for text in (shown, again))
    if shown != again:
        raise Failure("settings changed over a reset")
    yield f"{len(again)} settings unchanged after a reset"


def power_cut(bench):
    """The power fails at each of the flash operations of a settings write: old or new, never anything else."""
    bench.boot()
    board = bench.board
    bench.ask("$130=321.5")
    start = board.flash.operations
    bench.ask("$130=654.25")
    needed = board.flash.operations - start
    if needed == 0:
        raise Failure("nothing was written")
    seen = []
    for cut in range(needed + 1):
        bench.boot()
        bench.ask("$130=321.5")
        board = bench.board
        board.operations_left = cut
        bench.host.send("$130=654.25\n")
        board.run(seconds=0.1)
        flash = board.read_memory(board.part.flash_start, board.part.flash_kib * 1024)
        board = bench.fresh()
        board.write_memory(board.part.flash_start, flash)
        bench.wait_text("Grbl 1.1h", 2)
        value = next(line for line in bench.ask("$$") if line.startswith("$130=")).split("=")[1]
        if float(value) not in (321.5, 654.25):
            raise Failure(f"power cut before operation {cut} of {needed}: $130={value}")
        seen.append(float(value))
    if sorted(seen) != seen or seen[0] != 321.5 or seen[-1] != 654.25:
        raise Failure(f"values over the cuts: {seen}")
    yield f"{needed} operations in a write: cut after 0 to {needed} of them, {seen.count(321.5)} times the old value, then the new"


def hung(bench):
    """The control task never comes back: the chip is reset, outputs are safe from before the reset on, the cause is told."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    scope = Scope(board)
    hang(bench)
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a reset")
    unpatch(bench)
    tell(bench, "stuck", "atchdog")
    cycle, why = board.resets[0]
    yield f"control task: outputs safe {us_off(bench, begin)} and reset by {why} {(cycle - begin) / wiring.core_hz * 1e3:.0f} ms after it hung; {cause(bench)}"
    late = [step.at for step in scope.steps() if step.at > cycle]
    if late:
        raise Failure("steps after the reset")


def unserved(bench):
    """The interrupts of a task are off, as by a disturbed interrupt controller: the others see that it does not answer."""
    for task, interrupts in (("serial", (36, 67)), ("receive", (37, 38)), ("step", (28,))):
        yield f"{task} task: {without_interrupts(bench, interrupts)}"


def without_interrupts(bench, numbers):
    """What comes of it when these are off in full motion."""
    bench.boot()
    board = bench.board
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    board.nvic.enabled -= {16 + number for number in numbers}
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a reset")
    tell(bench, "stuck")
    cycle, why = board.resets[0]
    return f"outputs safe {us_off(bench, begin)} and reset by {why} {(cycle - begin) / bench.wiring.core_hz * 1e3:.0f} ms after its interrupts went off; {cause(bench)}"


def recorded(bench):
    """A control task that hangs in mid-job: what the board has recorded leads the simulator to the place and line of the failure."""
    bench.boot()
    bench.settings(**JOB_SETTINGS)
    board = bench.board
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    for line in ("G91", "N10 G1 X3 F1200", "N20 Y2", "N30 X40"):
        bench.ask(line)
    board.run(seconds=0.4)
    hang(bench)
    bench.wait(lambda: board.resets, 5, "a reset")
    unpatch(bench)
    tell(bench, "stuck", "atchdog")
    told = cause(bench)
    if "recording" in bench.wiring.left_out and "$REC" not in told:
        raise LeftOut("this board has no room for a recording")
    if "$REC" not in told:
        raise Failure(f"nothing is recorded: {told}")
    bench.ask("$X")
    listing = bench.ask("$REC", 5.0)
    end = next((line for line in listing if " ended " in line), None)
    if end is None or listing[-1] != "ok" or "[REC:end]" not in listing:
        raise Failure(f"the listing has no end: {listing[-5:]}")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "board.log"
        log.write_text("\n".join(listing) + "\n")
        done = subprocess.run([bench.oxmill, "replay", str(log)], capture_output=True, text=True, check=False)
    arrival = [line for line in done.stdout.splitlines() if "arrives at the place and line of the failure" in line]
    if done.returncode not in (0, 1) or done.stderr or not arrival:
        raise Failure(f"the replay parts: {done.stdout} {done.stderr}")
    if f"N{told.split(', line ')[1].split(',')[0]} " not in arrival[0]:
        raise Failure(f"the board failed at another line: {told}; {arrival[0]}")
    yield f"{len(listing)} lines are listed; the replay {arrival[0].split('replay')[-1].strip()}"


def deaf(bench):
    """Interrupts are masked for ever: only the independent watchdog can help."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    patch(bench, control_body(bench.image), b"\x72\xb6\xfe\xe7")  # cpsid i; b .
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a watchdog reset")
    unpatch(bench)
    cycle, why = board.resets[0]
    tell(bench, "atchdog", "WDT")
    yield f"masked for ever: reset by the {why} {(cycle - begin) / wiring.core_hz * 1e3:.0f} ms later; {cause(bench)}"


def brown_out(bench):
    """The supply sinks below the detector's threshold in full motion with the spindle on."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.peripherals["PWR"].values[0] >> 4 & 1:
        raise Failure("the supply is not watched")
    whole = Scope(board)
    busy(bench)
    scope = Scope(board)
    begin = board.now
    board.set_supply(2.7)
    board.run(seconds=0.02)
    rising = [step.at for step in scope.steps()]
    late = max(0, max(rising, default=0) - begin) / wiring.core_hz
    off = us_off(bench, begin)
    if late > STOP_S:
        raise Failure(f"pulses for another {us(late)}")
    if board.resets:
        raise Failure("the chip begins anew while the supply is still low")
    board.set_supply(3.3)
    bench.wait(lambda: board.resets, 1, "a reset after the supply has come back")
    tell(bench, "oltage", "upply")
    told = cause(bench)
    place, counted = float(told.split("at machine ")[1].split(",")[0]), whole.counts()[0] / 1000
    # The control task looks every 2 ms, and the pieces that it knows of last a millisecond: 3 ms of 50 mm/s, and a margin.
    if not -0.1 <= counted - place <= 0.4:
        raise Failure(f"X{place} is reported after {counted} mm: {told}")
    yield f"the place is the one {(counted - place) * 1e3:.0f} um before the last step"
    yield f"2.7 V: spindle off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def brown_out_of_a_beam(bench):
    """The supply sinks in mid-raster, and the next change of power comes while outputs are being made safe: no beam behind it, no
    pulse."""
    bench.boot()
    board, hz = bench.board, bench.wiring.core_hz
    fast(bench, 10_000)
    bench.settings(s100=80, s110=12_000, s30=10, s31=0, s32=1)
    clock, pwm, beam = board.peripherals["TIM2"], board.peripherals["TIM3"], BeamWatch(board)
    bench.host.send("G91G1F6000M3S0\nX.6\n" + "".join(f"X.05S{2 + 6 * (k % 2)}\n" for k in range(10)) + "X9S7\n")

    def away_s():
        return (clock.values[timer.CCR3] - clock.count() & 0xFFFF_FFFF) * clock.cycles / hz

    bench.wait(lambda: beam.last and len(beam.changes) > 2 and 150 * US < away_s() < 450 * US, 0.1, "a change of power that is due")
    write, made_safe = pwm.write, []

    def and_stand(offset, value):
        write(offset, value)
        if offset == timer.CCR2 and value == 0 and not made_safe:
            made_safe.append(board.now)
            board.stall(away_s() + 20 * US)

    pwm.write = and_stand
    scope = Scope(board)
    board.set_supply(2.7)
    board.run(seconds=0.005)
    if not made_safe:
        raise Failure("the beam was not switched off")
    late = [step.at for step in scope.steps() if step.at > made_safe[0]]
    if beam.last or duty(board) or late:
        raise Failure(f"after the beam was switched off power is {beam.changes[-1][1]}, and {len(late)} pulses come")
    board.set_supply(3.3)
    tell(bench, "oltage", "upply")
    yield "2.7 V, and the processor stands up to a change of power behind the beam's end: it stays off, and no pulse comes"


def inverted_outputs(bench):
    """$2 and $4: step pins rest high, the enable output is high while the drivers are on; and so it is after a failure."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    bench.settings(s2=7, s4=1)

    def expect(when, enable):
        levels = [board.level(pin) for pin in wiring.step]
        if levels != [1, 1, 1] or board.level(wiring.enable) != enable:
            raise Failure(f"{when}: step pins at {levels}, enable output at {board.level(wiring.enable)}")

    expect("at rest with drivers off", 0)
    bench.settings(s1=255)
    moving(bench, 1000)
    scope = Scope(board)
    board.run(seconds=0.1)
    if not scope.steps():
        raise Failure("nothing moves: this proves nothing")
    board.set_supply(2.7)
    board.run(seconds=0.02)
    expect("after a failure in motion", 1)
    board.set_supply(3.3)
    bench.wait(lambda: board.resets, 1, "a reset after the supply has come back")
    tell(bench, "oltage", "upply")
    expect("after the reset, by $1=255", 1)
    yield "step pins high, enable output low with drivers off and high with drivers on; a failure changes neither"


def second_motor(bench):
    """The second motor of an axis ($905): steps with it and with no other, turns the other way, is squared by its own switch."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    rest = {"s110": 1000, "s111": 1000, "s112": 1000, "s120": 500, "s121": 500, "s122": 500}
    bench.settings(**rest, s905=2)

    def moved(line):
        scope = Scope(board, second=True)
        bench.ask(f"G91 G1 {line} F600")
        bench.wait_state("Idle", 2)
        return scope.counts()

    for settings, line, counts in (
        ({}, "X-1 Y2 Z1", [-250, 500, 250, 500]),
        ({"s906": 1}, "Y1", [0, 250, 0, -250]),
        ({"s3": 2}, "Y1", [0, -250, 0, 250]),
        ({"s3": 0, "s905": 3, "s906": 0}, "Y1 Z-1", [0, 250, -250, -250]),
        ({"s905": 0}, "X1 Y1 Z1", [250, 250, 250, 0]),
    ):
        bench.settings(**settings)
        if (found := moved(line)) != counts:
            raise Failure(f"{settings} {line}: motors at {found} instead of {counts}")
    bench.settings(s905=1, s2=1)
    if [board.level(pin) for pin in (*wiring.step, wiring.second_step)] != [1, 0, 0, 1]:
        raise Failure("$2 does not invert the second motor with its axis")
    bench.settings(s2=0)
    yield "steps and turns with its axis only, also inverted"
    bench.settings(s907=1, s22=1, s44=1, s45=0, s46=0, s24=120, s25=600, s26=5, s27=1)
    scope = Scope(board, second=True)
    host.send("$H\n")
    # Motor by motor the switch closes here.
    places, answered = (400, 460), len(host.answers)
    begin = board.now
    while len(host.answers) == answered and board.seconds(board.now) - board.seconds(begin) < 20:
        board.run(seconds=0.004)
        first, _, _, second = scope.counts()
        board.drive(wiring.limits[0], 0 if first >= places[0] else 1)
        board.drive(wiring.second_limit, 0 if second >= places[1] else 1)
    first, _, _, second = scope.counts()
    if host.answers[answered:] != ["ok"] or abs(second - first - 60) > 12:
        raise Failure(f"$H was answered by {host.answers[answered:]}, the motors are at {first} and {second}")
    yield f"squared: the second motor is {second - first} steps further, its switch 60"


def fourth_axis(bench):
    """An axis that turns ($930=4) on the pins of the second motor: steps, polarities, the safe rate on all four, its switch. A board
    without it locks motion."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    bench.settings(s930=4)
    if wiring.axes < 4:
        for line, wanted in (("G91 G1 X1 F600", "error:9"), ("$103=10", "error:3")):
            if (found := error_of(bench, line)) != wanted:
                raise Failure(f"{line} was answered by {found} without a fourth axis")
        yield "none: motion is locked until $930 is 3 again"
        return
    bench.settings(s110=1000, s111=1000, s112=1000, s113=3000, s120=500, s121=500, s122=500, s123=500, s103=100)

    def moved(line):
        scope = Scope(board, second=True)
        bench.ask(f"G91 G1 {line} F600")
        bench.wait_state("Idle", 3)
        return scope.counts()

    for settings, line, counts in (
        ({}, "X-1 Y2 Z1 A-4.5", [-250, 500, 250, -450]),
        ({"s3": 8}, "A3", [0, 0, 0, -300]),
        ({"s3": 7}, "X1 A-3", [-250, 0, 0, -300]),
        ({"s3": 0, "s930": 3}, "X1", [250, 0, 0, 0]),
        ({"s905": 2}, "Y1", [0, 250, 0, 250]),
        ({"s905": 0, "s930": 4}, "Y1 A1", [0, 250, 0, 100]),
    ):
        bench.settings(**settings)
        if (found := moved(line)) != counts:
            raise Failure(f"{settings} {line}: motors at {found} instead of {counts}")
    bench.settings(s2=8)
    if [board.level(pin) for pin in (*wiring.step, wiring.second_step)] != [0, 0, 0, 1]:
        raise Failure("$2=8 does not invert A alone")
    bench.settings(s2=0)
    yield "A steps, and turns the other way, by itself"
    bench.settings(s22=1, s44=8, s45=0, s46=0, s24=600, s25=3000, s26=5, s27=1, s133=90)
    scope = Scope(board, second=True)
    answered, begin = len(host.answers), board.now
    host.send("$HA\n")
    while len(host.answers) == answered and board.seconds(board.now) - board.seconds(begin) < 20:
        board.run(seconds=0.004)
        board.drive(wiring.second_limit, 0 if scope.counts()[3] >= 1200 else 1)
    counts = scope.counts()
    if host.answers[answered:] != ["ok"] or counts[:3] != [0, 0, 0] or not 1080 <= counts[3] <= 1120:
        raise Failure(f"$HA was answered by {host.answers[answered:]}, the motors are at {counts}")
    yield f"homed at its own switch, {1200 - counts[3]} steps before it"
    yield from all_four_fast(bench)


def all_four_fast(bench):
    """Back and forth at the safe rate, all four together: no period is off."""
    safe, pulse_us = bench.wiring.safe_step_hz, bench.wiring.least_pulse_us
    acceleration = hard(bench, 6_000)
    bench.boot()
    bench.settings(s930=4)
    fast(bench, acceleration)
    greatest = round(safe * 60 / 1000, 3)
    bench.settings(s0=pulse_us, s103=1000, s123=acceleration, s110=greatest, s111=greatest, s112=greatest, s113=greatest)
    bench.forget_masks()
    scope, steps = Scope(bench.board, second=True), round(1.1 * safe**2 / acceleration / 1000 + 2000)
    way = steps / 1000
    # F is along X, Y and Z.
    for sign in ("", "-"):
        bench.ask(f"G91 G1 X{sign}{way:.3f} Y{sign}{way:.3f} Z{sign}{way:.3f} A{sign}{way:.3f} F{greatest * 3**0.5:.3f}")
    bench.wait_state("Idle", 5)
    events, widths, _, _ = scope.read()
    if scope.counts() != [0] * 4 or len(events) != 2 * steps or any(event.axes != 15 for event in events):
        raise Failure(f"{len(events)} steps, ends at {scope.counts()}")
    ramp = round(1.05 * safe**2 / 2 / acceleration / 1000) + 5
    found = steady(events[:steps], bench.wiring.core_hz, 1 / safe, ramp)
    if found is None or found["period_error"] > JITTER_S or max(widths) > pulse_us * US + JITTER_S:
        raise Failure(f"at {safe} steps/s: {found}, pulses up to {us(max(widths))}")
    mask, where = bench.longest_mask()
    busy, longest = step_load(bench.board, events[ramp].at, events[steps - ramp].at)
    yield f"four axes at {safe} steps/s: period error {us(found['period_error'])}, pulses {us(min(widths))} to {us(max(widths))}, masked {us(mask)} ({where}); step task {busy:.0%}, longest run {longest} cycles"


def spindle_pwm(bench):
    """Frequency and share of the spindle's PWM, from an opto-coupler's to a laser's, also when it is changed while it turns."""
    bench.boot()
    bench.settings(s30=1000)
    pwm = bench.board.peripherals["TIM3"]
    for hz in (5_000, 1_000, 50, 1, 25_000, 100_000):
        bench.settings(s33=hz)
        bench.ask("M3 S250")
        bench.board.run(seconds=0.005)
        shares = []
        for speed in (500, 1000, 250):
            bench.ask(f"S{speed}")
            bench.board.run(seconds=0.005)
            shares.append((speed / 1000, duty(bench.board)))
        found = pwm.frequency()
        if abs(found / hz - 1) > 1e-3 or any(abs(share - wanted) > 0.005 for wanted, share in shares):
            raise Failure(f"$33={hz}: {found:.2f} Hz, shares {shares}")
        bench.settings(s33=2_000)
        if abs(duty(bench.board) - 0.25) > 0.005:
            raise Failure(f"$33=2000 while the spindle turns: share {duty(bench.board):.4f} instead of 0.25")
        bench.ask("M5")
        bench.board.run(seconds=0.005)
        if duty(bench.board):
            raise Failure("the PWM stays on")
        yield f"$33={hz}: {found:.2f} Hz, shares {', '.join(f'{share:.4f}' for _, share in shares)}"


OUTPUT_S = 2.5e-3
"""From the first step of a motion to the output that changes with it (M62, M63): a look each millisecond, and the work in hand."""


def program_outputs(bench):
    """M64 and M65 at once, M62 and M63 where their motion begins; off after a reset and an alarm. A board without refuses them."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    outputs = wiring.program_outputs
    for line in (f"M64 P{len(outputs)}", f"M62 P{len(outputs)}", "M68 E0 Q1"):
        if (error := error_of(bench, line)) != "error:133":
            raise Failure(f"{line} was answered by {error}")
    if not outputs:
        yield "the board has none, and says so (error:133)"
        return

    def shown():
        board.run(seconds=0.001)
        return [board.level(pin) for pin in outputs]

    for line, levels in (("M64 P0", [1, 0]), ("M64 P1", [1, 1]), ("M65 P0", [0, 1]), ("M65 P1", [0, 0]), ("M62 P0", [0, 0])):
        bench.ask(line)
        if (found := shown()) != levels:
            raise Failure(f"after {line} the outputs are {found} and not {levels}")
    bench.ask("M63 P0")
    fast(bench, 1000)
    scope, begin = Scope(board), len(board.edges)
    lines = len(host.answers)
    host.stream("G91 F3000\nG1 X5\nM62 P1\nG1 Y5\nM63 P1 G1 X5\nG1 X5\n")
    bench.wait(lambda: host.all_answered, 2, "the last answer")
    bench.wait_state("Idle", 2)
    if set(host.answers[lines:]) != {"ok"}:
        raise Failure(f"answers: {host.answers[lines:]}")
    steps = [step.at for step in scope.steps()]
    changes = [(at, level) for at, port, pin, level in board.edges[begin:] if f"{port}{pin}" == outputs[1]]
    if [level for _, level in changes] != [1, 0] or len(steps) != 20_000:
        raise Failure(f"{outputs[1]} changes to {changes} in {len(steps)} steps")
    late = [(at - steps[first]) / wiring.core_hz for (at, _), first in zip(changes, (5_000, 10_000), strict=True)]
    # A block begins with the pause before its first step, in the middle of a path that does not stop a period of it.
    if not all(-1e-3 <= seconds <= OUTPUT_S for seconds in late):
        raise Failure(f"changes {us(late[0])} and {us(late[1])} after the first steps of their motions")
    yield f"M62 and M63 {us(late[0])} and {us(late[1])} after the first step of their motions, allowed {us(OUTPUT_S)}"
    for what in ("reset", "limit switch"):
        bench.settings(s21=1)
        for number, _ in enumerate(outputs):
            bench.ask(f"M64 P{number}")
        moving(bench)
        if shown() != [1, 1]:
            raise Failure("the outputs are not on")
        after = len(host.text)
        if what == "reset":
            host.send(b"\x18")
        else:
            board.drive(wiring.limits[0], 0)
        board.run(seconds=0.02)
        if shown() != [0, 0]:
            raise Failure(f"{what}: the outputs are {shown()}")
        board.drive(wiring.limits[0], None)
        if what == "limit switch":
            host.send(b"\x18")
        bench.wait_text("Grbl 1.1h", 1, after)
        board.run(seconds=0.05)
        bench.ask("$X")
    yield "at once with M64 and M65; off after a reset and a limit switch"


def program_inputs(bench):
    """M66 reads an input, or waits for it in each of its modes, a limited time."""
    bench.boot()
    board, wiring, host = bench.board, bench.wiring, bench.host
    inputs = wiring.program_inputs
    if (error := error_of(bench, f"M66 P{len(inputs)}")) != "error:133":
        raise Failure(f"M66 P{len(inputs)} was answered by {error}")
    if not inputs:
        yield "the board has none, and says so (error:133)"
        return

    def put_to(number, active):
        board.drive(inputs[number], 0 if active else None)

    def read():
        return float(next(line for line in bench.ask("(PRINT,#5399)") if line.startswith("[MSG:"))[5:-1])

    for levels in ((0, 0), (1, 0), (1, 1), (0, 1)):
        for number, active in enumerate(levels):
            put_to(number, active)
        board.run(seconds=0.002)
        for number, active in enumerate(levels):
            bench.ask(f"M66 P{number}")
            if read() != active:
                raise Failure(f"inputs {levels}: M66 P{number} reads {read()}")
    worst = 0
    # What the input does before, and the change that the mode waits for.
    for number, mode, before, after in ((0, 1, 0, 1), (1, 2, 1, 0), (1, 3, 0, 1), (0, 4, 1, 0)):
        put_to(number, before)
        put_to(1 - number, 1 - before)
        board.run(seconds=0.002)
        answers = len(host.answers)
        host.send(f"M66 P{number} L{mode} Q5\n")
        board.run(seconds=0.1)
        put_to(1 - number, before)
        board.run(seconds=0.1)
        if len(host.answers) != answers:
            raise Failure(f"L{mode} does not wait")
        contact = board.now
        put_to(number, after)
        bench.wait(lambda answers=answers: len(host.answers) > answers, 0.1, f"the answer to L{mode}")
        worst = max(worst, (host.lines[-1][0] - contact) / wiring.core_hz)
        if host.answers[-1] != "ok" or read() != after:
            raise Failure(f"L{mode}: {host.answers[-1]}, #5399 is {read()}")
    put_to(0, 0)
    board.run(seconds=0.002)
    begin = board.now
    bench.ask("M66 P0 L3 Q0.25")
    waited = (board.now - begin) / wiring.core_hz
    if read() != -1 or not 0.25 <= waited <= 0.26:
        raise Failure(f"Q0.25 waits for {waited:.3f} s, #5399 is {read()}")
    yield f"M66 answered at most {us(worst)} after the contact; Q0.25 waits for {waited:.3f} s"


def busy(bench):
    """Full motion, spindle, coolant and the outputs of programs on."""
    fast(bench, 1000)
    all_on(bench)
    moving(bench)
    if not duty(bench.board) or any(bench.board.level(pin) != 1 for pin in switched(bench.wiring)):
        raise Failure("spindle, coolant and outputs are not on")


def switched(wiring):
    """Outputs that `all_on` switches on."""
    return (wiring.spindle, wiring.flood, *wiring.program_outputs)


def all_on(bench):
    bench.ask("M3 S1000")
    bench.ask("M8")
    for number, _ in enumerate(bench.wiring.program_outputs):
        bench.ask(f"M64 P{number}")


def us_off(bench, begin):
    """When all that `all_on` switches on, and the PWM, were off after a moment."""
    board, wiring = bench.board, bench.wiring
    moments = []
    for name in switched(wiring):
        moment = next((at for at, port, pin, level in board.edges if f"{port}{pin}" == name and at >= begin and level != 1), None)
        if moment is None:
            raise Failure(f"P{name} stays on")
        moments.append(moment)
    if duty(board):
        raise Failure("the PWM stays on")
    return us(board.seconds(max(moments)) - board.seconds(begin))


def tell(bench, *words):
    """After the reset the welcome tells why, and nothing is on."""
    board = bench.board
    bench.wait_text("Grbl 1.1h", 2, bench.host.text.rfind(b"Grbl 1.1h") + 1)
    board.run(seconds=0.05)
    if any(board.level(pin) != 0 for pin in switched(bench.wiring)) or duty(board):
        raise Failure("spindle, coolant or an output is on after the reset")
    if not any(word in cause(bench) for word in words):
        raise Failure(f"the cause is not told: {bench.host.lines[-6:]}")


def cause(bench):
    """What was said since the last welcome."""
    lines = [text for _, text in bench.host.lines]
    last = max(k for k, text in enumerate(lines) if text.startswith("Grbl 1.1h"))
    return " ".join(text for text in lines[last + 1 :] if text.startswith("[MSG"))


def patch(bench, address, code):
    """Other instructions from now on, until `unpatch`."""
    bench.patched = (address, bench.board.read_memory(address, len(code)))
    put(bench, address, code)


def unpatch(bench):
    """The image as it was: what was put in stands for a fault of the program, not of the flash."""
    put(bench, *bench.patched)


def put(bench, address, code):
    bench.board.write_memory(address, code)
    bench.board.core.forget_decoded()
    bench.board.core.uc.ctl_remove_cache(address, address + len(code))


def hang(bench):
    """From now on the control task's body is an endless loop."""
    patch(bench, control_body(bench.image), b"\xfe\xe7")  # b .


def control_body(image):
    names = [name for _, _, name in image.functions if "control7Control" in name and ("4turn" in name or "4pass" in name)]
    if not names:
        raise Failure("the image has no function of the control task to hang")
    return next(start for start, _, name in image.functions if name == names[0])


def faulted(bench):
    """An undefined instruction in the control task, in full motion with the spindle on: everything safe at once."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    busy(bench)
    scope = Scope(board)
    patch(bench, control_body(bench.image), b"\x00\xde")  # udf
    board.faults_expected = True
    bench.wait(lambda: board.faults, 0.1, "the fault")
    at = board.faults[0][0]
    board.run(seconds=0.001)
    rising = [step.at for step in scope.steps()]
    late = max(0, max(rising, default=0) - at) / wiring.core_hz
    stuck = [name for name in wiring.step if board.level(name) == 1]
    if late > STOP_S or stuck:
        raise Failure(f"pulses for {us(late)} after the fault, step pins left high: {stuck}")
    yield f"HardFault: spindle and coolant off after {us_off(bench, at)}, last rising edge after {us(late)}"
    if board.resets:
        # The injected instruction belongs to the emulation, not to what the firmware does about it.
        unpatch(bench)
        tell(bench, "ault")
        yield f"then a reset; {cause(bench)}"


def with_usb(bench):
    if not bench.wiring.usb:
        raise LeftOut("this board has no USB of its own")
    bench.boot_with_usb()
    return bench.board, bench.host


def usb_port(bench):
    """Enumeration, the welcome line when the port is opened, a job by character counting, and a second host at the UART."""
    board, host = with_usb(bench)
    device = host.descriptors[1, 0]
    number = host.descriptors[3, 3][2:].decode("utf-16-le")
    words = [board.word(0x1FFF_7A10 + 4 * k) for k in range(3)]
    if device[8:12] != bytes([0x09, 0x12, 0x01, 0x00]) or number != "".join(f"{word:08X}" for word in words):
        raise Failure(f"device {device.hex()}, serial number {number}")
    if not bench.uart.has_said("Grbl 1.1h"):
        raise Failure("the UART was not greeted at power-up")
    yield f"set up and greeted; serial number {number}"
    bench.settings(**JOB_SETTINGS)
    scope = Scope(board)
    bench.forget_masks()
    before = len(host.answers)
    host.stream("\n".join(["G91 F3000"] + [f"G1 X{'-' if k % 2 else ''}0.5 Y0.25" for k in range(20)]))
    polls, moving, masks = 0, True, []
    while moving:
        # The log is written at rest only, and masks for longer than anything in motion.
        masks.append(bench.longest_mask())
        moving = not (bench.status().startswith("<Idle") and host.all_answered)
        polls += 1
        # Somebody else wants to drive: refused as long as this one has something to do.
        if polls == 5:
            bench.uart.send("G0X50\n")
        board.run(seconds=0.01)
    if any(answer != "ok" for answer in host.answers[before:]) or scope.counts() != [0, 20 * 250 // 4, 0]:
        raise Failure(f"{host.answers[before:]}, motors at {scope.counts()}")
    if bench.uart.lines[-1][1] != "error:8":
        raise Failure(f"the UART was told {bench.uart.lines[-3:]}")
    mask, where = max(entry for entry in masks if "defmt" not in entry[1])
    yield f"20 lines and {polls} status reports while they moved; {host.waits} times told to wait; longest time masked {us(mask)} ({where})"
    if host.waits:
        raise Failure("a sender that counts had to wait")
    uart, bench.host = bench.host, bench.uart
    bench.ask("G4P0")
    bench.host = uart
    bench.ask("G4P0")
    yield "at rest the UART takes over with a line, and USB again"
    yield from usb_waits_for_answers(bench)


def usb_waits_for_answers(bench):
    """All is done that the UART's host has asked for, and its answer still on the way: a line of USB's host is refused, and no byte goes
    astray."""
    host, uart = bench.host, bench.uart
    bench.host = uart
    bench.ask("G4P0")
    begin = len(uart.text)
    bench.ask("$$")
    listing, lefts = bytes(uart.text[begin:]), (400, 200, 100, 40)
    for left in lefts:
        begin, before = len(uart.text), len(host.answers)
        uart.send("$$\n")
        bench.wait(lambda begin=begin, left=left: len(uart.text) - begin >= len(listing) - left, 2, "most of the listing")
        host.send("G4P0\n")
        bench.wait(lambda before=before: len(host.answers) > before, 0.5, "an answer at USB")
        bench.wait(lambda begin=begin: len(uart.text) - begin >= len(listing), 0.5, "the end of the listing")
        if host.answers[-1] != "error:8" or bytes(uart.text[begin:]) != listing:
            raise Failure(f"{left} bytes before the end: USB was told {host.answers[-1]}, the UART {bytes(uart.text[-100:])!r}")
    bench.host = host
    yield f"a line {max(lefts)} to {min(lefts)} bytes before the end of the other host's listing is refused, and that is whole"


def usb_flood(bench):
    """A host that does not count: it is told to wait, loses nothing, and commands within the promise act at once."""
    board, host = with_usb(bench)
    bench.settings(**JOB_SETTINGS)
    # 255 bytes fill the queue, 128 more wait behind it; a dwell keeps the controller from reading them.
    host.send("G4P0.3\n" + "G4P0\n" * 75)
    board.run(seconds=0.02)
    if len(host.answers) > 10 or host.waits:
        raise Failure(f"{len(host.answers)} answers, {host.waits} waits: this proves nothing")
    begin = board.now
    bench.status()
    yield f"380 bytes of lines under way: `?` answered after {us((board.now - begin) / bench.wiring.core_hz)}"
    bench.wait(lambda: len(host.answers) >= 76 + len(JOB_SETTINGS), 3, "all answers")
    before = len(host.answers)
    bench.forget_masks()
    text = "".join(f"G4P0.00{k % 9 + 1}\n" for k in range(600))
    begin = board.now
    host.send(text)
    masks = []
    while len(host.answers) < before + 600 and board.seconds(board.now) - board.seconds(begin) < 20:
        board.run(seconds=0.005)
        masks.append(bench.longest_mask())
    if any(answer != "ok" for answer in host.answers[before:]) or host.has_said("lost") or host.packets:
        raise Failure(f"answers {set(host.answers[before:])}, {len(host.packets)} packets left")
    mask, where = max(entry for entry in masks if "defmt" not in entry[1])
    yield f"{len(text)} bytes poured in: {host.waits} times told to wait, nothing lost, {(board.now - begin) / bench.wiring.core_hz:.2f} s; longest time masked {us(mask)} ({where})"
    if not host.waits:
        raise Failure("the host was never told to wait: this proves nothing")
    # The port is closed while the host waits: DTR must be heard, and the next one find a free way.
    host.send("G1X3F300\n" + "G4P0.01\n" * 100)
    board.run(seconds=0.3)
    if not host.packets:
        raise Failure("the host does not wait: this proves nothing")
    host.order("close")
    bench.wait(lambda: not host.open, 0.1, "the end of the port")
    host.packets.clear()
    board.run(seconds=0.3)
    host.order("open")
    after = len(host.text)
    bench.wait_text("Grbl 1.1h", 0.2, after)
    if not (status := bench.status()).startswith("<Hold"):
        raise Failure(f"after the port was closed: {status}")
    host.send(b"\x18")
    bench.wait_text("Grbl 1.1h", 0.2, len(host.text))
    bench.ask("$X")
    bench.ask("G4P0")
    yield "closed while it waited: held; opened again, reset, and answered"


def chords(count, chord_mm, feed):
    """A program that moves along a circle of 100 mm in chords."""
    lines = [f"G90G1F{feed:.0f}"]
    for k in range(1, count + 1):
        angle = k * chord_mm / 100
        lines.append(f"X{100 * (math.cos(angle) - 1):.3f}Y{100 * math.sin(angle):.3f}")
    return "\n".join(lines)


BELTS = {"s0": 2, "s29": 0, "s100": 80, "s101": 80, "s110": 60000, "s111": 60000, "s120": 4000, "s121": 4000}
"""A machine for many lines a second, whose motors have few steps to do for each."""


FAST_BAUD = 1_000_000


def restart_at(bench, baud):
    """The board starts anew, with a host at this rate."""
    host = bench.host
    host.baud = baud
    bench.board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    bench.board.run(seconds=0.05)


def baud_rates(bench):
    """$931: another rate from the next start on. A host at the usual rate is heard all the same, and the board comes back to its own."""
    bench.boot()
    board, host = bench.board, bench.host
    bench.ask(f"$931={FAST_BAUD}")
    bench.ask("$I")
    restart_at(bench, FAST_BAUD)
    bench.ask("$I")
    yield f"after a start at {board.usart.baud():.0f} baud"

    def tries_of(text, every=0.3, most=20):
        """How often a host has to say something until it is answered."""
        for tries in range(1, most):
            after = len(host.answers)
            host.send(text + "\n")
            board.run(seconds=every)
            if "ok" in host.answers[after:]:
                return tries
        raise Failure(f"{text!r} was not answered")

    # The last line was heard just now: what is garbled is a disturbance.
    host.baud = 115_200
    host.send("$$\n")
    board.run(seconds=0.1)
    host.baud = FAST_BAUD
    host.send("\n")
    board.run(seconds=0.1)
    bench.ask("$I")
    board.run(seconds=10.1)
    host.baud = 115_200
    yield f"a host at 115200 baud that says $$ is answered at try {tries_of('$$')}"
    # It stays heard, however long it is silent.
    board.run(seconds=10.1)
    bench.ask("G21")
    restart_at(bench, FAST_BAUD)
    host.baud = 115_200
    yield f"one that ends lines and says $I, at try {tries_of(2 * chr(10) + '$I')}"
    restart_at(bench, FAST_BAUD)
    # Disturbances while nobody listens.
    host.baud = 115_200
    host.send(b"$$$$")
    board.run(seconds=1)
    if abs(board.usart.baud() / 115_200 - 1) > 0.01:
        raise Failure("the board does not listen at 115200 baud: this proves nothing")
    host.baud = FAST_BAUD
    # At the usual rate its bits are too short to be noticed.
    tries = tries_of("", every=1)
    yield f"back at {board.usart.baud():.0f} baud after {tries} s"
    bench.ask("$931=115200")
    restart_at(bench, 115_200)
    bench.ask("$I")


def uart_lines(bench):
    """Short lines over the UART at its greatest rate, by character counting: as over USB."""
    bench.boot()
    bench.settings(**BELTS, s931=FAST_BAUD)
    restart_at(bench, FAST_BAUD)
    yield from many_lines(bench, UART_LINES_S[bench.wiring.name])
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")


def usb_lines(bench):
    """Short lines over USB by character counting: up to the rate that is promised a job takes the time of its motion, because the
    look-ahead never runs low. And how many a second there are when the motion would take more."""
    with_usb(bench)
    bench.settings(**BELTS)
    yield from many_lines(bench, LINES_S[bench.wiring.name])


def many_lines(bench, promised):
    board, host = bench.board, bench.host
    # Far more lines than the look-ahead has in advance.
    for rate, count in ((promised, 4000), (4 * promised, 1200)):
        text = chords(count, 0.05, 0.05 * rate * 60)
        with tempfile.TemporaryDirectory() as folder:
            job = Path(folder) / "chords.nc"
            job.write_text(text)
            expected = json.loads(in_simulator(bench, job, BELTS, "--json"))["duration_s"]
        before, scope, begin = len(host.answers), Scope(board), board.now
        host.stream(text)
        bench.wait(lambda: host.all_answered, 60, "the last answer")
        lines = (len(host.answers) - before) / ((board.now - begin) / bench.wiring.core_hz)
        bench.wait_state("Idle", 60)
        if any(answer != "ok" for answer in host.answers[before:]):
            raise Failure(f"answers: {set(host.answers[before:])}")
        rising = [step.at for step in scope.steps()]
        took = (rising[-1] - rising[0]) / bench.wiring.core_hz
        yield f"{rate} lines/s of {len(text) // text.count(chr(10))} bytes asked for: {lines:.0f} lines/s answered; {took:.3f} s of motion, {expected:.3f} s in the simulator"
        if rate == promised and took > 1.002 * expected:
            raise Failure("the machine has waited for lines")
        bench.ask("G90G1X0Y0F9000")
        bench.wait_state("Idle", 60)


def usb_answers(bench):
    """Answers of lines that wait one behind the other share packets, and none is held while the line behind it takes its time."""
    board, host = with_usb(bench)
    bench.settings(**BELTS)
    text = chords(200, 0.05, 6000)
    begin = len(host.lines)
    host.stream(text)
    bench.wait(lambda: host.all_answered, 5, "the last answer")
    answered = [cycle for cycle, line in host.lines[begin:] if line == "ok"]
    packets = len(set(answered))
    if packets > len(answered) / 2:
        raise Failure(f"{len(answered)} answers in {packets} packets")
    bench.wait_state("Idle", 5)
    begin, sent = len(host.lines), board.now
    host.send("G21\n" * 3 + "G4P1\n" + "G21\n")
    board.run(seconds=0.9)
    held = [cycle for cycle, line in host.lines[begin:] if line == "ok"]
    if len(held) != 3:
        raise Failure(f"{len(held)} answers before the end of the dwell and not 3")
    took = board.seconds(held[-1]) - board.seconds(sent)
    yield f"{len(answered)} answers in {packets} packets; three in front of a dwell within {us(took)}"
    if took > 3e-3:
        raise Failure("an answer was held while nothing was to be done")
    bench.wait(lambda: sum(line == "ok" for _, line in host.lines[begin:]) == 5, 1, "the answers behind the dwell")


def usb_unplugged(bench):
    """The cable is pulled in mid-job: a hold, and the UART or the next host takes over."""
    board, host = with_usb(bench)
    bench.settings(**JOB_SETTINGS)
    scope = Scope(board)
    bench.ask("G91 G1 X10 F600")
    board.run(seconds=0.2)
    host.order("unplug")
    board.run(seconds=0.5)
    steps = len(scope.steps())
    board.run(seconds=0.5)
    if len(scope.steps()) != steps or not steps:
        raise Failure("the machine goes on without a host")
    bench.host = bench.uart
    if not (status := bench.status()).startswith("<Hold:0"):
        raise Failure(f"the UART is told {status}")
    bench.host = host
    host.order("plug")
    bench.wait(lambda: host.is_set_up, 1, "the set-up of the USB device")
    host.order("open")
    after = len(host.text)
    bench.wait_text("Grbl 1.1h", 0.2, after)
    host.send(b"~")
    bench.wait_state("Idle", 5)
    if scope.counts() != [2500, 0, 0]:
        raise Failure(f"the motors are at {scope.counts()}")
    yield "held after the cable was pulled, gone on after `~`, no step lost"
    bench.settings(s914=0)
    bench.ask("G91 G1 X-10 F600")
    board.run(seconds=0.2)
    host.order("unplug")
    board.run(seconds=1.5)
    if scope.counts() != [0, 0, 0]:
        raise Failure(f"with $914=0 the motors are at {scope.counts()}")
    yield "with $914=0 the move was finished"


def usb_unread(bench):
    """Packets that wait for room: they keep nobody from running, and go with their host."""
    board, host = with_usb(bench)
    otg, step = board.otg, Scope(board)
    bench.settings(**JOB_SETTINGS)

    def reopen():
        after = len(host.text)
        host.order("open")
        bench.wait_text("Grbl 1.1h", 0.2, after)
        bench.ask("G4P0")
        bench.wait_state("Idle", 1)
        if host.has_said("error", after) or step.steps():
            raise Failure(f"something of the host that went has been read; the next one was told {bytes(host.text[after:])!r}")

    # The queue of commands is full, one more waits, and what stands behind it is not fetched.
    hang(bench)
    host.send(64 * b"?")
    host.send(b"?G1 X5 F100 Y")
    board.run(seconds=0.02)
    host.order("close")
    bench.wait(lambda: not host.open, 0.1, "the end of the port")
    board.run(seconds=0.01)
    unpatch(bench)
    board.run(seconds=0.05)
    reopen()
    yield "closed with half a line unfetched: the next host begins a line of its own"
    # Answers that nobody has fetched: a packet of them is with the endpoint already.
    host.reads = False
    host.send(b"G4P0\n" * 20)
    board.run(seconds=0.1)
    host.order("close")
    bench.wait(lambda: not host.open, 0.1, "the end of the port")
    board.run(seconds=0.01)
    host.reads = True
    after = len(host.text)
    reopen()
    if not host.text[after:].startswith(b"\r\nGrbl"):
        raise Failure(f"the next host got answers to the one before: {bytes(host.text[after:])!r}")
    yield "closed with answers unread: the next host gets none of them"
    # A program that pours a file in is ended: its port is closed first, and what it had under way is called back later.
    bench.settings(s914=0)
    host.send("G4P0.01\n" * 400 + "G1 X5 F100\n" * 20)
    board.run(seconds=0.3)
    if not host.packets:
        raise Failure("the host does not wait: this proves nothing")
    host.order("close")
    bench.wait(lambda: not host.open, 0.1, "the end of the port")
    board.run(seconds=0.15)
    host.packets.clear()
    board.run(seconds=3)
    reopen()
    yield "closed while it waited: what was still under way is thrown away, and the next host is greeted"
    # Twice the driver has enabled the endpoint before the end of a packet was seen: one packet is with the driver, and one
    # stays in the FIFO and keeps the interrupt pending.
    hang(bench)
    host.send(64 * b"?")
    host.send(b"?")
    board.run(seconds=0.02)
    before = len(host.answers)
    for _ in range(2):
        otg.control[OUT, 1] = otg.control[OUT, 1] & ~NAKSTS | EPENA
        if not otg.out(1, b"G4P0\n"):
            raise Failure("the endpoint takes no packet: this proves nothing")
        board.run(seconds=0.01)
    unpatch(bench)
    bench.wait(lambda: len(host.answers) >= before + 2 or board.resets, 3, "an answer to what waited")
    if board.resets or host.answers[before:] != ["ok", "ok"]:
        raise Failure(f"{host.answers[before:]}, resets {board.resets}")
    bench.ask("G4P0")
    yield "a packet in the FIFO that nobody can fetch: the other tasks go on, and it is read when there is room"


def usb_set_up_again(bench):
    """A host that sets the device up again, or clears halts, begins with DATA0: no packet is lost, and none waits for ever."""
    board, host = with_usb(bench)

    def asks(count):
        for _ in range(count):
            bench.ask("G4P0")
            board.run(seconds=0.005)

    for order in ("configure", "clear halts"):
        for count in (1, 2, 1):
            host.order(order)
            board.run(seconds=0.005)
            asks(count)
        yield f"{order}: each packet has come, both ways"
    # The endpoint waits for room when the configuration is taken back.
    hang(bench)
    host.send(64 * b"?")
    host.send(b"?G4P0\n")
    host.send(b"G4P0\n")
    board.run(seconds=0.02)
    if not host.packets:
        raise Failure("the host does not wait: this proves nothing")
    host.order("unconfigure")
    host.order("configure")
    board.run(seconds=0.01)
    unpatch(bench)
    bench.wait(lambda: host.is_set_up and not host.packets, 0.5, "room for what waits")
    host.order("close")
    host.order("open")
    board.run(seconds=0.5)
    asks(2)
    yield "configuration taken back while the host waited: it goes on"


KNOWN = {}
"""Faults of the firmware that are known, by board and case: shown, and no failure."""


class LeftOut(Exception):
    """The board does not have it, by its row in parts.py; not a failure and not a pass."""


def all_cases(root):
    jobs = root / "tests" / "jobs"
    return [
        ("boot", boot),
        ("waiting line", waiting_line),
        ("stream axes.nc", lambda bench: streamed(bench, jobs / "axes.nc")),
        ("stream lines.nc", lambda bench: streamed(bench, jobs / "lines.nc")),
        ("stream splines.nc", lambda bench: streamed(bench, jobs / "splines.nc")),
        ("pulses", pulses),
        ("safe rate", safe_rate),
        ("safe rate, disturbed", disturbed),
        ("safe rate, fast UART", fast_flood),
        ("tight pulses", tight),
        ("hard start", hard_start),
        ("laser start", laser_start),
        ("raster", raster),
        ("turns", turns),
        ("called at turns", called_at_turns),
        ("hold", hold),
        ("stops", stops),
        ("stops on the ring", ring_stops),
        ("masked for long", masked_long),
        ("late segments", late_segments),
        ("late starts", late_starts),
        ("miscounts", miscounts),
        ("trips", trips),
        ("emergency stop", emergency_stop),
        ("lines at stops", lines_at_stops),
        ("switch noise", noise),
        ("probe", probe),
        ("flood of realtime commands", flood),
        ("bursts of overrides", override_bursts),
        ("second motor", second_motor),
        ("fourth axis", fourth_axis),
        ("spindle PWM", spindle_pwm),
        ("outputs of programs", program_outputs),
        ("inputs of programs", program_inputs),
        ("baud rates", baud_rates),
        ("uart lines", uart_lines),
        ("settings write", settings_write),
        ("power cut", power_cut),
        ("fault", faulted),
        ("stack overflow", overflowed),
        ("failure in a failure", failed_twice),
        ("hung control task", hung),
        ("unserved tasks", unserved),
        ("recorded failure", recorded),
        ("masked for ever", deaf),
        ("lost clock", lost_clock),
        ("boot loader left", left_loader),
        ("brown-out", brown_out),
        ("brown-out of a beam", brown_out_of_a_beam),
        ("low supply at power-up", low_at_power_up),
        ("inverted outputs", inverted_outputs),
        ("usb", usb_port),
        ("usb flood", usb_flood),
        ("usb lines", usb_lines),
        ("usb answers", usb_answers),
        ("usb unplugged", usb_unplugged),
        ("usb unread", usb_unread),
        ("usb set up again", usb_set_up_again),
    ]
