"""The start of a board, and whole jobs, compared step by step with the simulator."""

import re
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path

from ..board import Failure, Image
from ..models.nvic import HARD_FAULT, NMI
from ..models.rcc import PLLCFGR
from ..parts import MHZ, TABLES
from ..scope import Scope
from .bench import JOB_SETTINGS, LeftOut, duty, simulated, us


def boot(bench):
    """Boot: the greeting must come, and the outputs must never leave their safe levels before it."""
    bench.boot()
    board, wiring = bench.board, bench.wiring
    cycle, line = next(entry for entry in bench.host.lines if entry[1])
    if not line.startswith("Grbl 1.1h ['$' for help]"):
        raise Failure(f"the first line is {line!r}")
    if board.clocks[-1][2] != wiring.core_hz:
        raise Failure(f"the core runs at {board.clocks[-1][2]} Hz and not at {wiring.core_hz}")
    coolant = (wiring.flood, wiring.mist)
    safe = {name: 0 for name in (*wiring.step, wiring.spindle, wiring.spindle_direction, *coolant, *wiring.program_outputs)}
    safe |= dict.fromkeys((wiring.enable, *wiring.other_enables), 1)
    if wiring.motor_power:
        safe[wiring.motor_power] = 1
        if board.level(wiring.motor_power) != 1:
            raise Failure("the motors have no supply")
    for at, port, pin, level in board.edges:
        wanted = safe.get(f"{port}{pin}")
        if wanted is not None and level in (0, 1) and level != wanted:
            raise Failure(f"P{port}{pin} was {level} at {board.seconds(at):.6f} s")
    first = min(board.seconds(at) for at, port, pin, level in board.edges if f"{port}{pin}" in safe and level in (0, 1))
    used, size = board.stack_used()
    if duty(board):
        raise Failure("the spindle's PWM is on")
    yield f"clock {wiring.core_hz / 1e6:.0f} MHz; outputs driven from {first * 1e3:.2f} ms after reset, safe from then on"
    yield f"welcome line complete {board.seconds(cycle) * 1e3:.1f} ms after reset, {board.usart.baud():.0f} baud"
    yield f"stack at the start: {used} of {size} bytes"
    if used > size - 1024:
        raise Failure("less than 1 KiB of the stack is left")


def crystals(bench):
    """Boots with every known crystal, with an internal oscillator that is off by 4.5 %, without a crystal, and with an
    unknown one. With a known crystal the clock must be exact; otherwise the UART must tell the fault."""
    own = bench.wiring
    for mhz in (8, 12, 16, 25, None, 19):
        for error in (0.0, 0.045, -0.045):
            bench.wiring = replace(own, hse_hz=(mhz or 25) * MHZ)
            board = bench.fresh()
            board.peripherals["TIM11"].hsi_error = error
            board.rcc.hse_stands = mhz is None
            fault = mhz in (None, 19)
            bench.wait_text("[MSG:Board: no crystal" if fault else "Grbl 1.1h ['$' for help]", 1.5)
            # With a known crystal the PLL must run from the external oscillator, otherwise from the internal one. In
            # both cases the core must have its nominal clock.
            if board.rcc.values[PLLCFGR] >> 22 & 1 == fault or board.clocks[-1][2] != own.core_hz:
                raise Failure(f"{mhz} MHz: the core runs at {board.clocks[-1][2]} Hz, RCC_PLLCFGR {board.rcc.values[PLLCFGR]:#x}")
            if fault:
                for line in ("$X", "$J=G91X1F600", "G1X1F600"):
                    bench.host.send(line + "\n")
                    answered = len(bench.host.answers)
                    bench.wait(lambda before=answered: len(bench.host.answers) > before, 1, f"an answer to {line}")
                if not bench.status().startswith("<Alarm") or "ok" in bench.host.answers:
                    raise Failure("the machine is not locked")
            if not fault and f"[CRYSTAL:{mhz} MHz]" not in bench.ask("$I+"):
                raise Failure(f"{mhz} MHz are not told")
            if error == 0:
                yield f"{mhz or 'no'} MHz: {'locked, and told' if fault else 'exact clock'}, also with the internal oscillator up to 4.5 % off"
    bench.wiring = own


def own_pins(bench):
    """Writes a pin table with other pins into the image: the outputs must be at these pins. With a damaged table no pin
    may be driven, and the link must tell why. A table with the wrong oscillator must lock the machine."""
    own, image = bench.wiring, bench.image
    text = (TABLES / f"{own.name}.toml").read_text()
    changes = {"step_x": own.step[1], "step_y": own.step[0], "flood": own.limits[0], "limit_x": own.flood}
    for function, pin in changes.items():
        text = re.sub(rf'^{function} = ".*"$', f'{function} = "{pin}"', text, flags=re.MULTILINE)
    text = text.replace(f'name = "{own.name}"', 'name = "mine"')
    with tempfile.TemporaryDirectory() as folder:
        table, changed = Path(folder) / "mine.toml", Path(folder) / "mine.elf"

        def with_table(text):
            table.write_text(text)
            subprocess.run([bench.oxmill, "board", "write", image.path, table, "-o", changed], check=True, capture_output=True)
            return Image(changed)

        other = 25 if own.hse_hz == 8 * MHZ else 8
        wrong = with_table(text.replace('oscillator = "measured', f'oscillator = "{other} MHz'))
        bench.image = with_table(text)
        bytes_ = bytearray(changed.read_bytes())
        bytes_[bytes_.index(b"mine\0")] ^= 1
        changed.write_bytes(bytes_)
        damaged = Image(changed)
    steps = (own.step[1], own.step[0], own.step[2])
    bench.wiring = replace(own, step=steps, flood=own.limits[0], limits=(own.flood, *own.limits[1:]))
    bench.boot()
    board, scope = bench.board, Scope(bench.board)
    bench.ask("$J=G91X1F600")
    bench.wait_state("Idle", 5)
    moved = {step.axes for step in scope.steps()}
    bench.ask("M8")
    board.run(seconds=0.05)
    identity = bench.ask("$I+")
    if moved != {1} or not board.shown(own.limits[0]) or "[BOARD:mine]" not in identity:
        raise Failure(f"moved {moved}, flood {board.shown(own.limits[0])}, {identity}")
    yield f"steps of X at {steps[0]}, flood at {own.limits[0]}"
    bench.image, bench.wiring = damaged, own
    board = bench.fresh()
    bench.wait_text("[MSG:Board: no pin table", 1.5)
    driven = {f"{port}{pin}" for _, port, pin, level in board.edges if level in (0, 1)}
    if driven & {*own.step, *own.direction, own.enable, own.spindle, own.flood, own.pwm}:
        raise Failure(f"without a table {driven} are driven")
    if not bench.status().startswith("<Alarm"):
        raise Failure("the machine is not locked")
    yield "damaged: told, locked, no pin driven"
    bench.image = wrong
    board = bench.fresh()
    bench.wait_text("[MSG:Board: no crystal with the frequency of the pin table", 1.5)
    if board.clocks[-1][2] != own.core_hz or not bench.status().startswith("<Alarm"):
        raise Failure(f"with {other} MHz in the table the core runs at {board.clocks[-1][2]} Hz")
    bench.image, bench.wiring = image, own
    yield f"{other} MHz in the table: told, locked"


def tasks(bench):
    """Lists the enabled exceptions by priority, highest first; the step task must be above all other tasks."""
    bench.boot()
    nvic, image, step = bench.board.nvic, bench.image, 16 + bench.wiring.step_irq
    flash = next(data for at, data in image.segments if at == bench.board.part.flash_start)
    enabled = sorted((nvic.priority(number), number) for number in nvic.enabled if number not in (NMI, HARD_FAULT))
    names = {number: image.function(int.from_bytes(flash[4 * number :][:4], "little") & ~1) for _, number in enabled}
    served = [(priority, number) for priority, number in enabled if names[number] != "DefaultHandler_"]
    for priority, number in served:
        yield f"priority {15 - (priority >> 4):2}: {names[number]}{' (the step task)' if number == step else ''}"
    above = [names[number] for priority, number in served if priority <= nvic.priority(step) and number != step]
    if any(not name.endswith("PVD") for name in above):
        raise Failure(f"{above} may come before the step task")


def streamed(bench, job):
    """Streams a job by character counting: its steps must be those of the simulator, in the same order."""
    bench.boot()
    bench.settings(**JOB_SETTINGS)
    scope, host, board = Scope(bench.board), bench.host, bench.board
    board.refill_stack()
    bench.forget_masks()
    lines = len(host.answers)
    text = Path(job).read_text()
    begin = board.now
    host.stream(text)
    bench.wait(lambda: host.all_answered, 60, "the last answer")
    bench.wait_state("Idle", 60)
    errors = [answer for answer in host.answers[lines:] if answer != "ok"]
    if "splines" in bench.wiring.left_out and "error:141" in errors:
        raise LeftOut("this board has no room for splines")
    if errors:
        raise Failure(f"answers: {errors}")
    if board.usart.overruns or host.has_said("lost"):
        raise Failure("received bytes were lost")
    steps = [(step.axes, step.negative) for step in scope.steps()]
    expected, end = simulated(bench, job)
    if scope.counts() != list(end):
        raise Failure(f"the motors are at {scope.counts()} and not at {end}")
    first = next((k for k, (a, b) in enumerate(zip(steps, expected, strict=False)) if a != b), None)
    if first is not None or len(steps) != len(expected):
        raise Failure(f"step {first} of {len(steps)} differs from the simulator's {len(expected)} steps")
    mask, where = bench.longest_mask()
    used, size = board.stack_used()
    yield f"{Path(job).name}: {len(steps)} step events as in the simulator, ends at {end}, {(board.now - begin) / bench.wiring.core_hz:.2f} s"
    yield f"longest time masked {us(mask)} ({where}); stack {used} of {size} bytes"


def waiting_line(bench):
    """A line arrives byte by byte during a hold, so its last bytes wait in the serial task. After the hold the control
    task takes the first bytes. It must then call the serial task, which passes on the other bytes. Nothing else calls
    the serial task: no answer is being sent, and no byte arrives."""
    bench.boot()
    board, host = bench.board, bench.host
    for line in ("G1X.01F600", "G1X.125F600"):
        before = len(host.answers)
        for text in ("!", line + "\n"):
            host.send(text)
            board.run(seconds=0.05)
        if len(host.answers) != before:
            raise Failure("a hold takes lines: this proves nothing")
        # The supervisor of the watchdog also calls the serial task, but only every 100 ms. The test below allows 2 ms.
        resumed = board.seconds(host.send("~"))
        bench.wait(lambda wanted=before + 1: len(host.answers) >= wanted, 1, f"the answer to {line}")
        took = board.seconds(host.lines[-1][0]) - resumed
        yield f"{line} is answered {took * 1e3:.2f} ms after the end of a hold"
        if took > 2e-3:
            raise Failure("its last bytes have waited")
        if host.answers[before:] != ["ok"]:
            raise Failure(f"answers: {host.answers[before:]}")
        board.run(seconds=0.5)
