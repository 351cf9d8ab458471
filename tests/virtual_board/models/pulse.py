"""The advanced timers TIM1 and TIM8 as one-pulse slaves of TIM5 (RM0390 chapter 16, RM0383 chapter 12).

Modelled: one-pulse mode started by a trigger (SMS = 110, and TS of TIM5), compare events of four channels with their
DMA requests, the stop at the update event, reset, a stop by software. A trigger takes effect after a fixed number of
clocks (`SYNCHRONIZE`).
Not modelled: all other modes, prescaler, repetition, outputs, dead time, interrupts, reading the status.

On a real part a trigger that arrives while the counter runs is ignored, and a step is lost. Here it is misuse.
"""

from .peripheral import Misuse, Peripheral, Unmodelled
from .readings import is_chosen

CR1, CR2, SMCR, DIER, EGR, CNT, ARR = 0x00, 0x04, 0x08, 0x0C, 0x14, 0x24, 0x2C
COMPARE = (0x34, 0x38, 0x3C, 0x40)
CEN, OPM = 1 << 0, 1 << 3
TRIGGERED_BY_TIM5 = {"TIM1": 0b110 | 0b000 << 4, "TIM8": 0b110 | 0b011 << 4}
"""SMS and TS of TIMx_SMCR; the table "TIMx internal trigger connection" there has TIM5 as ITR0 of TIM1 and as ITR3 of
TIM8."""
SYNCHRONIZE, QUICKER, SLOWER = 4, 1, 8
"""Clocks from the trigger's event to the first count; `QUICKER` and `SLOWER` for the readings `quick-trigger` and
`slow-trigger` (readings.py)."""


def synchronize():
    """Returns the clocks from the trigger's event to the first count, for the chosen reading."""
    return QUICKER if is_chosen("quick-trigger") else SLOWER if is_chosen("slow-trigger") else SYNCHRONIZE


class Pulse:
    """One run of the counter."""

    def __init__(self, ends):
        self.ends = ends
        self.cut_at = None


class PulseTimer(Peripheral):
    REGISTERS = {
        CR1: ("CR1", 0, CEN | OPM),
        CR2: ("CR2", 0, 0),
        SMCR: ("SMCR", 0, 0b0111_0111),
        DIER: ("DIER", 0, 0x1E00),
        EGR: ("EGR", 0, 1),
        CNT: ("CNT", 0, 0xFFFF),
        ARR: ("ARR", 0xFFFF, 0xFFFF),
    } | {offset: (f"CCR{n + 1}", 0, 0xFFFF) for n, offset in enumerate(COMPARE)}

    def __init__(self, name, board):
        self.CLOCK = (0x44, {"TIM1": 0, "TIM8": 1}[name])
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.cut()
        self.pulse = None
        for dma in self.board.dma:
            dma.forget(self.name)

    pulse = None

    def runs(self):
        """Returns whether a pulse is being output."""
        return self.pulse is not None and self.pulse.cut_at is None and self.board.now < self.pulse.ends

    def cut(self):
        if self.runs():
            self.pulse.cut_at = self.board.now

    def read(self, offset):
        value = super().read(offset)
        if offset == CNT and self.pulse is not None:
            raise Unmodelled(f"{self.name}: the count in or after a pulse")
        return value | self.runs() if offset == CR1 else value

    def write(self, offset, value):
        if offset == CR1 and value & CEN:
            raise Unmodelled(f"{self.name} is started by software")
        if self.runs() and offset not in (CR1, SMCR, DIER):
            raise Misuse(f"{self.name}: a register is written while a pulse is out")
        super().write(offset, value)
        if offset == CR1:
            self.cut()
        if offset == SMCR and value & 7 and value != TRIGGERED_BY_TIM5[self.name]:
            raise Unmodelled(f"{self.name}_SMCR {value:#x}")
        if offset == EGR:
            self.values[EGR] = 0

    def trigger(self, at):
        """Called when TIM5 has reached a compare value, at cycle `at`."""
        if not self.values[SMCR] & 7:
            return
        if not self.values[CR1] & OPM:
            raise Unmodelled(f"{self.name} is triggered and not in one-pulse mode")
        if self.pulse is not None and self.pulse.cut_at is not None:
            raise Unmodelled(f"{self.name} is triggered in the middle of its count")
        rcc = self.board.rcc
        clock = rcc.hclk // rcc.timer_clock(rcc.pclk2)
        start = at + synchronize() * clock
        if self.pulse is not None and start < self.pulse.ends:
            raise Misuse(f"{self.name} is triggered while a pulse is out: a step is lost")
        self.pulse = Pulse(start + (self.values[ARR] + 1) * clock)
        for channel, offset in enumerate(COMPARE):
            count = self.values[offset]
            if self.values[DIER] >> 9 + channel & 1 and 0 < count <= self.values[ARR]:
                who, when = f"{self.name}_CH{channel + 1}", start + count * clock
                for dma in self.board.dma:
                    dma.ask(who, when, self.pulse)
