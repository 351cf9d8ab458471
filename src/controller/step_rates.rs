//! How fast the step task of a board can step.

/// What bounds the step rate of one axis.
///
/// ```text
///  step  _┌────┐_______________┌────┐___      short pulse: half a message comes between it and the next step
///         │    ├──▓▓▓▓▓▓▓▓▓────┤
///        _┌─────────────┐______┌──────        long pulse: half a message comes while it is out
///         │──▓▓▓▓▓▓▓▓▓──├──────┤
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRates {
    /// Greatest rate with the shortest pulse, steps/s.
    pub safe_hz: u32,
    /// What the step task needs without interruption for half a message, nanoseconds. A pulse at least as long leaves it that time.
    pub attention_ns: u32,
}

/// Time that a step output stays low between two pulses, microseconds: as long as the pulse, but not longer than the slowest
/// common driver (DRV8825) asks for.
const LONGEST_LOW_US: f32 = 1.9;
/// What is allowed for a pulse that ends later than due because another interrupt is in the way, microseconds. Where one ends
/// later still, the tick after it is put off: no pause is too short, and no step is lost.
const LATEST_PULSE_END_US: f32 = 1.9;
/// What comes on top of [`StepRates::attention_ns`] after a short pulse, microseconds: its end, and the entry of the next tick.
const AROUND_US: f32 = 0.7;

impl StepRates {
    /// The greatest rate that can be kept with pulses of this length (microseconds), steps/s.
    pub fn greatest_hz(self, pulse_us: f32) -> f32 {
        let low = if pulse_us < LONGEST_LOW_US { pulse_us } else { LONGEST_LOW_US };
        let attention = self.attention_ns as f32 / 1000.0;
        let mut period = pulse_us + low + LATEST_PULSE_END_US;
        if pulse_us < attention && period < pulse_us + attention + AROUND_US {
            period = pulse_us + attention + AROUND_US;
        }
        let kept = 1.0e6 / period;
        if kept < self.safe_hz as f32 { kept } else { self.safe_hz as f32 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pulses_leave_time_while_they_are_out_or_after() {
        let rates = StepRates { safe_hz: 119_000, attention_ns: 5_670 };
        for (pulse, kept) in
            [(1.0, 119_000.0), (2.0, 119_000.0), (4.0, 96_432.0), (5.0, 87_951.0), (6.0, 102_041.0), (10.0, 72_464.0)]
        {
            assert_eq!(rates.greatest_hz(pulse).round(), kept, "{pulse} us");
        }
        let idle = StepRates { safe_hz: 1_000_000, attention_ns: 0 };
        assert_eq!(idle.greatest_hz(1.0).round(), 256_410.0);
    }
}
