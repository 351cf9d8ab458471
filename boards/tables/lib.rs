//! The pin tables of the boards. A board is one file here, `NAME.toml`: chip, crystal, and the pin of each function.
//! [`Board::parse`] reads and checks such a file, which may also come from a user; [`image_file`] writes the table into
//! an image of the firmware. So a new board needs no code, and its pins can be changed without a compiler.
//!
//! ```toml
//! name = "my_board"                # in `$I` and on USB; at most 24 of a to z, 0 to 9 and _
//! title = "My board"               # for people
//! image = "blackpill_f411"         # the firmware's image: chip family, links to the host
//! chip = "STM32F411CE"             # which pins the package has
//! oscillator = "measured"          # or "8 MHz", "12 MHz", ...; with ", external" if a clock drives the input
//! remarks = ["..."]                # optional
//! [pins]                           # functions without a pin are left out
//! step_x = "A1"                    # port and number ...
//! probe = "B15 J4-2"               # ... and, if there is one, the label on the board
//! ```

mod check;
mod chips;
pub mod image_file;
#[cfg(test)]
mod tests;

pub use chips::{CHIPS, Chip};
pub use oxmill_boards::pin_table::{Pin, PinTable, Role};
use oxmill_boards::profiles;
use std::collections::BTreeMap;

/// The boards of this project: name, and contents of the file.
pub const BOARDS: [(&str, &str); 14] = [
    ("blackpill_f411", include_str!("blackpill_f411.toml")),
    ("blackpill_f401", include_str!("blackpill_f401.toml")),
    ("nucleo_f446re", include_str!("nucleo_f446re.toml")),
    ("nucleo_f411re", include_str!("nucleo_f411re.toml")),
    ("nucleo_f401re", include_str!("nucleo_f401re.toml")),
    ("octopus_f446", include_str!("octopus_f446.toml")),
    ("octopus_pro_f446", include_str!("octopus_pro_f446.toml")),
    ("spider_f446", include_str!("spider_f446.toml")),
    ("skr2_f407", include_str!("skr2_f407.toml")),
    ("monster8_f407", include_str!("monster8_f407.toml")),
    ("robin_nano_v3", include_str!("robin_nano_v3.toml")),
    ("jz_f407", include_str!("jz_f407.toml")),
    ("slb_ext", include_str!("slb_ext.toml")),
    ("blackpill_f411_grblhal", include_str!("blackpill_f411_grblhal.toml")),
];

/// A fault in a board's file, as reported to the user.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Fault {
    /// Line of the file, from 1; 0 if the fault is in no single line, as when an entry is missing.
    pub line: usize,
    /// What is wrong, and what to write.
    pub text: String,
}

/// An entry of `[pins]`: the pin of a function.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Use {
    /// Port and number of the pin: `"A1"` or `"PA1"` in the file.
    pub pin: Pin,
    /// Label of the pin on the board; empty if the file gives none.
    pub label: String,
    /// Line of the entry in the file, from 1.
    line: usize,
}

/// A board, read from its file and checked.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Board {
    /// Name on the command line and in `$I`.
    pub name: String,
    /// Name for people.
    pub title: String,
    /// The firmware image that runs on the board. Several boards can share an image.
    pub image: profiles::Board,
    /// The chip on the board. Its package determines which pins the file may use.
    pub chip: &'static Chip,
    /// Frequency of the oscillator in MHz; `None` if it is measured at the start.
    pub oscillator_mhz: Option<u8>,
    /// `true` if an external clock drives the oscillator's input; `false` for a crystal.
    pub is_external: bool,
    /// Hints for the person who wires the board.
    pub remarks: Vec<String>,
    /// The pins that have a function, by the function's name ([`name_of`]).
    pub pins: BTreeMap<&'static str, Use>,
}

impl Board {
    /// Returns the board of this project with this name, as in [`BOARDS`]; `None` if there is none.
    pub fn named(name: &str) -> Option<Board> {
        let (_, text) = BOARDS.iter().find(|(own, _)| *own == name)?;
        Board::parse(text).ok()
    }

    /// Reads a board's file.
    ///
    /// # Errors
    ///
    /// If the file has faults, returns all of them, in the order of the lines. Nothing of such a file may be used.
    pub fn parse(text: &str) -> Result<Board, Vec<Fault>> {
        check::parse(text)
    }

    /// Returns the pin table of the board, for [`image_file::write`].
    pub fn table(&self) -> PinTable {
        let number = self.image.image;
        let pin = |role| self.pins.get(name_of(role)).map(|found| found.pin);
        PinTable::new(number, &self.name, self.oscillator_mhz.unwrap_or(0), self.is_external, pin)
    }
}

/// Returns the name that a function has in a board's file.
pub fn name_of(role: Role) -> &'static str {
    match role {
        Role::StepX => "step_x",
        Role::StepY => "step_y",
        Role::StepZ => "step_z",
        Role::StepFourth => "step_fourth",
        Role::DirectionX => "direction_x",
        Role::DirectionY => "direction_y",
        Role::DirectionZ => "direction_z",
        Role::DirectionFourth => "direction_fourth",
        Role::Enable => "enable",
        Role::SecondEnable => "second_enable",
        Role::ThirdEnable => "third_enable",
        Role::FourthEnable => "fourth_enable",
        Role::SpindleOn => "spindle_on",
        Role::SpindleDirection => "spindle_direction",
        Role::SpindlePwm => "spindle_pwm",
        Role::Flood => "flood",
        Role::Mist => "mist",
        Role::ProgramOutput => "program_output",
        Role::SecondProgramOutput => "second_program_output",
        Role::LimitX => "limit_x",
        Role::LimitY => "limit_y",
        Role::LimitZ => "limit_z",
        Role::LimitFourth => "limit_fourth",
        Role::Probe => "probe",
        Role::Door => "door",
        Role::Hold => "hold",
        Role::Start => "start",
        Role::Reset => "reset",
        Role::DriverFault => "driver_fault",
        Role::AtSpeed => "at_speed",
        Role::ProgramInput => "program_input",
        Role::SecondProgramInput => "second_program_input",
        Role::MotorPower => "motor_power",
    }
}

/// Returns a pin as people write it: `A0`.
pub fn text_of(pin: Pin) -> String {
    format!("{}{}", char::from(b'A' + pin.port), pin.number)
}
