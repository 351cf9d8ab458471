//! Tests of subprograms: M98, G65 and M99. The lines of a subprogram run when it is called, and never otherwise.
#![cfg(feature = "full")]

use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Action, Dialect, Direction, Flow, Held, HeldLine, Interpreter, MotionCommand};
use proptest::prelude::*;

/// A host that sends a file. Records the X target of every straight move, the error numbers, and the ends of programs.
struct Sender {
    interpreter: Interpreter<3>,
    went: Vec<i64>,
    errors: Vec<u8>,
    ends: usize,
    sent: u32,
    /// Whether the machine rests before the next line.
    rested: bool,
    /// X targets of moves in lines that ran as they came.
    at_once: Vec<i64>,
    /// What the lines do, if it is wanted.
    acts: Option<Vec<String>>,
}

impl Sender {
    fn new() -> Self {
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

    fn check(&mut self, line: &[u8]) -> Result<Action<3>, Error> {
        let mut checked = Action::NOTHING;
        self.interpreter.check_into(line, Dialect::Oxmill, &mut checked).map(|()| checked)
    }

    fn carry_out(&mut self, line: &[u8]) -> bool {
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

    /// Executes a line that is not one of the host's program.
    fn commit_apart(&mut self, action: &Action<3>) {
        let place = self.interpreter.place();
        self.interpreter.commit(action);
        self.interpreter.return_to(place);
    }

    fn run_held(&mut self) {
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

    fn send(&mut self, line: &str) {
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

    fn send_after_rest(&mut self, text: &str) -> &mut Self {
        self.rested = true;
        self.send_all(text)
    }

    fn send_all(&mut self, text: &str) -> &mut Self {
        text.lines().for_each(|line| self.send(line));
        self
    }
}

/// Checks the X targets of a file without errors, which ends its program once.
#[track_caller]
fn goes(text: &str, places: &[i64]) {
    let mut sender = Sender::new();
    sender.send_all(text);
    assert_eq!((sender.went, sender.errors, sender.ends), (places.to_vec(), vec![], 1), "{text}");
}

/// Checks the errors of a file, and the X targets that it still reaches.
#[track_caller]
fn fails(text: &str, errors: &[u8], places: &[i64]) {
    let mut sender = Sender::new();
    sender.send_all(text);
    assert_eq!((sender.errors, sender.went), (errors.to_vec(), places.to_vec()), "{text}");
}

#[test]
fn the_usual_file() {
    goes(
        "%\nO1000 (PART)\nG21 G90\nG0 X1\nM98 P1001\nG0 X9\nM98 P1001\nM30\nO1001 (POCKET)\nG0 X2\nG0 X3\nM99\n%",
        &[1, 2, 3, 9, 2, 3],
    );
    goes("N1 :1000\nN2 G0 X1\nN3 M98 P7\nN4 M2\n\nN5 :0007\n\nN6 X2\nN7 M099\n%", &[1, 2]);
    // Two subprograms, in either order, one of which calls the other.
    for definitions in [["O1\nX2\nM98 P2\nX3\nM99\n", "O2\nX5\nM99\n"], ["O2\nX5\nM99\n", "O1\nX2\nM98 P2\nX3\nM99\n"]]
    {
        goes(&format!("G0 X1\nM98P1\nM98P2\nX9\nM30\n{}%\n", definitions.concat()), &[1, 2, 5, 3, 5, 9]);
    }
    // Subprograms that nothing calls.
    goes("G0 X1\nM30\nO5\nG1 X-3 F100\nM99\nO6\nX7\nM99\n%", &[1]);
    goes("G0 X1\nM98 P6\nM30\nO5\nG1 X-3 F100\nM99\nO6\nX7\nM99\nO8\nX8\nM99\n%", &[1, 7]);
}

#[test]
fn repeats() {
    goes("G91 G0 X1\nM98 P1 L3\nM30\nO1\nX2\nM99", &[1, 3, 5, 7]);
    goes("G0 X1\nM98 L2 P1\nM30\nO1\nX2\nM98 P2 L2\nM99\nO2\nX5\nM99", &[1, 2, 5, 5, 2, 5, 5]);
    // A return from within a condition begins the next pass, too.
    goes("M98 P1 L2\nM30\nO1\nG0 X1\no5 if [1]\nM99\no5 endif\nX2\nM99", &[1, 1]);
    goes("#5=2\nM98 P[0.5*2] L#5\nM30\nO1\nG0 X1\nM99", &[1, 1]);
    for (words, error) in [
        ("", 28),
        ("L2", 28),
        ("P1 L0", 39),
        ("P1 L-1", 39),
        ("P1 L10000", 39),
        ("P1.5", 23),
        ("P1 L1.5", 23),
        ("P-1", 4),
        ("P123456789", 39),
        ("P1 P1", 25),
        ("P1 L1 L1", 25),
        ("P1 X5", 36),
        ("P1 G0", 36),
        ("P1=2", 1),
        ("P", 2),
    ] {
        fails(&format!("M98 {words}\nG0 X1"), &[error], &[1]);
    }
}

#[test]
fn parameters() {
    // M98 shares the parameters of its caller.
    goes("#1=5\nM98 P1\nG0 X#1\nM30\nO1\nG0 X#1\n#1=[#1+1]\nM99", &[5, 6]);
    // G65 has parameters of its own.
    goes("#1=5 #2=7\nG65 P1 A2\nG0 X#1\nM30\nO1\nG0 X#1\nX#2\n#1=9\nM99", &[2, 0, 5]);
    let letters = "ABCIJKDEFHMQRSTUVWXYZ";
    let numbers = [1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 13, 17, 18, 19, 20, 21, 22, 23, 24, 25, 26];
    for (letter, number) in letters.chars().zip(numbers) {
        goes(&format!("G65 P1 {letter}42\nM30\nO1\nG0 X#{number}\nM99"), &[42]);
    }
    goes("#5=3\nG65 A-2.0 B[#5*2] P1 C#5 DSQRT[16]\nM2\nO1\nG0 X#1\nX#2\nX#3\nX#7\nM99", &[-2, 6, 3, 4]);
    // What the first pass has set, the next pass finds.
    goes("G65 P1 L3 A1\nM2\nO1\nG0 X#1\n#1=[#1+1]\nM99", &[1, 2, 3]);
    goes("G65 P1 A1\nM2\nO1\nG0 X#1\nG65 P2 A[#1+1]\nX#1\nM99\nO2\nX#1\nM98 P3\nM99\nO3\nX[#1+5]\nM99", &[1, 2, 7, 1]);
    for (words, error) in [("P1 A1 A2", 25), ("P1 I1 J2 I3", 25), ("P1 G5", 36), ("P1 N5", 36), ("P1 A", 2), ("A1", 28)]
    {
        fails(&format!("G65 {words}\nG0 X1"), &[error], &[1]);
    }
}

#[test]
fn subroutines_and_macros() {
    goes("o7 sub\nG0 X#1\nM99\nX9\no7 endsub\nM98 P7\nG65 P7 A4\no7 call [5]\nM2", &[0, 4, 5]);
    goes("G0 X1\nM98 P7\no7 call [5]\nM2\nO7\nX#1\nM99", &[1, 0, 5]);
    // A macro calls a subprogram that is not known: the program waits in the middle of the call.
    let mut sender = with_macro(&["O9000SUB", "G0X1", "M98P5", "G0X3", "O9000ENDSUB"]);
    sender.send_all("o9000 call\nG0 X4");
    assert_eq!(sender.went, [1]);
    assert_eq!(sender.interpreter.awaited_subprogram(), Some(5));
    sender.send_all("M30\nO5\nX2\nM99\n%");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1, 2, 3, 4][..], &[][..]));
    assert_eq!(sender.interpreter.macro_line(4), Some(&b"O9000ENDSUB"[..]));
    // From a startup line, nothing can follow.
    assert_eq!(sender.interpreter.begin_call(b"O9000CALL"), Ok(true));
    sender.went.clear();
    sender.run_held();
    assert_eq!((sender.went, sender.errors), (vec![1], vec![203]));
    assert!(!sender.interpreter.is_within_block());
}

fn with_macro(lines: &[&str]) -> Sender {
    let mut sender = Sender::new();
    for (index, line) in lines.iter().enumerate() {
        sender.interpreter.set_macro_line(index, line.as_bytes()).unwrap();
    }
    sender
}

/// A macro with the number of a subprogram is no subprogram of the file, whose own comes behind its end.
#[test]
fn a_macro_does_not_take_the_place_of_a_subprogram() {
    let macro_lines = ["O100SUB", "G0X-1", "O100ENDSUB"];
    for call in ["M98 P100", "G65 P100 A1", "G0 X1 M98 P100", "o2 sub\nM98 P100\no2 endsub\no2 call"] {
        let mut sender = with_macro(&macro_lines);
        sender.send_all(&format!("{call}\nG0 X9\nM30\nO100\nG0 X5\nM99\n%"));
        assert!(sender.went.ends_with(&[5, 9]) && !sender.went.contains(&-1), "{call}: {:?}", sender.went);
        assert!(sender.errors.is_empty(), "{call}: {:?}", sender.errors);
        sender.send_all("M98 P100\nM30\n%");
        assert_eq!((sender.errors.as_slice(), sender.went.contains(&-1)), (&[203][..], false), "{call}");
        sender.send("o100 call");
        assert_eq!(sender.went.last(), Some(&-1));
    }
}

/// Definitions end with their file, whether or not its program has called them.
#[test]
fn definitions_end_with_their_file() {
    type Way = (&'static str, fn(&mut Sender));
    let ends: [Way; 4] = [
        ("a tape mark", |sender| sender.send("%")),
        ("$X", |sender| {
            sender.interpreter.unlock(false, false);
            sender.interpreter.unlock(false, false);
        }),
        ("a rest", |sender| sender.rested = true),
        ("another host", |sender| {
            sender.interpreter.abandon_program();
            sender.interpreter.begin_program();
        }),
    ];
    for (name, end) in ends {
        for file in [
            "G0 X1\nM30\nO1\nG0 X-3\nM99",
            "G0 X1\nM98 P2\nM30\nO1\nG0 X-3\nM99\nO2\nM99\nO3\nX-4\nM99",
            "G0 X1\nM98 P2\nM30\nO2\nM99\nO1\nG0 X-3\nM99",
        ] {
            let mut sender = Sender::new();
            sender.send_all(file);
            end(&mut sender);
            sender.send_all("G0 X2\nM98 P1\nG0 X4\nM30\n%");
            assert_eq!((sender.went, sender.errors), (vec![1, 2], vec![203]), "{name}: {file}");
        }
    }
    // After an error in the run, too.
    for error in ["X", "M98 P1 L0", "o7 call"] {
        let mut sender = Sender::new();
        sender.send_all(&format!("M98 P5\nM30\nO1\nG0 X-3\nM99\nO5\nG0 X1\n{error}\nM99\nO2\nG0 X-3\nM99\n%"));
        assert_eq!(sender.errors[1..], [203; 3], "{error}");
        sender.errors.clear();
        sender.send_all("M98 P1\nM30\n%\nM98 P2\nM30\n%");
        assert_eq!((sender.went, sender.errors), (vec![1], vec![203, 203]), "{error}");
    }
}

/// Whatever is wrong in a subprogram, the rest of it is no program, even after a rest.
#[test]
fn a_refused_subprogram_is_no_program_after_a_rest() {
    for program in ["G0 X1\nM30\n", "G0 X1\nM98 P1\nM30\n"] {
        for error in ["o7 sub", "o8 endsub", "M99 P5", "GOTO", "M30", "O2 X5", "o7 if", "o1"] {
            let mut sender = Sender::new();
            sender.send_all(&format!("{program}O1\nG0 X-2\n{error}"));
            let errors = sender.errors.len();
            assert_eq!(errors, 1, "{error}");
            for _ in 0..3 {
                sender.send_after_rest("G0 X-3\nM99\nG0 X-4");
            }
            assert!(sender.errors.len() >= errors + 9 && sender.went.len() <= 1, "{error}: {:?}", sender.went);
            sender.send_all("%\nG0 X9");
            assert_eq!(sender.went.last(), Some(&9));
        }
        // A line that is refused before anybody reads it.
        let mut sender = Sender::new();
        sender.send_all(&format!("{program}O1\nG0 X-2"));
        sender.interpreter.refused_line(None);
        sender.interpreter.line_refused(Error::LineTooLong);
        sender.send_after_rest("G0 X-3\nM99");
        assert_eq!(sender.errors, [203, 203]);
    }
    // Between two subprograms such a line can be a number.
    let mut sender = Sender::new();
    sender.send_all("G0 X1\nM30\nO1\nG0 X-2\nM99");
    sender.interpreter.refused_line(None);
    sender.interpreter.line_refused(Error::LineTooLong);
    sender.send_after_rest("G0 X-3\nM99");
    assert_eq!((sender.errors, sender.went), (vec![203, 203], vec![1]));
}

/// A line with M30 that is refused or skipped ends the program all the same.
#[test]
fn a_refused_end_is_an_end() {
    for (end, errors) in [
        ("M98 P1 M30", &[36][..]),
        ("G65 P1 A M30", &[2]),
        ("o7 call M30", &[81]),
        ("X5 X5 M[28+2]", &[25]),
        ("M99.0", &[121, 203, 203, 203]),
        ("o1 if [0]\nM30", &[81, 203, 203]),
        ("o7 sub\nM30", &[81, 203, 203]),
        ("o7 sub\nX5 X5 M30\no7 endsub\no7 call", &[25]),
    ] {
        fails(&format!("G0 X1\n{end}\nO1\nX-3\nM99\n%\nX9"), errors, &[1, 9]);
    }
}

/// A rest while lines are held: the next line can be that of another file.
#[test]
fn a_rest_drops_a_held_program() {
    for held in ["M98 P8", "M98 P8\nG0 X2\nM30", "M98 P8\nM30\nO9\nG0 X-2", "M98 P9\nM98 P8\nM30\nO9\nM99", "M30\nO9"] {
        let mut sender = Sender::new();
        sender.send_all(held);
        assert!(sender.errors.is_empty(), "{held}: {:?}", sender.errors);
        // Remarks do not count.
        sender.rested = true;
        sender.send("(PART)");
        sender.send_after_rest("G21\nG0 X3\nO8\nG0 X4\nM99\nM30");
        assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 6][..], &[][..]), "{held}");
        sender.send_all("%\nG0 X9\nM30");
        assert_eq!((sender.errors.len(), sender.went), (6, vec![9]), "{held}");
    }
}

/// `$X`, a stop and an alarm drop what is held, and refuse the rest of it, which the host can still send.
#[test]
fn what_is_dropped_does_not_go_on_as_a_program() {
    type Way = (&'static str, fn(&mut Interpreter<3>));
    let ways: [Way; 3] = [
        ("$X", |interpreter| interpreter.unlock(false, false)),
        ("a stop", |interpreter| interpreter.abandon_program()),
        ("an alarm", |interpreter| {
            interpreter.abandon_program();
            interpreter.unlock(true, false);
        }),
    ];
    for (name, drop) in ways {
        for held in
            ["M98 P8", "M98 P8\nG0 X2\nM30", "M98 P8\nM30\nO9\nG0 X-2", "M98 P9\nM98 P8\nM30\nO9\nM99", "M30\nO9"]
        {
            let mut sender = Sender::new();
            sender.send_all(held);
            drop(&mut sender.interpreter);
            assert!(!sender.interpreter.is_within_block(), "{name}: {held}");
            let before = sender.interpreter.clone();
            sender.send_all("G0 X-3\nM99\nO8\nG0 X-4\nM99");
            sender.send_after_rest("G0 X-3");
            assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 6][..], &[][..]), "{name}: {held}");
            sender.interpreter.unlock(false, false);
            sender.send("G0 X9");
            assert_eq!(sender.went, [9], "{name}: {held}");
            // A rest does not begin the next program: the operator may have looked at the machine.
            let mut sender = Sender { interpreter: before, ..Sender::new() };
            sender.send_after_rest("O1000\nG0 X-9");
            assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 2][..], &[][..]), "{name}: {held}");
            sender.send_all("%\nO1000\nG0 X9\nM30");
            assert_eq!((sender.went, sender.errors.len()), (vec![9], 2), "{name}: {held}");
        }
    }
}

/// An alarm in a subprogram, such as that of a probe without contact: neither its `$X` nor a rest makes a program of the
/// subprograms that follow.
#[test]
fn an_alarm_in_a_subprogram_refuses_the_next_ones() {
    for refused in ["", "O2"] {
        let mut sender = Sender::new();
        sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
        sender.interpreter.abandon_program();
        if !refused.is_empty() {
            sender.interpreter.refused_line(Some(refused.as_bytes()));
        }
        sender.interpreter.unlock(true, false);
        sender.send_after_rest("O2\nG0 X-3\nM99\nX-4");
        assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 4][..], &[1][..]), "{refused}");
        sender.interpreter.unlock(false, false);
        sender.send("G0 X9");
        assert_eq!(sender.went, [1, 9]);
    }
    // A stop, after which nothing needs to be unlocked.
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.interpreter.abandon_program();
    sender.send_all("O2\nG0 X-3\nM99\nX-4");
    assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 4][..], &[1][..]));
}

/// M99 without a call means that a subprogram has run as the program, wherever the M99 is.
#[test]
fn a_return_without_a_call_refuses_the_rest() {
    for (line, error) in [
        ("M99", 203),
        ("o1 repeat [1]\nM99\no1 endrepeat", 203),
        ("M98 P2 M99", 36),
        ("o7 call M99", 81),
        ("X5 X5 M99.0", 25),
        ("G0 X5 M99", 203),
    ] {
        fails(&format!("O1001\nG0 X1\n{line}\nO1002\nG0 X-3"), &[error, 203, 203], &[1]);
    }
    // Not a return: names and values.
    fails("#<M99>=1\nX5 X5 F[#<M99>*99]\nG0 X2", &[25], &[2]);
}

/// A line with M30 that block delete skips ends the program all the same; other M words do not.
#[test]
fn a_skipped_end_is_an_end() {
    for (end, rested) in [("M30", false), ("N5M2", true)] {
        let mut sender = Sender::new();
        sender.send("G0 X1");
        sender.interpreter.skipped_line(end.as_bytes(), rested);
        sender.send_all("O1001\nG0 X-3\nM99\nX-4");
        assert_eq!((sender.errors, sender.went), (vec![203], vec![1]));
        // A program that goes on.
        let mut sender = Sender::new();
        sender.interpreter.skipped_line(end.as_bytes(), rested);
        sender.send_all("G0 X2\nM30");
        assert_eq!((sender.errors, sender.went), (vec![], vec![2]));
    }
}

/// Lines after a held end of the program are those of the next one, also if they are calls.
#[test]
fn calls_after_a_held_end_are_not_lost() {
    fails("M98 P1\nM30\nM98 P2\nG0 X5\nM30\nO1\nG0 X1\nM99", &[203; 6], &[]);
    fails("o1 if [0]\nM30\nM98 P2\no1 endif\nG0 X1", &[81, 81], &[1]);
    fails("G0 X1\nM30 M98 P1\nO1\nG0 X-3\nM99", &[121], &[1]);
    fails("M98 P1\nM30 M98 P2\nO1\nG0 X-3\nM99", &[203; 4], &[]);
}

/// A state that M73 saves in a pass of G65 is restored at the end of the pass.
#[test]
fn each_pass_of_a_macro_restores_its_state() {
    for call in ["G65 P1", "G65 P1 L2", "G65 P1 L5"] {
        let mut sender = Sender::new();
        sender.send_all(&format!("G90\no1 sub\nM73\nG91 G0 X1\no1 endsub\n{call}\nG0 X0\nM2"));
        assert_eq!((sender.went.last(), sender.errors.as_slice()), (Some(&0), &[][..]), "{call}: {:?}", sender.went);
    }
}

/// A startup line does not begin or end a program of the host.
#[test]
fn startup_lines_leave_the_place() {
    let mut sender = Sender::new();
    sender.send_all("G0 X1\nM30");
    for line in [&b"G54"[..], b"M30"] {
        let action = sender.check(line).unwrap();
        sender.commit_apart(&action);
    }
    sender.send_all("O1\nG0 X-3\nM99\nX-4");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1][..], &[203][..]));
    // A call among subprograms.
    let mut sender = with_macro(&["O9000SUB", "G0X1", "O9000ENDSUB"]);
    sender.send_all("M30\nO1\nM99");
    assert_eq!(sender.interpreter.begin_call(b"O9000CALL"), Ok(true));
    sender.run_held();
    assert_eq!(sender.went, [1]);
    sender.send_all("O2\nG0 X-3\nM99\nX-4");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1][..], &[203][..]));
    let mut sender = Sender::new();
    sender.send_all("G0 X1");
    let action = sender.check(b"M30").unwrap();
    sender.commit_apart(&action);
    sender.send_all("O1000\nG0 X2");
    assert_eq!((sender.went, sender.errors), (vec![1, 2], vec![]));
}

/// Block delete skips the number of a subprogram, and not its lines.
#[test]
fn a_skipped_number_begins_a_subprogram() {
    for (line, rested, errors) in [
        ("O1001", false, 2),
        ("N5:7", false, 2),
        ("O1001", true, 0),
        ("O1CALL", false, 0),
        ("G1X[COS[30]]", false, 0),
        ("M8", false, 0),
    ] {
        let mut sender = Sender::new();
        sender.send("M30");
        sender.interpreter.skipped_line(line.as_bytes(), rested);
        sender.send_all("G0 X3\nX4");
        assert_eq!(sender.errors, vec![203; errors], "{line}");
    }
    let mut sender = Sender::new();
    sender.interpreter.skipped_line(b"O1001", false);
    sender.send_all("G0 X3\nX4");
    assert!(sender.errors.is_empty());
}

/// Words in front of M98 and M99 act before them.
#[test]
fn words_in_front() {
    goes("G0 X1 M98 P1 L2\nN5 X2 M98 P1\nX8\nM30\nO1\nX5\nX6 M99\n%", &[1, 5, 6, 5, 6, 2, 5, 6, 8]);
    goes(
        "o1 sub\nG0 X1\nX6 M99\no1 endsub\nX7 M98 P1\no2 repeat [2]\nX8 M98 P1\no2 endrepeat\nM30",
        &[7, 1, 6, 8, 1, 6, 8, 1, 6],
    );
    fails("G0 X1 M98 P1 Y5\nX2\nX3 M98\nX4 M98 P1 L0", &[36, 28, 39], &[2]);
    fails("X1 M98 P1\nG0 X2\nM30\nO1\nX3\nM99\n%", &[], &[1, 3, 2]);
    // In G65 the letter M is an argument.
    goes("G65 X1 M98 P1\nM2\nO1\nG0 X#13\nX#24\nM99", &[98, 1]);
}

#[test]
fn conditions_and_loops() {
    goes("o1 repeat [2]\nG0 X1\nM98 P5\no1 endrepeat\nX3\nM2\nO5\nX2\nM99", &[1, 2, 1, 2, 3]);
    goes("o1 if [1]\nG0 X1\nM98 P5\nX3\no1 else\nX4\no1 endif\nX5\nM2\nO5\nX2\nM99", &[1, 2, 3, 5]);
    goes("o1 if [0]\nM98 P5\no1 endif\nG0 X5\nM2", &[5]);
    goes("o2 sub\nG0 X1\nM98 P5\nX3\no2 endsub\no2 call\nX4\nM2\nO5\nX2\nM99", &[1, 2, 3, 4]);
    // M2 in a branch that is not taken, and M99 in a loop.
    goes("M98 P5\no1 if [0]\nM2\no1 endif\nG0 X3\nM2\nO5\nG0 X2\nM99", &[2, 3]);
    let body = "o1 do\no2 while [1]\n#1=[#1+1]\nG0 X#1\no3 if [#1 GE 2]\nM99\no3 endif\no2 endwhile\no1 while [1]\nX9";
    goes(&format!("M98 P5\nM2\nO5\n{body}\nM99\n%"), &[1, 2]);
    // A program without an end does not fall into a subprogram.
    fails("M98 P5\nG0 X3\no1 if [0]\nM2\nO5\nG0 X2\nM99\nG0 X4\n%", &[81, 203], &[2, 3]);
}

/// Whatever is missing, no line of a subprogram runs by itself, and nothing of a held program that is refused.
#[test]
fn nothing_falls_into_a_subprogram() {
    // No subprogram of this number.
    fails("G0 X1\nM98 P1\nX2\nM30\n%\nG0 X9", &[203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nO2\nX3\nM99\n%\nX9", &[203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nO2\nX3\nM99\nX4\nX5\n%\nX9", &[203, 203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nX3\nX4\nO1\nX5\nM99\n%\nX9", &[203; 5], &[1, 9]);
    // No M30 in front of the subprogram.
    fails("G0 X1\nM98 P1\nX2\nO1\nX5\nM99\n%\nX9", &[203; 3], &[1, 9]);
    // M99 in the program.
    fails("O1000\nG0 X1\nM99\nO1\nX2\nM99\nX3\n%\nX9", &[203; 5], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    // No M99 in a subprogram.
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nO2\nX3\nM99\n%\nX9", &[203; 3], &[1, 9]);
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nM30\nX3\nM99\n%\nX9", &[203; 3], &[1, 9]);
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\n%\nX9", &[203], &[1, 9]);
    fails("G0 X1\nM30\nO1\nX2\n%\nG0 X9", &[81], &[1, 9]);
    // A number twice.
    fails("G0 X1\nM98 P2\nM30\nO1\nX2\nM99\nO1\nX3\nM99\nO2\nX4\nM99\n%\nX9", &[203; 6], &[1, 9]);
    // M99 with other words.
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nM99 P20\nX3\n%\nX9", &[121, 203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    fails("G0 X1\nX5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    // Lines that are refused, but end a program.
    fails("G0 X1\nX5 X5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    fails("G0 X1\nX5 X5 M30\nO1\nX2\nM99\n%\nX9", &[25], &[1, 9]);
    // An error within a call ends the program, and everything behind it is refused.
    fails("G0 X1\nM98 P1\nX5\nM30\nO1\nX2\nX\nX3\nM99\nO2\nX4\nM99\nX6\n%\nX9", &[2, 203, 203, 203, 203], &[1, 2, 9]);
    fails("G0 X1 X2\nM98 P1\nM98 P2 Q1\nX5\nM30\nO1\nX3\nM99\n%", &[25, 36], &[3]);
    // Words of Fanuc's macros in other forms.
    for jump in ["IF[#1EQ1]M99", "N5 IF#1EQ1GOTO5", "WHILE[#1LT5]DO", "GOTO", "END"] {
        fails(&format!("G0 X1\nM98 P1\nX2\nM30\nO1\nX3\n{jump}\n%\nX9"), &[121], &[1, 9]);
        fails(&format!("G0 X1\nM98 P1\n{jump}\n%\nX9"), &[121], &[1, 9]);
    }
    // Calls without an end.
    fails("M98 P1\nM30\nO1\nG0 X1\nM98 P1\nM99", &[82], &[1; 48]);
}

/// Returns a file whose program goes to X1, calls O1, and goes to X9.
fn calling(body: &str) -> String {
    format!("G0 X1\nM98 P1\nX9\nM30\nO1\n{body}\nM99\n%")
}

#[test]
fn loops_of_fanuc() {
    let count = "#1=0\nWHILE [#1 LT 3] DO1\n#1=[#1+1]\nX#1\nEND1";
    goes(&calling(count), &[1, 1, 2, 3, 9]);
    // In the stream they are held like the loops of O words.
    goes(&format!("G0 X7\n{count}\nX9\nM30"), &[7, 1, 2, 3, 9]);
    goes("G0 X7\nN10 WHILE [1 EQ 2] DO 3\nX1\nN20 END 3\nX9\nM30", &[7, 9]);
    // Within each other, and one after the other with the same number.
    let nested = "#1=0\nWHILE [#1 LT 2] DO1\n#2=0\nWHILE [#2 LT 2] DO2\nX[#1*10+#2]\n#2=[#2+1]\nEND2\n#1=[#1+1]\nEND1";
    goes(&calling(nested), &[1, 0, 1, 10, 11, 9]);
    goes(&calling(&format!("{count}\n{count}")), &[1, 1, 2, 3, 1, 2, 3, 9]);
    goes(&format!("{nested}\nG0 X9\nM30").replacen('#', "G0 X4\n#", 1), &[4, 0, 1, 10, 11, 9]);
    // M99 within a loop returns; the subprogram ends at the one behind it.
    goes(&calling("WHILE [1] DO1\nX5\nM99\nEND1\nX6"), &[1, 5, 9]);
    fails("G0 X1\nEND1\nX2\nM30", &[81], &[1, 2]);
    fails("G0 X1\nWHILE [#1 LT 2] DO1\nX5\nEND2\nM30\n%\nX2", &[81], &[1, 2]);
    fails("G0 X1\nWHILE [1] DO1\n#1=[#1+1]\nEND1\nX2\nM30", &[202], &[1, 2]);
}

#[test]
fn conditions_of_fanuc() {
    let body = "IF [#1 EQ 0] THEN #1=5\nIF [#1 EQ 0] THEN #1=6\nN7 IF [#1 GT 4] THEN G0 X#1\nIF [0] THEN X8";
    goes(&format!("G0 X7\n{body}\nX9\nM30"), &[7, 5, 9]);
    goes(&calling(body), &[1, 5, 9]);
    goes(&format!("G0 X7\no1 repeat [2]\n{body}\no1 endrepeat\nX9\nM30"), &[7, 5, 5, 9]);
    fails("G0 X1\nIF [1/0] THEN X3\nX2\nM30", &[72], &[1, 2]);
    fails("G0 X1\nIF [1] THEN X3 X4\nX2\nM30", &[25], &[1, 2]);
    for line in ["IF [1] THEN", "IF [1] THEN M98 P1", "IF [1] THEN X5 M99", "IF [1] THEN M30", "IF [1] THEN o1 if [1]"]
    {
        let mut sender = Sender::new();
        sender.send_all(&format!("G0 X1\n{line}"));
        assert_eq!((sender.went, sender.errors.len(), sender.ends), (vec![1], 1, 0), "{line}");
    }
}

#[test]
fn jumps_of_fanuc() {
    goes(&calling("#1=0\nN10 #1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 10\nX8"), &[1, 1, 2, 3, 8, 9]);
    goes(&calling("GOTO 020\nX5\nN20 X6\nX7"), &[1, 6, 7, 9]);
    goes(&calling("#2=20\nGOTO #2\nX5\nN20 GOTO [#2+10]\nX6\nN30 X7"), &[1, 7, 9]);
    // The next line with the number, not the first one of the subprogram.
    goes(&calling("N5 #1=[#1+1]\nX#1\nIF [#1 GE 2] GOTO 6\nGOTO 5\nX4\nN5 X5\nN6 X6"), &[1, 1, 5, 6, 9]);
    // Out of loops, to the end of a pass, and to the beginning of a loop.
    goes(&calling("WHILE [1] DO1\n#1=[#1+1]\nX#1\nIF [#1 EQ 2] GOTO 50\nEND1\nN50 X8"), &[1, 1, 2, 8, 9]);
    let twice = "WHILE [1] DO1\nWHILE [1] DO2\nX4\nGOTO 50\nEND2\nEND1\nN50 X8\nWHILE [#1 LT 2] DO1\n#1=[#1+1]\nEND1";
    goes(&calling(twice), &[1, 4, 8, 9]);
    let pass = "WHILE [#1 LT 3] DO1\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 END1";
    goes(&calling(pass), &[1, 1, 3, 9]);
    let again = "N3 WHILE [#1 LT 3] DO1\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 3\nX#1\nEND1";
    goes(&calling(again), &[1, 1, 3, 9]);
    goes(&calling("o7 repeat [3]\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 o7 endrepeat"), &[1, 1, 3, 9]);
    goes(&calling("o7 do\n#1=[#1+1]\nIF [#1 EQ 2] GOTO 5\nX#1\nN5 o7 while [#1 LT 3]"), &[1, 1, 3, 9]);
    // In the held part of the program, in a loop of the stream, and in a macro call with its own parameters.
    goes("G0 X1\nM98 P1\nN5 #1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 5\nM30\nO1\nX9\nM99\n%", &[1, 9, 1, 2, 3]);
    goes("G0 X7\nWHILE [1] DO1\n#1=[#1+1]\nX#1\nIF [#1 LT 3] GOTO 5\no1 break\nN5 END1\nM30", &[7, 1, 2, 3]);
    goes("G0 X1\nG65 P1 A2\nX9\nM30\nO1\nIF [#1 EQ 2] GOTO 6\nX5\nN6 X6\nM99\n%", &[1, 6, 9]);
    // A number in another subprogram, in the program, above the call that holds it, or nowhere.
    for body in ["GOTO 5", "GOTO 7", "GOTO 8", "GOTO 1.5", "GOTO -5"] {
        let file = format!("N8 G0 X1\nM98 P1\nN5 X9\nM30\nO1\n{body}\nM99\nO2\nN7 X7\nM99\n%");
        fails(&file, &[81, 203, 203, 203], &[1]);
    }
    // Into a loop or a condition.
    fails(&calling("GOTO 5\nWHILE [1] DO1\nN5 X5\nEND1"), &[81], &[1, 5]);
    fails(&calling("o1 if [1]\nGOTO 5\no1 endif\nN5 X5\nM99\nX6"), &[203, 203], &[1, 5, 9]);
    fails(&calling("o1 if [1]\nGOTO 5\nX4\nN5 X5\no1 endif"), &[81], &[1, 5]);
    fails(&calling("N5 GOTO 5"), &[202], &[1]);
    fails("G0 X1\nGOTO 5\nX2\nN5 X3\nIF [1] GOTO 5\nM30", &[121, 121], &[1, 2, 3]);
}

/// M10, M11 and M100 to M199 run a macro with their number, if there is one.
#[test]
fn m_words_of_macros() {
    let macros = ["O10SUB", "G0X3", "O10ENDSUB", "O150SUB", "X#1", "X#2", "O150ENDSUB"];
    let send = |text: &str| {
        let mut sender = with_macro(&macros);
        sender.send_all(text);
        (sender.went, sender.errors)
    };
    assert_eq!(send("G0 X1\nM10\nX2\nM150 P7 Q[2*4]\nN5 M150P6\nM30"), (vec![1, 3, 2, 7, 8, 6, 0], vec![]));
    assert_eq!(send("G0 X1\no1 repeat [2]\nM010\no1 endrepeat\nM30"), (vec![1, 3, 3], vec![]));
    assert_eq!(send(&calling("M10\nM150 P5 Q6")), (vec![1, 3, 5, 6, 9], vec![]));
    // No macro of the number, other words in the line, and a subroutine of the program.
    for (line, error) in [("M11", 20), ("M151", 20), ("M10.1", 23), ("M10 X5", 36), ("X5 M10", 20), ("M150 Q2 P1", 36)]
    {
        assert_eq!(send(&format!("G0 X1\n{line}\nX2\nM30")), (vec![1, 2], vec![error]), "{line}");
    }
    assert_eq!(send("o11 sub\nG0 X5\no11 endsub\nM11\nG0 X2\nM30"), (vec![2], vec![20]));
    assert_eq!(send("o10 sub\nG0 X5\no10 endsub\nM10\no10 call\nM30"), (vec![3, 5], vec![]));
}

/// Forms of numbers that are none of a subprogram, behind a program that is held or not.
#[test]
fn numbers_in_other_forms_are_refused() {
    for number in
        ["O1001.0", "O[1001]", "O#1", "O1001 G1 Z-3", "O1001 M98 P2", "N10.5 O1001", "O", "O123456789", "N1 O1001 ("]
    {
        for program in ["G0 X1\nM30", "G0 X1\nM98 P1001\nM30"] {
            let errors = if number.ends_with('(') { 0 } else { 3 };
            let mut sender = Sender::new();
            sender.send_all(&format!("{program}\n{number}\nG0 X5\nM99"));
            assert_eq!(sender.errors, vec![203; errors], "{number}");
            assert!(!sender.went.contains(&5) || errors == 0 && program.contains("M98"), "{number}");
            // A program begins behind a tape mark.
            sender.send("%");
            sender.went.clear();
            sender.errors.clear();
            sender.send_all("O1000\nG0 X7\nM30");
            assert_eq!((sender.errors, sender.went), (vec![], vec![7]), "{number}");
        }
    }
}

#[test]
fn the_next_program() {
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    assert_eq!(sender.went, [1]);
    // Without a rest, further lines belong to no program.
    sender.send("G0 X2");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1][..], &[203][..]));
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.send_after_rest("G0 X2\nO1000\nG0 X3\nM30");
    assert_eq!((sender.went, sender.errors), (vec![1, 2, 3], vec![]));
    // The same file again, without tape marks: its number tells it from a subprogram.
    let file = "O1000\nG0 X1\nM98 P1\nM30\nO1\nX2\nM99\n";
    let mut sender = Sender::new();
    sender.send_all(file).send_after_rest(file).send_after_rest(&file.replace("O1000", ":01000"));
    assert_eq!((sender.went.clone(), sender.errors.clone()), ([1, 2].repeat(3), vec![]));
    sender.send_all(file);
    assert_eq!((sender.went.len(), sender.errors), (6, vec![203; 4]), "without a rest");
    // Not if another program has begun since then.
    let mut sender = Sender::new();
    sender.send_all(file).send_after_rest("G0 X3\nM30\nO2\nX4\nM99").send_after_rest("O1000\nG0 X5\nM99");
    assert_eq!((sender.went, sender.errors), (vec![1, 2, 3], vec![]));
    // A number is that of a subprogram, even behind a rest.
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.send_after_rest("O2000\nG0 X3\nM30\nX4");
    assert_eq!((sender.went, sender.errors), (vec![1], vec![203, 203]));
    // A tape mark, a reset and another host drop what is held.
    for drop in [
        |interpreter: &mut Interpreter<3>| interpreter.begin_program(),
        |interpreter: &mut Interpreter<3>| interpreter.reset(),
        |interpreter: &mut Interpreter<3>| {
            interpreter.abandon_program();
            interpreter.begin_program();
        },
    ] {
        for text in ["M98 P1\nG0 X5", "M98 P1\nG0 X5\nM30", "M98 P1\nG0 X5\nM30\nO1\nG0 X6", "M30\nO1\nG0 X6", "M99"] {
            let mut sender = Sender::new();
            sender.send_all(text);
            drop(&mut sender.interpreter);
            assert!(!sender.interpreter.is_within_block(), "{text}");
            sender.errors.clear();
            sender.send_all("G0 X1\nM2\n%");
            assert_eq!((sender.went, sender.errors), (vec![1], vec![]), "{text}");
        }
    }
}

/// A program that does not fit is refused from its call on.
#[test]
fn memory_for_programs() {
    let line = "G1 F100 X5 Y2.5 Z-0.5\n";
    for lines in [200, 330, 340, 400] {
        let mut sender = Sender::new();
        sender.send_all(&format!("G0 X1\nM98 P1\n{}M30\nO1\nX2\nM99\n%\nG0 X9", line.repeat(lines)));
        if sender.errors.is_empty() {
            assert!(lines <= 330);
            assert_eq!(sender.went.len(), 3 + lines);
        } else {
            assert!(lines > 330 && sender.errors.iter().all(|code| *code == 83 || *code == 203), "{:?}", sender.errors);
            assert_eq!(sender.went, [1, 9]);
        }
        sender.interpreter.reset();
        assert!(!sender.interpreter.is_within_block());
    }
    // The count of what is too long is exact, wherever the text ends: in the program, in the subprogram for which it waits, or
    // in another one before that.
    for body in ["{}M30\nO1\nX2\nM99", "M30\nO1\n{}M99", "M30\nO2\n{}M99\nO1\nX3\nM99\nO3\nX4\nM99"] {
        let send = |lines: usize| {
            let mut sender = Sender::new();
            let body = body.replace("{}", &"X5\n".repeat(lines));
            sender.send_all(&format!("G0 X1\nM98 P1\n{body}\n%\n"));
            assert_eq!(sender.interpreter.lacking_bytes().is_some(), !sender.errors.is_empty(), "{lines}");
            sender.interpreter.lacking_bytes()
        };
        let lacking = send(2500).unwrap();
        let fits = 2500 - lacking.div_ceil(3);
        assert_eq!((send(fits), send(fits + 1).is_some()), (None, true), "{body}");
        assert_eq!(send(1500 + fits).unwrap() - send(fits + 500).unwrap(), 3000, "{body}");
    }
    // However full the memory is, no line of a subprogram runs by itself, and none of the held program before its call.
    for free in 0..200 {
        let fill = 6144 - 64 - free;
        let mut sender = Sender::new();
        sender.send_all(&format!("o7 sub\n{}o7 endsub", format!("G0X{}\n", "1".repeat(57)).repeat(fill / 61)));
        sender.send_all(&format!("G0 X1\nM98 P1\n(\nX3\nM30\nO1\n{}\nX2\nM99\nO2\nX4\nM99\n", "X5\n".repeat(free / 9)));
        assert!(!sender.went.contains(&4), "{free}");
        if !sender.errors.is_empty() {
            assert_eq!(sender.went, [1], "{free}");
        }
    }
}

#[test]
fn grbl_has_none() {
    let interpreter = Interpreter::<3>::default();
    for line in ["M98P1", "M99", "G65P1"] {
        assert_eq!(interpreter.check(line.as_bytes(), Dialect::Grbl).map_err(|error| error.code()), Err(20), "{line}");
    }
}

/// A subprogram of a random program: its moves and calls.
#[derive(Clone, Debug)]
enum Step {
    Move(i64),
    Add(i64),
    /// Which of the following subprograms, how often, and with an argument if it is a call by G65.
    Call(usize, u16, Option<i64>),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (-50_i64..50).prop_map(Step::Move),
        1 => (-5_i64..5).prop_map(Step::Add),
        2 => (0_usize..3, 1_u16..4, prop::option::of(-9_i64..9)).prop_map(|(to, times, with)| Step::Call(to, times, with)),
    ]
}

/// The programs: the main program first. A program calls only those behind it.
fn text_of(programs: &[Vec<Step>], index: usize) -> String {
    let lines = programs[index].iter().map(|step| match step {
        Step::Move(to) => format!("G0 X[{to} + #1]\n"),
        Step::Add(number) => format!("#1=[#1 + {number}]\n"),
        Step::Call(to, ..) if index + 1 + to >= programs.len() => String::new(),
        Step::Call(to, times, None) => format!("M98 P{} L{times}\n", index + 1 + to),
        Step::Call(to, times, Some(argument)) => format!("G65 P{} L{times} A{argument}\n", index + 1 + to),
    });
    lines.collect()
}

/// Appends the X targets of a program to `went`; `one` is #1.
fn written_out(programs: &[Vec<Step>], index: usize, one: &mut i64, went: &mut Vec<i64>) {
    for step in &programs[index] {
        match step {
            Step::Move(to) => went.push(to + *one),
            Step::Add(number) => *one += number,
            Step::Call(to, ..) if index + 1 + to >= programs.len() => {}
            Step::Call(to, times, argument) => {
                let mut own = argument.unwrap_or_default();
                for _ in 0..*times {
                    written_out(programs, index + 1 + to, if argument.is_some() { &mut own } else { one }, went);
                }
            }
        }
    }
}

/// A line of a program, or a call of a program behind it: which, how often, and with which arguments.
#[derive(Clone, Debug)]
enum Line {
    Text(&'static str),
    Call(usize, u16, Option<[i64; 3]>),
}

/// Parameters that the arguments A, B and Z of G65 set.
const ARGUMENTS: [&str; 3] = ["#1", "#2", "#26"];

/// Lines that are valid in any order.
const TEXTS: [&str; 18] = [
    "G90 G0 X[3+#1] Y#2 Z[5+#26]",
    "G91 G1 X#1 Y1.5",
    "G90",
    "G91",
    "G17 G91 G2 X2 Y0 I1 J0",
    "G91 G3 X0 Y-4 R2.5 Z#26",
    "G90 G99 G81 X[10+#2] Y1 Z-3 R2",
    "G0 X4",
    "G80 G0 Z[#26+1]",
    "G4 P[ABS[#1]/10]",
    "M3 S[1000+#2]",
    "G1 X1 F[100+ABS[#1]]",
    "G20 G1 X0.5",
    "G21",
    "G52 X#1",
    "G55 G0 Y2",
    "G54",
    "#100=[#100+#1] G0 X#100",
];

fn line() -> impl Strategy<Value = Line> {
    prop_oneof![
        3 => prop::sample::select(&TEXTS[..]).prop_map(Line::Text).boxed(),
        2 => (0_usize..3, 1_u16..4, prop::option::of([-9_i64..9, -9_i64..9, -9_i64..9]))
            .prop_map(|(to, times, with)| Line::Call(to, times, with))
            .boxed(),
    ]
}

/// Returns the lines of a program with its calls. `behind`: a call by M98 follows a line with words in the same line.
fn calls_of(programs: &[Vec<Line>], index: usize, behind: bool) -> String {
    let mut text = String::new();
    for line in &programs[index] {
        match line {
            Line::Text(words) => text += &format!("{words}\n"),
            Line::Call(to, ..) if index + 1 + to >= programs.len() => {}
            Line::Call(to, times, None) => {
                if behind && text.ends_with("G90\n") {
                    text.pop();
                    text.push(' ');
                }
                text += &format!("M98 P{} L{times}\n", index + 1 + to);
            }
            Line::Call(to, times, Some([a, b, z])) => {
                text += &format!("G65 P{} A{a} B{b} Z{z} L{times}\n", index + 1 + to);
            }
        }
    }
    text
}

/// Appends the lines of a program with those of its calls in their places, and with numbers for `ARGUMENTS`.
fn expand(programs: &[Vec<Line>], index: usize, values: &[i64; 3], lines: &mut Vec<String>) {
    for line in &programs[index] {
        match line {
            Line::Text(words) => {
                // The longest name first: #26 begins with #2.
                let number = |text: String, (name, value): (&&str, &i64)| text.replace(*name, &format!("[{value}]"));
                let words = words.replace("#100", "#_100");
                let words = ARGUMENTS.iter().zip(values).rev().fold(words, number);
                lines.push(words.replace("#_100", "#100"));
            }
            Line::Call(to, ..) if index + 1 + to >= programs.len() => {}
            Line::Call(to, times, with) => {
                for _ in 0..*times {
                    expand(programs, index + 1 + to, with.as_ref().unwrap_or(values), lines);
                }
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]
    /// A program with subprograms makes the same moves as the program written out, in whatever order its subprograms
    /// follow it.
    #[test]
    fn calls_are_the_lines_of_their_subprograms(
        programs in prop::collection::vec(prop::collection::vec(step(), 0..6), 1..5),
        turn in 0_usize..4,
    ) {
        let mut went = Vec::new();
        written_out(&programs, 0, &mut 0, &mut went);
        let mut subprograms: Vec<String> =
            (1..programs.len()).map(|index| format!("O{index}\n{}M99\n", text_of(&programs, index))).collect();
        let turn = turn % subprograms.len().max(1);
        subprograms.rotate_left(turn);
        let text = format!("O1000\n{}M30\n{}%\n", text_of(&programs, 0), subprograms.concat());
        let mut sender = Sender::new();
        sender.send_all(&text);
        prop_assert_eq!((sender.went, sender.errors, sender.ends), (went, vec![], 1), "{}", text);
    }

    /// The same for all kinds of lines: arcs, cycles, modes, dwells and arguments.
    #[test]
    fn calls_act_as_their_lines(
        programs in prop::collection::vec(prop::collection::vec(line(), 0..7), 2..5),
        lone in prop::collection::vec(prop::bool::ANY, 4),
    ) {
        let mut lines = vec!["O1000".to_owned(), "G21 G90 F300".to_owned()];
        expand(&programs, 0, &[0, 0, 0], &mut lines);
        let mut text = format!("O1000\nG21 G90 F300\n{}M30\n", calls_of(&programs, 0, false));
        for index in 1..programs.len() {
            text += &format!("O{index}\n{}M99\n", calls_of(&programs, index, lone[index - 1]));
        }
        let acts = |text: &str| {
            let mut sender = Sender::new();
            sender.acts = Some(Vec::new());
            sender.send_all(text);
            let position = sender.interpreter.position().0;
            (sender.acts.unwrap(), position, sender.errors, sender.ends)
        };
        let (called, written) = (acts(&text), acts(&format!("{}\nM30", lines.join("\n"))));
        prop_assert_eq!(called, written, "{}\n---\n{}", text, lines.join("\n"));
    }

    /// However the lines behind a program are mixed, and wherever the machine rests while lines are held, those behind
    /// the first number run in calls only, and never in the next job.
    #[test]
    fn no_mixture_falls_into_a_subprogram(
        program in prop::collection::vec(
            "M98P[123]|G65P[12]A1|M98P[12]L2|G0X1|G0X1M98P1|o1 if \\[[01]\\]|o1 endif|o1 repeat \\[2\\]|o1 endrepeat|M2|X|o9 sub\
             |o9 endsub|M98P1M30|XM30|WHILE\\[0\\]DO1|END1|IF\\[1\\]THENG0X1|GOTO7",
            0..8,
        ),
        lines in prop::collection::vec(
            ("M98P[123]|G65P[12]A1|M98P1L2|M30|O[123]|M99|G0X-1|G0X-1|G0X-1M99|G0X-1M98P1|o1 if \\[1\\]|o1 endif\
              |o1 repeat \\[2\\]|o1 endrepeat|X|o9 sub|o9 endsub|M99P2|O1G0X-1\
              |WHILE\\[0\\]DO1|END1|IF\\[[01]\\]THENG0X-1|IF\\[#9LT2\\]GOTO7|N7#9=\\[#9\\+1\\]", prop::bool::weighted(0.1)),
            0..30,
        ),
        next in 0_usize..5,
    ) {
        let mut sender = Sender::new();
        sender.send_all(&program.join("\n"));
        if sender.interpreter.is_within_block() {
            // An open block is no concern of subprograms, and a held program is ended here.
            sender.send_all("o1 endif\no1 endrepeat\no9 endsub\nEND1");
        }
        sender.send_all("M30\nO5");
        for (line, rests) in &lines {
            // Lines behind a complete subprogram and a rest are those of the next program.
            sender.rested = *rests && sender.interpreter.is_held();
            sender.send(line);
        }
        let at_once = sender.at_once.iter().filter(|x| **x < 0).count();
        prop_assert_eq!(at_once, 0, "{:?} {:?}", program, lines);
        sender.went.clear();
        match next {
            0 => sender.send("%"),
            1 => sender.interpreter.reset(),
            2 => {
                sender.interpreter.unlock(false, false);
                sender.interpreter.unlock(false, false);
            }
            3 => {
                sender.interpreter.abandon_program();
                sender.interpreter.begin_program();
            }
            _ => sender.rested = true,
        }
        sender.errors.clear();
        sender.send_all("G21\nG0X7\nM98P1\nM98P3\nM30\nO1\nG0X8\nM99\nO3\nG0X9\nM99\nG0X-2\n%");
        if next < 4 || sender.errors == [203] {
            prop_assert_eq!((sender.went, sender.errors), (vec![7, 8, 9], vec![203]), "{:?} {:?}", program, lines);
        } else {
            prop_assert!(sender.went.is_empty(), "{:?} {:?} {:?}", sender.went, program, lines);
        }
    }
}
