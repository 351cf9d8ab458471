//! Starts the clocks of the chip from its external oscillator. The same board is sold with different crystals, so the
//! frequency is measured at the start, against the internal oscillator.
//!
//! ```text
//!  HSE ──▶ / 31 (RTCPRE) ──▶ input of TIM11, channel 1: captures every eighth edge
//!  HSI, 16 MHz ───────────▶ counts of TIM11
//! ```
//! Without an external oscillator, or with an unknown frequency, the chip runs on its internal oscillator, which is
//! exact to a few percent: enough for a UART, but not for motion. The machine then stays locked, and the welcome line
//! says why.

use super::registers::{read, timer::*, write};
use crate::pin_table::PinTable;
use stm32f4xx_hal::pac;

/// Frequencies of crystals that boards with an STM32F4 have, MHz. The PLL makes exact clocks from each of them.
const KNOWN_MHZ: [u32; 4] = [8, 12, 16, 25];
/// Clock of TIM11 during the measurement: the internal oscillator, MHz.
const HSI_MHZ: u32 = 16;
/// Divider between the oscillator and TIM11 (RCC_CFGR, RTCPRE).
const DIVIDER: u32 = 31;
/// Edges of the divided clock from one capture to the next (TIM11_CCMR1, IC1PSC).
const EDGES: u32 = 8;
/// Number of intervals between captures that the measurement takes.
const CAPTURES: u32 = 16;
/// If the ready flag is not set in this many readings, the oscillator counts as missing. The readings take at least a
/// tenth of a second. A crystal starts within a few milliseconds.
const MOST_LOOKS: u32 = 400_000;
/// If the capture flag is not set in this many readings, the measurement fails. The readings take at least a
/// millisecond.
const MOST_LOOKS_AT_CAPTURE: u32 = 4_000;

/// Registers of TIM11, which only this measurement uses (RM0383, "TIM10/11 registers"; RM0368 and RM0390 have the
/// same). They are raw, because the HAL cannot capture the divided oscillator.
const TIM11: usize = 0x4001_4800;
const CCMR1: usize = 0x18;
const CCER: usize = 0x20;
const OR: usize = 0x50;
/// TIM11_CCMR1: channel 1 captures its input, at every eighth edge.
const CAPTURES_EIGHTH: u32 = 0b11 << 2 | 1;
/// TIM11_OR: the input of channel 1 is the divided oscillator (TI1_RMP).
const IS_OSCILLATOR: u32 = 0b10;
/// TIM11_SR: a capture has come.
const CAPTURED: u32 = 1 << 1;

/// Switches the external oscillator on, measures it, and returns its frequency in MHz. This is the frequency in the
/// table or, if the table has none, the one of `KNOWN_MHZ` that fits the measurement. Returns `None` if the oscillator
/// does not start, if the table's frequency contradicts the measurement, or if no frequency of `KNOWN_MHZ` fits. The
/// chip must run on its internal oscillator, as after a reset.
#[inline(never)]
pub fn find_oscillator(rcc: &pac::RCC, table: &PinTable) -> Option<u32> {
    // Two writes, because HSEBYP can only be written while the oscillator is off (reference manual, RCC_CR, HSEBYP).
    rcc.cr().modify(|_, w| w.hsebyp().bit(table.is_external()));
    rcc.cr().modify(|_, w| w.hseon().set_bit());
    if !(0..MOST_LOOKS).any(|_| rcc.cr().read().hserdy().bit_is_set()) {
        return None;
    }
    let ticks = measure(rcc);
    match table.oscillator_mhz().map(u32::from) {
        // Reject a frequency in the table that is far off: with it, the PLL would not lock, or would run too fast.
        Some(mhz) => Some(mhz).filter(|mhz| ticks.is_none_or(|ticks| is_near(*mhz, ticks, 100))),
        None => known(ticks?),
    }
}

/// Makes the external oscillator the source of the PLL, in place of the internal one, with the same output frequency.
/// Call after the HAL has set up all clocks for the internal oscillator, whose frequency the compiler knows. For a
/// frequency that is known only at run time, the HAL would need 3 KB of code that searches for dividers.
#[inline(never)]
pub fn change_source(rcc: &pac::rcc::RegisterBlock, mhz: u32) {
    rcc.cfgr().modify(|_, w| w.sw().hsi());
    while !rcc.cfgr().read().sws().is_hsi() {}
    #[cfg(feature = "stm32f446")]
    let has_over_drive = super::leave_over_drive();
    rcc.cr().modify(|_, w| w.pllon().clear_bit());
    while rcc.cr().read().pllrdy().bit_is_set() {}
    rcc.pllcfgr().modify(|r, w| {
        // Frequency of the PLL's own oscillator (VCO) in MHz. All clocks of our boards give a whole and even number.
        let vco_mhz = HSI_MHZ * u32::from(r.plln().bits()) / u32::from(r.pllm().bits());
        // The input of the PLL is 2 MHz, as the reference manuals recommend (RCC_PLLCFGR, PLLM), or 1 MHz. RM0368 asks
        // for a PLLN of 192 or more, so an F401, whose VCO runs at 336 MHz, always takes 1 MHz.
        let input_mhz = if mhz.is_multiple_of(2) && cfg!(not(feature = "stm32f401")) { 2 } else { 1 };
        // SAFETY: unsafe because the device crate cannot know which dividers are valid; safe because they are: PLLM is
        // 2 to 26, and PLLN 168 to 400.
        unsafe { w.pllm().bits((mhz / input_mhz) as u8).plln().bits((vco_mhz / input_mhz) as u16).pllsrc().hse() }
    });
    rcc.cr().modify(|_, w| w.pllon().set_bit());
    #[cfg(feature = "stm32f446")]
    if has_over_drive {
        super::enter_over_drive();
    }
    while rcc.cr().read().pllrdy().bit_is_clear() {}
    rcc.cfgr().modify(|_, w| w.sw().pll());
    while !rcc.cfgr().read().sws().is_pll() {}
}

/// Measures the external oscillator. Returns the ticks of the internal oscillator from the first to the last capture,
/// or `None` if no capture comes.
fn measure(rcc: &pac::RCC) -> Option<u32> {
    rcc.cfgr().modify(|_, w| w.rtcpre().set(DIVIDER as u8));
    rcc.apb2enr().modify(|_, w| w.tim11en().set_bit());
    // An enabled clock takes some cycles to arrive; reading back waits for them.
    let _ = rcc.apb2enr().read();
    for (register, value) in [(OR, IS_OSCILLATOR), (CCMR1, CAPTURES_EIGHTH), (CCER, 1), (ARR, 0xFFFF), (CR1, 1)] {
        write(TIM11 + register, value);
    }
    // Ignore the first capture, which may be from before the counter ran.
    capture()?;
    let first = capture()?;
    let mut last = first;
    for _ in 0..CAPTURES {
        last = capture()?;
    }
    rcc.apb2enr().modify(|_, w| w.tim11en().clear_bit());
    Some(last.wrapping_sub(first) & 0xFFFF)
}

/// Waits for the next capture of TIM11. Returns its time in ticks of the internal oscillator, or `None` if none comes.
#[inline(never)]
fn capture() -> Option<u32> {
    let has_come = (0..MOST_LOOKS_AT_CAPTURE).any(|_| read(TIM11 + SR) & CAPTURED != 0);
    // Reading the capture clears its flag.
    has_come.then(|| read(TIM11 + CCR1))
}

/// Returns true if a frequency in MHz fits the measured ticks to within `thousandths` (50 = 5 %). The internal
/// oscillator is within 1 % at 25 degrees, and within -8 to 4.5 % from -40 to 105 (data sheets, "HSI oscillator
/// characteristics").
#[inline(never)]
fn is_near(mhz: u32, ticks: u32, thousandths: u32) -> bool {
    let expected = HSI_MHZ * DIVIDER * EDGES * CAPTURES / mhz;
    expected.abs_diff(ticks) * 1000 <= expected * thousandths
}

/// Returns the frequency of `KNOWN_MHZ` that fits the measured ticks. The tolerance is smaller at 25 MHz, because
/// oscillators of 24 and 26 MHz also exist. Even so, these two may be taken for 25 MHz.
fn known(ticks: u32) -> Option<u32> {
    KNOWN_MHZ.into_iter().find(|mhz| is_near(*mhz, ticks, if *mhz == 25 { 50 } else { 80 }))
}
