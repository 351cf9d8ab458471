//! Settings by `--set`, `--settings` and `--dialect`, and the words that a small board lacks.

use super::{file, json, oxmill, run, text};
use std::io::Write;
use std::process::Stdio;

/// A file of settings may begin with a byte order mark, and its lines may end in LF, CR or CR LF.
#[test]
fn settings_may_come_from_any_editor() {
    let job = file("edited.nc", "G1 X10 F60000\n");
    let seconds = |with: &[&str]| json(&run(&[&["run", text(&job), "--json"], with].concat()))["duration_s"].as_f64();
    let expected = seconds(&["--set", "110=3000", "--set", "120=300"]);
    for (name, said) in [("bom.txt", "\u{FEFF}$110=3000\n$120=300\n"), ("cr.txt", "$110=3000\r; a remark\r$120=300\r")]
    {
        assert_eq!(seconds(&["--settings", text(&file(name, said))]), expected, "{name}");
    }
    let wrong = file("wrong.txt", "\u{FEFF}$110=3000\r\n\r$110\r");
    let said = run(&["run", text(&job), "--settings", text(&wrong)]).stderr;
    let said = String::from_utf8_lossy(&said);
    assert!(said.contains("line 3 of ") && said.contains("is not of the form $n=v"), "{said}");
}

/// The dialect determines which values are accepted, even if `--dialect` comes after the settings on the command
/// line. For a rejected value the controller's answer is shown.
#[test]
fn settings_are_those_of_the_dialect() {
    let job = file("dialect_of_settings.nc", "G21\n");
    let settings = file("settings_of_grbl.txt", "$32=2\n");
    for arguments in [["--settings", text(&settings)], ["--set", "32=2"], ["--set", "$32=2"]] {
        let arguments = [&["check", text(&job)], &arguments[..]].concat();
        let output = run(&arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains("error:52") && said.contains("0 or 1"), "{said}");
        let output = run(&[&arguments[..], &["--dialect", "grbl"]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    }
    // A dump lists soft limits (`$20`) before homing (`$22`), although soft limits need homing.
    let dump = file("dump_of_grbl.txt", "$20=1\n$22=1\n$0=2.5\n");
    let output = run(&["check", text(&job), "--dialect", "grbl", "--settings", text(&dump)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // A dump of the dialect of grblHAL lists the masks `$10` and `$22` before `$900=3`. The values of these masks are
    // valid only in the dialect that `$900=3` selects.
    let dump = file("dump_of_grblhal.txt", "$10=511\n$22=207\n$900=3\n$932=1\n");
    let output = run(&["check", text(&job), "--json", "--settings", text(&dump)]);
    assert_eq!(json(&output)["dialect"], "grblhal", "{}", String::from_utf8_lossy(&output.stderr));
    let output = run(&["check", text(&job), "--dialect", "oxmill", "--settings", text(&dump)]);
    assert!(output.status.code() == Some(2) && String::from_utf8_lossy(&output.stderr).contains("error:52"));
    // The program normally tries a rejected value again after all others. It does not try again if a later value for
    // the same setting follows.
    let twice = ["check", text(&job), "--dialect", "grbl", "--set", "32=2", "--set", "32=0"];
    let output = run(&twice);
    assert!(output.status.code() == Some(2) && String::from_utf8_lossy(&output.stderr).contains("--set 32=2"));
    // `--dialect` takes precedence over `--set 900=1`.
    let output = run(&["check", text(&job), "--dialect", "grbl", "--set", "900=1", "--set", "32=1"]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let job = file("word_of_oxmill.nc", "G21\nM7.1\nG70\n");
    let output = run(&["check", text(&job), "--dialect", "grbl", "--set", "900=1"]);
    assert_eq!(output.status.code(), Some(1));
}

/// A terminal's log of `$$` can be used as a settings file without changes.
#[test]
fn settings_may_be_what_a_machine_has_said() {
    let job = file("said.nc", "G1 X10 F60000\n");
    let mut child = oxmill(&["serve", "--stdio", "--set", "110=3000"]).stdin(Stdio::piped()).spawn().expect("a start");
    child.stdin.take().expect("a pipe").write_all(b"$$\n").expect("a listener");
    let said = String::from_utf8(child.wait_with_output().expect("an end").stdout).expect("text");
    assert!(said.contains("Grbl 1.1h") && said.contains("$110=3000.000") && said.contains("ok"), "{said}");
    let saved = file("said.txt", &format!("$$\n{said}[MSG:so]\n<Idle|MPos:0.000,0.000,0.000>\n"));
    let seconds = |with: &[&str]| json(&run(&[&["run", text(&job), "--json"], with].concat()))["duration_s"].as_f64();
    assert_eq!(seconds(&["--settings", text(&saved)]), seconds(&["--set", "110=3000"]));
    assert_ne!(seconds(&["--settings", text(&saved)]), seconds(&[]));
    let other = file("said_other.txt", "okay\n");
    assert_eq!(run(&["run", text(&job), "--settings", text(&other)]).status.code(), Some(2));
}

/// The simulator supports all words. If a board lacks some of these words, a check for this board (`--board`) reports
/// the errors that the board would report.
#[test]
fn a_check_for_a_small_board_refuses_what_it_leaves_out() {
    let job = file("small.nc", "$110=1000\nG21 G90\nG1 X1 F100\n%\nG999\n#1=2 (two)\nG68 X0 Y0 R45\nG1 X#1\nG69\nM2\n");
    let codes = |board: &str| {
        let output = run(&["run", text(&job), "--json", "--board", board]);
        assert_eq!(output.status.code(), Some(1));
        let summary = json(&output);
        let errors = summary["errors"].as_array().expect("a list").clone();
        errors.iter().map(|error| (error["line"].as_u64(), error["code"].as_u64())).collect::<Vec<_>>()
    };
    let refused =
        |errors: &[(u64, u64)]| errors.iter().map(|(line, code)| (Some(*line), Some(*code))).collect::<Vec<_>>();
    assert_eq!(codes("blackpill_f411"), refused(&[(5, 20)]));
    assert_eq!(codes("blackpill_f401"), refused(&[(5, 20), (6, 201), (7, 128), (8, 201)]));
}
