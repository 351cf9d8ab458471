"""DMA controllers (RM0390 chapter 9, RM0383 chapter 9), as far as a USART receives and a timer captures through them.

Modelled: streams from a peripheral to memory, bytes or half-words on both sides, memory address counting up, once; number
of data, end of a transfer with its flag, clearing of flags, switching off. A transfer is done at the moment of the request.
Not modelled: all other directions and sizes, circular and double-buffer mode, FIFO, priorities, bus load, interrupts.
"""

from .peripheral import Misuse, Peripheral, Unmodelled

LISR, HISR, LIFCR, HIFCR = 0x00, 0x04, 0x08, 0x0C
CR, NDTR, PAR, M0AR, M1AR, FCR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
EN, MINC, PSIZE, MSIZE, CHANNEL = 1 << 0, 1 << 10, 1 << 11, 1 << 13, 7 << 25
TCIF = 1 << 5
REQUESTS = {
    ("DMA2", 2, 4): "USART1", ("DMA2", 5, 4): "USART1", ("DMA1", 5, 4): "USART2",
    ("DMA1", 0, 2): "TIM4_CH1", ("DMA1", 3, 2): "TIM4_CH2", ("DMA1", 7, 2): "TIM4_CH3",
}  # fmt: skip
"""Who asks, by (controller, stream, channel)."""


class Dma(Peripheral):
    REGISTERS = {LISR: ("LISR", 0, 0), HISR: ("HISR", 0, 0)} | {
        0x10 + 0x18 * stream + offset: (f"S{stream}{name}", 0, bits)
        for stream in range(8)
        for offset, name, bits in (
            (CR, "CR", EN | MINC | PSIZE | MSIZE | CHANNEL),
            (NDTR, "NDTR", 0xFFFF),
            (PAR, "PAR", 0xFFFF_FFFF),
            (M0AR, "M0AR", 0xFFFF_FFFF),
        )
    }

    def __init__(self, name, board, bit):
        self.CLOCK = (0x30, bit)
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.next = [0] * 8
        """Memory address of the next datum."""

    @staticmethod
    def _shift(stream):
        return (0, 6, 16, 22)[stream % 4]

    def write(self, offset, value):
        if offset in (LIFCR, HIFCR):
            self.values[offset - 8] &= ~value
            return
        if offset in (LISR, HISR):
            raise Misuse(f"{self.name}: status registers are read-only")
        if offset >= 0x10:
            stream, register = divmod(offset - 0x10, 0x18)
            base = offset - register
            on = self.values[base + CR] & EN
            if on and register != CR:
                raise Misuse(f"{self.name}: a register of stream {stream} is written while it is on")
            if register == CR and value & EN and not on:
                flags = 0x3D << self._shift(stream)
                if self.values[LISR if stream < 4 else HISR] & flags:
                    raise Misuse(f"{self.name}: stream {stream} is switched on with flags of an earlier use")
                if not value & MINC:
                    raise Unmodelled(f"{self.name}: stream {stream} without MINC")
                if bool(value & PSIZE) != bool(value & MSIZE):
                    raise Unmodelled(f"{self.name}: stream {stream} with two sizes")
                self.next[stream] = self.values[base + M0AR]
        super().write(offset, value)

    def request(self, asks, data_address, datum):
        """A peripheral has a datum. Whether some stream has taken it."""
        for (name, stream, channel), who in REQUESTS.items():
            base = 0x10 + 0x18 * stream
            cr = self.values[base + CR]
            if name != self.name or who != asks or not cr & EN or (cr & CHANNEL) >> 25 != channel:
                continue
            if self.values[base + PAR] != data_address:
                raise Misuse(f"{self.name}: stream {stream} fetches from {self.values[base + PAR]:#x}")
            size = 2 if cr & PSIZE else 1
            self.board.write_memory(self.next[stream], datum.to_bytes(size, "little"))
            self.next[stream] += size
            self.values[base + NDTR] -= 1
            if self.values[base + NDTR] == 0:
                self.values[base + CR] &= ~EN
                self.values[LISR if stream < 4 else HISR] |= TCIF << self._shift(stream)
            return True
        return False
