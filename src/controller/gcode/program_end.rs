//! Decides on lines after the end of a program (M2, M30): they belong to the next program, or to subprograms, which
//! controls with M98 have there (`O1001` .. `M99`). The interpreter cannot call such subprograms and refuses their
//! lines, so that the machine does not execute them one after another. An O number (`O1001` .. `M30`) begins the next
//! program only if it follows a tape mark, a reset, or a rest of the machine.

use super::m_words::has_m_word;
use super::state::{Interpreter, ProgramPlace};
use crate::error::Error;

impl<const N: usize> Interpreter<N> {
    /// Whether a program has ended, and no other program has begun.
    #[inline]
    pub fn is_behind_end(&self) -> bool {
        self.place != ProgramPlace::Program
    }

    /// Marks the next line as the start of a program.
    pub fn begin_program(&mut self) {
        self.place = ProgramPlace::Program;
    }

    /// Examines a line after the end of a program. `rested`: the machine has been idle for a while, so an O number is
    /// that of the next program.
    ///
    /// # Errors
    /// [`Error::BehindEnd`] for the lines of a subprogram.
    pub fn look_behind_end(&mut self, line: &[u8], rested: bool) -> Result<(), Error> {
        match self.place {
            ProgramPlace::Program => Ok(()),
            ProgramPlace::End if !is_program_number(line) => Ok(()),
            ProgramPlace::End if rested => {
                self.place = ProgramPlace::Program;
                Ok(())
            }
            ProgramPlace::End => {
                self.place = ProgramPlace::Subprogram;
                Err(Error::BehindEnd)
            }
            ProgramPlace::Subprogram if line.is_empty() => Ok(()),
            ProgramPlace::Subprogram => {
                if has_m_word(line, &[b"2", b"30", b"99"]) {
                    self.place = ProgramPlace::End;
                }
                Err(Error::BehindEnd)
            }
        }
    }
}

/// Whether a line consists of a program number (O), which may follow a line number (N).
fn is_program_number(line: &[u8]) -> bool {
    let numbered = line.strip_prefix(b"N").unwrap_or_default();
    let digits = numbered.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let number = numbered.get(digits..).filter(|behind| !behind.is_empty()).unwrap_or(line).strip_prefix(b"O");
    number.is_some_and(|number| !number.is_empty() && number.iter().all(u8::is_ascii_digit))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode::Dialect;

    /// Returns which of these lines are accepted, on a machine that never rests.
    fn taken(lines: &[&str]) -> std::vec::Vec<bool> {
        let mut interpreter = Interpreter::<3>::default();
        let take = |line: &&str| {
            let line = line.as_bytes();
            if line == b"%" {
                interpreter.tape_mark().unwrap();
                return true;
            }
            if interpreter.look_behind_end(line, false).is_err() {
                return false;
            }
            let action = interpreter.check(line, Dialect::Oxmill).unwrap();
            interpreter.commit(&action);
            true
        };
        lines.iter().map(take).collect()
    }

    #[test]
    fn subprograms_behind_the_end_are_not_run() {
        let lines = ["O1000", "G0X1", "M30", "", "O1001", "G1Z-3F100", "", "#<M99>=2", "M99", "O1002", "M30", "G0Z1"];
        let run = [true, true, true, true, false, false, true, false, false, false, false, true];
        assert_eq!(taken(&lines), run);
        assert_eq!(taken(&["M2", "G0Z5", "N10O1", "G0Z-3", "N20M99", "G0Z1"]), [true, true, false, false, false, true]);
    }

    #[test]
    fn the_number_of_the_next_program_is_no_subprogram() {
        assert_eq!(taken(&["%", "O1", "M30", "%", "O2", "G0X1", "M30"]), [true; 7]);
        let mut interpreter = Interpreter::<3>::default();
        for end in ["M2", "M30"] {
            let action = interpreter.check(end.as_bytes(), Dialect::Oxmill).unwrap();
            interpreter.commit(&action);
            assert!(interpreter.is_behind_end());
            assert_eq!(interpreter.look_behind_end(b"O1", true), Ok(()));
            assert!(!interpreter.is_behind_end());
        }
        // A rest does not end a subprogram: the sender may have paused to ask the operator whether to continue.
        interpreter.place = ProgramPlace::End;
        assert_eq!(interpreter.look_behind_end(b"O1", false), Err(Error::BehindEnd));
        assert_eq!(interpreter.look_behind_end(b"G0X1", true), Err(Error::BehindEnd));
        interpreter.reset();
        assert!(!interpreter.is_behind_end());
    }

    #[test]
    fn numbers_of_programs_are_alone() {
        for (line, is) in [
            ("O1", true),
            ("N5O0100", true),
            ("O", false),
            ("O1SUB", false),
            ("O<A>CALL", false),
            ("G0X1", false),
            ("", false),
        ] {
            assert_eq!(is_program_number(line.as_bytes()), is, "{line}");
        }
    }
}
