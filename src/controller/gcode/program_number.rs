//! Finds the numbers of programs and subprograms (`O1001`, `:1001`), M99 and line numbers in the text of a line.

use super::code::Code;
use crate::number::{self, Digits};

/// Returns the part of a line after its line number (N and digits), or the whole line if it has none.
pub(super) fn behind_line_number(line: &[u8]) -> &[u8] {
    line.strip_prefix(b"N").map_or(line, behind_digits)
}

/// Returns the part of a text after the digits with which it begins.
#[inline(never)]
pub(super) fn behind_digits(text: &[u8]) -> &[u8] {
    let digits = text.iter().take_while(|byte| byte.is_ascii_digit()).count();
    text.get(digits..).unwrap_or_default()
}

/// Returns whether a line begins with the number of a program or subprogram; a line number (N) may precede it. Further
/// words may follow, and the numbers need not be valid: `N10O1001G0` has one.
pub(super) fn has_program_number(line: &[u8]) -> bool {
    is_program_number(line.strip_prefix(b"N").map_or(line, from_next_word))
}

/// Returns the number of a subprogram as digits without leading zeros: `1` for `N5O0001`. Returns `None` if the line
/// has any word besides this number and a line number before it.
#[inline(never)]
#[cfg(feature = "full")]
pub(super) fn subprogram_number(line: &[u8]) -> Option<&[u8]> {
    let Some((b'O' | b':', number)) = behind_line_number(line).split_first() else { return None };
    let zeros = number.iter().take_while(|digit| **digit == b'0').count();
    let number = number.get(zeros.min(number.len().saturating_sub(1))..)?;
    ((1..=8).contains(&number.len()) && behind_digits(number).is_empty()).then_some(number)
}

/// Returns the number of a program; 0 if the line is not a program number alone.
#[inline(never)]
#[cfg(feature = "full")]
pub(super) fn number_of(line: &[u8]) -> u32 {
    let digits = subprogram_number(line).unwrap_or_default();
    digits.iter().fold(0, |value, digit| value * 10 + u32::from(digit - b'0'))
}

/// Returns whether a refused line may be the first line of a program or subprogram: it has an O number anywhere in it,
/// or begins with a name instead of a number (`<SUB1>`).
pub(super) fn may_have_program_number(line: &[u8]) -> bool {
    let mut before = b' ';
    line.first() == Some(&b'<')
        || (0..line.len()).any(|at| {
            let rest = line.get(at..).unwrap_or_default();
            let begins_word = !before.is_ascii_uppercase();
            before = rest.first().copied().unwrap_or_default();
            begins_word && is_program_number(rest)
        })
}

/// Returns whether a text begins with a program number: O or a colon, then a number, and no keyword of an O word after
/// it. `O1X5` begins with a program number, `O1SUB` does not.
fn is_program_number(text: &[u8]) -> bool {
    let Some((b'O' | b':', number)) = text.split_first() else { return false };
    let word = from_next_word(number);
    let letters = word.iter().take_while(|byte| byte.is_ascii_uppercase()).count();
    !word.get(..letters).is_some_and(|word| O_WORDS.contains(&word))
}

/// Returns whether a line has M99, outside of names and expressions.
pub(super) fn has_return(line: &[u8]) -> bool {
    let mut rest = line;
    while let Some((letter, number)) = from_next_word(rest).split_first() {
        if *letter == b'M' && number::read(number, Digits::Exact).is_some_and(|read| Code::of(read.value).whole == 99) {
            return true;
        }
        rest = number;
    }
    false
}

/// Returns the part of a line that starts at its first letter or colon outside of brackets.
fn from_next_word(line: &[u8]) -> &[u8] {
    let mut depth = 0_usize;
    let word = line.iter().position(|byte| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        depth == 0 && (byte.is_ascii_uppercase() || *byte == b':')
    });
    word.and_then(|at| line.get(at..)).unwrap_or_default()
}

/// The keywords of O words. A build that does not execute O words needs them too: `O1SUB` is not a program number.
pub(super) const O_WORDS: [&[u8]; 15] = [
    b"SUB",
    b"ENDSUB",
    b"CALL",
    b"RETURN",
    b"IF",
    b"ELSEIF",
    b"ELSE",
    b"ENDIF",
    b"WHILE",
    b"ENDWHILE",
    b"DO",
    b"REPEAT",
    b"ENDREPEAT",
    b"BREAK",
    b"CONTINUE",
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn o_words_are_no_numbers() {
        for (line, is) in [
            ("O1", true),
            ("N5O0100", true),
            (":7", true),
            ("O1X5", true),
            ("O1SUB", false),
            ("N5O1ENDWHILE", false),
            ("O<A>CALL", false),
            ("O[1+ABS[2]]CALL[3]", false),
            ("O#1REPEAT[2]", false),
            ("G0X1", false),
            ("", false),
        ] {
            assert_eq!(has_program_number(line.as_bytes()), is, "{line}");
        }
        for word in O_WORDS {
            assert!(!has_program_number(&[b"O1", word].concat()), "{word:?}");
        }
    }
}
