//! The flash image: the two settings sectors of a board, in memory or in a file, under the log that the boards use.
//!
//! A file is the sectors one after the other, 16 KiB each, as a probe would read them out. Every word that the log writes
//! goes to the file at once and alone, so whatever ends the process leaves what a power cut would leave. A power cut can
//! also be ordered: after so many words and erases, the next one is left half done and nothing is taken any more.

use anyhow::{Context, Result, anyhow, bail};
use oxmill_controller::messages::{Record, Store as Change};
use oxmill_store::{Flash, Log, Sector, StoreError};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{ErrorKind, Read as _, Seek, SeekFrom, Write as _};
use std::path::Path;
use std::sync::Arc;

/// Bytes of a sector on the boards.
const SECTOR: u32 = 16 * 1024;
const ERASED: u32 = u32::MAX;

/// The log in its flash.
#[derive(Clone, Debug)]
pub struct Store {
    log: Log<Image>,
}

impl Store {
    /// An empty store that ends with the process.
    pub fn in_memory() -> Self {
        Self::with_sectors_of(SECTOR)
    }

    /// The same with smaller sectors, which are full sooner.
    ///
    /// # Panics
    /// If a sector is too small for its own header.
    pub fn with_sectors_of(bytes: u32) -> Self {
        Self::power_up(Image::erased(bytes)).expect("memory takes everything while it has power")
    }

    /// The store in a file, which is locked as long as this one lives: what two of them write would be lost. A file that
    /// does not exist yet or has nothing in it becomes an empty store.
    pub fn open(path: &Path) -> Result<Self> {
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(path)
            .with_context(|| format!("cannot open the flash image {}", path.display()))?;
        match file.try_lock() {
            // Where files cannot be locked, this is as good as it gets.
            Ok(()) => {}
            Err(TryLockError::Error(error)) if error.kind() == ErrorKind::Unsupported => {}
            Err(TryLockError::WouldBlock) => bail!("the flash image {} is in use by another oxmill", path.display()),
            Err(TryLockError::Error(error)) => {
                return Err(error).with_context(|| format!("cannot lock the flash image {}", path.display()));
            }
        }
        let mut bytes = Vec::new();
        // One byte more than an image has tells that it is none.
        (&file)
            .take(2 * u64::from(SECTOR) + 1)
            .read_to_end(&mut bytes)
            .with_context(|| format!("cannot read the flash image {}", path.display()))?;
        if bytes.is_empty() {
            bytes = Self::in_memory().log.into_flash().bytes();
            if let Err(error) = file.write_all(&bytes) {
                // Half an image would be refused the next time.
                let _ = file.set_len(0);
                return Err(error).with_context(|| format!("cannot make the flash image {}", path.display()));
            }
        }
        let mut image = Image::from_bytes(&bytes)
            .with_context(|| format!("{} is not a flash image of this simulator", path.display()))?;
        image.file = Some(Arc::new(file));
        Self::power_up(image).map_err(|failure| anyhow!("the flash image {} cannot be used: {failure}", path.display()))
    }

    fn power_up(image: Image) -> Result<Self, Failure> {
        Ok(Self { log: Log::open(image)? })
    }

    /// The store as it is found when power comes back: the same flash, and no further cut.
    ///
    /// # Errors
    /// When the file cannot be written.
    pub fn power_cycled(&self) -> Result<Self> {
        let mut image = self.log.flash().clone();
        image.cut = None;
        image.gone = false;
        Self::power_up(image).map_err(|failure| anyhow!("{failure}"))
    }

    /// All records that count, as they are restored at power-up.
    pub fn records(&mut self) -> Vec<Record> {
        let mut records = Vec::new();
        // A file is read once, when it is opened.
        let _ = self.log.for_each(|record| records.push(record));
        records
    }

    /// Carries out a change. `Ok` means that it is safe.
    pub fn apply(&mut self, change: &Change) -> Result<()> {
        self.log.store(change).map_err(|error| match error {
            StoreError::Full => anyhow!("the flash is full"),
            StoreError::Flash(failure) => anyhow!("{failure}"),
        })?;
        self.log.flash().sync().context("cannot write the flash image")
    }

    /// Whether a sector should be erased when there is time.
    pub fn needs_erase(&self) -> bool {
        self.log.needs_erase()
    }

    /// Erases it.
    pub fn erase_ahead(&mut self) -> Result<()> {
        self.log.erase_spare().map_err(|failure| anyhow!("{failure}"))
    }

    /// Lets the power go after so many more operations: the next one is left half done. `torn` are the bits that a word
    /// written by it has got; with bit 0 set, an erase looks complete and is not.
    pub fn cut_power_after(&mut self, operations: u32, torn: u32) {
        let image = self.log.flash_mut();
        image.cut = Some(operations);
        image.torn = torn;
    }

    /// Whether the power is gone.
    pub fn power_is_gone(&self) -> bool {
        self.log.flash().gone
    }

    /// Words written and sectors erased so far.
    pub fn operations(&self) -> u32 {
        self.log.flash().operations
    }
}

/// Why the flash did not take something.
#[derive(Debug)]
pub enum Failure {
    /// The power went.
    PowerCut,
    /// The file could not be written.
    File(std::io::Error),
}

impl std::fmt::Display for Failure {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Failure::PowerCut => f.write_str("the power was cut"),
            Failure::File(error) => error.fmt(f),
        }
    }
}

/// Two sectors.
#[derive(Clone, Debug)]
struct Image {
    sectors: [Vec<u32>; 2],
    /// Shared, because a store that is cloned is still the same flash.
    file: Option<Arc<File>>,
    operations: u32,
    cut: Option<u32>,
    torn: u32,
    gone: bool,
}

impl Image {
    fn erased(sector: u32) -> Self {
        let words = vec![ERASED; sector as usize / 4];
        Self { sectors: [words.clone(), words], file: None, operations: 0, cut: None, torn: 0, gone: false }
    }

    /// Anything but an image that holds a log is refused rather than erased.
    fn from_bytes(bytes: &[u8]) -> Result<Self> {
        if bytes.len() != 2 * SECTOR as usize {
            bail!("it does not have {} bytes", 2 * SECTOR);
        }
        let mut image = Self::erased(SECTOR);
        let words = bytes.chunks_exact(4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
        for (slot, word) in image.sectors.iter_mut().flatten().zip(words) {
            *slot = word;
        }
        if !Log::is_in(&mut image).unwrap_or(false) {
            bail!("neither half of it holds a settings log");
        }
        Ok(image)
    }

    fn bytes(&self) -> Vec<u8> {
        self.sectors.iter().flatten().flat_map(|word| word.to_le_bytes()).collect()
    }

    fn words(&mut self, sector: Sector) -> &mut Vec<u32> {
        let [a, b] = &mut self.sectors;
        match sector {
            Sector::A => a,
            Sector::B => b,
        }
    }

    /// Counts an operation; whether there is power for it. Without power nothing happens at all.
    fn spend(&mut self) -> Result<bool, Failure> {
        if self.gone {
            return Err(Failure::PowerCut);
        }
        self.operations += 1;
        match &mut self.cut {
            Some(0) => self.gone = true,
            Some(left) => *left -= 1,
            None => {}
        }
        Ok(!self.gone)
    }

    fn keep(&self, sector: Sector, from: usize, words: &[u32]) -> Result<(), Failure> {
        let Some(mut file) = self.file.as_deref() else { return Ok(()) };
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let start = if sector == Sector::A { 0 } else { u64::from(SECTOR) };
        file.seek(SeekFrom::Start(start + 4 * from as u64)).and_then(|_| file.write_all(&bytes)).map_err(Failure::File)
    }

    fn sync(&self) -> std::io::Result<()> {
        self.file.as_ref().map_or(Ok(()), |file| file.sync_data())
    }
}

impl Flash for Image {
    type Error = Failure;

    fn sector_size(&self) -> u32 {
        4 * self.sectors[0].len() as u32
    }

    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, Failure> {
        Ok(self.words(sector)[address as usize / 4])
    }

    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), Failure> {
        let powered = self.spend()?;
        let torn = self.torn;
        let at = address as usize / 4;
        let slot = &mut self.words(sector)[at];
        // Programming clears bits and never sets one.
        *slot &= if powered { word } else { word | !torn };
        let now = *slot;
        self.keep(sector, at, &[now])?;
        if powered { Ok(()) } else { Err(Failure::PowerCut) }
    }

    fn erase(&mut self, sector: Sector) -> Result<(), Failure> {
        let powered = self.spend()?;
        let torn = self.torn;
        let words = self.words(sector);
        let upto = if powered || torn & 1 != 0 { words.len() } else { words.len() / 2 };
        words[..upto].fill(ERASED);
        let now = words.clone();
        self.keep(sector, 0, &now)?;
        if powered { Ok(()) } else { Err(Failure::PowerCut) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn record(key: u16, value: &[u8]) -> Record {
        Record { key, value: heapless::Vec::from_slice(value).unwrap() }
    }

    #[test]
    fn records_outlive_the_store() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.img");
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
        drop(store);
        let mut again = Store::open(&path).unwrap().records();
        again.sort_by_key(|r| r.key);
        assert_eq!(again, [record(5, b""), record(7, b"new"), record(300, &[0, 255])]);
        assert_eq!(fs::metadata(&path).unwrap().len(), 32 * 1024);
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing else is left behind");
    }

    #[test]
    fn a_file_is_at_each_moment_what_the_flash_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.img");
        let mut store = Store::open(&path).unwrap();
        store.erase_ahead().unwrap();
        store.apply(&Change::Put(record(7, b"old"))).unwrap();
        store.cut_power_after(2, 0x0F0F_0F0F);
        assert!(store.apply(&Change::Put(record(7, b"newer"))).is_err());
        assert!(store.power_is_gone());
        assert!(store.apply(&Change::Put(record(7, b"newer"))).is_err(), "without power nothing is taken");
        assert_eq!(fs::read(&path).unwrap(), store.log.flash().bytes());
        drop(store);
        assert_eq!(Store::open(&path).unwrap().records(), [record(7, b"old")]);
    }

    #[test]
    fn an_empty_file_is_an_erased_flash() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.img");
        fs::write(&path, []).unwrap();
        Store::open(&path).unwrap().apply(&Change::Put(record(7, b"new"))).unwrap();
        assert_eq!(Store::open(&path).unwrap().records(), [record(7, b"new")]);
    }

    #[test]
    fn a_file_is_the_flash_of_one_machine_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.img");
        let first = Store::open(&path).unwrap();
        let same = first.clone();
        drop(first);
        let refused = Store::open(&path).unwrap_err().to_string();
        assert!(refused.contains("in use by another oxmill"), "{refused}");
        drop(same);
        Store::open(&path).unwrap();
    }

    #[test]
    fn foreign_files_are_refused_and_not_overwritten() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flash.img");
        let image = vec![0x55_u8; 2 * SECTOR as usize];
        let too_long = vec![0xFF_u8; 2 * SECTOR as usize + 1];
        for bytes in [&b"G1 X1\n"[..], &image, &too_long] {
            fs::write(&path, bytes).unwrap();
            assert!(Store::open(&path).is_err(), "{} bytes", bytes.len());
            assert_eq!(fs::read(&path).unwrap(), bytes);
        }
    }
}
