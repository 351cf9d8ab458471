//! Logs the maximum use of the stack whenever it has grown. The stack is measured only while the step task is at rest
//! and no host sends.

use crate::boards::{self, stack};
use crate::shared::{SERIAL, STEP};
use core::sync::atomic::Ordering;

/// The stack is measured only after this time without motion and without received bytes.
const QUIET_TICKS: u32 = boards::CLOCK_TICKS_PER_US * 5_000;
/// Minimum time between two measurements.
const REST_TICKS: u32 = boards::CLOCK_TICKS_PER_US * 1_000_000;

/// Logs each new maximum of the stack's use. Measures at most once per second, because a measurement takes a hundred
/// microseconds.
pub struct Watch {
    /// Time of the last measurement, in clock ticks.
    looked: u32,
    /// Time at which a motor or a host was last active, in clock ticks.
    busy: u32,
    /// Value of `activity` in [`SERIAL`] at the time `busy`.
    activity: u32,
    /// Maximum stack depth so far, in bytes.
    most: u32,
}

impl Watch {
    /// Starts with nothing measured.
    pub fn start() -> Watch {
        let now = boards::clock_ticks();
        Watch { looked: now, busy: now, activity: 0, most: 0 }
    }

    /// Measures the use of the stack if motors and hosts have been quiet for `QUIET_TICKS`, and the previous
    /// measurement was at least `REST_TICKS` ago. Call when there is nothing else to do.
    pub fn look(&mut self) {
        // While motors turn or a host sends, write no log line: it masks interrupts for longer than a byte takes at 1
        // Mbaud.
        let (now, activity) = (boards::clock_ticks(), SERIAL.activity.load(Ordering::Relaxed));
        if activity != self.activity || !STEP.at_rest.load(Ordering::Relaxed) {
            (self.busy, self.activity) = (now, activity);
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
