//! Holds, doors, alarms and resets: what brakes, what is dropped, and what continues.

use super::super::action::{self, Line, Pin};
use super::{Mode, Model, RESTORE, SLACK, Span, Work};

impl Model {
    /// Begins to stop the motion, and interrupts a dwell. Without a motion nothing brakes.
    pub(super) fn brake(&mut self) {
        let now = self.now;
        if let Some(motion) = self.motion.as_mut().filter(|motion| !motion.held) {
            let ramp = motion.speed / action::ACCELERATION;
            motion.held = true;
            let rests = !motion.stepped || motion.time.from <= now.to;
            self.braking = Some(now.plus(Span { from: if rests { 0.0 } else { 0.0005 }, to: ramp + SLACK }));
            motion.time = Span {
                from: (motion.time.from - now.to - ramp - SLACK).max(0.0),
                to: motion.time.to - now.from + ramp + SLACK,
            };
            self.place = [None; 3];
        }
        if let Some(Work::Dwell { time, held: held @ false }) = &mut self.work {
            *held = true;
            *time = Span { from: (time.from - now.to).max(0.0), to: time.to - now.from };
        }
    }

    /// Drops the queued motion. If it was in progress, the position becomes unknown.
    pub(super) fn forget_motion(&mut self) {
        self.forgets = false;
        if self.motion.take().is_some_and(|motion| !motion.held) {
            self.place = [None; 3];
        }
    }

    /// Called when a motion that was stopped has come to rest.
    pub(super) fn rest(&mut self, also: &mut Vec<Model>) {
        self.spindle_stopped |= std::mem::take(&mut self.stops_at_rest);
        if let Mode::Fault { alarm, later } = self.mode {
            return self.rest_for(alarm, later);
        }
        if self.work == Some(Work::Forbidden) {
            self.forget_motion();
            if self.mode == Mode::Free {
                return self.lock_for(2);
            }
        }
        match self.mode {
            Mode::Jog | Mode::Stop => {
                self.forget_motion();
                // A spindle that the operator has stopped stays off.
                self.spindle &= !std::mem::take(&mut self.spindle_stopped);
                let jogs = self.mode == Mode::Jog;
                self.mode = Mode::Free;
                match self.work.take() {
                    Some(Work::LaterJog(line)) if jogs => self.line(line, also),
                    Some(_) => self.say("ok"),
                    None => {}
                }
                self.read(also);
            }
            Mode::Door { .. } => {
                if self.forgets {
                    self.forget_motion();
                }
                self.outputs_off = !self.keeps_outputs;
                self.spindle_stopped &= self.keeps_outputs;
            }
            _ => {}
        }
    }

    /// Resumes the motion and the line in progress after a hold or a door.
    pub(super) fn go_on(&mut self, also: &mut Vec<Model>) {
        let now = self.now;
        if self.motion.as_ref().is_some_and(|motion| motion.time.from <= 0.0) {
            // The motion can have reached its end while it braked.
            let mut ended = self.clone();
            ended.place = ended.target();
            ended.motion = None;
            if matches!(ended.work, Some(Work::Drain(_) | Work::SingleBlock)) {
                ended.mode = Mode::Free;
                ended.outputs_off = false;
                ended.end_single_block();
                ended.motion_has_ended();
                ended.read(also);
            } else {
                ended.go_on(also);
            }
            also.push(ended);
        }
        self.mode = Mode::Free;
        self.outputs_off = false;
        if let Some(motion) = &mut self.motion {
            motion.held = false;
            motion.stepped = false;
            motion.time = now.plus(motion.time);
        }
        self.end_single_block();
        match &mut self.work {
            Some(Work::Forbidden) => return self.lock_for(2),
            Some(Work::Dwell { time, held }) => {
                *held = false;
                *time = now.plus(*time);
            }
            Some(Work::Pause) => {
                self.work = None;
                self.say("ok");
            }
            Some(Work::Tool { tool, spindle }) => {
                self.tool = *tool;
                self.selected = *tool;
                self.spindle = *spindle;
                self.work = None;
                self.say("ok");
            }
            Some(Work::LaterJog(line)) => {
                let line = *line;
                self.work = None;
                self.line(line, also);
            }
            _ => {}
        }
        if self.absent && self.motion.is_some() {
            self.host_fails(also);
        }
        self.read(also);
    }

    /// Handles a host that disconnects. Oxmill: a jog ends, and during a job this is a fault. If the job is being
    /// resumed after a door, the fault takes effect when the motion continues.
    pub(super) fn host_goes(&mut self, also: &mut Vec<Model>) {
        self.absent = matches!(self.mode, Mode::Door { restoring: Some(_) });
        if self.motion.is_some() && matches!(self.mode, Mode::Free | Mode::Jog) {
            self.host_fails(also);
        }
    }

    /// Handles another host that has connected: sends the greeting, and messages about an alarm or about state that no
    /// report shows.
    pub(super) fn host_comes(&mut self) {
        self.absent = false;
        self.said.clear();
        self.say("");
        self.say("Grbl 1.1h ['$' for help]");
        match self.mode {
            Mode::Alarm => self.say("[MSG:'$H'|'$X' to unlock]"),
            Mode::Critical => self.say("[MSG:Reset to continue]"),
            _ => {}
        }
        if !self.setup.grbl {
            self.tell_inherited();
        }
    }

    /// Oxmill: sends messages to the new host about state that no report shows.
    fn tell_inherited(&mut self) {
        if self.single_block {
            self.say("[MSG:Single block on]");
        }
        match self.mode {
            Mode::Check => self.say("[MSG:Enabled]"),
            Mode::Sleep => self.say("[MSG:Sleeping]"),
            Mode::Door { restoring: None } => self.say("[MSG:Check Door]"),
            _ => {}
        }
    }

    /// Raises an alarm after which only a reset is accepted.
    pub(super) fn lock_for(&mut self, alarm: u8) {
        self.say(format!("ALARM:{alarm}"));
        self.say("[MSG:Reset to continue]");
        self.wait_for_reset();
    }

    pub(super) fn wait_for_reset(&mut self) {
        self.mode = Mode::Critical;
        self.work = self.work.take().map(|_| Work::Unanswered);
        self.switch_off();
    }

    /// Ends all motion without braking. If the machine was moving, its position becomes unknown and is not trusted.
    pub(super) fn stop_dead(&mut self) {
        if self.moves() {
            self.place = [None; 3];
            self.trusted = false;
        }
        self.braking = None;
        self.motion = None;
        self.forgets = false;
    }

    pub(super) fn switch_off(&mut self) {
        self.given = None;
        self.spindle = false;
        self.spindle_stopped = false;
        self.stops_at_rest = false;
        self.flood = false;
        self.outputs_off = false;
    }

    /// Returns a copy of the model in which the motion has not moved the machine yet. `None` if no queued motion is
    /// in progress, or if a step of it has been seen.
    pub(super) fn unmoved(&self) -> Option<Model> {
        let may_be = self.moves() && self.motion.as_ref().is_some_and(|motion| !motion.stepped);
        may_be.then(|| Model { motion: None, braking: None, place: [None; 3], ..self.clone() })
    }

    /// Handles a reset (0x18 or the reset pin). Only the position and the loaded tool are kept. The reset causes alarm
    /// 3 during motion, and alarm 6 during homing.
    pub(super) fn reset(&mut self, also: &mut Vec<Model>) {
        if let Some(mut unmoved) = self.unmoved() {
            unmoved.reset(also);
            also.push(unmoved);
        }
        let alarm = match self.mode {
            Mode::Home(_) => Some(6),
            Mode::Critical => None,
            _ => self.moves().then_some(3),
        };
        self.drop_lines();
        self.end_all(alarm);
        self.initialise(alarm.is_some() || matches!(self.mode, Mode::Alarm | Mode::Critical | Mode::Sleep), also);
    }

    pub(super) fn drop_lines(&mut self) {
        self.waiting.clear();
        self.cancelled = 0;
    }

    /// Ends a homing cycle that has failed; the effects are those of a reset. Oxmill: waiting lines are answered in the
    /// alarm that follows.
    pub(super) fn fail_homing(&mut self, alarm: u8, also: &mut Vec<Model>) {
        self.end_all(Some(alarm));
        self.initialise(true, also);
        self.read(also);
    }

    pub(super) fn end_all(&mut self, alarm: Option<u8>) {
        if let Some(alarm) = alarm {
            self.say(format!("ALARM:{alarm}"));
        }
        self.stop_dead();
        if self.work.take().is_some() {
            self.say("ok");
        }
    }

    /// Does what all resets have in common: switches the outputs off, sets the overrides to 100 %, and sends the
    /// greeting. `locked`: the machine starts in an alarm that `$X` or `$H` ends.
    pub(super) fn initialise(&mut self, mut locked: bool, also: &mut Vec<Model>) {
        self.switch_off();
        self.overrides = [100; 3];
        self.single_block = false;
        self.selected = self.tool;
        self.mode = Mode::Free;
        self.checked = None;
        self.say("");
        self.say("Grbl 1.1h ['$' for help]");
        if self.setup.hard_limits && self.pins[..3].contains(&true) {
            self.say("[MSG:Check Limits]");
            locked = true;
        }
        // Oxmill: an active emergency stop or driver fault keeps the machine locked.
        for (pin, alarm, text) in [(Pin::EmergencyStop, 101, "Emergency stop"), (Pin::DriverFault, 102, "Driver fault")]
        {
            if self.on(pin) {
                self.say(format!("ALARM:{alarm}"));
                if !self.setup.grbl {
                    self.say(format!("[MSG:{text} is active]"));
                }
                locked = true;
            }
        }
        if locked {
            self.mode = Mode::Alarm;
            self.say("[MSG:'$H'|'$X' to unlock]");
        } else if self.on(Pin::Door) {
            self.door_opens(also);
        }
    }

    /// Cancels all jogs that have been received but have not started. They are answered as if they had been carried
    /// out. Oxmill: each event that ends a jog also cancels these, even if they wait while the machine brakes for a
    /// hold. `keeps_later_jogs`: `true` if a jog that arrives later still runs (after 0x85).
    pub(super) fn end_jogs(&mut self, keeps_later_jogs: bool) {
        self.cancelled = self.waiting.len();
        self.keeps_later_jogs = keeps_later_jogs;
        if matches!(self.work, Some(Work::LaterJog(Line::Jog(..) | Line::JogOutside))) {
            self.work = Some(Work::Pause);
        }
    }

    pub(super) fn hold(&mut self) {
        self.end_received_jogs();
        match self.mode {
            Mode::Free => {
                self.brake();
                self.mode = Mode::Hold;
            }
            Mode::Jog => self.brake(),
            _ => {}
        }
    }

    /// Ends jogs at a hold or a door. Oxmill: this also ends jogs that have not started. In Grbl these run after the
    /// hold.
    pub(super) fn end_received_jogs(&mut self) {
        if self.mode == Mode::Jog || !self.setup.grbl {
            self.end_jogs(false);
        }
    }

    pub(super) fn door_opens(&mut self, also: &mut Vec<Model>) {
        self.end_received_jogs();
        match self.mode {
            Mode::Free | Mode::Jog | Mode::Hold | Mode::Stop => {
                self.brake();
                self.forgets = matches!(self.mode, Mode::Jog | Mode::Stop);
                if self.mode == Mode::Stop {
                    self.work = self.work.take().map(|_| Work::Pause);
                }
                if self.forgets && self.braking.is_none() {
                    self.motion = None;
                }
            }
            Mode::Door { .. } => {}
            // Oxmill: an open door switches off a spindle that a fault has left on.
            Mode::Fault { .. } | Mode::Critical => return self.switch_off(),
            Mode::Home(_) => return self.fail_homing(7, also),
            Mode::Alarm | Mode::Check | Mode::Sleep => return,
        }
        self.mode = Mode::Door { restoring: None };
        self.keeps_outputs = false;
        self.outputs_off |= self.braking.is_none();
        self.spindle_stopped &= self.braking.is_some();
        self.say("[MSG:Check Door]");
    }

    pub(super) fn start(&mut self, also: &mut Vec<Model>) {
        match self.mode {
            Mode::Hold if self.braking.is_none() => {
                self.restore_spindle();
                self.go_on(also);
            }
            Mode::Door { restoring: None } if self.braking.is_none() && !self.on(Pin::Door) => {
                // Oxmill: the delays after a door also apply if a fault has left the outputs on.
                let seconds =
                    RESTORE[0] * f64::from(u8::from(self.spindle)) + RESTORE[1] * f64::from(u8::from(self.flood));
                self.outputs_off = false;
                if seconds > 0.0 {
                    self.mode = Mode::Door { restoring: Some(self.now.plus(Span::length(seconds, 0.0))) };
                } else {
                    self.go_on(also);
                }
            }
            _ => {}
        }
    }

    pub(super) fn restore_spindle(&mut self) {
        if self.spindle_stopped {
            self.spindle_stopped = false;
            self.say("[MSG:Restoring spindle]");
        }
    }
}
