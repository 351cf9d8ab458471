"""Limit switches, emergency stop, noise and the probe."""

from ..board import Failure
from ..scope import Scope
from .bench import TRIP_S, US, all_on, error_of, fast, moving, us, us_off
from .patching import hang


def trips(bench):
    """Limit switch, emergency stop (`$912`), reset button and driver fault must end the pulses even while the control
    task hangs."""
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
            # The queued motion lasts longer than these 6 ms. So if nothing stopped the pulses, the test would see them
            # until the end of the 6 ms.
            board.run(seconds=0.006)
            rising = [step.at for step in scope.steps()]
            worst = max(worst, (rising[-1] - begin) / wiring.core_hz)
        if worst > TRIP_S:
            raise Failure(f"{what}: pulses for another {us(worst)}, allowed {us(TRIP_S)}")
        yield f"{what}: pulses end at most {us(worst)} after its contact, allowed {us(TRIP_S)}; the control task stood still"


def emergency_stop(bench):
    """Emergency stop in full motion: everything must go off except the drivers. The stop must be latched and reported
    with position and line, and `$X` must then report that the position may be lost."""
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


def noise(bench):
    """Glitches at a limit pin that are shorter than the filter: nothing may stop, and each must be counted. Also checks
    the pull resistors."""
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
        # The pause between two glitches is at least 110 us, because a run of the step task can delay a sample of the
        # inputs. A shorter pause could fall between two samples.
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
    """The reported position of a contact must be that of the step at which it occurs, and braking must begin there."""
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
        # The probe's pin is read after each step, so the latched position is that of the last step before the contact
        # or of the first step after it.
        if not 0 <= at_contact - latched <= 1 or not report.endswith(":1]"):
            raise Failure(f"F{feed}: contact after step {at_contact}, latched {latched}: {report}")
        # The ramp is computed in single precision, so it can be longer by one or two steps in 5000 (at 84 MHz).
        if not 0 <= overshoot <= 1.0005 * bound + 1:
            raise Failure(f"F{feed}: {overshoot} steps beyond the contact, v²/2a + 1 = {bound:.0f}")
        worst = max(worst, at_contact - latched)
        bench.wait_state("Idle", 1)
        yield f"F{feed}: latched at step {latched} (contact after {at_contact}), then {overshoot} steps, v²/2a + 1 = {bound:.0f}"


def scope_of_z(bench):
    """Returns the reported position of Z in steps."""
    return round(float(bench.status().split("MPos:")[1].split("|")[0].split(",")[2]) * 1000)
