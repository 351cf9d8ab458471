//! Feed holds, jog cancels and soft stops: motion brakes, then the job is resumed, with its spindle and laser, or
//! forgotten. Also the start of motion, and the drivers' idle delay (`$1`) at its end.
//!
//! Names: Feed holds, jog cancels and soft stops: `motion.hold` brakes, then the job is resumed (`leave_hold`), with
//! the spindle restored and the laser darkened meanwhile, or it is forgotten, as by `stop_softly` and `end_jog`. Also
//! the start of motion, and the drivers' idle delay (`$1`) at its end. In it are `feed_hold`, `cancel_jog` (`Mode::Jog`
//! is `cancelling` then), `forget_received_jogs`, `end_soft_stop`, `stop_at_error` (`Key::StopOnError`),
//! `start_motion`, `start_idle_delay`, `toggle_spindle` (`Realtime::SpindleStop`), `restore_spindle`, `darken_laser`.
//! What follows is `AfterBraking::Continue` or `Lock`; in `Mode::Home` it is `Alarm::HomingReset`.

use super::Controller;
use super::task::Task;
use crate::error::Alarm;
use crate::machine::state::{AfterBraking, Mode};
use crate::machine::stops::StopReason;
use crate::messages::Coolant;
use crate::protocol::report;
use crate::settings::Key;

impl<const N: usize> Controller<N> {
    pub(super) fn start_motion(&mut self) {
        if matches!(self.mode, Mode::Normal | Mode::Jog { .. } | Mode::Home(_)) {
            self.step_supply.start();
            self.motion.start();
        }
    }

    #[inline(never)]
    pub(super) fn start_idle_delay(&mut self) {
        self.drivers.motion_ended(self.now, self.settings.whole(Key::IdleDelay));
    }

    pub(super) fn feed_hold(&mut self) {
        match self.mode {
            Mode::Normal => {
                self.motion.hold();
                // A jog that has been read and not queued yet ends here like one that moves.
                self.task.forget_jog();
                self.task.suspend(self.now);
                self.mode = Mode::Hold;
                self.darken_laser();
            }
            Mode::Jog { .. } => {
                self.cancel_jog();
                self.forget_received_jogs();
            }
            Mode::Hold => self.accessories.leave_hold(false),
            _ => {}
        }
    }

    /// A hold or a door is over: motion, a dwell or the lines that waited continue.
    #[inline(never)]
    pub(super) fn leave_hold(&mut self) {
        self.restore_spindle();
        self.accessories.end_spin_up();
        self.mode = Mode::Normal;
        self.task.resume(self.now);
        // After a contact, or before a soft-limit alarm, there is nothing to resume.
        if !self.probe.has_touched() && !matches!(self.task, Task::SoftLimit(_)) {
            self.motion.resume();
            if !self.motion.is_idle() {
                self.start_motion();
            }
        }
        if self.motion.is_idle() {
            // The drivers have stayed on for the operator, or since the tool was parked.
            self.start_idle_delay();
        }
    }

    /// Spindle stop in a hold: at once at rest, and while the machine brakes when it comes to rest; until then a second one
    /// changes nothing, as in Grbl.
    pub(super) fn toggle_spindle(&mut self) {
        self.accessories.end_spin_up();
        if !self.motion.is_at_rest() {
            self.accessories.stop_at_rest();
        } else if self.accessories.is_suspended() {
            self.restore_spindle();
        } else {
            self.accessories.suspend();
            self.replies.overrides_changed();
        }
    }

    /// A spindle that was stopped in a hold turns again, and a cut waits until it is up to speed.
    pub(super) fn restore_spindle(&mut self) {
        if self.accessories.restore() {
            self.replies.overrides_changed();
            if matches!(self.mode, Mode::Hold) && self.accessories.is_on() {
                if !self.settings.is_on(Key::Laser) {
                    self.accessories.spin_up(self.now + self.settings.seconds(Key::SpinUp));
                }
                self.say(|out| report::message(out, "Restoring spindle"));
            }
        }
    }

    /// No beam while the machine waits.
    pub(super) fn darken_laser(&mut self) {
        if self.settings.is_on(Key::Laser) && self.accessories.is_on() {
            self.accessories.suspend();
            self.replies.overrides_changed();
        }
    }

    /// Brakes to a stop and forgets the job; the position stays true.
    pub(super) fn stop_softly(&mut self, locked: bool) {
        if matches!(self.mode, Mode::Home(_)) {
            self.stops.order(StopReason::Alarm(Alarm::HomingReset));
            return;
        }
        if matches!(self.mode, Mode::Door(_)) {
            // The door comes first; the job is forgotten when it is closed.
            self.door.forget_job();
            return;
        }
        let going = matches!(self.mode, Mode::Normal | Mode::Jog { .. } | Mode::Hold);
        if going && (!self.motion.is_idle() || !self.task.is_none() || locked || !matches!(self.mode, Mode::Normal)) {
            self.accessories.leave_hold(false);
            self.motion.hold();
            self.mode = Mode::Stopping { then: if locked { AfterBraking::Lock } else { AfterBraking::Continue } };
        } else if matches!(self.mode, Mode::Normal | Mode::Check) {
            self.interpreter.abandon_program();
        }
    }

    /// A refused line ends the job, if that is wanted.
    pub(super) fn stop_at_error(&mut self) {
        if self.settings.is_on(Key::StopOnError) && matches!(self.mode, Mode::Normal) {
            self.stop_softly(true);
        }
    }

    #[inline(never)]
    pub(super) fn end_soft_stop(&mut self, locked: bool) {
        self.motion.discard();
        self.forget_waiting_outputs();
        self.step_supply.end();
        self.probe.break_off();
        self.door.take_jog();
        self.interpreter.set_position(self.motion.machine_position());
        self.start_idle_delay();
        // A beam must not rest on one point, a locked machine does not turn, and no cut waits any more for a spindle that is
        // getting up; else the spindle stays as it is.
        let turns = !self.accessories.is_suspended() && !self.is_spinning_up() && !self.task.waits_for_spindle();
        self.accessories.end_spin_up();
        if locked || !turns || self.settings.is_on(Key::Laser) {
            self.accessories.stop_spindle();
        }
        if locked {
            self.accessories.set_coolant(Coolant::default());
        }
        self.accessories.restore();
        self.interpreter.set_accessories(self.accessories.spindle(), self.accessories.coolant());
        self.replies.overrides_changed();
        self.interpreter.abandon_program();
        if self.task.abandon() {
            self.say_ok();
        }
        self.mode = if locked { Mode::Alarm(None) } else { Mode::Normal };
        if locked {
            self.say(|out| report::message(out, "Job stopped at an error, $X to go on"));
        }
    }

    pub(super) fn cancel_jog(&mut self) {
        self.motion.hold();
        self.task.forget_jog();
        self.mode = Mode::Jog { cancelling: true };
    }

    /// A hold or a door has no epoch of its own: of what has been received by now no jog shall move any more.
    pub(super) fn forget_received_jogs(&mut self) {
        self.lines.end_received_jogs(self.step_supply.observed().received);
    }

    /// A jog that has come to its end leaves the position at its target, not at the step next to that: small jogs add up.
    #[inline(never)]
    pub(super) fn end_jog(&mut self, cancelled: bool) {
        if cancelled {
            self.motion.discard();
            self.task.forget_jog();
            self.interpreter.set_position(self.motion.machine_position());
        }
        self.mode = Mode::Normal;
        self.step_supply.end();
        self.start_idle_delay();
    }
}
