//! A host that sends programs to the interpreter, for the tests of O words and subprograms.

use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect, Direction, Flow, Held, HeldLine, Interpreter, MotionCommand};

/// A host that sends a file. Records the X target (mm) of each straight move, the error numbers, and the number of
/// program ends.
pub struct Sender {
    pub interpreter: Interpreter<3>,
    pub went: Vec<i64>,
    pub errors: Vec<u8>,
    pub ends: usize,
    pub sent: u32,
    /// `true` if the machine has been idle for so long that the next line may belong to another program.
    pub rested: bool,
    /// X targets of moves in lines that were executed on arrival, not stored first.
    pub at_once: Vec<i64>,
    /// Motion, dwell and modal state of each executed line as text, if the test needs them.
    pub acts: Option<Vec<String>>,
}

impl Sender {
    pub fn new() -> Self {
        Self {
            interpreter: Interpreter::default(),
            went: Vec::new(),
            errors: Vec::new(),
            ends: 0,
            sent: 0,
            rested: false,
            at_once: Vec::new(),
            acts: None,
        }
    }

    pub fn check(&mut self, line: &[u8]) -> Result<Action<3>, Error> {
        let mut checked = Action::NOTHING;
        self.interpreter.check_into(line, Dialect::Oxmill, &mut checked).map(|()| checked)
    }

    pub fn carry_out(&mut self, line: &[u8]) -> bool {
        match self.check(line) {
            Ok(checked) => {
                if let Some(acts) = &mut self.acts {
                    acts.push(format!("{:?} {:?} {:?}", checked.motion, checked.dwell, checked.modal()));
                }
                if let MotionCommand::Line { target, .. } = checked.motion {
                    self.went.push(target.0[0].0 / 10_000_000);
                }
                self.ends += usize::from(checked.flow == Flow::End);
                self.interpreter.commit(&checked);
                true
            }
            Err(error) => {
                self.errors.push(error.code());
                false
            }
        }
    }

    /// Executes a line that is not part of the host's program, such as a startup line.
    pub fn commit_apart(&mut self, action: &Action<3>) {
        let place = self.interpreter.place();
        self.interpreter.commit(action);
        self.interpreter.return_to(place);
    }

    pub fn run_held(&mut self) {
        let mut held = HeldLine::new();
        loop {
            match self.interpreter.next_held(&mut held) {
                Ok(Held::Line) => {
                    if !self.carry_out(&held) {
                        self.interpreter.abandon_held();
                        return self.interpreter.refused_in_run(&held);
                    }
                }
                Ok(Held::Again) => {}
                Ok(Held::End) => return,
                Err(error) => {
                    self.errors.push(error.code());
                    return self.interpreter.refused_in_run(&held);
                }
            }
        }
    }

    pub fn send(&mut self, line: &str) {
        let line: String = line.split(['(', ';']).next().unwrap().replace(' ', "").to_uppercase();
        self.sent += 1;
        if line == "%" {
            if let Err(error) = self.interpreter.tape_mark() {
                self.errors.push(error.code());
            }
            return;
        }
        let line = line.as_bytes();
        let rested = std::mem::take(&mut self.rested);
        let looked = self.interpreter.look_behind_end(line, rested);
        let directed = match looked.and_then(|()| self.interpreter.direct(line, &[], self.sent)) {
            Ok(Direction::Check) => match self.check(line) {
                Ok(_) => Ok(Direction::Check),
                Err(error) => self.interpreter.direct_refused(line, &[], error),
            },
            directed => directed,
        };
        match directed {
            Ok(Direction::Check) => {
                let before = self.went.len();
                self.carry_out(line);
                self.at_once.extend_from_slice(&self.went[before..]);
            }
            Ok(Direction::Done | Direction::LeftOut) => {}
            Ok(Direction::Call | Direction::Run) => self.run_held(),
            Err(error) => {
                self.errors.push(error.code());
                self.interpreter.refused_line(Some(line));
                self.interpreter.line_refused(error);
            }
        }
    }

    pub fn send_after_rest(&mut self, text: &str) -> &mut Self {
        self.rested = true;
        self.send_all(text)
    }

    pub fn send_all(&mut self, text: &str) -> &mut Self {
        text.lines().for_each(|line| self.send(line));
        self
    }
}

/// Checks that a file has no errors, moves to these X targets, and ends its program once.
#[track_caller]
pub fn goes(text: &str, places: &[i64]) {
    let mut sender = Sender::new();
    sender.send_all(text);
    assert_eq!((sender.went, sender.errors, sender.ends), (places.to_vec(), vec![], 1), "{text}");
}

/// Checks the error numbers that a file causes, and the X targets that it moves to nevertheless.
#[track_caller]
pub fn fails(text: &str, errors: &[u8], places: &[i64]) {
    let mut sender = Sender::new();
    sender.send_all(text);
    assert_eq!((sender.errors, sender.went), (errors.to_vec(), places.to_vec()), "{text}");
}

pub fn with_macro(lines: &[&str]) -> Sender {
    let mut sender = Sender::new();
    for (index, line) in lines.iter().enumerate() {
        sender.interpreter.set_macro_line(index, line.as_bytes()).unwrap();
    }
    sender
}

/// Returns a file whose program goes to X1, calls the subprogram O1 with the lines of `body`, and goes to X9.
pub fn calling(body: &str) -> String {
    format!("G0 X1\nM98 P1\nX9\nM30\nO1\n{body}\nM99\n%")
}
