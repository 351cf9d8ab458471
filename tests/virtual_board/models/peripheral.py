"""What the models share: a table of registers, and loud failure for all that is not in it."""

NEVER = 1 << 62


class Unmodelled(Exception):
    """The firmware touched something that the emulation knows nothing of."""


class Misuse(Exception):
    """The firmware did what the reference manual forbids."""


class Peripheral:
    """A block of registers.

    `REGISTERS` maps an offset to (name, value after reset, bits that are modelled). A write that changes another bit
    fails, so does every access to an offset that is not listed.
    """

    REGISTERS = {}
    CLOCK = None
    """Where RCC switches its clock: (offset of the enable register, bit), or None if it is always on."""

    def __init__(self, name, board):
        self.name = name
        self.board = board
        self.due = NEVER
        """Core cycle at which `advance` wants to be called."""
        self.reset()

    def reset(self):
        self.values = {offset: row[1] for offset, row in self.REGISTERS.items()}
        self.due = NEVER

    def advance(self, now):
        """Time has come to `due`."""

    def clock_changed(self):
        """Core or bus clocks are about to change."""

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
        """Sets when to be called next."""
        if due != self.due:
            self.due = due
            self.board.replan()
