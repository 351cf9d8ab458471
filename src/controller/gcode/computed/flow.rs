//! `FlowControl`, the state of O words: the recorded lines of subroutines, loops and macros (the held text), a frame
//! for each open block or call, and whether the program's lines are streamed, recorded, run or skipped.
//!
//! ```text
//!            sub, while, do, repeat               endsub: kept; endwhile, while, endrepeat: run at once
//!  Streaming ────────────────────────▶ Recording ─────────────────────────────────────────────┐
//!   ▲  │  └── call ──────────────────────────────────────────────────────────────▶ Running ◀──┘
//!   │  │                                                                           │ ▲  │
//!   │  └── M98, G65 of an unknown subprogram ──▶ Holding ◀── in the program ───────┤ │  │
//!   │                                               │  Waiting ◀── in held lines ──┘ │  │
//!   │              a subprogram after the end: ─────┴─────┴──▶ Recording ── M99 ─────┘  │
//!   └─────────────────────────────── the end of the text, M2, an error ─────────────────┘
//! ```
//! A program that calls an unknown subprogram is held: its lines are recorded until the subprogram has arrived. If an
//! error occurs meanwhile, all its held lines are dropped (see `subprograms`). A subprogram for which no program waits
//! is forgotten at its M99.
//!
//! A condition is not recorded, because the lines of its false branches are only skipped. A serial link sends each
//! line only once, but the lines of subroutines and loops run later or repeatedly. So these lines are recorded, as
//! text of bounded size. A subroutine or loop that does not fit is refused up to its end, so that none of its lines is
//! executed as a line of the program. Held text is returned line by line, without recursion.

use super::m_words::has_m_word;
use super::modal_calls::ModalCall;
use crate::error::Error;
use crate::gcode::comment::split_comment;
use crate::gcode::program_number::behind_line_number;
use crate::lent::Lent;

/// Capacity in bytes of the held text (the recorded lines of subroutines, loops and macros) in programs on a PC.
/// Boards have their own capacity (`held_bytes` in `boards/profiles.rs`), which is not larger.
#[cfg(feature = "alloc")]
pub(super) const MOST_HELD: usize = 12_288;
/// Minimum capacity in bytes of the held text (recorded lines): enough for a probing subroutine of 150 lines and the
/// loop that calls it. A held line takes one byte more than its length.
#[cfg(feature = "alloc")]
pub const LEAST_HELD: usize = 6144;
/// Maximum number of bytes of the held text (recorded lines) that macros may take; the rest is for programs.
pub(super) const MOST_MACROS: usize = 3072;
/// Number of bytes that remain free in the held text (recorded lines) after a line is added. Only two kinds of lines
/// may use these bytes: the first line of a subroutine or loop, and the `ENDSUB` that replaces M99. So the label of a
/// block is recorded even if its other lines do not fit. The label is needed to recognize the last line of the block.
pub(super) const SPARE: usize = 64;
/// Maximum nesting of conditions, loops and calls: enough for 16 nested calls, each within two conditions.
const DEPTH: usize = 48;
/// Maximum total length of the labels of all frames, in bytes.
pub(super) const LABELS: usize = 384;
/// Maximum number of arguments of a call.
pub(super) const ARGUMENTS: usize = 30;
/// Maximum number of jumps in held text (recorded lines) during one line of the host. More jumps mean an endless loop.
pub(super) const PASSES: u32 = 100_000;
/// Return position of a call in a line that the host sends. After the call, the program continues with the host's next
/// line.
pub(super) const STREAM: u16 = u16::MAX;

/// A line of held text: its words, followed by its message, which begins with a mark (`(` or `;`, see `split_comment`).
pub type HeldLine = heapless::Vec<u8, 256>;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Keyword {
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
    /// The first line of a held subprogram: its number, and [`PROGRAM`] as keyword.
    Program,
    /// M98: calls a subprogram.
    CallProgram,
    /// G65: calls a subprogram with arguments.
    CallMacro,
    /// G66: begins a modal call.
    BeginModalCall,
    /// M99: ends a subprogram.
    Back,
    /// M10, M11, M100 to M199, which call a macro.
    CallMacroOfM,
    /// `IF [..] THEN`: the rest of the line is executed under a condition.
    Then,
    /// `GOTO n`, alone or under a condition.
    GoTo,
    /// Any other word.
    Unknown,
}

/// The keyword that begins a subprogram in the held text. No line of a host can have it, because small letters are
/// converted to capitals.
pub(super) const PROGRAM: &[u8] = b"sub";

/// The keywords. Of two keywords that begin alike, the longer one comes first: `ELSEIF` before `ELSE`.
pub(super) const KEYWORDS: [(&[u8], Keyword); 15] = [
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

/// The part of a line that controls the flow: an O word, M98, M99, G65, G66, GOTO, THEN, or an M word that calls a
/// macro. `label` is empty for M98, M99, G65 and G66. For THEN, `label` holds the words after THEN; for GOTO, the line
/// number to jump to. In both, `arguments` holds the condition, if there is one.
#[derive(Clone, Copy, Debug)]
pub(super) struct OWord<'a> {
    pub(super) label: &'a [u8],
    pub(super) keyword: Keyword,
    pub(super) arguments: &'a [u8],
}

impl<'a> OWord<'a> {
    /// Reads the O word of a line; ignores the line's message. Returns `None` for every other line, including a number
    /// without a keyword, such as `O1000`. The label may be an expression.
    pub(super) fn of(line: &'a [u8]) -> Option<OWord<'a>> {
        let (line, _) = split_comment(line);
        let line = behind_line_number(line);
        let Some(mut text) = line.strip_prefix(b"O") else { return Self::without_o(line) };
        // Leading zeros do not count: O0100 is O100.
        while let [b'0', b'0'..=b'9', ..] = text {
            text = text.get(1..)?;
        }
        let length = label_length(text)?;
        let (label, text) = text.split_at_checked(length).filter(|(label, _)| !label.is_empty())?;
        let Some((name, keyword)) = KEYWORDS.iter().find(|(name, _)| text.starts_with(name)) else {
            if text == PROGRAM {
                return Some(OWord { label, keyword: Keyword::Program, arguments: &[] });
            }
            let is_word = label.first() == Some(&b'<') || matches!(text, [b'A'..=b'Z', b'A'..=b'Z', ..]);
            return is_word.then_some(OWord { label, keyword: Keyword::Unknown, arguments: text });
        };
        Some(OWord { label, keyword: *keyword, arguments: text.get(name.len()..)? })
    }

    /// Reads a word other than O that controls the flow, at the beginning of a line: a call or M99, IF, WHILE, END or
    /// GOTO.
    fn without_o(line: &'a [u8]) -> Option<OWord<'a>> {
        match line.first()? {
            b'M' | b'G' => Self::of_call(line),
            b'W' | b'E' | b'I' => Self::of_macro(line),
            _ => None,
        }
    }

    /// Reads M98, M99, G65, G66, GOTO, and M words that call macros.
    fn of_call(line: &'a [u8]) -> Option<OWord<'a>> {
        let (letter, number) = line.split_first()?;
        let zeros = number.iter().take_while(|digit| **digit == b'0').count();
        let number = number.get(zeros..)?;
        let (number, arguments) = number.split_at_checked(digits(number))?;
        let keyword = match (letter, number) {
            (b'G', []) => return Self::of_jump(&[], line),
            (b'M', b"98") => Keyword::CallProgram,
            (b'M', b"99") => Keyword::Back,
            (b'M', b"10" | b"11" | [b'1', _, _]) => Keyword::CallMacroOfM,
            (b'G', b"65") => Keyword::CallMacro,
            (b'G', b"66") => Keyword::BeginModalCall,
            _ => return None,
        };
        let label = if keyword == Keyword::CallMacroOfM { number } else { &[] };
        (arguments.first() != Some(&b'.')).then_some(OWord { label, keyword, arguments })
    }

    /// Reads `WHILE [..] DO1`, `END1`, `IF [..] THEN` and `IF [..] GOTO 20`, which are words of Fanuc's macros.
    #[inline(never)]
    fn of_macro(line: &'a [u8]) -> Option<OWord<'a>> {
        if let Some(label) = line.strip_prefix(b"END") {
            return Self::of_loop(label, Keyword::EndWhile, &[]);
        }
        let is_loop = line.starts_with(b"WHILE[");
        let text = line.strip_prefix(if is_loop { b"WHILE".as_slice() } else { b"IF" })?;
        let (condition, rest) = text.split_at_checked(label_length(text).filter(|length| *length > 1)?)?;
        if is_loop {
            return Self::of_loop(rest.strip_prefix(b"DO")?, Keyword::While, condition);
        }
        match rest.strip_prefix(b"THEN") {
            Some(words) => {
                let then = OWord { label: words, keyword: Keyword::Then, arguments: condition };
                // The words after THEN must not begin a block, call or leave a subprogram, or end the program.
                let is_plain =
                    !words.is_empty() && OWord::of(words).is_none() && !has_m_word(words, &[b"2", b"30", b"98", b"99"]);
                (is_plain && condition.first() == Some(&b'[')).then_some(then)
            }
            None => Self::of_jump(condition, rest),
        }
    }

    /// Reads `DO1` or `END1` of a Fanuc loop. `label`: the text after DO or END. Returns `None` if this text is not a
    /// plain number.
    fn of_loop(label: &'a [u8], keyword: Keyword, arguments: &'a [u8]) -> Option<OWord<'a>> {
        (!label.is_empty() && digits(label) == label.len()).then_some(OWord { label, keyword, arguments })
    }

    /// Reads `GOTO n`. The number, which can be an expression, takes the place of the label.
    fn of_jump(condition: &'a [u8], line: &'a [u8]) -> Option<OWord<'a>> {
        let label = line.strip_prefix(b"GOTO").filter(|label| !label.is_empty())?;
        (condition.is_empty() || condition.first() == Some(&b'[')).then_some(OWord {
            label,
            keyword: Keyword::GoTo,
            arguments: condition,
        })
    }

    pub(super) fn is_ended_by(&self, other: &OWord) -> bool {
        let end = match self.keyword {
            Keyword::Sub => Keyword::EndSub,
            Keyword::While => Keyword::EndWhile,
            Keyword::Do => Keyword::While,
            _ => Keyword::EndRepeat,
        };
        other.keyword == end && other.label == self.label
    }

    /// Returns whether the label is an expression, which is allowed only in calls: `O[#1] CALL`.
    pub(super) fn has_computed_label(&self) -> bool {
        matches!(self.label.first(), Some(b'[' | b'#'))
    }

    /// Returns whether the text after the keyword is valid: values in brackets if the keyword takes values, otherwise
    /// nothing.
    pub(super) fn is_well_formed(&self) -> bool {
        let bracket = self.arguments.first() == Some(&b'[');
        match self.keyword {
            Keyword::Unknown => false,
            Keyword::CallProgram
            | Keyword::CallMacro
            | Keyword::BeginModalCall
            | Keyword::CallMacroOfM
            | Keyword::Back
            | Keyword::Then
            | Keyword::GoTo => true,
            keyword if keyword != Keyword::Call && self.has_computed_label() => false,
            Keyword::If | Keyword::ElseIf | Keyword::While | Keyword::Repeat => bracket,
            Keyword::Call | Keyword::Return | Keyword::EndSub => bracket || self.arguments.is_empty(),
            _ => self.arguments.is_empty(),
        }
    }

    pub(super) fn must_be_well_formed(&self) -> Result<(), Error> {
        if self.is_well_formed() { Ok(()) } else { Err(Error::FlowSyntax) }
    }

    /// Returns whether this O word can follow an M2 or M30 that was skipped or recorded and not executed. An M2 or M30
    /// is skipped or recorded if a block is open, or if the program is held for a subprogram. Calls, M99, THEN and
    /// GOTO cannot follow.
    pub(super) fn may_follow_end(&self) -> bool {
        !matches!(
            self.keyword,
            Keyword::Call
                | Keyword::CallProgram
                | Keyword::CallMacro
                | Keyword::BeginModalCall
                | Keyword::CallMacroOfM
                | Keyword::Back
                | Keyword::Then
                | Keyword::GoTo
        )
    }

    /// Returns whether this O word can end the skipping of lines.
    pub(super) fn ends_skipping(&self) -> bool {
        use Keyword::{Else, ElseIf, EndIf, EndRepeat, EndWhile, While};
        matches!(self.keyword, ElseIf | Else | EndIf | EndWhile | While | EndRepeat)
    }
}

/// Returns the length of the label in bytes: a name, digits, or an expression (`#` and a value, or a bracket).
fn label_length(text: &[u8]) -> Option<usize> {
    let signs = text.iter().take_while(|byte| **byte == b'#').count();
    let text = text.get(signs..)?;
    let length = match text.first()? {
        b'<' => text.iter().position(|byte| *byte == b'>')? + 1,
        b'[' => {
            let mut open = 0_usize;
            let closes = |byte: &u8| {
                match byte {
                    b'[' => open += 1,
                    b']' => open = open.saturating_sub(1),
                    _ => {}
                }
                open == 0
            };
            text.iter().position(closes)? + 1
        }
        _ => digits(text),
    };
    if signs > 0 && length == 0 { None } else { Some(signs + length) }
}

pub(super) fn digits(text: &[u8]) -> usize {
    text.iter().take_while(|byte| byte.is_ascii_digit()).count()
}

/// Returns whether a line has the word M2 or M30, written with a plain number.
pub(super) fn ends_program(line: &[u8]) -> bool {
    has_m_word(line, &[b"2", b"30"])
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum FrameKind {
    /// A condition; `true` if one of its branches has been taken.
    If(bool),
    While,
    Do,
    /// A repeat loop with its remaining passes, including the current one.
    Repeat(u32),
    Call,
    /// A call of a subprogram.
    Program(Passes),
}

impl FrameKind {
    pub(super) fn is_call(self) -> bool {
        matches!(self, FrameKind::Call | FrameKind::Program(_))
    }

    /// Returns whether a frame of this kind is a call with parameters of its own.
    pub(super) fn is_level(self) -> bool {
        matches!(self, FrameKind::Call | FrameKind::Program(Passes { is_macro: true, .. }))
    }
}

/// How often a call runs its subprogram.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Passes {
    /// Remaining passes, including the current one.
    pub(super) left: u16,
    /// G65: the call has parameters of its own.
    pub(super) is_macro: bool,
}

/// An open condition or loop, or an active call.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Frame {
    pub(super) kind: FrameKind,
    /// Length of the frame's label in bytes.
    pub(super) label: u8,
    /// Position in the held text to which the loop jumps back or the call returns.
    pub(super) at: u16,
    /// Whether the loop ends with this pass.
    pub(super) leaving: bool,
    /// The number of the host's line at which the block or call began, counted from the first received line.
    begun: u32,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum FlowState {
    Streaming,
    /// Lines of a block are recorded. The block begins at this position of the held text. If there is an error, the
    /// block's lines are refused instead.
    Recording(u16, Option<Error>),
    /// The program's lines are recorded, from the call of an unknown subprogram on.
    Holding,
    /// The recorded program has ended, and waits for the definition of a subprogram.
    Waiting,
    /// Held text is executed. `Some`: the text was stored only for this execution (a loop, or a line of the host with
    /// a call). It begins at this position and is removed afterwards. `None`: the text is a subroutine, which remains.
    Running(Option<u16>),
}

/// Buffer of the held text in programs on a PC, where its capacity is fixed.
#[cfg(feature = "alloc")]
pub(super) type HeldText = heapless::Vec<u8, MOST_HELD>;
/// Buffer of the held text. The type is a view without a fixed capacity, because the capacity differs from board to
/// board.
#[cfg(not(feature = "alloc"))]
pub(super) type HeldText = heapless::vec::VecView<u8>;

/// State of the O words: the held text, the open blocks and calls, and how the next line is treated.
#[cfg_attr(feature = "alloc", derive(Clone))]
#[derive(Debug, PartialEq)]
pub(super) struct FlowControl {
    pub(super) text: Lent<HeldText>,
    /// Maximum number of bytes in `text`.
    pub(super) most: usize,
    /// Number of bytes at the start of the text that belong to macros. These bytes remain when a program ends.
    pub(super) macros: u16,
    pub(super) frames: heapless::Vec<Frame, DEPTH>,
    labels: heapless::Vec<u8, LABELS>,
    pub(super) state: FlowState,
    /// Whether lines are skipped, up to the next O word with the label of the innermost frame.
    pub(super) skipping: bool,
    /// Position in the held text of the line that is executed next.
    pub(super) next: u16,
    /// Number of frames (open blocks and calls) that lines of the host have opened. The running held text has opened
    /// the frames after them.
    pub(super) below: u8,
    passes: u32,
    pub(super) skipped: u32,
    /// Number of the host's present line; the first received line is 1.
    pub(super) line: u32,
    /// Number of the host's line at which the present recording began. The recording is that of a block, a held
    /// program or a subprogram.
    pub(super) recorded_from: u32,
    /// Whether the previous line was an M2 or M30 that was skipped or recorded.
    pub(super) after_end: bool,
    /// If a block was still open at the end of the program: number of the host's line at which this block began.
    /// Otherwise `None`.
    pub(super) cut: Option<u32>,
    /// Position in the held text of the call that waits until the host has sent the called subprogram. When the
    /// subprogram is complete, the program continues with this call.
    pub(super) waiting: Option<u16>,
    /// Start of the held text that runs when the call at `waiting` continues. Afterwards the held text is removed from
    /// this position on.
    held_from: u16,
    /// Number of the subprogram in the most recent call of an unknown subprogram.
    pub(super) missing: u32,
    /// Number of conditions and loops that are open in the subprogram being recorded.
    pub(super) within: u8,
    /// `true` if the line in execution, or the line that called it, comes from the host; `false` if it is a startup
    /// line. When a line of the host calls an unknown subprogram, the program waits until the host sends the
    /// subprogram. A startup line cannot wait, so the same call is an error there.
    pub(super) of_host: bool,
    /// The modal call (G66), which follows each line that moves an axis.
    pub(super) modal: ModalCall,
}

impl FlowControl {
    /// Creates the state at power-up. `text`: empty buffer for the held text. `most`: number of its bytes that may be
    /// used.
    pub fn new(text: Lent<HeldText>, most: usize) -> Self {
        Self {
            text,
            most,
            macros: 0,
            frames: heapless::Vec::new(),
            labels: heapless::Vec::new(),
            state: FlowState::Streaming,
            skipping: false,
            next: 0,
            below: 0,
            passes: 0,
            skipped: 0,
            line: 0,
            recorded_from: 0,
            after_end: false,
            cut: None,
            waiting: None,
            held_from: 0,
            missing: 0,
            within: 0,
            of_host: false,
            modal: ModalCall::default(),
        }
    }

    /// Forgets everything except the macros. Resets the fields one at a time, because a new value would be copied here
    /// with all its frames and labels.
    pub fn reset(&mut self) {
        self.text.truncate(usize::from(self.macros));
        self.frames.clear();
        self.labels.clear();
        self.state = FlowState::Streaming;
        self.skipping = false;
        self.next = 0;
        self.below = 0;
        self.passes = 0;
        self.skipped = 0;
        self.line = 0;
        self.recorded_from = 0;
        self.after_end = false;
        self.cut = None;
        self.waiting = None;
        self.within = 0;
        self.modal.end();
    }

    /// Ends the program: resets the state. If a block is still open, stores in `cut` the line at which the block began.
    pub fn end_program(&mut self) {
        let cut = self.open_since();
        self.reset();
        self.cut = cut;
    }

    /// Returns the number of the host's line at which the outermost open block began; `None` if no block is open.
    pub(super) fn open_since(&self) -> Option<u32> {
        let of_stream = match self.state {
            FlowState::Running(_) => usize::from(self.below),
            _ => self.frames.len(),
        };
        let records = self.records() || self.state == FlowState::Waiting;
        let recorded = records.then_some(self.recorded_from);
        self.frames.get(..of_stream)?.first().map(|frame| frame.begun).or(recorded)
    }

    /// Returns whether lines of the host are recorded, in a block or in a held program.
    pub(super) fn records(&self) -> bool {
        matches!(self.state, FlowState::Recording(..) | FlowState::Holding)
    }

    /// Returns whether lines of the host are skipped, or recorded in a block or subprogram. In both cases the lines
    /// are not executed.
    pub(super) fn leaves_lines_out(&self) -> bool {
        self.skipping || matches!(self.state, FlowState::Recording(..))
    }

    /// Returns the held line at a position; `None` after the last line.
    pub(super) fn line(&self, at: u16) -> Option<&[u8]> {
        let (length, rest) = self.text.get(usize::from(at)..)?.split_first()?;
        rest.get(..usize::from(*length))
    }

    /// Appends a line and its message to the held text. Returns an error if fewer than `spare` bytes would remain
    /// free.
    pub(super) fn hold(&mut self, line: &[u8], comment: &[u8], spare: usize) -> Result<(), Error> {
        let length = line.len() + comment.len();
        let prefix = u8::try_from(length).map_err(|_| Error::OutOfMemory)?;
        if self.text.len() + 1 + length + spare > self.most {
            return Err(Error::OutOfMemory);
        }
        let _ = self.text.push(prefix);
        self.text.extend_from_slice(line).map_err(|_| Error::OutOfMemory)?;
        self.text.extend_from_slice(comment).map_err(|_| Error::OutOfMemory)
    }

    /// Finds a subroutine of the program or, if it has none with this label, a complete subroutine among the macros.
    /// Returns the positions of its first and second line.
    pub(super) fn find(&self, label: &[u8]) -> Option<(u16, u16)> {
        self.find_own(label).or_else(|| self.find_macro(label))
    }

    /// Finds a complete subroutine among the macros. Returns the positions of its first and second line.
    pub(super) fn find_macro(&self, label: &[u8]) -> Option<(u16, u16)> {
        let (at, behind) = self.find_sub(0, label)?;
        self.end_of_sub(behind, label).filter(|end| *end <= self.macros)?;
        Some((at, behind))
    }

    /// Finds a subroutine or subprogram of the program. Returns the positions of its first and second line.
    pub(super) fn find_own(&self, label: &[u8]) -> Option<(u16, u16)> {
        self.find_sub(self.macros, label)
    }

    fn find_sub(&self, from: u16, label: &[u8]) -> Option<(u16, u16)> {
        self.find_from(from, |order| matches!(order.keyword, Keyword::Sub | Keyword::Program) && order.label == label)
    }

    /// Returns the position after the `endsub` line of a subroutine.
    fn end_of_sub(&self, from: u16, label: &[u8]) -> Option<u16> {
        self.find_order(from, Keyword::EndSub, label).map(|(_, behind)| behind)
    }

    /// Searches from position `from` on for the first line with this O word. Returns the positions of this line and of
    /// the line after it.
    #[inline(never)]
    pub(super) fn find_order(&self, from: u16, keyword: Keyword, label: &[u8]) -> Option<(u16, u16)> {
        self.find_from(from, |order| order.keyword == keyword && order.label == label)
    }

    /// Searches from position `from` on for the first line whose O word satisfies `is_it`. Returns the positions of
    /// this line and of the line after it.
    pub(super) fn find_from(&self, from: u16, is_it: impl Fn(&OWord) -> bool) -> Option<(u16, u16)> {
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

    /// Drops the program's first subroutine with this label; macros stay.
    pub(super) fn drop_sub(&mut self, label: &[u8]) {
        if let Some((from, behind)) = self.find_own(label)
            && let Some(end) = self.end_of_sub(behind, label)
        {
            self.text.copy_within(usize::from(end).., usize::from(from));
            self.text.truncate(self.text.len() - usize::from(end - from));
        }
    }

    /// Drops a refused subroutine, whose text begins at `from`, and an older subroutine with the same label. Leaves an
    /// empty subroutine with this label, because otherwise a call of the label could run a macro with the same label.
    /// The `endsub` of the empty subroutine is invalid, so the call is an error. `end`: the `endsub` line without its
    /// arguments.
    pub(super) fn refuse_sub(&mut self, from: u16, label: &[u8], end: &[u8]) {
        let opening = 1 + self.line(from).map_or(0, <[u8]>::len);
        self.text.truncate(usize::from(from) + opening);
        self.drop_sub(label);
        let behind = self.text.len();
        if self.hold(end, b"]", SPARE).is_err() {
            self.text.truncate(behind.saturating_sub(opening));
        }
    }

    pub(super) fn push(&mut self, kind: FrameKind, label: &[u8], at: u16) -> Result<(), Error> {
        let frame = Frame { kind, label: label.len() as u8, at, leaving: false, begun: self.line };
        if self.labels.len() + label.len() > LABELS || self.frames.push(frame).is_err() {
            return Err(Error::TooDeep);
        }
        self.labels.extend_from_slice(label).map_err(|_| Error::TooDeep)
    }

    pub(super) fn pop(&mut self) -> Option<Frame> {
        let frame = self.frames.pop()?;
        self.labels.truncate(self.labels.len().saturating_sub(usize::from(frame.label)));
        Some(frame)
    }

    pub(super) fn is_of_last(&self, label: &[u8]) -> bool {
        self.last_label() == label
    }

    /// Returns the labels of all frames without separators, the innermost label last. [`Frame::label`] is the length
    /// of a frame's label.
    pub(super) fn labels(&self) -> &[u8] {
        &self.labels
    }

    /// Returns the label of the innermost frame.
    pub(super) fn last_label(&self) -> &[u8] {
        let length = self.frames.last().map_or(0, |frame| usize::from(frame.label));
        self.labels.get(self.labels.len().saturating_sub(length)..).unwrap_or_default()
    }

    /// Returns the innermost frame, or an error if its label is a different one.
    pub(super) fn last(&mut self, label: &[u8]) -> Result<&mut Frame, Error> {
        if !self.is_of_last(label) {
            return Err(Error::FlowSyntax);
        }
        self.frames.last_mut().ok_or(Error::FlowSyntax)
    }

    /// Continues with the held (recorded) line at `at`. Returns an error after [`PASSES`] jumps within one line of the
    /// host, to end endless loops.
    pub(super) fn go_back(&mut self, at: u16) -> Result<(), Error> {
        self.passes += 1;
        if self.passes > PASSES {
            return Err(Error::EndlessLoop);
        }
        self.next = at;
        Ok(())
    }

    /// Starts to execute the held text (recorded lines) at `at`. `temporary_from`: start of a text that was stored
    /// only for this execution (see [`FlowState::Running`]).
    pub(super) fn run(&mut self, at: u16, temporary_from: Option<u16>) {
        self.state = FlowState::Running(temporary_from);
        self.next = at;
        self.below = self.frames.len() as u8;
        self.passes = 0;
    }

    /// Starts to hold the lines of the program, because the call at `at` in the running text calls a subprogram that is
    /// not known yet. `is_complete`: the program has been held up to its end, so only subprograms can follow.
    pub(super) fn wait(&mut self, at: u16, is_complete: bool) {
        let end = self.text.len() as u16;
        self.held_from = if let FlowState::Running(Some(from)) = self.state {
            from
        } else {
            // A line of the host has made the outermost call. The call returns to the lines that the host sends from
            // now on, which are held at the end of the text.
            if let Some(call) = self.frames.get_mut(usize::from(self.below)) {
                call.at = end;
            }
            end
        };
        self.state = if is_complete { FlowState::Waiting } else { FlowState::Holding };
        if !is_complete {
            self.recorded_from = self.line;
            self.after_end = false;
        }
        self.waiting = Some(at);
        // The program's lines are held text from now on, too. So all open frames belong to the text that runs next,
        // even conditions that lines of the host have opened.
        self.below = 0;
    }

    /// Runs the call that has waited for its subprogram, and then the held program after it. Returns whether a call was
    /// waiting.
    pub(super) fn go_on(&mut self) -> bool {
        let Some(at) = self.waiting.take() else { return false };
        self.state = FlowState::Running(Some(self.held_from));
        self.next = at;
        self.passes = 0;
        true
    }

    /// Stops executing the held text (recorded lines), and closes the blocks and calls within it. Removes the text if
    /// it was stored only for this execution.
    pub fn stop(&mut self) {
        if let FlowState::Running(temporary_from) = self.state {
            if let Some(at) = temporary_from {
                self.text.truncate(usize::from(at));
            }
            while self.frames.len() > usize::from(self.below) {
                self.pop();
            }
            self.skipping = false;
            self.state = FlowState::Streaming;
        }
    }
}
