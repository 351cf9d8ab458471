//! Decides on lines after the end of a program (M2, M30): each line belongs to the next program, or to a subprogram
//! (`O1001` .. `M99`). Subprograms are held for calls by M98 and G65 (see `computed/subprograms.rs`); their lines are
//! not executed as they arrive. A build without subprograms refuses these lines.
//!
//! A *rest* is a pause in which the machine is idle and the host sends no line of a program. An O number begins the
//! next program (`O1001` .. `M30`) only if it follows one of these:
//! * a tape mark (`%`), a reset or `$X`,
//! * a rest right after the end of the program,
//! * a rest among subprograms, if the O number is that of the program before them: then the host sends the same file
//!   again.
//!
//! ```text
//!  Program ──M2, M30──▶ End ──O number──▶ Subprogram ──words outside of a subprogram, an error, $X,──▶ Refused
//!     ▲                  │                    │          a stop, an alarm                              │
//!     ├──O number after a rest                │                                                        │
//!     ├──words after a rest───────────────────┤                                                        │
//!     └──%, reset, another host───────────────┴──────────────────────── $X (not one that ends an alarm)┘
//! ```
//! A held program (one that calls an unknown subprogram) is dropped in the same cases as a subprogram, although its
//! place is still `Program`. When a program or subprogram has been dropped, the host can still send its remaining
//! lines, so they are refused. Three things do not end the refusal:
//! * a rest, and the `$X` that ends an alarm: the operator may only have looked at the machine before the sender
//!   continues;
//! * an M99: more lines of the same subprogram may follow, as targets of a GOTO.

use super::program_number::{has_program_number, has_return, may_have_program_number};
use super::state::{Interpreter, ProgramPlace};
use super::tools::may_have_m_word;
use crate::error::Error;
use crate::image::FULL_IMAGE;

impl<const N: usize> Interpreter<N> {
    /// Returns whether [`Interpreter::look_behind_end`] has to examine the host's next line. This is so after the end
    /// of a program until another one begins, and while a program is held until its subprogram has been received.
    #[inline]
    pub fn is_behind_end(&self) -> bool {
        self.place != ProgramPlace::Program || self.is_holding()
    }

    /// Returns the place of the host's next line relative to the end of a program.
    pub fn place(&self) -> ProgramPlace {
        self.place
    }

    /// Sets the place relative to the end of a program back to an earlier [`Interpreter::place`]. Call this after lines
    /// that do not belong to the host's program, such as startup lines.
    pub fn return_to(&mut self, place: ProgramPlace) {
        self.place = place;
    }

    /// Marks the next line as the start of a program. Drops a held program, and a subprogram that has not ended.
    pub fn begin_program(&mut self) {
        if self.is_held() {
            self.abandon_program();
        }
        self.computed.forget_number();
        self.place = ProgramPlace::Program;
    }

    /// Executes `$X`: the next line begins a program. But if the host is still sending a held program or its
    /// subprograms, the lines that follow are refused, up to another `$X`. `is_locked`: `true` if the `$X` ends an
    /// alarm; such a `$X` does not end a refusal. `rested`: `true` if the machine was idle before the `$X` and the
    /// host sent no line for a while. In this case no more subprograms are expected.
    #[cfg_attr(not(feature = "full"), allow(unused_variables, reason = "there are no subprograms"))]
    pub fn unlock(&mut self, is_locked: bool, rested: bool) {
        self.computed.end_modal_call();
        match self.place {
            _ if self.is_held() => self.abandon_program(),
            #[cfg(feature = "full")]
            ProgramPlace::Subprogram if !rested => self.place = ProgramPlace::Refused,
            ProgramPlace::Refused if is_locked => {}
            _ => self.place = ProgramPlace::Program,
        }
    }

    /// Examines a line that follows the end of a program, or that arrives while a program is held. `rested`: `true` if
    /// the machine was idle before the line and the host sent nothing for a while. Then an O number begins the next
    /// program, and the held program is incomplete, because no more lines of it will come.
    ///
    /// # Errors
    /// [`Error::OutOfPlace`] for lines that belong to no program.
    pub fn look_behind_end(&mut self, line: &[u8], rested: bool) -> Result<(), Error> {
        if line.is_empty() {
            return Ok(());
        }
        let begins = match self.place {
            _ if rested && self.is_held() => return Err(self.refuse_rest()),
            ProgramPlace::Program => return Ok(()),
            ProgramPlace::End if !has_program_number(line) => return Ok(()),
            ProgramPlace::End => rested,
            #[cfg(feature = "full")]
            ProgramPlace::Subprogram => rested && (!has_program_number(line) || self.begins_again(line)),
            // Lines that only switch spindle and coolant off are executed without `$X`, even after the program has
            // failed.
            ProgramPlace::Refused if switches_off(line) => return Ok(()),
            ProgramPlace::Refused => {
                self.computed.count_refused(line);
                false
            }
        };
        if begins {
            self.begin_program();
        } else if !self.look_among_subprograms(line) {
            return Err(self.refuse_rest());
        }
        Ok(())
    }

    /// Records that a line with M2 or M30 was refused. The lines after it are treated as lines after the end of a
    /// program.
    pub fn note_end(&mut self) {
        self.computed.end_modal_call();
        if self.place == ProgramPlace::Program {
            self.place = ProgramPlace::End;
        }
    }

    /// Records that block delete (`/`) has skipped a line. An M2 or M30 in the line ends the program all the same.
    /// After the end of a program, an O number in the line begins a subprogram, whose lines are refused. `rested`:
    /// `true` if the machine was idle before the line and the host sent nothing for a while; the O number then has no
    /// effect.
    pub fn skipped_line(&mut self, line: &[u8], rested: bool) {
        if may_end_program(line) {
            self.note_end();
        } else if self.place == ProgramPlace::End && !rested && has_program_number(line) {
            self.refuse_rest();
        }
    }

    /// Records that a line of the held text was refused while the text ran. The host's line that started the text is
    /// refused too. Among subprograms, the text is the program that has waited for them: the program ends, and all
    /// lines that follow are refused.
    #[cfg(feature = "full")]
    #[cold]
    #[inline(never)]
    pub fn refused_in_run(&mut self, line: &[u8]) {
        if self.place == ProgramPlace::Subprogram {
            self.refuse_rest();
        } else {
            self.refused_line(Some(line));
        }
    }

    /// Records that a line was refused. An M2 or M30 in the line, even a computed one, ends the program all the same.
    /// After the end of a program, an O number anywhere in the line begins a subprogram, which is refused. A line with
    /// unknown text (`None`: too long, damaged, or with an open comment) could contain an O number, so it has the same
    /// effect. An M99 in the line shows that the lines before it may have been a subprogram that was executed as the
    /// program. So all lines that follow are refused, unless lines are being recorded.
    #[cold]
    #[inline(never)]
    pub fn refused_line(&mut self, line: Option<&[u8]>) {
        if FULL_IMAGE && !self.is_recording() && line.is_some_and(has_return) {
            self.refuse_rest();
        }
        if self.place == ProgramPlace::Program && line.is_some_and(may_end_program) {
            return self.note_end();
        }
        if !matches!(self.place, ProgramPlace::Program | ProgramPlace::Refused)
            && line.is_none_or(may_have_program_number)
        {
            self.refuse_rest();
        }
    }
}

/// Returns whether a line only switches spindle and coolant off.
fn switches_off(line: &[u8]) -> bool {
    matches!(line, b"M5" | b"M05" | b"M9" | b"M09" | b"M5M9" | b"M9M5")
}

/// Returns whether a line has an M2 or M30, or may have one because the number of an M word is computed.
fn may_end_program(line: &[u8]) -> bool {
    may_have_m_word(line, &[2, 30])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gcode::{Dialect, Direction};
    use crate::image::FULL_IMAGE;

    /// Returns what happens to each line if the host makes no pause (*rest*) before it: `+` executed, `.` held, `-`
    /// refused.
    fn taken(lines: &[&str]) -> std::string::String {
        let mut interpreter = Interpreter::<3>::default();
        let take = |line: &&str| {
            let line = line.as_bytes();
            if line == b"%" {
                interpreter.tape_mark().unwrap();
                return '+';
            }
            let looked = interpreter.look_behind_end(line, false);
            match looked.and_then(|()| interpreter.direct(line, &[], 1)) {
                Ok(Direction::Check) => {
                    let action = interpreter.check(line, Dialect::Oxmill).unwrap();
                    interpreter.commit(&action);
                    '+'
                }
                Ok(_) => '.',
                Err(_) => '-',
            }
        };
        lines.iter().map(take).collect()
    }

    #[test]
    fn subprograms_behind_the_end_are_not_run() {
        let lines = ["O1000", "G0X1", "M30", "", "O1001", "G1Z-3F100", "", "#<M99>=2", "M99", "O1002", "M30", "G0Z1"];
        assert_eq!(taken(&lines), if FULL_IMAGE { "++++......--" } else { "++++--+-----" });
        let lines = ["M2", "G0Z5", "N10O1", "G0Z-3", "N20M99", "G0Z1"];
        assert_eq!(taken(&lines), if FULL_IMAGE { "++...-" } else { "++----" });
    }

    /// No line of a subprogram is executed, whatever number begins the subprogram, and wherever its M99 is.
    #[test]
    fn no_form_of_a_subprogram_is_run() {
        for number in [
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
            assert_eq!(taken(&["M30", number, "G1Z-3F100", "M99"]), "+---", "{number}");
        }
        for number in ["O1001", ":1001", "N1:1001", "O0001"] {
            let held = if FULL_IMAGE { "+...-" } else { "+----" };
            assert_eq!(taken(&["M30", number, "G1Z-3F100", "M99", "G1Z-3"]), held, "{number}");
        }
        for (end, full) in [
            ("IF[#1EQ1]M99", "+.-----"),
            ("IF#1EQ1THENM99", "+.-----"),
            ("M99", "+..----"),
            ("N5M99P20", "+.-----"),
            ("M30", "+.-----"),
        ] {
            let taken = taken(&["M30", "O1001", end, "G1Z-3F100", "N20G1Z-4", "O1002", "M99"]);
            assert_eq!(taken, if FULL_IMAGE { full } else { "+------" }, "{end}");
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
        assert_eq!(taken(&["%", "O1", "M30", "%", "O2", "G0X1", "M30"]), "+++++++");
        let mut interpreter = Interpreter::<3>::default();
        for end in ["M2", "M30"] {
            let action = interpreter.check(end.as_bytes(), Dialect::Oxmill).unwrap();
            interpreter.commit(&action);
            assert!(interpreter.is_behind_end());
            assert_eq!(interpreter.look_behind_end(b"O1", true), Ok(()));
            assert!(!interpreter.is_behind_end());
        }
        // A rest (a pause of the host) does not end a refusal: the sender may have paused to ask the operator whether
        // to continue.
        interpreter.place = ProgramPlace::End;
        assert_eq!(interpreter.look_behind_end(b"O1X5", false), Err(Error::OutOfPlace));
        assert_eq!(interpreter.look_behind_end(b"G0X1", true), Err(Error::OutOfPlace));
        interpreter.reset();
        assert!(!interpreter.is_behind_end());
    }
}
