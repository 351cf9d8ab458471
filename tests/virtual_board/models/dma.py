"""DMA controllers (RM0390 chapter 9, RM0383 chapter 9), as used for a USART in both directions, for captures of a
timer, and for the step output.

Modelled: transfers one after the other, each with a delay, for requests from any source; a stream that is switched off
completes its current transfer, and EN stays set until then; the number of data left (NDTR); the flag and the interrupt
at the end of a transfer; clearing of flags.
For a USART: reception in half-words or bytes (the same size on both sides), once or circular; transmission in bytes,
once. A transfer holds the controller for as long as the slower bus takes (`usart_hold`).
For compare events of timers: words in direct mode, in both directions, with either address incremented, circular. From
memory to a peripheral, the first word is fetched when the stream is enabled, and each further word right after the
previous one has been written. A request that no stream serves stays pending until its timer is reset.
For captures of timers: half-words, once, transferred at the time of the request.
Not modelled: other sizes, double-buffer mode, FIFO, the word that a stream to a USART fetches ahead, priorities of
streams other than by their number, other bus load.

Misuse is raised for errors that real parts do not report:
* GPIO reached through DMA2's peripheral port, or written by DMA2 while it may serve a USART, which is on APB2 (ES0287
  2.2.11: data may be corrupted);
* a peripheral that DMA1 does not reach;
* CR read right after EN was set (the stream may hang);
* two streams switched on back to back, or both for the same request;
* a word of memory changed after it was fetched;
* a stream switched on with a stale request, which it would serve at once.
"""

import functools
import heapq

from .peripheral import NEVER, Misuse, Peripheral, Unmodelled
from .readings import is_chosen

LISR, HISR, LIFCR, HIFCR = 0x00, 0x04, 0x08, 0x0C
CR, NDTR, PAR, M0AR, M1AR, FCR = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14
EN, TCIE, MINC, PSIZE, MSIZE, CHANNEL = 1 << 0, 1 << 4, 1 << 10, 1 << 11, 1 << 13, 7 << 25
TO_PERIPHERAL, CIRC, PINC, WORDS, PRIORITY = 1 << 6, 1 << 8, 1 << 9, 2 << 11 | 2 << 13, 3 << 16
TCIF = 1 << 5
VECTORS = {("DMA1", 6): 17}
"""Interrupt numbers of the streams that may interrupt at their end."""
REQUESTS = {
    ("DMA2", 2, 4): "USART1", ("DMA2", 5, 4): "USART1", ("DMA1", 5, 4): "USART2", ("DMA1", 6, 4): "USART2_TX",
    ("DMA1", 0, 2): "TIM4_CH1", ("DMA1", 3, 2): "TIM4_CH2", ("DMA1", 7, 2): "TIM4_CH3", ("DMA1", 2, 6): "TIM5_CH1",
    ("DMA1", 0, 6): "TIM5_CH3", ("DMA2", 4, 6): "TIM1_CH4",
    ("DMA2", 2, 7): "TIM8_CH1", ("DMA2", 3, 7): "TIM8_CH2", ("DMA2", 4, 7): "TIM8_CH3", ("DMA2", 7, 7): "TIM8_CH4",
    ("DMA2", 1, 6): "TIM1_CH1", ("DMA2", 3, 6): "TIM1_CH1", ("DMA2", 2, 6): "TIM1_CH2", ("DMA2", 6, 6): "TIM1_CH3",
}  # fmt: skip
"""Source of the requests, by (controller, stream, channel): RM0383 and RM0390, tables "DMA1 request mapping" and "DMA2
request mapping"; the same in RM0368 (F401)."""
TO_AHB, TO_APB, FETCH, BUSY = 12, 16, 10, 8
"""Cycles, in this order: from a request to the store on the AHB, from a request to the store on an APB, from that store
to the fetch of the next word, and between two stores (AN4031, tables 4 and 5)."""
USART_HOLD = 8
"""Cycles for which a transfer of a USART holds the controller, in addition to four clocks of its bus."""
SETTLE = 8
"""Minimum cycles between two stores that switch streams on, and from such a store to a read of CR. No manual says this:
the project brio measured it on an STM32F4 and saw streams hang."""
GPIO = range(0x4002_0000, 0x4002_2000)
"""Ports A to H: RM0383, RM0390, "Memory map", register boundary addresses."""


class Dma(Peripheral):
    REGISTERS = {LISR: ("LISR", 0, 0), HISR: ("HISR", 0, 0)} | {
        0x10 + 0x18 * stream + offset: (f"S{stream}{name}", 0, bits)
        for stream in range(8)
        for offset, name, bits in (
            (CR, "CR", EN | TCIE | TO_PERIPHERAL | CIRC | PINC | MINC | 3 << 11 | 3 << 13 | PRIORITY | CHANNEL),
            (NDTR, "NDTR", 0xFFFF),
            (PAR, "PAR", 0xFFFF_FFFF),
            (M0AR, "M0AR", 0xFFFF_FFFF),
        )
    }

    def __init__(self, name, board, bit):
        self.CLOCK = (0x30, bit)
        self.streams = {}
        """Maps each source of requests to the numbers of the streams that can serve it."""
        for (controller, stream, _), who in REQUESTS.items():
            if controller == name:
                self.streams.setdefault(who, []).append(stream)
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.next = [0] * 8
        """For each stream of a USART or of captures: memory address of the next datum."""
        self.agenda = []
        """Heap of the scheduled steps of transfers: (cycle, order, action)."""
        self.order = 0
        self.busy_until = 0
        self.whole = [0] * 8
        """For each stream: NDTR at the start, with which a circular stream also restarts."""
        self.fetched = [None] * 8
        """For each stream to a peripheral: (index in the ring, word) of the word that it has fetched ahead, or None."""
        self.switched_on = [-SETTLE] * 8
        self.taken = [0] * 8
        """Number of requests that each stream has taken, but not served yet."""
        self.ending = [0] * 8
        """For each stream that was switched off during a transfer: its CR from before, kept until the transfer ends;
        else 0."""
        self.under_way = {}
        """Number of requests not served yet, by source."""
        self.unserved = set()
        """Sources of requests that no stream has taken."""

    def read(self, offset):
        if offset >= 0x10:
            stream, register = divmod(offset - 0x10, 0x18)
            if register == CR and self.board.now - self.switched_on[stream] < SETTLE:
                raise Misuse(f"{self.name}: CR of stream {stream} is read right after it was switched on")
            if register == CR and self.ending[stream]:
                return super().read(offset) | EN
            if register == NDTR and is_chosen("counted-at-fetch") and self.fetched[stream] is not None:
                # NDTR already counts the word that the stream has fetched ahead; at the end of the ring it restarts
                # from the full number.
                return super().read(offset) - 1 or self.whole[stream]
        return super().read(offset)

    @staticmethod
    def _shift(stream):
        return (0, 6, 16, 22)[stream % 4]

    def write(self, offset, value):
        if offset in (LIFCR, HIFCR):
            self.values[offset - 8] &= ~value
            self._call()
            return
        if offset in (LISR, HISR):
            raise Misuse(f"{self.name}: status registers are read-only")
        if offset >= 0x10:
            stream, register = divmod(offset - 0x10, 0x18)
            base = offset - register
            on = self.values[base + CR] & EN
            if (on or self.ending[stream]) and register != CR:
                raise Misuse(f"{self.name}: a register of stream {stream} is written while it is on")
            if register == CR and value & EN and self.ending[stream]:
                raise Misuse(f"{self.name}: stream {stream} is switched on while it ends a transfer")
            if register == CR and value & EN and not on:
                flags = 0x3D << self._shift(stream)
                if self.values[LISR if stream < 4 else HISR] & flags:
                    raise Misuse(f"{self.name}: stream {stream} is switched on with flags of an earlier use")
                self._begin(stream, base, value)
            if register == CR and on and not value & EN:
                self._check_fetched(stream, base)
                if self.taken[stream]:
                    self.ending[stream] = self.values[base + CR]
                else:
                    self.fetched[stream] = None
        super().write(offset, value)
        if offset >= 0x10 and register == CR and value & EN and not on:
            self._call()
            who = self.who(stream, value)
            if who.startswith("USART"):
                self.board.peripherals[who.removesuffix("_TX")].ask_dma()

    def who(self, stream, cr):
        """Returns the source whose requests a stream serves."""
        return REQUESTS.get((self.name, stream, (cr & CHANNEL) >> 25), "")

    def _call(self):
        """Updates the interrupt lines of the streams that may interrupt at their end."""
        for (name, stream), irq in VECTORS.items():
            if name == self.name:
                flags = self.values[LISR if stream < 4 else HISR] >> self._shift(stream)
                self.board.nvic.level(irq, bool(flags & TCIF and self.values[0x10 + 0x18 * stream + CR] & TCIE))

    def _begin(self, stream, base, cr):
        """Switches a stream on, after checking its configuration."""
        who = self.who(stream, cr)
        par = self.values[base + PAR]
        if "_CH" not in who or not cr & CIRC:
            if cr & (PINC | 2 << 11 | 2 << 13) or bool(cr & TO_PERIPHERAL) != who.endswith("_TX") or cr & TO_PERIPHERAL and cr & (CIRC | PSIZE):
                raise Unmodelled(f"{self.name}: stream {stream} with CR {cr:#x}")
            if who.startswith("USART"):
                if self.board.now - max(self.switched_on) < SETTLE:
                    raise Misuse(f"{self.name}: stream {stream} is switched on right after another")
                self.switched_on[stream] = self.board.now
            if not self.values[base + NDTR]:
                raise Misuse(f"{self.name}: stream {stream} is switched on with nothing to do")
            self.whole[stream] = self.values[base + NDTR]
            if not cr & MINC:
                raise Unmodelled(f"{self.name}: stream {stream} without MINC")
            if bool(cr & PSIZE) != bool(cr & MSIZE):
                raise Unmodelled(f"{self.name}: stream {stream} with two sizes")
            self.next[stream] = self.values[base + M0AR]
            return
        if cr & (3 << 11 | 3 << 13) != WORDS:
            raise Unmodelled(f"{self.name}: stream {stream} with CR {cr:#x}")
        if self.name == "DMA2" and par in GPIO:
            raise Misuse(f"{self.name}: stream {stream} reaches GPIO through the peripheral port")
        # RM0383 and RM0390, figure of the bus matrix: the peripheral port of DMA1 leads only to APB1.
        if self.name == "DMA1" and not 0x4000_0000 <= par < 0x4001_0000:
            raise Misuse(f"{self.name}: the peripheral port does not reach {par:#x}")
        for other in range(8):
            there = self.values[0x10 + 0x18 * other + CR]
            if there & EN and self.who(other, there) == who:
                raise Misuse(f"{self.name}: streams {other} and {stream} are both on for {who}")
        if self.board.now - max(self.switched_on) < SETTLE:
            raise Misuse(f"{self.name}: stream {stream} is switched on right after another")
        if who in self.unserved:
            raise Misuse(f"{self.name}: stream {stream} is switched on with a request from before")
        if not self.values[base + NDTR]:
            raise Misuse(f"{self.name}: stream {stream} is switched on with nothing to do")
        self.switched_on[stream] = self.board.now
        self.whole[stream] = self.values[base + NDTR]
        self.fetched[stream] = None
        if cr & TO_PERIPHERAL:
            self._later(self.board.now + FETCH, lambda at: self._fetch(stream, base, 0))

    def _check_fetched(self, stream, base):
        held = self.fetched[stream]
        if held is not None and self.board.dma_load(self._place(base, held[0])) != held[1]:
            raise Misuse(f"{self.name}: word {held[0]} of stream {stream} was changed after it had been fetched")

    def _later(self, at, action):
        self.order += 1
        heapq.heappush(self.agenda, (at, self.order, action))
        self.plan(self.agenda[0][0])

    def advance(self, now):
        while self.agenda and self.agenda[0][0] <= now:
            at, _, action = heapq.heappop(self.agenda)
            action(at)
        self.plan(self.agenda[0][0] if self.agenda else NEVER)

    def _fetch(self, stream, base, index):
        if self.values[base + CR] & EN:
            self.fetched[stream] = (index, self.board.dma_load(self._place(base, index)))

    def _place(self, base, index):
        """Returns the memory address of a stream's word."""
        return self.values[base + M0AR] + (4 * index if self.values[base + CR] & MINC else 0)

    def forget(self, timer):
        """Drops the pending requests of a timer that is reset."""
        self.unserved = {who for who in self.unserved if not who.startswith(timer)}

    def ask(self, who, at, pulse=None):
        """Requests a transfer for a compare event at cycle `at`. The request is dropped if `pulse` has been cut short
        at or before that cycle."""
        streams = self.streams.get(who)
        if streams:
            self.under_way[who] = self.under_way.get(who, 0) + 1
            self._later(at, lambda at: self._serve(who, streams, at, pulse))

    def _serve(self, who, streams, at, pulse):
        if pulse is not None and pulse.cut_at is not None and pulse.cut_at <= at:
            self.under_way[who] -= 1
            return
        for stream in streams:
            base = 0x10 + 0x18 * stream
            cr = self.values[base + CR]
            if cr & EN and self.who(stream, cr) == who:
                self.taken[stream] += 1
                done = max(at + (TO_APB if cr & TO_PERIPHERAL else TO_AHB), self.busy_until + BUSY)
                self.busy_until = done
                self._later(done, functools.partial(self._transfer, who, stream, base))
                return
        self.under_way[who] -= 1
        self.unserved.add(who)

    def _transfer(self, who, stream, base, at):
        self.under_way[who] -= 1
        self.taken[stream] -= 1
        ending, self.ending[stream] = self.ending[stream], 0
        cr = self.values[base + CR] | ending
        if not cr & EN:
            return
        whole = self.whole[stream]
        index = whole - self.values[base + NDTR]
        par, memory = self.values[base + PAR], self.values[base + M0AR]
        if cr & TO_PERIPHERAL:
            if self.fetched[stream] is None or self.fetched[stream][0] != index:
                raise Misuse(f"{self.name}: stream {stream} is asked before it has fetched a word")
            self.board.store_by_dma(par, self.fetched[stream][1], at)
            if ending:
                self.fetched[stream] = None
            else:
                self._later(at + FETCH, lambda at: self._fetch(stream, base, (index + 1) % whole))
        else:
            word = self.board.dma_load(par + (4 * index if cr & PINC else 0))
            self.board.store_by_dma(memory + (4 * index if cr & MINC else 0), word, at)
        left = self.values[base + NDTR] - 1
        if left == 0:
            self.values[LISR if stream < 4 else HISR] |= TCIF << self._shift(stream)
        self.values[base + NDTR] = left or whole

    def usart_hold(self, bus):
        """Returns the cycles for which a transfer of a USART on this bus holds the controller."""
        rcc = self.board.rcc
        return USART_HOLD + 4 * (rcc.hclk // getattr(rcc, bus))

    def ask_for_usart(self, who, data_address, bus, at, serve):
        """Requests a transfer for a USART that has received a byte or can send one. The request came at cycle `at`,
        possibly long before now. Returns whether a stream takes the request; if so, it calls `serve(byte, at)`, which
        returns the received byte, or accepts the byte to be sent."""
        for stream in self.streams.get(who, ()):
            base = 0x10 + 0x18 * stream
            cr = self.values[base + CR]
            if not cr & EN or self.who(stream, cr) != who:
                continue
            if self.values[base + PAR] != data_address:
                raise Misuse(f"{self.name}: stream {stream} serves {self.values[base + PAR]:#x} and not {who}")
            if self.name == "DMA2" and self.board.puts_out_steps():
                raise Misuse(f"{self.name}: stream {stream} serves APB2 while others put out steps")
            self.taken[stream] += 1
            done = max(at, self.busy_until) + self.usart_hold(bus)
            self.busy_until = done
            self._later(done, functools.partial(self._transfer_of_usart, stream, base, serve))
            return True
        return False

    def _transfer_of_usart(self, stream, base, serve, at):
        self.taken[stream] -= 1
        ending, self.ending[stream] = self.ending[stream], 0
        cr = self.values[base + CR] | ending
        size, memory = 2 if cr & PSIZE else 1, self.next[stream]
        self.next[stream] += size
        left = self.values[base + NDTR] - 1
        self.values[base + NDTR] = left
        if left == 0 and cr & CIRC:
            self.values[base + NDTR], self.next[stream] = self.whole[stream], self.values[base + M0AR]
        elif left == 0:
            # The stream must be off before the USART requests the next byte.
            self.values[base + CR] &= ~EN
        if cr & TO_PERIPHERAL:
            byte, = self.board.read_memory(memory, 1)
            serve(byte, at)
        else:
            self.board.write_memory(memory, serve(None, at).to_bytes(size, "little"))
        if left == 0:
            self.values[LISR if stream < 4 else HISR] |= TCIF << self._shift(stream)
            self._call()

    def request(self, asks, data_address, datum):
        """Transfers a timer's capture `datum` at once, if a stream serves the source `asks`. Returns whether one
        does."""
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
