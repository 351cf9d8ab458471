//! WeAct Black Pill V2/V3 with STM32F401CC: 256 KiB of flash, 64 KiB of RAM, core at 84 MHz. Only this chip's numbers
//! are here: `PROFILE`, `AXES`, `BLOCKS`, `RECORDING_PAGES`, `RUN_CYCLES`, `CORE_HZ`; `setup` and the pin table are in
//! `boards/blackpill.rs`.
//!
//! 84 MHz, the most of this part, and 48 MHz for USB from the same PLL (336 MHz by 4 and by 7). The image also runs on an
//! STM32F401CE (512 KiB, 96 KiB), whose further memory it leaves unused. With 256 KiB, built for size, and a look-ahead of
//! half the length; see "Small parts" in docs/cost.md.

use crate::{blackpill, profiles};
use oxmill_controller::Profile;

pub use crate::blackpill::*;

/// The row of this board.
pub const PROFILE: Profile = crate::profile(&profiles::BLACKPILL_F401, true);
/// Axes that have pins.
pub const AXES: usize = profiles::BLACKPILL_F401.axes;
/// Depth of the look-ahead.
pub const BLOCKS: usize = profiles::BLACKPILL_F401.blocks;
/// Pages of 256 bytes for the recording of what comes in.
pub const RECORDING_PAGES: usize = profiles::BLACKPILL_F401.recording_pages;
/// More cycles than the longest run of the step task takes.
pub const RUN_CYCLES: u32 = profiles::BLACKPILL_F401.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = profiles::BLACKPILL_F401.core_hz;

/// Clocks, pins and timers; outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    blackpill::setup(device, CORE_HZ, low_voltage)
}
