//! `cargo xtask rs274`: runs random programs through Oxmill's interpreter and through LinuxCNC's (`rs274`, Debian
//! package `linuxcnc-uspace`) and compares the results: every end point, arc and dwell, their order, and rejections.

mod canon;
mod expressions;
mod files;
mod flow;
mod ours;
mod programs;
mod runner;
mod subprograms;

use crate::{Failure, root};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Default number of programs.
const PROGRAMS: usize = 10_000;
/// Number of programs that one process of `rs274` runs one after the other.
const BATCH: usize = 25;
/// Maximum difference of end points, mm: `rs274` prints four decimals, even in inches.
const TOLERANCE: f64 = 0.003;
/// Maximum difference of parameter values, because `rs274` has five decimals of inches. For values above 1 it is a
/// relative difference.
const VALUE_TOLERANCE: f64 = 3e-4;
/// Maximum relative difference of G93 rates, in addition to [`TOLERANCE`].
const RATE_TOLERANCE: f64 = 2e-4;
/// Minimum rates in G93, mm/min, for programs in mm and in inches. `rs274` replaces a lower rate by 0.1 units of the
/// program per minute.
const LEAST_RATES: [f64; 2] = [0.1, 2.54];
/// First word of the messages in generated programs, except those that show stored positions ([`PLACES_MARK`]).
const STATE: &str = "state";
/// First word of messages that show stored positions, which are in inches in `rs274`.
const PLACES_MARK: &str = "places";
/// Moves shorter than this, mm, are left out of the events of both interpreters.
const NO_MOVE: f64 = 0.0075;
/// Number of lines printed before one that differs.
const BEFORE: usize = 8;
/// Maximum number of differences printed.
const SHOWN: usize = 10;

/// Number of axes: X, Y and Z in mm, and A in degrees.
pub const AXES: usize = 4;

/// An action of a program. Positions are in work coordinates: X, Y and Z in mm, A in degrees.
#[derive(Clone, Debug)]
pub enum Event {
    Rapid([f64; AXES]),
    Feed([f64; AXES]),
    /// An arc: its end, its centre in the plane, and its number of turns, negative if clockwise.
    Arc([f64; AXES], [f64; 2], i64),
    /// A spline with this number of control points.
    Spline(u8),
    /// A dwell, s.
    Dwell(f64),
    /// A program output (M62 to M65, M67, M68). The four values are: `true` if the output is analog; its number; its
    /// new value; `true` if it changes with the next motion.
    Output(bool, i64, f64, bool),
    /// Feed rate of the feed move or arc before this event, mm/min. Occurs only in G93, where the rate follows from the
    /// length and the programmed time.
    Rate(f64),
    Message(String),
    /// A program stop; `true`: an optional stop.
    Stop(bool),
}

/// Returns whether two texts have equal words and nearly equal numbers. In messages with stored positions, `rs274`
/// shows values below 0.0001 inch as 0.
fn is_same_text(a: &str, b: &str) -> bool {
    let least = if a.starts_with(PLACES_MARK) { TOLERANCE } else { VALUE_TOLERANCE };
    let is_same = |(a, b): (&str, &str)| match (a.parse::<f64>(), b.parse::<f64>()) {
        (Ok(a), Ok(b)) => (a - b).abs() <= least.max(VALUE_TOLERANCE * a.abs()),
        _ => a == b,
    };
    a.split_whitespace().count() == b.split_whitespace().count()
        && a.split_whitespace().zip(b.split_whitespace()).all(is_same)
}

impl Event {
    fn is_as(&self, other: &Event) -> bool {
        fn near<const N: usize>(a: &[f64; N], b: &[f64; N]) -> bool {
            a.iter().zip(b).all(|(a, b)| (a - b).abs() <= TOLERANCE)
        }
        match (self, other) {
            (Event::Rapid(a), Event::Rapid(b)) | (Event::Feed(a), Event::Feed(b)) => near(a, b),
            (Event::Arc(a, c, n), Event::Arc(b, d, m)) => near(a, b) && near(c, d) && n == m,
            (Event::Spline(a), Event::Spline(b)) => a == b,
            (Event::Dwell(a), Event::Dwell(b)) => (a - b).abs() < 0.0006,
            (Event::Output(a, n, v, w), Event::Output(b, m, u, x)) => {
                (a, n, w) == (b, m, x) && (v - u).abs() <= TOLERANCE
            }
            (Event::Rate(a), Event::Rate(b)) => {
                (a - b).abs() <= TOLERANCE + RATE_TOLERANCE * a.abs()
                    || LEAST_RATES.iter().any(|least| a < least && (b - least).abs() < TOLERANCE)
            }
            (Event::Message(a), Event::Message(b)) => is_same_text(a, b),
            (Event::Stop(a), Event::Stop(b)) => a == b,
            _ => false,
        }
    }
}

/// Events of a batch in one of the interpreters, and the line that it has rejected, if any.
pub struct Outcome {
    pub events: Vec<Event>,
    /// For each event, the index of the line that caused it; empty for `rs274`.
    pub of: Vec<usize>,
    /// Text of the rejected line, if any; Oxmill's `events` end before it.
    pub refused: Option<String>,
}

/// Runs the comparison. `arguments`: a number of programs and a seed, both optional; or `files` and paths.
pub fn run(arguments: &[&str]) -> Result<(), Failure> {
    if Command::new("rs274").arg("-h").stdout(Stdio::null()).stderr(Stdio::null()).status().is_err() {
        return Err("rs274 is not installed: it is part of the Debian package linuxcnc-uspace".into());
    }
    if let Some(("files", paths)) = arguments.split_first().map(|(first, rest)| (*first, rest)) {
        return files::run(paths);
    }
    let number = |at: usize, default: usize| match arguments.get(at) {
        None => Ok(default),
        Some(text) => text.parse().map_err(|_| format!("not a number: {text}")),
    };
    let (count, seed) = (number(0, PROGRAMS)?, number(1, 1)?);
    if count == 0 {
        return Err("0 programs compare nothing".into());
    }
    let folder = &root().join("target/rs274");
    let batches = count.div_ceil(BATCH);
    let next = AtomicUsize::new(0);
    let totals = Mutex::new(Totals::default());
    let threads = std::thread::available_parallelism().map_or(1, |n| n.get());
    std::thread::scope(|scope| {
        for thread in 0..threads {
            let (next, totals) = (&next, &totals);
            let home = folder.join(format!("home{thread}"));
            scope.spawn(move || {
                loop {
                    let batch = next.fetch_add(1, Ordering::Relaxed);
                    if batch >= batches {
                        return;
                    }
                    let programs = BATCH.min(count - batch * BATCH);
                    let found = one_batch(&home, batch, (seed as u64) << 32 | batch as u64, programs);
                    totals.lock().unwrap_or_else(PoisonError::into_inner).add(batch, found);
                }
            });
        }
    });
    let totals = totals.into_inner().unwrap_or_else(PoisonError::into_inner);
    totals.tell(count, seed)
}

#[derive(Default)]
struct Totals {
    lines: usize,
    events: usize,
    refused: usize,
    differences: Vec<String>,
}

/// Result of the comparison of one batch. `lines` and `events`: numbers of lines and of Oxmill's events. `refused`:
/// `true` if the batch ends with a rejected line. `difference`: the first difference.
struct Found {
    lines: usize,
    events: usize,
    refused: bool,
    difference: Option<String>,
}

impl Totals {
    fn add(&mut self, batch: usize, found: Result<Found, Failure>) {
        match found {
            Ok(found) => {
                self.lines += found.lines;
                self.events += found.events;
                self.refused += usize::from(found.refused);
                self.differences.extend(found.difference.map(|difference| format!("batch {batch}: {difference}")));
            }
            Err(why) => self.differences.push(format!("batch {batch}: {why}")),
        }
    }

    fn tell(self, count: usize, seed: usize) -> Result<(), Failure> {
        println!(
            "{count} programs (seed {seed}), {} lines, {} moves, arcs, dwells and messages compared, {} refused lines: {} batches differ",
            self.lines,
            self.events,
            self.refused,
            self.differences.len()
        );
        if self.differences.is_empty() {
            return Ok(());
        }
        Err(self.differences.iter().take(SHOWN).cloned().collect::<Vec<_>>().join("\n\n"))
    }
}

/// Compares `programs` random programs that contain subprograms. Each program is a file of its own, because its main
/// part ends with M30.
fn batch_of_files(home: &Path, seed: u64, programs: usize) -> Result<Found, Failure> {
    let mut found = Found { lines: 0, events: 0, refused: false, difference: None };
    for number in 0..programs {
        let text = subprograms::program(seed << 8 | number as u64);
        let lines: Vec<String> = text.lines().map(str::to_owned).collect();
        let file = write(home, &lines)?;
        let (verdict, what, events) = files::judge(home, &file, text.as_bytes())?;
        found.lines += lines.len();
        found.events += events;
        if verdict != files::ALIKE {
            found.difference = Some(format!("{verdict}: {what}\n{text}"));
            break;
        }
    }
    Ok(found)
}

fn one_batch(home: &Path, batch: usize, seed: u64, programs: usize) -> Result<Found, Failure> {
    if batch % 8 == 6 {
        return batch_of_files(home, seed, programs);
    }
    // Half of the batches have parameters and O words; in half of these, both interpreters skip the lines that start
    // with a slash.
    let has_flow = batch % 2 == 1;
    let deletes_blocks = batch % 4 == 3;
    let written = match has_flow {
        true => flow::batch(seed, programs, deletes_blocks),
        false => programs::batch(seed, programs),
    };
    let (lines, ours) = (written.lines, written.outcome);
    let file = write(home, &lines)?;
    let settings = canon::Settings { tools: "T1 P1\nT2 P2\nT7 P7\n", deletes_blocks, reports_all: has_flow };
    let mut theirs = canon::interpret(home, &file, &settings)?;
    if has_flow {
        theirs.refused = theirs.refused.map(|line| flow::without_blanks(&line));
    }
    let difference = compare(&lines, &ours, &theirs).map(|what| {
        let kept = home.with_file_name(format!("differs-{seed:x}.ngc"));
        let saved = fs::copy(&file, &kept).map_or_else(|e| e.to_string(), |_| kept.display().to_string());
        let _ = fs::write(home.with_file_name(format!("differs-{seed:x}.txt")), side_by_side(&lines, &ours, &theirs));
        format!("{what}\n  program: {saved}")
    });
    Ok(Found { lines: lines.len(), events: ours.events.len(), refused: ours.refused.is_some(), difference })
}

/// Returns a text with a line for each event: Oxmill's event, the event of `rs274`, and the program line.
fn side_by_side(lines: &[String], ours: &Outcome, theirs: &Outcome) -> String {
    let mut text = String::new();
    for at in 0..ours.events.len().max(theirs.events.len()) {
        let (mine, other) = (ours.events.get(at), theirs.events.get(at));
        let is_same = matches!((mine, other), (Some(a), Some(b)) if a.is_as(b));
        let line = ours.of.get(at).and_then(|line| Some(format!("{}: {}", line + 1, lines.get(*line)?)));
        let mark = if is_same { "" } else { "differs " };
        text += &format!("{mark}{mine:?} {other:?} {}\n", line.unwrap_or_default());
    }
    text
}

fn write(home: &Path, lines: &[String]) -> Result<PathBuf, Failure> {
    let file = home.join("program.ngc");
    let _ = fs::remove_dir_all(home);
    fs::create_dir_all(home)
        .and_then(|()| fs::write(&file, lines.join("\n") + "\n"))
        .map_err(|e| format!("{}: {e}", file.display()))?;
    Ok(file)
}

/// Returns a description of the first difference, with the lines before it; `None` if there is none.
fn compare(lines: &[String], ours: &Outcome, theirs: &Outcome) -> Option<String> {
    for (at, event) in ours.events.iter().enumerate() {
        match theirs.events.get(at) {
            Some(other) if event.is_as(other) => {}
            other => {
                let line = ours.of.get(at).copied().unwrap_or_default();
                let before = lines.get(line.saturating_sub(BEFORE)..=line).unwrap_or_default().join("\n    ");
                let refused = &theirs.refused;
                return Some(format!("Oxmill {event:?}, rs274 {other:?}, which refused {refused:?}\n    {before}"));
            }
        }
    }
    // If both reject the same line, `rs274` may have more events: it can have moved before it found the error.
    if ours.refused != theirs.refused {
        return Some(format!("Oxmill refuses {:?}, rs274 {:?}", ours.refused, theirs.refused));
    }
    (ours.refused.is_none() && theirs.events.len() > ours.events.len())
        .then(|| format!("rs274 goes on with {:?}", theirs.events.get(ours.events.len())))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_of_messages_may_differ_as_much_as_they_are_shown() {
        for (a, b, same) in [
            ("places 0.002534 -8.18502", "places 0.0000 -8.1850", true),
            ("places 0.0035 1", "places 0.0000 1", false),
            ("state 0.002534", "state 0.0000", false),
            ("state 913.2", "state 913.3", true),
            ("state 913.2", "state 914", false),
            ("state 1 2", "state 1", false),
            ("state ######", "state ######", true),
        ] {
            assert_eq!(is_same_text(a, b), same, "{a} {b}");
        }
    }
}
