//! Compares how much each axis changes its speed with what physics and the junction rule allow. The speeds are read
//! from the step times alone. Nothing here is taken from the planner.
//!
//! **Measured.** p(t) is the position of an axis at time t (mm), v(t) its speed (mm/s). The mean speed over a window
//! of T seconds is subtracted from the mean speed over the next window. The difference, in mm/s, is:
//!
//! `D = (p(t+2T) - 2 p(t+T) + p(t)) / T`.
//!
//! D is the mean of `v(τ+T) - v(τ)` over all times τ from t to t+T. So the limit of D is the mean of the allowed
//! changes of speed over the same times τ. If the speed jumps at t+T, D is the whole jump.
//!
//! **Allowed.** Between the times τ and τ+T the path turns by the angle φ (rad), in any number of vertices. From here
//! on, v is the speed along the path. An axis may change its speed by the sum of two terms: acceleration, and one jump
//! by the junction rule.
//! - Acceleration: an axis with the acceleration a may change its speed by `a T`. This covers the acceleration along
//!   and across the path together, which may be larger by the share [`RAMP`].
//! - Junction rule: a single vertex of turn φ is passed at `v² = a d s / (1 - s)`. Here a is the acceleration across
//!   the path, d the junction deviation and s = cos(φ / 2). The direction cosine of the axis changes at the vertex. So
//!   the speed of the axis jumps by v times this change.
//! - Several vertices: one jump is granted for the *whole* turn, because the motor cannot tell several vertices from
//!   one. One jump per vertex would grant a multiple of the controller's rule, which is
//!   `v² <= a (L / φ + d s / (1 - s))` for a part of the path of length L that turns by φ. With L <= v T it follows
//!   that `v φ <= a T + v_j φ`, where v_j is the speed at a single vertex of turn φ. So the two terms here are this
//!   rule for a path of any form.
//! - Bounds: the granted jump falls to zero for a reversal. For small turns it has the limit v_j φ → √(8 a d). The feed
//!   also bounds v.
//! - Directions: they are taken from the intended chords, before the rounding to the program's digits, so they have no
//!   noise. The position error due to rounding is a term of its own.
//!
//! **Uncertain.** D has the weights 1, -2 and 1. So if positions are off by up to u, D is off by up to `4 u / T`.
//! - Steps ([`STEPS`]): an axis steps half way between two positions, so its position is well known between two
//!   consecutive steps. But a block starts and ends at whole steps. This adds half a step to the uncertainty. If two
//!   steps are far apart, the axis can rest or reverse between them. This adds another half step.
//! - Digits ([`DIGITS`]): each coordinate is off by up to half of a digit (the value of the program's last decimal
//!   place). The machine drives this noisy path. A controller sees only the noisy points. It can take a curve for a
//!   flatter one that is off by half a digit in each coordinate. In all three coordinates together that is √3 half
//!   digits.
//! - Directions: the direction of a chord of length l is off by up to 2 [`POINT`] / l, because both of its ends are
//!   off. A controller can underestimate a turn by the errors of its two directions together. So between two chords
//!   that are not much longer than a digit, it can mistake a reversal for a corner.
//! - Bends: a controller cannot distinguish a vertex from a bend as wide as the noise of the points on both sides. It
//!   takes such a bend of radius R at v² = a R.

use super::estimator::Limits;
use super::oracle::{AXES, Place, Pulse};

/// Share by which the combined acceleration along and across the path may exceed the acceleration limit of the axis.
pub const RAMP: f64 = 0.05;
/// Uncertainty of a position, in steps. The first value is for a position interpolated between two steps that follow
/// each other quickly. The second is for all other positions, where the axis can rest or reverse.
const STEPS: [f64; 2] = [0.6, 1.0];
/// Uncertainty of a position, in half digits of the program's coordinates. It is the sum of two parts. The first is 1,
/// for the rounding of the coordinate. The second is √3, because a controller can take the curve for a flatter one that
/// is off by half a digit in each of three coordinates.
const DIGITS: f64 = 2.75;
/// Uncertainty of a point, in half digits. A point has three coordinates, each off by up to half a digit, which makes
/// about √3.
const POINT: f64 = 1.75;
/// Maximum angle, rad, between two chords that still count as one straight part of the path.
const STRAIGHT: f64 = 0.25;
/// Minimum change of direction, rad, that counts as a corner of a smooth curve.
const CORNER: f64 = 0.3;
/// Number of times per window that the positions are read.
const READINGS: usize = 8;

/// A program of straight feed moves.
#[derive(Clone, Debug)]
pub struct Course {
    /// Ends of the moves as intended, mm; the first is the start position.
    pub meant: Vec<[f64; AXES]>,
    /// The same points as written in the program, rounded to its digits, mm.
    pub written: Vec<[f64; AXES]>,
    /// Resolution of the program's coordinates (value of their last decimal place), mm.
    pub digit: f64,
    /// mm/s.
    pub feed: f64,
    /// `true` if the chords approximate a smooth curve. Then the rule grants a jump at each vertex that turns by more
    /// than [`CORNER`], and no jump at other vertices.
    pub smooth: bool,
}

/// The change of an axis' speed that is largest relative to what is allowed.
#[derive(Clone, Copy, Debug)]
pub struct Change {
    /// `seen` / `allowed`; a value above 1 is a fault.
    pub ratio: f64,
    pub axis: usize,
    /// Time of the change, s, counted from the first step.
    pub at: f64,
    /// Window, s.
    pub window: f64,
    /// Measured and allowed change of speed, mm/s.
    pub seen: f64,
    pub allowed: f64,
    /// The part of `allowed` that the junction rule grants, mm/s.
    pub granted: f64,
}

impl std::fmt::Display for Change {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "axis {} changes by {:.2} mm/s within {} ms at {:.4} s: {:.2} times the {:.2} mm/s allowed ({:.2} for the turn)",
            self.axis,
            self.seen,
            self.window * 1000.0,
            self.at,
            self.ratio,
            self.allowed,
            self.granted
        )
    }
}

fn minus(a: [f64; AXES], b: [f64; AXES]) -> [f64; AXES] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn norm(v: [f64; AXES]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Effects of noise on a turn. `turn`: the angle by which a controller can underestimate the turn, rad. `radius`: a
/// controller can mistake the vertex for a bend of this radius, mm.
#[derive(Clone, Copy, Debug, Default)]
pub struct Unsure {
    turn: f64,
    radius: f64,
}

/// Returns the allowed speed jump of each axis where the path turns from one direction to another. The path speed there
/// is at most `feed`.
pub fn granted(before: [f64; AXES], after: [f64; AXES], unsure: Unsure, limits: &Limits, feed: f64) -> [f64; AXES] {
    let turn = minus(after, before);
    let size = norm(turn);
    if size < 1e-12 {
        return [0.0; AXES];
    }
    // With the turn φ: size = 2 sin(φ / 2), s = cos(φ / 2). 1 - s is a difference of nearly equal numbers, so it is
    // computed as `sin²(φ / 2) / (1 + s)`.
    let sure = (2.0 * (size / 2.0).min(1.0).asin() - unsure.turn).max(1e-9);
    let (sine, s) = (sure / 2.0).sin_cos();
    let acceleration = (0..AXES)
        .filter(|&i| turn[i] != 0.0)
        .map(|i| limits.acceleration[i] * size / turn[i].abs())
        .fold(f64::INFINITY, f64::min);
    let speed2 = acceleration * (limits.junction_deviation * s * (1.0 + s) / (sine * sine) + unsure.radius);
    turn.map(|part| speed2.sqrt().min(feed) * part.abs())
}

/// Returns the machine's position in steps after each pulse, with its time in s since the first step.
fn places(trace: &[Pulse], hz: f64) -> Vec<(f64, Place)> {
    let first = trace.first().map_or(0, |pulse| pulse.at);
    let mut place = [0; AXES];
    let mut places = Vec::with_capacity(trace.len());
    for pulse in trace {
        place = pulse.moved(place);
        places.push(((pulse.at - first) as f64 / hz, place));
    }
    places
}

/// Returns the time at which the machine passes each vertex, s. It must pass all of them in order, each within a
/// step. The time is the middle between the machine's arrival at the vertex and its departure.
fn passed(places: &[(f64, Place)], course: &Course, limits: &Limits) -> Result<Vec<f64>, String> {
    let mut from = 0;
    let at = |index: usize| if index == 0 { [0; AXES] } else { places[index - 1].1 };
    let time = |index: usize| if index == 0 { 0.0 } else { places[index - 1].0 };
    let mut times = Vec::with_capacity(course.written.len());
    for (number, point) in course.written.iter().enumerate() {
        let target = limits.place(*point);
        let near = |index: usize| (0..AXES).all(|a| at(index)[a].abs_diff(target[a]) <= 1);
        let Some(first) = (from..=places.len()).find(|&index| near(index)) else {
            return Err(format!("vertex {number}, {point:?}, is not passed after {} s", time(from)));
        };
        let last = (first..=places.len()).take_while(|&index| near(index)).last().unwrap_or(first);
        times.push(0.5 * (time(first) + time(last)));
        from = first;
    }
    // The machine arrives at the vertices in order. The middles of its stays need not be in order, because the stay
    // near one vertex can last longer than the stay near the next.
    for index in 1..times.len() {
        times[index] = times[index].max(times[index - 1]);
    }
    Ok(times)
}

/// State of the machine at times that are `step` seconds apart. `directions`: index of the chord that the machine is
/// on. `places`: positions of the axes.
struct Reading {
    step: f64,
    directions: Vec<usize>,
    /// Positions in steps, each with its uncertainty in steps.
    places: Vec<[(f64, f64); AXES]>,
}

/// Returns the position of an axis at evenly spaced times, and its uncertainty, both in steps. At the time of a step
/// the axis counts as half way between two positions. Between two steps it is taken to move evenly. If two steps are
/// so far apart that the axis can rest or reverse between them, the counted position is returned.
fn course_of_axis(places: &[(f64, Place)], axis: usize, step: f64, margin: usize, total: usize) -> Vec<(f64, f64)> {
    let mut levels = vec![];
    let mut before = 0;
    for (time, place) in places {
        if place[axis] != before {
            levels.push((*time, 0.5 * (before + place[axis]) as f64, place[axis] as f64));
            before = place[axis];
        }
    }
    let far = READINGS as f64 / 4.0 * step;
    let mut next = 0;
    (0..=total)
        .map(|index| {
            let now = (index as f64 - margin as f64) * step;
            while next < levels.len() && levels[next].0 <= now {
                next += 1;
            }
            let (Some(a), Some(b)) = (next.checked_sub(1).map(|n| levels[n]), levels.get(next)) else {
                return (next.checked_sub(1).map_or(0.0, |n| levels[n].2), STEPS[1]);
            };
            if b.0 - a.0 > far {
                return (a.2, STEPS[1]);
            }
            (a.1 + (b.1 - a.1) * (now - a.0) / (b.0 - a.0), STEPS[0])
        })
        .collect()
}

fn read(places: &[(f64, Place)], passed: &[f64], step: f64) -> Reading {
    // Add readings at rest: two windows before the first step and two after the last.
    let margin = 2 * READINGS;
    let last = places.last().map_or(0.0, |p| p.0);
    let total = (last / step).ceil() as usize + 2 * margin;
    let axes: [Vec<(f64, f64)>; AXES] = std::array::from_fn(|axis| course_of_axis(places, axis, step, margin, total));
    let places = (0..=total).map(|index| std::array::from_fn(|axis| axes[axis][index])).collect();
    let mut chord = 0;
    let mut directions = Vec::with_capacity(total);
    for index in 0..=total {
        let now = (index as f64 - margin as f64) * step;
        while chord + 2 < passed.len() && passed[chord + 1] <= now {
            chord += 1;
        }
        directions.push(chord);
    }
    Reading { step, directions, places }
}

/// Returns the uncertainty of each chord's direction, rad, in two lists. A direction is more certain over a longer
/// straight part of the path. The first list measures it over the straight part that ends with the chord, the second
/// over the straight part that starts with it.
fn unsure(course: &Course, chords: &[[f64; AXES]]) -> [Vec<f64>; 2] {
    let length = |k: usize| norm(minus(course.meant[k + 1], course.meant[k]));
    let kept = |k: usize, others: &mut dyn Iterator<Item = usize>| {
        let like = others.take_while(|other| norm(minus(chords[*other], chords[k])) < STRAIGHT);
        2.0 * POINT * 0.5 * course.digit / like.map(length).sum::<f64>()
    };
    [
        (0..chords.len()).map(|k| kept(k, &mut (0..=k).rev())).collect(),
        (0..chords.len()).map(|k| kept(k, &mut (k..chords.len()))).collect(),
    ]
}

/// Returns the speed jumps that the junction rule allows, for each reading and axis, mm/s. The rule is applied to the
/// turn between the reading and the one a window later.
fn grants(course: &Course, chords: &[[f64; AXES]], directions: &[usize], limits: &Limits) -> Vec<[f64; AXES]> {
    let [behind, ahead] = unsure(course, chords);
    let grant = |before: usize, after: usize| {
        let unsure = Unsure { turn: behind[before] + ahead[after], radius: POINT * course.digit };
        granted(chords[before], chords[after], unsure, limits, course.feed)
    };
    let pairs: Vec<[f64; AXES]> = (0..directions.len() - READINGS)
        .map(|k| {
            let (before, after) = (directions[k], directions[k + READINGS]);
            if !course.smooth {
                return if before == after { [0.0; AXES] } else { grant(before, after) };
            }
            let corner = |at: &usize| norm(minus(chords[*at], chords[at - 1])) > CORNER;
            let corners = (before + 1..=after).filter(corner).map(|at| grant(at - 1, at));
            corners.fold([0.0; AXES], |sum, one| std::array::from_fn(|axis| sum[axis] + one[axis]))
        })
        .collect();
    // The time at which the machine passes a vertex is known only to within a step. So each reading gets the largest
    // jump that is allowed for it or for one of its two neighbours.
    (0..pairs.len())
        .map(|k| {
            let near = &pairs[k.saturating_sub(1)..pairs.len().min(k + 2)];
            std::array::from_fn(|a| near.iter().map(|pair| pair[a]).fold(0.0, f64::max))
        })
        .collect()
}

/// Returns the change of an axis' speed that is largest relative to what is allowed. `window`: time over which mean
/// speeds are compared, s.
///
/// # Errors
/// The machine does not follow the course.
pub fn greatest_change(
    trace: &[Pulse],
    hz: f64,
    course: &Course,
    limits: &Limits,
    window: f64,
) -> Result<Change, String> {
    // Leave out chords of zero length: they have no direction.
    let mut real = Course { meant: Vec::new(), written: Vec::new(), ..*course };
    for (meant, written) in course.meant.iter().zip(&course.written) {
        if real.meant.last().is_none_or(|last| norm(minus(*meant, *last)) > 1e-9) {
            real.meant.push(*meant);
            real.written.push(*written);
        }
    }
    let chords: Vec<[f64; AXES]> = real
        .meant
        .windows(2)
        .map(|ends| {
            let way = minus(ends[1], ends[0]);
            way.map(|part| part / norm(way))
        })
        .collect();
    let places = places(trace, hz);
    let passed = passed(&places, &real, limits)?;
    let reading = read(&places, &passed, window / READINGS as f64);
    let count = reading.places.len();
    let pairs = grants(&real, &chords, &reading.directions, limits);
    let mut worst: Option<Change> = None;
    for k in 0..count - 2 * READINGS {
        let mean = |axis: usize| {
            let sum: f64 = pairs[k..=k + READINGS].iter().map(|pair| pair[axis]).sum();
            sum / (READINGS + 1) as f64
        };
        for axis in 0..AXES {
            let at = |n: usize| reading.places[k + n * READINGS][axis];
            let second = (at(2).0 - 2.0 * at(1).0 + at(0).0).abs();
            if second < 0.1 {
                continue;
            }
            let pitch = 1.0 / limits.steps_per_mm[axis];
            let seen = second * pitch / window;
            let granted = mean(axis);
            let steps = at(2).1 + 2.0 * at(1).1 + at(0).1;
            let uncertain = (steps * pitch + 4.0 * DIGITS * 0.5 * real.digit) / window;
            let allowed = limits.acceleration[axis] * window * (1.0 + RAMP) + granted + uncertain;
            let ratio = seen / allowed;
            if worst.is_none_or(|worst| ratio > worst.ratio) {
                let at = (k + READINGS) as f64 * reading.step - 2.0 * window;
                worst = Some(Change { ratio, axis, at, window, seen, allowed, granted });
            }
        }
    }
    worst.ok_or_else(|| "nothing moves".to_string())
}
