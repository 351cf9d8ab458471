//! The settings store of a simulated board: the boards' own log, on two flash sectors in memory. Every written word can
//! also be passed to a copy, such as a file.
//!
//! The copy gets every word as soon as it is written. So if the process is killed, the copy is like a flash after a
//! power cut. A power cut can also be ordered: after a given number of writes and erases, the next operation is left
//! half done, and all further ones fail.

use anyhow::{Context, Result, anyhow, bail};
use oxmill_controller::messages::{Record, Store as Change};
use oxmill_store::{Flash, Log, Sector, StoreError};
use std::fmt;
use std::sync::Arc;

/// Size of a sector on the boards, in bytes.
const SECTOR: u32 = 16 * 1024;
/// Size in bytes of a file that holds the simulated flash memory for settings: both sectors.
pub const IMAGE: usize = 2 * SECTOR as usize;
const ERASED: u32 = u32::MAX;

/// A change of the image, or the request to make all changes durable.
#[derive(Clone, Copy, Debug)]
pub enum Kept<'a> {
    /// Some bytes of the image have changed. Contains the offset of the first of them, in bytes, and their new values.
    Bytes(usize, &'a [u8]),
    /// All changes so far must be made durable.
    Sync,
}

/// A function that receives every change of the image, to keep a copy of it.
pub type Keep = Arc<dyn Fn(Kept<'_>) -> std::io::Result<()> + Send + Sync>;

/// Why an image cannot be used.
#[derive(Debug)]
pub enum Unusable {
    /// The bytes are not a flash image with a settings log.
    Foreign(anyhow::Error),
    /// The image contains a settings log, but opening the log has failed.
    Log(Failure),
}

/// The settings log, with the flash image that contains it.
#[derive(Clone, Debug)]
pub struct Store {
    log: Log<Image>,
}

impl Store {
    /// Makes an empty store in memory; its contents are lost when it is dropped.
    pub fn in_memory() -> Self {
        Self::with_sectors_of(SECTOR)
    }

    /// Makes an empty store in memory, with sectors of `bytes` bytes each. Small sectors are full after few changes, so
    /// tests soon reach the move to the other sector.
    ///
    /// # Panics
    /// If a sector is too small for its own header.
    pub fn with_sectors_of(bytes: u32) -> Self {
        Self::power_up(Image::erased(bytes)).expect("memory takes everything while it has power")
    }

    /// Opens the store in an image of which the caller keeps a copy; `keep` receives every change.
    ///
    /// # Errors
    /// If the bytes are not a flash image, or the log in it cannot be read.
    pub fn kept(bytes: &[u8], keep: Keep) -> Result<Self, Unusable> {
        let mut image = Image::from_bytes(bytes).map_err(Unusable::Foreign)?;
        image.keep = Some(keep);
        Self::power_up(image).map_err(Unusable::Log)
    }

    /// Returns the bytes of an image with an empty log, for a new file.
    pub fn blank() -> Vec<u8> {
        Self::in_memory().log.into_flash().bytes()
    }

    fn power_up(image: Image) -> Result<Self, Failure> {
        Ok(Self { log: Log::open(image)? })
    }

    /// Returns the store as it is after a power cycle: with the same flash, and without the power cut of
    /// [`Store::cut_power_after`].
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn power_cycled(&self) -> Result<Self> {
        let mut image = self.log.flash().clone();
        image.cut = None;
        image.gone = false;
        Self::power_up(image).map_err(|failure| anyhow!("{failure}"))
    }

    /// Returns a copy in memory only: its changes do not reach the file of the original (see [`Store::kept`]).
    ///
    /// # Errors
    /// If the log cannot be read.
    pub fn apart(&self) -> Result<Self> {
        let mut image = self.log.flash().clone();
        image.keep = None;
        Self::power_up(image).map_err(|failure| anyhow!("{failure}"))
    }

    /// Returns all valid records, as restored at power-up.
    pub fn records(&mut self) -> Vec<Record> {
        let mut records = Vec::new();
        // The image is in memory, so this cannot fail: a file is read only when it is opened.
        let _ = self.log.for_each(|record| records.push(record));
        records
    }

    /// Stores a change. `Ok` means that it is durable.
    pub fn apply(&mut self, change: &Change) -> Result<()> {
        self.log.store(change).map_err(|error| match error {
            StoreError::Full => anyhow!("the flash is full"),
            StoreError::Flash(failure) => anyhow!("{failure}"),
        })?;
        self.log.flash().sync().context("cannot write the flash image")
    }

    /// Returns whether the spare sector should be erased at the next opportunity ([`Store::erase_ahead`]).
    pub fn needs_erase(&self) -> bool {
        self.log.needs_erase()
    }

    /// Erases the spare sector, so that no later write has to wait for an erase.
    pub fn erase_ahead(&mut self) -> Result<()> {
        self.log.erase_spare().map_err(|failure| anyhow!("{failure}"))
    }

    /// Orders a power cut: `operations` more operations succeed, and the next one is left half done. `torn`: mask of
    /// the bits that an interrupted word write still programs. Bit 0 of `torn` also decides about an interrupted erase:
    /// if it is set, the whole sector is erased, otherwise only half of it. In both cases the operation fails.
    pub fn cut_power_after(&mut self, operations: u32, torn: u32) {
        let image = self.log.flash_mut();
        image.cut = Some(operations);
        image.torn = torn;
    }

    /// Returns whether the power cut ordered with [`Store::cut_power_after`] has happened.
    pub fn power_is_gone(&self) -> bool {
        self.log.flash().gone
    }

    /// The bytes of both sectors, one after the other.
    pub fn image(&self) -> Vec<u8> {
        self.log.flash().bytes()
    }

    /// Number of words written and sectors erased so far.
    pub fn operations(&self) -> u32 {
        self.log.flash().operations
    }
}

/// Why a flash operation failed.
#[derive(Debug)]
pub enum Failure {
    /// The power was cut.
    PowerCut,
    /// The copy of the flash (see [`Store::kept`]) could not be written.
    Copy(std::io::Error),
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Failure::PowerCut => f.write_str("the power was cut"),
            Failure::Copy(error) => error.fmt(f),
        }
    }
}

/// The simulated flash: the words of both sectors, and the power cut of [`Store::cut_power_after`].
#[derive(Clone)]
struct Image {
    sectors: [Vec<u32>; 2],
    /// Receives every change. Clones of the image share this function, because a cloned store represents the same
    /// flash.
    keep: Option<Keep>,
    operations: u32,
    cut: Option<u32>,
    torn: u32,
    gone: bool,
}

impl fmt::Debug for Image {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Image").field("operations", &self.operations).field("gone", &self.gone).finish_non_exhaustive()
    }
}

impl Image {
    fn erased(sector: u32) -> Self {
        let words = vec![ERASED; sector as usize / 4];
        Self { sectors: [words.clone(), words], keep: None, operations: 0, cut: None, torn: 0, gone: false }
    }

    /// Reads an image. Rejects bytes that contain no log, because opening a log there would erase them.
    fn from_bytes(bytes: &[u8]) -> Result<Self> {
        if bytes.len() != IMAGE {
            bail!("it does not have {IMAGE} bytes");
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

    /// Counts an operation. Returns whether there is power for the whole operation. Fails if the power was cut before
    /// it.
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

    fn tell(&self, sector: Sector, from: usize, words: &[u32]) -> Result<(), Failure> {
        let Some(keep) = &self.keep else { return Ok(()) };
        let bytes: Vec<u8> = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let start = if sector == Sector::A { 0 } else { 4 * self.sectors[0].len() };
        keep(Kept::Bytes(start + 4 * from, &bytes)).map_err(Failure::Copy)
    }

    fn sync(&self) -> std::io::Result<()> {
        self.keep.as_ref().map_or(Ok(()), |keep| keep(Kept::Sync))
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
        // A write to flash can only clear bits. If the power is cut during the write, only the bits in `torn` are
        // cleared.
        *slot &= if powered { word } else { word | !torn };
        let now = *slot;
        self.tell(sector, at, &[now])?;
        if powered { Ok(()) } else { Err(Failure::PowerCut) }
    }

    fn erase(&mut self, sector: Sector) -> Result<(), Failure> {
        let powered = self.spend()?;
        let torn = self.torn;
        let words = self.words(sector);
        let upto = if powered || torn & 1 != 0 { words.len() } else { words.len() / 2 };
        words[..upto].fill(ERASED);
        let now = words.clone();
        self.tell(sector, 0, &now)?;
        if powered { Ok(()) } else { Err(Failure::PowerCut) }
    }
}
