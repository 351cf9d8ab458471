//! How far the axes of a block have come: the arithmetic of steps, shared by the step generator, which counts down to the
//! next step, and by the planner's side, which needs to know where a segment ends.
//!
//! See `stepper` for the formula. All of it is in whole numbers and exact; nothing here keeps a state.

use crate::messages::{Leg, UNITS_PER_STEP};

/// What the axes of a block are measured by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Measure {
    /// Units of the whole block: 16 for each step of the dominant axis.
    pub total: u32,
    /// What a step is worth.
    pub threshold: u32,
    /// Threshold / total: in how many parts a step is divided.
    scale: u32,
}

impl Measure {
    pub(super) const MOST_STEPS: u32 = (1 << 30) / (UNITS_PER_STEP * Leg::PARTS);

    #[inline(always)]
    pub(super) fn of<const N: usize>(legs: &[Leg; N]) -> Self {
        let (mut dominant, mut on_steps) = (0, true);
        for leg in legs {
            dominant = leg.steps().max(dominant);
            on_steps &= leg.is_on_steps();
        }
        let total = dominant.wrapping_mul(UNITS_PER_STEP);
        let scale = if on_steps { 1 } else { Leg::PARTS };
        Self { total, threshold: total.wrapping_mul(scale), scale }
    }

    /// What a unit of the block takes off what is left until the next step of an axis. Below 0 (as a wrapped number) by
    /// less than a step in the whole block, for an axis without steps that turns back.
    #[inline(always)]
    pub(super) fn rate(&self, leg: Leg) -> u32 {
        leg.steps().wrapping_mul(self.scale).wrapping_add_signed(leg.end().wrapping_sub(leg.start()))
    }

    /// What an axis has of its first step at the start, less 1: half a step, and what its true start is beyond the rounded one.
    #[inline(always)]
    pub(super) fn credit(&self, leg: Leg) -> u32 {
        (self.threshold / 2).wrapping_add(parts_beyond(self.total, leg)).wrapping_sub(1)
    }
}

/// Steps that an axis has taken after `units` of a block, from its rate and credit ([`Measure`]).
///
/// What it began with and what the units have added, less a threshold for each step taken, stay below the threshold; so the
/// quotient is exact.
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

/// How far the true start of an axis is beyond the rounded one, in parts of the threshold; below 0 as a wrapped number.
#[inline(always)]
pub(super) fn parts_beyond(total: u32, leg: Leg) -> u32 {
    (leg.start() as u32).wrapping_mul(total)
}

/// `rate` × `units`, of which the first may be below 0 and both are less than 2^31.
#[inline]
pub(super) fn advance(rate: u32, units: u32) -> u64 {
    (i64::from(rate as i32) * i64::from(units as i32)) as u64
}

/// [`steps_taken`] and what is left until the next step, one bit of the quotient after the other: the step task has no room for
/// a division of 64 bits, and needs this at rest only.
pub(super) fn steps_and_rest(rate: u32, first: u32, threshold: u32, units: u32) -> (u32, u32) {
    let mut sum = advance(rate, units).wrapping_add(u64::from(threshold.wrapping_sub(first)));
    let mut taken = 0;
    for bit in (0..Leg::STEP_BITS).rev() {
        let part = u64::from(threshold) << bit;
        if sum > part {
            sum -= part;
            taken |= 1 << bit;
        }
    }
    (taken, threshold.wrapping_sub(sum as u32))
}

/// The number whose product with an odd number ends in 1, modulo 2^32: each step of Newton's method doubles the number of
/// right bits, 5 at first.
#[inline]
pub(super) fn inverse(odd: u32) -> u32 {
    let mut inverse = odd.wrapping_mul(3) ^ 2;
    for _ in 0..3 {
        inverse = inverse.wrapping_mul(2_u32.wrapping_sub(odd.wrapping_mul(inverse)));
    }
    inverse
}

/// `value` plus or minus `steps`.
#[inline]
pub(super) fn signed_add(value: i32, steps: u32, negative: bool) -> i32 {
    if negative { value.wrapping_sub_unsigned(steps) } else { value.wrapping_add_unsigned(steps) }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A whole number or a fraction, exactly.
    #[derive(Clone, Copy)]
    struct Ratio(i128, i128);

    /// Steps taken by the definition: with n steps between f and g sevenths, the true way after u of M units is
    /// f/7 + (n + (g - f)/7)·u/M, and the step nearest to it has been taken, that before if two are.
    pub fn defined(leg: Leg, total: u32, units: u32) -> i128 {
        let (n, f, g) = (i128::from(leg.steps()), i128::from(leg.start()), i128::from(leg.end()));
        let (u, m) = (i128::from(units), i128::from(total));
        let Ratio(above, below) = Ratio(f * m + (7 * n + g - f) * u, 7 * m);
        // The least whole number that is not below the way less a half.
        -(below - 2 * above).div_euclid(2 * below)
    }

    /// Three legs, of which one may have as many steps as the dominant axis, and one none.
    pub fn legs(most: u32) -> impl Strategy<Value = [Leg; 3]> {
        let ends = || prop_oneof![1 => Just([0; 3]), 3 => prop::array::uniform3(-3..=3)];
        let share = || prop_oneof![3 => 0.0..=1.0_f64, 1 => Just(1.0), 1 => Just(0.0)];
        let dominant = prop_oneof![1_u32..20, 1_u32..3000, 1_u32..=most];
        (dominant, share(), share(), ends(), ends()).prop_map(|(dominant, y, z, starts, ends)| {
            let steps = [dominant, (f64::from(dominant) * y) as u32, (f64::from(dominant) * z) as u32];
            std::array::from_fn(|axis| Leg::with_ends(steps[axis], starts[axis], ends[axis]))
        })
    }

    proptest! {
        #[test]
        fn a_leg_is_what_it_is_made_of(steps in 0_u32..1 << 26, start in -3..=3_i32, end in -3..=3_i32) {
            let leg = Leg::with_ends(steps, start, end);
            prop_assert_eq!((leg.steps(), leg.start(), leg.end()), (steps, start, end));
            prop_assert_eq!(leg.is_on_steps(), start == 0 && end == 0);
            prop_assert_eq!(Leg::with_ends(steps, 0, 0), Leg::on_steps(steps));
        }

        #[test]
        fn the_divisions_are_the_definition(legs in legs(Measure::MOST_STEPS), way in 0.0..=1.0_f64) {
            let measure = Measure::of(&legs);
            prop_assert!(measure.threshold <= 1 << 30);
            for units in [(f64::from(measure.total) * way) as u32, 0, measure.total] {
                for leg in legs {
                    let beyond = parts_beyond(measure.total, leg);
                    let (rate, first) = (measure.rate(leg), (measure.threshold / 2).wrapping_sub(beyond));
                    let taken = defined(leg, measure.total, units);
                    let credit = measure.credit(leg);
                    prop_assert_eq!(i128::from(steps_taken(rate, credit, measure.threshold, units)), taken);
                    let (slow, rest) = steps_and_rest(rate, first, measure.threshold, units);
                    prop_assert_eq!(i128::from(slow), taken);
                    prop_assert!(rest < measure.threshold);
                    let whole = i128::from(rate as i32) * i128::from(units) + i128::from(rest) - i128::from(first);
                    prop_assert_eq!(whole, taken * i128::from(measure.threshold));
                    if units == 0 || units == measure.total {
                        prop_assert_eq!(taken, if units == 0 { 0 } else { i128::from(leg.steps()) });
                    }
                }
            }
        }

        /// Lines continue with a division that fits 32 bits where it did.
        #[test]
        fn a_line_has_the_threshold_of_its_steps(x in 1_u32..1 << 26, y in 0_u32..1 << 26, way in 0.0..=1.0_f64) {
            let legs = [x, y].map(Leg::on_steps);
            let measure = Measure::of(&legs);
            let total = x.max(y) * UNITS_PER_STEP;
            prop_assert_eq!((measure.total, measure.threshold), (total, total));
            let units = (f64::from(total) * way) as u32;
            for leg in legs {
                prop_assert_eq!((measure.rate(leg), measure.credit(leg)), (leg.steps(), total / 2 - 1));
                let (taken, rest) = steps_and_rest(leg.steps(), total / 2, total, units);
                prop_assert_eq!(i128::from(taken), defined(leg, total, units));
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
