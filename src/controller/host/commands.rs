//! Executes `$` commands: settings, unlock, homing, check mode, sleep, defaults, startup lines and macros. For a
//! command with a long answer, such as `$$`, this file only starts the listing, and `listings` sends its lines. A
//! command that the present state forbids is refused before anything changes.

use crate::axes::{Axis, AxisMask};
use crate::dispatch::Controller;
use crate::error::Error;
use crate::gcode::{Dialect, REASONS};
use crate::image::FULL_IMAGE;
use crate::protocol::system::{self, Allowed, Restore, System};
use crate::protocol::{grblhal, reply_texts};
use crate::settings::{AxisKey, Key, Settings};
use crate::states::{Homing, State};
use crate::units::{DECIMAL_ONE, Decimal, Duration};
use crate::work::task::{Answer, Ask, Caller, Listing, Task};

// Numbers of settings whose change needs a further check or has further effects.
const DIALECT: u16 = Key::Dialect.number();
const DIRECTION_INVERT: u16 = Key::DirectionInvert.number();
const DOOR_FITTED: u16 = Key::DoorFitted.number();
const AXES: u16 = Key::Axes.number();
const BAUD: u16 = Key::Baud.number();
const HOMING: u16 = Key::Homing.number();
const HOMING_DIRECTION: u16 = Key::HomingDirection.number();
const HOMING_PULL_OFF: u16 = Key::HomingPullOff.number();
const KINEMATICS: u16 = Key::Kinematics.number();
const LASER: u16 = Key::Laser.number();
const REPORT_INCHES: u16 = Key::ReportInches.number();
const RESET_IS_EMERGENCY_STOP: u16 = Key::ResetIsEmergencyStop.number();
const SPINDLE_MAXIMUM: u16 = Key::SpindleMaximum.number();
const SPINDLE_MINIMUM: u16 = Key::SpindleMinimum.number();
const STEP_PULSE: u16 = Key::StepPulse.number();
const ZERO_AT_PULL_OFF: u16 = Key::ZeroAtPullOff.number();

/// Time between the answer to `$REBOOT` or `$DFU` and the restart, so that the answer can reach the host.
const REBOOT_DELAY: Duration = Duration::millis(100);

impl<const N: usize> Controller<N> {
    /// Executes a line that begins with `$`.
    pub(crate) fn system(&mut self, line: &[u8]) -> Result<(), Error> {
        let resting = matches!(self.state, State::Normal) && !self.m.step_supply.is_running();
        let idle = resting && self.m.motion.is_idle();
        match system::allowed(line) {
            Allowed::AtRest if !(idle || matches!(self.state, State::Alarm(_))) => return Err(Error::NotIdle),
            Allowed::ForJog if !(idle || matches!(self.state, State::Jog { .. })) => return Err(Error::NotIdle),
            _ => {}
        }
        if self.speaks_grblhal()
            && let Some(command) = grblhal::read(line)
        {
            return self.grblhal_command(command);
        }
        let command = system::read(line)?;
        if self.dialect() == Dialect::Grbl {
            command.known_to_grbl()?;
        }
        match command {
            System::Help => {
                self.say_help();
                self.say_ok();
            }
            System::Settings if matches!(self.state, State::Normal) && !idle => return Err(Error::NotIdle),
            System::Settings => self.task = Task::Listing(Listing::Settings, 0),
            System::Parameters => self.task = Task::Listing(Listing::Parameters, 0),
            System::StartupLines => self.task = Task::Listing(Listing::StartupLines, 0),
            System::ParserState => {
                self.say_parser_state();
                self.say_ok();
            }
            System::BuildInfo | System::MoreBuildInfo if self.speaks_grblhal() => {
                self.m.inputs.ask_view(false);
                self.task = Task::Listing(Listing::Identity, 0);
            }
            System::BuildInfo => self.report_build_info(false),
            System::MoreBuildInfo => self.report_build_info(true),
            System::Describe(_) if !FULL_IMAGE => return Err(Error::DescriptionsLeftOut),
            System::Describe(what) => self.task = Task::Listing(Listing::Descriptions(what), 0),
            System::Refusal if REASONS => self.tell_refusal(),
            System::Refusal => return Err(Error::DescriptionsLeftOut),
            System::SetBuildInfo(text) => {
                let text = heapless::Vec::from_slice(text).map_err(|_| Error::LineTooLong)?;
                self.m.records.save_build_info(text);
                self.task = Task::Storing(Answer::Host);
            }
            System::SetStartupLine(index, text) => self.set_startup_line(index, text)?,
            System::Macros => self.task = Task::Listing(Listing::Macros, 0),
            System::SetMacro(index, text) => self.set_macro(index, text)?,
            System::CheckMode => self.toggle_check_mode()?,
            System::Unlock => self.unlock()?,
            System::Home(axis) => self.home(axis)?,
            System::Jog(text) => return self.jog(text),
            System::Restore(what) => {
                self.must_hold_nothing()?;
                self.restore_defaults(what);
            }
            System::ResetCause => {
                let restart = self.m.replies.read_restart().clone();
                self.say(|out| reply_texts::restart(out, &restart));
                self.say_ok();
            }
            System::Recording => self.list_recording()?,
            System::Pins => {
                self.m.inputs.ask_view(false);
                self.task = Task::Listing(Listing::Pins, 0);
            }
            System::ClearNoise => {
                self.m.inputs.ask_view(true);
                self.say_ok();
            }
            System::CheckLines(session) => self.check_lines(session),
            System::Sleep => self.sleep(),
            System::Reboot { into_loader } => self.reboot(into_loader)?,
            System::Set(number, value) => self.set_setting(number, value)?,
        }
        Ok(())
    }

    /// Switches line checksums on (`$LC=ON`, `session` is `Some`) or off (`$LC=OFF`). The switch acts before the
    /// answer: the `ok` to `$LC=ON` has a checksum already, and the `ok` to `$LC=OFF` has none.
    fn check_lines(&mut self, session: Option<&[u8]>) {
        if let Some(session) = session {
            self.m.lines.begin_check(session);
        } else {
            self.m.lines.end_check();
        }
        self.say_ok();
    }

    fn list_recording(&mut self) -> Result<(), Error> {
        if !FULL_IMAGE {
            return Err(Error::RecorderLeftOut);
        }
        self.task = Task::Listing(Listing::Recording(Ask::Wanted), 0);
        Ok(())
    }

    fn sleep(&mut self) {
        self.say_ok();
        self.say(|out| reply_texts::message(out, "Sleeping"));
        self.fall_asleep();
    }

    /// Answers, and restarts the board after `REBOOT_DELAY`. Refused while the spindle, the coolant or another output
    /// is on: a restart switches all outputs off, and the boot loader drives no outputs at all. With homing off,
    /// `$REBOOT` is also refused in an alarm. The restart would clear the alarm, but only `$X` or `$H` may end one.
    fn reboot(&mut self, into_loader: bool) -> Result<(), Error> {
        self.must_hold_nothing()?;
        if into_loader && !self.m.settings_lock.has_loader() {
            self.say(|out| reply_texts::message(out, "This board has no boot loader for $DFU: docs/boards.md"));
            return Err(Error::InvalidStatement);
        }
        if matches!(self.state, State::Alarm(_)) && !self.m.settings.is_on(Key::Homing) && !into_loader {
            return Err(Error::Locked);
        }
        let accessories = &self.m.accessories;
        let coolant = accessories.coolant();
        if accessories.is_on() || coolant.flood || coolant.mist || accessories.digital().levels() != 0 {
            self.say(|out| reply_texts::message(out, "Switch off spindle, coolant and outputs first"));
            return Err(Error::NotIdle);
        }
        self.say_ok();
        self.task = Task::Rebooting { into_loader, at: self.m.now + REBOOT_DELAY };
        Ok(())
    }

    fn set_startup_line(&mut self, index: usize, text: &[u8]) -> Result<(), Error> {
        if !matches!(self.state, State::Normal) {
            return Err(Error::NotIdle);
        }
        // The line is executed before it is stored. An M2 in it would end the host's program, and with it an open
        // subroutine, loop or condition. So the line is refused while one of these is open.
        if self.m.interpreter.is_within_block() {
            return Err(Error::NotIdle);
        }
        let stored = heapless::Vec::from_slice(text).map_err(|_| Error::LineTooLong)?;
        if text.is_empty() {
            self.m.records.save_startup_line(index, stored);
            self.task = Task::Storing(Answer::Host);
            return Ok(());
        }
        self.m.records.validate(stored);
        self.startup_line(text, Caller::Validation(index))
    }

    fn set_macro(&mut self, index: usize, text: &[u8]) -> Result<(), Error> {
        if !matches!(self.state, State::Normal) {
            return Err(Error::NotIdle);
        }
        let stored = heapless::Vec::from_slice(text).map_err(|_| Error::LineTooLong)?;
        self.m.interpreter.set_macro_line(index, text)?;
        self.m.records.save_macro(index, &stored);
        self.task = Task::Storing(Answer::Host);
        Ok(())
    }

    /// Returns an error while the controller holds a program for later execution or records a subprogram. Commands such
    /// as `$H` or `$RST` call this function first: they would run between the held lines, or change what these lines
    /// mean.
    fn must_hold_nothing(&self) -> Result<(), Error> {
        if self.m.interpreter.is_held() { Err(Error::NotIdle) } else { Ok(()) }
    }

    fn home(&mut self, axis: Option<Axis>) -> Result<(), Error> {
        if !self.m.settings.is_on(Key::Homing) {
            return Err(Error::HomingDisabled);
        }
        self.must_hold_nothing()?;
        if axis.is_some_and(|axis| self.dialect() == Dialect::Grbl || axis.index() >= self.m.settings.axes_in_use()) {
            return Err(Error::InvalidStatement);
        }
        if self.m.inputs.signals().door {
            return Err(Error::DoorOpen);
        }
        if let Some((_, error)) = self.m.inputs.emergency() {
            return Err(error);
        }
        if let Some(error) = self.motion_locked() {
            return Err(error);
        }
        let (homing, next) = Homing::begin(axis, &mut self.m)?;
        self.enter(State::Homing(homing));
        self.follow(next);
        Ok(())
    }

    fn set_setting(&mut self, number: u16, value: Decimal) -> Result<(), Error> {
        if number == DIALECT {
            self.must_hold_nothing()?;
        }
        let (value, zero_at_pull_off) =
            if self.speaks_grblhal() { self.take_mask(number, value)? } else { (value, None) };
        // The table of settings has the widest limits of all boards, so the limits of this board are checked here.
        let least_pulse = i64::from(self.m.settings_lock.least_pulse_tenths()) * (DECIMAL_ONE / 10);
        if number == STEP_PULSE && (0..least_pulse).contains(&value.0) {
            return Err(Error::StepPulseTooShort);
        }
        let accepted = if number == BAUD && i64::from(value.truncate()) > i64::from(self.m.settings_lock.most_baud()) {
            Err(Error::SettingOutOfRange)
        } else {
            self.m.settings.accepted(number, value)
        };
        if FULL_IMAGE && accepted == Err(Error::SettingOutOfRange) {
            self.tell_values(number);
        }
        if accepted? != 0.0 {
            match number {
                DOOR_FITTED if self.m.inputs.pins().door => return Err(Error::DoorOpen),
                // The door and the reset button have an effect only when their input *becomes* active. A door that is
                // open already would cause no stop after the change, and a pressed button no alarm. So the setting is
                // refused while its input is active.
                RESET_IS_EMERGENCY_STOP if self.m.inputs.pins().reset => return Err(Error::EmergencyStop),
                _ => {}
            }
        }
        let dialect = self.dialect();
        if let Some(on) = zero_at_pull_off.filter(|on| *on != self.m.settings.is_on(Key::ZeroAtPullOff)) {
            self.change_setting(ZERO_AT_PULL_OFF, Decimal::from_int(on.into()))?;
        }
        self.change_setting(number, value)?;
        if self.dialect() != dialect {
            self.m.interpreter.change_dialect();
            self.end_check();
            // A rotated coordinate system also turns the G92 offset, but Grbl's dialect ignores rotations. So a change
            // of dialect can change the work offset.
            self.m.replies.offset_changed();
            self.apply_overrides();
        }
        self.task = Task::Storing(Answer::Setting(number));
        Ok(())
    }

    /// Sets a setting to a value that has been accepted, hands the value to the store, and carries out the other
    /// effects of the change. The effects of a change of dialect are left to the caller. The caller also waits until
    /// the value is stored.
    fn change_setting(&mut self, number: u16, value: Decimal) -> Result<(), Error> {
        let before = self.m.settings.by_number(number);
        let soft_limits = self.m.settings.is_on(Key::SoftLimits);
        self.m.settings.set(number, value)?;
        let is_other = self.m.settings.by_number(number) != before;
        // The new value gives the same S another power, so the spindle is stopped.
        if is_other && matches!(number, SPINDLE_MAXIMUM | SPINDLE_MINIMUM | LASER) {
            self.m.stop_spindle();
        }
        self.follow_setting(number, soft_limits);
        if is_other {
            self.rename_places(number);
        }
        Ok(())
    }

    /// Updates the values that depend on a changed setting, and stores the setting. `soft_limits`: `true` if soft
    /// limits were on before the change.
    fn follow_setting(&mut self, number: u16, soft_limits: bool) {
        self.reconfigure();
        // With another resolution (steps/mm), the present step counts stand for another position.
        self.m.interpreter.set_position(self.m.motion.machine_position());
        if matches!(number, REPORT_INCHES | AXES) {
            self.m.replies.offset_changed();
        }
        if number == HOMING {
            self.m.records.save_soft_limits_before_homing(&self.m.settings, soft_limits);
        }
        self.m.records.save_setting(number, &self.m.settings);
    }

    /// Marks the position as untrusted if the change of setting `number` has switched homing on, or has given the
    /// present position of the machine other coordinates. The machine must then be homed again. After a change of
    /// resolution or kinematics, also ends a series of canned cycles.
    fn rename_places(&mut self, number: u16) {
        let to_negative = AxisMask(self.m.settings.whole(Key::HomingDirection) as u8);
        let moves_places = AxisKey::Resolution.axis(number).is_some() || number == KINEMATICS;
        let zero_at_pull_off = self.m.settings.is_on(Key::ZeroAtPullOff);
        let renames_places = matches!(number, DIRECTION_INVERT | HOMING_DIRECTION | HOMING | AXES | ZERO_AT_PULL_OFF)
            || number == HOMING_PULL_OFF && zero_at_pull_off
            || AxisKey::Travel.axis(number).is_some_and(|axis| to_negative.has(axis) && !zero_at_pull_off);
        if moves_places {
            self.m.interpreter.end_cycles();
        }
        if moves_places || renames_places && self.m.settings.is_on(Key::Homing) {
            self.m.reference.lose();
        }
    }

    fn toggle_check_mode(&mut self) -> Result<(), Error> {
        match self.state {
            State::Check => {
                self.say(|out| reply_texts::message(out, "Disabled"));
                self.say_ok();
                self.m.interpreter.end_check_mode();
                self.enter(State::Normal);
                self.initialise();
            }
            State::Normal if self.m.motion.is_idle() => {
                self.must_hold_nothing()?;
                self.enter(State::Check);
                self.m.interpreter.begin_check_mode(self.dialect());
                self.say(|out| reply_texts::message(out, "Enabled"));
                self.say_ok();
            }
            _ => return Err(Error::NotIdle),
        }
        Ok(())
    }

    fn unlock(&mut self) -> Result<(), Error> {
        self.m.interpreter.unlock(self.state.is_alarm(), self.m.has_rested());
        if let State::Alarm(_) = self.state {
            if self.m.settings_lock.has_board_fault() {
                self.say(|out| reply_texts::message(out, "The board cannot be used: $RC tells why"));
                return Err(Error::Locked);
            }
            if self.m.inputs.signals().door {
                return Err(Error::DoorOpen);
            }
            if let Some((_, error)) = self.m.inputs.emergency() {
                return Err(error);
            }
            let damaged = self.m.records.are_damaged();
            if damaged && !self.m.records.confirm(self.m.now, &self.m.settings) {
                self.tell_damage();
                return Err(Error::StoreReadFailed);
            }
            self.enter(State::Normal);
            let unlocked = "Caution: Unlocked";
            let lost = "The position may be lost: home before using machine coordinates";
            let is_lost = !self.m.reference.is_trusted() && self.dialect() != Dialect::Grbl;
            // ioSender takes the message that follows `Caution: Unlocked` for the reason of the alarm. So with
            // `$900=3`, `Caution: Unlocked` is sent last.
            let told = if self.speaks_grblhal() { [lost, unlocked] } else { [unlocked, lost] };
            for text in told.into_iter().filter(|text| is_lost || *text != lost) {
                self.say(|out| reply_texts::message(out, text));
            }
            if damaged {
                self.task = Task::Storing(Answer::Host);
                return Ok(());
            }
        }
        self.say_ok();
        Ok(())
    }

    fn restore_defaults(&mut self, what: Restore) {
        if matches!(what, Restore::Settings | Restore::All) {
            self.m.stop_spindle();
            let mut settings = Settings::default();
            settings.restore(Key::Dialect.number(), self.m.settings.value(Key::Dialect));
            let same_steps = settings.axes(AxisKey::Resolution) == self.m.settings.axes(AxisKey::Resolution)
                && settings.arrangement() == self.m.settings.arrangement();
            if !same_steps {
                self.m.reference.lose();
            }
            self.m.settings.replace(settings);
        }
        if matches!(what, Restore::Coordinates | Restore::All) {
            self.m.interpreter.clear_stored();
        }
        if what == Restore::All {
            self.m.interpreter.clear_macros();
        }
        self.m.records.forget(what);
        self.say(|out| reply_texts::message(out, "Restoring defaults"));
        self.m.interpreter.reset();
        self.task = Task::Storing(Answer::Restart);
    }
}
