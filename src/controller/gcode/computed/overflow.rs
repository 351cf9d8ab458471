//! Counts by how many bytes a held program is too long. The controller refuses its lines one by one and keeps none; a
//! check of the whole file reports the sum. Only builds with the feature `reasons` count.

use super::flow::{FlowControl, PROGRAM, SPARE};
use super::m_words::has_m_word;
use crate::gcode::REASONS;
use crate::gcode::program_number::{number_of, subprogram_number};

/// Length of `ENDSUB` and `O`, which the held text has in place of M99.
const END_OF_SUBPROGRAM: usize = 7;

/// A held program that did not fit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Excess {
    /// Length of the text that would be held by now.
    held: usize,
    /// How much longer the text is than the memory.
    lacking: usize,
    /// Length of the number of the present subprogram; 0 in the program.
    digits: usize,
    /// The present subprogram is the one for which the program waited.
    is_awaited: bool,
    /// Lines are counted, because they still belong to the program or its subprograms.
    counts: bool,
}

/// The last held program that did not fit; takes no memory in a build that does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Overflow([Excess; REASONS as usize]);

impl Overflow {
    /// Begins with a line of `length` bytes that did not fit into `flow`. `subprogram`: the number of the subprogram to
    /// which the line belongs, and whether the program waits for this one.
    pub fn begin(&mut self, flow: &FlowControl, length: usize, subprogram: Option<(&[u8], bool)>) {
        for excess in &mut self.0 {
            let (number, is_awaited) = subprogram.unwrap_or_default();
            *excess = Excess { held: flow.text.len(), lacking: 0, digits: number.len(), is_awaited, counts: true };
            excess.add(1 + length, flow.most);
        }
    }

    /// Counts a further line. The number of the next subprogram after the awaited one ends the count.
    pub fn count(&mut self, flow: &FlowControl, line: &[u8]) {
        for excess in self.0.iter_mut().filter(|excess| excess.counts) {
            match subprogram_number(line) {
                Some(_) if excess.is_awaited => excess.counts = false,
                Some(number) => {
                    excess.is_awaited = number_of(line) == flow.missing;
                    excess.digits = number.len();
                    excess.add(1 + line.len() + PROGRAM.len(), flow.most);
                }
                // M99 does not raise `lacking`, because the last M99 needs no spare bytes.
                None if has_m_word(line, &[b"99"]) => excess.held += 1 + END_OF_SUBPROGRAM + excess.digits,
                None => excess.add(1 + line.len(), flow.most),
            }
        }
    }

    /// Ends the count: another program begins.
    pub fn end(&mut self) {
        self.0.iter_mut().for_each(|excess| excess.counts = false);
    }

    /// While lines are counted: returns by how many bytes the program is too long so far.
    #[cfg(feature = "reasons")]
    pub fn so_far(&self) -> Option<usize> {
        self.0.first().filter(|excess| excess.counts).map(|excess| excess.lacking)
    }

    /// Returns by how many bytes the last program that did not fit was too long; `None` if all programs have fit.
    pub fn lacking(&self) -> Option<usize> {
        self.0.first().map(|excess| excess.lacking).filter(|lacking| *lacking > 0)
    }
}

impl Excess {
    fn add(&mut self, length: usize, most: usize) {
        self.held += length;
        self.lacking = (self.held + SPARE).saturating_sub(most);
    }
}
