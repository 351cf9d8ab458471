//! The flash image: the controller's stored records, kept in memory or in a file between runs.
//!
//! A file is text, a record a line: its key, a blank, its bytes in hexadecimal. Each write replaces the whole file by
//! rename, so a cut at any instant leaves the old contents or the new ones.

use anyhow::{Context, Result, bail};
use oxmill_controller::messages::{Record, Store as Change};
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{ErrorKind, Write as _};
use std::path::{Path, PathBuf};

const HEADER: &str = "oxmill store 1";

/// Records by key, in the order of the keys.
#[derive(Clone, Debug, Default)]
pub struct Store {
    records: BTreeMap<u16, Vec<u8>>,
    file: Option<PathBuf>,
}

impl Store {
    /// An empty store that ends with the process.
    pub fn in_memory() -> Self {
        Self::default()
    }

    /// The store in a file. A file that does not exist yet is an empty store.
    pub fn open(path: &Path) -> Result<Self> {
        let text = match fs::read_to_string(path) {
            Ok(text) => text,
            Err(error) if error.kind() == ErrorKind::NotFound => String::new(),
            Err(error) => return Err(error).with_context(|| format!("cannot read the store {}", path.display())),
        };
        let records = parse(&text).with_context(|| format!("{} is not a store of this simulator", path.display()))?;
        Ok(Self { records, file: Some(path.to_owned()) })
    }

    /// All records, as they are restored at power-up.
    pub fn records(&self) -> impl Iterator<Item = Record> + '_ {
        self.records
            .iter()
            .filter_map(|(key, value)| Some(Record { key: *key, value: heapless::Vec::from_slice(value).ok()? }))
    }

    /// Carries out a change. `Ok` means that it is safe.
    pub fn apply(&mut self, change: &Change) -> Result<()> {
        let mut changed = self.records.clone();
        match change {
            Change::Put(record) => {
                changed.insert(record.key, record.value.to_vec());
            }
            Change::Remove { from, until } => changed.retain(|key, _| !(*from..*until).contains(key)),
        }
        if let Some(path) = &self.file {
            replace(path, &print(&changed)).with_context(|| format!("cannot write the store {}", path.display()))?;
        }
        self.records = changed;
        Ok(())
    }
}

fn print(records: &BTreeMap<u16, Vec<u8>>) -> String {
    let mut text = format!("{HEADER}\n");
    for (key, value) in records {
        let hex = value.iter().fold(String::new(), |mut hex, byte| {
            let _ = write!(hex, "{byte:02x}");
            hex
        });
        let _ = writeln!(text, "{key} {hex}");
    }
    text
}

fn parse(text: &str) -> Result<BTreeMap<u16, Vec<u8>>> {
    let mut records = BTreeMap::new();
    if text.is_empty() {
        return Ok(records);
    }
    let mut lines = text.lines();
    if lines.next() != Some(HEADER) {
        bail!("its first line is not `{HEADER}`");
    }
    for (index, line) in lines.enumerate() {
        let record = line.split_once(' ').and_then(|(key, hex)| Some((key.parse().ok()?, bytes(hex)?)));
        let Some((key, value)) = record else { bail!("its line {} is damaged", index + 2) };
        records.insert(key, value);
    }
    Ok(records)
}

fn bytes(hex: &str) -> Option<Vec<u8>> {
    let limit = Record { key: 0, value: heapless::Vec::new() }.value.capacity();
    if !hex.is_ascii() || !hex.len().is_multiple_of(2) || hex.len() / 2 > limit {
        return None;
    }
    (0..hex.len()).step_by(2).map(|i| u8::from_str_radix(hex.get(i..i + 2)?, 16).ok()).collect()
}

fn replace(path: &Path, text: &str) -> std::io::Result<()> {
    let mut name = path.file_name().unwrap_or_default().to_owned();
    name.push(".new");
    let new = path.with_file_name(name);
    let mut file = File::create(&new)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()?;
    fs::rename(&new, path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(key: u16, value: &[u8]) -> Record {
        Record { key, value: heapless::Vec::from_slice(value).unwrap() }
    }

    #[test]
    fn records_outlive_the_store() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.txt");
        let mut store = Store::open(&path).unwrap();
        for change in [
            Change::Put(record(7, b"old")),
            Change::Put(record(300, &[0, 255])),
            Change::Put(record(7, b"new")),
            Change::Put(record(3, b"x")),
            Change::Put(record(4, b"x")),
            Change::Put(record(5, b"")),
            Change::Remove { from: 3, until: 5 },
        ] {
            store.apply(&change).unwrap();
        }
        let again: Vec<Record> = Store::open(&path).unwrap().records().collect();
        assert_eq!(again, [record(5, b""), record(7, b"new"), record(300, &[0, 255])]);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left behind");
    }

    #[test]
    fn damage_is_refused_and_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.txt");
        for text in ["G1 X1\n", "oxmill store 1\n7 abc\n", "oxmill store 1\n70000 00\n", "oxmill store 1\n7 zz\n"] {
            fs::write(&path, text).unwrap();
            assert!(Store::open(&path).is_err(), "{text}");
            assert_eq!(fs::read_to_string(&path).unwrap(), text);
        }
    }
}
