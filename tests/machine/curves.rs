//! Smooth curves at changing speed. Each motor supplies the acceleration across the path and the acceleration along
//! it at the same time. The sum must stay within the limit of its axis.

use super::axis_speeds::{Change, Course, Unsure, granted, greatest_change};
use super::estimator::Limits;
use super::optimum::{Bound, Piece, duration, optimum};
use super::oracle::AXES;
use super::rig::{HZ, Rig};
use super::turns::{Style, program, run, seconds, settings};
use oxmill_controller::messages::Realtime;
use std::f64::consts::{PI, TAU};

/// Length of a window, s. The tests compare the mean speeds of two such windows. A window is so long that the errors
/// due to steps and digits are only 1 % of the change due to acceleration.
const WINDOW: f64 = 0.020;
/// Length of the chords of the programs, mm.
const CHORD: f64 = 0.1;
/// Length of the pieces in the reference computation, mm.
const FINE: f64 = 0.01;

const LIMITS: Limits =
    Limits { steps_per_mm: [1000.0; AXES], rate: [100.0; AXES], acceleration: [500.0; AXES], junction_deviation: 0.01 };

type Curve = Box<dyn Fn(f64) -> [f64; AXES]>;

/// A smooth part of a shape. `curve`: position in mm for a parameter from 0 to 1. `feed`: mm/s.
struct Part {
    curve: Curve,
    feed: f64,
}

fn part(feed: f64, curve: impl Fn(f64) -> [f64; AXES] + 'static) -> Part {
    Part { curve: Box::new(curve), feed }
}

fn line(feed: f64, from: [f64; 2], to: [f64; 2]) -> Part {
    part(feed, move |u| [from[0] + (to[0] - from[0]) * u, from[1] + (to[1] - from[1]) * u, 0.0])
}

/// Returns an arc around a centre, from one angle (rad) to the other.
fn arc(feed: f64, centre: [f64; 2], radius: f64, angles: [f64; 2]) -> Part {
    part(feed, move |u| {
        let angle = angles[0] + (angles[1] - angles[0]) * u;
        [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin(), 0.0]
    })
}

/// Returns ten shapes, each with its name; their start points are arbitrary.
fn shapes() -> Vec<(&'static str, Vec<Part>)> {
    let rectangle = || {
        let mut parts = Vec::new();
        let corners = [[35.0, 5.0], [35.0, 15.0], [5.0, 15.0], [5.0, 5.0]];
        let sides = [
            [[5.0, 0.0], [35.0, 0.0]],
            [[40.0, 5.0], [40.0, 15.0]],
            [[35.0, 20.0], [5.0, 20.0]],
            [[0.0, 15.0], [0.0, 5.0]],
        ];
        for (k, (side, centre)) in sides.into_iter().zip(corners).enumerate() {
            let from = (k as f64 - 1.0) * PI / 2.0;
            parts.extend([line(100.0, side[0], side[1]), arc(100.0, centre, 5.0, [from, from + PI / 2.0])]);
        }
        parts
    };
    vec![
        ("ellipse 30 x 8 mm", vec![part(100.0, |u| [30.0 * (TAU * u).cos(), 8.0 * (TAU * u).sin(), 0.0])]),
        (
            "the same at 30 degrees",
            vec![part(100.0, |u| {
                let (x, y) = (30.0 * (TAU * u).cos(), 8.0 * (TAU * u).sin());
                [x * 0.75_f64.sqrt() - y * 0.5, x * 0.5 + y * 0.75_f64.sqrt(), 0.0]
            })],
        ),
        (
            "spiral from 2 to 14 mm",
            vec![part(100.0, |u| {
                let radius = 2.0 + 12.0 * u;
                [radius * (3.0 * TAU * u).cos(), radius * (3.0 * TAU * u).sin(), 0.0]
            })],
        ),
        ("sine of 10 and 40 mm", vec![part(100.0, |u| [120.0 * u, 10.0 * (3.0 * TAU * u).sin(), 0.0])]),
        ("rounded rectangle, R 5 mm", rectangle()),
        (
            "S with feeds of 100, 40 and 80 mm/s",
            vec![
                arc(100.0, [0.0, 15.0], 15.0, [-PI / 2.0, PI / 4.0]),
                arc(40.0, [30.0 * 0.5_f64.sqrt(), 15.0 + 30.0 * 0.5_f64.sqrt()], 15.0, [5.0 * PI / 4.0, PI / 2.0]),
                arc(80.0, [30.0 * 0.5_f64.sqrt(), 45.0 + 30.0 * 0.5_f64.sqrt()], 15.0, [-PI / 2.0, PI / 2.0]),
            ],
        ),
        ("figure of eight", vec![part(100.0, |u| [25.0 * (TAU * u).sin(), 12.0 * (2.0 * TAU * u).sin(), 0.0])]),
        (
            "rosette of five leaves",
            vec![part(100.0, |u| {
                let radius = 14.0 + 5.0 * (5.0 * TAU * u).cos();
                [radius * (TAU * u).cos(), radius * (TAU * u).sin(), 0.0]
            })],
        ),
        (
            "drop with a point",
            vec![
                line(100.0, [0.0, 0.0], [20.0, 20.0]),
                arc(100.0, [0.0, 40.0], 800.0_f64.sqrt(), [-PI / 4.0, 5.0 * PI / 4.0]),
                line(100.0, [-20.0, 20.0], [0.0, 0.0]),
                line(100.0, [0.0, 0.0], [0.0, -20.0]),
            ],
        ),
        (
            "wave on a slope in space",
            vec![part(100.0, |u| [90.0 * u, 8.0 * (4.0 * PI * u).sin(), 30.0 * u + 4.0 * (6.0 * PI * u).cos()])],
        ),
    ]
}

fn minus(a: [f64; AXES], b: [f64; AXES]) -> [f64; AXES] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn norm(v: [f64; AXES]) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Returns points on a part, about `chord` apart, from its start.
fn along(part: &Part, chord: f64) -> Vec<[f64; AXES]> {
    const STEPS: u32 = 20_000;
    let at = |k: u32| (part.curve)(f64::from(k) / f64::from(STEPS));
    let mut lengths = vec![0.0];
    for k in 1..=STEPS {
        lengths.push(lengths[lengths.len() - 1] + norm(minus(at(k), at(k - 1))));
    }
    let whole = lengths[lengths.len() - 1];
    let count = (whole / chord).ceil();
    (0..=count as u32)
        .map(|n| {
            let way = whole * f64::from(n) / count;
            let k = lengths.partition_point(|length| *length < way).clamp(1, STEPS as usize);
            let share = (way - lengths[k - 1]) / (lengths[k] - lengths[k - 1]);
            (part.curve)((k as f64 - 1.0 + share.clamp(0.0, 1.0)) / f64::from(STEPS))
        })
        .collect()
}

/// Splits a shape into the short pieces from which [`optimum`] computes the shortest time.
fn pieces(shape: &[Part]) -> Vec<Piece> {
    let mut pieces: Vec<Piece> = Vec::new();
    for part in shape {
        let points = along(part, FINE);
        let ways: Vec<[f64; AXES]> = points.windows(2).map(|ends| minus(ends[1], ends[0])).collect();
        let tangents: Vec<[f64; AXES]> = ways.iter().map(|way| way.map(|x| x / norm(*way))).collect();
        let mut entry2 = f64::INFINITY;
        if let Some(before) = pieces.last() {
            let turn = minus(tangents[0], before.tangent);
            // Where two parts join smoothly, their tangents differ little: at most by the turn of the path within one
            // piece. A larger difference is a corner.
            if norm(turn) > 0.02 {
                let jump = granted(before.tangent, tangents[0], Unsure::default(), &LIMITS, f64::INFINITY);
                entry2 = (norm(jump) / norm(turn)).powi(2);
            }
        }
        for (k, way) in ways.iter().enumerate() {
            let (a, b) = (k.saturating_sub(1), (k + 1).min(ways.len() - 1));
            let apart: f64 =
                ways[a..=b].iter().map(|way| norm(*way)).sum::<f64>() - 0.5 * (norm(ways[a]) + norm(ways[b]));
            pieces.push(Piece {
                tangent: tangents[k],
                curvature: minus(tangents[b], tangents[a]).map(|x| x / apart),
                length: norm(*way),
                entry2: if k == 0 { entry2 } else { f64::INFINITY },
                most2: part.feed * part.feed,
            });
        }
    }
    pieces
}

/// Returns a program that drives a shape in chords, starting at the origin. Also returns the course. It has the
/// intended points, with which the steps are compared.
fn in_chords(shape: &[Part]) -> (String, Course) {
    let start = (shape[0].curve)(0.0);
    let (mut points, mut feeds) = (Vec::new(), Vec::new());
    for part in shape {
        feeds.push((points.len(), part.feed));
        points.extend(along(part, CHORD).into_iter().skip(1).map(|point| minus(point, start)));
    }
    let (text, mut course) = program(&points, Style::mm(5), 100.0);
    course.smooth = true;
    let mut lines: Vec<String> = text.lines().map(str::to_string).collect();
    let header = lines.len() - points.len();
    for (index, feed) in feeds {
        lines[header + index] += &format!(" F{}", feed * 60.0);
    }
    (lines.join("\n") + "\n", course)
}

/// Runs a shape in chords. Returns its duration, s, and the change of an axis' speed that is largest relative to what
/// is allowed.
fn measure(shape: &[Part], jerk: f64) -> (f64, Change) {
    let (text, course) = in_chords(shape);
    let rig = run(&settings(&LIMITS, jerk), &text);
    // The trace does not cover the first and the last half step.
    let unseen = 2.0 * (1.0 / LIMITS.steps_per_mm[0] / LIMITS.acceleration[0]).sqrt();
    (seconds(&rig) + unseen, greatest_change(&rig.trace, HZ as f64, &course, &LIMITS, WINDOW).unwrap())
}

/// Returns the shortest time, s, in which a machine with [`LIMITS`] can drive a shape.
fn shortest(shape: &[Part], bound: Bound) -> f64 {
    let pieces = pieces(shape);
    duration(&pieces, &optimum(&pieces, &LIMITS, bound))
}

/// Checks the reference against known results.
#[test]
fn the_shortest_time_is_known_for_lines_and_circles() {
    let of = |shape: &[Part]| shortest(shape, Bound::EachAxis);
    // A ramp of 10 mm in 0.2 s at both ends.
    let line_along = of(&[line(100.0, [0.0, 0.0], [40.0, 0.0])]);
    assert!((line_along - 0.6).abs() < 0.001, "{line_along}");
    // Both axes of a diagonal help: √2 × 500 mm/s².
    let diagonal = of(&[line(100.0, [0.0, 0.0], [30.0, 30.0])]);
    let expected = 1800.0_f64.sqrt() / 100.0 + 100.0 / (500.0 * 2.0_f64.sqrt());
    assert!((diagonal - expected).abs() < 0.001, "{diagonal}, {expected}");
    // Where the tangent is parallel to one axis, the other one has all the centripetal acceleration, so v² = a R. On
    // R = 5 mm the machine passes these four points of each turn at 50 mm/s and is a little faster between them.
    let turns = of(&[arc(100.0, [0.0, 0.0], 5.0, [0.0, 10.0 * TAU])]);
    let even = 10.0 * TAU * 5.0 / 50.0;
    assert!((0.9 * even..1.02 * even).contains(&turns), "{turns}, {even} at an even speed");
    let turns = shortest(&[arc(100.0, [0.0, 0.0], 5.0, [0.0, 10.0 * TAU])], Bound::Resultant);
    assert!((turns / even - 1.0).abs() < 0.02, "{turns}, {even} at an even speed");
    // At a right angle the junction rule allows v² = √2 a d s / (1 - s), with the acceleration a of an axis, the
    // junction deviation d and s = cos(45°), so s / (1 - s) = 2.41. The machine accelerates and brakes on each side.
    let corner = of(&[line(100.0, [0.0, 0.0], [10.0, 0.0]), line(100.0, [10.0, 0.0], [10.0, 10.0])]);
    let speed = (2.0_f64.sqrt() * 500.0 * 0.01 * 2.414_213_6).sqrt();
    let top = ((2.0 * 500.0 * 10.0 + speed * speed) / 2.0).sqrt();
    let expected = 2.0 * (top + top - speed) / 500.0;
    assert!((corner - expected).abs() < 0.001, "{corner}, {expected}");
}

/// On ten shapes, no axis exceeds its acceleration over 20 ms by more than 5 %. Prints how much longer the shapes take
/// than the shortest time.
#[test]
fn ramps_on_curves_stay_within_the_acceleration_of_each_axis() {
    let mut faults = Vec::new();
    println!(
        "| shape | s | shortest | | with the resultant bounded | change of speed in 20 ms | jerk of 20000 mm/s³ |"
    );
    println!("|---|---|---|---|---|---|---|");
    for (name, shape) in shapes() {
        let (time, change) = measure(&shape, 0.0);
        let (smooth, change_smooth) = measure(&shape, 20_000.0);
        let (least, even) = (shortest(&shape, Bound::EachAxis), shortest(&shape, Bound::Resultant));
        let excess = |change: &Change| {
            ((change.seen - change.granted) / (LIMITS.acceleration[change.axis] * WINDOW) - 1.0) * 100.0
        };
        let more = (time / least - 1.0) * 100.0;
        println!(
            "| {name} | {time:.3} | {least:.3} | {more:+.1} % | {even:.3}, {:+.1} % | {:+.1} % | {smooth:.3} s, {:+.1} % |",
            (even / least - 1.0) * 100.0,
            excess(&change),
            excess(&change_smooth)
        );
        for change in [change, change_smooth] {
            if change.ratio > 1.0 {
                faults.push(format!("{name}: {change}"));
            }
        }
        if !(-1.0..MOST_MORE).contains(&more) {
            faults.push(format!("{name}: {time} s, {least} s at best"));
        }
    }
    assert!(faults.is_empty(), "{}", faults.join("\n"));
}

/// Percent by which a shape may take longer than the shortest time.
const MOST_MORE: f64 = 15.0;

/// Drives a circle so fast that the bend uses all of the acceleration. After `after` seconds, sends `commands`, which
/// make the machine brake. Returns the largest change of speed, and the time, s, from the commands until the path speed
/// is below 15 mm/s.
fn braked_on_a_circle(jerk: f64, after: f64, commands: &[Realtime]) -> (Change, f64) {
    let (text, course) = in_chords(&[arc(100.0, [0.0, 0.0], 20.0, [0.0, 2.0 * TAU])]);
    let mut rig = Rig::with(&settings(&LIMITS, jerk));
    rig.send(text.as_bytes());
    rig.run_for(after);
    let begin = rig.trace.len();
    let time = rig.trace[begin - 1].at;
    for command in commands {
        rig.press(*command);
    }
    rig.run_for(3.0);
    // An upper bound of the path speed: the step rate of all axes together. 1000 steps of an axis are 1 mm.
    let speed = |pulses: &[super::oracle::Pulse]| {
        let ends = pulses[pulses.len() - 1].at - pulses[0].at;
        pulses.iter().map(|pulse| pulse.steps.count_ones()).sum::<u32>() as f64 / (ends as f64 / HZ as f64) / 1000.0
    };
    let slow = rig.trace[begin..].windows(200).find(|pulses| speed(pulses) < 15.0).expect("it brakes");
    let took = (slow[0].at - time) as f64 / HZ as f64;
    rig.press(Realtime::CycleStart);
    rig.press(Realtime::FeedReset);
    assert!(rig.run_until(600.0, |rig| rig.is_idle()));
    (greatest_change(&rig.trace, HZ as f64, &course, &LIMITS, WINDOW).unwrap(), took)
}

/// In a bend, a lower override and a hold brake with the part of the acceleration that the bend does not use. On a
/// circle of radius R, passed at v² = a·R (a: acceleration), braking to rest takes 1.31 · v/a. Here 1.31 is the
/// integral of 1/√(1 - x⁴) from 0 to 1. A jerk limit J adds a/J.
#[test]
fn braking_in_a_bend_stays_within_the_acceleration() {
    let lower = [Realtime::FeedDown10; 9];
    for jerk in [0.0, 5000.0, 20_000.0] {
        let built_up = if jerk > 0.0 { 500.0 / jerk } else { 0.0 };
        for commands in [&lower[..], &[Realtime::FeedHold]] {
            for after in [1.05, 1.15, 1.25] {
                let (change, took) = braked_on_a_circle(jerk, after, commands);
                let most = 1.31 * 100.0 / 500.0 + built_up + 0.016;
                assert!(change.ratio <= 1.0, "jerk {jerk}, {:?}: {change}", commands[0]);
                assert!(took < most, "jerk {jerk}, {:?}: {took} of {most} s", commands[0]);
            }
        }
    }
}
