//! Powers up a simulator: finds the board by its name, selects the dialect, and applies settings as if a host had sent
//! them. Reports the reason if a setting is rejected.

use crate::boards::{self, Board};
use crate::simulator::Simulator;
use oxmill_controller::error::Error;
use oxmill_controller::settings::Key;
use std::fmt;

/// How lines are understood and answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Dialect {
    /// Only the words and answers of Grbl 1.1h.
    Grbl,
    /// Grbl and everything beyond it.
    Oxmill,
    /// As `oxmill`, with two differences (docs/gcode.md).
    Seed,
    /// As `oxmill`, and answers like grblHAL, for gSender and ioSender.
    #[cfg_attr(feature = "program", value(name = "grblhal"))]
    GrblHal,
}

impl Dialect {
    /// The value of the setting that selects the dialect.
    pub fn setting(self) -> u8 {
        self as u8
    }

    /// The name of the dialect on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Dialect::Grbl => "grbl",
            Dialect::Oxmill => "oxmill",
            Dialect::Seed => "seed",
            Dialect::GrblHal => "grblhal",
        }
    }

    /// All dialects, in the order of their setting values.
    pub const ALL: [Dialect; 4] = [Dialect::Grbl, Dialect::Oxmill, Dialect::Seed, Dialect::GrblHal];

    /// Returns the dialect with this name (such as `grblhal`); `None` if no dialect has the name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dialect| dialect.name() == name)
    }

    /// Returns the dialect that is set in a simulator; `None` if no dialect has the value of the setting.
    pub fn of(simulator: &Simulator) -> Option<Self> {
        let value = simulator.controller().settings().whole(Key::Dialect);
        Self::ALL.into_iter().find(|dialect| u32::from(dialect.setting()) == value)
    }

    /// The setting that selects the dialect, as `$n=v`.
    pub fn assignment(self) -> String {
        format!("${}={}", Key::Dialect.number(), self.setting())
    }
}

/// Returns the profile of a board by its name, such as `desk`.
///
/// # Errors
/// A text that lists the existing names.
pub fn board_named(name: &str) -> Result<Board, String> {
    boards::ALL.into_iter().find(|board| board.name == name).ok_or_else(|| {
        let names: Vec<&str> = boards::ALL.iter().map(|board| board.name).collect();
        format!("the boards are {}", names.join(", "))
    })
}

/// Returns what a reply `error:N` means, as a text for users. `code` is N.
pub fn error_text(code: u8) -> &'static str {
    Error::ALL.iter().find(|error| error.code() == code).map_or("an error without a description", |error| error.text())
}

/// Returns all `[MSG:` lines of the output `said` as one line, to be appended to a text for users. A blank precedes
/// each of the messages.
pub fn messages_of(said: &str) -> String {
    said.lines().filter(|line| line.starts_with("[MSG:")).map(|line| format!(" {line}")).collect()
}

/// Why a setting was rejected.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SettingRefused {
    /// The text is not of the form `n=v` or `$n=v`.
    NoAssignment,
    /// The controller answered `error:N`, after messages such as ` [MSG:Values of $22: 0 or 1]`.
    Error(u8, String),
    /// The power cut of `Store::cut_power_after` has happened.
    PowerGone,
}

impl fmt::Display for SettingRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SettingRefused::NoAssignment => f.write_str("is not of the form $n=v"),
            SettingRefused::Error(code, messages) => {
                write!(f, "was refused with error:{code}: {}{messages}", error_text(*code))
            }
            SettingRefused::PowerGone => f.write_str("found no power"),
        }
    }
}

/// Applies a setting, given as `n=v` or `$n=v`. Discards all output of the controller.
///
/// # Errors
/// If the setting was rejected; it then keeps its value. The error says why.
pub fn apply_setting(simulator: &mut Simulator, setting: &str) -> Result<(), SettingRefused> {
    let assignment = setting.trim();
    let assignment = assignment.strip_prefix('$').unwrap_or(assignment);
    // Reject realtime commands, because the link would execute them. No setting needs these characters.
    let plain = assignment.bytes().all(|byte| byte.is_ascii_graphic() && !b"?!~".contains(&byte) || byte == b' ');
    if !plain || !assignment.contains('=') {
        return Err(SettingRefused::NoAssignment);
    }
    simulator.take_output();
    simulator.send(format!("${assignment}\n"));
    simulator.run_until_idle();
    if simulator.power_is_gone() {
        return Err(SettingRefused::PowerGone);
    }
    let said = simulator.take_output();
    let error = said.lines().find_map(|answer| answer.strip_prefix("error:")?.parse().ok());
    error.map_or(Ok(()), |code| Err(SettingRefused::Error(code, messages_of(&said))))
}
