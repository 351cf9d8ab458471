//! Reads decimal text as an exact [`Decimal`]: the numbers of programs and of `$` lines. Digits beyond the seventh
//! decimal are dropped; in Grbl's dialect only the first eight digits count.

use crate::units::{DECIMAL_PLACES, Decimal};

/// How many digits of a number count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Digits {
    /// All digits before the point and [`DECIMAL_PLACES`] after it; further ones are dropped.
    Exact,
    /// Grbl's rule: the first eight digits, leading zeros included. Further digits before the point count as zeros
    /// (`12345678901` is 12345678000); further digits after it are dropped.
    Eight,
}

const EIGHT: u32 = 8;
/// A mantissa below this can take one more digit without overflowing `u64`.
const ROOM_FOR_A_DIGIT: u64 = 1_000_000_000_000_000_000;
const POWERS: [u32; 8] = [1, 10, 100, 1000, 10_000, 100_000, 1_000_000, 10_000_000];

/// A number that was read from text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Number {
    /// Value, saturated at ±9.2 × 10¹¹.
    pub value: Decimal,
    /// Length of the number's text in bytes, with its sign.
    pub used: usize,
    /// Digits after the point, up to [`DECIMAL_PLACES`].
    pub places: u8,
}

/// Parses the decimal text (sign, digits, at most one point) at the start of `text`; `None` if there is no digit.
#[inline(never)]
pub fn read(text: &[u8], digits: Digits) -> Option<Number> {
    read_here(text, digits)
}

/// Does the same as [`read`], but is always inlined. For the words of G-code lines.
#[inline(always)]
pub fn read_here(text: &[u8], digits: Digits) -> Option<Number> {
    let negative = text.first() == Some(&b'-');
    let signs = usize::from(negative || text.first() == Some(&b'+'));
    let text = text.get(signs..).unwrap_or(&[]);
    let (value, used, places) = match read_short(text) {
        Some(short) => short,
        None => read_long(text, digits)?,
    };
    Some(Number { value: Decimal(if negative { -value } else { value }), used: signs + used, places })
}

/// Reads a number of the usual form: up to eight digits, at most seven of them after the point. Returns its value, the
/// bytes used and the digits after the point; `None` for all other numbers.
#[inline]
fn read_short(text: &[u8]) -> Option<(i64, usize, u8)> {
    let mut mantissa: u32 = 0;
    let mut used = 0;
    // Number of bytes up to and including the point; 0 as long as no point has been read.
    let mut point = 0;
    for &byte in text {
        used += 1;
        let digit = u32::from(byte).wrapping_sub(u32::from(b'0'));
        if digit < 10 {
            mantissa = mantissa.wrapping_mul(10).wrapping_add(digit);
        } else if byte == b'.' && point == 0 {
            point = used;
        } else {
            used -= 1;
            break;
        }
    }
    let digits = used - usize::from(point > 0);
    let fraction = if point > 0 { used - point } else { 0 };
    if digits == 0 || digits > EIGHT as usize {
        return None;
    }
    let power = POWERS.get((DECIMAL_PLACES as usize).checked_sub(fraction)?)?;
    Some((i64::from(mantissa) * i64::from(*power), used, fraction as u8))
}

/// Reads a number of any form. Returns its value, the bytes used and the digits after the point; `None` if there is no
/// digit.
#[inline(never)]
fn read_long(text: &[u8], digits: Digits) -> Option<(i64, usize, u8)> {
    let mut used = 0;
    let limit = match digits {
        Digits::Exact => u32::MAX,
        Digits::Eight => EIGHT,
    };
    let mut mantissa: u64 = 0;
    let mut count: u32 = 0;
    // `fraction`: number of digits of the mantissa after the point. `zeros`: number of digits dropped before the
    // point; each multiplies the mantissa by 10.
    let mut fraction: u32 = 0;
    let mut zeros: u32 = 0;
    let mut point = false;
    for &byte in text {
        match byte {
            b'0'..=b'9' => {
                let fits = count < limit && mantissa < ROOM_FOR_A_DIGIT;
                count = count.saturating_add(1);
                if fits && fraction < DECIMAL_PLACES {
                    mantissa = mantissa * 10 + u64::from(byte - b'0');
                    fraction += u32::from(point);
                } else if !point {
                    zeros = zeros.saturating_add(1);
                }
            }
            b'.' if !point => point = true,
            _ => break,
        }
        used += 1;
    }
    if count == 0 {
        return None;
    }
    Some((scaled(mantissa, fraction, zeros), used, fraction as u8))
}

/// Returns `mantissa` × 10^(`zeros` - `fraction`) as a raw [`Decimal`], saturated.
fn scaled(mantissa: u64, fraction: u32, zeros: u32) -> i64 {
    let places = DECIMAL_PLACES.saturating_sub(fraction).saturating_add(zeros);
    let magnitude = match 10_u64.checked_pow(places) {
        _ if mantissa == 0 => 0,
        Some(power) => mantissa.saturating_mul(power),
        None => u64::MAX,
    };
    i64::try_from(magnitude).unwrap_or(i64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::DECIMAL_ONE;
    use proptest::prelude::*;

    fn exact(text: &str) -> Option<(i64, usize)> {
        read(text.as_bytes(), Digits::Exact).map(|number| (number.value.0, number.used))
    }

    fn eight(text: &str) -> Option<(i64, usize)> {
        read(text.as_bytes(), Digits::Eight).map(|number| (number.value.0, number.used))
    }

    /// A table of the document with which the project began. The document keeps eight digits of a number.
    #[test]
    fn table_of_the_document() {
        for (text, value) in [
            ("12345678", 12_345_678 * DECIMAL_ONE),
            ("12345678901", 12_345_678_000 * DECIMAL_ONE),
            ("-12345678901", -12_345_678_000 * DECIMAL_ONE),
            ("-12345678", -12_345_678 * DECIMAL_ONE),
            ("123.45678", 1_234_567_800),
            ("-123.45678", -1_234_567_800),
            ("0.12345678", 1_234_567),
            ("-0.12345678", -1_234_567),
        ] {
            assert_eq!(eight(text), Some((value, text.len())), "{text}");
        }
    }

    #[test]
    fn the_same_table_exactly() {
        for (text, value) in [
            ("12345678", 12_345_678 * DECIMAL_ONE),
            ("12345678901", 12_345_678_901 * DECIMAL_ONE),
            ("-12345678901", -12_345_678_901 * DECIMAL_ONE),
            ("-12345678", -12_345_678 * DECIMAL_ONE),
            ("123.45678", 1_234_567_800),
            ("-123.45678", -1_234_567_800),
            ("0.12345678", 1_234_567),
            ("-0.12345678", -1_234_567),
        ] {
            assert_eq!(exact(text), Some((value, text.len())), "{text}");
        }
    }

    /// In the worked example of the document with which the project began, 123.456789 (nine digits) becomes 12345678
    /// with exponent -5.
    #[test]
    fn worked_example_of_the_document() {
        assert_eq!(eight("123.456789"), Some((1_234_567_800, 10)));
        assert_eq!(eight("123456789"), Some((1_234_567_800_000_000, 9)));
        assert_eq!(exact("123.456789"), Some((1_234_567_890, 10)));
    }

    #[test]
    fn shapes() {
        assert_eq!(exact("5"), Some((50_000_000, 1)));
        assert_eq!(exact("+.5X"), Some((5_000_000, 3)));
        assert_eq!(exact("-.5"), Some((-5_000_000, 3)));
        assert_eq!(exact("1."), Some((10_000_000, 2)));
        assert_eq!(exact("1..2"), Some((10_000_000, 2)));
        assert_eq!(exact("1.2.3"), Some((12_000_000, 3)));
        assert_eq!(exact("1E3"), Some((10_000_000, 1)));
        assert_eq!(exact("-0"), Some((0, 2)));
        assert_eq!(exact(".0000001"), Some((1, 8)));
        assert_eq!(exact(".00000019"), Some((1, 9)));
        for none in ["", "-", "+", ".", "-.", "--5", "+-5", "X", "-X5"] {
            assert_eq!(exact(none), None, "{none}");
            assert_eq!(eight(none), None, "{none}");
        }
    }

    #[test]
    fn far_values_saturate() {
        let nines = "9".repeat(5000);
        assert_eq!(exact(&nines), Some((i64::MAX, 5000)));
        assert_eq!(eight(&nines), Some((i64::MAX, 5000)));
        assert_eq!(exact(&format!("-{nines}")), Some((-i64::MAX, 5001)));
        let zeros = "0".repeat(5000);
        assert_eq!(exact(&format!("{zeros}1.5")), Some((15_000_000, 5003)));
        // Eight leading zeros use up all the digits that Grbl reads.
        assert_eq!(eight("00000000001"), Some((0, 11)));
        assert_eq!(eight(".123456789"), Some((1_234_567, 10)));
        assert_eq!(eight("-.123456789"), Some((-1_234_567, 11)));
    }

    proptest! {
        #[test]
        fn written_and_read_again(value in -i64::MAX..=i64::MAX) {
            let magnitude = value.unsigned_abs();
            let one = DECIMAL_ONE as u64;
            let sign = if value < 0 { "-" } else { "" };
            let text = format!("{sign}{}.{:07}", magnitude / one, magnitude % one);
            prop_assert_eq!(exact(&text), Some((value, text.len())));
        }

        #[test]
        fn eight_digits_are_a_prefix(value in 0..100_000_000_u64, places in 0..=7_usize) {
            let digits = format!("{value:08}");
            let (whole, fraction) = digits.split_at(8 - places);
            let text = format!("{whole}.{fraction}");
            prop_assert_eq!(eight(&text), exact(&text));
            let longer = format!("{text}99");
            prop_assert_eq!(eight(&longer).unwrap().0, exact(&text).unwrap().0);
        }
    }
}
