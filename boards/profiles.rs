//! What the boards are to a program: numbers only, shared by the firmware and by the simulator that stands in for a board.
//!
//! Pins, clocks and memory belong to each board's own folder.

/// Axes of every board so far.
pub const AXES: usize = 3;
/// Moves that the look-ahead holds.
pub const BLOCKS: usize = 512;

/// One board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Board {
    /// Name on the command line and in `cargo fw`.
    pub name: &'static str,
    /// Ticks of the step timer in a second.
    pub step_clock_hz: u32,
    /// Axes.
    pub axes: usize,
    /// Moves that the look-ahead holds.
    pub blocks: usize,
    /// Greatest step rate of one axis that the step task can follow, steps/s.
    pub safe_step_hz: u32,
    /// Bytes of lines that are received ahead of the controller.
    pub received_bytes: usize,
}

/// No hardware: the simulator's own board. Its step task costs nothing, so the rate is bounded by the step clock alone.
pub const DESK: Board = Board {
    name: "desk",
    step_clock_hz: 100_000_000,
    axes: AXES,
    blocks: BLOCKS,
    safe_step_hz: 1_000_000,
    received_bytes: 255,
};

/// WeAct Black Pill, STM32F411CE. 96 MHz and not 100, because USB needs 48 MHz from the same PLL. The step rate, emulated:
/// `cargo xtask count` gives 97 cycles for a tick, 47 for the end of its pulse and 342 for half a message after it; with 24
/// for each entry and 1.1 for flash wait states they take 614 cycles. The worst tick would allow 223 kHz
/// (docs/how-it-works.md, "What it costs").
pub const BLACKPILL_F411: Board =
    Board { name: "blackpill_f411", step_clock_hz: 96_000_000, safe_step_hz: 156_000, ..DESK };

/// ST Nucleo-64 with STM32F446RE: 180 MHz core, step timer on the 90 MHz bus clock. As above, with 5 cycles more for a
/// second port, it would be 290 kHz; the shortest pulse and the time after it, 3.9 us, do not allow that.
pub const NUCLEO_F446RE: Board =
    Board { name: "nucleo_f446re", step_clock_hz: 90_000_000, safe_step_hz: 256_000, ..DESK };

/// ST Nucleo-64 with STM32F411RE: 100 MHz core and step clock. The step rate as above.
pub const NUCLEO_F411RE: Board =
    Board { name: "nucleo_f411re", step_clock_hz: 100_000_000, safe_step_hz: 161_000, ..DESK };

/// ST Nucleo-64 with STM32F401RE: 84 MHz core and step clock. The step rate as above.
pub const NUCLEO_F401RE: Board =
    Board { name: "nucleo_f401re", step_clock_hz: 84_000_000, safe_step_hz: 135_000, ..DESK };

/// QEMU's `mps2-an386`: Cortex-M4F, timers at 25 MHz.
pub const QEMU_MPS2: Board = Board { name: "qemu_mps2", step_clock_hz: 25_000_000, safe_step_hz: 100_000, ..DESK };

/// All boards.
pub const ALL: [Board; 6] = [DESK, BLACKPILL_F411, NUCLEO_F446RE, NUCLEO_F411RE, NUCLEO_F401RE, QEMU_MPS2];
