//! The geometry of path blending (G64 P Q). Short moves are merged into one if they stay within the tolerance. A corner
//! is cut off by a polygon around a circle that touches both of its moves. For this, up to two moves are held back;
//! [`super::rounding`] decides when they are queued.
//!
//! ```text
//!              C                      M
//!             / \                 .-'  '-.
//!      d     /___\   e         .'          '.
//!           /  :  \          A ────────────── M'
//!          /   :   \
//!         A         B
//!     a corner cut off         a merged move
//! ```
//! A merged move (A to M') passes all points between its ends, such as M. The distance from each point is at most the
//! least of three lengths: Q, half of P, and the junction deviation. The main axis is the one with the longest
//! displacement. Each point is compared with the point of the line that has the same position on the main axis. So each
//! point allows a range of slopes for each of the other axes. Only the intersection of these ranges is stored: two
//! numbers per axis for any number of points.
//!
//! A corner C, where the path turns by t, is cut off by a straight piece. This piece and both moves touch a circle of
//! radius r. So C has the distance e = r·(1/cos(t/2) - 1) from the piece, and d = e / sin(t/2) from the ends of the
//! piece. e is at most the part of P that merging has not used, and d is at most a quarter of the shorter move. No
//! point of the piece is farther from the moves than e, and the rest of each move stays straight. So tool and
//! programmed path stay within P of each other.
//!
//! Instead of one turn by t, the path makes two turns by t/2. For these, the rule for turns ([`super::junction`])
//! allows a higher speed v. At the speed v, the axes can make both turns only if the piece between them has a certain
//! length L. This length follows from v² - v·J = a·L/t. Here a is the acceleration, and J is the speed that the rule
//! allows at the unchanged corner. The radius r follows from L, because L = 2·r·tan(t/4). A smaller radius is used if
//! the maximum e or d requires it.
//!
//! Four turns by t/4 replace the two turns if t exceeds 1.2 rad and the turns by t/2 limit the speed more than the
//! maximum e and d do.
//!
//! Two kinds of turns are not cut off:
//! * Turns of 0.25 to 0.6 rad: the two halves would count as a bend ([`super::curvature`]). On a bend, the machine is
//!   not allowed the speed J that it is allowed at a corner.
//! * Turns of more than two radians: cutting off the corner would take longer than it saves. Cutting off raises the
//!   speed at the corner by a·L/(t·v), with the acceleration a. The higher speed saves the time 2·L/(t·v) of braking
//!   and speeding up. But the piece of length L takes the time L/v, which is more if t exceeds 2.

use super::curvature::DIGITS_ASIDE;
use super::junction::{TurnRule, certain, radius_of, turn2};
use super::trapezoid::{greater, lesser, square_root};
use super::{Move, Speed};
use crate::axes::{LINEAR, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

/// Maximum number of moves that are held back: the move before a corner and the move after it. The second one can still
/// grow by merging.
const HELD: usize = if FULL_IMAGE { 2 } else { 0 };
/// Maximum length of a merged move, mm. A look-ahead of 512 such moves (2.56 m) exceeds any braking distance. Without a
/// limit, a move could be held back for ever.
const MOST_MERGED: f32 = 5.0;
/// Maximum share of a move that is cut off at each of its corners. Half of a move remains between two corners. So a
/// polygon becomes a polygon with twice as many sides, of about equal lengths.
const MOST_OF_A_MOVE: f32 = 0.25;
/// q² of a turn by two radians, with q = 2·sin(t/2) for a turn by t. Sharper corners are not cut off.
const SHARPEST2: f32 = 2.832;
/// q² of a turn by 1.2 rad. Only larger turns get four vertices.
const LARGE_FOR_FOUR2: f32 = 1.275;
/// q² of a turn by 0.6 rad. Corners from [`GENTLE2`] up to this value are not cut off.
const LARGE2: f32 = 0.349;
/// q² of a turn by 0.25 rad: the lower end of the range of corners that are not cut off ([`LARGE2`]).
const GENTLE2: f32 = 0.0622;

/// How far the tool is allowed to deviate from the programmed path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Total deviation (G64 P), mm; 0: the path is exact.
    pub path: f32,
    /// Deviation of merged moves (G64 Q, the naive cam tolerance of LinuxCNC), mm.
    pub merging: f32,
}

impl Tolerance {
    /// No deviation: the tool follows the programmed path exactly.
    pub const EXACT: Self = Self { path: 0.0, merging: 0.0 };

    /// Returns the usable tolerance for a junction deviation d. The deviation m of merged moves is limited to
    /// * half of the total, which leaves the rest for the corners at the ends of the merged move;
    /// * d, so that merging slows down no curve. Moves along a curve of radius R that are merged with the deviation m
    ///   meet at corners of the angle t = 2·√(2·m/R). With the acceleration a, such a corner allows the speed² J² =
    ///   8·a·d/t² = a·R·d/m. If m ≤ d, this is at least a·R, the speed² that the curve itself allows.
    pub(super) fn bounded(self, junction_deviation: f32) -> Self {
        let merging = lesser(lesser(self.merging, 0.5 * self.path), junction_deviation);
        Self { merging, ..self }
    }
}

/// Slopes that a merged move may have, relative to the main axis (the one with the longest displacement). For each
/// axis, this is the range of slopes with which the line passes all merged points closely enough.
#[derive(Clone, Copy, Debug)]
struct Slopes<const N: usize> {
    main: usize,
    reach: f32,
    allowed: [(f32, f32); N],
}

impl<const N: usize> Slopes<N> {
    /// Creates the slopes for a single move, without any restriction. Before another move is merged with this one,
    /// [`Slopes::pass`] adds the end of this one as a point.
    fn to(way: &[f32; N]) -> Self {
        let (mut main, mut reach) = (0, 0.0_f32);
        for (axis, part) in way.iter().enumerate() {
            if part.abs() > reach.abs() {
                (main, reach) = (axis, *part);
            }
        }
        Self { main, reach, allowed: [(f32::NEG_INFINITY, f32::INFINITY); N] }
    }

    /// Returns the displacement of the main axis at `way`; `None` if the main axis has moved back from its farthest
    /// point.
    fn along(&self, way: &[f32; N]) -> Option<f32> {
        let along = way.get(self.main).copied()?;
        (along * self.reach > 0.0 && along.abs() >= self.reach.abs()).then_some(along)
    }

    /// Restricts the slopes so that the line passes near a point: at a distance of at most `within` (mm) in each axis.
    /// `way`: displacement from the start of the line to the point, mm.
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

    /// Returns whether the straight line from its start to `way` passes all points added by [`Slopes::pass`] closely
    /// enough.
    fn allow(&self, way: &[f32; N]) -> bool {
        let Some(along) = self.along(way) else { return false };
        let share = 1.0 / along;
        way.iter().zip(&self.allowed).all(|(part, (least, most))| (*least..=*most).contains(&(part * share)))
    }
}

/// A move that is not queued yet, because the next move may be merged with it, or because the corner between the two
/// moves may be cut off.
#[derive(Clone, Copy, Debug)]
pub(super) struct HeldMove<const N: usize> {
    /// Programmed start.
    start: PerAxis<Coordinate, N>,
    pub m: Move<N>,
    /// Line number for its block.
    pub number: u32,
    /// Whether the move was merged from several moves.
    merged: bool,
    slopes: Slopes<N>,
}

/// The vertices that replace a corner, in order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Vertices<const N: usize> {
    pub first: PerAxis<Coordinate, N>,
    pub between: Option<[PerAxis<Coordinate, N>; 2]>,
    pub last: PerAxis<Coordinate, N>,
}

/// A corner that can be cut off. t is the angle by which the path turns there.
struct Corner {
    /// q = 2·sin(t/2), the length of the difference of the moves' unit vectors.
    turn: f32,
    /// cos(t/2) for a turn by t.
    cosine: f32,
    /// 1/t. A bend that makes this turn has a radius of this factor times the length of the bend.
    per_angle: f32,
    /// J, the speed that the rule for turns allows at the unchanged corner, mm/s.
    jump: f32,
    /// Maximum acceleration in the direction of the change of velocity, mm/s².
    across: f32,
    /// Maximum centripetal acceleration of a bend in the plane of the corner, mm/s².
    bend: f32,
}

/// The circle for cutting off a corner. Both moves touch the circle, and so do the pieces that replace the corner. The
/// ends of these pieces are called vertices.
struct Fillet {
    radius: f32,
    /// tan(t/2n) for a turn by t that is divided among n vertices.
    tangent: f32,
    /// Whether four vertices replace the corner, instead of two.
    four: bool,
}

impl Corner {
    fn between<const N: usize>(into: &[f32; N], out: &[f32; N], noise: f32, rule: &TurnRule<N>) -> Option<Self> {
        let all2 = turn2(into, out);
        let (certain2, certain_cosine) = certain(all2, noise)?;
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
            jump: square_root(rule.junction2(across, certain_cosine, certain2)),
            across,
            bend: rule.in_plane(into, out, all2, rule.moving(into, out)) * rule.curve_share,
        })
    }

    /// Returns the circle for cutting off the corner at the speed `fast`, mm/s. The new path stays within `deviation`
    /// (mm) of the moves. It leaves the first move at most `back` (mm) before the corner. `None` if the machine can
    /// pass the unchanged corner at this speed.
    fn fillet<const N: usize>(&self, fast: f32, deviation: f32, back: f32, rule: &TurnRule<N>) -> Option<Fillet> {
        if self.jump >= fast {
            return None;
        }
        let sine = 0.5 * self.turn;
        let fourth = sine / (1.0 + self.cosine);
        let two = self.with(fourth, 1.0, fast, deviation, back, rule);
        // Four turns of less than 0.3 rad each would count as a bend. On a bend, the machine is not allowed the speed J
        // that it is allowed at a corner.
        if two.1 || self.turn * self.turn < LARGE_FOR_FOUR2 {
            return Some(two.0);
        }
        let cosine = square_root(0.5 * (1.0 + self.cosine));
        let eighth = 0.5 * sine / (cosine * (1.0 + cosine));
        Some(Fillet { four: true, ..self.with(eighth, 3.0, fast, deviation, back, rule).0 })
    }

    /// Returns the circle. Also returns `true` if `deviation` and `back` limit its radius. In that case, these two
    /// limit the speed more than the turns at the vertices do. `tangent`: tangent of half the turn at a vertex.
    /// `pieces`: number of pieces between the vertices.
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

    /// Returns the vertices (ends of the straight pieces around the circle) that replace `corner`.
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
        // The middle piece touches the circle at the point of the circle that is nearest to the corner.
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

/// Displacement, direction and length of a move.
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
    /// Creates a held move. `start`: its programmed start. `number`: line number for its block.
    pub(super) fn new(start: PerAxis<Coordinate, N>, m: &Move<N>, number: u32) -> Self {
        Self { start, m: *m, number, merged: false, slopes: Slopes::to(&way(&start, &m.target)) }
    }

    /// Returns whether a move has the same speed, power, line number and tolerance as this one. Only such moves are
    /// merged, so that merging changes neither reports nor outputs.
    fn is_like(&self, m: &Move<N>) -> bool {
        self.m.speed == m.speed
            && self.m.power == m.power
            && self.m.scale_power == m.scale_power
            && self.m.line_number == m.line_number
            && self.m.tolerance == m.tolerance
    }

    /// Extends this move to the end of the next one, if the straight line passes all merged points closely enough.
    /// Returns whether the move was extended.
    pub(super) fn merge(&mut self, m: &Move<N>, number: u32) -> bool {
        let whole = way(&self.start, &m.target);
        if m.tolerance.merging <= 0.0 || !self.is_like(m) || length(&whole) > MOST_MERGED {
            return false;
        }
        let mut slopes = self.slopes;
        // The line may deviate in up to two linear axes besides the main one. These deviations are perpendicular, so
        // their squares add up, and each axis gets a part of the tolerance. Moves of other axes are not merged: their
        // tolerance is `Tolerance::EXACT`.
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

    /// Returns the part of the tolerance that remains after merging, mm.
    fn deviation(&self) -> f32 {
        self.m.tolerance.path - if self.merged { self.m.tolerance.merging } else { 0.0 }
    }

    /// Returns whether `from` and `to` are the ends of the whole move, so that nothing of it was cut off.
    pub(super) fn is_whole(&self, from: &PerAxis<Coordinate, N>, to: &PerAxis<Coordinate, N>) -> bool {
        self.start == *from && self.m.target == *to
    }

    fn feed(&self) -> f32 {
        if let Speed::Feed(feed) = self.m.speed { feed } else { 0.0 }
    }
}

/// Up to [`HELD`] moves that are not queued yet ([`HeldMove`]).
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

    /// Returns the held moves, the older one first.
    pub(super) fn moves(&self) -> impl Iterator<Item = &HeldMove<N>> {
        self.held.iter().flatten()
    }

    /// Returns the end of the last held move; `None` if no move is held.
    pub(super) fn end(&self) -> Option<PerAxis<Coordinate, N>> {
        self.moves().last().map(|held| held.m.target)
    }

    /// Returns the last held move. Further moves can still be merged with it.
    pub(super) fn last_mut(&mut self) -> Option<&mut HeldMove<N>> {
        self.held.iter_mut().flatten().last()
    }

    pub(super) fn is_full(&self) -> bool {
        self.held.iter().all(Option::is_some)
    }

    pub(super) fn push(&mut self, held: HeldMove<N>) {
        if let Some(free) = self.held.iter_mut().find(|place| place.is_none()) {
            *free = Some(held);
        }
    }

    /// Removes and returns the older move.
    pub(super) fn pop(&mut self) -> Option<HeldMove<N>> {
        let oldest = self.held.first_mut()?.take();
        self.held.rotate_left(1);
        oldest
    }

    /// Returns the vertices (ends of straight pieces) that replace the corner between two moves; `None` if the corner
    /// stays. `least_mm`: minimum length of a straight piece. `limit`: function that returns the axes' maximum speed on
    /// a path; its arguments are the displacement and the length of the path.
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
