//! The geometry of path blending (G64 P Q): merges short moves that stay within the tolerance into one, and cuts
//! corners by a polygon within a circle that touches both moves. Holds the last two moves of the queue meanwhile.
//! [`super::rounding`] decides when they are queued.
//!
//! ```text
//!              C                      M                A move merged of several (A to M) passes all points between at
//!             / \                 .-'  '-.             Q at most, and half of P. Every point allows a range of slopes to
//!      d     /___\   e         .'          '.          each other axis where the longest way has come as far: two numbers
//!           /  :  \          A ────────────── M'       for each axis, however many points there are.
//!          /   :   \
//!         A         B      A corner C is cut off by a straight piece, d = e / sin(t/2) away from it on either move, where
//!                          the path turns by t. e is what is left of P, and d a quarter of the shorter move at most.
//! ```
//! The piece turns twice by t/2, which the rule of turns ([`super::junction`]) lets pass faster than t, and has the length
//! between that the axes need: it touches a circle of radius r that touches both moves, and v² - v·J = a·L/t. Where there is room
//! for more speed than corners of t/2 allow, there are four of t/4. What is left of a move is straight, so the tool stays within P
//! of the path, and the path within P of it: C is e = r·(1/cos(t/2) - 1) away, and no point of a piece is farther from the moves.
//!
//! Turns of 0.25 to 0.6 rad are left as they are: their halves would count as a bend ([`super::curvature`]), which is granted no J.
//! Beyond two radians the way round takes longer than the stop saves: with the acceleration a, cutting off a corner raises its
//! speed by a·L/(t·v), which saves 2·L/(t·v) of braking and speeding up, and the way L takes L/v.

use super::curvature::DIGITS_ASIDE;
use super::junction::{TurnRule, certain, radius_of, turn2};
use super::trapezoid::{greater, lesser, square_root};
use super::{Move, Speed};
use crate::axes::{LINEAR, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

/// Moves that are held back: the one before a corner, and the one behind it, which may still grow.
const HELD: usize = if FULL_IMAGE { 2 } else { 0 };
/// Longest merged move, mm: 512 of them are more than a machine needs to stop in, and what is held back has an end.
const MOST_MERGED: f32 = 5.0;
/// Share of a move that a corner takes: what lies between two corners is as long as the pieces that cut them off, so a
/// polygon becomes one of twice as many sides.
const MOST_OF_A_MOVE: f32 = 0.25;
/// q² of turns by two radians, by 1.2 rad and by 0.6 rad, and of a gentle one of a quarter.
const SHARPEST2: f32 = 2.832;
const LARGE_FOR_FOUR2: f32 = 1.275;
const LARGE2: f32 = 0.349;
const GENTLE2: f32 = 0.0622;

/// How far the tool may be from the programmed path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// In all, mm; 0: the path is exact.
    pub path: f32,
    /// Where moves are merged (G64 Q, the naive cam tolerance of LinuxCNC), mm.
    pub merging: f32,
}

impl Tolerance {
    /// The path is exact.
    pub const EXACT: Self = Self { path: 0.0, merging: 0.0 };

    /// What is made use of with a junction deviation. Merging leaves half for the corners at its ends. A curve of radius R
    /// that is merged within m turns by t = 2·√(2·m/R) at once. J² = 8·a·d/t² is no less than the a·R of the curve up to
    /// m = d: so merging makes no curve slower.
    pub(super) fn bounded(self, junction_deviation: f32) -> Self {
        let merging = lesser(lesser(self.merging, 0.5 * self.path), junction_deviation);
        Self { merging, ..self }
    }
}

/// The slopes to the axis with the longest way that all points of a merged move allow.
#[derive(Clone, Copy, Debug)]
struct Slopes<const N: usize> {
    main: usize,
    reach: f32,
    allowed: [(f32, f32); N],
}

impl<const N: usize> Slopes<N> {
    /// Of a move without points between its ends, the end of which is no point yet.
    fn to(way: &[f32; N]) -> Self {
        let (mut main, mut reach) = (0, 0.0_f32);
        for (axis, part) in way.iter().enumerate() {
            if part.abs() > reach.abs() {
                (main, reach) = (axis, *part);
            }
        }
        Self { main, reach, allowed: [(f32::NEG_INFINITY, f32::INFINITY); N] }
    }

    /// How far the longest way leads at a place, if that is not back.
    fn along(&self, way: &[f32; N]) -> Option<f32> {
        let along = way.get(self.main).copied()?;
        (along * self.reach > 0.0 && along.abs() >= self.reach.abs()).then_some(along)
    }

    /// Takes over a point, which a line may pass at this distance in each axis.
    fn pass(&mut self, way: &[f32; N], within: f32) {
        let Some(along) = self.along(way) else { return };
        self.reach = along;
        let share = 1.0 / along;
        let range = within * share.abs();
        for ((least, most), part) in self.allowed.iter_mut().zip(way) {
            let slope = part * share;
            *least = greater(*least, slope - range);
            *most = lesser(*most, slope + range);
        }
    }

    /// Whether the straight line to here passes all points.
    fn allow(&self, way: &[f32; N]) -> bool {
        let Some(along) = self.along(way) else { return false };
        let share = 1.0 / along;
        way.iter().zip(&self.allowed).all(|(part, (least, most))| (*least..=*most).contains(&(part * share)))
    }
}

/// A move that is held back.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldMove<const N: usize> {
    /// Where it begins, as programmed.
    start: PerAxis<Coordinate, N>,
    pub m: Move<N>,
    /// What its block is numbered with.
    pub number: u32,
    /// It is made of several.
    merged: bool,
    slopes: Slopes<N>,
}

/// The vertices that take the place of a corner, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vertices<const N: usize> {
    pub first: PerAxis<Coordinate, N>,
    pub between: Option<[PerAxis<Coordinate, N>; 2]>,
    pub last: PerAxis<Coordinate, N>,
}

/// A corner that can be rounded.
struct Corner {
    /// q = 2·sin(t/2), and cos(t/2).
    turn: f32,
    cosine: f32,
    /// 1/t.
    per_angle: f32,
    /// J of the corner as it is, mm/s.
    jump: f32,
    /// Across the corner, and what bends in its plane may take, mm/s².
    across: f32,
    bend: f32,
}

/// The circle that touches both moves, around which the vertices lie.
struct Fillet {
    radius: f32,
    /// tan(t/2n) with n vertices.
    tangent: f32,
    four: bool,
}

impl Corner {
    fn between<const N: usize>(into: &[f32; N], out: &[f32; N], noise: f32, rule: &TurnRule<N>) -> Option<Self> {
        let all2 = turn2(into, out);
        let (certain2, sine) = certain(all2, noise)?;
        if all2 > SHARPEST2 || (GENTLE2..LARGE2).contains(&all2) {
            return None;
        }
        let turn = square_root(all2);
        let across = rule.across(into, out, turn);
        let cosine = square_root(greater(1.0 - 0.25 * all2, 0.0));
        Some(Self {
            turn,
            cosine,
            per_angle: radius_of(all2, cosine),
            jump: square_root(rule.junction2(across, sine, certain2)),
            across,
            bend: rule.in_plane(into, out, all2) * rule.curve_share,
        })
    }

    /// The circle for a speed, with this deviation and its first vertex so far from the corner at most.
    fn fillet<const N: usize>(&self, fast: f32, deviation: f32, back: f32, rule: &TurnRule<N>) -> Option<Fillet> {
        if self.jump >= fast {
            return None;
        }
        let sine = 0.5 * self.turn;
        let fourth = sine / (1.0 + self.cosine);
        let two = self.with(fourth, 1.0, fast, deviation, back, rule);
        // Four vertices of less than 0.3 rad would be a bend, which is granted no jump.
        if two.1 || self.turn * self.turn < LARGE_FOR_FOUR2 {
            return Some(two.0);
        }
        let cosine = square_root(0.5 * (1.0 + self.cosine));
        let eighth = 0.5 * sine / (cosine * (1.0 + cosine));
        Some(Fillet { four: true, ..self.with(eighth, 3.0, fast, deviation, back, rule).0 })
    }

    /// With vertices, given by the tangent of half of a turn, and so many pieces between them. And whether there is no room
    /// for what the vertices would allow.
    fn with<const N: usize>(
        &self,
        tangent: f32,
        pieces: f32,
        fast: f32,
        deviation: f32,
        back: f32,
        rule: &TurnRule<N>,
    ) -> (Fillet, bool) {
        let (square, sine) = (1.0 + tangent * tangent, 0.5 * self.turn);
        let vertex2 = rule.junction2(self.across, 1.0 / square_root(square), 4.0 * tangent * tangent / square);
        let speed = lesser(fast, square_root(vertex2));
        // v² - v·J = a·L/t, with L = 2·r·tan(t/2n) for each piece.
        let length = speed * (speed - self.jump) / (self.bend * self.per_angle);
        let needed = length / (2.0 * pieces * tangent);
        let within = deviation * self.cosine * (1.0 + self.cosine) / (sine * sine);
        let room = lesser(within, back / (sine / self.cosine - tangent));
        (Fillet { radius: lesser(needed, room), tangent, four: false }, needed >= room)
    }

    /// The vertices around the circle.
    fn cut<const N: usize>(
        &self,
        corner: &PerAxis<Coordinate, N>,
        into: &Leg<N>,
        out: &Leg<N>,
        fillet: &Fillet,
    ) -> Vertices<N> {
        let sine = 0.5 * self.turn;
        let beyond = |way: [f32; N]| corner.zip(&PerAxis(way), |place, part| place + Coordinate::from_mm_f32(part));
        let back = fillet.radius * (sine / self.cosine - fillet.tangent);
        // The piece in the middle touches the circle where that is nearest to the corner.
        let inward = fillet.radius * (1.0 - self.cosine) / (self.cosine * self.turn);
        let along = fillet.radius * fillet.tangent / (2.0 * self.cosine);
        let middle = |side: f32| {
            let mut way = into.unit;
            for (part, out) in way.iter_mut().zip(out.unit) {
                *part = (out - *part) * inward + (out + *part) * along * side;
            }
            beyond(way)
        };
        Vertices {
            first: beyond(into.unit.map(|part| part * -back)),
            between: fillet.four.then(|| [middle(-1.0), middle(1.0)]),
            last: beyond(out.unit.map(|part| part * back)),
        }
    }
}

/// A direction, and how long the way in it is.
struct Leg<const N: usize> {
    way: [f32; N],
    unit: [f32; N],
    length: f32,
}

fn way<const N: usize>(from: &PerAxis<Coordinate, N>, to: &PerAxis<Coordinate, N>) -> [f32; N] {
    to.zip(from, |to, from| (to - from).to_mm()).0
}

fn length<const N: usize>(way: &[f32; N]) -> f32 {
    square_root(way.iter().fold(0.0, |sum, part| sum + part * part))
}

impl<const N: usize> HeldMove<N> {
    /// A move from a place.
    pub(super) fn new(start: PerAxis<Coordinate, N>, m: &Move<N>, number: u32) -> Self {
        Self { start, m: *m, number, merged: false, slopes: Slopes::to(&way(&start, &m.target)) }
    }

    /// Whether a move may be merged with it: all that a report or an output tells of them is the same.
    fn is_like(&self, m: &Move<N>) -> bool {
        self.m.speed == m.speed
            && self.m.power == m.power
            && self.m.scale_power == m.scale_power
            && self.m.line_number == m.line_number
            && self.m.tolerance == m.tolerance
    }

    /// Becomes the line to the end of a move that follows, if that passes all points between near enough.
    pub(super) fn merge(&mut self, m: &Move<N>, number: u32) -> bool {
        let whole = way(&self.start, &m.target);
        if m.tolerance.merging <= 0.0 || !self.is_like(m) || length(&whole) > MOST_MERGED {
            return false;
        }
        let mut slopes = self.slopes;
        // Of X, Y and Z but the one with the longest way, the distances add up as the sides of a box. Where others move, none are merged.
        let within = m.tolerance.merging / square_root((N.min(LINEAR) - 1).max(1) as f32);
        slopes.pass(&way(&self.start, &self.m.target), within);
        if !slopes.allow(&whole) {
            return false;
        }
        *self = Self { m: Move { digit: lesser(self.m.digit, m.digit), ..*m }, number, merged: true, slopes, ..*self };
        true
    }

    fn leg(&self) -> Leg<N> {
        let way = way(&self.start, &self.m.target);
        let length = length(&way);
        let share = if length > 0.0 { 1.0 / length } else { 0.0 };
        Leg { way, unit: way.map(|part| part * share), length }
    }

    /// What merging has left of the tolerance.
    fn deviation(&self) -> f32 {
        self.m.tolerance.path - if self.merged { self.m.tolerance.merging } else { 0.0 }
    }

    /// Whether a piece of it is all of it.
    pub(super) fn is_whole(&self, from: &PerAxis<Coordinate, N>, to: &PerAxis<Coordinate, N>) -> bool {
        self.start == *from && self.m.target == *to
    }

    fn feed(&self) -> f32 {
        if let Speed::Feed(feed) = self.m.speed { feed } else { 0.0 }
    }
}

/// The end of the queue, as far as it is held back.
#[derive(Clone, Debug)]
pub(super) struct Blend<const N: usize> {
    held: [Option<HeldMove<N>>; HELD],
}

impl<const N: usize> Blend<N> {
    pub(super) const NONE: Self = Self { held: [None; HELD] };

    #[inline]
    pub(super) fn is_holding(&self) -> bool {
        FULL_IMAGE && self.held.first().is_some_and(Option::is_some)
    }

    pub(super) fn forget(&mut self) {
        self.held = [None; HELD];
    }

    /// The moves, the older one first.
    pub(super) fn moves(&self) -> impl Iterator<Item = &HeldMove<N>> {
        self.held.iter().flatten()
    }

    /// Where it ends.
    pub(super) fn end(&self) -> Option<PerAxis<Coordinate, N>> {
        self.moves().last().map(|held| held.m.target)
    }

    /// The last move, which may still grow.
    pub(super) fn last_mut(&mut self) -> Option<&mut HeldMove<N>> {
        self.held.iter_mut().flatten().last()
    }

    /// Whether there is no room for one more.
    pub(super) fn is_full(&self) -> bool {
        self.held.iter().all(Option::is_some)
    }

    pub(super) fn push(&mut self, held: HeldMove<N>) {
        if let Some(free) = self.held.iter_mut().find(|place| place.is_none()) {
            *free = Some(held);
        }
    }

    /// The older move.
    pub(super) fn pop(&mut self) -> Option<HeldMove<N>> {
        let oldest = self.held.first_mut()?.take();
        self.held.rotate_left(1);
        oldest
    }

    /// How the corner between two moves is cut; `None`: it stays as it is. `limit`: what the axes allow on a way of this length;
    /// a piece of less than `least_mm` is none.
    pub(super) fn cut(
        before: &HeldMove<N>,
        after: &HeldMove<N>,
        rule: &TurnRule<N>,
        least_mm: f32,
        limit: &dyn Fn(&[f32; N], f32) -> f32,
    ) -> Option<Vertices<N>> {
        if before.m.power != after.m.power || before.m.scale_power != after.m.scale_power {
            return None;
        }
        let (into, out) = (before.leg(), after.leg());
        if into.length <= 0.0 || out.length <= 0.0 {
            return None;
        }
        let noise = DIGITS_ASIDE * (before.m.digit / into.length + after.m.digit / out.length);
        let corner = Corner::between(&into.unit, &out.unit, noise, rule)?;
        let fast = lesser(
            lesser(before.feed(), limit(&into.way, into.length)),
            lesser(after.feed(), limit(&out.way, out.length)),
        );
        let room = lesser(before.deviation(), after.deviation());
        let back = MOST_OF_A_MOVE * lesser(into.length, out.length);
        let fillet = corner.fillet(fast, room, back, rule)?;
        (2.0 * fillet.radius * fillet.tangent >= least_mm).then(|| corner.cut(&before.m.target, &into, &out, &fillet))
    }
}
