//! O words (`O100 SUB`, `O1 IF [#1 GT 2]`): decides for each line of the host whether it is run, recorded or skipped,
//! and which recorded line runs next. Handles conditions, loops, subroutines and their calls; `flow` stores the open
//! blocks. A malformed O word is refused. If it begins a subroutine or loop, all lines of this block are refused too.
//! If it begins a condition, the lines of all its branches are skipped.

use super::Computed;
use super::flow::{
    ARGUMENTS, FlowState, FrameKind, HeldLine, Keyword, LABELS, OWord, PASSES, SPARE, STREAM, ends_program,
};
use super::real::Real;
use super::subprograms::{is_jump, split_call};
use crate::error::Error;
use crate::gcode::direction::{Direction, Held};
use crate::gcode::program_number::has_program_number;
use crate::gcode::state::Interpreter;
use core::fmt::Write;

/// The label of a call: a name or digits.
type Label = heapless::Vec<u8, LABELS>;

/// Line that runs at the end of a call if M73 has saved the modal state in this call. M72 restores the saved state.
const RESTORE: &[u8] = b"M72";

impl<const N: usize> Interpreter<N> {
    /// Returns what to do with a line of the host. `number`: how many lines the host has sent so far, with this one.
    /// `comment`: the line's message with its mark (see `split_comment`). `line` is empty if the line consists of a
    /// message alone.
    ///
    /// After an error, no part of the line has been executed. If a condition cannot be computed, none of its branches
    /// will run.
    #[inline]
    pub fn direct(&mut self, line: &[u8], comment: &[u8], number: u32) -> Result<Direction, Error> {
        self.computed.begin();
        let flow = &mut self.computed.flow;
        flow.line = number;
        let plain = flow.state == FlowState::Streaming && !flow.skipping && !flow.modal.is_active();
        let may_direct = match line.first() {
            Some(b'O' | b'N' | b':' | b'M' | b'W' | b'E') => true,
            Some(b'G') => matches!(line, [_, b'6', b'5' | b'6', ..] | [_, b'0', b'6', b'5' | b'6', ..] | [_, b'O', ..]),
            Some(b'I') => matches!(line, [_, b'F', ..]),
            _ => false,
        };
        if plain && !may_direct {
            return Ok(Direction::Check);
        }
        flow.of_host = true;
        let order = flow.order_of(line);
        self.direct_order(line, comment, order)
    }

    /// Begins the call of a subroutine from a startup line, which does not belong to the host's program. The lines of
    /// the subroutine run next. Returns `false` if the line has no O word.
    ///
    /// # Errors
    /// The errors of a call; [`Error::FlowSyntax`] for all other O words; [`Error::NotIdle`] while a block is open.
    pub fn begin_call(&mut self, line: &[u8]) -> Result<bool, Error> {
        match OWord::of(line) {
            None => Ok(false),
            Some(order) if order.keyword != Keyword::Call => Err(Error::FlowSyntax),
            Some(_) if self.is_within_block() => Err(Error::NotIdle),
            order => {
                self.computed.begin();
                self.computed.flow.of_host = false;
                self.direct_order(line, &[], order).map(|_| true)
            }
        }
    }

    /// Returns the number of lines of the present program that conditions have skipped.
    pub fn skipped(&self) -> u32 {
        self.computed.flow.skipped
    }

    /// Returns the number of the host's line at which the outermost open block (sub, loop, condition) began; `None` if
    /// no block is open. After a program that has ended inside a block, returns the line at which that block began.
    pub fn open_since(&self) -> Option<u32> {
        let flow = &self.computed.flow;
        flow.open_since().or(flow.cut)
    }

    /// Returns whether a subroutine, loop or condition is open.
    pub fn is_within_block(&self) -> bool {
        self.computed.flow.open_since().is_some()
    }

    /// Handles a tape mark (`%`), which separates programs. A block that is still open is dropped and is an error.
    ///
    /// # Errors
    /// [`Error::FlowSyntax`] if a block was open; [`Error::OutOfPlace`] if the program waits for a subprogram.
    pub fn tape_mark(&mut self) -> Result<(), Error> {
        let is_open = self.computed.flow.open_since().is_some();
        let error = if self.computed.flow.waiting.is_some() { Error::OutOfPlace } else { Error::FlowSyntax };
        self.begin_program();
        if !is_open {
            return Ok(());
        }
        self.computed.end_program();
        Err(error)
    }

    /// Checks whether the program has ended inside an open block. In this case its M2 or M30 was skipped or recorded,
    /// not executed. After such an M2 or M30, only O words that are not calls can still belong to the program. Any
    /// other `line` belongs to the next program, so this function drops the open blocks and refuses the line.
    fn look_for_end(&mut self, line: &[u8], order: Option<OWord>) -> Result<(), Error> {
        let flow = &mut self.computed.flow;
        let left_out = flow.leaves_lines_out();
        if line.is_empty() {
            return Ok(());
        }
        if order.is_some_and(|order| !left_out || !flow.after_end || order.may_follow_end()) {
            flow.cut = None;
        } else if left_out && flow.after_end {
            self.computed.end_program();
            self.note_end();
            self.refused_line(Some(line));
            return Err(Error::FlowSyntax);
        }
        flow.after_end = left_out && order.is_none() && ends_program(line);
        Ok(())
    }

    fn direct_order(&mut self, line: &[u8], comment: &[u8], order: Option<OWord>) -> Result<Direction, Error> {
        if self.computed.flow.records()
            && order.is_none()
            && !is_jump(line)
            && !has_program_number(line)
            && let Some((words, call)) = split_call(line)
        {
            // The words before M98 or M99 are held as a line of their own.
            self.direct_part(words, &[], None)?;
            return self.direct_part(call, comment, OWord::of(call));
        }
        self.direct_part(line, comment, order)
    }

    /// Decides what to do with a line. Records the lines of subroutines and loops; executes an O word that is in none
    /// of them. `line` can also be one of the two parts into which `split_call` has split a line.
    fn direct_part(&mut self, line: &[u8], comment: &[u8], order: Option<OWord>) -> Result<Direction, Error> {
        if let Some(directed) = self.direct_subprogram(line, comment, order) {
            return directed;
        }
        self.look_for_end(line, order)?;
        if let FlowState::Recording(from, error) = self.computed.flow.state {
            return self.record(line, comment, order, from, error);
        }
        let flow = &mut self.computed.flow;
        if flow.skipping && !order.is_some_and(|order| order.ends_skipping() && flow.is_of_last(order.label)) {
            flow.skipped = flow.skipped.saturating_add(1);
            return Ok(Direction::LeftOut);
        }
        let has_modal_call = flow.modal.is_active();
        let Some(order) = order else {
            if let Some(b'O' | b':') = line.first() {
                self.note_number(line);
            }
            if has_modal_call {
                return self.direct_before_modal_call(line, comment);
            }
            return Ok(Direction::Check);
        };
        match order.keyword {
            Keyword::If | Keyword::ElseIf | Keyword::Else | Keyword::EndIf => self.branch(order)?,
            Keyword::Call | Keyword::CallMacroOfM => {
                let (label, at) = self.called(&order)?;
                let arguments = self.arguments(&order)?;
                self.computed.flow.run(at, None);
                self.call(FrameKind::Call, &label, STREAM, &arguments)?;
                return Ok(Direction::Call);
            }
            Keyword::CallProgram | Keyword::CallMacro | Keyword::BeginModalCall | Keyword::Then => {
                return self.run_call(&[], line, comment, &order);
            }
            Keyword::GoTo => return Err(Error::NotSupported),
            Keyword::Back => return Err(self.refuse_rest()),
            Keyword::Sub | Keyword::Do | Keyword::While | Keyword::Repeat => {
                let from = flow.text.len() as u16;
                let held = order.must_be_well_formed().and_then(|()| flow.hold(line, comment, 0));
                flow.state = FlowState::Recording(from, held.err());
                flow.recorded_from = flow.line;
                if held.is_err() {
                    // The label and keyword of the refused block must be in the held text, so that the end of the block
                    // is recognized. If there is no room for them, all following lines are refused.
                    let length = line.len() - order.arguments.len();
                    flow.hold(line.get(..length).unwrap_or(&[]), &[], 0)?;
                }
                held?;
                return Ok(Direction::LeftOut);
            }
            _ => return Err(Error::FlowSyntax),
        }
        Ok(Direction::Done)
    }

    /// Records a line of a subroutine or loop. The last line of a loop starts the first pass. If a line is refused or
    /// does not fit, all lines up to the end of the block are refused, and the block is dropped.
    fn record(
        &mut self,
        line: &[u8],
        comment: &[u8],
        order: Option<OWord>,
        from: u16,
        error: Option<Error>,
    ) -> Result<Direction, Error> {
        let flow = &mut self.computed.flow;
        let opening = flow.line(from).and_then(OWord::of).ok_or(Error::FlowSyntax)?;
        let of_sub = opening.keyword == Keyword::Sub;
        let ends = order.is_some_and(|order| opening.is_ended_by(&order));
        let strange = order.is_some_and(|order| matches!(order.keyword, Keyword::Sub | Keyword::EndSub)) && !ends;
        let strange = strange || order.is_some_and(|order| !order.is_well_formed());
        let error = match error {
            None if strange => Some(Error::FlowSyntax),
            None => flow.hold(line, comment, SPARE).err(),
            error => error,
        };
        flow.state = match ends {
            true => FlowState::Streaming,
            false => FlowState::Recording(from, error),
        };
        match (error, order) {
            (Some(error), Some(order)) if ends => {
                if of_sub {
                    let end = line.get(..line.len() - order.arguments.len());
                    flow.refuse_sub(from, order.label, end.unwrap_or(line));
                } else {
                    flow.text.truncate(usize::from(from));
                }
                Err(error)
            }
            (Some(error), _) => Err(error),
            (None, Some(order)) if ends && of_sub => {
                // `find_own` returns the first definition, which is the older one if there are two.
                if flow.find_own(order.label).is_some_and(|(at, _)| at < from) {
                    flow.drop_sub(order.label);
                }
                Ok(Direction::LeftOut)
            }
            (None, _) if ends => {
                flow.run(from, Some(from));
                Ok(Direction::Run)
            }
            _ => Ok(Direction::LeftOut),
        }
    }

    /// Reads the next line of the held text that is running, and writes it to `line`. Writes an empty line if
    /// conditions or loops skip the line. An error ends the execution of the text.
    pub fn next_held(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        self.computed.begin();
        let next = self.next_line(line);
        match next {
            Ok(Held::Line | Held::Again) => {}
            _ if self.computed.flow.waiting.is_some() => {}
            Ok(Held::End) => self.stop_held(),
            Err(_) => self.abandon_held(),
        }
        next
    }

    /// Records that a line of the host was refused, possibly before `direct` was called for it. If a subroutine or loop
    /// is being recorded, it now lacks this line, so its remaining lines are refused. If a program is held or a
    /// subprogram is being recorded, all of it is dropped, and all lines that follow are refused.
    pub fn line_refused(&mut self, error: Error) {
        self.computed.begin();
        self.computed.end_modal_call();
        if self.is_held() {
            self.refuse_rest();
        } else if let FlowState::Recording(from, None) = self.computed.flow.state {
            self.computed.flow.state = FlowState::Recording(from, Some(error));
        }
    }

    fn next_line(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        let flow = &mut self.computed.flow;
        line.clear();
        if !matches!(flow.state, FlowState::Running(_)) {
            return Ok(Held::End);
        }
        if self.call_if_due()? {
            return Ok(Held::Again);
        }
        let flow = &mut self.computed.flow;
        let Some(text) = flow.line(flow.next) else {
            let complete = flow.frames.len() == usize::from(flow.below);
            return if complete { Ok(Held::End) } else { Err(Error::FlowSyntax) };
        };
        line.extend_from_slice(text).map_err(|_| Error::OutOfMemory)?;
        let at = flow.next;
        flow.next += 1 + text.len() as u16;
        let Some(order) = flow.order_of(line) else {
            if !flow.skipping {
                self.note_for_modal_call(line);
                return Ok(Held::Line);
            }
            line.clear();
            return Ok(Held::Again);
        };
        // `endsub` is not skipped, because the line after it does not belong to the subroutine. The first line of the
        // next subprogram is not skipped either: it is an error here.
        let ends = order.ends_skipping() && flow.is_of_last(order.label)
            || matches!(order.keyword, Keyword::EndSub | Keyword::Program);
        if flow.skipping && !ends {
            line.clear();
            return Ok(Held::Again);
        }
        match order.keyword {
            Keyword::If | Keyword::ElseIf | Keyword::Else | Keyword::EndIf => self.branch(order)?,
            Keyword::Call | Keyword::CallMacroOfM => {
                let back = flow.next;
                let (label, begin) = self.called(&order)?;
                let arguments = self.arguments(&order)?;
                self.call(FrameKind::Call, &label, back, &arguments)?;
                self.computed.flow.go_back(begin)?;
            }
            Keyword::CallProgram | Keyword::CallMacro => {
                if !self.call_from_text(&order, at)? {
                    line.clear();
                    return Ok(Held::End);
                }
            }
            Keyword::BeginModalCall => {
                if !self.begin_modal_call(&order, at)? {
                    line.clear();
                    return Ok(Held::End);
                }
            }
            Keyword::Then => return self.then(line),
            Keyword::GoTo => self.go_to(&order)?,
            Keyword::Return | Keyword::EndSub | Keyword::Back => return self.leave_call(line),
            Keyword::Sub | Keyword::Program => return Err(Error::FlowSyntax),
            _ => self.go_round(order, at)?,
        }
        Ok(Held::Again)
    }

    /// Executes `if`, `elseif`, `else`, `endif`.
    fn branch(&mut self, order: OWord) -> Result<(), Error> {
        match order.keyword {
            Keyword::If => {
                let flow = &mut self.computed.flow;
                flow.push(FrameKind::If(true), order.label, 0)?;
                // All branches count as skipped until the condition has been evaluated. So if the condition is an
                // error, none of them runs.
                flow.skipping = true;
                order.must_be_well_formed()?;
                let holds = self.condition(order.arguments)?;
                self.take_branch(order.label, holds, holds)
            }
            Keyword::ElseIf => {
                let taken = self.has_taken(order.label)?;
                self.take_branch(order.label, true, false)?;
                order.must_be_well_formed()?;
                let holds = !taken && self.condition(order.arguments)?;
                self.take_branch(order.label, taken || holds, holds)
            }
            Keyword::Else => {
                let taken = self.has_taken(order.label)?;
                self.take_branch(order.label, true, !taken && order.is_well_formed())?;
                order.must_be_well_formed()
            }
            _ => {
                self.has_taken(order.label)?;
                self.computed.flow.pop();
                self.computed.flow.skipping = false;
                order.must_be_well_formed()
            }
        }
    }

    /// Returns `true` if a branch of the innermost condition has run. Fails if the innermost block is not a condition
    /// with this label.
    fn has_taken(&mut self, label: &[u8]) -> Result<bool, Error> {
        match self.computed.flow.last(label)?.kind {
            FrameKind::If(taken) => Ok(taken),
            _ => Err(Error::FlowSyntax),
        }
    }

    fn take_branch(&mut self, label: &[u8], taken: bool, holds: bool) -> Result<(), Error> {
        self.computed.flow.last(label)?.kind = FrameKind::If(taken);
        self.computed.flow.skipping = !holds;
        Ok(())
    }

    /// Executes an O word of a loop in the held line at `at`: the first or last line of the loop, `break` or
    /// `continue`. Not called for lines of the host, because loops are always recorded before they run.
    fn go_round(&mut self, order: OWord, at: u16) -> Result<(), Error> {
        let next = self.computed.flow.next;
        match order.keyword {
            Keyword::While if self.computed.flow.last(order.label).is_ok_and(|frame| frame.kind == FrameKind::Do) => {
                let leaving = self.computed.flow.last(order.label)?.leaving;
                let again = !leaving && self.condition(order.arguments)?;
                self.end_pass(order.label, again)
            }
            Keyword::While => {
                let holds = self.condition(order.arguments)?;
                self.computed.flow.push(FrameKind::While, order.label, at)?;
                self.begin_pass(order.label, holds)
            }
            Keyword::Do => {
                self.computed.flow.push(FrameKind::Do, order.label, next)?;
                self.begin_pass(order.label, true)
            }
            Keyword::Repeat => {
                let count = self.argument(order.arguments)?.nearest_even();
                let beyond = if count.is_negative() { 0 } else { i64::MAX };
                let count = u32::try_from(count.whole().unwrap_or(beyond).max(0)).unwrap_or(u32::MAX);
                if count > PASSES {
                    return Err(Error::EndlessLoop);
                }
                self.computed.flow.push(FrameKind::Repeat(count), order.label, next)?;
                self.begin_pass(order.label, count > 0)
            }
            Keyword::EndWhile | Keyword::EndRepeat => {
                let frame = self.computed.flow.last(order.label)?;
                let again = match (&mut frame.kind, order.keyword) {
                    (FrameKind::While, Keyword::EndWhile) => true,
                    (FrameKind::Repeat(left), Keyword::EndRepeat) => {
                        *left = left.saturating_sub(1);
                        *left > 0
                    }
                    _ => return Err(Error::FlowSyntax),
                };
                let again = again && !frame.leaving;
                self.end_pass(order.label, again)
            }
            Keyword::Break | Keyword::Continue => self.cut_pass(order),
            _ => Err(Error::FlowSyntax),
        }
    }

    fn begin_pass(&mut self, label: &[u8], holds: bool) -> Result<(), Error> {
        self.computed.flow.last(label)?.leaving = !holds;
        self.computed.flow.skipping = !holds;
        Ok(())
    }

    fn end_pass(&mut self, label: &[u8], again: bool) -> Result<(), Error> {
        let flow = &mut self.computed.flow;
        let frame = *flow.last(label)?;
        flow.skipping = false;
        if !again || frame.kind == FrameKind::While {
            // The first line of a `while` loop pushes a new frame in each pass, so the old frame is removed here.
            flow.pop();
        }
        if again { flow.go_back(frame.at) } else { Ok(()) }
    }

    /// Executes `break` and `continue`: closes the blocks within the loop, and skips the lines up to the loop's last
    /// line. There `break` ends the loop, while `continue` lets the next pass begin.
    fn cut_pass(&mut self, order: OWord) -> Result<(), Error> {
        let flow = &mut self.computed.flow;
        while !flow.is_of_last(order.label) {
            match flow.frames.last() {
                Some(frame) if !frame.kind.is_call() && flow.frames.len() > usize::from(flow.below) => flow.pop(),
                _ => return Err(Error::FlowSyntax),
            };
        }
        let frame = flow.last(order.label)?;
        if matches!(frame.kind, FrameKind::If(_)) || frame.kind.is_call() {
            return Err(Error::FlowSyntax);
        }
        frame.leaving = order.keyword == Keyword::Break;
        flow.skipping = true;
        Ok(())
    }

    /// Returns the label of a called subroutine and the position of the subroutine's second line, where its execution
    /// begins. Computes the label if it is an expression: `O[#1] CALL`.
    fn called(&self, order: &OWord) -> Result<(Label, u16), Error> {
        let mut label = Label::new();
        if order.has_computed_label() {
            let (value, rest) = self.value(order.label)?;
            let number = value.whole().and_then(|number| u32::try_from(number).ok());
            let number = number.filter(|_| rest.is_empty()).ok_or(Error::FlowSyntax)?;
            write!(label, "{number}").map_err(|_| Error::FlowSyntax)?;
        } else {
            label.extend_from_slice(order.label).map_err(|_| Error::FlowSyntax)?;
        }
        let flow = &self.computed.flow;
        let found = if order.keyword == Keyword::Call { flow.find(&label) } else { flow.find_macro(&label) };
        let (_, begin) = found.ok_or(Error::FlowSyntax)?;
        Ok((label, begin))
    }

    /// Executes `return`, `endsub` and M99: goes back to the line after the call, or begins the next pass of a
    /// subprogram (L of M98). A value after `return` or `endsub` becomes the result of the call. If M73 has saved the
    /// modal state in the call, writes M72 to `line`, so that this state is restored next.
    fn leave_call(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        let order = OWord::of(line).ok_or(Error::FlowSyntax)?;
        let is_back = order.keyword == Keyword::Back;
        if is_back && !order.arguments.is_empty() {
            return Err(Error::NotSupported);
        }
        let value = if order.arguments.is_empty() { None } else { Some(self.argument(order.arguments)?) };
        let Computed { flow, parameters, returned, .. } = &mut self.computed;
        if order.keyword == Keyword::EndSub && !flow.last(order.label)?.kind.is_call() {
            return Err(Error::FlowSyntax);
        }
        while flow.frames.len() > usize::from(flow.below)
            && let Some(frame) = flow.frames.last()
        {
            if let FrameKind::Program(passes) = frame.kind
                && passes.left > 1
            {
                flow.next_pass()?;
                // If M73 has saved the modal state in this pass, M72 restores it before the next pass.
                if passes.is_macro && self.saved.leave(parameters.level().saturating_sub(1)) {
                    line.clear();
                    line.extend_from_slice(RESTORE).map_err(|_| Error::OutOfMemory)?;
                    return Ok(Held::Line);
                }
                return Ok(Held::Again);
            }
            let frame = *frame;
            flow.pop();
            if frame.kind.is_call() {
                if frame.kind.is_level() {
                    parameters.leave_call();
                }
                if parameters.level() < flow.modal.level() {
                    flow.modal.end();
                }
                *returned = value;
                flow.next = frame.at;
                if self.saved.leave(parameters.level()) {
                    line.clear();
                    line.extend_from_slice(RESTORE).map_err(|_| Error::OutOfMemory)?;
                    return Ok(Held::Line);
                }
                return Ok(if frame.at == STREAM { Held::End } else { Held::Again });
            }
        }
        Err(if is_back { Error::OutOfPlace } else { Error::FlowSyntax })
    }

    /// Returns the arguments of a call as pairs of parameter number and value: `[5] [7]` sets #1 to 5 and #2 to 7. An M
    /// word passes P as #1 and Q as #2 to its macro.
    fn arguments(&self, order: &OWord) -> Result<heapless::Vec<(u8, Real), ARGUMENTS>, Error> {
        let mut values = heapless::Vec::new();
        let mut rest = order.arguments;
        let mut number = 1;
        while let Some((letter, text)) = rest.split_first() {
            let value = match (order.keyword, letter, number) {
                (Keyword::Call, b'[', _) => rest,
                (Keyword::CallMacroOfM, b'P', 1) | (Keyword::CallMacroOfM, b'Q', 2) => text,
                (Keyword::Call, ..) => return Err(Error::FlowSyntax),
                _ => return Err(Error::UnusedWords),
            };
            let (value, behind) = self.value(value)?;
            values.push((number, value)).map_err(|_| Error::FlowSyntax)?;
            number += 1;
            rest = behind;
        }
        Ok(values)
    }
}
