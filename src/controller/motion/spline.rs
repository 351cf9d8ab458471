//! Divides a cubic Bezier curve in X and Y (G5, G5.1) into chords, which are straight moves between points of the
//! curve. Also computes the length, curvature and extent of the curve.
//!
//! ```text
//!        b ── ── c
//!       ╱  .──.   ╲
//!      ╱ .'    '.  ╲       control points a to d, and the curve
//!     ╱.'        '. ╲
//!    a'            'd
//! ```
//! De Casteljau's rule finds the point at a parameter t (0 to 1). The sides of the polygon a b c d are divided at the
//! share t, which gives three points. The two lines between these points are divided at t, which gives two points.
//! The line between these two points is divided at t, too: this last point lies on the curve, and the last line is
//! the tangent there.
//!
//! Coordinates are whole numbers of 0.1 nm. A result is rounded only in the divisions, which are made three times in a
//! row. So a point lies within 0.2 nm of the curve, for any number of chords.
//!
//! The number of chords follows from the tolerance. A chord over a parameter step h deviates from the curve by at
//! most |second derivative|·h²/8. The second derivative has its maximum at an end of the curve. The last chord ends
//! exactly at the target.

use super::arc::{Curvature, LEAST_TOLERANCE, UNIT, UNIT_BITS, scale};
use super::trapezoid::square_root;
use crate::axes::{Axis, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::Coordinate;

/// Minimum number of chords of a curve that is not straight. With fewer chords, a tiny curve would stay within the
/// tolerance but lose its shape.
const FEWEST: u32 = 4;
/// The length is integrated over this many pieces of the curve, with three points in each piece.
const PIECES: u8 = 16;
/// Difference below which two unit vectors count as one direction: an f32 cannot resolve less.
const STRAIGHT: f32 = 1.0e-6;

/// Ends and control points of a cubic Bezier curve. Axes other than X and Y do not move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SplineGeometry<const N: usize> {
    /// Start, machine coordinates.
    pub start: PerAxis<Coordinate, N>,
    /// End, machine coordinates.
    pub target: PerAxis<Coordinate, N>,
    /// First control point, in X and Y, relative to the start.
    pub leaving: [Coordinate; 2],
    /// Second control point, in X and Y, relative to the target.
    pub arriving: [Coordinate; 2],
}

/// The chords of a Bezier curve, computed one after the other.
#[derive(Clone, Debug)]
pub struct Spline<const N: usize> {
    start: PerAxis<Coordinate, N>,
    target: PerAxis<Coordinate, N>,
    /// Control points relative to the start.
    polygon: Polygon,
    chords: u32,
    done: u32,
    /// End of the previous chord, relative to the start.
    last: [i64; 2],
    /// Direction of the curve at the end of the previous chord; the zero vector if the curve has no direction there.
    tangent: [f32; 2],
    curve_radius: f32,
}

/// The second to fourth control points relative to the first, which is the start.
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

    /// Returns the length of the curve, mm, within half a percent, except for curves with a cusp.
    pub fn length(&self) -> f32 {
        self.polygon().length()
    }

    /// Returns the minimum and the maximum coordinate of each axis on the curve. They lie at an end of the curve, or
    /// where the curve runs perpendicular to the axis.
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
    /// Returns the point at the parameter `share` / 2^30, and a third of the derivative there.
    #[inline(never)]
    fn point_at(&self, share: i32) -> ([i64; 2], [i64; 2]) {
        let [b, c, d] = self.0;
        let (ab, bc, cd) = (between([0; 2], b, share), between(b, c, share), between(c, d, share));
        let (abc, bcd) = (between(ab, bc, share), between(bc, cd, share));
        (between(abc, bcd, share), minus(bcd, abc))
    }

    fn sides(&self) -> [[i64; 2]; 3] {
        let [b, c, d] = self.0;
        [b, minus(c, b), minus(d, c)]
    }

    /// Returns the parameters at which the derivative along an axis is zero.
    ///
    /// A third of the derivative is p·(1-t)² + 2·q·t·(1-t) + r·t². Here p, q and r are the sides of the polygon along
    /// the axis, in mm. The f32 error of t is about 1e-6. It is negligible, because near an extremum the coordinate
    /// changes only with the square of this error.
    #[inline(never)]
    fn turning_points([p, q, r]: [f32; 3]) -> [i32; 2] {
        let (square, half_linear) = (p - 2.0 * q + r, q - p);
        let root = square_root((q * q - p * r).max(0.0));
        // Computes both roots without subtracting nearly equal numbers.
        let sum = if half_linear < 0.0 { root - half_linear } else { -root - half_linear };
        [sum / square, p / sum].map(|share| {
            // A missing root is NaN or out of range. The parameter 0, the start of the curve, replaces it.
            if share > 0.0 && share < 1.0 { (share * UNIT as f32) as i32 } else { 0 }
        })
    }

    /// Returns the maximum second derivative divided by 6, mm.
    fn bend(&self) -> f32 {
        let [p, q, r] = self.sides();
        length(in_mm(minus(q, p))).max(length(in_mm(minus(r, q))))
    }

    #[inline(never)]
    fn length(&self) -> f32 {
        /// Three-point Gauss quadrature: distance of each outer point from the middle of a piece of length 1.
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
        // The weights 5, 8 and 5 add up to 18, and `speed` is a third of the derivative. So the factor is 3/18 = 1/6.
        sum * step / 6.0
    }
}

impl<const N: usize> Spline<N> {
    /// Prepares the chords. No chord deviates from the curve by more than `tolerance` (mm).
    #[inline(never)]
    pub fn new(geometry: &SplineGeometry<N>, tolerance: f32) -> Self {
        let polygon = geometry.polygon();
        let bend = polygon.bend();
        // A chord deviates from the curve by 6·bend·h²/8, where h = 1 / chords is its parameter step. Coordinates are
        // bounded, so there are less than 2^20 chords.
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

    /// Returns the end of the next chord; `None` after the last one.
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
        // At a cusp the curve has no direction; there the corner between the chords limits the speed.
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

    /// Returns the curvature along the chord that `next_chord` returned last.
    pub fn curvature(&self) -> Curvature {
        Curvature { radius: self.curve_radius, axes: [Axis::X, Axis::Y] }
    }
}
