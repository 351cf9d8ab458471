//! The bounding box of an arc, for soft limits. The box covers both ends of the arc. It also covers each quarter point
//! of the circle (0, 90, 180, 270 degrees) that lies on the arc.

use super::arc::{ArcGeometry, integer_length};
use crate::axes::{Axis, PerAxis};
use crate::units::Coordinate;

const TURN: f32 = core::f32::consts::TAU;
const QUARTER: f32 = core::f32::consts::FRAC_PI_2;

/// Returns the minimum and the maximum machine coordinate of each axis on an arc or helix.
#[inline(never)]
pub fn extent<const N: usize>(arc: &ArcGeometry<N>) -> (PerAxis<Coordinate, N>, PerAxis<Coordinate, N>) {
    let mut least = arc.start.zip(&arc.target, |a, b| a.min(b));
    let mut greatest = arc.start.zip(&arc.target, |a, b| a.max(b));
    let of = |place: &PerAxis<Coordinate, N>, axis| place.get(axis).unwrap_or(Coordinate::ZERO);
    let centre = [of(&arc.start, arc.axis_0) + arc.offset_0, of(&arc.start, arc.axis_1) + arc.offset_1];
    let to = [of(&arc.target, arc.axis_0) - centre[0], of(&arc.target, arc.axis_1) - centre[1]];
    let first = libm::atan2f(-arc.offset_1.to_mm(), -arc.offset_0.to_mm());
    // Returns the rotation from one angle to another in the arc's direction, rad: at least 0, less than a turn. The
    // angles must be less than two turns apart.
    let forward = |from: f32, to: f32| {
        let mut way = if arc.clockwise { from - to } else { to - from };
        while way < 0.0 {
            way += TURN;
        }
        if way >= TURN { way - TURN } else { way }
    };
    // Uses the sweep that the chords use. A sweep computed here from the end points alone could differ, because a tiny
    // arc and almost a full turn have nearly the same end points.
    let sweep = if arc.turns > 0 { TURN } else { arc.sweep() };
    // The radius is in whole units of 0.1 nm. So if a circle touches the end of an axis' travel, rounding does not move
    // it beyond that end.
    let radius = integer_length(arc.offset_0.0, arc.offset_1.0).max(integer_length(to[0].0, to[1].0));
    let radius = Coordinate(radius);
    // The circle's farthest points are at 0, 90, 180 and 270 degrees from axis 0.
    let farthest: [(f32, Axis, Coordinate); 4] = [
        (0.0, arc.axis_0, centre[0] + radius),
        (QUARTER, arc.axis_1, centre[1] + radius),
        (2.0 * QUARTER, arc.axis_0, centre[0] - radius),
        (3.0 * QUARTER, arc.axis_1, centre[1] - radius),
    ];
    for (angle, axis, place) in farthest {
        if forward(first, angle) < sweep {
            least.set(axis, of(&least, axis).min(place));
            greatest.set(axis, of(&greatest, axis).max(place));
        }
    }
    (least, greatest)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arc(start: [f64; 2], target: [f64; 2], centre: [f64; 2], clockwise: bool) -> ArcGeometry<3> {
        let mm = |v: f64| Coordinate((v * 1.0e7).round() as i64);
        ArcGeometry {
            start: PerAxis([mm(start[0]), mm(start[1]), Coordinate::ZERO]),
            target: PerAxis([mm(target[0]), mm(target[1]), Coordinate::mm(3)]),
            axis_0: Axis::X,
            axis_1: Axis::Y,
            offset_0: mm(centre[0] - start[0]),
            offset_1: mm(centre[1] - start[1]),
            clockwise,
            turns: 0,
        }
    }

    /// For many arcs, the bounding box equals that of ten thousand points of the same arc.
    #[test]
    fn agrees_with_points_on_the_arc() {
        for k in 0..400 {
            let k = f64::from(k);
            let (radius, a, sweep) = (0.5 + k * 0.37, k * 0.71, 0.01 + (k * 1.37) % 6.25);
            let clockwise = k as i32 % 2 == 0;
            let b = if clockwise { a - sweep } else { a + sweep };
            let at = |angle: f64| [7.0 + radius * angle.cos(), -3.0 + radius * angle.sin()];
            let (least, greatest) = extent(&arc(at(a), at(b), [7.0, -3.0], clockwise));
            let (mut low, mut high) = ([f64::MAX; 2], [f64::MIN; 2]);
            for step in 0..=10_000 {
                let point = at(a + (b - a) * f64::from(step) / 10_000.0);
                for i in 0..2 {
                    low[i] = low[i].min(point[i]);
                    high[i] = high[i].max(point[i]);
                }
            }
            for i in 0..2 {
                let tolerance = 2.0e-3;
                assert!((least.0[i].0 as f64 * 1e-7 - low[i]).abs() < tolerance, "{k} {i}");
                assert!((greatest.0[i].0 as f64 * 1e-7 - high[i]).abs() < tolerance, "{k} {i}");
            }
            assert_eq!(greatest.0[2], Coordinate::mm(3));
        }
    }

    /// For an arc that ends next to its start, extent and chords agree on whether it is a whole circle.
    #[test]
    fn agrees_with_the_chords_where_start_and_end_are_near() {
        let mut whole = 0;
        for k in 0..4000_i64 {
            let (radius, a) = (10.0 + k as f64 * 0.01, k as f64 * 0.71);
            let start = [radius * a.cos(), radius * a.sin()];
            let off = (k * 7919 % 401 - 200) as f64 * 1.0e-8 * radius;
            let target = [start[0] - off * a.sin(), start[1] + off * a.cos()];
            let arc = arc(start, target, [0.0, 0.0], k % 2 == 0);
            let (least, greatest) = extent(&arc);
            let mut chords = super::super::arc::Arc::new(&arc, 0.01);
            let is_whole = chords.chords_left() > 4;
            whole += u32::from(is_whole);
            while let Some(point) = chords.next_chord() {
                for i in 0..2 {
                    let slack = 2_000;
                    assert!(point.0[i].0 >= least.0[i].0 - slack && point.0[i].0 <= greatest.0[i].0 + slack, "{k}");
                }
            }
            assert_eq!(is_whole, greatest.0[0].0 - least.0[0].0 > (radius * 1.0e7) as i64, "{k}");
        }
        assert!(whole > 500 && whole < 3500, "{whole}");
    }

    #[test]
    fn a_circle_that_touches_an_end_does_not_leave_it() {
        for micrometres in 1..2000 {
            let radius = f64::from(micrometres) * 0.333;
            let (least, greatest) = extent(&arc([-2.0 * radius, 0.0], [-2.0 * radius, 0.0], [-radius, 0.0], true));
            assert_eq!((greatest.0[0], least.0[0]), (Coordinate::ZERO, Coordinate(-(20.0e6 * radius).round() as i64)));
        }
    }

    #[test]
    fn a_full_circle_reaches_all_round() {
        let (least, greatest) = extent(&arc([1.0, 0.0], [1.0, 0.0], [0.0, 0.0], true));
        assert_eq!((least.0[0], greatest.0[1]), (Coordinate::mm(-1), Coordinate::mm(1)));
    }
}
