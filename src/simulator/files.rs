//! The files of a run. A file that the run also reads is never overwritten; symbolic links are followed. Every output
//! file is opened and locked before the machine starts. If nothing was written, a new output file is removed again.
//! Input files that are read whole have a maximum size, because a device or a pipe can be endless.

use crate::file_kind;
use crate::fittings::Fittings;
use anyhow::{Context, Result, bail};
use std::ffi::OsString;
use std::fs::{self, File, OpenOptions, TryLockError};
use std::io::{self, BufRead, Read, Write};
use std::path::{Path, PathBuf};

/// Maximum number of symbolic links that are followed to a file that does not exist yet.
const MOST_LINKS: usize = 40;

/// Maximum size of a hand-written text file (settings, machine description), in bytes.
pub const TEXT: usize = 1 << 20;

/// Reads a whole file of at most `most` bytes.
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

/// Opens a text file, or standard input if the path is `-`. Also returns its length in bytes, if known.
///
/// # Errors
/// If it cannot be read, or is not a text file.
pub fn open_text(path: &Path) -> io::Result<(Box<dyn BufRead>, Option<u64>)> {
    if path.as_os_str() == "-" {
        let mut reader = io::BufReader::new(io::stdin());
        let begin = begin_of(&mut reader)?;
        file_kind::refuse(begin, begin.is_empty()).map_err(io::Error::other)?;
        return Ok((Box::new(reader), None));
    }
    let file = File::open(path)?;
    let about = file.metadata()?;
    if about.is_dir() {
        return Err(io::Error::other("it is a folder"));
    }
    let length = about.is_file().then_some(about.len());
    let mut reader = io::BufReader::with_capacity(1 << 16, file);
    // Detect an unreadable or non-text file before the machine starts.
    let begin = begin_of(&mut reader)?;
    let is_all = begin.is_empty() || length == Some(begin.len() as u64);
    file_kind::refuse(begin, is_all).map_err(io::Error::other)?;
    Ok((Box::new(reader.take(u64::MAX)), length))
}

/// Returns the first bytes of `reader` without consuming them; empty if there are none.
fn begin_of(reader: &mut impl BufRead) -> io::Result<&[u8]> {
    while let Err(error) = reader.fill_buf() {
        if error.kind() != io::ErrorKind::Interrupted {
            return Err(error);
        }
    }
    reader.fill_buf()
}

/// Writes `bytes` to standard output. A reader that has closed the pipe, such as `head`, is not an error.
///
/// # Errors
/// If it cannot be written.
pub fn print(mut out: impl Write, bytes: &[u8]) -> io::Result<()> {
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => Ok(()),
        written => written,
    }
}

/// Writes a line for the user to standard error; ignores a write error. Control characters are replaced, as file names
/// may contain terminal escape sequences.
pub fn eprint_line(text: &str) {
    let _ = writeln!(io::stderr(), "{}", text.replace(|c: char| c.is_control() && c != '\n', "?"));
}

/// Locks a file while it is open, because two programs that write into it would lose data.
///
/// # Errors
/// If another process has locked the file.
pub fn lock(file: &File) -> io::Result<()> {
    match file.try_lock() {
        Ok(()) => Ok(()),
        // A file system without locks is not an error.
        Err(TryLockError::Error(error)) if error.kind() == io::ErrorKind::Unsupported => Ok(()),
        Err(TryLockError::WouldBlock) => Err(io::Error::other("it is in use by another oxmill")),
        Err(TryLockError::Error(error)) => Err(error),
    }
}

/// Returns text without a byte order mark, which some editors write at the beginning.
pub fn without_mark(text: &str) -> &str {
    text.strip_prefix('\u{FEFF}').unwrap_or(text)
}

/// Reads the description of a machine (`--machine`). Returns its hardware (switches, probe plate and so on) and the
/// text of the file.
///
/// # Errors
/// If it cannot be read or understood.
pub fn read_machine(path: &Path) -> Result<(Fittings, String)> {
    let text = read(path, TEXT)
        .and_then(|bytes| file_kind::refuse(&bytes, false).map(|()| bytes).map_err(io::Error::other))
        .and_then(|bytes| String::from_utf8(bytes).map_err(io::Error::other))
        .with_context(|| format!("cannot read {}", path.display()))?;
    let fittings = Fittings::parse(&text).with_context(|| format!("{} does not describe a machine", path.display()))?;
    Ok((fittings, text))
}

/// A file, and what a run uses it for.
#[derive(Clone, Copy, Debug)]
pub struct Role<'a> {
    /// Path of the file.
    pub path: &'a Path,
    /// What the file is, as error messages name it: `the job`, `--output` and so on.
    pub name: &'static str,
    /// `true` if the run writes the file; `false` if it only reads the file.
    pub written: bool,
}

/// Checks that no file would overwrite another; fails if one would. Two paths that lead to one file by links are the
/// same file.
pub fn check_apart(files: &[Role]) -> Result<()> {
    let places: Vec<Place> = files.iter().map(|file| Place::of(file.path)).collect();
    for (index, (file, place)) in files.iter().zip(&places).enumerate() {
        for (other, other_place) in files.iter().zip(&places).take(index) {
            if (file.written || other.written) && place.is(other_place) {
                let (path, name, other_name) = (file.path.display(), file.name, other.name);
                bail!("{path} cannot be both {other_name} and {name}: one would be written over the other");
            }
        }
    }
    Ok(())
}

/// The file that a path leads to.
#[derive(Debug)]
struct Place {
    path: Option<PathBuf>,
    /// Device and inode number; `None` if the file does not exist, or if the system has no such numbers.
    file: Option<(u64, u64)>,
    /// `true` for a device, a pipe or the like, which a run may both read and write.
    special: bool,
}

impl Place {
    fn of(path: &Path) -> Self {
        match fs::metadata(path) {
            Ok(about) => Self { path: path.canonicalize().ok(), file: number(&about), special: !about.is_file() },
            Err(_) => Self { path: future(path), file: None, special: false },
        }
    }

    fn is(&self, other: &Place) -> bool {
        let same_path = self.path.is_some() && self.path == other.path;
        let same_file = self.file.is_some() && self.file == other.file;
        !self.special && !other.special && (same_path || same_file)
    }
}

#[cfg(unix)]
fn number(about: &fs::Metadata) -> Option<(u64, u64)> {
    use std::os::unix::fs::MetadataExt;
    Some((about.dev(), about.ino()))
}

#[cfg(not(unix))]
fn number(_: &fs::Metadata) -> Option<(u64, u64)> {
    None
}

/// Returns the path at which a file that does not exist yet would be created, with all links resolved.
fn future(path: &Path) -> Option<PathBuf> {
    let mut path = path.to_path_buf();
    for _ in 0..MOST_LINKS {
        let name: OsString = path.file_name()?.into();
        let folder = match path.parent() {
            Some(folder) if folder != Path::new("") => folder.canonicalize().ok()?,
            _ => Path::new(".").canonicalize().ok()?,
        };
        match fs::read_link(&path) {
            Ok(target) => path = folder.join(target),
            Err(_) => return Some(folder.join(name)),
        }
    }
    None
}

/// An output file. It is opened before the work, so that an unwritable file is detected early, and keeps its content
/// until it is written. A file that was created here but never written is removed.
#[derive(Debug)]
pub struct Output {
    path: PathBuf,
    file: Option<File>,
    made: bool,
}

impl Output {
    /// Opens the file, creating it if necessary, and locks it against other programs.
    pub fn open(path: &Path) -> io::Result<Self> {
        let made = fs::symlink_metadata(path).is_err();
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(path)?;
        if file.metadata()?.is_file() {
            lock(&file)?;
        }
        Ok(Self { path: path.to_path_buf(), file: Some(file), made })
    }

    /// Empties the file and returns it for writing.
    pub fn begin(mut self) -> io::Result<File> {
        let file = self.file.take().ok_or(io::ErrorKind::NotFound)?;
        if file.metadata()?.is_file() {
            file.set_len(0)?;
        }
        Ok(file)
    }

    /// Replaces the content of the file.
    pub fn write(self, bytes: &[u8]) -> Result<()> {
        let path = self.path.clone();
        let mut file = self.begin().with_context(|| format!("cannot write {}", path.display()))?;
        file.write_all(bytes).and_then(|()| file.flush()).with_context(|| format!("cannot write {}", path.display()))
    }

    /// The path of the file.
    pub fn path(&self) -> &Path {
        &self.path
    }
}

impl Drop for Output {
    fn drop(&mut self) {
        if self.made && self.file.is_some() {
            // If this fails, nothing is lost: the file is empty.
            let _ = fs::remove_file(&self.path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_test_support::Folder;

    fn role(path: &Path, written: bool) -> Role<'_> {
        Role { path, name: "a file", written }
    }

    fn apart(a: &Path, b: &Path) -> bool {
        check_apart(&[role(a, false), role(b, true)]).is_ok()
    }

    #[test]
    fn one_file_by_several_names_is_one() {
        let folder = Folder::new();
        let [a, b, new] = ["a", "b", "new"].map(|name| folder.path().join(name));
        fs::write(&a, "a").unwrap();
        fs::write(&b, "b").unwrap();
        assert!(apart(&a, &b) && apart(&a, &new));
        assert!(!apart(&a, &a) && !apart(&new, &new));
        assert!(!apart(&a, &folder.path().join(".").join("a")));
        assert!(!apart(&new, &folder.path().join(".").join("new")));
        assert!(check_apart(&[role(&a, false), role(&a, false)]).is_ok(), "two readers do no harm");
    }

    #[cfg(unix)]
    #[test]
    fn links_lead_to_the_file() {
        let folder = Folder::new();
        let [a, soft, hard, new, ahead] = ["a", "soft", "hard", "new", "ahead"].map(|name| folder.path().join(name));
        fs::write(&a, "a").unwrap();
        std::os::unix::fs::symlink("a", &soft).unwrap();
        fs::hard_link(&a, &hard).unwrap();
        std::os::unix::fs::symlink("new", &ahead).unwrap();
        assert!(!apart(&a, &soft) && !apart(&a, &hard) && !apart(&soft, &hard));
        assert!(!apart(&new, &ahead), "neither exists");
        assert!(apart(Path::new("/dev/null"), Path::new("/dev/null")), "a device is not written over");
    }

    #[test]
    fn an_output_keeps_what_it_has_until_it_is_written() {
        let folder = Folder::new();
        let [old, new] = ["old", "new"].map(|name| folder.path().join(name));
        fs::write(&old, "as it was").unwrap();
        drop((Output::open(&old).unwrap(), Output::open(&new).unwrap()));
        assert_eq!(fs::read_to_string(&old).unwrap(), "as it was");
        assert!(!new.exists());
        Output::open(&old).unwrap().write(b"now").unwrap();
        assert_eq!(fs::read_to_string(&old).unwrap(), "now");
        let first = Output::open(&old).unwrap();
        let second = Output::open(&old).unwrap_err();
        assert!(second.to_string().contains("in use by another oxmill"), "{second}");
        let file = first.begin().unwrap();
        assert!(Output::open(&old).is_err());
        drop(file);
        assert!(Output::open(&old).is_ok());
        assert!(Output::open(folder.path()).is_err());
        assert!(Output::open(&folder.path().join("none").join("x")).is_err());
    }
}
