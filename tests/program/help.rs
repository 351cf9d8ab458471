//! Texts about the program: completions, manual, exit status, the page of the JSON summary.

use super::{file, json, run, text};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

#[test]
fn shells_and_man_know_the_commands() {
    for arguments in [&["completions", "bash"][..], &["completions", "zsh"], &["man"]] {
        let output = run(arguments);
        let words = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(
            output.status.success() && words.contains("serve") && words.contains("check"),
            "{arguments:?}: {words}"
        );
    }
}

/// `serve --web` looks for the page in the folder of the program, where the archive of a release has it. If the page
/// is missing, the message names two ways to get it (a release, and `cargo xtask web`) and the option `--page`.
#[test]
fn the_page_is_looked_for_beside_the_program() {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("released");
    fs::remove_dir_all(&folder).ok();
    fs::create_dir_all(&folder).expect("a folder");
    let program = folder.join(format!("oxmill{}", std::env::consts::EXE_SUFFIX));
    fs::copy(env!("CARGO_BIN_EXE_oxmill"), &program).expect("a copy");
    let refused = || {
        let output = Command::new(&program).current_dir(&folder).args(["serve", "--web", "0"]).output();
        let output = output.expect("the program starts");
        assert_eq!(output.status.code(), Some(2));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let words = refused();
    assert!(["release", "cargo xtask web", "--page"].iter().all(|way| words.contains(way)), "{words}");
    fs::write(folder.join("oxmill.html"), "another page").expect("a file");
    assert!(refused().contains("is not the page of Oxmill"));
}

/// The manual that `man` prints has each option. `man --out` writes a page for each command, which has the options of
/// this command. Another page must refer to the page of a command: the page of the program, or the page of the command
/// above it.
#[test]
fn the_manual_has_the_options_of_each_command() {
    let plain = |text: &str| text.replace('\\', "");
    let whole = plain(&String::from_utf8_lossy(&run(&["man"]).stdout));
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("manual/man1");
    fs::remove_dir_all(&folder).ok();
    assert!(run(&["man", "--out", text(&folder)]).status.success());
    let page = |name: &str| plain(&fs::read_to_string(folder.join(name)).expect("a page"));
    for (command, options) in [
        ("run", &["--record", "--plot", "--trace", "--store"][..]),
        ("check", &["--json", "--board"]),
        ("plot", &["--output"]),
        ("serve", &["--web", "--page", "--pins", "--reset-on-connect"]),
        ("replay", &["--json", "--trace"]),
        ("resume", &["--line", "--number", "--clearance", "--plunge", "--spin-up", "--output"]),
        ("settings-import", &["--json", "--output"]),
        ("man", &["--out"]),
        ("completions", &["SHELL"]),
    ] {
        let (title, of_command) = (format!("oxmill-{command} 1"), page(&format!("oxmill-{command}.1")));
        assert!(whole.contains(&title) && of_command.contains(&title), "{command}");
        let (above, _) = title.rsplit_once('-').expect("a name");
        assert!(page(&format!("{above}.1")).contains(&format!("oxmill-{command}(1)")), "{command}");
        for option in options {
            assert!(whole.contains(option) && of_command.contains(option), "{command} {option}");
        }
    }
    let file = file("no_folder", "");
    assert_eq!(run(&["man", "--out", text(&file)]).status.code(), Some(2));
}

/// `docs/json.md` explains every field of the JSON summary with its type. It explains no other fields.
#[test]
fn the_page_of_the_json_has_its_fields() {
    let job = file("json.nc", "G1 X1 F100 (so what!)\nG999\nT1\nG38.2 Z-1\n");
    let summary = json(&run(&["run", text(&job), "--json"]));
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/json.md")).expect("docs/json.md");
    let rows: Vec<(&str, &str)> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split_once("` | "))
        .filter_map(|(name, rest)| Some((name, rest.split_once(" |")?.0)))
        .collect();
    let mut fields: Vec<(String, &Value)> = Vec::new();
    for (name, value) in summary.as_object().expect("an object") {
        fields.push((name.clone(), value));
        let (row, mark) = if value.is_array() { (&value[0], "[]") } else { (value, "") };
        fields.extend(row.as_object().into_iter().flatten().map(|(key, value)| (format!("{name}{mark}.{key}"), value)));
    }
    for (field, value) in &fields {
        let row = rows.iter().find(|(name, _)| name == field);
        let (_, kind) = row.unwrap_or_else(|| panic!("docs/json.md has no row for `{field}`"));
        let found = match value {
            Value::Null => "null",
            Value::Bool(_) => "true or false",
            Value::Number(_) => "number",
            Value::String(_) => "text",
            Value::Array(values) if values.first().is_some_and(Value::is_number) => "numbers",
            Value::Array(_) => "list",
            Value::Object(_) => "object",
        };
        assert!(kind.contains(found), "docs/json.md calls `{field}` {kind}, and it is {found}");
    }
    for (name, _) in &rows {
        assert!(fields.iter().any(|(field, _)| field == name), "docs/json.md explains `{name}`, which does not exist");
    }
}

#[test]
fn exit_statuses_are_explained() {
    let said = run(&["man"]).stdout;
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/json.md")).expect("docs/json.md");
    for line in oxmill_simulator::command_line::EXIT_STATUS.lines().skip(1) {
        let (status, meaning) = line.trim().split_once("  ").expect("a number and its meaning");
        assert!(page.contains(&format!("| {status} | {meaning} |")), "docs/json.md: {line}");
    }
    assert!(String::from_utf8_lossy(&said).contains("Exit status"));
}
