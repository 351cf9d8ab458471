//! A rational B-spline in X and Y (G5.2, G5.3), divided into a chain of chords. One chord is computed at a time. Each
//! span between two knots is divided into pieces, which are halved until they are within the tolerance of their
//! chords.
//!
//! The knots are uniform, but several knots coincide at each end: the curve begins at the first control point and ends
//! at the last one. A span is the part of the curve between two knots: the quotient of two polynomials whose degree is
//! one less than the order.
//!
//! ```text
//!       1 ─ ─ ─ ─ 2
//!      ╱    ___    ╲
//!     ╱  .-'   '-.  ╲       control points 0 to 3, curve and chord of a piece
//!    0 .'_________'. 3
//! ```
//! A piece is a part of a span with control points of its own, in whole numbers of 0.1 nm. To compute one of them, the
//! sides of the span's control polygon are divided, then the sides of the resulting polygon, and so on, as many times
//! as the degree. Each division uses the parameter of the piece's start or of the piece's end.
//!
//! The piece lies within the polygon of its control points. So its distance from its chord is at most the greatest
//! distance of a control point from the chord. If this distance is too great, the piece is halved.
//!
//! A side is divided between two points with the weights w₀ and w₁. A division at the share a is not in the ratio of a
//! to 1 - a, but of a·w₁ to (1 - a)·w₀. All weights are positive, so a point never leaves the polygon, however much
//! the weights differ.

use super::arc::{Curvature, LEAST_TOLERANCE, UNIT, scale};
use super::trapezoid::square_root;
use crate::axes::{Axis, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::{Coordinate, WeightedPoint};

/// Maximum order of a curve (its degree plus one).
const ORDER_MAX: usize = 8;
/// Maximum length of a piece, as a share of a span, so that a tiny curve keeps its shape.
const LONGEST: i64 = UNIT / 2;
/// Minimum length of a piece, as a share of a span, even if the tolerance requires shorter ones.
const SHORTEST: i64 = UNIT >> 20;
/// Maximum number of pieces that are examined for limits or the length. It bounds the time of a call for any weights
/// and rounding. A curve with more pieces counts as outside the limits; its remaining length is measured without
/// halving.
const MOST_PIECES: u32 = 1000;
/// Maximum size of a piece when a length is measured, as a share of a span.
const LONGEST_MEASURED: i64 = UNIT / 8;
/// Limit of the ratio (polygon - chord) / polygon of a piece whose length is measured. Above it, the piece is halved
/// first. The polygon is that of the piece's control points.
const BENT: f32 = 0.03;
/// Difference between chord and polygon that rounding alone can cause, mm.
const LEAST_BENT: f32 = 1.0e-5;
/// Difference below which two unit vectors count as one direction: an f32 cannot resolve less.
const STRAIGHT: f32 = 1.0e-6;

/// A position in X and Y relative to the first control point, in units of 0.1 nm.
type Place = [i64; 2];
/// The control points of a piece. Their number is the order of the curve; the remaining places are unused.
type Piece = [Place; ORDER_MAX];

/// A rational B-spline as programmed: start, control points and order.
#[derive(Clone, Copy, Debug)]
pub struct NurbsGeometry<'a, const N: usize> {
    /// Start, machine coordinates. Axes other than X and Y do not move.
    pub start: PerAxis<Coordinate, N>,
    /// The control points; the first is the start in X and Y. At least as many as the order.
    pub points: &'a [WeightedPoint],
    /// The degree plus one, 2 to 8.
    pub order: u8,
}

/// Progress along the chords of a curve. The caller keeps the control points.
#[derive(Clone, Debug)]
pub struct Nurbs<const N: usize> {
    start: PerAxis<Coordinate, N>,
    order: u8,
    tolerance: f32,
    span: usize,
    /// End of the previous chord, as a share of the span.
    at: i64,
    /// Initial length of the next piece, as a share of the span. It is halved until the piece is within the tolerance.
    step: i64,
    curve_radius: f32,
}

fn minus([a, b]: Place, [c, d]: Place) -> Place {
    [a - c, b - d]
}

fn in_mm(vector: Place) -> [f32; 2] {
    vector.map(|part| Coordinate(part).to_mm())
}

fn length([x, y]: [f32; 2]) -> f32 {
    square_root(x * x + y * y)
}

/// Returns the distance of a point from a line segment, mm. The segment begins at zero and ends at the second point.
fn distance([x, y]: [f32; 2], [a, b]: [f32; 2]) -> f32 {
    let (square, along) = (a * a + b * b, x * a + y * b);
    if along <= 0.0 {
        length([x, y])
    } else if along >= square {
        length([x - a, y - b])
    } else {
        (x * b - y * a).abs() / square_root(square)
    }
}

impl<const N: usize> NurbsGeometry<'_, N> {
    fn spans(&self) -> usize {
        (self.points.len() + 1).saturating_sub(usize::from(self.order))
    }

    /// Returns the control points of a piece of a span. `from`, `to`: ends of the piece, as shares of the span.
    #[inline(never)]
    fn piece(&self, span: usize, from: i64, to: i64) -> Piece {
        let degree = usize::from(self.order).clamp(2, ORDER_MAX) - 1;
        let mut local = [([0; 2], 1.0); ORDER_MAX];
        let [first_x, first_y] = self.points.first().map_or([0; 2], |first| first.place.map(|part| part.0));
        for (slot, point) in local.iter_mut().zip(self.points.get(span..).unwrap_or(&[])).take(degree + 1) {
            let [x, y] = point.place;
            *slot = ([x.0 - first_x, y.0 - first_y], point.weight);
        }
        let mut piece = [[0; 2]; ORDER_MAX];
        for (at, place) in piece.iter_mut().take(degree + 1).enumerate() {
            *place = self.divided(local, span, degree, |level| if level < at { to } else { from });
        }
        piece
    }

    /// Computes a control point of a piece. Divides the sides of the polygon `local`, then the sides of the resulting
    /// polygon, and so on, as many times as the degree. `share`: returns, for each of these levels, the share of the
    /// span at which to divide.
    fn divided(
        &self,
        mut local: [(Place, f32); ORDER_MAX],
        span: usize,
        degree: usize,
        share: impl Fn(usize) -> i64,
    ) -> Place {
        let spans = self.spans();
        // At either end of the curve, several knots coincide.
        let knot = |at: usize| at.saturating_sub(degree).min(spans) as i64;
        for level in 0..degree {
            for at in (level + 1..=degree).rev() {
                let (lower, upper) = (knot(span + at), knot(span + at + degree - level));
                let part = ((span as i64 - lower) * UNIT + share(level)) / (upper - lower).max(1);
                if let Some([.., (before, light), (place, heavy)]) = local.get_mut(at - 1..=at) {
                    *place = weighted((*before, *light), (place, heavy), part);
                }
            }
        }
        local.get(degree).map_or([0; 2], |(place, _)| *place)
    }

    fn place(&self, [x, y]: Place) -> PerAxis<Coordinate, N> {
        let mut place = self.start;
        for (axis, part) in [Axis::X, Axis::Y].into_iter().zip([x, y]) {
            place.set(axis, place.get(axis).unwrap_or(Coordinate::ZERO) + Coordinate(part));
        }
        place
    }

    /// Returns the length of the curve, mm, within half a percent. Strongly bent parts are measured in shorter pieces,
    /// a cusp in the shortest ones.
    pub fn length(&self) -> f32 {
        self.measure().0
    }

    /// Returns the length, mm, and the number of pieces measured.
    #[inline(never)]
    fn measure(&self) -> (f32, u32) {
        let degree = usize::from(self.order).clamp(2, ORDER_MAX) - 1;
        let (mut sum, mut pieces) = (0.0, 0);
        for span in 0..self.spans() {
            let (mut at, mut step) = (0, LONGEST_MEASURED);
            while at < UNIT {
                let to = (at + step).min(UNIT);
                let piece = self.piece(span, at, to);
                let (polygon, chord) = lengths(piece.get(..=degree).unwrap_or(&[]));
                pieces += 1;
                let is_bent = polygon - chord > BENT * polygon + LEAST_BENT;
                if is_bent && step > SHORTEST && pieces < MOST_PIECES {
                    step /= 2;
                    continue;
                }
                // The length lies between that of the chord and that of the polygon. The higher the degree is, the
                // nearer is the length to that of the polygon.
                sum += (2.0 * chord + (degree as f32 - 1.0) * polygon) / (degree as f32 + 1.0);
                (at, step) = (to, (step * 2).min(LONGEST_MEASURED));
            }
        }
        (sum, pieces)
    }

    /// Returns `true` if the curve leaves a convex region. `outside`: returns whether a position is outside the
    /// region. The result is also `true` if more than `MOST_PIECES` pieces would have to be examined, because the
    /// curve runs very close along the region's edge.
    #[inline(never)]
    pub fn leaves(&self, outside: impl Fn(&PerAxis<Coordinate, N>) -> bool) -> bool {
        let degree = usize::from(self.order).clamp(2, ORDER_MAX) - 1;
        let [first_x, first_y] = self.points.first().map_or([0; 2], |first| first.place.map(|part| part.0));
        let is_out = |place: &Place| outside(&self.place(*place));
        // The curve lies within the polygon of its control points: if all of them are inside, so is the curve.
        let corner = |point: &WeightedPoint| minus(point.place.map(|part| part.0), [first_x, first_y]);
        if !self.points.iter().map(corner).any(|place| is_out(&place)) {
            return false;
        }
        let mut pieces = 0;
        for span in 0..self.spans() {
            let (mut at, mut step) = (0, UNIT);
            while at < UNIT {
                pieces += 1;
                if pieces > MOST_PIECES {
                    return true;
                }
                let to = (at + step).min(UNIT);
                let piece = self.piece(span, at, to);
                let [Some(begin), Some(end)] = [0, degree].map(|corner| piece.get(corner)) else { return true };
                if is_out(begin) || is_out(end) {
                    return true;
                }
                if step > SHORTEST && piece.iter().take(degree + 1).any(is_out) {
                    step /= 2;
                } else {
                    (at, step) = (to, step * 2);
                }
            }
        }
        false
    }
}

/// Returns the point at a share of the distance between two weighted points. `part`: this share, as a multiple of 1 /
/// [`UNIT`]. Replaces the weight of the second point by the weight of the result.
fn weighted((before, light): (Place, f32), (place, heavy): (&Place, &mut f32), part: i64) -> Place {
    let share = if light.to_bits() == heavy.to_bits() {
        part as i32
    } else {
        let part = part as f32 / UNIT as f32;
        let (ahead, behind) = (part * *heavy, (1.0 - part) * light);
        *heavy = ahead + behind;
        (ahead / *heavy * UNIT as f32) as i32
    };
    let [a, b] = before;
    let [c, d] = *place;
    [a + scale(c - a, share), b + scale(d - b, share)]
}

/// Returns the lengths of a polygon and of the chord between its ends, mm.
fn lengths(corners: &[Place]) -> (f32, f32) {
    let way = |pair: &[Place]| match pair {
        [a, .., b] => length(in_mm(minus(*b, *a))),
        _ => 0.0,
    };
    (corners.windows(2).map(way).sum(), way(corners))
}

/// Returns the unit vector of the first side whose length is not 0; the zero vector if all lengths are 0.
fn direction(mut sides: impl Iterator<Item = Place>) -> [f32; 2] {
    let side = in_mm(sides.find(|side| *side != [0; 2]).unwrap_or([0; 2]));
    let length = length(side);
    if length > 0.0 { side.map(|part| part / length) } else { [0.0; 2] }
}

impl<const N: usize> Nurbs<N> {
    /// Prepares the chords. No chord deviates from the curve by more than `tolerance` (mm).
    pub fn new(geometry: &NurbsGeometry<N>, tolerance: f32) -> Self {
        Self {
            start: geometry.start,
            order: geometry.order,
            tolerance: tolerance.max(LEAST_TOLERANCE),
            span: 0,
            at: 0,
            step: LONGEST,
            curve_radius: f32::INFINITY,
        }
    }

    /// Returns the end of the next chord; `None` after the last one. `points` must be the control points given to
    /// [`Nurbs::new`].
    #[inline(never)]
    pub fn next_chord(&mut self, points: &[WeightedPoint]) -> Option<PerAxis<Coordinate, N>> {
        let curve = NurbsGeometry { start: self.start, points, order: self.order };
        if !FULL_IMAGE || self.span >= curve.spans() {
            return None;
        }
        let degree = usize::from(self.order).clamp(2, ORDER_MAX) - 1;
        loop {
            let to = (self.at + self.step).min(UNIT);
            let piece = curve.piece(self.span, self.at, to);
            let corners = piece.get(..=degree)?;
            let (first, last) = (*corners.first()?, *corners.last()?);
            let chord = in_mm(minus(last, first));
            let away = corners.iter().map(|corner| distance(in_mm(minus(*corner, first)), chord)).fold(0.0, f32::max);
            if away > self.tolerance && self.step > SHORTEST {
                self.step /= 2;
                continue;
            }
            let [from_first, from_last] = [
                direction(corners.iter().map(|corner| minus(*corner, first))),
                direction(corners.iter().rev().map(|corner| minus(last, *corner))),
            ];
            let turn = length([from_last[0] - from_first[0], from_last[1] - from_first[1]]);
            let has_both = from_first != [0.0; 2] && from_last != [0.0; 2];
            self.curve_radius = if has_both && turn > STRAIGHT { length(chord) / turn } else { f32::INFINITY };
            self.at = to;
            // A piece of twice the length deviates four times as much. So the length is doubled only if the deviation
            // is below a quarter of the tolerance.
            if 4.0 * away < self.tolerance {
                self.step = (self.step * 2).min(LONGEST);
            }
            if to == UNIT {
                (self.span, self.at) = (self.span + 1, 0);
            }
            return Some(curve.place(last));
        }
    }

    /// Returns the curvature along the chord that `next_chord` returned last.
    pub fn curvature(&self) -> Curvature {
        Curvature { radius: self.curve_radius, axes: [Axis::X, Axis::Y] }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn points(of: &[(f64, f64, f32)]) -> Vec<WeightedPoint> {
        let units = |mm: f64| Coordinate((mm * 1.0e7).round() as i64);
        of.iter().map(|&(x, y, weight)| WeightedPoint { place: [units(x), units(y)], weight }).collect()
    }

    fn geometry(points: &[WeightedPoint], order: u8) -> NurbsGeometry<'_, 3> {
        let [x, y] = points[0].place;
        NurbsGeometry { start: PerAxis([x, y, Coordinate::mm(7)]), points, order }
    }

    fn mm(place: &PerAxis<Coordinate, 3>) -> [f64; 2] {
        [0, 1].map(|axis| place.0[axis].0 as f64 / 1.0e7)
    }

    /// Returns a point of the curve by its definition: blending functions over the knots.
    fn defined(points: &[WeightedPoint], order: usize, at: f64) -> [f64; 2] {
        let (degree, spans) = (order - 1, points.len() + 1 - order);
        let knot = |i: usize| i.saturating_sub(degree).min(spans) as f64;
        let last = (at.floor() as usize).min(spans - 1) + degree;
        let mut blend: Vec<f64> = (0..points.len() + degree).map(|i| f64::from(u8::from(i == last))).collect();
        for level in 1..order {
            for i in 0..points.len() + degree - level {
                let part = |from: f64, to: f64, by: f64| if to > from { by / (to - from) } else { 0.0 };
                let rising = part(knot(i), knot(i + level), at - knot(i));
                let falling = part(knot(i + 1), knot(i + level + 1), knot(i + level + 1) - at);
                blend[i] = rising * blend[i] + falling * blend[i + 1];
            }
        }
        let sum = |value: &dyn Fn(&WeightedPoint) -> f64| {
            points.iter().zip(&blend).map(|(point, blend)| blend * f64::from(point.weight) * value(point)).sum::<f64>()
        };
        let weight = sum(&|_| 1.0);
        [0, 1].map(|axis| sum(&|point| point.place[axis].0 as f64 / 1.0e7) / weight)
    }

    /// Curves from LinuxCNC have the same points as in LinuxCNC's interpreter. Each point is given by its share of the
    /// whole curve, `at`/`parts`.
    #[test]
    fn as_linuxcnc_has_them() {
        let own = [(0.0, 0.0, 1.0), (0.0, 1.0, 1.0), (2.0, 2.0, 1.0), (2.0, 0.0, 1.0), (0.0, 0.0, 2.0)];
        let cubic = [(0.0, 0.0, 1.0), (2.0, 2.0, 1.0), (4.0, 0.0, 1.0), (4.0, 4.0, 1.0), (4.0, 6.0, 1.0)];
        let heavy_start = [(0.0, 0.0, 3.0), (2.0, 2.0, 1.0), (4.0, 0.0, 1.0)];
        let heavy_middle = [(0.0, 0.0, 1.0), (2.0, 2.0, 3.0), (4.0, 0.0, 1.0)];
        for (of, order, parts, at, wanted) in [
            (&own[..], 3, 75, 1, [0.0016, 0.0792]),
            (&own, 3, 75, 20, [0.64, 1.28]),
            (&own, 3, 75, 25, [1.0, 1.5]),
            (&own, 3, 75, 48, [1.9936, 1.1504]),
            (&own, 3, 75, 51, [1.993_610_2, 0.920_127_8]),
            (&own, 3, 75, 54, [1.900_156, 0.687_987_5]),
            (&cubic, 4, 75, 1, [0.157_876_1, 0.153_685_3]),
            (&cubic, 4, 75, 13, [1.740_297_5, 1.185_877_3]),
            (&cubic, 4, 75, 50, [3.851_851_9, 2.444_444_4]),
            (&heavy_start, 3, 45, 1, [0.030_524, 0.029_845_7]),
            (&heavy_start, 3, 45, 25, [1.592_920_4, 0.707_964_6]),
            (&heavy_middle, 3, 45, 1, [0.241_708_3, 0.239_891]),
            (&heavy_middle, 3, 45, 13, [1.536_459_7, 1.353_212_3]),
        ] {
            let points = points(of);
            let curve = geometry(&points, order);
            let at = at * curve.spans() as i64 * UNIT / parts;
            let piece = curve.piece((at / UNIT) as usize, 0, at % UNIT);
            let found = piece[usize::from(order) - 1].map(|part| part as f64 / 1.0e7);
            for (found, wanted) in found.iter().zip(wanted) {
                assert!((found - wanted).abs() < 2.0e-6, "{order} {at}: {found:?}, not {wanted:?}");
            }
        }
    }

    #[test]
    fn a_curve_without_length_and_one_that_is_straight() {
        let still = points(&[(1.0, 2.0, 1.0); 4]);
        let mut curve = Nurbs::new(&geometry(&still, 3), 0.002);
        while let Some(place) = curve.next_chord(&still) {
            assert_eq!((mm(&place), place.0[2]), ([1.0, 2.0], Coordinate::mm(7)));
            assert_eq!(curve.curvature().radius, f32::INFINITY);
        }
        let straight = points(&[(0.0, 0.0, 1.0), (3.0, 1.5, 5.0), (4.0, 2.0, 1.0)]);
        let mut curve = Nurbs::new(&geometry(&straight, 3), 0.002);
        let mut chords = 0;
        while curve.next_chord(&straight).is_some() {
            assert_eq!(curve.curvature().radius, f32::INFINITY);
            chords += 1;
        }
        assert!(chords <= 4, "{chords}");
    }

    /// A quarter of a circle is a curve of three points, the middle one with weight √(1/2).
    #[test]
    #[cfg_attr(not(feature = "full"), ignore = "no curves are built")]
    fn a_quarter_of_a_circle() {
        let quarter = points(&[(10.0, 0.0, 1.0), (10.0, 10.0, core::f32::consts::FRAC_1_SQRT_2), (0.0, 10.0, 1.0)]);
        let geometry = geometry(&quarter, 3);
        let mut curve = Nurbs::new(&geometry, 0.002);
        let mut chords = 0;
        while let Some(place) = curve.next_chord(&quarter) {
            let [x, y] = mm(&place);
            assert!((x.hypot(y) - 10.0).abs() < 2.0e-6, "{x} {y}");
            let radius = curve.curvature().radius;
            assert!((radius - 10.0).abs() < 0.02, "{radius}");
            chords += 1;
        }
        // An arc of the same tolerance has 40 chords.
        assert!((30..120).contains(&chords), "{chords}");
        assert!((geometry.length() - 15.708).abs() < 0.002, "{}", geometry.length());
    }

    #[test]
    #[cfg_attr(not(feature = "full"), ignore = "no curves are built")]
    fn the_length_of_a_curve_that_turns_back() {
        for size in [1.0e-6, 1.0e-5, 1.0e-4, 1.0e-3, 1.0] {
            let there_and_back = points(&[(0.0, 0.0, 1.0), (size, 0.0, 20.0), (0.0, 0.0, 0.05), (0.0, size, 1.0)]);
            let length = f64::from(geometry(&there_and_back, 4).length());
            assert!(length > 0.5 * size && length < 4.0 * size + 1.0e-4, "{size}: {length}");
        }
    }

    proptest! {
        /// The number of pieces is bounded for any weights: several thousand pieces would occupy the control task for
        /// longer than the segment buffer lasts.
        #[test]
        #[cfg_attr(not(feature = "full"), ignore = "no curves are built")]
        fn a_length_is_taken_of_a_bounded_number_of_pieces(
            of in prop::collection::vec((-1.0..1.0_f64, -1.0..1.0_f64, -7.0..7.0_f32), 8..14),
            order in 3..=8_u8,
            size in -5.0..3.0_f32,
            is_flat: bool,
        ) {
            let size = f64::from(10.0_f32.powf(size));
            let of: Vec<_> = of.into_iter().map(|(x, y, w)| (x * size, if is_flat { 0.0 } else { y * size }, w.exp())).collect();
            let points = points(&of);
            let geometry = geometry(&points, order);
            let (length, pieces) = geometry.measure();
            // After `MOST_PIECES` pieces, none is halved any more. In each span, the pieces then grow again from the
            // shortest to the longest.
            let least = (UNIT / LONGEST_MEASURED) as u32;
            prop_assert!(pieces < MOST_PIECES + 20 + geometry.spans() as u32 * (least + 20), "{pieces}");
            prop_assert!(length.is_finite() && length >= 0.0);
        }

        #[test]
        #[cfg_attr(not(feature = "full"), ignore = "no curves are built")]
        fn chords_stay_within_the_tolerance_and_limits_are_those_of_the_curve(
            of in prop::collection::vec((-50.0..50.0_f64, -50.0..50.0_f64, 0.05..20.0_f32), 8..14),
            order in 3..=8_u8,
            weighted: bool,
            limit in -40.0..40.0_f64,
        ) {
            const TOLERANCE: f64 = 0.01;
            let of: Vec<_> = of.into_iter().map(|(x, y, w)| (x, y, if weighted { w } else { 1.0 })).collect();
            let points = points(&of);
            let geometry = geometry(&points, order);
            let mut curve = Nurbs::new(&geometry, TOLERANCE as f32);
            let mut from = mm(&geometry.start);
            let (mut end, mut before) = (geometry.start, (0, 0));
            let (mut length, mut greatest) = (0.0, from[0]);
            while let Some(place) = curve.next_chord(&points) {
                let to = mm(&place);
                let now = if curve.at == 0 { (curve.span - 1, UNIT) } else { (curve.span, curve.at) };
                let began = if now.0 == before.0 { before.1 } else { 0 };
                for part in 0..=4 {
                    let share = began + (now.1 - began) * part / 4;
                    let point = defined(&points, usize::from(order), now.0 as f64 + share as f64 / UNIT as f64);
                    let [a, b] = [0, 1].map(|axis| (to[axis] - from[axis]) as f32);
                    let away = distance([0, 1].map(|axis| (point[axis] - from[axis]) as f32), [a, b]);
                    prop_assert!(f64::from(away) < TOLERANCE + 1.0e-5, "{point:?} is {away} from {from:?} to {to:?}");
                    greatest = greatest.max(point[0]);
                }
                length += (to[0] - from[0]).hypot(to[1] - from[1]);
                (from, end, before) = (to, place, now);
            }
            prop_assert_eq!([end.0[0], end.0[1]], points[points.len() - 1].place);
            prop_assert_eq!(end.0[2], Coordinate::mm(7));
            let computed = f64::from(geometry.length());
            prop_assert!((computed - length).abs() < 0.005 * length + 0.005, "{} {}", computed, length);
            if (greatest - limit).abs() > 2.0 * TOLERANCE {
                let leaves = geometry.leaves(|place| mm(place)[0] > limit);
                prop_assert_eq!(leaves, greatest > limit);
            }
        }
    }
}
