//! Shared by several test suites: reproducible random numbers, the numbers of a report, and temporary folders.

pub mod program;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};
use std::{env, fs, process};

/// A generator of pseudorandom numbers (xorshift, Marsaglia 2003): each seed other than 0 gives a fixed sequence.
pub struct Random(pub u64);

impl Random {
    fn bits(&mut self) -> u64 {
        self.0 ^= self.0 << 13;
        self.0 ^= self.0 >> 7;
        self.0 ^= self.0 << 17;
        self.0
    }

    /// Returns a number from 0 to `end` - 1.
    pub fn below(&mut self, end: u64) -> u64 {
        (self.bits() >> 11) % end
    }

    /// Returns one of the choices at random.
    pub fn of<'a>(&mut self, choices: &[&'a str]) -> &'a str {
        choices[self.below(choices.len() as u64) as usize]
    }
}

/// Returns the `N` numbers after `name:` in a report; `None` if there is no such field.
///
/// # Panics
/// If the field has anything but numbers, or too few of them.
pub fn numbers<const N: usize>(report: &str, name: &str) -> Option<[f64; N]> {
    let field =
        report.split(['<', '>', '[', ']', '|']).find_map(|field| field.strip_prefix(name)?.strip_prefix(':'))?;
    let mut values = field.split([':', ',']).map(|n| n.parse().expect("a number"));
    Some(std::array::from_fn(|_| values.next().expect("a number for each axis")))
}

/// Returns the inputs of a corpus: one per line, escaped as by [`u8::escape_ascii`].
///
/// # Panics
/// On an invalid escape.
pub fn unpack(text: &str) -> Vec<Vec<u8>> {
    text.lines()
        .map(|line| unescape(line).unwrap_or_else(|| panic!("{line:?} is not escaped as it should be")))
        .collect()
}

/// Returns the text of a corpus with these inputs: the inverse of [`unpack`].
pub fn pack(inputs: &[Vec<u8>]) -> String {
    inputs.iter().map(|input| format!("{}\n", input.escape_ascii())).collect()
}

fn unescape(line: &str) -> Option<Vec<u8>> {
    let mut bytes = line.bytes();
    let mut input = Vec::new();
    while let Some(byte) = bytes.next() {
        input.push(match byte {
            b'\\' => match bytes.next()? {
                b't' => b'\t',
                b'r' => b'\r',
                b'n' => b'\n',
                b'x' => {
                    let digits = [bytes.next()?, bytes.next()?];
                    u8::from_str_radix(std::str::from_utf8(&digits).ok()?, 16).ok()?
                }
                escaped @ (b'\\' | b'\'' | b'"') => escaped,
                _ => return None,
            },
            byte => byte,
        });
    }
    Some(input)
}

/// An empty temporary folder, deleted with its contents on drop.
pub struct Folder(PathBuf);

impl Folder {
    /// Creates an empty folder below the system's temporary folder.
    ///
    /// # Panics
    /// If the folder cannot be created.
    #[expect(clippy::new_without_default, reason = "a folder is made, not a value")]
    pub fn new() -> Self {
        static MADE: AtomicU32 = AtomicU32::new(0);
        let number = MADE.fetch_add(1, Ordering::Relaxed);
        let path = env::temp_dir().join(format!("oxmill-test-{}-{number}", process::id()));
        // An earlier process with the same ID can have left this folder behind.
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).expect("a folder");
        Self(path)
    }

    /// Returns the path of the folder. The folder exists until `self` is dropped.
    pub fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn folders_are_empty_and_go_away() {
    let (a, b) = (Folder::new(), Folder::new());
    fs::write(a.path().join("x"), "x").unwrap();
    assert_eq!(fs::read_dir(b.path()).unwrap().count(), 0);
    let path = a.path().to_owned();
    drop(a);
    assert!(!path.exists() && b.path().exists());
}

#[test]
fn any_input_is_packed_and_unpacked() {
    let inputs = vec![Vec::new(), (0..=255).collect(), b"G1 X1\n".to_vec()];
    assert_eq!(unpack(&pack(&inputs)), inputs);
}
