//! Tools: their lengths in a table, which of them the spindle holds, and the words that use both (T, M6, G43, G10 L1).

use super::Dialect;
use super::check::{Check, along, whole};
use super::modal::{CoordinateSystem, EXTENDED};
use super::offsets::{StoredOffset, TOOL_AXIS};
use super::parse::TOOL_MAX;
use super::word::{Letters, ToolLength};
use crate::axes::{AxisMask, PerAxis};
use crate::error::Error;
use crate::units::{Coordinate, Decimal};

/// How many tools the table holds.
pub const TOOLS: usize = if EXTENDED { 32 } else { 0 };

/// Bit of the number of an entry that a program has set which is only checked. It hides the one without the bit.
const CHECKED: u32 = 1 << 31;

/// A tool of the table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tool<const N: usize> {
    /// Its number, from 1 on; 0 for a free entry.
    pub number: u32,
    /// How far its tip is from the point that the spindle alone would have, by axis.
    pub offset: PerAxis<Coordinate, N>,
}

impl<const N: usize> Tool<N> {
    /// Whether this is no free entry, nor one of a program that is only checked.
    pub fn is_stored(&self) -> bool {
        self.number != 0 && self.number & CHECKED == 0
    }
}

/// The tools whose offsets are kept over power-off, in the order in which they were entered.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolTable<const N: usize>([Tool<N>; TOOLS]);

impl<const N: usize> ToolTable<N> {
    /// No tools.
    pub const EMPTY: Self = Self([Tool { number: 0, offset: PerAxis::all(Coordinate::ZERO) }; TOOLS]);

    /// All entries, the free ones included.
    pub fn entries(&self) -> &[Tool<N>] {
        &self.0
    }

    /// The entry of a tool, or the first free one.
    pub fn slot(&self, number: u32) -> Option<usize> {
        self.find(number).or_else(|| self.find(0))
    }

    /// What an entry holds from now on.
    pub fn put(&mut self, slot: usize, tool: Tool<N>) {
        if let Some(entry) = self.0.get_mut(slot) {
            *entry = tool;
        }
    }

    /// The offset of a tool; nothing for an unknown one. No tool at all (0) has no offset.
    pub fn offset(&self, number: u32) -> Option<PerAxis<Coordinate, N>> {
        if number == 0 {
            return Some(PerAxis::all(Coordinate::ZERO));
        }
        let find = |wanted| self.0.iter().find(|tool| tool.number == wanted);
        find(number | CHECKED).or_else(|| find(number)).map(|tool| tool.offset)
    }

    /// The entry of a tool that is in the table.
    pub fn find(&self, number: u32) -> Option<usize> {
        self.0.iter().position(|tool| tool.number == number)
    }

    /// Frees the entry of a tool.
    pub(super) fn remove(&mut self, number: u32) {
        if let Some(slot) = self.find(number) {
            self.put(slot, Tool { number: 0, offset: PerAxis::all(Coordinate::ZERO) });
        }
    }

    /// Forgets what a program has set that was only checked.
    pub(super) fn end_check(&mut self) {
        for tool in self.0.iter_mut().filter(|tool| tool.number & CHECKED != 0) {
            tool.number = 0;
        }
    }
}

/// The number of the entry that a program sets for a tool, which may be only checked.
pub(super) fn entry_number(number: u32, is_checking: bool) -> u32 {
    if is_checking { number | CHECKED } else { number }
}

impl<const N: usize> Check<'_, N> {
    /// T selects, M6 puts what is selected into the spindle.
    pub(super) fn tool(&mut self) -> Result<(), Error> {
        let modal = &mut self.checked.modal;
        if self.line.values.has(b'T') {
            let number = match self.dialect {
                Dialect::Grbl => self.line.value.t.truncate(),
                _ => whole(self.line.value.t)?,
            };
            modal.tool = number.unsigned_abs();
        } else if self.dialect == Dialect::Grbl {
            modal.tool = 0;
        }
        self.checked.after.spindle_word = self.line.spindle.is_some();
        if self.line.extended.tool_change {
            self.checked.tool_change = modal.tool != self.state.spindle_tool;
            self.checked.after.spindle_tool = modal.tool;
        }
        Ok(())
    }

    /// Group 8. Only the axes' next moves are affected.
    pub(super) fn tool_length(&mut self) -> Result<(), Error> {
        let Some(word) = self.line.tool_length else { return Ok(()) };
        let offset = match word {
            ToolLength::Cancel => PerAxis::all(Coordinate::ZERO),
            ToolLength::Dynamic => {
                let along_tool = self.dialect != Dialect::Grbl || self.line.axes == AxisMask::NONE.with(TOOL_AXIS);
                if self.line.axes.is_empty() || !along_tool {
                    return Err(Error::ToolLengthAxis);
                }
                self.with_axis_words(self.checked.tool_length, |_, value| value)
            }
            ToolLength::FromTable => self.tool_of_h()?,
            ToolLength::Add if !self.line.values.has(b'H') => return Err(Error::ValueWordMissing),
            ToolLength::Add => self.tool_of_h()?.zip(&self.checked.tool_length, |more, present| more + present),
        };
        self.checked.tool_length = offset;
        self.allow_offset(&offset)
    }

    /// The offset that H names; that of the tool in the spindle without H or with H0.
    fn tool_of_h(&mut self) -> Result<PerAxis<Coordinate, N>, Error> {
        if !EXTENDED {
            return Err(Error::ExtendedLeftOut);
        }
        let number = if self.take(b'H') { whole(self.line.value.h)?.unsigned_abs() } else { 0 };
        let number = if number == 0 { self.checked.after.spindle_tool } else { number };
        self.state.tools.offset(number).ok_or(Error::UnknownTool)
    }

    /// G10 L1, L10, L11: the table's offsets of tool P. They act with the next G43. L1 without axes takes it out.
    pub(super) fn set_tool(&mut self, l: i32) -> Result<(), Error> {
        if !EXTENDED {
            return Err(Error::ExtendedLeftOut);
        }
        let number = whole(self.line.value.p)?.unsigned_abs();
        if !self.line.values.has(b'P') {
            return Err(Error::ValueWordMissing);
        }
        if self.line.value.p > Decimal::from_int(TOOL_MAX) {
            return Err(Error::ToolNumberTooHigh);
        }
        let known = self.state.tools.offset(number);
        let has_room = self.state.tools.slot(entry_number(number, self.state.is_checking())).is_some();
        let removes = self.line.axes.is_empty();
        if number == 0 || removes && known.is_none() || !removes && !has_room {
            return Err(Error::UnknownTool);
        }
        self.unused.remove(Letters::of(b"LP"));
        let offsets = &self.state.offsets;
        // Where the work zero of the tool's tip is: L10 in the active system with its G92, L11 in the ninth, which holds a
        // fixture.
        let origin = if l == 11 {
            offsets.system(CoordinateSystem::G59_3)
        } else {
            offsets.system(self.checked.modal.coordinate_system).zip(&offsets.g92, |origin, g92| origin + g92)
        };
        self.checked.store = Some(StoredOffset::Tool(number));
        if removes {
            return Ok(());
        }
        let present = known.unwrap_or(PerAxis::all(Coordinate::ZERO));
        self.checked.stored = Some(self.with_axis_words(present, |axis, value| {
            if l == 1 { value } else { self.position(axis) - along(&origin, axis) - value }
        }));
        Ok(())
    }
}
