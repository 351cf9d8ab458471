//! The input side of motion ([`MoveQueue`]): the planner's blocks and the state at the end of the path.
//! [`super::enqueue`] turns moves into blocks. Before that, [`super::rounding`] merges moves and rounds corners, and
//! [`super::short_moves`] joins short moves.

use super::axis_limits::AxisLimits;
use super::backlash::{Backlash, Motors};
use super::blend::Blend;
use super::block::{Block, OverrideFactors};
use super::carried_time::CarriedTime;
use super::curvature::{Chain, Scale};
use super::jerk_anchors::Stretch;
use super::join::Join;
use super::kinematics::Kinematics;
use super::path_end::PathEnd;
use super::planner::Planner;
use super::{MotionSettings, Move};
use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::units::Coordinate;

/// Maximum backlash that is compensated, steps: 0.25 mm with 40,000 steps/mm.
pub(super) const MOST_BACKLASH: i32 = 10_000;
/// Maximum number of blocks of one move with backlash: one for the rest of the compensation before a plunge, one for
/// the part of the move in which compensation is made, and one for the rest of the move.
pub(super) const MOST_BLOCKS_OF_A_MOVE: usize = 3;

/// A move with more steps than a block can have. It is divided into equal pieces, each of which is queued as soon as
/// there is room for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct LongMove<const N: usize> {
    pub start: PerAxis<Coordinate, N>,
    pub whole: Move<N>,
    pub curve_speed2: f32,
    pub pieces: u32,
    pub next: u32,
}

/// Source of the blocks' line numbers, which appear in reports.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Numbering {
    /// The N word of the program line that the block comes from.
    Words,
    /// A number set by `Motion::number_moves`.
    Given(u32),
}

/// The queue of blocks, with the state needed to turn moves into blocks.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
#[repr(C)]
pub(super) struct MoveQueue<const N: usize> {
    pub kinematics: Kinematics<N>,
    pub backlash: Backlash<N>,
    pub limits: AxisLimits<N>,
    pub overrides: OverrideFactors,
    pub end: PathEnd<N>,
    /// Programmed time of the moves without a step whose length is carried over to the next block. Not restored when a
    /// block is taken back: only moves of the same feed are joined, and with a single feed this time has no effect.
    pub carried_time: CarriedTime,
    /// Offset of the exact end of the last move from the steps nearest to it, in sevenths of a step; `None` if that
    /// move was no chord of a curve.
    pub substep_offset: Option<[i32; N]>,
    pub long: Option<LongMove<N>>,
    pub numbering: Numbering,
    /// The mark for the blocks queued from now on ([`super::Motion::set_mark`]), already shifted to its bits in the
    /// blocks' flags.
    pub marked: u8,
    /// The last straight pieces of the path, from which its curvature is determined.
    pub chain: Chain<N>,
    /// Data of the last block, for joining short moves to it.
    pub join: Join<N>,
    /// Moves with a tolerance (G64) that are held back. They are not queued yet, because later moves can be merged with
    /// them and their corners can be rounded.
    pub blend: Blend<N>,
    pub planner: Planner<N>,
}

impl<const N: usize> MoveQueue<N> {
    /// Creates an empty queue. Call [`MoveQueue::configure`] before the first move.
    pub(super) fn new(blocks: Lent<[Block<N>]>, groups: Lent<[Stretch]>, scales: Lent<[Scale<N>]>) -> Self {
        Self {
            kinematics: Kinematics::ONE,
            backlash: Backlash::NONE,
            limits: AxisLimits::ONE,
            overrides: OverrideFactors::NONE,
            end: PathEnd::ZERO,
            carried_time: CarriedTime::NONE,
            substep_offset: None,
            long: None,
            numbering: Numbering::Words,
            marked: 0,
            chain: Chain::new(scales),
            join: Join::NONE,
            blend: Blend::NONE,
            planner: Planner::new(blocks, groups),
        }
    }

    /// Applies settings. Call only with an empty queue, and call [`MoveQueue::restart`] afterwards.
    pub(super) fn configure(&mut self, settings: &MotionSettings<N>) {
        self.kinematics = Kinematics::new(settings.arrangement, settings.steps_per_mm);
        self.join.configure(&self.kinematics);
        self.limits = AxisLimits::new(settings);
        self.planner.jerk_limited = self.limits.is_jerk_limited();
        let backlash = settings.backlash.zip(&settings.steps_per_mm, |mm, scale| (mm * scale.to_f32() + 0.5) as i32);
        self.backlash.configure(backlash.0.map(|steps| steps.clamp(0, MOST_BACKLASH)));
    }

    /// Clears the queue; the next move begins at `motors`. Returns `motors` with the lead limited to the backlash.
    pub(super) fn restart(&mut self, motors: Motors<N>) -> Motors<N> {
        self.backlash.rest(motors.lead);
        let motors = Motors { lead: self.backlash.lead(), ..motors };
        let steps = motors.tool();
        self.planner.clear();
        self.join.forget();
        self.blend.forget();
        self.long = None;
        self.end.restart(steps, self.kinematics.place(&steps));
        self.substep_offset = None;
        self.chain.restart(&self.end.planned);
        motors
    }

    /// Sets the position from which the next move is measured. The queue must be empty, and the motors must be on the
    /// steps nearest to this position.
    pub(super) fn set_position(&mut self, position: &PerAxis<Coordinate, N>) {
        self.end.planned = *position;
        self.end.block_end = *position;
        self.end.is_past_block = false;
        self.chain.restart(position);
    }

    /// Returns `true` if nothing is left: no block, no piece of a long move, no move that is held back.
    #[inline]
    pub(super) fn is_empty(&self) -> bool {
        self.planner.len() == 0 && self.long.is_none() && !self.blend.is_holding()
    }

    /// Returns how many more moves can be queued; 0 while a move of 2^26 steps or more is still being divided.
    #[inline]
    pub(super) fn free_blocks(&self) -> usize {
        let spare = if self.backlash.is_on() { MOST_BLOCKS_OF_A_MOVE.min(self.planner.capacity()) - 1 } else { 0 };
        if self.long.is_some() { 0 } else { self.planner.free().saturating_sub(spare + self.blocks_held()) }
    }

    /// Returns the programmed end of the last move, including moves that are held back or still being divided.
    pub(super) fn planned_position(&self) -> PerAxis<Coordinate, N> {
        if let Some(end) = self.blend.end() {
            return end;
        }
        self.long.map_or(self.end.planned, |long| long.whole.target)
    }

    /// Returns how many blocks must stay free for the moves held back.
    fn blocks_held(&self) -> usize {
        let pieces = match self.blend.moves().count() {
            0 => return 0,
            // The held move makes a corner with the next move. That takes four blocks besides the next move's own
            // block: the held move, and up to three pieces that cut off the corner.
            1 => 4,
            // The older held move is queued when the next move arrives: four blocks with the pieces of its corner. The
            // newer one then makes a corner with the next move: four blocks, as above.
            _ => 8,
        };
        if self.backlash.is_on() { pieces * MOST_BLOCKS_OF_A_MOVE } else { pieces }
    }

    /// Returns the line number for the block of a move: its N word, or the number set by `Motion::number_moves`.
    #[inline]
    pub(super) fn number_of(&self, m: &Move<N>) -> u32 {
        match self.numbering {
            Numbering::Words => m.line_number,
            Numbering::Given(number) => number,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::on_heap;

    #[test]
    fn backlash_keeps_blocks_back_for_what_a_move_takes_up() {
        let room = on_heap(8);
        let mut any = MoveQueue::<2>::new(room.blocks, room.groups, room.scales);
        assert_eq!((any.free_blocks(), any.is_empty()), (8, true));
        any.backlash.configure([5, 0]);
        assert_eq!(any.free_blocks(), 6);
        any.planner.push(Block::EMPTY, OverrideFactors::NONE);
        assert_eq!((any.free_blocks(), any.is_empty()), (5, false));
        any.restart(Motors::ZERO);
        assert!(any.is_empty());
    }
}
