//! Detects that the host has gone silent. This is necessary because a UART does not report a pulled cable. Every byte
//! that arrives from the host counts as a sign of life.

use crate::units::{Duration, Instant};

/// When the host last sent something, and whether the host was lost during a jog or just before a job resumed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Count of received bytes at the last [`Heartbeat::observe`] (wrapping).
    bytes: u16,
    /// The host has sent something since `alive_at` was set.
    alive: bool,
    alive_at: Instant,
    /// When the host counts as silent; `None` while silence is allowed.
    silent_at: Option<Instant>,
    /// The host disconnected while a job was about to be resumed.
    gone: bool,
    /// The host disconnected or went silent during a jog that is still ending, and the controller must react when it
    /// has ended.
    left_jog: bool,
}

impl Heartbeat {
    /// The host has not sent anything.
    pub const NONE: Heartbeat = Heartbeat {
        bytes: 0,
        alive: false,
        alive_at: Instant::from_ticks(0),
        silent_at: None,
        gone: false,
        left_jog: false,
    };

    /// Updates the count of received bytes (wrapping). Any change of it is a sign of life. The count does not include
    /// realtime commands: for these, call [`Heartbeat::record_activity`].
    #[inline]
    pub fn observe(&mut self, bytes: u16) {
        self.alive |= bytes != self.bytes;
        self.bytes = bytes;
    }

    /// Records that the host is not silent. Call it if the host has sent a realtime command, or if the queue is full,
    /// because bytes from the host may then be waiting outside of the queue.
    #[inline]
    pub fn record_activity(&mut self) {
        self.alive = true;
    }

    /// Allows silence until the next call of [`Heartbeat::is_silent`]. That call starts to measure the silence anew.
    #[inline]
    pub fn allow_silence(&mut self) {
        self.silent_at = None;
        self.alive = true;
    }

    /// Returns whether the host has been silent for `longest` or more. Also updates the time that
    /// [`Heartbeat::silent_at`] returns.
    pub fn is_silent(&mut self, now: Instant, longest: Duration) -> bool {
        if core::mem::take(&mut self.alive) {
            self.alive_at = now;
        }
        let silent_at = self.alive_at + longest;
        self.silent_at = Some(silent_at);
        now >= silent_at
    }

    /// Records whether the controller must react to the loss of the host when the present jog has ended.
    pub fn set_left_jog(&mut self, left_jog: bool) {
        self.left_jog = left_jog;
    }

    /// Returns whether the controller must react to the loss of the host, now that the jog has ended. Clears this
    /// record.
    pub fn take_left_jog(&mut self) -> bool {
        core::mem::take(&mut self.left_jog)
    }

    /// Records whether the host disconnected while a job was about to be resumed. `gone`: `false` also clears what
    /// [`Heartbeat::set_left_jog`] has recorded.
    pub fn set_gone(&mut self, gone: bool) {
        self.gone = gone;
        self.left_jog &= gone;
    }

    /// Returns whether the host disconnected while a job was about to be resumed. Clears this record.
    pub fn take_gone(&mut self) -> bool {
        core::mem::take(&mut self.gone)
    }

    /// Returns the time at which the host counts as silent if it sends nothing more; `None` while silence is allowed.
    #[inline]
    pub fn silent_at(&self) -> Option<Instant> {
        self.silent_at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_byte_is_a_sign_of_life() {
        let at = |ms: u64| Instant::from_ticks(0) + Duration::millis(ms);
        let longest = Duration::millis(500);
        let mut heartbeat = Heartbeat::NONE;
        heartbeat.observe(7);
        assert!(!heartbeat.is_silent(at(100), longest));
        heartbeat.observe(7);
        assert!(!heartbeat.is_silent(at(599), longest));
        assert_eq!(heartbeat.silent_at(), Some(at(600)));
        assert!(heartbeat.is_silent(at(600), longest));
        heartbeat.record_activity();
        assert!(!heartbeat.is_silent(at(700), longest));
        // A smaller count is also a sign of life, because the count wraps.
        heartbeat.observe(6);
        assert!(!heartbeat.is_silent(at(800), longest));
        assert_eq!(heartbeat.silent_at(), Some(at(1300)));
        heartbeat.allow_silence();
        assert_eq!(heartbeat.silent_at(), None);
        assert!(!heartbeat.is_silent(at(9000), longest));
        assert_eq!(heartbeat.silent_at(), Some(at(9500)));
    }
}
