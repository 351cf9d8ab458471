//! Faults of inputs, spindle and host. Settings select Oxmill's reaction to each (`$924` to `$928`).

use super::super::action::{HOST, Pin, SLOW};
use super::{Mode, Model, Work};

/// Returns the input of an alarm, as its message names it.
fn input(alarm: u8) -> &'static str {
    match alarm {
        101 => "Emergency stop",
        102 => "Driver fault",
        _ => "Limit switch",
    }
}

/// Returns the more severe of two alarms; only that one is reported.
fn heavier(one: u8, other: u8) -> u8 {
    [101, 102, 1, SLOW].into_iter().find(|alarm| [one, other].contains(alarm)).unwrap_or(one)
}

impl Model {
    /// Handles a fault of an input or of the spindle: stops the machine, at once or by braking.
    pub(super) fn fault(&mut self, alarm: u8, also: &mut Vec<Model>) {
        let braking_for = if let Mode::Fault { alarm, .. } = self.mode { Some(alarm) } else { None };
        let told = braking_for.map_or(alarm, |other| heavier(alarm, other));
        self.trusted &= alarm != 102;
        if self.setup.reaction(alarm).is_multiple_of(3) || !self.can_brake() {
            self.stop_at_once(told, also);
        } else if braking_for != Some(told) {
            self.brake_for(alarm);
        } else if let Mode::Fault { alarm: braked_for, later } = &mut self.mode {
            *later |= alarm == *braked_for;
        }
    }

    /// Returns whether a fault can make the machine brake. In other states the fault takes effect at once: during
    /// homing, and where nothing moves, as in an alarm or in sleep.
    fn can_brake(&self) -> bool {
        match self.mode {
            Mode::Free | Mode::Jog | Mode::Hold | Mode::Stop | Mode::Fault { .. } => true,
            Mode::Door { .. } => self.braking.is_some(),
            _ => false,
        }
    }

    /// Reports the input that caused the alarm. For a limit switch the message also names the axis. In Grbl's dialect
    /// there is no such message. For the alarms of host and spindle there is none, either.
    fn name_input(&mut self, alarm: u8) {
        if !self.setup.grbl && ![HOST, SLOW].contains(&alarm) {
            self.say(format!("[MSG:{}*", input(alarm)));
        }
    }

    /// Brakes for a fault: the input is reported at once, the alarm when the machine is at rest.
    fn brake_for(&mut self, alarm: u8) {
        self.name_input(alarm);
        self.brake();
        if matches!(self.mode, Mode::Door { .. }) {
            // An open door switches the spindle off at once; the coolant stays on until the machine is at rest.
            self.spindle_stopped = true;
        }
        self.mode = Mode::Fault { alarm, later: false };
        if alarm == 101 {
            self.switch_off();
        }
        if self.braking.is_none() {
            self.rest_for(alarm, false);
        }
    }

    /// Ends braking for a fault. Called when the machine has come to rest. `later`: another limit switch closed while
    /// the machine braked; this is reported after the alarm.
    pub(super) fn rest_for(&mut self, alarm: u8, later: bool) {
        self.forget_motion();
        self.say(format!("ALARM:{alarm}"));
        if later {
            self.name_input(alarm);
        }
        self.say("[MSG:Reset to continue]");
        self.lock_until_reset(alarm);
    }

    fn lock_until_reset(&mut self, alarm: u8) {
        // Outputs that a door or the operator has switched off stay off. At an open door all outputs are off.
        let at_door = self.on(Pin::Door) || matches!(self.mode, Mode::Door { .. });
        let stopped = self.spindle_stopped || self.stops_at_rest || self.outputs_off || at_door;
        if self.setup.reaction(alarm) < 3 || stopped {
            self.switch_off();
        }
        self.mode = Mode::Critical;
        self.work = self.work.take().map(|_| Work::Unanswered);
    }

    fn stop_at_once(&mut self, alarm: u8, also: &mut Vec<Model>) {
        if let Some(mut unmoved) = self.unmoved() {
            unmoved.stop_at_once(alarm, also);
            also.push(unmoved);
        }
        self.stop_dead();
        self.say(format!("ALARM:{alarm}"));
        // Oxmill: an interrupted homing cycle is answered together with the alarm. Any other line in progress is
        // answered only at the reset.
        if self.work == Some(Work::Homing) {
            self.work = None;
            self.say("ok");
        }
        self.name_input(alarm);
        self.say("[MSG:Reset to continue]");
        self.lock_until_reset(alarm);
    }

    pub(super) fn spindle_is_slow(&mut self, also: &mut Vec<Model>) {
        self.say("[MSG:The spindle has lost its speed]");
        self.fault(SLOW, also);
    }

    /// Handles a host timeout that has expired.
    pub(super) fn host_is_silent(&mut self, also: &mut Vec<Model>) {
        self.say("[MSG:The host is silent]");
        // Restart the timeout: so the silence is reported only once, and lines that follow a jog get the full timeout.
        self.heard = self.now;
        self.host_fails(also);
        if self.mode == Mode::Jog && self.braking.is_some_and(|rest| rest.from <= self.now.to) {
            // A jog that has not moved yet can end before a waiting line is read.
            let mut rested = self.clone();
            rested.braking = None;
            rested.rest(also);
            also.push(rested);
        }
    }

    /// Handles a host that has fallen silent or disconnected. A jog ends. A job either stops at once, or waits for a
    /// host and can be resumed; `$928` selects which.
    pub(super) fn host_fails(&mut self, also: &mut Vec<Model>) {
        self.end_received_jogs();
        let reaction = self.setup.reaction(HOST);
        match reaction {
            _ if self.mode != Mode::Free => self.hold(),
            0 | 3 => self.stop_at_once(HOST, also),
            4 => self.hold(),
            _ => {
                self.brake();
                self.mode = Mode::Door { restoring: None };
                self.keeps_outputs = reaction == 5;
                self.outputs_off |= self.braking.is_none() && !self.keeps_outputs;
            }
        }
    }
}
