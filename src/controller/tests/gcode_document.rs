//! Tests the worked examples of the "seed document", a description of G-code with which the project began. Where the
//! document disagrees with Grbl or NIST, a test shows what happens instead.

use crate::program::{DIALECTS, Program, in_mm, target, via};
use oxmill_controller::gcode::{
    Action, CoordinateSystem, Dialect, Feed, Flow, MotionCommand, MotionMode, StoredOffset,
};
use oxmill_controller::messages::SpindleDirection;
use oxmill_controller::units::Duration;

/// Returns a program whose tool is at `place` (axis words such as `X3 Y4`) in machine coordinates.
fn at(dialect: Dialect, place: &str) -> Program {
    let mut program = Program::new(dialect);
    program.run(&format!("G53 G0 {place}"));
    program
}

fn system(program: &Program, system: CoordinateSystem) -> [f64; 3] {
    in_mm(&program.interpreter.offsets().system(system))
}

fn g92(program: &Program) -> [f64; 3] {
    in_mm(&program.interpreter.offsets().g92)
}

fn feed(checked: &Action<3>) -> Feed {
    match checked.motion {
        MotionCommand::Line { feed, .. } | MotionCommand::Probe { feed, .. } => feed,
        MotionCommand::Arc(arc) => arc.feed,
        MotionCommand::Spline(spline) => spline.feed,
        MotionCommand::Nurbs(nurbs) => nurbs.feed,
        MotionCommand::None | MotionCommand::Cycle(_) => panic!("no motion"),
    }
}

#[test]
fn non_modal_commands_1_g53() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G54");
        program.run("N10 G91");
        assert_eq!(target(&program.run("N11 G1 X10 Y20 F100")), [10.0, 20.0, 0.0]);
        assert_eq!(target(&program.run("N12 G53 X0")), [0.0, 20.0, 0.0]);
        assert_eq!(target(&program.run("N13 X30")), [30.0, 20.0, 0.0]);
    }
}

#[test]
fn non_modal_commands_2_dwell() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G90");
        program.run("N2 G54");
        assert_eq!(target(&program.run("N10 G0 X30 Y40")), [30.0, 40.0, 0.0]);
        let dwell = program.run("N20 G4 P2");
        assert_eq!((dwell.dwell, dwell.motion), (Some(Duration::secs(2)), MotionCommand::None));
        let back = program.run("N30 X20 Y50");
        assert_eq!((target(&back), feed(&back), back.dwell), ([20.0, 50.0, 0.0], Feed::Rapid, None));
    }
}

#[test]
fn non_modal_commands_3_g10_l20() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G54 G91");
        program.run("N2 G10 L20 P1 X-10 Y-8");
        assert_eq!(program.work(), [-10.0, -8.0, 0.0]);
        assert_eq!(system(&program, CoordinateSystem::G54), [10.0, 8.0, 0.0]);
        assert_eq!(target(&program.run("N10 G0 X30 Y40")), [30.0, 40.0, 0.0]);
        program.run("N20 G4 P2");
        assert_eq!(target(&program.run("N30 X20 Y50")), [50.0, 90.0, 0.0]);
        assert_eq!(program.work(), [40.0, 82.0, 0.0]);
    }
}

/// In the document, a second G92 takes back the first one. In fact each G92 makes the current position read the new
/// values, and G92.1 takes back G92.
#[test]
fn non_modal_commands_4_g92() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G54 G91");
        program.run("N2 G92 X-10 Y-8");
        assert_eq!(program.work(), [-10.0, -8.0, 0.0]);
        assert_eq!(target(&program.run("N10 G0 X30 Y40")), [30.0, 40.0, 0.0]);
        assert_eq!(program.work(), [20.0, 32.0, 0.0]);
        program.run("N20 G92 X10 Y8");
        assert_eq!(program.work(), [10.0, 8.0, 0.0]);
        assert_eq!(g92(&program), [20.0, 32.0, 0.0]);
        assert!(program.run("G92.1").work_offset_changed);
        assert_eq!(program.work(), [30.0, 40.0, 0.0]);
    }
}

/// Grbl computes the target of the line before it clears the offset; the other dialects compute it afterwards.
#[test]
fn non_modal_commands_4_g92_1_beside_a_move() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("G92 Y4");
        let checked = program.run("G92.1 G0 Y2");
        assert_eq!(target(&checked), [0.0, if dialect == Dialect::Grbl { -2.0 } else { 2.0 }, 0.0]);
        assert!(checked.work_offset_changed);
        assert_eq!(g92(&program), [0.0; 3]);
        assert_eq!(target(&program.run("Y2")), [0.0, 2.0, 0.0]);
    }
}

#[test]
fn absolute_and_incremental() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G54 G91");
        assert_eq!(target(&program.run("N2 G1 X-10 Y-8 F50")), [-10.0, -8.0, 0.0]);
        assert_eq!(target(&program.run("N10 G53 X0 Y0")), [0.0, 0.0, 0.0]);
        assert_eq!(target(&program.run("N20 Z10")), [0.0, 0.0, 10.0]);
        assert_eq!(target(&program.run("N30 X20 Y50")), [20.0, 50.0, 10.0]);
    }
}

#[test]
fn the_house() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("N1 G90");
        program.run("N2 G54");
        let house = [
            ("N10 G1 X20.0 Y20.0 Z0 F10", [20.0, 20.0, 0.0], 10.0),
            ("N11 X20 Y0.0 Z0", [20.0, 0.0, 0.0], 10.0),
            ("N12 X0 Y0", [0.0, 0.0, 0.0], 10.0),
            ("N13 X0.0 Y20 Z0", [0.0, 20.0, 0.0], 10.0),
            ("N14 X20 Y20.0 Z0 F20", [20.0, 20.0, 0.0], 20.0),
            ("N15 X10.0 Y25.0 Z0", [10.0, 25.0, 0.0], 20.0),
            ("N16 X0.0 Y20.0 Z0", [0.0, 20.0, 0.0], 20.0),
        ];
        for (line, place, per_minute) in house {
            let checked = program.run(line);
            assert_eq!((target(&checked), feed(&checked)), (place, Feed::PerMinute(per_minute / 60.0)), "{line}");
        }
        assert_eq!(program.interpreter.check(b"N16", program.dialect).unwrap().line_number, 16);
    }
}

/// The words of a line act in a fixed order: feed mode, F, S, spindle, dwell, plane, system, distance, motion, stop.
#[test]
fn order_within_a_line() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("G10 L2 P2 X100");
        program.run("G93");
        let all = program.run("M0 X7 Z2 G90 G55 G18 G4 P1.5 M3 S500 F120 G94 G1");
        assert_eq!((all.speed_changed, all.speed), (true, 500.0));
        assert_eq!(all.spindle, Some(SpindleDirection::Clockwise));
        assert_eq!(all.dwell, Some(Duration::millis(1500)));
        assert!(all.work_offset_changed);
        assert_eq!((target(&all), feed(&all)), ([107.0, 0.0, 2.0], Feed::PerMinute(2.0)));
        assert_eq!(all.flow, Flow::Pause);
        // Nothing moves, because the axis words belong to G92. G92 acts before M2 changes the modal state.
        let offset = program.run("G92 X0 M2");
        assert_eq!((offset.motion, offset.flow), (MotionCommand::None, Flow::End));
        // M2 has returned to G54. The offset of G92 was computed in G55, and acts in G54 as well.
        assert_eq!(g92(&program), [7.0, 0.0, 0.0]);
        assert_eq!(program.work(), [100.0, 0.0, 2.0]);
    }
}

#[test]
fn g0_and_g1() {
    for dialect in DIALECTS {
        let mut program = at(dialect, "X3 Y4 Z5");
        assert_eq!(target(&program.run("G0 X0 Y0 Z0")), [0.0, 0.0, 0.0]);
        // The document has `G92 G0 X0 Y0 Z0`. That is an error, because both commands need the axis words.
        assert_eq!(program.error("G92 G0 X0 Y0 Z0"), 24);
        assert_eq!(target(&program.run("G1 X20 Y15 F200")), [20.0, 15.0, 0.0]);
        assert_eq!(target(&program.run("G91 G1 X20 Y15 F200")), [40.0, 30.0, 0.0]);
        assert_eq!(target(&program.run("G90 X20 Y15")), [20.0, 15.0, 0.0]);
    }
}

fn centre(checked: &Action<3>) -> [f64; 2] {
    match checked.motion {
        MotionCommand::Arc(arc) => [arc.i.0 as f64 / 1e7, arc.j.0 as f64 / 1e7],
        _ => panic!("no arc"),
    }
}

#[test]
fn arcs_by_radius() {
    for dialect in DIALECTS {
        let program = Program::new(dialect);
        assert_eq!(centre(&program.check("G02 X10 Y10 R10 F50").unwrap()), [10.0, 0.0]);
        assert_eq!(centre(&program.check("G02 X10 Y10 R-10 F50").unwrap()), [0.0, 10.0]);
        assert_eq!(centre(&program.check("G03 X10 Y10 R10 F50").unwrap()), [0.0, 10.0]);
        assert_eq!(centre(&program.check("G03 X10 Y10 R-10 F50").unwrap()), [10.0, 0.0]);
        // One coordinate can be left out. A full circle cannot be written in radius format.
        assert_eq!(centre(&program.check("G02 X20 R10 F50").unwrap()), [10.0, 0.0]);
        assert_eq!(program.error("G02 X0 Y0 R10 F50"), 33);
        // An arc in radius format starts where the arc before it ended.
        let mut program = program;
        program.run("G2 X20 Y0 R30 F50");
        assert_eq!(target(&program.run("X40 Y10 R30")), [40.0, 10.0, 0.0]);
    }
}

/// The end point of `G02 X-30 Y-40 I-10 J-15` is not on the circle.
#[test]
fn arc_end_off_the_circle() {
    let line = "G02 X-30 Y-40 I-10 J-15 F50";
    for dialect in [Dialect::Grbl, Dialect::Oxmill] {
        assert_eq!(Program::new(dialect).error(line), 33);
    }
    let mut program = Program::new(Dialect::Seed);
    let [x, y, z] = target(&program.run(line));
    let part = (325.0_f64 / 1025.0).sqrt();
    assert!((x - (-10.0 - 20.0 * part)).abs() < 1e-7 && (y - (-15.0 - 25.0 * part)).abs() < 1e-7 && z == 0.0);
    assert_eq!(program.machine(), [x, y, z]);
    // An end point within the tolerance stays as it is written.
    let mut program = Program::new(Dialect::Seed);
    assert_eq!(target(&program.run("G2 X2.004 Y0 I1 F50")), [2.004, 0.0, 0.0]);
    // Here the end point is the centre of the arc, so there is no nearest point on the circle.
    assert_eq!(program.error("G2 X3.004 Y0 I1"), 33);
}

/// With G90.1, I and J are coordinates of the centre. With G91.1 and at power-up, they are distances from the start to
/// the centre.
#[test]
fn arc_distance_modes() {
    for dialect in [Dialect::Oxmill, Dialect::Seed] {
        let mut program = at(dialect, "X5 Y10");
        program.run("G10 L2 P1 X1 Y1");
        program.run("G91.1 F100");
        assert_eq!(centre(&program.check("G2 X8 Y9 I2 J0").unwrap()), [2.0, 0.0]);
        program.run("G90.1");
        // Work (4,9) is machine (5,10); the centre at work (6,9) is 2 mm away.
        assert_eq!(centre(&program.check("G2 X8 Y9 I6 J9").unwrap()), [2.0, 0.0]);
        assert_eq!(program.error("G2 X8 Y9 I6"), 35);
        program.run("G91");
        assert_eq!(centre(&program.check("G2 X4 Y0 I6 J9").unwrap()), [2.0, 0.0]);
        program.run("G91.1");
        assert_eq!(centre(&program.check("G2 X4 I2").unwrap()), [2.0, 0.0]);
        program.run("G90.1 M2");
        assert_eq!(centre(&program.check("G2 X8 Y9 I2").unwrap()), [2.0, 0.0]);
    }
    let program = Program::new(Dialect::Grbl);
    assert_eq!((program.error("G90.1"), program.error("G91.1")), (20, 0));
}

#[test]
fn dwell_of_a_second() {
    for dialect in DIALECTS {
        assert_eq!(Program::new(dialect).run("G4 P1.0").dwell, Some(Duration::secs(1)));
        assert_eq!(Program::new(dialect).run("G4 P0.0000004").dwell, Some(Duration::micros(0)));
        assert_eq!(Program::new(dialect).run("G4 P0.0000005").dwell, Some(Duration::micros(1)));
    }
}

/// According to the document, L20 adds its values to the coordinate system. In fact L20 makes the current position
/// read these values.
#[test]
fn g10() {
    for dialect in DIALECTS {
        let mut program = at(dialect, "X5 Y6 Z7");
        let checked = program.run("G10 L20 P2 X20");
        assert_eq!(checked.store, Some(StoredOffset::System(CoordinateSystem::G55)));
        assert!(!checked.work_offset_changed);
        assert_eq!(system(&program, CoordinateSystem::G55), [-15.0, 0.0, 0.0]);
        program.run("G10 L20 P2 X20");
        assert_eq!(system(&program, CoordinateSystem::G55), [-15.0, 0.0, 0.0]);
        program.run("G10 L20 P2 X0 Y0 Z0");
        assert_eq!(system(&program, CoordinateSystem::G55), [5.0, 6.0, 7.0]);
        assert!(program.run("G10 L2 P1 X-200 Y-100").work_offset_changed);
        assert_eq!(program.work(), [205.0, 106.0, 7.0]);
        assert!(!program.run("G10 L2 P1 X-200").work_offset_changed);
        program.run("G10 L2 P1 X0 Y0 Z0");
        assert_eq!(program.work(), program.machine());
        // P0 and a missing P mean the active system. G55 acts before the G10 in its line, so the active system is G55.
        program.run("G55 G10 L2 P0 X1");
        program.run("G10 L2 Y2");
        assert_eq!(system(&program, CoordinateSystem::G55), [1.0, 2.0, 7.0]);
    }
}

/// According to the document, G28.1 stores the values of its axis words. In fact G28.1 stores the position of the
/// machine, and its axis words are those of a normal move.
#[test]
fn g28() {
    for dialect in DIALECTS {
        let mut program = at(dialect, "X10 Y20 Z30");
        program.run("G10 L2 P1 Z1");
        assert_eq!(program.run("G28.1").store, Some(StoredOffset::G28));
        program.run("G53 G0 X0 Y0 Z0");
        // Example 1 of the document: Z moves to its stored position from where it is.
        let home = program.check("G91 G28 Z0").unwrap();
        assert_eq!((via(&home), target(&home)), (Some([0.0, 0.0, 0.0]), [0.0, 0.0, 30.0]));
        // Example 2 of the document: without G91, Z first moves to work Z0, where the table can be.
        let home = program.check("G28 Z0").unwrap();
        assert_eq!((via(&home), target(&home)), (Some([0.0, 0.0, 1.0]), [0.0, 0.0, 30.0]));
        // Example 3 of the document: Z first moves to work Z-10.
        let home = program.run("G90 G28 Z-10");
        assert_eq!((via(&home), target(&home)), (Some([0.0, 0.0, -9.0]), [0.0, 0.0, 30.0]));
        assert_eq!((feed(&home), program.machine()), (Feed::Rapid, [0.0, 0.0, 30.0]));
        // Example 4 of the document: the position is stored, and X-10 Y-25 is a rapid, as G0 is active.
        let stored = program.run("G28.1 X-10 Y-25");
        assert_eq!(target(&stored), [-10.0, -25.0, 30.0]);
        assert_eq!(in_mm(&program.interpreter.offsets().stored(StoredOffset::G28)), [0.0, 0.0, 30.0]);
        let home = program.run("G28");
        assert_eq!((via(&home), target(&home)), (None, [0.0, 0.0, 30.0]));
        // Example 5 of the document: two rapids are used instead of G28.
        assert_eq!(target(&program.run("G90 G0 Z-10")), [0.0, 0.0, -9.0]);
        assert_eq!(target(&program.run("X0 Y0 Z0")), [0.0, 0.0, 1.0]);
        // G30 has a stored position of its own.
        program.run("G30.1");
        assert_eq!(target(&program.run("G30")), [0.0, 0.0, 1.0]);
    }
}

#[test]
fn g53() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("G10 L2 P1 X50 Y50 Z50");
        assert_eq!(target(&program.run("G53 G0 X-10 Y-25 Z-9")), [-10.0, -25.0, -9.0]);
        assert_eq!(target(&program.run("G53 X-20 Y-10 Z-5")), [-20.0, -10.0, -5.0]);
        assert_eq!(target(&program.run("X0 Y0 Z0")), [50.0, 50.0, 50.0]);
        assert_eq!(target(&program.run("G91 G53 X1")), [1.0, 50.0, 50.0]);
        assert_eq!(target(&program.run("X1")), [2.0, 50.0, 50.0]);
    }
}

/// After `G92 X10 Y25 Z0` the position is (-10,-25) according to the document. In fact it reads (10,25).
#[test]
fn g92_sets_the_present_position() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("G92 X10 Y25 Z0");
        assert_eq!(program.work(), [10.0, 25.0, 0.0]);
        program.run("G92 X0 Y0 Z0");
        assert_eq!(program.work(), [0.0, 0.0, 0.0]);
        program.run("G92 X-100 Y-125 Z-50");
        assert_eq!(g92(&program), [100.0, 125.0, 50.0]);
        // G92 acts in every coordinate system.
        program.run("G10 L2 P2 X1");
        program.run("G55");
        assert_eq!(program.work(), [-101.0, -125.0, -50.0]);
        // An axis that is not named keeps its offset.
        program.run("G92 Y0");
        assert_eq!(program.work(), [-101.0, 0.0, -50.0]);
    }
}

#[test]
fn g90_g91() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        assert_eq!(target(&program.run("G90 G0 X-5 Y-10")), [-5.0, -10.0, 0.0]);
        assert_eq!(target(&program.run("G91 G0 X10 Y-10")), [5.0, -20.0, 0.0]);
    }
}

#[test]
fn g93_g94() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        assert_eq!(feed(&program.run("G93 G1 X10 F2.0")), Feed::InverseTime(30.0));
        assert_eq!(program.error("G1 X20"), 22);
        assert_eq!(program.error("G94 X20"), 22);
        assert_eq!(feed(&program.run("G94 X20 F20")), Feed::PerMinute(20.0 / 60.0));
        // With G94, F is a length per minute and depends on the unit. With G93 it is a count per minute.
        assert_eq!(feed(&program.run("G20 F6 X1")), Feed::PerMinute(6.0 * 25.4 / 60.0));
        assert_eq!(feed(&program.run("G93 F6 X2")), Feed::InverseTime(10.0));
        assert_eq!(feed(&program.run("G94 F6 X3")), Feed::PerMinute(6.0 * 25.4 / 60.0));
    }
}

/// Figure 2.9 of the document: origin of the work system at (-100,-70), machine at (-90,-60), then G92 X5 Y5.
#[test]
fn local_coordinates() {
    for dialect in DIALECTS {
        let mut program = at(dialect, "X-90 Y-60");
        program.run("G10 L2 P1 X-100 Y-70");
        assert_eq!(program.work(), [10.0, 10.0, 0.0]);
        program.run("G92 X5 Y5");
        assert_eq!(g92(&program), [5.0, 5.0, 0.0]);
        assert_eq!(program.work(), [5.0, 5.0, 0.0]);
        // G92 stays in force when the origin changes.
        program.run("G10 L2 P1 X3.5 Y17.2");
        assert_eq!(system(&program, CoordinateSystem::G54), [3.5, 17.2, 0.0]);
        assert_eq!(program.work(), [-98.5, -82.2, 0.0]);
        // L20 sets origin = machine position - value - G92.
        program.run("G10 L20 P1 X1.5");
        assert_eq!(system(&program, CoordinateSystem::G54), [-96.5, 17.2, 0.0]);
        assert_eq!(program.work(), [1.5, -82.2, 0.0]);
        // P does not select the system.
        program.run("G10 L2 P3 X0.5");
        assert_eq!(program.interpreter.modal().coordinate_system, CoordinateSystem::G54);
        program.run("G10 L2 P1 X0 Y0 Z0");
        program.run("G92.1");
        assert_eq!(program.work(), program.machine());
    }
}

/// According to the document, G10 L2 does nothing with G91. In fact it acts as with G90.
#[test]
fn g10_l2_with_g91() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run_all("G91\nG10 L2 P1 X3.5 Y17.2\nG10 L2 P1 X3.5");
        assert_eq!(system(&program, CoordinateSystem::G54), [3.5, 17.2, 0.0]);
    }
}

#[test]
fn tool_length_is_the_third_offset() {
    for dialect in DIALECTS {
        let mut program = at(dialect, "Z10");
        program.run("G10 L2 P1 Z1");
        program.run("G43.1 Z2");
        assert_eq!(program.work(), [0.0, 0.0, 7.0]);
        program.run("G92 Z0");
        assert_eq!(g92(&program), [0.0, 0.0, 7.0]);
        program.run("G10 L20 P1 Z5");
        assert_eq!(program.work(), [0.0, 0.0, 5.0]);
        assert_eq!(system(&program, CoordinateSystem::G54), [0.0, 0.0, -4.0]);
        assert_eq!(target(&program.run("G0 Z0")), [0.0, 0.0, 5.0]);
        assert!(program.run("G49").work_offset_changed);
        assert_eq!(program.work(), [0.0, 0.0, 2.0]);
        program.run("G20 G43.1 Z1");
        assert_eq!(program.work(), [0.0, 0.0, 2.0 - 25.4]);
    }
}

/// One program cuts several workpieces, each with its own origin: G54, G55. Later, the program itself moves an origin
/// with G10.
#[test]
fn one_program_at_several_origins() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run_all("G10 L2 P1 X10 Y20\nG10 L2 P2 X30 Y40");
        for (word, place) in [("G54", [11.0, 22.0, 0.0]), ("G55", [31.0, 42.0, 0.0]), ("G54", [11.0, 22.0, 0.0])] {
            assert_eq!(target(&program.run(&format!("{word} G0 X1 Y2"))), place);
        }
        program.run("G10 L2 P1 X-5");
        assert_eq!(target(&program.run("X1 Y2")), [-4.0, 22.0, 0.0]);
    }
}

/// G59.1 to G59.3 are coordinate systems of their own. In the document, a control that reads G59.1 as G59 is in error.
#[test]
fn systems_beyond_g59() {
    for dialect in [Dialect::Oxmill, Dialect::Seed] {
        let mut program = Program::new(dialect);
        program.run_all("G10 L2 P6 X6\nG10 L2 P7 X7\nG10 L2 P8 X8\nG10 L2 P9 X9");
        for (word, x) in [("G59", 6.0), ("G59.1", 7.0), ("G59.2", 8.0), ("G59.3", 9.0), ("G59", 6.0)] {
            assert_eq!(target(&program.run(&format!("{word} G0 X0"))), [x, 0.0, 0.0]);
            assert_eq!(program.interpreter.modal().coordinate_system.word(), word);
        }
        assert_eq!(program.error("G10 L2 P10 X0"), 29);
        assert_eq!(program.error("G59.4"), 29);
    }
    let program = Program::new(Dialect::Grbl);
    assert_eq!((program.error("G59.1"), program.error("G10 L2 P7 X0")), (23, 29));
}

const FIVE_CIRCLES: &str = "
    G10 L2 P1 X0 Y0 Z0
    G10 L2 P2 X10
    G10 L2 P3 X-10
    G10 L2 P4 Y10
    G10 L2 P5 Y-10
    G54 G0 X-2.0 Y0 Z0
    G1 F1 Z-1.00
    G3 X-10.0 Y0 I1.0 J0
    G0 Z0
    G55 G0 X-2.0 Y0 Z0
    G1 F1 Z-1.00
    G3 X-10.0 Y0 I1.0 J0
    G0 Z0
    G56 G0 X-2.0 Y0 Z0
    G1 F1 Z-1.00
    G3 X-10.0 Y0 I1.0 J0
    G0 Z0
    G57 G0 X-2.0 Y0 Z0
    G1 F1 Z-1.00
    G3 X-10.0 Y0 I1.0 J0
    G0 Z0
    G58 G0 X-2.0 Y0 Z0
    G1 F1 Z-1.00
    G3 X-10.0 Y0 I1.0 J0
    G0 Z0
    M2";

fn circles(program: &mut Program, text: &str) -> Vec<[f64; 3]> {
    let mut circles = Vec::new();
    for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
        if let MotionCommand::Arc(arc) = program.run(line).motion {
            assert_eq!((arc.start, arc.clockwise, arc.turns), (arc.target, false, 0), "{line} is no full circle");
            let [x, y, z] = in_mm(&arc.start);
            circles.push([x + arc.i.0 as f64 / 1e7, y + arc.j.0 as f64 / 1e7, z]);
        }
    }
    circles
}

/// In the document, the circles end at X-10, which is off the circle. The dialect `seed` takes them for full circles;
/// the other dialects refuse them.
#[test]
fn five_circles() {
    let cross = [[-1.0, 0.0, -1.0], [9.0, 0.0, -1.0], [-11.0, 0.0, -1.0], [-1.0, 10.0, -1.0], [-1.0, -10.0, -1.0]];
    let on_the_circle = FIVE_CIRCLES.replace("X-10.0 Y0 I", "X-2.0 Y0 I");
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        assert_eq!(circles(&mut program, &on_the_circle), cross);
        assert_eq!(program.machine(), [-2.0, -10.0, 0.0]);
        assert_eq!(program.interpreter.modal().coordinate_system, CoordinateSystem::G54);
        program.run("G0 X-2 Y0 Z-1");
        assert_eq!(program.error("G3 X-10.0 Y0 I1.0 J0"), if dialect == Dialect::Seed { 0 } else { 33 });
    }
    assert_eq!(circles(&mut Program::new(Dialect::Seed), FIVE_CIRCLES), cross);
}

/// A dwell acts only in its own line. A second G92 replaces the first one.
#[test]
fn modal_and_non_modal() {
    for dialect in DIALECTS {
        let mut program = Program::new(dialect);
        program.run("G0 X1 G4 P1");
        assert_eq!(program.run("X2").dwell, None);
        program.run("G92 X20");
        program.run("G92 X30");
        assert_eq!(g92(&program), [-28.0, 0.0, 0.0]);
        // G0 stays until another motion word comes.
        assert_eq!(feed(&program.run("X3 F100")), Feed::Rapid);
        assert_eq!(feed(&program.run("G1 X4")), Feed::PerMinute(100.0 / 60.0));
        assert_eq!(feed(&program.run("X5")), Feed::PerMinute(100.0 / 60.0));
    }
}

/// `G10 ... G1 ...` on one line is an error, because both commands need the axis words.
#[test]
fn two_commands_with_axis_words() {
    for dialect in DIALECTS {
        assert_eq!(Program::new(dialect).error("G10 L2 P1 X3.5 Y17.2 G1 X2.0 Y5.8"), 24);
    }
}

/// The document's drilling example has G0, G49 and G80 on one line. Grbl refuses that; the other dialects accept it,
/// and G0 is in force afterwards.
#[test]
fn g80_beside_a_motion_word() {
    for line in ["G0 G40 G17 G80 G90", "G80 G40 G17 G0 G90"] {
        assert_eq!(Program::new(Dialect::Grbl).error(line), 21);
        for dialect in [Dialect::Oxmill, Dialect::Seed] {
            let mut program = Program::new(dialect);
            program.run("G1 F100");
            program.run(line);
            assert_eq!(program.interpreter.modal().motion, MotionMode::Rapid);
        }
    }
    assert_eq!(Program::new(Dialect::Grbl).error("G0 G49 G40 G17 G80 G90"), 24);
    for dialect in [Dialect::Oxmill, Dialect::Seed] {
        let mut program = Program::new(dialect);
        program.run("G43.1 Z3");
        // G49 ends the tool offset before the motion.
        assert_eq!(target(&program.run("G0 G49 G40 G17 G80 G90 Z1")), [0.0, 0.0, 1.0]);
        for line in ["G80 G80", "G80 G80 G0", "G0 G80 G1"] {
            assert_ne!(program.error(line), 0, "{line}");
        }
    }
}

/// In the document's drilling example, a line after G80 has only `X-7 Y-4`. Grbl and Oxmill refuse it (`error:31`). In
/// the dialect `seed` it moves in the mode of the last G0 or G1.
#[test]
fn axis_words_after_g80() {
    for dialect in [Dialect::Grbl, Dialect::Oxmill] {
        let mut program = Program::new(dialect);
        program.run("G80");
        assert_eq!(program.error("X-7 Y-4"), 31);
    }
    let mut program = Program::new(Dialect::Seed);
    program.run_all("G0 X1\nG2 X3 I1 F100\nG80");
    assert_eq!(program.interpreter.modal().motion.word(), "G80");
    let rapid = program.run("X-7 Y-4");
    assert_eq!((target(&rapid), feed(&rapid)), ([-7.0, -4.0, 0.0], Feed::Rapid));
    program.run_all("G1\nG80");
    assert_eq!(feed(&program.run("G53 X0")), Feed::PerMinute(100.0 / 60.0));
    // Here G80 is on the line itself. Then the axis word is refused, even in the dialect `seed`.
    assert_eq!(program.error("G80 X1"), 31);
}
