//! G68 and G69: finds the plane and the angle by which the coordinates of a line are rotated. Also executes G10 in a
//! rotated coordinate system, and refuses words that cannot be used while coordinates are rotated. The file
//! `targets.rs` applies the rotation.

use super::draft::Draft;
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::gcode::Dialect;
use crate::gcode::modal::{CoordinateSystem, Plane, PlaneAxes};
use crate::gcode::rotation::{Angle, RotatedPlane, Rotation, difference};
use crate::gcode::values::along;
use crate::gcode::word::Letters;
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

impl<const N: usize> Draft<'_, N> {
    /// Finds the rotation and the scaling of the line's coordinates. Grbl's dialect ignores both, because it has no
    /// words to end them.
    #[inline]
    pub(super) fn rotation(&mut self) -> Result<(), Error> {
        let system = self.action.modal.coordinate_system;
        let is_plain = self.state.rotation.is_none()
            && self.state.scaling.is_none()
            && self.line.extended.rotation.is_none()
            && self.line.extended.scaling.is_none()
            && self.state.offsets.angle(system) == Angle::ZERO;
        if !FULL_IMAGE || is_plain || self.dialect == Dialect::Grbl {
            return Ok(());
        }
        self.rotated_line()
    }

    #[inline(never)]
    fn rotated_line(&mut self) -> Result<(), Error> {
        match self.line.extended.rotation {
            Some(true) => {
                self.rotated = self.plane_with(None)?;
                self.scaling()?;
                let rotation = self.new_rotation()?;
                // A G68 with the angle 0 has the effect of G69.
                let rotation = Some(rotation).filter(|rotation| rotation.angle != Angle::ZERO);
                self.action.rotated.rotation = Some(rotation);
                self.plane_with(rotation.as_ref()).map(|_| ())
            }
            Some(false) => {
                self.action.rotated.rotation = Some(None);
                self.rotated = self.plane_with(None)?;
                self.scaling()
            }
            None => {
                self.rotated = self.plane_with(self.state.rotation.as_ref())?;
                self.scaling()
            }
        }
    }

    fn plane_with(&self, rotation: Option<&Rotation>) -> Result<Option<RotatedPlane>, Error> {
        let system = self.action.modal.coordinate_system;
        self.state.offsets.rotated_plane(system, &self.action.g92, &self.action.tool_length, rotation)
    }

    /// Reads G68: R is the angle, and the axis words give the centre. A and B can take the place of the axis words, as
    /// on Mach. Along an axis of the plane that has none of these words, the centre is at the present position. The
    /// distance mode has no effect.
    fn new_rotation(&mut self) -> Result<Rotation, Error> {
        let plane = self.action.modal.plane;
        let axes = plane.axes();
        if Axis::of_machine::<N>().any(|axis| self.line.axes.has(axis) && axis != axes.first && axis != axes.second) {
            return Err(Error::AxisWordsUnused);
        }
        if !self.take(b'R') {
            return Err(Error::ValueWordMissing);
        }
        let centre = [(axes.first, b'A'), (axes.second, b'B')].map(|(axis, of_mach)| {
            if self.line.axes.has(axis) {
                self.scaled_length(axis, self.axis_length(axis), false)
            } else if FULL_IMAGE && self.take(of_mach) {
                self.scaled_length(axis, self.length(self.line.value(of_mach)), false)
            } else {
                self.program_coordinate(axis)
            }
        });
        if self.unused.has_any(Letters::of(b"AB")) {
            return Err(Error::UnusedWords);
        }
        Ok(Rotation { plane, angle: Angle::of(self.line.value(b'R')), centre })
    }

    /// Refuses arcs, splines and cycles in another plane than the rotated one. After the rotation, their plane would
    /// no longer contain two machine axes.
    pub(super) fn needs_plane(&self, axes: PlaneAxes) -> Result<(), Error> {
        match self.rotated {
            Some(rotated) if FULL_IMAGE && rotated.axes != axes => Err(Error::NotInRotatedPlane),
            _ => Ok(()),
        }
    }

    /// Refuses words that set the coordinates of the present position along axes that G68 has rotated.
    pub(super) fn needs_no_rotation(&self) -> Result<(), Error> {
        let ends = self.line.extended.rotation == Some(false);
        match self.state.rotation {
            Some(rotation) if FULL_IMAGE && self.rotated.is_some() && !ends => {
                let axes = rotation.plane.axes();
                let named = self.line.axes.has(axes.first) || self.line.axes.has(axes.second);
                if named { Err(Error::RotationActs) } else { Ok(()) }
            }
            _ => Ok(()),
        }
    }

    /// Refuses an angle for the active system while G68 rotates another plane than that of X and Y. The angle would
    /// rotate X and Y. If both rotations were in force, every following line would be refused.
    pub(super) fn keeps_planes(&self, system: CoordinateSystem) -> Result<(), Error> {
        let turned = self.action.rotated.angle.is_some_and(|angle| angle != Angle::ZERO);
        let ends = self.line.extended.rotation == Some(false);
        match self.state.rotation {
            Some(rotation) if turned && !ends && system == self.action.modal.coordinate_system => {
                if rotation.plane == Plane::Xy { Ok(()) } else { Err(Error::NotInRotatedPlane) }
            }
            _ => Ok(()),
        }
    }

    /// Returns the coordinates that G10 gives to the present position in the rotated plane. An axis with a word gets
    /// the value of the word; the other axis keeps its program coordinate. `None` if neither axis has a word.
    fn named_in(&self, rotated: RotatedPlane) -> Option<[Coordinate; 2]> {
        let axes = [rotated.axes.first, rotated.axes.second];
        if !axes.into_iter().any(|axis| self.line.axes.has(axis)) {
            return None;
        }
        let mut place = self.state.in_program(rotated, rotated.part_of(&self.state.position));
        for (axis, coordinate) in axes.into_iter().zip(&mut place) {
            if self.line.axes.has(axis) {
                *coordinate = self.axis_length(axis);
            }
        }
        Some(place)
    }

    /// Executes G10 L20 for a rotated system: moves its origin along both axes, so that the tool gets the coordinates
    /// that the line gives. Returns `false`, and sets nothing, if the system is not rotated.
    pub(super) fn moves_rotated_origin(&mut self, system: CoordinateSystem) -> Result<bool, Error> {
        if !FULL_IMAGE || self.dialect == Dialect::Grbl {
            return Ok(false);
        }
        self.needs_no_rotation()?;
        let offsets = &self.state.offsets;
        let rotated = offsets.rotated_plane(system, &offsets.g92, &self.action.tool_length, None)?;
        let Some(rotated) = rotated else { return Ok(false) };
        let origin = offsets.system(system);
        let mut moved = self.with_axis_words(origin, |axis, value| {
            self.position(axis) - along(&offsets.g92, axis) - self.tool_offset(axis) - value
        });
        let stays = rotated.part_of(&origin);
        rotated.put(&mut moved, self.moved_by(rotated, stays));
        self.action.stored = Some(moved);
        Ok(true)
    }

    /// Moves `offset`, in machine coordinates, so that the tool gets the coordinates of the line's words. Returns the
    /// result.
    fn moved_by(&self, rotated: RotatedPlane, offset: [Coordinate; 2]) -> [Coordinate; 2] {
        match self.named_in(rotated) {
            Some(place) => {
                let missing = difference(rotated.part_of(&self.state.position), rotated.to_machine(place));
                difference(offset, missing.map(|part| Coordinate(part.0.saturating_neg())))
            }
            None => offset,
        }
    }

    /// Executes G10 L10 and L11 in a rotated system: sets the offset of a tool. `present`: the offset that the tool
    /// table has so far. Returns `false`, and sets nothing, if the system is not rotated.
    pub(super) fn sets_rotated_tool(&mut self, l: i32, present: &PerAxis<Coordinate, N>) -> Result<bool, Error> {
        self.needs_no_rotation()?;
        let offsets = &self.state.offsets;
        let (system, g92) = if l == 11 {
            (CoordinateSystem::G59_3, PerAxis::all(Coordinate::ZERO))
        } else {
            (self.action.modal.coordinate_system, offsets.g92)
        };
        let Some(rotated) = offsets.rotated_plane(system, &g92, present, None)? else { return Ok(false) };
        let origin = offsets.system(system);
        let mut tool = self.with_axis_words(*present, |axis, value| {
            self.position(axis) - along(&origin, axis) - along(&g92, axis) - value
        });
        rotated.put(&mut tool, self.moved_by(rotated, rotated.part_of(present)));
        self.action.stored = Some(tool);
        Ok(true)
    }
}
