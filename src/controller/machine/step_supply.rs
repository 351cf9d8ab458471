//! Keeps the step queue filled. Decides when to cut segments (pieces of planned motion) for the queue before planning
//! more lines, and when the controller has to be called again to refill the queue. Also records whether a motion is
//! in progress.
//!
//! ```text
//!  step time queued
//!  12 ms ── well filled ── from here on planning comes first
//!   6 ms ── low water ──── segments come first again
//!   0     ── at a start
//! ```
//! The step queue must not run dry while something moves. So when a motion starts, the queue is filled before more
//! lines are planned. From then on it is topped up. It runs low again only if the control task is late.

use crate::messages::{LINES_DEPTH, Observed};
use crate::units::Duration;

/// Maximum time between two calls of the controller while something moves: 2 ms. Each call refills the step queue.
const MOVING_WAKEUP: Duration = Duration::from_ticks(2_000);
/// Minimum time between two calls of the controller while something moves: 0.1 ms. It applies when the queue is full
/// of very short segments, or runs empty at the end of a motion.
const LEAST_WAKEUP: Duration = Duration::from_ticks(100);
/// Queued step time in microseconds from which the queue counts as well filled. Planning then comes before cutting
/// segments.
const WELL_FILLED_US: u32 = 12_000;
/// If the queued step time falls below this value, in microseconds, cutting segments comes before planning again.
const LOW_WATER_US: u32 = 6_000;

/// How well the step queue is filled, and the counters of the step task and of the received bytes.
#[derive(Clone, Debug)]
pub(crate) struct StepSupply {
    /// Since motion began, the step queue has contained [`WELL_FILLED_US`] of step time at least once.
    well_filled: bool,
    /// Motion has been started and has not ended.
    running: bool,
    /// The host's input has ended: no more bytes will come.
    input_ended: bool,
    observed: Observed,
}

impl StepSupply {
    /// At rest.
    pub(crate) const AT_REST: StepSupply = StepSupply {
        well_filled: false,
        running: false,
        input_ended: false,
        observed: Observed {
            segments_begun: 0,
            step_idle: true,
            rx_free: LINES_DEPTH as u16,
            received: 0,
            activity: 0,
        },
    };

    /// Stores the counters of the step task and of the received bytes.
    pub(crate) fn observe(&mut self, observed: Observed) {
        self.observed = observed;
    }

    /// Returns the counters that [`StepSupply::observe`] has stored.
    pub(crate) fn observed(&self) -> &Observed {
        &self.observed
    }

    /// Records that no more bytes will come, so that queued motion starts without waiting for further moves.
    pub(crate) fn end_input(&mut self) {
        self.input_ended = true;
    }

    /// Returns whether no further line is waiting: all received bytes have been read, or the input has ended.
    pub(crate) fn has_no_more(&self) -> bool {
        self.input_ended || self.observed.received == 0
    }

    /// Returns whether motion has been started and has not ended.
    pub(crate) fn is_running(&self) -> bool {
        self.running
    }

    /// Records that a motion has started. Until [`StepSupply::end`] is called, the step queue must not run empty.
    pub(crate) fn start(&mut self) {
        self.running = true;
    }

    /// Records that the motion has ended. From here on the step queue may run empty.
    pub(crate) fn end(&mut self) {
        self.running = false;
    }

    /// Returns whether segments must be cut before more lines are planned. `holds` returns whether the step queue
    /// contains at least the given number of microseconds of step time.
    pub(crate) fn is_short(&mut self, holds: impl Fn(u32) -> bool) -> bool {
        self.well_filled = (self.well_filled || holds(WELL_FILLED_US)) && self.running;
        !self.well_filled || !holds(LOW_WATER_US)
    }
}

/// Returns how long the controller may wait before it refills the step queue: half of the queued step time, within
/// limits. The number of queued messages is no measure of this time, because a queue full of single-step blocks is
/// only a millisecond or two of motion. `queued`: step time of the parking motion and of the program's motion, in
/// microseconds.
pub(crate) fn refill_delay(queued: [u32; 2]) -> Duration {
    let queued = match queued {
        [0, 0] => return MOVING_WAKEUP,
        [0, queued] | [queued, 0] => queued,
        [one, other] => one.min(other),
    };
    Duration::from_ticks(u64::from(queued / 2)).clamp(LEAST_WAKEUP, MOVING_WAKEUP)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn segments_come_first_at_a_start_and_at_low_water() {
        let mut feed = StepSupply::AT_REST;
        feed.start();
        let holding = |queued: u32| move |us: u32| queued >= us;
        assert!(feed.is_short(holding(11_999)));
        assert!(!feed.is_short(holding(12_000)));
        assert!(!feed.is_short(holding(6_000)) && feed.is_short(holding(5_999)));
        feed.end();
        assert!(feed.is_short(holding(12_000)), "the next motion is filled again");
    }

    #[test]
    fn half_of_what_is_queued_may_be_slept_through() {
        let ticks =
            [[0, 0], [0, 1_000], [3_000, 1_000], [0, 50], [90_000, 0]].map(|queued| refill_delay(queued).ticks());
        assert_eq!(ticks, [2_000, 500, 500, 100, 2_000]);
    }
}
