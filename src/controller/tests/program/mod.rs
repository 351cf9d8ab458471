//! Runs lines of programs for tests, and returns their actions and the positions in millimetres.
#![allow(dead_code, reason = "what a build leaves out uses a part of it")]

use oxmill_controller::axes::PerAxis;
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect, Interpreter, MotionCommand};
use oxmill_controller::units::{Coordinate, DECIMAL_ONE};

pub const DIALECTS: [Dialect; 3] = [Dialect::Grbl, Dialect::Oxmill, Dialect::Seed];

/// Returns a program in Oxmill's dialect, in millimetres and with a feed, that has run the lines of `setup`.
pub fn ready(setup: &str) -> Program {
    let mut program = Program::new(Dialect::Oxmill);
    program.run_all("G21 G90 F300");
    program.run_all(setup);
    program
}

/// Runs `setup` and then each line. Checks that a line leads to the machine position next to it, in mm.
pub fn play(setup: &str, lines: &[(&str, [f64; 3])]) -> Program {
    let mut program = ready(setup);
    for (line, place) in lines {
        program.run(line);
        let machine = program.machine();
        assert!(machine.iter().zip(place).all(|(a, b)| (a - b).abs() < 2.1e-7), "{line}: {machine:?}, not {place:?}");
    }
    program
}

/// An interpreter and the dialect of its lines.
#[derive(Clone)]
pub struct Program {
    pub interpreter: Interpreter<3>,
    pub dialect: Dialect,
}

impl Program {
    pub fn new(dialect: Dialect) -> Self {
        Self { interpreter: Interpreter::default(), dialect }
    }

    /// Checks a line without executing it. Removes blanks first, as the line filter does.
    pub fn check(&self, line: &str) -> Result<Action<3>, Error> {
        self.interpreter.check(line.replace(' ', "").as_bytes(), self.dialect)
    }

    /// Checks and executes a line. Panics if the line is refused.
    pub fn run(&mut self, line: &str) -> Action<3> {
        let mut action = Action::NOTHING;
        let text = line.replace(' ', "");
        let check = self.interpreter.check_into(text.as_bytes(), self.dialect, &mut action);
        check.unwrap_or_else(|error| panic!("{line}: {error:?}"));
        self.interpreter.commit(&action);
        action
    }

    /// Checks and executes the lines of a text, without the empty ones.
    pub fn run_all(&mut self, lines: &str) {
        for line in lines.lines().map(str::trim).filter(|line| !line.is_empty()) {
            self.run(line);
        }
    }

    /// Returns the error number of a line; 0 for a correct line.
    pub fn error(&self, line: &str) -> u8 {
        match self.check(line) {
            Ok(_) => 0,
            Err(error) => error.code(),
        }
    }

    /// Returns the machine position in mm.
    pub fn machine(&self) -> [f64; 3] {
        in_mm(self.interpreter.position())
    }

    /// Returns the position of the tool in the coordinates that a program would write, in mm.
    pub fn written(&self) -> [f64; 3] {
        in_mm(&self.interpreter.to_program(self.interpreter.position()))
    }

    /// Returns the work position in mm.
    pub fn work(&self) -> [f64; 3] {
        in_mm(&self.interpreter.position().zip(&self.interpreter.work_offset(), |position, offset| position - offset))
    }
}

/// Converts a position to mm. Numbers in tests have at most seven decimals, so the division gives exactly the `f64` of
/// such a number.
pub fn in_mm(place: &PerAxis<Coordinate, 3>) -> [f64; 3] {
    place.0.map(|coordinate| coordinate.0 as f64 / DECIMAL_ONE as f64)
}

pub fn target(action: &Action<3>) -> [f64; 3] {
    match action.motion {
        MotionCommand::None => panic!("no motion"),
        MotionCommand::Cycle(_) => in_mm(action.position()),
        MotionCommand::Line { target, .. } | MotionCommand::Probe { target, .. } => in_mm(&target),
        MotionCommand::Arc(arc) => in_mm(&arc.target),
        MotionCommand::Spline(spline) => in_mm(&spline.target),
        MotionCommand::Nurbs(nurbs) => in_mm(&nurbs.target),
    }
}

pub fn via(action: &Action<3>) -> Option<[f64; 3]> {
    match action.motion {
        MotionCommand::Line { via, .. } => via.map(|via| in_mm(&via)),
        _ => panic!("no straight move"),
    }
}
