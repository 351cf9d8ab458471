//! Everything that is sent to the host: `ok` and errors, alarms, messages, the welcome line and the status report.
//! While line checksums are on (`$LC=ON`), answers get their line number and checksum here. `protocol::reply_texts` and
//! `protocol::status_report` make the texts; this file supplies the values and queues the result.

use crate::dispatch::Controller;
use crate::error::{Alarm, Error};
use crate::gcode::{Dialect, Notice, ProgramPins, REASONS, WITH_VALUES};
use crate::image::FULL_IMAGE;
use crate::inputs::levels;
use crate::messages::Signals;
use crate::protocol::grblhal;
use crate::protocol::reply_texts::{self, PlaceForm};
use crate::protocol::status_report;
use crate::protocol::text::Text;
use crate::settings::Key;
use crate::states::State;
use crate::states::door::Interrupted;
use crate::units::per_minute;
use crate::work::line::Message;
use crate::work::task::{Job, Stage, Task};
use crate::work::tool_change::plan::ToolWait;

impl<const N: usize> Controller<N> {
    /// Makes a text and queues it for the host.
    pub(crate) fn say(&mut self, make: impl FnOnce(&mut Text)) {
        let mut text = Text::new();
        make(&mut text);
        self.queue_text(&text);
    }

    /// Sends `ok`, the answer to an accepted line.
    pub(crate) fn say_ok(&mut self) {
        self.queue_text(reply_texts::OK);
    }

    // Not inlined, so that its many callers share one copy of the code.
    #[inline(never)]
    fn queue_text(&mut self, text: &[u8]) {
        if self.m.lines.is_checking() && reply_texts::is_answer(text) && !self.m.replies.is_echoing() {
            return self.answer_checked(text);
        }
        self.m.replies.push(text, self.m.lines.hosts_cut());
    }

    /// Sends the answer to a line while line checksums are on (`$LC=ON`): with line number and checksum.
    // Not inlined, because the text takes 320 bytes of stack, which most answers do not need.
    #[inline(never)]
    fn answer_checked(&mut self, text: &[u8]) {
        if let Some(checked) = self.m.lines.checked_answer(text) {
            self.m.replies.push(&checked, self.m.lines.hosts_cut());
        }
    }

    /// Sends the message of a line that is executed. `comment`: a mark, then the message. With the mark
    /// [`WITH_VALUES`], parameters in the message are replaced by their values. Sends nothing in an alarm, or if the
    /// line would exceed the travel. Moves that were queued before the line can still be running when the message is
    /// sent.
    pub(crate) fn send_comment(&mut self, comment: &[u8]) {
        if let Some((mark, written)) = comment.split_first() {
            self.tell_message(*mark, written);
        }
    }

    // Not inlined, because it takes much stack and few lines have a message.
    #[inline(never)]
    fn tell_message(&mut self, mark: u8, written: &[u8]) {
        if self.state.is_alarm() || matches!(self.task, Task::SoftLimit(_)) {
            return;
        }
        let mut text = Message::new();
        if mark == WITH_VALUES {
            self.m.interpreter.expand(written, &mut text);
        } else {
            let _ = text.extend_from_slice(written);
        }
        self.say(|out| reply_texts::program_message(out, &text));
        self.line.keep_message(text);
    }

    /// Sends a notice (a message about a word of the program), unless it has already been sent for this program.
    #[inline(never)]
    pub(crate) fn tell_notice(&mut self, notice: Notice) {
        if self.line.take_unsent(notice) {
            self.say(|out| reply_texts::message(out, notice.text()));
        }
    }

    /// If the program waits for a subprogram, reports its number.
    #[inline(never)]
    pub(crate) fn tell_awaited(&mut self) {
        if let Some(number) = self.m.interpreter.awaited_subprogram() {
            self.say(|out| reply_texts::message_number(out, "Program waits for subprogram O", number));
        }
    }

    /// Sends the error of a line that is not executed, or not to its end.
    pub(crate) fn refuse(&mut self, error: Error) {
        // With line checksums, an error makes all later lines of the host fail. A startup line does not come from the
        // host, so its error must not have this effect.
        if !self.m.replies.is_echoing() {
            self.m.lines.fail(error);
        }
        if REASONS {
            self.tell_reason(error);
        }
        self.say(|out| reply_texts::error(out, error.code()));
    }

    /// Sends the explanation of an error, before the error itself. Sends nothing in these cases: in Grbl's dialect,
    /// because Grbl has no explanations; for a startup line, because its answer must be one line; to a host that has
    /// disconnected.
    #[cold]
    #[inline(never)]
    fn tell_reason(&mut self, error: Error) {
        if let Some(reason) = self.line.refused(error)
            && self.dialect() != Dialect::Grbl
            && !self.m.replies.is_echoing()
            && !self.m.replies.has_host_left(self.m.lines.hosts_cut())
        {
            self.say(|out| reply_texts::program_message(out, &reason));
        }
    }

    /// Answers `$E`: the explanation of the last refused line.
    pub(crate) fn tell_refusal(&mut self) {
        let mut text = Text::new();
        match self.line.refusal() {
            [] => reply_texts::message(&mut text, "No line was refused"),
            reason => reply_texts::program_message(&mut text, reason),
        }
        self.say(|out| out.clone_from(&text));
        self.say_ok();
    }

    pub(crate) fn tell_alarm(&mut self, alarm: Alarm) {
        self.m.interpreter.abandon_program();
        self.say(|out| reply_texts::alarm(out, alarm.code()));
        match alarm {
            Alarm::Underrun => self.say(|out| reply_texts::message(out, "Motion data ran out")),
            Alarm::Miscounted => self.say(|out| reply_texts::message(out, "Step outputs have failed")),
            _ => {}
        }
    }

    /// Switches line checksums off if they are on, and reports that to the host. Called after a change of dialect.
    pub(crate) fn end_check(&mut self) {
        if self.m.lines.end_check() {
            self.tell_unchecked();
        }
    }

    /// Switches line checksums off after a reset or a stop, because a line in transit can have been cut, and reports
    /// that to the host.
    pub(crate) fn abort_check(&mut self) {
        if self.m.lines.abort_check() {
            self.tell_unchecked();
        }
    }

    fn tell_unchecked(&mut self) {
        self.say(|out| reply_texts::message(out, "Lines are not checked any more"));
    }

    /// Reports which inputs caused the alarm, and where: the position, and the line number `line` (N word, 0 = none).
    /// Each alarm is reported once; in Grbl's dialect, none is.
    pub(crate) fn tell_trip(&mut self, line: u32) {
        if let Some(tripped) = self.m.inputs.take_tripped()
            && self.dialect() != Dialect::Grbl
        {
            let position = self.machine_position();
            let form = self.place_form();
            self.say(|out| reply_texts::trip(out, &tripped, &position, line, form));
        }
    }

    #[inline(never)]
    pub(crate) fn tell_damage(&mut self) {
        let text = "Stored settings damaged, some may be lost: send $$, correct them, wait 2 s, send $X";
        self.say(|out| reply_texts::message(out, text));
    }

    /// Reports how the machine can be unlocked; nothing if it is not locked.
    pub(crate) fn tell_lock(&mut self) {
        match self.state {
            State::Alarm(_) if self.m.records.are_damaged() => self.tell_damage(),
            State::Alarm(_) => self.say(|out| reply_texts::message(out, "'$H'|'$X' to unlock")),
            State::Critical(_) => self.say(|out| reply_texts::message(out, "Reset to continue")),
            _ => {}
        }
    }

    /// Sends the welcome line. Each host gets some messages only once, such as the one about damaged settings. These
    /// messages become due again, because a new host has not received them.
    pub(crate) fn greet(&mut self) {
        self.m.records.host_greeted();
        if self.speaks_grblhal() {
            self.say(grblhal::welcome);
        } else {
            self.say(reply_texts::welcome);
        }
        if let Some(failure) = self.m.replies.failure().cloned() {
            let grbl = self.dialect() == Dialect::Grbl;
            self.say(|out| reply_texts::failure(out, &failure, grbl));
        }
        self.m.settings_lock.host_greeted();
    }

    /// Tells a host that takes over about conditions that no status report shows. Most of these messages repeat what
    /// the previous host was told. A wait, such as a dwell, is reported to this host even if the previous one was not
    /// told. Sends nothing in Grbl's dialect, because Grbl has only one host.
    #[inline(never)]
    pub(crate) fn tell_inherited(&mut self) {
        // Only the full image has these texts.
        if !FULL_IMAGE || self.dialect() == Dialect::Grbl {
            return;
        }
        if self.line.is_single_block() {
            self.tell_single_block();
        }
        let state = match self.state {
            State::Check => "Enabled",
            State::Sleep(_) => "Sleeping",
            State::Door(door) if door.interrupted == Interrupted::Sleep => "Sleeping",
            State::Door(_) if !self.state.is_resuming() => "Check Door",
            State::Hold(hold) if hold.ends_with_spindle().is_some() => "Restoring spindle",
            _ => "",
        };
        if !state.is_empty() {
            self.say(|out| reply_texts::message(out, state));
        }
        if let Task::Job(job) = self.task {
            self.tell_wait(&job);
        }
    }

    /// Reports what the line being executed waits for.
    fn tell_wait(&mut self, job: &Job) {
        let seconds = job.left(self.m.now).to_micros().div_ceil(1_000_000) as u32;
        match (job.stage, self.line.action.pins()) {
            (Stage::Paused | Stage::CyclePaused, _) => {
                self.repeat_message();
                self.say(|out| reply_texts::message(out, "Program paused"));
            }
            (Stage::ToolChange, _) => {
                self.repeat_message();
                self.tell_tool();
            }
            (Stage::Measuring, _) => match self.line.change().waits_for() {
                Some(ToolWait::Change) => {
                    self.repeat_message();
                    self.tell_tool();
                }
                Some(ToolWait::Confirm) => self.tell_first_tool(),
                None => {}
            },
            (Stage::Dwell | Stage::DwellSuspended, _) if self.line.action.dwell.is_some() => {
                self.say(|out| reply_texts::message_number(out, "Dwell, seconds left: ", seconds));
            }
            (Stage::Dwell | Stage::DwellSuspended | Stage::SpinningUp | Stage::SpinningDown, _) => {
                self.say(|out| reply_texts::message(out, "Waits for the spindle"));
            }
            (Stage::Input | Stage::InputSuspended, Some(ProgramPins::Wait { number, .. })) => {
                self.say(|out| reply_texts::wait_for_input(out, number, seconds));
            }
            _ => {}
        }
    }

    /// Repeats the last message of the program, because it can say what a pause or tool change is for.
    fn repeat_message(&mut self) {
        let text = self.line.message();
        if !text.is_empty() {
            self.say(|out| reply_texts::program_message(out, &text));
        }
    }

    /// Reports the tool that the machine waits for.
    pub(crate) fn tell_tool(&mut self) {
        let tool = self.line.action.spindle_tool();
        self.say(|out| reply_texts::message_number(out, "Tool change T", tool));
    }

    /// Asks whether the work zero was set with the first tool. The operator confirms by `~`.
    pub(crate) fn tell_first_tool(&mut self) {
        self.say(|out| reply_texts::message(out, "First tool measured: send ~ if it set work zero, else reset"));
    }

    pub(crate) fn tell_single_block(&mut self) {
        let message = if self.line.is_single_block() { "Single block on" } else { "Single block off" };
        self.say(|out| reply_texts::message(out, message));
    }

    /// Sends the status report if `?` has requested one and the output queue has room for it.
    pub(crate) fn answer_status(&mut self) {
        if self.m.replies.take_status() {
            self.report_status();
        }
    }

    // Cold, because a report is made only a few times per second, while `answer_status` is called before each output.
    #[cold]
    #[inline(never)]
    fn report_status(&mut self) {
        let busy = self.m.step_supply.is_running()
            || matches!(
                self.state,
                State::Hold(_) | State::Braking { .. } | State::Jog { .. } | State::Door(_) | State::Homing(_)
            );
        let (spindle, speed) = self.spindle_now();
        let (mut show_offset, mut show_overrides) = self.m.replies.rare_fields(busy);
        let of_grblhal = if self.speaks_grblhal() {
            let full = self.m.replies.take_full_status();
            let mut fields = self.grblhal_fields(full, spindle);
            // A host shows the old values until the next report that has these fields. So the first report after a
            // change must have them.
            let (place, wait) = self.m.replies.note_fields(&mut fields);
            (show_offset, show_overrides) = (show_offset | full | place, show_overrides | full | wait);
            [Some(fields); FULL_IMAGE as usize]
        } else {
            [None; FULL_IMAGE as usize]
        };
        let mask = self.m.settings.whole(Key::StatusReport);
        let grbl = self.dialect() == Dialect::Grbl;
        let line = self.m.motion.line_number();
        let overrides = self.m.accessories.overrides();
        let status = status_report::Status {
            state: self.state.name(
                self.m.motion.is_at_rest(),
                self.m.step_supply.is_running(),
                self.m.inputs.signals().door,
            ),
            machine: self.machine_position(),
            offset: self.m.interpreter.work_zero(self.dialect()),
            show_machine: mask & 1 != 0,
            buffer: (mask & 2 != 0).then_some((self.m.motion.free_blocks(), self.m.step_supply.observed().rx_free)),
            line: (line > 0 && !grbl).then_some(line),
            feed: per_minute(self.m.motion.speed().max(self.m.parking.motion().speed())),
            speed,
            pins: self.shown_signals(),
            show_offset,
            overrides: show_overrides.then_some((
                [overrides.feed, overrides.rapid, overrides.spindle],
                spindle,
                self.m.accessories.coolant(),
            )),
            of_grblhal,
        };
        let form = self.place_form();
        self.say(|out| status_report::status(out, &status, form));
    }

    /// Returns the number of axes and the unit in which positions are reported.
    pub(crate) fn place_form(&self) -> PlaceForm {
        PlaceForm { axes: self.m.settings.axes_in_use(), inches: self.m.settings.is_on(Key::ReportInches) }
    }

    /// Returns the inputs for the status report. The limit switch of a second motor counts as a switch of its axis.
    fn shown_signals(&self) -> Signals {
        let signals = *self.m.inputs.signals();
        Signals { limits: levels::axes_of_switches(signals.limits, &self.m.settings), ..signals }
    }
}
