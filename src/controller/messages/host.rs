//! Messages between the serial task and the control task: realtime commands, bytes of lines with their epoch, and
//! pieces of replies.

/// A command that acts immediately, even in the middle of a line; one byte on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "Grbl's own names; bytes in protocol::realtime")]
pub enum Realtime {
    /// 0x18. The serial task has already requested the stop of the step task, so that the stop does not wait in the
    /// queue with this command.
    Reset,
    /// 0x19, as in grblHAL: brakes and discards the queue, but keeps position and modal state.
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
    /// 0x89, as in grblHAL: toggles single-block mode, in which the program pauses after each line that moves.
    SingleBlock,
    /// 0x83, only with `$900=3`: sends the parser state, without `ok`.
    ParserState,
    /// 0x87, only with `$900=3`: sends a status report with all fields.
    FullStatus,
    /// 0x88, only with `$900=3`: switches the pause at M1 on or off.
    OptionalStop,
    /// 0xA3, only with `$900=3`: the operator has changed the tool.
    ToolReady,
}

impl Realtime {
    /// Returns whether the command starts a new epoch of line bytes: see [`LineByte`].
    pub fn opens_epoch(self) -> bool {
        matches!(self, Realtime::Reset | Realtime::Stop | Realtime::JogCancel)
    }
}

/// Value of a [`LineByte`] that marks a change of hosts and belongs to no line. The unfinished line before it is void,
/// because its host has disconnected or is no longer the active host (the one whose lines are read: see
/// `protocol::active_host`). No host can send this value in a line, because 0x18 is a command. The mark's `epoch` is
/// the count (wrapping) of hosts that have disconnected so far, as in
/// [`Event::Disconnected`](super::Event::Disconnected).
pub const HOST_CHANGED: u8 = 0x18;

/// A byte of a line and its epoch: the count (wrapping) of resets, stops and jog cancels that were passed to `control`
/// before the byte. Commands and line bytes wait in separate queues. The epoch shows their order: a byte sent before a
/// reset must be dropped, and a byte sent after it must be kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineByte {
    /// The byte as received, or [`HOST_CHANGED`].
    pub byte: u8,
    /// The number of resets, stops and jog cancels (wrapping) before the byte.
    pub epoch: u16,
    /// Bytes before this byte were lost, so its line is refused.
    pub damaged: bool,
}

/// serial -> control: consecutive line bytes of one epoch (see [`LineByte`]). One message carries several bytes,
/// because a message for each byte would cost more than reading the byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineBytes {
    epoch: u16,
    /// [`LineByte::damaged`] of each byte, as bits.
    damaged: u16,
    len: u8,
    bytes: [u8; LineBytes::MOST],
}

impl LineBytes {
    /// Maximum number of bytes.
    pub const MOST: usize = 15;
    /// A message without bytes.
    pub const EMPTY: LineBytes = LineBytes { epoch: 0, damaged: 0, len: 0, bytes: [0; LineBytes::MOST] };

    /// Returns the number of bytes in the message.
    #[inline]
    pub fn len(&self) -> usize {
        self.len.into()
    }

    /// Returns whether the message contains no bytes.
    #[inline]
    pub fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Appends a byte. Returns `false` if there is no room or the byte is of another epoch.
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

    /// Appends undamaged bytes as far as there is room. Bytes of another epoch are not appended. Returns how many were
    /// appended.
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

    /// Returns the epoch, and the bytes from index `from` on; no bytes if any byte of the message is damaged.
    #[inline]
    pub fn undamaged(&self, from: usize) -> (u16, &[u8]) {
        let bytes = if self.damaged == 0 { self.bytes.get(from..self.len()) } else { None };
        (self.epoch, bytes.unwrap_or_default())
    }

    /// Returns the byte at index `place`; `None` if the message has fewer bytes.
    #[inline]
    pub fn get(&self, place: usize) -> Option<LineByte> {
        let byte = *self.bytes.get(place).filter(|_| place < self.len())?;
        Some(LineByte { byte, epoch: self.epoch, damaged: self.damaged >> place & 1 != 0 })
    }
}

/// A piece of the text sent to the host.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Chunk {
    /// Number of valid bytes, 1..=15.
    pub len: u8,
    /// The text: the first `len` bytes are valid.
    pub bytes: [u8; 15],
}

impl Chunk {
    /// Returns the valid bytes.
    pub fn as_bytes(&self) -> &[u8] {
        self.bytes.get(..usize::from(self.len)).unwrap_or(&[])
    }
}
