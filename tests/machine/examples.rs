//! Runs the programs of `examples/` to their end and checks where they end.

use super::host::{CARVER, CARVER_STEPS, assert_near};
use super::oracle::{AXES, Circle, Pulse};
use super::rig::Rig;
use super::seed::CENTRES;
use std::path::PathBuf;

#[path = "../../xtask/src/programs/mod.rs"]
#[allow(dead_code, reason = "the list of the benchmark's jobs is for the command line")]
mod jobs;

const HALF_STEP: f64 = 0.5 / CARVER_STEPS + 1e-9;

fn folder() -> PathBuf {
    PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("examples")
}

pub fn program(name: &str) -> String {
    let path = folder().join(format!("{name}.nc"));
    std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Returns the position after each pulse, in mm. `from`: position before the first pulse, in mm.
pub fn places(trace: &[Pulse], from: [f64; AXES], steps_per_mm: [f64; AXES]) -> Vec<[f64; AXES]> {
    let mut steps = [0; AXES];
    trace
        .iter()
        .map(|pulse| {
            steps = pulse.moved(steps);
            std::array::from_fn(|a| from[a] + steps[a] as f64 / steps_per_mm[a])
        })
        .collect()
}

/// Returns the minimum and the maximum coordinate of each axis.
fn extents(places: &[[f64; AXES]]) -> [[f64; AXES]; 2] {
    let fold =
        |start: f64, pick: fn(f64, f64) -> f64| std::array::from_fn(|a| places.iter().map(|p| p[a]).fold(start, pick));
    [fold(f64::INFINITY, f64::min), fold(f64::NEG_INFINITY, f64::max)]
}

/// Runs an example on a [`CARVER`] and checks its end position and the extents of its path.
fn run(name: &str, end: [f64; AXES], reach: [[f64; AXES]; 2]) -> Rig {
    let mut rig = Rig::with(CARVER);
    rig.run_clean(&program(name));
    assert_near(rig.place_mm(CARVER_STEPS), end, HALF_STEP);
    assert_near(rig.reported("MPos"), end, HALF_STEP + 0.0005);
    let [low, high] = extents(&places(&rig.trace, [0.0; AXES], [CARVER_STEPS; AXES]));
    // The extent of an arc can be off by a step plus the arc tolerance.
    assert_near(low, reach[0], 0.02);
    assert_near(high, reach[1], 0.02);
    rig
}

#[test]
fn house() {
    let mut rig = run("house", [0.0, 20.0, 0.0], [[0.0, 0.0, 0.0], [20.0, 25.0, 0.0]]);
    rig.carry_out("$10=0");
    assert_near(rig.reported("WPos"), [0.0, 20.0, 0.0], 0.0);
}

#[test]
fn five_circles() {
    let rig = run("five_circles", [-2.0, -10.0, 0.0], [[-12.0, -11.0, -1.0], [10.0, 11.0, 0.0]]);
    // The parts of the path at cutting depth, between the rapids: each is a full circle.
    let all = places(&rig.trace, [0.0; AXES], [CARVER_STEPS; AXES]);
    let cuts: Vec<&[[f64; AXES]]> = all.split(|p| p[2] != -1.0).filter(|cut| !cut.is_empty()).collect();
    assert_eq!(cuts.len(), 5);
    for (cut, centre) in cuts.iter().zip(CENTRES) {
        let start = [centre[0] - 1.0, centre[1], -1.0];
        Circle { axes: [0, 1, 2], centre, from: start, to: start, clockwise: false }
            .follows(cut, 0.002 + 1.25 / CARVER_STEPS, 3.0 / CARVER_STEPS)
            .unwrap();
    }
}

/// The drilling program of chapter 4.5 of S. Tajima's document drills its holes in order. It runs in the dialect
/// `$900=2`, which has drilling cycles.
#[test]
fn drilling() {
    const INCH: f64 = 25.4;
    let mut rig = Rig::with(CARVER);
    rig.carry_out("$900=2");
    rig.run_clean(&program("drilling"));
    let end = [-7.0 * INCH, -4.0 * INCH, 0.1 * INCH];
    assert_near(rig.place_mm(CARVER_STEPS), end, HALF_STEP);
    assert_near(rig.reported("MPos"), end, HALF_STEP + 0.0005);
    let all = places(&rig.trace, [0.0; AXES], [CARVER_STEPS; AXES]);
    // Positions at the bottom of each hole, in drilling order. One hole is drilled twice.
    let bottom = (-0.75 * INCH * CARVER_STEPS).round() / CARVER_STEPS;
    let mut holes: Vec<f64> = Vec::new();
    for cut in all.split(|p| p[2] != bottom).filter(|cut| !cut.is_empty()) {
        assert!((cut[0][1] - -4.0 * INCH).abs() <= HALF_STEP);
        holes.push(cut[0][0]);
    }
    let columns =
        [-7.0, -5.8889, -4.7778, -3.6667, -2.5556, -1.4444, -1.4444, -0.3333, 0.7778, 1.8889, 3.0].map(|x| x * INCH);
    assert_eq!(holes.len(), columns.len());
    for (hole, column) in holes.iter().zip(columns) {
        assert!((hole - column).abs() <= HALF_STEP, "{hole} for {column}");
    }
    // X and Y do not move while the tool is in the work.
    for pair in all.windows(2) {
        assert!(pair[0][2] > 0.0 || pair[0][..2] == pair[1][..2], "{pair:?}");
    }
    // Each peck goes 0.2 inch deeper, the first one from the retract plane R. At the end of each peck the tool reverses
    // and retracts by 0.01 inch.
    let turns: Vec<f64> = all
        .windows(3)
        .filter(|p| p[0][0] == first_hole(&all, bottom) && p[0][2] > p[1][2] && p[2][2] > p[1][2])
        .map(|p| p[1][2])
        .collect();
    let grounds = [-0.1, -0.3, -0.5, -0.7, -0.75].map(|z| z * INCH);
    assert_eq!(turns.len(), grounds.len(), "{turns:?}");
    for (turn, ground) in turns.iter().zip(grounds) {
        assert!((turn - ground).abs() <= HALF_STEP, "{turn} for {ground}");
    }
    let [low, high] = extents(&all);
    assert_near(low, [-7.0 * INCH, -4.0 * INCH, -0.75 * INCH], HALF_STEP);
    assert_near(high, [3.0 * INCH, 0.0, 0.1 * INCH], HALF_STEP);
}

/// Returns X of the first hole, mm.
fn first_hole(all: &[[f64; AXES]], bottom: f64) -> f64 {
    all.iter().find(|place| place[2] == bottom).map_or(f64::NAN, |place| place[0])
}

#[test]
fn pocket_mm() {
    run("pocket_mm", [0.0, 0.0, 5.0], [[-37.0, -22.0, -6.0], [37.0, 22.0, 5.0]]);
}

#[test]
fn pocket_inch() {
    let inch = 25.4;
    run(
        "pocket_inch",
        [0.0, 0.0, 0.25 * inch],
        [[-1.375 * inch, -0.625 * inch, -0.375 * inch], [1.375 * inch, 0.625 * inch, 0.25 * inch]],
    );
}

#[test]
fn relief() {
    run("relief", [0.0, 0.0, 3.0], [[0.0, 0.0, -3.2], [60.0, 40.0, 3.0]]);
}

#[test]
fn pcb_isolation() {
    run("pcb_isolation", [0.0, 0.0, 10.0], [[0.0, 0.0, -0.3], [60.0, 44.0, 10.0]]);
}

#[test]
fn every_example_has_a_test_and_short_lines() {
    let mut names: Vec<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|e| e == "nc"))
        .map(|path| path.file_stem().unwrap().to_string_lossy().into_owned())
        .collect();
    names.sort();
    assert_eq!(names, ["drilling", "five_circles", "house", "pcb_isolation", "pocket_inch", "pocket_mm", "relief"]);
    for name in names {
        let text = program(&name);
        assert!(text.is_ascii(), "{name}");
        assert!(text.len() < 1000 * 1024, "{name}");
        for line in text.lines() {
            // The limit includes blanks and comments, although Grbl does not count these.
            assert!(line.len() <= 79, "{name}: {line}");
        }
    }
}

#[test]
fn generated_examples_are_what_their_generators_write() {
    assert!(!jobs::generate("no such program", &mut Vec::new()).unwrap());
    for name in jobs::NAMES {
        let mut text = Vec::new();
        assert!(jobs::generate(name, &mut text).unwrap());
        assert!(text == program(name).into_bytes(), "examples/{name}.nc differs: cargo xtask job {name}");
    }
}

#[test]
fn the_relief_is_long_and_fine() {
    let text = program("relief");
    assert!(text.lines().count() > 50_000);
    assert!(text.lines().filter(|line| line.starts_with('X')).count() > 50_000);
}
