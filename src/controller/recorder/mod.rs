//! Records everything that the controller receives, with times: bytes of lines, realtime commands, inputs and step
//! events. The recording is a ring of RAM pages that survives a reset. After a reset the ring is kept for `$REC`, until
//! the next program starts.
//!
//! ```text
//!  page n-2 ▶ page n-1 ▶ page n ─┐    a page: mark, number, start time, number of used bytes and their sum, entries
//!     ▲                          │
//!     └── the oldest is reused ◀─┘
//! ```
//! A byte of a line is an entry of one byte. All other entries are rarer and begin with a tag (0x80 and above). One of
//! them, the time entry, contains the microseconds since the previous time. Each page can be decoded without the
//! others, so the ring always begins with a whole entry. An entry counts only when it is completely written, so a reset
//! at any moment leaves a valid ring.
//!
//! Bytes of a line are gathered first, and written to the ring together with the line end, before the controller gets
//! the line end. So a reset loses at most the last bytes of an unfinished line, which has had no effect yet.
//!
//! RAM contents are random after power-up, so a page is valid only if its mark, number and sum are right.
//!
//! After a reset, the recording from before the reset is kept and nothing is recorded, until an unlocked machine
//! receives a line of a program. `$` lines (reading settings, unlocking, jogging, homing) do not start a new recording.
//!
//! `?` is not recorded, because hosts send it continually and it changes nothing.

use crate::dispatch::Controller;
use crate::messages::{
    CrashKind, Event, HOST_CHANGED, LineByte, Noted, Realtime, Record, Recorded, Restart, Sensed, Standing, StepEvent,
    Stopping, ToStep,
};
use crate::protocol::intake::EPOCHS;
use crate::protocol::realtime;
use crate::units::{Coordinate, Instant};
use core::sync::atomic::{Ordering, compiler_fence};

/// Number of bytes for entries in a page.
const ROOM: usize = 236;
const OPEN: u32 = u32::from_le_bytes(*b"came");
/// Value of [`Page::mark`] in the page in which the recording ends; `OPEN` in all other valid pages.
const CLOSED: u32 = u32::from_le_bytes(*b"ends");

/// Maximum number of bytes of a line gathered before they are written to the ring.
const PLAIN: usize = 64;
/// Maximum number of bytes of a line end and its time entry: a tag, ten bytes of time, and the line end.
const LINE_END: usize = 1 + 10 + 1;

/// Maximum time, in microseconds, by which the last entry can be later than `Crash::moment`. That moment is the start
/// of a round of the control task, and the failure can happen in the next round. The watchdog ends a round that hangs
/// after half a second or two seconds.
const LONGEST_TURN_US: u32 = 10_000_000;

// Basis and prime of the 32-bit hash FNV-1a, used for the hash of blocks. Each step of the hash takes a whole word
// here, not a byte.
const BASIS: u32 = 0x811C_9DC5;
const PRIME: u32 = 0x0100_0193;
/// Factor in the checksum of a page: odd, so that one wrong byte always changes the checksum.
const FACTOR: u32 = 0x9E37_79B1;

/// Tags: the first byte of an entry. Only printable characters and line ends of a line are entries of one byte without
/// a tag.
mod tag {
    pub const BYTE: u8 = 0x80;
    pub const TIME: u8 = 0x81;
    pub const COMMAND: u8 = 0x82;
    pub const INPUTS: u8 = 0x83;
    pub const STEP: u8 = 0x84;
    pub const STORED: u8 = 0x85;
    pub const STORE_FAILED: u8 = 0x86;
    pub const CONNECTED: u8 = 0x87;
    pub const DISCONNECTED: u8 = 0x88;
    pub const MORE: u8 = 0x89;
    pub const DAMAGED: u8 = 0x8A;
    pub const CUT: u8 = 0x8B;
    pub const REST: u8 = 0x8C;
    pub const STANDING: u8 = 0x8D;
    pub const POWER_UP: u8 = 0x8E;
    pub const ENDED: u8 = 0x8F;
}

/// A page of the ring: 256 bytes; every bit pattern is allowed.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Page {
    mark: u32,
    /// Increases by one from page to page.
    number: u32,
    /// Time at which the page begins, in microseconds since power-up.
    time: u64,
    /// Number of used bytes (lower 8 bits) and their sum (upper 24 bits), in one word, so that a reset cannot separate
    /// them.
    state: u32,
    bytes: [u8; ROOM],
}

impl Page {
    /// A page without contents.
    pub const EMPTY: Page = Page { mark: 0, number: 0, time: 0, state: 0, bytes: [0; ROOM] };

    /// Returns the bytes of the pages as RAM holds them (little-endian). Only tests need them, to damage RAM contents.
    pub fn bytes_of(pages: &[Page]) -> impl Iterator<Item = u8> {
        pages.iter().flat_map(|page| {
            let head = page.mark.to_le_bytes().into_iter().chain(page.number.to_le_bytes());
            head.chain(page.time.to_le_bytes()).chain(page.state.to_le_bytes()).chain(page.bytes)
        })
    }

    /// Returns the page that these 256 bytes of RAM (little-endian) hold. The result is never `None`, because 256
    /// bytes are enough.
    pub fn of_bytes(bytes: &[u8; 256]) -> Option<Page> {
        let mut rest = Bytes(bytes);
        let (mark, number) = (rest.word()?, rest.word()?);
        let time = rest.some().map(u64::from_le_bytes)?;
        Some(Page { mark, number, time, state: rest.word()?, bytes: rest.some()? })
    }

    /// Makes the page valid as page `number`, with its present contents: sets the mark, the number and the sum. For
    /// tests.
    pub fn seal(&mut self, number: u32) {
        (self.mark, self.number) = (OPEN, number);
        let used = self.used().min(ROOM);
        let sum = self.bytes.iter().take(used).fold(self.seed(), |sum, byte| add_to_sum(sum, *byte));
        self.state = sum << 8 | used as u32;
    }

    #[inline(always)]
    fn used(&self) -> usize {
        (self.state & 0xFF) as usize
    }

    /// Returns the checksum of a page without entries.
    fn seed(&self) -> u32 {
        let words = [self.number, self.time as u32, (self.time >> 32) as u32];
        words.iter().flat_map(|word| word.to_le_bytes()).fold(0x5EED, add_to_sum)
    }

    /// Returns the entries, if the page is valid.
    #[inline(never)]
    fn entries(&self) -> Option<&[u8]> {
        let bytes = self.bytes.get(..self.used()).filter(|_| matches!(self.mark, OPEN | CLOSED))?;
        let sum = bytes.iter().fold(self.seed(), |sum, byte| add_to_sum(sum, *byte));
        (sum << 8 == self.state & !0xFF).then_some(bytes)
    }

    fn begin(&mut self, number: u32, time: u64) {
        // The page is invalid while it has no mark.
        self.mark = 0;
        compiler_fence(Ordering::SeqCst);
        (self.number, self.time) = (number, time);
        self.state = self.seed() << 8;
        compiler_fence(Ordering::SeqCst);
        self.mark = OPEN;
    }

    /// Appends all bytes, or none if there is no room. Returns whether they were appended.
    #[inline]
    fn append(&mut self, bytes: &[u8]) -> bool {
        let used = self.used();
        let end = used + bytes.len();
        let Some(places) = self.bytes.get_mut(used..end) else { return false };
        let mut sum = self.state >> 8;
        for (place, byte) in places.iter_mut().zip(bytes) {
            *place = *byte;
            sum = add_to_sum(sum, *byte);
        }
        // The new bytes belong to the page only from here on, when all of them are written.
        compiler_fence(Ordering::SeqCst);
        self.state = sum << 8 | end as u32;
        compiler_fence(Ordering::SeqCst);
        true
    }
}

#[inline(always)]
fn add_to_sum(sum: u32, byte: u8) -> u32 {
    sum.wrapping_mul(FACTOR).wrapping_add(u32::from(byte))
}

/// Packs a byte of a line into a word: its epoch in the upper 16 bits, [`LineByte::damaged`] in bit 8, and the byte in
/// the lower 8 bits. So the plain bytes of an epoch (undamaged, blank to `~`) are consecutive words, and one
/// comparison recognises them. The parts are joined in the order of the fields in memory and then rotated, because
/// that is cheap.
#[inline(always)]
fn word_of(byte: LineByte) -> u32 {
    (u32::from(byte.epoch) | u32::from(byte.byte) << 16 | u32::from(byte.damaged) << 24).rotate_left(16)
}

/// How far the ring has been read for `$REC`.
#[derive(Clone, Debug)]
struct Reading {
    /// `Page::number` of the page being read, if any.
    number: Option<u32>,
    at: usize,
    time: u64,
    /// The line being assembled.
    line: heapless::Vec<u8, { Noted::HOST_BYTES }>,
    /// Number of stored records (settings, offsets and the like) listed so far; `None` once all records are listed.
    records: Option<u16>,
    begun: bool,
}

/// Writes the recording into the ring of pages, and reads it back. `P` holds the pages.
#[derive(Clone, Debug)]
pub struct Recorder<P> {
    pages: P,
    /// Index of the page being written.
    slot: usize,
    number: u32,
    time: u64,
    /// The current epoch: number of resets, stops and jog cancels passed to the controller (wrapping), as in
    /// [`LineByte`].
    epoch: u16,
    /// The word ([`word_of`]) of a blank in the current epoch. A blank is the lowest plain byte (printable, undamaged):
    /// see [`Recorder::expect_plain`].
    plain_from: u32,
    /// Gathered bytes, which are not in the ring yet: printable bytes of a line, or a time entry.
    next: heapless::Vec<u8, PLAIN>,
    /// The `epoch` that the last reset or stop began. Line bytes of older epochs are not recorded.
    reset_epoch: u16,
    /// A line byte that arrived before the command that begins the byte's epoch. It is recorded after that command.
    early: Option<u8>,
    /// The recording from before the reset is kept in the ring, so nothing is recorded now.
    kept: bool,
    /// While a recording is kept: a line has begun and not ended. Its bytes are not recorded.
    in_line: bool,
    /// Something has been recorded since [`Recorder::at_rest`] last recorded a machine at rest.
    news: bool,
    /// No state recorded so far can start a replay, so the next state at rest must be recorded.
    wants_standing: bool,
    /// Hash of all blocks passed to the step task since the last stop. A replay must make the same blocks.
    blocks: u32,
    /// Value of `blocks` when it was last recorded.
    blocks_recorded: u32,
    /// `Page::number` of the page with the latest `Standing` entry.
    standing_in: u32,
    reading: Reading,
}

impl<P: AsRef<[Page]> + AsMut<[Page]>> Recorder<P> {
    /// Starts the recorder after a reset of the board. Keeps a recording from before the reset.
    pub fn begin(pages: P, restart: &Restart) -> Self {
        let reading = Reading { number: None, at: 0, time: 0, line: heapless::Vec::new(), records: None, begun: false };
        let mut recorder = Recorder {
            pages,
            slot: 0,
            number: 0,
            time: 0,
            epoch: 0,
            plain_from: 0,
            next: heapless::Vec::new(),
            reset_epoch: 0,
            early: None,
            kept: false,
            in_line: false,
            news: true,
            wants_standing: true,
            blocks: BASIS,
            blocks_recorded: BASIS,
            standing_in: 0,
            reading,
        };
        match recorder.newest() {
            Some(number) => recorder.keep(number, restart),
            None => {
                recorder.clear(0);
                recorder.put_entry(Instant::from_ticks(0), tag::POWER_UP, &[]);
            }
        }
        recorder.expect_plain();
        recorder
    }

    /// Returns the pages of the ring, for tests of what a reset leaves in RAM.
    pub fn pages(&self) -> &[Page] {
        self.pages.as_ref()
    }

    /// Returns whether a recording from before the reset is kept. While it is kept, nothing is recorded. The message
    /// about the restart then names `$REC`.
    pub fn is_kept(&self) -> bool {
        self.kept
    }

    /// Keeps the recording from before the reset, and appends an entry that records how the previous run ended.
    #[inline(never)]
    fn keep(&mut self, number: u32, restart: &Restart) {
        self.kept = true;
        (self.number, self.slot) = (number, self.slot_of(number));
        if self.page(number).is_none_or(|page| page.mark == CLOSED) {
            return;
        }
        // Read to the end: the last entry tells the time at which the recording ends.
        self.rewind();
        while self.next_entry().is_some() {}
        self.time = self.reading.time;
        let mut text = Rest::new();
        let (mut place, mut line, mut kind) = ([0; 3], 0, Noted::NO_CRASH);
        if let Some(crash) = &restart.crash {
            let passed = crash.moment.wrapping_sub(self.time as u32);
            // `crash.moment` is the start time of the round before the failed round, so the last entry can be later.
            // In that case `passed` is close to `u32::MAX`, and the time stays as it is.
            if passed <= u32::MAX - LONGEST_TURN_US {
                self.time_to(self.time + u64::from(passed));
            }
            (place, line) = (crash.place, crash.line);
            kind = CrashKind::ALL.iter().position(|known| *known == crash.kind).unwrap_or_default() as u8;
        }
        let _ = text.push(kind);
        for number in place.map(|axis| axis as u32).into_iter().chain([line]) {
            put_word(&mut text, number);
        }
        self.put_tagged(tag::ENDED, &text);
        let slot = self.slot;
        if let Some(page) = self.pages.as_mut().get_mut(slot) {
            page.mark = CLOSED;
        }
    }

    // Pages of the ring: finding and beginning them

    fn slot_of(&self, number: u32) -> usize {
        number as usize % self.pages.as_ref().len().max(1)
    }

    /// Returns the page of this number, if it is valid.
    #[inline(never)]
    fn page(&self, number: u32) -> Option<&Page> {
        let page = self.pages.as_ref().get(self.slot_of(number))?;
        (page.number == number && page.entries().is_some()).then_some(page)
    }

    #[inline(never)]
    fn newest(&self) -> Option<u32> {
        let pages = self.pages.as_ref().iter().enumerate();
        let whole = pages.filter(|(slot, page)| self.slot_of(page.number) == *slot && page.entries().is_some());
        // Pages left from an earlier pass around the ring have lower numbers, so the highest number is the newest.
        whole.map(|(_, page)| page.number).max()
    }

    /// Discards everything and starts recording.
    #[inline(never)]
    fn clear(&mut self, time: u64) {
        for page in self.pages.as_mut() {
            page.mark = 0;
        }
        (self.number, self.slot, self.time) = (0, 0, time);
        (self.kept, self.wants_standing, self.standing_in) = (false, true, 0);
        (self.blocks, self.blocks_recorded) = (BASIS, BASIS);
        self.next.clear();
        self.expect_plain();
        if let Some(page) = self.pages.as_mut().first_mut() {
            page.begin(0, time);
        }
    }

    #[inline(never)]
    fn turn_page(&mut self) {
        self.number = self.number.wrapping_add(1);
        self.slot = self.slot_of(self.number);
        let (number, time) = (self.number, self.time);
        if let Some(page) = self.pages.as_mut().get_mut(self.slot) {
            page.begin(number, time);
        }
    }

    // Writing: bytes are gathered in `next`, then written to a page

    /// Makes [`Recorder::put_plain`] accept only printable bytes of the current epoch, and none at all while the
    /// recording from before the reset is kept.
    fn expect_plain(&mut self) {
        // Bit 15 is never set in a word made by `word_of`. So with this bit, no word is in the range of plain bytes.
        let kept = u32::from(self.kept) << 15;
        self.plain_from = word_of(LineByte { byte: b' ', epoch: self.epoch, damaged: false }) | kept;
    }

    /// Gathers a byte in `next` if it is plain (printable, undamaged, of the current epoch) and there is room. Returns
    /// whether it was gathered; nearly all bytes are.
    #[inline(always)]
    fn put_plain(&mut self, byte: LineByte) -> bool {
        let is_plain = word_of(byte).wrapping_sub(self.plain_from) <= u32::from(b'~' - b' ');
        is_plain && self.next.push(byte.byte).is_ok()
    }

    /// Writes the bytes gathered in `next` to the ring, all into one page.
    #[inline(never)]
    fn flush(&mut self) {
        for _ in 0..2 {
            if self.pages.as_mut().get_mut(self.slot).is_some_and(|page| page.append(&self.next)) {
                break;
            }
            self.turn_page();
        }
        self.next.clear();
    }

    /// Writes an entry to the ring, all of it into one page, so that each page can be decoded without the others.
    #[inline(never)]
    fn put_tagged(&mut self, tag: u8, rest: &[u8]) {
        if !self.next.is_empty() {
            self.flush();
        }
        let mut entry = Rest::new();
        let _ = entry.push(tag);
        put_bytes(&mut entry, rest);
        for _ in 0..2 {
            if self.pages.as_mut().get_mut(self.slot).is_some_and(|page| page.append(&entry)) {
                return;
            }
            self.turn_page();
        }
    }

    #[inline(never)]
    fn time_to(&mut self, time: u64) {
        if self.time < time {
            self.put_time(time);
            self.flush();
            self.time = time;
        }
    }

    /// Writes the gathered bytes and a line end (`byte`) to the ring. If `time` is later than the last recorded time, a
    /// time entry comes before the line end.
    #[inline(always)]
    fn put_end(&mut self, time: u64, byte: u8) {
        if self.time < time {
            self.put_time(time);
        } else if self.next.is_full() {
            self.flush();
        }
        let _ = self.next.push(byte);
        self.flush();
        self.time = self.time.max(time);
    }

    /// Adds a time entry to the gathered bytes: the microseconds from `self.time`, the last recorded time, to `time`.
    #[inline]
    fn put_time(&mut self, time: u64) {
        if self.next.len() > PLAIN - LINE_END {
            self.flush();
        }
        let mut left = time - self.time;
        let _ = self.next.push(tag::TIME);
        while left >= 0x80 {
            let _ = self.next.push(left as u8 | 0x80);
            left >>= 7;
        }
        let _ = self.next.push(left as u8);
    }

    #[inline(never)]
    fn put_entry(&mut self, now: Instant, tag: u8, rest: &[u8]) {
        self.time_to(now.ticks());
        self.put_tagged(tag, rest);
    }

    /// Records text: bytes of `epoch` that only extend a line. `now`: the time at which the controller takes the text.
    /// Unlike [`Recorder::record`], this may be called after the controller has taken it, because text changes nothing
    /// that the recorder reads from the controller.
    #[inline]
    pub fn record_text<const N: usize>(&mut self, now: Instant, epoch: u16, text: &[u8], controller: &Controller<N>) {
        // Text has no damaged bytes and no control characters, so all of it is plain if its epoch is the current one.
        let is_expected = word_of(LineByte { byte: b' ', epoch, damaged: false }) == self.plain_from;
        if is_expected && self.next.extend_from_slice(text).is_ok() {
            return;
        }
        for byte in text {
            let byte = LineByte { byte: *byte, epoch, damaged: false };
            if !self.put_plain(byte) {
                self.line_byte(now, byte, controller);
            }
        }
    }

    /// Records an event for the controller at `now`. Call it before the controller gets the event.
    #[inline(always)]
    pub fn record<const N: usize>(&mut self, now: Instant, event: &Event<N>, controller: &Controller<N>) {
        match event {
            // Nearly all events are line bytes.
            Event::Line(byte) => {
                if !self.put_plain(*byte) {
                    self.line_byte(now, *byte, controller);
                }
            }
            Event::Realtime(Realtime::Status | Realtime::FullStatus | Realtime::ParserState) | Event::Pins(_) => {}
            event => self.record_seldom(now, event),
        }
    }

    /// Records that further bytes were already waiting when the controller took the end of the line just recorded.
    #[inline]
    pub fn more_waits(&mut self) {
        if self.kept {
            return;
        }
        let page = self.pages.as_mut().get_mut(self.slot).filter(|_| self.next.is_empty());
        if !page.is_some_and(|page| page.append(&[tag::MORE])) {
            self.put_tagged(tag::MORE, &[]);
        }
    }

    #[inline(never)]
    fn line_byte<const N: usize>(&mut self, now: Instant, byte: LineByte, controller: &Controller<N>) {
        let LineByte { byte: text, epoch, damaged } = byte;
        if self.kept {
            let begins = !self.in_line;
            self.in_line = !matches!(text, b'\n' | b'\r' | HOST_CHANGED);
            let unlocked = !controller.is_locked();
            if !(begins && unlocked && matches!(text, b'A'..=b'Z' | b'a'..=b'z' | b'#')) {
                return;
            }
            self.clear(now.ticks());
            self.record_standing(now, controller);
        }
        if text == HOST_CHANGED {
            return self.put_entry(now, tag::CUT, &[]);
        }
        let behind = self.epoch.wrapping_sub(epoch) as i16;
        if behind < 0 {
            self.early = Some(text);
            return;
        }
        if (epoch.wrapping_sub(self.reset_epoch) as i16) < 0 {
            return;
        }
        // A jog sent before a jog cancel is not carried out, so it is recorded like a damaged line.
        if damaged || behind > 0 && text == b'$' {
            self.put_entry(now, tag::DAMAGED, &[]);
        }
        self.record_byte(now, text);
    }

    fn record_byte(&mut self, now: Instant, text: u8) {
        match text {
            // Only the end of a line has a time in the recording.
            b'\n' | b'\r' => {
                self.put_end(now.ticks(), text);
                self.news = true;
            }
            b' '..=b'~' => self.put_tagged(text, &[]),
            other => self.put_tagged(tag::BYTE, &[other]),
        }
    }

    #[inline(never)]
    fn record_seldom<const N: usize>(&mut self, now: Instant, event: &Event<N>) {
        let opens = matches!(event, Event::Realtime(command) if command.opens_epoch());
        self.epoch = self.epoch.wrapping_add(u16::from(opens));
        self.expect_plain();
        if let Event::Realtime(Realtime::Reset | Realtime::Stop) = event {
            self.reset_epoch = self.epoch;
        }
        // Epochs are compared by the sign of their 16-bit difference. So `reset_epoch` must stay less than 2^15 behind
        // `epoch`.
        if self.epoch.wrapping_sub(self.reset_epoch) > EPOCHS {
            self.reset_epoch = self.epoch.wrapping_sub(EPOCHS);
        }
        if self.kept {
            return;
        }
        self.news = true;
        match event {
            Event::Realtime(command) => {
                self.wants_standing |= matches!(command, Realtime::Reset | Realtime::Stop);
                self.put_entry(now, tag::COMMAND, &[realtime::byte_of(*command)]);
            }
            Event::Step(event) => self.record_step(now, event),
            Event::Signals(sensed) => self.record_inputs(now, sensed),
            Event::Stored | Event::StoreFailed => {
                // The stored values have changed, so a replay cannot start from an earlier state.
                self.wants_standing = true;
                let stored = matches!(event, Event::Stored);
                self.put_entry(now, if stored { tag::STORED } else { tag::STORE_FAILED }, &[]);
            }
            Event::Connected => self.put_entry(now, tag::CONNECTED, &[]),
            Event::Disconnected(_) => self.put_entry(now, tag::DISCONNECTED, &[]),
            Event::Line(_) | Event::Pins(_) => {}
        }
        if opens && let Some(early) = self.early.take() {
            self.record_byte(now, early);
        }
    }

    fn record_inputs(&mut self, now: Instant, sensed: &Sensed) {
        let mut words = [0; 8];
        let (active, tripped) = words.split_at_mut(4);
        active.copy_from_slice(&sensed.signals.word().to_le_bytes());
        tripped.copy_from_slice(&sensed.tripped.to_le_bytes());
        self.put_entry(now, tag::INPUTS, &words);
    }

    fn record_step<const N: usize>(&mut self, now: Instant, event: &StepEvent<N>) {
        let (kind, position) = match event {
            StepEvent::Stopped { moving: false, position, .. } => (0, position),
            StepEvent::Stopped { moving: true, position, .. } => (1, position),
            StepEvent::Probed { position } => (2, position),
            StepEvent::Underrun { position, .. } => (3, position),
            StepEvent::Miscounted { position, .. } => (4, position),
        };
        // How many blocks the step task gets before a stop depends on the exact time of the stop, so it can differ in
        // a replay. The hash therefore starts again after each stop.
        (self.blocks, self.blocks_recorded) = (BASIS, BASIS);
        let mut rest = Rest::new();
        let _ = rest.push(kind);
        put_axes(&mut rest, &position.0);
        self.put_entry(now, tag::STEP, &rest);
    }

    /// Updates the hash of blocks when a message is passed to the step task. Only a message that announces a block
    /// changes the hash.
    #[inline(always)]
    pub fn handed(&mut self, message: &ToStep) {
        if let ToStep::Block { steps_by_axis, directions } = message {
            let mut hash = self.blocks;
            // Axes that do not move are skipped, because the machine that replays the recording can have more axes than
            // this board.
            for (axis, number) in steps_by_axis.iter().zip(1..) {
                if axis.steps() != 0 {
                    hash = (hash ^ axis.word()).wrapping_mul(PRIME) ^ number;
                }
            }
            self.blocks = (hash ^ u32::from(*directions)).wrapping_mul(PRIME);
        }
    }

    /// Returns the hash of all blocks passed to the step task since the last stop. A replay compares it with the
    /// recorded one.
    pub fn blocks(&self) -> u32 {
        self.blocks
    }

    /// Sets the hash of the blocks at the start of a replay. `blocks`: the hash that was recorded with the state from
    /// which the replay begins.
    pub fn follow_blocks(&mut self, blocks: u32) {
        self.blocks = blocks;
    }

    /// Records a machine at rest: the step counters and, from time to time, a state from which a replay can begin.
    #[inline]
    pub fn at_rest<const N: usize>(&mut self, now: Instant, controller: &Controller<N>) {
        if self.news && !self.kept {
            self.record_rest(now, controller);
        }
    }

    #[inline(never)]
    fn record_rest<const N: usize>(&mut self, now: Instant, controller: &Controller<N>) {
        self.news = false;
        if self.blocks != self.blocks_recorded {
            self.blocks_recorded = self.blocks;
            let mut rest = Rest::new();
            put_axes(&mut rest, &controller.step_counters().0);
            put_word(&mut rest, self.blocks);
            self.put_entry(now, tag::REST, &rest);
        }
        // Record a state in each quarter of the ring, so that the ring holds a state even after its oldest pages were
        // reused.
        let pages = self.pages.as_ref().len() as u32;
        if self.wants_standing || self.number.wrapping_sub(self.standing_in) >= (pages / 4).max(1) {
            self.record_standing(now, controller);
        }
    }

    #[inline(never)]
    fn record_standing<const N: usize>(&mut self, now: Instant, controller: &Controller<N>) {
        let Some(standing) = controller.standing() else { return };
        let mut rest = Rest::new();
        let flags = u8::from(standing.trusted) | u8::from(standing.locked) << 1 | u8::from(standing.inches) << 2;
        let _ = rest.push(flags);
        put_word(&mut rest, standing.tool);
        put_bytes(&mut rest, &standing.active.to_le_bytes());
        put_word(&mut rest, self.blocks);
        let _ = rest.push(N as u8);
        for (counter, place) in standing.counters.iter().zip(&standing.place) {
            put_word(&mut rest, *counter as u32);
            put_bytes(&mut rest, &place.0.to_le_bytes());
        }
        let _ = rest.push(standing.words.len() as u8);
        put_bytes(&mut rest, &standing.words);
        self.put_entry(now, tag::STANDING, &rest);
        self.wants_standing = false;
        self.standing_in = self.number;
    }

    // Reading

    /// Starts reading at the oldest page.
    #[inline(never)]
    fn rewind(&mut self) {
        let mut oldest = self.number;
        while self.number.wrapping_sub(oldest) < self.pages.as_ref().len() as u32
            && oldest > 0
            && self.page(oldest - 1).is_some()
        {
            oldest -= 1;
        }
        let page = self.page(oldest);
        let (number, time) = (page.map(|page| page.number), page.map_or(0, |page| page.time));
        self.reading = Reading { number, at: 0, time, line: heapless::Vec::new(), records: Some(0), begun: false };
    }

    /// Passes the next item of the `$REC` listing to `tell`: the board, a stored record, the start time, an entry or
    /// the end. `first`: begins the listing again. `name`: name of the board; `step_clock_hz`: frequency of its step
    /// clock. `record` returns the stored record (a setting, an offset) with this index.
    pub fn read(
        &mut self,
        first: bool,
        (name, step_clock_hz): (&'static str, u32),
        mut record: impl FnMut(u16) -> Option<Record>,
        tell: impl FnOnce(&Recorded),
    ) {
        if first {
            self.rewind();
            return tell(&Recorded::Board { name, step_clock_hz });
        }
        if let Some(told) = self.reading.records {
            if let Some(record) = record(told) {
                self.reading.records = Some(told.saturating_add(1));
                return tell(&Recorded::Record(record));
            }
            self.reading.records = None;
        }
        if !core::mem::replace(&mut self.reading.begun, true) {
            return tell(&Recorded::Begin(self.reading.time));
        }
        match self.next_entry() {
            Some(entry) => tell(&Recorded::Noted(self.reading.time, entry)),
            None => tell(&Recorded::End),
        }
    }

    /// Returns the next entry; its time is then in `self.reading.time`. `None`: the recording ends here.
    #[inline(never)]
    fn next_entry(&mut self) -> Option<Noted> {
        loop {
            let Some(number) = self.reading.number else { return self.take_line() };
            let at = self.reading.at;
            let Some(page) = self.page(number) else {
                self.reading.number = None;
                continue;
            };
            let bytes = page.bytes.get(at..page.used()).unwrap_or_default();
            let Some((tag, rest)) = bytes.split_first() else {
                let next = number.wrapping_add(1);
                self.reading.number = (number != self.number).then_some(next);
                self.reading.at = 0;
                continue;
            };
            let tag = *tag;
            let Some((used, found)) = decode(tag, rest) else {
                // An entry that cannot be decoded ends the listing.
                self.reading.number = None;
                continue;
            };
            // The entry may be one that voids the unfinished line (a reset, a disconnected host). So return that line
            // first.
            if matches!(found, Found::Noted(_)) && !self.reading.line.is_empty() {
                return self.take_line();
            }
            self.reading.at = at + 1 + used;
            match found {
                Found::Time(passed) => self.reading.time = self.reading.time.saturating_add(passed),
                Found::Text(byte) => {
                    let _ = self.reading.line.push(byte);
                    if matches!(byte, b'\n' | b'\r') || self.reading.line.is_full() {
                        return self.take_line();
                    }
                }
                Found::Noted(entry) => return Some(entry),
            }
        }
    }

    fn take_line(&mut self) -> Option<Noted> {
        let line = core::mem::take(&mut self.reading.line);
        (!line.is_empty()).then_some(Noted::Host(line))
    }
}

/// The bytes of an entry after its tag.
type Rest = heapless::Vec<u8, ROOM>;

// The following functions have many callers but rarely run. They are not inlined, to save flash.

#[inline(never)]
fn put_bytes(out: &mut Rest, bytes: &[u8]) {
    for byte in bytes {
        let _ = out.push(*byte);
    }
}

#[inline(never)]
fn put_word(out: &mut Rest, word: u32) {
    put_bytes(out, &word.to_le_bytes());
}

#[inline(never)]
fn put_axes(out: &mut Rest, axes: &[i32]) {
    let _ = out.push(axes.len() as u8);
    for axis in axes {
        put_word(out, *axis as u32);
    }
}

enum Found {
    Time(u64),
    Text(u8),
    Noted(Noted),
}

/// Unread bytes of an entry.
struct Bytes<'a>(&'a [u8]);

impl Bytes<'_> {
    fn some<const COUNT: usize>(&mut self) -> Option<[u8; COUNT]> {
        let (some, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*some)
    }

    #[inline(never)]
    fn byte(&mut self) -> Option<u8> {
        self.some().map(|[byte]| byte)
    }

    #[inline(never)]
    fn word(&mut self) -> Option<u32> {
        self.some().map(u32::from_le_bytes)
    }

    #[inline(never)]
    fn axes(&mut self) -> Option<heapless::Vec<i32, { Standing::AXES }>> {
        let count = usize::from(self.byte()?);
        let mut axes = heapless::Vec::new();
        for _ in 0..count {
            axes.push(self.word()? as i32).ok()?;
        }
        Some(axes)
    }
}

/// Decodes the entry with this tag; `rest`: the bytes after the tag. Returns how many of these bytes the entry has,
/// and the decoded entry. `None` if the entry is incomplete or unknown.
fn decode(tag: u8, rest: &[u8]) -> Option<(usize, Found)> {
    let mut bytes = Bytes(rest);
    let found = match tag {
        0..0x80 => Found::Text(tag),
        tag::BYTE => Found::Text(bytes.byte()?),
        tag::TIME => {
            let mut passed = 0;
            for shift in (0..64).step_by(7) {
                let digit = bytes.byte()?;
                passed |= u64::from(digit & 0x7F) << shift;
                if digit < 0x80 {
                    break;
                }
            }
            Found::Time(passed)
        }
        tag::COMMAND => Found::Noted(Noted::Command(bytes.byte()?)),
        tag::INPUTS => Found::Noted(Noted::Inputs { active: bytes.word()?, tripped: bytes.word()? }),
        tag::STEP => {
            let stopping = *Stopping::ALL.get(usize::from(bytes.byte()?))?;
            Found::Noted(Noted::Step(stopping, bytes.axes()?))
        }
        tag::STORED | tag::STORE_FAILED => Found::Noted(Noted::Stored(tag == tag::STORED)),
        tag::CONNECTED => Found::Noted(Noted::Connected),
        tag::DISCONNECTED => Found::Noted(Noted::Disconnected),
        tag::MORE => Found::Noted(Noted::More),
        tag::DAMAGED => Found::Noted(Noted::Damaged),
        tag::CUT => Found::Noted(Noted::Cut),
        tag::REST => Found::Noted(Noted::Rest { counters: bytes.axes()?, blocks: bytes.word()? }),
        tag::STANDING => Found::Noted(standing(&mut bytes)?),
        tag::POWER_UP => Found::Noted(Noted::PowerUp),
        tag::ENDED => {
            let kind = bytes.byte()?;
            let mut word = || bytes.word();
            let place = [word()? as i32, word()? as i32, word()? as i32];
            Found::Noted(Noted::Ended { crash: CrashKind::ALL.get(usize::from(kind)).copied(), place, line: word()? })
        }
        _ => return None,
    };
    Some((rest.len() - bytes.0.len(), found))
}

#[inline(never)]
fn standing(bytes: &mut Bytes<'_>) -> Option<Noted> {
    let flags = bytes.byte()?;
    let (tool, active, blocks) = (bytes.word()?, bytes.word()?, bytes.word()?);
    let (mut counters, mut place) = (heapless::Vec::new(), heapless::Vec::new());
    for _ in 0..bytes.byte()? {
        counters.push(bytes.word()? as i32).ok()?;
        place.push(Coordinate(bytes.some().map(i64::from_le_bytes)?)).ok()?;
    }
    let mut words = heapless::Vec::new();
    for _ in 0..bytes.byte()? {
        words.push(bytes.byte()?).ok()?;
    }
    let bit = |n: u8| flags >> n & 1 != 0;
    let (trusted, locked, inches) = (bit(0), bit(1), bit(2));
    Some(Noted::Standing {
        standing: Standing { counters, place, trusted, locked, inches, tool, active, words },
        blocks,
    })
}
