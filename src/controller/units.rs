//! The quantities with which the controller computes, each with its own type: positions, numbers of a program, steps
//! per millimetre, times, and control points of a curve.
//!
//! Positions are integers, so a million moves of 0.001 mm end at exactly 1000 mm. [`Coordinate`] counts 0.1 nm, which
//! is exact for seven decimals of a millimetre and six of an inch. [`StepsPerMm`] converts it to motor steps with
//! integers, too. Sums saturate. Speeds and accelerations are `f32` in mm/s and mm/s²; mm/min exists only where text
//! is read or written.

/// Decimal places that a number of a program keeps.
pub const DECIMAL_PLACES: u32 = 7;
/// 10 to the power of [`DECIMAL_PLACES`].
pub const DECIMAL_ONE: i64 = 10_000_000;

/// Returns `value` / [`DECIMAL_ONE`], rounded down. The processor of a board multiplies 32 by 32 bits in one
/// instruction, but has no instruction that divides more than 32 bits. So this code is five times as fast as a 64-bit
/// division.
pub(crate) const fn ones(value: u64) -> u64 {
    /// 5^7, the odd factor of 10^7 = 2^7 × 5^7.
    const ODD: u32 = 78_125;
    /// 2^48 / 5^7, rounded down.
    const INVERSE: u64 = (1 << 48) / ODD as u64;
    let halved = value >> 7;
    let high = halved >> 16;
    if high > u32::MAX as u64 {
        return value / DECIMAL_ONE as u64;
    }
    // The estimate is too small by less than three, because each of three roundings (of `INVERSE`, `high` and the
    // estimate) loses less than one.
    let estimate = (high * INVERSE) >> 32;
    let rest = (halved as u32).wrapping_sub((estimate as u32).wrapping_mul(ODD));
    estimate + (rest / ODD) as u64
}

/// Divides a 96-bit number (`words`, highest word first) by a divisor below 2^24, and returns the lowest 64 bits of
/// the quotient. Each step divides a whole word if the remainder so far is 0. Otherwise it divides a single byte,
/// because a remainder and a byte together fit into the 32 bits that the processor divides in one instruction.
fn quotient(words: [u32; 3], divisor: u32) -> u64 {
    let (mut quotient, mut rest) = (0, 0);
    for word in words {
        if rest == 0 {
            quotient = quotient << 32 | u64::from(word / divisor);
            rest = word % divisor;
            continue;
        }
        for byte in word.to_be_bytes() {
            let part = rest << 8 | u32::from(byte);
            quotient = quotient << 8 | u64::from(part / divisor);
            rest = part % divisor;
        }
    }
    quotient
}

/// Returns the square root of `square`, rounded down. Not inlined, because the code is long.
#[inline(never)]
pub(crate) fn integer_root(square: u128) -> u128 {
    square.isqrt()
}

/// Returns the nearest `f32`. A value that fits into 32 bits is converted in one instruction, with the same result.
#[inline]
pub(crate) fn wide_to_f32(value: i64) -> f32 {
    // Not inlined, because otherwise the compiler merges both conversions into one wide conversion.
    #[inline(never)]
    fn far(value: i64) -> f32 {
        value as f32
    }
    match i32::try_from(value) {
        Ok(near) => near as f32,
        Err(_) => far(value),
    }
}

/// A time of the controller's clock, in microseconds since power-up.
pub type Instant = fugit::Instant<u64, 1, 1_000_000>;
/// A length of time, in microseconds.
pub type Duration = fugit::Duration<u64, 1, 1_000_000>;

/// A number as a program writes it, in units of 10⁻⁷, without a physical unit yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Decimal(pub i64);

impl Decimal {
    /// Zero.
    pub const ZERO: Decimal = Decimal(0);

    /// Returns the decimal of a whole number.
    pub const fn from_int(value: i32) -> Decimal {
        Decimal(value as i64 * DECIMAL_ONE)
    }

    /// Returns the number as an `f32`. The result is the same on every processor: each part is converted on its own,
    /// and the decimals need one division.
    #[inline]
    pub fn to_f32(self) -> f32 {
        // Whole part and decimals are converted separately, so that the wide integer is not rounded before the
        // division. Otherwise a printed setting could be read back as another value.
        let size = self.0.unsigned_abs();
        let whole = ones(size);
        let rest = (size as u32).wrapping_sub((whole as u32).wrapping_mul(DECIMAL_ONE as u32));
        let mut size = wide_to_f32(whole as i64);
        if rest > 0 {
            size += rest as f32 / DECIMAL_ONE as f32;
        }
        if self.0 < 0 { -size } else { size }
    }

    /// Returns the whole part, rounded towards zero and saturated to `i32`.
    pub const fn truncate(self) -> i32 {
        let whole = ones(self.0.unsigned_abs());
        let whole = if whole > i32::MAX as u64 { i32::MAX } else { whole as i32 };
        match (self.0 < 0, whole) {
            (false, _) => whole,
            (true, i32::MAX) if self.0 / DECIMAL_ONE < -(i32::MAX as i64) => i32::MIN,
            (true, _) => -whole,
        }
    }
}

/// A position or a length along an axis, in units of 0.1 nm (10⁻⁷ mm).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Coordinate(pub i64);

impl Coordinate {
    /// The origin.
    pub const ZERO: Coordinate = Coordinate(0);
    /// Maximum distance from the origin that the controller computes with: 50 m. Targets beyond it are refused.
    pub const LIMIT: Coordinate = Coordinate(50_000 * DECIMAL_ONE);

    /// Converts a length in millimetres, as a program writes it.
    pub const fn from_mm(value: Decimal) -> Coordinate {
        Coordinate(value.0)
    }

    /// Converts a length in inches (25.4 mm each), as a program writes it. Exact for up to six decimals; further
    /// decimals are rounded to 0.1 nm.
    pub const fn from_inches(value: Decimal) -> Coordinate {
        // 25.4 = 254 / 10. Adding a half with the sign of the value rounds to nearest. Values are below 2^50 after
        // range checks; wider ones saturate far outside LIMIT.
        let wide = value.0.saturating_mul(254);
        let half = if wide < 0 { -5 } else { 5 };
        Coordinate(wide.saturating_add(half) / 10)
    }

    /// Converts whole millimetres.
    pub const fn mm(value: i32) -> Coordinate {
        Coordinate(value as i64 * DECIMAL_ONE)
    }

    /// Returns whole micrometres, rounded towards zero; correct within ±2 km.
    pub fn micrometres(self) -> i32 {
        let size = self.0.unsigned_abs();
        let whole = quotient([0, (size >> 32) as u32, size as u32], 10_000) as i32;
        if self.0 < 0 { whole.wrapping_neg() } else { whole }
    }

    /// Returns the length in mm, rounded to `f32` (seven digits).
    #[inline]
    pub fn to_mm(self) -> f32 {
        wide_to_f32(self.0) / DECIMAL_ONE as f32
    }

    /// Converts a length in mm, rounded to 0.1 nm.
    ///
    /// Beyond ±9 × 10¹¹ mm the result saturates.
    #[inline]
    pub fn from_mm_f32(mm: f32) -> Coordinate {
        let scaled = mm * DECIMAL_ONE as f32;
        Coordinate(if scaled < 0.0 { (scaled - 0.5) as i64 } else { (scaled + 0.5) as i64 })
    }

    /// Returns the nearest coordinate within ±[`Coordinate::LIMIT`].
    pub fn limited(self) -> Coordinate {
        self.clamp(-Self::LIMIT, Self::LIMIT)
    }

    /// Returns whether the coordinate is within ±[`Coordinate::LIMIT`].
    pub const fn in_range(self) -> bool {
        self.0 <= Self::LIMIT.0 && self.0 >= -Self::LIMIT.0
    }
}

impl core::ops::Add for Coordinate {
    type Output = Coordinate;
    fn add(self, other: Coordinate) -> Coordinate {
        Coordinate(self.0.saturating_add(other.0))
    }
}

impl core::ops::Sub for Coordinate {
    type Output = Coordinate;
    fn sub(self, other: Coordinate) -> Coordinate {
        Coordinate(self.0.saturating_sub(other.0))
    }
}

impl core::ops::Neg for Coordinate {
    type Output = Coordinate;
    fn neg(self) -> Coordinate {
        Coordinate(self.0.saturating_neg())
    }
}

/// Returns `size` × `mantissa` + `half`, saturated. Only for coordinates of 2^39 (55 m) or more, beyond the 50 m with
/// which the controller computes.
#[inline(never)]
fn far_product(size: u64, mantissa: u32, half: u64) -> u64 {
    let product = size.saturating_mul(u64::from(mantissa)).min(i64::MAX as u64);
    product.saturating_add(half).min(i64::MAX as u64)
}

/// Motor steps per millimetre: the exact value of the `f32` setting, as mantissa × 2^-shift. 2.5 steps/mm has mantissa
/// 5 and shift 1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepsPerMm {
    mantissa: u32,
    shift: u32,
}

impl StepsPerMm {
    /// Maximum accepted value, steps/mm.
    pub const MAX: f32 = 40_000.0;
    /// Minimum accepted value, steps/mm.
    pub const MIN: f32 = 0.001;

    /// One step per millimetre.
    pub const ONE: StepsPerMm = StepsPerMm { mantissa: 1, shift: 0 };

    /// Returns the value of a setting (steps/mm) as an exact fraction; `None` outside
    /// [`StepsPerMm::MIN`]..=[`StepsPerMm::MAX`].
    pub fn new(value: f32) -> Option<StepsPerMm> {
        if !(Self::MIN..=Self::MAX).contains(&value) {
            return None;
        }
        let bits = value.to_bits();
        // The value is a normal number, because 0.001 is far above the subnormals. So value = (2^23 + fraction) ×
        // 2^(exponent - 150).
        let exponent = (bits >> 23) & 0xFF;
        let mut mantissa = (bits & 0x7F_FFFF) | 0x80_0000;
        let mut shift = 150_u32.saturating_sub(exponent);
        while mantissa & 1 == 0 && shift > 0 {
            mantissa >>= 1;
            shift -= 1;
        }
        Some(StepsPerMm { mantissa, shift })
    }

    /// Returns the step nearest to a coordinate (halves round away from zero).
    #[inline]
    pub fn steps(self, coordinate: Coordinate) -> i32 {
        // In the first branch |coordinate| < 2^39 and mantissa < 2^24. The divisor is 10^7 × 2^shift, below 2^57
        // because shift <= 33. Shifting before the division by 10^7 does not change the quotient: the bits that are
        // shifted out affect neither the quotient nor its rounding.
        const HALF: u64 = DECIMAL_ONE as u64 / 2;
        let size = coordinate.0.unsigned_abs();
        let rounded = if size >> 39 == 0 {
            (size.wrapping_mul(u64::from(self.mantissa)) >> self.shift).wrapping_add(HALF)
        } else {
            far_product(size, self.mantissa, HALF << self.shift) >> self.shift
        };
        let steps = ones(rounded);
        match (coordinate.0 < 0, i32::try_from(steps)) {
            (false, steps) => steps.unwrap_or(i32::MAX),
            (true, Ok(steps)) => -steps,
            (true, Err(_)) => i32::MIN,
        }
    }

    /// Returns how far a coordinate is beyond its nearest step `steps`, rounded to sevenths of a step: -3 to 3.
    pub fn sevenths_beyond(self, coordinate: Coordinate, steps: i32) -> i32 {
        /// One step in the unit of `rest`.
        const STEP: i32 = DECIMAL_ONE as i32;
        // Both products can overflow, but the wrapping difference between them is right. It is at most half a step:
        // below 2^56 before the shift, at most 10^7 / 2 after it.
        let product = coordinate.0.wrapping_mul(i64::from(self.mantissa));
        let whole = i64::from(steps).wrapping_mul(DECIMAL_ONE << self.shift);
        let rest = (product.wrapping_sub(whole) >> self.shift) as i32;
        ((rest.clamp(-STEP / 2, STEP / 2) * 7 + 7 * STEP / 2) / STEP - 3).min(3)
    }

    /// Returns the coordinate nearest to a step.
    // Not inlined, because each caller converts all axes and would contain the code several times.
    #[inline(never)]
    pub fn coordinate(self, steps: i32) -> Coordinate {
        // The product |steps| × 10^7 × 2^shift has at most 88 bits: |steps| <= 2^31, and the other factor is below
        // 2^57.
        let (size, one) = (u64::from(steps.unsigned_abs()), (DECIMAL_ONE as u64) << self.shift);
        let low = size * u64::from(one as u32) + u64::from(self.mantissa / 2);
        let high = size * (one >> 32) + (low >> 32);
        let place = quotient([(high >> 32) as u32, high as u32, low as u32], self.mantissa) as i64;
        Coordinate(if steps < 0 { place.wrapping_neg() } else { place })
    }

    /// Returns the `f32` setting from which the value was made.
    pub fn to_f32(self) -> f32 {
        self.mantissa as f32 / (1_u64 << self.shift) as f32
    }
}

/// Converts mm/min of a setting or a program to mm/s.
pub fn per_second(per_minute: f32) -> f32 {
    per_minute / 60.0
}

/// Converts mm/s to mm/min for a report.
pub fn per_minute(per_second: f32) -> f32 {
    per_second * 60.0
}

/// A control point of a curve, in X and Y of the machine.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WeightedPoint {
    /// Machine coordinates X and Y.
    pub place: [Coordinate; 2],
    /// Weight of the point, above 0: a higher weight pulls the curve closer to the point.
    pub weight: f32,
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the step nearest to a coordinate, computed by the division that the fast code replaces.
    fn divided(scale: StepsPerMm, coordinate: Coordinate) -> i32 {
        let product = coordinate.0.saturating_mul(i64::from(scale.mantissa));
        let divisor = DECIMAL_ONE << scale.shift;
        let half = divisor / 2;
        let rounded = if product < 0 { product.saturating_sub(half) } else { product.saturating_add(half) };
        (rounded / divisor).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    proptest! {
        #[test]
        fn ones_are_the_quotient(value: u64, bits in 0_u32..64) {
            for value in [value >> bits, (value >> bits) / 10_000_000 * 10_000_000] {
                for value in [value.saturating_sub(1), value, value.saturating_add(1)] {
                    prop_assert_eq!(ones(value), value / 10_000_000);
                }
            }
        }

        #[test]
        fn places_are_those_of_the_division(steps: i32, bits in 0_u32..32, scale in 0.001_f32..40_000.0, fine in 0.001_f32..2.0) {
            for scale in [scale, fine, scale.trunc().max(1.0), 80.0, StepsPerMm::MIN, StepsPerMm::MAX] {
                let scale = StepsPerMm::new(scale).unwrap();
                for steps in [steps, steps >> bits, 0, 1, -1, i32::MAX, i32::MIN] {
                    let one = i128::from(steps) * (i128::from(DECIMAL_ONE) << scale.shift);
                    let mantissa = i128::from(scale.mantissa);
                    let half = if steps < 0 { -(mantissa / 2) } else { mantissa / 2 };
                    prop_assert_eq!(scale.coordinate(steps).0, ((one + half) / mantissa) as i64);
                }
            }
        }

        #[test]
        fn micrometres_are_towards_zero(place: i64, bits in 20_u32..64) {
            let place = place >> bits;
            prop_assert_eq!(i64::from(Coordinate(place).micrometres()), place / 10_000);
        }

        #[test]
        fn steps_are_those_of_the_division(place: i64, bits in 0_u32..40, scale in 0.001_f32..40_000.0, fine in 0.001_f32..2.0) {
            for scale in [scale, fine, scale.trunc().max(1.0)] {
                let scale = StepsPerMm::new(scale).unwrap();
                let coordinate = Coordinate(place >> (24 + bits % 40));
                prop_assert_eq!(scale.steps(coordinate), divided(scale, coordinate));
                prop_assert_eq!(scale.steps(Coordinate(place)), divided(scale, Coordinate(place)));
                // Coordinates around the middle between two steps, where the nearest step changes.
                let near = scale.coordinate(scale.steps(coordinate));
                for off in -2..=2 {
                    let half = Coordinate(near.0 + (5.0e6 / f64::from(scale.to_f32())) as i64 + off);
                    prop_assert_eq!(scale.steps(half), divided(scale, half));
                }
            }
        }

        #[test]
        fn sevenths_are_the_nearest(place: i64, bits in 24_u32..62, scale in 0.001_f32..40_000.0, fine in 0.001_f32..2.0) {
            for scale in [scale, fine, 80.0, 640.0] {
                let scale = StepsPerMm::new(scale).unwrap();
                let near = scale.coordinate(scale.steps(Coordinate(place >> bits)));
                for off in [0.0, 0.07, 0.08, -0.07, -0.08, 0.2, -0.3, 0.42, 0.43, -0.42, 0.499, -0.499] {
                    let coordinate = Coordinate(near.0 + (off * 1.0e7 / f64::from(scale.to_f32())) as i64);
                    let steps = scale.steps(coordinate);
                    let sevenths = scale.sevenths_beyond(coordinate, steps);
                    // `error` is the exact number of sevenths minus `sevenths`. All terms are multiplied by `step`, so
                    // that they are whole.
                    let step = i128::from(DECIMAL_ONE) << scale.shift;
                    let beyond = i128::from(coordinate.0) * i128::from(scale.mantissa) - i128::from(steps) * step;
                    let error = 7 * beyond - i128::from(sevenths) * step;
                    // The error is at most half a seventh of a step plus a ten-millionth of a step.
                    prop_assert!(2 * error.abs() <= step + 14 * (1 << scale.shift), "{sevenths} for {coordinate:?} at {scale:?}");
                    prop_assert!(sevenths.abs() <= 3);
                    prop_assert_eq!(scale.sevenths_beyond(scale.coordinate(steps), steps), 0);
                }
            }
        }

        #[test]
        fn an_f32_as_by_division(value: i64, bits in 0_u32..63) {
            let value = value >> bits;
            let (whole, rest) = (value / DECIMAL_ONE, value % DECIMAL_ONE);
            prop_assert_eq!(Decimal(value).to_f32(), whole as f32 + rest as f32 / DECIMAL_ONE as f32);
        }

        #[test]
        fn truncated_as_by_division(value: i64, bits in 0_u32..63) {
            let value = value >> bits;
            let whole = (value / DECIMAL_ONE).clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32;
            prop_assert_eq!(Decimal(value).truncate(), whole);
        }
    }
}
