"""USART (RM0390 chapter 25, RM0383 chapter 19), 8 bits, no parity, one stop bit, 16-fold oversampling.

Modelled: baud rate from BRR. Two kinds of bytes are sampled bit by bit from the levels of the line, which gives wrong
bytes and framing errors: bytes whose rate differs by more than 2.5 %, and bytes that had begun when the receiver was
switched on. A byte becomes readable in the middle of its stop bit; overrun if the previous byte is unread (the new byte
is lost, ORE stays until SR and DR are read). TXE, TC, IDLE; transmit data register and shift register with the duration
of each frame; interrupt enables, including the one for errors while DMA receives; DMA requests in both directions. A
DMA stream that reads DR does not read SR: the manuals do not say which unread flags this clears (`readings`).
Not modelled: parity, hardware flow control, synchronous and LIN modes, noise, IDLE as an interrupt.
"""

from .peripheral import NEVER, Misuse, Peripheral, Unmodelled
from .readings import is_chosen

SR, DR, BRR, CR1, CR2, CR3, GTPR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18
FE, ORE, IDLE, RXNE, TC, TXE = 1 << 1, 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7
RE, TE, IDLEIE, RXNEIE, TCIE, TXEIE, UE = 1 << 2, 1 << 3, 1 << 4, 1 << 5, 1 << 6, 1 << 7, 1 << 13
EIE, DMAR, DMAT = 1 << 0, 1 << 6, 1 << 7
"""Bits of USART_SR, USART_CR1 and USART_CR3."""


class Usart(Peripheral):
    REGISTERS = {
        SR: ("SR", TC | TXE, 0x3FF),
        DR: ("DR", 0, 0x1FF),
        BRR: ("BRR", 0, 0xFFFF),
        CR1: ("CR1", 0, RE | TE | RXNEIE | TCIE | TXEIE | UE),
        CR2: ("CR2", 0, 0),
        CR3: ("CR3", 0, EIE | DMAR | DMAT),
    }

    def __init__(self, name, board, base, clock, irq, bus):
        self.base = base
        self.CLOCK = clock
        self.irq = irq
        self.bus = bus
        self.wire = None
        """The device on the line. `next_byte()` returns the next byte as (core cycle of the middle of its stop bit,
        byte), or None; `taken()` removes that byte; `sent(byte, cycle)` receives a byte; `next_fall(cycle)` and
        `level(cycle)` describe the line itself."""
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.received = 0
        self.seen = 0
        """Flags that the last read of SR returned: a read of DR clears them."""
        self.waiting = None
        self.asked_to_read = self.asked_to_write = False
        """DMA requests that are not served yet."""
        self.shifting = None
        self.shift_ends = NEVER
        self.overruns = 0
        self.listens_from = 0
        """Cycle from which the receiver is on at this rate."""
        self.searches_from = 0
        """Cycle from which the receiver searches for a start bit, when it samples bit by bit."""

    def clock_changed(self):
        if self.values[CR1] & UE:
            raise Unmodelled(f"{self.name} is on while clocks change")

    def bit_cycles(self):
        rcc = self.board.rcc
        return self.values[BRR] * (rcc.hclk // getattr(rcc, self.bus))

    def baud(self):
        return getattr(self.board.rcc, self.bus) / self.values[BRR]

    def read(self, offset):
        value = super().read(offset)
        if offset == SR:
            self.seen = value
        if offset == DR:
            self.values[SR] &= ~RXNE
            if self.seen & (FE | ORE | IDLE):
                self.values[SR] &= ~(self.seen & (FE | ORE | IDLE))
            self.seen = 0
            self._call()
            return self.received
        return value

    def write(self, offset, value):
        if offset == SR:
            # RXNE and TC may be cleared by writing 0.
            self.values[SR] &= value | ~(RXNE | TC)
            self._call()
            return
        if offset == DR:
            if not self.values[CR1] & TE or not self.values[CR1] & UE:
                raise Misuse(f"{self.name}_DR is written while the transmitter is off")
            if not self.values[SR] & TXE:
                raise Misuse(f"{self.name}_DR is written while it is full: a byte is lost")
            self._fill(value, self.board.now)
            return
        before = self.hears
        if offset == BRR and before:
            raise Misuse(f"{self.name}_BRR is written while the USART is on")
        if offset == CR1 and self.values[CR1] & UE and not value & UE and self.shifting is not None:
            raise Misuse(f"{self.name} is switched off while it sends")
        super().write(offset, value)
        if self.hears and not before:
            self.listens_from = self.searches_from = self.board.now
        if offset in (CR1, CR3):
            self.ask_dma()
        if offset in (CR1, BRR, CR3):
            self._call()
            self.listen()

    def _fill(self, value, at):
        """Puts a byte to be sent into the data register."""
        self.values[SR] &= ~(TXE | TC)
        self.waiting = value & 0xFF
        if self.shifting is None:
            self._shift(at)
        self._call()

    def _shift(self, now):
        self.shifting, self.waiting = self.waiting, None
        self.shift_ends = now + 10 * self.bit_cycles()
        self.values[SR] |= TXE
        self.ask_dma(now)
        self._plan()

    def listen(self):
        """Plans the next event again. Called when bytes come onto the wire or the receiver's settings have changed."""
        self._plan()

    @property
    def hears(self):
        return self.values[CR1] & (UE | RE) == UE | RE

    @property
    def samples(self):
        """Returns whether the receiver must sample bit by bit, because it is out of step with the sender."""
        if not self.hears or not self.values[BRR]:
            return False
        arriving = self.wire.next_byte()
        begun = arriving and arriving[0] - 9.5 * self._bit_of_wire() < self.listens_from
        return bool(begun) or abs(self.wire.baud / self.baud() - 1) > 0.025

    def _bit_of_wire(self):
        return self.board.rcc.hclk / self.wire.baud

    def _start(self):
        """Returns the cycle at which the next known start bit begins, or None."""
        bit, search = self.bit_cycles(), self.searches_from
        while (fall := self.wire.next_fall(search)) is not None:
            if not any(self.wire.level(fall + share * bit) for share in (5 / 16, 9 / 16)):
                return fall
            search = fall + bit / 2
        return None

    def _plan(self):
        due = self.shift_ends
        arriving = self.wire.next_byte() if self.wire else None
        if arriving:
            due = min(due, arriving[0])
        if self.wire and self.samples and (start := self._start()) is not None:
            due = min(due, round(start + 9.6 * self.bit_cycles()))
        self.plan(due)

    def advance(self, now):
        if self.shift_ends <= now:
            ended, byte = self.shift_ends, self.shifting
            self.shifting, self.shift_ends = None, NEVER
            if self.waiting is not None:
                self._shift(ended)
            else:
                self.values[SR] |= TC
            # At another rate the host receives no valid byte.
            if self.wire and abs(self.wire.baud / self.baud() - 1) <= 0.025:
                self.wire.sent(byte, ended)
        if self.wire:
            self._sample(now)
        # Take only one byte per call. After a stall of the processor, DMA must fetch each byte before the next byte
        # arrives.
        if self.wire and (arriving := self.wire.next_byte()) and arriving[0] <= now:
            sampled = self.samples
            self.wire.taken()
            if self.hears and not sampled:
                self.searches_from = arriving[0]
                self._receive(arriving[1], 0, arriving[0])
        self._call()
        self._plan()

    def _sample(self, now):
        """Receives, bit by bit, the bytes that have arrived."""
        bit = self.bit_cycles()
        while self.samples and (start := self._start()) is not None and start + 9.6 * bit <= now + 1:
            levels = [self.wire.level(start + (k + 9 / 16) * bit) for k in range(10)]
            self.searches_from = start + (9 + 9 / 16) * bit
            self._receive(sum(level << k for k, level in enumerate(levels[1:9])), 0 if levels[9] else FE, now)

    def _receive(self, byte, error, at):
        if self.values[SR] & RXNE:
            self.values[SR] |= ORE
            self.overruns += 1
        else:
            self.received = byte
            self.values[SR] |= RXNE | error
            # The interrupt sees RXNE even if a DMA stream fetches the byte a moment later.
            self._call()
            self.ask_dma(at)

    def ask_dma(self, at=None):
        """Requests a DMA transfer for each direction that needs one and has none pending."""
        at = self.board.now if at is None else at
        sr, cr, cr3 = self.values[SR], self.values[CR1], self.values[CR3]
        if cr3 & DMAR and sr & RXNE and not self.asked_to_read:
            ask = (self.name, self.base + DR, self.bus, at, self._read_by_dma)
            self.asked_to_read = any(dma.ask_for_usart(*ask) for dma in self.board.dma)
        if cr3 & DMAT and sr & TXE and cr & (UE | TE) == UE | TE and not self.asked_to_write:
            ask = (f"{self.name}_TX", self.base + DR, self.bus, at, self._written_by_dma)
            self.asked_to_write = any(dma.ask_for_usart(*ask) for dma in self.board.dma)

    def _read_by_dma(self, _, at):
        self.asked_to_read = False
        self.values[SR] &= ~(RXNE | FE | ORE | IDLE if is_chosen("flags-by-dma") else RXNE | self.seen & (FE | ORE | IDLE))
        self.seen = 0
        self._call()
        return self.received

    def _written_by_dma(self, byte, at):
        self.asked_to_write = False
        self._fill(byte, at)

    def _call(self):
        sr, cr, cr3 = self.values[SR], self.values[CR1], self.values[CR3]
        wants = sr & (RXNE | ORE) and cr & RXNEIE or sr & TXE and cr & TXEIE or sr & TC and cr & TCIE
        wants = wants or cr3 & EIE and cr3 & DMAR and sr & (FE | ORE)
        self.board.nvic.level(self.irq, bool(wants))
