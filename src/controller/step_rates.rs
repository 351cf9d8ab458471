//! `StepRates`: how fast a board can step. The greatest rate in steps/s that pulses of a length allow, with the pause
//! between two pulses, up to the board's safe rate. All in nanoseconds: `TENTH_NS`, `ROUNDING_NS`, `SHORT_PULSE_NS`,
//! `LONGEST_PAUSE_NS`, `least_period_ns`.

/// Nanoseconds in the unit of `$0`, a tenth of a microsecond.
const TENTH_NS: u32 = 100;
/// What drivers want of a pause at most: the slowest common one (DRV8825) asks for 1.9 us, and for as much of the pulse
/// itself. Drivers that take shorter pulses take shorter pauses: A4988 1 us of both, TMC2209 0.1 us.
const LONGEST_PAUSE_NS: u32 = 1_900;
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

/// The pause after a step pulse at least: as long as the pulse, but no longer than any driver asks for. After a short pulse a
/// single one may be shorter by the rounding of intervals, so that a square wave can be kept.
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
            [(10, 490_000.0), (20, 253_807.0), (25, 225_225.0), (50, 144_092.0), (100, 83_752.0), (2550, 3_892.0)]
        {
            assert_eq!(rates.greatest_hz(pulse).round(), kept, "{pulse} tenths of a microsecond");
        }
        assert_eq!(StepRates { safe_hz: 100_000, ..rates }.greatest_hz(10), 100_000.0);
        // A pulse of 0.5 us and a pause as long.
        let fast = StepRates { safe_hz: 1_500_000, least_pulse_tenths: 5 };
        assert_eq!((fast.greatest_hz(5), fast.greatest_hz(9)), (1.0e6, 1.0e9 / 1_800.0));
        assert_eq!(fast.greatest_hz(10).round(), 490_196.0);
    }
}
