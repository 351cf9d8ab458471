//! Results of processing O words: [`Direction`] for a line of the host, and [`Held`] for the next line of the held text
//! (the recorded lines of subroutines, loops and macros).

/// What to do with a line of the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Check and execute the line.
    Check,
    /// Nothing: the line was an O word of a condition (if, elseif, else, endif), which has been executed.
    Done,
    /// Nothing: the line was skipped or recorded. The message in its comment is not sent.
    LeftOut,
    /// Run the subroutine that the line calls: read its lines with
    /// [`Interpreter::next_held`](super::Interpreter::next_held).
    Call,
    /// Run held text, to which the line has been added. The text that runs is one of these:
    /// * the loop that this line ends,
    /// * this line itself,
    /// * if this line ends a subprogram: the program that has waited for the subprogram.
    Run,
}

/// Result of reading the next line of held text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Held {
    /// The next held line has been read: check and execute it.
    Line,
    /// An O word of the held text has been processed; request the next line.
    Again,
    /// The held text has ended.
    End,
}
