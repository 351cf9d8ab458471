//! Switches the current of the motor drivers: on at the start of a motion, off when the delay `$1` after its end has
//! passed. With `$1=255` the current is always on.

use crate::units::{Duration, Instant};

/// Value of `$1` with which the drivers have current all the time.
const ALWAYS_ON: u32 = 255;

/// Whether the drivers have current, and until when.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Drivers {
    on: bool,
    /// When the current is switched off; `None` if no delay is running.
    off_at: Option<Instant>,
}

impl Drivers {
    /// Off: nothing has moved yet.
    pub const OFF: Drivers = Drivers { on: false, off_at: None };

    /// Returns whether the drivers have current, with this `$1` (ms).
    pub fn are_on(&self, idle_delay: u32) -> bool {
        self.on || idle_delay == ALWAYS_ON
    }

    /// Returns when the motor current is switched off, if no motion starts before; `None` if no delay is running.
    pub fn off_at(&self) -> Option<Instant> {
        self.off_at
    }

    /// Switches the current on for a motion, and cancels a delayed switch-off. Returns `false` if the current was on
    /// and no switch-off was due.
    pub fn switch_on(&mut self) -> bool {
        let changes = !self.on || self.off_at.is_some();
        *self = Drivers { on: true, off_at: None };
        changes
    }

    /// Switches the motor current off, for sleep or an emergency stop.
    pub fn switch_off(&mut self) {
        *self = Drivers::OFF;
    }

    /// Cancels the delayed switch-off, because an axis may drop without current.
    pub fn stay(&mut self) {
        self.off_at = None;
    }

    /// Starts the delay `$1` (ms) after the last motion.
    pub fn motion_ended(&mut self, now: Instant, idle_delay: u32) {
        if idle_delay != ALWAYS_ON {
            self.off_at = Some(now + Duration::millis(u64::from(idle_delay)));
        }
    }

    /// Switches the motor current off if the delay `$1` after the last motion has passed.
    pub fn look(&mut self, now: Instant) {
        if self.off_at.is_some_and(|at| now >= at) {
            self.switch_off();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(milliseconds: u64) -> Instant {
        Instant::from_ticks(0) + Duration::millis(milliseconds)
    }

    #[test]
    fn they_go_off_a_delay_after_the_last_motion() {
        let mut drivers = Drivers::OFF;
        assert!(!drivers.are_on(25));
        drivers.switch_on();
        drivers.look(at(1000));
        assert!(drivers.are_on(25) && drivers.off_at().is_none(), "no delay runs while something moves");
        drivers.motion_ended(at(1000), 25);
        assert_eq!(drivers.off_at(), Some(at(1025)));
        drivers.look(at(1024));
        assert!(drivers.are_on(25));
        drivers.look(at(1025));
        assert_eq!(drivers, Drivers::OFF);
    }

    #[test]
    fn a_motion_within_the_delay_keeps_them_on() {
        let mut drivers = Drivers::OFF;
        drivers.switch_on();
        drivers.motion_ended(at(0), 25);
        drivers.switch_on();
        drivers.look(at(100));
        assert!(drivers.are_on(25));
    }

    #[test]
    fn they_can_be_always_on() {
        let mut drivers = Drivers::OFF;
        assert!(drivers.are_on(255));
        drivers.switch_on();
        drivers.motion_ended(at(0), 255);
        assert_eq!(drivers.off_at(), None);
    }

    #[test]
    fn in_an_emergency_they_stay_or_go_off() {
        let mut drivers = Drivers::OFF;
        drivers.switch_on();
        drivers.motion_ended(at(0), 25);
        drivers.stay();
        drivers.look(at(1000));
        assert!(drivers.are_on(25));
        drivers.switch_off();
        assert!(!drivers.are_on(25));
    }
}
