//! Short moves that continue a line are joined into one block. Checks that this block still passes all points, and that
//! the look-ahead is longer than without joining.

use super::super::on_heap;
use super::super::{Motion, MotionSettings, Move, Speed};
use super::rig::{Rig, settings, to};
use crate::axes::{Arrangement, PerAxis};
use crate::messages::{Observed, ToStep};
use crate::units::StepsPerMm;
use proptest::prelude::*;

const FEED: Speed = Speed::Feed(100.0);

/// Returns the points at which moves along a straight line end. They are rounded to multiples of `digit` (mm).
fn chords(length: f64, angle: f64, chord: f64, digit: f64) -> Vec<[f64; 3]> {
    let (y, x) = angle.to_radians().sin_cos();
    let count = (length / chord).round();
    let point = |k: u32| [x, y, 0.0].map(|share| (share * length * f64::from(k) / count / digit).round() * digit);
    (1..=count as u32).map(point).collect()
}

fn run_all<const B: usize>(config: MotionSettings<3>, points: &[[f64; 3]]) -> Rig<3, B> {
    let mut rig = Rig::<3, B>::new(config);
    rig.moves.extend(points.iter().map(|point| to(*point, FEED)));
    rig.run();
    rig
}

#[test]
fn a_line_in_tiny_chords_takes_the_time_of_one() {
    for (angle, digit) in [(0.0, 1e-3), (90.0, 1e-3), (33.0, 1e-3), (40.0, 1e-3), (21.3, 1e-4), (117.0, 1e-5)] {
        for (scale, jerk) in [(80.0, 0.0), (250.0, 0.0), (80.0, 20_000.0), (250.0, 20_000.0)] {
            for chord in [0.005, 0.002] {
                let mut config = settings(scale, 100.0, 500.0);
                config.jerk = PerAxis::all(jerk);
                let points = chords(40.0, angle, chord, digit);
                let pieces = run_all::<512>(config, &points);
                let whole = run_all::<512>(config, &points[points.len() - 1..]);
                assert_eq!(pieces.position, whole.position);
                let ratio = pieces.seconds() / whole.seconds();
                assert!(ratio < 1.02, "{ratio}: {chord} mm at {angle}°, {digit}, {scale} steps/mm, jerk {jerk}");
                pieces.check_acceleration(false);
            }
        }
    }
}

#[test]
fn along_an_axis_the_steps_are_those_of_one_line() {
    let points = chords(5.0, 0.0, 0.0037, 1e-4);
    let order = |rig: &Rig<3, 512>| -> Vec<(u8, u8)> {
        rig.trace.iter().filter(|r| r.steps != 0).map(|r| (r.steps, r.directions)).collect()
    };
    let pieces = run_all::<512>(settings(250.0, 100.0, 500.0), &points);
    let whole = run_all::<512>(settings(250.0, 100.0, 500.0), &points[points.len() - 1..]);
    assert_eq!(order(&pieces), order(&whole));
    assert!(pieces.blocks.len() < points.len() / 50);
}

/// Returns the number of blocks for 40 short moves in a line along X, each modified by `change`.
fn queued(change: impl Fn(usize, &mut Move<3>)) -> usize {
    let mut motion = Motion::<3>::new(settings(250.0, 100.0, 500.0), on_heap(64));
    for k in 0..40 {
        let mut m = to([f64::from(k + 1) * 0.01, 0.0, 0.0], FEED);
        change(k as usize, &mut m);
        assert!(motion.line(&m));
    }
    motion.queued_blocks()
}

#[test]
fn only_moves_of_one_kind_are_joined() {
    assert_eq!(queued(|_, _| {}), 1);
    assert_eq!(queued(|_, m| m.speed = Speed::Rapid), 1);
    assert_eq!(queued(|_, m| m.line_number = 7), 1);
    assert_eq!(queued(|k, m| m.line_number = k as u32), 40, "reports tell each N word");
    assert_eq!(queued(|k, m| m.power = if k < 10 { 5 } else { 6 }), 2);
    assert_eq!(queued(|k, m| m.scale_power = (10..20).contains(&k)), 3);
    assert_eq!(queued(|k, m| m.speed = Speed::Feed(if k % 20 < 10 { 100.0 } else { 101.0 })), 4);
    assert_eq!(queued(|k, m| m.speed = if k < 15 { FEED } else { Speed::Rapid }), 2);
    assert_eq!(queued(|_, m| m.speed = Speed::Duration(0.1)), 40, "each takes its time");
    assert_eq!(queued(|_, m| m.no_feed_override = true), 40, "a jog or probe");
    // Moves back and forth, moves around a corner and longer moves are not joined.
    assert_eq!(queued(|k, m| m.target.0[0].0 *= if k % 2 == 0 { 1 } else { -1 }), 40);
    assert_eq!(
        queued(|k, m| m.target = if k < 20 { m.target } else { to([0.2, 0.01 * (k - 19) as f64, 0.0], FEED).target }),
        2
    );
    assert_eq!(queued(|_, m| m.target.0[0].0 *= 5), 40);
    assert_eq!(queued(|_, m| m.target.0[0].0 *= 4), 4, "half a millimetre at most");
}

#[test]
fn joined_moves_count_for_the_start() {
    let mut motion = Motion::<3>::new(settings(250.0, 100.0, 500.0), on_heap(64));
    for k in 0..64 {
        assert!(!motion.has_joined_enough(), "{k} moves");
        assert!(motion.line(&to([f64::from(k + 1) * 0.001, 0.0, 0.0], FEED)));
    }
    // Four of these moves make one step.
    assert!(motion.queued_blocks() <= 2);
    for k in 64..256 {
        assert!(motion.line(&to([f64::from(k + 1) * 0.001, 0.0, 0.0], FEED)));
    }
    assert!(motion.has_joined_enough());
}

#[test]
fn a_raster_changes_its_power_where_the_program_does() {
    let mut motion = Motion::<3>::new(settings(250.0, 100.0, 500.0), on_heap(512));
    let power = |k: usize| [0, 0, 300, 300, 300, 7, 0, 0, 0, 900][k / 3 % 10];
    for k in 0..300 {
        let mut m = to([(k + 1) as f64 * 0.02, 0.0, 0.0], FEED);
        m.power = power(k);
        assert!(motion.line(&m));
    }
    assert!(motion.queued_blocks() < 80, "{}", motion.queued_blocks());
    motion.start();
    let mut observed = Observed { segments_begun: 0, step_idle: false, rx_free: 0, received: 1, activity: 0 };
    let mut units = 0;
    while let Some(message) = motion.next(&observed) {
        let ToStep::Segment(segment) = message else { continue };
        observed.segments_begun += 1;
        // Each move has 5 steps of 16 units.
        let begin = units;
        units += u32::from(segment.ticks) * (16 >> segment.level);
        assert_eq!(segment.power, power(begin as usize / 80), "at {begin} units");
        assert_eq!(segment.power, power((units - 1) as usize / 80), "before {units} units");
    }
    assert_eq!(units, 300 * 80);
}

/// Settings of a machine in the property tests. `scales`: steps/mm of each motor. For all axes: `jerk` in mm/s³ and
/// `backlash` in mm (0 = none).
#[derive(Clone, Debug)]
struct Machine {
    scales: [f32; 3],
    core_xy: bool,
    jerk: f32,
    backlash: f32,
}

impl Machine {
    fn any() -> impl Strategy<Value = Machine> {
        let scale = || prop::sample::select(vec![40.0_f32, 80.0, 250.0, 400.0, 1000.0]);
        (prop::array::uniform3(scale()), any::<bool>(), any::<bool>(), any::<bool>()).prop_map(
            |(scales, core_xy, jerk, backlash)| Machine {
                scales: if core_xy { [scales[0], scales[0], scales[2]] } else { scales },
                core_xy,
                jerk: if jerk { 20_000.0 } else { 0.0 },
                backlash: if backlash { 0.05 } else { 0.0 },
            },
        )
    }

    fn settings(&self) -> MotionSettings<3> {
        let mut config = settings(80.0, 100.0, 500.0);
        config.steps_per_mm = PerAxis(self.scales.map(|scale| StepsPerMm::new(scale).unwrap()));
        config.acceleration = PerAxis([500.0, 400.0, 50.0]);
        config.jerk = PerAxis::all(self.jerk);
        config.backlash = PerAxis::all(self.backlash);
        if self.core_xy {
            config.arrangement = Arrangement::CoreXy;
        }
        config
    }

    /// Returns the motors' position, in steps, for a position of the tool, in mm.
    fn motors(&self, [x, y, z]: [f64; 3]) -> [f64; 3] {
        let way = if self.core_xy { [x + y, x - y, z] } else { [x, y, z] };
        std::array::from_fn(|motor| way[motor] * f64::from(self.scales[motor]))
    }
}

/// Generates paths of one to five lines or bends in short chords, with points rounded to three to five decimals. Each
/// line or bend has a direction and a turn per chord, both in degrees, and a chord length in mm.
fn polylines() -> impl Strategy<Value = Vec<[f64; 3]>> {
    let piece = (0.0..360.0_f64, prop_oneof![Just(0.0), -3.0..3.0_f64], 0.001..0.05_f64, 1_usize..120, -0.3..0.3_f64);
    (prop::collection::vec(piece, 1..6), prop::sample::select(vec![1e-3, 1e-4, 1e-5])).prop_map(|(pieces, digit)| {
        let (mut place, mut points) = ([0.0_f64; 3], Vec::new());
        for (mut angle, turn, chord, count, rise) in pieces {
            for _ in 0..count {
                let (y, x) = angle.to_radians().sin_cos();
                place = [place[0] + x * chord, place[1] + y * chord, place[2] + rise * chord];
                points.push(place.map(|v| (v / digit).round() * digit));
                angle += turn;
            }
        }
        points
    })
}

/// Asserts that `places` lie along the polyline `corners`, in its order, at most `off` away in each axis. All values
/// are in steps.
fn assert_along(places: &[[f64; 3]], corners: &[[f64; 3]], off: f64) {
    let mut first = 0;
    let near = |place: [f64; 3], piece: usize| {
        let (from, to) = (corners[piece], corners[piece + 1]);
        let (mut least, mut most) = (0.0_f64, 1.0_f64);
        for axis in 0..3 {
            let (way, part) = (to[axis] - from[axis], place[axis] - from[axis]);
            if way.abs() > 1e-9 {
                let (one, other) = ((part - off) / way, (part + off) / way);
                (least, most) = (least.max(one.min(other)), most.min(one.max(other)));
            } else if part.abs() > off {
                return false;
            }
        }
        least <= most
    };
    for place in places {
        while first + 1 < corners.len() && !near(*place, first) {
            first += 1;
        }
        assert!(first + 1 < corners.len(), "{place:?} is not along the path");
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 96, failure_persistence: None, ..ProptestConfig::default() })]

    /// Whichever moves are joined, the steps follow the program's points to the end. The acceleration stays within
    /// its limits, even with a feed hold.
    #[test]
    fn the_path_is_the_programs(
        machine in Machine::any(), points in polylines(), hold in prop::option::of(0_usize..400), early in 1_usize..600,
    ) {
        let mut rig = Rig::<3, 512>::new(machine.settings());
        // Some moves are queued before the start and the others while it runs.
        for point in points.iter().take(early) {
            rig.motion.line(&to(*point, FEED));
            if machine.jerk > 0.0 {
                rig.motion.queue.planner.assert_consistent();
            }
        }
        rig.moves.extend(points.iter().skip(early).map(|point| to(*point, FEED)));
        rig.motion.start();
        if let Some(at) = hold {
            while rig.stepper.segments_begun() < at as u32 && !rig.run_ticks(1) {}
            rig.motion.hold();
            prop_assert!(rig.run_ticks(10_000_000));
            let observed = rig.observed();
            rig.motion.observe(&observed);
            rig.motion.resume();
        }
        rig.run();
        prop_assert!(rig.events.is_empty());
        if machine.backlash == 0.0 {
            let mut corners = vec![[0.0; 3]];
            corners.extend(points.iter().map(|point| machine.motors(*point)));
            let mut at = [0.0; 3];
            let mut places = Vec::new();
            for record in &rig.trace {
                for axis in (0..3).filter(|axis| record.steps >> axis & 1 != 0) {
                    at[axis] += if record.directions >> axis & 1 != 0 { -1.0 } else { 1.0 };
                }
                places.push(at);
            }
            // The limit of 1.5 steps is the sum of three errors of half a step each: at the ends of blocks, on the line
            // between these ends, and at the points that a joined block passes.
            assert_along(&places, &corners, 1.5 + 1e-6);
            rig.check_acceleration(hold.is_some());
        }
        let end = machine.motors(points[points.len() - 1]);
        let tool = rig.motion.machine_steps().0;
        for axis in 0..3 {
            prop_assert!((f64::from(tool[axis]) - end[axis]).abs() <= 0.5 + 1e-6, "{tool:?} for {end:?}");
        }
    }

    /// A stop while moves are being joined discards them: the position is where the motors have stopped, and the next
    /// move begins there.
    #[test]
    fn after_a_stop_nothing_is_joined_to_what_was_forgotten(points in polylines(), ticks in 1_usize..3000) {
        let mut rig = Rig::<3, 512>::new(settings(250.0, 100.0, 500.0));
        rig.moves.extend(points.iter().map(|point| to(*point, FEED)));
        rig.pump();
        rig.motion.start();
        rig.run_ticks(ticks);
        rig.moves.clear();
        let event = rig.stop();
        rig.flush();
        rig.handle_stop(event);
        let stopped = rig.motion.machine_steps().0;
        prop_assert_eq!(stopped.map(i64::from), rig.position);
        let back = stopped.map(|steps| f64::from(steps) / 250.0 + 0.02);
        rig.moves.push_back(to(back, FEED));
        rig.run();
        prop_assert_eq!(rig.position, stopped.map(|steps| i64::from(steps) + 5));
    }
}
