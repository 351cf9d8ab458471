//! ST Nucleo-64 with STM32F411RE and an Arduino CNC shield v3, core at 100 MHz. This file has only the numbers of this
//! chip; `setup` and the pins are in `boards/nucleo64.rs`. Compare the pins with the user manual (UM1724) and with the
//! print on your shield before you switch on the motors' supply.
//!
#![doc = include_str!("nucleo64.md")]
//!
//! The clock comes from the ST-LINK (MCO, 8 MHz; bypass mode). Core and step clock run at 100 MHz, the maximum of this
//! part: the board has no USB, which would require 96 MHz. All pins float during reset: spindle, laser and coolant need
//! pull-down resistors, driver enable a pull-up.

use crate::{nucleo64, profiles};
use oxmill_controller::Profile;

pub use crate::nucleo64::*;

/// The profile of this board.
pub const PROFILE: Profile = crate::profile(&profiles::NUCLEO_F411RE, true);
/// Axes that have pins.
pub const AXES: usize = profiles::NUCLEO_F411RE.axes;
/// Depth of the look-ahead, in blocks.
pub const BLOCKS: usize = profiles::NUCLEO_F411RE.blocks;
/// Pages of 256 bytes for the recording of inputs and received bytes.
pub const RECORDING_PAGES: usize = profiles::NUCLEO_F411RE.recording_pages;
/// Maximum duration, in CPU cycles, of a run of the step task that generates events.
pub const RUN_CYCLES: u32 = profiles::NUCLEO_F411RE.run_cycles;
/// Clock of the processor and of SysTick.
pub const CORE_HZ: u32 = profiles::NUCLEO_F411RE.core_hz;

/// Sets up clocks, pins and timers; all outputs are off.
pub fn setup(device: pac::Peripherals, low_voltage: fn() -> !) -> Parts {
    nucleo64::setup(device, CORE_HZ, low_voltage)
}
