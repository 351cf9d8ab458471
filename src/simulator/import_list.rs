//! The result of an import. It has the settings that were taken, each checked by the controller's own table, and the
//! entries that were not taken, each with a reason.

use crate::boards::AXES;
use oxmill_controller::error::Error;
use oxmill_controller::number::{Digits, read};
use oxmill_controller::protocol::descriptions;
use oxmill_controller::protocol::text::Text;
use oxmill_controller::settings::{Key, Row, Settings, lines};
use oxmill_controller::units::{DECIMAL_ONE, DECIMAL_PLACES, Decimal};
use serde::{Serialize, Serializer};
use std::fmt;

/// Maximum length of an entry's text, in characters. Longer ones are cut off.
const LONGEST: usize = 100;

/// The reason for an entry whose number is no setting of Oxmill.
pub const NO_SETTING: &str = "no such setting";

/// The result of importing a file.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Import {
    /// The controller that the settings come from: `Grbl`, `grblHAL`, `FluidNC` or `Oxmill`.
    pub what: &'static str,
    /// The settings that result from the file, in its order. Each number appears once.
    pub taken: Vec<TakenSetting>,
    /// Entries, or parts of entries, that become no setting, in the order of the file.
    pub left: Vec<LeftEntry>,
}

/// A setting, and the entry from which it comes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TakenSetting {
    /// Number after `$`.
    pub number: u16,
    /// Value in the unit of the setting. The controller accepts this value, but may reject it in Grbl's dialect.
    pub value: Value,
    /// Name of the setting in the words of the firmware.
    pub name: String,
    /// Unit; empty for none.
    pub unit: &'static str,
    /// Text of the entry in the file from which the setting comes.
    pub from: String,
    /// Line of the entry, from 1.
    pub line: usize,
}

/// An entry, or a part of an entry, that becomes no setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftEntry {
    /// Text of the entry in the file.
    pub text: String,
    /// Why the entry is not taken.
    pub why: String,
    /// Line of the entry, from 1.
    pub line: usize,
}

/// An entry of the file: its text and its line, from 1.
#[derive(Clone, Debug)]
pub struct FileEntry {
    text: String,
    line: usize,
}

impl FileEntry {
    /// Makes an entry. Control characters in its text are replaced, as a file may contain terminal escape sequences.
    pub fn new(text: &str, line: usize) -> Self {
        let text = text.trim().chars().take(LONGEST).map(|c| if c.is_control() { '?' } else { c }).collect();
        Self { text, line }
    }
}

/// A value, exact to seven decimals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Value(pub Decimal);

impl fmt::Display for Value {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (size, one) = (self.0.0.unsigned_abs(), DECIMAL_ONE.unsigned_abs());
        let sign = if self.0.0 < 0 { "-" } else { "" };
        let text = format!("{sign}{}.{:0places$}", size / one, size % one, places = DECIMAL_PLACES as usize);
        f.write_str(text.trim_end_matches('0').trim_end_matches('.'))
    }
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.0.0 % DECIMAL_ONE == 0 {
            return serializer.serialize_i64(self.0.0 / DECIMAL_ONE);
        }
        // Converted through text, so that 0.01 becomes the `f64` nearest to 0.01.
        serializer.serialize_f64(self.to_string().parse().unwrap_or_default())
    }
}

/// Returns the number in `text`; `None` if `text` is not a number, or has more than a number.
pub fn number(text: &str) -> Option<Decimal> {
    read(text.as_bytes(), Digits::Exact).filter(|number| number.used == text.len()).map(|number| number.value)
}

/// Returns a value as a `u32`; `None` if it is not whole, is negative or is too large.
pub fn whole(value: Decimal) -> Option<u32> {
    (value.0 % DECIMAL_ONE == 0).then(|| u32::try_from(value.0 / DECIMAL_ONE).ok()).flatten()
}

/// Converts a whole number to a [`Decimal`], the fixed-point type of the settings.
pub fn decimal(whole: u32) -> Decimal {
    Decimal(i64::from(whole) * DECIMAL_ONE)
}

/// Returns a setting's row of the controller's table; `None` if there is no setting with this number.
pub fn row(number: u16) -> Option<Row> {
    (0..lines(AXES)).filter_map(|line| Settings::<AXES>::described(line, AXES)).find(|row| row.number == number)
}

/// Returns which values a setting accepts, in the firmware's words.
pub fn values_of(row: &Row) -> String {
    let mut text = Text::new();
    descriptions::values_of(&mut text, row);
    let text = String::from_utf8_lossy(&text);
    text.trim().trim_start_matches("[MSG:").trim_end_matches(']').to_owned()
}

impl Import {
    /// Makes an empty import. `what`: the controller that the settings come from.
    pub fn of(what: &'static str) -> Self {
        Self { what, ..Self::default() }
    }

    /// Returns whether the import already has the setting with this number.
    pub fn has(&self, number: u16) -> bool {
        self.taken.iter().any(|taken| taken.number == number)
    }

    /// Adds a setting if the controller's table of settings accepts the value. Otherwise lists the entry as not taken,
    /// with the values that the setting accepts.
    pub fn take(&mut self, number: u16, value: Decimal, entry: &FileEntry) {
        let Some(row) = row(number) else { return self.leave(entry, NO_SETTING) };
        match Settings::<AXES>::default().accepted(number, value) {
            Ok(_) => {}
            Err(error @ Error::NegativeValue) => return self.leave(entry, error.text()),
            Err(_) => return self.leave(entry, values_of(&row)),
        }
        let mut name = Text::new();
        descriptions::name(&mut name, &row);
        self.taken.push(TakenSetting {
            number,
            value: Value(value),
            name: String::from_utf8_lossy(&name).into_owned(),
            unit: if row.description.unit == "mask" { "" } else { row.description.unit },
            from: entry.text.clone(),
            line: entry.line,
        });
    }

    /// Lists an entry as not taken, with the reason.
    pub fn leave(&mut self, entry: &FileEntry, why: impl Into<String>) {
        self.left.push(LeftEntry { text: entry.text.clone(), why: why.into(), line: entry.line });
    }

    /// Ends an import. If the file sets a number several times, the last value counts, as on a board. Earlier values
    /// that differ from it are listed as not taken.
    pub fn finish(mut self) -> Self {
        let mut taken: Vec<TakenSetting> = Vec::new();
        for next in self.taken {
            if let Some(at) = taken.iter().position(|before| before.number == next.number) {
                let before = taken.remove(at);
                if before.value != next.value {
                    let why = format!("line {} sets ${} again", next.line, next.number);
                    self.left.push(LeftEntry { text: before.from, why, line: before.line });
                }
            }
            taken.push(next);
        }
        taken.sort_by_key(|taken| taken.line);
        self.left.sort_by_key(|left| left.line);
        Self { taken, ..self }
    }

    /// Returns the settings as lines `$n=v`, sorted by number. Only homing (`$22`) comes before soft limits (`$20`):
    /// Grbl's dialect accepts soft limits only with homing on.
    pub fn assignments(&self) -> String {
        const SOFT_LIMITS: u16 = Key::SoftLimits.number();
        const HOMING: u16 = Key::Homing.number();
        let mut taken: Vec<&TakenSetting> = self.taken.iter().collect();
        taken.sort_by_key(|taken| if taken.number == SOFT_LIMITS { (HOMING, true) } else { (taken.number, false) });
        taken.iter().map(|taken| format!("${}={}\n", taken.number, taken.value)).collect()
    }
}
