//! Canned cycles as a sequence of simple steps: rapids, feeds, dwells and spindle stops. The controller requests one
//! step at a time, so a hold or a reset can act between any two steps.
//!
//! ```text
//!  clear  ───▶ (in the plane, rapid) ──┐                        ▲
//!                                      │ rapid                  │ as the cycle says
//!  R      ─────────────────────────────┼────────────────────────┤
//!                                      │ feed, at once or       │
//!                                      │ in pecks of Q          │
//!  bottom                              ▼ dwell, spindle stop ───┘
//! ```
//! All levels are coordinates of the axis normal to the selected plane. If the tool starts below R, it first rises to R
//! without moving in the plane. The clear level is R with G99; with G98 it is the level at which the series of cycles
//! began, or R if R is higher. The levels and the order of the moves are those of RS274NGC.

use super::modal::{CycleKind, Plane, PlaneAxes};
use super::values::along;
use crate::axes::PerAxis;
use crate::messages::SpindleDirection;
use crate::units::{Coordinate, Duration};

/// Words that stay in force as long as the motion mode is this cycle, and the level to which G98 returns.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleWords {
    /// The holes are drilled normal to this plane.
    pub plane: Plane,
    /// R as written, in mm.
    pub r: Coordinate,
    /// The word of the axis normal to the plane, as written, in mm.
    pub depth: Coordinate,
    /// Q as written, in mm.
    pub peck: Coordinate,
    /// P: dwell at the bottom.
    pub dwell: Duration,
    /// The level to which G98 returns, without the tool length offset: the machine coordinate at which the series of
    /// cycles began, minus the offset at that time. G98 adds the offset in force, so that a longer tool returns to a
    /// higher machine coordinate.
    pub level: Coordinate,
}

impl CycleWords {
    /// No words: the state before the first cycle.
    pub const NONE: CycleWords = CycleWords {
        plane: Plane::Xy,
        r: Coordinate::ZERO,
        depth: Coordinate::ZERO,
        peck: Coordinate::ZERO,
        dwell: Duration::from_ticks(0),
        level: Coordinate::ZERO,
    };
}

/// Step of a cycle after the tool has reached the bottom of the hole.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum After {
    Dwell,
    SpindleOff,
    Pause,
    FeedToR,
    FeedToClear,
    RapidToClear,
    SpindleOn,
}

impl CycleKind {
    const fn after_bottom(self) -> &'static [After] {
        use After::{Dwell, FeedToClear, FeedToR, Pause, RapidToClear, SpindleOff, SpindleOn};
        match self {
            CycleKind::ChipBreak | CycleKind::Drill | CycleKind::Peck => &[RapidToClear],
            CycleKind::DrillDwell => &[Dwell, RapidToClear],
            CycleKind::Bore => &[FeedToR, RapidToClear],
            CycleKind::BoreStop => &[Dwell, SpindleOff, RapidToClear, SpindleOn],
            CycleKind::BoreManual => &[Dwell, SpindleOff, Pause, RapidToClear, SpindleOn],
            CycleKind::BoreDwell => &[Dwell, FeedToClear],
        }
    }

    /// Returns whether Q gives the depth of a peck.
    pub const fn pecks(self) -> bool {
        matches!(self, CycleKind::ChipBreak | CycleKind::Peck)
    }

    /// Returns whether P gives the dwell at the bottom.
    pub const fn dwells(self) -> bool {
        matches!(self, CycleKind::DrillDwell | CycleKind::BoreStop | CycleKind::BoreManual | CycleKind::BoreDwell)
    }

    /// Returns whether the spindle stops at the bottom.
    pub const fn stops_spindle(self) -> bool {
        matches!(self, CycleKind::BoreStop | CycleKind::BoreManual)
    }
}

/// Single step of a canned cycle, from [`Cycle::step`]. Positions are machine positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CycleStep<const N: usize> {
    /// Rapid to this machine position; its length can be 0.
    Rapid(PerAxis<Coordinate, N>),
    /// Feed move to this machine position at this speed in mm/s; its length can be 0.
    Feed(PerAxis<Coordinate, N>, f32),
    /// Dwell at the bottom.
    Dwell(Duration),
    /// The spindle stops at the bottom of the hole (G86, G88).
    SpindleOff,
    /// The program pauses until the operator continues it (G88).
    Pause,
    /// The spindle restarts, in the direction that it had before the cycle stopped it.
    SpindleOn(SpindleDirection),
}

/// The next step of a cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CyclePhase {
    /// Rise to R, without moving in the plane.
    Rise,
    /// Rapid to the next hole, in the plane.
    Plane,
    /// Rapid down to R.
    Approach,
    /// Feed to the bottom, or one peck towards it.
    Cut,
    /// Rapid out of the hole to R.
    Out,
    /// Rapid to where the next peck begins: down from R (G83), or up from the bottom of the previous peck (G73).
    Return,
    /// Steps after the bottom; the number counts the completed entries of [`CycleKind::after_bottom`].
    After(u8),
}

/// Canned cycle of one line: its holes, its levels (machine coordinates along the drilling axis) and its progress.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle<const N: usize> {
    /// Kind of cycle, which determines the steps: G83 drills in pecks, for example.
    pub kind: CycleKind,
    pub(super) axes: PlaneAxes,
    /// Position of the tool after the previous step.
    pub(super) place: PerAxis<Coordinate, N>,
    /// Position of the next hole; its coordinate along the depth is ignored.
    pub(super) hole: PerAxis<Coordinate, N>,
    /// Vector from one hole to the next.
    pub(super) pitch: [Coordinate; 2],
    /// Number of holes that are not finished yet, with the present one.
    pub(super) left: u32,
    pub(super) r: Coordinate,
    pub(super) bottom: Coordinate,
    pub(super) clear: Coordinate,
    /// Depth of one peck.
    pub(super) peck: Coordinate,
    /// Bottom of the latest peck.
    pub(super) reached: Coordinate,
    pub(super) next: CyclePhase,
    pub(super) feed: f32,
    pub(super) spindle: SpindleDirection,
    pub(super) words: CycleWords,
}

impl<const N: usize> Cycle<N> {
    pub(super) fn at_depth(&self, place: &PerAxis<Coordinate, N>, depth: Coordinate) -> PerAxis<Coordinate, N> {
        let mut place = *place;
        place.set(self.axes.linear, depth);
        place
    }

    /// Returns the position of a hole: of the next one for `count` 0, of the one after it for 1, and so on.
    pub(super) fn hole_after(&self, count: u32) -> PerAxis<Coordinate, N> {
        let mut hole = self.hole;
        for (axis, pitch) in [self.axes.first, self.axes.second].into_iter().zip(self.pitch) {
            let way = pitch.0.saturating_mul(i64::from(count));
            hole.set(axis, along(&hole, axis) + Coordinate(way));
        }
        hole
    }

    /// Returns points that enclose the whole cycle: each move begins and ends at one of these points or between two of
    /// them. The checks of the range and of the travel limits use them. Valid only before the first step.
    pub fn corners(&self) -> [PerAxis<Coordinate, N>; 6] {
        let high = along(&self.place, self.axes.linear).max(self.r);
        let last = self.hole_after(self.left.saturating_sub(1));
        [
            self.at_depth(&self.place, high),
            self.at_depth(&self.hole, high),
            self.at_depth(&self.hole, self.bottom),
            self.at_depth(&self.hole, self.clear),
            self.at_depth(&last, self.bottom),
            self.at_depth(&last, self.clear),
        ]
    }

    /// Returns whether the machine must stand still before the next step: a dwell, a pause, or a change of the
    /// spindle.
    pub fn next_rests(&self) -> bool {
        let CyclePhase::After(done) = self.next else { return false };
        matches!(
            self.kind.after_bottom().get(usize::from(done)),
            Some(After::Dwell | After::SpindleOff | After::Pause | After::SpindleOn)
        )
    }

    /// Returns the next step; `None` at the end of the cycle. `clearance`: with G73, the distance by which the tool
    /// backs off after a peck; with G83, the height above the bottom of the previous peck at which the rapid down
    /// ends. Neither move ends above R.
    pub fn step(&mut self, clearance: Coordinate) -> Option<CycleStep<N>> {
        let r = self.r;
        let (next, depth, is_feed) = match self.next {
            CyclePhase::Plane if self.left == 0 => return None,
            CyclePhase::Rise => (CyclePhase::Plane, along(&self.place, self.axes.linear).max(r), false),
            CyclePhase::Plane => {
                let level = along(&self.place, self.axes.linear);
                self.place = self.hole;
                (CyclePhase::Approach, level, false)
            }
            CyclePhase::Approach => {
                self.reached = r;
                (CyclePhase::Cut, r, false)
            }
            CyclePhase::Cut => {
                let peck = if self.kind.pecks() { self.reached - self.peck } else { self.bottom };
                self.reached = peck.max(self.bottom);
                let next = match self.kind {
                    _ if self.reached == self.bottom => CyclePhase::After(0),
                    CycleKind::Peck => CyclePhase::Out,
                    _ => CyclePhase::Return,
                };
                (next, self.reached, true)
            }
            CyclePhase::Out => (CyclePhase::Return, r, false),
            CyclePhase::Return => (CyclePhase::Cut, (self.reached + clearance).min(r), false),
            CyclePhase::After(done) => return self.after(done),
        };
        self.next = next;
        Some(self.go_to_depth(depth, is_feed))
    }

    fn after(&mut self, done: u8) -> Option<CycleStep<N>> {
        let all = self.kind.after_bottom();
        let after = all.get(usize::from(done)).copied()?;
        self.next = CyclePhase::After(done + 1);
        if usize::from(done) + 1 == all.len() {
            self.next = CyclePhase::Plane;
            self.hole = self.hole_after(1);
            self.left = self.left.saturating_sub(1);
        }
        Some(match after {
            After::Dwell => CycleStep::Dwell(self.words.dwell),
            After::SpindleOff => CycleStep::SpindleOff,
            After::Pause => CycleStep::Pause,
            After::FeedToR => self.go_to_depth(self.r, true),
            After::FeedToClear => self.go_to_depth(self.clear, true),
            After::RapidToClear => self.go_to_depth(self.clear, false),
            After::SpindleOn => CycleStep::SpindleOn(self.spindle),
        })
    }

    fn go_to_depth(&mut self, depth: Coordinate, is_feed: bool) -> CycleStep<N> {
        self.place.set(self.axes.linear, depth);
        if is_feed { CycleStep::Feed(self.place, self.feed) } else { CycleStep::Rapid(self.place) }
    }
}
