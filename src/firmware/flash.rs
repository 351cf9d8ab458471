//! The `Settings` store of the firmware: opens the `Log` of `oxmill-store` in the board's flash and restores each
//! `Record` into the controller, stores a change, finds a `record` by number, and erases a sector before it is needed
//! (`wants_erase`, `wants_erase_soon`), unless the flash is `worn`: one erase has failed. `defmt` logs what cannot be
//! stored or found; a number is found by `seek`.
//!
//! A write is a few words and is made when the controller asks for it. An erase deafens the processor for a quarter of a
//! second on the STM32 boards, so it is made ahead of need and only when the caller says that nothing moves, turns, burns
//! or waits.

use crate::boards::SettingsFlash;
use crate::control::BoardController;
use oxmill_controller::messages::{Record, Store};
use oxmill_store::{Log, StoreError};

/// The log, as long as the flash works.
pub struct Settings {
    log: Option<Log<SettingsFlash>>,
    /// An erase has failed: it is not tried again before the next power-up.
    worn: bool,
}

impl Settings {
    /// Finds the log, or makes an empty one in flash that holds none, and hands its records to the controller.
    pub fn open(flash: SettingsFlash, controller: &mut BoardController) -> Settings {
        let mut log = Log::open(flash).ok();
        if let Some(log) = &mut log
            && log.for_each(|record| controller.restore(&record)).is_err()
        {
            defmt::error!("the settings cannot be read");
        }
        if log.is_none() {
            defmt::error!("the settings sectors cannot be used");
        }
        Settings { log, worn: false }
    }

    /// A stored record, by its number among those that count.
    pub fn record(&mut self, number: u16) -> Option<Record> {
        let (mut left, mut found) = (number, None);
        let seek = |record: Record| match left.checked_sub(1) {
            Some(less) => left = less,
            None => found = found.take().or(Some(record)),
        };
        self.log.as_mut()?.for_each(seek).ok()?;
        found
    }

    /// Carries out a change; whether it was stored.
    pub fn store(&mut self, change: &Store) -> bool {
        match self.log.as_mut().map(|log| log.store(change)) {
            Some(Ok(())) => true,
            failure => {
                match failure {
                    Some(Err(StoreError::Full)) => defmt::error!("no room to store a setting"),
                    _ => defmt::error!("a setting could not be written"),
                }
                false
            }
        }
    }

    /// Whether an erase is due.
    pub fn wants_erase(&self) -> bool {
        !self.worn && self.log.as_ref().is_some_and(Log::needs_erase)
    }

    /// Whether there will soon be no room without it.
    pub fn wants_erase_soon(&self) -> bool {
        !self.worn && self.log.as_ref().is_some_and(Log::needs_erase_soon)
    }

    /// Erases the sector that holds nothing that counts.
    pub fn erase(&mut self) {
        if let Some(log) = &mut self.log
            && log.erase_spare().is_err()
        {
            defmt::error!("a settings sector cannot be erased");
            self.worn = true;
        }
    }
}
