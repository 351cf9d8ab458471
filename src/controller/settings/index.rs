//! Finds a setting's row: by its number after `$`, or by its line in the listing of `$$`.

use super::row::Entry;
use super::table::{Key, PER_AXIS, SCALARS};
use crate::axes::Axis;

/// The row of a setting: in [`SCALARS`] or in [`PER_AXIS`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Index {
    /// A row of [`SCALARS`].
    Scalar(usize),
    /// A row of [`PER_AXIS`], and the axis.
    PerAxis(usize, Axis),
}

impl Index {
    /// Returns the index of the setting with this number, on a machine with `axes` axes.
    pub(super) fn of_number(number: u16, axes: usize) -> Option<Self> {
        if let Some(i) = SCALARS.iter().position(|e| e.number == number) {
            return Some(Self::Scalar(i));
        }
        PER_AXIS.iter().enumerate().find_map(|(i, e)| {
            let axis = Axis::ALL.get(usize::from(number.checked_sub(e.number)?)).copied()?;
            (axis.index() < axes).then_some(Self::PerAxis(i, axis))
        })
    }

    /// Returns the index of row `line` of `$$` (0 is the first) with `axes` axes in use.
    pub(super) fn of_line(line: usize, axes: usize) -> Option<Self> {
        let Some(line) = line.checked_sub(Key::COUNT) else { return Some(Self::Scalar(line)) };
        Some(Self::PerAxis(line.checked_div(axes)?, *Axis::ALL.get(line.checked_rem(axes)?)?))
    }

    /// Returns the row and the number after `$`. All axes share a row, so the number depends on the axis: the row of X
    /// at `$100` is used for Y at `$101`.
    pub(super) fn row(self) -> Option<(&'static Entry, u16)> {
        match self {
            Self::Scalar(i) => SCALARS.get(i).map(|entry| (entry, entry.number)),
            Self::PerAxis(i, axis) => PER_AXIS.get(i).map(|entry| (entry, entry.number + axis.index() as u16)),
        }
    }
}
