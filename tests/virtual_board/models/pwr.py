"""Power controller (RM0390 chapter 5, RM0383 chapter 5).

Modelled: voltage scaling with the maximum core clock of each scale, over-drive of the STM32F446 (both ready at once);
the voltage detector, its threshold and its line to EXTI.
Not modelled: sleep modes, regulator modes, the detector's hysteresis of 100 mV.
"""

from .exti import PVD_LINE
from .peripheral import Misuse, Peripheral

CR, CSR = 0x00, 0x04
VOS, ODEN, ODSWEN = 3 << 14, 1 << 16, 1 << 17
PVDE, PLS, PVDO = 1 << 4, 7 << 5, 1 << 2
THRESHOLDS_V = (2.0, 2.1, 2.3, 2.5, 2.6, 2.7, 2.8, 2.9)
"""Thresholds of the voltage detector, by PLS of PWR_CR."""


class Pwr(Peripheral):
    REGISTERS = {CR: ("CR", 0, VOS | PVDE | PLS | 1 << 8), CSR: ("CSR", 0, 0)}
    CLOCK = (0x40, 28)

    def reset(self):
        super().reset()
        self.values[CR] = self.board.part.pwr_cr_reset
        self.low = False

    def row(self, offset):
        name, value, modelled = super().row(offset)
        if offset == CR and self.board.part.over_drive_hz:
            modelled |= ODEN | ODSWEN
        return name, value, modelled

    def read(self, offset):
        value = super().read(offset)
        if offset == CSR:
            cr = self.values[CR]
            return PVDO * self.low | 1 << 14 | (cr & ODEN) | (cr & ODSWEN)
        return value

    def write(self, offset, value):
        if offset == CR and value & ODSWEN and not self.values[CR] & ODEN:
            raise Misuse("PWR_CR: ODSWEN before over-drive is ready")
        if offset == CR and (value ^ self.values[CR]) & VOS and self.board.rcc.values[0] >> 24 & 1:
            raise Misuse("PWR_CR: VOS is changed while the PLL is on")
        super().write(offset, value)
        self.supply_changed()

    def supply_changed(self):
        """Compares the supply with the threshold."""
        cr = self.values[CR]
        low = bool(cr & PVDE) and self.board.supply_v < THRESHOLDS_V[(cr & PLS) >> 5]
        if low != self.low:
            self.low = low
            self.board.exti.edge(PVD_LINE, low)

    def limit(self):
        """Returns the maximum core clock for the present voltage scale."""
        part, cr = self.board.part, self.values[CR]
        if part.over_drive_hz and cr & ODEN and cr & ODSWEN:
            return part.over_drive_hz
        return part.scale_hz[(cr & VOS) >> 14]
