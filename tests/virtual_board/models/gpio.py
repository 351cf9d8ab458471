"""General-purpose input and output (RM0390 chapter 7, RM0383 chapter 8).

Modelled: MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, AFRL, AFRH; push-pull and open-drain outputs, pull resistors,
external levels, and the time of each change of an output. An output changes at the store itself.
Not modelled: LCKR, slew rates, the one or two AHB cycles from a store to the pin and from a pin to IDR, contention
between an output and an external level, analogue mode other than "no output". A floating input reads 1; such reads are
counted.
"""

from .peripheral import Misuse, Peripheral, Unmodelled

MODER, OTYPER, OSPEEDR, PUPDR, IDR, ODR, BSRR, AFRL, AFRH = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18, 0x20, 0x24
INPUT, OUTPUT, ALTERNATE, ANALOGUE = range(4)
FLOATING = None

# GPIOx_MODER, OSPEEDR, PUPDR: reset values of ports A and B, which have the pins of the debug port.
RESET = {
    "GPIOA": {MODER: 0xA800_0000, OSPEEDR: 0x0C00_0000, PUPDR: 0x6400_0000},
    "GPIOB": {MODER: 0x0000_0280, OSPEEDR: 0x0000_00C0, PUPDR: 0x0000_0100},
}


class Gpio(Peripheral):
    REGISTERS = {
        MODER: ("MODER", 0, 0xFFFF_FFFF),
        OTYPER: ("OTYPER", 0, 0xFFFF),
        OSPEEDR: ("OSPEEDR", 0, 0xFFFF_FFFF),
        PUPDR: ("PUPDR", 0, 0xFFFF_FFFF),
        IDR: ("IDR", 0, 0),
        ODR: ("ODR", 0, 0xFFFF),
        BSRR: ("BSRR", 0, 0xFFFF_FFFF),
        AFRL: ("AFRL", 0, 0xFFFF_FFFF),
        AFRH: ("AFRH", 0, 0xFFFF_FFFF),
    }

    def __init__(self, name, board):
        self.port = name[-1]
        self.outside = [FLOATING] * 16
        """External level at each pin."""
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.values.update(RESET.get(self.name, {}))
        self.floating_reads = 0
        self.word = self.floats = 0
        self.at = None
        """Cycle of a store by DMA in progress, otherwise None."""
        self.shown = [FLOATING] * 16
        """Level that the chip drives each pin to; "AF" while a peripheral drives it."""
        self._show(0xFFFF)
        self._sense()

    def read(self, offset):
        self.row(offset)
        if offset == IDR:
            self.floating_reads += self.floats
            return self.word
        if offset == BSRR:
            return 0
        return self.values[offset]

    def write(self, offset, value):
        if offset == BSRR:
            # The low half sets, the high half resets; setting takes precedence.
            before = self.values[ODR]
            after = (before & ~(value >> 16) | value) & 0xFFFF
            if after != before:
                self.values[ODR] = after
                self._show(before ^ after)
                self._follow(before ^ after)
            return
        if offset == IDR:
            raise Misuse(f"{self.name}_IDR is read-only")
        super().write(offset, value)
        if offset in (MODER, ODR, OTYPER):
            self._show(0xFFFF)
        self._sense()

    def store_by_dma(self, offset, value, at):
        """Writes a register for a DMA stream, at cycle `at`, which may be one instruction ago."""
        self.at = at
        self.write(offset, value)
        self.at = None

    def mode(self, pin):
        return self.values[MODER] >> 2 * pin & 3

    def function(self, pin):
        """Returns which alternate function the pin has (0 to 15), or None if it is not in that mode."""
        if self.mode(pin) != ALTERNATE:
            return None
        return self.values[AFRL if pin < 8 else AFRH] >> 4 * (pin & 7) & 15

    def level(self, pin):
        """Returns the level at the pin: 0, 1, or None if nothing drives or pulls it."""
        shown = self.shown[pin]
        if shown in (0, 1):
            return shown
        if self.outside[pin] is not FLOATING:
            return self.outside[pin]
        return {1: 1, 2: 0}.get(self.values[PUPDR] >> 2 * pin & 3)

    def drive(self, pin, level):
        """Drives a pin from outside (0, 1), or stops driving it (None)."""
        self.outside[pin] = level
        self._sense()

    def _follow(self, pins):
        """Updates IDR like `_sense`, for a change of these outputs only; inputs keep their level."""
        for pin in range(16):
            if pins >> pin & 1:
                level = self.level(pin)
                self.word = self.word & ~(1 << pin) | (1 if level is None else level) << pin

    def _sense(self):
        """Updates IDR for all pins."""
        self.word = self.floats = 0
        for pin in range(16):
            level = self.level(pin)
            if level is None:
                self.floats += self.mode(pin) == INPUT
                level = 1
            self.word |= level << pin

    def _show(self, pins):
        moder, odr, otyper = self.values[MODER], self.values[ODR], self.values[OTYPER]
        pin = 0
        while pins:
            if pins & 1:
                mode = moder >> 2 * pin & 3
                level = FLOATING
                if mode == OUTPUT:
                    level = odr >> pin & 1
                    if level and otyper >> pin & 1:
                        level = FLOATING
                elif mode == ALTERNATE:
                    level = "AF"
                if level != self.shown[pin]:
                    self.shown[pin] = level
                    self.board.edge(self.port, pin, level, self.at)
            pins >>= 1
            pin += 1


__all__ = ["Gpio", "Misuse", "Unmodelled"]
