//! The STM32F4 board that an image is built for: the numbers of its row, and the pins and `setup` of its wiring. `lib.rs` says which
//! row and which wiring.

use crate::{CHOSEN, wiring};
use oxmill_controller::Profile;

pub use crate::wiring::*;

/// The row of this board.
pub const PROFILE: Profile = crate::profile(&CHOSEN, true);
/// Axes that have pins.
pub const AXES: usize = CHOSEN.axes;
/// Depth of the look-ahead.
pub const BLOCKS: usize = CHOSEN.blocks;
/// Pages of 256 bytes for the recording of what comes in.
pub const RECORDING_PAGES: usize = CHOSEN.recording_pages;
/// More cycles than the longest run of the step task takes.
pub const RUN_CYCLES: u32 = CHOSEN.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = CHOSEN.core_hz;

/// Clocks, pins and timers; outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    wiring::setup(device, CORE_HZ, low_voltage)
}
