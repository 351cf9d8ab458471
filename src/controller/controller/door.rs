//! The safety door: brake, park if that is wanted, switch off; and all of it backwards.
//!
//! The parking moves belong to a motion of their own, so that the job's look-ahead stays as it was. Afterwards the job's
//! block is entered again at the very unit where it was left.

use super::{Controller, StopReason};
use crate::axes::{Axis, PerAxis};
use crate::error::Alarm;
use crate::machine::state::{Door, Mode};
use crate::messages::{Coolant, SpindleDirection};
use crate::motion::{Move, Speed};
use crate::protocol::report;
use crate::settings::{AxisKey, Key};
use crate::units::{Coordinate, Duration, per_second};

/// What the door took away and where parking goes.
#[derive(Clone, Copy, Debug)]
pub(super) struct DoorState<const N: usize> {
    /// Coolant that comes back; `None` while nothing has been switched off.
    coolant: Option<Coolant>,
    /// The parking moves, if the tool was parked.
    way: Option<ParkingWay<N>>,
    /// 0x19 came meanwhile: nothing of the job goes on.
    pub(super) forget_job: bool,
    /// Sleep: what is done ends asleep.
    pub(super) asleep: bool,
}

#[derive(Clone, Copy, Debug)]
struct ParkingWay<const N: usize> {
    /// Where the job was left.
    left: PerAxis<Coordinate, N>,
    /// The end of the slow pull-out.
    clear: PerAxis<Coordinate, N>,
    /// Where the tool parks.
    park: PerAxis<Coordinate, N>,
}

impl<const N: usize> DoorState<N> {
    pub(super) const CLOSED: Self = Self { coolant: None, way: None, forget_job: false, asleep: false };

    /// Whether the tool has left the job for the parking place.
    pub(super) fn is_parking(&self) -> bool {
        self.way.is_some()
    }
}

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// The door input or 0x84.
    pub(super) fn open_door(&mut self) {
        match self.mode {
            Mode::Jog { .. } => {
                self.motion.hold();
                self.task.forget_jog();
                self.forget_received_jogs();
                self.jog_interrupted = true;
                self.mode = Mode::Door(Door::Braking);
            }
            Mode::Normal | Mode::Hold => {
                self.spinning_up = None;
                self.motion.hold();
                self.task.forget_jog();
                self.task.suspend(self.now);
                self.mode = Mode::Door(Door::Braking);
            }
            Mode::Stopping { locked: false } => {
                // The stop stays one: nothing goes on when the door is closed.
                self.door.forget_job = true;
                self.mode = Mode::Door(Door::Braking);
            }
            Mode::Door(Door::SpindleRestoring(_) | Door::CoolantRestoring(_)) => self.switch_off_and_park(),
            Mode::Door(Door::Returning | Door::Plunging) => {
                self.detour.hold();
                self.mode = Mode::Door(Door::Reopened);
            }
            Mode::Door(_) => {}
            Mode::Home => {
                self.order_stop(StopReason::Alarm(Alarm::HomingDoor));
                return;
            }
            _ => return,
        }
        self.say(|out| report::message(out, "Check Door"));
    }

    /// `$SLP`: as a door that only a reset closes.
    pub(super) fn fall_asleep(&mut self) {
        self.door.asleep = true;
        if self.mode.is_alarm() {
            // A locked machine does not move, not even to park.
            self.spindle_stopped = true;
            self.parked();
        } else {
            self.mode = Mode::Door(Door::Braking);
        }
    }

    /// `~` at a closed door.
    pub(super) fn close_door(&mut self) {
        if self.signals.door || self.door.asleep {
            return;
        }
        match self.door.way {
            Some(way) => {
                self.detour_to(&way.clear, Key::ParkingFastRate);
                self.mode = Mode::Door(Door::Returning);
            }
            None => self.restore_spindle_for_door(),
        }
    }

    /// Goes on with whatever phase has come to its end.
    #[inline(never)]
    pub(super) fn settle_door(&mut self, door: Door) {
        match door {
            Door::Braking if self.motion.is_at_rest() => {
                if core::mem::take(&mut self.jog_interrupted) {
                    self.motion.discard();
                    self.running = false;
                    self.interpreter.set_position(self.motion.machine_position());
                }
                self.begin_parking();
            }
            Door::PullingOut if self.detour_ended() => self.switch_off_and_park(),
            Door::Parking if self.detour_ended() => self.parked(),
            Door::Reopened if self.detour.is_at_rest() => {
                self.detour.discard();
                match self.door.way {
                    // In or near the cut with the spindle on: slowly out, as at first.
                    Some(way) if !self.spindle_stopped => {
                        self.detour_to(&way.clear, Key::ParkingPullOutRate);
                        self.mode = Mode::Door(Door::PullingOut);
                    }
                    _ => self.switch_off_and_park(),
                }
            }
            Door::Returning if self.detour_ended() => self.restore_spindle_for_door(),
            Door::SpindleRestoring(until) => {
                if !self.has_spun_up(until) {
                    return;
                }
                self.coolant = self.door.coolant.unwrap_or_default();
                self.rare_fields.overrides_changed();
                let delay = if self.coolant == Coolant::default() {
                    Duration::millis(0)
                } else {
                    self.settings.seconds(Key::DoorCoolantDelay)
                };
                self.mode = Mode::Door(Door::CoolantRestoring(self.now + delay));
            }
            Door::CoolantRestoring(until) if self.now >= until => match self.door.way {
                Some(way) => {
                    self.detour_to(&way.left, Key::ParkingPullOutRate);
                    // The job's block is entered with the slack where it was.
                    self.detour.end_with_lead(self.motion.lead());
                    self.mode = Mode::Door(Door::Plunging);
                }
                None => self.leave_door(),
            },
            Door::Plunging if self.detour_ended() => self.leave_door(),
            _ => {}
        }
    }

    fn leave_door(&mut self) {
        if self.door.way.is_some() {
            self.motion.reenter();
        }
        let forget_job = self.door.forget_job;
        self.door = DoorState::CLOSED;
        if forget_job {
            self.end_soft_stop(false);
        } else {
            self.leave_hold();
        }
    }

    /// The first move of parking, or straight to switching off where there is no parking.
    fn begin_parking(&mut self) {
        self.door.way = self.parking_way();
        match self.door.way {
            Some(way) => {
                self.detour.configure(self.motion.settings());
                self.detour.stand_where(&self.motion);
                self.detour_to(&way.clear, Key::ParkingPullOutRate);
                self.mode = Mode::Door(Door::PullingOut);
            }
            None => self.switch_off_and_park(),
        }
    }

    /// Where parking leads. None with homing off, with a laser, with an untrusted position, where a program holds it off
    /// (M56 P0), and where the tool is beyond the parking place already.
    fn parking_way(&self) -> Option<ParkingWay<N>> {
        let modal = self.interpreter.modal();
        if !self.settings.is_on(Key::Parking)
            || !self.settings.is_on(Key::Homing)
            || self.settings.is_on(Key::Laser)
            || !self.reference.is_trusted()
            || modal.no_parking
        {
            return None;
        }
        let axis = Axis::ALL.get(self.settings.whole(Key::ParkingAxis) as usize).copied()?;
        let left = self.motion.machine_position();
        let here = left.get(axis)?;
        let travel = Coordinate::from_mm_f32(self.settings.axes(AxisKey::Travel).get(axis)?);
        let park = Coordinate::from_mm_f32(self.settings.value(Key::ParkingTarget)).clamp(-travel, Coordinate::ZERO);
        if here >= park {
            return None;
        }
        let clear = (here + Coordinate::from_mm_f32(self.settings.value(Key::ParkingPullOut))).min(park);
        let at = |place: Coordinate| {
            let mut whole = left;
            whole.set(axis, place);
            whole
        };
        Some(ParkingWay { left, clear: at(clear), park: at(park) })
    }

    fn switch_off_and_park(&mut self) {
        // What was switched off before, by an opening of the same door, is not forgotten.
        self.door.coolant.get_or_insert(self.coolant);
        self.coolant = Coolant::default();
        self.spindle_stopped = true;
        self.rare_fields.overrides_changed();
        match self.door.way {
            Some(way) => {
                self.detour_to(&way.park, Key::ParkingFastRate);
                self.mode = Mode::Door(Door::Parking);
            }
            None => self.parked(),
        }
    }

    fn parked(&mut self) {
        if self.door.asleep {
            self.spindle = SpindleDirection::Off;
            self.drivers.switch_off();
            // Axes can be moved by hand now.
            self.reference.lose();
            self.mode = Mode::Sleep;
        } else {
            self.mode = Mode::Door(Door::Parked);
        }
    }

    fn restore_spindle_for_door(&mut self) {
        self.spindle_stopped = false;
        self.rare_fields.overrides_changed();
        let at_once = self.spindle == SpindleDirection::Off || self.settings.is_on(Key::Laser);
        let delay = if at_once { Duration::millis(0) } else { self.settings.seconds(Key::DoorSpindleDelay) };
        self.mode = Mode::Door(Door::SpindleRestoring(self.now + delay));
        // Nothing to wait for: the same call goes on.
        if at_once {
            self.settle_door(Door::SpindleRestoring(self.now));
            if let Mode::Door(Door::CoolantRestoring(until)) = self.mode
                && self.now >= until
            {
                self.settle_door(Door::CoolantRestoring(until));
            }
        }
    }

    fn detour_to(&mut self, target: &PerAxis<Coordinate, N>, rate: Key) {
        self.detour.line(&Move {
            target: *target,
            speed: Speed::Feed(per_second(self.settings.value(rate))),
            power: 0,
            scale_power: false,
            line_number: 0,
            no_feed_override: true,
            digit: 0.0,
        });
        self.detour.start();
        self.drivers.switch_on();
    }

    fn detour_ended(&self) -> bool {
        self.detour.is_idle()
    }
}
