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

UART_LINES_S = {"blackpill_f411": 700, "blackpill_f401": 700, "nucleo_f446re": 5700, "nucleo_f411re": 4000, "nucleo_f401re": 2600}
"""Short lines a second that a board takes over the UART at its greatest rate, while it moves."""

LONGEST_GAP_S = 125 * US
"""Between two samples of the inputs: a run of the step task may be in between."""


def restart_at(bench, baud):
    """The board starts anew, with a host at this rate."""
    host = bench.host
    host.baud = baud
    bench.board.request_reset(None, "power")
    host.text.clear()
    bench.wait_text("Grbl 1.1h", 1)
    bench.board.run(seconds=0.05)


def boot_fast(bench):
    """The board at the greatest rate of its UART."""
    bench.boot()
    bench.ask(f"$931={bench.wiring.most_baud}")
    restart_at(bench, bench.wiring.most_baud)


def baud_rates(bench):
    """$931: another rate from the next start on, but with hold and start both active then; and settings that are stored while bytes come."""
    bench.boot()
    board, host = bench.board, bench.host
    fast_baud = bench.wiring.most_baud
    bench.ask(f"$931={fast_baud}")
    bench.ask("$I")
    restart_at(bench, fast_baud)
    bench.ask("$I")
    yield f"after a start at {board.usart.baud():.0f} baud"
    # As many bytes as the board says that it takes (`Bf:`).
    host.window = 255
    # Remarks of any length, so that a store finds any number of bytes waiting: of text, and of bytes of which few are read at once.
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
    # Switches that open when they are pressed, as $14 says.
    bench.ask("$14=6")
    for baud, level in (fast_baud, 0), (115_200, None):
        for pin in ("hold", "start"):
            board.drive(getattr(bench.wiring, pin), level)
        restart_at(bench, baud)
    yield f"the same with inverted inputs: {board.usart.baud():.0f} baud"


class Disturbed:
    """Now and then a digit of what the host sends becomes another byte, and is seen to be wrong."""

    def __init__(self, usart, become):
        self.usart, self.become, self.receive = usart, become, usart._receive
        self.ends, self.lines = 0, []
        """Numbers of the lines in which that was."""
        usart._receive = self

    def __call__(self, byte, error, at):
        # The loss before has been told by then.
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
    """A byte is wrong, and seen to be: none of the lines that come then is carried out with another value than was sent, nor as two, and each
    is answered."""
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
    # The line itself, and at a fast rate those before and behind it within two samples of the inputs.
    if refused > 3 * len(disturbed.lines):
        raise Failure("more lines are refused than were disturbed")
    listing = bench.ask("$$")
    for number in range(3):
        right = [value for value, answer in zip(values[number::3], answers[number::3], strict=True) if answer == "ok"][-1]
        if f"${130 + number}={right}" not in listing:
            raise Failure(f"${130 + number} is not {right}: {listing[-12:]}")
    # Of a line that is cut in two the second half would move.
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
"""What a host, or a wire on which there is noise, may say at the greatest rate without flow control."""


def sampled(bench):
    """A UART that is flooded at its greatest rate keeps no input from being sampled, and motion goes on."""
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
        # For 60 ms: longer than the step task has segments for.
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
    bench.settings(**BELTS, s931=bench.wiring.most_baud)
    restart_at(bench, bench.wiring.most_baud)
    yield from many_lines(bench, UART_LINES_S[bench.wiring.name], begin_s=0.015)
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")


def fast_flood(bench):
    """At the safe rate, a host that floods the UART at its greatest rate: no period is off, and no byte is lost. Nothing takes time from the
    step task."""
    boot_fast(bench)
    lines = yield from flooded_at_safe_rate(bench, lambda: bench.board.run(seconds=200 * US))
    yield f"{lines} lines meanwhile at {bench.board.usart.baud():.0f} baud, {bench.host.bytes_sent} bytes"
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")
