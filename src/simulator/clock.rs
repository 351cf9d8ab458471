//! The virtual clock: counts ticks of the step clock since power-up and converts them to the controller's microseconds
//! and back. It advances only on request, and never backwards.

use oxmill_controller::units::Instant;
use std::time::Duration;

const MICROSECONDS: u64 = 1_000_000;

/// The time of a simulated machine, in ticks of its step clock.
#[derive(Clone, Copy, Debug)]
pub struct Clock {
    hz: u64,
    now: u64,
}

impl Clock {
    /// A clock at 0 with `hz` ticks per second; an `hz` of 0 counts as 1.
    pub fn new(hz: u32) -> Self {
        Self { hz: u64::from(hz.max(1)), now: 0 }
    }

    /// Number of ticks since power-up.
    pub fn now(&self) -> u64 {
        self.now
    }

    /// Advances to `ticks`; ignores a time in the past.
    pub fn advance_to(&mut self, ticks: u64) {
        self.now = self.now.max(ticks);
    }

    /// The time since power-up as the controller sees it: whole microseconds, rounded down.
    pub fn instant(&self) -> Instant {
        // Convert whole seconds and the remainder separately, because the ticks of a few days, multiplied by a
        // million, would overflow.
        Instant::from_ticks(self.now / self.hz * MICROSECONDS + self.now % self.hz * MICROSECONDS / self.hz)
    }

    /// Returns the first tick at which [`Clock::instant`] has reached `instant`. Saturates beyond the clock's range.
    pub fn ticks_at(&self, instant: Instant) -> u64 {
        let us = instant.ticks();
        let seconds = (us / MICROSECONDS).saturating_mul(self.hz);
        seconds.saturating_add((us % MICROSECONDS * self.hz).div_ceil(MICROSECONDS))
    }

    /// Returns the latest tick at which a wait can end. It is far enough below the maximum of ticks and of
    /// microseconds: even the longest dwell can be added without overflow.
    pub fn end(&self) -> u64 {
        (u64::MAX / 4 / MICROSECONDS).saturating_mul(self.hz).min(u64::MAX / 2)
    }

    /// Converts a duration to ticks, rounded up. Saturates beyond the clock's range.
    pub fn ticks_in(&self, span: Duration) -> u64 {
        u64::try_from((span.as_nanos() * u128::from(self.hz)).div_ceil(1_000_000_000)).unwrap_or(u64::MAX)
    }

    /// Converts ticks to seconds.
    pub fn seconds(&self, ticks: u64) -> f64 {
        ticks as f64 / self.hz as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_moment_beyond_the_range_is_behind_the_end() {
        for hz in [1, 1_000_000, 100_000_000] {
            let clock = Clock::new(hz);
            for us in [900_000_000_000_000_000, u64::MAX / 2, u64::MAX] {
                let at = clock.ticks_at(Instant::from_ticks(us));
                assert!(
                    at > clock.end() || u128::from(at) >= u128::from(us / MICROSECONDS) * u128::from(hz),
                    "{hz} {us}"
                );
            }
            // More than the longest dwell can be added without overflow, in ticks and in microseconds.
            let mut last = clock;
            last.advance_to(clock.end());
            assert!(clock.end().checked_mul(2).is_some() && last.instant().ticks().checked_mul(4).is_some());
            assert!(last.instant().ticks() / MICROSECONDS > 60_000_000_000, "2000 years");
        }
    }

    #[test]
    fn a_moment_has_come_exactly_at_its_tick() {
        for hz in [25_000_000, 90_000_000, 96_000_000, 100_000_000, 1_000_003] {
            for us in [0, 1, 2, 999_999, 1_000_000, 86_400_000_001] {
                let mut clock = Clock::new(hz);
                let at = clock.ticks_at(Instant::from_ticks(us));
                clock.advance_to(at);
                assert!(clock.instant().ticks() >= us, "{hz} {us}");
                if at > 0 {
                    let mut before = Clock::new(hz);
                    before.advance_to(at - 1);
                    assert!(before.instant().ticks() < us, "{hz} {us}");
                }
            }
        }
    }
}
