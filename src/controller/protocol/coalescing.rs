//! Holds replies back for up to about 1 ms, so that one message to the serial task carries several. Each message
//! makes that task run once more and takes a packet on the link.
//!
//! Guarantees:
//! * An answer is held back only while bytes of another line wait to be read. So a host is never delayed if it waits
//!   for the answer before it sends more.
//! * An answer is held for at most `LONGEST` plus one round of the control loop (`pump::round`).

use crate::units::{Duration, Instant};

/// Maximum time for which an answer is held: 1 ms.
const LONGEST: Duration = Duration::from_ticks(1_000);

/// Decides in each round of the control loop whether answers are held back, so that one message carries several.
#[derive(Clone, Copy, Debug)]
pub struct Coalescing {
    /// Answers are held back only in rounds of the control loop that begin before this time.
    until: Instant,
    /// The current round of the control loop began before `until`.
    is_within: bool,
}

impl Default for Coalescing {
    fn default() -> Self {
        Self { until: Instant::from_ticks(0), is_within: false }
    }
}

impl Coalescing {
    /// Starts a round of the pump (the loop of the control task) at `now`.
    #[inline(always)]
    pub fn begin(&mut self, now: Instant) {
        self.is_within = now < self.until;
    }

    /// Records that answers were sent in the round of the control loop that began at `now`. In rounds that begin less
    /// than `LONGEST` later, answers can be held back.
    #[inline(always)]
    pub fn sent(&mut self, now: Instant) {
        self.until = now + LONGEST;
    }

    /// Returns whether answers are held back in the current round of the control loop. `lines_wait`: bytes of lines
    /// wait to be read.
    #[inline(always)]
    pub fn holds(&self, lines_wait: bool) -> bool {
        lines_wait && self.is_within
    }

    /// Stops holding answers back, in rounds of the control loop that begin at `now` or later.
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
        // The first answer of a burst is sent at once.
        answers.begin(at(5_000));
        assert!(!answers.holds(true));
        // If no answer is sent in a round of the control loop, the next round holds nothing back either.
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
        // After the release no answer is held back, even in a round that begins in the same microsecond.
        answers.begin(at(5_100));
        assert!(!answers.holds(true));
    }
}
