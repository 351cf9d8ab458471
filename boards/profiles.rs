//! What the boards are to a program: numbers only, shared by the firmware and by the simulator of a board. Each `Board`
//! (`DESK`, `BLACKPILL_F411`, `NUCLEO_F446RE`, `QEMU_MPS2` ...) is a table of `name`, `axes`, `blocks`, `core_hz`,
//! `step_clock_hz`, `run_cycles`, `safe_step_hz`, `received_bytes`, `recording_pages`, `program_pins` and `has_at_speed`, over the
//! defaults of `HARDWARE`.
//!
//! Pins, clocks and memory belong to each board's own folder.

/// Most axes of a board: the simulator has room for so many.
pub const AXES: usize = 4;
/// Axes of most boards with hardware: what a fourth one costs at each tick and in each block, a machine with three would pay, too.
const AXES_OF_BOARDS: usize = 3;
/// Moves that the look-ahead holds.
pub const BLOCKS: usize = 512;

/// One board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Name on the command line and in `cargo fw`.
    pub name: &'static str,
    /// Ticks of the step timer in a second.
    pub step_clock_hz: u32,
    /// Clock of the processor.
    pub core_hz: u32,
    /// More cycles than the longest run of the step task takes that makes events (a stop takes longer): what `cargo xtask count`
    /// says, times 1.1 for the flash.
    pub run_cycles: u32,
    /// Axes.
    pub axes: usize,
    /// Moves that the look-ahead holds.
    pub blocks: usize,
    /// Greatest step rate of one axis that the step task can follow, steps/s.
    pub safe_step_hz: u32,
    /// Shortest step pulse (`$0`), tenths of a microsecond.
    pub least_pulse_tenths: u16,
    /// Bytes of lines that are received ahead of the controller.
    pub received_bytes: usize,
    /// Greatest rate of the UART (`$931`), baud.
    pub most_baud: u32,
    /// Outputs and inputs for programs (M62 to M66).
    pub program_pins: [u8; 2],
    /// A pin on which a spindle tells that it is up to speed (`$915`).
    pub has_at_speed: bool,
    /// Pages of 256 bytes of RAM for the recording of what comes in; 0 = there is no room for it.
    pub recording_pages: usize,
    /// Expressions, parameters, O words, rotations, scaling, splines and rounded corners: a small flash has no room for them.
    pub has_all_words: bool,
}

/// No hardware: the simulator's own board. Its step task costs nothing, so the rate is bounded by the step clock alone.
pub const DESK: Board = Board {
    name: "desk",
    step_clock_hz: 100_000_000,
    core_hz: 100_000_000,
    run_cycles: 4_450,
    axes: AXES,
    blocks: BLOCKS,
    safe_step_hz: 1_000_000,
    least_pulse_tenths: 5,
    received_bytes: 255,
    most_baud: 1_000_000,
    program_pins: [4, 2],
    has_at_speed: true,
    recording_pages: 64,
    has_all_words: true,
};

/// What is so on most boards with hardware: three axes, no pulse below 1 us unless a board has been tried with it, and no pins left for
/// programs or a spindle that tells its speed.
const HARDWARE: Board =
    Board { axes: AXES_OF_BOARDS, least_pulse_tenths: 10, program_pins: [0, 0], has_at_speed: false, ..DESK };

/// The Nucleos have more pins: those of programs are in a corner of the outer connectors that no shield covers.
const NUCLEO: Board = Board { program_pins: [2, 2], has_at_speed: true, ..HARDWARE };

/// The Black Pills have USB. The interrupt of their UART is below the step task: a byte must take longer to come than the longest
/// run of that task.
const BLACKPILL: Board = Board { most_baud: 115_200, ..HARDWARE };

/// WeAct Black Pill, STM32F411CE. 96 MHz and not 100, because USB needs 48 MHz from the same PLL (RM0383, 6.3.2: PLLQ divides the same
/// oscillator as PLLP). The step rate, emulated,
/// is that of the shortest pulse of 1 us and as long a pause: the events that are ahead and the processor would allow more
/// (docs/cost.md, "Step rates").
pub const BLACKPILL_F411: Board = Board {
    name: "blackpill_f411",
    step_clock_hz: 96_000_000,
    core_hz: 96_000_000,
    safe_step_hz: 490_000,
    ..BLACKPILL
};

/// WeAct Black Pill, STM32F401CC: 84 MHz, and half the look-ahead, for 64 KiB of RAM. Built for size, but for the step task.
pub const BLACKPILL_F401: Board = Board {
    name: "blackpill_f401",
    step_clock_hz: 84_000_000,
    core_hz: 84_000_000,
    safe_step_hz: 490_000,
    blocks: 256,
    recording_pages: 0,
    has_all_words: false,
    ..BLACKPILL
};

/// ST Nucleo-64 with STM32F446RE: 180 MHz core, step timer on the 90 MHz bus clock. Fast enough for a fourth axis, with which a run
/// that makes 32 events takes some 8 cycles more for each, and one that begins a block a message more.
pub const NUCLEO_F446RE: Board = Board {
    name: "nucleo_f446re",
    step_clock_hz: 90_000_000,
    core_hz: 180_000_000,
    run_cycles: 5_200,
    axes: AXES,
    safe_step_hz: 1_000_000,
    least_pulse_tenths: 5,
    ..NUCLEO
};

/// ST Nucleo-64 with STM32F411RE: 100 MHz core and step clock.
pub const NUCLEO_F411RE: Board = Board { name: "nucleo_f411re", safe_step_hz: 490_000, ..NUCLEO };

/// ST Nucleo-64 with STM32F401RE: 84 MHz core and step clock.
pub const NUCLEO_F401RE: Board = Board {
    name: "nucleo_f401re",
    step_clock_hz: 84_000_000,
    core_hz: 84_000_000,
    safe_step_hz: 490_000,
    recording_pages: 6,
    ..NUCLEO
};

/// QEMU's `mps2-an386`: Cortex-M4F, timers at 25 MHz.
pub const QEMU_MPS2: Board =
    Board { name: "qemu_mps2", step_clock_hz: 25_000_000, core_hz: 25_000_000, safe_step_hz: 100_000, ..HARDWARE };

/// All boards.
pub const ALL: [Board; 7] =
    [DESK, BLACKPILL_F411, BLACKPILL_F401, NUCLEO_F446RE, NUCLEO_F411RE, NUCLEO_F401RE, QEMU_MPS2];
