//! Tests of the words that the small image refuses, because 256 KiB of flash have no room for them.

#![cfg(not(feature = "full"))]

use crate::program::Program;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Dialect, Direction, Interpreter};

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Asserts that lines with Grbl's own words are accepted, and that after them each of `lines` is refused with `error`.
fn refuses(lines: &[&str], error: Error) {
    for dialect in NEW {
        let mut program = Program::new(dialect);
        program.run_all("G21 G90 F300\nM3 S100\nG0 X1 Y1 Z10\nG43.1 Z1\nG49\nG92 X0\nG92.1\nT1");
        for line in lines {
            assert_eq!(program.error(line), error.code(), "{line}");
        }
    }
}

#[test]
fn rotations() {
    refuses(&["G68 X1 R1", "G68 R1", "G10 L2 P1 R1", "G10 L2 P1 X1 R1"], Error::RotationLeftOut);
    refuses(&["G68.1 X1 R1"], Error::NotSupported);
    refuses(&["G51 X1 Y1 P2", "G51 I2", "G51"], Error::ScalingLeftOut);
    assert_eq!(["G69", "G50"].map(|line| Program::new(Dialect::Oxmill).error(line)), [0; 2]);
}

#[test]
fn splines() {
    refuses(&["G5 X1 Y1 I1 J1 P1 Q1", "G5.1 X1 Y1 I1 J1", "G5", "G5.2 P1 L3", "G5.3"], Error::SplinesLeftOut);
    refuses(&["G4 P-1", "G10 L2 P-1 X0"], Error::NegativeValue);
}

#[test]
fn rounded_corners() {
    refuses(&["G64 P0.1", "G64 P0.1 Q0"], Error::BlendingLeftOut);
    assert_eq!(["G64", "G64 P0", "G61", "G61.1"].map(|line| Program::new(Dialect::Oxmill).error(line)), [0; 4]);
}

#[test]
fn pins() {
    refuses(&["M62 P0", "M65 P0", "M66 P0", "M67 E0 Q1", "M68 E0 Q1"], Error::NoSuchPin);
}

#[test]
fn expressions_and_parameters() {
    refuses(&["#1=2", "G0 X[1+1]", "G0 X#1", "M73"], Error::ExpressionsLeftOut);
    let mut interpreter = Interpreter::<3>::default();
    for line in ["O1SUB", "O<A>CALL[2]", "O100IF[1]", "O1ENDSUB", "N5O7CALL", "O#1CALL", "O[1]CALL"] {
        assert_eq!(interpreter.direct(line.as_bytes(), &[], 1), Err(Error::ExpressionsLeftOut), "{line}");
    }
    for line in ["O1000", "N5", "G0X1", "O7G0X1", ""] {
        assert_eq!(interpreter.direct(line.as_bytes(), &[], 1), Ok(Direction::Check), "{line}");
    }
}

/// Cycles, the tool table, and words that save modal state or shift coordinates (M70, G92.2, G52) are in every image.
#[test]
fn what_stays() {
    for dialect in NEW {
        let program = Program::new(dialect);
        assert_eq!(["M70", "M48", "G92.2", "G52 X1", "G43 H1"].map(|line| program.error(line)), [0; 5]);
    }
}
