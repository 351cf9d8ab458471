//! Decides which of two hosts is the active one: its lines are read, and it gets the replies. The links of UART and USB
//! share a [`HostArbiter`]. It counts the epochs of line bytes in the order of the queue, and puts a [`HOST_CHANGED`]
//! before the first line byte of another host.

use crate::messages::{HOST_CHANGED, LineByte, Realtime};
use crate::protocol::active_host::ActiveHost;
use crate::protocol::queues::Queues;

/// Decides which of the hosts on several links is the active one, and counts the epochs of the bytes of all hosts.
#[derive(Clone, Debug, Default)]
pub struct HostArbiter {
    active: ActiveHost,
    /// Epoch of the next line byte: the number of resets, stops and jog cancels queued before it (wrapping, see
    /// [`LineByte`]). A command counts when it is queued, not when it is received: while it waits for room, a command
    /// of the other host may be queued first.
    epoch: u16,
    /// The unfinished line in the queue is void: a [`HOST_CHANGED`] must precede the next line byte.
    host_change_due: bool,
    /// Number of times that the active host has disconnected, since power-up (wrapping).
    gone: u16,
}

impl HostArbiter {
    /// Creates an arbiter to which no host has sent anything.
    pub const fn new() -> Self {
        Self { active: ActiveHost::new(), epoch: 0, host_change_due: false, gone: 0 }
    }

    /// Returns the link that gets the replies.
    pub fn active_link(&self) -> usize {
        self.active.link()
    }

    /// Returns how many times the active host has disconnected, since power-up (wrapping), for `Event::Disconnected`.
    pub fn gone(&self) -> u16 {
        self.gone
    }

    /// Returns whether a [`HOST_CHANGED`] must be queued before the next line byte. If line bytes wait for room, the
    /// caller must include this `HOST_CHANGED` in the number of received bytes.
    pub fn is_host_change_due(&self) -> bool {
        self.host_change_due
    }

    /// Queues a command, from a link or from elsewhere. A reset, stop or jog cancel that is queued advances the epoch
    /// of later line bytes. Returns whether there was room.
    pub fn command(&mut self, command: Realtime, queues: &mut impl Queues) -> bool {
        let queued = queues.realtime(command);
        if queued && command.opens_epoch() {
            self.epoch = self.epoch.wrapping_add(1);
        }
        queued
    }

    #[inline]
    pub(super) fn epoch(&self) -> u16 {
        self.epoch
    }

    /// Returns whether the link's line bytes can be put into the queue directly: its host is the active one, and no
    /// [`HOST_CHANGED`] must be queued before them.
    #[inline]
    pub(super) fn reads(&self, link: usize) -> bool {
        !self.host_change_due && self.active.is_held_by(link)
    }

    /// Makes the arbiter send a [`HOST_CHANGED`] before the next byte of a line.
    #[inline]
    pub(super) fn require_host_change(&mut self) {
        self.host_change_due = true;
    }

    /// Queues a line byte, after a [`HOST_CHANGED`] if one is required. Returns whether there was room.
    pub(super) fn line(&mut self, byte: LineByte, queues: &mut impl Queues) -> bool {
        if self.host_change_due && !queues.line(LineByte { byte: HOST_CHANGED, epoch: self.gone, damaged: false }) {
            return false;
        }
        self.host_change_due = false;
        queues.line(byte)
    }

    /// Claims the role of the active host for the host of `link`, which sends a line. Returns whether that host is the
    /// active one afterwards. If the other host loses this role, `void` voids its unfinished line.
    #[inline]
    pub(super) fn claim(&mut self, link: usize, queues: &impl Queues, void: impl FnOnce()) -> bool {
        // In the common case this host is already the active one.
        if self.active.is_held_by(link) {
            return true;
        }
        let free = queues.is_free();
        self.turn_to(|active| active.claim(link, free, true), void)
    }

    /// Lets `ask` request the role of the active host, and returns its result. If the active host changes, `void` voids
    /// the unfinished line of the previous one.
    pub(super) fn turn_to(&mut self, ask: impl FnOnce(&mut ActiveHost) -> bool, void: impl FnOnce()) -> bool {
        let before = self.active.link();
        let granted = ask(&mut self.active);
        if self.active.link() != before {
            void();
            self.host_change_due = true;
        }
        granted
    }

    /// Records that the host of `link` has disconnected. Returns whether it was the active host.
    pub(super) fn leave(&mut self, link: usize) -> bool {
        let was_active = self.active_link() == link;
        self.host_change_due |= was_active;
        self.gone = self.gone.wrapping_add(u16::from(was_active));
        self.active.leave(link);
        was_active
    }
}

#[cfg(test)]
mod tests;
