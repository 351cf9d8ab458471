//! Runs the unmodified STM32 images on the virtual board of `tests/virtual_board`, a Python program in its own virtual
//! environment under `target/tools`.

use crate::python::{environment, module};
use crate::{Failure, cargo, image, root, run, suites};
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::thread;

/// Boards whose chips are modelled, each with its cases for a run of all boards. Such a run has each case on the board
/// where it is hardest, and a few cases on several chips. A board without cases runs only if it is named, as in
/// `.ci/nightly`. A named board runs all cases.
const BOARDS: [(&str, &[&str]); 14] = [
    ("blackpill_f411", ON_F411),
    ("nucleo_f446re", ON_F446),
    ("blackpill_f401", ON_F401),
    ("nucleo_f411re", &[]),
    ("nucleo_f401re", &[]),
    ("octopus_f446", ON_CONTROL_F446),
    ("octopus_pro_f446", &[]),
    ("spider_f446", ON_OTHER_PINS),
    ("robin_nano_v3", ON_CONTROL_F407),
    ("skr2_f407", ON_SKR2),
    ("monster8_f407", &[]),
    ("jz_f407", &[]),
    ("slb_ext", ON_CONTROL_F412),
    ("blackpill_f411_grblhal", ON_OTHER_PINS),
];

/// Cases for the board that most owners have. Its processor is slow, and it has both links: USB, and a UART that needs
/// an interrupt for each byte.
const ON_F411: &[&str] = &[
    "boot",
    "crystals",
    "own pins",
    "tasks",
    "stream axes.nc",
    "pulses",
    "safe rate",
    "hard start",
    "laser start",
    "turns",
    "hold",
    "stops",
    "stops on the ring",
    "masked for long",
    "miscounts",
    "emergency stop",
    "lines at stops",
    "switch noise",
    "probe",
    "flood of realtime commands",
    "second motor",
    "spindle PWM",
    "torn line",
    "waiting line",
    "fault",
    "stack overflow",
    "failure in a failure",
    "hung control task",
    "unserved tasks",
    "recorded failure",
    "masked for ever",
    "lost clock",
    "boot loader left",
    "restart on request",
    "brown-out",
    "brown-out of a beam",
    "usb",
    "usb answers",
    "usb flood",
    "usb lines",
    "usb reset",
    "usb set up again",
    "usb stop",
    "usb unplugged",
    "usb unread",
];

/// Cases for a Nucleo F446RE. Its UART works by DMA, it has the highest step rate, and its core runs at twice the clock
/// of the step timer.
const ON_F446: &[&str] = &[
    "boot",
    "tasks",
    "pulses",
    "turns",
    "hold",
    "uart lines",
    "baud rates",
    "torn line",
    "disturbed line",
    "waiting line",
    "settings write",
    "power cut",
    "fault",
    "lost clock",
];

/// Cases for the slowest chip, an F401. They cover what can differ because of its clocks, rates and memory.
const ON_F401: &[&str] =
    &["boot", "crystals", "tasks", "pulses", "safe rate", "turns", "settings write", "fault", "lost clock"];

/// Cases for the image of control boards with an F446. It differs from the Nucleo's in its ports, its clock rate (168
/// instead of 180 MHz) and its USB, whose core is newer than the Black Pills'.
const ON_CONTROL_F446: &[&str] = &[
    "boot",
    "crystals",
    "tasks",
    "trips",
    "inverted outputs",
    "fourth axis",
    "power cut",
    "usb",
    "usb flood",
    "lost clock",
    "restart on request",
];

/// Cases for the image of control boards with an F407. On `robin_nano_v3`, two ports have direction outputs but no step
/// outputs; TIM8 drives such ports.
const ON_CONTROL_F407: &[&str] = &[
    "boot",
    "tasks",
    "safe rate",
    "turns at full rate",
    "zigzag",
    "stops in a zigzag",
    "fourth axis",
    "settings write",
    "usb",
];

/// Cases for the image of control boards with an F412, in which TIM8 makes the pulses and TIM1 the spindle's PWM.
const ON_CONTROL_F412: &[&str] = &[
    "boot",
    "crystals",
    "tasks",
    "pulses",
    "turns",
    "stops on the ring",
    "spindle PWM",
    "settings write",
    "brown-out of a beam",
    "usb",
    "fault",
    "lost clock",
    "restart on request",
];

/// Cases for a board that has the same image as another board, and only another pin table. The other board runs more
/// cases; these test the pins.
const ON_OTHER_PINS: &[&str] =
    &["boot", "pulses", "trips", "inverted outputs", "outputs of programs", "inputs of programs"];

/// Cases for the board that can switch off the supply of its motors. Its spindle PWM is on channel 3 of the timer.
const ON_SKR2: &[&str] =
    &["boot", "pulses", "outputs of programs", "inputs of programs", "spindle PWM", "raster", "restart on request"];

/// Boards that can also run the loop-back suite, with its wires. `true`: a run of all boards includes the suite.
const LOOPBACK: [(&str, bool); 3] = [("blackpill_f411", true), ("nucleo_f446re", true), ("blackpill_f401", false)];

/// Facts that the manuals leave open are modelled with a first and a second reading
/// (`tests/virtual_board/models/readings.py`). Each row has the name of a second reading, a board, and the cases that
/// depend on the fact. `.ci/nightly` runs all cases of three boards under each second reading.
const READINGS: [(&str, &str, &[&str]); 6] = [
    ("counted-at-fetch", "blackpill_f411", &["hold", "turns"]),
    ("compare-on-count", "nucleo_f446re", &["probe"]),
    ("quick-trigger", "blackpill_f411", &["pulses"]),
    ("slow-trigger", "nucleo_f446re", &["turns"]),
    ("flags-by-dma", "nucleo_f446re", &["disturbed line"]),
    ("flags-by-dma", "blackpill_f411", &["disturbed line"]),
];

/// Runs the cases of one board or of all boards, two processes at a time; `cases` selects some of them. Without
/// `cases`, also runs the loop-back suite. If no board is named either, also runs the cases in [`READINGS`].
pub fn check(board: Option<&str>, cases: &[&str]) -> Result<(), Failure> {
    let is_wanted = |name: &str, own: &[&str]| board.map_or(!own.is_empty(), |board| board == name);
    let boards: Vec<(&str, &[&str])> = BOARDS.into_iter().filter(|(name, own)| is_wanted(name, own)).collect();
    if boards.is_empty() {
        let all: Vec<&str> = BOARDS.iter().map(|(name, _)| *name).collect();
        return Err(format!("there is no such virtual board; there are {}", all.join(", ")));
    }
    let python = environment("virtual-board", "virtual_board")?;
    suites::require_defmt_print()?;
    run(cargo().args(["build", "--quiet", "--locked", "--bin", "oxmill"]))?;
    run(module(&python, "unittest").arg("virtual_board.test_models"))?;
    let mut runs = Vec::new();
    let is_named = board.is_some();
    for (board, own) in &boards {
        let mut command = module(&python, "virtual_board");
        command.arg(board).arg(image::build(board)?.path).arg(root().join("target/debug/oxmill"));
        command.args(if cases.is_empty() && !is_named { own } else { cases });
        runs.push((*board, command));
    }
    for (reading, board, own) in READINGS.iter().filter(|_| cases.is_empty() && !is_named) {
        let mut command = module(&python, "virtual_board");
        command.arg(board).arg(root().join("target/boards").join(format!("{board}.elf")));
        command.arg(root().join("target/debug/oxmill")).args(*own).args(["--reading", reading]);
        runs.push((*board, command));
    }
    let has_loopback = |(board, in_all): &(&str, bool)| {
        cases.is_empty() && (is_named || *in_all) && boards.iter().any(|(name, _)| name == board)
    };
    for (board, _) in LOOPBACK.into_iter().filter(has_loopback) {
        let mut command = module(&python, "virtual_board.loopback");
        command.arg(board).arg(suites::loopback(board)?);
        runs.push((board, command));
    }
    let failed = two_at_a_time(runs);
    if failed.is_empty() { Ok(()) } else { Err(format!("the virtual board failed:\n{}", failed.join("\n"))) }
}

/// Runs a script on one board; with `wall`, the run ends when the machine first rests after this many seconds of real
/// time. Returns the board's output and the notes of its test stand.
pub fn soak(board: &str, elf: &Path, script: &Path, wall: Option<u64>) -> Result<(String, String), Failure> {
    if !BOARDS.iter().any(|(name, _)| *name == board) {
        return Err(format!("there is no such virtual board: {board}"));
    }
    let python = environment("virtual-board", "virtual_board")?;
    let (answers, report) = (script.with_extension("answers"), script.with_extension("report"));
    run(module(&python, "virtual_board.soak")
        .arg(board)
        .args([elf, script])
        .args([&answers, &report])
        .args(wall.map(|seconds| seconds.to_string())))?;
    let read = |path: &Path| fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()));
    Ok((read(&answers)?, read(&report)?))
}

/// Runs the commands, two at a time, and prints the output of each when it ends. Returns a message for each command
/// that failed. The caller prints these messages again, at the end of the log.
fn two_at_a_time(runs: Vec<(&str, Command)>) -> Vec<String> {
    let waiting = Mutex::new(runs.into_iter());
    let failed = Mutex::new(Vec::new());
    let work = || {
        loop {
            let next = waiting.lock().expect("no worker panics with the lock").next();
            let Some((board, mut command)) = next else { return };
            let output = command.stdin(Stdio::null()).output();
            // Printed with the lock held, so that two reports do not mix.
            let mut failed = failed.lock().expect("no worker panics with the lock");
            match output {
                Ok(output) => {
                    print!("{}", String::from_utf8_lossy(&output.stdout));
                    if !output.status.success() {
                        eprint!("{}", String::from_utf8_lossy(&output.stderr));
                        let (report, said) =
                            (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
                        failed.push(format!("{board} ({}): {}", output.status, failures(&report, &said)));
                    }
                }
                Err(error) => failed.push(format!("{board} ({}: {error})", command.get_program().to_string_lossy())),
            }
        }
    };
    thread::scope(|scope| {
        scope.spawn(work);
        work();
    });
    failed.into_inner().expect("no worker panics with the lock")
}

/// Returns the failed cases of a report, each with the line after it, which gives the reason. Also returns the last
/// line of `errors`, which names an exception.
fn failures(report: &str, errors: &str) -> String {
    let mut lines = report.lines();
    let mut found = Vec::new();
    while let Some(line) = lines.next() {
        if line.contains("FAILED") {
            found.push(format!("{line} {}", lines.next().unwrap_or_default().trim()));
        }
    }
    found.extend(errors.lines().last().map(str::to_string));
    found.join("; ")
}

#[cfg(test)]
mod tests {
    use super::failures;

    #[test]
    fn failed_cases_are_named_with_their_reasons() {
        let report =
            "case boot ... ok (0.5 s)\ncase turns ... FAILED\n  a step too few (2.0 s)\ncase hold ... ok (1.0 s)\n";
        assert_eq!(failures(report, ""), "case turns ... FAILED a step too few (2.0 s)");
        assert_eq!(failures("case boot ... ok", "Traceback\nKeyError: 7\n"), "KeyError: 7");
    }
}
