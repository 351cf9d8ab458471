"""A board that runs an unmodified image: processor, memory, peripherals, pins and time.

Every access to something that is not modelled fails with the position in the program. Every change of an output is
recorded with its time in core cycles. The folder models/ has the registers, core.py the cost of instructions; the cases
and host.py emulate the devices at the pins.

Entering an exception takes 12 cycles, leaving it 12, going from one directly to the next 6. Flash wait states multiply
the cost of instructions by 1.1 in the step interrupt, whose code is usually cached, and by 1.3 elsewhere. Reading a
register on an APB bus stalls the processor for two clocks of that bus (the two phases of an APB transfer); a write does
not stall it. Accesses to AHB registers cost nothing beyond the instruction.
"""

import bisect
import ctypes
import struct

from elftools.elf.elffile import ELFFile
from unicorn import UC_HOOK_MEM_WRITE, UC_PROT_ALL

from .core import ASLEEP, DEADLINE, EXCEPTION_RETURN, FAULT, Core
from .models.clock_meter import ClockMeter
from .models.dma import Dma
from .models.exti import Exti
from .models.flash import Flash
from .models.gpio import Gpio
from .models.iwdg import Iwdg
from .models.nvic import HARD_FAULT, SYSTICK, Nvic
from .models.otg import OtgFs
from .models.peripheral import Misuse, Peripheral, Unmodelled
from .models.pulse import PulseTimer
from .models.pwr import Pwr
from .models.rcc import HSI_HZ, Rcc
from .models.syscfg import SYSTEM_MEMORY, Syscfg
from .models.timer import FUNCTION, INPUTS, SMCR, AdvancedPwm, Timer
from .models.usart import Usart

ENTRY_CYCLES, RETURN_CYCLES, CHAIN_CYCLES = 12, 12, 6
WAIT_STATES_FROM_V = 2.7
"""Minimum supply, V, for which the wait states of `parts.py` are valid."""
HOT, COLD = round(1.1 * 256), round(1.3 * 256)
FILL = b"\xa5"
"""Contents of each byte of RAM at power-up."""
PAINTS = (4 * FILL, (0xA5C3_5A3C).to_bytes(4, "little"))
"""The two values of a stack word that was never used: the emulation's fill of RAM, and the pattern with which the
firmware marks unused stack (its stack paint)."""


WORD = struct.Struct("<I")

BREAKPOINT = 7
"""Unicorn's exception number for a BKPT instruction."""


class Failure(Exception):
    """The emulation cannot continue, or the board does not behave as a case requires."""


class Image:
    """An ELF file: the contents for flash, and the names of addresses."""

    def __init__(self, path):
        self.path = path
        with open(path, "rb") as file:
            elf = ELFFile(file)
            self.segments = [
                (s["p_paddr"], s.data()) for s in elf.iter_segments() if s["p_type"] == "PT_LOAD" and s["p_filesz"]
            ]
            self.symbols, functions = {}, []
            for symbol in elf.get_section_by_name(".symtab").iter_symbols():
                if symbol.name:
                    self.symbols.setdefault(symbol.name, symbol["st_value"])
                if symbol["st_info"]["type"] == "STT_FUNC":
                    functions.append((symbol["st_value"] & ~1, symbol["st_size"], symbol.name))
        self.functions = sorted(functions)
        self.starts = [start for start, _, _ in self.functions]

    def place(self, address):
        """Returns the function and offset of an address as text, for example `memcpy+0x12`."""
        if found := self._find(address):
            start, _, name = found
            return f"{name}+{address - start:#x}"
        return f"{address:#010x}"

    def function(self, address):
        """Returns the symbol of the function at an address, or `elsewhere` if no function is there."""
        found = self._find(address)
        return found[2] if found else "elsewhere"

    def _find(self, address):
        index = bisect.bisect_right(self.starts, address) - 1
        if index >= 0 and address < self.functions[index][0] + max(self.functions[index][1], 2):
            return self.functions[index]
        return None


# Sources for this file: base addresses from RM0383 and RM0390, "Memory map", register boundary addresses; interrupt
# numbers from their vector tables; bits of the enable registers from RCC_AHB1ENR, RCC_APB1ENR and RCC_APB2ENR.
UNIQUE_ID = bytes.fromhex("3300210007504b4b38373320")
"""The chip's unique number (96 bits), taken from a real part."""


LOADER = 0x1FFF_0000
"""The chip's boot loader, in ROM: its vector table."""
LOADER_STACK, LOADER_START = 0x2000_2D40, LOADER + 0x200


def _due(peripheral):
    return peripheral.due


class Board:
    """One board. Its time is `now`, in core cycles since power-up; `seconds` converts it to seconds."""

    def __init__(self, wiring, image):
        self.wiring, self.part, self.image = wiring, wiring.part, image
        self.core = Core(image)
        self.state = self.core.state
        self.failure = None
        self.faults_expected = False
        self.faults = []
        self.resets = []
        self.edges = []
        """(cycle, port, pin, level) of every change of an output; level is 0, 1, None (not driven) or "AF" (alternate
        function)."""
        self.watchers = []
        self.operations_left = None
        self.clocks = [(0, 0.0, 16_000_000)]
        """(cycle, seconds since power-up, core clock in Hz) at each change of the core clock."""
        self.powered = True
        self.supply_v = 3.3
        self._reset_asked = None
        self._fixes = []
        self._vectors = {}
        self.has_debugger = False
        """Whether a debug probe is connected: without one, a semihosting call that ends the program is a fault."""
        self.ended = None
        """The status with which the program has ended itself; None while it runs."""
        self.step_runs = []
        """(cycle of entry, cycle after the return) of each run of the step interrupt."""
        self.serial = 16 + wiring.serial_irq
        """Exception number of the serial task's interrupt."""
        self.begins = {SYSTICK: [], self.serial: []}
        """Cycles at which the input samples (SysTick) and the runs of the serial task began, by exception number."""
        self.held = False
        """While true, no interrupt is taken, as if code had masked all of them. Independent of the program's own
        masks."""
        self._asleep = False
        self._next_due = None
        self._map()
        self._fit()
        self.power_on()

    # Construction.

    def _map(self):
        uc, part = self.core.uc, self.part
        uc.mem_map(part.flash_start, part.flash_kib * 1024, UC_PROT_ALL)
        # RAM is memory of this process and not of unicorn, so that DMA accesses it without calling unicorn.
        self.ram = (ctypes.c_char * (part.ram_kib * 1024))()
        uc.mem_map_ptr(part.ram_start, part.ram_kib * 1024, UC_PROT_ALL, ctypes.addressof(self.ram))
        self.write_memory(part.flash_start, b"\xff" * part.flash_kib * 1024)
        self.write_memory(part.ram_start, FILL * part.ram_kib * 1024)
        for address, data in self.image.segments:
            self.write_memory(address, data)
        guarded = self._guarded
        self.core.map_registers(0x4000_0000, 0x8_0000, guarded(self._read_register), guarded(self._write_register))
        self.core.map_registers(0x5000_0000, 0x4_0000, guarded(self._read_otg), guarded(self._write_otg))
        # System memory holds an endless loop in place of the chip's boot loader, and the unique number at 0x1FFF_7A10.
        uc.mem_map(LOADER, 0x8000, UC_PROT_ALL)
        self.write_memory(LOADER, struct.pack("<II", LOADER_STACK, LOADER_START | 1))
        self.write_memory(LOADER_START, b"\xfe\xe7")  # b .
        self.write_memory(0x1FFF_7A10, UNIQUE_ID)
        self.core.map_registers(0x4200_0000, 0x100_0000, guarded(self._read_bit), guarded(self._write_bit))
        self.core.map_registers(0xE000_0000, 0x10_0000, guarded(self._read_core), guarded(self._write_core))
        uc.hook_add(
            UC_HOOK_MEM_WRITE, guarded(self._store_to_flash), None, part.flash_start, part.flash_start + part.flash_kib * 1024 - 1
        )

    def _fit(self):
        self.peripherals = {}
        self.pages = {}
        self.dma = []
        self.nvic = None
        fit = self._add
        self.rcc = fit(0x4002_3800, Rcc("RCC", self))
        self.nvic = Nvic(self, self.part.interrupts)
        self.peripherals["NVIC"] = self.nvic
        fit(0x4000_7000, Pwr("PWR", self))
        self.flash = fit(0x4002_3C00, Flash("FLASH", self))
        for bit, name in enumerate("ABCDEFGH"):
            gpio = Gpio(f"GPIO{name}", self)
            gpio.CLOCK = (0x30, bit)
            fit(0x4002_0000 + 0x400 * bit, gpio)
        for name, base, bit, irq, wide in (
            ("TIM2", 0x4000_0000, 0, 28, True),
            ("TIM3", 0x4000_0400, 1, 29, False),
            ("TIM4", 0x4000_0800, 2, 30, False),
            ("TIM5", 0x4000_0C00, 3, 50, True),
        ):
            fit(base, Timer(name, self, bit, irq, wide, base))
        for name, base, clock, irq, bus in (
            ("USART1", 0x4001_1000, (0x44, 4), 37, "pclk2"),
            ("USART2", 0x4000_4400, (0x40, 17), 38, "pclk1"),
        ):
            fit(base, Usart(name, self, base, clock, irq, bus))
        fit(0x4001_4800, ClockMeter("TIM11", self))
        slaves = self.peripherals["TIM5"].slaves
        if self.wiring.pulse_timer == "TIM8":
            fit(0x4001_0000, AdvancedPwm("TIM1", self))
        else:
            slaves.append(fit(0x4001_0000, PulseTimer("TIM1", self)))
        if self.part.has_tim8:
            slaves.append(fit(0x4001_0400, PulseTimer("TIM8", self)))
        self.dma = [fit(0x4002_6000, Dma("DMA1", self, 21)), fit(0x4002_6400, Dma("DMA2", self, 22))]
        self.otg = self.peripherals["OTG_FS"] = OtgFs("OTG_FS", self)
        self.exti = fit(0x4001_3C00, Exti("EXTI", self))
        self.syscfg = fit(0x4001_3800, Syscfg("SYSCFG", self))
        self.iwdg = fit(0x4000_3000, Iwdg("IWDG", self))
        self.usart = self.peripherals[self.wiring.usart]
        self._timed = [p for p in self.peripherals.values() if type(p).advance is not Peripheral.advance]
        # The registers DWT_CTRL and DWT_CYCCNT, and of DBGMCU: IDCODE, CR and the two freeze registers. They only
        # store what is written, because no debugger halts this processor.
        self.plain = {0x1000: 0x4000_0001, 0x1004: 0, 0x4_2000: 0x1000_0431, 0x4_2004: 0, 0x4_2008: 0, 0x4_200C: 0}

    def _add(self, base, peripheral):
        self.peripherals[peripheral.name] = peripheral
        self.pages[base >> 10] = peripheral
        return peripheral

    # Power and reset.

    def power_on(self):
        """Starts at the reset vector. RAM keeps its contents."""
        for peripheral in self.peripherals.values():
            peripheral.reset()
        self.change_clock(16_000_000)
        self.core.library.reset()
        self.state.margin = COLD
        stack, start = struct.unpack("<II", self.read_memory(self.part.flash_start, 8))
        for name in ("primask", "basepri", "control"):
            self.core.write(name, 0)
        self.core.write("xpsr", 1 << 24)
        self.core.write("sp", stack)
        self.core.write("lr", 0xFFFF_FFFF)
        self.core.write("pc", start & ~1)
        self._asleep = False
        self._next_due = None

    def jump_from_loader(self, resets_clocks):
        """Starts the program as the chip's boot loader does, by a jump instead of a reset: system memory is at address
        0, and VTOR points to the vectors there. `resets_clocks`: True if the loader resets the clocks before the
        jump."""
        self.power_on()
        self.syscfg.values[0] = SYSTEM_MEMORY
        self.nvic.vectors = LOADER
        if not resets_clocks:
            # 60 MHz from HSI by the PLL, three wait states.
            self.flash.write(0x00, 3)
            self.rcc.write(0x04, 16 | 240 << 6 | 1 << 16 | 5 << 24)
            self.rcc.write(0x00, self.rcc.values[0x00] | 1 << 24)
            self.rcc.write(0x08, 2 | 0b100 << 10)

    def request_reset(self, flags, why):
        """Called by models: the chip resets after the current instruction. `flags` are the reset flags for RCC_CSR."""
        self._reset_asked = (flags, why)
        self.state.deadline = 0

    def _do_reset(self):
        from .models.rcc import SOFTWARE_RESET

        flags, why = self._reset_asked
        self._reset_asked = None
        self.resets.append((self.now, why))
        self.rcc.note_reset(SOFTWARE_RESET if flags is None else flags)
        self.power_on()

    # Time.

    @property
    def now(self):
        return self.state.now

    def change_clock(self, hz):
        last, seconds, before = self.clocks[-1]
        if hz != before:
            for peripheral in self.peripherals.values():
                peripheral.clock_changed()
            self.clocks.append((self.now, seconds + (self.now - last) / before, hz))

    def slow_down(self, hz):
        """Changes the core's clock while models run. Only the watchdog's model adapts its time to the new clock."""
        self.iwdg.slowed_down(hz / self.clocks[-1][2])
        self.clocks.append((self.now, self.seconds(), hz))

    def seconds(self, cycle=None):
        """Returns the time of a cycle in seconds since power-up; default: now."""
        cycle = self.now if cycle is None else cycle
        since, seconds, hz = next(entry for entry in reversed(self.clocks) if entry[0] <= cycle)
        return seconds + (cycle - since) / hz

    def cycles(self, seconds):
        return round(seconds * self.clocks[-1][2])

    def stall(self, seconds):
        """Stalls the processor while everything else continues."""
        self.state.now += self.cycles(seconds)
        self.state.deadline = 0

    def stand(self, seconds):
        """Stalls the processor in the middle of a register access. All events of the models during the stall happen
        before the access takes effect."""
        self.stall(seconds)
        self._advance()

    def replan(self):
        """Makes the board compute the time of the next event again. A model calls this after it has changed its
        `due`."""
        self._next_due = None
        self.state.deadline = 0

    def look(self):
        """Makes the board check for interrupts after the current instruction. Models call this when an interrupt may
        have become pending."""
        self.state.deadline = 0

    def mask(self, seconds):
        """Runs for a time without taking interrupts, as if code had masked them."""
        self.held = True
        self.look()
        self.run(seconds=seconds)
        self.held = False
        self.look()

    def check_supply(self, hclk):
        limit = self.peripherals["PWR"].limit()
        if hclk > limit:
            raise Misuse(f"core clock {hclk} Hz beyond the {limit} Hz of the supply's scale")
        if hclk > HSI_HZ and self.supply_v < WAIT_STATES_FROM_V:
            raise Misuse(f"core clock {hclk} Hz at {self.supply_v} V: the wait states are those for {WAIT_STATES_FROM_V} V or more")
        self.flash.check(hclk)

    def power_left(self, _):
        """Called before each flash operation: counts down to the power cut that a case has requested. Returns whether
        there is still power."""
        if self.operations_left is None:
            return True
        self.operations_left -= 1
        if self.operations_left < 0:
            self.powered = False
            self.state.deadline = 0
            return False
        return True

    def set_supply(self, volts):
        """Changes the supply voltage. Below 1.7 V a real chip would be reset; here the case must do that."""
        self.supply_v = volts
        self.peripherals["PWR"].supply_changed()

    # Memory and registers.

    def read_memory(self, address, size):
        return bytes(self.core.uc.mem_read(address, size))

    def write_memory(self, address, data):
        self.core.uc.mem_write(address, data)

    def dma_load(self, address):
        """Reads a word of RAM for a DMA stream."""
        return WORD.unpack_from(self.ram, self._ram_at(address))[0]

    def _ram_at(self, address):
        at = address - self.part.ram_start
        if not 0 <= at <= len(self.ram) - WORD.size:
            raise Unmodelled(f"DMA reaches {address:#010x}, which is no RAM")
        return at

    def word(self, symbol):
        """Returns a word of RAM or flash, by symbol or address."""
        address = self.image.symbols[symbol] if isinstance(symbol, str) else symbol
        return struct.unpack("<I", self.read_memory(address, 4))[0]

    def _guarded(self, function):
        """Wraps a callback: no exception must pass through unicorn, so the exception is stored, and `run` raises it."""

        def call(*arguments):
            try:
                return function(*arguments) or 0
            except (Unmodelled, Misuse, Failure) as failure:
                self._fail(f"{type(failure).__name__}: {failure}")
            except Exception as failure:  # a fault of the emulation itself
                import traceback

                self._fail(f"the emulation is at fault: {failure!r}\n{traceback.format_exc()}")
            return 0

        return call

    def _fail(self, why):
        if self.failure is None:
            self.failure = why
        self.core.uc.emu_stop()

    def _at(self, address):
        peripheral = self.pages.get(address >> 10)
        if peripheral is None:
            raise Unmodelled(f"nothing is modelled at {address:#010x}")
        if peripheral.CLOCK is not None:
            self.rcc.check_clock(peripheral)
        return peripheral

    def _read_register(self, uc, offset, size, _):
        address = 0x4000_0000 + offset
        peripheral = self._at(address)
        if offset < 0x2_0000:
            rcc = self.rcc
            self.state.wait += 2 * (rcc.hclk // (rcc.pclk1 if offset < 0x1_0000 else rcc.pclk2))
        value = peripheral.read(address & 0x3FC)
        return value >> 8 * (address & 3) & (1 << 8 * size) - 1

    def _write_register(self, uc, offset, size, value, _):
        address = 0x4000_0000 + offset
        if address & 3 or size == 1:
            raise Unmodelled(f"store of {size} bytes to {address:#010x}")
        self._at(address).write(address & 0x3FC, value)

    def puts_out_steps(self):
        """Returns whether the step output is on: the pulse timer reacts to its trigger, so DMA2 can write to a port at
        any time."""
        return bool(self.peripherals[self.wiring.pulse_timer].values[SMCR] & 7)

    def store_by_dma(self, address, value, at):
        """Writes a word for a DMA stream, at cycle `at`, which can be up to one instruction before now."""
        if address >> 28 == 2:
            WORD.pack_into(self.ram, self._ram_at(address), value)
        else:
            self._at(address).store_by_dma(address & 0x3FC, value, at)

    def _read_otg(self, uc, offset, size, _):
        # OTG_FS is on AHB2, so an access does not wait for a slower bus. The firmware reads the receive FIFO at
        # endpoint 0's address.
        return self._otg_on().read(offset)

    def _write_otg(self, uc, offset, size, value, _):
        self._otg_on().write(offset, value)

    def _otg_on(self):
        self.rcc.check_clock(self.otg)
        return self.otg

    def _read_bit(self, uc, offset, size, _):
        address, bit = 0x4000_0000 + (offset >> 7 << 2), offset >> 2 & 31
        return self._at(address).read(address & 0x3FC) >> bit & 1

    def _write_bit(self, uc, offset, size, value, _):
        address, bit = 0x4000_0000 + (offset >> 7 << 2), offset >> 2 & 31
        peripheral = self._at(address)
        before = peripheral.read(address & 0x3FC)
        peripheral.write(address & 0x3FC, before & ~(1 << bit) | (value & 1) << bit)

    def _read_core(self, uc, offset, size, _):
        if offset == 0x1004:
            return self.now & 0xFFFF_FFFF
        if offset in self.plain:
            return self.plain[offset]
        value = self.nvic.read((offset & ~3) - 0xE000)
        return value >> 8 * (offset & 3) & (1 << 8 * size) - 1

    def _write_core(self, uc, offset, size, value, _):
        if offset in self.plain:
            self.plain[offset] = value
        elif offset == 0x1FB0:
            pass  # DWT_LAR, the lock of the cycle counter.
        elif size == 1:
            self.nvic.write_byte(offset - 0xE000, value)
        elif size == 4:
            self.nvic.write(offset - 0xE000, value)
        else:
            raise Unmodelled(f"store of {size} bytes to {0xE000_0000 + offset:#010x}")

    def _store_to_flash(self, uc, access, address, size, value, _):
        # Unicorn calls this hook before the store, and the hook cannot prevent the store. So the correct contents of
        # flash are written again right after it.
        self.flash.program(address, size, value & (1 << 8 * size) - 1)
        self._fixes.append((address, self.read_memory(address, size)))
        self.state.deadline = 0

    # Pins.

    def edge(self, port, pin, level, at=None):
        edge = (self.now if at is None else at, port, pin, level)
        self.edges.append(edge)
        for watcher in self.watchers:
            watcher(edge)

    def pin(self, name):
        """Returns the port's model and the number of a pin such as "A10"."""
        return self.peripherals["GPIO" + name[0]], int(name[1:])

    def level(self, name):
        gpio, pin = self.pin(name)
        return gpio.level(pin)

    def shown(self, name):
        gpio, pin = self.pin(name)
        return gpio.shown[pin]

    def drive(self, name, level):
        gpio, pin = self.pin(name)
        before = gpio.level(pin)
        gpio.drive(pin, level)
        timer, channel = INPUTS.get((name[0], pin), (None, None))
        if timer and gpio.function(pin) == FUNCTION and gpio.level(pin) != before:
            self.peripherals[timer].edge(channel)

    # Running.

    def run(self, cycles=None, seconds=None, until=None, limit=None):
        """Runs for `cycles` or for `seconds`, and returns True. If `until` is given, runs until `until()` is true, at
        most for `limit` seconds, and returns whether it became true; `until()` is checked after each event. In both
        cases returns False if the board loses power or the program ends itself."""
        state = self.state
        seconds = limit if seconds is None else seconds
        stop = None if seconds is None else self.seconds() + seconds
        end, clocks = self.now + (cycles or 0), None
        while self.powered and self.ended is None:
            if until is not None and until():
                return True
            if stop is not None and clocks != len(self.clocks):
                clocks, end = len(self.clocks), self.now + self.cycles(stop - self.seconds())
            if state.now >= end:
                return until is None
            self._slice(end)
            if self.failure:
                raise Failure(f"{self.failure}\n  at {self.image.place(state.at)}, {self.seconds():.6f} s after power-up")
        return False

    def _slice(self, end):
        state, nvic = self.state, self.nvic
        try:
            self._advance()
            if self._reset_asked:
                self._do_reset()
            number, masked = nvic.takeable(state.primask or self.held, state.basepri)
        except (Unmodelled, Misuse) as failure:
            self.failure = f"{type(failure).__name__}: {failure}"
            return
        state.pending = masked
        if number is not None:
            self._asleep = False
            self._enter(number, ENTRY_CYCLES)
        if self._asleep and self._next_due is not None:
            if masked:
                self._asleep = False
            else:
                state.now = max(state.now, min(self._next_due, end))
                return
        if self._next_due is None:
            self._next_due = min([p.due for p in self._timed])
        state.deadline = min(self._next_due, end)
        if state.deadline <= state.now:
            return
        error = self.core.run()
        if self._fixes:
            for address, data in self._fixes:
                self.write_memory(address, data)
            self._fixes.clear()
        if self.failure:
            return
        if state.reason == FAULT and state.fault == BREAKPOINT and self.has_debugger:
            self._end()
        elif error or state.reason == FAULT:
            self._fault(error)
        elif state.reason == ASLEEP:
            self._guarded(self.rcc.check_sleep)()
            self._asleep = True
            self.core.write("pc", state.at + 2)
            state.next = state.at + 2
            state.now += 1
        elif state.reason == EXCEPTION_RETURN:
            self._leave()
        elif state.reason != DEADLINE:
            self.failure = f"unicorn stopped for an unknown reason ({state.reason})"

    def _advance(self):
        while True:
            if self._next_due is None:
                self._next_due = min([p.due for p in self._timed])
            now = self.state.now
            if self._next_due > now:
                return
            due = [p for p in self._timed if p.due <= now]
            if len(due) > 1:
                due.sort(key=_due)
            for peripheral in due:
                peripheral.advance(now)
            self._next_due = None

    def _enter(self, number, cycles):
        key = self.nvic.vectors + 4 * number
        vector = self._vectors.get(key)
        if vector is None:
            vector = self._vectors[key] = self.word(key)
        thread = not self.nvic.active
        self.nvic.begin(number)
        if number == 16 + self.wiring.step_irq:
            self._step_began = self.now
        if number in self.begins:
            self.begins[number].append(self.now)
        if not self.core.enter(number, vector, thread) and number != HARD_FAULT:
            self._fault(0)
            return
        self.state.now += cycles
        self.state.margin = HOT if number == 16 + self.wiring.step_irq else COLD

    def _leave(self):
        state, nvic = self.state, self.nvic
        code = self.core.library.counter(self.core.handle) | 1
        if not nvic.active:
            self.failure = f"exception return {code:#x} without an exception"
            return
        if nvic.end() == 16 + self.wiring.step_irq:
            self.step_runs.append((self._step_began, self.now + RETURN_CYCLES))
        if bool(code & 8) != (not nvic.active):
            self.failure = f"exception return {code:#x} to the wrong mode, active {nvic.active}"
            return
        self.core.leave(code)
        number, masked = nvic.takeable(state.primask or self.held, state.basepri)
        state.pending = masked
        if number is not None:
            nvic.chained += 1
            self._enter(number, CHAIN_CYCLES)
            return
        state.now += RETURN_CYCLES
        running = nvic.active[-1][0] if nvic.active else None
        state.margin = HOT if running == 16 + self.wiring.step_irq else COLD

    def _end(self):
        """Handles a breakpoint if a debug probe is connected: only SYS_EXIT_EXTENDED of Arm's semihosting is
        allowed."""
        code, = struct.unpack("<H", self.read_memory(self.state.at, 2))
        operation, block = self.core.read("r0"), self.core.read("r1")
        if code != 0xBEAB or operation != 0x20:
            self.failure = f"breakpoint {code:#x}, operation {operation:#x}"
            return
        reason, status = struct.unpack("<II", self.read_memory(block, 8))
        self.ended = status if reason == 0x20026 else -1

    def _fault(self, error):
        state = self.state
        why = f"fault {state.fault} (unicorn error {error}, address {state.invalid_address:#010x}) at {self.image.place(state.at)}"
        self.faults.append((self.now, state.at, state.invalid_address))
        if any(number == HARD_FAULT for number, _ in self.nvic.active):
            self.failure = f"lockup: {why}"
        elif not self.faults_expected:
            self.failure = why
        else:
            self.core.write("pc", state.at)
            self._enter(HARD_FAULT, ENTRY_CYCLES)

    # Use of the stack.

    def stack_used(self):
        """Returns the number of stack bytes that have been in use, and the stack's size. Words that still hold one of
        `PAINTS` count as unused."""
        bottom, top = self.image.symbols["_stack_end"], self.image.symbols["_stack_start"]
        stack = self.read_memory(bottom, top - bottom)
        free = 0
        while free < len(stack) and stack[free : free + 4] in PAINTS:
            free += 4
        return len(stack) - free, len(stack)

    def refill_stack(self):
        """Marks the stack below the present stack pointer as unused."""
        bottom = self.image.symbols["_stack_end"]
        self.write_memory(bottom, FILL * (self.core.read("sp") - bottom))


__all__ = ["Board", "Failure", "Image"]
