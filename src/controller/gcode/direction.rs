//! Results of processing O words: what to do with a line of the host, and what comes next in the held text (the
//! recorded lines of subroutines, loops and macros).

/// What to do with a line of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Check and execute the line.
    Check,
    /// Nothing: the line belongs to a condition, which has been evaluated.
    Done,
    /// Nothing: the line was skipped or recorded. The message in its comment is not sent.
    LeftOut,
    /// Run the subroutine that the line calls: [`Interpreter::next_held`](super::Interpreter::next_held).
    Call,
    /// Run held text: the loop that ends with this line, the line itself, or the program that has waited for the
    /// subprogram that ends here. The line has been recorded.
    Run,
}

/// Next item of held text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// The next held line has been read: check and execute it.
    Line,
    /// An O word of the held text has been processed; request the next line.
    Again,
    /// The held text has ended.
    End,
}
