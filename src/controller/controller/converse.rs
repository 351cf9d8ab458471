//! Lines are dispatched and `$` commands answered.

use super::execute::{Answer, Task};
use super::outputs::dialect;
use super::{Controller, Damage, LOOKING, STORED_TEXT};
use crate::axes::{Axis, PerAxis};
use crate::error::Error;
use crate::gcode::{CoordinateSystem, Dialect, StoredOffset};
use crate::machine::state::Mode;
use crate::messages::{LINES_DEPTH, LineByte, PinView, Record, STORE_DAMAGED, Store, input};
use crate::protocol::line::{self, Pushed};
use crate::protocol::report::{self, ParserState};
use crate::protocol::system::{self, Allowed, Restore, System};
use crate::settings::{AxisKey, Key, Settings};
use crate::units::{Coordinate, Decimal};

/// Keys of stored records: a setting has its own number (0 to 999). What `$RST` forgets is one range, so that a power cut
/// finds all of it or nothing.
const KEY_OFFSETS: u16 = 1000;
const KEY_STARTUP: u16 = 1100;
const KEY_BUILD_INFO: u16 = 1200;
/// The dialect stands above what `$RST` forgets: it is how this host is spoken to.
const KEY_DIALECT: u16 = 2000;
/// Numbers of settings that are more than values.
const DIALECT: u16 = Key::Dialect.number();
const DOOR_FITTED: u16 = Key::DoorFitted.number();
const HOMING: u16 = Key::Homing.number();
const KINEMATICS: u16 = Key::Kinematics.number();
const REPORT_INCHES: u16 = Key::ReportInches.number();
const RESET_IS_EMERGENCY_STOP: u16 = Key::ResetIsEmergencyStop.number();
const SOFT_LIMITS: u16 = Key::SoftLimits.number();

/// An answer of many lines.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Listing {
    /// `$$`
    Settings,
    /// `$#`
    Parameters,
    /// `$N`
    StartupLines,
    /// `$PINS`
    Pins,
}

impl<const N: usize, const BLOCKS: usize> Controller<N, BLOCKS> {
    /// Takes a stored record at power-up. Records that make no sense are ignored.
    pub fn restore(&mut self, record: &Record) {
        match record.key {
            0..KEY_OFFSETS => {
                if let Ok(bytes) = record.value.as_slice().try_into() {
                    self.settings.restore(record.key, f32::from_le_bytes(bytes));
                }
            }
            KEY_OFFSETS..KEY_STARTUP => {
                let mut place = PerAxis::default();
                for (axis, bytes) in Axis::of_machine::<N>().zip(record.value.chunks_exact(8)) {
                    if let Ok(bytes) = bytes.try_into() {
                        place.set(axis, Coordinate(i64::from_le_bytes(bytes)));
                    }
                }
                if place.iter().all(|c| c.in_range())
                    && let Some(offset) = StoredOffset::all().nth(usize::from(record.key - KEY_OFFSETS))
                {
                    self.interpreter.offsets_mut().set_stored(offset, place);
                }
            }
            KEY_STARTUP..KEY_BUILD_INFO => {
                if let Some(line) = self.startup_lines.get_mut(usize::from(record.key - KEY_STARTUP)) {
                    *line = heapless::Vec::from_slice(&record.value).unwrap_or_default();
                }
            }
            KEY_BUILD_INFO => self.build_info = heapless::Vec::from_slice(&record.value).unwrap_or_default(),
            KEY_DIALECT => {
                if let Ok(bytes) = record.value.as_slice().try_into() {
                    self.settings.restore(DIALECT, f32::from_le_bytes(bytes));
                }
            }
            STORE_DAMAGED => self.damage = Damage::Untold,
            _ => {}
        }
    }

    // Bytes to lines

    pub(super) fn release_held(&mut self) {
        if let Some(byte) = self.lines.release() {
            self.line_byte(byte);
        }
    }

    pub(super) fn line_byte(&mut self, byte: LineByte) {
        let taken = self.lines.take(byte, || line_rules(&self.settings));
        if taken.lost {
            self.say(|out| report::message(out, "Received bytes lost"));
        }
        if taken.pushed != Pushed::More {
            // Realtime commands come before the lines received after them: so the report of a `?` comes before the answer.
            self.answer_status();
        }
        match taken.pushed {
            Pushed::More => {}
            Pushed::TooLong => {
                self.lines.clear();
                self.refuse(Error::LineTooLong);
                self.stop_at_error();
            }
            Pushed::Complete => {
                // Filled in its place: what is returned by value would be copied with all that it might hold.
                let mut text = heapless::Vec::<u8, { line::LENGTH }>::new();
                let _ = text.extend_from_slice(self.lines.text());
                if self.must_wait(&text) {
                    self.task = Task::JogWaits;
                } else {
                    self.lines.clear();
                    self.dispatch(&text);
                }
            }
        }
    }

    /// A jog behind a jog cancel begins once the machine has stopped, at the place where it stands then.
    fn must_wait(&self, line: &[u8]) -> bool {
        line.starts_with(b"$J=") && self.mode == (Mode::Jog { cancelling: true }) && self.lines.is_jog_behind_cancel()
    }

    /// The jog that has waited for the end of the one before it.
    #[inline(never)]
    pub(super) fn begin_waiting_jog(&mut self) {
        let mut text = heapless::Vec::<u8, { line::LENGTH }>::new();
        let _ = text.extend_from_slice(self.lines.text());
        self.lines.clear();
        self.task = Task::None;
        self.dispatch(&text);
    }

    fn refuse(&mut self, error: Error) {
        self.say(|out| report::error(out, error.code()));
    }

    fn dispatch(&mut self, line: &[u8]) {
        let result = match line.first() {
            None => {
                self.say(report::ok);
                Ok(())
            }
            // A tape mark; Grbl's dialect has none.
            Some(b'%') if self.dialect() != Dialect::Grbl => {
                self.say(report::ok);
                Ok(())
            }
            Some(b'$') => self.system(line),
            Some(_) if self.mode.is_alarm() || matches!(self.mode, Mode::Jog { .. }) => Err(Error::Locked),
            Some(_) => self.gcode(line, Answer::Host),
        };
        if let Err(error) = result {
            self.refuse(error);
            if line.first() != Some(&b'$') {
                self.stop_at_error();
            }
        }
    }

    /// A refused line ends the job, if that is wanted.
    fn stop_at_error(&mut self) {
        if self.settings.is_on(Key::StopOnError) && self.mode == Mode::Normal {
            self.stop_softly(true);
        }
    }

    fn gcode(&mut self, line: &[u8], answer: Answer) -> Result<(), Error> {
        self.interpreter.check_into(line, dialect(&self.settings), &mut self.checked)?;
        if let Some(error) = self.refuse_line() {
            return Err(error);
        }
        if self.leaves_travel() {
            self.motion.hold();
            self.task = Task::SoftLimit;
        } else {
            self.begin(answer, false);
        }
        Ok(())
    }

    fn jog(&mut self, line: &[u8]) -> Result<(), Error> {
        self.interpreter.check_jog_into(line, dialect(&self.settings), &mut self.checked)?;
        if self.lines.is_jog_stale() || self.mode == (Mode::Jog { cancelling: true }) {
            // Sent before the cancel: it shall not move any more.
            self.say(report::ok);
            return Ok(());
        }
        let clipped = self.settings.is_on(Key::JogClip);
        if clipped {
            self.clip_to_travel();
        }
        if let Some(error) = self.refuse_line() {
            return Err(error);
        }
        if !clipped && self.leaves_travel() {
            return Err(Error::JogOutsideTravel);
        }
        self.begin(Answer::Host, true);
        Ok(())
    }

    // Startup lines

    #[inline(never)]
    pub(super) fn run_startup_line(&mut self, index: usize, then: Option<Answer>) {
        let line = if self.mode.is_alarm() { None } else { self.startup_lines.get(index).cloned() };
        let Some(line) = line else {
            if let Some(answer) = then {
                self.finish(answer);
            }
            return;
        };
        if !line.is_empty() {
            self.say(|out| report::startup_echo(out, &line));
            match self.gcode(&line, Answer::Startup(index, then.is_some())) {
                Ok(()) => return,
                Err(error) => self.refuse(error),
            }
        }
        self.task = Task::Startup(index + 1, then);
    }

    pub(super) fn store_startup_line(&mut self, index: usize, line: heapless::Vec<u8, STORED_TEXT>) {
        self.save(KEY_STARTUP + index as u16, &line);
        if let Some(slot) = self.startup_lines.get_mut(index) {
            *slot = line;
        }
        self.task = Task::Storing(Answer::Host);
    }

    // `$` commands

    fn system(&mut self, line: &[u8]) -> Result<(), Error> {
        let resting = matches!(self.mode, Mode::Normal) && !self.running;
        let idle = resting && self.motion.is_idle();
        match system::allowed(line) {
            Allowed::AtRest if !(idle || self.mode == Mode::Alarm) => return Err(Error::NotIdle),
            Allowed::ForJog if !(idle || matches!(self.mode, Mode::Jog { .. })) => return Err(Error::NotIdle),
            _ => {}
        }
        match system::read(line)? {
            System::Help => {
                let grbl = self.dialect() == Dialect::Grbl;
                self.say(|out| report::help(out, grbl));
                self.say(report::ok);
            }
            System::Settings if self.mode == Mode::Normal && !idle => return Err(Error::NotIdle),
            System::Settings => self.task = Task::Listing(Listing::Settings, 0),
            System::Parameters => self.task = Task::Listing(Listing::Parameters, 0),
            System::StartupLines => self.task = Task::Listing(Listing::StartupLines, 0),
            System::ParserState => {
                self.report_parser_state();
                self.say(report::ok);
            }
            System::BuildInfo => {
                let info = self.build_info.clone();
                let letters = self.option_letters();
                self.say(|out| report::build_info(out, &info, &letters, BLOCKS, LINES_DEPTH));
                // Grbl has two lines, and strict senders count on it.
                if self.dialect() != Dialect::Grbl {
                    self.say(report::firmware);
                }
                self.say(report::ok);
            }
            System::SetBuildInfo(text) => {
                let text = heapless::Vec::from_slice(text).map_err(|_| Error::LineTooLong)?;
                self.save(KEY_BUILD_INFO, &text);
                self.build_info = text;
                self.task = Task::Storing(Answer::Host);
            }
            System::SetStartupLine(..) if self.mode != Mode::Normal => return Err(Error::NotIdle),
            System::SetStartupLine(index, text) => {
                let stored = heapless::Vec::from_slice(text).map_err(|_| Error::LineTooLong)?;
                if text.is_empty() {
                    self.store_startup_line(index, stored);
                } else {
                    self.validated = stored;
                    self.gcode(text, Answer::Validation(index))?;
                }
            }
            System::CheckMode => self.toggle_check_mode()?,
            System::Unlock => self.unlock()?,
            System::Home(_) if !self.settings.is_on(Key::Homing) => return Err(Error::HomingDisabled),
            System::Home(Some(axis)) if self.dialect() == Dialect::Grbl || axis.index() >= N => {
                return Err(Error::InvalidStatement);
            }
            System::Home(axis) => self.begin_homing(axis)?,
            System::Jog(text) => return self.jog(text),
            System::Restore(what) => self.restore_defaults(what),
            System::ResetCause => {
                let restart = self.restart.clone();
                self.restart_told = true;
                self.say(|out| report::restart(out, &restart));
                self.say(report::ok);
            }
            // Grbl takes the P for the number of a setting.
            System::Pins | System::ClearNoise if self.dialect() == Dialect::Grbl => return Err(Error::BadNumber),
            System::Pins => {
                self.pin_view = None;
                self.read_pins = Some(false);
                self.task = Task::Listing(Listing::Pins, 0);
            }
            System::ClearNoise => {
                self.read_pins = Some(true);
                self.say(report::ok);
            }
            System::Sleep => {
                self.say(report::ok);
                self.say(|out| report::message(out, "Sleeping"));
                self.fall_asleep();
            }
            System::Set(DOOR_FITTED, value) if value != Decimal::ZERO && self.pins.door => {
                return Err(Error::DoorOpen);
            }
            // As with the door: it would not be seen to become active.
            System::Set(RESET_IS_EMERGENCY_STOP, value) if value != Decimal::ZERO && self.pins.reset => {
                return Err(Error::EmergencyStop);
            }
            System::Set(number, value) => {
                let soft_limits = self.settings.is_on(Key::SoftLimits);
                self.settings.set(number, value)?;
                self.changed(number, soft_limits);
                self.task = Task::Storing(Answer::Setting(number));
            }
        }
        Ok(())
    }

    /// A setting has a new value: derived numbers follow, and it is stored. `soft_limits`: they were on before.
    fn changed(&mut self, number: u16, soft_limits: bool) {
        self.reconfigure();
        // Another resolution is another place for the same steps; homing that is switched on has not been done.
        self.interpreter.set_position(self.motion.machine_position());
        let is_resolution = AxisKey::Resolution.axis(number).is_some();
        if is_resolution || number == KINEMATICS || (number == HOMING && self.settings.is_on(Key::Homing)) {
            self.reference.lose();
        }
        if number == REPORT_INCHES {
            self.rare_fields.offset_changed();
        }
        if number == HOMING {
            self.store_soft_limits_before_homing(soft_limits);
        }
        self.save_setting(number);
    }

    /// `$20` is stored so that the record of `$22`, which follows, changes both at once: see `Settings::settle`.
    fn store_soft_limits_before_homing(&mut self, soft_limits: bool) {
        let record: f32 = match (self.settings.is_on(Key::Homing), soft_limits) {
            (true, true) => return,
            (false, true) => 1.0,
            (_, false) => 0.0,
        };
        self.save(SOFT_LIMITS, &record.to_le_bytes());
    }

    fn toggle_check_mode(&mut self) -> Result<(), Error> {
        match self.mode {
            Mode::Check => {
                self.say(|out| report::message(out, "Disabled"));
                self.say(report::ok);
                self.interpreter.reset();
                self.mode = Mode::Normal;
                self.initialise();
            }
            Mode::Normal if self.motion.is_idle() => {
                self.mode = Mode::Check;
                self.say(|out| report::message(out, "Enabled"));
                self.say(report::ok);
            }
            _ => return Err(Error::NotIdle),
        }
        Ok(())
    }

    fn unlock(&mut self) -> Result<(), Error> {
        if self.mode == Mode::Alarm {
            if self.signals.door {
                return Err(Error::DoorOpen);
            }
            if let Some((_, error)) = self.emergency_now() {
                return Err(error);
            }
            let damaged = self.is_store_damaged();
            if damaged {
                self.confirm_damage()?;
            }
            self.mode = Mode::Normal;
            self.alarm = None;
            self.say(|out| report::message(out, "Caution: Unlocked"));
            if !self.reference.is_trusted() && self.dialect() != Dialect::Grbl {
                self.say(|out| report::message(out, "The position may be lost: home before using machine coordinates"));
            }
            if damaged {
                self.task = Task::Storing(Answer::Host);
                return Ok(());
            }
        }
        self.say(report::ok);
        Ok(())
    }

    /// The settings are right as they are, says somebody who has had time to look at them: the store forgets its damage.
    fn confirm_damage(&mut self) -> Result<(), Error> {
        if !matches!(self.damage, Damage::Listed(at) if self.now >= at + LOOKING) {
            self.tell_damage();
            return Err(Error::StoreReadFailed);
        }
        self.damage = Damage::None;
        self.forget(STORE_DAMAGED..STORE_DAMAGED + 1);
        Ok(())
    }

    fn restore_defaults(&mut self, what: Restore) {
        if matches!(what, Restore::Settings | Restore::All) {
            let mut settings = Settings::default();
            settings.restore(DIALECT, self.settings.value(Key::Dialect));
            let same_steps = settings.axes(AxisKey::Resolution) == self.settings.axes(AxisKey::Resolution)
                && settings.arrangement() == self.settings.arrangement();
            if !same_steps {
                self.reference.lose();
            }
            self.settings.replace(settings);
        }
        if matches!(what, Restore::Coordinates | Restore::All) {
            self.interpreter.offsets_mut().clear_stored();
        }
        if what == Restore::All {
            self.startup_lines = [heapless::Vec::new(), heapless::Vec::new()];
            self.build_info.clear();
        }
        self.forget(match what {
            Restore::Settings => 0..KEY_OFFSETS,
            Restore::Coordinates => KEY_OFFSETS..KEY_STARTUP,
            Restore::All => 0..KEY_DIALECT,
        });
        self.say(|out| report::message(out, "Restoring defaults"));
        self.interpreter.reset();
        self.task = Task::Storing(Answer::Restart);
    }

    // The store

    /// At most two of these come from one command, and the next is read when they are answered: there is room.
    fn hand_to_store(&mut self, store: Store) {
        if self.profile.has_store && self.stores.push_back(store).is_ok() {
            self.unstored += 1;
        }
    }

    fn save(&mut self, key: u16, value: &[u8]) {
        if let Ok(value) = heapless::Vec::from_slice(value) {
            self.hand_to_store(Store::Put(Record { key, value }));
        }
    }

    fn forget(&mut self, keys: core::ops::Range<u16>) {
        self.hand_to_store(Store::Remove { from: keys.start, until: keys.end });
    }

    fn save_setting(&mut self, number: u16) {
        if let Some(value) = self.settings.by_number(number) {
            let key = if number == DIALECT { KEY_DIALECT } else { number };
            self.save(key, &value.to_le_bytes());
        }
    }

    #[inline(never)]
    pub(super) fn store_offset(&mut self, offset: StoredOffset) {
        let place = self.interpreter.offsets().stored(offset);
        let mut bytes: heapless::Vec<u8, 48> = heapless::Vec::new();
        for value in place.iter() {
            let _ = bytes.extend_from_slice(&value.0.to_le_bytes());
        }
        if let Some(index) = StoredOffset::all().position(|o| o == offset) {
            self.save(KEY_OFFSETS + index as u16, &bytes);
        }
    }

    // Answers

    /// What `$I` says is switched on, in Grbl's letters and their order.
    fn option_letters(&self) -> heapless::Vec<u8, 12> {
        let own = self.dialect() != Dialect::Grbl;
        let on = |key| self.settings.is_on(key);
        [
            (true, b'V'),
            (own, b'N'),
            (own, b'M'),
            (on(Key::Kinematics), b'C'),
            (on(Key::Parking), b'P'),
            (own, b'H'),
            (own && on(Key::Parking), b'R'),
            (on(Key::DoorFitted), b'+'),
            (on(Key::GangedAxis), b'2'),
        ]
        .into_iter()
        .filter_map(|(on, letter)| on.then_some(letter))
        .collect()
    }

    #[inline(never)]
    pub(super) fn go_on_listing(&mut self, listing: Listing, line: usize) -> bool {
        if !self.has_reply_room() {
            return false;
        }
        let more = match listing {
            Listing::Settings => self.list_setting(line),
            Listing::Parameters => self.list_parameter(line),
            Listing::Pins => match self.pin_view {
                Some(view) => self.list_pin(&view, line),
                None => return false,
            },
            Listing::StartupLines => match self.startup_lines.get(line).cloned() {
                Some(text) => {
                    self.say(|out| report::startup_line(out, line, &text));
                    true
                }
                None => false,
            },
        };
        if more {
            self.task = Task::Listing(listing, line + 1);
        } else {
            self.task = Task::None;
            if listing == Listing::Settings && self.is_store_damaged() {
                self.damage = Damage::Listed(self.now);
                self.say(|out| report::message(out, "Compare with your notes; 2 s later $X confirms"));
            }
            self.say(report::ok);
        }
        true
    }

    fn list_setting(&mut self, line: usize) -> bool {
        let Some((entry, number, value)) = self.settings.row(line) else { return false };
        if entry.grbl || self.dialect() != Dialect::Grbl {
            self.say(|out| report::setting(out, &entry, number, value));
        }
        true
    }

    fn list_pin(&mut self, view: &PinView, bit: usize) -> bool {
        if view.fitted >> bit & 1 != 0 {
            let (active, wiring) = (self.pins.word() >> bit & 1 != 0, self.input_wiring);
            self.say(|out| report::pin(out, bit, view, active, &wiring));
        }
        bit + 1 < input::COUNT
    }

    fn list_parameter(&mut self, line: usize) -> bool {
        let inches = self.settings.is_on(Key::ReportInches);
        let systems =
            if self.dialect() == Dialect::Grbl { CoordinateSystem::OF_GRBL } else { CoordinateSystem::ALL.len() };
        let offsets = *self.interpreter.offsets();
        if let Some(system) = CoordinateSystem::ALL.get(..systems).and_then(|all| all.get(line)) {
            self.say(|out| report::parameter(out, system.word(), &offsets.system(*system), inches));
            return true;
        }
        match line - systems {
            0 => self.say(|out| report::parameter(out, "G28", &offsets.stored(StoredOffset::G28), inches)),
            1 => self.say(|out| report::parameter(out, "G30", &offsets.stored(StoredOffset::G30), inches)),
            2 => self.say(|out| report::parameter(out, "G92", &offsets.g92, inches)),
            3 => self.say(|out| report::tool_length(out, offsets.tool_length, inches)),
            4 => {
                let (place, success) = (self.probed, self.probe_succeeded);
                self.say(|out| report::probe(out, &place, success, inches));
            }
            _ => return false,
        }
        true
    }

    fn report_parser_state(&mut self) {
        let modal = self.interpreter.modal();
        let state = ParserState {
            words: [
                modal.motion.word(),
                modal.coordinate_system.word(),
                modal.plane.word(),
                modal.units.word(),
                modal.distance.word(),
                modal.feed_mode.word(),
            ],
            spindle: modal.spindle,
            coolant: modal.coolant,
            parking: self.settings.is_on(Key::Parking) && !modal.no_parking && self.dialect() != Dialect::Grbl,
            tool: u32::from(modal.tool),
            feed: modal.feed.to_f32(),
            speed: modal.speed,
        };
        let inches = self.settings.is_on(Key::ReportInches);
        self.say(|out| report::parser_state(out, &state, inches));
    }
}

/// How lines are read.
fn line_rules<const N: usize>(settings: &Settings<N>) -> line::Rules {
    match dialect(settings) {
        Dialect::Grbl => line::Rules { length: line::GRBL_LENGTH, merge_crlf: false, nested_remarks: false },
        dialect => line::Rules { length: line::LENGTH, merge_crlf: true, nested_remarks: dialect == Dialect::Seed },
    }
}
