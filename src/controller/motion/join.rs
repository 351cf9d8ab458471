//! Short moves that continue a line become one block with it, so that the look-ahead reaches farther than its count of
//! blocks.
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

use super::curvature::Piece;
use super::kinematics::Kinematics;
use super::profile::{greater, lesser, square_root};
use super::{AnyMotion, End, Move, Speed};
use crate::axes::PerAxis;
use crate::units::{Coordinate, DECIMAL_ONE};

/// Longest move that is joined, the sum of its ways in all axes: 512 blocks that are longer make a look-ahead of 16 mm at
/// least, in which 100 mm/s are braked at 313 mm/s². They stay the blocks that they are.
const MOST_PIECE: i64 = DECIMAL_ONE / 1000 * 45;
/// Longest joined move, mm.
const MOST_JOINED: f32 = 0.5;
/// The last digit counts as no less than this, mm: numbers with 24 bits are off by as much at 0.5 m from the last point.
const LEAST_DIGIT: f32 = 1.0e-4;
/// Path by straight line beyond which points wind for a purpose: rounding to digits makes it the square root of 3 at most.
const MOST_WINDING: f32 = 1.75;

/// What is known of the last block of the queue.
#[derive(Clone, Debug)]
pub(super) struct Join<const N: usize> {
    /// It may be taken back for a longer one.
    open: bool,
    /// The chain has not got its piece yet.
    kept: bool,
    /// No point of it has been looked at.
    fresh: bool,
    /// The motor with the longest way, how far it has come, and the slopes to it that all points allow each motor.
    main: usize,
    reach: f32,
    slopes: [(f32, f32); N],
    /// Half a step of each motor, mm of its way.
    half_mm: [f32; N],
    /// Path along the points, mm.
    path: f32,
    /// Moves that made no block since the queue was empty.
    moves: usize,
    /// Of its piece of the path, for the chain: from end to end, the path and greatest speed².
    length: f32,
    block_path: f32,
    fast2: f32,
    /// The program's last digit.
    digit: f32,
    /// What its moves have in common.
    speed: Speed,
    power: u16,
    scale_power: bool,
    line_number: u32,
    /// The end of the queue before the last block: all that [`AnyMotion::line`] changes but planner and chain.
    before: End<N>,
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
        before: End::ZERO,
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
    pub(super) fn keeps(&mut self, piece: &Piece<'_, N>) -> bool {
        self.digit = piece.digit;
        if self.open {
            (self.length, self.block_path, self.fast2) = (piece.length, piece.path, piece.fast2);
        }
        self.kept = self.open;
        self.open
    }

    /// Whether a move is of the kind of the last block's.
    fn is_like(&self, m: &Move<N>) -> bool {
        self.speed == m.speed
            && self.power == m.power
            && self.scale_power == m.scale_power
            && self.line_number == m.line_number
    }

    /// How far the longest way leads at a place (ways of the motors), if that is not back.
    fn along(&self, way: &[f32; N]) -> Option<f32> {
        let along = way.get(self.main).copied()?;
        (along * self.reach > 0.0 && along.abs() >= self.reach.abs()).then_some(along)
    }

    /// Takes over a point of the line. `false`: it leads back, and nothing continues the line.
    fn pass(&mut self, way: &[f32; N]) -> bool {
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
    fn allows(&self, way: &[f32; N]) -> bool {
        let Some(along) = self.along(way) else { return false };
        let share = 1.0 / along;
        way.iter().zip(&self.slopes).all(|(part, (least, most))| (*least..=*most).contains(&(part * share)))
    }
}

impl<const N: usize> AnyMotion<N> {
    /// Before a move is made a block: takes back the last block if this move continues it, so that the new block begins where
    /// that one did. Gives the speed² at which the blocks before may already count on entering it.
    #[inline]
    pub(super) fn join(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>, is_line: bool) -> f32 {
        let ends = m.target.iter().zip(self.end.block_end.iter());
        let ways: i64 = ends.map(|(to, from)| (to.0 - from.0).abs()).sum();
        if is_line && !m.no_feed_override && ways <= MOST_PIECE {
            return self.join_short(m, target_steps);
        }
        self.join.open = false;
        if self.join.kept && *target_steps != self.end.planned_steps {
            self.end_join();
        }
        0.0
    }

    #[inline(never)]
    fn join_short(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>) -> f32 {
        if self.planner.len() == 0 {
            self.join.moves = 0;
        }
        self.join.open &= self.join.is_like(m);
        self.join.digit = lesser(self.join.digit, m.digit);
        if *target_steps == self.end.planned_steps {
            // It makes no block, but is a point of the line.
            self.join.open = self.join.open && self.pass_by(m);
            return 0.0;
        }
        if self.join.open
            && let Some(promised) = self.continues(m, target_steps)
        {
            self.join.moves += 1;
            self.take_back();
            return promised;
        }
        self.end_join();
        self.remember(m);
        0.0
    }

    /// Nothing more is joined to the last block: the chain gets its piece.
    #[inline(never)]
    pub(super) fn end_join(&mut self) {
        let join = &mut self.join;
        join.open = false;
        if core::mem::take(&mut join.kept) {
            let piece = Piece {
                start: &join.before.block_end,
                end: &self.end.block_end,
                direction: &self.end.direction,
                length: join.length,
                path: join.block_path,
                fast2: join.fast2,
                digit: join.digit,
            };
            let planner = &mut self.planner;
            self.chain.extend(&piece, &self.turns, &mut |bend| planner.limit(&bend));
        }
    }

    /// The ways of the motors from where the last block begins.
    fn way_to(&self, place: &PerAxis<Coordinate, N>) -> [f32; N] {
        self.kinematics.way_of_motors(&place.zip(&self.join.before.block_end, |to, from| (to - from).to_mm()).0)
    }

    /// A point from which no block is made. `false`: nothing continues the line.
    fn pass_by(&mut self, m: &Move<N>) -> bool {
        self.join.path += self.distance(&m.target);
        let way = self.way_to(&m.target);
        self.pass_end() && self.join.pass(&way)
    }

    /// The end of the first move is the first point.
    fn pass_end(&mut self) -> bool {
        if !self.join.fresh {
            return true;
        }
        let end = self.way_to(&self.end.block_end);
        self.join.pass(&end)
    }

    /// Whether a move continues the last block within its bounds, and if so, what speed² has been promised for its entry.
    fn continues(&mut self, m: &Move<N>, target_steps: &PerAxis<i32, N>) -> Option<f32> {
        // The only block may be on its way out, or the next one with a speed already given.
        if self.planner.len() < 2 && (self.feed.running.active || self.feed.pace.speed2 > 0.0) {
            return None;
        }
        let motors = self.way_to(&m.target);
        if !self.pass_end() || !self.join.allows(&motors) {
            return None;
        }
        let before = &self.join.before;
        let way = m.target.zip(&before.block_end, |to, from| (to - from).to_mm());
        let straight = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
        let path = self.join.path + self.distance(&m.target);
        if straight > MOST_JOINED || path > MOST_WINDING * straight {
            return None;
        }
        let skipped = before.planned.zip(&before.block_end, |to, from| (to - from).to_mm());
        let own = way.zip(&skipped, |way, skipped| way - skipped);
        let length = square_root(own.iter().fold(0.0, |sum, part| sum + part * part)) + before.carried;
        let moved = target_steps.zip(&before.planned_steps, i32::wrapping_sub);
        // Steps that stand for more than the length would bring other limits (`append`); none make no block.
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
        // From the speed at which the old block could have been braked to a stop, this one can.
        let last = self.planner.last()?;
        let (acceleration, _) = self.limits(&way, length);
        let promised = last.acceleration * last.length;
        if acceleration * length < promised {
            return None;
        }
        let eased = last.jerk * last.length * last.length;
        if self.planner.jerk_limited && self.jerk_along(&way, length, acceleration) * length * length < eased {
            return None;
        }
        let promised = lesser(last.max_entry2, 2.0 * promised);
        self.join.path = path;
        self.join.pass(&motors);
        Some(promised)
    }

    /// The end of the queue as it was before the last block.
    fn take_back(&mut self) {
        self.end = self.join.before;
        self.planner.take_back();
    }

    /// Notes the end of the queue before a block of its own is made of this move.
    fn remember(&mut self, m: &Move<N>) {
        let path = self.distance(&m.target);
        let join = &mut self.join;
        join.open = !matches!(m.speed, Speed::Duration(_));
        join.fresh = true;
        join.path = path;
        join.speed = m.speed;
        join.power = m.power;
        join.scale_power = m.scale_power;
        join.line_number = m.line_number;
        join.before = self.end;
    }

    /// Whether as many moves have been queued from rest as there are blocks, although some of them have been joined and the
    /// queue has room: reason enough to start.
    pub fn has_joined_enough(&self) -> bool {
        self.join.moves > 0 && self.planner.len() + self.join.moves >= self.planner.capacity()
    }
}
