//! Common parts of the suites on the target: a log, an exit after a failure, and a controller and a step generator in a
//! loop.
//!
//! The log goes through semihosting in QEMU and through RTT on a board. A failed test ends the run with status 101, a
//! fault with 102.
#![cfg_attr(target_os = "none", no_std)]
#![cfg(target_os = "none")]

#[cfg(feature = "board")]
use cortex_m as _;
#[cfg(not(feature = "qemu_mps2"))]
use defmt_rtt as _;
#[cfg(feature = "qemu_mps2")]
use defmt_semihosting as _;
#[cfg(feature = "board")]
use oxmill_boards as _;

#[cfg(feature = "stm32f4")]
pub mod capture;
pub mod rig;

#[cfg(feature = "board")]
use oxmill_boards::SettingsFlash;

/// Returns access to the board's settings sectors. Only one owner may exist at a time.
#[cfg(feature = "board")]
pub fn settings_flash() -> SettingsFlash {
    #[cfg(feature = "qemu_mps2")]
    return SettingsFlash::new();
    #[cfg(not(feature = "qemu_mps2"))]
    {
        // SAFETY: unsafe because the peripherals are taken without asking their owner; safe because the tests use the
        // flash interface only through the value returned here, and only one such value exists at a time.
        let device = unsafe { oxmill_boards::pac::Peripherals::steal() };
        SettingsFlash::new(device.FLASH, || {}, || {})
    }
}

use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    defmt::error!("{}", defmt::Display2Format(info));
    semihosting::process::exit(101)
}

#[defmt::panic_handler]
fn defmt_panic() -> ! {
    semihosting::process::exit(101)
}

// SAFETY: unsafe because a fault may strike anywhere; safe because it only reports and ends the run.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    defmt::error!("hard fault at {=u32:#010x}", frame.pc());
    semihosting::process::exit(102)
}
