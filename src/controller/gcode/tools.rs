//! The tool table: numbers and length offsets of tools. Also the measurements of a tool setter (`$918=2`): the first
//! measured tool is the reference, and later tools get an offset relative to it.

use super::code::Code;
use crate::axes::PerAxis;
use crate::number::{self, Digits};
use crate::units::Coordinate;

/// Maximum number of tools in the tool table.
pub const TOOLS: usize = 32;

/// Bit in the number of an entry that a program has set in check mode. While this entry exists, it is used instead of
/// the tool's entry without the bit.
const CHECKED: u32 = 1 << 31;

/// Entry of the tool table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tool<const N: usize> {
    /// Number of the tool, from 1; 0 for a free entry.
    pub number: u32,
    /// Offset of the tool's tip from the reference point of the spindle, by axis.
    pub offset: PerAxis<Coordinate, N>,
}

impl<const N: usize> Tool<N> {
    /// Returns whether the entry is kept over power-off: it is not free, and was not set in check mode.
    pub fn is_stored(&self) -> bool {
        self.number != 0 && self.number & CHECKED == 0
    }
}

/// The tools with known offsets. All entries are kept over power-off, except those that a program has set in check
/// mode.
#[derive(Clone, Debug, PartialEq)]
pub struct ToolTable<const N: usize>([Tool<N>; TOOLS]);

impl<const N: usize> ToolTable<N> {
    /// A table in which all entries are free.
    pub const EMPTY: Self = Self([Tool { number: 0, offset: PerAxis::all(Coordinate::ZERO) }; TOOLS]);

    /// Returns all entries, including the free ones.
    pub fn entries(&self) -> &[Tool<N>] {
        &self.0
    }

    /// Returns whether all entries are free.
    pub(super) fn is_empty(&self) -> bool {
        self.0.iter().all(|tool| tool.number == 0)
    }

    /// Returns the index of a tool's entry, or of the first free entry; `None` if the table is full.
    pub fn slot(&self, number: u32) -> Option<usize> {
        self.find(number).or_else(|| self.find(0))
    }

    /// Replaces the entry at index `slot`. Does nothing if the index is too large.
    pub fn put(&mut self, slot: usize, tool: Tool<N>) {
        if let Some(entry) = self.0.get_mut(slot) {
            *entry = tool;
        }
    }

    /// Returns the offset of a tool, in check mode the one set there; `None` for an unknown tool. Tool 0 (no tool) has
    /// the offset 0.
    pub fn offset(&self, number: u32) -> Option<PerAxis<Coordinate, N>> {
        if number == 0 {
            return Some(PerAxis::all(Coordinate::ZERO));
        }
        let find = |wanted| self.0.iter().find(|tool| tool.number == wanted);
        find(number | CHECKED).or_else(|| find(number)).map(|tool| tool.offset)
    }

    /// Returns the index of a tool's entry, if the tool is in the table.
    pub fn find(&self, number: u32) -> Option<usize> {
        self.0.iter().position(|tool| tool.number == number)
    }

    /// Removes a tool: its entry becomes free.
    pub(super) fn remove(&mut self, number: u32) {
        if let Some(slot) = self.find(number) {
            self.put(slot, Tool { number: 0, offset: PerAxis::all(Coordinate::ZERO) });
        }
    }

    /// Removes the entries that programs have set in check mode.
    pub(super) fn end_check(&mut self) {
        for tool in self.0.iter_mut().filter(|tool| tool.number & CHECKED != 0) {
            tool.number = 0;
        }
    }
}

/// Measurements of the tool in the spindle (`$918=2`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Measured {
    /// The machine coordinate at which a tool with offset 0 touches the setter, derived from the first measured tool.
    reference: Option<Coordinate>,
    /// The measured offset of the tool in the spindle.
    offset: Option<Coordinate>,
    /// In check mode: M6 is assumed to have measured the tool.
    pub(super) assumed: bool,
}

impl Measured {
    pub(super) const NOTHING: Self = Self { reference: None, offset: None, assumed: false };

    /// Returns the offset of the tool in the spindle, if it has been measured.
    pub(super) fn offset(&self) -> Option<Coordinate> {
        self.offset
    }

    /// Returns whether no tool has been measured yet.
    pub(super) fn is_first(&self) -> bool {
        self.reference.is_none()
    }

    /// Returns the machine coordinate at which a tool with offset 0 touches the setter, if it is known.
    pub(super) fn reference(&self) -> Option<Coordinate> {
        self.reference
    }

    pub(super) fn set_reference(&mut self, reference: Option<Coordinate>) {
        self.reference = reference;
    }

    /// Forgets the offset of the tool in the spindle; the reference remains.
    pub(super) fn forget_tool(&mut self) {
        self.offset = None;
    }

    /// Records that a tool touched the setter at the machine coordinate `place` while the offset `active` was in
    /// force. Returns the offset of the tool, and `true` for the first measured tool. The first tool gets the offset
    /// `active`. The offset of each later tool gives its tip, at any point, the same work coordinates as the first
    /// tool's tip at that point.
    pub(super) fn touched(&mut self, place: Coordinate, active: Coordinate) -> (Coordinate, bool) {
        let is_first = self.is_first();
        let reference = *self.reference.get_or_insert(place - active);
        let offset = place - reference;
        self.offset = Some(offset);
        (offset, is_first)
    }
}

/// Returns whether a refused line has an M6, or may have one because its text is unknown (`None`: too long, damaged,
/// or with an open comment).
pub fn asks_for_tool(line: Option<&[u8]>) -> bool {
    line.is_none_or(|line| may_have_m_word(line, &[6]))
}

/// Returns whether a line has one of these M words, or may have one. It may have one if the number of an M word is
/// computed (`M[6]`), or if the line has an M and a bracket that is not closed.
#[inline(never)]
pub(super) fn may_have_m_word(line: &[u8], wanted: &[u8]) -> bool {
    let mut depth = 0_usize;
    let has = line.iter().enumerate().any(|(at, byte)| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        let number = line.get(at + 1..).unwrap_or_default();
        *byte == b'M' && depth == 0 && may_be_one_of(number, wanted)
    });
    has || depth > 0 && line.contains(&b'M')
}

/// Returns whether the number or expression at the start of the text can give one of the `wanted` numbers.
fn may_be_one_of(number: &[u8], wanted: &[u8]) -> bool {
    match number::read(number, Digits::Exact) {
        Some(read) => {
            let code = Code::of(read.value);
            code.hundredths == 0 && wanted.contains(&code.whole)
        }
        // A bracket, a parameter, or a function such as `FIX[`.
        None => matches!(number.iter().find(|byte| !byte.is_ascii_uppercase()), Some(b'[' | b'#')),
    }
}

/// Returns the number of the table entry that a program sets for a tool: in check mode with the bit [`CHECKED`].
pub(super) fn entry_number(number: u32, is_checking: bool) -> u32 {
    if is_checking { number | CHECKED } else { number }
}
