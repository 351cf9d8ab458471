//! Decides on lines after the end of a program (M2, M30): they belong to the next program, or to subprograms, which
//! controls with M98 have there (`O1001` .. `M99`). The interpreter cannot call such subprograms and refuses their
//! lines, so that the machine does not execute them one after another. An O number (`O1001` .. `M30`) begins the next
//! program only if it follows a tape mark, a reset, or a rest of the machine.
//!
//! ```text
//!  Program ──M2, M30──▶ End ──O number──▶ Subprogram ──M99, M2, M30──▶ SubprogramEnd
//!     ▲                  │ rested             ▲                            │      │ rested
//!     └──────────────────┴────────────────────┼──────────O number──────────┘      │
//!     └───────────────────────────────────────┼───────────────────────────────────┘
//! ```
//! In `Subprogram` and `SubprogramEnd` each line is refused: an M99 may be followed by more of the same subprogram, which a
//! GOTO reaches.

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
        use ProgramPlace::{End, Program, Subprogram, SubprogramEnd};
        match self.place {
            Program => return Ok(()),
            Subprogram | SubprogramEnd if line.is_empty() => return Ok(()),
            End if !has_program_number(line) => return Ok(()),
            // After a subprogram any line begins the next program: nothing falls into that.
            End | SubprogramEnd if rested => {
                self.place = Program;
                return Ok(());
            }
            End => self.place = Subprogram,
            SubprogramEnd if has_program_number(line) => self.place = Subprogram,
            Subprogram if ends_subprogram(line) => self.place = SubprogramEnd,
            Subprogram | SubprogramEnd => {}
        }
        Err(Error::BehindEnd)
    }
}

/// Whether a line ends a subprogram for certain: it has M99, M2 or M30 and no condition (`IF[#1EQ1]M99`).
fn ends_subprogram(line: &[u8]) -> bool {
    !line.contains(&b'[') && has_m_word(line, &[b"2", b"30", b"99"])
}

/// Whether a line begins with the number of a program or subprogram, after its line number (N) if it has one: O or a colon,
/// and no O word. Further words may follow, and the number need not be a valid one.
fn has_program_number(line: &[u8]) -> bool {
    let numbered = line.strip_prefix(b"N").unwrap_or_default();
    let digits = numbered.iter().take_while(|byte| byte.is_ascii_digit()).count();
    let line = numbered.get(digits..).filter(|after| !after.is_empty()).unwrap_or(line);
    let Some((b'O' | b':', number)) = line.split_first() else { return false };
    let mut depth = 0_usize;
    let word = number.iter().position(|byte| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth == 0 && byte.is_ascii_uppercase()
    });
    let word = word.and_then(|at| number.get(at..)).unwrap_or_default();
    !O_WORDS.iter().any(|start| word.starts_with(*start))
}

/// The first letters of each O word: `sub`, `endsub`, `else`, `call`, `continue`, `return`, `if`, `while`, `do`, `break`.
const O_WORDS: [&[u8]; 10] = [b"SU", b"EN", b"EL", b"CA", b"CO", b"RE", b"IF", b"WH", b"DO", b"BR"];

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
        let run = [true, true, true, true, false, false, true, false, false, false, false, false];
        assert_eq!(taken(&lines), run);
        assert_eq!(
            taken(&["M2", "G0Z5", "N10O1", "G0Z-3", "N20M99", "G0Z1"]),
            [true, true, false, false, false, false]
        );
    }

    /// Whatever opens it, and wherever it returns.
    #[test]
    fn no_form_of_a_subprogram_is_run() {
        for number in
            [":1001", "N1:1001", "O1001.0", "O1001.5", "O[1001]", "O#1", "O1001G1Z-3F100", "O1001M3", "O1001%", "O"]
        {
            assert_eq!(taken(&["M30", number, "G1Z-3F100", "M99"]), [true, false, false, false], "{number}");
        }
        for end in ["IF[#1EQ1]M99", "M99", "N5M99P20", "/M99", "IF[#1EQ1]M30", "M30"] {
            assert_eq!(taken(&["M30", "O1001", end, "G1Z-3F100", "N20G1Z-4", "M99"])[1..], [false; 5], "{end}");
        }
    }

    #[test]
    fn after_a_subprogram_and_a_rest_the_next_program_begins() {
        for (end, is_taken) in [("M99", true), ("IF[#1EQ1]M99", false)] {
            let mut interpreter = Interpreter::<3>::default();
            interpreter.place = ProgramPlace::End;
            for line in ["O1001", end] {
                assert_eq!(interpreter.look_behind_end(line.as_bytes(), false), Err(Error::BehindEnd));
            }
            assert_eq!(interpreter.look_behind_end(b"G0X1", false), Err(Error::BehindEnd));
            assert_eq!(interpreter.look_behind_end(b"G0X1", true).is_ok(), is_taken, "{end}");
        }
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
    fn o_words_are_no_numbers() {
        for (line, is) in [
            ("O1", true),
            ("N5O0100", true),
            (":7", true),
            ("O1X5", true),
            ("O1SUB", false),
            ("N5O1ENDWHILE", false),
            ("O<A>CALL", false),
            ("O[1+ABS[2]]CALL[3]", false),
            ("O#1REPEAT[2]", false),
            ("G0X1", false),
            ("", false),
        ] {
            assert_eq!(has_program_number(line.as_bytes()), is, "{line}");
        }
        let words = "SUB ENDSUB CALL RETURN IF ELSEIF ELSE ENDIF WHILE ENDWHILE DO REPEAT ENDREPEAT BREAK CONTINUE";
        for word in words.split(' ') {
            assert!(!has_program_number(std::format!("O1{word}").as_bytes()), "{word}");
        }
    }
}
