//! G5 (cubic, by I, J, P, Q) and G5.1 (quadratic, by I, J) in the plane of X and Y. A G5 without I and J continues the
//! curve before it smoothly.

use super::draft::Draft;
use crate::axes::Axis;
use crate::error::Error;
use crate::gcode::action::{MotionCommand, SplineMove};
use crate::gcode::modal::{MotionMode, Plane, SplineKind};
use crate::gcode::rotation::difference;
use crate::gcode::values::{in_xy, reachable};
use crate::gcode::word::Claim;
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

impl<const N: usize> Draft<'_, N> {
    /// Refuses a negative P, except with G5, where P is a distance.
    pub(super) fn sign_of_p(&self) -> Result<(), Error> {
        let is_distance =
            self.claim == Claim::Motion && self.action.modal.motion == MotionMode::Spline(SplineKind::Cubic);
        if self.line.extended.is_p_negative && !is_distance { Err(Error::NegativeValue) } else { Ok(()) }
    }

    /// Checks G5 and G5.1. For G5, I and J lead from the start to the first control point, P and Q from the end to the
    /// second. For G5.1, I and J lead from the start to the only control point. These words are distances even with
    /// G90.1, as in LinuxCNC.
    #[inline(never)]
    pub(super) fn spline(&mut self, kind: SplineKind) -> Result<(), Error> {
        if !FULL_IMAGE {
            return Err(Error::SplinesLeftOut);
        }
        if self.line.axes.is_empty() {
            return Err(Error::NoAxisWords);
        }
        let aside = Axis::of_machine::<N>().skip(2).any(|axis| self.line.axes.has(axis));
        if aside || self.action.modal.plane != Plane::Xy {
            return Err(Error::SplineOutsideXy);
        }
        self.needs_plane(Plane::Xy.axes())?;
        let start = self.state.position;
        let target = self.target();
        let near_start = self.vector(b"IJ")?;
        let (leaving, arriving) = match (kind, near_start) {
            (SplineKind::Quadratic, None) => return Err(Error::ValueWordMissing),
            (SplineKind::Quadratic, Some(middle)) => {
                let chord = difference(in_xy(&target), in_xy(&start));
                // A quadratic curve equals a cubic curve whose vectors to the control points are two thirds as long.
                (middle.map(two_thirds), difference(middle, chord).map(two_thirds))
            }
            (SplineKind::Cubic | SplineKind::Nurbs, _) => {
                let arriving = self.vector(b"PQ")?.ok_or(Error::ValueWordMissing)?;
                // Without I and J, the curve continues the most recent G5 smoothly, if it starts where that G5 ended.
                let last = self.state.tangent.iter().flatten().find(|tangent| tangent.place == in_xy(&start));
                (near_start.or(last.map(|tangent| tangent.way)).ok_or(Error::ValueWordMissing)?, arriving)
            }
        };
        let feed = self.feed_of_motion();
        let spline = SplineMove { start, target, leaving, arriving, feed };
        for corner in &spline.corners() {
            reachable(corner)?;
        }
        self.action.motion = MotionCommand::Spline(spline);
        self.action.position = target;
        Ok(())
    }

    /// Returns the vector that two words give in X and Y, scaled and rotated to machine axes. `None` if the line has
    /// neither word; an error if it has only one.
    #[inline(never)]
    fn vector(&mut self, letters: &[u8; 2]) -> Result<Option<[Coordinate; 2]>, Error> {
        let [has_first, has_second] = letters.map(|letter| self.take(letter));
        if has_first != has_second {
            return Err(Error::ValueWordMissing);
        }
        let way = self.scaled_vector([Axis::X, Axis::Y], letters.map(|letter| self.length(self.line.value(letter))));
        Ok(has_first.then(|| match self.rotated {
            Some(rotated) if FULL_IMAGE => rotated.angle.turn(way),
            _ => way,
        }))
    }
}

fn two_thirds(way: Coordinate) -> Coordinate {
    Coordinate(way.0.saturating_mul(2).saturating_add(way.0.signum()) / 3)
}
