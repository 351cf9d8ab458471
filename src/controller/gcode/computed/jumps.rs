//! Words of Fanuc's macros: `IF [..] THEN`, and GOTO within held text. `WHILE [..] DO1` .. `END1` are loops like those of
//! O words (see `flow`). Also calls of macros by M words: M10, M11, M100 to M199.
//!
//! A jump stays in the text that runs: a subprogram, a subroutine, a loop, or the held part of a program. It leaves the
//! loops that do not contain its target. A jump into a loop is an error at the end of that loop. The stream has no
//! jumps, because its earlier lines are gone and its later ones have not come.

use super::flow::{ARGUMENTS, FlowControl, FlowState, FrameKind, HeldLine, Keyword, OWord, SPARE};
use super::real::Real;
use crate::error::Error;
use crate::gcode::direction::{Direction, Held};
use crate::gcode::remark::split_remark;
use crate::gcode::state::Interpreter;

impl<const N: usize> Interpreter<N> {
    /// Executes `IF [..] THEN` in a line of the host: the words behind THEN are held and run like a loop.
    #[inline(never)]
    pub(super) fn run_then(&mut self, order: &OWord, remark: &[u8]) -> Result<Direction, Error> {
        if !self.condition(order.arguments)? {
            return Ok(Direction::LeftOut);
        }
        let flow = &mut self.computed.flow;
        let from = flow.text.len() as u16;
        flow.hold(order.label, remark, SPARE)?;
        flow.of_host = true;
        flow.run(from, Some(from));
        Ok(Direction::Run)
    }

    /// Executes `IF [..] THEN` in a held line: leaves only the words behind THEN in it.
    #[inline(never)]
    pub(super) fn then(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        let order = OWord::of(line).ok_or(Error::FlowSyntax)?;
        if !self.condition(order.arguments)? {
            line.clear();
            return Ok(Held::Again);
        }
        let (words, _) = split_remark(line);
        let start = words.len() - order.label.len();
        line.copy_within(start.., 0);
        line.truncate(line.len() - start);
        Ok(Held::Line)
    }

    /// Executes GOTO in the running text.
    #[inline(never)]
    pub(super) fn go_to(&mut self, order: &OWord) -> Result<(), Error> {
        if !order.arguments.is_empty() && !self.condition(order.arguments)? {
            return Ok(());
        }
        let (value, rest) = self.value(order.label)?;
        let number = value.whole().filter(|_| rest.is_empty()).ok_or(Error::FlowSyntax)?;
        let flow = &mut self.computed.flow;
        let (from, end) = flow.scope().ok_or(Error::FlowSyntax)?;
        let target = flow.numbered(number, flow.next, end).or_else(|| flow.numbered(number, from, end));
        let target = target.ok_or(Error::FlowSyntax)?;
        flow.leave_loops(target);
        flow.go_back(target)
    }

    /// Reads the values that an M word passes to its macro: P is #1, Q is #2.
    #[inline(never)]
    pub(super) fn arguments_of_m(&self, text: &[u8]) -> Result<heapless::Vec<(u8, Real), ARGUMENTS>, Error> {
        let mut values = heapless::Vec::new();
        let mut rest = text;
        for (number, letter) in [(1, b'P'), (2, b'Q')] {
            if let Some((of, text)) = rest.split_first()
                && *of == letter
            {
                let (value, behind) = self.value(text)?;
                let _ = values.push((number, value));
                rest = behind;
            }
        }
        if rest.is_empty() { Ok(values) } else { Err(Error::UnusedWords) }
    }
}

impl FlowControl {
    /// Returns where the running text begins and ends in which a jump can find its target: the innermost subprogram or
    /// subroutine, or the held lines of the program.
    #[inline(never)]
    fn scope(&self) -> Option<(u16, u16)> {
        let mut labels = self.labels();
        for frame in self.frames.get(usize::from(self.below)..)?.iter().rev() {
            let (others, label) = labels.split_at_checked(labels.len().checked_sub(usize::from(frame.label))?)?;
            if frame.kind.is_call() {
                let (_, begin) = self.find(label)?;
                let is_end = |order: &OWord| order.keyword == Keyword::EndSub && order.label == label;
                let (end, _) = self.find_from(begin, is_end)?;
                return (begin..=end).contains(&self.next).then_some((begin, end));
            }
            labels = others;
        }
        let FlowState::Running(Some(from)) = self.state else { return None };
        let is_subprogram = |order: &OWord| order.keyword == Keyword::Program;
        Some((from, self.find_from(from, is_subprogram).map_or(self.text.len() as u16, |(at, _)| at)))
    }

    /// Returns the position of the first line from `from` up to `end` that has this line number.
    #[inline(never)]
    fn numbered(&self, number: i64, from: u16, end: u16) -> Option<u16> {
        let mut at = from;
        while at < end {
            let line = self.line(at)?;
            if let Some(digits) = line.strip_prefix(b"N") {
                let digits = digits.iter().take_while(|byte| byte.is_ascii_digit());
                let read = |value: i64, digit: &u8| value.saturating_mul(10).saturating_add(i64::from(digit - b'0'));
                if digits.fold(0, read) == number {
                    return Some(at);
                }
            }
            at += 1 + line.len() as u16;
        }
        None
    }

    /// Closes the loops and conditions of the running text that do not contain the line at `target`.
    fn leave_loops(&mut self, target: u16) {
        while self.frames.len() > usize::from(self.below)
            && let Some(frame) = self.frames.last()
        {
            let (first, end) = match frame.kind {
                FrameKind::Call | FrameKind::Program(_) => return,
                // The first line of a `while` pushes its frame again.
                FrameKind::While => (frame.at + 1, Keyword::EndWhile),
                FrameKind::Do => (frame.at, Keyword::While),
                FrameKind::Repeat(_) => (frame.at, Keyword::EndRepeat),
                // A condition has no position. If the target is within it, its `endif` is an error.
                FrameKind::If(_) => {
                    self.pop();
                    continue;
                }
            };
            let label = self.last_label();
            let end = self.find_from(frame.at, |order| order.keyword == end && order.label == label);
            if end.is_some_and(|(end, _)| (first..=end).contains(&target)) {
                return;
            }
            self.pop();
        }
    }
}
