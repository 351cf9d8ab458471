//! Turns that a program makes of short chords: taken no faster than the same turn in one vertex or as an arc, and no slower.
//! How the speeds of axes are read and what is allowed: [`super::axis_speeds`].

use super::axis_speeds::{Course, greatest_change};
use super::estimator::Limits;
use super::oracle::AXES;
use super::rig::{HZ, Rig};
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

fn settings(limits: &Limits, jerk: f64) -> String {
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
struct Style {
    inches: bool,
    decimals: usize,
}

impl Style {
    const fn mm(decimals: usize) -> Style {
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
fn program(meant: &[[f64; AXES]], style: Style, feed: f64) -> (String, Course) {
    let mut text =
        format!("G{} G90 G94 G17\nG1 F{:.5}\n", if style.inches { 20 } else { 21 }, feed * 60.0 / style.unit());
    let digits = style.decimals;
    let mut course = Course {
        meant: vec![[0.0; AXES]],
        written: vec![[0.0; AXES]],
        digit: style.unit() * 0.1_f64.powi(digits as i32),
        feed,
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
fn run(settings: &str, program: &str) -> Rig {
    let mut rig = Rig::with(settings);
    rig.run_clean(program);
    rig
}

/// From the first to the last step.
fn seconds(rig: &Rig) -> f64 {
    (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
}

/// Seconds of a program of straight moves at 100 mm/s, 250 steps/mm.
fn seconds_of(points: &[[f64; AXES]], style: Style) -> f64 {
    seconds(&run(&settings(&limits(250.0), 0.0), &program(points, style, 100.0).0))
}

/// The greatest change of an axis' speed over any of the windows.
fn worst(rig: &Rig, course: &Course, limits: &Limits) -> super::axis_speeds::Change {
    let changes = WINDOWS.map(|window| greatest_change(&rig.trace, HZ as f64, course, limits, window).unwrap());
    changes.into_iter().max_by(|a, b| a.ratio.total_cmp(&b.ratio)).unwrap()
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
            let (time, worst) = (seconds(&rig), worst(&rig, &course, &limits));
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
