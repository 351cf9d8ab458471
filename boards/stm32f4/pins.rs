//! Sets up the pins that the pin table of the image names.
//!
//! The registers are raw: in the HAL, the number of a pin is part of its type, so the HAL cannot use pins from a table
//! that is read at run time. The registers of a port are those of reference manual RM0383, "GPIO registers"; all
//! STM32F4 have the same.

use super::registers::{Chip, Map, read, write, write_bsrr};
use super::step::{PORTS, Place, Pwm, bsrr};
use crate::pin_table::{Pin, PinTable, Role};
use stm32f4xx_hal::rcc::Rcc;

const PORT_SIZE: usize = 0x400;
const MODER: usize = 0x00;
const OTYPER: usize = 0x04;
const OSPEEDR: usize = 0x08;
const PUPDR: usize = 0x0C;
/// Alternate functions of pins 0 to 7; those of pins 8 to 15 follow.
const AFRL: usize = 0x20;
// MODER
const INPUT: u32 = 0;
const OUTPUT: u32 = 1;
const ALTERNATE: u32 = 2;
// PUPDR
const NO_PULL: u32 = 0;
const PULL_UP: u32 = 1;
const PULL_DOWN: u32 = 2;
/// OSPEEDR: edges of a few nanoseconds, for steps.
const MEDIUM: u32 = 1;
/// Alternate functions of TIM1 and TIM3 on all their pins (data sheets, "Alternate function mapping").
const TIM1: u32 = 1;
const TIM3: u32 = 2;

impl Place {
    /// Converts a pin of the table. Returns `None` if this image does not use the pin's port.
    fn of(pin: Pin) -> Option<Place> {
        (usize::from(pin.port) < PORTS).then(|| Place::new(usize::from(pin.port), u32::from(pin.number)))
    }
}

/// Returns the pin of a function; `None` if the board has none.
#[inline(never)]
pub(super) fn place(table: &PinTable, role: Role) -> Option<Place> {
    table.pin(role).and_then(Place::of)
}

/// Returns the pin of each function in `roles`, in the same order.
pub(super) fn places<const N: usize>(table: &PinTable, roles: &[Role; N]) -> [Option<Place>; N] {
    let mut places = [None; N];
    find(table, roles, &mut places);
    places
}

/// The loop of [`places`]. Takes slices, so that the compiler cannot unroll it.
#[inline(never)]
fn find(table: &PinTable, roles: &[Role], places: &mut [Option<Place>]) {
    for (place, role) in places.iter_mut().zip(roles) {
        *place = self::place(table, *role);
    }
}

// This function, `output` and `input` are not inlined, because they are called for some thirty pins.
/// Sets the `width` bits that belong to a pin in a register of its port.
#[inline(never)]
fn set(place: Place, register: usize, width: u32, value: u32) {
    let address = <Chip as Map>::GPIO + PORT_SIZE * place.port() + register;
    let at = place.pin() * width;
    write(address, read(address) & !(((1 << width) - 1) << at) | value << at);
}

/// Makes a pin a push-pull output. Sets the level first, so that the output has it from the beginning.
#[inline(never)]
pub(super) fn output(place: Place, high: bool) {
    write_bsrr::<Chip>(place.port(), bsrr(place.pin(), high));
    set(place, OTYPER, 1, 0);
    set(place, PUPDR, 2, NO_PULL);
    set(place, MODER, 2, OUTPUT);
}

/// Makes a pin an output with steep edges, for steps; low at first.
pub(super) fn step_output(place: Place) {
    output(place, false);
    set(place, OSPEEDR, 2, MEDIUM);
}

/// Makes a pin an input with a pull-up.
#[inline(never)]
pub(super) fn input(place: Place) {
    set(place, PUPDR, 2, PULL_UP);
    set(place, MODER, 2, INPUT);
}

/// Makes a pin the PWM output of its timer.
pub(super) fn pwm(place: Place, pwm: Pwm) {
    let timer = if pwm.timer == <Chip as Map>::TIM1 { TIM1 } else { TIM3 };
    set(place, PUPDR, 2, NO_PULL);
    let register = AFRL + 4 * (place.pin() / 8) as usize;
    set(Place::new(place.port(), place.pin() % 8), register, 4, timer);
    set(place, MODER, 2, ALTERNATE);
}

/// Makes the debug pins A15 and B4 inputs with a pull-down, unless the pin table uses them. After a reset these pins
/// have pull-ups. On a control board, a pull-up could switch on the MOSFET at such a pin.
pub(super) fn release_debug_pins(table: &PinTable) {
    for (port, number) in [(0, 15), (1, 4)] {
        if !Role::ALL.iter().any(|role| table.pin(*role) == Some(Pin { port, number })) {
            let place = Place::new(usize::from(port), u32::from(number));
            set(place, PUPDR, 2, PULL_DOWN);
            set(place, MODER, 2, INPUT);
        }
    }
}

/// Sets the pull resistor of an input (PUPDR): 0 for none, 1 for a pull-up, 2 for a pull-down.
pub(super) fn set_pull(place: Place, pull: u32) {
    set(place, PUPDR, 2, pull);
}

/// Starts the clocks of all ports that this image uses. Ports without a used pin get their clock, too, because
/// `InputPins::read` and `safe_state` access all ports.
pub(super) fn clock_ports(rcc: &mut Rcc) {
    rcc.ahb1enr().modify(|r, w| {
        // SAFETY: unsafe because the device crate cannot know which numbers the register takes; safe because bit 0 is
        // the clock of port A, and those of the other ports follow (RCC_AHB1ENR).
        unsafe { w.bits(r.bits() | ((1 << PORTS) - 1)) }
    });
    // Keep the clocks of the ports on while the processor sleeps, because steps go on. By the manuals of the F401 and
    // F411 (RCC_AHB1LPENR), the clock of port E would stop.
    rcc.ahb1lpenr().modify(|r, w| {
        // SAFETY: as above; the bits of this register are the same.
        unsafe { w.bits(r.bits() | ((1 << PORTS) - 1)) }
    });
    // An enabled clock takes some cycles to arrive; reading back waits for them.
    let _ = rcc.ahb1enr().read();
}
