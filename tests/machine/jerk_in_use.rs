//! The jerk limit in motion other than a program's straight lines: arcs, homing, jogs and their cancel, parking,
//! backlash compensation, belts, and holds.
//!
//! Each test reads one quantity over time from the steps: the distance along an arc, or the position of an axis.
//! Between two steps it is interpolated, so it is up to a step off ([`UNCERTAIN`]; this includes the finer grid of
//! slow moves).
//!
//! Differences over a time h show the motion: the first is the mean speed × h, the second the mean acceleration × h²,
//! the third the mean jerk × h³. Each is compared with its limit × h, h² or h³. The allowances are 1, 2 and 3 % of
//! the limit, plus 2, 4 and 8 times the uncertainty of one position.

use super::estimator::TOLERANCE;
use super::oracle::AXES;
use oxmill_simulator::{Fittings, Options, Simulator, boards};
use oxmill_test_support::numbers;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::fmt::Write;
use std::time::Duration;

const HZ: f64 = boards::DESK.step_clock_hz as f64;
const STEPS: f64 = 400.0;
const RATE: f64 = 100.0;
const ACCELERATION: f64 = 500.0;
const JERK: f64 = 5000.0;
const PITCH: f64 = 1.0 / STEPS;
/// Uncertainty of a position that is interpolated between two steps, in steps.
const UNCERTAIN: f64 = 1.0;

fn mill(description: &str, more: &str) -> Simulator {
    let fittings = Fittings::parse(&format!("steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\n{description}")).unwrap();
    let mut mill = Simulator::new(Options { keep_steps: true, fittings, ..Options::default() });
    let mut text = String::from("$0=3\n$11=0.02\n");
    for axis in 0..AXES {
        writeln!(text, "$10{axis}={STEPS}\n$11{axis}={}\n$12{axis}={ACCELERATION}\n$22{axis}={JERK}", RATE * 60.0)
            .unwrap();
    }
    run(&mut mill, &format!("{text}{more}"));
    mill.trace_mut().restart();
    mill
}

/// Sends line by line and runs each to its end.
fn run(mill: &mut Simulator, text: &str) {
    for line in text.lines() {
        mill.send(format!("{line}\n"));
        assert!(mill.run_until_idle(), "{line}");
    }
    let said = mill.take_output();
    assert!(!said.contains("error") && !said.contains("ALARM"), "{text}: {said}");
}

/// Returns for each step event its time, s, and the positions of all axes, mm.
fn places(mill: &Simulator) -> Vec<(f64, [f64; AXES])> {
    mill.trace().kept().iter().map(|r| (r.at as f64 / HZ, r.position.map(|steps| f64::from(steps) / STEPS))).collect()
}

/// Returns the position at a time, interpolated in `course` (pairs of time and position).
fn at(course: &[(f64, f64)], time: f64) -> f64 {
    let next = course.partition_point(|p| p.0 <= time);
    match (next.checked_sub(1).and_then(|k| course.get(k)), course.get(next)) {
        (Some(a), Some(b)) => a.1 + (b.1 - a.1) * (time - a.0) / (b.0 - a.0),
        (Some(a), None) => a.1,
        (None, b) => b.map_or(0.0, |b| b.1),
    }
}

/// Compares speed, acceleration and jerk with bounds. `course`: pairs of time (s) and position. `bounds` returns the
/// three limits at a position. Where `exempt` returns `true` for one of the compared positions, nothing is checked.
fn check(course: &[(f64, f64)], bounds: impl Fn(f64) -> [f64; 3], exempt: impl Fn(f64) -> bool) -> Result<(), String> {
    let (Some(first), Some(last)) = (course.first(), course.last()) else { return Err("nothing moves".into()) };
    let mut compared = 0;
    for (order, weights) in [[-1.0, 1.0, 0.0, 0.0], [1.0, -2.0, 1.0, 0.0], [-1.0, 3.0, -3.0, 1.0]].iter().enumerate() {
        // h is so long that the allowance for the uncertainty is a tenth of the limit for speed, a sixteenth for
        // acceleration, and a quarter for jerk.
        let h = [20.0 * PITCH / RATE, (64.0 * PITCH / ACCELERATION).sqrt(), (32.0 * PITCH / JERK).cbrt()][order];
        let mut time = first.0 - 3.0 * h;
        while time < last.0 {
            let points = [0.0, 1.0, 2.0, 3.0].map(|k| at(course, time + k * h));
            if !points.iter().any(|place| exempt(*place)) {
                let seen: f64 = points.iter().zip(weights).map(|(place, weight)| place * weight).sum();
                let most = points.iter().map(|place| bounds(*place)[order]).fold(0.0, f64::max);
                let size = h.powi(order as i32 + 1);
                let slack = f64::from(2_u32 << order) * UNCERTAIN * PITCH;
                if seen.abs() > most * size * (1.0 + TOLERANCE * (order + 1) as f64) + slack {
                    return Err(format!("order {}: {} of {most} at {time} s, over {h} s", order + 1, seen / size));
                }
                compared += 1;
            }
            time += h / 3.0;
        }
    }
    if compared > 0 { Ok(()) } else { Err("nothing was compared".into()) }
}

/// Checks that each axis that moves keeps [`RATE`], [`ACCELERATION`] and [`JERK`]. `exempt` gets an axis and its
/// position in mm. Where it returns `true`, nothing is checked.
#[track_caller]
fn check_axes(places: &[(f64, [f64; AXES])], exempt: impl Fn(usize, f64) -> bool) {
    for axis in 0..AXES {
        let mut course: Vec<(f64, f64)> = Vec::new();
        for (time, place) in places {
            if course.last().is_none_or(|last| last.1 != place[axis]) {
                course.push((*time, place[axis]));
            }
        }
        if course.len() > 1 {
            check(&course, |_| [RATE, ACCELERATION, JERK], |place| exempt(axis, place))
                .unwrap_or_else(|why| panic!("axis {axis}: {why}"));
        }
    }
}

#[track_caller]
fn assert_counted(mill: &Simulator) {
    assert_eq!(mill.machine().position().map(|steps| f64::from(steps) / STEPS), mill.machine_position());
}

/// Checks the measurement itself: it must detect motion without a jerk limit, and motion with a jerk that is 50 % too
/// high.
#[test]
fn what_exceeds_the_jerk_limit_is_seen() {
    for jerk in [0.0, 1.5 * JERK] {
        let mut mill = mill("", &format!("$220={jerk}\n"));
        run(&mut mill, "G1 X40 F6000");
        let course: Vec<(f64, f64)> = places(&mill).iter().map(|(time, place)| (*time, place[0])).collect();
        let fault = check(&course, |_| [RATE, ACCELERATION, JERK], |_| false).unwrap_err();
        assert!(fault.starts_with("order 3"), "{fault}");
    }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 24, max_shrink_iters: 20, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default()
    })]

    /// The jerk along the path is bounded on circles and helices of any size and feed. The distance along the path is
    /// computed from the angle about the centre.
    #[test]
    fn jerk_is_bounded_on_arcs(
        radius in 1_u32..30, turns in 1_u32..4, depth in prop::sample::select(vec![0_i32, 0, -2, 9]), feed in 300_u32..6000,
        clockwise in any::<bool>(), touches in prop::collection::vec((20_u64..600, prop::sample::select(&[0x90, 0x91, 0x92, b'!', b'~'][..])), 0..4),
    ) {
        let mut mill = mill("", "");
        let radius = f64::from(radius);
        let code = if clockwise { 2 } else { 3 };
        mill.send(format!("G17 G21 G90\nG{code} X0 Y0 Z{depth} I{radius} J0 P{turns} F{feed}\n"));
        let touched = !touches.is_empty();
        for (milliseconds, touch) in touches {
            mill.run_for(Duration::from_millis(milliseconds));
            mill.send([touch]);
        }
        for _ in 0..2 {
            mill.run_for(Duration::from_secs(2));
            mill.send("~");
        }
        prop_assert!(mill.run_until_idle());
        let said = mill.take_output();
        prop_assert!(!said.contains("error") && !said.contains("ALARM"), "{said}");
        let end = [0.0, 0.0, f64::from(depth)];
        prop_assert_eq!(mill.machine().position().map(|steps| f64::from(steps) / STEPS), end);
        // `path`: mm of path per rad. `plane` and `across`: distance in the plane and along Z per mm of path.
        let angle = f64::from(turns) * std::f64::consts::TAU;
        let path = radius.hypot(f64::from(depth) / angle);
        let (plane, across) = (radius / path, (f64::from(depth) / angle / path).abs());
        let mut course = vec![(0.0, 0.0)];
        let mut before = std::f64::consts::PI;
        let mut whole = 0.0;
        for (time, place) in places(&mill) {
            let seen = place[1].atan2(place[0] - radius);
            let turn = (seen - before + 3.0 * std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
            whole += if clockwise { -turn } else { turn };
            before = seen;
            course.push((time, whole * path));
        }
        course.remove(0);
        prop_assert!((whole - angle).abs() < 2.0 * PITCH / radius, "{} of {} rad", whole, angle);
        // Only the acceleration along the path is checked, not the centripetal one. The axis with the largest share in
        // the path limits it.
        let most = |place: f64| {
            let angle = place / path;
            let share = angle.cos().abs().max(angle.sin().abs()) * plane;
            1.0 / share.max(across)
        };
        let fastest = f64::from(feed) / 60.0 * if touched { 2.0 } else { 1.0 };
        let checked = check(&course, |place| [fastest.min(RATE * most(place)), ACCELERATION * most(place), JERK * most(place)], |_| false);
        prop_assert!(checked.is_ok(), "{checked:?}");
    }

    #[test]
    fn jerk_is_bounded_in_jogs_and_their_cancel(
        jogs in prop::collection::vec((0..AXES, -40_i32..40, 60_u32..6000), 1..5), cancel in prop::option::of(5_u64..900),
    ) {
        let mut mill = mill("", "");
        for (axis, way, feed) in jogs {
            let letter = ['X', 'Y', 'Z'][axis];
            mill.send(format!("$J=G91 {letter}{way} F{feed}\n"));
        }
        if let Some(milliseconds) = cancel {
            mill.run_for(Duration::from_millis(milliseconds));
            mill.send([0x85]);
        }
        prop_assert!(mill.run_until_idle());
        prop_assert!(!mill.take_output().contains("error:9"));
        assert_counted(&mill);
        if !mill.trace().kept().is_empty() {
            // Where two jogs meet at a corner, the speed of an axis can jump, so only jogs along one axis are checked.
            let places = places(&mill);
            let (whole, _) = straight(&places);
            if whole {
                check_axes(&places, |_, _| false);
            }
        }
    }
}

/// Returns whether exactly one axis moves, and the first axis that moves.
fn straight(places: &[(f64, [f64; AXES])]) -> (bool, usize) {
    let moves = |axis: usize| places.iter().any(|p| p.1[axis] != places[0].1[axis]);
    let axes: Vec<usize> = (0..AXES).filter(|axis| moves(*axis)).collect();
    (axes.len() == 1, axes.first().copied().unwrap_or(0))
}

/// The jerk is bounded if a jog along one axis is cancelled at any moment of its ramps.
#[test]
fn jerk_is_bounded_when_a_jog_is_cancelled() {
    for milliseconds in (5..700).step_by(31) {
        let mut mill = mill("", "");
        mill.send("$J=G91 X50 F6000\n");
        mill.run_for(Duration::from_millis(milliseconds));
        mill.send([0x85]);
        assert!(mill.run_until_idle());
        assert_counted(&mill);
        check_axes(&places(&mill), |_, _| false);
    }
}

const SWITCHES: &str = r#"
    [[switch]]
    axis = "x"
    at_mm = 4.0
    side = "positive"
    [[switch]]
    axis = "y"
    at_mm = 4.0
    side = "positive"
    [[switch]]
    axis = "z"
    at_mm = 4.0
    side = "positive"
"#;
const CYCLE: &str = "$22=1\n$24=300\n$25=2400\n$27=3\n";

/// When the homing switch closes, the step task brakes with a constant deceleration, so the jerk is not checked there.
/// In all other motion of the cycle it is bounded.
#[test]
fn jerk_is_bounded_in_the_homing_cycle() {
    let mut mill = mill(SWITCHES, CYCLE);
    run(&mut mill, "$H");
    assert_eq!(mill.machine_position(), [-3.0; AXES]);
    let home = mill.machine().position();
    assert!(home.iter().all(|steps| (f64::from(*steps) / STEPS - 1.0).abs() < 0.01), "{home:?}");
    check_axes(&places(&mill), |_, place| place > 3.98);
    run(&mut mill, "G53 G0 X-20 Y-10");
    let there = mill.machine().position();
    assert_eq!((there[0] - home[0], there[1] - home[1]), (-17 * 400, -7 * 400));
}

#[test]
fn jerk_is_bounded_on_the_way_to_the_parking_place() {
    for milliseconds in [30, 90, 170, 260, 400] {
        let mut mill = mill(SWITCHES, &format!("{CYCLE}$41=1\n"));
        run(&mut mill, "$H\nG53 G0 X-20 Z-30\nM3 S500");
        mill.trace_mut().restart();
        let before = mill.machine().position();
        mill.send("G91 G1 X-12 F3000\n");
        mill.run_for(Duration::from_millis(milliseconds));
        mill.send([0x84]);
        mill.run_for(Duration::from_secs(20));
        let parked = mill.machine().position();
        assert!(parked[2] > before[2] + 20 * 400, "not parked: {parked:?} {before:?}");
        mill.send("~");
        mill.run_for(Duration::from_secs(20));
        assert!(mill.run_until_idle());
        let after = mill.machine().position();
        assert_eq!([after[0] - before[0], after[1] - before[1], after[2] - before[2]], [-12 * 400, 0, 0]);
        check_axes(&places(&mill), |_, _| false);
    }
}

/// While one axis takes up its backlash, the other continues along the path as smoothly as without backlash.
#[test]
fn jerk_is_bounded_while_backlash_is_taken_up() {
    let mut mill = mill("backlash_mm = [0.05, 0.0, 0.0]", "$160=0.05\n");
    run(&mut mill, "G90 G1 X12 Y12 F4000\nX2 Y2\nX2.5 Y2.5\nX-7 Y-7\nX0 Y0");
    mill.trace_mut().restart();
    mill.send("G1 X12 Y12 F4000\nX2 Y2\nX2.5 Y2.5\nX-7 Y-7\nX9 Y9\n");
    assert!(mill.run_until_idle());
    let driven = mill.fittings().driven_mm();
    assert!((0..AXES).all(|axis| (driven[axis] - [9.0, 9.0, 0.0][axis]).abs() < 1e-9), "{driven:?}");
    let free: Vec<(f64, [f64; AXES])> =
        places(&mill).into_iter().map(|(time, place)| (time, [0.0, place[1], 0.0])).collect();
    check_axes(&free, |_, _| false);
}

/// On CoreXY belts each motor moves two axes. The limits apply to the axes, not to the motors.
#[test]
fn jerk_is_bounded_on_belts() {
    let mut mill = mill("kinematics = \"corexy\"", "$904=1\n");
    // Each move goes from rest to rest, because a corner would be exempt from the check.
    run(&mut mill, "G90 G1 X30 F6000\nX0\nY25\nY0\nG0 X20 Y20\nX0 Y0\nG1 X10 Y5\nX0 Y0");
    assert_eq!(mill.machine().position(), [0; AXES]);
    let axes: Vec<(f64, [f64; AXES])> =
        places(&mill).into_iter().map(|(time, [a, b, z])| (time, [0.5 * (a + b), 0.5 * (a - b), z])).collect();
    check_axes(&axes, |_, _| false);
}

/// A hold must start within 25 ms of the command. Its start is computed back from its end. The shortest ramp down
/// from the speed v with the jerk J takes v / A + A / J. If the ramp does not reach the full deceleration A, it takes
/// 2 √(v / J).
#[test]
fn a_hold_with_jerk_limit_begins_within_25_ms() {
    for (feed, milliseconds) in [(6000, 500), (6000, 611), (3000, 333), (3000, 402), (1500, 700)] {
        let mut mill = mill("", "");
        let speed = f64::from(feed) / 60.0;
        mill.send(format!("G1 X100 F{feed}\n"));
        mill.run_for(Duration::from_millis(milliseconds));
        let asked = mill.clock().now() as f64 / HZ;
        mill.send("!");
        mill.run_for(Duration::from_secs(2));
        mill.send("?");
        let report = mill.take_output();
        assert!(report.contains("Hold:0"), "{report}");
        let course: Vec<(f64, f64)> = places(&mill).iter().map(|(time, place)| (*time, place[0])).collect();
        let (end, place) = course[course.len() - 1];
        assert_eq!(
            numbers::<3>(report.lines().find(|l| l.starts_with('<')).unwrap(), "MPos").unwrap()[0],
            (place * 1000.0).round() / 1000.0
        );
        let ramp = if speed * JERK > ACCELERATION * ACCELERATION {
            speed / ACCELERATION + ACCELERATION / JERK
        } else {
            2.0 * (speed / JERK).sqrt()
        };
        // After its last step the machine still moves by at least half a step, d. At the maximum jerk J, the last d
        // before rest takes (6 d / J)^(1/3).
        let rest = end + (6.0 * 0.5 * PITCH / JERK).cbrt();
        let begins = rest - ramp - asked;
        println!("F{feed}: the hold acts after {:.1} ms", begins * 1000.0);
        assert!(begins < 0.025 && begins > -0.003, "{begins} s");
        mill.send("~");
        assert!(mill.run_until_idle());
        assert_eq!(mill.machine().position(), [100 * 400, 0, 0]);
        check_axes(&places(&mill), |_, _| false);
    }
}
