//! Text that waits to be sent to the host, in order and in chunks. Room is kept for the answer to the line in work.
//! Also when a status report is due, and which of its rare fields it carries.

use super::report::{RareFields, is_answer, is_of_one_host};
use super::text::PIECE;
use crate::messages::{Chunk, Restart};

/// Bytes of answers that wait for the serial task.
const BYTES: usize = 1024;
/// Free bytes that a listing, a status report or a line asks for before it begins.
const RESERVE: usize = 2 * PIECE;
/// Free bytes that a report asks for beyond these where the text before it was one, too: lines and listings come in between, however
/// often a host asks.
const BETWEEN_REPORTS: usize = 64;
/// Bytes that only the answer to the line in work may fill. The longest is that to a checked line.
const ANSWER: usize = 64;

/// Answers and reports to come.
// Small things first: one instruction reaches 4 KiB from the base of the controller.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Replies {
    /// Hosts that have gone (wrapping).
    hosts_gone: u16,
    /// A startup line has been echoed: the answer to it follows on the same line.
    echoed: bool,
    /// `?` has been asked and not yet answered.
    status_due: bool,
    /// The text that was queued last is a status report.
    reported: bool,
    rare_fields: RareFields,
    /// The host knows of the failure before this start.
    restart_told: bool,
    restart: Restart,
    /// The place of the first byte that waits, and how many do.
    first: usize,
    waiting: usize,
    ring: [u8; BYTES],
}

impl Default for Replies {
    fn default() -> Self {
        Self::new()
    }
}

impl Replies {
    /// Nothing to say.
    pub const fn new() -> Self {
        Self {
            hosts_gone: 0,
            echoed: false,
            status_due: false,
            reported: false,
            rare_fields: RareFields::DUE,
            restart_told: false,
            restart: Restart::POWER,
            first: 0,
            waiting: 0,
            ring: [0; BYTES],
        }
    }

    /// Whether there is room for what can wait for it.
    #[inline]
    pub fn has_room(&self) -> bool {
        BYTES - self.waiting >= RESERVE
    }

    /// Whether a startup line has been echoed, whose answer follows on the same line.
    pub fn is_echoing(&self) -> bool {
        self.echoed
    }

    /// Whether nothing waits to be sent.
    pub fn is_idle(&self) -> bool {
        self.waiting == 0 && !self.status_due
    }

    /// Whether text waits to be sent.
    #[inline]
    pub fn are_waiting(&self) -> bool {
        self.waiting != 0
    }

    /// A host has gone; this is the number (wrapping) of such hosts. What waits was for it, and is not for the next one.
    pub fn host_left(&mut self, hosts_gone: u16) {
        self.hosts_gone = hosts_gone;
        self.waiting = 0;
    }

    /// Whether the host has gone whose lines are read. `hosts_cut`: of the hosts that have gone those whose last line has been
    /// read.
    pub fn has_host_left(&self, hosts_cut: u16) -> bool {
        self.hosts_gone != hosts_cut
    }

    /// Queues text. There is always room: whoever can wait asks [`Replies::has_room`] first, and what cannot (an alarm, a
    /// message) is short. Only a flood of resets makes more; what then finds no room is left out as a whole, but never the answer to the
    /// line in work.
    ///
    /// `hosts_cut`: as for [`Replies::has_host_left`]. The next host would take the answer to a line of one that has gone for
    /// one of its own, so it is left out.
    pub fn push(&mut self, text: &[u8], hosts_cut: u16) {
        let unheard = self.has_host_left(hosts_cut) && !self.echoed && is_of_one_host(text);
        let free = BYTES - self.waiting;
        let has_room = free >= text.len() + ANSWER || free >= text.len() && is_answer(text);
        if unheard || !has_room {
            return;
        }
        self.echoed = text.last() == Some(&b':');
        self.reported = text.first() == Some(&b'<');
        let end = self.first + self.waiting;
        for (place, byte) in (end..).zip(text) {
            if let Some(slot) = self.ring.get_mut(place % BYTES) {
                *slot = *byte;
            }
        }
        self.waiting += text.len();
    }

    /// The next bytes to be sent. Asked before each segment: no call for nothing.
    #[inline]
    pub fn next_chunk(&mut self) -> Option<Chunk> {
        if self.waiting == 0 { None } else { Some(self.chunk()) }
    }

    #[inline(never)]
    fn chunk(&mut self) -> Chunk {
        let mut chunk = Chunk { len: 0, bytes: [0; 15] };
        let count = self.waiting.min(chunk.bytes.len());
        for (slot, place) in chunk.bytes.iter_mut().zip(self.first..self.first + count) {
            *slot = self.ring.get(place % BYTES).copied().unwrap_or(0);
        }
        chunk.len = count as u8;
        self.first = (self.first + count) % BYTES;
        self.waiting -= count;
        chunk
    }

    /// `?`
    pub fn ask_status(&mut self) {
        self.status_due = true;
    }

    /// Whether a status report has to be made now.
    #[inline]
    pub fn take_status(&mut self) -> bool {
        let needed = if self.reported { RESERVE + BETWEEN_REPORTS } else { RESERVE };
        let now = self.status_due && BYTES - self.waiting >= needed;
        self.status_due &= !now;
        now
    }

    /// After a reset no report is due, and the first carries what is rare.
    pub fn reset(&mut self) {
        self.rare_fields = RareFields::DUE;
        self.status_due = false;
    }

    /// The work offset has changed: the next report shows it.
    pub fn offset_changed(&mut self) {
        self.rare_fields.offset_changed();
    }

    /// An override or accessory has changed: the next report shows it.
    pub fn overrides_changed(&mut self) {
        self.rare_fields.overrides_changed();
    }

    /// Whether the report made now carries (`WCO`, `Ov`).
    pub fn rare_fields(&mut self, busy: bool) -> (bool, bool) {
        self.rare_fields.next(busy)
    }

    /// What is known of the end before this start.
    pub fn restarted(&mut self, restart: Restart) {
        self.restart = restart;
    }

    /// The failure that a welcome line is followed by: at each until the host has asked for the record, as the first may
    /// not have been heard.
    pub fn failure(&self) -> Option<&Restart> {
        (self.restart.is_failure() && !self.restart_told).then_some(&self.restart)
    }

    /// `$RC`: the record.
    pub fn tell_restart(&mut self) -> &Restart {
        self.restart_told = true;
        &self.restart
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::ResetCause;

    fn sent(replies: &mut Replies) -> String {
        let mut all = Vec::new();
        while let Some(chunk) = replies.next_chunk() {
            all.extend_from_slice(chunk.as_bytes());
        }
        String::from_utf8(all).unwrap()
    }

    #[test]
    fn what_finds_no_room_is_left_out_as_a_whole() {
        let mut replies = Replies::new();
        let text = [b'x'; 300];
        for _ in 0..3 {
            replies.push(&text, 0);
        }
        assert!(!replies.has_room());
        replies.push(&text, 0);
        replies.push(b"ALARM:1\r\n", 0);
        assert_eq!(sent(&mut replies), "x".repeat(900) + "ALARM:1\r\n");
        assert!(replies.has_room() && replies.is_idle());
        // Behind a flood of resets, whatever its length, the answer to the line that a reset ends.
        for _ in 0..BYTES {
            replies.push(b"\n", 0);
        }
        replies.push(b":4294967295 error:200 0123456789ABCDEF\r\n", 0);
        assert!(sent(&mut replies).ends_with("\n:4294967295 error:200 0123456789ABCDEF\r\n"));
    }

    #[test]
    fn nothing_of_a_host_that_has_gone_is_for_the_next_one() {
        let mut replies = Replies::new();
        replies.push(b"$0=10\r\n", 0);
        replies.host_left(1);
        for row in [b"$1=25\r\n".as_slice(), b"[G54:0.000,0.000,0.000]\r\n", b"ok\r\n"] {
            replies.push(row, 0);
        }
        replies.push(b"[MSG:Reset to continue]\r\n", 0);
        assert_eq!(sent(&mut replies), "[MSG:Reset to continue]\r\n");
        replies.push(b"$0=10\r\n", 1);
        assert_eq!(sent(&mut replies), "$0=10\r\n");
    }

    #[test]
    fn a_host_that_has_gone_gets_no_answers_until_its_lines_are_read() {
        let mut replies = Replies::new();
        replies.host_left(1);
        replies.push(b"ok\r\n", 0);
        replies.push(b"[MSG:Pgm End]\r\n", 0);
        replies.push(b">G0X1:", 0);
        replies.push(b"ok\r\n", 0);
        replies.push(b"error:1\r\n", 0);
        replies.push(b"ok\r\n", 1);
        assert_eq!(sent(&mut replies), "[MSG:Pgm End]\r\n>G0X1:ok\r\nok\r\n");
    }

    #[test]
    fn a_status_report_waits_for_room() {
        let mut replies = Replies::new();
        assert!(!replies.take_status());
        replies.push(&[b'x'; RESERVE], 0);
        replies.ask_status();
        assert!(!replies.take_status() && !replies.is_idle());
        sent(&mut replies);
        assert!(replies.take_status() && !replies.take_status());
    }

    #[test]
    fn a_failure_is_told_until_it_has_been_asked_for() {
        let mut replies = Replies::new();
        assert_eq!(replies.failure(), None);
        let failure = Restart { cause: ResetCause::Watchdog, crash: None, is_recorded: true };
        replies.restarted(failure.clone());
        replies.reset();
        assert_eq!(replies.failure(), Some(&failure));
        assert_eq!(*replies.tell_restart(), failure);
        assert_eq!(replies.failure(), None);
    }
}
