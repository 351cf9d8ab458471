//! Joins short collinear moves into one block: keeps what is known of the last block of the queue, as long as further
//! moves may continue its line. So the look-ahead reaches farther than its number of blocks. [`super::short_moves`]
//! decides which moves continue.
//!
//! ```text
//!            P1 ───┐ half a step of each motor, and no more than the program's last digit can make
//!   A ─────────────┼───────────── C        the block from A is taken back, and the one from A to C is queued instead
//!          P2 ─────┘
//! ```
//! The line from A to C must pass all points between at no more than that distance in any motor, where the longest way among
//! the motors has come as far. Every point so allows a range of slopes to each other motor, and what counts is what all of
//! them allow: two numbers for each motor, however many points there are, and no sum of errors.
//!
//! A block is taken back by restoring the end of the queue as it was before; so lengths, corners and curvature are those of
//! a program that has the joined move in it. The chain of [`super::curvature`] gets a piece when nothing more is joined to it:
//! until then the queue ends there, at rest. A block that is taken back has never begun, and what the blocks before it count
//! on is kept: it can be entered as fast as before.

use super::curvature::PathPiece;
use super::kinematics::Kinematics;
use super::path_end::PathEnd;
use super::trapezoid::{greater, lesser};
use super::{Move, Speed};

/// The last digit counts as no less than this, mm: numbers with 24 bits are off by as much at 0.5 m from the last point.
const LEAST_DIGIT: f32 = 1.0e-4;
/// What is known of the last block of the queue.
#[derive(Clone, Debug)]
pub(super) struct Join<const N: usize> {
    /// It may be taken back for a longer one.
    pub open: bool,
    /// The chain has not got its piece yet.
    pub kept: bool,
    /// No point of it has been looked at.
    pub fresh: bool,
    /// The motor with the longest way, how far it has come, and the slopes to it that all points allow each motor.
    main: usize,
    reach: f32,
    slopes: [(f32, f32); N],
    /// Half a step of each motor, mm of its way.
    half_mm: [f32; N],
    /// Path along the points, mm.
    pub path: f32,
    /// Moves that made no block since the queue was empty.
    pub moves: usize,
    /// Of its piece of the path, for the chain: from end to end, the path and greatest speed².
    pub length: f32,
    pub block_path: f32,
    pub fast2: f32,
    /// The program's last digit.
    pub digit: f32,
    /// What its moves have in common.
    speed: Speed,
    power: u16,
    scale_power: bool,
    line_number: u32,
    /// The end of the queue before the last block: all that [`super::queue::MoveQueue::line`] changes but planner and chain.
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

    /// Takes over the resolution of the motors.
    pub(super) fn configure(&mut self, kinematics: &Kinematics<N>) {
        self.forget();
        self.half_mm = kinematics.half_mm();
    }

    /// The block that is being made stays as it is.
    #[inline]
    pub(super) fn close(&mut self) {
        self.open = false;
    }

    /// The queue has been cleared.
    pub(super) fn forget(&mut self) {
        self.open = false;
        self.kept = false;
    }

    /// Keeps the piece of a block that may be taken back from the chain.
    #[inline]
    pub(super) fn keeps(&mut self, piece: &PathPiece<'_, N>) -> bool {
        self.digit = piece.digit;
        if self.open {
            (self.length, self.block_path, self.fast2) = (piece.length, piece.path, piece.fast2);
        }
        self.kept = self.open;
        self.open
    }

    /// Whether a move is of the kind of the last block's.
    pub(super) fn is_like(&self, m: &Move<N>) -> bool {
        self.speed == m.speed
            && self.power == m.power
            && self.scale_power == m.scale_power
            && self.line_number == m.line_number
    }

    /// How far the longest way leads at a place (ways of the motors), if that is not back.
    pub(super) fn along(&self, way: &[f32; N]) -> Option<f32> {
        let along = way.get(self.main).copied()?;
        (along * self.reach > 0.0 && along.abs() >= self.reach.abs()).then_some(along)
    }

    /// Takes over a point of the line. `false`: it leads back, and nothing continues the line.
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
            // A point and the two ends may each be half a digit off, in this motor and in the main one.
            let range = lesser(half, digit * (1.0 + slope.abs())) * share.abs();
            *least = greater(*least, slope - range);
            *most = lesser(*most, slope + range);
        }
        true
    }

    /// Whether the straight line to here passes all points.
    pub(super) fn allows(&self, way: &[f32; N]) -> bool {
        let Some(along) = self.along(way) else { return false };
        let share = 1.0 / along;
        way.iter().zip(&self.slopes).all(|(part, (least, most))| (*least..=*most).contains(&(part * share)))
    }

    /// Notes the end of the queue before a block of its own is made of this move.
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

    /// After a first point at 1 mm of the main motor, with half steps of 0.5 mm.
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
