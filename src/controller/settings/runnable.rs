//! Checks whether the machine can run with the present settings. Returns the number of the first setting that makes
//! motion impossible, such as a rate that needs more than the board's step rate.

use super::table::{AxisKey, Key, SOFT_LIMITS};
use super::values::Settings;
use crate::axes::{Arrangement, Axis, LINEAR};
use crate::step_rates::StepRates;
use crate::units::StepsPerMm;

/// Rates that motion can compute with, mm/min. The range is far wider than any machine needs.
const RATES: core::ops::RangeInclusive<f32> = 3.0e-5..=6.0e6;
/// Accelerations that motion can compute with, mm/s². The range is far wider than any machine needs.
const ACCELERATIONS: core::ops::RangeInclusive<f32> = 1.0e-3..=1.0e7;
/// Jerk, mm/s³. With a jerk of 1 mm/s³, a move of a millimetre takes at least three seconds, so a lower value must be a
/// mistake in the unit.
const JERKS: core::ops::RangeInclusive<f32> = 1.0..=1.0e10;
/// Maximum backlash in steps that motion compensates.
const MOST_BACKLASH: f32 = 10_000.0;
/// Maximum junction deviation, mm.
const GREATEST_DEVIATION: f32 = 1.0e3;
/// Minimum arc tolerance, mm.
const LEAST_TOLERANCE: f32 = 1.0e-4;
const STEP_PULSE: u16 = Key::StepPulse.number();
const GANGED_AXIS: u16 = Key::GangedAxis.number();

impl<const N: usize> Settings<N> {
    /// Returns the number of the first setting that makes motion impossible, or `None` if motion is possible. The
    /// reasons are:
    /// * a step pulse (`$0`) shorter than the board can make, for instance stored by the firmware of another board;
    /// * a value of zero for steps/mm, a rate or an acceleration, or a jerk above 0 but below 1 mm/s³;
    /// * a step rate (rate × resolution) beyond what the board can keep up with at this length of the step pulse
    ///   (`$0`);
    /// * a second motor (`$905`), if the board has none, if the axis A uses its driver, or if it belongs to X or Y of a
    ///   CoreXY machine;
    /// * more axes than the board has motors for;
    /// * soft limits without homing, or a homing or parking cycle that could never end;
    /// * any other value outside the bounds that motion can compute with.
    pub fn unrunnable(&self, rates: StepRates, has_second_motor: bool) -> Option<u16> {
        let pulse = self.step_pulse_tenths();
        if pulse < rates.least_pulse_tenths {
            return Some(STEP_PULSE);
        }
        let greatest_hz = rates.greatest_hz(pulse);
        let core_xy = self.arrangement() == Arrangement::CoreXy;
        let resolution = self.axes(AxisKey::Resolution);
        let rate = self.axes(AxisKey::MaxRate);
        let acceleration = self.axes(AxisKey::Acceleration);
        let in_use = self.axes_in_use();
        let of_axis = Axis::of_machine::<N>().take(in_use).find_map(|axis| {
            let offset = axis.index() as u16;
            let (r, v, a) = (resolution.get(axis)?, rate.get(axis)?, acceleration.get(axis)?);
            // On a diagonal, one motor of a CoreXY machine steps at the sum of the rates of X and Y.
            let motor_rate = match axis {
                Axis::X | Axis::Y if core_xy => rate.get(Axis::X)? + rate.get(Axis::Y)?,
                _ => v,
            };
            if StepsPerMm::new(r).is_none() {
                Some(const { AxisKey::Resolution.number() } + offset)
            } else if !RATES.contains(&v) || r * motor_rate / 60.0 > greatest_hz {
                Some(const { AxisKey::MaxRate.number() } + offset)
            } else if !ACCELERATIONS.contains(&a) {
                Some(const { AxisKey::Acceleration.number() } + offset)
            } else if self.axes(AxisKey::Backlash).get(axis)? * r > MOST_BACKLASH {
                Some(const { AxisKey::Backlash.number() } + offset)
            } else if self.axes(AxisKey::Jerk).get(axis).is_some_and(|jerk| jerk != 0.0 && !JERKS.contains(&jerk)) {
                Some(const { AxisKey::Jerk.number() } + offset)
            } else {
                None
            }
        });
        // A second motor and the axis A would use the same driver, the fourth of the board. So a machine cannot have
        // both.
        let cannot = |axis: &Axis| !has_second_motor || in_use > LINEAR || (core_xy && *axis != Axis::Z);
        let ganged = self.ganged_axis().filter(cannot).map(|_| GANGED_AXIS);
        of_axis.or(ganged).or_else(|| self.unrunnable_cycle())
    }

    /// Returns whether the rate in the setting `rate` is outside the range that motion can compute with. A cycle
    /// (homing, parking) at such a rate might never end.
    pub fn is_rate_out_of_range(&self, rate: Key) -> bool {
        !RATES.contains(&self.value(rate))
    }

    /// Returns the number of the first general (not per-axis) setting that makes motion impossible. The settings of
    /// homing and parking cycles count only if the cycle is enabled.
    fn unrunnable_cycle(&self) -> Option<u16> {
        let homing = self.is_on(Key::Homing);
        let parking = homing && self.is_on(Key::Parking);
        if self.whole(Key::Axes) as usize > self.axes_with_motors() && self.value(Key::Dialect) != 0.0 {
            Some(const { Key::Axes.number() })
        } else if self.value(Key::JunctionDeviation) > GREATEST_DEVIATION {
            Some(const { Key::JunctionDeviation.number() })
        } else if self.value(Key::ArcTolerance) < LEAST_TOLERANCE {
            Some(const { Key::ArcTolerance.number() })
        } else if self.is_on(Key::SoftLimits) && !homing {
            Some(SOFT_LIMITS)
        } else if homing && self.is_rate_out_of_range(Key::HomingLocate) {
            Some(const { Key::HomingLocate.number() })
        } else if homing && self.is_rate_out_of_range(Key::HomingSeek) {
            Some(const { Key::HomingSeek.number() })
        } else if parking && self.whole(Key::ParkingAxis) as usize >= self.axes_in_use().min(LINEAR) {
            Some(const { Key::ParkingAxis.number() })
        } else if parking && self.is_rate_out_of_range(Key::ParkingPullOutRate) {
            Some(const { Key::ParkingPullOutRate.number() })
        } else if parking && self.is_rate_out_of_range(Key::ParkingFastRate) {
            Some(const { Key::ParkingFastRate.number() })
        } else {
            None
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::error::Error;
    use crate::units::Decimal;

    fn rates(safe_hz: u32) -> StepRates {
        StepRates { safe_hz, least_pulse_tenths: 10 }
    }

    fn set(settings: &mut Settings<3>, number: u16, thousandths: i64) -> Result<(), Error> {
        settings.set(number, Decimal(thousandths * 10_000))
    }

    #[test]
    fn a_pulse_that_the_board_does_not_make_locks_motion() {
        let mut s = Settings::<3>::default();
        set(&mut s, 0, 900).unwrap();
        assert_eq!(s.unrunnable(rates(490_000), true), Some(0));
        assert_eq!(s.unrunnable(StepRates { least_pulse_tenths: 9, ..rates(490_000) }, true), None);
    }

    #[test]
    fn a_set_that_cannot_run_names_its_setting() {
        let mut s = Settings::<3>::default();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
        set(&mut s, 101, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(101));
        set(&mut s, 101, 250_000).unwrap();
        set(&mut s, 112, 30_000_000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(112));
        set(&mut s, 112, 500_000).unwrap();
        set(&mut s, 120, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(120));
        set(&mut s, 120, 10_000).unwrap();
        set(&mut s, 222, 500).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(222));
        assert_eq!(set(&mut s, 222, -1), Err(Error::NegativeValue));
        set(&mut s, 222, 0).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
    }

    /// Each bound is the one that `docs/settings.md` gives.
    #[test]
    fn each_bound_of_what_can_run_is_where_it_is_said_to_be() {
        let (homing, parking): (&[_], &[_]) = (&[(22, 1)], &[(22, 1), (41, 1)]);
        // Each row: the settings made first; the number of the setting under test; a value that locks motion; a value
        // that does not (both values in ten-millionths).
        for (before, number, locked, free) in [
            (&[][..], 11, 10_001_000_000, 10_000_000_000),
            (&[], 12, 999, 1000),
            (&[], 160, 400_010_000, 400_000_000),
            (&[], 110, 0, 1000),
            (&[], 120, 9000, 11_000),
            (&[], 220, 9_999_000, 10_000_000),
            (&[], 20, 10_000_000, 0),
            (homing, 24, 0, 1000),
            (homing, 25, 0, 1000),
            (parking, 42, 30_000_000, 20_000_000),
            (parking, 57, 0, 1000),
            (parking, 59, 0, 1000),
        ] {
            let mut s = Settings::<3>::default();
            for (number, value) in before {
                s.set(*number, Decimal::from_int(*value)).unwrap();
            }
            s.set(number, Decimal(locked)).unwrap();
            assert_eq!(s.unrunnable(rates(100_000), true), Some(number), "{locked}");
            s.set(number, Decimal(free)).unwrap();
            assert_eq!(s.unrunnable(rates(100_000), true), None, "${number}={free}");
        }
    }

    #[test]
    fn motors_that_pull_together_add_their_rates() {
        let mut s = Settings::<3>::default();
        for (number, value) in [(110, 12_000), (111, 9_000)] {
            set(&mut s, number, value * 1000).unwrap();
        }
        // At 250 steps/mm, X needs 50,000 steps/s and Y 37,500. On the diagonal of a CoreXY machine a motor needs the
        // sum, 87,500.
        assert_eq!(s.unrunnable(rates(83_000), true), None);
        set(&mut s, 904, 1000).unwrap();
        assert_eq!(s.unrunnable(rates(83_000), true), Some(110));
        set(&mut s, 0, 3000).unwrap();
        assert_eq!(s.unrunnable(rates(88_000), true), None);
    }

    #[test]
    fn a_second_motor_needs_its_pins() {
        let mut s = Settings::<3>::default();
        set(&mut s, 905, 2000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), None);
        assert_eq!(s.unrunnable(rates(100_000), false), Some(905));
        set(&mut s, 904, 1000).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(905));
    }

    #[test]
    fn axes_that_are_not_in_use_have_no_settings() {
        let mut s = Settings::<4>::default();
        let listed = |s: &Settings<4>| (0..).map_while(|line| s.row(line)).map(|row| row.1).collect::<Vec<_>>();
        let three = listed(&s);
        let of_three = Settings::<3>::default();
        assert_eq!(three, (0..Settings::<3>::LINES).map(|line| of_three.row(line).unwrap().1).collect::<Vec<_>>());
        // Settings can come in any order, so those of A are accepted before `$930` puts A in use.
        s.set(103, Decimal::from_int(7)).unwrap();
        s.set(44, Decimal::from_int(12)).unwrap();
        assert_eq!((listed(&s), s.homing_cycles().0), (three.clone(), [4, 3, 0, 0]));
        s.set(930, Decimal::from_int(4)).unwrap();
        assert_eq!(s.homing_cycles().0, [12, 3, 0, 0]);
        assert_eq!((s.axes_in_use(), listed(&s).len()), (4, Settings::<4>::LINES));
        s.set(103, Decimal::from_int(10)).unwrap();
        s.set(44, Decimal::from_int(12)).unwrap();
        s.set(103, Decimal::ZERO).unwrap();
        assert_eq!(s.unrunnable(rates(100_000), true), Some(103));
        s.set(930, Decimal::from_int(3)).unwrap();
        assert_eq!((s.unrunnable(rates(100_000), true), s.homing_cycles().0), (None, [4, 3, 0, 0]));
        assert_eq!(listed(&s), three);
        s.set(930, Decimal::from_int(4)).unwrap();
        s.set(900, Decimal::ZERO).unwrap();
        assert_eq!((s.axes_in_use(), listed(&s)), (3, three), "to Grbl");
        assert_eq!(s.set(103, Decimal::from_int(10)), Err(Error::InvalidStatement));
        assert_eq!(s.set(44, Decimal::from_int(8)), Err(Error::InvalidStatement));
        assert_eq!(
            Settings::<4>::of_board(3).set(103, Decimal::from_int(10)),
            Err(Error::InvalidStatement),
            "no motor"
        );
        assert_eq!(Settings::<3>::default().set(103, Decimal::from_int(10)), Err(Error::InvalidStatement));
    }

    #[test]
    fn a_board_declines_axes_for_which_it_has_no_motors() {
        for mut s in [Settings::<4>::of_board(3), Settings::<4>::of_board(4)] {
            let has_four = s.axes_with_motors() == 4;
            s.set(930, Decimal::from_int(4)).unwrap();
            assert_eq!(s.axes_in_use(), if has_four { 4 } else { 3 });
            assert_eq!(s.unrunnable(rates(100_000), true), (!has_four).then_some(930));
            s.set(905, Decimal::from_int(2)).unwrap();
            assert!(s.unrunnable(rates(100_000), true).is_some(), "one motor too few");
            s.set(930, Decimal::from_int(3)).unwrap();
            assert_eq!(s.unrunnable(rates(100_000), true), None);
        }
        let mut s = Settings::<3>::default();
        s.set(930, Decimal::from_int(4)).unwrap();
        assert_eq!((s.axes_in_use(), s.unrunnable(rates(100_000), true)), (3, Some(930)));
    }
}
