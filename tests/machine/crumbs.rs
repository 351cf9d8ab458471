//! Tiny moves between long ones: shorter than a step, or shorter than the resolution of the program's coordinates.

use super::oracle::AXES;
use super::rig::{HZ, Rig};

/// Returns the intervals between the steps of an axis, s.
fn intervals(rig: &Rig, axis: usize) -> Vec<f64> {
    let times: Vec<u64> = rig.trace.iter().filter(|p| p.steps >> axis & 1 != 0).map(|p| p.at).collect();
    times.windows(2).map(|w| (w[1] - w[0]) as f64 / HZ as f64).collect()
}

fn machine(scale: f64, rate: f64, acceleration: f64) -> Rig {
    let mut text = String::from("$0=1\n$11=0.01\n");
    for axis in 0..AXES {
        text += &format!("$10{axis}={scale}\n$11{axis}={}\n$12{axis}={acceleration}\n", rate * 60.0);
    }
    Rig::with(&text)
}

/// A move of 0.2 nm crosses the position at which a coordinate is rounded to the next step, so it makes one step. No
/// interval between two steps may be shorter than half of the interval at the axis' maximum rate.
#[test]
fn a_hairs_breadth_is_no_faster_than_its_axis() {
    let mut rig = machine(80.0, 100.0, 500.0);
    rig.run_clean("G0 X10.0062499\nG0 X10.0062501\nG0 X30\n");
    let least = intervals(&rig, 0).into_iter().fold(f64::MAX, f64::min);
    assert!(least > 0.99 * 0.5 / 80.0 / 100.0, "{least} s");
}

/// Y must not exceed its maximum rate in lines that move Y by steps and X by less than a step.
#[test]
fn beside_a_hairs_breadth_axes_keep_their_rates() {
    let mut rig = Rig::with("$0=1\n$11=0.01\n$100=80\n$101=400\n$110=6000\n$111=600\n$120=500\n$121=100\n");
    let lines: String = (1..2000)
        .map(|k| format!("X{} Y{:.3}\n", if k % 2 == 0 { "0.0062" } else { "0.0063" }, 0.005 * f64::from(k)))
        .collect();
    rig.run_clean(&format!("G0\n{lines}"));
    let least = intervals(&rig, 1).chunks(16).map(|w| w.iter().sum::<f64>() / w.len() as f64).fold(f64::MAX, f64::min);
    assert!(1.0 / 400.0 / least < 10.5, "{} mm/s", 1.0 / 400.0 / least);
}

/// A straight line in short chords is not slowed by corners, even if one axis has coarse steps and the other has fine
/// ones.
#[test]
fn coarse_steps_make_no_corners() {
    let mut rig = Rig::with("$0=1\n$11=0.01\n$100=250\n$101=8.889\n$110=6000\n$111=6000\n$120=500\n$121=500\n");
    let lines: String =
        (1..2000).map(|k| format!("X{:.2} Y{:.3}\n", 0.02 * f64::from(k), 0.004 * f64::from(k))).collect();
    rig.run_clean(&format!("G1 F1200\n{lines}"));
    let seconds = (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64;
    // 40.8 mm at 20 mm/s take 2.04 s.
    assert!(seconds < 2.3, "{seconds} s");
}

/// With G93, a tiny move that becomes a whole step by rounding takes its programmed time and no more.
#[test]
fn inverse_time_of_a_hairs_breadth() {
    let mut rig = machine(80.0, 100.0, 500.0);
    rig.run_clean("G93 G1 X10.0062499 F60\nG1 X10.0062501 F60\nG1 X20 F60\n");
    let seconds = (rig.trace[rig.trace.len() - 1].at - rig.trace[0].at) as f64 / HZ as f64;
    assert!(seconds > 2.0 && seconds < 3.5, "{seconds} s");
}

/// A long move of X is followed by moves of Y, back and forth by less than a step, and then by another long move of X.
/// X stands still during the moves of Y. So X must brake before them to the speed allowed at a corner, and accelerate
/// from that speed after them.
#[test]
fn a_wait_for_crumbs_is_a_corner() {
    let mut rig = machine(80.0, 100.0, 500.0);
    let crumbs = "Y0.005\nY0\n".repeat(50);
    rig.run_clean(&format!("G1 X20 Y0 F6000\n{crumbs}X20.0125\nX60\n"));
    let speeds: Vec<f64> = intervals(&rig, 0).iter().map(|seconds| 1.0 / 80.0 / seconds).collect();
    // The junction rule, v² = √2 a d s / (1 - s), allows 4.1 mm/s at a right angle (a: acceleration of an axis, d:
    // junction deviation, s = cos(45°)). One step (0.0125 mm) later the acceleration has raised this to 5.4 mm/s.
    let slowest = speeds[200..3000].iter().copied().fold(f64::MAX, f64::min);
    assert!(slowest < 6.0, "{slowest} mm/s");
    // Compare mean speeds over 32 steps (0.4 mm), because the smoothing of steps makes single intervals uneven. Over
    // 0.4 mm the acceleration a changes v² by 2 a × 0.4 mm. The test allows 1.2 times this change, plus 40 (mm/s)²
    // for the speed jump at the corner.
    let means: Vec<f64> = speeds.chunks(32).map(|w| w.len() as f64 / w.iter().map(|v| 1.0 / v).sum::<f64>()).collect();
    for pair in means.windows(2) {
        let change = (pair[1] * pair[1] - pair[0] * pair[0]).abs();
        assert!(change < 1.2 * 2.0 * 500.0 * 0.4 + 40.0, "{pair:?} mm/s");
    }
}

/// The machine slows down at a corner between moves of 0.0005 mm. These are shorter than the usual resolution of
/// programs (0.001 mm), but still longer than its steps (0.0001 mm).
#[test]
fn corners_between_moves_shorter_than_a_digit() {
    let mut rig = machine(10_000.0, 10.0, 100.0);
    let (x, y) = ("X0.0005\n".repeat(2000), "Y0.0005\n".repeat(2000));
    rig.run_clean(&format!("G91 G1 F600\n{x}{y}"));
    let last = intervals(&rig, 0);
    let speed = 10.0 / 10_000.0 / last[last.len() - 10..].iter().sum::<f64>();
    // The junction rule (see above) allows 1.8 mm/s at a right angle. The test allows 3 mm/s, because rounding changes
    // the directions of such short moves, and with them the angle of the corner.
    assert!(speed < 3.0, "{speed} mm/s into the corner");
    let back = "X-0.0004 Y0.0003\n".repeat(2000);
    let mut rig = machine(10_000.0, 10.0, 100.0);
    rig.run_clean(&format!("G91 G1 F600\n{x}{back}"));
    let turn = rig.trace.iter().position(|p| p.steps & 1 != 0 && p.directions & 1 != 0).unwrap();
    let speed = 20.0 / 10_000.0 / ((rig.trace[turn].at - rig.trace[turn - 20].at) as f64 / HZ as f64);
    assert!(speed < 3.0, "{speed} mm/s into the turn");
}

/// A reversal of X, in which the motor also takes up backlash, is carried out even with the extreme resolutions of
/// 0.1 steps/mm on X and 40,000 steps/mm on Z.
#[test]
fn backlash_on_the_longest_moves() {
    let settings = "$0=1\n$11=0\n$100=0.1\n$160=70\n$102=40000\n$110=60000\n$112=100\n$120=1000\n$122=100\n";
    let mut rig = Rig::with(settings);
    rig.send(b"G1 X4000 F600000\nG1 X-4000 Z5000\n");
    rig.run_for(60.0);
    assert!(rig.place[0] > 0);
}
