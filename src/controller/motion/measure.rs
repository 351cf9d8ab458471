//! The exact arithmetic of steps within a block: how many steps each axis has taken after a number of units. Both the
//! step generator and the code that cuts segments use this module, so they agree on where a segment ends. All
//! computations use whole numbers and are exact; there is no state.
//!
//! Each axis has a countdown to its next step, the remainder. Each unit reduces it by the axis' rate; each step adds
//! the threshold (see `dda`). On a line, an axis' rate is its number of steps. The threshold is the number of units:
//! 16 for each step of the dominant axis, the one with the most steps.
//!
//! A chord of a curve can begin and end between two steps. Its exact start is f steps beyond the step nearest to the
//! start. Its exact end is g steps beyond the step nearest to the end. f and g are from -1/2 to 1/2, in sevenths of a
//! step ([`AxisSteps`]). After u of M units, an axis with n steps has taken ⌈f + (n + g - f)·u/M - 1/2⌉ steps. This
//! number is 0 at the start, n at the end, and always within half a step of the exact chord.
//!
//! To compute this number without fractions, everything is multiplied by 7: the threshold is 7·M, the rate is 7·n +
//! 7·g - 7·f, and the first remainder is smaller by 7·f·M.

use crate::messages::{AxisSteps, UNITS_PER_STEP};

/// How the steps of a block are counted: its length in units, and the value of one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Measure {
    /// Units of the whole block: 16 for each step of the dominant axis.
    pub total: u32,
    /// Amount that each step adds to an axis' countdown (`dda`).
    pub threshold: u32,
    /// `threshold` / `total`: 7 if steps are counted in sevenths, because an axis begins or ends between two steps;
    /// otherwise 1.
    scale: u32,
}

impl Measure {
    /// Maximum number of steps of a block that can be counted in sevenths: its threshold is at most 2^30.
    pub(super) const MOST_STEPS: u32 = (1 << 30) / (UNITS_PER_STEP * AxisSteps::PARTS);

    #[inline(always)]
    pub(super) fn of<const N: usize>(steps_by_axis: &[AxisSteps; N]) -> Self {
        let (mut dominant, mut on_steps) = (0, true);
        for axis_steps in steps_by_axis {
            dominant = axis_steps.steps().max(dominant);
            on_steps &= axis_steps.is_on_steps();
        }
        let total = dominant.wrapping_mul(UNITS_PER_STEP);
        let scale = if on_steps { 1 } else { AxisSteps::PARTS };
        Self { total, threshold: total.wrapping_mul(scale), scale }
    }

    /// Returns the amount by which each unit of the block reduces an axis' countdown to its next step. The rate is
    /// negative (wrapped) for an axis without steps that moves backwards by less than a step in the whole block.
    #[inline(always)]
    pub(super) fn rate(&self, axis_steps: AxisSteps) -> u32 {
        axis_steps
            .steps()
            .wrapping_mul(self.scale)
            .wrapping_add_signed(axis_steps.end().wrapping_sub(axis_steps.start()))
    }

    /// Returns the value with which the sum in [`steps_taken`] begins: half a step, plus the offset of the axis' exact
    /// start, minus 1. A step equals `threshold`. The 1 is subtracted so that a point exactly half way between two
    /// steps counts as the lower step.
    #[inline(always)]
    pub(super) fn credit(&self, axis_steps: AxisSteps) -> u32 {
        (self.threshold / 2).wrapping_add(parts_beyond(self.total, axis_steps)).wrapping_sub(1)
    }
}

/// Returns the steps that an axis has taken after `units` of a block, from its rate and credit ([`Measure`]):
/// (credit + rate × units) / threshold, computed exactly and rounded down.
#[inline]
pub(super) fn steps_taken(rate: u32, credit: u32, threshold: u32, units: u32) -> u32 {
    if threshold == 0 {
        return 0;
    }
    let sum = advance(rate, units).wrapping_add(u64::from(credit));
    match u32::try_from(sum) {
        Ok(small) => small / threshold,
        Err(_) => (sum / u64::from(threshold)) as u32,
    }
}

/// Returns the offset of an axis' exact start from the step nearest to it, scaled so that a step equals the threshold.
/// Negative numbers are wrapped. `total`: length of the block in units.
#[inline(always)]
pub(super) fn parts_beyond(total: u32, axis_steps: AxisSteps) -> u32 {
    (axis_steps.start() as u32).wrapping_mul(total)
}

/// Returns `rate` × `units`. `rate` can be negative (wrapped); both are less than 2^31.
#[inline]
pub(super) fn advance(rate: u32, units: u32) -> u64 {
    (i64::from(rate as i32) * i64::from(units as i32)) as u64
}

/// Returns [`steps_taken`] and the countdown to the next step. `first`: the countdown at the start of the block.
/// Divides bit by bit, which is slow but small. The step task has no room for a 64-bit division, and calls this
/// function only at rest.
pub(super) fn steps_and_rest(rate: u32, first: u32, threshold: u32, units: u32) -> (u32, u32) {
    let mut sum = advance(rate, units).wrapping_add(u64::from(threshold.wrapping_sub(first)));
    let mut taken = 0;
    for bit in (0..AxisSteps::STEP_BITS).rev() {
        let part = u64::from(threshold) << bit;
        if sum > part {
            sum -= part;
            taken |= 1 << bit;
        }
    }
    (taken, threshold.wrapping_sub(sum as u32))
}

/// Returns the inverse of an odd number modulo 2^32. Each Newton iteration doubles the number of correct bits (5 at
/// first).
#[inline]
pub(super) fn inverse(odd: u32) -> u32 {
    let mut inverse = odd.wrapping_mul(3) ^ 2;
    for _ in 0..3 {
        inverse = inverse.wrapping_mul(2_u32.wrapping_sub(odd.wrapping_mul(inverse)));
    }
    inverse
}

#[inline]
pub(super) fn signed_add(value: i32, steps: u32, negative: bool) -> i32 {
    if negative { value.wrapping_sub_unsigned(steps) } else { value.wrapping_add_unsigned(steps) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// An exact fraction: numerator and denominator.
    #[derive(Clone, Copy)]
    struct Ratio(i128, i128);

    /// Returns the steps taken by definition. With n steps between offsets of f and g sevenths, the exact position
    /// after u of M units is f/7 + (n + (g - f)/7)·u/M. The axis has taken the step nearest to this position. If two
    /// steps are equally near, it has taken the lower one.
    pub fn defined(axis_steps: AxisSteps, total: u32, units: u32) -> i128 {
        let (n, f, g) = (i128::from(axis_steps.steps()), i128::from(axis_steps.start()), i128::from(axis_steps.end()));
        let (u, m) = (i128::from(units), i128::from(total));
        let Ratio(above, below) = Ratio(f * m + (7 * n + g - f) * u, 7 * m);
        // Steps taken: the exact position, less half a step, rounded up.
        -(below - 2 * above).div_euclid(2 * below)
    }

    /// Generates the steps of three axes. The second and the third axis can have up to as many steps as the first one,
    /// which is dominant.
    pub fn steps_by_axis(most: u32) -> impl Strategy<Value = [AxisSteps; 3]> {
        let ends = || prop_oneof![1 => Just([0; 3]), 3 => prop::array::uniform3(-3..=3)];
        let share = || prop_oneof![3 => 0.0..=1.0_f64, 1 => Just(1.0), 1 => Just(0.0)];
        let dominant = prop_oneof![1_u32..20, 1_u32..3000, 1_u32..=most];
        (dominant, share(), share(), ends(), ends()).prop_map(|(dominant, y, z, starts, ends)| {
            let steps = [dominant, (f64::from(dominant) * y) as u32, (f64::from(dominant) * z) as u32];
            std::array::from_fn(|axis| AxisSteps::with_ends(steps[axis], starts[axis], ends[axis]))
        })
    }

    proptest! {
        #[test]
        fn a_leg_is_what_it_is_made_of(steps in 0_u32..1 << 26, start in -3..=3_i32, end in -3..=3_i32) {
            let axis_steps = AxisSteps::with_ends(steps, start, end);
            prop_assert_eq!((axis_steps.steps(), axis_steps.start(), axis_steps.end()), (steps, start, end));
            prop_assert_eq!(axis_steps.is_on_steps(), start == 0 && end == 0);
            prop_assert_eq!(AxisSteps::with_ends(steps, 0, 0), AxisSteps::on_steps(steps));
        }

        #[test]
        fn the_divisions_are_the_definition(steps_by_axis in steps_by_axis(Measure::MOST_STEPS), way in 0.0..=1.0_f64) {
            let measure = Measure::of(&steps_by_axis);
            prop_assert!(measure.threshold <= 1 << 30);
            for units in [(f64::from(measure.total) * way) as u32, 0, measure.total] {
                for axis_steps in steps_by_axis {
                    let beyond = parts_beyond(measure.total, axis_steps);
                    let (rate, first) = (measure.rate(axis_steps), (measure.threshold / 2).wrapping_sub(beyond));
                    let taken = defined(axis_steps, measure.total, units);
                    let credit = measure.credit(axis_steps);
                    prop_assert_eq!(i128::from(steps_taken(rate, credit, measure.threshold, units)), taken);
                    let (slow, rest) = steps_and_rest(rate, first, measure.threshold, units);
                    prop_assert_eq!(i128::from(slow), taken);
                    prop_assert!(rest < measure.threshold);
                    let whole = i128::from(rate as i32) * i128::from(units) + i128::from(rest) - i128::from(first);
                    prop_assert_eq!(whole, taken * i128::from(measure.threshold));
                    if units == 0 || units == measure.total {
                        prop_assert_eq!(taken, if units == 0 { 0 } else { i128::from(axis_steps.steps()) });
                    }
                }
            }
        }

        /// For a line, which begins and ends on full steps, the threshold is the number of units of the block, not
        /// seven times as much. So the sum in `steps_taken` more often fits 32 bits and needs only a 32-bit division.
        #[test]
        fn a_line_has_the_threshold_of_its_steps(x in 1_u32..1 << 26, y in 0_u32..1 << 26, way in 0.0..=1.0_f64) {
            let steps_by_axis = [x, y].map(AxisSteps::on_steps);
            let measure = Measure::of(&steps_by_axis);
            let total = x.max(y) * UNITS_PER_STEP;
            prop_assert_eq!((measure.total, measure.threshold), (total, total));
            let units = (f64::from(total) * way) as u32;
            for axis_steps in steps_by_axis {
                prop_assert_eq!((measure.rate(axis_steps), measure.credit(axis_steps)), (axis_steps.steps(), total / 2 - 1));
                let (taken, rest) = steps_and_rest(axis_steps.steps(), total / 2, total, units);
                prop_assert_eq!(i128::from(taken), defined(axis_steps, total, units));
                prop_assert!(rest < total);
            }
        }
    }

    #[test]
    fn inverses_of_odd_numbers() {
        for odd in (1..100_000).chain(u32::MAX - 100_000..=u32::MAX).step_by(2).map(|n: u32| n | 1) {
            assert_eq!(odd.wrapping_mul(inverse(odd)), 1, "{odd}");
        }
    }
}
