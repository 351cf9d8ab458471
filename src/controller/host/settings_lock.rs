//! Settings that make motion impossible on this board, such as a rate beyond its step rate. After each change of a
//! setting, this file searches for a setting of this kind and names it to the host.
//!
//! A setting that makes motion impossible locks motion. Its name is sent to the host twice: after the `ok` to the
//! change that caused the lock, and before the first `error:9` to a line that would move. If there are several such
//! settings, the first one that [`Settings::unrunnable`] finds is named. Later lines do not repeat the name, because a
//! sender that streams a job into a locked machine, or restores its settings one by one, would get it after each line.

use crate::dispatch::Profile;
use crate::settings::{Key, Settings};
use crate::step_rates::StepRates;

/// Tracks which setting locks motion on this board, if any, and whether the host has got its name. Also contains the
/// properties of the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SettingsLock {
    /// Name of the board.
    board: &'static str,
    /// Frequency of the board's oscillator in MHz; 0 if it has none.
    oscillator_mhz: u8,
    /// The board has a fault: motion stays locked until the next start.
    has_board_fault: bool,
    rates: StepRates,
    has_second_motor: bool,
    has_at_speed: bool,
    program_pins: [u8; 2],
    most_baud: u32,
    has_loader: bool,
    /// The revision of the settings for which `setting` was determined.
    revision: Option<u32>,
    /// The setting that locks motion, if any.
    setting: Option<u16>,
    /// The setting that locked motion at the last call of `name_after_change`; `None` if motion was not locked.
    named: Option<u16>,
    /// The setting has been named before the error of a refused line, so later refused lines do not name it again.
    named_at_line: bool,
}

impl SettingsLock {
    /// Creates the lock for a board; no settings have been examined.
    pub(crate) const fn new(profile: &Profile) -> Self {
        let Profile {
            name,
            rates,
            has_second_motor,
            has_at_speed,
            program_pins,
            most_baud,
            oscillator_mhz,
            has_loader,
            ..
        } = *profile;
        let (revision, setting, named, named_at_line) = (None, None, None, false);
        Self {
            board: name,
            oscillator_mhz,
            has_board_fault: false,
            rates,
            has_second_motor,
            has_at_speed,
            program_pins,
            most_baud,
            has_loader,
            revision,
            setting,
            named,
            named_at_line,
        }
    }

    /// Returns the name of the board, for the answers to `$I` and `$I+`.
    pub(crate) fn board(&self) -> &'static str {
        self.board
    }

    /// Locks motion until the next start, because of a fault of the board.
    pub(crate) fn board_failed(&mut self) {
        self.has_board_fault = true;
    }

    pub(crate) fn has_board_fault(&self) -> bool {
        self.has_board_fault
    }

    /// Returns the frequency of the board's oscillator in MHz, for the answer to `$I+`; 0 if it has none.
    pub(crate) fn oscillator_mhz(&self) -> u8 {
        self.oscillator_mhz
    }

    /// Returns the maximum step rate with the step pulse of the settings, in Hz.
    pub(crate) fn greatest_hz<const N: usize>(&self, settings: &Settings<N>) -> u32 {
        self.rates.greatest_hz(settings.step_pulse_tenths()) as u32
    }

    /// Returns the number of outputs and inputs that the board has for programs.
    pub(crate) fn program_pins(&self) -> [u8; 2] {
        self.program_pins
    }

    /// Returns the maximum rate of the UART (`$931`), in baud.
    pub(crate) fn most_baud(&self) -> u32 {
        self.most_baud
    }

    /// Returns whether the board can restart into a boot loader (`$DFU`).
    pub(crate) fn has_loader(&self) -> bool {
        self.has_loader
    }

    /// Returns the shortest step pulse (`$0`) of the board, in tenths of a microsecond.
    pub(crate) fn least_pulse_tenths(&self) -> u16 {
        self.rates.least_pulse_tenths
    }

    /// Returns the number of the setting that locks motion; `None` if no setting does.
    pub(crate) fn setting<const N: usize>(&mut self, settings: &Settings<N>) -> Option<u16> {
        let (rates, has_second_motor, has_at_speed) = (self.rates, self.has_second_motor, self.has_at_speed);
        self.examine(settings.revision(), || {
            let unheard = !has_at_speed && settings.is_on(Key::AtSpeed);
            if unheard { Some(const { Key::AtSpeed.number() }) } else { settings.unrunnable(rates, has_second_motor) }
        })
    }

    /// Returns the setting that locks motion. Calls `unrunnable`, which finds this setting, only if `revision` differs
    /// from the previous call, that is, after a change of any setting.
    fn examine(&mut self, revision: u32, unrunnable: impl FnOnce() -> Option<u16>) -> Option<u16> {
        if self.revision != Some(revision) {
            let setting = unrunnable();
            self.revision = Some(revision);
            self.named_at_line &= self.setting == setting;
            self.setting = setting;
        }
        self.setting
    }

    /// Returns the setting to name to the host after the change of setting `changed`; `None` if there is nothing to
    /// name. The setting that locks motion is named if it is `changed` itself, or if it did not lock motion at the
    /// previous call. Call `Self::setting` first, because that call finds the locking setting.
    pub(crate) fn name_after_change(&mut self, changed: u16) -> Option<u16> {
        let named = core::mem::replace(&mut self.named, self.setting);
        self.setting.filter(|setting| *setting == changed || named != Some(*setting))
    }

    /// Returns the setting to name to the host before the error of a refused line; `None` if it need not be named. The
    /// setting that locks motion is named once: at the first refused line after it locked motion, or after a host was
    /// greeted.
    pub(crate) fn name_at_line(&mut self) -> Option<u16> {
        let named_before = core::mem::replace(&mut self.named_at_line, true);
        self.setting.filter(|_| !named_before)
    }

    /// Lets the next refused line name the setting again: a new host was greeted and may have missed the message.
    pub(crate) fn host_greeted(&mut self) {
        self.named_at_line = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a lock that has examined several revisions of the settings in turn. `settings` contains, for each
    /// revision, the setting that locks motion, if any.
    fn after(settings: &[Option<u16>]) -> SettingsLock {
        let rates = StepRates { safe_hz: 0, least_pulse_tenths: 5 };
        let (name, step_clock_hz, axes, program_pins) = ("", 0, 3, [0; 2]);
        let (has_second_motor, has_at_speed, has_store, has_loader) = (false, false, false, false);
        let mut lock = SettingsLock::new(&Profile {
            name,
            step_clock_hz,
            rates,
            axes,
            has_second_motor,
            has_at_speed,
            program_pins,
            most_baud: 0,
            oscillator_mhz: 0,
            has_store,
            has_loader,
        });
        for (revision, setting) in settings.iter().enumerate() {
            assert_eq!(lock.examine(revision as u32, || *setting), *setting);
        }
        lock
    }

    #[test]
    fn a_set_is_looked_at_once_for_each_revision() {
        let mut lock = after(&[Some(100)]);
        assert_eq!(lock.examine(0, || panic!("known already")), Some(100));
        assert_eq!(lock.examine(1, || None), None);
        assert_eq!(lock.examine(1, || panic!("known already")), None);
        assert_eq!((lock.name_after_change(100), lock.name_at_line()), (None, None));
    }

    #[test]
    fn a_change_names_what_it_locked_and_no_other_repeats_it() {
        let mut lock = after(&[Some(100)]);
        assert_eq!(lock.name_after_change(100), Some(100));
        assert_eq!(lock.name_after_change(101), None, "still the same");
        assert_eq!(lock.name_after_change(100), Some(100), "set again");
        lock.examine(1, || Some(112));
        assert_eq!(lock.name_after_change(100), Some(112), "the next at fault");
        lock.examine(2, || None);
        assert_eq!(lock.name_after_change(112), None);
        lock.examine(3, || Some(112));
        assert_eq!(lock.name_after_change(0), Some(112), "locked again, by another setting's change");
    }

    #[test]
    fn the_first_refused_line_has_the_reason() {
        let mut lock = after(&[Some(100)]);
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(100), None));
        lock.examine(1, || Some(100));
        assert_eq!(lock.name_at_line(), None, "another setting has changed, the reason is the same");
        lock.examine(2, || Some(112));
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(112), None));
        lock.host_greeted();
        assert_eq!((lock.name_at_line(), lock.name_at_line()), (Some(112), None));
    }
}
