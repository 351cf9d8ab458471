//! Determines how fast the machine can follow a path that turns. One rule serves for every turn, from a single corner
//! to a long curve of short chords. The path is divided into spans: parts of at least a certain length, each with the
//! direction from its start to its end. Each new span is compared with the spans before it. If the direction has
//! turned, a `Bend` limits the speed and the acceleration of the blocks on the turn. Turns that can come from the
//! rounding of the program's coordinates are ignored.
//!
//! Suppose that a path turns by the angle t (rad) within the length L (mm), and is followed at the speed v (mm/s). The
//! velocity vector then changes by v·q in the time L/v. Here q = 2·sin(t/2) is the length of the difference of the
//! unit vectors before and after the turn. The axes' acceleration a provides a·L/v of this change. The junction
//! deviation d (mm) permits an additional jump of the velocity by J·q. The jump is the same for the whole turn,
//! however the turn is distributed over L. So v is limited as follows:
//!
//! ```text
//!   1        between two single pieces             v² - v·J = a·L/t      J² = a·d·s / (1 - s), s = cos(t/2)
//!    \  2    between the middles of two spans      v² - J²  = a·L/t      (of several pieces each)
//!     '---.  a corner: L = 0                       v        = J
//!          \ 3
//! ```
//! Form 1 is exact if both ends are single pieces (straight moves), because these turn only at their ends. A span of
//! several pieces has the direction of the path in its middle, so form 2 is used. It is stricter, and tends to v² =
//! a·R on a long curve of radius R.
//!
//! The program's coordinates are rounded. A digit is the value of their last decimal place, such as 0.001 mm, and each
//! point can be off by half a digit on each axis. That can turn a span of length l by at most 1.5 digits / l. This
//! angle (`noise`) is subtracted from each turn, so a straight line with rounded points counts as straight. The finer
//! the resolution of a program, the smaller is this allowance.
//!
//! Short spans are unreliable if the resolution is coarse. Long spans hide short turns. So the path is measured on
//! several scales at once. Each scale has its own minimum length of a span, and each new span is compared with the
//! last [`HISTORY`] spans of the same scale. A piece longer than the minimum length is a span of its own; the
//! unfinished span before it ends where the piece starts.

use super::axis_limits::GREATEST_ACCELERATION;
use super::block::{Block, CurveLoad};
use super::junction::{
    BEND_MARGIN, REVERSAL, SQUARE_CORNER, TurnRule, UNLIMITED2, certain, is_noise, radius_of, rise2, turn2,
};
use super::path_end::way_mm;
use super::trapezoid::{greater, lesser, square_root};
use crate::axes::PerAxis;
use crate::image::FULL_IMAGE;
use crate::lent::Lent;
use crate::units::Coordinate;

/// Number of scales. Each scale divides the path into spans of a different minimum length: powers of two, from
/// [`SHORTEST`] to 32 mm. On the longest scale, a span and the [`HISTORY`] spans before it cover 160 mm, more than a
/// radian of a bend with a radius of 100 mm.
pub(super) const SCALES: usize = 14;
/// Minimum length of a span on the finest scale, mm. The minimum doubles from each scale to the next.
const SHORTEST: f32 = 1.0 / 256.0;
/// Returns the minimum length of the spans of a scale, mm.
#[inline]
fn scale_length(scale: usize) -> f32 {
    SHORTEST * (1_u32 << scale) as f32
}

/// Returns the number of scales on which a straight piece of this length, mm, is long enough to be a span of its own.
/// They are the finest scales: one scale from 1/256 mm on, two scales from 1/128 mm on. Compares binary exponents.
#[inline]
fn scales_within(length: f32) -> usize {
    let exponent = |length: f32| (length.to_bits() >> 23) as usize;
    (exponent(length) + 1).saturating_sub(exponent(SHORTEST)).min(SCALES)
}

/// `true`: limits that the machine cannot exceed anyway are skipped, to save time. The small image has no room for the
/// checks that find such limits. So it computes all limits, except those that the first check of [`Span::limit_after`]
/// excludes. Both images make the same steps (`tests/jobs.rs`).
const LEAVES_OUT: bool = FULL_IMAGE;
/// Number of previous spans that a new one is compared with.
const HISTORY: usize = 4;
const _: () = assert!(HISTORY.is_power_of_two(), "the indices of a ring wrap");
/// Sideways error that rounding of the coordinates can cause at the two ends of a span together, in digits (values of
/// the last decimal place). Half a digit on each axis shifts a point by 0.71 digits if two axes move, by 0.87 digits
/// if three move. For two points that is 1.41 or 1.73 digits; 1.5 lies between.
pub(super) const DIGITS_ASIDE: f32 = 1.5;
/// Minimum ratio of a span's straight length to its path length. Below this ratio the span has no useful direction,
/// and is not compared with others. Half a circle has 2/π = 0.64.
const STRAIGHTNESS: f32 = 0.6;
/// q² (see the head of this file) of a turn of 0.61 rad. A larger turn need not be a bend: it can be a corner between
/// straight pieces, where the machine is faster than on a bend.
const LARGE_TURN2: f32 = 0.36;
/// Decides whether a turn above [`LARGE_TURN2`] over several spans is a bend or a corner. The turn consists of smaller
/// turns from span to span. It counts as a bend only if the first and the last of the smaller turns each have at least
/// this share of the q² of the whole turn.
const ENDS2: f32 = 1.0 / 36.0;
/// Limit of the radius of a large turn, as a multiple of the junction deviation. The radius is L/t: path length divided
/// by angle. Below the limit, [`ENDS2`] alone decides whether the turn counts as a bend. Above the limit, the turn must
/// also consist of exactly three smaller turns from span to span, and the middle one must be no corner ([`EVEN2`]).
/// Above the limit, the J² of the smaller turns is negligible compared with a·L/t.
const VAGUE: f32 = 72.0;
/// Of three consecutive turns, the middle one is no corner if its q² is less than this multiple of the lower q² of the
/// other two.
const EVEN2: f32 = 9.0;
/// Maximum q² (0.25 rad) of a turn between two spans from which a radius of curvature is computed. The radius of a
/// larger turn would only be a mean over a long distance.
const LARGEST_FOR_RADIUS2: f32 = 0.0625;
/// Maximum q² (0.1 rad) of a turn for which [`Span::note_turn`] checks in advance whether the turn allows the
/// attainable speed. [`HISTORY`] such turns in a row have a q of at most 0.1 · [`HISTORY`] in total.
const LITTLE_TURN2: f32 = 0.01;
/// Lower bound of s = cos(t/2) for a turn t that consists of [`HISTORY`] turns of at most 0.1 rad ([`LITTLE_TURN2`]).
const LITTLE_TURNS_COSINE: f32 = 0.95;
/// A block counts as steep ([`Chain::since_steep`]) if its acceleration is more than this factor times
/// [`TurnRule::most`]. The acceleration of other blocks can exceed [`TurnRule::most`] by up to 0.5 %. The margin of
/// [`rise2`] (1 %) covers that.
const STEEP: f32 = 1.005;
/// A bend has no noticeable effect if its speed² is more than this factor times the maximum speed² of the machine
/// there: the bend then leaves the acceleration along the path unchanged, within 5 %.
pub(super) const NOTICEABLE: f32 = 3.2;
/// Number of points after which [`LastDigit`] begins a new record of the finest resolution. The result is the finest
/// resolution of two records, the present one and the one before. One point is not enough, because a number without
/// its trailing zeros (1.5 instead of 1.500) seems to have a coarser resolution than the program.
const POINTS: u8 = 32;

/// A limit for the blocks from `nearest` to `farthest`. Both numbers count back from the newest block, which is 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bend {
    /// Maximum speed² at the blocks' entries.
    pub speed2: f32,
    /// Range of blocks (nearest, farthest) that is searched for a slow corner; `None`: the limit always applies. A
    /// corner is slow if its speed² is at most `speed2`. The limit does not apply if there is a slow corner, because
    /// most of the turn can be at this corner. The machine brakes before the corner and speeds up after it, so the
    /// whole turn takes long enough.
    pub once: Option<(usize, usize)>,
    /// The acceleration that the bend needs at a given speed, to be set in the blocks; `NONE`: the bend only limits the
    /// speed.
    pub curve: CurveLoad,
    pub nearest: usize,
    pub farthest: usize,
}

/// A part of the path, of one or several straight pieces, with the direction from its start to its end.
#[derive(Clone, Copy, Debug)]
pub(super) struct Span<const N: usize> {
    /// Unit vector from the start to the end of the span; valid only if `straight`.
    direction: [f32; N],
    /// Maximum angle by which the rounding of its ends can have turned the span, rad.
    noise: f32,
    /// Length of the path, mm.
    path: f32,
    /// Maximum speed² of the span's moves under any override, mm²/s².
    fast2: f32,
    /// Maximum speed² that the machine can have in the span ([`Finder::attainable2`]); at most `fast2`.
    attainable2: f32,
    /// Number of moves; 0: there is no span.
    blocks: u16,
    /// `true` if the span has a direction: its ends are different points, and its path is not much longer than the
    /// straight line between them ([`STRAIGHTNESS`]).
    straight: bool,
    /// q² of the turn from the previous span to this one.
    turned2: f32,
    /// Speed² that the turn from the previous span certainly allows, both by itself and as a part of a longer turn; 0:
    /// not known.
    sure2: f32,
    /// The bend that the turn from the previous span indicates; `NONE`: the turn is too gentle to matter, or too large
    /// to compute a radius ([`LARGEST_FOR_RADIUS2`]).
    curve: CurveLoad,
}

/// Maximum speed² in the turn from one span to a later one, and the size of this turn.
struct Limit {
    speed2: f32,
    /// q² (see the head of this file) of the part of the turn that rounding of the coordinates cannot explain.
    turn2: f32,
    /// Path length of the turn divided by its angle, mm.
    radius: f32,
}

impl<const N: usize> Span<N> {
    const NONE: Self = Self {
        direction: [0.0; N],
        noise: 0.0,
        path: 0.0,
        fast2: 0.0,
        attainable2: 0.0,
        blocks: 0,
        straight: false,
        turned2: 0.0,
        sure2: 0.0,
        curve: CurveLoad::NONE,
    };

    /// Creates a span that consists of one straight piece.
    #[inline]
    pub(super) fn of(piece: &PathPiece<'_, N>) -> Self {
        let straight = piece.length > 0.0;
        let noise = if straight { DIGITS_ASIDE * piece.digit / piece.length } else { 0.0 };
        Self {
            direction: *piece.direction,
            noise,
            path: piece.path,
            fast2: piece.fast2,
            attainable2: piece.fast2,
            blocks: 1,
            straight,
            ..Self::NONE
        }
    }

    /// Returns the path length, mm, that the span contributes to a turn at its start or its end. A span of several
    /// pieces has its direction in its middle, so it contributes half of its path. A span of one piece has its
    /// direction up to its ends, so it contributes 0.
    #[inline]
    fn half(&self) -> f32 {
        if self.blocks == 1 { 0.0 } else { 0.5 * self.path }
    }

    /// Returns the maximum speed² at the corner between the span `before` and this one, each of which must consist of
    /// one straight piece.
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
        let Some((turn2, half_cosine)) = certain(all2, before.noise + self.noise) else { return UNLIMITED2 };
        if turn2 > REVERSAL {
            return 0.0;
        }
        let across = rule.across(&before.direction, &self.direction, square_root(all2));
        rule.junction2(across, half_cosine, turn2)
    }

    /// Returns the speed limit for the turn from an earlier span `old` to this one. Returns `None` if the limit is not
    /// below the speed² `fast2`, or if rounding of the coordinates can explain the turn. `between`: path length
    /// between the two spans, mm.
    #[inline]
    fn limit_after(&self, old: &Self, between: f32, fast2: f32, rule: &TurnRule<N>) -> Option<Limit> {
        let all2 = turn2(&old.direction, &self.direction);
        let noise = old.noise + self.noise;
        if is_noise(all2, noise) {
            return None;
        }
        let length = between + old.half() + self.half();
        // A quick first check with values on the safe side. `all2` is the turn before noise is subtracted, so it is at
        // least the real turn. 1 - q²/4 is at most s = √(1 - q²/4).
        if rule.is_surely_faster(rule.least, length, all2, 1.0 - 0.25 * all2, fast2) {
            return None;
        }
        let moving = rule.moving(&old.direction, &self.direction);
        let (turn2, half_cosine) = certain(all2, noise)?;
        let radius = length * radius_of(turn2, half_cosine);
        let junction2 = |across| if turn2 > REVERSAL { 0.0 } else { rule.junction2(across, half_cosine, turn2) };
        // A second check. In both forms of the rule (see the head of this file), the speed² is at least a·L/t + J².
        // Here a is the lowest acceleration limit of the moving axes.
        if LEAVES_OUT && BEND_MARGIN * (moving.least * rule.curve_share * radius + junction2(moving.least)) > fast2 {
            return None;
        }
        let bend2 = rule.in_plane(&old.direction, &self.direction, all2, moving) * rule.curve_share * radius;
        if bend2 > fast2 {
            return None;
        }
        let junction2 = junction2(rule.across(&old.direction, &self.direction, square_root(all2)));
        let speed2 = if old.blocks == 1 && self.blocks == 1 {
            let speed = 0.5 * (square_root(junction2) + square_root(junction2 + 4.0 * bend2));
            speed * speed
        } else {
            junction2 + bend2
        };
        (speed2 < fast2).then_some(Limit { speed2, turn2, radius })
    }

    /// Returns the part of the path, mm, that counts for the turn from the span `old` to this one. Several consecutive
    /// turns can also be treated as one turn, for which [`Span::limit_after`] uses a certain length. The parts of these
    /// turns add up to at most this length.
    #[inline]
    fn share_of_length(&self, old: &Self) -> f32 {
        match (old.blocks, self.blocks) {
            (1, 1) => 0.5 * lesser(old.path, self.path),
            _ => old.half() + self.half(),
        }
    }

    /// Sets `turned2`, `sure2` and `curve` for the turn from the previous span `old` to this one. Sets `curve` only if
    /// the bend would have a noticeable effect at the maximum speed of the faster span ([`NOTICEABLE`]).
    #[inline]
    fn note_turn(&mut self, old: &Self, rule: &TurnRule<N>) {
        if old.blocks == 0 || !old.straight || !self.straight {
            return;
        }
        let all2 = turn2(&old.direction, &self.direction);
        self.turned2 = all2;
        let attainable2 = greater(old.attainable2, self.attainable2);
        if LEAVES_OUT
            && all2 <= LITTLE_TURN2
            && rule.is_surely_faster(rule.least, self.share_of_length(old), all2, LITTLE_TURNS_COSINE, attainable2)
        {
            self.sure2 = attainable2;
        }
        if is_noise(all2, old.noise + self.noise) {
            return;
        }
        let fast2 = greater(old.fast2, self.fast2);
        let length = 0.5 * (old.path + self.path);
        if LEAVES_OUT && rule.is_surely_faster(rule.least, length, all2, 1.0 - 0.25 * all2, NOTICEABLE * fast2) {
            return;
        }
        let Some((turn2, half_cosine)) = certain(all2, old.noise + self.noise) else { return };
        if turn2 < LARGEST_FOR_RADIUS2 {
            let radius = length * radius_of(turn2, half_cosine);
            let moving = rule.moving(&old.direction, &self.direction);
            let acceleration = rule.in_plane(&old.direction, &self.direction, all2, moving);
            let curve2 = acceleration * rule.curve_share * radius;
            if curve2 < NOTICEABLE * fast2 {
                self.curve = CurveLoad::new(curve2, acceleration);
            }
        }
    }
}

/// The straight piece of the path that the newest block covers.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathPiece<'a, const N: usize> {
    pub start: &'a PerAxis<Coordinate, N>,
    pub end: &'a PerAxis<Coordinate, N>,
    /// Unit vector from `start` to `end`; if both are the same point, the unit vector of the block before.
    pub direction: &'a [f32; N],
    /// Straight distance from start to end, mm.
    pub length: f32,
    /// Path length, including moves too short for a step, mm.
    pub path: f32,
    /// Maximum speed² under any override.
    pub fast2: f32,
    /// Resolution of the program's coordinates (value of their last decimal place), mm.
    pub digit: f32,
}

/// The two limits of a block that determine the maximum speed that the machine can reach in the block.
#[derive(Clone, Copy, Debug)]
pub(super) struct EntryLimit {
    /// Maximum speed² at the block's entry.
    pub corner2: f32,
    /// Maximum acceleration along the block, mm/s².
    pub acceleration: f32,
}

impl EntryLimit {
    /// Returns the limits of the newest block, or values that limit nothing if there is no block.
    #[inline]
    pub(super) fn of<const N: usize>(newest: Option<&Block<N>>) -> Self {
        newest.map_or(Self { corner2: UNLIMITED2, acceleration: GREATEST_ACCELERATION }, |block| Self {
            corner2: block.corner2,
            acceleration: block.acceleration,
        })
    }
}

/// Finds the bends that the newest piece of the path completes, and passes them to `found`. Also tracks the speed that
/// the machine can reach under all these limits.
struct Finder<'a, const N: usize> {
    rule: &'a TurnRule<N>,
    found: &'a mut dyn FnMut(Bend),
    /// Maximum speed² that the machine can have at the end of the newest piece. After each speed limit, the machine
    /// can only speed up with the acceleration of its axes.
    attainable2: f32,
    /// Path length of the straight piece that is being added, mm.
    newest: f32,
    /// Path length since the last steep block ([`Chain::since_steep`]), mm.
    since_steep: f32,
}

impl<const N: usize> Finder<'_, N> {
    /// Passes a bend to `found`, and lowers `attainable2` if the bend limits it. `behind`: number of blocks queued
    /// after the span that completes the bend. `length`: upper bound of the path length, mm, from the bend's nearest
    /// entry to the end of that span.
    #[inline]
    fn limit(&mut self, bend: Bend, behind: usize, length: f32) {
        let length = if behind > 0 { length + self.newest } else { length };
        if LEAVES_OUT && bend.once.is_none() && length <= self.since_steep {
            // If the bend is found late, the machine may already be too fast for it. But when the machine reached the
            // bend, the queue ended within `length`, so the machine could still stop within `length`. So its speed² was
            // at most `rise2` there. Up to the end of the newest piece, the speed² can rise by `rise2` once more.
            let rise2 = rise2(self.rule.most, length);
            self.attainable2 = lesser(self.attainable2, greater(bend.speed2, rise2) + rise2);
        }
        (self.found)(bend);
    }
}

/// Ring of the last [`HISTORY`] spans.
#[derive(Clone, Copy, Debug)]
struct History<const N: usize> {
    spans: [Span<N>; HISTORY],
    newest: usize,
}

impl<const N: usize> History<N> {
    const NONE: Self = Self { spans: [Span::NONE; HISTORY], newest: 0 };

    /// Returns a previous span, counted back from the newest one, which is 0. If there is no such span, returns an
    /// empty one (`blocks` is 0).
    #[inline(always)]
    fn back(&self, count: usize) -> &Span<N> {
        self.spans.get(self.newest.wrapping_sub(count) % HISTORY).unwrap_or(&Span::NONE)
    }

    /// Returns the previous spans, the newest first.
    #[inline(always)]
    fn iter(&self) -> impl Iterator<Item = &Span<N>> {
        (0..HISTORY).map(|count| self.back(count)).take_while(|span| span.blocks > 0)
    }

    // Not inlined, because this function has several callers.
    /// Compares a new span with the previous ones, then adds it to them. `behind`: number of blocks after the span.
    /// Skips the corner between two spans of one piece each, because [`Chain::corner2`] limits it.
    #[inline(never)]
    fn take_span(&mut self, new: &mut Span<N>, behind: usize, finder: &mut Finder<'_, N>) {
        let (first, second) = (self.back(0), self.back(1));
        new.note_turn(first, finder.rule);
        // Of three consecutive turns, a corner causes at most two, a bend all three.
        let bend = new.curve.middle(first.curve, second.curve);
        if new.straight && !self.surely_allows(new) {
            self.compare(new, behind, finder);
        }
        if !bend.is_none() {
            let own = usize::from(new.blocks);
            let farthest = behind + own - 1 + usize::from(first.blocks) + usize::from(second.blocks);
            // The bend is part of the programmed shape, not a corner. So the junction deviation does not allow it more
            // than the speed of a square corner.
            let square = bend.acceleration() * finder.rule.deviation * SQUARE_CORNER;
            let speed2 = greater(bend.speed2(), square);
            let bend = Bend { speed2, once: None, curve: bend, nearest: behind + own, farthest };
            finder.limit(bend, behind, new.path + first.path);
        }
        self.newest = (self.newest + 1) % HISTORY;
        if let Some(oldest) = self.spans.get_mut(self.newest) {
            *oldest = *new;
        }
    }

    /// Returns `true` if every turn from a previous span to the new one certainly allows the speed that the machine can
    /// have there. Then [`History::compare`] is not necessary. Only the turns from span to span are checked. A turn
    /// over several spans allows any speed that all of its small turns allow: its angle is at most the sum of their
    /// angles, and its path is at least as long as their paths together.
    #[inline(always)]
    fn surely_allows(&self, new: &Span<N>) -> bool {
        if !LEAVES_OUT {
            return false;
        }
        let (mut sure2, mut fast2) = (new.sure2, new.attainable2);
        for old in self.iter() {
            fast2 = greater(old.attainable2, fast2);
            if sure2 < fast2 {
                return false;
            }
            sure2 = lesser(old.sure2, sure2);
        }
        true
    }

    /// Compares a new span with each previous one, and passes every speed limit below the possible speed to `finder`.
    #[inline(always)]
    fn compare(&self, new: &Span<N>, behind: usize, finder: &mut Finder<'_, N>) {
        let rule = finder.rule;
        let first = self.back(0);
        let own = usize::from(new.blocks);
        let (mut between, mut blocks, mut fast2, mut turned2) = (0.0, 0, new.attainable2, new.turned2);
        for (index, old) in self.iter().enumerate() {
            fast2 = greater(fast2, old.attainable2);
            let corner = index == 0 && own == 1 && old.blocks == 1;
            if old.straight
                && !corner
                && let Some(limit) = new.limit_after(old, between, fast2, rule)
            {
                let ends2 = lesser(new.turned2, turned2);
                let spread = index > 0 && limit.radius < VAGUE * rule.deviation && ends2 > ENDS2 * limit.turn2;
                let bent = index == 2 && ends2 > ENDS2 * limit.turn2 && first.turned2 < EVEN2 * ends2;
                // If the old and the new span are neighbours, the limit applies from the middle of the old span to the
                // middle of the new one. Otherwise it applies to the blocks between the two spans.
                let halves = if index == 0 { (own / 2, usize::from(old.blocks) / 2) } else { (own - 1, 0) };
                let start = behind + own - 1 + blocks;
                let once = limit.turn2 > LARGE_TURN2 && !spread && !bent;
                let bend = Bend {
                    speed2: limit.speed2,
                    once: once.then_some((behind, start + usize::from(old.blocks) - 1)),
                    curve: CurveLoad::NONE,
                    nearest: behind + halves.0,
                    farthest: start + halves.1,
                };
                finder.limit(bend, behind, new.path);
            }
            between += old.path;
            blocks += usize::from(old.blocks);
            turned2 = old.turned2;
        }
    }
}

/// The path measured on one scale: the last completed spans, and the unfinished one, which is still shorter than the
/// scale's minimum length.
#[derive(Clone, Copy, Debug)]
pub struct Scale<const N: usize> {
    history: History<N>,
    /// Start of the unfinished span.
    start: PerAxis<Coordinate, N>,
    /// Path length of the unfinished span, mm.
    path: f32,
    /// Maximum speed² of the pieces in the unfinished span, under any override.
    fast2: f32,
    /// Maximum speed² that the machine can have in the unfinished span; at most `fast2`.
    attainable2: f32,
    /// Number of blocks in the unfinished span.
    blocks: u16,
}

impl<const N: usize> Scale<N> {
    #[inline]
    fn begin(&mut self, start: &PerAxis<Coordinate, N>) {
        self.start = *start;
        self.path = 0.0;
        self.fast2 = 0.0;
        self.attainable2 = 0.0;
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
            attainable2: self.attainable2,
            blocks: self.blocks,
            straight,
            ..Span::NONE
        };
        self.begin(end);
        span
    }
}

/// The resolution of the program's coordinates: the finest one of the last 32 to 64 points.
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

/// The path at the end of the queue, measured in spans on several scales, so that bends are found when a piece is
/// added.
#[derive(Debug)]
#[cfg_attr(feature = "alloc", derive(Clone))]
pub(super) struct Chain<const N: usize> {
    /// The last straight pieces, each as a span of its own.
    pieces: History<N>,
    scales: Lent<[Scale<N>]>,
    /// Number of scales on which the last piece is long enough to be a span of its own. They are the finest scales.
    /// They have no unfinished span, and `pieces` serves as their history.
    whole: usize,
    digit: LastDigit,
    /// Maximum speed² that the machine can have at the end of the last piece ([`Finder::attainable2`]).
    attainable2: f32,
    /// Path length since the last steep block, mm. A block is steep if its acceleration along its path exceeds
    /// [`TurnRule::most`], the upper bound for the displacement of the axes. Steep blocks occur because moves without
    /// a step lengthen the path of the next block, but not the displacement of its axes.
    since_steep: f32,
}

impl<const N: usize> Chain<N> {
    /// Initial contents of all scales. (A chain without scales compares a new piece only with the last [`HISTORY`]
    /// pieces.)
    pub(super) const SCALES: [Scale<N>; SCALES] = {
        let scale = Scale {
            history: History::NONE,
            start: PerAxis::all(Coordinate::ZERO),
            path: 0.0,
            fast2: 0.0,
            attainable2: 0.0,
            blocks: 0,
        };
        [scale; SCALES]
    };

    pub(super) fn new(scales: Lent<[Scale<N>]>) -> Self {
        Self { pieces: History::NONE, scales, whole: 0, digit: LastDigit::NONE, attainable2: 0.0, since_steep: 0.0 }
    }

    /// Discards the path before `start`, because the machine comes to rest there.
    pub(super) fn restart(&mut self, start: &PerAxis<Coordinate, N>) {
        self.whole = 0;
        self.attainable2 = 0.0;
        self.since_steep = 0.0;
        self.pieces = History::NONE;
        for scale in self.scales.iter_mut() {
            scale.history = self.pieces;
            scale.begin(start);
        }
    }

    /// Records `digit`, the resolution of one more point's coordinates, mm. Returns the resolution of the program, mm:
    /// the finest one of the last points.
    pub(super) fn last_digit(&mut self, digit: f32) -> f32 {
        self.digit.with(digit)
    }

    /// Returns the record of the program's resolution, so that the caller can restore it later. The caller does so
    /// after it has queued pieces with computed ends, because such ends tell nothing about the program's resolution.
    pub(super) fn program_digit(&self) -> LastDigit {
        self.digit
    }

    /// Restores the record that [`Chain::program_digit`] has returned.
    pub(super) fn set_program_digit(&mut self, digit: LastDigit) {
        self.digit = digit;
    }

    /// Returns the maximum speed² at the corner between the last piece and a new one, `piece`, given as a span of its
    /// own. Call [`Chain::extend`] afterwards.
    #[inline]
    pub(super) fn corner2(&self, piece: &Span<N>, rule: &TurnRule<N>) -> f32 {
        let before = self.pieces.back(0);
        if before.blocks == 0 { UNLIMITED2 } else { piece.corner2(before, rule) }
    }

    /// Adds the straight piece of the newest block, and calls `found` for each bend that it completes. The block must
    /// be in the queue already, because its limits are lowered, too.
    #[inline(never)]
    pub(super) fn extend(
        &mut self,
        piece: &PathPiece<'_, N>,
        block: EntryLimit,
        mut new: Span<N>,
        rule: &TurnRule<N>,
        found: &mut dyn FnMut(Bend),
    ) {
        new.attainable2 = self.attainable2_in(piece, block, rule);
        let (attainable2, since_steep) = (new.attainable2, self.since_steep);
        let mut finder = Finder { rule, found, attainable2, newest: piece.path, since_steep };
        self.add(piece, new, &mut finder);
        self.attainable2 = finder.attainable2;
    }

    /// Returns the maximum speed² that the machine can reach in the newest piece. It enters the piece with at most the
    /// corner speed of the block, and at most the speed attainable at the end of the last piece. Then it speeds up
    /// with the acceleration of the block. Also updates `since_steep`.
    #[inline]
    fn attainable2_in(&mut self, piece: &PathPiece<'_, N>, block: EntryLimit, rule: &TurnRule<N>) -> f32 {
        if !LEAVES_OUT {
            return piece.fast2;
        }
        let is_steep = block.acceleration > STEEP * rule.most;
        self.since_steep = if is_steep { 0.0 } else { self.since_steep + piece.path };
        let entry2 = lesser(block.corner2, self.attainable2);
        lesser(entry2 + rise2(block.acceleration, piece.path), piece.fast2)
    }

    fn add(&mut self, piece: &PathPiece<'_, N>, mut new: Span<N>, finder: &mut Finder<'_, N>) {
        let digit = piece.digit;
        let whole = scales_within(piece.length);
        let mut scale_length = scale_length(whole);
        if self.whole < whole {
            self.end_before(piece, &new, whole, finder);
        }
        for scale in self.scales.get_mut(whole..self.whole).unwrap_or_default() {
            scale.history = self.pieces;
            scale.begin(piece.start);
        }
        self.pieces.take_span(&mut new, 0, finder);
        self.whole = whole;
        let (mut path, mut fast2, mut attainable2, mut blocks) = (new.path, new.fast2, new.attainable2, 1);
        for scale in self.scales.get_mut(whole..).unwrap_or_default() {
            scale.path += path;
            scale.fast2 = greater(scale.fast2, fast2);
            scale.attainable2 = greater(scale.attainable2, attainable2);
            scale.blocks = scale.blocks.saturating_add(blocks);
            if scale.path < scale_length {
                return;
            }
            (path, fast2, attainable2, blocks) = (scale.path, scale.fast2, scale.attainable2, scale.blocks);
            let mut span = scale.end(piece.end, digit);
            scale.history.take_span(&mut span, 0, finder);
            scale_length *= 2.0;
        }
    }

    /// Handles the scales `self.whole` to `whole`. On these scales, the new piece is long enough to be a span of its
    /// own, but the last piece was too short. On each of them, ends the unfinished span where the new piece begins,
    /// then adds the piece as a span. Both spans are compared with the previous ones.
    #[inline(never)]
    fn end_before(&mut self, piece: &PathPiece<'_, N>, new: &Span<N>, whole: usize, finder: &mut Finder<'_, N>) {
        let (mut path, mut fast2, mut attainable2, mut blocks) = (0.0, 0.0, 0.0, 0);
        for (index, scale) in self.scales.iter_mut().enumerate().skip(self.whole) {
            scale.path += path;
            scale.fast2 = greater(scale.fast2, fast2);
            scale.attainable2 = greater(scale.attainable2, attainable2);
            scale.blocks = scale.blocks.saturating_add(blocks);
            if index >= whole {
                // This is the first scale on which the piece is too short for a span. The span that has just ended on
                // the next finer scale is added here (above). The caller adds the piece itself later.
                return;
            }
            if scale.blocks > 0 {
                (path, fast2, attainable2, blocks) = (scale.path, scale.fast2, scale.attainable2, scale.blocks);
                let mut span = scale.end(piece.start, piece.digit);
                scale.history.take_span(&mut span, 1, finder);
            }
            let mut own = *new;
            scale.history.take_span(&mut own, 0, finder);
        }
    }
}

#[cfg(test)]
mod tests;
