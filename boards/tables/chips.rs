//! The chips: which family they belong to, and which pins their packages have. Sources: the data sheets' tables "Pin and
//! ball definitions" of STM32F401xB/C, F401xD/E, F405xx and F407xx, F411xC/E and F446xC/E.

use oxmill_boards::pin_table::Pin;

/// A chip.
#[derive(Debug, PartialEq, Eq)]
pub struct Chip {
    /// As ST writes it, without package and temperature.
    pub name: &'static str,
    /// As probe-rs writes it.
    pub probe_name: &'static str,
    /// For each port from A on, a bit for each pin of the package.
    pins: [u16; 8],
}

const NONE: u16 = 0;
const ALL: u16 = 0xFFFF;
/// Without pin 11, where these packages have VCAP.
const NO_11: u16 = !(1 << 11);
const C13_TO_15: u16 = 0xE000;
const H0_1: u16 = 0b11;

const UFQFPN48: [u16; 8] = [ALL, NO_11, C13_TO_15, NONE, NONE, NONE, NONE, H0_1];
const LQFP64: [u16; 8] = [ALL, NO_11, ALL, 1 << 2, NONE, NONE, NONE, H0_1];
const LQFP100: [u16; 8] = [ALL, ALL, ALL, ALL, ALL, NONE, NONE, H0_1];
const LQFP144: [u16; 8] = [ALL, ALL, ALL, ALL, ALL, ALL, ALL, H0_1];

/// All chips.
pub const CHIPS: [Chip; 10] = [
    Chip { name: "STM32F401CC", probe_name: "STM32F401CCUx", pins: UFQFPN48 },
    Chip { name: "STM32F411CE", probe_name: "STM32F411CEUx", pins: UFQFPN48 },
    Chip { name: "STM32F401RE", probe_name: "STM32F401RETx", pins: LQFP64 },
    Chip { name: "STM32F411RE", probe_name: "STM32F411RETx", pins: LQFP64 },
    Chip { name: "STM32F407VE", probe_name: "STM32F407VETx", pins: LQFP100 },
    Chip { name: "STM32F407VG", probe_name: "STM32F407VGTx", pins: LQFP100 },
    Chip { name: "STM32F407ZE", probe_name: "STM32F407ZETx", pins: LQFP144 },
    Chip { name: "STM32F446RE", probe_name: "STM32F446RETx", pins: LQFP64 },
    Chip { name: "STM32F446VE", probe_name: "STM32F446VETx", pins: LQFP100 },
    Chip { name: "STM32F446ZE", probe_name: "STM32F446ZETx", pins: LQFP144 },
];

impl Chip {
    /// Returns whether the package has a pin.
    pub fn has(&self, pin: Pin) -> bool {
        self.pins.get(usize::from(pin.port)).is_some_and(|port| port >> pin.number & 1 != 0)
    }
}
