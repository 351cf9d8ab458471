//! Tests of what Grbl does not have: G52, G92.2, G92.3, circles without axis words, M48 to M53, M70 to M72, path
//! control (G61.1, G64), and words that are refused with a special error.

use crate::program::{Program, in_mm};
use oxmill_controller::gcode::{CycleStep, Dialect, Flow, MotionCommand, PathControl};
use oxmill_controller::messages::SpindleDirection;
use oxmill_controller::units::Coordinate;

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Returns a program at X1 Y2 Z3.
fn ready(dialect: Dialect) -> Program {
    let mut program = Program::new(dialect);
    program.run_all("G21 F300\nG0 X1 Y2 Z3");
    program
}

/// Runs lines and checks the machine position after each.
fn play(lines: &[(&str, [f64; 3])]) {
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, machine) in lines {
            program.run(line);
            assert_eq!(program.machine(), *machine, "{line}");
        }
    }
}

#[test]
fn g92_suspended_and_restored() {
    play(&[
        ("G92 X10", [1.0, 2.0, 3.0]),
        ("G0 X11", [2.0, 2.0, 3.0]),
        ("G92.2", [2.0, 2.0, 3.0]),
        ("X1", [1.0, 2.0, 3.0]),
        ("G92.3", [1.0, 2.0, 3.0]),
        ("X1", [-8.0, 2.0, 3.0]),
        ("G92.1", [-8.0, 2.0, 3.0]),
        ("X1", [1.0, 2.0, 3.0]),
        // After G92.1, G92.3 has nothing to restore.
        ("G92.3", [1.0, 2.0, 3.0]),
        ("X2", [2.0, 2.0, 3.0]),
    ]);
}

/// G92.1, G92.2 and G92.3 change the offset before the motion of their line, as in RS274NGC.
#[test]
fn g92_changes_before_the_motion_of_its_line() {
    play(&[
        ("G0 Y0", [1.0, 0.0, 3.0]),
        ("G92 Y4", [1.0, 0.0, 3.0]),
        ("G92.2 G0 Y2", [1.0, 2.0, 3.0]),
        ("G92.3 G0 Y2", [1.0, -2.0, 3.0]),
        ("G92.2 Y3", [1.0, 3.0, 3.0]),
        ("G92.3 G91 Y3", [1.0, 6.0, 3.0]),
        ("G90 G92.1 Y3", [1.0, 3.0, 3.0]),
        // With G90.1, the centre of an arc is a coordinate of the program. So the changed offset acts on it, too.
        ("G92 X11 Y13", [1.0, 3.0, 3.0]),
        ("G92.2 G90.1 G2 X3 Y3 I2 J3", [3.0, 3.0, 3.0]),
        ("G92.3 G2 X11 Y13 I12 J13", [1.0, 3.0, 3.0]),
    ]);
}

#[test]
fn g92_changes_before_the_cycle_of_its_line() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run_all("G92 X11 Z13");
        let levels = |program: &mut Program, line: &str| {
            let MotionCommand::Cycle(mut cycle) = program.run(line).motion else { panic!("{line}") };
            let mut lowest = [f64::MAX; 3];
            while let Some(step) = cycle.step(Coordinate(0)) {
                if let CycleStep::Feed(place, _) = step {
                    lowest = in_mm(&place);
                }
            }
            lowest
        };
        assert_eq!(levels(&mut program, "G92.2 G81 X2 Y0 Z-1 R1"), [2.0, 0.0, -1.0]);
        assert_eq!(levels(&mut program, "G92.3 G81 X2 Y0 Z9 R11"), [-8.0, 0.0, -1.0]);
        assert_eq!(levels(&mut program, "G92.1 G81 X2 Y0 Z-2 R1"), [2.0, 0.0, -2.0]);
    }
}

#[test]
fn g52_and_g92_are_one_offset() {
    play(&[
        ("G52 X10", [1.0, 2.0, 3.0]),
        ("G0 X11", [21.0, 2.0, 3.0]),
        ("G92 Y5", [21.0, 2.0, 3.0]),
        ("X1 Y1", [11.0, -2.0, 3.0]),
        // G52 sets only the named axes. The value is absolute even with G91.
        ("G91 G52 X1", [11.0, -2.0, 3.0]),
        ("G90 X1 Y1", [2.0, -2.0, 3.0]),
        ("G92.1", [2.0, -2.0, 3.0]),
        ("X0 Y0", [0.0, 0.0, 3.0]),
        ("G52 Z1", [0.0, 0.0, 3.0]),
        ("G92.2", [0.0, 0.0, 3.0]),
        ("Z0", [0.0, 0.0, 0.0]),
        ("G92.3", [0.0, 0.0, 0.0]),
        ("Z0", [0.0, 0.0, 1.0]),
    ]);
}

#[test]
fn a_reset_forgets_what_g92_3_would_restore() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run_all("G92 X10\nG92.2\nM70");
        program.interpreter.reset();
        program.run_all("G92.3\nG0 X0");
        assert_eq!(program.machine(), [0.0, 2.0, 3.0]);
        assert_eq!(program.error("M72"), 123);
    }
}

#[test]
fn g28_in_two_stages() {
    play(&[
        ("G28.1", [1.0, 2.0, 3.0]),
        ("G0 X10 Y10 Z10", [10.0, 10.0, 10.0]),
        ("G28 X5", [1.0, 10.0, 10.0]),
        ("G91 G28 Z0", [1.0, 10.0, 3.0]),
        ("G28 X1 Y1", [1.0, 2.0, 3.0]),
        ("G0 X1", [2.0, 2.0, 3.0]),
        ("G90 G28", [1.0, 2.0, 3.0]),
    ]);
}

#[test]
fn full_circles_need_no_axis_word() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, i, j, z) in
            [("G2 I5", 5, 0, 3.0), ("I3", 3, 0, 3.0), ("G2 Z1 I5", 5, 0, 1.0), ("G3 X1 J2", 0, 2, 1.0)]
        {
            let MotionCommand::Arc(arc) = program.run(line).motion else { panic!("{line}") };
            assert_eq!((arc.i.0, arc.j.0), (i * 10_000_000, j * 10_000_000), "{line}");
            assert_eq!(program.machine(), [1.0, 2.0, z], "{line}");
        }
        let MotionCommand::Arc(arc) = program.run("G18 I5").motion else { panic!() };
        assert_eq!((arc.i.0, arc.j.0), (0, 50_000_000));
        for (line, code) in [("G2", 26), ("G2 R5", 26), ("R5", 36), ("G17 G2 Z5 R5", 32), ("G0 I5", 36)] {
            assert_eq!(program.error(line), code, "{line}");
        }
    }
    let mut program = ready(Dialect::Grbl);
    assert_eq!((program.error("G2 I5"), program.error("G2 Z1 I5")), (26, 32));
    program.run("G2 X1 I5");
    assert_eq!(program.error("I5"), 36);
}

#[test]
fn state_is_kept_and_restored() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G43.1 Z1 M3 S100");
        program.run("M70");
        let before = *program.interpreter.modal();
        program.run_all("G20 G91 G18 G55 G93 G99 G49 M4 S5 M8 M49 T7 G61.1\nG1 X1 F5");
        let restored = program.run("M72");
        assert_eq!(restored.spindle, Some(SpindleDirection::Clockwise));
        assert!(restored.coolant.is_some() && restored.speed_changed && restored.work_offset_changed);
        let after = *program.interpreter.modal();
        // M72 does not restore the motion word and the tool.
        assert_eq!((after.motion.word(), after.tool), ("G1", 7));
        assert!(
            oxmill_controller::gcode::Modal { motion: before.motion, straight: before.straight, tool: 0, ..after }
                == before
        );
        program.run("G0 Z0");
        assert_eq!(program.machine()[2], 1.0);
        program.run_all("N5 M72\nM71");
        assert_eq!(program.error("M72"), 123);
        for line in ["M70 G0", "M72 X1", "M70 M72", "M71 S5"] {
            assert_eq!(program.error(line), 21, "{line}");
        }
    }
}

#[test]
fn overrides_are_held_off() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, feed, spindle) in [
            ("M49", true, true),
            ("M48", false, false),
            ("M50 P0", true, false),
            ("M51 P0", true, true),
            ("M50", false, true),
            ("M51 P1", false, false),
            ("M52 P0", false, false),
            ("M53", false, false),
            ("M49", true, true),
            ("M2", false, false),
        ] {
            program.run(line);
            let held = program.interpreter.modal().overrides_held;
            assert_eq!((held.feed, held.spindle), (feed, spindle), "{line}");
        }
        for (line, code) in
            [("M50 P2", 39), ("M50 P0.5", 39), ("M52", 121), ("M53 P0", 121), ("M48 P1", 36), ("M48 M50", 21)]
        {
            assert_eq!(program.error(line), code, "{line}");
        }
    }
}

#[test]
fn path_control() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, path) in [
            ("G61.1", PathControl::ExactStop),
            ("G64 P0 Q0.2", PathControl::ExactPath),
            ("G64 Q0.2", PathControl::ExactPath),
            ("G61.1 G0 X1", PathControl::ExactStop),
            ("G61", PathControl::ExactPath),
            ("G64", PathControl::ExactPath),
        ] {
            program.run(line);
            assert_eq!(program.interpreter.modal().path, path, "{line}");
        }
        assert_eq!((program.error("G61 P1"), program.error("G61 G64"), program.error("G64 P-1")), (36, 21, 4));
    }
}

#[test]
fn words_that_say_what_is_so() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for line in ["G50 G69 G97", "G0 G49 G40 G17 G80 G50 G90", "O1000", "N10 O7", "M60", "M6"] {
            assert_eq!(program.run(line).motion, MotionCommand::None, "{line}");
        }
        assert_eq!((program.run("M60").flow, program.run("M1").flow), (Flow::Pause, Flow::OptionalPause));
        for line in ["O1000 G0", "O1000 X1", "O1000 S500 T3", "O1000 F1", "O1000 T1", "O1000 R1", "O1000 N1 S1"] {
            assert_eq!(program.error(line), 36, "{line}");
        }
        // Without the feature `full`, a line with a parameter is refused with another error.
        let code = if cfg!(feature = "full") { 36 } else { 201 };
        assert_eq!((program.error("O1000 #1=5"), program.error("N10 #1=5 O7")), (code, code));
    }
}

#[test]
fn errors_of_their_own() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for word in [
            "G7", "G16", "G33", "G33.1", "G51.1", "G74", "G76", "G84", "G87", "G96", "M19", "M98", "M99", "M97", "G65",
            "G66",
        ] {
            let line = format!("{word} X1 Z-1 R1 Q1 P1 F100 S1");
            assert_eq!(program.error(&line), 121, "{word}");
        }
        // G8 with P switches the look-ahead. Without P, as here, G8 is refused.
        assert_eq!(program.error("G8 X1 F100"), 121);
        // G31 is a probing move, which does not use R.
        let code = if cfg!(feature = "full") { 36 } else { 121 };
        assert_eq!(program.error("G31 X1 Z-1 R1 F100"), code);
        for word in ["G41", "G41.1", "G42", "G42.1"] {
            assert_eq!(program.error(&format!("{word} D1 X1")), 122, "{word}");
        }
        for word in ["G39", "G100", "M31", "M100"] {
            assert_eq!(program.error(word), 20, "{word}");
        }
        program.run("G1 X1");
        assert_eq!(program.machine(), [1.0, 2.0, 3.0]);
    }
}

/// M72 puts the offset of G92 in or out of force, as it was at M70. M72 does not restore the values of the offset.
#[test]
fn g92_and_m72() {
    play(&[
        ("M70", [1.0, 2.0, 3.0]),
        ("G92 X10", [1.0, 2.0, 3.0]),
        ("M72", [1.0, 2.0, 3.0]),
        ("X0", [0.0, 2.0, 3.0]),
        ("G92.3", [0.0, 2.0, 3.0]),
        ("X0", [-9.0, 2.0, 3.0]),
        ("M70", [-9.0, 2.0, 3.0]),
        ("G92.2", [-9.0, 2.0, 3.0]),
        ("M72", [-9.0, 2.0, 3.0]),
        ("X1", [-8.0, 2.0, 3.0]),
        ("G92 X11", [-8.0, 2.0, 3.0]),
        ("M72", [-8.0, 2.0, 3.0]),
        ("X11", [-8.0, 2.0, 3.0]),
    ]);
}

/// P and Q of G64 are lengths in the unit of the line. If Q is missing, it gets the value of P, as in LinuxCNC.
#[cfg(feature = "full")]
#[test]
fn path_tolerances() {
    let within = |path, merging| PathControl::Within(oxmill_controller::gcode::PathTolerance { path, merging });
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, path) in [
            ("G64 P0.1 Q0.2", within(1_000_000, 2_000_000)),
            ("G64 P0.05", within(500_000, 500_000)),
            ("G64 P0.05 Q0", within(500_000, 0)),
            ("G20 G64 P0.01", within(2_540_000, 2_540_000)),
            ("M70", within(2_540_000, 2_540_000)),
            ("G61", PathControl::ExactPath),
            ("M72", within(2_540_000, 2_540_000)),
            ("G21 G64 P1000", within(u32::MAX, u32::MAX)),
            ("G1 X1 F100", within(u32::MAX, u32::MAX)),
            ("G64", PathControl::ExactPath),
        ] {
            program.run(line);
            assert_eq!(program.interpreter.modal().path, path, "{line}");
        }
        let errors = ["G64 P-1", "G64 P1 Q-1", "G1 X1 P1", "G61 Q1"].map(|line| program.error(line));
        assert_eq!(errors, [4, 4, 36, 36]);
    }
}

/// Grbl's dialect refuses these words, as Grbl does.
#[test]
fn grbl_knows_none_of_them() {
    let program = ready(Dialect::Grbl);
    for line in [
        "G52 X1",
        "G92.2",
        "G92.3",
        "G61.1",
        "G64",
        "G64 P0.1",
        "G50",
        "G68 X0 R1",
        "G69",
        "G97",
        "G41",
        "G42",
        "G51 X1 P2",
        "G5 X1 I1 J1",
        "G5.1 X1 I1 J1",
        "G33",
        "M48",
        "M49",
        "M50",
        "M60",
        "M70",
        "M71",
        "M72",
        "M73",
        "O1000",
    ] {
        assert_eq!(program.error(line), 20, "{line}");
    }
}

/// `is_plain` is true while no line has left an offset, a saved state, a rotation, a scaling or a parameter. A
/// recording that can be replayed begins in such a state.
#[test]
fn a_state_is_plain_while_no_line_has_left_anything_behind() {
    let lines: &[(bool, &str, &str)] = &[
        (true, "G92 X1", "G92.1"),
        (true, "G43.1 Z2", "G49"),
        (true, "T3", "M6"),
        (true, "M70", ""),
        (cfg!(feature = "full"), "G68 X0 Y0 R30", "G69"),
        (cfg!(feature = "full"), "G51 X0 Y0 P2", "G50"),
        (cfg!(feature = "full"), "#1=5", ""),
    ];
    for (_, left, ended) in lines.iter().filter(|(known, ..)| *known) {
        let mut program = Program::new(Dialect::Oxmill);
        let is_plain = |program: &Program| program.interpreter.is_plain(program.interpreter.position());
        assert!(is_plain(&program));
        program.run(left);
        assert!(!is_plain(&program), "{left}");
        if !ended.is_empty() {
            program.run(ended);
            assert!(is_plain(&program), "{left} {ended}");
        }
    }
    let mut program = Program::new(Dialect::Oxmill);
    let start = *program.interpreter.position();
    program.run("G0 X1");
    assert!(!program.interpreter.is_plain(&start));
}
