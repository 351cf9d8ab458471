//! Runs the unmodified STM32 images on the virtual board of `tests/virtual_board`, a Python program in an environment of its
//! own under `target/tools`.

use crate::{Failure, cargo, image, root, run, suites};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

/// Boards whose parts are modelled.
pub const BOARDS: [&str; 3] = ["blackpill_f411", "nucleo_f446re", "blackpill_f401"];

/// Boards of these that have room for the loop-back suite.
const LOOPBACK: [&str; 2] = ["blackpill_f411", "nucleo_f446re"];

/// All cases on one board, or on all of them, two at a time, and the loop-back suite.
pub fn check(board: Option<&str>) -> Result<(), Failure> {
    let boards: Vec<&str> = board.map_or(BOARDS.to_vec(), |board| vec![board]);
    if let Some(unknown) = boards.iter().find(|board| !BOARDS.contains(board)) {
        return Err(format!("`{unknown}` has no virtual board; there are {}", BOARDS.join(", ")));
    }
    let python = environment()?;
    suites::require_defmt_print()?;
    run(cargo().args(["build", "--quiet", "--bin", "oxmill"]))?;
    run(module(&python, "unittest").arg("virtual_board.test_models"))?;
    let mut runs = Vec::new();
    for board in &boards {
        let mut cases = module(&python, "virtual_board");
        cases.arg(board).arg(image::build(board)?.path).arg(root().join("target/debug/oxmill"));
        runs.push((*board, cases));
    }
    for board in LOOPBACK.into_iter().filter(|board| boards.contains(board)) {
        let mut cases = module(&python, "virtual_board.loopback");
        cases.arg(board).arg(suites::loopback(board)?);
        runs.push((board, cases));
    }
    let mut failed = Vec::new();
    for pair in runs.chunks_mut(2) {
        let running: Vec<Result<Child, Failure>> = pair.iter_mut().map(|(_, command)| start(command)).collect();
        for ((board, _), child) in pair.iter().zip(running) {
            let output = child?.wait_with_output().map_err(|error| error.to_string())?;
            print!("{}", String::from_utf8_lossy(&output.stdout));
            if !output.status.success() {
                eprint!("{}", String::from_utf8_lossy(&output.stderr));
                failed.push(*board);
            }
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("the virtual board failed: {}", failed.join(", "))) }
}

fn start(cases: &mut Command) -> Result<Child, Failure> {
    let child = cases.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn();
    child.map_err(|error| format!("{}: {error}", cases.get_program().to_string_lossy()))
}

fn module(python: &Path, name: &str) -> Command {
    let mut command = Command::new(python);
    command.current_dir(root().join("tests")).env("PYTHONDONTWRITEBYTECODE", "1").args(["-m", name]);
    command
}

/// Python with the packages of `requirements.txt`; made anew when that file has changed.
fn environment() -> Result<PathBuf, Failure> {
    let folder = root().join("target/tools/virtual-board");
    let python = folder.join("bin/python");
    let wanted = root().join("tests/virtual_board/requirements.txt");
    let installed = folder.join("requirements.txt");
    let read = |path: &Path| fs::read_to_string(path).map_err(|error| format!("{}: {error}", path.display()));
    let text = read(&wanted)?;
    if read(&installed).is_ok_and(|installed| installed == text) {
        return Ok(python);
    }
    run(Command::new("python3").args(["-m", "venv", "--clear"]).arg(&folder))
        .map_err(|why| format!("{why}: install Python 3 with venv (Debian: `apt-get install python3-venv`)"))?;
    run(Command::new(&python).args(["-m", "pip", "install", "--quiet", "--requirement"]).arg(&wanted))?;
    fs::write(&installed, text).map_err(|error| format!("{}: {error}", installed.display()))?;
    Ok(python)
}
