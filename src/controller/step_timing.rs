//! `StepTiming`: when edges of the step outputs may come, in ticks of the step clock. From the pulse (`$0`) and the
//! direction set-up (`$29`) follow the gap and the split between events; `between` places an event that changes nothing
//! in a long pause, `is_regular` and `later` compare intervals and moments.
//!
//! ```text
//!  step       ____┌─────┐_______________________┌─────┐____
//!                 ├─$0──┤                       │
//!                 ├─ gap ───┤ an event at the   │
//!                 │         │ earliest          │
//!  direction  ──────────────X───────────────────┼──────────
//!                           ├─ setup ($29) ─────┤
//! ```

/// What drivers want of a pause at most, microseconds: the slowest common one (DRV8825) asks for 1.9, and for as much of the pulse
/// itself. Drivers that take shorter pulses take shorter pauses: A4988 1 us of both, TMC2209 0.1 us.
const LONGEST_PAUSE_NS: u32 = 1_900;
/// Least set-up time of a direction, whatever `$29` says, microseconds.
const LEAST_SETUP_US: u32 = 2;
/// No event for longer than this, microseconds, is filled up by events that change nothing: so what must be ahead of its time
/// for outputs to follow on each other is never old.
const SPLIT_US: u32 = 250;

/// See the head of this file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepTiming {
    /// Length of a step pulse (`$0`) in ticks of the step clock.
    pub pulse: u32,
    /// From one event to the next at least: a pulse and the pause after it.
    pub gap: u32,
    /// From a change of directions to the next step at least.
    pub setup: u32,
    /// From one event to the next at most.
    split: u32,
}

impl StepTiming {
    /// Turns the step pulse `$0` and the direction set-up `$29`, microseconds, into timer ticks of a step clock of so many MHz.
    pub const fn new(clock_mhz: u32, pulse_us: u32, setup_us: u32) -> StepTiming {
        let pulse = pulse_us * clock_mhz;
        let longest = (LONGEST_PAUSE_NS * clock_mhz).div_ceil(1000);
        let gap = pulse + if pulse < longest { pulse } else { longest };
        let setup = if setup_us < LEAST_SETUP_US { LEAST_SETUP_US } else { setup_us } * clock_mhz;
        let split = SPLIT_US * clock_mhz;
        StepTiming {
            pulse,
            gap,
            setup: if setup < gap { gap } else { setup },
            split: if split < 2 * gap { 2 * gap } else { split },
        }
    }

    /// Whether ticks with these intervals, the least and the greatest of a row, can be put out as they are.
    #[inline]
    pub fn is_regular(&self, (least, greatest): (u32, u32)) -> bool {
        least >= self.gap && greatest < self.split
    }

    /// Where an event that changes nothing comes in between, if the next one is far from the last, or if what is ahead
    /// is short (`short`), so that no more could follow soon: at least half of the time to both, and no more than the longest from the
    /// last.
    #[inline]
    pub fn between(&self, last: u32, next: u32, short: bool) -> Option<u32> {
        let away = next.wrapping_sub(last) as i32;
        if away <= self.split as i32 && !(short && away >= 2 * self.gap as i32) {
            return None;
        }
        let half = away as u32 / 2;
        Some(last.wrapping_add(if half < self.split { half } else { self.split }))
    }
}

/// The later of two moments of a wrapping clock.
#[inline]
pub fn later(a: u32, b: u32) -> u32 {
    if a.wrapping_sub(b) as i32 >= 0 { a } else { b }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn a_pause_is_as_long_as_the_pulse_up_to_what_drivers_want() {
        for (pulse_us, setup_us, wanted) in [
            (1, 0, (96, 192, 192)),
            (2, 10, (192, 375, 960)),
            (10, 0, (960, 1143, 1143)),
            (255, 255, (24_480, 24_663, 24_663)),
        ] {
            let timing = StepTiming::new(96, pulse_us, setup_us);
            assert_eq!((timing.pulse, timing.gap, timing.setup), wanted, "$0={pulse_us} $29={setup_us}");
        }
        // The rate that the settings allow leaves this gap.
        for pulse_us in 1..=255_u8 {
            for clock_mhz in [25, 84, 90, 96, 100] {
                let timing = StepTiming::new(clock_mhz, u32::from(pulse_us), 0);
                let period =
                    clock_mhz as f32 * 1.0e6 / crate::StepRates { safe_hz: u32::MAX }.greatest_hz(f32::from(pulse_us));
                assert!(period >= timing.gap as f32, "{period} {timing:?}");
            }
        }
    }

    proptest! {
        /// Whatever the moments, steps of a wrapping clock: events in between keep both distances, and there is an end.
        #[test]
        fn long_times_are_filled_up(last in any::<u32>(), away in 0_u32..1 << 28, pulse_us in 1_u32..=255, short in any::<bool>()) {
            let timing = StepTiming::new(96, pulse_us, 0);
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
