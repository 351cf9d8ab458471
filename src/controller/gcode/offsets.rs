//! All offsets of the interpreter. Work position = machine position - coordinate system - G92 - tool length offset,
//! unless coordinates are rotated (see `rotation`). Coordinate systems, G28 and G30 are stored, G92 is not.

use super::modal::{CoordinateSystem, Plane};
use super::rotation::{Angle, RotatedPlane, Rotation, difference, sum};
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

/// The axis of the tool length offset in Grbl's dialect, and of measured tool lengths in all dialects.
pub(super) const TOOL_AXIS: Axis = Axis::Z;

/// Position or offset that is kept over power-off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoredOffset {
    /// Origin of a work coordinate system (G10).
    System(CoordinateSystem),
    /// Target of G28 (set by G28.1).
    G28,
    /// Target of G30 (set by G30.1).
    G30,
    /// Offset of a tool of the table (G10 L1).
    Tool(u32),
}

impl StoredOffset {
    /// Returns all stored positions except the offsets of tools: the coordinate systems, then G28 and G30.
    pub fn all() -> impl Iterator<Item = StoredOffset> {
        CoordinateSystem::ALL.into_iter().map(StoredOffset::System).chain([StoredOffset::G28, StoredOffset::G30])
    }
}

/// All offsets, in machine coordinates. [`Coordinate::ZERO`] everywhere on a new machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offsets<const N: usize> {
    systems: [PerAxis<Coordinate, N>; CoordinateSystem::ALL.len()],
    /// Angle by which each system is rotated about its origin.
    angles: [Angle; CoordinateSystem::ALL.len()],
    g28: PerAxis<Coordinate, N>,
    g30: PerAxis<Coordinate, N>,
    /// Offset by G92 or G52; a reset clears it.
    pub g92: PerAxis<Coordinate, N>,
    /// The offset that G92.3 restores after a G92.2.
    pub(super) g92_kept: PerAxis<Coordinate, N>,
    /// Whether G92 or G52 is in force, even with the value 0. `false` before the first one, and after G92.1, G92.2 or a
    /// reset.
    pub g92_acts: bool,
    /// Tool length offset. A reset clears it, except the measured length of the tool in the spindle.
    pub tool_length: PerAxis<Coordinate, N>,
}

impl<const N: usize> Default for Offsets<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Offsets<N> {
    /// Creates the offsets of a new machine: all are zero.
    pub const fn new() -> Self {
        let zero = PerAxis::all(Coordinate::ZERO);
        Self {
            systems: [zero; CoordinateSystem::ALL.len()],
            angles: [Angle::ZERO; CoordinateSystem::ALL.len()],
            g28: zero,
            g30: zero,
            g92: zero,
            g92_kept: zero,
            g92_acts: false,
            tool_length: zero,
        }
    }

    /// Returns a stored position. Returns zero for a tool, because its offset is in the tool table.
    pub fn stored(&self, which: StoredOffset) -> PerAxis<Coordinate, N> {
        match which {
            StoredOffset::System(system) => self.system(system),
            StoredOffset::G28 => self.g28,
            StoredOffset::G30 => self.g30,
            StoredOffset::Tool(_) => PerAxis::all(Coordinate::ZERO),
        }
    }

    /// Replaces a stored position. Does nothing for a tool, because its offset is in the tool table.
    pub fn set_stored(&mut self, which: StoredOffset, value: PerAxis<Coordinate, N>) {
        match which {
            StoredOffset::System(system) => {
                if let Some(slot) = self.systems.get_mut(system as usize) {
                    *slot = value;
                }
            }
            StoredOffset::G28 => self.g28 = value,
            StoredOffset::G30 => self.g30 = value,
            StoredOffset::Tool(_) => {}
        }
    }

    /// Returns the origin of a coordinate system, in machine coordinates.
    pub fn system(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        self.systems.get(system as usize).copied().unwrap_or(PerAxis::all(Coordinate::ZERO))
    }

    /// Returns the angle by which a coordinate system is rotated about its origin.
    pub fn angle(&self, system: CoordinateSystem) -> Angle {
        self.angles.get(system as usize).copied().unwrap_or(Angle::ZERO)
    }

    pub(super) fn set_angle(&mut self, system: CoordinateSystem, angle: Angle) {
        if let Some(slot) = self.angles.get_mut(system as usize) {
            *slot = angle;
        }
    }

    /// Sets all stored positions and angles to zero.
    pub fn clear_stored(&mut self) {
        *self = Offsets {
            g92: self.g92,
            g92_kept: self.g92_kept,
            g92_acts: self.g92_acts,
            tool_length: self.tool_length,
            ..Offsets::default()
        };
    }

    fn g92_and_tool_length(&self) -> PerAxis<Coordinate, N> {
        self.g92.zip(&self.tool_length, |g92, tool| g92 + tool)
    }

    /// Returns machine position minus work position while `system` is active.
    pub fn total(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        self.system(system).zip(&self.g92_and_tool_length(), |origin, offset| origin + offset)
    }
}

impl<const N: usize> Offsets<N> {
    /// Returns the plane in which `system` is rotated with the given G92, tool length offset and G68; `None` without a
    /// rotation. An angle of the system always rotates X and Y. So the function fails if the system has an angle and
    /// G68 rotates another plane.
    #[inline]
    pub(super) fn rotated_plane(
        &self,
        system: CoordinateSystem,
        g92: &PerAxis<Coordinate, N>,
        tool_length: &PerAxis<Coordinate, N>,
        rotation: Option<&Rotation>,
    ) -> Result<Option<RotatedPlane>, Error> {
        if !FULL_IMAGE || rotation.is_none() && self.angle(system) == Angle::ZERO {
            return Ok(None);
        }
        self.rotated(system, g92, tool_length, rotation).map(Some)
    }

    #[inline(never)]
    fn rotated(
        &self,
        system: CoordinateSystem,
        g92: &PerAxis<Coordinate, N>,
        tool_length: &PerAxis<Coordinate, N>,
        rotation: Option<&Rotation>,
    ) -> Result<RotatedPlane, Error> {
        let of_system = self.angle(system);
        let rotation = rotation.copied().unwrap_or(Rotation {
            plane: Plane::Xy,
            angle: Angle::ZERO,
            centre: [Coordinate::ZERO; 2],
        });
        if of_system != Angle::ZERO && rotation.plane != Plane::Xy {
            return Err(Error::NotInRotatedPlane);
        }
        let axes = rotation.plane.axes();
        let mut plane = RotatedPlane { axes, angle: of_system.plus(rotation.angle), zero: [Coordinate::ZERO; 2] };
        let origin = sum(plane.part_of(&self.system(system)), plane.part_of(tool_length));
        let turned = difference(rotation.centre, rotation.angle.turn(rotation.centre));
        plane.zero = sum(origin, of_system.turn(sum(turned, plane.part_of(g92))));
        Ok(plane)
    }

    /// Returns the machine position of the work zero of a system. G92 shifts this zero along the rotated axes of the
    /// system.
    pub(super) fn zero_of(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        let mut zero = self.total(system);
        if let Ok(Some(rotated)) = self.rotated_plane(system, &self.g92, &self.tool_length, None) {
            rotated.put(&mut zero, rotated.zero);
        }
        zero
    }
}
