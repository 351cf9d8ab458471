//! The values of the settings, initially the defaults of a new machine. A setting is read by its key: as a number,
//! switch, mask or time. Settings with a special meaning, such as homing cycles or kinematics, have functions of their
//! own.

use super::index::Index;
use super::table::{AxisKey, GRBLHAL, Key, PER_AXIS, SCALARS, SOFT_LIMITS, homing_cycle};
use crate::axes::{Arrangement, Axis, LINEAR, PerAxis};
use crate::image::FULL_IMAGE;
use crate::units::Duration;

/// The value of each setting, in the unit of its row in the table.
#[derive(Clone, Debug, PartialEq)]
pub struct Settings<const N: usize> {
    scalars: [f32; Key::COUNT],
    per_axis: [PerAxis<f32, N>; AxisKey::COUNT],
    /// Counts changes, so that values derived from the settings are computed only once after each change.
    revision: u32,
    /// Number of axes for which the board has motors, at most `N`.
    present: usize,
}

/// Stored form of `$20=1` (soft limits on) while homing is off. A stored 1 counts only with homing on. So the single
/// record `$22=0` switches off homing and soft limits at once, even if the power is cut right after it.
const BEFORE_HOMING: f32 = 2.0;

/// Returns the mask of `axes` axes, bit 0 for X.
pub(super) const fn axes_mask(axes: usize) -> u8 {
    (1 << axes) - 1
}

impl<const N: usize> Default for Settings<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Settings<N> {
    /// Returns the defaults, for a board that has motors for all `N` axes.
    #[allow(clippy::indexing_slicing, reason = "both arrays have the length of their table")]
    pub const fn new() -> Self {
        let mut settings =
            Self { scalars: [0.0; Key::COUNT], per_axis: [PerAxis::all(0.0); AxisKey::COUNT], revision: 0, present: N };
        let mut i = 0;
        while i < Key::COUNT {
            settings.scalars[i] = SCALARS[i].default;
            i += 1;
        }
        i = 0;
        while i < AxisKey::COUNT {
            settings.per_axis[i] = PerAxis::all(PER_AXIS[i].default);
            i += 1;
        }
        i = 0;
        while i < N {
            settings.per_axis[AxisKey::HomingCycle as usize].0[i] = homing_cycle(i) as f32;
            if i >= LINEAR {
                // A rotary axis turns without end, so its travel is 0.
                settings.per_axis[AxisKey::Travel as usize].0[i] = 0.0;
            }
            i += 1;
        }
        settings
    }

    /// Returns the defaults, for a board that has motors for `axes` axes.
    pub const fn of_board(axes: usize) -> Self {
        Self { present: if axes < N { axes } else { N }, ..Self::new() }
    }

    /// Returns how many axes the machine has (`$930`). In Grbl's dialect it has at most three.
    pub fn axes_in_use(&self) -> usize {
        if N <= LINEAR || self.value(Key::Dialect) == 0.0 {
            return N.min(LINEAR);
        }
        (self.whole(Key::Axes) as usize).clamp(LINEAR, self.axes_with_motors())
    }

    /// Returns how many axes can be in use. These are the axes for which the board has motors, but at least three.
    pub(super) fn axes_with_motors(&self) -> usize {
        self.present.max(LINEAR)
    }

    /// Returns the value of a setting that exists once, in the unit of its row.
    pub fn value(&self, key: Key) -> f32 {
        self.scalars.get(key as usize).copied().unwrap_or(0.0)
    }

    /// Returns the value of a setting that exists once, without its fraction.
    pub fn whole(&self, key: Key) -> u32 {
        self.value(key) as u32
    }

    /// Returns the length of the step pulse (`$0`) in tenths of a microsecond.
    pub fn step_pulse_tenths(&self) -> u16 {
        (self.value(Key::StepPulse) * 10.0 + 0.5) as u16
    }

    /// Returns a time setting (in seconds) as a duration, at most a day.
    pub fn seconds(&self, key: Key) -> Duration {
        let seconds = self.value(key);
        let bounded = if seconds < 86_400.0 { seconds } else { 86_400.0 };
        Duration::from_ticks((bounded * 1.0e6) as u64)
    }

    /// Returns whether hosts are answered like grblHAL (`$900=3`).
    #[inline]
    pub fn speaks_grblhal(&self) -> bool {
        FULL_IMAGE && self.whole(Key::Dialect) == GRBLHAL
    }

    /// Returns whether the value of a setting that exists once is not 0.
    pub fn is_on(&self, key: Key) -> bool {
        self.value(key) != 0.0
    }

    /// Returns the values of a per-axis setting, in the unit of its row.
    pub fn axes(&self, key: AxisKey) -> PerAxis<f32, N> {
        self.per_axis.get(key as usize).copied().unwrap_or(PerAxis::all(0.0))
    }

    /// Returns the ends of an axis' travel in machine coordinates, in mm; `None` for an axis that turns without end.
    /// Without `$932`, the ends are minus the length of the travel and 0, whichever of the two has the switch. With
    /// `$932`, 0 is where homing ends, and the travel extends from there away from the switch.
    pub fn ends_of_travel(&self, axis: Axis) -> Option<[f32; 2]> {
        let travel = self.axes(AxisKey::Travel).get(axis).filter(|travel| axis.has_ends(*travel))?;
        if !self.is_on(Key::ZeroAtPullOff) {
            return Some([-travel, 0.0]);
        }
        let pull_off = self.value(Key::HomingPullOff);
        let rest = if travel > pull_off { travel - pull_off } else { 0.0 };
        let is_homed_to_negative = self.whole(Key::HomingDirection) >> axis.index() & 1 != 0;
        Some(if is_homed_to_negative { [0.0, rest] } else { [-rest, 0.0] })
    }

    /// Returns the axes of each homing cycle, bit 0 for X, limited to the axes of the machine.
    pub fn homing_cycles(&self) -> PerAxis<u8, N> {
        let axes = axes_mask(self.axes_in_use());
        self.axes(AxisKey::HomingCycle).map(|cycle| cycle as u8 & axes)
    }

    /// Returns how the motors move the tool (`$904`).
    pub fn arrangement(&self) -> Arrangement {
        if self.whole(Key::Kinematics) == 1 { Arrangement::CoreXy } else { Arrangement::Cartesian }
    }

    /// Returns the axis that two motors move (`$905`); `None` if each axis has one motor.
    pub fn ganged_axis(&self) -> Option<Axis> {
        Axis::ALL.get((self.whole(Key::GangedAxis) as usize).checked_sub(1)?).copied()
    }

    /// Restores a stored value. Returns `false`, without a change, if the setting cannot have this value in any
    /// dialect. A number that is no setting of this board may come from other firmware: then nothing changes, and the
    /// result is `true`.
    pub fn restore(&mut self, number: u16, value: f32) -> bool {
        let axes = self.axes_with_motors();
        let index = Index::of_number(number, axes);
        let Some((index, (entry, _))) = index.and_then(|index| Some((index, index.row()?))) else { return true };
        let before_homing = number == SOFT_LIMITS && value == BEFORE_HOMING;
        let can_be = before_homing || entry.kind.can_be(value, axes_mask(axes));
        if can_be {
            self.put(index, value);
        }
        can_be
    }

    /// Completes the restoring of stored values. Call it at power-up, after [`Settings::restore`] was called for each
    /// of them. If homing is off, switches off soft limits that were stored while homing was on.
    pub fn settle(&mut self) {
        let kept = self.value(Key::SoftLimits) == BEFORE_HOMING || self.is_on(Key::Homing);
        let on = kept && self.is_on(Key::SoftLimits);
        self.put(Index::Scalar(Key::SoftLimits as usize), if on { 1.0 } else { 0.0 });
    }

    /// Returns the value of the setting with this number, in its stored form; `None` if there is no such setting.
    pub fn by_number(&self, number: u16) -> Option<f32> {
        if number == SOFT_LIMITS && self.is_on(Key::SoftLimits) && !self.is_on(Key::Homing) {
            return Some(BEFORE_HOMING);
        }
        self.at(Index::of_number(number, N)?)
    }

    /// Returns the value that must be stored for `$20` (soft limits) just before a changed `$22` (homing) is stored;
    /// `None` if the stored `$20` can stay. As a result, the record of `$22` changes both settings at once (see
    /// `settle`), and a power cut before that record changes neither. `were_on`: `true` if soft limits were on before
    /// `$22` changed.
    pub fn soft_limits_before_homing(&self, were_on: bool) -> Option<f32> {
        match (self.is_on(Key::Homing), were_on) {
            (true, true) => None,
            (false, true) => Some(1.0),
            (_, false) => Some(0.0),
        }
    }

    /// Returns the number of changes so far (wrapping). Code that keeps a result computed from settings computes it
    /// again when this number differs.
    pub fn revision(&self) -> u32 {
        self.revision
    }

    /// Replaces all values by those of `others`, for `$RST`. The number of axes with motors stays.
    pub fn replace(&mut self, others: Self) {
        *self = Self { revision: self.revision.wrapping_add(1), present: self.present, ..others };
    }

    /// Returns the value of the setting at an index; `None` if the index is beyond the tables.
    pub(super) fn at(&self, index: Index) -> Option<f32> {
        match index {
            Index::Scalar(i) => self.scalars.get(i).copied(),
            Index::PerAxis(i, axis) => self.per_axis.get(i)?.get(axis),
        }
    }

    /// Sets the value at an index without a check, and counts the change in `revision`.
    pub(super) fn put(&mut self, index: Index, value: f32) {
        self.revision = self.revision.wrapping_add(1);
        match index {
            Index::Scalar(i) => {
                if let Some(slot) = self.scalars.get_mut(i) {
                    *slot = value;
                }
            }
            Index::PerAxis(i, axis) => {
                if let Some(slot) = self.per_axis.get_mut(i) {
                    slot.set(axis, value);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::Decimal;

    #[test]
    fn what_no_setting_can_be_is_not_taken_over() {
        for (number, value, taken) in [
            (0, 0.4, false),
            (0, 0.5, true),
            (0, 2.55, false),
            (0, 254.9, true),
            (0, 1000.0, false),
            (1, 25.5, false),
            (1, 256.0, false),
            (14, 16.0, false),
            (14, 256.0, true),
            (20, 2.0, true),
            (21, 2.0, false),
            (33, 0.0, false),
            (44, 8.0, true),
            (44, 16.0, false),
            (47, 3.0, true),
            (48, 1.0, true),
            (58, -5.0e11, true),
            (58, -1.0e12, false),
            (110, -1.0, false),
            (110, 9.0e11, true),
            (110, 1.0e12, false),
            (110, f32::INFINITY, false),
            (110, f32::NAN, false),
            (900, 3.0, crate::image::FULL_IMAGE),
            (900, 4.0, false),
        ] {
            let mut s = Settings::<4>::default();
            let before = s.by_number(number);
            assert_eq!(s.restore(number, value), taken, "${number}={value}");
            assert_eq!(s.by_number(number), if taken && before.is_some() { Some(value) } else { before });
        }
        // A board with motors for three axes has no settings for A.
        let mut s = Settings::<4>::of_board(3);
        assert!(!s.restore(44, 8.0) && s.restore(44, 7.0));
        assert!(s.restore(103, 80.0), "no setting of this board");
        assert_eq!(s.by_number(103), Some(250.0));
    }

    /// After a power cut at any time, homing and soft limits are either both as before a change of `$22`, or both as
    /// after it. The change stores two records, and the power can be cut between them.
    #[test]
    fn soft_limits_and_homing_change_at_once() {
        let switch = |on: bool| Decimal::from_int(i32::from(on));
        let is = |s: &Settings<3>| [Key::SoftLimits, Key::Homing].map(|key| s.is_on(key));
        let found = |record: [f32; 2]| {
            let mut s = Settings::<3>::default();
            assert!(s.restore(20, record[0]) && s.restore(22, record[1]));
            s.settle();
            is(&s)
        };
        let (mut s, mut record) = (Settings::<3>::default(), [0.0; 2]);
        for (number, on) in [
            (20, true),
            (22, true),
            (22, true),
            (22, false),
            (22, true),
            (20, true),
            (20, false),
            (22, false),
            (20, true),
        ] {
            let before = s.clone();
            s.set(number, switch(on)).unwrap();
            if number == 22 {
                record[0] = s.soft_limits_before_homing(before.is_on(Key::SoftLimits)).unwrap_or(record[0]);
                assert_eq!(found(record), is(&before));
            }
            record[usize::from(number == 22)] = s.by_number(number).unwrap();
            assert_eq!(found(record), is(&s));
        }
    }

    /// Number of dialects: the values of `$900` that this image has.
    const DIALECTS: i32 = if crate::image::FULL_IMAGE { 4 } else { 3 };

    proptest::proptest! {
        /// A value that can be set can also be restored, even if another dialect is in force then.
        #[test]
        fn what_can_be_set_is_taken_over(value: i64, shift in 0..64_u32, set_in in 0..DIALECTS, in_force in 0..DIALECTS) {
            let of = |dialect| {
                let mut s = Settings::<4>::default();
                s.set(Key::Dialect.number(), Decimal::from_int(dialect)).unwrap();
                s
            };
            let (mut before, mut after) = (of(set_in), of(in_force));
            let any = value >> shift;
            let tenths = any / 1_000_000 * 1_000_000;
            for (number, value) in (0..1000).flat_map(|number| [(number, any), (number, tenths)]) {
                if before.set(number, Decimal(value)).is_ok() {
                    let stored = before.by_number(number).unwrap();
                    proptest::prop_assert!(after.restore(number, stored), "${}={}", number, stored);
                    proptest::prop_assert_eq!(after.at(Index::of_number(number, 4).unwrap()), Some(stored));
                }
            }
        }
    }

    /// The step pulse is stored in microseconds, even if it has tenths. So records of older firmware, which had only
    /// whole microseconds, are read unchanged.
    #[test]
    fn a_step_pulse_stored_in_whole_microseconds_is_read_as_it_was() {
        for (record, tenths) in
            [([0x00, 0x00, 0x80, 0x3f], 10), ([0x00, 0x00, 0x20, 0x41], 100), ([0x00, 0x00, 0x7f, 0x43], 2550)]
        {
            let mut s = Settings::<3>::default();
            s.restore(0, 2.5);
            s.restore(0, f32::from_le_bytes(record));
            assert_eq!(s.step_pulse_tenths(), tenths);
        }
    }
}
