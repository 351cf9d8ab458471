//! Writes the generated programs of `examples/`: the same bytes on every machine, since all arithmetic is on integers.
//!
//! Each program has its own file below; [`writer`] formats the words and numbers of a line. Nothing here depends on the
//! controller: the programs are plain G-code for any Grbl 1.1.

pub mod bench;
mod pcb;
mod pocket;
mod relief;
mod writer;

use std::io::{Result, Write};

/// The programs that [`generate`] can write, by the stem of their file in `examples/`.
pub const NAMES: &[&str] = &["pocket_mm", "pocket_inch", "relief", "pcb_isolation"];

/// Writes one program. Returns `false`, without output, if there is no program of this name.
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
