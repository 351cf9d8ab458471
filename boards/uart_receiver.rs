//! What a UART receives, on its way to the serial task. DMA or the interrupt of the UART puts bytes into a buffer. The task that samples
//! the inputs reads them with each sample and sends them on in messages: a command which stops the machine within 50 us, all else
//! within 200 us. The serial task is called for them once in 500 us (`calls`), and takes what has been sent whenever it runs. A look reads
//! few bytes, so that a sample is short; only behind an overrun it empties the whole buffer.
//!
//! ```text
//!  UART ──▶ DMA or interrupt ──▶ buffer ──look──▶ messages ──▶ serial task
//! ```
//! Bytes leave in the order in which they came. Where bytes are missing, the message behind them says so. Where some of several bytes
//! are damaged and it is not known which, no line that has one of them is carried out.
//!
//! The buffer has one reader. A slot that has been read is `EMPTY` again: so an overrun is seen however long nobody has looked,
//! half a second of an erase of flash included.
//!
//! No registers: a [`ByteSource`] has those of the chip, so that all of this runs on a desk as well.

use crate::calls::{RESET, is_stop};
use core::sync::atomic::{AtomicU16, Ordering, Ordering::Relaxed, fence};

/// Slots of the buffer: the 255 bytes that a sender with flow control has under way, 64 realtime commands beside them, and the one that
/// stays free.
pub const SLOTS: usize = 320;
/// Slots that only a command which stops the machine may take, where the interrupt fills the buffer.
const FOR_STOPS: usize = 16;
/// Bytes that wait in a circular buffer while the messages have no room, at most. Beyond them the oldest are lost, a few with each look:
/// so DMA does not come round while somebody looks.
pub const MOST_WAITING: usize = SLOTS - 64;
/// What the UART puts its bytes into: nine bits of its data register, or `EMPTY`, and the mark of a loss. Atomic, as DMA writes it.
pub type Buffer = [AtomicU16; SLOTS];

/// No byte has come, or it has been read.
const EMPTY: u16 = 0x8000;
/// Bytes are missing before this one.
const MISSING: u16 = 0x4000;

/// Bytes of text that may wait for the end of their line without a call.
const GATHERED: u8 = 32;
/// Looks after which what has come is passed on.
const WAITED: u8 = 4;
/// Bytes of text that a look by DMA reads at most, and half as many of others. At 1 Mbaud five come between two samples.
const AT_A_TIME: u8 = 28;
/// In place of a damaged byte, and behind damaged ones, as the last of them may have become the end of a line: no line is carried out
/// that has one.
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
    fn clear(&mut self) {
        (self.is_behind_loss, self.len) = (false, 0);
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

/// The reader of the buffer. Sends are made by the caller's `send`, which says whether there was room.
pub struct UartReceiver<S> {
    source: S,
    buffer: &'static Buffer,
    /// The next slot to be read.
    read: usize,
    /// The message that is being filled, and looks since its first byte.
    message: ReceivedBytes,
    looks: u8,
    /// The last byte that was read.
    before: u8,
    /// Bytes of text since a call.
    text: u8,
    /// The last byte that was passed on since a call.
    unheard: Option<u8>,
    /// Bytes are missing before the next one.
    is_missing: bool,
    /// The bytes before the next one are damaged.
    is_torn: bool,
    /// Those that come up to the next look may be damaged.
    is_doubtful: bool,
    /// A command that stops the machine has been read and not been passed on with a call.
    has_stop: bool,
    /// More is in the buffer than could be read. None of the first `scanned` bytes of it stops the machine; whether the next one does.
    is_stuck: bool,
    scanned: usize,
    has_stop_ahead: bool,
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
            read: 0,
            message: ReceivedBytes::EMPTY,
            looks: 0,
            before: 0,
            text: 0,
            unheard: None,
            is_missing: false,
            is_torn: false,
            is_doubtful: false,
            has_stop: false,
            is_stuck: false,
            scanned: 0,
            has_stop_ahead: false,
        }
    }

    /// What fills the buffer.
    #[inline(always)]
    pub fn source(&mut self) -> &mut S {
        &mut self.source
    }

    /// Whether a command that stops the machine has come and not been passed on with a call.
    #[inline(always)]
    pub fn has_stop(&self) -> bool {
        self.has_stop || self.has_stop_ahead
    }

    const fn after(at: usize) -> usize {
        if S::IS_CIRCULAR && at + 1 == SLOTS { 0 } else { at + 1 }
    }

    /// Reads what has come since the look before, and sends what fills a message.
    #[inline(always)]
    pub fn look(&mut self, send: impl FnMut(ReceivedBytes) -> bool) -> Look {
        let place = self.source.place();
        // In this order: a damaged byte is told of before it is counted, so none is among those before the place if nothing is told.
        fence(Ordering::SeqCst);
        let is_damaged = self.source.is_damaged();
        if self.read != place || is_damaged || self.is_doubtful || self.is_at_end(place) {
            self.read_up_to(place, is_damaged, send);
        }
        self.looks = if self.message.len == 0 { 0 } else { self.looks.saturating_add(1) };
        Look { stop: self.has_stop(), news: self.is_stuck || self.text >= GATHERED, waits: self.looks >= WAITED }
    }

    /// The slot of the next byte has not been read.
    #[inline(always)]
    fn is_at_end(&self, place: usize) -> bool {
        S::IS_CIRCULAR && self.buffer.get(place).is_some_and(|slot| slot.load(Relaxed) != EMPTY)
    }

    #[inline(never)]
    fn read_up_to(&mut self, place: usize, is_damaged: bool, mut send: impl FnMut(ReceivedBytes) -> bool) {
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
        self.is_stuck = false;
        // Without DMA bytes come slowly, and a long look would keep the next one from being fetched.
        let (mut read, mut left) = (0, if S::IS_CIRCULAR { AT_A_TIME } else { AT_A_TIME / 4 });
        while self.read != place {
            let Some(slot) = self.buffer.get(self.read) else { break };
            let word = slot.load(Relaxed);
            if is_line_byte(word) && !(is_bad || self.is_missing || self.is_torn) {
                let count = self.read_text(place, left);
                read += usize::from(count);
                left -= count;
                if count > 0 {
                    continue;
                }
            }
            // A byte may have been counted and not be written yet.
            let is_read = word != EMPTY && left > 0 && self.append(word, is_bad, &mut send);
            if !is_read {
                if word == EMPTY && self.is_overtaken(place) {
                    self.lose_all();
                    return;
                }
                self.leave_behind(read);
                self.is_stuck = word != EMPTY;
                self.is_doubtful |= is_bad;
                if self.is_stuck {
                    self.scan(place);
                    if left > 0 {
                        self.lose_oldest(place);
                    }
                }
                return;
            }
            slot.store(EMPTY, Relaxed);
            read += 1;
            // What is no text takes longer.
            left = left.saturating_sub(if is_line_byte(word) { 1 } else { 2 });
            self.read = Self::after(self.read);
        }
        (self.scanned, self.has_stop_ahead) = (0, false);
        if !S::IS_CIRCULAR && self.read == self.source.place() && self.source.begin_anew() {
            self.read = 0;
        }
    }

    /// Reads text and ends of lines for which the message has room, up to the last slot. Gives how many bytes, at most `most`.
    #[inline(always)]
    fn read_text(&mut self, place: usize, most: u8) -> u8 {
        let end = if self.read <= place { place } else { SLOTS };
        let slots = self.buffer.get(self.read..end).unwrap_or_default();
        let room = self.message.bytes.get_mut(self.message.len.into()..).unwrap_or_default();
        let (mut count, mut has_end) = (0, false);
        for (slot, byte) in slots.iter().zip(room).take(most.into()) {
            let word = slot.load(Relaxed);
            if !is_line_byte(word) {
                break;
            }
            has_end |= word == b'\n'.into();
            slot.store(EMPTY, Relaxed);
            *byte = word as u8;
            count += 1;
        }
        if count > 0 {
            self.message.len += count;
            self.text = if has_end { GATHERED } else { self.text.saturating_add(count) };
            self.before = 0;
            self.read = Self::after(self.read + usize::from(count) - 1);
        }
        count
    }

    /// Puts a byte into the message, behind what tells that it is missing something or damaged. Whether there was room.
    #[inline(always)]
    fn append(&mut self, word: u16, is_bad: bool, send: &mut impl FnMut(ReceivedBytes) -> bool) -> bool {
        let byte = if is_bad { refused(word as u8) } else { word as u8 };
        let is_missing = self.is_missing || word & MISSING != 0;
        let is_torn = self.is_torn && !is_bad;
        let len = usize::from(self.message.len);
        if (is_missing && len > 0 || len + usize::from(is_torn) >= ReceivedBytes::MOST) && !self.send_message(send) {
            return false;
        }
        self.is_missing = false;
        self.message.is_behind_loss |= is_missing;
        if is_torn {
            self.message.push(REFUSED);
        }
        self.is_torn = is_bad;
        if is_text(byte) {
            self.message.push(byte);
            self.text = self.text.saturating_add(1);
        } else {
            self.append_command(byte);
        }
        self.before = byte;
        true
    }

    /// A byte that is no text. A report, a hold or a reset that is asked for twice before anybody has heard it says the same; other bytes
    /// that come twice may be one character.
    #[inline(always)]
    fn append_command(&mut self, byte: u8) {
        let last = self.message.from(0).last().copied().or(self.unheard);
        let may_repeat = matches!(byte, b'?' | b'!' | RESET | 0x19);
        let repeats = may_repeat && last == Some(byte) && !self.message.is_behind_loss;
        if !repeats {
            self.message.push(byte);
        }
        self.text = GATHERED;
        self.has_stop |= is_stop(byte) && byte != self.before;
    }

    fn send_message(&mut self, send: &mut impl FnMut(ReceivedBytes) -> bool) -> bool {
        let is_sent = send(self.message);
        if is_sent {
            self.unheard = self.message.from(0).last().copied();
            self.message.clear();
        }
        is_sent
    }

    /// Looks for the first command that stops the machine among the bytes that could not be read, a few with each look: the serial task
    /// makes room for it.
    #[cold]
    #[inline(never)]
    fn scan(&mut self, place: usize) {
        let (mut at, mut left) = (self.read + self.scanned, AT_A_TIME);
        if at >= SLOTS && S::IS_CIRCULAR {
            at -= SLOTS;
        }
        while !self.has_stop_ahead && at != place && left > 0 {
            let Some(slot) = self.buffer.get(at) else { return };
            let word = slot.load(Relaxed);
            if word == EMPTY {
                // Counted, and not written yet.
                return;
            }
            self.has_stop_ahead = is_stop(word as u8);
            self.scanned += usize::from(!self.has_stop_ahead);
            left -= 1;
            at = Self::after(at);
        }
    }

    /// There is no room for what comes next: if too much waits, the oldest bytes are lost, none of which stops the machine.
    #[cold]
    #[inline(never)]
    fn lose_oldest(&mut self, place: usize) {
        let waiting = if self.read <= place { place - self.read } else { place + SLOTS - self.read };
        let lost = if S::IS_CIRCULAR {
            waiting.saturating_sub(MOST_WAITING).min(AT_A_TIME.into()).min(self.scanned)
        } else {
            0
        };
        for _ in 0..lost {
            let Some(slot) = self.buffer.get(self.read) else { return };
            slot.store(EMPTY, Relaxed);
            self.read = Self::after(self.read);
        }
        if lost > 0 {
            self.scanned -= lost;
            self.is_missing = true;
            self.before = 0;
        }
    }

    /// Bytes have been read that may have been scanned before.
    #[inline(always)]
    fn leave_behind(&mut self, count: usize) {
        self.has_stop_ahead &= count <= self.scanned;
        self.scanned = self.scanned.saturating_sub(count);
    }

    /// The next slot is empty, and it is not that of the last byte, which may be counted and not be written yet: DMA came round while a look
    /// read, and what it wrote there was taken for the oldest byte.
    #[cold]
    #[inline(never)]
    fn is_overtaken(&self, place: usize) -> bool {
        if !S::IS_CIRCULAR || Self::after(self.read) == place {
            return false;
        }
        self.source.settle();
        self.buffer.get(self.read).is_some_and(|slot| slot.load(Relaxed) == EMPTY)
    }

    /// No slot is free, and that is not because the last byte is about to be counted.
    #[cold]
    #[inline(never)]
    fn is_full(&self, place: usize) -> bool {
        self.source.settle();
        loop {
            let now = self.source.place();
            let is_full = now == place || self.is_at_end(now);
            // A byte that has just come is in that slot, too.
            if self.source.place() == now {
                return is_full;
            }
        }
    }

    /// Bytes have been overwritten, it is not known which: all are lost but what stops the machine most.
    #[cold]
    #[inline(never)]
    fn lose_all(&mut self) {
        let mut stop =
            self.message.from(0).iter().copied().max_by_key(|byte| weight(*byte)).filter(|byte| is_stop(*byte));
        let (mut at, mut emptied) = (self.source.place(), 0);
        // Once round, the oldest first, and then what came meanwhile: no slot that has been written is left behind.
        while let Some(slot) = self.buffer.get(at).filter(|_| emptied < SLOTS || at != self.source.place()) {
            let word = slot.load(Relaxed);
            if word != EMPTY && weight(word as u8) > stop.map_or(0, weight) {
                stop = Some(word as u8);
            }
            slot.store(EMPTY, Relaxed);
            emptied += 1;
            at = Self::after(at);
        }
        self.read = at;
        (self.scanned, self.has_stop_ahead) = (0, false);
        self.message.clear();
        if let Some(stop) = stop {
            self.message.is_behind_loss = true;
            self.message.push(stop);
            self.has_stop = true;
        }
        self.is_missing = true;
        self.is_stuck = false;
        self.text = GATHERED;
        self.before = 0;
    }

    /// Sends what has been read. `calls`: the serial task is called right behind it.
    #[inline(never)]
    pub fn pass_on(&mut self, calls: bool, mut send: impl FnMut(ReceivedBytes) -> bool) {
        if self.message.len > 0 && !self.send_message(&mut send) {
            self.looks = WAITED;
            return;
        }
        self.looks = 0;
        if calls {
            (self.text, self.unheard, self.has_stop) = (0, None, false);
        }
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

/// Which of several commands that stop the machine is kept where only one can be: reset, stop, door, hold, end of a jog. 0: none of them.
fn weight(byte: u8) -> u8 {
    match byte {
        RESET => 5,
        0x19 => 4,
        0x84 => 3,
        b'!' => 2,
        0x85 => 1,
        _ => 0,
    }
}

/// What is left of a byte where one of several is damaged: what stops the machine does so, and no line but an empty one is carried out
/// that has one of them.
fn refused(byte: u8) -> u8 {
    if is_stop(byte) || matches!(byte, b'\n' | b'\r') { byte } else { REFUSED }
}

/// Whether a slot has text or an end of a line, and no mark.
#[inline(always)]
fn is_line_byte(word: u16) -> bool {
    word <= 0xFF && (is_text(word as u8) || word as u8 == b'\n')
}

/// Whether a byte is text of a line, with which the serial task has nothing to do before the end of the line.
#[inline(always)]
fn is_text(byte: u8) -> bool {
    (b' '..=b'}').contains(&byte) && !matches!(byte, b'!' | b'?')
}
