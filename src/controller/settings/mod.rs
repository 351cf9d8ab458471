//! The `$` settings: their table, their values, and their checks.
//!
//! `$$`, the checks of `$n=v` and the documents come from one table. A setting that is legal alone is stored, as senders
//! restore them one by one; whether the *set* can be run is asked by [`Settings::unrunnable`].
//!
//! Calls go down this list and never up:
//!
//! * `ranges`: `$n=v`; `listing`: `$$`; `runnable`: whether the machine can run with what is set
//! * `values`: what the settings are set to, also as they are stored
//! * `index`: which row a number or a line of `$$` belongs to
//! * `table`: the rows, and the keys that name them
//! * `row`: what a row says

mod index;
mod listing;
mod ranges;
mod row;
mod runnable;
mod table;
mod values;

pub use listing::lines;
pub use row::{Description, Entry, Kind, Row, SettingGroup};
pub use table::{AxisKey, Key, PER_AXIS, PER_AXIS_DESCRIPTIONS, SCALAR_DESCRIPTIONS, SCALARS};
pub use values::Settings;
