//! Runs the fences named `conversation` and compares the answers.

use crate::{all_pages, keep, read, root};
use oxmill_controller::messages::Realtime;
use oxmill_simulator::{Fittings, Options, Simulator};
use std::collections::BTreeMap;
use std::fs;

const FENCE: &str = "```conversation\n";
/// Pages for work at a machine. On these pages, all lines for the machine must be in fences named `conversation`.
const HANDS_ON: [&str; 5] = ["boards", "first-cut", "set-up", "tuning", "troubleshooting"];

/// Returns a new machine. If the page has a mark `<!-- machine: FILE -->`, FILE describes the hardware of this machine,
/// in the format that the option `--machine` reads.
fn machine(page: &str) -> Simulator {
    let fittings = page.split("<!-- machine: ").nth(1).and_then(|rest| rest.split_once(" -->")).map(|(file, _)| {
        let text = fs::read_to_string(root().join(file)).unwrap_or_else(|error| panic!("{file}: {error}"));
        Fittings::parse(&text).expect("a machine")
    });
    let mut mill = Simulator::new(Options { fittings: fittings.unwrap_or_default(), ..Options::default() });
    mill.run_until_idle();
    mill.take_output();
    mill
}

/// Sends the text of a line that begins with `> `. A realtime command is sent without a line end.
fn send(mill: &mut Simulator, line: &str) {
    match line {
        "?" => mill.press(Realtime::Status),
        "!" => mill.press(Realtime::FeedHold),
        "~" => mill.press(Realtime::CycleStart),
        "0x18" => mill.press(Realtime::Reset),
        _ => mill.send(format!("{line}\n")),
    }
}

/// Sends the lines of a fence to the machine. Returns these lines with the machine's answers, and the number of lines.
/// A line after `> ` goes to the controller. A line after `* ` sets an input pin, as `--pins` does. Virtual time then
/// runs until the machine is idle, or for half a second if the line ends in ` ...`.
fn said(mill: &mut Simulator, fence: &str) -> (String, usize) {
    let (mut now, mut seen) = (String::new(), 0);
    for line in fence.lines().filter(|line| line.starts_with("> ") || line.starts_with("* ")) {
        let (words, waits) = line[2..].split_once(" ...").map_or((&line[2..], true), |(words, _)| (words, false));
        if line.starts_with("* ") {
            assert_eq!(mill.pin_line(words), "ok", "{line}");
        } else {
            send(mill, words);
        }
        let done = !waits || mill.run_until_idle();
        if !waits {
            mill.run_for(std::time::Duration::from_millis(500));
        }
        let answer = mill.take_output().replace('\r', "");
        // The machine must become idle after each line. Exception: after an alarm that only a reset ends, the
        // controller reads no more lines.
        assert!(done || answer.contains("ALARM"), "{line}: {answer}");
        now += &format!("{line}\n{answer}");
        seen += 1;
    }
    (now, seen)
}

/// All fences of a page are one conversation with one new machine.
#[test]
fn conversations_of_the_pages_are_what_is_said() {
    let mut seen = 0;
    for page in all_pages().iter().filter(|page| read(page).contains(FENCE)) {
        keep(page, |text| {
            let mut mill = machine(text);
            let mut parts = text.split(FENCE);
            let mut now = parts.next().unwrap_or_default().to_owned();
            for part in parts {
                let (fence, rest) = part.split_once("```").expect("the fence ends");
                let (answers, lines) = said(&mut mill, fence);
                now += &format!("{FENCE}{answers}```{rest}");
                seen += lines;
            }
            now
        });
    }
    assert!(seen > 80, "{seen} lines");
}

/// Only fences named `conversation` are tested. So lines for the machine must not be in other fences.
#[test]
fn pages_with_hands_on_say_all_lines_in_conversations() {
    for name in HANDS_ON {
        for (kind, lines) in crate::fences(&read(&root().join(format!("docs/{name}.md")))) {
            let known = ["conversation", "sh", "console", "toml", "text"].contains(&kind.as_str());
            assert!(known, "docs/{name}.md has a fence `{kind}`");
            let for_machines = |line: &&String| {
                let mut begin = line.chars();
                let [first, second] = [begin.next(), begin.next()];
                first.is_some_and(|c| "$GM".contains(c)) && second.is_some_and(|c| c != ' ')
            };
            let stray = lines.iter().find(for_machines).filter(|_| kind != "conversation");
            assert!(stray.is_none(), "docs/{name}.md: {stray:?} in a fence `{kind}`");
        }
    }
}

/// Reads the settings that a text assigns in lines `$n=v`. Returns the values by setting number. If a text assigns a
/// setting several times, the last value counts. Only lines that begin with `before` are read.
fn assignments(text: &str, before: &str) -> BTreeMap<u16, String> {
    let lines = text.lines().filter_map(|line| line.strip_prefix(before)?.strip_prefix('$')?.split_once('='));
    lines.filter_map(|(number, value)| Some((number.parse().ok()?, value.to_owned()))).collect()
}

/// `examples/mill.txt` has the settings that result from docs/set-up.md.
#[test]
fn the_settings_of_the_example_are_those_of_the_page() {
    let page = read(&root().join("docs/set-up.md"));
    let (until_restored, _) = page.split_once("> $RST=$").expect("the end");
    let settings = assignments(until_restored, "> ");
    assert!(settings.len() > 20, "{settings:?}");
    assert_eq!(settings, assignments(&read(&root().join("examples/mill.txt")), ""));
}
