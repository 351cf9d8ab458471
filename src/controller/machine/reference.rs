//! Whether the machine is where its step counters say, and which axes have been homed.

use crate::axes::AxisMask;

/// The reference of the position. It is lost with a stop at speed, with sleep, with another resolution, direction or end of
/// homing, and comes back with homing. Without homing there is no better knowledge: a lost reference is then a warning and locks nothing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reference {
    trusted: bool,
    /// Axes homed since it was lost.
    homed: AxisMask,
}

impl Reference {
    /// The machine is where it was switched on.
    pub const ASSUMED: Reference = Reference { trusted: true, homed: AxisMask::NONE };

    /// Whether the position is true, as far as can be known.
    pub fn is_trusted(&self) -> bool {
        self.trusted
    }

    /// The position is not known any more.
    pub fn lose(&mut self) {
        *self = Reference { trusted: false, homed: AxisMask::NONE };
    }

    /// For a replay: as it was in the recording. Axes that were homed one by one are not known.
    pub fn assume(&mut self, trusted: bool) {
        *self = Reference { trusted, homed: AxisMask::NONE };
    }

    /// Axes have been homed. With those of all `cycles` (masks of axes) the position is true; those homed one by one count
    /// together, and an axis that no cycle has counts as homed.
    pub fn homed(&mut self, axes: AxisMask, mut cycles: impl Iterator<Item = u8>) {
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
        reference.homed(AxisMask(0b111), CYCLES.into_iter());
        assert!(reference.is_trusted());
    }

    #[test]
    fn axes_homed_one_by_one_count_together() {
        let mut reference = Reference::ASSUMED;
        reference.lose();
        for axis in [0b100, 0b001] {
            reference.homed(AxisMask(axis), CYCLES.into_iter());
            assert!(!reference.is_trusted());
        }
        reference.homed(AxisMask(0b010), CYCLES.into_iter());
        assert!(reference.is_trusted());
        // And none of them counts after the next loss.
        reference.lose();
        reference.homed(AxisMask(0b010), CYCLES.into_iter());
        assert!(!reference.is_trusted());
    }

    #[test]
    fn homing_without_an_axis_proves_nothing() {
        let mut reference = Reference::ASSUMED;
        reference.lose();
        reference.homed(AxisMask::NONE, [0, 0, 0].into_iter());
        assert!(!reference.is_trusted());
    }
}
