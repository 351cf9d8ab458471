//! Trace of the step outputs, event by event. It always keeps digests (running hashes of the events). On request, it
//! also writes a row per event into a CSV file, or keeps the events in memory.

use oxmill_controller::axes::{Axis, LINEAR};
use oxmill_controller::digest::Digest;
use oxmill_controller::messages::{SlowOutputs, SpindleDirection};
use std::io::{self, BufWriter, Write};

use crate::boards::AXES;

/// One step event: the step outputs that rose together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StepRecord {
    /// Virtual time in step-clock ticks since power-up.
    pub at: u64,
    /// Total time in motion up to this event, in ticks of the step clock. Times at rest do not count. The digest uses
    /// this time, not `at`.
    pub busy: u64,
    /// Axes that stepped; bit 0 is X.
    pub steps: u8,
    /// Axes whose direction is negative; bit 0 is X.
    pub directions: u8,
    /// Step counters of X, Y and Z after the step.
    pub position: [i32; LINEAR],
    /// Step counter of A after the step.
    pub rotary: [i32; AXES - LINEAR],
}

/// An optional value that is not cloned with its owner: the clone has `None`. Used for values that can have only one
/// reader or writer, such as a file.
#[derive(Debug)]
pub struct Sole<T>(pub Option<T>);

impl<T> Clone for Sole<T> {
    fn clone(&self) -> Self {
        Sole(None)
    }
}

impl<T> Default for Sole<T> {
    fn default() -> Self {
        Sole(None)
    }
}

/// Records the step outputs: as digests and, on request, as a CSV file or a list.
#[derive(Clone, Debug, Default)]
pub struct Trace {
    digest: Digest,
    events: u64,
    first: Option<StepRecord>,
    last: Option<StepRecord>,
    csv: Sole<Csv>,
    list: Option<Vec<StepRecord>>,
    segments: Vec<u64>,
    history: History,
}

/// A running hash over the times of all steps, and over all changes of the outputs with their times.
#[derive(Clone, Debug, Default)]
struct History {
    hash: u64,
    shown: Option<(SlowOutputs, u16)>,
}

impl History {
    fn add(&mut self, word: u64) {
        self.hash = hash([self.hash, word]);
    }

    fn outputs(&mut self, at: u64, outputs: &SlowOutputs, power: u16) {
        let shown = Some((*outputs, power));
        if shown == self.shown {
            return;
        }
        self.shown = shown;
        let SlowOutputs { spindle, coolant, drivers, digital, .. } = outputs;
        let switches = [*spindle == SpindleDirection::Clockwise, *spindle == SpindleDirection::CounterClockwise];
        let switches = switches.into_iter().chain([coolant.flood, coolant.mist, *drivers]);
        let bits = switches.fold(u64::from(*digital), |bits, on| bits << 1 | u64::from(on));
        self.add(at);
        self.add(bits << 16 | u64::from(power));
    }
}

/// Returns a hash of words (FNV-1a).
pub fn hash(words: impl IntoIterator<Item = u64>) -> u64 {
    words.into_iter().fold(0xCBF2_9CE4_8422_2325, |hash, word| (hash ^ word).wrapping_mul(0x0000_0100_0000_01B3))
}

impl Trace {
    /// Also writes a row for each step event from now on into this CSV file.
    pub fn write_csv(&mut self, csv: Csv) {
        self.csv = Sole(Some(csv));
    }

    /// Also keeps every step event from now on in memory.
    pub fn keep(&mut self) {
        self.list = Some(Vec::new());
    }

    /// The kept step events; empty unless [`Trace::keep`] was called.
    pub fn kept(&self) -> &[StepRecord] {
        self.list.as_deref().unwrap_or(&[])
    }

    /// Call when the step task starts a segment, at the tick `at` of the virtual clock.
    #[inline]
    pub fn segment(&mut self, at: u64) {
        if self.list.is_some() {
            self.segments.push(at);
        }
    }

    /// Start ticks of the segments whose step events were kept.
    pub fn segments(&self) -> &[u64] {
        &self.segments
    }

    /// Clears counts, digests and kept events: a new trace begins.
    pub fn restart(&mut self) {
        self.digest = Digest::default();
        self.events = 0;
        self.first = None;
        self.last = None;
        if let Some(list) = &mut self.list {
            list.clear();
        }
        self.segments.clear();
        self.history = History::default();
    }

    /// Records one step event: the step outputs that rise at one tick.
    #[inline]
    pub fn step(&mut self, record: StepRecord) {
        self.digest.add(record.busy, record.steps, record.directions);
        self.history.add(record.at);
        self.events += 1;
        if self.first.is_none() {
            self.first = Some(record);
        }
        self.last = Some(record);
        if let Some(csv) = &mut self.csv.0 {
            csv.write_row(&record);
        }
        if let Some(list) = &mut self.list {
            list.push(record);
        }
    }

    /// Records the spindle and coolant outputs from the tick `at` of the virtual clock on; `power` is 0 to 65535.
    pub fn outputs(&mut self, at: u64, outputs: &SlowOutputs, power: u16) {
        self.history.outputs(at, outputs, power);
        if let Some(csv) = &mut self.csv.0 {
            csv.outputs(outputs, power);
        }
    }

    /// Returns the digests of the steps since the start or the last [`Trace::restart`].
    pub fn digest(&self) -> &Digest {
        &self.digest
    }

    /// Hash of the virtual times of all steps and output changes, and of the new output values.
    pub fn history(&self) -> u64 {
        self.history.hash
    }

    /// Returns the number of step events since the start or the last [`Trace::restart`].
    pub fn events(&self) -> u64 {
        self.events
    }

    /// Number of ticks from the first to the last step event.
    pub fn duration(&self) -> u64 {
        match (self.first, self.last) {
            (Some(first), Some(last)) => last.at - first.at,
            _ => 0,
        }
    }

    /// Closes the CSV file, if there is one. Returns the first error that occurred while it was written.
    pub fn finish(&mut self) -> io::Result<()> {
        self.csv.0.take().map_or(Ok(()), Csv::finish)
    }
}

/// The CSV file. Its last columns are spindle, power, coolant and the digital outputs of the program (a bit mask, bit
/// 0 is P0). If any of the four has changed, the next row gives the values of all four. In all other rows these
/// columns are empty.
pub struct Csv {
    out: BufWriter<Box<dyn Write>>,
    hz: u64,
    origin: u64,
    axes: usize,
    row: Vec<u8>,
    shown: Option<(SlowOutputs, u16)>,
    current: Option<(SlowOutputs, u16)>,
    failed: Option<io::Error>,
}

impl std::fmt::Debug for Csv {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Csv").field("hz", &self.hz).field("origin", &self.origin).finish_non_exhaustive()
    }
}

impl Csv {
    /// Writes the header into an empty file. `hz`: step clock; `origin`: the tick at which `t_s` is 0; `axes`: number
    /// of axes, each with a column.
    ///
    /// # Errors
    /// If writing fails.
    pub fn new(file: impl Write + 'static, hz: u32, origin: u64, axes: usize) -> io::Result<Self> {
        let mut out = BufWriter::with_capacity(1 << 18, Box::new(file) as Box<dyn Write>);
        write!(out, "t_s")?;
        for axis in Axis::ALL.iter().take(axes) {
            write!(out, ",{}", char::from(axis.letter().to_ascii_lowercase()))?;
        }
        writeln!(out, ",spindle,power,coolant,outputs")?;
        let row = Vec::with_capacity(64);
        Ok(Self { out, hz: u64::from(hz), origin, axes, row, shown: None, current: None, failed: None })
    }

    fn outputs(&mut self, outputs: &SlowOutputs, power: u16) {
        self.current = Some((*outputs, power));
    }

    fn write_row(&mut self, record: &StepRecord) {
        if self.failed.is_some() {
            return;
        }
        let ticks = record.at.saturating_sub(self.origin);
        let nanoseconds = (ticks % self.hz) * 1_000_000_000 / self.hz;
        self.row.clear();
        push_number(&mut self.row, ticks / self.hz, 1);
        self.row.push(b'.');
        push_number(&mut self.row, nanoseconds, 9);
        for steps in record.position.into_iter().chain(record.rotary).take(self.axes) {
            self.row.push(b',');
            if steps < 0 {
                self.row.push(b'-');
            }
            push_number(&mut self.row, u64::from(steps.unsigned_abs()), 1);
        }
        if self.current == self.shown {
            self.row.extend_from_slice(b",,,,\n");
        } else if let Some((outputs, power)) = self.current {
            let spindle = match outputs.spindle {
                SpindleDirection::Off => "off",
                SpindleDirection::Clockwise => "cw",
                SpindleDirection::CounterClockwise => "ccw",
            };
            let coolant = match (outputs.coolant.flood, outputs.coolant.mist) {
                (false, false) => "off",
                (true, false) => "flood",
                (false, true) => "mist",
                (true, true) => "flood+mist",
            };
            let power = f64::from(power) / f64::from(u16::MAX);
            self.row.extend_from_slice(format!(",{spindle},{power:.4},{coolant},{}\n", outputs.digital).as_bytes());
            self.shown = self.current;
        }
        self.failed = self.out.write_all(&self.row).err();
    }

    fn finish(mut self) -> io::Result<()> {
        match self.failed.take() {
            Some(error) => Err(error),
            None => self.out.flush(),
        }
    }
}

/// Appends an integer in decimal, with zeros in front up to `width` digits. Formatting the rows takes most of the time
/// for a trace, and `write!` would take several times as long.
fn push_number(row: &mut Vec<u8>, mut value: u64, width: usize) {
    let mut digits = [b'0'; 20];
    let mut start = digits.len();
    while value > 0 || digits.len() - start < width {
        start -= 1;
        digits[start] = b'0' + (value % 10) as u8;
        value /= 10;
    }
    row.extend_from_slice(&digits[start..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use oxmill_controller::messages::Coolant;
    use oxmill_test_support::Folder;
    use std::fs::File;

    fn step(at: u64, position: [i32; LINEAR]) -> StepRecord {
        StepRecord { at, busy: at, steps: 1, directions: 0, position, rotary: [0] }
    }

    #[test]
    fn rows_are_times_positions_and_changed_outputs() {
        let folder = Folder::new();
        let path = folder.path().join("t.csv");
        let mut trace = Trace::default();
        trace.write_csv(Csv::new(File::create(&path).unwrap(), 1_000_000, 500, 3).unwrap());
        trace.step(step(500, [1, 0, 0]));
        let outputs = SlowOutputs {
            spindle: SpindleDirection::Clockwise,
            power: 65535,
            power_from_segments: false,
            coolant: Coolant { flood: true, mist: false },
            drivers: true,
            digital: 5,
        };
        trace.outputs(600, &outputs, 65535);
        trace.step(step(1_000_501, [2, -10, 0]));
        trace.step(step(61_000_500, [-2147483648, 0, 0]));
        trace.finish().unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let rows: Vec<&str> = text.lines().collect();
        assert_eq!(
            rows,
            [
                "t_s,x,y,z,spindle,power,coolant,outputs",
                "0.000000000,1,0,0,,,,",
                "1.000001000,2,-10,0,cw,1.0000,flood,5",
                "61.000000000,-2147483648,0,0,,,,",
            ]
        );
        assert_eq!((trace.events(), trace.duration()), (3, 61_000_000));
    }

    #[test]
    fn each_moment_and_each_output_is_in_the_history() {
        const OFF: SlowOutputs = SlowOutputs {
            spindle: SpindleDirection::Off,
            power: 0,
            power_from_segments: false,
            coolant: Coolant { flood: false, mist: false },
            drivers: false,
            digital: 0,
        };
        let history = |steps: u64, at: u64, outputs: &SlowOutputs, power: u16| {
            let mut trace = Trace::default();
            trace.outputs(1, &OFF, 0);
            trace.step(step(steps, [1, 0, 0]));
            trace.outputs(at, outputs, power);
            trace.outputs(at + 1, outputs, power);
            trace.history()
        };
        let all = [
            history(5, 9, &OFF, 0),
            history(6, 9, &OFF, 0),
            history(5, 9, &OFF, 1),
            history(5, 10, &OFF, 1),
            history(5, 9, &SlowOutputs { spindle: SpindleDirection::Clockwise, ..OFF }, 0),
            history(5, 9, &SlowOutputs { spindle: SpindleDirection::CounterClockwise, ..OFF }, 0),
            history(5, 9, &SlowOutputs { coolant: Coolant { flood: true, mist: false }, ..OFF }, 0),
            history(5, 9, &SlowOutputs { coolant: Coolant { flood: false, mist: true }, ..OFF }, 0),
            history(5, 9, &SlowOutputs { drivers: true, ..OFF }, 0),
            history(5, 9, &SlowOutputs { digital: 1, ..OFF }, 0),
        ];
        for (n, one) in all.iter().enumerate() {
            assert!(!all[..n].contains(one), "{n}");
        }
        assert_eq!(history(5, 9, &OFF, 0), history(5, 90, &OFF, 0), "nothing has changed");
    }

    #[test]
    fn a_restarted_trace_is_as_new() {
        let mut trace = Trace::default();
        trace.keep();
        trace.step(step(1, [1, 0, 0]));
        trace.restart();
        assert_eq!((trace.events(), trace.duration(), trace.kept().len()), (0, 0, 0));
        assert_eq!(*trace.digest(), Digest::default());
    }
}
