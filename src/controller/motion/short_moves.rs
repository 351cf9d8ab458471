//! Decides which short moves are joined to the last block of the queue ([`super::join`]). A move is joined if it
//! continues the block's line and the speeds planned for earlier blocks stay valid. To join a move, the last block is
//! taken back and a longer one is queued.

use super::Move;
use super::axis_limits::shares;
use super::curvature::{EntryLimit, PathPiece, Span};
use super::queue::MoveQueue;
use super::trapezoid::{lesser, square_root};
use crate::axes::PerAxis;
use crate::units::{Coordinate, DECIMAL_ONE};

/// Maximum length of a move that is joined, as the sum of its displacements in all axes (0.045 mm). Longer moves remain
/// separate blocks. In X and Y, 512 moves just above this limit make a look-ahead of at least 16 mm, in which a machine
/// at 100 mm/s can brake to rest at 313 mm/s².
const MOST_PIECE: i64 = DECIMAL_ONE / 1000 * 45;
/// Maximum length of a block of joined moves, mm.
const MOST_JOINED: f32 = 0.5;
/// Maximum ratio of two lengths: the programmed path through the ends of all joined moves, and the straight line.
/// Rounding of the coordinates makes the path a staircase, at most √3 times as long as the line. A longer path winds
/// on purpose.
const MOST_WINDING: f32 = 1.75;

impl<const N: usize> MoveQueue<N> {
    /// Call before a block is made of a move. If the move continues the last block, takes that block back, so that the
    /// new block covers both moves. Then returns the entry speed² that the new block must allow, because earlier
    /// blocks are planned with it. Returns 0 if no block was taken back.
    #[inline]
    pub(super) fn join(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>, is_line: bool) -> f32 {
        if is_line && !m.no_feed_override && self.is_short(m) {
            return self.join_short(m, target_steps);
        }
        self.join.open = false;
        if self.join.kept && *target_steps != self.end.planned_steps {
            self.end_join();
        }
        0.0
    }

    /// Returns whether the displacements of all axes from the end of the last block add up to at most [`MOST_PIECE`].
    /// For most moves, the first axis alone exceeds this limit, so the check ends there.
    #[inline]
    fn is_short(&self, m: &Move<N>) -> bool {
        let mut ways = 0;
        m.target.iter().zip(self.end.block_end.iter()).all(|(to, from)| {
            ways += (to.0 - from.0).abs();
            ways <= MOST_PIECE
        })
    }

    #[inline(never)]
    fn join_short(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>) -> f32 {
        if self.planner.len() == 0 {
            self.join.moves = 0;
        }
        self.join.open &= self.join.is_like(m);
        self.join.digit = lesser(self.join.digit, m.digit);
        if *target_steps == self.end.planned_steps {
            // The move has no step, so it makes no block, but the line of the joined moves must pass its end, too.
            self.join.open = self.join.open && self.pass_by(m);
            return 0.0;
        }
        if self.join.open
            && let Some(least_entry2) = self.continues(m, target_steps)
        {
            self.join.moves += 1;
            self.take_back();
            return least_entry2;
        }
        self.end_join();
        self.join.remember(m, self.end);
        0.0
    }

    /// Stops joining moves to the last block. Then adds the block's piece of the path to the chain (the path in which
    /// bends are found), unless the piece is already there.
    #[inline(never)]
    pub(super) fn end_join(&mut self) {
        let join = &mut self.join;
        join.open = false;
        if core::mem::take(&mut join.kept) {
            let piece = PathPiece {
                start: &join.before.block_end,
                end: &self.end.block_end,
                direction: &self.end.direction,
                length: join.length,
                path: join.block_path,
                fast2: join.fast2,
                digit: join.digit,
            };
            let planner = &mut self.planner;
            let limit = EntryLimit::of(planner.last());
            self.chain.extend(&piece, limit, Span::of(&piece), &self.limits.turns, &mut |bend| planner.limit(&bend));
        }
    }

    /// Returns the motors' displacements from the start of the last block, mm.
    fn way_to(&self, place: &PerAxis<Coordinate, N>) -> [f32; N] {
        self.kinematics.way_of_motors(&place.zip(&self.join.before.block_end, |to, from| (to - from).to_mm()).0)
    }

    /// Adds the end of a move without a step to the points that the line of the joined moves must pass. Returns `false`
    /// if the line leads back to this point. No move can then continue the line.
    fn pass_by(&mut self, m: &Move<N>) -> bool {
        self.join.path += self.end.distance(&m.target);
        let way = self.way_to(&m.target);
        self.pass_end() && self.join.pass(&way)
    }

    /// Adds the end of the block's first move to the points that the line of the joined moves must pass, unless that
    /// was done already. Returns `false` if no move can continue the line.
    fn pass_end(&mut self) -> bool {
        if !self.join.fresh {
            return true;
        }
        let end = self.way_to(&self.end.block_end);
        self.join.pass(&end)
    }

    /// Checks whether a move can be joined to the last block: it continues the block's line, and stays within the
    /// limits for joined moves. If so, adds the end of the move to the points of the line. Returns the entry speed²
    /// that the longer block must allow, because earlier blocks may be planned for it; `None` if the move cannot be
    /// joined.
    fn continues(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>) -> Option<f32> {
        // A block that is alone in the queue can be running already, or its entry speed can be fixed already.
        if self.planner.len() < 2 && self.planner.is_entered() {
            return None;
        }
        let motors = self.way_to(&m.target);
        if !self.pass_end() || !self.join.allows(&motors) {
            return None;
        }
        let before = &self.join.before;
        let way = m.target.zip(&before.block_end, |to, from| (to - from).to_mm());
        let straight = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
        let path = self.join.path + self.end.distance(&m.target);
        if straight > MOST_JOINED || path > MOST_WINDING * straight {
            return None;
        }
        let skipped = before.planned.zip(&before.block_end, |to, from| (to - from).to_mm());
        let own = way.zip(&skipped, |way, skipped| way - skipped);
        let length = square_root(own.iter().fold(0.0, |sum, part| sum + part * part)) + before.length_carry;
        let moved = target_steps.zip(&before.planned_steps, i32::wrapping_sub);
        // Do not join if the new block would be too short for its steps, because `append` would use other limits. Do
        // not join without steps either, because there would be no block.
        let too_many = |(steps, mm): (&i32, f32)| (steps.unsigned_abs() as f32 - 0.5) * mm > 1.001 * length;
        if moved.iter().all(|steps| *steps == 0) || moved.iter().zip(self.kinematics.least_mm).any(too_many) {
            return None;
        }
        if self.backlash.is_on() {
            let mut after = self.backlash;
            after.turn(&target_steps.zip(&self.end.planned_steps, i32::wrapping_sub).0);
            if after.is_outstanding() {
                return None;
            }
        }
        // The longer block replaces the last one. From any speed from which the machine could brake to a stop within
        // the last block, it must be able to brake to a stop within the longer block.
        let last = self.planner.last()?;
        let shares = shares(&way, length);
        let (acceleration, _) = self.limits.along_shares(&shares);
        let braking = last.acceleration * last.length;
        if acceleration * length < braking {
            return None;
        }
        let eased = last.jerk * last.length * last.length;
        if self.planner.jerk_limited && self.limits.jerk_along(&shares, acceleration) * length * length < eased {
            return None;
        }
        let least_entry2 = lesser(last.max_entry2, 2.0 * braking);
        self.join.path = path;
        self.join.pass(&motors);
        Some(least_entry2)
    }

    /// Removes the last block and restores the end of the queue before it.
    fn take_back(&mut self) {
        self.end = self.join.before;
        self.planner.take_back();
    }

    /// Returns `true` if the sum of the queued blocks and of the moves joined into them reaches the capacity of the
    /// look-ahead. In that case, motion should start although the queue still has room.
    pub(super) fn has_joined_enough(&self) -> bool {
        self.join.moves > 0 && self.planner.len() + self.join.moves >= self.planner.capacity()
    }
}
