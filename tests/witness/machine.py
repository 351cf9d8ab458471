"""A chip of labwired with the firmware in it, and a host at its UART.

Promises that registers are found by the names that ST's SVD gives them, from the package. labwired 0.25.0 has no interrupt of a received byte
(RXNEIE), so this pends it for each.
"""

from labwired import Sim

from . import chip as chips

BYTE_S = 0.000_087
"""Of 115200 baud."""
ISPR, AIRCR, RESET = 0xE000_E200, 0xE000_ED0C, 0x05FA_0004
STEP_S = 0.0002
"""How often the answers are looked at."""


class Broken(Exception):
    """A belief does not hold."""


class Machine:
    def __init__(self, elf, description, system, uart):
        self.description, self.uart = description, uart
        self.bases = chips.bases(description)
        self.interrupt = next(p["irq"] for p in description["peripherals"] if p["id"] == uart)
        self.schemas = {}
        self.sim = Sim(elf, system=system, uart=uart)

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.sim.close()

    # Registers, by ST's names.

    def schema(self, peripheral):
        if peripheral not in self.schemas:
            # The package calls the flash interface otherwise than the file of its registers.
            self.schemas[peripheral] = chips.fields(peripheral.removesuffix("_ctrl"))
        return self.schemas[peripheral]

    def value(self, peripheral, register):
        offset, _ = self.schema(peripheral)[register]
        return self.sim.read_u32(self.bases[peripheral] + offset)

    def address(self, peripheral, register):
        return self.bases[peripheral] + self.schema(peripheral)[register][0]

    def field(self, peripheral, register, name):
        lowest, mask = self.schema(peripheral)[register][1][name]
        return self.value(peripheral, register) >> lowest & mask

    def expect(self, peripheral, register, **wanted):
        """Compares fields. Returns them as text."""
        told = []
        for name, value in wanted.items():
            found = self.field(peripheral, register, name)
            if found != value:
                raise Broken(f"{peripheral.upper()}_{register}.{name} is {found} and not {value}")
            told.append(f"{name}={value}")
        return f"{peripheral.upper()}_{register} {' '.join(told)}"

    # Time and text.

    def run(self, seconds):
        stop = self.sim.run_for(seconds)
        if stop.kind != "reached":
            raise Broken(f"the processor stopped: {stop.kind} at {stop.pc if stop.pc is None else hex(stop.pc)}")

    def until(self, mark, limit):
        """What the board says up to a mark."""
        said, end = b"", self.sim.time + limit
        while mark not in said:
            if self.sim.time >= end:
                raise Broken(f"{mark!r} did not come within {limit * 1000:.0f} ms; the board said {said[-200:]!r}")
            self.run(STEP_S)
            said += self.sim.read_uart_bytes()
        return said.decode("latin1")

    def put(self, byte):
        """A byte arrives now."""
        self.sim.send_bytes(bytes([byte]))
        self.sim.write_u32(ISPR + self.interrupt // 32 * 4, 1 << self.interrupt % 32)

    def send(self, data):
        for byte in data:
            self.put(byte)
            self.run(BYTE_S)

    def ask(self, line, limit=0.05):
        """Sends a line; what is said up to its answer, which has to be `ok`."""
        self.send(line.encode("latin1") + b"\n")
        said = self.until(b"\r\n", limit)
        while not said.endswith(("ok\r\n",)) and "error" not in said:
            said += self.until(b"\r\n", limit)
        if not said.endswith("ok\r\n"):
            raise Broken(f"{line} was answered by {said!r}")
        return said

    def status(self):
        self.send(b"?")
        return self.until(b">\r\n", 0.01)

    def reset(self):
        """The reset that software may ask for (AIRCR, SYSRESETREQ). Flash and what is outside of the chip stay."""
        self.sim.write_u32(AIRCR, RESET)
        self.run(0.000_001)
        self.sim.read_uart_bytes()
