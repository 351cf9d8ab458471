//! At which baud rate a serial port listens: the one that a setting chooses, or, for a host that does not know it, the
//! usual one. A rate that no host can use would else lock everyone out, for settings come over the same line.
//!
//! ```text
//!             garbled thrice, nothing heard lately          a line end or ? is heard
//!   home ────────────────────────────────────────▶ usual ─────────────────────────▶ stays there
//!    ▲  ▲                                            │                                    │
//!    │  └──────── nothing heard within 5 s ──────────┘                                    │
//!    └──────────────────── garbled thrice, nothing heard lately ──────────────────────────┘
//! ```
//!
//! Names: `BaudGuard` has a `home` rate and the [`USUAL`] one; it is told what is `heard` and what is `garbled`.

/// The rate of senders for Grbl, and of a new controller.
pub const USUAL: u32 = 115_200;

/// So many garbled bytes are no disturbance.
const GARBLED: u8 = 3;
/// A line end or a `?` that was heard so lately was no accident, in microseconds.
const LATELY: u32 = 10_000_000;
/// For so long a host at the usual rate may take to be heard.
const PATIENCE: u32 = 5_000_000;

/// Which rate to listen at. Times are in microseconds, wrapping.
#[derive(Clone, Debug)]
pub struct BaudGuard {
    home: u32,
    /// At the usual rate instead.
    away: bool,
    /// Garbled bytes since a line end was heard.
    garbled: u8,
    /// When the rate changed, or the last line end was heard at it.
    since: u32,
    /// One was heard.
    heard: bool,
}

impl BaudGuard {
    /// At the usual rate.
    pub const fn new() -> Self {
        Self { home: USUAL, away: false, garbled: 0, since: 0, heard: false }
    }

    /// Listens at this rate from now on.
    pub fn choose(&mut self, baud: u32) {
        *self = Self { home: baud, ..Self::new() };
    }

    /// Whether there is but one rate.
    #[inline]
    pub fn is_settled(&self) -> bool {
        self.home == USUAL
    }

    /// The end of a line or a `?` has come undisturbed: other rates hardly ever make one of what they take for bytes.
    pub fn heard(&mut self, now: u32) {
        (self.garbled, self.since, self.heard) = (0, now, true);
    }

    /// A byte has come whose stop bit was none. Gives the rate to change to.
    pub fn garbled(&mut self, now: u32) -> Option<u32> {
        let lately = self.heard && now.wrapping_sub(self.since) < LATELY;
        let waits = self.away && !self.heard;
        if self.is_settled() || lately || waits {
            self.garbled = 0;
            return None;
        }
        self.garbled += 1;
        (self.garbled >= GARBLED).then(|| self.change(now))
    }

    /// Something may have come. Gives the rate to change to, if nothing was heard at the usual one.
    pub fn home_again(&mut self, now: u32) -> Option<u32> {
        (self.away && !self.heard && now.wrapping_sub(self.since) > PATIENCE).then(|| self.change(now))
    }

    fn change(&mut self, now: u32) -> u32 {
        *self = Self { home: self.home, away: !self.away, garbled: 0, since: now, heard: false };
        if self.away { USUAL } else { self.home }
    }
}

impl Default for BaudGuard {
    fn default() -> Self {
        Self::new()
    }
}
