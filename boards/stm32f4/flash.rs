//! The `SettingsFlash` of an STM32F4: two of its 16 KiB sectors. A write stores a word of 32 bits at once (parallelism
//! 32), which needs a supply of 2.7 V or more.
//!
//! Only these two sectors are ever written or erased. While a word is written or a sector erased, every fetch from
//! flash stalls, and with it the whole program. A word takes 16 us (at most 100 us), an erase 250 ms (at most 500 ms;
//! data sheet of the STM32F411, table "Flash memory programming"). The caller decides when to start an operation.

use oxmill_store::{Flash, Sector};
use stm32f4xx_hal::pac;

const SECTOR_BYTES: u32 = 16 * 1024;
/// Start of the flash memory; its first four sectors have 16 KiB each (reference manual, flash module organization).
const FLASH_START: u32 = 0x0800_0000;

/// KEYR: the two words that unlock the control register.
const KEYS: [u32; 2] = [0x4567_0123, 0xCDEF_89AB];
// Bits of the status register (SR).
const BUSY: u32 = 1 << 16;
/// Error bits of SR: operation error, write protection, alignment, parallelism, sequence. Writing 1 clears a bit.
const ERRORS: u32 = 1 << 1 | 1 << 4 | 1 << 5 | 1 << 6 | 1 << 7;
// Bits of the control register (CR).
const PROGRAM: u32 = 1 << 0;
const ERASE: u32 = 1 << 1;
const SECTOR_SHIFT: u32 = 3;
const PARALLELISM_32: u32 = 0b10 << 8;
const START: u32 = 1 << 16;
const LOCK: u32 = 1 << 31;
// Bits of the access control register (ACR).
const DATA_CACHE: u32 = 1 << 10;
const DATA_CACHE_RESET: u32 = 1 << 12;

/// Writes a whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which values are valid for the register; safe because
        // each value consists of the constants above, of a sector number that `erase` has checked, or of bits read from
        // the same register. Only sectors 1 and 2 are ever erased, and they hold no part of the program.
        unsafe { $register.bits($bits) }
    }};
}

/// Why a write or an erase failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FlashError {
    /// The error bits of SR; 0 if the sector to be erased is not one of the settings sectors.
    Refused(u32),
    /// The value read back differs from the value written.
    Unlike,
}

/// The two settings sectors.
pub struct SettingsFlash {
    flash: pac::FLASH,
    before_stall: fn(),
    after_stall: fn(),
}

unsafe extern "C" {
    /// Start of the settings sectors, from the linker script.
    static _settings_start: u32;
}

impl SettingsFlash {
    /// Returns access to the two sectors that the linker script reserves. `before_stall` and `after_stall` are called,
    /// with interrupts off, before and after each operation that stalls the processor. `before_stall` must prepare
    /// everything that cannot wait until the operation has ended, such as receiving.
    pub fn new(flash: pac::FLASH, before_stall: fn(), after_stall: fn()) -> SettingsFlash {
        SettingsFlash { flash, before_stall, after_stall }
    }

    fn address(sector: Sector) -> u32 {
        let start = &raw const _settings_start as u32;
        match sector {
            Sector::A => start,
            Sector::B => start + SECTOR_BYTES,
        }
    }

    /// Writes or erases, with interrupts off. `control`: value of CR during the operation. `operation`: starts the
    /// write or the erase. Returns the error bits of SR, if any.
    fn operate(&mut self, control: u32, operation: impl FnOnce(&pac::FLASH)) -> Result<(), FlashError> {
        let flash = &self.flash;
        let errors = critical_section::with(|_| {
            (self.before_stall)();
            while flash.sr().read().bits() & BUSY != 0 {}
            flash.sr().write(|w| raw!(w, ERRORS));
            for key in KEYS {
                flash.keyr().write(|w| raw!(w, key));
            }
            flash.cr().write(|w| raw!(w, control | PARALLELISM_32));
            operation(flash);
            while flash.sr().read().bits() & BUSY != 0 {}
            let errors = flash.sr().read().bits() & ERRORS;
            flash.cr().write(|w| raw!(w, LOCK));
            (self.after_stall)();
            errors
        });
        if errors == 0 { Ok(()) } else { Err(FlashError::Refused(errors)) }
    }

    /// Empties the data cache. An erase does not update it, so it may hold old words of the sectors (reference manual,
    /// "Flash erase sequences").
    fn forget_cached(&self) {
        let acr = self.flash.acr();
        let before = acr.read().bits();
        // The cache can be reset only while it is off.
        acr.write(|w| raw!(w, before & !DATA_CACHE));
        acr.write(|w| raw!(w, before & !DATA_CACHE | DATA_CACHE_RESET));
        acr.write(|w| raw!(w, before & !DATA_CACHE));
        acr.write(|w| raw!(w, before));
    }
}

impl Flash for SettingsFlash {
    type Error = FlashError;

    fn sector_size(&self) -> u32 {
        SECTOR_BYTES
    }

    fn read(&mut self, sector: Sector, address: u32) -> Result<u32, FlashError> {
        let address = Self::address(sector) + (address & (SECTOR_BYTES - 4));
        // SAFETY: unsafe because a raw address is read; safe because it is aligned and lies in the settings sectors,
        // which are always readable memory.
        Ok(unsafe { (address as *const u32).read_volatile() })
    }

    fn write(&mut self, sector: Sector, address: u32, word: u32) -> Result<(), FlashError> {
        let at = (Self::address(sector) + (address & (SECTOR_BYTES - 4))) as *mut u32;
        self.operate(PROGRAM, |_| {
            // SAFETY: unsafe because a raw address is written; safe because it is aligned and lies in the settings
            // sectors, where the program has neither code nor data.
            unsafe { at.write_volatile(word) }
        })?;
        if self.read(sector, address)? == word { Ok(()) } else { Err(FlashError::Unlike) }
    }

    fn erase(&mut self, sector: Sector) -> Result<(), FlashError> {
        let number = (Self::address(sector) - FLASH_START) / SECTOR_BYTES;
        // Sector 0 has the vectors, sectors 3 and up have the code.
        if !(1..=2).contains(&number) {
            return Err(FlashError::Refused(0));
        }
        let control = ERASE | number << SECTOR_SHIFT;
        let done = self.operate(control, |flash| {
            flash.cr().write(|w| raw!(w, control | PARALLELISM_32 | START));
        });
        self.forget_cached();
        done
    }
}
