//! Runs the commands that pages show, and compares their output and the durations of jobs in tables.

use crate::{all_pages, keep, read, root};
use std::process::{Command, Stdio};

const FENCE: &str = "```console\n";

/// Runs the `oxmill` program of this tree in the root folder. Returns its output.
pub fn oxmill(words: &[&str]) -> String {
    let output =
        Command::new(env!("CARGO_BIN_EXE_oxmill")).args(words).current_dir(root()).stdin(Stdio::null()).output();
    let output = output.expect("the program starts");
    assert!(output.stderr.is_empty(), "{words:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).expect("text")
}

/// In a fence named `console`, a line after `$ ` is a command. The lines after it must be its output.
#[test]
fn consoles_of_the_pages_are_what_is_printed() {
    let mut seen = 0;
    for page in all_pages().iter().filter(|page| read(page).contains(FENCE)) {
        keep(page, |text| {
            let mut parts = text.split(FENCE);
            let mut now = parts.next().unwrap_or_default().to_owned();
            for part in parts {
                let (fence, rest) = part.split_once("```").expect("the fence ends");
                now += FENCE;
                for line in fence.lines().filter_map(|line| line.strip_prefix("$ oxmill ")) {
                    let words: Vec<&str> = line.split_whitespace().collect();
                    now += &format!("$ oxmill {line}\n{}", oxmill(&words));
                    seen += 1;
                }
                now += &format!("```{rest}");
            }
            now
        });
    }
    assert!(seen > 1, "{seen} commands");
}

/// Returns the duration of a job according to the program's report.
fn time(words: &[&str]) -> String {
    let report = oxmill(words);
    let time = report.lines().find_map(|line| line.trim().strip_prefix("time")).expect("a time");
    time.trim().to_owned()
}

/// Measures the durations in the tables of a page again, and returns the page with these durations. The first head cell
/// of such a table is a command, `oxmill check JOB ...`. In each row, the first cell has words that are added to the
/// command, and the second cell has the duration.
fn measured(text: &str, seen: &mut usize) -> String {
    let mut common: Vec<&str> = Vec::new();
    let mut now = String::new();
    for line in text.lines() {
        let head = line.strip_prefix("| `oxmill check ").and_then(|rest| rest.split_once(" ...` |"));
        if let Some((words, _)) = head {
            common = words.split_whitespace().collect();
        }
        let row = line.strip_prefix("| `").filter(|_| head.is_none() && !common.is_empty());
        if let Some((words, rest)) = row.and_then(|rest| rest.split_once("` | ")) {
            let words: Vec<&str> = ["check"].iter().chain(&common).copied().chain(words.split_whitespace()).collect();
            let (_, other_cells) = rest.split_once(" |").expect("a cell");
            let (cells, _) = line.split_at(line.find("` | ").unwrap_or_default());
            now += &format!("{cells}` | {} |{other_cells}\n", time(&words));
            *seen += 1;
        } else {
            if !line.starts_with('|') {
                common.clear();
            }
            now += &format!("{line}\n");
        }
    }
    now
}

#[test]
fn times_in_tables_are_what_jobs_take() {
    let mut seen = 0;
    for page in all_pages().iter().filter(|page| read(page).contains("\n| `oxmill check ")) {
        keep(page, |text| measured(text, &mut seen));
    }
    assert!(seen > 10, "{seen} times");
}
