//! WeAct Black Pill V2/V3 with STM32F411CE: 512 KiB of flash, 128 KiB of RAM, core at 96 MHz. This file has only the
//! numbers of this chip; `setup` and the pin table are in `boards/blackpill.rs`.
//!
//! The core runs at 96 MHz instead of the maximum of 100 MHz, because USB needs 48 MHz, and the single PLL makes both
//! clocks by dividing the same oscillator (RM0383, 6.3.2: PLLP and PLLQ).

use crate::{blackpill, profiles};
use oxmill_controller::Profile;

pub use crate::blackpill::*;

/// The profile of this board.
pub const PROFILE: Profile = crate::profile(&profiles::BLACKPILL_F411, true);
/// Axes that have pins.
pub const AXES: usize = profiles::BLACKPILL_F411.axes;
/// Depth of the look-ahead, in blocks.
pub const BLOCKS: usize = profiles::BLACKPILL_F411.blocks;
/// Pages of 256 bytes for the recording of inputs and received bytes.
pub const RECORDING_PAGES: usize = profiles::BLACKPILL_F411.recording_pages;
/// Maximum duration, in CPU cycles, of a run of the step task that generates events.
pub const RUN_CYCLES: u32 = profiles::BLACKPILL_F411.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = profiles::BLACKPILL_F411.core_hz;

/// Sets up clocks, pins and timers; all outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    blackpill::setup(device, CORE_HZ, low_voltage)
}
