"""The laser's power, compared with the steps at which it should change."""

from random import Random

from ..board import Failure
from ..models import timer
from ..scope import Scope
from .bench import BEAM_STOP_S, RUN_CYCLES, TRIP_S, US, byte_stop_s, duty, fast, stand_once, step_clock, us
from .failures import tell
from .stops import StopWatch

BEHIND_CYCLES = 400
"""Maximum number of cycles from the end of the step output at a stop until the laser is off. The firmware needs this
time because it first waits for a change of power that is about to happen."""


def laser_start(bench):
    """Moves start with such a high acceleration that many segments begin before the first step. Each segment has its
    own power (M4). All steps must be output, without an alarm."""
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
"""Maximum time between the edge of the step that begins a segment and the change to its power, if DMA writes the power."""


def beam_s(bench, masked_s=0.0):
    """Returns the maximum time, s, from the edge of the step that begins a segment to the change to its power. TIM1 is
    out of reach for DMA1: there the step task writes the power, which can take one more run of the task and a time
    `masked_s` (s) with interrupts masked."""
    return BEAM_S if bench.wiring.pwm_timer == "TIM3" else RUN_CYCLES / bench.wiring.core_hz + 2 * US + masked_s


class BeamWatch:
    """Records the changes of the PWM's compare register, by the program or by DMA."""

    def __init__(self, board):
        self.board, self.pwm = board, board.peripherals[board.wiring.pwm_timer]
        self.changes = []
        """(core cycle, new duty cycle from 0 to 1) for each change."""
        self.compare = timer.COMPARE[board.wiring.pwm_channel - 1]
        self.last = self.pwm.values[self.compare]
        by_program, by_dma = self.pwm.write, self.pwm.store_by_dma

        def write(offset, value):
            by_program(offset, value)
            self.note(board.now)

        def store(offset, value, at):
            by_dma(offset, value, at)
            self.note(at)

        self.pwm.write, self.pwm.store_by_dma = write, store

    def note(self, at):
        value = self.pwm.values[self.compare]
        if value != self.last:
            self.last = value
            self.changes.append((at, value / (self.pwm.values[timer.ARR] + 1)))


def raster(bench):
    """A laser draws rows of 20 pixels/mm at 12 m/min, each pixel with a different power. The power must change at the
    edge of the step that begins the pixel, even if interrupts are masked at random times. After a stop at any time, the
    laser must be off."""
    bench.boot()
    fast(bench, 10_000)
    bench.settings(s100=80, s110=12_000, s30=1000, s31=0, s32=1)
    yield from raster_rows(bench, "M3", 1, 0.0)
    yield from raster_rows(bench, "M4", 1, 20 * US)
    yield from raster_starts(bench)
    yield from raster_stops(bench)
    yield from raster_stops_at_full_rate(bench)


def raster_rows(bench, mode, rows, masked_s):
    """Draws rows. At each end of a row is a section without power, long enough for reaching the speed and for receiving
    the pixels."""
    board, hz, random = bench.board, bench.wiring.core_hz, Random(12)
    scope, beam, pixels, masks = Scope(board), BeamWatch(board), 70, 0
    begins = []
    """For each pixel, the index of the step with which it begins, and its power as a share of full power."""
    for row in range(rows):
        shares = [0]
        while len(shares) <= pixels:
            share = random.choice((0, 1000, random.randrange(50, 950)))
            if share != shares[-1] and (share or 1 < len(shares) < pixels):
                shares.append(share)
        # A pixel begins with the step that brings the tool to its edge.
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
    allowed = beam_s(bench, masked_s)
    exact = sum(-BEAM_S <= by <= allowed for by in late)
    yield (
        f"{mode}, pixels of {us(pixel)}, masked {masks} times for {us(masked_s)}: {exact} of {len(late)} changes of power at their step, "
        f"{us(min(late))} to {us(max(late))} from its edge"
    )
    if exact < len(late) * (0.97 if masked_s else 1) or min(late) < -BEAM_S or max(late) > max(pixel / 4, allowed):
        raise Failure("power does not change with its step")


def raster_starts(bench):
    """Interrupts are masked when a motion is about to begin; the mask ends shortly before or after the planned time of
    its first step. The motion may be delayed, but each step must have the same power as without the mask."""
    bench.settings(s110=6_000)
    bench.settings(s100=1280)
    board, hz = bench.board, bench.wiring.core_hz
    clock, beam = board.peripherals["TIM5"], BeamWatch(board)

    def away():
        return (clock.values[timer.CCR2] - clock.count() & 0xFFFF_FFFF) * clock.cycles / hz

    def start(until_s=None):
        """Starts a move. Returns the time from the planned start of the first segment to the first step, the time from
        that step to the first change of power (both in s), and the power right after each step."""
        board.run(seconds=0.002)
        scope, known = Scope(board), len(beam.changes)
        bench.host.send("G91G1X.1F6000M4S1000\n")
        # The step task schedules its next call for 450 us before the first event.
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
            while changes[0][0] < at + beam_s(bench) * hz:
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
    """Sends 0x18 so that the laser goes off just before, at and just after a scheduled change of power. Also tests
    emergency stops."""
    bench.settings(s100=80, s30=10, s912=1)
    board, hz, random = bench.board, bench.wiring.core_hz, Random(18)
    clock, beam, worst, near, takes = board.peripherals["TIM5"], BeamWatch(board), {}, [], None
    watch, behind = StopWatch(board), 0
    # The row is short enough that the host has sent all of it before the tool reaches the first pixel.
    row = "M3S0\nX.6\n" + "".join(f"X.05S{2 + 6 * (k % 2)}\n" for k in range(10)) + "X9S7\n"

    def are_near():
        return any(-250 < cycles < 0 for cycles in near) and any(0 < cycles < 250 for cycles in near)

    for k in range(100):
        if k >= 15 and are_near():
            break
        what = "emergency stop" if k % 5 == 4 else "0x18"
        bench.ask("$X")
        # With a single feed, all changes of power might coincide with a run of the step task, and every stop would come
        # at the end of such a run.
        feed = 6000 if k < 15 else random.randrange(4000, 6000)
        bench.host.send(f"G91G1F{feed}" + row)
        goal = len(beam.changes) + 2 + k % 4

        def away():
            return (clock.values[timer.CCR3] - clock.count() & 0xFFFF_FFFF) * clock.cycles

        def is_due(goal=goal):
            return beam.last and len(beam.changes) >= goal and 150 * US < away() / hz < 450 * US and bench.host.free_at < board.now

        bench.wait(is_due, 0.1, "a change of power that is due")
        moment = board.now + away()
        if what == "0x18":
            # `lead`: cycles from the moment at which the board notices the byte to the change of power. `takes`:
            # cycles from that moment until the laser is off, in the fastest of the stops so far. The first three stops
            # only measure `takes`. The byte is read 9.5 bits after its start. With DMA, the board notices it only at
            # the next sample of the inputs. A run of the step task can delay the stop.
            lead = 40 * US * hz if k < 3 else takes + 240 - 30 * k if k < 15 else takes + random.uniform(-300, 3000)
            seen = heard = round(moment - lead)
            if bench.wiring.uart_irq is None:
                bench.sample_at(seen)
                heard -= round(random.uniform(2, 40) * US * hz)
            heard = bench.host.send(b"\x18", at=heard - 9.5 / 115_200 * hz)
        else:
            board.run(seconds=random.uniform(0, 400) * US)
            heard = board.now
            board.drive(bench.wiring.reset, 0)
        board.run(seconds=0.002)
        after = [(at, share) for at, share in beam.changes if at > heard]
        off = next((at for at, share in after if share == 0), None)
        if off is None or after[-1][0] > off:
            raise Failure(f"{what} {k + 1}: after it power is {after}")
        # With a PWM of TIM3, DMA may still write a power that was requested before the stop. With a PWM of TIM1, the
        # program writes the power, and after the stop it must write no power other than 0.
        if bench.wiring.pwm_timer == "TIM1" and any(share and at > watch.halted_at for at, share in after):
            raise Failure(f"{what} {k + 1}: power after the last edge: {after}")
        if what == "0x18":
            takes = min(takes or off - seen, off - seen)
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
    if not are_near():
        raise Failure("no stop came right before a change, or right behind one: this proves nothing")
    if worst["0x18"] > BEAM_STOP_S.get(bench.wiring.name, byte_stop_s(bench)) or worst["emergency stop"] > TRIP_S + RUN_CYCLES / hz:
        raise Failure("the beam is off too late")
    if behind > BEHIND_CYCLES:
        raise Failure("the beam burns where the tool is about to stand while undone events are counted")


def raster_stops_at_full_rate(bench):
    """Sends 0x18 at the board's maximum step rate, timed so that the stop comes just before a change of power: the
    firmware's event counters must agree, as at any other stop."""
    board, hz, random, beam = bench.board, bench.wiring.core_hz, Random(103), BeamWatch(bench.board)
    bench.ask("$X")
    # Set the pulse first, because with a longer pulse the rate would be rejected.
    bench.settings(s0=bench.wiring.least_pulse_us, s110=6000)
    bench.settings(s100=bench.wiring.safe_step_hz // 100)
    clock, pulses, obeyed = step_clock(board), board.peripherals[bench.wiring.pulse_timer], []
    watch, behind = StopWatch(board), 0
    to_pulses = pulses.write

    def away():
        """Returns the ticks of the step clock from now to the next change of power; negative if the change is past."""
        ticks = clock.values[timer.CCR3] - clock.count() & 0xFFFF_FFFF
        return ticks - (ticks >> 31 << 32)

    def halt(offset, value):
        ahead = away() - wanted
        if offset == timer.SMCR and pulses.values[offset] & 7 and not value & 7 and 0 <= ahead * clock.cycles / hz < 40 * US:
            board.stand(ahead * clock.cycles / hz)
            obeyed.append(away())
        to_pulses(offset, value)

    pulses.write = halt
    row = "M3S0\nX2\n" + "".join(f"X.05S{2 + 6 * (k % 2)}\n" for k in range(10)) + "X9S7\n"
    stops = 0
    while len(obeyed) < 16 and stops < 150:
        wanted = 96 - 6 * len(obeyed)
        bench.ask("$X")
        bench.host.send("G91G1F6000" + row)
        # All lines arrive before the tool reaches the first pixel.
        bench.wait(lambda: bench.host.free_at < board.now, 0.1, "the lines")
        goal = len(beam.changes) + 2 + stops % 4
        stops += 1
        bench.wait(lambda goal=goal: len(beam.changes) >= goal, 0.1, "a change of power")
        after = len(bench.host.text)
        # The time from a byte to its stop varies, because a byte that DMA has received is found only at the next sample
        # of the inputs. So the test varies the lead, the time by which the byte precedes the change of power.
        lead_s = random.uniform(5, 110) * US
        # A pixel lasts 500 us.
        heard = bench.host.send(b"\x18", at=beam.changes[-1][0] + (500 * US - 9.5 / 115_200 - lead_s) * hz)
        bench.wait_text("Grbl 1.1h", 0.1, after)
        board.run(seconds=0.001)
        said, changes = bytes(bench.host.text[after:]), [(at, share) for at, share in beam.changes if at > heard]
        if b"ALARM:103" in said:
            raise Failure(f"stop {stops}, obeyed {obeyed[-1:]} ticks before a change of power: {said!r}")
        off = next((at for at, share in changes if share == 0), None)
        if off is None or changes[-1][0] > off:
            raise Failure(f"stop {stops}: after it power is {changes}")
        behind = max(behind, off - watch.halted_at)
    yield (
        f"{stops} stops at {bench.wiring.safe_step_hz} steps/s, {len(obeyed)} of them {max(obeyed)} to {min(obeyed)} ticks before a change of power: "
        f"no miscount; off at most {us(behind / hz)} after the last edge that was let out"
    )
    if len(obeyed) < 16:
        raise Failure("too few stops came where they were to: this proves little")
    if behind > BEHIND_CYCLES:
        raise Failure("the beam burns where the tool is about to stand while undone events are counted")


def brown_out_of_a_beam(bench):
    """The supply falls during a raster, and the next change of power is due while the firmware makes the outputs safe.
    After that there must be no power and no pulse."""
    bench.boot()
    board, hz = bench.board, bench.wiring.core_hz
    fast(bench, 10_000)
    bench.settings(s100=80, s110=12_000, s30=10, s31=0, s32=1)
    clock, pwm, beam = board.peripherals["TIM5"], board.peripherals[board.wiring.pwm_timer], BeamWatch(board)
    bench.host.send("G91G1F6000M3S0\nX.6\n" + "".join(f"X.05S{2 + 6 * (k % 2)}\n" for k in range(10)) + "X9S7\n")

    def away_s():
        return (clock.values[timer.CCR3] - clock.count() & 0xFFFF_FFFF) * clock.cycles / hz

    bench.wait(lambda: beam.last and len(beam.changes) > 2 and 150 * US < away_s() < 450 * US, 0.1, "a change of power that is due")
    write, made_safe = pwm.write, []

    def and_stand(offset, value):
        write(offset, value)
        if offset == beam.compare and value == 0 and not made_safe:
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
