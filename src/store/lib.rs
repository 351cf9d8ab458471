//! Settings that survive a power cut at any moment: a `Log` of records (key, value, CRC-32) in two sectors of a
//! `Flash`. A full sector is compacted into the other; damage costs only the records that it hits, and is told. It
//! takes the place of the EEPROM of Grbl.
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
//!
//! # Damage
//! Flash may lose a bit, and a file may be overwritten. A record whose crc is wrong is left out, and the next one is looked
//! for word by word: records begin at multiples of 4, a sector is erased as a whole, so what has a right crc behind the
//! damage is a record of this log. (No text that a host can store looks like one: no character has the code of `PUT`, and
//! none the length of a `REMOVE`.) A header with one wrong byte is mended by its crc.
//!
//! A power cut leaves damage of its own, at the end: words of one record up to some word, of which any bits may be
//! programmed, and nothing but erased words behind it. That is no damage, unless one wrong byte in an otherwise whole
//! record explains it as well, which is possible only where the cut fell into the last word of a record.
//!
//! Damage is handed out as a record with the key [`STORE_DAMAGED`] until that record is removed; it outlives power cycles
//! and moves. Its removal copies what is left into the spare sector. Opening a damaged log changes nothing in flash.
#![cfg_attr(not(test), no_std)]
#![forbid(unsafe_code)]

use crc::{CRC_32_JAMCRC, Crc, NoTable};
use oxmill_controller::messages::{Record, STORE_DAMAGED, Store};

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
/// The address of the mark, and its value.
const MARK_AT: u32 = 8;
const MARK: u32 = u32::from_le_bytes(*b"wipe");
/// Bytes of the longest value, and words of its record.
const LONGEST: u32 = 100;
const LONGEST_WORDS: usize = 27;
/// Damaged stretches that are remembered; behind more of them every record is checked again each time.
const GAPS: usize = 8;
/// Keys whose records are looked for in one walk over the log.
const KEYS: usize = 128;
/// In place of the address of a record: none is in the header.
const NOWHERE: u32 = 0;
/// The polynomial of the CRC, its bits reflected.
const POLYNOMIAL: u32 = CRC_32_JAMCRC.poly.reverse_bits();
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
    /// The sector in use has been damaged.
    unsound: bool,
    /// Damaged stretches between records, and where their list ends for want of room.
    gaps: heapless::Vec<Gap, GAPS>,
    unmapped: u32,
    /// The spare sector holds its mark and nothing else.
    spare_erased: bool,
}

/// Where the records of keys that follow each other are.
type Places = [u32; KEYS];

/// The keys from `from` on that have a record, and its address.
fn stored(from: u16, places: &Places) -> impl Iterator<Item = (u16, u32)> {
    (from..=u16::MAX).zip(places.iter().copied()).filter(|(_, address)| *address != NOWHERE)
}

/// Bytes between records that hold none.
#[derive(Clone, Copy, Debug)]
struct Gap {
    start: u32,
    end: u32,
}

/// CRC-32 of IEEE 802.3 without its last inversion, bit by bit: rare and small.
const CRC: Crc<u32, NoTable> = Crc::<u32, NoTable>::new(&CRC_32_JAMCRC);

/// Returns the CRC of whole words.
fn crc(words: &[u32]) -> u32 {
    let mut digest = CRC.digest();
    words.iter().for_each(|word| digest.update(&word.to_le_bytes()));
    digest.finalize()
}

/// The word in which a single wrong byte explains why the last of these is not the crc of the others, and the bits that are
/// wrong in it.
fn wrong_byte(words: &[u32]) -> Option<(usize, u32)> {
    let (sum, covered) = words.split_last()?;
    let mut difference = crc(covered) ^ sum;
    for index in (0..=covered.len()).rev() {
        if difference.to_le_bytes().iter().filter(|byte| **byte != 0).count() <= 1 {
            return Some((index, difference));
        }
        // The crc is linear: run backwards over a word, the difference is the one that the word came in with.
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

    /// Whether there are records that begin so.
    fn is_possible(self) -> bool {
        match self.kind {
            PUT => self.length <= LONGEST,
            REMOVE => self.length == 2,
            _ => false,
        }
    }
}

/// The sequence of a sector that holds a log, and whether its header is whole; one wrong byte in it is mended.
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
    /// Finds the log in flash; empty memory and memory that holds something else become an empty log.
    ///
    /// # Errors
    /// If the flash cannot be read, written or erased.
    pub fn open(flash: F) -> Result<Self, F::Error> {
        let mut log = Self::over(flash);
        if !log.find_sector()? {
            // Nothing to lose: this is the only place where the sector in use is erased.
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

    /// Finds the sector in use and its records; `false` if there is none.
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
        // A header with more than one wrong byte: records tell that there is a log.
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

    /// Finds the records of the sector, the stretches between them, and the end.
    fn survey(&mut self) -> Result<(), F::Error> {
        let mut address = HEADER;
        self.end = HEADER;
        while address < self.flash.sector_size() {
            let Some(entry) = self.checked_entry(address)? else {
                address += 4;
                continue;
            };
            for (word, at) in entry.words().iter().zip((address..).step_by(4)) {
                // The bytes that fill up its last word do not matter, but are told.
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

    /// What is behind the last record: whether it is erased, and whether it is damage other than a power cut's.
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
            // A first word that was cut short may look like anything.
            [_] => return Ok((false, false)),
            [first, .., last] => (*first, *last, words.get(..words.len() - 1).unwrap_or_default()),
        };
        let (outline, size) = (Outline::read(first), until - self.end);
        let cut_short = size < outline.size() || size == outline.size() && crc(covered) & !last == 0;
        // With the byte mended the record is as long as what is there: else its crc fits by chance.
        let one_byte = wrong_byte(&words).is_some_and(|(index, bits)| {
            let mended = if index == 0 { Outline::read(first ^ bits) } else { outline };
            mended.is_possible() && mended.size() == size
        });
        Ok((false, !outline.is_possible() || !cut_short || one_byte))
    }

    /// Whether a memory holds a log, as [`Log::open`] would find it.
    ///
    /// # Errors
    /// If the memory cannot be read.
    pub fn is_in(flash: &mut F) -> Result<bool, F::Error> {
        Log::over(flash).find_sector()
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

    /// Hands every record that counts to `take`, and one with the key [`STORE_DAMAGED`] if others have been lost.
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

    /// Makes a change durable. A record that is there already is not written again.
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
        // What is damaged cannot be written again where it is.
        let cleans = self.unsound && entry.kind == REMOVE && entry.replaces(STORE_DAMAGED);
        // Behind a write that failed, what is read now need not be what a restart finds.
        if !cleans && self.appendable && self.holds(&entry)? {
            return Ok(());
        }
        if cleans || !self.appendable || self.end + entry.size() > self.flash.sector_size() {
            return self.compact_into_spare(&entry);
        }
        // If the memory fails within the record, what it has written stays behind the end.
        self.appendable = false;
        self.end = self.append(self.sector, self.end, &entry)?;
        self.appendable = true;
        Ok(())
    }

    /// Whether the spare sector should be erased when there is time.
    pub fn needs_erase(&self) -> bool {
        !self.spare_erased
    }

    /// Whether no record fits before the spare sector has been erased, or only a few, or damage has to be left behind.
    pub fn needs_erase_soon(&self) -> bool {
        !self.spare_erased && (!self.appendable || self.unsound || self.end + RESERVE > self.flash.sector_size())
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

    /// Compacts the log (garbage collection): copies what counts into the spare sector, and what is being stored with it; the spare then becomes the log.
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
            // It has not been confirmed.
            let entry = Entry { kind: PUT, key: STORE_DAMAGED, value: heapless::Vec::new() };
            end = self.copy(target, end, &entry)?;
        }
        if coming.kind == PUT {
            // It replaces its predecessor in one step: both stand before the header does.
            end = self.copy(target, end, coming)?;
        }
        let sequence = self.sequence.wrapping_add(1);
        // A header of which the last word fails may count after a restart, and what were appended here would not.
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

    /// Appends to a sector that is being filled, if there is room.
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

    /// The record at an address, if it is whole and its CRC is right.
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

    /// The first record from an address on.
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

    /// Where the records are that count, of as many keys from `from` on; and the first key behind these that has a record. To look
    /// for what replaces each record would take seconds in a full log.
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

    /// Whether storing an entry would change nothing.
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
