"""A host at the USB port of a Black Pill."""

import json
import math
import tempfile
from pathlib import Path

from ..board import Failure
from ..models.otg import EPENA, IN, NAKSTS, OUT, USBSUSP
from ..scope import Scope
from .bench import JOB_SETTINGS, in_simulator, us, with_usb
from .patching import hang, unpatch

LINES_S = {"blackpill_f401": 2850}
"""Short lines per second that a board accepts over USB while it moves."""


def usb_port(bench):
    """Checks enumeration, the greeting when the port is opened, a job sent by character counting, and a second host at
    the UART."""
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
        # Writing the log masks interrupts for longer than any code that runs during motion, but happens only at rest.
        # So the masks of log writing are left out below.
        masks.append(bench.longest_mask())
        moving = not (bench.status().startswith("<Idle") and host.all_answered)
        polls += 1
        # The second host tries to move: it must be refused while the first one has work in progress.
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


SENT_AHEAD = 64
"""Size, in bytes, of the queue between the serial task and the UART."""


def usb_waits_for_answers(bench):
    """The command of the UART's host is done, but its answer is still being sent: a line of the USB host must be
    refused. If the rest of the answer is already in the UART's queue of `SENT_AHEAD` bytes, the line may also be
    accepted. No byte may be lost or go to the wrong host."""
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
        is_told = host.answers[-1] == "error:8" or left < SENT_AHEAD and host.answers[-1] == "ok"
        if not is_told or bytes(uart.text[begin:]) != listing:
            raise Failure(f"{left} bytes before the end: USB was told {host.answers[-1]}, the UART {bytes(uart.text[-100:])!r}")
    bench.host = host
    yield f"a line {max(lefts)} to {SENT_AHEAD} bytes before the end of the other host's listing is refused, and that is whole"


def usb_flood(bench):
    """A host without character counting: it must be held back and lose nothing, and commands within the limits must act
    at once."""
    board, host = with_usb(bench)
    bench.settings(**JOB_SETTINGS)
    # 255 bytes fill the queue, 128 more wait after it; a dwell prevents the controller from reading them.
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
    # The port is closed while the board holds the host back: the board must notice the change of DTR, and the next host
    # must find a working link.
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
    """Returns a program that moves along a circle of radius 100 mm in chords."""
    lines = [f"G90G1F{feed:.0f}"]
    for k in range(1, count + 1):
        angle = k * chord_mm / 100
        lines.append(f"X{100 * (math.cos(angle) - 1):.3f}Y{100 * math.sin(angle):.3f}")
    return "\n".join(lines)

BELTS = {"s0": 2, "s29": 0, "s100": 80, "s101": 80, "s110": 60000, "s111": 60000, "s120": 4000, "s121": 4000}
"""Settings of a machine for many lines per second: each line takes few steps."""


def usb_lines(bench):
    """Sends short lines over USB by character counting. Up to the promised number of lines per second, a job must last
    only as long as its motion, because the look-ahead never runs low. Also measures how many lines per second the board
    accepts when the motion needs more lines."""
    with_usb(bench)
    bench.settings(**BELTS)
    yield from many_lines(bench, LINES_S.get(bench.wiring.name, 4200))


def many_lines(bench, promised, begin_s=0.0):
    """Sends many short lines at several rates and compares the duration with the simulator's. `begin_s`: time that may
    be lost at the start, when motion begins before the look-ahead is full."""
    board, host = bench.board, bench.host
    # Far more lines than the look-ahead holds. Lines that end with CR LF have one more byte.
    for rate, count, end in ((promised, 4000, "\n"), (4 * promised, 1200, "\n"), (0.85 * promised, 1500, "\r\n")):
        text = chords(count, 0.05, 0.05 * rate * 60)
        with tempfile.TemporaryDirectory() as folder:
            job = Path(folder) / "chords.nc"
            job.write_text(text)
            expected = json.loads(in_simulator(bench, job, BELTS, "--json"))["duration_s"]
        before, scope, begin = len(host.answers), Scope(board), board.now
        host.stream(text, end)
        bench.wait(lambda: host.all_answered, 60, "the last answer")
        lines = (len(host.answers) - before) / ((board.now - begin) / bench.wiring.core_hz)
        bench.wait_state("Idle", 60)
        if any(answer != "ok" for answer in host.answers[before:]):
            raise Failure(f"answers: {set(host.answers[before:])}")
        rising = [step.at for step in scope.steps()]
        took = (rising[-1] - rising[0]) / bench.wiring.core_hz
        yield f"{rate:.0f} lines/s of {len(text) / text.count(chr(10)):.0f} bytes and {len(end)} at the end asked for: {lines:.0f} lines/s answered; {took:.3f} s of motion, {expected:.3f} s in the simulator"
        if rate <= promised and took > 1.002 * expected + begin_s:
            raise Failure("the machine has waited for lines")
        bench.ask("G90G1X0Y0F9000")
        bench.wait_state("Idle", 60)


def usb_stop(bench):
    """A command that stops the machine must not wait long after other commands or after lines that are refused."""
    board, usb = with_usb(bench)
    bench.settings(**JOB_SETTINGS)
    refused = b"G1 X1 Y2 Z3\n" * 21
    for name, text, mover in (
        ("60 overrides", b"\x91" * 60, usb),
        ("130 bytes 0xFF", b"\xff" * 130, usb),
        (f"{len(refused)} bytes of lines, while the UART's host has the machine", refused, bench.uart),
    ):
        bench.host = mover
        bench.ask("G91 G1 X20 F3000")
        board.run(seconds=0.1)
        scope, sent = Scope(board), board.now
        usb.send(text + b"\x18")
        board.run(seconds=0.05)
        took = (max((step.at for step in scope.steps()), default=sent) - sent) / bench.wiring.core_hz
        yield f"{name} and a reset over USB: the last step comes {us(took)} later"
        if took > 2e-3:
            raise Failure("the reset has waited")
        bench.ask("$X")
    bench.host = usb


def usb_answers(bench):
    """Answers of consecutive waiting lines must share packets, and none may be held back while the next line takes
    time."""
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
    """The cable is pulled during a job: the machine must hold, and the UART or the next host must get control."""
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
    # While flash is erased and the processor is stalled, a line arrives and then the cable is pulled; the firmware
    # notices both afterwards.
    host.order("plug")
    bench.wait(lambda: host.is_set_up, 1, "the set-up of the USB device")
    host.order("open")
    bench.settings(s914=1)
    board.stall(0.3)
    if not board.otg.out(1, b"G91 G1 X10 F600\n"):
        raise Failure("the endpoint takes no packet: this proves nothing")
    board.otg.flag(USBSUSP)
    host.open = host.is_set_up = False
    board.run(seconds=0.5)
    bench.host = bench.uart
    if scope.counts() != [0, 0, 0] or not (status := bench.status()).startswith("<Idle"):
        raise Failure(f"pulled while the processor stood: {status}, the motors are at {scope.counts()}")
    bench.ask("G4P0")
    yield "pulled while the processor stood: what was not read yet has gone with its host, and the UART has the machine"


def usb_unread(bench):
    """Packets that wait for space in the firmware's queue must not keep other tasks from running, and must be discarded
    when their host closes the port."""
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

    # The queue of commands is full, one more command waits, and the bytes after it are not fetched.
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
    # Now the host fetches no answers. One packet of answers is already in the endpoint.
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
    # A program on the host ends while it sends a whole file. The host's operating system first closes the port, and
    # later cancels the bytes in flight.
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
    # Emulates a driver that enables the endpoint twice before the firmware sees the end of a packet: one packet is in
    # the driver, and a second one stays in the FIFO and keeps the interrupt pending.
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
    """A host that configures the device again, or clears halts, restarts with DATA0: no packet may be lost or wait
    forever."""
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
    # The host withdraws the configuration while the endpoint waits for space.
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


def usb_reset(bench):
    """A host resets the bus during a job and configures the device again, also with unfetched answers: the machine must
    hold, and the port must work as before."""
    board, host = with_usb(bench)
    bench.settings(**JOB_SETTINGS)
    scope = Scope(board)
    for reads in (True, False):
        bench.ask("G91 G1 X10 F600")
        board.run(seconds=0.2)
        host.reads = reads
        host.send("G4P0\n" if reads else "$G\n$G\n")
        board.run(seconds=0.02)
        if not reads and not board.otg.control[IN, 2] & EPENA:
            raise Failure("no packet waits to be fetched: this proves nothing")
        host.order("reset")
        board.run(seconds=0.005)
        host.reads = True
        bench.wait(lambda: host.is_set_up, 1, "the set-up of the USB device")
        after = len(host.text)
        host.order("open")
        bench.wait_text("Grbl 1.1h", 0.2, after)
        if not host.text[after:].startswith(b"\r\nGrbl"):
            raise Failure(f"behind the reset: {bytes(host.text[after:])!r}")
        bench.wait_state("Hold:0", 0.2)
        host.send(b"~")
        bench.wait_state("Idle", 5)
        for _ in range(3):
            bench.ask("G4P0")
        yield f"{'all read' if reads else 'a packet unread'}: held behind the reset, and gone on after `~`"
    if scope.counts() != [5000, 0, 0]:
        raise Failure(f"the motors are at {scope.counts()}")
