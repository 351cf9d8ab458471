//! Repeats conversations recorded from Grbl 1.1h with the simulator in Grbl's dialect.
//!
//! Each group (a file of recordings) starts with a fresh machine. An answer must be equal byte for byte, with two
//! exceptions. Either [`differences::DIFFERENCES`] lists the answer with a reason. Or the answer depends on the wall
//! time of the recording, and a rule of [`rules`] accepts it. The test prints the number of answers of each kind.

mod differences;
mod record;
mod rules;

use oxmill_controller::messages::Signals;
use oxmill_simulator::{Fittings, Options, Simulator};
use record::{Record, Tally, answers, read};
use std::time::Duration;

/// Time without output after which the recording host assumed that there was no answer.
const SILENCE: Duration = Duration::from_millis(300);
/// Interval between two checks for an answer.
const LOOK: Duration = Duration::from_millis(20);
/// Maximum number of checks for an answer; a homing cycle takes the longest.
const PATIENCE: u32 = 20_000;
/// Interval between two `?` while waiting for Idle.
const POLL: Duration = Duration::from_millis(100);

/// Machine of the homing recordings: its switches close at +2 mm on every axis.
const SWITCHES_AT_2_MM: &str = r#"
    steps_per_mm = [250, 250, 250]
    switch = [
        { axis = "x", at_mm = 2.0, side = "positive", bounce_us = 700 },
        { axis = "y", at_mm = 2.0, side = "positive", bounce_us = 700 },
        { axis = "z", at_mm = 2.0, side = "positive", bounce_us = 700 },
    ]
"#;

/// Returns a machine as at the start of the recordings, in Grbl's dialect.
fn power_up(group: &str) -> Simulator {
    let fittings = if group.starts_with("27") { Fittings::parse(SWITCHES_AT_2_MM) } else { Ok(Fittings::default()) };
    let mut mill = Simulator::new(Options { fittings: fittings.expect("a machine"), ..Options::default() });
    mill.send("$900=0\n");
    mill.run_until_idle();
    assert!(mill.take_output().ends_with("ok\r\n"));
    // This reset puts the machine into the state after power-up; only the dialect is kept.
    mill.send([0x18]);
    mill.run_until_idle();
    mill
}

/// Repeats what the recording host did for one record: sends bytes or sets a pin, and waits. Returns the machine's
/// output.
fn play_record(mill: &mut Simulator, record: &Record) -> String {
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
                // Output right after an answer is part of the answer, such as the welcome message after `$RST`.
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

fn replay(group: &str, text: &str, tally: &mut Tally) {
    let mut mill = power_up(group);
    let mut boot = mill.take_output();
    for record in read(text) {
        let said = if record.kind == "boot" { std::mem::take(&mut boot) } else { play_record(&mut mill, &record) };
        tally.judge(group, &record, &said);
    }
}

#[test]
fn recordings_answer_as_grbl_did() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/transcripts");
    let mut files: Vec<_> =
        std::fs::read_dir(folder).expect("the recordings").map(|e| e.expect("a file").path()).collect();
    files.sort();
    assert_eq!(files.len(), 31);
    let mut tally = Tally::new();
    for file in files {
        let group = file.file_stem().expect("a name").to_string_lossy().into_owned();
        replay(&group, &std::fs::read_to_string(&file).expect("a recording"), &mut tally);
    }
    println!("{tally}");
    assert!(tally.other.is_empty(), "{}", tally.other.join("\n"));
    let unused = tally.unused();
    assert!(unused.is_empty(), "listed as different, but equal: {unused:?}");
}
