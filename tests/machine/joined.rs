//! Straight lines in very short chords take as long as one line and end at the same position.

use super::oracle::AXES;
use super::rig::HZ;
use oxmill_simulator::{JobText, Options, Simulator};
use std::fmt::Write;
use std::io::Cursor;
use std::time::Duration;

/// Returns the seconds from the first step to the last, and the end position in steps.
fn run(scale: f64, job: &str) -> (f64, [i64; AXES]) {
    let mut mill = Simulator::new(Options { keep_steps: true, ..Options::default() });
    let mut settings = String::from("$0=1\n$11=0.01\n");
    for axis in 0..AXES {
        writeln!(settings, "$10{axis}={scale}\n$11{axis}=6000\n$12{axis}=500").unwrap();
    }
    mill.send(settings.as_bytes());
    assert!(mill.run_until_idle());
    mill.take_output();
    mill.begin_job();
    mill.load_job(JobText::new(Cursor::new(job.as_bytes().to_vec())));
    // Read the answers promptly, because the machine waits when its output is full.
    while !mill.is_idle() {
        mill.run_for(Duration::from_millis(20));
        assert!(!mill.take_output().contains("error"));
    }
    let steps = mill.trace().kept();
    ((steps[steps.len() - 1].at - steps[0].at) as f64 / HZ as f64, mill.machine().position().map(i64::from))
}

/// Returns two programs for a line of 60 mm at an angle (in degrees): as one move, and in chords. Coordinates have
/// `decimals` decimals.
fn line(angle: f64, chord: f64, decimals: usize) -> [String; 2] {
    let (y, x) = angle.to_radians().sin_cos();
    let count = (60.0 / chord) as u32;
    let at = |k: u32| {
        let along = 60.0 * f64::from(k) / f64::from(count);
        format!("X{:.decimals$} Y{:.decimals$}\n", along * x, along * y)
    };
    [at(count), (1..=count).map(at).collect()].map(|moves| format!("G21 G90 G1 F6000\n{moves}"))
}

/// A line in tiny chords takes the time of a single move. The controller joins such chords, so their number does not
/// limit the distance that the look-ahead covers.
#[test]
fn a_line_in_tiny_chords_takes_the_time_of_one() {
    for (angle, decimals) in [(0.0, 3), (90.0, 4), (33.0, 3), (40.0, 3), (21.3, 4), (71.0, 5)] {
        for (scale, chord) in [(80.0, 0.005), (80.0, 0.002), (250.0, 0.005), (250.0, 0.002)] {
            let [one, chords] = line(angle, chord, decimals);
            let ((whole, end), (pieces, place)) = (run(scale, &one), run(scale, &chords));
            assert_eq!(place, end);
            let ratio = pieces / whole;
            assert!(ratio < 1.02, "{ratio}: {chord} mm at {angle}°, {decimals} decimals, {scale} steps/mm");
        }
    }
}
