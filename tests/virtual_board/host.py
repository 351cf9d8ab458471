"""The sender at the other end of the serial line: 8N1, bytes back to back, character counting."""

from collections import deque

WINDOW = 127
"""Bytes that a sender keeps in flight: the size of Grbl's receive buffer, which every sender assumes."""


FRAMES = 8
"""Minimum number of bytes kept in `frames`, from which the levels of the line are computed."""


class Host:
    """A sender at a UART; it exchanges bytes with their times in both directions."""

    def __init__(self, board, baud=115_200):
        self.board, self.baud = board, baud
        self.outgoing = deque()
        self.window = WINDOW
        self.free_at = 0
        """Core cycle at which the line can take the next byte."""
        self.text = bytearray()
        """All bytes received from the board."""
        self.lines = []
        """(core cycle of its end, text) for each complete line from the board."""
        self._line = bytearray()
        self._job, self._pending = deque(), deque()
        self.answers = []
        self.bytes_sent = 0
        self.frames = deque()
        """(core cycle of its start, cycles of a bit, byte) for each of the last bytes on the line."""
        board.usart.wire = self

    # Called by the model of the USART.

    def next_byte(self):
        return self.outgoing[0] if self.outgoing else None

    def taken(self):
        self.outgoing.popleft()

    def level(self, cycle):
        """Returns the level (0 or 1) of the line to the board at a core cycle; 1 if no byte is on the line."""
        for start, bit, byte in self.frames:
            if start <= cycle < start + 10 * bit:
                place = int((cycle - start) / bit)
                return (byte << 1 | 1 << 9) >> place & 1
        return 1

    def next_fall(self, cycle):
        """Returns the cycle of the line's first falling edge at or after `cycle`; None if no byte with such an edge is
        on the line yet."""
        for start, bit, byte in self.frames:
            word = byte << 1 | 1 << 9
            for place in range(10):
                before = word >> (place - 1) & 1 if place else 1
                if start + place * bit >= cycle and before and not word >> place & 1:
                    return start + place * bit
        return None

    def sent(self, byte, cycle):
        self.text.append(byte)
        self._line.append(byte)
        if byte == 0x0A:
            line = self._line.decode("latin1").rstrip("\r\n")
            self._line.clear()
            self.lines.append((cycle, line))
            if line == "ok" or line.startswith("error"):
                self.answers.append(line)
                if self._pending:
                    self._pending.popleft()
                self._feed()

    # For the cases.

    def send(self, data, at=None):
        """Queues bytes after those already on the line. Returns the cycle at which the board can read the last one."""
        board = self.board
        bit = board.clocks[-1][2] / self.baud
        for byte in data if isinstance(data, bytes) else data.encode():
            start = max(self.free_at, at if at is not None else board.now)
            self.free_at = start + 10 * bit
            self.outgoing.append((round(start + 9.5 * bit), byte))
            self.frames.append((start, bit, byte))
            while len(self.frames) > FRAMES and self.frames[0][0] + 20 * bit < board.now:
                self.frames.popleft()
            self.bytes_sent += 1
        board.usart.listen()
        return self.outgoing[-1][0] if self.outgoing else board.now

    def stream(self, text, end="\n"):
        """Starts sending a job by character counting."""
        self._job.extend((line + end).encode() for line in text.splitlines())
        self._feed()

    def _feed(self):
        while self._job and sum(self._pending) + len(self._job[0]) <= self.window:
            line = self._job.popleft()
            self._pending.append(len(line))
            self.send(line)

    @property
    def all_answered(self):
        return not self._job and not self._pending

    def has_said(self, text, after=0):
        return text.encode() in self.text[after:]
