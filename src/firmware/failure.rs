//! Ends the program after a failure of any kind. `fail` brings the outputs into the safe state, stores kind and reason
//! in RAM that survives a reset, logs the reason, and resets the board. The next welcome line reports the failure, and
//! the machine stays locked.

use crate::{boards, last_words};
use core::sync::atomic::{AtomicBool, Ordering};
use oxmill_controller::messages::CrashKind;

/// `true` while `fail` is ending the program. A second failure must not run it again.
static FAILING: AtomicBool = AtomicBool::new(false);

/// Ends the program. A second failure is possible while the reason is formatted or logged (the debug log allows no
/// nested log frames). The board then resets at once, and the record of the first failure stays.
pub fn fail(kind: CrashKind, why: core::fmt::Arguments<'_>) -> ! {
    cortex_m::interrupt::disable();
    boards::safe_state();
    if FAILING.swap(true, Ordering::Relaxed) {
        cortex_m::peripheral::SCB::sys_reset()
    }
    last_words::keep(kind, why);
    boards::restart(why)
}

/// Ends the program because the supply voltage drops. Called by boards that can detect this.
pub fn low_voltage() -> ! {
    fail(CrashKind::Voltage, format_args!("supply below 2.9 V"))
}
