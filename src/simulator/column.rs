//! Finds the column of the word that an error message names. The controller reads lines without blanks and comments,
//! and its messages name words in that form. This module looks for the word in the line as it is in the file.

/// Returns the column in `line` of the word that the message `reason` names, in characters from 1. `None` if the
/// message names only a missing word, or is about another line.
pub fn of_word(reason: &str, line: &str) -> Option<u64> {
    let words = without_comments(line);
    let named = reason.split(": ").next().unwrap_or_default();
    let without_number = named.starts_with("no number behind ");
    named.split([' ', ',']).filter(|name| is_word(name)).find_map(|name| {
        let at = (0..words.len()).find(|at| begins(&words[*at..], name, without_number))?;
        Some(words[at].0)
    })
}

/// Returns a line as the controller reads it: in upper case, without blanks and comments.
pub fn as_read(line: &str) -> String {
    without_comments(line).into_iter().map(|(_, character)| character).collect()
}

/// Returns the characters of a line outside comments and blanks, in upper case, with their columns.
fn without_comments(line: &str) -> Vec<(u64, char)> {
    let mut depth = 0_usize;
    let mut words = Vec::new();
    for (column, character) in (1..).zip(line.split(';').next().unwrap_or_default().chars()) {
        match character {
            '(' => depth += 1,
            ')' if depth > 0 => depth -= 1,
            _ if depth > 0 || character.is_whitespace() => {}
            _ => words.push((column, character.to_ascii_uppercase())),
        }
    }
    words
}

/// Returns whether a part of a message is a G-code word and not plain English: it has no lower-case letter.
fn is_word(name: &str) -> bool {
    !name.is_empty() && !name.contains(|c: char| c.is_ascii_lowercase())
}

/// Returns whether `line` begins with the G-code word `name`. `G2` also matches `G02`, but not `G21`.
/// `without_number`: `true` if the message is about a letter that has no number. A `name` that is only a letter then
/// matches only a letter without a number after it.
fn begins(line: &[(u64, char)], name: &str, without_number: bool) -> bool {
    let is_of_number = |c: char| c.is_ascii_digit() || c == '.';
    let mut rest = line.iter().map(|(_, character)| *character).peekable();
    let mut last = ' ';
    for wanted in name.chars() {
        if last.is_ascii_alphabetic() && wanted.is_ascii_digit() {
            while rest.peek() == Some(&'0') && wanted != '0' {
                rest.next();
            }
        }
        if rest.next() != Some(wanted) {
            return false;
        }
        last = wanted;
    }
    let next = rest.next().unwrap_or(' ');
    match last.is_ascii_alphabetic() {
        true if without_number => !is_of_number(next) && !"[#".contains(next),
        true => true,
        false => !(is_of_number(last) && is_of_number(next)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_word_is_found_as_it_was_written() {
        for (reason, line, column) in [
            ("comma in X1,5: write a decimal point", "g1 (X1) x 1,5 f100", Some(9)),
            (
                "Q is missing in G83: the depth of each peck in program units, above 0, such as Q2",
                "N10  G83 X1 Z-5 R1",
                Some(6),
            ),
            ("the radius of G2 is 4.000 mm at its start", "G21 G02 X10 I4", Some(5)),
            ("G0 and G1 in one line: write one of them, or two lines", "G10 G01 G0 X1", Some(9)),
            ("no number behind X", "X1 Y2 X", Some(7)),
            ("no letter in front of 10", "10 (ten)", Some(1)),
            ("write #101+2 in brackets behind X", "G1 X #101 + 2", Some(6)),
            ("letter O in X1O5: write a 0", "G1 x1o5", Some(6)),
            ("F is missing: no feed has been set for G1", "X5 ; F", None),
            ("no subroutine 100 above this line", "o100 call", Some(2)),
        ] {
            assert_eq!(of_word(reason, line), column, "{reason}: {line}");
        }
    }
}
