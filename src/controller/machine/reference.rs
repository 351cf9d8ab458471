//! Records whether the machine's position matches its step counters, and which axes have been homed.

use crate::axes::AxisMask;

/// The reference of the position: whether the position can be trusted. Homing restores the reference. With homing
/// disabled nothing can restore it, so its loss is only a warning and locks nothing. These events lose the reference:
/// * a stop at speed;
/// * a failed homing;
/// * an emergency stop during homing, or one that switches the drivers off;
/// * a driver fault;
/// * sleep;
/// * a power-up with homing enabled, or a restart after a failure;
/// * a change of settings that gives the same position other coordinates, such as resolution, direction, or the end at
///   which an axis is homed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reference {
    trusted: bool,
    /// Axes homed since the reference was lost.
    homed: AxisMask,
}

impl Reference {
    /// Trusted although nothing has been homed, because the machine is assumed to be at its power-up position.
    pub const ASSUMED: Reference = Reference { trusted: true, homed: AxisMask::NONE };

    /// Returns whether the position is correct, as far as the controller can detect.
    pub fn is_trusted(&self) -> bool {
        self.trusted
    }

    /// Returns the axes homed since the reference was lost.
    pub fn homed_axes(&self) -> AxisMask {
        self.homed
    }

    /// Marks the position as unknown.
    pub fn lose(&mut self) {
        *self = Reference { trusted: false, homed: AxisMask::NONE };
    }

    /// Sets whether the position is trusted, for a replay. A recording contains this fact, but not which axes were
    /// homed, so no axis counts as homed.
    pub fn assume(&mut self, trusted: bool) {
        *self = Reference { trusted, homed: AxisMask::NONE };
    }

    /// Marks `axes` as homed. The position is trusted once all axes that are in one of the `cycles` (masks of axes)
    /// have been homed, together or one at a time. An axis that is in no cycle need not be homed.
    pub fn mark_homed(&mut self, axes: AxisMask, mut cycles: impl Iterator<Item = u8>) {
        self.homed = AxisMask(self.homed.0 | axes.0);
        self.trusted |= !axes.is_empty() && cycles.all(|cycle| cycle & !self.homed.0 == 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CYCLES: [u8; 3] = [0b100, 0b011, 0];

    #[test]
    fn all_cycles_make_it_true() {
        let mut reference = Reference::ASSUMED;
        assert!(reference.is_trusted());
        reference.lose();
        assert!(!reference.is_trusted());
        reference.mark_homed(AxisMask(0b111), CYCLES.into_iter());
        assert!(reference.is_trusted());
    }

    #[test]
    fn axes_homed_one_by_one_count_together() {
        let mut reference = Reference::ASSUMED;
        reference.lose();
        for axis in [0b100, 0b001] {
            reference.mark_homed(AxisMask(axis), CYCLES.into_iter());
            assert!(!reference.is_trusted());
        }
        reference.mark_homed(AxisMask(0b010), CYCLES.into_iter());
        assert!(reference.is_trusted());
        // Axes homed before another loss of the reference no longer count.
        reference.lose();
        reference.mark_homed(AxisMask(0b010), CYCLES.into_iter());
        assert!(!reference.is_trusted());
    }

    #[test]
    fn homing_without_an_axis_proves_nothing() {
        let mut reference = Reference::ASSUMED;
        reference.lose();
        reference.mark_homed(AxisMask::NONE, [0, 0, 0].into_iter());
        assert!(!reference.is_trusted());
    }
}
