//! How fast a path may turn: one rule for every turn, from a single corner to a long curve of short chords. The path is
//! gathered into spans on several scales; each new span is compared with the ones before it, and each `Bend` found
//! limits speed and acceleration of some blocks. Turns that the rounding of the program's last digit explains are
//! ignored.
//!
//! A path that turns by an angle t within a length L demands of the axes a change of velocity of v·q in the time L/v, where
//! q = |difference of the unit vectors| = 2·sin(t/2). The axes can provide a·L/v of it, and the junction deviation d permits
//! a jump of J·q on top, the same for the whole turn however it is distributed over L:
//!
//! ```text
//!   1        between two single pieces             v² - v·J = a·L/t      J² = a·d·s / (1 - s), s = cos(t/2)
//!    \  2    between the middles of two spans      v² - J²  = a·L/t      (of several pieces each)
//!     '---.  a corner: L = 0                       v        = J
//!          \ 3
//! ```
//! The first form is exact where both ends are single pieces, because these turn at their ends only. The direction of a span
//! of several pieces is that of the path in its middle; the second form is stricter, and tends to v² = a·R on a long curve.
//!
//! The program's points are rounded: each may be off by half of the last digit on each axis. That turns a span of length l
//! by 1.5 digits / l at most, and that much of q is ignored (`noise`). So a straight line whose points are rounded counts as
//! straight, and a program with finer digits loses nothing.
//!
//! Short spans say little where the digit is coarse, long ones say little where a turn is short. So the path is measured on
//! several scales at once: on each scale it is cut into spans of at least that length, and a new span is compared with the
//! last [`HISTORY`] before it. A piece longer than the scale is a span by itself; the span begun before it ends where it starts.

use super::block::CurveLoad;
use super::junction::{REVERSAL, SQUARE_CORNER, TurnRule, UNLIMITED2, certain, is_noise, radius_of, turn2};
use super::path_end::way_mm;
use super::trapezoid::{greater, lesser, square_root};
use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::units::Coordinate;

/// Lengths of the spans: powers of two from [`SHORTEST`] (mm) to 32 mm. With the spans before it the longest measures a
/// radian of a bend of R = 100 mm.
pub(super) const SCALES: usize = 14;
const SHORTEST: f32 = 1.0 / 256.0;
/// Length of the spans of a scale, mm.
#[inline]
fn scale_length(scale: usize) -> f32 {
    SHORTEST * (1_u32 << scale) as f32
}

/// Scales that are no longer than a piece, by its binary exponent.
#[inline]
fn scales_within(length: f32) -> usize {
    let exponent = |length: f32| (length.to_bits() >> 23) as usize;
    (exponent(length) + 1).saturating_sub(exponent(SHORTEST)).min(SCALES)
}

/// Spans that a new one is compared with.
const HISTORY: usize = 4;
/// Half a digit on each of two axes puts a point 0.71 digits aside, on each of three 0.87. For both ends of a span.
pub(super) const DIGITS_ASIDE: f32 = 1.5;
/// A span whose ends are closer than this share of its path is no chord of a bend: that of half a circle has 0.64.
const STRAIGHTNESS: f32 = 0.6;
/// q² of 0.6 rad: what turns more need not be a bend, but may be a corner with straights beside it, where the machine is
/// faster than on a bend.
const LARGE_TURN2: f32 = 0.36;
/// A large turn is spread over its whole length if both ends of it turn by this share of q² at least.
const ENDS2: f32 = 1.0 / 36.0;
/// L/t in junction deviations up to which that counts: beyond, the J² of the smaller turns within is little beside a·L/t.
const VAGUE: f32 = 72.0;
/// Of three turns in a row the middle one is no corner if its q² is less than this many times the lesser of the others.
const EVEN2: f32 = 9.0;
/// q² up to which a turn tells the curvature of its own place, and not a mean of what is far away.
const GENTLE2: f32 = 0.0625;
/// A bend for more than this many times the greatest speed² leaves the acceleration along the path as it is, within 5 %.
pub(super) const NOTICEABLE: f32 = 3.2;
/// Points of which the finest digit counts: words lose their trailing zeros, but not all of them.
const POINTS: u8 = 32;

/// A limit for some of the blocks, counted back from the newest, which is 0: the nearest and the farthest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Greatest speed² at their entries.
    pub speed2: f32,
    /// If given: one slower entry among these blocks (nearest, farthest) is enough, and this limit does not apply. Then most of
    /// the turn may be a corner, for which the machine brakes and from which it speeds up with the acceleration of the axes,
    /// so that the whole turn takes the time that it needs.
    pub once: Option<(usize, usize)>,
    /// What the bend leaves of the acceleration.
    pub curve: CurveLoad,
    pub nearest: usize,
    pub farthest: usize,
}

/// A span of the path with the direction from its start to its end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span<const N: usize> {
    /// Unit vector.
    direction: [f32; N],
    /// By how much the rounding of its ends may have turned it, rad.
    noise: f32,
    /// Length of the path, mm.
    path: f32,
    /// Greatest speed² in it under any override.
    fast2: f32,
    /// Moves in it; 0: there is none.
    blocks: u16,
    /// Whether the direction means anything.
    straight: bool,
    /// From the middle of the span before to its own: q² and the bend.
    turned2: f32,
    curve: CurveLoad,
}

/// What is granted between two spans.
struct Limit {
    speed2: f32,
    /// What is certain of q².
    turn2: f32,
    /// L/t.
    radius: f32,
}

impl<const N: usize> Span<N> {
    const NONE: Self = Self {
        direction: [0.0; N],
        noise: 0.0,
        path: 0.0,
        fast2: 0.0,
        blocks: 0,
        straight: false,
        turned2: 0.0,
        curve: CurveLoad::NONE,
    };

    /// A single piece.
    #[inline]
    pub(super) fn of(piece: &PathPiece<'_, N>) -> Self {
        let straight = piece.length > 0.0;
        let noise = if straight { DIGITS_ASIDE * piece.digit / piece.length } else { 0.0 };
        Self {
            direction: *piece.direction,
            noise,
            path: piece.path,
            fast2: piece.fast2,
            blocks: 1,
            straight,
            ..Self::NONE
        }
    }

    /// How much path lies between its middle and its end; a single piece has its direction up to the end.
    #[inline]
    fn half(&self) -> f32 {
        if self.blocks == 1 { 0.0 } else { 0.5 * self.path }
    }

    /// Greatest speed² at the corner with the piece before; both are single pieces.
    #[inline]
    fn corner2(&self, before: &Self, rule: &TurnRule<N>) -> f32 {
        if !before.straight || !self.straight {
            return UNLIMITED2;
        }
        let all2 = turn2(&before.direction, &self.direction);
        if is_noise(all2, before.noise + self.noise) { UNLIMITED2 } else { self.corner_of_turn(before, all2, rule) }
    }

    #[inline(never)]
    fn corner_of_turn(&self, before: &Self, all2: f32, rule: &TurnRule<N>) -> f32 {
        let Some((turn2, sine)) = certain(all2, before.noise + self.noise) else { return UNLIMITED2 };
        if turn2 > REVERSAL {
            return 0.0;
        }
        let across = rule.across(&before.direction, &self.direction, square_root(all2));
        rule.junction2(across, sine, turn2)
    }

    /// Whether a span before, with so much path `between` them, may set a limit below `fast2`: most turns are noise, or bends
    /// that are surely faster. No call for them.
    #[inline(always)]
    fn may_be_limited(&self, old: &Self, between: f32, fast2: f32, rule: &TurnRule<N>) -> bool {
        let all2 = turn2(&old.direction, &self.direction);
        let noise = old.noise + self.noise;
        if is_noise(all2, noise) {
            return false;
        }
        let (least, length) = (rule.least_of(&old.direction, &self.direction), between + old.half() + self.half());
        // Less noise, the turn is no larger, and √x is no less than x.
        if rule.is_surely_faster(least, length, all2, 1.0 - 0.25 * all2, fast2) {
            return false;
        }
        certain(all2, noise).is_some_and(|(turn2, sine)| !rule.is_surely_faster(least, length, turn2, sine, fast2))
    }

    /// What is granted from a span before with so much path `between` them; `None` if it is no limit for `fast2`.
    #[inline(never)]
    fn limit_after(&self, old: &Self, between: f32, fast2: f32, rule: &TurnRule<N>) -> Option<Limit> {
        let all2 = turn2(&old.direction, &self.direction);
        let (turn2, sine) = certain(all2, old.noise + self.noise)?;
        let radius = (between + old.half() + self.half()) * radius_of(turn2, sine);
        let bend2 = rule.in_plane(&old.direction, &self.direction, all2) * rule.curve_share * radius;
        if bend2 > fast2 {
            return None;
        }
        let junction2 = if turn2 > REVERSAL {
            0.0
        } else {
            rule.junction2(rule.across(&old.direction, &self.direction, square_root(all2)), sine, turn2)
        };
        let speed2 = if old.blocks == 1 && self.blocks == 1 {
            let speed = 0.5 * (square_root(junction2) + square_root(junction2 + 4.0 * bend2));
            speed * speed
        } else {
            junction2 + bend2
        };
        (speed2 < fast2).then_some(Limit { speed2, turn2, radius })
    }

    /// Notes how it continues the one before: the bend only if it tells at the speeds there.
    #[inline]
    fn note_turn(&mut self, old: &Self, rule: &TurnRule<N>) {
        if old.blocks == 0 || !old.straight || !self.straight {
            return;
        }
        self.turned2 = turn2(&old.direction, &self.direction);
        let Some((turn2, sine)) = certain(self.turned2, old.noise + self.noise) else { return };
        if turn2 < GENTLE2 {
            let radius = 0.5 * (old.path + self.path) * radius_of(turn2, sine);
            let acceleration = rule.in_plane(&old.direction, &self.direction, self.turned2);
            let curve2 = acceleration * rule.curve_share * radius;
            if curve2 < NOTICEABLE * greater(old.fast2, self.fast2) {
                self.curve = CurveLoad::new(curve2, acceleration);
            }
        }
    }
}

/// A straight piece of the path: the newest block.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathPiece<'a, const N: usize> {
    pub start: &'a PerAxis<Coordinate, N>,
    pub end: &'a PerAxis<Coordinate, N>,
    /// Unit vector.
    pub direction: &'a [f32; N],
    /// From start to end, mm.
    pub length: f32,
    /// The same with moves too short for a step, mm.
    pub path: f32,
    /// Greatest speed² under any override.
    pub fast2: f32,
    /// The last digit of the program, mm.
    pub digit: f32,
}

/// The spans before, the newest first.
#[derive(Clone, Copy, Debug)]
struct History<const N: usize>([Span<N>; HISTORY]);

impl<const N: usize> History<N> {
    // One copy: it is called for pieces, for spans that end and for those that are ended.
    /// Compares a new span, behind which there are so many blocks, with those before it, and adds it. The corner between
    /// two single pieces is known already ([`Chain::corner2`]).
    #[inline(never)]
    fn take_span(&mut self, new: &mut Span<N>, behind: usize, rule: &TurnRule<N>, found: &mut dyn FnMut(Bend)) {
        let [first, second, ..] = &self.0;
        new.note_turn(first, rule);
        // A corner turns two neighbouring spans at most, a bend all of them.
        let bend = new.curve.middle(first.curve, second.curve);
        if self.may_limit(new, rule) {
            self.compare(new, behind, rule, found);
        }
        if !bend.is_none() {
            let own = usize::from(new.blocks);
            let farthest = behind + own - 1 + usize::from(first.blocks) + usize::from(second.blocks);
            // A bend in the drawing: no corner, so nothing is granted but what a square corner has.
            let square = bend.acceleration() * rule.deviation * SQUARE_CORNER;
            let speed2 = greater(bend.speed2(), square);
            found(Bend { speed2, once: None, curve: bend, nearest: behind + own, farthest });
        }
        let [first, second, third, fourth] = &mut self.0;
        // One after the other: an array of them would be made elsewhere first.
        *fourth = *third;
        *third = *second;
        *second = *first;
        *first = *new;
    }

    /// Whether there may be a limit for a new span: what [`History::compare`] then asks of all spans.
    #[inline(always)]
    fn may_limit(&self, new: &Span<N>, rule: &TurnRule<N>) -> bool {
        let (mut between, mut fast2) = (0.0, new.fast2);
        for (index, old) in self.0.iter().enumerate() {
            if old.blocks == 0 || !new.straight {
                return false;
            }
            fast2 = greater(fast2, old.fast2);
            let corner = index == 0 && new.blocks == 1 && old.blocks == 1;
            if old.straight && !corner && new.may_be_limited(old, between, fast2, rule) {
                return true;
            }
            between += old.path;
        }
        false
    }

    /// Compares a new span with those before it.
    #[inline(never)]
    fn compare(&self, new: &Span<N>, behind: usize, rule: &TurnRule<N>, found: &mut dyn FnMut(Bend)) {
        let [first, ..] = &self.0;
        let own = usize::from(new.blocks);
        let (mut between, mut blocks, mut fast2, mut turned2) = (0.0, 0, new.fast2, new.turned2);
        for (index, old) in self.0.iter().enumerate() {
            if old.blocks == 0 || !new.straight {
                break;
            }
            fast2 = greater(fast2, old.fast2);
            let corner = index == 0 && own == 1 && old.blocks == 1;
            if old.straight
                && !corner
                && let Some(limit) = new.limit_after(old, between, fast2, rule)
            {
                let ends2 = lesser(new.turned2, turned2);
                let spread = index > 0 && limit.radius < VAGUE * rule.deviation && ends2 > ENDS2 * limit.turn2;
                let bent = index == 2 && ends2 > ENDS2 * limit.turn2 && first.turned2 < EVEN2 * ends2;
                // Of neighbours up to the middle of each; otherwise what is between, where the path is slowest.
                let halves = if index == 0 { (own / 2, usize::from(old.blocks) / 2) } else { (own - 1, 0) };
                let start = behind + own - 1 + blocks;
                let once = limit.turn2 > LARGE_TURN2 && !spread && !bent;
                found(Bend {
                    speed2: limit.speed2,
                    once: once.then_some((behind, start + usize::from(old.blocks) - 1)),
                    curve: CurveLoad::NONE,
                    nearest: behind + halves.0,
                    farthest: start + halves.1,
                });
            }
            between += old.path;
            blocks += usize::from(old.blocks);
            turned2 = old.turned2;
        }
    }
}

/// One scale: the spans before, and the one that has been begun.
#[derive(Clone, Copy, Debug)]
pub struct Scale<const N: usize> {
    history: History<N>,
    /// Where it begins, how long its path is, its greatest speed² and its blocks.
    start: PerAxis<Coordinate, N>,
    path: f32,
    fast2: f32,
    blocks: u16,
}

impl<const N: usize> Scale<N> {
    /// Begins a span.
    #[inline]
    fn begin(&mut self, start: &PerAxis<Coordinate, N>) {
        self.start = *start;
        self.path = 0.0;
        self.fast2 = 0.0;
        self.blocks = 0;
    }

    /// Ends the span and begins the next.
    #[inline(never)]
    fn end(&mut self, end: &PerAxis<Coordinate, N>, digit: f32) -> Span<N> {
        let way = end.zip(&self.start, way_mm);
        let length = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
        let straight = length > 0.0 && length >= STRAIGHTNESS * self.path;
        let shortness = if straight { 1.0 / length } else { 0.0 };
        let span = Span {
            direction: way.0.map(|part| part * shortness),
            noise: DIGITS_ASIDE * digit * shortness,
            path: self.path,
            fast2: self.fast2,
            blocks: self.blocks,
            straight,
            ..Span::NONE
        };
        self.begin(end);
        span
    }
}

/// The program's last digit: the finest of its last 32 to 64 points.
#[derive(Clone, Copy, Debug)]
pub(super) struct LastDigit {
    finest: f32,
    before: f32,
    points: u8,
}

impl LastDigit {
    const NONE: Self = Self { finest: f32::INFINITY, before: f32::INFINITY, points: 0 };

    fn with(&mut self, digit: f32) -> f32 {
        if self.points >= POINTS {
            *self = Self { finest: f32::INFINITY, before: self.finest, points: 0 };
        }
        self.points += 1;
        self.finest = lesser(digit, self.finest);
        lesser(self.finest, self.before)
    }
}

/// The end of the queue as a chain of points.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
pub(super) struct Chain<const N: usize> {
    /// The last single pieces.
    pieces: History<N>,
    scales: Lent<[Scale<N>]>,
    /// So many scales are no longer than the last piece: their spans are the single pieces. On moves that are long
    /// anyway nothing is gathered at all.
    whole: usize,
    digit: LastDigit,
}

impl<const N: usize> Chain<N> {
    /// What its scales are before there is a path. A chain without scales knows single turns only.
    pub(super) const SCALES: [Scale<N>; SCALES] = {
        let none = History([Span::NONE; HISTORY]);
        let scale = Scale { history: none, start: PerAxis::all(Coordinate::ZERO), path: 0.0, fast2: 0.0, blocks: 0 };
        [scale; SCALES]
    };

    pub(super) fn new(scales: Lent<[Scale<N>]>) -> Self {
        Self { pieces: History([Span::NONE; HISTORY]), scales, whole: 0, digit: LastDigit::NONE }
    }

    /// Forgets what lies before this point: the machine comes to rest there.
    pub(super) fn restart(&mut self, start: &PerAxis<Coordinate, N>) {
        self.whole = 0;
        self.pieces = History([Span::NONE; HISTORY]);
        for scale in self.scales.iter_mut() {
            scale.history = self.pieces;
            scale.begin(start);
        }
    }

    /// The program's last digit, mm, with that of one more point.
    pub(super) fn last_digit(&mut self, digit: f32) -> f32 {
        self.digit.with(digit)
    }

    /// What is known of the program's last digit, to be restored after a piece that has none.
    pub(super) fn program_digit(&self) -> LastDigit {
        self.digit
    }

    /// See [`Chain::program_digit`].
    pub(super) fn set_program_digit(&mut self, digit: LastDigit) {
        self.digit = digit;
    }

    /// Greatest speed² at the corner before a piece, which is a span by itself; [`Chain::extend`] has to follow.
    #[inline]
    pub(super) fn corner2(&self, piece: &Span<N>, rule: &TurnRule<N>) -> f32 {
        let [before, ..] = &self.pieces.0;
        if before.blocks == 0 { UNLIMITED2 } else { piece.corner2(before, rule) }
    }

    /// Adds the newest block, which has been pushed already, and tells what bends are found.
    #[inline(never)]
    pub(super) fn extend(
        &mut self,
        piece: &PathPiece<'_, N>,
        mut new: Span<N>,
        rule: &TurnRule<N>,
        found: &mut dyn FnMut(Bend),
    ) {
        let digit = piece.digit;
        let whole = scales_within(piece.length);
        let mut scale_length = scale_length(whole);
        if self.whole < whole {
            self.end_before(piece, &new, whole, rule, found);
        }
        for scale in self.scales.get_mut(whole..self.whole).unwrap_or_default() {
            scale.history = self.pieces;
            scale.begin(piece.start);
        }
        self.pieces.take_span(&mut new, 0, rule, found);
        self.whole = whole;
        let (mut path, mut fast2, mut blocks) = (new.path, new.fast2, 1);
        for scale in self.scales.get_mut(whole..).unwrap_or_default() {
            scale.path += path;
            scale.fast2 = greater(scale.fast2, fast2);
            scale.blocks = scale.blocks.saturating_add(blocks);
            if scale.path < scale_length {
                return;
            }
            (path, fast2, blocks) = (scale.path, scale.fast2, scale.blocks);
            let mut span = scale.end(piece.end, digit);
            scale.history.take_span(&mut span, 0, rule, found);
            scale_length *= 2.0;
        }
    }

    /// A piece longer than the scales up to `whole`: their spans end where it begins, and it is compared with them.
    #[inline(never)]
    fn end_before(
        &mut self,
        piece: &PathPiece<'_, N>,
        new: &Span<N>,
        whole: usize,
        rule: &TurnRule<N>,
        found: &mut dyn FnMut(Bend),
    ) {
        let (mut path, mut fast2, mut blocks) = (0.0, 0.0, 0);
        for (index, scale) in self.scales.iter_mut().enumerate().skip(self.whole) {
            scale.path += path;
            scale.fast2 = greater(scale.fast2, fast2);
            scale.blocks = scale.blocks.saturating_add(blocks);
            if index >= whole {
                // Longer scales continue with what the last one has ended; the piece comes to it.
                return;
            }
            if scale.blocks > 0 {
                (path, fast2, blocks) = (scale.path, scale.fast2, scale.blocks);
                let mut span = scale.end(piece.start, piece.digit);
                scale.history.take_span(&mut span, 1, rule, found);
            }
            let mut own = *new;
            scale.history.take_span(&mut own, 0, rule, found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Pseudo-random numbers (xorshift, Marsaglia 2003).
    struct Random(u64);

    impl Random {
        fn below(&mut self, end: u64) -> u64 {
            self.0 ^= self.0 << 13;
            self.0 ^= self.0 >> 7;
            self.0 ^= self.0 << 17;
            (self.0 >> 11) % end
        }

        /// From 0 to 1.
        fn share(&mut self) -> f32 {
            self.below(1 << 24) as f32 / (1 << 24) as f32
        }

        /// Any order of size between two numbers.
        fn size(&mut self, least: f32, greatest: f32) -> f32 {
            least * (greatest / least).powf(self.share())
        }

        fn sign(&mut self) -> f32 {
            if self.below(2) == 0 { 1.0 } else { -1.0 }
        }

        /// Of all that the settings and the bounds on them allow.
        fn rule<const N: usize>(&mut self) -> TurnRule<N> {
            let all = self.size(1.0e-3, 1.0e7);
            let acceleration = match self.below(3) {
                0 => [all; N],
                1 => [all; N].map(|all| (all * self.size(1.0e-3, 1.0)).max(1.0e-3)),
                _ => [0.0; N].map(|_| self.size(1.0e-3, 1.0e7)),
            };
            let deviation = if self.below(2) == 0 { 0.0 } else { self.size(1.0e-6, 1.0e3) };
            let curve_share = if self.below(2) == 0 { 1.0 } else { self.size(0.01, 100.0) };
            TurnRule { acceleration, deviation, curve_share }
        }

        /// The unit vector of a way, as the queue makes it or as the scales do.
        fn unit<const N: usize>(&mut self, way: [f32; N]) -> [f32; N] {
            let length = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
            let shortness = 1.0 / length;
            if self.below(2) == 0 { way.map(|part| part / length) } else { way.map(|part| part * shortness) }
        }

        /// A direction, with axes that stay and axes that hardly move.
        fn direction<const N: usize>(&mut self) -> [f32; N] {
            let mut way = [0.0; N].map(|_| if self.below(2) == 0 { 0.0 } else { self.sign() * self.size(1.0e-7, 1.0) });
            way[self.below(N as u64) as usize] = self.sign();
            self.unit(way)
        }

        /// One that continues another: after a slight turn of some axes, or back, or nowhere near it.
        fn turned<const N: usize>(&mut self, before: [f32; N], turn: f32) -> [f32; N] {
            let back = match self.below(12) {
                0 => return self.direction(),
                1 => -1.0,
                _ => 1.0,
            };
            let way = before.map(|part| {
                let aside = if self.below(3) == 0 { 0.0 } else { turn * (self.share() - 0.5) };
                back * part + aside
            });
            self.unit(way)
        }

        /// A span of one piece or some.
        fn span<const N: usize>(&mut self, direction: [f32; N], path: f32, turn: f32) -> Span<N> {
            Span {
                direction,
                noise: if self.below(2) == 0 { 0.0 } else { self.share() * turn },
                path,
                fast2: UNLIMITED2,
                blocks: 1 + self.below(3) as u16,
                straight: self.below(20) > 0,
                ..Span::NONE
            }
        }
    }

    /// The limits between a new span and those before it, by the whole rule.
    fn limits<const N: usize>(history: &History<N>, new: &Span<N>, rule: &TurnRule<N>) -> Vec<f32> {
        let mut speeds2 = Vec::new();
        history.compare(new, 0, rule, &mut |bend| speeds2.push(bend.speed2));
        speeds2
    }

    /// Asks of many turns, with speeds that are about as fast as they allow, and gives how many are limited and how many are
    /// left out in advance.
    fn ask<const N: usize>(random: &mut Random, count: u32) -> (u32, u32) {
        let (mut limited, mut left_out) = (0, 0);
        for _ in 0..count {
            let rule = random.rule::<N>();
            let (turn, path) = (random.size(1.0e-3, 3.0), random.size(1.0e-7, 1.0e5));
            let mut direction = random.direction();
            let [mut new, first, second, third, fourth] = [(); HISTORY + 1].map(|()| {
                direction = random.turned(direction, turn);
                let path = path * random.size(0.1, 10.0);
                random.span(direction, path, turn)
            });
            let mut history = History([first, second, third, fourth]);
            let speeds2 = limits(&history, &new, &rule);
            if speeds2.is_empty() {
                continue;
            }
            let near2 = match random.below(3) {
                0 => speeds2[random.below(speeds2.len() as u64) as usize],
                _ => speeds2.iter().fold(UNLIMITED2, |least, speed2| lesser(*speed2, least)),
            };
            // From the least to the greatest speed that there is.
            let fast2 = (near2 * (0.9 + 0.15 * random.share())).clamp(1.6e-13, 1.0e10);
            for span in history.0.iter_mut().chain([&mut new]) {
                span.fast2 = if random.below(2) == 0 { fast2 } else { fast2 * random.share() };
            }
            let is_limited = !limits(&history, &new, &rule).is_empty();
            let may_be = history.may_limit(&new, &rule);
            assert!(may_be || !is_limited, "{history:?} {new:?} {rule:?}");
            limited += u32::from(is_limited);
            left_out += u32::from(!may_be);
        }
        (limited, left_out)
    }

    #[test]
    fn no_turn_that_limits_is_left_out_in_advance() {
        let mut random = Random(0x2545_F491_4F6C_DD1D);
        for (limited, left_out) in [ask::<3>(&mut random, 40_000), ask::<6>(&mut random, 40_000)] {
            assert!(limited > 10_000 && left_out > 1000, "{limited} {left_out}");
        }
    }
}
