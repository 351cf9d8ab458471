//! The number of a G or M word as whole part and hundredths, rounded as Grbl does: G38.2 is 38 and 20.

use crate::units::{DECIMAL_ONE, Decimal, ones};

/// The number of a G or M word, split into two parts for the lookup: `G38.2` is 38 and 20.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Code {
    /// The whole part, modulo 256.
    pub whole: u8,
    /// The fraction in hundredths, rounded; [`Code::NO_CODE`] if the number is negative or its whole part exceeds 255.
    pub hundredths: u16,
}

impl Code {
    /// A fraction that no command has.
    pub const NO_CODE: u16 = u16::MAX;
    /// A hundredth in units of a [`Decimal`]: 100,000.
    const HUNDREDTH: u32 = (DECIMAL_ONE / 100) as u32;

    /// Returns the code of a number. Grbl keeps only the low byte of the whole part and takes everything else as the
    /// fraction. So `G256` is a G0 with an impossible fraction, while `G999` (low byte 231) is an unknown command. A
    /// host gets different error numbers for these two.
    pub fn of(value: Decimal) -> Code {
        let ones = ones(value.0.unsigned_abs());
        // The fraction is less than `DECIMAL_ONE` (10^7), so it fits `u32`.
        let rest = (value.0.unsigned_abs() - ones * DECIMAL_ONE as u64) as u32;
        let hundredths = (rest + Self::HUNDREDTH / 2) / Self::HUNDREDTH;
        let negative = value.0 < 0;
        let whole = if negative { (ones as i64).wrapping_neg() } else { ones as i64 };
        let hundredths = match u16::try_from(hundredths) {
            Ok(hundredths) if (0..256).contains(&whole) && !(negative && hundredths > 0) => hundredths,
            _ => Self::NO_CODE,
        };
        Code { whole: (whole & 0xFF) as u8, hundredths }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::number::{Digits, read};

    #[test]
    fn codes() {
        let code = |text: &str| Code::of(read(text.as_bytes(), Digits::Exact).unwrap().value);
        assert_eq!(code("38.2"), Code { whole: 38, hundredths: 20 });
        assert_eq!(code("92.10"), Code { whole: 92, hundredths: 10 });
        assert_eq!(code("92.001"), Code { whole: 92, hundredths: 0 });
        assert_eq!(code("1.999"), Code { whole: 1, hundredths: 100 });
        assert_eq!(code("256"), Code { whole: 0, hundredths: Code::NO_CODE });
        assert_eq!(code("999"), Code { whole: 231, hundredths: Code::NO_CODE });
        assert_eq!(code("-1"), Code { whole: 255, hundredths: Code::NO_CODE });
        assert_eq!(code("-0.5"), Code { whole: 0, hundredths: Code::NO_CODE });
        assert_eq!(code("-0"), Code { whole: 0, hundredths: 0 });
    }
}
