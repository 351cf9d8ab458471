//! Reads the recording back, entry by entry: for `$REC`, and after a reset to find the time at which it ends.

use super::Recorder;
use super::entry::{Found, decode};
use super::page::Page;
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
}

impl<P: AsRef<[Page]> + AsMut<[Page]>> Recorder<P> {
    /// Starts reading at the oldest page.
    #[inline(never)]
    pub(super) fn rewind(&mut self) {
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
    pub(super) fn next_entry(&mut self) -> Option<Noted> {
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
