//! Files that the program reads and writes: files that are not jobs, files that must not be overwritten, outputs that
//! fail.

use super::{file, json, oxmill, run, text};
use std::fs;
use std::io::Write;
use std::path::Path;
use std::process::Stdio;

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
    // On Windows, output that is redirected to a file can be in UTF-16.
    let (job, settings) = (file("job_of_settings.nc", "G21\n"), file("settings_utf16.txt", ""));
    fs::write(&settings, &utf16).expect("a file can be written");
    for option in ["--settings", "--machine"] {
        let output = run(&["check", text(&job), option, text(&settings)]);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(2) && said.contains("UTF-16"), "{option} {said}");
    }
    let empty = run(&["check", "-"]);
    assert_eq!(empty.status.code(), Some(2), "{}", String::from_utf8_lossy(&empty.stderr));
    // Line 20,001 has a byte 0. The program runs the lines before it.
    let job = file("damaged.nc", &format!("{}G1 X2\0\nG1 X3\n", "G1 X1 F6000\n".repeat(20_000)));
    let output = run(&["run", "--json", text(&job)]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.code() == Some(2) && said.contains("line 20001 has a byte 0"), "{said}");
    let summary = json(&output);
    assert_eq!((&summary["complete"], &summary["position_mm"][0]), (&false.into(), &1.0.into()));
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

/// An output path that leads to another file of the same run is rejected, also if it is a hard link or another
/// spelling of the path. No file is changed then.
#[test]
fn no_file_is_written_over_another() {
    let program = "G1 X1 F300\n";
    let job = file("kept.nc", program);
    let settings = file("kept.txt", "$100=80\n");
    let linked = Path::new(env!("CARGO_TARGET_TMPDIR")).join("linked.svg");
    // Remove the link that an earlier run of this test has left: otherwise the link could not be made again.
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

/// `/dev/full` accepts no output, like a full disk.
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

/// Endless files are not read to the end. A file that is too long for its purpose is rejected, and the message names
/// the file.
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
