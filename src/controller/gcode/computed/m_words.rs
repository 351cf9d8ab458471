//! Finds M words in the text of a line that is recorded or skipped. The words of such a line have not been evaluated.

/// Returns whether a line has an M word with one of these numbers, written as a plain integer: `M30` or `M030`.
pub(super) fn has_m_word(line: &[u8], numbers: &[&[u8]]) -> bool {
    find_m_word(line, numbers).is_some()
}

/// Returns the position of the first M word with one of these numbers, written as a plain integer.
#[inline(never)]
pub(super) fn find_m_word(line: &[u8], numbers: &[&[u8]]) -> Option<usize> {
    let mut in_name = false;
    let mut rest = line;
    while let Some((byte, behind)) = rest.split_first() {
        let at = line.len() - rest.len();
        rest = behind;
        in_name = *byte == b'<' || in_name && *byte != b'>';
        if *byte != b'M' || in_name {
            continue;
        }
        let digits = behind.iter().take_while(|byte| byte.is_ascii_digit()).count();
        let (number, after) = behind.split_at_checked(digits).unwrap_or_default();
        let zeros = number.iter().take_while(|digit| **digit == b'0').count();
        let number = number.get(zeros..).unwrap_or_default();
        if numbers.contains(&number) && after.first() != Some(&b'.') {
            return Some(at);
        }
    }
    None
}
