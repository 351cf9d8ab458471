//! A block: one straight move with everything that planning and stepping need to know of it, in 64 bytes at most.

use super::profile::lesser;

/// What a block's programmed speed means.
pub(super) const RAPID: u8 = 1;
/// Overrides leave the block alone (jog, homing, probing).
pub(super) const NO_OVERRIDE: u8 = 2;
/// Laser power follows the speed.
pub(super) const SCALE_POWER: u8 = 4;

/// Most steps of a block's dominant axis: 16 units of each, doubled by a counter that is about to step, fit 32 bits.
pub(super) const MAX_STEPS: u32 = 1 << 26;

/// Factors on programmed feeds and on rapids.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Overrides {
    pub feed: f32,
    pub rapid: f32,
}

/// A straight move. Lengths in mm, speeds in mm/s; `2` at the end of a name means squared.
#[derive(Clone, Copy, Debug)]
pub(super) struct Block<const N: usize> {
    pub steps: [u32; N],
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
    /// Planned entry speed: from it the rest of the queue can be braked to a stop.
    pub entry2: f32,
    pub power: u16,
    pub directions: u8,
    pub flags: u8,
}

impl<const N: usize> Block<N> {
    pub(super) const EMPTY: Self = Self {
        steps: [0; N],
        line_number: 0,
        length: 0.0,
        acceleration: 1.0,
        programmed: 0.0,
        limit: 0.0,
        corner2: 0.0,
        max_entry2: 0.0,
        entry2: 0.0,
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

    /// Steps of the axis that has most.
    #[inline]
    pub(super) fn dominant(&self) -> u32 {
        self.steps.iter().fold(0, |most, steps| most.max(*steps))
    }
}
