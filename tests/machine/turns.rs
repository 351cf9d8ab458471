//! Turns that a program makes of short chords: taken no faster than the same turn in one vertex or as an arc, and no slower.
//! How the speeds of axes are read and what is allowed: [`super::axis_speeds`].

use super::axis_speeds::{Change, Course, greatest_change};
use super::estimator::Limits;
use super::optimum::{Bound, Piece, optimum, steps};
use super::oracle::{AXES, Pulse};
use super::rig::{HZ, Rig};
use proptest::prelude::*;
use proptest::strategy::ValueTree;
use proptest::test_runner::{Config, RngAlgorithm, TestRng, TestRunner};
use std::f64::consts::PI;
use std::fmt::Write;

/// Windows in which speeds are compared, s.
const WINDOWS: [f64; 3] = [0.002, 0.005, 0.020];

/// 100 mm/s and 500 mm/s², `$11` as it is by default.
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

/// How a program writes its numbers.
#[derive(Clone, Copy, Debug)]
pub struct Style {
    inches: bool,
    decimals: usize,
}

impl Style {
    pub const fn mm(decimals: usize) -> Style {
        Style { inches: false, decimals }
    }

    const fn inches(decimals: usize) -> Style {
        Style { inches: true, decimals }
    }

    /// mm.
    fn unit(self) -> f64 {
        if self.inches { 25.4 } else { 1.0 }
    }
}

/// A program of straight moves through these points, from the origin, and its course. Feed in mm/s.
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

/// Runs a program to its end.
pub fn run(settings: &str, program: &str) -> Rig {
    let mut rig = Rig::with(settings);
    rig.run_clean(program);
    rig
}

/// From the first to the last step.
pub fn seconds(rig: &Rig) -> f64 {
    (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
}

/// Seconds of a program of straight moves at 100 mm/s, 250 steps/mm.
fn seconds_of(points: &[[f64; AXES]], style: Style) -> f64 {
    seconds(&run(&settings(&limits(250.0), 0.0), &program(points, style, 100.0).0))
}

/// The greatest change of an axis' speed over any of the windows.
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

/// Two lines of `leg` mm joined by an arc in so many chords.
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

/// A line of 100 mm at an odd angle, in so many pieces.
fn line(pieces: u32) -> Vec<[f64; AXES]> {
    (1..=pieces)
        .map(|k| {
            let way = 100.0 * f64::from(k) / f64::from(pieces);
            [way * 17.3_f64.to_radians().cos(), way * 17.3_f64.to_radians().sin(), 0.0]
        })
        .collect()
}

/// A remnant of a move in a right angle makes it two corners of 45 degrees, which changes nothing for the motors.
#[test]
fn a_remnant_in_a_right_angle_makes_it_no_faster() {
    let settings = settings(&limits(1000.0), 0.0);
    let plain = seconds(&run(&settings, "G21 G90 F6000\nG1 X20\nG1 Y20\n"));
    let remnant = seconds(&run(&settings, "G21 G90 F6000\nG1 X20\nG1 X20.0008 Y0.0008\nG1 Y20\n"));
    println!("{remnant} s, {plain} s without the remnant");
    assert!((0.99 * plain..1.01 * plain).contains(&remnant), "{remnant} s, {plain} s without the remnant");
}

/// A half circle of R = 0.05 mm allows 5 mm/s; the two lines have to brake for it.
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

/// The noise of rounding is no corner, however coarse the digits.
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

/// Nor does it make a circle tighter.
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

/// A part of a path in the plane, from where the one before has ended and in its direction.
#[derive(Clone, Copy, Debug)]
enum Part {
    /// Straight on, in so many pieces.
    Line(f64, u32),
    /// A bend of this radius by an angle, in chords of about this length.
    Arc { radius: f64, angle: f64, chord: f64 },
    /// A turn in one vertex.
    Corner(f64),
}

/// Points along some parts from the origin, without the origin.
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

/// Chords of one arc at most.
const MOST_CHORDS: f64 = 300.0;

/// What is drawn. Lengths of lines are shares of the way in which a machine comes to its feed.
#[derive(Clone, Debug)]
enum Shape {
    /// Lines joined by bends of these angles.
    Fillets(Vec<(f64, f64)>),
    /// Rows joined by half circles, alternately to both sides.
    Rows(Vec<f64>),
    /// Tips of two turns each, all alike.
    Star { tips: u32, side: f64, sharp: f64 },
    /// Half circles that grow by this factor.
    Spiral { halves: u32, growth: f64 },
    /// Strokes with sharp or round corners.
    Text(Vec<(f64, f64, bool)>),
    /// The contour around a polygon, with round joins.
    Contour { corners: u32, side: f64, turns: u32 },
}

/// A shape in all its sizes.
#[derive(Clone, Debug)]
struct Job {
    shape: Shape,
    radius: f64,
    chord: f64,
    /// Pieces of each line.
    pieces: u32,
    /// Turns of the plane: within itself, about X and about Z; and rise of Z with the path.
    tilt: [f64; 3],
    rise: f64,
    style: Style,
}

impl Job {
    /// With lines of about `reach` mm.
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

    /// In a plane in space.
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

/// Even over the orders of magnitude.
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

/// Steps, rate, accelerations, junction deviation; jerk, and the feed.
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

/// Lines in which about the feed is reached, and as short as it can be.
fn reach(limits: &Limits, feed: f64) -> f64 {
    (feed * feed / limits.acceleration[0] / 2.0).clamp(0.5, 12.0)
}

/// A number from the environment.
fn number(name: &str, default: u64) -> u64 {
    std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
}

/// The same case for the same number.
fn drawn<S: Strategy>(strategy: &S, case: u64) -> S::Value {
    let mut seed = [0; 32];
    seed[..8].copy_from_slice(&case.to_le_bytes());
    let mut runner = TestRunner::new_with_rng(Config::default(), TestRng::from_seed(RngAlgorithm::ChaCha, &seed));
    strategy.new_tree(&mut runner).expect("no filters").current()
}

/// Random shapes on random machines, `OXMILL_FUZZ=N` of them, from `OXMILL_FUZZ_SEED` on: no axis changes its speed by more
/// than its acceleration, the junction rule for the whole turn and the digits make of it.
#[test]
fn no_axis_changes_its_speed_by_more_than_a_whole_turn_is_granted() {
    let strategy = (machines(), jobs());
    let (cases, first) = (number("OXMILL_FUZZ", 200), number("OXMILL_FUZZ_SEED", 1));
    let mut excesses = Vec::new();
    for case in first..first + cases {
        let ((limits, jerk, feed), job) = drawn(&strategy, case);
        let (text, course) = program(&job.points(reach(&limits, feed)), job.style, feed);
        let settings = settings(&limits, jerk);
        let rig = run(&settings, &text);
        let change = worst(&rig.trace, &course, &limits)
            .unwrap_or_else(|fault| panic!("case {case}: {fault}\n{settings}{text}"));
        if std::env::var_os("W_ALL").is_some() {
            println!("{:.2} case {case} {change} {job:?} {limits:?} {jerk}", change.ratio);
        }
        if change.ratio > 1.0 {
            let told = format!("case {case}: {change}\n    {job:?}\n    {limits:?} jerk {jerk} feed {feed}");
            excesses.push((change.ratio, told, format!("{settings}{text}")));
        }
    }
    excesses.sort_by(|a, b| b.0.total_cmp(&a.0));
    if let Some((_, _, job)) = excesses.first() {
        let file = concat!(env!("CARGO_TARGET_TMPDIR"), "/turn.nc");
        std::fs::write(file, job).unwrap();
        let told: Vec<&str> = excesses.iter().take(12).map(|excess| excess.1.as_str()).collect();
        panic!("{} of {cases} jobs, the worst in {file}:\n{}", excesses.len(), told.join("\n"));
    }
}

/// Greatest v² at each vertex by the rule itself: for every span of vertices, of length L and turning by t, from one vertex
/// to half a circle, `a (L / t + d s / (1 - s))`. All spans, with endless look-ahead, of the points that were meant.
fn speeds2_of_turns(chords: &[[f64; AXES]], lengths: &[f64], limits: &Limits, feed: f64) -> Vec<f64> {
    let mut most = vec![feed * feed; chords.len() + 1];
    for first in 1..chords.len() {
        let (mut length, mut whole) = (0.0, 0.0);
        for last in first..chords.len() {
            let cosine = |a: [f64; AXES], b: [f64; AXES]| (0..AXES).map(|i| a[i] * b[i]).sum::<f64>().clamp(-1.0, 1.0);
            whole += cosine(chords[last - 1], chords[last]).acos();
            if last > first {
                length += lengths[last - 1];
            }
            if whole > PI + 1e-6 {
                break;
            }
            let turn = cosine(chords[first - 1], chords[last]).acos();
            if turn < 1e-7 {
                continue;
            }
            let vector: [f64; AXES] = std::array::from_fn(|i| (chords[last][i] - chords[first - 1][i]).abs());
            let size = vector.iter().map(|part| part * part).sum::<f64>().sqrt();
            let acceleration = (0..AXES)
                .filter(|&i| vector[i] > 1e-9)
                .map(|i| limits.acceleration[i] * size / vector[i])
                .fold(f64::INFINITY, f64::min);
            let s = (turn / 2.0).cos();
            let corner = limits.junction_deviation * s * (1.0 + s) / (turn / 2.0).sin().powi(2);
            let speed2 = acceleration * (length / turn + corner);
            for vertex in &mut most[first..=last] {
                *vertex = vertex.min(speed2);
            }
        }
    }
    most
}

/// Steps of a machine that takes a course at the speeds of the rule, or at so many times their squares.
fn by_the_rule(course: &Course, limits: &Limits, excess: f64) -> Vec<Pulse> {
    let ways: Vec<[f64; AXES]> =
        course.meant.windows(2).map(|ends| std::array::from_fn(|i| ends[1][i] - ends[0][i])).collect();
    let lengths: Vec<f64> = ways.iter().map(|way| way.iter().map(|part| part * part).sum::<f64>().sqrt()).collect();
    let chords: Vec<[f64; AXES]> =
        ways.iter().zip(&lengths).map(|(way, length)| way.map(|part| part / length)).collect();
    let most = speeds2_of_turns(&chords, &lengths, limits, course.feed);
    let (mut pieces, mut points) = (Vec::new(), vec![course.written[0]]);
    for (k, chord) in chords.iter().enumerate() {
        // Where a bend uses up the acceleration across, none is left along: a curvature that needs all of it at the
        // greatest speed, split over the chords next to it.
        let bend = |at: usize| -> [f64; AXES] {
            if at == 0 || at >= chords.len() {
                return [0.0; AXES];
            }
            let turn: [f64; AXES] = std::array::from_fn(|i| chords[at][i] - chords[at - 1][i]);
            turn.map(|part| part / (0.5 * (lengths[at] + lengths[at - 1])))
        };
        let count = (lengths[k] / 0.05).ceil().clamp(2.0, 100.0);
        for part in 0..count as u32 {
            let mut curvature = [0.0; AXES];
            if count < 3.0 {
                let used = bend(k + part as usize);
                let across = (0..AXES).map(|i| used[i].abs() / limits.acceleration[i]).fold(0.0, f64::max);
                let most2 = most[k].max(most[k + 1]);
                curvature = used.map(|part| part / excess / (across * most2).max(1.0));
            }
            pieces.push(Piece {
                tangent: *chord,
                curvature,
                length: lengths[k] / count,
                entry2: if part == 0 { excess * most[k] } else { f64::INFINITY },
                most2: course.feed * course.feed,
            });
            let share = f64::from(part + 1) / count;
            points.push(std::array::from_fn(|i| {
                course.written[k][i] + (course.written[k + 1][i] - course.written[k][i]) * share
            }));
        }
    }
    let speeds2 = optimum(&pieces, limits, Bound::EachAxis);
    steps(&points, &pieces, &speeds2, limits, HZ as f64)
}

/// The measure itself: it accepts motion by the rule, at its limit everywhere, in any shape, and sees half as much again.
#[test]
fn the_measure_accepts_the_rule_and_sees_half_as_much_again() {
    let strategy = (machines(), jobs());
    let (mut cases, mut seen) = (0, [0; 3]);
    for case in 1..200 {
        let ((limits, _, feed), job) = drawn(&strategy, case);
        let points = job.points(reach(&limits, feed));
        if points.len() > 600 {
            continue;
        }
        let (_, course) = program(&points, job.style, feed);
        let change = worst(&by_the_rule(&course, &limits, 1.0), &course, &limits).unwrap();
        let more = [1.5, 2.25, 4.0].map(|e| worst(&by_the_rule(&course, &limits, e), &course, &limits).unwrap().ratio);
        println!("case {case}: {change}; {more:.2?} with more, {} points {job:?} {limits:?}", points.len());
        cases += 1;
        for k in 0..3 {
            seen[k] += u32::from(more[k] > 1.0);
        }
    }
    println!("{seen:?} of {cases}");
}
