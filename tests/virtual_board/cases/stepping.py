"""Pulses, periods and directions of the step outputs at all rates, also when the step task or its data are late."""

from itertools import pairwise
from random import Random

from ..board import Failure
from ..models import timer
from ..models.timer import EGR
from ..parts import MHZ
from ..scope import Scope, steady
from .bench import (
    JITTER_S,
    LATEST_PULSE_END_S,
    RUN_CYCLES,
    US,
    fast,
    hard,
    joins_for,
    moving,
    stand_once,
    step_clock,
    step_load,
    us,
    with_usb,
)
from .patching import hang, unpatch


LONGEST_RUN = (RUN_CYCLES, 5200)
"""Maximum cycles of a run of the step task, on boards with three and with four axes (`run_cycles` in profiles.rs)."""


def pulses(bench):
    """Checks pulse width, direction set-up and period at 1, 10, 50 and 100 kHz (or the safe rate), all three axes
    together. The last rate, 3 kHz, has the longest pulse, 255 us. At 3 kHz some ticks (events of the step timer) have
    no step, so this pulse outlasts the time between two ticks."""
    yield from at_rates(bench, (1_000, 60, 10), (10_000, 400, 10), (50_000, 2500, 10), (100_000, 5000, 2), (3_000, 180, 255))


def safe_rate(bench):
    """Checks pulses and periods with the shortest pulse at the board's safe rate: with equal rates of all axes, and
    with three rates of which none divides another."""
    safe, pulse_us = bench.wiring.safe_step_hz, bench.wiring.least_pulse_us
    acceleration = hard(bench, 6_000)
    steps = round((1.1 * safe**2 / acceleration / 1000 + 2000) / 9) * 9
    for ways in ((1, 1, 1), (9, 7, 5)):
        yield from at_rates(bench, (safe, steps, pulse_us), acceleration=acceleration, ways=ways)


def disturbed(bench):
    """Moves at the safe rate while interrupts are masked for 20 us at random times and a host floods the link (USB, if
    the board has it): no period may be off."""
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


def flooded_at_safe_rate(bench, meanwhile):
    """Runs at the safe rate under a flood of lines and status requests. Returns the number of lines."""
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
    """Checks longer pulses. For each pulse length, moves at the maximum rate that the settings allow with it."""
    for pulse_us in (0.6, 0.9, 1.1, 2, 2.5, 3, 4, 5, 6, 7, 9, 10):
        if pulse_us < bench.wiring.least_pulse_us:
            continue
        rate = round(bench.wiring.greatest_hz(pulse_us))
        acceleration = max(3_000, round(rate / 100 * 3))
        yield from at_rates(bench, (rate, round(1.1 * rate**2 / acceleration / 1000) + 1000, pulse_us), acceleration=acceleration)


def at_rates(bench, *rates, acceleration=3_000, ways=(1, 1, 1), meanwhile=None, boots=True):
    """Moves back and forth at each of `rates` (steps/s, steps one way, `$0`); `ways` are the relative distances of the
    axes. Checks widths, set-up, hold and periods."""
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
        # Keep only events with a step of X, the fastest axis; at low rates, other axes also step between these events.
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
        busy, run = step_load(board, events[ramp].at, events[steps - ramp].at)
        yield f"{line}; period error {us(found['period_error'])}, drift over {found['steps']} steps {us(found['drift'])}, masked {us(mask)} ({where}); step task {busy:.0%}, longest run {run} cycles"
        # A pulse below 1 us is followed by a pause of about the same length, so the tolerance for its end is smaller.
        latest = LATEST_PULSE_END_S if pulse_us >= 1 else JITTER_S
        if least < pulse_us * US or most > pulse_us * US + latest:
            raise Failure(f"pulse width {us(least)} to {us(most)} with $0={pulse_us}")
        if min(setups) < 10 * US:
            raise Failure(f"direction set-up {us(min(setups))} with $29=10")
        if min(holds) < pulse_us * US:
            raise Failure(f"a direction changes {us(min(holds))} after the edge of a step, within its pulse")
        if run > LONGEST_RUN[bench.wiring.core_hz > 100 * MHZ]:
            raise Failure(f"a run of the step task of {run} cycles")
        if found["drift"] > 2 * US:
            raise Failure(f"the period drifts by {us(found['drift'])} over {found['steps']} steps")
        if found["period_error"] > JITTER_S:
            raise Failure(f"a period is off by {us(found['period_error'])}, whatever is masked it may be {us(JITTER_S)}")
        bench.ask("G90")


def hard_start(bench):
    """Starts from rest with 10 m/s², several times: the step task must not run out of segments."""
    bench.boot()
    fast(bench, 10_000)
    rate = min(6006, int(bench.wiring.greatest_hz(5)) * 60 // 1000)
    bench.settings(s0=2, s110=rate, s111=rate, s112=rate)
    bench.settings(s0=5)
    for attempt in range(8):
        bench.board.run(seconds=attempt * 7e-6)
        way = f"{'-' if attempt % 2 else ''}4"
        # Request a report as soon as the line is answered, as a sender does. At that time the first segments are
        # output.
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


def turns(bench):
    """Directions change at speed: a zigzag whose corners are passed without stopping, also with direction set-up times
    so long that they delay ticks (step events). All later ticks must be delayed by the same amount, so that no step
    follows the previous one sooner than planned."""
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
        if min(widths) < pulse_us * US or fastest < (pulse_us + min(pulse_us, 2.5)) * US:
            raise Failure("a pulse or the pause after it is too short")
        if fastest > 20 * US:
            raise Failure("the corners were not passed at speed: this proves nothing")
        # Y and Z move a quarter of the distance of X, so the path is sqrt(1 + 2/16) times as long as the move of X. A
        # step is 0.001 mm.
        planned = 60 / 4600 / 1000 * (1 + 2 / 16) ** 0.5
        if fastest < planned - JITTER_S:
            raise Failure(f"a step comes {us(fastest)} after the one before, {us(planned)} are planned")


def turns_at_full_rate(bench):
    """Directions change at the maximum rate, with interrupts masked for 20 us at random times. A run of the step task
    that begins a segment and changes a direction generates few events. Even after such a run, enough events must be
    queued that the next run may be late by the length of one mask."""
    bench.boot()
    board, hz, random = bench.board, bench.wiring.core_hz, Random(25)
    rate = at_full_rate(bench)
    bench.settings(s29=0, s11=50)
    clock, rests = step_clock(board), []
    write = clock.write

    def call(offset, value):
        write(offset, value)
        # A run of the step task that has generated events ends by writing CCR2.
        if offset == timer.CCR2 and is_at_speed:
            rests.append(joins_for(board))

    clock.write, is_at_speed = call, False
    for way in (1.13, 0.57, 1.9):
        lines = round(80 / way)
        scope, after = Scope(board), len(bench.host.text)
        zigzag = "\n".join(f"X{way} Y{'-' if k % 2 else ''}.05" for k in range(lines))
        # The first move is slow, so that all lines have arrived before the fast moves begin.
        bench.host.stream(f"G91 G1 F60 X.2\nF{rate}\n{zigzag}\n")
        bench.wait(lambda scope=scope: len(board.edges) - scope.first > 2 * 26_000, 1, "the rate")
        is_at_speed = True
        while len(board.edges) - scope.first < 2 * (round(1000 * way) * lines - 26_000):
            board.run(seconds=random.uniform(30, 200) * US)
            board.mask(20 * US)
            if bench.host.has_said("ALARM", after):
                board.run(seconds=0.001)
                raise Failure(f"lines of {way} mm: {bytes(bench.host.text[after:])[-60:]!r}; events for {us(min(rests) / hz)} were left")
        is_at_speed = False
        bench.wait(lambda: bench.host.all_answered, 5, "the last answer")
        bench.wait_state("Idle", 5)
        if scope.counts() != [200 + round(1000 * way) * lines, 50 * (lines % 2), 0]:
            raise Failure(f"lines of {way} mm: the motors are at {scope.counts()}")
    edge = RUN_CYCLES + RUN_CYCLES / 4
    yield (
        f"turns at {bench.wiring.safe_step_hz} steps/s, masked at random: {len(rests)} runs leave events for {us(min(rests) / hz)} or more, "
        f"{us(edge / hz)} are needed"
    )
    if min(rests) < edge + 20 * US * hz:
        raise Failure("too few events are ahead behind a turn for interrupts to be masked then")


def zigzag(bench):
    """X moves at the maximum rate, and Y and Z turn after each mm of X, while interrupts are masked for 20 us at random
    times. Y and Z turn at speed: their last step before a turn and their first step after it can be close together."""
    pulse_us = bench.wiring.least_pulse_us
    for setup_us, way in ((10, 0.2), (0, 0.02), (10, 0.02)):
        bench.boot()
        board, hz, random, lines = bench.board, bench.wiring.core_hz, Random(7), 12
        rate = at_full_rate(bench)
        bench.settings(s111=rate, s112=rate)
        bench.settings(s29=setup_us, s11=5)
        # The first and the last move are of X alone: X accelerates and brakes there.
        lead = 2 + round((rate / 60) ** 2 / 2 / hard(bench, 10_000))
        scope = Scope(board)
        turning = "".join(f"X1 Y{'-' * (k % 2)}{way} Z{'-' * (1 - k % 2)}{way}\n" for k in range(lines))
        bench.host.stream(f"G91 G1 F{rate * (1 + 2 * way * way) ** 0.5:.0f} X{lead}\n{turning}X{lead}\n")
        while not (bench.host.all_answered and bench.status().startswith("<Idle")):
            for _ in range(20):
                board.run(seconds=random.uniform(60, 400) * US)
                board.mask(20 * US)
            if bench.host.has_said("ALARM"):
                raise Failure(f"turns of {way} mm: {bytes(bench.host.text)[-60:]!r}")
        events, widths, setups, holds = scope.read()
        rising = [event.at for event in events if event.axes & 1]
        periods = [(b - a) / hz for a, b in pairwise(rising)]
        at_speed = sum(period < 1.02 * 60 / rate / 1000 for period in periods)
        yield (
            f"Y and Z turn by {way} mm: {len(setups)} changes of direction, set-up from {us(min(setups))} with $29={setup_us}, hold from {us(min(holds))}; "
            f"pulses {us(min(widths))} to {us(max(widths))}; {at_speed} of {len(periods)} periods of X at {rate / 60:.0f} mm/s"
        )
        if scope.counts() != [2000 * lead + 1000 * lines, 0, 0]:
            raise Failure(f"the motors are at {scope.counts()}")
        if min(setups) < setup_us * US or min(holds) < pulse_us * US or min(widths) < pulse_us * US:
            raise Failure("a direction output changes too late, or within a pulse, or a pulse is too short")
        if len(setups) < 2 * lines - 2 or way > 0.1 and at_speed < len(periods) / 4:
            raise Failure("few changes of direction at speed: this proves little")


def called_at_turns(bench):
    """Calls the step task right before ticks (step events), as other tasks may do, in a zigzag that turns at every
    corner: no direction may change within a pulse."""
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
        clock = board.peripherals["TIM5"]
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


def at_full_rate(bench, acceleration=10_000):
    """Sets the board's safe rate for X, with the shortest pulse: 490 mm/s or more, reached after 49 ms at 10,000 mm/s².
    Returns the rate in mm/min."""
    safe = bench.wiring.safe_step_hz
    fast(bench, hard(bench, acceleration))
    rate = safe * 60 // 1000
    # Set the pulse first, because with a longer pulse the rate would be rejected.
    bench.settings(s0=bench.wiring.least_pulse_us)
    bench.settings(s110=rate)
    return rate


def masked_long(bench):
    """Interrupts are masked for longer than the queued events last: slow moves must continue later, with no step lost
    and no step too soon. At rates at which a motor could not continue at speed after the pause, the machine must stop
    and report it."""
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
    """The control task hangs until the step task has used up all segments and only events are queued. A segment that
    arrives now must be received at once, and not only when the last of these events are output. So interrupts that are
    masked after its arrival must not delay a step."""

    def late(released_s=None):
        """Without `released_s`, returns the time of the last step, in cycles. With it, lets the control task continue
        `released_s` before the time of that step, and returns the longest time between two steps, in s."""
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


def late_starts(bench):
    """Interrupts are masked right before a motion begins. The motion may begin later, but must be complete, and there
    must be no alarm."""
    bench.boot()
    board = bench.board
    fast(bench, 10_000)

    tim5, hz = board.peripherals["TIM5"], bench.wiring.core_hz

    def start(before_s=None, masked_s=0.0, stands_until=None):
        """Starts a move. Returns the time from the planned first event to the first step, in s."""
        # Wait until the firmware has done its work at rest.
        board.run(seconds=0.002)
        scope, after = Scope(board), len(bench.host.text)
        bench.host.send("G91 G1 X0.02 F3000\n")

        def away():
            return (tim5.values[timer.CCR2] - tim5.count() & 0xFFFF_FFFF) * tim5.cycles / hz

        # The first event comes 2 ms after the first segment. The step task schedules its next call for 450 us before
        # that event.
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
    # Each time, interrupts are masked from a moment before the step task is called, or from a moment while the task
    # generates the first events. The mask ends near the planned time of the first event, or just after the usual time
    # of the first step.
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
    """The timer of the pulses misses a trigger, DMA serves one request too many, or a DMA stream reports an error, each at
    a slow rate and at the maximum rate: the motion must end soon, with ALARM:103."""

    def miss(pulses):
        trigger = pulses.trigger

        def once(at):
            pulses.trigger = trigger

        pulses.trigger = once

    pulses, stream = bench.wiring.pulse_timer, bench.wiring.pulse_stream
    faults = {
        "a trigger is missed": lambda board: miss(board.peripherals[pulses]),
        "a request too many": lambda board: board.dma[1].ask(f"{pulses}_CH1", board.now + 1),
        "a stream's error": lambda board: board.dma[1].values.__setitem__(0, board.dma[1].values[0] | {1: 1 << 9, 2: 1 << 19}[stream]),
        "an error of the moments": lambda board: board.dma[0].values.__setitem__(0, board.dma[0].values[0] | 1 << 19),
    }
    for what, inject in faults.items():
        for pace in ("slow", "full"):
            bench.boot()
            board, hz = bench.board, bench.wiring.core_hz
            if pace == "full":
                bench.ask(f"G91 G1 X200 F{at_full_rate(bench)}")
                board.run(seconds=0.08)
            else:
                moving(bench)
            scope, after = Scope(board), len(bench.host.text)
            board.run(seconds=0.001)
            begin, before = board.now, len(scope.steps())
            inject(board)
            bench.wait_text("ALARM:103", 0.1, after)
            late = max([0] + [(step.at - begin) / hz for step in scope.steps()])
            bench.at_rest(0.005)
            if not bench.status().startswith("<Alarm"):
                raise Failure(f"{what}: {bench.status()}")
            yield f"{what}, {pace}: ALARM:103, steps for another {us(late)}"
            if late > 2e-3:
                raise Failure(f"{what}: steps for another {us(late)}")
            if pace == "full" and before < 0.98e-3 * bench.wiring.safe_step_hz:
                raise Failure("not at the greatest rate: this proves little")
