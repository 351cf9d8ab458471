//! The ring between the task that answers and the interrupt that a free data register brings.
//!
//! Neither side waits for the other: each variable has one writer.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, Ordering::Relaxed, fence};

/// Bytes of the ring: a power of two.
pub const ROOM: u32 = 64;

/// The ring.
pub struct Sent {
    bytes: [AtomicU8; ROOM as usize],
    /// Bytes that have been put in, and taken out.
    put: AtomicU32,
    taken: AtomicU32,
}

impl Sent {
    /// Nothing is to be sent.
    pub const fn new() -> Self {
        Self { bytes: [const { AtomicU8::new(0) }; ROOM as usize], put: AtomicU32::new(0), taken: AtomicU32::new(0) }
    }

    /// Bytes that wait.
    #[inline]
    pub fn waiting(&self) -> u32 {
        self.put.load(Relaxed).wrapping_sub(self.taken.load(Relaxed))
    }

    /// For the task: a byte, if there is room for it.
    #[inline]
    pub fn put(&self, byte: u8) -> bool {
        let put = self.put.load(Relaxed);
        let has_room = self.waiting() < ROOM;
        if has_room {
            fence(Ordering::Acquire);
            self.bytes[(put % ROOM) as usize].store(byte, Relaxed);
            fence(Ordering::Release);
            self.put.store(put.wrapping_add(1), Relaxed);
        }
        has_room
    }

    /// For the interrupt: the next byte.
    #[inline]
    pub fn take(&self) -> Option<u8> {
        let taken = self.taken.load(Relaxed);
        if self.put.load(Relaxed) == taken {
            return None;
        }
        fence(Ordering::Acquire);
        let byte = self.bytes[(taken % ROOM) as usize].load(Relaxed);
        fence(Ordering::Release);
        self.taken.store(taken.wrapping_add(1), Relaxed);
        Some(byte)
    }
}

impl Default for Sent {
    fn default() -> Self {
        Self::new()
    }
}
