"""Base of the models: a table of registers; any access to something that is not in the table fails."""

NEVER = 1 << 62


class Unmodelled(Exception):
    """The firmware used something that is not modelled."""


class Misuse(Exception):
    """The firmware did something that the reference manual forbids."""


class Peripheral:
    """A block of registers.

    `REGISTERS` maps an offset to (name, value after reset, modelled bits). A write that changes any other bit fails; so
    does every access to an offset that is not listed.
    """

    REGISTERS = {}
    CLOCK = None
    """Bit in RCC that enables the clock: (offset of the enable register, bit), or None if the clock is always on."""

    def __init__(self, name, board):
        self.name = name
        self.board = board
        self.due = NEVER
        """Core cycle of the next call of `advance`."""
        self.reset()

    def reset(self):
        self.values = {offset: row[1] for offset, row in self.REGISTERS.items()}
        self.due = NEVER

    def advance(self, now):
        """Called when `due` has come."""

    def clock_changed(self):
        """Called before core or bus clocks change."""

    def row(self, offset):
        row = self.REGISTERS.get(offset)
        if row is None:
            raise Unmodelled(f"{self.name} has no model of the register at {offset:#05x}")
        return row

    def read(self, offset):
        self.row(offset)
        return self.values[offset]

    def write(self, offset, value):
        name, _, modelled = self.row(offset)
        changed = (value ^ self.values[offset]) & ~modelled
        if changed:
            raise Unmodelled(f"{self.name}_{name}: bits {changed:#x} of {value:#010x} are not modelled")
        self.values[offset] = value

    def plan(self, due):
        """Sets the time of the next call of `advance`."""
        if due != self.due:
            self.due = due
            self.board.replan()
