//! WeAct Black Pill V2/V3 with STM32F401CC: 256 KiB of flash, 64 KiB of RAM, core at 84 MHz. This file has only the
//! numbers of this chip; `setup` and the pin table are in `boards/blackpill.rs`.
//!
//! 84 MHz is the maximum of this part; 48 MHz for USB come from the same PLL (336 MHz divided by 4 and by 7). The image
//! also runs on an STM32F401CE (512 KiB, 96 KiB) and leaves its additional memory unused. To fit into 256 KiB the image
//! is built for size, and the look-ahead is halved for the RAM; see "Small parts" in docs/cost.md.

use crate::{blackpill, profiles};
use oxmill_controller::Profile;

pub use crate::blackpill::*;

/// The profile of this board.
pub const PROFILE: Profile = crate::profile(&profiles::BLACKPILL_F401, true);
/// Axes that have pins.
pub const AXES: usize = profiles::BLACKPILL_F401.axes;
/// Depth of the look-ahead, in blocks.
pub const BLOCKS: usize = profiles::BLACKPILL_F401.blocks;
/// Pages of 256 bytes for the recording of inputs and received bytes.
pub const RECORDING_PAGES: usize = profiles::BLACKPILL_F401.recording_pages;
/// Maximum duration, in CPU cycles, of a run of the step task that generates events.
pub const RUN_CYCLES: u32 = profiles::BLACKPILL_F401.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = profiles::BLACKPILL_F401.core_hz;

/// Sets up clocks, pins and timers; all outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    blackpill::setup(device, CORE_HZ, low_voltage)
}
