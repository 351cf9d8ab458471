//! Runs Python programs of `tests`, each in its own virtual environment under `target/tools`, with the packages that it
//! requires.

use crate::{Failure, root, run};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Returns a command that runs a Python module in the folder `tests`, such as `virtual_board.soak`.
pub fn module(python: &Path, name: &str) -> Command {
    let mut command = Command::new(python);
    command.current_dir(root().join("tests")).env("PYTHONDONTWRITEBYTECODE", "1").args(["-m", name]);
    command
}

/// Returns the path of a Python interpreter with the packages of `tests/PACKAGE/requirements.txt`. The interpreter
/// belongs to the virtual environment `target/tools/NAME`, which is made again when that file has changed.
pub fn environment(name: &str, package: &str) -> Result<PathBuf, Failure> {
    let folder = root().join("target/tools").join(name);
    let python = folder.join("bin/python");
    let wanted = root().join("tests").join(package).join("requirements.txt");
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
