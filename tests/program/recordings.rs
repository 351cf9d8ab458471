//! Tests `replay` with recordings made by `run --record`, by `serve --record` and by boards.

use super::{file, json, oxmill, run, text};
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::Stdio;

#[test]
fn a_recorded_job_is_played_again() {
    let job = file("recorded.nc", "G21 G90 (Größe)\nM3 S500\nG2 X4 I2 F600\nM0\nG0 X0 Z1\nbad\nM5\n%\n");
    let recording = Path::new(env!("CARGO_TARGET_TMPDIR")).join("recorded.rec");
    let arguments = ["--board", "nucleo_f446re", "--set", "$110=900", "--dialect", "seed"];
    let run_arguments = [&["run", text(&job), "--json", "--record", text(&recording)], &arguments[..]].concat();
    let recorded = run(&run_arguments);
    assert_eq!(recorded.status.code(), Some(1), "one line is refused");
    let played = run(&["replay", text(&recording), "--json"]);
    assert_eq!(played.status.code(), Some(1));
    let [mut recorded, mut played] = [&recorded, &played].map(json);
    assert_eq!(recorded["errors"].as_array().map(Vec::len), Some(1));
    for summary in [&mut recorded, &mut played] {
        summary["host_s"] = Value::Null;
        summary["job"] = Value::Null;
    }
    assert_eq!(recorded, played);
    // The replay reports a recording that has the same steps, but other outputs or another clock rate.
    let text_of = fs::read_to_string(&recording).expect("a recording is text");
    for (from, to) in [("job M3 S500\\n\n", ""), ("nucleo_f446re 90000000", "nucleo_f446re 90000001")] {
        assert!(text_of.contains(from), "{from}");
        let output = run(&["replay", text(&file("other.rec", &text_of.replace(from, to)))]);
        assert_eq!(output.status.code(), Some(3), "{from}");
        assert!(
            String::from_utf8_lossy(&output.stderr).contains("at its end the machine is where it was recorded, but")
        );
    }
    let (lines, end) = text_of.trim_end().rsplit_once('\n').expect("lines");
    let (time, state) = end.split_once(' ').expect("a time");
    let time: u64 = time.parse().expect("a time");
    let changed = file("other_end.rec", &format!("{lines}\n{} {state}\n", time ^ 1));
    assert_eq!(run(&["replay", text(&changed)]).status.code(), Some(3), "another end");
    // The replay reports a recording of a program that makes other steps.
    let other = fs::read_to_string(&recording).expect("a recording is text").replace("G0 X0 Z1", "G0 X0 Z2");
    let changed = file("changed.rec", &other);
    let output = run(&["replay", text(&changed)]);
    assert_eq!(output.status.code(), Some(3), "worse than the refused line that both have");
    assert!(String::from_utf8_lossy(&output.stderr).contains("at its end the recording has the machine at"));
    // A truncated recording cannot be compared.
    let (cut, _) = other.trim_end().rsplit_once('\n').expect("lines");
    assert_eq!(run(&["replay", text(&file("cut.rec", &format!("{cut}\n")))]).status.code(), Some(3));
    let output = run(&["replay", text(&file("empty.rec", "oxmill recording 1\nbegin 0\n5 host ?\n"))]);
    assert_eq!(output.status.code(), Some(3), "nothing is compared");
    assert_eq!(run(&["replay", text(&job)]).status.code(), Some(2), "no recording");
    assert_eq!(run(&["run", text(&job), "--record", text(&job)]).status.code(), Some(2), "the job itself");
}

/// The job has a dwell of many days. The replay does not wait for the end of the dwell.
#[test]
fn a_recorded_job_with_a_very_long_dwell_is_played_again() {
    let job = file("long_dwell.nc", "G0 X1\nG4 P10000000\nG0 X2\n");
    let recording = file("long_dwell.rec", "");
    assert!(run(&["run", text(&job), "--record", text(&recording)]).status.success());
    let output = run(&["replay", text(&recording)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// If an error prevents a run, an older recording must not have been overwritten.
#[test]
fn a_recording_is_kept_until_there_is_a_new_one() {
    let job = file("kept.nc", "G0 X1\n");
    let old = file("kept.rec", "an older one");
    let kept = || fs::read_to_string(&old).expect("a file") == "an older one";
    let record = ["--record", text(&old)];
    for wrong in [["--set", "$7=1"], ["--settings", "no such file"], ["--machine", text(&job)]] {
        assert_eq!(run(&[&["run", text(&job)], &record[..], &wrong[..]].concat()).status.code(), Some(2));
        assert!(kept(), "{wrong:?}");
        assert_eq!(run(&[&["serve", "--stdio"], &record[..], &wrong[..]].concat()).status.code(), Some(2));
        assert!(kept(), "{wrong:?}");
    }
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    assert_eq!(run(&[&["serve", "--tcp", &address], &record[..]].concat()).status.code(), Some(2));
    assert!(kept(), "a port that is in use");
    assert!(run(&[&["run", text(&job)], &record[..]].concat()).status.success());
    assert!(fs::read_to_string(&old).expect("a file").starts_with("oxmill recording 1\n"));
}

#[test]
fn a_replay_writes_the_trace_of_the_run() {
    let job = file("traced.nc", "G91 G1 X1 Y0.5 F600\nM3 S500\nG2 X2 I1\nM8\nG0 Z-1\n");
    let recording = Path::new(env!("CARGO_TARGET_TMPDIR")).join("traced.rec");
    let (of_run, of_replay) = (file("of_run.csv", ""), file("of_replay.csv", ""));
    let ran = run(&["run", text(&job), "--record", text(&recording), "--trace", text(&of_run)]);
    assert_eq!(ran.status.code(), Some(0), "{ran:?}");
    let played = run(&["replay", text(&recording), "--trace", text(&of_replay)]);
    assert_eq!(played.status.code(), Some(0), "{played:?}");
    let [of_run, of_replay] = [of_run, of_replay].map(|path| fs::read_to_string(path).expect("text"));
    assert!(of_run.lines().count() > 500, "{of_run}");
    assert_eq!(of_run, of_replay);
}

/// Settings are not recorded as lines: some act only at power-up and would not be active after a line.
#[test]
fn settings_are_part_of_a_recording() {
    let job = file("settings.nc", "G0 X1\n$J=G91 Y1 F600\n");
    let recording = Path::new(env!("CARGO_TARGET_TMPDIR")).join("settings.rec");
    let settings = ["--set", "$22=1", "--set", "$J=G91X3F500", "--set", "$N0=G0X20", "--set", "$5=1", "--set", "$21=1"];
    let recorded = json(&run(&[&["run", text(&job), "--json", "--record", text(&recording)], &settings[..]].concat()));
    let played = run(&["replay", text(&recording), "--json"]);
    assert_eq!(json(&played)["trace_hash"], recorded["trace_hash"]);
    assert!(played.stderr.is_empty(), "{}", String::from_utf8_lossy(&played.stderr));
}

#[test]
fn a_recording_is_written_over_no_other_file() {
    for option in ["--store", "--settings", "--machine"] {
        let path = file("kept", "$100=80\n");
        let output = run(&["serve", "--stdio", option, text(&path), "--record", text(&path)]);
        assert_eq!(output.status.code(), Some(2), "{option}");
        assert_eq!(fs::read_to_string(&path).expect("a text"), "$100=80\n");
    }
}

#[test]
fn a_recorded_conversation_is_played_again() {
    let recording = Path::new(env!("CARGO_TARGET_TMPDIR")).join("conversation.rec");
    let mut serve = oxmill(&["serve", "--stdio", "--speed", "max", "--record", text(&recording), "--set", "$120=200"]);
    let mut child = serve.stdin(Stdio::piped()).spawn().expect("the program starts");
    let mut host = child.stdin.take().expect("a pipe");
    host.write_all(b"G1 X3 F600\n!").expect("it reads");
    std::thread::sleep(std::time::Duration::from_millis(50));
    host.write_all(b"~G1 X0 Y2\nbad\nG0 Z1\n").expect("it reads");
    drop(host);
    assert!(child.wait_with_output().expect("it ends").status.success());
    let played = run(&["replay", text(&recording), "--json"]);
    let summary = json(&played);
    assert_eq!((&summary["steps"], played.status.code()), (&serde_json::json!([0, 500, 250]), Some(1)));
    // `bad` is the third line of the host. The setting `$120=200` does not count as a line, because it was active
    // before the host connected.
    assert_eq!((&summary["errors"][0]["line"], &summary["errors"][0]["code"]), (&3.into(), &2.into()));
    assert!(String::from_utf8_lossy(&played.stderr).is_empty(), "the same steps");
}

/// Recordings from real machines: each one once revealed a fault, or shows behaviour that must not change.
#[test]
fn recordings_from_the_field() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/field");
    let mut files: Vec<PathBuf> =
        fs::read_dir(folder).expect("the folder").map(|entry| entry.unwrap().path()).collect();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "rec"));
    assert!(!files.is_empty());
    for path in files {
        let recording = fs::read_to_string(&path).expect("text");
        let played = run(&["replay", text(&path)]);
        if recording.contains("[REC:") {
            // The recording ends with a failure of the board's firmware.
            let said = String::from_utf8_lossy(&played.stdout);
            assert!(said.contains("arrives at the place and line of the failure"), "{}: {said}", path.display());
        } else {
            assert!(recording.contains(" at "), "{}: nothing to compare", path.display());
        }
        assert!(played.stderr.is_empty(), "{}: {}", path.display(), String::from_utf8_lossy(&played.stderr));
    }
}

/// A terminal's log can contain bytes that are not text, for instance from before the baud rate was set.
#[test]
fn noise_around_a_listing_does_not_matter() {
    let board = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings/field/panic_in_mid_job.rec");
    let mut log = b"\xff\xfe\x80\0noise\r\n12:00 < ".to_vec();
    log.extend(fs::read(board).expect("the recording"));
    let path = file("noise.log", "");
    fs::write(&path, log).expect("a file");
    let played = run(&["replay", text(&path)]);
    let said = String::from_utf8_lossy(&played.stdout);
    assert!(said.contains("arrives at the place and line of the failure"), "{said}{played:?}");
}
