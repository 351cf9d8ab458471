//! Powers up a simulator: finds the board by its name, selects the dialect, and applies settings as if a host had sent
//! them. A setting that is refused is reported with the reason.

use crate::boards::{self, Board};
use crate::simulator::Simulator;
use oxmill_controller::error::Error;
use oxmill_controller::settings::Key;
use std::fmt;

/// How lines are understood and answered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "program", derive(clap::ValueEnum))]
pub enum Dialect {
    /// As Grbl 1.1h, even where Oxmill knows more.
    Grbl,
    /// Grbl and everything beyond it.
    Oxmill,
    /// As `oxmill`, and what the document means that Oxmill was made from.
    Seed,
}

impl Dialect {
    /// Its value as a `$` setting.
    pub fn setting(self) -> u8 {
        self as u8
    }

    /// Its name on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Dialect::Grbl => "grbl",
            Dialect::Oxmill => "oxmill",
            Dialect::Seed => "seed",
        }
    }

    /// All of them.
    pub const ALL: [Dialect; 3] = [Dialect::Grbl, Dialect::Oxmill, Dialect::Seed];

    /// The one of this name.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|dialect| dialect.name() == name)
    }

    /// The one that a simulator has.
    pub fn of(simulator: &Simulator) -> Option<Self> {
        let value = simulator.controller().settings().whole(Key::Dialect);
        Self::ALL.into_iter().find(|dialect| u32::from(dialect.setting()) == value)
    }

    /// The setting that chooses it, as `$n=v`.
    pub fn assignment(self) -> String {
        format!("${}={}", Key::Dialect.number(), self.setting())
    }
}

/// The board of this name.
///
/// # Errors
/// A text with the names that there are.
pub fn board_named(name: &str) -> Result<Board, String> {
    boards::ALL.into_iter().find(|board| board.name == name).ok_or_else(|| {
        let names: Vec<&str> = boards::ALL.iter().map(|board| board.name).collect();
        format!("the boards are {}", names.join(", "))
    })
}

/// What an error means, for people.
pub fn error_text(code: u8) -> &'static str {
    Error::ALL.iter().find(|error| error.code() == code).map_or("an error without a description", |error| error.text())
}

/// Why a setting was not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SettingRefused {
    /// The text is not of the form `n=v` or `$n=v`.
    NoAssignment,
    /// The controller answered `error:N`.
    Error(u8),
    /// The power was cut, as ordered.
    PowerGone,
}

impl fmt::Display for SettingRefused {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            SettingRefused::NoAssignment => f.write_str("is not of the form $n=v"),
            SettingRefused::Error(code) => write!(f, "was refused with error:{code}: {}", error_text(*code)),
            SettingRefused::PowerGone => f.write_str("found no power"),
        }
    }
}

/// Applies `n=v` or `$n=v`. What the controller says besides is thrown away.
///
/// # Errors
/// Why it was not taken; the setting is as before then.
pub fn apply_setting(simulator: &mut Simulator, setting: &str) -> Result<(), SettingRefused> {
    let assignment = setting.trim();
    let assignment = assignment.strip_prefix('$').unwrap_or(assignment);
    // The wire has realtime commands, none of which a setting can need.
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
    for answer in simulator.take_output().lines() {
        if let Some(code) = answer.strip_prefix("error:").and_then(|code| code.parse().ok()) {
            return Err(SettingRefused::Error(code));
        }
    }
    Ok(())
}
