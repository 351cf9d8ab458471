//! Replaces this folder (`computed`) in builds without the feature `full`: the same functions, without effect. Lines
//! that need the feature are refused with an error of their own.

use crate::axes::PerAxis;
use crate::error::Error;
use crate::gcode::direction::{Direction, Held};
use crate::gcode::program_number::{behind_digits, behind_line_number};
use crate::gcode::state::{Interpreter, ProgramPlace};
use crate::gcode::word::Word;
use crate::units::Coordinate;

/// Minimum capacity of the held text, in bytes: this build holds no text.
#[cfg(feature = "alloc")]
pub const LEAST_HELD: usize = 0;

/// Empty: this build has no parameters and no held text.
#[derive(Debug)]
pub(super) struct ComputedMemory;

/// Empty: this build has no parameters and no held text.
#[derive(Debug)]
#[cfg(not(feature = "alloc"))]
pub(super) struct ComputedStorage<const HELD: usize>;

#[cfg(not(feature = "alloc"))]
impl<const HELD: usize> ComputedStorage<HELD> {
    pub const EMPTY: Self = Self;

    pub fn lend(&'static mut self) -> ComputedMemory {
        ComputedMemory
    }
}

#[cfg(feature = "alloc")]
impl ComputedMemory {
    pub fn on_heap(_: usize) -> Self {
        Self
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Computed<const N: usize>;

impl<const N: usize> Computed<N> {
    pub fn new(_: ComputedMemory) -> Self {
        Self
    }

    pub fn reset(&mut self) {}

    pub fn end_modal_call(&mut self) {}

    pub fn has_modal_call(&self) -> bool {
        false
    }

    pub fn forget_number(&mut self) {}

    pub fn count_refused(&mut self, _: &[u8]) {}

    pub fn begin(&mut self) {}

    pub fn assigns(&self) -> bool {
        false
    }

    pub fn commit(&mut self) {}

    pub fn level(&self) -> u8 {
        0
    }

    pub fn end_program(&mut self) {}

    /// Returns `true`: there are no parameters and subroutines that a program could leave behind.
    pub fn is_blank(&self) -> bool {
        true
    }
}

#[inline(never)]
fn is_o_word(line: &[u8]) -> bool {
    let behind = behind_line_number(line).strip_prefix(b"O").map(behind_digits);
    matches!(behind, Some([b'A'..=b'Z', b'A'..=b'Z', ..] | [b'<' | b'#' | b'[', ..]))
}

/// A line of a subroutine, loop or macro, of which this build has none.
pub type HeldLine = heapless::Vec<u8, 1>;

impl<const N: usize> Interpreter<N> {
    /// Refuses O words with a keyword. Returns [`Direction::Check`] for every other line, including a program number
    /// such as `O1000`.
    pub fn direct(&mut self, line: &[u8], _: &[u8], _: u32) -> Result<Direction, Error> {
        if is_o_word(line) { Err(Error::ExpressionsLeftOut) } else { Ok(Direction::Check) }
    }

    /// Returns `false`: there are no subroutines to call.
    pub fn begin_call(&mut self, _: &[u8]) -> Result<bool, Error> {
        Ok(false)
    }

    /// Does nothing: no lines are recorded.
    pub fn line_refused(&mut self, _: Error) {}

    /// Returns `None`: there are no blocks.
    pub fn open_since(&self) -> Option<u32> {
        None
    }

    /// Begins the next program; there are no open blocks.
    pub fn tape_mark(&mut self) -> Result<(), Error> {
        self.begin_program();
        Ok(())
    }

    /// Abandons the program, and refuses all lines that follow until another program begins. Returns the error for the
    /// present line.
    #[cold]
    #[inline(never)]
    pub(in crate::gcode) fn refuse_rest(&mut self) -> Error {
        self.abandon_program();
        self.place = ProgramPlace::Refused;
        Error::OutOfPlace
    }

    /// Returns `error`: a line cannot be a call.
    pub fn direct_refused(&mut self, _: &[u8], _: &[u8], error: Error) -> Result<Direction, Error> {
        Err(error)
    }

    pub(super) fn look_among_subprograms(&mut self, _: &[u8]) -> bool {
        false
    }

    /// Returns `None`: no program is held.
    pub fn excess_bytes(&self) -> Option<usize> {
        None
    }

    /// Returns `false`: no program is held.
    pub fn is_held(&self) -> bool {
        false
    }

    pub(super) fn is_holding(&self) -> bool {
        false
    }

    /// Returns `false`: no line is recorded.
    pub(super) fn is_recording(&self) -> bool {
        false
    }

    /// Does nothing: this build has no held text, so no line of held text can be refused.
    pub fn refused_in_run(&mut self, _: &[u8]) {}

    /// Returns `None`: no program waits.
    pub fn awaited_subprogram(&self) -> Option<u32> {
        None
    }

    /// Returns 0: no line is skipped.
    pub fn skipped(&self) -> u32 {
        0
    }

    /// Returns [`Held::End`]: there are no recorded lines.
    pub fn next_held(&mut self, _: &mut HeldLine) -> Result<Held, Error> {
        Ok(Held::End)
    }

    /// Does nothing: there are no recorded lines.
    pub fn abandon_held(&mut self) {}

    /// Returns `false`: there are no blocks.
    pub fn is_within_block(&self) -> bool {
        false
    }

    /// Returns `None`: there are no macros.
    pub fn macro_line(&self, _: usize) -> Option<&[u8]> {
        None
    }

    /// Returns an error always: there is no room for macros.
    ///
    /// # Errors
    /// [`Error::ExpressionsLeftOut`]
    pub fn set_macro_line(&mut self, _: usize, _: &[u8]) -> Result<(), Error> {
        Err(Error::ExpressionsLeftOut)
    }

    /// Does nothing: there are no macros.
    pub fn clear_macros(&mut self) {}

    /// Abandons the program: ends G68 and G51, because no other program expects them. There are no open blocks.
    pub fn abandon_program(&mut self) {
        self.rotation = None;
        self.scaling = None;
    }

    /// Does nothing: no parameter shows the probed position.
    pub fn set_probed(&mut self, _: &PerAxis<Coordinate, N>, _: bool) {}

    /// Does nothing: no parameter shows the input read by M66.
    pub fn set_input_read(&mut self, _: Option<bool>) {}

    /// Copies the message unchanged: there are no parameters.
    pub fn expand<const LENGTH: usize>(&self, comment: &[u8], out: &mut heapless::Vec<u8, LENGTH>) {
        for byte in comment {
            let _ = out.push(*byte);
        }
    }

    #[cfg(feature = "reasons")]
    pub(super) fn explain_flow(&self, line: &[u8], error: Error, out: &mut super::Reason) -> bool {
        if is_o_word(line) {
            let _ = out.extend_from_slice(error.text().as_bytes());
        }
        is_o_word(line)
    }

    #[cfg(feature = "reasons")]
    pub(super) fn unset_parameter<'t>(&self, _: &'t [u8]) -> Option<&'t [u8]> {
        None
    }

    pub(super) fn compute<'t>(&self, _: u8, text: &'t [u8]) -> Result<(Word, &'t [u8]), Error> {
        let signs = text.iter().take_while(|byte| matches!(byte, b'-' | b'+')).count();
        match text.get(signs) {
            Some(b'[' | b'#') => Err(Error::ExpressionsLeftOut),
            _ => Err(Error::BadNumber),
        }
    }

    pub(super) fn assign<'t>(&mut self, _: &'t [u8]) -> Result<&'t [u8], Error> {
        Err(Error::ExpressionsLeftOut)
    }
}
