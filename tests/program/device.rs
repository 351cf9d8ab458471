//! `serve --stdio`: a Grbl device on standard input and output.

use super::{file, json, oxmill, run, text};
use std::fs;
use std::io::{Read, Write};
use std::process::Stdio;

/// If answers cannot be written, or the input cannot be read to its end, the program prints the reason and ends with
/// status 2.
#[cfg(unix)]
#[test]
fn a_device_on_standard_input_loses_nothing_silently() {
    let full = || Stdio::from(fs::OpenOptions::new().write(true).open("/dev/full").expect("a device"));
    for pins in [&[][..], &["--pins", "0"]] {
        // The program's input stays open, so only the failed output can end the program.
        let mut program = oxmill(&[&["serve", "--stdio", "--speed", "max"], pins].concat());
        let mut program = program.stdin(Stdio::piped()).stdout(full()).spawn().expect("it starts");
        // This write may fail: the program can have ended already, because it could not write its greeting.
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
    for dialect in ["grbl", "oxmill", "grblhal"] {
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

/// If the store has a wrong byte, `run` reports it and does not start. A device (`serve`) reports it and stays locked
/// until the user has listed the settings (`$$`) and unlocked the device (`$X`).
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
        let told = "[MSG:Stored settings damaged, some may be lost: send $$, correct them, wait 2 s, send $X]\r\n";
        let refused = format!("\r\nGrbl 1.1h ['$' for help]\r\n{told}{told}error:7\r\nerror:9\r\n$0=10\r\n");
        assert!(said.starts_with(&refused), "byte {address}: {said}");
        assert!(said.contains("$101=81.000\r\n"), "byte {address}: {said}");
        assert!(said.ends_with("[MSG:Caution: Unlocked]\r\nok\r\nok\r\n"), "byte {address}: {said}");
        assert!(run(&arguments).status.success(), "it is clean again");
    }
}
