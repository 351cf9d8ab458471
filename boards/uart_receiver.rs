//! What a UART receives, on its way to the serial task: the bytes lie in a buffer that DMA fills, or the interrupt of the UART, until
//! the task that samples the inputs passes them on in messages. It looks at the buffer with each sample: a command which stops the
//! machine is passed on within 50 us, all else within 200 us; the serial task is called for it once in 800 us (`calls`), and takes
//! what has been passed on whenever it runs. A sample passes few bytes on, so that it is short whatever comes.
//!
//! ```text
//!  UART ──▶ DMA or interrupt ──▶ buffer ──look, pass_on──▶ messages ──▶ serial task
//! ```
//! Bytes leave in the order in which they came. Where bytes are missing, the message behind them says so. Where some of several bytes
//! are damaged and it is not known which, no line that has one of them is carried out.
//!
//! The buffer has one reader. A slot that has been read is `EMPTY` again: so an overrun is seen however long nobody has looked,
//! half a second of an erase of flash included.
//!
//! No registers: a [`ByteSource`] has those of the chip, so that all of this runs on a desk as well.

use crate::calls::is_stop;
use core::sync::atomic::{AtomicU16, Ordering, Ordering::Relaxed, fence};

/// Slots of the buffer: the 255 bytes that a sender with flow control has under way, 64 realtime commands beside them, and the one that
/// stays free.
pub const SLOTS: usize = 320;
/// Slots that only a command which stops the machine may take, where the interrupt fills the buffer.
const FOR_STOPS: usize = 16;
/// What the UART puts its bytes into: nine bits of its data register, or [`EMPTY`], and marks. Atomic, as DMA writes it.
pub type Buffer = [AtomicU16; SLOTS];

/// No byte has come, or it has been read.
const EMPTY: u16 = 0x8000;
/// Bytes are missing before this one.
const MISSING: u16 = 0x4000;
/// The bytes before this one are damaged: `REFUSED` goes in front, as one of them may have become the end of a line.
const TORN: u16 = 0x2000;

/// Bytes of text that may wait for the end of their line without a call.
const GATHERED: u8 = 32;
/// Looks after which what has come is passed on.
const WAITED: u8 = 4;
/// Bytes that are passed on at a time: five times as many as come between two samples at 1 Mbaud.
const AT_A_TIME: u8 = 28;
/// In place of a damaged byte: no line is carried out that has one.
const REFUSED: u8 = b'@';

/// What puts bytes into the buffer.
pub trait ByteSource {
    /// The buffer goes round; otherwise it is begun anew whenever it is empty ([`ByteSource::begin_anew`]).
    const IS_CIRCULAR: bool;

    /// The slot of the next byte, [`SLOTS`] if there is none.
    fn place(&self) -> usize;
    /// Whether a byte has been damaged since [`ByteSource::clear_damage`].
    fn is_damaged(&self) -> bool;
    /// Forgets it. A byte that comes at this moment may be lost.
    fn clear_damage(&mut self);
    /// Waits for as long as it takes to write a byte and to count it.
    fn settle(&self) {}
    /// All has been read of a buffer that does not go round: the next byte goes into the first slot. Whether it does.
    fn begin_anew(&mut self) -> bool {
        false
    }
}

/// A message to the serial task: bytes that came one behind the other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(align(4))]
pub struct ReceivedBytes {
    /// Bytes are missing before these.
    pub is_behind_loss: bool,
    len: u8,
    bytes: [u8; ReceivedBytes::MOST],
}

impl ReceivedBytes {
    /// How many bytes fit.
    pub const MOST: usize = 14;
    /// None.
    pub const EMPTY: Self = ReceivedBytes { is_behind_loss: false, len: 0, bytes: [0; Self::MOST] };

    /// Those from a place on.
    #[inline]
    pub fn from(&self, place: usize) -> &[u8] {
        self.bytes.get(place..usize::from(self.len)).unwrap_or_default()
    }

    #[inline]
    fn push(&mut self, byte: u8) {
        if let Some(slot) = self.bytes.get_mut(usize::from(self.len)) {
            *slot = byte;
            self.len += 1;
        }
    }
}

/// What a look has found.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Look {
    /// There is a command that stops the machine: the serial task is to be called at once.
    pub stop: bool,
    /// There is something for the serial task to do: it is to be called soon.
    pub news: bool,
    /// Something has waited long enough to be passed on, with or without a call.
    pub waits: bool,
}

/// The reader of the buffer.
pub struct UartReceiver<S> {
    source: S,
    buffer: &'static Buffer,
    /// The next slot to look at, and the next to be read: what lies between them waits.
    seen: usize,
    read: usize,
    /// The last byte that was looked at.
    before: u8,
    /// Bytes of text since a call, and looks since what waits was passed on.
    text: u8,
    looks: u8,
    /// The last byte that was passed on since a call.
    unheard: Option<u8>,
    /// Bytes are missing before the next one.
    is_missing: bool,
    /// The bytes before the next one are damaged.
    is_torn: bool,
    /// Those that come up to the next look may be damaged.
    is_doubtful: bool,
    /// A command that stops the machine waits.
    has_stop: bool,
    /// Not all could be passed on.
    is_stuck: bool,
    message: ReceivedBytes,
}

impl<S: ByteSource> UartReceiver<S> {
    /// Of a buffer that nobody else reads, and into which nothing is put yet.
    pub fn new(source: S, buffer: &'static Buffer) -> Self {
        for slot in buffer {
            slot.store(EMPTY, Relaxed);
        }
        UartReceiver {
            source,
            buffer,
            seen: 0,
            read: 0,
            before: 0,
            text: 0,
            looks: 0,
            unheard: None,
            is_missing: false,
            is_torn: false,
            is_doubtful: false,
            has_stop: false,
            is_stuck: false,
            message: ReceivedBytes::EMPTY,
        }
    }

    /// What fills the buffer.
    #[inline(always)]
    pub fn source(&mut self) -> &mut S {
        &mut self.source
    }

    /// Whether a command that stops the machine waits.
    #[inline(always)]
    pub fn has_stop(&self) -> bool {
        self.has_stop
    }

    const fn after(at: usize) -> usize {
        if S::IS_CIRCULAR && at + 1 == SLOTS { 0 } else { at + 1 }
    }

    /// Looks at what has come since the look before.
    #[inline(always)]
    pub fn look(&mut self) -> Look {
        let place = self.source.place();
        // In this order: a damaged byte is told of before it is counted, so none is among those before the place if nothing is told.
        fence(Ordering::SeqCst);
        let is_damaged = self.source.is_damaged();
        if self.seen != place || is_damaged || self.is_doubtful || self.is_at_end(place) {
            self.look_at(place, is_damaged);
        }
        self.looks = if self.read == self.seen { 0 } else { self.looks.saturating_add(1) };
        let waits = self.is_stuck || self.looks >= WAITED;
        Look { stop: self.has_stop, news: self.is_stuck || self.text >= GATHERED, waits }
    }

    /// The slot of the next byte has not been read.
    #[inline(always)]
    fn is_at_end(&self, place: usize) -> bool {
        S::IS_CIRCULAR && self.buffer.get(place).is_some_and(|slot| slot.load(Relaxed) != EMPTY)
    }

    #[inline(never)]
    fn look_at(&mut self, place: usize, is_damaged: bool) {
        if self.is_at_end(place) && self.is_full(place) {
            self.lose_all();
            return;
        }
        if is_damaged {
            self.source.clear_damage();
            self.is_missing = true;
        }
        let is_bad = is_damaged || self.is_doubtful;
        self.is_doubtful = is_damaged;
        while self.seen != place {
            let Some(slot) = self.buffer.get(self.seen) else { break };
            let word = slot.load(Relaxed);
            if word == EMPTY {
                // Counted, and not written yet.
                self.is_doubtful |= is_bad;
                break;
            }
            self.see(slot, word, is_bad);
            self.seen = Self::after(self.seen);
        }
    }

    /// Looks at a byte, and marks it if it is missing something or damaged.
    #[inline(always)]
    fn see(&mut self, slot: &AtomicU16, word: u16, is_bad: bool) {
        let mut byte = word as u8;
        let mut marks = word & MISSING;
        if is_bad || self.is_torn || self.is_missing {
            if core::mem::take(&mut self.is_missing) {
                marks |= MISSING;
            }
            if is_bad {
                byte = refused(byte);
            } else if self.is_torn {
                marks |= TORN;
            }
            self.is_torn = is_bad;
        }
        slot.store(u16::from(byte) | marks, Relaxed);
        if is_text(byte) {
            self.text = self.text.saturating_add(1);
        } else {
            self.text = GATHERED;
            self.has_stop |= is_stop(byte) && byte != self.before;
        }
        self.before = byte;
    }

    /// No slot is free, and that is not because the last byte is about to be counted.
    #[cold]
    #[inline(never)]
    fn is_full(&self, place: usize) -> bool {
        self.source.settle();
        place == self.source.place()
    }

    /// Bytes have been overwritten, it is not known which: all are lost but what stops the machine last.
    #[cold]
    #[inline(never)]
    fn lose_all(&mut self) {
        let mut stop = self.message.from(0).iter().copied().rfind(|byte| is_stop(*byte));
        let (mut at, mut emptied) = (self.source.place(), 0);
        // Once round, the oldest first, and then what came meanwhile: no slot that has been written is left behind.
        while let Some(slot) = self.buffer.get(at).filter(|_| emptied < SLOTS || at != self.source.place()) {
            let word = slot.load(Relaxed);
            if word != EMPTY && is_stop(word as u8) {
                stop = Some(word as u8);
            }
            slot.store(EMPTY, Relaxed);
            emptied += 1;
            at = Self::after(at);
        }
        (self.seen, self.read) = (at, at);
        self.message = ReceivedBytes::EMPTY;
        if let Some(stop) = stop {
            self.message.is_behind_loss = true;
            self.message.push(stop);
            self.has_stop = true;
        }
        self.is_missing = true;
        self.text = GATHERED;
        self.before = 0;
    }

    /// Sends what waits in messages, as far as there is room for them and not for too long. `calls`: the serial task is called right
    /// behind it.
    #[inline(never)]
    pub fn pass_on(&mut self, calls: bool, mut send: impl FnMut(ReceivedBytes) -> bool) {
        self.looks = 0;
        self.is_stuck = true;
        let mut left = AT_A_TIME;
        while self.fill(&mut left) {
            if !send(self.message) {
                return;
            }
            self.unheard = self.message.from(0).last().copied();
            self.message = ReceivedBytes::EMPTY;
        }
        if calls {
            (self.text, self.unheard) = (0, None);
        }
        if self.read != self.seen {
            return;
        }
        self.is_stuck = false;
        self.has_stop &= !calls;
        if !S::IS_CIRCULAR && self.read == self.source.place() && self.source.begin_anew() {
            (self.seen, self.read) = (0, 0);
        }
    }

    /// Puts what waits into the message, as far as it fits and so many bytes are left. Whether there is anything in it.
    #[inline(always)]
    fn fill(&mut self, left: &mut u8) -> bool {
        while self.read != self.seen && *left > 0 {
            let Some(slot) = self.buffer.get(self.read) else { break };
            let word = slot.load(Relaxed);
            let (is_missing, is_torn) = (word & MISSING != 0, word & TORN != 0);
            let len = usize::from(self.message.len);
            if is_missing && len > 0 || len + usize::from(is_torn) >= ReceivedBytes::MOST {
                break;
            }
            slot.store(EMPTY, Relaxed);
            *left -= 1;
            self.read = Self::after(self.read);
            self.message.is_behind_loss |= is_missing;
            if is_torn {
                self.message.push(REFUSED);
            }
            let byte = word as u8;
            // What is said twice before anybody has heard it says the same.
            let last = self.message.from(0).last().copied().or(self.unheard);
            let repeats = (byte == b'?' || is_stop(byte)) && last == Some(byte) && !self.message.is_behind_loss;
            if !repeats {
                self.message.push(byte);
            }
        }
        self.message.len > 0
    }

    /// For an interrupt that fills the buffer: a byte goes into the slot at `place`, behind a loss or not. Whether there was room.
    #[inline(always)]
    pub fn put(&mut self, byte: u8, place: usize, is_behind_loss: bool) -> bool {
        let room = if is_stop(byte) { SLOTS } else { SLOTS - FOR_STOPS };
        let slot = self.buffer.get(place).filter(|_| place < room);
        if let Some(slot) = slot {
            slot.store(u16::from(byte) | if is_behind_loss { MISSING } else { 0 }, Relaxed);
        }
        slot.is_some()
    }
}

/// What is left of a byte where one of several is damaged: what stops the machine does so, and no line but an empty one is carried out
/// that has one of them.
fn refused(byte: u8) -> u8 {
    if is_stop(byte) || matches!(byte, b'\n' | b'\r') { byte } else { REFUSED }
}

/// Whether a byte is text of a line, with which the serial task has nothing to do before the end of the line.
#[inline(always)]
fn is_text(byte: u8) -> bool {
    (b' '..=b'}').contains(&byte) && !matches!(byte, b'!' | b'?')
}
