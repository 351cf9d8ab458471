//! Minimum times between the edges of the step outputs, in ticks of the step clock, derived from the pulse length
//! (`$0`) and the direction set-up time (`$29`). The step task keeps these times between its events.
//!
//! ```text
//!  step       ____┌─────┐_______________________┌─────┐____
//!                 ├─$0──┤                       │
//!                 ├─ gap ───┤ an event at the   │
//!                 │         │ earliest          │
//!  direction  ──────────────X───────────────────┼──────────
//!                           ├─ setup ($29) ─────┤
//! ```

use crate::step_rates::least_pause_ns;

/// Minimum set-up time of a direction, even if `$29` is less, microseconds.
const LEAST_SETUP_US: u32 = 2;
/// Maximum time between two events, microseconds. If the next event is farther away, events that change nothing are
/// inserted before it. A few events are always queued ahead, so that the output never runs dry. With this limit, each
/// of them is queued only shortly before its time.
const SPLIT_US: u32 = 250;

/// Minimum and maximum times between step events, in ticks of the step clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepTiming {
    /// Length of a step pulse (`$0`) in ticks of the step clock.
    pub pulse: u32,
    /// Minimum time from one step event (a step, or a change of directions) to the next: a pulse and the pause after
    /// it.
    pub gap: u32,
    /// Minimum time from a change of directions to the next step.
    pub setup: u32,
    /// Maximum time from one step event to the next. In longer times, events that change nothing are inserted.
    split: u32,
}

impl StepTiming {
    /// Converts the step pulse length `$0` (tenths of a microsecond) and the direction set-up time `$29` (microseconds)
    /// into ticks of a step clock of `clock_mhz` MHz.
    pub const fn new(clock_mhz: u32, pulse_tenths: u16, setup_us: u32) -> StepTiming {
        let pulse = pulse_ticks(pulse_tenths, clock_mhz);
        let gap = pulse + (least_pause_ns(pulse_tenths) * clock_mhz).div_ceil(1000);
        let setup = if setup_us < LEAST_SETUP_US { LEAST_SETUP_US } else { setup_us } * clock_mhz;
        let split = SPLIT_US * clock_mhz;
        StepTiming {
            pulse,
            gap,
            setup: if setup < gap { gap } else { setup },
            split: if split < 2 * gap { 2 * gap } else { split },
        }
    }

    /// Returns whether all step events of a sequence can be output at their planned times, without a delay and without
    /// inserted events. The argument is the shortest and the longest interval between the events, in ticks.
    pub fn is_regular(&self, (least, greatest): (u32, u32)) -> bool {
        least >= self.gap && greatest < self.split
    }

    /// Returns the time of an event to insert between `last` and `next`; `None` if no event is needed. An inserted
    /// event changes nothing. One is needed in two cases: `next` is more than `split` ticks after `last`, or few
    /// events are queued ahead (`short`) and there is time for one more. The inserted event is half-way between `last`
    /// and `next`, but at most `split` ticks after `last`.
    pub fn between(&self, last: u32, next: u32, short: bool) -> Option<u32> {
        let away = next.wrapping_sub(last) as i32;
        if away <= self.split as i32 && !(short && away >= 2 * self.gap as i32) {
            return None;
        }
        let half = away as u32 / 2;
        Some(last.wrapping_add(if half < self.split { half } else { self.split }))
    }
}

/// Returns a step pulse (`$0`, tenths of a microsecond) in ticks of a timer of `clock_mhz` MHz, rounded up to whole
/// ticks. Whole microseconds are exact; tenths are exact on timers of 90, 100 or 180 MHz.
const fn pulse_ticks(pulse_tenths: u16, clock_mhz: u32) -> u32 {
    (pulse_tenths as u32 * clock_mhz).div_ceil(10)
}

/// Returns the later of two times of a wrapping clock.
pub fn later(a: u32, b: u32) -> u32 {
    if a.wrapping_sub(b) as i32 >= 0 { a } else { b }
}

/// Returns the earlier of two times of a wrapping clock.
pub fn sooner(a: u32, b: u32) -> u32 {
    if a.wrapping_sub(b) as i32 <= 0 { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_pause_is_as_long_as_the_pulse_up_to_what_drivers_want() {
        for (clock_mhz, pulse_tenths, setup_us, wanted) in [
            (96, 10, 0, (96, 192, 192)),
            (96, 20, 10, (192, 384, 960)),
            (96, 100, 0, (960, 1200, 1200)),
            (96, 2550, 255, (24_480, 24_720, 24_720)),
            (96, 25, 0, (240, 480, 480)),
            // Pulse (0.5 us) and pause (0.46 us) in ticks: 48 and 44.16; 45 and 41.4; 42 and 38.64.
            (96, 5, 0, (48, 93, 192)),
            (90, 5, 0, (45, 87, 180)),
            (84, 5, 0, (42, 81, 168)),
            // Pulse (0.8 us) and pause (0.76 us) in ticks: 67.2 and 63.84.
            (84, 8, 0, (68, 132, 168)),
        ] {
            let timing = StepTiming::new(clock_mhz, pulse_tenths, setup_us);
            assert_eq!(
                (timing.pulse, timing.gap, timing.setup),
                wanted,
                "{clock_mhz} MHz {pulse_tenths} $29={setup_us}"
            );
        }
    }

    /// At the highest rate that [`crate::StepRates`] allows, the interval is at least a pulse and its pause
    /// ([`StepTiming::gap`]), for every pulse length. At the clocks of the boards, at least one tick is left over.
    #[test]
    fn the_greatest_rate_leaves_the_gap() {
        let rates = crate::StepRates { safe_hz: u32::MAX, least_pulse_tenths: 1 };
        for pulse_tenths in 5..=2550 {
            for (clock_mhz, spare) in [(25, 0.0), (84, 1.0), (90, 1.0), (96, 1.0), (100, 1.0)] {
                let timing = StepTiming::new(clock_mhz, pulse_tenths, 0);
                let period = f64::from(clock_mhz) * 1.0e6 / f64::from(rates.greatest_hz(pulse_tenths));
                assert!(
                    period + 0.01 >= f64::from(timing.gap) + spare,
                    "{clock_mhz} {pulse_tenths} {period} {timing:?}"
                );
                let longer = 10 * timing.pulse - u32::from(pulse_tenths) * clock_mhz;
                assert!(longer < 10, "never shorter, nor a tick longer: {clock_mhz} {pulse_tenths} {timing:?}");
            }
        }
    }

    proptest! {
        /// At any time of the wrapping clock, the events that [`StepTiming::between`] inserts keep the minimum and the
        /// maximum time to their neighbours, and their number is finite.
        #[test]
        fn long_times_are_filled_up(last in any::<u32>(), away in 0_u32..1 << 28, pulse_tenths in 5_u16..=2550, short in any::<bool>()) {
            let timing = StepTiming::new(96, pulse_tenths, 0);
            let next = last.wrapping_add(away);
            let mut at = last;
            while let Some(between) = timing.between(at, next, short) {
                prop_assert!((timing.gap..=timing.split).contains(&between.wrapping_sub(at)));
                at = between;
                prop_assert!(next.wrapping_sub(at) as i32 >= timing.gap as i32);
            }
            prop_assert!(next.wrapping_sub(at) <= timing.split);
        }
    }
}
