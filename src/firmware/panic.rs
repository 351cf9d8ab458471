//! The handlers that a program has once: `panic` with the location, `HardFault`, which reads the program counter from
//! the stack `frame`, or finds that the stack overflowed (`StackOverflow`), and `NonMaskableInt`, when the clock has
//! failed. They end in [`oxmill_firmware::failure`].

use core::panic::PanicInfo;
use oxmill_controller::messages::CrashKind;
use oxmill_firmware::boards;
use oxmill_firmware::failure::fail;

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        // The file's name is enough, and leaves room for the message.
        Some(place) => {
            let file = place.file().rsplit('/').next().unwrap_or_default();
            fail(CrashKind::Panic, format_args!("{file}:{}: {}", place.line(), info.message()))
        }
        None => fail(CrashKind::Panic, format_args!("{}", info.message())),
    }
}

/// The clock of the board has failed, and the processor continues by a slower one of its own: no rate is true any more. On a
/// board that does not watch its clock the interrupt is that of the watchdog, which resets next.
// unsafe because it replaces the handler of cortex-m-rt by its name; safe because the signature is the one of an exception that
// does not return.
#[unsafe(no_mangle)]
extern "C" fn NonMaskableInt() -> ! {
    if boards::WATCHES_CLOCK {
        fail(CrashKind::Clock, format_args!("no external clock"));
    }
    loop {
        core::hint::spin_loop();
    }
}

/// Bus, usage and memory faults, a stack that has run out of RAM among them.
///
/// A fault of the stack leaves the stack pointer below RAM, where any push or load would be a second fault and lock the
/// processor up with its outputs on. So the stack pointer is set back first; what was on the stack is not needed any more.
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
    oxmill_boards::safe_state();
    let stack = &raw const _stack_end as usize..&raw const _stack_start as usize;
    // The program counter is the seventh of the eight words of an exception frame (ARMv7-M, B1.5.6).
    let counter = frame + 6 * size_of::<u32>();
    if frame.is_multiple_of(4) && stack.contains(&frame) && stack.contains(&counter) {
        // SAFETY: unsafe because the address comes from a fault; safe because it is aligned and lies within the stack.
        let counter = unsafe { (counter as *const u32).read_volatile() };
        fail(CrashKind::Fault, format_args!("at {counter:#010x}"))
    }
    fail(CrashKind::StackOverflow, format_args!("stack pointer {frame:#010x}"))
}
