//! The host's end of the link. Bytes wait in the host's port, the boards' own [`Link`] fetches them, and the controller
//! takes them from the queues. A host can connect, disconnect, lose bytes and stay silent.
//!
//! ```text
//!  host ──▶ port ──▶ Link ──▶ queues of commands and lines ──▶ control task
//! ```
//! The simulated link has flow control, like USB: bytes for which the link and the board's queues have no room wait in
//! the host's port.

use crate::boards::AXES;
use oxmill_controller::messages::{Event, LINES_DEPTH, LineByte, REALTIME_DEPTH, Realtime};
use oxmill_controller::protocol::link::{AMBIGUOUS_US, MOST_HELD};
use oxmill_controller::units::{Duration, Instant};
use oxmill_controller::{Controller, HostArbiter, Link, Queues};
use std::collections::VecDeque;

/// Index of the host's link.
const HOST: usize = 0;
/// Index of the link that has no host.
const UNUSED: usize = 1;

/// The queues from the link to the control task, as large as the boards'.
#[derive(Clone, Default)]
struct ToControl {
    realtime: VecDeque<Realtime>,
    lines: VecDeque<LineByte>,
    /// `true` if everything that any host has sent has been executed and answered.
    free: bool,
    /// `true` if the controller reads comments as text, character by character.
    reads_characters: bool,
    /// `true` if the controller answers like grblHAL.
    speaks_grblhal: bool,
    /// `true` if a reset has been received since the last call of [`HostLink::wants_stop`].
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

    fn speaks_grblhal(&self) -> bool {
        self.speaks_grblhal
    }
}

/// The host's port, the link after it, and the controller's queues.
#[derive(Clone)]
pub struct HostLink {
    /// Bytes that the host has sent and the link has not fetched yet.
    port: VecDeque<u8>,
    link: Link,
    unused_link: Link,
    arbiter: HostArbiter,
    queues: ToControl,
    /// Number of bytes that the link has fetched (wrapping).
    activity: u16,
    connected: bool,
    disconnected: bool,
    /// A `!` within a comment can be text or a feed hold. If no byte follows it until this time, it becomes a feed
    /// hold.
    command_at: Option<Instant>,
    /// In a replay: `true` if more bytes waited on the board, after the bytes sent so far.
    more: bool,
    /// In a replay: `true` if the host never counts as silent (see [`HostLink::update_activity`]).
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
            activity: 0,
            connected: false,
            disconnected: false,
            command_at: None,
            more: false,
            never_silent: false,
        }
    }
}

impl HostLink {
    /// Puts bytes from the host into its port.
    pub fn send(&mut self, bytes: &[u8]) {
        self.port.extend(bytes);
    }

    /// Sets whether more bytes waited on the board, after the bytes that are sent next. Only a replay calls this.
    pub fn follow(&mut self, more: bool) {
        self.more = more;
    }

    /// Makes the host never count as silent from here on (see [`HostLink::update_activity`]). Only a replay calls this.
    pub fn set_never_silent(&mut self) {
        self.never_silent = true;
    }

    /// Simulates that bytes were lost on their way to the link, after those sent so far. The controller refuses the
    /// line with the lost bytes.
    pub fn lose(&mut self) {
        self.link.lose();
    }

    /// Queues a realtime command that does not come from the host, such as the command of a button.
    pub fn command(&mut self, command: Realtime) {
        // The queue has room: after every input the control task runs and empties it.
        self.arbiter.command(command, &mut self.queues);
    }

    /// Connects the host. Call when it opens the port.
    pub fn connect(&mut self) {
        self.connected |= self.link.came(&mut self.arbiter, &mut self.unused_link, &self.queues);
    }

    /// Disconnects the host. Call when it closes the port or is unplugged. The bytes in the port are lost.
    pub fn disconnect(&mut self) {
        self.port.clear();
        self.disconnected |= self.link.went(&mut self.arbiter);
    }

    // The functions from here on do the work of a board's serial task.

    /// Moves bytes from the link into the queues, as far as there is room. Returns whether any byte was moved.
    pub fn pass_on(&mut self) -> bool {
        self.link.pass_on(&mut self.arbiter, &mut self.queues)
    }

    /// Fetches a byte from the port into the link. Returns whether anything was added to the queues. Returns `None` if
    /// there was no byte to fetch, or no room in the link.
    pub fn fetch<const N: usize>(&mut self, controller: &Controller<N>) -> Option<bool> {
        let byte = if self.link.room() > 0 { self.port.pop_front()? } else { return None };
        self.activity = self.activity.wrapping_add(1);
        self.command_at = None;
        self.queues.free = self.queues.lines.is_empty() && controller.is_free();
        self.queues.reads_characters = controller.reads_characters();
        self.queues.speaks_grblhal = controller.speaks_grblhal();
        Some(self.link.take(byte, &mut self.arbiter, &mut self.unused_link, &mut self.queues))
    }

    /// Turns the last byte received into a feed hold, if it is a `!` in a comment and no byte has followed it for
    /// `AMBIGUOUS_US`. Call after all available bytes have been fetched. Returns whether a command was queued.
    pub fn await_rest(&mut self, now: Instant) -> bool {
        if !self.link.is_ambiguous() {
            return false;
        }
        // Wait while bytes are in the port: they can be the rest of the comment.
        let at = *self.command_at.get_or_insert(now + Duration::micros(AMBIGUOUS_US.into()));
        if !self.port.is_empty() || now < at {
            return false;
        }
        self.command_at = None;
        self.link.take_as_command();
        self.pass_on()
    }

    /// Returns the time at which the last byte received becomes a feed hold, if it is a `!` in a comment. Returns
    /// `None` if it is no such `!`, or if bytes wait in the port.
    pub fn rest_due(&self) -> Option<Instant> {
        self.command_at.filter(|_| self.port.is_empty())
    }

    /// Returns whether a reset has arrived since the last call. The caller must then stop the step task.
    pub fn wants_stop(&mut self) -> bool {
        std::mem::take(&mut self.queues.stop)
    }

    /// Returns whether bytes of the host have not reached the queues yet: they are in the port or in the link.
    pub fn waits(&self) -> bool {
        !self.port.is_empty() || self.link.is_waiting() || self.link.is_ambiguous()
    }

    // The functions from here on are the input of the control task.

    /// Returns the next connect or disconnect.
    pub fn next_event(&mut self) -> Option<Event<AXES>> {
        if std::mem::take(&mut self.disconnected) {
            return Some(Event::Disconnected(self.arbiter.gone()));
        }
        std::mem::take(&mut self.connected).then_some(Event::Connected)
    }

    /// Removes and returns the next realtime command.
    pub fn next_command(&mut self) -> Option<Realtime> {
        self.queues.realtime.pop_front()
    }

    /// Returns the next byte of a line without removing it.
    pub fn line_byte_ahead(&self) -> Option<LineByte> {
        self.queues.lines.front().copied()
    }

    /// Removes and returns the next byte of a line.
    pub fn next_line_byte(&mut self) -> Option<LineByte> {
        self.queues.lines.pop_front()
    }

    /// Number of line bytes in the queue.
    pub fn queued(&self) -> usize {
        self.queues.lines.len()
    }

    /// Number of line bytes in the queue and in the link. Two things count as one further byte each:
    /// * a `HOST_CHANGED` that must be queued before the bytes of the link (it discards the unfinished line of the
    ///   former host),
    /// * in a replay, further bytes that waited on the board.
    pub fn received(&self) -> usize {
        let held = self.link.held();
        self.queues.lines.len()
            + held
            + usize::from(held > 0 && self.arbiter.is_host_change_due())
            + usize::from(self.more)
    }

    /// Number of bytes that the link has fetched (wrapping). The controller takes a host as silent if this number stays
    /// the same. So with `never_silent`, and after [`HostLink::set_never_silent`], each call increases the number.
    pub fn update_activity(&mut self, never_silent: bool) -> u16 {
        self.activity = self.activity.wrapping_add(u16::from(never_silent || self.never_silent));
        self.activity
    }

    /// Number of bytes that the host has sent and the controller has not read: in the queue, the link and the port.
    pub fn unread(&self) -> usize {
        self.port.len() + self.received() - usize::from(self.more)
    }
}
