//! What is wrong with a refused line, in a sentence that names the word: "Q is missing in G83". A line that was refused
//! has changed nothing, so it is read again here, word by word, and looked at in the state in which it was refused.
//!
//! Promises: accepted lines pay nothing for it; the sentence says what to change without a look into a document; it has
//! no brackets, which would end a `[MSG:...]`. Words are named as they were received: in capitals, without blanks. The
//! word that is wrong comes before the first colon, and what may help behind it. Leaves to others: the number of the
//! error, which is that of the check. Nothing is inlined: flash is scarcer than the time of a refusal. Boards without room for texts (feature `reasons`) have none of it.

mod meaning;
mod words;

use super::action::Action;
use super::parse::Parsed;
use super::state::Interpreter;
use super::{Dialect, Reason};
use crate::error::Error;
use crate::number::{self, Digits};
use crate::units::{DECIMAL_ONE, Decimal};
use words::{Found, Text};

/// Names longer than this are cut: an expression may fill a line.
const NAME: usize = 24;

impl<const N: usize> Interpreter<N> {
    /// What is wrong with a line that has just been refused, and has changed nothing; nothing if the number of the error says
    /// all there is. `action` is that of the check.
    #[cold]
    #[inline(never)]
    pub fn explain(
        &mut self,
        line: &[u8],
        dialect: Dialect,
        error: Error,
        is_jog: bool,
        action: &Action<N>,
        out: &mut Reason,
    ) {
        out.clear();
        if self.explain_flow(line, error, out) {
            return;
        }
        let mut parsed = Parsed::empty();
        match self.refused_word(line, dialect, &mut parsed) {
            Some(found) => self.explain_word(&Text { line, dialect }, found, error, out),
            None => self.explain_meaning(&Text { line, dialect }, &parsed, error, is_jog, action, out),
        }
        self.computed.begin();
    }

    /// The first word that cannot be read or stand behind those before it.
    #[inline(never)]
    fn refused_word(&mut self, line: &[u8], dialect: Dialect, parsed: &mut Parsed<N>) -> Option<Found> {
        let mut start = 0;
        while start < line.len() {
            let end = words::end_of(line, start);
            if let Err(error) = self.read_again(line.get(..end)?, dialect, parsed) {
                return Some(Found { start, end, error });
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
}

/// Appends a text in which each `%` stands for the next of some others.
#[inline(never)]
pub(in crate::gcode) fn say(out: &mut Reason, template: &str, others: &[&[u8]]) {
    let mut others = others.iter();
    for byte in template.bytes() {
        if byte == b'%' {
            name(out, others.next().copied().unwrap_or_default());
        } else {
            let _ = out.push(byte);
        }
    }
}

/// A part of a line. It ends at a bracket, and has nothing in it that is no text.
#[inline(never)]
fn name(out: &mut Reason, text: &[u8]) {
    let end = text.iter().position(|byte| matches!(byte, b'[' | b']')).unwrap_or(text.len());
    for byte in text.iter().take(end.min(NAME)) {
        let _ = out.push(if matches!(byte, b' '..=b'~') { *byte } else { b'?' });
    }
}

/// A length in mm with three decimals.
#[inline(never)]
fn millimetres(out: &mut Reason, units: i64) {
    let thousandths = (units.unsigned_abs() + DECIMAL_ONE as u64 / 2000) / (DECIMAL_ONE as u64 / 1000);
    if units < 0 {
        let _ = out.push(b'-');
    }
    digits(out, thousandths / 1000, 1);
    let _ = out.push(b'.');
    digits(out, thousandths % 1000, 3);
}

/// So many digits at least.
#[inline(never)]
fn digits(out: &mut Reason, value: u64, least: usize) {
    let mut rest = u32::try_from(value).unwrap_or(u32::MAX);
    let (mut power, mut places) = (1_000_000_000_u32, 10_usize);
    while power > 0 {
        if rest >= power || places <= least || power == 1 {
            let mut digit = b'0';
            while rest >= power {
                rest -= power;
                digit += 1;
            }
            let _ = out.push(digit);
            // The ones behind it are written, too.
            power /= 10;
            while power > 0 {
                let mut digit = b'0';
                while rest >= power {
                    rest -= power;
                    digit += 1;
                }
                let _ = out.push(digit);
                power /= 10;
            }
            return;
        }
        power /= 10;
        places -= 1;
    }
}

/// The number of a word that is written plainly.
#[inline(never)]
fn plain_number(word: &[u8]) -> Option<Decimal> {
    let text = word.get(1..)?;
    number::read(text, Digits::Exact).filter(|number| number.used == text.len()).map(|number| number.value)
}
