//! The pin table of a board: which pin of the chip has which function, and which crystal the chip has. The table is
//! one block of the image. It begins with a mark and ends with a checksum, so that a tool can find and replace it
//! without a compiler. The firmware reads the table during its start.
//!
//! The layout in the image, [`SIZE`] bytes:
//!
//! | offset | bytes | contents |
//! |---|---|---|
//! | 0 | 8 | [`MAGIC`] |
//! | 8 | 24 | name of the board, ASCII, filled up with 0 |
//! | 32 | 1 | frequency of the oscillator in MHz; 0 = measure it |
//! | 33 | 1 | 1 if an external clock drives the oscillator's input, 0 if a crystal does |
//! | 34 | 1 | number of the image that the table is for |
//! | 35 | 1 | 0 |
//! | 36 | 40 | the pin of each [`Role`], in the order of their numbers: port * 16 + number, or [`NO_PIN`] |
//! | 76 | 4 | CRC-32 (ISO-HDLC) of the bytes before it, little-endian |

use crate::checksum;

/// First bytes of a table. The last of them is the version of the layout.
pub const MAGIC: [u8; 8] = *b"OXMPINS\x01";
/// Size of a table, bytes.
pub const SIZE: usize = 80;
/// Maximum length of a board's name, bytes.
pub const NAME_SIZE: usize = 24;
/// Entry of a function that has no pin.
pub const NO_PIN: u8 = 0xFF;

const NAME_AT: usize = 8;
const OSCILLATOR_AT: usize = 32;
const IMAGE_AT: usize = 34;
const PINS_AT: usize = 36;
const CRC_AT: usize = 76;

/// Functions that a pin can have. The number of a function is the index of its entry in the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u8)]
#[allow(missing_docs, reason = "the names say it")]
pub enum Role {
    StepX,
    StepY,
    StepZ,
    /// Step of the fourth motor: the second motor of an axis, or axis A.
    StepFourth,
    DirectionX,
    DirectionY,
    DirectionZ,
    DirectionFourth,
    /// Enable input of the drivers. A board with a separate enable input for each driver has up to four.
    Enable,
    SecondEnable,
    ThirdEnable,
    FourthEnable,
    SpindleOn,
    SpindleDirection,
    SpindlePwm,
    Flood,
    Mist,
    /// First output for programs (M64 P0).
    ProgramOutput,
    SecondProgramOutput,
    LimitX,
    LimitY,
    LimitZ,
    /// Limit switch of the fourth motor.
    LimitFourth,
    Probe,
    Door,
    Hold,
    Start,
    Reset,
    DriverFault,
    AtSpeed,
    /// First input for programs (M66 P0).
    ProgramInput,
    SecondProgramInput,
    /// Switch of the motors' supply: on when high. The firmware switches it on at its start.
    MotorPower,
}

impl Role {
    /// All functions, in the order of the table.
    pub const ALL: [Role; 33] = [
        Role::StepX,
        Role::StepY,
        Role::StepZ,
        Role::StepFourth,
        Role::DirectionX,
        Role::DirectionY,
        Role::DirectionZ,
        Role::DirectionFourth,
        Role::Enable,
        Role::SecondEnable,
        Role::ThirdEnable,
        Role::FourthEnable,
        Role::SpindleOn,
        Role::SpindleDirection,
        Role::SpindlePwm,
        Role::Flood,
        Role::Mist,
        Role::ProgramOutput,
        Role::SecondProgramOutput,
        Role::LimitX,
        Role::LimitY,
        Role::LimitZ,
        Role::LimitFourth,
        Role::Probe,
        Role::Door,
        Role::Hold,
        Role::Start,
        Role::Reset,
        Role::DriverFault,
        Role::AtSpeed,
        Role::ProgramInput,
        Role::SecondProgramInput,
        Role::MotorPower,
    ];
}

/// A pin of the chip.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Pin {
    /// 0 for port A.
    pub port: u8,
    /// 0 to 15.
    pub number: u8,
}

impl Pin {
    /// Returns the channel of TIM1 that this pin can output: 0 for channel 1; `None` if there is none. The pins of the
    /// links to the host (A9 to A11) count as pins without a channel. Source: data sheets, "Alternate function
    /// mapping"; the same for all chips of `boards/tables/chips.rs`.
    pub const fn channel_of_tim1(self) -> Option<usize> {
        match (self.port, self.number) {
            (0, 8) | (4, 9) => Some(0),
            (4, 11) => Some(1),
            (4, 13) => Some(2),
            (4, 14) => Some(3),
            _ => None,
        }
    }

    /// Returns the channel of TIM3 that this pin can output: 0 for channel 1; `None` if there is none. Source: data
    /// sheets, "Alternate function mapping"; the same for all chips of `boards/tables/chips.rs`.
    pub const fn channel_of_tim3(self) -> Option<usize> {
        match (self.port, self.number) {
            (0, 6) | (1, 4) | (2, 6) => Some(0),
            (0, 7) | (1, 5) | (2, 7) => Some(1),
            (1, 0) | (2, 8) => Some(2),
            (1, 1) | (2, 9) => Some(3),
            _ => None,
        }
    }
}

/// A pin table. Its methods do not check whether a pin is suitable for its role: the tool that makes the table does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct PinTable([u8; SIZE]);

impl PinTable {
    /// Returns a table without pins, as an image contains it until a board is chosen. Its checksum is wrong, so
    /// `is_intact` returns false.
    pub const fn none(image: u8) -> PinTable {
        let mut bytes = [NO_PIN; SIZE];
        let mut at = 0;
        while at < MAGIC.len() {
            bytes[at] = MAGIC[at];
            at += 1;
        }
        bytes[OSCILLATOR_AT] = 0;
        bytes[IMAGE_AT] = image;
        PinTable(bytes)
    }

    /// Makes a table. `image`: number of the image that the table is for. `name`: name of the board, cut to
    /// [`NAME_SIZE`] bytes. `mhz`: frequency of the oscillator; with 0, the firmware measures it. `is_external`:
    /// `true` if an external clock drives the oscillator's input, `false` if a crystal does.
    pub fn new(image: u8, name: &str, mhz: u8, is_external: bool, pins: impl Fn(Role) -> Option<Pin>) -> PinTable {
        let mut bytes = [0; SIZE];
        bytes[..MAGIC.len()].copy_from_slice(&MAGIC);
        for (to, from) in bytes[NAME_AT..OSCILLATOR_AT].iter_mut().zip(name.bytes()) {
            *to = from;
        }
        bytes[OSCILLATOR_AT] = mhz;
        bytes[OSCILLATOR_AT + 1] = u8::from(is_external);
        bytes[IMAGE_AT] = image;
        bytes[PINS_AT..CRC_AT].fill(NO_PIN);
        for role in Role::ALL {
            if let Some(pin) = pins(role) {
                bytes[PINS_AT + role as usize] = pin.port << 4 | pin.number & 15;
            }
        }
        let sum = checksum(&bytes[..CRC_AT]);
        bytes[CRC_AT..].copy_from_slice(&sum.to_le_bytes());
        PinTable(bytes)
    }

    /// Makes a table from bytes of an image, without checking them. Call [`PinTable::is_intact`] to check them.
    pub const fn from_bytes(bytes: [u8; SIZE]) -> PinTable {
        PinTable(bytes)
    }

    /// Returns the table as the bytes that an image contains.
    pub const fn bytes(&self) -> &[u8; SIZE] {
        &self.0
    }

    /// Returns whether the table begins with [`MAGIC`] and its checksum is right.
    pub fn is_intact(&self) -> bool {
        let (rest, sum) = self.0.split_at(CRC_AT);
        rest.starts_with(&MAGIC) && checksum(rest).to_le_bytes() == sum
    }

    /// Returns the number of the image that the table is for.
    pub const fn image(&self) -> u8 {
        self.0[IMAGE_AT]
    }

    /// Returns the name of the board. It ends before the first blank, control character or byte that is not ASCII.
    #[inline(never)]
    pub fn name(&self) -> &str {
        let name = self.0.get(NAME_AT..OSCILLATOR_AT).unwrap_or_default();
        let length = name.iter().position(|byte| !byte.is_ascii_graphic()).unwrap_or(name.len());
        let name = name.get(..length).unwrap_or_default();
        // SAFETY: unsafe because a text must be UTF-8; safe because all bytes up to here are ASCII. `from_utf8` would
        // add half a kilobyte of code.
        unsafe { core::str::from_utf8_unchecked(name) }
    }

    /// Returns the frequency of the oscillator in MHz, or `None` if it has to be measured.
    pub fn oscillator_mhz(&self) -> Option<u8> {
        Some(self.0[OSCILLATOR_AT]).filter(|mhz| *mhz != 0)
    }

    /// Returns true if an external clock drives the oscillator's input, false if a crystal does.
    pub fn is_external(&self) -> bool {
        self.0[OSCILLATOR_AT + 1] == 1
    }

    /// Returns the pin of a function; `None` if the board has none for it.
    #[inline(never)]
    pub fn pin(&self, role: Role) -> Option<Pin> {
        let entry = *self.0.get(PINS_AT + role as usize)?;
        (entry != NO_PIN).then_some(Pin { port: entry >> 4, number: entry & 15 })
    }
}
