//! Rational B-splines (NURBS), whose control points have a line each. G5.2 starts or continues a curve; G5.3 ends the
//! curve and moves along it. The interpreter collects the points until then. It is an error if G5.3 or a point comes
//! without a G5.2, if another motion comes before G5.3, or if there are too few or too many points.

use super::draft::Draft;
use crate::axes::{Axis, AxisMask};
use crate::error::Error;
use crate::gcode::action::{Keeping, MotionCommand, NurbsMove};
use crate::gcode::control_points::{Addition, ControlPoints, ORDER, ORDERS};
use crate::gcode::modal::{MotionMode, Plane, SplineKind};
use crate::gcode::values::{in_xy, reachable, whole};
use crate::gcode::word::Claim;
use crate::image::FULL_IMAGE;
use crate::units::{Decimal, WeightedPoint};

/// Motion mode of the lines between G5.2 and G5.3.
const POINTS: MotionMode = MotionMode::Spline(SplineKind::Nurbs);

impl<const N: usize> Draft<'_, N> {
    /// Returns whether a curve is open: G5.2 has started it and is still the motion mode, and the tool is still at the
    /// start of the curve.
    fn has_control_points(&self) -> bool {
        let here = in_xy(&self.state.position);
        self.state.modal.motion == POINTS && self.state.control_points.iter().any(|points| points.begin_at(here))
    }

    /// While a curve is open, refuses every motion mode except G5.2, which continues the curve, and G80, which drops
    /// it.
    pub(super) fn leaves_control_points(&self, mode: MotionMode) -> Result<(), Error> {
        let leaves = !matches!(mode, POINTS | MotionMode::Cancelled);
        if leaves && self.has_control_points() { Err(Error::ControlPointsNotEnded) } else { Ok(()) }
    }

    /// Checks G5.2, or a later line while G5.2 is in force. X and Y give a control point, P its weight, L the order of
    /// the curve. The first line may have no X and Y. Then it has no control point, and P is the weight of the start.
    #[inline(never)]
    pub(super) fn control_point(&mut self) -> Result<(), Error> {
        let begins = !self.has_control_points();
        if begins && self.line.modal.motion != Some(POINTS) {
            return Err(Error::ControlPointsNotBegun);
        }
        let is_in_plane = !Axis::of_machine::<N>().skip(2).any(|axis| self.line.axes.has(axis));
        if !is_in_plane || self.action.modal.plane != Plane::Xy {
            return Err(Error::SplineOutsideXy);
        }
        self.needs_plane(Plane::Xy.axes())?;
        let has_point = !self.line.axes.is_empty();
        if has_point && self.line.axes != AxisMask::NONE.with(Axis::X).with(Axis::Y) {
            return Err(Error::ValueWordMissing);
        }
        let order = self.order(begins)?;
        let weight = match self.take(b'P') {
            true if self.line.value(b'P') <= Decimal::ZERO => return Err(Error::ValueOutOfRange),
            true => self.line.value(b'P').to_f32(),
            false if has_point => return Err(Error::ValueWordMissing),
            false => 1.0,
        };
        if has_point && !begins && self.state.control_points.iter().all(ControlPoints::is_full) {
            return Err(Error::TooManyControlPoints);
        }
        let start = in_xy(&self.state.position);
        let target = self.target();
        reachable(&target)?;
        // The tool does not move. `None` keeps the coordinates that the program wrote for the present position.
        self.action.rotated.reached = None;
        self.action.rotated.scaled.rest = None;
        let weight_of_start = if has_point { 1.0 } else { weight };
        self.action.after.keeping = Keeping::Add(
            [Addition {
                start: begins.then_some(WeightedPoint { place: start, weight: weight_of_start }),
                point: has_point.then_some(WeightedPoint { place: in_xy(&target), weight }),
                order,
            }; FULL_IMAGE as usize],
        );
        Ok(())
    }

    /// Reads L. Without L, an open curve keeps its order, and a new curve has the order 3.
    fn order(&mut self, begins: bool) -> Result<u8, Error> {
        if !self.take(b'L') {
            return Ok(if begins { ORDER } else { self.order_so_far() });
        }
        let order = whole(self.line.value(b'L'))?;
        match u32::try_from(order) {
            Ok(order) if ORDERS.contains(&order) => Ok(order as u8),
            _ => Err(Error::ValueOutOfRange),
        }
    }

    fn order_so_far(&self) -> u8 {
        self.state.control_points.first().map_or(ORDER, ControlPoints::order)
    }

    /// Checks G5.3: a move along the curve of the control points. The motion mode becomes G80.
    #[inline(never)]
    pub(super) fn nurbs(&mut self) -> Result<(), Error> {
        self.action.modal.motion = MotionMode::Cancelled;
        if self.claim == Claim::Motion {
            return Err(Error::AxisWordsUnused);
        }
        if !self.has_control_points() {
            return Err(Error::ControlPointsNotBegun);
        }
        let (points, order) = (self.state.control_points(), self.order_so_far());
        if points.len() < usize::from(order) {
            return Err(Error::TooFewControlPoints);
        }
        if self.action.modal.feed == Decimal::ZERO {
            return Err(Error::UndefinedFeed);
        }
        let start = self.state.position;
        let mut target = start;
        for (axis, part) in [Axis::X, Axis::Y].into_iter().zip(points.last().map_or(in_xy(&start), |last| last.place)) {
            target.set(axis, part);
        }
        self.action.motion = MotionCommand::Nurbs(NurbsMove { start, target, order, feed: self.feed_of_motion() });
        self.action.position = target;
        Ok(())
    }
}
