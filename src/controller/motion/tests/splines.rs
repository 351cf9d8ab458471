//! Compares the chords of splines, and the steps made of them, with the exact Bezier curve, computed by its polynomial
//! in 64 bits.

use super::super::{Speed, Spline, SplineGeometry};
use super::rig::{Rig, mm, settings, to};
use crate::axes::PerAxis;
use crate::units::{Coordinate, DECIMAL_ONE, StepsPerMm};
use proptest::prelude::*;

type Point = [f64; 2];

fn f(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / DECIMAL_ONE as f64
}

fn geometry(points: [Point; 4]) -> SplineGeometry<3> {
    let [start, leaving, arriving, target] = points.map(|point| point.map(mm));
    SplineGeometry {
        start: PerAxis([start[0], start[1], mm(1.5)]),
        target: PerAxis([target[0], target[1], mm(1.5)]),
        leaving: [leaving[0] - start[0], leaving[1] - start[1]],
        arriving: [arriving[0] - target[0], arriving[1] - target[1]],
    }
}

/// Returns the control points of a geometry, rounded to 0.1 nm.
fn control(geometry: &SplineGeometry<3>) -> [Point; 4] {
    let place = |place: &PerAxis<Coordinate, 3>| [f(place.0[0]), f(place.0[1])];
    let (start, target) = (place(&geometry.start), place(&geometry.target));
    let beside = |place: Point, way: [Coordinate; 2]| [place[0] + f(way[0]), place[1] + f(way[1])];
    [start, beside(start, geometry.leaving), beside(target, geometry.arriving), target]
}

/// Returns the exact point at parameter `t`, by Bernstein's polynomials.
fn exact(points: &[Point; 4], t: f64) -> Point {
    let s = 1.0 - t;
    let weights = [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t];
    std::array::from_fn(|axis| weights.iter().zip(points).map(|(weight, point)| weight * point[axis]).sum())
}

fn distance(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}

/// Returns the distance of a point from a line segment.
fn from_piece(point: Point, a: Point, b: Point) -> f64 {
    let (way, to) = ([b[0] - a[0], b[1] - a[1]], [point[0] - a[0], point[1] - a[1]]);
    let square = way[0] * way[0] + way[1] * way[1];
    let share = if square > 0.0 { ((to[0] * way[0] + to[1] * way[1]) / square).clamp(0.0, 1.0) } else { 0.0 };
    distance(point, [a[0] + way[0] * share, a[1] + way[1] * share])
}

/// Checks all chords and the extent. Returns the number of chords.
fn check(geometry: &SplineGeometry<3>, tolerance: f64) -> usize {
    let points = control(geometry);
    let mut spline = Spline::new(geometry, tolerance as f32);
    let ends: Vec<_> = std::iter::from_fn(|| spline.next_chord()).collect();
    assert_eq!(ends.last(), Some(&geometry.target));
    assert_eq!(spline.next_chord(), None);
    let (least, greatest) = geometry.extent();
    let size = points.iter().map(|point| distance(*point, points[0])).fold(0.0, f64::max);
    let (mut low, mut high) = (points[0], points[0]);
    let mut before = points[0];
    for (k, end) in ends.iter().enumerate() {
        for axis in 0..3 {
            // Allows for three rounding errors.
            let slack = if k + 1 == ends.len() { 0 } else { 4 };
            assert!(end.0[axis].0 >= least.0[axis].0 - slack && end.0[axis].0 <= greatest.0[axis].0 + slack);
        }
        let count = ends.len() as f64;
        let end = [f(end.0[0]), f(end.0[1])];
        // The parameter has 30 bits. A side of the polygon is at most twice `size`, and the point moves at most three
        // sides per unit of the parameter. So one bit of the parameter moves the point by at most 6 / 2^30 of `size`.
        let off = distance(end, exact(&points, (k as f64 + 1.0) / count));
        assert!(off < 5e-7 + 6e-9 * size, "chord {k} ends {off} mm off");
        for part in 0..=8 {
            let point = exact(&points, (k as f64 + f64::from(part) / 8.0) / count);
            let off = from_piece(point, before, end);
            assert!(off < tolerance.max(1e-4) * 1.001 + 1e-6 + 6e-9 * size, "{off} mm off chord {k} of {count}");
            low = std::array::from_fn(|axis| low[axis].min(point[axis]));
            high = std::array::from_fn(|axis| high[axis].max(point[axis]));
        }
        before = end;
    }
    for axis in 0..2 {
        let (least, greatest) = (f(least.0[axis]), f(greatest.0[axis]));
        // The points lie within the extent, and the outermost ones close to its edges.
        assert!(least <= low[axis] + 4e-7 && greatest >= high[axis] - 4e-7, "axis {axis}");
        assert!(low[axis] - least < tolerance + 1e-6 && greatest - high[axis] < tolerance + 1e-6, "axis {axis}");
    }
    ends.len()
}

/// Returns a quarter of a circle, with an error of 0.03 %.
fn quarter(radius: f64) -> SplineGeometry<3> {
    const HANDLE: f64 = 0.552_284_75;
    geometry([[radius, 0.0], [radius, radius * HANDLE], [radius * HANDLE, radius], [0.0, radius]])
}

#[test]
fn the_chords_of_a_quarter_are_as_many_as_those_of_an_arc() {
    for radius in [0.01, 1.0, 30.0, 1000.0] {
        let chords = check(&quarter(radius), 0.002) as f64;
        let arc = std::f64::consts::FRAC_PI_2 / (2.0 * (1.0 - 0.002 / f64::max(radius, 0.01)).acos());
        assert!(chords < 1.2 * arc + 4.0, "{chords}, of an arc {arc}");
    }
}

#[test]
fn a_chord_bends_as_the_curve_does() {
    for radius in [1.0, 30.0, 1000.0] {
        let mut spline = Spline::new(&quarter(radius), 0.002);
        while spline.next_chord().is_some() {
            let share = f64::from(spline.curvature().radius) / radius;
            assert!((share - 1.0).abs() < 0.03, "{share}");
        }
    }
}

#[test]
fn curves_of_one_point_or_one_line() {
    let chords = |points| check(&geometry(points), 0.002);
    assert_eq!(chords([[3.0, -1.0]; 4]), 1);
    assert_eq!(chords([[0.0, 0.0], [1.0, 2.0], [2.0, 4.0], [3.0, 6.0]]), 1);
    // Special curves: back and forth on a line, a cusp, a loop, equal control points, maximum coordinates, and a tiny
    // curve.
    for points in [
        [[0.0, 0.0], [20.0, 10.0], [-10.0, -5.0], [6.0, 3.0]],
        [[0.0, 0.0], [10.0, 10.0], [0.0, 10.0], [10.0, 0.0]],
        [[0.0, 0.0], [30.0, 10.0], [-20.0, 10.0], [10.0, 0.0]],
        [[0.0, 0.0], [0.0, 0.0], [10.0, 5.0], [10.0, 5.0]],
        [[-20_000.0, 5.0], [45_000.0, 45_000.0], [-45_000.0, 45_000.0], [40_000.0, -3.0]],
        [[0.0, 0.0], [1e-6, 2e-6], [3e-6, 0.0], [0.0, 1e-6]],
    ] {
        check(&geometry(points), 0.002);
    }
}

#[test]
fn no_axis_but_x_and_y_moves() {
    let g = geometry([[0.0, 0.0], [5.0, 1.0], [9.0, -4.0], [3.0, 3.0]]);
    let mut spline = Spline::new(&g, 0.01);
    while let Some(place) = spline.next_chord() {
        assert_eq!(place.0[2], mm(1.5));
    }
}

fn anywhere(reach: f64) -> impl Strategy<Value = [Point; 4]> {
    prop::array::uniform4(prop::array::uniform2(-reach..reach))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    #[test]
    fn chords_of_any_curve(points in (-3.0_f64..3.0).prop_flat_map(|log| anywhere(10.0_f64.powf(log))), tolerance in 0.0_f64..0.1) {
        check(&geometry(points), tolerance);
    }

    /// Special curves: on a coarse grid, sides of the polygon are often equal, mirrored or of length 0.
    #[test]
    fn chords_of_special_curves(cells in prop::array::uniform8(-2_i32..=2), unit in 0.1_f64..50.0) {
        let at = |k: usize| [f64::from(cells[k]) * unit, f64::from(cells[k + 1]) * unit];
        check(&geometry([at(0), at(2), at(4), at(6)]), 0.002);
    }

    #[test]
    fn length_by_many_points(points in anywhere(100.0)) {
        let g = geometry(points);
        let points = control(&g);
        let count = 4000;
        let at = |k: i32| exact(&points, f64::from(k) / f64::from(count));
        let length: f64 = (0..count).map(|k| distance(at(k), at(k + 1))).sum();
        let share = f64::from(g.length()) / length;
        prop_assert!((share - 1.0).abs() < 0.004, "{share}");
    }
}

/// Runs a curve and checks that it ends exactly at its target. `every`: number of ticks between feed holds; `None`:
/// no holds, and the limits of the axes are checked, too. Returns the maximum distance of a step from the exact
/// curve, mm.
fn farthest_off(g: &SplineGeometry<3>, scale: f32, feed: f32, every: Option<usize>) -> f64 {
    let mut config = settings(100.0, 100.0, 500.0);
    config.steps_per_mm = PerAxis::all(StepsPerMm::new(scale).unwrap());
    let mut rig = Rig::<3, 64>::new(config);
    rig.motion.set_machine_position(&g.start);
    let mut spline = Spline::new(g, config.arc_tolerance);
    while let Some(place) = spline.next_chord() {
        let mut m = to([0.0; 3], Speed::Feed(feed));
        m.target = place;
        rig.moves.push_back(m);
        rig.bends.push_back(spline.curvature());
    }
    match every {
        None => {
            rig.run();
            rig.check_limits();
        }
        Some(every) => {
            rig.pump();
            rig.motion.start();
            while !(rig.moves.is_empty() && rig.motion.is_idle()) {
                rig.run_ticks(every);
                rig.motion.hold();
                assert!(rig.run_ticks(1_000_000));
                let observed = rig.observed();
                rig.motion.observe(&observed);
                rig.motion.resume();
                rig.pump();
            }
        }
    }
    let steps = |place: &PerAxis<Coordinate, 3>| config.steps_per_mm.zip(place, |scale, at| scale.steps(at));
    assert_eq!(rig.motion.machine_steps(), steps(&g.target));
    assert_eq!(rig.motion.planned_position(), g.target);
    let points = control(g);
    let dense: Vec<Point> = (0..=2000).map(|k| exact(&points, f64::from(k) / 2000.0)).collect();
    let mut place = steps(&g.start).0;
    let mut farthest = 0.0_f64;
    for record in &rig.trace {
        for (axis, place) in place.iter_mut().enumerate() {
            *place += i32::from(record.steps >> axis & 1) * if record.directions >> axis & 1 != 0 { -1 } else { 1 };
        }
        let tool = [f64::from(place[0]) / f64::from(scale), f64::from(place[1]) / f64::from(scale)];
        let off = dense.windows(2).map(|ends| from_piece(tool, ends[0], ends[1])).fold(f64::MAX, f64::min);
        farthest = farthest.max(off);
    }
    assert_eq!(place, steps(&g.target).0);
    farthest
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, ..ProptestConfig::default() })]

    /// The distance of a step is at most the tolerance of the chords plus √2·(1/2 + 1/14) of a step. The limit has a
    /// margin of 2·10^-4 mm. The distance is measured from a polygon of 2000 points, which is within 10^-5 mm of the
    /// curve.
    #[test]
    fn steps_of_any_curve_stay_near_it(
        points in anywhere(8.0), scale in prop_oneof![Just(80.0_f32), 40.0_f32..250.0], feed in 5.0_f32..100.0,
        every in prop::option::of(200_usize..3000),
    ) {
        let off = farthest_off(&geometry(points), scale, feed, every);
        let most = 0.002 + std::f64::consts::SQRT_2 * 4.0 / 7.0 / f64::from(scale) + 2e-4;
        prop_assert!(off <= most, "{off} mm, {most} allowed");
    }
}

/// The machine is slow at a cusp, and where the curve is tight.
#[test]
fn speed_where_a_curve_comes_to_a_point() {
    for points in [
        [[0.0, 0.0], [10.0, 10.0], [0.0, 10.0], [10.0, 0.0]],
        [[0.0, 0.0], [10.1, 10.0], [-0.1, 10.0], [10.0, 0.0]],
        [[0.0, 0.0], [9.9, 10.0], [0.1, 10.0], [10.0, 0.0]],
    ] {
        let mut config = settings(400.0, 100.0, 500.0);
        config.junction_deviation = 0.01;
        let mut rig = Rig::<3, 64>::new(config);
        let g = geometry(points);
        rig.motion.set_machine_position(&g.start);
        let mut spline = Spline::new(&g, config.arc_tolerance);
        while let Some(place) = spline.next_chord() {
            let mut m = to([0.0; 3], Speed::Feed(100.0));
            m.target = place;
            rig.moves.push_back(m);
            rig.bends.push_back(spline.curvature());
        }
        rig.run();
        rig.check_limits();
        // Measures the time above y = 7.45: 0.05 mm up to the cusp at y = 7.5, and 0.05 mm back.
        let (mut y, mut begin, mut end) = (0, None, 0);
        for record in &rig.trace {
            y += i32::from(record.steps >> 1 & 1) * if record.directions >> 1 & 1 != 0 { -1 } else { 1 };
            if f64::from(y) / 400.0 > 7.45 {
                begin.get_or_insert(record.time);
                end = record.time;
            }
        }
        let seconds = (end - begin.unwrap()) as f64 / f64::from(rig.hz);
        // Braking to rest within 0.05 mm at 500 mm/s² takes 14 ms, and so does speeding up on the way back. Without a
        // stop at the cusp, both together would take 1 ms.
        assert!(seconds > 0.02, "{seconds} s");
    }
}
