//! The end of the queue, where the next move begins: the programmed end of the last move, and the end of the last
//! block (programmed and in steps). Also stores the length of moves too short for a step, which is carried over to the
//! next block.

use super::trapezoid::square_root;
use crate::axes::PerAxis;
use crate::units::Coordinate;

/// Returns the displacement of an axis between positions within [`Coordinate::LIMIT`], mm. An axis that does not move
/// needs no division.
#[inline]
pub(super) fn way_mm(to: Coordinate, from: Coordinate) -> f32 {
    let way = to.0 - from.0;
    if way == 0 { 0.0 } else { Coordinate(way).to_mm() }
}

/// The end of the queue. It lies beyond the end of the last block if moves too short for a step have followed this
/// block.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathEnd<const N: usize> {
    /// Programmed end of the last move.
    pub planned: PerAxis<Coordinate, N>,
    /// Programmed end of the last block.
    pub block_end: PerAxis<Coordinate, N>,
    /// End of the last block in motor steps.
    pub planned_steps: PerAxis<i32, N>,
    /// Total length of the moves without a step since `block_end`, mm. Negative: the last block is longer than its
    /// moves by this amount.
    pub length_carry: f32,
    /// Unit vector of the last block.
    pub direction: [f32; N],
    /// Whether moves without a step have been queued since the last block.
    pub is_past_block: bool,
    /// `true` if moves without a step went to and fro before the last block, so that the block includes their time. The
    /// corners before and after this block are at most as fast as a square corner.
    pub had_stepless_moves: bool,
    /// Whether the last block moves motors but not the tool; the next block then begins at rest.
    pub motors_only: bool,
}

impl<const N: usize> PathEnd<N> {
    pub(super) const ZERO: Self = Self {
        planned: PerAxis::all(Coordinate::ZERO),
        block_end: PerAxis::all(Coordinate::ZERO),
        planned_steps: PerAxis::all(0),
        length_carry: 0.0,
        direction: [0.0; N],
        is_past_block: false,
        had_stepless_moves: false,
        motors_only: false,
    };

    /// Resets the end to a position at rest.
    pub(super) fn restart(&mut self, steps: PerAxis<i32, N>, position: PerAxis<Coordinate, N>) {
        self.length_carry = 0.0;
        self.planned_steps = steps;
        self.planned = position;
        self.block_end = position;
        self.is_past_block = false;
        self.motors_only = false;
        self.had_stepless_moves = false;
    }

    /// Returns the distance from the programmed end of the last move to a target, mm.
    pub(super) fn distance(&self, target: &PerAxis<Coordinate, N>) -> f32 {
        let mut square = 0.0;
        for (to, from) in target.iter().zip(self.planned.iter()) {
            let way = (*to - *from).to_mm();
            square += way * way;
        }
        square_root(square)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_distance_is_measured_from_the_programmed_end() {
        let mut end = PathEnd::<2>::ZERO;
        end.restart(PerAxis([80, 0]), PerAxis([Coordinate::mm(1), Coordinate::ZERO]));
        assert_eq!(end.distance(&PerAxis([Coordinate::mm(4), Coordinate::mm(4)])), 5.0);
        end.planned = PerAxis([Coordinate::mm(4), Coordinate::mm(1)]);
        assert_eq!(end.distance(&PerAxis([Coordinate::mm(4), Coordinate::mm(4)])), 3.0);
    }
}
