//! Macros (`$Mn=line`): numbered lines that outlive programs, resets and power cycles. A program can call a subroutine
//! that they define.
//!
//! They are the first lines of the held text: what ends a program keeps them. A line that a number has none of is empty.

use super::flow::{FlowControl, FlowState, MOST_MACROS};
use crate::error::Error;
use crate::gcode::state::Interpreter;

/// Macros may have so many lines.
pub(super) const LINES: usize = 64;

impl FlowControl {
    /// A line of the macros, if it has this number or there are any behind it.
    fn macro_line(&self, index: usize) -> Option<&[u8]> {
        let mut at = 0;
        for _ in 0..index {
            at = self.behind(at)?;
        }
        if at < self.macros { self.line(at) } else { None }
    }

    /// Where the line behind one of the macros begins.
    fn behind(&self, at: u16) -> Option<u16> {
        if at >= self.macros {
            return None;
        }
        Some(at + 1 + self.line(at)?.len() as u16)
    }

    /// Puts a line in the place of the one with this number, with empty ones before it as far as there are none. Subroutines of a
    /// program are kept behind them; what runs or is recorded must not be moved.
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
        let (free, all) = (self.text.capacity() - self.text.len(), usize::from(self.macros));
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
    /// The line of this number, 0 to 63, of the macros; nothing behind the last.
    pub fn macro_line(&self, index: usize) -> Option<&[u8]> {
        self.computed.flow.macro_line(index)
    }

    /// Sets a line of the macros; an empty one removes it.
    ///
    /// # Errors
    /// [`Error::InvalidStatement`] for a number above 63, [`Error::OutOfMemory`] if there is no room, [`Error::NotIdle`] within a
    /// subroutine, loop or condition that has begun. Nothing has changed then.
    pub fn set_macro_line(&mut self, index: usize, line: &[u8]) -> Result<(), Error> {
        self.computed.flow.set_macro_line(index, line)
    }

    /// Forgets all macros.
    pub fn clear_macros(&mut self) {
        self.computed.flow.clear_macros();
    }
}
