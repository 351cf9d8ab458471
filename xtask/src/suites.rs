//! Runs the defmt-test suites of `tests/on_target`, on QEMU or on a board, and the loop-back bench, whose pins are
//! wired together.

use crate::paths::cargo_for_boards;
use crate::{Failure, QEMU_BOARD, boards, exists, qemu, run};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::process::{Command, Stdio};

/// Environment variable with the runner for the ARM target.
const RUNNER: &str = "CARGO_TARGET_THUMBV7EM_NONE_EABIHF_RUNNER";
/// Runner for QEMU, as a path relative to the workspace. The path of the workspace can contain blanks, and cargo
/// splits the variable at blanks.
const QEMU_RUNNER: &str = ".cargo/qemu-runner.sh";
/// Suites that need only the processor, memory and flash.
const SUITES: [&str; 4] = ["controller", "settings", "copies", "queues"];
/// Suite that needs wires on a board: docs/bench.md.
const LOOPBACK: &str = "loopback";

/// Returns `true` if a board has enough RAM for a suite and its stack (tests/on_target/build.rs).
fn has_room(board: &str, suite: &str) -> bool {
    !board.contains("f401") || suite != "controller"
}

fn suites(board: &str) -> Vec<&'static str> {
    SUITES.into_iter().filter(|suite| has_room(board, suite)).collect()
}

fn tell_left_out(board: &str) {
    for suite in SUITES.iter().filter(|suite| !has_room(board, suite)) {
        println!("suite `{suite}` needs a stack of 84 KiB, for which {board} has no room: it is not run there");
    }
}

fn cargo_test(board: &str, suites: &[&str]) -> Result<Command, Failure> {
    let mut cargo = cargo_for_boards("test", boards::profile(board))?;
    cargo.env(crate::BOARD, board);
    cargo.args(["--locked", "--package", "oxmill-on-target", "--features", boards::image(board), "--no-fail-fast"]);
    cargo.args(suites.iter().flat_map(|suite| ["--test", suite]));
    Ok(cargo)
}

/// Runs all suites on QEMU, except the loop-back suite: QEMU's board has no pins.
pub fn on_qemu() -> Result<(), Failure> {
    require_qemu_tools()?;
    run(cargo_test(QEMU_BOARD, &SUITES)?.env(RUNNER, QEMU_RUNNER))?;
    println!("suite `{LOOPBACK}` is not for QEMU, which has no pins: it is for boards, see docs/bench.md");
    Ok(())
}

/// Builds all suites of a board, to check that they link.
pub fn build(board: &str) -> Result<(), Failure> {
    if board == QEMU_BOARD {
        return run(cargo_test(board, &SUITES)?.arg("--no-run"));
    }
    chip(board)?;
    tell_left_out(board);
    run(cargo_test(board, &suites(board))?.args(["--test", LOOPBACK, "--no-run"]))
}

/// Runs the suites on a board, except the one that needs wires.
pub fn on_board(board: &str) -> Result<(), Failure> {
    require_probe()?;
    run(cargo_test(board, &suites(board))?.env(RUNNER, runner(board)?))?;
    tell_left_out(board);
    println!("suite `{LOOPBACK}` needs wires and was not run: `cargo xtask bench-board {board}`, docs/bench.md");
    Ok(())
}

/// Runs the suites on a board, then the loop-back suite; prints the table of measured figures, even after a failure.
pub fn bench(board: &str) -> Result<(), Failure> {
    let runner = runner(board)?;
    require_probe()?;
    let others = run(cargo_test(board, &suites(board))?.env(RUNNER, &runner));
    tell_left_out(board);
    let mut running = cargo_test(board, &[LOOPBACK])?
        .env(RUNNER, &runner)
        .stdout(Stdio::piped())
        .spawn()
        .map_err(|error| format!("cargo cannot be started: {error}"))?;
    let mut table = Vec::new();
    for line in running.stdout.take().into_iter().flat_map(|log| BufReader::new(log).lines()) {
        let line = line.map_err(|error| error.to_string())?;
        println!("{line}");
        table.extend(row(&line).map(str::to_owned));
    }
    let status = running.wait().map_err(|error| error.to_string())?;
    if !table.is_empty() {
        println!("\n{board}\n\n| rate, settings | figure | measured | bound | |\n|---|---|---|---|---|");
        println!("{}\n", table.join("\n"));
    }
    others.map_err(|why| format!("{why}: a suite has failed, see above"))?;
    if status.success() { Ok(()) } else { Err("the loop-back has failed, see above".into()) }
}

/// Returns the row of the table of measured figures that a log line contains; `None` if it contains none. The log adds
/// text before and after the row.
fn row(line: &str) -> Option<&str> {
    let row = line.get(line.find('|')?..=line.rfind('|')?)?;
    (row.matches('|').count() == 6).then_some(row)
}

/// Builds the loop-back suite of a board; returns its path.
pub fn loopback(board: &str) -> Result<PathBuf, Failure> {
    let mut cargo = cargo_test(board, &[LOOPBACK])?;
    cargo.args(["--no-run", "--message-format=json-render-diagnostics"]).stderr(Stdio::inherit());
    let built = cargo.output().map_err(|error| format!("cargo cannot be started: {error}"))?;
    if !built.status.success() {
        return Err(format!("the suite `{LOOPBACK}` of {board} is not built"));
    }
    let messages = String::from_utf8_lossy(&built.stdout);
    messages
        .lines()
        .filter_map(|line| serde_json::from_str::<serde_json::Value>(line).ok())
        .find_map(|message| message["executable"].as_str().map(PathBuf::from))
        .ok_or_else(|| format!("cargo does not say where the suite `{LOOPBACK}` of {board} is"))
}

/// Returns the command that flashes a suite and runs it.
fn runner(board: &str) -> Result<String, Failure> {
    Ok(format!("probe-rs run --chip {}", chip(board)?))
}

/// Returns probe-rs' name of a board's chip.
fn chip(board: &str) -> Result<&'static str, Failure> {
    if board == QEMU_BOARD {
        return Err(format!("{board} has no probe"));
    }
    Ok(boards::described(board)?.chip.probe_name)
}

fn require_probe() -> Result<(), Failure> {
    let Ok(list) = Command::new("probe-rs").arg("list").output() else {
        return Err("probe-rs is missing: `cargo install --locked probe-rs-tools`".into());
    };
    let said = [list.stdout, list.stderr].concat();
    if String::from_utf8_lossy(&said).contains("No debug probes were found") {
        return Err("probe-rs finds no probe: is the ST-LINK or other SWD probe plugged in, and may you use it? \
            (`probe-rs list`; https://probe.rs/docs/getting-started/probe-setup)"
            .into());
    }
    Ok(())
}

/// Checks that the tool for reading the target's log is installed.
pub fn require_defmt_print() -> Result<(), Failure> {
    if exists("defmt-print") {
        Ok(())
    } else {
        Err("defmt-print is missing: `cargo install --locked defmt-print`".into())
    }
}

fn require_qemu_tools() -> Result<(), Failure> {
    qemu::require()?;
    require_defmt_print()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_suite_is_run_somewhere() {
        let folder = std::fs::read_dir(crate::root().join("tests/on_target/tests")).unwrap();
        let mut found: Vec<String> =
            folder.map(|file| file.unwrap().path().file_stem().unwrap().to_str().unwrap().to_owned()).collect();
        found.sort();
        let mut listed = [SUITES.as_slice(), &[LOOPBACK]].concat();
        listed.sort_unstable();
        assert_eq!(found, listed);
    }

    #[test]
    fn rows_are_found_in_any_log() {
        let plain = "| 1000 Hz, $0=10, $29=10 | pulse of X | 10.49 to 10.58 us | 10.00 to 15.00 us | ok |";
        assert_eq!(row(plain), Some(plain));
        let log = format!("12:00:00.1: [INFO ] {plain} (loopback tests/on_target/tests/loopback.rs:200)");
        assert_eq!(row(&log), Some(plain));
        assert_eq!(row("(3/7) running `slow_train`..."), None);
        assert_eq!(row("a | b | c"), None);
        assert_eq!(row("|"), None);
    }

    #[test]
    fn a_board_without_room_or_probe_is_refused() {
        assert!(chip(QEMU_BOARD).is_err());
        assert!(boards::with_hardware().all(|board| chip(board).is_ok()));
        for board in ["nucleo_f401re", "blackpill_f401"] {
            assert_eq!(suites(board), ["settings", "copies", "queues"]);
        }
        assert_eq!(suites("nucleo_f411re"), SUITES);
    }
}
