//! Tests of tools: the table, the words that change it, and the offsets that are taken from it.

use crate::program::{Program, in_mm};
use oxmill_controller::axes::PerAxis;
use oxmill_controller::gcode::{Dialect, MotionCommand, TOOLS, ToolTable};
use oxmill_controller::units::Coordinate;

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Returns a program at X1 Y2 Z3.
fn ready(dialect: Dialect) -> Program {
    let mut program = Program::new(dialect);
    program.run_all("G21 F300\nG0 X1 Y2 Z3");
    program
}

#[test]
fn offsets_move_nothing_and_then_one_axis_each() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G10 L1 P1 Z5 X1");
        for (line, machine) in [
            ("G43 H1", [1.0, 2.0, 3.0]),
            ("G0 Z1", [1.0, 2.0, 6.0]),
            ("X1", [2.0, 2.0, 6.0]),
            ("G43.1 Z2", [2.0, 2.0, 6.0]),
            ("Z1", [2.0, 2.0, 3.0]),
            // G43.1 changes only the axes that it names.
            ("G43.1 Y3", [2.0, 2.0, 3.0]),
            ("X1 Y1 Z1", [2.0, 4.0, 3.0]),
            // G43.2 adds to the offset that is in force.
            ("G43.2 H1", [2.0, 4.0, 3.0]),
            ("X1 Y1 Z1", [3.0, 4.0, 8.0]),
            ("G53 Z1", [3.0, 4.0, 1.0]),
            ("M2", [3.0, 4.0, 1.0]),
            ("G0 Z1", [3.0, 4.0, 8.0]),
            ("G49 X1 Y1 Z1", [1.0, 1.0, 1.0]),
        ] {
            program.run(line);
            assert_eq!(program.machine(), machine, "{line}");
        }
    }
}

#[test]
fn the_tool_in_the_spindle() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run_all("G10 L1 P7 Z5\nG10 L1 P8 Z6");
        // T alone only selects a tool. G43 still uses the tool in the spindle.
        program.run_all("T7\nG43\nG0 Z0");
        assert_eq!(program.machine(), [1.0, 2.0, 0.0]);
        assert!(program.run("M6").tool_change);
        assert!(!program.run("M6").tool_change);
        program.run_all("G43\nZ0");
        assert_eq!(program.machine(), [1.0, 2.0, 5.0]);
        // If all words are on one line, the new tool's offset acts on the move.
        program.run("T8 M6 G43 G0 Z1");
        assert_eq!(program.machine(), [1.0, 2.0, 7.0]);
        program.run_all("G43 H7\nG43 H0\nZ0");
        assert_eq!(program.machine(), [1.0, 2.0, 6.0]);
        // A changed entry of the table takes effect at the next G43.
        program.run_all("G10 L1 P8 Z-1 X4\nZ0");
        assert_eq!(program.machine(), [1.0, 2.0, 6.0]);
        program.run("G43 Z0 X0");
        assert_eq!(program.machine(), [4.0, 2.0, -1.0]);
        program.run("T0 M6 G43 X0 Y0 Z0");
        assert_eq!(program.machine(), [0.0, 0.0, 0.0]);
        program.run_all("G10 L1 P99999 Z1\nT99999");
        assert_eq!(program.interpreter.modal().tool, 99_999);
    }
}

#[test]
fn entries_by_measuring() {
    for dialect in NEW {
        for (before, word, z) in [
            // `G10 L10 P1 Z5` sets the offset with which the tip is at Z5 of the active coordinates. The machine is at
            // Z3, so the offset is -2.
            ("", "L10", -2.0),
            // L10 takes the offset of G92 into account, but not the previous tool offset.
            ("G92 Z10\nG43.1 Z4", "L10", 5.0),
            ("G10 L2 P1 Z-2", "L10", 0.0),
            // L11 uses the coordinate system of the fixture (G59.3), and ignores the offset of G92.
            ("G10 L2 P9 Z-7\nG10 L2 P1 Z-2", "L11", 5.0),
            ("G10 L2 P9 Z-7\nG92 Z10", "L11", 5.0),
        ] {
            let mut program = ready(dialect);
            program.run_all(before);
            program.run(&format!("G10 {word} P1 Z5"));
            let offset = program.interpreter.tools().offset(1).unwrap();
            assert_eq!(offset.0.map(|place| place.0), [0, 0, (z * 1e7) as i64], "{before} {word}");
        }
    }
}

#[test]
fn a_table_has_an_end() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for tool in 1..=TOOLS {
            program.run(&format!("G10 L1 P{} Z{tool}", tool * 100));
        }
        assert_eq!(program.error("G10 L1 P7 Z1"), 47);
        program.run("G10 L1 P300 Z-1");
        program.run("G43 H300 G0 Z0");
        assert_eq!(program.machine(), [1.0, 2.0, -1.0]);
    }
}

#[test]
fn what_is_refused() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G10 L1 P1 Z1");
        for (line, code) in [
            ("G43 H7", 47),
            ("G43.2 H7", 47),
            ("G43.2", 28),
            ("G43 H1.5", 23),
            ("G43 H-1", 4),
            ("G0 X1 H1", 36),
            ("G43.1", 37),
            ("G43.1 H1", 37),
            ("T100000", 38),
            ("G10 L1 Z5", 28),
            ("G10 L1 P0 Z5", 47),
            ("G10 L1 P1.5 Z5", 23),
            ("G10 L1.5 P1 Z5", 23),
            ("G10 L2.5 P1 Z5", 23),
            ("G10 L-1.5 P1 Z5", 23),
            ("G10 L2 P1.5 Z5", 23),
            ("G10 L20 P0.1 Z5", 23),
            ("G10 L1 P100000 Z5", 38),
            ("G10 L1 P2147483647 Z5", 38),
            ("G10 L1 P99999999999999999999 Z5", 23),
            ("G43 H2147483647", 47),
            ("G10 L1 P1 Z50000.1", 33),
            ("G10 L10 P1 Z-50000", 33),
            ("G10 L1 P2", 47),
            ("G10 L1 P0", 47),
            ("G10 L1", 28),
            ("G10 L10 P1", 26),
            ("G10 L1 P2 R3", 47),
            ("G10 L1 P1 K3", 36),
            ("G10 L1 P1 Z5 K3", 36),
            ("G10 L10 P1 Z5 R3", 36),
            ("G10 L11 P1 Z5 Q3", 36),
            ("G10 L2 P1 X5 Q3", 36),
            // L is checked before P, so with an unknown L the tool number does not matter.
            ("G10 L3 P12 X1", 20),
            ("G10 L3 P3 X1", 20),
            ("G10 L2 P12 X1", 29),
            ("M6 M6", 21),
            ("G43 G49", 21),
        ] {
            assert_eq!(program.error(line), code, "{line}");
        }
    }
    let mut program = ready(Dialect::Grbl);
    for (line, code) in
        [("G43", 20), ("G43 H1", 20), ("M6", 20), ("H1", 20), ("T256", 38), ("G10 L1 P3 X1", 20), ("G10 L1 P12 X1", 29)]
    {
        assert_eq!(program.error(line), code, "{line}");
    }
    assert_eq!(program.error("G43.1 X1"), 37);
    program.run("G43.1 Z1");
    assert!(matches!(program.run("G0 Z1").motion, MotionCommand::Line { .. }));
    assert_eq!(program.machine(), [1.0, 2.0, 2.0]);
}

/// Without any entry in the tool table, every tool has length 0 and no tool is refused as unknown.
#[test]
fn without_any_entry_tools_have_no_length() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for line in ["G43 H7", "T3 M6 G43", "G43.2 H9", "G43 H99999 G0 Z3"] {
            program.run(line);
            assert_eq!((tool_length(&program), program.machine()), (0.0, [1.0, 2.0, 3.0]), "{line}");
        }
        // While a tool length is in force, tools that have no entry are refused.
        program.run("G43.1 Z2");
        assert_eq!((program.error("G43 H7"), program.error("G43.2 H7"), program.error("G43 H0")), (47, 47, 47));
        program.run("M61 Q0");
        assert_eq!(program.error("G43 H0"), 0, "no tool has no length");
        program.run("G49");
        assert_eq!(program.error("G43 H7"), 0);
        // A tool without an entry is also refused in three other cases: the table has an entry, an entry was made in
        // check mode, or a tool has been measured.
        program.run("G10 L1 P1 Z0");
        assert_eq!(program.error("G43 H7"), 47);
        program.run("G10 L1 P1");
        program.interpreter.begin_check_mode(Dialect::Oxmill);
        program.run("G10 L1 P1 Z0");
        assert_eq!(program.error("G43 H7"), 47);
        program.interpreter.reset();
        assert_eq!(program.error("G43 H7"), 0);
        program.interpreter.begin_check_mode(Dialect::Oxmill);
        program.interpreter.assume_measured();
        assert_eq!((program.error("G43 H7"), program.error("G43")), (47, 0));
        program.interpreter.reset();
        measure(&mut program, 1, -50);
        assert_eq!((program.error("G43 H7"), program.error("G43")), (47, 0));
        assert_eq!(program.error("G10 L1 P7"), 47);
    }
}

/// The radius (R), angles (I, J) and orientation (Q) of LinuxCNC's tables are not stored. A line with only these words
/// changes no offset and does not remove the tool.
#[test]
fn words_of_a_tool_that_are_not_kept() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G10 L1 P1 Z5");
        for line in ["G10 L1 P1 R3", "G10 L1 P1 I10 J20 Q3", "G10 L1 P1 R-1 G91", "G90 G10 L1 P1 Q0"] {
            program.run(line);
            assert_eq!((program.error("G43 H1"), program.error("G10 L1 P1")), (0, 0), "{line}");
        }
        program.run("G10 L1 P1 Z7 R3 Q1");
        program.run("G43 H1");
        assert_eq!(tool_length(&program), 7.0);
        program.run_all("G10 L1 P2 Z7\nG10 L1 P1");
        assert_eq!(program.error("G43 H1"), 47);
    }
}

/// Offsets, sums of offsets and targets beyond 50 m are refused, because the controller does not compute there.
#[test]
fn offsets_have_an_end() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for line in [
            "G10 L2 P1 X50000.1",
            "G10 L2 X-99999999999999999999",
            "G20 G10 L2 P1 X3000",
            "G92 X99999999999999999999",
            "G92 X-50000.1",
            "G10 L20 P1 Y50010",
            "G43.1 Z-99999999999999999999",
        ] {
            assert_eq!(program.error(line), 33, "{line}");
        }
        program.run_all("G10 L1 P1 Z-40000\nG10 L2 P1 Z50000\nG43 H1");
        assert_eq!(program.error("G43.2 H1"), 33);
        assert_eq!(program.error("G52 X-50000.0000001"), 33);
        program.run("G52 X-50000");
        assert_eq!(program.error("G0 X-1"), 33);
        program.run("G0 X1");
        assert_eq!(program.machine(), [-49_999.0, 2.0, 3.0]);
    }
}

/// In check mode a program's changes to the table last until the check ends.
#[test]
fn a_check_leaves_the_table_as_it_was() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run_all("G10 L1 P1 Z1\nG10 L1 P2 Z2");
        let before = program.interpreter.tools().clone();
        program.interpreter.begin_check_mode(Dialect::Oxmill);
        program.run_all("G10 L1 P1 X5\nG10 L1 P1 Y6\nG10 L1 P7 Z7\nG43 H1 G0 X0 Y0 Z0");
        assert_eq!(program.machine(), [5.0, 6.0, 1.0]);
        program.run("G43 H7 X0 Y0 Z0");
        assert_eq!(program.machine(), [0.0, 0.0, 7.0]);
        let stored = |tools: &ToolTable<3>| tools.entries().iter().filter(|tool| tool.is_stored()).count();
        assert_eq!(stored(program.interpreter.tools()), 2);
        // Each tool takes one entry.
        for tool in 10..10 + TOOLS - 4 {
            program.run(&format!("G10 L1 P{tool} Z{tool}"));
        }
        assert_eq!((program.error("G10 L1 P2 Z1"), program.error("G10 L1 P10 Z1")), (47, 0));
        program.interpreter.reset();
        assert_eq!(*program.interpreter.tools(), {
            // The check has used entries that were free before. The table is compared without their contents; only
            // their number must be 0 again (free).
            let mut after = before.clone();
            for (slot, tool) in program.interpreter.tools().entries().iter().enumerate().skip(2) {
                after.put(slot, *tool);
                assert_eq!(tool.number, 0);
            }
            after
        });
        program.run("G10 L1 P7 Z-7");
        program.run("G43 H7 G0 Z0");
        assert_eq!(program.machine()[2], -7.0);
    }
}

/// G10 L1 without axis words removes a tool from the table. An entry of length 0 is kept: it can belong to the tool
/// with which others are compared.
#[test]
fn a_tool_is_taken_out() {
    for dialect in NEW {
        let mut program = ready(dialect);
        for tool in 1..=TOOLS {
            program.run(&format!("G10 L1 P{tool} X0 Y0 Z0"));
        }
        assert_eq!((program.error("G43 H5"), program.error("G10 L1 P99 Z1")), (0, 47));
        program.run("G43 H5");
        program.run("G10 L1 P5");
        assert_eq!((program.error("G43 H5"), program.error("G10 L1 P5"), program.error("G43 H6")), (47, 47, 0));
        program.run("G10 L1 P99 Z1");
        assert_eq!((program.error("G43 H99"), program.error("G10 L1 P5 Z1")), (0, 47));
        // A program in check mode does not remove a tool permanently.
        program.interpreter.begin_check_mode(Dialect::Oxmill);
        program.run("G10 L1 P6");
        program.interpreter.reset();
        assert_eq!(program.error("G43 H6"), 0);
    }
}

/// Measures the tool `number`, which touches a setter at the machine coordinate `height`. Returns whether it is the
/// first measured tool.
fn measure(program: &mut Program, number: u32, height: i32) -> bool {
    program.interpreter.tool_removed();
    program.interpreter.tool_measured(number, Coordinate::mm(height))
}

fn tool_length(program: &Program) -> f64 {
    in_mm(&program.interpreter.offsets().tool_length)[2]
}

/// The host can set the reference (`$TLR`): the height at which a tool without offset touches the setter. Lengths are
/// then measured from there, not from the first measured tool.
#[test]
fn a_host_sets_the_reference_of_the_setter() {
    let mut program = ready(Dialect::Oxmill);
    program.run("G43.1 Z2");
    assert_eq!(program.interpreter.tool_reference(), None);
    let touched = PerAxis([Coordinate::mm(1), Coordinate::mm(2), Coordinate::mm(-50)]);
    program.interpreter.set_tool_reference(Some(touched));
    assert_eq!(program.interpreter.tool_reference(), Some(Coordinate::mm(-52)), "of a tool with offset 0");
    assert!(!measure(&mut program, 2, -43));
    assert_eq!(tool_length(&program), 9.0, "7 mm longer than the one that has touched");
    program.interpreter.set_tool_reference(None);
    assert!(measure(&mut program, 2, -43));
}

#[test]
fn measured_tools_have_the_same_work_zero() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("G43.1 X1 Z2");
        assert!(measure(&mut program, 1, -50));
        assert_eq!(tool_length(&program), 2.0, "the first one keeps what acts");
        assert!(!measure(&mut program, 2, -43));
        assert_eq!(tool_length(&program), 9.0, "7 mm longer");
        // Along Z the measured length acts; along the other axes the table's offset acts.
        program.run_all("G10 L1 P2 X5 Z-1\nG49");
        assert_eq!(tool_length(&program), 0.0);
        for line in ["G43", "G43 H2", "G43 H0"] {
            program.run("G49");
            program.run(line);
            assert_eq!(in_mm(&program.interpreter.offsets().tool_length), [5.0, 0.0, 9.0], "{line}");
        }
        program.run("G49");
        program.interpreter.reset();
        assert_eq!(tool_length(&program), 9.0, "a reset does not forget what is in the spindle");
        // The length of another tool that has not been measured is unknown.
        program.run("T3 M6");
        assert_eq!(program.error("G43"), 47);
        program.interpreter.reset();
        assert_eq!(tool_length(&program), 0.0);
        assert!(!measure(&mut program, 1, -50));
        assert_eq!(tool_length(&program), 2.0, "the reference is kept");
        program.run("M61 Q4");
        assert_eq!(program.error("G43"), 47);
    }
}

#[test]
fn a_tool_that_was_taken_out_is_not_there() {
    let mut program = ready(Dialect::Oxmill);
    measure(&mut program, 5, -20);
    assert!(!program.check("T5 M6").unwrap().tool_change);
    program.interpreter.tool_removed();
    assert!(program.check("T5 M6").unwrap().tool_change);
    program.interpreter.reset();
    assert_eq!(tool_length(&program), 0.0);
}

/// M72 puts the length of the tool in the spindle into force, as it was measured last. M72 does not restore the length
/// of another tool, nor an older measurement.
#[test]
fn a_restored_state_has_the_length_of_the_tool_in_the_spindle() {
    let mut program = ready(Dialect::Oxmill);
    measure(&mut program, 1, -20);
    program.run_all("M70\nG91 G49\nM72");
    assert_eq!((tool_length(&program), program.error("G43 H1")), (0.0, 0));
    measure(&mut program, 2, -10);
    program.run_all("M70\nG49\nM72");
    assert_eq!(tool_length(&program), 10.0);
    program.run("M70");
    measure(&mut program, 1, -13);
    program.run("M72");
    assert_eq!(tool_length(&program), 7.0);
    program.run("M70");
    measure(&mut program, 1, -15);
    program.run("M72");
    assert_eq!(tool_length(&program), 5.0, "it has been put in otherwise");
    // M70 has saved a state with a measured length in force. M72 puts into force the length that has been measured
    // since then, not the saved one.
    for line in ["G49", "G43.1 Z99"] {
        program.run("M70");
        measure(&mut program, 2, -10);
        program.run(line);
        program.run("M72");
        assert_eq!(tool_length(&program), 10.0, "{line}");
    }
    for tool in ["T3 M6", "M61 Q3"] {
        let mut program = ready(Dialect::Oxmill);
        program.run_all("G10 L1 P3 Z3\nG43.1 X1 Z2\nM70\nG20");
        program.run(tool);
        program.run_all("G43 H3\nM72");
        assert_eq!(tool_length(&program), 3.0, "{tool}");
        program.run_all("M70\nG49\nM72");
        assert_eq!(tool_length(&program), 3.0);
    }
}

#[test]
fn a_check_measures_nothing_and_forgets_nothing() {
    let mut program = ready(Dialect::Oxmill);
    measure(&mut program, 1, -20);
    measure(&mut program, 2, -10);
    program.interpreter.begin_check_mode(Dialect::Oxmill);
    program.run("T9 M6");
    program.interpreter.assume_measured();
    program.run("G43 H9");
    program.interpreter.reset();
    assert_eq!(program.error("G43 H9"), 47);
    assert!(!program.check("T2 M6").unwrap().tool_change);
    assert_eq!(tool_length(&program), 10.0);
    program.interpreter.change_dialect();
    program.interpreter.reset();
    assert_eq!(tool_length(&program), 0.0, "Grbl has no such offset");
}

#[test]
fn a_tool_is_named() {
    for dialect in NEW {
        let mut program = ready(dialect);
        program.run("M61 Q7");
        assert_eq!((program.interpreter.spindle_tool(), program.interpreter.modal().tool), (7, 7));
        assert!(!program.check("T7 M6").unwrap().tool_change);
        program.run("T8 M61 Q9");
        assert_eq!((program.interpreter.spindle_tool(), program.interpreter.modal().tool), (9, 8));
        program.run("M61 Q0");
        for (line, error) in
            [("M61", 28), ("M61 Q-1", 4), ("M61 Q0.5", 23), ("M61 Q100000", 38), ("M61 Q1 M6", 21), ("M61 P1", 28)]
        {
            assert_eq!(program.error(line), error, "{line}");
        }
    }
    assert_eq!(Program::new(Dialect::Grbl).error("M61 Q1"), 20);
}
