//! Supply of an STM32F4: the core's voltage scale, the detector that interrupts when the supply falls, and a restart
//! that waits until the supply has risen again.

use super::safe_state;
use core::cell::Cell;
use critical_section::Mutex;
use stm32f4xx_hal::pac;

/// Writes a whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers a register takes; safe because the macro
        // writes only registers of the supply and of its interrupt line, which reach no memory, and each value is
        // explained where it is written.
        unsafe { $register.bits($bits) }
    }};
}

/// Raises the voltage of the core (voltage scale) for the full clock. An F411 or F412 starts with the scale for 84 MHz
/// (reference manuals, PWR_CR, VOS), and the HAL leaves it there. The scale can be changed only while the PLL is off.
#[cfg(any(feature = "stm32f411", feature = "stm32f412"))]
pub fn full_core_voltage(pwr: &pac::PWR) {
    clock_supply();
    pwr.cr().modify(|r, w| raw!(w, r.bits() | 0b11 << 14));
}

/// Enables the clock of the supply control, and waits for the clock by reading the enable register back. Before the
/// clock arrives, writes are lost and reads are useless (errata sheets, "Delay after an RCC peripheral clock
/// enabling").
fn clock_supply() {
    // SAFETY: unsafe because a bit of the clock control is set without owning it; safe because no task runs yet.
    let enable = unsafe { (*pac::RCC::ptr()).apb1enr() };
    enable.modify(|_, w| w.pwren().set_bit());
    let _ = enable.read();
}

/// Switches over-drive off, and returns true if it was on. Call while the core runs on the internal oscillator, before
/// the PLL is switched off (RM0390, "Exiting from Over-drive mode").
#[cfg(feature = "stm32f446")]
pub fn leave_over_drive() -> bool {
    // SAFETY: unsafe because the owner is by-passed; safe because no task runs yet.
    let cr = unsafe { (*pac::PWR::ptr()).cr() };
    let was_on = cr.read().oden().bit_is_set();
    cr.modify(|_, w| w.odswen().clear_bit().oden().clear_bit());
    was_on
}

/// Switches over-drive on. Call while the PLL starts (RM0390, "Entering Over-drive mode").
#[cfg(feature = "stm32f446")]
pub fn enter_over_drive() {
    // SAFETY: unsafe because the owner is by-passed; safe because no task runs yet.
    let pwr = unsafe { &*pac::PWR::ptr() };
    pwr.cr().modify(|_, w| w.oden().set_bit());
    while pwr.csr().read().odrdy().bit_is_clear() {}
    pwr.cr().modify(|_, w| w.odswen().set_bit());
    while pwr.csr().read().odswrdy().bit_is_clear() {}
}

/// Vector of the voltage detector, whose name differs between the device crates.
#[cfg(not(feature = "stm32f401"))]
const VOLTAGE_VECTOR: pac::Interrupt = pac::Interrupt::PVD;
#[cfg(feature = "stm32f401")]
const VOLTAGE_VECTOR: pac::Interrupt = pac::Interrupt::EXTI16_PVD;

/// EXTI line of the voltage detector.
const VOLTAGE_LINE: u32 = 1 << 16;

/// The function to call when the supply falls too low, set by [`watch_voltage`].
static LOW_VOLTAGE: Mutex<Cell<fn() -> !>> = Mutex::new(Cell::new(unwatched));

/// Initial value of `LOW_VOLTAGE`. Never called: the vector is masked until [`watch_voltage`] has set a function.
fn unwatched() -> ! {
    safe_state();
    cortex_m::peripheral::SCB::sys_reset()
}

/// Calls `low_voltage` when the supply falls below 2.9 V (2.85 to 2.99 V). `low_voltage` must make the machine safe
/// while there is still power; it runs at the highest priority and does not return.
pub fn watch_voltage(pwr: &pac::PWR, exti: &pac::EXTI, low_voltage: fn() -> !) {
    critical_section::with(|cs| LOW_VOLTAGE.borrow(cs).set(low_voltage));
    detect_voltage(pwr);
    // The detector's output rises when the voltage falls.
    exti.rtsr().modify(|r, w| raw!(w, r.bits() | VOLTAGE_LINE));
    exti.pr().write(|w| raw!(w, VOLTAGE_LINE));
    exti.imr().modify(|r, w| raw!(w, r.bits() | VOLTAGE_LINE));
    // SAFETY: unsafe because priorities and masks may break critical sections; safe because the handler only ends the
    // program.
    unsafe {
        cortex_m::Peripherals::steal().NVIC.set_priority(VOLTAGE_VECTOR, 0);
        pac::NVIC::unmask(VOLTAGE_VECTOR);
    }
    // If the supply had already fallen before edge detection was enabled, no edge follows. So check the level, too.
    if voltage_is_low() {
        pac::NVIC::pend(VOLTAGE_VECTOR);
    }
}

/// Waits until the supply has risen to 3 V (rising threshold of the detector: 2.95 to 3.09 V). Call before the clocks
/// are set up. The chip already starts at 1.7 V, with a clock of 16 MHz. For a faster clock, the flash wait states in
/// use require at least 2.7 V (reference manual, "Relation between CPU clock frequency and flash memory read time"). A
/// small supply takes a tenth of a second to charge capacitors of a few millifarads.
pub fn await_voltage(pwr: &pac::PWR) {
    detect_voltage(pwr);
    if voltage_is_low() {
        defmt::warn!("waits for a supply of 3.1 V");
        while voltage_is_low() {}
    }
}

/// Switches on the detector at its highest threshold (PLS = 7): 2.9 V when the supply falls, and 0.1 V more when it
/// rises (data sheets, "Embedded reset and power control block characteristics").
fn detect_voltage(pwr: &pac::PWR) {
    clock_supply();
    pwr.cr().modify(|_, w| raw!(w.pvde().set_bit().pls(), 7));
    cortex_m::asm::delay(SETTLED_CYCLES);
}

/// Delay for the detector's first comparison: 10 us at the 16 MHz of a reset, more than the detector needs.
const SETTLED_CYCLES: u32 = 160;

fn voltage_is_low() -> bool {
    // SAFETY: unsafe because the owner is by-passed; safe because reading CSR has no effect.
    unsafe { (*pac::PWR::ptr()).csr().read().pvdo().bit_is_set() }
}

/// Handles the interrupt of the voltage detector; does not return.
#[cfg_attr(not(feature = "stm32f401"), unsafe(export_name = "PVD"))]
#[cfg_attr(feature = "stm32f401", unsafe(export_name = "EXTI16_PVD"))]
// unsafe because the linker takes the name on trust; safe because it is the vector's, and the signature fits.
extern "C" fn voltage_low() {
    critical_section::with(|cs| LOW_VOLTAGE.borrow(cs).get())()
}

/// Switches the core to the clock that it has after a reset (HSI). Call only when timing no longer matters.
fn slow_down() {
    // SAFETY: unsafe because the owner of the clocks is by-passed; safe because the program has ended.
    let rcc = unsafe { &*pac::RCC::ptr() };
    rcc.cr().modify(|_, w| w.hsion().set_bit());
    while rcc.cr().read().hsirdy().bit_is_clear() {}
    rcc.cfgr().modify(|_, w| w.sw().hsi());
    while !rcc.cfgr().read().sws().is_hsi() {}
}

/// Ends the program after a failure: logs `why`, and resets as soon as the supply is good. Until then the core runs at
/// 16 MHz, for which the wait states of the flash suffice at any supply voltage. The outputs stay driven meanwhile; in
/// a reset they would float.
pub fn restart(why: core::fmt::Arguments<'_>) -> ! {
    slow_down();
    defmt::error!("{}", defmt::Display2Format(&why));
    while voltage_is_low() {}
    cortex_m::peripheral::SCB::sys_reset()
}
