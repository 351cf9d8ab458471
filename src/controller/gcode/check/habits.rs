//! Words that CAM programs write for other controls. Some have the same meaning here (G54.1 P, G154 P, U V W of G28).
//! Others have no effect. For M29 and for words that switch the look-ahead, the host gets a message once per program.

use super::draft::{CENTRE, Draft};
use crate::axes::PerAxis;
use crate::error::Error;
use crate::gcode::action::Notice;
use crate::gcode::modal::{CoordinateSystem, Distance, MotionMode, SplineKind};
use crate::gcode::values::whole;
use crate::gcode::word::{Group, Groups, Letters};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, Decimal};

/// Number of coordinate systems before G59.1 (G54 to G59). G54.1 P1 selects the one after them: G59.1.
const BEFORE_THE_FIRST: usize = CoordinateSystem::OF_GRBL;

impl<const N: usize> Draft<'_, N> {
    /// Executes words of other controls. G54.1 and G154 select a coordinate system by its number. G8 P, G103, G187 and
    /// M29 only send a message to the host.
    pub(super) fn habits(&mut self) -> Result<(), Error> {
        let extended = &self.line.extended;
        if !FULL_IMAGE {
            return Ok(());
        }
        if extended.system_by_number {
            self.action.modal.coordinate_system = self.system_by_number()?;
            if self.action.modal.coordinate_system == CoordinateSystem::G59_3 {
                self.action.after.notice = Some(Notice::SystemOfSetter);
            }
        }
        if let Some(number) = extended.look_ahead {
            // G8 without P is a word of lathes (radius programming), which is not supported.
            if !self.take(b'P') && number == 8 {
                return Err(Error::NotSupported);
            }
            self.unused.remove(Letters::of(b"EQ"));
            self.action.after.notice = Some(Notice::LookAhead);
        }
        if extended.rigid_tapping {
            self.action.after.notice = Some(Notice::RigidTapping);
        }
        Ok(())
    }

    fn system_by_number(&mut self) -> Result<CoordinateSystem, Error> {
        if !self.take(b'P') {
            return Err(Error::ValueWordMissing);
        }
        let number = usize::try_from(whole(self.line.value(b'P'))?).unwrap_or(0);
        let system = number.checked_sub(1).and_then(|index| CoordinateSystem::ALL.get(BEFORE_THE_FIRST + index));
        system.copied().ok_or(Error::UnsupportedCoordinateSystem)
    }

    /// Refuses a P of G30 other than 2. On other controls P selects further stored positions, which do not exist here.
    #[inline(never)]
    pub(super) fn second_position(&self) -> Result<(), Error> {
        if self.line.value(b'P') == Decimal::from_int(2) { Ok(()) } else { Err(Error::ValueOutOfRange) }
    }

    /// Returns the intermediate point of G28 and G30. U, V and W give this point as distances from the present
    /// position, even with G90.
    pub(super) fn point_on_the_way(&mut self) -> Result<PerAxis<Coordinate, N>, Error> {
        let distances = self.line.extended.distances;
        if distances.is_empty() {
            return Ok(self.target());
        }
        if distances != self.line.axes {
            return Err(Error::NoParallelAxes);
        }
        let distance = core::mem::replace(&mut self.action.modal.distance, Distance::Incremental);
        let point = self.target();
        self.action.modal.distance = distance;
        Ok(point)
    }

    /// Accepts a D, the number of a tool radius, if all other words of the line have been used. D may be alone on its
    /// line, or beside G40 or G43 to G49, but not beside G12 and G13. Stores in the action whether D names the radius
    /// of a tool; D0 names none. Returns `false` if D was not accepted.
    #[inline(never)]
    pub(super) fn take_radius_register(&mut self) -> Result<bool, Error> {
        let mut others = self.line.values;
        others.remove(Letters::of(b"DN"));
        let is_alone = others.is_empty() && self.line.groups == Groups::default();
        let is_beside = self.line.tool_length.is_some() || self.line.groups.has(Group::CutterCompensation);
        let is_circle = self.line.extended.circle.is_some();
        if self.unused != Letters::of(b"D") || !(is_alone || is_beside) || is_circle {
            return Ok(false);
        }
        self.action.after.names_radius = Some(whole(self.line.value(b'D'))? != 0);
        Ok(true)
    }

    /// Returns whether the line's spline word switches the look-ahead, as on other controls: G5.1 with Q, or G5 with
    /// P, without a destination. Such a word starts no curve.
    #[inline(never)]
    pub(super) fn is_look_ahead(&self) -> bool {
        let letter = match self.line.modal.motion {
            Some(MotionMode::Spline(SplineKind::Quadratic)) => b'Q',
            Some(MotionMode::Spline(SplineKind::Cubic)) => b'P',
            _ => return false,
        };
        let mut others = Letters::of(b"PQ");
        others.remove(Letters::of(&[letter]));
        FULL_IMAGE
            && self.line.axes.is_empty()
            && self.unused.has(letter)
            && !self.unused.has_any(others)
            && !self.unused.has_any(CENTRE)
    }

    /// Accepts a line that switches the look-ahead. The motion mode stays in force.
    pub(super) fn switch_look_ahead(&mut self) -> Result<(), Error> {
        self.unused.remove(Letters::of(b"PQR"));
        self.action.modal.motion = self.state.modal.motion;
        self.action.after.notice = Some(Notice::LookAhead);
        Ok(())
    }
}
