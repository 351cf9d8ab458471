//! Tests with wrong bits and bytes in the memory. Only the records with wrong bytes may be lost. The damage must be
//! reported until the user confirms it, which removes the report.

use super::*;
use std::ops::Range;

const CONFIRM: Store = Store::Remove { from: STORE_DAMAGED, until: STORE_DAMAGED + 1 };

/// State of the spare sector when the damage occurs.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Spare {
    /// Never used.
    Blank,
    /// Erased, with its mark.
    Erased,
    /// Contains the log from before the last compaction.
    Old,
}

/// Returns a log with records of all kinds, and its changes in order, each with the addresses of its bytes.
fn image(spare: Spare) -> (Log<Mock>, Vec<(Range<u32>, Store)>) {
    let mut log = Log::open(Mock::new()).unwrap();
    let mut changes = vec![
        put(100, &80_f32.to_le_bytes()),
        put(20, &1_f32.to_le_bytes()),
        put(1000, &[0xA5; 24]),
        put(1005, &[7, 0, 0, 0, 0, 0, 0, 0, 0x5A, 0xA5, 0, 0, 0, 0, 0, 0, 255, 255, 255, 255, 255, 255, 255, 255]),
        put(1100, b"G21 G90 G17 (a remark that ends where no word does)"),
        put(1101, b""),
        put(1200, b"mill 7"),
        put(100, &81_f32.to_le_bytes()),
        put(110, &[0; 4]),
        Store::Remove { from: 110, until: 120 },
        put(777, &[255; 4]),
        put(2000, &1_f32.to_le_bytes()),
        put(122, &300_f32.to_le_bytes()),
    ];
    if spare == Spare::Old {
        log.erase_spare().unwrap();
        log.store(&put(100, &10_f32.to_le_bytes())).unwrap();
        let moved = put(5, &5_f32.to_le_bytes());
        log.appendable = false;
        log.store(&moved).unwrap();
        assert!(log.needs_erase());
        changes.splice(0..0, [put(100, &10_f32.to_le_bytes()), moved]);
    }
    let mut spans = Vec::new();
    let mut from = HEADER;
    for (at, change) in changes.iter().enumerate() {
        if spare != Spare::Old || at >= 2 {
            log.store(change).unwrap();
        }
        let words = match change {
            Store::Put(record) => record.value.len().div_ceil(4) as u32 + 2,
            Store::Remove { .. } => 3,
        };
        spans.push((from..from + 4 * words, change.clone()));
        from += 4 * words;
    }
    assert_eq!(log.end, from);
    if spare == Spare::Erased {
        log.erase_spare().unwrap();
    }
    (log, spans)
}

/// Returns whether wrong bytes at these addresses destroy a record. The padding bytes of a record do not count.
fn is_hit(span: &Range<u32>, change: &Store, addresses: &[u32]) -> bool {
    let length = match change {
        Store::Put(record) => record.value.len() as u32,
        Store::Remove { .. } => 2,
    };
    let filler = span.start + 4 + length..span.end - 4;
    addresses.iter().any(|address| span.contains(address) && !filler.contains(address))
}

/// Returns the values that must be found after damage at these addresses.
fn without(spans: &[(Range<u32>, Store)], addresses: &[u32]) -> BTreeMap<u16, Vec<u8>> {
    let mut model = BTreeMap::new();
    for (span, change) in spans {
        if !is_hit(span, change, addresses) {
            apply(&mut model, change);
        }
    }
    model
}

fn change_byte(flash: &mut Mock, sector: Sector, address: u32, bits: u8) {
    flash.sectors[sector as usize][address as usize / 4] ^= u32::from(bits) << (8 * (address % 4));
}

/// After any wrong byte (so also after any wrong bit), all other records are valid, and the damage is reported.
#[test]
fn a_wrong_byte_costs_one_record_and_is_told() {
    for spare in [Spare::Blank, Spare::Erased, Spare::Old] {
        let (log, spans) = image(spare);
        let (sector, end) = (log.sector, log.end);
        for address in 0..SIZE {
            let expected = without(&spans, &[address]);
            for bits in 1..=255 {
                let mut flash = log.flash.clone();
                change_byte(&mut flash, sector, address, bits);
                let (stored, told) = found(&mut Log::open(flash.clone()).unwrap());
                assert_eq!(stored, expected, "{spare:?}: {bits:#x} at {address}");
                // A wrong byte in the first word after the last record is not reported, because a power cut can leave
                // such a word, too.
                assert_eq!(told, !(end..end + 4).contains(&address), "{spare:?}: {bits:#x} at {address}");
                assert!(Log::is_in(&mut flash).unwrap());
            }
        }
    }
}

#[test]
fn a_wrong_byte_in_the_spare_sector_changes_nothing() {
    for spare in [Spare::Blank, Spare::Erased, Spare::Old] {
        let (log, spans) = image(spare);
        for address in 0..SIZE {
            for bits in 1..=255 {
                let mut flash = log.flash.clone();
                change_byte(&mut flash, log.sector.other(), address, bits);
                let mut log = Log::open(flash).unwrap();
                assert_eq!(contents(&mut log), without(&spans, &[]), "{spare:?}: {bits:#x} at {address}");
            }
        }
    }
}

/// If a header is completely lost, the records must still be found.
#[test]
fn a_lost_header_is_told() {
    let (log, spans) = image(Spare::Erased);
    let mut flash = log.flash.clone();
    for address in 0..HEADER {
        change_byte(&mut flash, log.sector, address, 0x3C);
    }
    let mut log = Log::open(flash).unwrap();
    assert_eq!(found(&mut log), (without(&spans, &[]), true));
    log.erase_spare().unwrap();
    log.store(&CONFIRM).unwrap();
    assert_eq!(contents(&mut Log::open(log.flash).unwrap()), without(&spans, &[]));
}

/// A damaged length or kind must not lead the reader into the middle of other records.
#[test]
fn damage_leads_nowhere() {
    let (log, spans) = image(Spare::Erased);
    let (first, _) = &spans[2];
    for length in 0..=255_u8 {
        for kind in [PUT, REMOVE] {
            let mut flash = log.flash.clone();
            let word = &mut flash.sectors[log.sector as usize][first.start as usize / 4];
            *word = *word & 0xFFFF_0000 | u32::from(length) << 8 | u32::from(kind);
            let same = *word == log.flash.sectors[log.sector as usize][first.start as usize / 4];
            let expected = if same { without(&spans, &[]) } else { without(&spans, &[first.start]) };
            assert_eq!(found(&mut Log::open(flash).unwrap()), (expected, !same), "{kind:#x} {length}");
        }
    }
}

/// A value may contain bytes that look like a record. If damage makes the reader search within the value, these bytes
/// must not be taken for a record.
#[test]
fn a_record_in_a_value_does_not_count() {
    let mut value = [b' '; 32];
    value[..2].copy_from_slice(&[255, 255]);
    let inner = Entry { kind: REMOVE, key: 0, value: heapless::Vec::from_slice(&value).unwrap() };
    let text: Vec<u8> = inner.words().iter().flat_map(|word| word.to_le_bytes()).collect();
    let mut log = Log::open(Mock::new()).unwrap();
    log.store(&put(7, b"kept")).unwrap();
    let outer = log.end;
    log.store(&put(1100, &text)).unwrap();
    log.store(&put(8, b"kept")).unwrap();
    change_byte(&mut log.flash, log.sector, outer, 1);
    let kept = BTreeMap::from([(7, b"kept".to_vec()), (8, b"kept".to_vec())]);
    assert_eq!(found(&mut Log::open(log.flash).unwrap()), (kept, true));
}

/// Two wrong bytes in the last record are reported, because a power cut does not leave such a record.
#[test]
fn a_last_record_with_more_wrong_bytes_is_told() {
    let (log, spans) = image(Spare::Erased);
    let (last, _) = spans.last().unwrap();
    for (one, other) in [(4, 5), (4, 7), (5, 6), (2, 6), (7, 9)] {
        let mut flash = log.flash.clone();
        for address in [last.start + one, last.start + other] {
            change_byte(&mut flash, log.sector, address, 0x81);
        }
        assert_eq!(found(&mut Log::open(flash).unwrap()), (without(&spans, &[last.start]), true), "{one} {other}");
    }
}

/// Damage is reported across power cycles, changes and compactions, until the record that reports it is removed. After
/// that the log is clean.
#[test]
fn damage_is_told_until_it_is_confirmed() {
    for (hit, moves) in [(0, 0), (0, 3), (13, 0), (13, 1), (41, 3), (1, 2)] {
        let (log, spans) = image(Spare::Erased);
        let mut flash = log.flash.clone();
        change_byte(&mut flash, log.sector, hit, 4);
        let mut model = without(&spans, &[hit]);
        let mut log = Log::open(flash).unwrap();
        let mut moved = 0;
        for value in 0_u32.. {
            let sector = log.sector;
            let next = put(300, &value.to_le_bytes());
            change(&mut log, &next).unwrap();
            apply(&mut model, &next);
            moved += u32::from(log.sector != sector);
            assert_eq!(found(&mut log), (model.clone(), true));
            log = Log::open(log.flash).unwrap();
            assert_eq!(found(&mut log), (model.clone(), true), "byte {hit}, {moved} moves");
            if moved == moves {
                break;
            }
        }
        change(&mut log, &CONFIRM).unwrap();
        assert_eq!(contents(&mut log), model);
        let mut log = Log::open(log.flash).unwrap();
        assert_eq!(contents(&mut log), model);
        // A second confirmation writes nothing.
        let before = count(&log);
        log.store(&CONFIRM).unwrap();
        assert_eq!(count(&log), before);
    }
}

/// The report of damage can be removed only while the spare sector is erased. Before that, `needs_erase_soon` is true.
#[test]
fn a_confirmation_waits_for_the_spare_sector() {
    let (log, _) = image(Spare::Blank);
    let mut flash = log.flash.clone();
    change_byte(&mut flash, log.sector, HEADER, 1);
    let mut log = Log::open(flash).unwrap();
    assert!(log.needs_erase() && log.needs_erase_soon());
    assert_eq!(log.store(&CONFIRM), Err(StoreError::Full));
    assert!(found(&mut Log::open(log.flash.clone()).unwrap()).1);
    log.erase_spare().unwrap();
    assert!(!log.needs_erase_soon());
    log.store(&CONFIRM).unwrap();
    assert!(!found(&mut Log::open(log.flash).unwrap()).1);
}

/// If the power is cut at any operation while a change and the confirmation of damage are stored, nothing is lost, and
/// the damage can be confirmed again.
#[test]
fn a_power_cut_in_the_confirmation_loses_nothing() {
    for hit in [0, 5, HEADER, HEADER + 21, 300] {
        let (log, spans) = image(Spare::Erased);
        let mut damaged = log.flash.clone();
        change_byte(&mut damaged, log.sector, hit, 0x10);
        let model = without(&spans, &[hit]);
        let confirm = |flash: Mock| {
            let mut log = Log::open(flash).unwrap();
            let later = put(300, b"on");
            let _ = change(&mut log, &later)
                .and_then(|()| change(&mut log, &CONFIRM))
                .and_then(|()| Ok(log.erase_spare()?));
            log.flash
        };
        let whole = confirm(damaged.clone()).operations - damaged.operations;
        assert!(whole > 10);
        let (mut told, mut clean) = (0, 0);
        for power in 0..whole {
            for torn_bits in [0, 0xFFFF_FFFF, 0x0F0F_0F0F, 0xFFFF_00FF] {
                let mut flash = damaged.clone();
                (flash.power, flash.torn_bits) = (Some(power), torn_bits);
                let mut flash = confirm(flash);
                flash.power = None;
                let (mut stored, tells) = found(&mut Log::open(flash.clone()).unwrap());
                stored.remove(&300);
                assert_eq!(stored, model, "byte {hit}, operation {power}");
                if tells {
                    told += 1
                } else {
                    clean += 1
                }
                let (mut stored, tells) = found(&mut Log::open(confirm(flash)).unwrap());
                assert_eq!(stored.remove(&300).as_deref(), Some(&b"on"[..]));
                assert_eq!((stored, tells), (model.clone(), false));
            }
        }
        assert!(told > 10 && clean > 0, "{told} {clean}");
    }
}

/// Words that resemble parts of a log.
fn any_word() -> impl Strategy<Value = u32> {
    let first = (prop_oneof![Just(PUT), Just(REMOVE)], 0_u8..104, 0_u16..8)
        .prop_map(|(kind, length, key)| u32::from(kind) | u32::from(length) << 8 | u32::from(key) << 16);
    prop_oneof![4 => first, 2 => any::<u32>(), 1 => Just(ERASED), 1 => Just(0), 1 => Just(MARK)]
}

/// Maximum number of reads for opening a log of [`SIZE`] bytes. In the worst case each word is read as the start of a
/// record of the maximum length. Everything else takes at most 1000 reads.
const OPENING: u32 = SIZE / 4 * (LONGEST_WORDS as u32 + 3) + 1000;

proptest! {
    #![proptest_config(some_cases())]

    /// A log opens on memory with any contents, with a limited number of reads, and can then store changes.
    #[test]
    fn any_memory_is_opened(
        a in proptest::collection::vec(any_word(), SIZE as usize / 4),
        b in proptest::collection::vec(any_word(), SIZE as usize / 4),
        sequences in (proptest::option::of(any::<u32>()), proptest::option::of(any::<u32>())),
    ) {
        let mut flash = Mock::new();
        flash.sectors = [a, b];
        for (sector, sequence) in flash.sectors.iter_mut().zip([sequences.0, sequences.1]) {
            if let Some(sequence) = sequence {
                sector[0] = sequence;
                sector[1] = crc(&[sequence]);
            }
        }
        let mut log = Log::open(flash).unwrap();
        prop_assert!(log.flash.reads < 2 * OPENING, "{} reads", log.flash.reads);
        let (mut model, _) = found(&mut log);
        log.flash.whole = [true; 2];
        for next in [put(3, b"on"), CONFIRM, put(4, b"and on")] {
            change(&mut log, &next).unwrap();
            if next != CONFIRM {
                apply(&mut model, &next);
            }
        }
        prop_assert_eq!(contents(&mut Log::open(log.flash).unwrap()), model);
    }

    /// With any damage after the header and at most one wrong byte in the header, all records outside the damage are
    /// valid.
    #[test]
    fn what_is_not_hit_holds(
        changes in changes(),
        hits in proptest::collection::vec((HEADER..SIZE, 1_u8..), 0..40),
        header in proptest::option::of((0..HEADER, 1_u8..)),
        restarts in proptest::bool::ANY,
    ) {
        let mut log = Log::open(Mock::new()).unwrap();
        let mut spans = Vec::new();
        for c in changes {
            let (sector, end) = (log.sector, log.end);
            change(&mut log, &c).unwrap();
            if log.sector != sector {
                // Compaction has copied all valid records to the other sector, so read all of them again.
                spans = records(&mut log);
            } else if log.end > end {
                spans.push((end..log.end, c));
            }
        }
        let mut flash = log.flash.clone();
        let mut addresses: Vec<u32> = Vec::new();
        for (address, bits) in hits.iter().copied().chain(header) {
            change_byte(&mut flash, log.sector, address, bits);
        }
        let byte = |flash: &Mock, at: u32| flash.sectors[log.sector as usize][at as usize / 4].to_le_bytes()[at as usize % 4];
        addresses.extend((0..SIZE).filter(|at| byte(&flash, *at) != byte(&log.flash, *at)));
        let mut log = Log::open(flash).unwrap();
        prop_assert!(log.flash.reads < 2 * OPENING, "{} reads", log.flash.reads);
        let mut model = without(&spans, &addresses);
        let (stored, told) = found(&mut log);
        prop_assert_eq!(&stored, &model);
        // Damage must be reported if an intact record follows it.
        let behind = spans.iter().rfind(|(span, change)| !is_hit(span, change, &addresses));
        let must_tell = behind.is_some_and(|(span, _)| addresses.iter().any(|a| *a < span.end));
        prop_assert!(told || !must_tell);
        prop_assert!(!told || !addresses.is_empty());
        prop_assert!(told || addresses.iter().all(|a| *a >= HEADER));
        for next in [put(3, b"on"), Store::Remove { from: 1, until: 3 }, put(2, b"and on")] {
            change(&mut log, &next).unwrap();
            apply(&mut model, &next);
            if restarts {
                log = Log::open(log.flash).unwrap();
            }
            prop_assert_eq!(found(&mut log), (model.clone(), told));
        }
        change(&mut log, &CONFIRM).unwrap();
        prop_assert_eq!(contents(&mut Log::open(log.flash).unwrap()), model);
    }
}

/// Returns the records of an undamaged log, and the bytes that they occupy.
fn records(log: &mut Log<Mock>) -> Vec<(Range<u32>, Store)> {
    let mut all = Vec::new();
    let mut address = HEADER;
    while let Some(entry) = log.checked_entry(address).unwrap() {
        let end = address + entry.size();
        let store = match entry.kind {
            PUT => put(entry.key, &entry.value),
            _ => Store::Remove { from: entry.key, until: entry.until() },
        };
        all.push((address..end, store));
        address = end;
    }
    assert_eq!(address, log.end);
    all
}
