//! Reads a recording line by line: the text written by `Recorder`, or the listing of a board.

use super::entry::{BoardReport, Input, TITLE};
use crate::boards::Board;
use crate::files::without_mark;
use crate::power_up::board_named;
use oxmill_controller::messages::{Noted, Record, Standing, Stopping};
use oxmill_controller::units::Coordinate;

/// Maximum duration of a recording, in seconds: 100 days.
const LONGEST: u64 = 100 * 24 * 3600;

/// A recording that has been read: the machine at the beginning, the inputs with their times, and the job.
#[derive(Clone, Debug)]
pub struct Recording {
    pub(super) board: Board,
    pub(super) records: Vec<Record>,
    pub(super) machine: String,
    pub(super) begin: Option<u64>,
    pub(super) inputs: Vec<(u64, Input)>,
    /// The text of the recorded job.
    pub(super) job: Option<Vec<u8>>,
    /// `true` if the listing of a board has no `end` line: its later part is missing.
    pub(super) broken_off: bool,
}

impl Recording {
    /// Reads a recording from its text: a file written by `Recorder`, or a log with the listing of a board.
    ///
    /// # Errors
    /// The number of the first line that cannot be read, and the reason.
    pub fn parse(text: &str) -> Result<Self, String> {
        if let Some(listed) = listed(text) {
            return Self::read(&listed, true);
        }
        Self::read(without_mark(text), false)
    }

    fn read(text: &str, listed: bool) -> Result<Self, String> {
        // Ignore a last line without an end: a killed program can have written only part of it.
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

    /// Parses a time in ticks. A time after 100 days is an error, because a replay (about 10,000 times as fast as the
    /// machine) should reach every time within a quarter of an hour.
    fn parse_time(&self, text: &str) -> Result<u64, String> {
        let time = number(text)?;
        let last = LONGEST * u64::from(self.board.step_clock_hz);
        // The time of a job is not limited, because its replay skips dwells, however long they are.
        if time <= last || self.job.is_some() { Ok(time) } else { Err(format!("`{time}` is later than 100 days")) }
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
                    word if let Some(report) = parse_report(word, rest)? => Input::Report(report),
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
}

/// Returns the lines of the last board listing in a log, without the rest of the log.
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

/// Parses a line that only a board writes; `None` for other lines.
fn parse_report(word: &str, rest: &str) -> Result<Option<BoardReport>, String> {
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
    Ok(Some(BoardReport::Noted(entry)))
}

pub(super) fn axes(words: &[&str]) -> Result<heapless::Vec<i32, { Standing::AXES }>, String> {
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

/// Parses the end of a recording: `panic N12 1.000 2.000 0.000`, or `reset`.
fn ended(text: &str, words: &[&str]) -> Result<BoardReport, String> {
    let text = text.to_owned();
    let [_, line, place @ ..] = words else {
        return Ok(BoardReport::Ended { text, crash: false, place: Vec::new(), line: 0 });
    };
    let line = number(line.trim_start_matches('N'))?;
    let micrometres = |word: &&str| Ok((number::<f64>(word)? * 1e3).round() as i64);
    let place = place.iter().map(micrometres).collect::<Result<_, String>>()?;
    Ok(BoardReport::Ended { text, crash: true, place, line })
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

/// Returns the bytes of a text that `escape_ascii` has written: `G1\n` becomes G, 1 and a line feed.
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
