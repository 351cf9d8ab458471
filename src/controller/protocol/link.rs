//! What a host sends, on its way to the control task. A `Link` takes the bytes of one host, in the serial task. It picks out realtime
//! commands, which go ahead of all lines, and keeps bytes of lines for which the queue has no room. Two hosts may be connected, by UART
//! and USB: `HostArbiter` says which of them has the floor. Lines of the other one are refused with `error:8`.
//!
//! ```text
//!  host ──▶ Link ──realtime──────────────────────▶ queue     at once, past all lines
//!             └───line bytes──▶ floor? ──▶ held ──▶ queue     in their order, when there is room
//!                                 │         │ too little room for another packet: the link is told to wait
//!                                 └─▶ error:8, once for each line
//! ```
//! What is promised for a link that can wait (USB answers NAK): no byte is lost, and a realtime command acts at once as
//! long as the line bytes under way fit into the queue and [`Link::room`]. A sender that counts characters, or obeys
//! `Bf:`, never has more of them under way than the queue alone takes, so for it that is always. A sender that pours a
//! whole file in without counting is told to wait, and then what it sends behind that waits too, commands as well.
//!
//! A line is read as a whole or not at all: of one that was refused, or cut because another host took the floor or made
//! the machine reset, the rest is refused too, whenever it comes and whoever has the floor then.
//!
//! Characters of a remark are text, though a byte of them may look like a command: see [`remark`](super::remark). Whether
//! they are is known with their last byte, so the bytes before wait here; if it is no character, they are commands after all.
//!
//! A `!` in a remark may be text, as in `(slow!)`, or an operator's. It is text if the line goes on behind it, and a command if
//! nothing comes for [`AMBIGUOUS_US`]: see [`Link::take_as_command`]. A `~` in a remark is text: a pause of the host must not start
//! a machine that is held. In dialect `grbl` both always are commands.

use crate::messages::{HOST_CHANGED, LineByte, Realtime};
use crate::protocol::floor::Floor;
use crate::protocol::realtime::{Received, is_plain};
use crate::protocol::remark::Remark;

/// How long a `!` in a remark waits for the rest of its line, in µs: 230 bytes at 115,200 baud.
pub const AMBIGUOUS_US: u32 = 20_000;

/// Bytes of lines that a link can hold: two packets of USB more than the one that must always fit.
pub const MOST_HELD: usize = 3 * 64;

/// The way to `control`.
pub trait Queues {
    /// Queues a command. Gives whether there was room.
    fn realtime(&mut self, command: Realtime) -> bool;
    /// Queues a byte of a line. Gives whether there was room.
    fn line(&mut self, byte: LineByte) -> bool;
    /// Queues bytes of lines, as many of them as there is room for. Gives how many.
    #[inline]
    fn text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        let left = bytes.iter().position(|byte| !self.line(LineByte { byte: *byte, epoch, damaged: false }));
        left.unwrap_or(bytes.len())
    }
    /// Whether the link that is being read can wait. One that cannot loses a command that is refused, so each is tried.
    fn waits(&self) -> bool;
    /// Whether all that any host has said is done and answered.
    fn is_free(&self) -> bool;
    /// A reset has come: stops the step task, before anyone has queued or decided anything.
    fn stop(&mut self);
    /// A byte has come that is neither a line's nor a command: no more than a sign of life.
    fn ignored(&mut self) {}
    /// Whether characters of remarks are text. To Grbl each byte of 0x80 and above is a command or nothing.
    fn reads_characters(&self) -> bool;
}

/// Arbitration between the hosts on several links: the floor, and what their bytes pass through together.
#[derive(Clone, Debug, Default)]
pub struct HostArbiter {
    floor: Floor,
    /// The epoch of the next line byte: see [`LineByte`]. It is counted where a command is handed over and not where it is
    /// received, so that a command that waits for room is not overtaken in the count by one of the other host.
    epoch: u16,
    /// The line that has begun is void: [`HOST_CHANGED`] goes before the next line byte.
    cut: bool,
    /// Hosts with the floor that have gone since power-up (wrapping).
    gone: u16,
}

impl HostArbiter {
    /// No host has sent anything.
    pub const fn new() -> Self {
        Self { floor: Floor::new(), epoch: 0, cut: false, gone: 0 }
    }

    /// Who gets the answers.
    pub fn holder(&self) -> usize {
        self.floor.holder()
    }

    /// How many hosts with the floor have gone since power-up (wrapping), for `Event::Disconnected`.
    pub fn gone(&self) -> u16 {
        self.gone
    }

    /// Whether a [`HOST_CHANGED`] goes before the next byte, which is a byte received like others.
    pub fn owes_cut(&self) -> bool {
        self.cut
    }

    /// Queues a command, also one that has come over no link. Gives whether there was room.
    pub fn command(&mut self, command: Realtime, queues: &mut impl Queues) -> bool {
        let queued = queues.realtime(command);
        if queued && command.opens_epoch() {
            self.epoch = self.epoch.wrapping_add(1);
        }
        queued
    }

    fn line(&mut self, byte: LineByte, queues: &mut impl Queues) -> bool {
        if self.cut && !queues.line(LineByte { byte: HOST_CHANGED, epoch: self.gone, damaged: false }) {
            return false;
        }
        self.cut = false;
        queues.line(byte)
    }

    /// A host sends a line: whether it has the floor.
    #[inline]
    fn claim(&mut self, link: usize, other: &mut Link, queues: &impl Queues) -> bool {
        // Nearly always, and nothing changes by it.
        if self.floor.is_held_by(link) {
            return true;
        }
        let free = queues.is_free();
        self.turn_to(other, |floor| floor.claim(link, free, true))
    }

    /// Lets `ask` ask for the floor. Where another host takes over, the one that loses it is cut short: its half line, the partial
    /// line that it has sent so far, is void.
    fn turn_to(&mut self, other: &mut Link, ask: impl FnOnce(&mut Floor) -> bool) -> bool {
        let before = self.floor.holder();
        let granted = ask(&mut self.floor);
        if self.floor.holder() != before {
            other.refusing_line |= other.mid_line;
            other.held.clear();
            self.cut = true;
        }
        granted
    }
}

/// The receiving side of one link to a host.
#[derive(Clone, Debug)]
pub struct Link {
    number: usize,
    /// Bytes of lines that wait for room in the queue, and how many may.
    held: heapless::Deque<LineByte, MOST_HELD>,
    may_hold: usize,
    /// Commands for which there was no room: nothing more is taken, as they may not be overtaken by another. One, or those that
    /// [`Remark::break_off`] has given with it.
    stuck: heapless::Deque<Realtime, 4>,
    /// Bytes were lost; the next byte of a line says so.
    lost: bool,
    /// A line has begun and not ended.
    mid_line: bool,
    /// The line is refused to its end, and with it the LF behind its CR.
    refusing_line: bool,
    /// The byte before was a CR.
    after_cr: bool,
    /// The remark that the line is in, and the bytes of its next character.
    remark: Remark,
    /// A hold came in a remark, and nothing behind it yet.
    is_ambiguous: bool,
    /// What is left of the refusals to be sent: so many, less so many bytes of the first.
    refusals: u16,
    refused_bytes: usize,
}

impl Link {
    /// Nothing received. `may_hold`: how many bytes of lines may wait here for room in the queue, at most [`MOST_HELD`].
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
            remark: Remark::NONE,
            is_ambiguous: false,
            refusals: 0,
            refused_bytes: 0,
        }
    }

    /// How many bytes can be taken, whatever they are, with both queues full.
    pub fn room(&self) -> usize {
        if !self.stuck.is_empty() { 0 } else { self.may_hold.saturating_sub(self.held.len()) }
    }

    /// Line bytes that wait for room in the queue.
    pub fn held(&self) -> usize {
        self.held.len()
    }

    /// Whether something waits for room in a queue.
    pub fn is_waiting(&self) -> bool {
        !self.stuck.is_empty() || !self.held.is_empty()
    }

    /// Takes a byte. Without room it is lost, which the next byte of a line says: a link that can wait is not read then.
    /// Gives whether something was queued.
    pub fn take(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        self.take_text(&[byte], arbiter, queues) > 0 || self.take_any(byte, arbiter, other, queues)
    }

    /// Takes a byte of whatever kind.
    fn take_any(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        let mut any = false;
        for byte in self.remark.break_off(byte) {
            if let Received::Realtime(command) = Received::of(byte) {
                any |= self.command(command, arbiter, queues);
            }
        }
        if self.remark.takes(byte, || queues.reads_characters()) {
            self.is_ambiguous = false;
            queues.ignored();
            return any;
        }
        self.take_alone(byte, arbiter, other, queues) || any
    }

    /// Takes a byte that is no part of a character.
    fn take_alone(&mut self, byte: u8, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut impl Queues) -> bool {
        match Received::of(byte) {
            Received::Nothing => {
                queues.ignored();
                false
            }
            Received::Realtime(command @ (Realtime::FeedHold | Realtime::CycleStart))
                if self.remark.is_inside() && queues.reads_characters() =>
            {
                self.is_ambiguous |= command == Realtime::FeedHold;
                queues.ignored();
                false
            }
            Received::Realtime(command) => {
                if command == Realtime::Reset {
                    queues.stop();
                    arbiter.turn_to(other, |floor| floor.seize(self.number));
                    self.mid_line = false;
                    self.after_cr = false;
                    // What was lost so far goes with it.
                    self.lost = false;
                }
                if matches!(command, Realtime::Reset | Realtime::Stop) {
                    self.remark.leave();
                    self.is_ambiguous = false;
                    other.void_line(arbiter);
                }
                // A realtime command cuts no line: the answer to a `?` goes to the host that is within a line.
                if !other.mid_line || other.refusing_line {
                    let free = queues.is_free();
                    arbiter.turn_to(other, |floor| floor.claim(self.number, free, false));
                }
                self.command(command, arbiter, queues)
            }
            Received::Line(byte) => {
                self.is_ambiguous = false;
                self.remark.follow(byte);
                let second_of_crlf = byte == b'\n' && self.after_cr;
                self.after_cr = byte == b'\r';
                if second_of_crlf {
                    if self.refusing_line || arbiter.holder() != self.number {
                        return false;
                    }
                } else {
                    self.refusing_line &= self.mid_line;
                    self.refusing_line = self.refusing_line || !arbiter.claim(self.number, other, queues);
                }
                self.mid_line = !is_end(byte);
                if self.refusing_line {
                    if is_end(byte) {
                        self.refusals = self.refusals.saturating_add(1);
                        self.lost = false;
                    }
                    return false;
                }
                let byte = LineByte { byte, epoch: arbiter.epoch, damaged: self.lost };
                let queued = self.held.is_empty() && arbiter.line(byte, queues);
                self.lost = !queued && (self.held.len() >= self.may_hold || self.held.push_back(byte).is_err());
                queued
            }
        }
    }

    /// Takes the first of some bytes as far as they are text and ends of lines by LF: of the host with the floor, where nothing
    /// waits, was lost or is refused. What becomes of such a byte, which nearly all are, needs no other question than whether
    /// there is room. Gives how many.
    #[inline]
    pub fn take_text(&mut self, bytes: &[u8], arbiter: &HostArbiter, queues: &mut impl Queues) -> usize {
        if self.remark.has_begun_character() {
            return 0;
        }
        let has_floor = !arbiter.cut && arbiter.floor.is_held_by(self.number);
        let has_no_room = self.held.len() >= self.may_hold && !queues.waits() && has_floor;
        if self.mid_line && (self.refusing_line || has_no_room) {
            return self.drop_text(bytes);
        }
        let is_text = has_floor && !(self.refusing_line || self.lost || self.after_cr) && self.held.is_empty();
        if !is_text {
            return 0;
        }
        let other = bytes.iter().position(|byte| !is_plain(*byte) && *byte != b'\n');
        let text = bytes.get(..other.unwrap_or(bytes.len())).unwrap_or_default();
        let taken = if text.is_empty() { 0 } else { queues.text(arbiter.epoch, text) };
        if let Some(last) = taken.checked_sub(1).and_then(|last| bytes.get(last)) {
            self.mid_line = *last != b'\n';
            self.is_ambiguous = false;
        }
        if self.remark.is_inside() && text.iter().take(taken).any(|byte| *byte == b'\n') {
            self.remark.leave();
        }
        taken
    }

    /// Drops the text that comes next of a line that is refused, or for which there is no room. Gives how many bytes.
    fn drop_text(&mut self, bytes: &[u8]) -> usize {
        let dropped = bytes.iter().take_while(|byte| is_plain(**byte)).count();
        if dropped > 0 {
            self.after_cr = false;
            self.is_ambiguous = false;
            self.lost |= !self.refusing_line;
        }
        dropped
    }

    /// Whether the next byte belongs to a remark.
    #[inline]
    pub fn is_in_remark(&self) -> bool {
        self.remark.is_inside()
    }

    /// Whether the last byte is a `!` that may be text.
    #[inline]
    pub fn is_ambiguous(&self) -> bool {
        self.is_ambiguous
    }

    /// Nothing has come behind a `!` in a remark for [`AMBIGUOUS_US`], though the link could have taken it, or what comes next may
    /// belong to another line: it is a hold, which [`Link::pass_on`] queues.
    pub fn take_as_command(&mut self) {
        if core::mem::take(&mut self.is_ambiguous) {
            // There is room: it holds what stuck behind this one, and that was no more than a command.
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

    /// There may be room in the queues: what waits is queued. Gives whether something was queued.
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

    /// The other host has reset the machine: of the line that has begun here nothing may be read.
    fn void_line(&mut self, arbiter: &mut HostArbiter) {
        self.is_ambiguous = false;
        if !self.mid_line || self.refusing_line {
            return;
        }
        self.refusing_line = true;
        while self.held.back().is_some_and(|byte| !is_end(byte.byte)) {
            self.held.pop_back();
        }
        arbiter.cut |= self.held.is_empty();
    }

    /// Bytes were lost on the way here: the line that they belong to will be refused.
    pub fn lose(&mut self) {
        self.lost = true;
        self.take_as_command();
        self.remark.leave();
    }

    /// A host has opened its port. Gives whether it has the floor: another host's job continues, and this one is not greeted
    /// within it. A [`HOST_CHANGED`] goes before its first byte of a line: it ends what was there before. What has no place in the
    /// queue is forgotten: it was sent before the port was opened, and the start of its line may be in front of the cut.
    pub fn came(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &impl Queues) -> bool {
        let free = queues.is_free();
        let granted = arbiter.turn_to(other, |floor| floor.claim(self.number, free, true));
        arbiter.cut |= granted;
        self.forget();
        granted
    }

    /// The host has gone. What has no place in the queue goes with it, also the rest of a line, and the next host begins at
    /// the start of one: a [`HOST_CHANGED`] goes before it, and the controller answers none of the lines in front of that. Gives
    /// whether it had the floor.
    pub fn went(&mut self, arbiter: &mut HostArbiter) -> bool {
        let held_floor = arbiter.holder() == self.number;
        arbiter.cut |= held_floor;
        arbiter.gone = arbiter.gone.wrapping_add(u16::from(held_floor));
        arbiter.floor.leave(self.number);
        self.forget();
        held_floor
    }

    fn forget(&mut self) {
        self.take_as_command();
        let stuck = core::mem::take(&mut self.stuck);
        *self = Self { stuck, ..Self::new(self.number, self.may_hold) };
    }

    /// Sends what the host is refused. `false` while there is more of it.
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

/// What a host without the floor is told for each of its lines: 8 is Grbl's "not idle".
const REFUSAL: &[u8] = b"[MSG:Another host has the machine]\r\nerror:8\r\n";

#[cfg(test)]
mod tests;
