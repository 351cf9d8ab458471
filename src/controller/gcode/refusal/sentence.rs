//! Parts of a sentence about a refused line: words of the line, lengths, numbers.

use crate::gcode::Reason;
use crate::number::{self, Digits};
use crate::units::{DECIMAL_ONE, Decimal};

/// Maximum length of a name. Longer names are cut, because an expression can fill a line.
const NAME: usize = 24;

/// Appends `template`, in which each `%` is replaced by the next of `others`.
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

/// Appends a part of a line, up to its first bracket; characters outside printable ASCII become `?`.
#[inline(never)]
pub(super) fn name(out: &mut Reason, text: &[u8]) {
    let end = text.iter().position(|byte| matches!(byte, b'[' | b']')).unwrap_or(text.len());
    for byte in text.iter().take(end.min(NAME)) {
        let _ = out.push(if matches!(byte, b' '..=b'~') { *byte } else { b'?' });
    }
}

/// Appends a length in mm with three decimals.
#[inline(never)]
pub(super) fn millimetres(out: &mut Reason, units: i64) {
    let thousandths = (units.unsigned_abs() + DECIMAL_ONE as u64 / 2000) / (DECIMAL_ONE as u64 / 1000);
    if units < 0 {
        let _ = out.push(b'-');
    }
    digits(out, thousandths / 1000, 1);
    let _ = out.push(b'.');
    digits(out, thousandths % 1000, 3);
}

/// Appends a number with at least `least` digits.
#[inline(never)]
pub(super) fn digits(out: &mut Reason, value: u64, least: usize) {
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
            // All lower digits follow, including zeros.
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

/// Returns the number of a word if it is written as a plain number.
#[inline(never)]
pub(super) fn plain_number(word: &[u8]) -> Option<Decimal> {
    let text = word.get(1..)?;
    number::read(text, Digits::Exact).filter(|number| number.used == text.len()).map(|number| number.value)
}
