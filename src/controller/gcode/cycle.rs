//! Canned cycles as a sequence of simple steps: rapids, feeds, dwells and spindle stops. The controller asks for one
//! step at a time, so a hold or a reset acts between any two of them.
//!
//! ```text
//!  clear  ───▶ (in the plane, rapid) ──┐                        ▲
//!                                      │ rapid                  │ as the cycle says
//!  R      ─────────────────────────────┼────────────────────────┤
//!                                      │ feed, at once or       │
//!                                      │ in pecks of Q          │
//!  bottom                              ▼ dwell, spindle stop ───┘
//! ```
//! All levels lie along the axis across the selected plane. Where the tool is below R at the start, it first rises to R
//! above the point where it is. The clear level is R with G99, and with G98 the level at which the series of cycles
//! began, if that is above R. Order and levels are those of RS274NGC.

use super::modal::{CycleKind, Plane, PlaneAxes};
use super::values::along;
use crate::axes::PerAxis;
use crate::messages::SpindleDirection;
use crate::units::{Coordinate, Duration};

/// The words that stay in force while the same cycle word does, and the level that G98 goes back to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleWords {
    /// Across it the holes are drilled.
    pub plane: Plane,
    /// R as it was written, in mm.
    pub r: Coordinate,
    /// The word of the axis across the plane, as it was written, in mm.
    pub depth: Coordinate,
    /// Q, as it was written, in mm.
    pub peck: Coordinate,
    /// P.
    pub dwell: Duration,
    /// Machine coordinate at which the series of cycles began, less the tool offset: a longer tool goes back to a higher one.
    pub level: Coordinate,
}

impl CycleWords {
    /// Before the first cycle.
    pub const NONE: CycleWords = CycleWords {
        plane: Plane::Xy,
        r: Coordinate::ZERO,
        depth: Coordinate::ZERO,
        peck: Coordinate::ZERO,
        dwell: Duration::from_ticks(0),
        level: Coordinate::ZERO,
    };
}

/// What follows when the bottom is reached.
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

    /// Whether Q gives the depth of a peck.
    pub const fn pecks(self) -> bool {
        matches!(self, CycleKind::ChipBreak | CycleKind::Peck)
    }

    /// Whether P gives the dwell at the bottom.
    pub const fn dwells(self) -> bool {
        matches!(self, CycleKind::DrillDwell | CycleKind::BoreStop | CycleKind::BoreManual | CycleKind::BoreDwell)
    }

    /// Whether the spindle stops at the bottom.
    pub const fn stops_spindle(self) -> bool {
        matches!(self, CycleKind::BoreStop | CycleKind::BoreManual)
    }
}

/// One thing that a cycle does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CycleStep<const N: usize> {
    /// A rapid, which may be of no length.
    Rapid(PerAxis<Coordinate, N>),
    /// A feed move at so many mm/s, which may be of no length.
    Feed(PerAxis<Coordinate, N>, f32),
    /// At the bottom.
    Dwell(Duration),
    /// The spindle stops.
    SpindleOff,
    /// The program pauses.
    Pause,
    /// The spindle turns again.
    SpindleOn(SpindleDirection),
}

/// Which step is next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum CyclePhase {
    /// Up to R where the tool is.
    Rise,
    /// To the next hole, in the plane.
    Plane,
    /// Down to R.
    Approach,
    /// To the bottom, or a peck towards it.
    Cut,
    /// Out of the hole to R.
    Out,
    /// Down again, or back from the ground, to where the next peck begins.
    Return,
    /// So many of [`CycleKind::after_bottom`] are done.
    After(u8),
}

/// A cycle line: its holes, and how far it has come.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cycle<const N: usize> {
    /// Which cycle.
    pub kind: CycleKind,
    pub(super) axes: PlaneAxes,
    /// Where the tool is after the step before.
    pub(super) place: PerAxis<Coordinate, N>,
    /// The next hole; its coordinate along the depth does not count.
    pub(super) hole: PerAxis<Coordinate, N>,
    /// From a hole to the next one.
    pub(super) pitch: [Coordinate; 2],
    /// Holes that have not been begun.
    pub(super) left: u32,
    pub(super) r: Coordinate,
    pub(super) bottom: Coordinate,
    pub(super) clear: Coordinate,
    /// Depth of a peck.
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

    /// The hole that is so many after the next one.
    pub(super) fn hole_after(&self, count: u32) -> PerAxis<Coordinate, N> {
        let mut hole = self.hole;
        for (axis, pitch) in [self.axes.first, self.axes.second].into_iter().zip(self.pitch) {
            let way = pitch.0.saturating_mul(i64::from(count));
            hole.set(axis, along(&hole, axis) + Coordinate(way));
        }
        hole
    }

    /// The corners of all that is to come: every move leads from one of these points, or from a point between two of
    /// them, to another. Before the first step only.
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

    /// Whether motion has to be at rest before the next step.
    pub fn next_rests(&self) -> bool {
        let CyclePhase::After(done) = self.next else { return false };
        matches!(
            self.kind.after_bottom().get(usize::from(done)),
            Some(After::Dwell | After::SpindleOff | After::Pause | After::SpindleOn)
        )
    }

    /// The next step. `clearance`: how far the tool backs off after a peck, and above the ground of a hole it rapids
    /// down to; never above R.
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
