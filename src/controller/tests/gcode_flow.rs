//! Tests of O words: which lines run, how often, and with which parameters. Where LinuxCNC's interpreter accepts the
//! same text, the expected lists were checked with it.
#![cfg(feature = "full")]

use crate::subprogram_sender::{Sender, fails};
use oxmill_controller::gcode::{Direction, Interpreter};
use proptest::prelude::*;

/// Runs a program. Checks that it has no errors and moves to the X targets `places` (mm).
#[track_caller]
fn goes(text: &str, places: &[i64]) {
    let mut sender = Sender::new();
    sender.send_all(text);
    assert_eq!((sender.went, sender.errors), (places.to_vec(), vec![]), "{text}");
}

#[test]
fn conditions() {
    for (a, b, place) in [(1, 0, 1), (1, 1, 1), (0, 1, 2), (0, 0, 3)] {
        let text = format!("o1 if [{a}]\nG0 X1\no1 elseif [{b}]\nG0 X2\no1 else\nG0 X3\no1 endif\nG0 X4");
        goes(&text, &[place, 4]);
    }
    goes("o1 if [0]\no2 if [1]\nX1\no2 else\nX2\no2 endif\nM2\no1 endif\nX3", &[3]);
    goes("N1 o<a b> if [1]\no2 if [0]\nX1\no2 else\nX2\no2 endif\no<AB> else\nX5\no<ab> endif\nX3", &[2, 3]);
    goes("#1=5\no010 if [#1 GT 3]\nX#1\no10 endif", &[5]);
    // Skipped lines are not checked.
    goes("o1 if [0]\nnonsense\no1 elseif [0]\nX[1/0]\no1 endif\nX1", &[1]);
    goes("o1 if [1]\no1 elseif [1/0]\no1 endif\nX1", &[1]);
}

#[test]
fn conditions_that_do_not_fit() {
    fails("o1 else", &[81], &[]);
    fails("o1 endif", &[81], &[]);
    fails("o1 if [1]\no2 endif\no1 endif\nX1", &[81], &[1]);
    fails("o1 if 1", &[81], &[]);
    fails("o1 if [1] X5\nX1", &[81], &[]);
    // If a condition has no value, neither branch runs.
    fails("o1 if [1/0]\nX1\no1 else\nX2\no1 endif\nX3", &[72], &[3]);
    fails("o1 if [0]\no1 elseif [1/0]\nX1\no1 else\nX2\no1 endif\nX3", &[72], &[3]);
    fails("o1 break", &[81], &[]);
    fails("o1 endwhile\no1 endrepeat\no1 return\no1 endsub\no1 continue", &[81; 5], &[]);
    let deep: String = (0..49).map(|label| format!("o{label} if [1]\n")).collect();
    fails(&deep, &[82], &[]);
}

#[test]
fn loops() {
    goes("o1 while [#1 LT 3]\n#1=[#1+1]\nX#1\no1 endwhile\nX9", &[1, 2, 3, 9]);
    goes("o1 while [0]\nX1\no1 endwhile\nX9", &[9]);
    goes("#1=5\no1 do\n#1=[#1-1]\nX#1\no1 while [#1 GT 3]\nX9", &[4, 3, 9]);
    for (count, passes) in [
        ("0.4", 0),
        ("0.5", 0),
        ("0.6", 1),
        ("1.1", 1),
        ("1.4", 1),
        ("1.5", 2),
        ("2.4", 2),
        ("2.5", 2),
        ("2.7", 3),
        ("3.49", 3),
        ("3.5", 4),
        ("5/2", 2),
        ("7/2", 4),
        ("-0.4", 0),
        ("-1.5", 0),
    ] {
        let text = format!("o1 repeat [{count}]\n#31=[#31+1]\no1 endrepeat\nX#31");
        goes(&text, &[passes]);
    }
    goes("o1 repeat [-1]\nX1\no1 endrepeat\nX9", &[9]);
    goes("o1 repeat [0]\nX1\no1 endrepeat\nX9", &[9]);
    // A count above 100,000, the maximum of passes, is refused before the first pass.
    for count in ["100001", "100000.6", "200000-1", "9999999999"] {
        fails(&format!("o1 repeat [{count}]\nX1\no1 endrepeat\nX9"), &[202], &[9]);
    }
    fails("o1 repeat [2]\nX1\no2 repeat [100001]\nX2\no2 endrepeat\no1 endrepeat\nX9", &[202], &[1, 9]);
    // A loop can contain another loop with a condition.
    goes(
        "o1 repeat [2]\no2 repeat [3]\n#1=[#1+1]\no3 if [#1 MOD 2]\nX#1\no3 endif\no2 endrepeat\nX-1\no1 endrepeat",
        &[1, 3, -1, 5, -1],
    );
    goes(
        "o1 while [1]\n#1=[#1+1]\no2 if [#1 EQ 2]\no1 continue\no2 endif\no3 if [#1 EQ 4]\no1 break\no3 endif\nX#1\n\
         o1 endwhile\nX9",
        &[1, 3, 9],
    );
    goes("o1 do\n#1=[#1+1]\no2 if [#1 EQ 1]\no1 continue\no2 endif\nX#1\no1 while [#1 LT 3]\nX9", &[2, 3, 9]);
    goes("o1 do\nX1\no1 break\nX2\no1 while [1]\nX9", &[1, 9]);
    goes("o1 repeat [3]\n#1=[#1+1]\no2 if [#1 EQ 2]\no1 continue\no2 endif\nX#1\no1 endrepeat\nX9", &[1, 3, 9]);
    // A branch can contain a loop.
    goes("o1 if [1]\no2 repeat [2]\nX1\no2 endrepeat\no1 else\nX2\no1 endif\nX9", &[1, 1, 9]);
}

#[test]
fn subroutines() {
    goes("o100 sub\nX1\no100 endsub\nX2\no100 call\nX3", &[2, 1, 3]);
    goes("o100 sub\nX[#1+#2]\n#1=50\no100 endsub\n#1=7\no100 call [1] [2]\nX#1\no100 call\nX#1", &[3, 7, 0, 7]);
    goes("o<f> sub\no<f> return [#1*2]\nX99\no<f> endsub\no<f> call [4]\nX#<_value> Y#<_value_returned>", &[8]);
    goes(
        "o1 sub\no1 endsub [5]\no1 call\nX[#<_value>+#<_value_returned>]\no2 sub\no2 endsub\no2 call\nX#<_value>",
        &[6, 0],
    );
    // A name that begins with an underline is global. All other names are local.
    goes("o1 sub\n#<a>=1 #<_b>=2\no1 endsub\no1 call\nX[EXISTS[#<a>]] \nX#<_b>", &[0, 2]);
    // Calls can be nested, and loops can contain calls.
    goes("o1 sub\nX#1\no1 endsub\no2 sub\no1 call [#1+10]\nX#1\no2 endsub\no2 call [1]\nX9", &[11, 1, 9]);
    goes("o1 sub\no2 if [#1 GT 0]\nX#1\no1 call [#1-1]\no2 endif\no1 endsub\no1 call [3]\nX9", &[3, 2, 1, 9]);
    goes("o1 sub\nX#1\no1 endsub\no3 repeat [2]\no1 call [5]\no3 endrepeat\nX9", &[5, 5, 9]);
    goes("o1 sub\no2 while [1]\nX1\no1 return\no2 endwhile\no1 endsub\no1 call\nX9", &[1, 9]);
    // If a subroutine is defined twice, the later definition counts.
    goes("o1 sub\nX1\no1 endsub\no2 sub\nX2\no2 endsub\no1 sub\nX3\no1 endsub\no1 call\no2 call\no1 call", &[3, 2, 3]);
    // A body does not run when it is defined.
    goes("o1 sub\nX1\nM2\no1 endsub\nX2", &[2]);
}

#[test]
fn subroutines_that_do_not_fit() {
    fails("o1 call", &[81], &[]);
    fails("o1 sub\no2 sub\nX1\no1 endsub\no1 call\nX2", &[81, 81, 81, 81], &[2]);
    fails("o1 sub\no2 endsub\nX1\no1 endsub\nX2", &[81, 81, 81], &[2]);
    fails("o1 sub\no1 endsub\no1 call [1\nX1", &[75], &[1]);
    fails("o1 sub\no1 endsub\no1 call 5\nX1", &[81], &[1]);
    // An error within a call ends the call. After that, #1 is the parameter of the main program again.
    fails("o1 sub\n#1=8\nX1\nX[1/0]\nX2\no1 endsub\n#1=7\no1 call\nX#1", &[72], &[1, 7]);
    fails("o1 sub\no2 if [1]\no1 endsub\no1 call\nX1", &[81], &[1]);
    fails("o1 sub\no2 if [0]\no1 endsub\no3 sub\nX5\no3 endsub\no1 call\nX1", &[81], &[1]);
    fails("o1 sub\no1 call\no1 endsub\no1 call\nX1", &[82], &[1]);
    fails("o1 while [1]\no1 endwhile\nX1", &[202], &[1]);
    fails("o1 repeat [2]\no1 return\no1 endrepeat\nX1", &[81], &[1]);
    fails("o1 repeat [2]\no2 break\no1 endrepeat\nX1", &[81], &[1]);
    fails("o1 repeat [2]\no2 endwhile\no1 endrepeat\nX1", &[81], &[1]);
}

#[test]
fn computed_labels_of_calls() {
    let subs = "o4 sub\nX#1\no4 endsub\no5 sub\nX[#1+10]\no5 endsub\no<n> sub\nX9\no<n> endsub\n";
    goes(&format!("{subs}#7=4\no#7 call [3]\n#7=5\no#7 call [3]"), &[3, 13]);
    goes(&format!("{subs}#7=8 #8=4 #<l>=5\no##7 call [1]\no#<l> call [2]\no[#8+[2-1]] call [3] [4]"), &[1, 12, 13]);
    goes(&format!("{subs}o1 sub\no#1 call [#1]\no1 endsub\no1 call [4]\no1 call [5]\nN7 o[2*2] call [6]"), &[4, 15, 6]);
    goes("o7 if [0]\no#1 call\no[1/0] call\no7 endif\nX1", &[1]);
    for (call, error) in [
        ("o#7 call", 81),
        ("o[1/0] call", 72),
        ("o[4.5] call", 81),
        ("o[0-4] call", 81),
        ("o[4 call", 81),
        ("o[4]] call", 81),
        ("o# call", 81),
        ("o#<none> call", 74),
        ("o[4] call 5", 81),
        ("o[10**30] call", 81),
    ] {
        let mut sender = Sender::new();
        sender.send_all(subs).send_all(call).send_all("X1");
        assert_eq!((sender.errors.len(), sender.went), (1, vec![1]), "{call}: {:?}", sender.errors);
        assert!(
            sender.errors[0] == error || ["o[4 call", "o# call", "o[4]] call"].contains(&call),
            "{call}: {:?}",
            sender.errors
        );
    }
    // Only the label of a call can be computed; all other labels must be numbers or names. If the first line of a block
    // is refused, all lines of the block are refused.
    fails("o#1 sub\nX1\no#1 endsub\nX2", &[81; 3], &[2]);
    fails("o[1] repeat [2]\nX1\no[1] endrepeat\nX2", &[81; 3], &[2]);
    fails("o#1 if [1]\nX1\no#1 endif\nX2", &[81, 81], &[2]);
    fails("o1 while [1]\no#2 if [1]\nX1\no#2 endif\no1 endwhile\nX2", &[81; 4], &[2]);
}

#[test]
fn unknown_keywords() {
    for line in ["o16 foo", "o<a>", "o<a> foo [1]", "o16 cal [1]", "o16 gosub", "N5 o16 whil [1]"] {
        fails(&format!("{line}\nX1"), &[81], &[1]);
        goes(&format!("o1 if [0]\n{line}\no1 endif\nX1"), &[1]);
        fails(&format!("o1 repeat [2]\nX2\n{line}\no1 endrepeat\nX1"), &[81, 81], &[1]);
    }
    goes("o1000\nN1 o2000\nX1", &[1]);
    fails("o1000 G0 X5\nX1", &[36], &[1]);
}

/// A subroutine can call itself within two conditions, sixteen calls deep.
#[test]
fn recursion_within_conditions() {
    let sub = "o1 sub\no2 if [#1 GT 0]\no3 if [1]\nX#1\no1 call [#1-1]\no3 endif\no2 endif\no1 endsub\n";
    let places: Vec<i64> = (1..16).rev().collect();
    goes(&format!("{sub}o1 call [15]"), &places);
    fails(&format!("{sub}o1 call [16]\nX0"), &[82], &[(1..=16).rev().collect(), vec![0]].concat());
    // With long names fewer calls can be nested.
    let name = "n".repeat(60);
    let sub = format!("o<{name}> sub\no2 if [#1 GT 0]\nX#1\no<{name}> call [#1-1]\no2 endif\no<{name}> endsub\n");
    goes(&format!("{sub}o<{name}> call [5]"), &[5, 4, 3, 2, 1]);
    fails(&format!("{sub}o<{name}> call [6]\nX0"), &[82], &[6, 5, 4, 3, 2, 1, 0]);
}

/// A word that does not belong in a line with an O keyword is an error. It is never ignored.
#[test]
fn words_behind_a_keyword() {
    for condition in [0, 1] {
        // The refused `endif` still ends the condition.
        fails(&format!("o1 if [{condition}]\nX1\no1 endif X9\nX2"), &[81], [&[2][..], &[1, 2]][condition]);
        // The second branch does not run in either case.
        let went = [&[3][..], &[1, 3]][condition];
        fails(&format!("o1 if [{condition}]\nX1\no1 else X9\nX2\no1 endif\nX3"), &[81], went);
    }
    fails("o1 sub X9\nX1\no1 endsub\nX2\no1 call", &[81; 4], &[2]);
    fails("o1 sub\nX1\no1 endsub X9\nX2\no1 call", &[81, 81], &[2]);
    fails("o1 do X9\nX1\no1 while [0]\nX2", &[81; 3], &[2]);
    fails("o1 do\nX1\no1 while X9\nX2", &[81], &[2]);
    fails("o1 repeat X9\nX1\no1 endrepeat\nX2", &[81; 3], &[2]);
    for end in
        ["o1 endrepeat X9", "o2 endif X9\no1 endrepeat", "o1 break X9\no1 endrepeat", "o1 continue 1\no1 endrepeat"]
    {
        let errors = vec![81; end.lines().count()];
        fails(&format!("o1 repeat [2]\nX1\n{end}\nX2"), &errors, &[2]);
    }
    fails("o1 sub\no1 return X9\no1 endsub\nX2", &[81, 81], &[2]);
}

/// There are 6 KiB for the text of subroutines and loops. If one of them does not fit, all its lines up to its end are
/// refused, so that none of them runs on its own.
#[test]
fn memory_for_text() {
    let line = "G1 F100 X1.5 Y2.5 Z-0.5\n";
    let sub = |label: u32, lines: usize| format!("o{label} sub\n{}o{label} endsub\n", line.repeat(lines));
    let mut sender = Sender::new();
    sender.send_all(&sub(1, 270)).send_all("o1 call");
    assert_eq!((sender.errors.as_slice(), sender.went.len()), (&[][..], 270));
    sender.send_all(&sub(2, 60));
    assert!(sender.errors.len() > 20 && sender.errors.iter().all(|code| *code == 83), "{:?}", sender.errors);
    assert_eq!(sender.went.len(), 270);
    sender.errors.clear();
    sender.send_all("o2 call").send_all("o1 call");
    assert_eq!((sender.errors.as_slice(), sender.went.len()), (&[81][..], 540));
    // Loops leave no text in memory, whether they end normally or by an error.
    let mut sender = Sender::new();
    for _ in 0..100 {
        sender.send_all("o5 repeat [2]\nG0 X1 Y2 Z3\nG0 X1 Y2 Z3\no5 endrepeat");
        sender.send_all("o5 repeat [2]\nG0 X1 Y2 Z3\nnonsense\no5 endrepeat");
    }
    assert_eq!((sender.errors, sender.went.len()), (vec![2; 100], 500));
}

/// With any amount of free memory, no line of a refused block runs outside of the block. A subroutine that is refused
/// repeatedly takes no additional memory.
#[test]
fn refused_in_full_memory() {
    let line = |length: usize| format!("G0X1Y{:0width$}\n", 0, width = length - "G0X1Y".len());
    for free in 0..300 {
        for label in ["2", "<a_name>", &format!("<{}>", "a".repeat(70)), &format!("<{}>", "a".repeat(150))] {
            let mut sender = Sender::new();
            // `body` fills the memory except for `free` bytes. Each line takes one byte more than its length, and the
            // first and last line of the subroutine take 15 bytes together.
            let body = 6144 - 64 - 15 - free;
            let body = line(61).repeat(body / 62 - 1) + &line(61 + body % 62);
            sender.send_all(&format!("o1 sub\n{body}o1 endsub"));
            assert!(sender.errors.is_empty(), "{free}: {:?}", sender.errors);
            for _ in 0..3 {
                sender.send_all(&format!("o{label} sub\n{}o{label} endsub", line(240)));
                sender.send_all(&format!("o{label} repeat [2]\n{}o{label} endrepeat", line(240)));
            }
            if free < 100 {
                assert!(sender.went.is_empty(), "{free} {label}: {:?}", sender.went);
            }
        }
    }
    let mut sender = Sender::new();
    for _ in 0..500 {
        sender.send_all("o1 sub\no2 sub\nX1\no1 endsub");
    }
    sender.errors.clear();
    sender.send_all(&format!("o1 sub\n{}o1 endsub\no1 call", line(61).repeat(97)));
    assert_eq!((sender.errors.as_slice(), sender.went.len()), (&[][..], 97));
}

#[test]
fn the_end_of_a_program() {
    // M2 within a call and a condition closes both.
    goes("o1 sub\nX1\no3 if [1]\nM2\no3 endif\nX2\no1 endsub\no2 if [1]\no1 call\nG0 X3", &[1, 3]);
    fails("o1 sub\nM2\no1 endsub\no1 call\no1 call", &[81], &[]);
    let mut sender = Sender::new();
    sender.send_all("o1 if [0]\nX1");
    assert_eq!(sender.interpreter.skipped(), 1);
    sender.interpreter.reset();
    sender.send_all("X2\no3 repeat [2]\nX3");
    sender.interpreter.abandon_program();
    sender.send("X4");
    assert_eq!(sender.went, [2, 4]);
}

/// `open_since` returns the number of the line that began the outermost open block. It still does after a program has
/// ended inside a block.
#[test]
fn blocks_that_are_left_open() {
    for (text, since) in [
        ("X1\no1 sub\nX2", Some(2)),
        ("o1 if [1]\nX1\no2 if [0]", Some(1)),
        ("o1 if [1]\no2 while [1]\nX1", Some(1)),
        ("X1\n\no1 do\no2 repeat [2]\no2 endrepeat", Some(3)),
        ("o1 repeat [2]\nX1\no1 endrepeat", None),
        ("o1 if [0]\nM2\no1 endif\nX1\nM2", None),
        // A program ends with M2 in a block that stays open. The first program runs its M2, and the second one skips
        // it.
        ("X1\no1 if [1]\nM2", Some(2)),
        ("X1\no1 if [0]\nM2", Some(2)),
        ("o1 if [1]\nM2\nG4 P0\no2 if [1]\no2 endif", None),
        // M2 ends an open loop or call, so it is no longer open.
        ("o1 sub\nM2\no1 endsub\no1 call", None),
        ("o1 repeat [2]\no2 if [1]\nM30\no2 endif\no1 endrepeat", None),
        ("o2 if [1]\no1 repeat [2]\nM30\no1 endrepeat", Some(1)),
    ] {
        let mut sender = Sender::new();
        sender.send_all(text);
        assert_eq!(sender.interpreter.open_since(), since, "{text}");
        sender.interpreter.reset();
        assert_eq!(sender.interpreter.open_since(), None);
    }
}

/// After an M2 that was skipped or stored in a block, only an O word is accepted. So the lines of the next program are
/// not taken for a part of the open block.
#[test]
fn the_next_program_is_none_of_an_open_block() {
    for end in ["M2", "M30", "G0 X5 M02", "N5 M030", "M5M2"] {
        for begin in ["o1 if [0]", "o1 sub", "o1 while [0]", "o1 if [1]\no1 else"] {
            fails(&format!("{begin}\nX1\n{end}\nX2\nX3\no1 endif"), &[81, 81], &[3]);
            goes(&format!("{begin}\n{end}\nX9").replace(end, "#1=#<_M2> M20 M3 M2.5"), &[]);
        }
    }
    fails("#1=5\no1 sub\nM2\nG4 P0\nX#1", &[81], &[0]);
    goes("o1 sub\nM2\no1 endsub\nX1\no2 if [0]\nM2\no2 else\nX2\no2 endif\nX3", &[1, 2, 3]);
    for (begin, error) in [("o1 if [0]\nX1", 81), ("o1 if [1]", 81), ("o1 do", 81), ("X1", 0), ("o1 sub\no1 endsub", 0)]
    {
        let mut sender = Sender::new();
        sender.send_all(begin);
        assert_eq!(sender.interpreter.tape_mark().map_or_else(|error| error.code(), |()| 0), error, "{begin}");
        sender.went.clear();
        sender.send("X2");
        assert_eq!((sender.went, sender.interpreter.tape_mark()), (vec![2], Ok(())));
    }
}

/// A line with only O and a number (the number of a program) is no O word.
#[test]
fn numbers_of_programs_are_left_to_the_check() {
    let mut interpreter = Interpreter::<3>::default();
    for line in [&b"O1000"[..], b"N10O1000", b"OX", b"O", b"N", b"O<A", b"O1X5", b"O#1", b"O[1]"] {
        assert_eq!(interpreter.direct(line, &[], 1), Ok(Direction::Check), "{line:?}");
    }
}

proptest! {
    /// Any program of O words ends, and lines after a reset run.
    #[test]
    fn any_program_ends(lines in prop::collection::vec(
        "(o[123] ?(sub|endsub|call|return|if|elseif|else|endif|while|endwhile|do|repeat|endrepeat|break|continue) \
         ?(|\\[#1\\]|\\[#1 LT 2\\]|\\[2\\]|\\[0\\]|\\[1\\]))|#1=\\[#1\\+1\\]|G0X1|M2",
        0..40,
    )) {
        let mut sender = Sender::new();
        for line in &lines {
            sender.send(line);
        }
        sender.interpreter.reset();
        sender.went.clear();
        sender.send("G0 X5");
        prop_assert_eq!(sender.went, vec![5]);
    }
}

/// Each case behaves as in LinuxCNC's interpreter.
#[test]
fn states_saved_until_a_call_returns() {
    // M73 saves the modal state until the call returns, so inches and G91 act only within the subroutine. The motion
    // word is not restored.
    goes("o1 sub\nM73\nG91 G0 X1\nX1\nG20 X1\no1 endsub\nG90 G0 X5\no1 call\nX10", &[5, 6, 7, 32, 10]);
    goes(
        "o1 sub\nM73\nG91\no1 if [#1]\no1 return\no1 endif\nX1\no1 endsub\nX5\no1 call [1]\nX3\no1 call [0]\nX4",
        &[5, 3, 4, 4],
    );
    // The returned value is computed before the state is restored.
    goes("o1 sub\nM73\nG91\no1 endsub [#<_incremental>+6]\no1 call\nX#<_value>", &[7]);
    // Each call saves a state of its own. A call within a call restores its state before its caller continues.
    goes("o1 sub\nM73\nG91\no2 call\nX1\no1 endsub\no2 sub\nM73\nG90\nX8\no2 endsub\nX5\no1 call\nX1", &[5, 8, 9, 1]);
    goes(
        "o1 sub\nG91\nM70\nG90\no2 call\nM72\nX1\no1 endsub\no2 sub\nM70\nG90\nM72\no2 endsub\nM70\nX5\no1 call\nM72\nX1",
        &[5, 6, 1],
    );
    // M70 saves the state, M71 drops the saved state, and M72 restores it at once. M73 saves it and restores it at the
    // end of the call. If an M70 follows the M73, the end of the call restores what M70 has saved. If an M71 follows,
    // nothing is restored. But if an M70 comes after that M71, the end of the call restores what this M70 has saved.
    goes("o1 sub\nM73\nG91\nM70\nG90\no1 endsub\nX5\no1 call\nX1", &[5, 6]);
    goes("o1 sub\nM73\nM71\nM70\nG91\no1 endsub\nX5\no1 call\nX1", &[5, 1]);
    goes("o1 sub\nM73\nM71\nG91\no1 endsub\nX5\no1 call\nX1", &[5, 6]);
    goes("o1 sub\nM70\nM73\nG91\nX1\nM72\nX1\nG91\no1 endsub\nX5\no1 call\nX1", &[5, 6, 1, 1]);
    // If a loop runs M73 several times, the last M73 counts.
    goes("o1 sub\no2 repeat [2]\nM73\nG91\no2 endrepeat\no1 endsub\nX5\no1 call\nX1", &[5, 6]);
    // Outside subroutines M73 acts as M70.
    goes("M73\nG91\nX5\nM72\nX1\nM72\nX2", &[5, 1, 2]);
}

#[test]
fn states_of_other_calls_are_not_restored() {
    fails("o1 sub\nM72\no1 endsub\nM70\no1 call\nX1", &[123], &[1]);
    fails("o1 sub\nM73\no1 endsub\no1 call\nM72\nX1", &[123], &[1]);
    fails("o1 sub\nM70\no2 call\no1 endsub\no2 sub\nM72\no2 endsub\no1 call\nX1", &[123], &[1]);
    // An error ends the subroutine and drops its saved state. No later call restores that state.
    fails(
        "o1 sub\nM73\nG91\nnonsense\no1 endsub\nX5\no1 call\nX1\no2 sub\nX1\no2 endsub\no2 call\nG90\nX1",
        &[2],
        &[5, 6, 7, 1],
    );
    fails("o1 sub\nM73\nG91\nM2\no1 endsub\nX5\no1 call\nG91 G0 X1\nM72", &[123], &[5, 6]);
    fails("o1 sub\nM73 G91\no1 endsub\no1 call\nM72 X1", &[21, 21], &[]);
    // The main program and seven nested calls can each save a state.
    let deep = |calls: u32| {
        format!(
            "o1 sub\nM73\nG91\nX1\no2 if [#1 GT 1]\no1 call [#1-1]\no2 endif\no1 endsub\nM70\nX5\no1 call [{calls}]\nX1"
        )
    };
    goes(&deep(7), &[5, 6, 7, 8, 9, 10, 11, 12, 1]);
    fails(&deep(8), &[82], &[5, 6, 7, 8, 9, 10, 11, 12, 13]);
}
