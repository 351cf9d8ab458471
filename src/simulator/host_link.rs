//! The host's end of the link. Bytes wait in the host's port, the boards' own [`Link`] fetches
//! them, and the controller takes them from the queues. A host can connect, disconnect, lose bytes and stay silent.
//!
//! ```text
//!  host ──▶ port ──▶ Link ──▶ queues of commands and lines ──▶ control task
//! ```
//! The host is on a link like USB, which can wait: what has no room in the board's queues and in the link waits in the
//! host's port.

use crate::boards::AXES;
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, REALTIME_DEPTH, Realtime};
use oxmill_controller::protocol::link::{AMBIGUOUS_US, MOST_HELD};
use oxmill_controller::units::{Duration, Instant};
use oxmill_controller::{HostArbiter, Link, Queues};
use std::collections::VecDeque;

/// Number of the host's link, and of the one that has no host.
const HOST: usize = 0;
const UNUSED: usize = 1;

/// The queues from the link to the control task, as deep as the boards'.
#[derive(Clone, Default)]
struct ToControl {
    realtime: VecDeque<Realtime>,
    lines: VecDeque<LineByte>,
    /// All that any host has said is done and answered.
    free: bool,
    /// Characters of remarks are text.
    reads_characters: bool,
    /// The step task has to be stopped.
    stop: bool,
}

impl Queues for ToControl {
    fn realtime(&mut self, command: Realtime) -> bool {
        let room = self.realtime.len() < REALTIME_DEPTH;
        if room {
            self.realtime.push_back(command);
        }
        room
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let room = self.lines.len() < LINES_DEPTH;
        if room {
            self.lines.push_back(byte);
        }
        room
    }

    fn waits(&self) -> bool {
        true
    }

    fn is_free(&self) -> bool {
        self.free
    }

    fn stop(&mut self) {
        self.stop = true;
    }

    fn reads_characters(&self) -> bool {
        self.reads_characters
    }
}

/// The link with what is in front of it and behind it.
#[derive(Clone)]
pub struct HostLink {
    /// Sent by the host and not yet fetched by the link, which has no room.
    port: VecDeque<u8>,
    link: Link,
    unused_link: Link,
    arbiter: HostArbiter,
    queues: ToControl,
    /// Bytes that the link has fetched (wrapping).
    heard: u16,
    connected: bool,
    disconnected: bool,
    /// When a `!` that may be text is a command, if nothing comes until then.
    command_at: Option<Instant>,
    /// More bytes wait behind those that were sent, in a replay.
    more: bool,
    /// The host is never silent, in a replay.
    never_silent: bool,
}

impl Default for HostLink {
    fn default() -> Self {
        HostLink {
            port: VecDeque::new(),
            link: Link::new(HOST, MOST_HELD),
            unused_link: Link::new(UNUSED, 0),
            arbiter: HostArbiter::new(),
            queues: ToControl::default(),
            heard: 0,
            connected: false,
            disconnected: false,
            command_at: None,
            more: false,
            never_silent: false,
        }
    }
}

impl HostLink {
    /// Bytes from the host reach its port.
    pub fn send(&mut self, bytes: &[u8]) {
        self.port.extend(bytes);
    }

    /// More bytes wait behind those that come next, or not.
    pub fn follow(&mut self, more: bool) {
        self.more = more;
    }

    /// From here on the host is never silent.
    pub fn hear_always(&mut self) {
        self.never_silent = true;
    }

    /// Bytes are lost here.
    pub fn lose(&mut self) {
        self.link.lose();
    }

    /// A realtime command that does not come over the wire.
    pub fn command(&mut self, command: Realtime) {
        // There is room: each turn empties the queue.
        self.arbiter.command(command, &mut self.queues);
    }

    /// A host has opened the port.
    pub fn connect(&mut self) {
        self.connected |= self.link.came(&mut self.arbiter, &mut self.unused_link, &self.queues);
    }

    /// The host has closed the port, or is unplugged; what the port holds goes with it.
    pub fn disconnect(&mut self) {
        self.port.clear();
        self.disconnected |= self.link.went(&mut self.arbiter);
    }

    // The serial task

    /// What the link holds goes into the queues, as far as there is room; whether anything did.
    pub fn pass_on(&mut self) -> bool {
        self.link.pass_on(&mut self.arbiter, &mut self.queues)
    }

    /// Fetches a byte from the port, if there are one and room for it; whether something was queued. `is_free`,
    /// `reads_characters`: what the controller says.
    pub fn fetch(&mut self, is_free: bool, reads_characters: bool) -> Option<bool> {
        let byte = if self.link.room() > 0 { self.port.pop_front()? } else { return None };
        self.heard = self.heard.wrapping_add(1);
        self.command_at = None;
        self.queues.free = self.queues.lines.is_empty() && is_free;
        self.queues.reads_characters = reads_characters;
        Some(self.link.take(byte, &mut self.arbiter, &mut self.unused_link, &mut self.queues))
    }

    /// All that could be fetched has been: if the last byte is a `!` that may be text, the rest of its line is waited for.
    /// Whether it has been waited for long enough, and a command was queued.
    pub fn await_rest(&mut self, now: Instant) -> bool {
        if !self.link.is_ambiguous() {
            return false;
        }
        // What has no room yet may be the rest.
        let at = *self.command_at.get_or_insert(now + Duration::micros(AMBIGUOUS_US.into()));
        if !self.port.is_empty() || now < at {
            return false;
        }
        self.command_at = None;
        self.link.take_as_command();
        self.pass_on()
    }

    /// When to look again at a `!` that may be text, if the host could send the rest of its line.
    pub fn rest_due(&self) -> Option<Instant> {
        self.command_at.filter(|_| self.port.is_empty())
    }

    /// Whether the step task has to be stopped; `true` once.
    pub fn wants_stop(&mut self) -> bool {
        std::mem::take(&mut self.queues.stop)
    }

    /// Whether something has found no room.
    pub fn waits(&self) -> bool {
        !self.port.is_empty() || self.link.is_waiting() || self.link.is_ambiguous()
    }

    // The control task

    /// A host that has gone or come.
    pub fn next_event(&mut self) -> Option<Event<AXES>> {
        if std::mem::take(&mut self.disconnected) {
            return Some(Event::Disconnected(self.arbiter.gone()));
        }
        std::mem::take(&mut self.connected).then_some(Event::Connected)
    }

    /// The next command.
    pub fn next_command(&mut self) -> Option<Realtime> {
        self.queues.realtime.pop_front()
    }

    /// The next byte of a line, which stays.
    pub fn line_byte_ahead(&self) -> Option<LineByte> {
        self.queues.lines.front().copied()
    }

    /// The next byte of a line.
    pub fn next_line_byte(&mut self) -> Option<LineByte> {
        self.queues.lines.pop_front()
    }

    /// Line bytes in the queue.
    pub fn queued(&self) -> usize {
        self.queues.lines.len()
    }

    /// Line bytes in the queue, those that wait in the link for room in it, and the cut that goes before these.
    pub fn received(&self) -> usize {
        let held = self.link.held();
        self.queues.lines.len() + held + usize::from(held > 0 && self.arbiter.owes_cut()) + usize::from(self.more)
    }

    /// Bytes that the link has fetched (wrapping); one more each time it is asked in place of a host that cannot be silent.
    pub fn heard(&mut self, never_silent: bool) -> u16 {
        self.heard = self.heard.wrapping_add(u16::from(never_silent || self.never_silent));
        self.heard
    }

    /// Bytes sent and not yet taken by the controller: in its queue, in the link, and in the port.
    pub fn unread(&self) -> usize {
        self.port.len() + self.received() - usize::from(self.more)
    }
}
