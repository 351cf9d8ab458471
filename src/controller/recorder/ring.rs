//! The ring of pages in RAM: which page is the newest, and which page holds a number. Only the newest page is written.

use super::page::{CLOSED, Page};

/// A ring of pages. `P` holds them.
#[derive(Clone, Debug)]
pub(super) struct Ring<P> {
    pages: P,
    /// Index of the newest page.
    slot: usize,
    /// Number of the newest page.
    number: u32,
}

impl<P: AsRef<[Page]> + AsMut<[Page]>> Ring<P> {
    /// Takes the pages as they are in RAM. The first page counts as the newest one until [`Ring::turn_to`].
    pub(super) fn new(pages: P) -> Self {
        Ring { pages, slot: 0, number: 0 }
    }

    pub(super) fn pages(&self) -> &[Page] {
        self.pages.as_ref()
    }

    /// Returns the number of the newest page.
    pub(super) fn number(&self) -> u32 {
        self.number
    }

    fn slot_of(&self, number: u32) -> usize {
        number as usize % self.pages().len().max(1)
    }

    /// Returns the page of this number, if it is valid.
    #[inline(never)]
    pub(super) fn page(&self, number: u32) -> Option<&Page> {
        let page = self.pages().get(self.slot_of(number))?;
        (page.number == number && page.entries().is_some()).then_some(page)
    }

    /// Searches the RAM for the newest valid page, and returns its number.
    #[inline(never)]
    pub(super) fn newest(&self) -> Option<u32> {
        let pages = self.pages().iter().enumerate();
        let whole = pages.filter(|(slot, page)| self.slot_of(page.number) == *slot && page.entries().is_some());
        // Pages left from an earlier pass around the ring have lower numbers, so the highest number is the newest.
        whole.map(|(_, page)| page.number).max()
    }

    /// Makes the page of this number the newest one.
    pub(super) fn turn_to(&mut self, number: u32) {
        (self.number, self.slot) = (number, self.slot_of(number));
    }

    /// Returns the number of the oldest page of the recording that ends with the newest page.
    pub(super) fn oldest(&self) -> u32 {
        let mut oldest = self.number;
        while self.number.wrapping_sub(oldest) < self.pages().len() as u32
            && oldest > 0
            && self.page(oldest - 1).is_some()
        {
            oldest -= 1;
        }
        oldest
    }

    /// Discards all pages, and begins page 0. `time`: microseconds since power-up.
    pub(super) fn clear(&mut self, time: u64) {
        for page in self.pages.as_mut() {
            page.mark = 0;
        }
        (self.number, self.slot) = (0, 0);
        if let Some(page) = self.newest_page() {
            page.begin(0, time);
        }
    }

    /// Begins the next page, in place of the oldest one. `time`: microseconds since power-up.
    #[inline(never)]
    pub(super) fn begin_next(&mut self, time: u64) {
        self.turn_to(self.number.wrapping_add(1));
        let number = self.number;
        if let Some(page) = self.newest_page() {
            page.begin(number, time);
        }
    }

    /// Returns the newest page; `None` if the ring has no pages.
    #[inline(always)]
    fn newest_page(&mut self) -> Option<&mut Page> {
        self.pages.as_mut().get_mut(self.slot)
    }

    /// Appends the bytes to the newest page. Returns `false`, and appends none of them, if the page has no room.
    #[inline(always)]
    pub(super) fn append(&mut self, bytes: &[u8]) -> bool {
        self.newest_page().is_some_and(|page| page.append(bytes))
    }

    /// Marks the newest page as the end of the recording.
    pub(super) fn close(&mut self) {
        if let Some(page) = self.newest_page() {
            page.mark = CLOSED;
        }
    }

    /// Returns whether the newest page is invalid or ends the recording.
    pub(super) fn is_closed(&self) -> bool {
        self.page(self.number).is_none_or(|page| page.mark == CLOSED)
    }
}
