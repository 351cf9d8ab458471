//! Computes how fast a board can step. The length of the step pulse limits the step rate, and so does the speed of the
//! processor.

/// Nanoseconds in the unit of `$0`, a tenth of a microsecond.
const TENTH_NS: u32 = 100;
/// Longest pause between step pulses that common drivers require: 2.5 us (DM542) or 1.9 us (DRV8825), with equally long
/// pulses. Drivers that accept shorter pulses also accept shorter pauses, such as the A4988 with 1 us for both.
const LONGEST_PAUSE_NS: u32 = 2_500;
/// After a pulse shorter than this, the pause may be shorter than the pulse by [`ROUNDING_NS`]. That is safe: a driver
/// that accepts pulses below 1 us also accepts a pause far shorter than this one.
const SHORT_PULSE_NS: u32 = 1_000;
/// A step can come this much earlier than planned, because intervals are rounded to whole ticks. (Two ticks are 0.024
/// us at 84 MHz.)
const ROUNDING_NS: u32 = 40;

/// Limits of the step rate of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRates {
    /// Maximum step rate that is safe for the processor, with the shortest pulse, in steps/s.
    pub safe_hz: u32,
    /// The shortest pulse (`$0`) that the board can make, in tenths of a microsecond.
    pub least_pulse_tenths: u16,
}

impl StepRates {
    /// Returns the maximum rate with pulses of this length (tenths of a microsecond), in steps/s.
    pub fn greatest_hz(self, pulse_tenths: u16) -> f32 {
        let kept = 1.0e9 / least_period_ns(pulse_tenths) as f32;
        if kept < self.safe_hz as f32 { kept } else { self.safe_hz as f32 }
    }
}

/// Returns the minimum pause after a step pulse, in ns: as long as the pulse, but at most the longest pause that
/// drivers require. After a pulse below 1 us the pause may be shorter by the rounding of intervals, so that a square
/// wave is possible.
pub(crate) const fn least_pause_ns(pulse_tenths: u16) -> u32 {
    let pulse = pulse_tenths as u32 * TENTH_NS;
    if pulse < SHORT_PULSE_NS {
        pulse.saturating_sub(ROUNDING_NS)
    } else if pulse < LONGEST_PAUSE_NS {
        pulse
    } else {
        LONGEST_PAUSE_NS
    }
}

/// Returns the minimum planned time from step to step, in ns. It includes the rounding of intervals, so the pulse and
/// the pause after it are always complete.
const fn least_period_ns(pulse_tenths: u16) -> u32 {
    pulse_tenths as u32 * TENTH_NS + least_pause_ns(pulse_tenths) + ROUNDING_NS
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_pulse_and_its_pause() {
        let rates = StepRates { safe_hz: 490_000, least_pulse_tenths: 10 };
        for (pulse, kept) in
            [(10, 490_000.0), (20, 247_525.0), (25, 198_413.0), (50, 132_626.0), (100, 79_745.0), (2550, 3_883.0)]
        {
            assert_eq!(rates.greatest_hz(pulse).round(), kept, "{pulse} tenths of a microsecond");
        }
        assert_eq!(StepRates { safe_hz: 100_000, ..rates }.greatest_hz(10), 100_000.0);
        // A pulse of 0.5 us and an equally long pause.
        let fast = StepRates { safe_hz: 1_500_000, least_pulse_tenths: 5 };
        assert_eq!((fast.greatest_hz(5), fast.greatest_hz(9)), (1.0e6, 1.0e9 / 1_800.0));
        assert_eq!(fast.greatest_hz(10).round(), 490_196.0);
    }

    /// At the maximum rate, the pause between two step pulses is long enough for drivers, even if rounding makes the
    /// interval from pulse to pulse [`ROUNDING_NS`] shorter.
    #[test]
    fn the_pause_is_the_shorter_of_the_pulse_and_what_drivers_ask_for() {
        for pulse in 10..=2550_u16 {
            let rates = StepRates { safe_hz: u32::MAX, least_pulse_tenths: 5 };
            let pulse_ns = f64::from(pulse) * 100.0;
            let pause = 1.0e9 / f64::from(rates.greatest_hz(pulse)) - pulse_ns - f64::from(ROUNDING_NS);
            assert!(pause > pulse_ns.min(2_500.0) - 0.01 * pulse_ns / 100.0, "{pulse} tenths: {pause} ns");
            assert!(least_pause_ns(pulse) >= 2_500.min(u32::from(pulse) * 100), "{pulse}");
        }
    }
}
