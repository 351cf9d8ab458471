//! The speed at a corner (junction deviation, `$11`): how fast the path may turn from one direction to another within
//! the axes' accelerations. [`super::curvature`] derives the rule and applies it to the whole path.

use super::trapezoid::{greater, lesser, quotient, square_root};

/// Speed² of a corner that sets no limit; the nominal speeds do.
pub(super) const UNLIMITED2: f32 = 1.0e30;
/// Speed² of a square corner by acceleration and deviation: s / (1 - s) with s = √(1/2).
pub(super) const SQUARE_CORNER: f32 = 2.414_213_6;
/// A turn of which noise can explain less than this share is taken as it is.
const CERTAIN: f32 = 1.0 / 64.0;
/// q² below which a path is straight: the cosine of 0.999999 at which Grbl stops to compute.
const STRAIGHT: f32 = 2.0e-6;
/// q² beyond which a move turns back on itself.
pub(super) const REVERSAL: f32 = 4.0 - 2.0e-6;

/// Share of a bend's speed² that rounding leaves for certain. Of unit vectors that are off by the last bit, the normal and the tangent of a
/// turn of q² = [`STRAIGHT`] are square to each other within 0.0007.
const SURELY: f32 = 0.99;

/// What the rule must know of the machine.
#[derive(Clone, Copy, Debug)]
pub(super) struct TurnRule<const N: usize> {
    /// Of each axis, mm/s².
    pub acceleration: [f32; N],
    /// Junction deviation, mm.
    pub deviation: f32,
    /// Share of the acceleration that bends may take.
    pub curve_share: f32,
}

/// q² of two unit vectors.
#[inline]
pub(super) fn turn2<const N: usize>(before: &[f32; N], after: &[f32; N]) -> f32 {
    let mut square = 0.0;
    for (a, b) in before.iter().zip(after) {
        square += (b - a) * (b - a);
    }
    square
}

/// Whether a turn is none, or may be the work of noise alone.
#[inline]
pub(super) fn is_noise(turn2: f32, noise: f32) -> bool {
    turn2 <= noise * noise || turn2 < STRAIGHT
}

/// q² and s of what noise cannot explain of a turn, from q² of all; `None` if that is nothing.
#[inline]
pub(super) fn certain(turn2: f32, noise: f32) -> Option<(f32, f32)> {
    if is_noise(turn2, noise) {
        return None;
    }
    let sine = square_root(greater(1.0 - 0.25 * turn2, 0.0));
    if noise * noise <= CERTAIN * CERTAIN * turn2 {
        return Some((turn2, sine));
    }
    // q = 2·sin(t/2) and s = cos(t/2) of an angle that is smaller by the noise.
    let half = 0.5 * noise * (1.0 - noise * noise * (1.0 / 24.0));
    let cosine = 1.0 - 0.125 * noise * noise;
    let turn = square_root(turn2);
    let less = turn * cosine - 2.0 * sine * half;
    let less2 = less * less;
    (less > 0.0 && less2 >= STRAIGHT).then_some((less2, sine * cosine + 0.5 * turn * half))
}

impl<const N: usize> TurnRule<N> {
    /// Greatest acceleration along the change of direction at which no axis exceeds its own.
    #[inline(never)]
    pub(super) fn across(&self, before: &[f32; N], after: &[f32; N], turn: f32) -> f32 {
        let mut least = UNLIMITED2;
        for ((before, after), limit) in before.iter().zip(after).zip(&self.acceleration) {
            let part = (after - before).abs();
            if part * least > limit * turn {
                least = quotient(limit * turn, part);
            }
        }
        least
    }

    /// Greatest acceleration that every axis takes in any direction of the plane of a turn: with the normal n and the
    /// tangent t, axis i gets a·√(n_i² + t_i²) at most wherever on the bend. So the speed on a circle is even.
    /// It bounds the centripetal acceleration of a bend.
    #[inline(never)]
    pub(super) fn in_plane(&self, before: &[f32; N], after: &[f32; N], turn2: f32) -> f32 {
        let normal = 1.0 / turn2;
        // Of a turn straight back only the normal is known; the shorter spans know the rest.
        let tangent = if turn2 < 3.9 { 1.0 / (4.0 - turn2) } else { 0.0 };
        let mut least2 = UNLIMITED2;
        for ((a, b), limit) in before.iter().zip(after).zip(&self.acceleration) {
            let (difference, sum) = (b - a, b + a);
            let share2 = difference * difference * normal + sum * sum * tangent;
            if share2 * least2 > limit * limit {
                least2 = quotient(limit * limit, share2);
            }
        }
        square_root(least2)
    }

    /// The least acceleration of the axes that move before or after a turn.
    #[inline]
    pub(super) fn least_of(&self, before: &[f32; N], after: &[f32; N]) -> f32 {
        let mut least = UNLIMITED2;
        for ((before, after), limit) in before.iter().zip(after).zip(&self.acceleration) {
            // Zeros of either sign.
            let moves = (before.to_bits() | after.to_bits()) << 1 != 0;
            if moves && *limit < least {
                least = *limit;
            }
        }
        least
    }

    /// Whether the bend of a turn within a length is surely faster than `fast2`, by squares: without division or root. In the plane of
    /// the turn the axes give the `least` of them or more; s is no less than `sine`.
    #[inline]
    pub(super) fn is_surely_faster(&self, least: f32, length: f32, turn2: f32, sine: f32, fast2: f32) -> bool {
        let bend = SURELY * least * self.curve_share * length * (2.0 + sine);
        bend * bend > 9.0 * turn2 * fast2 * fast2
    }

    /// J² of a turn, the square of the junction speed (junction velocity) by the junction deviation:
    /// v² = a·d·s / (1 - s). 1 - s is a small difference for gentle turns; with q² = 4·(1 - s²) it is
    /// computed as q² / (4·(1 + s)) instead.
    #[inline]
    pub(super) fn junction2(&self, across: f32, sine: f32, turn2: f32) -> f32 {
        across * self.deviation * sine * (1.0 + sine) / (0.25 * turn2)
    }

    /// Speed² at which every axis takes a square corner.
    #[inline]
    pub(super) fn square_corner2(&self) -> f32 {
        let least = self.acceleration.iter().fold(UNLIMITED2, |most, own| lesser(*own, most));
        least * self.deviation * SQUARE_CORNER
    }
}

/// Radius of a bend for its length: 1/t, t = 3·q / (2 + s) within 0.2 % up to a right angle and 5 % up to half a turn
/// (Shafer's approximation of the arc tangent).
#[inline]
pub(super) fn radius_of(turn2: f32, sine: f32) -> f32 {
    (2.0 + sine) / (3.0 * square_root(turn2))
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: TurnRule<2> = TurnRule { acceleration: [500.0, 100.0], deviation: 0.01, curve_share: 1.0 };

    #[test]
    fn a_square_corner_has_the_speed_of_its_deviation() {
        let (before, after) = ([1.0, 0.0], [0.0, 1.0]);
        let all2 = turn2(&before, &after);
        let (certain2, sine) = certain(all2, 0.0).unwrap();
        assert!((certain2 - 2.0).abs() < 1e-6 && (sine - 0.5_f32.sqrt()).abs() < 1e-6);
        // Each axis gets 0.71 of the change of direction.
        let across = RULE.across(&before, &after, all2.sqrt());
        assert!((across - 100.0 * 2.0_f32.sqrt()).abs() < 1e-3, "{across}");
        let speed2 = RULE.junction2(100.0, sine, certain2);
        assert!((speed2 / RULE.square_corner2() - 1.0).abs() < 1e-5, "{speed2}");
    }

    #[test]
    fn what_rounding_explains_is_no_turn() {
        assert_eq!(certain(1.0e-6, 0.0), None);
        assert_eq!(certain(0.01, 0.1), None);
        let (less2, sine) = certain(0.01, 0.05).unwrap();
        // An angle of 0.1 rad less 0.05.
        assert!((less2.sqrt() - 0.05).abs() < 1e-4 && (sine - 0.025_f32.cos()).abs() < 1e-4, "{less2} {sine}");
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
