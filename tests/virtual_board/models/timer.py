"""General-purpose timers TIM2 to TIM5 (RM0390 chapter 17, RM0383 chapter 13), and TIM1 where it makes only a PWM (RM0390
chapter 16).

Modelled: counting up from the internal clock; prescaler (loaded at an update); auto-reload; compare flags of channels 1
to 4 (set when the counter reaches CCRx, not when CCRx is written to the current count), flags by EGR, clearing flags by
writing 0; interrupt enables; PWM mode 1 as a duty cycle of the output, and an output forced low; capture of both edges
of a channel's own pin, with its DMA request, and overcapture; the DMA requests of the compare events of channels 1 and
3; the compare event of channel 1 as the trigger of other timers (CR2, MMS = 011).
Not modelled: capture of one edge or of another channel's pin; the delay of synchronizer and filter (the same for every
edge), and the pulses that the filter removes; slave and one-pulse mode (`pulse.py` has those of TIM1); preload of
compare registers; other triggers; DMA of other channels' compare events and of updates; counting down; edges of PWM
outputs.
"""

from .peripheral import NEVER, Misuse, Peripheral, Unmodelled
from .readings import is_chosen

FORCED_LOW = 4
"""OC1M of TIMx_CCMR1: the output is inactive, independent of the comparison."""
CR1, CR2, SMCR, DIER, SR, EGR, CCMR1, CCMR2, CCER = 0x00, 0x04, 0x08, 0x0C, 0x10, 0x14, 0x18, 0x1C, 0x20
CNT, PSC, ARR, CCR1, CCR2, CCR3, CCR4 = 0x24, 0x28, 0x2C, 0x34, 0x38, 0x3C, 0x40
BDTR, MOE = 0x44, 1 << 15
COMPARE = (CCR1, CCR2, CCR3, CCR4)
OWN_PIN, FILTERS, BOTH_EDGES = 1, (0, 2), 0b1011
"""`OWN_PIN`: CCxS for a channel's own pin (TIMx_CCMR1). `FILTERS`: values of ICxF, the input filter, that the model
accepts without filtering. `BOTH_EDGES`: CCxNP, CCxP and CCxE for both edges (TIMx_CCER)."""
INPUTS = {("B", 6): ("TIM4", 1), ("B", 7): ("TIM4", 2), ("B", 8): ("TIM4", 3)}
"""Timer and channel by pin, as alternate function 2 (data sheets, table of alternate functions)."""
FUNCTION = 2
COMPARE_PULSE = 0b011 << 4
"""MMS of TIMx_CR2: the event of channel 1 is the trigger output, even if its flag is already set."""


class Timer(Peripheral):
    REGISTERS = {
        CR1: ("CR1", 0, 1),
        CR2: ("CR2", 0, 0x70),
        DIER: ("DIER", 0, 0x1E1F),
        SR: ("SR", 0, 0x1E1F),
        EGR: ("EGR", 0, 0x1F),
        CCMR1: ("CCMR1", 0, 0x7373),
        CCMR2: ("CCMR2", 0, 0x7373),
        CCER: ("CCER", 0, 0xBBBB),
        CNT: ("CNT", 0, 0xFFFF_FFFF),
        PSC: ("PSC", 0, 0xFFFF),
        ARR: ("ARR", 0xFFFF_FFFF, 0xFFFF_FFFF),
        CCR1: ("CCR1", 0, 0xFFFF_FFFF),
        CCR2: ("CCR2", 0, 0xFFFF_FFFF),
        CCR3: ("CCR3", 0, 0xFFFF_FFFF),
        CCR4: ("CCR4", 0, 0xFFFF_FFFF),
    }

    def __init__(self, name, board, bit, irq, wide, base=0):
        self.CLOCK = (0x40, bit)
        self.base = base
        self.irq = irq
        self.top = 0xFFFF_FFFF if wide else 0xFFFF
        self.slaves = []
        """Timers that this timer may trigger."""
        super().__init__(name, board)

    def reset(self):
        super().reset()
        self.values[ARR] = self.top
        self.since = 0
        """Reference for the count: at core cycle `since` the counter had the value `began`."""
        self.began = 0
        self.prescaler = 0
        self.cycles = 1
        """Core cycles per count."""
        self.matched = [NEVER] * 5
        """Core cycle of the next event of each flag of SR."""

    @property
    def running(self):
        return self.values[CR1] & 1

    def count(self, now=None):
        """Returns the count at cycle `now` (default: the present), even if the counter has wrapped."""
        if not self.running:
            return self.began
        counts = ((self.board.now if now is None else now) - self.since) // self.cycles
        return (self.began + counts) % (self.values[ARR] + 1)

    def _hold(self, value=None):
        """Moves the reference (`since`, `began`) to the present time and keeps the fraction of a count; with `value`,
        also sets the count and drops the fraction."""
        now = self.board.now
        if value is None:
            value = self.count(now)
            self.since = now - (now - self.since) % self.cycles if self.running else now
        else:
            self.since = now
        self.began = value

    BUS = "pclk1"

    def _take_prescaler(self):
        rcc = self.board.rcc
        clock = rcc.timer_clock(getattr(rcc, self.BUS))
        cycles, rest = divmod(rcc.hclk, clock)
        if rest:
            raise Unmodelled(f"{self.name}: its clock {clock} does not divide the core's {rcc.hclk}")
        self.cycles = cycles * (self.prescaler + 1)

    def clock_changed(self):
        if self.running:
            raise Unmodelled(f"{self.name} runs while clocks change")

    def read(self, offset):
        if offset == CNT:
            return self.count()
        if offset == EGR:
            return 0
        if offset in COMPARE and self.captures(COMPARE.index(offset) + 1):
            self.values[SR] &= ~(2 << COMPARE.index(offset))
            self._call()
        return super().read(offset)

    def captures(self, channel):
        """Returns a value other than 0 if a channel is an input (capture), and 0 if it compares."""
        return self.values[CCMR1 if channel <= 2 else CCMR2] >> 8 * (channel - 1 & 1) & 3

    def edge(self, channel):
        """Called when the level of a channel's pin has changed."""
        mode = self.values[CCMR1 if channel <= 2 else CCMR2] >> 8 * (channel - 1 & 1) & 0xFF
        enable = self.values[CCER] >> 4 * (channel - 1) & 0xF
        if not mode & 3 or not enable & 1:
            return
        if mode & 3 != OWN_PIN or mode >> 4 not in FILTERS or enable != BOTH_EDGES:
            raise Unmodelled(f"{self.name}: capture with CCMR {mode:#x}, CCER {enable:#x} in channel {channel}")
        flag, offset = 1 << channel, COMPARE[channel - 1]
        if self.values[SR] & flag:
            self.values[SR] |= 1 << 8 + channel
        self.values[offset] = self.count()
        self.values[SR] |= flag
        if self.values[DIER] >> 8 + channel & 1:
            who = f"{self.name}_CH{channel}"
            if any(dma.request(who, self.base + offset, self.values[offset]) for dma in self.board.dma):
                self.values[SR] &= ~flag
        self._call()

    def write(self, offset, value):
        if offset == SR:
            cleared = self.values[SR] & ~value
            if cleared & 8 and any(dma.under_way.get(f"{self.name}_CH3") for dma in self.board.dma):
                raise Misuse(f"{self.name}: the flag of channel 3 is cleared while its request of DMA is under way")
            self.values[SR] &= value | ~0x1E1F
            self._call()
            return
        if offset == EGR:
            self.row(offset)
            if value & ~0x1F:
                raise Unmodelled(f"{self.name}_EGR {value:#x}")
            if value & 1:
                self.prescaler = self.values[PSC]
                self._take_prescaler()
                self._hold(0)
                self._schedule()
            self.values[SR] |= value
            for channel in range(1, 5):
                if value >> channel & 1:
                    self._compare(channel, self.board.now)
            self._call()
            return
        if value & ~self.top and offset in (CNT, ARR) + COMPARE:
            raise Misuse(f"{self.name} has 16 bits: {value:#x}")
        if offset == DIER:
            self._check_requests(self.values[DIER] & ~value, value & ~self.values[DIER])
        before = self.running
        if offset == CNT:
            self._hold(value)
        elif offset in (CR1, ARR):
            self._hold()
        super().write(offset, value)
        if offset == CR1 and not before and self.running:
            self._take_prescaler()
            self.since = self.board.now
        if offset == DIER:
            if any(value >> 8 + channel & 1 and not self.captures(channel) for channel in (2, 4)):
                raise Unmodelled(f"{self.name}: DMA of a compare event")
            self._call()
        if offset == CR2 and value not in (0, COMPARE_PULSE):
            raise Unmodelled(f"{self.name}_CR2 {value:#x}")
        if offset in (CR1, CNT, ARR, CCMR1, CCMR2):
            self._schedule()
        elif offset in COMPARE:
            self._compare_written(COMPARE.index(offset) + 1, self.board.now)

    def store_by_dma(self, offset, value, at):
        """Writes a compare register for a DMA stream, at cycle `at`, which may be one instruction ago."""
        if offset not in COMPARE:
            raise Unmodelled(f"{self.name}: DMA to the register at {offset:#x}")
        self.values[offset] = value
        self._compare_written(COMPARE.index(offset) + 1, at)

    def _compare_written(self, channel, at):
        self._schedule_flag(channel, at)
        if is_chosen("compare-on-count") and self.running and self.count(at) == self.values[COMPARE[channel - 1]]:
            self.matched[channel] = at
        self._plan()

    def _check_requests(self, off, on):
        """Raises Misuse if DMA requests of compare events change at a bad time. `off`, `on`: the bits of DIER that the
        write clears and sets."""
        for channel in range(1, 5):
            if off >> 8 + channel & 1 and any(dma.under_way.get(f"{self.name}_CH{channel}") for dma in self.board.dma):
                raise Misuse(f"{self.name}: a request of DMA is taken back while it is under way")
            # The check leaves out channel 1: a set flag may cause a request there, because the firmware requests the
            # first word right afterwards anyway.
            if channel == 3 and on >> 8 + channel & 1 and self.values[SR] >> channel & 1 and not self.captures(channel):
                raise Misuse(f"{self.name}: requests of channel 3 are switched on while its flag is set")

    def _compare(self, channel, at):
        """Raises the event of a channel: its DMA request and, for channel 1, the trigger of other timers."""
        if self.captures(channel):
            return
        if self.values[DIER] >> 8 + channel & 1:
            for dma in self.board.dma:
                dma.ask(f"{self.name}_CH{channel}", at)
        if channel == 1 and self.values[CR2] == COMPARE_PULSE:
            for slave in self.slaves:
                slave.trigger(at)

    def _call(self):
        self.board.nvic.level(self.irq, bool(self.values[SR] & self.values[DIER] & 0x1F))

    def _schedule_flag(self, flag, now):
        """Schedules the next event of a flag: the first time after `now` at which the counter arrives at the value that
        sets the flag."""
        if not self.running:
            self.matched[flag] = NEVER
            return
        if flag and self.captures(flag):
            self.matched[flag] = NEVER
            return
        goal = 0 if flag == 0 else self.values[COMPARE[flag - 1]]
        period = self.values[ARR] + 1
        if goal >= period:
            self.matched[flag] = NEVER
            return
        counts = (now - self.since) // self.cycles
        missing = (goal - self.began - counts) % period or period
        self.matched[flag] = self.since + (counts + missing) * self.cycles

    def _schedule(self):
        for flag in range(5):
            self._schedule_flag(flag, self.board.now)
        self._plan()

    def _plan(self):
        # Every event is scheduled, even if it does not interrupt.
        self.plan(min(self.matched))

    def advance(self, now):
        for flag, at in enumerate(self.matched):
            if at <= now:
                self.values[SR] |= 1 << flag
                self._schedule_flag(flag, at)
                if flag:
                    self._compare(flag, at)
        self._call()
        self._plan()

    def until_tick(self):
        """Returns the core cycles until the counter reaches CCR1. None if reaching it has no effect, or if the counter
        passed it long ago."""
        counts = (self.values[CCR1] - self.count()) & 0xFFFF_FFFF
        return counts * self.cycles if self.values[DIER] & (2 | 1 << 9) and counts < 1 << 20 else None

    def frequency(self):
        """Returns the number of overflows per second."""
        return self.board.rcc.hclk / (self.cycles * (self.values[ARR] + 1))

    def duty(self, channel):
        """Returns the share of time for which a PWM output is high, 0 to 1; None if the channel is not a PWM output."""
        mode = self.values[CCMR1 if channel <= 2 else CCMR2] >> (8 * ((channel - 1) & 1)) + 4 & 7
        if mode == FORCED_LOW:
            return 0.0
        if mode != 6 or not self.values[CCER] >> 4 * (channel - 1) & 1 or not self.running:
            return None
        return min(1.0, self.values[COMPARE[channel - 1]] / (self.values[ARR] + 1))


class AdvancedPwm(Timer):
    """TIM1 as a PWM: its outputs also need MOE (TIMx_BDTR), without which they are high-impedance (OSSI, OSSR = 0)."""

    REGISTERS = Timer.REGISTERS | {BDTR: ("BDTR", 0, MOE)}
    BUS = "pclk2"

    def __init__(self, name, board):
        super().__init__(name, board, 0, None, False, 0x4001_0000)
        self.CLOCK = (0x44, 0)

    def _call(self):
        if self.values[DIER]:
            raise Unmodelled(f"{self.name}: interrupts and DMA requests of an advanced timer")

    def store_by_dma(self, offset, value, at):
        raise Misuse(f"{self.name}: DMA1 does not reach APB2")

    def duty(self, channel):
        return super().duty(channel) if self.values[BDTR] & MOE else None
