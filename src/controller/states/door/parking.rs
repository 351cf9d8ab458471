//! `SafetyDoor`: what an open safety door has interrupted (coolant, a jog, the job to be forgotten, sleep), and the
//! parking moves to the points left, clear and park, in a motion of their own. `Opening` says whether the tool retracts
//! and the spindle stays on. Which phase comes when is decided in `states/door/mod.rs`.
//!
//! The parking moves belong to a motion of their own, so that the job's look-ahead stays as it was. Afterwards the job's
//! block is entered again at the very unit where it was left.
//!
//! ```text
//!  park ────────────────────┐ fast, spindle off
//!  clear ───────┐           │
//!               │ slow, spindle on
//!  left (where the job was interrupted)
//! ```

use crate::axes::{Axis, PerAxis};
use crate::error::Alarm;
use crate::lent::Lent;
use crate::messages::{Coolant, Observed, ToStep};
use crate::motion::{Motion, Move, Speed, Tolerance};
use crate::settings::{Key, Settings};
use crate::units::{Coordinate, per_second};

/// What the door took away and where parking leads.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct SafetyDoor<const N: usize> {
    /// Coolant that comes back; `None` while nothing has been switched off.
    coolant: Option<Coolant>,
    /// 0x19 came meanwhile: the job is forgotten when the door is closed.
    forget_job: bool,
    /// Sleep: what is done ends asleep.
    asleep: bool,
    /// A jog was moving when the door opened: it is forgotten at rest.
    jog_interrupted: bool,
    opening: Opening,
    /// The parking moves, if the tool was parked.
    parking: Option<Parking<N>>,
    motion: Lent<Motion<N>>,
}

/// What is done at an open door; a fault may do the same.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Opening {
    /// The tool is parked, where the settings and the program allow it.
    pub retract: bool,
    /// Spindle and coolant stay on.
    pub spindle_on: bool,
    /// An alarm follows.
    pub alarm: Option<Alarm>,
}

impl Opening {
    /// By the door itself.
    const BY_DOOR: Opening = Opening { retract: true, spindle_on: false, alarm: None };
}

/// The points of the parking moves.
#[derive(Clone, Copy, Debug)]
struct Parking<const N: usize> {
    /// Where the job was left.
    left: PerAxis<Coordinate, N>,
    /// The end of the slow pull-out.
    clear: PerAxis<Coordinate, N>,
    /// Where the tool parks.
    park: PerAxis<Coordinate, N>,
}

/// Where a parking move leads.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParkingPoint {
    /// Where the job was left.
    Left,
    /// The end of the slow pull-out.
    Clear,
    /// Where the tool parks.
    Park,
}

impl<const N: usize> SafetyDoor<N> {
    /// A door that has not been opened.
    pub fn new(motion: Lent<Motion<N>>) -> Self {
        Self {
            coolant: None,
            forget_job: false,
            asleep: false,
            jog_interrupted: false,
            opening: Opening::BY_DOOR,
            parking: None,
            motion,
        }
    }

    /// Closed again: nothing of what it interrupted is kept. Whether the job has to be forgotten.
    pub fn close(&mut self) -> bool {
        self.coolant = None;
        self.parking = None;
        self.asleep = false;
        self.opening = Opening::BY_DOOR;
        core::mem::take(&mut self.forget_job)
    }

    /// A stop has ended whatever it interrupted.
    pub fn reset(&mut self) {
        self.close();
        self.jog_interrupted = false;
    }

    /// The job is forgotten when the door is closed.
    pub fn forget_job(&mut self) {
        self.forget_job = true;
    }

    /// It is opened by something else than the door.
    pub fn open(&mut self, opening: Opening) {
        self.opening = opening;
    }

    /// What is done while it is open.
    pub fn opening(&self) -> Opening {
        self.opening
    }

    /// What is done ends asleep.
    pub fn fall_asleep(&mut self) {
        self.asleep = true;
    }

    /// See [`SafetyDoor::fall_asleep`].
    pub fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// A jog was moving when it opened.
    pub fn interrupt_jog(&mut self) {
        self.jog_interrupted = true;
    }

    /// Whether a jog has to be forgotten now, at rest.
    pub fn take_jog(&mut self) -> bool {
        core::mem::take(&mut self.jog_interrupted)
    }

    /// Coolant is switched off. What was switched off before, by an opening of the same door, is not forgotten.
    pub fn keep_coolant(&mut self, coolant: Coolant) {
        self.coolant.get_or_insert(coolant);
    }

    /// Coolant that comes back.
    pub fn kept_coolant(&self) -> Coolant {
        self.coolant.unwrap_or_default()
    }

    // Parking

    /// Whether the tool has left the job for the parking point.
    pub fn is_parking(&self) -> bool {
        self.parking.is_some()
    }

    /// Plans where parking leads from the end of the job's `motion`. Whether there is parking: not with homing off, with a
    /// laser, where it is not `allowed`, and where the tool is beyond the parking point already.
    pub fn leave_job(&mut self, allowed: bool, settings: &Settings<N>, motion: &Motion<N>) -> bool {
        self.parking = if allowed { Parking::from(motion.machine_position(), settings) } else { None };
        if self.is_parking() {
            self.motion.configure(motion.settings());
            self.motion.stand_where(motion);
        }
        self.is_parking()
    }

    /// A parking move at the rate (mm/min) of this setting. Whether there is parking.
    pub fn move_to(&mut self, point: ParkingPoint, rate: Key, settings: &Settings<N>) -> bool {
        let Some(parking) = &self.parking else { return false };
        let target = match point {
            ParkingPoint::Left => parking.left,
            ParkingPoint::Clear => parking.clear,
            ParkingPoint::Park => parking.park,
        };
        self.motion.line(&Move {
            target,
            speed: Speed::Feed(per_second(settings.value(rate))),
            power: 0,
            scale_power: false,
            line_number: 0,
            no_feed_override: true,
            digit: 0.0,
            tolerance: Tolerance::EXACT,
        });
        self.motion.start();
        true
    }

    /// The move under way ends with the slack where the job left it.
    pub fn end_with_lead(&mut self, lead: [i32; N]) {
        self.motion.end_with_lead(lead);
    }

    /// The door has been opened again in a parking move.
    pub fn hold(&mut self) {
        self.motion.hold();
    }

    /// The rest of the move is forgotten.
    pub fn discard(&mut self) {
        self.motion.discard();
    }

    /// The motion of parking.
    #[inline]
    pub fn motion(&self) -> &Motion<N> {
        &self.motion
    }

    /// Its next message to the step task.
    #[inline]
    pub fn next_message(&mut self) -> Option<ToStep> {
        self.motion.next_message()
    }

    /// What is seen of the step task.
    pub fn observe(&mut self, observed: &Observed) {
        self.motion.observe(observed);
    }

    /// The step task has stopped there. After a parking move the job's `motion` adopts the position, for this one knows on
    /// which side the slack is.
    pub fn stopped(&mut self, position: &PerAxis<i32, N>, motion: &mut Motion<N>) {
        self.motion.stopped(position);
        if self.is_parking() {
            motion.stand_where(&self.motion);
        }
    }
}

impl<const N: usize> Parking<N> {
    fn from(left: PerAxis<Coordinate, N>, settings: &Settings<N>) -> Option<Self> {
        if !settings.is_on(Key::Parking) || !settings.is_on(Key::Homing) || settings.is_on(Key::Laser) {
            return None;
        }
        let axis = Axis::ALL.get(settings.whole(Key::ParkingAxis) as usize).copied()?;
        let here = left.get(axis)?;
        let [least, greatest] = settings.ends_of_travel(axis)?.map(Coordinate::from_mm_f32);
        let park = Coordinate::from_mm_f32(settings.value(Key::ParkingTarget)).clamp(least, greatest);
        if here >= park {
            return None;
        }
        let clear = (here + Coordinate::from_mm_f32(settings.value(Key::ParkingPullOut))).min(park);
        let at = |coordinate: Coordinate| {
            let mut position = left;
            position.set(axis, coordinate);
            position
        };
        Some(Parking { left, clear: at(clear), park: at(park) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn settings(values: &[(Key, f32)]) -> Settings<3> {
        let mut settings = Settings::default();
        assert!(values.iter().all(|(key, value)| settings.restore(key.number(), *value)));
        settings
    }

    const PARKING: [(Key, f32); 4] =
        [(Key::Parking, 1.0), (Key::Homing, 1.0), (Key::ParkingTarget, -5.0), (Key::ParkingPullOut, 4.0)];

    fn parking(z: i32, settings: &Settings<3>) -> Option<[i64; 3]> {
        let left = PerAxis([Coordinate::mm(-10), Coordinate::mm(-20), Coordinate::mm(z)]);
        let parking = Parking::from(left, settings)?;
        let points = [parking.left, parking.clear, parking.park];
        assert!(points.iter().all(|point| point.0[..2] == left.0[..2]), "it leaves along one axis");
        Some(points.map(|point| point.0[2].0 / Coordinate::mm(1).0))
    }

    #[test]
    fn the_tool_leaves_slowly_and_parks_fast() {
        assert_eq!(parking(-30, &settings(&PARKING)), Some([-30, -26, -5]));
        assert_eq!(parking(-7, &settings(&PARKING)), Some([-7, -5, -5]), "the pull-out ends at the parking point");
        assert_eq!(parking(-5, &settings(&PARKING)), None, "it is there");
        for off in [(Key::Parking, 0.0), (Key::Homing, 0.0), (Key::Laser, 1.0)] {
            let values: Vec<(Key, f32)> = PARKING.into_iter().chain([off]).collect();
            assert_eq!(parking(-30, &settings(&values)), None);
        }
    }

    #[test]
    fn the_tool_parks_within_its_travel_wherever_machine_zero_is() {
        let place = |mm: f32, others: &[(Key, f32)]| {
            let parking: Vec<(Key, f32)> =
                PARKING.into_iter().chain([(Key::ParkingTarget, mm)]).chain(others.iter().copied()).collect();
            settings(&parking)
        };
        assert_eq!(parking(-30, &place(3.0, &[])), Some([-30, -26, 0]));
        let zero = (Key::ZeroAtPullOff, 1.0);
        assert_eq!(parking(-30, &place(3.0, &[zero])), Some([-30, -26, 0]), "clear of the switch");
        // Homed to the negative end its coordinates are positive.
        let upwards = [zero, (Key::HomingDirection, 4.0), (Key::HomingPullOff, 2.0)];
        assert_eq!(parking(30, &place(150.0, &upwards)), Some([30, 34, 150]));
        assert_eq!(parking(30, &place(500.0, &upwards)), Some([30, 34, 198]), "the travel, less the pull-off");
        assert_eq!(parking(30, &place(-5.0, &upwards)), None);
    }

    #[test]
    fn coolant_of_the_first_opening_comes_back() {
        let mut door = SafetyDoor::<3>::new(Lent::new(Motion::unconfigured(84_000_000, crate::motion::on_heap(2))));
        let flood = Coolant { flood: true, mist: false };
        door.keep_coolant(flood);
        door.keep_coolant(Coolant::default());
        assert_eq!(door.kept_coolant(), flood);
        door.forget_job();
        assert!(door.close() && !door.close());
        assert_eq!(door.kept_coolant(), Coolant::default());
    }
}
