//! The tool table: numbers and length offsets of tools. Also what a tool setter has measured (`$918=2`): the first tool
//! is the reference, and later ones get an offset against it.

use super::code::Code;
use crate::axes::PerAxis;
use crate::number::{self, Digits};
use crate::units::Coordinate;

/// How many tools the table holds.
pub const TOOLS: usize = 32;

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

    /// Whether it has no entry of any tool.
    pub(super) fn is_empty(&self) -> bool {
        self.0.iter().all(|tool| tool.number == 0)
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

/// What has been measured of the tool in the spindle (`$918=2`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Measured {
    /// Where a tool without offset touches the setter, from the first tool that was measured.
    reference: Option<Coordinate>,
    /// The offset of the tool in the spindle.
    offset: Option<Coordinate>,
    /// In a program that is only checked M6 is taken to have measured the tool.
    pub(super) assumed: bool,
}

impl Measured {
    /// Nothing.
    pub(super) const NOTHING: Self = Self { reference: None, offset: None, assumed: false };

    /// The offset of the tool in the spindle, if it was measured.
    pub(super) fn offset(&self) -> Option<Coordinate> {
        self.offset
    }

    /// Whether the next tool to be measured is the first one.
    pub(super) fn is_first(&self) -> bool {
        self.reference.is_none()
    }

    /// The tool is taken out.
    pub(super) fn forget_tool(&mut self) {
        self.offset = None;
    }

    /// A tool has touched the setter at this place of the machine while `active` was in force. Its offset is such that the
    /// tips of all tools that were measured have the same coordinates at the same place; the first one keeps what is in force.
    /// Whether it is the first.
    pub(super) fn touched(&mut self, place: Coordinate, active: Coordinate) -> (Coordinate, bool) {
        let is_first = self.is_first();
        let reference = *self.reference.get_or_insert(place - active);
        let offset = place - reference;
        self.offset = Some(offset);
        (offset, is_first)
    }
}

/// Whether a line that has been refused asks for another tool (M6), as far as its words can be told.
#[inline(never)]
pub fn asks_for_tool(line: &[u8]) -> bool {
    line.split(|byte| *byte == b'M').skip(1).any(|number| {
        number::read(number, Digits::Exact).is_some_and(|read| Code::of(read.value) == Code { whole: 6, hundredths: 0 })
    })
}

/// The number of the entry that a program sets for a tool, which may be only checked.
pub(super) fn entry_number(number: u32, is_checking: bool) -> u32 {
    if is_checking { number | CHECKED } else { number }
}
