//! Geometry of an arc in its plane. Finds the centre of an arc with R, and checks that the ends of an arc with I, J, K
//! are equally far from its centre. The check of a line computes this in integers, in units of 0.1 nm; `motion::arc`
//! divides the arc into chords later.
//!
//! ```text
//!        second                     chord: start to target
//!          │      target            centre: start to centre, half of the chord plus h across it
//!          │     ╱  │
//!          │   ╱    │               radius format: h² = r² - (chord / 2)²
//!          │ ╱  ╲ h │               G2 with R > 0 has its centre to the right of the chord, G3 to the left;
//!        start ── centre ── first   R < 0 swaps the sides and so takes the longer way round
//! ```
//! Lengths stay below 2^42 units (twice [`Coordinate::LIMIT`] in each direction), so their squares leave 40 bits of a
//! `u128` free. A square is shifted into these bits before its root is computed, which gives the root binary places.
//! The error of a root is far below 0.1 nm, except for arcs whose chord is extremely short relative to their radius.

use crate::error::Error;
use crate::units::{Coordinate, DECIMAL_ONE, integer_root};

/// Difference of the radii at start and end that is always allowed: 0.005 mm.
pub(super) const RADIUS_TOLERANCE: Coordinate = Coordinate(DECIMAL_ONE / 200);
/// Limit of the tolerance that grows with the radius: 0.5 mm, reached at a radius of 500 mm.
const RADIUS_TOLERANCE_MAX: i64 = DECIMAL_ONE / 2;
/// The tolerance that grows with the radius is the radius divided by this: 0.1 %.
const RADIUS_TOLERANCE_PART: i64 = 1000;
/// Length by which a chord may exceed twice the radius in all dialects: 0.4 nm, because the conversion from inches
/// rounds each value.
pub(super) const DIAMETER_TOLERANCE: Coordinate = Coordinate(4);

/// A vector in the plane of an arc, in units of 0.1 nm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Vector {
    pub first: i64,
    pub second: i64,
}

impl Vector {
    pub fn new(first: Coordinate, second: Coordinate) -> Vector {
        Vector { first: first.0, second: second.0 }
    }

    /// Returns an error if a part is outside the range of the computations below.
    pub fn checked(self) -> Result<Vector, Error> {
        const MAX: u64 = 2 * Coordinate::LIMIT.0.unsigned_abs();
        if self.first.unsigned_abs() > MAX || self.second.unsigned_abs() > MAX {
            return Err(Error::InvalidTarget);
        }
        Ok(self)
    }

    fn minus(self, other: Vector) -> Vector {
        Vector { first: self.first - other.first, second: self.second - other.second }
    }

    fn square(self) -> u128 {
        square(self.first.unsigned_abs()) + square(self.second.unsigned_abs())
    }

    fn length(self) -> i64 {
        integer_root(self.square()) as i64
    }
}

fn square(value: u64) -> u128 {
    u128::from(value) * u128::from(value)
}

/// Returns the square roots of both values, each multiplied by the same power of two. This factor cancels out when one
/// root is divided by the other. The greater result has about 62 bits.
fn roots(a: u128, b: u128) -> (i128, i128) {
    // The greater square keeps two leading zero bits, so its root stays below 2^63.
    let shift = (a.max(b).leading_zeros().saturating_sub(2)) & !1;
    (integer_root(a << shift) as i128, integer_root(b << shift) as i128)
}

/// Returns `numerator / denominator`, rounded to the nearest integer.
fn divided(numerator: i128, denominator: i128) -> i64 {
    let half = denominator / 2;
    let rounded = if numerator < 0 { numerator - half } else { numerator + half };
    (rounded / denominator) as i64
}

/// Returns the vector from the start to the centre of an arc with R. A negative radius stands for the arc of more than
/// half a turn. If the chord exceeds twice the radius by `tolerance` or less, the arc is a half circle.
pub(super) fn centre_by_radius(
    chord: Vector,
    radius: Coordinate,
    clockwise: bool,
    tolerance: Coordinate,
) -> Result<Vector, Error> {
    let chord = chord.checked()?;
    if chord.square() == 0 {
        return Err(Error::InvalidTarget);
    }
    if !radius.in_range() {
        return Err(Error::InvalidTarget);
    }
    let diameter = 2 * radius.0.unsigned_abs();
    if square(diameter + tolerance.0.unsigned_abs()) < chord.square() || radius == Coordinate::ZERO {
        return Err(Error::ImpossibleRadius);
    }
    // h is the distance of the centre from the chord: 2h / chord = √(4r² - chord²) / √chord²
    let (across, along) = roots(square(diameter).saturating_sub(chord.square()), chord.square());
    let to_the_right = clockwise == (radius.0 > 0);
    let across = if to_the_right { across } else { -across };
    let (x, y) = (i128::from(chord.first), i128::from(chord.second));
    Ok(Vector { first: divided(x * along + y * across, 2 * along), second: divided(y * along - x * across, 2 * along) })
}

/// Returns by how much a chord may exceed twice the radius if the words of the arc are rounded. `digit`: value of
/// their last decimal place, 0.001 mm for `X1.234`. Twice R is off by up to 1 digit. Each end of the chord is off by
/// up to half a digit along each axis, so the chord is off by up to sqrt(2) digits. The sum is 1 + sqrt(2), about 2.4
/// digits.
pub(super) fn rounding_of_diameter(digit: Coordinate) -> Coordinate {
    Coordinate(digit.0 * 12 / 5)
}

/// Returns by how much the radii at start and end may differ if the words of the arc are rounded to `digit`. Start,
/// end and centre are each off by up to half a digit along each axis, which is sqrt(2) / 2 digits. The centre counts
/// twice, because it affects both radii. The sum is 2 sqrt(2), about 2.8 digits.
pub(super) fn rounding_of_radii(digit: Coordinate) -> Coordinate {
    Coordinate(digit.0 * 14 / 5)
}

/// Returns whether the radii at start and end agree: they differ by at most `tolerance`, or by at most the tolerance
/// that grows with the radius.
pub(super) fn radii_agree(chord: Vector, centre: Vector, tolerance: Coordinate) -> Result<bool, Error> {
    let radius = centre.checked()?.length();
    let difference = (chord.checked()?.minus(centre).length() - radius).abs();
    Ok(difference <= tolerance.0
        || (difference <= RADIUS_TOLERANCE_MAX && difference.saturating_mul(RADIUS_TOLERANCE_PART) <= radius))
}

/// Returns the point where the ray from the centre to the programmed end point crosses the circle. The result is
/// relative to the start of the arc.
pub(super) fn ray_crossing(chord: Vector, centre: Vector) -> Result<Vector, Error> {
    let ray = chord.checked()?.minus(centre.checked()?);
    if ray.square() == 0 || centre.square() == 0 {
        return Err(Error::InvalidTarget);
    }
    let (radius, distance) = roots(centre.square(), ray.square());
    Ok(Vector {
        first: centre.first + divided(i128::from(ray.first) * radius, distance),
        second: centre.second + divided(i128::from(ray.second) * radius, distance),
    })
}

/// Returns whether start and centre are the same point. Then the radius is 0, and there is no arc.
pub(super) fn is_point(centre: Vector) -> bool {
    centre.square() == 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn centre_by_radius(chord: Vector, radius: Coordinate, clockwise: bool) -> Result<Vector, Error> {
        super::centre_by_radius(chord, radius, clockwise, DIAMETER_TOLERANCE)
    }

    fn radii_agree(chord: Vector, centre: Vector) -> Result<bool, Error> {
        super::radii_agree(chord, centre, RADIUS_TOLERANCE)
    }

    fn mm(first: f64, second: f64) -> Vector {
        Vector { first: (first * 1e7).round() as i64, second: (second * 1e7).round() as i64 }
    }

    fn radius(mm: f64) -> Coordinate {
        Coordinate((mm * 1e7).round() as i64)
    }

    #[test]
    fn quarter_circles() {
        // G2 from (0,0) to (10,10). With R10 the centre is to the right of the chord, at (10,0). With R-10 it is to
        // the left.
        assert_eq!(centre_by_radius(mm(10.0, 10.0), radius(10.0), true), Ok(mm(10.0, 0.0)));
        assert_eq!(centre_by_radius(mm(10.0, 10.0), radius(-10.0), true), Ok(mm(0.0, 10.0)));
        assert_eq!(centre_by_radius(mm(10.0, 10.0), radius(10.0), false), Ok(mm(0.0, 10.0)));
        assert_eq!(centre_by_radius(mm(10.0, 10.0), radius(-10.0), false), Ok(mm(10.0, 0.0)));
    }

    #[test]
    fn half_circles() {
        assert_eq!(centre_by_radius(mm(5.0, 0.0), radius(2.5), true), Ok(mm(2.5, 0.0)));
        assert_eq!(centre_by_radius(mm(5.0, 0.0), radius(2.4999), true), Err(Error::ImpossibleRadius));
        // Twice R is one unit less than the chord, as after rounding from inches.
        assert_eq!(
            centre_by_radius(Vector { first: 50_000_001, second: 0 }, Coordinate(25_000_000), true),
            Ok(Vector { first: 25_000_001, second: 0 })
        );
    }

    #[test]
    fn impossible_radii() {
        assert_eq!(centre_by_radius(mm(0.0, 0.0), radius(1.0), true), Err(Error::InvalidTarget));
        assert_eq!(centre_by_radius(mm(1.0, 0.0), radius(0.0), true), Err(Error::ImpossibleRadius));
        assert_eq!(centre_by_radius(Vector { first: 1, second: 0 }, radius(0.0), true), Err(Error::ImpossibleRadius));
        assert_eq!(centre_by_radius(mm(1.0, 0.0), Coordinate(i64::MIN), true), Err(Error::InvalidTarget));
        assert_eq!(
            centre_by_radius(Vector { first: i64::MIN, second: 0 }, radius(1.0), true),
            Err(Error::InvalidTarget)
        );
    }

    #[test]
    fn agreement_of_radii() {
        let at = |x: f64, i: f64| radii_agree(mm(x, 0.0), mm(i, 0.0)).unwrap();
        assert!(at(2.004, 1.0) && at(2.005, 1.0) && !at(2.006, 1.0));
        assert!(at(20.008, 10.0) && !at(20.015, 10.0));
        assert!(at(2000.4, 1000.0) && !at(2001.5, 1000.0) && !at(200.5, 100.0));
        assert!(at(0.0, 0.0) && !at(1.0, 0.0));
    }

    /// `G02 X-30 Y-40 I-10 J-15`: the radius is 18.0278 mm, and the programmed end is 32.0156 mm from the centre.
    #[test]
    fn ray_of_the_document() {
        let crossing = ray_crossing(mm(-30.0, -40.0), mm(-10.0, -15.0)).unwrap();
        let part = (325.0_f64 / 1025.0).sqrt();
        assert_eq!(crossing, mm(-10.0 - 20.0 * part, -15.0 - 25.0 * part));
        // `G3 X-10 Y0 I1 J0` from X-2: the centre is X-1, and the ray to X-10 crosses the circle at the start.
        assert_eq!(ray_crossing(mm(-8.0, 0.0), mm(1.0, 0.0)), Ok(mm(0.0, 0.0)));
        assert_eq!(ray_crossing(mm(1.0, 0.0), mm(1.0, 0.0)), Err(Error::InvalidTarget));
        assert_eq!(ray_crossing(mm(1.0, 0.0), mm(0.0, 0.0)), Err(Error::InvalidTarget));
    }

    proptest! {
        /// Start and target lie on the circle within a nanometre, for radii up to a metre and chords from a micrometre.
        #[test]
        fn centre_is_as_far_from_both_ends(
            r in 100_000_i64..10_000_000_000,
            part in 0.0001..1.0_f64,
            angle in 0.0..std::f64::consts::TAU,
            clockwise: bool,
            long: bool,
        ) {
            let length = (2.0 * r as f64 * part).max(10_000.0);
            let chord = Vector { first: (length * angle.cos()) as i64, second: (length * angle.sin()) as i64 };
            let centre = centre_by_radius(chord, Coordinate(if long { -r } else { r }), clockwise).unwrap();
            prop_assert!((centre.length() - r).abs() <= 10, "start {} of {r}", centre.length());
            let end = chord.minus(centre).length();
            prop_assert!((end - r).abs() <= 10, "end {end} of {r}");
            // The cross product of chord and centre is negative if the centre is to the right of the chord.
            let cross = i128::from(chord.first) * i128::from(centre.second)
                - i128::from(chord.second) * i128::from(centre.first);
            prop_assert!(cross == 0 || (cross < 0) == (clockwise != long) || cross.unsigned_abs() < 4 * length as u128);
        }

        #[test]
        fn ray_ends_on_the_circle(
            x in -1_000_000_000_000_i64..1_000_000_000_000, y in -1_000_000_000_000_i64..1_000_000_000_000,
            i in -1_000_000_000_000_i64..1_000_000_000_000, j in -1_000_000_000_000_i64..1_000_000_000_000,
        ) {
            let (chord, centre) = (Vector { first: x, second: y }, Vector { first: i, second: j });
            if let Ok(crossing) = ray_crossing(chord, centre) {
                prop_assert!((crossing.minus(centre).length() - centre.length()).abs() <= 2);
            }
        }

        #[test]
        fn any_numbers(x: i64, y: i64, i: i64, j: i64, r: i64, clockwise: bool) {
            let (chord, centre) = (Vector { first: x, second: y }, Vector { first: i, second: j });
            let _ = centre_by_radius(chord, Coordinate(r), clockwise);
            let _ = radii_agree(chord, centre);
            let _ = ray_crossing(chord, centre);
        }
    }
}
