//! Decides which received bytes still count, and collects them into lines. Bytes from before a reset and jogs from
//! before a jog cancel are dropped; a byte that is ahead of its realtime command is held. Complete lines pass their
//! checksum, if lines are checked.
//!
//! Realtime commands and line bytes come through two queues that keep no order between them. Each byte carries the epoch
//! it was received in ([`LineByte`]), and each soft reset (Ctrl-X), stop and jog cancel opens an epoch:
//!
//! ```text
//!  byte of a later epoch      its command is still on the way: held until it has come
//!  byte before a reset        dropped
//!  jog before a jog cancel    is not carried out (the line is read and answered)
//! ```
//! What has no epoch of its own counts the bytes received by then instead: a reset button drops them, a feed hold and a door
//! end the jogs among them.

use super::heartbeat::Heartbeat;
use super::line_checksum::{LineChecksum, Verdict};
use super::line_filter::{Line, LineRules, Pushed};
use super::text::Text;
use crate::error::Error;
use crate::messages::{HOST_CHANGED, LineByte};

/// Epochs by which an older one may fall behind: resets, stops and jog cancels while a line waits unread.
pub(crate) const EPOCHS: u16 = 1 << 14;

/// What a byte has brought about.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Taken {
    /// Bytes before it were lost on the way, the first ones of their line.
    pub lost: bool,
    /// What follows is another host's: it was a [`HOST_CHANGED`].
    pub cut: bool,
    /// What it completed.
    pub pushed: Pushed,
    /// Whether that may be carried out.
    pub verdict: Verdict,
}

impl Taken {
    const NOTHING: Taken = Taken { lost: false, cut: false, pushed: Pushed::More, verdict: Verdict::Valid };
}

/// The received lines, as far as they count.
#[derive(Clone, Debug)]
pub struct LineIntake {
    /// A byte that came before the realtime command which opened its epoch.
    held: Option<LineByte>,
    /// Resets, stops and jog cancels taken.
    epoch: u16,
    /// Bytes of older epochs are dropped: the epoch of the last reset or stop.
    reset_epoch: u16,
    /// Jogs of older epochs are dropped: the epoch of the last jog cancel.
    jog_epoch: u16,
    /// Received bytes to be dropped because of a reset button, and whether they end in the middle of a line.
    drop_bytes: u16,
    drop_rest: bool,
    /// Received bytes that were there before the end of a jog by a hold or a door: jogs among them are dropped.
    jog_bytes: u16,
    /// Epoch of the first byte of the current line.
    line_epoch: u16,
    /// The current line began before the end of a jog by a hold or a door.
    line_before_cancel: bool,
    /// The end of a jog has been ordered by 0x85, which leaves the jogs behind it alone.
    keeps_later_jogs: bool,
    line: Line,
    check: LineChecksum,
    heartbeat: Heartbeat,
    /// Of the hosts that have gone (wrapping), those whose last line has been read.
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
    /// Nothing received.
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

    /// Lines completed since power-up (wrapping), those that did not fit among them.
    pub fn lines_read(&self) -> u32 {
        self.lines_read
    }

    /// Of the hosts that have gone (wrapping), those whose last line has been read.
    pub fn hosts_cut(&self) -> u16 {
        self.hosts_cut
    }

    /// Takes a byte of the text of a line, if nothing has happened for which it would be held or dropped. The first byte of a
    /// jog is not among these: only of jogs it matters in which epoch they began. (Of one behind a blank, too: the line is empty.)
    #[inline]
    pub fn take_plain(&mut self, byte: LineByte) -> bool {
        byte.epoch == self.epoch && !byte.damaged && self.line.push_plain(byte.byte)
    }

    /// Takes the first of some bytes of an epoch, as far as [`LineIntake::take_plain`] takes each of them. Gives how many.
    #[inline]
    pub fn take_text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        if epoch == self.epoch { self.line.push_plain_text(bytes) } else { 0 }
    }

    /// Takes an LF that ends a line of such bytes; what [`LineIntake::take`] would do with it, in brief. Whether it was one.
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

    /// Takes a byte. When it completes a line, that is [`LineIntake::text`] until [`LineIntake::clear`].
    pub fn take(&mut self, byte: LineByte, rules: impl Fn() -> LineRules) -> Taken {
        if byte.byte == HOST_CHANGED {
            // Its epoch is the number of the host that has gone.
            self.hosts_cut = byte.epoch;
        } else if is_before(self.epoch, byte.epoch) {
            // The command that opened this epoch is still on its way through the other queue.
            self.held = Some(byte);
            return Taken::NOTHING;
        } else if is_before(byte.epoch, self.reset_epoch) {
            // It may be among those that a button or a hold has counted since.
            self.drop_bytes = self.drop_bytes.saturating_sub(1);
            self.jog_bytes = self.jog_bytes.saturating_sub(1);
            return Taken::NOTHING;
        }
        let before_cancel = self.jog_bytes > 0;
        self.jog_bytes = self.jog_bytes.saturating_sub(1);
        if self.drop_bytes > 0 || self.drop_rest {
            // Received before the reset button; the line that the last of them is in is dropped to its end.
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
        // Told once for each line, however many are lost.
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

    /// Lines are checked from now on; the first has the number 0.
    pub fn begin_check(&mut self, session: &[u8]) {
        self.line.expect_plain(false);
        self.check.begin(session);
    }

    /// Lines are not checked any more. Whether they were.
    pub fn end_check(&mut self) -> bool {
        self.check.end()
    }

    /// A reset or a stop: lines are not checked any more behind the next line end. Whether they were.
    pub fn lapse_check(&mut self) -> bool {
        self.check.lapse()
    }

    /// Whether lines are checked.
    #[inline]
    pub fn is_checking(&self) -> bool {
        self.check.is_on()
    }

    /// The line taken last was refused for what it says.
    pub fn fail(&mut self, error: Error) {
        self.check.fail(error);
    }

    /// The error that answers each checked line behind one that was refused for what it says.
    pub fn failed(&self) -> Option<Error> {
        self.check.failed()
    }

    /// An answer in the form of a checked line, while lines are checked.
    pub fn checked_answer(&self, text: &[u8]) -> Option<Text> {
        self.check.answer(text)
    }

    /// Whether a byte that comes next would be dropped, as it was received before a reset or a stop.
    pub fn is_old(&self, byte: LineByte) -> bool {
        if self.holds() || is_before(self.epoch, byte.epoch) {
            return false;
        }
        let by_button = self.drop_bytes > 0 || self.drop_rest;
        by_button || is_before(byte.epoch, self.reset_epoch)
    }

    /// Whether a byte that comes next waits for a command that has opened an epoch, or comes behind one that does.
    pub fn is_ahead(&self, byte: LineByte) -> bool {
        self.holds() || byte.byte != HOST_CHANGED && is_before(self.epoch, byte.epoch)
    }

    /// Whether a byte waits for its realtime command: no other may come before it.
    pub fn holds(&self) -> bool {
        self.held.is_some()
    }

    /// The byte that has waited, to be taken again after a command that opens an epoch.
    pub fn release(&mut self) -> Option<LineByte> {
        self.held.take()
    }

    /// The current line.
    pub fn text(&self) -> &[u8] {
        self.line.text()
    }

    /// How many bytes of text a line has that is too long, and how many of them fit; `None` if some were lost.
    pub fn lengths(&self) -> Option<(usize, usize)> {
        self.line.lengths()
    }

    /// Whether a remark of the line had parentheses in it.
    pub fn has_nested_remark(&self) -> bool {
        self.line.has_nested_remark()
    }

    /// Whether the line has no remark.
    #[inline]
    pub fn has_no_remark(&self) -> bool {
        self.line.has_no_remark()
    }

    /// What a remark of the line has to say, and whether it shows values of parameters.
    pub fn message(&self) -> Option<(bool, &[u8])> {
        self.line.message()
    }

    /// The current line has been read, or is void.
    pub fn clear(&mut self) {
        self.line.clear();
        self.check.clear();
    }

    /// Whether the current line, a jog, was sent before the end of a jog was ordered.
    pub fn is_jog_stale(&self) -> bool {
        self.line_before_cancel || is_before(self.line_epoch, self.jog_epoch)
    }

    /// Whether the current line, a jog, was sent behind the 0x85 that ends the one before it.
    pub fn is_jog_behind_cancel(&self) -> bool {
        self.keeps_later_jogs && !self.is_jog_stale()
    }

    /// So many bytes have been received and not been given yet; those of a host that has gone have gone with it. `heard`: so many
    /// have been received at all (wrapping).
    pub fn observe(&mut self, received: u16, heard: u16) {
        self.heartbeat.observe(heard);
        if self.drop_bytes | self.jog_bytes != 0 {
            self.drop_bytes = self.drop_bytes.min(received);
            self.jog_bytes = self.jog_bytes.min(received);
        }
    }

    /// A reset or a stop: what was sent before it is dropped by its epoch. Bytes that a reset button drops are among
    /// them, and not to be counted again.
    pub fn reset(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.reset_epoch = self.epoch;
        self.jog_epoch = self.epoch;
        self.drop_bytes = 0;
        self.drop_rest = false;
        self.jog_bytes = 0;
        self.clear();
        // An LF that follows ends a line of its own, whatever came before the reset.
        self.line.separate();
    }

    /// When the host is heard.
    pub fn heartbeat(&self) -> &Heartbeat {
        &self.heartbeat
    }

    /// When the host is heard, to be told of it.
    pub fn heartbeat_mut(&mut self) -> &mut Heartbeat {
        &mut self.heartbeat
    }

    /// A command that opens an epoch and does nothing else.
    pub fn open_epoch(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.keep_epochs_near();
    }

    /// 0x85: a jog that was sent before it is stale, also one that has not been read yet; one behind it is not.
    pub fn cancel_jogs(&mut self) {
        self.epoch = self.epoch.wrapping_add(1);
        self.jog_epoch = self.epoch;
        self.keeps_later_jogs = true;
        self.keep_epochs_near();
    }

    /// A jog ends without an epoch: of the `received` bytes no jog shall move any more.
    pub fn end_received_jogs(&mut self, received: u16) {
        self.jog_bytes = received;
        self.line.expect_plain(false);
        self.line_before_cancel = true;
        self.keeps_later_jogs = false;
    }

    /// The byte that comes next is dropped, and behind it the rest of its line.
    pub fn drop_next(&mut self) {
        self.drop_bytes = self.drop_bytes.max(1);
        self.line.expect_plain(false);
    }

    /// The reset button does what 0x18 does, but it opens no epoch: the `received` bytes are dropped all the same.
    pub fn drop_received(&mut self, received: u16) {
        self.drop_bytes = received;
        self.line.separate();
        self.line.expect_plain(false);
    }

    /// Epochs are compared by their signed difference, so the older ones must not fall behind by half of the range.
    fn keep_epochs_near(&mut self) {
        for older in [&mut self.reset_epoch, &mut self.jog_epoch] {
            if self.epoch.wrapping_sub(*older) > EPOCHS {
                *older = self.epoch.wrapping_sub(EPOCHS);
            }
        }
    }
}

/// Whether an epoch is older than another. They wrap.
#[inline]
fn is_before(epoch: u16, other: u16) -> bool {
    (epoch.wrapping_sub(other) as i16) < 0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::line_filter::LENGTH;

    fn rules() -> LineRules {
        LineRules { length: LENGTH, merge_crlf: true, nested_remarks: false, expressions: true, block_delete: false }
    }

    fn byte(byte: u8, epoch: u16) -> LineByte {
        LineByte { byte, epoch, damaged: false }
    }

    /// Gives bytes of an epoch as the controller does; the lines that were completed.
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

    /// What waits for its command is none of what a button drops, nor is what comes behind it.
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
        // A reset that comes after it drops the bytes by their epoch, and counts none of the next.
        intake.drop_received(6);
        intake.reset();
        assert_eq!(give(&mut intake, b"G1X1", 0), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 1), ["G4"]);
        // The other way round: bytes of a reset before it are among those that it counts.
        intake.reset();
        intake.drop_received(4);
        assert_eq!(give(&mut intake, b"G1X1", 1), [""; 0]);
        assert_eq!(give(&mut intake, b"G4\n", 2), ["G4"]);
        // Bytes that went with their host are not dropped from the next host's.
        intake.drop_received(6);
        intake.observe(0, 0);
        assert_eq!(give(&mut intake, b"G4\n", 2), ["G4"]);
        // An LF behind it ends a line of its own, whatever came before.
        assert_eq!(give(&mut intake, b"G4\r", 2), ["G4"]);
        intake.drop_received(1);
        assert_eq!(give(&mut intake, b"\n\n", 2), [""]);
    }

    /// Leaves the line in place, as the controller does while a jog waits.
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
        // Those of them that the reset button drops are not counted to what is received later.
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

    /// A bare jog cancel at each key that is released, for as long as the machine is on.
    #[test]
    fn epochs_wrap() {
        let mut intake = LineIntake::new();
        for epoch in 1..=100_000_u32 {
            if epoch % 3 == 0 {
                intake.open_epoch()
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

    /// An intake that takes bytes in brief where it can, and one that never does.
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

        /// Whether it has ended a line.
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
                // Of a line that is damaged nothing is carried out.
                let is_jog = brief.pushed == Pushed::Complete && intake.text().starts_with(b"$J=");
                let jog = is_jog.then(|| (intake.is_jog_stale(), intake.is_jog_behind_cancel()));
                let message = intake.message().map(|(has_values, text)| (has_values, text.to_vec()));
                (intake.text().to_vec(), message, jog, intake.lines_read(), intake.holds())
            };
            assert_eq!(seen(&self.brief), seen(&self.whole));
            if self.brief.has_no_remark() {
                assert_eq!(self.whole.message(), None);
            }
            let ends = brief.pushed != Pushed::More;
            if ends {
                self.lines += 1;
                self.each(LineIntake::clear);
            }
            ends
        }

        /// Several bytes at once, as far as they are taken in brief. Gives how many.
        fn give_text(&mut self, epoch: u16, text: &[u8]) -> usize {
            let taken = self.brief.take_text(epoch, text);
            for text in &text[..taken] {
                assert_eq!(self.whole.take(byte(*text, epoch), rules), Taken::NOTHING, "{text}");
            }
            assert_eq!(self.brief.text(), self.whole.text());
            taken
        }

        /// A command that opens an epoch has come at last: the byte that has waited for it is given.
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
                0 => both.each(LineIntake::open_epoch),
                1 => both.each(LineIntake::cancel_jogs),
                2 => both.each(LineIntake::reset),
                number @ 3..6 => both.each(|intake| intake.end_received_jogs(3 * (number as u16 - 3))),
                number @ 6..9 => both.each(|intake| intake.drop_received(3 * (number as u16 - 6))),
                9 => both.each(|intake| intake.observe(2, 0)),
                10..14 => both.each(|intake| _ = intake.lapse_check()),
                14 if !both.brief.holds() => _ = both.give(byte(HOST_CHANGED, epoch)),
                _ => {}
            }
            epoch = both.whole.epoch;
            both.release();
        }
        assert!(both.lines > 10_000, "{}", both.lines);
    }
}
