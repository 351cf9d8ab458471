//! Makes the rows of `$$` one at a time, for a machine with a given number of axes. For senders that request
//! descriptions, also returns the name and unit of each row.

use super::index::Index;
use super::row::{Entry, Row};
use super::table::{AxisKey, Key, PER_AXIS_DESCRIPTIONS, SCALAR_DESCRIPTIONS};
use super::values::Settings;

/// Returns the number of rows of `$$` with `axes` axes in use.
pub const fn lines(axes: usize) -> usize {
    Key::COUNT + AxisKey::COUNT * axes
}

impl<const N: usize> Settings<N> {
    /// Number of rows of `$$` with all axes in use.
    pub const LINES: usize = lines(N);

    /// Returns row `line` of `$$` (0 is the first): its entry, number and value.
    pub fn row(&self, line: usize) -> Option<(Entry, u16, f32)> {
        let index = Index::of_line(line, self.axes_in_use())?;
        let (entry, number) = index.row()?;
        Some((*entry, number, self.at(index)?))
    }

    /// Returns row `line` of `$$` (0 is the first) with its description; `None` after the last row. `axes`: number of
    /// axes in use.
    pub fn described(line: usize, axes: usize) -> Option<Row> {
        let index = Index::of_line(line, axes)?;
        let (axis, description) = match index {
            Index::Scalar(i) => (None, *SCALAR_DESCRIPTIONS.get(i)?),
            Index::PerAxis(i, axis) => (Some(axis), PER_AXIS_DESCRIPTIONS.get(i)?.of_axis(axis)),
        };
        let (entry, number) = index.row()?;
        Some(Row { number, axis, entry: *entry, description: description.with_axes(axes) })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_listing_has_every_row_once() {
        let s = Settings::<3>::default();
        let numbers: Vec<u16> = (0..Settings::<3>::LINES).map(|i| s.row(i).unwrap().1).collect();
        assert!(numbers.contains(&132) && numbers.contains(&900));
        let mut unique = numbers.clone();
        unique.sort_unstable();
        unique.dedup();
        assert_eq!(unique.len(), numbers.len());
        assert!(s.row(Settings::<3>::LINES).is_none());
    }
}
