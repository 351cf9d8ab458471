//! Faults, of inputs, of the spindle and of the host: Oxmill stops for each as its setting says.

use super::super::action::{HOST, Pin, SLOW};
use super::{Mode, Model, Work};

/// The input of an alarm, as its message names it.
fn input(alarm: u8) -> &'static str {
    match alarm {
        101 => "Emergency stop",
        102 => "Driver fault",
        _ => "Limit switch",
    }
}

/// Of several faults the heaviest is told.
fn heavier(one: u8, other: u8) -> u8 {
    [101, 102, 1, SLOW].into_iter().find(|alarm| [one, other].contains(alarm)).unwrap_or(one)
}

impl Model {
    /// An input stops everything, at once or within the accelerations.
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

    /// Homing and what is not a motion of lines have no room to brake.
    fn can_brake(&self) -> bool {
        match self.mode {
            Mode::Free | Mode::Jog | Mode::Hold | Mode::Stop | Mode::Fault { .. } => true,
            Mode::Door { .. } => self.braking.is_some(),
            _ => false,
        }
    }

    /// It says which input and where, if not in Grbl's dialect.
    fn name_input(&mut self, alarm: u8) {
        if !self.setup.grbl && ![HOST, SLOW].contains(&alarm) {
            self.say(format!("[MSG:{}*", input(alarm)));
        }
    }

    /// The input is named at once, the alarm follows at rest.
    fn brake_for(&mut self, alarm: u8) {
        self.name_input(alarm);
        self.brake();
        if matches!(self.mode, Mode::Door { .. }) {
            // No spindle turns there; the coolant flows until the machine rests.
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

    /// A machine that braked for a fault has come to rest.
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
        // What a door or the operator has stopped stays off; and at an open door nothing stays on.
        let at_door = self.on(Pin::Door) || matches!(self.mode, Mode::Door { .. });
        let stopped = self.spindle_stopped || self.stops_at_rest || self.outputs_off || at_door;
        if self.setup.reaction(alarm) < 3 || stopped {
            self.switch_off();
        }
        self.mode = Mode::Critical;
        self.work = self.work.take().map(|_| Work::Owed);
    }

    fn stop_at_once(&mut self, alarm: u8, also: &mut Vec<Model>) {
        if let Some(mut unmoved) = self.unmoved() {
            unmoved.stop_at_once(alarm, also);
            also.push(unmoved);
        }
        self.stop_dead();
        self.say(format!("ALARM:{alarm}"));
        // Oxmill: a homing cycle is answered at once, any other line when the reset comes.
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

    /// It has not been heard for too long.
    pub(super) fn host_is_silent(&mut self, also: &mut Vec<Model>) {
        self.say("[MSG:The host is silent]");
        // It is told once; for lines behind a jog the time begins again.
        self.heard = self.now;
        self.host_fails(also);
        if self.mode == Mode::Jog && self.braking.is_some_and(|rest| rest.from <= self.now.to) {
            // A jog that has not moved may be over before a line that waits is read.
            let mut rested = self.clone();
            rested.braking = None;
            rested.rest(also);
            also.push(rested);
        }
    }

    /// A job waits for a host, and can be resumed; a jog ends.
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
