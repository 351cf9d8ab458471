//! Holds replies back for a moment, so that several go to the serial task in one message. Each message costs a run of
//! that task and a packet on the link.
//!
//! It promises: an answer is held only while whole or part of another line waits to be taken, so a host that waits for it
//! before it sends more never finds it held; and no longer than `LONGEST` and a round.

use crate::units::{Duration, Instant};

/// Longest time for which an answer is held.
const LONGEST: Duration = Duration::from_ticks(1_000);

/// Whether answers are held back.
#[derive(Clone, Copy, Debug)]
pub struct Coalescing {
    /// When answers are held no longer.
    until: Instant,
    /// The round began before that.
    is_within: bool,
}

impl Default for Coalescing {
    fn default() -> Self {
        Self { until: Instant::from_ticks(0), is_within: false }
    }
}

impl Coalescing {
    /// A round begins.
    #[inline(always)]
    pub fn begin(&mut self, now: Instant) {
        self.is_within = now < self.until;
    }

    /// Answers have gone in the round that began at `now`: those that follow may be held.
    #[inline(always)]
    pub fn sent(&mut self, now: Instant) {
        self.until = now + LONGEST;
    }

    /// Whether answers are held back in this round. `lines_wait`: there are bytes of lines that it could take.
    #[inline(always)]
    pub fn holds(&self, lines_wait: bool) -> bool {
        lines_wait && self.is_within
    }

    /// In the next round, if it begins at `now` or later, nothing is held back.
    pub fn release(&mut self, now: Instant) {
        self.until = now;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(micros: u64) -> Instant {
        Instant::from_ticks(micros)
    }

    #[test]
    fn answers_are_held_a_millisecond_at_most_and_only_while_lines_wait() {
        let mut answers = Coalescing::default();
        // The first of a burst goes at once.
        answers.begin(at(5_000));
        assert!(!answers.holds(true));
        // A round that has other things to do leaves them to the next.
        answers.begin(at(5_000));
        assert!(!answers.holds(true));
        answers.sent(at(5_000));
        for micros in [5_000, 5_300, 5_999] {
            answers.begin(at(micros));
            assert!(answers.holds(true) && !answers.holds(false), "{micros}");
        }
        answers.begin(at(6_000));
        assert!(!answers.holds(true));
        answers.sent(at(6_000));
        answers.begin(at(6_001));
        assert!(answers.holds(true));
    }

    #[test]
    fn nothing_is_held_while_the_pump_sleeps() {
        let mut answers = Coalescing::default();
        answers.begin(at(5_000));
        answers.sent(at(5_000));
        answers.begin(at(5_100));
        assert!(answers.holds(true));
        answers.release(at(5_100));
        // Of the same microsecond, too.
        answers.begin(at(5_100));
        assert!(!answers.holds(true));
    }
}
