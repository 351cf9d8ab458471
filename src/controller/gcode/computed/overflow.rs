//! Counts by how many bytes a held program is too long. A program is held if it calls a subprogram that the host has
//! not sent yet: its lines are recorded and run later. The controller drops a program that does not fit and refuses
//! each of its remaining lines; a check of the whole file then reports the sum. Only builds with the feature `reasons`
//! count.

use super::flow::{FlowControl, PROGRAM, SPARE};
use super::m_words::has_m_word;
use crate::gcode::REASONS;
use crate::gcode::program_number::{number_of, subprogram_number};

/// Length in bytes of `O` and `ENDSUB`. In the held text, `O1001ENDSUB` replaces the M99 of the subprogram 1001.
const END_OF_SUBPROGRAM: usize = 7;

/// Count of the bytes of a held program that did not fit into the held text.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Excess {
    /// Length that the held text would have in bytes if every line so far had been stored.
    held: usize,
    /// Number of bytes by which `held`, with [`SPARE`] bytes left free, exceeds the capacity of the held text.
    bytes: usize,
    /// Number of digits in the O number of the subprogram whose lines are being counted; 0 for lines of the main
    /// program.
    digits: usize,
    /// Whether the lines being counted belong to the subprogram for which the program waits.
    is_awaited: bool,
    /// Whether the next refused line is counted. Becomes `false` when another program begins, or when a subprogram
    /// follows the awaited one.
    counts: bool,
}

/// The most recent held program that did not fit; takes no memory in a build that does not count.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Overflow([Excess; REASONS as usize]);

impl Overflow {
    /// Starts the count with the first line that did not fit into `flow`; the line has `length` bytes. `subprogram`:
    /// the number of the subprogram to which the line belongs, and `true` if the program waits for this subprogram.
    pub fn begin(&mut self, flow: &FlowControl, length: usize, subprogram: Option<(&[u8], bool)>) {
        for excess in &mut self.0 {
            let (number, is_awaited) = subprogram.unwrap_or_default();
            *excess = Excess { held: flow.text.len(), bytes: 0, digits: number.len(), is_awaited, counts: true };
            excess.add(1 + length, flow.most);
        }
    }

    /// Adds a further refused line to the count. The program could have continued after the awaited subprogram, so the
    /// count ends at the next O number after that subprogram.
    pub fn count(&mut self, flow: &FlowControl, line: &[u8]) {
        for excess in self.0.iter_mut().filter(|excess| excess.counts) {
            match subprogram_number(line) {
                Some(_) if excess.is_awaited => excess.counts = false,
                Some(number) => {
                    excess.is_awaited = number_of(line) == flow.missing;
                    excess.digits = number.len();
                    excess.add(1 + line.len() + PROGRAM.len(), flow.most);
                }
                // M99 does not raise `bytes`: it is stored as `O`, number and `ENDSUB`, which may use the `SPARE`
                // bytes.
                None if has_m_word(line, &[b"99"]) => excess.held += 1 + END_OF_SUBPROGRAM + excess.digits,
                None => excess.add(1 + line.len(), flow.most),
            }
        }
    }

    /// Ends the count of missing bytes, because another program begins. [`Self::excess`] still returns the sum.
    pub fn end(&mut self) {
        self.0.iter_mut().for_each(|excess| excess.counts = false);
    }

    /// Returns by how many bytes the program is too long so far; `None` if no count of refused lines is in progress.
    #[cfg(feature = "reasons")]
    pub fn so_far(&self) -> Option<usize> {
        self.0.first().filter(|excess| excess.counts).map(|excess| excess.bytes)
    }

    /// Returns how many bytes of memory were missing for the most recent held program that did not fit; `None` if all
    /// programs have fit.
    pub fn excess(&self) -> Option<usize> {
        self.0.first().map(|excess| excess.bytes).filter(|bytes| *bytes > 0)
    }
}

impl Excess {
    fn add(&mut self, length: usize, most: usize) {
        self.held += length;
        self.bytes = (self.held + SPARE).saturating_sub(most);
    }
}
