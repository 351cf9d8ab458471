//! Archives (tar, packed with gzip) whose bytes depend only on their contents: sorted by name, without times and
//! owners.

use super::{Failure, read};
use flate2::{Compression, GzBuilder};
use std::fs;
use std::io::Write;
use std::path::Path;

/// A file that is packed into an archive: its path in the archive, its permissions and its contents.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    name: String,
    mode: u32,
    bytes: Vec<u8>,
}

impl Entry {
    /// Returns an entry for a file that is not executable, whether it is text or not.
    pub fn text(name: &str, bytes: Vec<u8>) -> Entry {
        Entry { name: name.into(), mode: 0o644, bytes }
    }

    pub fn program(name: &str, bytes: Vec<u8>) -> Entry {
        Entry { name: name.into(), mode: 0o755, bytes }
    }

    /// Returns the file's path in the archive, without the archive's top folder.
    pub fn name(&self) -> &str {
        &self.name
    }
}

/// Returns an entry for each file below a folder, named by its path in the folder.
pub fn tree(folder: &Path) -> Result<Vec<Entry>, Failure> {
    let mut entries = Vec::new();
    collect(folder, "", &mut entries)?;
    Ok(entries)
}

fn collect(folder: &Path, before: &str, entries: &mut Vec<Entry>) -> Result<(), Failure> {
    for entry in fs::read_dir(folder).map_err(|error| format!("{}: {error}", folder.display()))?.flatten() {
        let name = format!("{before}{}", entry.file_name().to_string_lossy());
        if entry.path().is_dir() {
            collect(&entry.path(), &format!("{name}/"), entries)?;
        } else {
            entries.push(Entry::text(&name, read(&entry.path())?));
        }
    }
    Ok(())
}

/// Returns the packed archive, in which all files are in a folder named `folder`.
pub fn packed(folder: &str, mut entries: Vec<Entry>) -> Result<Vec<u8>, Failure> {
    entries.sort_by(|a, b| a.name.cmp(&b.name));
    let failed = |error: std::io::Error| format!("{folder}: {error}");
    let mut tar = tar::Builder::new(Vec::new());
    for entry in &entries {
        let mut header = tar::Header::new_gnu();
        header.set_size(entry.bytes.len() as u64);
        header.set_mode(entry.mode);
        header.set_mtime(0);
        header.set_uid(0);
        header.set_gid(0);
        tar.append_data(&mut header, format!("{folder}/{}", entry.name), &entry.bytes[..]).map_err(failed)?;
    }
    let tar = tar.into_inner().map_err(failed)?;
    // `GzBuilder` writes the time 0 into the header if it gets no other.
    let mut gzip = GzBuilder::new().write(Vec::new(), Compression::best());
    gzip.write_all(&tar).map_err(failed)?;
    gzip.finish().map_err(failed)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;

    #[test]
    fn an_archive_depends_on_nothing_but_its_contents() {
        let entries = vec![
            Entry::program("b", b"run".to_vec()),
            Entry::text("a/long", b"words ".repeat(1000)),
            Entry::text("c", vec![]),
        ];
        let archive = packed("x-1", entries.clone()).unwrap();
        assert_eq!(archive[4..8], [0; 4], "the time");
        let reversed = packed("x-1", entries.iter().rev().cloned().collect()).unwrap();
        assert_eq!(archive, reversed);
        let mut tar = tar::Archive::new(flate2::read::GzDecoder::new(&archive[..]));
        let mut found = Vec::new();
        for entry in tar.entries().unwrap() {
            let mut entry = entry.unwrap();
            let mut bytes = Vec::new();
            entry.read_to_end(&mut bytes).unwrap();
            let header = entry.header();
            assert_eq!((header.mtime().unwrap(), header.uid().unwrap(), header.gid().unwrap()), (0, 0, 0));
            let name = entry.path().unwrap().to_string_lossy().into_owned();
            found.push(Entry { name, mode: entry.header().mode().unwrap(), bytes });
        }
        let mut wanted = entries;
        wanted.sort_by(|a, b| a.name.cmp(&b.name));
        for entry in &mut wanted {
            entry.name.insert_str(0, "x-1/");
        }
        assert_eq!(found, wanted);
    }
}
