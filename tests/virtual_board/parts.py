"""Properties of the parts and boards, taken from data sheets and from the drawings in boards/ and not from the
firmware: the emulation must not take its pins from the code that it checks."""

import re
from dataclasses import dataclass, replace
from pathlib import Path

PROFILES = Path(__file__).resolve().parents[2] / "boards" / "profiles.rs"
MHZ = 1_000_000


@dataclass(frozen=True)
class Part:
    """An STM32F4."""

    name: str
    core_hz: int
    apb1_hz: int
    apb2_hz: int
    wait_states: tuple
    """Maximum core clock for 0, 1, 2, ... wait states at 2.7 to 3.6 V (RM0383, RM0390, RM0368, "Number of wait states
    according to CPU clock")."""
    scale_hz: dict
    """Maximum core clock by VOS (PWR_CR; data sheet, general operating conditions)."""
    over_drive_hz: int
    """Maximum core clock with over-drive; 0 without over-drive (RM0390, "Voltage regulator")."""
    pwr_cr_reset: int
    """Value of PWR_CR after a reset."""
    interrupts: int
    """Number of interrupt vectors."""
    asleep: tuple
    """RCC_AHB1LPENR, AHB2LPENR, APB1LPENR and APB2LPENR after a reset, from the manuals: a set bit means that the
    peripheral's clock runs while the processor sleeps. On the F401 and F411 the clocks of TIM1, GPIOE and GPIOH
    stop."""
    vco_hz: int = 100 * MHZ
    """Minimum frequency of the PLL's oscillator (RCC_PLLCFGR; 192 MHz in RM0368)."""
    flash_kib: int = 512
    ram_kib: int = 128
    flash_start: int = 0x0800_0000
    ram_start: int = 0x2000_0000

    def sector(self, number):
        """Returns address and size of a flash sector: 4 sectors of 16 KiB, one of 64, the rest of 128."""
        sizes = [16] * 4 + [64] + [128] * ((self.flash_kib - 128) // 128)
        return self.flash_start + 1024 * sum(sizes[:number]), 1024 * sizes[number]


STM32F411 = Part(
    "STM32F411CE", 100 * MHZ, 50 * MHZ, 100 * MHZ,
    wait_states=(30 * MHZ, 64 * MHZ, 90 * MHZ, 100 * MHZ),
    scale_hz={1: 64 * MHZ, 2: 84 * MHZ, 3: 100 * MHZ}, over_drive_hz=0, pwr_cr_reset=0x8000, interrupts=86,
    asleep=(0x0061_900F, 0x80, 0x10E2_C80F, 0x0007_7930),
)  # fmt: skip
STM32F401 = Part(
    "STM32F401CC", 84 * MHZ, 42 * MHZ, 84 * MHZ,
    wait_states=(30 * MHZ, 60 * MHZ, 84 * MHZ),
    scale_hz={1: 60 * MHZ, 2: 84 * MHZ}, over_drive_hz=0, pwr_cr_reset=0x8000, interrupts=85, vco_hz=192 * MHZ,
    asleep=(0x0061_900F, 0x80, 0x10E2_C80F, 0x0007_7930), flash_kib=256, ram_kib=64,
)  # fmt: skip
STM32F401RE = replace(STM32F401, name="STM32F401RE", flash_kib=512, ram_kib=96)
STM32F446 = Part(
    "STM32F446RE", 180 * MHZ, 45 * MHZ, 90 * MHZ,
    wait_states=tuple(n * 30 * MHZ for n in range(1, 7)),
    scale_hz={1: 120 * MHZ, 2: 144 * MHZ, 3: 168 * MHZ}, over_drive_hz=180 * MHZ, pwr_cr_reset=0xC000, interrupts=97,
    asleep=(0x6067_90FF, 0x81, 0x3FFF_C9FF, 0x00C7_7F33),
)  # fmt: skip


@dataclass(frozen=True)
class Wiring:
    """A board: its crystal, and the function of each pin."""

    name: str
    part: Part
    hse_hz: int
    hse_bypass: bool
    core_hz: int
    step: tuple
    direction: tuple
    limits: tuple
    enable: str
    spindle: str
    spindle_direction: str
    flood: str
    mist: str
    pwm: str
    probe: str
    door: str
    hold: str
    start: str
    reset: str
    driver_fault: str
    second_step: str
    second_direction: str
    second_limit: str
    at_speed: str | None
    usart: str
    program_outputs: tuple = ()
    program_inputs: tuple = ()
    step_irq: int = 50
    serial_irq: int = 17
    """Interrupt that runs the serial task: on a Nucleo that of the sending DMA stream, on a Black Pill that of SPI2."""
    uart_irq: int | None = None
    """The UART's interrupt, if DMA does not serve the UART."""
    usb: bool = False
    """OTG_FS is the first link to the host."""
    left_out: tuple = ()
    """Features that this board's image lacks for want of space; all other boards have them."""

    def promised(self, number):
        """Returns a number of the board's entry in `profiles.rs`, so that the cases test what the firmware promises."""
        text, begin = PROFILES.read_text(), f'name: "{self.name}"'
        while True:
            # A number that an entry lacks comes from the entry named after its two dots.
            row, _, rest = text.split(begin, 1)[1].split("}", 1)[0].partition("..")
            if found := re.search(rf"\b{number}: ([0-9_]+)", row):
                return int(found[1])
            begin = f"const {rest.strip()}: Board"

    @property
    def safe_step_hz(self):
        return self.promised("safe_step_hz")

    @property
    def axes(self):
        """Number of axes: three, or four if the board's entry says `AXES`, as many as the simulator."""
        row = PROFILES.read_text().split(f'name: "{self.name}"', 1)[1].split("};", 1)[0]
        return 4 if "axes: AXES," in row else 3

    @property
    def most_baud(self):
        return self.promised("most_baud")

    @property
    def least_pulse_us(self):
        return self.promised("least_pulse_tenths") / 10

    def greatest_hz(self, pulse_us):
        """Returns slightly less than the maximum step rate for pulses of this length (`StepRates` of the
        controller)."""
        pause = pulse_us - 0.04 if pulse_us < 1 else min(pulse_us, 2.5)
        period = pulse_us + pause + 0.04
        return min(1e6 / period * 0.998, self.safe_step_hz)


BLACKPILL_F411 = Wiring(
    "blackpill_f411", STM32F411, 25 * MHZ, False, 96 * MHZ,
    step=("A1", "A2", "A3"), direction=("A4", "A5", "A6"), limits=("B12", "B13", "B14"),
    enable="B0", spindle="B1", spindle_direction="B10", flood="B8", mist="B9", pwm="A7",
    probe="B15", door="B7", hold="B5", start="B6", reset="B4", driver_fault="B3", second_step="A8", second_direction="A15",
    second_limit="A0", at_speed=None, usart="USART1", serial_irq=36, uart_irq=37, usb=True,
)  # fmt: skip
BLACKPILL_F401 = replace(BLACKPILL_F411, name="blackpill_f401", part=STM32F401, core_hz=84 * MHZ, left_out=("splines", "recording"))
NUCLEO_F446RE = Wiring(
    "nucleo_f446re", STM32F446, 8 * MHZ, True, 180 * MHZ,
    step=("A10", "B3", "B5"), direction=("B4", "B10", "A8"), limits=("C7", "B6", "A6"),
    enable="A9", spindle="C2", spindle_direction="A5", flood="B0", mist="C1", pwm="A7",
    probe="C0", door="C3", hold="A1", start="A4", reset="A0", driver_fault="C10", second_step="B13", second_direction="B14",
    second_limit="B15", at_speed="C11", usart="USART2",
    program_outputs=("C8", "C9"), program_inputs=("C6", "C5"),
)  # fmt: skip
NUCLEO_F411RE = replace(NUCLEO_F446RE, name="nucleo_f411re", part=STM32F411, core_hz=100 * MHZ)
NUCLEO_F401RE = replace(NUCLEO_F446RE, name="nucleo_f401re", part=STM32F401RE, core_hz=84 * MHZ)

BOARDS = {wiring.name: wiring for wiring in (BLACKPILL_F411, BLACKPILL_F401, NUCLEO_F446RE, NUCLEO_F411RE, NUCLEO_F401RE)}
