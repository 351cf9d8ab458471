//! Tests of macros: stored lines that remain when a program ends. In memory, macros come before the lines that a
//! program stores (subroutines and loops).
#![cfg(feature = "full")]

use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Direction, Interpreter};
use proptest::prelude::*;

fn all(interpreter: &Interpreter<3>) -> Vec<String> {
    (0..).map_while(|i| interpreter.macro_line(i).map(|line| String::from_utf8(line.to_vec()).unwrap())).collect()
}

fn send(interpreter: &mut Interpreter<3>, text: &str) -> Vec<Result<Direction, Error>> {
    text.lines().map(|line| interpreter.direct(line.as_bytes(), &[], 1)).collect()
}

#[test]
fn lines_beyond_the_last_and_too_many_bytes() {
    let mut interpreter = Interpreter::<3>::default();
    assert_eq!(interpreter.set_macro_line(64, b"G0"), Err(Error::InvalidStatement));
    assert_eq!(interpreter.set_macro_line(63, b"G0X1"), Ok(()));
    assert_eq!(all(&interpreter).len(), 64);
    interpreter.clear_macros();
    assert!(all(&interpreter).is_empty());
    // Macros may take 3072 bytes. Each of these lines takes 80 bytes and one more, so there is room for 37 lines.
    let line = [b'X'; 80];
    for index in 0..37 {
        assert_eq!(interpreter.set_macro_line(index, &line), Ok(()), "{index}");
    }
    assert_eq!(interpreter.set_macro_line(37, &line), Err(Error::OutOfMemory));
    assert_eq!(interpreter.set_macro_line(36, &line), Ok(()), "in the place of one");
    assert_eq!(interpreter.set_macro_line(37, b"G0X1"), Ok(()));
    assert_eq!(all(&interpreter).len(), 38);
}

#[test]
fn a_program_that_has_filled_the_memory_keeps_its_lines() {
    let mut interpreter = Interpreter::<3>::default();
    send(&mut interpreter, "O1SUB");
    let long = format!("G1X{}", "1".repeat(100));
    while send(&mut interpreter, &long) == [Ok(Direction::LeftOut)] {}
    send(&mut interpreter, "O1ENDSUB\nO2SUB\nO2ENDSUB");
    for _ in 0..60 {
        send(&mut interpreter, &format!("O3SUB\n{long}\nO3ENDSUB"));
        send(&mut interpreter, &format!("O4SUB\n{long}\n{long}\nO4ENDSUB"));
    }
    let mut stored = 0;
    while interpreter.set_macro_line(stored, long.as_bytes()).is_ok() {
        stored += 1;
    }
    assert!(stored > 20, "{stored}");
    assert_eq!(send(&mut interpreter, "O2CALL"), [Ok(Direction::Call)]);
}

proptest! {
    /// Macro lines that are set in any order read back as they were set. A subroutine that a program has stored after
    /// them in memory can still be called.
    #[test]
    fn lines_are_as_they_were_set(sets in prop::collection::vec((0_usize..12, "[A-Z0-9]{0,9}"), 1..40), with_program: bool) {
        let mut interpreter = Interpreter::<3>::default();
        if with_program {
            send(&mut interpreter, "O9SUB\nG0X5\nO9ENDSUB");
        }
        let mut expected: Vec<String> = Vec::new();
        for (index, line) in &sets {
            prop_assert_eq!(interpreter.set_macro_line(*index, line.as_bytes()), Ok(()));
            if expected.len() <= *index && !line.is_empty() {
                expected.resize(index + 1, String::new());
            }
            if let Some(place) = expected.get_mut(*index) {
                place.clone_from(line);
            }
            prop_assert_eq!(&all(&interpreter), &expected);
            let answer = send(&mut interpreter, "O9CALL");
            let there = if with_program { Ok(Direction::Call) } else { Err(Error::FlowSyntax) };
            prop_assert_eq!(answer, [there]);
            interpreter.abandon_held();
        }
        // The lines of the macros survive the end of a program, and a reset.
        interpreter.abandon_program();
        prop_assert_eq!(&all(&interpreter), &expected);
        prop_assert_eq!(send(&mut interpreter, "O9CALL"), [Err(Error::FlowSyntax)]);
        interpreter.reset();
        prop_assert_eq!(&all(&interpreter), &expected);
    }
}
