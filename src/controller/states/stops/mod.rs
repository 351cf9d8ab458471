//! Handles a stop of the step task. Depending on the reason of the stop, the machine is locked or reset, or homing or
//! probing continues. A stop at speed may have lost steps, so the position is no longer trusted afterwards.

mod faults;
pub(crate) mod orders;
pub(crate) mod reaction;

use crate::axes::PerAxis;
use crate::dispatch::Controller;
use crate::error::{Alarm, Error};
use crate::machine::spindle::SpindleRange;
use crate::messages::StepEvent;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::State;
use crate::states::stops::orders::{Finished, StopReason};
use crate::work::task::Task;

impl<const N: usize> Controller<N> {
    /// Stops the step task because of an input. If the input has already stopped the step task, records the reason of
    /// that stop.
    pub(crate) fn stop_for(&mut self, reason: StopReason, stopped: &mut Stopped) {
        if stopped.already {
            stopped.answered = true;
            self.m.stops.wait_for(reason);
            self.finish_stop();
        } else {
            self.m.stops.order(reason);
        }
    }

    pub(crate) fn step_event(&mut self, event: &StepEvent<N>) {
        match *event {
            StepEvent::Stopped { stops, moving, position } => {
                if moving && !matches!(self.state, State::Homing(_)) {
                    self.keep_speed();
                }
                self.m.stops.record_stop(stops, moving, self.m.motion.line_number());
                self.stopped_at(&position);
            }
            StepEvent::Probed { position } => {
                self.m.probe.contact(|| self.m.motion.position_of_counter(&position));
                return;
            }
            StepEvent::Underrun { stops, position } => {
                self.await_what_brakes(Alarm::Underrun);
                self.m.stops.record_failure(stops, Alarm::Underrun);
                self.stopped_at(&position);
            }
            StepEvent::Miscounted { stops, position } => {
                self.await_what_brakes(Alarm::Miscounted);
                self.m.stops.record_failure(stops, Alarm::Miscounted);
                self.stopped_at(&position);
            }
        }
        self.finish_stop();
    }

    /// Handles a failure of the step task while the machine is already stopping or braking for another reason. If that
    /// reason is at least as serious as the failure, it will be reported in place of the failure.
    fn await_what_brakes(&mut self, failure: Alarm) {
        if let Some(reason) = self.stop_under_way()
            && reason.heavier(StopReason::Alarm(failure)) == reason
        {
            self.m.stops.wait_for(reason);
        }
    }

    /// Sets the spindle to the speed (S) of the move in execution. The S read last can belong to a later line, which
    /// will not be executed. A spindle that stays on must not change to that S.
    pub(crate) fn keep_speed(&mut self) {
        if let Some(power) = self.m.motion.running_power() {
            self.m.accessories.set_speed(SpindleRange::of(&self.m.settings).speed_of(power));
        }
    }

    fn stopped_at(&mut self, position: &PerAxis<i32, N>) {
        self.m.motion.stopped(position);
        self.m.parking.stopped(position, &mut self.m.motion);
    }

    /// Handles a stop once all requested stops have happened.
    pub(crate) fn finish_stop(&mut self) {
        let Some(stop) = self.m.stops.finish() else { return };
        self.m.step_supply.end();
        self.m.probe.stopped();
        match stop.reason {
            StopReason::Nothing => self.m.motion.discard(),
            StopReason::Contact => {
                // The probe cycle continues from here, and so does a hold or a door that has begun in the meantime.
                self.m.probe.rests_after_contact();
                self.m.motion.discard();
            }
            StopReason::Switch => {
                // Homing continues from here.
                self.end_pauses();
                self.m.motion.discard();
            }
            StopReason::Alarm(alarm) => {
                self.m.accessories.apply_stop_at_rest();
                if !self.keeps_spindle_on(alarm) {
                    self.switch_off();
                }
                self.end_pauses();
                self.finish_alarm(alarm, &stop);
            }
            StopReason::Reset => {
                self.end_pauses();
                self.switch_off();
                self.finish_reset(stop.moving);
            }
        }
    }

    /// Ends parking and a probing move, if they are in progress.
    fn end_pauses(&mut self) {
        self.m.parking.end(&mut self.m.motion);
        self.m.probe.forget_move();
    }

    fn finish_alarm(&mut self, alarm: Alarm, stop: &Finished) {
        if matches!(alarm, Alarm::EmergencyStop | Alarm::DriverFault) {
            return self.finish_emergency(alarm, stop);
        }
        if matches!(self.state, State::Homing(_)) {
            return self.fail_homing(alarm);
        }
        if stop.moving {
            self.m.reference.lose();
        }
        self.m.motion.discard();
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.tell_alarm(alarm);
        if alarm == Alarm::HardLimit {
            self.tell_trip(stop.line);
        }
        if matches!(alarm, Alarm::Underrun | Alarm::Miscounted) {
            if matches!(self.task, Task::JogWaits) {
                self.m.lines.clear();
            }
            if self.task.abandon() {
                self.refuse(Error::Locked);
            }
            self.enter(State::Alarm(Some(alarm)));
        } else {
            self.say(|out| reply_texts::message(out, "Reset to continue"));
            self.enter(State::Critical(alarm));
        }
    }

    /// Latches the emergency stop or driver fault. Only a reset ends the alarm. If the input is still active at the
    /// reset, the alarm is reported again.
    fn finish_emergency(&mut self, alarm: Alarm, stop: &Finished) {
        let homing = matches!(self.state, State::Homing(_));
        let drivers_off = self.m.settings.is_on(Key::EmergencyDriversOff);
        // A faulty driver may have lost steps, and a motor without current does not hold its position.
        if stop.moving || homing || drivers_off || alarm == Alarm::DriverFault {
            self.m.reference.lose();
        }
        if drivers_off {
            self.m.drivers.switch_off();
        } else {
            self.m.drivers.stay();
        }
        self.m.accessories.restore();
        self.m.motion.discard();
        self.m.interpreter.set_position(self.m.motion.machine_position());
        self.tell_alarm(alarm);
        if homing {
            self.say_ok();
        }
        self.tell_trip(stop.line);
        self.say(|out| reply_texts::message(out, "Reset to continue"));
        self.enter(State::Critical(alarm));
    }

    /// Completes a soft reset (Ctrl-X). The welcome line follows. If the reset came during motion or homing, it raises
    /// `ALARM:3` or `ALARM:6` first, and the position is lost, as in Grbl.
    fn finish_reset(&mut self, moving: bool) {
        self.m.motion.discard();
        self.m.lines.clear();
        if matches!(self.state, State::Hold(_) | State::Door(_)) {
            // The drivers may have stayed on in the hold or at the door, for example for a tool change. Their idle
            // delay (`$1`) starts now.
            self.m.start_idle_delay();
        }
        let homing = matches!(self.state, State::Homing(_));
        if moving || homing {
            self.m.reference.lose();
            self.lock(if homing { Alarm::HomingReset } else { Alarm::AbortInMotion });
        }
        if let State::Sleep(_) | State::Critical(_) = self.state {
            self.enter(State::Alarm(self.state.alarm()));
        }
        // A command that was waiting is answered before the welcome line, as Grbl does, because senders expect one
        // answer to each line.
        if homing || self.task.answers_host() {
            self.say_ok();
        }
        self.task = Task::None;
        self.m.interpreter.reset();
        if !self.state.is_alarm() {
            self.enter(State::Normal);
        }
        self.initialise();
    }
}

/// Whether an input has stopped the step task directly (`already`), and whether a reason for that stop has been found
/// (`answered`).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stopped {
    pub(crate) already: bool,
    pub(crate) answered: bool,
}
