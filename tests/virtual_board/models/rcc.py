"""Reset and clock control (RM0390 chapter 6, RM0383 chapter 6).

Modelled: HSI; HSE (crystal or bypass, as on the board: if the firmware selects the wrong one, HSE never becomes ready);
the main PLL with its limits; the system clock and the bus prescalers with their limits; peripheral clock enables, which
take a few cycles to take effect (errata sheets, "Delay after an RCC peripheral clock enabling"), and resets; LSI; the
reset flags; a failing HSE with clock security (without it, the emulation fails). Oscillators and PLL are ready at once:
the firmware's waiting loops see the bit at the first read.
Not modelled: the other PLLs, MCO, RTC and the backup domain, start-up times. It is misuse if the processor sleeps while
the low-power enables would stop a clock that is on.
"""

from .nvic import NMI
from .peripheral import Misuse, Peripheral

CR, PLLCFGR, CFGR, CIR = 0x00, 0x04, 0x08, 0x0C
AHB1RSTR, AHB2RSTR, APB1RSTR, APB2RSTR = 0x10, 0x14, 0x20, 0x24
AHB1ENR, AHB2ENR, APB1ENR, APB2ENR = ENABLES = 0x30, 0x34, 0x40, 0x44
AHB1LPENR, AHB2LPENR, APB1LPENR, APB2LPENR = SLEEP_ENABLES = 0x50, 0x54, 0x60, 0x64
CSR, DCKCFGR = 0x74, 0x8C

HSI_HZ = 16_000_000
LSI_HZ = 32_000
"""Typical frequencies of the internal oscillators: RM0383 and RM0390, "HSI clock" and "LSI clock"."""

HSE_ON, CLOCK_SECURITY, PLL_ON = 1 << 16, 1 << 19, 1 << 24
SOFTWARE_RESET, WATCHDOG_RESET, POWER_ON_RESET = 1 << 28 | 1 << 26, 1 << 29 | 1 << 26, 1 << 27 | 1 << 26 | 1 << 25
"""RCC_CSR: the flag of the reset's cause, and PINRSTF, because every reset also pulls the reset pin; at power-up also
BORRSTF."""


class Rcc(Peripheral):
    REGISTERS = {
        CR: ("CR", 0x81, 0x010D_0001),
        PLLCFGR: ("PLLCFGR", 0x2400_3010, 0x7F43_7FFF),
        CFGR: ("CFGR", 0, 0x001F_FCF3),
        AHB1RSTR: ("AHB1RSTR", 0, 0x0060_10FF),
        AHB2RSTR: ("AHB2RSTR", 0, 0x80),
        APB1RSTR: ("APB1RSTR", 0, 0x1002_000F),
        APB2RSTR: ("APB2RSTR", 0, 0x0000_4013),
        AHB1ENR: ("AHB1ENR", 0, 0x0060_10FF),
        AHB2ENR: ("AHB2ENR", 0, 0x80),
        APB1ENR: ("APB1ENR", 0, 0x1002_000F),
        APB2ENR: ("APB2ENR", 0, 0x0004_4013),
        AHB1LPENR: ("AHB1LPENR", 0, 0xFFFF_FFFF),
        AHB2LPENR: ("AHB2LPENR", 0, 0xFFFF_FFFF),
        APB1LPENR: ("APB1LPENR", 0, 0xFFFF_FFFF),
        APB2LPENR: ("APB2LPENR", 0, 0xFFFF_FFFF),
        CSR: ("CSR", 0x0E00_0000, 0x0100_0001),
        DCKCFGR: ("DCKCFGR", 0, 0x0100_0000),
    }

    def __init__(self, name, board):
        self.flags = POWER_ON_RESET
        self.hse_stands = False
        """Whether the oscillator has failed."""
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.values[CSR] = self.flags
        self.values.update(zip(SLEEP_ENABLES, self.board.part.asleep, strict=True))
        self.arrives = {}
        """Maps each enabled clock, as (offset of the register, bit), to the core cycle from which it runs."""
        self.all_there = 0
        """The cycle from which all enabled clocks run."""
        self.hclk, self.pclk1, self.pclk2 = HSI_HZ, HSI_HZ, HSI_HZ

    def note_reset(self, flags):
        """Records the cause of the coming reset; flags add up until RMVF clears them."""
        self.flags = self.values[CSR] & 0xFE00_0000 | flags

    def read(self, offset):
        value = super().read(offset)
        if offset == CR:
            ready = (value & 1) << 1
            if value >> 16 & 1 and not self.hse_stands and bool(value >> 18 & 1) == self.board.wiring.hse_bypass:
                ready |= 1 << 17
            if value >> 24 & 1:
                ready |= 1 << 25
            return value & ~0x0202_0002 | ready
        if offset == CFGR:
            return value & ~0xC | (value & 3) << 2
        if offset == CSR:
            return value & ~2 | (value & 1) << 1
        return value

    def write(self, offset, value):
        if offset == CR:
            # Ready bits and calibration are read-only. The PLL must not be switched off while it is in use.
            value &= 0x010D_00F9
            if self.values[CFGR] & 3 == 2 and not value >> 24 & 1:
                raise Misuse("RCC_CR: the PLL is switched off while it is the system clock")
        if offset == PLLCFGR and self.values[CR] >> 24 & 1:
            raise Misuse("RCC_PLLCFGR is written while the PLL is on")
        if offset == CFGR:
            value &= ~0xC
        if offset == CSR:
            flags = 0 if value >> 24 & 1 else self.values[CSR] & 0xFE00_0000
            self.values[CSR] = flags | value & 1
            return
        enabled = value & ~self.values[offset] if offset in ENABLES else 0
        super().write(offset, value)
        if enabled:
            self._enable(offset, enabled)
        if offset in (AHB1RSTR, AHB2RSTR, APB1RSTR, APB2RSTR):
            for peripheral in self.board.peripherals.values():
                if peripheral.CLOCK and peripheral.CLOCK[0] - 0x20 == offset and value >> peripheral.CLOCK[1] & 1:
                    peripheral.reset()
                    self.board.replan()
        if offset == CFGR or offset == DCKCFGR:
            self._clocks()

    def _enable(self, offset, bits):
        """Switches clocks on. A clock on the AHB starts after two AHB cycles, a clock on another bus after one cycle of
        that bus and one of the AHB."""
        bus = {APB1ENR: self.pclk1, APB2ENR: self.pclk2}.get(offset)
        self.all_there = self.board.now + (2 if bus is None else 1 + self.hclk // bus)
        for bit in range(32):
            if bits >> bit & 1:
                self.arrives[offset, bit] = self.all_there

    def check_clock(self, peripheral):
        """Raises Misuse if a peripheral is used whose clock does not run."""
        offset, bit = peripheral.CLOCK
        if not self.values[offset] >> bit & 1:
            raise Misuse(f"{peripheral.name} is used while its clock is off")
        if self.board.now < self.all_there and self.board.now < self.arrives.get((offset, bit), 0):
            raise Misuse(f"{peripheral.name} is used before its clock, which has just been switched on, is there")

    def check_sleep(self):
        """Called when the processor goes to sleep: raises Misuse if an enabled clock would stop, because the firmware
        relies on its peripherals during sleep."""
        for enable, asleep in zip(ENABLES, SLEEP_ENABLES, strict=True):
            if standing := self.values[enable] & ~self.values[asleep]:
                names = {p.name: p.CLOCK for p in self.board.peripherals.values() if p.CLOCK}
                names = [name for name, (offset, bit) in names.items() if offset == enable and standing >> bit & 1]
                raise Misuse(f"the processor sleeps, and the clock of {', '.join(names)} stands (RCC, {asleep:#x})")

    def lose_hse(self):
        """Makes the oscillator fail, and the PLL with it: the system clock becomes HSI, and the NMI is taken."""
        self.hse_stands = True
        if not self.values[CR] & CLOCK_SECURITY:
            self.board.failure = "the core has no clock any more: outputs stay as they are until the watchdog resets"
            return
        self.values[CR] &= ~(HSE_ON | PLL_ON)
        self.values[CFGR] &= ~3
        self._slow_down()
        self.board.nvic.pending.add(NMI)
        self.board.look()

    def _slow_down(self):
        """Makes HSI the system clock, even while models run. The ratios of the clocks do not change. The watchdog keeps
        its timeout in seconds; other events are scheduled in core cycles and come later in real time."""
        divider1, divider2 = self.hclk // self.pclk1, self.hclk // self.pclk2
        self.hclk = HSI_HZ
        self.pclk1, self.pclk2 = HSI_HZ // divider1, HSI_HZ // divider2
        self.board.slow_down(HSI_HZ)

    def timer_clock(self, bus_clock):
        """Returns the clock, Hz, of the timers on a bus. Without TIMPRE: the bus clock, or twice the bus clock if the
        bus has a divider. With TIMPRE: the core's clock if the divider is at most 4, otherwise four times the bus
        clock."""
        divider = self.hclk // bus_clock
        if self.values[DCKCFGR] >> 24 & 1:
            return self.hclk if divider <= 4 else 4 * bus_clock
        return bus_clock if divider == 1 else 2 * bus_clock

    def pll_hz(self):
        part, value = self.board.part, self.values[PLLCFGR]
        source = self.board.wiring.hse_hz if value >> 22 & 1 else HSI_HZ
        m, n, p = value & 63, value >> 6 & 511, 2 * ((value >> 16 & 3) + 1)
        vco_in = source // m if m >= 2 else 0
        if not 950_000 <= vco_in <= 2_100_000 or not 50 <= n <= 432:
            raise Misuse(f"RCC_PLLCFGR {value:#010x}: input of {vco_in} Hz, times {n}")
        vco = source * n // m
        if not part.vco_hz <= vco <= 432_000_000 or vco // p > part.core_hz:
            raise Misuse(f"RCC_PLLCFGR {value:#010x}: oscillator at {vco} Hz, output {vco // p} Hz")
        return vco // p

    def _clocks(self):
        value = self.values[CFGR]
        source = value & 3
        if source == 0:
            if self.hclk > HSI_HZ:
                self._slow_down()
                return
            system = HSI_HZ
        elif source == 1:
            if not self.read(CR) >> 17 & 1:
                return
            system = self.board.wiring.hse_hz
        elif source == 2:
            uses_hse = self.values[PLLCFGR] >> 22 & 1
            if not self.read(CR) >> 25 & 1 or uses_hse and not self.read(CR) >> 17 & 1:
                raise Misuse("RCC_CFGR: the PLL is chosen and is not ready")
            system = self.pll_hz()
        else:
            raise Misuse("RCC_CFGR: SW = 3 is not allowed on these parts")
        ahb, apb1, apb2 = value >> 4 & 15, value >> 10 & 7, value >> 13 & 7
        hclk = system // (1 if ahb < 8 else (2, 4, 8, 16, 64, 128, 256, 512)[ahb - 8])
        pclk1, pclk2 = hclk >> max(0, apb1 - 3), hclk >> max(0, apb2 - 3)
        part = self.board.part
        if hclk > part.core_hz or pclk1 > part.apb1_hz or pclk2 > part.apb2_hz:
            raise Misuse(f"clocks beyond the part's limits: core {hclk}, APB1 {pclk1}, APB2 {pclk2} Hz")
        self.board.check_supply(hclk)
        if (hclk, pclk1, pclk2) != (self.hclk, self.pclk1, self.pclk2):
            self.board.change_clock(hclk)
            self.hclk, self.pclk1, self.pclk2 = hclk, pclk1, pclk2
