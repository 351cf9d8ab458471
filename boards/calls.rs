//! When the serial task is called for what can wait: at once, but then not again for 500 us. So a host, or noise on a wire, that
//! sends without end leaves time for the control task, which prepares what the step task puts out. A command that stops the machine does
//! not wait for this.

/// Samples of the inputs between two calls: 500 us. At 1 Mbaud the 255 bytes that a host has under way take 2.5 ms, and in that time the
/// first of them has to be called for, carried out and answered, or the line falls silent.
pub const REST: u8 = 10;

/// When to call.
#[derive(Debug, Default)]
pub struct Calls {
    /// Samples until it may be called again.
    rests: u8,
}

impl Calls {
    /// The next call is made at once.
    pub const fn new() -> Self {
        Calls { rests: 0 }
    }

    /// The inputs are sampled. Whether to call now: `has_news` is asked only if it is time.
    #[inline(always)]
    pub fn sample(&mut self, has_news: impl FnOnce() -> bool) -> bool {
        self.rests = self.rests.saturating_sub(1);
        let calls = self.rests == 0 && has_news();
        if calls {
            self.rests = REST;
        }
        calls
    }
}

/// The byte that resets.
pub const RESET: u8 = 0x18;

/// Whether a byte stops the machine: hold, reset, stop, door, the end of a jog.
#[inline(always)]
pub fn is_stop(byte: u8) -> bool {
    matches!(byte, b'!' | RESET | 0x19 | 0x84 | 0x85)
}
