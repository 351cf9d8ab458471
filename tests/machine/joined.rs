//! Straight lines in very short chords: as fast as one line, and no other path.

use super::oracle::AXES;
use super::rig::{HZ, Rig};
use std::fmt::Write;

fn machine(scale: f64, more: &str) -> Rig {
    let mut text = String::from("$0=1\n$11=0.01\n");
    for axis in 0..AXES {
        writeln!(text, "$10{axis}={scale}\n$11{axis}=6000\n$12{axis}=500").unwrap();
    }
    Rig::with(&(text + more))
}

fn seconds(rig: &Rig) -> f64 {
    (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64
}

/// The end of a line of this length at an angle (in degrees), and the same in chords, written with some decimals.
fn line(length: f64, angle: f64, chord: f64, decimals: usize) -> (String, String) {
    let (y, x) = angle.to_radians().sin_cos();
    let count = (length / chord).round();
    let at = |k: f64| {
        let along = length * k / count;
        format!("X{:.decimals$} Y{:.decimals$}\n", along * x, along * y)
    };
    (at(count), (1..=count as u32).map(|k| at(f64::from(k))).collect())
}

/// Look-ahead is no matter of how many moves a line is made of.
#[test]
fn a_line_in_tiny_chords_takes_the_time_of_one() {
    for (angle, decimals) in [(0.0, 3), (90.0, 4), (33.0, 3), (21.3, 4), (71.0, 5)] {
        for scale in [80.0, 250.0] {
            for chord in [0.005, 0.002] {
                for jerk in ["", "$220=20000\n$221=20000\n$222=20000\n"] {
                    let (one, chords) = line(60.0, angle, chord, decimals);
                    let time = |text: &str| {
                        let mut rig = machine(scale, jerk);
                        rig.run_clean(&format!("G21 G90 G1 F6000\n{text}"));
                        (seconds(&rig), rig.place)
                    };
                    let ((whole, end), (pieces, place)) = (time(&one), time(&chords));
                    let ratio = pieces / whole;
                    println!("{angle} {decimals} {scale} {chord} {jerk:?}: {ratio}");
                    assert_eq!(place, end);
                    assert!(
                        ratio < 1.02,
                        "{pieces} s for {whole} s: {chord} mm at {angle}°, {scale} steps/mm {jerk:?}"
                    );
                }
            }
        }
    }
}
