//! Notices a host that has gone silent. A UART does not report a pulled cable, so every byte of a line and every
//! realtime command counts as a sign of life.

use crate::units::{Duration, Instant};

/// When the host was heard last.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Heartbeat {
    /// Bytes received when the host was heard last (wrapping).
    bytes: u16,
    /// It has been heard, and the time of that is not taken yet.
    heard: bool,
    heard_at: Instant,
    /// When it will have been silent for too long.
    silent_at: Option<Instant>,
    /// It has gone while a job was about to be resumed.
    gone: bool,
    /// It has gone in a jog, which ends.
    left_jog: bool,
}

impl Heartbeat {
    /// Not heard yet.
    pub const NONE: Heartbeat = Heartbeat {
        bytes: 0,
        heard: false,
        heard_at: Instant::from_ticks(0),
        silent_at: None,
        gone: false,
        left_jog: false,
    };

    /// So many bytes of lines have been received (wrapping).
    #[inline]
    pub fn observe(&mut self, bytes: u16) {
        self.heard |= bytes != self.bytes;
        self.bytes = bytes;
    }

    /// A realtime command has come.
    #[inline]
    pub fn hear(&mut self) {
        self.heard = true;
    }

    /// It may be silent as long as it likes. Whenever that ends it counts as heard.
    #[inline]
    pub fn rest(&mut self) {
        self.silent_at = None;
        self.heard = true;
    }

    /// Whether the host has been silent for longer than this.
    pub fn is_silent(&mut self, now: Instant, longest: Duration) -> bool {
        if core::mem::take(&mut self.heard) {
            self.heard_at = now;
        }
        let silent_at = self.heard_at + longest;
        self.silent_at = Some(silent_at);
        now >= silent_at
    }

    /// Notes whether it has gone in a jog.
    pub fn set_left_jog(&mut self, left_jog: bool) {
        self.left_jog = left_jog;
    }

    /// Whether it has; told once.
    pub fn take_left_jog(&mut self) -> bool {
        core::mem::take(&mut self.left_jog)
    }

    /// Notes whether it has gone while a job was about to be resumed.
    pub fn set_gone(&mut self, gone: bool) {
        self.gone = gone;
        self.left_jog &= gone;
    }

    /// Whether it has; told once.
    pub fn take_gone(&mut self) -> bool {
        core::mem::take(&mut self.gone)
    }

    /// When it will have been, if it says nothing more; none while silence is allowed.
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
        heartbeat.hear();
        assert!(!heartbeat.is_silent(at(700), longest));
        // The count wraps.
        heartbeat.observe(6);
        assert!(!heartbeat.is_silent(at(800), longest));
        assert_eq!(heartbeat.silent_at(), Some(at(1300)));
        heartbeat.rest();
        assert_eq!(heartbeat.silent_at(), None);
        assert!(!heartbeat.is_silent(at(9000), longest));
        assert_eq!(heartbeat.silent_at(), Some(at(9500)));
    }
}
