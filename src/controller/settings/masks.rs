//! Settings (`$10`, `$22`) that are masks in grblHAL and have fewer values here. With `$900=3`, hosts write and read
//! grblHAL's mask. A bit of such a mask is one of three kinds: it is a part of the value of a setting here, it stands
//! for a function that is always on here, or it stands for a function that does not exist here. Bits of the last kind
//! are refused.

use super::table::Key;
use super::values::Settings;

/// A setting whose mask in grblHAL has more bits than its value here. With `$900=3`, hosts write and read the mask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GrblHalMask {
    number: u16,
    /// Bits that are the value of this setting (`number`).
    pub own: u32,
    /// Bits that are the value of another setting. Only the mask of `$22` has such a bit, which is the value of
    /// `$932`.
    elsewhere: u32,
    /// Bits of functions that are always on in this firmware.
    always: u32,
    /// Meanings of the bits from the lowest, separated by commas; `N/A` for a bit without a function.
    pub labels: &'static str,
}

/// Bit of `$22` for a machine zero where homing ends (`$932`).
const ZERO_AT_PULL_OFF: u32 = 1 << 3;

const MASKS: [GrblHalMask; 2] = [
    GrblHalMask {
        number: Key::StatusReport.number(),
        own: 0b11,
        elsewhere: 0,
        always: 0x1FC,
        labels: "Machine position,Buffer state,Line numbers,Feed and speed,Pins,Work offset,Overrides,\
                 Probe result,Work offset at once",
    },
    GrblHalMask {
        number: Key::Homing.number(),
        own: 1,
        elsewhere: ZERO_AT_PULL_OFF,
        always: 0b1100_0110,
        labels: "Homing,Single axes,At power-up,Machine zero where homing ends,N/A,N/A,$X unlocks,Kept at a reset",
    },
];

impl GrblHalMask {
    /// Returns the mask of the setting `number`; `None` if this setting has the same value with `$900=3` as without.
    pub fn of(number: u16) -> Option<&'static GrblHalMask> {
        MASKS.iter().find(|mask| mask.number == number)
    }

    /// Returns all bits that a host can set; the others have no function in this firmware.
    pub const fn bits(&self) -> u32 {
        self.own | self.elsewhere | self.always
    }

    /// Returns the mask that a host reads after it has written `written`. The bits of functions that are always on are
    /// set in it. But if homing is off in the mask of `$22`, the whole mask reads as 0.
    pub fn read_back(&self, written: u32) -> u32 {
        if self.is_in_force(written) { written | self.always } else { written & self.own }
    }

    /// Returns whether the bits other than `own` have an effect. In the mask of `$22` they have none while homing is
    /// off (`$22=0`).
    fn is_in_force(&self, bits: u32) -> bool {
        self.elsewhere == 0 || bits & self.own != 0
    }

    /// Returns the value of `$932` that the mask `written` sets; `None` if this is not the mask of `$22`, or if
    /// `written` switches homing off.
    pub fn zero_at_pull_off(&self, written: u32) -> Option<bool> {
        (self.elsewhere != 0 && self.is_in_force(written)).then_some(written & ZERO_AT_PULL_OFF != 0)
    }
}

impl<const N: usize> Settings<N> {
    /// Returns the value of a setting as hosts of `$900=3` read it.
    #[inline(never)]
    pub fn shown_to_grblhal(&self, number: u16, value: f32) -> f32 {
        let own = value as u32;
        match GrblHalMask::of(number) {
            Some(mask) if mask.is_in_force(own) => {
                let zero = mask.elsewhere != 0 && self.is_on(Key::ZeroAtPullOff);
                (own & mask.own | mask.always | if zero { ZERO_AT_PULL_OFF } else { 0 }) as f32
            }
            _ => value,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn masks_are_written_and_read() {
        let mut settings = Settings::<3>::default();
        let [report, homing] = MASKS;
        assert_eq!((report.bits(), homing.bits()), (511, 0b1100_1111));
        assert_eq!(settings.shown_to_grblhal(10, 3.0), 511.0);
        assert_eq!(settings.shown_to_grblhal(10, 0.0), 508.0);
        assert_eq!(settings.shown_to_grblhal(22, 0.0), 0.0);
        assert_eq!(settings.shown_to_grblhal(22, 1.0), 199.0);
        assert!(settings.restore(932, 1.0));
        assert_eq!(settings.shown_to_grblhal(22, 1.0), 207.0);
        assert_eq!(settings.shown_to_grblhal(21, 1.0), 1.0);
        assert_eq!([0, 1, 9].map(|bits| homing.zero_at_pull_off(bits)), [None, Some(false), Some(true)]);
        assert_eq!(report.zero_at_pull_off(511), None);
        assert_eq!([0, 9, 79].map(|bits| homing.read_back(bits)), [0, 207, 207]);
        assert_eq!([2, 511].map(|bits| report.read_back(bits)), [510, 511]);
    }

    #[test]
    fn every_bit_has_a_label() {
        for mask in MASKS {
            for (bit, label) in mask.labels.split(',').enumerate() {
                assert_eq!(mask.bits() >> bit & 1 != 0, label != "N/A", "${} bit {bit}", mask.number);
            }
            assert_eq!(mask.bits() >> mask.labels.split(',').count(), 0);
        }
    }
}
