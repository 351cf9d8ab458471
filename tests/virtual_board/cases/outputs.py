"""Second motor, fourth axis, spindle, outputs and inputs for programs, inverted levels."""

from ..board import Failure
from ..scope import Scope, steady
from .bench import JITTER_S, US, duty, error_of, fast, hard, moving, step_load, us
from .failures import tell


def inverted_outputs(bench):
    """`$2` and `$4`: step pins must be high at rest and the enable output high while the drivers are on, also after a
    failure."""
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
    """The second motor of an axis (`$905`) must step with that axis and no other, support inversion, and be squared by
    its own switch."""
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
    # Positions, in steps, at which the switches of the first and the second motor close.
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
    """Tests a rotary axis (`$930=4`) on the pins of the second motor: its steps, its polarities, homing at its own
    switch, and the safe rate on all four axes. A board without it must lock motion."""
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
    """Moves all four axes back and forth at the safe rate: no period may be off."""
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
    # F is the speed along X, Y and Z together, without A.
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
    """Checks frequency and duty cycle of the spindle's PWM, at low frequencies (for an opto-coupler) and at high ones
    (for a laser), also if the frequency changes while the spindle turns."""
    bench.boot()
    bench.settings(s30=1000)
    pwm = bench.board.peripherals[bench.wiring.pwm_timer]
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
"""Maximum time from the first step of a motion to the output that changes with it (M62, M63): the controller checks
every millisecond, but can be busy at that time."""


def program_outputs(bench):
    """M64 and M65 must act at once, M62 and M63 when the motion after them begins; a reset and an alarm must switch the
    outputs off. A board without outputs must refuse these commands."""
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
    # The change may precede the first step, because a block begins one interval before its first step. If the path
    # does not stop before the block, this interval is one step period.
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
    """M66 must read an input, or wait for it in each of its modes, with a time limit."""
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
    # Index of the input, mode, state of the input before, and the state that the mode waits for.
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
