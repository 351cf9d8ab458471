"""Independent watchdog (RM0390 chapter 20, RM0383 chapter 15).

Modelled: keys, prescaler, reload, counting with the 32 kHz of the LSI (17 to 47 kHz on real parts), reset. SR is always
0, because prescaler and reload take effect at once; on real parts this takes up to five LSI cycles.
Not modelled: start by option byte, freezing by a debugger.
"""

from .peripheral import NEVER, Misuse, Peripheral
from .rcc import LSI_HZ, WATCHDOG_RESET

KR, PR, RLR, SR = 0x00, 0x04, 0x08, 0x0C


class Iwdg(Peripheral):
    REGISTERS = {
        KR: ("KR", 0, 0xFFFF),
        PR: ("PR", 0, 7),
        RLR: ("RLR", 0xFFF, 0xFFF),
        SR: ("SR", 0, 0),
    }

    def reset(self):
        super().reset()
        self.started = False
        self.open = False
        self.feeds = 0

    def write(self, offset, value):
        if offset == KR:
            # Keys of IWDG_KR: 0x5555 opens PR and RLR, 0xCCCC starts the watchdog, 0xAAAA reloads the counter.
            self.open = value == 0x5555
            if value in (0xCCCC, 0xAAAA):
                self.started |= value == 0xCCCC
                self.feeds += value == 0xAAAA
                self._reload()
            elif value != 0x5555:
                raise Misuse(f"IWDG_KR {value:#x} is no key")
            return
        if not self.open:
            raise Misuse("IWDG_PR or RLR is written without its key")
        super().write(offset, value)

    def seconds(self):
        """Returns the timeout: seconds from a feed to the reset."""
        return (self.values[RLR] + 1) * (4 << min(self.values[PR], 6)) / LSI_HZ

    def _reload(self):
        self.plan(self.board.now + self.board.cycles(self.seconds()) if self.started else NEVER)

    def clock_changed(self):
        if self.started:
            raise Misuse("the watchdog is started before the clocks are set: its model cannot follow")

    def slowed_down(self, ratio):
        """Adapts the timeout to a slower core clock; `ratio` is new clock / old clock."""
        if self.started:
            now = self.board.now
            self.plan(now + round((self.due - now) * ratio))

    def advance(self, now):
        self.plan(NEVER)
        self.board.request_reset(WATCHDOG_RESET, "independent watchdog")
