//! The time of a job by tool: feed, rapids, dwells and spin-up. Also lists the lines that take longer than an hour.

use serde::Serialize;

/// Times of one tool.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ToolTime {
    /// The tool number of M6; 0 for the time before the first M6.
    pub tool: u32,
    /// Time of all moves except rapids, in seconds.
    pub feed_s: f64,
    /// Time of rapids, in seconds.
    pub rapid_s: f64,
    /// Time of G4 and of the dwells of canned cycles, in seconds.
    pub dwell_s: f64,
    /// Time in which the machine waits for the spindle to spin up (`$394`) or to stop (`$539`), in seconds.
    pub spin_up_s: f64,
}

/// A line is listed if it takes longer than this time, in seconds.
const LONG: f64 = 3600.0;

/// The times of all tools in the order of use, and of the line in progress.
#[derive(Clone, Debug, Default)]
pub struct Times {
    tools: Vec<ToolTime>,
    line: u32,
    line_s: f64,
    /// The lines before `line` that took longer than [`LONG`]: line number and time in seconds.
    long: Vec<(u32, f64)>,
}

impl Times {
    /// Returns the row of a tool; creates it if needed.
    pub fn of(&mut self, tool: u32) -> &mut ToolTime {
        // The tool in use is usually the last one in the list.
        let at = self.tools.iter().rposition(|row| row.tool == tool).unwrap_or_else(|| {
            self.tools.push(ToolTime { tool, ..ToolTime::default() });
            self.tools.len() - 1
        });
        &mut self.tools[at]
    }

    /// Adds to the time of a line (as the controller counts lines). All times of a line must be added before those of
    /// the next line.
    pub fn add_to_line(&mut self, line: u32, seconds: f64) {
        if line != self.line {
            self.long.extend(self.long_line());
            (self.line, self.line_s) = (line, 0.0);
        }
        self.line_s += seconds;
    }

    /// Returns the lines that take longer than an hour, with their times in seconds.
    pub fn long_lines(&self) -> Vec<(u32, f64)> {
        self.long.iter().copied().chain(self.long_line()).collect()
    }

    fn long_line(&self) -> Option<(u32, f64)> {
        (self.line_s > LONG).then_some((self.line, self.line_s))
    }

    /// Returns the rows of the tools that took time.
    pub fn rows(&self) -> Vec<ToolTime> {
        self.tools.iter().filter(|row| row.feed_s + row.rapid_s + row.dwell_s + row.spin_up_s > 0.0).cloned().collect()
    }

    /// Returns the times of all tools added up, with tool number 0.
    pub fn sum(&self) -> ToolTime {
        self.tools.iter().fold(ToolTime::default(), |sum, row| ToolTime {
            tool: 0,
            feed_s: sum.feed_s + row.feed_s,
            rapid_s: sum.rapid_s + row.rapid_s,
            dwell_s: sum.dwell_s + row.dwell_s,
            spin_up_s: sum.spin_up_s + row.spin_up_s,
        })
    }
}
