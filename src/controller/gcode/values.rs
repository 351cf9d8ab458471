//! Small conversions of word values: whole numbers, seconds, and coordinates within the range that the controller
//! computes with.

use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal, Duration};

/// A number that selects something, which has no fraction.
pub(super) fn whole(value: Decimal) -> Result<i32, Error> {
    let number = value.truncate();
    if Decimal::from_int(number) == value { Ok(number) } else { Err(Error::IntegerRequired) }
}

/// A time that a program gives in seconds.
pub(super) fn seconds(value: Decimal) -> Duration {
    /// Units of a [`Decimal`] of seconds in a microsecond.
    const MICROSECOND: u64 = DECIMAL_ONE as u64 / 1_000_000;
    Duration::micros((value.0.unsigned_abs() + MICROSECOND / 2) / MICROSECOND)
}

pub(super) fn along<const N: usize>(place: &PerAxis<Coordinate, N>, axis: Axis) -> Coordinate {
    place.get(axis).unwrap_or(Coordinate::ZERO)
}

/// A coordinate of so many units, or the greatest that there is.
pub(super) fn nearest(units: i128) -> Coordinate {
    Coordinate(units.clamp(i64::MIN.into(), i64::MAX.into()) as i64)
}

/// The coordinates of a place in the plane of X and Y.
pub(super) fn in_xy<const N: usize>(place: &PerAxis<Coordinate, N>) -> [Coordinate; 2] {
    [along(place, Axis::X), along(place, Axis::Y)]
}

/// An error unless the controller may compute with the place.
pub(super) fn reachable<const N: usize>(place: &PerAxis<Coordinate, N>) -> Result<(), Error> {
    if place.iter().all(|coordinate| coordinate.in_range()) { Ok(()) } else { Err(Error::InvalidTarget) }
}
