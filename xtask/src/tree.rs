//! Copies of the source tree, for builds with modified files.

use crate::Failure;
use std::fs;
use std::path::Path;

/// Makes `to` a copy of the file or folder `from`. Writes only files that differ, so that cargo does not rebuild the
/// rest. Deletes files that `from` does not have, and leaves out `node_modules`.
pub fn copy(from: &Path, to: &Path) -> Result<(), Failure> {
    let failure = |error: std::io::Error| format!("{}: {error}", from.display());
    if from.is_dir() {
        fs::create_dir_all(to).map_err(failure)?;
        for entry in fs::read_dir(to).map_err(failure)? {
            let entry = entry.map_err(failure)?;
            if !from.join(entry.file_name()).exists() {
                let path = entry.path();
                if path.is_dir() { fs::remove_dir_all(path) } else { fs::remove_file(path) }.map_err(failure)?;
            }
        }
        for entry in fs::read_dir(from).map_err(failure)? {
            let entry = entry.map_err(failure)?;
            if entry.file_name() == "node_modules" {
                continue;
            }
            copy(&entry.path(), &to.join(entry.file_name()))?;
        }
        return Ok(());
    }
    let wanted = fs::read(from).map_err(failure)?;
    if fs::read(to).is_ok_and(|there| there == wanted) {
        return Ok(());
    }
    fs::write(to, wanted).map_err(failure)
}
