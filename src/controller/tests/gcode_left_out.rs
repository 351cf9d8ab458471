//! Words that a controller refuses if it is built without the features for which a small flash has no room.

use crate::program::Program;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::Dialect;
#[cfg(not(feature = "expressions"))]
use oxmill_controller::gcode::{Direction, Interpreter};

const NEW: [Dialect; 2] = [Dialect::Oxmill, Dialect::Seed];

/// Checks the error of each line, and that Grbl's own words are accepted.
fn refuses(lines: &[&str], error: Error) {
    for dialect in NEW {
        let mut program = Program::new(dialect);
        program.run_all("G21 G90 F300\nM3 S100\nG0 X1 Y1 Z10\nG43.1 Z1\nG49\nG92 X0\nG92.1\nT1");
        for line in lines {
            assert_eq!(program.error(line), error.code(), "{line}");
        }
    }
}

#[cfg(not(feature = "extended-gcode"))]
#[test]
fn cycles_tools_and_words_of_state() {
    let cycles = ["G73", "G81", "G82", "G83", "G85", "G86", "G88", "G89"].map(|word| format!("{word} X2 Z-1 R2 Q1 P1"));
    refuses(&cycles.each_ref().map(String::as_str), Error::ExtendedLeftOut);
    let tools = ["M6", "G43 H1", "G43.2 H1", "G10 L1 P1 Z1", "G10 L10 P1 Z1", "G10 L11 P1 Z1"];
    refuses(&tools, Error::ExtendedLeftOut);
    let pins = ["M61 Q1", "M62 P0", "M65 P0", "M66 P0", "M67 E0 Q1", "M68 E0 Q1"];
    refuses(&pins, Error::ExtendedLeftOut);
    let offsets = ["G52 X1", "G92.2", "G92.3"];
    refuses(&offsets, Error::ExtendedLeftOut);
    let state = ["M48", "M49", "M50 P0", "M51 P0", "M52 P0", "M53", "M70", "M71", "M72"];
    refuses(&state, Error::ExtendedLeftOut);
}

#[cfg(not(feature = "rotation"))]
#[test]
fn rotations() {
    refuses(&["G68 X1 R1", "G68 R1", "G10 L2 P1 R1", "G10 L2 P1 X1 R1"], Error::RotationLeftOut);
    refuses(&["G68.1 X1 R1"], Error::NotSupported);
    refuses(&["G51 X1 Y1 P2", "G51 I2", "G51"], Error::ScalingLeftOut);
    assert_eq!(["G69", "G50"].map(|line| Program::new(Dialect::Oxmill).error(line)), [0; 2]);
}

#[cfg(not(feature = "splines"))]
#[test]
fn splines() {
    refuses(&["G5 X1 Y1 I1 J1 P1 Q1", "G5.1 X1 Y1 I1 J1", "G5", "G5.2 P1 L3", "G5.3"], Error::SplinesLeftOut);
    refuses(&["G4 P-1", "G10 L2 P-1 X0"], Error::NegativeValue);
}

#[cfg(not(feature = "blending"))]
#[test]
fn rounded_corners() {
    refuses(&["G64 P0.1", "G64 P0.1 Q0"], Error::BlendingLeftOut);
    assert_eq!(["G64", "G64 P0", "G61", "G61.1"].map(|line| Program::new(Dialect::Oxmill).error(line)), [0; 4]);
}

#[cfg(not(feature = "expressions"))]
#[test]
fn expressions_and_parameters() {
    refuses(&["#1=2", "G0 X[1+1]", "G0 X#1"], Error::ExpressionsLeftOut);
    let mut interpreter = Interpreter::<3>::default();
    for line in ["O1SUB", "O<A>CALL[2]", "O100IF[1]", "O1ENDSUB", "N5O7CALL", "O#1CALL", "O[1]CALL"] {
        assert_eq!(interpreter.direct(line.as_bytes(), &[], 1), Err(Error::ExpressionsLeftOut), "{line}");
    }
    for line in ["O1000", "N5", "G0X1", "O7G0X1", ""] {
        assert_eq!(interpreter.direct(line.as_bytes(), &[], 1), Ok(Direction::Check), "{line}");
    }
}

/// With all features nothing is refused.
#[cfg(all(feature = "extended-gcode", feature = "expressions"))]
#[test]
fn nothing() {
    for dialect in NEW {
        let program = Program::new(dialect);
        assert_eq!(["M70", "M48", "#1=2", "G92.2"].map(|line| program.error(line)), [0; 4]);
    }
    refuses(&[], Error::ExtendedLeftOut);
}
