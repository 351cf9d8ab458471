//! ST Nucleo-64 with STM32F401RE and an Arduino CNC shield v3, core at 84 MHz. Only this chip's numbers and clocks are
//! here: `PROFILE`, `AXES`, `BLOCKS`, `RECORDING_PAGES`, `RUN_CYCLES`, `CORE_HZ`; `setup` and the pins are in
//! `boards/nucleo64.rs`. Compare with the user manual (UM1724) and with the print on your shield before you switch the
//! motors' supply on.
//!
#![doc = include_str!("../nucleo64.md")]
//!
//! The clock comes from the ST-LINK (MCO, 8 MHz): bypass mode. 84 MHz core and step clock, the most of this part. In reset all pins float: spindle,
//! laser and coolant need pull-down resistors, driver enable a pull-up.

use crate::{nucleo64, profiles};
use oxmill_controller::Profile;

pub use crate::nucleo64::*;

/// The row of this board.
pub const PROFILE: Profile = crate::profile(&profiles::NUCLEO_F401RE, true);
/// Axes that have pins.
pub const AXES: usize = profiles::NUCLEO_F401RE.axes;
/// Depth of the look-ahead.
pub const BLOCKS: usize = profiles::NUCLEO_F401RE.blocks;
/// Pages of 256 bytes for the recording of what comes in.
pub const RECORDING_PAGES: usize = profiles::NUCLEO_F401RE.recording_pages;
/// More cycles than the longest run of the step task takes.
pub const RUN_CYCLES: u32 = profiles::NUCLEO_F401RE.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = profiles::NUCLEO_F401RE.core_hz;

/// Clocks, pins and timers; outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    nucleo64::setup(device, CORE_HZ, low_voltage)
}
