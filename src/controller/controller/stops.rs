//! Stops, alarms and resets: what ends a motion from outside, and how the controller begins anew.

use super::cycles::Probing;
use super::door::DoorState;
use super::execute::Task;
use super::{Controller, StopReason, StopState};
use crate::axes::PerAxis;
use crate::error::{Alarm, Error};
use crate::gcode::Dialect;
use crate::machine::realtime_override::Overrides;
use crate::machine::state::Mode;
use crate::messages::{Coolant, GangedMotors, SpindleDirection, StepEvent};
use crate::protocol::report::{self, RareFields};
use crate::settings::Key;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// A stop has been asked for by somebody who has also stopped the step task.
    pub(super) fn begin_stop(&mut self, reason: StopReason) {
        self.stop.expected = self.stop.expected.wrapping_add(1);
        self.await_stop(reason);
    }

    /// A stop that is counted already is awaited for this reason.
    pub(super) fn await_stop(&mut self, reason: StopReason) {
        // A reset wins over everything, an alarm over a homing switch: what they end, the others cannot go on with.
        let weight = |reason| match reason {
            None => 0,
            Some(StopReason::Nothing) => 1,
            Some(StopReason::Switch | StopReason::Contact) => 2,
            Some(StopReason::Alarm(Alarm::EmergencyStop)) => 5,
            Some(StopReason::Alarm(Alarm::DriverFault)) => 4,
            Some(StopReason::Alarm(_)) => 3,
            Some(StopReason::Reset) => 6,
        };
        if weight(Some(reason)) > weight(self.stop.awaited) {
            self.stop.awaited = Some(reason);
        }
        self.finish_stop();
    }

    /// Asks the step task to stop. Two reasons before it has been told are one stop.
    pub(super) fn order_stop(&mut self, reason: StopReason) {
        if self.stop.order {
            self.stop.expected = self.stop.expected.wrapping_sub(1);
        }
        self.stop.order = true;
        self.begin_stop(reason);
    }

    pub(super) fn step_event(&mut self, event: &StepEvent<N>) {
        match *event {
            StepEvent::Stopped { stops, moving, position } => {
                self.stop.seen = stops;
                self.stop.moving |= moving;
                self.stop.line = self.motion.line_number();
                self.stopped_at(&position);
            }
            StepEvent::Probed { position } => {
                self.probe_contact(&position);
                return;
            }
            StepEvent::Underrun { stops, position } => {
                self.stop.seen = stops;
                self.stop.expected = self.stop.expected.wrapping_add(1);
                self.stop.moving = true;
                self.stopped_at(&position);
                if self.stop.awaited.is_none() {
                    self.stop.awaited = Some(StopReason::Alarm(Alarm::Underrun));
                }
            }
        }
        self.finish_stop();
    }

    fn stopped_at(&mut self, position: &PerAxis<i32, N>) {
        self.motion.stopped(position);
        self.detour.stopped(position);
        if self.door.is_parking() {
            // The way to the parking place was the detour's, and it knows on which side the slack is.
            self.motion.stand_where(&self.detour);
        }
    }

    /// Goes on after a stop, once every stop that was asked for has happened.
    pub(super) fn finish_stop(&mut self) {
        let Some(reason) = self.stop.awaited else { return };
        // An order that is not out yet cannot have been obeyed, whatever else has stopped meanwhile.
        if self.stop.order || (self.stop.seen.wrapping_sub(self.stop.expected) as i16) < 0 {
            return;
        }
        let (moving, line) = (self.stop.moving, self.stop.line);
        // A stop that has happened and has not been told of is waited for by `step_message`.
        let StopState { expected, seen, .. } = self.stop;
        self.stop = StopState { expected, seen, resume: true, ..StopState::default() };
        self.running = false;
        self.probe_watch = None;
        if reason == StopReason::Nothing {
            self.motion.discard();
            return;
        }
        if reason == StopReason::Contact {
            // The probe goes on from here, or what has begun meanwhile: a hold, a door.
            self.probing = Some(Probing::Touched);
            self.motion.discard();
            return;
        }
        self.door = DoorState::CLOSED;
        self.spinning_up = None;
        self.jog_interrupted = false;
        self.probing = None;
        if reason == StopReason::Switch {
            // Homing goes on from here.
            self.motion.discard();
            return;
        }
        self.spindle = SpindleDirection::Off;
        self.coolant = Coolant::default();
        self.interpreter.set_accessories(self.spindle, self.coolant);
        match reason {
            StopReason::Nothing | StopReason::Switch | StopReason::Contact => {}
            StopReason::Alarm(alarm @ (Alarm::EmergencyStop | Alarm::DriverFault)) => {
                self.finish_emergency(alarm, moving, line);
            }
            StopReason::Reset => self.finish_reset(moving),
            StopReason::Alarm(alarm) if self.mode == Mode::Home => self.fail_homing(alarm),
            StopReason::Alarm(alarm) => {
                if moving {
                    self.reference.lose();
                }
                self.motion.discard();
                self.interpreter.set_position(self.motion.machine_position());
                self.raise(alarm);
                if alarm == Alarm::HardLimit {
                    self.tell_trip(line);
                }
                if alarm == Alarm::Underrun {
                    if matches!(self.task, Task::JogWaits) {
                        self.lines.clear();
                    }
                    if self.task.abandon() {
                        self.say(|out| report::error(out, Error::Locked.code()));
                    }
                    self.mode = Mode::Alarm;
                } else {
                    self.say(|out| report::message(out, "Reset to continue"));
                    self.mode = Mode::Critical;
                }
            }
        }
    }

    /// Latched: only a reset ends it, and one that comes while the input is still active says so again.
    fn finish_emergency(&mut self, alarm: Alarm, moving: bool, line: u32) {
        let homing = self.mode == Mode::Home;
        let drivers_off = self.settings.is_on(Key::EmergencyDriversOff);
        // A driver at fault may have lost steps, and a motor without current does not hold.
        if moving || homing || drivers_off || alarm == Alarm::DriverFault {
            self.reference.lose();
        }
        if drivers_off {
            self.drivers.switch_off();
        } else {
            self.drivers.stay();
        }
        self.spindle_stopped = false;
        self.motion.discard();
        self.interpreter.set_position(self.motion.machine_position());
        self.raise(alarm);
        if homing && self.task.abandon() {
            self.say(report::ok);
        }
        self.tell_trip(line);
        self.say(|out| report::message(out, "Reset to continue"));
        self.mode = Mode::Critical;
    }

    /// Which inputs caused the alarm, where, and at which line.
    fn tell_trip(&mut self, line: u32) {
        if self.dialect() != Dialect::Grbl {
            let (tripped, place) = (self.tripped, self.motion.machine_position());
            let inches = self.settings.is_on(Key::ReportInches);
            self.say(|out| report::trip(out, &tripped, &place, line, inches));
        }
    }

    pub(super) fn finish_reset(&mut self, moving: bool) {
        self.motion.discard();
        self.lines.clear();
        if moving || self.mode == Mode::Home {
            let homing = self.mode == Mode::Home;
            self.reference.lose();
            self.raise(if homing { Alarm::HomingReset } else { Alarm::AbortInMotion });
            self.mode = Mode::Alarm;
        }
        if self.mode == Mode::Sleep || self.mode == Mode::Critical {
            self.mode = Mode::Alarm;
        }
        // A command that was waiting is answered before the welcome line, as Grbl does: senders count on one answer a line.
        if self.task.answers_host() {
            self.say(report::ok);
        }
        self.task = Task::None;
        self.interpreter.reset();
        if !self.mode.is_alarm() {
            self.mode = Mode::Normal;
        }
        self.initialise();
    }

    pub(super) fn raise(&mut self, alarm: Alarm) {
        self.alarm = Some(alarm);
        self.say(|out| report::alarm(out, alarm.code()));
        if alarm == Alarm::Underrun {
            self.say(|out| report::message(out, "Motion data ran out"));
        }
    }

    /// What every power-up and reset ends with.
    pub(super) fn initialise(&mut self) {
        self.ganged_motors = GangedMotors::Both;
        self.spindle = SpindleDirection::Off;
        self.spindle_speed = 0.0;
        self.spindle_stopped = false;
        self.spinning_up = None;
        self.coolant = Coolant::default();
        self.overrides = Overrides::default();
        self.motion.set_overrides(1.0, 1.0);
        self.reconfigure();
        self.interpreter.set_position(self.motion.machine_position());
        self.probed = PerAxis::default();
        self.probe_succeeded = false;
        self.rare_fields = RareFields::default();
        self.status_due = false;
        self.greet();
        if self.settings.is_on(Key::HardLimits) && self.signals.limits != 0 {
            self.mode = Mode::Alarm;
            self.say(|out| report::message(out, "Check Limits"));
        }
        if let Some((alarm, _)) = self.emergency_now() {
            self.mode = Mode::Alarm;
            self.raise(alarm);
            let still = match alarm {
                Alarm::EmergencyStop => "Emergency stop is active",
                _ => "Driver fault is active",
            };
            self.say(|out| report::message(out, still));
        }
        if self.mode == Mode::Alarm {
            self.tell_lock();
        } else {
            self.alarm = None;
            if self.signals.door {
                self.open_door();
            }
            self.task = Task::Startup(0, None);
        }
    }

    pub(super) fn tell_damage(&mut self) {
        let text = "Stored settings were damaged and some may be lost: check $$, 2 s later $X confirms";
        self.say(|out| report::message(out, text));
    }

    /// What a host has to do before the machine goes on.
    pub(super) fn tell_lock(&mut self) {
        match self.mode {
            Mode::Alarm if self.is_store_damaged() => self.tell_damage(),
            Mode::Alarm => self.say(|out| report::message(out, "'$H'|'$X' to unlock")),
            Mode::Critical => self.say(|out| report::message(out, "Reset to continue")),
            _ => {}
        }
    }
}
