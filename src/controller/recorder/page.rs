//! A page of the recording in RAM, which survives a reset: its bytes, its checksum, and the order in which they are
//! written. A reset between any two writes leaves a valid page.

use core::sync::atomic::{Ordering, compiler_fence};

/// Number of bytes for entries in a page.
pub(super) const ROOM: usize = 236;
const OPEN: u32 = u32::from_le_bytes(*b"came");
/// Value of [`Page::mark`] in the page in which the recording ends; `OPEN` in all other valid pages.
pub(super) const CLOSED: u32 = u32::from_le_bytes(*b"ends");

/// Factor in the checksum of a page: odd, so that one wrong byte always changes the checksum.
const FACTOR: u32 = 0x9E37_79B1;

/// A page of the ring: 256 bytes; every bit pattern is allowed.
#[repr(C)]
#[derive(Clone, Copy, Debug)]
pub struct Page {
    pub(super) mark: u32,
    /// Increases by one from page to page.
    pub(super) number: u32,
    /// Time at which the page begins, in microseconds since power-up.
    pub(super) time: u64,
    /// Number of used bytes (lower 8 bits) and their sum (upper 24 bits), in one word, so that a reset cannot separate
    /// them.
    state: u32,
    pub(super) bytes: [u8; ROOM],
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
        let (mark, rest) = bytes.split_first_chunk()?;
        let (number, rest) = rest.split_first_chunk()?;
        let (time, rest) = rest.split_first_chunk()?;
        let (state, rest) = rest.split_first_chunk()?;
        let [mark, number, state] = [*mark, *number, *state].map(u32::from_le_bytes);
        Some(Page { mark, number, time: u64::from_le_bytes(*time), state, bytes: *rest.first_chunk()? })
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
    pub(super) fn used(&self) -> usize {
        (self.state & 0xFF) as usize
    }

    /// Returns the checksum of a page without entries.
    fn seed(&self) -> u32 {
        let words = [self.number, self.time as u32, (self.time >> 32) as u32];
        words.iter().flat_map(|word| word.to_le_bytes()).fold(0x5EED, add_to_sum)
    }

    /// Returns the entries, if the page is valid.
    #[inline(never)]
    pub(super) fn entries(&self) -> Option<&[u8]> {
        let bytes = self.bytes.get(..self.used()).filter(|_| matches!(self.mark, OPEN | CLOSED))?;
        let sum = bytes.iter().fold(self.seed(), |sum, byte| add_to_sum(sum, *byte));
        (sum << 8 == self.state & !0xFF).then_some(bytes)
    }

    pub(super) fn begin(&mut self, number: u32, time: u64) {
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
    pub(super) fn append(&mut self, bytes: &[u8]) -> bool {
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
