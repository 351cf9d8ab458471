//! Signals of the input pins: what has been pressed, what has tripped, and the stop that follows.

use super::{Controller, StopReason};
use crate::error::{Alarm, Error};
use crate::machine::state::Mode;
use crate::messages::{Coolant, SECOND_SWITCH, Sensed, Signals, SpindleDirection};
use crate::settings::Key;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    pub(super) fn signals_changed(&mut self, sensed: &Sensed) {
        // Armed inputs have stopped the step task themselves, before this message.
        let stops = sensed.trips.wrapping_sub(self.trips);
        self.has_sensed = true;
        self.trips = sensed.trips;
        self.stop.expected = self.stop.expected.wrapping_add(u16::from(stops));
        let mut stopped = Stopped { already: stops != 0, answered: false };
        self.pins = sensed.signals;
        let signals = self.fitted(self.pins);
        let before = core::mem::replace(&mut self.signals, signals);
        // What tripped may be inactive again.
        let tripped = self.fitted(Signals::of_word(sensed.tripped));
        self.emergency(&before, &tripped, &mut stopped);
        if signals.reset && !before.reset || tripped.reset {
            // The button stands for 0x18, but it opens no epoch: what has been received goes all the same.
            self.lines.drop_received(self.observed.received);
            self.stop_for(StopReason::Reset, &mut stopped);
        }
        let closed = signals.limits & !before.limits | tripped.limits;
        if self.mode == Mode::Home {
            self.home_switch(&mut stopped);
        } else if closed != 0 && self.settings.is_on(Key::HardLimits) && !self.mode.is_alarm() {
            let closed = self.axes_of_switches(closed);
            let awaited = self.stop.awaited == Some(StopReason::Alarm(Alarm::HardLimit));
            let limits = if awaited { self.tripped.limits | closed } else { closed };
            if self.stop.awaited.is_none() || awaited {
                self.tripped = Signals { limits, ..Signals::NONE };
            }
            self.stop_for(StopReason::Alarm(Alarm::HardLimit), &mut stopped);
        }
        if stopped.already && !stopped.answered {
            let homing = self.mode == Mode::Home;
            self.await_stop(if homing { StopReason::Alarm(Alarm::HardLimit) } else { StopReason::Nothing });
        }
        if signals.door && !before.door {
            self.open_door();
        }
        if signals.hold && !before.hold {
            self.feed_hold();
        }
        if signals.start && !before.start {
            self.cycle_start();
        }
    }

    /// Stops for an input, unless it has already been done.
    pub(super) fn stop_for(&mut self, reason: StopReason, stopped: &mut Stopped) {
        if stopped.already {
            stopped.answered = true;
            self.await_stop(reason);
        } else {
            self.order_stop(reason);
        }
    }

    /// Emergency stop and driver fault, if they have become active. Spindle and coolant do not wait for the step task.
    fn emergency(&mut self, before: &Signals, tripped: &Signals, stopped: &mut Stopped) {
        let stop = self.signals.emergency_stop && !before.emergency_stop || tripped.emergency_stop;
        let fault = self.signals.driver_fault && !before.driver_fault || tripped.driver_fault;
        let alarm = match (stop, fault) {
            (true, _) => Alarm::EmergencyStop,
            (_, true) => Alarm::DriverFault,
            _ => return,
        };
        self.spindle = SpindleDirection::Off;
        self.coolant = Coolant::default();
        self.interpreter.set_accessories(self.spindle, self.coolant);
        self.tripped = Signals { emergency_stop: stop, driver_fault: fault, ..Signals::NONE };
        self.stop_for(StopReason::Alarm(alarm), stopped);
    }

    /// The emergency that is going on.
    pub(super) fn emergency_now(&self) -> Option<(Alarm, Error)> {
        if self.signals.emergency_stop {
            Some((Alarm::EmergencyStop, Error::EmergencyStop))
        } else if self.signals.driver_fault {
            Some((Alarm::DriverFault, Error::DriverFault))
        } else {
            None
        }
    }

    /// The inputs as the settings want them understood: without those that are not fitted, and the reset button as an
    /// emergency stop (`$912`).
    pub(super) fn fitted(&self, pins: Signals) -> Signals {
        let second = if self.settings.is_on(Key::GangedSwitch) { SECOND_SWITCH } else { 0 };
        let reset_stops = self.settings.is_on(Key::ResetIsEmergencyStop);
        Signals {
            limits: pins.limits & (!SECOND_SWITCH | second),
            door: pins.door && self.settings.is_on(Key::DoorFitted),
            reset: pins.reset && !reset_stops,
            emergency_stop: pins.emergency_stop || pins.reset && reset_stops,
            ..pins
        }
    }
}

/// Whether an input has stopped the step task itself, and whether the reason for it has been found.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopped {
    pub(super) already: bool,
    pub(super) answered: bool,
}
