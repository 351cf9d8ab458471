//! Converts between positions of the tool and steps of the motors, for Cartesian and CoreXY machines.
//!
//! ```text
//!  Cartesian   each motor moves one axis
//!  CoreXY      the first two motors pull one belt:  A = X + Y,  B = X - Y;   X = (A + B) / 2,  Y = (A - B) / 2
//! ```
//! With linear kinematics, a straight block is also straight in motor steps. So the rest of the motion code is
//! independent of the kinematics; its lengths, speeds and limits are those of the axes. Guarantee: converting steps to
//! a position and back gives the same steps.

use crate::axes::{Arrangement, PerAxis};
use crate::units::{Coordinate, StepsPerMm};

/// The arrangement of the motors, and the steps per millimetre of each.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Kinematics<const N: usize> {
    arrangement: Arrangement,
    steps_per_mm: PerAxis<StepsPerMm, N>,
    /// For each motor, the minimum distance that the tool moves with one of its steps, mm.
    pub least_mm: [f32; N],
}

impl<const N: usize> Kinematics<N> {
    /// Placeholder until the settings are applied: one step per millimetre on each axis.
    pub(super) const ONE: Self =
        Self { arrangement: Arrangement::Cartesian, steps_per_mm: PerAxis::all(StepsPerMm::ONE), least_mm: [1.0; N] };

    pub(super) fn new(arrangement: Arrangement, steps_per_mm: PerAxis<StepsPerMm, N>) -> Self {
        let mut least_mm = steps_per_mm.0.map(|scale| 1.0 / scale.to_f32());
        if arrangement == Arrangement::CoreXy {
            // When the tool moves along a diagonal, only one motor turns. Its belt moves √2 times as far as the tool.
            for mm in least_mm.iter_mut().take(2) {
                *mm *= core::f32::consts::FRAC_1_SQRT_2;
            }
        }
        Self { arrangement, steps_per_mm, least_mm }
    }

    /// Returns the steps nearest to a position.
    #[inline]
    pub(super) fn steps(&self, place: &PerAxis<Coordinate, N>) -> PerAxis<i32, N> {
        let mut turned = PerAxis::all(Coordinate::ZERO);
        self.steps_per_mm.zip(self.of_motors(place, &mut turned), |scale, coordinate| scale.steps(coordinate))
    }

    /// Like [`Kinematics::steps`], but converts only the axes that have moved since an earlier position; with CoreXY,
    /// converts all axes. `before`: the earlier position; `steps`: the steps of that position.
    #[inline]
    pub(super) fn steps_from(
        &self,
        before: &PerAxis<Coordinate, N>,
        steps: &PerAxis<i32, N>,
        place: &PerAxis<Coordinate, N>,
    ) -> PerAxis<i32, N> {
        if self.arrangement == Arrangement::CoreXy {
            return self.steps(place);
        }
        let mut steps = *steps;
        let places = place.iter().zip(before.iter());
        for (steps, (scale, (to, from))) in steps.iter_mut().zip(self.steps_per_mm.iter().zip(places)) {
            if to != from {
                *steps = scale.steps(*to);
            }
        }
        debug_assert_eq!(steps, self.steps(place));
        steps
    }

    /// Returns the offset of a position from the steps nearest to it, in sevenths of a step.
    #[inline(never)]
    pub(super) fn sevenths_beyond(&self, place: &PerAxis<Coordinate, N>, steps: &PerAxis<i32, N>) -> [i32; N] {
        let mut turned = PerAxis::all(Coordinate::ZERO);
        let place = self.of_motors(place, &mut turned);
        let mut beyond = steps.0;
        for (value, (scale, coordinate)) in beyond.iter_mut().zip(self.steps_per_mm.iter().zip(place.iter())) {
            *value = scale.sevenths_beyond(*coordinate, *value);
        }
        beyond
    }

    /// Returns the position of each motor's belt or screw for a position of the tool. `turned`: memory for the result
    /// with CoreXY. Without CoreXY, the result is `place` itself.
    #[inline]
    fn of_motors<'a>(
        &self,
        place: &'a PerAxis<Coordinate, N>,
        turned: &'a mut PerAxis<Coordinate, N>,
    ) -> &'a PerAxis<Coordinate, N> {
        match (self.arrangement, place.0.as_slice()) {
            (Arrangement::CoreXy, [x, y, ..]) => {
                *turned = with_first_two(place, (*x + *y).limited(), (*x - *y).limited());
                turned
            }
            _ => place,
        }
    }

    /// Returns the displacements of the axes (mm) for displacements of the motors (steps).
    pub(super) fn way_of_axes(&self, steps: &[i32; N]) -> [f32; N] {
        let mut way = [0.0; N];
        for ((mm, steps), scale) in way.iter_mut().zip(steps).zip(self.steps_per_mm.iter()) {
            *mm = *steps as f32 / scale.to_f32();
        }
        if let (Arrangement::CoreXy, [a, b, ..]) = (self.arrangement, way.as_mut_slice()) {
            (*a, *b) = (0.5 * (*a + *b), 0.5 * (*a - *b));
        }
        way
    }

    /// Returns the displacements of the motors' belts or screws (mm) for displacements of the tool (mm).
    pub(super) fn way_of_motors(&self, way: &[f32; N]) -> [f32; N] {
        let mut motors = *way;
        if let (Arrangement::CoreXy, [x, y, ..]) = (self.arrangement, motors.as_mut_slice()) {
            (*x, *y) = (*x + *y, *x - *y);
        }
        motors
    }

    /// Returns the displacement of each motor's belt or screw for half a step, mm.
    pub(super) fn half_mm(&self) -> [f32; N] {
        self.steps_per_mm.0.map(|scale| 0.5 / scale.to_f32())
    }

    /// Returns the position of the tool for steps of the motors.
    pub(super) fn place(&self, steps: &PerAxis<i32, N>) -> PerAxis<Coordinate, N> {
        let place = self.steps_per_mm.zip(steps, |scale, count| scale.coordinate(count));
        match (self.arrangement, place.0.as_slice()) {
            (Arrangement::CoreXy, [a, b, ..]) => {
                // If the sum is odd, halving it loses half a unit of 0.1 nm. That is far less than half a step, so
                // `steps` gives the same steps back.
                with_first_two(&place, Coordinate((a.0 + b.0).div_euclid(2)), Coordinate((a.0 - b.0).div_euclid(2)))
            }
            _ => place,
        }
    }
}

fn with_first_two<const N: usize>(
    place: &PerAxis<Coordinate, N>,
    first: Coordinate,
    second: Coordinate,
) -> PerAxis<Coordinate, N> {
    let mut changed = *place;
    if let [a, b, ..] = changed.0.as_mut_slice() {
        (*a, *b) = (first, second);
    }
    changed
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn kinematics(arrangement: Arrangement, spm: [f32; 3]) -> Kinematics<3> {
        Kinematics::new(arrangement, PerAxis(spm.map(|v| StepsPerMm::new(v).unwrap())))
    }

    #[test]
    fn a_belt_moves_both() {
        let core_xy = kinematics(Arrangement::CoreXy, [80.0, 80.0, 400.0]);
        let at = |x, y, z| PerAxis([Coordinate::mm(x), Coordinate::mm(y), Coordinate::mm(z)]);
        assert_eq!(core_xy.steps(&at(10, 0, 1)).0, [800, 800, 400]);
        assert_eq!(core_xy.steps(&at(0, 10, 0)).0, [800, -800, 0]);
        assert_eq!(core_xy.steps(&at(-3, -3, 0)).0, [-480, 0, 0]);
        assert_eq!(core_xy.place(&PerAxis([800, -800, 400])), at(0, 10, 1));
    }

    proptest! {
        #[test]
        fn a_place_of_steps_leads_back(
            a in -20_000_000..20_000_000_i32, b in -20_000_000..20_000_000_i32, z in -20_000_000..20_000_000_i32,
            spm in prop::array::uniform3(40.0_f32..3000.0), core_xy in any::<bool>(),
        ) {
            let arrangement = if core_xy { Arrangement::CoreXy } else { Arrangement::Cartesian };
            let kinematics = kinematics(arrangement, spm);
            let steps = PerAxis([a, b, z].map(|s| s / 64));
            prop_assert_eq!(kinematics.steps(&kinematics.place(&steps)), steps);
        }
    }
}
