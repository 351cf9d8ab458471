//! Decides which received bytes are still valid, and assembles them into lines. While line checksums are on
//! (`$LC=ON`), this module also verifies the checksum of each complete line.
//!
//! Realtime commands and line bytes arrive through two queues, so their mutual order is lost. Each byte carries the
//! epoch in which it was received ([`LineByte`]); each soft reset (Ctrl-X), stop and jog cancel opens a new epoch:
//!
//! ```text
//!  byte of a later epoch      its command is still in the other queue: the byte is held until the command arrives
//!  byte before a reset        dropped
//!  jog before a jog cancel    not executed (the line is read and answered)
//! ```
//! The reset button, a feed hold and the door open no epoch. When one of them comes, this module stores how many bytes
//! have been received but not read yet. The button drops that many bytes; hold and door cancel the jogs among them.

use super::heartbeat::Heartbeat;
use super::line_checksum::{LineChecksum, Verdict};
use super::line_filter::{Line, LineRules, Pushed};
use super::text::Text;
use crate::error::Error;
use crate::messages::{HOST_CHANGED, LineByte};

/// Maximum distance between the current epoch and `reset_epoch` or `jog_epoch`. A line is dropped, as after a reset,
/// if more resets, stops and jog cancels than this come while it is unread.
pub(crate) const EPOCHS: u16 = 1 << 14;

/// What [`LineIntake::take`] did with a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Bytes before this one were lost. Set only at the first loss in a line.
    pub lost: bool,
    /// The byte was a [`HOST_CHANGED`]: later bytes are from another host.
    pub cut: bool,
    /// What the byte completed: a line, a line that is too long, or nothing yet.
    pub pushed: Pushed,
    /// Whether the completed line may be executed; `Valid` if no line was completed.
    pub verdict: Verdict,
}

impl Taken {
    const NOTHING: Taken = Taken { lost: false, cut: false, pushed: Pushed::More, verdict: Verdict::Valid };
}

/// Assembles lines from the received bytes that are still valid.
#[derive(Clone, Debug)]
pub struct LineIntake {
    /// A line byte that arrived before its command: the reset, stop or jog cancel that was sent before the byte is
    /// still in the other queue. The byte waits here for that command.
    held: Option<LineByte>,
    /// The current epoch: number of resets, stops and jog cancels handled (wrapping).
    epoch: u16,
    /// The epoch that the most recent reset or stop opened: bytes of older epochs are dropped.
    reset_epoch: u16,
    /// The epoch that the most recent jog cancel, reset or stop opened. Jogs of older epochs are not executed.
    jog_epoch: u16,
    /// Number of bytes still to be dropped, because they were received before the reset button was pressed.
    drop_bytes: u16,
    /// The rest of the current line is dropped, because the start of the line was dropped.
    drop_rest: bool,
    /// Number of bytes still to be read that were received before a hold or a door ended a jog. Jogs among these bytes
    /// are not executed.
    jog_bytes: u16,
    /// Epoch of the first byte of the current line.
    line_epoch: u16,
    /// The current line began before a hold or a door ended a jog.
    line_before_cancel: bool,
    /// The most recent command or event that ends jogs was a 0x85, so jogs that were sent after it are executed.
    keeps_later_jogs: bool,
    line: Line,
    check: LineChecksum,
    heartbeat: Heartbeat,
    /// Number (wrapping) of disconnected hosts whose last line has been read.
    hosts_cut: u16,
    /// Lines completed (wrapping).
    lines_read: u32,
}

impl Default for LineIntake {
    fn default() -> Self {
        Self::new()
    }
}

impl LineIntake {
    /// Creates an intake that has received nothing.
    pub const fn new() -> Self {
        Self {
            held: None,
            epoch: 0,
            reset_epoch: 0,
            jog_epoch: 0,
            drop_bytes: 0,
            drop_rest: false,
            jog_bytes: 0,
            line_epoch: 0,
            line_before_cancel: false,
            keeps_later_jogs: false,
            line: Line::new(),
            check: LineChecksum::OFF,
            heartbeat: Heartbeat::NONE,
            hosts_cut: 0,
            lines_read: 0,
        }
    }

    /// Returns the number of lines completed since power-up (wrapping), including those that were too long.
    pub fn lines_read(&self) -> u32 {
        self.lines_read
    }

    /// Returns the number (wrapping) of disconnected hosts whose last line has been read.
    pub fn hosts_cut(&self) -> u16 {
        self.hosts_cut
    }

    /// Fast path of [`LineIntake::take`] for a byte of ordinary text that need not be held or dropped. Returns
    /// whether the byte was taken.
    ///
    /// Does not record the epoch of the line, because only jogs need it. A jog begins with `$`, which is not ordinary
    /// text, so [`LineIntake::take`] takes it. [`LineIntake::take`] records the epoch if the line is empty. Before the
    /// `$` the line is empty even after blanks, because blanks are not stored.
    #[inline]
    pub fn take_plain(&mut self, byte: LineByte) -> bool {
        byte.epoch == self.epoch && !byte.damaged && self.line.push_plain(byte.byte)
    }

    /// Takes bytes from the start of `bytes`, up to the first byte that [`LineIntake::take_plain`] would not take.
    /// `epoch`: the epoch of all these bytes. Returns how many bytes were taken.
    #[inline]
    pub fn take_text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        if epoch == self.epoch { self.line.push_plain_text(bytes) } else { 0 }
    }

    /// Fast path of [`LineIntake::take`] for an LF that ends a line of ordinary text. Returns whether the byte was such
    /// an LF.
    #[inline]
    pub fn take_end(&mut self, byte: LineByte) -> bool {
        let ends = byte.byte == b'\n'
            && byte.epoch == self.epoch
            && !byte.damaged
            && self.line.ends_plain()
            && !self.check.looks_at_end();
        self.lines_read = self.lines_read.wrapping_add(u32::from(ends));
        ends
    }

    /// Takes a byte. If the byte completes a line, the line is available as [`LineIntake::text`] until
    /// [`LineIntake::clear`].
    pub fn take(&mut self, byte: LineByte, rules: impl Fn() -> LineRules) -> Taken {
        if byte.byte == HOST_CHANGED {
            // The epoch of a `HOST_CHANGED` is the number of disconnected hosts.
            self.hosts_cut = byte.epoch;
        } else if is_before(self.epoch, byte.epoch) {
            // The reset, stop or jog cancel that was sent before this byte is still in the queue of commands.
            self.held = Some(byte);
            return Taken::NOTHING;
        } else if is_before(byte.epoch, self.reset_epoch) {
            // The byte was received before a reset, so it is dropped. The reset button, a hold or a door may have come
            // after that reset, while this byte was unread. In this case their byte counts include this byte.
            self.drop_bytes = self.drop_bytes.saturating_sub(1);
            self.jog_bytes = self.jog_bytes.saturating_sub(1);
            return Taken::NOTHING;
        }
        let before_cancel = self.jog_bytes > 0;
        self.jog_bytes = self.jog_bytes.saturating_sub(1);
        if self.drop_bytes > 0 || self.drop_rest {
            // The byte was received before the reset button was pressed, or belongs to a line with such a byte. That
            // line is dropped to its end.
            self.drop_bytes = self.drop_bytes.saturating_sub(1);
            self.drop_rest = !matches!(byte.byte, b'\n' | b'\r' | HOST_CHANGED);
            if byte.byte == HOST_CHANGED {
                self.line = Line::new();
                self.check.end();
            }
            return Taken { cut: byte.byte == HOST_CHANGED, ..Taken::NOTHING };
        }
        if byte.byte == HOST_CHANGED {
            self.line = Line::new();
            self.check.end();
            return Taken { cut: true, ..Taken::NOTHING };
        }
        // A loss is reported once for each line, however many bytes are lost.
        let lost = byte.damaged && self.line.damage();
        if byte.damaged {
            self.check.damage();
        }
        if self.line.is_empty() && !self.check.has_begun() {
            self.line_epoch = byte.epoch;
            self.line_before_cancel = before_cancel;
        }
        let (pushed, verdict) = self.push(byte.byte, rules);
        self.line.expect_line(self.jog_bytes == 0 && !self.check.is_on());
        self.lines_read = self.lines_read.wrapping_add(u32::from(pushed != Pushed::More));
        Taken { lost, cut: false, pushed, verdict }
    }

    fn push(&mut self, byte: u8, rules: impl Fn() -> LineRules) -> (Pushed, Verdict) {
        let ends = matches!(byte, b'\n' | b'\r');
        let Some(byte) = (if ends { Some(byte) } else { self.check.take(byte) }) else {
            self.line.separate();
            return (Pushed::More, Verdict::Valid);
        };
        let pushed = self.line.push(byte, rules);
        let verdict = match pushed {
            Pushed::More => Verdict::Valid,
            Pushed::Complete => self.check.finish(self.line.text()),
            Pushed::TooLong => self.check.finish(&[]),
        };
        (pushed, verdict)
    }

    /// Switches line checksums on. The first line has the number 0. `session`: the four letters after `$LC=ON`, or
    /// empty.
    pub fn begin_check(&mut self, session: &[u8]) {
        self.line.expect_plain(false);
        self.check.begin(session);
    }

    /// Switches line checksums off. Returns whether they were on.
    pub fn end_check(&mut self) -> bool {
        self.check.end()
    }

    /// Switches line checksums off because of a reset or a stop: everything up to the next line end is refused. Returns
    /// whether checksums were on.
    pub fn abort_check(&mut self) -> bool {
        self.check.abort()
    }

    /// Returns whether line checksums are on (`$LC=ON`).
    #[inline]
    pub fn is_checking(&self) -> bool {
        self.check.is_on()
    }

    /// Records that the most recently completed line was refused for its content. While checksums are on, no later
    /// line is executed.
    pub fn fail(&mut self, error: Error) {
        self.check.fail(error);
    }

    /// Returns the error of the line that passed the checksum but was refused for its content; `None` if there was no
    /// such line. Every later line gets this error.
    pub fn failed(&self) -> Option<Error> {
        self.check.failed()
    }

    /// Returns the answer `text` with a checksum and the number of the expected line added; `None` while checksums
    /// are off.
    pub fn checked_answer(&self, text: &[u8]) -> Option<Text> {
        self.check.answer(text)
    }

    /// Returns whether `byte`, if taken next, would be dropped because it was received before a reset or a stop.
    pub fn is_old(&self, byte: LineByte) -> bool {
        if self.holds() || is_before(self.epoch, byte.epoch) {
            return false;
        }
        let by_button = self.drop_bytes > 0 || self.drop_rest;
        by_button || is_before(byte.epoch, self.reset_epoch)
    }

    /// Returns whether `byte` cannot be taken yet: the reset, stop or jog cancel that was sent before it has not been
    /// handled, or another byte is held already.
    pub fn is_ahead(&self, byte: LineByte) -> bool {
        self.holds() || byte.byte != HOST_CHANGED && is_before(self.epoch, byte.epoch)
    }

    /// Returns whether a line byte is held because the reset, stop or jog cancel that was sent before it is still in
    /// the queue of commands. No other byte may be taken before the held one.
    pub fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// Removes and returns the held byte. Call it after a reset, stop or jog cancel, then take the byte again.
    pub fn release(&mut self) -> Option<LineByte> {
        self.held.take()
    }

    /// Returns the text of the current line as far as it has arrived: in capitals, without blanks and comments.
    pub fn text(&self) -> &[u8] {
        self.line.text()
    }

    /// Returns two lengths for a line that is too long: its own, without blanks and comments, and the allowed one.
    /// `None` if bytes of the line were lost, or if this build does not count the excess.
    pub fn lengths(&self) -> Option<(usize, usize)> {
        self.line.lengths()
    }

    /// Returns the first words of a line that block delete skips. Empty for any other line, and in the small firmware
    /// image.
    pub fn deleted(&self) -> &[u8] {
        self.line.deleted()
    }

    /// Returns whether a comment of the line contained parentheses.
    pub fn has_nested_comment(&self) -> bool {
        self.line.has_nested_comment()
    }

    /// Returns whether the line cannot contain a message, because its latest comment in parentheses is empty or
    /// missing.
    #[inline]
    pub fn has_no_comment(&self) -> bool {
        self.line.has_no_comment()
    }

    /// Returns the message in the line's comment, if any, and whether it shows values of parameters.
    pub fn message(&self) -> Option<(bool, &[u8])> {
        self.line.message()
    }

    /// Discards the current line, because it has been read or must not be executed.
    pub fn clear(&mut self) {
        self.line.clear();
        self.check.clear();
    }

    /// Returns whether the current line, a jog, was sent before the most recent command or event that ended a jog. Such
    /// a jog is not executed.
    pub fn is_jog_stale(&self) -> bool {
        self.line_before_cancel || is_before(self.line_epoch, self.jog_epoch)
    }

    /// Returns whether the current line, a jog, was sent after the 0x85 that ended the previous jog.
    pub fn is_jog_behind_cancel(&self) -> bool {
        self.keeps_later_jogs && !self.is_jog_stale()
    }

    /// Updates the byte counts. `received`: number of line bytes that have been received and not been taken, except
    /// those that the link dropped because their host disconnected. `activity`: number of all received bytes except
    /// commands (wrapping).
    pub fn observe(&mut self, received: u16, activity: u16) {
        self.heartbeat.observe(activity);
        if self.drop_bytes | self.jog_bytes != 0 {
            self.drop_bytes = self.drop_bytes.min(received);
            self.jog_bytes = self.jog_bytes.min(received);
        }
    }

    /// Handles a reset or a stop: all bytes sent earlier are dropped because of their older epoch. They include the
    /// bytes that the reset button still had to drop, so the count of those bytes is cleared.
    pub fn reset(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.reset_epoch = self.epoch;
        self.jog_epoch = self.epoch;
        self.drop_bytes = 0;
        self.drop_rest = false;
        self.jog_bytes = 0;
        self.clear();
        // An LF received next ends a line of its own, even if a CR preceded the reset.
        self.line.separate();
    }

    /// Returns the state of the host timeout.
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// Returns the state of the host timeout, for changes.
    pub fn heartbeat_mut(&mut self) -> &mut Heartbeat {
        &mut self.heartbeat
    }

    /// Handles a stop (0x19) in Grbl's dialect, which ignores 0x19. Drops nothing, but advances the epoch, because the
    /// serial task has advanced the epoch of the line bytes after the stop.
    pub fn advance_epoch(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.keep_epochs_near();
    }

    /// Handles a jog cancel (0x85). It makes all jogs sent earlier stale, including those that have not been read yet.
    /// Later jogs are valid.
    pub fn cancel_jogs(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.jog_epoch = self.epoch;
        self.keeps_later_jogs = true;
        self.keep_epochs_near();
    }

    /// Handles a feed hold, a door, or the loss of the host. They end a jog, but do not advance the epoch. Jogs among
    /// the next `received` bytes, which have arrived but have not been read, are not executed.
    pub fn end_received_jogs(&mut self, received: u16) {
        self.jog_bytes = received;
        self.line.expect_plain(false);
        self.line_before_cancel = true;
        self.keeps_later_jogs = false;
    }

    /// Drops the next byte and the rest of its line.
    pub fn drop_next(&mut self) {
        self.drop_bytes = self.drop_bytes.max(1);
        self.line.expect_plain(false);
    }

    /// Handles the reset button, which acts like 0x18. As the button sends no byte, it does not advance the epoch.
    /// Instead, the next `received` bytes, which have arrived but have not been read, are dropped.
    pub fn drop_received(&mut self, received: u16) {
        self.drop_bytes = received;
        self.line.separate();
        self.line.expect_plain(false);
    }

    /// Keeps `reset_epoch` and `jog_epoch` within `EPOCHS` of the current epoch. Epochs are compared by their signed
    /// difference, so their distance must stay below half of the range of `u16`.
    fn keep_epochs_near(&mut self) {
        for older in [&mut self.reset_epoch, &mut self.jog_epoch] {
            if self.epoch.wrapping_sub(*older) > EPOCHS {
                *older = self.epoch.wrapping_sub(EPOCHS);
            }
        }
    }
}

/// Returns whether an epoch is older than another. Epochs wrap.
#[inline]
fn is_before(epoch: u16, other: u16) -> bool {
    (epoch.wrapping_sub(other) as i16) < 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::line_filter::LENGTH;

    fn rules() -> LineRules {
        LineRules { length: LENGTH, merge_crlf: true, nested_comments: false, expressions: true, block_delete: false }
    }

    fn byte(byte: u8, epoch: u16) -> LineByte {
        LineByte { byte, epoch, damaged: false }
    }

    /// Passes bytes of an epoch to the intake as the controller does. Returns the completed lines.
    fn give(intake: &mut LineIntake, text: &[u8], epoch: u16) -> Vec<String> {
        let mut lines = Vec::new();
        for b in text {
            assert!(!intake.holds(), "no byte is given while one is held");
            if intake.take_plain(byte(*b, epoch)) {
                continue;
            }
            if intake.take(byte(*b, epoch), rules).pushed == Pushed::Complete {
                lines.push(String::from_utf8(intake.text().to_vec()).unwrap());
                intake.clear();
            }
        }
        lines
    }

    #[test]
    fn a_byte_that_overtook_its_command_is_held() {
        let mut intake = LineIntake::new();
        assert_eq!(give(&mut intake, b"G0\nG1", 0), ["G0"]);
        assert_eq!(give(&mut intake, b"G", 1), [""; 0]);
        assert!(intake.holds());
        intake.reset();
        let held = intake.release().unwrap();
        assert_eq!((held, intake.holds()), (byte(b'G', 1), false));
        intake.take(held, rules);
        assert_eq!(give(&mut intake, b"4\n", 1), ["G4"], "without the half line from before the reset");
    }

    #[test]
    fn bytes_before_a_reset_are_dropped_and_later_ones_are_not() {
        let mut intake = LineIntake::new();
        intake.reset();
        assert_eq!(give(&mut intake, b"G0X1\nG0", 0), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 1), ["G4"]);
        intake.cancel_jogs();
        assert_eq!(give(&mut intake, b"G0X2\n", 1), ["G0X2"], "whole lines are none of a jog cancel's business");
    }

    /// A byte can wait for the realtime command that was sent before it. The reset button does not drop such a byte,
    /// and does not drop the bytes after it.
    #[test]
    fn a_byte_of_a_later_epoch_is_not_old() {
        let mut intake = LineIntake::new();
        intake.drop_received(10);
        assert!(intake.is_old(byte(b'G', 0)));
        assert!(!intake.is_old(byte(b'G', 1)));
        intake.take(byte(b'G', 1), rules);
        assert!(intake.holds());
        assert!(!intake.is_old(byte(b'0', 0)) && !intake.is_old(byte(b'0', 1)));
        intake.reset();
        let held = intake.release().unwrap();
        intake.take(held, rules);
        assert_eq!(give(&mut intake, b"0\n", 1), ["G0"]);
    }

    #[test]
    fn a_reset_button_drops_what_has_been_received_to_the_end_of_its_line() {
        let mut intake = LineIntake::new();
        intake.drop_received(6);
        assert_eq!(give(&mut intake, b"G0\nG1 X5\nG4\n", 0), ["G4"]);
        // The button has six bytes to drop, then a reset follows. The reset drops them because of their epoch. The
        // count of the button must not apply to later bytes.
        intake.drop_received(6);
        intake.reset();
        assert_eq!(give(&mut intake, b"G1X1", 0), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 1), ["G4"]);
        // In the reverse order, the count of the button includes the four unread bytes. They are dropped because of
        // their epoch, and each of them reduces the count.
        intake.reset();
        intake.drop_received(4);
        assert_eq!(give(&mut intake, b"G1X1", 1), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 2), ["G4"]);
        // The button has six bytes to drop, but the link has already dropped them because their host disconnected.
        // `observe` reports that no received byte is left, so the button drops no bytes of the next host instead.
        intake.drop_received(6);
        intake.observe(0, 0);
        assert_eq!(give(&mut intake, b"G4\n", 2), ["G4"]);
        // An LF after the dropped bytes ends a line of its own, even if a CR preceded them.
        assert_eq!(give(&mut intake, b"G4\r", 2), ["G4"]);
        intake.drop_received(1);
        assert_eq!(give(&mut intake, b"\n\n", 2), [""]);
    }

    /// Passes a jog and leaves its line in place, as the controller does while a jog waits.
    fn give_jog(intake: &mut LineIntake, epoch: u16) {
        for b in *b"$J=X1" {
            intake.take(byte(b, epoch), rules);
        }
        assert_eq!(intake.take(byte(b'\n', epoch), rules).pushed, Pushed::Complete);
    }

    #[test]
    fn a_jog_cancel_voids_the_jogs_before_it() {
        let mut intake = LineIntake::new();
        give_jog(&mut intake, 0);
        assert!(!intake.is_jog_stale() && !intake.is_jog_behind_cancel());
        intake.cancel_jogs();
        assert!(intake.is_jog_stale(), "read, and not begun");
        intake.clear();
        give_jog(&mut intake, 0);
        assert!(intake.is_jog_stale() && !intake.is_jog_behind_cancel(), "not read yet");
        intake.clear();
        give_jog(&mut intake, 1);
        assert!(!intake.is_jog_stale() && intake.is_jog_behind_cancel());
    }

    #[test]
    fn a_hold_voids_the_jogs_received_before_it() {
        let mut intake = LineIntake::new();
        intake.cancel_jogs();
        intake.end_received_jogs(6);
        assert!(intake.is_jog_stale(), "also the one that is being read");
        give_jog(&mut intake, 1);
        assert!(intake.is_jog_stale() && !intake.is_jog_behind_cancel());
        intake.clear();
        give_jog(&mut intake, 1);
        assert!(!intake.is_jog_stale(), "the next was received later");
        assert!(!intake.is_jog_behind_cancel(), "no 0x85 has come since");
        // Bytes that the reset button drops no longer count as received before the hold.
        intake.clear();
        intake.end_received_jogs(6);
        intake.drop_received(6);
        assert_eq!(give(&mut intake, b"$J=X2\n", 1), [""; 0]);
        give_jog(&mut intake, 1);
        assert!(!intake.is_jog_stale(), "received after the button");
    }

    #[test]
    fn a_cut_voids_the_half_line() {
        let mut intake = LineIntake::new();
        assert_eq!(give(&mut intake, &[b'G', b'0', HOST_CHANGED, b'G', b'4', b'\n'], 0), ["G4"]);
    }

    #[test]
    fn lost_bytes_are_told_and_their_line_is_refused() {
        let mut intake = LineIntake::new();
        give(&mut intake, b"G1X", 0);
        let damaged = LineByte { damaged: true, ..byte(b'5', 0) };
        assert!(!intake.take_plain(damaged));
        assert_eq!(intake.take(damaged, rules), Taken { lost: true, ..Taken::NOTHING });
        assert_eq!(intake.take(damaged, rules), Taken { lost: false, ..Taken::NOTHING }, "they have been told");
        assert_eq!(intake.take(byte(b'\n', 0), rules), Taken { pushed: Pushed::TooLong, ..Taken::NOTHING });
    }

    /// The epochs wrap in normal use, because a sender can send a jog cancel at each release of a key.
    #[test]
    fn epochs_wrap() {
        let mut intake = LineIntake::new();
        for epoch in 1..=100_000_u32 {
            if epoch % 3 == 0 {
                intake.advance_epoch()
            } else {
                intake.cancel_jogs()
            }
            if epoch % 1000 == 0 {
                assert_eq!(give(&mut intake, b"G4\n", epoch as u16), ["G4"], "{epoch}");
                assert_eq!(give(&mut intake, b"G4\n", (epoch - 900) as u16), ["G4"], "{epoch}: still waiting");
            }
        }
        intake.reset();
        assert_eq!(give(&mut intake, b"G4\n", 100_000_u32 as u16), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 100_001_u32 as u16), ["G4"]);
    }

    /// Two intakes: one uses the fast path wherever possible, the other never does. Both must agree.
    struct Both {
        brief: LineIntake,
        whole: LineIntake,
        lines: u32,
    }

    impl Both {
        fn each(&mut self, act: impl Fn(&mut LineIntake)) {
            act(&mut self.brief);
            act(&mut self.whole);
        }

        /// Passes a byte to both intakes. Returns whether the byte has ended a line.
        fn give(&mut self, byte: LineByte) -> bool {
            let rules = || LineRules { block_delete: self.lines % 4 == 3, ..rules() };
            let brief = if self.brief.take_plain(byte) {
                Taken::NOTHING
            } else if self.brief.take_end(byte) {
                Taken { pushed: Pushed::Complete, ..Taken::NOTHING }
            } else {
                self.brief.take(byte, rules)
            };
            assert_eq!(brief, self.whole.take(byte, rules), "{byte:?}");
            let seen = |intake: &LineIntake| {
                // Only complete jogs are compared, because a damaged line is not executed.
                let is_jog = brief.pushed == Pushed::Complete && intake.text().starts_with(b"$J=");
                let jog = is_jog.then(|| (intake.is_jog_stale(), intake.is_jog_behind_cancel()));
                let message = intake.message().map(|(has_values, text)| (has_values, text.to_vec()));
                (intake.text().to_vec(), message, jog, intake.lines_read(), intake.holds())
            };
            assert_eq!(seen(&self.brief), seen(&self.whole));
            if self.brief.has_no_comment() {
                assert_eq!(self.whole.message(), None);
            }
            let ends = brief.pushed != Pushed::More;
            if ends {
                self.lines += 1;
                self.each(LineIntake::clear);
            }
            ends
        }

        /// Passes as many bytes as possible by the fast path. Returns how many were taken.
        fn give_text(&mut self, epoch: u16, text: &[u8]) -> usize {
            let taken = self.brief.take_text(epoch, text);
            for text in &text[..taken] {
                assert_eq!(self.whole.take(byte(*text, epoch), rules), Taken::NOTHING, "{text}");
            }
            assert_eq!(self.brief.text(), self.whole.text());
            taken
        }

        /// Passes the held byte again, after the command for which it was held.
        fn release(&mut self) {
            let (brief, whole) = (self.brief.release(), self.whole.release());
            assert_eq!(brief, whole);
            if let Some(byte) = brief {
                self.give(byte);
            }
        }
    }

    #[test]
    fn bytes_are_taken_in_brief_as_they_are_taken_always() {
        const TEXT: [&[u8]; 20] = [
            b"G1",
            b"x-1.5",
            b"Y2",
            b"\n",
            b"\n",
            b"\r\n",
            b"\r",
            b"$J=",
            b"(MSG,a)",
            b"(b",
            b")",
            b";",
            b" ",
            b"/",
            b"%",
            b"$LC=ON",
            b":0",
            b"N1",
            b"[#1]",
            b"0123456789012345678901234567890123456789",
        ];
        let mut both = Both { brief: LineIntake::new(), whole: LineIntake::new(), lines: 0 };
        let mut state = 0x2545_F491_4F6C_DD1D_u64;
        let mut below = |end: u64| {
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            (state >> 11) % end
        };
        let mut epoch = 0_u16;
        for _ in 0..100_000 {
            let late = match below(60) {
                0 => u16::MAX,
                1 => 1,
                _ => 0,
            };
            let text = TEXT[below(20) as usize];
            let at_once = below(2) == 0 && !both.brief.holds();
            let taken = if at_once { both.give_text(epoch.wrapping_add(late), text) } else { 0 };
            for text in &text[taken..] {
                let damaged = below(200) == 0;
                let ends = !both.brief.holds()
                    && both.give(LineByte { byte: *text, epoch: epoch.wrapping_add(late), damaged });
                if ends && below(20) == 0 {
                    both.each(|intake| intake.begin_check(b""));
                }
            }
            match below(80) {
                0 => both.each(LineIntake::advance_epoch),
                1 => both.each(LineIntake::cancel_jogs),
                2 => both.each(LineIntake::reset),
                number @ 3..6 => both.each(|intake| intake.end_received_jogs(3 * (number as u16 - 3))),
                number @ 6..9 => both.each(|intake| intake.drop_received(3 * (number as u16 - 6))),
                9 => both.each(|intake| intake.observe(2, 0)),
                10..14 => both.each(|intake| _ = intake.abort_check()),
                14 if !both.brief.holds() => _ = both.give(byte(HOST_CHANGED, epoch)),
                _ => {}
            }
            epoch = both.whole.epoch;
            both.release();
        }
        assert!(both.lines > 10_000, "{}", both.lines);
    }
}
