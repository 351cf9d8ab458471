//! Tests of the settings log on a flash memory in RAM. After a power cut at any operation, each key has its old or its
//! new value.

#[path = "damage_tests.rs"]
mod damage;
#[path = "failure_tests.rs"]
mod failure;

use super::*;
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::vec::Vec;

const SIZE: u32 = 512;

/// Returns the number of random cases of each property: 64, or `PROPTEST_CASES`.
fn some_cases() -> ProptestConfig {
    let cases = std::env::var("PROPTEST_CASES").map_or(64, |cases| cases.parse().expect("a number"));
    ProptestConfig { cases, ..ProptestConfig::default() }
}

/// Flash in RAM whose power can be cut. `power`: number of operations that still succeed. After them, each operation is
/// done only in part and fails.
#[derive(Clone, Debug)]
struct Mock {
    sectors: [Vec<u32>; 2],
    /// For each sector: `true` if its last erase was complete. After an incomplete erase, cells that read as ones may
    /// not hold what is written to them.
    whole: [bool; 2],
    power: Option<u32>,
    operations: u32,
    reads: u32,
    /// Location of a word that a power cut left half written, and its missing bits.
    torn: Option<(Sector, u32, u32)>,
    /// If the power is cut during a write, only these bits of its word are still programmed.
    torn_bits: u32,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct PowerCut;

impl Mock {
    fn new() -> Self {
        let words = vec![ERASED; SIZE as usize / 4];
        Self {
            sectors: [words.clone(), words],
            whole: [false; 2],
            power: None,
            operations: 0,
            reads: 0,
            torn: None,
            torn_bits: 0,
        }
    }

    fn spend(&mut self) -> bool {
        self.operations += 1;
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

impl Flash for Mock {
    type Error = PowerCut;
    fn sector_size(&self) -> u32 {
        SIZE
    }
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, PowerCut> {
        self.reads += 1;
        Ok(self.sectors[sector as usize][address as usize / 4])
    }
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), PowerCut> {
        let powered = self.spend();
        let torn = self.torn_bits;
        let slot = &mut self.sectors[sector as usize][address as usize / 4];
        assert_eq!(*slot, ERASED, "only erased words are programmed");
        assert!(self.whole[sector as usize], "an erase that was cut short is made again before anything is written");
        *slot = if powered { word } else { word | !torn };
        if !powered {
            self.torn = Some((sector, address, *slot ^ word));
        }
        if powered { Ok(()) } else { Err(PowerCut) }
    }
    fn erase(&mut self, sector: Sector) -> Result<(), PowerCut> {
        let powered = self.spend();
        let words = &mut self.sectors[sector as usize];
        // An interrupted erase can look complete or incomplete.
        let upto = if powered || self.torn_bits & 1 != 0 { words.len() } else { words.len() / 2 };
        words[..upto].fill(ERASED);
        self.whole[sector as usize] = powered;
        if powered { Ok(()) } else { Err(PowerCut) }
    }
}

fn count(log: &Log<Mock>) -> u32 {
    log.flash.operations
}

fn put(key: u16, bytes: &[u8]) -> Store {
    Store::Put(Record { key, value: heapless::Vec::from_slice(bytes).unwrap() })
}

/// Returns the values of all keys, and whether damage is reported.
fn found(log: &mut Log<Mock>) -> (BTreeMap<u16, Vec<u8>>, bool) {
    let mut all = BTreeMap::new();
    log.for_each(|r| assert!(all.insert(r.key, r.value.to_vec()).is_none(), "a key counts once")).unwrap();
    let told = all.remove(&STORE_DAMAGED);
    assert!(told.as_ref().is_none_or(Vec::is_empty));
    (all, told.is_some())
}

fn contents(log: &mut Log<Mock>) -> BTreeMap<u16, Vec<u8>> {
    let (all, told) = found(log);
    assert!(!told, "there is no damage");
    all
}

fn apply(model: &mut BTreeMap<u16, Vec<u8>>, change: &Store) {
    match change {
        Store::Put(r) => {
            model.insert(r.key, r.value.to_vec());
        }
        Store::Remove { from, until } => model.retain(|key, _| !(*from..*until).contains(key)),
    }
}

/// Stores a change as the owner of the log does: first erases the spare sector if it is not erased.
fn change(log: &mut Log<Mock>, change: &Store) -> Result<(), StoreError<PowerCut>> {
    if log.needs_erase() {
        log.erase_spare()?;
    }
    log.store(change)
}

#[test]
fn records_come_back_after_a_restart() {
    let mut log = Log::open(Mock::new()).unwrap();
    change(&mut log, &put(100, &[1, 2, 3, 4])).unwrap();
    change(&mut log, &put(7, b"G20 line")).unwrap();
    change(&mut log, &put(100, &[5, 6, 7, 8])).unwrap();
    change(&mut log, &Store::Remove { from: 7, until: 8 }).unwrap();
    let mut log = Log::open(log.flash).unwrap();
    assert_eq!(contents(&mut log), BTreeMap::from([(100, vec![5, 6, 7, 8])]));
}

#[test]
fn foreign_contents_become_an_empty_log() {
    let mut flash = Mock::new();
    flash.sectors[0].fill(0x1234_5678);
    flash.sectors[1].fill(0);
    let mut log = Log::open(flash).unwrap();
    assert!(contents(&mut log).is_empty());
    assert!(log.needs_erase());
}

#[test]
fn a_full_log_says_so_and_keeps_what_it_has() {
    let mut log = Log::open(Mock::new()).unwrap();
    let mut stored = BTreeMap::new();
    for key in 0.. {
        let record = put(key, &[key as u8; 40]);
        match change(&mut log, &record) {
            Ok(()) => apply(&mut stored, &record),
            Err(error) => {
                assert_eq!(error, StoreError::Full);
                break;
            }
        }
    }
    assert!(stored.len() >= 9);
    let mut log = Log::open(log.flash).unwrap();
    assert_eq!(contents(&mut log), stored);
}

#[test]
fn a_sector_is_used_to_its_last_word() {
    let mut log = Log::open(Mock::new()).unwrap();
    let mut stored = BTreeMap::new();
    for key in 0.. {
        // A record has two words besides its value.
        let left = (SIZE - log.end) as usize;
        let length = if left > 100 { 40 } else { left - 8 };
        let record = put(key, &vec![key as u8; length]);
        change(&mut log, &record).unwrap();
        apply(&mut stored, &record);
        if left <= 100 {
            // Compaction copies everything to the other sector, with the new record in place of the old one.
            let record = put(key, &vec![0xAA; length]);
            assert_eq!(log.end, SIZE);
            change(&mut log, &record).unwrap();
            apply(&mut stored, &record);
            break;
        }
    }
    assert_eq!(log.end, SIZE);
    let mut log = Log::open(log.flash).unwrap();
    assert_eq!(contents(&mut log), stored);
}

#[test]
fn what_stands_there_already_is_not_written_again() {
    let mut log = Log::open(Mock::new()).unwrap();
    change(&mut log, &put(100, &[1, 2, 3, 4])).unwrap();
    change(&mut log, &put(101, &[1, 2, 3, 4])).unwrap();
    let before = count(&log);
    change(&mut log, &put(100, &[1, 2, 3, 4])).unwrap();
    change(&mut log, &Store::Remove { from: 102, until: 200 }).unwrap();
    assert_eq!(count(&log), before);
    change(&mut log, &Store::Remove { from: 100, until: 101 }).unwrap();
    let before = count(&log);
    change(&mut log, &Store::Remove { from: 100, until: 101 }).unwrap();
    assert_eq!(count(&log), before);
    change(&mut log, &put(100, &[1, 2, 3, 4])).unwrap();
    assert_eq!(contents(&mut log).len(), 2);
}

#[test]
fn a_failed_write_spoils_its_record_only() {
    let mut log = Log::open(Mock::new()).unwrap();
    change(&mut log, &put(1, b"kept")).unwrap();
    log.flash.power = Some(1);
    assert!(log.store(&put(2, b"lost")).is_err());
    log.flash.power = None;
    change(&mut log, &put(3, b"later")).unwrap();
    let mut log = Log::open(log.flash).unwrap();
    assert_eq!(contents(&mut log), BTreeMap::from([(1, b"kept".to_vec()), (3, b"later".to_vec())]));
}

fn changes() -> impl Strategy<Value = Vec<Store>> {
    let one = prop_oneof![
        6 => (0_u16..6, proptest::collection::vec(any::<u8>(), 0..20)).prop_map(|(key, v)| put(key, &v)),
        1 => (0_u16..6, 0_u16..6).prop_map(|(a, b)| Store::Remove { from: a.min(b), until: a.max(b) }),
    ];
    proptest::collection::vec(one, 1..60)
}

/// Cuts the power at each operation of the series. If the operation is a write, only the bits `torn_bits` of its word
/// are programmed. Afterwards the log holds the state before or after the interrupted change, and still works.
fn cut_everywhere(changes: &[Store], torn_bits: u32) -> Result<(), TestCaseError> {
    let whole = {
        let mut log = Log::open(Mock::new()).unwrap();
        for c in changes {
            change(&mut log, c).unwrap();
        }
        log.flash.operations
    };
    for power in 0..whole {
        let mut flash = Mock::new();
        flash.power = Some(power);
        flash.torn_bits = torn_bits;
        let (mut before, mut after) = (BTreeMap::new(), BTreeMap::new());
        let mut flash = match Log::open(flash.clone()) {
            Err(PowerCut) => {
                let mut kept = flash;
                let _ = kept.erase(Sector::A);
                kept
            }
            Ok(mut log) => {
                for c in changes {
                    apply(&mut after, c);
                    if change(&mut log, c).is_err() {
                        break;
                    }
                    before.clone_from(&after);
                }
                log.flash
            }
        };
        flash.power = None;
        let torn = flash.torn;
        let mut log = Log::open(flash).unwrap();
        let (stored, told) = found(&mut log);
        prop_assert!(stored == before || stored == after, "{stored:?} is neither {before:?} nor {after:?}");
        // A power cut may be reported as damage only if it interrupted the write of a crc, and if the unprogrammed bits
        // lie in a single byte.
        let one_byte = |missing: u32| missing.to_le_bytes().iter().filter(|byte| **byte != 0).count() == 1;
        let like_damage = torn.is_some_and(|(sector, address, missing)| {
            one_byte(missing) && (address == 4 || log.is_erased(sector, address + 4).unwrap())
        });
        prop_assert!(!told || like_damage, "a power cut is told as damage: {torn:?}");
        change(&mut log, &put(3, b"on")).unwrap();
        let (stored, still) = found(&mut log);
        prop_assert_eq!(still, told);
        prop_assert!(stored.get(&3).is_some_and(|v| v == b"on"));
    }
    Ok(())
}

/// The power cut leaves a partial record whose crc would fit if one of its bytes were changed. But the changed record
/// would have another length, so the partial record must not be reported as damage.
#[test]
fn a_crc_that_fits_by_chance_is_no_damage() {
    let value = heapless::Vec::from_slice(&[203, 117, 14, 83, 92, 38, 228, 0, 129, 48]).unwrap();
    cut_everywhere(&[Store::Put(Record { key: 0, value })], 2_909_146_938).unwrap();
}

proptest! {
    #![proptest_config(some_cases())]

    #[test]
    fn the_log_is_a_map(changes in changes()) {
        let mut log = Log::open(Mock::new()).unwrap();
        let mut model = BTreeMap::new();
        for c in &changes {
            change(&mut log, c).unwrap();
            apply(&mut model, c);
            prop_assert_eq!(contents(&mut log), model.clone());
        }
        prop_assert_eq!(contents(&mut Log::open(log.flash).unwrap()), model);
    }

    #[test]
    fn a_power_cut_loses_nothing(changes in changes(), torn_bits: u32) {
        cut_everywhere(&changes, torn_bits)?;
    }
}
