//! The look-ahead with a jerk limit: what the reverse pass and the running ramp know of the way to the next anchor. An
//! anchor is an entry at which a ramp ends; [`super::planner`] shows how they are found.

use super::block::{Block, CurveLoad};
use super::jerk::{Bounds, PathState, ramp_distance, ramp_speed};
use super::trapezoid::{lesser, square_root};

/// Bounds that differ by less than this factor are taken for the same: on a curve they change from block to block, and an
/// anchor at each of them would cost more than the tighter bounds.
const ALIKE: f32 = 0.8;

/// The way back from an anchor, while the reverse pass goes along it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    /// Of the anchor, mm/s.
    pub speed: f32,
    /// How far it is, mm.
    pub distance: f32,
    /// The greatest speed² that entries on the way allow.
    pub ceiling2: f32,
    /// The tightest ones on the way.
    pub bounds: Bounds,
}

impl Way {
    pub(super) fn to(speed: f32) -> Self {
        Self { speed, distance: 0.0, ceiling2: f32::INFINITY, bounds: Bounds::NONE }
    }

    /// Whether a block with these bounds is of another kind than those on the way.
    #[inline]
    pub(super) fn differs(&self, own: Bounds) -> bool {
        let apart = |a: f32, b: f32| a < ALIKE * b || b < ALIKE * a;
        apart(own.acceleration, self.bounds.acceleration) || apart(own.jerk, self.bounds.jerk)
    }

    /// The speed of an anchor right here, if a ramp from `cap2` gets shorter by ending here and not with this way: a block
    /// with tight bounds would else spoil all of a long ramp.
    #[inline(never)]
    pub(super) fn better_anchor(&self, own: Bounds, cap2: f32) -> Option<f32> {
        let ceiling = square_root(self.ceiling2);
        let top = lesser(square_root(cap2), ceiling);
        let here = lesser(ramp_speed(self.speed, self.distance, self.bounds), ceiling);
        let joined = ramp_distance(top, self.speed, self.bounds.and(own)) - self.distance;
        (ramp_distance(top, here, own) < joined).then_some(here)
    }
}

/// One or more blocks in a row, as a machine sees them that eases off its acceleration meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    /// Of the path, mm.
    pub length: f32,
    /// Speed² of the slowest anchor among the entries.
    pub slowest2: f32,
    /// The tightest ones.
    pub bounds: Bounds,
    /// The least acceleration without bends, and what all bends together leave.
    pub straight_acceleration: f32,
    pub curve: CurveLoad,
}

impl Stretch {
    /// All 0: memory that nothing has been written to.
    pub(super) const BLANK: Self = Self {
        length: 0.0,
        slowest2: 0.0,
        bounds: Bounds { acceleration: 0.0, jerk: 0.0 },
        straight_acceleration: 0.0,
        curve: CurveLoad::NONE,
    };

    pub(super) const NONE: Self = Self {
        length: 0.0,
        slowest2: f32::INFINITY,
        bounds: Bounds::NONE,
        straight_acceleration: f32::INFINITY,
        curve: CurveLoad::NONE,
    };

    #[inline]
    pub(super) fn and<const N: usize>(self, block: &Block<N>) -> Self {
        let anchor2 = if block.ramp.distance == 0.0 { block.entry2 } else { f32::INFINITY };
        Self {
            length: self.length + block.length,
            slowest2: lesser(self.slowest2, anchor2),
            bounds: self.bounds.and(block.bounds()),
            straight_acceleration: lesser(self.straight_acceleration, block.acceleration),
            curve: self.curve.and(block.curve),
        }
    }
}

/// The next anchor, seen from a place before it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    pub speed: f32,
    pub distance: f32,
    pub ceiling: f32,
    pub bounds: Bounds,
}

impl Target {
    /// Where the ramp has to come to first: down to the ceiling, in the same block as yet.
    pub(super) fn nearest(&self, speed: f32) -> (f32, f32) {
        self.beyond(speed, f32::NEG_INFINITY)
    }

    /// The same for what a machine does on the next way: if it comes to the ceiling within that, the ramp down from there
    /// begins with it. Otherwise it would begin a segment late, which tells: a sixth of the way of a ramp has to make up for it.
    pub(super) fn beyond(&self, speed: f32, way: f32) -> (f32, f32) {
        if speed > self.ceiling {
            let distance = self.distance - ramp_distance(self.ceiling, self.speed, self.bounds);
            if distance > way {
                return (self.ceiling, distance);
            }
        }
        (self.speed, self.distance)
    }

    /// Whether a machine in this state, not accelerating, can come down in time.
    pub(super) fn is_met(&self, state: PathState) -> bool {
        let (speed, distance) = self.nearest(state.speed);
        state.lands(speed, distance, self.bounds)
    }
}
