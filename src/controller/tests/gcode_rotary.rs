//! Tests of a rotary fourth axis: its words, its offsets, and the meaning of F (RS274NGC, 2.1.2.5 and 2.1.2.6).

use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect, Feed, Interpreter, MotionCommand};
use oxmill_controller::units::Coordinate;

struct Program(Interpreter<4>);

fn value(coordinate: Coordinate) -> f64 {
    coordinate.0 as f64 / 1e7
}

impl Program {
    fn new(lines: &str) -> Program {
        let mut program = Program(Interpreter::default());
        for line in lines.lines() {
            program.run(line);
        }
        program
    }

    fn check(&self, line: &str) -> Result<Action<4>, Error> {
        self.0.check(line.replace(' ', "").as_bytes(), Dialect::Oxmill)
    }

    fn run(&mut self, line: &str) -> Action<4> {
        let checked = self.check(line).unwrap_or_else(|error| panic!("{line}: {error:?}"));
        self.0.commit(&checked);
        checked
    }

    fn machine(&self) -> [f64; 4] {
        self.0.position().0.map(value)
    }

    /// Runs a line and returns its speed along the path of X, Y, Z and A together, in units (mm or degrees) per
    /// minute.
    fn speed(&mut self, line: &str) -> f32 {
        match self.run(line).motion {
            MotionCommand::Line { feed: Feed::PerMinute(feed), .. }
            | MotionCommand::Probe { feed: Feed::PerMinute(feed), .. } => feed * 60.0,
            other => panic!("{line}: {other:?}"),
        }
    }
}

#[track_caller]
fn near(found: f32, expected: f32) {
    assert!((found - expected).abs() < 1.0e-4 * expected, "{found}, not {expected}");
}

#[test]
fn f_is_along_the_way_of_x_y_and_z() {
    let mut program = Program::new("G21 G91 F600");
    near(program.speed("G1 X30 Y-40"), 600.0);
    // X and Y move 50 mm, which takes 5 s. Meanwhile A turns 120 degrees, so the path of all axes is 130 units in 5 s.
    near(program.speed("X30 Y40 A120"), 600.0 * 130.0 / 50.0);
    near(program.speed("Z-5 A-12"), 600.0 * 13.0 / 5.0);
    // F is the speed of X even if X moves very little.
    near(program.speed("X0.001 A90"), 600.0 * 90_000.0);
    near(program.speed("G38.3 X3 A4"), 600.0 * 5.0 / 3.0);
}

#[test]
fn f_of_a_move_that_only_turns_is_degrees_per_minute_as_written() {
    let mut program = Program::new("G21 G91");
    near(program.speed("G1 A90 F720"), 720.0);
    near(program.speed("G20 X0 A-90"), 720.0);
    near(program.speed("A10 F100"), 100.0);
    near(program.speed("X1"), 2540.0);
    near(program.speed("G21 A10"), 100.0);
    near(program.speed("X1"), 2540.0);
    near(program.speed("A5 F50"), 50.0);
    // X moves one inch (25.4 mm) at 10 inches per minute. A turns 25.4 degrees in the same time, so the path is longer
    // by the square root of 2.
    near(program.speed("G20 X1 A25.4 F10"), 254.0 * core::f32::consts::SQRT_2);
}

/// With G95, F is in degrees per revolution of the spindle if only A moves.
#[cfg(feature = "full")]
#[test]
fn f_per_revolution_turns_it() {
    let mut program = Program::new("G21 G90 G95 S100");
    near(program.speed("G1 X10 F0.5"), 50.0);
    near(program.speed("A90 F2"), 200.0);
    near(program.speed("G20 A0 F2"), 200.0);
    near(program.speed("G21 X20 A10 F0.5"), 50.0 * core::f32::consts::SQRT_2);
}

#[test]
fn inverse_time_is_for_all_axes() {
    let mut program = Program::new("G21 G91 G93");
    for line in ["G1 A90 F2", "X1 A90 F2", "X1 F2"] {
        let MotionCommand::Line { feed, .. } = program.run(line).motion else { panic!("{line}") };
        assert_eq!(feed, Feed::InverseTime(30.0), "{line}");
    }
    assert_eq!(program.check("A1"), Err(Error::UndefinedFeed));
}

#[test]
fn degrees_have_no_unit_and_all_the_offsets() {
    let mut program = Program::new("G20 G90 G0 X1 A90");
    assert_eq!(program.machine(), [25.4, 0.0, 0.0, 90.0]);
    program.run("G21 G10 L2 P1 A10");
    program.run("G0 A5");
    assert_eq!(program.machine()[3], 15.0);
    program.run("G91 A720.5");
    assert_eq!(program.machine()[3], 735.5, "it may turn on and on");
    program.run("G90 G92 A0");
    program.run("A1");
    assert_eq!(program.machine()[3], 736.5);
    program.run("G92.1");
    program.run("G53 G0 A3");
    assert_eq!(program.machine()[3], 3.0);
    program.run("G10 L20 P1 A0");
    program.run("A1");
    assert_eq!(program.machine()[3], 4.0);
    program.run("G43.1 A2");
    program.run("A1");
    assert_eq!(program.machine()[3], 6.0);
    program.run("G49 G28.1");
    program.run("X0 A100");
    program.run("G28 A50");
    assert_eq!(program.machine(), [0.0, 0.0, 0.0, 6.0]);
}

#[test]
fn an_arc_carries_it_along() {
    let mut program = Program::new("G21 G90 F600");
    let MotionCommand::Arc(arc) = program.run("G2 X10 I5 A180").motion else { panic!("an arc") };
    assert_eq!((value(arc.start.0[3]), value(arc.target.0[3])), (0.0, 180.0));
    assert_eq!(arc.feed, Feed::PerMinute(10.0), "along X, Y and Z");
    assert_eq!(program.check("G2 A90"), Err(Error::NoPlaneAxisForArc));
}

#[test]
fn canned_cycles_and_rotations_leave_it_alone() {
    let mut program = Program::new("G21 G90 F600 G0 A30");
    assert_eq!(program.check("G81 X1 Z-1 R1 A5"), Err(Error::AxisWordsUnused));
    program.run("G81 X1 Z-1 R1");
    assert_eq!(program.machine()[3], 30.0);
    program.run("G80");
    if cfg!(feature = "full") {
        assert_eq!(program.check("G68 X0 Y0 A1 R90"), Err(Error::AxisWordsUnused));
        program.run("G68 X0 Y0 R90");
        program.run("G0 X10 A40");
        let [x, y, _, a] = program.machine();
        assert!((x - 1.0).abs() < 1e-6 && (y - 10.0).abs() < 1e-6 && a == 40.0, "{x} {y} {a}");
    }
}

/// G28 does not move an axis that is no longer in use, even if its position was stored while the axis was in use.
#[test]
fn an_axis_that_is_not_in_use_is_unknown_and_stays() {
    let mut program = Program::new("G21 G90\nG0 A90\nG28.1\nG0 A10");
    program.0.set_axes(3);
    for line in ["A1", "G0 X1 A1", "G92 A0", "G10 L2 P1 A1", "B1"] {
        assert_eq!(program.check(line), Err(Error::UnsupportedCommand), "{line}");
    }
    program.run("X5");
    program.run("G28");
    assert_eq!(program.machine(), [0.0, 0.0, 0.0, 10.0]);
    program.0.set_axes(4);
    for line in ["B1", "G1 X1 C2 F100"] {
        assert_eq!(program.check(line), Err(Error::OneRotaryAxis), "{line}");
    }
    program.run("G28");
    assert_eq!(program.machine(), [0.0, 0.0, 0.0, 90.0]);
}
