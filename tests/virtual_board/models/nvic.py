"""The core's own peripherals: NVIC, system control block, SysTick, cycle counter (ARMv7-M architecture manual, part B).

Modelled: enable bits, pending bits, active bits and 4-bit priorities of interrupts; level-sensitive lines (a line that
is still high at the return pends again); preemption, tail-chaining, PRIMASK, BASEPRI, software pending, SysTick from
the core clock, the reset request, the NMI, FPU access control, the fault registers as plain words, DWT_CYCCNT.
Not modelled: priority grouping; late arrival (here, an interrupt of higher priority that arrives during exception entry
is taken after the entry); faults other than HardFault; SLEEPONEXIT and deep sleep; MPU; ITM; the reference clock of
SysTick; FPU access before it is enabled (works here, faults on a real part).
"""

from .peripheral import NEVER, Misuse, Peripheral, Unmodelled

PRIORITY_BITS = 0xF0
"""An STM32F4 implements the upper four of eight bits: PM0214, "Interrupt priority registers"."""
NMI, HARD_FAULT, SVCALL, PENDSV, SYSTICK = 2, 3, 11, 14, 15
THREAD = 256
"""Priority of a processor that runs no exception: lower than all others."""

CSR, RVR, CVR = 0x010, 0x014, 0x018
ISER, ICER, ISPR, ICPR, IABR, IPR = 0x100, 0x180, 0x200, 0x280, 0x300, 0x400
CPUID, ICSR, VTOR, AIRCR, SCR, CCR, SHPR, SHCSR = 0xD00, 0xD04, 0xD08, 0xD0C, 0xD10, 0xD14, 0xD18, 0xD24
CFSR, HFSR, MMFAR, BFAR, CPACR, FPCCR = 0xD28, 0xD2C, 0xD34, 0xD38, 0xD88, 0xF34
DEMCR = 0xDFC
PLAIN = {CCR: 0x200, SHCSR: 0, CFSR: 0, HFSR: 0, MMFAR: 0, BFAR: 0, CPACR: 0, FPCCR: 0xC000_0000, DEMCR: 0, SCR: 0}


class Nvic(Peripheral):
    def __init__(self, board, interrupts):
        self.count = interrupts
        super().__init__("NVIC", board)

    def reset(self):
        super().reset()
        self.priorities = [0] * (16 + self.count)
        self.enabled = {NMI, HARD_FAULT, SVCALL, PENDSV, SYSTICK}
        self.pending = set()
        self.lines = set()
        """Exceptions whose line is high."""
        self.active = []
        """Stack of the active exceptions, as (number, priority); the newest last."""
        self.plain = dict(PLAIN)
        self.vectors = self.board.part.flash_start
        self.csr = self.reload = 0
        self.zero_at = NEVER
        self.counted = False
        self.entries = {}
        """How often each exception was entered."""
        # How often an exception was entered directly from another one (tail-chaining).
        self.chained = 0

    # The lines of the peripherals.

    def level(self, irq, up):
        """Sets the interrupt line of a peripheral. A rise makes the interrupt pending."""
        number = 16 + irq
        if up:
            if number not in self.lines:
                self.lines.add(number)
                self.pending.add(number)
                self.board.look()
        else:
            # Hardware keeps a pending interrupt even if its line falls before it is taken: do not clear `pending`.
            self.lines.discard(number)

    def priority(self, number):
        return {NMI: -2, HARD_FAULT: -1}.get(number, self.priorities[number])

    def running(self):
        """Returns the priority of the running code. PRIMASK and BASEPRI are ignored."""
        return min((p for _, p in self.active), default=THREAD)

    def best(self):
        """Returns the most urgent pending exception, whatever runs at present."""
        ready = [n for n in self.pending if n in self.enabled]
        return min(ready, key=lambda n: (self.priority(n), n)) if ready else None

    def takeable(self, primask, basepri):
        """Returns the exception to take now (or None), and whether an exception waits only because of a mask."""
        if not self.pending:
            return None, False
        best = self.best()
        if best is None:
            return None, False
        priority = self.priority(best)
        if priority >= self.running():
            return None, False
        if best not in (NMI, HARD_FAULT) and (primask or basepri and priority >= basepri):
            return None, True
        return best, False

    def begin(self, number):
        """Marks an exception as active and no longer pending."""
        self.pending.discard(number)
        self.active.append((number, self.priority(number)))
        self.entries[number] = self.entries.get(number, 0) + 1

    def end(self):
        """Ends the newest active exception and returns its number. The exception pends again if its line is still
        high."""
        number, _ = self.active.pop()
        if number in self.lines:
            self.pending.add(number)
        return number

    def raise_fault(self):
        self.pending.add(HARD_FAULT)
        self.board.look()

    # Registers, by their offset from 0xE000_E000.

    def _bits(self, offset, base):
        word = offset - base >> 2
        return [16 + 32 * word + n for n in range(32) if 32 * word + n < self.count]

    def read(self, offset):
        if offset == CSR:
            value = self.csr | self.counted << 16
            self.counted = False
            return value
        if offset == RVR:
            return self.reload
        if offset == CVR:
            return 0 if self.zero_at == NEVER else min(self.zero_at - self.board.now, self.reload)
        for base, names in ((ISER, self.enabled), (ICER, self.enabled), (ISPR, self.pending), (ICPR, self.pending)):
            if base <= offset < base + 0x20:
                return sum(1 << k for k, n in enumerate(self._bits(offset, base)) if n in names)
        if IPR <= offset < IPR + self.count:
            return sum(self.priorities[16 + offset - IPR + k] << 8 * k for k in range(4) if offset - IPR + k < self.count)
        if SHPR <= offset < SHPR + 12:
            return sum(self.priorities[4 + offset - SHPR + k] << 8 * k for k in range(4))
        if offset == CPUID:
            return 0x410F_C241
        if offset == ICSR:
            active = self.active[-1][0] if self.active else 0
            best = self.best() or 0
            return active | best << 12 | (not self.active[1:]) << 11 | (SYSTICK in self.pending) << 26
        if offset == VTOR:
            return self.vectors
        if offset == AIRCR:
            return 0xFA05_0000
        if offset in self.plain:
            return self.plain[offset]
        raise Unmodelled(f"the core's register at {0xE000_E000 + offset:#x} has no model")

    def write_byte(self, offset, value):
        if IPR <= offset < IPR + self.count:
            self.priorities[16 + offset - IPR] = value & PRIORITY_BITS
        elif SHPR <= offset < SHPR + 12:
            self.priorities[4 + offset - SHPR] = value & PRIORITY_BITS
        else:
            raise Unmodelled(f"byte store to the core's register at {0xE000_E000 + offset:#x}")
        self.board.look()

    def write(self, offset, value):
        if offset == CSR:
            if value & ~7 or not value & 4 and value & 1:
                raise Unmodelled(f"SysTick: CSR {value:#x}")
            if value & 1 and not self.csr & 1:
                # The first cycle loads the counter.
                self.zero_at = self.board.now + 1 + self.reload
                self.plan(self.zero_at)
            elif not value & 1:
                self.zero_at = NEVER
                self.plan(NEVER)
            self.csr = value
        elif offset == RVR:
            self.reload = value & 0xFF_FFFF
        elif offset == CVR:
            self.counted = False
            if self.csr & 1:
                self.zero_at = self.board.now + 1 + self.reload
                self.plan(self.zero_at)
        elif ISER <= offset < ISER + 0x20:
            self.enabled |= {n for k, n in enumerate(self._bits(offset, ISER)) if value >> k & 1}
        elif ICER <= offset < ICER + 0x20:
            self.enabled -= {n for k, n in enumerate(self._bits(offset, ICER)) if value >> k & 1}
        elif ISPR <= offset < ISPR + 0x20:
            self.pending |= {n for k, n in enumerate(self._bits(offset, ISPR)) if value >> k & 1}
        elif ICPR <= offset < ICPR + 0x20:
            named = {n for k, n in enumerate(self._bits(offset, ICPR)) if value >> k & 1}
            self.pending -= named - self.lines
        elif offset == ICSR:
            if value & ~(1 << 25 | 1 << 26 | 1 << 27 | 1 << 28):
                raise Unmodelled(f"ICSR {value:#x}")
            for bit, number in ((26, SYSTICK), (28, PENDSV)):
                if value >> bit & 1:
                    self.pending.add(number)
                if value >> bit - 1 & 1:
                    self.pending.discard(number)
        elif offset == AIRCR:
            if value >> 16 != 0x5FA:
                raise Misuse(f"AIRCR {value:#x} without its key")
            if value & 0x700:
                raise Unmodelled("priority grouping")
            if value & 4:
                self.board.request_reset(None, "software")
        elif offset == VTOR:
            self.vectors = value
        elif IPR <= offset < IPR + self.count or SHPR <= offset < SHPR + 12:
            for k in range(4):
                self.write_byte(offset + k, value >> 8 * k & 0xFF)
        elif offset == SCR and value:
            raise Unmodelled(f"SCR {value:#x}")
        elif offset in self.plain:
            self.plain[offset] = value
        elif offset == 0xF00:
            self.pending.add(16 + (value & 0x1FF))
        else:
            raise Unmodelled(f"the core's register at {0xE000_E000 + offset:#x} has no model")
        self.board.look()

    def clock_changed(self):
        if self.csr & 1:
            raise Unmodelled("SysTick runs while clocks change")

    def advance(self, now):
        self.counted = True
        if self.csr & 2:
            self.pending.add(SYSTICK)
            self.board.look()
        # The counter stays at 0 for one cycle and is reloaded in the next.
        self.zero_at = self.due + self.reload + 1
        self.plan(self.zero_at)
