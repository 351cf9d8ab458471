//! Fuzz target: G-code as a host sends it, in the dialects Oxmill, Grbl and Seed. The text has lines, comments,
//! expressions, parameters, O words, and lines of macros. The first byte chooses the dialect, block delete on or off,
//! and a fourth axis or none.
//!
//! Invariants:
//! - A rejected line changes nothing.
//! - Every position stays within range.
//! - Every value that a line yields is a finite number.
//! - Each stored line of a subroutine, loop or macro is carried out with a bounded amount of work.

use super::work::at_most;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{
    AS_WRITTEN, Action, Dialect, Direction, Held, HeldLine, Interpreter, WITH_VALUES, split_comment,
};
use oxmill_controller::protocol::line_filter::{self, Line, LineRules, Pushed};

/// X, Y, Z and A; the first byte can disable A.
const AXES: usize = 4;
/// Maximum number of control-flow edges in a call. The highest count in 20 million executions was 5,120, in a call
/// that looked for its subroutine in a full store of macros.
const MOST_WORK: u64 = 20_000;
/// Maximum number of lines that a program executes, because it can contain an endless loop.
const MOST_LINES: usize = 2_000;

struct Program {
    interpreter: Interpreter<AXES>,
    checked: Action<AXES>,
    dialect: Dialect,
    lines: usize,
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let Some((first, text)) = data.split_first() else { return };
    let dialect = [Dialect::Oxmill, Dialect::Grbl, Dialect::Seed][usize::from(*first % 3)];
    let rules = || LineRules {
        length: if dialect == Dialect::Grbl { line_filter::GRBL_LENGTH } else { line_filter::LENGTH },
        merge_crlf: dialect != Dialect::Grbl,
        nested_comments: dialect != Dialect::Grbl,
        expressions: dialect != Dialect::Grbl,
        block_delete: first & 0x40 != 0,
    };
    let mut program = Program { interpreter: Interpreter::default(), checked: Action::NOTHING, dialect, lines: 0 };
    program.interpreter.set_axes(if first & 0x20 != 0 { AXES } else { 3 });
    let mut line = Line::new();
    for byte in text {
        match line.push(*byte, rules) {
            Pushed::More => {}
            Pushed::TooLong => line.clear(),
            Pushed::Complete => {
                let text = line.text().to_vec();
                let comment = line.message().map_or_else(Vec::new, |(has_values, text)| {
                    [&[if has_values { WITH_VALUES } else { AS_WRITTEN }], text].concat()
                });
                line.clear();
                program.line(&text, &comment);
            }
        }
        if program.lines > MOST_LINES {
            return;
        }
    }
}

impl Program {
    fn line(&mut self, text: &[u8], comment: &[u8]) {
        self.lines += 1;
        if let Some((number, words)) = macro_line(text).filter(|_| self.dialect != Dialect::Grbl) {
            let _ = self.interpreter.set_macro_line(number, words);
            return;
        }
        if text.is_empty() && comment.is_empty() || text.starts_with(b"$") && !text.starts_with(b"$J=") {
            return;
        }
        if let Some(jog) = text.strip_prefix(b"$J=") {
            return self.jog(jog);
        }
        let direction = match self.dialect {
            Dialect::Grbl => Ok(Direction::Check),
            _ if text.starts_with(b"%") => {
                let _ = self.interpreter.tape_mark();
                return;
            }
            _ => at_most(MOST_WORK, || {
                self.interpreter.look_behind_end(text, false)?;
                self.interpreter.direct(text, comment, self.lines as u32)
            }),
        };
        match direction {
            Ok(Direction::Check) => {
                if self.carry_out(text) {
                    self.tell(comment);
                } else if self.dialect != Dialect::Grbl
                    && self.interpreter.direct_refused(text, comment, Error::NotSupported) == Ok(Direction::Run)
                {
                    self.run_held();
                }
            }
            Ok(Direction::Run | Direction::Call) => self.run_held(),
            Ok(Direction::Done | Direction::LeftOut) | Err(_) => {}
        }
    }

    fn run_held(&mut self) {
        let mut held = HeldLine::new();
        while self.lines <= MOST_LINES {
            self.lines += 1;
            match at_most(MOST_WORK, || self.interpreter.next_held(&mut held)) {
                Ok(Held::Line) => {
                    let line = held.clone();
                    let (words, comment) = split_comment(&line);
                    if !words.is_empty() && !self.carry_out(words) {
                        return self.interpreter.abandon_held();
                    }
                    self.tell(comment);
                }
                Ok(Held::Again) => {}
                Ok(Held::End) | Err(_) => return,
            }
        }
        self.interpreter.abandon_held();
    }

    fn tell(&self, comment: &[u8]) {
        if let Some((&WITH_VALUES, written)) = comment.split_first() {
            let mut text = heapless::Vec::<u8, 128>::new();
            self.interpreter.expand(written, &mut text);
        }
    }

    fn jog(&mut self, text: &[u8]) {
        let before = (*self.interpreter.modal(), *self.interpreter.position());
        let checked = at_most(MOST_WORK, || self.interpreter.check_jog_into(text, self.dialect, &mut self.checked));
        assert!(before == (*self.interpreter.modal(), *self.interpreter.position()), "a check changes nothing");
        if checked.is_ok() {
            self.interpreter.commit(&self.checked);
            assert!(before.0 == *self.interpreter.modal(), "a jog changes no modal state");
            self.look();
        }
    }

    fn carry_out(&mut self, text: &[u8]) -> bool {
        let before = (*self.interpreter.modal(), *self.interpreter.position());
        let result = at_most(MOST_WORK, || self.interpreter.check_into(text, self.dialect, &mut self.checked));
        assert!(before == (*self.interpreter.modal(), *self.interpreter.position()), "a check changes nothing");
        if result.is_err() {
            return false;
        }
        assert!(self.checked.speed.is_finite() && self.checked.speed >= 0.0, "S {}", self.checked.speed);
        assert!(self.checked.digit.is_finite() && self.checked.digit >= 0.0, "digit {}", self.checked.digit);
        self.interpreter.commit(&self.checked);
        self.look();
        true
    }

    fn look(&self) {
        assert!(self.interpreter.position().iter().all(|place| place.in_range()), "a position out of reach");
    }
}

/// Returns the number and the text of a `$Mn=` line.
fn macro_line(text: &[u8]) -> Option<(usize, &[u8])> {
    let text = text.strip_prefix(b"$M")?;
    let end = text.iter().position(|byte| *byte == b'=')?;
    let number = std::str::from_utf8(&text[..end]).ok()?.parse().ok()?;
    Some((number, &text[end + 1..]))
}
