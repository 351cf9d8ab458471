//! Tests of scaled coordinates: G51 scales and mirrors, and G50 ends that.

#![cfg(feature = "full")]

use crate::program::{Program, in_mm, play, ready, target, via};
use oxmill_controller::gcode::{CycleStep, Dialect, Feed, MotionCommand};
use oxmill_controller::units::{Coordinate, DECIMAL_ONE};

#[test]
fn about_a_centre() {
    let program = play(
        "G10 L2 P1 X100\nG0 X5 Y5 Z5",
        &[
            ("G51 X10 Y20 Z0 P2", [105.0, 5.0, 5.0]),
            ("G0 X10 Y20", [110.0, 20.0, 5.0]),
            ("G1 X15 Y10 Z-1", [120.0, 0.0, -2.0]),
            ("G91 X1 Z-.5", [122.0, 0.0, -3.0]),
            ("G90 Y20", [122.0, 20.0, -3.0]),
            ("G55 X10", [10.0, 20.0, -3.0]),
            ("G54 G53 X1 Y1", [1.0, 1.0, -3.0]),
            ("G51 X0 Y0 Z0 I.5 K3", [1.0, 1.0, -3.0]),
            ("X10 Y10 Z10", [105.0, 10.0, 30.0]),
            ("G50", [105.0, 10.0, 30.0]),
            ("X10", [110.0, 10.0, 30.0]),
        ],
    );
    assert!(program.interpreter.scaling().is_none());
    assert_eq!(program.written(), [10.0, 10.0, 30.0]);
}

/// If G51 does not name an axis, the centre of the scaling in that axis is at the tool.
#[test]
fn about_the_tool() {
    let program = play(
        "G92 X-1\nG0 X4 Y2",
        &[
            ("G51 P3", [5.0, 2.0, 0.0]),
            ("X5 Y2", [8.0, 2.0, 0.0]),
            ("G51 Y0 I2 J2", [8.0, 2.0, 0.0]),
            // The centre of X is 7 in the program: the unscaled position of the tool.
            ("X8 Y3", [10.0, 6.0, 0.0]),
            ("G50 X0 Y0", [1.0, 0.0, 0.0]),
        ],
    );
    assert_eq!(program.written(), [0.0, 0.0, 0.0]);
}

#[test]
fn mirrored() {
    play(
        "G51 X10 Y0 I-1",
        &[("G0 X12 Y3", [8.0, 3.0, 0.0]), ("G91 X1", [7.0, 3.0, 0.0]), ("G90 X10", [10.0, 3.0, 0.0])],
    );
    let mut program = ready("G51 X0 Y0 I-2 J2\nG0 X1 Y0");
    let MotionCommand::Arc(arc) = program.run("G2 X2 Y1 I1 J0").motion else { panic!() };
    let way = |c: Coordinate| c.0 as f64 / DECIMAL_ONE as f64;
    assert_eq!((arc.clockwise, way(arc.i), way(arc.j), in_mm(&arc.target)), (false, -2.0, 0.0, [-4.0, 2.0, 0.0]));
    let mut program = ready("G51 X0 Y0 I-2 J-2\nG0 X1 Y0");
    let MotionCommand::Arc(arc) = program.run("G3 X2 Y1 I1 J0").motion else { panic!() };
    assert_eq!((arc.clockwise, way(arc.i), in_mm(&arc.target)), (false, -2.0, [-4.0, -2.0, 0.0]));
}

#[test]
fn arcs() {
    let way = |c: Coordinate| c.0 as f64 / DECIMAL_ONE as f64;
    for line in ["G2 X2 Y0 I1 J0", "G2 X2 Y0 R1", "G90.1 G2 X2 Y0 I1 J0", "G91 G2 X2 I1", "G2 X2 Y0 I1 Z3"] {
        let mut program = ready("G10 L2 P1 X5\nG51 X1 Y0 Z0 P2.5\nG0 X0 Y0");
        let MotionCommand::Arc(arc) = program.run(line).motion else { panic!("{line}") };
        assert_eq!((way(arc.i), way(arc.j), arc.clockwise), (2.5, 0.0, true), "{line}");
        assert_eq!(in_mm(&arc.target)[..2], [8.5, 0.0], "{line}");
    }
    // A full circle stays full. The distance of a rounded end point from the circle is checked in unscaled
    // coordinates.
    let mut program = ready("G51 X0 Y0 P20\nG0 X1.234 Y0");
    let MotionCommand::Arc(arc) = program.run("G3 I-1.234").motion else { panic!() };
    assert_eq!(arc.start, arc.target);
    assert_eq!([program.error("G3 X0.873 Y0.873 I-1.234 J0"), program.error("G3 X0.8 Y0.9 I-1.234 J0")], [0, 33]);
    // In a plane with two different factors an arc would become an ellipse, so it is refused there.
    let mut program = ready("G51 X0 Y0 Z0 I2 J3 K2\nG0 X1 Y1");
    for (line, error) in
        [("G2 X2 I1", 142), ("G2 I1", 142), ("G2 X5 Y5 R9", 142), ("G19 G2 Y5 Z5 R9", 142), ("G18 G2 X2 Z0 I.5", 0)]
    {
        assert_eq!(program.error(line), error, "{line}");
    }
    let MotionCommand::Arc(arc) = program.run("G18 G2 X2 Z0 I.5 Y2").motion else { panic!() };
    assert_eq!((way(arc.i), way(arc.j), in_mm(&arc.target)), (0.0, 1.0, [4.0, 6.0, 0.0]));
}

#[cfg(feature = "full")]
#[test]
fn splines() {
    let mut program = ready("G51 X0 Y0 I2 J-3\nG0 X1 Y1");
    let MotionCommand::Spline(spline) = program.run("G5 X2 Y1 I1 J1 P-.5 Q1").motion else { panic!() };
    let corners = spline.corners().map(|corner| in_mm(&corner));
    assert_eq!(corners, [[2.0, -3.0, 0.0], [4.0, -6.0, 0.0], [3.0, -6.0, 0.0], [4.0, -3.0, 0.0]]);
}

/// Runs a cycle, and returns the machine coordinate Z (mm) at the end of each of its moves.
fn heights(program: &mut Program, line: &str) -> Vec<f64> {
    let MotionCommand::Cycle(mut cycle) = program.run(line).motion else { panic!("{line}") };
    let mut heights = Vec::new();
    while let Some(step) = cycle.step(Coordinate::mm(1)) {
        if let CycleStep::Rapid(place) | CycleStep::Feed(place, _) = step {
            heights.push(in_mm(&place)[2]);
        }
    }
    heights
}

/// R, Z and Q of a cycle are scaled with the factor of the depth axis. P (the dwell) and the clearance of a peck are
/// not scaled.
#[test]
fn cycles() {
    let mut program = ready("G0 Z20\nG51 X0 Y0 Z0 P2");
    assert_eq!(heights(&mut program, "G99 G83 X1 Y1 Z-2 R1 Q2"), [20.0, 20.0, 2.0, -2.0, 2.0, -1.0, -4.0, 2.0]);
    assert_eq!(program.machine(), [2.0, 2.0, 2.0]);
    // R, Z and Q stay in force as they were written. The new factor scales the written numbers.
    program.run("G51 Z0 K3");
    assert_eq!(heights(&mut program, "X5"), [3.0, 3.0, 3.0, -3.0, 3.0, -2.0, -6.0, 3.0]);
    let mut program = ready("G0 Z20\nG51 P2 X0 Y0 Z0\nG91");
    assert_eq!(heights(&mut program, "G99 G81 X1 Z-3 R-4 L2"), [20.0, 20.0, 12.0, 6.0, 12.0, 12.0, 12.0, 6.0, 12.0]);
    assert_eq!(program.machine(), [4.0, 0.0, 12.0]);
}

#[test]
fn places_of_the_machine_are_not_scaled() {
    let mut program = ready("G0 X10 Y10 Z10\nG28.1\nG51 X0 Y0 Z0 P2");
    program.run_all("G0 X1 Y1 Z1");
    let return_move = program.run("G28 Z3");
    assert_eq!((via(&return_move), target(&return_move)), (Some([2.0, 2.0, 6.0]), [2.0, 2.0, 10.0]));
    assert_eq!(target(&program.run("G53 G0 X7")), [7.0, 2.0, 10.0]);
    assert_eq!(target(&program.run("G28")), [10.0; 3]);
    // The tool offset is not scaled either.
    program.run("G43.1 Z5");
    assert_eq!(target(&program.run("G0 Z1")), [10.0, 10.0, 7.0]);
}

/// In a jog with G91, distances are not scaled. In a jog with G90, coordinates are those of the scaled program.
#[test]
fn jogs() {
    let program = ready("G51 X0 Y0 P2\nG0 X1 Y1");
    let jog = |line: &[u8]| target(&program.interpreter.check_jog(line, Dialect::Oxmill).unwrap());
    assert_eq!(jog(b"G91X1F100"), [3.0, 2.0, 0.0]);
    assert_eq!(jog(b"G90X3F100"), [6.0, 2.0, 0.0]);
    assert_eq!(jog(b"G53X3F100"), [3.0, 2.0, 0.0]);
    let error =
        |line: &[u8]| program.interpreter.check_jog(line, Dialect::Oxmill).map(|_| ()).map_err(|error| error.code());
    assert_eq!((error(b"G51X1P2F100"), error(b"G50X1F100")), (Err(16), Err(16)));
}

#[test]
fn feed_probe_and_digit() {
    let mut program = ready("G51 X0 Y0 P2");
    let checked = program.run("G1 X1.25");
    assert!(matches!(checked.motion, MotionCommand::Line { feed: Feed::PerMinute(5.0), .. }));
    assert!((checked.digit - 0.02).abs() < 1e-6);
    let MotionCommand::Probe { target, .. } = program.run("G38.2 X5").motion else { panic!() };
    assert_eq!(in_mm(&target), [10.0, 0.0, 0.0]);
    assert_eq!(program.written(), [5.0, 0.0, 0.0]);
}

/// With a rotation, coordinates are scaled first, then rotated. The centre of G68 is a coordinate of the program, too.
#[test]
fn with_rotations() {
    play(
        "G10 L2 P1 R90",
        &[
            ("G51 X1 Y0 P2", [0.0; 3]),
            ("G0 X2 Y1", [-2.0, 3.0, 0.0]),
            ("G91 X1", [-2.0, 5.0, 0.0]),
            ("G90 Y0", [0.0, 5.0, 0.0]),
        ],
    );
    play(
        "",
        &[
            ("G51 X0 Y0 I2 J1", [0.0; 3]),
            ("G68 X5 Y0 R90", [0.0; 3]),
            ("G0 X5 Y0", [10.0, 0.0, 0.0]),
            ("X6 Y1", [9.0, 2.0, 0.0]),
            ("G50", [9.0, 2.0, 0.0]),
            ("X12 Y0", [10.0, 2.0, 0.0]),
            ("G51 X10 Y0 P3", [10.0, 2.0, 0.0]),
            ("X11", [10.0, 3.0, 0.0]),
            ("G69 G50 X0", [0.0, 3.0, 0.0]),
        ],
    );
}

#[test]
fn what_ends_it() {
    type End = (&'static str, fn(&mut Program));
    let ends: [End; 5] = [
        ("G50", |program| _ = program.run("G50")),
        ("M2", |program| _ = program.run("M2")),
        ("M30", |program| _ = program.run("M30")),
        ("reset", |program| program.interpreter.reset()),
        ("dialect", |program| program.interpreter.change_dialect()),
    ];
    for (name, end) in ends {
        let mut program = ready("G51 X0 Y0 P2\nG0 X1");
        assert!(program.interpreter.scaling().is_some());
        end(&mut program);
        assert!(program.interpreter.scaling().is_none(), "{name}");
        program.run("G90 G0 X5");
        assert_eq!(program.machine()[0], 5.0, "{name}");
    }
    for line in ["G51 X3 P1", "G51 I1 J1 K1"] {
        let mut program = ready("G51 X0 P2");
        program.run(line);
        assert!(program.interpreter.scaling().is_none(), "{line}");
    }
}

#[test]
fn what_is_refused() {
    let mut program = ready("");
    for (line, error) in [
        ("G51", 28),
        ("G51 X1 Y1", 28),
        ("G51 X1 P0", 39),
        // Fanuc writes factors in thousandths: 1000 means 1. Here factors above 100 are refused.
        ("G51 X0 Y0 I1000 J-1000", 151),
        ("G51 X0 Y0 P1000", 151),
        ("G51 P100.001", 151),
        ("G51 J-100.001", 151),
        ("G51 K2000", 151),
        ("G51 X1 P-2", 4),
        ("G51 X1 I0", 39),
        ("G51 X1 K-1", 39),
        ("G51 X1 P2 I2", 36),
        ("G51 X1 P2 R2", 36),
        ("G51 G0 X1 P2", 24),
        ("G51 G50 P2", 21),
        ("G51.1 X1 P2", 121),
        ("G4 P1 G51 X1", 28),
        ("G51 X1 I-2 J-1", 0),
    ] {
        assert_eq!(program.error(line), error, "{line}");
    }
    program.run("G51 X0 I2");
    for (line, error) in [
        ("G92 X0", 143),
        ("G92 Y0", 0),
        ("G10 L20 P1 X0", 143),
        ("G10 L20 P0 Y0", 0),
        ("G10 L10 P1 X0", 143),
        ("G10 L11 P1 X0", 143),
        ("G10 L1 P1 X0", 0),
        ("G10 L2 P1 X0", 0),
        ("G52 X1", 0),
        ("G50 G92 X0", 0),
        ("G0 X30000", 33),
    ] {
        assert_eq!(program.error(line), error, "{line}");
    }
    let mut program = ready("G51 X0 P.0000001 Z0\nG0 X10");
    assert_eq!(program.error("G83 X1 Z-1 R1 Q.1"), 39);
    program.run("G50");
    let grbl = Program::new(Dialect::Grbl);
    assert_eq!(["G51 X1 P2", "G50"].map(|line| grbl.error(line)), [20; 2]);
}

/// The rounding of 200,000 increments does not accumulate, rotated or not.
#[test]
fn increments_do_not_drift() {
    for setup in ["", "G10 L2 P1 X1.2345678 Y-3 R33.3\nG0 X0 Y0"] {
        let mut program = ready(setup);
        program.run_all("G51 X0 Y0 I.3333333 J.7777777\nG0 X0 Y0\nG91");
        for _ in 0..100_000 {
            program.run("G1 X0.0001 Y-.0003");
        }
        let reached = program.machine();
        assert_eq!(program.written(), [10.0, -30.0, 0.0], "{setup}");
        program.run("G90 G0 X1 Y1");
        program.run("X10 Y-30");
        let again = program.machine();
        assert!(reached.iter().zip(again).all(|(a, b)| (a - b).abs() < 1.5e-7), "{reached:?} {again:?}");
    }
}
