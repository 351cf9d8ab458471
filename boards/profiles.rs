//! Numeric profiles of all boards, shared by the firmware and the simulator of a board. Each `Board` is a table of
//! numbers; the boards with hardware start from the defaults of `HARDWARE`.
//!
//! Pins and clock set-up are in the boards' modules, memory layouts are in `boards/images`.

/// Maximum number of axes of a board; the simulator supports this many.
pub const AXES: usize = 4;
/// Number of axes of most boards with hardware. Each axis costs time at each tick and memory in each block, so a fourth
/// axis would slow down machines that have three.
const AXES_OF_BOARDS: usize = 3;
/// Moves that the look-ahead holds.
pub const BLOCKS: usize = 512;

/// The numbers of one board and of its image.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Board name on the command line and in `cargo fw`.
    pub name: &'static str,
    /// Ticks of the step timer in a second.
    pub step_clock_hz: u32,
    /// Clock of the processor, Hz.
    pub core_hz: u32,
    /// Maximum duration of a run of the step task, in CPU cycles, if the run generates events. A run that stops the
    /// output takes longer. The value is at least 1.1 times the number of instructions that `cargo xtask count`
    /// counts, because the flash has wait states.
    pub run_cycles: u32,
    /// Number of axes, 3 or 4. A board whose pin table has fewer motors has fewer axes.
    pub axes: usize,
    /// Moves that the look-ahead holds.
    pub blocks: usize,
    /// Capacity of the memory for subroutines, loops and macros, bytes; 0 if the image has none.
    pub held_bytes: usize,
    /// Maximum step rate of one axis, steps/s. The step task can follow this rate.
    pub safe_step_hz: u32,
    /// Shortest step pulse that `$0` can set, tenths of a microsecond.
    pub least_pulse_tenths: u16,
    /// Capacity, in bytes, for received lines that the controller has not read yet.
    pub received_bytes: usize,
    /// Maximum rate of the UART (`$931`), baud.
    pub most_baud: u32,
    /// Number of outputs for programs (M62 to M65), and number of inputs for programs (M66).
    pub program_pins: [u8; 2],
    /// Whether there is an input for a spindle's at-speed signal (`$915`).
    pub has_at_speed: bool,
    /// Pages of 256 bytes of RAM for the recording of inputs and received bytes; 0 = no recording.
    pub recording_pages: usize,
    /// Number of the firmware's image. A pin table is made for one image. Several boards may share an image.
    pub image: u8,
    /// Whether there is USB; the UART to the host is then `USART1`, otherwise `USART2`.
    pub has_usb: bool,
    /// Number of GPIO ports, from A on, that may have pins in use.
    pub ports: usize,
    /// Maximum number of ports that have step pins, and perhaps direction pins.
    pub step_ports: usize,
    /// Maximum number of further ports that have direction pins, but no step pins.
    pub direction_ports: usize,
    /// Whether TIM8 makes the step pulses in place of TIM1. Then a channel of TIM1, such as the one on A8, can make the
    /// spindle's PWM.
    pub tim8_makes_pulses: bool,
    /// `true` if programs can use expressions, parameters, O words, rotations, scaling, splines and rounded corners. A
    /// small flash has no space for these.
    pub has_all_words: bool,
}

/// No hardware: the simulator's own board. Its step task takes no time, so the processor does not limit the step rate.
pub const DESK: Board = Board {
    name: "desk",
    step_clock_hz: 100_000_000,
    core_hz: 100_000_000,
    run_cycles: 4_450,
    axes: AXES,
    blocks: BLOCKS,
    held_bytes: 12_288,
    safe_step_hz: 1_000_000,
    least_pulse_tenths: 5,
    received_bytes: 255,
    most_baud: 1_000_000,
    program_pins: [4, 2],
    has_at_speed: true,
    recording_pages: 64,
    image: 0,
    has_usb: false,
    ports: 3,
    step_ports: 2,
    direction_ports: 0,
    tim8_makes_pulses: false,
    has_all_words: true,
};

/// Defaults of the boards with hardware: a board has three axes, and no pins for programs or for a spindle's at-speed
/// signal. Its step pulses take at least 1 us, unless the board was tested with shorter pulses.
const HARDWARE: Board =
    Board { axes: AXES_OF_BOARDS, least_pulse_tenths: 10, program_pins: [0, 0], has_at_speed: false, ..DESK };

/// The Nucleos have spare pins for program outputs and inputs and for the at-speed signal. The outputs for programs
/// are on the outer connectors, in a corner that no shield covers.
const NUCLEO: Board = Board { program_pins: [2, 2], has_at_speed: true, ..HARDWARE };

/// The Black Pills have USB. Their UART interrupt has a lower priority than the step task, so a run of that task
/// delays it. The baud rate is limited for this reason: a byte must take longer to arrive (87 us at 115,200 baud) than
/// the longest run takes.
const BLACKPILL: Board = Board { most_baud: 115_200, has_usb: true, step_ports: 1, ..HARDWARE };

/// WeAct Black Pill, STM32F411CE. The chip runs at 96 MHz instead of 100, because USB needs 48 MHz from the same PLL
/// (RM0383, 6.3.2: PLLQ divides the same oscillator as PLLP). The maximum step rate follows from the shortest pulse (1
/// us) and a pause of 1 us; it was tested in emulation. The queue of events and the processor would allow a higher
/// rate (docs/cost.md, "Step rates").
pub const BLACKPILL_F411: Board = Board {
    name: "blackpill_f411",
    step_clock_hz: 96_000_000,
    core_hz: 96_000_000,
    safe_step_hz: 490_000,
    image: 1,
    ..BLACKPILL
};

/// WeAct Black Pill, STM32F401CC: 84 MHz. It has half the look-ahead, because the chip has only 64 KiB of RAM. The
/// image is built for size, except the step task.
pub const BLACKPILL_F401: Board = Board {
    name: "blackpill_f401",
    step_clock_hz: 84_000_000,
    core_hz: 84_000_000,
    safe_step_hz: 490_000,
    image: 2,
    blocks: 256,
    held_bytes: 0,
    recording_pages: 0,
    has_all_words: false,
    ..BLACKPILL
};

/// ST Nucleo-64 with STM32F446RE: 180 MHz core, step timer on the 90 MHz bus clock. This is fast enough for a fourth
/// axis. The fourth axis makes a run of the step task longer (`run_cycles`), by about 8 cycles for each of its up to
/// 32 events. Besides, a run that starts a block receives one more message.
pub const NUCLEO_F446RE: Board = Board {
    name: "nucleo_f446re",
    step_clock_hz: 90_000_000,
    core_hz: 180_000_000,
    image: 3,
    run_cycles: 5_200,
    axes: AXES,
    safe_step_hz: 1_000_000,
    least_pulse_tenths: 5,
    ..NUCLEO
};

/// ST Nucleo-64 with STM32F411RE: 100 MHz core and step clock.
pub const NUCLEO_F411RE: Board = Board { name: "nucleo_f411re", image: 4, safe_step_hz: 490_000, ..NUCLEO };

/// ST Nucleo-64 with STM32F401RE: 84 MHz core and step clock.
pub const NUCLEO_F401RE: Board = Board {
    name: "nucleo_f401re",
    step_clock_hz: 84_000_000,
    core_hz: 84_000_000,
    safe_step_hz: 490_000,
    image: 5,
    held_bytes: 6_144,
    recording_pages: 6,
    ..NUCLEO
};

/// Control boards with STM32F446 and USB: [`OCTOPUS_F446`] and those derived from it. The core runs at 168 MHz instead
/// of 180, because USB needs 48 MHz from the same PLL. The step timer is on the 84 MHz bus clock. The image is built
/// for size, but its step task for speed. A step task built for size would be too slow at a step rate of 1 MHz: the
/// queue of events would run dry after changes of direction.
pub const CONTROL_F446: Board = Board {
    name: "control_f446",
    step_clock_hz: 84_000_000,
    core_hz: 168_000_000,
    safe_step_hz: 490_000,
    least_pulse_tenths: 10,
    image: 6,
    has_usb: true,
    ports: 7,
    held_bytes: 8_192,
    direction_ports: 2,
    most_baud: 115_200,
    has_at_speed: false,
    program_pins: [0, 0],
    ..NUCLEO_F446RE
};

/// Control boards with STM32F407 and USB: the clocks are those of [`CONTROL_F446`].
pub const CONTROL_F407: Board = Board { name: "control_f407", image: 7, ports: 5, ..CONTROL_F446 };

/// Control boards with STM32F412 and USB: the clocks are those of [`BLACKPILL_F411`]. TIM8 makes the pulses, because
/// these boards have the spindle's PWM on A8.
pub const CONTROL_F412: Board = Board {
    name: "control_f412",
    image: 8,
    ports: 5,
    step_ports: 2,
    tim8_makes_pulses: true,
    held_bytes: 32_768,
    ..BLACKPILL_F411
};

/// BTT Octopus, with the image [`CONTROL_F446`].
pub const OCTOPUS_F446: Board =
    Board { name: "octopus_f446", has_at_speed: true, program_pins: [2, 2], ..CONTROL_F446 };
/// BTT Octopus Pro, with the image [`CONTROL_F446`].
pub const OCTOPUS_PRO_F446: Board = Board { name: "octopus_pro_f446", ..OCTOPUS_F446 };
/// Fysetc Spider, with the image [`CONTROL_F446`].
pub const SPIDER_F446: Board = Board { name: "spider_f446", ..OCTOPUS_F446 };
/// BTT SKR 2, with the image [`CONTROL_F407`].
pub const SKR2_F407: Board = Board { name: "skr2_f407", has_at_speed: true, program_pins: [2, 2], ..CONTROL_F407 };
/// MKS Monster8, with the image [`CONTROL_F407`].
pub const MONSTER8_F407: Board = Board { name: "monster8_f407", ..SKR2_F407 };
/// MKS Robin Nano V3, with the image [`CONTROL_F407`].
pub const ROBIN_NANO_V3: Board = Board { name: "robin_nano_v3", ..SKR2_F407 };
/// JZ-F407VET6, with the image [`CONTROL_F407`].
pub const JZ_F407: Board = Board { name: "jz_f407", ..SKR2_F407 };
/// Sienci SuperLongBoard EXT, with the image [`CONTROL_F412`].
pub const SLB_EXT: Board = Board { name: "slb_ext", program_pins: [2, 2], ..CONTROL_F412 };
/// WeAct Black Pill, STM32F411CE, with the pins of grblHAL.
pub const BLACKPILL_F411_GRBLHAL: Board = Board { name: "blackpill_f411_grblhal", ..BLACKPILL_F411 };

/// QEMU's `mps2-an386`: Cortex-M4F, timers at 25 MHz.
pub const QEMU_MPS2: Board = Board {
    name: "qemu_mps2",
    step_clock_hz: 25_000_000,
    core_hz: 25_000_000,
    safe_step_hz: 100_000,
    held_bytes: 6_144,
    ..HARDWARE
};

/// The images of the firmware for boards with hardware. A pin table contains the number of its image (`image`), so
/// these numbers must never change.
pub const IMAGES: [Board; 8] = [
    BLACKPILL_F411,
    BLACKPILL_F401,
    NUCLEO_F446RE,
    NUCLEO_F411RE,
    NUCLEO_F401RE,
    CONTROL_F446,
    CONTROL_F407,
    CONTROL_F412,
];

/// All boards, with the simulator's own ([`DESK`]). Boards that share an image are listed one by one.
pub const ALL: [Board; 16] = [
    DESK,
    BLACKPILL_F411,
    BLACKPILL_F401,
    NUCLEO_F446RE,
    NUCLEO_F411RE,
    NUCLEO_F401RE,
    QEMU_MPS2,
    OCTOPUS_F446,
    OCTOPUS_PRO_F446,
    SPIDER_F446,
    SKR2_F407,
    MONSTER8_F407,
    ROBIN_NANO_V3,
    JZ_F407,
    SLB_EXT,
    BLACKPILL_F411_GRBLHAL,
];
