//! Files are read with a bound: a device or a pipe may have no end.

use std::fs::File;
use std::io::{self, Read};
use std::path::Path;

/// Longest file of text that somebody has written for a machine: settings, a description.
pub const TEXT: usize = 1 << 20;

/// Reads a whole file of at most so many bytes.
///
/// # Errors
/// If it cannot be read or is longer.
pub fn read(path: &Path, most: usize) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    File::open(path)?.take(most as u64 + 1).read_to_end(&mut bytes)?;
    if bytes.len() > most {
        return Err(io::Error::other(format!("it has more than {most} bytes")));
    }
    Ok(bytes)
}
