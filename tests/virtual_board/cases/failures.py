"""Faults, hung tasks, failing clocks and supplies: the outputs must go off, and the board must report the cause after
the reset."""

import subprocess
import tempfile
from pathlib import Path

from ..board import HSI_HZ, LOADER_STACK, LOADER_START, Failure
from ..models.syscfg import SYSTEM_MEMORY
from ..scope import Scope
from .bench import JOB_SETTINGS, LeftOut, STOP_S, busy, duty, switched, us, us_off
from .patching import control_body, hang, patch, put, unpatch


def left_loader(bench):
    """The chip's boot loader jumps into the program, as a host can order (`:leave` of dfu-util), and leaves its own
    vectors and clocks. The program must restart by a reset."""
    for resets_clocks in (False, True):
        board = bench.fresh()
        board.jump_from_loader(resets_clocks)
        begin = board.seconds()
        bench.wait_text("Grbl 1.1h", 1.0)
        if [why for _, why in board.resets] != ["software"]:
            raise Failure(f"resets: {board.resets}")
        if board.clocks[-1][2] != bench.wiring.core_hz:
            raise Failure(f"the core runs at {board.clocks[-1][2]} Hz")
        if any(at < board.resets[0][0] and level in (0, 1) for at, _, _, level in board.edges):
            raise Failure("an output was driven before the reset")
        yield f"left with clocks {'reset' if resets_clocks else 'on'}: reset after {us(board.seconds(board.resets[0][0]) - begin)}"


def rebooted(bench):
    """`$REBOOT` restarts the board, and `$DFU` starts the chip's boot loader, both with all outputs off. The boot
    loader must find the chip as after a reset. After the boot loader the program must run again: what is left in RAM
    must not start the boot loader a second time."""
    bench.boot()
    board, host = bench.board, bench.host
    host.send("M3 S1000\n$100=123.5\n$REBOOT\n")
    bench.wait_text("[MSG:Switch off spindle, coolant and outputs first]", 1.0)
    host.send("M5\n$REBOOT\n")
    begin = board.now
    bench.wait(lambda: board.resets, 1.0, "a reset")
    if [why for _, why in board.resets] != ["software"] or host.text.count(b"ok\r\n") < 4:
        raise Failure(f"resets: {board.resets}, said {host.lines[-4:]}")
    after = us(board.seconds(board.resets[0][0]) - board.seconds(begin))
    bench.wait_text("Grbl 1.1h", 2, host.text.rfind(b"Grbl 1.1h") + 1)
    board.run(seconds=0.05)
    if any(board.level(pin) != 0 for pin in switched(bench.wiring)) or duty(board):
        raise Failure("an output is on after the restart")
    if "[RESET:software]" not in bench.ask("$RC") or "$100=123.500" not in bench.ask("$$"):
        raise Failure(f"after the restart: {host.lines[-80:]}")
    yield f"restarted {after} after the command, outputs off, the setting kept"
    if not bench.wiring.usb or bench.wiring.starts_in_loader:
        host.send("$DFU\n")
        bench.wait_text("error:3", 1.0)
        yield "no boot loader on this link, or one that could start a load: $DFU is refused"
        return
    host.send("$DFU\n")
    bench.wait(lambda: board.core.read("pc") == LOADER_START, 1.0, "the boot loader")
    board.run(seconds=0.01)
    registers = [board.core.read(name) for name in ("sp", "primask", "basepri", "control")]
    enabled = [number for number in board.nvic.enabled if number >= 16]
    if registers != [LOADER_STACK, 0, 0, 0] or enabled or board.nvic.csr:
        raise Failure(f"the boot loader finds {registers}, interrupts {enabled}, SysTick {board.nvic.csr}")
    if board.clocks[-1][2] != HSI_HZ or board.syscfg.values[0] != SYSTEM_MEMORY:
        raise Failure(f"the boot loader finds a clock of {board.clocks[-1][2]} Hz, MEMRMP {board.syscfg.values[0]}")
    if any(board.level(pin) in (1, "AF") for pin in switched(bench.wiring)) or len(board.resets) != 2:
        raise Failure(f"the boot loader finds an output on, or resets {board.resets}")
    yield "$DFU: the boot loader runs at 16 MHz, no interrupt enabled, system memory at 0, no output driven"
    board.jump_from_loader(False)
    bench.wait_text("Grbl 1.1h", 1.0, host.text.rfind(b"Grbl 1.1h") + 1)
    if len(board.resets) != 3:
        raise Failure(f"resets: {board.resets}")
    yield "left by a jump: the program runs again"


def lost_clock(bench):
    """The oscillator fails in full motion with the spindle on, also while interrupts are masked: everything must be
    safe at once, and the cause must be reported after the reset."""
    for masked in (False, True):
        bench.boot()
        board = bench.board
        busy(bench)
        scope = Scope(board)
        board.core.write("primask", int(masked))
        begin = board.now
        board.rcc.lose_hse()
        bench.wait(lambda board=board: board.resets, 0.1, "a reset")
        board.rcc.hse_stands = False
        rising = [step.at for step in scope.steps()]
        late = board.seconds(max([begin, *rising])) - board.seconds(begin)
        off = us_off(bench, begin)
        if late > STOP_S:
            raise Failure(f"pulses for another {us(late)}")
        tell(bench, "clock failure")
        yield f"clock lost{', interrupts masked' * masked}: spindle off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def low_at_power_up(bench):
    """The supply rises slowly: this must not be reported as a failure, and neither the full clock nor a task may start
    before the voltage is high enough."""
    for low_s in (0.12, 1.2):
        board = bench.fresh()
        board.set_supply(1.8)
        board.run(seconds=low_s)
        if board.rcc.hclk != HSI_HZ or bench.host.has_said("Grbl"):
            raise Failure("the firmware runs on a supply of 1.8 V")
        board.set_supply(3.3)
        bench.wait_text("Grbl 1.1h", 1)
        board.run(seconds=0.02)
        if board.resets or bench.host.has_said("failure"):
            raise Failure(f"a supply that takes {low_s} s to rise counts as a failure")
    yield "1.8 V for 120 ms and for 1.2 s: not started before the supply was good, and no failure"


def overflowed(bench):
    """The stack overflows in full motion with the spindle on: everything must be safe, and the cause must be
    reported."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    busy(bench)
    scope = Scope(board)
    patch(bench, control_body(bench.image), b"\xff\xb4\xfd\xe7")  # push {r0-r7}; b .-2
    board.faults_expected = True
    bench.wait(lambda: board.faults, 0.1, "the fault")
    at = board.faults[0][0]
    board.run(seconds=0.001)
    late = max(0, max((step.at for step in scope.steps()), default=0) - at) / wiring.core_hz
    if late > STOP_S:
        raise Failure(f"pulses for {us(late)} after the overflow")
    off = us_off(bench, at)
    bench.wait(lambda: board.resets, 1, "a reset")
    unpatch(bench)
    tell(bench, "stack overflow")
    yield f"spindle and coolant off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def failed_twice(bench):
    """A second failure while the first one is being logged: the board must reset and report the first one."""
    bench.boot()
    board, image = bench.board, bench.image
    names = [start for start, _, name in image.functions if "stm32f4" in name and "restart" in name]
    if not names:
        raise Failure("the image has no function that logs a failure")
    busy(bench)
    board.faults_expected = True
    hang(bench)
    first = bench.patched
    patch(bench, names[0], b"\x00\xde")  # udf
    bench.wait(lambda: board.resets, 3, "a reset")
    unpatch(bench)
    put(bench, *first)
    if not board.faults:
        raise Failure("nothing failed for the second time: this proves nothing")
    tell(bench, "stuck task")
    yield f"{cause(bench)}"


def hung(bench):
    """The control task hangs: the chip must reset, with outputs safe even before the reset, and report the cause."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    scope = Scope(board)
    hang(bench)
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a reset")
    unpatch(bench)
    tell(bench, "stuck", "atchdog")
    cycle, why = board.resets[0]
    yield f"control task: outputs safe {us_off(bench, begin)} and reset by {why} {(cycle - begin) / wiring.core_hz * 1e3:.0f} ms after it hung; {cause(bench)}"
    late = [step.at for step in scope.steps() if step.at > cycle]
    if late:
        raise Failure("steps after the reset")


def unserved(bench):
    """The interrupts of a task are disabled, as if noise had changed the interrupt controller: the other tasks must
    detect that this task does not respond."""
    for task, interrupts in (("serial", (bench.wiring.serial_irq, 67)), ("step", (bench.wiring.step_irq,))):
        yield f"{task} task: {without_interrupts(bench, interrupts)}"


def without_interrupts(bench, numbers):
    """Disables these interrupts in full motion. Returns a description of the result."""
    bench.boot()
    board = bench.board
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    board.nvic.enabled -= {16 + number for number in numbers}
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a reset")
    tell(bench, "stuck")
    cycle, why = board.resets[0]
    return f"outputs safe {us_off(bench, begin)} and reset by {why} {(cycle - begin) / bench.wiring.core_hz * 1e3:.0f} ms after its interrupts went off; {cause(bench)}"


def recorded(bench):
    """The control task hangs during a job: the board's recording must lead the simulator to the position and line of
    the failure."""
    bench.boot()
    bench.settings(**JOB_SETTINGS)
    board = bench.board
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    for line in ("G91", "N10 G1 X3 F1200", "N20 Y2", "N30 X40"):
        bench.ask(line)
    board.run(seconds=0.4)
    hang(bench)
    bench.wait(lambda: board.resets, 5, "a reset")
    unpatch(bench)
    tell(bench, "stuck", "atchdog")
    told = cause(bench)
    if "recording" in bench.wiring.left_out and "$REC" not in told:
        raise LeftOut("this board has no room for a recording")
    if "$REC" not in told:
        raise Failure(f"nothing is recorded: {told}")
    bench.ask("$X")
    listing = bench.ask("$REC", 5.0)
    end = next((line for line in listing if " ended " in line), None)
    if end is None or listing[-1] != "ok" or "[REC:end]" not in listing:
        raise Failure(f"the listing has no end: {listing[-5:]}")
    with tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "board.log"
        log.write_text("\n".join(listing) + "\n")
        done = subprocess.run([bench.oxmill, "replay", str(log)], capture_output=True, text=True, check=False)
    arrival = [line for line in done.stdout.splitlines() if "arrives at the place and line of the failure" in line]
    if done.returncode not in (0, 1) or done.stderr or not arrival:
        raise Failure(f"the replay parts: {done.stdout} {done.stderr}")
    if f"N{told.split(', line ')[1].split(',')[0]} " not in arrival[0]:
        raise Failure(f"the board failed at another line: {told}; {arrival[0]}")
    yield f"{len(listing)} lines are listed; the replay {arrival[0].split('replay')[-1].strip()}"


def deaf(bench):
    """Interrupts are masked forever: only the independent watchdog can reset the chip."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.iwdg.started:
        raise Failure("the watchdog is not started")
    busy(bench)
    patch(bench, control_body(bench.image), b"\x72\xb6\xfe\xe7")  # cpsid i; b .
    begin = board.now
    bench.wait(lambda: board.resets, 5, "a watchdog reset")
    unpatch(bench)
    cycle, why = board.resets[0]
    tell(bench, "atchdog", "WDT")
    yield f"masked for ever: reset by the {why} {(cycle - begin) / wiring.core_hz * 1e3:.0f} ms later; {cause(bench)}"


def brown_out(bench):
    """The supply falls below the detector's threshold in full motion with the spindle on: everything must be safe at
    once, the core must slow down, and the chip must not restart before the supply is good again."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    if not board.peripherals["PWR"].values[0] >> 4 & 1:
        raise Failure("the supply is not watched")
    whole = Scope(board)
    busy(bench)
    scope = Scope(board)
    begin = board.now
    board.set_supply(2.7)
    board.run(seconds=0.02)
    rising = [step.at for step in scope.steps()]
    late = max(0, max(rising, default=0) - begin) / wiring.core_hz
    off = us_off(bench, begin)
    if late > STOP_S:
        raise Failure(f"pulses for another {us(late)}")
    if board.resets:
        raise Failure("the chip begins anew while the supply is still low")
    if board.rcc.hclk != HSI_HZ:
        raise Failure(f"the core runs at {board.rcc.hclk} Hz on a supply below that of the flash's wait states")
    board.set_supply(3.3)
    bench.wait(lambda: board.resets, 1, "a reset after the supply has come back")
    tell(bench, "oltage", "upply")
    told = cause(bench)
    place, counted = float(told.split("at machine ")[1].split(",")[0]), whole.counts()[0] / 1000
    # The control task updates the position every 2 ms, in pieces of 1 ms, so the reported position can be 3 ms old,
    # which is 0.15 mm at 50 mm/s. The bounds include a margin.
    if not -0.1 <= counted - place <= 0.4:
        raise Failure(f"X{place} is reported after {counted} mm: {told}")
    yield f"the place is the one {(counted - place) * 1e3:.0f} um before the last step"
    yield f"2.7 V: spindle off after {off}, last rising edge after {us(late)}; {cause(bench)}"


def tell(bench, *words):
    """Checks that after the reset the board reports a cause with one of these words after its greeting, and that no
    output is on."""
    board = bench.board
    bench.wait_text("Grbl 1.1h", 2, bench.host.text.rfind(b"Grbl 1.1h") + 1)
    board.run(seconds=0.05)
    if any(board.level(pin) != 0 for pin in switched(bench.wiring)) or duty(board):
        raise Failure("spindle, coolant or an output is on after the reset")
    if not any(word in cause(bench) for word in words):
        raise Failure(f"the cause is not told: {bench.host.lines[-6:]}")


def cause(bench):
    """Returns the messages since the last greeting."""
    lines = [text for _, text in bench.host.lines]
    last = max(k for k, text in enumerate(lines) if text.startswith("Grbl 1.1h"))
    return " ".join(text for text in lines[last + 1 :] if text.startswith("[MSG"))


def faulted(bench):
    """An undefined instruction in the control task in full motion, with the spindle on: everything must be safe at
    once."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    busy(bench)
    scope = Scope(board)
    patch(bench, control_body(bench.image), b"\x00\xde")  # udf
    board.faults_expected = True
    bench.wait(lambda: board.faults, 0.1, "the fault")
    at = board.faults[0][0]
    board.run(seconds=0.001)
    rising = [step.at for step in scope.steps()]
    late = max(0, max(rising, default=0) - at) / wiring.core_hz
    stuck = [name for name in wiring.step if board.level(name) == 1]
    if late > STOP_S or stuck:
        raise Failure(f"pulses for {us(late)} after the fault, step pins left high: {stuck}")
    # The motors must keep their supply, because an axis without a brake would drop. In a reset the pin floats. The
    # level of such an edge is None and not 0, so the check ignores it.
    if any(edge > at and level == 0 and f"{port}{pin}" == wiring.motor_power for edge, port, pin, level in board.edges):
        raise Failure("the fault switches the motors' supply off")
    yield f"HardFault: spindle and coolant off after {us_off(bench, at)}, last rising edge after {us(late)}"
    if board.resets:
        # The injected instruction must not affect the restarted firmware.
        unpatch(bench)
        tell(bench, "ault")
        yield f"then a reset; {cause(bench)}"
