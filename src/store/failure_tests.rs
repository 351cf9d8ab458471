//! Tests with writes and erases that fail while the power is on, and with repeated power cuts. Every change that the
//! log has accepted must be found again.

use super::*;
use proptest::prelude::*;

/// How an operation fails.
#[derive(Clone, Copy, Debug)]
enum Fault {
    /// The operation is refused and has no effect.
    Refused,
    /// The operation is done in part, and fails. A write programs only the bits of this mask; the mask also determines
    /// how many words an erase erases.
    Partly(u32),
    /// The operation is complete, but is reported as failed.
    Reported,
    /// The power is cut during the operation, which is done in part as with `Partly`.
    Cut(u32),
}

/// Flash on which operations fail according to a list. Each fault of the list has the number of operations that succeed
/// before it.
#[derive(Clone, Debug)]
struct Worn {
    sectors: [Vec<u32>; 2],
    faults: Vec<(u32, Fault)>,
    left: u32,
    gone: bool,
    reads: u32,
}

impl Worn {
    fn next(&mut self) -> Option<Fault> {
        if self.gone {
            return Some(Fault::Refused);
        }
        let (left, fault) = *self.faults.first()?;
        if self.left < left {
            self.left += 1;
            return None;
        }
        self.left = 0;
        self.faults.remove(0);
        self.gone = matches!(fault, Fault::Cut(_));
        Some(fault)
    }
}

impl Flash for Worn {
    type Error = ();
    fn sector_size(&self) -> u32 {
        4 * self.sectors[0].len() as u32
    }
    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, ()> {
        self.reads += 1;
        Ok(self.sectors[sector as usize][address as usize / 4])
    }
    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), ()> {
        let fault = self.next();
        let slot = &mut self.sectors[sector as usize][address as usize / 4];
        match fault {
            None => {
                assert_eq!(*slot, ERASED, "only erased words are programmed");
                *slot = word;
                return Ok(());
            }
            Some(Fault::Refused) => {}
            Some(Fault::Reported) => *slot &= word,
            Some(Fault::Partly(bits) | Fault::Cut(bits)) => *slot &= word | !bits,
        }
        Err(())
    }
    fn erase(&mut self, sector: Sector) -> Result<(), ()> {
        let fault = self.next();
        let words = &mut self.sectors[sector as usize];
        let done = match fault {
            None | Some(Fault::Reported) => words.len(),
            Some(Fault::Refused) => 0,
            Some(Fault::Partly(bits) | Fault::Cut(bits)) => bits as usize % (words.len() + 1),
        };
        words[..done].fill(ERASED);
        if fault.is_none() { Ok(()) } else { Err(()) }
    }
}

fn worn() -> Log<Worn> {
    with_sectors_of(SIZE)
}

fn with_sectors_of(size: u32) -> Log<Worn> {
    let words = vec![ERASED; size as usize / 4];
    Log::open(Worn { sectors: [words.clone(), words], faults: Vec::new(), left: 0, gone: false, reads: 0 }).unwrap()
}

type Map = BTreeMap<u16, Vec<u8>>;

fn stored(log: &mut Log<Worn>) -> Map {
    let mut all = BTreeMap::new();
    log.for_each(|r| assert!(all.insert(r.key, r.value.to_vec()).is_none(), "a key counts once")).unwrap();
    all.remove(&STORE_DAMAGED);
    all
}

fn series() -> impl Strategy<Value = Vec<(Store, u8)>> {
    let one = prop_oneof![
        8 => (0_u16..7, proptest::collection::vec(any::<u8>(), 0..60)).prop_map(|(key, v)| put(key, &v)),
        1 => (0_u16..7, 0_u16..7).prop_map(|(a, b)| Store::Remove { from: a.min(b), until: a.max(b) }),
    ];
    // Each change comes with a number, which decides whether there is time for an erase before the change, and whether
    // a restart follows the change.
    proptest::collection::vec((one, 0..12_u8), 1..150)
}

fn faults() -> impl Strategy<Value = Vec<(u32, Fault)>> {
    let any_bits = || {
        prop_oneof![
            any::<u32>(),
            Just(0),
            Just(u32::MAX),
            (0..4_u32).prop_map(|b| !(0xFF << (8 * b))),
            (0..32_u32).prop_map(|b| !(1 << b))
        ]
    };
    let fault = prop_oneof![
        1 => Just(Fault::Refused),
        1 => any_bits().prop_map(Fault::Partly),
        1 => Just(Fault::Reported),
        3 => any_bits().prop_map(Fault::Cut),
    ];
    proptest::collection::vec((0_u32..120, fault), 1..8)
}

/// A compaction (a move of all records to the other sector) fails at any one of its writes, in any way. Changes that
/// the log accepts afterwards must survive a restart.
#[test]
fn a_move_that_fails_takes_nothing_along() {
    let faults = [Fault::Refused, Fault::Reported, Fault::Partly(0x00FF_FFFF), Fault::Partly(0xFF00_0000)];
    for (word, fault) in (0..=101).flat_map(|word| faults.map(|fault| (word, fault))) {
        let mut log = worn();
        log.erase_spare().unwrap();
        for key in 0..4 {
            log.store(&put(key, &[key as u8; 92])).unwrap();
        }
        log.store(&put(0, b"older")).unwrap();
        log.flash.faults = vec![(word, fault)];
        // The log has room for a short record, but not for this one, so it is compacted.
        let moved = log.store(&put(0, &[7; 92]));
        assert_eq!(moved, Err(StoreError::Flash(())), "{word}");
        let taken = log.store(&put(9, b"on")).is_ok();
        let mut log = Log::open(log.flash).unwrap();
        let found = stored(&mut log);
        assert_eq!(found.contains_key(&9), taken, "word {word}, {fault:?}");
        let old = found.get(&0).is_some_and(|value| value == b"older");
        assert!(old || found.get(&0).is_some_and(|value| *value == [7; 92]), "word {word}, {fault:?}");
    }
}

/// After a failed write nothing can be stored until the spare sector has been erased. `needs_erase_soon` reports this.
#[test]
fn what_failed_needs_an_erase_soon() {
    let mut log = with_sectors_of(4 * RESERVE);
    log.store(&put(1, b"old")).unwrap();
    assert!(log.needs_erase() && !log.needs_erase_soon());
    log.flash.faults = vec![(1, Fault::Cut(0x00FF_0000))];
    assert!(log.store(&put(1, b"new")).is_err());
    assert!(log.needs_erase_soon());
    log.flash.gone = false;
    let mut log = Log::open(log.flash).unwrap();
    assert!(log.needs_erase_soon());
    log.erase_spare().unwrap();
    assert!(!log.needs_erase_soon());
    log.store(&put(1, b"new")).unwrap();
    assert_eq!(stored(&mut log), BTreeMap::from([(1, b"new".to_vec())]));
}

/// Reads of a full log must be few, because the watchdog allows the control task half a second. On a board a read takes
/// about a hundred cycles, or a thousand if the log has more than eight gaps (damaged places). So the log must not be
/// searched again for each of its records.
#[test]
fn a_full_log_is_soon_looked_through() {
    let mut log = with_sectors_of(16 * 1024);
    log.erase_spare().unwrap();
    for n in 0_u32..1364 {
        let key = if n < 120 { 400 + n } else { 600 + n % 120 };
        log.store(&put(key as u16, &n.to_le_bytes())).unwrap();
    }
    for gap in 0..12 {
        log.flash.sectors[0][3 + 3 * (200 + 2 * gap)] ^= 1;
    }
    let mut log = Log::open(log.flash).unwrap();
    assert!(log.unmapped < log.end);
    let mut reads = |what, act: &mut dyn FnMut(&mut Log<Worn>)| {
        let before = log.flash.reads;
        act(&mut log);
        let reads = log.flash.reads - before;
        assert!(reads < 200_000, "{what}: {reads} reads");
    };
    reads("power-up", &mut |log| assert_eq!(stored(log).len(), 240));
    reads("nothing to remove", &mut |log| log.store(&Store::Remove { from: 0, until: 400 }).unwrap());
    reads("move", &mut |log| log.store(&Store::Remove { from: STORE_DAMAGED, until: STORE_DAMAGED + 1 }).unwrap());
    assert_eq!(stored(&mut log).len(), 240);
}

/// The memory stores a record, but reports a failure. A restart would find this record as valid. So the change back to
/// the old state must be written, even if it seems to change nothing.
#[test]
fn a_record_that_was_reported_as_failed_is_replaced() {
    for back in [put(1, b"old"), Store::Remove { from: 1, until: 2 }] {
        let mut log = worn();
        log.erase_spare().unwrap();
        let mut model = Map::new();
        if let Store::Put(_) = back {
            log.store(&back).unwrap();
        }
        log.flash.faults = vec![(2, Fault::Reported)];
        assert!(log.store(&put(1, b"new")).is_err());
        log.store(&back).unwrap();
        apply(&mut model, &back);
        assert_eq!(stored(&mut Log::open(log.flash).unwrap()), model);
    }
}

/// Stores changes while operations fail. Each restart must find all accepted changes; a change that failed may be found
/// or not.
fn play(series: Vec<(Store, u8)>, faults: Vec<(u32, Fault)>) -> Result<(), TestCaseError> {
    let mut log = worn();
    log.flash.faults = faults;
    let mut possible = vec![Map::new()];
    for (next, chance) in series {
        if log.needs_erase() && chance > 3 {
            let _ = log.erase_spare();
        }
        let mut after = possible.clone();
        after.iter_mut().for_each(|model| apply(model, &next));
        match log.store(&next) {
            Ok(()) => {
                possible = after;
                let now = stored(&mut log);
                prop_assert!(possible.contains(&now), "{:?} gives {:?}", next, now);
            }
            Err(StoreError::Full) => {}
            Err(StoreError::Flash(())) => possible.extend(after),
        }
        if log.flash.gone || chance == 0 || chance == 7 {
            let mut flash = log.flash;
            flash.gone = false;
            log = Log::open(flash).unwrap();
            let found = stored(&mut log);
            prop_assert!(possible.contains(&found), "found {:?} of {:#?}", found, possible);
            possible = vec![found];
        }
    }
    Ok(())
}

/// Returns changes of up to three times [`KEYS`] keys, which is more than one walk over the log finds.
fn many_keys() -> impl Strategy<Value = Vec<Store>> {
    let one = prop_oneof![
        20 => (0_u16..3 * KEYS as u16, proptest::collection::vec(any::<u8>(), 0..5)).prop_map(|(key, v)| put(key, &v)),
        1 => (0_u16..3 * KEYS as u16, 0..3 * KEYS as u16).prop_map(|(a, b)| Store::Remove { from: a, until: b.min(a + 200) }),
        1 => Just(put(u16::MAX, b"last")),
    ];
    proptest::collection::vec(one, 1..1500)
}

proptest! {
    #![proptest_config(some_cases())]

    #[test]
    fn a_log_of_many_keys_is_a_map(changes in many_keys()) {
        let mut log = with_sectors_of(8192);
        let mut model = Map::new();
        for next in &changes {
            if log.needs_erase() {
                log.erase_spare().unwrap();
            }
            log.store(next).unwrap();
            apply(&mut model, next);
        }
        prop_assert_eq!(stored(&mut log), model.clone());
        let before = log.end;
        for (from, until) in [(u16::MAX, u16::MAX), (3 * KEYS as u16, u16::MAX)] {
            log.store(&Store::Remove { from, until }).unwrap();
        }
        prop_assert_eq!(log.end, before, "nothing is removed and nothing written");
        prop_assert_eq!(stored(&mut Log::open(log.flash).unwrap()), model);
    }

    #[test]
    fn what_was_taken_is_found_again(series in series(), faults in faults()) {
        play(series, faults)?;
    }
}
