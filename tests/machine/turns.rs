//! Tests turns that a program approximates by short chords. The machine must take such a turn as fast as the same
//! turn in one vertex or as an arc, neither faster nor slower. [`super::axis_speeds`] explains how axis speeds are
//! read and what is allowed.

use super::axis_speeds::{Change, Course, greatest_change};
use super::estimator::Limits;
use super::optimum::by_the_rule;
use super::oracle::{AXES, Pulse};
use super::rig::{HZ, Rig};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use std::f64::consts::PI;
use std::fmt::Write;
use std::ops::Range;

/// Lengths of the time windows over which changes of an axis' speed are measured, s.
const WINDOWS: [f64; 3] = [0.002, 0.005, 0.020];

/// Returns limits of 100 mm/s and 500 mm/s², with the default `$11`.
fn limits(steps_per_mm: f64) -> Limits {
    Limits {
        steps_per_mm: [steps_per_mm; AXES],
        rate: [100.0; AXES],
        acceleration: [500.0; AXES],
        junction_deviation: 0.01,
    }
}

pub fn settings(limits: &Limits, jerk: f64) -> String {
    let mut text = format!("$0=1\n$11={}\n", limits.junction_deviation);
    for axis in 0..AXES {
        writeln!(text, "$10{axis}={}", limits.steps_per_mm[axis]).unwrap();
        writeln!(text, "$11{axis}={}", limits.rate[axis] * 60.0).unwrap();
        writeln!(text, "$12{axis}={}", limits.acceleration[axis]).unwrap();
        if jerk > 0.0 {
            writeln!(text, "$22{axis}={jerk}").unwrap();
        }
    }
    text
}

/// Number format of a program.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    inches: bool,
    decimals: usize,
}

impl Style {
    pub const fn mm(decimals: usize) -> Style {
        Style { inches: false, decimals }
    }

    pub const fn inches(decimals: usize) -> Style {
        Style { inches: true, decimals }
    }

    /// Returns the program's unit in mm.
    pub fn unit(self) -> f64 {
        if self.inches { 25.4 } else { 1.0 }
    }
}

/// Returns a program of straight moves from the origin through the points `meant` (mm), and its [`Course`]. The
/// course has these points twice: as intended, and as rounded in the program. `feed`: mm/s.
pub fn program(meant: &[[f64; AXES]], style: Style, feed: f64) -> (String, Course) {
    let mut text =
        format!("G{} G90 G94 G17\nG1 F{:.5}\n", if style.inches { 20 } else { 21 }, feed * 60.0 / style.unit());
    let digits = style.decimals;
    let mut course = Course {
        meant: vec![[0.0; AXES]],
        written: vec![[0.0; AXES]],
        digit: style.unit() * 0.1_f64.powi(digits as i32),
        feed,
        smooth: false,
    };
    let plane = meant.iter().all(|point| point[2] == 0.0);
    for point in meant {
        let words = point.map(|mm| format!("{:.digits$}", mm / style.unit()));
        let [x, y, z] = &words;
        writeln!(text, "X{x} Y{y}{}", if plane { String::new() } else { format!(" Z{z}") }).unwrap();
        course.meant.push(*point);
        course.written.push(words.map(|word| word.parse::<f64>().unwrap() * style.unit()));
    }
    (text, course)
}

/// Starts a machine with these settings, runs a program to its end, and returns the machine with the trace of its
/// pulses.
pub fn run(settings: &str, program: &str) -> Rig {
    let mut rig = Rig::with(settings);
    rig.run_clean(program);
    rig
}

/// Returns the seconds from the first to the last step.
pub fn seconds(rig: &Rig) -> f64 {
    (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
}

/// Returns the seconds of a program of straight moves at 100 mm/s, 250 steps/mm.
fn seconds_of(points: &[[f64; AXES]], style: Style) -> f64 {
    seconds(&run(&settings(&limits(250.0), 0.0), &program(points, style, 100.0).0))
}

/// Returns the worst change of an axis' speed over all [`WINDOWS`]: the one with the largest ratio to the allowed
/// change.
fn worst(trace: &[Pulse], course: &Course, limits: &Limits) -> Result<Change, String> {
    let mut worst: Option<Change> = None;
    for window in WINDOWS {
        let change = greatest_change(trace, HZ as f64, course, limits, window)?;
        if worst.is_none_or(|worst| change.ratio > worst.ratio) {
            worst = Some(change);
        }
    }
    worst.ok_or_else(|| "no windows".to_string())
}

/// Returns the points of two lines of `leg` mm joined by an arc of `chords` chords.
fn fillet(leg: f64, radius: f64, angle: f64, chords: u32) -> Vec<[f64; AXES]> {
    let mut points = vec![[leg, 0.0, 0.0]];
    for k in 1..=chords {
        let turned = angle * f64::from(k) / f64::from(chords);
        points.push([leg + radius * turned.sin(), radius * (1.0 - turned.cos()), 0.0]);
    }
    let last = points[points.len() - 1];
    points.push([last[0] + leg * angle.cos(), last[1] + leg * angle.sin(), 0.0]);
    points
}

/// Returns the points of a line of 100 mm at an odd angle, divided into `pieces` equal parts.
fn line(pieces: u32) -> Vec<[f64; AXES]> {
    (1..=pieces)
        .map(|k| {
            let way = 100.0 * f64::from(k) / f64::from(pieces);
            [way * 17.3_f64.to_radians().cos(), way * 17.3_f64.to_radians().sin(), 0.0]
        })
        .collect()
}

/// A move of about 0.001 mm in a right angle turns the angle into two corners of 45 degrees. For the motors nothing
/// changes, so the machine must not be faster.
#[test]
fn a_remnant_in_a_right_angle_makes_it_no_faster() {
    let settings = settings(&limits(1000.0), 0.0);
    let plain = seconds(&run(&settings, "G21 G90 F6000\nG1 X20\nG1 Y20\n"));
    let remnant = seconds(&run(&settings, "G21 G90 F6000\nG1 X20\nG1 X20.0008 Y0.0008\nG1 Y20\n"));
    println!("{remnant} s, {plain} s without the remnant");
    assert!((0.99 * plain..1.01 * plain).contains(&remnant), "{remnant} s, {plain} s without the remnant");
}

/// A half circle of R = 0.05 mm allows 5 mm/s, so the machine must brake at the end of the first line.
#[test]
fn a_half_circle_in_chords_is_taken_as_an_arc_is() {
    let arc = "G21 G90 F6000\nG1 X20\nG3 X20 Y0.1 J0.05\nG1 X0\n";
    let mut faults = Vec::new();
    for steps in [80.0, 250.0, 1000.0] {
        let limits = limits(steps);
        let of_arc = seconds(&run(&settings(&limits, 0.0), arc));
        for (decimals, jerk) in [(3, 0.0), (4, 0.0), (5, 0.0), (3, 20_000.0), (5, 20_000.0)] {
            let (text, course) = program(&fillet(20.0, 0.05, PI, 24), Style::mm(decimals), 100.0);
            let rig = run(&settings(&limits, jerk), &text);
            let (time, worst) = (seconds(&rig), worst(&rig.trace, &course, &limits).unwrap());
            println!("{steps} steps/mm, {decimals} decimals, jerk {jerk}: {time:.3} s (arc {of_arc:.3} s), {worst}");
            if time < 0.76 || worst.ratio > 1.0 || jerk == 0.0 && time > 1.03 * of_arc {
                faults.push(format!("{steps} steps/mm, {decimals} decimals, jerk {jerk}: {time} s, {worst}"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Rounding noise does not count as corners, however coarse the digits.
#[test]
fn a_straight_line_in_coarse_digits_keeps_its_time() {
    let whole = seconds_of(&line(1), Style::mm(5));
    let mut faults = Vec::new();
    for style in [Style::mm(2), Style::mm(3), Style::inches(3), Style::inches(4)] {
        let time = seconds_of(&line(1000), style);
        println!("{style:?}: {:.3} times the time of the single line", time / whole);
        if !(0.98..1.05).contains(&(time / whole)) {
            faults.push(format!("{style:?}: {time} s, {whole} s in one piece"));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Rounding noise does not make a circle seem tighter than it is: with coarse digits the circle takes as long as with
/// six decimals.
#[test]
fn a_circle_in_coarse_digits_keeps_its_time() {
    let mut faults = Vec::new();
    for pieces in [1000, 2000, 4000] {
        let circle: Vec<[f64; AXES]> = (1..=pieces)
            .map(|k| 2.0 * PI * f64::from(k) / f64::from(pieces))
            .map(|angle| [30.0 - 30.0 * angle.cos(), 30.0 * angle.sin(), 0.0])
            .collect();
        let fine = seconds_of(&circle, Style::mm(6));
        for style in [Style::inches(4), Style::mm(3)] {
            let time = seconds_of(&circle, style);
            println!("{pieces} chords, {style:?}: {:.3} times the time of six decimals", time / fine);
            if !(0.98..1.05).contains(&(time / fine)) {
                faults.push(format!("{pieces} chords, {style:?}: {time} s, {fine} s in six decimals"));
            }
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// A part of a path in the plane. It begins at the end of the previous part, in the direction in which that part
/// ended.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// A straight line of a length (mm), in a number of pieces.
    Line(f64, u32),
    /// A bend of this radius (mm) by an angle (rad), in chords of about this length (mm).
    Arc { radius: f64, angle: f64, chord: f64 },
    /// A turn in one vertex, rad.
    Corner(f64),
}

/// Returns the points along some parts, starting at the origin, without the origin itself.
fn points(parts: &[Part]) -> Vec<[f64; AXES]> {
    let (mut at, mut heading) = ([0.0_f64; 2], 0.0_f64);
    let mut points = Vec::new();
    for part in parts {
        match *part {
            Part::Line(length, pieces) => {
                let from = at;
                for k in 1..=pieces {
                    let way = length * f64::from(k) / f64::from(pieces);
                    at = [from[0] + way * heading.cos(), from[1] + way * heading.sin()];
                    points.push([at[0], at[1], 0.0]);
                }
            }
            Part::Arc { radius, angle, chord } => {
                let chords = (radius * angle.abs() / chord).ceil().clamp(1.0, MOST_CHORDS);
                let turn = angle / chords;
                let length = 2.0 * radius * (turn.abs() / 2.0).sin();
                for _ in 0..chords as u32 {
                    heading += turn / 2.0;
                    at = [at[0] + length * heading.cos(), at[1] + length * heading.sin()];
                    heading += turn / 2.0;
                    points.push([at[0], at[1], 0.0]);
                }
            }
            Part::Corner(angle) => heading += angle,
        }
    }
    points
}

/// Maximum number of chords of one arc. An arc that would need more gets longer chords than [`Part::Arc`] asks for.
const MOST_CHORDS: f64 = 300.0;

/// Shape of a path. A line of length 1 is about as long as the distance in which the machine reaches its feed (see
/// `reach`).
#[derive(Clone, Debug)]
enum Shape {
    /// Lines joined by bends: for each bend its angle and the length of the line after it.
    Fillets(Vec<(f64, f64)>),
    /// Parallel lines of these lengths, joined by half circles that turn left and right alternately.
    Rows(Vec<f64>),
    /// A star of equal tips. Each tip has two bends: one by the angle `sharp` (rad), and one back in the other
    /// direction.
    Star { tips: u32, side: f64, sharp: f64 },
    /// Half circles, each larger than the one before by this factor.
    Spiral { halves: u32, growth: f64 },
    /// Strokes as of engraved text: for each its angle to the next stroke (rad), its length, and `true` if the corner
    /// is round.
    Text(Vec<(f64, f64, bool)>),
    /// A contour with round joins that runs `turns` times around a polygon.
    Contour { corners: u32, side: f64, turns: u32 },
}

/// A shape with its dimensions, orientation and number format.
#[derive(Clone, Debug)]
struct Job {
    shape: Shape,
    radius: f64,
    chord: f64,
    /// Number of equal moves into which each line is divided.
    pieces: u32,
    /// Rotations of the plane, rad: within itself, about X and about Z.
    tilt: [f64; 3],
    /// Rise perpendicular to the plane before it is tilted, mm per mm of path.
    rise: f64,
    style: Style,
}

impl Job {
    /// Returns the points of the shape. `reach`: length in mm of a line whose length in the shape is 1.
    fn points(&self, reach: f64) -> Vec<[f64; AXES]> {
        let line = |share: f64| Part::Line((share * reach).max(0.01), self.pieces);
        let bend = |angle: f64| Part::Arc { radius: self.radius, angle, chord: self.chord };
        let mut parts = Vec::new();
        match &self.shape {
            Shape::Fillets(bends) => {
                parts.push(line(1.0));
                for (angle, share) in bends {
                    parts.extend([bend(*angle), line(*share)]);
                }
            }
            Shape::Rows(rows) => {
                for (k, share) in rows.iter().enumerate() {
                    parts.extend([line(*share), bend(if k % 2 == 0 { PI } else { -PI })]);
                }
                parts.push(line(1.0));
            }
            Shape::Star { tips, side, sharp } => {
                for _ in 0..*tips {
                    parts.extend([line(*side), bend(*sharp), line(*side), bend(2.0 * PI / f64::from(*tips) - sharp)]);
                }
            }
            Shape::Spiral { halves, growth } => {
                parts.push(line(0.7));
                for k in 0..*halves {
                    let radius = (self.radius * growth.powi(k as i32)).min(5.0);
                    parts.push(Part::Arc { radius, angle: PI, chord: self.chord });
                }
                parts.push(line(0.7));
            }
            Shape::Text(strokes) => {
                for (angle, share, round) in strokes {
                    parts.extend([line(*share), if *round { bend(*angle) } else { Part::Corner(*angle) }]);
                }
                parts.push(line(0.3));
            }
            Shape::Contour { corners, side, turns } => {
                for _ in 0..corners * turns {
                    parts.extend([line(*side), bend(2.0 * PI / f64::from(*corners))]);
                }
            }
        }
        self.turned(points(&parts))
    }

    /// Lifts each point above the plane by `rise` times the length of the path up to it, and tilts the plane.
    fn turned(&self, points: Vec<[f64; AXES]>) -> Vec<[f64; AXES]> {
        let [within, about_x, about_z] = self.tilt.map(f64::sin_cos);
        let rotated = |(sin, cos): (f64, f64), a: f64, b: f64| (a * cos - b * sin, a * sin + b * cos);
        let (mut path, mut before) = (0.0, [0.0; AXES]);
        points
            .into_iter()
            .map(|point| {
                path += (point[0] - before[0]).hypot(point[1] - before[1]);
                before = point;
                let (x, y) = rotated(within, point[0], point[1]);
                let (y, z) = rotated(about_x, y, self.rise * path);
                let (x, y) = rotated(about_z, x, y);
                [x, y, z]
            })
            .collect()
    }
}

/// Generates numbers that are evenly distributed over orders of magnitude.
fn log_uniform(from: f64, to: f64) -> impl Strategy<Value = f64> {
    (from.ln()..to.ln()).prop_map(f64::exp)
}

fn shapes() -> impl Strategy<Value = Shape> {
    let angle = || prop_oneof![2 => 0.2..PI, 1 => Just(PI / 2.0), 1 => Just(PI)];
    let turn = move || (angle(), any::<bool>()).prop_map(|(angle, left)| if left { angle } else { -angle });
    prop_oneof![
        4 => prop::collection::vec((turn(), 0.2..1.2), 1..4).prop_map(Shape::Fillets),
        3 => prop::collection::vec(0.3..1.2, 1..4).prop_map(Shape::Rows),
        2 => (4_u32..8, 0.1..0.5, 1.6..3.0).prop_map(|(tips, side, sharp)| Shape::Star { tips, side, sharp }),
        2 => (2_u32..8, 1.0..2.0).prop_map(|(halves, growth)| Shape::Spiral { halves, growth }),
        2 => prop::collection::vec((turn(), 0.02..0.3, any::<bool>()), 4..20).prop_map(Shape::Text),
        2 => (3_u32..7, 0.1..0.6, 1_u32..3).prop_map(|(corners, side, turns)| Shape::Contour { corners, side, turns }),
    ]
}

fn jobs() -> impl Strategy<Value = Job> {
    let style = prop_oneof![3 => (2_usize..6).prop_map(Style::mm), 1 => (3_usize..6).prop_map(Style::inches)];
    let tilt = prop_oneof![
        2 => (0.0..2.0 * PI).prop_map(|within| ([within, 0.0, 0.0], 0.0)),
        1 => Just(([0.0; 3], 0.0)),
        1 => (prop::array::uniform3(0.0..2.0 * PI), prop_oneof![Just(0.0), -0.3..0.3]),
    ];
    (shapes(), log_uniform(0.002, 5.0), log_uniform(0.0005, 1.0), prop_oneof![Just(1_u32), 2_u32..40], tilt, style)
        .prop_map(|(shape, radius, chord, pieces, (tilt, rise), style)| Job {
            shape,
            radius,
            chord,
            pieces,
            tilt,
            rise,
            style,
        })
}

/// Generates machines (steps, rate, accelerations, junction deviation), jerk and feed.
fn machines() -> impl Strategy<Value = (Limits, f64, f64)> {
    let steps = prop::sample::select(vec![[80.0; AXES], [250.0; AXES], [400.0, 320.0, 800.0], [1000.0; AXES]]);
    let acceleration =
        prop::sample::select(vec![[500.0; AXES], [500.0, 500.0, 100.0], [1500.0, 1000.0, 400.0], [4000.0; AXES]]);
    let deviation = prop::sample::select(vec![0.002, 0.01, 0.01, 0.05]);
    let jerk = prop_oneof![2 => Just(0.0), 1 => log_uniform(5000.0, 100_000.0)];
    let feed = prop_oneof![2 => Just(100.0), 1 => 15.0..100.0];
    (steps, acceleration, deviation, jerk, feed).prop_map(
        |(steps_per_mm, acceleration, junction_deviation, jerk, feed)| {
            (Limits { steps_per_mm, rate: [100.0; AXES], acceleration, junction_deviation }, jerk, feed)
        },
    )
}

/// Returns the distance, mm, in which the machine accelerates from rest to the feed, but at least 0.5 and at most 12.
fn reach(limits: &Limits, feed: f64) -> f64 {
    (feed * feed / limits.acceleration[0] / 2.0).clamp(0.5, 12.0)
}

fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

/// Draws a random value that depends on the case number only.
fn drawn<S: Strategy>(strategy: &S, case: u64) -> S::Value {
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&case.to_le_bytes());
    let mut runner = TestRunner::new_with_rng(Config::default(), TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
    strategy.new_tree(&mut runner).expect("no filters").current()
}

/// A random job: the machine, its jerk, settings, program and course, and `told`, a description for error messages.
struct Drawn {
    limits: Limits,
    jerk: f64,
    settings: String,
    text: String,
    course: Course,
    told: String,
}

impl Drawn {
    fn new(case: u64) -> Drawn {
        let ((limits, jerk, feed), job) = drawn(&(machines(), jobs()), case);
        let (text, course) = program(&job.points(reach(&limits, feed)), job.style, feed);
        let told = format!("    {job:?}\n    {limits:?} jerk {jerk} feed {feed}");
        Drawn { settings: settings(&limits, jerk), limits, jerk, text, course, told }
    }
}

/// Returns the case numbers of a run. `OXMILL_FUZZ=N` runs N cases instead of `default`. `OXMILL_FUZZ_SEED` sets the
/// number of the first case; without it the first case is 1.
fn cases(default: u64) -> Range<u64> {
    let (cases, first) = (number("OXMILL_FUZZ", default), number("OXMILL_FUZZ_SEED", 1));
    first..first + cases
}

/// Fails if there are faults: prints their number and the 12 worst, and writes the program of the worst one to a
/// file. A fault is a tuple of its ratio, its description and the program.
fn tell(name: &str, mut faults: Vec<(f64, String, String)>) {
    faults.sort_by(|a, b| b.0.total_cmp(&a.0));
    if let Some((_, _, job)) = faults.first() {
        let file = format!("{}/{name}.nc", env!("CARGO_TARGET_TMPDIR"));
        std::fs::write(&file, job).unwrap();
        let told: Vec<&str> = faults.iter().take(12).map(|fault| fault.1.as_str()).collect();
        panic!("{} jobs, the worst in {file}:\n{}", faults.len(), told.join("\n"));
    }
}

/// Random shapes on random machines: the speed of each axis changes no more than allowed. Three terms add up to the
/// allowed change: the acceleration, the junction rule for the whole turn, and the rounding to digits.
#[test]
fn no_axis_changes_its_speed_by_more_than_a_whole_turn_is_granted() {
    let mut faults = Vec::new();
    for case in cases(200) {
        let job = Drawn::new(case);
        let rig = run(&job.settings, &job.text);
        let change = worst(&rig.trace, &job.course, &job.limits).unwrap_or_else(|fault| panic!("case {case}: {fault}"));
        if change.ratio > 1.0 {
            let told = format!("case {case}: {change}\n{}", job.told);
            faults.push((change.ratio, told, format!("{}{}", job.settings, job.text)));
        }
    }
    tell("turn", faults);
}

/// Maximum number of vertices of jobs that are compared with the rule for turns. The reference applies the rule to
/// every run of consecutive vertices, which takes long if there are many vertices.
const MOST_VERTICES: usize = 300;

/// In its turns a job takes no longer than the rule for turns requires ([`by_the_rule`]). So rounding noise costs no
/// time.
#[test]
fn no_turn_takes_longer_than_the_rule_needs() {
    let mut faults = Vec::new();
    for case in cases(120) {
        let job = Drawn::new(case);
        if job.jerk > 0.0 || job.course.meant.len() > MOST_VERTICES {
            continue;
        }
        let ideal = by_the_rule(&job.course, &job.limits, 1.0, HZ as f64);
        let least = (ideal[ideal.len() - 1].at - ideal[0].at) as f64 / HZ as f64;
        let time = seconds(&run(&job.settings, &job.text));
        if time > SLOWER * least + UNSEEN {
            let told = format!("case {case}: {time:.3} s, {least:.3} s by the rule\n{}", job.told);
            faults.push((time / least, told, format!("{}{}", job.settings, job.text)));
        }
    }
    tell("slow_turn", faults);
}

/// Allowed ratio of a job's duration to the duration that [`by_the_rule`] computes. The controller looks ahead over a
/// limited number of moves, applies the rule to some runs of vertices only, and sees points that are rounded to
/// digits.
const SLOWER: f64 = 1.15;
/// Maximum time that a measured duration lacks, in seconds: before the first step and after the last one.
const UNSEEN: f64 = 0.01;

/// Tests the measurement itself (`worst`) with motion computed by [`by_the_rule`]. The measurement must accept motion
/// at the maximum speed that the rule for turns allows, in any shape. At 1.5 times this speed it must reject some jobs,
/// namely those with fine steps and digits. At 2 times this speed it must reject most jobs.
#[test]
fn the_measure_accepts_the_rule_and_sees_a_broken_one() {
    let (mut compared, mut seen) = (0, [0, 0]);
    for case in 1..100 {
        let Drawn { limits, course, told, .. } = Drawn::new(case);
        if course.meant.len() > MOST_VERTICES {
            continue;
        }
        let ratio = |excess: f64| worst(&by_the_rule(&course, &limits, excess, HZ as f64), &course, &limits).unwrap();
        let change = ratio(1.0);
        assert!(change.ratio <= 1.0, "case {case}: {change}\n{told}");
        compared += 1;
        for (seen, excess) in seen.iter_mut().zip([1.5_f64, 2.0]) {
            *seen += u32::from(ratio(excess * excess).ratio > 1.0);
        }
    }
    println!("of {compared} jobs 1.5 times the speed is seen on {}, twice the speed on {}", seen[0], seen[1]);
    assert!(compared > 50 && 8 * seen[0] > compared && 2 * seen[1] > compared, "{seen:?} of {compared}");
}
