//! O words: conditions, subroutines and loops.
//!
//! ```text
//!            sub, while, do, repeat               endsub: kept; endwhile, while, endrepeat: run at once
//!  Streaming ────────────────────────▶ Recording ─────────────────────────────────────────────┐
//!      ▲  └── call ──────────────────────────────────────────────────────────────▶ Running ◀──┘
//!      └─────────────────────────────── the end of the text, M2, an error ────────────┘
//! ```
//! A condition needs no memory: the lines of the branch that does not hold are skipped. Subroutines and loops are held as
//! text of bounded size, for no line comes twice over a serial link. What does not fit is refused to its end, so that no
//! line of it is taken for one of the program. What runs is given out line by line; nothing here calls itself.

use super::Computed;
use super::real::Real;
use crate::error::Error;
use crate::gcode::{Direction, Held, Interpreter, split_remark};

/// Bytes of held text, with one more for each line.
const TEXT: usize = 2048;
/// Bytes of it that only the first line of something may take, so that its end is known even if it does not fit.
const SPARE: usize = 64;
/// Conditions, loops and calls that may be under way within each other.
const DEPTH: usize = 16;
/// Bytes of their labels.
const LABELS: usize = 160;
/// Arguments of a call.
const ARGUMENTS: usize = 30;
/// How often held text may go back in one line of the host: a loop that never ends is found out.
const PASSES: u32 = 100_000;
/// Where a call from the stream returns to.
const STREAM: u16 = u16::MAX;

/// A line of held text: words and message.
pub type HeldLine = heapless::Vec<u8, 256>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Keyword {
    Sub,
    EndSub,
    Call,
    Return,
    If,
    ElseIf,
    Else,
    EndIf,
    While,
    EndWhile,
    Do,
    Repeat,
    EndRepeat,
    Break,
    Continue,
}

/// A text that begins another comes behind it.
const KEYWORDS: [(&[u8], Keyword); 15] = [
    (b"SUB", Keyword::Sub),
    (b"ENDSUB", Keyword::EndSub),
    (b"CALL", Keyword::Call),
    (b"RETURN", Keyword::Return),
    (b"IF", Keyword::If),
    (b"ELSEIF", Keyword::ElseIf),
    (b"ELSE", Keyword::Else),
    (b"ENDIF", Keyword::EndIf),
    (b"WHILE", Keyword::While),
    (b"ENDWHILE", Keyword::EndWhile),
    (b"DO", Keyword::Do),
    (b"REPEAT", Keyword::Repeat),
    (b"ENDREPEAT", Keyword::EndRepeat),
    (b"BREAK", Keyword::Break),
    (b"CONTINUE", Keyword::Continue),
];

/// A line with an O word.
#[derive(Clone, Copy, Debug)]
struct OWord<'a> {
    label: &'a [u8],
    keyword: Keyword,
    arguments: &'a [u8],
}

impl<'a> OWord<'a> {
    /// `None` for every other line; a message is no part of it. A number without a keyword, such as `O1000`, is one of them.
    fn of(line: &'a [u8]) -> Option<OWord<'a>> {
        let (line, _) = split_remark(line);
        let line = match line.strip_prefix(b"N") {
            Some(numbered) => numbered.get(digits(numbered)..)?,
            None => line,
        };
        let mut text = line.strip_prefix(b"O")?;
        // O0100 is O100.
        while let [b'0', b'0'..=b'9', ..] = text {
            text = text.get(1..)?;
        }
        let length = match text.first()? {
            b'<' => text.iter().position(|byte| *byte == b'>')? + 1,
            _ => digits(text),
        };
        let (label, text) = text.split_at_checked(length).filter(|(label, _)| !label.is_empty())?;
        let (name, keyword) = KEYWORDS.iter().find(|(name, _)| text.starts_with(name))?;
        Some(OWord { label, keyword: *keyword, arguments: text.get(name.len()..)? })
    }

    /// The end of what this begins.
    fn is_ended_by(&self, other: &OWord) -> bool {
        let end = match self.keyword {
            Keyword::Sub => Keyword::EndSub,
            Keyword::While => Keyword::EndWhile,
            Keyword::Do => Keyword::While,
            _ => Keyword::EndRepeat,
        };
        other.keyword == end && other.label == self.label
    }

    /// Whether what is behind the keyword may be its own: values in brackets if it takes any, or nothing.
    fn is_well_formed(&self) -> bool {
        let bracket = self.arguments.first() == Some(&b'[');
        match self.keyword {
            Keyword::If | Keyword::ElseIf | Keyword::While | Keyword::Repeat => bracket,
            Keyword::Call | Keyword::Return | Keyword::EndSub => bracket || self.arguments.is_empty(),
            _ => self.arguments.is_empty(),
        }
    }

    fn must_be_well_formed(&self) -> Result<(), Error> {
        if self.is_well_formed() { Ok(()) } else { Err(Error::FlowSyntax) }
    }

    /// Whether skipped lines can come to an end with it.
    fn ends_skipping(&self) -> bool {
        use Keyword::{Else, ElseIf, EndIf, EndRepeat, EndWhile, While};
        matches!(self.keyword, ElseIf | Else | EndIf | EndWhile | While | EndRepeat)
    }
}

fn digits(text: &[u8]) -> usize {
    text.iter().take_while(|byte| byte.is_ascii_digit()).count()
}

/// Whether a line has the word M2 or M30, written with a plain number.
fn ends_program(line: &[u8]) -> bool {
    let mut in_name = false;
    let mut rest = line;
    while let Some((byte, behind)) = rest.split_first() {
        in_name = *byte == b'<' || in_name && *byte != b'>';
        let (number, after) = behind.split_at_checked(digits(behind)).unwrap_or_default();
        let zeros = number.iter().take_while(|digit| **digit == b'0').count();
        let is_end = matches!(number.get(zeros..), Some(b"2" | b"30"));
        if *byte == b'M' && !in_name && is_end && after.first() != Some(&b'.') {
            return true;
        }
        rest = behind;
    }
    false
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum FrameKind {
    /// A condition; whether one of its branches has been taken.
    If(bool),
    While,
    Do,
    /// So many passes are left, this one included.
    Repeat(u32),
    Call,
}

/// A condition, loop or call under way.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Frame {
    kind: FrameKind,
    /// Bytes of its label.
    label: u8,
    /// Where a loop goes back to, or a call returns to.
    at: u16,
    /// The loop is being left.
    leaving: bool,
    /// The line of the host with which it began.
    begun: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum State {
    Streaming,
    /// Lines are held; the text of this begins here. With an error they are refused.
    Recording(u16, Option<Error>),
    /// Text runs; a loop of the stream, which begins here, is dropped at its end.
    Running(Option<u16>),
}

/// Held text, and what is under way.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct FlowControl {
    text: heapless::Vec<u8, TEXT>,
    frames: heapless::Vec<Frame, DEPTH>,
    labels: heapless::Vec<u8, LABELS>,
    state: State,
    /// Lines are skipped up to the next O word of the last frame.
    skipping: bool,
    /// The next line that runs.
    next: u16,
    /// Frames of the stream, below those of what runs.
    below: u8,
    passes: u32,
    skipped: u32,
    /// Number of the host's line that is read.
    line: u32,
    /// The one with which the text began that is being recorded.
    recorded_from: u32,
    /// The last line was an M2 or M30 that is skipped or recorded.
    after_end: bool,
    /// The line with which the block began that the end of the program has cut short.
    cut: Option<u32>,
}

impl FlowControl {
    pub const fn new() -> Self {
        Self {
            text: heapless::Vec::new(),
            frames: heapless::Vec::new(),
            labels: heapless::Vec::new(),
            state: State::Streaming,
            skipping: false,
            next: 0,
            below: 0,
            passes: 0,
            skipped: 0,
            line: 0,
            recorded_from: 0,
            after_end: false,
            cut: None,
        }
    }

    /// Forgets all.
    pub fn reset(&mut self) {
        *self = Self::new();
    }

    /// The program has ended: all but the block that it ended in is forgotten.
    pub fn end_program(&mut self) {
        let cut = self.open_since();
        self.reset();
        self.cut = cut;
    }

    /// The line of the host with which the outermost block began that has not come to its end.
    fn open_since(&self) -> Option<u32> {
        let of_stream = match self.state {
            State::Running(_) => usize::from(self.below),
            _ => self.frames.len(),
        };
        let recorded = matches!(self.state, State::Recording(..)).then_some(self.recorded_from);
        self.frames.get(..of_stream)?.first().map(|frame| frame.begun).or(recorded)
    }

    /// Whether lines of the host are skipped or recorded.
    fn leaves_lines_out(&self) -> bool {
        self.skipping || matches!(self.state, State::Recording(..))
    }

    /// The held line at a position.
    fn line(&self, at: u16) -> Option<&[u8]> {
        let (length, rest) = self.text.get(usize::from(at)..)?.split_first()?;
        rest.get(..usize::from(*length))
    }

    /// Keeps a line and its message, with so many bytes to spare behind it.
    fn hold(&mut self, line: &[u8], remark: &[u8], spare: usize) -> Result<(), Error> {
        let length = line.len() + remark.len();
        let prefix = u8::try_from(length).map_err(|_| Error::OutOfMemory)?;
        if self.text.len() + 1 + length + spare > TEXT {
            return Err(Error::OutOfMemory);
        }
        let _ = self.text.push(prefix);
        self.text.extend_from_slice(line).map_err(|_| Error::OutOfMemory)?;
        self.text.extend_from_slice(remark).map_err(|_| Error::OutOfMemory)
    }

    /// Where a subroutine begins, and where its second line does.
    fn find(&self, label: &[u8]) -> Option<(u16, u16)> {
        self.find_from(0, |order| order.keyword == Keyword::Sub && order.label == label)
    }

    /// The next line with an O word of some kind: where it begins and the next one does.
    fn find_from(&self, from: u16, is_it: impl Fn(&OWord) -> bool) -> Option<(u16, u16)> {
        let mut at = from;
        while let Some(line) = self.line(at) {
            let behind = at + 1 + line.len() as u16;
            if OWord::of(line).is_some_and(|order| is_it(&order)) {
                return Some((at, behind));
            }
            at = behind;
        }
        None
    }

    /// Drops a subroutine that has been defined again.
    fn drop_sub(&mut self, label: &[u8]) {
        let is_end = |order: &OWord| order.keyword == Keyword::EndSub && order.label == label;
        if let Some((from, behind)) = self.find(label)
            && let Some((_, end)) = self.find_from(behind, is_end)
        {
            self.text.copy_within(usize::from(end).., usize::from(from));
            self.text.truncate(self.text.len() - usize::from(end - from));
        }
    }

    fn push(&mut self, kind: FrameKind, label: &[u8], at: u16) -> Result<(), Error> {
        let frame = Frame { kind, label: label.len() as u8, at, leaving: false, begun: self.line };
        if self.labels.len() + label.len() > LABELS || self.frames.push(frame).is_err() {
            return Err(Error::TooDeep);
        }
        self.labels.extend_from_slice(label).map_err(|_| Error::TooDeep)
    }

    fn pop(&mut self) -> Option<Frame> {
        let frame = self.frames.pop()?;
        self.labels.truncate(self.labels.len().saturating_sub(usize::from(frame.label)));
        Some(frame)
    }

    /// Whether the innermost frame has this label.
    fn is_of_last(&self, label: &[u8]) -> bool {
        let length = self.frames.last().map_or(0, |frame| usize::from(frame.label));
        self.labels.get(self.labels.len().saturating_sub(length)..) == Some(label)
    }

    /// The innermost frame, if it has this label.
    fn last(&mut self, label: &[u8]) -> Result<&mut Frame, Error> {
        if !self.is_of_last(label) {
            return Err(Error::FlowSyntax);
        }
        self.frames.last_mut().ok_or(Error::FlowSyntax)
    }

    fn go_back(&mut self, at: u16) -> Result<(), Error> {
        self.passes += 1;
        if self.passes > PASSES {
            return Err(Error::EndlessLoop);
        }
        self.next = at;
        Ok(())
    }

    fn run(&mut self, at: u16, of_loop: Option<u16>) {
        self.state = State::Running(of_loop);
        self.next = at;
        self.below = self.frames.len() as u8;
        self.passes = 0;
    }

    /// Held text has come to its end, or is given up.
    pub fn stop(&mut self) {
        if let State::Running(of_loop) = self.state {
            if let Some(at) = of_loop {
                self.text.truncate(usize::from(at));
            }
            while self.frames.len() > usize::from(self.below) {
                self.pop();
            }
            self.skipping = false;
            self.state = State::Streaming;
        }
    }
}

impl<const N: usize> Interpreter<N> {
    /// How a line of the host is to be taken, which has this number among all that have come. After an error nothing of it
    /// has been done; of a condition whose value is an error no branch will be. `remark` is its message, with its mark; a line
    /// may have nothing else.
    #[inline]
    pub fn direct(&mut self, line: &[u8], remark: &[u8], number: u32) -> Result<Direction, Error> {
        self.computed.begin();
        let flow = &mut self.computed.flow;
        flow.line = number;
        let plain = flow.state == State::Streaming && !flow.skipping;
        if plain && !matches!(line.first(), Some(b'O' | b'N')) {
            return Ok(Direction::Check);
        }
        self.direct_order(line, remark, OWord::of(line))
    }

    /// Lines that a condition has left out.
    pub fn skipped(&self) -> u32 {
        self.computed.flow.skipped
    }

    /// The line of the host with which the outermost block (sub, loop, condition) began that has not come to its end, or
    /// that the end of the program has cut short.
    pub fn open_since(&self) -> Option<u32> {
        let flow = &self.computed.flow;
        flow.open_since().or(flow.cut)
    }

    /// A tape mark, between programs: what one of them has left open is an error, and forgotten.
    pub fn tape_mark(&mut self) -> Result<(), Error> {
        if self.computed.flow.open_since().is_none() {
            return Ok(());
        }
        self.computed.end_program();
        Err(Error::FlowSyntax)
    }

    /// Behind an M2 or M30 that is skipped or recorded no line of its program can follow but an O word: any other is one of
    /// the next program.
    fn look_for_end(&mut self, line: &[u8], order: Option<OWord>) -> Result<(), Error> {
        let flow = &mut self.computed.flow;
        let left_out = flow.leaves_lines_out();
        if line.is_empty() {
            return Ok(());
        }
        if order.is_some() {
            flow.cut = None;
        } else if left_out && flow.after_end {
            self.computed.end_program();
            return Err(Error::FlowSyntax);
        }
        flow.after_end = left_out && order.is_none() && ends_program(line);
        Ok(())
    }

    fn direct_order(&mut self, line: &[u8], remark: &[u8], order: Option<OWord>) -> Result<Direction, Error> {
        self.look_for_end(line, order)?;
        if let State::Recording(from, error) = self.computed.flow.state {
            return self.record(line, remark, order, from, error);
        }
        let flow = &mut self.computed.flow;
        if flow.skipping && !order.is_some_and(|order| order.ends_skipping() && flow.is_of_last(order.label)) {
            flow.skipped = flow.skipped.saturating_add(1);
            return Ok(Direction::LeftOut);
        }
        let Some(order) = order else { return Ok(Direction::Check) };
        match order.keyword {
            Keyword::If | Keyword::ElseIf | Keyword::Else | Keyword::EndIf => self.branch(order)?,
            Keyword::Call => {
                let (_, at) = flow.find(order.label).ok_or(Error::FlowSyntax)?;
                let arguments = self.arguments(order.arguments)?;
                self.computed.flow.run(at, None);
                self.call(order, STREAM, &arguments)?;
                return Ok(Direction::Call);
            }
            Keyword::Sub | Keyword::Do | Keyword::While | Keyword::Repeat => {
                let from = flow.text.len() as u16;
                let held = order.must_be_well_formed().and_then(|()| flow.hold(line, remark, 0));
                if held.is_err() {
                    // What is refused needs its label and kind.
                    let length = line.len() - order.arguments.len();
                    flow.hold(line.get(..length).unwrap_or(&[]), &[], 0)?;
                }
                flow.state = State::Recording(from, held.err());
                flow.recorded_from = flow.line;
                held?;
                return Ok(Direction::LeftOut);
            }
            _ => return Err(Error::FlowSyntax),
        }
        Ok(Direction::Done)
    }

    /// A line of a subroutine or loop.
    fn record(
        &mut self,
        line: &[u8],
        remark: &[u8],
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
            None => flow.hold(line, remark, SPARE).err(),
            error => error,
        };
        flow.state = match ends {
            true => State::Streaming,
            false => State::Recording(from, error),
        };
        match (error, order) {
            (Some(error), _) => {
                if ends {
                    flow.text.truncate(usize::from(from));
                }
                Err(error)
            }
            (None, Some(order)) if ends && of_sub => {
                // The older one is found first.
                if flow.find(order.label).is_some_and(|(at, _)| at < from) {
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

    /// The next line of held text; empty if it is skipped. An error ends it.
    pub fn next_held(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        self.computed.begin();
        let next = self.next_line(line);
        if !matches!(next, Ok(Held::Line | Held::Again)) {
            self.abandon_held();
        }
        next
    }

    /// A held line was refused: the rest is not run.
    pub fn abandon_held(&mut self) {
        self.computed.flow.stop();
        self.computed.parameters.leave_calls();
    }

    /// The rest of the program is not run, or it is another host's: conditions and loops under way are forgotten, and what
    /// is held.
    pub fn abandon_program(&mut self) {
        self.computed.flow.reset();
        self.computed.parameters.leave_calls();
    }

    fn next_line(&mut self, line: &mut HeldLine) -> Result<Held, Error> {
        let flow = &mut self.computed.flow;
        line.clear();
        if !matches!(flow.state, State::Running(_)) {
            return Ok(Held::End);
        }
        let Some(text) = flow.line(flow.next) else {
            let complete = flow.frames.len() == usize::from(flow.below);
            return if complete { Ok(Held::End) } else { Err(Error::FlowSyntax) };
        };
        line.extend_from_slice(text).map_err(|_| Error::OutOfMemory)?;
        let at = flow.next;
        flow.next += 1 + text.len() as u16;
        let Some(order) = OWord::of(line) else {
            if !flow.skipping {
                return Ok(Held::Line);
            }
            line.clear();
            return Ok(Held::Again);
        };
        // The end of a subroutine is not skipped: behind it comes another.
        let ends = order.ends_skipping() && flow.is_of_last(order.label) || order.keyword == Keyword::EndSub;
        if flow.skipping && !ends {
            line.clear();
            return Ok(Held::Again);
        }
        match order.keyword {
            Keyword::If | Keyword::ElseIf | Keyword::Else | Keyword::EndIf => self.branch(order)?,
            Keyword::Call => {
                let (_, begin) = flow.find(order.label).ok_or(Error::FlowSyntax)?;
                let back = flow.next;
                let arguments = self.arguments(order.arguments)?;
                self.call(order, back, &arguments)?;
                self.computed.flow.go_back(begin)?;
            }
            Keyword::Return | Keyword::EndSub => return self.leave_call(order),
            Keyword::Sub => return Err(Error::FlowSyntax),
            _ => self.go_round(order, at)?,
        }
        Ok(Held::Again)
    }

    /// if, elseif, else, endif.
    fn branch(&mut self, order: OWord) -> Result<(), Error> {
        match order.keyword {
            Keyword::If => {
                let flow = &mut self.computed.flow;
                flow.push(FrameKind::If(true), order.label, 0)?;
                // Unless the condition is found to hold no branch does.
                flow.skipping = true;
                let holds = self.condition(order.arguments)?;
                self.take_branch(order.label, holds, holds)
            }
            Keyword::ElseIf => {
                let taken = self.has_taken(order.label)?;
                self.take_branch(order.label, true, false)?;
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

    /// Whether a branch of the innermost condition has been taken.
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

    /// while, do, repeat and their ends, break, continue; only in held text.
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
                let count = self.argument(order.arguments)?.ceiling();
                let beyond = if count.is_negative() { 0 } else { i64::from(PASSES) };
                let count = count.whole().unwrap_or(beyond).clamp(0, i64::from(PASSES)) as u32;
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
            // A while begins its next pass with its first line.
            flow.pop();
        }
        if again { flow.go_back(frame.at) } else { Ok(()) }
    }

    /// break, continue: what is within the loop is left, and the rest of the pass is skipped.
    fn cut_pass(&mut self, order: OWord) -> Result<(), Error> {
        let flow = &mut self.computed.flow;
        while !flow.is_of_last(order.label) {
            match flow.frames.last() {
                Some(frame) if frame.kind != FrameKind::Call && flow.frames.len() > usize::from(flow.below) => {
                    flow.pop()
                }
                _ => return Err(Error::FlowSyntax),
            };
        }
        let frame = flow.last(order.label)?;
        if matches!(frame.kind, FrameKind::If(_) | FrameKind::Call) {
            return Err(Error::FlowSyntax);
        }
        frame.leaving = order.keyword == Keyword::Break;
        flow.skipping = true;
        Ok(())
    }

    fn call(&mut self, order: OWord, back: u16, arguments: &[Real]) -> Result<(), Error> {
        let Computed { flow, parameters, .. } = &mut self.computed;
        let pushed = flow.push(FrameKind::Call, order.label, back).and_then(|()| parameters.enter_call(arguments));
        if pushed.is_err() && back == STREAM {
            self.abandon_held();
        }
        pushed
    }

    /// return, endsub: back to the line behind the call, with a value.
    fn leave_call(&mut self, order: OWord) -> Result<Held, Error> {
        let value = if order.arguments.is_empty() { None } else { Some(self.argument(order.arguments)?) };
        let Computed { flow, parameters, returned, .. } = &mut self.computed;
        if order.keyword == Keyword::EndSub && flow.last(order.label)?.kind != FrameKind::Call {
            return Err(Error::FlowSyntax);
        }
        while flow.frames.len() > usize::from(flow.below)
            && let Some(frame) = flow.pop()
        {
            if frame.kind == FrameKind::Call {
                parameters.leave_call();
                *returned = value;
                flow.next = frame.at;
                return Ok(if frame.at == STREAM { Held::End } else { Held::Again });
            }
        }
        Err(Error::FlowSyntax)
    }

    fn condition(&self, text: &[u8]) -> Result<bool, Error> {
        self.argument(text).map(|value| !value.is_zero())
    }

    /// The value of a bracket that is all of a text.
    fn argument(&self, text: &[u8]) -> Result<Real, Error> {
        if text.first() != Some(&b'[') {
            return Err(Error::FlowSyntax);
        }
        let (value, rest) = self.value(text)?;
        if rest.is_empty() { Ok(value) } else { Err(Error::FlowSyntax) }
    }

    fn arguments(&self, text: &[u8]) -> Result<heapless::Vec<Real, ARGUMENTS>, Error> {
        let mut values = heapless::Vec::new();
        let mut rest = text;
        while !rest.is_empty() {
            if rest.first() != Some(&b'[') {
                return Err(Error::FlowSyntax);
            }
            let (value, behind) = self.value(rest)?;
            values.push(value).map_err(|_| Error::FlowSyntax)?;
            rest = behind;
        }
        Ok(values)
    }
}
