//! Macros (`$Mn=line`): numbered lines that survive programs, resets and power cycles. They can define subroutines,
//! which a program can call.
//!
//! Macros are the first lines of the held text (recorded lines: see `flow`), and remain there when a program ends. The
//! held text has a line for each number up to the highest number in use. The line of an unused number is empty.

use super::flow::{FlowControl, FlowState, MOST_MACROS};
use crate::error::Error;
use crate::gcode::state::Interpreter;

/// Maximum number of macro lines.
pub(super) const LINES: usize = 64;

impl FlowControl {
    /// Returns the macro line with this number. The line of an unused number is empty; above the highest number in use
    /// the result is `None`.
    fn macro_line(&self, index: usize) -> Option<&[u8]> {
        let mut at = 0;
        for _ in 0..index {
            at = self.behind(at)?;
        }
        if at < self.macros { self.line(at) } else { None }
    }

    /// Returns the position after the macro line that begins at `at`.
    fn behind(&self, at: u16) -> Option<u16> {
        if at >= self.macros {
            return None;
        }
        Some(at + 1 + self.line(at)?.len() as u16)
    }

    /// Replaces the macro line with this number, and adds empty lines for missing lower numbers. This moves all text
    /// after the line, such as the subroutines of a program. So the call is refused while a subroutine, loop or
    /// condition is open.
    fn set_macro_line(&mut self, index: usize, line: &[u8]) -> Result<(), Error> {
        if index >= LINES {
            return Err(Error::InvalidStatement);
        }
        if self.state != FlowState::Streaming || !self.frames.is_empty() {
            return Err(Error::NotIdle);
        }
        let (mut at, mut missing) = (0, 0);
        for _ in 0..index {
            match self.behind(at) {
                Some(next) => at = next,
                None => missing += 1,
            }
        }
        let replaced = self.behind(at).map_or(0, |next| usize::from(next - at));
        if line.is_empty() && replaced == 0 {
            return Ok(());
        }
        let length = u8::try_from(line.len()).map_err(|_| Error::OutOfMemory)?;
        let added = missing + 1 + line.len();
        let (free, all) = (self.most.saturating_sub(self.text.len()), usize::from(self.macros));
        if added > free + replaced || all + added > MOST_MACROS + replaced {
            return Err(Error::OutOfMemory);
        }
        let at = usize::from(at);
        if let Some(text) = self.text.get_mut(at..) {
            text.rotate_left(replaced);
        }
        self.text.truncate(self.text.len() - replaced);
        for byte in core::iter::repeat_n(0, missing).chain([length]).chain(line.iter().copied()) {
            let _ = self.text.push(byte);
        }
        if let Some(text) = self.text.get_mut(at..) {
            text.rotate_right(added);
        }
        self.macros = (all + added - replaced) as u16;
        Ok(())
    }

    fn clear_macros(&mut self) {
        if let Some(text) = self.text.get_mut(..) {
            text.rotate_left(usize::from(self.macros));
        }
        self.text.truncate(self.text.len() - usize::from(self.macros));
        self.macros = 0;
    }
}

impl<const N: usize> Interpreter<N> {
    /// Returns the macro line with this number, 0 to 63; `None` above the highest number in use.
    pub fn macro_line(&self, index: usize) -> Option<&[u8]> {
        self.computed.flow.macro_line(index)
    }

    /// Sets the macro line with this number, 0 to 63. An empty `line` removes the macro line.
    ///
    /// # Errors
    /// [`Error::InvalidStatement`] for a number above 63, [`Error::OutOfMemory`] if there is no room,
    /// [`Error::NotIdle`] while a subroutine, loop or condition is open. Nothing is changed in these cases.
    pub fn set_macro_line(&mut self, index: usize, line: &[u8]) -> Result<(), Error> {
        self.computed.flow.set_macro_line(index, line)
    }

    /// Forgets all macros.
    pub fn clear_macros(&mut self) {
        self.computed.flow.clear_macros();
    }
}
