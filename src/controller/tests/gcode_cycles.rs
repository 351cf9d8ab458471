//! Compares the moves of each canned cycle with a list that was written by hand from RS274NGC, the NIST standard of
//! G-code.
//!
//! In a list, `r 2 1 10` is a rapid to X2 Y1 Z10, and `f 2 1 -1` a feed move to X2 Y1 Z-1 (machine coordinates, mm).
//! Moves of no length are left out.

use crate::program::{Program, in_mm};
use oxmill_controller::gcode::{Action, CycleStep, Dialect, MotionCommand};
use oxmill_controller::units::Coordinate;

/// Height above the bottom of a peck at which the next peck begins to feed: the default of `$921`, 0.01 inch (0.254
/// mm).
const CLEARANCE: Coordinate = Coordinate(2_540_000);
const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Returns the steps of the canned cycle in a checked line. `before`: machine position at the start of the line, mm.
fn steps_of(checked: &Action<3>, mut before: [f64; 3]) -> Vec<String> {
    let MotionCommand::Cycle(mut cycle) = checked.motion else { panic!("no cycle") };
    let mut list = Vec::new();
    while let Some(step) = cycle.step(CLEARANCE) {
        let (letter, place) = match step {
            CycleStep::Rapid(place) => ("r", in_mm(&place)),
            CycleStep::Feed(place, _) => ("f", in_mm(&place)),
            CycleStep::Dwell(time) => {
                list.push(format!("dwell {}", time.to_micros() as f64 / 1e6));
                continue;
            }
            CycleStep::SpindleOff => {
                list.push("stop".into());
                continue;
            }
            CycleStep::Pause => {
                list.push("pause".into());
                continue;
            }
            CycleStep::SpindleOn(_) => {
                list.push("turn".into());
                continue;
            }
        };
        if place != before {
            list.push(format!("{letter} {} {} {}", place[0], place[1], place[2]));
            before = place;
        }
    }
    assert_eq!(in_mm(checked.position()), before, "the position after the line");
    list
}

/// Runs a line and compares its steps with `expected`, a list with commas between the steps.
fn expect(program: &mut Program, line: &str, expected: &str) {
    let before = program.machine();
    let checked = program.run(line);
    let expected: Vec<&str> = expected.split(',').map(str::trim).collect();
    assert_eq!(steps_of(&checked, before), expected, "{line}");
}

/// Returns a program at X1 Y1 Z10 with the spindle on.
fn ready(dialect: Dialect) -> Program {
    let mut program = Program::new(dialect);
    program.run_all("G21 G90 G98 F300\nM3 S100\nG0 X1 Y1 Z10");
    program
}

/// Runs the lines one after the other, in both dialects that have cycles. Each line comes with its expected steps; an
/// empty text means that they are not compared.
fn play(lines: &[(&str, &str)]) {
    for dialect in NEW {
        let mut program = ready(dialect);
        for (line, expected) in lines {
            match *expected {
                "" => {
                    program.run(line);
                }
                expected => expect(&mut program, line, expected),
            }
        }
    }
}

#[test]
fn g81_drills_and_sticks() {
    play(&[
        ("G81 X2 Z-1 R2", "r 2 1 10, r 2 1 2, f 2 1 -1, r 2 1 10"),
        ("Y3", "r 2 3 10, r 2 3 2, f 2 3 -1, r 2 3 10"),
        ("X4 R3 Z-2", "r 4 3 10, r 4 3 3, f 4 3 -2, r 4 3 10"),
        ("Z-3", "r 4 3 3, f 4 3 -3, r 4 3 10"),
        ("G81 X5", "r 5 3 10, r 5 3 3, f 5 3 -3, r 5 3 10"),
    ]);
}

#[test]
fn g82_dwells_at_the_bottom() {
    play(&[
        ("G82 X2 Z-1 R2 P0.5", "r 2 1 10, r 2 1 2, f 2 1 -1, dwell 0.5, r 2 1 10"),
        ("X3", "r 3 1 10, r 3 1 2, f 3 1 -1, dwell 0.5, r 3 1 10"),
        ("X4 P0", "r 4 1 10, r 4 1 2, f 4 1 -1, dwell 0, r 4 1 10"),
    ]);
}

#[test]
fn g83_leaves_the_hole_after_each_peck() {
    play(&[
        (
            "G83 X2 Y3 Z-5 R2 Q3",
            "r 2 3 10, r 2 3 2, f 2 3 -1, r 2 3 2, r 2 3 -0.746, f 2 3 -4, r 2 3 2, r 2 3 -3.746, f 2 3 -5, r 2 3 10",
        ),
        // The last peck has the full depth Q.
        ("X5 Z-4", "r 5 3 10, r 5 3 2, f 5 3 -1, r 5 3 2, r 5 3 -0.746, f 5 3 -4, r 5 3 10"),
        // Q is deeper than the hole, so there is one peck.
        ("X6 Q7", "r 6 3 10, r 6 3 2, f 6 3 -4, r 6 3 10"),
        // Q (0.2 mm) is less than the clearance (0.254 mm). The first peck ends at Z1.8, and 1.8 + 0.254 is above R.
        // So the second peck feeds from R.
        (
            "G99 X7 Z1.5 R2 Q0.2",
            "r 7 3 10, r 7 3 2, f 7 3 1.8, r 7 3 2, f 7 3 1.6, r 7 3 2, r 7 3 1.854, f 7 3 1.5, r 7 3 2",
        ),
    ]);
}

#[test]
fn g73_backs_off_after_each_peck() {
    play(&[
        (
            "G73 X2 Y3 Z-5 R2 Q3",
            "r 2 3 10, r 2 3 2, f 2 3 -1, r 2 3 -0.746, f 2 3 -4, r 2 3 -3.746, f 2 3 -5, r 2 3 10",
        ),
        ("X3 Q10", "r 3 3 10, r 3 3 2, f 3 3 -5, r 3 3 10"),
    ]);
}

/// The tool retracts at the feed rate up to R, and by a rapid above R.
#[test]
fn g85_feeds_out_to_r() {
    play(&[
        ("G85 X4 Z-1 R2", "r 4 1 10, r 4 1 2, f 4 1 -1, f 4 1 2, r 4 1 10"),
        ("G99 X5", "r 5 1 10, r 5 1 2, f 5 1 -1, f 5 1 2"),
    ]);
}

#[test]
fn g86_draws_a_standing_spindle_back() {
    play(&[
        ("G86 X3 Z-1 R2 P.1", "r 3 1 10, r 3 1 2, f 3 1 -1, dwell 0.1, stop, r 3 1 10, turn"),
        ("X4", "r 4 1 10, r 4 1 2, f 4 1 -1, dwell 0.1, stop, r 4 1 10, turn"),
    ]);
}

#[test]
fn g88_pauses_at_the_bottom() {
    play(&[("G88 X6 Z-1 R2 P1", "r 6 1 10, r 6 1 2, f 6 1 -1, dwell 1, stop, pause, r 6 1 10, turn")]);
}

/// The tool retracts at the feed rate all the way to the clear level (the height to which G98 retracts), even above R.
#[test]
fn g89_feeds_out_all_the_way() {
    play(&[
        ("G89 X5 Z-1 R2 P1", "r 5 1 10, r 5 1 2, f 5 1 -1, dwell 1, f 5 1 10"),
        ("G99 X6", "r 6 1 10, r 6 1 2, f 6 1 -1, dwell 1, f 6 1 2"),
    ]);
}

#[test]
fn levels_of_g98_and_g99() {
    play(&[
        ("G99 G81 X2 Z-1 R2", "r 2 1 10, r 2 1 2, f 2 1 -1, r 2 1 2"),
        ("X3", "r 3 1 2, f 3 1 -1, r 3 1 2"),
        // G98 retracts to the clear level: the height at which this series of cycles began, here Z10. Another cycle
        // word does not end the series and does not change the clear level.
        ("G98 X4", "r 4 1 2, f 4 1 -1, r 4 1 10"),
        ("G99 G82 X5 Z-1 R3 P0", "r 5 1 10, r 5 1 3, f 5 1 -1, dwell 0, r 5 1 3"),
        ("G98 X6", "r 6 1 3, f 6 1 -1, dwell 0, r 6 1 10"),
        // Any other motion ends the series of cycles. The next cycle takes the new height as its clear level.
        ("G0 Z5", ""),
        ("G81 X7 Z-1 R2", "r 7 1 5, r 7 1 2, f 7 1 -1, r 7 1 5"),
        ("G80", ""),
        ("G0 Z6", ""),
        ("G81 X8 Z-1 R2", "r 8 1 6, r 8 1 2, f 8 1 -1, r 8 1 6"),
    ]);
}

/// The clear level (the height to which G98 retracts) is a height of the tool's tip, and so is R with G91. So with a
/// longer tool the machine retracts higher, and the tip clears the same obstacles.
#[test]
fn a_longer_tool_goes_back_to_a_higher_level() {
    play(&[
        ("G10 L1 P2 Z5", ""),
        ("G81 X2 Z-1 R2", "r 2 1 10, r 2 1 2, f 2 1 -1, r 2 1 10"),
        ("G43 H2", ""),
        ("X3", "r 3 1 10, r 3 1 7, f 3 1 4, r 3 1 15"),
        ("G49 G81 X4 Z-1 R2", "r 4 1 15, r 4 1 2, f 4 1 -1, r 4 1 10"),
        ("G91 G43 H2 G81 X1 Z-1 R-3", "r 4 1 12, r 5 1 12, f 5 1 11, r 5 1 15"),
        ("G49 X1", "r 6 1 15, r 6 1 7, f 6 1 6, r 6 1 10"),
        // A line that begins a series can also change the tool length. Then the clear level is the height of the
        // machine at the start of the line (here Z10); the new length does not raise it.
        ("G90 G0 Z10", ""),
        ("G43 H2 G81 X7 Z-1 R2", "r 7 1 10, r 7 1 7, f 7 1 4, r 7 1 10"),
    ]);
}

/// The end of a program (M2, M30) does not change G98 or G99. LinuxCNC does the same: its interpreter `rs274`, which
/// was fed line by line, makes the same moves before and after M2.
#[test]
fn the_end_of_a_program_leaves_the_retract_mode() {
    for end in ["M2", "M30"] {
        play(&[
            ("G99 G81 X2 Z-1 R2", "r 2 1 10, r 2 1 2, f 2 1 -1, r 2 1 2"),
            (end, ""),
            ("G0 Z8", ""),
            ("G81 X3 Z-1 R2 F300", "r 3 1 8, r 3 1 2, f 3 1 -1, r 3 1 2"),
            ("G98", ""),
            (end, ""),
            ("G0 Z8", ""),
            ("G81 X4 Z-1 R2 F300", "r 4 1 8, r 4 1 2, f 4 1 -1, r 4 1 8"),
        ]);
    }
}

#[test]
fn a_start_below_r_rises_first() {
    play(&[
        ("G0 Z-3", ""),
        ("G81 X5 Z-5 R1", "r 1 1 1, r 5 1 1, f 5 1 -5, r 5 1 1"),
        ("X8", "r 8 1 1, f 8 1 -5, r 8 1 1"),
    ]);
}

#[test]
fn a_hole_of_no_depth() {
    play(&[("G81 X2 Z2 R2", "r 2 1 10, r 2 1 2, r 2 1 10")]);
}

#[test]
fn incremental_words_and_repetitions() {
    play(&[
        (
            "G91 G81 X2 Y1 Z-3 R-2 L3",
            "r 3 2 10, r 3 2 8, f 3 2 5, r 3 2 10, r 5 3 10, r 5 3 8, f 5 3 5, r 5 3 10, r 7 4 10, r 7 4 8, f 7 4 5, r 7 4 10",
        ),
        // L is not modal.
        ("X1", "r 8 4 10, r 8 4 8, f 8 4 5, r 8 4 10"),
        // Z and R keep the numbers of the line with G91, here Z-3 and R-2. Under G90 these numbers are coordinates,
        // and no longer distances.
        ("G90 X9", "r 9 4 10, r 9 4 -2, f 9 4 -3, r 9 4 10"),
        ("X8 L2", "r 8 4 10, r 8 4 -2, f 8 4 -3, r 8 4 10, r 8 4 -2, f 8 4 -3, r 8 4 10"),
    ]);
    // With G99, repeated holes do not get deeper, because R counts from the height at which the series of cycles began.
    play(&[
        ("G99 G91 G81 X2 Z-3 R-2 L2", "r 3 1 10, r 3 1 8, f 3 1 5, r 3 1 8, r 5 1 8, f 5 1 5, r 5 1 8"),
        ("X1", "r 6 1 8, f 6 1 5, r 6 1 8"),
        ("G83 X1 Z-1 R-1 Q5", "r 6 1 9, r 7 1 9, f 7 1 8, r 7 1 9"),
    ]);
}

#[test]
fn other_planes() {
    play(&[
        ("G18 G81 X5 Z-1 Y-3 R1", "r 5 1 -1, f 5 -3 -1, r 5 1 -1"),
        ("Z2", "r 5 1 2, f 5 -3 2, r 5 1 2"),
        // In another plane another axis is the depth, so no word stays in force.
        ("G19 G81 X-7 R6 Z4", "r 6 1 2, r 6 1 4, f -7 1 4, r 6 1 4"),
        ("Y9", "r 6 9 4, f -7 9 4, r 6 9 4"),
    ]);
    let mut program = ready(Dialect::Oxmill);
    program.run("G81 X1 Z0 R1");
    assert_eq!(program.error("G18 X2 Y0 R0"), 0);
    assert_eq!(program.error("G18 X2 R0"), 28);
}

#[test]
fn inches_and_offsets() {
    play(&[
        ("G10 L2 P1 X10 Z-4", ""),
        ("G92 Y1", ""),
        ("G43.1 Z1", ""),
        // The offsets of Z are -4 mm (G10) and +1 mm (G43.1). Together they place R and Z 3 mm lower in the machine.
        ("G20 G81 X0.1 Z-0.1 R0.1", "r 12.54 1 10, r 12.54 1 -0.46, f 12.54 1 -5.54, r 12.54 1 10"),
        ("G21 X0", "r 10 1 10, r 10 1 -0.46, f 10 1 -5.54, r 10 1 10"),
    ]);
}

#[test]
fn words_on_the_line_act_before_the_cycle() {
    for dialect in NEW {
        let mut program = ready(dialect);
        let checked = program.run("N7 M8 S200 F120 G81 X2 Z-1 R2");
        assert_eq!((checked.line_number, checked.speed, checked.coolant.is_some()), (7, 200.0, true));
        let MotionCommand::Cycle(mut cycle) = checked.motion else { panic!() };
        let feeds: Vec<f32> = core::iter::from_fn(|| cycle.step(CLEARANCE))
            .filter_map(|step| if let CycleStep::Feed(_, feed) = step { Some(feed) } else { None })
            .collect();
        assert_eq!(feeds, [2.0]);
        assert_eq!(checked.digit, 0.0);
    }
}

#[test]
fn what_is_refused() {
    for dialect in NEW {
        for (line, code) in [
            ("G81 R1", 26),
            ("G81 X1", 28),
            ("G81 X1 R1", 28),
            ("G81 X1 Z1", 28),
            ("G82 X1 Z-1 R1", 28),
            ("G83 X1 Z-1 R1", 28),
            ("G73 X1 Z-1 R1", 28),
            ("G86 X1 Z-1 R1", 28),
            ("G88 X1 Z-1 R1", 28),
            ("G89 X1 Z-1 R1", 28),
            ("G83 X1 Z-1 R1 Q0", 39),
            ("G83 X1 Z-1 R1 Q-1", 39),
            ("G82 X1 Z-1 R1 P-1", 4),
            ("G81 X1 Z-1 R1 L0", 39),
            ("G81 X1 Z-1 R1 L-1", 39),
            ("G81 X1 Z-1 R1 L1.5", 23),
            ("G81 X1 Z-1 R1 L9999999", 39),
            ("G81 X1 Z2 R1", 54),
            ("G91 G81 X1 Z1 R-1", 54),
            ("G81 X1 Z-1 R1 P1", 36),
            ("G85 X1 Z-1 R1 P1", 36),
            ("G83 X1 Z-1 R1 Q1 P1", 36),
            ("G81 X1 Z-1 R1 Q1", 36),
            ("G81 X1 Z-1 R1 I1", 36),
            ("G53 G81 X1 Z-1 R1", 30),
            ("G93 G81 X1 Z-1 R1 F5", 120),
            ("G93 G81 X1 Z-1 R1", 22),
            ("M5 G86 X1 Z-1 R1 P0", 41),
            ("M5 G88 X1 Z-1 R1 P0", 41),
            ("G81 G83 X1 Z-1 R1 Q1", 24),
            ("G4 P1 G82 X1 Z-1 R1", 28),
            ("G91 G81 X1000 Z-1 R1 L1000000", 33),
            ("G81 X60000 Z-1 R1", 33),
            ("G81.1 X1 Z-1 R1", 20),
        ] {
            let program = ready(dialect);
            assert_eq!(program.error(line), code, "{line}");
        }
        let mut program = Program::new(dialect);
        assert_eq!(program.error("G81 X1 Z-1 R1"), 22);
        // A refused line does not end a series of cycles, and does not change the words that stay in force in the
        // series.
        program.run("F100 G81 X1 Z-1 R1");
        assert_eq!(program.error("X2 R-5"), 54);
        assert_eq!(program.error("R2"), 36);
        expect(&mut program, "X2", "r 2 0 1, f 2 0 -1, r 2 0 1");
        // Words stay in force only under the same cycle word.
        assert_eq!(program.error("G85 X5 Z-1"), 28);
        assert_eq!(program.error("G85 X5 R1"), 28);
        program.run("G1 X3");
        assert_eq!(program.error("G81 X4 Z-1"), 28);
        program.run("G81 X4 Z-1 R1");
        program.run("G80");
        assert_eq!(program.error("G81 X4 Z-1"), 28);
    }
}

#[test]
fn grbl_has_no_cycles() {
    let program = ready_in_grbl();
    for word in ["G73", "G81", "G82", "G83", "G85", "G86", "G88", "G89", "G98", "G99"] {
        assert_eq!(program.error(word), 20, "{word}");
    }
    assert_eq!((program.error("G81 X1 Z-1 R1"), program.error("X1 Q1"), program.error("G0 G80 X1")), (20, 20, 21));
}

fn ready_in_grbl() -> Program {
    let mut program = Program::new(Dialect::Grbl);
    program.run("G21 G90 F300");
    program
}

#[test]
fn g80_beside_a_motion_word_only_cancels() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G81 X2 Z-1 R2");
        assert_eq!(program.error("G0 G80 G1 X5"), 24);
        program.run("G80 G1 X5");
        assert_eq!(program.machine(), [5.0, 1.0, 10.0]);
        assert_eq!(program.interpreter.modal().motion.word(), "G1");
        program.run("G0 G80 X6");
        assert_eq!(program.interpreter.modal().motion.word(), "G0");
        expect(&mut program, "G80 G81 X7 Z-1 R1", "r 7 1 10, r 7 1 1, f 7 1 -1, r 7 1 10");
        assert_eq!(program.error("G80 G80"), 21);
    }
}
