//! A Bezier curve of third degree in X and Y (G5, G5.1) as a chain of chords, computed one at a time by dividing the
//! sides of its control polygon; its length, its curvature and its extent.
//!
//! ```text
//!        b ── ── c         Each point is found by halving in other shares: a share t of the way along each side of the
//!       ╱  .──.   ╲        polygon a b c d, of the two sides that this gives, and of the last one, whose direction is the
//!      ╱ .'    '.  ╲       tangent. Whole numbers of 0.1 nm: three roundings, so a point lies within 0.2 nm of the curve
//!     ╱.'        '. ╲      however long the chain is.
//!    a'            'd
//! ```
//! A chord of a parameter step h leaves the curve by |second derivative|·h²/8 at most, and the derivative is greatest at an
//! end: that gives the number of chords. The last one ends at the target exactly.

use super::arc::{Curvature, LEAST_TOLERANCE, UNIT, UNIT_BITS, scale};
use super::trapezoid::square_root;
use crate::axes::{Axis, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

/// Fewest chords of what is no straight line, whatever the tolerance allows: a tiny curve keeps its shape.
const FEWEST: u32 = 4;
/// Pieces in which the length is summed up, each by three points.
const PIECES: u8 = 16;
/// Unit vectors that differ by less are one direction: beyond is what an f32 cannot tell.
const STRAIGHT: f32 = 1.0e-6;

/// A curve from one place to another. The axes other than X and Y stay where they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplineGeometry<const N: usize> {
    /// Where it begins, machine coordinates.
    pub start: PerAxis<Coordinate, N>,
    /// Where it ends.
    pub target: PerAxis<Coordinate, N>,
    /// The control point that it heads for, in X and Y from the start.
    pub leaving: [Coordinate; 2],
    /// The control point that it comes from, in X and Y from the target.
    pub arriving: [Coordinate; 2],
}

/// The chords of a curve, in order.
#[derive(Clone, Debug)]
pub struct Spline<const N: usize> {
    start: PerAxis<Coordinate, N>,
    target: PerAxis<Coordinate, N>,
    /// Control points from the start, which is the first of them.
    polygon: Polygon,
    chords: u32,
    done: u32,
    /// The end of the last chord, from the start, and the direction of the curve there; zero where it has none.
    last: [i64; 2],
    tangent: [f32; 2],
    curve_radius: f32,
}

/// The control points after the first, from it.
#[derive(Clone, Copy, Debug)]
struct Polygon([[i64; 2]; 3]);

fn between([a, b]: [i64; 2], [c, d]: [i64; 2], share: i32) -> [i64; 2] {
    [a + scale(c - a, share), b + scale(d - b, share)]
}

fn minus([a, b]: [i64; 2], [c, d]: [i64; 2]) -> [i64; 2] {
    [a - c, b - d]
}

fn in_mm(vector: [i64; 2]) -> [f32; 2] {
    vector.map(|part| Coordinate(part).to_mm())
}

fn length([x, y]: [f32; 2]) -> f32 {
    square_root(x * x + y * y)
}

#[inline(never)]
fn unit(vector: [i64; 2]) -> [f32; 2] {
    let vector = in_mm(vector);
    let length = length(vector);
    if length > 0.0 { vector.map(|part| part / length) } else { [0.0; 2] }
}

impl<const N: usize> SplineGeometry<N> {
    #[inline(never)]
    fn polygon(&self) -> Polygon {
        let in_plane =
            |place: &PerAxis<Coordinate, N>| [Axis::X, Axis::Y].map(|axis| place.get(axis).map_or(0, |c| c.0));
        let end = minus(in_plane(&self.target), in_plane(&self.start));
        let [x, y] = end;
        let [arriving_x, arriving_y] = self.arriving;
        Polygon([self.leaving.map(|part| part.0), [x + arriving_x.0, y + arriving_y.0], end])
    }

    /// Length of the way, in mm: within half a percent, but for curves with a point.
    pub fn length(&self) -> f32 {
        self.polygon().length()
    }

    /// The least and the greatest coordinates on the curve: at its ends, and where it runs across an axis.
    #[inline(never)]
    pub fn extent(&self) -> (PerAxis<Coordinate, N>, PerAxis<Coordinate, N>) {
        let mut least = self.start.zip(&self.target, |a, b| a.min(b));
        let mut greatest = self.start.zip(&self.target, |a, b| a.max(b));
        let polygon = self.polygon();
        for (index, axis) in [Axis::X, Axis::Y].into_iter().enumerate() {
            let of = |[x, y]: [i64; 2]| if index == 0 { x } else { y };
            let start = self.start.get(axis).unwrap_or(Coordinate::ZERO);
            for share in Polygon::turning_points(polygon.sides().map(|side| Coordinate(of(side)).to_mm())) {
                let place = start + Coordinate(of(polygon.point_at(share).0));
                least.set(axis, least.get(axis).map_or(place, |least| least.min(place)));
                greatest.set(axis, greatest.get(axis).map_or(place, |greatest| greatest.max(place)));
            }
        }
        (least, greatest)
    }
}

impl Polygon {
    /// The point at a share of the parameter, in 2^-30, and the derivative there but for a factor.
    #[inline(never)]
    fn point_at(&self, share: i32) -> ([i64; 2], [i64; 2]) {
        let [b, c, d] = self.0;
        let (ab, bc, cd) = (between([0; 2], b, share), between(b, c, share), between(c, d, share));
        let (abc, bcd) = (between(ab, bc, share), between(bc, cd, share));
        (between(abc, bcd, share), minus(bcd, abc))
    }

    /// The sides.
    fn sides(&self) -> [[i64; 2]; 3] {
        let [b, c, d] = self.0;
        [b, minus(c, b), minus(d, c)]
    }

    /// Where the derivative along an axis is zero, as shares of the parameter.
    ///
    /// The derivative is quadratic: p·(1-t)² + 2·q·t·(1-t) + r·t² with the sides p, q, r. Near an extremum the coordinate
    /// changes with the square of an error of t: what f32 leaves in t, 1e-6, is nothing.
    #[inline(never)]
    fn turning_points([p, q, r]: [f32; 3]) -> [i32; 2] {
        let (square, half_linear) = (p - 2.0 * q + r, q - p);
        let root = square_root((q * q - p * r).max(0.0));
        // The two roots without a difference of nearly equal numbers.
        let sum = if half_linear < 0.0 { root - half_linear } else { -root - half_linear };
        [sum / square, p / sum].map(|share| {
            // A root that does not exist is no number, or lies outside: an end of the curve takes its place.
            if share > 0.0 && share < 1.0 { (share * UNIT as f32) as i32 } else { 0 }
        })
    }

    /// The greatest second derivative divided by 6, mm.
    fn bend(&self) -> f32 {
        let [p, q, r] = self.sides();
        length(in_mm(minus(q, p))).max(length(in_mm(minus(r, q))))
    }

    #[inline(never)]
    fn length(&self) -> f32 {
        /// Distance of the outer two of Gauss's three points from the middle of a piece of length 1.
        const OUTER: f32 = 0.387_298_35;
        let [p, q, r] = self.sides().map(in_mm);
        let speed = |t: f32| {
            let s = 1.0 - t;
            let along = |p: f32, q: f32, r: f32| p * s * s + 2.0 * q * s * t + r * t * t;
            length([along(p[0], q[0], r[0]), along(p[1], q[1], r[1])])
        };
        let step = 1.0 / f32::from(PIECES);
        let mut sum = 0.0;
        for piece in 0..PIECES {
            let at = |share: f32| speed((f32::from(piece) + share) * step);
            sum += 5.0 * (at(0.5 - OUTER) + at(0.5 + OUTER)) + 8.0 * at(0.5);
        }
        // Weights of 18; the derivative is three times what the sides give.
        sum * step / 6.0
    }
}

impl<const N: usize> Spline<N> {
    /// Prepares the chords, none of which leaves the curve by more than `tolerance` (mm).
    #[inline(never)]
    pub fn new(geometry: &SplineGeometry<N>, tolerance: f32) -> Self {
        let polygon = geometry.polygon();
        let bend = polygon.bend();
        // 6·bend·h²/8 with h = 1 / chords. Places are bounded, so they are less than 2^20.
        let tolerance = tolerance.max(LEAST_TOLERANCE);
        let chords = libm::ceilf(square_root(0.75 * bend / tolerance)) as u32;
        let fewest = if bend > LEAST_TOLERANCE { FEWEST } else { 1 };
        Self {
            start: geometry.start,
            target: geometry.target,
            polygon,
            chords: chords.max(fewest),
            done: 0,
            last: [0; 2],
            tangent: unit(polygon.point_at(0).1),
            curve_radius: f32::INFINITY,
        }
    }

    /// Where the next chord ends; `None` after the last.
    #[inline(never)]
    pub fn next_chord(&mut self) -> Option<PerAxis<Coordinate, N>> {
        if !FULL_IMAGE || self.done >= self.chords {
            return None;
        }
        self.done += 1;
        let share = (u64::from(self.done) << UNIT_BITS) / u64::from(self.chords);
        let (point, derivative) = self.polygon.point_at(share as i32);
        let tangent = unit(derivative);
        let turn = length([tangent[0] - self.tangent[0], tangent[1] - self.tangent[1]]);
        let has_both = tangent != [0.0; 2] && self.tangent != [0.0; 2];
        // Where the curve comes to a point and has no direction, the corner of the chords says how fast.
        self.curve_radius =
            if has_both && turn > STRAIGHT { length(in_mm(minus(point, self.last))) / turn } else { f32::INFINITY };
        (self.last, self.tangent) = (point, tangent);
        if self.done == self.chords {
            return Some(self.target);
        }
        let mut place = self.start;
        for (axis, part) in [Axis::X, Axis::Y].into_iter().zip(point) {
            place.set(axis, place.get(axis).unwrap_or(Coordinate::ZERO) + Coordinate(part));
        }
        Some(place)
    }

    /// How the curve bends along the last chord.
    pub fn curvature(&self) -> Curvature {
        Curvature { radius: self.curve_radius, axes: [Axis::X, Axis::Y] }
    }
}
