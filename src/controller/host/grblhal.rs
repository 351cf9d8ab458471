//! Answers hosts like grblHAL (`$900=3`): its `$` commands, its build info, settings that are masks there, and the
//! fields that only its status reports have.

use crate::dispatch::Controller;
use crate::error::Error;
use crate::gcode::TOOLS;
use crate::messages::{PinView, SpindleDirection};
use crate::protocol::grblhal::{self, Command, Identity};
use crate::protocol::reply_texts;
use crate::protocol::status_report::GrblHalFields;
use crate::settings::{GrblHalMask, Key};
use crate::states::State;
use crate::units::{DECIMAL_ONE, Decimal};
use crate::work::task::{Listing, Stage, Task};

/// Number of the alarm with which grblHAL asks for homing. Only full reports have it.
const HOMING_REQUIRED: u8 = 11;

impl<const N: usize> Controller<N> {
    /// Executes a command that Grbl and Oxmill lack. Such a command is allowed in idle or alarm.
    #[inline(never)]
    pub(crate) fn grblhal_command(&mut self, command: Command) -> Result<(), Error> {
        match command {
            Command::Settings => self.task = Task::Listing(Listing::Settings, 0),
            Command::Table(what) => self.task = Task::Listing(Listing::Descriptions(what), 0),
            Command::Help => {
                self.say_help();
                self.say_ok();
            }
            Command::Describe(number) => {
                let row = self.described(number).ok_or(Error::InvalidStatement)?;
                self.say_description(row);
                self.say_ok();
            }
            Command::Spindles { in_fields } => {
                let settings = &self.m.settings;
                let speeds = [Key::SpindleMinimum, Key::SpindleMaximum].map(|key| settings.value(key));
                let reports_speed = settings.is_on(Key::AtSpeed);
                self.say(|out| grblhal::spindle(out, in_fields, reports_speed, speeds));
                self.say_ok();
            }
            Command::ToolReference => {
                if !self.measures_tools() {
                    return Err(Error::InvalidStatement);
                }
                let (place, success) = self.m.probe.result();
                self.m.interpreter.set_tool_reference(success.then_some(place));
                self.say_ok();
            }
            Command::SingleBlock => {
                self.line.toggle_single_block();
                self.tell_single_block();
                self.say_ok();
            }
            Command::BlockDelete => {
                self.toggle(Key::BlockDelete, ["Block delete off", "Block delete on"]);
                self.say_ok();
            }
            Command::OptionalStop => {
                self.toggle_optional_stop();
                self.say_ok();
            }
        }
        Ok(())
    }

    /// Switches the pause at M1 on or off (0x88, `$O`), until power-off.
    pub(crate) fn toggle_optional_stop(&mut self) {
        self.toggle(Key::OptionalStop, ["Optional stop off", "Optional stop on"]);
    }

    /// Switches a setting on or off without storing it, and reports its new state.
    fn toggle(&mut self, key: Key, states: [&'static str; 2]) {
        let is_on = !self.m.settings.is_on(key);
        self.m.settings.restore(key.number(), if is_on { 1.0 } else { 0.0 });
        let [off, on] = states;
        self.say(|out| reply_texts::message(out, if is_on { on } else { off }));
    }

    /// Answers `$I` and `$I+`.
    #[inline(never)]
    pub(crate) fn report_identity(&mut self, pins: &PinView) {
        let user = self.m.records.build_info().clone();
        let (letters, settings, lock) = (self.option_letters(), &self.m.settings, &self.m.settings_lock);
        let this = Identity {
            user: &user,
            letters: &letters,
            blocks: self.m.motion.blocks(),
            axes: settings.axes_in_use(),
            tools: TOOLS,
            homing: settings.is_on(Key::Homing),
            changes_tools: self.m.prompts_for_tools(),
            pins,
            board: lock.board(),
            has_store: self.m.records.has_store(),
            step_rate: lock.greatest_hz(settings),
            program_pins: lock.program_pins(),
        };
        self.say(|out| grblhal::options(out, &this));
        self.say(|out| grblhal::equipment(out, &this));
    }

    /// Takes a value for a setting that is a mask in grblHAL. Returns the value that the setting has here. A bit that
    /// acts always need not be written; a message tells if it is read back all the same.
    ///
    /// # Errors
    /// [`Error::SettingOutOfRange`] for a bit that nothing does, after a message that names it.
    pub(crate) fn take_mask(&mut self, number: u16, value: Decimal) -> Result<Decimal, Error> {
        let Some(mask) = GrblHalMask::of(number) else { return Ok(value) };
        let Ok(bits) = u32::try_from(value.truncate()) else { return Ok(value) };
        if value.0 % DECIMAL_ONE != 0 {
            return Ok(value);
        }
        let unknown = bits & !mask.bits();
        if unknown != 0 {
            self.tell_values(number);
            self.say(|out| reply_texts::message_number(out, "Nothing does what these bits mean: ", unknown));
            return Err(Error::SettingOutOfRange);
        }
        let own = bits & mask.own;
        if let Some(on) = mask.zero_at_pull_off(bits)
            && on != self.m.settings.is_on(Key::ZeroAtPullOff)
        {
            self.change_setting(Key::ZeroAtPullOff.number(), Decimal::from_int(on.into()))?;
        }
        if !mask.is_read_back(bits) {
            let all = self.m.settings.shown_to_grblhal(number, own as f32) as u32;
            self.say(|out| reply_texts::message_number(out, "Some bits always act, so this is ", all));
        }
        Ok(Decimal::from_int(own as i32))
    }

    /// Whether M6 waits for the operator.
    pub(crate) fn waits_for_tool(&mut self) -> bool {
        let Task::Job(job) = self.task else { return false };
        matches!(self.state, State::Hold(_))
            && match job.stage {
                Stage::ToolChange => true,
                Stage::Measuring => self.line.change().waits_for().is_some(),
                _ => false,
            }
    }

    /// Returns the fields that only grblHAL's reports have.
    pub(crate) fn grblhal_fields(&mut self, full: bool, spindle: SpindleDirection) -> GrblHalFields {
        let is_homing_on = self.m.settings.is_on(Key::Homing);
        let reference = self.m.reference;
        let alarm = match self.state {
            State::Alarm(None) if is_homing_on && !reference.is_trusted() => HOMING_REQUIRED,
            _ => self.state.alarm().map_or(0, |alarm| alarm.code()),
        };
        GrblHalFields {
            full,
            alarm,
            system: self.m.interpreter.modal().coordinate_system.word(),
            tool: self.m.interpreter.spindle_tool(),
            homed: is_homing_on.then_some((reference.is_trusted(), reference.homed_axes().0)),
            has_reference: self.m.interpreter.tool_reference().is_some(),
            waits_for_tool: self.waits_for_tool(),
            spindle,
            coolant: self.m.accessories.coolant(),
        }
    }
}
