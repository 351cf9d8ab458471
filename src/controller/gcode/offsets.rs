//! Where the program's coordinates lie in the machine: work position = machine position - (WCS + G92 + TLO).

use super::modal::CoordinateSystem;
use crate::axes::{Axis, PerAxis};
use crate::units::Coordinate;

/// The axis that the tool length offset acts along.
pub(super) const TOOL_AXIS: Axis = Axis::Z;

/// A place that is kept over power-off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoredOffset {
    /// Origin of a work coordinate system (G10).
    System(CoordinateSystem),
    /// Where G28 goes (G28.1).
    G28,
    /// Where G30 goes (G30.1).
    G30,
}

impl StoredOffset {
    /// All stored places: the coordinate systems, then G28 and G30.
    pub fn all() -> impl Iterator<Item = StoredOffset> {
        CoordinateSystem::ALL.into_iter().map(StoredOffset::System).chain([StoredOffset::G28, StoredOffset::G30])
    }
}

/// All offsets, in machine coordinates. [`Coordinate::ZERO`] everywhere on a new machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Offsets<const N: usize> {
    systems: [PerAxis<Coordinate, N>; CoordinateSystem::ALL.len()],
    g28: PerAxis<Coordinate, N>,
    g30: PerAxis<Coordinate, N>,
    /// G92, forgotten at reset.
    pub g92: PerAxis<Coordinate, N>,
    /// Tool length offset along Z, forgotten at reset.
    pub tool_length: Coordinate,
}

impl<const N: usize> Default for Offsets<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Offsets<N> {
    /// Those of a new machine.
    pub const fn new() -> Self {
        let zero = PerAxis::all(Coordinate::ZERO);
        Self {
            systems: [zero; CoordinateSystem::ALL.len()],
            g28: zero,
            g30: zero,
            g92: zero,
            tool_length: Coordinate::ZERO,
        }
    }

    /// The value of a stored place.
    pub fn stored(&self, which: StoredOffset) -> PerAxis<Coordinate, N> {
        match which {
            StoredOffset::System(system) => self.system(system),
            StoredOffset::G28 => self.g28,
            StoredOffset::G30 => self.g30,
        }
    }

    /// Replaces a stored place.
    pub fn set_stored(&mut self, which: StoredOffset, value: PerAxis<Coordinate, N>) {
        match which {
            StoredOffset::System(system) => {
                if let Some(slot) = self.systems.get_mut(system as usize) {
                    *slot = value;
                }
            }
            StoredOffset::G28 => self.g28 = value,
            StoredOffset::G30 => self.g30 = value,
        }
    }

    /// The origin of a coordinate system.
    pub fn system(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        self.systems.get(system as usize).copied().unwrap_or(PerAxis::all(Coordinate::ZERO))
    }

    /// Sets every stored place to zero.
    pub fn clear_stored(&mut self) {
        *self = Offsets { g92: self.g92, tool_length: self.tool_length, ..Offsets::default() };
    }

    /// G92 and tool length offset together.
    pub fn volatile(&self) -> PerAxis<Coordinate, N> {
        let mut sum = self.g92;
        if let Some(along_tool) = sum.get(TOOL_AXIS) {
            sum.set(TOOL_AXIS, along_tool + self.tool_length);
        }
        sum
    }

    /// What lies between machine and work position while `system` is active.
    pub fn total(&self, system: CoordinateSystem) -> PerAxis<Coordinate, N> {
        self.system(system).zip(&self.volatile(), |origin, offset| origin + offset)
    }
}
