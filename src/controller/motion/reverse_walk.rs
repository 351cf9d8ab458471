//! The reverse pass without a jerk limit. From the last block to the first it sets the greatest entry speed from which
//! the machine can brake to the exit speed; it ends at the first entry that does not change. [`super::planner`] calls
//! it on pieces of its ring.

use super::block::Block;
use super::curvature::Bend;

/// A reverse pass on its way.
pub(super) struct Walk {
    /// The speed² at which the last block before what has been walked over is left.
    pub exit2: f32,
    /// Whether it looks for an entry that is settled.
    pub searching: bool,
    /// That entry; 0: none.
    pub settled: usize,
}

impl Walk {
    /// Brings the entries of some blocks in a row, the first of which is at a place, into line, from the last of them to the
    /// first. Ends with `false` at one that stays, in front of the place from which limits have `changed`.
    #[inline(never)]
    pub(super) fn back<const N: usize>(&mut self, blocks: &mut [Block<N>], from: usize, changed: usize) -> bool {
        let Self { mut exit2, mut searching, mut settled } = *self;
        let mut place = from + blocks.len();
        for block in blocks.iter_mut().rev() {
            place -= 1;
            let reach2 = block.braking_entry2(exit2);
            let is_capped = reach2 >= block.max_entry2;
            exit2 = if is_capped { block.max_entry2 } else { reach2 };
            if place < changed && block.entry2 == exit2 {
                self.settled = settled;
                return false;
            }
            block.entry2 = exit2;
            if searching {
                // What is before a steep block may get slower by what is appended.
                let is_steep = block.is_steep();
                if is_steep || is_capped && block.is_surely_capped(reach2) {
                    searching = false;
                    settled = if is_steep { 0 } else { place };
                }
            }
        }
        *self = Self { exit2, searching, settled };
        true
    }
}

/// What bends have lowered.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lowered {
    /// The first place; `usize::MAX`: none.
    pub first: usize,
    /// Behind the last one that has been walked over, 0 if none has.
    pub planned_end: usize,
}

impl Lowered {
    pub(super) const NONE: Self = Self { first: usize::MAX, planned_end: 0 };

    /// What either has.
    #[inline]
    pub(super) fn and(self, other: Self) -> Self {
        Self { first: self.first.min(other.first), planned_end: self.planned_end.max(other.planned_end) }
    }

    /// The first block of the queue has gone.
    #[inline]
    pub(super) fn pop(&mut self) {
        if self.first != usize::MAX {
            self.first = self.first.saturating_sub(1);
            self.planned_end = self.planned_end.saturating_sub(1);
        }
    }

    /// Lowers blocks in a row, the first of which is at a place.
    #[inline(never)]
    pub(super) fn lower<const N: usize>(&mut self, blocks: &mut [Block<N>], from: usize, bend: &Bend) {
        // Positive numbers are ordered as their bits are.
        let speed2 = bend.speed2.to_bits();
        for (index, block) in blocks.iter_mut().enumerate() {
            // Most blocks in a long bend are as low already. No entry is above its corner.
            let is_tighter = bend.curve.is_tighter(block.curve);
            if speed2 < block.corner2.to_bits() {
                block.corner2 = bend.speed2;
            } else if !is_tighter {
                continue;
            }
            if speed2 < block.max_entry2.to_bits() {
                block.max_entry2 = bend.speed2;
            } else if !is_tighter {
                continue;
            }
            block.curve = block.curve.tighter(bend.curve);
            self.first = self.first.min(from + index);
            // A block that came after the last walk has no entry.
            if block.entry2 > 0.0 {
                self.planned_end = from + index + 1;
            }
        }
    }
}
