//! Prints numbers without `core::fmt`, which would cost many KiB of flash. The digits are the same on every machine.

use crate::units::Coordinate;

/// Maximum length of a piece of text, in bytes: a status report of six axes with every field.
pub const PIECE: usize = 320;

/// A piece of text under construction. Excess bytes are cut off; [`PIECE`] is large enough for every text.
pub type Text = heapless::Vec<u8, PIECE>;

/// The end of every line sent to a host.
pub const END: &[u8] = b"\r\n";

/// Appends bytes, as far as there is room.
#[inline(never)]
pub fn put(out: &mut Text, bytes: &[u8]) {
    for byte in bytes {
        if out.push(*byte).is_err() {
            return;
        }
    }
}

/// Appends a whole number in decimal.
#[inline(never)]
pub fn whole(out: &mut Text, value: u64) {
    let mut digits = [0_u8; 20];
    let mut rest = value;
    let mut used = 0;
    for slot in digits.iter_mut().rev() {
        *slot = b'0' + (rest % 10) as u8;
        rest /= 10;
        used += 1;
        if rest == 0 {
            break;
        }
    }
    put(out, digits.get(digits.len() - used..).unwrap_or(&[]));
}

/// Appends `form` with each `%` replaced by the next of `texts`, and each `#` by the next of `numbers`.
#[inline(never)]
pub fn filled(out: &mut Text, form: &[u8], texts: &[&[u8]], numbers: &[u32]) {
    let (mut texts, mut numbers) = (texts.iter(), numbers.iter());
    for byte in form {
        match byte {
            b'%' => put(out, texts.next().copied().unwrap_or_default()),
            b'#' => whole(out, numbers.next().copied().unwrap_or_default().into()),
            byte => put(out, core::slice::from_ref(byte)),
        }
    }
}

/// Appends `value` / 10^`places` with `places` decimals, after a minus sign if `negative` (even before a zero).
pub fn fixed(out: &mut Text, negative: bool, value: u64, places: u32) {
    if negative {
        put(out, b"-");
    }
    let one = 10_u64.pow(places);
    whole(out, value / one);
    if places > 0 {
        put(out, b".");
        let mut fraction = value % one;
        let mut digit = one / 10;
        while digit > 0 {
            put(out, &[b'0' + (fraction / digit) as u8]);
            fraction %= digit;
            digit /= 10;
        }
    }
}

/// Appends a length: in mm with 3 decimals or in inches with 4, rounded to the nearest. A negative value that rounds to
/// zero keeps its sign, as in Grbl.
pub fn length(out: &mut Text, value: Coordinate, inches: bool) {
    let size = value.0.unsigned_abs();
    if inches {
        // In units of 0.1 nm, 0.0001 inch is 25,400.
        fixed(out, value.0 < 0, (size + 12_700) / 25_400, 4);
    } else {
        fixed(out, value.0 < 0, (size + 5_000) / 10_000, 3);
    }
}

/// Appends a non-negative real number, rounded half up. Scales by hundreds and tens in `f32` as Grbl does, so that
/// settings print with the same last digit.
#[inline(never)]
pub fn real(out: &mut Text, value: f32, places: u32) {
    // From 1000 up the whole part is not scaled: `f32` would lose the last digit, and the printed value would not be
    // read back unchanged.
    let whole = if value < 1000.0 { 0 } else { value as u64 };
    let mut scaled = value - whole as f32;
    let mut left = places;
    while left >= 2 {
        scaled *= 100.0;
        left -= 2;
    }
    if left == 1 {
        scaled *= 10.0;
    }
    fixed(out, false, whole.saturating_mul(10_u64.pow(places)).saturating_add((scaled + 0.5) as u64), places);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(make: impl FnOnce(&mut Text)) -> String {
        let mut out = Text::new();
        make(&mut out);
        String::from_utf8(out.to_vec()).unwrap()
    }

    #[test]
    fn lengths_round_to_nearest_and_keep_the_sign() {
        assert_eq!(text(|o| length(o, Coordinate(-4_900), false)), "-0.000");
        assert_eq!(text(|o| length(o, Coordinate(5_000), false)), "0.001");
        assert_eq!(text(|o| length(o, Coordinate::mm(-123), false)), "-123.000");
        assert_eq!(text(|o| length(o, Coordinate(254_000), true)), "0.0010");
        assert_eq!(text(|o| length(o, Coordinate::mm(1), true)), "0.0394");
    }

    #[test]
    fn numbers_of_any_size() {
        assert_eq!(text(|o| whole(o, 0)), "0");
        assert_eq!(text(|o| whole(o, u64::MAX)), "18446744073709551615");
        assert_eq!(text(|o| real(o, 0.002, 3)), "0.002");
        assert_eq!(text(|o| real(o, 123.4567, 3)), "123.457");
        assert_eq!(text(|o| real(o, 1000.0, 0)), "1000");
        assert_eq!(text(|o| real(o, 15.748, 1)), "15.7");
    }
}
