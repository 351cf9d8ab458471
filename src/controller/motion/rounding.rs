//! Decides when moves with a tolerance (G64) are queued. A move may be held back, merged with the next, or queued with
//! its corner cut off ([`super::blend`]). All of them are queued as soon as the speed of the first block may depend on
//! them.
//!
//! What is held back costs nothing while the machine does not need it: as long as some entry ahead is as fast as it can ever
//! be, all speeds before it are what they are with any number of moves behind, but for a tight bend among those, for which the
//! machine brakes as for any that is seen late. Once none is, or the queue is empty, the
//! moves are queued as they are; so a link that is late costs a rounded corner, and no time. A move that is queued is never
//! taken back, so nothing that the machine counts on changes.

use super::arc::Curvature;
use super::blend::{Blend, HeldMove};
use super::block::MAX_STEPS;
use super::junction::UNLIMITED2;
use super::queue::{MoveQueue, Numbering};
use super::trapezoid::{greater, lesser};
use super::{Move, Speed};
use crate::axes::{LINEAR, PerAxis};
use crate::image::FULL_IMAGE;

/// A look-ahead shorter than this holds nothing back.
const LEAST_BLOCKS: usize = 32;
/// Entries that are looked at for one as fast as it can be.
const MOST_ENTRIES: usize = 64;
/// As fast as it can be: with a jerk limit the speed of an entry is a root that is squared again.
const FULL: f32 = 0.999;

impl<const N: usize> MoveQueue<N> {
    /// Queues a move, or holds it back. `false`: no room, nothing done.
    #[inline]
    pub(super) fn take(&mut self, m: &Move<N>) -> bool {
        if FULL_IMAGE && (m.tolerance.path > 0.0 || self.blend.is_holding()) {
            return self.take_within(m);
        }
        self.line(m)
    }

    /// Queues a chord of an arc, behind what has been held back.
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

    /// Whether a move is one of those that are rounded.
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

    /// Queues all that is held back.
    #[inline(never)]
    pub(super) fn release(&mut self) {
        while self.blend.is_holding() {
            self.queue_oldest();
        }
    }

    /// The same, once the machine needs it.
    #[inline]
    pub(super) fn release_in_time(&mut self) {
        if self.blend.is_holding() && self.is_end_near() {
            self.release();
        }
    }

    /// Whether the speed of the first block may depend on what is held back.
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

    /// Queues the oldest move that is held back, and the pieces that cut off the corner behind it.
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
        // Its ends are where they have been computed to be, whatever digits the program has.
        let digit = self.chain.program_digit();
        let places = cut.between.iter().flatten().chain(core::iter::once(&cut.last));
        for target in places {
            self.queue_held(&oldest, &Move { target: *target, speed, digit: 0.0, ..oldest.m });
        }
        self.chain.set_program_digit(digit);
    }

    /// Queues a piece of a move that has been held back, along its true ends.
    fn queue_held(&mut self, held: &HeldMove<N>, piece: &Move<N>) {
        if piece.target == self.end.planned {
            return;
        }
        let numbering = core::mem::replace(&mut self.numbering, Numbering::Given(held.number));
        // A whole move is queued as without a tolerance; what takes up slack is stepped from step to step.
        let true_ends = !held.is_whole(&self.end.planned, &piece.target) && !self.backlash.is_on();
        self.put(piece, UNLIMITED2, true_ends);
        self.numbering = numbering;
    }
}
