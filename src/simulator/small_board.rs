//! Features that a small board does not support ([`Board::has_all_words`]). The simulator itself supports everything. A
//! check of a job for a small board adds the errors that the board would return.
//!
//! [`Board::has_all_words`]: oxmill_boards::profiles::Board::has_all_words

use crate::prologue::words_of;
use oxmill_controller::error::Error;
use oxmill_controller::units::Decimal;

/// Returns the error with which a small board rejects a line that other boards accept; `None` if it accepts the line,
/// too.
pub fn error_of(line: &str) -> Option<Error> {
    let code = code(line);
    let is_computed = code.contains(['#', '[']) || is_o_word(&code);
    match code.chars().next() {
        Some('$') => return (code.starts_with("$M") && code.contains('=')).then_some(Error::ExpressionsLeftOut),
        // Do not judge a line with `/`, because it may be skipped. Do not judge a checked line (`:`) either: it begins
        // with a header, which is not G-code.
        Some('/' | ':') => return None,
        _ if is_computed => return Some(Error::ExpressionsLeftOut),
        _ => {}
    }
    let words = words_of(code.as_bytes());
    words.iter().find_map(|(letter, number)| refused(*letter, *number, &words))
}

/// Returns a line without blanks and comments, in upper case.
fn code(line: &str) -> String {
    let mut depth = 0_usize;
    let mut code = String::new();
    for character in line.split(';').next().unwrap_or_default().chars() {
        match character {
            '(' => depth += 1,
            ')' => depth = depth.saturating_sub(1),
            _ if depth > 0 || character.is_whitespace() => {}
            _ => code.push(character.to_ascii_uppercase()),
        }
    }
    code
}

/// Returns whether a line is an O word: O, a label and a keyword. O with only a number is a program number.
fn is_o_word(code: &str) -> bool {
    let behind_digits = |text: &str| text.trim_start_matches(|c: char| c.is_ascii_digit()).to_owned();
    let line = code.strip_prefix('N').map_or(code.to_owned(), behind_digits);
    let Some(rest) = line.strip_prefix('O').map(behind_digits) else { return false };
    let letters = rest.chars().take_while(char::is_ascii_alphabetic).count();
    rest.starts_with('<') || letters > 1
}

fn refused(letter: u8, number: Decimal, words: &[(u8, Decimal)]) -> Option<Error> {
    let value = |letter| words.iter().find(|(other, _)| *other == letter).map(|(_, number)| *number);
    let is = |thousandths: i64| number == Decimal(Decimal::from_int(1).0 * thousandths / 1000);
    match letter {
        b'G' if [5000, 5100, 5200, 5300].into_iter().any(is) => Some(Error::SplinesLeftOut),
        b'G' if is(51_000) => Some(Error::ScalingLeftOut),
        b'G' if is(68_000) => Some(Error::RotationLeftOut),
        b'G' if is(64_000) && value(b'P').is_some_and(|path| path > Decimal::ZERO) => Some(Error::BlendingLeftOut),
        b'G' if is(10_000) && value(b'L') == Some(Decimal::from_int(2)) && value(b'R').is_some() => {
            Some(Error::RotationLeftOut)
        }
        b'M' if is(73_000) => Some(Error::ExpressionsLeftOut),
        b'G' if is(65_000) => Some(Error::NotSupported),
        b'M' if is(98_000) || is(99_000) => Some(Error::NotSupported),
        b'G' if is(31_000) || is(8000) && value(b'P').is_some() => Some(Error::NotSupported),
        b'G' if is(54_100) => Some(Error::UnsupportedCoordinateSystem),
        b'G' if [70_000, 71_000, 154_000, 187_000].into_iter().any(is) => Some(Error::UnsupportedCommand),
        b'M' if is(29_000) => Some(Error::UnsupportedCommand),
        b'D' => Some(Error::UnsupportedCommand),
        b'U'..=b'W' => Some(Error::NoParallelAxes),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_word_has_the_error_of_the_board() {
        for (line, code) in [
            ("G0 X[1+1]", 201),
            ("#1=2", 201),
            ("n5 o<drill> call [2]", 201),
            ("O100 while [1]", 201),
            ("O1 ENDSUB (end)", 201),
            ("m73", 201),
            ("$M0=G0 X1", 201),
            ("G68 X0 Y0 R45", 128),
            ("g10 l2 p1 r30", 128),
            ("G05.1 X1 Y1 I1 J1", 141),
            ("G5.20 P1 L3", 141),
            ("G51 P2", 144),
            ("G64P.05", 134),
            ("G5.1 Q1", 141),
            ("G31 Z-1", 121),
            ("M98 P1001 L2", 121),
            ("g65 p1 a1", 121),
            ("N5 X1 M99", 121),
            ("g08p1", 121),
            ("G54.1 P1", 29),
            ("G70", 20),
            ("G43 H1 D1", 20),
            ("M29 S1", 20),
            ("G28 U0 W0", 149),
        ] {
            assert_eq!(error_of(line).map(|error| error.code()), Some(code), "{line}");
        }
        let taken = "O1000\nN5 O7\nG1 X5 Y51 Z68 (G68 #1 [2])\nG64\nG64 P0\nG50\nG69\nG54 G17\nG10 L2 P1 X1\nG10 L20 P1 R1\n\
            G0 X1 ; [1]\n$M\n$N0=G0 X[1]\nG53 G0 Z0\nG81 R1 Z-1\nM72\n(PRINT, #1)\n/G68 R1\n:ABPHHcVUiPGG64\n";
        for line in taken.lines() {
            assert_eq!(error_of(line), None, "{line}");
        }
    }
}
