//! Passes a job's text to the controller byte by byte, and finds the line of the file that each reply (error, message,
//! alarm) belongs to.
//!
//! The bytes of a file are never realtime commands, unlike those on a link. Comments can contain any UTF-8: non-ASCII
//! characters reach the controller as `?`, which is ignored in a comment and rejected elsewhere. Every line gets
//! exactly one answer, in order, as with any sender.

use crate::advice;
use crate::column;
use crate::realtime_bytes;
use crate::small_board;
use crate::summary::Warning;
use oxmill_controller::error::Error;
use oxmill_controller::protocol::line_checksum::ANSWER_HEADER;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::io::{self, BufRead};

/// Maximum length of a line, in bytes. A file with a longer line is not a program for a machine.
const LONGEST_LINE: usize = 1 << 20;
/// Maximum number of parameter names that are remembered. They are suggested when a line uses a similar, unknown name.
const MOST_NAMES: usize = 100;
/// A name is suggested only if it differs from the unknown name by at most this many letters.
const MOST_DIFFERENT: usize = 2;
/// Maximum number of lines that are kept because the controller may have stored them.
const MOST_STORED: usize = 8_000;
/// Maximum number of characters that the controller quotes of a stored line.
const QUOTED: usize = 24;
/// Reports show at most this many characters of a line.
const SHOWN_LINE: usize = 120;
/// Number of bytes that are kept ready for the controller, as in the full receive queue of a board.
const AHEAD: usize = 256;

/// A reply of the controller, or a warning.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Said {
    /// `error:N` for a line of the file.
    Error {
        /// Line number in the file, from 1.
        line: u64,
        /// Number of the error, as in `error:N`.
        code: u8,
        /// The line, without blanks at its ends, cut off after 120 characters.
        text: String,
        /// What is wrong with the line, if known: the message before the error.
        reason: Option<String>,
    },
    /// Any other output that is not an answer to a line.
    Message {
        /// Line number in the file of the oldest line that was unanswered when this output came; 0 if there was none.
        line: u64,
        /// The line of output.
        text: String,
        /// Text of the line `line` of the file, cut off as in [`Said::Error`]; empty if `line` is 0.
        source: String,
    },
    /// A line given to the controller may not do what was intended.
    Warning(Warning),
}

/// A job's lines on their way to the controller, and the answers to them.
pub struct JobText {
    reader: Box<dyn BufRead>,
    bytes: VecDeque<u8>,
    at_end: bool,
    after_cr: bool,
    stopped: bool,
    failed: Option<io::Error>,
    /// Names of parameters, such as `depth`, that lines of the file set; not more than [`MOST_NAMES`].
    names: Vec<String>,
    /// Numbers of the parameters that lines of the file set, such as 100 for `#100=5`.
    numbers_set: BTreeSet<u32>,
    /// Subroutines of the file, such as `o100`, each with the line number of its `sub`; at most [`MOST_NAMES`].
    subroutines: Vec<(String, u64)>,
    /// Numbers of the parameters that lines of the file read, each with its first line; at most [`MOST_NAMES`].
    numbers_read: BTreeMap<u32, u64>,
    /// Whether a line sets a parameter whose number it computes, such as `#[#1+100]=5`.
    sets_computed: bool,
    /// Whether a comment has mentioned inches so far.
    mentions_inches: bool,
    /// Line number of the most recent line with G21.
    metric_at: Option<u64>,
    /// Line number of the most recent line with G20.
    inches_at: Option<u64>,
    /// Unanswered lines: the number in the file, the text, and an error if the line has words that the board does not
    /// support (see `small_board`).
    unanswered: VecDeque<(u64, String, Option<Error>)>,
    /// Whether the board supports all words of the simulator.
    has_all_words: bool,
    /// Whether a line `%` is a tape mark in the controller's dialect.
    has_tape_marks: bool,
    lines: u64,
    answers: u64,
    /// Line number of the oldest unanswered line when the first alarm was reported.
    alarmed_at: Option<u64>,
    consumed: u64,
    reply: Vec<u8>,
    /// The most recent line of output, if it was a message (`[MSG:`). If the next line of output is an error, the
    /// message explains it.
    message: Option<String>,
    said: Vec<Said>,
    /// Number of lines that the controller had read before this job.
    lines_before: u32,
    /// For each tape mark (`%`) in the file: the number of lines before it that are not tape marks.
    marks: Vec<u64>,
    /// Line number of a tape mark that follows lines with words, while it is unknown whether further lines with words
    /// follow the mark. If they do, the mark separates two programs, and the controller gets the mark before the next
    /// line with words. `None` if there is no such mark, or if the controller has got it.
    between: Option<u64>,
    /// For each tape mark that was given to the controller: the number of lines given before it, including tape marks.
    given_marks: Vec<u64>,
    /// Answered lines that may have opened a block of O words.
    openers: Vec<Opener>,
    /// Answered lines from the first opener on, with their line numbers in the file. The controller may have stored
    /// these lines for a subroutine, loop or macro.
    stored: VecDeque<(u64, String)>,
    /// Whether a line with words has been given to the controller.
    has_words: bool,
    /// The line that ended the program.
    ended_at: Option<ProgramEnd>,
    /// Number of lines with words after the end of the program that were answered `ok`.
    behind_end: u64,
    /// Whether a subprogram has begun after the end of the program. The lines of a subprogram are executed only when it
    /// is called, so they do not count in `behind_end`.
    among_subprograms: bool,
}

/// Where a program ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProgramEnd {
    /// Line number in the file, from 1.
    pub line: u64,
    /// Whether a tape mark ended the program, instead of M2 or M30.
    pub is_tape_mark: bool,
}

/// The controller's message at M2 and M30.
const PROGRAM_END: &str = "[MSG:Pgm End]";

/// Errors caused by the state of the machine. A message before such an error does not explain the line.
const OF_STATE: [u8; 6] = [
    Error::StoreReadFailed.code(),
    Error::NotIdle.code(),
    Error::Locked.code(),
    Error::SoftLimitNeedsHoming.code(),
    Error::JogOutsideTravel.code(),
    Error::DamagedLine.code(),
];

/// A line that may have opened a subroutine, loop or condition.
struct Opener {
    /// Number of this line among those given to the controller, from 1.
    given: u64,
    /// Number of this line in the file, from 1.
    number: u64,
    text: String,
}

impl JobText {
    /// Makes a job whose lines are read from `reader`.
    pub fn new(reader: impl BufRead + 'static) -> Self {
        Self {
            reader: Box::new(reader),
            bytes: VecDeque::new(),
            at_end: false,
            after_cr: false,
            stopped: false,
            failed: None,
            names: Vec::new(),
            numbers_set: BTreeSet::new(),
            subroutines: Vec::new(),
            numbers_read: BTreeMap::new(),
            sets_computed: false,
            mentions_inches: false,
            metric_at: None,
            inches_at: None,
            unanswered: VecDeque::new(),
            has_all_words: true,
            has_tape_marks: true,
            lines: 0,
            answers: 0,
            alarmed_at: None,
            consumed: 0,
            reply: Vec::new(),
            message: None,
            said: Vec::new(),
            lines_before: 0,
            marks: Vec::new(),
            between: None,
            given_marks: Vec::new(),
            openers: Vec::new(),
            stored: VecDeque::new(),
            has_words: false,
            ended_at: None,
            behind_end: 0,
            among_subprograms: false,
        }
    }

    /// Starts the job. `lines_before`: number of lines (wrapping) that the controller has read before.
    /// `has_all_words`: `false` for a board that does not support all words. The errors that this board would return
    /// for such words are then added. `has_tape_marks`: `true` if the controller's dialect has tape marks.
    pub fn begin(&mut self, lines_before: u32, has_all_words: bool, has_tape_marks: bool) {
        self.lines_before = lines_before;
        self.has_all_words = has_all_words;
        self.has_tape_marks = has_tape_marks;
    }

    /// Finds a line that may have opened a block (subroutine, loop or condition). `line`: its number as the controller
    /// counts lines. Returns its number in the file and its text.
    pub fn opener(&self, line: u32) -> Option<(u64, &str)> {
        let given = u64::from(line.wrapping_sub(self.lines_before));
        self.openers.iter().find(|opener| opener.given == given).map(|opener| (opener.number, opener.text.as_str()))
    }

    /// Returns the program numbers in the file, such as `O1001 (line 20)`, except that of the program that contains the
    /// line `call`. Searches only the lines since the last [`JobText::forget_openers`].
    pub fn other_programs(&self, call: u64) -> Vec<String> {
        let mut numbers: Vec<(u64, &str)> = self.program_numbers().collect();
        if let Some(own) = numbers.iter().rposition(|(line, _)| *line < call) {
            numbers.remove(own);
        }
        numbers.into_iter().map(|(line, number)| format!("{number} (line {line})")).collect()
    }

    fn program_numbers(&self) -> impl Iterator<Item = (u64, &str)> {
        self.openers.iter().filter_map(|opener| {
            let text = opener.text.trim();
            let digits = text.strip_prefix(['O', 'o'])?;
            let length = digits.bytes().take_while(u8::is_ascii_digit).count();
            let is_alone = digits
                .get(length..)
                .is_some_and(|rest| rest.trim_start().is_empty() || rest.trim_start().starts_with('('));
            (length > 0 && is_alone).then(|| (opener.number, &text[..=length]))
        })
    }

    /// Converts `line`, as the controller counts lines, to a line number in the file; 0 for a line before the job.
    pub fn file_line(&self, line: u32) -> u64 {
        let given = u64::from(line.wrapping_sub(self.lines_before));
        if line == 0 || given == 0 || given > self.lines {
            return 0;
        }
        let of_file = given - self.given_marks.partition_point(|before| *before < given) as u64;
        of_file + self.marks.partition_point(|before| *before < of_file) as u64
    }

    /// Forgets the lines that may have opened a subroutine, loop or condition. Called while none is open.
    pub fn forget_openers(&mut self) {
        self.openers.clear();
    }

    /// Number of lines read so far, including tape marks.
    pub fn lines(&self) -> u64 {
        self.lines
    }

    /// Returns the number of tape marks: lines that contain only `%`, or only `%` and comments. They mark the ends of
    /// a punched tape. Only tape marks between two programs are passed on to the controller.
    pub fn tape_marks(&self) -> u64 {
        self.marks.len() as u64
    }

    /// Number of answered lines.
    pub fn answers(&self) -> u64 {
        self.answers
    }

    /// Number of bytes of the file read so far.
    pub fn consumed(&self) -> u64 {
        self.consumed
    }

    /// Returns whether a comment has mentioned inches so far.
    pub fn mentions_inches(&self) -> bool {
        self.mentions_inches
    }

    /// Line number of the most recent line with G21 so far.
    pub fn metric_at(&self) -> Option<u64> {
        self.metric_at
    }

    /// Line number of the most recent line with G20 so far; `None` if G21 has come after it.
    pub fn inches_at(&self) -> Option<u64> {
        self.inches_at.filter(|_| self.inches_at > self.metric_at)
    }

    /// Returns the line number and the text of the stored line that the controller quotes as `quoted`. Returns `None`
    /// if no line or more than one line of the file begins like this.
    pub fn stored_line(&self, quoted: &str) -> Option<(u64, &str)> {
        let is_quoted = |text: &str| {
            let read = column::as_read(text);
            read == quoted || quoted.len() == QUOTED && read.starts_with(quoted)
        };
        let mut found = self.stored.iter().filter(|(_, text)| is_quoted(text));
        let (number, text) = found.next()?;
        found.next().is_none().then_some((*number, text))
    }

    /// Line number in the file of the oldest line that has not been answered.
    pub fn oldest_unanswered(&self) -> Option<u64> {
        self.unanswered.front().map(|(number, ..)| *number)
    }

    /// Returns the line at which the first alarm came: the oldest line that was unanswered then. It may have been
    /// answered since. Before the first alarm, returns the oldest unanswered line. Lines are counted as in the file.
    pub fn alarmed_at(&self) -> Option<u64> {
        self.alarmed_at.or_else(|| self.oldest_unanswered())
    }

    /// Stops giving lines to the controller.
    pub fn stop(&mut self) {
        self.stopped = true;
        self.bytes.clear();
        self.unanswered.clear();
    }

    /// Ends the job because the board has restarted after the last answered line, and warns about that.
    pub fn end_by_restart(&mut self) {
        let line = self.file_line(self.lines_before.wrapping_add(self.answers as u32));
        let text = "the board restarts here, so the lines below do not run".into();
        self.said.push(Said::Warning(Warning { line, text }));
        self.stop();
    }

    /// Returns whether all lines of the job have been given to the controller and answered.
    pub fn is_used_up(&self) -> bool {
        self.bytes.is_empty() && (self.at_end || self.stopped) && self.unanswered.is_empty()
    }

    /// Returns whether the file could not be read to the end.
    pub fn has_failed(&self) -> bool {
        self.failed.is_some()
    }

    /// Removes and returns the error that ended reading.
    pub fn failure(&mut self) -> Option<io::Error> {
        self.failed.take()
    }

    /// Removes and returns the replies and warnings since the last call of this function.
    pub fn said(&mut self) -> Vec<Said> {
        std::mem::take(&mut self.said)
    }

    /// Returns the number of bytes that are ready for the controller, at most the size of a receive queue; 0 at the
    /// end.
    pub fn waiting(&mut self) -> usize {
        self.fill();
        self.bytes.len().min(AHEAD)
    }

    /// Removes and returns the next byte for the controller; `None` at the end of the job.
    pub fn next_byte(&mut self) -> Option<u8> {
        if self.bytes.is_empty() {
            self.fill();
        }
        self.bytes.pop_front()
    }

    fn fill(&mut self) {
        while self.bytes.len() < AHEAD && !self.at_end && !self.stopped {
            match self.read_line() {
                Ok(Some(line)) if line.contains(&0) => {
                    let number = self.lines + 1;
                    self.failed = Some(io::Error::other(format!("line {number} has a byte 0 and is no text")));
                    self.at_end = true;
                }
                Ok(Some(line)) => self.take_line(&line),
                Ok(None) => self.at_end = true,
                Err(error) => {
                    self.failed = Some(error);
                    self.at_end = true;
                }
            }
        }
    }

    /// Returns the next line without its end, which is LF, CR LF or CR.
    fn read_line(&mut self) -> io::Result<Option<Vec<u8>>> {
        let mut line = Vec::new();
        loop {
            let available = match self.reader.fill_buf() {
                Err(error) if error.kind() == io::ErrorKind::Interrupted => continue,
                other => other?,
            };
            if available.is_empty() {
                return Ok((!line.is_empty()).then_some(line));
            }
            let skip = usize::from(std::mem::take(&mut self.after_cr) && available[0] == b'\n');
            let end = available[skip..].iter().position(|byte| matches!(byte, b'\n' | b'\r')).map(|at| at + skip);
            line.extend_from_slice(&available[skip..end.unwrap_or(available.len())]);
            let used = end.map_or(available.len(), |end| end + 1);
            self.after_cr = end.is_some_and(|end| available[end] == b'\r');
            self.reader.consume(used);
            self.consumed += used as u64;
            if end.is_some() {
                return Ok(Some(line));
            }
            if line.len() > LONGEST_LINE {
                return Err(io::Error::other("a line has more than a million bytes: this is not a G-code file"));
            }
        }
    }

    fn take_line(&mut self, line: &[u8]) {
        self.lines += 1;
        if let Some(text) = realtime_bytes::warning(line) {
            self.said.push(Said::Warning(Warning { line: self.lines, text }));
        }
        let text = String::from_utf8_lossy(line);
        let text = if self.lines == 1 { text.trim_start_matches('\u{FEFF}') } else { &text };
        if is_tape_mark(text) {
            self.marks.push(self.lines - 1 - self.tape_marks());
            self.between = Some(self.lines).filter(|_| self.has_words && self.has_tape_marks);
            if self.has_words && self.ended_at.is_none() {
                self.ended_at = Some(ProgramEnd { line: self.lines, is_tape_mark: true });
            }
            return;
        }
        if !is_blank_or_comment(text) {
            self.has_words = true;
            if let Some(line) = self.between.take() {
                self.given_marks.push(self.lines - 1 - self.tape_marks() + self.given_marks.len() as u64);
                self.bytes.extend(b"%\n");
                self.unanswered.push_back((line, "%".into(), None));
            }
        }
        self.bytes.extend(text.chars().map(plain));
        self.bytes.push_back(b'\n');
        let left_out = if self.has_all_words { None } else { small_board::error_of(text) };
        let mut shown: String = text.trim().chars().take(SHOWN_LINE).map(shown_character).collect();
        if text.trim().chars().nth(SHOWN_LINE).is_some() {
            shown += " ...";
        }
        self.mentions_inches |= mentions_inches(text);
        if text.contains(['o', 'O']) {
            self.note_subroutine(text);
        }
        if text.contains('#') {
            self.note_names(text);
            self.note_numbers(text);
        }
        if text.contains(['2']) && text.contains(['G', 'g']) {
            self.note_units(text);
        }
        self.unanswered.push_back((self.lines, shown, left_out));
    }

    /// Notes the names of the parameters that a line sets, such as `#<depth>=2`.
    fn note_names(&mut self, line: &str) {
        for part in line.split("#<").skip(1) {
            if let Some((name, behind)) = part.split_once('>')
                && behind.trim_start().starts_with('=')
                && self.names.len() < MOST_NAMES
                && !self.names.iter().any(|known| known == name)
            {
                self.names.push(name.to_owned());
            }
        }
    }

    /// Notes a line with G20 or G21.
    fn note_units(&mut self, line: &str) {
        for word in advice::words(line) {
            match word.as_str() {
                "G20" => self.inches_at = Some(self.lines),
                "G21" => self.metric_at = Some(self.lines),
                _ => {}
            }
        }
    }

    /// Notes the number of the subroutine that begins in a line such as `o100 sub`.
    fn note_subroutine(&mut self, line: &str) {
        let line = column::as_read(line);
        if let Some(number) = line.strip_prefix('O').and_then(|rest| rest.strip_suffix("SUB"))
            && number.bytes().all(|byte| byte.is_ascii_digit())
            && self.subroutines.len() < MOST_NAMES
        {
            self.subroutines.push((format!("o{number}"), self.lines));
        }
    }

    /// Returns the subroutines of the file, such as `o100`, each with its line number.
    pub fn subroutines(&self) -> &[(String, u64)] {
        &self.subroutines
    }

    /// Notes the numbers of the parameters that a line sets and reads. Only `#31` to `#4999` count, because lower
    /// numbers are arguments of calls, and the machine sets the parameters with higher numbers.
    fn note_numbers(&mut self, line: &str) {
        let line = column::as_read(line);
        for part in line.split('#').skip(1) {
            // A number is computed as `#[#1+100]` or `##1`.
            self.sets_computed |= (part.starts_with('[') || part.is_empty()) && line.contains('=');
            let digits = part.bytes().take_while(u8::is_ascii_digit).count();
            let (number, behind) = part.split_at(digits);
            match number.parse() {
                Ok(31..=4999) if behind.starts_with('=') => {
                    self.numbers_set.extend(number.parse::<u32>());
                }
                Ok(number @ 31..=4999) if self.numbers_read.len() < MOST_NAMES => {
                    self.numbers_read.entry(number).or_insert(self.lines);
                }
                _ => {}
            }
        }
    }

    /// Returns some parameters that the file sets, such as `#100`, in order of their numbers.
    pub fn numbers_set(&self) -> Vec<String> {
        self.numbers_set.iter().take(5).map(|number| format!("#{number}")).collect()
    }

    /// Returns the numbers of the parameters that the file reads and never sets, each with its first line.
    pub fn never_set(&self) -> Vec<(u32, u64)> {
        let is_unset = |number: &u32| !self.sets_computed && !self.numbers_set.contains(number);
        self.numbers_read.iter().map(|(number, line)| (*number, *line)).filter(|(number, _)| is_unset(number)).collect()
    }

    /// Returns the name of a parameter that the file sets and that differs from `name` by few letters, if there is one.
    pub fn name_like(&self, name: &str) -> Option<&str> {
        let distance = |known: &String| strsim::damerau_levenshtein(&known.to_lowercase(), &name.to_lowercase());
        let nearest = self.names.iter().min_by_key(|known| distance(known))?;
        (distance(nearest) <= MOST_DIFFERENT && distance(nearest) < name.chars().count()).then_some(nearest)
    }

    /// Returns the lines that call a program, each with its number in the file. `number`: number of the program, such
    /// as `O1001`. Searches only the lines since the last [`JobText::forget_openers`].
    pub fn calls_of(&self, number: &str) -> Vec<(u64, &str)> {
        let word = number.replace(['O', 'o'], "P");
        let is_one = |opener: &&Opener| is_call(&opener.text) && advice::words(&opener.text).contains(&word);
        self.openers.iter().filter(is_one).map(|opener| (opener.number, opener.text.as_str())).collect()
    }

    /// Receives a part of the controller's output.
    pub fn answered(&mut self, bytes: &[u8]) {
        for byte in bytes {
            match byte {
                b'\r' => {}
                b'\n' => {
                    let line = String::from_utf8_lossy(&std::mem::take(&mut self.reply)).into_owned();
                    self.reply_line(&line);
                }
                _ => self.reply.push(*byte),
            }
        }
    }

    /// Returns where the program ended (M2, M30, or a tape mark after words), and how many later lines with words were
    /// answered `ok`. `None` if there are no such lines.
    pub fn behind_end(&self) -> Option<(ProgramEnd, u64)> {
        self.ended_at.filter(|_| self.behind_end > 0).map(|end| (end, self.behind_end))
    }

    fn reply_line(&mut self, reply: &str) {
        // After `$LC=ON` in the file, each answer begins with a header, which has a checksum.
        let reply = match without_header(reply) {
            "known" => "ok",
            text => text,
        };
        let code = reply.strip_prefix("error:").and_then(|code| code.parse().ok());
        if reply == PROGRAM_END
            && let Some((line, ..)) = self.unanswered.front()
            // Lines are read ahead, so `ended_at` can already be a tape mark after this line.
            && self.ended_at.is_none_or(|end| *line < end.line)
        {
            self.ended_at = Some(ProgramEnd { line: *line, is_tape_mark: false });
        }
        if reply == "ok" || code.is_some() {
            self.answers += 1;
            let (line, text, left_out) = self.unanswered.pop_front().unwrap_or_default();
            let is_behind = self.ended_at.is_some_and(|end| line > end.line);
            self.among_subprograms |= is_behind && code.is_none() && is_program_number(&text);
            self.among_subprograms &= text != "%";
            let is_carried_out =
                code.is_none() && !is_blank_or_comment(&text) && text != "%" && !self.among_subprograms;
            self.behind_end += u64::from(is_carried_out && is_behind);
            let reason = self.message.take().filter(|_| code.is_some_and(|code| !OF_STATE.contains(&code)));
            if let Some(code) = code.or(left_out.map(Error::code)) {
                self.said.push(Said::Error { line, code, text: text.clone(), reason });
            }
            let is_opener = text.contains(['o', 'O']) || is_call(&text);
            if is_opener || !self.stored.is_empty() {
                self.stored.push_back((line, text.clone()));
                if self.stored.len() > MOST_STORED {
                    self.stored.pop_front();
                }
            }
            if is_opener {
                self.openers.push(Opener { given: self.answers, number: line, text });
            }
        } else if !reply.is_empty() {
            if reply.starts_with("ALARM:") && self.alarmed_at.is_none() {
                self.alarmed_at = self.oldest_unanswered();
            }
            self.message = Some(reply.to_owned()).filter(|text| text.starts_with("[MSG:"));
            let (line, source) =
                self.unanswered.front().map(|(line, text, _)| (*line, text.clone())).unwrap_or_default();
            self.said.push(Said::Message { line, text: reply.to_owned(), source });
        }
    }
}

/// Returns whether a comment of a line has the word INCH or INCHES, or IN after a number.
fn mentions_inches(line: &str) -> bool {
    let Some(at) = line.find(['(', ';']) else { return false };
    let comment = line[at..].to_ascii_uppercase();
    let words: Vec<&str> = comment.split(|c: char| !c.is_ascii_alphanumeric() && c != '.').collect();
    let is_number = |word: &str| word.starts_with(|c: char| c.is_ascii_digit() || c == '.');
    words.iter().any(|word| ["INCH", "INCHES"].contains(word) || is_number(word) && word.ends_with("IN"))
        || words.windows(2).any(|pair| is_number(pair[0]) && pair[1] == "IN")
}

/// Returns an answer without the header (line number and checksum) that precedes it after `$LC=ON`.
pub fn without_header(reply: &str) -> &str {
    reply.strip_prefix(':').and_then(|answer| answer.get(ANSWER_HEADER - 1..)).unwrap_or(reply)
}

/// Returns whether a line may call a subprogram (M98, G65).
pub fn is_call(text: &str) -> bool {
    let words = text.to_ascii_uppercase().replace(' ', "");
    ["M98", "M098", "G65", "G065"].iter().any(|word| words.contains(word))
}

/// Returns whether a line is the number of a program or subprogram, such as `N5 O1001 (POCKET)`.
fn is_program_number(text: &str) -> bool {
    let words = text.split(['(', ';']).next().unwrap_or_default().replace(' ', "").to_ascii_uppercase();
    let behind =
        words.strip_prefix('N').map_or(&*words, |number| number.trim_start_matches(|c: char| c.is_ascii_digit()));
    behind.strip_prefix(['O', ':']).is_some_and(|number| number.chars().all(|c| c.is_ascii_digit()))
}

/// Returns whether a line is `%` followed only by comments.
pub fn is_tape_mark(text: &str) -> bool {
    let Some(mut rest) = text.trim_start().strip_prefix('%') else { return false };
    loop {
        rest = rest.trim_start();
        match rest.strip_prefix('(') {
            Some(comment) => rest = comment.split_once(')').map_or("", |(_, behind)| behind),
            None => return rest.is_empty() || rest.starts_with(';'),
        }
    }
}

/// Returns whether a line is empty or begins with a comment.
fn is_blank_or_comment(text: &str) -> bool {
    let text = text.trim_start();
    text.is_empty() || text.starts_with(['(', ';'])
}

/// Returns a character as shown to users: a blank for a tab, `?` for other control characters.
fn shown_character(character: char) -> char {
    match character {
        '\t' => ' ',
        _ if character.is_control() => '?',
        _ => character,
    }
}

/// Converts a character to the byte that the controller gets: `?` for characters that are neither ASCII nor blank.
fn plain(character: char) -> u8 {
    match character {
        // Unicode spaces count as blanks, too.
        _ if character.is_whitespace() => b' ',
        _ if character.is_ascii() => character as u8,
        _ => b'?',
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn drain(job: &mut JobText) -> String {
        std::iter::from_fn(|| job.next_byte()).map(char::from).collect()
    }

    #[test]
    fn inches_are_a_unit_and_not_a_preposition() {
        for line in ["(SIZE 4 X 3 IN)", "G0 X1 ; .25 in deep", "(3/8IN END MILL)", "(units: inches)", "(1/4 inch)"] {
            assert!(mentions_inches(line), "{line}");
        }
        for line in ["(CUT IN 2 PASSES)", "(MADE IN MM)", "G1 X4", "(3 INTERVALS)", "(T1 IN SPINDLE)"] {
            assert!(!mentions_inches(line), "{line}");
        }
    }

    #[test]
    fn all_line_ends_are_one_line_end() {
        let mut job = JobText::new(&b"\xEF\xBB\xBFG0\r\nG1\n\nG2\rG3"[..]);
        assert_eq!(drain(&mut job), "G0\nG1\n\nG2\nG3\n");
        assert_eq!(job.lines(), 5);
    }

    #[test]
    fn what_comes_behind_the_end_of_the_program_is_counted() {
        let mut job = JobText::new(&b"G0 X1\nM30\n(more)\n\nG0 X2\n"[..]);
        drain(&mut job);
        job.answered(b"ok\r\n[MSG:Pgm End]\r\nok\r\nok\r\nok\r\n");
        assert_eq!(job.behind_end(), None);
        job.answered(b"ok\r\n");
        assert_eq!(job.behind_end(), Some((ProgramEnd { line: 2, is_tape_mark: false }, 1)));
    }

    #[test]
    fn a_tape_mark_behind_words_ends_the_program() {
        let end = |text: &'static str, said: &[u8]| {
            let mut job = JobText::new(text.as_bytes());
            drain(&mut job);
            job.answered(said);
            job.behind_end().map(|(end, behind)| (end.line, end.is_tape_mark, behind))
        };
        assert_eq!(end("(a)\n%\nG0 X1\n%\nG0 X2\n\nX3\n%\nX4\n", &b"ok\r\n".repeat(8)), Some((4, true, 3)));
        assert_eq!(end("%\nG0 X1\n%\n(a)\n", &b"ok\r\n".repeat(2)), None);
        // If a program has both M30 and a tape mark at its end, it ends at the first of them.
        assert_eq!(end("%\nM30\n%\nX4\n", b"[MSG:Pgm End]\r\nok\r\nok\r\nok\r\n"), Some((2, false, 1)));
        assert_eq!(end("X1\n%\nM30\nX4\n", b"ok\r\nok\r\n[MSG:Pgm End]\r\nok\r\nok\r\n"), Some((2, true, 2)));
    }

    #[test]
    fn text_is_text_and_tape_marks_are_left_out() {
        let text = "%\nG0 X1 (原点へ移動 ! ~)\n\u{3000}G\u{FF11}\n % (end)(;) ;x\n";
        let mut job = JobText::new(text.as_bytes());
        assert_eq!(drain(&mut job), "G0 X1 (????? ! ~)\n G?\n");
        assert_eq!((job.lines(), job.tape_marks()), (4, 2));
    }

    /// A tape mark between two programs begins the next one, so the controller gets it.
    #[test]
    fn tape_marks_between_programs_are_passed_on() {
        let text = "%\nG0 X1\nM30\n% (A)\n(B)\n%\nO2\nG0 X2\nbad\nM30\n%\n";
        let mut job = JobText::new(text.as_bytes());
        assert_eq!(drain(&mut job), "G0 X1\nM30\n(B)\n%\nO2\nG0 X2\nbad\nM30\n");
        assert_eq!((job.lines(), job.tape_marks()), (11, 4));
        job.answered(b"ok\r\n[MSG:Pgm End]\r\nok\r\nok\r\nok\r\nok\r\nok\r\nerror:20\r\nok\r\n");
        assert!(job.is_used_up());
        assert!(job.said().iter().any(|said| matches!(said, Said::Error { line: 9, .. })));
        assert_eq!([1, 2, 3, 5, 6, 7, 8].map(|given| job.file_line(given)), [2, 3, 5, 7, 8, 9, 10]);
        let mut job = JobText::new(text.as_bytes());
        job.begin(0, true, false);
        assert!(!drain(&mut job).contains('%'), "Grbl's dialect has none");
    }

    /// After `$LC=ON`, answers begin with a header. The lines of the job have no checksums, so they are rejected.
    #[test]
    fn answers_to_checked_lines_are_answers() {
        let mut job = JobText::new(&b"$LC=ON\nG0\n\n"[..]);
        drain(&mut job);
        job.answered(b":AAAABDHeBSSVBok\r\n:AAAASKKKKKKKKerror:129\r\n:AAAAPABDHABDHknown\r\n");
        assert_eq!(job.said(), [Said::Error { line: 2, code: 129, text: "G0".into(), reason: None }]);
        assert!(job.is_used_up());
    }

    /// A line with words after `%` is not a tape mark: it is passed on, so that the controller rejects it.
    #[test]
    fn a_tape_mark_has_its_line_for_itself() {
        let mut job = JobText::new(&b"%G0X1\n%%\n% (a) X\n%(a\n%;\n"[..]);
        assert_eq!(drain(&mut job), "%G0X1\n%%\n% (a) X\n");
        assert_eq!((job.lines(), job.tape_marks()), (5, 2));
    }

    #[test]
    fn answers_find_their_lines() {
        let mut job = JobText::new(&b"%\nG0\nbad\nG1\n"[..]);
        drain(&mut job);
        assert!(!job.is_used_up());
        job.answered(b"ok\r\nerr");
        job.answered(b"or:20\r\n[MSG:Pgm End]\r\n\r\nok\r\n");
        assert_eq!(
            job.said(),
            [
                Said::Error { line: 3, code: 20, text: "bad".into(), reason: None },
                Said::Message { line: 4, text: "[MSG:Pgm End]".into(), source: "G1".into() }
            ]
        );
        assert!(job.is_used_up());
        assert_eq!(job.answers(), 3);
    }

    #[test]
    fn lines_of_the_controller_are_lines_of_the_file() {
        let mut job = JobText::new(&b"%\nG0\nG1\n%\n\nG2\n"[..]);
        job.begin(40, true, true);
        drain(&mut job);
        assert_eq!([0, 40, 41, 42, 43, 45].map(|line| job.file_line(line)), [0, 0, 2, 3, 5, 6]);
        assert_eq!((job.file_line(41_000), job.file_line(7)), (0, 0));
    }

    #[test]
    fn a_refused_line_is_shown_with_blanks_for_tabs() {
        let mut job = JobText::new(&b"G1\tX\x07\n"[..]);
        drain(&mut job);
        job.answered(b"error:2\r\n");
        assert_eq!(job.said(), [Said::Error { line: 1, code: 2, text: "G1 X?".into(), reason: None }]);
    }

    /// A message before an error explains the error. But if the state of the machine causes the error (here error 9:
    /// locked), the message is not about the line.
    #[test]
    fn the_message_in_front_of_an_error_says_what_is_wrong_with_its_line() {
        let mut job = JobText::new(&b"G1 X\nG1\nG2\n"[..]);
        drain(&mut job);
        job.answered(b"[MSG:no number behind X]\r\nerror:2\r\n[MSG:x]\r\nerror:9\r\n[MSG:y]\r\n<Idle>\r\nerror:20\r\n");
        let reasons = job.said().into_iter().filter_map(|said| match said {
            Said::Error { code, reason, .. } => Some((code, reason)),
            _ => None,
        });
        let expected = [(2, Some("[MSG:no number behind X]".to_owned())), (9, None), (20, None)];
        assert_eq!(reasons.collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_stopped_job_gives_nothing_more() {
        let mut job = JobText::new(&b"G0\nG1\n"[..]);
        assert_eq!(job.next_byte(), Some(b'G'));
        job.stop();
        assert_eq!((job.next_byte(), job.waiting()), (None, 0));
        assert!(job.is_used_up());
    }
}
