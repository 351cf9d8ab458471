"""TIM11 as far as it can measure the external oscillator: its channel 1 captures the divided oscillator (RM0383, "TIM11
option register 1", TI1_RMP = 2; RCC_CFGR, RTCPRE). It counts with the clock of APB2, which is the internal oscillator
while the firmware measures. Not modelled: everything else that the timer can do."""

from .peripheral import Misuse, Peripheral, Unmodelled
from .rcc import CFGR, HSI_HZ

CR1, SR, CCMR1, CCER, CNT, ARR, CCR1, OR = 0x00, 0x10, 0x18, 0x20, 0x24, 0x2C, 0x34, 0x50
CAPTURED = 2
OSCILLATOR = 2


class ClockMeter(Peripheral):
    CLOCK = (0x44, 18)
    REGISTERS = {
        CR1: ("CR1", 0, 1),
        SR: ("SR", 0, 0),
        CCMR1: ("CCMR1", 0, 0x0D),
        CCER: ("CCER", 0, 1),
        ARR: ("ARR", 0, 0xFFFF),
        CCR1: ("CCR1", 0, 0),
        OR: ("OR", 0, 3),
    }

    hsi_error = 0.0
    """Share by which the internal oscillator is too fast (data sheets: within 1 % at 25 degrees, -8 to 4.5 % from -40 to
    105 degrees)."""

    def reset(self):
        super().reset()
        self.begun, self.seen, self.read_one = None, 0, False

    def _captures(self):
        """Returns the number of captures so far, and the ticks from one to the next."""
        rcc = self.board.rcc
        divider = rcc.values[CFGR] >> 16 & 31
        if self.values[OR] != OSCILLATOR or divider < 2 or self.values[CCMR1] != 0x0D or not self.values[CCER]:
            raise Unmodelled("TIM11 has a model for the measurement of the oscillator only")
        if rcc.pclk2 != HSI_HZ:
            raise Misuse("TIM11 measures the oscillator by a clock that is not the internal oscillator")
        if rcc.hse_stands or not rcc.values[0] >> 16 & 1:
            return 0, 1.0
        ticks = 8 * divider * HSI_HZ * (1 + self.hsi_error) / self.board.wiring.hse_hz
        return int((self.board.now - self.begun) / ticks + 0.3), ticks

    def write(self, offset, value):
        super().write(offset, value)
        if offset == CR1 and value & 1:
            if not self.values[ARR]:
                raise Misuse("TIM11 does not count while its limit is 0")
            self.begun, self.seen, self.read_one = self.board.now, 0, False

    def read(self, offset):
        if offset not in (SR, CCR1) or self.begun is None:
            return super().read(offset)
        count, ticks = self._captures()
        if offset == SR:
            return CAPTURED if count > self.seen else 0
        if count > self.seen + 1 and self.read_one:
            raise Misuse("a capture of TIM11 was lost before it was read")
        self.seen, self.read_one = count, True
        return round((count - 0.3) * ticks) & 0xFFFF
