//! Composes sentences about refused lines from a template, words of the line, lengths and numbers.

use crate::gcode::Reason;
use crate::number::{self, Digits};
use crate::units::{DECIMAL_ONE, Decimal};

/// Maximum length in bytes of a word or name within a sentence. A longer one is cut: an expression can fill a whole
/// line.
const NAME: usize = 24;

/// Appends `template` to `out`. Replaces each `%` in it by the next of `others`, as `name` writes it.
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

/// Appends the first `NAME` bytes of a part of a line. Stops at a bracket, which would end the message. Characters
/// outside printable ASCII become `?`.
#[inline(never)]
pub(super) fn name(out: &mut Reason, text: &[u8]) {
    let end = text.iter().position(|byte| matches!(byte, b'[' | b']')).unwrap_or(text.len());
    for byte in text.iter().take(end.min(NAME)) {
        let _ = out.push(if matches!(byte, b' '..=b'~') { *byte } else { b'?' });
    }
}

/// Appends a length in mm with three decimals. `units` is in units of 0.1 nm.
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
pub(super) fn digits(out: &mut Reason, mut value: u64, least: usize) {
    // 2^64 has 20 digits.
    let mut digits = heapless::Vec::<u8, 20>::new();
    while value > 0 || digits.len() < least {
        let _ = digits.push(b'0' + (value % 10) as u8);
        value /= 10;
    }
    let _ = digits.iter().rev().try_for_each(|digit| out.push(*digit));
}

/// Returns the number of a word; `None` if it is computed or malformed.
#[inline(never)]
pub(super) fn plain_number(word: &[u8]) -> Option<Decimal> {
    let text = word.get(1..)?;
    number::read(text, Digits::Exact).filter(|number| number.used == text.len()).map(|number| number.value)
}
