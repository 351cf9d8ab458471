//! Tests of rotated coordinates. G10 L2 R rotates a coordinate system. G68 rotates the coordinates of the program, and
//! G69 ends G68.

#![cfg(feature = "full")]

use crate::program::{Program, in_mm, play, ready};
use oxmill_controller::gcode::{Angle, CoordinateSystem, Dialect, MotionCommand};
use oxmill_controller::units::{DECIMAL_ONE, Decimal};

/// Half of the square root of 3.
const H: f64 = 0.866_025_403_784_438_6;

/// A system is rotated about its origin. An axis that is not named keeps its coordinate in the program.
#[test]
fn a_rotated_system() {
    let program = play(
        "G10 L2 P1 X10 Y5 R30",
        &[
            ("G0 X10 Y0", [10.0 + 10.0 * H, 10.0, 0.0]),
            ("G1 Y10 Z1", [5.0 + 10.0 * H, 10.0 + 10.0 * H, 1.0]),
            ("G91 X-10", [5.0, 5.0 + 10.0 * H, 1.0]),
            ("G90 G53 X1 Y1", [1.0, 1.0, 1.0]),
            ("Z3", [1.0, 1.0, 3.0]),
            ("G55 X1 Y2", [1.0, 2.0, 3.0]),
            ("G54 X10 Y0", [10.0 + 10.0 * H, 10.0, 3.0]),
            ("G10 L2 P1 R0", [10.0 + 10.0 * H, 10.0, 3.0]),
            ("X10 Y0", [20.0, 5.0, 3.0]),
            ("G10 L2 P0 X0 Y0 R-90", [20.0, 5.0, 3.0]),
            ("X10 Y1", [1.0, -10.0, 3.0]),
        ],
    );
    assert_eq!(program.written(), [10.0, 1.0, 3.0]);
    let angle = program.interpreter.offsets().angle(CoordinateSystem::G54);
    assert_eq!(angle.degrees(), Decimal::from_int(-90));
}

/// The offset of G92 is along the axes of the rotated system. The tool offset and the origin of the system are along
/// the axes of the machine.
#[test]
fn offsets_of_a_rotated_system() {
    let program = play(
        "G10 L2 P1 X10 Y5 R90",
        &[
            ("G92 X10 Y-5", [0.0, 0.0, 0.0]),
            ("G0 X20 Y-5", [0.0, 10.0, 0.0]),
            ("G43.1 X1 Z2", [0.0, 10.0, 0.0]),
            ("G0 X20 Y-5 Z0", [1.0, 10.0, 2.0]),
            ("G92.1", [1.0, 10.0, 2.0]),
            ("G49 X0 Y0", [10.0, 5.0, 2.0]),
            ("G10 L20 P1 X1", [10.0, 5.0, 2.0]),
            ("X0", [10.0, 4.0, 2.0]),
        ],
    );
    assert_eq!(in_mm(&program.interpreter.offsets().system(CoordinateSystem::G54)), [10.0, 4.0, 0.0]);
    // The work zero in reports is a position in machine coordinates.
    let zero = |program: &Program| in_mm(&program.interpreter.work_zero(Dialect::Oxmill));
    assert_eq!(zero(&program), [10.0, 4.0, 0.0]);
    let mut program = program;
    program.run("G52 X3");
    assert_eq!(zero(&program), [10.0, 7.0, 0.0]);
    assert_eq!(in_mm(&program.interpreter.work_zero(Dialect::Grbl)), [13.0, 4.0, 0.0]);
}

/// The rounding of 200,000 increments does not accumulate.
#[test]
fn increments_do_not_drift() {
    let mut program = ready("G10 L2 P1 X1.2345678 Y-3 R33.3\nG0 X0 Y0\nG91");
    for _ in 0..100_000 {
        program.run("G1 X0.001 Y-.0003");
    }
    let reached = program.machine();
    assert_eq!(program.written(), [100.0, -30.0, 0.0]);
    program.run("G90 G0 X1");
    program.run("X100 Y-30");
    assert_eq!(program.machine(), reached);
}

#[test]
fn arcs() {
    let mut program = ready("G10 L2 P1 X10 R30\nG0 X10 Y0");
    for line in ["G2 I5", "G2 X10 Y0 I5", "G3 X10 I0 J7 P2", "G90.1 G3 I3 J4", "G91.1 G91 G2 I5", "G91 G2 X0 I5"] {
        let start = program.machine();
        match program.run(line).motion {
            MotionCommand::Arc(arc) => assert_eq!((arc.start, in_mm(&arc.target)), (arc.target, start), "{line}"),
            motion => panic!("{line}: {motion:?}"),
        }
    }
    let MotionCommand::Arc(arc) = program.run("G90 G2 X15 Y5 I5").motion else { panic!("no arc") };
    let centre = [arc.i, arc.j].map(|way| way.0 as f64 / DECIMAL_ONE as f64);
    assert!((centre[0] - 5.0 * H).abs() < 1e-6 && (centre[1] - 2.5).abs() < 1e-6, "{centre:?}");
    for line in ["G18 G2 X20 Z5 R10", "G19 G2 Y20 Z5 R10", "G18 G81 X1 Z1 Y-1 R1"] {
        assert_eq!(program.error(line), 126, "{line}");
    }
    // A full circle ends exactly at its start, even if that position has no exact coordinates in the program.
    program.run("G53 G0 X1.2345679 Y7");
    let MotionCommand::Arc(arc) = program.run("G3 I1").motion else { panic!("no arc") };
    assert_eq!(arc.start, arc.target);
}

#[test]
fn cycles_and_places() {
    let mut program = play(
        "G10 L2 P1 R90\nG0 X1 Y0 Z5\nG28.1",
        &[
            ("G81 X3 Y4 Z-1 R2", [-4.0, 3.0, 5.0]),
            ("G91 X1 L3", [-4.0, 6.0, 7.0]),
            ("G80", [-4.0, 6.0, 7.0]),
            ("G90 G28 X0 Y0", [0.0, 1.0, 7.0]),
            ("G1 X7 Y7", [-7.0, 7.0, 7.0]),
            // G28 X names the X axis of the program. The program is rotated by 90 degrees, so the machine moves along
            // Y.
            ("G28 X7", [-7.0, 1.0, 7.0]),
        ],
    );
    program.run("G38.3 X9 F100");
    assert_eq!(program.machine(), [-7.0, 9.0, 7.0]);
}

/// G68 rotates about a point. It rotates the coordinates of the program, but not the coordinates in reports.
#[test]
fn a_rotated_program() {
    let mut program = play(
        "G10 L2 P1 X100",
        &[
            ("G68 X10 Y10 R90", [0.0, 0.0, 0.0]),
            ("G0 X20 Y10", [110.0, 20.0, 0.0]),
            ("G91 Y1", [109.0, 20.0, 0.0]),
            // X0 of the centre is absolute, even with G91. Y is not named, so in Y the centre is at the tool.
            ("G68 X0 R180", [109.0, 20.0, 0.0]),
            ("G90 X1 Y21", [99.0, 19.0, 0.0]),
            ("G69 X1 Y1", [101.0, 1.0, 0.0]),
            ("G68 X0 Y0 R90", [101.0, 1.0, 0.0]),
            ("G53 X3 Y4", [3.0, 4.0, 0.0]),
            ("G55 X3", [3.0, 3.0, 0.0]),
            ("G54 X3 Y0", [100.0, 3.0, 0.0]),
            // G68 and a rotated system act together.
            ("G10 L2 P1 R-90", [100.0, 3.0, 0.0]),
            ("X3 Y4", [103.0, 4.0, 0.0]),
        ],
    );
    assert!(program.interpreter.rotation().is_some());
    assert_eq!(in_mm(&program.interpreter.work_zero(Dialect::Oxmill)), [100.0, 0.0, 0.0]);
    for line in ["G92 X0", "G10 L20 P1 Y0", "G10 L20 P2 X1"] {
        assert_eq!(program.error(line), 127, "{line}");
    }
    for line in ["G92 Z0", "G10 L20 P1 Z0", "G52 X1", "G69 G92 X0", "G10 L2 P2 X1"] {
        assert_eq!(program.error(line), 0, "{line}");
    }
    program.run("M2");
    assert!(program.interpreter.rotation().is_none());
    program.run("G68 R1");
    program.interpreter.reset();
    assert!(program.interpreter.rotation().is_none());
    // The angle of the system is kept.
    assert_eq!(program.interpreter.offsets().angle(CoordinateSystem::G54), Angle(-90 * DECIMAL_ONE as i32));
}

#[test]
fn other_planes() {
    let mut program = play(
        "",
        &[
            ("G18 G68 X0 Z0 R90", [0.0, 0.0, 0.0]),
            ("G0 X1 Y2 Z3", [3.0, 2.0, -1.0]),
            ("G2 X1 Z5 K1", [5.0, 2.0, -1.0]),
            ("G19 G68 Y2 Z0 R-90", [5.0, 2.0, -1.0]),
            ("G0 Y3 Z7", [5.0, 9.0, -1.0]),
        ],
    );
    for line in ["G17 G2 I1", "G17 G81 X1 Z-1 R1"] {
        assert_eq!(program.error(line), 126, "{line}");
    }
    // A system is rotated in the XY plane, so G68 in another plane cannot be combined with it.
    program.run("G10 L2 P2 R1");
    assert_eq!((program.error("G55 X1"), program.error("G69 G55 X1")), (126, 0));
    program.run("G69 G55");
    assert_eq!((program.error("G18 G68 R1"), program.error("G17 G68 R1")), (126, 0));
    // While G68 rotates in another plane, the active system cannot get an angle, because after that no line could be
    // run.
    program.run("G54 G18 G68 X0 Z0 R10");
    for (line, error) in
        [("G10 L2 P1 R30", 126), ("G10 L2 P0 R30", 126), ("G10 L2 P1 R0", 0), ("G10 L2 P2 R30", 0), ("M5", 0)]
    {
        assert_eq!(program.error(line), error, "{line}");
    }
    // A rotation by a whole turn counts as no rotation.
    program.run("G18 G68 X0 Z0 R360");
    assert_eq!(program.error("G17 G2 I1"), 0);
}

/// A rotation ends when a program is given up, because the next program does not expect it.
#[test]
fn a_program_that_is_given_up_leaves_no_rotation() {
    let mut program = ready("G68 X0 Y0 R90");
    program.interpreter.abandon_program();
    program.run("G0 X1");
    assert_eq!(program.machine(), [1.0, 0.0, 0.0]);
}

#[test]
fn errors() {
    let program = ready("G0 X1");
    for (line, code) in [
        ("G68", 28),
        ("G68 X1 Y1", 28),
        ("G68 X1 Z1 R1", 31),
        ("G68 X1 R1 P1", 36),
        ("G68 G0 X1 R1", 24),
        ("G68 G69 R1", 21),
        ("G68.1 X1 R1", 121),
        ("G10 L20 P1 X1 R1", 36),
        ("G10 L2 R1", 0),
        ("G10 L2 P1", 26),
        ("G10 L2 P1 X50001 R1", 33),
    ] {
        assert_eq!(program.error(line), code, "{line}");
    }
    let jog = |line: &str| program.interpreter.check_jog(line.as_bytes(), Dialect::Oxmill).map(|_| ());
    assert_eq!(jog("G68X1R1F100").map_err(|error| error.code()), Err(16));
}

/// In a jog with G91, distances are along the axes of the machine. In a jog with G90, coordinates are those of the
/// rotated program.
#[test]
fn jogs() {
    let program = ready("G10 L2 P1 X10 R90\nG0 X5 Y0");
    let jog = |line: &str| {
        let jog = program.interpreter.check_jog(line.as_bytes(), Dialect::Oxmill);
        in_mm(jog.expect("a jog").position())
    };
    assert_eq!(program.machine(), [10.0, 5.0, 0.0]);
    assert_eq!(jog("G91X1F100"), [11.0, 5.0, 0.0]);
    assert_eq!(jog("X0Y0F100"), [10.0, 0.0, 0.0]);
    assert_eq!(jog("X7F100"), [10.0, 7.0, 0.0]);
    assert_eq!(jog("G53X7F100"), [7.0, 5.0, 0.0]);
}

/// G92.1, G92.2 and G92.3 change the offset before the motion on the same line, even if the axes are rotated.
#[test]
fn g92_changes_before_a_rotated_motion() {
    play(
        "G10 L2 P1 X10 R90\nG0 X0 Y0\nG92 X4",
        &[
            ("G92.2 G0 X2", [10.0, 2.0, 0.0]),
            ("G92.3 G0 X2", [10.0, -2.0, 0.0]),
            ("G92.3 X4 Y1", [9.0, 0.0, 0.0]),
            ("G92.1 X4 Y1", [9.0, 4.0, 0.0]),
            ("X4 Y2", [8.0, 4.0, 0.0]),
        ],
    );
}

/// Grbl's dialect has no word that ends a rotation, so no rotation is in force in that dialect.
#[test]
fn grbl_has_no_rotation() {
    let mut program = ready("G10 L2 P1 X10 R90\nG68 X0 Y0 R30");
    program.interpreter.change_dialect();
    program.dialect = Dialect::Grbl;
    assert_eq!(["G68 X0 Y0 R1", "G69", "G10 L2 P1 X1 R1"].map(|line| program.error(line)), [20; 3]);
    program.run("G0 X1 Y2");
    assert_eq!(program.machine(), [11.0, 2.0, 0.0]);
    program.run("G92 X0");
    program.run("G10 L20 P1 Y0");
    program.run("G0 X1 Y1");
    assert_eq!(program.machine(), [12.0, 3.0, 0.0]);
    program.dialect = Dialect::Oxmill;
    program.run("G92.1");
    program.run("G0 X1 Y2");
    assert_eq!(program.machine(), [8.0, 3.0, 0.0]);
}

#[cfg(feature = "full")]
#[test]
fn parameters() {
    let program = play(
        "G10 L2 P1 X10 R30\nG10 L2 P3 R400\nG0 X10 Y0",
        &[("G10 L2 P2 X#5420 Y#5230 Z#5270", [10.0 + 10.0 * H, 5.0, 0.0]), ("G55 G0 X0 Y0 Z0", [10.0, 30.0, 40.0])],
    );
    assert_eq!(program.error("#5230=1"), 200);
}
