//! A [`Block`]: one straight move with all that planning and stepping need, in at most 68 bytes. In names a `2` at the
//! end means squared (`entry2` is an entry speed squared). Also what overrides and bends leave of a block's speed and
//! acceleration.

use super::jerk::Bounds;
use super::trapezoid::{greater, lesser, square_root};
use crate::messages::AxisSteps;

/// What a block's programmed speed means.
pub(super) const RAPID: u8 = 1;
/// Overrides leave the block alone (jog, homing, probing).
pub(super) const NO_OVERRIDE: u8 = 2;
/// Laser power follows the speed.
pub(super) const SCALE_POWER: u8 = 4;

/// The bits of the flags from here on are the mark of the block: see [`super::Motion::set_mark`].
pub(super) const MARK_SHIFT: u32 = 3;

/// Most steps of a block's dominant axis: 16 units of each, doubled by a counter that is about to step, fit 32 bits.
pub(super) const MAX_STEPS: u32 = 1 << AxisSteps::STEP_BITS;

/// Factors on programmed feeds and on rapids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OverrideFactors {
    pub feed: f32,
    pub rapid: f32,
}

impl OverrideFactors {
    /// As programmed.
    pub(super) const NONE: Self = Self { feed: 1.0, rapid: 1.0 };
}

/// A straight move. Lengths in mm, speeds in mm/s; `2` at the end of a name means squared.
#[derive(Clone, Copy, Debug)]
pub struct Block<const N: usize> {
    pub(super) steps_by_axis: [AxisSteps; N],
    pub(super) line_number: u32,
    /// Path length, lengths of moves too short for a step included.
    pub(super) length: f32,
    /// Greatest acceleration along the path at which no axis goes beyond its own, mm/s².
    pub(super) acceleration: f32,
    /// Speed as programmed, before overrides.
    pub(super) programmed: f32,
    /// Greatest speed along the path at which no axis goes beyond its own, mm/s.
    pub(super) limit: f32,
    /// What the corner with the block before allows, whatever the nominal speeds are.
    pub(super) corner2: f32,
    /// Greatest entry speed: the corner and both nominal speeds.
    pub(super) max_entry2: f32,
    /// Planned entry speed: from it the rest of the queue can be braked to a stop. With a jerk limit, that of the anchor
    /// that `ramp` leads to.
    pub(super) entry2: f32,
    /// Greatest jerk along the path at which no axis goes beyond its own, mm/s³; means nothing without a jerk limit.
    pub(super) jerk: f32,
    /// How the entry is planned with a jerk limit.
    pub(super) ramp: Ramp,
    /// What a bend leaves of the acceleration.
    pub(super) curve: CurveLoad,
    pub(super) power: u16,
    pub(super) directions: u8,
    pub(super) flags: u8,
}

/// The upper half of an `f32`: rounded down by 0.8 % at most.
fn upper(value: f32) -> u16 {
    (value.to_bits() >> 16) as u16
}

fn of_upper(upper: u16) -> f32 {
    f32::from_bits(u32::from(upper) << 16)
}

/// [`upper`] of what is beyond all numbers.
const INFINITY: u16 = 0x7F80;

/// A bend on which the block lies. At its full speed v² = a·R it takes all of the acceleration a, at a lower one the share
/// r = v²/(a·R); what is left is for speeding up and braking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CurveLoad {
    /// Bits by which the speed² is below that of none, so that none is 0.
    below: u16,
    acceleration: u16,
}

/// Least share of the acceleration that a bend leaves: both together exceed it by 3 %, and the machine can always brake.
const LEAST_SHARE: f32 = 0.25;

/// Share of a speed² that rounding leaves for certain: in a bend, a bit may be lost where the exit rises, and in each of the
/// blocks behind.
const SURELY: f32 = 0.999;

/// Share of the greatest speed² at which a ramp with bounded jerk still has all of its acceleration.
const RAMP_SHARE: f32 = 0.9;

impl CurveLoad {
    /// Straight.
    pub(super) const NONE: Self = Self { below: 0, acceleration: 0 };

    /// A bend that takes all of `acceleration` (mm/s²) at the speed².
    pub(super) fn new(speed2: f32, acceleration: f32) -> Self {
        Self { below: INFINITY - upper(speed2), acceleration: upper(acceleration) }
    }

    #[inline]
    pub(super) fn is_none(self) -> bool {
        self.below == 0
    }

    /// The speed² at which it takes all of the acceleration, and that acceleration, mm/s².
    pub(super) fn speed2(self) -> f32 {
        of_upper(INFINITY - self.below)
    }

    pub(super) fn acceleration(self) -> f32 {
        of_upper(self.acceleration)
    }

    /// The tighter one of two.
    #[inline]
    pub(super) fn tighter(self, other: Self) -> Self {
        if other.is_tighter(self) { other } else { self }
    }

    /// Positive numbers are ordered as their bits are.
    #[inline]
    pub(super) fn is_tighter(self, other: Self) -> bool {
        self.below > other.below
    }

    /// One that leaves no more than either: the lower speed² and the lesser acceleration, which may be those of different
    /// bends where the axes are unequal.
    #[inline]
    pub(super) fn and(self, other: Self) -> Self {
        if self.is_none() || other.is_none() {
            return self.tighter(other);
        }
        Self { below: self.below.max(other.below), acceleration: self.acceleration.min(other.acceleration) }
    }

    /// The middle one of three; none if one of them is none.
    #[inline]
    pub(super) fn middle(self, second: Self, third: Self) -> Self {
        let (tight, gentle) = if self.is_tighter(second) { (self, second) } else { (second, self) };
        if gentle.is_none() || third.is_none() {
            Self::NONE
        } else if third.is_tighter(tight) {
            tight
        } else {
            gentle.tighter(third)
        }
    }

    /// What is left of an acceleration `along` the path at a speed². Along the path and across it, the sum of both on each
    /// axis is within its limit, either as parts of a circle, a·√(1 - r²), or as shares, 1 - r of what the path's own
    /// direction allows.
    #[inline]
    pub(super) fn left(self, along: f32, speed2: f32) -> f32 {
        if self.is_none() { along } else { self.left_in_bend(along, speed2) }
    }

    /// Once in the image, but for the walk over the queue.
    #[inline(never)]
    fn left_in_bend(self, along: f32, speed2: f32) -> f32 {
        self.left_of(along, speed2)
    }

    #[inline(always)]
    pub(super) fn left_of(self, along: f32, speed2: f32) -> f32 {
        let share = lesser(speed2 / self.speed2(), 1.0);
        let circle = greater(square_root(1.0 - share * share), LEAST_SHARE);
        lesser(greater(along * (1.0 - share), of_upper(self.acceleration) * circle), along)
    }
}

/// The way from a block's entry to the next anchor: an entry at which the machine may be at the planned speed and without
/// acceleration, and at whose speed a ramp can end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ramp {
    /// mm; 0: this entry is an anchor itself.
    pub distance: f32,
    /// Speed² from which a ramp to the anchor may begin at most, for it would pass an entry in between too fast.
    pub ceiling2: f32,
    /// The tightest bounds on the way, each the upper half of an `f32` (rounded down by 0.8 % at most).
    acceleration: u16,
    jerk: u16,
}

impl Ramp {
    /// An anchor.
    pub(super) const ANCHOR: Self = Self { distance: 0.0, ceiling2: f32::INFINITY, acceleration: 0x7F80, jerk: 0x7F80 };

    #[inline]
    pub(super) fn new(distance: f32, ceiling2: f32, bounds: Bounds) -> Self {
        Self { distance, ceiling2, acceleration: upper(bounds.acceleration), jerk: upper(bounds.jerk) }
    }

    #[inline]
    pub(super) fn bounds(&self) -> Bounds {
        Bounds { acceleration: of_upper(self.acceleration), jerk: of_upper(self.jerk) }
    }
}

impl<const N: usize> Block<N> {
    /// What a ring is made of before it has blocks: all 0, so that it needs no flash.
    pub const NONE: Self = Self {
        acceleration: 0.0,
        jerk: 0.0,
        ramp: Ramp { distance: 0.0, ceiling2: 0.0, acceleration: 0, jerk: 0 },
        ..Self::EMPTY
    };

    pub(super) const EMPTY: Self = Self {
        steps_by_axis: [AxisSteps::on_steps(0); N],
        line_number: 0,
        length: 0.0,
        acceleration: 1.0,
        programmed: 0.0,
        limit: 0.0,
        corner2: 0.0,
        max_entry2: 0.0,
        entry2: 0.0,
        jerk: 1.0,
        ramp: Ramp::ANCHOR,
        curve: CurveLoad::NONE,
        power: 0,
        directions: 0,
        flags: 0,
    };

    /// The speed to run at under feed and rapid override.
    #[inline]
    pub(super) fn nominal(&self, overrides: OverrideFactors) -> f32 {
        let wanted = if self.flags & NO_OVERRIDE != 0 {
            self.programmed
        } else if self.flags & RAPID != 0 {
            self.programmed * overrides.rapid
        } else {
            self.programmed * overrides.feed
        };
        lesser(wanted, self.limit)
    }

    /// Greatest acceleration along the path at a speed².
    #[inline]
    pub(super) fn acceleration_at(&self, speed2: f32) -> f32 {
        self.curve.left(self.acceleration, speed2)
    }

    /// Greatest entry speed² from which it can be braked to an exit speed², whatever else bounds it.
    #[inline(always)]
    pub(super) fn braking_entry2(&self, exit2: f32) -> f32 {
        let along = self.acceleration;
        let left = if self.curve.is_none() { along } else { self.curve.left_of(along, exit2) };
        exit2 + 2.0 * left * self.length
    }

    /// The same within its cap.
    #[cfg(test)]
    pub(super) fn entry_before(&self, exit2: f32) -> f32 {
        lesser(self.max_entry2, self.braking_entry2(exit2))
    }

    /// Whether its entry, from which it could be braked at a speed², stays at its cap where the exit rises.
    #[inline]
    pub(super) fn is_surely_capped(&self, reach2: f32) -> bool {
        SURELY * reach2 >= self.max_entry2
    }

    /// Whether a higher exit may let it be entered less fast, because a bend then leaves so much less to brake with: not while the
    /// greatest slope of [`CurveLoad::left`], at its least share, takes no more than the exit adds.
    #[inline]
    pub(super) fn is_steep(&self) -> bool {
        let acceleration = greater(self.acceleration, self.curve.acceleration());
        !self.curve.is_none() && 2.0 / LEAST_SHARE * acceleration * self.length > self.curve.speed2()
    }

    /// What bounds changes of speed in the block.
    #[inline]
    ///
    /// In a bend the acceleration of a ramp is greatest about half way up, below nine tenths of the speed²: it is
    /// counted with what is left there.
    pub(super) fn bounds(&self) -> Bounds {
        let acceleration = self.acceleration_at(RAMP_SHARE * self.max_entry2);
        Bounds { acceleration, jerk: self.jerk }
    }

    /// Steps of the axis that has most.
    #[inline]
    pub(super) fn dominant(&self) -> u32 {
        self.steps_by_axis.iter().fold(0, |most, axis_steps| most.max(axis_steps.steps()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_no_larger_than_said() {
        assert_eq!(size_of::<Block<3>>(), 68);
        let bounds = Bounds { acceleration: 500.0, jerk: 12_345.0 };
        let kept = Ramp::new(1.0, 2.0, bounds).bounds();
        assert_eq!(kept.acceleration, 500.0);
        assert!(kept.jerk <= 12_345.0 && kept.jerk > 12_345.0 * 0.992);
    }
}
