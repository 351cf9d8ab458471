//! Writes a recording: `Recorder` writes each input as a line, and the state of the machine when it has changed.
//! `RecordedJob` passes the lines of a job on and records them.

use super::entry::{Input, TITLE, place, traced};
use crate::simulator::Simulator;
use std::cell::RefCell;
use std::fmt::Write as _;
use std::io::{self, BufRead, Read, Write};
use std::rc::Rc;

/// Writes a recording while the machine runs. The caller reports each input before it passes the input to the
/// simulator.
pub struct Recorder {
    /// Bytes of the recording that have not been written to `out` yet.
    held: Vec<u8>,
    out: Option<Box<dyn Write>>,
    begin: u64,
    last: String,
    /// Tick before which [`Recorder::time_passed`] does nothing.
    next_look: u64,
}

impl Recorder {
    /// Begins the recording of a simulator that has just been powered up. `machine`: the text of its machine
    /// description. The recording stays in memory until [`Recorder::write_to`] is called. So the caller can keep an
    /// older recording in the file until the machine has started successfully.
    pub fn begin(simulator: &mut Simulator, machine: &str) -> Self {
        let (board, now) = (*simulator.board(), simulator.clock().now());
        let mut head = format!("{TITLE}\nboard {} {}\n", board.name, board.step_clock_hz);
        for record in simulator.store_mut().records() {
            let _ = write!(head, "record {} ", record.key);
            for byte in &record.value {
                let _ = write!(head, "{byte:02x}");
            }
            head.push('\n');
        }
        for line in machine.lines() {
            let _ = writeln!(head, "machine {line}");
        }
        let _ = writeln!(head, "begin {now}");
        Self { held: head.into_bytes(), out: None, begin: now, last: place(simulator), next_look: now }
    }

    /// Writes everything recorded so far to `out`, and from now on each further entry.
    ///
    /// # Errors
    /// If writing fails.
    pub fn write_to(&mut self, out: Box<dyn Write>) -> io::Result<()> {
        self.out = Some(out);
        self.pass_on()?;
        self.flush()
    }

    fn pass_on(&mut self) -> io::Result<()> {
        if let Some(out) = &mut self.out {
            out.write_all(&self.held)?;
            self.held.clear();
        }
        Ok(())
    }

    fn flush(&mut self) -> io::Result<()> {
        self.out.as_mut().map_or(Ok(()), |out| out.flush())
    }

    /// Records an input at the present time. If the state of the machine has changed, records the state first. Ignores
    /// entries that only a board records.
    ///
    /// # Errors
    /// If writing fails.
    pub fn input(&mut self, simulator: &Simulator, input: &Input) -> io::Result<()> {
        self.look(simulator)?;
        match input {
            Input::Connect => self.write(simulator, "connect"),
            Input::Disconnect => self.write(simulator, "disconnect"),
            Input::Host(bytes) => self.write(simulator, &format!("host {}", bytes.escape_ascii())),
            Input::Pin(line) => self.write(simulator, &format!("pin {}", line.trim())),
            Input::At(place) => self.write(simulator, &format!("at {place}")),
            Input::Job => self.write(simulator, "job"),
            Input::Report(_) => Ok(()),
        }
    }

    /// Writes a line with the present time and flushes it, so that it survives any end of the program.
    fn write(&mut self, simulator: &Simulator, text: &str) -> io::Result<()> {
        self.held.extend(format!("{} {text}\n", simulator.clock().now()).into_bytes());
        self.pass_on()?;
        self.flush()
    }

    /// Call often as time passes. Records the state of the machine if it has changed, at most once per second of
    /// machine time.
    ///
    /// # Errors
    /// If writing fails.
    pub fn time_passed(&mut self, simulator: &Simulator) -> io::Result<()> {
        let now = simulator.clock().now();
        if now < self.next_look {
            return Ok(());
        }
        self.next_look = now + u64::from(simulator.board().step_clock_hz);
        self.look(simulator)
    }

    /// Records the state of the machine if it has changed.
    ///
    /// # Errors
    /// If writing fails.
    pub fn look(&mut self, simulator: &Simulator) -> io::Result<()> {
        let here = place(simulator);
        if here != self.last {
            self.write(simulator, &format!("at {}", traced(simulator, self.begin)))?;
            self.last = here;
        }
        Ok(())
    }

    /// Records a line of a job, with its line end and without a time.
    ///
    /// # Errors
    /// If writing fails.
    pub fn job_line(&mut self, line: &[u8]) -> io::Result<()> {
        self.held.extend(format!("job {}\n", line.escape_ascii()).into_bytes());
        self.pass_on()
    }

    /// Records the final state of the machine.
    ///
    /// # Errors
    /// If writing fails.
    pub fn end(&mut self, simulator: &Simulator) -> io::Result<()> {
        self.write(simulator, &format!("at {}", traced(simulator, self.begin)))
    }
}

/// A job that is recorded while it is read.
pub struct RecordedJob<R> {
    reader: R,
    recorder: Rc<RefCell<Recorder>>,
    line: Vec<u8>,
    failed: Option<io::Error>,
}

impl<R: BufRead> RecordedJob<R> {
    /// Wraps the reader of a job.
    pub fn new(reader: R, recorder: Rc<RefCell<Recorder>>) -> Self {
        Self { reader, recorder, line: Vec::new(), failed: None }
    }

    fn write_line(&mut self) {
        let line = std::mem::take(&mut self.line);
        if let Err(error) = self.recorder.borrow_mut().job_line(&line) {
            self.failed.get_or_insert(error);
        }
    }
}

impl<R: BufRead> Read for RecordedJob<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.fill_buf()?.read(buffer)?;
        self.consume(count);
        Ok(count)
    }
}

impl<R: BufRead> BufRead for RecordedJob<R> {
    fn fill_buf(&mut self) -> io::Result<&[u8]> {
        if let Some(error) = self.failed.take() {
            return Err(io::Error::other(format!("the recording cannot be written: {error}")));
        }
        if self.reader.fill_buf()?.is_empty() && !self.line.is_empty() {
            self.write_line();
        }
        self.reader.fill_buf()
    }

    fn consume(&mut self, count: usize) {
        let bytes = self.reader.fill_buf().map_or_else(|_| Vec::new(), |bytes| bytes[..count].to_vec());
        for byte in bytes {
            self.line.push(byte);
            if byte == b'\n' {
                self.write_line();
            }
        }
        self.reader.consume(count);
    }
}
