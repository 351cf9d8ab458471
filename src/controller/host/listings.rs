//! Answers of many lines, which are sent one line per call, and answers of many fields: settings `$$`, parameters `$#`,
//! startup lines `$N`, macros `$M`, pins `$PINS`, descriptions `$ES`, build info `$I`, and the parser state `$G`.

use crate::axes::{Axis, LINEAR, PerAxis};
use crate::dispatch::Controller;
use crate::gcode::{Angle, CoordinateSystem, Dialect, FeedMode, StoredOffset, TOOLS};
use crate::host::stored::STORED_TEXT;
use crate::image::FULL_IMAGE;
use crate::messages::{LINES_DEPTH, PinView, SECOND_SWITCH, input};
use crate::protocol::descriptions::{self, Limits};
use crate::protocol::grblhal::{self, Identity};
use crate::protocol::reply_texts::{self, ParserState, PlaceForm};
use crate::protocol::system::Described;
use crate::settings::{self, Key, Row, Settings};
use crate::units::Coordinate;
use crate::work::task::{Ask, Listing, Task};

impl<const N: usize> Controller<N> {
    #[inline(never)]
    pub(crate) fn advance_listing(&mut self, listing: Listing, line: usize) -> bool {
        if !self.m.replies.has_room() {
            return false;
        }
        let more = match listing {
            Listing::Recording(Ask::Wanted) if FULL_IMAGE => {
                self.task = Task::Listing(Listing::Recording(Ask::Due), line);
                return true;
            }
            Listing::Recording(_) => return false,
            Listing::Settings => self.list_setting(line),
            Listing::Parameters => self.list_parameter(line),
            Listing::Pins => match self.m.inputs.view() {
                Some(view) => self.list_pin(&view, line),
                None => return false,
            },
            Listing::Identity => match self.m.inputs.view() {
                Some(view) if FULL_IMAGE => {
                    self.report_identity(&view);
                    false
                }
                _ => return false,
            },
            Listing::Descriptions(what) => FULL_IMAGE && self.describe(what, line),
            Listing::Macros => {
                match self.m.interpreter.macro_line(line).map(heapless::Vec::<u8, STORED_TEXT>::from_slice) {
                    Some(text) => {
                        let text = text.unwrap_or_default();
                        if !text.is_empty() {
                            self.say(|out| reply_texts::kept_line(out, b'M', line, &text));
                        }
                        true
                    }
                    None => false,
                }
            }
            Listing::StartupLines => match self.m.records.startup_line(line).cloned() {
                Some(text) => {
                    self.say(|out| reply_texts::kept_line(out, b'N', line, &text));
                    true
                }
                None => false,
            },
        };
        if more {
            self.task = Task::Listing(listing, line + 1);
        } else {
            self.task = Task::None;
            if listing == Listing::Settings && self.m.records.listed(self.m.now) {
                self.say(|out| reply_texts::message(out, "Compare with your notes, wait 2 s, then send $X"));
            }
            self.say_ok();
        }
        true
    }

    /// Sends the row of tool `number`, 1 to [`TOOLS`]. As in grblHAL, a tool without stored offsets has a row, too,
    /// because gSender looks up the tool in the spindle after a probe contact. That tool can have a number above
    /// [`TOOLS`] and no stored offsets. In that case its row follows the last one.
    fn list_tool_of_grblhal(&mut self, number: u32, form: PlaceForm) {
        let entries = self.m.interpreter.tools().entries();
        let stored = |number| entries.iter().find(|tool| tool.is_stored() && tool.number == number);
        let offset = stored(number).map_or(PerAxis::all(Coordinate::ZERO), |tool| tool.offset);
        let own = self.m.interpreter.spindle_tool();
        let is_beyond = number == TOOLS as u32 && own > number && stored(own).is_none();
        self.say(|out| reply_texts::tool(out, number, &offset, form));
        if is_beyond {
            self.say(|out| reply_texts::tool(out, own, &PerAxis::<_, N>::all(Coordinate::ZERO), form));
        }
    }

    fn list_setting(&mut self, line: usize) -> bool {
        let Some((entry, number, value)) = self.m.settings.row(line) else { return false };
        let value = if self.speaks_grblhal() { self.m.settings.shown_to_grblhal(number, value) } else { value };
        if entry.grbl || self.dialect() != Dialect::Grbl {
            self.say(|out| reply_texts::setting(out, &entry, number, value));
        }
        true
    }

    fn list_parameter(&mut self, line: usize) -> bool {
        let form = self.place_form();
        let systems =
            if self.dialect() == Dialect::Grbl { CoordinateSystem::OF_GRBL } else { CoordinateSystem::ALL.len() };
        let offsets = *self.m.interpreter.offsets();
        if let Some(system) = CoordinateSystem::ALL.get(..systems).and_then(|all| all.get(line)) {
            self.say(|out| reply_texts::parameter(out, system.word(), &offsets.system(*system), form));
            return true;
        }
        match line - systems {
            0 => self.say(|out| reply_texts::parameter(out, "G28", &offsets.stored(StoredOffset::G28), form)),
            1 => self.say(|out| reply_texts::parameter(out, "G30", &offsets.stored(StoredOffset::G30), form)),
            2 => self.say(|out| reply_texts::parameter(out, "G92", &offsets.g92, form)),
            3 => self.say(|out| reply_texts::tool_length(out, &offsets.tool_length, form)),
            4 => {
                let (position, success) = self.m.probe.result();
                self.say(|out| reply_texts::probe(out, &position, success, form));
                if self.speaks_grblhal()
                    && let Some(height) = self.m.interpreter.tool_reference()
                {
                    self.say(|out| grblhal::tool_reference(out, height, form.inches));
                }
            }
            entry if self.dialect() != Dialect::Grbl && entry < TOOLS + 5 => {
                if let Some(tool) = self.m.interpreter.tools().entries().get(entry - 5).copied()
                    && tool.is_stored()
                    && !(self.speaks_grblhal() && tool.number <= TOOLS as u32)
                {
                    self.say(|out| reply_texts::tool(out, tool.number, &tool.offset, form));
                }
                if self.speaks_grblhal() {
                    self.list_tool_of_grblhal(entry as u32 - 4, form);
                }
            }
            entry if self.dialect() != Dialect::Grbl && FULL_IMAGE => {
                let Some(system) = CoordinateSystem::ALL.get(entry - TOOLS - 5) else { return false };
                let angle = offsets.angle(*system);
                if angle != Angle::ZERO {
                    self.say(|out| reply_texts::rotation(out, system.word(), angle.degrees()));
                }
            }
            _ => return false,
        }
        true
    }

    fn list_pin(&mut self, view: &PinView, bit: usize) -> bool {
        // The limit switch of an unused axis is not listed. On a machine with more than three axes, the second motor's
        // switch is not listed either.
        let axes = self.m.settings.axes_in_use();
        let counts =
            if bit < Axis::ALL.len() { bit < axes } else { axes <= LINEAR || 1 << bit != SECOND_SWITCH as usize };
        if counts && view.fitted >> bit & 1 != 0 {
            let (active, wiring) = (self.m.inputs.pins().word() >> bit & 1 != 0, self.m.inputs.wiring());
            let grblhal = self.speaks_grblhal();
            self.say(|out| reply_texts::pin(out, bit, view, active, &wiring, grblhal));
        }
        bit + 1 < input::COUNT
    }

    fn describe(&mut self, what: Described, line: usize) -> bool {
        let axes = self.m.settings.axes_in_use();
        let is_there = line < descriptions::lines(what, axes, self.speaks_grblhal());
        if is_there {
            let limits = self.limits();
            self.say(|out| descriptions::line::<N>(out, what, line, axes, limits));
        }
        is_there
    }

    /// Returns the limits of this board and dialect, which narrow the ranges in the table of settings.
    fn limits(&self) -> Limits {
        Limits {
            least_pulse_tenths: self.m.settings_lock.least_pulse_tenths(),
            most_baud: self.m.settings_lock.most_baud(),
            grblhal: self.speaks_grblhal(),
        }
    }

    /// Returns the row of a setting, with its range on this board and in this dialect; `None` if this machine does not
    /// have the setting.
    pub(crate) fn described(&self, number: u16) -> Option<Row> {
        let axes = self.m.settings.axes_in_use();
        let mut rows = (0..settings::lines(axes)).filter_map(|line| Settings::<N>::described(line, axes));
        rows.find(|row| row.number == number).map(|row| descriptions::narrowed(row, self.limits()))
    }

    /// Sends `[SETTINGDESCR:...]`, the name and the values of one setting.
    pub(crate) fn say_description(&mut self, row: Row) {
        self.say(|out| descriptions::of_setting(out, &row));
    }

    /// Sends the values that a setting accepts, after a host has tried to set a value that is not allowed.
    #[inline(never)]
    pub(crate) fn tell_values(&mut self, number: u16) {
        if let Some(row) = self.described(number) {
            self.say(|out| descriptions::values_of(out, &row));
        }
    }

    /// Answers `$I`, or `$I+` with the options that a sender may query.
    pub(crate) fn report_build_info(&mut self, with_options: bool) {
        const OPTIONS: &[&str] = if FULL_IMAGE { &["ENUMS", "EXPR"] } else { &[] };
        let info = self.m.records.build_info().clone();
        let (letters, blocks) = (self.option_letters(), self.m.motion.blocks());
        self.say(|out| reply_texts::build_info(out, &info, &letters, blocks, LINES_DEPTH));
        // In Grbl's dialect the answer has only two lines, because strict senders rely on that.
        if self.dialect() != Dialect::Grbl {
            self.say(reply_texts::firmware);
        }
        if with_options {
            let axes = self.m.settings.axes_in_use();
            self.say(|out| reply_texts::more_options(out, axes, OPTIONS));
            let lock = &self.m.settings_lock;
            let (board, oscillator_mhz) = (lock.board(), lock.oscillator_mhz());
            self.say(|out| reply_texts::board(out, board, oscillator_mhz));
        }
        self.say_ok();
    }

    /// Answers `$I` and `$I+` with `$900=3`.
    fn report_identity(&mut self, pins: &PinView) {
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

    /// Returns the options that `$I` shows as enabled, in Grbl's letters and order.
    fn option_letters(&self) -> heapless::Vec<u8, 12> {
        let own = self.dialect() != Dialect::Grbl;
        let on = |key| self.m.settings.is_on(key);
        let mut letters = heapless::Vec::new();
        for (on, letter) in [
            (true, b'V'),
            (own, b'N'),
            (own, b'M'),
            (on(Key::Kinematics), b'C'),
            (on(Key::Parking), b'P'),
            (own, b'H'),
            (own && on(Key::Parking), b'R'),
            (on(Key::DoorFitted), b'+'),
            (on(Key::GangedAxis), b'2'),
        ] {
            let _ = if on { letters.push(letter) } else { Ok(()) };
        }
        letters
    }

    /// Sends the parser state, the answer to `$G`, without `ok`.
    pub(crate) fn say_parser_state(&mut self) {
        let modal = self.m.interpreter.modal();
        let zero = PerAxis::all(Coordinate::ZERO);
        let offsets = self.m.interpreter.offsets();
        // From these two words, ioSender reads whether a G92 offset and a tool length offset are active.
        let (g92, length) = match self.speaks_grblhal() {
            true => {
                (if offsets.g92 == zero { "" } else { "G92" }, if offsets.tool_length == zero { "G49" } else { "G43" })
            }
            false => ("", ""),
        };
        let state = ParserState {
            words: [
                modal.motion.word(),
                modal.coordinate_system.word(),
                g92,
                modal.plane.word(),
                modal.units.word(),
                modal.distance.word(),
                modal.feed_mode.word(),
                length,
            ],
            rotation: self.m.interpreter.rotation().is_some(),
            // With `$900=3`, the field `Sc` of the status report shows scaling instead.
            scaling: self.m.interpreter.scaling().is_some() && !self.speaks_grblhal(),
            calls: self.m.interpreter.has_modal_call() && !self.speaks_grblhal(),
            blends: self.m.interpreter.modal().path.tolerance().is_some(),
            spindle: modal.spindle,
            coolant: modal.coolant,
            parking: self.m.settings.is_on(Key::Parking) && !modal.no_parking && self.dialect() != Dialect::Grbl,
            tool: if self.speaks_grblhal() { self.m.interpreter.spindle_tool() } else { modal.tool },
            feed: modal.feed.to_f32(),
            per_revolution: modal.feed_mode == FeedMode::PerRevolution,
            speed: modal.speed,
        };
        let inches = self.m.settings.is_on(Key::ReportInches);
        self.say(|out| reply_texts::parser_state(out, &state, inches));
    }
}
