"""External interrupt controller (RM0390 chapter 10, RM0383 chapter 10), as far as the voltage detector uses it.

Modelled: line 16, which follows the detector's output: masks, both edges, software trigger, clearing the pending bit by
writing 1.
Not modelled: the lines of pins (using their bits fails), events.
"""

from .peripheral import Peripheral

IMR, EMR, RTSR, FTSR, SWIER, PR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
PVD_LINE, PVD_IRQ = 1 << 16, 1
"""RM0383 and RM0390, "External interrupt/event line mapping" and the vector table."""


class Exti(Peripheral):
    REGISTERS = {
        IMR: ("IMR", 0, PVD_LINE),
        EMR: ("EMR", 0, 0),
        RTSR: ("RTSR", 0, PVD_LINE),
        FTSR: ("FTSR", 0, PVD_LINE),
        SWIER: ("SWIER", 0, PVD_LINE),
        PR: ("PR", 0, PVD_LINE),
    }

    def write(self, offset, value):
        if offset == PR:
            self.values[PR] &= ~value
            self.values[SWIER] &= ~value
        else:
            rises = value & ~self.values[SWIER] if offset == SWIER else 0
            super().write(offset, value)
            self.values[PR] |= rises & self.values[IMR]
        self._call()

    def edge(self, line, rising):
        """Call when the source of a line has changed."""
        if self.values[RTSR if rising else FTSR] & line:
            self.values[PR] |= line
            self._call()

    def _call(self):
        self.board.nvic.level(PVD_IRQ, bool(self.values[PR] & self.values[IMR] & PVD_LINE))
