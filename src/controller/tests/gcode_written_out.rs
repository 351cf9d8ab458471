//! Tests of two properties of subprograms. A program acts like the same program with its calls written out. And no
//! mixture of lines runs a subprogram without a call.
#![cfg(feature = "full")]

use crate::subprogram_sender::Sender;
use oxmill_controller::error::Error;
use proptest::prelude::*;

/// A line of a random program: a move to an X of this number plus #1, an addition of this number to #1, or a call.
#[derive(Clone, Debug)]
enum Step {
    Move(i64),
    Add(i64),
    /// A call. The first number selects the called program, counted from this one: 0 is the next program. Then come
    /// the number of repeats, and the argument if the call is a G65.
    Call(usize, u16, Option<i64>),
}

fn step() -> impl Strategy<Value = Step> {
    prop_oneof![
        3 => (-50_i64..50).prop_map(Step::Move),
        1 => (-5_i64..5).prop_map(Step::Add),
        2 => (0_usize..3, 1_u16..4, prop::option::of(-9_i64..9)).prop_map(|(to, times, with)| Step::Call(to, times, with)),
    ]
}

/// Returns the lines of the program with this index. The first program is the main program. Each program calls only
/// programs with a higher index.
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

/// Appends the X targets of a program to `went`, including the X targets of the programs that it calls. `one` is the
/// value of #1.
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

/// A line of a program, or a call. The first number of a call selects the called program, counted from this one: 0 is
/// the next program. Then come the number of repeats, and the arguments if the call is a G65.
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

/// Returns the lines of a program with its calls. If `behind` is `true` and the line before an M98 ends with G90, the
/// M98 is appended to that line.
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

/// Appends the lines of a program. Each call is replaced by the lines of the called program, and each parameter of
/// `ARGUMENTS` by its value.
fn expand(programs: &[Vec<Line>], index: usize, values: &[i64; 3], lines: &mut Vec<String>) {
    for line in &programs[index] {
        match line {
            Line::Text(words) => {
                // Replace the longest name first, because #26 begins with #2.
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
    /// A program with subprograms makes the same moves as the same program with its calls written out. The subprograms
    /// after the main program can be in any order.
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

    /// Programs with all kinds of lines (arcs, cycles, modes, dwells and arguments) act the same as with their calls
    /// written out.
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
        // Many relative moves can lead beyond 50 m, where a line is refused. A refusal within a
        // subprogram ends all its callers, but the same lines without calls go on. So the test leaves out programs with
        // such a line.
        prop_assume!(!written.2.contains(&Error::InvalidTarget.code()));
        prop_assert_eq!(called, written, "{}\n---\n{}", text, lines.join("\n"));
    }

    /// The lines after the first O number run only in calls, and never in the next job. That holds for any mixture of
    /// lines, even if the host pauses while a program waits for its subprograms, or within a subprogram.
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
            // This test is not about open blocks, so they are closed here. A held program is ended, too.
            sender.send_all("o1 endif\no1 endrepeat\no9 endsub\nEND1");
        }
        sender.send_all("M30\nO5");
        for (line, rests) in &lines {
            // The host pauses only while a program waits for its subprograms, or within a subprogram. If it paused
            // after a complete subprogram, the lines after the pause would belong to the next program.
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
