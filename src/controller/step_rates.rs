//! How fast a board can step: the maximum step rate for a length of step pulse, up to the rate that is safe for its
//! processor.

/// Nanoseconds in the unit of `$0`, a tenth of a microsecond.
const TENTH_NS: u32 = 100;
/// The longest pause that common drivers ask for: 2.5 us for a DM542, 1.9 us for a DRV8825, each with a pulse as long. Drivers
/// that accept shorter pulses accept shorter pauses, such as an A4988 with 1 us of both.
const LONGEST_PAUSE_NS: u32 = 2_500;
/// Pulses shorter than this are for drivers that are far from their limit with a pause as long.
const SHORT_PULSE_NS: u32 = 1_000;
/// A step may come so much sooner than planned: intervals are whole ticks, two of which are 0.024 us at 84 MHz.
const ROUNDING_NS: u32 = 40;

/// What bounds the step rate of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRates {
    /// Greatest rate with the shortest pulse, steps/s.
    pub safe_hz: u32,
    /// The shortest pulse (`$0`), tenths of a microsecond.
    pub least_pulse_tenths: u16,
}

impl StepRates {
    /// The greatest rate that can be kept with pulses of this length (tenths of a microsecond), steps/s.
    pub fn greatest_hz(self, pulse_tenths: u16) -> f32 {
        let kept = 1.0e9 / least_period_ns(pulse_tenths) as f32;
        if kept < self.safe_hz as f32 { kept } else { self.safe_hz as f32 }
    }
}

/// The least pause after a step pulse: the shorter of the pulse and the longest pause that drivers ask for. After a pulse below
/// 1 us a single pause may be shorter by the rounding of intervals, so that a square wave can be kept.
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

/// From step to step at least, as planned: the rounding of intervals leaves the pulse and the pause after it.
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
        // A pulse of 0.5 us and a pause as long.
        let fast = StepRates { safe_hz: 1_500_000, least_pulse_tenths: 5 };
        assert_eq!((fast.greatest_hz(5), fast.greatest_hz(9)), (1.0e6, 1.0e9 / 1_800.0));
        assert_eq!(fast.greatest_hz(10).round(), 490_196.0);
    }

    /// At the greatest rate, with intervals that are shorter than planned by what their rounding may take off.
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
