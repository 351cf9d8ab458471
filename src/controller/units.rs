//! The quantities the controller computes with, each a type of its own.
//!
//! Places are integers: [`Coordinate`] counts 0.1 nm (exact for seven decimals of a millimetre and for six of an inch),
//! steps count motor steps. The way from one to the other is integer arithmetic ([`StepsPerMm`]), so a million moves of
//! 0.001 mm end at exactly 1000 mm. Speeds and accelerations are `f32` in mm/s and mm/s²; mm/min exists only where
//! text is read or written.

/// Decimal places that a number of a program keeps.
pub const DECIMAL_PLACES: u32 = 7;
/// 10 to the power of [`DECIMAL_PLACES`].
pub const DECIMAL_ONE: i64 = 10_000_000;

/// A moment of the controller's clock, in microseconds since power-up.
pub type Instant = fugit::Instant<u64, 1, 1_000_000>;
/// A span of the controller's clock, in microseconds.
pub type Duration = fugit::Duration<u64, 1, 1_000_000>;

/// A number as a program writes it, in units of 10⁻⁷, without a physical unit yet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Decimal(pub i64);

impl Decimal {
    /// Zero.
    pub const ZERO: Decimal = Decimal(0);

    /// The decimal of a whole number.
    pub const fn from_int(value: i32) -> Decimal {
        Decimal(value as i64 * DECIMAL_ONE)
    }

    /// The nearest `f32`, computed with one exact conversion and one division, so equal on every machine.
    pub fn to_f32(self) -> f32 {
        // Apart, so that the wide integer is not rounded before it is divided: a printed setting reads back as itself.
        let (whole, rest) = (self.0 / DECIMAL_ONE, self.0 % DECIMAL_ONE);
        whole as f32 + rest as f32 / DECIMAL_ONE as f32
    }

    /// The whole part, cut towards zero, kept within `i32`.
    pub const fn truncate(self) -> i32 {
        let whole = self.0 / DECIMAL_ONE;
        if whole > i32::MAX as i64 {
            i32::MAX
        } else if whole < i32::MIN as i64 {
            i32::MIN
        } else {
            whole as i32
        }
    }
}

/// A place or a length along an axis, in units of 0.1 nm (10⁻⁷ mm).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Coordinate(pub i64);

impl Coordinate {
    /// The origin.
    pub const ZERO: Coordinate = Coordinate(0);
    /// Greatest distance from the origin that the controller computes with: 50 m. Farther targets are refused.
    pub const LIMIT: Coordinate = Coordinate(50_000 * DECIMAL_ONE);

    /// A length in millimetres as the program wrote it.
    pub const fn from_mm(value: Decimal) -> Coordinate {
        Coordinate(value.0)
    }

    /// A length in inches as the program wrote it (25.4 mm each; exact for six decimals, rounded to 0.1 nm beyond).
    pub const fn from_inches(value: Decimal) -> Coordinate {
        // 25.4 = 254 / 10; the half towards the sign rounds to nearest. Values are below 2^50 after range checks; wider
        // ones saturate far outside LIMIT.
        let wide = value.0.saturating_mul(254);
        let half = if wide < 0 { -5 } else { 5 };
        Coordinate(wide.saturating_add(half) / 10)
    }

    /// A length from whole millimetres.
    pub const fn mm(value: i32) -> Coordinate {
        Coordinate(value as i64 * DECIMAL_ONE)
    }

    /// The length in mm as the nearest `f32`.
    #[inline]
    pub fn to_mm(self) -> f32 {
        self.0 as f32 / DECIMAL_ONE as f32
    }

    /// The coordinate nearest to a length in mm.
    ///
    /// Beyond ±9 × 10¹¹ mm the result saturates.
    #[inline]
    pub fn from_mm_f32(mm: f32) -> Coordinate {
        let scaled = mm * DECIMAL_ONE as f32;
        Coordinate(if scaled < 0.0 { (scaled - 0.5) as i64 } else { (scaled + 0.5) as i64 })
    }

    /// The nearest place that the controller may compute with.
    pub fn limited(self) -> Coordinate {
        self.clamp(-Self::LIMIT, Self::LIMIT)
    }

    /// Whether the controller may compute with this place (see [`Coordinate::LIMIT`]).
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

/// How many motor steps make a millimetre: exactly the value of the `f32` setting, as mantissa × 2^-shift.
///
/// Only finite values above 0 and up to [`StepsPerMm::MAX`] exist; with the 24-bit mantissa and coordinates within
/// [`Coordinate::LIMIT`] (below 2^39) every product fits an `i64`, so both directions are exact before one rounding.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepsPerMm {
    mantissa: u32,
    shift: u32,
}

impl StepsPerMm {
    /// Greatest value that is taken.
    pub const MAX: f32 = 40_000.0;
    /// Least value that is taken.
    pub const MIN: f32 = 0.001;

    /// One step a millimetre.
    pub const ONE: StepsPerMm = StepsPerMm { mantissa: 1, shift: 0 };

    /// The exact fraction of a setting; `None` outside [`StepsPerMm::MIN`]..=[`StepsPerMm::MAX`].
    pub fn new(value: f32) -> Option<StepsPerMm> {
        if !(Self::MIN..=Self::MAX).contains(&value) {
            return None;
        }
        let bits = value.to_bits();
        // Normal numbers only (0.001 is far above the subnormals): value = (2^23 + fraction) × 2^(exponent - 150).
        let exponent = (bits >> 23) & 0xFF;
        let mut mantissa = (bits & 0x7F_FFFF) | 0x80_0000;
        let mut shift = 150_u32.saturating_sub(exponent);
        while mantissa & 1 == 0 && shift > 0 {
            mantissa >>= 1;
            shift -= 1;
        }
        Some(StepsPerMm { mantissa, shift })
    }

    /// The step nearest to a coordinate (a half goes away from zero).
    pub fn steps(self, coordinate: Coordinate) -> i32 {
        // |coordinate| < 2^39 and mantissa < 2^24. The divisor is 10^7 × 2^shift (shift <= 33: below 2^57).
        let product = coordinate.0.saturating_mul(i64::from(self.mantissa));
        let divisor = DECIMAL_ONE << self.shift;
        let half = divisor / 2;
        let rounded = if product < 0 { product.saturating_sub(half) } else { product.saturating_add(half) };
        let steps = rounded / divisor;
        steps.clamp(i64::from(i32::MIN), i64::from(i32::MAX)) as i32
    }

    /// The coordinate nearest to a step.
    pub fn coordinate(self, steps: i32) -> Coordinate {
        let numerator = i128::from(steps) * i128::from(DECIMAL_ONE << self.shift);
        let mantissa = i128::from(self.mantissa);
        let half = if steps < 0 { -(mantissa / 2) } else { mantissa / 2 };
        Coordinate(((numerator + half) / mantissa) as i64)
    }

    /// The value as `f32`: the setting it came from.
    pub fn to_f32(self) -> f32 {
        self.mantissa as f32 / (1_u64 << self.shift) as f32
    }
}

/// mm/min of a setting or a program to mm/s.
pub fn per_second(per_minute: f32) -> f32 {
    per_minute / 60.0
}

/// mm/s to mm/min for a report.
pub fn per_minute(per_second: f32) -> f32 {
    per_second * 60.0
}
