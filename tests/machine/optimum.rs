//! The shortest time in which a path can be taken, in `f64`, with the whole of it in view: what a controller with an endless
//! queue and no rounding would do. A reference for times, and a source of motion that is known to be within its limits.
//!
//! The path is given as pieces with their tangent x' and curvature x'' (by the length). With speed v and acceleration u
//! along the path each axis has the acceleration `x'' v² + x' u`, which stays within its limit. Backward from the end: the
//! greatest v² of each knot from which the rest can still be driven; forward: the greatest u that stays below that. The set
//! of (v², u) is convex and holds (0, 0), so this is the optimum, but for the length of the pieces.

use super::estimator::Limits;
use super::oracle::{AXES, Pulse};

/// A part of a path that is short enough to have one tangent and one curvature.
#[derive(Clone, Copy, Debug)]
pub struct Piece {
    pub tangent: [f64; AXES],
    /// 1/mm.
    pub curvature: [f64; AXES],
    /// mm.
    pub length: f64,
    /// Greatest speed² where it begins, and on it; (mm/s)².
    pub entry2: f64,
    pub most2: f64,
}

/// What bounds the acceleration across and along.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Bound {
    /// Each axis its own.
    EachAxis,
    /// Their resultant: no more in any direction than the weakest axis can. On a circle the speed is even.
    Resultant,
}

/// The accelerations along the path that the axes can bear on a piece which is entered at `v2`.
fn range(piece: &Piece, v2: f64, limits: &Limits, bound: Bound) -> (f64, f64) {
    let twice = 2.0 * piece.length;
    // Not below a stop at its end.
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
        // At the beginning and at the end, where v² is v2 + 2 u length.
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

/// Speed² at each knot, from rest to rest.
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

/// Seconds.
pub fn duration(pieces: &[Piece], speeds2: &[f64]) -> f64 {
    pieces.iter().zip(speeds2.windows(2)).map(|(piece, v2)| 2.0 * piece.length / (v2[0].sqrt() + v2[1].sqrt())).sum()
}

/// The steps of such a motion along points, one piece between each two of them: each axis steps where it is half a step
/// on, at the exact time.
pub fn steps(points: &[[f64; AXES]], pieces: &[Piece], speeds2: &[f64], limits: &Limits, hz: f64) -> Vec<Pulse> {
    let mut pulses = Vec::new();
    let mut begun = 0.0;
    for (k, piece) in pieces.iter().enumerate() {
        let (first2, last2) = (speeds2[k], speeds2[k + 1]);
        let time =
            |share: f64| 2.0 * share * piece.length / (first2.sqrt() + (first2 + (last2 - first2) * share).sqrt());
        for axis in 0..AXES {
            let [from, to] = [k, k + 1].map(|n| points[n][axis] * limits.steps_per_mm[axis]);
            let back = to < from;
            let (low, high) = (from.min(to), from.max(to));
            // The halves in (low, high].
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
