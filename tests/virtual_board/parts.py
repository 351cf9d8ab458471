"""Properties of the chips, taken from data sheets, and of the boards. The pins of a board are read from its file in
`boards/tables`; the firmware contains only a table of bytes that a tool makes from this file."""

import re
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

FOLDER = Path(__file__).resolve().parents[2] / "boards"
PROFILES, TABLES = FOLDER / "profiles.rs", FOLDER / "tables"
MHZ = 1_000_000


@dataclass(frozen=True)
class Part:
    """The properties of an STM32F4: clock limits, reset values and memory."""

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
    otg_id: int = 0x2000
    """OTG_FS, CID: newer cores have 0x2000 (RM0390), older ones 0x1200 (RM0383, RM0368) or 0x1100 (RM0090)."""
    has_tim8: bool = False
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
    asleep=(0x0061_900F, 0x80, 0x10E2_C80F, 0x0007_7930), otg_id=0x1200,
)  # fmt: skip
STM32F401 = Part(
    "STM32F401CC", 84 * MHZ, 42 * MHZ, 84 * MHZ,
    wait_states=(30 * MHZ, 60 * MHZ, 84 * MHZ),
    scale_hz={1: 60 * MHZ, 2: 84 * MHZ}, over_drive_hz=0, pwr_cr_reset=0x8000, interrupts=85, vco_hz=192 * MHZ,
    asleep=(0x0061_900F, 0x80, 0x10E2_C80F, 0x0007_7930), otg_id=0x1200, flash_kib=256, ram_kib=64,
)  # fmt: skip
STM32F401RE = replace(STM32F401, name="STM32F401RE", flash_kib=512, ram_kib=96)
STM32F446 = Part(
    "STM32F446RE", 180 * MHZ, 45 * MHZ, 90 * MHZ,
    wait_states=tuple(n * 30 * MHZ for n in range(1, 7)),
    scale_hz={1: 120 * MHZ, 2: 144 * MHZ, 3: 168 * MHZ}, over_drive_hz=180 * MHZ, pwr_cr_reset=0xC000, interrupts=97,
    asleep=(0x6067_90FF, 0x81, 0x3FFF_C9FF, 0x00C7_7F33), has_tim8=True,
)  # fmt: skip
STM32F407 = Part(
    "STM32F407VE", 168 * MHZ, 42 * MHZ, 84 * MHZ,
    wait_states=(*(n * 30 * MHZ for n in range(1, 6)), 168 * MHZ),
    scale_hz={0: 144 * MHZ, 1: 168 * MHZ}, over_drive_hz=0, pwr_cr_reset=0x4000, interrupts=82,
    asleep=(0x7E67_91FF, 0xF1, 0x36FE_C9FF, 0x0007_5F33), otg_id=0x1100, has_tim8=True,
)  # fmt: skip
"""RM0090; its core-coupled RAM is left out, because the firmware does not use it."""
STM32F412 = replace(STM32F411, name="STM32F412VG", otg_id=0x2000, has_tim8=True, interrupts=97, flash_kib=1024, ram_kib=256)
"""RM0402: supply, wait states and clocks as in an F411; USB and timers as in an F446. After a reset fewer clocks run in
sleep on the F411. The model takes these fewer clocks, so the image must enable all that it needs."""


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
    other_enables: tuple = ()
    """Enable inputs of the other drivers, on a board whose drivers have an input each."""
    program_outputs: tuple = ()
    program_inputs: tuple = ()
    motor_power: str | None = None
    """Switch of the motors' supply, on when high."""
    step_irq: int = 50
    serial_irq: int = 17
    """Interrupt that runs the serial task: on a Nucleo that of the sending DMA stream, on a Black Pill that of SPI2."""
    uart_irq: int | None = None
    """The UART's interrupt, if DMA does not serve the UART."""
    usb: bool = False
    """Whether OTG_FS is the first link to the host."""
    starts_in_loader: bool = False
    """Whether the boot loader could make an output high that starts a load; then `$DFU` is refused."""
    left_out: tuple = ()
    """Features that this board's image lacks for want of space; all other boards have them."""

    def entry(self, field):
        """Returns the value of a field in the board's entry in `profiles.rs`, as it stands there."""
        text, begin = PROFILES.read_text(), f'name: "{self.name}"'
        while True:
            # A field that an entry lacks comes from the entry after its `..` (struct update syntax of Rust).
            row, _, rest = text.split(begin, 1)[1].split("}", 1)[0].partition("..")
            if found := re.search(rf"\b{field}: (\w+)", row):
                return found[1]
            begin = f"const {rest.strip()}: Board"

    @property
    def pulse_timer(self):
        """Timer that makes the step pulses, `TIM8` or `TIM1`."""
        return "TIM8" if self.entry("tim8_makes_pulses") == "true" else "TIM1"

    @property
    def pulse_stream(self):
        """Stream of DMA2 that writes the words of the first port (docstring of `boards/stm32f4/chain.rs`)."""
        return 2 if self.pulse_timer == "TIM8" else 1

    @property
    def pwm_timer(self):
        """Timer that makes the spindle's PWM: `TIM1` on pin A8, `TIM3` on all other pins."""
        return "TIM1" if self.pwm == "A8" else "TIM3"

    @property
    def pwm_channel(self):
        """Channel of the timer on the spindle's pin (RM0383 and RM0390 refer to the data sheets, "Alternate function
        mapping")."""
        channels = {"A6": 1, "B4": 1, "C6": 1, "A7": 2, "B5": 2, "C7": 2, "B0": 3, "C8": 3, "B1": 4, "C9": 4, "A8": 1}
        return channels[self.pwm]

    def promised(self, number):
        """Returns a number of the board's entry in `profiles.rs`, so that the cases test what the firmware promises."""
        return int(self.entry(number))

    @property
    def safe_step_hz(self):
        return self.promised("safe_step_hz")

    @property
    def axes(self):
        """Number of axes: 4 if the board's entry says `AXES` (the number of the simulator), otherwise 3."""
        return {"AXES": 4, "AXES_OF_BOARDS": 3}[self.entry("axes")]

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


def on(name, part, hse_hz, core_hz, **others):
    """Returns a board: pins from its file, the rest from here."""
    table = tomllib.loads((TABLES / f"{name}.toml").read_text())
    # A pin is port and number; its label on the board may follow.
    pins = {function: pin.split()[0] for function, pin in table["pins"].items()}
    enables = [pins[f"{nth}enable"] for nth in ("", "second_", "third_", "fourth_") if f"{nth}enable" in pins]
    return Wiring(
        name, part, hse_hz, table["oscillator"].endswith(", external"), core_hz,
        step=tuple(pins[f"step_{axis}"] for axis in "xyz"),
        direction=tuple(pins[f"direction_{axis}"] for axis in "xyz"),
        limits=tuple(pins[f"limit_{axis}"] for axis in "xyz"),
        enable=enables[0], other_enables=tuple(enables[1:]),
        spindle=pins["spindle_on"], spindle_direction=pins["spindle_direction"], pwm=pins["spindle_pwm"],
        flood=pins["flood"], mist=pins["mist"], probe=pins["probe"], door=pins["door"], hold=pins["hold"],
        start=pins["start"], reset=pins["reset"], driver_fault=pins["driver_fault"],
        second_step=pins["step_fourth"], second_direction=pins["direction_fourth"], second_limit=pins["limit_fourth"],
        at_speed=pins.get("at_speed"),
        program_outputs=tuple(pins[name] for name in ("program_output", "second_program_output") if name in pins),
        program_inputs=tuple(pins[name] for name in ("program_input", "second_program_input") if name in pins),
        motor_power=pins.get("motor_power"),
        **others,
    )  # fmt: skip


USB = {"usart": "USART1", "serial_irq": 36, "uart_irq": 37, "usb": True}
NUCLEO = {"usart": "USART2"}

BOARDS = {
    board.name: board
    for board in (
        on("blackpill_f411", STM32F411, 25 * MHZ, 96 * MHZ, **USB),
        on("blackpill_f401", STM32F401, 25 * MHZ, 84 * MHZ, left_out=("splines", "recording"), **USB),
        on("nucleo_f446re", STM32F446, 8 * MHZ, 180 * MHZ, **NUCLEO),
        on("nucleo_f411re", STM32F411, 8 * MHZ, 100 * MHZ, **NUCLEO),
        on("nucleo_f401re", STM32F401RE, 8 * MHZ, 84 * MHZ, **NUCLEO),
        on("octopus_f446", replace(STM32F446, name="STM32F446ZE"), 12 * MHZ, 168 * MHZ, **USB),
        on("octopus_pro_f446", replace(STM32F446, name="STM32F446ZE"), 12 * MHZ, 168 * MHZ, **USB),
        on("spider_f446", replace(STM32F446, name="STM32F446VE"), 12 * MHZ, 168 * MHZ, starts_in_loader=True, **USB),
        on("skr2_f407", STM32F407, 8 * MHZ, 168 * MHZ, starts_in_loader=True, **USB),
        on("monster8_f407", STM32F407, 8 * MHZ, 168 * MHZ, **USB),
        on("robin_nano_v3", STM32F407, 8 * MHZ, 168 * MHZ, **USB),
        on("jz_f407", STM32F407, 25 * MHZ, 168 * MHZ, **USB),
        on("slb_ext", STM32F412, 25 * MHZ, 96 * MHZ, starts_in_loader=True, **USB),
        on("blackpill_f411_grblhal", STM32F411, 25 * MHZ, 96 * MHZ, **USB),
    )
}
