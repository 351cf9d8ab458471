//! Scaled coordinates: G51 multiplies the X, Y and Z values of a program by factors, relative to a centre. Rotation
//! (`rotation`) and offsets are applied to the result.
//!
//! ```text
//!                       scaled = centre + factor · (written - centre)         a distance: factor · written
//! ```
//! Coordinates are in units of 0.1 nm, factors in units of 10^-7. So the product of a coordinate and a factor is an
//! exact integer in units of 10^-8 nm. When a position is rounded to 0.1 nm, the remainder is stored and added to the
//! next distance, so that roundings do not add up in G91.

use super::values::nearest;
use crate::axes::{Axis, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal};

/// Number of scaled axes: X, Y and Z. In a build without scaling it is 0, so that the types below take no memory.
const AXES: usize = if FULL_IMAGE { 3 } else { 0 };

/// Scaling by G51.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Scaling {
    /// No factor is 0.
    factors: [Decimal; AXES],
    centre: [Coordinate; AXES],
}

/// Remainder from rounding a position to 0.1 nm, for each axis, in units of 10^-8 nm.
pub(super) type Rest = [i32; AXES];
/// The remainders of an exact position.
pub(super) const NO_REST: Rest = [0; AXES];

/// A length in units of 10^-8 nm.
type Fine = i128;

fn fine(coordinate: Coordinate) -> Fine {
    i128::from(coordinate.0) * i128::from(DECIMAL_ONE)
}

/// Returns `numerator / denominator`, rounded to the nearest integer.
// Not inlined, so that the long code of the division is in the image only once.
#[inline(never)]
fn divided(numerator: Fine, denominator: i64) -> Coordinate {
    let denominator = i128::from(denominator);
    let half = denominator.abs() / 2;
    nearest((numerator * denominator.signum() + half).div_euclid(denominator.abs()))
}

/// Rounds a length to a coordinate. Also returns the remainder.
#[inline(never)]
fn rounded(length: Fine) -> (Coordinate, i32) {
    let coordinate = divided(length, DECIMAL_ONE);
    // The remainder is at most 0.05 nm (5,000,000 units). It is larger only if the coordinate was limited to its type.
    (coordinate, i32::try_from(length - fine(coordinate)).unwrap_or(0))
}

impl Scaling {
    pub(super) fn new(factors: [Decimal; 3], centre: [Coordinate; 3]) -> Self {
        Self {
            factors: core::array::from_fn(|axis| factors.get(axis).copied().unwrap_or(Decimal::ZERO)),
            centre: core::array::from_fn(|axis| centre.get(axis).copied().unwrap_or(Coordinate::ZERO)),
        }
    }

    /// Returns the factor of an axis; 1 for rotary axes.
    pub(super) fn factor(&self, axis: Axis) -> Decimal {
        self.factors.get(axis.index()).copied().unwrap_or(Decimal::from_int(1))
    }

    /// Returns whether G51 changes the size along an axis: its factor is not 1.
    pub(super) fn scales(&self, axis: Axis) -> bool {
        self.factor(axis) != Decimal::from_int(1)
    }

    fn centre(&self, axis: Axis) -> Fine {
        fine(self.centre.get(axis.index()).copied().unwrap_or(Coordinate::ZERO))
    }

    /// Scales a coordinate of the program about the centre. Also returns the remainder from rounding.
    #[inline(never)]
    pub(super) fn place(&self, axis: Axis, written: Coordinate) -> (Coordinate, i32) {
        let centre = self.centre(axis);
        // Both operands of the subtraction are multiples of `DECIMAL_ONE`, so the division is exact.
        let from_centre = nearest((fine(written) - centre) / i128::from(DECIMAL_ONE));
        rounded(centre + i128::from(from_centre.0) * i128::from(self.factor(axis).0))
    }

    /// Scales a distance of the program and adds `rest`, the remainder from the previous rounding. Also returns the new
    /// remainder.
    #[inline(never)]
    pub(super) fn way(&self, axis: Axis, written: Coordinate, rest: i32) -> (Coordinate, i32) {
        rounded(i128::from(written.0) * i128::from(self.factor(axis).0) + i128::from(rest))
    }

    /// Scales a length that has no direction, such as a radius, by the absolute value of the factor.
    pub(super) fn size(&self, axis: Axis, written: Coordinate) -> Coordinate {
        let length = i128::from(written.0) * i128::from(self.factor(axis).0.unsigned_abs());
        rounded(length).0
    }

    /// Converts a scaled distance in units of 0.1 nm back to the distance in the program.
    pub(super) fn written_way(&self, axis: Axis, scaled: i64) -> i64 {
        divided(fine(Coordinate(scaled)), self.factor(axis).0).0
    }

    /// Converts a scaled position back to the position in the program. `rest` is the remainder from rounding the scaled
    /// position.
    #[inline(never)]
    pub(super) fn written<const N: usize>(&self, place: &mut PerAxis<Coordinate, N>, rest: &Rest) {
        for (axis, rest) in [Axis::X, Axis::Y, Axis::Z].into_iter().zip(rest) {
            if self.scales(axis)
                && let Some(scaled) = place.get(axis)
            {
                let centre = self.centre(axis);
                let from_centre = divided(fine(scaled) + i128::from(*rest) - centre, self.factor(axis).0);
                place.set(axis, nearest(centre / i128::from(DECIMAL_ONE)) + from_centre);
            }
        }
    }

    /// Returns the smallest factor, without its sign. The check multiplies `Action::digit`, the value of the last
    /// decimal place of the axis words, by this factor.
    #[inline(never)]
    pub(super) fn least(&self) -> f32 {
        self.factors.iter().map(|factor| Decimal(factor.0.saturating_abs()).to_f32()).fold(f32::INFINITY, f32::min)
    }
}

/// Changes that a line makes to the scaling.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct ScalingChange {
    /// The new scaling of G51, or `Some(None)` for G50.
    pub(super) scaling: Option<Option<Scaling>>,
    pub(super) rest: Option<Rest>,
}

impl ScalingChange {
    pub(super) const NONE: ScalingChange = ScalingChange { scaling: None, rest: None };
}

#[cfg(test)]
#[cfg(feature = "full")]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn back_and_forth(
            written in -500_000_000_000_i64..500_000_000_000, centre in -500_000_000_000_i64..500_000_000_000,
            factor in (1_000_i64..1_000_000_000), mirrored: bool,
        ) {
            let factor = if mirrored { -factor } else { factor };
            let scaling = Scaling::new([Decimal(factor); 3], [Coordinate(centre); 3]);
            let (place, rest) = scaling.place(Axis::Y, Coordinate(written));
            let wanted = centre as f64 + (written - centre) as f64 * factor as f64 / 1e7;
            prop_assert!((place.0 as f64 - wanted).abs() < 1.0 + wanted.abs() * 1e-15);
            let mut back = PerAxis([Coordinate::ZERO, place, Coordinate::ZERO]);
            scaling.written(&mut back, &[0, rest, 0]);
            prop_assert_eq!(back.0[1].0, written);
        }

        /// The end position does not depend on how a distance is split into increments.
        #[test]
        fn increments_add_up(ways in prop::collection::vec(-30_000_i64..30_000, 1..50), factor in 1_i64..100_000_000) {
            let scaling = Scaling::new([Decimal(factor); 3], [Coordinate::ZERO; 3]);
            let (mut place, mut rest) = (Coordinate::ZERO, 0);
            for way in &ways {
                let (next, left) = scaling.way(Axis::X, Coordinate(*way), rest);
                (place, rest) = (place + next, left);
            }
            prop_assert_eq!((place, rest), scaling.way(Axis::X, Coordinate(ways.iter().sum()), 0));
        }

        #[test]
        fn any_numbers(written: i64, centre: i64, factor: i64, rest: i32) {
            prop_assume!(factor != 0);
            let scaling = Scaling::new([Decimal(factor); 3], [Coordinate(centre); 3]);
            let _ = (scaling.place(Axis::X, Coordinate(written)), scaling.way(Axis::Z, Coordinate(written), rest));
            let _ = (scaling.size(Axis::X, Coordinate(written)), scaling.written_way(Axis::X, written));
            scaling.written(&mut PerAxis([Coordinate(written); 3]), &[rest; 3]);
        }
    }
}
