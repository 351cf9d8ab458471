//! Decides on lines after the end of a program (M2, M30): they belong to the next program, or to subprograms, which
//! controls with M98 have there (`O1001` .. `M99`). The interpreter cannot call such subprograms and refuses their
//! lines, so that the machine does not execute them one after another. An O number (`O1001` .. `M30`) begins the next
//! program only if it follows a tape mark, a reset, `$X`, or a rest of the machine.
//!
//! ```text
//!  Program ──M2, M30──▶ End ──O number──▶ Subprogram ──%, $X, reset, another host──▶ Program
//!     ▲                  │
//!     └───────────O number after a rest
//! ```
//! An M2 or M30 that was refused, or skipped by a condition, counts, too. An M99 does not end the refusal: more lines of
//! the same subprogram can follow it, which a GOTO reaches.

use super::state::{Interpreter, ProgramPlace};
use super::tools::may_end_program;
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
            ProgramPlace::Program => return Ok(()),
            ProgramPlace::Subprogram if line.is_empty() => return Ok(()),
            ProgramPlace::End if !has_program_number(line) => return Ok(()),
            ProgramPlace::End if rested => {
                self.place = ProgramPlace::Program;
                return Ok(());
            }
            ProgramPlace::End | ProgramPlace::Subprogram => {}
        }
        self.place = ProgramPlace::Subprogram;
        Err(Error::BehindEnd)
    }

    /// Takes note that a line with the end of the program was refused: for the lines after it, the program has ended.
    pub fn note_end(&mut self) {
        if self.place == ProgramPlace::Program {
            self.place = ProgramPlace::End;
        }
    }

    /// Takes note of a refused line. If it has M2 or M30, also a computed one, the program has ended all the same. After
    /// the end of a program, the line begins a subprogram if it has an O number anywhere, or if its text is unknown
    /// (`None`), because it was too long, damaged, or had an open remark.
    #[cold]
    #[inline(never)]
    pub fn refused_line(&mut self, line: Option<&[u8]>) {
        if self.place == ProgramPlace::Program && line.is_some_and(may_end_program) {
            return self.note_end();
        }
        let may_have_number = line.is_none_or(|line| {
            let mut before = b' ';
            line.first() == Some(&b'<')
                || (0..line.len()).any(|at| {
                    let rest = line.get(at..).unwrap_or_default();
                    let begins_word = !before.is_ascii_uppercase();
                    before = rest.first().copied().unwrap_or_default();
                    begins_word && is_program_number(rest)
                })
        });
        if self.place == ProgramPlace::End && may_have_number {
            self.place = ProgramPlace::Subprogram;
        }
    }
}

/// Whether a line begins with the number of a program or subprogram, after its line number (N) if it has one. Further words
/// may follow, and the numbers need not be valid ones.
fn has_program_number(line: &[u8]) -> bool {
    is_program_number(line.strip_prefix(b"N").map_or(line, from_next_word))
}

/// Whether a text begins with O or a colon, and with no O word.
fn is_program_number(text: &[u8]) -> bool {
    let Some((b'O' | b':', number)) = text.split_first() else { return false };
    let word = from_next_word(number);
    let letters = word.iter().take_while(|byte| byte.is_ascii_uppercase()).count();
    !word.get(..letters).is_some_and(|word| O_WORDS.contains(&word))
}

/// Returns the part of a line from its first letter or colon on that is not in brackets.
fn from_next_word(line: &[u8]) -> &[u8] {
    let mut depth = 0_usize;
    let word = line.iter().position(|byte| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth == 0 && (byte.is_ascii_uppercase() || *byte == b':')
    });
    word.and_then(|at| line.get(at..)).unwrap_or_default()
}

/// The keywords of O words, also in the image that has none.
pub(super) const O_WORDS: [&[u8]; 15] = [
    b"SUB",
    b"ENDSUB",
    b"CALL",
    b"RETURN",
    b"IF",
    b"ELSEIF",
    b"ELSE",
    b"ENDIF",
    b"WHILE",
    b"ENDWHILE",
    b"DO",
    b"REPEAT",
    b"ENDREPEAT",
    b"BREAK",
    b"CONTINUE",
];

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
        for number in [
            ":1001",
            "N1:1001",
            "N10.5O1001",
            "N#1O1001",
            "N[2]O1",
            "O1001.0",
            "O1001.5",
            "O[1001]",
            "O#1",
            "O1001G1Z-3F100",
            "O1001M3",
            "O1001%",
            "O",
        ] {
            assert_eq!(taken(&["M30", number, "G1Z-3F100", "M99"]), [true, false, false, false], "{number}");
        }
        for end in ["IF[#1EQ1]M99", "IF#1EQ1THENM99", "M99", "N5M99P20", "/M99", "IF[#1EQ1]M30", "M30"] {
            assert_eq!(
                taken(&["M30", "O1001", end, "G1Z-3F100", "N20G1Z-4", "O1002", "M99"])[1..],
                [false; 6],
                "{end}"
            );
        }
    }

    #[test]
    fn a_refused_line_with_a_number_begins_a_subprogram() {
        for (line, begins) in [
            (Some("O1001CONTOUR"), true),
            (Some("G90O1001"), true),
            (Some("#1=1O1001"), true),
            (Some("%O1001"), true),
            (Some("<SUB1>"), true),
            (Some("10:1001"), true),
            (None, true),
            (Some("G1X5"), false),
            (Some("O<A>CALL[1"), false),
            (Some("N5O1ENDIF"), false),
            (Some("G0XROUND[1]"), false),
        ] {
            for place in [ProgramPlace::Program, ProgramPlace::End] {
                let mut interpreter = Interpreter::<3>::default();
                interpreter.place = place;
                interpreter.refused_line(line.map(str::as_bytes));
                let refuses = interpreter.look_behind_end(b"G1Z-3", true).is_err();
                assert_eq!(refuses, begins && place == ProgramPlace::End, "{line:?}");
            }
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
        for word in O_WORDS {
            assert!(!has_program_number(&[b"O1", word].concat()), "{word:?}");
        }
    }
}
