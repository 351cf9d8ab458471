//! When the serial task is called for what can wait: at once, but then not again for 800 us. So a host, or noise on a wire, that
//! sends without end leaves time for the control task, which prepares what the step task puts out.
//!
//! Whoever comes in between any two accesses, no note is lost: the worst that two at a moment bring about is a call for nothing.

use core::sync::atomic::{AtomicU8, Ordering::Relaxed};

/// Samples of the inputs between two calls: 800 us.
pub const REST: u8 = 16;

/// A variable that tasks of several priorities read and write, each access at one moment: an atomic, or one in a test which comes in
/// between.
pub trait Word {
    /// Its value.
    fn get(&self) -> u8;
    /// Changes it.
    fn set(&self, value: u8);
}

impl Word for AtomicU8 {
    #[inline(always)]
    fn get(&self) -> u8 {
        self.load(Relaxed)
    }

    #[inline(always)]
    fn set(&self, value: u8) {
        self.store(value, Relaxed);
    }
}

/// When to call.
pub struct Calls<W> {
    /// Samples until it may be called again.
    rests: W,
    /// 1: it is to be called then.
    is_due: W,
}

impl<W: Word> Calls<W> {
    /// Both are 0 at the start.
    pub const fn new(rests: W, is_due: W) -> Self {
        Self { rests, is_due }
    }

    /// There is something that can wait. Gives whether to call now.
    #[inline(always)]
    pub fn note(&self) -> bool {
        let calls = self.rests.get() == 0;
        if calls {
            self.rests.set(REST);
        } else {
            self.is_due.set(1);
        }
        calls
    }

    /// The inputs are sampled. Gives whether what has been noted before is to be noted now.
    #[inline(always)]
    pub fn sample(&self) -> bool {
        let rests = self.rests.get();
        if rests > 0 {
            self.rests.set(rests - 1);
        }
        // Also where nothing rests: a task may have noted it after this has counted the last one down.
        let is_due = rests <= 1 && self.is_due.get() != 0;
        if is_due {
            // In this order: what comes between the two is heard by the call that follows.
            self.is_due.set(0);
        }
        is_due
    }
}

#[cfg(feature = "board")]
static CALLS: Calls<AtomicU8> = Calls::new(AtomicU8::new(0), AtomicU8::new(0));

/// Calls the serial task at once, or when it may be called again.
#[cfg(feature = "board")]
pub fn call_soon() {
    if CALLS.note() {
        crate::call_serial();
    }
}

/// To be called with each sample of the inputs: calls the serial task if it is due.
#[cfg(feature = "board")]
#[inline(always)]
pub fn call_if_due() {
    if CALLS.sample() {
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
