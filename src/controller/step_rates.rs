//! `StepRates`: how fast a board can step. The greatest rate in steps/s that pulses of a length allow, with the pause
//! between two pulses, up to the board's safe rate.

/// What bounds the step rate of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRates {
    /// Greatest rate with the shortest pulse, steps/s.
    pub safe_hz: u32,
}

/// Time that a step output stays low between two pulses, microseconds: as long as the pulse, but not longer than the slowest
/// common driver (DRV8825) asks for.
const LONGEST_LOW_US: f32 = 1.9;
/// What is added to a pulse and its pause, microseconds: the timer of the pulses must be at rest again.
const AROUND_US: f32 = 0.04;

impl StepRates {
    /// The greatest rate that can be kept with pulses of this length (microseconds), steps/s.
    pub fn greatest_hz(self, pulse_us: f32) -> f32 {
        let low = if pulse_us < LONGEST_LOW_US { pulse_us } else { LONGEST_LOW_US };
        let kept = 1.0e6 / (pulse_us + low + AROUND_US);
        if kept < self.safe_hz as f32 { kept } else { self.safe_hz as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_pulse_and_its_pause() {
        let rates = StepRates { safe_hz: 490_000 };
        for (pulse, kept) in [(1.0, 490_000.0), (2.0, 253_807.0), (5.0, 144_092.0), (10.0, 83_752.0), (255.0, 3_892.0)]
        {
            assert_eq!(rates.greatest_hz(pulse).round(), kept, "{pulse} us");
        }
        assert_eq!(StepRates { safe_hz: 100_000 }.greatest_hz(1.0), 100_000.0);
    }
}
