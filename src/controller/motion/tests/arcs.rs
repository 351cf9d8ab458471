//! Compares the chords of arcs, and the steps made of them, with the exact circle.

use super::super::on_heap;
use super::super::{Arc, ArcGeometry, Motion, Speed};
use super::rig::{Rig, mm, settings, to};
use crate::axes::{Arrangement, Axis, PerAxis};
use crate::messages::{AxisSteps, ToStep};
use crate::units::{Coordinate, DECIMAL_ONE};
use proptest::prelude::*;

const PLANES: [(Axis, Axis, Axis); 3] =
    [(Axis::X, Axis::Y, Axis::Z), (Axis::Z, Axis::X, Axis::Y), (Axis::Y, Axis::Z, Axis::X)];

fn f(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / DECIMAL_ONE as f64
}

/// Returns the geometry of an arc around `centre`, from the angle `from` over the angle `sweep` (rad; negative:
/// clockwise; more than 6.3 in either direction: a full circle). `rise`: displacement of the linear axis, mm.
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

/// Checks all chords: the ends lie on the circle, the middle lies within the tolerance, and the angles never turn
/// back. Returns the number of chords.
fn check(geometry: &ArcGeometry<3>, radius: f64, tolerance: f64) -> u32 {
    let centre = [
        f(geometry.start.get(geometry.axis_0).unwrap() + geometry.offset_0),
        f(geometry.start.get(geometry.axis_1).unwrap() + geometry.offset_1),
    ];
    let mut arc = Arc::new(geometry, tolerance as f32);
    let chords = u32::try_from(arc.chords_left()).unwrap();
    let flat = |p: &PerAxis<Coordinate, 3>| {
        [f(p.get(geometry.axis_0).unwrap()) - centre[0], f(p.get(geometry.axis_1).unwrap()) - centre[1]]
    };
    let mut last = flat(&geometry.start);
    let mut turned = 0.0;
    let mut end = geometry.start;
    // Allows for the rounding of the `f32` tolerance, and for the grid of 0.1 nm.
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

/// After 20,000 turns, the last chords still have equal angles and end on the circle.
#[test]
fn turns_add_no_error() {
    let (from, sweep) = (0.3, 1.0);
    let g = geometry(0, 1.0, from, sweep, 0.0, 20_000, [0.0, 0.0]);
    let mut arc = Arc::new(&g, 0.002);
    let left = arc.chords_left();
    let mut points = Vec::new();
    let mut count = 0;
    while let Some(point) = arc.next_chord() {
        count += 1;
        if arc.chords_left() < 30 {
            points.push(point);
        }
    }
    assert_eq!(count, left);
    let of_turn = 20_000.0 * std::f64::consts::PI / (1.0_f64 - 0.002).acos();
    assert!(left as f64 > of_turn && (left as f64) < of_turn + 2.0 * 20_000.0, "{left} chords, {of_turn} would do");
    let angle = |p: &PerAxis<Coordinate, 3>| f(p.0[1]).atan2(f(p.0[0]));
    let plain = points.iter().filter(|p| angle(p) > from + 1e-4 && angle(p) < from + sweep + 1e-4);
    let mut angles: Vec<f64> = plain.map(angle).collect();
    angles.dedup();
    let last: Vec<f64> = angles[angles.len() - 8..].to_vec();
    assert!(last.windows(3).all(|w| ((w[2] - w[1]) / (w[1] - w[0]) - 1.0).abs() < 1e-4), "{last:?}");
    assert!(points.iter().all(|p| (f(p.0[0]).hypot(f(p.0[1])) - 1.0).abs() < 1e-6));
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

/// Maximum distance of a step from an arc, in steps, without the tolerance of the chords. Two errors add up in each
/// axis. A step is at most 1/2 step off its chord. The ends of the chord are at most 1/14 step off, because they are
/// rounded to sevenths of a step. If both axes have the maximum error, the distance is √2 × (1/2 + 1/14) = √2 × 4/7.
const MOST_OFF: f64 = std::f64::consts::SQRT_2 * 4.0 / 7.0;

/// Runs an arc and checks that it ends exactly at its target. Returns how far the farthest step is from the circle,
/// in steps, after subtraction of the chords' tolerance.
fn farthest_off(geometry: &ArcGeometry<3>, config: super::super::MotionSettings<3>, feed: f32) -> f64 {
    let mut rig = Rig::<3, 64>::new(config);
    rig.motion.set_machine_position(&geometry.start);
    let mut arc = Arc::new(geometry, config.arc_tolerance);
    rig.arc = Some(arc.clone());
    while let Some(point) = arc.next_chord() {
        let mut m = to([0.0; 3], Speed::Feed(feed));
        m.target = point;
        rig.moves.push_back(m);
    }
    rig.run();
    rig.check_limits();
    let steps = |place: &PerAxis<Coordinate, 3>| {
        let mut place = *place;
        if config.arrangement == Arrangement::CoreXy {
            (place.0[0], place.0[1]) = (place.0[0] + place.0[1], place.0[0] - place.0[1]);
        }
        config.steps_per_mm.zip(&place, |scale, at| scale.steps(at))
    };
    assert_eq!(rig.motion.machine_steps(), steps(&geometry.target));
    assert_eq!(rig.motion.planned_position(), geometry.target);

    let plane = [geometry.axis_0, geometry.axis_1].map(Axis::index);
    let centre = [f(geometry.start.0[plane[0]] + geometry.offset_0), f(geometry.start.0[plane[1]] + geometry.offset_1)];
    let scales = config.steps_per_mm.0.map(|scale| f64::from(scale.to_f32()));
    let step = plane.map(|axis| 1.0 / scales[axis]).into_iter().fold(0.0, f64::max);
    let radius = f(geometry.offset_0).hypot(f(geometry.offset_1));
    let mut place = steps(&geometry.start).0;
    let mut farthest = 0.0_f64;
    for record in &rig.trace {
        for (axis, place) in place.iter_mut().enumerate() {
            *place += i32::from(record.steps >> axis & 1) * if record.directions >> axis & 1 != 0 { -1 } else { 1 };
        }
        let mut tool = place.map(f64::from);
        for (tool, scale) in tool.iter_mut().zip(scales) {
            *tool /= scale;
        }
        if config.arrangement == Arrangement::CoreXy {
            (tool[0], tool[1]) = ((tool[0] + tool[1]) / 2.0, (tool[0] - tool[1]) / 2.0);
        }
        let from = |n: usize| tool[plane[n]] - centre[n];
        let off = (from(0).hypot(from(1)) - radius).abs();
        farthest = farthest.max((off - f64::from(config.arc_tolerance)) / step);
    }
    assert_eq!(place, steps(&geometry.target).0);
    farthest
}

#[test]
fn steps_of_an_arc_stay_within_tolerance_and_four_fifths_of_a_step() {
    for radius in [0.1, 5.0, 60.0] {
        let g = geometry(0, radius, 0.0, -7.0, 0.0, 0, [-radius, 0.0]);
        let config = settings(200.0, 100.0, 800.0);
        let worst = farthest_off(&g, config, 40.0);
        assert!(worst <= MOST_OFF, "{worst} steps at radius {radius}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 150, ..ProptestConfig::default() })]

    /// No step is farther from the arc than `MOST_OFF`. The arc can start and end anywhere between two steps. The
    /// feed can have any value; at low feeds the ticks are finer than steps.
    #[test]
    fn steps_of_any_arc_stay_near_it(
        plane in 0_usize..3, log in -1.5_f64..1.7, from in -3.2_f64..3.2, sweep in 0.001_f64..6.27, left in any::<bool>(),
        rise in prop_oneof![Just(0.0), -2.0_f64..2.0], x in -50.0_f64..50.0, y in -50.0_f64..50.0,
        scales in prop_oneof![Just([80.0_f32; 3]), prop::array::uniform3(20.0_f32..800.0)],
        feed in prop_oneof![0.5_f32..5.0, 1.0_f32..100.0],
    ) {
        let radius = 10.0_f64.powf(log);
        let g = geometry(plane, radius, from, if left { sweep } else { -sweep }, rise, 0, [x, y]);
        let mut config = settings(100.0, 100.0, 800.0);
        config.steps_per_mm = PerAxis(scales.map(|scale| crate::units::StepsPerMm::new(scale).unwrap()));
        let worst = farthest_off(&g, config, feed);
        if config.steps_per_mm.0[0] == config.steps_per_mm.0[1] && plane == 0 {
            // A step of a motor moves the tool by 1/√2 of a step's length, along a diagonal. Each motor has the same
            // maximum error in steps, so the distance is smaller by √2.
            config.arrangement = Arrangement::CoreXy;
            let worst = farthest_off(&g, config, feed);
            prop_assert!(worst <= MOST_OFF / std::f64::consts::SQRT_2 + 0.003, "{worst} steps of motors");
        }
        // The margin is for the chords' rounding to 0.1 nm and to 32 bits.
        prop_assert!(worst <= MOST_OFF + 0.003, "{worst} steps");
    }
}

/// The last segment at constant speed reaches into the ramp after it. The ramp is not too steep, even if it has only a
/// few steps.
#[test]
fn a_short_ramp_behind_a_constant_speed_is_no_steeper() {
    let g = geometry(2, 10.0_f64.powf(0.6588462477398048), -2.276435767022154, -1.2119748809651154, 0.0, 0, [0.0, 0.0]);
    let mut config = settings(100.0, 100.0, 800.0);
    config.steps_per_mm = PerAxis([20.0, 20.0, 611.87946].map(|scale| crate::units::StepsPerMm::new(scale).unwrap()));
    farthest_off(&g, config, 3.7653491);
}

/// Runs an arc with a feed hold after every `every` ticks, and checks that the reported position is the actual one.
fn run_with_holds<const N: usize>(rig: &mut Rig<N, 16>, every: usize, end: PerAxis<i32, N>) {
    rig.pump();
    rig.motion.start();
    for _ in 0..10_000 {
        rig.run_ticks(every);
        rig.motion.hold();
        assert!(rig.run_ticks(1_000_000));
        let observed = rig.observed();
        rig.motion.observe(&observed);
        let lead = PerAxis(rig.motion.lead());
        let motors = rig.motion.machine_steps().zip(&lead, |tool, lead| tool + lead);
        assert_eq!(motors.0.map(i64::from), rig.position);
        rig.motion.resume();
        rig.pump();
        if rig.moves.is_empty() && rig.motion.is_idle() {
            assert_eq!(rig.motion.machine_steps(), end);
            return;
        }
    }
    panic!("does not finish");
}

#[test]
fn the_place_in_the_midst_of_a_chord_is_known() {
    for (every, radius, backlash) in [(7, 0.3, 0.0), (40, 2.0, 0.0), (301, 9.0, 0.0), (40, 2.0, 0.02), (7, 0.2, 0.013)]
    {
        let mut config = settings(163.0, 60.0, 500.0);
        config.backlash = PerAxis([backlash, backlash / 2.0, 0.0]);
        let mut rig = Rig::<3, 16>::new(config);
        let g = geometry(0, radius, 0.0, -7.0, 0.37, 0, [-radius, 0.0]);
        let mut arc = Arc::new(&g, config.arc_tolerance);
        rig.arc = Some(arc.clone());
        while let Some(point) = arc.next_chord() {
            let mut m = to([0.0; 3], Speed::Feed(15.0));
            m.target = point;
            rig.moves.push_back(m);
        }
        let end = config.steps_per_mm.zip(&g.target, |scale, at| scale.steps(at));
        run_with_holds(&mut rig, every, end);
    }
}

/// A chord ends between two steps. The step task receives how far each end is from the nearest step, in sevenths of a
/// step, counted in the direction of motion. This must be so on a machine with six axes, too.
#[test]
fn six_axes_have_their_ends() {
    let three = settings(10.0, 100.0, 500.0);
    let config = super::super::MotionSettings::<6> {
        arrangement: three.arrangement,
        steps_per_mm: PerAxis::all(three.steps_per_mm.0[0]),
        max_rate: PerAxis::all(100.0),
        least_feed: 0.0,
        acceleration: PerAxis::all(500.0),
        jerk: PerAxis::all(0.0),
        backlash: PerAxis::all(0.0),
        junction_deviation: 0.01,
        curve_share: 1.0,
        arc_tolerance: 0.002,
        step_clock_hz: 84_000_000,
    };
    let mut motion = Motion::<6>::new(config, on_heap(8));
    let zero = PerAxis::all(Coordinate::ZERO);
    let offsets = (Coordinate::mm(50), Coordinate::ZERO);
    let geometry: ArcGeometry<6> = ArcGeometry {
        start: zero,
        target: zero,
        axis_0: Axis::X,
        axis_1: Axis::Y,
        offset_0: offsets.0,
        offset_1: offsets.1,
        clockwise: true,
        turns: 0,
    };
    let arc = Arc::new(&geometry, 0.002);
    // 0.671 mm is 6 5/7 steps, which is 2/7 of a step before the nearest step, the seventh.
    let ends = [0.611, -0.611, 0.671, -0.671, 0.0, 0.029];
    motion.chord(&to(ends, Speed::Feed(10.0)), arc.curvature());
    motion.chord(&to([0.0; 6], Speed::Feed(10.0)), arc.curvature());
    motion.line(&to(ends, Speed::Feed(10.0)));
    motion.start();
    let mut blocks = Vec::new();
    // The simulated step task is idle again after each message.
    let mut observed = crate::messages::Observed { step_idle: true, ..Default::default() };
    while let Some(message) = motion.next(&observed) {
        match message {
            ToStep::BlockRest { steps_by_axis } => blocks.push(steps_by_axis),
            ToStep::Block { steps_by_axis, directions } => {
                let rest = blocks.pop().unwrap();
                assert_eq!(directions, if blocks.len() == 2 { 0b00_0101 } else { 0b00_1010 });
                blocks.extend([steps_by_axis, rest]);
            }
            ToStep::Segment(_) => observed.segments_begun += 1,
            _ => {}
        }
    }
    let with = |ends: [(u32, i32, i32); 3]| ends.map(|(steps, start, end)| AxisSteps::with_ends(steps, start, end));
    let there = [with([(6, 0, 1), (6, 0, 1), (7, 0, -2)]), with([(7, 0, -2), (0, 0, 0), (0, 0, 2)])];
    let back = [with([(6, -1, 0), (6, -1, 0), (7, 2, 0)]), with([(7, 2, 0), (0, 0, 0), (0, 2, 0)])];
    let line = [[6, 6, 7].map(AxisSteps::on_steps), [7, 0, 0].map(AxisSteps::on_steps)];
    assert_eq!(blocks, [there, back, line].concat());
}

#[test]
fn a_chord_of_very_many_steps_is_a_line() {
    let mut motion = Motion::<3>::new(settings(10_000.0, 800.0, 5000.0), on_heap(8));
    let g = geometry(0, 1.0e5, 0.0, 0.1, 0.0, 0, [-1.0e5, 0.0]);
    let arc = Arc::new(&g, 10.0);
    for x in [958.698_035, 1_917.396_14, 1_917.396_14] {
        assert!(motion.chord(&to([x, 1.000_03, 0.0], Speed::Feed(500.0)), arc.curvature()));
    }
    motion.start();
    let mut observed = crate::messages::Observed::default();
    let mut blocks = Vec::new();
    while let Some(message) = motion.next(&observed) {
        match message {
            ToStep::Block { steps_by_axis, .. } => blocks.push(steps_by_axis),
            ToStep::Segment(_) => observed.segments_begun += 1,
            _ => {}
        }
    }
    let ends = [AxisSteps::with_ends(9_586_980, 0, 2), AxisSteps::with_ends(10_000, 0, 2), AxisSteps::on_steps(0)];
    assert_eq!(blocks, [ends, [9_586_981, 0, 0].map(AxisSteps::on_steps)]);
}
