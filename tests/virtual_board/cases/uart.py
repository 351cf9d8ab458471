"""The UART: its rate, and how many lines a second it carries."""

from itertools import pairwise
from random import Random

from ..board import Failure
from ..models.nvic import SYSTICK
from ..scope import Scope
from .bench import US, fast, hard, us
from .stepping import flooded_at_safe_rate
from .usb import BELTS, many_lines

UART_LINES_S = {"blackpill_f411": 3000, "blackpill_f401": 2000, "nucleo_f446re": 5500, "nucleo_f411re": 3700, "nucleo_f401re": 2500}
"""Short lines a second that a board takes over the UART at its greatest rate, while it moves."""

FAST_BAUD = 1_000_000

LONGEST_GAP_S = 120 * US
"""Between two samples of the inputs: a run of the step task may be in between."""


def restart_at(bench, baud):
    """The board starts anew, with a host at this rate."""
    host = bench.host
    host.baud = baud
    bench.board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    bench.board.run(seconds=0.05)


def baud_rates(bench):
    """$931: another rate from the next start on, but with hold and start both active then; and settings that are stored while bytes come."""
    bench.boot()
    board, host = bench.board, bench.host
    bench.ask(f"$931={FAST_BAUD}")
    bench.ask("$I")
    restart_at(bench, FAST_BAUD)
    bench.ask("$I")
    yield f"after a start at {board.usart.baud():.0f} baud"
    # Remarks of any length, so that a store finds any number of bytes waiting.
    random, overruns = Random(931), board.usart.overruns
    lines = [f"${130 + k % 3}={200 + k}.5({random.randrange(40) * 'a'})" for k in range(300)]
    begin = len(host.answers)
    host.stream("\n".join(lines))
    bench.wait(lambda: host.all_answered, 5, "the last answer")
    if host.answers[begin:] != ["ok"] * len(lines) or board.usart.overruns != overruns:
        raise Failure(f"{set(host.answers[begin:])}, {board.usart.overruns - overruns} overruns while settings are stored")
    yield f"{len(lines)} settings stored one behind the other, no byte lost"
    for pins, baud in (("hold",), FAST_BAUD), (("start",), FAST_BAUD), (("hold", "start"), 115_200):
        for pin in pins:
            board.drive(getattr(bench.wiring, pin), 0)
        restart_at(bench, baud)
        for pin in pins:
            board.drive(getattr(bench.wiring, pin), None)
        yield f"started with {' and '.join(pins)} active: {board.usart.baud():.0f} baud"
    board.run(seconds=0.05)
    # Switches that open when they are pressed, as $14 says.
    bench.ask("$14=6")
    for baud, level in (FAST_BAUD, 0), (115_200, None):
        for pin in ("hold", "start"):
            board.drive(getattr(bench.wiring, pin), level)
        restart_at(bench, baud)
    yield f"the same with inverted inputs: {board.usart.baud():.0f} baud"


FLOODS = {"?": b"?", "ends of lines": b"\n", "0xFF": b"\xff", "NUL": b"\0", "comments": b"(a)\n"}
"""What a host, or a wire on which there is noise, may say at the greatest rate without flow control."""


def sampled(bench):
    """A UART that is flooded at its greatest rate keeps no input from being sampled, and motion goes on."""
    bench.boot()
    bench.ask(f"$931={FAST_BAUD}")
    restart_at(bench, FAST_BAUD)
    board, host, hz = bench.board, bench.host, bench.wiring.core_hz
    safe, acceleration = bench.wiring.safe_step_hz, hard(bench, 6_000)
    fast(bench, acceleration)
    greatest = round(safe * 60 / 1000, 3)
    bench.settings(s110=greatest, s111=greatest, s112=greatest)
    bench.settings(s0=bench.wiring.least_pulse_us, s29=10)
    way, feed = 0.2 * safe / 1000, safe / 1000 * 60 * 3**0.5
    for name, text in FLOODS.items():
        bench.ask(f"G91G1X{way:.3f}Y{way:.3f}Z{way:.3f}F{feed:.1f}")
        board.run(seconds=safe / 1000 / acceleration + 0.02)
        board.begins[SYSTICK].clear()
        after = len(host.text)
        begin = board.now
        host.send(text * (2000 // len(text)))
        board.run(seconds=0.02)
        samples = [begin, *board.begins[SYSTICK], board.now]
        gap = max(later - before for before, later in pairwise(samples)) / hz
        yield f"{name}: the inputs were sampled at least every {us(gap)}"
        if gap > LONGEST_GAP_S:
            raise Failure(f"no sample for {us(gap)} while {name} came")
        if host.has_said("ALARM", after):
            raise Failure(f"an alarm while {name} came: {bytes(host.text[after:][-200:])!r}")
        host.send(b"\x18")
        board.run(seconds=0.1)
        host.send("\n\n$X\n")
        board.run(seconds=0.1)


def torn_line(bench):
    """A line that has not ended goes with the reset button: what comes behind is no part of it."""
    for text in ("G91G1X1F1000", "G91 G1 X1 F1000 (a remark that is longer than what waits)"):
        bench.boot()
        board, host = bench.board, bench.host
        scope = Scope(board)
        host.send(text)
        # Soon: from time to time all that waits is read anyway.
        board.run(seconds=len(text) * 10 / host.baud + 0.0005)
        after = len(host.text)
        board.drive(bench.wiring.reset, 0)
        bench.wait_text("Grbl 1.1h", 0.5, after)
        board.drive(bench.wiring.reset, None)
        board.run(seconds=0.01)
        host.send("\n")
        board.run(seconds=0.1)
        if scope.counts() != [0, 0, 0] or not bench.status().startswith("<Idle"):
            raise Failure(f"{text!r} was carried out behind the reset: {scope.counts()}")
        yield f"{text!r} has gone with the reset"


def uart_lines(bench):
    """Short lines over the UART at its greatest rate, by character counting: as over USB."""
    bench.boot()
    bench.settings(**BELTS, s931=FAST_BAUD)
    restart_at(bench, FAST_BAUD)
    yield from many_lines(bench, UART_LINES_S[bench.wiring.name], begin_s=0.015)
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")


def fast_flood(bench):
    """At the safe rate, a host that floods the UART at its greatest rate: no period is off, and no byte is lost."""
    bench.boot()
    bench.ask(f"$931={FAST_BAUD}")
    restart_at(bench, FAST_BAUD)
    lines = yield from flooded_at_safe_rate(bench, lambda: bench.board.run(seconds=200 * US))
    yield f"{lines} lines meanwhile at {bench.board.usart.baud():.0f} baud, {bench.host.bytes_sent} bytes"
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")
