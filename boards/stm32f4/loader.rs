//! Restarts the chip on request of a host: into the program (`$REBOOT`), or into the boot loader in the chip's ROM
//! (`$DFU`). So a host can load new firmware over USB, and nobody has to press the BOOT0 button.
//!
//! ```text
//!  $DFU ─▶ reboot: outputs safe, request in RAM ─▶ reset ─▶ enter_loader_if_requested ─▶ boot loader in ROM
//!                                                              └─ no request ─▶ this program
//! ```
//! The jump into the boot loader comes before anything else has run. So the boot loader finds the chip as after a reset
//! with BOOT0 pressed.

use super::safe_state;
use core::mem::MaybeUninit;
use core::ptr::addr_of_mut;
use stm32f4xx_hal::pac;

/// `true` if a host can reach the boot loader over the cable of the board, as with USB. On a Nucleo it cannot: the
/// cable leads to the ST-LINK, which is connected to USART2, and the boot loader does not serve USART2 (AN2606).
pub const HAS_LOADER: bool = cfg!(feature = "usb");

/// Start of the boot loader in ROM, with its vector table (reference manuals, "Boot configuration").
const LOADER: *const u32 = 0x1FFF_0000 as *const u32;
/// Value of MEM_MODE (SYSCFG_MEMRMP) that puts the system memory, which is the ROM, at address 0. The boot loader
/// relies on finding its vectors there.
const SYSTEM_MEMORY: u8 = 1;

/// Value of `REQUEST` that requests the boot loader. `REQUEST` keeps its value in a reset, because the start-up code
/// does not initialise it.
const REQUESTED: u32 = u32::from_le_bytes(*b"$DFU");

#[unsafe(link_section = ".uninit.LOADER_REQUEST")]
// unsafe because the linker takes the section on trust; safe because the name is the one of cortex-m-rt for RAM that is
// not initialised, and any bits are a number.
static mut REQUEST: MaybeUninit<u32> = MaybeUninit::uninit();

/// Sets the outputs to their safe levels and restarts the chip. With `into_loader`, the chip starts in its boot loader
/// if a host can reach that ([`HAS_LOADER`]). In all other cases the chip starts in the program.
pub fn reboot(into_loader: bool) -> ! {
    cortex_m::interrupt::disable();
    safe_state();
    if HAS_LOADER && into_loader {
        // SAFETY: unsafe because a static is written; safe because interrupts are off and only the reset follows.
        unsafe { addr_of_mut!(REQUEST).cast::<u32>().write_volatile(REQUESTED) }
    }
    cortex_m::peripheral::SCB::sys_reset()
}

/// Enters the boot loader if [`reboot`] has requested it. Call before anything else, even before RAM is initialised:
/// the boot loader expects the chip as it is after a reset.
#[inline]
pub fn enter_loader_if_requested() {
    if !HAS_LOADER {
        return;
    }
    let request = addr_of_mut!(REQUEST).cast::<u32>();
    // SAFETY: unsafe because registers are used without their owners and memory is read that may never have been
    // written; safe because nothing else runs yet, and any bits are a number.
    unsafe {
        let rcc = &*pac::RCC::ptr();
        // The request counts only after a reset by software: after any other, the RAM may hold this number by accident.
        let requested = rcc.csr().read().sftrstf().bit_is_set() && request.read_volatile() == REQUESTED;
        request.write_volatile(0);
        if requested {
            rcc.apb2enr().modify(|_, w| w.syscfgen().set_bit());
            // An enabled clock takes some cycles to arrive; reading back waits for them.
            let _ = rcc.apb2enr().read();
            (*pac::SYSCFG::ptr()).memrmp().write(|w| w.mem_mode().bits(SYSTEM_MEMORY));
            cortex_m::asm::bootload(LOADER)
        }
    }
}
