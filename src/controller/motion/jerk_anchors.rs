//! Look-ahead with a jerk limit: data about the path to the next anchor, for the reverse pass and for the running
//! ramp. An anchor is an entry (the start of a block) at which a ramp ends. [`super::planner`] describes how anchors
//! are found.

use super::block::{Block, CurveLoad};
use super::jerk::{Bounds, PathState, ramp_distance, ramp_speed};
use super::trapezoid::{lesser, square_root};

/// Ratio above which two bounds count as the same. On a curve, bounds change slightly from block to block. An anchor
/// (end of a ramp) at each change would cost more machine time than applying the tightest bounds to all of these
/// blocks.
const ALIKE: f32 = 0.8;

/// The path to the next anchor, from the block that the reverse pass has reached.
#[derive(Clone, Copy, Debug)]
pub(super) struct Way {
    /// Speed at the anchor, mm/s.
    pub speed: f32,
    /// Distance to the anchor, mm.
    pub distance: f32,
    /// Maximum speed² that the entries before the anchor allow.
    pub ceiling2: f32,
    /// The tightest acceleration and jerk bounds of the blocks up to the anchor.
    pub bounds: Bounds,
}

impl Way {
    pub(super) fn to(speed: f32) -> Self {
        Self { speed, distance: 0.0, ceiling2: f32::INFINITY, bounds: Bounds::NONE }
    }

    /// Returns whether a block's bounds differ noticeably from the tightest bounds on the way to the anchor.
    #[inline]
    pub(super) fn differs(&self, own: Bounds) -> bool {
        let apart = |a: f32, b: f32| a < ALIKE * b || b < ALIKE * a;
        apart(own.acceleration, self.bounds.acceleration) || apart(own.jerk, self.bounds.jerk)
    }

    /// Returns the speed of an additional anchor at the end of a block if this anchor shortens the ramp, otherwise
    /// `None`. Without the anchor, the tight bounds of one block would apply to all of a long ramp. `own`: bounds of
    /// the block; `cap2`: speed² from which the ramp comes down.
    #[inline(never)]
    pub(super) fn better_anchor(&self, own: Bounds, cap2: f32) -> Option<f32> {
        let ceiling = square_root(self.ceiling2);
        let top = lesser(square_root(cap2), ceiling);
        let here = lesser(ramp_speed(self.speed, self.distance, self.bounds), ceiling);
        let joined = ramp_distance(top, self.speed, self.bounds.and(own)) - self.distance;
        (ramp_distance(top, here, own) < joined).then_some(here)
    }
}

/// Summary of consecutive blocks: the limits for a machine that reduces its acceleration or deceleration to 0 on them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    /// Path length, mm.
    pub length: f32,
    /// Speed² of the slowest anchor among the entries of these blocks; infinite without an anchor.
    pub slowest2: f32,
    /// The tightest bounds of the blocks.
    pub bounds: Bounds,
    /// Minimum acceleration of the blocks, bends not considered.
    pub straight_acceleration: f32,
    /// Combination of the bends of all these blocks.
    pub curve: CurveLoad,
}

impl Stretch {
    /// Initial contents of the memory: all 0, so that static memory takes no flash.
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

/// The next anchor, as seen from a position before it on the path (mm and mm/s).
#[derive(Clone, Copy, Debug)]
pub(super) struct Target {
    pub speed: f32,
    pub distance: f32,
    pub ceiling: f32,
    pub bounds: Bounds,
}

impl Target {
    /// Returns the next speed that the ramp must come down to, and the distance to the point with that speed. This is
    /// the ceiling if the machine is faster than the ceiling, otherwise the anchor. The ceiling is the maximum speed
    /// with which a ramp to the anchor can begin.
    pub(super) fn nearest(&self, speed: f32) -> (f32, f32) {
        self.beyond(speed, f32::NEG_INFINITY)
    }

    /// Like [`Target::nearest`], for a segment of length `way`, mm. If the machine reaches the ceiling within the
    /// segment, returns the anchor instead. The ramp from the ceiling down to the anchor then begins with this segment,
    /// because it would begin too late with the next one.
    pub(super) fn beyond(&self, speed: f32, way: f32) -> (f32, f32) {
        if speed > self.ceiling {
            let distance = self.distance - ramp_distance(self.ceiling, self.speed, self.bounds);
            if distance > way {
                return (self.ceiling, distance);
            }
        }
        (self.speed, self.distance)
    }

    /// Returns whether a machine in this state can slow down to the ceiling or the anchor in time. The machine must not
    /// be accelerating.
    pub(super) fn is_met(&self, state: PathState) -> bool {
        let (speed, distance) = self.nearest(state.speed);
        state.lands(speed, distance, self.bounds)
    }
}
