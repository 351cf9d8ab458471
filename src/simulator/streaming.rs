//! Forecasts a job over a serial link: how long it takes with a sender that counts characters at a baud rate, and at
//! which lines the machine waits for bytes. Compared with the same job over a link without limit.
//!
//! The sender counts characters: it sends a line as long as what the controller has not answered, with it, fits into the
//! receive buffer. Answers need their time on the way back, too. Time passes in slices of a millisecond.

use crate::machine::linear;
use crate::path::Drawing;
use crate::simulator::Simulator;
use serde::Serialize;
use std::collections::{BTreeMap, VecDeque};
use std::time::Duration;

/// A slice of time.
const SLICE: Duration = Duration::from_millis(1);
/// Slices in a second, times the bits on the wire for a byte: start, eight data bits, stop.
const BYTE: u64 = 1000 * 10;
/// A lag that has grown by less than this between two lines is left out of account, in seconds: it is the slices'.
const NOTICEABLE: f64 = 0.005;
/// Places that are listed.
const MOST_PLACES: usize = 20;

/// A line at which the machine lost time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Lost {
    /// Number of the line in the text sent, from 1.
    pub line: u64,
    /// How much later it ended than the lines before it had let expect, in seconds.
    pub seconds: f64,
}

/// What became of a job that was sent.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Streamed {
    /// Bits per second of the link; 0 for one without limit.
    pub baud: u32,
    /// From the first byte sent to rest, in seconds.
    pub forecast_s: f64,
    /// Whether every line was answered and the machine came to rest.
    pub complete: bool,
    /// Lines that were answered with an error.
    pub errors: u64,
    /// Where most time was lost against a link without limit, the worst first.
    pub lost: Vec<Lost>,
}

/// A job that is being sent.
pub struct Streaming {
    simulator: Simulator,
    baud: u32,
    origin: u64,
    lines_before: u32,
    waiting: VecDeque<Vec<u8>>,
    /// Lengths of the lines that have been sent and not answered.
    in_flight: VecDeque<usize>,
    /// Bytes of the lines that the sender has handed to the link.
    outgoing: VecDeque<u8>,
    /// Bytes that the link may still carry in this slice, and what it carries back.
    credit: u64,
    returning: VecDeque<u8>,
    answer: Vec<u8>,
    credit_back: u64,
    errors: u64,
    done: bool,
}

impl Streaming {
    /// Begins to send a text to a simulator that is idle, at so many bits per second; 0 for a link without limit.
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

    /// Lets so many milliseconds of the machine pass. Whether the job has come to its end.
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
            self.hear_answer(byte);
        }
        let answered = self.waiting.is_empty() && self.in_flight.is_empty();
        let stuck = !self.simulator.is_active() && self.outgoing.is_empty() && self.returning.is_empty();
        self.done = answered && self.simulator.is_idle() || stuck && !self.in_flight.is_empty();
    }

    /// A dwell may last for years.
    fn pass_slices_without_event(&mut self) {
        let slice = self.simulator.clock().ticks_in(SLICE);
        let slices = self.simulator.ticks_without_event() / slice;
        self.simulator.advance_to(self.simulator.clock().now() + slices * slice);
        for credit in [&mut self.credit, &mut self.credit_back] {
            *credit = (*credit + slices % BYTE * u64::from(self.baud)) % BYTE;
        }
    }

    fn hear_answer(&mut self, byte: u8) {
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

    /// Lines that have been answered, of how many.
    pub fn progress(&self) -> (u64, u64) {
        let left = (self.waiting.len() + self.in_flight.len()) as u64;
        let read = u64::from(self.simulator.controller().lines_read().wrapping_sub(self.lines_before));
        (read, read.max(1) + left)
    }

    /// When each line of the text ended, in seconds from the first byte.
    fn ends(&self) -> BTreeMap<u32, f64> {
        let points = self.simulator.meter().drawing().map_or(&[][..], Drawing::points);
        points.iter().map(|point| (point.mark.line.wrapping_sub(self.lines_before), point.seconds[1])).collect()
    }

    /// What became of it, compared with the same job over a link without limit.
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

/// How many of the waiting bytes a link carries in a slice.
fn carried(baud: u32, credit: &mut u64, waiting: usize) -> usize {
    if baud == 0 {
        return waiting;
    }
    *credit += u64::from(baud);
    let carried = usize::try_from(*credit / BYTE).unwrap_or(waiting).min(waiting);
    // An idle link saves nothing up but the part of a byte that is under way.
    *credit = if carried < waiting { *credit - carried as u64 * BYTE } else { *credit % BYTE };
    carried
}

/// The lines as a sender sends them: without tape marks, and without what would be a realtime command.
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

    /// Moves of 0.1 mm at 6000 mm/min: a thousand lines of 17 bytes in a second.
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
        // 8 kB at 1920 bytes a second.
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

    /// One of a thousand years is passed at once, and one that is longer than the clock runs ends it.
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
