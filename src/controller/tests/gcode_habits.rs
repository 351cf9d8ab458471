//! Tests of words that CAM programs write out of habit. Some of these words have the meaning that other controls give
//! them. The others have no effect.
#![cfg(feature = "full")]

use crate::program::{Program, in_mm, target, via};
use oxmill_controller::gcode::{Action, CoordinateSystem, Dialect, Feed, MotionCommand, MotionMode, Notice};

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Runs `test` in the dialects that have the words. Grbl's dialect refuses the lines of `grbl` with these error
/// numbers.
fn each(grbl: &[(&str, u8)], test: impl Fn(&mut Program)) {
    for dialect in NEW {
        let mut program = Program::new(dialect);
        program.run_all("G21 G90 F300");
        test(&mut program);
    }
    let mut program = Program::new(Dialect::Grbl);
    program.run_all("G21 G90 F300");
    for (line, error) in grbl {
        assert_eq!(program.error(line), *error, "{line}");
    }
}

/// G70 and G71 select units, as in Mach. They are not the lathe cycles of other controls.
#[test]
fn units_of_mach() {
    each(&[("G70", 20), ("G71", 20)], |program| {
        program.run("G70 G0 X1");
        assert_eq!((program.machine()[0], program.interpreter.modal().units.word()), (25.4, "G20"));
        program.run("G71 G0 X1");
        assert_eq!((program.machine()[0], program.interpreter.modal().units.word()), (1.0, "G21"));
        for (line, error) in [("G70 G20", 21), ("G70 G71", 21), ("G70.1", 20), ("G71 P10 Q20 U1", 149), ("G71 P10", 36)]
        {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// D names the register of the cutter's radius. D has no effect here, because there is no cutter compensation.
#[test]
fn d_beside_g43_or_alone() {
    each(&[("D1", 20), ("G43.1 Z1 D1", 20)], |program| {
        program.run("G10 L1 P5 Z2");
        program.run("G43 H5 D5 Z10");
        assert_eq!(program.machine(), [0.0, 0.0, 12.0]);
        for line in ["D1", "N10 D12", "G49 D0", "G40 D1", "G43 H5 D1 G1 X1 Y1", "G0 G40 G49 D3 X1", "G43.1 Z2 D1"] {
            assert_eq!(program.error(line), 0, "{line}");
        }
        assert_eq!(program.run("D1").motion, MotionCommand::None);
        for (line, error) in [
            ("D-1", 4),
            ("D1.5", 23),
            ("D1 D2", 25),
            ("G0 X1 D1", 36),
            // In Siemens controls D1 selects the length of the tool, so D beside T is refused.
            ("T1 D1", 36),
            ("T1 M6 D1", 36),
            ("D1 F200", 36),
            ("D1 P1", 36),
            ("G41 D1", 122),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// G31 is a probing move without an alarm; it is not modal.
#[test]
fn skip() {
    each(&[("G31 X1", 20)], |program| {
        for (before, after) in
            [("G0", MotionMode::Rapid), ("G1 X2", MotionMode::Linear), ("G2 X4 Y0 I2 J0", MotionMode::Linear)]
        {
            program.run_all("G0 X0 Y0\nG1");
            program.run(before);
            let checked = program.run("G31 Z-10 F50");
            let MotionCommand::Probe { away: false, alarm: false, .. } = checked.motion else {
                panic!("{:?}", checked.motion)
            };
            assert_eq!(target(&checked)[2], -10.0);
            assert_eq!(program.interpreter.modal().motion, after, "{before}");
            program.run("Z5");
        }
        program.run_all("G0 Z5\nG91 G31 Z-1\nG90");
        assert_eq!(program.machine()[2], 4.0);
        program.run_all("G81 X0 Z0 R5\nG31 Z-1");
        assert_eq!(program.interpreter.modal().motion, MotionMode::Rapid, "the series of cycles has ended");
        for (line, error) in [("G31", 26), ("G31 Z-1", 33), ("G31 G0 X1", 24), ("G31 P1 X1", 36), ("G31.1 X1", 121)] {
            assert_eq!(program.error(line), error, "{line}");
        }
        let mut unfed = Program::new(program.dialect);
        assert_eq!(unfed.error("G31 Z-1"), 22);
        unfed.run("G31 Z-1 F10");
    });
}

#[test]
fn look_ahead() {
    let grbl = [("G187 P1", 20), ("G8 P1", 20), ("G5.1 Q1", 20), ("G5 P10000", 20)];
    each(&grbl, |program| {
        program.run("G1 X1");
        for line in [
            "G187",
            "G187 P2",
            "G187 P3 E0.01",
            "G08 P1",
            "G8 P0",
            "G05.1 Q1",
            "G5.1 Q0",
            "G05.1 Q1 R5",
            "G05 P10000",
            "G5 P0",
        ] {
            let before = *program.interpreter.modal();
            let checked = program.run(line);
            assert_eq!((checked.motion, checked.notice()), (MotionCommand::None, Some(Notice::LookAhead)), "{line}");
            assert!(!checked.moves_only(), "{line}");
            assert_eq!(*program.interpreter.modal(), before, "{line}");
            let mut new = Program::new(program.dialect);
            new.run(line);
            assert_eq!(new.interpreter.modal().motion, MotionMode::Rapid, "{line}");
        }
        program.run("X3");
        assert_eq!(program.machine()[0], 3.0);
        for (line, error) in [
            // Words of lathes and of splines are refused.
            ("G8", 121),
            ("G7 P1", 121),
            ("G8.1 P1", 20),
            ("G187.5", 20),
            ("G187 H1", 36),
            ("G5.1 X1 Q1", 28),
            ("G5.1 I1 J1", 26),
            ("G5 P1 Q1", 26),
            ("G5 X1 P1", 28),
            ("G5.1", 26),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// M29 announces rigid tapping; the tapping cycle itself is refused.
#[test]
fn rigid_tapping() {
    each(&[("M29 S100", 20)], |program| {
        let checked = program.run("M29 S500");
        assert_eq!(
            (checked.motion, checked.notice(), checked.speed),
            (MotionCommand::None, Some(Notice::RigidTapping), 500.0)
        );
        assert_eq!((program.error("G84 X1 Z-5 R2"), program.error("M29 M29"), program.error("M29.5")), (121, 21, 23));
        assert_eq!(program.error("M29 P1"), 36);
    });
}

#[test]
fn numbers_of_programs() {
    each(&[(":1000", 1), ("O1000", 20)], |program| {
        for line in ["O1000", ":1000", "N5 :1000", "N5 O1000", ":0001"] {
            assert_eq!(program.run(line).motion, MotionCommand::None, "{line}");
        }
        for (line, error) in [(":", 1), (":X", 1), (":1000 G0 X1", 36), ("G0 X1 :5", 36), ("::1", 1)] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// In G54.1 and in G154, P1 selects G59.1, P2 selects G59.2, and P3 selects G59.3.
#[test]
fn more_coordinate_systems() {
    each(&[("G54.1 P1", 23), ("G154 P1", 20)], |program| {
        program.run("G10 L2 P8 X10 Y20");
        for (line, system) in [
            ("G54.1 P1", CoordinateSystem::G59_1),
            ("G54.1 P2", CoordinateSystem::G59_2),
            ("G54.1P3", CoordinateSystem::G59_3),
            ("G154 P1", CoordinateSystem::G59_1),
            ("G154 P3", CoordinateSystem::G59_3),
            ("G154 P2 G0 X1 Y1", CoordinateSystem::G59_2),
        ] {
            program.run("G54");
            let checked = program.run(line);
            assert!(checked.work_offset_changed, "{line}");
            assert_eq!(program.interpreter.modal().coordinate_system, system, "{line}");
        }
        assert_eq!(program.machine(), [11.0, 21.0, 0.0]);
        for (line, error) in [
            ("G54.1", 28),
            ("G154", 28),
            ("G54.1 P0", 29),
            ("G54.1 P4", 29),
            ("G154 P99", 29),
            ("G54.1 P1.5", 23),
            ("G54.1 P-1", 4),
            ("G54.1 P1 G55", 21),
            ("G54.2 P1", 29),
            ("G154.1 P1", 20),
            ("G54.1 P1 G4", 28),
            ("G54.1 P1 G10 L2 X1", 28),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// On lathes and some mills, U, V and W are distances along X, Y and Z. Here only G28 and G30 take them.
#[test]
fn returns_by_distances() {
    each(&[("G28 U0 W0", 20)], |program| {
        program.run_all("G0 X1 Y2 Z3\nG28.1\nG30.1\nG0 X10 Y20 Z30");
        for (line, by, end) in [
            ("G28 U0 W0", [10.0, 20.0, 30.0], [1.0, 20.0, 3.0]),
            ("G28 W5", [10.0, 20.0, 35.0], [10.0, 20.0, 3.0]),
            ("G30 V-1", [10.0, 19.0, 30.0], [10.0, 2.0, 30.0]),
            ("G91 G28 U0 V0 W0", [10.0, 20.0, 30.0], [1.0, 2.0, 3.0]),
            ("G90 G28 U1", [11.0, 20.0, 30.0], [1.0, 20.0, 30.0]),
        ] {
            let checked = program.clone().run(line);
            assert_eq!((via(&checked), in_mm(checked.position())), (Some(by), end), "{line}");
            let distance = if line.starts_with("G91") { "G91" } else { "G90" };
            assert_eq!(checked.modal().distance.word(), distance, "{line}");
        }
        for (line, error) in [
            ("U1", 149),
            ("G0 U1", 149),
            ("U0 G28", 149),
            ("G28.1 U0", 149),
            ("G53 G0 W0", 149),
            ("G28 X0 W0", 149),
            ("G28 X0 U0", 25),
            ("G28 U0 U0", 25),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// In Mach, the words A and B of G68 set the centre of the rotation. Other controls write X and Y instead.
#[cfg(feature = "full")]
#[test]
fn rotations_of_mach() {
    each(&[("G68 A1 B2 R90", 20)], |program| {
        program.run_all("G0 X9 Y9\nG68 A1 B2 R90\nG0 X2 Y2");
        assert_eq!(program.machine(), [1.0, 3.0, 0.0]);
        program.run_all("G69 G0 X1 Y5\nG68 B2 R90\nG0 X2 Y2");
        assert_eq!(program.machine(), [1.0, 3.0, 0.0]);
        program.run_all("G69\nG70 G68 A1 B0 R180\nX0 Y0\nG69 G71");
        assert_eq!(program.machine(), [50.8, 0.0, 0.0]);
        for (line, error) in [
            ("G68 X1 A1 B2 R9", 36),
            ("G68 A1 A1 R9", 25),
            ("A1 G68 R9", 20),
            ("G69 A1", 20),
            ("G0 A1", 20),
            ("A1", 20),
            ("B1", 20),
            ("G68 C1 R9", 20),
            ("G68 A1 B2", 28),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// These named parameters of LinuxCNC tell a program on which control it runs, and what that control can do.
#[cfg(feature = "full")]
#[test]
fn what_programs_ask() {
    for dialect in NEW {
        let mut program = Program::new(dialect);
        program.run_all("G21 G90 F300 G99");
        for (name, value) in [
            ("task", 1.0),
            ("metric_machine", 1.0),
            ("spindle_rpm_mode", 1.0),
            ("spindle_css_mode", 0.0),
            ("units_per_rev", 0.0),
            ("lathe_diameter_mode", 0.0),
            ("lathe_radius_mode", 1.0),
            ("adaptive_feed", 0.0),
            ("feed_hold", 1.0),
            ("retract_r_plane", 1.0),
            ("retract_old_z", 0.0),
            ("feed_override", 1.0),
            ("speed_override", 1.0),
        ] {
            let name = name.to_uppercase();
            program.run(&format!("G0 X[2+#<_{name}>]"));
            assert_eq!(program.machine()[0], 2.0 + value, "{name}");
            assert_eq!(program.error(&format!("#<_{name}>=1")), 200, "{name}");
        }
        program.run_all("G98 M50 P0\nG0 X[#<_FEED_OVERRIDE>] Y[#<_SPEED_OVERRIDE>] Z[#<_RETRACT_OLD_Z>]");
        assert_eq!(program.machine(), [0.0, 1.0, 1.0]);
    }
}

/// Returns the speed of a straight feed move or an arc, mm/min.
fn speed(checked: &Action<3>) -> f32 {
    match &checked.motion {
        MotionCommand::Line { feed: Feed::PerMinute(feed), .. } => feed * 60.0,
        MotionCommand::Arc(arc) => match arc.feed {
            Feed::PerMinute(feed) => feed * 60.0,
            feed => panic!("{feed:?}"),
        },
        motion => panic!("{motion:?}"),
    }
}

/// With G95, F is the distance per revolution of the spindle. The feed rate is F times the programmed S.
#[test]
fn feed_per_revolution() {
    each(&[("G95", 20), ("G95 F1", 20)], |program| {
        let near = |program: &mut Program, line: &str, expected: f32| {
            let found = speed(&program.run(line));
            assert!((found - expected).abs() < 1.0e-3 * expected, "{line}: {found}");
        };
        program.run("S1000 M3");
        // An F that was set with G94 is not in force with G95. An F of G95 is not in force in the other modes.
        assert_eq!((program.error("G95 G1 X1"), program.error("G95 G93 G1 X1 F1")), (22, 21));
        near(program, "G95 G1 X1 F0.2", 200.0);
        near(program, "X2", 200.0);
        near(program, "X3 S500", 100.0);
        near(program, "G2 X5 I1", 100.0);
        program.run("S2000");
        near(program, "G1 X6", 400.0);
        near(program, "G20 X1 F0.01", 508.0);
        near(program, "G21 X7", 508.0);
        assert_eq!(program.error("X8 S0"), 22);
        program.run("S0");
        for (line, error) in [("X8", 22), ("G0 X8", 0), ("G1", 22), ("G81 X1 Z-1 R1", 22), ("G38.2 X1", 22)] {
            assert_eq!(program.error(line), error, "{line}");
        }
        let [per_revolution, per_minute] = ["S2 F40 G81 X7 Z-1 R1", "G94 F80 G81 X7 Z-1 R1"].map(|line| {
            let mut program = program.clone();
            program.run(line).motion
        });
        assert!(matches!(per_minute, MotionCommand::Cycle(_)));
        assert_eq!(per_revolution, per_minute);
        program.run("S100");
        assert_eq!(
            (program.error("G81 X1 Z-1 R1"), program.error("G94 G1 X9"), program.error("G93 G1 X9")),
            (0, 22, 22)
        );
        near(program, "G94 G1 X9 F300", 300.0);
        // M70 saves G95 together with its F. The end of a program selects G94 and leaves no F in force.
        program.run_all("G95 F0.5\nM70\nG94 F100\nM72");
        near(program, "G1 X10", 50.0);
        assert_eq!(program.interpreter.modal().feed_mode.word(), "G95");
        program.run("M2");
        assert_eq!((program.interpreter.modal().feed_mode.word(), program.error("G1 X9")), ("G94", 22));
        // A jog has its own F, per minute.
        program.run_all("G95 F0.5");
        let jog = program.interpreter.check_jog(b"G91X1F600", program.dialect).unwrap();
        assert_eq!(speed(&jog), 600.0);
        program.interpreter.change_dialect();
        assert_eq!(program.interpreter.modal().feed_mode.word(), "G94");
    });
}

/// On other controls, P of G30 selects a stored position: P1 selects the position of G28, and P2 the position of G30.
/// Here G30 accepts only P2.
#[test]
fn second_stored_position() {
    each(&[("G30 P2", 36)], |program| {
        program.run_all("G0 X5 Y6\nG30.1\nG0 X0 Y0");
        let checked = program.run("G30 P2");
        assert_eq!(target(&checked), [5.0, 6.0, 0.0]);
        program.run("G0 X1 Y1");
        assert_eq!(target(&program.run("G91 G30 P2 Y0")), [1.0, 6.0, 0.0]);
        for (line, error) in [("G30 P1", 39), ("G30 P3 Z0", 39), ("G30 P2.5", 39), ("G28 P2", 36), ("G30 P-2", 4)] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

/// G15 ends the mode G16, and G67 ends the mode G66. Here neither mode is active, so both words do nothing. G16 itself
/// is refused. G66 calls a subprogram only as the first word of its line. Elsewhere in a line it is refused.
#[test]
fn modes_that_are_never_active() {
    each(&[("G15", 20), ("G67", 20)], |program| {
        program.run("G0 G15 G17 G40 G49 G50 G67 G69 G80 G90 X3");
        assert_eq!(program.machine()[0], 3.0);
        for (line, error) in [("G16", 121), ("G0 G66 P1", 121), ("G15 G15", 21), ("G15.1", 20), ("G67.1", 20)] {
            assert_eq!(program.error(line), error, "{line}");
        }
    });
}

#[test]
fn the_system_of_the_setter() {
    each(&[], |program| {
        assert_eq!(program.run("G54.1 P3").notice(), Some(Notice::SystemOfSetter));
        assert_eq!(program.run("G154 P2").notice(), None);
        assert_eq!(program.run("G59.3").notice(), None);
    });
}

/// G12 and G13 cut a circle round the tool, as on Mach. The tool ends where it began.
#[test]
fn circles_round_the_tool() {
    each(&[("G12 I5", 20), ("G13 I5", 20)], |program| {
        program.run_all("G10 L2 P1 X3 Y4\nG0 X10 Y20 Z-1\nG2 X10 Y20 I1");
        for (line, clockwise) in [("G12 I2.5", true), ("N7 G13 I2.5 F600 M3 S100", false)] {
            let action = program.run(line);
            let MotionCommand::Arc(arc) = action.motion else { panic!("{line} is no arc") };
            assert_eq!(in_mm(&arc.start), [15.5, 24.0, -1.0], "{line}");
            assert_eq!((arc.target, arc.clockwise, arc.from_centre, arc.turns), (arc.start, clockwise, true, 0));
            assert_eq!([arc.i, arc.j].map(|way| way.to_mm()), [-2.5, 0.0]);
            assert_eq!(action.notice(), Some(Notice::CircleOfMach));
            assert_eq!(program.machine(), [13.0, 24.0, -1.0], "the tool returns to the centre");
            assert_eq!(program.interpreter.modal().motion, MotionMode::ArcClockwise, "the motion mode stays");
        }
        // The radius is affected by inches, by a scaling that mirrors, and by a rotation.
        program.run_all("G51 X0 Y0 I-2 J2\nG68 X0 Y0 R90\nG0 X0 Y0");
        let MotionCommand::Arc(arc) = program.run("G20 G12 I0.5").motion else { panic!("no arc") };
        let centre = program.machine();
        let [x, y, _] = in_mm(&arc.start);
        assert!((x - centre[0]).abs() < 1e-4 && (y - centre[1] + 25.4).abs() < 1e-4, "{x} {y} from {centre:?}");
        assert!(!arc.clockwise, "mirrored");
    });
    for dialect in NEW {
        let mut program = Program::new(dialect);
        assert_eq!(program.error("G12 I5"), 22, "no feed");
        program.run("F300");
        for (line, error) in [
            ("G12", 28),
            ("G13 R5", 28),
            ("G12 I0", 39),
            ("G13 I-5", 39),
            ("G12 I5 X1", 36),
            ("G13 I5 Z-1", 36),
            ("G12 I5 J1", 36),
            ("G13 I5 D1", 36),
            ("G40 G13 I5 D1", 36),
            ("G43 H1 G12 I5 D0", 36),
            ("G13 I5 K10 Q2", 36),
            ("G12 I5 L2", 36),
            ("G1 G12 I5", 24),
            ("G12 G13 I5", 24),
            ("G53 G12 I5", 30),
            ("G12 I60000", 33),
            ("G93 G12 I5 F2", 120),
            ("G18 G13 I5", 140),
            ("G12.1 I5", 121),
        ] {
            assert_eq!(program.error(line), error, "{line}");
        }
        // On Haas controls, a D word changes the meaning of I in G12 to the radius of the finished wall. So after a D
        // word G12 is refused. D0 or the end of the program ends that.
        for (before, error) in [("D3", 121), ("G43 H1 D2", 121), ("D0", 0), ("D3\nM30", 0)] {
            program.run_all(before);
            assert_eq!(program.error("G12 I5"), error, "behind {before}");
        }
        program.run_all("G95 F0.1 S100\nG0 X1");
        assert_eq!([program.error("S0 G12 I5"), program.error("G12 I5")], [22, 0]);
        program.run_all("G94 F100");
        // After G5.2 has begun a curve of control points, a circle or line is refused until G5.3 ends the curve.
        program.run_all("G0 X0 Y0\nG5.2 X1 Y1 P1 L3\nX2 Y0 P1");
        assert_eq!([program.error("G12 I5"), program.error("G1 X5")], [146, 146]);
    }
}
