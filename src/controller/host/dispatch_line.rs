//! Dispatches received lines. The intake (`protocol::intake`) collects their bytes. A complete line is a `$` command, a
//! jog or a line of a program; this file passes the line on or refuses it with an error. A jog that arrives while
//! another jog brakes waits until the machine is at rest.

use crate::dispatch::Controller;
use crate::error::Error;
use crate::gcode::{self, AS_WRITTEN, Dialect, Direction, Flow, Notice, REASONS, WITH_VALUES};
use crate::image::FULL_IMAGE;
use crate::messages::{HOST_CHANGED, LineByte};
use crate::protocol::intake::Taken;
use crate::protocol::line_checksum::Verdict;
use crate::protocol::line_filter::{self, Pushed};
use crate::protocol::reply_texts;
use crate::settings::{Key, Settings};
use crate::states::State;
use crate::units::Instant;
use crate::view::dialect;
use crate::work::task::{Answer, Caller, Task};

/// A mark of one byte, followed by the message in a line's comment, such as `(MSG, text)`. The mark is [`WITH_VALUES`]
/// if parameters in the message are replaced by their values, as in `(PRINT, #1)`. Otherwise the mark is
/// [`AS_WRITTEN`].
type Comment = heapless::Vec<u8, { line_filter::MESSAGE_LENGTH + 1 }>;

impl<const N: usize> Controller<N> {
    pub(crate) fn release_held(&mut self) {
        if let Some(byte) = self.m.lines.release() {
            self.line_byte(self.m.now, byte);
        }
    }

    /// Returns whether `byte`, the next line byte, must be dropped. A byte is dropped if it was received before a reset
    /// or a stop. In a state that only a reset ends (such as sleep), a byte is also dropped if it was received before
    /// that reset, even if the reset is still to come.
    pub fn is_old(&self, byte: LineByte) -> bool {
        if self.state.waits_for_reset() {
            return !self.m.stops.is_awaited() && !self.m.lines.is_ahead(byte);
        }
        if byte.byte == HOST_CHANGED {
            // A `HOST_CHANGED` comes before the bytes of the next host. At an open door, lines wait, but this byte is
            // processed at once if nothing of the previous host is in progress.
            let waits = matches!(self.state, State::Door(_)) && !self.m.lines.holds();
            return waits && matches!(self.task, Task::None | Task::Startup(_, None));
        }
        self.m.lines.is_old(byte)
    }

    /// Drops a byte for which [`Controller::is_old`] returned `true`. This is allowed even while the controller accepts
    /// no lines, for example at an open door.
    pub fn drop_old(&mut self, byte: LineByte) {
        if self.state.waits_for_reset() {
            self.m.lines.drop_next();
        }
        self.other_byte(byte);
    }

    #[inline(never)]
    pub(crate) fn line_byte(&mut self, now: Instant, byte: LineByte) {
        self.m.now = now;
        if self.m.lines.take_end(byte) {
            return self.line_ended();
        }
        self.other_byte(byte);
    }

    /// Processes a line that the fast path of the intake has completed: no bytes of it were lost, and line checksums
    /// are off.
    fn line_ended(&mut self) {
        self.answer_status();
        let is_of_program = self.m.lines.has_no_comment()
            && !matches!(self.m.lines.text().first(), None | Some(b'%' | b'$'))
            && !self.state.is_alarm()
            && !matches!(self.state, State::Jog { .. })
            && self.dialect() != Dialect::Grbl
            && !self.m.interpreter.is_behind_end();
        if is_of_program {
            self.line_of_program();
        } else {
            self.complete();
        }
        if !matches!(self.task, Task::Job(_)) {
            self.m.pins.disturb();
        }
    }

    /// Processes a line of the host's program that has no message. The line is read in the intake's buffer, so nothing
    /// is copied.
    fn line_of_program(&mut self) {
        let (text, dialect) = (self.m.lines.text(), dialect(&self.m.settings));
        let checked = match self.m.interpreter.direct(text, &[], self.m.lines.lines_read()) {
            Ok(Direction::Check) => match self.m.interpreter.check_into(text, dialect, &mut self.line.action) {
                Ok(()) => Ok(Direction::Check),
                Err(error) => self.m.interpreter.direct_refused(text, &[], error),
            },
            directed => directed,
        };
        if REASONS && let Err(error) = checked {
            self.line.explain(&mut self.m.interpreter, text, dialect, error, false);
        }
        let asks_for_tool = checked.is_err() && gcode::asks_for_tool(known_text(text));
        if checked.is_err() {
            self.m.interpreter.refused_line(known_text(text));
        }
        self.m.lines.clear();
        match checked {
            Ok(Direction::Check) => {
                if let Err(error) = self.begin_checked(Answer::Host) {
                    if REASONS {
                        self.explain(&[], error);
                    }
                    if self.line.action.flow == Flow::End {
                        self.m.interpreter.note_end();
                    }
                    self.refuse_program_line(error, self.line.action.tool_change);
                }
            }
            Ok(direction) => self.directed(direction, &[]),
            Err(error) => self.refuse_program_line(error, asks_for_tool),
        }
        self.m.last_line_at = self.m.now;
    }

    /// Processes a byte that needs more than the fast paths for text and for line ends.
    #[inline(never)]
    fn other_byte(&mut self, byte: LineByte) {
        let taken = self.m.lines.take(byte, || line_rules(&self.m.settings));
        if taken.pushed != Pushed::More || taken.cut || taken.lost {
            self.taken(taken);
        }
    }

    /// Reacts to a byte that completed a line, marked a change of hosts, or came after lost bytes.
    #[inline(never)]
    fn taken(&mut self, taken: Taken) {
        if taken.cut && self.state.waits_for_reset() {
            // The line in progress will not continue, and nobody waits for its answer.
            self.task.abandon();
        }
        if taken.cut {
            // Subroutines, loops and conditions that the previous host has left open do not concern the next host. The
            // previous host's last lines have been executed by now.
            self.m.interpreter.abandon_program();
            self.m.interpreter.begin_program();
        }
        if taken.lost {
            self.say(|out| reply_texts::message(out, "Received bytes lost"));
        }
        if taken.pushed != Pushed::More {
            // Realtime commands take effect before later lines. So if a `?` came before the end of this line, its
            // report is sent before the answer to the line.
            self.answer_status();
        }
        match taken.pushed {
            Pushed::More => {}
            _ if taken.verdict != Verdict::Valid => self.answer_invalid(taken.verdict),
            Pushed::TooLong => {
                if REASONS && let Some((length, fit)) = self.m.lines.lengths() {
                    self.line.explain_length(length, fit);
                }
                self.m.lines.clear();
                self.refuse_host_line(Error::LineTooLong, None);
            }
            Pushed::Complete => self.complete(),
        }
        // A line that has become a `Task::Job` has not changed any output yet. Any other line may have, so the outputs
        // must be compared with those last sent.
        if !matches!(self.task, Task::Job(_)) {
            self.m.pins.disturb();
        }
    }

    /// Executes the line that the intake has completed, or makes it wait if it is a jog that must wait.
    #[inline(never)]
    fn complete(&mut self) {
        // The buffers are filled in place. If a function returned them, it would copy their whole capacity.
        let (mut text, mut comment) = (heapless::Vec::<u8, { line_filter::LENGTH }>::new(), Comment::new());
        let _ = text.extend_from_slice(self.m.lines.text());
        self.read_comment(&mut comment);
        if FULL_IMAGE && !self.m.lines.deleted().is_empty() {
            let rested = self.m.has_rested();
            self.m.interpreter.skipped_line(self.m.lines.deleted(), rested);
        }
        if FULL_IMAGE && self.m.lines.has_nested_comment() && self.dialect() == Dialect::Oxmill {
            self.tell_notice(Notice::NestedComment);
        }
        if self.must_wait(&text) {
            self.task = Task::JogWaits;
        } else {
            self.m.lines.clear();
            self.dispatch(&text, &comment);
        }
    }

    /// Answers a line that is not executed because of line checksums: it is damaged or empty, was received before, or
    /// follows a line that was refused for its content. The host sends the line again if necessary.
    fn answer_invalid(&mut self, verdict: Verdict) {
        self.m.lines.clear();
        match self.m.lines.failed() {
            Some(error) => self.refuse(error),
            None if verdict == Verdict::Known => self.say(reply_texts::known),
            None => self.refuse(Error::DamagedLine),
        }
    }

    /// Reads the mark and the message of the line into `comment` (see [`Comment`]). Without a message, and in Grbl's
    /// dialect, `comment` stays empty.
    fn read_comment(&self, comment: &mut Comment) {
        if let Some((has_values, text)) = self.m.lines.message()
            && self.dialect() != Dialect::Grbl
        {
            let _ = comment.push(if has_values { WITH_VALUES } else { AS_WRITTEN });
            let _ = comment.extend_from_slice(text);
        }
    }

    /// Returns whether the line is a jog that must wait. A jog that was sent after a jog cancel waits while the
    /// cancelled jog brakes. It then starts from the position at which the machine has stopped.
    fn must_wait(&self, line: &[u8]) -> bool {
        line.starts_with(b"$J=")
            && matches!(self.state, State::Jog { cancelling: true })
            && self.m.lines.is_jog_behind_cancel()
    }

    /// Starts the jog that waits for the end of the jog before it ([`Task::JogWaits`]), if possible. Returns whether it
    /// has been dispatched.
    #[inline(never)]
    pub(crate) fn begin_waiting_jog(&mut self) -> bool {
        if matches!(self.state, State::Jog { cancelling: true })
            || self.state.is_suspended()
            || self.m.stops.is_awaited()
        {
            return false;
        }
        let (mut text, mut comment) = (heapless::Vec::<u8, { line_filter::LENGTH }>::new(), Comment::new());
        let _ = text.extend_from_slice(self.m.lines.text());
        self.read_comment(&mut comment);
        self.m.lines.clear();
        self.task = Task::None;
        self.dispatch(&text, &comment);
        true
    }

    fn dispatch(&mut self, line: &[u8], comment: &[u8]) {
        let rested = self.m.has_rested();
        let result = match line.first() {
            None if comment.is_empty() || self.state.is_alarm() => {
                self.say_ok();
                Ok(())
            }
            // A tape mark, which Grbl's dialect does not have.
            Some(b'%') if self.dialect() != Dialect::Grbl => self.tape_mark(line, comment),
            // A startup line or macro with a message is refused: the message would be sent now, and not when the line
            // is executed.
            Some(b'$') if !comment.is_empty() && keeps_line(line) => Err(Error::InvalidStatement),
            Some(b'$') => self.system(line).map(|()| self.send_comment(comment)),
            Some(_) if self.state.is_alarm() || matches!(self.state, State::Jog { .. }) => Err(Error::Locked),
            _ => self.program_line(line, comment),
        };
        if REASONS && let Err(error) = result {
            self.explain(line, error);
        }
        match result {
            Ok(()) => {}
            Err(error) if line.first() == Some(&b'$') => self.refuse(error),
            Err(error) => self.refuse_host_line(error, known_text(line)),
        }
        let goes_on = match line.first() {
            // A sender may send requests such as `$G` all the time, so they do not end the host's pause that
            // `has_rested` measures.
            Some(b'$') => true,
            // If the host has paused long enough for another program to begin, an empty line does not end the pause,
            // because that program can begin with comments.
            None => rested,
            _ => false,
        };
        if !goes_on {
            self.m.last_line_at = self.m.now;
        }
    }

    /// Refuses a line of the host that is not a `$` command. `text`: the words of the line, if they are known.
    fn refuse_host_line(&mut self, error: Error, text: Option<&[u8]>) {
        if self.dialect() != Dialect::Grbl {
            self.m.interpreter.refused_line(text);
        }
        self.refuse_program_line(error, gcode::asks_for_tool(text));
    }

    /// Finds the explanation of a refused line: of a program line, a jog or a startup line. Other `$` lines have none.
    #[cold]
    fn explain(&mut self, line: &[u8], error: Error) {
        let (words, is_jog) = match line {
            [b'$', b'J', b'=', words @ ..] => (words, true),
            [b'$', b'N', b'0'..=b'9', b'=', words @ ..] => (words, false),
            [b'$', ..] => return,
            words => (words, false),
        };
        let dialect = self.dialect();
        self.line.explain(&mut self.m.interpreter, words, dialect, error, is_jog);
    }

    /// Refuses a line of a program, and reports the error. If a subroutine or loop is being recorded, it now lacks
    /// this line, so the whole subroutine or loop is refused, too. Stops the job if `$901` is on, or if the line would
    /// have asked the operator for another tool (`asks_for_tool`).
    fn refuse_program_line(&mut self, error: Error, asks_for_tool: bool) {
        self.refuse(error);
        self.m.interpreter.line_refused(error);
        self.m.last_line_at = self.m.now;
        self.stop_at_error(asks_for_tool);
    }

    /// Handles a line with `%`, the tape mark between two programs. An open subroutine, loop or condition is an error.
    /// Further words on the line would be lost and are an error, too.
    fn tape_mark(&mut self, line: &[u8], comment: &[u8]) -> Result<(), Error> {
        if line.len() > 1 {
            return Err(Error::ExpectedLetter);
        }
        self.tell_awaited();
        self.m.interpreter.tape_mark()?;
        self.send_comment(comment);
        self.say_ok();
        Ok(())
    }

    /// Handles a line of the host's program: first its O words (subroutines, loops, conditions), then its G-code.
    /// Grbl's dialect has no O words.
    fn program_line(&mut self, line: &[u8], comment: &[u8]) -> Result<(), Error> {
        let direction = match self.dialect() {
            Dialect::Grbl => Direction::Check,
            _ => {
                let rested = self.m.has_rested();
                if rested && !line.is_empty() {
                    self.tell_awaited();
                }
                self.m.interpreter.look_behind_end(line, rested)?;
                self.m.interpreter.direct(line, comment, self.m.lines.lines_read())?
            }
        };
        if direction == Direction::Check && !line.is_empty() {
            match self.gcode(line, Answer::Host) {
                Ok(()) => self.send_comment(comment),
                Err(error) if self.dialect() == Dialect::Grbl => return Err(error),
                Err(error) => {
                    let direction = self.m.interpreter.direct_refused(line, comment, error)?;
                    self.directed(direction, &[]);
                }
            }
        } else {
            self.directed(direction, comment);
        }
        Ok(())
    }

    /// Finishes a line that has no G-code to execute now: it has only a message, belongs to a condition, was skipped or
    /// recorded, or starts a subroutine or loop.
    #[inline(never)]
    fn directed(&mut self, direction: Direction, comment: &[u8]) {
        match direction {
            Direction::Check | Direction::Done => {
                self.send_comment(comment);
                self.say_ok();
            }
            Direction::LeftOut => self.say_ok(),
            Direction::Call => {
                self.send_comment(comment);
                self.task = Task::Held(Caller::Host);
            }
            Direction::Run => self.task = Task::Held(Caller::Host),
        }
    }
}

/// Returns whether a `$` line sets a startup line or a macro.
fn keeps_line(line: &[u8]) -> bool {
    matches!(line, [b'$', b'N' | b'M', b'0'..=b'9', ..])
}

/// Returns the text of a line; `None` if a nested comment has not ended, because the text is then unknown.
fn known_text(text: &[u8]) -> Option<&[u8]> {
    Some(text).filter(|text| *text != [line_filter::OPEN_COMMENT])
}

/// Returns how the line filter treats lines in the present dialect.
fn line_rules<const N: usize>(settings: &Settings<N>) -> line_filter::LineRules {
    match dialect(settings) {
        Dialect::Grbl => line_filter::LineRules {
            length: line_filter::GRBL_LENGTH,
            merge_crlf: false,
            nested_comments: false,
            expressions: false,
            block_delete: false,
        },
        Dialect::Oxmill | Dialect::Seed => line_filter::LineRules {
            length: line_filter::LENGTH,
            merge_crlf: true,
            nested_comments: true,
            expressions: true,
            block_delete: settings.is_on(Key::BlockDelete),
        },
    }
}
