//! `Watch` looks from time to time how deep the stack has been, and logs it when the depth has grown. It is `looked` at
//! by `clock_ticks` while the step task is `at_rest`, and `defmt::info!` writes `used` of `size`.

use crate::boards::{self, stack};
use crate::shared::STEP;
use core::sync::atomic::Ordering;

/// Logs each new depth, but not more often than once in a second: looking takes a hundred microseconds.
pub struct Watch {
    looked: u32,
    most: u32,
}

impl Watch {
    /// Nothing seen yet.
    pub fn start() -> Watch {
        Watch { looked: boards::clock_ticks(), most: 0 }
    }

    /// To be called when there is nothing else to do.
    pub fn look(&mut self) {
        // A line of the log masks interrupts for as long as it takes: not while motors turn.
        if !STEP.at_rest.load(Ordering::Relaxed) {
            return;
        }
        let now = boards::clock_ticks();
        if now.wrapping_sub(self.looked) < boards::CLOCK_TICKS_PER_US * 1_000_000 {
            return;
        }
        self.looked = now;
        let used = stack::used();
        if used > self.most {
            self.most = used;
            defmt::info!("stack: {} of {} bytes used", used, stack::size());
        }
    }
}
