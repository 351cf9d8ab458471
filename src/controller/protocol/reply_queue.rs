//! Queue of the text that waits to be sent to the host. Some room is always reserved for the answer to the line being
//! executed. This module also decides when a status report is made, and which of the rare fields (`WCO`, `Ov`) it has.

use super::reply_texts::{is_answer, is_of_one_host};
use super::status_report::{GrblHalFields, RareFields};
use super::text::PIECE;
use crate::image::FULL_IMAGE;
use crate::messages::{Chunk, Restart};

/// Capacity of the queue, in bytes.
const BYTES: usize = 1024;
/// Free bytes required before a row of a listing or a status report is made, or a byte of a line is taken.
const RESERVE: usize = 2 * PIECE;
/// Additional free bytes required for a status report directly after another one. Without them, a host that sends `?`
/// all the time would leave no room for answers to lines and rows of listings.
const BETWEEN_REPORTS: usize = 64;
/// Bytes reserved for the answer to the line being executed. The longest one has a line number and a checksum
/// (`$LC=ON`).
const ANSWER: usize = 64;

/// Replies that wait to be sent, and reports that are due.
// Small fields come first, because one load or store instruction reaches only 4 KiB from the base of the controller.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Replies {
    /// Number of hosts that have disconnected (wrapping).
    hosts_gone: u16,
    /// A startup line was echoed, and its answer follows on the same line of text.
    echoed: bool,
    /// `?` was received and has not been answered.
    status_due: bool,
    /// The next report must have all fields (0x87). Takes no memory in the small firmware image.
    is_full: [bool; FULL_IMAGE as usize],
    /// The fields of the previous status report with `$900=3`; `None` before the first one.
    last_fields: [Option<GrblHalFields>; FULL_IMAGE as usize],
    /// The text that was queued last is a status report.
    reported: bool,
    rare_fields: RareFields,
    /// The host has read, by `$RC`, why the machine was restarted.
    restart_read: bool,
    restart: Restart,
    /// Index of the first waiting byte in `ring`.
    first: usize,
    /// Number of bytes in `ring` that have not been sent yet.
    waiting: usize,
    ring: [u8; BYTES],
}

impl Default for Replies {
    fn default() -> Self {
        Self::new()
    }
}

impl Replies {
    /// An empty queue.
    pub const fn new() -> Self {
        Self {
            hosts_gone: 0,
            echoed: false,
            status_due: false,
            is_full: [false; FULL_IMAGE as usize],
            last_fields: [None; FULL_IMAGE as usize],
            reported: false,
            rare_fields: RareFields::DUE,
            restart_read: false,
            restart: Restart::POWER,
            first: 0,
            waiting: 0,
            ring: [0; BYTES],
        }
    }

    /// Returns whether there is room for a row of a listing, a status report, or the answer to another line.
    #[inline]
    pub fn has_room(&self) -> bool {
        BYTES - self.waiting >= RESERVE
    }

    /// Returns whether a startup line was echoed and its answer follows on the same line.
    pub fn is_echoing(&self) -> bool {
        self.echoed
    }

    /// Returns whether the queue is empty and no `?` waits for its report. If not, the controller counts as busy.
    pub fn is_idle(&self) -> bool {
        self.waiting == 0 && !self.status_due
    }

    /// Returns whether text waits to be sent.
    #[inline]
    pub fn are_waiting(&self) -> bool {
        self.waiting != 0
    }

    /// Drops the waiting text, because its host has disconnected. `hosts_gone`: number of disconnected hosts
    /// (wrapping).
    pub fn host_left(&mut self, hosts_gone: u16) {
        self.hosts_gone = hosts_gone;
        self.waiting = 0;
    }

    /// Returns whether the host whose lines are being read has disconnected. `hosts_cut`: number of disconnected hosts
    /// whose last line has been read (wrapping).
    pub fn has_host_left(&self, hosts_cut: u16) -> bool {
        self.hosts_gone != hosts_cut
    }

    /// Queues text. A text that does not fit is dropped as a whole. Only the answer to the line being executed always
    /// fits.
    ///
    /// Call this for long text only while [`Replies::has_room`] returns `true`. Alarms and messages need not wait:
    /// they are short, and only a flood of resets could fill the queue with them.
    ///
    /// `hosts_cut`: as for [`Replies::has_host_left`]. Answers to lines of a disconnected host are dropped, because the
    /// next host would take them for answers to its own lines.
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

    /// Removes and returns the next bytes to be sent. Only the check for an empty queue is inlined, because it runs
    /// before each segment, and the queue is usually empty.
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

    /// Requests a status report (`?`).
    pub fn ask_status(&mut self) {
        self.status_due = true;
    }

    /// Requests a status report with all fields (0x87).
    pub fn ask_full_status(&mut self) {
        self.status_due = true;
        self.is_full = [true; FULL_IMAGE as usize];
    }

    /// Returns whether the next status report must have all fields (0x87), and clears that request.
    pub fn take_full_status(&mut self) -> bool {
        self.is_full.first_mut().is_some_and(core::mem::take)
    }

    /// Compares the fields of a status report (`$900=3`) with those of the previous report, and stores them. Sets
    /// `shows_scaling`. Returns whether a field that comes with `WCO` has changed, and whether M6 has started or
    /// stopped waiting for a tool.
    pub fn note_fields(&mut self, fields: &mut GrblHalFields) -> (bool, bool) {
        let before = self.last_fields.first_mut().and_then(|last| last.replace(*fields));
        fields.shows_scaling = fields.scaled || before.is_some_and(|before| before.scaled);
        let Some(before) = before else { return (false, false) };
        let rare =
            |fields: &GrblHalFields| (fields.system, fields.tool, fields.homed, fields.scaled, fields.has_reference);
        (rare(&before) != rare(fields), before.waits_for_tool != fields.waits_for_tool)
    }

    /// Returns whether the caller must make a status report now. If so, clears the request.
    #[inline]
    pub fn take_status(&mut self) -> bool {
        let needed = if self.reported { RESERVE + BETWEEN_REPORTS } else { RESERVE };
        let now = self.status_due && BYTES - self.waiting >= needed;
        self.status_due &= !now;
        now
    }

    /// After a reset: cancels a requested report, and makes the rare fields due: `WCO` in the next report, `Ov` in the
    /// report after it.
    pub fn reset(&mut self) {
        self.rare_fields = RareFields::DUE;
        self.status_due = false;
        self.is_full = [false; FULL_IMAGE as usize];
    }

    /// Makes the field `WCO` due in the next report, because the work offset has changed.
    pub fn offset_changed(&mut self) {
        self.rare_fields.offset_changed();
    }

    /// Makes the field `Ov` due in the next report without `WCO`, because an override or an accessory has changed.
    pub fn overrides_changed(&mut self) {
        self.rare_fields.overrides_changed();
    }

    /// Returns whether the next status report has the field `WCO`, and whether it has `Ov`. Call it once for each
    /// report, because it counts the reports. `busy`: the machine moves or its motion is suspended.
    pub fn rare_fields(&mut self, busy: bool) -> (bool, bool) {
        self.rare_fields.next(busy)
    }

    /// Stores why the machine was restarted, for the message after the welcome line.
    pub fn restarted(&mut self, restart: Restart) {
        self.restart = restart;
    }

    /// Returns the failure to report after a welcome line; `None` if there is none. It is reported again after each
    /// welcome line until the host sends `$RC`, because a single report can be lost.
    pub fn failure(&self) -> Option<&Restart> {
        (self.restart.is_failure() && !self.restart_read).then_some(&self.restart)
    }

    /// Returns the record for `$RC`, and marks it as read.
    pub fn read_restart(&mut self) -> &Restart {
        self.restart_read = true;
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
        // After a flood of resets of any length there is still room for the answer to the interrupted line.
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
        assert_eq!(*replies.read_restart(), failure);
        assert_eq!(replies.failure(), None);
    }
}
