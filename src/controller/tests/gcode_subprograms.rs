//! Tests of subprograms: M98, G65 and M99. The lines of a subprogram run when it is called, and never otherwise.
#![cfg(feature = "full")]

use crate::subprogram_sender::{Sender, fails, goes, with_macro};
use oxmill_controller::error::Error;
use oxmill_controller::gcode::{Dialect, Interpreter};

#[test]
fn the_usual_file() {
    goes(
        "%\nO1000 (PART)\nG21 G90\nG0 X1\nM98 P1001\nG0 X9\nM98 P1001\nM30\nO1001 (POCKET)\nG0 X2\nG0 X3\nM99\n%",
        &[1, 2, 3, 9, 2, 3],
    );
    goes("N1 :1000\nN2 G0 X1\nN3 M98 P7\nN4 M2\n\nN5 :0007\n\nN6 X2\nN7 M099\n%", &[1, 2]);
    // One of two subprograms calls the other; they can be defined in either order.
    for definitions in [["O1\nX2\nM98 P2\nX3\nM99\n", "O2\nX5\nM99\n"], ["O2\nX5\nM99\n", "O1\nX2\nM98 P2\nX3\nM99\n"]]
    {
        goes(&format!("G0 X1\nM98P1\nM98P2\nX9\nM30\n{}%\n", definitions.concat()), &[1, 2, 5, 3, 5, 9]);
    }
    // Subprograms that nothing calls do not run.
    goes("G0 X1\nM30\nO5\nG1 X-3 F100\nM99\nO6\nX7\nM99\n%", &[1]);
    goes("G0 X1\nM98 P6\nM30\nO5\nG1 X-3 F100\nM99\nO6\nX7\nM99\nO8\nX8\nM99\n%", &[1, 7]);
}

#[test]
fn repeats() {
    goes("G91 G0 X1\nM98 P1 L3\nM30\nO1\nX2\nM99", &[1, 3, 5, 7]);
    goes("G0 X1\nM98 L2 P1\nM30\nO1\nX2\nM98 P2 L2\nM99\nO2\nX5\nM99", &[1, 2, 5, 5, 2, 5, 5]);
    // An M99 within a condition ends a pass, too. Then the next pass begins.
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
    // The values that a pass sets are still set in the next pass.
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
    // A macro calls a subprogram that is not defined yet: the program waits in the middle of the call.
    let mut sender = with_macro(&["O9000SUB", "G0X1", "M98P5", "G0X3", "O9000ENDSUB"]);
    sender.send_all("o9000 call\nG0 X4");
    assert_eq!(sender.went, [1]);
    assert_eq!(sender.interpreter.awaited_subprogram(), Some(5));
    sender.send_all("M30\nO5\nX2\nM99\n%");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1, 2, 3, 4][..], &[][..]));
    assert_eq!(sender.interpreter.macro_line(4), Some(&b"O9000ENDSUB"[..]));
    // Now a startup line calls the macro. After a startup line, no lines come that could define subprogram 5. So the
    // call does not wait: it is `error:203`.
    assert_eq!(sender.interpreter.begin_call(b"O9000CALL"), Ok(true));
    sender.went.clear();
    sender.run_held();
    assert_eq!((sender.went, sender.errors), (vec![1], vec![203]));
    assert!(!sender.interpreter.is_within_block());
}

/// A call of a subprogram never runs a macro with the same number. The subprogram comes after the end of the program.
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

/// The subprograms of a file are forgotten at the end of the file, even if its program has not called them.
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
    // After an error in the program, the subprograms of its file are forgotten, too.
    for error in ["X", "M98 P1 L0", "o7 call"] {
        let mut sender = Sender::new();
        sender.send_all(&format!("M98 P5\nM30\nO1\nG0 X-3\nM99\nO5\nG0 X1\n{error}\nM99\nO2\nG0 X-3\nM99\n%"));
        assert_eq!(sender.errors[1..], [203; 3], "{error}");
        sender.errors.clear();
        sender.send_all("M98 P1\nM30\n%\nM98 P2\nM30\n%");
        assert_eq!((sender.went, sender.errors), (vec![1], vec![203, 203]), "{error}");
    }
}

/// After a refused line of a subprogram, its remaining lines are refused too, so that they are not run as a program.
/// The refusal continues after a pause of the host. It ends at a line `%`.
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
        // The remaining lines are also refused if the wrong line is too long, so that its words are not read at all.
        let mut sender = Sender::new();
        sender.send_all(&format!("{program}O1\nG0 X-2"));
        sender.interpreter.refused_line(None);
        sender.interpreter.line_refused(Error::LineTooLong);
        sender.send_after_rest("G0 X-3\nM99");
        assert_eq!(sender.errors, [203, 203]);
    }
    // The words of a line that is too long are not read. If such a line comes between two subprograms, it may be the
    // line with the next O number. So the lines after it are refused.
    let mut sender = Sender::new();
    sender.send_all("G0 X1\nM30\nO1\nG0 X-2\nM99");
    sender.interpreter.refused_line(None);
    sender.interpreter.line_refused(Error::LineTooLong);
    sender.send_after_rest("G0 X-3\nM99");
    assert_eq!((sender.errors, sender.went), (vec![203, 203], vec![1]));
}

/// If a line with M30 is refused or skipped, the program ends all the same.
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

/// If the host pauses while a program waits for its subprograms, or within a subprogram, the stored lines are dropped:
/// the next line can be that of another file.
#[test]
fn a_rest_drops_a_held_program() {
    for held in ["M98 P8", "M98 P8\nG0 X2\nM30", "M98 P8\nM30\nO9\nG0 X-2", "M98 P9\nM98 P8\nM30\nO9\nM99", "M30\nO9"] {
        let mut sender = Sender::new();
        sender.send_all(held);
        assert!(sender.errors.is_empty(), "{held}: {:?}", sender.errors);
        // A line with only a comment begins no program, and is accepted.
        sender.rested = true;
        sender.send("(PART)");
        sender.send_after_rest("G21\nG0 X3\nO8\nG0 X4\nM99\nM30");
        assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 6][..], &[][..]), "{held}");
        sender.send_all("%\nG0 X9\nM30");
        assert_eq!((sender.errors.len(), sender.went), (6, vec![9]), "{held}");
    }
}

/// `$X`, a stop and an alarm drop the stored lines of a program or subprogram. Its other lines, which the host can
/// still send, are refused.
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
            // A pause of the host does not end the refusal, even if an O number follows: the operator may only have
            // looked at the machine.
            let mut sender = Sender { interpreter: before, ..Sender::new() };
            sender.send_after_rest("O1000\nG0 X-9");
            assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 2][..], &[][..]), "{name}: {held}");
            sender.send_all("%\nO1000\nG0 X9\nM30");
            assert_eq!((sender.went, sender.errors.len()), (vec![9], 2), "{name}: {held}");
        }
    }
}

/// An alarm in a subprogram, for example because a probe made no contact, ends the program. The subprograms that
/// follow are not run as a program, even after `$X` or a pause of the host.
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
    // A stop needs no `$X` after it, but the lines that follow are refused, too.
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.interpreter.abandon_program();
    sender.send_all("O2\nG0 X-3\nM99\nX-4");
    assert_eq!((sender.errors.as_slice(), sender.went.as_slice()), (&[203; 4][..], &[1][..]));
}

/// An M99 without a call means that the lines of a subprogram were run as a part of the program. So all lines after it
/// are refused. The M99 can be alone, behind other words, or in a line that has another error.
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
    // A name or a value with M99 in it, such as `#<M99>`, is no return.
    fails("#<M99>=1\nX5 X5 F[#<M99>*99]\nG0 X2", &[25], &[2]);
}

/// If block delete (`/`) skips a line with M2 or M30, the program ends all the same.
#[test]
fn a_skipped_end_is_an_end() {
    for (end, rested) in [("M30", false), ("N5M2", true)] {
        let mut sender = Sender::new();
        sender.send("G0 X1");
        sender.interpreter.skipped_line(end.as_bytes(), rested);
        sender.send_all("O1001\nG0 X-3\nM99\nX-4");
        assert_eq!((sender.errors, sender.went), (vec![203], vec![1]));
        // If the program continues after the skipped line, its lines run.
        let mut sender = Sender::new();
        sender.interpreter.skipped_line(end.as_bytes(), rested);
        sender.send_all("G0 X2\nM30");
        assert_eq!((sender.errors, sender.went), (vec![], vec![2]));
    }
}

/// Lines after the M30 of a held program (one that waits for its subprograms) do not belong to it. Even calls among
/// them are refused, not silently dropped.
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
    // A startup line can call a macro even while the host sends subprograms.
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

/// Block delete (`/`) may skip an O number after the end of a program. The lines after it still belong to a subprogram
/// and are refused.
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

/// Words before M98 and M99 act first.
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
    // An M2 in a branch that is not taken does not end the program. An M99 in a loop returns to the caller.
    goes("M98 P5\no1 if [0]\nM2\no1 endif\nG0 X3\nM2\nO5\nG0 X2\nM99", &[2, 3]);
    let body = "o1 do\no2 while [1]\n#1=[#1+1]\nG0 X#1\no3 if [#1 GE 2]\nM99\no3 endif\no2 endwhile\no1 while [1]\nX9";
    goes(&format!("M98 P5\nM2\nO5\n{body}\nM99\n%"), &[1, 2]);
    // A program without an end does not run on into a subprogram.
    fails("M98 P5\nG0 X3\no1 if [0]\nM2\nO5\nG0 X2\nM99\nG0 X4\n%", &[81, 203], &[2, 3]);
}

/// No line of a subprogram runs without a call, even if the file lacks the subprogram, an M30 or an M99. If a program
/// that waits for its subprograms is refused, none of its stored lines runs.
#[test]
fn nothing_falls_into_a_subprogram() {
    // There is no subprogram with this number.
    fails("G0 X1\nM98 P1\nX2\nM30\n%\nG0 X9", &[203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nO2\nX3\nM99\n%\nX9", &[203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nO2\nX3\nM99\nX4\nX5\n%\nX9", &[203, 203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM30\nX3\nX4\nO1\nX5\nM99\n%\nX9", &[203; 5], &[1, 9]);
    // There is no M30 before the subprogram.
    fails("G0 X1\nM98 P1\nX2\nO1\nX5\nM99\n%\nX9", &[203; 3], &[1, 9]);
    // The program contains an M99.
    fails("O1000\nG0 X1\nM99\nO1\nX2\nM99\nX3\n%\nX9", &[203; 5], &[1, 9]);
    fails("G0 X1\nM98 P1\nX2\nM99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    // A subprogram has no M99.
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nO2\nX3\nM99\n%\nX9", &[203; 3], &[1, 9]);
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nM30\nX3\nM99\n%\nX9", &[203; 3], &[1, 9]);
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\n%\nX9", &[203], &[1, 9]);
    fails("G0 X1\nM30\nO1\nX2\n%\nG0 X9", &[81], &[1, 9]);
    // Two subprograms have the same number.
    fails("G0 X1\nM98 P2\nM30\nO1\nX2\nM99\nO1\nX3\nM99\nO2\nX4\nM99\n%\nX9", &[203; 6], &[1, 9]);
    // M99 has other words.
    fails("G0 X1\nM98 P1\nM30\nO1\nX2\nM99 P20\nX3\n%\nX9", &[121, 203], &[1, 9]);
    fails("G0 X1\nM98 P1\nX5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    fails("G0 X1\nX5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    // A refused line with M99 or M30 ends the program nevertheless.
    fails("G0 X1\nX5 X5 M99\nO1\nX2\nM99\n%\nX9", &[203; 4], &[1, 9]);
    fails("G0 X1\nX5 X5 M30\nO1\nX2\nM99\n%\nX9", &[25], &[1, 9]);
    // An error within a call ends the program, and all lines after it are refused.
    fails("G0 X1\nM98 P1\nX5\nM30\nO1\nX2\nX\nX3\nM99\nO2\nX4\nM99\nX6\n%\nX9", &[2, 203, 203, 203, 203], &[1, 2, 9]);
    fails("G0 X1 X2\nM98 P1\nM98 P2 Q1\nX5\nM30\nO1\nX3\nM99\n%", &[25, 36], &[3]);
    // Macro statements of Fanuc are refused if they are incomplete (such as GOTO without a number) or in another form.
    for jump in ["IF[#1EQ1]M99", "N5 IF#1EQ1GOTO5", "WHILE[#1LT5]DO", "GOTO", "END"] {
        fails(&format!("G0 X1\nM98 P1\nX2\nM30\nO1\nX3\n{jump}\n%\nX9"), &[121], &[1, 9]);
        fails(&format!("G0 X1\nM98 P1\n{jump}\n%\nX9"), &[121], &[1, 9]);
    }
    // Calls that never end are refused when they are nested too deeply.
    fails("M98 P1\nM30\nO1\nG0 X1\nM98 P1\nM99", &[82], &[1; 48]);
}

/// Some O numbers have a form that the number of a subprogram cannot have. They are refused, whether or not the
/// program before them waits for subprograms.
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
            // After a tape mark (`%`), a new program begins.
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
    // Lines after the last subprogram are refused if they follow at once. Lines after a pause of the host are a new
    // program, and run.
    sender.send("G0 X2");
    assert_eq!((sender.went.as_slice(), sender.errors.as_slice()), (&[1][..], &[203][..]));
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.send_after_rest("G0 X2\nO1000\nG0 X3\nM30");
    assert_eq!((sender.went, sender.errors), (vec![1, 2, 3], vec![]));
    // The same file is sent again, without tape marks. The number of its program shows that it is no subprogram.
    let file = "O1000\nG0 X1\nM98 P1\nM30\nO1\nX2\nM99\n";
    let mut sender = Sender::new();
    sender.send_all(file).send_after_rest(file).send_after_rest(&file.replace("O1000", ":01000"));
    assert_eq!((sender.went.clone(), sender.errors.clone()), ([1, 2].repeat(3), vec![]));
    sender.send_all(file);
    assert_eq!((sender.went.len(), sender.errors), (6, vec![203; 4]), "without a rest");
    // The second file has no number, so O1000 is no longer the number of the last program. It begins a subprogram.
    let mut sender = Sender::new();
    sender.send_all(file).send_after_rest("G0 X3\nM30\nO2\nX4\nM99").send_after_rest("O1000\nG0 X5\nM99");
    assert_eq!((sender.went, sender.errors), (vec![1, 2, 3], vec![]));
    // O2000 is not the number of the last program, so it begins a subprogram, even after a pause of the host.
    let mut sender = Sender::new();
    sender.send_all("M98 P1\nM30\nO1\nG0 X1\nM99");
    sender.send_after_rest("O2000\nG0 X3\nM30\nX4");
    assert_eq!((sender.went, sender.errors), (vec![1], vec![203, 203]));
    // A tape mark, a reset and another host drop the stored lines of a program or subprogram.
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

/// If a program does not fit into the memory, all its lines from the first call of a subprogram on are refused.
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
    // The number of excess bytes is exact wherever the memory runs out: in the program, in the subprogram for which
    // the program waits, or in a subprogram before that one.
    for body in ["{}M30\nO1\nX2\nM99", "M30\nO1\n{}M99", "M30\nO2\n{}M99\nO1\nX3\nM99\nO3\nX4\nM99"] {
        let send = |lines: usize| {
            let mut sender = Sender::new();
            let body = body.replace("{}", &"X5\n".repeat(lines));
            sender.send_all(&format!("G0 X1\nM98 P1\n{body}\n%\n"));
            assert_eq!(sender.interpreter.excess_bytes().is_some(), !sender.errors.is_empty(), "{lines}");
            sender.interpreter.excess_bytes()
        };
        let lacking = send(2500).unwrap();
        let fits = 2500 - lacking.div_ceil(3);
        assert_eq!((send(fits), send(fits + 1).is_some()), (None, true), "{body}");
        assert_eq!(send(1500 + fits).unwrap() - send(fits + 500).unwrap(), 3000, "{body}");
    }
    // However full the memory is, no line of a subprogram runs without a call. If the program does not fit, its lines
    // from the call on do not run.
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
