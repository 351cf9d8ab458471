//! The homing cycle: which axes move where, when to stop, when to wait. It moves nothing itself: it gives an [`Order`]
//! and is told how that ended.
//!
//! ```text
//!  each cycle (Z, then X and Y together):
//!    seek at $25 ──switch──▶ wait $26 ──▶ pull off $27 ──▶ wait ──▶ locate at $24 ──switch──▶ wait ──▶ pull off ──▶ wait
//! ```
//! Motion stops dead at a switch (as the rates of homing allow; a ramp would run into the switch's end). Axes of a cycle
//! that have not reached theirs go on. The place of an axis is then the pull-off away from its switch.

use crate::axes::{Axis, AxisMask, PerAxis};
use crate::error::Alarm;
use crate::units::{Coordinate, Duration};

/// How far a seek goes, in travels of the longest axis of the cycle: beyond all of it, with a margin.
const SEEK_TRAVELS: f32 = 1.5;
/// How far a locate goes, in pull-offs.
const LOCATE_PULL_OFFS: f32 = 5.0;

/// The settings that homing needs, lengths in mm and rates in mm/s.
#[derive(Clone, Copy, Debug)]
pub struct HomingSettings<const N: usize> {
    /// `$23`: axes whose switch is at the negative end.
    pub to_negative: AxisMask,
    /// `$25`
    pub seek_rate: f32,
    /// `$24`
    pub locate_rate: f32,
    /// `$27`
    pub pull_off: f32,
    /// `$26`
    pub debounce: Duration,
    /// `$130` and on
    pub travel: PerAxis<f32, N>,
}

/// What is to be done next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Order<const N: usize> {
    /// Move by so much (mm) at a rate (mm/s, along the path). If `watch` is not empty, stop as soon as one of its axes'
    /// switches closes.
    Move {
        /// Distances in mm.
        by: PerAxis<f32, N>,
        /// Rate in mm/s.
        rate: f32,
        /// Switches that end it.
        watch: AxisMask,
    },
    /// Wait.
    Wait(Duration),
    /// The axes of the mask stand at the given machine coordinates; homing is over.
    Done(AxisMask, PerAxis<Coordinate, N>),
    /// It failed.
    Failed(Alarm),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Pass {
    Seek,
    SeekPullOff,
    Locate,
    LocatePullOff,
}

/// A homing cycle under way.
#[derive(Clone, Debug)]
pub struct Homing<const N: usize> {
    settings: HomingSettings<N>,
    /// Cycles still to come, the current one first.
    cycles: heapless::Deque<AxisMask, 8>,
    homed: AxisMask,
    pass: Pass,
    /// Axes of the current approach that have not reached their switch.
    approaching: AxisMask,
    /// The order given last was a move (else a wait).
    moving: bool,
}

impl<const N: usize> Homing<N> {
    /// Homes all axes (Z first, then X and Y together, then each further one), or only one.
    pub fn new(settings: HomingSettings<N>, only: Option<Axis>) -> Self {
        let mut cycles = heapless::Deque::new();
        let all = [
            AxisMask::NONE.with(Axis::Z),
            AxisMask::NONE.with(Axis::X).with(Axis::Y),
            AxisMask::NONE.with(Axis::A),
            AxisMask::NONE.with(Axis::B),
            AxisMask::NONE.with(Axis::C),
        ];
        match only {
            Some(axis) => {
                let _ = cycles.push_back(AxisMask::NONE.with(axis));
            }
            // Z and XY are two cycles; each axis beyond three has one more.
            None => {
                for cycle in all.into_iter().take(N - 1) {
                    let _ = cycles.push_back(cycle);
                }
            }
        }
        let approaching = cycles.front().copied().unwrap_or(AxisMask::NONE);
        Self { settings, cycles, homed: AxisMask::NONE, pass: Pass::Seek, approaching, moving: false }
    }

    /// The first order; `switches` are the limit switches that are closed now.
    pub fn begin(&mut self, switches: AxisMask) -> Order<N> {
        self.approach(switches)
    }

    /// The order after the last one has ended, by itself or because a watched switch closed; `switches` are the limit
    /// switches that are closed now.
    pub fn next(&mut self, switches: AxisMask) -> Order<N> {
        match (self.moving, self.pass) {
            (true, Pass::Seek | Pass::Locate) => {
                let reached = AxisMask(self.approaching.0 & switches.0);
                if reached.is_empty() {
                    return Order::Failed(Alarm::HomingNoSwitch);
                }
                self.approach(switches)
            }
            (true, Pass::SeekPullOff | Pass::LocatePullOff) => self.wait(),
            (false, Pass::Seek) => self.pull_off(Pass::SeekPullOff),
            (false, Pass::Locate) => self.pull_off(Pass::LocatePullOff),
            (false, Pass::SeekPullOff | Pass::LocatePullOff) if self.cycle().0 & switches.0 != 0 => {
                Order::Failed(Alarm::HomingPullOff)
            }
            (false, Pass::SeekPullOff) => {
                self.pass = Pass::Locate;
                self.approaching = self.cycle();
                self.approach(switches)
            }
            (false, Pass::LocatePullOff) => {
                self.homed = AxisMask(self.homed.0 | self.cycle().0);
                self.cycles.pop_front();
                if self.cycles.is_empty() {
                    return Order::Done(self.homed, self.places());
                }
                self.pass = Pass::Seek;
                self.approaching = self.cycle();
                self.approach(switches)
            }
        }
    }

    fn cycle(&self) -> AxisMask {
        self.cycles.front().copied().unwrap_or(AxisMask::NONE)
    }

    /// -1 for an axis whose switch is at its negative end.
    fn towards(&self, axis: Axis) -> f32 {
        if self.settings.to_negative.has(axis) { -1.0 } else { 1.0 }
    }

    fn wait(&mut self) -> Order<N> {
        self.moving = false;
        Order::Wait(self.settings.debounce)
    }

    /// Moves the axes that have not reached their switch; waits when all have.
    fn approach(&mut self, switches: AxisMask) -> Order<N> {
        self.approaching = AxisMask(self.approaching.0 & !switches.0);
        if self.approaching.is_empty() {
            return self.wait();
        }
        let (distance, rate) = if self.pass == Pass::Seek {
            let longest = Axis::of_machine::<N>()
                .filter(|axis| self.cycle().has(*axis))
                .filter_map(|axis| self.settings.travel.get(axis))
                .fold(0.0, |a: f32, b| if b > a { b } else { a });
            (SEEK_TRAVELS * longest, self.settings.seek_rate)
        } else {
            (LOCATE_PULL_OFFS * self.settings.pull_off, self.settings.locate_rate)
        };
        self.travel(self.approaching, distance, rate, self.approaching)
    }

    fn pull_off(&mut self, pass: Pass) -> Order<N> {
        self.pass = pass;
        self.travel(self.cycle(), -self.settings.pull_off, self.settings.seek_rate, AxisMask::NONE)
    }

    fn travel(&mut self, axes: AxisMask, distance: f32, rate: f32, watch: AxisMask) -> Order<N> {
        self.moving = true;
        let by = PerAxis::from_axis(|axis| if axes.has(axis) { self.towards(axis) * distance } else { 0.0 });
        // Each axis at the rate: the path of n axes is sqrt(n) times as fast.
        let count = axes.0.count_ones() as f32;
        Order::Move { by, rate: rate * libm::sqrtf(count), watch }
    }

    /// Where the axes stand after their last pull-off: the machine's space is negative, from -travel to 0.
    fn places(&self) -> PerAxis<Coordinate, N> {
        PerAxis::from_axis(|axis| {
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

    fn homing(to_negative: AxisMask) -> Homing<3> {
        let settings = HomingSettings {
            to_negative,
            seek_rate: 10.0,
            locate_rate: 1.0,
            pull_off: 2.0,
            debounce: Duration::millis(250),
            travel: PerAxis([200.0, 100.0, 50.0]),
        };
        Homing::new(settings, None)
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
        // X and Y together; Y reaches its switch first and X goes on alone.
        expect_move(h.next(AxisMask::NONE), [300.0, -300.0, 0.0], AxisMask(3));
        expect_move(h.next(Y), [300.0, 0.0, 0.0], X);
        assert_eq!(h.next(AxisMask(3)), wait);
        expect_move(h.next(AxisMask(3)), [-2.0, 2.0, 0.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        expect_move(h.next(AxisMask::NONE), [10.0, -10.0, 0.0], AxisMask(3));
        assert_eq!(h.next(AxisMask(3)), wait);
        expect_move(h.next(AxisMask(3)), [-2.0, 2.0, 0.0], AxisMask::NONE);
        assert_eq!(h.next(AxisMask::NONE), wait);
        let done = PerAxis([Coordinate::mm(-2), Coordinate::mm(-98), Coordinate::mm(-2)]);
        assert_eq!(h.next(AxisMask::NONE), Order::Done(AxisMask(7), done));
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
}
