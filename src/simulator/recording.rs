//! What came into a simulated machine, with its time, as text: `Recorder` writes it and, at each rest, where the
//! machine is; `Recording` reads it back, plays it into another simulator, and compares where that arrives. It also
//! reads what a board has listed by `$REC`.
//!
//! ```text
//! oxmill recording 1
//! board desk 1000000                      name, ticks of the step clock in a second
//! record 100 00007a43                     each stored record: key, value
//! machine [[switch]]                      each line of the machine's description, if it has one
//! begin 1500000                           virtual time, in ticks of the step clock, at which the recording begins
//! 1512000 connect                         a host has opened the port; `disconnect`: closed it
//! 1530000 host G1 X10 F600\n              bytes of the host, escaped as in Rust
//! 1600000 pin door 1                      a line of the pin protocol
//! 1600000 at 80 0 0 9d53b4ab5f4e1c2a alarm 0 trusted cw 32896 flood
//!                                         position of the motors, hash of all steps in their order; alarm and
//!                                         outputs, the spindle's power from 0 to 65535
//! 1700000 job                             a job begins that no host sends: it is taken as fast as the controller likes
//! job G0 X1\n                             each line of it
//! ```
//! A board lists what it has recorded by `$REC`, each line as `[REC:...]`; in a log of a terminal all other lines are left out, and of several
//! listings the last one counts. It has other lines besides, which `protocol::recorded` of the controller writes and [`crate::board_replay`] plays.
//!
//! Lines begin with their time but for those in front of `begin` and those of a job.
//!
//! Names: What came into a simulated machine, with its time, as text under a `TITLE`. `Recorder` writes each `Input` as
//! a line to an `io::Write` (host bytes escaped, pins, connect, disconnect, the job: `RecordedJob`, a `BufRead` with
//! `fill_buf` and `consume`, writes each `job_line` that was read) and, at rest (`next_look`), where the machine is:
//! counters, hash, and words for what is on (drivers, cw, flood). `Recording` reads such text by `parse_line` and
//! `parse_time` (`split_once`, `from_str_radix`, `bytes_of_hex`, `number`), or what a board has listed: `Told`, with
//! what it has `Noted` (`Stopping`, `standing`; "these are too many axes"). It plays that into a
//! `simulator: &mut Simulator` that was powered up the same, while `hear` takes what it says; `here` it must arrive at
//! the same place, with the same hash (`agrees`, `compare_end`, `NOTHING_COMPARED`). A recording read from a file may
//! be `broken_off`; its `Fittings` are parsed from text, and an answer that begins with `error` counts (`hear_all`,
//! `compares`).

use crate::boards::{AXES, Board};
use crate::files::without_mark;
use crate::fittings::Fittings;
use crate::power_up::board_named;
use crate::simulator::{Options, Simulator};
use crate::store::Store;
use oxmill_controller::axes::LINEAR;
use oxmill_controller::messages::{Noted, Record, SpindleDirection, Standing, Stopping, Store as Change};
use oxmill_controller::units::Coordinate;
use std::cell::RefCell;
use std::fmt::Write as _;
use std::io::{self, BufRead, Read, Write};
use std::rc::Rc;

/// Why a replay that has not parted from its recording is not told to be the same.
pub(crate) const NOTHING_COMPARED: &str = "nothing in it tells where the motors were, so nothing has been compared";
/// How long a recording may be, s: 100 days.
const LONGEST: u64 = 100 * 24 * 3600;

/// The first line.
const TITLE: &str = "oxmill recording 1";

/// What comes in, or is to be compared.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Input {
    /// A host has opened the port.
    Connect,
    /// A host has closed the port.
    Disconnect,
    /// Bytes of the host.
    Host(Vec<u8>),
    /// A line of the pin protocol.
    Pin(String),
    /// Where the motors were, the hash of all steps, the alarm and the outputs.
    At(String),
    /// A job begins.
    Job,
    /// What only a board tells.
    Told(Told),
}

/// What only a board tells.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(clippy::large_enum_variant, reason = "few of them, and read once")]
pub enum Told {
    /// An entry of its ring.
    Noted(Noted),
    /// How it ended.
    Ended {
        /// As it is written.
        text: String,
        /// In a failure.
        crash: bool,
        /// Machine position in micrometres.
        place: Vec<i64>,
        /// N word.
        line: u32,
    },
}

/// A recording that has been read.
#[derive(Clone, Debug)]
pub struct Recording {
    board: Board,
    records: Vec<Record>,
    machine: String,
    begin: Option<u64>,
    inputs: Vec<(u64, Input)>,
    /// The text of its job.
    job: Option<Vec<u8>>,
    /// It was not listed to its end.
    broken_off: bool,
}

/// Where a machine is: what two runs are compared by.
fn place(simulator: &Simulator) -> String {
    // A that has never turned is not told of, so that recordings of three axes stay what they are.
    let position = simulator.machine().motors();
    let axes = if simulator.machine().motor_pulses()[LINEAR..] == [0; AXES - LINEAR] { LINEAR } else { AXES };
    let places: String = position[..axes].iter().map(|steps| format!("{steps} ")).collect();
    format!("{places}{:016x} {}", simulator.trace().digest().order_hash(), state(simulator))
}

/// What else two runs are compared by: the alarm, what is known of the position, and the outputs.
fn state(simulator: &Simulator) -> String {
    let controller = simulator.controller();
    let mut words = format!("alarm {}", controller.alarm().map_or(0, |alarm| alarm.code()));
    let mut word = |of: &str, holds: bool| {
        if holds {
            words.push(' ');
            words.push_str(of);
        }
    };
    word("trusted", controller.is_trusted());
    word("paused", controller.is_paused());
    let Some(outputs) = simulator.outputs() else { return words };
    word("drivers", outputs.drivers);
    word(&format!("cw {}", outputs.power), outputs.spindle == SpindleDirection::Clockwise);
    word(&format!("ccw {}", outputs.power), outputs.spindle == SpindleDirection::CounterClockwise);
    word("flood", outputs.coolant.flood);
    word("mist", outputs.coolant.mist);
    word(&format!("pins {:02x}", outputs.digital), outputs.digital != 0);
    words
}

/// Whether a machine is where it was recorded. Recordings of older versions have no more than the motors.
fn agrees(recorded: &str, here: &str) -> bool {
    here.strip_prefix(recorded).is_some_and(|rest| rest.is_empty() || rest.starts_with(" alarm "))
}

/// Writes a recording while it happens.
pub struct Recorder {
    /// What is not written yet.
    held: Vec<u8>,
    out: Option<Box<dyn Write>>,
    last: String,
    /// When the place of the machine is looked at again.
    next_look: u64,
}

impl Recorder {
    /// Begins the recording of a simulator that has just been powered up; `machine` describes what is fitted to it. It is kept
    /// in memory until it is told where to write: a file that has an older recording loses it only to a machine that works.
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
        Self { held: head.into_bytes(), out: None, last: place(simulator), next_look: now }
    }

    /// Where it is written from here on, with all that has come in before.
    ///
    /// # Errors
    /// If it cannot be written.
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

    /// Something comes in now.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn input(&mut self, simulator: &Simulator, input: &Input) -> io::Result<()> {
        self.look(simulator)?;
        match input {
            Input::Connect => self.write(simulator, "connect"),
            Input::Disconnect => self.write(simulator, "disconnect"),
            Input::Host(bytes) => self.write(simulator, &format!("host {}", bytes.escape_ascii())),
            Input::Pin(line) => self.write(simulator, &format!("pin {}", line.trim())),
            Input::At(place) => self.write(simulator, &format!("at {place}")),
            Input::Job => self.write(simulator, "job"),
            // Only boards tell that.
            Input::Told(_) => Ok(()),
        }
    }

    /// A line of now. Whatever ends the program, it is there.
    fn write(&mut self, simulator: &Simulator, text: &str) -> io::Result<()> {
        self.held.extend(format!("{} {text}\n", simulator.clock().now()).into_bytes());
        self.pass_on()?;
        self.flush()
    }

    /// Time has passed: where the machine is, once a second of its time.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn time_passed(&mut self, simulator: &Simulator) -> io::Result<()> {
        let now = simulator.clock().now();
        if now < self.next_look {
            return Ok(());
        }
        self.next_look = now + u64::from(simulator.board().step_clock_hz);
        self.look(simulator)
    }

    /// Where the machine is now, if it has moved.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn look(&mut self, simulator: &Simulator) -> io::Result<()> {
        let here = place(simulator);
        if here != self.last {
            self.write(simulator, &format!("at {here}"))?;
            self.last = here;
        }
        Ok(())
    }

    /// A line of a job.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn job_line(&mut self, line: &[u8]) -> io::Result<()> {
        self.held.extend(format!("job {}\n", line.escape_ascii()).into_bytes());
        self.pass_on()
    }

    /// The end: where the machine is.
    ///
    /// # Errors
    /// If it cannot be written.
    pub fn end(&mut self, simulator: &Simulator) -> io::Result<()> {
        let here = place(simulator);
        self.write(simulator, &format!("at {here}"))
    }
}

/// A job that is recorded as it is read.
pub struct RecordedJob<R> {
    reader: R,
    recorder: Rc<RefCell<Recorder>>,
    line: Vec<u8>,
    failed: Option<io::Error>,
}

impl<R: BufRead> RecordedJob<R> {
    /// The job that comes from `reader`.
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

impl Recording {
    /// The text of its job, if it is of one.
    pub fn job(&self) -> Option<&[u8]> {
        self.job.as_deref()
    }

    /// Whether it is of a board.
    pub fn is_of_board(&self) -> bool {
        self.inputs.iter().any(|(_, input)| matches!(input, Input::Told(_)))
    }

    /// What came in, and when.
    pub fn inputs(&self) -> &[(u64, Input)] {
        &self.inputs
    }

    /// Whether it has its end.
    pub fn is_whole(&self) -> bool {
        !self.broken_off
    }

    /// How long it is as far as its last input, or its job: ticks of the step clock.
    pub fn length(&self) -> u64 {
        self.inputs.last().map_or(0, |(time, _)| time.saturating_sub(self.begin.unwrap_or_default()))
    }

    /// Whether there was anything by which two machines are compared.
    ///
    /// # Errors
    /// Nothing tells where the machine was: the recording is not whole.
    pub fn check_compared(&self) -> Result<(), String> {
        let compares = self.inputs.iter().any(|(_, input)| matches!(input, Input::At(_)));
        if compares { Ok(()) } else { Err(NOTHING_COMPARED.into()) }
    }

    /// Whether a machine that has come to the end of the job is where it was in the recording.
    ///
    /// # Errors
    /// Where it is instead.
    pub fn compare_end(&self, simulator: &Simulator) -> Result<(), String> {
        let here = place(simulator);
        match self.inputs.last() {
            Some((_, Input::At(recorded))) if agrees(recorded, &here) => Ok(()),
            Some((_, Input::At(recorded))) => {
                Err(format!("at its end the recording has the machine at {recorded}; here it is at {here}"))
            }
            _ => Err("the recording has no end: nothing can be compared".into()),
        }
    }

    /// Reads a recording.
    ///
    /// # Errors
    /// The number of the first line that cannot be read, and why.
    pub fn parse(text: &str) -> Result<Self, String> {
        if let Some(listed) = listed(text) {
            return Self::read(&listed, true);
        }
        Self::read(without_mark(text), false)
    }

    fn read(text: &str, listed: bool) -> Result<Self, String> {
        // A program that was killed may have written half of its last line.
        let whole = text.rfind('\n').map_or("", |end| &text[..=end]);
        let mut lines = whole.lines().enumerate().map(|(index, line)| (index + 1, line));
        if lines.next().is_none_or(|(_, line)| line != TITLE) {
            return Err(format!("line 1: this is no recording: it does not begin with `{TITLE}`"));
        }
        let mut recording = Self {
            board: crate::boards::DESK,
            records: Vec::new(),
            machine: String::new(),
            begin: None,
            inputs: Vec::new(),
            job: None,
            broken_off: listed,
        };
        for (number, line) in lines.filter(|(_, line)| !line.is_empty()) {
            recording.parse_line(line).map_err(|why| format!("line {number}: {why}"))?;
        }
        Ok(recording)
    }

    /// A time that can be reached, in a few minutes as a replay is some 10,000 times as fast as the machine.
    fn parse_time(&self, text: &str) -> Result<u64, String> {
        let time = number(text)?;
        let last = LONGEST * u64::from(self.board.step_clock_hz);
        if time <= last { Ok(time) } else { Err(format!("`{time}` is later than 100 days")) }
    }

    fn parse_line(&mut self, line: &str) -> Result<(), String> {
        let (word, rest) = line.split_once(' ').unwrap_or((line, ""));
        match word {
            "board" => {
                let (name, hz) = rest.split_once(' ').ok_or("a board has a name and a step clock")?;
                self.board = board_named(name)?;
                self.board.step_clock_hz = number(hz)?;
                if !(100_000..=1_000_000_000).contains(&self.board.step_clock_hz) {
                    return Err(format!("`{hz}` is no step clock"));
                }
            }
            "record" => {
                let (key, value) = rest.split_once(' ').unwrap_or((rest, ""));
                let bytes = bytes_of_hex(value)?;
                let value = heapless::Vec::from_slice(&bytes).map_err(|_| "the record is too long")?;
                self.records.push(Record { key: number(key)?, value });
            }
            "machine" => {
                self.machine.push_str(rest);
                self.machine.push('\n');
            }
            "end" => self.broken_off = false,
            "begin" => self.begin = Some(self.parse_time(rest)?),
            "job" => self.job.get_or_insert_default().extend(unescape(rest)?),
            time => {
                let (word, rest) = rest.split_once(' ').unwrap_or((rest, ""));
                let input = match word {
                    "connect" => Input::Connect,
                    "disconnect" => Input::Disconnect,
                    "host" => Input::Host(unescape(rest)?),
                    "pin" => Input::Pin(rest.into()),
                    "at" => Input::At(rest.into()),
                    "job" => Input::Job,
                    word if let Some(told) = told(word, rest)? => Input::Told(told),
                    _ => return Err(format!("`{line}` is not understood")),
                };
                let time = self.parse_time(time)?;
                let begin = self.begin.ok_or("it comes before `begin`")?;
                if self.inputs.last().map_or(begin, |(before, _)| *before) > time {
                    return Err("it is earlier than the line before".into());
                }
                self.inputs.push((time, input));
            }
        }
        Ok(())
    }

    /// The machine as it was when the recording began.
    ///
    /// # Errors
    /// Why there can be no such machine.
    pub fn power_up(&self) -> Result<Simulator, String> {
        let mut store = Store::in_memory();
        for record in &self.records {
            store.apply(&Change::Put(record.clone())).map_err(|error| error.to_string())?;
        }
        let fittings = match self.machine.as_str() {
            "" => Fittings::default(),
            text => Fittings::parse(text).map_err(|error| format!("{error:#}"))?,
        };
        let mut simulator = Simulator::new(Options { board: self.board, store, fittings, keep_steps: false });
        // As whoever records does before anything comes in: startup lines are carried out.
        simulator.run_until_idle();
        simulator.take_output();
        advance(&mut simulator, self.begin.ok_or("the recording has no `begin`")?, |_| {}, |_| {});
        Ok(simulator)
    }

    /// Plays what came in to a machine that has just been powered up, as far as its job, if it has one; `hear` gets what it says,
    /// and `pass` now and then the time since the begin, ticks of the step clock. Then it is where that begins, or where the recording ends.
    ///
    /// # Errors
    /// Where the machine parts from the recording.
    pub fn play(
        &self,
        simulator: &mut Simulator,
        mut hear: impl FnMut(&str),
        mut pass: impl FnMut(u64),
    ) -> Result<(), String> {
        let begin = self.begin.unwrap_or_default();
        for (time, input) in &self.inputs {
            advance(simulator, *time, &mut hear, |now| pass(now.saturating_sub(begin)));
            match input {
                Input::Job => return Ok(()),
                Input::Told(_) => return Err("lines of a board and of a simulator are mixed".into()),
                Input::Connect => simulator.connect(),
                Input::Disconnect => simulator.disconnect(),
                Input::Host(bytes) => simulator.send(bytes),
                Input::Pin(line) => {
                    let answer = simulator.pin_line(line);
                    if answer.starts_with("error") {
                        return Err(answer);
                    }
                }
                Input::At(recorded) => {
                    let here = place(simulator);
                    if !agrees(recorded, &here) {
                        let seconds = simulator.clock().seconds(time.saturating_sub(begin));
                        return Err(format!(
                            "{seconds:.6} s after its begin the recording has the machine at {recorded}; here it is at {here}"
                        ));
                    }
                }
            }
            hear_all(simulator, &mut hear);
        }
        Ok(())
    }
}

/// The lines of the last listing in a log, and nothing else of it.
fn listed(log: &str) -> Option<String> {
    let lines = log.lines().filter_map(|line| Some(line.split_once("[REC:")?.1.split_once(']')?.0));
    let mut text = None;
    for line in lines {
        if line == TITLE {
            text = Some(String::new());
        }
        if let Some(text) = &mut text {
            text.push_str(line);
            text.push('\n');
        }
    }
    text
}

/// A line that only a board tells.
fn told(word: &str, rest: &str) -> Result<Option<Told>, String> {
    let words: Vec<&str> = rest.split_whitespace().collect();
    let entry = match word {
        "power" => Noted::PowerUp,
        "more" => Noted::More,
        "stored" => Noted::Stored(true),
        "unstored" => Noted::Stored(false),
        "damaged" => Noted::Damaged,
        "cut" => Noted::Cut,
        "inputs" => {
            let word = |at: usize| words.get(at).and_then(|word| u32::from_str_radix(word, 16).ok());
            let (active, tripped) = word(0).zip(word(1)).ok_or_else(|| format!("`{rest}` are no inputs"))?;
            Noted::Inputs { active, tripped }
        }
        "stopped" => Noted::Step(Stopping::AtRest, axes(&words)?),
        "cut-off" => Noted::Step(Stopping::Moving, axes(&words)?),
        "probed" => Noted::Step(Stopping::Probed, axes(&words)?),
        "underrun" => Noted::Step(Stopping::Underrun, axes(&words)?),
        "miscounted" => Noted::Step(Stopping::Miscounted, axes(&words)?),
        "rest" => {
            let (blocks, counters) = words.split_first().ok_or("where is it at rest?")?;
            Noted::Rest { blocks: number(blocks)?, counters: axes(counters)? }
        }
        "state" => standing(&words)?,
        "ended" => return ended(rest, &words).map(Some),
        _ => return Ok(None),
    };
    Ok(Some(Told::Noted(entry)))
}

fn axes(words: &[&str]) -> Result<heapless::Vec<i32, { Standing::AXES }>, String> {
    let axes: Vec<i32> = words.iter().map(|word| number(word)).collect::<Result<_, _>>()?;
    heapless::Vec::from_slice(&axes).map_err(|_| "these are too many axes".into())
}

fn standing(words: &[&str]) -> Result<Noted, String> {
    let [flags, blocks, tool, active, axes @ .., words] = words else { return Err("a state has more words".into()) };
    let (mut counters, mut place) = (heapless::Vec::new(), heapless::Vec::new());
    for pair in axes.chunks(2) {
        let [counter, coordinate] = pair else { return Err("an axis has a counter and a place".into()) };
        counters.push(number(counter)?).map_err(|_| "these are too many axes")?;
        place.push(Coordinate(number(coordinate)?)).map_err(|_| "these are too many axes")?;
    }
    let has = |letter: char| flags.contains(letter);
    let standing = Standing {
        counters,
        place,
        trusted: has('t'),
        locked: has('l'),
        inches: has('i'),
        tool: number(tool)?,
        active: u32::from_str_radix(active, 16).map_err(|_| format!("`{active}` are no inputs"))?,
        words: heapless::Vec::from_slice(words.as_bytes()).map_err(|_| "the words of the state are too long")?,
    };
    Ok(Noted::Standing { standing, blocks: number(blocks)? })
}

/// `panic N12 1.000 2.000 0.000`, or `reset`.
fn ended(text: &str, words: &[&str]) -> Result<Told, String> {
    let text = text.to_owned();
    let [_, line, place @ ..] = words else {
        return Ok(Told::Ended { text, crash: false, place: Vec::new(), line: 0 });
    };
    let line = number(line.trim_start_matches('N'))?;
    let micrometres = |word: &&str| Ok((number::<f64>(word)? * 1e3).round() as i64);
    let place = place.iter().map(micrometres).collect::<Result<_, String>>()?;
    Ok(Told::Ended { text, crash: true, place, line })
}

/// Lets time pass; what the machine says is taken now and then, as by a host.
fn advance(simulator: &mut Simulator, until: u64, mut hear: impl FnMut(&str), mut pass: impl FnMut(u64)) {
    let slice = u64::from(simulator.board().step_clock_hz) / 50;
    while simulator.clock().now() < until {
        simulator.advance_to(until.min(simulator.clock().now() + slice));
        hear_all(simulator, &mut hear);
        pass(simulator.clock().now());
    }
}

/// Takes all that the machine has to say: what it holds back for want of room comes with what is taken.
fn hear_all(simulator: &mut Simulator, hear: &mut impl FnMut(&str)) {
    while simulator.unfetched() > 0 {
        hear(&simulator.take_output());
    }
}

fn number<T: std::str::FromStr>(text: &str) -> Result<T, String> {
    text.trim().parse().map_err(|_| format!("`{text}` is no number that may stand there"))
}

fn bytes_of_hex(text: &str) -> Result<Vec<u8>, String> {
    let digits = text.as_bytes().chunks(2).map(|pair| std::str::from_utf8(pair).unwrap_or_default());
    digits
        .map(|pair| u8::from_str_radix(pair, 16).ok().filter(|_| pair.len() == 2))
        .collect::<Option<Vec<u8>>>()
        .ok_or_else(|| format!("`{text}` is no value of a record"))
}

/// What `escape_ascii` has escaped.
fn unescape(text: &str) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        bytes.push(match byte {
            b'\\' => match rest.next() {
                Some(b'n') => b'\n',
                Some(b'r') => b'\r',
                Some(b't') => b'\t',
                Some(same @ (b'\\' | b'\'' | b'"')) => same,
                Some(b'x') => {
                    let digit = |digit: Option<u8>| char::from(digit?).to_digit(16);
                    let value = digit(rest.next()).zip(digit(rest.next())).map(|(high, low)| high << 4 | low);
                    value.ok_or_else(|| format!("`\\x` in `{text}` lacks its digits"))? as u8
                }
                _ => return Err(format!("`\\` in `{text}` escapes nothing")),
            },
            plain => plain,
        });
    }
    Ok(bytes)
}
