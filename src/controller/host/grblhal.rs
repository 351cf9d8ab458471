//! Answers hosts as grblHAL does (`$900=3`): executes grblHAL's `$` commands, and converts values of the settings that
//! are masks in grblHAL.

use crate::axes::Axis;
use crate::dispatch::Controller;
use crate::error::Error;
use crate::gcode::Dialect;
use crate::protocol::grblhal::{self, Command};
use crate::protocol::reply_texts;
use crate::settings::{GrblHalMask, Key};
use crate::units::{DECIMAL_ONE, Decimal};
use crate::work::task::{Listing, Task};

impl<const N: usize> Controller<N> {
    /// Executes a command that exists only with `$900=3`. The caller has checked that the present state allows the
    /// command: `$LEV`, `$LIM` and `$PINSTATE` are always allowed, the others only in idle or alarm.
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
                // Without a probe contact there is no position for the reference. A reference that was set before
                // stays.
                let (place, true) = self.m.probe.result() else { return Err(Error::InvalidStatement) };
                self.m.interpreter.set_tool_reference(Some(place));
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
            Command::LastEvent | Command::Limits => {
                let ganged = self.m.settings.ganged_axis().map_or(b' ', Axis::letter);
                let (now, last) = (*self.m.inputs.signals(), *self.m.inputs.last_event());
                self.say(|out| match command {
                    Command::Limits => grblhal::limits(out, &now, &[ganged]),
                    _ => grblhal::last_event(out, &last, &[ganged]),
                });
                self.say_ok();
            }
            Command::OptionalStop => {
                self.toggle_optional_stop();
                self.say_ok();
            }
            Command::ProgramPins => {
                self.say_program_pins();
                self.say_ok();
            }
            Command::Ports => {
                let (stored, most) = (self.m.settings.whole(Key::Baud), self.m.settings_lock.most_baud());
                self.say(|out| grblhal::port(out, stored.min(most)));
                self.say_ok();
            }
        }
        Ok(())
    }

    /// Answers `$PINSTATE`: sends one line for each input and output of programs (M62 to M66).
    fn say_program_pins(&mut self) {
        let [outputs, inputs] = self.m.settings_lock.program_pins();
        let pins = self.m.inputs.pins().program;
        for number in 0..u32::from(inputs) {
            self.say(|out| grblhal::program_input(out, number, pins >> number & 1 != 0));
        }
        let levels = self.m.accessories.digital().levels();
        for number in 0..u32::from(outputs) {
            self.say(|out| grblhal::program_output(out, number, levels >> number & 1 != 0));
        }
    }

    /// Sends the list of commands, the answer to `$`.
    pub(crate) fn say_help(&mut self) {
        let grbl = self.dialect() == Dialect::Grbl;
        self.say(|out| reply_texts::help(out, grbl));
        if self.speaks_grblhal() {
            self.say(grblhal::help);
        }
    }

    /// Switches the pause at M1 on or off (0x88, `$O`), until power-off.
    pub(crate) fn toggle_optional_stop(&mut self) {
        self.toggle(Key::OptionalStop, ["Optional stop off", "Optional stop on"]);
    }

    /// Switches a setting on or off until power-off, without storing it. Sends the message of its new state: `states`
    /// has the message for off, then the one for on.
    fn toggle(&mut self, key: Key, states: [&'static str; 2]) {
        let is_on = !self.m.settings.is_on(key);
        self.m.settings.restore(key.number(), if is_on { 1.0 } else { 0.0 });
        let [off, on] = states;
        self.say(|out| reply_texts::message(out, if is_on { on } else { off }));
    }

    /// Converts `value`, which a host with `$900=3` writes to setting `number`, to the value that the setting has
    /// here. Two settings are masks of bits in grblHAL, but single values here; the value of any other setting stays
    /// as it is. The mask of `$22` also has a bit for `$932`. If this mask switches homing on, returns the value of
    /// `$932`, too.
    ///
    /// Some functions are always on here, so their bits are read back as set. For example, after `$22=1` a host reads
    /// `$22=199`. While homing is off, only the lowest bit of `$22` has an effect. If a host will read another value
    /// than it wrote, a message gives the value that it will read.
    ///
    /// # Errors
    /// [`Error::SettingOutOfRange`] for a bit that has no function here, after a message that names the bit.
    pub(crate) fn take_mask(&mut self, number: u16, value: Decimal) -> Result<(Decimal, Option<bool>), Error> {
        let Some(mask) = GrblHalMask::of(number) else { return Ok((value, None)) };
        let Ok(bits) = u32::try_from(value.truncate()) else { return Ok((value, None)) };
        if value.0 % DECIMAL_ONE != 0 {
            return Ok((value, None));
        }
        let unknown = bits & !mask.bits();
        if unknown != 0 {
            self.tell_values(number);
            self.say(|out| reply_texts::message_number(out, "Nothing does what these bits mean: ", unknown));
            return Err(Error::SettingOutOfRange);
        }
        let own = bits & mask.own;
        let all = mask.read_back(bits);
        if all != bits {
            self.say(|out| reply_texts::message_number(out, "Acts as ", all));
        }
        Ok((Decimal::from_int(own as i32), mask.zero_at_pull_off(bits)))
    }
}
