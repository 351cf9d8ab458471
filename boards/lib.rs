//! The boards: pins, clocks and registers behind one interface (`contract`). A cargo feature selects the board of an
//! image; the items of that board are re-exported here.
//!
//! Without a board feature (on a host), the crate has only the numeric profiles of all boards ([`profiles`]), for the
//! simulator, and the parts without registers.
#![no_std]

pub mod calls;
pub mod profiles;
// Compiled without a board, too, so that host tests can use it.
pub mod uart_receiver;
#[cfg(any(not(feature = "board"), feature = "usb"))]
pub mod usb_host;

#[cfg(feature = "board")]
pub mod contract;
#[cfg(feature = "board")]
pub mod stack;
#[cfg(feature = "board")]
pub mod stm32f4;

#[cfg(any(feature = "blackpill_f411", feature = "blackpill_f401"))]
mod blackpill;
#[cfg(any(feature = "nucleo_f446re", feature = "nucleo_f411re", feature = "nucleo_f401re"))]
mod nucleo64;

#[cfg(feature = "blackpill_f401")]
mod blackpill_f401;
#[cfg(feature = "blackpill_f411")]
mod blackpill_f411;
#[cfg(feature = "nucleo_f401re")]
mod nucleo_f401re;
#[cfg(feature = "nucleo_f411re")]
mod nucleo_f411re;
#[cfg(feature = "nucleo_f446re")]
mod nucleo_f446re;
#[cfg(feature = "qemu_mps2")]
mod qemu_mps2;

#[cfg(feature = "blackpill_f401")]
pub use blackpill_f401::*;
#[cfg(feature = "blackpill_f411")]
pub use blackpill_f411::*;
#[cfg(feature = "nucleo_f401re")]
pub use nucleo_f401re::*;
#[cfg(feature = "nucleo_f411re")]
pub use nucleo_f411re::*;
#[cfg(feature = "nucleo_f446re")]
pub use nucleo_f446re::*;
#[cfg(feature = "qemu_mps2")]
pub use qemu_mps2::*;

#[cfg(feature = "board")]
pub use contract::{
    COMBINATIONS, Due, Free, Incoming, NoPort, Port, SecondMotor, SlowLevels, StepOutput, Undone, input_bits,
};

#[cfg(all(target_os = "none", not(feature = "board")))]
compile_error!("choose a board: `cargo fw BOARD`, or one of the features of this package");

/// Converts a board's table of numbers to the profile that the controller uses.
#[cfg(feature = "board")]
const fn profile(board: &profiles::Board, has_second_motor: bool) -> oxmill_controller::Profile {
    oxmill_controller::Profile {
        name: board.name,
        step_clock_hz: board.step_clock_hz,
        rates: oxmill_controller::StepRates {
            safe_hz: board.safe_step_hz,
            least_pulse_tenths: board.least_pulse_tenths,
        },
        axes: board.axes,
        has_second_motor,
        has_at_speed: board.has_at_speed,
        program_pins: board.program_pins,
        most_baud: board.most_baud,
        has_store: true,
    }
}
