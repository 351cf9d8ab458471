//! Checks whether all following lines would have the same meaning in two interpreters. If not, names a part of the
//! state that differs. `oxmill resume` uses this to prove that the rest of a job is complete. Also checks whether an
//! interpreter is in a state simple enough to begin a recording that can be replayed.

use super::control_points::ControlPoints;
use super::modal::{FeedMode, Modal, MotionMode, SplineKind};
use super::state::{Interpreter, ProgramPlace};
use super::tools::Measured;
use super::values::in_xy;
use crate::axes::PerAxis;
use crate::units::{Coordinate, Decimal};

impl<const N: usize> Interpreter<N> {
    /// Compares two interpreters part by part. Returns the name of the first part that could give a following line
    /// different meanings in them; `None` if all following lines have the same meaning in both. The words of canned
    /// cycles and curves count only while their mode is in force.
    pub fn differs_from(&self, other: &Self) -> Option<&'static str> {
        let in_cycle = matches!(self.modal.motion, MotionMode::Cycle(_));
        let are_blank = [self, other].into_iter().all(|state| state.computed.is_blank() && !state.is_within_block());
        let parts = [
            (meant(&self.modal) != meant(&other.modal), "the modal state"),
            (self.offsets != other.offsets, "an offset"),
            (self.position != other.position, "the place"),
            (self.spindle_tool != other.spindle_tool || self.measured != other.measured, "the tool in the spindle"),
            (self.tools != other.tools, "the tool table"),
            (self.before_check.is_some() || other.before_check.is_some(), "check mode"),
            (!are_blank, "a parameter or subroutine that the program has set"),
            (!self.saved.is_empty() || !other.saved.is_empty(), "a state that M70 keeps"),
            (self.rotation != other.rotation, "a rotation (G68)"),
            (self.scaling != other.scaling || self.rest != other.rest, "a scaling (G51)"),
            (in_cycle && self.cycle != other.cycle, "the canned cycle in force"),
            (self.next_way() != other.next_way(), "the direction of the curve in front"),
            (self.waiting_points() != other.waiting_points(), "a curve whose control points are being read"),
        ];
        parts.into_iter().find_map(|(differs, part)| differs.then_some(part))
    }

    /// Returns whether the program is at `place` and has no state except the modal state, the stored offsets and the
    /// tool table: no G92, open block, saved state, rotation or scaling. A recording that can be replayed begins only
    /// in such a state.
    pub fn is_plain(&self, place: &PerAxis<Coordinate, N>) -> bool {
        let offsets = [&self.offsets.g92, &self.offsets.g92_kept, &self.offsets.tool_length];
        self.position == *place
            && offsets.into_iter().all(|offset| *offset == PerAxis::all(Coordinate::ZERO))
            && !self.is_within_block()
            && matches!(self.place, ProgramPlace::Program | ProgramPlace::End)
            && self.before_check.is_none()
            && self.saved.is_empty()
            && self.rotation.is_none()
            && self.scaling.is_none()
            && self.measured == Measured::NOTHING
            && self.computed.is_blank()
            && self.modal.tool == self.spindle_tool
    }

    /// Returns the control points of a curve that G5.2 has begun and G5.3 has not ended yet; `None` without such a
    /// curve.
    fn waiting_points(&self) -> Option<&ControlPoints> {
        let waits = self.modal.motion == MotionMode::Spline(SplineKind::Nurbs);
        self.control_points.first().filter(|points| waits && points.begin_at(in_xy(&self.position)))
    }

    /// Returns the direction in which a G5 without I and J would continue the most recent G5: the vector from the
    /// present position to the first control point. `None` if the most recent G5 did not end here.
    fn next_way(&self) -> Option<[Coordinate; 2]> {
        let last = self.tangent.iter().flatten().find(|tangent| tangent.place == in_xy(&self.position));
        last.map(|tangent| tangent.way)
    }
}

/// Returns the modal state without the parts that affect no later line: removes the speed of an earlier F while G93 is
/// active or F is undefined.
fn meant(modal: &Modal) -> Modal {
    let is_speed = modal.feed_mode != FeedMode::InverseTime && modal.feed > Decimal::ZERO;
    let feed_per_second = if is_speed { modal.feed_per_second } else { 0.0 };
    Modal { feed_per_second, feed_in_inches: is_speed && modal.feed_in_inches, ..*modal }
}
