"""A chip in the emulator labwired that runs the firmware, and a host at the chip's UART.

Finds registers by the names of ST's SVD, which the package includes. Emulates what labwired 0.25.0 lacks at a UART:

* Without DMA, labwired raises no interrupt for a received byte (RXNEIE): this module makes it pending for each byte.
* With DMA, labwired's UART raises no requests. Its streams move one item when switched on: a receiving stream only
  counts it, a sending stream also writes a 0 into the data register instead of the byte in memory.
  - Receiving: this module copies each byte from the data register to memory and counts it.
  - Sending: a 0 from the UART shows that the firmware has switched on the stream. This module reads the bytes from
    memory, and leaves the last one to labwired, which ends the transfer with its flag and interrupt.
"""

import math

from labwired import Sim

from . import chip as chips

BYTE_S = 0.000_087
"""Duration of a byte at 115200 baud."""
SYST_CSR, ICER, ISPR, ICPR = 0xE000_E010, 0xE000_E180, 0xE000_E200, 0xE000_E280
AIRCR, RESET = 0xE000_ED0C, 0x05FA_0004
STEP_S = 0.0002
"""Interval at which `until` checks the output."""
STREAMS = {"usart2": ("dma1", 5, 6)}
"""For a UART with DMA: controller, receiving stream, sending stream."""
LOOK_S = 0.000_02
"""Interval, s, at which the sending stream is checked: the firmware never starts the stream twice within this time."""


class Broken(Exception):
    """Raised if a belief (an assumption of the firmware about the hardware) does not hold, or the chip does not
    answer."""


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
        """Clears the records of received and sent bytes, because the chip starts anew."""
        self.sim.read_uart_bytes()
        self.said, self.slots, self.ends = b"", None, 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.sim.close()

    # Registers, by ST's names.

    def schema(self, peripheral):
        if peripheral not in self.schemas:
            # The package calls the flash interface `flash_ctrl`, but the file with its registers `flash`.
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
        """Checks that fields have the wanted values; raises Broken otherwise. Returns the fields as text."""
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
        """Reads the bytes that DMA sends. `starts`: how often labwired's sending stream has started since the last
        check. This includes starts that the last `fetch` itself caused (`ends`), which do not count."""
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
        """Emulates DMA: stores the byte of the data register in the circular buffer."""
        stream = f"S{self.receiver}"
        left = self.value(self.dma, f"{stream}NDTR")
        if self.slots is None:
            # labwired counted one item when the stream was switched on.
            self.slots = left = left + 1
        address = self.value(self.dma, f"{stream}M0AR") + 2 * (self.slots - left)
        shift = address % 4 * 8
        others = self.sim.read_u32(address & ~3) & ~(0xFFFF << shift)
        self.sim.write_u32(address & ~3, others | (self.value(self.uart, "DR") & 0x1FF) << shift)
        self.set(self.dma, f"{stream}NDTR", left - 1 or self.slots)

    def until(self, mark, limit):
        """Runs until the board has sent `mark`, for at most `limit` seconds. Returns the output up to then."""
        said, end = b"", self.sim.time + limit
        while mark not in said:
            if self.sim.time >= end:
                raise Broken(f"{mark!r} did not come within {limit * 1000:.0f} ms; the board said {said[-200:]!r}")
            self.run(STEP_S)
            said, self.said = said + self.said, b""
        return said.decode("latin1")

    def put(self, byte):
        """Makes a byte arrive at the UART now."""
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
        """Sends a line. Returns the output up to its answer, which must be `ok`."""
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
        """Performs the reset that software can request (AIRCR, SYSRESETREQ). Flash and the environment of the chip keep
        their state.

        labwired resets only the processor. So this method disables SysTick and the interrupts, which would act before
        the firmware sets them up again. It resets twice because labwired, after a reset at some moments, skips the loop
        that clears memory (apparently when the reset hits an IT block).
        """
        for _ in range(2):
            self.sim.write_u32(AIRCR, RESET)
            self.sim.write_u32(SYST_CSR, 0)
            for word in range(3):
                self.sim.write_u32(ICER + 4 * word, 0xFFFF_FFFF)
                self.sim.write_u32(ICPR + 4 * word, 0xFFFF_FFFF)
            self.run(0.000_001)
        self.forget()
