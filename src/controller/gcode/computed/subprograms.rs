//! Fanuc's subprograms: `O1001` to `M99` after the end of the program, called by M98 or, with arguments, by G65. They
//! are held as text like other subroutines, so M98 and G65 also call `O1001 SUB`.
//!
//! A call usually comes before its subprogram: the host has not sent the subprogram's lines yet. From this call on,
//! the lines of the program are held too: they are recorded and not executed.
//!
//! ```text
//!            call of an unknown number        number after M2, M30               M99
//!  Streaming ────────────────────────▶ Holding ───────────────▶ Recording ──────────────▶ Running
//!                                                                   ▲   number              │ call of an unknown number
//!                                                                   └──────────── Waiting ◀─┘
//! ```
//! Guarantees:
//! * A line of a subprogram is executed only by a call.
//! * If a line of the held program or of a subprogram is refused before the program continues, the held lines are
//!   dropped without being executed, and all lines that follow are refused. The same happens if the machine is idle and
//!   the host sends nothing for 5 s, because the next line can then belong to another file.
//! * An M99 without a call shows that the lines before it may have been a subprogram that was executed as the program.
//!   So all following lines are refused.
//! * A subprogram is valid only in its file. If no program waits for the subprogram, it is read and forgotten.
//!
//! M98 and G65 do not call macros. If they did, a call whose subprogram comes later in the file would run a macro with
//! the same number instead.

use super::Computed;
use super::expression;
use super::flow::{FlowControl, FlowState, FrameKind, Keyword, OWord, PROGRAM, Passes, SPARE, ends_program};
use super::m_words::find_m_word;
use super::real::Real;
use crate::error::Error;
use crate::gcode::REASONS;
use crate::gcode::comment::split_comment;
use crate::gcode::direction::Direction;
use crate::gcode::program_number::{behind_line_number, has_program_number, number_of, subprogram_number};
use crate::gcode::state::{Interpreter, ProgramPlace};
use core::fmt::Write;

/// Maximum number of passes of a call (L).
const MOST_REPEATS: i64 = 9999;
/// Highest number of a subprogram.
const HIGHEST: i64 = 99_999_999;
/// The letters of G65's arguments: A sets #1, B sets #2, and so on. A point stands for a parameter that no letter sets.
const LETTERS: &[u8; 26] = b"ABCIJKDEF.H.M...QRSTUVWXYZ";

/// The number of a subprogram, or a line that consists of O, the number and a keyword.
type ShortLine = heapless::Vec<u8, 16>;

/// The values of the words of M98, G65 or G66.
pub(super) struct Call {
    number: u32,
    pub(super) label: ShortLine,
    passes: Passes,
    arguments: heapless::Vec<(u8, Real), { LETTERS.len() }>,
}

impl<const N: usize> Interpreter<N> {
    /// Returns whether the host's lines are being held as part of a program that has called an unknown subprogram.
    #[inline]
    pub(in crate::gcode) fn is_holding(&self) -> bool {
        self.computed.flow.state == FlowState::Holding
    }

    /// Returns whether the host's lines are recorded, as lines of a subroutine, loop or subprogram, or of a held
    /// program.
    pub(in crate::gcode) fn is_recording(&self) -> bool {
        self.computed.flow.records()
    }

    /// Returns the number of the subprogram for which a program waits; `None` if no program waits.
    pub fn awaited_subprogram(&self) -> Option<u32> {
        let flow = &self.computed.flow;
        flow.waiting.map(|_| flow.missing)
    }

    /// Handles a line of a held program or of a subprogram: records the line, refuses it, or begins a subprogram.
    /// `line` can also be a part of a line (see `split_call`). Returns `None` for all other lines, which the caller
    /// handles.
    #[inline(never)]
    pub(super) fn direct_subprogram(
        &mut self,
        line: &[u8],
        comment: &[u8],
        order: Option<OWord>,
    ) -> Option<Result<Direction, Error>> {
        match self.computed.flow.state {
            FlowState::Holding => Some(self.hold_line(line, comment, order)),
            FlowState::Recording(from, _) => self.is_held().then(|| self.record_subprogram(line, comment, order, from)),
            FlowState::Running(_) => None,
            FlowState::Waiting | FlowState::Streaming if self.place == ProgramPlace::Subprogram => {
                subprogram_number(line).map(|label| self.define(label))
            }
            FlowState::Waiting | FlowState::Streaming => None,
        }
    }

    /// Handles a line of the host that the check has refused with `error`. If M98 follows other words, executes these
    /// words and then the call. If M99 follows other words, there is no call to return from, so all following lines are
    /// refused.
    #[cold]
    #[inline(never)]
    pub fn direct_refused(&mut self, line: &[u8], comment: &[u8], error: Error) -> Result<Direction, Error> {
        let Some((words, call)) = split_call(line) else { return Err(error) };
        match OWord::of(call) {
            Some(order) if order.keyword == Keyword::Back => Err(self.refuse_rest()),
            Some(order)
                if order.keyword == Keyword::CallProgram && error == Error::NotSupported && !ends_program(words) =>
            {
                self.run_call(words, call, comment, &order)
            }
            _ => Err(error),
        }
    }

    /// Executes M98, G65, G66 or `IF [..] THEN` in a line of the host. `call`: the part of the line from this word on;
    /// `words`: the part before it. Both parts are added to the held text and run there, as the lines of a loop do. If
    /// the subprogram is unknown, the program is held from the call on.
    #[inline(never)]
    pub(super) fn run_call(
        &mut self,
        words: &[u8],
        call: &[u8],
        comment: &[u8],
        order: &OWord,
    ) -> Result<Direction, Error> {
        if order.keyword != Keyword::Then {
            self.read_call(order)?;
        }
        let flow = &mut self.computed.flow;
        let from = flow.text.len();
        let mut held = Ok(());
        if !words.is_empty() {
            held = flow.hold(words, &[], SPARE);
        }
        if let Err(error) = held.and_then(|()| flow.hold(call, comment, SPARE)) {
            flow.text.truncate(from);
            self.refuse_rest();
            return Err(error);
        }
        flow.of_host = true;
        flow.run(from as u16, Some(from as u16));
        Ok(Direction::Run)
    }

    /// Adds a line of the host to the held text and runs it there. If there is no room, refuses all lines that follow.
    pub(super) fn run_line(&mut self, line: &[u8], comment: &[u8]) -> Result<Direction, Error> {
        let flow = &mut self.computed.flow;
        let from = flow.text.len() as u16;
        if let Err(error) = flow.hold(line, comment, SPARE) {
            self.refuse_rest();
            return Err(error);
        }
        flow.of_host = true;
        flow.run(from, Some(from));
        Ok(Direction::Run)
    }

    /// Examines a line with an O number after the end of a program, or a line among subprograms. Returns whether the
    /// line belongs to a held program or to a subprogram; otherwise the caller refuses it. If the line belongs to a
    /// subprogram, the place becomes [`ProgramPlace::Subprogram`].
    #[inline(never)]
    pub(in crate::gcode) fn look_among_subprograms(&mut self, line: &[u8]) -> bool {
        let flow = &self.computed.flow;
        let belongs = match flow.state {
            // `hold_line` decides later whether this line belongs to the held program. It refuses an O number before
            // the end of the program.
            FlowState::Holding => return true,
            FlowState::Recording(..) => self.is_held(),
            FlowState::Waiting => subprogram_number(line).is_some(),
            // A subprogram cannot begin in an open condition.
            _ => flow.frames.is_empty() && subprogram_number(line).is_some(),
        };
        let belongs = belongs && matches!(self.place, ProgramPlace::End | ProgramPlace::Subprogram);
        if belongs {
            self.place = ProgramPlace::Subprogram;
        }
        belongs
    }

    /// Stores the O number of the program, unless the program has ended.
    #[inline(never)]
    pub(super) fn note_number(&mut self, line: &[u8]) {
        if self.place == ProgramPlace::Program {
            self.computed.program = number_of(line);
        }
    }

    /// Returns whether this line has the O number of the main program. If it comes among the subprograms after M30, it
    /// means that the host sends the same file again.
    #[inline(never)]
    pub(in crate::gcode) fn begins_again(&self, line: &[u8]) -> bool {
        self.computed.program > 0 && number_of(line) == self.computed.program
    }

    /// Holds a line of the program after the call of an unknown subprogram. After the end of the program, the number of
    /// a subprogram begins the definition of that subprogram. If the line cannot belong to the program, or the memory
    /// is full, refuses the line and all lines that follow.
    #[inline(never)]
    fn hold_line(&mut self, line: &[u8], comment: &[u8], order: Option<OWord>) -> Result<Direction, Error> {
        let flow = &mut self.computed.flow;
        let has_ended = flow.after_end;
        if has_ended && let Some(label) = subprogram_number(line) {
            return self.define(label);
        }
        let keyword = order.map(|order| order.keyword);
        let is_next = has_ended && !line.is_empty() && !order.is_some_and(|order| order.may_follow_end());
        if is_next || has_program_number(line) || keyword == Some(Keyword::Back) {
            return Err(self.refuse_rest());
        }
        if let Err(error) = flow.hold_order(line, comment, order) {
            self.refuse_held(error, line, comment, None);
            return Err(error);
        }
        if !line.is_empty() {
            flow.after_end = order.is_none() && ends_program(line);
        }
        Ok(Direction::LeftOut)
    }

    /// Refuses a line of a held program or of a subprogram, and all lines that follow. `subprogram`: number of the
    /// subprogram to which the line belongs.
    fn refuse_held(&mut self, error: Error, line: &[u8], comment: &[u8], subprogram: Option<&[u8]>) {
        let Computed { flow, overflow, .. } = &mut self.computed;
        if REASONS && error == Error::OutOfMemory && flow.waiting.is_some() {
            let number = |label: &[u8]| label.iter().fold(0, |value, digit| value * 10 + u32::from(digit - b'0'));
            let subprogram = subprogram.map(|label| (label, number(label) == flow.missing));
            overflow.begin(flow, line.len() + comment.len(), subprogram);
        }
        self.refuse_rest();
    }

    /// Returns by how many bytes a held program was too long: the most recent one that did not fit. `None` if all
    /// programs have fit. The result is a minimum, because lines after the awaited subprogram are not counted.
    pub fn excess_bytes(&self) -> Option<usize> {
        self.computed.overflow.excess()
    }

    /// Begins the definition of a subprogram. If a subprogram with this number exists, or there is no room, refuses
    /// this line and all lines that follow.
    #[inline(never)]
    fn define(&mut self, label: &[u8]) -> Result<Direction, Error> {
        self.place = ProgramPlace::Subprogram;
        let flow = &mut self.computed.flow;
        let from = flow.text.len() as u16;
        // If there were two definitions, a call would be ambiguous.
        let held = match flow.find_own(label).is_some() {
            true => Err(Error::OutOfPlace),
            false => flow.hold(&line_of(label, PROGRAM), &[], SPARE),
        };
        if flow.waiting.is_none() {
            flow.recorded_from = flow.line;
            flow.missing = 0;
        }
        if let Err(error) = held {
            let line = if REASONS { line_of(label, PROGRAM) } else { ShortLine::new() };
            self.refuse_held(error, &line, &[], Some(label));
            return Err(error);
        }
        flow.within = 0;
        flow.state = FlowState::Recording(from, None);
        Ok(Direction::LeftOut)
    }

    /// Records a line of a subprogram. An M99 outside of conditions and loops ends the subprogram, and the program that
    /// waits for it continues. If no program waits, the subprogram is forgotten, because a later program must not call
    /// it. A program number, M2, M30 or a lack of memory is an error: refuses the line and all lines that follow.
    #[inline(never)]
    fn record_subprogram(
        &mut self,
        line: &[u8],
        comment: &[u8],
        order: Option<OWord>,
        from: u16,
    ) -> Result<Direction, Error> {
        let flow = &mut self.computed.flow;
        if has_program_number(line) || order.is_none() && ends_program(line) {
            return Err(self.refuse_rest());
        }
        let ends = order.is_some_and(|order| order.keyword == Keyword::Back) && flow.within == 0;
        let held = match order {
            Some(order) if order.keyword == Keyword::Back && !order.arguments.is_empty() => Err(Error::NotSupported),
            _ if ends => {
                let label = flow.line(from).and_then(OWord::of).map(|opening| opening.label);
                let end = line_of(label.unwrap_or_default(), b"ENDSUB");
                flow.hold(&end, comment, 0)
            }
            order => {
                flow.count_blocks(from, order);
                flow.hold_order(line, comment, order)
            }
        };
        if let Err(error) = held {
            let mut label = ShortLine::new();
            if REASONS && let Some(opening) = self.computed.flow.line(from).and_then(OWord::of) {
                let _ = label.extend_from_slice(opening.label);
            }
            self.refuse_held(error, line, comment, Some(&label));
            return Err(error);
        }
        if !ends {
            return Ok(Direction::LeftOut);
        }
        if flow.go_on() {
            return Ok(Direction::Run);
        }
        flow.text.truncate(usize::from(from));
        flow.state = FlowState::Streaming;
        Ok(Direction::LeftOut)
    }

    /// Executes M98 or G65 in the held line at `at`. Returns `false` if the subprogram is unknown and the program now
    /// waits for it.
    #[inline(never)]
    pub(super) fn call_from_text(&mut self, order: &OWord, at: u16) -> Result<bool, Error> {
        let call = self.read_call(order)?;
        let flow = &mut self.computed.flow;
        let back = flow.next;
        match flow.find_own(&call.label) {
            Some((_, begin)) => {
                self.call(FrameKind::Program(call.passes), &call.label, back, &call.arguments)?;
                self.computed.flow.go_back(begin)?;
                Ok(true)
            }
            None => self.await_subprogram(&call, at),
        }
    }

    /// Makes the program wait for the subprogram that the held line at `at` calls, until the host has sent it. Returns
    /// `false`, because the call has not been executed. Fails in a startup line, which cannot wait.
    pub(super) fn await_subprogram(&mut self, call: &Call, at: u16) -> Result<bool, Error> {
        let flow = &mut self.computed.flow;
        flow.missing = call.number;
        if !flow.of_host {
            return Err(Error::OutOfPlace);
        }
        flow.wait(at, self.place == ProgramPlace::Subprogram);
        Ok(false)
    }

    /// Executes G66 in the held line at `at`. Returns `false` if the subprogram is unknown and the program now waits
    /// for it.
    #[inline(never)]
    pub(super) fn begin_modal_call(&mut self, order: &OWord, at: u16) -> Result<bool, Error> {
        let call = self.read_call(order)?;
        if self.computed.flow.find_own(&call.label).is_none() {
            return self.await_subprogram(&call, at);
        }
        let (level, modal) = (self.computed.level(), &self.computed.flow.modal);
        // A modal call must still be active after its subprogram has returned. A G66 in this subprogram would replace
        // the modal call, so it is an error.
        if modal.is_active() && modal.level() < level {
            return Err(Error::TooDeep);
        }
        if self.computed.flow.modal.begin(order.arguments, level) { Ok(true) } else { Err(Error::OutOfMemory) }
    }

    /// Examines the line that runs next, if a modal call is active. If this line moves an axis, [`Self::call_if_due`]
    /// executes the modal call after the line.
    #[inline]
    pub(super) fn note_for_modal_call(&mut self, line: &[u8]) {
        if self.computed.flow.modal.is_active() {
            let level = self.computed.level();
            let (words, _) = split_comment(line);
            self.computed.flow.modal.look_at(words, level);
        }
    }

    /// Executes the modal call if the previous line moves an axis. Returns whether the call was executed.
    #[inline(never)]
    pub(super) fn call_if_due(&mut self) -> Result<bool, Error> {
        let flow = &mut self.computed.flow;
        let at = flow.next;
        let Some(line) = flow.modal.take_due() else { return Ok(false) };
        let order = OWord::of(&line).ok_or(Error::FlowSyntax)?;
        self.call_from_text(&order, at)
    }

    /// Decides on a line of the host while a modal call is active. A line that moves an axis is added to the held text;
    /// it runs there, followed by the call. Any other line is checked as usual.
    #[inline(never)]
    pub(super) fn direct_before_modal_call(&mut self, line: &[u8], comment: &[u8]) -> Result<Direction, Error> {
        self.note_for_modal_call(line);
        if self.computed.flow.modal.take_due().is_none() {
            return Ok(Direction::Check);
        }
        if let Some((words, call)) = split_call(line)
            && let Some(order) = OWord::of(call)
            && order.keyword == Keyword::CallProgram
        {
            return self.run_call(words, call, comment, &order);
        }
        self.run_line(line, comment)
    }

    /// Reads the words of M98, G65 or G66.
    #[inline(never)]
    pub(super) fn read_call(&self, order: &OWord) -> Result<Call, Error> {
        let is_macro = order.keyword != Keyword::CallProgram;
        let is_modal = order.keyword == Keyword::BeginModalCall;
        // G66 causes calls later in the program. An expression could have another value then, so only plain numbers are
        // allowed.
        if is_modal && order.arguments.iter().any(|byte| matches!(byte, b'#' | b'[')) {
            return Err(Error::NotSupported);
        }
        let (mut number, mut repeats) = (None, None);
        let mut arguments = heapless::Vec::<(u8, Real), { LETTERS.len() }>::new();
        let mut rest = order.arguments;
        while let Some((letter, text)) = rest.split_first() {
            if !letter.is_ascii_uppercase() {
                return Err(Error::ExpectedLetter);
            }
            let is_number = matches!(text.first(), Some(b'0'..=b'9' | b'.' | b'-' | b'+'));
            if !is_number && !expression::begins(text) {
                return Err(Error::BadNumber);
            }
            let (value, behind) = self.value(text)?;
            rest = behind;
            let chosen = match letter {
                b'P' => &mut number,
                b'L' => &mut repeats,
                _ => {
                    let index = LETTERS.iter().position(|of| of == letter).filter(|_| is_macro);
                    let argument = index.ok_or(Error::UnusedWords)? as u8 + 1;
                    if arguments.iter().any(|(of, _)| *of == argument) {
                        return Err(Error::WordRepeated);
                    }
                    let _ = arguments.push((argument, value));
                    continue;
                }
            };
            if chosen.is_some() {
                return Err(Error::WordRepeated);
            }
            *chosen = Some(value.whole().ok_or(Error::IntegerRequired)?);
        }
        let number = number.ok_or(Error::ValueWordMissing)?;
        let repeats = repeats.unwrap_or(1);
        if number < 0 {
            return Err(Error::NegativeValue);
        }
        if number > HIGHEST || !(1..=MOST_REPEATS).contains(&repeats) {
            return Err(Error::ValueOutOfRange);
        }
        let mut label = ShortLine::new();
        write!(label, "{number}").map_err(|_| Error::FlowSyntax)?;
        let passes = Passes { left: repeats as u16, is_macro };
        Ok(Call { number: number as u32, label, passes, arguments })
    }
}

impl FlowControl {
    /// Adds a line of a program or of a subprogram to the held text. Refuses O words that are not allowed there.
    #[inline(never)]
    fn hold_order(&mut self, line: &[u8], comment: &[u8], order: Option<OWord>) -> Result<(), Error> {
        match order {
            Some(order) if !order.is_well_formed() => Err(Error::FlowSyntax),
            Some(OWord { keyword: Keyword::Sub | Keyword::EndSub, .. }) => Err(Error::FlowSyntax),
            None if is_jump(line) => Err(Error::NotSupported),
            _ => self.hold(line, comment, SPARE),
        }
    }

    /// Begins the next pass of the innermost call, which must be a call of a subprogram.
    #[inline(never)]
    pub(super) fn next_pass(&mut self) -> Result<(), Error> {
        let label = self.last_label();
        let (_, begin) = self.find_own(label).ok_or(Error::FlowSyntax)?;
        if let Some(FrameKind::Program(passes)) = self.frames.last_mut().map(|frame| &mut frame.kind) {
            passes.left = passes.left.saturating_sub(1);
        }
        self.skipping = false;
        self.go_back(begin)
    }

    /// Updates the number of open conditions and loops of the subprogram that is recorded from `from` on.
    #[inline(never)]
    fn count_blocks(&mut self, from: u16, order: Option<OWord>) {
        let Some(order) = order else { return };
        let opens = match order.keyword {
            Keyword::If | Keyword::Do | Keyword::Repeat => true,
            Keyword::While => !self.closes_do(from, order.label),
            Keyword::EndIf | Keyword::EndWhile | Keyword::EndRepeat => false,
            _ => return,
        };
        self.within = if opens { self.within.saturating_add(1) } else { self.within.saturating_sub(1) };
    }

    /// Returns whether a `do` with this label is open, so that a `while` with this label in the next line would end
    /// it. This is so if the last `do` or `while` with this label is a `do`. `from`: where the recorded text begins.
    fn closes_do(&self, from: u16, label: &[u8]) -> bool {
        let is_loop = |order: &OWord| matches!(order.keyword, Keyword::Do | Keyword::While) && order.label == label;
        let (mut at, mut closes) = (from, false);
        while let Some((line, behind)) = self.find_from(at, is_loop) {
            closes = self.line(line).and_then(OWord::of).is_some_and(|order| order.keyword == Keyword::Do);
            at = behind;
        }
        closes
    }
}

/// Returns whether a line begins with a word of Fanuc's macros: IF, WHILE, END, GOTO. A line that begins so but is no
/// [`OWord`] has a form of the word that is not supported.
pub(super) fn is_jump(line: &[u8]) -> bool {
    let line = behind_line_number(line);
    [b"IF".as_slice(), b"WHILE", b"END", b"GOTO"].iter().any(|word| line.starts_with(word))
}

/// Splits a line before M98 or M99: returns the words before it, and the rest of the line. `None` if the line begins
/// with M98 or M99, or has neither.
#[inline(never)]
pub(super) fn split_call(line: &[u8]) -> Option<(&[u8], &[u8])> {
    line.split_at_checked(find_m_word(line, &[b"98", b"99"]).filter(|at| *at > 0)?)
}

/// Returns a line such as `O1001ENDSUB`: `O`, the label and the keyword.
#[inline(never)]
fn line_of(label: &[u8], keyword: &[u8]) -> ShortLine {
    let mut line = ShortLine::new();
    for part in [b"O".as_slice(), label, keyword] {
        let _ = line.extend_from_slice(part);
    }
    line
}
