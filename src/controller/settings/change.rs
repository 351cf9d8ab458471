//! Sets a setting (`$n=v`): checks the value against the range in the settings table. A refused value gets an error
//! that gives the reason. Soft limits depend on homing: Grbl's dialect refuses `$20=1` while homing is off, and `$22=0`
//! switches soft limits off in every dialect.

use super::index::Index;
use super::row::Kind;
use super::table::{Key, PARKING_PLACE, SOFT_LIMITS};
use super::values::{Settings, axes_mask};
use crate::axes::LINEAR;
use crate::error::Error;
use crate::units::{DECIMAL_ONE, Decimal};

const HOMING: u16 = Key::Homing.number();

impl<const N: usize> Settings<N> {
    /// Returns how many axes have settings: in Grbl's dialect at most three, otherwise all axes for which the board
    /// has motors. An axis that `$930` does not put in use counts too, because a sender may restore the settings of A
    /// before `$930`.
    fn axes_to_set(&self) -> usize {
        if N <= LINEAR || self.value(Key::Dialect) == 0.0 { N.min(LINEAR) } else { self.axes_with_motors() }
    }

    /// Returns the value that `$number=value` would set: checked, and without a fraction if the setting is a whole
    /// number.
    ///
    /// # Errors
    /// * [`Error::NegativeValue`]: below zero (only the parking place `$58` may be negative);
    /// * [`Error::InvalidStatement`]: the number does not exist;
    /// * [`Error::SettingOutOfRange`]: out of range, or with a fraction where only whole numbers are allowed; in Grbl's
    ///   dialect [`Error::InvalidStatement`] for a value out of range;
    /// * [`Error::StepPulseTooShort`]: `$0` out of range; [`Error::InvalidStatement`]: `$0` in range but no multiple of
    ///   0.1 µs, outside Grbl's dialect;
    /// * [`Error::SoftLimitNeedsHoming`]: `$20=1` without `$22`, in Grbl's dialect.
    pub fn accepted(&self, number: u16, value: Decimal) -> Result<f32, Error> {
        self.placed(number, value).map(|(_, value)| value)
    }

    /// Checks and sets `$number=value`. A refused value changes nothing.
    ///
    /// # Errors
    /// Those of [`Settings::accepted`].
    pub fn set(&mut self, number: u16, value: Decimal) -> Result<(), Error> {
        let (index, value) = self.placed(number, value)?;
        self.put(index, value);
        if number == HOMING && value == 0.0 {
            // Soft limits need a homed position, so `$22=0` switches them off too.
            self.put(Index::Scalar(Key::SoftLimits as usize), 0.0);
        }
        Ok(())
    }

    /// Checks `$number=value`. Returns the index of the setting and the value to be set.
    fn placed(&self, number: u16, value: Decimal) -> Result<(Index, f32), Error> {
        let negative = value < Decimal::ZERO;
        if negative && number != PARKING_PLACE {
            return Err(Error::NegativeValue);
        }
        let index = Index::of_number(number, N).ok_or(Error::InvalidStatement)?;
        if matches!(index, Index::PerAxis(_, axis) if axis.index() >= self.axes_to_set()) {
            return Err(Error::InvalidStatement);
        }
        let (entry, _) = index.row().ok_or(Error::InvalidStatement)?;
        let value = self.checked(entry.kind, value)?;
        // Other dialects accept `$20=1` without homing, so that a sender can restore settings in any order. They lock
        // motion until homing is on.
        let grbl = self.value(Key::Dialect) == 0.0;
        if number == SOFT_LIMITS && value != 0.0 && !self.is_on(Key::Homing) && grbl {
            return Err(Error::SoftLimitNeedsHoming);
        }
        Ok((index, value))
    }

    /// Checks a value against the range of its kind. For kinds without a fraction, Grbl's dialect drops the fraction of
    /// the value; the other dialects refuse a value with a fraction.
    fn checked(&self, kind: Kind, value: Decimal) -> Result<f32, Error> {
        let (whole, grbl) = (value.truncate(), self.value(Key::Dialect) == 0.0);
        let value = match kind {
            Kind::Tenths(..) => return self.tenths(kind, value),
            Kind::Switch if grbl && (1..=255).contains(&whole) => 1.0,
            Kind::Real | Kind::Speed | Kind::Place => value.to_f32(),
            _ if !grbl && value.0 % DECIMAL_ONE != 0 => return Err(Error::SettingOutOfRange),
            _ => whole as f32,
        };
        match kind.can_be(value, axes_mask(self.axes_to_set())) {
            true => Ok(value),
            false if grbl => Err(Error::InvalidStatement),
            false => Err(Error::SettingOutOfRange),
        }
    }

    /// Checks the length of the step pulse (`$0`), and returns it in microseconds as a multiple of 0.1. Grbl's dialect
    /// truncates to whole microseconds and refuses less than 3 us. The other dialects refuse a value that is no
    /// multiple of 0.1.
    fn tenths(&self, kind: Kind, value: Decimal) -> Result<f32, Error> {
        /// 0.1 as a raw [`Decimal`]. The longest pulse, 2550 tenths, fits into 32 bits in this form.
        const TENTH: u32 = (DECIMAL_ONE / 10) as u32;
        let Ok(value) = u32::try_from(value.0) else { return Err(Error::StepPulseTooShort) };
        let (mut tenths, rest) = (value / TENTH, value % TENTH);
        let is_grbl = self.value(Key::Dialect) == 0.0;
        if is_grbl {
            tenths -= tenths % 10;
        }
        let pulse = tenths as f32 / 10.0;
        if !kind.can_be(pulse, 0) || (is_grbl && tenths < 30) {
            return Err(Error::StepPulseTooShort);
        }
        if rest != 0 && !is_grbl { Err(Error::InvalidStatement) } else { Ok(pulse) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::axes::PerAxis;
    use crate::settings::table::{AxisKey, SCALARS};

    fn set(settings: &mut Settings<3>, number: u16, thousandths: i64) -> Result<(), Error> {
        settings.set(number, Decimal(thousandths * 10_000))
    }

    #[test]
    fn values_are_checked_before_they_are_taken() {
        let mut s = Settings::<3>::default();
        assert_eq!(set(&mut s, 0, 0), Err(Error::StepPulseTooShort));
        assert_eq!(set(&mut s, 0, 256_000), Err(Error::StepPulseTooShort));
        assert_eq!(set(&mut s, 1, 300_000), Err(Error::SettingOutOfRange));
        assert_eq!(set(&mut s, 103, 1_000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 7, 1_000), Err(Error::InvalidStatement));
        assert_eq!(set(&mut s, 11, -1), Err(Error::NegativeValue));
        assert_eq!(s, Settings::default());
        assert_eq!(set(&mut s, 102, 80_500), Ok(()));
        assert_eq!(s.axes(AxisKey::Resolution), PerAxis([250.0, 250.0, 80.5]));
        assert_eq!(s.by_number(102), Some(80.5));
    }

    /// Only Grbl's dialect truncates fractions; the others refuse them. A switch is 0 or 1, but in Grbl's dialect any
    /// whole number from 1 to 255 counts as 1.
    #[test]
    fn whole_numbers_have_no_fraction_and_switches_are_0_or_1() {
        for (number, thousandths, taken, in_grbl) in [
            (1, 25_500, None, Some(25.0)),
            (1, 25_000, Some(25.0), Some(25.0)),
            (904, 500, None, Some(0.0)),
            (23, 3900, None, Some(3.0)),
            (21, 1000, Some(1.0), Some(1.0)),
            (21, 0, Some(0.0), Some(0.0)),
            (21, 2000, None, Some(1.0)),
            (21, 3000, None, Some(1.0)),
            (21, 255_900, None, Some(1.0)),
            (21, 256_000, None, None),
            (21, 900, None, Some(0.0)),
            (21, 1001, None, Some(1.0)),
            (23, 255_000, Some(255.0), Some(255.0)),
            (23, 256_000, None, None),
            (44, 8000, None, None),
        ] {
            for (dialect, taken, refused) in [
                (0, in_grbl, Error::InvalidStatement),
                (1_000, taken, Error::SettingOutOfRange),
                (2_000, taken, Error::SettingOutOfRange),
                (3_000, taken, Error::SettingOutOfRange),
            ]
            .into_iter()
            .take(if crate::image::FULL_IMAGE { 4 } else { 3 })
            {
                let mut s = Settings::<3>::default();
                set(&mut s, 900, dialect).unwrap();
                let before = s.by_number(number);
                let result = set(&mut s, number, thousandths);
                assert_eq!(result, taken.map_or(Err(refused), |_| Ok(())), "${number}={thousandths}, $900={dialect}");
                assert_eq!(s.by_number(number), taken.or(before), "${number}={thousandths}, $900={dialect}");
            }
        }
    }

    #[test]
    fn no_switch_takes_a_third_value() {
        let switches = SCALARS.iter().filter(|entry| entry.kind == Kind::Switch);
        for entry in switches {
            let mut s = Settings::<3>::default();
            let results = [0, 1, 2, 3, 79, 255].map(|value| set(&mut s, entry.number, value * 1000));
            assert_eq!(results[..2], [Ok(()), Ok(())], "${}", entry.number);
            assert!(results[2..].iter().all(|result| *result == Err(Error::SettingOutOfRange)), "${}", entry.number);
        }
    }

    /// `$0` can be set to each tenth of a microsecond, and is not rounded. Values between tenths are refused, as are
    /// pulses that no board can make.
    #[test]
    fn a_step_pulse_is_taken_to_the_tenth_or_not_at_all() {
        let mut s = Settings::<3>::default();
        for tenths in 5..=2550_u16 {
            assert_eq!(set(&mut s, 0, i64::from(tenths) * 100), Ok(()));
            assert_eq!(s.step_pulse_tenths(), tenths);
            // The value survives being stored and restored.
            let mut other = Settings::<3>::default();
            other.restore(0, f32::from_le_bytes(s.by_number(0).unwrap().to_le_bytes()));
            assert_eq!(other.step_pulse_tenths(), tenths);
        }
        for (thousandths, error) in [
            (2_550, Error::InvalidStatement),
            (501, Error::InvalidStatement),
            (499, Error::StepPulseTooShort),
            (255_100, Error::StepPulseTooShort),
            (i64::MAX / 10_000, Error::StepPulseTooShort),
        ] {
            assert_eq!(set(&mut s, 0, thousandths), Err(error), "{thousandths}");
        }
        assert_eq!(s.step_pulse_tenths(), 2550);
        // Grbl's dialect has whole microseconds, and truncates as Grbl does.
        set(&mut s, 900, 0).unwrap();
        for (thousandths, tenths) in
            [(3_000, Some(30)), (3_999, Some(30)), (255_900, Some(2550)), (2_999, None), (256_000, None)]
        {
            let taken = set(&mut s, 0, thousandths);
            assert_eq!(taken, tenths.map_or(Err(Error::StepPulseTooShort), |_| Ok(())), "{thousandths}");
            assert!(tenths.is_none_or(|tenths| s.step_pulse_tenths() == tenths), "{thousandths}");
        }
    }

    #[test]
    fn masks_take_their_bits_only() {
        let mut s = Settings::<3>::default();
        for (number, mask, taken) in [(14, 256 + 64 + 8, true), (14, 16, false), (18, 127, true), (908, 128, false)] {
            assert_eq!(set(&mut s, number, mask * 1000).is_ok(), taken, "${number}={mask}");
        }
    }

    #[test]
    fn soft_limits_live_and_die_with_homing() {
        let mut s = Settings::<3>::default();
        set(&mut s, 900, 0).unwrap();
        assert_eq!(set(&mut s, 20, 1_000), Err(Error::SoftLimitNeedsHoming));
        set(&mut s, 22, 1_000).unwrap();
        set(&mut s, 20, 1_000).unwrap();
        set(&mut s, 22, 0).unwrap();
        assert!(!s.is_on(Key::SoftLimits));
    }

    #[test]
    fn homing_cycles_are_those_of_the_machine() {
        let cycles = |s: &Settings<3>| s.axes(AxisKey::HomingCycle).0;
        let mut s = Settings::<3>::default();
        assert_eq!(cycles(&s), [4.0, 3.0, 0.0]);
        assert_eq!(set(&mut s, 44, 8000), Err(Error::SettingOutOfRange));
        assert_eq!(set(&mut s, 47, 1000), Err(Error::InvalidStatement));
        set(&mut s, 44, 1000).unwrap();
        assert_eq!(cycles(&s), [1.0, 3.0, 0.0]);
        assert_eq!(Settings::<4>::default().axes(AxisKey::HomingCycle).0, [4.0, 3.0, 0.0, 0.0], "A has no switch");
    }
}
