//! The time of a job by tool and by kind: a row (`ToolTime`) of seconds at feed, in rapids, dwelling and waiting for
//! the spindle to spin up.

use serde::Serialize;

/// What a tool took.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct ToolTime {
    /// The number of M6; 0 for what came before any.
    pub tool: u32,
    /// Moves that are no rapids, s.
    pub feed_s: f64,
    /// Rapids, s.
    pub rapid_s: f64,
    /// G4, and the dwells of canned cycles, s.
    pub dwell_s: f64,
    /// Waiting for the spindle: `$394`, `$539`, s.
    pub spin_up_s: f64,
}

/// The times of all tools, in the order in which they came.
#[derive(Clone, Debug, Default)]
pub struct Times(Vec<ToolTime>);

impl Times {
    /// The row of a tool.
    pub fn of(&mut self, tool: u32) -> &mut ToolTime {
        // The tool that is in use was mostly the last.
        let at = self.0.iter().rposition(|row| row.tool == tool).unwrap_or_else(|| {
            self.0.push(ToolTime { tool, ..ToolTime::default() });
            self.0.len() - 1
        });
        &mut self.0[at]
    }

    /// The rows of the tools that took time.
    pub fn rows(&self) -> Vec<ToolTime> {
        self.0.iter().filter(|row| row.feed_s + row.rapid_s + row.dwell_s + row.spin_up_s > 0.0).cloned().collect()
    }

    /// All of them together.
    pub fn sum(&self) -> ToolTime {
        self.0.iter().fold(ToolTime::default(), |sum, row| ToolTime {
            tool: 0,
            feed_s: sum.feed_s + row.feed_s,
            rapid_s: sum.rapid_s + row.rapid_s,
            dwell_s: sum.dwell_s + row.dwell_s,
            spin_up_s: sum.spin_up_s + row.spin_up_s,
        })
    }
}
