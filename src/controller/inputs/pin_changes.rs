//! Reacts to changes of the input pins: emergency stop, driver fault, reset button, limit switches, door, hold and
//! start. If the step task has already stopped by itself, the reason for that stop is determined here.

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::inputs::levels::{self, InputChange};
use crate::messages::{Sensed, Signals};
use crate::states::State;
use crate::states::stops::Stopped;
use crate::states::stops::orders::StopReason;
use crate::states::stops::reaction::Reaction;

impl<const N: usize> Controller<N> {
    pub(crate) fn signals_changed(&mut self, sensed: &Sensed) {
        let InputChange { stops, came } = self.m.inputs.take(sensed, &self.m.settings);
        self.m.stops.add_expected(stops);
        let mut stopped = Stopped { already: stops != 0, answered: false };
        self.emergency(&came, &mut stopped);
        if came.reset {
            // The button acts like 0x18. But 0x18 starts an epoch of line bytes (see `LineByte`), and the button does
            // not. So the bytes received so far are counted, and that many are dropped.
            self.m.lines.drop_received(self.m.step_supply.observed().received);
            self.abort_check();
            self.stop_for(StopReason::Reset, &mut stopped);
        }
        let limits = came.limits & levels::hard_limits(&self.m.settings);
        if let State::Homing(homing) = &mut self.state {
            if homing.is_reached(self.m.switches()) {
                self.stop_for(StopReason::Switch, &mut stopped);
            }
        } else if limits != 0 && !self.state.is_alarm() {
            let closed = levels::axes_of_switches(limits, &self.m.settings);
            let limit = StopReason::Alarm(Alarm::HardLimit);
            let under_way = self.stop_under_way();
            if under_way.is_none_or(|other| other.heavier(limit) == limit) {
                self.m.inputs.trip_limits(closed, under_way == Some(limit));
            }
            self.fault(Alarm::HardLimit, &mut stopped);
        }
        if stopped.already && !stopped.answered {
            let homing = matches!(self.state, State::Homing(_));
            self.m.stops.wait_for(if homing { StopReason::Alarm(Alarm::HardLimit) } else { StopReason::Nothing });
            self.finish_stop();
        }
        if came.door {
            self.open_door();
        }
        if came.hold {
            self.feed_hold();
        }
        if came.start {
            self.cycle_start();
        }
    }

    /// Reacts to emergency stop and driver fault, if they have become active. An emergency stop switches spindle and
    /// coolant off before the step task has answered, even if motion still has to brake. A driver fault switches them
    /// off this early only if its reaction (`$926`) stops motion at once and switches the spindle off.
    fn emergency(&mut self, came: &Signals, stopped: &mut Stopped) {
        if came.driver_fault {
            // The driver may have lost steps.
            self.m.reference.lose();
        }
        let alarm = match (came.emergency_stop, came.driver_fault) {
            (true, _) => Alarm::EmergencyStop,
            (_, true) => Alarm::DriverFault,
            _ => return,
        };
        let reaction = Reaction::to(alarm, &self.m.settings);
        if alarm == Alarm::EmergencyStop || reaction.is_at_once() && !reaction.spindle_on {
            self.switch_off();
        }
        self.m.inputs.trip_emergency(came.emergency_stop, came.driver_fault);
        self.fault(alarm, stopped);
    }
}
