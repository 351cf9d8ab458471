//! Tests the parts of the command line that other programs rely on, by running the program.

mod device;
mod files;
mod help;
mod recordings;
mod settings;
mod settings_import;

use serde_json::Value;
use std::fs;
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

/// Writes a file into the tests' temporary folder, and returns its path.
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

/// If a dwell is longer than the virtual clock can run, the job is reported as unfinished. A dwell that the clock can
/// run is run to its end, even if it takes more than a thousand years.
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

#[test]
fn plot_draws_the_job() {
    let job = file("plot.nc", "G21 G91\nG1 X10 Y5 F600\n");
    let [svg, png] = ["plot.svg", "plot.png"].map(|name| Path::new(env!("CARGO_TARGET_TMPDIR")).join(name));
    let output = run(&["plot", text(&job), "-o", text(&svg), "-o", text(&png)]);
    assert_eq!(output.status.code(), Some(0));
    let drawn = fs::read_to_string(&svg).expect("a drawing");
    assert!(drawn.starts_with("<svg") && drawn.contains("plot.nc"));
    assert!(fs::read(&png).expect("a drawing").starts_with(b"\x89PNG"));
    // `run --plot` must write the same drawing as `plot`.
    let other = svg.with_file_name("plot_by_run.svg");
    run(&["run", text(&job), "--plot", text(&other)]);
    assert_eq!(fs::read_to_string(&other).expect("a drawing"), drawn);
    let bad = file("plot_bad.nc", "G999\n");
    assert_eq!(run(&["plot", text(&bad), "-o", text(&svg)]).status.code(), Some(1));
    assert_eq!(run(&["plot", text(&job)]).status.code(), Some(2));
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

/// A probing line is answered after its alarm. A line whose target is beyond the travel is not answered. In both cases
/// the alarm has the number of the line that raised it.
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

/// A block of O words without an end is one error, reported for the line that opened the block. The lines in the
/// block are accepted, but the machine does not carry them out.
#[test]
fn a_block_without_an_end_is_an_error_of_the_line_that_began_it() {
    for (name, program, line) in [
        ("open_if.nc", "%\nG1 X1 F600\n\no1 if [0]\nG1 X2\nM2\n%\n", 4),
        // The tape mark `%` ends the first program, so its open block is dropped, and the second program is run.
        ("open_sub.nc", "o<pocket> sub\n%\nG1 X2 F600\nM30\n", 2),
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

/// Runs a file, and returns its summary and its errors: line, code, text.
fn errors_of(name: &str, program: &str) -> (Value, Vec<(u64, u64, String)>) {
    let job = file(name, program);
    let output = run(&["run", text(&job), "--json"]);
    let summary = json(&output);
    let errors = summary["errors"].as_array().expect("a list").iter();
    let errors: Vec<_> = errors
        .map(|error| {
            let number = |key: &str| error[key].as_u64().expect(key);
            (number("line"), number("code"), error["text"].as_str().unwrap_or_default().to_owned())
        })
        .collect();
    assert_eq!(output.status.code(), Some(i32::from(!errors.is_empty())), "{name}: {summary}");
    (summary, errors)
}

/// Subprograms follow the end of their program. They run only when they are called.
#[test]
fn nothing_falls_into_a_subprogram_behind_the_end() {
    let (summary, errors) = errors_of("uncalled.nc", "%\nO1000\nG21 G0 X1\nM30\nO1001\nG1 Z-3 F100\nM99\n%\n");
    assert_eq!((errors, &summary["position_mm"]), (vec![], &serde_json::json!([1.0, 0.0, 0.0])));
    assert_eq!(summary["notes"], serde_json::json!([]), "the lines of a subprogram are no lines behind the end");
    let called = "%\nO1000\nG21 G0 X1\nM98 P1001 L2\nM30\nO1001 (STEP)\nG91 G1 Z-3 F100\nG90\nM99\n%\n";
    let (summary, errors) = errors_of("called.nc", called);
    assert_eq!((errors, &summary["position_mm"]), (vec![], &serde_json::json!([1.0, 0.0, -6.0])));
    assert_eq!(summary["notes"], serde_json::json!([]));
    // The subprogram is missing or has no end, or M99 ends a program that nothing has called.
    for (name, program, line, code) in [
        ("missing.nc", "G21 G0 X1\nM98 P1001\nG0 X2\nM30\nO1002\nG1 Z-3 F100\nM99\n%\n", 2, 203),
        ("endless.nc", "G21 G0 X1\nM98 P1001\nG0 X2\nM30\nO1001\nG1 Z-3 F100\n%\n", 2, 203),
        ("first.nc", "O1001\nG21 G0 X1\nM99\n", 3, 203),
    ] {
        let (summary, errors) = errors_of(name, program);
        assert_eq!(errors.iter().map(|(line, code, _)| (*line, *code)).collect::<Vec<_>>(), [(line, code)], "{name}");
        assert_eq!(summary["position_mm"], serde_json::json!([1.0, 0.0, 0.0]), "{name}");
    }
}

/// A program that calls a subprogram must fit into the board's memory. If it does not, the advice says how many bytes
/// the board lacks.
#[test]
fn a_held_program_that_is_too_long_is_measured() {
    let program = format!("G21 G0 X1\nM98 P1\n{}M30\nO1\nX3\nM99\n", "X2.25 Y-1\n".repeat(700));
    let job = file("too_long.nc", &program);
    let output = run(&["check", text(&job), "--json", "--board", "nucleo_f401re"]);
    let error = &json(&output)["errors"][0];
    // The board must hold the text of the program in memory. Each of the 700 lines needs 9 bytes: 8 for its text
    // without blanks, and 1 for the length. M98P1, M30, O1 with its keyword, and X3 come on top. Another 64 bytes must
    // stay free. The board has 6144 bytes.
    let lacking = 700 * 9 + 6 + 4 + 6 + 3 + 64 - 6144;
    assert_eq!(error["code"], 83);
    let advice = error["advice"].as_str().expect("advice");
    assert!(advice.starts_with(&format!("nucleo_f401re lacks {lacking} bytes: ")), "{advice}");
    // A board with more RAM has room for the program.
    assert_eq!(
        json(&run(&["check", text(&job), "--json", "--board", "nucleo_f446re"]))["errors"],
        serde_json::json!([])
    );
    // The lines that follow are refused, too. Their messages say by how much the program is too long so far.
    let errors = json(&output)["errors"].as_array().cloned().expect("a list");
    let last = errors.last().expect("an error")["text"].as_str().expect("a text").to_owned();
    assert_eq!(
        last,
        format!("M99 does not fit either: the program is {lacking} bytes too long so far; send $X to drop it")
    );
}

/// A check warns of two kinds of lines: a line that takes hours, and a line with a byte that would act as a realtime
/// command if a sender sent the byte unchanged.
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
                    "if sent unchanged in dialect grbl: byte 0x9C of `Ü` raises the spindle speed by 1 %, byte 0xA0 of `à` switches flood coolant on or off"
                ),
                (4, "if sent unchanged in dialect grbl: `!` holds the machine, `~` resumes the held machine"),
            ]
        );
        // Grbl's dialect raises the feed of 0.05 mm/min to 1 mm/min, so there the line takes only minutes.
        let long = (dialect == "oxmill").then_some((5, "takes 2 h 0 min 0 s"));
        assert_eq!((told.get(2).copied(), &summary["more_warnings"]), (long, &0.into()));
    }
    let said = String::from_utf8(run(&["check", text(&job)]).stdout).expect("text");
    assert!(
        said.contains("every line is accepted, with 3 warnings") && said.contains("line 4: if sent unchanged"),
        "{said}"
    );
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

/// `resume` writes a program for the remaining part of a job, to standard output or to a file, and `run` accepts this
/// program. If `resume` reports an error, it writes no file.
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
