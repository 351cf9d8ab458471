//! Writes the generated programs of `examples/`: the same bytes on every machine, since all arithmetic is on integers.
//!
//! Each program has its own file below. [`writer`] formats the words and numbers of a line. The programs are plain
//! G-code for any Grbl 1.1. The jobs of the benchmark ([`bench`]) are written from here, too; their curves need `f64`.

pub mod bench;
mod pcb;
mod pocket;
mod relief;
mod writer;

use std::io::{Result, Write};

/// Names of the programs: the stems of their files in `examples/`.
pub const NAMES: &[&str] = &["pocket_mm", "pocket_inch", "relief", "pcb_isolation"];

/// Writes a program of `examples/` or a job of the benchmark. Returns `false`, without output, if none has this name.
///
/// # Errors
/// Errors of `out`.
pub fn generate(name: &str, out: &mut dyn Write) -> Result<bool> {
    match name {
        "pocket_mm" => pocket::millimetres(out)?,
        "pocket_inch" => pocket::inches(out)?,
        "relief" => relief::write(out)?,
        "pcb_isolation" => pcb::write(out)?,
        _ => return bench::generate(name, out),
    }
    Ok(true)
}
