//! Jerk-limited motion: the jerk is bounded at all times. Splitting a path into blocks costs no time, and durations
//! are near the shortest possible.

use super::estimator::{Limits, Line, check, check_jerk};
use super::oracle::AXES;
use super::rig::{HZ, Rig};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;
use std::fmt::Write;

const MACHINE: Limits =
    Limits { steps_per_mm: [400.0; AXES], rate: [200.0; AXES], acceleration: [500.0; AXES], junction_deviation: 0.02 };

fn settings(limits: &Limits, jerk: [f64; AXES]) -> String {
    let mut text = format!("$0=1\n$11={}\n", limits.junction_deviation);
    for (axis, jerk) in jerk.iter().enumerate() {
        writeln!(text, "$10{axis}={}", limits.steps_per_mm[axis]).unwrap();
        writeln!(text, "$11{axis}={}", limits.rate[axis] * 60.0).unwrap();
        writeln!(text, "$12{axis}={}", limits.acceleration[axis]).unwrap();
        writeln!(text, "$22{axis}={jerk}").unwrap();
    }
    text
}

/// A program of straight moves, with its expected end position (um) and its lines.
#[derive(Clone, Debug)]
struct Job {
    text: String,
    at: [i64; AXES],
    lines: Vec<Line>,
}

fn mm(place: [i64; AXES]) -> [f64; AXES] {
    place.map(|v| v as f64 / 1000.0)
}

impl Job {
    fn new() -> Job {
        Job { text: "G21 G90 G94 G17\n".into(), at: [0; AXES], lines: Vec::new() }
    }

    /// Appends a move to a position in mm, rounded to micrometres, at a feed in mm/s.
    fn to(&mut self, place: [f64; AXES], feed: f64) {
        let place = place.map(|v| (v * 1000.0).round() as i64);
        if place == self.at {
            return;
        }
        let [x, y, z] = mm(place);
        writeln!(self.text, "G1 X{x:.3} Y{y:.3} Z{z:.3} F{:.3}", feed * 60.0).unwrap();
        self.lines.push(Line { from: mm(self.at), to: mm(place), feed: Some(feed) });
        self.at = place;
    }

    fn line(length: f64, blocks: u32, feed: f64) -> Job {
        let mut job = Job::new();
        for k in 1..=blocks {
            job.to([length * f64::from(k) / f64::from(blocks), 0.0, 0.0], feed);
        }
        job
    }

    /// Runs the job on a machine, checks the path and all limits, and returns the seconds from the first to the last
    /// step.
    fn run(&self, limits: &Limits, jerk: [f64; AXES]) -> f64 {
        let mut rig = Rig::with(&settings(limits, jerk));
        rig.run_clean(&self.text);
        assert_eq!(rig.place, limits.place(mm(self.at)));
        check(&rig.trace, HZ as f64, &self.lines, limits).unwrap();
        let most = jerk.map(|j| if j > 0.0 { j } else { f64::INFINITY });
        if jerk != [0.0; AXES] {
            check_jerk(&rig.trace, HZ as f64, &self.lines, limits, most).unwrap();
        }
        (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
    }
}

/// Returns the shortest time of a change of speed, s, and the distance covered in it, mm. `from`, `to`: mm/s.
fn ramp(from: f64, to: f64, acceleration: f64, jerk: f64) -> (f64, f64) {
    let change = (to - from).abs();
    let time = if change * jerk >= acceleration * acceleration {
        change / acceleration + acceleration / jerk
    } else {
        2.0 * (change / jerk).sqrt()
    };
    (time, 0.5 * (from + to) * time)
}

/// Returns the shortest time for a distance, s. `from`, `to`: speeds at its ends, where the acceleration is zero;
/// `most`: maximum speed. Bisection finds the highest speed from which the motion can still slow down to the end
/// speed.
fn least_time(length: f64, from: f64, to: f64, most: f64, acceleration: f64, jerk: f64) -> f64 {
    let needs = |top: f64| ramp(from, top, acceleration, jerk).1 + ramp(top, to, acceleration, jerk).1;
    let (mut low, mut high) = (from.max(to), most);
    if needs(high) > length {
        for _ in 0..60 {
            let middle = 0.5 * (low + high);
            if needs(middle) > length { high = middle } else { low = middle }
        }
    }
    let top = high;
    let (up, up_way) = ramp(from, top, acceleration, jerk);
    let (down, down_way) = ramp(top, to, acceleration, jerk);
    up + down + (length - up_way - down_way) / top
}

const JERK: f64 = 5000.0;

/// Returns the time, s, that the trace of a job does not cover. The motor moves by half a step before its first step
/// and by half a step after its last one. Each half step takes a few milliseconds.
fn of_steps() -> f64 {
    2.0 * (6.0 * 0.5 / MACHINE.steps_per_mm[0] / JERK).cbrt()
}

/// Compares the durations of five jobs with the shortest possible ones. At a corner or a change of feed, the controller
/// lets the acceleration along the path fall to zero. The computed shortest time does the same.
#[test]
fn jobs_take_little_more_than_the_shortest_time() {
    let a = MACHINE.acceleration[0];
    let mut rows: Vec<(&str, f64, f64)> = Vec::new();

    rows.push((
        "long line",
        Job::line(150.0, 1, 100.0).run(&MACHINE, [JERK; 3]),
        least_time(150.0, 0.0, 0.0, 100.0, a, JERK),
    ));
    rows.push((
        "line of a millimetre",
        Job::line(1.0, 1, 100.0).run(&MACHINE, [JERK; 3]),
        least_time(1.0, 0.0, 0.0, 100.0, a, JERK),
    ));

    let mut zigzag = Job::new();
    for k in 0..12 {
        zigzag.to([if k % 2 == 0 { 25.0 } else { 0.0 }, 0.0, 0.0], 100.0);
    }
    rows.push(("zigzag", zigzag.run(&MACHINE, [JERK; 3]), 12.0 * least_time(25.0, 0.0, 0.0, 100.0, a, JERK)));

    let mut square = Job::new();
    for place in [[20.0, 0.0], [20.0, 20.0], [0.0, 20.0], [0.0, 0.0]] {
        square.to([place[0], place[1], 0.0], 80.0);
    }
    let corner = MACHINE.junction([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.0);
    let sides = [[0.0, corner], [corner, corner], [corner, corner], [corner, 0.0]];
    let ideal = sides.iter().map(|[v0, v1]| least_time(20.0, *v0, *v1, 80.0, a, JERK)).sum();
    rows.push(("square", square.run(&MACHINE, [JERK; 3]), ideal));

    let mut capped = Job::new();
    for (x, feed) in [(60.0, 100.0), (75.0, 40.0), (140.0, 100.0)] {
        capped.to([x, 0.0, 0.0], feed);
    }
    let ideal = least_time(60.0, 0.0, 40.0, 100.0, a, JERK) + 15.0 / 40.0 + least_time(65.0, 40.0, 0.0, 100.0, a, JERK);
    rows.push(("slower feed in the middle", capped.run(&MACHINE, [JERK; 3]), ideal));

    for (job, seconds, ideal) in rows {
        let whole = seconds + of_steps();
        println!("{job}: {whole:.3} s, {ideal:.3} s at least: {:+.1} %", (whole / ideal - 1.0) * 100.0);
        assert!(whole < ideal * 1.05, "{job}");
        assert!(whole > ideal * 0.98, "{job}: faster than possible");
    }
}

/// Splitting a path into blocks costs no time, neither where the machine ramps nor on a curve.
#[test]
fn borders_of_blocks_cost_no_time() {
    let whole = Job::line(50.0, 1, 100.0).run(&MACHINE, [JERK; 3]);
    let chain = Job::line(50.0, 500, 100.0).run(&MACHINE, [JERK; 3]);
    assert!((chain / whole - 1.0).abs() < 0.005, "{whole} s in one block, {chain} s in 500");
    // A straight line along the tangent leads into a circle of R = 10 mm, on which v² = a·R allows more than the feed.
    let mut circle = Job::new();
    circle.to([0.0, 30.0, 0.0], 60.0);
    for k in 1..=900 {
        let angle = f64::from(k) * 0.01;
        circle.to([10.0 * angle.cos() - 10.0, 10.0 * angle.sin() + 30.0, 0.0], 60.0);
    }
    let seconds = circle.run(&MACHINE, [JERK; 3]) + of_steps();
    let ideal = least_time(120.0, 0.0, 0.0, 60.0, 500.0, JERK);
    assert!((seconds / ideal - 1.0).abs() < 0.01, "{seconds} of {ideal} s");
}

/// The junction rule allows no higher speed at a corner if the jerk is limited. So a job with a jerk limit takes longer
/// than the same job without one.
#[test]
fn corners_are_passed_no_faster() {
    for turn in [10.0_f64, 35.0, 90.0, 150.0] {
        let mut job = Job::new();
        let (mut angle, mut at) = (0.0_f64, [0.0; 3]);
        for k in 0..16 {
            at[0] += 6.0 * angle.cos();
            at[1] += 6.0 * angle.sin();
            job.to(at, 120.0);
            angle += if k % 4 < 2 { turn.to_radians() } else { -turn.to_radians() };
        }
        let (smooth, even) = (job.run(&MACHINE, [JERK; 3]), job.run(&MACHINE, [0.0; 3]));
        assert!(smooth > even, "{turn}: {smooth} s, {even} s without a limit");
    }
}

/// Before the corner only X moves. After the corner Z moves, too, and Z has lower limits of jerk and acceleration than
/// X. The limits of Z must be kept even if a hold or a lower feed override acts shortly before the corner.
#[test]
fn a_corner_is_minded_by_what_brakes_before_it() {
    let limits = Limits { acceleration: [500.0, 400.0, 60.0], ..MACHINE };
    let jerk = [8000.0, 5000.0, 300.0];
    for (touch, behind) in
        [(b'!', [2.0, 0.5, 3.0]), (0x92, [2.0, 0.5, 3.0]), (b'!', [1.0, 4.0, 0.5]), (0x92, [9.0, 1.0, 2.0])]
    {
        for milliseconds in (20..320).step_by(10) {
            let mut job = Job::new();
            job.to([6.0, 0.0, 0.0], 40.0);
            job.to(behind, 40.0);
            let mut rig = Rig::with(&settings(&limits, jerk));
            rig.send(job.text.as_bytes());
            rig.run_for(f64::from(milliseconds) / 1000.0);
            for _ in 0..3 {
                rig.send(&[touch]);
            }
            rig.run_for(1.5);
            rig.send(b"~");
            rig.settle();
            assert_eq!(rig.place, limits.place(mm(job.at)));
            let most = jerk.map(|j| if j > 0.0 { j } else { f64::INFINITY });
            check(&rig.trace, HZ as f64, &job.lines, &limits)
                .and_then(|()| check_jerk(&rig.trace, HZ as f64, &job.lines, &limits, most))
                .unwrap_or_else(|fault| panic!("{touch} after {milliseconds} ms, {behind:?}: {fault}"));
        }
    }
}

/// A ramp to a lower feed can start slightly late, because the machine is still reaching the previous feed. It must
/// still end at the right position.
#[test]
fn a_late_ramp_lands_at_the_end() {
    for fast in 51..70 {
        for (length, blocks) in [(20.8, 13), (20.0, 5), (15.0, 30), (18.0, 1)] {
            let mut job = Job::line(length, blocks, f64::from(fast));
            for k in 1..=5 {
                job.to([length + 0.8 * f64::from(k), 0.0, 0.0], 50.0);
            }
            job.run(&MACHINE, [1500.0; 3]);
        }
    }
}

/// The steps of X are so coarse that a ramp has only a few steps. Still, the machine must pass the corner after the
/// ramp no faster than planned.
#[test]
fn corners_behind_coarse_steps_are_minded() {
    for (scale, steps, jerk) in [(2000.0, 5.0, [500_000.0, 0.0, 10_000.0]), (3000.0, 20.0, [100_000.0, 0.0, 1000.0])] {
        let limits = Limits {
            steps_per_mm: [steps, 80.0, 400.0],
            acceleration: [scale, scale, 50.0],
            junction_deviation: 0.001,
            ..MACHINE
        };
        for k in 0..120 {
            let mut job = Job::new();
            job.to([2.0 + 0.05 * f64::from(k), 0.0, 0.0], 200.0);
            job.to([2.0 + 0.05 * f64::from(k), 0.0, -1.0], 200.0);
            let mut rig = Rig::with(&settings(&limits, jerk));
            rig.run_clean(&job.text);
            let z: Vec<u64> = rig.trace.iter().filter(|p| p.steps & 4 != 0).map(|p| p.at).collect();
            // The junction rule, v² = √2 a d s / (1 - s), allows 0.41 mm/s (a: acceleration of Z, d: junction
            // deviation, s = cos(45°)). From this speed the first three intervals take 9.6 ms at 50 mm/s², and longer
            // with limited jerk.
            let seconds = (z[3] - z[0]) as f64 / HZ as f64;
            assert!(seconds > 0.004, "{k}: three steps in {seconds} s");
        }
    }
}

/// The jerk limit is kept if a cycle start arrives shortly before or after the end of a hold, at any moment. A hold
/// always completes the ramp that it has started.
#[test]
fn a_start_right_behind_a_hold_keeps_the_limit() {
    for (feed, jerk) in [(8.0, 8000.0), (5.6, 8000.0), (8.0, 1500.0), (2.0, 1500.0), (40.0, 5000.0)] {
        let job = Job::line(10.0, 4, feed);
        // Send the cycle start after 0.7 to 1.3 times the time that the hold needs to brake.
        let brakes = 2.0 * (feed / jerk).sqrt();
        for part in 0..60 {
            let mut rig = Rig::with(&settings(&MACHINE, [jerk; 3]));
            rig.send(job.text.as_bytes());
            rig.run_for(0.4);
            rig.send(b"!");
            rig.run_for(brakes * (0.7 + 0.01 * f64::from(part)));
            for _ in 0..2 {
                rig.send(b"~");
                rig.run_for(1.0);
            }
            rig.settle();
            assert_eq!(rig.place, MACHINE.place(mm(job.at)));
            check_jerk(&rig.trace, HZ as f64, &job.lines, &MACHINE, [jerk; 3])
                .unwrap_or_else(|fault| panic!("{feed} mm/s, {jerk} mm/s³, {part}: {fault}"));
        }
    }
}

/// Checks the measurement itself: `check_jerk` must report a motion whose speed ramps have no jerk limit.
#[test]
fn a_trapezoid_is_seen() {
    let job = Job::line(60.0, 1, 100.0);
    let mut rig = Rig::with(&settings(&MACHINE, [0.0; 3]));
    rig.run_clean(&job.text);
    assert!(check_jerk(&rig.trace, HZ as f64, &job.lines, &MACHINE, [JERK; 3]).unwrap_err().contains("mm/s³"));
}

/// Generates jobs of straight runs in one or many blocks at various feeds, gentle bends, circles of short chords, and
/// corners.
fn jobs() -> impl Strategy<Value = Job> {
    let piece = prop_oneof![
        3 => (0_i32..=0, 1_u32..40, 1_u32..30, 2_u32..120, Just(0.0)),
        1 => (-170_i32..170, 1_u32..40, 1_u32..3, 2_u32..120, Just(0.0)),
        2 => (0_i32..=0, 1_u32..10, 10_u32..150, 10_u32..120, -1.5_f64..1.5),
    ];
    prop::collection::vec(piece, 1..7).prop_map(|pieces| {
        let mut job = Job::new();
        let (mut angle, mut at) = (0.0_f64, [0.0; 3]);
        for (turn, length, count, feed, bend) in pieces {
            angle += f64::from(turn).to_radians();
            for _ in 0..count {
                angle += bend.to_radians();
                at[0] += 0.1 * f64::from(length) * angle.cos();
                at[1] += 0.1 * f64::from(length) * angle.sin();
                job.to(at, f64::from(feed));
            }
        }
        job
    })
}

fn unequal() -> impl Strategy<Value = (Limits, [f64; AXES])> {
    let jerk = || prop::sample::select(vec![1500.0, 5000.0, 8000.0]);
    (400.0_f64..800.0, prop::collection::vec(jerk(), 3), any::<bool>()).prop_map(|(y, jerk, free)| {
        let limits = Limits { acceleration: [500.0, y, 300.0], ..MACHINE };
        (limits, [jerk[0], if free { 0.0 } else { jerk[1] }, jerk[2]])
    })
}

const TOUCHES: [u8; 10] = [0x90, 0x91, 0x91, 0x92, 0x92, 0x93, b'!', b'!', b'~', b'~'];

/// Returns the number of random jobs; `OXMILL_JERK=N` runs N jobs, different from the default ones.
fn cases() -> u32 {
    std::env::var("OXMILL_JERK").map_or(120, |cases| cases.parse().expect("a number"))
}

/// Returns the seed of the random jobs: 1 for the default number of jobs, otherwise the number of jobs itself.
fn seed() -> u64 {
    if cases() == 120 { 1 } else { u64::from(cases()) }
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: cases(), max_shrink_iters: 20, failure_persistence: None, rng_seed: RngSeed::Fixed(seed()), ..ProptestConfig::default()
    })]

    #[test]
    fn jerk_is_bounded((limits, jerk) in unequal(), job in jobs()) {
        job.run(&limits, jerk);
    }

    /// The jerk stays bounded with overrides and holds at any time, even during ramps.
    #[test]
    fn jerk_is_bounded_under_overrides_and_holds(
        (limits, jerk) in unequal(),
        job in jobs(),
        touches in prop::collection::vec((1_u64..400, prop::sample::select(&TOUCHES[..])), 1..12),
    ) {
        let mut rig = Rig::with(&settings(&limits, jerk));
        rig.send(job.text.as_bytes());
        for (milliseconds, touch) in touches {
            rig.run_for(milliseconds as f64 / 1000.0);
            rig.send(&[touch]);
        }
        for _ in 0..3 {
            // Send cycle start again, because the first one has no effect if it comes during the ramp of a hold.
            rig.run_for(1.5);
            rig.send(b"~");
        }
        rig.settle();
        prop_assert_eq!(rig.place, limits.place(mm(job.at)), "{}", job.text);
        let mut lines = job.lines.clone();
        for line in &mut lines {
            line.feed = line.feed.map(|feed| feed * 2.0);
        }
        let most = jerk.map(|j| if j > 0.0 { j } else { f64::INFINITY });
        let checked = check(&rig.trace, HZ as f64, &lines, &limits)
            .and_then(|()| check_jerk(&rig.trace, HZ as f64, &lines, &limits, most));
        if let Err(fault) = checked {
            return Err(TestCaseError::fail(format!("{fault}\n{}", job.text)));
        }
    }
}
