//! Forecasts how long a job takes over a serial link of a given baud rate. Lists the lines at which the machine waits
//! for bytes, in comparison with an unlimited link.
//!
//! The sender counts characters: it sends a line if the line and all unanswered lines together fit into the
//! controller's receive buffer. Replies take time on the way back, too. Time advances in slices of a millisecond.

use crate::machine::linear;
use crate::path::Drawing;
use crate::simulator::Simulator;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// Length of a time slice.
const SLICE: Duration = Duration::from_millis(1);
/// Capacity that a byte uses, in thousandths of a bit: a start bit, eight data bits and a stop bit. In this unit, a
/// link of N baud gains a capacity of N in each slice of 1/1000 s. For example, at 115200 baud a slice carries
/// 115200 / 10000 = 11.52 bytes.
const BYTE: u64 = 1000 * 10;
/// Minimum loss of time that is listed, in seconds. The lag of a line is how much later it ends than over an unlimited
/// link. A line is listed if its lag exceeds the lag of the last listed line by more than this loss. Smaller
/// differences can come from the time slices alone.
const NOTICEABLE: f64 = 0.005;
/// Maximum number of lines that are listed.
const MOST_PLACES: usize = 20;

/// A line at which the machine lost time because it waited for bytes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lost {
    /// Line number in the text sent, from 1.
    pub line: u64,
    /// Time lost compared with an unlimited link, in seconds. Counted from the previous listed line, in the order of
    /// the text.
    pub seconds: f64,
}

/// Forecast for a job that is sent over a link.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Streamed {
    /// Bits per second of the link; 0 for an unlimited link.
    pub baud: u32,
    /// Time from the first byte sent until the machine is at rest, in seconds.
    pub forecast_s: f64,
    /// Whether every line was answered and the machine came to rest.
    pub complete: bool,
    /// Number of lines that were answered with an error.
    pub errors: u64,
    /// Lines at which the machine lost time compared with an unlimited link. The line with the largest loss comes
    /// first.
    pub lost: Vec<Lost>,
}

/// A job that is being sent over a simulated link to a simulated machine.
pub struct Streaming {
    simulator: Simulator,
    baud: u32,
    origin: u64,
    lines_before: u32,
    waiting: VecDeque<Vec<u8>>,
    /// Lengths of the lines that have been sent and not answered.
    in_flight: VecDeque<usize>,
    /// Bytes of the sender that the link has not carried yet.
    outgoing: VecDeque<u8>,
    /// Capacity that the link has gained for `outgoing` and not used yet, in the unit of [`BYTE`].
    credit: u64,
    /// Reply bytes that the link has not carried back to the sender yet.
    returning: VecDeque<u8>,
    answer: Vec<u8>,
    /// Capacity that the link has gained for `returning` and not used yet, in the unit of [`BYTE`].
    credit_back: u64,
    errors: u64,
    done: bool,
}

impl Streaming {
    /// Starts sending a text to an idle simulator at `baud` bits per second; 0 for an unlimited link.
    pub fn new(mut simulator: Simulator, text: &[u8], baud: u32) -> Self {
        let origin = simulator.clock().now();
        simulator.begin_job();
        simulator.mark_moves();
        simulator.take_output();
        let start = simulator.meter().millimetres(simulator.machine().motors());
        let seconds = simulator.clock().seconds(origin);
        simulator.meter_mut().draw(Drawing::new(linear(start), seconds));
        let lines_before = simulator.controller().lines_read();
        Self {
            simulator,
            baud,
            origin,
            lines_before,
            waiting: lines_of(text),
            in_flight: VecDeque::new(),
            outgoing: VecDeque::new(),
            credit: 0,
            returning: VecDeque::new(),
            answer: Vec::new(),
            credit_back: 0,
            errors: 0,
            done: false,
        }
    }

    /// Advances the machine by up to `slices` milliseconds. Returns whether the job has ended.
    pub fn advance(&mut self, slices: u32) -> bool {
        for _ in 0..slices {
            if self.done {
                break;
            }
            self.run_slice();
        }
        self.done
    }

    fn run_slice(&mut self) {
        let room = self.simulator.board().received_bytes;
        while let Some(line) = self.waiting.front()
            && (self.in_flight.is_empty() || self.in_flight.iter().sum::<usize>() + line.len() <= room)
        {
            self.in_flight.push_back(line.len());
            self.outgoing.extend(self.waiting.pop_front().unwrap_or_default());
        }
        if self.outgoing.is_empty() && self.returning.is_empty() {
            self.pass_slices_without_event();
        }
        let carried = carried(self.baud, &mut self.credit, self.outgoing.len());
        let bytes: Vec<u8> = self.outgoing.drain(..carried).collect();
        if !bytes.is_empty() {
            self.simulator.send(bytes);
        }
        self.simulator.run_for(SLICE);
        self.returning.extend(self.simulator.take_output().bytes());
        let carried = self::carried(self.baud, &mut self.credit_back, self.returning.len());
        for byte in self.returning.drain(..carried).collect::<Vec<u8>>() {
            self.receive_answer(byte);
        }
        let answered = self.waiting.is_empty() && self.in_flight.is_empty();
        let stuck = !self.simulator.is_active() && self.outgoing.is_empty() && self.returning.is_empty();
        self.done = answered && self.simulator.is_idle() || stuck && !self.in_flight.is_empty();
    }

    /// Skips the time slices in which nothing happens, because a dwell can last for years.
    fn pass_slices_without_event(&mut self) {
        let slice = self.simulator.clock().ticks_in(SLICE);
        let slices = self.simulator.ticks_without_event() / slice;
        self.simulator.advance_to(self.simulator.clock().now() + slices * slice);
        for credit in [&mut self.credit, &mut self.credit_back] {
            *credit = (*credit + slices % BYTE * u64::from(self.baud)) % BYTE;
        }
    }

    fn receive_answer(&mut self, byte: u8) {
        if byte != b'\n' {
            self.answer.push(byte);
            return;
        }
        let answer = std::mem::take(&mut self.answer);
        let is_error = answer.starts_with(b"error:");
        if is_error || answer.starts_with(b"ok") {
            self.in_flight.pop_front();
            self.errors += u64::from(is_error);
        }
    }

    /// Returns the progress: the number of lines that the controller has read, and the approximate number of all lines.
    pub fn progress(&self) -> (u64, u64) {
        let left = (self.waiting.len() + self.in_flight.len()) as u64;
        // After a restart (`$REBOOT`) the controller counts from 0 again.
        let read = u64::from(self.simulator.controller().lines_read().saturating_sub(self.lines_before));
        (read, read.max(1) + left)
    }

    /// Returns the end time of each line of the text, in seconds from the first byte.
    fn ends(&self) -> BTreeMap<u32, f64> {
        let points = self.simulator.meter().drawing().map_or(&[][..], Drawing::points);
        points.iter().map(|point| (point.mark.line.wrapping_sub(self.lines_before), point.seconds[1])).collect()
    }

    /// Returns the result, compared with the same job over an unlimited link.
    pub fn summary(&self, unlimited: &Streaming) -> Streamed {
        let clock = self.simulator.clock();
        let free = unlimited.ends();
        let mut lag = 0.0;
        let mut lost = Vec::new();
        for (line, end) in self.ends() {
            let Some(expected) = free.get(&line) else { continue };
            let late = end - expected;
            if late > lag + NOTICEABLE {
                lost.push(Lost { line: u64::from(line), seconds: ((late - lag) * 1e3).round() / 1e3 });
                lag = late;
            }
        }
        lost.sort_by(|a, b| b.seconds.total_cmp(&a.seconds).then(a.line.cmp(&b.line)));
        lost.truncate(MOST_PLACES);
        Streamed {
            baud: self.baud,
            forecast_s: clock.seconds(clock.now() - self.origin),
            complete: self.done && self.in_flight.is_empty(),
            errors: self.errors,
            lost,
        }
    }
}

/// Returns how many of the `waiting` bytes a link carries in one time slice. `credit`: its unused capacity, in the unit
/// of [`BYTE`].
fn carried(baud: u32, credit: &mut u64, waiting: usize) -> usize {
    if baud == 0 {
        return waiting;
    }
    *credit += u64::from(baud);
    let carried = usize::try_from(*credit / BYTE).unwrap_or(waiting).min(waiting);
    // If all bytes are carried, the rest of the capacity is lost, except for a part of a byte: an idle link cannot save
    // up capacity.
    *credit = if carried < waiting { *credit - carried as u64 * BYTE } else { *credit % BYTE };
    carried
}

/// Returns the lines as a sender transmits them. A tape mark becomes an empty line. Realtime commands and characters
/// beyond ASCII become blanks.
fn lines_of(text: &[u8]) -> VecDeque<Vec<u8>> {
    let text = String::from_utf8_lossy(text).replace("\r\n", "\n").replace('\r', "\n");
    let plain = |c: char| if c.is_ascii_graphic() && !"!?~".contains(c) { c as u8 } else { b' ' };
    let lines = text.trim_start_matches('\u{FEFF}').split_terminator('\n').map(|line| {
        let mark = line.trim_start().starts_with('%');
        let line = if mark { "" } else { line };
        line.chars().map(plain).chain([b'\n']).collect()
    });
    lines.collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::power_up::apply_setting;

    fn streamed(text: &str, baud: u32) -> Streaming {
        let mut simulator = Simulator::new(crate::Options::default());
        simulator.run_until_idle();
        for setting in ["110=6000", "111=6000", "120=500", "121=500"] {
            apply_setting(&mut simulator, setting).unwrap();
        }
        let mut streaming = Streaming::new(simulator, text.as_bytes(), baud);
        while !streaming.advance(1000) {}
        streaming
    }

    /// Moves of 0.1 mm at 6000 mm/min: a thousand lines of 17 bytes per second.
    fn dense() -> String {
        let moves: String = (1..=500).map(|i| format!("G1X{:.4}Y0.0000\n", f64::from(i) * 0.1)).collect();
        format!("G21 G90 F6000\n{moves}")
    }

    #[test]
    fn a_slow_link_starves_a_dense_job_and_a_fast_one_does_not() {
        let free = streamed(&dense(), 0);
        let fast = streamed(&dense(), 921_600).summary(&free);
        let slow = streamed(&dense(), 19_200).summary(&free);
        let unlimited = free.summary(&free);
        assert!(unlimited.complete && fast.complete && slow.complete);
        assert!(fast.forecast_s < unlimited.forecast_s + 0.2, "{fast:?} {unlimited:?}");
        // The job has almost 9 kB, which take more than 4 s at 1920 bytes per second.
        assert!(slow.forecast_s > 3.5 && slow.forecast_s > 2.0 * unlimited.forecast_s, "{slow:?} {unlimited:?}");
        assert!(!slow.lost.is_empty() && unlimited.lost.is_empty());
        assert!(slow.lost.iter().all(|lost| (1..=501).contains(&lost.line) && lost.seconds > 0.0));
    }

    #[test]
    fn refused_lines_are_counted_and_realtime_bytes_are_not_sent() {
        let free = streamed("%\nG1 X1 F600 (why? ! ~)\nbad\nG0 X0\n%", 0);
        let summary = free.summary(&free);
        assert_eq!((summary.errors, summary.complete), (1, true));
    }

    /// A dwell of a thousand years is skipped; a dwell beyond the range of the clock ends the job.
    #[test]
    fn long_dwells_take_no_time_of_the_host() {
        for baud in [0, 9600] {
            let long = streamed("G4 P31557600000\nG0 X1\n", baud);
            assert!(long.summary(&long).complete && long.summary(&long).forecast_s > 31_557_600_000.0);
            let endless = streamed("G4 P900000000000\nG0 X1\n", baud);
            assert!(!endless.summary(&endless).complete);
        }
    }

    #[test]
    fn a_link_carries_its_rate() {
        let mut credit = 0;
        let sum: usize = (0..1000).map(|_| carried(115_200, &mut credit, 1 << 20)).sum();
        assert_eq!(sum, 11_520);
        assert_eq!(carried(115_200, &mut credit, 0), 0);
        assert!(credit < BYTE, "nothing is saved up");
    }
}
