//! The handlers that exist once per program. `before_start` enters the chip's boot loader on request. The others report
//! a failure and end the program ([`oxmill_firmware::failure`]): `panic` reports the location, `HardFault` the program
//! counter or a stack overflow, `NonMaskableInt` a failed clock.

use core::panic::PanicInfo;
use oxmill_controller::messages::CrashKind;
use oxmill_firmware::boards;
use oxmill_firmware::failure::fail;

/// Runs first after a reset, before RAM is initialised. If `$DFU` has requested the chip's boot loader, that loader
/// must find the chip as it is after a reset.
///
/// Rust code may run here, because it uses only registers, and a number in RAM that is never initialised.
extern "C" fn before_start() {
    boards::enter_loader_if_requested();
}

// The start-up code of cortex-m-rt calls `__pre_init` with an empty stack, and initialises RAM after the return.
core::arch::global_asm!(
    ".section .text.__pre_init, \"ax\"",
    ".global __pre_init",
    ".type __pre_init, %function",
    ".p2align 1",
    ".thumb_func",
    "__pre_init: b {before_start}",
    ".size __pre_init, . - __pre_init",
    ".previous",
    before_start = sym before_start,
);

#[panic_handler]
fn panic(info: &PanicInfo<'_>) -> ! {
    match info.location() {
        // The file name without its path is enough, and leaves room for the message.
        Some(place) => {
            let file = place.file().rsplit('/').next().unwrap_or_default();
            fail(CrashKind::Panic, format_args!("{file}:{}: {}", place.line(), info.message()))
        }
        None => fail(CrashKind::Panic, format_args!("{}", info.message())),
    }
}

/// Handles a failure of the board's clock: the processor continues with a slower internal clock, so all rates are
/// wrong. On a board that does not watch its clock, only the watchdog raises this interrupt, before it resets the
/// board.
// unsafe because it replaces the handler of cortex-m-rt by its name; safe because it has the signature of an exception
// handler that does not return.
#[unsafe(no_mangle)]
extern "C" fn NonMaskableInt() -> ! {
    if boards::WATCHES_CLOCK {
        fail(CrashKind::Clock, format_args!("no external clock"));
    }
    loop {
        // `spin_loop` would leave QEMU's fast path, and the seconds until the reset would take minutes.
        cortex_m::asm::nop();
    }
}

/// Handles bus, usage and memory faults, including a stack that has run out of RAM.
///
/// After a stack overflow the stack pointer is below RAM. Any push or load would then be a second fault, which locks up
/// the processor with its outputs on. So the handler first sets the stack pointer to the top of the stack, whose
/// contents are not needed any more.
// SAFETY: unsafe because it replaces the handler of cortex-m-rt by its name and moves the stack pointer; safe because
// it does not return, and the function that it branches to takes the old pointer as a number.
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

/// Reports the fault. `frame`: the stack pointer at the fault, where the processor has stored the registers if it
/// could.
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
