//! Messages between the serial task and the control task: realtime commands, bytes of lines with their epoch, and
//! pieces of replies.

/// A command that acts at once, even in the middle of a line; one byte on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "Grbl's own names; bytes in protocol::realtime")]
pub enum Realtime {
    /// 0x18. The sender has also raised the sticky stop of the step task.
    Reset,
    /// 0x19, as in grblHAL: brake, forget what is queued, keep position and modal state.
    Stop,
    Status,
    CycleStart,
    FeedHold,
    SafetyDoor,
    JogCancel,
    FeedReset,
    FeedUp10,
    FeedDown10,
    FeedUp1,
    FeedDown1,
    RapidFull,
    RapidHalf,
    RapidQuarter,
    SpindleReset,
    SpindleUp10,
    SpindleDown10,
    SpindleUp1,
    SpindleDown1,
    SpindleStop,
    FloodToggle,
    MistToggle,
    /// 0x89, as in grblHAL: the program pauses behind each line that moves, or no longer.
    SingleBlock,
}

impl Realtime {
    /// Whether it begins another epoch of line bytes: see [`LineByte`].
    pub fn opens_epoch(self) -> bool {
        matches!(self, Realtime::Reset | Realtime::Stop | Realtime::JogCancel)
    }
}

/// In place of a byte of a line: what has come of the line is void, for its host has gone or lost the floor. No host can
/// send it, as 0x18 is a command. In place of the epoch it has the number (wrapping) of hosts that have gone before it, as
/// [`Event::Disconnected`](super::Event::Disconnected).
pub const HOST_CHANGED: u8 = 0x18;

/// A byte of a line and the epoch it came in: the number (wrapping) of resets, stops and jog cancels that had been handed
/// to `control` before it. So a byte sent before a reset is dropped and one sent after it never is, although the two queues to
/// `control` keep no order between them.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineByte {
    /// The byte.
    pub byte: u8,
    /// The epoch when it came.
    pub epoch: u16,
    /// Bytes before this one were lost: the line it belongs to is refused.
    pub damaged: bool,
}

/// serial -> control: bytes of lines that were received one after the other, all of one epoch. A message for each of them
/// would cost more than to read it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineBytes {
    epoch: u16,
    /// A bit for each byte: [`LineByte::damaged`].
    damaged: u16,
    len: u8,
    bytes: [u8; LineBytes::MOST],
}

impl LineBytes {
    /// How many bytes fit.
    pub const MOST: usize = 15;
    /// None.
    pub const EMPTY: LineBytes = LineBytes { epoch: 0, damaged: 0, len: 0, bytes: [0; LineBytes::MOST] };

    /// How many there are.
    #[inline]
    pub fn len(&self) -> usize {
        self.len.into()
    }

    /// Whether there are none.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Adds one. `false`: there is no room, or it is of another epoch.
    #[inline]
    pub fn push(&mut self, byte: LineByte) -> bool {
        if self.len == 0 {
            (self.epoch, self.damaged) = (byte.epoch, 0);
        }
        let (same, place) = (self.epoch == byte.epoch, self.bytes.get_mut(usize::from(self.len)));
        let Some(place) = place.filter(|_| same) else { return false };
        *place = byte.byte;
        self.damaged |= u16::from(byte.damaged) << self.len;
        self.len += 1;
        true
    }

    /// Adds as many of some undamaged bytes as there is room for; none if they are of another epoch. Gives how many.
    #[inline]
    pub fn extend(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        if self.len == 0 {
            (self.epoch, self.damaged) = (epoch, 0);
        }
        let room = self.bytes.get_mut(usize::from(self.len)..).filter(|_| self.epoch == epoch).unwrap_or_default();
        let count = room.len().min(bytes.len());
        for (place, byte) in room.iter_mut().zip(bytes) {
            *place = *byte;
        }
        self.len += count as u8;
        count
    }

    /// Their epoch and the bytes from a place on, if none of all is damaged.
    #[inline]
    pub fn undamaged(&self, from: usize) -> (u16, &[u8]) {
        let bytes = if self.damaged == 0 { self.bytes.get(from..self.len()) } else { None };
        (self.epoch, bytes.unwrap_or_default())
    }

    /// The byte at a place, from 0.
    #[inline]
    pub fn get(&self, place: usize) -> Option<LineByte> {
        let byte = *self.bytes.get(place).filter(|_| place < self.len())?;
        Some(LineByte { byte, epoch: self.epoch, damaged: self.damaged >> place & 1 != 0 })
    }
}

/// A few bytes of answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// How many of `bytes` count, 1..=15.
    pub len: u8,
    /// The text.
    pub bytes: [u8; 15],
}

impl Chunk {
    /// The bytes that count.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }
}
