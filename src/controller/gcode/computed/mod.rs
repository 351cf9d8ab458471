//! Expressions, parameters and O words of a program. [`Computed`] holds the state of all three; the interpreter begins
//! it with each line, commits it with the line, and resets it at the end of a program. A build without the feature
//! `expressions` has `none.rs` instead.

#[cfg(feature = "reasons")]
mod explain;
mod expression;
mod flow;
mod machine_values;
mod macros;
mod o_words;
mod parameters;
mod real;
#[cfg(test)]
mod tests;

use crate::axes::PerAxis;
use crate::lent::Lent;
use crate::units::Coordinate;
use flow::{FlowControl, HeldText};
use parameters::{Cells, Parameters};
use real::Real;

pub use flow::HeldLine;

/// Memory that is lent to it.
#[derive(Debug)]
pub(super) struct ComputedMemory {
    cells: Lent<Cells>,
    text: Lent<HeldText>,
}

/// Owns that memory on a board.
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub(super) struct ComputedStorage {
    cells: Cells,
    text: HeldText,
}

#[cfg(not(feature = "alloc"))]
impl ComputedStorage {
    pub const EMPTY: Self = Self { cells: Cells::new(), text: HeldText::new() };

    pub fn lend(&'static mut self) -> ComputedMemory {
        ComputedMemory { cells: &mut self.cells, text: &mut self.text }
    }
}

#[cfg(feature = "alloc")]
impl ComputedMemory {
    pub fn on_heap() -> Self {
        Self { cells: Lent::new(Cells::new()), text: Lent::new(HeldText::new()) }
    }
}

/// What expressions need beside the state of the interpreter.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct Computed<const N: usize> {
    parameters: Parameters,
    flow: FlowControl,
    /// What the last subroutine has returned.
    returned: Option<Real>,
    /// Where the last probing move found its contact, in work coordinates of then.
    probed: PerAxis<Coordinate, N>,
    probe_succeeded: bool,
    /// What M66 has read last: 1, 0, or -1.
    input_read: i8,
}

impl<const N: usize> Computed<N> {
    pub fn new(memory: ComputedMemory) -> Self {
        Self {
            parameters: Parameters::new(memory.cells),
            flow: FlowControl::new(memory.text),
            returned: None,
            probed: PerAxis::all(Coordinate::ZERO),
            probe_succeeded: false,
            input_read: 0,
        }
    }

    /// Forgets all but the macros.
    pub fn reset(&mut self) {
        self.parameters.reset();
        self.flow.reset();
        self.returned = None;
        self.probed = PerAxis::all(Coordinate::ZERO);
        self.probe_succeeded = false;
        self.input_read = 0;
    }

    /// Whether programs have left nothing behind that another could read, but macros and the place of a contact.
    pub fn is_blank(&self) -> bool {
        let text = self.flow.text.len() == usize::from(self.flow.macros);
        text && self.parameters.is_empty() && self.returned.is_none() && self.input_read == 0
    }

    /// A line is going to be checked: what one before it would have set, and did not, is forgotten.
    pub fn begin(&mut self) {
        self.parameters.drop_staged();
    }

    /// Whether the line sets a parameter.
    pub fn assigns(&self) -> bool {
        self.parameters.has_staged()
    }

    /// Takes over what the line sets.
    pub fn commit(&mut self) {
        self.parameters.commit();
    }

    /// Calls under way.
    pub fn level(&self) -> u8 {
        self.parameters.level()
    }

    /// M2, M30: forgets what is local to the program, its subroutines among it.
    pub fn end_program(&mut self) {
        self.flow.end_program();
        self.parameters.end_program();
    }
}
