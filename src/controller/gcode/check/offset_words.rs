//! Offsets and stored positions: G10 L2 and L20, G28, G28.1, G30, G30.1, G52, G53, and G92 to G92.3. Changes go into
//! the line's action and take effect when the line is committed.

use super::draft::Draft;
use crate::axes::{Axis, LINEAR, PerAxis};
use crate::error::Error;
use crate::gcode::Dialect;
use crate::gcode::action::{Feed, MotionCommand};
use crate::gcode::modal::{CoordinateSystem, MotionMode};
use crate::gcode::offsets::StoredOffset;
use crate::gcode::rotation::Angle;
use crate::gcode::values::{along, reachable, whole};
use crate::gcode::word::{Letters, NonModal};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, Decimal};

impl<const N: usize> Draft<'_, N> {
    pub(super) fn non_modal(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.non_modal else { return Ok(()) };
        self.non_modal_word(word)?;
        self.allow_offset(&self.action.g92)?;
        self.action.stored.map_or(Ok(()), |stored| self.allow_offset(&stored))
    }

    fn non_modal_word(&mut self, word: NonModal) -> Result<(), Error> {
        match word {
            NonModal::SetSystem => self.set_system(),
            NonModal::SetOffset => self.set_offset(),
            NonModal::Go(which) => self.go_to_stored(which),
            NonModal::StorePosition(which) => {
                self.action.store = Some(which);
                self.action.stored = Some(self.state.position);
                Ok(())
            }
            NonModal::LocalOffset if self.line.axes.is_empty() => Err(Error::NoAxisWords),
            NonModal::LocalOffset => {
                self.action.g92 = self.with_axis_words(self.state.offsets.g92, |_, value| value);
                self.action.after.keeps_g92 = true;
                self.action.after.g92_acts = true;
                Ok(())
            }
            NonModal::MachineCoordinates => match self.action.modal.motion {
                MotionMode::Rapid | MotionMode::Linear => Ok(()),
                _ => Err(Error::G53NeedsMotion),
            },
            NonModal::Dwell | NonModal::ClearOffset | NonModal::SuspendOffset | NonModal::RestoreOffset => Ok(()),
        }
    }

    /// Executes G92.1, G92.2 and G92.3. A motion on the same line already uses the new offset, as in RS274NGC. In
    /// Grbl's dialect the motion uses the old offset.
    pub(super) fn offset_acts(&mut self) {
        match self.line.non_modal {
            Some(word @ (NonModal::ClearOffset | NonModal::SuspendOffset)) => {
                self.action.after.keeps_g92 = word == NonModal::ClearOffset;
                self.let_offset_act(false);
            }
            Some(NonModal::RestoreOffset) => self.let_offset_act(true),
            _ => {}
        }
    }

    /// Restores the stored G92 offset if `acts` is `true` (G92.3), for example after G92.2. Otherwise sets the offset
    /// in force to 0.
    pub(super) fn let_offset_act(&mut self, acts: bool) {
        self.action.g92 = if acts { self.state.offsets.g92_kept } else { PerAxis::all(Coordinate::ZERO) };
        self.action.after.g92_acts = acts;
    }

    /// Executes G10. L2 sets the origin of a system to the given machine coordinates. L20 moves the origin so that the
    /// present position gets the given coordinates. The distance mode has no effect.
    fn set_system(&mut self) -> Result<(), Error> {
        let line = self.line;
        let of_tool = self.dialect != Dialect::Grbl && line.value(b'L') == Decimal::from_int(1);
        let rotates = self.dialect != Dialect::Grbl && line.values.has(b'R');
        if line.axes.is_empty() && !of_tool && !rotates {
            return Err(Error::NoAxisWords);
        }
        if !line.values.has(b'P') && !line.values.has(b'L') {
            return Err(Error::ValueWordMissing);
        }
        // In Grbl's dialect, P is checked first, as in Grbl: a wrong system is reported before an unknown L. The other
        // dialects check L first.
        if self.dialect != Dialect::Grbl {
            // If a dwell or another word of the line has already used P, the G10 has no P.
            if line.values.has(b'P') && !self.unused.has(b'P') {
                return Err(Error::ValueWordMissing);
            }
            match whole(line.value(b'L'))? {
                2 if rotates && !FULL_IMAGE => return Err(Error::RotationLeftOut),
                2 | 20 => {}
                l @ (1 | 10 | 11) => return self.set_tool(l),
                _ => return Err(Error::UnsupportedCommand),
            }
        }
        let system = self.system_of(line.value(b'P').truncate())?;
        if self.dialect != Dialect::Grbl {
            whole(line.value(b'P'))?;
        }
        let from_position = match line.value(b'L').truncate() {
            2 if line.values.has(b'R') && !rotates => return Err(Error::UnsupportedCommand),
            2 => {
                self.action.rotated.angle = self.take(b'R').then(|| Angle::of(line.value(b'R')));
                self.keeps_planes(system)?;
                false
            }
            20 => {
                self.needs_no_scaling()?;
                true
            }
            _ => return Err(Error::UnsupportedCommand),
        };
        self.unused.remove(Letters::of(b"LP"));
        let which = StoredOffset::System(system);
        let present = self.state.offsets.stored(which);
        self.action.store = Some(which);
        if from_position && self.moves_rotated_origin(system)? {
            return Ok(());
        }
        self.action.stored = Some(self.with_axis_words(present, |axis, value| {
            if from_position {
                self.position(axis) - along(&self.state.offsets.g92, axis) - self.tool_offset(axis) - value
            } else {
                value
            }
        }));
        Ok(())
    }

    /// Returns the system that G10's P selects; 0 is the active system.
    fn system_of(&self, p: i32) -> Result<CoordinateSystem, Error> {
        let count = if self.dialect == Dialect::Grbl { CoordinateSystem::OF_GRBL } else { CoordinateSystem::ALL.len() };
        match usize::try_from(p) {
            Ok(0) => Ok(self.action.modal.coordinate_system),
            Ok(p) => CoordinateSystem::ALL
                .get(..count)
                .and_then(|systems| systems.get(p - 1))
                .copied()
                .ok_or(Error::UnsupportedCoordinateSystem),
            Err(_) => Err(Error::UnsupportedCoordinateSystem),
        }
    }

    /// Executes G92: shifts the work coordinates so that the present position gets the given coordinates in the active
    /// system.
    fn set_offset(&mut self) -> Result<(), Error> {
        if self.line.axes.is_empty() {
            return Err(Error::NoAxisWords);
        }
        self.needs_no_rotation()?;
        self.needs_no_scaling()?;
        let origin = self.state.offsets.system(self.action.modal.coordinate_system);
        let rotated = self.rotated.filter(|_| FULL_IMAGE);
        self.action.g92 = self.with_axis_words(self.state.offsets.g92, |axis, value| {
            if rotated.is_some() {
                return self.program_coordinate(axis) + along(&self.state.offsets.g92, axis) - value;
            }
            self.position(axis) - along(&origin, axis) - self.tool_offset(axis) - value
        });
        self.action.after.keeps_g92 = true;
        self.action.after.g92_acts = true;
        Ok(())
    }

    /// Executes G28 and G30: the axes that have a word move to the stored position, through the intermediate point
    /// that the words give. Without axis words, all axes move there directly.
    fn go_to_stored(&mut self, which: StoredOffset) -> Result<(), Error> {
        if FULL_IMAGE && which == StoredOffset::G30 && self.dialect != Dialect::Grbl && self.take(b'P') {
            self.second_position()?;
        }
        let stored = self.state.offsets.stored(which);
        let (via, target) = if self.line.axes.is_empty() {
            // An axis may have been in use when the position was stored, and not be in use now. Such an axis does not
            // move.
            let has = |axis: Axis| N <= LINEAR || axis.index() < self.state.axes();
            let of = |axis| if has(axis) { along(&stored, axis) } else { self.position(axis) };
            (None, PerAxis::from_axis(of))
        } else {
            let axes = self.line.axes;
            let mut target =
                PerAxis::from_axis(|axis| if axes.has(axis) { along(&stored, axis) } else { self.position(axis) });
            let via = if FULL_IMAGE { self.point_on_the_way()? } else { self.target() };
            self.go_in_rotated_plane(&stored, &via, &mut target);
            reachable(&via)?;
            (Some(via), target)
        };
        reachable(&target)?;
        self.action.motion = MotionCommand::Line { via, target, feed: Feed::Rapid };
        self.action.position = target;
        Ok(())
    }
}
