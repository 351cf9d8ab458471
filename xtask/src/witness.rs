//! Runs the firmware on labwired, an independent emulator (`tests/witness`). A belief is a fact about the hardware on
//! which the firmware relies. For each belief, prints if it was confirmed. The firmware is built for a Cortex-M3 here,
//! because labwired lacks some instructions of a Cortex-M4F (DSP, and part of floating point).

use crate::paths::cargo_for;
use crate::python::{environment, module};
use crate::{Failure, boards, root, run};
use std::fs;
use std::path::PathBuf;
use std::process::Command;

const TARGET: &str = "thumbv7m-none-eabi";
/// A Nucleo with its host on `USART2`, and a Black Pill with its host on `USART1` (not on USB). The numbers are the
/// frequency of the oscillator in MHz, and a wrong frequency. The frequency is written into the image, because labwired
/// does not model the timer with which the firmware measures it. An image with the wrong frequency is a fault that the
/// checks must detect.
const BOARDS: [(&str, u8, u8); 2] = [("nucleo_f411re", 8, 25), ("blackpill_f411", 25, 8)];

/// Checks every belief (a fact about the hardware on which the firmware relies) on both boards. With the option
/// `--faults`, puts faults into the image; each of them must be detected.
pub fn witness(options: &[&str]) -> Result<(), Failure> {
    require_target()?;
    let python = environment("witness", "witness")?;
    let mut failed = Vec::new();
    for (board, mhz, wrong_mhz) in BOARDS {
        let image = build(board, mhz, wrong_mhz)?;
        let folder = root().join("target/witness").join(board);
        if let Err(why) = run(module(&python, "witness").arg(board).arg(image).arg(folder).args(options)) {
            failed.push(format!("{board}: {why}"));
        }
    }
    if failed.is_empty() { Ok(()) } else { Err(format!("see above:\n{}", failed.join("\n"))) }
}

/// Builds the firmware for a Cortex-M3, with the frequency of its oscillator in its pin table; returns the path of the
/// ELF file. Beside it is a file `BOARD-crystal.elf` with the wrong frequency.
fn build(board: &str, mhz: u8, wrong_mhz: u8) -> Result<PathBuf, Failure> {
    let profile = boards::FAST;
    run(cargo_for("build", profile, TARGET)?.args(["--locked", "--package", "oxmill-firmware", "--features", board]))?;
    let built = root().join("target").join(TARGET).join(profile).join("oxmill-firmware");
    // Every board links to the same file name, so each board's image is copied to a name of its own.
    let folder = root().join("target/witness");
    let fail = |error: std::io::Error| format!("{}: {error}", built.display());
    let image = fs::create_dir_all(&folder).and_then(|()| fs::read(&built)).map_err(fail)?;
    for (ending, mhz) in [("", mhz), ("-crystal", wrong_mhz)] {
        let described = oxmill_tables::Board { oscillator_mhz: Some(mhz), ..boards::described(board)? };
        let image = oxmill_tables::image_file::write(&image, &described.table())?;
        fs::write(folder.join(format!("{board}{ending}.elf")), image).map_err(fail)?;
    }
    Ok(folder.join(format!("{board}.elf")))
}

/// Installs the target's standard library with rustup if it is missing.
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
