//! Converts between spindle speed (S, rpm) and PWM power, within `$30` and `$31` and under an override.

use crate::settings::{Key, Settings};

/// Minimum power of a spindle that is on: 1 of Grbl's 255 PWM steps, so that the minimum speed does not switch the
/// spindle off.
const LEAST_POWER: f32 = 257.0;
const FULL_POWER: f32 = 65_535.0;

/// Speed range of the spindle: `$30` (maximum) and `$31` (minimum).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpindleRange {
    /// Speed at full power, in rpm.
    pub maximum: f32,
    /// Speed at minimum power, in rpm.
    pub minimum: f32,
}

impl SpindleRange {
    /// Reads the range from the settings `$30` and `$31`.
    pub fn of<const N: usize>(settings: &Settings<N>) -> SpindleRange {
        SpindleRange { maximum: settings.value(Key::SpindleMaximum), minimum: settings.value(Key::SpindleMinimum) }
    }

    /// Returns the power (0 to 65535) and the actual speed (rpm) for a programmed speed (rpm) under an override in
    /// percent. A speed outside the range is replaced by the nearer end of the range. A speed of 0 is off.
    pub fn output(&self, programmed: f32, percent: u8) -> (u16, f32) {
        let speed = programmed * f32::from(percent) / 100.0;
        if speed <= 0.0 {
            (0, 0.0)
        } else if self.minimum >= self.maximum || speed >= self.maximum {
            (FULL_POWER as u16, self.maximum)
        } else if speed <= self.minimum {
            (LEAST_POWER as u16, self.minimum)
        } else {
            let share = (speed - self.minimum) / (self.maximum - self.minimum);
            ((LEAST_POWER + share * (FULL_POWER - LEAST_POWER)) as u16, speed)
        }
    }

    /// Returns `power` as changed by an override in percent. Not inlined: most outputs need no override, and the caller
    /// would have to save registers for the constants of this calculation.
    #[inline(never)]
    pub fn overridden(&self, power: u16, percent: u8) -> u16 {
        self.output(self.speed_of(power), percent).0
    }

    /// Returns the speed (rpm) of a power: the inverse of [`SpindleRange::output`].
    pub fn speed_of(&self, power: u16) -> f32 {
        if power == 0 {
            0.0
        } else if self.minimum >= self.maximum {
            self.maximum
        } else {
            let share = (f32::from(power) - LEAST_POWER) / (FULL_POWER - LEAST_POWER);
            self.minimum + share * (self.maximum - self.minimum)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn speeds_map_to_power() {
        let range = SpindleRange { maximum: 1000.0, minimum: 200.0 };
        assert_eq!(range.output(0.0, 100), (0, 0.0));
        assert_eq!(range.output(50.0, 100), (257, 200.0));
        assert_eq!(range.output(1000.0, 100), (65_535, 1000.0));
        assert_eq!(range.output(600.0, 200), (65_535, 1000.0));
        assert_eq!(range.output(600.0, 100), (32_896, 600.0));
        for speed in [200.0, 300.0, 600.0, 999.0, 1000.0] {
            assert!((range.speed_of(range.output(speed, 100).0) - speed).abs() < 0.02);
        }
        assert_eq!(SpindleRange { maximum: 0.0, minimum: 0.0 }.output(10.0, 100), (65_535, 0.0));
    }
}
