//! Settings that survive a power cut at any moment: an append-only log of records in two flash sectors.
//!
//! ```text
//!  sector  ┌───────┬────────┬────────┬────────┬───────────┐
//!          │ header│ record │ record │ record │ erased ...│
//!          └───────┴────────┴────────┴────────┴───────────┘
//!  header  sequence · crc(sequence) · mark       mark: the erase came to its end; sequence and crc are written last when
//!                                                a sector has been filled by a move
//!  record  kind, length, key · value · crc       the crc is written last: without it the record does not exist
//! ```
//! The valid sector with the higher sequence counts; the last record of a key counts. When it is full, the records that
//! count are copied into the other sector, which becomes valid with its last word, and only then is the old one of no
//! more use. So at each moment one sector holds all settings, old or new. Erasing deafens the processor (hundreds of
//! milliseconds on these parts), so it is never done in the course of a write: [`Log::needs_erase`] says when the spare
//! sector should be erased, and the owner does it while nothing moves ([`Log::erase_spare`]). Cells of an erase that was
//! cut short may read as ones and still not hold what is written to them; so a sector without its mark is erased again.
//!
//! A change is one record, so a change is atomic; who wants two things to change together gives them one key or a range.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

use oxmill_controller::messages::{Record, Store};

/// A flash memory of two sectors. Addresses are bytes from the start of a sector, multiples of 4.
pub trait Flash {
    /// What can go wrong.
    type Error;
    /// Bytes of a sector.
    fn sector_size(&self) -> u32;
    /// Reads a word.
    ///
    /// # Errors
    /// If the memory cannot be read.
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, Self::Error>;
    /// Programs a word that is erased (all ones).
    ///
    /// # Errors
    /// If the memory does not take it.
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), Self::Error>;
    /// Sets a whole sector to ones.
    ///
    /// # Errors
    /// If the memory does not do it.
    fn erase(&mut self, sector: Sector) -> Result<(), Self::Error>;
}

/// One of the two sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sector {
    /// The first.
    A,
    /// The second.
    B,
}

impl Sector {
    const fn other(self) -> Sector {
        match self {
            Sector::A => Sector::B,
            Sector::B => Sector::A,
        }
    }
}

/// Why something could not be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError<E> {
    /// The flash memory failed.
    Flash(E),
    /// The log is full, and the spare sector has not been erased (or the live records alone fill a sector).
    Full,
}

impl<E> From<E> for StoreError<E> {
    fn from(error: E) -> Self {
        StoreError::Flash(error)
    }
}

/// Room that is kept for what is stored while an erase has to wait: some forty settings.
const RESERVE: u32 = 1024;
const ERASED: u32 = u32::MAX;
/// Bytes of a sector's header: sequence, its crc, the mark of a completed erase.
const HEADER: u32 = 12;
/// Where the mark stands, and what it is.
const MARK_AT: u32 = 8;
const MARK: u32 = u32::from_le_bytes(*b"wipe");
/// Bytes of the longest value.
const LONGEST: u32 = 100;
/// Kinds of record; both differ from erased and zeroed memory in several bits.
const PUT: u8 = 0xA5;
const REMOVE: u8 = 0x5A;

/// The log. One owner; every change is complete in flash when the call returns.
#[derive(Clone, Debug)]
pub struct Log<F> {
    flash: F,
    sector: Sector,
    sequence: u32,
    /// Behind the last record that counts: all before it has been checked or written.
    end: u32,
    /// What follows is erased, so the next record may be appended.
    appendable: bool,
    /// The spare sector holds its mark and nothing else.
    spare_erased: bool,
}

/// CRC-32 (IEEE 802.3, reflected, polynomial 0xEDB88320) over whole words, bit by bit: rare and small.
fn crc(start: u32, words: &[u32]) -> u32 {
    let mut crc = start;
    for word in words {
        crc ^= word;
        for _ in 0..32 {
            crc = if crc & 1 == 0 { crc >> 1 } else { (crc >> 1) ^ 0xEDB8_8320 };
        }
    }
    crc
}

/// A record as it stands in flash.
#[derive(Clone, Debug)]
struct Entry {
    kind: u8,
    key: u16,
    value: heapless::Vec<u8, { LONGEST as usize }>,
}

impl Entry {
    fn first_word(&self) -> u32 {
        u32::from(self.kind) | (self.value.len() as u32) << 8 | u32::from(self.key) << 16
    }

    fn size(&self) -> u32 {
        8 + (self.value.len() as u32).next_multiple_of(4)
    }

    fn words(&self) -> heapless::Vec<u32, 27> {
        let mut words = heapless::Vec::new();
        let _ = words.push(self.first_word());
        for bytes in self.value.chunks(4) {
            let mut word = [0_u8; 4];
            for (slot, byte) in word.iter_mut().zip(bytes) {
                *slot = *byte;
            }
            let _ = words.push(u32::from_le_bytes(word));
        }
        let sum = crc(ERASED, &words);
        let _ = words.push(sum);
        words
    }

    /// The key after the last that a removal takes away.
    fn until(&self) -> u16 {
        match self.value.as_slice() {
            [low, high, ..] => u16::from_le_bytes([*low, *high]),
            _ => self.key,
        }
    }

    /// Whether this entry, standing later in the log, makes an earlier record of `key` count no more.
    fn replaces(&self, key: u16) -> bool {
        match self.kind {
            PUT => self.key == key,
            _ => (self.key..self.until()).contains(&key),
        }
    }
}

/// The first word of a record, as far as it can be taken apart.
#[derive(Clone, Copy, Debug)]
struct Outline {
    kind: u8,
    length: u32,
    key: u16,
}

impl Outline {
    fn read(word: u32) -> Self {
        let [kind, length, low, high] = word.to_le_bytes();
        Self { kind, length: u32::from(length), key: u16::from_le_bytes([low, high]) }
    }

    fn size(self) -> u32 {
        8 + self.length.next_multiple_of(4)
    }
}

/// The sequence of a sector that holds a log.
fn sequence_of<F: Flash>(flash: &mut F, sector: Sector) -> Result<Option<u32>, F::Error> {
    let sequence = flash.read(sector, 0)?;
    let sum = flash.read(sector, 4)?;
    Ok((sequence != ERASED && sum == crc(ERASED, &[sequence])).then_some(sequence))
}

impl<F: Flash> Log<F> {
    /// Finds the log in flash; empty memory and memory that holds something else become an empty log.
    ///
    /// # Errors
    /// If the flash cannot be read, written or erased.
    pub fn open(flash: F) -> Result<Self, F::Error> {
        let mut log =
            Self { flash, sector: Sector::A, sequence: 0, end: HEADER, appendable: false, spare_erased: false };
        let a = sequence_of(&mut log.flash, Sector::A)?;
        let b = sequence_of(&mut log.flash, Sector::B)?;
        let newest = match (a, b) {
            (Some(a), Some(b)) if (b.wrapping_sub(a) as i32) > 0 => Some((Sector::B, b)),
            (Some(a), _) => Some((Sector::A, a)),
            (None, Some(b)) => Some((Sector::B, b)),
            (None, None) => None,
        };
        match newest {
            Some((sector, sequence)) => {
                log.sector = sector;
                log.sequence = sequence;
                while let Some(entry) = log.checked_entry(log.end)? {
                    log.end += entry.size();
                }
                log.appendable = log.is_erased(sector, log.end)?;
            }
            None => {
                // Nothing to lose: this is the only place where the sector in use is erased.
                log.wipe(Sector::A)?;
                log.write_header(Sector::A, 1)?;
                log.sequence = 1;
                log.appendable = true;
            }
        }
        let spare = log.sector.other();
        log.spare_erased = log.flash.read(spare, 0)? == ERASED
            && log.flash.read(spare, 4)? == ERASED
            && log.flash.read(spare, MARK_AT)? == MARK
            && log.is_erased(spare, HEADER)?;
        Ok(log)
    }

    /// Whether a memory holds a log, as [`Log::open`] would find it.
    ///
    /// # Errors
    /// If the memory cannot be read.
    pub fn is_in(flash: &mut F) -> Result<bool, F::Error> {
        Ok(sequence_of(flash, Sector::A)?.is_some() || sequence_of(flash, Sector::B)?.is_some())
    }

    /// The memory.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// The memory, to be told what is no business of the log.
    pub fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Gives the memory back.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Hands every record that counts to `take`.
    ///
    /// # Errors
    /// If the flash cannot be read.
    pub fn for_each(&mut self, mut take: impl FnMut(Record)) -> Result<(), F::Error> {
        let mut address = HEADER;
        while address < self.end {
            let outline = self.outline(address)?;
            let next = address + outline.size();
            if outline.kind == PUT && !self.is_replaced(outline.key, next)? {
                let entry = self.entry(address)?;
                take(Record { key: entry.key, value: entry.value });
            }
            address = next;
        }
        Ok(())
    }

    /// Makes a change durable. A record that stands there already is not written again.
    ///
    /// # Errors
    /// [`StoreError::Full`] when there is no room and the spare sector is not erased; [`StoreError::Flash`] when the
    /// memory fails. What was stored before still holds.
    pub fn store(&mut self, change: &Store) -> Result<(), StoreError<F::Error>> {
        let entry = match change {
            Store::Put(record) => Entry { kind: PUT, key: record.key, value: record.value.clone() },
            Store::Remove { from, until } => {
                let value = heapless::Vec::from_slice(&until.to_le_bytes()).unwrap_or_default();
                Entry { kind: REMOVE, key: *from, value }
            }
        };
        if self.holds(&entry)? {
            return Ok(());
        }
        if !self.appendable || self.end + entry.size() > self.flash.sector_size() {
            return self.move_to_spare(&entry);
        }
        // If the memory fails in the midst of the record, what it has written stays behind the end.
        self.appendable = false;
        self.end = self.append(self.sector, self.end, &entry)?;
        self.appendable = true;
        Ok(())
    }

    /// Whether the spare sector should be erased when there is time.
    pub fn needs_erase(&self) -> bool {
        !self.spare_erased
    }

    /// Whether only a few more records fit before the spare sector has to be erased.
    pub fn needs_erase_soon(&self) -> bool {
        !self.spare_erased && self.end + RESERVE > self.flash.sector_size()
    }

    /// Erases the spare sector, which holds nothing that counts. Takes hundreds of milliseconds on real flash.
    ///
    /// # Errors
    /// If the memory does not do it.
    pub fn erase_spare(&mut self) -> Result<(), F::Error> {
        self.wipe(self.sector.other())?;
        self.spare_erased = true;
        Ok(())
    }

    /// Copies what counts into the spare sector, and what is being stored with it; the spare then becomes the log.
    fn move_to_spare(&mut self, coming: &Entry) -> Result<(), StoreError<F::Error>> {
        if !self.spare_erased {
            return Err(StoreError::Full);
        }
        let target = self.sector.other();
        self.spare_erased = false;
        let mut address = HEADER;
        let mut end = HEADER;
        while address < self.end {
            let outline = self.outline(address)?;
            let next = address + outline.size();
            if outline.kind == PUT && !coming.replaces(outline.key) && !self.is_replaced(outline.key, next)? {
                if end + outline.size() > self.flash.sector_size() {
                    return Err(StoreError::Full);
                }
                let entry = self.entry(address)?;
                end = self.append(target, end, &entry)?;
            }
            address = next;
        }
        if coming.kind == PUT {
            // It replaces its predecessor in one step: both stand before the header does.
            if end + coming.size() > self.flash.sector_size() {
                return Err(StoreError::Full);
            }
            end = self.append(target, end, coming)?;
        }
        let sequence = self.sequence.wrapping_add(1);
        self.write_header(target, sequence)?;
        self.sector = target;
        self.sequence = sequence;
        self.end = end;
        self.appendable = true;
        Ok(())
    }

    fn append(&mut self, sector: Sector, address: u32, entry: &Entry) -> Result<u32, F::Error> {
        let mut at = address;
        for word in entry.words() {
            self.flash.write(sector, at, word)?;
            at += 4;
        }
        Ok(at)
    }

    fn wipe(&mut self, sector: Sector) -> Result<(), F::Error> {
        self.flash.erase(sector)?;
        self.flash.write(sector, MARK_AT, MARK)
    }

    fn write_header(&mut self, sector: Sector, sequence: u32) -> Result<(), F::Error> {
        self.flash.write(sector, 0, sequence)?;
        self.flash.write(sector, 4, crc(ERASED, &[sequence]))
    }

    fn is_erased(&mut self, sector: Sector, from: u32) -> Result<bool, F::Error> {
        for address in (from..self.flash.sector_size()).step_by(4) {
            if self.flash.read(sector, address)? != ERASED {
                return Ok(false);
            }
        }
        Ok(true)
    }

    fn outline(&mut self, address: u32) -> Result<Outline, F::Error> {
        Ok(Outline::read(self.flash.read(self.sector, address)?))
    }

    /// The record at an address where there is one.
    fn entry(&mut self, address: u32) -> Result<Entry, F::Error> {
        let outline = self.outline(address)?;
        let mut entry = Entry { kind: outline.kind, key: outline.key, value: heapless::Vec::new() };
        // Longer ones are refused by `checked_entry`.
        let _ = entry.value.resize_default(outline.length as usize);
        let mut at = address + 4;
        for bytes in entry.value.chunks_mut(4) {
            let word = self.flash.read(self.sector, at)?.to_le_bytes();
            for (slot, byte) in bytes.iter_mut().zip(word) {
                *slot = byte;
            }
            at += 4;
        }
        Ok(entry)
    }

    /// The record at an address, if a whole one stands there.
    fn checked_entry(&mut self, address: u32) -> Result<Option<Entry>, F::Error> {
        let size = self.flash.sector_size();
        if address + 8 > size {
            return Ok(None);
        }
        let outline = self.outline(address)?;
        if !matches!(outline.kind, PUT | REMOVE) || outline.length > LONGEST || address + outline.size() > size {
            return Ok(None);
        }
        let entry = self.entry(address)?;
        let sum = self.flash.read(self.sector, address + outline.size() - 4)?;
        Ok((entry.words().last() == Some(&sum)).then_some(entry))
    }

    /// Whether a record counts no more because of one from `from` on.
    fn is_replaced(&mut self, key: u16, from: u32) -> Result<bool, F::Error> {
        let mut address = from;
        while address < self.end {
            let outline = self.outline(address)?;
            let replaces = match outline.kind {
                PUT => outline.key == key,
                _ => outline.key <= key && self.entry(address)?.replaces(key),
            };
            if replaces {
                return Ok(true);
            }
            address += outline.size();
        }
        Ok(false)
    }

    /// Whether storing an entry would change nothing.
    fn holds(&mut self, coming: &Entry) -> Result<bool, F::Error> {
        let mut holds = coming.kind == REMOVE;
        let mut address = HEADER;
        while address < self.end {
            let outline = self.outline(address)?;
            if coming.kind == REMOVE {
                let stands = outline.kind == PUT && coming.replaces(outline.key);
                if stands && !self.is_replaced(outline.key, address + outline.size())? {
                    return Ok(false);
                }
            } else if outline.kind == REMOVE || outline.key == coming.key {
                let entry = self.entry(address)?;
                if entry.replaces(coming.key) {
                    holds = entry.kind == PUT && entry.value == coming.value;
                }
            }
            address += outline.size();
        }
        Ok(holds)
    }
}

#[cfg(test)]
mod tests;
