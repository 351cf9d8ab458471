//! An arc or helix as a chain of chords, computed one at a time. Centre, radius and sweep are computed from exact
//! integers. From chord to chord, a direction vector in 2^-30 fixed point is rotated and brought back to length 1. Each
//! full turn starts with the exact direction again, so the error does not grow over many turns.

use super::trapezoid::square_root;
use crate::axes::{Axis, PerAxis};
use crate::units::{Coordinate, integer_root, wide_to_f32};

/// Fraction bits of the direction vector.
pub(super) const UNIT_BITS: u32 = 30;
pub(super) const UNIT: i64 = 1 << UNIT_BITS;
/// Maximum angle, rad, between start and end of an arc that counts as a full circle, as in Grbl.
const FULL_CIRCLE: f32 = 5.0e-7;
const TURN: f32 = core::f32::consts::TAU;
/// Maximum half angle of a chord (45 degrees), even if the tolerance allows more, so that tiny circles stay round.
const WIDEST: f32 = core::f32::consts::FRAC_PI_4;
/// Minimum tolerance, mm: below it, chords would be shorter than machines can follow.
pub(super) const LEAST_TOLERANCE: f32 = 0.0001;
/// Maximum number of chords in a turn: an f32 can count that far exactly.
const MOST_CHORDS: f32 = 16_000_000.0;

/// How sharply a curve bends along one of its chords, and in which plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Radius of the curve in space, mm; infinite if it is straight or unknown.
    pub radius: f32,
    /// The axes of the plane in which the curve turns.
    pub axes: [Axis; 2],
}

/// An arc in a plane. Other axes move proportionally to the arc's length.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ArcGeometry<const N: usize> {
    /// Start, machine coordinates.
    pub start: PerAxis<Coordinate, N>,
    /// End, machine coordinates.
    pub target: PerAxis<Coordinate, N>,
    /// First axis of the plane; counter-clockwise is from `axis_0` towards `axis_1`.
    pub axis_0: Axis,
    /// Second axis of the plane.
    pub axis_1: Axis,
    /// Distance from the start to the centre along `axis_0`.
    pub offset_0: Coordinate,
    /// Distance from the start to the centre along `axis_1`.
    pub offset_1: Coordinate,
    /// `true`: the arc turns clockwise, from `axis_1` towards `axis_0`.
    pub clockwise: bool,
    /// Number of full turns at the beginning of the arc. The rest, of at most one turn, is called the plain arc.
    pub turns: u32,
}

/// The chords of an arc, in order.
#[derive(Clone, Debug)]
pub struct Arc<const N: usize> {
    geometry: ArcGeometry<N>,
    centre: [Coordinate; 2],
    /// Direction from the centre to the start of the arc. Each full turn ends in this direction, too.
    first: [i32; 2],
    /// Direction from the centre to the end of the previous chord.
    unit: [i32; 2],
    /// Sine of a chord's angle (signed), in fixed point with `turn_bits` fraction bits. A smaller angle leaves room for
    /// more fraction bits, so that the sum of thousands of tiny angles is exact enough.
    sine: i32,
    /// 1 - cosine of a chord's angle, in the same fixed point.
    versine: i32,
    turn_bits: u32,
    start_radius: i64,
    radius_change: f32,
    length: f32,
    /// Radius of the curve in space, mm. On a helix it exceeds the radius of the circle. Infinite for a single chord.
    curve_radius: f32,
    /// Number of chords in each full turn before the plain arc.
    chords_of_turn: u32,
    /// Number of chords in the plain arc.
    chords: u32,
    /// Number of full turns left, including the present one.
    turns_left: u32,
    /// Angle of a full turn, divided by the angle of the whole arc.
    turn_share: f32,
    /// Angle of the plain arc, rad.
    sweep: f32,
    /// Number of chords in the present full turn. After the full turns: number of chords in the plain arc.
    present: u32,
    /// Number of chords completed in the present turn, or in the plain arc.
    done: u32,
    /// Part of the whole arc, 0 to 1, before the present turn.
    share_before: f32,
    /// Part of the whole arc, 0 to 1, that one chord of the present turn, or of the plain arc, covers.
    share: f32,
}

/// Returns the length of an integer vector, rounded down from the exact value.
#[inline(never)]
pub(super) fn integer_length(x: i64, y: i64) -> i64 {
    let square = u128::from(x.unsigned_abs()).pow(2) + u128::from(y.unsigned_abs()).pow(2);
    integer_root(square) as i64
}

/// Returns `value` × `unit` (2^-30 fixed point), rounded to nearest.
#[inline]
pub(super) fn scale(value: i64, unit: i32) -> i64 {
    // Both halves of the value are multiplied separately, so no product exceeds 64 bits. The upper product is only
    // shifted left, so it needs no rounding.
    let (upper, lower) = ((value >> 32) as i32, value as u32);
    (product(upper, unit) << (32 - UNIT_BITS)) + ((i64::from(lower) * i64::from(unit) + UNIT / 2) >> UNIT_BITS)
}

/// Converts to an integer, truncating towards zero. Most values take the 32-bit conversion, which is one instruction.
#[inline]
fn whole(value: f32) -> i64 {
    #[inline(never)]
    fn far(value: f32) -> i64 {
        value as i64
    }
    if value.abs() < 2.0e9 { i64::from(value as i32) } else { far(value) }
}

/// Returns the 64-bit product, in one instruction.
#[inline]
fn product(a: i32, b: i32) -> i64 {
    i64::from(a) * i64::from(b)
}

#[inline(never)]
fn direction(x: i64, y: i64, length: i64) -> [i32; 2] {
    if length == 0 {
        return [UNIT as i32, 0];
    }
    let part = |value: i64| ((i128::from(value) << UNIT_BITS) / i128::from(length)) as i32;
    [part(x), part(y)]
}

/// The plain arc, which is the arc without its full turns: centre, direction to the start, radii at both ends, and
/// signed angle.
struct Plain {
    centre: [Coordinate; 2],
    first: [i32; 2],
    start_radius: i64,
    end_radius: i64,
    sweep: f32,
}

/// Returns the sine of an angle in rad. An angle above 90 degrees counts as 90 degrees.
///
/// Computed in integers, because the sine of `libm` takes 5 KB of flash and computes in `f64`, which these processors
/// emulate in software.
#[inline(never)]
fn sine(angle: f32) -> f32 {
    const QUARTER_BITS: u32 = core::f32::consts::FRAC_PI_2.to_bits();
    /// Fraction bits of x² (`square`) and of sin x / x (`factor`).
    const BITS: u32 = 61;
    const ONE: u64 = 1 << BITS;
    /// Fraction bits of the factor in the last multiplication. With more bits, the product of the factor and the
    /// mantissa would be too large for an `i64`.
    const FACTOR_BITS: u32 = 39;
    let product = |a: u64, b: u64| ((u128::from(a) * u128::from(b)) >> BITS) as u64;
    let bits = angle.abs().to_bits().min(QUARTER_BITS);
    // The angle is mantissa / 2^shift.
    let (mantissa, shift) = (u64::from(bits & 0x7F_FFFF | 0x80_0000), 150 - (bits >> 23));
    let square = mantissa * mantissa;
    let square = if 2 * shift <= BITS {
        square << (BITS - 2 * shift)
    } else {
        square.checked_shr(2 * shift - BITS).unwrap_or(0)
    };
    // sin x / x = 1 - x²/(2·3)·(1 - x²/(4·5)·(1 - ...)); the last term is below 2^-40 of the whole.
    let mut factor = ONE;
    for n in [14, 12, 10, 8, 6, 4, 2_u64] {
        factor = ONE - product(square, factor) / (n * (n + 1));
    }
    // The mantissa has 24 bits, the factor 39. Their exact product is rounded only once, to the 24 bits of the result.
    let exact = mantissa * (factor >> (BITS - FACTOR_BITS));
    let scale = f32::from_bits((127 - FACTOR_BITS).saturating_sub(shift) << 23);
    (wide_to_f32(exact as i64) * scale).copysign(angle)
}

impl<const N: usize> ArcGeometry<N> {
    #[inline(never)]
    fn plain(&self) -> Plain {
        let of = |place: &PerAxis<Coordinate, N>, axis| place.get(axis).unwrap_or(Coordinate::ZERO);
        let start = [of(&self.start, self.axis_0), of(&self.start, self.axis_1)];
        let target = [of(&self.target, self.axis_0), of(&self.target, self.axis_1)];
        let centre = [start[0] + self.offset_0, start[1] + self.offset_1];
        let from = [start[0] - centre[0], start[1] - centre[1]];
        let to = [target[0] - centre[0], target[1] - centre[1]];
        let start_radius = integer_length(from[0].0, from[1].0);
        let end_radius = integer_length(to[0].0, to[1].0);
        let first = direction(from[0].0, from[1].0, start_radius);
        let last = direction(to[0].0, to[1].0, end_radius);
        // Each product is at most 2^60, so the sum of two products is at most 2^61 and fits an `i64`.
        let cross = (product(first[0], last[1]) - product(first[1], last[0])) as f32;
        let dot = (product(first[0], last[0]) + product(first[1], last[1])) as f32;
        let mut sweep = libm::atan2f(cross, dot);
        if self.clockwise {
            if sweep >= -FULL_CIRCLE {
                sweep -= TURN;
            }
        } else if sweep <= FULL_CIRCLE {
            sweep += TURN;
        }
        Plain { centre, first, start_radius, end_radius, sweep }
    }

    /// Returns the angle of the plain arc (without the full turns), rad: above 0, at most one turn.
    pub(super) fn sweep(&self) -> f32 {
        self.plain().sweep.abs()
    }
}

impl<const N: usize> Arc<N> {
    /// Prepares the chords (Grbl: arc segments) of an arc. Their number is such that no chord deviates from the arc by
    /// more than `tolerance` (`$12`, mm).
    pub fn new(geometry: &ArcGeometry<N>, tolerance: f32) -> Self {
        let of = |place: &PerAxis<Coordinate, N>, axis| place.get(axis).unwrap_or(Coordinate::ZERO);
        let Plain { centre, first, start_radius, end_radius, sweep } = geometry.plain();
        let turns = geometry.turns as f32 * TURN;
        let angle = if geometry.clockwise { sweep - turns } else { sweep + turns };

        // A chord with half angle h deviates from an arc of radius r by r·(1 - cos h). `half` is the h for which this
        // deviation equals the tolerance.
        let radius = Coordinate(start_radius.max(end_radius)).to_mm();
        let tolerance = tolerance.max(LEAST_TOLERANCE);
        let half = if tolerance < radius {
            libm::atan2f(square_root(tolerance * (2.0 * radius - tolerance)), radius - tolerance).min(WIDEST)
        } else {
            WIDEST
        };
        let count = |angle: f32| {
            let count = libm::ceilf(angle.abs() / (2.0 * half)).min(MOST_CHORDS);
            if start_radius == 0 || end_radius == 0 { 1 } else { (count as u32).max(1) }
        };
        let chords = count(sweep);

        let mut square = 0.0;
        for axis in Axis::of_machine::<N>() {
            let way = if axis == geometry.axis_0 || axis == geometry.axis_1 {
                0.0
            } else {
                (of(&geometry.target, axis) - of(&geometry.start, axis)).to_mm()
            };
            square += way * way;
        }
        let mean_radius = 0.5 * Coordinate(start_radius.saturating_add(end_radius)).to_mm();
        let along = mean_radius * angle;
        let length = square_root(square + along * along);
        // A helix of radius r bends like a circle of radius r·(length / length in the plane)².
        let stretch = if along == 0.0 { 1.0 } else { length / along };
        let single = chords == 1 && geometry.turns == 0;
        let mut arc = Self {
            geometry: *geometry,
            centre,
            first,
            unit: first,
            sine: 0,
            versine: 0,
            turn_bits: UNIT_BITS,
            start_radius,
            radius_change: (end_radius - start_radius) as f32,
            length,
            curve_radius: if single { f32::INFINITY } else { mean_radius * stretch * stretch },
            chords_of_turn: count(TURN),
            chords,
            turns_left: geometry.turns,
            turn_share: TURN / angle.abs(),
            sweep,
            present: 0,
            done: 0,
            share_before: 0.0,
            share: 0.0,
        };
        arc.begin_turn();
        arc
    }

    /// Begins the next full turn, or the plain arc.
    #[inline(never)]
    fn begin_turn(&mut self) {
        self.unit = self.first;
        self.done = 0;
        self.share_before = (self.geometry.turns - self.turns_left) as f32 * self.turn_share;
        let (angle, chords, span) = match self.turns_left {
            0 => (self.sweep, self.chords, 1.0 - self.share_before),
            _ => (TURN.copysign(self.sweep), self.chords_of_turn, self.turn_share),
        };
        self.present = chords;
        self.share = span / chords as f32;
        let step = angle / chords as f32;
        let half_sine = sine(0.5 * step);
        let mut turn_bits = UNIT_BITS;
        let mut magnified = step.abs();
        while magnified < 0.5 && turn_bits < 2 * UNIT_BITS {
            magnified *= 2.0;
            turn_bits += 1;
        }
        let one = (1_u64 << turn_bits) as f32;
        self.sine = (sine(step) * one) as i32;
        self.versine = (2.0 * half_sine * half_sine * one) as i32;
        self.turn_bits = turn_bits;
    }

    /// Returns the end of the next chord; `None` after the last one.
    pub fn next_chord(&mut self) -> Option<PerAxis<Coordinate, N>> {
        if self.done >= self.present {
            return None;
        }
        self.done += 1;
        let share = self.share_before + self.done as f32 * self.share;
        if self.done < self.present {
            self.turn();
        } else if self.turns_left == 0 {
            return Some(self.geometry.target);
        } else {
            // Each turn restarts at the exact direction, so errors of the angle do not add up.
            self.turns_left -= 1;
            self.begin_turn();
        }
        Some(self.point(share))
    }

    /// Rotates the direction from the centre (`self.unit`) by one chord.
    #[inline(always)]
    fn turn(&mut self) {
        let [x, y] = self.unit;
        // Why the result fits in 32 bits: the vector has length 1, and a chord spans 90 degrees at most, so the chord
        // is at most √2 long. Each sum of products below (in 2^-60 fixed point) is then at most 2^60 × √2. With `half`
        // added it stays below 2^61.
        let beyond = self.turn_bits - UNIT_BITS;
        let half = i64::from(1_u32 << beyond) << (UNIT_BITS - 1);
        let rounded = |sum: i64| ((sum + half) >> UNIT_BITS) as i32 >> beyond;
        let x_turned = x - rounded(product(x, self.versine) + product(y, self.sine));
        let y_turned = y + rounded(product(x, self.sine) - product(y, self.versine));
        // Corrects the length to 1 by one Newton step. `excess` is about the length minus 1.
        let square = product(x_turned, x_turned) + product(y_turned, y_turned);
        let excess = ((square - UNIT * UNIT) >> (UNIT_BITS + 1)) as i32;
        let share = |part: i32| ((product(part, excess) + UNIT / 2) >> UNIT_BITS) as i32;
        self.unit = [x_turned - share(x_turned), y_turned - share(y_turned)];
    }

    /// Returns the point of the arc in the direction `unit` from the centre. `share`: part of the whole arc before this
    /// point, 0 to 1. It determines the radius (on a spiral) and the positions of the other axes.
    #[inline(always)]
    fn point(&self, share: f32) -> PerAxis<Coordinate, N> {
        let [x, y] = self.unit;
        let radius = self.start_radius + whole(self.radius_change * share);
        let mut point = self.geometry.start;
        for (axis, (place, target)) in Axis::of_machine::<N>().zip(point.iter_mut().zip(self.geometry.target.iter())) {
            *place = if axis == self.geometry.axis_0 {
                self.centre[0] + Coordinate(scale(radius, x))
            } else if axis == self.geometry.axis_1 {
                self.centre[1] + Coordinate(scale(radius, y))
            } else if target == place {
                *place
            } else {
                *place + Coordinate(whole(wide_to_f32((*target - *place).0) * share))
            };
        }
        point
    }

    /// Returns the length of the whole arc, mm.
    pub fn length(&self) -> f32 {
        self.length
    }

    /// Returns the length of the arc in all axes (a degree counts as a millimetre), divided by its length in X, Y and
    /// Z. At least 1; 1 if no rotary axis moves.
    pub fn rotary_stretch(&self) -> f32 {
        let (mut linear, mut rotary) = (0.0, 0.0);
        let ways = self.geometry.target.zip(&self.geometry.start, |to, from| (to - from).to_mm());
        for (axis, way) in Axis::ALL.into_iter().zip(ways.iter()) {
            if axis.is_rotary() {
                rotary += way * way;
            } else if axis != self.geometry.axis_0 && axis != self.geometry.axis_1 {
                linear += way * way;
            }
        }
        if rotary == 0.0 {
            return 1.0;
        }
        let angle = self.sweep.abs() + self.geometry.turns as f32 * TURN;
        let end_radius = Coordinate(self.start_radius + whole(self.radius_change));
        let along = 0.5 * (Coordinate(self.start_radius).to_mm() + end_radius.to_mm()) * angle;
        square_root(1.0 + rotary / (linear + along * along))
    }

    /// Returns the number of chords left, including the chords of full turns.
    pub fn chords_left(&self) -> u64 {
        u64::from(self.turns_left) * u64::from(self.chords_of_turn) + u64::from(self.chords) - u64::from(self.done)
    }

    /// Returns the curvature in space. On a helix, its radius is greater than the radius of the circle. On a spiral,
    /// its radius is the mean of the radii at both ends. If the arc has only one chord, the radius is infinite.
    pub fn curvature(&self) -> Curvature {
        Curvature { radius: self.curve_radius, axes: [self.geometry.axis_0, self.geometry.axis_1] }
    }

    /// Returns the radius at the start, mm.
    pub fn radius(&self) -> f32 {
        Coordinate(self.start_radius).to_mm()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn the_sine_is_that_of_f64(angle in prop_oneof![-WIDEST * 2.0..WIDEST * 2.0, -1.0e-3_f32..1.0e-3, -1.0e-7_f32..1.0e-7]) {
            let exact = f64::from(angle).sin() as f32;
            // Before its only rounding, `sine` has a relative error of about 2^-39. If the exact sine is almost midway
            // between two neighbouring `f32` values, this error can make `sine` round to the other one.
            prop_assert!(sine(angle).to_bits().abs_diff(exact.to_bits()) <= 1, "{angle}: {} {exact}", sine(angle));
        }

        #[test]
        fn scaled_as_by_the_wide_product(value: i64, bits in 22_u32..64, unit in -(UNIT as i32)..=UNIT as i32) {
            let value = value >> bits;
            let wide = ((i128::from(value) * i128::from(unit) + i128::from(UNIT / 2)) >> UNIT_BITS) as i64;
            prop_assert_eq!(scale(value, unit), wide);
        }
    }
}
