//! A block: one straight move with everything that planning and stepping need to know of it, in 64 bytes at most.

use super::jerk::Bounds;
use super::profile::lesser;
use crate::messages::Leg;

/// What a block's programmed speed means.
pub(super) const RAPID: u8 = 1;
/// Overrides leave the block alone (jog, homing, probing).
pub(super) const NO_OVERRIDE: u8 = 2;
/// Laser power follows the speed.
pub(super) const SCALE_POWER: u8 = 4;

/// Most steps of a block's dominant axis: 16 units of each, doubled by a counter that is about to step, fit 32 bits.
pub(super) const MAX_STEPS: u32 = 1 << Leg::STEP_BITS;

/// Factors on programmed feeds and on rapids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Overrides {
    pub feed: f32,
    pub rapid: f32,
}

/// A straight move. Lengths in mm, speeds in mm/s; `2` at the end of a name means squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<const N: usize> {
    pub legs: [Leg; N],
    pub line_number: u32,
    /// Path length, lengths of moves too short for a step included.
    pub length: f32,
    /// Greatest acceleration along the path that no axis minds.
    pub acceleration: f32,
    /// Speed as programmed, before overrides.
    pub programmed: f32,
    /// Greatest speed along the path that no axis minds.
    pub limit: f32,
    /// What the corner with the block before allows, whatever the nominal speeds are.
    pub corner2: f32,
    /// Greatest entry speed: the corner and both nominal speeds.
    pub max_entry2: f32,
    /// Planned entry speed: from it the rest of the queue can be braked to a stop. With a jerk limit, that of the anchor
    /// that `ramp` leads to.
    pub entry2: f32,
    /// Greatest jerk along the path that no axis minds; means nothing without a jerk limit.
    pub jerk: f32,
    /// How the entry is planned with a jerk limit.
    pub ramp: Ramp,
    pub power: u16,
    pub directions: u8,
    pub flags: u8,
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
        let upper = |value: f32| (value.to_bits() >> 16) as u16;
        Self { distance, ceiling2, acceleration: upper(bounds.acceleration), jerk: upper(bounds.jerk) }
    }

    #[inline]
    pub(super) fn bounds(&self) -> Bounds {
        let whole = |upper: u16| f32::from_bits(u32::from(upper) << 16);
        Bounds { acceleration: whole(self.acceleration), jerk: whole(self.jerk) }
    }
}

impl<const N: usize> Block<N> {
    pub(super) const EMPTY: Self = Self {
        legs: [Leg::on_steps(0); N],
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
        power: 0,
        directions: 0,
        flags: 0,
    };

    /// The speed to run at under overrides.
    #[inline]
    pub(super) fn nominal(&self, overrides: Overrides) -> f32 {
        let wanted = if self.flags & NO_OVERRIDE != 0 {
            self.programmed
        } else if self.flags & RAPID != 0 {
            self.programmed * overrides.rapid
        } else {
            self.programmed * overrides.feed
        };
        lesser(wanted, self.limit)
    }

    /// What bounds changes of speed in the block.
    #[inline]
    pub(super) fn bounds(&self) -> Bounds {
        Bounds { acceleration: self.acceleration, jerk: self.jerk }
    }

    /// Steps of the axis that has most.
    #[inline]
    pub(super) fn dominant(&self) -> u32 {
        self.legs.iter().fold(0, |most, leg| most.max(leg.steps()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_block_is_no_larger_than_said() {
        assert_eq!(size_of::<Block<3>>(), 64);
        let bounds = Bounds { acceleration: 500.0, jerk: 12_345.0 };
        let kept = Ramp::new(1.0, 2.0, bounds).bounds();
        assert_eq!(kept.acceleration, 500.0);
        assert!(kept.jerk <= 12_345.0 && kept.jerk > 12_345.0 * 0.992);
    }
}
