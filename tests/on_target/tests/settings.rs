//! Tests of the settings log in the flash of the target. On a board this overwrites its settings and erases a sector
//! about ten times.
#![no_std]
#![no_main]
#![allow(missing_docs, reason = "code that defmt-test generates")]

use heapless::Vec;
use oxmill_boards::SettingsFlash;
use oxmill_controller::messages::{Record, Store};
use oxmill_on_target::settings_flash;
use oxmill_store::{Flash, Log, Sector};

fn put(key: u16, bytes: &[u8]) -> Store {
    Store::Put(Record { key, value: Vec::from_slice(bytes).unwrap() })
}

fn fresh() -> Log<SettingsFlash> {
    let mut flash = settings_flash();
    defmt::assert!(flash.erase(Sector::A).is_ok());
    defmt::assert!(flash.erase(Sector::B).is_ok());
    open()
}

fn open() -> Log<SettingsFlash> {
    match Log::open(settings_flash()) {
        Ok(log) => log,
        Err(_) => defmt::panic!("the flash fails"),
    }
}

fn value(log: &mut Log<SettingsFlash>, wanted: u16) -> Option<Vec<u8, 100>> {
    let mut found = None;
    let read = log.for_each(|record| {
        if record.key == wanted {
            found = Some(record.value);
        }
    });
    defmt::assert!(read.is_ok());
    found
}

#[defmt_test::tests]
mod suite {
    use super::{fresh, open, put, value};
    use oxmill_controller::messages::Store;
    use oxmill_on_target::settings_flash;
    use oxmill_store::{Flash, Sector, StoreError};

    #[test]
    fn an_erased_sector_is_all_ones_and_keeps_a_word() {
        let mut flash = settings_flash();
        for sector in [Sector::A, Sector::B] {
            defmt::assert!(flash.erase(sector).is_ok());
            for address in (0..flash.sector_size()).step_by(4) {
                defmt::assert!(matches!(flash.read(sector, address), Ok(u32::MAX)));
            }
        }
        let last = flash.sector_size() - 4;
        defmt::assert!(flash.write(Sector::A, last, 0x1234_5678).is_ok());
        defmt::assert!(matches!(flash.read(Sector::A, last), Ok(0x1234_5678)));
        defmt::assert!(matches!(flash.read(Sector::B, last), Ok(u32::MAX)));
        defmt::assert!(flash.erase(Sector::B).is_ok());
        defmt::assert!(matches!(flash.read(Sector::A, last), Ok(0x1234_5678)), "the sectors are apart");
        // The word was also read before the erase, so this read detects a stale word in a cache.
        defmt::assert!(flash.erase(Sector::A).is_ok());
        defmt::assert!(matches!(flash.read(Sector::A, last), Ok(u32::MAX)));
    }

    #[test]
    fn records_are_found_again() {
        let mut log = fresh();
        defmt::assert!(log.store(&put(100, &1.5_f32.to_le_bytes())).is_ok());
        defmt::assert!(log.store(&put(1100, b"G20 (a startup line)")).is_ok());
        defmt::assert!(log.store(&put(100, &2.5_f32.to_le_bytes())).is_ok());
        defmt::assert!(log.store(&Store::Remove { from: 1100, until: 1101 }).is_ok());
        let mut log = open();
        defmt::assert!(value(&mut log, 100).as_deref() == Some(&2.5_f32.to_le_bytes()));
        defmt::assert!(value(&mut log, 1100).is_none());
    }

    #[test]
    fn a_full_sector_moves_to_the_spare_and_says_when_to_erase() {
        let mut log = fresh();
        defmt::assert!(log.erase_spare().is_ok());
        defmt::assert!(log.store(&put(7, b"stays")).is_ok());
        let (mut moves, mut counter) = (0, 0_u32);
        while moves < 3 {
            counter += 1;
            match log.store(&put(8, &counter.to_le_bytes())) {
                Ok(()) => {}
                Err(_) => defmt::panic!("change {} was not taken", counter),
            }
            if log.needs_erase() {
                moves += 1;
                defmt::assert!(log.erase_spare().is_ok());
            }
        }
        // A record has 12 bytes, so three sectors of 16 KiB hold about four thousand records.
        defmt::assert!(counter > 3_000, "{} changes", counter);
        let mut log = open();
        defmt::assert!(value(&mut log, 7).as_deref() == Some(b"stays"));
        defmt::assert!(value(&mut log, 8).as_deref() == Some(&counter.to_le_bytes()));
    }

    #[test]
    fn without_an_erased_spare_a_full_log_refuses_and_keeps_what_it_has() {
        let mut log = fresh();
        let mut counter = 0_u32;
        let full = loop {
            counter += 1;
            match log.store(&put(8, &counter.to_le_bytes())) {
                Ok(()) => {}
                Err(error) => break error,
            }
        };
        defmt::assert!(matches!(full, StoreError::Full));
        let mut log = open();
        defmt::assert!(value(&mut log, 8).as_deref() == Some(&(counter - 1).to_le_bytes()));
    }
}
