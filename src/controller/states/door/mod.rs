//! The safety door and its parking motion, phase by phase of `Mode::Door`: brake, retract (pull the tool out), switch
//! spindle and coolant off, park; and at `~` all of it backwards: return, restore spindle and coolant, plunge into the
//! cut, leave. Also for sleep and for a fault that retracts. The points and what the door interrupted are kept in
//! `parking.rs`. It begins the `parking_move` to a `parking_point`, and falls asleep.

pub(crate) mod parking;

use crate::dispatch::Controller;
use crate::error::Alarm;
use crate::messages::Coolant;
use crate::protocol::report;
use crate::settings::Key;
use crate::states::door::parking::{Opening, ParkingPoint};
use crate::states::stops::orders::StopReason;
use crate::states::{AfterBraking, Door, Mode};
use crate::units::Duration;

impl<const N: usize> Controller<N> {
    /// The door input or 0x84.
    pub(crate) fn open_door(&mut self) {
        self.switch_off_for_door();
        self.forget_received_jogs();
        match self.mode {
            Mode::Jog { .. } => {
                self.m.motion.hold();
                self.task.forget_jog();
                self.m.door.interrupt_jog();
                self.enter(Mode::Door(Door::Braking));
            }
            Mode::Normal | Mode::Hold => self.brake_for_door(),
            Mode::Stopping { then: AfterBraking::Continue } => {
                // The stop stays one: nothing resumes when the door is closed.
                self.m.door.forget_job();
                self.enter(Mode::Door(Door::Braking));
            }
            Mode::Door(Door::SpindleRestoring(_) | Door::CoolantRestoring(_)) => self.switch_off_and_park(),
            Mode::Door(Door::Returning | Door::Plunging) => {
                self.m.door.hold();
                self.enter(Mode::Door(Door::Reopened));
            }
            Mode::Door(_) => {}
            Mode::Home(_) => {
                self.m.stops.order(StopReason::Alarm(Alarm::HomingDoor));
                return;
            }
            _ => return,
        }
        self.say(|out| report::message(out, "Check Door"));
    }

    /// A fault may have left the spindle on (`$924` to `$928`); at an open door it does not turn.
    fn switch_off_for_door(&mut self) {
        match self.mode {
            Mode::Door(door) if self.m.door.opening().spindle_on => {
                self.m.door.open(Opening { spindle_on: false, ..self.m.door.opening() });
                if matches!(door, Door::Parking | Door::Parked | Door::Returning) {
                    self.suspend_for_door();
                }
            }
            Mode::Stopping { then } if then.alarm().is_some() => self.switch_off(),
            Mode::Critical(_) => self.switch_off(),
            _ => {}
        }
    }

    /// Braking; then what the open door does.
    pub(crate) fn brake_for_door(&mut self) {
        self.m.accessories.end_spin_up();
        self.m.motion.hold();
        self.task.forget_jog();
        self.task.suspend(self.m.now);
        self.enter(Mode::Door(Door::Braking));
    }

    /// `$SLP`: as a door that only a reset closes.
    pub(crate) fn fall_asleep(&mut self) {
        self.m.door.fall_asleep();
        if self.mode.is_alarm() {
            // A locked machine does not move, not even to park.
            self.m.accessories.suspend();
            self.parked();
        } else {
            self.enter(Mode::Door(Door::Braking));
        }
    }

    /// `~` at a closed door.
    pub(crate) fn close_door(&mut self) {
        if self.m.inputs.signals().door || self.m.door.is_asleep() || self.m.door.opening().alarm.is_some() {
            return;
        }
        if self.parking_move(ParkingPoint::Clear, Key::ParkingFastRate) {
            self.enter(Mode::Door(Door::Returning));
        } else {
            self.restore_spindle_for_door();
        }
    }

    /// Begins the next phases as the ones before come to their end. One of no length has come to it at once, and nothing
    /// would wake the controller for it.
    pub(crate) fn settle_phases(&mut self, mut door: Door) {
        loop {
            self.settle_door(door);
            match self.mode {
                Mode::Door(next) if next != door => door = next,
                _ => return,
            }
        }
    }

    /// Begins the next phase when one has come to its end.
    #[inline(never)]
    fn settle_door(&mut self, door: Door) {
        match door {
            Door::Braking if self.m.motion.is_at_rest() => {
                if self.m.door.take_jog() {
                    self.m.motion.discard();
                    self.m.step_supply.end();
                    self.m.interpreter.set_position(self.m.motion.machine_position());
                }
                self.begin_parking();
            }
            Door::PullingOut if self.m.door.motion().is_idle() => self.switch_off_and_park(),
            Door::Parking if self.m.door.motion().is_idle() => self.parked(),
            Door::Reopened if self.m.door.motion().is_at_rest() => {
                self.m.door.discard();
                // In or near the cut with the spindle on: slowly out, as at first.
                if !self.m.accessories.is_suspended() && self.parking_move(ParkingPoint::Clear, Key::ParkingPullOutRate)
                {
                    self.enter(Mode::Door(Door::PullingOut));
                } else {
                    self.switch_off_and_park();
                }
            }
            Door::Returning if self.m.door.motion().is_idle() => self.restore_spindle_for_door(),
            Door::SpindleRestoring(until) => {
                if !self.has_spun_up(until) {
                    return;
                }
                let coolant = self.m.door.kept_coolant();
                self.m.accessories.set_coolant(coolant);
                self.m.replies.overrides_changed();
                let delay = if coolant == Coolant::default() {
                    Duration::millis(0)
                } else {
                    self.m.settings.seconds(Key::DoorCoolantDelay)
                };
                // A phase of no length would leave a wake-up that is now.
                if delay == Duration::millis(0) {
                    self.plunge();
                } else {
                    self.enter(Mode::Door(Door::CoolantRestoring(self.m.now + delay)));
                }
            }
            Door::CoolantRestoring(until) if self.m.now >= until => self.plunge(),
            Door::Plunging if self.m.door.motion().is_idle() => self.leave_door(),
            _ => {}
        }
    }

    /// Slowly back into the cut, if the tool was parked.
    #[inline(never)]
    fn plunge(&mut self) {
        if self.parking_move(ParkingPoint::Left, Key::ParkingPullOutRate) {
            // The job's block is entered with the slack where it was.
            self.m.door.end_with_lead(self.m.motion.lead());
            self.enter(Mode::Door(Door::Plunging));
        } else {
            self.leave_door();
        }
    }

    /// A soft stop has come to its end. The door may have been opened meanwhile.
    pub(crate) fn finish_soft_stop(&mut self, lock: bool) {
        self.end_soft_stop(lock);
        if self.m.inputs.signals().door {
            self.open_door();
        }
    }

    fn leave_door(&mut self) {
        if self.m.door.is_parking() {
            self.m.probe.watch_again();
            self.m.motion.reenter();
        }
        if self.m.door.close() {
            self.finish_soft_stop(false);
        } else {
            self.leave_hold();
        }
    }

    /// Retracts the tool: the first move of parking. Straight to switching off where there is none: with an untrusted position or
    /// settings that lock motion, or where a program holds it off (M56 P0), besides what [`SafetyDoor::leave_job`] knows.
    ///
    /// [`SafetyDoor::leave_job`]: crate::states::door::parking::SafetyDoor::leave_job
    pub(crate) fn begin_parking(&mut self) {
        let allowed = self.m.door.opening().retract
            && self.m.reference.is_trusted()
            && self.locking_setting().is_none()
            && !self.m.interpreter.modal().no_parking;
        if self.m.door.leave_job(allowed, &self.m.settings, &self.m.motion)
            && self.parking_move(ParkingPoint::Clear, Key::ParkingPullOutRate)
        {
            self.m.probe.look_away();
            self.enter(Mode::Door(Door::PullingOut));
        } else {
            self.switch_off_and_park();
        }
    }

    fn suspend_for_door(&mut self) {
        self.m.door.keep_coolant(self.m.accessories.coolant());
        self.m.accessories.set_coolant(Coolant::default());
        self.m.accessories.suspend();
        self.m.replies.overrides_changed();
    }

    fn switch_off_and_park(&mut self) {
        if self.m.door.opening().spindle_on {
            self.m.door.keep_coolant(self.m.accessories.coolant());
        } else {
            self.suspend_for_door();
        }
        if self.parking_move(ParkingPoint::Park, Key::ParkingFastRate) {
            self.enter(Mode::Door(Door::Parking));
        } else {
            self.parked();
        }
    }

    fn parked(&mut self) {
        if self.m.door.is_asleep() {
            self.m.accessories.stop_spindle();
            self.m.drivers.switch_off();
            // Axes can be moved by hand now.
            self.m.reference.lose();
            self.enter(Mode::Sleep(self.mode.alarm()));
        } else {
            self.enter(Mode::Door(Door::Parked));
            if let Some(alarm) = self.m.door.opening().alarm {
                self.m.stops.order(StopReason::Alarm(alarm));
            }
        }
    }

    fn restore_spindle_for_door(&mut self) {
        let laser = self.m.settings.is_on(Key::Laser);
        if !laser {
            // A beam comes back with the motion: it would burn on one point while the coolant (an air assist) is waited for.
            self.m.accessories.restore();
            self.m.replies.overrides_changed();
        }
        let at_once = laser || !self.m.accessories.is_on();
        let delay = if at_once { Duration::millis(0) } else { self.m.settings.seconds(Key::DoorSpindleDelay) };
        self.enter(Mode::Door(Door::SpindleRestoring(self.m.now + delay)));
        if at_once {
            self.settle_door(Door::SpindleRestoring(self.m.now));
        }
    }

    /// A parking move at the rate of this setting. Whether there is parking.
    fn parking_move(&mut self, to: ParkingPoint, rate: Key) -> bool {
        let parking = self.m.door.move_to(to, rate, &self.m.settings);
        if parking {
            self.m.drivers.switch_on();
        }
        parking
    }
}
