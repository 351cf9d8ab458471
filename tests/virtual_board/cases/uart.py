"""The UART: its rate, and how many lines a second it carries."""

from ..board import Failure
from .bench import US
from .stepping import flooded_at_safe_rate
from .usb import BELTS, many_lines

UART_LINES_S = {"blackpill_f411": 3000, "blackpill_f401": 2000, "nucleo_f446re": 5500, "nucleo_f411re": 3700, "nucleo_f401re": 2500}
"""Short lines a second that a board takes over the UART at its greatest rate, while it moves."""

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


def fast_flood(bench):
    """At the safe rate, a host that floods the UART at its greatest rate: no period is off, and no byte is lost."""
    bench.boot()
    bench.ask(f"$931={FAST_BAUD}")
    restart_at(bench, FAST_BAUD)
    lines = yield from flooded_at_safe_rate(bench, lambda: bench.board.run(seconds=200 * US))
    yield f"{lines} lines meanwhile at {bench.board.usart.baud():.0f} baud, {bench.host.bytes_sent} bytes"
    if bench.board.usart.overruns or bench.host.has_said("lost"):
        raise Failure(f"{bench.board.usart.overruns} overruns")
