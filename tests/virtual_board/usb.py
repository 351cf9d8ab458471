"""A host at the USB port: enumerates the device as a CDC-ACM serial port and exchanges bytes.

Transactions follow each other as on a real bus without other devices: 60 us for a transaction with 64 bytes, even if
NAK answers it, and 10 us for a short one. While the port is open, the host polls the IN endpoint continuously; a poll
that would only be answered by NAK, because nothing has changed since the last poll, is not emulated. Packets of the
control endpoint are assumed to have up to 64 bytes, as the device declares.
"""

from collections import deque

from .board import Failure
from .host import Host
from .models.otg import ENUMDNE, IN, NEVER, USBRST, USBSUSP, WKUPINT

SHORT_S, LONG_S = 10e-6, 60e-6
DATA_OUT, DATA_IN = 1, 2
"""Numbers of the data endpoints."""
WAITING = 8
"""After this many NAKs in a row (half a millisecond), this host assumes that the device has no space; fewer NAKs only
show that the device is busy with the previous packet."""


class UsbHost(Host):
    """A host like the sender at the UART; the cable is plugged in from the beginning."""

    def __init__(self, board):
        self.otg = board.otg
        usart = board.usart.wire
        super().__init__(board)
        board.usart.wire = usart
        self.otg.host = self
        self.due = NEVER
        self.descriptors = {}
        self.packets = deque()
        self.open = self.is_set_up = False
        self.reads = True
        """Whether the program at the open port fetches received bytes."""
        self._toggle_out = self._toggle_in = 0
        """Toggle of the next data packet: 0 for DATA0."""
        self.waits = self._naks = 0
        """`waits`: how often the device has refused a packet `WAITING` times in a row, that is, for longer than it
        takes to fetch a packet. `_naks`: NAKs in a row."""
        self._work = None
        self._orders = deque()
        self._idle_since = None
        """While polling is suspended, because all further polls would have the same answer: core cycle of the last
        emulated poll. Otherwise None."""

    # The bus.

    def look(self):
        """Starts this host's work if the device has connected."""
        if self.otg.connected and self._work is None:
            self._work = self._life()
            self.due = self.board.now + self.board.cycles(1e-3)
            self.otg.plan(self.due)

    def step(self, now):
        if self._work is None or self.due > now:
            return self.due
        wait = next(self._work)
        if wait is None:
            self._idle_since, self.due = now, NEVER
        else:
            self.due = now + self.board.cycles(wait)
        return self.due

    def wake(self):
        """Resumes polling, because the device or the host may have something to send. The next poll comes at the time at
        which it would have come if polling had not been suspended."""
        if self._idle_since is not None:
            period = self.board.cycles(SHORT_S)
            self.due = self._idle_since + ((self.board.now - self._idle_since) // period + 1) * period
            self._idle_since = None
            self.otg.plan(self.due)

    def send(self, data, at=None):
        for begin in range(0, len(data), 64):
            self.packets.append(bytes(data[begin : begin + 64] if isinstance(data, bytes) else data[begin : begin + 64].encode()))
        self.bytes_sent += len(data)
        self.wake()
        return self.board.now

    def order(self, what):
        """Queues an order, executed after the present one: `open`, `close`, `unplug`, `plug`, `reset`, `configure`,
        `unconfigure` or `clear halts`."""
        self._orders.append(what)
        self.wake()

    def _until(self, transaction, *arguments, tries=3000):
        for _ in range(tries):
            answer = transaction(*arguments)
            if answer is not False:
                return answer
            yield SHORT_S
        raise Failure(f"the device answers {transaction.__name__}{arguments} with NAK for ever")

    def _control(self, request, length=0, data=None):
        """Performs a control transfer. Returns the answer, or None for STALL."""
        self.otg.setup(bytes(request))
        yield SHORT_S
        answer = b""
        if data is not None:
            if (yield from self._until(self.otg.out, 0, data)) is None:
                return None
            yield SHORT_S
        elif length:
            while len(answer) < length:
                packet = yield from self._until(self.otg.in_, 0)
                if packet is None:
                    return None
                answer += packet
                yield SHORT_S
                if len(packet) < 64:
                    break
            yield from self._until(self.otg.out, 0, b"")
            yield SHORT_S
            return answer
        status = yield from self._until(self.otg.in_, 0)
        yield SHORT_S
        return status

    def _descriptor(self, kind, index, length):
        answer = yield from self._control([0x80, 6, index, kind, 0x09 if kind == 3 else 0, 0x04 if kind == 3 else 0, length, 0], length)
        self.descriptors[kind, index] = answer

    def _enumerate(self):
        self.otg.flag(USBRST)
        yield 10e-3
        self.otg.flag(ENUMDNE)
        yield 1e-3
        yield from self._descriptor(1, 0, 18)
        yield from self._control([0, 5, 7, 0, 0, 0, 0, 0])
        yield from self._descriptor(1, 0, 18)
        yield from self._descriptor(2, 0, 255)
        for index in (1, 2, 3):
            yield from self._descriptor(3, index, 255)
        yield from self._configure(1)

    def _configure(self, value):
        """Sets the configuration. Both sides restart with DATA0 (USB 2.0, 9.1.1.5)."""
        yield from self._control([0, 9, value, 0, 0, 0, 0, 0])
        self._toggle_out = self._toggle_in = 0
        self.is_set_up = value == 1

    def _clear_halts(self):
        """Clears the halts of both data endpoints, which restart with DATA0, whether halted or not (USB 2.0, 9.4.5)."""
        yield from self._control([2, 1, 0, 0, DATA_OUT, 0, 0, 0])
        self._toggle_out = 0
        yield from self._control([2, 1, 0, 0, 0x80 | DATA_IN, 0, 0, 0])
        self._toggle_in = 0

    def _dtr(self, up):
        if up:
            yield from self._control([0x21, 0x20, 0, 0, 0, 0, 7, 0], data=(115_200).to_bytes(4, "little") + bytes([0, 0, 8]))
        yield from self._control([0x21, 0x22, 3 if up else 0, 0, 0, 0, 0, 0])
        self.open = up

    def _life(self):
        yield from self._enumerate()
        while True:
            if self._orders:
                order = self._orders.popleft()
                if order in ("open", "close"):
                    yield from self._dtr(order == "open")
                elif order == "unplug":
                    self.otg.flag(USBSUSP)
                    self.open = self.is_set_up = False
                elif order == "plug":
                    self.otg.flag(WKUPINT)
                    yield from self._enumerate()
                elif order == "reset":
                    # The cable stays plugged in, so no suspend precedes this bus reset.
                    self.open = self.is_set_up = False
                    yield from self._enumerate()
                elif order in ("configure", "unconfigure"):
                    yield from self._configure(int(order == "configure"))
                elif order == "clear halts":
                    yield from self._clear_halts()
            wait = SHORT_S if self.packets or self._orders else None
            if self.open and self.reads:
                toggle = self.otg.toggle[IN, DATA_IN]
                data = self.otg.in_(DATA_IN)
                if data:
                    # A packet with the wrong toggle is taken for a repetition and dropped.
                    if toggle == self._toggle_in:
                        self._toggle_in ^= 1
                        for byte in data:
                            self.sent(byte, self.board.now)
                    yield LONG_S
                    wait = SHORT_S
            if self.packets and self.is_set_up:
                if self.otg.out(DATA_OUT, self.packets[0], self._toggle_out):
                    self.packets.popleft()
                    self._toggle_out ^= 1
                    self._naks = 0
                else:
                    self._naks += 1
                    self.waits += self._naks == WAITING
                wait = LONG_S
            yield wait
