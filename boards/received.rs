//! The ring between the interrupt that a byte brings and the task that reads it.
//!
//! One side never waits for the other: each variable has one writer, but for `error` and `drops`, which the interrupt sets
//! and the task takes back. A place in the stream is the count of bytes before it, wrapping.

use crate::calls::{RESET, is_stop};
use core::sync::atomic::{AtomicBool, AtomicU8, AtomicU32, Ordering, Ordering::Relaxed, fence};

/// Bytes of the ring: a power of two.
pub const ROOM: u32 = 512;
/// Places that only what stops the machine may take.
pub const FOR_STOPS: u32 = 16;
/// Most bytes that [`Received::place`] moves.
const MOVED: usize = 64;
/// Bytes of text that may wait for the end of their line.
const GATHERED: u32 = 32;

/// Whether the task is to be called for a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Call {
    /// It stops the machine.
    AtOnce,
    /// When it may be called.
    Soon,
    /// Not for this one.
    NotYet,
}

/// What is next in the stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// A byte.
    Byte(u8),
    /// Bytes are missing here.
    Missing,
    /// Nothing has come.
    Nothing,
}

/// The ring.
pub struct Received {
    bytes: [AtomicU8; ROOM as usize],
    /// Bytes that have been put in.
    come: AtomicU32,
    /// Bytes that have been taken out: never beyond `error_at` while there is an error.
    taken: AtomicU32,
    /// Bytes are missing at `error_at`: overwritten, or disturbed.
    error: AtomicBool,
    error_at: AtomicU32,
    /// Where the last byte ends that stops the machine, or may do so.
    stop_to: AtomicU32,
    /// There was another error before that one was told: all that comes is dropped until the ring is empty.
    drops: AtomicBool,
    /// The byte before, if it was kept and nothing is missing behind it.
    before: AtomicU8,
}

impl Received {
    /// Nothing has come.
    pub const fn new() -> Self {
        Self {
            bytes: [const { AtomicU8::new(0) }; ROOM as usize],
            come: AtomicU32::new(0),
            taken: AtomicU32::new(0),
            error: AtomicBool::new(false),
            error_at: AtomicU32::new(0),
            stop_to: AtomicU32::new(0),
            drops: AtomicBool::new(false),
            before: AtomicU8::new(0),
        }
    }

    /// Place of a byte of the stream.
    #[inline(always)]
    fn slot(&self, at: u32) -> &AtomicU8 {
        &self.bytes[(at % ROOM) as usize]
    }

    /// For the interrupt: a byte has come. Gives whether the task is to be called for it.
    #[inline(always)]
    pub fn hear(&self, byte: u8) -> Call {
        let before = self.before.load(Relaxed);
        self.before.store(byte, Relaxed);
        if is_text(byte) {
            let is_due = self.keep(byte, false).is_none_or(|waiting| waiting >= GATHERED);
            return if is_due { Call::Soon } else { Call::NotYet };
        }
        let is_stop = is_stop(byte);
        let repeats = byte == before && (is_stop || byte == b'?');
        if repeats && self.is_waiting() {
            // The one before has not been heard yet: it says the same.
            return Call::NotYet;
        }
        if byte == RESET {
            self.forget_losses();
        }
        self.keep(byte, is_stop);
        if is_stop && !repeats { Call::AtOnce } else { Call::Soon }
    }

    /// For the interrupt: a byte, one that stops the machine also where others are dropped or have no room. Gives how many waited before it,
    /// or `None` if it is missing now.
    #[inline(always)]
    pub fn keep(&self, byte: u8, is_stop: bool) -> Option<u32> {
        let come = self.come.load(Relaxed);
        let waiting = come.wrapping_sub(self.taken.load(Relaxed));
        let has_place = if is_stop { waiting < ROOM } else { waiting < ROOM - FOR_STOPS && !self.drops.load(Relaxed) };
        if !has_place {
            self.miss();
            return None;
        }
        self.slot(come).store(byte, Relaxed);
        let behind = come.wrapping_add(1);
        // Unless bytes behind it are as urgent.
        if is_stop && !(1..=ROOM).contains(&self.stop_to.load(Relaxed).wrapping_sub(behind)) {
            self.stop_to.store(behind, Relaxed);
        }
        fence(Ordering::Release);
        self.come.store(behind, Relaxed);
        Some(waiting)
    }

    /// Whether a byte has not been taken yet.
    #[inline(always)]
    pub fn is_waiting(&self) -> bool {
        self.come.load(Relaxed) != self.taken.load(Relaxed)
    }

    /// Whether what stops the machine, or may do so, waits.
    #[inline]
    pub fn has_stop(&self) -> bool {
        let ahead = self.stop_to.load(Relaxed).wrapping_sub(self.taken.load(Relaxed));
        (1..=ROOM).contains(&ahead)
    }

    /// While the interrupt does not run: as many bytes as the ring holds are as urgent as a stop.
    pub fn hurry(&self) {
        self.stop_to.store(self.taken.load(Relaxed).wrapping_add(ROOM), Relaxed);
    }

    /// Nothing has come: at the start, while neither side runs.
    pub fn clear(&self) {
        self.taken.store(self.come.load(Relaxed), Relaxed);
        self.error.store(false, Relaxed);
        self.drops.store(false, Relaxed);
    }

    /// For the interrupt: a command comes that makes void what came before, and what was lost of it.
    pub fn forget_losses(&self) {
        self.drops.store(false, Relaxed);
    }

    /// For the interrupt: bytes are missing here.
    pub fn miss(&self) {
        // What is lost says nothing: the same again is to be kept.
        self.before.store(0, Relaxed);
        if !self.error.load(Relaxed) && !self.drops.load(Relaxed) {
            self.error_at.store(self.come.load(Relaxed), Relaxed);
            fence(Ordering::Release);
            self.error.store(true, Relaxed);
        } else {
            self.drops.store(true, Relaxed);
        }
    }

    /// For the task: the bytes that come next, up to what is missing or to the end of the ring.
    #[inline]
    pub fn ready(&self) -> &[u8] {
        let taken = self.taken.load(Relaxed);
        // In this order: an error that comes between the two lies behind these bytes.
        let mut count = self.come.load(Relaxed).wrapping_sub(taken);
        fence(Ordering::Acquire);
        if self.error.load(Relaxed) {
            count = count.min(self.error_at.load(Relaxed).wrapping_sub(taken));
        }
        let from = taken % ROOM;
        let count = count.min(ROOM - from) as usize;
        let bytes = self.bytes.as_ptr().cast::<u8>();
        // SAFETY: unsafe because atomics are read as plain bytes; safe because those that have come and not been taken
        // lie in the ring, and nothing writes them: `keep` writes behind them, and the task that holds this slice is not
        // preempted by what calls `place`.
        unsafe { core::slice::from_raw_parts(bytes.add(from as usize), count) }
    }

    /// For the task: so many of [`Received::ready`] have been read.
    #[inline]
    pub fn pass(&self, count: usize) {
        fence(Ordering::Release);
        self.taken.store(self.taken.load(Relaxed).wrapping_add(count as u32), Relaxed);
    }

    /// For the task: what is next.
    #[inline]
    pub fn next(&self) -> Next {
        loop {
            if let [byte, ..] = *self.ready() {
                self.pass(1);
                return Next::Byte(byte);
            }
            let (error, taken) = (self.error.load(Relaxed), self.taken.load(Relaxed));
            fence(Ordering::Acquire);
            if error && self.error_at.load(Relaxed) == taken {
                self.error.store(false, Relaxed);
                return Next::Missing;
            }
            // While it drops, nothing comes but stops.
            let drops = self.drops.load(Relaxed);
            fence(Ordering::Acquire);
            if !self.error.load(Relaxed) && self.come.load(Relaxed) == taken {
                if drops {
                    self.drops.store(false, Relaxed);
                    return Next::Missing;
                }
                return Next::Nothing;
            }
        }
    }

    /// While neither side runs: the room behind what waits that is in one piece, as an address and a count of bytes. If what
    /// waits is little, as it is where the task has not been kept from it, it moves to the begin of the ring, and the room
    /// is all of the rest. [`Received::placed`] has to follow.
    pub fn place(&self) -> (usize, u32) {
        let taken = self.taken.load(Relaxed);
        let waiting = self.come.load(Relaxed).wrapping_sub(taken);
        let mut moved = [0; MOVED];
        if let Some(moved) = moved.get_mut(..waiting as usize) {
            for (at, byte) in (0..).zip(moved.iter_mut()) {
                *byte = self.slot(taken.wrapping_add(at)).load(Relaxed);
            }
            for (slot, byte) in self.bytes.iter().zip(moved) {
                slot.store(*byte, Relaxed);
            }
            for at in [&self.error_at, &self.stop_to] {
                at.store(at.load(Relaxed).wrapping_sub(taken), Relaxed);
            }
            self.taken.store(0, Relaxed);
            self.come.store(waiting, Relaxed);
        }
        let at = self.come.load(Relaxed) % ROOM;
        (self.bytes.as_ptr() as usize + at as usize, (ROOM - at).min(ROOM - waiting))
    }

    /// While neither side runs: of so many bytes of that room, which have been filled, some are missing or disturbed, and it is
    /// not known which. `refused` gives what each becomes.
    pub fn placed_disturbed(&self, count: u32, refused: fn(u8) -> u8) {
        self.miss();
        let come = self.come.load(Relaxed);
        for at in 0..count {
            let slot = self.slot(come.wrapping_add(at));
            slot.store(refused(slot.load(Relaxed)), Relaxed);
        }
        self.placed(count);
    }

    /// While neither side runs: so many bytes of that room have been filled.
    pub fn placed(&self, count: u32) {
        // None of them has been looked at: a stop may be among them.
        self.before.store(0, Relaxed);
        let come = self.come.load(Relaxed).wrapping_add(count);
        self.stop_to.store(come, Relaxed);
        self.come.store(come, Relaxed);
    }
}

/// Whether a byte is text of a line, with which the task has nothing to do before the end of the line.
#[inline(always)]
fn is_text(byte: u8) -> bool {
    (b' '..=b'}').contains(&byte) && !matches!(byte, b'!' | b'?')
}

impl Default for Received {
    fn default() -> Self {
        Self::new()
    }
}
