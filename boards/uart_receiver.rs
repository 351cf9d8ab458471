//! Carries received UART bytes to the serial task. DMA or the UART's interrupt writes them into a buffer. The task
//! that samples the inputs reads the buffer at each sample (a "look") and forwards the bytes in messages. To keep the
//! sample short, a look reads only a few bytes. Only after an overrun does a look empty the whole buffer.
//!
//! A command that stops the machine is forwarded after at most 50 us, any other byte after at most 200 us. For bytes
//! without such a command, the sampling task calls the serial task at most once per 500 us (`calls`). Whenever the
//! serial task runs, it takes all messages sent so far.
//!
//! Bytes keep their order. If bytes are missing, the next message is marked (`is_behind_loss`). The hardware can
//! report damage without telling which bytes are damaged. Then no line that contains one of the doubtful bytes is
//! executed.
//!
//! The buffer has one reader, which sets each slot to `EMPTY` after reading it. If the writer reaches a slot that is
//! not `EMPTY`, this is an overrun. The reader detects it even after the half second of a flash erase, in which nobody
//! reads the buffer.
//!
//! Only a [`ByteSource`] accesses registers, so that host tests can run this code.

use crate::calls::{RESET, is_stop};
use core::sync::atomic::{AtomicU16, Ordering, Ordering::Relaxed, fence};

/// Slots of the buffer: 255 for bytes that a sender with flow control may have sent ahead, 64 for realtime commands,
/// and one that stays free.
pub const SLOTS: usize = 320;
/// Slots reserved for commands that stop the machine, in a buffer that an interrupt fills instead of DMA.
const FOR_STOPS: usize = 16;
/// Maximum number of bytes kept in a circular buffer while no message can be sent. If more bytes wait, each look
/// (reading of the buffer) drops a few of the oldest, so that DMA does not overtake the reader meanwhile.
pub const MOST_WAITING: usize = SLOTS - 64;
/// The buffer that the UART's bytes are written into. A slot holds either `EMPTY`, or nine bits of the data register,
/// to which an interrupt can add the flag `MISSING`. Slots are atomic, because DMA writes them.
pub type Buffer = [AtomicU16; SLOTS];

/// Slot value: no byte has arrived, or it has been read.
const EMPTY: u16 = 0x8000;
/// Slot flag: bytes are missing before this one.
const MISSING: u16 = 0x4000;

/// When this many bytes of text have arrived, the serial task is called even if the end of the line has not arrived.
const GATHERED: u8 = 32;
/// Number of looks (one per sample) after which a message is passed on although it is not full: 200 us.
const WAITED: u8 = 4;
/// Maximum number of bytes of text that one look (reading of the buffer) reads from a buffer filled by DMA; other bytes
/// count double. At 1 Mbaud five bytes arrive between two samples.
const AT_A_TIME: u8 = 28;
/// The byte that replaces a damaged byte (see [`refused`]). A line that contains it is not executed. It is also
/// inserted once after a series of damaged bytes. The reason: an end of line in the series may have been another byte
/// before the damage, and then the bytes after the series still belong to the damaged line.
const REFUSED: u8 = b'@';

/// The part of a UART that writes bytes into the buffer.
pub trait ByteSource {
    /// `true`: the writer continues at the first slot after the last one. `false`: the writer stops at the last slot,
    /// and the reader restarts the buffer when it is empty ([`ByteSource::begin_anew`]).
    const IS_CIRCULAR: bool;

    /// Returns the index of the slot that the next byte will be written into, or [`SLOTS`] if the buffer is used up.
    fn place(&self) -> usize;
    /// Returns whether a byte has been damaged since the last call of [`ByteSource::clear_damage`].
    fn is_damaged(&self) -> bool;
    /// Clears the report of [`ByteSource::is_damaged`]. A byte that arrives at this moment may be lost.
    fn clear_damage(&mut self);
    /// Waits as long as the hardware takes, after a byte is received, to write it into the buffer and to advance
    /// [`ByteSource::place`].
    fn settle(&self) {}
    /// Restarts a non-circular buffer that has been read completely. Returns whether the next byte will go into the
    /// first slot.
    fn begin_anew(&mut self) -> bool {
        false
    }
}

/// A message to the serial task: consecutive received bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(align(4))]
pub struct ReceivedBytes {
    /// Bytes were lost before the bytes of this message.
    pub is_behind_loss: bool,
    len: u8,
    bytes: [u8; ReceivedBytes::MOST],
}

impl ReceivedBytes {
    /// Maximum number of bytes in a message. With its length and mark, a message then fills 16 bytes.
    pub const MOST: usize = 14;
    /// A message without bytes and without the mark of a loss.
    pub const EMPTY: Self = ReceivedBytes { is_behind_loss: false, len: 0, bytes: [0; Self::MOST] };

    /// Returns the bytes of the message from index `place` on; an empty slice if there are none.
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

/// Result of [`UartReceiver::look`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Look {
    /// A command that stops the machine has arrived: call the serial task at once.
    pub stop: bool,
    /// The serial task has work: call it soon.
    pub news: bool,
    /// The message being filled has waited long enough: pass it on, with or without a call of the serial task.
    pub waits: bool,
}

/// The reader of the buffer. It sends messages through a function `send` of the caller, which returns whether the queue
/// had space for the message.
pub struct UartReceiver<S> {
    source: S,
    buffer: &'static Buffer,
    /// The next slot to be read.
    read: usize,
    /// The message being filled.
    message: ReceivedBytes,
    /// Number of looks since the first byte of `message`; 0 while `message` is empty.
    looks: u8,
    /// The byte read most recently; 0 if [`UartReceiver::read_text`] has read it, or if bytes have been lost since. If
    /// several equal stop commands arrive in a row, only the first calls the serial task at once; `before` shows which
    /// are repeated.
    before: u8,
    /// Number of bytes of text read since the last call of the serial task. The task is called when this number
    /// reaches [`GATHERED`]. An end of line, a command or an overrun sets the number to [`GATHERED`].
    text: u8,
    /// Last byte of the message sent most recently, which the serial task may not have processed yet. `None` after a
    /// call of the serial task.
    unheard: Option<u8>,
    /// Bytes were lost before the next byte to be read.
    is_missing: bool,
    /// The byte read most recently may be damaged. Before the next good byte, [`REFUSED`] is inserted.
    is_torn: bool,
    /// The most recent look has found damage. The bytes of the next look may be damaged as well.
    is_doubtful: bool,
    /// A command that stops the machine has been read, and the serial task has not been called for it yet.
    has_stop: bool,
    /// The most recent look left bytes in the buffer, because it reached its limit or no message could be sent.
    is_stuck: bool,
    /// How many of the oldest unread bytes [`UartReceiver::scan`] has checked. None of these bytes stops the machine.
    scanned: usize,
    /// The byte after the `scanned` ones is a command that stops the machine.
    has_stop_ahead: bool,
}

impl<S: ByteSource> UartReceiver<S> {
    /// Creates the reader of `buffer`, which must have no other reader and no writer yet.
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

    /// Returns the source that fills the buffer, so that the UART's interrupt can update its state.
    #[inline(always)]
    pub fn source(&mut self) -> &mut S {
        &mut self.source
    }

    /// Returns whether a command that stops the machine has arrived for which the serial task has not been called yet.
    #[inline(always)]
    pub fn has_stop(&self) -> bool {
        self.has_stop || self.has_stop_ahead
    }

    const fn after(at: usize) -> usize {
        if S::IS_CIRCULAR && at + 1 == SLOTS { 0 } else { at + 1 }
    }

    /// Reads the bytes that have arrived since the last look, and sends each message that is full.
    #[inline(always)]
    pub fn look(&mut self, send: impl FnMut(ReceivedBytes) -> bool) -> Look {
        let place = self.source.place();
        // Read `place`, the position of the writer, before the damage flag: the hardware reports the damage of a byte
        // before it counts the byte. So if no damage is reported, no byte before `place` is damaged.
        fence(Ordering::SeqCst);
        let is_damaged = self.source.is_damaged();
        if self.read != place || is_damaged || self.is_doubtful || self.is_at_end(place) {
            self.read_up_to(place, is_damaged, send);
        }
        self.looks = if self.message.len == 0 { 0 } else { self.looks.saturating_add(1) };
        Look { stop: self.has_stop(), news: self.is_stuck || self.text >= GATHERED, waits: self.looks >= WAITED }
    }

    /// Returns whether the next byte would overwrite an unread byte, as in a full buffer.
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
        // Without DMA, a look reads fewer bytes. They arrive slowly, and a long look would delay the interrupt that
        // fetches the next byte from the UART.
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
            // An empty slot is not read: DMA may have counted a byte that it has not written yet.
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
            // Bytes other than text count double, because it takes longer to process them.
            left = left.saturating_sub(if is_line_byte(word) { 1 } else { 2 });
            self.read = Self::after(self.read);
        }
        (self.scanned, self.has_stop_ahead) = (0, false);
        if !S::IS_CIRCULAR && self.read == self.source.place() && self.source.begin_anew() {
            self.read = 0;
        }
    }

    /// Reads up to `most` bytes of text and ends of lines into the free space of the message. Stops at the last slot
    /// instead of wrapping around. Returns how many bytes it has read.
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

    /// Appends a byte to the message. If bytes before it were lost, marks the message; if they were damaged, inserts
    /// [`REFUSED`]. Sends the message first if it is full, or if a loss must be marked at the start of a new one.
    /// Returns `false` if the message could not be sent.
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

    /// Appends a byte that is not text. Drops a repeated `?`, hold, reset or stop: the byte before it is the same, and
    /// the serial task may not have processed that byte yet. Keeps other repeated bytes, because they may be parts of
    /// one UTF-8 character.
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

    /// Checks the bytes that had to stay in the buffer, a few at each call, until it finds a command that stops the
    /// machine. If there is such a command, the serial task is called. The serial task then takes messages from the
    /// queue, which makes space for the command.
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
                // DMA has counted the byte, but not written it yet.
                return;
            }
            self.has_stop_ahead = is_stop(word as u8);
            self.scanned += usize::from(!self.has_stop_ahead);
            left -= 1;
            at = Self::after(at);
        }
    }

    /// Drops a few of the oldest bytes if no message can be sent and more than [`MOST_WAITING`] bytes wait in a
    /// circular buffer. Never drops a command that stops the machine.
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

    /// Adjusts the results of `scan` after `count` bytes have been read.
    #[inline(always)]
    fn leave_behind(&mut self, count: usize) {
        self.has_stop_ahead &= count <= self.scanned;
        self.scanned = self.scanned.saturating_sub(count);
    }

    /// Returns whether DMA has overtaken the reader, which has found an empty slot among the unread ones. Only the
    /// newest of these slots may be empty: DMA can count its newest byte before it writes the byte. If an older slot
    /// is empty, DMA has gone once round the buffer during a look. That look has read the newest byte as if it were
    /// the oldest.
    #[cold]
    #[inline(never)]
    fn is_overtaken(&self, place: usize) -> bool {
        if !S::IS_CIRCULAR || Self::after(self.read) == place {
            return false;
        }
        self.source.settle();
        self.buffer.get(self.read).is_some_and(|slot| slot.load(Relaxed) == EMPTY)
    }

    /// Returns whether all slots hold unread bytes. Waits first: while the newest byte is written but not counted yet,
    /// the buffer also seems full.
    #[cold]
    #[inline(never)]
    fn is_full(&self, place: usize) -> bool {
        self.source.settle();
        loop {
            let now = self.source.place();
            let is_full = now == place || self.is_at_end(now);
            // A byte that arrived between the two calls of `place` is in the slot just checked. It does not mean that
            // the buffer is full, so look again.
            if self.source.place() == now {
                return is_full;
            }
        }
    }

    /// Handles an overrun. Nobody knows which bytes were overwritten, so all bytes are dropped. Of the commands that
    /// stop the machine, the one with the highest `weight` is kept.
    #[cold]
    #[inline(never)]
    fn lose_all(&mut self) {
        let mut stop =
            self.message.from(0).iter().copied().max_by_key(|byte| weight(*byte)).filter(|byte| is_stop(*byte));
        let (mut at, mut emptied) = (self.source.place(), 0);
        // Go once round the buffer, oldest byte first. Then go on through the bytes that arrived meanwhile, so that
        // every written slot is emptied.
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

    /// Sends the message being filled. `calls`: `true` if the caller calls the serial task right afterwards. If the
    /// message cannot be sent, the result of the next look asks for it again ([`Look::waits`]).
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

    /// Writes a byte into the slot at `place`; called by an interrupt that fills the buffer. `is_behind_loss`: `true`
    /// if bytes are missing before this byte. Returns `false` if there was no space.
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

/// Returns the priority of a command that stops the machine, for the case that only one can be kept: reset 5, stop 4,
/// door 3, hold 2, jog cancel 1. Returns 0 for any other byte.
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

/// Returns what replaces a byte that may be damaged. Commands that stop the machine and ends of lines stay as they
/// are. Any other byte becomes [`REFUSED`], so that its line is not executed.
fn refused(byte: u8) -> u8 {
    if is_stop(byte) || matches!(byte, b'\n' | b'\r') { byte } else { REFUSED }
}

/// Returns whether the value of a slot is a byte of text or an end of line, without any flag.
#[inline(always)]
fn is_line_byte(word: u16) -> bool {
    word <= 0xFF && (is_text(word as u8) || word as u8 == b'\n')
}

/// Returns whether a byte is text of a line, which the serial task need not process before the end of the line.
#[inline(always)]
fn is_text(byte: u8) -> bool {
    (b' '..=b'}').contains(&byte) && !matches!(byte, b'!' | b'?')
}
