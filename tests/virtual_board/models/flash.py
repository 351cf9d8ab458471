"""Flash interface (RM0390 chapter 3, RM0383 chapter 3).

Modelled: wait states checked against the core clock (2.7 to 3.6 V); key sequence (a wrong key locks until reset);
sector erase; programming in units of PSIZE, which can only clear bits; the error flags PGSERR, PGPERR, PGAERR, which
prevent an operation from starting; BSY. The processor and its interrupts stall during an operation, as the code is in
the same bank. Durations are the typical ones of the data sheets: a word 16 us, sectors of 16/64/128 KiB 250/550/1000 ms
at x32.
Not modelled: caches (core.c uses a margin instead), option bytes, mass erase, write protection, interrupts of the flash
itself, code that runs from RAM during an operation (here it stalls, too).
"""

from .peripheral import Misuse, Peripheral, Unmodelled

ACR, KEYR, SR, CR = 0x00, 0x04, 0x0C, 0x10
PG, SER, MER, STRT, LOCK = 1 << 0, 1 << 1, 1 << 2, 1 << 16, 1 << 31
EOP, PGAERR, PGPERR, PGSERR, BSY = 1 << 0, 1 << 5, 1 << 6, 1 << 7, 1 << 16
KEYS = (0x4567_0123, 0xCDEF_89AB)
"""RM0383 and RM0390, "Unlocking the Flash control register"."""
BASE = 0x0800_0000
PROGRAM_S = 16e-6
ERASE_S = {16: 0.25, 64: 0.55, 128: 1.0}
"""Duration of an erase by sector size in KiB: data sheet of the STM32F411, "Flash memory programming", typical."""
SLOWER = {0: 1.6, 1: 1.2, 2: 1.0}
"""Factor on the duration of an erase, by PSIZE: 16 KiB take 400 ms at x8 and 300 ms at x16 instead of 250 ms."""


class Flash(Peripheral):
    REGISTERS = {
        ACR: ("ACR", 0, 0x1F0F),
        KEYR: ("KEYR", 0, 0xFFFF_FFFF),
        SR: ("SR", 0, 0xF3),
        CR: ("CR", LOCK, LOCK | STRT | 0x300 | 0x78 | PG | SER),
    }

    def reset(self):
        super().reset()
        self.key = 0
        self.dead = False
        self.operations = self.erases = 0

    def read(self, offset):
        if offset == KEYR:
            raise Misuse("FLASH_KEYR is write-only")
        return super().read(offset)

    def write(self, offset, value):
        if offset == KEYR:
            return self._unlock(value)
        if offset == SR:
            # Writing 1 clears a flag.
            self.values[SR] &= ~(value & 0xF3)
            return None
        if offset == CR:
            if self.values[CR] & LOCK:
                raise Misuse(f"FLASH_CR is written ({value:#x}) while it is locked")
            super().write(offset, value)
            if value & STRT:
                self._erase(value)
            return None
        super().write(offset, value)
        if offset == ACR:
            self.check(self.board.rcc.hclk)
        return None

    def check(self, hclk):
        """Raises Misuse if the wait states are too few for a core clock."""
        latency = self.values[ACR] & 15
        limit = next((most for states, most in enumerate(self.board.part.wait_states) if states == latency), 1 << 40)
        if hclk > limit:
            raise Misuse(f"{latency} wait states at {hclk} Hz")

    def _unlock(self, value):
        if self.dead or value != KEYS[self.key]:
            self.dead = True
            raise Misuse("FLASH_KEYR: wrong key sequence")
        self.key = (self.key + 1) % 2
        if self.key == 0:
            self.values[CR] &= ~LOCK

    def _erase(self, value):
        if value & MER or not value & SER:
            raise Unmodelled(f"FLASH_CR {value:#x}: only sector erase is modelled")
        sector = value >> 3 & 15
        start, size = self.board.part.sector(sector)
        self.operations += 1
        self.erases += 1
        if not self.board.power_left(self):
            return
        self.board.write_memory(start, b"\xff" * size)
        self.board.stall(ERASE_S[size // 1024] * SLOWER[value >> 8 & 3])
        self.values[CR] &= ~STRT
        self.values[SR] |= EOP

    def program(self, address, size, value):
        """Carries out a store of the processor to flash: it can only clear bits. Raises Misuse if the registers of the
        flash interface do not allow the store."""
        cr = self.values[CR]
        if cr & LOCK or not cr & PG:
            self.values[SR] |= PGSERR
            raise Misuse(f"store to flash at {address:#010x} without PG")
        if self.values[SR] & (PGAERR | PGPERR | PGSERR):
            raise Misuse(f"store to flash at {address:#010x} with an error flag set: {self.values[SR]:#x}")
        if size != 1 << (cr >> 8 & 3):
            self.values[SR] |= PGPERR
            raise Misuse(f"store of {size} bytes to flash with PSIZE {cr >> 8 & 3}")
        before = int.from_bytes(self.board.read_memory(address, size), "little")
        self.operations += 1
        if self.board.power_left(self):
            self.board.write_memory(address, (before & value).to_bytes(size, "little"))
            self.board.stall(PROGRAM_S)
            self.values[SR] |= EOP
