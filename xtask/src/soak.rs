//! Long runs of the firmware on QEMU or on a virtual board: a job of any length, interrupted by holds, door openings,
//! overrides, status reports, stops, resets, and a host that closes its port. `tests/soak.rs` does the same with the
//! simulator.
//!
//! Whenever the machine rests, three conditions are checked. Every line has been answered once, the motors have made
//! exactly the steps of the program, and the reported position matches these steps. The maximum stack use is printed at
//! the start, in the middle and at the end; the firmware allocates no other memory.

use crate::qemu::{self, Preload};
use crate::script::Script;
use crate::{Failure, QEMU_BOARD, image, known, root, virtual_board};
use oxmill_test_support::program::{AXES, Program, SETTINGS, STEPS_PER_MM};
use oxmill_test_support::{Random, numbers};
use std::collections::VecDeque;
use std::fs;
use std::time::{Duration, Instant};

/// Maximum number of lines that are sent and not yet answered: this many fit into the receive queue together.
const ON_THEIR_WAY: usize = 4;
/// Number of lines generated per second of the run. A machine cannot carry out that many, so the script does not end
/// early.
const LINES_PER_SECOND: u64 = 25;
/// Maximum wall time per second of machine time in QEMU, s.
const SLOWEST: u64 = 10;

/// A section of the script, which ends when the machine rests or a motion is interrupted. `end`: the expected state at
/// its end.
struct Record {
    sent: Sent,
    end: End,
}

/// Numbers of holds, overrides and closed host ports in one record.
#[derive(Clone, Copy, Default)]
struct Sent {
    holds: u64,
    overrides: u64,
    hosts: u64,
}

enum End {
    /// Number of lines answered, and net steps of the motors since the program was last restarted.
    Rest { lines: u64, place: [i64; AXES] },
    /// Motion was interrupted: the program restarts from this position.
    Stopped,
}

/// Maximum duration of a run, s: a script counts milliseconds in 32 bits.
const LONGEST: u64 = u32::MAX as u64 / 1_000;
/// A run that lasts at least this long, in ms of machine time, must contain holds, overrides, stops and resets in
/// motion.
const LONG_MS: u64 = 600_000;

/// Numbers of lines and other events in a run.
#[derive(Default, Debug)]
struct Counts {
    lines: u64,
    rests: u64,
    polls: u64,
    holds: u64,
    overrides: u64,
    stops: u64,
    resets_in_motion: u64,
    hosts: u64,
}

/// A generated job: its script, and for each record (section of the script) the expected state at its end.
struct Job {
    script: Script,
    random: Random,
    program: Program,
    waiting: VecDeque<String>,
    records: Vec<Record>,
    sent: Sent,
    has_port: bool,
}

impl Job {
    fn new(seed: u64, seconds: u64, has_port: bool) -> Job {
        let mut job = Job {
            script: Script::default(),
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            program: Program { place: [0; AXES], relative: false },
            waiting: SETTINGS.map(str::to_owned).into(),
            records: Vec::new(),
            sent: Sent::default(),
            has_port,
        };
        job.script.wait(300);
        job.note(End::Stopped);
        let mut lines = 0;
        while lines < LINES_PER_SECOND * seconds {
            // A virtual board is slow, so the machine rests after fewer lines there.
            for _ in 0..1 + job.random.below(if has_port { 12 } else { 60 }) {
                job.program.lines(&mut job.random, &mut job.waiting);
            }
            lines += job.chunk();
            job.script.end_after((seconds * 1_000) as u32);
        }
        job
    }

    fn note(&mut self, end: End) {
        self.script.note();
        let sent = std::mem::take(&mut self.sent);
        self.records.push(Record { sent, end });
    }

    /// Adds the waiting lines to the script. Between some lines, adds status requests, holds, overrides and jog
    /// cancels. Ends the record after an interruption, or when the machine rests after all lines. Returns the number of
    /// lines sent.
    fn chunk(&mut self) -> u64 {
        let mut sent = 0;
        while let Some(line) = self.waiting.pop_front() {
            if sent >= ON_THEIR_WAY {
                self.script.answers((sent - ON_THEIR_WAY + 1) as u32);
            }
            self.script.send(format!("{line}\n").as_bytes());
            sent += 1;
            if self.random.below(12) == 0 {
                self.disturb();
            }
            if self.random.below(300) == 0 {
                self.interrupt();
                return sent as u64;
            }
        }
        self.script.answers(sent as u32);
        if self.has_port && self.random.below(4) == 0 {
            // If the machine still moves when the host closes its port, it brakes. It continues when `~` arrives.
            self.script.reopen(self.random.below(100) as u32);
            self.sent.hosts += 1;
            self.resume();
        }
        self.script.wait(20);
        self.script.wait_for_idle(50);
        self.note(End::Rest { lines: sent as u64, place: self.program.place });
        sent as u64
    }

    /// Resumes twice, because the machine can still be braking when the first `~` arrives.
    fn resume(&mut self) {
        self.script.send(b"~");
        self.script.wait(600);
        self.script.send(b"~");
    }

    fn disturb(&mut self) {
        match self.random.below(12) {
            0 | 1 => self.script.send(b"?"),
            2..=5 => {
                self.script.send(&[[b'!', 0x84][usize::from(self.random.below(4) == 0)]]);
                self.script.wait(self.random.below(150) as u32);
                self.resume();
                self.sent.holds += 1;
            }
            // Jog cancel; without a jog it has no effect.
            6 => self.script.send(&[0x85]),
            _ => {
                let bytes = [0x90, 0x91, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x99, 0x9A, 0x9B];
                self.script.send(&[bytes[self.random.below(11) as usize]]);
                self.sent.overrides += 1;
            }
        }
        self.script.wait(self.random.below(60) as u32);
    }

    /// Interrupts the motion by a stop (0x19) or a reset (0x18). The program restarts at the position where the motion
    /// ended.
    fn interrupt(&mut self) {
        self.script.wait(self.random.below(200) as u32);
        if self.random.below(3) == 0 {
            self.script.send(&[0x19]);
            self.script.wait(3_000);
            self.resume();
        } else {
            self.script.send(&[0x18]);
        }
        self.script.wait(700);
        self.script.send(b"?");
        self.script.wait(100);
        self.note(End::Stopped);
        self.program = Program { place: [0; AXES], relative: false };
        self.waiting = ["$X", "G90", "G92X0Y0Z0"].map(str::to_owned).into();
    }
}

/// What the test stand reports at the end of a record (section of the script): bytes sent by the firmware, machine
/// time, steps of the motors, and stack use and size.
#[derive(Clone, Copy)]
struct Note {
    bytes: usize,
    ms: u64,
    steps: [i64; AXES],
    stack: [u32; 2],
}

impl Note {
    fn of(line: &str) -> Option<Note> {
        let words: Vec<&str> = line.strip_prefix("note ")?.split(' ').collect();
        let field = |name: &str| words.iter().find_map(|word| word.strip_prefix(name));
        let mut steps = field("steps=")?.split(',').map(|steps| steps.parse().ok());
        Some(Note {
            bytes: field("bytes=")?.parse().ok()?,
            ms: field("at=")?.parse().ok()?,
            steps: [steps.next()??, steps.next()??, steps.next()??],
            stack: [field("stack=")?.parse().ok()?, words.last()?.parse().ok()?],
        })
    }
}

/// `cargo xtask soak qemu|BOARD [--minutes N|--seconds N] [--wall N] [--seed N]`. On a virtual board the run ends when
/// the machine first rests after `--wall` seconds of real time.
pub fn run(arguments: &[&str]) -> Result<(), Failure> {
    let (board, rest) = arguments.split_first().ok_or("soak on what? `qemu`, or a board")?;
    let (mut seconds, mut seed, mut wall) = (60, 1, None);
    for pair in rest.chunks(2) {
        let ([name, number], Ok(value)) = (pair, pair.last().unwrap_or(&"").parse::<u64>()) else {
            return Err(format!("{pair:?} is not `--minutes N`, `--seconds N`, `--wall N` or `--seed N`"));
        };
        match *name {
            "--minutes" => seconds = value.saturating_mul(60),
            "--seconds" => seconds = value,
            "--seed" => seed = value,
            "--wall" => wall = Some(value),
            _ => return Err(format!("{number} of what? `{name}` is not known")),
        }
    }
    let on_qemu = matches!(*board, "qemu" | QEMU_BOARD);
    if !on_qemu {
        known(board)?;
    } else if wall.is_some() {
        return Err("`--wall N` is for a virtual board".into());
    }
    if seconds > LONGEST {
        return Err(format!("{seconds} seconds are more than the {LONGEST} that a script can be told"));
    }
    let job = Job::new(seed, seconds, !on_qemu);
    let folder = root().join("target/soak");
    let path = folder.join(board);
    let written = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, job.script.codes()));
    written.map_err(|error| format!("{}: {error}", path.display()))?;
    let elf = image::build(if on_qemu { QEMU_BOARD } else { board })?.path;
    let begin = Instant::now();
    let (said, report) = if on_qemu {
        qemu::preloaded(&elf, Preload::Script, &path, Duration::from_secs(SLOWEST * seconds))?
    } else {
        virtual_board::soak(board, &elf, &path, wall)?
    };
    let notes: Vec<Note> = report.lines().filter_map(Note::of).collect();
    let counts = account(&job.records, &notes, &said)?;
    let (Some(last), middle) = (notes.last(), notes.get(notes.len() / 2)) else {
        return Err("nothing was noted".into());
    };
    let ratio = begin.elapsed().as_secs_f64() * 1000.0 / last.ms.max(1) as f64;
    println!(
        "soak on {board}, seed {seed}: {:.1} minutes of machine time, {ratio:.2} s each second",
        last.ms as f64 / 6e4
    );
    println!("{counts:?}");
    let depths: Vec<String> =
        [notes.first(), middle, Some(last)].iter().flatten().map(|n| n.stack[0].to_string()).collect();
    println!("stack at the start, in the middle, at the end: {} of {} bytes", depths.join(", "), last.stack[1]);
    if last.ms < seconds * 1_000 && wall.is_none() {
        return Err(format!("the script was at its end after {} ms", last.ms));
    }
    let Counts { holds, overrides, stops, resets_in_motion, .. } = counts;
    if last.ms >= LONG_MS && [holds, overrides, stops, resets_in_motion].contains(&0) {
        return Err("of holds, overrides, stops and resets in motion one has not happened".into());
    }
    if last.stack[0] * 4 > last.stack[1] * 3 {
        return Err("the stack has less than a quarter to spare".into());
    }
    Ok(())
}

/// Compares, for each record, the test stand's note and the firmware's output with the expected state.
fn account(records: &[Record], notes: &[Note], said: &str) -> Result<Counts, Failure> {
    let mut counts = Counts::default();
    let (mut base, mut from) = ([0; AXES], 0);
    for (number, (record, note)) in records.iter().zip(notes).enumerate() {
        let fail = |what: &str, text: &str| Err(format!("record {number} at {} ms: {what}\n{text}", note.ms));
        let Some(text) = said.get(from..note.bytes) else { return fail("nothing was said", "") };
        from = note.bytes;
        let answers = text.lines().filter(|line| *line == "ok").count() as u64;
        if text.contains("error:") {
            return fail("an error", text);
        }
        counts.polls += text.lines().filter(|line| line.starts_with('<')).count() as u64;
        if let Some(report) = text.lines().rfind(|line| line.starts_with('<')) {
            let Some(place) = numbers::<AXES>(report, "MPos") else { return fail("no position", report) };
            if place.map(|mm| (mm * STEPS_PER_MM).round() as i64) != note.steps {
                return fail(&format!("the motors have made {:?} steps", note.steps), report);
            }
        }
        counts.holds += record.sent.holds;
        counts.overrides += record.sent.overrides;
        counts.hosts += record.sent.hosts;
        match &record.end {
            End::Rest { lines, place } => {
                let made: [i64; AXES] = std::array::from_fn(|axis| note.steps[axis] - base[axis]);
                if answers != *lines || text.contains("ALARM") {
                    return fail(&format!("{answers} answers to {lines} lines"), text);
                }
                if made != *place {
                    return fail(&format!("{made:?} steps, and {place:?} were asked for"), text);
                }
                counts.lines += lines;
                counts.rests += 1;
            }
            End::Stopped => {
                base = note.steps;
                counts.stops += u64::from(number > 0);
                counts.resets_in_motion += u64::from(text.contains("ALARM:3"));
            }
        }
    }
    if counts.rests == 0 { Err("no record has come to its end".into()) } else { Ok(counts) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lost_step_and_a_lost_answer_are_seen() {
        let ends = [End::Stopped, End::Rest { lines: 2, place: [250, 0, 0] }];
        let records = ends.map(|end| Record { sent: Sent::default(), end });
        let said = "Grbl\r\nok\r\nok\r\n<Idle|MPos:1.000,0.000,0.000|FS:0,0>\r\n";
        let report = |steps: i64| {
            let line = format!("note bytes={} at=7 steps={steps},0,0 stack=9 of 90", said.len());
            [Note::of("note bytes=6 at=1 steps=0,0,0 stack=8 of 90").expect("a note"), Note::of(&line).expect("a note")]
        };
        assert_eq!(account(&records, &report(250), said).expect("all is well").lines, 2);
        assert!(account(&records, &report(249), said).is_err());
        assert!(account(&records, &report(250), &said.replacen("ok", "no", 1)).is_err());
    }
}
