//! The `$` settings: their table, their values, and their checks.
//!
//! `$$`, the checks of `$n=v` and the documentation of the settings are made from one table. Each value is checked
//! alone and stored if it is valid, because senders restore settings one at a time. [`Settings::unrunnable`] checks
//! whether the machine can run with *all* settings together.
//!
//! Each module uses only modules below it in this list:
//!
//! * `change`: `$n=v`; `listing`: `$$`; `runnable`: whether the machine can run with the settings; `masks`: settings
//!   that are masks in grblHAL
//! * `values`: the values of the settings, and their stored form
//! * `index`: finds the row for a number or a line of `$$`
//! * `table`: the rows, and the keys that name them
//! * `row`: the contents of a row

mod change;
mod index;
mod listing;
mod masks;
mod row;
mod runnable;
mod table;
mod values;

pub use listing::lines;
pub use masks::GrblHalMask;
pub use row::{Description, Entry, Kind, Row, SettingGroup};
pub use table::{AxisKey, Key, PER_AXIS, PER_AXIS_DESCRIPTIONS, SCALAR_DESCRIPTIONS, SCALARS};
pub use values::Settings;
