//! A rotary fourth axis (A), checked on the steps of the machine. A moves evenly with X, Y and Z and ends at its
//! exact position. F has the meaning that RS274NGC specifies (2.1.2.5 and 2.1.2.6): along X, Y and Z if they move,
//! otherwise degrees per minute.

use oxmill_simulator::{Options, Simulator, boards};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

const HZ: f64 = boards::DESK.step_clock_hz as f64;
/// Steps per mm of X, Y and Z, and per degree of A.
const STEPS: [f64; 4] = [400.0, 320.0, 450.0, 100.0];
/// Acceleration of all axes, mm/s² (degrees/s² for A). It is so large that ramps take almost no time.
const ACCELERATION: f64 = 100_000.0;

fn mill() -> Simulator {
    let mut mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
    run(&mut mill, "$930=4\n$0=1\n");
    for (axis, steps) in STEPS.iter().enumerate() {
        run(&mut mill, &format!("$10{axis}={steps}\n$11{axis}=60000\n$12{axis}={ACCELERATION}\n"));
    }
    run(&mut mill, "G21 G91\n");
    mill.trace_mut().restart();
    mill
}

/// Sends all lines and runs them to the end.
fn run(mill: &mut Simulator, text: &str) {
    mill.send(text);
    assert!(mill.run_until_idle(), "{text}");
    let said = mill.take_output();
    assert!(!said.contains("error") && !said.contains("ALARM"), "{text}: {said}");
}

/// Returns the time in seconds and the positions of all axes in steps at each step event.
fn course(mill: &Simulator) -> Vec<(f64, [f64; 4])> {
    let place = |record: &oxmill_simulator::trace::StepRecord| {
        let ([x, y, z], [a]) = (record.position, record.rotary);
        [x, y, z, a].map(f64::from)
    };
    mill.trace().kept().iter().map(|record| (record.at as f64 / HZ, place(record))).collect()
}

/// Returns the seconds from the first to the last step.
fn seconds(mill: &Simulator) -> f64 {
    let course = course(mill);
    course.last().expect("it moves").0 - course[0].0
}

/// Runs a line on a new machine and returns the seconds from its first to its last step.
fn time_of(line: &str) -> f64 {
    let mut mill = mill();
    run(&mut mill, &format!("{line}\n"));
    seconds(&mill)
}

#[track_caller]
fn near(found: f64, expected: f64) {
    assert!((found - expected).abs() < 0.01 * expected + 0.002, "{found} s, not {expected}");
}

#[test]
fn f_is_along_x_y_and_z_or_degrees_per_minute() {
    near(time_of("G1 X30 Y40 F600"), 5.0);
    near(time_of("G1 X30 Y40 A90 F600"), 5.0);
    near(time_of("G1 X30 Y40 A-720 F600"), 5.0);
    near(time_of("G1 A90 F600"), 9.0);
    near(time_of("G20 G1 A90 F600"), 9.0);
    near(time_of("G20 G1 X1 A90 F10"), 6.0);
    near(time_of("G93 G1 X1 A90 F12"), 5.0);
    near(time_of("G93 G1 A90 F12"), 5.0);
    near(time_of("$J=A90 F600"), 9.0);
}

/// If A turns during an arc or helix, the arc still takes the time that F gives along X, Y and Z. The test drives a
/// quarter of a circle of radius 20 mm, and a helix of three turns, 5 mm each, in two planes. F is 600 mm/min.
#[test]
fn an_arc_takes_it_along_and_keeps_its_feed() {
    let quarter = 20.0 * core::f64::consts::FRAC_PI_2 / 10.0;
    near(time_of("G2 X20 Y-20 J-20 F600"), quarter);
    near(time_of("G2 X20 Y-20 J-20 A90 F600"), quarter);
    near(time_of("G2 X20 Y-20 J-20 A-900 F600"), quarter);
    let turns = ((6.0 * core::f64::consts::PI * 10.0).powi(2) + 15.0 * 15.0_f64).sqrt() / 10.0;
    near(time_of("G17 G3 Z15 I10 P3 F600"), turns);
    near(time_of("G17 G3 Z15 I10 P3 A1080 F600"), turns);
    near(time_of("G19 G3 X15 J10 P3 A45 F600"), turns);
    near(time_of("G93 G2 X20 Y-20 J-20 A90 F12"), 5.0);
}

/// A's maximum rate limits the move, however large F is.
#[test]
fn its_own_rate_bounds_the_path() {
    let mut mill = mill();
    run(&mut mill, "$113=3600\nG1 X10 A120 F6000\n");
    near(seconds(&mill), 2.0);
    assert_eq!(mill.machine().motors(), [4000, 0, 0, 12_000]);
}

/// A turns in proportion to the angle about the arc's centre.
#[test]
fn it_turns_evenly_along_an_arc() {
    let mut mill = mill();
    run(&mut mill, "G2 X40 I20 A300 F1200\n");
    for (_, [x, y, _, a]) in course(&mill) {
        let (x, y) = (20.0 - x / STEPS[0], y / STEPS[1]);
        let turned = y.atan2(x) / core::f64::consts::PI;
        // A may be off by the sum of two angles: two steps of Y on the circle, seen from its centre, and one step of A.
        let slack = 2.0 / STEPS[1] / 20.0 / core::f64::consts::PI + 1.0 / STEPS[3] / 300.0;
        assert!((turned - a / STEPS[3] / 300.0).abs() < slack, "{turned} {a}");
    }
    assert_eq!(mill.machine().motors(), [16_000, 0, 0, 30_000]);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: RngSeed::Fixed(930), ..ProptestConfig::default() })]

    /// At every step of a line, each axis is within a step of its position on the line. Each line ends within half a
    /// step of its exact position, however many lines precede it.
    #[test]
    fn it_interpolates_with_the_others(
        ways in prop::collection::vec(prop::array::uniform4(-2000_i32..2000), 1..6), feed in 60_u32..6000,
    ) {
        let mut mill = mill();
        let mut place = [0.0; 4];
        for way in ways {
            let step = way.map(|hundredths| f64::from(hundredths) / 100.0);
            if step == [0.0; 4] {
                continue;
            }
            mill.trace_mut().restart();
            let from = mill.machine().motors().map(f64::from);
            let [x, y, z, a] = step;
            run(&mut mill, &format!("G1 X{x:.2} Y{y:.2} Z{z:.2} A{a:.2} F{feed}\n"));
            place = std::array::from_fn(|axis| place[axis] + step[axis]);
            let motors: [f64; 4] = mill.machine().motors().map(f64::from);
            let whole: [f64; 4] = std::array::from_fn(|axis| motors[axis] - from[axis]);
            let dominant = (0..4).max_by(|a, b| whole[*a].abs().total_cmp(&whole[*b].abs())).unwrap_or(0);
            for (_, steps) in course(&mill) {
                // `part` is the share of the line that has been covered. It is read from the dominant axis, which is
                // itself up to half a step ahead or behind. So each axis may be off by a whole step.
                let part = (steps[dominant] - from[dominant]) / whole[dominant];
                for axis in 0..4 {
                    let meant = from[axis] + whole[axis] * part;
                    prop_assert!((steps[axis] - meant).abs() < 1.01, "axis {axis}: {} for {meant}", steps[axis]);
                }
            }
            for axis in 0..4 {
                prop_assert!((motors[axis] - place[axis] * STEPS[axis]).abs() < 0.501, "axis {axis}: {motors:?} {place:?}");
            }
        }
    }
}

/// With three axes in use, the machine makes the same steps at the same times, whether or not a fourth axis was
/// configured before.
#[test]
fn three_axes_are_as_without_it() {
    let job = "G21 G90\nG1 X3 Y2 F900\nG2 X6 Y5 I3\nG0 Z1\nG1 X0.1 Y0.2 Z0.3\n";
    let steps = |fourth: bool| {
        let mut mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
        if fourth {
            run(&mut mill, "$930=4\n$103=33.3\nG0 A7.1\nG28.1\n$930=3\n");
            mill.trace_mut().restart();
        }
        run(&mut mill, job);
        let kept = mill.trace().kept();
        let first = kept.first().expect("it moves").busy;
        let steps = kept.iter().map(|record| (record.busy - first, record.steps, record.directions));
        (steps.collect::<Vec<_>>(), mill.machine().position())
    };
    let ((without, place), (with, other_place)) = (steps(false), steps(true));
    assert!(without.len() > 1000);
    assert_eq!((without.len(), place), (with.len(), other_place));
    for (one, other) in without.iter().zip(&with) {
        // A move made before this job can leave part of a tick that is carried over, so times may differ by a tick.
        assert!(
            one.0.abs_diff(other.0) <= 1 && (one.1, one.2) == (other.1, other.2),
            "{one:?}, with A before: {other:?}"
        );
    }
}

/// A path tolerance applies to X, Y and Z only: lines along which A turns stay exact, however little A turns.
#[test]
fn a_path_tolerance_leaves_moves_with_it_exact() {
    let digest = |path: &str, a: &str| {
        let mut mill = mill();
        let back = a.replace("A", "A-");
        let lines = [("X5", a), ("Y5", a), ("X-5", back.as_str()), ("Y0.02", a), ("Y0.03 X0.001", a), ("X-5 Y3", a)];
        let lines: String = lines.iter().map(|(way, a)| format!("{way} {a}\n")).collect();
        run(&mut mill, &format!("{path}\nG1 F6000\n{lines}"));
        (mill.trace().digest().order_hash(), mill.trace().digest().time_hash())
    };
    assert_ne!(digest("G64 P0.2", ""), digest("G61", ""), "corners are rounded");
    assert_eq!(digest("G64 P0.2", "A7"), digest("G61", "A7"));
    assert_eq!(digest("G64 P0.2", "A0.01"), digest("G61", "A0.01"));
}

/// A move of a chain: distances in 0.1 um and 0.1 millidegree, and F in mm/min, or in moves per second with G93.
type Link = ([i32; 4], u32);

/// Returns a program of 1500 moves, made by repeating `links`, and the time that its F words prescribe, s.
fn chain(links: &[Link], inverse_time: bool) -> (String, f64) {
    let (mut text, mut seconds) = (String::from(if inverse_time { "G93\n" } else { "G94\n" }), 0.0);
    for (way, feed) in links.iter().cycle().take(1500) {
        let [x, y, z, a] = way.map(|part| f64::from(part) / 10_000.0);
        let linear = (x * x + y * y + z * z).sqrt();
        let feed = if inverse_time { feed * 60 } else { *feed };
        text += &format!("G1 X{x:.4} Y{y:.4} Z{z:.4} A{a:.4} F{feed}\n");
        seconds +=
            60.0 / f64::from(feed) * if inverse_time { 1.0 } else { [a.abs(), linear][usize::from(linear > 0.0)] };
    }
    (text, seconds)
}

/// Generates moves along X, mostly shorter than a step. Some also turn A, and if `most_y` is not 0, some also move Y.
fn links(feed: core::ops::Range<u32>, most_y: i32) -> impl Strategy<Value = Vec<Link>> {
    let way = (1..25, 0..=most_y, 0..100, prop_oneof![4 => Just(1), 1 => Just(10)], 0..4);
    let way = way.prop_map(|(x, y, a, far, kind)| [x * far, y * far * (kind & 1), 0, a * far * (kind >> 1)]);
    prop::collection::vec((way, feed), 2..7)
}

/// Returns two ratios for a chain of moves. The first is the duration of the chain divided by the time that its F words
/// prescribe. The second is the tolerance of the first ratio: one step of X divided by the chain's length along X. A
/// tolerance is needed because durations are measured from the first to the last step only.
fn time_in_terms_of_meant(links: &[Link], inverse_time: bool) -> (f64, f64) {
    let (text, meant) = chain(links, inverse_time);
    let mut mill = mill();
    run(&mut mill, &text);
    let way: f64 = links.iter().cycle().take(1500).map(|(way, _)| f64::from(way[0]) / 10_000.0).sum();
    (seconds(&mill) / meant, 1.0 / (STEPS[0] * way))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, rng_seed: RngSeed::Fixed(931), ..ProptestConfig::default() })]

    /// Some moves are too short to make a step. Such moves, together with the next move that makes a step, take the
    /// time that F gives them. This holds whatever A does, and with equal or different feeds. Y does not move here.
    /// Otherwise the controller would join lines that go back and forth in Y to one straight line, which is shorter.
    #[test]
    fn chains_of_moves_shorter_than_a_step_take_their_time(even in links(30..31, 0), odd in links(30..120, 0)) {
        for links in [even, odd] {
            let (ratio, step) = time_in_terms_of_meant(&links, false);
            // A step is made at the feed of the move that completes it, even if moves with other feeds have contributed
            // to the step. So a chain can take longer than its F words say, but not less time.
            let slowest = links.iter().map(|(_, feed)| *feed).min().unwrap_or(1);
            let all_slow: Vec<Link> = links.iter().map(|(way, _)| (*way, slowest)).collect();
            let most = chain(&all_slow, false).1 / chain(&links, false).1;
            prop_assert!((0.99 - step..1.35 * most).contains(&ratio), "{ratio} of the time of {links:?}");
        }
    }

    #[test]
    fn chains_in_inverse_time_take_it(even in links(100..101, 19), odd in links(100..400, 19)) {
        for links in [even, odd] {
            let (ratio, step) = time_in_terms_of_meant(&links, true);
            prop_assert!((0.95 - step..1.06).contains(&ratio), "{ratio} of the time of {links:?}");
        }
    }
}
