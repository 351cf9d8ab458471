//! Settings that survive a power cut at any moment: an append-only log of records in two flash sectors.
//!
//! ```text
//!  sector  ┌───────┬────────┬────────┬────────┬───────────┐
//!          │ header│ record │ record │ record │ erased ...│
//!          └───────┴────────┴────────┴────────┴───────────┘
//!  header  sequence · crc(sequence)              written last when a sector has been filled by a move
//!  record  kind, length, key · value · crc       the crc is written last: without it the record does not exist
//! ```
//! The valid sector with the higher sequence counts; the last record of a key counts. When it is full, the records that
//! count are copied into the other sector, which becomes valid with its last word, and only then is the old one of no
//! more use. So at each moment one sector holds all settings, old or new. Erasing deafens the processor (hundreds of
//! milliseconds on these parts), so it is never done in the course of a write: [`Log::needs_erase`] says when the spare
//! sector should be erased, and the owner does it while nothing moves ([`Log::erase_spare`]).
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

const ERASED: u32 = u32::MAX;
/// Bytes of a sector's header: sequence and its crc.
const HEADER: u32 = 8;
/// Kinds of record; both differ from erased and zeroed memory in several bits.
const PUT: u8 = 0xA5;
const REMOVE: u8 = 0x5A;

/// The log. One owner; every change is complete in flash when the call returns.
#[derive(Debug)]
pub struct Log<F> {
    flash: F,
    sector: Sector,
    sequence: u32,
    /// Where the next record goes; the sector's size when nothing more may be appended to it.
    end: u32,
    /// The spare sector is all ones.
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
    value: heapless::Vec<u8, 100>,
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

/// What stands at an address.
enum Found {
    Entry(Entry),
    /// Erased: the log ends here.
    End,
    /// A record that was never finished: the log ends here, and nothing can be appended.
    Torn,
}

impl<F: Flash> Log<F> {
    /// Finds the log in flash; empty memory and memory that holds something else become an empty log.
    ///
    /// # Errors
    /// If the flash cannot be read, written or erased.
    pub fn open(flash: F) -> Result<Self, F::Error> {
        let mut log = Self { flash, sector: Sector::A, sequence: 0, end: 0, spare_erased: false };
        let a = log.sequence_of(Sector::A)?;
        let b = log.sequence_of(Sector::B)?;
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
                log.end = log.find_end()?;
            }
            None => {
                // Nothing to lose: this is the only place where the sector in use is erased.
                log.flash.erase(Sector::A)?;
                log.write_header(Sector::A, 1)?;
                log.sequence = 1;
                log.end = HEADER;
            }
        }
        log.spare_erased = log.is_erased(log.sector.other())?;
        Ok(log)
    }

    /// Hands every record that counts to `take`.
    ///
    /// # Errors
    /// If the flash cannot be read.
    pub fn for_each(&mut self, mut take: impl FnMut(Record)) -> Result<(), F::Error> {
        let mut address = HEADER;
        while let Found::Entry(entry) = self.read_entry(address)? {
            let next = address + entry.size();
            if entry.kind == PUT && !self.is_replaced(entry.key, next)? {
                take(Record { key: entry.key, value: entry.value });
            }
            address = next;
        }
        Ok(())
    }

    /// Makes a change durable.
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
        if self.end + entry.size() > self.flash.sector_size() {
            self.move_to_spare(&entry)?;
        }
        if self.end + entry.size() > self.flash.sector_size() {
            return Err(StoreError::Full);
        }
        self.end = self.append(self.sector, self.end, &entry)?;
        Ok(())
    }

    /// Whether the spare sector should be erased when there is time.
    pub fn needs_erase(&self) -> bool {
        !self.spare_erased
    }

    /// Erases the spare sector, which holds nothing that counts. Takes hundreds of milliseconds on real flash.
    ///
    /// # Errors
    /// If the memory does not do it.
    pub fn erase_spare(&mut self) -> Result<(), F::Error> {
        self.flash.erase(self.sector.other())?;
        self.spare_erased = true;
        Ok(())
    }

    /// Copies what counts into the spare sector, which then becomes the log.
    fn move_to_spare(&mut self, coming: &Entry) -> Result<(), StoreError<F::Error>> {
        if !self.spare_erased {
            return Err(StoreError::Full);
        }
        let target = self.sector.other();
        self.spare_erased = false;
        let mut address = HEADER;
        let mut end = HEADER;
        while let Found::Entry(entry) = self.read_entry(address)? {
            address += entry.size();
            if entry.kind == PUT && !coming.replaces(entry.key) && !self.is_replaced(entry.key, address)? {
                if end + entry.size() > self.flash.sector_size() {
                    return Err(StoreError::Full);
                }
                end = self.append(target, end, &entry)?;
            }
        }
        if coming.kind == PUT {
            // What is being stored replaces its predecessor in one step: both stand before the header does.
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

    fn write_header(&mut self, sector: Sector, sequence: u32) -> Result<(), F::Error> {
        self.flash.write(sector, 0, sequence)?;
        self.flash.write(sector, 4, crc(ERASED, &[sequence]))
    }

    fn sequence_of(&mut self, sector: Sector) -> Result<Option<u32>, F::Error> {
        let sequence = self.flash.read(sector, 0)?;
        let sum = self.flash.read(sector, 4)?;
        Ok((sequence != ERASED && sum == crc(ERASED, &[sequence])).then_some(sequence))
    }

    fn is_erased(&mut self, sector: Sector) -> Result<bool, F::Error> {
        for address in (0..self.flash.sector_size()).step_by(4) {
            if self.flash.read(sector, address)? != ERASED {
                return Ok(false);
            }
        }
        Ok(true)
    }

    /// Where appending may go on: behind the last record if the rest is erased, else nowhere.
    fn find_end(&mut self) -> Result<u32, F::Error> {
        let mut address = HEADER;
        loop {
            match self.read_entry(address)? {
                Found::Entry(entry) => address += entry.size(),
                Found::Torn => return Ok(self.flash.sector_size()),
                Found::End => break,
            }
        }
        for rest in (address..self.flash.sector_size()).step_by(4) {
            if self.flash.read(self.sector, rest)? != ERASED {
                return Ok(self.flash.sector_size());
            }
        }
        Ok(address)
    }

    fn read_entry(&mut self, address: u32) -> Result<Found, F::Error> {
        let size = self.flash.sector_size();
        if address + 8 > size {
            return Ok(Found::End);
        }
        let first = self.flash.read(self.sector, address)?;
        if first == ERASED {
            return Ok(Found::End);
        }
        let [kind, length, low, high] = first.to_le_bytes();
        let mut entry = Entry { kind, key: u16::from_le_bytes([low, high]), value: heapless::Vec::new() };
        if !matches!(kind, PUT | REMOVE)
            || entry.value.resize_default(usize::from(length)).is_err()
            || address + entry.size() > size
        {
            return Ok(Found::Torn);
        }
        let sum_at = address + entry.size() - 4;
        let mut at = address + 4;
        for bytes in entry.value.chunks_mut(4) {
            let word = self.flash.read(self.sector, at)?.to_le_bytes();
            for (slot, byte) in bytes.iter_mut().zip(word) {
                *slot = byte;
            }
            at += 4;
        }
        let sum = self.flash.read(self.sector, sum_at)?;
        let valid = entry.words().last() == Some(&sum);
        Ok(if valid { Found::Entry(entry) } else { Found::Torn })
    }

    fn is_replaced(&mut self, key: u16, from: u32) -> Result<bool, F::Error> {
        let mut address = from;
        while let Found::Entry(entry) = self.read_entry(address)? {
            if entry.replaces(key) {
                return Ok(true);
            }
            address += entry.size();
        }
        Ok(false)
    }
}

#[cfg(test)]
mod tests;
