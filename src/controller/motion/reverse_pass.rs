//! The reverse pass without a jerk limit. For each block, from the last to the first, it sets the maximum entry speed
//! from which the machine can brake to the exit speed. The pass ends at the first entry that does not change.
//! [`super::planner`] runs it on each contiguous part of its ring, and explains which entries are settled.

use super::block::Block;
use super::curvature::Bend;

/// Progress of a reverse pass, passed on from one part of the ring to the other.
pub(super) struct Walk {
    /// Exit speed² of the next block to process.
    pub exit2: f32,
    /// Whether the pass is still searching for a settled entry: one that is final, whatever is appended.
    pub searching: bool,
    /// Place of the last settled entry, the one nearest to the end of the queue; 0: none.
    pub settled: usize,
}

impl Walk {
    /// Updates the entries of consecutive blocks, from the last to the first. `from`: place of the first of these
    /// blocks in the queue; `changed`: place from which limits have changed. Returns `false` if the pass has ended at
    /// an unchanged entry before `changed`.
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
                // A block is steep if it is in a bend where a faster exit requires a slower entry. Entries before a
                // steep block can get slower when blocks are appended, so they are not settled.
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

/// Range of blocks whose limits were lowered by bends.
#[derive(Clone, Copy, Debug)]
pub(super) struct Lowered {
    /// Place of the first lowered block; `usize::MAX`: none.
    pub first: usize,
    /// Place after the last lowered block whose entry speed a reverse pass had already set; 0: there is no such block.
    pub planned_end: usize,
}

impl Lowered {
    pub(super) const NONE: Self = Self { first: usize::MAX, planned_end: 0 };

    /// Returns the range that covers both ranges.
    #[inline]
    pub(super) fn and(self, other: Self) -> Self {
        Self { first: self.first.min(other.first), planned_end: self.planned_end.max(other.planned_end) }
    }

    /// Moves the places forward by one, because the first block was removed from the queue.
    #[inline]
    pub(super) fn pop(&mut self) {
        if self.first != usize::MAX {
            self.first = self.first.saturating_sub(1);
            self.planned_end = self.planned_end.saturating_sub(1);
        }
    }

    /// Lowers consecutive blocks to the limits of `bend`. `from`: place of the first of them.
    #[inline(never)]
    pub(super) fn lower<const N: usize>(&mut self, blocks: &mut [Block<N>], from: usize, bend: &Bend) {
        // Speeds² are compared by their bits, because positive numbers have the same order as their bits.
        let speed2 = bend.speed2.to_bits();
        for (index, block) in blocks.iter_mut().enumerate() {
            // In a long bend, earlier calls have already lowered most blocks enough, so these blocks are skipped. If
            // `corner2` is low enough, `max_entry2` is low enough, too, because it never exceeds `corner2`.
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
            // If `entry2` is above 0, a reverse pass has already set the entry speed of the block.
            if block.entry2 > 0.0 {
                self.planned_end = from + index + 1;
            }
        }
    }
}
