//! Message comments of programs (`(MSG, ...)`, `(PRINT, ...)`, `(DEBUG, ...)`). They are stored after the words of
//! their line.
//!
//! A mark before the text of the message tells whether the text is sent as written, or with the values of parameters
//! inserted. [`split_comment`] splits a line at the mark. The words before the mark contain neither `(` nor `;`,
//! because all comments have been removed from them.

/// Mark of a message that is sent as it is written.
pub const AS_WRITTEN: u8 = b'(';
/// Mark of a message in which parameters are replaced by their values.
pub const WITH_VALUES: u8 = b';';

/// Splits a line into its words and its message. The second part begins with the mark; it is empty if the line has no
/// message.
pub fn split_comment(line: &[u8]) -> (&[u8], &[u8]) {
    let end = line.iter().position(|byte| matches!(*byte, AS_WRITTEN | WITH_VALUES));
    line.split_at_checked(end.unwrap_or(line.len())).unwrap_or((line, &[]))
}
