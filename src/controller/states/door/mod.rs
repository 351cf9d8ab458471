//! The safety door. When it opens, the machine brakes, pulls the tool out, switches spindle and coolant off and parks
//! the tool. `~` undoes all of that in reverse order, and the job continues. Sleep, a fault with retraction and a lost
//! host go through the same phases.
//!
//! [`Door`] holds the data of this state: its phase, the interrupted work, and the coolant to restore. [`parking`]
//! plans the tool's path to the parking position.

pub(crate) mod parking;

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::messages::Coolant;
use crate::protocol::reply_texts;
use crate::settings::Key;
use crate::states::door::parking::ParkingPoint;
use crate::states::stops::orders::StopReason;
use crate::states::{AfterBraking, State};
use crate::units::{Duration, Instant};

/// An open safety door, or something that acts like one: sleep, a fault with retraction, a lost host.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Door {
    pub phase: DoorPhase,
    pub interrupted: Interrupted,
    pub opening: Opening,
    /// Coolant to restore; `None` while nothing has been switched off.
    coolant: Option<Coolant>,
}

/// Phases of an open door, from braking to the way back into the cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
// Makes the tag (the number of the variant) one byte. Without it, the tags of this enum and of `State` would have 64
// bits, because some variants hold a 64-bit instant.
#[repr(u8)]
pub(crate) enum DoorPhase {
    /// Braking; parking begins at rest.
    Braking,
    /// First parking move: slowly out of the cut, with the spindle still turning.
    PullingOut,
    /// Second parking move: fast to the parking position, with spindle and coolant off.
    Parking,
    /// At rest with spindle and coolant off.
    Parked,
    /// Braking, because the door was opened again during a move back to the job.
    Reopened,
    /// After `~`: fast back towards the cut.
    Returning,
    /// The spindle runs up until the given time, then the coolant starts.
    SpindleRestoring(Instant),
    /// The coolant builds up until the given time, then motion resumes.
    CoolantRestoring(Instant),
    /// Slowly back into the cut.
    Plunging,
}

/// What the machine was doing when the door opened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Interrupted {
    /// A job. After the door is closed, `~` resumes it.
    Job,
    /// A jog, which is dropped once the machine is at rest.
    Jog {
        /// 0x19 has been received since the door opened.
        stopped: bool,
    },
    /// A job that was stopped (0x19). After the door is closed, `~` moves the tool back, and then the job is dropped.
    StoppedJob,
    /// Nothing resumes, because the machine falls asleep.
    Sleep,
}

/// How the machine reacts to an open door, or to a fault that acts like one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Opening {
    /// The tool is parked if the settings and the program allow it.
    pub retract: bool,
    /// Spindle and coolant stay on.
    pub spindle_on: bool,
    /// The alarm that follows once the tool is parked, if any.
    pub alarm: Option<Alarm>,
}

impl Opening {
    /// The reaction to the open safety door and to `$SLP`: the tool is parked if the settings allow it, the spindle is
    /// switched off, and no alarm follows.
    pub const BY_DOOR: Opening = Opening { retract: true, spindle_on: false, alarm: None };
}

impl Door {
    fn opened(interrupted: Interrupted, opening: Opening) -> Door {
        Door { phase: DoorPhase::Braking, interrupted, opening, coolant: None }
    }

    /// Handles 0x19: marks interrupted work as stopped, so that it is dropped and does not resume.
    pub(crate) fn stop_job(&mut self) {
        self.interrupted = match self.interrupted {
            Interrupted::Job | Interrupted::StoppedJob => Interrupted::StoppedJob,
            Interrupted::Jog { .. } => Interrupted::Jog { stopped: true },
            Interrupted::Sleep => Interrupted::Sleep,
        };
    }

    /// Remembers which coolant is switched off. If the door is opened again on the way back, the coolant of the first
    /// opening stays remembered.
    fn keep_coolant(&mut self, coolant: Coolant) {
        self.coolant.get_or_insert(coolant);
    }

    /// Drops an interrupted jog once the machine is at rest. Returns whether a jog was interrupted.
    fn forget_jog(&mut self) -> bool {
        let Interrupted::Jog { stopped } = self.interrupted else { return false };
        self.interrupted = if stopped { Interrupted::StoppedJob } else { Interrupted::Job };
        true
    }
}

impl DoorPhase {
    /// Returns whether `~` was received at the closed door, and the machine is on its way back to the job.
    pub(crate) fn is_resuming(self) -> bool {
        matches!(
            self,
            DoorPhase::Returning
                | DoorPhase::SpindleRestoring(_)
                | DoorPhase::CoolantRestoring(_)
                | DoorPhase::Plunging
        )
    }

    /// Returns the state's name in the report for `?`. `open`: the door input is active.
    pub(crate) fn name(self, open: bool) -> &'static str {
        match self {
            DoorPhase::Braking | DoorPhase::PullingOut | DoorPhase::Parking | DoorPhase::Reopened => "Door:2",
            DoorPhase::Parked if open => "Door:1",
            DoorPhase::Parked => "Door:0",
            _ => "Door:3",
        }
    }
}

impl<const N: usize> Controller<N> {
    /// Handles the door input or 0x84.
    pub(crate) fn open_door(&mut self) {
        self.switch_off_for_door();
        self.forget_received_jogs();
        match self.state {
            State::Jog { .. } => {
                self.m.motion.hold();
                self.task.forget_jog();
                self.open(Interrupted::Jog { stopped: false }, Opening::BY_DOOR);
            }
            State::Normal | State::Hold(_) => self.brake_for_door(Opening::BY_DOOR),
            // The machine already brakes for a stop (0x19), so nothing may resume later.
            State::Braking { then: AfterBraking::Continue } => self.open(Interrupted::StoppedJob, Opening::BY_DOOR),
            State::Door(door) => match door.phase {
                DoorPhase::SpindleRestoring(_) | DoorPhase::CoolantRestoring(_) => self.switch_off_and_park(),
                DoorPhase::Returning | DoorPhase::Plunging => {
                    self.m.parking.hold();
                    self.enter_phase(DoorPhase::Reopened);
                }
                _ => {}
            },
            State::Homing(_) => {
                self.m.stops.order(StopReason::Alarm(Alarm::HomingDoor));
                return;
            }
            _ => return,
        }
        self.say(|out| reply_texts::message(out, "Check Door"));
    }

    #[inline(never)]
    fn open(&mut self, interrupted: Interrupted, opening: Opening) {
        self.enter(State::Door(Door::opened(interrupted, opening)));
    }

    #[inline(never)]
    fn enter_phase(&mut self, phase: DoorPhase) {
        if let State::Door(door) = &mut self.state {
            door.phase = phase;
        }
    }

    /// Switches off the spindle if a reaction to a fault (`$924` to `$928`) has left it on. It must not turn while the
    /// door is open.
    fn switch_off_for_door(&mut self) {
        match &mut self.state {
            State::Door(door) if door.opening.spindle_on => {
                door.opening.spindle_on = false;
                if matches!(door.phase, DoorPhase::Parking | DoorPhase::Parked | DoorPhase::Returning) {
                    self.suspend_for_door();
                }
            }
            State::Braking { then } if then.alarm().is_some() => self.switch_off(),
            State::Critical(_) => self.switch_off(),
            _ => {}
        }
    }

    /// Brakes. When the machine is at rest, the next phases of an open door follow: the tool is parked as `opening`
    /// says.
    pub(crate) fn brake_for_door(&mut self, opening: Opening) {
        self.m.motion.hold();
        self.task.forget_jog();
        self.task.suspend(self.m.now);
        self.open(Interrupted::Job, opening);
    }

    /// Retracts the tool after the machine has braked for a fault. The alarm follows once the tool is parked.
    pub(crate) fn retract_for(&mut self, opening: Opening) {
        self.open(Interrupted::Job, opening);
        self.begin_parking();
    }

    /// Handles `$SLP`. Sleep is like an open door that only a reset closes.
    pub(crate) fn fall_asleep(&mut self) {
        if self.state.is_alarm() {
            // A locked machine does not move, not even to park.
            self.m.accessories.suspend();
            self.rest_asleep();
        } else {
            self.open(Interrupted::Sleep, Opening::BY_DOOR);
        }
    }

    /// Handles `~`: if the machine is parked and the door is closed, starts the way back to the job. Does nothing in
    /// sleep, or if an alarm follows.
    pub(crate) fn close_door(&mut self) {
        let State::Door(door) = &self.state else { return };
        let opens = door.phase == DoorPhase::Parked
            && door.interrupted != Interrupted::Sleep
            && door.opening.alarm.is_none()
            && !self.m.inputs.signals().door;
        if !opens {
            return;
        }
        if self.parking_move(ParkingPoint::Clear, Key::ParkingFastRate) {
            self.enter_phase(DoorPhase::Returning);
        } else {
            self.restore_spindle_for_door();
        }
    }

    /// Starts the next phase when the current one has ended. If that phase also ends at once, starts the one after it
    /// too, because no event would do so later.
    pub(crate) fn settle_phases(&mut self, mut phase: DoorPhase) {
        loop {
            self.settle_door(phase);
            match self.state {
                State::Door(door) if door.phase != phase => phase = door.phase,
                _ => return,
            }
        }
    }

    /// Starts the next phase if `phase` has ended.
    #[inline(never)]
    fn settle_door(&mut self, phase: DoorPhase) {
        match phase {
            DoorPhase::Braking if self.m.motion.is_at_rest() => {
                if let State::Door(door) = &mut self.state
                    && door.forget_jog()
                {
                    self.m.motion.discard();
                    self.m.step_supply.end();
                    self.m.interpreter.set_position(self.m.motion.machine_position());
                }
                self.begin_parking();
            }
            DoorPhase::PullingOut if self.m.parking.motion().is_idle() => self.switch_off_and_park(),
            DoorPhase::Parking if self.m.parking.motion().is_idle() => self.parked(),
            DoorPhase::Reopened if self.m.parking.motion().is_at_rest() => {
                self.m.parking.discard();
                // If the spindle is on, the tool can be in the cut. In that case it is pulled out slowly, as when the
                // door was first opened.
                if !self.m.accessories.is_suspended() && self.parking_move(ParkingPoint::Clear, Key::ParkingPullOutRate)
                {
                    self.enter_phase(DoorPhase::PullingOut);
                } else {
                    self.switch_off_and_park();
                }
            }
            DoorPhase::Returning if self.m.parking.motion().is_idle() => self.restore_spindle_for_door(),
            DoorPhase::SpindleRestoring(until) => {
                if !self.has_spun_up(until) {
                    return;
                }
                let coolant = self.kept_coolant();
                self.m.accessories.set_coolant(coolant);
                self.m.replies.overrides_changed();
                let delay = if coolant == Coolant::default() {
                    Duration::millis(0)
                } else {
                    self.m.settings.seconds(Key::DoorCoolantDelay)
                };
                // Skip the phase if it would take no time: it would request a wake-up for the present moment.
                if delay == Duration::millis(0) {
                    self.plunge();
                } else {
                    self.enter_phase(DoorPhase::CoolantRestoring(self.m.now + delay));
                }
            }
            DoorPhase::CoolantRestoring(until) if self.m.now >= until => self.plunge(),
            DoorPhase::Plunging if self.m.parking.motion().is_idle() => self.leave_door(),
            _ => {}
        }
    }

    /// Moves the tool slowly back into the cut if it was parked.
    #[inline(never)]
    fn plunge(&mut self) {
        if self.parking_move(ParkingPoint::Left, Key::ParkingPullOutRate) {
            // The interrupted block continues from here, so each motor must be as far ahead of its axis (because of
            // backlash) as when the block was left.
            self.m.parking.end_with_lead(self.m.motion.lead());
            self.enter_phase(DoorPhase::Plunging);
        } else {
            self.leave_door();
        }
    }

    /// Ends a soft stop (0x19, or a refused line that ends the job) once the machine is at rest. If the door was opened
    /// during the stop, handles the open door now.
    pub(crate) fn finish_soft_stop(&mut self, lock: bool) {
        self.end_soft_stop(lock);
        if self.m.inputs.signals().door {
            self.open_door();
        }
    }

    fn leave_door(&mut self) {
        if self.m.parking.is_away() {
            self.m.probe.watch_again();
            self.m.motion.reenter();
        }
        self.m.parking.end(&mut self.m.motion);
        if matches!(self.state, State::Door(Door { interrupted: Interrupted::StoppedJob, .. })) {
            self.finish_soft_stop(false);
        } else {
            self.leave_hold();
        }
    }

    /// Starts the first parking move, which pulls the tool out. The tool stays where it is in five cases: the reaction
    /// (`retract`) does not include parking; the position is untrusted; settings lock motion; the program disables
    /// parking (M56 P0); or a reason of [`Parking::leave_job`] applies. In these cases, spindle and coolant are
    /// switched off at once, unless the reaction leaves them on.
    ///
    /// [`Parking::leave_job`]: crate::states::door::parking::Parking::leave_job
    fn begin_parking(&mut self) {
        let allowed = matches!(self.state, State::Door(door) if door.opening.retract)
            && self.m.reference.is_trusted()
            && self.locking_setting().is_none()
            && !self.m.interpreter.modal().no_parking;
        if self.m.parking.leave_job(allowed, &self.m.settings, &mut self.m.motion)
            && self.parking_move(ParkingPoint::Clear, Key::ParkingPullOutRate)
        {
            self.m.probe.look_away();
            self.enter_phase(DoorPhase::PullingOut);
        } else {
            self.switch_off_and_park();
        }
    }

    fn keep_coolant(&mut self) {
        if let State::Door(door) = &mut self.state {
            door.keep_coolant(self.m.accessories.coolant());
        }
    }

    fn kept_coolant(&self) -> Coolant {
        if let State::Door(door) = &self.state { door.coolant.unwrap_or_default() } else { Coolant::default() }
    }

    fn suspend_for_door(&mut self) {
        self.keep_coolant();
        self.m.accessories.set_coolant(Coolant::default());
        self.m.accessories.suspend();
        self.m.replies.overrides_changed();
    }

    fn switch_off_and_park(&mut self) {
        if matches!(self.state, State::Door(door) if door.opening.spindle_on) {
            self.keep_coolant();
        } else {
            self.suspend_for_door();
        }
        if self.parking_move(ParkingPoint::Park, Key::ParkingFastRate) {
            self.enter_phase(DoorPhase::Parking);
        } else {
            self.parked();
        }
    }

    fn parked(&mut self) {
        let State::Door(door) = &mut self.state else { return };
        if door.interrupted == Interrupted::Sleep {
            return self.rest_asleep();
        }
        door.phase = DoorPhase::Parked;
        if let Some(alarm) = door.opening.alarm {
            self.m.stops.order(StopReason::Alarm(alarm));
        }
    }

    fn rest_asleep(&mut self) {
        self.m.accessories.stop_spindle();
        self.m.drivers.switch_off();
        // Axes can be moved by hand from here on, so the position is no longer trusted.
        self.m.reference.lose();
        self.enter(State::Sleep(self.state.alarm()));
    }

    fn restore_spindle_for_door(&mut self) {
        let laser = self.m.settings.is_on(Key::Laser);
        if !laser {
            // A laser is switched on again when motion resumes. Now it would burn one point while the machine waits for
            // the coolant (an air assist).
            self.m.accessories.restore();
            self.m.replies.overrides_changed();
        }
        let at_once = laser || !self.m.accessories.is_on();
        let delay = if at_once { Duration::millis(0) } else { self.m.settings.seconds(Key::DoorSpindleDelay) };
        let phase = DoorPhase::SpindleRestoring(self.m.now + delay);
        self.enter_phase(phase);
        if at_once {
            self.settle_door(phase);
        }
    }

    /// Starts a parking move at the rate in the setting `rate`. Returns false, without a move, if the tool is not being
    /// parked.
    fn parking_move(&mut self, to: ParkingPoint, rate: Key) -> bool {
        let parking = self.m.parking.move_to(to, rate, &self.m.settings);
        if parking {
            self.m.drivers.switch_on();
        }
        parking
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coolant_of_the_first_opening_comes_back() {
        let mut door = Door::opened(Interrupted::Job, Opening::BY_DOOR);
        let flood = Coolant { flood: true, mist: false };
        door.keep_coolant(flood);
        door.keep_coolant(Coolant::default());
        assert_eq!(door.coolant, Some(flood));
    }

    #[test]
    fn a_stop_forgets_whatever_would_resume() {
        let stopped = |interrupted| {
            let mut door = Door::opened(interrupted, Opening::BY_DOOR);
            door.stop_job();
            let jog = door.forget_jog();
            (door.interrupted, jog)
        };
        assert_eq!(stopped(Interrupted::Job), (Interrupted::StoppedJob, false));
        assert_eq!(stopped(Interrupted::Jog { stopped: false }), (Interrupted::StoppedJob, true));
        assert_eq!(stopped(Interrupted::Sleep), (Interrupted::Sleep, false));
    }
}
