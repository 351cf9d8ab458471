//! Settings that make motion impossible on this board, such as a rate beyond its step rate. Looks for one after each
//! change of a setting and tells the host which one it is.
//!
//! A set that cannot be run locks motion by its first setting at fault ([`Settings::unrunnable`]). The host is told which
//! one: after the `ok` to the change that brought it about, and before the first `error:9` to a line that would move.
//! Neither is repeated for what follows: a sender that restores one setting after the other would read it at each line,
//! and so would one that streams a job into a locked machine.

use crate::dispatch::Profile;
use crate::settings::{Key, Settings};
use crate::step_rates::StepRates;

/// The setting that locks motion.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SettingsLock {
    /// What the board can do.
    rates: StepRates,
    has_second_motor: bool,
    has_at_speed: bool,
    program_pins: [u8; 2],
    most_baud: u32,
    /// Revision of the settings that were looked at last.
    revision: Option<u32>,
    /// The setting that locks them.
    setting: Option<u16>,
    /// The one that was named last after a change.
    named: Option<u16>,
    /// A line has been refused with the reason.
    refused: bool,
}

impl SettingsLock {
    /// For a board. Nothing has been looked at.
    pub(crate) const fn new(profile: &Profile) -> Self {
        let Profile { rates, has_second_motor, has_at_speed, program_pins, most_baud, .. } = *profile;
        let (revision, setting, named, refused) = (None, None, None, false);
        Self { rates, has_second_motor, has_at_speed, program_pins, most_baud, revision, setting, named, refused }
    }

    /// How many outputs and inputs the board has for programs.
    pub(crate) fn program_pins(&self) -> [u8; 2] {
        self.program_pins
    }

    /// The greatest rate of the UART (`$931`), baud.
    pub(crate) fn most_baud(&self) -> u32 {
        self.most_baud
    }

    /// The shortest step pulse (`$0`) that the board makes, tenths of a microsecond.
    pub(crate) fn least_pulse_tenths(&self) -> u16 {
        self.rates.least_pulse_tenths
    }

    /// The setting that locks motion.
    #[inline]
    pub(crate) fn setting<const N: usize>(&mut self, settings: &Settings<N>) -> Option<u16> {
        let (rates, has_second_motor, has_at_speed) = (self.rates, self.has_second_motor, self.has_at_speed);
        self.look(settings.revision(), || {
            let unheard = !has_at_speed && settings.is_on(Key::AtSpeed);
            if unheard { Some(const { Key::AtSpeed.number() }) } else { settings.unrunnable(rates, has_second_motor) }
        })
    }

    /// `unrunnable` looks for the setting, once for each revision.
    #[inline]
    fn look(&mut self, revision: u32, unrunnable: impl FnOnce() -> Option<u16>) -> Option<u16> {
        if self.revision != Some(revision) {
            let setting = unrunnable();
            self.revision = Some(revision);
            self.refused &= self.setting == setting;
            self.setting = setting;
        }
        self.setting
    }

    /// The setting `changed` has a new value, and `Self::setting` knows of it: the setting to be named. That is the one that
    /// locks motion, if it has just been changed or was not named yet.
    pub(crate) fn name_after_change(&mut self, changed: u16) -> Option<u16> {
        let named = core::mem::replace(&mut self.named, self.setting);
        self.setting.filter(|setting| *setting == changed || named != Some(*setting))
    }

    /// A line is refused: the setting to be named before its error.
    pub(crate) fn name_at_line(&mut self) -> Option<u16> {
        let refused = core::mem::replace(&mut self.refused, true);
        self.setting.filter(|_| !refused)
    }

    /// A host has been greeted, which may not have heard it.
    pub(crate) fn host_greeted(&mut self) {
        self.refused = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lock after these revisions, each of which locks by a setting or not.
    fn after(settings: &[Option<u16>]) -> SettingsLock {
        let rates = StepRates { safe_hz: 0, least_pulse_tenths: 5 };
        let (name, step_clock_hz, axes, program_pins) = ("", 0, 3, [0; 2]);
        let (has_second_motor, has_at_speed, has_store) = (false, false, false);
        let mut lock = SettingsLock::new(&Profile {
            name,
            step_clock_hz,
            rates,
            axes,
            has_second_motor,
            has_at_speed,
            program_pins,
            most_baud: 0,
            has_store,
        });
        for (revision, setting) in settings.iter().enumerate() {
            assert_eq!(lock.look(revision as u32, || *setting), *setting);
        }
        lock
    }

    #[test]
    fn a_set_is_looked_at_once_for_each_revision() {
        let mut lock = after(&[Some(100)]);
        assert_eq!(lock.look(0, || panic!("known already")), Some(100));
        assert_eq!(lock.look(1, || None), None);
        assert_eq!(lock.look(1, || panic!("known already")), None);
        assert_eq!((lock.name_after_change(100), lock.name_at_line()), (None, None));
    }

    #[test]
    fn a_change_names_what_it_locked_and_no_other_repeats_it() {
        let mut lock = after(&[Some(100)]);
        assert_eq!(lock.name_after_change(100), Some(100));
        assert_eq!(lock.name_after_change(101), None, "still the same");
        assert_eq!(lock.name_after_change(100), Some(100), "set again");
        lock.look(1, || Some(112));
        assert_eq!(lock.name_after_change(100), Some(112), "the next at fault");
        lock.look(2, || None);
        assert_eq!(lock.name_after_change(112), None);
        lock.look(3, || Some(112));
        assert_eq!(lock.name_after_change(0), Some(112), "locked again, by another setting's change");
    }

    #[test]
    fn the_first_refused_line_has_the_reason() {
        let mut lock = after(&[Some(100)]);
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(100), None));
        lock.look(1, || Some(100));
        assert_eq!(lock.name_at_line(), None, "another setting has changed, the reason is the same");
        lock.look(2, || Some(112));
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(112), None));
        lock.host_greeted();
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(112), None));
    }
}
