"""A chip of labwired with the firmware in it, and a host at its UART.

Promises that registers are found by the names that ST's SVD gives them, from the package, and stands in for what labwired 0.25.0 lacks at a UART:

* without DMA: it has no interrupt of a received byte (RXNEIE), so this pends it for each;
* with DMA: its UART asks for nothing, and a stream moves one item when it is switched on: it counts it, and where it sends, puts a 0 into the data
  register in place of the byte in memory. So this carries a received byte from the data register to memory and counts it. That 0 tells that the
  firmware has switched on the stream that sends: this takes the bytes out of memory and leaves the last one to labwired, which ends the transfer
  with its flag and its interrupt.
"""

import math

from labwired import Sim

from . import chip as chips

BYTE_S = 0.000_087
"""Of 115200 baud."""
SYST_CSR, ICER, ISPR, ICPR = 0xE000_E010, 0xE000_E180, 0xE000_E200, 0xE000_E280
AIRCR, RESET = 0xE000_ED0C, 0x05FA_0004
STEP_S = 0.0002
"""How often the answers are looked at."""
STREAMS = {"usart2": ("dma1", 5, 6)}
"""By UART with DMA: the controller, the stream that receives, the one that sends."""
LOOK_S = 0.000_02
"""How often these are looked at: the firmware does not send twice in between."""


class Broken(Exception):
    """A belief does not hold."""


class Machine:
    def __init__(self, elf, description, system, uart):
        self.description, self.uart = description, uart
        self.bases = chips.bases(description)
        self.interrupt = next(p["irq"] for p in description["peripherals"] if p["id"] == uart)
        self.schemas = {}
        self.sim = Sim(elf, system=system, uart=uart)
        self.dma, self.receiver, self.sender = STREAMS.get(uart, (None, None, None))
        self.forget()

    def forget(self):
        """Nothing has been said or received since the start of the chip."""
        self.sim.read_uart_bytes()
        self.said, self.slots, self.ends = b"", None, 0

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

    def set(self, peripheral, register, value):
        self.sim.write_u32(self.address(peripheral, register), value)

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
        looks = math.ceil(seconds / LOOK_S) if self.dma else 1
        for _ in range(looks):
            stop = self.sim.run_for(seconds / looks)
            if stop.kind != "reached":
                raise Broken(f"the processor stopped: {stop.kind} at {stop.pc if stop.pc is None else hex(stop.pc)}")
            out = self.sim.read_uart_bytes()
            if not self.dma:
                self.said += out
            elif out:
                self.fetch(len(out))

    def fetch(self, starts):
        """What DMA sends. `starts`: how often labwired has begun since the last look, with what this began itself."""
        starts, self.ends = starts - self.ends, 0
        if starts == 0:
            return
        if starts > 1:
            raise Broken(f"the stream that sends was switched on {starts} times within {LOOK_S * 1e6:.0f} us")
        stream = f"S{self.sender}"
        count = self.value(self.dma, f"{stream}NDTR") + 1
        self.said += self.sim.read_memory(self.value(self.dma, f"{stream}M0AR"), count)
        if count > 1:
            control = self.value(self.dma, f"{stream}CR")
            self.set(self.dma, f"{stream}CR", control & ~1)
            self.set(self.dma, f"{stream}NDTR", 1)
            self.set(self.dma, f"{stream}CR", control)
            self.ends = 1

    def store(self):
        """DMA puts the byte of the data register into the circular buffer."""
        stream = f"S{self.receiver}"
        left = self.value(self.dma, f"{stream}NDTR")
        if self.slots is None:
            # One of them was counted when the stream was switched on.
            self.slots = left = left + 1
        address = self.value(self.dma, f"{stream}M0AR") + 2 * (self.slots - left)
        shift = address % 4 * 8
        others = self.sim.read_u32(address & ~3) & ~(0xFFFF << shift)
        self.sim.write_u32(address & ~3, others | (self.value(self.uart, "DR") & 0x1FF) << shift)
        self.set(self.dma, f"{stream}NDTR", left - 1 or self.slots)

    def until(self, mark, limit):
        """What the board says up to a mark."""
        said, end = b"", self.sim.time + limit
        while mark not in said:
            if self.sim.time >= end:
                raise Broken(f"{mark!r} did not come within {limit * 1000:.0f} ms; the board said {said[-200:]!r}")
            self.run(STEP_S)
            said, self.said = said + self.said, b""
        return said.decode("latin1")

    def put(self, byte):
        """A byte arrives now."""
        self.sim.send_bytes(bytes([byte]))
        if self.dma:
            self.store()
        else:
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
        """The reset that software may ask for (AIRCR, SYSRESETREQ). Flash and what is outside of the chip stay.

        labwired resets the processor alone. So this ends what would act before the firmware sets it up again, SysTick and interrupts. And it resets
        twice: after a reset at some moments labwired skips the loop that clears memory, in the middle of an IT block as it seems.
        """
        for _ in range(2):
            self.sim.write_u32(AIRCR, RESET)
            self.sim.write_u32(SYST_CSR, 0)
            for word in range(3):
                self.sim.write_u32(ICER + 4 * word, 0xFFFF_FFFF)
                self.sim.write_u32(ICPR + 4 * word, 0xFFFF_FFFF)
            self.run(0.000_001)
        self.forget()
