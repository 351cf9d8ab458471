//! The limits of the axes (rate, acceleration, jerk). Computes from them, for a direction of motion, the maximum speed,
//! acceleration and jerk at which no axis exceeds its own limit.

use super::MotionSettings;
use super::junction::TurnRule;
use super::trapezoid::{lesser, quotient};
use crate::axes::PerAxis;

/// Minimum speed, mm/s: one step per minute with 40,000 steps/mm.
const LEAST_SPEED: f32 = 4.0e-7;
/// Maximum speed, mm/s, far beyond any machine's; its square fits an `f32`.
const GREATEST_SPEED: f32 = 1.0e5;
/// Lower bound of an axis' acceleration setting, mm/s².
const LEAST_ACCELERATION: f32 = 1.0e-3;
/// Upper bound of an axis' acceleration setting, mm/s², far beyond any machine's.
pub(super) const GREATEST_ACCELERATION: f32 = 1.0e7;
/// Lower bound of the curve share setting: the part of the acceleration that curves may take, 1 for all of it.
const LEAST_CURVE_SHARE: f32 = 0.01;
/// Upper bound of the curve share setting.
const GREATEST_CURVE_SHARE: f32 = 100.0;
/// Upper bound of the junction deviation setting, mm.
const GREATEST_DEVIATION: f32 = 1.0e3;
/// Lower bound of an axis' jerk setting, mm/s³, if the setting is not 0.
const LEAST_JERK: f32 = 1.0;
/// Upper bound of an axis' jerk setting, mm/s³; also the value for an axis without a limit.
const GREATEST_JERK: f32 = 1.0e10;
/// Minimum time, s, in which the maximum acceleration is built up. This time spans several segments, because the
/// acceleration can only change from one segment to the next.
const LEAST_EASE: f32 = 0.004;

/// Limits `value` to a range; NaN becomes `least`.
pub(super) fn bounded(value: f32, least: f32, greatest: f32) -> f32 {
    if value > least { lesser(value, greatest) } else { least }
}

fn bounded_speed(speed: f32) -> f32 {
    bounded(speed, LEAST_SPEED, GREATEST_SPEED)
}

/// Returns the size of each axis' displacement, divided by the path's length.
#[inline]
pub(super) fn shares<const N: usize>(way: &PerAxis<f32, N>, length: f32) -> [f32; N] {
    way.0.map(|part| part.abs() / length)
}

/// The limits of all axes, and the rule for turns.
#[derive(Clone, Copy, Debug)]
pub(super) struct AxisLimits<const N: usize> {
    /// The rule for turns, with the acceleration of each axis.
    pub turns: TurnRule<N>,
    /// Maximum speed of each axis, mm/s.
    max_rate: [f32; N],
    /// Minimum feed, mm/s.
    least_feed: f32,
    /// Maximum jerk of each axis, mm/s³.
    jerk: [f32; N],
    jerk_limited: bool,
}

impl<const N: usize> AxisLimits<N> {
    /// Limits before settings are applied.
    pub(super) const ONE: Self = Self {
        turns: TurnRule::ONE,
        max_rate: [1.0; N],
        least_feed: LEAST_SPEED,
        jerk: [GREATEST_JERK; N],
        jerk_limited: false,
    };

    pub(super) fn new(settings: &MotionSettings<N>) -> Self {
        let jerk = |jerk| if jerk > 0.0 { bounded(jerk, LEAST_JERK, GREATEST_JERK) } else { GREATEST_JERK };
        Self {
            turns: TurnRule::new(
                settings.acceleration.0.map(|a| bounded(a, LEAST_ACCELERATION, GREATEST_ACCELERATION)),
                bounded(settings.junction_deviation, 0.0, GREATEST_DEVIATION),
                bounded(settings.curve_share, LEAST_CURVE_SHARE, GREATEST_CURVE_SHARE),
            ),
            max_rate: settings.max_rate.0.map(bounded_speed),
            least_feed: bounded_speed(settings.least_feed),
            jerk: settings.jerk.0.map(jerk),
            jerk_limited: settings.jerk.iter().any(|jerk| *jerk > 0.0),
        }
    }

    #[inline]
    pub(super) fn is_jerk_limited(&self) -> bool {
        self.jerk_limited
    }

    /// Returns the programmed speed, mm/s, limited to the range from the minimum feed to the maximum speed.
    #[inline]
    pub(super) fn feed(&self, programmed: f32) -> f32 {
        bounded(programmed, self.least_feed, GREATEST_SPEED)
    }

    /// Returns the maximum acceleration (mm/s²) and the maximum speed (mm/s) along a straight path with the
    /// displacement `way` and the length `length`, both in mm.
    pub(super) fn along(&self, way: &PerAxis<f32, N>, length: f32) -> (f32, f32) {
        self.along_shares(&shares(way, length))
    }

    /// Does the same as [`AxisLimits::along`], but takes the [`shares`] of the axes.
    #[inline]
    pub(super) fn along_shares(&self, shares: &[f32; N]) -> (f32, f32) {
        let mut acceleration = GREATEST_ACCELERATION;
        let mut limit = GREATEST_SPEED;
        // For an axis that does not move (share 0) neither condition is true, so nothing is divided by 0.
        for ((share, most), rate) in shares.iter().zip(&self.turns.acceleration).zip(&self.max_rate) {
            if share * acceleration > *most {
                acceleration = quotient(*most, *share);
            }
            if share * limit > *rate {
                limit = quotient(*rate, *share);
            }
        }
        (acceleration, limit)
    }

    /// Returns the maximum jerk along a straight path, mm/s³. `shares`: displacement of each axis divided by the path's
    /// length. `acceleration`: maximum acceleration along the path, mm/s².
    #[inline]
    pub(super) fn jerk_along(&self, shares: &[f32; N], acceleration: f32) -> f32 {
        let mut jerk = acceleration / LEAST_EASE;
        if self.jerk_limited {
            for (share, most) in shares.iter().zip(&self.jerk) {
                if share * jerk > *most {
                    jerk = quotient(*most, *share);
                }
            }
        }
        jerk
    }

    /// Returns the lowest acceleration limit of the axes that move (whose share is not 0), mm/s².
    #[inline(never)]
    pub(super) fn least_acceleration(&self, shares: &[f32; N]) -> f32 {
        let moving = shares.iter().zip(self.turns.acceleration).filter(|(part, _)| **part != 0.0);
        moving.fold(GREATEST_ACCELERATION, |least, (_, own)| lesser(own, least))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits(jerk: [f32; 2]) -> AxisLimits<2> {
        AxisLimits {
            turns: TurnRule::new([500.0, 100.0], 0.01, 1.0),
            max_rate: [100.0, 50.0],
            least_feed: 0.0,
            jerk: jerk.map(|jerk| if jerk > 0.0 { jerk } else { GREATEST_JERK }),
            jerk_limited: jerk.iter().any(|jerk| *jerk > 0.0),
        }
    }

    #[test]
    fn an_axis_that_does_not_move_sets_no_limit() {
        let limits = limits([0.0; 2]);
        assert_eq!(limits.along(&PerAxis([-2.0, 0.0]), 2.0), (500.0, 100.0));
        assert_eq!(limits.along(&PerAxis([0.0, 3.0]), 3.0), (100.0, 50.0));
        assert_eq!(limits.least_acceleration(&[1.0, 0.0]), 500.0);
        assert_eq!(limits.least_acceleration(&[1.0, 1.0e-3]), 100.0);
    }

    #[test]
    fn along_a_diagonal_no_axis_goes_beyond_its_own() {
        let (acceleration, speed) = limits([0.0; 2]).along(&PerAxis([3.0, -4.0]), 5.0);
        assert_eq!((acceleration, speed), (100.0 / 0.8, 50.0 / 0.8));
    }

    #[test]
    fn jerk_is_that_of_the_axis_that_has_least_for_its_share() {
        let way = shares(&PerAxis([3.0, -4.0]), 5.0);
        assert_eq!(limits([0.0; 2]).jerk_along(&way, 100.0), 100.0 / LEAST_EASE);
        assert_eq!(limits([600.0, 0.0]).jerk_along(&way, 100.0), 600.0 / 0.6);
        assert_eq!(limits([600.0, 400.0]).jerk_along(&way, 100.0), 400.0 / 0.8);
    }

    #[test]
    fn what_is_not_a_number_counts_as_the_least() {
        assert_eq!(bounded(f32::NAN, 1.0, 2.0), 1.0);
        assert_eq!((bounded(3.0, 1.0, 2.0), bounded(-1.0, 1.0, 2.0), bounded(1.5, 1.0, 2.0)), (2.0, 1.0, 1.5));
    }
}
