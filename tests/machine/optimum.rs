//! Computes, in `f64`, the shortest time for a path that is known as a whole. This is the time of a controller with
//! an endless queue and without rounding. It serves as a reference for times, and as a source of motion that keeps
//! the limits.
//!
//! The path is given as pieces with their tangent x' and curvature x'' (the first and second derivative of the
//! position by the length of the path). With speed v and acceleration u along the path, each axis has the
//! acceleration `x'' v² + x' u`, which must stay within the limit of the axis.
//!
//! A backward pass finds for each knot (the border of two pieces) the maximum v² from which the rest of the path can
//! still be driven. A forward pass then takes at each knot the maximum u that does not exceed this v². The allowed
//! pairs (v², u) form a convex set that contains (0, 0). So the result is the optimum, except for the finite length
//! of the pieces.

use super::axis_speeds::{Course, Unsure, granted};
use super::estimator::Limits;
use super::oracle::{AXES, Pulse};
use std::f64::consts::PI;

/// A part of a path that is short enough to have one tangent and one curvature.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    pub tangent: [f64; AXES],
    /// Change of the tangent per length of path, 1/mm.
    pub curvature: [f64; AXES],
    /// Length along the path, mm.
    pub length: f64,
    /// Maximum speed² at the start of the piece, (mm/s)².
    pub entry2: f64,
    /// Maximum speed² on the piece, (mm/s)².
    pub most2: f64,
}

/// Rule that bounds the acceleration across and along the path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// Each axis keeps its own acceleration limit.
    EachAxis,
    /// The accelerations of all axes together form a vector. In every direction this vector is at most as long as the
    /// limit of the weakest axis. So the speed on a circle is constant.
    Resultant,
}

/// Returns the minimum and the maximum acceleration along the path that the axes allow on a piece, mm/s². `v2`:
/// speed² at the start of the piece. If this speed is too high for the bend, returns an empty range, (1, 0).
fn range(piece: &Piece, v2: f64, limits: &Limits, bound: Bound) -> (f64, f64) {
    let twice = 2.0 * piece.length;
    // The lowest value brakes to a stop at the end of the piece.
    let (mut low, mut high) = (-v2 / twice, f64::INFINITY);
    if bound == Bound::Resultant {
        let most = limits.acceleration.iter().copied().fold(f64::INFINITY, f64::min);
        let across = piece.curvature.iter().map(|x| x * x).sum::<f64>().sqrt() * v2;
        if across > most {
            return (1.0, 0.0);
        }
        let along = (most * most - across * across).sqrt();
        return (low.max(-along), along);
    }
    for axis in 0..AXES {
        let bend = piece.curvature[axis];
        // The axis must keep its limit at both ends of the piece. At the start the speed² is `v2`. At the end it is
        // `v2` + 2 u `length`, with the acceleration u along the path.
        for share in [piece.tangent[axis], piece.tangent[axis] + twice * bend] {
            let most = limits.acceleration[axis];
            let (a, b) = ((-most - bend * v2) / share, (most - bend * v2) / share);
            if share.abs() > 1e-12 {
                low = low.max(a.min(b));
                high = high.min(a.max(b));
            } else if (bend * v2).abs() > most {
                return (1.0, 0.0);
            }
        }
    }
    (low, high)
}

/// Returns the highest possible speed², (mm/s)², at each knot: the start, the end, and each border of two pieces. The
/// motion starts and ends at rest.
pub fn optimum(pieces: &[Piece], limits: &Limits, bound: Bound) -> Vec<f64> {
    let mut reachable = vec![0.0; pieces.len() + 1];
    for (k, piece) in pieces.iter().enumerate().rev() {
        let exit2 = f64::min(reachable[k + 1], piece.most2);
        let drivable = |v2: f64| {
            let (low, high) = range(piece, v2, limits, bound);
            low <= high.min((exit2 - v2) / (2.0 * piece.length))
        };
        let (mut low, mut high) = (0.0, piece.entry2.min(piece.most2));
        if drivable(high) {
            low = high;
        } else {
            for _ in 0..60 {
                let middle = 0.5 * (low + high);
                if drivable(middle) { low = middle } else { high = middle }
            }
        }
        reachable[k] = low;
    }
    let mut speeds2 = vec![0.0; pieces.len() + 1];
    for (k, piece) in pieces.iter().enumerate() {
        let (_, most) = range(piece, speeds2[k], limits, bound);
        let next2 = speeds2[k] + 2.0 * piece.length * most;
        speeds2[k + 1] = next2.min(reachable[k + 1]).min(piece.most2).max(0.0);
    }
    speeds2
}

/// Returns the duration of a motion, s. `speeds2`: speed² at each knot, (mm/s)², as [`optimum`] returns it.
pub fn duration(pieces: &[Piece], speeds2: &[f64]) -> f64 {
    pieces.iter().zip(speeds2.windows(2)).map(|(piece, v2)| 2.0 * piece.length / (v2[0].sqrt() + v2[1].sqrt())).sum()
}

/// Returns the steps of a motion along points. `pieces` has one piece between each two neighbouring points. Each axis
/// steps at the exact time at which it is half way to the next step.
fn steps(points: &[[f64; AXES]], pieces: &[Piece], speeds2: &[f64], limits: &Limits, hz: f64) -> Vec<Pulse> {
    let mut pulses = Vec::new();
    let mut begun = 0.0;
    for (k, piece) in pieces.iter().enumerate() {
        let (first2, last2) = (speeds2[k], speeds2[k + 1]);
        let time =
            |share: f64| 2.0 * share * piece.length / (first2.sqrt() + (first2 + (last2 - first2) * share).sqrt());
        for (axis, steps_per_mm) in limits.steps_per_mm.iter().enumerate() {
            let [from, to] = [k, k + 1].map(|n| points[n][axis] * steps_per_mm);
            let back = to < from;
            let (low, high) = (from.min(to), from.max(to));
            // The axis steps at each whole number plus 1/2 in (low, high].
            for step in (low - 0.5).floor() as i64 + 1..=(high - 0.5).floor() as i64 {
                let share = (step as f64 + 0.5 - from) / (to - from);
                let at = ((begun + time(share)) * hz) as u64;
                pulses.push(Pulse { at, steps: 1 << axis, directions: u8::from(back) << axis });
            }
        }
        begun += time(1.0);
    }
    pulses.sort_by_key(|pulse| pulse.at);
    pulses
}

/// Returns the intended chords of a course as unit vectors and lengths.
fn chords(course: &Course) -> (Vec<[f64; AXES]>, Vec<f64>) {
    let ways: Vec<[f64; AXES]> =
        course.meant.windows(2).map(|ends| std::array::from_fn(|i| ends[1][i] - ends[0][i])).collect();
    let lengths: Vec<f64> = ways.iter().map(|way| norm(*way)).collect();
    (ways.iter().zip(&lengths).map(|(way, length)| way.map(|part| part / length)).collect(), lengths)
}

fn norm(v: [f64; AXES]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns the angle between two unit vectors, rad.
fn angle(a: [f64; AXES], b: [f64; AXES]) -> f64 {
    (0..AXES).map(|i| a[i] * b[i]).sum::<f64>().clamp(-1.0, 1.0).acos()
}

/// Returns the maximum v² at each vertex by the rule for turns. The rule covers every part of the path, from a single
/// vertex to half a circle. For a part that is L long and turns by φ, the maximum is `a (L / φ + d s / (1 - s))`.
/// Here a is the acceleration across the path, d the junction deviation and s = cos(φ / 2).
fn speeds2_of_turns(chords: &[[f64; AXES]], lengths: &[f64], limits: &Limits, feed: f64) -> Vec<f64> {
    let mut most = vec![feed * feed; chords.len() + 1];
    for first in 1..chords.len() {
        let (mut length, mut whole) = (0.0, 0.0);
        for last in first..chords.len() {
            whole += angle(chords[last - 1], chords[last]);
            if last > first {
                length += lengths[last - 1];
            }
            if whole > PI + 1e-6 {
                break;
            }
            let (before, after) = (chords[first - 1], chords[last]);
            let vector: [f64; AXES] = std::array::from_fn(|i| (after[i] - before[i]).abs());
            let size = norm(vector);
            if size < 1e-7 {
                continue;
            }
            let acceleration = (0..AXES)
                .filter(|&i| vector[i] > 1e-9)
                .map(|i| limits.acceleration[i] * size / vector[i])
                .fold(f64::INFINITY, f64::min);
            let corner = norm(granted(before, after, Unsure::default(), limits, f64::INFINITY)) / size;
            let speed2 = acceleration * length / angle(before, after) + corner * corner;
            for vertex in &mut most[first..=last] {
                *vertex = vertex.min(speed2);
            }
        }
    }
    most
}

/// Returns the number of parts that a chord is cut into: at least two, so that the motion can start and end at rest.
fn parts(length: f64) -> u32 {
    (length / 0.05).ceil().clamp(2.0, 100.0) as u32
}

/// Returns the steps of a machine that follows a course at the maximum speed of the rule for turns (see
/// `speeds2_of_turns`). The maximum v² of the rule is multiplied by `excess`. If `excess` is above 1, the machine
/// breaks the rule.
pub fn by_the_rule(course: &Course, limits: &Limits, excess: f64, hz: f64) -> Vec<Pulse> {
    let (chords, lengths) = chords(course);
    let most = speeds2_of_turns(&chords, &lengths, limits, course.feed);
    let bend = |at: usize| -> [f64; AXES] {
        if at == 0 || at >= chords.len() {
            return [0.0; AXES];
        }
        std::array::from_fn(|i| (chords[at][i] - chords[at - 1][i]) / (0.5 * (lengths[at] + lengths[at - 1])))
    };
    let (mut pieces, mut points) = (Vec::new(), vec![course.written[0]]);
    for (k, chord) in chords.iter().enumerate() {
        let count = parts(lengths[k]);
        for part in 0..count {
            let mut curvature = [0.0; AXES];
            if count == 2 {
                // A chord cut into only two parts is short, so it can belong to a bend. In a bend at its maximum speed
                // no acceleration is left for a ramp. So the two parts get the curvature of the bend.
                let used = bend(k + part as usize);
                let across = (0..AXES).map(|i| used[i].abs() / limits.acceleration[i]).fold(0.0, f64::max);
                curvature = used.map(|x| x / excess / (across * most[k].max(most[k + 1])).max(1.0));
            }
            let entry2 = if part == 0 { excess * most[k] } else { f64::INFINITY };
            let (length, most2) = (lengths[k] / f64::from(count), course.feed * course.feed);
            pieces.push(Piece { tangent: *chord, curvature, length, entry2, most2 });
            let share = f64::from(part + 1) / f64::from(count);
            let ends = [course.written[k], course.written[k + 1]];
            points.push(std::array::from_fn(|i| ends[0][i] + (ends[1][i] - ends[0][i]) * share));
        }
    }
    let speeds2 = optimum(&pieces, limits, Bound::EachAxis);
    steps(&points, &pieces, &speeds2, limits, hz)
}
