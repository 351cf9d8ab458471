//! Tests of G5 to G5.3: the curve that a line describes.

#![cfg(feature = "full")]

use crate::program::{Program, in_mm};
use oxmill_controller::gcode::{Action, Dialect, Feed, MotionCommand};
use oxmill_controller::units::DECIMAL_ONE;

/// Half of the square root of 3.
const H: f64 = 0.866_025_403_784_438_6;

fn ready(setup: &str) -> Program {
    let mut program = Program::new(Dialect::Oxmill);
    program.run_all("G21 G90 G17 F300");
    program.run_all(setup);
    program
}

/// Returns the control points in X and Y of the machine, mm.
fn curve(checked: &Action<3>) -> [[f64; 2]; 4] {
    let MotionCommand::Spline(spline) = checked.motion else { panic!("no spline: {:?}", checked.motion) };
    assert_eq!((spline.corners()[0], spline.corners()[3]), (spline.start, spline.target));
    assert_eq!(*checked.position(), spline.target);
    spline.corners().map(|corner| [corner.0[0], corner.0[1]].map(|c| c.0 as f64 / DECIMAL_ONE as f64))
}

/// Runs `setup` and then `line`. Checks the control points of the curve of `line` (X and Y of the machine, mm), except
/// the first one, which is its start.
fn gives(setup: &str, line: &str, wanted: [[f64; 2]; 3]) -> Program {
    let mut program = ready(setup);
    let found = curve(&program.run(line));
    for (found, wanted) in found[1..].iter().zip(wanted) {
        let near = (found[0] - wanted[0]).abs() < 1.6e-7 && (found[1] - wanted[1]).abs() < 1.6e-7;
        assert!(near, "{line}: {found:?}, not {wanted:?}");
    }
    program
}

#[test]
fn two_control_points() {
    let mut program = gives("", "G5 I0 J3 P0 Q-3 X1 Y1", [[0.0, 3.0], [1.0, -2.0], [1.0, 1.0]]);
    // Without I and J, a curve starts in the direction in which the last one ended. G5 is modal.
    assert_eq!(curve(&program.run("G5 P0 Q-3 X2 Y2")), [[1.0, 1.0], [1.0, 4.0], [2.0, -1.0], [2.0, 2.0]]);
    assert_eq!(curve(&program.run("P-1 Q.5 X7")), [[2.0, 2.0], [2.0, 5.0], [6.0, 2.5], [7.0, 2.0]]);
    assert_eq!(curve(&program.run("G91 I1 J1 P-1 Q.5 Y1")), [[7.0, 2.0], [8.0, 3.0], [6.0, 3.5], [7.0, 3.0]]);
    assert_eq!(program.interpreter.modal().motion.word(), "G5");
}

#[test]
fn one_control_point() {
    let program = gives("G0 X1 Y2", "G5.1 X4 Y-1 I3 J6", [[3.0, 6.0], [4.0, 5.0], [4.0, -1.0]]);
    assert_eq!(program.interpreter.modal().motion.word(), "G5.1");
    gives("G91 G0 X1 Y2", "G5.1 X3 I.1 J0", [[1.0 + 0.2 / 3.0, 2.0], [2.0 + 0.2 / 3.0, 2.0], [4.0, 2.0]]);
}

/// Units, offsets and rotations act on control points as on all coordinates. Control points are written as distances
/// even with G90.1.
#[test]
fn what_acts_on_control_points() {
    gives("G20", "G5 I1 J2 P-1 Q0 X3 Y0", [[25.4, 50.8], [50.8, 0.0], [76.2, 0.0]]);
    gives("G90.1 G0 X5", "G5 I1 J2 P-1 Q0 X8 Y0", [[6.0, 2.0], [7.0, 0.0], [8.0, 0.0]]);
    gives("G10 L2 P1 X10 Y20\nG92 X-1 Y-1", "G5 I1 J2 P-1 Q0 X3 Y0", [[1.0, 2.0], [3.0, 1.0], [4.0, 1.0]]);
    gives("G10 L2 P1 X10 R90\nG0 X0 Y0", "G5 I1 J2 P-1 Q0 X3 Y0", [[8.0, 1.0], [10.0, 2.0], [10.0, 3.0]]);
    let end = [10.0 + 3.0 * H, 1.5];
    gives("G68 X10 Y0 R30\nG0 X10 Y0", "G5 I1 J0 P-1 Q0 X13", [[10.0 + H, 0.5], [end[0] - H, 1.0], end]);
    gives("G43.1 X1 Y-1 Z5", "G5 I1 J2 P-1 Q0 X3 Y0", [[1.0, 2.0], [3.0, -1.0], [4.0, -1.0]]);
}

/// A G5 without I and J starts in the direction in which the last G5 ended. Other lines may come between the two, but
/// the tool must be where the last G5 ended.
#[test]
fn going_on_smoothly() {
    let first = "G5 I1 J2 P-1 Q.5 X3 Y0";
    for between in ["", "G1", "F100 M8", "G4 P0", "G1 Z5", "G21 G17", "G80", "G1 X5\nX3", "G92 X7 Y7", "N5"] {
        let mut program = ready(first);
        program.run_all(between);
        let found = curve(&program.run("G91 G5 X1 P0 Q0"));
        assert_eq!(found[1], [4.0, -0.5], "{between}");
    }
    let mut program = ready(first);
    program.run("G68 X3 Y0 R90");
    assert_eq!(curve(&program.run("G5 X4 Y0 P-1 Q0")), [[3.0, 0.0], [4.0, -0.5], [3.0, 0.0], [3.0, 1.0]]);
    for between in ["", "G1 X4", "G28", "M2", "G5 X4 I0 J0 P0 Q0\nG1 X3 Y0", "G5.1 X4 I0 J1"] {
        let mut program = if between.is_empty() { ready("") } else { ready(first) };
        program.run_all(between);
        assert_eq!(program.error("G17 G90 F1 G5 X9 P0 Q0"), 28, "{between}");
    }
    let mut program = ready(first);
    program.interpreter.reset();
    assert_eq!(program.error("F1 G5 X9 P0 Q0"), 28);
    let mut program = ready(first);
    program.interpreter.change_dialect();
    assert_eq!(program.error("F1 G5 X9 P0 Q0"), 28);
    // After a jog to another place, I and J are needed. After a jog back they are not.
    let mut program = ready(first);
    let jog = program.interpreter.check_jog(b"X9F100", Dialect::Oxmill).unwrap();
    program.interpreter.commit(&jog);
    assert_eq!(program.error("G5 X9 P0 Q0"), 28);
    let jog = program.interpreter.check_jog(b"X3F100", Dialect::Oxmill).unwrap();
    program.interpreter.commit(&jog);
    assert_eq!(program.error("G5 X9 P0 Q0"), 0);
}

#[test]
fn feeds() {
    let feed = |line: &str| match ready("").run(line).motion {
        MotionCommand::Spline(spline) => spline.feed,
        _ => panic!("{line}"),
    };
    assert_eq!(feed("G5 I1 J2 P-1 Q0 X3"), Feed::PerMinute(5.0));
    assert_eq!(feed("G93 F30 G5.1 I1 J2 X3"), Feed::InverseTime(2.0));
}

#[test]
fn what_is_refused() {
    let mut program = ready("");
    for (line, error) in [
        ("G5 I1 J1 P1 Q1", 26),
        ("G5.1 I1 J1", 26),
        ("G5", 26),
        ("G5 I1 P1 Q1 X1", 28),
        ("G5 J1 P1 Q1 X1", 28),
        ("G5 I1 J1 P1 X1", 28),
        ("G5 I1 J1 Q1 X1", 28),
        ("G5 I1 J1 X1", 28),
        ("G5 P1 Q1 X1", 28),
        ("G5.1 I1 X1", 28),
        ("G5.1 X1", 28),
        ("G5 I1 J1 P1 Q1 X1 Z1", 140),
        ("G5 I1 J1 P1 Q1 Z1", 140),
        ("G18 G5 I1 J1 P1 Q1 X1", 140),
        ("G5.1 G19 I1 J1 X1", 140),
        ("G5 I1 J1 K1 P1 Q1 X1", 36),
        ("G5 I1 J1 P1 Q1 X1 R1", 36),
        ("G5.1 I1 J1 P1 X1", 36),
        ("G5.1 I1 J1 P-1 X1", 4),
        ("G1 P-1 X1", 4),
        ("G4 P-1", 4),
        ("G10 L2 P-1 X1", 4),
        ("G2 X1 I1 P-1", 4),
        ("G4 P1 G5 I1 J1 Q1 X1", 28),
        ("G53 G5 I1 J1 P1 Q1 X1", 30),
        ("G5 G1 I1 J1 P1 Q1 X1", 24),
        ("G5 G28 I1 J1 P1 Q1 X1", 24),
        ("G93 G5 I1 J1 P1 Q1 X1", 22),
        ("G5 I60000 J1 P1 Q1 X1", 33),
        ("G5 I1 J1 P-60000 Q1 X1", 33),
        ("G5 I1 J1 P1 Q1 X60000", 33),
        ("G5.1 I9999999 J1 X1", 33),
        ("G5.4", 20),
        ("G18 G68 X0 Z0 R1", 0),
    ] {
        let before = program.interpreter.clone();
        assert_eq!(program.error(line), error, "{line}");
        assert!(program.interpreter == before, "{line}");
    }
    program.run("G18 G68 X0 Z0 R1");
    assert_eq!(program.error("G17 G5 I1 J1 P1 Q1 X1"), 126);
    let no_feed = Program::new(Dialect::Seed);
    assert_eq!(no_feed.error("G5 I1 J1 P1 Q1 X1"), 22);
    let jog = |line: &[u8]| program.interpreter.check_jog(line, Dialect::Oxmill).map(|_| ());
    assert_eq!(jog(b"G17G69G5X1I1J1P1Q1F100").map_err(|error| error.code()), Err(16));
}

/// While G5 is in force, the P of a curve (G5) can be negative. The P of every other word must not be negative, as
/// when any other motion mode is in force.
#[test]
fn only_the_p_of_a_spline_is_negative() {
    let program = ready("G5 X10 Y0 I3 J3 P-3 Q3");
    for line in [
        "G4 P-1",
        "M64 P-1",
        "M66 P-1",
        "M66 P-1 L3 Q1",
        "M56 P-1",
        "M50 P-1",
        "G64 P-1",
        "G10 L1 P-3 Z1.5",
        "G10 L11 P-4 Z2",
        "G10 L2 P-1 X1",
        "G51 P-2",
        "G51 X0 P-2",
        "P-1",
        "M64 P-3 X20 Q3",
        "M62 G5 X20 I1 J1 P-3 Q3",
    ] {
        assert_eq!(program.error(line), 4, "{line}");
    }
    for line in ["X20 P-3 Q3", "M8 X20 P-3 Q3", "M67 E1 X20 P-3 Q3", "G92.1 X20 P-3 Q3"] {
        assert_eq!(program.error(line), 0, "{line}");
    }
    // The P belongs to G4 or G64, so the spline has no P.
    assert_eq!(["G4 P-1 X20 Q3", "G64 P-1 X20 Q3"].map(|line| program.error(line)), [28, 28]);
}

#[test]
fn grbl_knows_none() {
    let mut program = Program::new(Dialect::Grbl);
    program.run("G17 F300");
    for line in ["G5 X1 I1 J1", "G5.1 X1 I1 J1", "G5"] {
        assert_eq!(program.error(line), 20, "{line}");
    }
    assert_eq!(program.error("G1 X1 P-1"), 4);
}

/// Rounding does not accumulate over very many curves with G91.
#[test]
fn curves_do_not_drift() {
    let mut program = ready("G68 X0 Y0 R33.3\nG91\nG5 X0.001 Y.0003 I1 J1 P0 Q0");
    for _ in 1..10_000 {
        program.run("X0.001 Y.0003 P-.1 Q.05");
    }
    assert_eq!(in_mm(&program.interpreter.to_program(program.interpreter.position()))[..2], [10.0, 3.0]);
}

/// Returns the control points in X and Y of the machine, mm, with their weights.
fn control_points(program: &Program) -> Vec<(f64, f64, f32)> {
    let mm = |part: oxmill_controller::units::Coordinate| part.0 as f64 / DECIMAL_ONE as f64;
    let points = program.interpreter.control_points();
    points.iter().map(|point| (mm(point.place[0]), mm(point.place[1]), point.weight)).collect()
}

#[test]
fn control_points_of_a_curve() {
    let mut program = ready("G0 X1 Y1 Z5\nG5.2 P2 L4\nX2 Y2 P1\nX4 Y0 P.5\nF60 M8\nG5.2 X6 Y6 P3");
    assert_eq!(control_points(&program), [(1.0, 1.0, 2.0), (2.0, 2.0, 1.0), (4.0, 0.0, 0.5), (6.0, 6.0, 3.0)]);
    assert_eq!((program.machine(), program.interpreter.modal().motion.word()), ([1.0, 1.0, 5.0], "G5.2"));
    let MotionCommand::Nurbs(nurbs) = program.run("N7 G5.3").motion else { panic!() };
    assert_eq!((nurbs.order, nurbs.feed), (4, Feed::PerMinute(1.0)));
    assert_eq!((in_mm(&nurbs.start), program.machine()), ([1.0, 1.0, 5.0], [6.0, 6.0, 5.0]));
    assert_eq!(program.interpreter.modal().motion.word(), "G80");
    // The next curve starts with new control points and a new order. Its first G5.2 has X and Y, so P is the weight of
    // that point, and the start has weight 1.
    program.run_all("G5.2 X7 Y7 P2\nX8 Y7 P1\nG5.3");
    assert_eq!(control_points(&program), [(6.0, 6.0, 1.0), (7.0, 7.0, 2.0), (8.0, 7.0, 1.0)]);
    // With G91, each point counts from the tool, which stays at the start of the curve until G5.3.
    program.run_all("G91 G5.2 X1 Y0 P1\nX1 Y1 P1\nL3 X0 Y2 P1");
    assert_eq!(control_points(&program)[1..], [(9.0, 7.0, 1.0), (9.0, 8.0, 1.0), (8.0, 9.0, 1.0)]);
    let MotionCommand::Nurbs(nurbs) = program.run("G93 F2 G5.3").motion else { panic!() };
    assert_eq!(nurbs.feed, Feed::InverseTime(30.0));
    // Offsets, rotation and units act on control points, too.
    let mut program = ready("G10 L2 P1 X10 R90\nG0 X0 Y0\nG20\nG5.2 X1 Y0 P1\nG21 X0 Y5 P1\nG5.3");
    assert_eq!(control_points(&program), [(10.0, 0.0, 1.0), (10.0, 25.4, 1.0), (5.0, 0.0, 1.0)]);
    assert_eq!(program.run("G1 X0 Y5").motion, program.run("G1 X0 Y5").motion);
    assert_eq!(program.work(), [-5.0, 0.0, 0.0]);
}

#[test]
fn control_points_that_are_refused() {
    let begun = "G5.2 X1 Y1 P1\nX2 Y0 P1";
    let mut wrong = Vec::new();
    for (setup, line, error) in [
        ("", "G5.3", 145),
        ("", "G5.2 X1 Y1", 28),
        ("", "G5.2 X1 P1", 28),
        ("", "G5.2 X1 Y1 P0", 39),
        ("", "G5.2 X1 Y1 P-1", 4),
        ("", "G5.2 X1 Y1 P1 L2", 39),
        ("", "G5.2 X1 Y1 P1 L9", 39),
        ("", "G5.2 X1 Y1 P1 L3.5", 23),
        ("", "G5.2 X1 Y1 Z1 P1", 140),
        ("G18", "G5.2 X1 Y1 P1", 140),
        ("", "G5.2 X1 Y1 P1 I1", 36),
        ("", "G5.2 X1 Y1 P1 G5.3", 21),
        ("F0", "G5.2 X1 Y1 P1", 22),
        ("G93 G5.2 X1 Y1 P1 F1\nX2 Y0 P1 F1", "G5.3", 22),
        ("G5.2 X1 Y1 P1", "G5.3", 147),
        ("G5.2 X1 Y1 P1 L8\nX2 Y0 P1", "G5.3", 147),
        (begun, "G5.3", 0),
        (begun, "X3 Y1", 28),
        (begun, "G5.3 X3 Y1", 31),
        (begun, "G1 X5", 146),
        (begun, "G1", 146),
        (begun, "G2 I1", 146),
        (begun, "G5 X1 I1 J1 P1 Q1", 146),
        (begun, "G38.2 Z-1", 146),
        (begun, "G80", 0),
        ("G5.2 X1 Y1 P1\nX2 Y0 P1\nG80", "G5.3", 145),
        ("G5.2 X1 Y1 P1\nX2 Y0 P1\nG28", "G5.3", 0),
        ("G28.1\nG0 X9\nG5.2 X1 Y1 P1\nX2 Y0 P1\nG28", "G5.3", 145),
        ("G28.1\nG0 X9\nG5.2 X1 Y1 P1\nX2 Y0 P1\nG28", "X3 Y0 P1", 145),
        ("G5.2 X1 Y1 P1\nX2 Y0 P1\nM2", "G5.3", 145),
        ("G5.2 X1 Y1 P1\nX2 Y0 P1\nG5.3", "X3 Y0", 31),
    ] {
        let found = ready(setup).error(line);
        if found != error {
            wrong.push((setup, line, found));
        }
    }
    assert!(wrong.is_empty(), "{wrong:?}");
    let mut program = ready("G5.2 P1");
    for _ in 1..32 {
        program.run("X1 Y1 P1");
    }
    assert_eq!((program.error("X1 Y1 P1"), program.error("G5.3")), (148, 0));
    let mut program = ready(begun);
    program.interpreter.reset();
    assert_eq!(program.error("F1 G5.3"), 145);
    let mut program = ready(begun);
    program.interpreter.change_dialect();
    assert_eq!((program.error("F1 G5.3"), program.interpreter.modal().motion.word()), (145, "G80"));
}
