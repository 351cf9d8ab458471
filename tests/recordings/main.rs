//! Conversations recorded from Grbl 1.1h, held again with the simulator in Grbl's dialect.
//!
//! Each group starts from a fresh machine. Every record must answer equal, byte for byte, or stand in
//! [`differences::DIFFERENCES`] with the reason, or be equal by one of the rules of [`rules`], which cover what depends on
//! the wall time of the recording. The test prints how many of each there were.

mod differences;
mod rules;

use oxmill_controller::messages::Signals;
use oxmill_simulator::{Fittings, Options, Simulator};
use serde_json::Value;
use std::time::Duration;

/// How long the recording host listened for an answer before it took silence for one.
const SILENCE: Duration = Duration::from_millis(300);
/// Between two looks for an answer.
const LOOK: Duration = Duration::from_millis(20);
/// Answers take no longer than a homing cycle.
const PATIENCE: u32 = 20_000;
/// Between two `?` while waiting for Idle.
const POLL: Duration = Duration::from_millis(100);

/// The machine of the homing recordings: switches that close at +2 mm on every axis.
const SWITCHES_AT_2_MM: &str = r#"
    steps_per_mm = [250, 250, 250]
    switch = [
        { axis = "x", at_mm = 2.0, side = "positive", bounce_us = 700 },
        { axis = "y", at_mm = 2.0, side = "positive", bounce_us = 700 },
        { axis = "z", at_mm = 2.0, side = "positive", bounce_us = 700 },
    ]
"#;

/// One line of a recording.
struct Record {
    n: u64,
    kind: String,
    send: Vec<u8>,
    reply: Vec<String>,
    acked: bool,
    wait: f64,
}

fn read(text: &str) -> Vec<Record> {
    text.lines()
        .map(|line| {
            let value: Value = serde_json::from_str(line).expect("a recording is JSON lines");
            let text = |key: &str| value[key].as_str().unwrap_or_default().to_string();
            Record {
                n: value["n"].as_u64().expect("n"),
                kind: text("kind"),
                // Bytes above 0x7F were recorded as the characters of the same number.
                send: text("send").chars().map(|c| c as u32 as u8).collect(),
                reply: value["reply"]
                    .as_array()
                    .map(|lines| lines.iter().map(|l| l.as_str().expect("a line").to_string()).collect())
                    .unwrap_or_default(),
                acked: value["acked"].as_bool().unwrap_or(false),
                wait: value["wait"].as_f64().unwrap_or(0.0),
            }
        })
        .collect()
}

/// A machine as the recordings begin with it, spoken to in Grbl's dialect.
fn power_up(group: &str) -> Simulator {
    let fittings = if group.starts_with("27") { Fittings::parse(SWITCHES_AT_2_MM) } else { Ok(Fittings::default()) };
    let mut mill = Simulator::new(Options { fittings: fittings.expect("a machine"), ..Options::default() });
    mill.send("$900=0\n");
    mill.run_until_idle();
    assert!(mill.take_output().ends_with("ok\r\n"));
    // The settings are those of a machine that has been told its dialect, and nothing else has happened to it.
    mill.send([0x18]);
    mill.run_until_idle();
    mill
}

fn lines(text: &str) -> Vec<String> {
    text.split("\r\n").filter(|line| !line.is_empty()).map(str::to_string).collect()
}

fn answers(text: &str) -> usize {
    lines(text).iter().filter(|line| *line == "ok" || line.starts_with("error:")).count()
}

/// Does what the recording host did and gives what came back.
fn hold(mill: &mut Simulator, record: &Record) -> String {
    let mut said = mill.take_output();
    let listen = |mill: &mut Simulator, said: &mut String, time| {
        mill.run_for(time);
        said.push_str(&mill.take_output());
    };
    match record.kind.as_str() {
        "boot" => {}
        "line" => {
            mill.send(&record.send);
            mill.send("\n");
            said.push_str(&mill.take_output());
            if record.acked {
                let wanted = if record.send.ends_with(b"\r") { 2 } else { 1 };
                for _ in 0..PATIENCE {
                    if answers(&said) >= wanted {
                        break;
                    }
                    listen(mill, &mut said, LOOK);
                }
                // What follows an answer at once belongs to it: the welcome after `$RST`.
                listen(mill, &mut said, LOOK);
            } else {
                listen(mill, &mut said, SILENCE);
            }
        }
        "raw" => {
            mill.send(&record.send);
            listen(mill, &mut said, SILENCE);
        }
        "rt" => {
            mill.send(&record.send);
            listen(mill, &mut said, if record.reply.is_empty() { SILENCE } else { LOOK });
        }
        "pin" => {
            let mut pins = mill.pins();
            set_pin(&mut pins, &record.send);
            mill.set_pins(pins);
            listen(mill, &mut said, LOOK);
        }
        "wait" => listen(mill, &mut said, Duration::from_secs_f64(record.wait)),
        "idle" => {
            for _ in 0..PATIENCE {
                mill.send("?");
                let report = mill.take_output();
                if report.starts_with("<Idle") {
                    said.push_str(&report);
                    break;
                }
                mill.run_for(POLL);
            }
        }
        kind => panic!("a record of unknown kind {kind}"),
    }
    said
}

fn set_pin(pins: &mut Signals, what: &[u8]) {
    let on = what.ends_with(b"1");
    let limit = |bit: u8| if on { pins.limits | bit } else { pins.limits & !bit };
    match what.first() {
        Some(b'x') => pins.limits = limit(1),
        Some(b'y') => pins.limits = limit(2),
        Some(b'z') => pins.limits = limit(4),
        Some(b'p') => pins.probe = on,
        Some(b'r') => pins.reset = on,
        Some(b'h') => pins.hold = on,
        Some(b's') => pins.start = on,
        _ => panic!("an unknown pin {what:?}"),
    }
}

#[derive(Default)]
struct Tally {
    equal: usize,
    by_rule: usize,
    listed: usize,
    used: Vec<bool>,
    other: Vec<String>,
}

fn replay(group: &str, text: &str, tally: &mut Tally) {
    let mut mill = power_up(group);
    let mut boot = mill.take_output();
    for record in read(text) {
        let said = if record.kind == "boot" { std::mem::take(&mut boot) } else { hold(&mut mill, &record) };
        let got = lines(&said);
        let listed = differences::DIFFERENCES.iter().position(|d| d.group == group && d.n == record.n);
        if got == record.reply {
            tally.equal += 1;
        } else if let Some(index) = listed {
            let difference = &differences::DIFFERENCES[index];
            tally.used[index] = true;
            if difference.answers.is_none_or(|answers| answers == got) {
                tally.listed += 1;
            } else {
                tally.other.push(format!("{group} {}: listed, but answered {got:?}", record.n));
            }
        } else if rules::equal(&record.kind, &record.reply, &got) {
            tally.by_rule += 1;
        } else {
            let send = String::from_utf8_lossy(&record.send);
            tally.other.push(format!(
                "{group} {} {} {send:?}\n    recorded {:?}\n    answered {got:?}",
                record.n, record.kind, record.reply
            ));
        }
    }
}

#[test]
fn recordings_answer_as_grbl_did() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/transcripts");
    let mut files: Vec<_> =
        std::fs::read_dir(folder).expect("the recordings").map(|e| e.expect("a file").path()).collect();
    files.sort();
    assert_eq!(files.len(), 31);
    let mut tally = Tally { used: vec![false; differences::DIFFERENCES.len()], ..Tally::default() };
    for file in files {
        let group = file.file_stem().expect("a name").to_string_lossy().into_owned();
        replay(&group, &std::fs::read_to_string(&file).expect("a recording"), &mut tally);
    }
    let unused: Vec<String> = differences::DIFFERENCES
        .iter()
        .zip(&tally.used)
        .filter(|(_, used)| !**used)
        .map(|(d, _)| format!("{} {}", d.group, d.n))
        .collect();
    println!(
        "{} equal, {} equal but for wall time, {} listed differences, {} other",
        tally.equal,
        tally.by_rule,
        tally.listed,
        tally.other.len()
    );
    assert!(tally.other.is_empty(), "{}", tally.other.join("\n"));
    assert!(unused.is_empty(), "listed as different, but equal: {unused:?}");
}
