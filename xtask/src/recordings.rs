//! Repeats recorded conversations with Grbl 1.1h on the firmware in QEMU. A group is one recording. Each group starts
//! after a new power-up. Groups that change an input pin are left out. The rules of the comparison and the list of
//! allowed differences are in `tests/recordings`, because the tests of the simulator use them, too.
//!
//! A script inside the machine (`boards/qemu_mps2/script.rs`) plays the host, so the state of the machine when a byte
//! arrives does not depend on the load of this computer.

#[path = "../../tests/recordings/differences.rs"]
mod differences;
#[path = "../../tests/recordings/record.rs"]
mod record;
#[path = "../../tests/recordings/rules.rs"]
mod rules;

use crate::qemu::{self, Preload};
use crate::script::Script;
use crate::{Failure, QEMU_BOARD, image, root};
use record::{Record, Tally, read};
use std::fs;
use std::path::Path;
use std::time::Duration;

/// Silence after which the host that made the recordings assumed that there was no answer, ms.
const SILENCE: u32 = 300;
/// Time after an answer during which further output still belongs to the answer, ms.
const LOOK: u32 = 20;
/// Interval between two `?` while the script waits for Idle, ms.
const POLL: u32 = 100;
/// Maximum duration of the replay of a group (one recording).
const LIMIT: Duration = Duration::from_secs(600);

/// Replays the groups that change no input pin. If `only` is not empty, replays only those whose names begin with one
/// of its texts.
pub fn replay_all(only: &[&str]) -> Result<(), Failure> {
    let folder = root().join("tests/transcripts");
    let mut files: Vec<_> = fs::read_dir(&folder)
        .map_err(|error| format!("{}: {error}", folder.display()))?
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .collect();
    files.sort();
    let group = |file: &Path| file.file_stem().unwrap_or_default().to_string_lossy().into_owned();
    if let Some(name) = only.iter().find(|name| !files.iter().any(|file| group(file).starts_with(**name))) {
        return Err(format!("there is no recording `{name}`"));
    }
    let image = image::build(QEMU_BOARD)?;
    let mut tally = Tally::new();
    let (mut groups, mut left_out) = (0, Vec::new());
    for file in files {
        let group = group(&file);
        let text = fs::read_to_string(&file).map_err(|error| format!("{}: {error}", file.display()))?;
        let records = read(&text);
        let wanted = only.is_empty() || only.iter().any(|name| group.starts_with(name));
        // Group 27 (homing) needs switches at known positions.
        if !wanted || records.iter().any(|record| record.kind == "pin") || group.starts_with("27") {
            left_out.push(group);
            continue;
        }
        let others = tally.other.len();
        replay(&image.path, &group, &records, &mut tally)?;
        println!("recording {group}: {} records, {} other", records.len(), tally.other.len() - others);
        groups += 1;
    }
    println!("{groups} recordings on QEMU: {tally}; left out: {}", left_out.join(", "));
    if groups == 0 {
        return Err("each of these recordings moves a pin".into());
    }
    if tally.other.is_empty() { Ok(()) } else { Err(tally.other.join("\n")) }
}

/// Replays the records of a group (the lines of one recording) on a machine that has just been powered up, and adds the
/// results to `tally`.
fn replay(elf: &Path, group: &str, records: &[Record], tally: &mut Tally) -> Result<(), Failure> {
    let mut script = Script::default();
    // Before the first record: wait for the greeting, set the dialect, and reset. The greeting after the reset belongs
    // to the recording.
    script.wait(SILENCE);
    script.send(b"$900=0\n");
    script.answers(1);
    script.wait(LOOK);
    script.end_record();
    script.send(&[0x18]);
    script.wait(SILENCE);
    for record in records {
        // If the list of differences says that this firmware does not answer here, do not wait for an answer.
        let listed = differences::DIFFERENCES.iter().find(|d| d.group == group && d.n == record.n);
        let silent = listed.is_some_and(|d| d.answers.is_some_and(|answers| answers.is_empty()));
        add_record(&mut script, record, silent)?;
        script.end_record();
    }
    let folder = root().join("target/recordings");
    let path = folder.join(group);
    let written = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, script.codes()));
    written.map_err(|error| format!("{}: {error}", path.display()))?;
    let (said, report) =
        qemu::preloaded(elf, Preload::Script, &path, LIMIT).map_err(|why| format!("{group}: {why}"))?;
    let marks: Vec<usize> = report.lines().map_while(|line| line.parse().ok()).collect();
    if marks.len() != records.len() + 1 {
        return Err(format!("{group}: {} of {} records were held", marks.len().saturating_sub(1), records.len()));
    }
    for (record, ends) in records.iter().zip(marks.windows(2)) {
        let said = said.get(ends[0]..ends[1]).ok_or_else(|| format!("{group} {}: nothing was said", record.n))?;
        // If several reports arrived while waiting for Idle, compare only the most recent one.
        let from = if record.kind == "idle" { said.rfind('<').unwrap_or(0) } else { 0 };
        tally.judge(group, record, &said[from..]);
    }
    Ok(())
}

/// Adds to the script what the host did for this record when the recording was made: the bytes that it sent, and then
/// its wait. `silent`: `true` if this firmware does not answer here.
fn add_record(script: &mut Script, record: &Record, silent: bool) -> Result<(), Failure> {
    match record.kind.as_str() {
        "boot" => {}
        "line" => {
            let mut line = record.send.clone();
            line.push(b'\n');
            script.send(&line);
            if record.acked && !silent {
                script.answers(if record.send.ends_with(b"\r") { 2 } else { 1 });
                script.wait(LOOK);
            } else {
                script.wait(SILENCE);
            }
        }
        "raw" => {
            script.send(&record.send);
            script.wait(SILENCE);
        }
        "rt" => {
            script.send(&record.send);
            script.wait(if record.reply.is_empty() { SILENCE } else { LOOK });
        }
        "wait" => script.wait((record.wait * 1000.0) as u32),
        "idle" => script.wait_for_idle(POLL),
        kind => return Err(format!("a record of unknown kind {kind}")),
    }
    Ok(())
}
