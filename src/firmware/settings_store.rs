//! The settings store of the firmware: opens the log of `oxmill-store` in the board's flash, restores its records into
//! the controller, stores changes, and erases the spare sector before it is needed.
//!
//! A write programs only a few words, so it is done at once. An erase stalls the processor for a quarter of a second on
//! the STM32 boards, so it is done ahead of need. The caller starts it only if no motor moves, the spindle and the
//! laser are off, and no command waits. After a failed erase, no erase is tried until the next power-up.

use crate::BoardController;
use crate::boards::SettingsFlash;
use oxmill_controller::messages::{Record, Store};
use oxmill_store::{Log, StoreError};

/// The settings store. `log` is `None` if the flash cannot be used.
pub struct SettingsStore {
    log: Option<Log<SettingsFlash>>,
    /// `true` if an erase has failed. No erase is then tried before the next power-up.
    worn: bool,
}

impl SettingsStore {
    /// Opens the log and passes its records to the controller. If the flash has no log, creates an empty one.
    pub fn open(flash: SettingsFlash, controller: &mut BoardController) -> SettingsStore {
        let mut log = Log::open(flash).ok();
        if let Some(log) = &mut log
            && log.for_each(|record| controller.restore(&record)).is_err()
        {
            defmt::error!("the settings cannot be read");
        }
        if log.is_none() {
            defmt::error!("the settings sectors cannot be used");
        }
        SettingsStore { log, worn: false }
    }

    /// Returns the valid record with the index `number`, from 0; `None` if there are fewer.
    pub fn record(&mut self, number: u16) -> Option<Record> {
        let (mut left, mut found) = (number, None);
        let seek = |record: Record| match left.checked_sub(1) {
            Some(less) => left = less,
            None => found = found.take().or(Some(record)),
        };
        self.log.as_mut()?.for_each(seek).ok()?;
        found
    }

    /// Writes a change to the flash. Returns whether it was stored; `false` if there is no room or the write failed.
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

    /// Returns whether the spare sector needs an erase and can be erased (no erase has failed since power-up).
    pub fn wants_erase(&self) -> bool {
        !self.worn && self.log.as_ref().is_some_and(Log::needs_erase)
    }

    /// Returns whether an erase of the spare sector is urgent: without it, the log will soon have no room.
    pub fn wants_erase_soon(&self) -> bool {
        !self.worn && self.log.as_ref().is_some_and(Log::needs_erase_soon)
    }

    /// Erases the spare sector, which holds no valid records. Stalls the processor for a quarter of a second on the
    /// STM32 boards.
    pub fn erase(&mut self) {
        if let Some(log) = &mut self.log
            && log.erase_spare().is_err()
        {
            defmt::error!("a settings sector cannot be erased");
            self.worn = true;
        }
    }
}
