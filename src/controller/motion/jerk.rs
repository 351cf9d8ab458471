//! The mathematics of the S-curve: changes of speed within `Bounds` of acceleration and jerk. `ramp_distance` is for
//! ramps that begin and end with an acceleration of 0. `ramp_speed` is its inverse, by Newton's method.
//!
//! ```text
//!  speed  from ____                       acceleration   0 ___                 ___
//!                  \__  a = -j·t                              \             /
//!                     \                                        \           /   slope ±j
//!                      \   a = -A                            -A \_________/
//!                       \__
//!                          \____ to       distance = mean speed · time; the curve is symmetric,
//!                                         so its mean speed is (from + to) / 2
//! ```
//! Units are millimetres and seconds. Only + - * / and the square root are used, so that results are the same on every
//! computer.

use super::trapezoid::{greater, lesser, square_root};

/// The state of motion along the path, mm/s and mm/s².
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct PathState {
    pub speed: f32,
    pub acceleration: f32,
}

/// Bounds on a change of speed: acceleration (mm/s²) and jerk (mm/s³).
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bounds {
    pub acceleration: f32,
    pub jerk: f32,
}

impl Bounds {
    pub(super) const NONE: Self = Self { acceleration: f32::INFINITY, jerk: f32::INFINITY };

    /// Returns the bounds rounded down to numbers whose lower 16 bits are 0. Reason: [`super::block::Ramp`] stores
    /// only the upper 16 bits.
    #[inline]
    pub(super) fn rounded_down(self) -> Self {
        let upper = |value: f32| f32::from_bits(value.to_bits() & 0xFFFF_0000);
        Self { acceleration: upper(self.acceleration), jerk: upper(self.jerk) }
    }

    /// Returns the lower acceleration and the lower jerk of two bounds.
    #[inline]
    pub(super) fn and(self, other: Self) -> Self {
        Self { acceleration: lesser(self.acceleration, other.acceleration), jerk: lesser(self.jerk, other.jerk) }
    }
}

/// Returns the distance needed to slow down from one speed to a lower one (or to speed up from the lower one), with an
/// acceleration of 0 at both ends.
#[inline]
pub(super) fn ramp_distance(from: f32, to: f32, bounds: Bounds) -> f32 {
    let change = from - to;
    if change <= 0.0 {
        return 0.0;
    }
    let Bounds { acceleration, jerk } = bounds;
    let time = if change * jerk >= acceleration * acceleration {
        change / acceleration + acceleration / jerk
    } else {
        // The change is too small to reach the maximum acceleration: the acceleration grows for half of the time and
        // falls for the other half.
        2.0 * square_root(change / jerk)
    };
    0.5 * (from + to) * time
}

/// Returns the maximum speed from which `distance` suffices to slow down to the speed `to`: the inverse of
/// [`ramp_distance`].
pub(super) fn ramp_speed(to: f32, distance: f32, bounds: Bounds) -> f32 {
    let Bounds { acceleration, jerk } = bounds;
    if distance <= 0.0 {
        return to;
    }
    // If the ramp reaches the maximum acceleration a, the change of speed x satisfies (to + x / 2)·(x / a + a / j) =
    // distance, with the jerk j.
    let least = to * acceleration / jerk;
    if distance > least {
        let half = to / acceleration + 0.5 * acceleration / jerk;
        let change = acceleration * (square_root(half * half + 2.0 * (distance - least) / acceleration) - half);
        if change * jerk >= acceleration * acceleration {
            return to + change;
        }
    }
    // Otherwise the change of speed is x = y², where y³ + 2·to·y = distance·√j, with the jerk j. Newton's method
    // converges from any y that is too great, because the left side is convex. If one of the two terms on the left is
    // left out, the solution is a y that is too great.
    let wanted = distance * square_root(jerk);
    let mut root = cube_root(wanted);
    if 2.0 * to * root > wanted {
        root = wanted / (2.0 * to);
    }
    for _ in 0..NEWTON {
        let square = root * root;
        root = (2.0 * square * root + wanted) / (3.0 * square + 2.0 * to);
    }
    to + root * root
}

/// Number of Newton iterations. They reach 24 bits, because the starting value is too great by a factor of 1.4 at most.
const NEWTON: u32 = 4;

/// Returns the cube root of a nonnegative number; 0 for numbers up to `f32::MIN_POSITIVE`.
#[inline]
pub(super) fn cube_root(value: f32) -> f32 {
    if value <= f32::MIN_POSITIVE {
        return 0.0;
    }
    // Dividing the bits by 3 divides the exponent, which gives the root within 6 %.
    let mut root = f32::from_bits(value.to_bits() / 3 + 0x2A51_4067);
    for _ in 0..3 {
        root = (2.0 * root + value / (root * root)) * (1.0 / 3.0);
    }
    root
}

impl PathState {
    /// Returns the maximum speed of the ramp that contains this state, and the distance, mm, from here to the point
    /// with that speed, where the acceleration is 0. The distance is positive for an accelerating machine: it reaches
    /// the point when it has reduced its acceleration to 0. The distance is negative for a braking machine, because
    /// the point lies behind it.
    #[inline]
    pub(super) fn summit(self, jerk: f32) -> (f32, f32) {
        let time = self.acceleration / jerk;
        let gain = self.acceleration * time;
        (self.speed + 0.5 * gain, time * (self.speed + gain * (1.0 / 3.0)))
    }

    /// Returns the speed that a braking machine still has when it has reduced its deceleration to 0, and the distance
    /// that it travels until then.
    #[inline]
    pub(super) fn valley(self, jerk: f32) -> (f32, f32) {
        let time = -self.acceleration / jerk;
        let loss = -self.acceleration * time;
        (self.speed - 0.5 * loss, time * (self.speed - loss * (1.0 / 3.0)))
    }

    /// Returns whether a braking machine can slow down to `target` within `distance`, and arrive there with an
    /// acceleration of 0.
    pub(super) fn lands(self, target: f32, distance: f32, bounds: Bounds) -> bool {
        let (valley, way) = self.valley(bounds.jerk);
        if self.speed <= target {
            return true;
        }
        if valley <= 0.0 {
            // The machine would come to rest before its deceleration is reduced to 0. It passes the target speed on
            // the way: check that this happens within the distance.
            let change = self.speed - target;
            let root = square_root(greater(self.acceleration * self.acceleration - 2.0 * bounds.jerk * change, 0.0));
            let time = 2.0 * change / (root - self.acceleration);
            return time * (self.speed + time * (0.5 * self.acceleration + time * bounds.jerk * (1.0 / 6.0)))
                <= distance;
        }
        if valley <= target {
            return way <= distance;
        }
        self.falls(target, distance, bounds)
    }

    /// Returns `true` if the ramp that contains this state reaches `target` within `distance` from here. The ramp
    /// starts at its maximum speed ([`PathState::summit`]).
    #[inline]
    fn falls(self, target: f32, distance: f32, bounds: Bounds) -> bool {
        let (summit, ahead) = self.summit(bounds.jerk);
        summit <= target || ramp_distance(summit, target, bounds) + ahead <= distance
    }

    /// Returns the acceleration that the machine must have after `time` to reach `nominal` as soon as possible, and to
    /// arrive there with an acceleration of 0.
    #[inline]
    pub(super) fn towards(self, nominal: f32, time: f32, bounds: Bounds) -> f32 {
        let Bounds { acceleration, jerk } = bounds;
        let half = 0.5 * jerk * time;
        let excess = self.speed + 0.5 * self.acceleration * time - nominal;
        // If the machine begins to ease off the acceleration a at the speed v, it reaches the speed v ± a² / 2j after
        // the time a / j. That must be the nominal speed.
        let wanted = if excess < 0.0 {
            square_root(half * half - 2.0 * jerk * excess) - half
        } else {
            half - square_root(half * half + 2.0 * jerk * excess)
        };
        greater(lesser(wanted, acceleration), -acceleration)
    }
}

/// Returns the acceleration, mm/s², that a machine at `speed` must have now, so that a constant jerk takes it to the
/// speed `target` after exactly `distance`, with an acceleration of 0 there. If the caller computes the acceleration
/// anew at each point, the path has this constant jerk, and small errors are corrected.
#[inline]
pub(super) fn landing(speed: f32, target: f32, distance: f32) -> f32 {
    -(2.0 / 3.0) * (speed - target) * (speed + 2.0 * target) / distance
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOUNDS: Bounds = Bounds { acceleration: 500.0, jerk: 10_000.0 };

    /// Integrates braking from one speed to another in small time steps; returns the distance.
    fn brake(from: f64, to: f64, bounds: Bounds) -> f64 {
        let (a, j) = (f64::from(bounds.acceleration), f64::from(bounds.jerk));
        let change = from - to;
        let (ramp, level) = if change * j >= a * a { (a / j, change / a - a / j) } else { ((change / j).sqrt(), 0.0) };
        let steps = 100_000;
        let whole = 2.0 * ramp + level;
        let dt = whole / f64::from(steps);
        let (mut v, mut way) = (from, 0.0);
        for k in 0..steps {
            let t = (f64::from(k) + 0.5) * dt;
            let pull = j * t.min(whole - t).min(ramp);
            way += (v - 0.5 * pull * dt) * dt;
            v -= pull * dt;
        }
        assert!((v - to).abs() < 1e-6);
        way
    }

    #[test]
    fn a_ramp_is_as_long_as_its_integral() {
        for (from, to) in [(100.0, 0.0), (100.0, 90.0), (30.0, 10.0), (5.0, 0.0), (0.1, 0.0), (200.0, 199.9)] {
            let way = ramp_distance(from as f32, to as f32, BOUNDS);
            let exact = brake(from, to, BOUNDS);
            assert!((f64::from(way) / exact - 1.0).abs() < 1e-4, "{from} {to}: {way} {exact}");
        }
    }

    #[test]
    fn the_speed_of_a_ramp_is_the_inverse_of_its_length() {
        for jerk in [100.0, 1.0e4, 1.0e6, 1.0e9] {
            for to in [0.0, 0.01, 1.0, 30.0, 500.0] {
                for change in [1.0e-3, 0.1, 1.0, 24.0, 26.0, 100.0, 1000.0] {
                    let bounds = Bounds { jerk, ..BOUNDS };
                    let from = to + change;
                    let found = ramp_speed(to, ramp_distance(from, to, bounds), bounds);
                    assert!((found - from).abs() < 2e-5 * from + 1e-3 * change, "{jerk} {to} {from}: {found}");
                }
            }
        }
    }

    #[test]
    fn third_roots() {
        for k in 0..2000 {
            let value = 1.0e-20 * 1.06_f32.powi(k % 1200) * (1.0 + k as f32 * 1e-3);
            let root = f64::from(cube_root(value));
            assert!((root.powi(3) / f64::from(value) - 1.0).abs() < 1e-6, "{value}");
        }
        assert_eq!(cube_root(0.0), 0.0);
    }

    /// For each state within a ramp, `summit` returns the speed and the place of the start of that ramp. `lands` is
    /// true for the distance to the end of the ramp but false for a shorter one.
    #[test]
    fn states_within_a_ramp_belong_to_it() {
        let (from, to) = (80.0_f32, 20.0);
        let whole = ramp_distance(from, to, BOUNDS);
        let mut state = PathState { speed: from, acceleration: 0.0 };
        let mut way = 0.0;
        for _ in 0..45 {
            let time = 0.001;
            let gone = time * (state.speed + time * (0.5 * state.acceleration - time * BOUNDS.jerk / 6.0));
            state.speed += time * (state.acceleration - 0.5 * BOUNDS.jerk * time);
            state.acceleration -= BOUNDS.jerk * time;
            way += gone;
            let (summit, ahead) = state.summit(BOUNDS.jerk);
            assert!((summit - from).abs() < 1e-3 && (ahead + way).abs() < 1e-3, "{summit} {ahead} {way}");
            assert!(state.lands(to, whole - way + 0.01, BOUNDS));
            assert!(!state.lands(to, whole - way - 0.01, BOUNDS));
        }
    }

    /// If `lands` is true, a braking machine that reduces its deceleration at once gets down to the target speed within
    /// the distance. Skips states in which the deceleration reaches 0 above the target speed.
    #[test]
    fn easing_off_at_once_comes_down_in_time() {
        let jerk = BOUNDS.jerk;
        let mut found = [0; 3];
        for k in 0..60_000_u32 {
            let random = |salt: u32, most: f32| {
                (k.wrapping_mul(2_654_435_761).wrapping_mul(salt) >> 8) as f32 / 16_777_216.0 * most
            };
            let state = PathState { speed: random(3, 30.0), acceleration: -random(5, 500.0) };
            let (target, distance) = (if k % 3 == 0 { 0.0 } else { random(7, 15.0) }, random(11, 0.5));
            let (valley, _) = state.valley(jerk);
            if state.speed <= target || valley > target || state.acceleration == 0.0 {
                continue;
            }
            let (mut v, mut a, mut way) = (state.speed, state.acceleration, 0.0);
            while v > target && a < 0.0 && way <= distance {
                let time = 1.0e-5;
                way += v * time;
                v += a * time;
                a += jerk * time;
            }
            let lands = state.lands(target, distance, BOUNDS);
            if lands {
                assert!(
                    v < target + 0.02 || (way - distance).abs() < 2.0e-3,
                    "{state:?} {target} {distance}: {v} at {way}"
                );
            } else if valley <= 0.0 {
                assert!(way > distance - 2.0e-3, "{state:?} {target} {distance}: {v} at {way}");
            }
            found[if valley <= 0.0 { 0 } else { 1 } + usize::from(lands && valley > 0.0)] += 1;
        }
        assert!(found.iter().all(|count| *count > 100), "{found:?}");
    }

    #[test]
    fn a_landing_has_an_even_jerk() {
        let (target, jerk) = (7.0_f32, 3000.0_f32);
        for time in [0.001_f32, 0.01, 0.1] {
            let speed = target + 0.5 * jerk * time * time;
            let distance = target * time + jerk * time * time * time / 6.0;
            let wanted = -jerk * time;
            assert!((landing(speed, target, distance) / wanted - 1.0).abs() < 1e-2, "{time}");
        }
    }
}
