//! Limits how often received bytes call the serial task: at most once per 500 us. If the last such call is longer ago,
//! the next byte calls the task at once. Without this limit, a host that sends without pause, or noise on a wire,
//! would leave the control task too little CPU time to prepare the motion. Commands that stop the machine bypass the
//! limit.

/// Minimum time between two calls of the serial task: 10 samples of the inputs, or 500 us. A host can have 255 bytes
/// in flight, which take 2.55 ms at 1 Mbaud. The host has to pause if it takes longer than these 2.55 ms to deliver,
/// execute and answer the first line among these bytes. So `REST` must be well below 2.55 ms.
pub const REST: u8 = 10;

/// Rate limiter for calls of the serial task.
#[derive(Debug, Default)]
pub struct Calls {
    /// Number of samples until the next call is allowed.
    rests: u8,
}

impl Calls {
    /// Creates a limiter that allows a call at once.
    pub const fn new() -> Self {
        Calls { rests: 0 }
    }

    /// Counts one sample of the inputs. Returns true if the serial task must be called now. This is the case if the
    /// pause since the last call is over and `has_news` returns true. `has_news` returns whether there is work for the
    /// serial task; it is not called during the pause.
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

/// The soft-reset byte (Ctrl-X).
pub const RESET: u8 = 0x18;

/// Returns whether a byte stops the machine: feed hold, reset, stop, door or jog cancel.
#[inline(always)]
pub fn is_stop(byte: u8) -> bool {
    matches!(byte, b'!' | RESET | 0x19 | 0x84 | 0x85)
}
