//! Realtime commands: what a byte that no line holds back does to the state.

use super::cycles::{self, Probing};
use super::execute::Task;
use super::{Controller, StopReason};
use crate::error::Alarm;
use crate::gcode::Dialect;
use crate::machine::realtime_override::Overrides;
use crate::machine::state::{Door, Mode};
use crate::messages::{Coolant, Realtime, SpindleDirection};
use crate::protocol::report;
use crate::settings::Key;
use crate::units::Duration;

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    pub(super) fn realtime(&mut self, command: Realtime) {
        match command {
            Realtime::Reset => {
                self.lines.reset();
                self.begin_stop(StopReason::Reset);
                self.release_held();
            }
            // Grbl knows no such byte and drops it.
            Realtime::Stop if self.dialect() == Dialect::Grbl => {
                self.lines.open_epoch();
                self.release_held();
            }
            Realtime::Stop => {
                self.lines.reset();
                self.stop_softly(false);
                self.release_held();
            }
            Realtime::Status => self.status_due = true,
            Realtime::CycleStart => self.cycle_start(),
            Realtime::FeedHold => self.feed_hold(),
            Realtime::SafetyDoor => self.open_door(),
            Realtime::JogCancel => {
                self.lines.cancel_jogs();
                if self.mode == (Mode::Jog { cancelling: false }) {
                    self.cancel_jog();
                }
                // One that has been read and not queued yet has no mode of its own.
                self.task.forget_jog();
                self.release_held();
            }
            Realtime::SpindleStop => {
                if self.mode == Mode::Hold && self.spindle != SpindleDirection::Off && self.motion.is_at_rest() {
                    self.spinning_up = None;
                    if self.spindle_stopped {
                        self.restore_spindle();
                    } else {
                        self.spindle_stopped = true;
                        self.rare_fields.overrides_changed();
                    }
                }
            }
            Realtime::FloodToggle => self.toggle_coolant(|c| c.flood = !c.flood),
            Realtime::MistToggle if self.dialect() != Dialect::Grbl => self.toggle_coolant(|c| c.mist = !c.mist),
            Realtime::MistToggle => {}
            _ => self.set_overrides(self.overrides.after(command)),
        }
    }

    fn toggle_coolant(&mut self, change: impl FnOnce(&mut Coolant)) {
        if matches!(self.mode, Mode::Normal | Mode::Hold) {
            change(&mut self.coolant);
            self.interpreter.set_accessories(self.spindle, self.coolant);
            self.rare_fields.overrides_changed();
        }
    }

    fn set_overrides(&mut self, overrides: Overrides) {
        if overrides != self.overrides {
            self.overrides = overrides;
            self.motion.set_overrides(f32::from(overrides.feed) / 100.0, f32::from(overrides.rapid) / 100.0);
            self.rare_fields.overrides_changed();
        }
    }

    pub(super) fn cycle_start(&mut self) {
        match self.mode {
            Mode::Normal => self.start_motion(),
            Mode::Hold if self.spinning_up.is_some() => {}
            Mode::Hold if self.motion.is_at_rest() => {
                let delay = self.settings.seconds(Key::SpinUp);
                let spin_up = self.spindle_stopped && self.spindle != SpindleDirection::Off;
                self.restore_spindle();
                if spin_up
                    && !self.settings.is_on(Key::Laser)
                    && (delay > Duration::from_ticks(0) || !self.is_at_speed())
                {
                    self.spinning_up = Some(self.now + delay);
                } else {
                    self.leave_hold();
                }
            }
            Mode::Door(Door::Parked) => self.close_door(),
            _ => {}
        }
    }

    /// A hold or a door is over: motion, a dwell or the lines that waited go on.
    #[inline(never)]
    pub(super) fn leave_hold(&mut self) {
        self.restore_spindle();
        self.mode = Mode::Normal;
        self.task.resume(self.now);
        // After a contact, or on the way to a soft-limit alarm, there is nothing to go on with.
        let touched = matches!(self.probing, Some(Probing::Braking | Probing::Touched));
        if !touched && !matches!(self.task, Task::SoftLimit) {
            self.motion.resume();
            if !self.motion.is_idle() {
                self.start_motion();
            }
        }
    }

    /// A spindle that was stopped in a hold turns again.
    pub(super) fn restore_spindle(&mut self) {
        if self.spindle_stopped {
            self.spindle_stopped = false;
            self.rare_fields.overrides_changed();
            if self.mode == Mode::Hold && self.spindle != SpindleDirection::Off {
                self.say(|out| report::message(out, "Restoring spindle"));
            }
        }
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
            Mode::Hold => self.spinning_up = None,
            _ => {}
        }
    }

    /// No beam while the machine waits.
    pub(super) fn darken_laser(&mut self) {
        if self.settings.is_on(Key::Laser) && self.spindle != SpindleDirection::Off {
            self.spindle_stopped = true;
            self.rare_fields.overrides_changed();
        }
    }

    /// Brakes to a stop and forgets the job; the position stays true.
    pub(super) fn stop_softly(&mut self, locked: bool) {
        if self.mode == Mode::Home {
            self.order_stop(StopReason::Alarm(Alarm::HomingReset));
            return;
        }
        if matches!(self.mode, Mode::Door(_)) {
            // The door goes on as it must; the job is forgotten when it is closed.
            self.door.forget_job = true;
            return;
        }
        let going = matches!(self.mode, Mode::Normal | Mode::Jog { .. } | Mode::Hold);
        if going && (!self.motion.is_idle() || !self.task.is_none() || locked || self.mode != Mode::Normal) {
            self.spinning_up = None;
            self.motion.hold();
            self.mode = Mode::Stopping { locked };
        }
    }

    #[inline(never)]
    pub(super) fn end_soft_stop(&mut self, locked: bool) {
        self.motion.discard();
        self.running = false;
        self.probing = None;
        self.jog_interrupted = false;
        self.probe_watch = Some(cycles::WATCH_ENDS);
        self.interpreter.set_position(self.motion.machine_position());
        self.start_idle_delay();
        // A beam does not stand still, and a locked machine does not turn; else the spindle stays as it is.
        if locked || self.settings.is_on(Key::Laser) || self.spindle_stopped {
            self.spindle = SpindleDirection::Off;
        }
        if locked {
            self.coolant = Coolant::default();
        }
        self.spindle_stopped = false;
        self.interpreter.set_accessories(self.spindle, self.coolant);
        self.rare_fields.overrides_changed();
        if self.task.abandon() {
            self.say(report::ok);
        }
        self.mode = if locked { Mode::Alarm } else { Mode::Normal };
        if locked {
            self.say(|out| report::message(out, "Job stopped at an error, $X to go on"));
        }
        if self.signals.door {
            self.open_door();
        }
    }

    pub(super) fn cancel_jog(&mut self) {
        self.motion.hold();
        self.task.forget_jog();
        self.mode = Mode::Jog { cancelling: true };
    }

    /// A hold or a door has no epoch of its own: of what has been received by now no jog shall move any more.
    pub(super) fn forget_received_jogs(&mut self) {
        self.lines.end_received_jogs(self.observed.received);
    }

    #[inline(never)]
    pub(super) fn end_jog(&mut self) {
        self.motion.discard();
        self.task.forget_jog();
        self.interpreter.set_position(self.motion.machine_position());
        self.mode = Mode::Normal;
        self.running = false;
        self.start_idle_delay();
    }

    /// Nobody is there to stop what moves or to see where it goes: it is held if `$914` says so. A jog ends either way, as
    /// the key that would end it has no wire any more.
    pub(super) fn host_left(&mut self) {
        let at_work = self.running || !self.motion.is_idle() || !self.task.is_none();
        match self.mode {
            Mode::Jog { .. } => {
                self.cancel_jog();
                self.forget_received_jogs();
            }
            Mode::Normal if at_work && self.settings.is_on(Key::HoldWithoutHost) => self.feed_hold(),
            _ => {}
        }
    }
}
