//! Parking: moves the tool away from the job and back to the position where the job was left. The safety door decides
//! when each move is made.
//!
//! These moves have a small [`Motion`] of their own, so the job's look-ahead stays as it was. Afterwards the
//! interrupted block continues exactly where it was left.
//!
//! ```text
//!  park ────────────────────┐ fast, spindle off
//!  clear ───────┐           │
//!               │ slow, spindle on
//!  left (where the job was interrupted)
//! ```

use crate::axes::{Axis, PerAxis};
use crate::lent::Lent;
use crate::messages::{Observed, ToStep};
use crate::motion::{Motion, Move, Speed, Tolerance};
use crate::settings::{Key, Settings};
use crate::units::{Coordinate, per_second};

/// The tool's path to the parking position and back.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub struct Parking<const N: usize> {
    /// The three points of the parking moves; `None` while the tool is at the job.
    route: Option<Route<N>>,
    motion: Lent<Motion<N>>,
}

/// The points of the parking moves.
#[derive(Clone, Copy, Debug)]
struct Route<const N: usize> {
    /// Where the job was left.
    left: PerAxis<Coordinate, N>,
    /// The end of the slow pull-out.
    clear: PerAxis<Coordinate, N>,
    /// Parking position: as `left`, but with the parking axis at the parking place (`$58`). A place outside of the
    /// travel is replaced by the end of the travel.
    park: PerAxis<Coordinate, N>,
}

/// The target of a parking move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ParkingPoint {
    /// The position at which the job was interrupted.
    Left,
    /// The end of the slow pull-out from the cut.
    Clear,
    /// The parking position ($58), where the tool waits while the door is open.
    Park,
}

impl<const N: usize> Parking<N> {
    /// Returns the value at the start: the tool is at the job. `motion` will make the parking moves.
    pub fn new(motion: Lent<Motion<N>>) -> Self {
        Self { route: None, motion }
    }

    /// Ends parking, because the tool is back at the job, or because a stop has ended the job's `motion`.
    pub fn end(&mut self, motion: &mut Motion<N>) {
        if self.route.take().is_some() {
            self.motion.lend_ring(motion);
        }
    }

    /// Returns whether the tool is on its way to the parking point, is there, or is on its way back.
    pub fn is_away(&self) -> bool {
        self.route.is_some()
    }

    /// Plans the parking moves from the machine position of the job's `motion`. Returns whether the tool will be
    /// parked. The tool stays at the job if `allowed` is `false`, if parking or homing is off, in laser mode, if the
    /// parking axis turns without end, or if the tool is already at or beyond the parking point.
    pub fn leave_job(&mut self, allowed: bool, settings: &Settings<N>, motion: &mut Motion<N>) -> bool {
        self.route = if allowed { Route::from(motion.machine_position(), settings) } else { None };
        if self.is_away() {
            motion.lend_ring(&mut self.motion);
            self.motion.configure(motion.settings());
            self.motion.take_over_position(motion);
        }
        self.is_away()
    }

    /// Starts a parking move at the rate (mm/min) in the setting `rate`. Returns false, without a move, if the tool is
    /// not being parked.
    pub fn move_to(&mut self, point: ParkingPoint, rate: Key, settings: &Settings<N>) -> bool {
        let Some(route) = &self.route else { return false };
        let target = match point {
            ParkingPoint::Left => route.left,
            ParkingPoint::Clear => route.clear,
            ParkingPoint::Park => route.park,
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

    /// Makes the current move end with each motor `lead` steps ahead of its axis (backlash compensation). `lead`: the
    /// value where the job was left.
    pub fn end_with_lead(&mut self, lead: [i32; N]) {
        self.motion.end_with_lead(lead);
    }

    /// Brakes a parking move, because the door has been opened again.
    pub fn hold(&mut self) {
        self.motion.hold();
    }

    /// Drops the rest of a parking move that [`Parking::hold`] has braked.
    pub fn discard(&mut self) {
        self.motion.discard();
    }

    /// Returns the motion of the parking moves. The job has another one.
    pub fn motion(&self) -> &Motion<N> {
        &self.motion
    }

    /// Returns the next message of the parking moves for the step task; `None` if there is none. The controller sends
    /// these messages before those of the job.
    pub fn next_message(&mut self) -> Option<ToStep> {
        self.motion.next_message()
    }

    /// Passes the step task's counters to the motion of the parking moves.
    pub fn observe(&mut self, observed: &Observed) {
        self.motion.observe(observed);
    }

    /// Sets the motion of the parking moves to `position`, at which the step task has stopped (in motor steps). If the
    /// tool is away from the job, also sets the job's `motion`: its position, and how far each motor is ahead of its
    /// axis because of backlash.
    pub fn stopped(&mut self, position: &PerAxis<i32, N>, motion: &mut Motion<N>) {
        self.motion.stopped(position);
        if self.is_away() {
            motion.take_over_position(&self.motion);
        }
    }
}

impl<const N: usize> Route<N> {
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
        Some(Route { left, clear: at(clear), park: at(park) })
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
        let route = Route::from(left, settings)?;
        let points = [route.left, route.clear, route.park];
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
        // Z is homed to its negative end, so its coordinates are positive.
        let upwards = [zero, (Key::HomingDirection, 4.0), (Key::HomingPullOff, 2.0)];
        assert_eq!(parking(30, &place(150.0, &upwards)), Some([30, 34, 150]));
        assert_eq!(parking(30, &place(500.0, &upwards)), Some([30, 34, 198]), "the travel, less the pull-off");
        assert_eq!(parking(30, &place(-5.0, &upwards)), None);
    }
}
