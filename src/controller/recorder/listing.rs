//! Reads the recording back, entry by entry: for `$REC`, and after a reset to find the time at which it ends.

use super::entry::{Found, decode};
use super::page::Page;
use super::ring::Ring;
use crate::messages::{Noted, Record, Recorded};

/// How far the ring has been read for `$REC`.
#[derive(Clone, Debug)]
pub(super) struct Reading {
    /// `Page::number` of the page being read, if any.
    number: Option<u32>,
    at: usize,
    pub(super) time: u64,
    /// The line being assembled.
    line: heapless::Vec<u8, { Noted::HOST_BYTES }>,
    /// Number of stored records (settings, offsets and the like) listed so far; `None` once all records are listed.
    records: Option<u16>,
    begun: bool,
}

impl Reading {
    /// Nothing has been read.
    pub(super) const fn new() -> Self {
        Reading { number: None, at: 0, time: 0, line: heapless::Vec::new(), records: None, begun: false }
    }

    /// Starts reading at the oldest page.
    #[inline(never)]
    pub(super) fn rewind<P: AsRef<[Page]> + AsMut<[Page]>>(&mut self, ring: &Ring<P>) {
        let page = ring.page(ring.oldest());
        *self = Reading { number: page.map(|page| page.number), records: Some(0), ..Reading::new() };
        self.time = page.map_or(0, |page| page.time);
    }

    /// Passes the next item of the `$REC` listing to `tell`: the board, a stored record, the start time, an entry or
    /// the end. `first`: begins the listing again. `name`: name of the board; `step_clock_hz`: frequency of its step
    /// clock. `record` returns the stored record (a setting, an offset) with this index.
    pub(super) fn read<P: AsRef<[Page]> + AsMut<[Page]>>(
        &mut self,
        ring: &Ring<P>,
        first: bool,
        (name, step_clock_hz): (&'static str, u32),
        mut record: impl FnMut(u16) -> Option<Record>,
        tell: impl FnOnce(&Recorded),
    ) {
        if first {
            self.rewind(ring);
            return tell(&Recorded::Board { name, step_clock_hz });
        }
        if let Some(told) = self.records {
            if let Some(record) = record(told) {
                self.records = Some(told.saturating_add(1));
                return tell(&Recorded::Record(record));
            }
            self.records = None;
        }
        if !core::mem::replace(&mut self.begun, true) {
            return tell(&Recorded::Begin(self.time));
        }
        match self.next_entry(ring) {
            Some(entry) => tell(&Recorded::Noted(self.time, entry)),
            None => tell(&Recorded::End),
        }
    }

    /// Returns the next entry; its time is then in `time`. `None`: the recording ends here.
    #[inline(never)]
    pub(super) fn next_entry<P: AsRef<[Page]> + AsMut<[Page]>>(&mut self, ring: &Ring<P>) -> Option<Noted> {
        loop {
            let Some(number) = self.number else { return self.take_line() };
            let at = self.at;
            let Some(page) = ring.page(number) else {
                self.number = None;
                continue;
            };
            let bytes = page.bytes.get(at..page.used()).unwrap_or_default();
            let Some((tag, rest)) = bytes.split_first() else {
                let next = number.wrapping_add(1);
                self.number = (number != ring.number()).then_some(next);
                self.at = 0;
                continue;
            };
            let tag = *tag;
            let Some((used, found)) = decode(tag, rest) else {
                // An entry that cannot be decoded ends the listing.
                self.number = None;
                continue;
            };
            // The entry may be one that voids the unfinished line (a reset, a disconnected host). So return that line
            // first.
            if matches!(found, Found::Noted(_)) && !self.line.is_empty() {
                return self.take_line();
            }
            self.at = at + 1 + used;
            match found {
                Found::Time(passed) => self.time = self.time.saturating_add(passed),
                Found::Text(byte) => {
                    let _ = self.line.push(byte);
                    if matches!(byte, b'\n' | b'\r') || self.line.is_full() {
                        return self.take_line();
                    }
                }
                Found::Noted(entry) => return Some(entry),
            }
        }
    }

    fn take_line(&mut self) -> Option<Noted> {
        let line = core::mem::take(&mut self.line);
        (!line.is_empty()).then_some(Noted::Host(line))
    }
}
