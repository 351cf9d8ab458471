//! How fast a board can step.

use crate::step_timing::least_period_ns;

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
