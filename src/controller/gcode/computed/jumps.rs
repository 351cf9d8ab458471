//! Words of Fanuc's macros: `IF [..] THEN`, GOTO within held text (recorded lines), and calls of macros by M words
//! (M10, M11, M100 to M199). `WHILE [..] DO1` .. `END1` are loops like those of O words: see `flow`.
//!
//! A jump stays within the running text: a subprogram, a subroutine, a loop, or the held part of a program. It leaves
//! the loops that do not contain its target. A jump into a loop is an error at the end of that loop. A line that is
//! executed as the host sends it cannot jump, because the lines before it are not stored and the lines after it have
//! not arrived.

use super::flow::{FlowControl, FlowState, FrameKind, HeldLine, Keyword, OWord};
use crate::error::Error;
use crate::gcode::comment::split_comment;
use crate::gcode::direction::Held;
use crate::gcode::state::Interpreter;

impl<const N: usize> Interpreter<N> {
    /// Executes `IF [..] THEN` in a held (recorded) line. If the condition is true, leaves only the words after THEN
    /// in the line; otherwise empties the line.
    #[inline(never)]
    pub(super) fn then(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        let order = OWord::of(line).ok_or(Error::FlowSyntax)?;
        if !self.condition(order.arguments)? {
            line.clear();
            return Ok(Held::Again);
        }
        let (words, _) = split_comment(line);
        let start = words.len() - order.label.len();
        line.copy_within(start.., 0);
        line.truncate(line.len() - start);
        self.note_for_modal_call(line);
        Ok(Held::Line)
    }

    /// Executes GOTO in held text (recorded lines). If its condition is true or absent, continues with the line that
    /// has this N number. Looks for this line below the GOTO first, then from the start of the text.
    #[inline(never)]
    pub(super) fn go_to(&mut self, order: &OWord) -> Result<(), Error> {
        if !order.arguments.is_empty() && !self.condition(order.arguments)? {
            return Ok(());
        }
        let (value, rest) = self.value(order.label)?;
        let number = value.whole().filter(|_| rest.is_empty()).ok_or(Error::FlowSyntax)?;
        let flow = &mut self.computed.flow;
        let target = flow.numbered(number, flow.next).or_else(|| flow.numbered(number, flow.beginning()?));
        let target = target.ok_or(Error::FlowSyntax)?;
        flow.leave_loops(target);
        flow.go_back(target)
    }
}

impl FlowControl {
    /// Reads the O word of a line. M10, M11 and M100 to M199 count as O words only if they have a macro.
    #[inline(never)]
    pub(super) fn order_of<'l>(&self, line: &'l [u8]) -> Option<OWord<'l>> {
        let is_known = |order: &OWord| order.keyword != Keyword::CallMacroOfM || self.find_macro(order.label).is_some();
        OWord::of(line).filter(is_known)
    }

    /// Returns the start of the text in which a jump looks for its target: the called subprogram or subroutine that is
    /// running, or else the held lines of the program.
    #[inline(never)]
    fn beginning(&self) -> Option<u16> {
        let mut labels = self.labels();
        for frame in self.frames.get(usize::from(self.below)..)?.iter().rev() {
            let (others, label) = labels.split_at_checked(labels.len().checked_sub(usize::from(frame.label))?)?;
            if frame.kind.is_call() {
                // A subroutine of the program and a macro can have the same label. Look among the macros if the
                // running text is a macro, otherwise among the program's subroutines.
                let found = if self.next < self.macros { self.find_macro(label) } else { self.find_own(label) };
                return found.map(|(_, begin)| begin);
            }
            labels = others;
        }
        if let FlowState::Running(from) = self.state { from } else { None }
    }

    /// Looks for a line number (N) from position `from` to the end of the subprogram or program. Returns the position
    /// of the first line with this number; `None` if there is none.
    #[inline(never)]
    fn numbered(&self, number: i64, from: u16) -> Option<u16> {
        let mut at = from;
        loop {
            let line = self.line(at)?;
            if OWord::of(line).is_some_and(|order| matches!(order.keyword, Keyword::EndSub | Keyword::Program)) {
                return None;
            }
            if let Some(digits) = line.strip_prefix(b"N") {
                let digits = digits.iter().take_while(|byte| byte.is_ascii_digit());
                let read = |value: i64, digit: &u8| value.saturating_mul(10).saturating_add(i64::from(digit - b'0'));
                if digits.fold(0, read) == number {
                    return Some(at);
                }
            }
            at += 1 + line.len() as u16;
        }
    }

    /// Closes the loops and conditions of the running text that do not contain the line at `target`.
    fn leave_loops(&mut self, target: u16) {
        while self.frames.len() > usize::from(self.below)
            && let Some(frame) = self.frames.last()
        {
            let (first, end) = match frame.kind {
                FrameKind::Call | FrameKind::Program(_) => return,
                // A jump to the first line of a `while` leaves the loop, because this line opens the loop again. So
                // the range of the loop begins one byte after the start of this line.
                FrameKind::While => (frame.at + 1, Keyword::EndWhile),
                FrameKind::Do => (frame.at, Keyword::While),
                FrameKind::Repeat(_) => (frame.at, Keyword::EndRepeat),
                // A frame does not store where its condition is in the text, so the condition is always closed. If the
                // target is within the condition, its `endif` becomes an error.
                FrameKind::If(_) => {
                    self.pop();
                    continue;
                }
            };
            let end = self.find_order(frame.at, end, self.last_label());
            if end.is_some_and(|(end, _)| (first..=end).contains(&target)) {
                return;
            }
            self.pop();
        }
    }
}
