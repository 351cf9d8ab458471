//! Joins short collinear moves into one block, so that the look-ahead covers more moves than it has blocks. Stores the
//! data of the queue's last block as long as further moves can continue its line. [`super::short_moves`] selects the
//! moves to join.
//!
//! ```text
//!            P1 ───┐ at most half a step of each motor, and at most what rounding of the coordinates can cause
//!   A ─────────────┼───────────── C        the block from A is taken back, and the one from A to C is queued instead
//!          P2 ─────┘
//! ```
//! For every motor, the line from A to C must pass each point between A and C within the distance shown. Line and
//! point are compared where the main motor, the one with the longest displacement, has the same position. So each
//! point allows each other motor a range of slopes relative to the main motor. Only the intersection of the ranges of
//! all points is stored: two numbers per motor for any number of points. Errors do not add up.
//!
//! To take a block back, the previous end of the queue is restored. So lengths, corners and curvature are the same as
//! if the program contained the joined move. Only a block that has not begun is taken back, and the new block can be
//! entered as fast as the old one. So the speeds planned for earlier blocks stay valid.
//!
//! The chain (the last pieces of the path, in which [`super::curvature`] finds bends) gets the block's piece when no
//! more moves can be joined to the block. That is early enough: until then the block is the last one of the queue, and
//! the plan ends at rest there.

use super::curvature::PathPiece;
use super::kinematics::Kinematics;
use super::path_end::PathEnd;
use super::trapezoid::{greater, lesser};
use super::{Move, Speed};

/// Minimum resolution that is assumed for the program's coordinates, mm: an `f32` has an error of this order at 0.5 m
/// from the last point.
const LEAST_DIGIT: f32 = 1.0e-4;
/// Data of the last block of the queue, for joining moves to it.
#[derive(Clone, Debug)]
pub(super) struct Join<const N: usize> {
    /// Whether the last block can still be replaced by a longer one that covers the next move, too.
    pub open: bool,
    /// `true` if the block's piece of the path has not been added to the chain (see the head of this file) yet. The
    /// piece is kept back if the block can be replaced by a longer one.
    pub kept: bool,
    /// `true` as long as no point that the line must pass has been added.
    pub fresh: bool,
    /// The motor with the longest displacement.
    main: usize,
    /// Displacement of the main motor at the farthest point, mm.
    reach: f32,
    /// Range of each motor's slope, relative to the main motor, in which the line passes all added points.
    slopes: [(f32, f32); N],
    /// Displacement of each motor's belt or screw for half a step, mm.
    half_mm: [f32; N],
    /// Length of the programmed path through the ends of all joined moves, mm.
    pub path: f32,
    /// Number of moves that were joined or merged after the queue was last empty. They have no block of their own.
    pub moves: usize,
    /// Straight length of the block's piece of the path, mm ([`PathPiece::length`]). The piece is added to the chain
    /// when joining ends.
    pub length: f32,
    /// Path length of the block's piece, mm ([`PathPiece::path`]).
    pub block_path: f32,
    /// Maximum speed² of the block's piece under any override ([`PathPiece::fast2`]).
    pub fast2: f32,
    /// Resolution of the program's coordinates (value of their last decimal place), mm. For a block of several moves,
    /// this is the finest of their resolutions.
    pub digit: f32,
    /// Speed that the block's moves have in common. The next three fields are common to these moves, too.
    speed: Speed,
    power: u16,
    scale_power: bool,
    line_number: u32,
    /// The end of the queue before the last block, to be restored when that block is replaced by a longer one.
    pub before: PathEnd<N>,
}

impl<const N: usize> Join<N> {
    pub(super) const NONE: Self = Self {
        open: false,
        kept: false,
        fresh: false,
        main: 0,
        reach: 0.0,
        slopes: [(0.0, 0.0); N],
        half_mm: [0.0; N],
        path: 0.0,
        moves: 0,
        length: 0.0,
        block_path: 0.0,
        fast2: 0.0,
        digit: 0.0,
        speed: Speed::Rapid,
        power: 0,
        scale_power: false,
        line_number: 0,
        before: PathEnd::ZERO,
    };

    /// Sets the step size of each motor, and stops joining moves to the last block.
    pub(super) fn configure(&mut self, kinematics: &Kinematics<N>) {
        self.forget();
        self.half_mm = kinematics.half_mm();
    }

    /// Ends joining: no later move is joined to the block that is being made.
    #[inline]
    pub(super) fn close(&mut self) {
        self.open = false;
    }

    /// Call when the queue is cleared: no move is joined to the blocks that were in it.
    pub(super) fn forget(&mut self) {
        self.open = false;
        self.kept = false;
    }

    /// Call for each new block. If the block can still be replaced by a longer one, saves the data of its piece of the
    /// path and returns `true`. The caller then must not add the piece to the chain yet.
    #[inline]
    pub(super) fn keeps(&mut self, piece: &PathPiece<'_, N>) -> bool {
        self.digit = piece.digit;
        if self.open {
            (self.length, self.block_path, self.fast2) = (piece.length, piece.path, piece.fast2);
        }
        self.kept = self.open;
        self.open
    }

    /// Returns whether a move has the same speed, power and line number as the last block's moves.
    pub(super) fn is_like(&self, m: &Move<N>) -> bool {
        self.speed == m.speed
            && self.power == m.power
            && self.scale_power == m.scale_power
            && self.line_number == m.line_number
    }

    /// Returns the main motor's part of `way`; `None` if the main motor has moved back from its farthest point. `way`:
    /// displacements of all motors from the start of the line, mm.
    pub(super) fn along(&self, way: &[f32; N]) -> Option<f32> {
        let along = way.get(self.main).copied()?;
        (along * self.reach > 0.0 && along.abs() >= self.reach.abs()).then_some(along)
    }

    /// Adds a point that the line must pass. `way`: displacements of the motors from the start of the line to the
    /// point, mm. Returns `false` if the main motor moves back to this point, so that no move can continue the line.
    pub(super) fn pass(&mut self, way: &[f32; N]) -> bool {
        if core::mem::take(&mut self.fresh) {
            self.slopes = [(f32::NEG_INFINITY, f32::INFINITY); N];
            self.reach = 0.0;
            for (motor, part) in way.iter().enumerate() {
                if part.abs() > self.reach.abs() {
                    (self.main, self.reach) = (motor, *part);
                }
            }
        }
        let Some(along) = self.along(way) else { return false };
        self.reach = along;
        let share = 1.0 / along;
        let digit = greater(self.digit, LEAST_DIGIT);
        for ((least, most), (part, half)) in self.slopes.iter_mut().zip(way.iter().zip(self.half_mm)) {
            let slope = part * share;
            // Rounding of the coordinates can shift the point and each end of the line by half of the resolution. Both
            // the position of this motor and that of the main motor are shifted.
            let range = lesser(half, digit * (1.0 + slope.abs())) * share.abs();
            *least = greater(*least, slope - range);
            *most = lesser(*most, slope + range);
        }
        true
    }

    /// Returns `true` if the straight line from the start to `way` passes each added point within the distance allowed
    /// for that point. `way`: displacements of the motors, mm.
    pub(super) fn allows(&self, way: &[f32; N]) -> bool {
        let Some(along) = self.along(way) else { return false };
        let share = 1.0 / along;
        way.iter().zip(&self.slopes).all(|(part, (least, most))| (*least..=*most).contains(&(part * share)))
    }

    /// Call before a new block is made of a move: saves the end of the queue. Later moves can be joined to the block,
    /// unless the move has a duration.
    pub(super) fn remember(&mut self, m: &Move<N>, end: PathEnd<N>) {
        self.open = !matches!(m.speed, Speed::Duration(_));
        self.fresh = true;
        self.path = end.distance(&m.target);
        self.speed = m.speed;
        self.power = m.power;
        self.scale_power = m.scale_power;
        self.line_number = m.line_number;
        self.before = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axes::{Arrangement, PerAxis};
    use crate::units::StepsPerMm;

    /// Returns the data of a block that ends at its first point, 1 mm from the start along X, on a machine with steps
    /// of 1 mm. `digit`: resolution of the coordinates, mm.
    fn joined(digit: f32) -> Join<2> {
        let mut join = Join::NONE;
        join.configure(&Kinematics::new(Arrangement::Cartesian, PerAxis::all(StepsPerMm::ONE)));
        join.digit = digit;
        join.fresh = true;
        assert!(join.pass(&[1.0, 0.0]));
        join
    }

    #[test]
    fn a_line_has_to_pass_its_points_within_half_a_step() {
        let join = joined(1.0);
        assert!(join.allows(&[2.0, 0.9]) && join.allows(&[2.0, -0.9]));
        assert!(!join.allows(&[2.0, 1.1]));
    }

    #[test]
    fn a_line_has_to_pass_its_points_within_the_last_digit() {
        let join = joined(0.1);
        assert!(join.allows(&[2.0, 0.15]) && !join.allows(&[2.0, 0.25]));
    }

    #[test]
    fn a_move_back_continues_no_line() {
        let mut join = joined(1.0);
        assert!(!join.allows(&[0.5, 0.0]));
        assert!(!join.pass(&[-1.0, 0.0]));
    }
}
