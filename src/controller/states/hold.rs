//! Feed hold, jog cancel and soft stop: motion brakes, then the job resumes or is dropped. [`Hold`] records whether the
//! spindle was switched on again in the hold. If so, the hold ends only when the spindle is up to speed. Motion is also
//! started here.

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::gcode::Dialect;
use crate::messages::Coolant;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::stops::orders::StopReason;
use crate::states::{AfterBraking, State};
use crate::units::Instant;
use crate::work::line::Message;
use crate::work::task::Task;

/// A feed hold, by the operator or by the program (M0, a tool change).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hold {
    /// End of the spin-up time (`$394`), if the spindle was switched on again in this hold.
    turns_at: Option<Instant>,
    /// `~` was received: the hold ends when the spindle is up to speed.
    leaves: bool,
}

impl Hold {
    pub(crate) const BEGUN: Hold = Hold { turns_at: None, leaves: false };

    /// Returns the end of the spin-up time if `~` was received and the hold waits for the spindle; otherwise `None`.
    pub(crate) fn ends_with_spindle(&self) -> Option<Instant> {
        self.turns_at.filter(|_| self.leaves)
    }
}

impl<const N: usize> Controller<N> {
    pub(crate) fn start_motion(&mut self) {
        if matches!(self.state, State::Normal | State::Jog { .. } | State::Homing(_)) {
            self.m.start_motion();
        }
    }

    pub(crate) fn feed_hold(&mut self) {
        self.forget_received_jogs();
        match self.state {
            State::Normal => {
                self.m.motion.hold();
                // A jog that waits for room in the look-ahead is dropped here, because a hold ends any jog.
                self.task.forget_jog();
                self.task.suspend(self.m.now);
                self.enter(State::Hold(Hold::BEGUN));
                self.darken_laser();
            }
            State::Jog { .. } => self.cancel_jog(),
            State::Hold(hold) => self.enter(State::Hold(Hold { leaves: false, ..hold })),
            _ => {}
        }
    }

    /// Ends a hold or a door: motion, a dwell or waiting lines continue.
    #[inline(never)]
    pub(crate) fn leave_hold(&mut self) {
        self.restore_spindle();
        self.enter(State::Normal);
        self.task.resume(self.m.now);
        // After a contact of the probe, or before a soft-limit alarm, there is nothing to resume.
        if !self.m.probe.has_touched() && !matches!(self.task, Task::SoftLimit(_)) {
            self.m.motion.resume();
            if !self.m.motion.is_idle() {
                self.start_motion();
            }
        }
        if self.m.motion.is_idle() {
            // The drivers have stayed on during the hold, or while the tool was parked. Their idle delay (`$1`) starts
            // now.
            self.m.start_idle_delay();
        }
    }

    /// Toggles the spindle in a hold (0x9E). At rest this acts at once. While the machine brakes, the spindle stops
    /// when the machine comes to rest; a second command before that changes nothing, as in Grbl.
    pub(crate) fn toggle_spindle(&mut self) {
        self.enter(State::Hold(Hold::BEGUN));
        if !self.m.motion.is_at_rest() {
            self.m.accessories.stop_at_rest();
        } else if self.m.accessories.is_suspended() {
            self.restore_spindle();
        } else {
            self.m.accessories.suspend();
            self.m.replies.overrides_changed();
        }
    }

    /// Switches a stopped spindle on again. In a hold, the next cut then waits until the spindle is up to speed.
    pub(crate) fn restore_spindle(&mut self) {
        if self.m.accessories.restore() {
            self.m.replies.overrides_changed();
            if let State::Hold(hold) = self.state
                && self.m.accessories.is_on()
            {
                if !self.m.settings.is_on(Key::Laser) {
                    let turns_at = self.m.now + self.m.settings.seconds(Key::SpinUp);
                    self.enter(State::Hold(Hold { turns_at: Some(turns_at), ..hold }));
                }
                self.say(|out| reply_texts::message(out, "Restoring spindle"));
            }
        }
    }

    /// Handles `~` in a hold: ends the hold. If a spindle that was switched on again is not up to speed yet, the hold
    /// ends later, when it is.
    pub(crate) fn end_hold(&mut self) {
        self.restore_spindle();
        match self.state {
            State::Hold(hold) if self.is_spinning_up() => self.enter(State::Hold(Hold { leaves: true, ..hold })),
            _ => self.leave_hold(),
        }
    }

    /// Returns whether a spindle that was switched on again in this hold is not up to speed yet.
    fn is_spinning_up(&self) -> bool {
        let State::Hold(Hold { turns_at: Some(turns_at), .. }) = self.state else { return false };
        self.m.now < turns_at || !self.has_speed()
    }

    /// Switches a laser off while the machine waits.
    pub(crate) fn darken_laser(&mut self) {
        if self.m.settings.is_on(Key::Laser) && self.m.accessories.is_on() {
            self.m.accessories.suspend();
            self.m.replies.overrides_changed();
        }
    }

    /// Brakes to a stop and drops the job; the position stays trusted. `locked`: the machine is locked once it is at
    /// rest.
    pub(crate) fn stop_softly(&mut self, locked: bool) {
        if matches!(self.state, State::Homing(_)) {
            self.m.stops.order(StopReason::Alarm(Alarm::HomingReset));
            return;
        }
        if let State::Door(door) = &mut self.state {
            // An open door takes precedence. The job is dropped later: after `~` at the closed door, when the tool is
            // back.
            return door.stop_job();
        }
        let going = matches!(self.state, State::Normal | State::Jog { .. } | State::Hold(_));
        if going && (!self.m.motion.is_idle() || !self.task.is_none() || locked || !matches!(self.state, State::Normal))
        {
            if self.is_spinning_up() {
                // The spindle spins up only for the cut that is dropped here, so switch it off.
                self.m.accessories.stop_spindle();
            }
            self.m.motion.hold();
            self.enter(State::Braking { then: if locked { AfterBraking::Lock } else { AfterBraking::Continue } });
        } else if matches!(self.state, State::Normal | State::Check) {
            self.m.interpreter.abandon_program();
        }
    }

    /// Ends the job at a refused line if `$901` is on, or if the line would have prompted the operator for another tool
    /// (`asks_for_tool`). In the second case the lines after it are meant for that tool.
    pub(crate) fn stop_at_error(&mut self, asks_for_tool: bool) {
        let lacks_tool = asks_for_tool && self.m.prompts_for_tools() && self.dialect() != Dialect::Grbl;
        if matches!(self.state, State::Normal) && (lacks_tool || self.m.settings.is_on(Key::StopOnError)) {
            self.stop_softly(true);
        }
    }

    #[inline(never)]
    pub(crate) fn end_soft_stop(&mut self, locked: bool) {
        self.m.motion.discard();
        self.forget_waiting_outputs();
        self.m.step_supply.end();
        self.m.probe.break_off();
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.m.start_idle_delay();
        // The spindle stops in four cases: it is a laser, which would burn one point; the machine is locked; the
        // spindle is suspended; or it spins up for a cut that is dropped. Otherwise it stays as it is.
        let turns = !self.m.accessories.is_suspended() && !self.task.waits_for_spindle();
        if locked || !turns || self.m.settings.is_on(Key::Laser) {
            self.m.accessories.stop_spindle();
        }
        if locked {
            self.m.accessories.set_coolant(Coolant::default());
        }
        self.m.accessories.restore();
        self.m.interpreter.set_accessories(self.m.accessories.spindle(), self.m.accessories.coolant());
        self.m.replies.overrides_changed();
        self.m.interpreter.abandon_program();
        self.line.keep_message(Message::new());
        if self.task.abandon() {
            self.say_ok();
        }
        self.enter(if locked { State::Alarm(None) } else { State::Normal });
        if locked {
            self.say(|out| reply_texts::message(out, "Job ended at an error, unlock with $X"));
        }
    }

    pub(crate) fn cancel_jog(&mut self) {
        self.m.motion.hold();
        self.task.forget_jog();
        self.enter(State::Jog { cancelling: true });
    }

    /// Makes the controller skip the jogs among the line bytes received so far. A hold or a door, unlike a reset or a
    /// jog cancel, begins no epoch that marks later bytes (see `protocol::intake`). So the bytes received so far are
    /// counted. In Grbl's dialect this has an effect only while a jog moves.
    pub(crate) fn forget_received_jogs(&mut self) {
        if self.dialect() != Dialect::Grbl || matches!(self.state, State::Jog { .. }) {
            self.m.lines.end_received_jogs(self.m.step_supply.observed().received);
        }
    }

    /// Ends a jog. The next jog starts from the exact target of this one, not from the nearest step, so that small
    /// jogs add up. After a cancelled jog, it starts from the position where the machine has stopped.
    #[inline(never)]
    pub(crate) fn end_jog(&mut self, cancelled: bool) {
        if cancelled {
            self.m.motion.discard();
            self.task.forget_jog();
            self.m.interpreter.set_position(self.m.motion.machine_position());
        }
        self.enter(State::Normal);
        self.m.step_supply.end();
        self.m.start_idle_delay();
    }
}
