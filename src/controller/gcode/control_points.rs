//! The control points of a G5.2 curve, each with its weight, until G5.3 runs the curve.

use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::units::{Coordinate, WeightedPoint};

/// So many control points may wait, the start among them: each takes 24 bytes.
const MOST: usize = if FULL_IMAGE { 32 } else { 0 };
/// Orders that L may name; the degree is one less.
pub(super) const ORDERS: core::ops::RangeInclusive<u32> = 3..=8;
/// Without L.
pub(super) const ORDER: u8 = 3;

/// What a line adds to the control points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Addition {
    /// Those that there are are forgotten; this is the first one.
    pub start: Option<WeightedPoint>,
    pub point: Option<WeightedPoint>,
    pub order: u8,
}

/// Room for control points.
pub(super) type PointList = heapless::Vec<WeightedPoint, MOST>;

/// The control points, in X and Y of the machine. The first is where the curve begins.
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

    /// Whether they begin at a place.
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

    /// Adds what there is room for.
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
