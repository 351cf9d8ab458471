//! How much a chain of short moves bends, from points that lie far enough apart.
//!
//! The corner rule looks at two moves and takes what lies between them for a corner. On a curve that somebody has cut into
//! chords this allows any speed, if only the chords are short: the corners are then as flat as one likes, and the
//! acceleration v²/R across the path is that of the curve. Here the bend is measured:
//!
//! ```text
//!        B        direction AB to direction BC turns by q (difference of unit vectors),
//!      /   \      over the mean of both lengths: curvature = |q| / mean, exact on a circle for equal lengths
//!    A       C
//! ```
//! Each point may be off by [`NOISE`], the last digit of the program. Neighbouring points say little where chords are
//! short: a digit of 1 um on chords of 0.1 mm is a bend of R = 10 mm that is not there. Points far apart say little where
//! the bend is short. So the chain is looked at in spans of several lengths at once, from each the part of the bend that
//! noise cannot explain is taken, and the tightest counts: a straight line with noise is straight, and a circle is measured
//! by the longest span that turns by no more than [`MOST_TURN`].
//!
//! What A, B and C tell is the limit for everything from A to C. A corner of θ in the middle of spans of length L is taken
//! for a bend of v² = a·L/θ. No machine is faster than √(2·a·L) where it has to brake for that corner within L, so for
//! θ about half a radian nothing is slowed by a span that holds a corner and nothing else; a sharper one ends the chain.

use super::planner::UNLIMITED2;
use super::profile::square_root;
use crate::axes::PerAxis;
use crate::units::Coordinate;

/// How far a programmed point may be from the meant one, mm. Three decimals: half a digit in each of two axes is 0.0007.
/// Four decimals of an inch: 0.0018 at worst, 0.001 in the mean.
const NOISE: f32 = 0.0008;
/// |difference of unit vectors|² of 0.6 rad: spans that turn more are left to the shorter ones, and a corner that does
/// ends the chain.
pub(super) const MOST_TURN: f32 = 0.36;
/// Lengths of the spans, mm. Noise takes 4·NOISE·R/L² off a curvature: 1 % at R = 3·L², so the longest serves R = 200 mm,
/// where 1000 mm/s² allow 450 mm/s. On a small circle L is 0.3·R at least, and noise takes 4 % mm / R. The shortest
/// turns by 0.6 rad at R = 0.1 mm; below that the corner rule is the stricter one with its usual 0.01 mm.
const SPANS: [f32; 8] = [0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0];
/// A span whose ends are closer than this share of its path is no chord of a bend.
const STRAIGHTNESS: f32 = 0.9;

/// The limit for the entries of some blocks.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Greatest speed².
    pub speed2: f32,
    /// It holds for the entries of so many blocks, from the newest back.
    pub blocks: usize,
}

/// The points of one span length: the last one, and what is known of the span that ended there.
#[derive(Clone, Copy, Debug)]
struct Span<const N: usize> {
    knot: PerAxis<Coordinate, N>,
    /// Path and blocks since.
    path: f32,
    blocks: usize,
    /// The span before: unit vector, length, blocks. No blocks: there is none that tells anything.
    direction: [f32; N],
    length: f32,
    before: usize,
}

/// The end of the queue as a chain of points.
#[derive(Clone, Debug)]
pub(super) struct Chain<const N: usize> {
    spans: [Span<N>; SPANS.len()],
    /// So many of the spans are no longer than the last piece: its ends are their points, and what they know stands here
    /// only. On moves that are long anyway nothing is gathered at all.
    whole: usize,
    direction: [f32; N],
    length: f32,
}

/// A piece of the path: where it ends, its unit vector and length.
#[derive(Clone, Copy, Debug)]
pub(super) struct Piece<'a, const N: usize> {
    pub start: &'a PerAxis<Coordinate, N>,
    pub end: &'a PerAxis<Coordinate, N>,
    pub direction: &'a [f32; N],
    pub length: f32,
}

/// |difference|² of two unit vectors.
#[inline]
pub(super) fn turn2<const N: usize>(before: &[f32; N], after: &[f32; N]) -> f32 {
    let mut square = 0.0;
    for (a, b) in before.iter().zip(after) {
        square += (b - a) * (b - a);
    }
    square
}

/// Speed² on a path that turns from one unit vector to the other between the middles of two pieces of these lengths;
/// `turn2` is |difference of the vectors|².
///
/// The acceleration is the greatest that every axis takes in any direction of the plane of the curve: with the normal n and
/// the tangent t, axis i gets a·√(n_i² + t_i²) at most wherever on the curve. So the speed on a circle is even.
pub(super) fn bend_speed2<const N: usize>(
    before: &[f32; N],
    after: &[f32; N],
    turn2: f32,
    lengths: [f32; 2],
    acceleration: &[f32; N],
) -> f32 {
    let [first, second] = lengths;
    // Each end of a piece turns it by NOISE / length.
    let noise = 2.0 * NOISE * (first + second) / (first * second);
    // A turn that is all noise; or back, which is a corner and no bend.
    if turn2 <= noise * noise || turn2 >= 3.999 {
        return UNLIMITED2;
    }
    let sure = square_root(turn2) - noise;
    let (normal, tangent) = (1.0 / turn2, 1.0 / (4.0 - turn2));
    let mut least2 = UNLIMITED2;
    for ((a, b), limit) in before.iter().zip(after).zip(acceleration) {
        let (difference, sum) = (b - a, b + a);
        let share2 = difference * difference * normal + sum * sum * tangent;
        if share2 * least2 > limit * limit {
            least2 = limit * limit / share2;
        }
    }
    square_root(least2) * 0.5 * (first + second) / sure
}

impl<const N: usize> Chain<N> {
    pub(super) const fn new() -> Self {
        let span = Span {
            knot: PerAxis::all(Coordinate::ZERO),
            path: 0.0,
            blocks: 0,
            direction: [0.0; N],
            length: 0.0,
            before: 0,
        };
        Self { spans: [span; SPANS.len()], whole: 0, direction: [0.0; N], length: 0.0 }
    }

    /// Begins anew at a corner.
    pub(super) fn restart(&mut self, place: &PerAxis<Coordinate, N>) {
        self.whole = 0;
        for span in &mut self.spans {
            span.knot = *place;
            span.path = 0.0;
            span.blocks = 0;
            span.before = 0;
        }
    }

    /// Goes on with a straight piece, the next block, and tells what bends have been found.
    pub(super) fn extend(&mut self, piece: &Piece<'_, N>, acceleration: &[f32; N], mut found: impl FnMut(Bend)) {
        let whole = SPANS.iter().take_while(|span| **span <= piece.length).count();
        if self.whole < whole {
            // Shorter spans end where the piece begins. It is the newest block already.
            self.advance(self.whole, whole, piece.start, 0.0, 0, acceleration, &mut |bend: Bend| {
                found(Bend { blocks: bend.blocks + 1, ..bend });
            });
        }
        for span in self.spans.iter_mut().take(self.whole).skip(whole) {
            span.knot = *piece.start;
            span.direction = self.direction;
            span.length = self.length;
            span.before = 1;
            span.path = 0.0;
            span.blocks = 0;
        }
        self.advance(whole, whole, piece.end, piece.length, 1, acceleration, &mut found);
        self.whole = whole;
        self.direction = *piece.direction;
        self.length = piece.length;
    }

    /// Makes `place` a point of the spans from `first` on: of those before `forced` in any case, and of those that are long
    /// enough with `path` and `blocks` more, up to the first that is not.
    #[allow(clippy::too_many_arguments, reason = "one loop for both ends of a piece")]
    #[inline]
    fn advance(
        &mut self,
        first: usize,
        forced: usize,
        place: &PerAxis<Coordinate, N>,
        mut path: f32,
        mut blocks: usize,
        acceleration: &[f32; N],
        found: &mut impl FnMut(Bend),
    ) {
        for (index, (span, limit)) in self.spans.iter_mut().zip(SPANS).enumerate().skip(first) {
            span.path += path;
            span.blocks += blocks;
            if span.path < limit && index >= forced {
                return;
            }
            if span.blocks == 0 {
                continue;
            }
            (path, blocks) = (span.path, span.blocks);
            let way = place.zip(&span.knot, |to, from| (to - from).to_mm());
            let mut square = 0.0;
            for part in way.iter() {
                square += part * part;
            }
            let length = square_root(square);
            let before = core::mem::replace(&mut span.before, 0);
            span.knot = *place;
            span.path = 0.0;
            span.blocks = 0;
            if length < STRAIGHTNESS * path || length <= 0.0 {
                continue;
            }
            let direction = way.0.map(|part| part / length);
            // Where both are single blocks the corner itself has been looked at.
            if before > 0 && before + blocks > 2 {
                let turn2 = turn2(&span.direction, &direction);
                if turn2 <= MOST_TURN {
                    let lengths = [span.length, length];
                    let speed2 = bend_speed2(&span.direction, &direction, turn2, lengths, acceleration);
                    found(Bend { speed2, blocks: before + blocks });
                }
            }
            span.direction = direction;
            span.length = length;
            span.before = blocks;
        }
    }
}
