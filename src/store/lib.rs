//! Settings log that survives a power cut at any time. It keeps records (key, value, CRC-32) in two sectors of a
//! [`Flash`], and replaces Grbl's EEPROM.
//!
//! ```text
//!  sector  ┌───────┬────────┬────────┬────────┬───────────┐
//!          │ header│ record │ record │ record │ erased ...│
//!          └───────┴────────┴────────┴────────┴───────────┘
//!  header  sequence · crc(sequence) · mark       mark: the erase is complete; compaction writes sequence and crc last
//!  record  kind, length, key · value · crc       the crc is written last: without it the record does not exist
//! ```
//! * The valid sector with the higher sequence is in use. The last record of a key is the valid one.
//! * A full sector is compacted into the other, which becomes valid with its last word. So at each moment one sector
//!   holds all settings, old or new.
//! * A change is one record, and therefore atomic. Values that must change together need one key or a range of keys.
//! * Erasing stalls the processor for hundreds of milliseconds on these parts, so a write never erases. While
//!   [`Log::needs_erase`] is true, the owner calls [`Log::erase_spare`] when nothing moves.
//! * After an interrupted erase, cells may read as ones and still not hold what is written to them. So a sector without
//!   its mark is erased again.
//!
//! # Damage
//! Flash may lose a bit, and a file that holds the log may be overwritten. A record with a wrong crc is skipped, and
//! the next record is looked for word by word. Any record with a right crc after the damage belongs to this log, not to
//! an older one, because records begin at multiples of 4 and a sector is erased as a whole. (A text that a host can
//! store never looks like a record, because its characters are neither the kind `PUT` nor the length of a `REMOVE`.)
//! One wrong byte in a header is corrected by means of its crc.
//!
//! A power cut during a write leaves a partial record at the end of the log. The record has some words, and the last
//! of them may have only some of its bits programmed. Only erased words follow. A partial record is normally not
//! damage. But if the power was cut in the last word of a record, the result can look like a complete record with one
//! wrong byte. Only this case counts as damage.
//!
//! Damage is reported as a record with the key [`STORE_DAMAGED`] until that record is removed. The report survives
//! power cycles and compaction. Removing the record compacts the log into the spare sector. Opening a damaged log
//! changes nothing in flash.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

use crc::{CRC_32_JAMCRC, Crc, NoTable};
use oxmill_controller::messages::{Record, STORE_DAMAGED, Store};

/// A flash memory of two sectors. Addresses are bytes from the start of a sector, multiples of 4.
pub trait Flash {
    /// Why an operation failed.
    type Error;
    /// Returns the size of a sector in bytes.
    fn sector_size(&self) -> u32;
    /// Reads a word.
    ///
    /// # Errors
    /// If the memory cannot be read.
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, Self::Error>;
    /// Programs a word that is erased (all ones).
    ///
    /// # Errors
    /// If the word cannot be programmed.
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), Self::Error>;
    /// Erases a sector: sets it to ones.
    ///
    /// # Errors
    /// If the sector cannot be erased.
    fn erase(&mut self, sector: Sector) -> Result<(), Self::Error>;
}

impl<F: Flash> Flash for &mut F {
    type Error = F::Error;
    fn sector_size(&self) -> u32 {
        F::sector_size(self)
    }
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, F::Error> {
        F::read(self, sector, address)
    }
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), F::Error> {
        F::write(self, sector, address, word)
    }
    fn erase(&mut self, sector: Sector) -> Result<(), F::Error> {
        F::erase(self, sector)
    }
}

/// One of the two sectors.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sector {
    /// The first one; a new log begins here.
    A,
    /// The second one.
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

/// Why a change could not be stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StoreError<E> {
    /// The flash memory failed.
    Flash(E),
    /// The log is full. Either the spare sector is not erased, or the valid records alone fill a sector.
    Full,
}

impl<E> From<E> for StoreError<E> {
    fn from(error: E) -> Self {
        StoreError::Flash(error)
    }
}

/// An erase is urgent when fewer bytes than this are free in the sector in use. A setting takes 12 bytes.
const RESERVE: u32 = 1024;
const ERASED: u32 = u32::MAX;
/// Size of a sector's header, in bytes: sequence, crc of the sequence, mark of a completed erase.
const HEADER: u32 = 12;
/// Address of the mark in a sector's header.
const MARK_AT: u32 = 8;
/// Value of the mark of a sector that was erased completely.
const MARK: u32 = u32::from_le_bytes(*b"wipe");
/// Size of the longest value, in bytes.
const LONGEST: u32 = 100;
/// Size of the longest record, in words.
const LONGEST_WORDS: usize = 27;
/// Maximum number of remembered gaps (damaged bytes between records). If there are more, records from the first
/// unremembered gap on are checked again each time they are read.
const GAPS: usize = 8;
/// Number of keys whose records are found in one walk over the log.
const KEYS: usize = 128;
/// Address that means "no record": the header is at address 0, so no record can be there.
const NOWHERE: u32 = 0;
/// The polynomial of the CRC, its bits reflected.
const POLYNOMIAL: u32 = CRC_32_JAMCRC.poly.reverse_bits();
/// Kind of a record with a value. Like `REMOVE`, it differs from erased and from zeroed memory in several bits.
const PUT: u8 = 0xA5;
/// Kind of a record that removes a range of keys.
const REMOVE: u8 = 0x5A;

/// The log. It has one owner. A change is complete in flash when [`Log::store`] returns.
#[derive(Clone, Debug)]
pub struct Log<F> {
    flash: F,
    sector: Sector,
    sequence: u32,
    /// Address after the last valid record. Everything before this address was checked or written.
    end: u32,
    /// The words from `end` on are erased, so a record can be appended.
    appendable: bool,
    /// The sector in use contains damage that must be reported.
    unsound: bool,
    /// Gaps between records, in the order of their addresses.
    gaps: heapless::Vec<Gap, GAPS>,
    /// Address from which on gaps are not listed, because the list is full.
    unmapped: u32,
    /// The spare sector is erased and has its mark.
    spare_erased: bool,
}

/// Addresses of the records of consecutive keys; [`NOWHERE`] for a key without a record.
type Places = [u32; KEYS];

/// Returns the keys that have a record, each with the address of the record. `from`: key of the first of the `places`.
fn stored(from: u16, places: &Places) -> impl Iterator<Item = (u16, u32)> {
    (from..=u16::MAX).zip(places.iter().copied()).filter(|(_, address)| *address != NOWHERE)
}

/// A stretch of damaged bytes between records.
#[derive(Clone, Copy, Debug)]
struct Gap {
    start: u32,
    end: u32,
}

/// CRC-32 of IEEE 802.3 without its final inversion. Computed bit by bit: it is rarely needed, and a table for faster
/// computation would take more flash.
const CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_JAMCRC);

/// Returns the CRC of whole words.
fn crc(words: &[u32]) -> u32 {
    let mut digest = CRC.digest();
    words.iter().for_each(|word| digest.update(&word.to_le_bytes()));
    digest.finalize()
}

/// Looks for a single wrong byte that explains why the last word is not the crc of the words before it. Returns the
/// index of the word that contains this byte, and the wrong bits in that word.
fn wrong_byte(words: &[u32]) -> Option<(usize, u32)> {
    let (sum, covered) = words.split_last()?;
    let mut difference = crc(covered) ^ sum;
    for index in (0..=covered.len()).rev() {
        if difference.to_le_bytes().iter().filter(|byte| **byte != 0).count() <= 1 {
            return Some((index, difference));
        }
        // `difference` holds the bits that would be wrong in word `index`. Convert it to the bits that would be wrong
        // in the word before: the CRC is linear, so it can be run backwards over one word.
        for _ in 0..32 {
            difference = if difference >> 31 == 0 { difference << 1 } else { (difference ^ POLYNOMIAL) << 1 | 1 };
        }
    }
    None
}

/// A record as it is in flash.
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

    fn words(&self) -> heapless::Vec<u32, LONGEST_WORDS> {
        let mut words = heapless::Vec::new();
        let _ = words.push(self.first_word());
        for bytes in self.value.chunks(4) {
            let mut word = [0_u8; 4];
            for (slot, byte) in word.iter_mut().zip(bytes) {
                *slot = *byte;
            }
            let _ = words.push(u32::from_le_bytes(word));
        }
        let sum = crc(&words);
        let _ = words.push(sum);
        words
    }

    /// Returns the first key after the removed range, for a record that removes keys.
    fn until(&self) -> u16 {
        match self.value.as_slice() {
            [low, high, ..] => u16::from_le_bytes([*low, *high]),
            _ => self.key,
        }
    }

    /// Returns whether this entry makes an earlier record of `key` invalid: it sets or removes that key.
    fn replaces(&self, key: u16) -> bool {
        match self.kind {
            PUT => self.key == key,
            _ => (self.key..self.until()).contains(&key),
        }
    }
}

/// The decoded first word of a record.
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

    /// Returns whether a record can begin with this word.
    fn is_possible(self) -> bool {
        match self.kind {
            PUT => self.length <= LONGEST,
            REMOVE => self.length == 2,
            _ => false,
        }
    }
}

/// Returns the sequence of a sector, and whether its header is intact; `None` if the sector holds no log. One wrong
/// byte in the sequence or its crc is corrected.
fn sequence_of<F: Flash>(flash: &mut F, sector: Sector) -> Result<Option<(u32, bool)>, F::Error> {
    let sequence = flash.read(sector, 0)?;
    let sum = flash.read(sector, 4)?;
    let mark = flash.read(sector, MARK_AT)?;
    let whole = sum == crc(&[sequence]);
    let found = match wrong_byte(&[sequence, sum]) {
        _ if whole => Some(sequence),
        Some((index, wrong)) if mark == MARK => Some(if index == 0 { sequence ^ wrong } else { sequence }),
        _ => None,
    };
    Ok(found.filter(|sequence| *sequence != ERASED).map(|sequence| (sequence, whole && mark == MARK)))
}

impl<F: Flash> Log<F> {
    /// Finds the log in flash. Memory without a log, empty or not, becomes an empty log.
    ///
    /// # Errors
    /// If the flash cannot be read, written or erased.
    pub fn open(flash: F) -> Result<Self, F::Error> {
        let mut log = Self::over(flash);
        if !log.find_sector()? {
            // This is the only place that erases the sector in use. No log can be lost, because there is none.
            log.sector = Sector::A;
            log.sequence = 1;
            log.appendable = true;
            log.unsound = false;
            log.wipe(Sector::A)?;
            log.write_header(Sector::A, 1)?;
        }
        let spare = log.sector.other();
        log.spare_erased = log.flash.read(spare, 0)? == ERASED
            && log.flash.read(spare, 4)? == ERASED
            && log.flash.read(spare, MARK_AT)? == MARK
            && log.is_erased(spare, HEADER)?;
        Ok(log)
    }

    fn over(flash: F) -> Self {
        Self {
            flash,
            sector: Sector::A,
            sequence: 1,
            end: HEADER,
            appendable: false,
            unsound: false,
            gaps: heapless::Vec::new(),
            unmapped: u32::MAX,
            spare_erased: false,
        }
    }

    /// Finds the sector in use and its records. Returns `false` if neither sector holds a log.
    fn find_sector(&mut self) -> Result<bool, F::Error> {
        let a = sequence_of(&mut self.flash, Sector::A)?;
        let b = sequence_of(&mut self.flash, Sector::B)?;
        let newest = match (a, b) {
            (Some((a, _)), Some(b)) if (b.0.wrapping_sub(a) as i32) > 0 => Some((Sector::B, b)),
            (Some(a), _) => Some((Sector::A, a)),
            (None, Some(b)) => Some((Sector::B, b)),
            (None, None) => None,
        };
        if let Some((sector, (sequence, whole))) = newest {
            self.sector = sector;
            self.sequence = sequence;
            self.unsound = !whole;
            self.survey()?;
            return Ok(true);
        }
        // No header is valid, even with one byte corrected. But if a sector has records, this sector holds a log.
        for sector in [Sector::A, Sector::B] {
            self.sector = sector;
            if self.flash.read(sector, 0)? != ERASED || self.flash.read(sector, 4)? != ERASED {
                self.unsound = true;
                self.survey()?;
                if self.end > HEADER {
                    return Ok(true);
                }
            }
        }
        Ok(false)
    }

    /// Finds the records of the sector in use, the gaps (damaged bytes) between them, and the end of the log.
    fn survey(&mut self) -> Result<(), F::Error> {
        let mut address = HEADER;
        self.end = HEADER;
        while address < self.flash.sector_size() {
            let Some(entry) = self.checked_entry(address)? else {
                address += 4;
                continue;
            };
            for (word, at) in entry.words().iter().zip((address..).step_by(4)) {
                // A wrong padding byte does not invalidate the record, but it is reported as damage.
                self.unsound |= self.flash.read(self.sector, at)? != *word;
            }
            if address > self.end {
                self.unsound = true;
                if self.gaps.push(Gap { start: self.end, end: address }).is_err() {
                    self.unmapped = self.unmapped.min(self.end);
                }
            }
            address += entry.size();
            self.end = address;
        }
        let (appendable, damaged) = self.look_behind()?;
        self.appendable = appendable;
        self.unsound |= damaged;
        Ok(())
    }

    /// Examines the words after the last record. Returns two values: whether they are all erased, and whether they show
    /// damage that a power cut cannot explain.
    fn look_behind(&mut self) -> Result<(bool, bool), F::Error> {
        let mut until = self.end;
        for address in (self.end..self.flash.sector_size()).step_by(4) {
            if self.flash.read(self.sector, address)? != ERASED {
                until = address + 4;
            }
        }
        let mut words = heapless::Vec::<u32, LONGEST_WORDS>::new();
        for address in (self.end..until).step_by(4) {
            if words.push(self.flash.read(self.sector, address)?).is_err() {
                return Ok((false, true));
            }
        }
        let (first, last, covered) = match words.as_slice() {
            [] => return Ok((true, false)),
            // A power cut can leave any bits in the first word of a record, so a single word does not count as damage.
            [_] => return Ok((false, false)),
            [first, .., last] => (*first, *last, words.get(..words.len() - 1).unwrap_or_default()),
        };
        let (outline, size) = (Outline::read(first), until - self.end);
        let cut_short = size < outline.size() || size == outline.size() && crc(covered) & !last == 0;
        // One wrong byte explains these words only if the corrected record has exactly as many words. Otherwise the crc
        // fits by chance.
        let one_byte = wrong_byte(&words).is_some_and(|(index, bits)| {
            let mended = if index == 0 { Outline::read(first ^ bits) } else { outline };
            mended.is_possible() && mended.size() == size
        });
        Ok((false, !outline.is_possible() || !cut_short || one_byte))
    }

    /// Returns whether a memory holds a log that [`Log::open`] would find.
    ///
    /// # Errors
    /// If the memory cannot be read.
    pub fn is_in(flash: &mut F) -> Result<bool, F::Error> {
        Log::over(flash).find_sector()
    }

    /// Returns the flash memory that holds the log.
    pub fn flash(&self) -> &F {
        &self.flash
    }

    /// Returns the flash memory for direct access, for example to simulate power cuts in tests.
    pub fn flash_mut(&mut self) -> &mut F {
        &mut self.flash
    }

    /// Returns the memory and drops the log.
    pub fn into_flash(self) -> F {
        self.flash
    }

    /// Passes each valid record to `take`, in the order of the keys. If the log is damaged, one of the records has the
    /// key [`STORE_DAMAGED`].
    ///
    /// # Errors
    /// If the flash cannot be read.
    pub fn for_each(&mut self, mut take: impl FnMut(Record)) -> Result<(), F::Error> {
        let mut damage = self.unsound;
        let mut from = Some(0);
        while let Some(first) = from {
            let (places, next) = self.counting(first)?;
            for (key, address) in stored(first, &places) {
                damage &= key != STORE_DAMAGED;
                take(Record { key, value: self.entry(address)?.value });
            }
            from = next;
        }
        if damage {
            take(Record { key: STORE_DAMAGED, value: heapless::Vec::new() });
        }
        Ok(())
    }

    /// Writes a change into the log, so that it survives a power cut. A change that has no effect is not written.
    ///
    /// # Errors
    /// [`StoreError::Full`] if there is no room and the spare sector is not erased; [`StoreError::Flash`] if the memory
    /// fails. Earlier changes remain valid.
    pub fn store(&mut self, change: &Store) -> Result<(), StoreError<F::Error>> {
        let entry = match change {
            Store::Put(record) => Entry { kind: PUT, key: record.key, value: record.value.clone() },
            Store::Remove { from, until } => {
                let value = heapless::Vec::from_slice(&until.to_le_bytes()).unwrap_or_default();
                Entry { kind: REMOVE, key: *from, value }
            }
        };
        // Flash cannot be repaired in place. So a change that removes the report of damage (the user confirms the
        // damage) copies the valid records into the spare sector.
        let cleans = self.unsound && entry.kind == REMOVE && entry.replaces(STORE_DAMAGED);
        // After a failed write (`appendable` is false), store the change even if it seems to have no effect. The failed
        // record is ignored now, but a restart could find it as valid.
        if !cleans && self.appendable && self.holds(&entry)? {
            return Ok(());
        }
        if cleans || !self.appendable || self.end + entry.size() > self.flash.sector_size() {
            return self.compact_into_spare(&entry);
        }
        // If a write of the record fails, the words written so far remain after `end`. Then no other record can be
        // appended there.
        self.appendable = false;
        self.end = self.append(self.sector, self.end, &entry)?;
        self.appendable = true;
        Ok(())
    }

    /// Returns whether the spare sector should be erased at the next opportunity, that is when nothing moves.
    pub fn needs_erase(&self) -> bool {
        !self.spare_erased
    }

    /// Returns whether the spare sector must be erased soon. Without an erase, few or no further records fit, or the
    /// report of damage cannot be removed.
    pub fn needs_erase_soon(&self) -> bool {
        !self.spare_erased && (!self.appendable || self.unsound || self.end + RESERVE > self.flash.sector_size())
    }

    /// Erases the spare sector, which holds no valid records. Takes hundreds of milliseconds on real flash.
    ///
    /// # Errors
    /// If the sector cannot be erased.
    pub fn erase_spare(&mut self) -> Result<(), F::Error> {
        self.wipe(self.sector.other())?;
        self.spare_erased = true;
        Ok(())
    }

    /// Compacts the log: copies the valid records and the new one (`coming`) into the spare sector, which then becomes
    /// the sector in use.
    fn compact_into_spare(&mut self, coming: &Entry) -> Result<(), StoreError<F::Error>> {
        if !self.spare_erased {
            return Err(StoreError::Full);
        }
        let target = self.sector.other();
        self.spare_erased = false;
        let mut damage = self.unsound && !coming.replaces(STORE_DAMAGED);
        let mut from = Some(0);
        let mut end = HEADER;
        while let Some(first) = from {
            let (places, next) = self.counting(first)?;
            for (key, address) in stored(first, &places) {
                if !coming.replaces(key) {
                    damage &= key != STORE_DAMAGED;
                    let entry = self.entry(address)?;
                    end = self.copy(target, end, &entry)?;
                }
            }
            from = next;
        }
        if damage {
            // The report of damage has not been removed by the user, so the new sector must contain it as well.
            let entry = Entry { kind: PUT, key: STORE_DAMAGED, value: heapless::Vec::new() };
            end = self.copy(target, end, &entry)?;
        }
        if coming.kind == PUT {
            // The new record becomes valid together with the copied ones, when the header is written. So it replaces
            // the old record of its key atomically.
            end = self.copy(target, end, coming)?;
        }
        let sequence = self.sequence.wrapping_add(1);
        // If the write of the last header word fails, nothing more may be appended to the old sector. A restart can
        // find the new sector valid, and would then lose any record appended to the old sector.
        self.appendable = false;
        self.write_header(target, sequence)?;
        self.sector = target;
        self.sequence = sequence;
        self.end = end;
        self.appendable = true;
        self.unsound = false;
        self.gaps.clear();
        self.unmapped = u32::MAX;
        Ok(())
    }

    /// Appends a record to `target`, the sector being filled by compaction. Returns the address after the record, or
    /// [`StoreError::Full`] if there is no room.
    fn copy(&mut self, target: Sector, end: u32, entry: &Entry) -> Result<u32, StoreError<F::Error>> {
        if end + entry.size() > self.flash.sector_size() {
            return Err(StoreError::Full);
        }
        Ok(self.append(target, end, entry)?)
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
        self.flash.write(sector, 4, crc(&[sequence]))
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

    /// Reads the record at an address where a valid record is known to be.
    fn entry(&mut self, address: u32) -> Result<Entry, F::Error> {
        let outline = self.outline(address)?;
        let mut entry = Entry { kind: outline.kind, key: outline.key, value: heapless::Vec::new() };
        // This cannot fail, because `checked_entry` refuses longer values.
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

    /// Returns the record at an address, if it is complete and its crc is right.
    fn checked_entry(&mut self, address: u32) -> Result<Option<Entry>, F::Error> {
        let size = self.flash.sector_size();
        if address + 8 > size {
            return Ok(None);
        }
        let outline = self.outline(address)?;
        if !outline.is_possible() || address + outline.size() > size {
            return Ok(None);
        }
        let entry = self.entry(address)?;
        let sum = self.flash.read(self.sector, address + outline.size() - 4)?;
        Ok((entry.words().last() == Some(&sum)).then_some(entry))
    }

    /// Returns the address and the outline of the first record at or after an address.
    fn record_from(&mut self, mut address: u32) -> Result<Option<(u32, Outline)>, F::Error> {
        while address < self.end {
            if let Some(gap) = self.gaps.iter().find(|gap| gap.start == address) {
                address = gap.end;
            } else if address >= self.unmapped && self.checked_entry(address)?.is_none() {
                address += 4;
            } else {
                return Ok(Some((address, self.outline(address)?)));
            }
        }
        Ok(None)
    }

    /// Finds the valid records of `KEYS` consecutive keys, beginning with `from`. Returns their addresses, and the next
    /// higher key that has a record. Walks over the log once for all these keys. A separate search for each key would
    /// take seconds in a full log.
    fn counting(&mut self, from: u16) -> Result<(Places, Option<u16>), F::Error> {
        let mut places = [NOWHERE; KEYS];
        let index = |key: u16| usize::from(key.saturating_sub(from)).min(KEYS);
        let mut more = None;
        let mut next = HEADER;
        while let Some((address, outline)) = self.record_from(next)? {
            next = address + outline.size();
            let key = outline.key;
            if outline.kind != PUT {
                let until = self.entry(address)?.until();
                if let Some(removed) = places.get_mut(index(key)..index(until)) {
                    removed.fill(NOWHERE);
                }
            } else if let Some(place) = places.get_mut(index(key)) {
                if key >= from {
                    *place = address;
                }
            } else if more.is_none_or(|more| key < more) {
                more = Some(key);
            }
        }
        Ok((places, more))
    }

    /// Returns whether storing an entry would change nothing, because the log already has that state.
    fn holds(&mut self, coming: &Entry) -> Result<bool, F::Error> {
        if coming.kind == REMOVE {
            let mut from = Some(coming.key);
            while let Some(first) = from.filter(|key| coming.replaces(*key)) {
                let (places, next) = self.counting(first)?;
                if stored(first, &places).any(|(key, _)| coming.replaces(key)) {
                    return Ok(false);
                }
                from = next;
            }
            return Ok(true);
        }
        let mut holds = false;
        let mut next = HEADER;
        while let Some((address, outline)) = self.record_from(next)? {
            next = address + outline.size();
            if outline.kind == REMOVE || outline.key == coming.key {
                let entry = self.entry(address)?;
                if entry.replaces(coming.key) {
                    holds = entry.kind == PUT && entry.value == coming.value;
                }
            }
        }
        Ok(holds)
    }
}

#[cfg(test)]
mod tests;
