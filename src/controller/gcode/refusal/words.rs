//! Explains refused lines in which one word cannot be read, or conflicts with an earlier word of the line. (`meaning`
//! explains the other refusals.)

use super::sentence::{digits, millimetres, name, plain_number, say};
use crate::axes::Axis;
use crate::error::Error;
use crate::gcode::code::Code;
use crate::gcode::parse::{Parsed, TOOL_MAX, TOOL_MAX_OF_GRBL};
use crate::gcode::state::Interpreter;
use crate::gcode::word::Groups;
use crate::gcode::{Dialect, Reason};
use crate::image::FULL_IMAGE;

/// The text of a refused line, and the dialect in which it was read.
#[derive(Clone, Copy)]
pub(super) struct Text<'a> {
    pub line: &'a [u8],
    pub dialect: Dialect,
}

/// A word of a refused line, and the error for which it was refused.
#[derive(Clone, Copy)]
pub(super) struct RefusedWord {
    pub start: usize,
    pub end: usize,
    pub error: Error,
}

impl<'a> Text<'a> {
    pub fn words(self) -> impl Iterator<Item = &'a [u8]> {
        let mut start = 0;
        core::iter::from_fn(move || {
            let from = start;
            start = if from < self.line.len() { end_of(self.line, from) } else { return None };
            self.line.get(from..start)
        })
    }

    #[inline(never)]
    pub fn word(self, letter: u8) -> Option<&'a [u8]> {
        self.words().find(|word| word.first() == Some(&letter))
    }

    /// Returns the first word with this letter and one of these numbers, in tenths: `G38.2` is 382.
    #[inline(never)]
    pub fn code(self, letter: u8, tenths: &[u16]) -> Option<&'a [u8]> {
        self.words().find(|word| word.first() == Some(&letter) && tenths_of(word).is_some_and(|is| has(tenths, is)))
    }
}

/// Returns the number of a word in tenths, without further digits: 382 for `G38.2`. `None` if it is not a plain number.
#[inline(never)]
pub(super) fn tenths_of(word: &[u8]) -> Option<i64> {
    plain_number(word).map(|number| number.0 / (crate::units::DECIMAL_ONE / 10))
}

#[inline(never)]
fn has(numbers: &[u16], tenths: i64) -> bool {
    numbers.iter().any(|number| i64::from(*number) == tenths)
}

/// Returns the first of `names` with which a text begins.
#[inline(never)]
fn beginning(text: &[u8], names: &[&'static [u8]]) -> Option<&'static [u8]> {
    names.iter().copied().find(|name| text.starts_with(name))
}

/// Names of functions. At the beginning of a value, as in `XSIN[30]`, these letters belong to the value and do not
/// begin another word.
const FUNCTIONS: [&[u8]; 14] = [
    b"ABS[", b"ACOS[", b"ASIN[", b"ATAN[", b"COS[", b"EXISTS[", b"EXP[", b"FIX[", b"FUP[", b"LN[", b"ROUND[", b"SIN[",
    b"SQRT[", b"TAN[",
];
/// Operators that consist of letters.
const OPERATORS: [&[u8]; 10] = [b"MOD", b"EQ", b"NE", b"GT", b"GE", b"LT", b"LE", b"AND", b"OR", b"XOR"];

/// Returns the end of the word that begins at `start`.
#[inline(never)]
pub(super) fn end_of(line: &[u8], start: usize) -> usize {
    let (mut at, mut depth) = (start + 1, 0_usize);
    let mut before = line.get(start).copied().unwrap_or_default();
    if before == b'[' {
        depth = 1;
    }
    while let Some(&byte) = line.get(at) {
        let is_operand = !matches!(before, b'0'..=b'9' | b'.' | b']' | b'>');
        match byte {
            b'[' => depth += 1,
            b']' => depth = depth.saturating_sub(1),
            b'<' => at += line.get(at..).and_then(|rest| rest.iter().position(|byte| *byte == b'>')).unwrap_or(0),
            _ if depth > 0 => {}
            b'#' if !is_operand => break,
            b'A'..=b'Z' => {
                let rest = line.get(at..).unwrap_or_default();
                match beginning(rest, &FUNCTIONS).filter(|_| is_operand) {
                    // Skip the function's name up to its last letter; the bracket is the next byte.
                    Some(function) => at += function.len() - 2,
                    None => break,
                }
            }
            _ => {}
        }
        before = line.get(at).copied().unwrap_or_default();
        at += 1;
    }
    at.min(line.len())
}

/// Sentences about refused G words. The numbers are those of the words in tenths: 330 is G33. Most sentences say what
/// to write instead.
const INSTEAD_OF_G: [(&[u16], &str); 12] = [
    (
        &[330, 331, 760, 840],
        "% is not supported: nothing measures the spindle. Drill (G81), mill the thread (G3 with Z)",
    ),
    (&[740], "% is not supported: tapping needs a measured spindle, and pecking is G73. Mill the thread (G2 with Z)"),
    (&[960], "% is not supported: write G97 and S in revolutions per minute"),
    (&[70, 80], "% is not supported: there is no lathe mode, X is no diameter"),
    (&[160], "% is not supported: write X and Y instead of angle and radius"),
    (&[410, 411, 420, 421], "% is not supported: let the CAM program offset the path by the radius of the cutter"),
    (&[511], "% is not supported: G51 with a negative I or J mirrors"),
    (&[650, 660], "% calls a subprogram only at the beginning of its line, as a plain number: G65 P1001"),
    (&[870], "% is not supported: it needs a spindle that stops at an angle. Write the back boring as single moves"),
    (&[682], "% is not supported: tilted planes need five axes"),
    (&[290], "% is a word of 3-D printers: make the program for a mill"),
    (&[380], "% lacks its digit: G38.2 to G38.5 are probing moves"),
];
const INSTEAD_OF_M: [(&[u16], &str); 5] = [
    (&[100, 110], "% needs a macro (o10 sub or o11 sub in $M0=) and a line of its own. For outputs use M64, M65"),
    (&[980, 990], "% must be written as a plain number: M98 P1001, M99"),
    (&[970], "% is not supported: write O1000 .. M99 behind M30, and call it with M98 P1000"),
    (&[190], "% is not supported: the spindle cannot be turned to an angle"),
    (
        &[
            170, 180, 200, 210, 220, 230, 240, 820, 830, 840, 920, 1040, 1050, 1060, 1070, 1080, 1090, 1100, 1110,
            1120, 1130, 1140, 1150, 1170, 1180, 1190, 1400, 1410, 1900, 2010, 2030, 2040, 2050, 2200, 2210, 2800, 3000,
            3010, 3030, 3040, 4000, 4120, 4200, 5000, 5010, 5020, 8510, 9000, 9060, 9070,
        ],
        "% is a word of 3-D printers: make the program for a mill",
    ),
];

impl<const N: usize> Interpreter<N> {
    /// Returns the first word that cannot be read or that conflicts with the words before it.
    #[inline(never)]
    pub(super) fn refused_word(
        &mut self,
        line: &[u8],
        dialect: Dialect,
        parsed: &mut Parsed<N>,
    ) -> Option<RefusedWord> {
        let mut start = 0;
        while start < line.len() {
            let end = end_of(line, start);
            if let Err(error) = self.read_again(line.get(..end)?, dialect, parsed) {
                return Some(RefusedWord { start, end, error });
            }
            start = end;
        }
        None
    }

    #[inline(never)]
    fn read_again(&mut self, line: &[u8], dialect: Dialect, parsed: &mut Parsed<N>) -> Result<(), Error> {
        self.computed.begin();
        *parsed = Parsed::empty();
        parsed.read_apart(line, dialect, self)
    }

    /// Explains a word that is wrong by itself or conflicts with an earlier word of the line. `told`: the error with
    /// which the line was refused. If the error of the word differs from it, writes nothing.
    #[inline(never)]
    pub(super) fn explain_word(&mut self, text: &Text, found: RefusedWord, told: Error, out: &mut Reason) {
        let line = text.line;
        let word = line.get(found.start..found.end).unwrap_or_default();
        let before = line.get(..found.start).unwrap_or_default();
        let letter = word.first().copied().unwrap_or_default();
        if found.error != told {
            return;
        }
        let error = found.error;
        match error {
            Error::ExpectedLetter | Error::BadNumber | Error::ExpressionSyntax => {
                self.explain_text(text, found, word, before, out);
            }
            Error::TwoAxisCommands | Error::ModalGroupViolation => self.explain_pair(text, found, word, error, out),
            Error::WordRepeated => {
                let first = text.word(letter).unwrap_or_default();
                say(out, "% is twice in the line: %", &[&[letter], first]);
                say(out, " and %", &[word]);
            }
            Error::NegativeValue => say(out, "% must not be negative", &[word]),
            Error::ToolNumberTooHigh => {
                say(out, "% is too high: tools go up to ", &[word]);
                digits(out, if text.dialect == Dialect::Grbl { TOOL_MAX_OF_GRBL } else { TOOL_MAX } as u64, 1);
            }
            Error::UnsupportedCommand
            | Error::NotSupported
            | Error::CutterCompensation
            | Error::IntegerRequired
            | Error::UnsupportedCoordinateSystem => {
                let grbl = text.dialect == Dialect::Grbl;
                if grbl
                    && matches!(letter, b'G' | b'M')
                    && self.read_again(word, Dialect::Oxmill, &mut Parsed::empty()).is_ok()
                {
                    return say(out, "% is not in Grbl's dialect: $900=1 has it", &[word]);
                }
                explain_unknown::<N>(text, word, before, error, out);
            }
            Error::NoParallelAxes => {
                say(out, "% is no axis here: there are no U, V and W. Choose a post-processor for X, Y and Z", &[word]);
            }
            Error::OneRotaryAxis => say(out, "% is no axis here: A is the only one that turns", &[word]),
            Error::UnknownOperation => explain_operation(word, out),
            Error::DivisionByZero => say(out, "% is divided by zero", &[word_name(word)]),
            Error::ArgumentOutOfRange => explain_argument(word, out),
            Error::InvalidArgument => self.explain_parameter(word, out),
            Error::InvalidResult => say(out, "the value of % is too large", &[word_name(word)]),
            Error::TooDeep => say(out, "% has too many brackets within each other", &[word_name(word)]),
            Error::OutOfMemory => say(out, "% finds no room: too many parameters are set", &[word_name(word)]),
            Error::ReadOnlyParameter => {
                say(out, "% belongs to the machine: set one of your own, such as #100", &[word_name(word)]);
            }
            // The text of the error says enough, for example that this build lacks the word.
            error => {
                say(out, "%: ", &[word_name(word)]);
                let _ = out.extend_from_slice(error.text().as_bytes());
            }
        }
    }

    /// Explains text that is not a word, or a word without a valid number.
    #[inline(never)]
    fn explain_text(&mut self, text: &Text, found: RefusedWord, word: &[u8], before: &[u8], out: &mut Reason) {
        let (letter, rest) = word.split_first().unwrap_or((&0, &[]));
        let behind = text.line.get(found.end..).unwrap_or_default();
        let next = behind.get(..end_of(behind, 0)).unwrap_or_default();
        let grbl = text.dialect == Dialect::Grbl;
        let count = |what: u8| word.iter().filter(|byte| **byte == what).count();
        match (*letter, rest) {
            // The line filter leaves only `)` of a line whose nested comment is not closed.
            (b')', []) if text.line.len() == 1 => {
                say(out, "a remark is not closed: each parenthesis needs its other half", &[])
            }
            _ if count(b')') > 0 => {
                let first = if *letter == b')' { last_word(before) } else { up_to(word, b')') };
                say(out, "a parenthesis is closed that was not opened, behind %", &[first]);
            }
            _ if count(b'%') > 0 => say(out, "% has to be alone in its line", &[b"%"]),
            _ if count(b'<') > count(b'>') => say(out, "the name in % is not closed with >", &[word]),
            (b'/', _) => say(out, "/ skips a line only as its first character", &[]),
            (b'#', _) if grbl => say(out, "% is a parameter: Grbl's dialect has none ($900=1 has)", &[word_name(word)]),
            (b'0'..=b'9' | b'.' | b'-' | b'+', _) => say(out, "no letter in front of %", &[word]),
            (b'#', [] | [b'=', ..]) => say(out, "no number and no name behind #", &[]),
            (b'#', _) if word.last() == Some(&b'=') => say(out, "no value behind %", &[word]),
            (b'#', _) if !word.contains(&b'=') => say(out, "% has no letter in front, or no = behind", &[word]),
            (first, _) if !first.is_ascii_uppercase() && first != b'#' => {
                if first.is_ascii_graphic() {
                    say(out, "% begins no word", &[&[first]]);
                } else {
                    say(out, "a character that is no G-code, behind %", &[last_word(before)]);
                }
            }
            (_, [.., b'#']) => say(out, "no number behind %", &[word]),
            (first, [] | [b'-' | b'+']) if next.first() == Some(&b'O') && first != b'O' => {
                say(out, "letter O in %%: write a 0", &[word, next]);
            }
            (b'O', [] | [b'.', ..]) if !before.is_empty() => {
                say(out, "letter O in %%: write a 0", &[last_word(before), word]);
            }
            (b'M', []) if next == b"M" => {
                say(out, "no unit may follow %: remove it, G21 is mm, G20 inch", &[last_word(before)])
            }
            (b'I', []) if next.first() == Some(&b'N') => {
                say(out, "no unit may follow %: remove it, G21 is mm, G20 inch", &[last_word(before)]);
            }
            (first, [] | [b'-' | b'+' | b'.']) => say(out, "no number behind %", &[&[first]]),
            (first, [b'=', ..]) => say(out, "no = in a word: write %%", &[&[first], rest.get(1..).unwrap_or_default()]),
            (_, _) if is_comma(rest) => say(out, "comma in %: write a decimal point", &[word]),
            (first, [b',', ..]) => say(out, "no number behind %", &[&[first]]),
            (first, _) if grbl && (count(b'[') > 0 || count(b'#') > 0) => {
                say(out, "% is computed: Grbl's dialect takes numbers only ($900=1 computes)", &[&[first]]);
            }
            (_, _) if count(b'[') > count(b']') => say(out, "a bracket is not closed in %", &[word_name(word)]),
            (_, _) if count(b'[') < count(b']') => {
                say(out, "a bracket is closed that was not opened, in %", &[word_name(word)]);
            }
            (_, _) if points(rest) => say(out, "two points in %", &[word]),
            (_, [b'-' | b'+', b'-' | b'+', ..]) => say(out, "two signs in %", &[word]),
            (_, [.., b'/']) => say(out, "/ skips a line only as its first character", &[]),
            (_, [.., b'+' | b'-' | b'*']) => say(out, "no number behind %", &[word]),
            (first, _) => {
                let sum = operator_at(rest);
                let target = word.iter().position(|byte| *byte == b'=').and_then(|at| word.get(at + 1..));
                match (sum, target) {
                    (Some(_), None) if grbl || !FULL_IMAGE => {
                        say(out, "% is computed: write the result, such as %5", &[word, &[first]]);
                    }
                    (Some(_), value) => {
                        let written = value.unwrap_or(rest);
                        if written.contains(&b'[') {
                            say(
                                out,
                                "% continues after its bracket: put one pair of brackets around the whole value",
                                &[word_name(word)],
                            );
                        } else {
                            let target = word.get(..word.len() - written.len()).unwrap_or_default();
                            say(out, "write % in brackets behind %", &[written, target]);
                        }
                    }
                    (None, _) => match rest.iter().find(|byte| !is_of_number(**byte)) {
                        Some(strange) if strange.is_ascii_graphic() && !word.contains(&b'[') => {
                            say(out, "% in % is no part of a number", &[&[*strange], word]);
                        }
                        Some(_) if !word.contains(&b'[') => {
                            say(out, "a character that is no G-code, in %", &[word]);
                        }
                        _ => explain_brackets(word, out),
                    },
                }
            }
        }
    }

    /// Explains two words that exclude each other: `word`, and an earlier word of the line.
    #[inline(never)]
    fn explain_pair(&mut self, text: &Text, found: RefusedWord, word: &[u8], error: Error, out: &mut Reason) {
        let mut start = 0;
        let mut parsed = Parsed::empty();
        while start < found.start {
            let end = end_of(text.line, start);
            let other = text.line.get(start..end).unwrap_or_default();
            let mut both = heapless::Vec::<u8, 64>::new();
            let fit = both.extend_from_slice(other).and_then(|()| both.extend_from_slice(word));
            if fit.is_ok() && self.read_again(&both, text.dialect, &mut parsed) == Err(error) {
                let is_same = other == word;
                let mut groups = [Groups::default(); 2];
                for (word, groups) in [other, word].into_iter().zip(&mut groups) {
                    let _ = self.read_again(word, text.dialect, &mut parsed);
                    *groups = parsed.groups;
                }
                let [first, second] = groups;
                let is_of_one_group = first == second;
                if is_same {
                    say(out, "% is twice in the line: write it once, or two lines", &[word]);
                } else if error == Error::ModalGroupViolation || is_of_one_group {
                    say(out, "% and % in one line: write one of them, or two lines", &[other, word]);
                } else {
                    say(out, "% and % in one line: both want the axis words, write two lines", &[other, word]);
                }
                return;
            }
            start = end;
        }
        say(out, "% does not go with the words in front of it: write two lines", &[word]);
    }

    /// Explains a parameter that has not been set, or cannot be set.
    #[inline(never)]
    fn explain_parameter(&mut self, word: &[u8], out: &mut Reason) {
        let value = word.iter().position(|byte| *byte == b'=').and_then(|at| word.get(at..)).unwrap_or_default();
        match self.unset_parameter(value).or_else(|| self.unset_parameter(word)) {
            Some(found @ [b'#', b'<', ..]) => {
                say(out, "% is not set above this line: set it, or correct the name", &[found])
            }
            Some(found) => say(out, "% does not exist: parameters are #1 to #5999", &[found]),
            None => {
                say(out, "a parameter in % does not exist: #1 to #5999, and names up to 32 letters", &[word_name(word)])
            }
        }
    }
}

/// Returns the last word of `before`; "the beginning" if `before` is empty.
#[inline(never)]
fn last_word(before: &[u8]) -> &[u8] {
    let mut start = 0;
    while start < before.len() {
        let end = end_of(before, start);
        if end >= before.len() {
            return before.get(start..).unwrap_or_default();
        }
        start = end;
    }
    b"the beginning"
}

/// Returns the name of a word: the part before `=` or before the bracket of a computed value. This is a letter, or the
/// parameter that the word sets. Returns the whole word if it has no `=` and no bracket.
#[inline(never)]
pub(super) fn word_name(word: &[u8]) -> &[u8] {
    let end = word.iter().position(|byte| matches!(byte, b'=' | b'[')).unwrap_or(word.len());
    let name = word.get(..end).unwrap_or_default();
    // In `X-ABS[..]`, a sign and a function precede the bracket. The name of the word is only its letter.
    if end < word.len() && name.first().is_some_and(u8::is_ascii_uppercase) {
        return name.get(..1).unwrap_or_default();
    }
    name
}

fn is_of_number(byte: u8) -> bool {
    matches!(byte, b'0'..=b'9' | b'.' | b'-' | b'+')
}

/// Returns the part of a text before the byte `end`.
#[inline(never)]
fn up_to(text: &[u8], end: u8) -> &[u8] {
    text.split(|byte| *byte == end).next().unwrap_or_default()
}

/// Explains a malformed expression whose brackets are balanced.
#[inline(never)]
fn explain_brackets(word: &[u8], out: &mut Reason) {
    let name = word_name(word);
    let is_operator = |byte: &u8| matches!(byte, b'+' | b'-' | b'*' | b'/');
    for pair in word.windows(2) {
        match pair {
            [b'[', b']'] => return say(out, "nothing is in the brackets of %", &[name]),
            [operator, b']'] if is_operator(operator) => {
                return say(out, "no value behind % in the brackets of %", &[&[*operator], name]);
            }
            [b'[', operator] if matches!(operator, b'*' | b'/') => {
                return say(out, "no value in front of % in the brackets of %", &[&[*operator], name]);
            }
            _ => {}
        }
    }
    if word.windows(5).any(|part| part == b"ATAN[") {
        return say(out, "ATAN in % takes two values: as in ATAN, y in brackets, /, x in brackets", &[name]);
    }
    say(out, "the expression of % is malformed", &[name]);
}

/// Returns whether a number has a comma next to a digit.
#[inline(never)]
fn is_comma(number: &[u8]) -> bool {
    number.windows(2).any(|pair| matches!(pair, [b',', b'0'..=b'9'])) && number.first() != Some(&b',')
        || matches!(number, [b',', b'0'..=b'9', ..])
        || number.last() == Some(&b',') && number.len() > 1
}

/// Returns whether a number has more than one decimal point.
#[inline(never)]
fn points(number: &[u8]) -> bool {
    let plain = number.iter().take_while(|byte| is_of_number(**byte));
    plain.filter(|byte| **byte == b'.').count() > 1
}

/// Returns the position of the first operator outside of brackets. The first byte does not count, because it can only
/// be a sign.
#[inline(never)]
fn operator_at(value: &[u8]) -> Option<usize> {
    let mut depth = 0_usize;
    value.iter().enumerate().position(|(at, byte)| {
        match byte {
            b'[' => depth += 1,
            b']' => depth = depth.saturating_sub(1),
            _ => {}
        }
        at > 0 && depth == 0 && matches!(byte, b'+' | b'-' | b'*' | b'/')
    })
}

/// Explains a letter, G word or M word that does not exist, or that this dialect or machine lacks.
#[inline(never)]
fn explain_unknown<const N: usize>(text: &Text, word: &[u8], before: &[u8], error: Error, out: &mut Reason) {
    let letter = word.first().copied().unwrap_or_default();
    let grbl = text.dialect == Dialect::Grbl;
    let (tenths, number) = (tenths_of(word), plain_number(word));
    let instead: &[(&[u16], &str)] = match letter {
        b'G' => &INSTEAD_OF_G,
        b'M' => &INSTEAD_OF_M,
        b'O' if !before.is_empty() => {
            return say(out, "letter O in %%: write a 0", &[last_word(before), word]);
        }
        b'@' | b'^' => return say(out, "% is not supported: write X and Y instead of angle and radius", &[word]),
        _ => {
            let is_axis = Axis::from_letter(letter).is_some();
            return match (is_axis, grbl) {
                (true, _) if letter == b'A' && N > 3 => {
                    say(out, "% is no axis of this machine: $930=4 adds A", &[word]);
                }
                (true, _) => say(out, "% is no axis of this machine", &[word]),
                (false, true) => say(out, "% has a letter that Grbl's dialect does not know ($900=1 may)", &[word]),
                (false, false) => say(out, "% has a letter that nothing uses", &[word]),
            };
        }
    };
    let found = instead.iter().find(|(numbers, _)| tenths.is_some_and(|tenths| has(numbers, tenths)));
    if let Some((_, sentence)) = found {
        return say(out, sentence, &[word]);
    }
    match error {
        Error::UnsupportedCoordinateSystem => {
            say(out, "% is no coordinate system: there are G54 to G59, G59.1, G59.2 and G59.3", &[word]);
        }
        Error::IntegerRequired if letter == b'M' => {
            say(out, "% is not known: M words have whole numbers up to 255", &[word])
        }
        Error::IntegerRequired => {
            let whole = number.map_or(0, |number| Code::of(number).whole);
            say(out, "% is not known: G", &[word]);
            digits(out, whole.into(), 1);
            let _ = out.extend_from_slice(b" has no fraction");
        }
        Error::NotSupported if letter == b'M' && number.is_none() => {
            say(out, "a computed M word is none that is supported: write its number, such as M98 P1001", &[]);
        }
        _ if letter == b'M' && !grbl && matches!(tenths, Some(1000..=1990)) => {
            say(out, "% needs a macro of its number ($M0=o150 sub for M150) and a line of its own", &[word]);
        }
        _ if letter == b'M' => say(out, "% is no M word that is known", &[word]),
        _ => say(out, "% is no G word that is known", &[word]),
    }
}

/// Explains a name in an expression that is neither a function nor an operator.
#[inline(never)]
fn explain_operation(word: &[u8], out: &mut Reason) {
    let text = word.get(1..).unwrap_or_default();
    let mut at = 0;
    while let Some(byte) = text.get(at) {
        let rest = text.get(at..).unwrap_or_default();
        if *byte == b'<' {
            at += rest.iter().position(|byte| *byte == b'>').unwrap_or(0) + 1;
        } else if byte.is_ascii_uppercase() {
            let known = beginning(rest, &FUNCTIONS).or_else(|| beginning(rest, &OPERATORS));
            match known {
                Some(known) => at += known.len(),
                None => {
                    let length = rest.iter().take_while(|byte| byte.is_ascii_uppercase()).count();
                    let unknown = rest.get(..length).unwrap_or_default();
                    return say(out, "% in % is no function and no operator", &[unknown, word_name(word)]);
                }
            }
        } else {
            at += 1;
        }
    }
    say(out, "a function or operator in % is unknown", &[word_name(word)]);
}

/// Explains an argument that a function does not accept.
#[inline(never)]
fn explain_argument(word: &[u8], out: &mut Reason) {
    let has = |name: &[u8]| word.windows(name.len()).any(|part| part == name);
    let of = word_name(word);
    let (name, takes): (&[u8], &str) = match () {
        () if has(b"SQRT[") => (b"SQRT", "not below 0"),
        () if has(b"LN[") => (b"LN", "above 0"),
        () if has(b"ACOS[") => (b"ACOS", "from -1 to 1"),
        () if has(b"ASIN[") => (b"ASIN", "from -1 to 1"),
        () if has(b"TAN[") => (b"TAN", "not of 90 degrees"),
        () => return say(out, "a power in % has a negative base and a fraction as exponent", &[of]),
    };
    say(out, "% in % takes values ", &[name, of]);
    let _ = out.extend_from_slice(takes.as_bytes());
}

/// Appends the limit of coordinates, such as `50000.000mm`. `limit` is in units of 0.1 nm.
#[inline(never)]
pub(super) fn say_limit(out: &mut Reason, limit: i64) {
    millimetres(out, limit);
    name(out, b"mm");
}
