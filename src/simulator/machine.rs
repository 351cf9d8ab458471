//! The simulated machine at the step pins. Counts net steps and pulses of each motor, and records the extents: the
//! lowest and highest position that each carriage reached. The machine is Cartesian or CoreXY.

use crate::boards::AXES;

use oxmill_controller::axes::{Arrangement, LINEAR};
use oxmill_controller::messages::{GangedMotors, Wiring};

/// Returns the first three values, those of X, Y and Z, without A.
pub fn linear<T>([x, y, z, ..]: [T; AXES]) -> [T; LINEAR] {
    [x, y, z]
}

/// The positions of motors and carriages, in steps from the position at power-up.
#[derive(Clone, Debug, Default)]
pub struct Machine {
    position: [i32; AXES],
    /// Net steps of the second motor of the ganged axis.
    second: i32,
    arrangement: Arrangement,
    ganged: u8,
    ganged_motors: GangedMotors,
    low: [i32; AXES],
    high: [i32; AXES],
    pulses: [u64; AXES],
}

impl Machine {
    /// Sets how further steps are counted: which axis is ganged (has two motors), and which of its two motors follow
    /// the pulses of the axis.
    pub fn wire(&mut self, wiring: &Wiring) {
        self.ganged = wiring.ganged;
        self.ganged_motors = wiring.ganged_motors;
    }

    /// Sets whether the machine is Cartesian or CoreXY. Only the extents depend on this. A change restarts them.
    pub fn arrange(&mut self, arrangement: Arrangement) {
        if self.arrangement != arrangement {
            self.arrangement = arrangement;
            self.restart_extents();
        }
    }

    /// Counts one pulse for each axis whose bit in `steps` is set (bit 0 is X). If its bit in `directions` is set, the
    /// axis moves in the negative direction.
    #[inline]
    pub fn step(&mut self, mut steps: u8, directions: u8) {
        if self.ganged & steps != 0 {
            if self.ganged_motors != GangedMotors::First {
                self.second = self.second.wrapping_add(if directions & self.ganged != 0 { -1 } else { 1 });
            }
            if self.ganged_motors == GangedMotors::Second {
                steps &= !self.ganged;
            }
        }
        for axis in 0..AXES {
            if steps & (1 << axis) != 0 {
                let negative = directions & (1 << axis) != 0;
                let position = self.position[axis].wrapping_add(if negative { -1 } else { 1 });
                self.position[axis] = position;
                self.pulses[axis] += 1;
            }
        }
        for (axis, place) in self.carriages().into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(place);
            self.high[axis] = self.high[axis].max(place);
        }
    }

    /// Returns the carriage positions in steps; on a CoreXY machine, X and Y are in half steps.
    #[inline]
    fn carriages(&self) -> [i32; AXES] {
        match self.arrangement {
            Arrangement::Cartesian => self.position,
            Arrangement::CoreXy => {
                let mut places = self.position;
                let [a, b, ..] = self.position;
                (places[0], places[1]) = (a.wrapping_add(b), a.wrapping_sub(b));
                places
            }
        }
    }

    /// Net steps of the ganged axis' second motor since power-up.
    pub fn second_motor(&self) -> i32 {
        self.second
    }

    /// Net steps of X, Y and Z since power-up. On a CoreXY machine, the first two are those of the belt motors.
    pub fn position(&self) -> [i32; LINEAR] {
        linear(self.position)
    }

    /// Net steps of all motors since power-up, in the order X, Y, Z, A. A ganged axis has the steps of its first motor;
    /// see [`Machine::second_motor`].
    pub fn motors(&self) -> [i32; AXES] {
        self.position
    }

    /// Minimum and maximum position of each carriage since power-up or the last [`Machine::restart`], in steps (X and Y
    /// of a CoreXY machine: half steps).
    pub fn extents(&self) -> ([i32; AXES], [i32; AXES]) {
        (self.low, self.high)
    }

    /// Pulses of X, Y and Z since power-up or the last [`Machine::restart`].
    pub fn pulses(&self) -> [u64; LINEAR] {
        linear(self.pulses)
    }

    /// Pulses of all motors since power-up or the last [`Machine::restart`].
    pub fn motor_pulses(&self) -> [u64; AXES] {
        self.pulses
    }

    /// Restarts extents and pulse counts at the present position.
    pub fn restart(&mut self) {
        self.restart_extents();
        self.pulses = [0; AXES];
    }

    /// Gives the present position other coordinates without moving the machine, as after a simulated homing. `by`:
    /// steps added to the counter of each motor. Restarts the extents.
    pub fn rename_place(&mut self, by: [i32; AXES]) {
        for (axis, by) in by.into_iter().enumerate() {
            self.position[axis] = self.position[axis].wrapping_add(by);
            if self.ganged & 1 << axis != 0 {
                self.second = self.second.wrapping_add(by);
            }
        }
        self.restart_extents();
    }

    fn restart_extents(&mut self) {
        self.low = self.carriages();
        self.high = self.low;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::messages::InputWiring;

    #[test]
    fn carriages_follow_pulses() {
        let mut machine = Machine::default();
        for _ in 0..3 {
            machine.step(0b011, 0b010);
        }
        machine.step(0b001, 0b001);
        assert_eq!(machine.position(), [2, -3, 0]);
        assert_eq!(machine.extents(), ([0, -3, 0, 0], [3, 0, 0, 0]));
        assert_eq!(machine.pulses(), [4, 3, 0]);
        machine.restart();
        assert_eq!(machine.extents(), ([2, -3, 0, 0], [2, -3, 0, 0]));
    }

    #[test]
    fn a_second_motor_follows_its_axis_or_goes_alone() {
        let mut wiring = Wiring { ganged: 0b010, ..wiring() };
        let mut machine = Machine::default();
        for (motors, directions) in [(GangedMotors::Both, 0), (GangedMotors::First, 0), (GangedMotors::Second, 0b010)] {
            wiring.ganged_motors = motors;
            machine.wire(&wiring);
            machine.step(0b011, directions);
        }
        assert_eq!((machine.position(), machine.second_motor()), ([3, 2, 0], 0));
    }

    #[test]
    fn belts_pull_two_carriages() {
        let mut machine = Machine::default();
        machine.arrange(Arrangement::CoreXy);
        machine.step(0b011, 0b010);
        machine.step(0b011, 0b010);
        assert_eq!(machine.extents(), ([0, 0, 0, 0], [0, 4, 0, 0]));
    }

    fn wiring() -> Wiring {
        Wiring {
            pulse_tenths: 100,
            direction_setup_us: 5,
            pwm_hz: 5_000,
            step_invert: 0,
            direction_invert: 0,
            enable_invert: false,
            probe_invert: false,
            inputs: InputWiring::PULL_UPS,
            armed: 0,
            ganged: 0,
            ganged_invert: false,
            ganged_motors: GangedMotors::Both,
        }
    }
}
