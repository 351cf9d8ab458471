//! Tests of error numbers, and of the choice between two errors in a line. Also tests motions that are missing from the
//! recordings of Grbl, and words that Grbl does not have.

use crate::program::{DIALECTS, Program, target};
use oxmill_controller::gcode::{Action, Dialect, Feed, Flow, Interpreter, MotionCommand};
use oxmill_controller::messages::{Coolant, SpindleDirection};

/// Error numbers, each with lines that cause it in every dialect. Each line comes after `F100`, in the XY plane, in
/// motion mode G0, at the position (0,0,0).
const ERRORS: &[(u8, &[&str])] = &[
    (1, &["1", "%", "G1 X1..2", "X1*2", "!", "X1,5", "g0"]),
    (2, &["X", "G", "M", "X.", "X-", "X+", "G1 XY"]),
    (4, &["F-1", "N-1", "P-1", "S-1", "T-1", "F-0.0000001"]),
    (20, &["G6", "G38", "G38.6", "G90.2", "M100", "B1", "A1"]),
    (20, &["G-1", "G999", "G10 L3 P1 X1", "G10 P1 X1", "G10 L-2 X0", "G10 L258 P1 X0"]),
    (21, &["G17 G18", "G20 G21", "G80 G80", "M3 M4", "M0 M2", "M8 M9", "G53 G4 P1", "G4 P1 G92 X1"]),
    (22, &["G1 F0", "G1 F0 X1", "G93 G1 X1", "G93 G2 X2 I1", "G93 G38.2 X1", "G2 F0 I1"]),
    (23, &["G1.5", "G17.1", "M3.5", "G10.1"]),
    (24, &["G0 G1", "G0 G0", "G28 G30", "G92 X1 G1", "G0 G43.1 Z1", "G0 G1.5", "G0 G38.9", "G43.1 Z1 G10"]),
    (25, &["X1 X1", "F1 F1", "T1 T1", "T1 T-1", "R1 R1", "K1 K1", "N1 N1", "L1 L1"]),
    (26, &["G2", "G38.2", "G10", "G10 L2 P1", "G92"]),
    (27, &["N10000001", "N99999999999999999999", "N10000001 G4"]),
    (28, &["G4", "G4 X1", "G10 X0"]),
    (29, &["G10 L2 P10 X0", "G10 L20 P99999999999999999999 X0"]),
    (30, &["G53 G2 X2 I1", "G53 G80", "G53 G80 X1", "G53 G38.2 X1"]),
    (31, &["G80 X1", "G80 G92.1 X1", "G80 G28.1 X1"]),
    (32, &["G2 Z1 R1", "G18 G2 Y1 R1", "G19 G2 X1 R1"]),
    (33, &["G2 X0 Y0 R1", "G2 Z1 X0 R1", "G38.2 X0", "G0 X-50000.001"]),
    (33, &["X99999999999999999999999", "G28 X60000", "G20 X-3000", "G2 X1 I99999999999", "G2 X1 R99999999999"]),
    (34, &["G2 X10 R1", "G2 X10 R0", "G2 X10 R4.98", "G2 X10.001 R4.998"]),
    (35, &["G2 X1", "G2 X1 K1", "G19 G2 Y1 I1"]),
    (36, &["I1", "L1", "P1", "R1", "G0 X1 P1", "G2 X2 I1 R1", "M3 P1", "G4 P1 L1", "G10 L20 P1 X1 R1"]),
    (37, &["G43.1"]),
    (38, &["T100000", "T99999999999999999999", "T100000 T1"]),
];

/// Errors of Grbl's dialect only. In the other dialects these lines are correct or have another error.
const ERRORS_OF_GRBL: &[(u8, &[&str])] = &[
    (20, &["G43", "G43.2 H0", "G81", "G98", "M6", "X1 Q1", "X1 H1", "G5", "M99", "G10 L2 P1 R1 X1"]),
    (20, &["D1", "U1", "V1", "W1", "G12", "G13", "G31", "G65", "G66", "M97"]),
    (23, &["M-1", "M256", "M600", "M99999", "G256", "G54.1", "G59.4", "G-0.5"]),
    (26, &["G2 I1"]),
    (29, &["G10 L3 P10 X0"]),
    (32, &["G2 Z1 I1", "G18 G2 Y1 I1", "G19 G2 X1 J1"]),
    (37, &["G43.1 X1", "G43.1 X1 Z1"]),
    (38, &["T256", "T255.5", "T256 T256", "T300 T-1"]),
];

fn ready(dialect: Dialect) -> Program {
    let mut program = Program::new(dialect);
    program.run("F100");
    program
}

/// The radii at the start and the end of an arc may differ by 0.1 % of the radius. A difference of 0.005 mm is always
/// allowed, and one of more than 0.5 mm never. In the dialect `seed` any difference is allowed.
#[test]
fn an_arc_may_end_at_another_radius_within_limits() {
    for dialect in [Dialect::Grbl, Dialect::Oxmill] {
        let program = ready(dialect);
        for line in ["G2 X2.0049 I1", "G2 X20.009 I10", "G2 X800.39 I400", "G2 X2000.49 I1000"] {
            assert_eq!(program.error(line), 0, "{line} in {dialect:?}");
        }
        for line in ["G2 X2.0051 I1", "G2 X20.011 I10", "G2 X800.41 I400", "G2 X2000.51 I1000"] {
            assert_eq!(program.error(line), 33, "{line} in {dialect:?}");
        }
    }
}

#[test]
fn every_error() {
    for dialect in DIALECTS {
        let program = ready(dialect);
        for (code, lines) in ERRORS {
            for line in lines.iter() {
                assert_eq!(program.error(line), *code, "{line} in {dialect:?}");
            }
        }
        // With the feature `full`, values are expressions (except in Grbl's dialect), so two signs are allowed.
        let is_plain = dialect == Dialect::Grbl || cfg!(not(feature = "full"));
        assert_eq!(program.error("G0 X--1") == 2, is_plain, "{dialect:?}");
        for (code, lines) in ERRORS_OF_GRBL {
            for line in lines.iter() {
                let same = program.error(line) == *code;
                // D is one of the words that CAM programs write out of habit. Without the feature `full`, D is refused
                // as in Grbl's dialect.
                let is_left_out = line.starts_with('D') && cfg!(not(feature = "full"));
                assert_eq!(same, dialect == Dialect::Grbl || is_left_out, "{line} in {dialect:?}");
            }
        }
    }
}

/// Of two errors in a line, the one that Grbl checks first is reported.
#[test]
fn order_of_checks() {
    for dialect in DIALECTS {
        let program = ready(dialect);
        let ladder: &[(&str, u8)] = &[
            // Errors of the words come first, in the order of the words in the line.
            ("X1 G6 2", 20),
            ("X1 * G6", 1),
            ("G0 G1 G6", 24),
            ("M3.5 M100", 23),
            ("T100000 T-1", 38),
            // After them come errors of the line number, the feed with G93, the dwell, the tool length, G10, G53, G80,
            // the feed, the arc, and unused words, in this order.
            ("N99999999 G93 G1 X1 P1", 27),
            ("G93 G1 X1 G4", 22),
            ("G4 G1 F0 X1", 28),
            ("G43.1 P1", 37),
            ("G10 P99", 26),
            ("G10 L2 P99 X1 I1", 29),
            ("G53 G2 F0 X1 P1", 30),
            ("G80 X1 P1", 31),
            ("G2 F0", 22),
            ("G2 Z1 R1 P1 L1", 32),
            ("G2 X10 R1 L1", 34),
            ("G2 X2 I1 L1", 36),
        ];
        for (line, code) in ladder {
            assert_eq!(program.error(line), *code, "{line} in {dialect:?}");
        }
    }
}

/// While G80 is in force, axis words are allowed if a command of the line uses them (such as G28 or G92). Grbl's
/// dialect refuses them.
#[test]
fn axis_words_of_other_commands_under_g80() {
    for line in ["G28 Z0", "G30 X1", "G92 X1", "G10 L2 P1 X1", "G43.1 Z1", "G80 G28 Z0"] {
        for dialect in DIALECTS {
            let mut program = ready(dialect);
            program.run("G80");
            assert_eq!(program.error(line), if dialect == Dialect::Grbl { 31 } else { 0 }, "{line} in {dialect:?}");
        }
    }
}

/// CAM programs round each word to a resolution, such as 0.001 mm. If rounding explains why the words of an arc do not
/// fit together, the arc is accepted.
#[test]
fn arcs_of_rounded_words() {
    let new = [Dialect::Oxmill, Dialect::Seed];
    for (line, error) in [
        ("G3 X4.9287 Y0 R2.4643", 0),
        ("G2 X7.071 Y7.072 R5", 0),
        ("G2 X10 R4.9999", 0),
        ("G2 X10 R4.99", 0),
        ("G2 X10 R4.98", 34),
        ("G2 X10.002 R5", 0),
        ("G2 X10.003 R5", 34),
        ("G2 X10.0003 R5", 34),
        ("G2 X10 R4.9985", 34),
        ("G20 G2 X1 R.499", 0),
        ("G20 G2 X1.0001 R.499", 34),
        ("G20 G2 X1 R.4999", 0),
    ] {
        for dialect in new {
            assert_eq!(ready(dialect).error(line), error, "{line} in {dialect:?}");
        }
    }
    // The radius of the half circle becomes half of the distance between its ends.
    let MotionCommand::Arc(arc) = ready(Dialect::Oxmill).run("G3 X4.9287 R2.4643").motion else { panic!() };
    assert_eq!((arc.i.0, arc.j.0), (24_643_500, 0));
    #[cfg(feature = "full")]
    for factor in ["100", "0.01"] {
        let mut program = ready(Dialect::Oxmill);
        program.run(&format!("G51 X0 Y0 Z0 P{factor}"));
        assert_eq!(["G2 X10.002 R5", "G2 X10.003 R5"].map(|line| program.error(line)), [0, 34], "{factor}");
    }
    for (line, error) in [
        // With at most two decimals, a unit of the last decimal is 0.01 mm. The radii at the start and the end may
        // differ by 2.8 such units (0.028 mm).
        ("G2 X5.02 I2.5", 0),
        ("G2 X5.02 I2.50", 0),
        ("G2 X5.03 I2.5", 33),
        ("G2 X5.012 I2.5", 33),
        ("G2 X5.0049 I2.5", 0),
        ("G2 X5.012 Y0 I2.500 J0", 33),
        ("G20 G2 X.202 I.1", 0),
        ("G20 G2 X.203 I.1", 33),
        ("G20 G2 X.2002 I.1", 0),
        ("G20 G2 X.2003 I.1", 33),
        ("G90.1 G2 X5.02 Y0 I2.5 J0", 0),
        ("G18 G2 Z5.02 K2.5", 0),
    ] {
        assert_eq!(ready(Dialect::Oxmill).error(line), error, "{line}");
    }
    // In the dialect `seed` an arc ends on the circle, even if the program's end point is off the circle. Grbl's
    // dialect rejects this arc, and also the half circle with R that Oxmill's dialect accepts above.
    let MotionCommand::Arc(arc) = ready(Dialect::Seed).run("G2 X5.02 I2.5").motion else { panic!() };
    assert_eq!(arc.target.0[0].0, 50_000_000);
    let grbl = ready(Dialect::Grbl);
    assert_eq!(["G3 X4.9287 Y0 R2.4643", "G2 X5.02 I2.5"].map(|line| grbl.error(line)), [34, 33]);
}

/// Grbl keeps only the lowest byte of these numbers. For example, it reads G256 as G0 with a fraction, which is
/// another error. The other dialects refuse the numbers as unknown.
#[test]
fn numbers_that_no_word_has() {
    for dialect in DIALECTS.into_iter().filter(|dialect| *dialect != Dialect::Grbl) {
        let program = ready(dialect);
        for line in ["G10000", "G256", "G999", "G-1", "G-0.5", "M600", "M256", "M-1", "M99999", "M1000"] {
            assert_eq!(program.error(line), 20, "{line} in {dialect:?}");
        }
        for line in ["G54.3 P1", "G59.4", "G54.4"] {
            assert_eq!(program.error(line), 29, "{line} in {dialect:?}");
        }
        for line in ["U1", "G0 V1", "G1 X1 W-2"] {
            assert_eq!(program.error(line), 149, "{line} in {dialect:?}");
        }
        for line in ["G65 P1", "G66", "M97 P10"] {
            assert_eq!(program.error(line), 121, "{line} in {dialect:?}");
        }
        let full = cfg!(feature = "full");
        let code = |of_full: u8| if full { of_full } else { 121 };
        assert_eq!([program.error("G12 I5"), program.error("G13")], [if full { 0 } else { 121 }, code(28)]);
    }
}

#[test]
fn tool_number_is_kept() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        program.run("T7");
        assert_eq!(program.interpreter.modal().tool, 7);
        program.run("X1");
        assert_eq!(program.interpreter.modal().tool, if dialect == Dialect::Grbl { 0 } else { 7 });
    }
}

#[test]
fn words_of_oxmill() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        if dialect == Dialect::Grbl {
            assert_eq!((program.error("M7"), program.error("M56"), program.error("G2 X2 I1 P1")), (20, 20, 36));
            continue;
        }
        let mist = Coolant { mist: true, flood: false };
        assert_eq!(program.run("M7").coolant, Some(mist));
        assert_eq!(program.run("M7").coolant, None);
        assert_eq!(program.run("M8").coolant, Some(Coolant { mist: true, flood: true }));
        assert_eq!(program.run("M9").coolant, Some(Coolant::default()));
        for (line, held_off) in
            [("G0", false), ("M56 P0", true), ("G0", true), ("M56", false), ("M56 P0", true), ("M56 P1", false)]
        {
            program.run(line);
            assert_eq!(program.interpreter.modal().no_parking, held_off, "{line}");
        }
        assert_eq!(program.error("M56 G4 P1"), 28);
    }
}

fn turns(checked: &Action<3>) -> u32 {
    match checked.motion {
        MotionCommand::Arc(arc) => arc.turns,
        _ => panic!("no arc"),
    }
}

#[test]
fn turns_of_arcs() {
    for dialect in [Dialect::Oxmill, Dialect::Seed] {
        let program = ready(dialect);
        assert_eq!(turns(&program.check("G2 X2 I1").unwrap()), 0);
        assert_eq!(turns(&program.check("G2 X2 I1 P1").unwrap()), 0);
        assert_eq!(turns(&program.check("G3 X0 I1 Z-5 P5").unwrap()), 4);
        assert_eq!(turns(&program.check("G3 X2 R1 P2").unwrap()), 1);
        for p in ["P0", "P1.5", "P0.5", "P99999999999999999999", "P1000001"] {
            assert_eq!(program.error(&format!("G2 X2 I1 {p}")), 23, "{p}");
        }
    }
}

/// The direction of an arc is seen from the positive end of the axis outside of its plane. So in G18, G3 turns from Z
/// towards X.
#[test]
fn planes() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        for (line, i, j) in
            [("G17 G2 X10 Y10 R10", 10, 0), ("G18 G2 Z10 X10 R10", 10, 0), ("G19 G2 Y10 Z10 R10", 10, 0)]
        {
            let MotionCommand::Arc(arc) = program.check(line).unwrap().motion else { panic!("{line}") };
            assert_eq!((arc.i.0, arc.j.0), (i * 10_000_000, j * 10_000_000), "{line}");
        }
        program.run("G18");
        let MotionCommand::Arc(arc) = program.check("G3 X0 Z0 Y3 I1 K2").unwrap().motion else { panic!() };
        assert_eq!((arc.i.0, arc.j.0, arc.clockwise), (20_000_000, 10_000_000, false));
    }
}

/// If the centre is at the start, the arc has no radius: X and Y stay, and only the axis outside of the plane moves.
#[test]
fn arc_without_radius() {
    for dialect in DIALECTS {
        let checked = ready(dialect).check("G2 X0 Y0 Z5 I0 J0").unwrap();
        let MotionCommand::Line { via: None, feed: Feed::PerMinute(_), .. } = checked.motion else { panic!() };
        assert_eq!(target(&checked), [0.0, 0.0, 5.0]);
    }
}

#[test]
fn probing_moves() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        for (word, away, alarm) in
            [("G38.2", false, true), ("G38.3", false, false), ("G38.4", true, true), ("G38.5", true, false)]
        {
            let checked = program.check(&format!("{word} Z-5")).unwrap();
            match checked.motion {
                MotionCommand::Probe { away: a, alarm: b, .. } => assert_eq!((a, b), (away, alarm), "{word}"),
                _ => panic!("{word}"),
            }
            assert_eq!(target(&checked), [0.0, 0.0, -5.0]);
        }
        // If the probe stops on the way, the program continues from where it stopped.
        program.run("G38.2 Z-5");
        let mut stopped = *program.interpreter.position();
        stopped.0[2].0 = -12_345_678;
        program.interpreter.set_position(stopped);
        assert_eq!(target(&program.run("G91 G0 Z1")), [0.0, 0.0, -0.234_567_8]);
    }
}

#[test]
fn end_of_program() {
    for dialect in DIALECTS {
        for word in ["M2", "M30"] {
            let mut program = ready(dialect);
            program.run("G20 G91 G55 G18 M3 S5 M8 F2 T3 G92 X1");
            let end = program.run(&format!("G0 X1 {word}"));
            // The spindle still turns during the motion of the line; `flow` marks the end of the program.
            assert_eq!((end.flow, end.spindle, end.coolant), (Flow::End, None, None));
            assert_eq!(end.modal().spindle, SpindleDirection::Off);
            assert!(end.work_offset_changed);
            let modal = program.interpreter.modal();
            let words = [modal.motion.word(), modal.plane.word(), modal.units.word(), modal.distance.word()];
            assert_eq!(words, ["G1", "G17", "G20", "G90"]);
            assert_eq!((modal.coordinate_system.word(), modal.speed, modal.feed.0), ("G54", 5.0, 508_000_000));
        }
    }
}

#[test]
fn feed_after_the_end_of_a_program() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        program.run("G93 G1 X1 F5 M2");
        assert_eq!(program.error("X2"), 22);
    }
}

#[test]
fn jogs_leave_the_state_alone() {
    for dialect in DIALECTS {
        let mut program = ready(dialect);
        program.run_all("G91\nG20\nT4\nG10 L2 P1 X1\nG92 Y1\nG80");
        let before = program.interpreter.clone();
        // A jog is a straight line even under G80. It uses the program's units and distance mode unless it has words
        // for them.
        let jog = before.check_jog(b"X1F60N7", program.dialect).unwrap();
        assert_eq!(target(&jog), [25.4, 0.0, 0.0]);
        let MotionCommand::Line { feed: Feed::PerMinute(feed), .. } = jog.motion else { panic!() };
        assert_eq!((feed, jog.line_number), (25.4, 7));
        let absolute = before.check_jog(b"G21G90G53X2F60", program.dialect).unwrap();
        assert_eq!(target(&absolute), [2.0, 0.0, 0.0]);
        program.interpreter.commit(&absolute);
        assert_eq!(program.machine(), [2.0, 0.0, 0.0]);
        program.interpreter.set_position(*before.position());
        assert!(program.interpreter == before);
        let nothing = before.check_jog(b"F100", program.dialect).unwrap();
        assert_eq!((nothing.motion, nothing.position()), (MotionCommand::None, before.position()));
        for (jog, code) in [("", 22), ("X1", 22), ("X1F0", 22), ("G0X1F1", 16), ("M3X1F1", 16), ("X1F1S1", 36)] {
            assert_eq!(before.check_jog(jog.as_bytes(), program.dialect).unwrap_err().code(), code, "{jog}");
        }
    }
}

/// Words of the rotary axis A are in degrees, with G20 as with G21. A belongs to no plane: during an arc it only turns
/// along.
#[test]
fn four_axes() {
    for dialect in DIALECTS {
        let mut interpreter = Interpreter::<4>::default();
        for line in ["G20F10", "G10L2P1X1A10", "G0X1A90"] {
            let checked = interpreter.check(line.as_bytes(), dialect).unwrap();
            interpreter.commit(&checked);
        }
        assert_eq!(interpreter.position().0.map(|place| place.0), [508_000_000, 0, 0, 1_000_000_000]);
        let helix = interpreter.check(b"G2X1Y0I1A0", dialect).unwrap();
        let MotionCommand::Arc(arc) = helix.motion else { panic!() };
        assert_eq!(arc.target.0.map(|place| place.0), [508_000_000, 0, 0, 100_000_000]);
        assert_eq!(interpreter.check(b"B1", dialect).unwrap_err().code(), 150);
        let grbl = dialect == Dialect::Grbl;
        assert_eq!(interpreter.check(b"G43.1Z1A1", dialect).map_err(|error| error.code()).err(), grbl.then_some(37));
    }
}
