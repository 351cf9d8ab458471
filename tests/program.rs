//! Tests the parts of the command line that other programs rely on, by running the program.

use serde_json::Value;
use std::fs;
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

fn oxmill(arguments: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_oxmill"));
    command.args(arguments).stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped());
    command
}

fn run(arguments: &[&str]) -> Output {
    oxmill(arguments).output().expect("the program starts")
}

fn json(output: &Output) -> Value {
    serde_json::from_slice(&output.stdout).expect("one JSON object")
}

/// Writes a file for this test.
fn file(name: &str, text: &str) -> PathBuf {
    let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    fs::write(&path, text).expect("a file can be written");
    path
}

fn text(path: &Path) -> &str {
    path.to_str().expect("a path in UTF-8")
}

#[test]
fn a_good_job_ends_with_0_and_a_summary() {
    let job = file("good.nc", "G21 G90\nG0 X3\n(日本語)\nG1 X10 Y5 F600\n");
    let output = run(&["run", text(&job), "--json", "--set", "100=80", "--set", "101=80"]);
    assert_eq!(output.status.code(), Some(0));
    let summary = json(&output);
    assert_eq!(summary["lines"], 4);
    assert_eq!(summary["errors"].as_array().map(Vec::len), Some(0));
    assert!(summary["alarm"].is_null());
    assert_eq!(summary["position_mm"], serde_json::json!([10.0, 5.0, 0.0]));
    assert_eq!(summary["work_position_mm"], serde_json::json!([10.0, 5.0, 0.0]));
    assert_eq!(summary["steps"], serde_json::json!([800, 400, 0]));
    assert_eq!(summary["extents_mm"]["max"], serde_json::json!([10.0, 5.0, 0.0]));
    let feed = (49.0_f64 + 25.0).sqrt();
    assert!((summary["distance_mm"].as_f64().expect("a distance") - 3.0 - feed).abs() < 1e-3);
    assert!(summary["duration_s"].as_f64().expect("a duration") > feed / 10.0);
    for hash in ["trace_hash", "order_hash"] {
        let digits = summary[hash].as_str().expect("a text");
        assert!(digits.len() == 16 && digits.chars().all(|c| c.is_ascii_hexdigit()), "{hash} is {digits}");
    }
    assert!(summary["step_clock_hz"].as_u64().is_some_and(|hz| hz > 0));
    assert_eq!(json(&run(&["run", text(&job), "--json"]))["lines"], 4);
}

#[test]
fn places_are_numbers_without_a_resolution() {
    let job = file("no_resolution.nc", "G0 X3\n");
    let output = run(&["run", text(&job), "--json", "--set", "100=0"]);
    assert_eq!(output.status.code(), Some(1), "motion is locked");
    let summary = json(&output);
    for end in ["min", "max"] {
        assert_eq!(summary["extents_mm"][end], serde_json::json!([0.0, 0.0, 0.0]));
    }
}

/// A dwell longer than the virtual clock can run is reported as an unfinished job. A shorter one, however long, runs to
/// its end.
#[test]
fn a_dwell_of_many_thousand_years_ends_the_simulation() {
    let years = "50000000000";
    for (name, dwell, complete) in [("long", years, true), ("endless", "900000000000", false)] {
        let job = file(&format!("dwell_{name}.nc"), &format!("G4 P{dwell}\nG0 X1\n"));
        let output = run(&["run", text(&job), "--json"]);
        assert_eq!(output.status.code(), Some(i32::from(!complete)), "{}", String::from_utf8_lossy(&output.stderr));
        let summary = json(&output);
        assert_eq!(
            (&summary["complete"], summary["notes"].to_string().contains("line 1 waits for so long")),
            (&complete.into(), !complete)
        );
    }
    let job = file("dwell_twice.nc", &format!("G4 P{years}\n").repeat(3));
    assert_eq!(run(&["check", text(&job)]).status.code(), Some(1));
}

/// Terminal control characters and characters invalid in XML are never output as they are.
#[cfg(unix)]
#[test]
fn names_with_control_characters_are_shown_without_them() {
    let job = file("evil\u{1b}]0;x\u{7}\n<&>.nc", "G0 X1\n");
    let drawing = Path::new(env!("CARGO_TARGET_TMPDIR")).join("evil.svg");
    let output = run(&["run", text(&job), "--plot", text(&drawing)]);
    let drawn = fs::read_to_string(&drawing).expect("a drawing");
    let missing = format!("{}.none", text(&job));
    let refused = run(&["run", &missing]);
    let said = [output.stdout, output.stderr, refused.stderr, drawn.into_bytes()]
        .map(|bytes| String::from_utf8(bytes).expect("text"));
    for said in &said {
        assert!(!said.contains(|c: char| c.is_control() && c != '\n'), "{said:?}");
    }
    assert!(said[0].contains("evil?]0;x??<&>.nc") && said[3].contains("evil?]0;x??&lt;&amp;&gt;.nc"), "{said:?}");
}

#[test]
fn check_is_run_on_one_screen() {
    let bad = file("check_bad.nc", "G1 X1 F100\nG999\nX2\n");
    let output = run(&["check", text(&bad)]);
    assert_eq!(output.status.code(), Some(1));
    let words = String::from_utf8(output.stdout).expect("text");
    for part in ["1 line refused", "line 2: G999", "error:20", "docs/gcode.md", "extents"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    assert!(!words.contains('\u{1b}'), "no colours where there is no terminal");
    let [mut check, mut run_] = ["check", "run"].map(|command| json(&run(&[command, text(&bad), "--json"])));
    for summary in [&mut check, &mut run_] {
        summary["host_s"] = Value::Null;
    }
    assert_eq!(check, run_);
    assert_eq!(run(&["check", text(&file("check_good.nc", "G1 X1 F100\n"))]).status.code(), Some(0));
    assert_eq!(run(&["check", "no such file"]).status.code(), Some(2));
}

/// A byte order mark and any line ends are accepted.
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

/// The dialect decides which values are accepted, wherever it is selected; the answer of a refused one is shown.
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
    // A dump has soft limits before the homing that they need.
    let dump = file("dump_of_grbl.txt", "$20=1\n$22=1\n$0=2.5\n");
    let output = run(&["check", text(&job), "--dialect", "grbl", "--settings", text(&dump)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    // The option wins.
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

/// The simulator supports all words; a check for a board that lacks some reports the errors that the board would.
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

#[test]
fn plot_draws_the_job() {
    let job = file("plot.nc", "G21 G91\nG1 X10 Y5 F600\n");
    let [svg, png] = ["plot.svg", "plot.png"].map(|name| Path::new(env!("CARGO_TARGET_TMPDIR")).join(name));
    let output = run(&["plot", text(&job), "-o", text(&svg), "-o", text(&png)]);
    assert_eq!(output.status.code(), Some(0));
    let drawn = fs::read_to_string(&svg).expect("a drawing");
    assert!(drawn.starts_with("<svg") && drawn.contains("plot.nc"));
    assert!(fs::read(&png).expect("a drawing").starts_with(b"\x89PNG"));
    // Must be the same drawing as by `run --plot`.
    let other = svg.with_file_name("plot_by_run.svg");
    run(&["run", text(&job), "--plot", text(&other)]);
    assert_eq!(fs::read_to_string(&other).expect("a drawing"), drawn);
    let bad = file("plot_bad.nc", "G999\n");
    assert_eq!(run(&["plot", text(&bad), "-o", text(&svg)]).status.code(), Some(1));
    assert_eq!(run(&["plot", text(&job)]).status.code(), Some(2));
}

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

/// The page is found beside the program, as in the archive of a release; if it is not there, the message names both
/// ways to get it.
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

/// Each option is in the manual, both on standard output and in the files, which refer to each other.
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
        ("man", &["--out"]),
        ("completions", &["SHELL"]),
    ] {
        let (title, of_command) = (format!("oxmill-{command} 1"), page(&format!("oxmill-{command}.1")));
        assert!(whole.contains(&title) && of_command.contains(&title), "{command}");
        assert!(page("oxmill.1").contains(&format!("oxmill-{command}(1)")), "{command}");
        for option in options {
            assert!(whole.contains(option) && of_command.contains(option), "{command} {option}");
        }
    }
    let file = file("no_folder", "");
    assert_eq!(run(&["man", "--out", text(&file)]).status.code(), Some(2));
}

/// `docs/json.md` explains every field with its type, and no field that does not exist.
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
            Value::Array(values) if values.first().is_some_and(Value::is_number) => "3 numbers",
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
fn errors_stand_in_the_summary_with_their_lines_and_end_with_1() {
    let job = file("bad.nc", "G1 X1 F100\nG999\nX2\n");
    let output = run(&["run", text(&job), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let summary = json(&output);
    let errors = summary["errors"].as_array().expect("a list");
    assert_eq!(errors.len(), 1);
    assert_eq!((&errors[0]["line"], &errors[0]["code"]), (&Value::from(2), &Value::from(20)));
    assert!(errors[0]["text"].as_str().is_some_and(|text| !text.is_empty()));
    let words = String::from_utf8(run(&["run", text(&job)]).stdout).expect("text");
    assert!(words.contains("line 2") || words.contains("     2"), "{words}");
}

/// A probing line is answered after its alarm, and a line beyond the travel not at all. In both cases the alarm has the
/// number of the line that raised it.
#[test]
fn an_alarm_has_the_line_that_raised_it() {
    let limits: Vec<&str> = "--set 20=1 --set 22=1 --set 130=60 --work-zero=-40,-20,-10".split(' ').collect();
    for (program, more, code, line) in [
        ("G21 F600\nG1 X1\nG38.2 Z-1\n", &[][..], 5, 3),
        ("G21 F600\nG38.2 Z-1\nG0 X5\nG0 X6\n", &[], 5, 2),
        ("G21 F600\nG1 X1\nG1 X999\nG1 X2\n", &limits, 2, 3),
    ] {
        let job = file("alarm.nc", program);
        let summary = json(&run(&[&["run", text(&job), "--json"], more].concat()));
        let alarm = &summary["alarm"];
        assert_eq!((&alarm["code"], &alarm["line"]), (&Value::from(code), &Value::from(line)), "{program}");
    }
}

/// All lines of a block without an end are accepted, but none of them is carried out.
#[test]
fn a_block_without_an_end_is_an_error_of_the_line_that_began_it() {
    for (name, program, line) in [
        ("open_if.nc", "%\nG1 X1 F600\n\no1 if [0]\nG1 X2\nM2\n%\n", 4),
        ("open_sub.nc", "o<pocket> sub\n%\nG1 X2 F600\nM30\n", 1),
        ("open_loop.nc", "G1 X1 F600\no1 repeat [2]\no1 endrepeat\n o2 while [1] (so)\nX5", 4),
        ("open_at_end.nc", "o5 if [1]\nG1 X1 F600\nM2\n", 1),
    ] {
        let job = file(name, program);
        let output = run(&["run", text(&job), "--json"]);
        assert_eq!(output.status.code(), Some(1), "{name}");
        let summary = json(&output);
        let errors = summary["errors"].as_array().expect("a list");
        assert_eq!(errors.len(), 1, "{name}: {errors:?}");
        assert_eq!((&errors[0]["line"], &errors[0]["code"]), (&Value::from(line), &Value::from(81)), "{name}");
        assert_eq!(errors[0]["source"], program.lines().nth(line - 1).expect("the line").trim(), "{name}");
    }
    let job = file("closed.nc", "o1 sub\nG1 X2 F600\no1 endsub\no2 if [1]\no1 call\no2 endif\nM2\n");
    assert_eq!(run(&["run", text(&job)]).status.code(), Some(0));
}

#[test]
fn bad_usage_and_files_that_cannot_be_read_end_with_2() {
    for arguments in [&["run", "no_such_file.nc"][..], &["run"], &["mill"], &["run", "x.nc", "--board", "none"]] {
        let output = run(arguments);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?} ends without a reason");
    }
}

#[test]
fn files_that_are_no_jobs_are_named() {
    let utf16: Vec<u8> = "\u{FEFF}G20\r\nG1 X1 F60\r\n".encode_utf16().flat_map(u16::to_le_bytes).collect();
    let binary: Vec<u8> = (0..2000_u32).map(|n| ((n * n) >> 3) as u8).collect();
    let cases = [("UTF-16", &utf16[..]), ("empty", b""), ("empty", b"\r\n\r\n"), ("binary", &binary)];
    for (number, (what, bytes)) in cases.into_iter().enumerate() {
        let job = file(&format!("no_job_{number}.nc"), "");
        fs::write(&job, bytes).expect("a file can be written");
        for command in [&["check"][..], &["run", "--json"], &["resume", "--line", "1"]] {
            let output = run(&[command, &[text(&job)]].concat());
            let said = String::from_utf8_lossy(&output.stderr);
            assert_eq!((output.status.code(), said.lines().count()), (Some(2), 1), "{command:?} {said}");
            assert!(said.contains(what) && output.stdout.is_empty(), "{command:?} {said}");
        }
    }
    // Windows writes `$$ > settings.txt` so.
    let (job, settings) = (file("job_of_settings.nc", "G21\n"), file("settings_utf16.txt", ""));
    fs::write(&settings, &utf16).expect("a file can be written");
    for option in ["--settings", "--machine"] {
        let output = run(&["check", text(&job), option, text(&settings)]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains("UTF-16"), "{option} {said}");
    }
    let empty = run(&["check", "-"]);
    assert_eq!(empty.status.code(), Some(2), "{}", String::from_utf8_lossy(&empty.stderr));
    // The lines before the damage are run.
    let job = file("damaged.nc", &format!("{}G1 X2\0\nG1 X3\n", "G1 X1 F6000\n".repeat(20_000)));
    let output = run(&["run", "--json", text(&job)]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("line 20001 has a byte 0"), "{said}");
    let summary = json(&output);
    assert_eq!((&summary["complete"], &summary["position_mm"][0]), (&false.into(), &1.0.into()));
}

/// A file for a control with M98 has subprograms behind its end. A sender sends their lines, too; they are refused.
#[test]
fn nothing_falls_into_a_subprogram_behind_the_end() {
    let job = file("subprogram.nc", "%\nO1000\nG21 G0 X1\nM30\nO1001\nG1 Z-3 F100\nM99\n%\n");
    let output = run(&["run", text(&job), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let summary = json(&output);
    let errors = summary["errors"].as_array().expect("a list");
    let refused: Vec<_> = errors.iter().map(|error| (error["line"].as_u64(), error["code"].as_u64())).collect();
    assert_eq!(refused, [5, 6, 7].map(|line| (Some(line), Some(203))));
    assert_eq!(summary["position_mm"], serde_json::json!([1.0, 0.0, 0.0]));
}

/// Warns of each line with which a sender would hold the machine or open its door, and of a line that takes hours.
#[test]
fn lines_are_named_that_do_what_may_not_be_meant() {
    let job = file("meant.nc", "G21 G91\n(Grüße, Über-Maß à 5)\nG1 X1 F600\n(so what! go~)\nG1 X6 F0.05\nM2\n");
    for dialect in ["oxmill", "grbl"] {
        let output = run(&["check", text(&job), "--json", "--dialect", dialect]);
        assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
        let summary = json(&output);
        let warnings = summary["warnings"].as_array().expect("a list");
        let told: Vec<_> =
            warnings.iter().map(|w| (w["line"].as_u64().unwrap(), w["text"].as_str().unwrap())).collect();
        assert_eq!(
            told[..2],
            [
                (
                    2,
                    "sent as it is, byte 0x9C of `Ü` raises the spindle by 1 %, byte 0xA0 of `à` switches flood coolant on or off in dialect grbl"
                ),
                (4, "sent as it is, `!` holds the machine, `~` goes on where the machine is held in dialect grbl"),
            ]
        );
        // In Grbl's dialect 0.05 mm/min is raised to 1 mm/min.
        let long = (dialect == "oxmill").then_some((5, "takes 2 h 0 min 0 s"));
        assert_eq!((told.get(2).copied(), &summary["more_warnings"]), (long, &0.into()));
    }
    let said = String::from_utf8(run(&["check", text(&job)]).stdout).expect("text");
    assert!(
        said.contains("every line is accepted, with 3 warnings") && said.contains("line 4: sent as it is"),
        "{said}"
    );
}

#[test]
fn a_job_may_come_by_standard_input() {
    let mut program = oxmill(&["run", "-", "--json"]).stdin(Stdio::piped()).spawn().expect("the program starts");
    program.stdin.take().expect("a pipe").write_all(b"G1 X2 F300\n").expect("the program reads");
    let output = program.wait_with_output().expect("the program ends");
    assert_eq!(output.status.code(), Some(0));
    assert_eq!(json(&output)["position_mm"][0], 2.0);
}

#[test]
fn drawings_and_traces_are_what_their_names_say() {
    let job = file("drawn.nc", "G0 X1\nG1 Y2 F300\nM3 S1000\nG1 X0\n");
    let [svg, png, csv] = ["drawn.svg", "drawn.png", "drawn.csv"].map(|name| file(name, ""));
    let output = run(&["run", text(&job), "--plot", text(&svg), "--plot", text(&png), "--trace", text(&csv)]);
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(fs::read_to_string(svg).expect("text").contains("<svg"));
    assert_eq!(fs::read(png).expect("bytes").get(..8), Some(&b"\x89PNG\r\n\x1a\n"[..]));
    let table = fs::read_to_string(csv).expect("text");
    assert!(table.starts_with("t_s,x,y,z"));
    let last = table.lines().last().expect("rows").split(',').skip(1).take(3).collect::<Vec<_>>();
    let net = json(&run(&["run", text(&job), "--json"]))["steps"].clone();
    assert_eq!(net, serde_json::json!(last.iter().map(|n| n.parse::<i64>().expect("steps")).collect::<Vec<_>>()));
}

/// Tries to write every output over one of the other files, by the file's own name and by others.
#[test]
fn no_file_is_written_over_another() {
    let program = "G1 X1 F300\n";
    let job = file("kept.nc", program);
    let settings = file("kept.txt", "$100=80\n");
    let linked = Path::new(env!("CARGO_TARGET_TMPDIR")).join("linked.svg");
    // The link of an earlier run is removed, because it cannot be made again.
    let _ = fs::remove_file(&linked);
    fs::hard_link(&job, &linked).expect("a link can be made");
    let roundabout = job.parent().expect("a folder").join(".").join("kept.nc");
    let [job, settings, linked, roundabout] = [&job, &settings, &linked, &roundabout].map(|path| text(path));
    let fresh = Path::new(env!("CARGO_TARGET_TMPDIR")).join("fresh.svg");
    let fresh = text(&fresh);
    for outputs in [
        &["--trace", job][..],
        &["--trace", roundabout],
        &["--plot", linked],
        &["--store", job],
        &["--settings", settings, "--trace", settings],
        &["--machine", settings, "--store", settings],
        &["--plot", fresh, "--trace", fresh],
        &["--plot", fresh, "--plot", fresh],
    ] {
        let output = run(&[&["run", job][..], outputs].concat());
        assert_eq!(output.status.code(), Some(2), "{outputs:?}");
        assert!(String::from_utf8_lossy(&output.stderr).contains("cannot be both"), "{outputs:?}");
        assert_eq!(fs::read_to_string(job).expect("the job"), program, "{outputs:?}");
        assert_eq!(fs::read_to_string(settings).expect("the settings"), "$100=80\n", "{outputs:?}");
        assert!(!Path::new(fresh).exists(), "{outputs:?}");
    }
}

#[test]
fn an_output_that_cannot_be_written_is_found_before_the_machine_starts() {
    let job = file("started.nc", "G1 X1 F300\n");
    let trace = file("started.csv", "as it was");
    for name in ["none/x.svg", "none/x.csv"] {
        let path = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
        let what = if name.ends_with("svg") { "--plot" } else { "--trace" };
        let mut arguments = vec!["run", text(&job), what, text(&path)];
        if what == "--plot" {
            arguments.extend(["--trace", text(&trace)]);
        }
        let output = run(&arguments);
        assert_eq!(output.status.code(), Some(2), "{name}");
        assert!(output.stdout.is_empty(), "{name}: the job was run");
        assert!(String::from_utf8_lossy(&output.stderr).contains(name), "{name} is not named");
    }
    assert_eq!(fs::read_to_string(trace).expect("text"), "as it was");
}

/// An output device that accepts nothing, like a full disk.
#[cfg(target_os = "linux")]
#[test]
fn the_summary_is_printed_though_an_output_fails() {
    let job = file("full.nc", "G1 X1 F300\n");
    let drawing = Path::new(env!("CARGO_TARGET_TMPDIR")).join("full.svg");
    let _ = fs::remove_file(&drawing);
    std::os::unix::fs::symlink("/dev/full", &drawing).expect("a link can be made");
    for arguments in [["--trace", "/dev/full"], ["--plot", text(&drawing)]] {
        let output = run(&[&["run", text(&job), "--json"][..], &arguments].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}");
        assert_eq!(json(&output)["steps"][0], 250, "{arguments:?}");
        assert!(!output.stderr.is_empty(), "{arguments:?} ends without a reason");
    }
}

#[test]
fn a_job_of_errors_has_a_summary_of_bounded_size() {
    let job = file("errors.nc", &"G1\tQ1\n".repeat(30_000));
    let output = run(&["run", text(&job), "--json"]);
    assert_eq!(output.status.code(), Some(1));
    let summary = json(&output);
    assert_eq!(summary["errors"].as_array().map(Vec::len), Some(1000));
    assert_eq!(summary["more_errors"], 29_000);
    assert_eq!(summary["errors"][0]["source"], "G1 Q1");
    assert!(output.stdout.len() < 1_000_000, "{} bytes", output.stdout.len());
    let words = String::from_utf8(run(&["run", text(&job)]).stdout).expect("text");
    assert!(words.contains("30000") && words.contains("and 29980 more"), "{words}");
}

#[test]
fn a_reader_that_has_seen_enough_is_no_failure() {
    let job = file("piped.nc", "G1 X1 F300\n");
    for how in [&["run", text(&job)][..], &["run", text(&job), "--json"]] {
        let mut program = oxmill(how).spawn().expect("the program starts");
        drop(program.stdout.take());
        let output = program.wait_with_output().expect("the program ends");
        assert_eq!(output.status.code(), Some(0));
        assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    }
}

/// If standard error is closed or full, the exit status still reports the result.
#[cfg(unix)]
#[test]
fn nothing_that_cannot_be_said_is_a_crash() {
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").expect("a device"));
    let closed = || Stdio::from(std::io::pipe().expect("a pipe").1);
    let recording = file("said.rec", "oxmill recording 1\nboard desk 1000000\nbegin 0\n1000 connect\n");
    let status = |arguments: &[&str], to: Stdio| {
        let output = oxmill(arguments).stdout(to).output().expect("it ends by itself");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    for words in [&["serve", "--tcp", "0"][..], &["serve", "--pty"], &["completions", "bash"], &["man"]] {
        let (code, said) = status(words, full());
        assert!(code == Some(2) && said.starts_with("oxmill: cannot write"), "{words:?}: {code:?}, {said}");
        let (code, said) = status(words, closed());
        assert!(code != Some(101) && !said.contains("panicked"), "{words:?}: {code:?}, {said}");
    }
    let (code, said) = status(&["replay", text(&recording)], closed());
    assert_eq!((code, said.contains("panicked")), (Some(3), false), "{said}");
    let mute = oxmill(&["run", "none.nc"]).stderr(full()).output().expect("it ends by itself");
    assert_eq!(mute.status.code(), Some(2));
}

/// Lost answers, and input that cannot be read to its end, end the program with a status that reports it.
#[cfg(unix)]
#[test]
fn a_device_on_standard_input_loses_nothing_silently() {
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").expect("a device"));
    for pins in [&[][..], &["--pins", "0"]] {
        // The program's input stays open.
        let mut program = oxmill(&[&["serve", "--stdio", "--speed", "max"], pins].concat());
        let mut program = program.stdin(Stdio::piped()).stdout(full()).spawn().expect("it starts");
        // The greeting is lost, too, so the program can have ended already.
        let _ = program.stdin.as_mut().expect("a pipe").write_all(b"G1 X1 F1000\n");
        let (code, said) = ended(program);
        assert!(code == Some(2) && said.contains("cannot write the answers"), "{pins:?}: {code:?}, {said}");
    }
    let endless = file("endless.nc", &"x".repeat(70_000));
    let folder = env!("CARGO_TARGET_TMPDIR");
    for (input, reason) in [(text(&endless), "more than 65536 characters"), (folder, "directory")] {
        let input = fs::File::open(input).expect("it can be opened");
        let (code, said) = ended(oxmill(&["serve", "--stdio"]).stdin(input).spawn().expect("it starts"));
        assert!(code == Some(2) && said.contains(reason), "{code:?}, {said}");
    }
}

/// Returns exit status and output of a program that must end while its input is still open.
#[cfg(unix)]
fn ended(mut program: std::process::Child) -> (Option<i32>, String) {
    let end = std::time::Instant::now() + std::time::Duration::from_secs(60);
    loop {
        if let Some(status) = program.try_wait().expect("a program") {
            let mut said = String::new();
            program.stderr.take().expect("a pipe").read_to_string(&mut said).expect("text");
            return (status.code(), said);
        }
        if std::time::Instant::now() > end {
            let _ = program.kill();
            panic!("it does not end");
        }
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
}

/// A sender may start with `?` and a line end in one write: the report comes before the `ok` of the empty line.
#[test]
fn a_report_comes_before_the_line_that_follows_its_question() {
    for dialect in ["grbl", "oxmill"] {
        let mut program =
            oxmill(&["serve", "--stdio", "--dialect", dialect]).stdin(Stdio::piped()).spawn().expect("it starts");
        program.stdin.take().expect("a pipe").write_all(b"?\n").expect("the device reads");
        let mut said = String::new();
        program.stdout.take().expect("a pipe").read_to_string(&mut said).expect("text");
        program.wait().expect("the device ends with its input");
        let lines: Vec<&str> = said.lines().collect();
        assert!(matches!(lines[..], [.., report, "ok"] if report.starts_with("<Idle|")), "{dialect}: {said}");
    }
}

#[test]
fn a_device_on_standard_input_greets_and_answers() {
    let mut program = oxmill(&["serve", "--stdio", "--speed", "max"]).stdin(Stdio::piped()).spawn().expect("it starts");
    program.stdin.take().expect("a pipe").write_all(b"$I\nG1 X1 F1000\n").expect("the device reads");
    let mut said = String::new();
    program.stdout.take().expect("a pipe").read_to_string(&mut said).expect("text");
    program.wait().expect("the device ends with its input");
    assert!(said.contains("Grbl 1.1h ['$' for help]"), "{said}");
    assert!(said.contains("[VER:1.1h.") && said.ends_with("ok\r\nok\r\n"), "{said}");
}

/// A wrong byte in the store: `run` reports it and does not start; a device reports it and stays locked until the user
/// has checked.
#[test]
fn a_damaged_store_is_told_and_locks() {
    let job = file("stored.nc", "G21 G90\nG0 X10\n");
    let store = file("stored.img", "");
    for (address, byte) in [(12, b'X'), (12, 0), (12, 255), (20, b'X'), (20, 0), (20, 255), (5, 0), (9, 255)] {
        fs::remove_file(&store).expect("a file can be removed");
        let arguments = ["run", text(&job), "--store", text(&store), "--json"];
        let output = run(&[&arguments[..], &["--set", "100=80", "--set", "101=81"]].concat());
        assert_eq!(json(&output)["steps"][0], 800);
        let output = run(&[&arguments[..], &["--set", "100=80"]].concat());
        assert_eq!(json(&output)["steps"][0], 800);
        let mut image = fs::read(&store).expect("an image");
        assert_ne!(image[address], byte, "byte {address}");
        image[address] = byte;
        fs::write(&store, &image).expect("a file can be written");

        let output = run(&arguments);
        assert_eq!((output.status.code(), output.stdout.as_slice()), (Some(2), &b""[..]), "byte {address}");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(said.contains("damaged") && said.contains("some may be lost") && said.contains("$$"), "{said}");
        assert_eq!(fs::read(&store).expect("an image"), image, "nothing is written");

        let mut program = oxmill(&["serve", "--stdio", "--store", text(&store), "--speed", "100"])
            .stdin(Stdio::piped())
            .spawn()
            .expect("it starts");
        let mut input = program.stdin.take().expect("a pipe");
        input.write_all(b"$X\nG0X10\n$$\n").expect("the device reads");
        std::thread::sleep(std::time::Duration::from_millis(500));
        input.write_all(b"$X\nG0X10\n").expect("the device reads");
        drop(input);
        let output = program.wait_with_output().expect("the device ends with its input");
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let told = "[MSG:Stored settings were damaged and some may be lost: check $$, 2 s later $X confirms]\r\n";
        let refused = format!("\r\nGrbl 1.1h ['$' for help]\r\n{told}{told}error:7\r\nerror:9\r\n$0=10\r\n");
        assert!(said.starts_with(&refused), "byte {address}: {said}");
        assert!(said.contains("$101=81.000\r\n"), "byte {address}: {said}");
        assert!(said.ends_with("[MSG:Caution: Unlocked]\r\nok\r\nok\r\n"), "byte {address}: {said}");
        assert!(run(&arguments).status.success(), "it is clean again");
    }
}

/// Endless files are not read to the end, and a file too long for its purpose is rejected by name.
#[cfg(unix)]
#[test]
fn files_are_read_with_a_bound() {
    let job = file("bounded.nc", "G1 X1 F300\n");
    let long = file("too_long.toml", &"# a remark\n".repeat(100_000));
    for option in ["--store", "--settings", "--machine"] {
        for path in [Path::new("/dev/zero"), &long] {
            let output = run(&["run", text(&job), option, text(path)]);
            let said = String::from_utf8_lossy(&output.stderr).into_owned();
            assert_eq!(output.status.code(), Some(2), "{option} {}: {said}", path.display());
            let why = if option == "--store" { "it does not have 32768 bytes" } else { "it has more than " };
            assert!(said.contains(text(path)) && said.contains(why), "{option}: {said}");
        }
    }
    let output = run(&["run", "/dev/zero"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2));
    assert!(said.contains("/dev/zero") && said.contains("it is a binary file"), "{said}");
    let output = run(&["run", text(&file("one_line.nc", &"G1 X1 ".repeat(200_000)))]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.code() == Some(2) && said.contains("a line has more than a million bytes"), "{said}");
}

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
    // A recording whose steps are the same but whose outputs or clock differ is reported.
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
    // A recording of a program that makes other steps is reported.
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

/// The replay does not wait for the end of the dwell.
#[test]
fn a_recorded_job_with_a_very_long_dwell_is_played_again() {
    let job = file("long_dwell.nc", "G0 X1\nG4 P10000000\nG0 X2\n");
    let recording = file("long_dwell.rec", "");
    assert!(run(&["run", text(&job), "--record", text(&recording)]).status.success());
    let output = run(&["replay", text(&recording)]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// Errors that prevent a run are found before an older recording is overwritten.
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
fn exit_statuses_are_explained() {
    let said = run(&["man"]).stdout;
    let page = fs::read_to_string(Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/json.md")).expect("docs/json.md");
    for line in oxmill_simulator::command_line::EXIT_STATUS.lines().skip(1) {
        let (status, meaning) = line.trim().split_once("  ").expect("a number and its meaning");
        assert!(page.contains(&format!("| {status} | {meaning} |")), "docs/json.md: {line}");
    }
    assert!(String::from_utf8_lossy(&said).contains("Exit status"));
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
    // `bad` is the third line of the host: the setting was active before the host connected, and is not a line.
    assert_eq!((&summary["errors"][0]["line"], &summary["errors"][0]["code"]), (&3.into(), &2.into()));
    assert!(String::from_utf8_lossy(&played.stderr).is_empty(), "the same steps");
}

/// Recordings of machines: each once revealed a fault, or shows behaviour that must not change.
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
            // A recording of a board whose firmware failed at its end.
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

/// The rest of a job is a program that is accepted, on standard output or in a file; errors are reported, and leave no
/// file.
#[test]
fn the_rest_of_a_job_is_written() {
    let pocket = concat!(env!("CARGO_MANIFEST_DIR"), "/examples/pocket_mm.nc");
    let out = Path::new(env!("CARGO_TARGET_TMPDIR")).join("rest.nc");
    fs::remove_file(&out).ok();
    let told = run(&["resume", pocket, "--line", "200", "-o", text(&out)]);
    let said = String::from_utf8_lossy(&told.stderr);
    assert!(told.status.success() && told.stdout.is_empty() && said.contains("line 200 of 465"), "{said}");
    assert_eq!(run(&["run", text(&out)]).status.code(), Some(0));
    assert_eq!(run(&["resume", pocket, "--line", "200"]).stdout, fs::read(&out).expect("a program"));
    let other = out.with_file_name("no_rest.nc");
    for (arguments, word) in [
        (&["--line", "466"][..], "there is no line 466"),
        (&["--number", "466"], "no line has N466"),
        (&["--line", "2", "--plunge", "0.9"], "the plunge feed is below 1 mm/min"),
        (&["--line", "2", "--clearance", "nan"], "--clearance"),
        (&["--line", "2", "--number", "3"], "--number"),
        (&[], "--line"),
        (&["--line", "2", "--set", "100"], "is not of the form $n=v"),
    ] {
        let output = run(&[&["resume", pocket, "-o", text(&other)], arguments].concat());
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains(word) && !other.exists(), "{arguments:?}: {said}");
    }
    let job = file("rested.nc", "G21 G90 G0 Z5\nX1\n");
    let output = run(&["resume", text(&job), "--line", "2", "-o", text(&job)]);
    assert_eq!(output.status.code(), Some(2), "the job would be written over");
}
