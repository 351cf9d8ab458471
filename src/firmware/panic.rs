//! The end after a bug: outputs into the safe state first, then the reason into the log, then nothing more.

use crate::boards;
use core::panic::PanicInfo;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    cortex_m::interrupt::disable();
    boards::safe_state();
    boards::halt(format_args!("{info}"))
}

/// Bus, usage and memory faults, a stack that has run out of RAM among them.
///
/// A fault of the stack leaves the stack pointer below RAM, where any push or load would be a second fault and lock the
/// processor up with its outputs on. So the stack begins anew before anything else; what was on it is not needed any more.
// SAFETY: unsafe because it replaces the handler of cortex-m-rt by its name and moves the stack pointer; safe because
// nothing returns from here, and the body it branches to takes the old pointer as a number.
#[unsafe(no_mangle)]
#[unsafe(naked)]
pub unsafe extern "C" fn HardFault() -> ! {
    core::arch::naked_asm!(
        "mrs r0, msp",
        "movw r1, #:lower16:_stack_start",
        "movt r1, #:upper16:_stack_start",
        "msr msp, r1",
        "b {body}",
        body = sym hard_fault,
    )
}

/// `frame` is where the processor has put the registers, if it could.
extern "C" fn hard_fault(frame: usize) -> ! {
    unsafe extern "C" {
        static _stack_end: u32;
        static _stack_start: u32;
    }
    cortex_m::interrupt::disable();
    boards::safe_state();
    let stack = &raw const _stack_end as usize..&raw const _stack_start as usize;
    // The program counter is the seventh of the eight words of an exception frame (ARMv7-M, B1.5.6).
    let counter = frame + 6 * size_of::<u32>();
    if frame.is_multiple_of(4) && stack.contains(&frame) && stack.contains(&counter) {
        // SAFETY: unsafe because the address comes from a fault; safe because it is aligned and lies within the stack.
        let counter = unsafe { (counter as *const u32).read_volatile() };
        boards::halt(format_args!("hard fault at {counter:#010x}"))
    }
    boards::halt(format_args!("hard fault: the stack has overflowed"))
}
