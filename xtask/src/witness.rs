//! Runs the firmware on labwired, an emulator whose authors have never seen it (`tests/witness`), and says belief by belief what was
//! witnessed. The image differs from the one that is shipped in its target: labwired has neither the DSP instructions nor all of the
//! floating-point ones of a Cortex-M4F, so it is built for a Cortex-M3.

use crate::paths::cargo_for;
use crate::python::{environment, module};
use crate::{Failure, boards, root, run};
use std::fs;
use std::path::PathBuf;
use std::process::Command;

const TARGET: &str = "thumbv7m-none-eabi";
/// A Nucleo, whose host is at `USART2`, and a Black Pill, whose host is at `USART1` here.
const BOARDS: [&str; 2] = ["nucleo_f411re", "blackpill_f411"];

/// Every belief on both boards; or the faults, each of which has to be seen.
pub fn witness(options: &[&str]) -> Result<(), Failure> {
    require_target()?;
    let python = environment("witness", "witness")?;
    let mut failed = Vec::new();
    for board in BOARDS {
        let image = build(board)?;
        let folder = root().join("target/witness").join(board);
        if let Err(why) = run(module(&python, "witness").arg(board).arg(image).arg(folder).args(options)) {
            failed.push(format!("{board}: {why}"));
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("see above:\n{}", failed.join("\n"))) }
}

/// The firmware for a processor without those instructions.
fn build(board: &str) -> Result<PathBuf, Failure> {
    let profile = boards::FAST;
    run(cargo_for("build", profile, TARGET)?.args(["--locked", "--package", "oxmill-firmware", "--features", board]))?;
    let built = root().join("target").join(TARGET).join(profile).join("oxmill-firmware");
    // Every board links to the same name.
    let folder = root().join("target/witness");
    let path = folder.join(format!("{board}.elf"));
    let copy = fs::create_dir_all(&folder).and_then(|()| fs::copy(&built, &path));
    copy.map_err(|error| format!("{}: {error}", built.display()))?;
    Ok(path)
}

/// Sees to the standard library of the target.
fn require_target() -> Result<(), Failure> {
    let asked =
        Command::new("rustc").current_dir(root()).args(["--print", "target-libdir", "--target", TARGET]).output();
    let folder = asked.map_err(|error| format!("rustc cannot be started: {error}"))?.stdout;
    if PathBuf::from(String::from_utf8_lossy(&folder).trim()).is_dir() {
        return Ok(());
    }
    run(Command::new("rustup").current_dir(root()).args(["target", "add", TARGET]))
        .map_err(|why| format!("{why}: the firmware is built for {TARGET} here, whose library is missing"))
}
