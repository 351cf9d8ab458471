//! Detects hosts at a USB serial port: whether one is connected, when it leaves, and when another one takes its place.
//! The detection uses the DTR line, the state of the device (configured or not), and received packets. Bytes of a
//! departed host that arrive late are rejected.
//!
//! Accesses no registers: the caller passes the driver's state, so that host tests can run this code.

/// Time in microseconds during which bytes of a departed host can still arrive. An operating system cancels them much
/// sooner.
pub const LATE_BYTES_US: u32 = 200_000;

/// State of the host, as far as the port can detect it.
#[derive(Clone, Debug)]
pub struct UsbHost {
    /// Bytes have been received since the last host left, so a host is connected. Some hosts never raise DTR: only
    /// their bytes show that they are there.
    spoken: bool,
    /// Time at which DTR fell; `None` when no late bytes can arrive any more. A host closes its port before it cancels
    /// its unsent bytes, so they can arrive after DTR has fallen.
    closing: Option<u32>,
    /// Arguments of the last [`UsbHost::look`].
    dtr: bool,
    configured: bool,
}

/// What [`UsbHost::look`] has found since the last call.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Look {
    /// A host has left: discard the bytes received from it and the bytes queued for it.
    pub gone: bool,
    /// A host is connected.
    pub there: bool,
}

impl Default for UsbHost {
    fn default() -> Self {
        Self::new()
    }
}

impl UsbHost {
    /// Returns the state of a port without a host and without a cable.
    pub const fn new() -> Self {
        Self { spoken: false, closing: None, dtr: false, configured: false }
    }

    /// Updates the state. `dtr`: `true` while the host raises the DTR line. `configured`: `true` while the host has
    /// configured the USB device. `now`: reads a free-running clock.
    pub fn look(&mut self, dtr: bool, configured: bool, now: impl FnOnce() -> u32) -> Look {
        // `closed`: DTR falls when the host closes the port. `unplugged`: the bus goes idle when the cable is pulled.
        let (closed, unplugged) = (self.dtr && !dtr, self.configured && !configured);
        // If a host has sent bytes without opening the port (without DTR), and DTR rises now, another host has opened
        // the port.
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
        // If another host has taken the port over, store DTR as low. This call then reports that no host is there. At
        // the next call DTR seems to rise, and the new host is reported.
        self.dtr = dtr && !changes_hands;
        self.configured = configured;
        Look { gone, there: configured && self.is_listening() }
    }

    /// Decides whether to accept a received packet; call this for each packet that is not empty. Returns `false` if
    /// the packet may come from a departed host. `late` is [`LATE_BYTES_US`] in ticks of the clock.
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

    /// Returns whether a host reads the bytes sent. The answer holds only while the device is configured.
    pub fn is_listening(&self) -> bool {
        self.dtr || self.spoken
    }
}
