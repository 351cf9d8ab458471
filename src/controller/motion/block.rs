//! A [`Block`]: one straight move with all data for planning and stepping, in 68 bytes for three axes. Also computes
//! the speed of a block under overrides, and its acceleration in bends. A `2` at the end of a name means squared:
//! `entry2` is the square of an entry speed.

use super::jerk::Bounds;
use super::trapezoid::{greater, lesser, square_root};
use crate::messages::AxisSteps;

/// Flag: the block is a rapid; the rapid override applies to its programmed speed.
pub(super) const RAPID: u8 = 1;
/// Flag: overrides have no effect on the block (jog, homing, probing).
pub(super) const NO_OVERRIDE: u8 = 2;
/// Flag: laser power is scaled with the speed.
pub(super) const SCALE_POWER: u8 = 4;

/// Lowest bit of the mark in a block's flags. The mark is the number from [`super::Motion::set_mark`] that ties a
/// change of outputs to the block.
pub(super) const MARK_SHIFT: u32 = 3;

/// The dominant axis of a block (the one with the most steps) must have fewer steps than this. At 16 units per step,
/// the block then has less than 2^30 units. The countdown to an axis' next step (`dda`) stays between -2^30 and 2^30,
/// so it fits a signed 32-bit number.
pub(super) const MAX_STEPS: u32 = 1 << AxisSteps::STEP_BITS;

/// Override factors for programmed feeds and for rapids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct OverrideFactors {
    pub feed: f32,
    pub rapid: f32,
}

impl OverrideFactors {
    /// No change: all speeds as programmed.
    pub(super) const NONE: Self = Self { feed: 1.0, rapid: 1.0 };
}

/// A straight move. Lengths in mm, speeds in mm/s; `2` at the end of a name means squared.
#[derive(Clone, Copy, Debug)]
pub struct Block<const N: usize> {
    pub(super) steps_by_axis: [AxisSteps; N],
    pub(super) line_number: u32,
    /// Path length, mm, including the preceding moves that were too short for a step.
    pub(super) length: f32,
    /// Maximum acceleration along the path at which no axis exceeds its limit, mm/s².
    pub(super) acceleration: f32,
    /// Programmed speed, before overrides.
    pub(super) programmed: f32,
    /// Maximum speed along the path at which no axis exceeds its limit, mm/s.
    pub(super) limit: f32,
    /// Maximum entry speed² that the corner before the block allows, regardless of nominal speeds.
    pub(super) corner2: f32,
    /// Maximum entry speed²: the lowest of `corner2`, this block's nominal speed² and the previous block's nominal
    /// speed².
    pub(super) max_entry2: f32,
    /// Planned entry speed², from which the machine can stop within the rest of the queue. With a jerk limit: the
    /// planned speed² at the end of `ramp`.
    pub(super) entry2: f32,
    /// Maximum jerk along the path at which no axis exceeds its limit, mm/s³. Unused without a jerk limit.
    pub(super) jerk: f32,
    /// Ramp from the entry to the next anchor; only with a jerk limit.
    pub(super) ramp: Ramp,
    /// The bend that the block is part of. The faster the block, the more of `acceleration` the bend takes.
    pub(super) curve: CurveLoad,
    pub(super) power: u16,
    pub(super) directions: u8,
    pub(super) flags: u8,
}

/// Returns the upper half of an `f32`: a positive number is rounded down by 0.8 % at most.
fn upper(value: f32) -> u16 {
    (value.to_bits() >> 16) as u16
}

fn of_upper(upper: u16) -> f32 {
    f32::from_bits(u32::from(upper) << 16)
}

/// The upper half of an infinite `f32` ([`upper`]).
const INFINITY: u16 = 0x7F80;

/// A bend of radius R that a block is part of. At its maximum speed v, where v² = a·R, the bend takes all of the
/// acceleration a. At a lower speed, it takes the share r = v²/(a·R). The rest is left for speeding up and braking.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct CurveLoad {
    /// The upper half (16 bits) of the bend's maximum speed² as an `f32`, subtracted from [`INFINITY`]. So 0 means no
    /// bend.
    below: u16,
    acceleration: u16,
}

/// Minimum share of the acceleration that is left for braking in a bend, so that the machine can always brake. Because
/// of this minimum, the accelerations along and across the path together can exceed the limit by up to 3 %.
const LEAST_BRAKING: f32 = 0.25;

/// Margin for rounding errors in [`Block::is_surely_capped`]. In a bend, rounding can lower an entry speed² by one bit
/// although the exit speed² rises. The errors of this block and of all later ones can add up.
const CAP_MARGIN: f32 = 0.999;

/// Share of the maximum entry speed² at which [`Block::bounds`] computes how much acceleration a bend leaves for a
/// jerk-limited ramp.
const RAMP_SHARE: f32 = 0.9;

impl CurveLoad {
    /// No bend: all of the acceleration is available along the path.
    pub(super) const NONE: Self = Self { below: 0, acceleration: 0 };

    /// Creates a bend with the maximum speed² `speed2`, at which it takes all of `acceleration` (mm/s²).
    pub(super) fn new(speed2: f32, acceleration: f32) -> Self {
        Self { below: INFINITY - upper(speed2), acceleration: upper(acceleration) }
    }

    #[inline]
    pub(super) fn is_none(self) -> bool {
        self.below == 0
    }

    /// Returns the bend's maximum speed², at which it takes all of the acceleration.
    pub(super) fn speed2(self) -> f32 {
        of_upper(INFINITY - self.below)
    }

    /// Returns the acceleration that the bend takes at [`CurveLoad::speed2`], mm/s².
    pub(super) fn acceleration(self) -> f32 {
        of_upper(self.acceleration)
    }

    /// Returns the tighter one of two bends.
    #[inline]
    pub(super) fn tighter(self, other: Self) -> Self {
        if other.is_tighter(self) { other } else { self }
    }

    /// Returns whether this bend allows a lower speed than `other`. Comparing the bits is enough, because positive
    /// `f32` values have the order of their bits.
    #[inline]
    pub(super) fn is_tighter(self, other: Self) -> bool {
        self.below > other.below
    }

    /// Returns a bend that leaves no more acceleration than either of the two bends: it has the lower speed² and the
    /// lower acceleration of the two. If the axes have different limits, the two values can come from different bends.
    #[inline]
    pub(super) fn and(self, other: Self) -> Self {
        if self.is_none() || other.is_none() {
            return self.tighter(other);
        }
        Self { below: self.below.max(other.below), acceleration: self.acceleration.min(other.acceleration) }
    }

    /// Returns the second tightest of three bends; `NONE` if one of them is `NONE`.
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

    /// Returns how much of the acceleration `along` (the maximum in the path's direction) is left at a speed². Two
    /// formulas keep the accelerations along and across the path together within each axis' limit (a and r as in
    /// [`CurveLoad`]):
    /// * a·√(1 - r²), because the two accelerations are perpendicular; the root counts as at least [`LEAST_BRAKING`];
    /// * along·(1 - r), because the shares r and 1 - r of an axis' limit add up to 1.
    ///
    /// Returns the result of the formula that leaves more acceleration, at most `along`.
    #[inline]
    pub(super) fn left(self, along: f32, speed2: f32) -> f32 {
        if self.is_none() { along } else { self.left_in_bend(along, speed2) }
    }

    /// Not inlined: most callers share this copy of [`CurveLoad::left_of`], which saves flash. Only the reverse pass
    /// and the running block inline it.
    #[inline(never)]
    fn left_in_bend(self, along: f32, speed2: f32) -> f32 {
        self.left_of(along, speed2)
    }

    #[inline(always)]
    pub(super) fn left_of(self, along: f32, speed2: f32) -> f32 {
        let share = lesser(speed2 / self.speed2(), 1.0);
        let circle = greater(square_root(1.0 - share * share), LEAST_BRAKING);
        lesser(greater(along * (1.0 - share), of_upper(self.acceleration) * circle), along)
    }
}

/// The ramp from a block's entry to the next anchor. An anchor is an entry that the machine can pass at its planned
/// speed with an acceleration of 0, so that a ramp can end there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Ramp {
    /// Distance to the anchor, mm; 0: this entry is an anchor itself.
    pub distance: f32,
    /// Maximum speed² at which a ramp to the anchor can begin. From a higher speed, the machine would be too fast at an
    /// entry before the anchor.
    pub ceiling2: f32,
    /// The lowest acceleration and the lowest jerk that the blocks up to the anchor allow. Each number is the upper
    /// half of an `f32`, so it is rounded down, by 0.8 % at most.
    acceleration: u16,
    jerk: u16,
}

impl Ramp {
    /// The ramp of an entry that is an anchor itself.
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
    /// Initial contents of the planner's ring: all 0, so that they take no flash.
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

    /// Returns the nominal speed under feed and rapid override, mm/s.
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

    /// Returns the maximum acceleration along the path at a speed², mm/s².
    #[inline]
    pub(super) fn acceleration_at(&self, speed2: f32) -> f32 {
        self.curve.left(self.acceleration, speed2)
    }

    /// Returns the maximum entry speed² from which the machine can brake to the exit speed² `exit2` within the block.
    /// Does not apply `max_entry2`.
    #[inline(always)]
    pub(super) fn braking_entry2(&self, exit2: f32) -> f32 {
        let along = self.acceleration;
        let left = if self.curve.is_none() { along } else { self.curve.left_of(along, exit2) };
        exit2 + 2.0 * left * self.length
    }

    /// Returns [`Block::braking_entry2`], at most `max_entry2`.
    #[cfg(test)]
    pub(super) fn entry_before(&self, exit2: f32) -> f32 {
        lesser(self.max_entry2, self.braking_entry2(exit2))
    }

    /// Returns `true` if the entry speed² certainly stays at `max_entry2` when the exit speed rises, even with rounding
    /// errors. `reach2`: the current [`Block::braking_entry2`].
    #[inline]
    pub(super) fn is_surely_capped(&self, reach2: f32) -> bool {
        CAP_MARGIN * reach2 >= self.max_entry2
    }

    /// Returns whether a higher exit speed can lower the possible entry speed. A bend leaves less deceleration at a
    /// higher exit speed. So the speed² that braking takes off within the block can fall by more than the exit speed²
    /// rises. The check assumes the steepest slope of [`CurveLoad::left`]. This slope occurs where the share left for
    /// braking falls to [`LEAST_BRAKING`].
    #[inline]
    pub(super) fn is_steep(&self) -> bool {
        let acceleration = greater(self.acceleration, self.curve.acceleration());
        !self.curve.is_none() && 2.0 / LEAST_BRAKING * acceleration * self.length > self.curve.speed2()
    }

    /// Returns the bounds on changes of speed in the block.
    ///
    /// In a bend, the acceleration bound is the acceleration that the bend leaves at nine tenths of the maximum entry
    /// speed². A ramp needs its maximum acceleration about half way up, and its speed is lower there.
    #[inline]
    pub(super) fn bounds(&self) -> Bounds {
        let acceleration = self.acceleration_at(RAMP_SHARE * self.max_entry2);
        Bounds { acceleration, jerk: self.jerk }
    }

    /// Returns the number of steps of the dominant axis.
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
