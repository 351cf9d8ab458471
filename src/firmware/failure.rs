//! The end after a failure of any kind: `fail` brings outputs into the safe state first, keeps the `CrashKind` and the
//! reason in RAM that outlives the reset, logs it, then resets; `low_voltage` is one cause. `FAILING` prevents a second
//! failure within the first. The host is told of it at the next welcome line, by a machine that is locked.

use crate::{boards, last_words};
use core::sync::atomic::{AtomicBool, Ordering};
use oxmill_controller::messages::CrashKind;

/// The program is being ended.
static FAILING: AtomicBool = AtomicBool::new(false);

/// Ends the program. A failure while it does so (in the log, whose frames do not nest; in a `Display` of the reason) leaves
/// the first record as it is and resets at once.
pub fn fail(kind: CrashKind, why: core::fmt::Arguments<'_>) -> ! {
    cortex_m::interrupt::disable();
    boards::safe_state();
    if FAILING.swap(true, Ordering::Relaxed) {
        cortex_m::peripheral::SCB::sys_reset()
    }
    last_words::keep(kind, why);
    boards::restart(why)
}

/// The supply sinks: called by boards that can tell.
pub fn low_voltage() -> ! {
    fail(CrashKind::Voltage, format_args!("supply below 2.9 V"))
}
