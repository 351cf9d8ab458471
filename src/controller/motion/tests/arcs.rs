//! Chords against the exact circle, and through the steps.

use super::super::{Arc, ArcGeometry, Speed};
use super::rig::{Rig, mm, settings, to};
use crate::axes::{Axis, PerAxis};
use crate::units::{Coordinate, DECIMAL_ONE};
use proptest::prelude::*;

const PLANES: [(Axis, Axis, Axis); 3] =
    [(Axis::X, Axis::Y, Axis::Z), (Axis::Z, Axis::X, Axis::Y), (Axis::Y, Axis::Z, Axis::X)];

fn f(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / DECIMAL_ONE as f64
}

/// A geometry from polar data.
fn geometry(
    plane: usize,
    radius: f64,
    from: f64,
    sweep: f64,
    rise: f64,
    turns: u32,
    centre: [f64; 2],
) -> ArcGeometry<3> {
    let (axis_0, axis_1, linear) = PLANES[plane];
    let mut start = PerAxis::all(Coordinate::ZERO);
    let mut target = start;
    let at = |angle: f64| [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()];
    let [a, b] = at(from);
    start.set(axis_0, mm(a));
    start.set(axis_1, mm(b));
    let end = if sweep.abs() > 6.3 { from } else { from + sweep };
    let [c, d] = at(end);
    target.set(axis_0, mm(c));
    target.set(axis_1, mm(d));
    target.set(linear, mm(rise));
    ArcGeometry {
        start,
        target,
        axis_0,
        axis_1,
        offset_0: mm(centre[0]) - mm(a),
        offset_1: mm(centre[1]) - mm(b),
        clockwise: sweep < 0.0,
        turns,
    }
}

/// Checks all chords: both ends on the circle, the middle within tolerance, angles in order; gives the number of chords.
fn check(geometry: &ArcGeometry<3>, radius: f64, tolerance: f64) -> u32 {
    let centre = [
        f(geometry.start.get(geometry.axis_0).unwrap() + geometry.offset_0),
        f(geometry.start.get(geometry.axis_1).unwrap() + geometry.offset_1),
    ];
    let mut arc = Arc::new(geometry, tolerance as f32);
    let chords = arc.chords_left();
    let flat = |p: &PerAxis<Coordinate, 3>| {
        [f(p.get(geometry.axis_0).unwrap()) - centre[0], f(p.get(geometry.axis_1).unwrap()) - centre[1]]
    };
    let mut last = flat(&geometry.start);
    let mut turned = 0.0;
    let mut end = geometry.start;
    // The f32 tolerance itself, and the grid of 0.1 nm.
    let slack = tolerance * 1e-3 + 3e-7 + radius * 3e-9;
    while let Some(point) = arc.next_chord() {
        let here = flat(&point);
        let off = here[0].hypot(here[1]) - radius;
        assert!(off.abs() <= slack, "end {off}");
        let middle = (0.5 * (here[0] + last[0])).hypot(0.5 * (here[1] + last[1])) - radius;
        assert!(middle.abs() <= tolerance + slack || radius <= tolerance, "middle {middle} of {tolerance}");
        let angle = (last[0] * here[1] - last[1] * here[0]).atan2(last[0] * here[0] + last[1] * here[1]);
        let angle = if geometry.clockwise { -angle } else { angle };
        assert!(angle > 0.0 || chords == 1, "turns back by {angle}");
        turned += angle;
        last = here;
        end = point;
    }
    assert_eq!(end, geometry.target);
    let rise = f(geometry.target.0[0]) * 0.0;
    let whole = (turned / std::f64::consts::TAU + 1e-6).floor() as u32;
    if chords > 1 {
        assert!(whole >= geometry.turns, "{whole} turns");
        let linear = Axis::ALL.into_iter().take(3).find(|a| *a != geometry.axis_0 && *a != geometry.axis_1).unwrap();
        let up = f(geometry.target.get(linear).unwrap() - geometry.start.get(linear).unwrap());
        let length = (radius * turned).hypot(up) + rise;
        assert!((f64::from(arc.length()) / length - 1.0).abs() < 1e-4, "{} of {length}", arc.length());
    }
    assert!((f64::from(arc.radius()) / radius - 1.0).abs() < 1e-5);
    assert_eq!(arc.chords_left(), 0);
    chords
}

#[test]
fn full_circles_in_all_planes() {
    for plane in 0..3 {
        for radius in [0.1, 1.0, 5.0, 100.0, 1000.0, 10_000.0] {
            for sweep in [7.0, -7.0] {
                let chords = check(&geometry(plane, radius, 1.1, sweep, 0.0, 0, [3.0, -4.0]), radius, 0.002);
                let least = std::f64::consts::PI / (1.0 - 0.002 / radius).acos();
                assert!(
                    f64::from(chords) < least + 2.0 && f64::from(chords) > 0.99 * least.min(4.0),
                    "{chords} chords, {least} would do"
                );
            }
        }
    }
}

#[test]
fn helix_of_many_turns() {
    for plane in 0..3 {
        check(&geometry(plane, 12.0, 0.3, 2.0, -7.5, 9, [0.0, 0.0]), 12.0, 0.002);
        check(&geometry(plane, 10_000.0, 0.3, -2.0, 100.0, 2, [0.0, 0.0]), 10_000.0, 0.002);
    }
}

#[test]
fn degenerate_arcs_end_at_the_target() {
    let mut geometry = geometry(0, 5.0, 0.0, 1.0, 0.0, 0, [0.0, 0.0]);
    geometry.offset_0 = Coordinate::ZERO;
    geometry.offset_1 = Coordinate::ZERO;
    let mut arc = Arc::new(&geometry, 0.002);
    assert_eq!(arc.next_chord(), Some(geometry.target));
    assert_eq!(arc.next_chord(), None);
    geometry.offset_0 = Coordinate(1);
    geometry.target = geometry.start;
    for tolerance in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let mut arc = Arc::new(&geometry, tolerance);
        let mut end = None;
        while let Some(point) = arc.next_chord() {
            end = Some(point);
        }
        assert_eq!(end, Some(geometry.target));
    }
}

proptest! {
    #[test]
    fn any_arc_is_round(
        plane in 0_usize..3, log in -1.0_f64..4.0, from in -3.2_f64..3.2, sweep in 0.001_f64..6.27, left in any::<bool>(),
        rise in -30.0_f64..30.0, turns in 0_u32..3, x in -500.0_f64..500.0, y in -500.0_f64..500.0,
    ) {
        let radius = 10.0_f64.powf(log);
        let sweep = if left { sweep } else { -sweep };
        check(&geometry(plane, radius, from, sweep, rise, turns, [x, y]), radius, 0.002);
    }

    #[test]
    fn a_spiral_keeps_between_its_radii(growth in -0.004_f64..0.004, sweep in 0.1_f64..6.0) {
        let mut g = geometry(0, 4.0, 0.0, sweep, 0.0, 0, [0.0, 0.0]);
        g.target.0[0] = mm((4.0 + growth) * sweep.cos());
        g.target.0[1] = mm((4.0 + growth) * sweep.sin());
        let mut arc = Arc::new(&g, 0.002);
        while let Some(p) = arc.next_chord() {
            let off = f(p.0[0]).hypot(f(p.0[1])) - 4.0;
            prop_assert!(off >= growth.min(0.0) - 1e-5 && off <= growth.max(0.0) + 1e-5);
        }
    }
}

#[test]
fn steps_of_an_arc_stay_within_tolerance_and_a_step_and_a_quarter() {
    for radius in [0.1, 5.0, 60.0] {
        let config = settings(200.0, 100.0, 800.0);
        let mut rig = Rig::<3, 64>::new(config);
        let g = geometry(0, radius, 0.0, -7.0, 0.0, 0, [-radius, 0.0]);
        let mut arc = Arc::new(&g, config.arc_tolerance);
        while let Some(point) = arc.next_chord() {
            let mut m = to([0.0; 3], Speed::Feed(40.0));
            m.target = point;
            rig.moves.push_back(m);
        }
        rig.run();
        rig.check_limits();
        let (mut x, mut y) = (0_i64, 0_i64);
        let mut worst = 0.0_f64;
        for record in &rig.trace {
            x += i64::from(record.steps & 1) * if record.directions & 1 != 0 { -1 } else { 1 };
            y += i64::from(record.steps >> 1 & 1) * if record.directions & 2 != 0 { -1 } else { 1 };
            let off = (x as f64 / 200.0 + radius).hypot(y as f64 / 200.0) - radius;
            worst = worst.max(off.abs());
        }
        assert_eq!((x, y), (0, 0));
        assert!(worst <= 0.002 + 1.25 / 200.0, "{worst} at radius {radius}");
    }
}
