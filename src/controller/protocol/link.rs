//! Passes the bytes of one host to the control task. `Link` runs in the serial task, finds realtime commands, which
//! overtake all lines, and holds line bytes for which the queue has no room. Two hosts may be connected, by UART and
//! USB: [`HostArbiter`] decides which of them is the active host. Lines of the other host are refused with `error:8`.
//!
//! ```text
//!  host ──▶ Link ──realtime──────────────────────▶ queue     at once, before all lines
//!             └───line bytes──▶ active? ─▶ held ──▶ queue     in order, when there is room
//!                                 │         │ no room for another packet: the link has to wait
//!                                 └─▶ error:8, once for each line
//! ```
//! A link that can wait (USB answers NAK) loses no byte. Its realtime commands act at once as long as the queue and
//! the link ([`Link::room`]) together have room for the line bytes in transit. For a sender that counts characters or
//! respects `Bf:`, the queue alone has enough room. A sender that sends a whole file without counting has to wait,
//! and so do the commands that it sends after that.
//!
//! A line is read as a whole or not at all. The rest of a line is refused if its start was refused, or if another
//! host cut the line by becoming the active host or by a reset. This applies whenever the rest arrives, and whichever
//! host is the active one by then.
//!
//! In a comment, the bytes of a UTF-8 character are text, even if one of them equals a command: see
//! [`comment`](super::comment). The link recognises a character only when its last byte arrives. Until then, its other
//! bytes wait here. If they turn out to form no character, they act as commands.
//!
//! A `!` in a comment may be text, as in `(slow!)`, or a hold from the operator. It is text if the line continues after
//! it, and a command if nothing follows for [`AMBIGUOUS_US`]: see [`Link::take_as_command`]. A `~` in a comment is
//! text: a host that pauses at that point must not start a machine in hold. In Grbl's dialect both are always commands.
//! With `$900=3`, 0x82 is treated like `!`. 0x81 and 0xA3 are treated like `~`; they can be bytes of `ü` and `£`.

use crate::messages::{LineByte, Realtime};
use crate::protocol::comment::CommentTracker;
use crate::protocol::host_arbiter::HostArbiter;
use crate::protocol::queues::Queues;
use crate::protocol::realtime::{Received, is_plain, is_plain_or_lf};

/// How long a `!` in a comment waits for the rest of its line, in µs: the duration of 230 bytes at 115,200 baud.
pub const AMBIGUOUS_US: u32 = 20_000;

/// Maximum number of line bytes that a link can hold: three USB packets of 64 bytes. A USB port fetches a packet only
/// while there is room for a whole one, so one packet is the minimum.
pub const MOST_HELD: usize = 3 * 64;

/// The receiving side of one link to a host.
#[derive(Clone, Debug)]
pub struct Link {
    number: usize,
    /// Line bytes that wait for room in the queue.
    held: heapless::Deque<LineByte, MOST_HELD>,
    /// Maximum number of `held` bytes.
    may_hold: usize,
    /// Commands for which the queue had no room. While a command waits here, no byte is taken, because no byte may
    /// overtake a command. The capacity is one command plus up to three bytes of an incomplete UTF-8 character before
    /// it, which can be commands after all (see [`CommentTracker::break_off`]).
    stuck: heapless::Deque<Realtime, 4>,
    /// Bytes were lost; the next line byte is marked as damaged.
    lost: bool,
    /// A line has begun and not ended.
    mid_line: bool,
    /// The current line is refused to its end, including the LF after its CR.
    refusing_line: bool,
    after_cr: bool,
    /// Whether the current line is in a comment, and the bytes of an incomplete character.
    comment: CommentTracker,
    /// A `!` arrived in a comment, and nothing after it yet.
    is_ambiguous: bool,
    /// Number of refused lines that still have to be answered with [`REFUSAL`].
    refusals: u16,
    /// Number of bytes of the current [`REFUSAL`] that have been sent.
    refused_bytes: usize,
}

impl Link {
    /// Creates a link that has received nothing. `number`: 0 for the UART, 1 for USB. `may_hold`: number of line
    /// bytes that may wait for room in the queue, at most [`MOST_HELD`].
    pub const fn new(number: usize, may_hold: usize) -> Self {
        assert!(may_hold <= MOST_HELD);
        Self {
            number,
            held: heapless::Deque::new(),
            may_hold,
            stuck: heapless::Deque::new(),
            lost: false,
            mid_line: false,
            refusing_line: false,
            after_cr: false,
            comment: CommentTracker::NONE,
            is_ambiguous: false,
            refusals: 0,
            refused_bytes: 0,
        }
    }

    /// Returns how many bytes of any kind can be taken even if both queues (of commands and of line bytes) are full.
    pub fn room(&self) -> usize {
        if !self.stuck.is_empty() { 0 } else { self.may_hold.saturating_sub(self.held.len()) }
    }

    /// Returns the number of line bytes that wait for room in the queue.
    pub fn held(&self) -> usize {
        self.held.len()
    }

    /// Returns whether a command or a line byte waits for room in its queue.
    pub fn is_waiting(&self) -> bool {
        !self.stuck.is_empty() || !self.held.is_empty()
    }

    /// Takes a byte. Returns whether something was queued. If there is no room, the byte is lost, and the next line
    /// byte is marked as damaged. So a link that can make its host wait must not be read while it has no room.
    pub fn take(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        self.take_text(&[byte], arbiter, queues) > 0 || self.take_any(byte, arbiter, other, queues)
    }

    /// Takes a byte of any kind, without the fast path.
    fn take_any(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        let mut any = false;
        for byte in self.comment.break_off(byte) {
            if let Received::Realtime(command) = Received::in_dialect(byte, queues) {
                any |= self.command(command, arbiter, queues);
            }
        }
        if self.comment.takes(byte, || queues.reads_characters()) {
            self.is_ambiguous = false;
            queues.ignored();
            return any;
        }
        self.take_alone(byte, arbiter, other, queues) || any
    }

    /// Takes a byte that is not part of a UTF-8 character in a comment.
    fn take_alone(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        match Received::in_dialect(byte, queues) {
            Received::Nothing => {
                queues.ignored();
                false
            }
            Received::Realtime(command @ (Realtime::FeedHold | Realtime::CycleStart | Realtime::ToolReady))
                if self.comment.is_inside() && queues.reads_characters() =>
            {
                self.is_ambiguous |= command == Realtime::FeedHold;
                queues.ignored();
                false
            }
            Received::Realtime(command) => {
                if command == Realtime::Reset {
                    queues.stop();
                    arbiter.turn_to(|active| active.take_over(self.number), || other.lose_active_role());
                    self.mid_line = false;
                    self.after_cr = false;
                    // The bytes lost so far belong to lines that the reset voids.
                    self.lost = false;
                }
                if matches!(command, Realtime::Reset | Realtime::Stop) {
                    self.comment.leave();
                    self.is_ambiguous = false;
                    other.void_line(arbiter);
                }
                // A realtime command does not cut the other host's line. Until the end of that line the other host
                // stays the active one, so it even gets the answer to a `?` of this host.
                if !other.mid_line || other.refusing_line {
                    let free = queues.is_free();
                    arbiter.turn_to(|active| active.claim(self.number, free, false), || other.lose_active_role());
                }
                self.command(command, arbiter, queues)
            }
            Received::Line(byte) => {
                self.is_ambiguous = false;
                self.comment.follow(byte, || queues.reads_characters());
                let second_of_crlf = byte == b'\n' && self.after_cr;
                self.after_cr = byte == b'\r';
                if second_of_crlf {
                    if self.refusing_line || arbiter.active_link() != self.number {
                        return false;
                    }
                } else {
                    self.refusing_line &= self.mid_line;
                    self.refusing_line =
                        self.refusing_line || !arbiter.claim(self.number, queues, || other.lose_active_role());
                }
                self.mid_line = !is_end(byte);
                if self.refusing_line {
                    if is_end(byte) {
                        self.refusals = self.refusals.saturating_add(1);
                        self.lost = false;
                    }
                    return false;
                }
                let byte = LineByte { byte, epoch: arbiter.epoch(), damaged: self.lost };
                let queued = self.held.is_empty() && arbiter.line(byte, queues);
                self.lost = !queued && (self.held.len() >= self.may_hold || self.held.push_back(byte).is_err());
                queued
            }
        }
    }

    /// Fast path of [`Link::take`] for text and LF line ends, which nearly all bytes are. Applies if the host is the
    /// active one, no byte waits or was lost, and the line is not refused: then only the room in the queue has to be
    /// checked. Also drops text of a line that is refused or has no room. Returns the number of bytes taken from the
    /// front.
    #[inline]
    pub fn take_text(&mut self, bytes: &[u8], arbiter: &HostArbiter, queues: &mut impl Queues) -> usize {
        if self.comment.has_begun_character() {
            return 0;
        }
        let is_active = arbiter.reads(self.number);
        let has_no_room = self.held.len() >= self.may_hold && !queues.waits() && is_active;
        if self.mid_line && (self.refusing_line || has_no_room) {
            return self.drop_text(bytes);
        }
        let is_text = is_active && !(self.refusing_line || self.lost || self.after_cr) && self.held.is_empty();
        if !is_text {
            return 0;
        }
        let other = bytes.iter().position(|byte| !is_plain_or_lf(*byte));
        let text = bytes.get(..other.unwrap_or(bytes.len())).unwrap_or_default();
        let taken = if text.is_empty() { 0 } else { queues.text(arbiter.epoch(), text) };
        if let Some(last) = taken.checked_sub(1).and_then(|last| bytes.get(last)) {
            self.mid_line = *last != b'\n';
            self.is_ambiguous = false;
        }
        if self.comment.is_inside() && text.iter().take(taken).any(|byte| *byte == b'\n') {
            self.comment.leave();
        }
        taken
    }

    /// Drops text of a line that is refused, or for which there is no room. Returns the number of dropped bytes.
    fn drop_text(&mut self, bytes: &[u8]) -> usize {
        let dropped = bytes.iter().take_while(|byte| is_plain(**byte)).count();
        if dropped > 0 {
            self.after_cr = false;
            self.is_ambiguous = false;
            self.lost |= !self.refusing_line;
        }
        dropped
    }

    /// Returns whether the next byte belongs to a comment.
    #[inline]
    pub fn is_in_comment(&self) -> bool {
        self.comment.is_inside()
    }

    /// Returns whether the most recently received byte is a `!` that may be text.
    #[inline]
    pub fn is_ambiguous(&self) -> bool {
        self.is_ambiguous
    }

    /// Treats a `!` that may be text as a feed hold. [`Link::pass_on`] will put the hold into the queue. Call this
    /// function if nothing has followed the `!` for [`AMBIGUOUS_US`] although the link had room, or if the next byte
    /// may belong to another line.
    pub fn take_as_command(&mut self) {
        if core::mem::take(&mut self.is_ambiguous) {
            // There is room: `stuck` contains only what arrived after this `!`, which is at most one command.
            let _ = self.stuck.push_back(Realtime::FeedHold);
        }
    }

    fn command(&mut self, command: Realtime, arbiter: &mut HostArbiter, queues: &mut impl Queues) -> bool {
        let waits = queues.waits();
        let queued = (self.stuck.is_empty() || !waits) && arbiter.command(command, queues);
        if !queued {
            self.lost |= !waits || self.stuck.push_back(command).is_err();
        }
        queued
    }

    /// Queues the waiting commands and line bytes, as far as there is room in the queues. Returns whether something was
    /// queued.
    pub fn pass_on(&mut self, arbiter: &mut HostArbiter, queues: &mut impl Queues) -> bool {
        let mut any = false;
        while let Some(command) = self.stuck.front()
            && arbiter.command(*command, queues)
        {
            self.stuck.pop_front();
            any = true;
        }
        while let Some(byte) = self.held.front()
            && arbiter.line(*byte, queues)
        {
            self.held.pop_front();
            any = true;
        }
        any
    }

    /// Voids the unfinished line, because the other host has become the active one. Drops all bytes that wait for
    /// room, and refuses the rest of the line.
    fn lose_active_role(&mut self) {
        self.refusing_line |= self.mid_line;
        self.held.clear();
    }

    /// Voids the unfinished line, because the other host has reset the machine.
    fn void_line(&mut self, arbiter: &mut HostArbiter) {
        self.is_ambiguous = false;
        if !self.mid_line || self.refusing_line {
            return;
        }
        self.refusing_line = true;
        while self.held.back().is_some_and(|byte| !is_end(byte.byte)) {
            self.held.pop_back();
        }
        if self.held.is_empty() {
            arbiter.require_host_change();
        }
    }

    /// Records that bytes were lost before they arrived here: the line that they belong to will be refused.
    pub fn lose(&mut self) {
        self.lost = true;
        self.take_as_command();
        self.comment.leave();
    }

    /// Handles a host that has opened its port. Returns whether it is the active host now. If not, the job of the
    /// other host continues, and this host gets no welcome line.
    ///
    /// Bytes that wait for the queue were sent before the port was opened, so they are dropped. The start of their line
    /// may already be in the queue. To void that start, a [`HOST_CHANGED`](crate::messages::HOST_CHANGED) is queued
    /// before the host's first line byte.
    pub fn came(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &impl Queues) -> bool {
        let free = queues.is_free();
        let granted = arbiter.turn_to(|active| active.claim(self.number, free, true), || other.lose_active_role());
        if granted {
            arbiter.require_host_change();
        }
        self.forget();
        granted
    }

    /// Handles the disconnection of this link's host. Returns whether it was the active host. Bytes that wait for the
    /// queue are dropped. A `HOST_CHANGED` comes before the next host's first byte, so this byte starts a new line.
    /// The controller does not answer the lines before that `HOST_CHANGED`.
    pub fn went(&mut self, arbiter: &mut HostArbiter) -> bool {
        let was_active = arbiter.leave(self.number);
        self.forget();
        was_active
    }

    fn forget(&mut self) {
        self.take_as_command();
        let stuck = core::mem::take(&mut self.stuck);
        *self = Self { stuck, ..Self::new(self.number, self.may_hold) };
    }

    /// Sends `error:8`, with a message before it, for each refused line. `send` returns whether it has taken a byte.
    /// Returns `false` while some bytes remain to be sent.
    pub fn refuse(&mut self, mut send: impl FnMut(u8) -> bool) -> bool {
        while self.refusals > 0 {
            let Some(byte) = REFUSAL.get(self.refused_bytes) else {
                self.refused_bytes = 0;
                self.refusals -= 1;
                continue;
            };
            if !send(*byte) {
                return false;
            }
            self.refused_bytes += 1;
        }
        true
    }
}

fn is_end(byte: u8) -> bool {
    matches!(byte, b'\n' | b'\r')
}

/// Reply to each line of a host that is not the active one: 8 is Grbl's "not idle".
const REFUSAL: &[u8] = b"[MSG:Another host has the machine]\r\nerror:8\r\n";

#[cfg(test)]
pub(super) mod tests;
