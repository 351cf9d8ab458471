//! Emulates the settings flash, which this machine lacks: RAM at `_settings_start`, which the linker script reserves.
//! It behaves like flash: after an erase, each word can be written once. Its contents survive a reset of the machine,
//! but not the end of QEMU.

use oxmill_store::{Flash, Sector};

/// Bytes of a sector, the same as on the STM32 boards.
const SECTOR_BYTES: u32 = 16 * 1024;
const ERASED: u32 = u32::MAX;

/// Error: the word to be written has not been erased since it was last written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotErased;

/// The two settings sectors.
pub struct SettingsFlash(());

unsafe extern "C" {
    /// Start of the settings sectors, from the linker script.
    static mut _settings_start: u32;
}

impl SettingsFlash {
    /// Returns access to the sectors that the linker script reserves.
    #[allow(clippy::new_without_default, reason = "there is one, and the board makes it")]
    pub fn new() -> SettingsFlash {
        SettingsFlash(())
    }

    fn at(sector: Sector, address: u32) -> *mut u32 {
        let start = &raw mut _settings_start as u32;
        let sector = if sector == Sector::A { start } else { start + SECTOR_BYTES };
        (sector + (address & (SECTOR_BYTES - 4))) as *mut u32
    }
}

impl Flash for SettingsFlash {
    type Error = NotErased;

    fn sector_size(&self) -> u32 {
        SECTOR_BYTES
    }

    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, NotErased> {
        // SAFETY: unsafe because a raw address is read; safe because it is aligned and lies in RAM that no section of
        // the program uses.
        Ok(unsafe { Self::at(sector, address).read_volatile() })
    }

    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), NotErased> {
        if self.read(sector, address)? != ERASED {
            return Err(NotErased);
        }
        // SAFETY: as in `read`.
        unsafe { Self::at(sector, address).write_volatile(word) };
        Ok(())
    }

    fn erase(&mut self, sector: Sector) -> Result<(), NotErased> {
        for address in (0..SECTOR_BYTES).step_by(4) {
            // SAFETY: as in `read`.
            unsafe { Self::at(sector, address).write_volatile(ERASED) };
        }
        Ok(())
    }
}
