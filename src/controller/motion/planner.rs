//! The look-ahead: a ring of blocks, each with the greatest entry speed from which all that is queued behind it can still
//! be braked to a stop.
//!
//! ```text
//!   v²   ___                 corner limits      |
//!       /   \___      _____                      entry2 of each block: the reverse pass,
//!      /        \    /     \                     v²(entry) = min(corner, v²(exit) + 2·a·length)
//!     /          \__/       \____ 0
//! ```
//! Only the reverse pass is kept here. Acceleration towards those speeds needs no pass: the running block accelerates from
//! the speed it really has, so a speed that cannot be reached is just not reached, and holds, overrides and late blocks
//! need no repair of the queue. A new block changes the entries behind it only as far as they were limited by the old end
//! of the queue; the walk stops at the first that stays.

use super::block::{Block, Overrides};
use super::curvature::{Bend, bend_speed2};
use super::profile::{lesser, square_root};

/// Corners with less change of direction than this are straight: |difference of the unit vectors|² of 2 × 10⁻⁶ is the
/// cosine of -0.999999 at which Grbl stops to compute.
const STRAIGHT: f32 = 2.0e-6;
/// |difference of the unit vectors|² beyond which the move turns back on itself (cosine of 0.999999).
const REVERSAL: f32 = 4.0 - 2.0e-6;
/// Speed² of a corner that sets no limit; the nominal speeds do.
pub(super) const UNLIMITED2: f32 = 1.0e30;
/// Last digit of a program, mm: a corner that it can make of a straight line is none.
pub(super) const DIGIT: f32 = 0.001;

/// Speed² with which the corner between two directions (unit vectors, `turn2` = |difference|²) may be taken: that of a
/// circle which touches both and leaves the corner by `deviation`, at the greatest acceleration that no axis minds along
/// the corner's bisector; and if the corner is a bend of a chain, that of the chain (see `curvature`).
///
/// v² = a·d·s / (1 - s) with s = sin(half the inner angle). 1 - s is a small difference for gentle corners; with
/// |q|² = |current - previous|² = 4·(1 - s²) it is computed as |q|² / (4·(1 + s)) instead.
pub(super) fn corner_speed2<const N: usize>(
    previous: &[f32; N],
    current: &[f32; N],
    turn2: f32,
    lengths: [f32; 2],
    acceleration: &[f32; N],
    deviation: f32,
) -> f32 {
    let [first, second] = lengths;
    let shorter = lesser(first, second);
    if turn2 > REVERSAL {
        return 0.0;
    }
    if turn2 < STRAIGHT || turn2 * shorter * shorter < DIGIT * DIGIT {
        return UNLIMITED2;
    }
    let turn = square_root(turn2);
    let mut least = UNLIMITED2;
    for ((before, after), limit) in previous.iter().zip(current).zip(acceleration) {
        let part = (after - before).abs();
        if part * least > limit * turn {
            least = limit * turn / part;
        }
    }
    let sine = square_root((1.0 - 0.25 * turn2).max(0.0));
    let corner2 = least * deviation * sine * (1.0 + sine) / (0.25 * turn2);
    lesser(corner2, bend_speed2(previous, current, turn2, lengths, acceleration))
}

/// The ring of blocks. The first one may be running; its entry speed is then history.
#[derive(Clone, Debug)]
pub(super) struct Planner<const N: usize, const BLOCKS: usize> {
    blocks: [Block<N>; BLOCKS],
    first: usize,
    len: usize,
    /// Limits have changed from this place on.
    changed: usize,
}

impl<const N: usize, const BLOCKS: usize> Planner<N, BLOCKS> {
    #[inline(always)]
    pub(super) const fn new() -> Self {
        Self { blocks: [Block::EMPTY; BLOCKS], first: 0, len: 0, changed: 0 }
    }

    #[inline]
    pub(super) fn len(&self) -> usize {
        self.len
    }

    #[inline]
    pub(super) fn free(&self) -> usize {
        BLOCKS - self.len
    }

    #[inline]
    fn slot(&self, place: usize) -> usize {
        let index = self.first + place;
        if index >= BLOCKS { index - BLOCKS } else { index }
    }

    pub(super) fn first(&self) -> Option<&Block<N>> {
        if self.len == 0 { None } else { self.blocks.get(self.first) }
    }

    /// Entry speed² of the second block, the exit of the first; 0 without one.
    #[inline]
    pub(super) fn exit2(&self) -> f32 {
        if self.len < 2 { 0.0 } else { self.blocks.get(self.slot(1)).map_or(0.0, |block| block.entry2) }
    }

    pub(super) fn clear(&mut self) {
        self.first = 0;
        self.len = 0;
    }

    pub(super) fn pop(&mut self) {
        if self.len > 0 {
            self.first = self.slot(1);
            self.len -= 1;
        }
    }

    /// Appends a block (its `corner2` is set); `false` if the ring is full. [`Planner::plan`] has to follow.
    pub(super) fn push(&mut self, mut block: Block<N>, overrides: Overrides) -> bool {
        if self.len >= BLOCKS {
            return false;
        }
        let previous = match self.len {
            0 => 0.0,
            len => self.blocks.get(self.slot(len - 1)).map_or(0.0, |before| before.nominal(overrides)),
        };
        let nominal = lesser(block.nominal(overrides), previous);
        block.max_entry2 = lesser(block.corner2, nominal * nominal);
        let slot = self.slot(self.len);
        if let Some(place) = self.blocks.get_mut(slot) {
            *place = block;
            self.changed = self.len;
            self.len += 1;
        }
        true
    }

    /// Lowers corners that turn out to lie on a bend. What the machine is too fast for already is braked for, but not in
    /// time; that takes a queue shorter than the bend's span, whose end it has to be able to stop at all the same.
    pub(super) fn limit(&mut self, bend: &Bend) {
        for place in self.len.saturating_sub(bend.blocks).max(1)..self.len {
            let slot = self.slot(place);
            let Some(block) = self.blocks.get_mut(slot) else { return };
            block.corner2 = lesser(block.corner2, bend.speed2);
            if bend.speed2 < block.max_entry2 {
                block.max_entry2 = bend.speed2;
                self.changed = self.changed.min(place);
            }
        }
    }

    /// Brings the entries into line with what has been appended and limited.
    pub(super) fn plan(&mut self) {
        self.reverse_pass();
    }

    /// Applies new overrides to all blocks.
    pub(super) fn replan(&mut self, overrides: Overrides) {
        let mut previous = 0.0;
        for place in 0..self.len {
            let slot = self.slot(place);
            if let Some(block) = self.blocks.get_mut(slot) {
                let nominal = block.nominal(overrides);
                let least = nominal.min(previous);
                block.max_entry2 = block.corner2.min(least * least);
                previous = nominal;
            }
        }
        self.changed = 0;
        self.reverse_pass();
    }

    /// From the end of the queue towards the running block: over all that has changed, and on as far as entries change.
    fn reverse_pass(&mut self) {
        let mut exit2 = 0.0;
        let mut place = self.len;
        while place > 1 {
            place -= 1;
            let slot = self.slot(place);
            let Some(block) = self.blocks.get_mut(slot) else { return };
            let reachable2 = exit2 + 2.0 * block.acceleration * block.length;
            let entry2 = lesser(block.max_entry2, reachable2);
            if entry2 == block.entry2 && place < self.changed {
                return;
            }
            block.entry2 = entry2;
            exit2 = entry2;
        }
    }
}
