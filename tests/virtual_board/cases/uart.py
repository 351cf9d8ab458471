"""The UART: its rate, and how many lines a second it carries."""

from itertools import pairwise
from random import Random

from ..board import Failure
from ..models.nvic import SYSTICK
from ..models.usart import FE
from ..scope import Scope
from .bench import US, fast, hard, us
from .stepping import flooded_at_safe_rate
from .usb import BELTS, many_lines

UART_LINES_S = {"nucleo_f446re": 5700, "nucleo_f411re": 4000, "nucleo_f401re": 2600}
"""Short lines per second that a board accepts over the UART at its maximum rate while it moves."""

LONGEST_GAP_S = 125 * US
"""Maximum time between two samples of the inputs, including the delay by a run of the step task."""


def restart_at(bench, baud):
    """Restarts the board, with a host at this rate."""
    host = bench.host
    host.baud = baud
    bench.board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    bench.board.run(seconds=0.05)


def boot_fast(bench):
    """Starts the board at the maximum rate of its UART."""
    bench.boot()
    bench.ask(f"$931={bench.wiring.most_baud}")
    restart_at(bench, bench.wiring.most_baud)


def baud_rates(bench):
    """`$931` sets the UART's rate from the next start of the board on, except if the hold and start inputs are both
    active at that start. Also stores settings while bytes arrive."""
    bench.boot()
    board, host = bench.board, bench.host
    fast_baud = bench.wiring.most_baud
    bench.ask(f"$931={fast_baud}")
    bench.ask("$I")
    restart_at(bench, fast_baud)
    bench.ask("$I")
    yield f"after a start at {board.usart.baud():.0f} baud"
    # The host sends as many bytes ahead as the board announces (`Bf:`).
    host.window = 255
    # The comments have various lengths, so that settings are stored while any number of bytes wait. The first comments
    # consist of text. The later ones consist of other bytes, of which the receiver reads fewer at a time.
    random, overruns = Random(931), board.usart.overruns
    for letter, count in ("a", 300), ("\u00e4", 200):
        lines = [f"${130 + k % 3}={200 + k}.5({random.randrange(40) * letter})" for k in range(count)]
        begin = len(host.answers)
        host.stream("\n".join(lines))
        bench.wait(lambda: host.all_answered, 5, "the last answer")
        if host.answers[begin:] != ["ok"] * count or board.usart.overruns != overruns:
            raise Failure(f"{set(host.answers[begin:])}, {board.usart.overruns - overruns} overruns while settings are stored")
        yield f"{count} settings stored one behind the other, with remarks of the letter {letter}, no byte lost"
    for pins, baud in (("hold",), fast_baud), (("start",), fast_baud), (("hold", "start"), 115_200):
        for pin in pins:
            board.drive(getattr(bench.wiring, pin), 0)
        restart_at(bench, baud)
        for pin in pins:
            board.drive(getattr(bench.wiring, pin), None)
        yield f"started with {' and '.join(pins)} active: {board.usart.baud():.0f} baud"
    board.run(seconds=0.05)
    # Normally closed switches, as set by `$14`.
    bench.ask("$14=6")
    for baud, level in (fast_baud, 0), (115_200, None):
        for pin in ("hold", "start"):
            board.drive(getattr(bench.wiring, pin), level)
        restart_at(bench, baud)
    yield f"the same with inverted inputs: {board.usart.baud():.0f} baud"


class Disturbed:
    """Replaces a digit that the host sends by another byte with a framing error, now and then."""

    def __init__(self, usart, become):
        self.usart, self.become, self.receive = usart, become, usart._receive
        self.ends, self.lines = 0, []
        """Indices of the lines with a replaced digit."""
        usart._receive = self

    def __call__(self, byte, error, at):
        # The replaced digits are at least ten lines apart, so that the firmware has reported the previous loss before
        # the next one.
        is_due = not self.lines or self.ends >= self.lines[-1] + 10
        if is_due and chr(byte).isdigit():
            self.lines.append(self.ends)
            self.receive(self.become(byte), FE, at)
        else:
            self.receive(byte, error, at)
        self.ends += byte == ord("\n")

    def end(self):
        self.usart._receive = self.receive
        if not self.lines:
            raise Failure("this proves nothing")


def disturbed_line(bench):
    """Bytes arrive with a detected error: no line may be executed with a wrong value or as two lines, and each must be
    answered."""
    boot_fast(bench)
    board, host = bench.board, bench.host
    disturbed = Disturbed(board.usart, lambda byte: byte ^ 1)
    begin = len(host.answers)
    values = [f"{100 + 2 * k}.000" for k in range(400)]
    host.stream("\n".join(f"${130 + k % 3}={value}" for k, value in enumerate(values)))
    bench.wait(lambda: host.all_answered, 5, "the last answer")
    disturbed.end()
    answers = host.answers[begin:]
    refused = sum(answer != "ok" for answer in answers)
    yield f"{len(disturbed.lines)} bytes of {len(values)} lines disturbed, {refused} lines refused"
    if carried_out := [line for line in disturbed.lines if answers[line] == "ok"]:
        raise Failure(f"disturbed lines {carried_out} were carried out")
    # The board refuses the disturbed line. At a high baud rate it also refuses neighbouring lines: those received less
    # than two input-sampling periods before or after it.
    if refused > 3 * len(disturbed.lines):
        raise Failure("more lines are refused than were disturbed")
    listing = bench.ask("$$")
    for number in range(3):
        right = [value for value, answer in zip(values[number::3], answers[number::3], strict=True) if answer == "ok"][-1]
        if f"${130 + number}={right}" not in listing:
            raise Failure(f"${130 + number} is not {right}: {listing[-12:]}")
    # If a disturbed line were executed as two lines, the second half would move the machine.
    bench.ask("$X")
    scope = Scope(board)
    disturbed = Disturbed(board.usart, lambda byte: ord("\n"))
    host.stream("\n".join(f"G10L2P{k % 6 + 1}X{k}Y1Z2" for k in range(1000)))
    bench.wait(lambda: host.all_answered, 20, "the last answer")
    disturbed.end()
    board.run(seconds=0.1)
    yield f"{len(disturbed.lines)} bytes have become ends of lines"
    if scope.steps():
        raise Failure(f"half a line was carried out: the motors are at {scope.counts()}")


FLOODS = {"?": b"?", "ends of lines": b"\n", "ends by CR LF": b"\r\n", "0xFF": b"\xff", "NUL": b"\0", "comments": b"(a)\n"}
"""Bytes that a host, or noise on the wire, can send at the maximum rate without flow control."""


def sampled(bench):
    """A UART that is flooded at its maximum rate must not delay the samples of the inputs, and motion must continue."""
    boot_fast(bench)
    board, host, hz = bench.board, bench.host, bench.wiring.core_hz
    safe, acceleration = bench.wiring.safe_step_hz, hard(bench, 6_000)
    fast(bench, acceleration)
    greatest = round(safe * 60 / 1000, 3)
    bench.settings(s110=greatest, s111=greatest, s112=greatest)
    bench.settings(s0=bench.wiring.least_pulse_us, s29=10)
    way, feed = 0.3 * safe / 1000, safe / 1000 * 60 * sum((share / 9) ** 2 for share in (9, 7, 5)) ** 0.5
    for name, text in FLOODS.items():
        bench.ask(f"G91G1X{way:.3f}Y{way * 7 / 9:.3f}Z{way * 5 / 9:.3f}F{feed:.1f}")
        board.run(seconds=safe / 1000 / acceleration + 0.02)
        board.begins[SYSTICK].clear()
        after = len(host.text)
        begin = board.now
        # The flood lasts 60 ms, longer than the queued segments of the step task.
        host.send(text * round(0.006 * host.baud / len(text)))
        board.run(seconds=0.06)
        samples = [begin, *board.begins[SYSTICK], board.now]
        gap = max(later - before for before, later in pairwise(samples)) / hz
        yield f"{name}: the inputs were sampled at least every {us(gap)}"
        if gap > LONGEST_GAP_S:
            raise Failure(f"no sample for {us(gap)} while {name} came")
        board.run(seconds=0.05)
        if host.has_said("ALARM", after) or not bench.status().startswith("<Run"):
            raise Failure(f"an alarm while {name} came: {bytes(host.text[after:][-200:])!r}")
        host.send(b"\x18")
        board.run(seconds=0.1)
        host.send("\n\n$X\n")
        board.run(seconds=0.1)


def torn_line(bench):
    """The reset button must discard an unfinished line: later bytes must not continue it."""
    for text in ("G91G1X1F1000", "G91 G1 X1 F1000 (a remark that is longer than what waits)"):
        bench.boot()
        board, host = bench.board, bench.host
        scope = Scope(board)
        host.send(text)
        # Press the button soon after the last byte, while the line still waits in the UART's receiver. Later the
        # firmware would read the waiting bytes.
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
    """Sends short lines over the UART at its maximum rate by character counting, as over USB."""
    bench.boot()
    bench.settings(**BELTS, s931=bench.wiring.most_baud)
    restart_at(bench, bench.wiring.most_baud)
    yield from many_lines(bench, UART_LINES_S.get(bench.wiring.name, 700), begin_s=0.015)
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")


def fast_flood(bench):
    """Moves at the safe rate while a host floods the UART at its maximum rate: no period may be off and no byte lost.
    Nothing interrupts the step task."""
    boot_fast(bench)
    lines = yield from flooded_at_safe_rate(bench, lambda: bench.board.run(seconds=200 * US))
    yield f"{lines} lines meanwhile at {bench.board.usart.baud():.0f} baud, {bench.host.bytes_sent} bytes"
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")
