//! Limits how often the serial task is called for received bytes that are not urgent: at most once per 500 us. If its
//! last such call is longer ago, it is called at once. So even if bytes arrive without pause, from a host or as noise
//! on a wire, the control task gets CPU time to prepare the motion. Commands that stop the machine bypass this limit.

/// Minimum time between two calls of the serial task, in samples of the inputs: 500 us. This must be well below the
/// 2.55 ms in which a host at 1 Mbaud sends the 255 bytes that it can have in flight. If the first line among these
/// bytes is not delivered, executed and answered within that time, the host has to pause.
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

    /// Counts one sample of the inputs. Returns whether to call the serial task; evaluates `has_news` only if a call is
    /// allowed.
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
