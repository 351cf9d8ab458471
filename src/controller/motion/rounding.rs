//! Decides when moves with a tolerance (G64) are queued. A move can be held back, merged with the next, or queued with
//! its corner cut off ([`super::blend`]). All held moves are queued as soon as the speed of the first block can depend
//! on them.
//!
//! Holding moves back costs no time as long as an entry in the queue has its maximum speed. Speeds before that entry
//! do not depend on later moves. (A tight bend among the held moves is an exception: it is found late, and the machine
//! brakes as hard as necessary for it.)
//!
//! If the queue is empty, or is short and no entry in it has its maximum speed, the held moves are queued at once. The
//! corner after the last of them then stays as programmed. So if moves arrive slowly, a corner is not rounded, but no
//! time is lost. Queued moves are never taken back, so all planned speeds stay valid.

use super::arc::Curvature;
use super::blend::{Blend, HeldMove};
use super::block::MAX_STEPS;
use super::junction::UNLIMITED2;
use super::queue::{MoveQueue, Numbering};
use super::trapezoid::{greater, lesser};
use super::{Move, Speed};
use crate::axes::{LINEAR, PerAxis};
use crate::image::FULL_IMAGE;

/// Moves are held back only if the look-ahead has at least this many blocks.
const LEAST_BLOCKS: usize = 32;
/// Maximum number of entries, counted from the start of the queue, that are searched for one at its maximum speed.
const MOST_ENTRIES: usize = 64;
/// Share of the maximum speed² from which an entry speed² counts as the maximum. With a jerk limit, the entry speed²
/// is the square of a rounded root, so it can be slightly too low.
const FULL: f32 = 0.999;

impl<const N: usize> MoveQueue<N> {
    /// Queues a move or holds it back. Later moves can be merged with a held move, and its corner can be rounded.
    /// Returns `false`, with nothing done, if there is no room.
    #[inline]
    pub(super) fn take(&mut self, m: &Move<N>) -> bool {
        if FULL_IMAGE && (m.tolerance.path > 0.0 || self.blend.is_holding()) {
            return self.take_within(m);
        }
        self.line(m)
    }

    /// Queues the held moves, then a chord of a curve. Returns `false`, with nothing done, if there is no room.
    #[inline]
    pub(super) fn take_chord(&mut self, m: &Move<N>, curvature: Curvature) -> bool {
        if self.blend.is_holding() {
            if self.free_blocks() == 0 {
                return false;
            }
            self.release();
        }
        self.chord(m, curvature)
    }

    #[inline(never)]
    fn take_within(&mut self, m: &Move<N>) -> bool {
        if self.free_blocks() == 0 {
            return false;
        }
        if !self.may_hold(m) {
            self.release();
            return self.line(m);
        }
        let m = &Move { tolerance: m.tolerance.bounded(self.limits.turns.deviation), ..*m };
        let number = self.number_of(m);
        let holding = self.blend.is_holding();
        if !holding && self.planner.len() == 0 {
            self.join.moves = 0;
        }
        let start = self.blend.end().unwrap_or(self.end.planned);
        if start == m.target {
            return true;
        }
        if self.blend.last_mut().is_some_and(|last| last.merge(m, number)) {
            self.join.moves += 1;
            return true;
        }
        if self.blend.is_full() {
            self.queue_oldest();
        }
        self.blend.push(HeldMove::new(start, m, number));
        true
    }

    /// Returns whether a move can be held back, so that its corners can be rounded. It must be a feed move with a
    /// tolerance, obey overrides, and fit into one block. The look-ahead must have at least [`LEAST_BLOCKS`] blocks.
    fn may_hold(&self, m: &Move<N>) -> bool {
        let from = self.kinematics.steps(&self.planned_position());
        let steps = self.kinematics.steps(&m.target);
        let most = steps.iter().zip(from.iter()).fold(0, |most, (to, from)| to.abs_diff(*from).max(most));
        m.tolerance.path > 0.0
            && matches!(m.speed, Speed::Feed(_))
            && !m.no_feed_override
            && self.planner.capacity() >= LEAST_BLOCKS
            && most < MAX_STEPS
    }

    /// Queues all held moves.
    #[inline(never)]
    pub(super) fn release(&mut self) {
        while self.blend.is_holding() {
            self.queue_oldest();
        }
    }

    /// Queues all held moves if the speed of the first block can depend on them.
    #[inline]
    pub(super) fn release_in_time(&mut self) {
        if self.blend.is_holding() && self.is_end_near() {
            self.release();
        }
    }

    /// Returns whether the speed of the first block can depend on the held moves. It cannot if an entry in the queue
    /// has its maximum speed.
    fn is_end_near(&mut self) -> bool {
        if !self.planner.jerk_limited {
            self.planner.settle();
        }
        for place in 1..MOST_ENTRIES {
            let Some(block) = self.planner.block(place) else { return true };
            if block.ramp.distance == 0.0 && block.entry2 >= FULL * block.max_entry2 {
                return false;
            }
        }
        false
    }

    /// Queues the oldest held move, and the pieces that cut off the corner after it.
    fn queue_oldest(&mut self) {
        let Some(oldest) = self.blend.pop() else { return };
        let next = self.blend.moves().next().copied();
        let cut = next.and_then(|next| {
            let steps_mm =
                self.kinematics.half_mm().iter().take(LINEAR).fold(0.0, |most, half| greater(most, 2.0 * half));
            let limit = |way: &[f32; N], length| self.limits.along(&PerAxis(*way), length).1;
            Blend::cut(&oldest, &next, &self.limits.turns, 2.0 * steps_mm, &limit).map(|cut| (cut, next))
        });
        let Some((cut, next)) = cut else { return self.queue_held(&oldest, &oldest.m) };
        self.queue_held(&oldest, &Move { target: cut.first, ..oldest.m });
        let speed = match (oldest.m.speed, next.m.speed) {
            (Speed::Feed(before), Speed::Feed(after)) => Speed::Feed(lesser(before, after)),
            (speed, _) => speed,
        };
        // The ends of the pieces are computed, not read from the program, so they are not rounded: their `digit` is 0.
        let digit = self.chain.program_digit();
        let places = cut.between.iter().flatten().chain(core::iter::once(&cut.last));
        for target in places {
            self.queue_held(&oldest, &Move { target: *target, speed, digit: 0.0, ..oldest.m });
        }
        self.chain.set_program_digit(digit);
    }

    /// Queues a held move, or a piece of it.
    fn queue_held(&mut self, held: &HeldMove<N>, piece: &Move<N>) {
        if piece.target == self.end.planned {
            return;
        }
        let numbering = core::mem::replace(&mut self.numbering, Numbering::Given(held.number));
        // If the corner of a move is cut off, its pieces can end between two steps, and their steps follow these exact
        // ends. A whole move begins and ends on full steps, as if it had no tolerance. With backlash compensation, all
        // ends are full steps.
        let true_ends = !held.is_whole(&self.end.planned, &piece.target) && !self.backlash.is_on();
        self.put(piece, UNLIMITED2, true_ends);
        self.numbering = numbering;
    }
}
