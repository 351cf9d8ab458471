//! Determines how fast the machine can follow a path that turns, by one rule for every turn, from a single corner to a
//! long curve of short chords. The path is divided into spans on several scales. Each new span is compared with the
//! spans before it, and each `Bend` found limits speed and acceleration of some blocks. Turns that can come from the
//! rounding of the program's last digit are ignored.
//!
//! A path that turns by an angle t within a length L requires a change of velocity of v·q in the time L/v, where q =
//! 2·sin(t/2) is the length of the difference of the unit vectors. The axes' acceleration provides a·L/v of this
//! change. The junction deviation d permits an additional jump of J·q, the same for the whole turn, however it is
//! distributed over L:
//!
//! ```text
//!   1        between two single pieces             v² - v·J = a·L/t      J² = a·d·s / (1 - s), s = cos(t/2)
//!    \  2    between the middles of two spans      v² - J²  = a·L/t      (of several pieces each)
//!     '---.  a corner: L = 0                       v        = J
//!          \ 3
//! ```
//! The first form is exact if both ends are single pieces, because these turn only at their ends. The direction of a
//! span of several pieces is that of the path in its middle; the second form is stricter, and tends to v² = a·R on a
//! long curve.
//!
//! The program's points are rounded: each can be off by half of the last digit on each axis. That can turn a span of
//! length l by at most 1.5 digits / l, and this much of q is ignored (`noise`). So a straight line with rounded points
//! counts as straight, and a program with finer digits loses no speed.
//!
//! If digits are coarse, short spans are unreliable; in long spans, short turns disappear. So the path is measured on
//! several scales at once. On each scale it is divided into spans of at least the scale's length, and a new span is
//! compared with the last [`HISTORY`] spans before it. A piece longer than the scale is a span of its own; the
//! unfinished span before it ends where the piece starts.

use super::block::CurveLoad;
use super::junction::{REVERSAL, SQUARE_CORNER, TurnRule, UNLIMITED2, certain, is_noise, radius_of, turn2};
use super::path_end::way_mm;
use super::trapezoid::{greater, lesser, square_root};
use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::units::Coordinate;

/// Number of scales. The lengths of their spans are powers of two from [`SHORTEST`] to 32 mm. On the longest scale, a
/// span and the [`HISTORY`] spans before it cover more than a radian of a bend of R = 100 mm.
pub(super) const SCALES: usize = 14;
/// Length of the spans of the first scale, mm.
const SHORTEST: f32 = 1.0 / 256.0;
/// Returns the minimum length of the spans of a scale, mm.
#[inline]
fn scale_length(scale: usize) -> f32 {
    SHORTEST * (1_u32 << scale) as f32
}

/// Returns how many scales are no longer than a piece of this length. Compares binary exponents.
#[inline]
fn scales_within(length: f32) -> usize {
    let exponent = |length: f32| (length.to_bits() >> 23) as usize;
    (exponent(length) + 1).saturating_sub(exponent(SHORTEST)).min(SCALES)
}

/// Number of previous spans that a new one is compared with.
const HISTORY: usize = 4;
/// Sideways error of a span's two ends together, in digits. Half a digit on each of two axes shifts a point by 0.71
/// digits, on each of three axes by 0.87; 1.5 lies between the sums for two points, 1.41 and 1.73.
pub(super) const DIGITS_ASIDE: f32 = 1.5;
/// Minimum ratio of a span's chord to its path. Below it the span does not count as the chord of a bend. Half a circle
/// has 2/π = 0.64.
const STRAIGHTNESS: f32 = 0.6;
/// q² of 0.61 rad. A larger turn need not be a bend: it can be a corner between straight pieces, where the machine is
/// faster than on a bend.
const LARGE_TURN2: f32 = 0.36;
/// A large turn counts as spread over its whole length only if the turn at either end has at least this share of its
/// q².
const ENDS2: f32 = 1.0 / 36.0;
/// Maximum L/t, as a multiple of the junction deviation, for which [`ENDS2`] applies. Beyond it, the J² of the smaller
/// turns within the large turn is negligible compared with a·L/t.
const VAGUE: f32 = 72.0;
/// Of three consecutive turns, the middle one is no corner if its q² is less than this multiple of the lower q² of the
/// other two.
const EVEN2: f32 = 9.0;
/// q² up to which a turn represents the local curvature rather than a mean over a long distance.
const GENTLE2: f32 = 0.0625;
/// Ratio of a bend's speed² to the maximum speed² above which the bend leaves the acceleration along the path
/// unchanged, within 5 %.
pub(super) const NOTICEABLE: f32 = 3.2;
/// Number of points whose finest digit counts as the program's. One point is not enough, because a number without its
/// trailing zeros seems to have coarser digits.
const POINTS: u8 = 32;

/// A limit for the blocks from `nearest` to `farthest`, counted back from the newest one, which is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Maximum speed² at the blocks' entries.
    pub speed2: f32,
    /// A range of blocks (nearest, farthest). If one of their entries is already as slow as `speed2`, the limit does
    /// not apply, because most of the turn can be a corner at that entry. The machine brakes before the corner and
    /// speeds up after it with the axes' acceleration, so the whole turn takes long enough.
    pub once: Option<(usize, usize)>,
    /// Acceleration that the bend takes.
    pub curve: CurveLoad,
    pub nearest: usize,
    pub farthest: usize,
}

/// A span of the path with the direction from its start to its end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span<const N: usize> {
    /// Unit vector.
    direction: [f32; N],
    /// Maximum angle by which the rounding of its ends can have turned the span, rad.
    noise: f32,
    /// Length of the path, mm.
    path: f32,
    /// Maximum speed² of its moves under any override.
    fast2: f32,
    /// Number of moves; 0: there is no span.
    blocks: u16,
    /// Whether the direction is meaningful.
    straight: bool,
    /// q² of the turn from the middle of the previous span to that of this one.
    turned2: f32,
    /// The bend of that turn.
    curve: CurveLoad,
}

/// Limit for the turn between two spans.
struct Limit {
    speed2: f32,
    /// q² of the turn, without noise.
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

    /// Creates the span of a single piece.
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

    /// Returns the path length between the point at which the span has its direction and its end: half of the path, or
    /// 0 for a single piece.
    #[inline]
    fn half(&self) -> f32 {
        if self.blocks == 1 { 0.0 } else { 0.5 * self.path }
    }

    /// Returns the maximum speed² at the corner with the previous piece. Both spans must be single pieces.
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

    /// Returns whether the turn from an earlier span can set a limit below `fast2`. `between`: path length between the
    /// spans. Inlined, so that the many turns that are noise or surely fast enough cost no function call.
    #[inline(always)]
    fn may_be_limited(&self, old: &Self, between: f32, fast2: f32, rule: &TurnRule<N>) -> bool {
        let all2 = turn2(&old.direction, &self.direction);
        let noise = old.noise + self.noise;
        if is_noise(all2, noise) {
            return false;
        }
        let (least, length) = (rule.least_of(&old.direction, &self.direction), between + old.half() + self.half());
        // A first check with bounds on the safe side: subtracting noise does not make the turn larger, and s = √(1 -
        // q²/4) is no less than 1 - q²/4.
        if rule.is_surely_faster(least, length, all2, 1.0 - 0.25 * all2, fast2) {
            return false;
        }
        certain(all2, noise).is_some_and(|(turn2, sine)| !rule.is_surely_faster(least, length, turn2, sine, fast2))
    }

    /// Returns the limit for the turn from an earlier span, with the path length `between` the two; `None` if it does
    /// not limit `fast2`.
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

    /// Sets the turn from the previous span. Sets the bend of this turn only if the bend matters at the maximum speed
    /// of the faster span.
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
    /// Straight distance from start to end, mm.
    pub length: f32,
    /// Path length, including moves too short for a step, mm.
    pub path: f32,
    /// Maximum speed² under any override.
    pub fast2: f32,
    /// Value of the program's last digit, mm.
    pub digit: f32,
}

/// The previous spans, the newest first.
#[derive(Clone, Copy, Debug)]
struct History<const N: usize>([Span<N>; HISTORY]);

impl<const N: usize> History<N> {
    // Not inlined, because this function has several callers.
    /// Compares a new span with the previous ones, and adds it. `behind`: number of blocks after the span. Skips the
    /// corner between two single pieces, which [`Chain::corner2`] limits.
    #[inline(never)]
    fn take_span(&mut self, new: &mut Span<N>, behind: usize, rule: &TurnRule<N>, found: &mut dyn FnMut(Bend)) {
        let [first, second, ..] = &self.0;
        new.note_turn(first, rule);
        // Of three consecutive turns, a corner causes at most two, a bend all three.
        let bend = new.curve.middle(first.curve, second.curve);
        if self.may_limit(new, rule) {
            self.compare(new, behind, rule, found);
        }
        if !bend.is_none() {
            let own = usize::from(new.blocks);
            let farthest = behind + own - 1 + usize::from(first.blocks) + usize::from(second.blocks);
            // The bend is part of the programmed shape, not a corner. So the junction deviation grants it no more than
            // the speed of a square corner.
            let square = bend.acceleration() * rule.deviation * SQUARE_CORNER;
            let speed2 = greater(bend.speed2(), square);
            found(Bend { speed2, once: None, curve: bend, nearest: behind + own, farthest });
        }
        let [first, second, third, fourth] = &mut self.0;
        // Moved one by one, because an array expression would be built in a temporary first.
        *fourth = *third;
        *third = *second;
        *second = *first;
        *first = *new;
    }

    /// Returns whether a new span can get a limit, so that [`History::compare`] is necessary.
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

    /// Compares a new span with the previous ones, and calls `found` for each limit.
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
                // For neighbouring spans, the limit applies from middle to middle; for others, it applies to the path
                // between the two spans.
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

/// One scale: its previous spans, and the unfinished one.
#[derive(Clone, Copy, Debug)]
pub struct Scale<const N: usize> {
    history: History<N>,
    /// Start of the unfinished span.
    start: PerAxis<Coordinate, N>,
    /// Path length of the unfinished span, mm.
    path: f32,
    /// Maximum speed² in the unfinished span.
    fast2: f32,
    /// Blocks of the unfinished span.
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

    /// Ends the unfinished span, begins the next one, and returns the completed span.
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

/// The program's last digit: the finest one of its last 32 to 64 points.
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

/// The straight pieces at the end of the queue, measured on all scales.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
pub(super) struct Chain<const N: usize> {
    /// The last single pieces.
    pieces: History<N>,
    scales: Lent<[Scale<N>]>,
    /// Number of scales no longer than the last piece: their spans are the single pieces. Long moves therefore need no
    /// unfinished spans at all.
    whole: usize,
    digit: LastDigit,
}

impl<const N: usize> Chain<N> {
    /// Initial scales. (A chain without scales considers only turns between single pieces.)
    pub(super) const SCALES: [Scale<N>; SCALES] = {
        let none = History([Span::NONE; HISTORY]);
        let scale = Scale { history: none, start: PerAxis::all(Coordinate::ZERO), path: 0.0, fast2: 0.0, blocks: 0 };
        [scale; SCALES]
    };

    pub(super) fn new(scales: Lent<[Scale<N>]>) -> Self {
        Self { pieces: History([Span::NONE; HISTORY]), scales, whole: 0, digit: LastDigit::NONE }
    }

    /// Discards the path before `start`, because the machine comes to rest there.
    pub(super) fn restart(&mut self, start: &PerAxis<Coordinate, N>) {
        self.whole = 0;
        self.pieces = History([Span::NONE; HISTORY]);
        for scale in self.scales.iter_mut() {
            scale.history = self.pieces;
            scale.begin(start);
        }
    }

    /// Adds the digit of one more point, and returns the program's last digit, mm.
    pub(super) fn last_digit(&mut self, digit: f32) -> f32 {
        self.digit.with(digit)
    }

    /// Returns the state of the program's last digit, to be restored after pieces with computed ends.
    pub(super) fn program_digit(&self) -> LastDigit {
        self.digit
    }

    /// Restores the state returned by [`Chain::program_digit`].
    pub(super) fn set_program_digit(&mut self, digit: LastDigit) {
        self.digit = digit;
    }

    /// Returns the maximum speed² at the corner before a single piece. Call [`Chain::extend`] afterwards.
    #[inline]
    pub(super) fn corner2(&self, piece: &Span<N>, rule: &TurnRule<N>) -> f32 {
        let [before, ..] = &self.pieces.0;
        if before.blocks == 0 { UNLIMITED2 } else { piece.corner2(before, rule) }
    }

    /// Adds the piece of the newest block, which must be in the queue already. Calls `found` for each bend.
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

    /// Handles a piece longer than the scales below `whole`: ends their unfinished spans where the piece begins, and
    /// compares the piece with the previous spans.
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
                // The longer scales get the path of the span that the last shorter scale ended. The piece itself is
                // added to them later.
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

        /// Returns a number from 0 to 1.
        fn share(&mut self) -> f32 {
            self.below(1 << 24) as f32 / (1 << 24) as f32
        }

        /// Returns a number between two others, evenly distributed by order of magnitude.
        fn size(&mut self, least: f32, greatest: f32) -> f32 {
            least * (greatest / least).powf(self.share())
        }

        fn sign(&mut self) -> f32 {
            if self.below(2) == 0 { 1.0 } else { -1.0 }
        }

        /// Returns a rule from the whole range that the settings allow.
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

        /// Returns the unit vector of a displacement, rounded as in the queue or as in the scales.
        fn unit<const N: usize>(&mut self, way: [f32; N]) -> [f32; N] {
            let length = square_root(way.iter().fold(0.0, |sum, part| sum + part * part));
            let shortness = 1.0 / length;
            if self.below(2) == 0 { way.map(|part| part / length) } else { way.map(|part| part * shortness) }
        }

        /// Returns a direction in which some axes do not move and some hardly move.
        fn direction<const N: usize>(&mut self) -> [f32; N] {
            let mut way = [0.0; N].map(|_| if self.below(2) == 0 { 0.0 } else { self.sign() * self.size(1.0e-7, 1.0) });
            way[self.below(N as u64) as usize] = self.sign();
            self.unit(way)
        }

        /// Returns a direction after `before`: slightly turned in some axes, reversed, or unrelated.
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

        /// Returns a span of one to three pieces.
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

    /// Returns the limits between a new span and the previous ones, by the complete rule.
    fn limits<const N: usize>(history: &History<N>, new: &Span<N>, rule: &TurnRule<N>) -> Vec<f32> {
        let mut speeds2 = Vec::new();
        history.compare(new, 0, rule, &mut |bend| speeds2.push(bend.speed2));
        speeds2
    }

    /// Checks `may_limit` for many turns at speeds close to their limits. Returns how many are limited, and how many
    /// are excluded in advance.
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
            // Clamped to the range of possible speeds.
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
