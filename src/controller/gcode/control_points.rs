//! The control points of a G5.2 curve, each with its weight. Lines with G5.2 add them one by one, then G5.3 moves along
//! the curve.

use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::units::{Coordinate, WeightedPoint};

/// Maximum number of control points of a curve, including the start; each takes 24 bytes.
const MOST: usize = if FULL_IMAGE { 32 } else { 0 };
/// Orders that L can select. The degree of the curve is one less.
pub(super) const ORDERS: core::ops::RangeInclusive<u32> = 3..=8;
/// Order of a curve without L.
pub(super) const ORDER: u8 = 3;

/// The change that a line makes to the control points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Addition {
    /// Start point of a new curve; `None` if the line continues a curve. A start point replaces all earlier control
    /// points.
    pub start: Option<WeightedPoint>,
    pub point: Option<WeightedPoint>,
    pub order: u8,
}

/// Memory for the control points of a curve, at most `MOST`.
pub(super) type PointList = heapless::Vec<WeightedPoint, MOST>;

/// The control points, in X and Y of the machine, with the order of the curve. The first point is the start of the
/// curve.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct ControlPoints {
    points: Lent<PointList>,
    order: u8,
}

impl ControlPoints {
    pub fn new(points: Lent<PointList>) -> Self {
        Self { points, order: ORDER }
    }

    /// Returns whether the curve starts at `place`, in X and Y of the machine; `false` without control points.
    pub fn begin_at(&self, place: [Coordinate; 2]) -> bool {
        self.points.first().is_some_and(|first| first.place == place)
    }

    pub fn is_full(&self) -> bool {
        self.points.is_full()
    }

    pub fn all(&self) -> &[WeightedPoint] {
        &self.points
    }

    pub fn order(&self) -> u8 {
        self.order
    }

    /// Adds the points of a line with G5.2; a start point replaces all earlier points. Points beyond the capacity are
    /// dropped; the check refuses a line that would add them.
    pub fn add(&mut self, addition: &Addition) {
        if let Some(start) = addition.start {
            self.points.clear();
            let _ = self.points.push(start);
        }
        if let Some(point) = addition.point {
            let _ = self.points.push(point);
        }
        self.order = addition.order;
    }
}
