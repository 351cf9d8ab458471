//! The speed at a corner (junction deviation, `$11`): how fast the machine can pass from one direction to another
//! within the axes' accelerations. [`super::curvature`] derives the rule and applies it to the whole path.
//!
//! Notation: for a turn by the angle t, q = 2·sin(t/2) (length of the difference of the unit vectors) and s = cos(t/2).
//! In names, `turn2` is q² and `half_cosine` is s. In Grbl's formula, s is the sine of half the angle π - t between the
//! two pieces of the path.

use super::trapezoid::{greater, lesser, square_root};

/// Speed² of a corner that sets no limit of its own.
pub(super) const UNLIMITED2: f32 = 1.0e30;
/// Speed² of a square corner, divided by acceleration and deviation: s / (1 - s) with s = √(1/2).
pub(super) const SQUARE_CORNER: f32 = 2.414_213_6;
/// Noise (the angle that rounding of coordinates can cause) is neglected if it is less than this share of the turn.
const CERTAIN: f32 = 1.0 / 64.0;
/// q² below which a path counts as straight; it equals Grbl's limit, a cosine of 0.999999.
const STRAIGHT: f32 = 2.0e-6;
/// q² above which a move counts as a reversal.
pub(super) const REVERSAL: f32 = 4.0 - 2.0e-6;
/// q² from which a turn (162 degrees or more) is so near to a reversal that its tangent is undefined.
const NO_TANGENT: f32 = 3.9;

/// Safety factor for the speed² of a bend. It is used in the quick checks that skip a limit, so that rounding errors
/// cannot make them skip too much. Example of such an error: if unit vectors are off by their last bit, the normal and
/// the tangent of a turn of q² = [`STRAIGHT`] are perpendicular only within 0.0007.
pub(super) const BEND_MARGIN: f32 = 0.99;

/// Settings of the machine for the rule for turns.
#[derive(Clone, Copy, Debug)]
pub(super) struct TurnRule<const N: usize> {
    /// Maximum acceleration of each axis, mm/s².
    pub acceleration: [f32; N],
    /// The minimum of `acceleration`, mm/s².
    pub least: f32,
    /// Upper bound of the acceleration along any path: that of a path on which all axes reach their limits, mm/s².
    pub most: f32,
    /// Junction deviation, mm.
    pub deviation: f32,
    /// Share of the acceleration that bends are allowed to take.
    pub curve_share: f32,
}

/// The axes that move on at least one side of a turn.
#[derive(Clone, Copy, Debug)]
pub(super) struct MovingAxes {
    /// Lowest acceleration limit of the moving axes, mm/s².
    pub least: f32,
    /// Whether at most two axes move.
    pub are_two: bool,
}

/// Returns q² of the turn between two directions: the square of the length of the difference of the unit vectors.
#[inline]
pub(super) fn turn2<const N: usize>(before: &[f32; N], after: &[f32; N]) -> f32 {
    let mut square = 0.0;
    for (a, b) in before.iter().zip(after) {
        square += (b - a) * (b - a);
    }
    square
}

/// Returns `true` if a turn is negligible or can be explained by noise alone. `turn2`: q² of the turn; `noise`:
/// maximum angle that rounding of the coordinates can cause, rad.
#[inline]
pub(super) fn is_noise(turn2: f32, noise: f32) -> bool {
    turn2 <= noise * noise || turn2 < STRAIGHT
}

/// Returns q² and s of a turn after subtraction of the angle that noise (rounding of coordinates) can explain; `None`
/// if noise explains all of it. `turn2`: q² of the whole turn; `noise`: maximum angle of the noise, rad.
#[inline]
pub(super) fn certain(turn2: f32, noise: f32) -> Option<(f32, f32)> {
    if is_noise(turn2, noise) {
        return None;
    }
    let half_cosine = square_root(greater(1.0 - 0.25 * turn2, 0.0));
    if noise * noise <= CERTAIN * CERTAIN * turn2 {
        return Some((turn2, half_cosine));
    }
    // q and s of the turn less the angle `noise`, by the formulas for the sine and cosine of a difference.
    let noise_sine = 0.5 * noise * (1.0 - noise * noise * (1.0 / 24.0));
    let noise_cosine = 1.0 - 0.125 * noise * noise;
    let turn = square_root(turn2);
    let less = turn * noise_cosine - 2.0 * half_cosine * noise_sine;
    let less2 = less * less;
    (less > 0.0 && less2 >= STRAIGHT).then_some((less2, half_cosine * noise_cosine + 0.5 * turn * noise_sine))
}

impl<const N: usize> TurnRule<N> {
    /// Placeholder until the settings are applied.
    pub(super) const ONE: Self =
        Self { acceleration: [1.0; N], least: 1.0, most: N as f32, deviation: 0.0, curve_share: 1.0 };

    /// Creates the rule from the settings, in the units of the fields.
    pub(super) fn new(acceleration: [f32; N], deviation: f32, curve_share: f32) -> Self {
        let least = acceleration.iter().fold(UNLIMITED2, |least, own| lesser(*own, least));
        let most = square_root(acceleration.iter().fold(0.0, |sum, own| sum + own * own));
        Self { acceleration, least, most, deviation, curve_share }
    }

    /// Returns the maximum acceleration, mm/s², in the direction of the change of velocity, so that no axis exceeds
    /// its limit. `turn`: q, the length of the difference of the two unit vectors.
    #[inline(never)]
    pub(super) fn across(&self, before: &[f32; N], after: &[f32; N], turn: f32) -> f32 {
        // Finds the axis with the lowest ratio of its limit to its part of the difference. Divides only once, at the
        // end.
        let (mut least, mut least_part) = (UNLIMITED2, turn);
        for ((before, after), limit) in before.iter().zip(after).zip(&self.acceleration) {
            let part = (after - before).abs();
            if part * least > limit * least_part {
                (least, least_part) = (*limit, part);
            }
        }
        least * turn / least_part
    }

    /// Returns the acceleration a, mm/s², that the machine can have in every direction within the plane of a turn, so
    /// that no axis exceeds its limit. It limits the centripetal acceleration of a bend. At any point of the bend,
    /// axis i gets at most `a·√(n_i² + t_i²)`, where n and t are the unit vectors normal and tangential to the turn.
    /// So one limit holds for the whole bend, and the speed on a circle is constant.
    #[inline]
    pub(super) fn in_plane(&self, before: &[f32; N], after: &[f32; N], turn2: f32, moving: MovingAxes) -> f32 {
        // The plane of two axes contains both of them, so n_i² + t_i² = 1.
        if moving.are_two && turn2 < NO_TANGENT { moving.least } else { self.in_any_plane(before, after, turn2) }
    }

    #[inline(never)]
    fn in_any_plane(&self, before: &[f32; N], after: &[f32; N], turn2: f32) -> f32 {
        let normal = 1.0 / turn2;
        // On a reversal, the sum of the two directions is too short to define the tangent, so only the normal is used.
        // The path is also measured in shorter spans. The turns between those are smaller, so their limits include the
        // tangent.
        let tangent = if turn2 < NO_TANGENT { 1.0 / (4.0 - turn2) } else { 0.0 };
        // Finds the axis with the lowest ratio of limit to share, as in `across`.
        let (mut least2, mut least_share2) = (UNLIMITED2, 1.0);
        for ((a, b), limit) in before.iter().zip(after).zip(&self.acceleration) {
            let (difference, sum) = (b - a, b + a);
            let share2 = difference * difference * normal + sum * sum * tangent;
            if share2 * least2 > limit * limit * least_share2 {
                (least2, least_share2) = (limit * limit, share2);
            }
        }
        square_root(least2 / least_share2)
    }

    /// Returns the axes that move on at least one side of a turn, in the direction `before` or `after`.
    #[inline]
    pub(super) fn moving(&self, before: &[f32; N], after: &[f32; N]) -> MovingAxes {
        let (mut least, mut count) = (UNLIMITED2, 0);
        for ((before, after), limit) in before.iter().zip(after).zip(&self.acceleration) {
            // The shift drops the sign, so that -0.0 counts as 0.
            if (before.to_bits() | after.to_bits()) << 1 != 0 {
                least = lesser(*limit, least);
                count += 1;
            }
        }
        MovingAxes { least, are_two: count <= 2 }
    }

    /// Returns `true` if a bend that makes this turn within `length`, mm, certainly allows more than the speed²
    /// `fast2`. Compares squares, without division or square root. `least`: lower bound of [`TurnRule::in_plane`];
    /// `half_cosine`: lower bound of s.
    #[inline]
    pub(super) fn is_surely_faster(&self, least: f32, length: f32, turn2: f32, half_cosine: f32, fast2: f32) -> bool {
        let bend = BEND_MARGIN * least * self.curve_share * length * (2.0 + half_cosine);
        bend * bend > 9.0 * turn2 * fast2 * fast2
    }

    /// Returns J² of a turn, the square of the speed that the junction deviation allows (junction velocity). With the
    /// acceleration a ([`TurnRule::across`], mm/s²) and the junction deviation d (mm), J² is a·d·s / (1 - s). For
    /// gentle turns, 1 - s would be an inexact difference of nearly equal numbers. The code uses q² / (4·(1 + s))
    /// instead, which is equal to 1 - s, because q² = 4·(1 - s²).
    #[inline]
    pub(super) fn junction2(&self, across: f32, half_cosine: f32, turn2: f32) -> f32 {
        across * self.deviation * half_cosine * (1.0 + half_cosine) / (0.25 * turn2)
    }

    /// Returns a speed² that a square corner between any two axes allows. It is computed with the lowest acceleration
    /// of all axes.
    #[inline]
    pub(super) fn square_corner2(&self) -> f32 {
        self.least * self.deviation * SQUARE_CORNER
    }
}

/// Returns how much the speed² (mm²/s²) of a machine can rise while it speeds up with `acceleration` (mm/s²) over
/// `length` (mm). Includes a margin of 1 % for rounding.
#[inline]
pub(super) fn rise2(acceleration: f32, length: f32) -> f32 {
    2.02 * acceleration * length
}

/// Returns the radius of a bend per unit of its length: 1/t. The angle t = 3·q / (2 + s) is correct within 0.2 % up to
/// a right angle and within 5 % up to half a turn (Shafer's approximation of the arc tangent).
#[inline]
pub(super) fn radius_of(turn2: f32, half_cosine: f32) -> f32 {
    (2.0 + half_cosine) / (3.0 * square_root(turn2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rule() -> TurnRule<2> {
        TurnRule::new([500.0, 100.0], 0.01, 1.0)
    }

    #[test]
    fn a_square_corner_has_the_speed_of_its_deviation() {
        let (before, after) = ([1.0, 0.0], [0.0, 1.0]);
        let all2 = turn2(&before, &after);
        let (certain2, half_cosine) = certain(all2, 0.0).unwrap();
        assert!((certain2 - 2.0).abs() < 1e-6 && (half_cosine - 0.5_f32.sqrt()).abs() < 1e-6);
        // Each axis gets 0.71 of the change of direction.
        let across = rule().across(&before, &after, all2.sqrt());
        assert!((across - 100.0 * 2.0_f32.sqrt()).abs() < 1e-3, "{across}");
        let speed2 = rule().junction2(100.0, half_cosine, certain2);
        assert!((speed2 / rule().square_corner2() - 1.0).abs() < 1e-5, "{speed2}");
    }

    #[test]
    fn what_rounding_explains_is_no_turn() {
        assert_eq!(certain(1.0e-6, 0.0), None);
        assert_eq!(certain(0.01, 0.1), None);
        let (less2, half_cosine) = certain(0.01, 0.05).unwrap();
        // An angle of 0.1 rad, less 0.05 rad of noise.
        assert!(
            (less2.sqrt() - 0.05).abs() < 1e-4 && (half_cosine - 0.025_f32.cos()).abs() < 1e-4,
            "{less2} {half_cosine}"
        );
    }

    #[test]
    fn a_bend_is_as_long_as_its_angle_times_its_radius() {
        for (angle, within) in [(0.01_f32, 0.002), (1.0, 0.002), (1.57, 0.0025), (3.1, 0.05)] {
            let (half_sine, half_cosine) = (0.5 * angle).sin_cos();
            let radius = radius_of(4.0 * half_sine * half_sine, half_cosine);
            assert!((radius * angle - 1.0).abs() < within, "{angle}: {radius}");
        }
    }
}
