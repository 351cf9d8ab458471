//! Fuzz target: flash memory with arbitrary contents, and changes to it. A power cut can interrupt each change.
//!
//! Invariants:
//! - Opening never fails, whatever the contents.
//! - No key is read twice.
//! - Only erased words are written.
//! - A stored value is found, even after another power-up.
//! - If a change is interrupted, either all of it is stored or nothing, and all other values stay.

use super::work::at_most;
use arbitrary::{Arbitrary, Unstructured};
use oxmill_controller::messages::{Record, STORE_DAMAGED, Store};
use oxmill_store::{Flash, Log, Sector};
use std::collections::BTreeMap;

const WORDS: usize = 128;
const ERASED: u32 = u32::MAX;

#[derive(Clone)]
struct Memory {
    sectors: [[u32; WORDS]; 2],
    /// Number of writes and erases until the power fails; `None`: it does not fail.
    power: Option<u32>,
}

struct PowerCut;

impl Memory {
    fn spend(&mut self) -> bool {
        match &mut self.power {
            None => true,
            Some(0) => false,
            Some(left) => {
                *left -= 1;
                true
            }
        }
    }
}

impl Flash for Memory {
    type Error = PowerCut;
    fn sector_size(&self) -> u32 {
        4 * WORDS as u32
    }
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, PowerCut> {
        Ok(self.sectors[sector as usize][address as usize / 4])
    }
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), PowerCut> {
        let powered = self.spend();
        let slot = &mut self.sectors[sector as usize][address as usize / 4];
        assert_eq!(*slot, ERASED, "only erased words are programmed");
        // When the power fails during the write, the lower half of the word is still erased.
        *slot = if powered { word } else { word | 0xFFFF };
        if powered { Ok(()) } else { Err(PowerCut) }
    }
    fn erase(&mut self, sector: Sector) -> Result<(), PowerCut> {
        let powered = self.spend();
        let upto = if powered { WORDS } else { WORDS / 2 };
        self.sectors[sector as usize][..upto].fill(ERASED);
        if powered { Ok(()) } else { Err(PowerCut) }
    }
}

/// Maximum number of control-flow edges while the log is opened or changed once; the highest count when this was
/// chosen: 1,911.
const MOST_WORK: u64 = 8_000;

#[derive(Arbitrary)]
enum Action {
    Put(u8, u8, u8),
    Remove(u8),
    Erase,
    PowerUp,
    PutAndCut(u8, u8, u8, u8),
    RemoveAndCut(u8, u8),
    EraseAndCut(u8),
}

type Contents = BTreeMap<u16, Vec<u8>>;

fn contents(log: &mut Log<Memory>) -> Contents {
    let mut all = Contents::new();
    let read = log.for_each(|record| {
        assert!(all.insert(record.key, record.value.to_vec()).is_none(), "a key counts once");
    });
    assert!(read.is_ok(), "nothing is cut while it is read");
    all.remove(&STORE_DAMAGED);
    all
}

fn put(key: u8, length: u8, filler: u8) -> (Store, Vec<u8>) {
    let value = vec![filler; usize::from(length % 41)];
    let record = Record { key: u16::from(key), value: heapless::Vec::from_slice(&value).unwrap_or_default() };
    (Store::Put(record), value)
}

fn open(memory: Memory) -> Log<Memory> {
    match at_most(MOST_WORK, || Log::open(memory)) {
        Ok(log) => log,
        Err(PowerCut) => panic!("opens with power"),
    }
}

/// Makes a change, cuts the power during it, and powers up again. `after`: number of flash operations before the cut,
/// modulo 64. `new`: the contents after the change. `known` becomes `new` if the change was acknowledged, or if all
/// of it was stored. The caller compares `known` with the contents.
fn cut(
    mut log: Log<Memory>,
    after: u8,
    known: &mut Contents,
    new: Contents,
    change: impl FnOnce(&mut Log<Memory>) -> bool,
) -> Log<Memory> {
    log.flash_mut().power = Some(u32::from(after % 64));
    let acknowledged = change(&mut log);
    let mut memory = log.into_flash();
    memory.power = None;
    let mut log = open(memory);
    if acknowledged || contents(&mut log) == new {
        *known = new;
    }
    log
}

/// Runs the target on one input; panics if an invariant is violated.
pub fn run(data: &[u8]) {
    let mut input = Unstructured::new(data);
    let _ = all(&mut input);
}

fn all(input: &mut Unstructured) -> arbitrary::Result<()> {
    let mut memory = Memory { sectors: [[ERASED; WORDS]; 2], power: None };
    // The flash is either erased, or each sector starts with arbitrary words from the input.
    if input.ratio(1, 2)? {
        for sector in &mut memory.sectors {
            let used = input.int_in_range(0..=WORDS)?;
            for word in &mut sector[..used] {
                *word = input.arbitrary()?;
            }
        }
    }
    let mut log = open(memory);
    let mut known = contents(&mut log);
    while !input.is_empty() {
        match input.arbitrary()? {
            Action::Put(key, length, filler) => {
                let (change, value) = put(key, length, filler);
                if at_most(MOST_WORK, || log.store(&change)).is_ok() {
                    known.insert(u16::from(key), value);
                }
            }
            Action::Remove(key) => {
                if at_most(MOST_WORK, || log.store(&Store::Remove { from: u16::from(key), until: u16::from(key) + 1 }))
                    .is_ok()
                {
                    known.remove(&u16::from(key));
                }
            }
            Action::Erase => {
                let _ = at_most(MOST_WORK, || log.erase_spare());
            }
            Action::PowerUp => log = open(log.into_flash()),
            Action::PutAndCut(key, length, filler, after) => {
                let (change, value) = put(key, length, filler);
                let new = known.clone().into_iter().chain([(u16::from(key), value)]).collect();
                log = cut(log, after, &mut known, new, |log| at_most(MOST_WORK, || log.store(&change)).is_ok());
            }
            Action::RemoveAndCut(key, after) => {
                let key = u16::from(key);
                let mut new = known.clone();
                new.remove(&key);
                let change = Store::Remove { from: key, until: key + 1 };
                log = cut(log, after, &mut known, new, |log| at_most(MOST_WORK, || log.store(&change)).is_ok());
            }
            Action::EraseAndCut(after) => {
                let new = known.clone();
                log = cut(log, after, &mut known, new, |log| at_most(MOST_WORK, || log.erase_spare()).is_ok());
            }
        }
        assert_eq!(contents(&mut log), known);
    }
    Ok(())
}
