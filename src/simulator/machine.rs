//! The machine behind the step pins: carriages that follow pulses, and how far they got.

use crate::boards::AXES;

/// Carriages, in steps from where they stood at power-up.
#[derive(Clone, Debug, Default)]
pub struct Machine {
    position: [i32; AXES],
    low: [i32; AXES],
    high: [i32; AXES],
    pulses: [u64; AXES],
}

impl Machine {
    /// Step pins rise; `directions` has a bit for each axis that moves to negative.
    #[inline]
    pub fn step(&mut self, steps: u8, directions: u8) {
        for axis in 0..AXES {
            if steps & (1 << axis) != 0 {
                let negative = directions & (1 << axis) != 0;
                let position = self.position[axis].wrapping_add(if negative { -1 } else { 1 });
                self.position[axis] = position;
                self.low[axis] = self.low[axis].min(position);
                self.high[axis] = self.high[axis].max(position);
                self.pulses[axis] += 1;
            }
        }
    }

    /// Net steps since power-up.
    pub fn position(&self) -> [i32; AXES] {
        self.position
    }

    /// Least and greatest position since power-up or the last [`Machine::restart`].
    pub fn extents(&self) -> ([i32; AXES], [i32; AXES]) {
        (self.low, self.high)
    }

    /// Pulses since power-up or the last [`Machine::restart`].
    pub fn pulses(&self) -> [u64; AXES] {
        self.pulses
    }

    /// Counts extents and pulses anew from the present position.
    pub fn restart(&mut self) {
        self.low = self.position;
        self.high = self.position;
        self.pulses = [0; AXES];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn carriages_follow_pulses() {
        let mut machine = Machine::default();
        for _ in 0..3 {
            machine.step(0b011, 0b010);
        }
        machine.step(0b001, 0b001);
        assert_eq!(machine.position(), [2, -3, 0]);
        assert_eq!(machine.extents(), ([0, -3, 0], [3, 0, 0]));
        assert_eq!(machine.pulses(), [4, 3, 0]);
        machine.restart();
        assert_eq!(machine.extents(), ([2, -3, 0], [2, -3, 0]));
    }
}
