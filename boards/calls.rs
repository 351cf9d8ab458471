//! When the serial task is called for what can wait: at once, but then not again for 800 us. So a host, or noise on a wire, that
//! sends without end leaves time for the control task, which prepares what the step task puts out.
//!
//! Names: what cannot wait `is_stop`. `call_soon` calls it or notes that it `IS_DUE`; `call_if_due` counts the samples of the inputs that it `RESTS`.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

/// Samples of the inputs between two calls: 800 us.
const REST: u32 = 16;

/// Samples until it may be called again.
static RESTS: AtomicU32 = AtomicU32::new(0);
/// It is to be called then.
static IS_DUE: AtomicBool = AtomicBool::new(false);

/// Calls the serial task at once, or when it may be called again.
pub fn call_soon() {
    if RESTS.load(Relaxed) == 0 {
        RESTS.store(REST, Relaxed);
        crate::call_serial();
    } else {
        IS_DUE.store(true, Relaxed);
    }
}

/// To be called with each sample of the inputs: calls the serial task if it is due.
#[inline(always)]
pub fn call_if_due() {
    let rests = RESTS.load(Relaxed);
    if rests > 0 {
        RESTS.store(rests - 1, Relaxed);
    }
    // Also where nothing rests: a task may have noted it after this has counted the last one down.
    if rests <= 1 && IS_DUE.load(Relaxed) {
        // In this order: what comes between the two is heard by the call that follows.
        IS_DUE.store(false, Relaxed);
        call_soon();
    }
}

/// The byte that resets.
pub const RESET: u8 = 0x18;

/// Whether a byte stops the machine: hold, reset, stop, door, the end of a jog.
#[inline(always)]
pub fn is_stop(byte: u8) -> bool {
    matches!(byte, b'!' | RESET | 0x19 | 0x84 | 0x85)
}
