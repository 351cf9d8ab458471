//! The end after a bug: outputs into the safe state first, then the reason into the log, then nothing more.

use crate::boards;
use core::panic::PanicInfo;
use cortex_m_rt::{ExceptionFrame, exception};

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    boards::safe_state();
    boards::halt(format_args!("{info}"))
}

/// Bus, usage and memory faults, a stack that has run out of RAM among them.
// SAFETY: unsafe because a fault may strike in the middle of anything; safe because nothing returns from here, interrupts
// are off, and the safe state is made of plain stores to registers.
#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    cortex_m::interrupt::disable();
    boards::safe_state();
    boards::halt(format_args!("hard fault at {:#010x}, called from {:#010x}", frame.pc(), frame.lr()))
}
