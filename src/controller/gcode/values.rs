//! Small conversions of word values: to whole numbers, to durations, and to coordinates within the range in which the
//! controller computes.

use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::units::{Coordinate, DECIMAL_ONE, Decimal, Duration};

/// Converts the value of a word that must be a whole number, such as the number of a tool. Digits after the point are
/// an error.
pub(super) fn whole(value: Decimal) -> Result<i32, Error> {
    let number = value.truncate();
    if Decimal::from_int(number) == value { Ok(number) } else { Err(Error::IntegerRequired) }
}

/// Converts a time in seconds to a duration, rounded to microseconds; ignores the sign.
pub(super) fn seconds(value: Decimal) -> Duration {
    /// A microsecond, in units of a [`Decimal`] that holds seconds.
    const MICROSECOND: u64 = DECIMAL_ONE as u64 / 1_000_000;
    Duration::micros((value.0.unsigned_abs() + MICROSECOND / 2) / MICROSECOND)
}

pub(super) fn along<const N: usize>(place: &PerAxis<Coordinate, N>, axis: Axis) -> Coordinate {
    place.get(axis).unwrap_or(Coordinate::ZERO)
}

/// Converts `units` of 0.1 nm to a coordinate, limited to the range of the type.
pub(super) fn nearest(units: i128) -> Coordinate {
    Coordinate(units.clamp(i64::MIN.into(), i64::MAX.into()) as i64)
}

pub(super) fn in_xy<const N: usize>(place: &PerAxis<Coordinate, N>) -> [Coordinate; 2] {
    [along(place, Axis::X), along(place, Axis::Y)]
}

/// Fails if a coordinate is beyond ±50 m, the range in which the controller computes.
pub(super) fn reachable<const N: usize>(place: &PerAxis<Coordinate, N>) -> Result<(), Error> {
    if place.iter().all(|coordinate| coordinate.in_range()) { Ok(()) } else { Err(Error::InvalidTarget) }
}
