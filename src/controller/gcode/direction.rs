//! The two answers that O words give: what to do with a line of the host, and what comes next of held text.

/// What a line of the host is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// To be checked and carried out.
    Check,
    /// Done with: a condition.
    Done,
    /// Skipped, or held: its message is not to be told now.
    LeftOut,
    /// Done with, and what it calls is to be run: [`Interpreter::next_held`](super::Interpreter::next_held).
    Call,
    /// Held, and a loop is to be run of which it is the last line.
    Run,
}

/// What comes next of held text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// This line is to be checked and carried out.
    Line,
    /// An O word of the held text, which has been dealt with; ask for the next line.
    Again,
    /// It has come to its end.
    End,
}
