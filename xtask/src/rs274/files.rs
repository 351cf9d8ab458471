//! `cargo xtask rs274 files FOLDER...`: runs complete programs by other authors through both interpreters.
//!
//! A program counts as equal if both interpreters produce the same events up to its end, or up to the line that both
//! reject. Programs that only one of them rejects are listed with the reason; different events in a program that both
//! accept are a difference.

use super::canon::Settings;
use super::ours::Mill;
use super::{Event, canon};
use crate::Failure;
use oxmill_controller::gcode::{Direction, Flow, Held, HeldLine, Interpreter, split_comment};
use oxmill_controller::protocol::line_filter::{self, Line, LineRules, Pushed};
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// Maximum number of lines of a program that are carried out, counting each pass of a loop.
const MOST_LINES: usize = 200_000;
/// Files with this ending are programs.
const ENDING: &str = "ngc";
/// Numbers of the tools that are entered into the tool tables of both interpreters, without offsets.
const TOOLS: std::ops::RangeInclusive<u32> = 1..=30;

/// The result of a program in Oxmill's interpreter.
struct Ours {
    events: Vec<Event>,
    /// Number of the rejected line in the file, and the reason; `None` if no line was rejected.
    refused: Option<(usize, String)>,
}

/// Compares the programs at these paths: files, and all `.ngc` files below folders. Of equal files only one is
/// compared.
pub fn run(paths: &[&str]) -> Result<(), Failure> {
    let mut files = Vec::new();
    for path in paths {
        collect(Path::new(path), &mut files)?;
    }
    files.sort();
    files.dedup();
    if files.is_empty() {
        return Err(format!("no .{ENDING} file in {}", paths.join(", ")));
    }
    let home = crate::root().join("target/rs274/files");
    let mut seen: BTreeMap<Vec<u8>, PathBuf> = BTreeMap::new();
    let mut counts: BTreeMap<&str, Vec<String>> = BTreeMap::new();
    for file in files {
        let text = fs::read(&file).map_err(|e| format!("{}: {e}", file.display()))?;
        if seen.contains_key(&text) {
            continue;
        }
        let _ = fs::remove_dir_all(&home);
        fs::create_dir_all(&home).map_err(|e| e.to_string())?;
        let (verdict, what, _) = judge(&home, &file, &text)?;
        counts.entry(verdict).or_default().push(format!("{}: {what}", file.display()));
        seen.insert(text, file);
    }
    for (verdict, files) in &counts {
        println!("{verdict}: {}", files.len());
        if *verdict != ALIKE {
            files.iter().for_each(|file| println!("  {file}"));
        }
    }
    let of = |verdict| counts.get(verdict).map_or(0, Vec::len);
    let [alike, both, declined, only, differ] = [ALIKE, BOTH_REFUSE, DECLINED, ONLY_RS274, DIFFER].map(of);
    println!(
        "{} programs: {alike} alike, {both} refused by both, {declined} declined by Oxmill alone, {only} refused by rs274 alone, {differ} differ",
        seen.len()
    );
    Ok(())
}

/// Verdict: both interpreters have run the whole program, with the same events.
pub const ALIKE: &str = "alike";
const BOTH_REFUSE: &str = "refused by both, alike up to there";
const DECLINED: &str = "declined by Oxmill alone, alike up to there";
const ONLY_RS274: &str = "refused by rs274 alone, alike up to there";
const DIFFER: &str = "differ";

fn collect(path: &Path, files: &mut Vec<PathBuf>) -> Result<(), Failure> {
    let failed = |e: std::io::Error| format!("{}: {e}", path.display());
    if !path.is_dir() {
        path.metadata().map_err(failed)?;
        files.push(path.to_owned());
        return Ok(());
    }
    for entry in fs::read_dir(path).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        if path.is_dir() {
            collect(&path, files)?;
        } else if path.extension().is_some_and(|ending| ending == ENDING) {
            files.push(path);
        }
    }
    Ok(())
}

/// Runs a program through both interpreters. Returns the verdict with its reason, and the number of Oxmill's events.
pub fn judge(home: &Path, file: &Path, text: &[u8]) -> Result<(&'static str, String, usize), Failure> {
    let tools: String = TOOLS.map(|tool| format!("T{tool} P{tool}\n")).collect();
    let theirs = canon::interpret(home, file, &Settings { tools: &tools, deletes_blocks: false, reports_all: false })?;
    let ours = interpret(text);
    let alike = ours.events.iter().zip(&theirs.events).take_while(|(a, b)| a.is_as(b)).count();
    let (mine, others) = (ours.events.len(), theirs.events.len());
    let first = || format!("event {alike}: Oxmill {:?}, rs274 {:?}", ours.events.get(alike), theirs.events.get(alike));
    let (verdict, what) = match (ours.refused, theirs.refused) {
        (None, None) if alike == mine && alike == others => (ALIKE, String::new()),
        (Some((line, why)), None) if alike == mine => (DECLINED, format!("line {line}, {why}")),
        (None, Some(why)) if alike == others => (ONLY_RS274, why),
        (Some((line, why)), Some(other)) if alike == mine.min(others) => {
            (BOTH_REFUSE, format!("line {line}, {why}; rs274: {other}"))
        }
        (refused, other) => (DIFFER, format!("{}; refused: {refused:?}, {other:?}", first())),
    };
    Ok((verdict, what, mine))
}

/// Carries out a program in Oxmill's interpreter, to its end or to the first line that is rejected.
fn interpret(text: &[u8]) -> Ours {
    let mut program = Program { mill: Mill::new(), lines: 0, events: Vec::new() };
    for tool in TOOLS {
        let entered = program.mill.run(&format!("G10 L1 P{tool} X0 Y0 Z0"));
        assert!(entered.is_ok(), "the table has room for tool {tool}");
    }
    // LinuxCNC starts in G99, so Oxmill is set to it, too.
    assert!(program.mill.run("G99").is_ok());
    let rules = || LineRules {
        length: line_filter::LENGTH,
        merge_crlf: true,
        nested_comments: false,
        expressions: true,
        block_delete: false,
    };
    let mut line = Line::new();
    let (mut number, mut tape_marks) = (1, 0);
    let mut refused = None;
    for byte in text.iter().chain(b"\n") {
        match line.push(*byte, rules) {
            Pushed::More => {}
            Pushed::TooLong => {
                refused = Some((number, "a line that is too long".to_owned()));
                break;
            }
            Pushed::Complete => {
                let words = line.text().to_vec();
                line.clear();
                tape_marks += usize::from(words.first() == Some(&b'%'));
                // A second tape mark ends a program.
                let end = if tape_marks > 1 { Ok(true) } else { program.line(&words, number) };
                match end {
                    Ok(false) => {}
                    Ok(true) => break,
                    Err(why) => {
                        refused = Some((number, why));
                        break;
                    }
                }
            }
        }
        number += usize::from(*byte == b'\n');
    }
    Ours { events: program.events, refused }
}

struct Program {
    mill: Mill,
    lines: usize,
    events: Vec<Event>,
}

impl Program {
    /// Carries out a line of the file; returns `true` at the end of the program.
    fn line(&mut self, text: &[u8], number: usize) -> Result<bool, String> {
        if text.is_empty() || text.starts_with(b"%") {
            return Ok(false);
        }
        let direction = self.interpreter().direct(text, &[], number as u32).map_err(tell)?;
        match direction {
            Direction::Check => self.carry_out(text),
            Direction::Run | Direction::Call => self.run_held(),
            Direction::Done | Direction::LeftOut => Ok(false),
        }
    }

    fn interpreter(&mut self) -> &mut Interpreter<{ super::AXES }> {
        self.mill.interpreter()
    }

    fn run_held(&mut self) -> Result<bool, String> {
        let mut held = HeldLine::new();
        loop {
            match self.interpreter().next_held(&mut held).map_err(tell)? {
                Held::Line => {
                    let line = held.clone();
                    let (words, _) = split_comment(&line);
                    if !words.is_empty() && self.carry_out(words)? {
                        return Ok(true);
                    }
                }
                Held::Again => self.count()?,
                Held::End => return Ok(false),
            }
        }
    }

    fn count(&mut self) -> Result<(), String> {
        self.lines += 1;
        if self.lines > MOST_LINES { Err(format!("more than {MOST_LINES} lines")) } else { Ok(()) }
    }

    fn carry_out(&mut self, text: &[u8]) -> Result<bool, String> {
        self.count()?;
        let text = String::from_utf8_lossy(text).into_owned();
        let (events, flow) = self.mill.carry_out(&text).map_err(|error| format!("{} in {text}", tell(error)))?;
        self.events.extend(events.into_iter().filter(|event| !matches!(event, Event::Rate(_))));
        Ok(flow == Flow::End)
    }
}

fn tell(error: oxmill_controller::error::Error) -> String {
    format!("error:{}", error.code())
}
