//! The homing cycle as a sequence: which axes seek their switches (fast), pull off, and locate them again (slowly), and
//! how an axis with two motors is squared. This module moves nothing itself. It returns an order (move, wait, done,
//! failed), and is called again with the closed switches when that order has been carried out.
//!
//! ```text
//!  each cycle ($44 and on; at first Z, then X and Y together):
//!    seek at $25 ──switch──▶ wait $26 ──▶ pull off $27 ──▶ wait ──▶ locate at $24 ──switch──▶ wait ──▶ pull off ──▶ wait
//!                                                                   └──────────────── $43 times ────────────────┘
//! ```
//! At a switch, motion stops without a ramp: the rates of homing are low enough for that, and during a ramp the axis
//! could run into the end of the switch. Axes of a cycle that have not reached their switch continue. At the end of its
//! cycle, an axis is one pull-off away from its switch. The position of the axis is set at that moment, not after the
//! last cycle. A later cycle can move an axis that was homed before (for example by backlash in belts that two axes
//! share). The position of the homed axis includes that movement.
//!
//! An axis with two motors and two switches is squared. In each seek and each locate, the motor whose switch closes
//! first stops, and the other motor moves on alone.

use crate::axes::{Axis, AxisMask, PerAxis};
use crate::error::Alarm;
use crate::messages::{GangedMotors, SECOND_SWITCH};
use crate::units::{Coordinate, Duration};

/// Length of a seek, as a multiple of the longest travel among the axes of the cycle.
const SEEK_TRAVELS: f32 = 1.5;
/// Travel that a seek (the fast search for a switch) assumes for a rotary axis without ends (`$133` = 0), degrees. Such
/// an axis meets its switch within one turn.
const TURN: f32 = 360.0;
/// Maximum length of a locate (the slow second approach to a switch), as a multiple of the pull-off.
const LOCATE_PULL_OFFS: f32 = 5.0;

/// The settings that homing needs, lengths in mm and rates in mm/s.
#[derive(Clone, Copy, Debug)]
pub(crate) struct HomingSettings<const N: usize> {
    /// `$44` and on: the axes of each cycle; an empty mask is no cycle.
    pub cycles: [AxisMask; N],
    /// `$43`: how often the switches are located.
    pub passes: u32,
    /// `$23`: axes whose switch is at the negative end.
    pub to_negative: AxisMask,
    /// Rate of a seek, the fast search for a switch (`$25`), mm/s.
    pub seek_rate: f32,
    /// Rate of a locate, the slow second approach to a switch (`$24`), mm/s.
    pub locate_rate: f32,
    /// Length of a pull-off (`$27`).
    pub pull_off: f32,
    /// Wait after each move (`$26`).
    pub debounce: Duration,
    /// Travel of each axis (`$130` and on).
    pub travel: PerAxis<f32, N>,
    /// `$932`: machine zero is where homing ends.
    pub zero_at_pull_off: bool,
    /// The axis that has two motors with a switch each, and the maximum distance that one of the motors may move alone,
    /// mm.
    pub squared: Option<(Axis, f32)>,
}

/// The next action of homing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Order<const N: usize> {
    /// Move by a distance at a rate along the path. If `watch` is not empty, stop as soon as one of its switches
    /// closes.
    Move {
        /// Distances in mm.
        by: PerAxis<f32, N>,
        /// Rate in mm/s.
        rate: f32,
        /// Switches that end the move.
        watch: AxisMask,
        /// Motors of the ganged axis that take part.
        motors: GangedMotors,
    },
    /// Wait this long, for the switches to settle.
    Wait(Duration),
    /// The axes of the mask have completed their cycle, and are at these machine coordinates.
    Reached(AxisMask, PerAxis<Coordinate, N>),
    /// These axes have been homed; homing is over.
    Done(AxisMask),
    /// Homing failed.
    Failed(Alarm),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pass {
    Seek,
    SeekPullOff,
    Locate,
    LocatePullOff,
    Reached,
}

/// Homing in progress: the cycles still to come, and the progress of the current one.
#[derive(Clone, Debug)]
pub(crate) struct HomingCycle<const N: usize> {
    settings: HomingSettings<N>,
    /// Axes of the cycles still to come, the current one first.
    cycles: heapless::Deque<AxisMask, 8>,
    homed: AxisMask,
    pass: Pass,
    /// How many locates the current cycle still has to make.
    locates_left: u32,
    /// Switches of the current seek or locate that have not closed.
    approaching: AxisMask,
    /// Switches that can end the current move: all of `approaching`, or only one while one motor of the squared axis
    /// moves alone.
    watched: AxisMask,
    /// `true` if the order returned last was a move, `false` if it was a wait.
    moving: bool,
}

impl<const N: usize> HomingCycle<N> {
    /// Plans the homing of the axes of all cycles, or only of the axis `only`.
    pub fn new(settings: HomingSettings<N>, only: Option<Axis>) -> Self {
        let mut cycles = heapless::Deque::new();
        let only = only.map(|axis| AxisMask::NONE.with(axis));
        let all = settings.cycles.iter().copied().filter(|_| only.is_none());
        for cycle in all.chain(only).filter(|cycle| !cycle.is_empty()) {
            let _ = cycles.push_back(cycle);
        }
        Self {
            settings,
            cycles,
            homed: AxisMask::NONE,
            pass: Pass::Seek,
            locates_left: 0,
            approaching: AxisMask::NONE,
            watched: AxisMask::NONE,
            moving: false,
        }
    }

    /// Returns the first order of the next cycle, or [`Order::Done`] if no cycle is left. `switches`: the limit
    /// switches that are closed now.
    pub fn begin(&mut self, switches: AxisMask) -> Order<N> {
        if self.cycles.is_empty() {
            return Order::Done(self.homed);
        }
        self.locates_left = self.settings.passes;
        self.approach_anew(Pass::Seek, switches)
    }

    /// Returns the next order. Call it when the previous order has been carried out, or when a watched switch has ended
    /// the move of that order. `switches`: the limit switches that are closed now.
    pub fn next(&mut self, switches: AxisMask) -> Order<N> {
        match (self.moving, self.pass) {
            (true, Pass::Seek | Pass::Locate) => {
                if self.watched.0 & switches.0 == 0 {
                    let squaring = self.lagging().is_some();
                    return Order::Failed(if squaring { Alarm::HomingSquaring } else { Alarm::HomingNoSwitch });
                }
                self.approach(switches)
            }
            (true, Pass::SeekPullOff | Pass::LocatePullOff) => self.wait(),
            (false, Pass::Seek) => self.pull_off(Pass::SeekPullOff),
            (false, Pass::Locate) => self.pull_off(Pass::LocatePullOff),
            (false, Pass::SeekPullOff | Pass::LocatePullOff) if self.switches_of_cycle().0 & switches.0 != 0 => {
                Order::Failed(Alarm::HomingPullOff)
            }
            (false, Pass::SeekPullOff) => self.locate(switches),
            (false, Pass::LocatePullOff) if self.locates_left > 0 => self.locate(switches),
            (false, Pass::LocatePullOff) => {
                let reached = self.cycle();
                self.homed = AxisMask(self.homed.0 | reached.0);
                self.cycles.pop_front();
                self.pass = Pass::Reached;
                Order::Reached(reached, self.places())
            }
            (_, Pass::Reached) => self.begin(switches),
        }
    }

    fn cycle(&self) -> AxisMask {
        self.cycles.front().copied().unwrap_or(AxisMask::NONE)
    }

    /// Returns the switches of the current cycle. A squared axis has two.
    fn switches_of_cycle(&self) -> AxisMask {
        match self.settings.squared {
            Some((axis, _)) if self.cycle().has(axis) => AxisMask(self.cycle().0 | SECOND_SWITCH),
            _ => self.cycle(),
        }
    }

    /// Returns the direction of the switch: -1 for an axis whose switch is at its negative end, otherwise 1.
    fn towards(&self, axis: Axis) -> f32 {
        if self.settings.to_negative.has(axis) { -1.0 } else { 1.0 }
    }

    fn wait(&mut self) -> Order<N> {
        self.moving = false;
        Order::Wait(self.settings.debounce)
    }

    fn locate(&mut self, switches: AxisMask) -> Order<N> {
        self.locates_left = self.locates_left.saturating_sub(1);
        self.approach_anew(Pass::Locate, switches)
    }

    fn approach_anew(&mut self, pass: Pass, switches: AxisMask) -> Order<N> {
        self.pass = pass;
        self.approaching = self.switches_of_cycle();
        self.approach(switches)
    }

    /// Returns the move of the axes that have not reached their switch; a wait if all axes have reached theirs.
    fn approach(&mut self, switches: AxisMask) -> Order<N> {
        self.approaching = AxisMask(self.approaching.0 & !switches.0);
        if self.approaching.is_empty() {
            return self.wait();
        }
        let rate = if self.pass == Pass::Seek { self.settings.seek_rate } else { self.settings.locate_rate };
        if let Some((axis, motors, most)) = self.lagging() {
            // The other axes wait, because a gantry must be skewed for as short a time as possible.
            self.watched = AxisMask(match motors {
                GangedMotors::Second => SECOND_SWITCH,
                _ => AxisMask::NONE.with(axis).0,
            });
            return self.travel(AxisMask::NONE.with(axis), most, rate, self.watched, motors);
        }
        let axes = AxisMask(self.approaching.0 & !SECOND_SWITCH);
        let distance = if self.pass == Pass::Seek {
            let longest = Axis::of_machine::<N>()
                .filter(|axis| self.cycle().has(*axis))
                .filter_map(|axis| self.settings.travel.get(axis).map(|travel| (axis, travel)))
                .map(|(axis, travel)| if axis.is_rotary() && travel == 0.0 { TURN } else { travel })
                .fold(0.0, |a: f32, b| if b > a { b } else { a });
            SEEK_TRAVELS * longest
        } else {
            LOCATE_PULL_OFFS * self.settings.pull_off
        };
        self.watched = self.approaching;
        self.travel(axes, distance, rate, self.watched, GangedMotors::Both)
    }

    /// If only one motor of the squared axis has reached its switch, returns the axis, the other motor, and how far
    /// (mm) that motor may move.
    fn lagging(&self) -> Option<(Axis, GangedMotors, f32)> {
        let (axis, most) = self.settings.squared.filter(|(axis, _)| self.cycle().has(*axis))?;
        match (self.approaching.has(axis), self.approaching.0 & SECOND_SWITCH != 0) {
            (true, false) => Some((axis, GangedMotors::First, most)),
            (false, true) => Some((axis, GangedMotors::Second, most)),
            _ => None,
        }
    }

    fn pull_off(&mut self, pass: Pass) -> Order<N> {
        self.pass = pass;
        let distance = -self.settings.pull_off;
        self.travel(self.cycle(), distance, self.settings.seek_rate, AxisMask::NONE, GangedMotors::Both)
    }

    fn travel(&mut self, axes: AxisMask, distance: f32, rate: f32, watch: AxisMask, motors: GangedMotors) -> Order<N> {
        self.moving = true;
        let by = PerAxis::from_axis(|axis| if axes.has(axis) { self.towards(axis) * distance } else { 0.0 });
        // Each axis moves at `rate`, so the rate along the path of n axes is sqrt(n) times as high.
        let count = axes.0.count_ones() as f32;
        Order::Move { by, rate: rate * oxmill_sqrt::square_root(count), watch, motors }
    }

    /// Returns the coordinates of the axes after their last pull-off: 0 with `zero_at_pull_off`. Otherwise the travel
    /// of each axis goes from -travel to 0, and the axis is one pull-off away from the switch at one of these ends.
    fn places(&self) -> PerAxis<Coordinate, N> {
        PerAxis::from_axis(|axis| {
            if self.settings.zero_at_pull_off {
                return Coordinate::ZERO;
            }
            let pull_off = Coordinate::from_mm_f32(self.settings.pull_off);
            if self.settings.to_negative.has(axis) {
                pull_off - Coordinate::from_mm_f32(self.settings.travel.get(axis).unwrap_or(0.0))
            } else {
                -pull_off
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const X: AxisMask = AxisMask(1);
    const Y: AxisMask = AxisMask(2);
    const Z: AxisMask = AxisMask(4);

    fn settings(to_negative: AxisMask) -> HomingSettings<3> {
        HomingSettings {
            cycles: [Z, AxisMask(3), AxisMask::NONE],
            passes: 1,
            to_negative,
            seek_rate: 10.0,
            locate_rate: 1.0,
            pull_off: 2.0,
            debounce: Duration::millis(250),
            travel: PerAxis([200.0, 100.0, 50.0]),
            zero_at_pull_off: false,
            squared: None,
        }
    }

    fn homing(to_negative: AxisMask) -> HomingCycle<3> {
        HomingCycle::new(settings(to_negative), None)
    }

    fn expect_move(order: Order<3>, by: [f32; 3], watch: AxisMask) {
        assert!(matches!(order, Order::Move { by: b, watch: w, .. } if b.0 == by && w == watch), "{order:?}");
    }

    #[test]
    fn the_whole_cycle() {
        let mut h = homing(Y);
        let wait = Order::Wait(Duration::millis(250));
        expect_move(h.begin(AxisMask::NONE), [0.0, 0.0, 75.0], Z);
        assert_eq!(h.next(Z), wait);
        expect_move(h.next(Z), [0.0, 0.0, -2.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        expect_move(h.next(AxisMask::NONE), [0.0, 0.0, 10.0], Z);
        assert_eq!(h.next(Z), wait);
        expect_move(h.next(Z), [0.0, 0.0, -2.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        let places = PerAxis([Coordinate::mm(-2), Coordinate::mm(-98), Coordinate::mm(-2)]);
        assert_eq!(h.next(AxisMask::NONE), Order::Reached(Z, places));
        // X and Y together; Y reaches its switch first and X moves on alone.
        expect_move(h.next(AxisMask::NONE), [300.0, -300.0, 0.0], AxisMask(3));
        expect_move(h.next(Y), [300.0, 0.0, 0.0], X);
        assert_eq!(h.next(AxisMask(3)), wait);
        expect_move(h.next(AxisMask(3)), [-2.0, 2.0, 0.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        expect_move(h.next(AxisMask::NONE), [10.0, -10.0, 0.0], AxisMask(3));
        assert_eq!(h.next(AxisMask(3)), wait);
        expect_move(h.next(AxisMask(3)), [-2.0, 2.0, 0.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        assert_eq!(h.next(AxisMask::NONE), Order::Reached(AxisMask(3), places));
        assert_eq!(h.next(AxisMask::NONE), Order::Done(AxisMask(7)));
    }

    #[test]
    fn failures() {
        let mut h = homing(AxisMask::NONE);
        h.begin(AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), Order::Failed(Alarm::HomingNoSwitch));
        let mut h = homing(AxisMask::NONE);
        h.begin(AxisMask::NONE);
        h.next(Z);
        h.next(Z);
        h.next(Z);
        assert_eq!(h.next(Z), Order::Failed(Alarm::HomingPullOff));
    }

    #[test]
    fn cycles_and_passes_are_settings() {
        let settings = HomingSettings { cycles: [X, AxisMask::NONE, Z], passes: 2, ..settings(AxisMask::NONE) };
        let mut h = HomingCycle::new(settings, None);
        expect_move(h.begin(AxisMask::NONE), [300.0, 0.0, 0.0], X);
        for _ in 0..2 {
            // The switch has closed. A wait, a pull-off, a wait and a locate follow.
            h.next(X);
            expect_move(h.next(X), [-2.0, 0.0, 0.0], AxisMask::NONE);
            h.next(AxisMask::NONE);
            expect_move(h.next(AxisMask::NONE), [10.0, 0.0, 0.0], X);
        }
        h.next(X);
        h.next(X);
        h.next(AxisMask::NONE);
        assert!(matches!(h.next(AxisMask::NONE), Order::Reached(X, _)));
        // Y has no cycle.
        expect_move(h.next(AxisMask::NONE), [0.0, 0.0, 75.0], Z);
        let none = HomingSettings { cycles: [AxisMask::NONE; 3], ..settings };
        assert!(matches!(HomingCycle::new(none, None).begin(AxisMask::NONE), Order::Done(AxisMask::NONE)));
    }

    #[test]
    fn a_gantry_is_squared() {
        let second = AxisMask(SECOND_SWITCH);
        let settings =
            HomingSettings { cycles: [AxisMask(3); 3], squared: Some((Axis::Y, 5.0)), ..settings(AxisMask::NONE) };
        let mut h = HomingCycle::new(settings, None);
        let both = AxisMask(3 | SECOND_SWITCH);
        let expect = |order: Order<3>, by: [f32; 3], watch: AxisMask, motors: GangedMotors| {
            expect_move(order, by, watch);
            assert!(matches!(order, Order::Move { motors: m, .. } if m == motors), "{order:?}");
        };
        expect(h.begin(AxisMask::NONE), [300.0, 300.0, 0.0], both, GangedMotors::Both);
        // The second motor of Y reaches its switch first. So the first motor of Y moves on alone. X continues after
        // that.
        expect(h.next(second), [0.0, 5.0, 0.0], Y, GangedMotors::First);
        expect(h.next(AxisMask(second.0 | Y.0)), [300.0, 0.0, 0.0], X, GangedMotors::Both);
        assert!(matches!(h.next(both), Order::Wait(_)));
        expect(h.next(both), [-2.0, -2.0, 0.0], AxisMask::NONE, GangedMotors::Both);
        h.next(AxisMask::NONE);
        expect(h.next(AxisMask::NONE), [10.0, 10.0, 0.0], both, GangedMotors::Both);
        expect(h.next(Y), [0.0, 5.0, 0.0], second, GangedMotors::Second);
        // The second switch does not close.
        assert_eq!(h.next(Y), Order::Failed(Alarm::HomingSquaring));
    }

    #[test]
    fn a_second_switch_that_stays_closed_is_seen() {
        let settings = HomingSettings { cycles: [Y; 3], squared: Some((Axis::Y, 5.0)), ..settings(AxisMask::NONE) };
        let mut h = HomingCycle::new(settings, None);
        let both = AxisMask(Y.0 | SECOND_SWITCH);
        h.begin(AxisMask::NONE);
        h.next(both);
        h.next(both);
        h.next(AxisMask(SECOND_SWITCH));
        assert_eq!(h.next(AxisMask(SECOND_SWITCH)), Order::Failed(Alarm::HomingPullOff));
    }
}
