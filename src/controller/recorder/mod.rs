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

mod entry;
mod listing;
mod page;
mod ring;

pub use page::Page;

use crate::dispatch::Controller;
use crate::messages::{
    CrashKind, Event, HOST_CHANGED, LineByte, Noted, Realtime, Record, Recorded, Restart, Sensed, StepEvent, ToStep,
};
use crate::protocol::intake::EPOCHS;
use crate::protocol::realtime;
use crate::units::Instant;
use entry::{Rest, put_axes, put_bytes, put_word, tag};
use listing::Reading;
use ring::Ring;

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
/// Packs a byte of a line into a word: its epoch in the upper 16 bits, [`LineByte::damaged`] in bit 8, and the byte in
/// the lower 8 bits. So the plain bytes of an epoch (undamaged, blank to `~`) are consecutive words, and one
/// comparison recognises them. The parts are joined in the order of the fields in memory and then rotated, because
/// that is cheap.
#[inline(always)]
fn word_of(byte: LineByte) -> u32 {
    (u32::from(byte.epoch) | u32::from(byte.byte) << 16 | u32::from(byte.damaged) << 24).rotate_left(16)
}

/// Writes the recording into the ring of pages, and reads it back. `P` holds the pages.
#[derive(Clone, Debug)]
pub struct Recorder<P> {
    ring: Ring<P>,
    /// Time of the last entry, in microseconds since power-up.
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
        let mut recorder = Recorder {
            ring: Ring::new(pages),
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
            reading: Reading::new(),
        };
        match recorder.ring.newest() {
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
        self.ring.pages()
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
        self.ring.turn_to(number);
        if self.ring.is_closed() {
            return;
        }
        // Read to the end: the last entry tells the time at which the recording ends.
        self.reading.rewind(&self.ring);
        while self.reading.next_entry(&self.ring).is_some() {}
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
        self.ring.close();
    }

    /// Discards everything and starts recording.
    #[inline(never)]
    fn clear(&mut self, time: u64) {
        self.ring.clear(time);
        self.time = time;
        (self.kept, self.wants_standing, self.standing_in) = (false, true, 0);
        (self.blocks, self.blocks_recorded) = (BASIS, BASIS);
        self.next.clear();
        self.expect_plain();
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
            if self.ring.append(&self.next) {
                break;
            }
            self.ring.begin_next(self.time);
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
            if self.ring.append(&entry) {
                return;
            }
            self.ring.begin_next(self.time);
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
        if !(self.next.is_empty() && self.ring.append(&[tag::MORE])) {
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
        let pages = self.ring.pages().len() as u32;
        if self.wants_standing || self.ring.number().wrapping_sub(self.standing_in) >= (pages / 4).max(1) {
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
        self.standing_in = self.ring.number();
    }

    /// Passes the next item of the `$REC` listing to `tell`: the board, a stored record, the start time, an entry or
    /// the end. `first`: begins the listing again. `board`: name of the board, and frequency of its step clock in Hz.
    /// `record` returns the stored record (a setting, an offset) with this index.
    pub fn read(
        &mut self,
        first: bool,
        board: (&'static str, u32),
        record: impl FnMut(u16) -> Option<Record>,
        tell: impl FnOnce(&Recorded),
    ) {
        self.reading.read(&self.ring, first, board, record, tell);
    }
}
