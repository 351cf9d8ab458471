//! Compares the measured maximum speed and acceleration with the feed rate of the program and with the acceleration
//! setting. The programs are circles and lines, each as one move or as many short straight moves, on coarse and fine
//! steps.

use oxmill_simulator::meter::Measured;
use oxmill_simulator::{JobText, Options, Simulator};
use std::fmt::Write;

/// Acceleration of X and Y, mm/s².
const ACCELERATION: f64 = 500.0;

/// Returns the measurements of a program on a machine with `resolution` steps per mm.
fn measured(resolution: u32, program: &str) -> Measured {
    let mut mill = Simulator::new(Options::default());
    for axis in 0..2 {
        let number = 100 + axis;
        mill.send(format!("${number}={resolution}\n${}=3600\n${}={ACCELERATION}\n", number + 10, number + 20));
        mill.run_until_idle();
    }
    mill.begin_job();
    mill.take_output();
    mill.load_job(JobText::new(std::io::Cursor::new(program.to_owned())));
    while !mill.is_idle() && mill.advance_once(u64::MAX) {}
    let said = mill.take_output();
    assert!(!said.contains("error") && !said.contains("ALARM"), "{program}: {said}");
    mill.meter().measured()
}

fn assert_near(value: f64, low: f64, high: f64, what: &str) {
    assert!((low..=high).contains(&value), "{what}: {value} is not in {low} to {high}");
}

/// Returns a number from 0 to 1 for an index. Consecutive indices give evenly spread numbers (multiples of the golden
/// ratio).
fn spread(index: usize) -> f64 {
    (index as f64 * 0.618_033_988_75).fract()
}

#[test]
fn a_circle_at_feed_has_the_speed_and_the_ramps_of_its_program() {
    for resolution in [80, 250, 1000] {
        for (radius, feed) in [(0.5, 300.0), (2.0, 600.0), (5.0, 1000.0), (20.0, 3000.0)] {
            let what = format!("a circle of R {radius} at F{feed} and {resolution} steps/mm");
            let m = measured(resolution, &format!("G21 G91 G2 X0 Y0 I{radius} F{feed}"));
            assert_near(m.speed * 60.0, feed * 0.99, feed * 1.01, &what);
            // The smallest circle on the coarsest steps has few steps along an axis, and its ramp is two steps long.
            let coarse = radius * f64::from(resolution) < 100.0;
            for axis in 0..2 {
                let least = if coarse { 0.93 } else { 0.97 };
                assert_near(m.axis_speed[axis] * 60.0, feed * least, feed * 1.01, &what);
                assert!(m.axis_acceleration[axis] <= ACCELERATION * 1.03, "{what}: {m:?}");
            }
            let least = if coarse { 0.7 } else { 0.93 };
            assert_near(m.acceleration, ACCELERATION * least, ACCELERATION * 1.05, &what);
            let length = std::f64::consts::TAU * radius;
            assert_near(m.distance, length * 0.99, length * 1.005, &what);
        }
    }
}

#[test]
fn a_line_has_the_speed_and_the_ramps_of_its_program() {
    for (index, resolution) in [80, 100, 250, 400, 1000].into_iter().cycle().take(25).enumerate() {
        let (angle, feed) = (spread(index) * std::f64::consts::TAU, 300.0 + 2700.0 * spread(index + 7));
        // A ramp from rest to the feed rate v with the acceleration a is v^2 / (2 a) long. The line is at least six
        // ramps long, so that most of it is at the feed rate, and has at least 400 steps.
        let length = (3.0 * (feed / 60.0).powi(2) / ACCELERATION).max(400.0 / f64::from(resolution));
        let (x, y) = (length * angle.cos(), length * angle.sin());
        let program = format!("G21 G91 G1 X{x:.4} Y{y:.4} F{feed:.1}");
        let m = measured(resolution, &program);
        let what = format!("{program} at {resolution} steps/mm");
        assert_near(m.speed * 60.0, feed * 0.99, feed * 1.01, &what);
        let longer = x.abs().max(y.abs()) / length;
        assert_near(m.acceleration, ACCELERATION / longer * 0.96, ACCELERATION / longer * 1.03, &what);
        for (axis, part) in [x / length, y / length].into_iter().enumerate() {
            let speed = feed * part.abs();
            assert_near(m.axis_speed[axis] * 60.0, speed * 0.98 - 2.0, speed * 1.01 + 2.0, &what);
        }
        assert_near(m.distance, length * 0.995, length * 1.005, &what);
    }
}

/// Returns a program of straight moves, at most `chord` mm each, along a path of `length` mm. `place` returns the
/// position (X, Y) after a fraction of the path.
fn pieces(feed: f64, length: f64, chord: f64, place: impl Fn(f64) -> (f64, f64)) -> String {
    let count = (length / chord).ceil();
    let mut program = format!("G21 G90 F{feed}\n");
    for index in 1..=count as usize {
        let (x, y) = place(index as f64 / count);
        writeln!(program, "G1 X{x:.3} Y{y:.3}").expect("a text takes it");
    }
    program
}

#[test]
fn a_line_in_chords_has_the_speed_of_its_program() {
    let feed = 1500.0;
    for resolution in [80, 250, 1000] {
        for (index, chord) in [0.01, 0.03, 0.1, 0.4, 1.0].into_iter().enumerate() {
            let (angle, length) = (spread(index + resolution as usize) * std::f64::consts::FRAC_PI_2, 12.0);
            let program =
                pieces(feed, length, chord, |part| (length * part * angle.cos(), length * part * angle.sin()));
            let m = measured(resolution, &program);
            let what = format!("a line at {angle:.2} rad in chords of {chord} mm at {resolution} steps/mm");
            assert_near(m.speed * 60.0, feed * 0.985, feed * 1.01, &what);
            // The speed of an axis does not exceed its share of the feed, whatever the directions of the short moves
            // are.
            for (axis, part) in [angle.cos(), angle.sin()].into_iter().enumerate() {
                assert_near(m.axis_speed[axis] * 60.0, feed * part * 0.97 - 15.0, feed * part * 1.01 + 15.0, &what);
            }
            let longer = angle.cos().max(angle.sin());
            assert_near(m.acceleration, ACCELERATION * 0.6, ACCELERATION / longer * 1.05, &what);
            assert_near(m.distance, length * 0.98, length * 1.02, &what);
        }
    }
}

#[test]
fn a_circle_in_chords_has_the_speed_of_its_program() {
    let (feed, radius) = (900.0, 5.0);
    let length = std::f64::consts::TAU * radius;
    for resolution in [80, 250, 1000] {
        for chord in [0.02, 0.05, 0.2, 0.6] {
            let program = pieces(feed, length, chord, |part| {
                let (sin, cos) = (std::f64::consts::TAU * part).sin_cos();
                (radius * sin, radius - radius * cos)
            });
            let m = measured(resolution, &program);
            let what = format!("a circle in chords of {chord} mm at {resolution} steps/mm");
            // The maximum speed must be the feed rate, and not more. Whether the feed rate is reached everywhere is not
            // tested here.
            assert_near(m.speed * 60.0, feed * 0.97, feed * 1.01, &what);
            assert_near(m.acceleration, ACCELERATION * 0.5, ACCELERATION * 1.5, &what);
            assert_near(m.distance, length * 0.98, length * 1.02, &what);
        }
    }
}

#[test]
fn rounding_to_coarse_steps_is_no_speed() {
    // Each move is three quarters of a step long. Rounded to steps, it becomes a third longer, or has no length.
    let program = pieces(600.0, 30.0, 0.03, |part| (30.0 * part, 0.0));
    let m = measured(25, &program);
    assert_near(m.speed * 60.0, 570.0, 606.0, "a line in pieces below a step");
    assert!(m.acceleration <= ACCELERATION * 1.05, "{m:?}");
}
