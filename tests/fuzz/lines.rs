//! G-code as a host sends it, in each dialect: lines, remarks, expressions, parameters, O words. The first byte chooses the
//! dialect and whether block delete is on.
//!
//! Promises: a refused line changes nothing; every position stays within reach; what a line gives is a number; text that
//! is held comes to an end or goes on in bounded steps.

use oxmill_controller::gcode::{Checked, Dialect, Direction, Held, HeldLine, Interpreter};
use oxmill_controller::protocol::line::{self, Line, Pushed, Rules};

const AXES: usize = 3;
/// Lines that a program may execute: a loop has no end of its own.
const MOST_LINES: usize = 2_000;

struct Program {
    interpreter: Interpreter<AXES>,
    checked: Checked<AXES>,
    dialect: Dialect,
    lines: usize,
}

/// The target.
pub fn run(data: &[u8]) {
    let Some((first, text)) = data.split_first() else { return };
    let dialect = [Dialect::Oxmill, Dialect::Grbl, Dialect::Seed][usize::from(*first % 3)];
    let rules = || Rules {
        length: if dialect == Dialect::Grbl { line::GRBL_LENGTH } else { line::LENGTH },
        merge_crlf: dialect != Dialect::Grbl,
        nested_remarks: dialect == Dialect::Seed,
        expressions: dialect != Dialect::Grbl,
        block_delete: first & 0x40 != 0,
    };
    let mut program = Program { interpreter: Interpreter::new(), checked: Checked::NOTHING, dialect, lines: 0 };
    let mut line = Line::new();
    for byte in text {
        match line.push(*byte, rules) {
            Pushed::More => {}
            Pushed::TooLong => line.clear(),
            Pushed::Complete => {
                let text = line.text().to_vec();
                line.clear();
                program.line(&text);
            }
        }
        if program.lines > MOST_LINES {
            return;
        }
    }
}

impl Program {
    fn line(&mut self, text: &[u8]) {
        self.lines += 1;
        if text.is_empty() || text.starts_with(b"$") && !text.starts_with(b"$J=") {
            return;
        }
        if let Some(jog) = text.strip_prefix(b"$J=") {
            return self.jog(jog);
        }
        let direction = match self.dialect {
            Dialect::Grbl => Ok(Direction::Check),
            _ => self.interpreter.direct(text),
        };
        match direction {
            Ok(Direction::Check) => {
                self.carry_out(text);
            }
            Ok(Direction::Run) => self.run_held(),
            Ok(Direction::Done) | Err(_) => {}
        }
    }

    fn run_held(&mut self) {
        let mut held = HeldLine::new();
        while self.lines <= MOST_LINES {
            self.lines += 1;
            match self.interpreter.next_held(&mut held) {
                Ok(Held::Line) if !self.carry_out(&held.clone()) => return self.interpreter.abandon_held(),
                Ok(Held::Line | Held::Again) => {}
                Ok(Held::End) | Err(_) => return,
            }
        }
        self.interpreter.abandon_held();
    }

    fn jog(&mut self, text: &[u8]) {
        let before = (*self.interpreter.modal(), *self.interpreter.position());
        let checked = self.interpreter.check_jog_into(text, self.dialect, &mut self.checked);
        assert!(before == (*self.interpreter.modal(), *self.interpreter.position()), "a check changes nothing");
        if checked.is_ok() {
            self.interpreter.commit(&self.checked);
            assert!(before.0 == *self.interpreter.modal(), "a jog changes no modal state");
            self.look();
        }
    }

    fn carry_out(&mut self, text: &[u8]) -> bool {
        let before = (*self.interpreter.modal(), *self.interpreter.position());
        let result = self.interpreter.check_into(text, self.dialect, &mut self.checked);
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
