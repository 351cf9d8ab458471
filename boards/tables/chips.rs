//! The chips that a board's file may name, and the pins of their packages. Sources: the data sheets' tables "Pin and
//! ball definitions" of STM32F401xB/C, F401xD/E, F405xx and F407xx, F411xC/E, F412xG and F446xC/E.

use oxmill_boards::pin_table::Pin;

/// A microcontroller that a board can have.
#[derive(Debug, PartialEq, Eq)]
pub struct Chip {
    /// ST's part number without the letters for package and temperature range.
    pub name: &'static str,
    /// Name of the chip in probe-rs, the program that flashes it over a debug probe.
    pub probe_name: &'static str,
    /// Pins that the package has: a mask for each port from A to H, bit 0 for pin 0.
    pins: [u16; 8],
}

const NONE: u16 = 0;
const ALL: u16 = 0xFFFF;
/// All pins of port B except B11. These packages have VCAP (for the capacitor of the core's regulator) in its place.
const NO_11: u16 = !(1 << 11);
const C13_TO_15: u16 = 0xE000;
const H0_1: u16 = 0b11;

const UFQFPN48: [u16; 8] = [ALL, NO_11, C13_TO_15, NONE, NONE, NONE, NONE, H0_1];
/// LQFP100 of chips without B11, such as the STM32F412.
const LQFP100_NO_11: [u16; 8] = [ALL, NO_11, ALL, ALL, ALL, NONE, NONE, H0_1];
const LQFP64: [u16; 8] = [ALL, NO_11, ALL, 1 << 2, NONE, NONE, NONE, H0_1];
const LQFP100: [u16; 8] = [ALL, ALL, ALL, ALL, ALL, NONE, NONE, H0_1];
const LQFP144: [u16; 8] = [ALL, ALL, ALL, ALL, ALL, ALL, ALL, H0_1];

/// The chips that the entry `chip` of a board's file can name.
pub const CHIPS: [Chip; 11] = [
    Chip { name: "STM32F401CC", probe_name: "STM32F401CCUx", pins: UFQFPN48 },
    Chip { name: "STM32F411CE", probe_name: "STM32F411CEUx", pins: UFQFPN48 },
    Chip { name: "STM32F401RE", probe_name: "STM32F401RETx", pins: LQFP64 },
    Chip { name: "STM32F411RE", probe_name: "STM32F411RETx", pins: LQFP64 },
    Chip { name: "STM32F407VE", probe_name: "STM32F407VETx", pins: LQFP100 },
    Chip { name: "STM32F407VG", probe_name: "STM32F407VGTx", pins: LQFP100 },
    Chip { name: "STM32F407ZE", probe_name: "STM32F407ZETx", pins: LQFP144 },
    Chip { name: "STM32F412VG", probe_name: "STM32F412VGTx", pins: LQFP100_NO_11 },
    Chip { name: "STM32F446RE", probe_name: "STM32F446RETx", pins: LQFP64 },
    Chip { name: "STM32F446VE", probe_name: "STM32F446VETx", pins: LQFP100 },
    Chip { name: "STM32F446ZE", probe_name: "STM32F446ZETx", pins: LQFP144 },
];

impl Chip {
    /// Returns whether the chip's package has this pin. A small package lacks many: UFQFPN48 has no port D.
    pub fn has(&self, pin: Pin) -> bool {
        self.pins.get(usize::from(pin.port)).is_some_and(|port| port >> pin.number & 1 != 0)
    }
}
