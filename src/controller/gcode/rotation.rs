//! Rotated coordinates. G10 L2 R rotates a coordinate system about its origin; G68 rotates the program about a centre.
//! If both act, they are computed as one rotation of the plane, in fixed point.
//!
//! ```text
//!      second │      ╱ second of the program
//!             │     ╱
//!             │    ╱  ⟍ angle, counter-clockwise      machine = zero + R(angle) · program
//!             │  zero ── ⟍
//!             │            ⟍ first of the program
//!             └──────────────── first
//! ```
//! G92 and G52 are along the rotated axes of the system. The origin of the system and the tool length offset are along
//! the machine's axes. Rotations by multiples of 90 degrees are exact, others are rounded to 0.1 nm. The most recent
//! position is stored in program coordinates, so that these roundings do not add up in G91.

use super::modal::{Plane, PlaneAxes};
use super::scaling::ScalingChange;
use super::values::{along, nearest};
use crate::axes::PerAxis;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal};

/// An angle in degrees, in the unit of a [`Decimal`]: greater than -180 and at most 180 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Angle(pub i32);

/// 1 in the fixed-point format of sines and cosines. The product of a sine and a coordinate fits `i128`; shifted right
/// by [`FRACTION`], it fits `i64`.
const ONE: i64 = 1 << FRACTION;
const FRACTION: u32 = 62;

impl Angle {
    /// No rotation.
    pub const ZERO: Angle = Angle(0);
    const HALF_TURN: i64 = 180 * DECIMAL_ONE;

    /// Converts degrees to an angle, modulo 360 degrees.
    pub const fn of(degrees: Decimal) -> Angle {
        let angle = degrees.0.rem_euclid(2 * Self::HALF_TURN);
        Angle((if angle > Self::HALF_TURN { angle - 2 * Self::HALF_TURN } else { angle }) as i32)
    }

    /// Returns the angle in degrees, greater than -180 and at most 180.
    pub const fn degrees(self) -> Decimal {
        Decimal(self.0 as i64)
    }

    pub(super) fn plus(self, other: Angle) -> Angle {
        Angle::of(Decimal(self.degrees().0 + other.degrees().0))
    }

    fn minus(self) -> Angle {
        Angle::of(Decimal(-self.degrees().0))
    }

    /// Returns cosine and sine in units of 2^-62, with an error of a few units. Both are power series of a small angle:
    /// the difference between this angle and the nearest multiple of 90 degrees.
    fn cosine_and_sine(self) -> (i64, i64) {
        const QUARTER: i64 = Angle::HALF_TURN / 2;
        /// One unit of an angle in radians, times 2^96.
        const RADIANS: i128 = 138_279_229_617_906_158_461;
        let quarters = (self.degrees().0 + QUARTER / 2).div_euclid(QUARTER);
        let rest = self.degrees().0 - quarters * QUARTER;
        let x = ((i128::from(rest) * RADIANS) >> (96 - FRACTION)) as i64;
        let square = product(x, x);
        // The cosine is 1 - x²/(1·2) · (1 - x²/(3·4) · ...), the sine is x · (1 - x²/(2·3) · (1 - x²/(4·5) · ...)),
        // with x in radians. x is at most π/4, so after ten factors the next term is below 2^-62.
        let series = |first: i64| {
            (0..10).rev().fold(ONE, |sum, term| {
                let factor = 2 * term + first;
                ONE - product(square, sum) / (factor * (factor + 1))
            })
        };
        let (cosine, sine) = (series(1), product(x, series(2)));
        match quarters.rem_euclid(4) {
            0 => (cosine, sine),
            1 => (-sine, cosine),
            2 => (-cosine, -sine),
            _ => (sine, -cosine),
        }
    }

    /// Rotates a vector by the angle, counter-clockwise if it is positive. Rounds to 0.1 nm.
    pub(super) fn turn(self, [first, second]: [Coordinate; 2]) -> [Coordinate; 2] {
        if self == Angle::ZERO {
            return [first, second];
        }
        let (cosine, sine) = self.cosine_and_sine();
        let sum = |a: Coordinate, b: i64, c: Coordinate, d: i64| {
            let sum = i128::from(a.0) * i128::from(b) + i128::from(c.0) * i128::from(d);
            nearest((sum + i128::from(ONE / 2)) >> FRACTION)
        };
        [sum(first, cosine, second, -sine), sum(first, sine, second, cosine)]
    }
}

fn product(a: i64, b: i64) -> i64 {
    ((i128::from(a) * i128::from(b)) >> FRACTION) as i64
}

/// G68: rotation of the program's coordinates about a point of the active coordinate system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    pub(super) plane: Plane,
    pub(super) angle: Angle,
    pub(super) centre: [Coordinate; 2],
}

/// A rotation of a plane: converts the program's coordinates to machine coordinates and back.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RotatedPlane {
    pub(super) axes: PlaneAxes,
    pub(super) angle: Angle,
    /// The machine position of the program's zero.
    pub(super) zero: [Coordinate; 2],
}

impl RotatedPlane {
    pub(super) fn to_machine(self, program: [Coordinate; 2]) -> [Coordinate; 2] {
        sum(self.angle.turn(program), self.zero)
    }

    pub(super) fn to_program(self, machine: [Coordinate; 2]) -> [Coordinate; 2] {
        self.angle.minus().turn(difference(machine, self.zero))
    }

    /// Returns the two coordinates of a position that lie in the plane.
    pub(super) fn part_of<const N: usize>(self, place: &PerAxis<Coordinate, N>) -> [Coordinate; 2] {
        [along(place, self.axes.first), along(place, self.axes.second)]
    }

    /// Sets the two coordinates of `place` that lie in the plane.
    pub(super) fn put<const N: usize>(self, place: &mut PerAxis<Coordinate, N>, [first, second]: [Coordinate; 2]) {
        place.set(self.axes.first, first);
        place.set(self.axes.second, second);
    }
}

pub(super) fn sum(a: [Coordinate; 2], b: [Coordinate; 2]) -> [Coordinate; 2] {
    let ([a, b], [c, d]) = (a, b);
    [a + c, b + d]
}

pub(super) fn difference(a: [Coordinate; 2], b: [Coordinate; 2]) -> [Coordinate; 2] {
    let ([a, b], [c, d]) = (a, b);
    [a - c, b - d]
}

/// Changes that a line makes to rotation and scaling.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct RotationChange {
    /// G10 L2 R: the new angle of the coordinate system.
    pub(super) angle: Option<Angle>,
    /// The new rotation of G68, or `Some(None)` for G69.
    pub(super) rotation: Option<Option<Rotation>>,
    pub(super) reached: Option<Reached>,
    pub(super) scaled: ScalingChange,
}

impl RotationChange {
    pub(super) const NONE: RotationChange =
        RotationChange { angle: None, rotation: None, reached: None, scaled: ScalingChange::NONE };
}

/// The target of the most recent move in rotated coordinates, as the program gave it and in machine coordinates. The
/// next line in G91 starts from `program`, so that roundings do not add up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reached {
    pub(super) rotated: RotatedPlane,
    pub(super) program: [Coordinate; 2],
    pub(super) machine: [Coordinate; 2],
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn angles() {
        let of = |degrees: i32| Angle::of(Decimal::from_int(degrees)).degrees().truncate();
        assert_eq!([0, 180, 181, 360, -180, -179, 725].map(of), [0, 180, -179, 0, 180, -179, 5]);
        assert_eq!(Angle::of(Decimal(i64::MIN)).minus().plus(Angle::of(Decimal(i64::MIN))), Angle::ZERO);
        let half = Angle::of(Decimal::from_int(180));
        assert_eq!((half.minus(), half.plus(half)), (half, Angle::ZERO));
    }

    #[test]
    fn quarters_are_exact() {
        let vector = [Coordinate(123_456_789), Coordinate(-42)];
        let [x, y] = vector;
        let turned = |degrees| Angle::of(Decimal::from_int(degrees)).turn(vector);
        assert_eq!(turned(90), [Coordinate(42), x]);
        assert_eq!(turned(180), [Coordinate(-x.0), Coordinate(42)]);
        assert_eq!(turned(-90), [y, Coordinate(-x.0)]);
        assert_eq!(turned(360), vector);
    }

    proptest! {
        #[test]
        fn sines_are_those_of_a_desk(units in -1_800_000_000..=1_800_000_000_i32) {
            let (cosine, sine) = Angle::of(Decimal(units.into())).cosine_and_sine();
            let (wanted_sine, wanted_cosine) = (f64::from(units) / 1e7).to_radians().sin_cos();
            prop_assert!((cosine as f64 / ONE as f64 - wanted_cosine).abs() < 1e-15);
            prop_assert!((sine as f64 / ONE as f64 - wanted_sine).abs() < 1e-15);
            // The point (cosine, sine) lies on the unit circle. This test in integers is finer than the precision of
            // `f64`.
            let square = |v: i64| i128::from(v) * i128::from(v);
            prop_assert!((square(cosine) + square(sine) - square(ONE)).abs() < 64 * i128::from(ONE));
        }

        #[test]
        fn back_and_forth(x in -500_000_000_000_i64..500_000_000_000, y in -500_000_000_000_i64..500_000_000_000, a: i32) {
            let angle = Angle::of(Decimal(a.into()));
            let plane = RotatedPlane { axes: Plane::Xy.axes(), angle, zero: [Coordinate(y), Coordinate(x)] };
            let [back_x, back_y] = plane.to_program(plane.to_machine([Coordinate(x), Coordinate(y)]));
            prop_assert!((back_x.0 - x).abs() <= 1 && (back_y.0 - y).abs() <= 1);
        }

        #[test]
        fn any_numbers(x: i64, y: i64, a: i64) {
            Angle::of(Decimal(a)).turn([Coordinate(x), Coordinate(y)]);
        }
    }
}
