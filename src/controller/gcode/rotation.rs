//! Rotated coordinates: G10 L2 R turns a coordinate system about its origin, G68 turns what a program writes about a point.
//!
//! ```text
//!      second │      ╱ second of the program
//!             │     ╱
//!             │    ╱  ⟍ angle, counter-clockwise      machine = zero + R(angle) · program
//!             │  zero ── ⟍
//!             │            ⟍ first of the program
//!             └──────────────── first
//! ```
//! G92 and G52 lie along the axes of the system, and so turn with it; its origin and the tool length offset are the
//! machine's. A turn by a multiple of 90 degrees is exact, any other one to the nearest 0.1 nm. Which place a program has
//! reached is kept as the program wrote it, so that roundings do not add up over a million increments.

use super::Dialect;
use super::modal::{CoordinateSystem, Plane, PlaneAxes, ROTATION};
use super::offsets::Offsets;
use super::state::Interpreter;
use super::values::along;
use crate::axes::PerAxis;
use crate::error::Error;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal};

/// An angle in units of a [`Decimal`] of a degree, above -180 degrees up to 180 degrees.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Angle(pub i32);

/// 1 in the fixed point of sines: products of it fit `i128` with a coordinate, quotients `i64`.
const ONE: i64 = 1 << FRACTION;
const FRACTION: u32 = 62;

impl Angle {
    /// No rotation.
    pub const ZERO: Angle = Angle(0);
    const HALF_TURN: i64 = 180 * DECIMAL_ONE;

    /// The angle of so many degrees.
    pub const fn of(degrees: Decimal) -> Angle {
        let angle = degrees.0.rem_euclid(2 * Self::HALF_TURN);
        Angle((if angle > Self::HALF_TURN { angle - 2 * Self::HALF_TURN } else { angle }) as i32)
    }

    /// In degrees.
    pub const fn degrees(self) -> Decimal {
        Decimal(self.0 as i64)
    }

    fn plus(self, other: Angle) -> Angle {
        Angle::of(Decimal(self.degrees().0 + other.degrees().0))
    }

    fn minus(self) -> Angle {
        Angle::of(Decimal(-self.degrees().0))
    }

    /// Cosine and sine, within a few units of 2^-62: the power series on both sides of the next multiple of 90 degrees.
    fn cosine_and_sine(self) -> (i64, i64) {
        const QUARTER: i64 = Angle::HALF_TURN / 2;
        /// Radians in a unit, times 2^96.
        const RADIANS: i128 = 138_279_229_617_906_158_461;
        let quarters = (self.degrees().0 + QUARTER / 2).div_euclid(QUARTER);
        let rest = self.degrees().0 - quarters * QUARTER;
        let x = ((i128::from(rest) * RADIANS) >> (96 - FRACTION)) as i64;
        let square = product(x, x);
        // 1 - x²/(a·b) · (1 - x²/(c·d) · ...), with terms until they are below 2^-62.
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

    /// A vector turned by the angle.
    pub(super) fn turn(self, [first, second]: [Coordinate; 2]) -> [Coordinate; 2] {
        let (cosine, sine) = self.cosine_and_sine();
        let sum = |a: Coordinate, b: i64, c: Coordinate, d: i64| {
            let sum = i128::from(a.0) * i128::from(b) + i128::from(c.0) * i128::from(d);
            let rounded = (sum + i128::from(ONE / 2)) >> FRACTION;
            Coordinate(rounded.clamp(i64::MIN.into(), i64::MAX.into()) as i64)
        };
        [sum(first, cosine, second, -sine), sum(first, sine, second, cosine)]
    }
}

fn product(a: i64, b: i64) -> i64 {
    ((i128::from(a) * i128::from(b)) >> FRACTION) as i64
}

/// G68: what a program writes is turned about a point of the active coordinate system.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rotation {
    pub(super) plane: Plane,
    pub(super) angle: Angle,
    pub(super) centre: [Coordinate; 2],
}

/// How the coordinates of a program lie in the machine, in the plane in which they are rotated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct RotatedPlane {
    pub(super) axes: PlaneAxes,
    pub(super) angle: Angle,
    /// Where the program's zero is in the machine.
    zero: [Coordinate; 2],
}

impl RotatedPlane {
    pub(super) fn to_machine(self, program: [Coordinate; 2]) -> [Coordinate; 2] {
        sum(self.angle.turn(program), self.zero)
    }

    pub(super) fn to_program(self, machine: [Coordinate; 2]) -> [Coordinate; 2] {
        self.angle.minus().turn(difference(machine, self.zero))
    }

    /// The coordinates of a place in the plane.
    pub(super) fn part_of<const N: usize>(self, place: &PerAxis<Coordinate, N>) -> [Coordinate; 2] {
        [along(place, self.axes.first), along(place, self.axes.second)]
    }

    /// Replaces the coordinates of a place in the plane.
    pub(super) fn put<const N: usize>(self, place: &mut PerAxis<Coordinate, N>, [first, second]: [Coordinate; 2]) {
        place.set(self.axes.first, first);
        place.set(self.axes.second, second);
    }
}

fn sum(a: [Coordinate; 2], b: [Coordinate; 2]) -> [Coordinate; 2] {
    let ([a, b], [c, d]) = (a, b);
    [a + c, b + d]
}

pub(super) fn difference(a: [Coordinate; 2], b: [Coordinate; 2]) -> [Coordinate; 2] {
    let ([a, b], [c, d]) = (a, b);
    [a - c, b - d]
}

/// A place that a program has reached, as it wrote it and as it is in the machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Reached {
    pub(super) rotated: RotatedPlane,
    pub(super) program: [Coordinate; 2],
    pub(super) machine: [Coordinate; 2],
}

impl<const N: usize> Offsets<N> {
    /// How a coordinate system is rotated with a tool and a G68; `None` if it is not. The two rotations have one plane.
    #[inline]
    pub(super) fn rotated_plane(
        &self,
        system: CoordinateSystem,
        tool_length: &PerAxis<Coordinate, N>,
        rotation: Option<&Rotation>,
    ) -> Result<Option<RotatedPlane>, Error> {
        if !ROTATION || rotation.is_none() && self.angle(system) == Angle::ZERO {
            return Ok(None);
        }
        self.rotated(system, tool_length, rotation).map(Some)
    }

    #[inline(never)]
    fn rotated(
        &self,
        system: CoordinateSystem,
        tool_length: &PerAxis<Coordinate, N>,
        rotation: Option<&Rotation>,
    ) -> Result<RotatedPlane, Error> {
        let of_system = self.angle(system);
        let rotation = rotation.copied().unwrap_or(Rotation {
            plane: Plane::Xy,
            angle: Angle::ZERO,
            centre: [Coordinate::ZERO; 2],
        });
        if of_system != Angle::ZERO && rotation.plane != Plane::Xy {
            return Err(Error::NotInRotatedPlane);
        }
        let axes = rotation.plane.axes();
        let mut plane = RotatedPlane { axes, angle: of_system.plus(rotation.angle), zero: [Coordinate::ZERO; 2] };
        let origin = sum(plane.part_of(&self.system(system)), plane.part_of(tool_length));
        let turned = difference(rotation.centre, rotation.angle.turn(rotation.centre));
        plane.zero = sum(origin, of_system.turn(sum(turned, plane.part_of(&self.g92))));
        Ok(plane)
    }

    /// The place of the machine where the coordinates of a system are zero: G92 turns with the system.
    fn zero_of(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        let mut zero = self.total(system);
        if let Ok(Some(rotated)) = self.rotated_plane(system, &self.tool_length, None) {
            rotated.put(&mut zero, rotated.zero);
        }
        zero
    }
}

impl<const N: usize> Interpreter<N> {
    /// What reports take for the offset of the work coordinates: where their zero is in the machine, but for G68. A distance
    /// from there is along the axes of the machine. Rotations do not act in the dialect of Grbl.
    pub fn work_zero(&self, dialect: Dialect) -> PerAxis<Coordinate, N> {
        match dialect {
            Dialect::Grbl => self.work_offset(),
            _ => self.offsets.zero_of(self.modal.coordinate_system),
        }
    }

    /// The rotation by G68.
    pub fn rotation(&self) -> Option<&Rotation> {
        self.rotation.as_ref()
    }

    /// A coordinate system is rotated.
    pub fn set_angle(&mut self, system: CoordinateSystem, angle: Angle) {
        self.offsets.set_angle(system, angle);
    }

    /// The coordinates that a program has for a place of the machine.
    pub fn to_program(&self, place: &PerAxis<Coordinate, N>) -> PerAxis<Coordinate, N> {
        let offsets = &self.offsets;
        let mut program = place.zip(&self.work_offset(), |place, offset| place - offset);
        let rotated = offsets.rotated_plane(self.modal.coordinate_system, &offsets.tool_length, self.rotation.as_ref());
        if let Ok(Some(rotated)) = rotated {
            rotated.put(&mut program, self.in_program(rotated, rotated.part_of(place)));
        }
        program
    }

    /// The same in a rotated plane: as the program wrote it, if it is the place that it has reached.
    pub(super) fn in_program(&self, rotated: RotatedPlane, machine: [Coordinate; 2]) -> [Coordinate; 2] {
        match self.reached {
            Some(reached) if reached.rotated == rotated && reached.machine == machine => reached.program,
            _ => rotated.to_program(machine),
        }
    }
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
            // What f64 cannot tell: they lie on the circle.
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
