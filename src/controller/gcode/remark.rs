//! Messages of programs, as they are kept behind the words of a line: `(MSG, ...)`, `(PRINT, ...)`, `(DEBUG, ...)`.
//! `split_remark` parts them at the mark: as written, or with the values of parameters.
//!
//! A mark is in front of the text. Neither of the marks can be among the words, which have no remarks.

/// Mark of a message that is told as it is written.
pub const AS_WRITTEN: u8 = b'(';
/// Mark of one in which parameters are replaced by their values.
pub const WITH_VALUES: u8 = b';';

/// The words of a line, and the message behind them with its mark; nothing if there is none.
pub fn split_remark(line: &[u8]) -> (&[u8], &[u8]) {
    let end = line.iter().position(|byte| matches!(*byte, AS_WRITTEN | WITH_VALUES));
    line.split_at_checked(end.unwrap_or(line.len())).unwrap_or((line, &[]))
}
