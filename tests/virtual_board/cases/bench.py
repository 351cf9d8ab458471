"""A board with a host, and the common parts of the cases: bounds, settings, observation of the outputs."""

import csv
import subprocess
import tempfile
from pathlib import Path

from ..board import Board, Failure
from ..host import Host
from ..models.dma import M0AR, NDTR, REQUESTS
from ..scope import Scope
from ..usb import UsbHost

US = 1e-6

JITTER_S = 0.1 * US
"""Maximum error of a step period. An edge may have to wait for another DMA transfer, but never for the program."""

SAMPLE_S, FILTER_SAMPLES = 50 * US, 8

STOP_S = 20 * US
"""Maximum time from the detection of a stop to the last rising edge."""

RUN_CYCLES = 4450
"""Longest run of the step task (`run_cycles` in profiles.rs)."""

BEAM_STOP_S = {"blackpill_f401": 130 * US}
"""Maximum time from the last bit of a byte that stops the machine until the laser is off, for boards whose image is
built for size: these take longer than `byte_stop_s` (docs/limits.md)."""

HOLD_S = 25e-3
"""Maximum time from `!` to the beginning of the ramp."""

TRIP_S = FILTER_SAMPLES * SAMPLE_S + SAMPLE_S + STOP_S
"""Maximum time from a contact to the last rising edge: up to one sample until the filter starts, the filter, and the
stop."""

STACK_LEFT = 4096
"""Bytes of the stack that must stay unused in all cases."""

LATEST_PULSE_END_S = 0.15 * US
"""Maximum by which a pulse may be longer than `$0`: DMA outputs its falling edge, and may first have to finish other
transfers."""


class Bench:
    """A board with a host, for one case after another."""

    def __init__(self, wiring, image, oxmill):
        self.wiring, self.image, self.oxmill = wiring, image, oxmill
        self.masked = {}
        self.board, self.deepest = None, (0, 0, "")
        self.case = ""
        self.fresh()

    def fresh(self):
        """Creates a new board, not yet running."""
        self.note_stack()
        self.board = Board(self.wiring, self.image)
        self.host = Host(self.board)
        return self.board

    def sample_at(self, cycle):
        """Shifts the samples of the inputs so that one sample comes at the given cycle. The period of the samples does
        not change."""
        nvic, period = self.board.nvic, self.board.nvic.reload + 1
        nvic.zero_at = cycle - (cycle - nvic.zero_at) // period * period
        nvic.plan(nvic.zero_at)

    def note_stack(self):
        """Records the maximum stack use, except on a board that was made to fail."""
        if self.board is not None and not self.board.faults_expected:
            used, size = self.board.stack_used()
            self.deepest = max(self.deepest, (used, size, self.case))

    def boot(self):
        self.fresh()
        # The limit is long: with DMA the greeting is sent while flash is erased, but the interrupt that ends the
        # transfer is served only after the erase.
        self.wait_text("Grbl 1.1h ['$' for help]\r\n", 1.1)
        self.forget_masks()

    def boot_with_usb(self):
        """Starts a new board. `host` is then a host that has opened the USB port, and `uart` the host at the UART."""
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
        """Sends a line and waits for its answer, which must be `ok`. Returns the lines up to and with this `ok`."""
        begin, answers = len(self.host.lines), len(self.host.answers)
        self.host.send(line + "\n")
        self.wait(lambda: len(self.host.answers) > answers, limit, f"an answer to {line}")
        if self.host.answers[-1] != "ok":
            raise Failure(f"{line} was answered by {self.host.answers[-1]}")
        return [text for _, text in self.host.lines[begin:]]

    def settings(self, **values):
        for name, value in values.items():
            # Flash may have to be erased first, hence the long limit.
            self.ask(f"${name[1:]}={value}", 2.0)
        # Gives the settings store time for work that it does in advance, such as an erase.
        self.board.run(seconds=0.01)

    def status(self):
        after = len(self.host.lines)
        self.host.send(b"?")
        self.wait(lambda: any(line.startswith("<") for _, line in self.host.lines[after:]), 0.2, "a status report")
        return next(line for _, line in self.host.lines[after:] if line.startswith("<"))

    def wait_state(self, state, limit):
        """Polls like a sender until the state is reached. Returns the report with that state."""
        for _ in range(round(limit / 0.02)):
            status = self.status()
            if status.startswith(f"<{state}"):
                return status
            self.board.run(seconds=0.02)
        raise Failure(f"the state is {status} and not {state} after {limit} s")

    def at_rest(self, seconds):
        """Runs for a time and fails if a step is output."""
        scope = Scope(self.board)
        self.board.run(seconds=seconds)
        if scope.steps():
            raise Failure("a step came at rest")

    # Masks.

    def forget_masks(self):
        self.board.state.masked_longest = 0

    def longest_mask(self):
        """Returns the longest time with interrupts masked since the last call of this function or of `forget_masks`, in
        s, and where in the program it ended."""
        state = self.board.state
        cycles, where = state.masked_longest, self.image.place(state.slowest_to)
        state.masked_longest = 0
        return cycles / self.board.clocks[-1][2], where


def byte_stop_s(bench):
    """Returns the maximum time, s, from the last bit of a byte that stops the machine to the last rising edge. It is
    the sum of one period of the input samples (each sample reads the received bytes), the longest run of the step task,
    and 2 us."""
    return SAMPLE_S + RUN_CYCLES / bench.wiring.core_hz + 2 * US


def us(seconds):
    return f"{seconds / US:.2f} us"


def duty(board):
    """Returns the share of time for which the spindle's PWM is high; 0 if the timer does not drive its pin."""
    if board.shown(board.wiring.pwm) != "AF":
        return 0
    gpio, pin = board.pin(board.wiring.pwm)
    if gpio.function(pin) != {"TIM1": 1, "TIM3": 2}[board.wiring.pwm_timer]:
        raise Failure(f"the spindle's pin has alternate function {gpio.function(pin)}")
    share = board.peripherals[board.wiring.pwm_timer].duty(board.wiring.pwm_channel)
    if share is None:
        raise Failure("the spindle's pin belongs to the timer, which does not drive it")
    return share


JOB_SETTINGS = {"s110": 3000, "s111": 3000, "s112": 3000, "s120": 1000, "s121": 1000, "s122": 1000}


def in_simulator(bench, job, settings, *options):
    """Runs a job in the simulator with this board's profile. Returns the output."""
    command = [bench.oxmill, "run", str(job), "--board", bench.wiring.name, *options]
    for name, value in settings.items():
        command += ["--set", f"{name[1:]}={value}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise Failure(f"the simulator failed: {done.stderr}")
    return done.stdout


def simulated(bench, job, settings=JOB_SETTINGS):
    """Runs a job in the simulator. Returns (axes, negative) for each step event, and the end position in steps. `axes`:
    bit mask of the axes that step (bit 0: X); `negative`: those that step in the negative direction."""
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


def fast(bench, acceleration, pulse_us=2):
    """Sets 1000 steps/mm and the maximum rate that the board's safe rate and the pulse allow; a higher rate would be
    rejected."""
    rate = int(bench.wiring.greatest_hz(pulse_us)) * 60 // 1000
    bench.settings(s0=pulse_us, s110=rate, s111=rate, s112=rate)
    bench.settings(s100=1000, s101=1000, s102=1000, s120=acceleration, s121=acceleration, s122=acceleration)


def hard(bench, acceleration):
    """Returns an acceleration (mm/s²), raised in proportion if the board's safe rate is above 490 kHz. So a faster
    board needs no more time to reach its safe rate than a board of 490 kHz."""
    return round(acceleration * max(1, bench.wiring.safe_step_hz / 490_000))


def step_load(board, begin, end):
    """Returns the share of processor time that the step task takes from cycle `begin` to `end`, and its longest run
    that begins in between, in cycles."""
    runs = [(entry, left) for entry, left in board.step_runs if begin <= entry < end]
    return sum(left - entry for entry, left in runs) / (end - begin), max(left - entry for entry, left in runs)


def moving(bench, feed=3000, way=100):
    """Starts a long move of X and waits until it is at speed."""
    bench.ask(f"G91 G1 X{way} F{feed}")
    bench.board.run(seconds=feed / 60 / 1000 + 0.05)


def step_clock(board):
    """Returns the timer whose compare events time the steps."""
    return next(timer for timer in board.peripherals.values() if getattr(timer, "slaves", None))


def joins_for(board):
    """Returns the number of cycles from now to the deadline for queueing the next step event. After the deadline the
    output stops. The deadline is the time of the last queued event but one."""
    clock = step_clock(board)
    name, stream, _ = next(place for place, who in REQUESTS.items() if who == f"{clock.name}_CH1")
    registers = 0x10 + 0x18 * stream
    dma = board.peripherals[name]
    ring = dma.values[registers + M0AR]
    places = dma.whole[stream]
    moments = [board.word(ring + 4 * place) for place in range(places)]
    # The DMA stream of event times is one event ahead of the output. The slot after the last event holds a past time,
    # so the loop ends at the last event.
    at = (places - dma.values[registers + NDTR] - 1) % places
    while (moments[(at + 1) % places] - moments[at] & 0xFFFF_FFFF) < 1 << 31:
        at = (at + 1) % places
    return ((moments[at - 1] - clock.count() + (1 << 31) & 0xFFFF_FFFF) - (1 << 31)) * clock.cycles


def stand_once(board, until):
    """Stalls the processor when the output of the next motion is about to begin. `until`: end of the stall, in seconds
    after the time of the first event."""
    tim5, moments = board.peripherals["TIM5"], board.dma[0]
    write = moments.write

    def and_stand(offset, value):
        write(offset, value)
        if offset == 0x10 + 0x18 * 2 + M0AR:
            moments.write = write
            away = (board.word(value) - tim5.count() & 0xFFFF_FFFF) * tim5.cycles / board.clocks[-1][2]
            board.stall(away + until)

    moments.write = and_stand


def error_of(bench, line):
    """Returns the answer to a line, normally an error."""
    answers = len(bench.host.answers)
    bench.host.send(line + "\n")
    bench.wait(lambda: len(bench.host.answers) > answers, 1, f"an answer to {line}")
    return bench.host.answers[-1]


def busy(bench):
    """Starts motion at full speed, with spindle, coolant and the outputs for programs on."""
    fast(bench, 1000)
    all_on(bench)
    moving(bench)
    if not duty(bench.board) or any(bench.board.level(pin) != 1 for pin in switched(bench.wiring)):
        raise Failure("spindle, coolant and outputs are not on")


def switched(wiring):
    """Returns the outputs that `all_on` switches on."""
    return (wiring.spindle, wiring.flood, *wiring.program_outputs)


def all_on(bench):
    bench.ask("M3 S1000")
    bench.ask("M8")
    for number, _ in enumerate(bench.wiring.program_outputs):
        bench.ask(f"M64 P{number}")


def us_off(bench, begin):
    """Returns the time from `begin` (a cycle) until all outputs of `all_on` were off, as text. Fails if one of them or
    the PWM is still on."""
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


def with_usb(bench):
    if not bench.wiring.usb:
        raise LeftOut("this board has no USB of its own")
    bench.boot_with_usb()
    return bench.board, bench.host


class LeftOut(Exception):
    """Raised if the board lacks the tested feature according to its entry in parts.py. The case then neither fails nor
    passes."""
