//! From places of the tool to steps of the motors, and back. Cartesian: each motor moves one axis.
//!
//! Another machine (CoreXY) changes these two functions and nothing else: blocks are straight in motor steps for any linear
//! kinematics, while lengths, speeds and limits are those of the axes.

use crate::axes::PerAxis;
use crate::units::{Coordinate, StepsPerMm};

/// The steps nearest to a place.
pub(super) fn steps<const N: usize>(
    steps_per_mm: &PerAxis<StepsPerMm, N>,
    place: &PerAxis<Coordinate, N>,
) -> PerAxis<i32, N> {
    steps_per_mm.zip(place, |scale, coordinate| scale.steps(coordinate))
}

/// The place that steps stand for.
pub(super) fn place<const N: usize>(
    steps_per_mm: &PerAxis<StepsPerMm, N>,
    steps: &PerAxis<i32, N>,
) -> PerAxis<Coordinate, N> {
    steps_per_mm.zip(steps, |scale, count| scale.coordinate(count))
}
