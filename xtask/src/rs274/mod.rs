//! `cargo xtask rs274`: random programs through Oxmill's interpreter and through LinuxCNC's (`rs274`, Debian package
//! `linuxcnc-uspace`), and what both make of them side by side: every end point, arc, dwell, their order, and refusals.

mod canon;
mod files;
mod ours;
mod programs;

use crate::{Failure, root};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

/// Programs, unless the command line says otherwise.
const PROGRAMS: usize = 10_000;
/// Programs that one process of `rs274` runs one after the other.
const BATCH: usize = 25;
/// End points may be this far apart, mm: `rs274` prints four decimals, of inches too.
const TOLERANCE: f64 = 0.003;
/// Moves that are shorter, mm, are left out on both sides.
const NO_MOVE: f64 = 0.0075;
/// Lines that are printed before one that differs.
const BEFORE: usize = 8;
/// Differences that are printed.
const SHOWN: usize = 10;

/// X, Y and Z in mm, and A in degrees.
pub const AXES: usize = 4;

/// What a program does, in work coordinates.
#[derive(Clone, Debug)]
pub enum Event {
    /// A rapid to a place.
    Rapid([f64; AXES]),
    /// A feed move to a place.
    Feed([f64; AXES]),
    /// An arc: its end, its centre in the plane, and its turns, negative when clockwise.
    Arc([f64; AXES], [f64; 2], i64),
    /// A spline of so many control points.
    Spline(u8),
    /// Seconds.
    Dwell(f64),
    /// An output of the program: its number, its value, and whether it changes with the next motion. `true`: an analog one.
    Output(bool, i64, f64, bool),
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
            _ => false,
        }
    }
}

/// What became of a batch.
pub struct Outcome {
    pub events: Vec<Event>,
    /// The line of each event, if that is known.
    pub of: Vec<usize>,
    /// The text of the line that was refused, if one was; nothing of it or after it is in `events` of Oxmill.
    pub refused: Option<String>,
}

/// Runs the comparison: `arguments` are a number of programs and a seed.
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
                    let found = one_batch(&home, (seed as u64) << 32 | batch as u64, programs);
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

/// What one batch has shown.
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
            "{count} programs (seed {seed}), {} lines, {} moves, arcs and dwells compared, {} refused lines: {} batches differ",
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

fn one_batch(home: &Path, seed: u64, programs: usize) -> Result<Found, Failure> {
    let batch = programs::batch(seed, programs);
    let (lines, ours) = (batch.lines, batch.outcome);
    let file = write(home, &lines)?;
    let theirs = canon::interpret(home, &file)?;
    let difference = compare(&lines, &ours, &theirs).map(|what| {
        let kept = home.with_file_name(format!("differs-{seed:x}.ngc"));
        let saved = fs::copy(&file, &kept).map_or_else(|e| e.to_string(), |_| kept.display().to_string());
        format!("{what}\n  program: {saved}")
    });
    Ok(Found { lines: lines.len(), events: ours.events.len(), refused: ours.refused.is_some(), difference })
}

fn write(home: &Path, lines: &[String]) -> Result<PathBuf, Failure> {
    let file = home.join("program.ngc");
    let _ = fs::remove_dir_all(home);
    fs::create_dir_all(home)
        .and_then(|()| fs::write(&file, lines.join("\n") + "\n"))
        .map_err(|e| format!("{}: {e}", file.display()))?;
    Ok(file)
}

/// The first difference.
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
    // In a line that it refuses rs274 may have moved before it finds out.
    if ours.refused != theirs.refused {
        return Some(format!("Oxmill refuses {:?}, rs274 {:?}", ours.refused, theirs.refused));
    }
    (ours.refused.is_none() && theirs.events.len() > ours.events.len())
        .then(|| format!("rs274 goes on with {:?}", theirs.events.get(ours.events.len())))
}
