//! The recorded conversations with Grbl 1.1h held with the firmware in QEMU: all groups that move no input pin, each from
//! a fresh start, judged by the same rules and the same list of differences as the simulator (`tests/recordings`).
//!
//! QEMU runs in real time here, as the recording host did; on a busy host its time falls behind. So what is waited for is
//! an answer wherever there is one, and groups that look at a machine in mid-move are held only when they are named
//! (`cargo xtask recordings 15 17`), on a host with nothing else to do.

#[path = "../../tests/recordings/differences.rs"]
mod differences;
#[path = "../../tests/recordings/record.rs"]
mod record;
#[path = "../../tests/recordings/rules.rs"]
mod rules;

use crate::{Failure, QEMU_BOARD, image, qemu, root};
use record::{Record, Tally, answers, read};
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::thread;
use std::time::{Duration, Instant};

/// How long the recording host listened for an answer before it took silence for one.
const SILENCE: Duration = Duration::from_millis(300);
/// How long after the last byte a status report or an answer is taken for complete.
const PAUSE: Duration = Duration::from_millis(40);
/// Between two `?` while waiting for Idle.
const POLL: Duration = Duration::from_millis(100);
/// How often a group is held: a host that is busy holds QEMU up, and a machine in mid-move is then elsewhere. What the
/// firmware answers wrongly it answers wrongly each time.
const ATTEMPTS: u32 = 4;
/// Longest wait for an answer: all of the travel at 500 mm/min, and some more.
const PATIENCE: Duration = Duration::from_secs(40);

/// A recording with a move of 0.7 mm at 0.5 mm/min, 85 s for the machine, and on some hosts much more in QEMU: by name only.
const CRAWLING: &str = "30_motion_sync";
/// Longest wait for the end of motion.
const SLOWEST: Duration = Duration::from_secs(300);

/// All groups without pins that do not look at a machine in mid-move, or those named.
pub fn replay_all(only: &[&str]) -> Result<(), Failure> {
    let image = image::build(QEMU_BOARD)?;
    let folder = root().join("tests/transcripts");
    let mut files: Vec<_> = fs::read_dir(&folder)
        .map_err(|error| format!("{}: {error}", folder.display()))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .collect();
    files.sort();
    let mut tally = Tally::new();
    let (mut groups, mut left_out) = (0, Vec::new());
    for file in files {
        let group = file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
        let records = read(&text);
        // Group 27 has switches at known places.
        if records.iter().any(|record| record.kind == "pin") || group.starts_with("27") {
            left_out.push(group);
            continue;
        }
        let wanted = only.iter().any(|name| group.starts_with(name));
        if !wanted && (!only.is_empty() || looks_at_motion(&records) || group == CRAWLING) {
            left_out.push(group);
            continue;
        }
        let before = tally.clone();
        for attempt in 1..=ATTEMPTS {
            let last = attempt == ATTEMPTS;
            replay(&image.path, &group, &records, &mut tally, last)?;
            let other = tally.other.len() - before.other.len();
            println!("recording {group}: {} records, {other} other", records.len());
            if let Some(first) = tally.other.get(before.other.len()).filter(|_| !last) {
                println!("  held again: {first}");
            }
            if other == 0 || last {
                break;
            }
            tally = before.clone();
        }
        groups += 1;
    }
    println!("{groups} recordings on QEMU: {tally}; left out: {}", left_out.join(", "));
    if tally.other.is_empty() { Ok(()) } else { Err(tally.other.join("\n")) }
}

/// Whether a group asks where the machine is in mid-move, or stops it there: then the answers depend on the host's load.
fn looks_at_motion(records: &[Record]) -> bool {
    let in_motion = ["<Run", "<Jog", "<Hold:", "<Home", "<Door:2", "ALARM:3", "ALARM:6"];
    records.iter().flat_map(|record| &record.reply).any(|line| in_motion.iter().any(|begin| line.starts_with(begin)))
}

/// Holds a group with a machine that was just switched on; only up to the first fault, unless it shall go to the end.
fn replay(elf: &Path, group: &str, records: &[Record], tally: &mut Tally, to_the_end: bool) -> Result<(), Failure> {
    let others = tally.other.len();
    let (_qemu, stream, _stand) = qemu::live(elf)?;
    let mut host = Host { stream, said: String::new() };
    host.send(b"$900=0\n")?;
    host.listen(PATIENCE, |said| answers(said) > 0)?;
    host.send(&[0x18])?;
    // The greeting to the host comes first, and the one after the reset belongs to the recording.
    host.said.clear();
    host.listen(PATIENCE, |said| said.contains("to lock]") || said.contains("help]"))?;
    host.pause()?;
    for record in records {
        if record.kind != "boot" {
            // Where no answer is listed there is none to wait for.
            let listed = differences::DIFFERENCES.iter().find(|d| d.group == group && d.n == record.n);
            let silent = listed.is_some_and(|d| d.answers.is_some_and(|answers| answers.is_empty()));
            host.hold(record, if silent { SILENCE } else { PATIENCE })
                .map_err(|why| format!("{group} {}: {why}", record.n))?;
        }
        tally.judge(group, record, &std::mem::take(&mut host.said));
        if tally.other.len() > others && !to_the_end {
            break;
        }
    }
    Ok(())
}

/// The host's end of the line.
struct Host {
    stream: TcpStream,
    said: String,
}

impl Host {
    fn send(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.stream.write_all(bytes).map_err(|error| error.to_string())
    }

    /// Listens for a time, or until enough has been said.
    fn listen(&mut self, time: Duration, enough: impl Fn(&str) -> bool) -> Result<(), Failure> {
        let begin = Instant::now();
        let mut buffer = [0; 1024];
        while !enough(&self.said) {
            let left = time.saturating_sub(begin.elapsed());
            if left.is_zero() {
                return Ok(());
            }
            self.stream.set_read_timeout(Some(left)).map_err(|error| error.to_string())?;
            match self.stream.read(&mut buffer) {
                Ok(0) => return Err("QEMU has gone".into()),
                Ok(length) => self.said.push_str(&String::from_utf8_lossy(&buffer[..length])),
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Ok(()),
                Err(error) => return Err(error.to_string()),
            }
        }
        Ok(())
    }

    /// Listens until nothing comes for a moment.
    fn pause(&mut self) -> Result<(), Failure> {
        loop {
            let before = self.said.len();
            self.listen(PAUSE, |said| said.len() > before)?;
            if self.said.len() == before {
                return Ok(());
            }
        }
    }

    /// Does what the recording host did.
    fn hold(&mut self, record: &Record, patience: Duration) -> Result<(), Failure> {
        match record.kind.as_str() {
            "line" => {
                self.send(&record.send)?;
                self.send(b"\n")?;
                if record.acked {
                    let wanted = if record.send.ends_with(b"\r") { 2 } else { 1 };
                    self.listen(patience, |said| answers(said) >= wanted)?;
                    self.pause()
                } else {
                    self.listen(SILENCE, |_| false)
                }
            }
            "raw" => {
                self.send(&record.send)?;
                self.listen(SILENCE, |_| false)
            }
            "rt" => {
                self.send(&record.send)?;
                if record.reply.is_empty() {
                    return self.listen(SILENCE, |_| false);
                }
                let last = record.reply.last().cloned().unwrap_or_default();
                let begin = last.chars().next().unwrap_or_default();
                self.listen(SILENCE, |said| said.contains(begin) && said.ends_with('\n'))?;
                self.pause()
            }
            "wait" => self.listen(Duration::from_secs_f64(record.wait), |_| false),
            "idle" => {
                let begin = Instant::now();
                while begin.elapsed() < SLOWEST {
                    let before = std::mem::take(&mut self.said);
                    self.send(b"?")?;
                    self.listen(SILENCE, |said| said.contains(">\r\n"))?;
                    let idle = self.said.contains("<Idle");
                    let report = std::mem::replace(&mut self.said, before);
                    if idle {
                        self.said.push_str(&report);
                        return Ok(());
                    }
                    thread::sleep(POLL);
                }
                Ok(())
            }
            kind => Err(format!("a record of unknown kind {kind}")),
        }
    }
}
