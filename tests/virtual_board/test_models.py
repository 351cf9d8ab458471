"""Tests each model against register traces worked out by hand from the reference manuals, without an image or a
processor.

`cargo xtask virtual` runs these tests before the boards.
"""

import unittest
from types import SimpleNamespace

from .host import Host
from .models import dma, exti, flash, gpio, iwdg, nvic, otg, pulse, pwr, rcc, readings, timer, usart
from .models.peripheral import NEVER, Misuse, Unmodelled
from .parts import BOARDS
from .profile import readable
from .usb import SHORT_S, UsbHost


class Bench:
    """Replaces the board for a model; the tests set the time."""

    def __init__(self, wiring=BOARDS["blackpill_f411"], hclk=96_000_000, pclk1=48_000_000):
        self.wiring, self.part = wiring, wiring.part
        self.now = 0
        self.memory = {}
        self.edges, self.lines, self.resets, self.clock = [], {}, [], 16_000_000
        self.peripherals = {}
        self.nvic = SimpleNamespace(level=lambda irq, up: self.lines.__setitem__(irq, up))
        self.rcc = SimpleNamespace(
            hclk=hclk, pclk1=pclk1, pclk2=hclk, values={0: 0}, timer_clock=lambda bus: bus if bus == hclk else 2 * bus
        )
        self.dma = []
        self.stalled, self.slow = 0.0, []
        self.limit = 1 << 40
        self.supply_v = 3.3
        self.exti = SimpleNamespace(edge=lambda line, rising: None)
        self.hz = hclk

    def replan(self):
        pass

    look = replan

    def edge(self, port, pin, level, at=None):
        self.edges.append((self.now if at is None else at, port, pin, level))

    def cycles(self, seconds):
        return round(seconds * self.hz)

    def change_clock(self, hz):
        self.clock = hz

    def slow_down(self, hz):
        self.slow.append(hz)

    def check_supply(self, hclk):
        if hclk > self.limit:
            raise Misuse("supply")

    def power_left(self, _):
        return True

    def stall(self, seconds):
        self.stalled += seconds

    def write_memory(self, address, data):
        for k, byte in enumerate(data):
            self.memory[address + k] = byte

    def read_memory(self, address, size):
        return bytes(self.memory.get(address + k, 0xFF) for k in range(size))

    def dma_load(self, address):
        return int.from_bytes(self.read_memory(address, 4), "little")

    def request_reset(self, flags, why):
        self.resets.append((self.now, flags, why))

    def until(self, model, cycle):
        """Advances time and calls the model at its due times, as the board does."""
        while model.due <= cycle:
            self.now = model.due
            model.advance(self.now)
        self.now = cycle


def advance_until(bench, models, cycle):
    """Advances several models in the order of their events."""
    while (due := min(model.due for model in models)) <= cycle:
        bench.now = max(bench.now, due)
        next(model for model in models if model.due == due).advance(bench.now)
    bench.now = cycle


class GpioTraces(unittest.TestCase):
    def test_output_by_bsrr_and_odr(self):
        bench = Bench()
        port = gpio.Gpio("GPIOA", bench)
        # After a reset PA13 to PA15 belong to the debug port (MODER 0xA800_0000), all others are inputs.
        self.assertEqual(bench.edges, [(0, "A", 13, "AF"), (0, "A", 14, "AF"), (0, "A", 15, "AF")])
        bench.edges.clear()
        bench.now = 5
        port.write(gpio.BSRR, 1 << 3)
        self.assertEqual(bench.edges, [], "an input does not show ODR")
        port.write(gpio.MODER, 0xA800_0000 | 1 << 6)
        bench.now = 7
        # The word both sets and resets PA3. Setting takes precedence, so nothing changes; later, bit 19 alone resets
        # PA3.
        port.write(gpio.BSRR, 1 << 3 | 1 << 19)
        bench.now = 9
        self.assertEqual(port.read(gpio.IDR) & 8, 8)
        port.write(gpio.BSRR, 1 << 19)
        self.assertEqual(port.read(gpio.IDR) & 8, 0)
        port.write(gpio.ODR, 0x0008)
        self.assertEqual(bench.edges, [(5, "A", 3, 1), (9, "A", 3, 0), (9, "A", 3, 1)])
        self.assertEqual(port.read(gpio.BSRR), 0)
        self.assertEqual(port.read(gpio.IDR) & 8, 8)

    def test_inputs_pulls_and_open_drain(self):
        bench = Bench()
        port = gpio.Gpio("GPIOC", bench)
        # PC0 pulled up, PC1 pulled down, PC2 floating, PC3 driven low against its pull-up.
        port.write(gpio.PUPDR, 0b01_00_10_01)
        port.drive(3, 0)
        self.assertEqual(port.read(gpio.IDR) & 0b1011, 0b0001)
        self.assertEqual(port.level(2), None)
        # Open drain: a 1 leaves the level to the pull-up, and a 0 drives the pin low.
        port.write(gpio.OTYPER, 1)
        port.write(gpio.MODER, 1)
        self.assertEqual(port.level(0), 0)
        port.write(gpio.BSRR, 1)
        self.assertEqual((port.shown[0], port.level(0)), (None, 1))
        # AFRL holds four bits per pin: function 7 on PC1.
        port.write(gpio.MODER, 0b10_00)
        port.write(gpio.AFRL, 7 << 4)
        self.assertEqual((port.function(1), port.function(0)), (7, None))
        with self.assertRaises(Unmodelled):
            port.write(0x1C, 0)


class RccTraces(unittest.TestCase):
    def test_96_mhz_from_a_25_mhz_crystal(self):
        bench = Bench()
        model = rcc.Rcc("RCC", bench)
        bench.rcc = model
        self.assertEqual(model.read(rcc.CR) & 3, 3, "HSI is on and ready after reset")
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 16)
        self.assertTrue(model.read(rcc.CR) >> 17 & 1)
        # 25 MHz / 25 * 192 / 2 = 96 MHz: M = 25, N = 192, P = 0 (2), source HSE, Q = 4.
        model.write(rcc.PLLCFGR, 25 | 192 << 6 | 1 << 22 | 4 << 24 | 2 << 28)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 24)
        with self.assertRaises(Misuse):
            model.write(rcc.PLLCFGR, 0)
        # APB1 divided by 2 (0b100), then the PLL as system clock.
        model.write(rcc.CFGR, 0b100 << 10)
        self.assertEqual((model.hclk, model.pclk1), (16_000_000, 8_000_000))
        model.write(rcc.CFGR, 0b100 << 10 | 2)
        self.assertEqual((model.hclk, model.pclk1, model.pclk2), (96_000_000, 48_000_000, 96_000_000))
        self.assertEqual(model.read(rcc.CFGR) >> 2 & 3, 2)
        # Timers of a divided bus run at twice its clock.
        self.assertEqual(model.timer_clock(model.pclk1), 96_000_000)
        with self.assertRaises(Misuse):
            model.write(rcc.CR, model.read(rcc.CR) & ~(1 << 24))

    def test_an_enabled_clock_takes_a_few_cycles(self):
        bench = Bench(BOARDS["nucleo_f446re"])
        model = rcc.Rcc("RCC", bench)
        model.hclk, model.pclk1 = 180_000_000, 45_000_000
        for offset, bit, cycles in ((rcc.AHB1ENR, 21, 2), (rcc.APB1ENR, 28, 5), (rcc.APB2ENR, 14, 2)):
            peripheral = SimpleNamespace(name="it", CLOCK=(offset, bit))
            with self.assertRaises(Misuse):
                model.check_clock(peripheral)
            model.pclk2 = model.hclk
            model.write(offset, 1 << bit)
            bench.now += cycles - 1
            with self.assertRaises(Misuse):
                model.check_clock(peripheral)
            bench.now += 1
            model.check_clock(peripheral)
        # Switching another clock on does not affect a clock that is already on.
        model.write(rcc.APB1ENR, 1 << 28 | 1)
        model.check_clock(SimpleNamespace(name="it", CLOCK=(rcc.APB1ENR, 28)))

    def test_clocks_while_the_processor_sleeps(self):
        for wiring, stands in ((BOARDS["blackpill_f411"], True), (BOARDS["nucleo_f446re"], False)):
            bench = Bench(wiring)
            model = rcc.Rcc("RCC", bench)
            model.write(rcc.AHB1ENR, 7 | 3 << 21)
            model.write(rcc.APB1ENR, 0xF | 1 << 28)
            model.check_sleep()
            # Bit 0 enables TIM1. After a reset of an F411, the clock of TIM1 stops while the processor sleeps.
            model.write(rcc.APB2ENR, 1 | 1 << 14)
            if stands:
                with self.assertRaises(Misuse):
                    model.check_sleep()
                model.write(rcc.APB2LPENR, model.read(rcc.APB2LPENR) | 1)
            model.check_sleep()

    def test_bypass_limits_and_reset_flags(self):
        bench = Bench(BOARDS["nucleo_f446re"])
        model = rcc.Rcc("RCC", bench)
        # The Nucleo has no crystal: without HSEBYP (bit 18) the oscillator never becomes ready.
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 16)
        self.assertFalse(model.read(rcc.CR) >> 17 & 1)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 18)
        self.assertTrue(model.read(rcc.CR) >> 17 & 1)
        # 8 MHz / 4 * 180 / 2 = 180 MHz, but undivided APB1 would exceed its 45 MHz.
        model.write(rcc.PLLCFGR, 4 | 180 << 6 | 1 << 22 | 8 << 24 | 2 << 28)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 24)
        with self.assertRaises(Misuse):
            model.write(rcc.CFGR, 2)
        model.write(rcc.CFGR, 0b101 << 10 | 0b100 << 13 | 2)
        self.assertEqual((model.hclk, model.pclk1, model.pclk2), (180_000_000, 45_000_000, 90_000_000))
        # Power-on sets PORRSTF, PINRSTF, BORRSTF; a watchdog reset adds IWDGRSTF (bit 29); RMVF clears all.
        self.assertEqual(model.read(rcc.CSR) >> 24, 0x0E)
        model.note_reset(rcc.WATCHDOG_RESET)
        model.reset()
        self.assertEqual(model.read(rcc.CSR) >> 24, 0x2E)
        model.write(rcc.CSR, 1 << 24)
        self.assertEqual(model.read(rcc.CSR) >> 24, 0)


    def test_a_crystal_that_fails(self):
        bench = Bench()
        bench.nvic, bench.failure = nvic.Nvic(bench, 86), None
        model = rcc.Rcc("RCC", bench)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 16)
        model.write(rcc.PLLCFGR, 25 | 192 << 6 | 1 << 22 | 4 << 24 | 2 << 28)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 24)
        model.write(rcc.CFGR, 0b100 << 10 | 2)
        # Without CSSON (bit 19) the core has no clock after the failure.
        model.lose_hse()
        self.assertIn("no clock", bench.failure)
        bench.failure, model.hse_stands = None, False
        # With CSSON, HSE and PLL go off and HSI becomes the system clock; the NMI is taken despite any mask.
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 19)
        model.lose_hse()
        self.assertIsNone(bench.failure)
        self.assertEqual((model.read(rcc.CR) >> 16 & 0x303, model.read(rcc.CFGR) & 0xF), (0, 0))
        self.assertEqual((model.hclk, model.pclk1, model.pclk2), (16_000_000, 8_000_000, 16_000_000))
        self.assertEqual(bench.slow, [16_000_000])
        self.assertEqual(bench.nvic.takeable(1, 0x10), (nvic.NMI, False))

    def test_back_to_the_clock_of_a_reset(self):
        bench = Bench()
        model = rcc.Rcc("RCC", bench)
        model.write(rcc.PLLCFGR, 16 | 192 << 6 | 4 << 24 | 2 << 28)
        model.write(rcc.CR, model.read(rcc.CR) | 1 << 24)
        model.write(rcc.CFGR, 0b100 << 10 | 2)
        self.assertEqual((bench.clock, model.pclk1), (96_000_000, 48_000_000))
        model.write(rcc.CFGR, 0b100 << 10)
        self.assertEqual((model.hclk, model.pclk1, bench.slow), (16_000_000, 8_000_000, [16_000_000]))


class PwrTraces(unittest.TestCase):
    def test_f411_wakes_up_for_84_mhz(self):
        model = pwr.Pwr("PWR", Bench(BOARDS["blackpill_f411"]))
        self.assertEqual((model.read(pwr.CR), model.limit()), (0x8000, 84_000_000))
        model.write(pwr.CR, 0xC000)
        self.assertEqual(model.limit(), 100_000_000)
        with self.assertRaises(Unmodelled):
            model.write(pwr.CR, 0xC000 | 1 << 16)

    def test_f446_over_drive_comes_in_two_steps(self):
        bench = Bench(BOARDS["nucleo_f446re"])
        model = pwr.Pwr("PWR", bench)
        self.assertEqual(model.limit(), 168_000_000)
        with self.assertRaises(Misuse):
            model.write(pwr.CR, 0xC000 | 1 << 17)
        model.write(pwr.CR, 0xC000 | 1 << 16)
        self.assertEqual((model.read(pwr.CSR) >> 16 & 3, model.limit()), (1, 168_000_000))
        model.write(pwr.CR, 0xC000 | 3 << 16)
        self.assertEqual((model.read(pwr.CSR) >> 16 & 3, model.limit()), (3, 180_000_000))
        bench.rcc.values[0] = 1 << 24
        with self.assertRaises(Misuse):
            model.write(pwr.CR, 0x8000 | 3 << 16)


class ExtiTraces(unittest.TestCase):
    def test_the_voltage_detector(self):
        bench = Bench()
        bench.exti = exti.Exti("EXTI", bench)
        model = pwr.Pwr("PWR", bench)
        # Rising edge of line 16, threshold 7: 2.9 V.
        bench.exti.write(exti.RTSR, 1 << 16)
        bench.exti.write(exti.IMR, 1 << 16)
        model.write(pwr.CR, 0x8000 | 1 << 4 | 7 << 5)
        self.assertEqual((model.read(pwr.CSR) >> 2 & 1, bench.lines[1]), (0, False))
        bench.supply_v = 2.85
        model.supply_changed()
        self.assertEqual((model.read(pwr.CSR) >> 2 & 1, bench.exti.read(exti.PR), bench.lines[1]), (1, 1 << 16, True))
        # A 1 clears the pending bit; the falling edge is not enabled.
        bench.exti.write(exti.PR, 1 << 16)
        bench.supply_v = 3.3
        model.supply_changed()
        self.assertEqual((model.read(pwr.CSR) >> 2 & 1, bench.exti.read(exti.PR), bench.lines[1]), (0, 0, False))

    def test_masked_and_by_software(self):
        bench = Bench()
        model = exti.Exti("EXTI", bench)
        model.write(exti.FTSR, 1 << 16)
        model.edge(1 << 16, rising=False)
        # The pending bit is set although the interrupt is masked, and takes effect as soon as it is unmasked.
        self.assertEqual((model.read(exti.PR), bench.lines[1]), (1 << 16, False))
        model.write(exti.IMR, 1 << 16)
        self.assertTrue(bench.lines[1])
        model.write(exti.PR, 1 << 16)
        model.write(exti.SWIER, 1 << 16)
        self.assertEqual((model.read(exti.PR), bench.lines[1]), (1 << 16, True))
        with self.assertRaises(Unmodelled):
            model.write(exti.IMR, 1)


class FlashTraces(unittest.TestCase):
    def unlocked(self, bench):
        model = flash.Flash("FLASH", bench)
        model.write(flash.KEYR, 0x4567_0123)
        self.assertEqual(model.read(flash.CR), 1 << 31)
        model.write(flash.KEYR, 0xCDEF_89AB)
        self.assertEqual(model.read(flash.CR), 0)
        return model

    def test_program_words(self):
        bench = Bench()
        with self.assertRaises(Misuse):
            flash.Flash("FLASH", bench).write(flash.CR, 1)
        model = self.unlocked(bench)
        model.write(flash.CR, 1 | 2 << 8)
        model.program(0x0800_4000, 4, 0xFFFF_00F0)
        model.program(0x0800_4000, 4, 0x1234_FFFF)
        # Programming can change bits only from 1 to 0.
        self.assertEqual(bench.read_memory(0x0800_4000, 4), (0x1234_00F0).to_bytes(4, "little"))
        self.assertAlmostEqual(bench.stalled, 32e-6)
        self.assertEqual(model.read(flash.SR), 1)
        model.write(flash.SR, 1)
        self.assertEqual(model.read(flash.SR), 0)
        with self.assertRaises(Misuse):
            model.program(0x0800_4004, 1, 0)
        self.assertEqual(model.read(flash.SR), 1 << 6)
        model.write(flash.CR, 1 << 31)
        with self.assertRaises(Misuse):
            model.program(0x0800_4004, 4, 0)

    def test_erase_a_sector(self):
        bench = Bench()
        model = self.unlocked(bench)
        bench.write_memory(0x0800_7FFC, b"\0" * 8)
        # SER, sector 1, x32, then STRT: erases 0x0800_4000 to 0x0800_7FFF in 250 ms.
        model.write(flash.CR, 1 << 1 | 1 << 3 | 2 << 8)
        model.write(flash.CR, 1 << 1 | 1 << 3 | 2 << 8 | 1 << 16)
        self.assertEqual(bench.read_memory(0x0800_7FFC, 8), b"\xff\xff\xff\xff\0\0\0\0")
        self.assertAlmostEqual(bench.stalled, 0.25)
        self.assertEqual(model.read(flash.CR) >> 16 & 1, 0)
        with self.assertRaises(Misuse):
            model.write(flash.KEYR, 1)

    def test_wait_states(self):
        # 96 MHz need 3 wait states on the F411 (90 MHz is the limit of 2).
        bench = Bench()
        model = flash.Flash("FLASH", bench)
        with self.assertRaises(Misuse):
            model.write(flash.ACR, 2)
        model.write(flash.ACR, 3 | 7 << 8)
        self.assertEqual(model.read(flash.ACR), 0x703)


class TimerTraces(unittest.TestCase):
    def fresh(self, bench, wide=True):
        return timer.Timer("TIM2", bench, 0, 28, wide)

    def test_compare_flag_and_interrupt(self):
        # 180 MHz core, timer at 90 MHz: a count takes two cycles.
        bench = Bench(BOARDS["nucleo_f446re"], 180_000_000, 45_000_000)
        model = self.fresh(bench)
        model.write(timer.CR1, 1)
        model.write(timer.CCR1, 100)
        model.write(timer.DIER, 2)
        bench.until(model, 199)
        self.assertEqual((model.read(timer.CNT), model.read(timer.SR) & 2, bench.lines.get(28)), (99, 0, False))
        bench.until(model, 200)
        self.assertEqual((model.read(timer.CNT), model.read(timer.SR) & 2, bench.lines[28]), (100, 2, True))
        # Writing 0 clears flags; 1 leaves them. CCR2 is 0, which the counter reaches only when it wraps.
        model.write(timer.SR, 0xFFFF_FFFD)
        self.assertEqual((model.read(timer.SR), bench.lines[28]), (0, False))
        # If CCR1 is written with the present count, there is no match before the counter wraps. EGR sets the flag
        # instead.
        model.write(timer.CCR1, 100)
        bench.until(model, 1000)
        self.assertEqual(model.read(timer.SR) & 2, 0)
        model.write(timer.EGR, 2)
        self.assertEqual((model.read(timer.SR) & 2, bench.lines[28]), (2, True))

    def test_prescaler_waits_for_an_update_and_the_counter_wraps(self):
        bench = Bench()
        model = self.fresh(bench, wide=False)
        model.write(timer.PSC, 95)
        model.write(timer.ARR, 9)
        model.write(timer.CR1, 1)
        bench.until(model, 5)
        self.assertEqual(model.read(timer.CNT), 5, "the new prescaler is not taken yet")
        model.write(timer.EGR, 1)
        self.assertEqual((model.read(timer.CNT), model.read(timer.SR) & 1), (0, 1))
        model.write(timer.SR, 0)
        # 96 cycles per count, ten counts per period: UIF at 5 + 960.
        bench.until(model, 5 + 959)
        self.assertEqual((model.read(timer.CNT), model.read(timer.SR) & 1), (9, 0))
        bench.until(model, 5 + 960)
        self.assertEqual((model.read(timer.CNT), model.read(timer.SR) & 1), (0, 1))
        # A stopped timer keeps its count.
        bench.until(model, 5 + 960 + 3 * 96)
        model.write(timer.CR1, 0)
        bench.until(model, 5000)
        self.assertEqual(model.read(timer.CNT), 3)
        with self.assertRaises(Misuse):
            model.write(timer.CCR1, 0x1_0000)

    def test_capture_of_both_edges_by_dma(self):
        bench = Bench(BOARDS["nucleo_f446re"], 180_000_000, 45_000_000)
        controller = dma.Dma("DMA1", bench, 21)
        bench.dma = [controller]
        stream = 0x10 + 0x18 * 3
        controller.write(stream + dma.PAR, 0x4000_0838)
        controller.write(stream + dma.M0AR, 0x2000_0100)
        controller.write(stream + dma.NDTR, 2)
        controller.write(stream + dma.CR, 2 << 25 | 1 << 13 | 1 << 11 | 1 << 10 | 1)
        model = timer.Timer("TIM4", bench, 2, 30, False, 0x4000_0800)

        def flags():
            # Flags of channel 2 only; the other channels have had compare events meanwhile.
            return model.read(timer.SR) & (4 | 1 << 10)

        model.write(timer.CCMR1, 0x2121)
        model.write(timer.CR1, 1)
        bench.until(model, 1000)
        model.edge(2)
        self.assertEqual((flags(), controller.read(stream + dma.NDTR)), (0, 2), "the channel is off")
        model.write(timer.CCER, 0x00B0)
        model.write(timer.DIER, 1 << 10)
        # A count takes two cycles; the second edge comes after the counter has wrapped.
        for cycles in (2000, 2 * (0x1_0000 + 7) + 1):
            bench.until(model, cycles)
            model.edge(2)
        self.assertEqual(bench.read_memory(0x2000_0100, 4), bytes([0xE8, 3, 7, 0]))
        self.assertEqual((flags(), controller.read(dma.LISR)), (0, 1 << 27))
        # DMA no longer fetches, so the next edge leaves CC2IF set, and the one after it also sets CC2OF. Reading the
        # count clears only CC2IF.
        model.edge(2)
        self.assertEqual(flags(), 4)
        model.edge(2)
        self.assertEqual(flags(), 1 << 10 | 4)
        model.read(timer.CCR2)
        self.assertEqual(flags(), 1 << 10)
        with self.assertRaises(Unmodelled):
            # Capture of one edge only.
            model.write(timer.CCER, 0x0010)
            model.edge(2)
        with self.assertRaises(Unmodelled):
            # The model does not support DMA requests of compare events of channel 2 or 4.
            model.write(timer.DIER, 1 << 12)

    def test_pwm_duty(self):
        bench = Bench()
        model = self.fresh(bench, wide=False)
        model.write(timer.ARR, 19_199)
        model.write(timer.CCMR1, 0b110 << 12)
        model.write(timer.CCR2, 4_800)
        model.write(timer.CR1, 1)
        self.assertIsNone(model.duty(2), "the output is not enabled")
        model.write(timer.CCER, 1 << 4)
        self.assertEqual(model.duty(2), 0.25)
        model.write(timer.CCR2, 19_200)
        self.assertEqual(model.duty(2), 1.0)


class Wire:
    """Replaces the sender and receiver at a USART: bytes with their times."""

    def __init__(self, arriving=(), baud=115_200):
        self.arriving, self.baud, self.heard = list(arriving), baud, []
        bit = 96e6 / baud
        self.frames = [(at - 9.5 * bit, bit, byte) for at, byte in arriving]

    level, next_fall = Host.level, Host.next_fall

    def next_byte(self):
        return self.arriving[0] if self.arriving else None

    def taken(self):
        self.arriving.pop(0)

    def sent(self, byte, cycle):
        self.heard.append((cycle, byte))


class UsartTraces(unittest.TestCase):
    ON = usart.UE | usart.RE | usart.TE

    def fresh(self, bench, wire):
        model = usart.Usart("USART1", bench, 0x4001_1000, (0x44, 4), 37, "pclk2")
        model.wire = wire
        # 96 MHz / 833 = 115246 baud: 833 cycles per bit.
        model.write(usart.BRR, 833)
        return model

    def test_overrun(self):
        bench = Bench()
        wire = Wire([(9000, 0x41), (17_330, 0x42), (25_660, 0x43)])
        model = self.fresh(bench, wire)
        model.write(usart.CR1, self.ON | usart.RXNEIE)
        bench.until(model, 9000)
        self.assertEqual((model.read(usart.SR), bench.lines[37]), (0xE0, True))
        # The first byte was not read in time: the second byte is lost, the first one is kept, and ORE is set.
        bench.until(model, 17_330)
        self.assertEqual(model.read(usart.SR), 0xE8)
        self.assertEqual(model.read(usart.DR), 0x41)
        # SR was read before DR: ORE and RXNE are cleared.
        self.assertEqual((model.read(usart.SR), bench.lines[37], model.overruns), (0xC0, False, 1))
        bench.until(model, 25_660)
        self.assertEqual(model.read(usart.DR), 0x43)

    def test_transmission_is_paced(self):
        bench = Bench()
        wire = Wire()
        model = self.fresh(bench, wire)
        model.write(usart.CR1, self.ON)
        model.write(usart.DR, 0x55)
        # The byte moves to the shift register at once: TXE is set again, TC is not.
        self.assertEqual(model.read(usart.SR), usart.TXE)
        model.write(usart.DR, 0xAA)
        self.assertEqual(model.read(usart.SR), 0)
        with self.assertRaises(Misuse):
            model.write(usart.DR, 0)
        bench.until(model, 8330)
        self.assertEqual((wire.heard, model.read(usart.SR)), ([(8330, 0x55)], usart.TXE))
        bench.until(model, 16_660)
        self.assertEqual((wire.heard[-1], model.read(usart.SR)), ((16_660, 0xAA), usart.TXE | usart.TC))

    def heard(self, baud, brr, text):
        """Sends `text` at the rate `baud` to a receiver with the divider `brr`. Returns (byte, whether it has a framing
        error) for each received byte."""
        bench, bit = Bench(), 96e6 / baud
        wire = Wire([(2_000 + round(10 * bit * k + 9.5 * bit), byte) for k, byte in enumerate(text)], baud)
        model = usart.Usart("USART1", bench, 0x4001_1000, (0x44, 4), 37, "pclk2")
        model.wire = wire
        model.write(usart.BRR, brr)
        model.write(usart.CR1, self.ON | usart.RXNEIE)
        heard = []
        for now in range(1_000, round(4_000 + 10 * bit * len(text) + 20 * brr), 50):
            bench.until(model, now)
            if (status := model.read(usart.SR)) & usart.RXNE:
                heard.append((model.read(usart.DR), bool(status & usart.FE)))
        return heard

    def test_other_baud_rates(self):
        self.assertEqual(self.heard(115_200, 833, b"$?"), [(0x24, False), (0x3F, False)])
        # The receiver reads each run of zeros, including the start bit, as a byte of zeros. If the run is longer than
        # nine of the receiver's bits, the stop bit is missing.
        self.assertEqual(self.heard(115_200, 96, b"?"), [(0, False), (0, True)])
        self.assertEqual(self.heard(115_200, 96, b"\n"), [(0, True), (0, False), (0, True)])
        # At twice the rate each bit is read as two.
        self.assertEqual(self.heard(115_200, 417, b"?"), [(0xFE, False), (0xF8, False)])
        self.assertEqual(self.heard(115_200, 417, b"$"), [(0x60, True), (0xF8, False)])
        # The bits are much shorter than those of the receiver: a few zeros are too short for a start bit. A whole byte
        # of zeros is read as a start bit, and then the line is high again.
        self.assertEqual(self.heard(1_000_000, 833, b"\x18"), [])
        self.assertEqual(self.heard(1_000_000, 833, b"\0"), [(0xFF, False)])


class DmaTraces(unittest.TestCase):
    """A USART with DMA: USART1 on an APB as fast as the core, USART2 on an APB with half the core's clock."""

    BYTES, HALF_WORDS, ROUND, SEND = 4 << 25 | 1 << 10, 4 << 25 | 1 << 10 | 1 << 11 | 1 << 13, 1 << 8, 4 << 25 | 1 << 10 | 1 << 6 | 1 << 4

    def fresh(self, number=1):
        bench = self.bench = Bench()
        self.model = dma.Dma(f"DMA{3 - number}", bench, 23 - number)
        bench.dma = [self.model]
        bench.puts_out_steps = lambda: False
        base, bus, clock = (0x4001_1000, "pclk2", (0x44, 4)) if number == 1 else (0x4000_4400, "pclk1", (0x40, 17))
        self.port = bench.peripherals[f"USART{number}"] = usart.Usart(f"USART{number}", bench, base, clock, 36 + number, bus)
        self.port.wire = Wire()
        # 115246 baud: 833 cycles per bit, 834 on the slower bus.
        self.port.write(usart.BRR, 833 if number == 1 else 417)

    def stream(self, number, count, how, data):
        base = 0x10 + 0x18 * number
        for offset, value in ((dma.PAR, data), (dma.M0AR, 0x2000_0100), (dma.NDTR, count), (dma.CR, how | 1)):
            self.model.write(base + offset, value)
        return base

    def until(self, cycle):
        advance_until(self.bench, (self.port, self.model), cycle)

    def receiving(self, count, how=BYTES, bytes_sent=3, error=0):
        self.fresh()
        self.port.wire.arriving = [(9000 + 8330 * k, 0x30 + k) for k in range(bytes_sent)]
        base = self.stream(2, count, how, 0x4001_1004)
        self.port.write(usart.CR3, usart.DMAR | usart.EIE)
        self.port.write(usart.CR1, UsartTraces.ON)
        if error:
            receive = self.port._receive
            self.port._receive = lambda byte, flags, at: receive(byte, error if byte == 0x31 else flags, at)
        return base

    def test_bytes_go_to_memory(self):
        base = self.receiving(8)
        self.until(9011)
        self.assertEqual((self.bench.read_memory(0x2000_0100, 1), self.model.read(base + dma.NDTR)), (b"\xff", 8))
        # The byte is stored twelve cycles after the request: eight cycles of the core, and four cycles of the bus.
        # This bus is as fast as the core.
        self.until(9012)
        self.assertEqual((self.bench.read_memory(0x2000_0100, 1), self.model.read(base + dma.NDTR)), (b"0", 7))
        self.until(38_000)
        self.assertEqual(self.bench.read_memory(0x2000_0100, 4), b"012\xff")
        self.assertEqual((self.model.read(base + dma.NDTR), self.model.read(base + dma.CR) & 1), (5, 1))
        self.assertEqual(self.port.overruns, 0)
        with self.assertRaises(Misuse):
            self.model.write(base + dma.NDTR, 1)

    def test_the_end_of_a_transfer(self):
        base, model = self.receiving(2), self.model
        self.until(38_000)
        # The flags of stream 2 begin at bit 16, TCIF is the sixth. The third byte stays in the USART.
        self.assertEqual((model.read(dma.LISR), model.read(base + dma.CR) & 1), (1 << 21, 0))
        self.assertEqual((self.bench.read_memory(0x2000_0100, 3), self.port.read(usart.DR)), (b"01\xff", 0x32))
        with self.assertRaises(Misuse):
            model.write(base + dma.CR, self.BYTES | 1)
        self.assertEqual([model._shift(stream) for stream in range(8)], [0, 6, 16, 22] * 2)
        model.write(dma.LIFCR, 0x3D << 16)
        model.write(base + dma.NDTR, 1)
        model.write(base + dma.CR, self.BYTES | 1)

    def test_round_and_round(self):
        base = self.receiving(4, self.HALF_WORDS | self.ROUND, 6)
        self.until(60_000)
        self.assertEqual(self.bench.read_memory(0x2000_0100, 10), b"4\x005\x002\x003\x00\xff\xff")
        self.assertEqual((self.model.read(base + dma.NDTR), self.model.read(base + dma.CR) & 1, self.model.read(dma.LISR)), (2, 1, 1 << 21))

    def test_errors_call_although_dma_reads(self):
        self.addCleanup(readings.forget)
        for clears_all in False, True:
            self.receiving(8, error=usart.FE)
            if clears_all:
                readings.choose("flags-by-dma")
            self.until(17_300)
            self.assertFalse(self.bench.lines[37])
            # The interrupt line rises with the byte, before DMA fetches it.
            self.until(17_335)
            self.assertTrue(self.bench.lines[37])
            self.until(20_000)
            self.assertEqual((self.bench.read_memory(0x2000_0100, 2), self.bench.lines[37]), (b"01", not clears_all))
            self.port.read(usart.SR), self.port.read(usart.DR)
            self.assertFalse(self.bench.lines[37])

    def test_a_processor_that_stands_loses_no_byte(self):
        self.receiving(8)
        # After the stall, the emulation handles all events in the order of their times, so each byte is fetched before
        # the next one arrives.
        self.bench.now = 60_000
        while min(model.due for model in (self.port, self.model)) <= self.bench.now:
            min((self.port, self.model), key=lambda model: model.due).advance(self.bench.now)
        self.assertEqual((self.bench.read_memory(0x2000_0100, 4), self.port.overruns), (b"012\xff", 0))

    def test_sending(self):
        self.fresh(2)
        port, model = self.port, self.model
        self.bench.write_memory(0x2000_0100, b"abc")
        port.write(usart.CR1, UsartTraces.ON)
        port.write(usart.CR3, usart.DMAT)
        base = self.stream(6, 3, self.SEND, 0x4000_4404)
        self.until(100)
        # Each transfer takes sixteen cycles, because the bus has half the core's clock. The first byte has moved on to
        # the shift register, the second one waits in the data register.
        self.assertEqual((model.read(base + dma.NDTR), port.shift_ends, port.read(usart.SR)), (1, 16 + 8340, 0))
        self.assertFalse(self.bench.lines.get(17))
        self.until(8400)
        self.assertEqual((model.read(base + dma.NDTR), model.read(base + dma.CR) & 1, model.read(dma.HISR), self.bench.lines[17]), (0, 0, 1 << 21, True))
        model.write(dma.HIFCR, 0x3D << 16)
        self.assertFalse(self.bench.lines[17])
        self.until(30_000)
        self.assertEqual([byte for _, byte in port.wire.heard], list(b"abc"))

    def test_one_byte_for_a_transmitter_at_rest(self):
        self.fresh(2)
        self.bench.write_memory(0x2000_0100, b"a!")
        self.port.write(usart.CR1, UsartTraces.ON)
        self.port.write(usart.CR3, usart.DMAT)
        base = self.stream(6, 1, self.SEND, 0x4000_4404)
        self.until(30_000)
        # The data register is free again at once, but the stream has ended.
        self.assertEqual((self.model.read(base + dma.NDTR), [byte for _, byte in self.port.wire.heard]), (0, list(b"a")))

    def test_what_parts_punish(self):
        self.receiving(8)
        self.bench.puts_out_steps = lambda: True
        with self.assertRaises(Misuse):
            # DMA2 must not serve a USART on APB2 while it may write steps to a port.
            self.until(9000)
        self.fresh(2)
        with self.assertRaises(Misuse):
            self.stream(6, 0, self.SEND, 0x4000_4404)


class ChainTraces(unittest.TestCase):
    """The step output, set up as by an image: DMA1 loads the event times of TIM5, TIM1 times the pulses, and DMA2
    writes the words to the port. At 96 MHz both timers count core cycles."""

    MOMENTS, RING, OFF = 0x2000_0100, 0x2000_0200, 0x2000_0300
    BSRR, CCR1 = 0x4002_0018, 0x4000_0C34
    WORDS = 2 << 11 | 2 << 13 | 1 << 8 | 3 << 16
    ON = 6 << 25 | 1 << 9 | WORDS
    LOW = 6 << 25 | WORDS
    CHAIN = 6 << 25 | 1 << 6 | 1 << 10 | WORDS

    def setUp(self):
        bench = self.bench = Bench()
        self.tim1 = pulse.PulseTimer("TIM1", bench)
        self.tim5 = timer.Timer("TIM5", bench, 3, 50, True, 0x4000_0C00)
        self.tim5.slaves.append(self.tim1)
        self.dma1, self.dma2 = bench.dma = [dma.Dma("DMA1", bench, 21), dma.Dma("DMA2", bench, 22)]
        self.port = gpio.Gpio("GPIOA", bench)
        self.port.write(gpio.MODER, 0xA800_0000 | 1 << 2)
        bench.edges.clear()
        bench.store_by_dma = lambda address, value, at: (self.port if address == self.BSRR else self.tim5).store_by_dma(
            address & 0x3FC, value, at
        )
        self.tim5.write(timer.CR2, 3 << 4)
        self.tim5.write(timer.CR1, 1)

    def tearDown(self):
        readings.forget()

    def words(self, address, values):
        for k, value in enumerate(values):
            self.bench.write_memory(address + 4 * k, value.to_bytes(4, "little"))

    def until(self, cycle):
        """Advances all models in the order of their events."""
        models = (self.tim5, self.dma1, self.dma2)
        while (due := min(model.due for model in models)) <= cycle:
            self.bench.now = max(self.bench.now, due)
            next(model for model in models if model.due == due).advance(self.bench.now)
        self.bench.now = cycle

    def stream(self, controller, number, peripheral, memory, count, how):
        base = 0x10 + 0x18 * number
        for offset, value in ((dma.PAR, peripheral), (dma.M0AR, memory), (dma.NDTR, count), (dma.CR, how | 1)):
            controller.write(base + offset, value)
        self.until(self.bench.now + 20)
        return base

    def begin(self, moments, words, pulse_ticks=96):
        self.words(self.MOMENTS, moments)
        self.words(self.RING, words)
        self.words(self.OFF, [2 << 16])
        for offset, value in ((0x34, 1), (0x40, 1 + pulse_ticks), (pulse.ARR, 2 + pulse_ticks), (pulse.CR1, pulse.OPM)):
            self.tim1.write(offset, value)
        self.stream(self.dma2, 1, self.RING, self.BSRR, len(words), self.ON)
        self.stream(self.dma2, 4, self.OFF, self.BSRR, len(words), self.LOW)
        self.stream(self.dma1, 2, self.CCR1, self.MOMENTS, len(moments), self.CHAIN)
        self.tim5.write(timer.CCR1, 0xFFFF_FFFF)
        self.tim5.write(timer.DIER, 1 << 9)
        self.tim5.write(timer.EGR, 2)
        self.until(self.bench.now + 50)
        self.tim1.write(pulse.DIER, 1 << 9 | 1 << 12)
        self.tim1.write(pulse.SMCR, 0x06)

    def test_events_at_their_moments(self):
        self.begin([1000, 1200, 1500, 999, 0, 0], [2, 0, 2, 2, 2, 2])
        self.assertEqual(self.tim5.read(timer.CCR1), 1000, "the first moment comes by DMA, asked for by hand")
        self.until(5000)
        # Cycles from the match: 4 to the first count, 1 to the compare event, 12 to the store. The second word changes
        # nothing.
        self.assertEqual(self.bench.edges, [(1017, "A", 1, 1), (1113, "A", 1, 0), (1517, "A", 1, 1), (1613, "A", 1, 0)])
        # Three of six events have been output, and four event times have been written to CCR1. The last of these times
        # is past, so the output has stopped.
        self.assertEqual((self.dma2.read(0x10 + 0x18 + dma.NDTR), self.dma1.read(0x10 + 0x18 * 2 + dma.NDTR)), (3, 2))
        self.assertEqual(self.tim5.read(timer.CCR1), 999)

    def test_the_ring_goes_round(self):
        self.begin([1000, 1200, 1400], [2, 2, 2])
        self.until(1300)
        # The first slot was fetched again with the event at 1200, so this value has no effect.
        self.words(self.MOMENTS, [1600])
        self.until(1450)
        self.assertEqual((self.dma2.read(0x10 + 0x18 + dma.NDTR), self.dma2.read(dma.LISR) & 1 << 11), (3, 1 << 11))
        self.until(1300 + 600)
        self.assertEqual([at for at, _, _, level in self.bench.edges if level], [1017, 1217, 1417])

    def test_a_moment_that_comes_too_late(self):
        self.begin([1000, 1200, 1400, 1399], [2, 2, 2, 2])
        self.until(1300)
        # The fourth slot was fetched with the event at 1200, so the new value has no effect.
        self.words(self.MOMENTS + 12, [1600])
        self.until(3000)
        self.assertEqual(self.tim5.read(timer.CCR1), 1399)
        self.until(3010)
        # The stream has fetched the first slot: changing it is detected when the stream is switched off.
        self.words(self.MOMENTS, [2000])
        with self.assertRaises(Misuse):
            self.dma1.write(0x10 + 0x18 * 2 + dma.CR, 0)

    def test_no_trigger_while_a_pulse_is_out(self):
        self.begin([1000, 1090, 1500, 1499], [2, 2, 2, 2])
        with self.assertRaises(Misuse):
            self.until(2000)

    def test_a_stop(self):
        self.begin([1000, 1200, 1400, 1600], [2, 2, 2, 2])
        self.until(1203)
        # The second pulse has been triggered and is complete; the third does not come.
        self.tim1.write(pulse.SMCR, 0x00)
        self.until(3000)
        self.assertEqual([at for at, _, _, _ in self.bench.edges], [1017, 1113, 1217, 1313])
        self.assertEqual(self.dma2.read(0x10 + 0x18 + dma.NDTR), 2)

    def test_no_request_is_taken_back_under_way(self):
        self.begin([1000, 1200, 1400, 1600], [2, 2, 2, 2])
        self.until(1205)
        with self.assertRaises(Misuse):
            self.tim5.write(timer.DIER, 0)
        self.until(1250)
        self.tim5.write(timer.DIER, 0)

    def test_a_transfer_waits_for_that_of_a_usart(self):
        self.begin([1000, 1200, 1500, 999, 0, 0], [2, 0, 2, 2, 2, 2])
        stores, store = [], self.tim5.store_by_dma
        self.tim5.store_by_dma = lambda offset, value, at: (stores.append((at, value)), store(offset, value, at))
        self.bench.peripherals["USART2"] = SimpleNamespace(ask_dma=lambda: None)
        self.bench.puts_out_steps = lambda: True
        self.stream(self.dma1, 5, 0x4000_4404, 0x2000_0400, 4, 4 << 25 | 1 << 10)
        self.until(999)
        self.assertTrue(self.dma1.ask_for_usart("USART2", 0x4000_4404, "pclk1", 999, lambda _, at: 0x41))
        self.until(5000)
        # Without the byte, the first event time would be written 16 cycles after the match. The byte occupies the
        # controller until 15 cycles after the match, and the time is written 8 cycles after that.
        self.assertEqual(stores[:2], [(1023, 1200), (1216, 1500)])
        # DMA2, which writes the edges, does not have to wait: the byte occupies only DMA1.
        self.assertEqual([at for at, _, _, level in self.bench.edges if level], [1017, 1517])

    def test_a_stream_that_is_switched_off_ends_its_transfer(self):
        self.begin([1000, 1200, 1400, 1600], [2, 2, 2, 2])
        self.until(1208)
        base = 0x10 + 0x18
        # The transfer of the second word to the port is in progress.
        self.dma2.write(base + dma.CR, 0)
        self.assertEqual(self.dma2.read(base + dma.CR), 1)
        with self.assertRaises(Misuse):
            self.dma2.write(base + dma.NDTR, 4)
        with self.assertRaises(Misuse):
            self.dma2.write(base + dma.CR, self.ON | 1)
        self.until(1220)
        self.assertEqual((self.bench.edges[-1], self.dma2.read(base + dma.CR)), ((1217, "A", 1, 1), 0))
        self.assertEqual(self.dma2.read(base + dma.NDTR), 2)
        self.dma2.write(base + dma.NDTR, 4)

    def test_a_pulse_that_is_cut(self):
        self.begin([1000, 1200, 1400, 1600], [2, 2, 2, 2])
        self.until(1210)
        self.tim1.write(pulse.SMCR, 0)
        self.tim1.write(pulse.CR1, 0)
        self.until(3000)
        self.assertEqual(self.bench.edges[-1], (1217, "A", 1, 1), "the end of the pulse does not come any more")

    def test_what_parts_punish(self):
        base = 0x10 + 0x18
        self.words(self.RING, [2, 2])
        with self.assertRaises(Misuse):
            # GPIO at the peripheral port.
            self.stream(self.dma2, 1, self.BSRR, self.RING, 2, 6 << 25 | 1 << 6 | 1 << 10 | self.WORDS)
        with self.assertRaises(Misuse):
            # DMA1 does not reach GPIO at all.
            self.stream(self.dma1, 2, self.BSRR, self.RING, 2, self.CHAIN)
        self.stream(self.dma2, 1, self.RING, self.BSRR, 2, self.ON)
        with self.assertRaises(Misuse):
            # The same request on two streams.
            self.stream(self.dma2, 3, self.RING, self.BSRR, 2, self.ON)
        self.dma2.write(base + dma.CR, 0)
        self.dma2.write(base + dma.CR, self.ON | 1)
        with self.assertRaises(Misuse):
            self.dma2.read(base + dma.CR)
        with self.assertRaises(Misuse):
            # Switched on right after another stream.
            self.stream(self.dma2, 4, self.OFF, self.BSRR, 2, self.LOW)
        self.until(self.bench.now + 20)
        self.assertEqual(self.dma2.read(base + dma.CR) & 1, 1)
        # A request that no stream serves stays pending until its timer is reset.
        self.dma2.ask("TIM1_CH4", self.bench.now + 5)
        self.until(self.bench.now + 20)
        with self.assertRaises(Misuse):
            self.stream(self.dma2, 4, self.OFF, self.BSRR, 2, self.LOW)
        self.tim1.reset()
        self.stream(self.dma2, 4, self.OFF, self.BSRR, 2, self.LOW)

    def test_a_compare_value_written_onto_the_count(self):
        for name, flag in ((None, 0), ("compare-on-count", 2)):
            if name:
                readings.choose(name)
            self.until(self.bench.now + 100)
            self.tim5.write(timer.SR, 0)
            self.tim5.write(timer.CCR1, self.tim5.read(timer.CNT))
            self.until(self.bench.now)
            self.assertEqual(self.tim5.read(timer.SR) & 2, flag)
            self.tim5.write(timer.CCR1, self.tim5.read(timer.CNT) - 1)
            self.tim5.write(timer.SR, 0)
            self.until(self.bench.now + 50)
            self.assertEqual(self.tim5.read(timer.SR) & 2, 0, "what is past matches by neither")

    def test_a_word_that_is_counted_when_it_is_fetched(self):
        readings.choose("counted-at-fetch")
        base = 0x10 + 0x18 * 2
        self.begin([1000, 1200, 1500, 1499], [2, 2, 2, 2])
        # The stream has written one word and fetched the next.
        self.assertEqual(self.dma1.read(base + dma.NDTR), 2)
        self.until(1300)
        # The fourth word is fetched, and the count restarts.
        self.assertEqual((self.dma1.read(base + dma.NDTR), self.dma2.read(0x10 + 0x18 + dma.NDTR)), (4, 3 - 1))

    def test_a_trigger_sooner_and_later(self):
        for name, edges in (("quick-trigger", (1014, 1110)), ("slow-trigger", (1021, 1117))):
            self.setUp()
            readings.forget()
            readings.choose(name)
            self.begin([1000, 2000, 1999], [2, 2, 2])
            self.until(1500)
            self.assertEqual(tuple(at for at, _, _, _ in self.bench.edges), edges)


class AdvancedPwmTraces(unittest.TestCase):
    """TIM1 as the PWM of a spindle: 100 counts, half of them high."""

    def setUp(self):
        self.tim1 = timer.AdvancedPwm("TIM1", Bench())
        for offset, value in ((timer.CCMR1, 6 << 4), (timer.CCER, 1), (timer.ARR, 99), (timer.CCR1, 50), (timer.CR1, 1)):
            self.tim1.write(offset, value)

    def test_the_output_needs_moe(self):
        self.assertIsNone(self.tim1.duty(1))
        self.tim1.write(timer.BDTR, timer.MOE)
        self.assertEqual(self.tim1.duty(1), 0.5)
        self.assertIsNone(self.tim1.duty(2), "a channel that is not switched on")

    def test_dma_does_not_reach_it(self):
        with self.assertRaises(Misuse):
            self.tim1.store_by_dma(timer.CCR1, 10, 0)

    def test_interrupts_are_not_modelled(self):
        with self.assertRaises(Unmodelled):
            self.tim1.write(timer.DIER, 1)


class BeamTraces(unittest.TestCase):
    """The laser's power, set up as by an image: TIM5's channel 3 makes DMA1 write TIM3's compare value. At 96 MHz both
    timers count core cycles."""

    POWER, COMPARE = 0x2000_0100, 0x4000_0438
    HOW = 6 << 25 | 1 << 6 | 2 << 11 | 2 << 13 | 1 << 8
    STREAM = 0x10

    def setUp(self):
        bench = self.bench = Bench()
        self.tim5 = timer.Timer("TIM5", bench, 3, 50, True, 0x4000_0C00)
        self.tim3 = timer.Timer("TIM3", bench, 1, 29, False, 0x4000_0400)
        self.dma1, = bench.dma = [dma.Dma("DMA1", bench, 21)]
        self.stores = []
        bench.store_by_dma = self.store
        self.tim5.write(timer.CR1, 1)

    def store(self, address, value, at):
        self.stores.append((at, value))
        self.assertEqual(address, self.COMPARE)
        self.tim3.store_by_dma(address & 0x3FC, value, at)

    def until(self, cycle):
        advance_until(self.bench, (self.tim5, self.dma1), cycle)

    def switch_on(self, power):
        self.bench.write_memory(self.POWER, power.to_bytes(4, "little"))
        for offset, value in ((dma.PAR, self.COMPARE), (dma.M0AR, self.POWER), (dma.NDTR, 128), (dma.CR, self.HOW | 1)):
            self.dma1.write(self.STREAM + offset, value)
        self.until(self.bench.now + 20)

    def arm(self, power, moment):
        self.switch_on(power)
        self.tim5.write(timer.CCR3, 0xFFFF_FFFF)
        self.tim5.write(timer.SR, ~8 & 0x1E1F)
        self.tim5.write(timer.DIER, 1 << 11 | 8)
        self.tim5.write(timer.CCR3, moment)

    def test_a_power_at_its_moment(self):
        self.arm(700, 1000)
        self.until(999)
        self.assertEqual((self.stores, self.bench.lines.get(50)), ([], False))
        self.until(1050)
        # 16 cycles from the match to the store on the APB; the interrupt comes with the match.
        self.assertEqual((self.stores, self.bench.lines[50]), ([(1016, 700)], True))
        self.assertEqual(self.tim3.read(timer.CCR2), 700)
        self.until(100_000)
        self.assertEqual(len(self.stores), 1, "one event is one request")

    def test_an_event_by_hand(self):
        self.until(2000)
        self.arm(300, 1000)
        # The time has passed: no event occurs, and the flag stays clear.
        self.until(2100)
        self.assertEqual((self.stores, self.tim5.read(timer.SR) & 8), ([], 0))
        self.tim5.write(timer.EGR, 8)
        self.until(2200)
        self.assertEqual(self.stores, [(2116, 300)])

    def test_another_power_after_it(self):
        for power, moment in ((700, 1000), (0, 1300)):
            self.arm(power, moment)
            self.until(moment + 50)
            self.tim5.write(timer.DIER, 8)
            self.dma1.write(self.STREAM + dma.CR, self.HOW)
        self.assertEqual(self.stores, [(1016, 700), (1316, 0)])

    def test_a_change_that_is_taken_back(self):
        self.arm(700, 1000)
        self.until(950)
        self.tim5.write(timer.DIER, 8)
        self.dma1.write(self.STREAM + dma.CR, 0)
        self.until(1100)
        self.assertEqual((self.stores, self.bench.lines[50]), ([], True), "the call stays")

    def test_what_parts_punish(self):
        self.arm(700, 1000)
        self.until(1005)
        with self.assertRaises(Misuse):
            # The request is under way.
            self.tim5.write(timer.DIER, 8)
        with self.assertRaises(Misuse):
            # The manuals do not say whether a request stays pending when its flag is cleared.
            self.tim5.write(timer.SR, ~8 & 0x1E1F)
        self.until(1050)
        self.bench.write_memory(self.POWER, (100).to_bytes(4, "little"))
        with self.assertRaises(Misuse):
            # The changed word had been fetched for the next request.
            self.dma1.write(self.STREAM + dma.CR, 0)
        self.bench.write_memory(self.POWER, (700).to_bytes(4, "little"))
        self.dma1.write(self.STREAM + dma.CR, 0)
        self.tim5.write(timer.DIER, 8)
        with self.assertRaises(Misuse):
            # The manuals do not say whether a set flag causes a request at once.
            self.tim5.write(timer.DIER, 1 << 11 | 8)
        # If the stream is off at the event, the request stays pending, and a stream that is switched on later would
        # output the next power at once.
        self.arm(200, 2000)
        self.until(1990)
        self.dma1.write(self.STREAM + dma.CR, 0)
        self.until(2050)
        self.assertEqual(self.stores, [(1016, 700)])
        with self.assertRaises(Misuse):
            self.switch_on(400)

    def test_other_channels_are_not_modelled(self):
        for channel in (2, 4):
            with self.assertRaises(Unmodelled):
                self.tim5.write(timer.DIER, 1 << 8 + channel)


class IwdgTraces(unittest.TestCase):
    def test_starves(self):
        bench = Bench()
        model = iwdg.Iwdg("IWDG", bench)
        self.assertEqual(model.due, NEVER)
        model.write(iwdg.KR, 0x5555)
        # Prescaler 32 (PR = 3) and 1000 counts: one second.
        model.write(iwdg.PR, 3)
        model.write(iwdg.RLR, 999)
        model.write(iwdg.KR, 0xCCCC)
        bench.until(model, 95_999_999)
        self.assertEqual(bench.resets, [])
        bench.until(model, 96_000_000)
        self.assertEqual(bench.resets, [(96_000_000, rcc.WATCHDOG_RESET, "independent watchdog")])

    def test_fed_and_keys(self):
        bench = Bench()
        model = iwdg.Iwdg("IWDG", bench)
        with self.assertRaises(Misuse):
            model.write(iwdg.RLR, 10)
        # After a reset: prescaler 4, 4096 counts: 512 ms.
        model.write(iwdg.KR, 0xCCCC)
        self.assertEqual(model.due, 49_152_000)
        bench.now = 40_000_000
        model.write(iwdg.KR, 0xAAAA)
        self.assertEqual(model.due, 89_152_000)
        with self.assertRaises(Misuse):
            model.write(iwdg.KR, 0x1234)
        # When half of the time has passed, the core's clock drops to a sixth, so the other half takes a sixth of the
        # cycles.
        bench.now += 24_576_000
        model.slowed_down(1 / 6)
        self.assertEqual(model.due, bench.now + 4_096_000)


class OtgTraces(unittest.TestCase):
    """RM0383, 22.16: GRXSTSR and GRXSTSP hold EPNUM in bits 3:0, BCNT in 14:4, PKTSTS in 20:17 (2 data received, 3
    transfer completed, 4 SETUP completed, 6 SETUP received)."""

    def fresh(self):
        bench = Bench()
        model = otg.OtgFs("OTG_FS", bench)
        # Enables the global interrupt and those of the receive FIFO and of IN endpoints.
        model.write(0x008, 1)
        model.write(0x018, 1 << 4 | 1 << 18)
        return bench, model

    def test_a_setup_packet_and_its_end(self):
        bench, model = self.fresh()
        self.assertFalse(bench.lines.get(67))
        self.assertEqual(model.read(0x014) & 1 << 4, 0)
        with self.assertRaises(Misuse):
            model.read(0x01C)
        # GET_DESCRIPTOR, device, 64 bytes: eight bytes for endpoint 0.
        model.setup(bytes.fromhex("8006000100004000"))
        self.assertTrue(bench.lines[67])
        self.assertEqual(model.read(0x01C), 6 << 17 | 8 << 4)
        self.assertEqual(model.read(0x020), 0x000C_0080)
        with self.assertRaises(Misuse):
            model.read(0x020)
        self.assertEqual([model.read(0x1000), model.read(0x1000)], [0x0100_0680, 0x0040_0000])
        # The entry for the packet's end follows half a microsecond later.
        self.assertEqual(model.read(0x014) & 1 << 4, 0)
        bench.now += 48
        model.call()
        self.assertEqual(model.read(0x020), 0x0008_0000)
        model.call()
        self.assertFalse(bench.lines[67])

    def test_a_packet_with_the_wrong_toggle_is_thrown_away(self):
        bench, model = self.fresh()
        enabled = 1 << 31 | 1 << 26 | 1 << 15
        for toggle, taken in ((0, True), (1, True), (1, False), (0, True)):
            model.write(0xB20, enabled)
            self.assertTrue(model.out(1, b"G", toggle), "ACK in any case")
            self.assertEqual(len(model.fifo), 2 * taken)
            model.fifo.clear()
        # SD0PID in DOEPCTL1 makes the endpoint expect DATA0.
        model.write(0xB20, enabled | 1 << 28)
        model.out(1, b"G", 0)
        self.assertEqual(len(model.fifo), 2)

    def test_a_suspended_bus_is_told_until_it_is_used_again(self):
        _, model = self.fresh()
        # Flags of GINTSTS: USBSUSP, WKUPINT, USBSUSP, USBRST. DSTS: full speed in bits 2:1, SUSPSTS in bit 0.
        for flag, status in ((1 << 11, 7), (1 << 31, 6), (1 << 11, 7), (1 << 12, 6)):
            model.flag(flag)
            self.assertEqual(model.read(0x808), status)

    def test_an_in_endpoint_is_disabled_behind_its_nak_and_then_emptied(self):
        _, model = self.fresh()
        # DIEPCTL1: active, CNAK, EPENA. Its DIEPINT has INEPNE and EPDISD; GRSTCTL flushes its FIFO.
        enabled, snak, disabled, flush = 1 << 31 | 1 << 26 | 1 << 15, 1 << 27, 1 << 30, 1 << 6 | 1 << 5
        model.write(0x920, enabled)
        for offset, value in ((0x010, flush), (0x920, snak | disabled)):
            with self.assertRaises(Misuse):
                model.write(offset, value)
        # CNAK cancels a NAK in force.
        model.write(0x920, enabled)
        self.assertEqual(model.read(0x928), 0)
        model.write(0x920, 1 << 15 | snak)
        self.assertEqual(model.read(0x928), 1 << 6)
        model.write(0x920, 1 << 15 | disabled)
        self.assertEqual(model.read(0x928), 1 << 6 | 1 << 1)
        model.write(0x010, flush)

    def test_a_packet_for_an_endpoint_that_then_answers_nak(self):
        bench, model = self.fresh()
        # Endpoint 1 is not active, then active and not enabled, then enabled with its NAK cleared.
        self.assertIs(model.out(1, b"G0"), False)
        model.write(0xB20, 1 << 15)
        self.assertIs(model.out(1, b"G0"), False)
        model.write(0xB20, 1 << 31 | 1 << 26 | 1 << 15)
        self.assertEqual(model.read(0xB20), 1 << 31 | 1 << 15)
        self.assertIs(model.out(1, b"G0X1\n"), True)
        self.assertEqual(model.read(0xB20), 1 << 17 | 1 << 15)
        self.assertIs(model.out(1, b"?"), False)
        bench.now += 48
        self.assertEqual(model.read(0x020), 0x0004_0051)
        self.assertEqual([model.read(0x1000), model.read(0x1000)], [0x3158_3047, 0x0000_000A])
        self.assertEqual(model.read(0x020), 0x0006_0001)
        model.write(0xB20, 1 << 31 | 1 << 26 | 1 << 15)
        self.assertIs(model.out(1, b"?"), True)
        # STALL overrides NAK and ACK.
        model.write(0xB20, 1 << 21 | 1 << 15)
        self.assertIsNone(model.out(1, b"?"))

    def test_a_packet_to_the_host(self):
        bench, model = self.fresh()
        model.write(0x810, 1)
        model.write(0x81C, 1 << 1)
        self.assertIs(model.in_(1), False)
        # One packet of three bytes; the FIFO has space for 16 words.
        model.write(0x930, 1 << 19 | 3)
        model.write(0x920, 1 << 31 | 1 << 26 | 1 << 15)
        self.assertEqual(model.read(0x938), 16)
        self.assertIs(model.in_(1), False, "nothing has been written yet")
        model.write(0x2000, 0x000A_6B6F)
        self.assertEqual(model.read(0x938), 15)
        self.assertEqual(model.in_(1), b"ok\n")
        # Transfer complete: IEPINT in GINTSTS, bit 0 in DIEPINT1, cleared by writing 1.
        self.assertTrue(model.read(0x014) & 1 << 18 and bench.lines[67])
        self.assertEqual(model.read(0x928), 1)
        model.write(0x928, 1)
        self.assertEqual(model.read(0x014) & 1 << 18, 0)
        self.assertFalse(bench.lines[67])


class NvicTraces(unittest.TestCase):
    def fresh(self):
        bench = Bench()
        bench.part = SimpleNamespace(flash_start=0x0800_0000)
        return bench, nvic.Nvic(bench, 86)

    def test_preemption_and_tail(self):
        _, model = self.fresh()
        # Interrupt 28 has priority 0xC0, interrupt 37 has 0xD0; they are enabled in ISER0 and ISER1.
        model.write(nvic.IPR + 28, 0xC0)
        model.write_byte(nvic.IPR + 37, 0xDF)
        self.assertEqual(model.read(nvic.IPR + 36) >> 8 & 0xFF, 0xD0, "four bits are there")
        model.write(nvic.ISER, 1 << 28)
        model.write(nvic.ISER + 4, 1 << 5)
        model.level(37, True)
        self.assertEqual(model.takeable(0, 0), (16 + 37, False))
        model.begin(16 + 37)
        model.level(28, True)
        self.assertEqual(model.takeable(0, 0), (16 + 28, False), "the more urgent one preempts")
        self.assertEqual(model.takeable(1, 0), (None, True), "PRIMASK keeps it back")
        self.assertEqual(model.takeable(0, 0xC0), (None, True), "BASEPRI of its own priority too")
        model.begin(16 + 28)
        model.level(28, False)
        self.assertEqual(model.end(), 16 + 28)
        # Interrupt 28 does not become pending again, because its line has fallen. Interrupt 37 becomes pending again
        # when its handler returns, because its line is still high.
        self.assertEqual(model.takeable(0, 0), (None, False))
        self.assertEqual(model.end(), 16 + 37)
        self.assertEqual(model.takeable(0, 0), (16 + 37, False))

    def test_equal_priority_and_software(self):
        _, model = self.fresh()
        model.write(nvic.ISER, 1 << 29 | 1 << 28)
        model.write(nvic.ISPR, 1 << 29 | 1 << 28)
        # Equal priority: the lower number comes first, and neither preempts the other.
        self.assertEqual(model.takeable(0, 0)[0], 16 + 28)
        model.begin(16 + 28)
        self.assertEqual(model.takeable(0, 0), (None, False))
        model.write(nvic.ICPR, 1 << 29)
        model.end()
        self.assertEqual(model.takeable(0, 0), (None, False))
        model.write(nvic.ICER, 1 << 28)
        model.write(nvic.ISPR, 1 << 28)
        self.assertEqual(model.takeable(0, 0), (None, False), "pending and not enabled")
        with self.assertRaises(Unmodelled):
            model.read(0xF00)

    def test_systick(self):
        bench, model = self.fresh()
        # Reload 99 from the core clock: first zero after 1 + 99 cycles, then every 100.
        model.write(nvic.RVR, 99)
        model.write(nvic.CVR, 0)
        model.write(nvic.CSR, 7)
        bench.until(model, 99)
        self.assertEqual((model.read(nvic.CVR), model.pending), (1, set()))
        bench.until(model, 100)
        self.assertEqual(model.pending, {nvic.SYSTICK})
        self.assertEqual(model.read(nvic.CSR), 7 | 1 << 16)
        self.assertEqual(model.read(nvic.CSR), 7, "COUNTFLAG is cleared by reading")
        model.pending.clear()
        bench.until(model, 199)
        self.assertEqual(model.pending, set())
        bench.until(model, 200)
        self.assertEqual(model.pending, {nvic.SYSTICK})


class UsbHostPolls(unittest.TestCase):
    def test_polls_that_are_not_played_keep_their_moments(self):
        bench = Bench()
        bench.usart, bench.otg = SimpleNamespace(wire=None), otg.OtgFs("OTG_FS", bench)
        host, period = UsbHost(bench), bench.cycles(SHORT_S)
        host._work, host.due = iter([None, None, SHORT_S]), 1000
        self.assertEqual(host.step(1000), NEVER)
        for moment, poll in ((1000 + 2 * period + 1, 1000 + 3 * period), (1000 + 4 * period, 1000 + 5 * period)):
            bench.now = moment
            host.send(b"?")
            self.assertEqual((host.due, bench.otg.due), (poll, poll))
            bench.now = poll + 1
            host.order("open")
            self.assertEqual(host.due, poll, "it is put off no further")
            bench.now = poll
            wait = host.step(poll)
        self.assertEqual(wait, poll + period, "and then each is played")


class ProfileTest(unittest.TestCase):
    def test_names_are_those_of_the_source(self):
        self.assertEqual(readable("_ZN14oxmill_control4pump5round17h0123456789abcdefE"), "oxmill_control::pump::round")
        self.assertEqual(readable("_ZN29_$LT$a..B$u20$as$u20$c..D$GT$1f17h0123456789abcdefE"), "<a::B as c::D>::f")
        self.assertEqual(readable("memcpy"), "memcpy")

if __name__ == "__main__":
    unittest.main()
