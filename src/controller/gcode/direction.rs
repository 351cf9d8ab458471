//! Results of processing O words: what to do with a line of the host, and what comes next in held text.

/// What to do with a line of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Check and execute the line.
    Check,
    /// Nothing: the line was a condition and has been evaluated.
    Done,
    /// Nothing: the line was skipped or held. Its message is not sent.
    LeftOut,
    /// Run what the line calls: [`Interpreter::next_held`](super::Interpreter::next_held).
    Call,
    /// Run the loop of which this line is the last; the line has been held.
    Run,
}

/// Next item of held text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// Check and execute this line.
    Line,
    /// An O word of the held text has been processed; request the next line.
    Again,
    /// The held text has ended.
    End,
}
