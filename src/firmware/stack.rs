//! `Watch` looks from time to time how deep the stack has been, and logs it when the depth has grown. It is `looked` at
//! by `clock_ticks` while the step task is `at_rest` and nothing is `heard` (it is not `busy`), and `defmt::info!` writes `used` of `size`.

use crate::boards::{self, stack};
use crate::shared::{SERIAL, STEP};
use core::sync::atomic::Ordering;

/// How long nothing has moved and nothing has come when it looks.
const QUIET_TICKS: u32 = boards::CLOCK_TICKS_PER_US * 5_000;
/// Between two looks.
const REST_TICKS: u32 = boards::CLOCK_TICKS_PER_US * 1_000_000;

/// Logs each new depth, but not more often than once in a second: looking takes a hundred microseconds.
pub struct Watch {
    looked: u32,
    /// When something was going on, and what had been heard then.
    busy: u32,
    heard: u32,
    most: u32,
}

impl Watch {
    /// Nothing seen yet.
    pub fn start() -> Watch {
        let now = boards::clock_ticks();
        Watch { looked: now, busy: now, heard: 0, most: 0 }
    }

    /// To be called when there is nothing else to do.
    pub fn look(&mut self) {
        // A line of the log masks interrupts for as long as it takes, longer than a byte at 1 Mbaud: not while motors turn, and not
        // while a host sends.
        let (now, heard) = (boards::clock_ticks(), SERIAL.heard.load(Ordering::Relaxed));
        if heard != self.heard || !STEP.at_rest.load(Ordering::Relaxed) {
            (self.busy, self.heard) = (now, heard);
        }
        if now.wrapping_sub(self.busy) < QUIET_TICKS || now.wrapping_sub(self.looked) < REST_TICKS {
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
