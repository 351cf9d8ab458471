//! Who is at the other end of a USB serial port. `UsbHost` looks at whether the device is `configured`, at `dtr` and at
//! who has `spoken`, and a `Look` says whether there is a host, when one has gone (`unplugged`, `closed`, `closing`) or
//! another has come (`opened`, `changes_hands`), and whether what is received `late` is still of one that has gone.
//!
//! No registers: it is told what the driver sees, and runs on a desk as well.

/// How long after its end a host's bytes may still come, in microseconds: much longer than an operating system takes to call
/// them back.
pub const LATE_BYTES_US: u32 = 200_000;

/// The host, as far as the port can tell.
#[derive(Clone, Debug)]
pub struct UsbHost {
    /// The host has sent something since it set the device up or closed its port: some never raise DTR.
    spoken: bool,
    /// When DTR fell, while what comes may still be of the host that has gone: it closes its port first and calls back what
    /// it was about to send afterwards.
    closing: Option<u32>,
    /// As they were at the last look.
    dtr: bool,
    configured: bool,
}

/// What a look has found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// A host has gone: what it has sent goes with it, and what it was to be sent.
    pub gone: bool,
    /// A host is there.
    pub there: bool,
}

impl Default for UsbHost {
    fn default() -> Self {
        Self::new()
    }
}

impl UsbHost {
    /// No host.
    pub const fn new() -> Self {
        Self { spoken: false, closing: None, dtr: false, configured: false }
    }

    /// The driver has been asked: its DTR, and whether the device is set up. `now` reads a free-running clock.
    pub fn look(&mut self, dtr: bool, configured: bool, now: impl FnOnce() -> u32) -> Look {
        // DTR falls when the port is closed, the bus goes idle when the cable is pulled.
        let (closed, unplugged) = (self.dtr && !dtr, self.configured && !configured);
        // Whoever opens the port is another host than one that has spoken without.
        let opened = !self.dtr && dtr;
        let changes_hands = opened && self.spoken;
        let gone = closed || unplugged || changes_hands;
        if gone {
            self.spoken = false;
        }
        if closed {
            self.closing = Some(now());
        } else if opened || unplugged {
            self.closing = None;
        }
        // One that has gone for a moment is seen to go: the next look finds the other.
        self.dtr = dtr && !changes_hands;
        self.configured = configured;
        Look { gone, there: configured && self.is_listening() }
    }

    /// A packet has come, with something in it. Whether it counts: it is not of a host that has gone. `late` is
    /// [`LATE_BYTES_US`] in ticks of the clock.
    pub fn speaks(&mut self, late: u32, now: impl FnOnce() -> u32) -> bool {
        if let Some(since) = self.closing {
            if now().wrapping_sub(since) < late {
                return false;
            }
            self.closing = None;
        }
        self.spoken = true;
        true
    }

    /// Whether a host reads what is sent, as long as the device is set up.
    pub fn is_listening(&self) -> bool {
        self.dtr || self.spoken
    }
}
