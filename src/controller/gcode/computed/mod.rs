//! Expressions, parameters and O words of a program. [`Computed`] holds their state. The interpreter prepares this
//! state before each line and commits it with the line. The end of a program resets parts of it. A build without the
//! feature `full` has `none.rs` instead.

mod calls;
#[cfg(feature = "reasons")]
mod explain;
mod expression;
mod flow;
mod jumps;
mod m_words;
mod machine_values;
mod macros;
mod modal_calls;
mod o_words;
mod overflow;
mod parameters;
mod real;
mod subprograms;
#[cfg(test)]
mod tests;

use crate::axes::PerAxis;
use crate::gcode::REASONS;
use crate::lent::Lent;
use crate::units::Coordinate;
use flow::{FlowControl, HeldText};
use overflow::Overflow;
use parameters::{Cells, Parameters};
use real::Real;

pub use flow::HeldLine;
#[cfg(feature = "alloc")]
pub use flow::LEAST_HELD;

/// Memory of one [`Computed`]: references to static storage on boards, boxes in programs on a PC.
#[derive(Debug)]
pub(super) struct ComputedMemory {
    cells: Lent<Cells>,
    text: Lent<HeldText>,
    /// Maximum number of bytes in `text`.
    held: usize,
}

/// Static storage on a board for the memory of one [`Computed`], with `HELD` bytes for held text (recorded lines).
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub(super) struct ComputedStorage<const HELD: usize> {
    cells: Cells,
    text: heapless::Vec<u8, HELD>,
}

#[cfg(not(feature = "alloc"))]
impl<const HELD: usize> ComputedStorage<HELD> {
    pub const EMPTY: Self = Self { cells: Cells::new(), text: heapless::Vec::new() };

    pub fn lend(&'static mut self) -> ComputedMemory {
        ComputedMemory { cells: &mut self.cells, text: self.text.as_mut_view(), held: HELD }
    }
}

#[cfg(feature = "alloc")]
impl ComputedMemory {
    pub fn on_heap(held: usize) -> Self {
        Self { cells: Lent::new(Cells::new()), text: Lent::new(HeldText::new()), held: held.min(flow::MOST_HELD) }
    }
}

/// The interpreter's state for expressions, parameters and O words.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct Computed<const N: usize> {
    parameters: Parameters,
    flow: FlowControl,
    /// Value that the most recent subroutine returned; `None` if it returned no value.
    returned: Option<Real>,
    /// Position of the most recent probing result, in the program coordinates that were in force at that time.
    probed: PerAxis<Coordinate, N>,
    probe_succeeded: bool,
    /// Result of the most recent M66: 1 (input active), 0 (inactive) or -1 (timeout).
    input_read: i8,
    /// O number of the program; 0 if it has none.
    program: u32,
    /// Count of the missing bytes, if the most recent held program did not fit into the memory.
    overflow: Overflow,
}

impl<const N: usize> Computed<N> {
    pub fn new(memory: ComputedMemory) -> Self {
        Self {
            parameters: Parameters::new(memory.cells),
            flow: FlowControl::new(memory.text, memory.held),
            returned: None,
            probed: PerAxis::all(Coordinate::ZERO),
            probe_succeeded: false,
            input_read: 0,
            program: 0,
            overflow: Overflow::default(),
        }
    }

    /// Forgets the parameters, the results of subroutines, probing and M66, and the held text except the macros.
    pub fn reset(&mut self) {
        self.parameters.reset();
        self.flow.reset();
        self.returned = None;
        self.probed = PerAxis::all(Coordinate::ZERO);
        self.probe_succeeded = false;
        self.input_read = 0;
    }

    /// Ends the modal call of G66, if there is one. Called after a refused line, by `$X`, and when another program
    /// begins.
    pub fn end_modal_call(&mut self) {
        self.flow.modal.end();
    }

    /// Returns whether a modal call (G66) is active.
    pub fn has_modal_call(&self) -> bool {
        self.flow.modal.is_active()
    }

    /// Forgets the program's O number, ends G66, and stops counting the missing bytes of a held program that did not
    /// fit. Called when another program begins.
    pub fn forget_number(&mut self) {
        self.end_modal_call();
        self.program = 0;
        self.overflow.end();
    }

    /// Counts the bytes of a refused line, if it belongs to a held program that did not fit into the memory. The sum
    /// tells by how many bytes the program is too long. Counts only in builds with `reasons`.
    pub fn count_refused(&mut self, line: &[u8]) {
        if REASONS {
            self.overflow.count(&self.flow, line);
        }
    }

    /// Returns whether another program starts without traces of earlier ones: no state is left that it could read,
    /// except macros and the most recent probe position.
    pub fn is_blank(&self) -> bool {
        let text = self.flow.text.len() == usize::from(self.flow.macros) && !self.flow.modal.is_active();
        text && self.parameters.is_empty() && self.returned.is_none() && self.input_read == 0
    }

    /// Prepares the check of a line: drops the assignments of an earlier line that was not committed.
    pub fn begin(&mut self) {
        self.parameters.drop_staged();
    }

    /// Returns whether the line being checked assigns a parameter.
    pub fn assigns(&self) -> bool {
        self.parameters.has_staged()
    }

    /// Puts the assignments of the checked line into force.
    pub fn commit(&mut self) {
        self.parameters.commit();
    }

    /// Returns the number of active subroutine calls.
    pub fn level(&self) -> u8 {
        self.parameters.level()
    }

    /// Ends the program (M2, M30): forgets everything local to the program, including its subroutines.
    pub fn end_program(&mut self) {
        self.flow.end_program();
        self.parameters.end_program();
    }
}
