//! Cuts the next segment of a block with a jerk limit (S-curve). The segment starts with the present speed and
//! acceleration, and is as fast as the planned anchors allow. An anchor is an entry of a block at which a ramp ends.
//!
//! At its end, each segment has the first one of these accelerations that is possible:
//! 1. the acceleration that leads to the nominal speed soonest;
//! 2. the present acceleration;
//! 3. the acceleration of a ramp down to the next anchor.
//!
//! Accelerations 1 and 2 are possible if the machine can still meet the next anchors after the segment. Only speed and
//! acceleration are carried from one segment to the next. So an override, a hold, the resume after a hold, or moves
//! that arrive late need no plan of their own. They only change which accelerations are possible, and the jerk stays
//! bounded.

use super::jerk::{Bounds, PathState, cube_root, landing, ramp_distance, ramp_speed};
use super::planner::Planner;
use super::running::{PathMotion, Running};
use super::segment::{self, Cut, SegmentSize};
use super::trapezoid::{Pace, greater, lesser, square_root};
use crate::messages::UNITS_PER_STEP;

/// Relative deviation up to which a speed counts as the nominal speed: about a hundred rounding errors of an `f32`.
const SAME_SPEED: f32 = 1.0e-5;
/// Relative deviation from the nominal speed up to which a segment ends at exactly the nominal speed, with an
/// acceleration of 0.
const SNAP: f32 = 1.0e-4;

/// A segment's time and the state at its end.
#[derive(Clone, Copy, Debug)]
struct Travelled {
    seconds: f32,
    end: PathState,
}

/// Returns the next piece of the running block; `None` for an immediate stop.
#[inline(never)]
pub(super) fn next_cut<const N: usize>(
    run: &Running<N>,
    motion: &mut PathMotion,
    braking: bool,
    planner: &Planner<N>,
) -> Option<Cut> {
    let bounds = planner.first()?.bounds();
    let millimetre = 1.0 / run.scale;
    let state = PathState { speed: motion.pace.speed * millimetre, acceleration: motion.acceleration };
    let nominal = if braking { 0.0 } else { square_root(run.nominal2) * millimetre };
    // If the machine can stop within one step, the shape of the speed change has no effect on the motor: use a
    // trapezoid. But a machine that already brakes, for example in a hold, comes to rest with limited jerk.
    let fastest = greater(nominal, state.speed);
    if state.acceleration >= 0.0 && ramp_distance(fastest, 0.0, bounds) < UNITS_PER_STEP as f32 * millimetre {
        let (curve, left) = run.trapezoid(motion.pace, braking, planner)?;
        return Some(segment::cut(&curve, run.done, left, motion.pace, run.scales_power()));
    }
    let units = run.left();
    let left = units as f32 * millimetre;
    let size = SegmentSize::next(motion.pace, state.acceleration * run.scale, run.done, units);
    let way = (size.grain * size.ticks) as f32 * millimetre;
    let last = size.grain * size.ticks == units;

    let from_rest = start(way, bounds);
    let at_rest = state.speed <= 0.0 || size.ticks == 1 && state.speed <= 0.25 * from_rest.end.speed;
    let left = if last && !at_rest { way } else { left };
    let next = SegmentStart::new(state, way, left, nominal, bounds, planner);
    let limit = &mut motion.ease_off_limit;
    let travelled = if at_rest { next.leave_rest(from_rest, limit) } else { next.keep_moving(braking, limit) };
    let speed = travelled.end.speed * run.scale;
    let end = Pace { speed, speed2: speed * speed };
    let mut cut = size.cut(motion.pace.speed, end, travelled.seconds);
    cut.acceleration = travelled.end.acceleration;
    Some(cut)
}

/// Speed, acceleration and limits at the start of the next segment.
struct SegmentStart<'a, const N: usize> {
    state: PathState,
    /// Length of the segment, mm.
    way: f32,
    /// Distance to the end of the block, mm.
    left: f32,
    nominal: f32,
    bounds: Bounds,
    /// Estimated duration of the segment, s.
    guess: f32,
    /// Maximum change of the acceleration during the segment, mm/s²: the change that the jerk bound allows within
    /// `guess`.
    change: f32,
    planner: &'a Planner<N>,
}

impl<'a, const N: usize> SegmentStart<'a, N> {
    #[inline]
    fn new(state: PathState, way: f32, left: f32, nominal: f32, bounds: Bounds, planner: &'a Planner<N>) -> Self {
        let time = way / state.speed;
        let guess = way / greater(state.speed + 0.5 * state.acceleration * time, 0.5 * state.speed);
        Self { state, way, left, nominal, bounds, guess, change: bounds.jerk * guess, planner }
    }

    /// Returns the first segment of a machine at rest. Normally this is the segment `free`, which has constant jerk.
    /// But if the machine could not slow down for the next anchors after `free`, a slower segment is returned.
    fn leave_rest(&self, free: Travelled, ease_off_limit: &mut f32) -> Travelled {
        let Self { way, nominal, bounds, .. } = *self;
        let rest = self.left - way;
        if let Some(ahead) = self.planner.allows(free.end, rest, nominal) {
            *ease_off_limit = ahead;
            return free;
        }
        let target = self.planner.target(0, rest, bounds);
        let slow = lesser(lesser(ramp_speed(target.speed, target.distance, target.bounds), nominal), free.end.speed);
        let end = PathState { speed: slow, acceleration: 0.0 };
        if slow > 0.1 * free.end.speed {
            return Travelled { seconds: 2.0 * way / slow, end };
        }
        // From rest to rest, the jerk changes its sign after a quarter and three quarters of the time.
        Travelled { seconds: cube_root(32.0 * way / bounds.jerk), end }
    }

    /// Returns a segment for a moving machine: with the maximum acceleration allowed, or on a ramp down.
    fn keep_moving(&self, braking: bool, ease_off_limit: &mut f32) -> Travelled {
        let Self { state, nominal, bounds, planner, .. } = *self;
        let mut allowed = Bounds { acceleration: lesser(bounds.acceleration, *ease_off_limit), ..bounds };
        let too_fast = state.speed > nominal * (1.0 + SNAP);
        if too_fast {
            // Use the tightest bounds of all blocks that the machine passes until it has reduced its deceleration to
            // 0.
            let (_, ease) = state.valley(bounds.jerk);
            allowed = planner.bounds_within(ease, self.left, state.speed * state.speed);
        }
        let best = self.within_jerk(state.towards(nominal, self.guess, allowed));
        // In a hold the nominal speed is 0, but the machine need not reach it within a certain distance. So the
        // nominal speed sets no limit here; the corners in the queue still do.
        let most = if braking { f32::INFINITY } else { nominal * (1.0 + SAME_SPEED) };
        if let Some((ahead, travelled)) = self.to_nominal(best, most).or_else(|| self.as_before(best, most)) {
            *ease_off_limit = ahead;
            return travelled;
        }
        *ease_off_limit = bounds.acceleration;
        // The argument `steepest` is used if the distance is too short for the planned ramp. Normally it is the
        // running block's acceleration. If the machine is too fast, it is the lowest acceleration of the blocks on
        // which the machine reduces its deceleration to 0.
        self.ramp_down(best, if too_fast { allowed.acceleration } else { bounds.acceleration })
    }

    /// Returns the acceleration nearest to `wanted` that the jerk allows.
    #[inline]
    fn within_jerk(&self, wanted: f32) -> f32 {
        let acceleration = self.state.acceleration;
        greater(lesser(wanted, acceleration + self.change), acceleration - self.change)
    }

    /// Returns the segment's time and end state if it ends with the acceleration `end`. Uses the mean acceleration as
    /// if it were constant. The error of the distance is j·t³/12 with the jerk j and the duration t: a hundredth of a
    /// micrometre for 100,000 mm/s³ and 1 ms.
    #[inline]
    fn to(&self, end: f32) -> Travelled {
        let PathState { speed, acceleration } = self.state;
        let end2 = speed * speed + (acceleration + end) * self.way;
        if end2 <= 0.0 {
            return Self::come_to_rest(self.planner, speed, self.way, self.left, self.bounds);
        }
        let last = square_root(end2);
        self.at_speed(last, end)
    }

    /// Returns the segment's time and end state if it ends with this speed and acceleration.
    #[inline]
    fn at_speed(&self, speed: f32, acceleration: f32) -> Travelled {
        Travelled { seconds: 2.0 * self.way / (self.state.speed + speed), end: PathState { speed, acceleration } }
    }

    /// Tries to end the segment with `best`, the acceleration that leads to the nominal speed soonest. If that is
    /// possible, returns an acceleration bound, and the segment's time and end state. The bound is the lowest one of
    /// the blocks on which the machine would then reduce its acceleration to 0.
    ///
    /// Returns `None` if [`Planner::allows`] forbids the end state. Also returns `None` if the acceleration at the end
    /// exceeds the bound and `best` is at least the present acceleration.
    #[inline]
    fn to_nominal(&self, best: f32, most: f32) -> Option<(f32, Travelled)> {
        let travelled = self.to(best);
        let ahead = self.planner.allows(travelled.end, self.left - self.way, most)?;
        if travelled.end.acceleration > ahead && best >= self.state.acceleration {
            return None;
        }
        let off = (travelled.end.speed - self.nominal).abs();
        let slight =
            self.state.acceleration.abs() <= self.change && travelled.end.acceleration.abs() <= 0.5 * self.change;
        let arrives = slight && off <= SNAP * self.nominal;
        Some((ahead, if arrives { self.at_speed(self.nominal, 0.0) } else { travelled }))
    }

    /// Tries to keep the present acceleration. Returns the same values as [`SegmentStart::to_nominal`]; `None` in these
    /// cases:
    /// * The present acceleration is negative, or at least `best`.
    /// * The present acceleration is above the bound of the blocks ahead.
    /// * [`Planner::allows`] forbids the end state.
    #[inline]
    fn as_before(&self, best: f32, most: f32) -> Option<(f32, Travelled)> {
        let acceleration = self.state.acceleration;
        if acceleration < 0.0 || acceleration >= best {
            return None;
        }
        let travelled = self.to(acceleration);
        let ahead = self.planner.allows(travelled.end, self.left - self.way, most)?;
        (travelled.end.acceleration <= ahead).then_some((ahead, travelled))
    }

    /// Returns the time and end state of a segment on a ramp down to the next anchor. `steepest`: acceleration to use
    /// if the distance is too short for the planned ramp.
    #[inline]
    fn ramp_down(&self, best: f32, steepest: f32) -> Travelled {
        let Self { state, way, .. } = *self;
        let PathState { speed, acceleration } = state;
        let target = self.planner.target(0, self.left, self.bounds);
        let (aim, distance) = target.beyond(speed, way);
        if aim <= 0.0 && distance <= way {
            return Travelled { seconds: 3.0 * (way / speed), end: PathState { speed: 0.0, acceleration: 0.0 } };
        }
        // The ramp is planned with the tightest bounds ahead.
        let planned = target.bounds.acceleration;
        // A bend can leave less acceleration for braking than was planned: the override was raised in the bend, or the
        // bend was found late. If the target cannot be met with the planned acceleration, brake with all of the
        // block's acceleration.
        let all = self.planner.first().map_or(steepest, |block| greater(steepest, block.acceleration));
        let mut wanted = if target.is_met(state) { -planned } else { -greater(planned, all) };
        if acceleration <= 0.0 {
            let next = speed + acceleration * self.guess;
            let land = if next > aim { landing(next, aim, greater(distance - way, 0.0)) } else { 0.0 };
            wanted = greater(wanted, land);
        }
        let travelled = self.to(lesser(self.within_jerk(wanted), best));
        // The ticks are too coarse for a gradual change if the ramp ends in this segment and the machine must lose more
        // than half of its speed in it. Then end at the planned speed regardless of the jerk.
        let even = (speed * speed - aim * aim) / (2.0 * way);
        let coarse = distance <= way && aim < 0.5 * speed && travelled.end.speed > aim && even <= all;
        if coarse { self.at_speed(aim, 0.0) } else { travelled }
    }

    /// Returns the time and end state of a segment in which braking would bring the machine to rest before the end of
    /// the segment. Instead, the machine keeps its speed through the segment. If the block ends with this segment, the
    /// end speed is at most the planned one.
    #[inline(never)]
    fn come_to_rest(planner: &Planner<N>, speed: f32, way: f32, left: f32, bounds: Bounds) -> Travelled {
        let exit = if left > way { speed } else { lesser(speed, planner.target(0, left, bounds).speed) };
        // `3.0 * way / speed` is the time until rest at constant jerk.
        let seconds = if exit > 0.0 { 2.0 * way / (speed + exit) } else { 3.0 * way / speed };
        Travelled { seconds, end: PathState { speed: exit, acceleration: 0.0 } }
    }
}

/// Returns the time and end state of the first segment from rest. Its jerk is constant: the maximum jerk, or less if
/// the acceleration would become too high.
fn start(way: f32, bounds: Bounds) -> Travelled {
    let seconds = greater(cube_root(6.0 * way / bounds.jerk), square_root(6.0 * way / bounds.acceleration));
    Travelled { seconds, end: PathState { speed: 3.0 * way / seconds, acceleration: 6.0 * way / (seconds * seconds) } }
}
