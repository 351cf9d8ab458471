//! The numbers of expressions: decimal floating point with 18 digits, rounded after each operation. Has arithmetic,
//! comparisons, roots, and series for sine, arc tangent, logarithm and exponential.
//!
//! * Sums, differences and products with results of up to 18 digits are exact: `10.1 + 0.2` is exactly 10.3.
//! * A sum or difference becomes 0 if it is smaller than 10⁻¹⁴ of the larger operand, because only a rounding error is
//!   left. Comparisons, whole parts and remainders subtract in this way, so 1/3 + 1/3 + 1/3 counts as equal to 1.
//! * Quotients and square roots are correct in 18 digits. Sine, cosine, arc tangent and logarithm are within 10⁻¹⁵,
//!   powers with a fractional exponent within a relative 10⁻¹³.
//! * All arithmetic is integer arithmetic: results are the same on every machine, and every operation takes a bounded
//!   number of steps.
//! * Results of 10⁴¹ and more are an error; results below 10⁻³² can become 0.
//!
//! Most functions are not inlined, because flash is scarce and expressions need not be fast.

use crate::error::Error;
use crate::units::{Coordinate, DECIMAL_PLACES, Decimal, integer_root};
use core::cmp::Ordering;

/// Maximum number of digits of a mantissa.
const DIGITS: u32 = 18;
/// Exclusive upper limit of a mantissa.
const MANTISSA_END: i64 = 1_000_000_000_000_000_000;
/// Number of zeros that an `i128` has room for after an 18-digit mantissa.
const SPARE_DIGITS: u32 = 20;
/// Highest power of ten that a number's first digit may stand for. A number of 10^41 or more is an error.
const EXPONENT_MAX: i32 = 40;
/// Minimum of [`Real::exponent`]; a number that would need a smaller exponent becomes 0.
const EXPONENT_MIN: i32 = -50;

/// A number: mantissa × 10^exponent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Real {
    /// At most 18 digits, without trailing zeros.
    mantissa: i64,
    exponent: i8,
}

/// Returns the remainder of a division. One of the operands must fit 64 bits; the remainder is no larger than either
/// operand, so it fits 64 bits too. Not inlined, because the code of an `i128` division takes a few KB on a 32-bit
/// processor.
#[inline(never)]
fn remainder(dividend: i128, divisor: i128) -> i64 {
    (dividend % divisor) as i64
}

impl Real {
    pub const ZERO: Real = Real::int(0);
    pub const ONE: Real = Real { mantissa: 1, exponent: 0 };

    /// Creates a whole number. Its last digit must not be 0, because mantissas have no trailing zeros; 0 itself is
    /// allowed.
    const fn int(mantissa: i64) -> Real {
        Real { mantissa, exponent: 0 }
    }

    pub const fn truth(holds: bool) -> Real {
        if holds { Real::ONE } else { Real::ZERO }
    }

    /// Returns `mantissa` × 10^`exponent`, rounded to 18 digits.
    pub fn new(mantissa: i128, exponent: i32) -> Result<Real, Error> {
        Self::rounded(mantissa, exponent, DIGITS)
    }

    /// Returns `mantissa` × 10^`exponent`, rounded to `digits` digits.
    #[inline(never)]
    fn rounded(mantissa: i128, exponent: i32, digits: u32) -> Result<Real, Error> {
        let size = mantissa.unsigned_abs();
        let end = 10_u128.pow(digits);
        let (mut power, mut exponent) = (1_u128, exponent);
        while size >= end.saturating_mul(power) {
            power *= 10;
            exponent += 1;
        }
        let size = if power == 1 { size } else { (size + power / 2) / power };
        // `size` is at most 10^18, so it fits `i64`.
        let mut size = size as i64;
        while size != 0 && size % 10 == 0 {
            size /= 10;
            exponent += 1;
        }
        match i8::try_from(exponent) {
            _ if size == 0 || exponent < EXPONENT_MIN => Ok(Real::ZERO),
            Ok(exponent) if i32::from(exponent) + size.ilog10() as i32 <= EXPONENT_MAX => {
                Ok(Real { mantissa: if mantissa < 0 { -size } else { size }, exponent })
            }
            _ => Err(Error::InvalidResult),
        }
    }

    /// Creates a number whose parts the caller knows to be in range, so that no error is possible.
    #[inline(never)]
    fn known(mantissa: i64, exponent: i32) -> Real {
        Self::new(i128::from(mantissa), exponent).unwrap_or(Real::ZERO)
    }

    /// Returns mantissa and exponent, as [`Real::from_parts`] takes them.
    pub fn parts(self) -> (i64, i8) {
        (self.mantissa, self.exponent)
    }

    /// Creates a number from the result of [`Real::parts`], without rounding or checks.
    pub fn from_parts(mantissa: i64, exponent: i8) -> Real {
        Real { mantissa, exponent }
    }

    /// Reads a number without a sign: digits and at most one decimal point. Digits after the eighteenth are dropped.
    /// Also returns the number of bytes read.
    pub fn read(text: &[u8]) -> Option<(Real, usize)> {
        let (mut mantissa, mut exponent, mut digits, mut used) = (0_i64, 0_i32, 0, 0);
        let mut point = false;
        for byte in text {
            match byte {
                b'0'..=b'9' => {
                    digits += 1;
                    if mantissa < MANTISSA_END / 10 {
                        mantissa = mantissa * 10 + i64::from(byte - b'0');
                        exponent -= i32::from(point);
                    } else {
                        exponent += i32::from(!point);
                    }
                }
                b'.' if !point => point = true,
                _ => break,
            }
            used += 1;
        }
        let number = Self::new(i128::from(mantissa), exponent).ok()?;
        (digits > 0).then_some((number, used))
    }

    pub fn from_decimal(value: Decimal) -> Real {
        Self::new(i128::from(value.0), -(DECIMAL_PLACES as i32)).unwrap_or(Real::ZERO)
    }

    pub fn from_coordinate(value: Coordinate) -> Real {
        Self::from_decimal(Decimal(value.0))
    }

    /// Converts an `f32`, rounded to seven digits. An `f32` is exact to about seven digits only; further digits would
    /// differ from the number in the program.
    pub fn from_f32(value: f32) -> Real {
        let Real { mantissa, exponent } = Self::from_coordinate(Coordinate::from_mm_f32(value));
        Self::rounded(i128::from(mantissa), exponent.into(), 7).unwrap_or(Real::ZERO)
    }

    pub fn fits_decimal(self) -> bool {
        self.to_decimal().0.unsigned_abs() < i64::MAX.unsigned_abs()
    }

    /// Converts to the nearest [`Decimal`]; numbers outside its range saturate.
    #[inline(never)]
    pub fn to_decimal(self) -> Decimal {
        let exponent = i32::from(self.exponent) + DECIMAL_PLACES as i32;
        let power = ten_to(exponent.unsigned_abs());
        let wide = i128::from(self.mantissa);
        let value = if exponent >= 0 { wide.saturating_mul(power) } else { divided(wide, power) };
        Decimal(i64::try_from(value).unwrap_or(if wide < 0 { -i64::MAX } else { i64::MAX }))
    }

    /// Returns how many decimal places this number has as a [`Decimal`].
    pub fn places(self) -> u8 {
        (-i32::from(self.exponent)).clamp(0, DECIMAL_PLACES as i32) as u8
    }

    /// Returns the whole number that differs from this one by less than 0.0001, if there is one.
    #[inline(never)]
    pub fn whole(self) -> Option<i64> {
        let nearest = self.round();
        let off = self.sub(nearest).ok()?;
        let value = nearest.to_decimal().0 / crate::units::DECIMAL_ONE;
        (off.abs().is_below(TOLERANCE) && Self::known(value, 0) == nearest).then_some(value)
    }

    pub fn is_zero(self) -> bool {
        self.mantissa == 0
    }

    pub fn is_negative(self) -> bool {
        self.mantissa < 0
    }

    pub fn is_below(self, other: Real) -> bool {
        self.order(other) == Ordering::Less
    }

    #[inline(never)]
    pub fn order(self, other: Real) -> Ordering {
        // The difference can overflow only if the signs are opposite. In this case the sign of `self` decides.
        self.sub(other).map_or(self.mantissa.cmp(&0), |off| off.mantissa.cmp(&0))
    }

    /// Returns whether two numbers differ by less than 0.0001, as LinuxCNC compares.
    pub fn is_near(self, other: Real) -> bool {
        self.sub(other).is_ok_and(|off| off.abs().is_below(TOLERANCE))
    }

    pub fn neg(self) -> Real {
        Real { mantissa: -self.mantissa, ..self }
    }

    pub fn abs(self) -> Real {
        Real { mantissa: self.mantissa.abs(), ..self }
    }

    #[inline(never)]
    pub fn add(self, other: Real) -> Result<Real, Error> {
        let (high, low) = if self.exponent >= other.exponent { (self, other) } else { (other, self) };
        if high.is_zero() {
            return Ok(low);
        }
        let gap = (i32::from(high.exponent) - i32::from(low.exponent)).unsigned_abs();
        let lift = gap.min(SPARE_DIGITS);
        let (wide, low) = (i128::from(high.mantissa) * ten_to(lift), i128::from(low.mantissa) / ten_to(gap - lift));
        let sum = wide + low;
        if sum.unsigned_abs() < wide.unsigned_abs().max(low.unsigned_abs()) / ROUNDING {
            return Ok(Real::ZERO);
        }
        Self::new(sum, i32::from(high.exponent) - lift as i32)
    }

    pub fn sub(self, other: Real) -> Result<Real, Error> {
        self.add(other.neg())
    }

    #[inline(never)]
    pub fn mul(self, other: Real) -> Result<Real, Error> {
        let product = i128::from(self.mantissa) * i128::from(other.mantissa);
        Self::new(product, i32::from(self.exponent) + i32::from(other.exponent))
    }

    #[inline(never)]
    pub fn div(self, other: Real) -> Result<Real, Error> {
        if other.is_zero() {
            return Err(Error::DivisionByZero);
        }
        let (wide, exponent) = self.lengthened();
        let quotient = wide / i128::from(other.mantissa);
        Self::new(quotient, exponent - i32::from(other.exponent))
    }

    /// Returns the mantissa extended to 38 digits, and its exponent.
    #[inline(never)]
    fn lengthened(self) -> (i128, i32) {
        let mut wide = i128::from(self.mantissa);
        let mut exponent = i32::from(self.exponent);
        while wide != 0 && wide.unsigned_abs() < ten_to(DIGITS + SPARE_DIGITS - 1).unsigned_abs() {
            wide *= 10;
            exponent -= 1;
        }
        (wide, exponent)
    }

    /// Returns the remainder of a division. It is at least 0 and less than the absolute value of the divisor.
    #[inline(never)]
    pub fn modulo(self, divisor: Real) -> Result<Real, Error> {
        if divisor.is_zero() {
            return Err(Error::DivisionByZero);
        }
        let gap = i32::from(self.exponent) - i32::from(divisor.exponent);
        let (rest, exponent) = if gap >= 0 {
            let mut rest = self.mantissa % divisor.mantissa;
            for _ in 0..gap {
                rest = remainder(i128::from(rest) * 10, i128::from(divisor.mantissa));
            }
            (rest, divisor.exponent)
        } else {
            let wide = i128::from(divisor.mantissa).saturating_mul(ten_to(gap.unsigned_abs()));
            (remainder(i128::from(self.mantissa), wide), self.exponent)
        };
        let rest = Self::known(rest, i32::from(exponent));
        let rest = if rest.is_negative() { rest.add(divisor.abs())? } else { rest };
        let none_is_left =
            self.order(self.sub(rest)?) == Ordering::Equal || rest.order(divisor.abs()) == Ordering::Equal;
        Ok(if none_is_left { Real::ZERO } else { rest })
    }

    /// Rounds down to a whole number. If the number differs from a whole number by no more than a rounding error,
    /// returns that whole number.
    #[inline(never)]
    pub fn floor(self) -> Real {
        let nearest = self.round();
        if self.order(nearest) == Ordering::Equal {
            return nearest;
        }
        self.whole_part(|wide, power| wide.div_euclid(power))
    }

    pub fn ceiling(self) -> Real {
        self.neg().floor().neg()
    }

    /// Rounds to the nearest whole number, halves away from zero.
    #[inline(never)]
    pub fn round(self) -> Real {
        self.whole_part(divided)
    }

    /// Rounds to the nearest whole number, halves to even.
    pub fn nearest_even(self) -> Real {
        let half = Real { mantissa: 5, exponent: -1 };
        let even = |number: Real| number.mul(half).is_ok_and(|part| part.floor() == part);
        match (self.add(half).map(Real::floor), self.sub(half)) {
            (Ok(up), Ok(down)) if up.sub(down) == Ok(Real::ONE) && !even(up) => down,
            (Ok(up), _) => up,
            _ => self,
        }
    }

    fn whole_part(self, divide: impl Fn(i128, i128) -> i128) -> Real {
        if self.exponent >= 0 {
            return self;
        }
        let power = ten_to(i32::from(self.exponent).unsigned_abs());
        Self::known(divide(i128::from(self.mantissa), power) as i64, 0)
    }

    #[inline(never)]
    pub fn sqrt(self) -> Result<Real, Error> {
        if self.is_negative() {
            return Err(Error::ArgumentOutOfRange);
        }
        let (mut wide, mut exponent) = self.lengthened();
        if exponent % 2 != 0 {
            wide /= 10;
            exponent += 1;
        }
        Self::new(integer_root(wide.unsigned_abs()) as i128, exponent / 2)
    }

    /// Raises `self` to a power. For a whole exponent, computes it by multiplication, so that squares are exact.
    pub fn power(self, exponent: Real) -> Result<Real, Error> {
        if exponent.floor() == exponent && exponent.abs().is_below(Self::int(i64::from(i32::MAX))) {
            let count = (exponent.to_decimal().0 / crate::units::DECIMAL_ONE) as i32;
            return match self.multiplied(count.unsigned_abs()) {
                power if count >= 0 => power,
                Ok(power) if !power.is_zero() || self.is_zero() => Real::ONE.div(power),
                Ok(_) => Err(Error::InvalidResult),
                Err(_) => Ok(Real::ZERO),
            };
        }
        match (self.mantissa.cmp(&0), exponent.is_negative()) {
            (Ordering::Less, _) => Err(Error::ArgumentOutOfRange),
            (Ordering::Equal, true) => Err(Error::DivisionByZero),
            (Ordering::Equal, false) => Ok(Real::ZERO),
            (Ordering::Greater, _) => self.ln()?.mul(exponent)?.exp(),
        }
    }

    #[inline(never)]
    fn multiplied(self, mut count: u32) -> Result<Real, Error> {
        let (mut square, mut product) = (self, Real::ONE);
        loop {
            if count & 1 != 0 {
                product = product.mul(square)?;
            }
            count >>= 1;
            if count == 0 {
                return Ok(product);
            }
            square = square.mul(square)?;
        }
    }
}

/// Two numbers that differ by less than this are equal for `EQ` and `NE`. A number that differs from a whole number by
/// less than this counts as whole.
const TOLERANCE: Real = Real { mantissa: 1, exponent: -4 };

/// A sum counts as 0 if it is smaller than its larger operand divided by this number.
const ROUNDING: u128 = 100_000_000_000_000;

/// Returns a power of ten; if it exceeds `i128`, the maximum of that type.
#[inline(never)]
fn ten_to(power: u32) -> i128 {
    10_i128.checked_pow(power).unwrap_or(i128::MAX)
}

/// Returns the nearest quotient, halves away from zero.
#[inline(never)]
fn divided(value: i128, divisor: i128) -> i128 {
    let half = if value < 0 { -(divisor / 2) } else { divisor / 2 };
    value.saturating_add(half) / divisor
}

// Sine, arc tangent, logarithm and exponential compute in binary fixed point. One unit is 2^-60, so 1.0 is 2^60 units.

const BITS: u32 = 60;
const UNIT: i64 = 1 << BITS;
const PI: i64 = 3_622_009_729_038_561_421;
const LN_2: i128 = 799_144_290_325_165_979;
const LN_10: i128 = 2_654_699_869_899_991_814;
const ROOT_OF_HALF: i64 = 815_238_614_083_298_888;
/// Number of terms after which every series here has converged.
const TERMS: i64 = 64;

/// Decimal places to which a function's result is rounded. Units of 2^-60 are finer than that; the rounding makes
/// `SIN[30]` exactly 0.5.
const PLACES: u32 = 16;
/// Decimal places of a result that is an angle in degrees.
const PLACES_OF_DEGREES: u32 = 14;

#[inline(never)]
fn times(a: i64, b: i64) -> i64 {
    ((i128::from(a) * i128::from(b)) >> BITS) as i64
}

#[inline(never)]
fn over(a: i64, b: i64) -> i64 {
    ((i128::from(a) << BITS) / i128::from(b)) as i64
}

/// Returns `first` × (1 - x²/(n(n+1)) + x⁴/(n(n+1)(n+2)(n+3)) - ...), where x is an angle in radians and `square` is
/// x². The result is the sine of x for `first` = x and `n` = 2, and the cosine of x for `first` = 1 and `n` = 1.
#[inline(never)]
fn sine_series(first: i64, square: i64, n: i64) -> i64 {
    let (mut term, mut sum) = (first, first);
    for k in 0..TERMS {
        let n = n + 2 * k;
        term = -times(term, square) / (n * (n + 1));
        sum += term;
        if term == 0 {
            break;
        }
    }
    sum
}

/// Returns x ± x³/3 + x⁵/5 ± ...: the arc tangent for `sign` = -1, the inverse hyperbolic tangent for 1. `x` is at most
/// 0.2.
#[inline(never)]
fn tangent_series(x: i64, sign: i64) -> i64 {
    let square = times(x, x) * sign;
    let (mut power, mut sum) = (x, x);
    for k in 1..TERMS {
        power = times(power, square);
        let term = power / (2 * k + 1);
        sum += term;
        if term == 0 {
            break;
        }
    }
    sum
}

impl Real {
    /// Converts to units of 2^-60. The absolute value of the number must be at most 2^60.
    #[inline(never)]
    fn to_fixed(self) -> i128 {
        let power = ten_to(i32::from(self.exponent).unsigned_abs());
        let wide = i128::from(self.mantissa);
        if self.exponent >= 0 { wide.saturating_mul(power).saturating_mul(1 << BITS) } else { (wide << BITS) / power }
    }

    /// Converts from units of 2^-60, rounded to `places` decimal places. The absolute value of the number must be below
    /// 2^10.
    #[inline(never)]
    fn from_fixed(value: i128, places: u32) -> Real {
        let wide = value * ten_to(places);
        Self::new((wide + (1 << (BITS - 1))) >> BITS, -(places as i32)).unwrap_or(Real::ZERO)
    }

    /// Returns the sine of an angle in degrees.
    pub fn sin(self) -> Result<Real, Error> {
        self.sine(0)
    }

    /// Returns the cosine of an angle in degrees.
    pub fn cos(self) -> Result<Real, Error> {
        self.sine(1)
    }

    /// Returns the sine of an angle: `self` in degrees, plus `quarters` times 90 degrees. Full turns are subtracted in
    /// decimal arithmetic, so large angles lose no accuracy.
    #[inline(never)]
    fn sine(self, quarters: u32) -> Result<Real, Error> {
        let right = Self::known(90, 0);
        let (mut rest, mut quarters) = (self.modulo(Self::known(360, 0))?, quarters);
        while !rest.is_below(right) {
            rest = rest.sub(right)?;
            quarters += 1;
        }
        let complement = Self::int(45).is_below(rest);
        if complement {
            rest = right.sub(rest)?;
        }
        let x = times(rest.div(Self::int(45))?.to_fixed() as i64, PI / 4);
        let square = times(x, x);
        let is_cosine = (quarters & 1 == 1) != complement;
        let value = if is_cosine { sine_series(UNIT, square, 1) } else { sine_series(x, square, 2) };
        let value = i128::from(value);
        Ok(Self::from_fixed(if quarters & 2 == 0 { value } else { -value }, PLACES))
    }

    pub fn tan(self) -> Result<Real, Error> {
        self.sin()?.div(self.cos()?).map_err(|_| Error::ArgumentOutOfRange)
    }

    /// Returns the direction of (x, y) in degrees, above -180 and up to 180; `self` is y.
    #[inline(never)]
    pub fn atan(self, x: Real) -> Result<Real, Error> {
        let (height, width) = (self.abs(), x.abs());
        let steep = width.is_below(height);
        let (small, large) = if steep { (width, height) } else { (height, width) };
        let mut angle = if small.is_zero() { Real::ZERO } else { slope(small.div(large)?) };
        if steep {
            angle = Self::known(90, 0).sub(angle)?;
        }
        if x.is_negative() {
            angle = Self::known(180, 0).sub(angle)?;
        }
        Ok(if self.is_negative() { angle.neg() } else { angle })
    }

    pub fn asin(self) -> Result<Real, Error> {
        self.atan(self.other_leg()?)
    }

    pub fn acos(self) -> Result<Real, Error> {
        self.other_leg()?.atan(self)
    }

    /// Returns √(1 - x²), where x is `self`; an error if the absolute value of x exceeds 1.
    #[inline(never)]
    fn other_leg(self) -> Result<Real, Error> {
        Real::ONE.sub(self)?.mul(Real::ONE.add(self)?)?.sqrt()
    }

    #[inline(never)]
    pub fn ln(self) -> Result<Real, Error> {
        if self.mantissa <= 0 {
            return Err(Error::ArgumentOutOfRange);
        }
        // Splits the mantissa into fraction × 2^binary, where the fraction is between √½ and √2.
        let zeros = self.mantissa.leading_zeros();
        let mut fraction = (self.mantissa << (zeros - 1)) >> (63 - BITS);
        let mut binary = i128::from(64 - zeros);
        if fraction < ROOT_OF_HALF {
            fraction *= 2;
            binary -= 1;
        }
        let of_fraction = 2 * tangent_series(over(fraction - UNIT, fraction + UNIT), 1);
        let sum = i128::from(of_fraction) + binary * LN_2 + i128::from(self.exponent) * LN_10;
        // The sum is wrong by up to 2^6 units of 2^-60, so the result is rounded to one decimal place less than in
        // other functions.
        Ok(Self::from_fixed(sum, PLACES - 1))
    }

    /// Returns e to the power of `self`.
    #[inline(never)]
    pub fn exp(self) -> Result<Real, Error> {
        if Self::known(100, 0).is_below(self) {
            return Err(Error::InvalidResult);
        }
        // Below -94 the result is less than 10^-40, so it becomes 0. The code below would fail there: from about -94.3
        // down, `scale` would be 2^137, which exceeds the maximum of a number (10^41).
        if self.is_below(Self::known(-94, 0)) {
            return Ok(Real::ZERO);
        }
        let wide = self.to_fixed();
        let binary = wide.div_euclid(LN_2);
        let rest = (wide - binary * LN_2) as i64;
        let (mut term, mut sum) = (UNIT, UNIT);
        for n in 1..TERMS {
            term = times(term, rest) / n;
            sum += term;
            if term == 0 {
                break;
            }
        }
        let scale = Self::int(2).multiplied(binary.unsigned_abs() as u32)?;
        let value = Self::from_fixed(i128::from(sum), PLACES);
        let value = if binary < 0 { value.div(scale)? } else { value.mul(scale)? };
        Self::rounded(i128::from(value.mantissa), i32::from(value.exponent), 14)
    }
}

/// Returns the angle, in degrees, of a slope from 0 to 1. (The slope is the tangent of the angle.) The series converges
/// faster for small angles, so the angle is halved twice first: if t is the slope of an angle, the slope of half the
/// angle is t / (1 + √(1 + t²)).
fn slope(slope: Real) -> Real {
    let mut t = slope.to_fixed() as i64;
    for _ in 0..2 {
        let square = UNIT + times(t, t);
        t = over(t, UNIT + integer_root((square as u128) << BITS) as i64);
    }
    let half_turns = over(tangent_series(t, -1), PI);
    Real::from_fixed(4 * 180 * i128::from(half_turns), PLACES_OF_DEGREES)
}
