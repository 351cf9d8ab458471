//! Checks a job: runs it through the controller as fast as possible and collects the report. Uses no files, threads or
//! system clock; the caller shows the progress between calls.

use crate::advice;
use crate::boards::AXES;
use crate::column;
use crate::power_up::{Dialect, error_text};
use crate::simulator::Simulator;
use crate::summary::{AlarmReport, Extents, LineError, Summary, Warning, clock_time};
use crate::text::{JobText, Said, is_call, without_header};
use crate::tool_times::ToolTime;
use oxmill_controller::axes::{Axis, LINEAR};
use oxmill_controller::error::{Alarm, Error};
use oxmill_controller::gcode::Units;
use oxmill_controller::messages::Realtime;

/// Beginning of the controller's message that a program waits for a subprogram. The number of the subprogram follows,
/// such as `O1001]`.
const AWAITS: &str = "[MSG:Program waits for subprogram ";
/// Beginning of the controller's message about G43 while no tool is in the table.
pub const NO_TOOLS: &str = "[MSG:No tool is in the table";
/// Maximum number of errors, and of warnings, that the report lists. Further ones are only counted.
const KEPT_ERRORS: usize = 1000;
/// Maximum number of controller messages, and of simulator notes, that the report lists. Further ones are only counted.
const KEPT_MESSAGES: usize = 50;

/// What the report says about a job, except for its measurements (times, distances, speeds).
#[derive(Debug, Default)]
struct Outcome {
    errors: Vec<LineError>,
    more_errors: u64,
    warnings: Vec<Warning>,
    more_warnings: u64,
    messages: Vec<String>,
    message_lines: Vec<u64>,
    more_messages: u64,
    notes: Vec<String>,
    more_notes: u64,
    alarm: Option<AlarmReport>,
    complete: bool,
}

impl Outcome {
    fn collect(&mut self, job: &mut JobText) {
        for said in job.said() {
            match said {
                Said::Error { line, code, text, reason: Some(reason) } => {
                    self.unsay(&reason);
                    let reason = reason.trim_start_matches("[MSG:").trim_end_matches(']');
                    self.refused(line, code, reason, text, job);
                }
                Said::Error { line, code, text, reason: None } => {
                    self.refused(line, code, error_text(code), text, job);
                }
                Said::Warning(warning) => self.warn(warning),
                // The controller can send this message several times in a row: list it once.
                Said::Message { text, .. } if self.messages.last() == Some(&text) && text.starts_with(AWAITS) => {}
                Said::Message { line, text, source } if self.messages.len() < KEPT_MESSAGES => {
                    if text.starts_with(NO_TOOLS) {
                        self.warn(Warning { line, text: without_length(&source) });
                    }
                    self.messages.push(text);
                    self.message_lines.push(line);
                }
                Said::Message { .. } => self.more_messages += 1,
            }
        }
    }

    /// Removes the most recent message if it is `message`. The report shows this text together with the error that it
    /// explains.
    fn unsay(&mut self, message: &str) {
        if self.more_messages > 0 {
            self.more_messages -= 1;
        } else if self.messages.last().is_some_and(|last| last == message) {
            self.messages.pop();
            self.message_lines.pop();
        }
    }

    fn refused(&mut self, line: u64, code: u8, text: &str, source: String, job: &JobText) {
        if self.errors.len() >= KEPT_ERRORS {
            self.more_errors += 1;
            return;
        }
        // If the wrong line was stored by the controller, the message quotes that line. The answer then belongs to the
        // line that ran the stored line.
        let within = text.strip_prefix("in ").and_then(|quoted| quoted.split_once(": "));
        let stored = within.and_then(|(quoted, fault)| Some((job.stored_line(quoted)?, fault)));
        if let Some(((number, stored), fault)) = stored {
            let column = column::of_word(fault, stored);
            let (text, advice) = self.explained(number, code, fault, stored, job);
            let advice = format!("{advice} It was stored, and line {line} ran it.").trim_start().to_owned();
            self.errors.push(LineError { line: number, code, column, text, advice, source: stored.into() });
            return;
        }
        let column = column::of_word(text, &source);
        let (text, advice) = self.explained(line, code, text, &source, job);
        self.errors.push(LineError { line, code, column, text, advice, source });
    }

    /// Returns what is wrong with a refused line, and what to do about it. Detects three causes that the controller
    /// does not report: an earlier line was refused, several lines have run together, or a name is misspelt.
    fn explained(&self, line: u64, code: u8, text: &str, source: &str, job: &JobText) -> (String, String) {
        let refused_feed = self.errors.iter().rev().find(|error| advice::count(&error.source, 'F') > 0);
        if let Some(LineError { line, .. }) = refused_feed
            && code == Error::UndefinedFeed.code()
        {
            return (text.into(), format!("Line {line} has an F and was refused: correct that line first."));
        }
        if let Some(LineError { line: before, source, .. }) = self.errors.last()
            && code == Error::InvalidTarget.code()
            && before + 1 == line
            && moves(source)
        {
            // Leave out the controller's suggestion of a centre: it would be right only for this wrong start.
            let fault = text.split(". ").next().unwrap_or(text);
            let advice =
                format!("Line {before} was refused, so this arc starts at another point: correct that line first.");
            return (fault.into(), advice);
        }
        if code == Error::LineTooLong.code() && advice::count(source, 'X') > 1 {
            return ("several moves have run together in this line: begin a new line for each".into(), String::new());
        }
        if text.contains("3-D printer") {
            return (text.into(), advice::PRINTER.into());
        }
        if code == Error::LineTooLong.code() {
            let is_long = |number: &str| number.bytes().take_while(u8::is_ascii_digit).count() > MANY_DECIMALS;
            let advice = match source {
                source if source.contains('[') => advice::LONG_EXPRESSION,
                source if source.split('.').skip(1).any(is_long) => advice::LONG_NUMBERS,
                _ => advice::LONG_LINE,
            };
            return (text.into(), advice.into());
        }
        if text.starts_with("no subroutine ") {
            let number = text.split(' ').nth(2).unwrap_or_default();
            return (text.into(), other_subroutines(number, job.subroutines()));
        }
        let unset = text.strip_prefix("#<").and_then(|rest| rest.split_once("> is not set"));
        if let Some(name) = unset.and_then(|(name, _)| job.name_like(name)) {
            return (text.into(), format!("The file sets #<{name}>: is that the name?"));
        }
        (text.into(), advice::beside(text, code, source).into())
    }

    fn warn(&mut self, warning: Warning) {
        if self.warnings.len() < KEPT_ERRORS {
            self.warnings.push(warning);
        } else {
            self.more_warnings += 1;
        }
    }

    /// Adds an error if a subroutine, loop or condition is still open at the end of the file, because its content was
    /// not executed, or not as intended. `since`: where it begins, from `Controller::open_since`; `None` if nothing is
    /// open.
    fn look_for_open_block(&mut self, since: Option<u32>, job: &JobText) {
        if let Some((line, source)) = since.and_then(|line| job.opener(line)) {
            let source = source.to_owned();
            if is_call(&source) && !source.trim_start().starts_with(['o', 'O']) {
                let (line, source, text) = self.missing_program(line, source, job);
                self.refused(line, Error::OutOfPlace.code(), &text, source, job);
            } else {
                let text = "the sub, loop or condition that begins here has no end";
                self.refused(line, Error::FlowSyntax.code(), text, source, job);
            }
        }
    }

    /// Returns the first line that calls a subprogram that is not in the file: its number, its source, and what is
    /// wrong with it. `opener`: the line with the call at which the controller has begun to store the program. Removes
    /// the controller's messages about waiting for this subprogram.
    fn missing_program(&mut self, opener: u64, source: String, job: &JobText) -> (u64, String, String) {
        let awaited = self.messages.iter().rev().find_map(|message| message.strip_prefix(AWAITS));
        let Some(number) = awaited.map(|number| number.trim_end_matches(']').to_owned()) else {
            let text = "a subprogram that is called here is not in the file: write it after M30, as O1001 .. M99";
            return (opener, source, text.into());
        };
        let all = std::mem::take(&mut self.messages).into_iter().zip(std::mem::take(&mut self.message_lines));
        (self.messages, self.message_lines) = all.filter(|(message, _)| !message.starts_with(AWAITS)).unzip();
        let calls = job.calls_of(&number);
        let (call, source) = calls.first().map_or((opener, source), |(line, text)| (*line, (*text).to_owned()));
        let more: Vec<String> = calls.iter().skip(1).map(|(line, _)| line.to_string()).collect();
        let more = match &more[..] {
            [] => String::new(),
            [line] => format!(", also in line {line}"),
            lines => format!(", also in lines {}", lines.join(", ")),
        };
        (call, source, missing(&number, &more, &job.other_programs(call)))
    }

    /// Adds advice to the last error `OutOfMemory`. The controller stores a program until its subprograms have arrived,
    /// and this program does not fit into the memory of `board`: `excess` bytes are missing.
    fn measure_held(&mut self, excess: usize, board: &str) {
        let is_of_memory = |error: &&mut LineError| error.code == Error::OutOfMemory.code();
        if let Some(error) = self.errors.iter_mut().rfind(is_of_memory) {
            error.advice = format!(
                "{board} lacks {excess} bytes: it must store the program from its first call on (words plus one byte per line). \
                 Write the subprograms above the program, as o1001 sub .. o1001 endsub: less is stored."
            );
        }
    }

    fn note(&mut self, note: String) {
        if self.notes.len() < KEPT_MESSAGES {
            self.notes.push(note);
        } else {
            self.more_notes += 1;
        }
    }
}

/// The error about a missing program names other programs of the file: at most this number of them, and the last one
/// in addition.
const MOST_NAMED: usize = 5;

/// Number of decimals above which a number has more digits than any post-processor needs.
const MANY_DECIMALS: usize = 6;

/// Returns whether a line has words that move X, Y or Z.
fn moves(source: &str) -> bool {
    ['X', 'Y', 'Z'].iter().any(|letter| advice::count(source, *letter) > 0)
}

/// Returns the warning about the line `source`, which has a G43 although no tool has a stored length.
fn without_length(source: &str) -> String {
    let words = advice::words(source);
    let word = ['H', 'T'].iter().find_map(|letter| words.iter().find(|word| word.starts_with(*letter)));
    let number = word.and_then(|word| word.get(1..)).unwrap_or("1");
    let tool = word.filter(|word| word.starts_with('H')).map_or(String::new(), |word| format!(" {word}"));
    format!(
        "no tool lengths are stored, so G43{tool} adds 0. If you zero Z with each tool, ignore this. If not, the tool cuts \
         too deep or too shallow: insert G10 L1 P{number} Z<difference> above this line, and one such line for each other \
         H number of G43, with P equal to it. The difference is the length of the tool minus the length of the tool with which you zero Z, in program units"
    )
}

/// Returns advice for the call of the subroutine `missing`, such as `110`, which the file does not have above the call.
/// `present`: the subroutines that it has, each with its line.
fn other_subroutines(missing: &str, present: &[(String, u64)]) -> String {
    let named: Vec<String> =
        present.iter().take(MOST_NAMED).map(|(number, line)| format!("{number} (line {line})")).collect();
    let define = format!("write o{missing} sub, its lines and o{missing} endsub above this line");
    match &named[..] {
        [] => format!("The file has no subroutine so far: {define}."),
        [only] => format!("The only subroutine so far is {only}: call it if you mean that one, or {define}."),
        several => format!("The subroutines so far are {}: correct the number, or {define}.", several.join(", ")),
    }
}

/// Returns the error text for calls of the subprogram `number`, such as `O1001`, which is not in the file. `more`: the
/// further lines that call it. `present`: the numbers of the other programs in the file.
fn missing(number: &str, more: &str, present: &[String]) -> String {
    match present {
        [] => format!("{number} is called here{more} and is not in the file: write it after M30, from {number} to M99"),
        [only] => {
            let word = only.split(' ').next().unwrap_or_default().replace(['O', 'o'], "P");
            format!(
                "{number} is called here{more}, but the only subprogram in the file is {only}: write {word} if you mean that one, \
                 or write the missing one after M30, from {number} to M99"
            )
        }
        [others @ .., last] => {
            let (few, rest) = others.split_at(others.len().min(MOST_NAMED));
            let (few, dots) = (few.join(", "), if rest.is_empty() { "" } else { ", .." });
            format!(
                "{number} is called here{more}, but the file has only {few}{dots} and {last}: correct the number, or write the \
                 missing one after M30, from {number} to M99"
            )
        }
    }
}

/// A job that is being run through the controller.
///
/// ```
/// use oxmill_simulator::{JobText, Options, Simulator, check::Check};
/// let mut check = Check::new(Simulator::new(Options::default()), JobText::new(&b"G21 G91\nG1 X1 F600\n"[..]));
/// while !check.advance(1000) {}
/// let summary = check.summary("one.nc", 0.0);
/// assert!(summary.is_good() && summary.position_mm == [1.0, 0.0, 0.0]);
/// ```
pub struct Check {
    simulator: Simulator,
    origin: u64,
    /// Motor positions at the beginning of the job, in steps.
    began_at: [i32; AXES],
    outcome: Outcome,
    done: bool,
}

impl Check {
    /// Starts a job on an idle simulator. To collect a drawing or a trace, the caller must set up the simulator for it
    /// beforehand.
    pub fn new(mut simulator: Simulator, job: JobText) -> Self {
        let origin = simulator.clock().now();
        simulator.mark_moves();
        simulator.begin_job();
        simulator.take_output();
        simulator.load_job(job);
        let began_at = simulator.machine().motors();
        Self { simulator, origin, began_at, outcome: Outcome::default(), done: false }
    }

    /// Makes a report for a machine that a host has driven without a job, as in a replay. `origin`: the tick at which
    /// the report begins. `said`: the output of the machine since then.
    pub fn of(simulator: Simulator, origin: u64, said: &str) -> Self {
        let mut outcome = Outcome { complete: true, ..Outcome::default() };
        let mut answers = 0;
        let no_job = JobText::new(std::io::empty());
        for line in said.lines().map(without_header) {
            answers += u64::from(matches!(line, "ok" | "known"));
            if let Some(code) = line.strip_prefix("error:").and_then(|code| code.parse().ok()) {
                answers += 1;
                outcome.refused(answers, code, error_text(code), String::new(), &no_job);
            }
            let alarm = line.strip_prefix("ALARM:").and_then(|code| code.parse().ok());
            let alarm = alarm.and_then(|code: u8| Alarm::ALL.iter().find(|alarm| alarm.code() == code));
            if let (Some(alarm), None) = (alarm, &outcome.alarm) {
                let (text, advice) = (alarm.text().into(), advice::for_alarm(*alarm).into());
                outcome.alarm = Some(AlarmReport { code: alarm.code(), text, line: None, advice });
            }
        }
        Self { simulator, origin, began_at: [0; AXES], outcome, done: true }
    }

    /// Advances the job by up to `rounds` rounds, each to the next event. A round takes the computer a few
    /// microseconds. Returns whether the job has ended.
    pub fn advance(&mut self, rounds: u32) -> bool {
        for _ in 0..rounds {
            if self.done {
                break;
            }
            if self.run_slice() {
                self.finish();
            }
        }
        self.done
    }

    /// Advances the job to its next event, or handles an alarm or a pause. Returns whether the job has ended.
    fn run_slice(&mut self) -> bool {
        let (simulator, outcome) = (&mut self.simulator, &mut self.outcome);
        if simulator.unfetched() > 0 {
            simulator.take_output();
            let is_open = simulator.controller().open_since().is_some();
            if let Some(job) = simulator.job_mut() {
                outcome.collect(job);
                if !is_open {
                    job.forget_openers();
                }
            }
        }
        if outcome.alarm.is_none()
            && let Some(alarm) = simulator.controller().alarm()
        {
            let line = simulator.job().and_then(JobText::alarmed_at);
            outcome.alarm = Some(AlarmReport {
                code: alarm.code(),
                text: alarm.text().into(),
                line,
                advice: advice::for_alarm(alarm).into(),
            });
            if let Some(job) = simulator.job_mut() {
                job.stop();
            }
        }
        if simulator.is_idle() {
            return true;
        }
        if simulator.controller().is_paused() {
            let line = simulator.job().and_then(JobText::oldest_unanswered).unwrap_or_default();
            outcome.note(format!("line {line} paused the program; cycle start was pressed at once"));
            simulator.press(Realtime::CycleStart);
            return false;
        }
        if simulator.advance_once(u64::MAX) || simulator.unfetched() > 0 {
            return false;
        }
        if outcome.alarm.is_none() {
            let line = simulator.job().and_then(JobText::oldest_unanswered).unwrap_or_default();
            outcome.note(if simulator.waits_beyond_the_clock() {
                format!("line {line} waits for so long that the simulated time ends before it")
            } else {
                format!("line {line} waits for an input or a command that the simulator never gets")
            });
        }
        true
    }

    fn finish(&mut self) {
        self.done = true;
        self.simulator.take_output();
        let open_since = self.simulator.controller().open_since();
        let long_lines = self.simulator.meter().times().long_lines();
        if let Some(excess) = self.simulator.controller().excess_bytes() {
            self.outcome.measure_held(excess, self.simulator.board().name);
        }
        if let Some(job) = self.simulator.job_mut() {
            self.outcome.collect(job);
            self.outcome.look_for_open_block(open_since, job);
            for (line, seconds) in long_lines {
                self.outcome
                    .warn(Warning { line: job.file_line(line), text: format!("takes {}", clock_time(seconds)) });
            }
            for (number, line) in job.never_set() {
                // A refused line, such as one without support for parameters, has an error of its own.
                if self.outcome.errors.iter().any(|error| error.line == line) {
                    continue;
                }
                let set = job.numbers_set();
                let name = format!("#{number}");
                let other = match set.iter().find(|other| strsim::damerau_levenshtein(other, &name) == 1) {
                    Some(near) => format!("{near}, which the file sets"),
                    None if set.is_empty() => "another parameter".into(),
                    None => format!("another parameter (the file sets {})", set.join(", ")),
                };
                let text = format!(
                    "{name} is 0 here, because no line of the file sets it. If you mean {other}, correct the number. If not, \
                     insert a line such as {name}=12.5 above. Ignore this if a program that ran before sets {name}: the \
                     machine keeps it until it is switched off"
                );
                self.outcome.warn(Warning { line, text });
            }
            if let Some((end, behind)) = job.behind_end() {
                let word = if end.is_tape_mark { "%" } else { "M2 or M30" };
                let (lines, were) = if behind == 1 { ("line", "was") } else { ("lines", "were") };
                self.outcome.note(format!(
                    "line {} ended the program ({word}), but {behind} more {lines} after it {were} carried out, because a sender sends them too",
                    end.line
                ));
            }
            self.outcome.complete = self.outcome.alarm.is_none() && job.is_used_up() && !job.has_failed();
        }
        self.compare_with_travel();
        self.look_for_feeds_in_inches();
        self.outcome.warnings.sort_by_key(|warning| warning.line);
    }

    /// Warns if the numbers of a job in millimetres are probably inches: the comments mention inches, the job is
    /// small, and its feeds are as slow as those of a program in inches.
    fn look_for_feeds_in_inches(&mut self) {
        /// Average feed in mm/min. Only a job with a lower average is noted. Programs in mm mostly have feeds of 100
        /// or more, and programs in inches feeds of 5 to 100.
        const SLOW: f64 = 50.0;
        /// Size in mm. Only a job that is smaller than this in X and in Y is noted, because parts of 100 inches are
        /// rare.
        const SMALL: f64 = 100.0;
        let simulator = &self.simulator;
        let (measured, feed_s) = (simulator.meter().measured(), simulator.meter().times().sum().feed_s);
        let (low, high) = simulator.machine().extents();
        let [low, high] = [low, high].map(|steps| simulator.meter().carriages_mm(steps));
        let [x, y] = [0, 1].map(|axis| high[axis] - low[axis]);
        let feed = 60.0 * (measured.distance - measured.rapid_distance) / feed_s;
        let is_metric = simulator.controller().interpreter().modal().units == Units::Mm;
        let mentions_inches = simulator.job().is_some_and(JobText::mentions_inches);
        if mentions_inches && is_metric && feed < SLOW && x.max(y) > 0.0 && x.max(y) < SMALL {
            let signs = format!(
                "the comments name inches, and as millimetres the job is only {x:.2} x {y:.2} mm, and cuts at {feed:.0} mm/min on average"
            );
            match simulator.job().and_then(JobText::metric_at) {
                Some(line) => self.outcome.warn(Warning {
                    line,
                    text: format!(
                        "G21 makes the numbers millimetres. But {signs}. If the numbers are inches, replace G21 by G20"
                    ),
                }),
                None => {
                    self.outcome.note(format!("{signs}. If the numbers are inches, write G20 above the first move"))
                }
            }
        }
    }

    /// Warns of a job whose moves cover several times the travel of an axis. The usual cause: the numbers are
    /// millimetres, but the program runs in inches.
    fn compare_with_travel(&mut self) {
        /// An axis is named if its moves cover more than this many times its travel. Less is common: many jobs are made
        /// for a larger machine than the settings describe.
        const MUCH: f64 = 5.0;
        let settings = self.simulator.controller().settings();
        let (low, high) = self.simulator.machine().extents();
        let [low, high] = [low, high].map(|steps| self.simulator.meter().carriages_mm(steps));
        let (mut axes, mut metric, mut travels) = (Vec::new(), Vec::new(), Vec::new());
        for axis in Axis::ALL.into_iter().take(LINEAR) {
            let Some([from, to]) = settings.ends_of_travel(axis) else { continue };
            let (travel, covered) = (f64::from(to - from), high[axis.index()] - low[axis.index()]);
            if covered > MUCH * travel && travel > 0.0 {
                axes.push(format!("{} over {covered:.0} mm", char::from(axis.letter())));
                metric.push(format!("{} over {:.0} mm", char::from(axis.letter()), covered / 25.4));
                travels.push(format!("{travel:.0} mm (${})", 130 + axis.index()));
            }
        }
        if axes.is_empty() {
            return;
        }
        let too_far = format!("the job moves {}, but the travel is {}", axes.join(" and "), travels.join(" and "));
        match self.simulator.job().and_then(JobText::inches_at) {
            Some(line) => self.outcome.warn(Warning {
                line,
                text: format!(
                    "G20 makes the numbers inches, so {too_far}. If the numbers are millimetres, replace G20 by G21: then the \
                     job moves {}. If they are inches, the job does not fit the machine: do not run it",
                    metric.join(" and ")
                ),
            }),
            None => self.outcome.note(format!("{too_far}: the job does not fit the machine")),
        }
    }

    /// Marks the job as incomplete. Call if its text could not be read to the end.
    pub fn cut_short(&mut self) {
        self.outcome.complete = false;
    }

    /// Number of bytes of the job that have been read so far.
    pub fn consumed(&self) -> u64 {
        self.simulator.job().map_or(0, JobText::consumed)
    }

    /// Machine time since power-up, in seconds.
    pub fn seconds(&self) -> f64 {
        self.simulator.clock().seconds(self.simulator.clock().now())
    }

    /// The simulator that runs the job.
    pub fn simulator(&self) -> &Simulator {
        &self.simulator
    }

    /// The simulator, for taking what it has collected, such as the drawing.
    pub fn simulator_mut(&mut self) -> &mut Simulator {
        &mut self.simulator
    }

    /// Returns the report up to now. `host_s`: time that the computer needed for the simulation, in seconds.
    pub fn summary(&self, name: &str, host_s: f64) -> Summary {
        let simulator = &self.simulator;
        let (clock, trace, machine) = (simulator.clock(), simulator.trace(), simulator.machine());
        let outcome = &self.outcome;
        let forecast = clock.seconds(clock.now() - self.origin);
        let measured = simulator.meter().measured();
        let times = simulator.meter().times().sum();
        let (low, high) = machine.extents();
        // The step counters began at 0 at power-up, but homing can have given the position other coordinates since. So
        // calculate distances from the present position: they are the same in all coordinates.
        let here = simulator.machine_place();
        let counted = simulator.meter().millimetres(machine.motors());
        let axes = simulator.controller().settings().axes_in_use();
        let named = |steps: [i32; AXES]| {
            let place = simulator.meter().carriages_mm(steps);
            (0..axes).map(|axis| round(place[axis] - counted[axis] + here[axis])).collect()
        };
        Summary {
            job: name.into(),
            board: simulator.board().name.into(),
            dialect: Dialect::of(simulator).map_or("?", Dialect::name).into(),
            step_clock_hz: simulator.board().step_clock_hz,
            lines: simulator.job().map_or(0, JobText::lines),
            tape_marks: simulator.job().map_or(0, JobText::tape_marks),
            errors: outcome.errors.clone(),
            more_errors: outcome.more_errors,
            warnings: outcome.warnings.clone(),
            more_warnings: outcome.more_warnings,
            alarm: outcome.alarm.clone(),
            complete: outcome.complete,
            notes: outcome.notes.clone(),
            more_notes: outcome.more_notes,
            messages: outcome.messages.clone(),
            message_lines: outcome.message_lines.clone(),
            more_messages: outcome.more_messages,
            forecast_s: forecast,
            duration_s: clock.seconds(trace.duration()),
            feed_s: round(times.feed_s),
            rapid_s: round(times.rapid_s),
            standing_s: round((forecast - times.feed_s - times.rapid_s).max(0.0)),
            dwell_s: round(times.dwell_s),
            spin_up_s: round(times.spin_up_s),
            tools: simulator.meter().times().rows().into_iter().map(rounded).collect(),
            moving_s: clock.seconds(simulator.busy_ticks()),
            position_mm: here[..axes].to_vec(),
            work_position_mm: simulator.work_place()[..axes].to_vec(),
            steps: (0..axes).map(|axis| i64::from(machine.motors()[axis]) - i64::from(self.began_at[axis])).collect(),
            pulses: machine.motor_pulses()[..axes].to_vec(),
            step_events: trace.events(),
            distance_mm: round(measured.distance),
            rapid_distance_mm: round(measured.rapid_distance),
            extents_mm: Extents { min: named(low), max: named(high) },
            travel_mm: travel(simulator),
            peak_speed_mm_s: round(measured.speed),
            peak_acceleration_mm_s2: round(measured.acceleration),
            peak_axis_speed_mm_s: measured.axis_speed.map(round)[..axes].to_vec(),
            peak_axis_acceleration_mm_s2: measured.axis_acceleration.map(round)[..axes].to_vec(),
            trace_hash: format!("{:016x}", trace.digest().time_hash()),
            order_hash: format!("{:016x}", trace.digest().order_hash()),
            host_s,
        }
    }
}

/// Returns the travel of X, Y and Z after homing, in machine coordinates.
fn travel(simulator: &Simulator) -> Extents {
    let settings = simulator.controller().settings();
    let ends = |axis: &Axis| settings.ends_of_travel(*axis).unwrap_or_default().map(|end| round(f64::from(end)));
    let (min, max) = Axis::ALL[..LINEAR].iter().map(ends).map(|[low, high]| (low, high)).unzip();
    Extents { min, max }
}

fn rounded(row: ToolTime) -> ToolTime {
    let ToolTime { tool, feed_s, rapid_s, dwell_s, spin_up_s } = row;
    let [feed_s, rapid_s, dwell_s, spin_up_s] = [feed_s, rapid_s, dwell_s, spin_up_s].map(round);
    ToolTime { tool, feed_s, rapid_s, dwell_s, spin_up_s }
}

/// Rounds to six decimals (a nanometre or a microsecond), because further digits are rounding errors.
fn round(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io;

    #[test]
    fn the_lists_of_a_report_are_bounded() {
        let text = "bad\n".repeat(KEPT_ERRORS + 5);
        let mut job = JobText::new(io::Cursor::new(text));
        while job.next_byte().is_some() {}
        let answers = "[MSG:x]\r\nerror:9\r\n".repeat(KEPT_ERRORS + 5);
        job.answered(answers.as_bytes());
        let mut outcome = Outcome::default();
        outcome.collect(&mut job);
        assert_eq!((outcome.errors.len(), outcome.more_errors), (KEPT_ERRORS, 5));
        assert_eq!(outcome.messages.len() as u64 + outcome.more_messages, KEPT_ERRORS as u64 + 5);
        for _ in 0..KEPT_MESSAGES + 3 {
            outcome.note("paused".into());
        }
        assert_eq!((outcome.notes.len(), outcome.more_notes), (KEPT_MESSAGES, 3));
    }

    #[test]
    fn a_restart_ends_a_job() {
        let summary = checked("oxmill", "G21 G90\n%\n$REBOOT\nG1 X10 F600\nG1 X0\n");
        let warnings: Vec<_> = summary.warnings.iter().map(|warning| (warning.line, warning.text.as_str())).collect();
        assert_eq!(warnings, [(3, "the board restarts here, so the lines below do not run")]);
        assert_eq!(summary.position_mm[0], 0.0);
    }

    /// An arc after a refused line starts at a wrong point. So that point may be the only reason for the arc's error.
    #[test]
    fn an_arc_behind_a_refused_line_is_not_blamed_alone() {
        let advice = |text| checked("oxmill", text).errors.into_iter().map(|error| error.advice).collect::<Vec<_>>();
        let wrong = advice("G21 G90 F400\nG1 X10\nG3 X0 Y1O I-10 J0\nG3 X-10 Y0 J-10\nG1 X0 Y0\nG3 X5 Y0 I1\n");
        let [_, second, third] = &wrong[..] else { panic!("{wrong:?}") };
        assert_eq!(second, "Line 3 was refused, so this arc starts at another point: correct that line first.");
        assert!(!third.contains("was refused"), "{third}");
    }

    /// The advice uses names, program numbers and line numbers from the rest of the file, which a check of a single
    /// line does not have.
    #[test]
    fn advice_takes_the_rest_of_the_file_into_account() {
        let wrong = checked("oxmill", "G21 G90\n#<depth>=-2\nG1 Z#<depht> F100\nG1 Z#<width> F100\n").errors;
        assert_eq!(
            [wrong[0].advice.as_str(), wrong[1].advice.contains("depth").to_string().as_str()],
            ["The file sets #<depth>: is that the name?", "false"]
        );
        let looped =
            checked("oxmill", "G21\n#<step>=2\no100 repeat [2]\n  G91 G1 Y#<setp> F400 (up)\no100 endrepeat\n").errors;
        assert_eq!(
            looped.iter().map(|error| (error.line, error.column, &*error.advice)).collect::<Vec<_>>(),
            [(4, Some(9), "The file sets #<step>: is that the name? It was stored, and line 5 ran it.")]
        );
        let unset = |text| checked("oxmill", text).warnings.into_iter().map(|warning| warning.line).collect::<Vec<_>>();
        assert_eq!(unset("G21\n#100=5\nG1 X#1000 F#100\nX[#1000+#5 + #5220]\n(#200)\n"), [3]);
        assert!(unset("G21\n#[100]=5\nG1 X#100 F100\n").is_empty());
        assert!(unset("G21\n#1=100\n##1=5\nG1 X#100 F100\n").is_empty());
        assert!(checked("grbl", "G21\nG1 X#100 F100\n").warnings.is_empty());
        // Only G20 in force, outside of comments, makes the numbers inches.
        let inches =
            |text| checked("oxmill", text).warnings.into_iter().map(|warning| warning.line).collect::<Vec<_>>();
        assert_eq!(inches("G21\nG20\nG0 X80\n"), [2]);
        assert!(inches("G20\nG21\nG0 X2000\n").is_empty() && inches("(no G20)\nG21\nG0 X2000\n").is_empty());
        let call = checked("oxmill", "o101 sub\nG91 G0 X1\no101 endsub\no110 call\n").errors;
        assert!(call[0].advice.starts_with("The only subroutine so far is o101 (line 1): call it if"), "{call:?}");
        let calls = "O1 (MAIN)\nG21 G90\nM98 P20\nM98 P20\nM30\nO21\nG1 X1 F100\nM99\n";
        let summary = checked("oxmill", calls);
        assert_eq!((summary.errors.len(), summary.errors[0].line), (1, 3), "{:?}", summary.errors);
        let later = "O1\nG21 G90\nM98 P20\nM98 P30\nM30\nO20\nG1 X1 F100\nM99\n";
        let error = &checked("oxmill", later).errors[0];
        assert_eq!((error.line, &*error.source, error.text.get(..18)), (4, "M98 P30", Some("O30 is called here")));
        let text = "O20 is called here, also in line 4, but the only subprogram in the file is O21 (line 6): write P21 if you mean that one, or write the missing one after M30, from O20 to M99";
        assert_eq!(summary.errors[0].text, text);
        assert!(!summary.messages.iter().any(|message| message.starts_with(AWAITS)), "{:?}", summary.messages);
        let one: String = (0..40).map(|at| format!("G1X{at}.123")).collect();
        let text = Box::leak(format!("G21 G90 F100\n{one}\n").into_boxed_str());
        assert!(checked("oxmill", text).errors[0].text.starts_with("several moves have run together"));
        let warned = checked("oxmill", "G21 G90\nT7 M6\nG43 H7\n").warnings;
        assert!(warned[0].text.contains("so G43 H7 adds 0") && warned[0].text.contains("G10 L1 P7 Z"), "{warned:?}");
    }

    #[test]
    fn a_missing_program_is_told_with_those_that_exist() {
        let text = |present: &[&str]| {
            missing("O7", ", also in line 8", &present.iter().map(|name| (*name).to_owned()).collect::<Vec<_>>())
        };
        assert!(
            text(&["O1"])
                .contains("is called here, also in line 8, but the only subprogram in the file is O1: write P1 if")
        );
        assert!(text(&["O1", "O2"]).contains("the file has only O1 and O2:"));
        let many = ["O1", "O2", "O3", "O4", "O5", "O6", "O8"];
        assert!(text(&many).contains("the file has only O1, O2, O3, O4, O5, .. and O8:"), "{}", text(&many));
    }

    fn checked(dialect: &str, text: &'static str) -> Summary {
        let mut simulator = Simulator::new(crate::Options::default());
        crate::power_up::apply_setting(&mut simulator, &Dialect::by_name(dialect).unwrap().assignment()).unwrap();
        let mut check = Check::new(simulator, JobText::new(text.as_bytes()));
        while !check.advance(1000) {}
        check.summary("a.nc", 0.0)
    }

    #[test]
    fn lines_that_take_hours_are_named() {
        let summary = checked("oxmill", "%\nG21 F600\nG1 X1 F0.01\n(wow!)\nG1 X2 F600\nG4 P3601\nG4 P3599\nG4 P7200");
        let warnings: Vec<_> = summary.warnings.iter().map(|warning| (warning.line, warning.text.as_str())).collect();
        let [slow, (4, _), first, second] = warnings[..] else { panic!("{warnings:?}") };
        assert_eq!(
            [slow, first, second],
            [(3, "takes 1 h 40 min 0 s"), (6, "takes 1 h 0 min 1 s"), (8, "takes 2 h 0 min 0 s")]
        );
        assert!(summary.is_good());
    }

    /// In the dialect of Grbl a slower feed is raised to 1 mm/min, as by Grbl's `MINIMUM_FEED_RATE`.
    #[test]
    fn no_feed_is_below_a_millimetre_a_minute_in_grbls_dialect() {
        for line in ["G1 X1 F0.01\n", "G93 G1 X1 F0.001\n", "$J=G91 X1 F0.01\n", "F0.01 G2 X0 Y0.6366 J0.3183\n"] {
            let summary = checked("grbl", line);
            assert!((summary.forecast_s - 60.0).abs() < 1.0, "{line}: {} s, {:?}", summary.forecast_s, summary.errors);
        }
        assert!(checked("oxmill", "G1 X0.1 F0.1\n").forecast_s > 59.0);
    }

    /// Runs a job with a spindle that needs 1.5 s to spin up and 0.75 s to stop.
    fn with_spindle_delays(text: &'static str) -> Summary {
        let mut simulator = Simulator::new(crate::Options::default());
        crate::power_up::apply_setting(&mut simulator, "394=1.5").unwrap();
        crate::power_up::apply_setting(&mut simulator, "539=0.75").unwrap();
        let mut check = Check::new(simulator, JobText::new(text.as_bytes()));
        while !check.advance(1000) {}
        let summary = check.summary("a.nc", 0.0);
        assert!(summary.is_good(), "{summary}");
        summary
    }

    /// A program in inches that runs in millimetres makes a job that is too small and too slow.
    #[test]
    fn a_small_job_with_slow_feeds_is_noted() {
        let is_noted = |text| {
            let warnings = checked("oxmill", text).warnings;
            warnings.iter().any(|warning| warning.line == 2 && warning.text.ends_with("inches, replace G21 by G20"))
        };
        assert!(is_noted("(SIZE 4 X 3 IN)\nG21 G90\nG1 Z-0.05 F8\nG1 X4 F30\nG1 Y3\nG1 X0 Y0\nM30"));
        assert!(!is_noted("(SIZE 4 X 3 IN)\nG20 G90\nG1 Z-0.05 F8\nG1 X4 F30\nG1 Y3\nM30"));
        assert!(!is_noted("(SIZE 40 X 30 IN MM)\nG21 G90\nG1 Z-1 F80\nG1 X40 F300\nG1 Y30\nM30"));
        assert!(
            !is_noted("(drill)\nG21 G81 X10 Z-2 R1 F40\nX20\nM30")
                && !is_noted("G21\nG0 X5\nM30")
                && !is_noted("G21\nG1 Z-1 F10\nM30")
                && !is_noted("M30")
        );
    }

    /// With the default settings, M6 does not wait for the moves before it. So the controller can have read the next M6
    /// while a move is still running, and the time of the move must still count for the move's own tool.
    #[test]
    fn the_time_is_told_by_tool_and_by_kind() {
        let text = "G21 G91\nM3 S1000\nG4 P0.5\nT1 M6\nG1 X3 F600\nT2 M6 G0 X-3\nG4 P2\nG82 G99 X0 Y0 Z-1 R0.5 P0.25 F600\nG80\nG4 P1 M5\nT1 M6\nG0 X1\n";
        let summary = with_spindle_delays(text);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-4, "{a} {b}: {:?}", summary.tools);
        let [none, one, two] = summary.tools[..] else { panic!("{:?}", summary.tools) };
        assert_eq!([none.tool, one.tool, two.tool], [0, 1, 2]);
        assert_eq!([none.feed_s, none.rapid_s, one.dwell_s, one.spin_up_s], [0.0; 4]);
        close(none.spin_up_s, 1.5);
        close(none.dwell_s, 0.5);
        // A move from rest to rest over d, at 10 mm/s2, takes 2 * sqrt(d / 10) s. The cycle goes up 0.5 mm, down 1 mm
        // and up 1 mm.
        let ramps = |way: f64| 2.0 * (way / 10.0).sqrt();
        close(one.feed_s, ramps(3.0));
        close(one.rapid_s, ramps(1.0));
        close(two.feed_s, ramps(1.0));
        close(two.rapid_s, ramps(3.0) + ramps(0.5) + ramps(1.0));
        close(two.dwell_s, 2.0 + 0.25 + 1.0);
        close(two.spin_up_s, 0.75);
        let sum = |part: fn(&ToolTime) -> f64| summary.tools.iter().map(part).sum::<f64>();
        close(sum(|row| row.feed_s), summary.feed_s);
        close(sum(|row| row.rapid_s), summary.rapid_s);
        close(sum(|row| row.dwell_s), summary.dwell_s);
        close(sum(|row| row.spin_up_s), summary.spin_up_s);
        // The remaining standstill time comes only from the look-ahead and the rounding to microseconds.
        assert!((summary.standing_s - summary.dwell_s - summary.spin_up_s).abs() < 0.01, "{summary}");
    }

    /// A boring cycle stops the spindle at the bottom and restarts it; the wait for the spindle is not a dwell. G4 on a
    /// line with M3 is a dwell.
    #[test]
    fn waiting_for_the_spindle_within_a_cycle_is_no_dwell() {
        let text = "G21 G91\nM3 S1000 G4 P0.5\nG86 G99 X0 Y0 Z-1 R0.5 P0.25 F600\nG80\n";
        let summary = with_spindle_delays(text);
        assert!((summary.dwell_s - 0.75).abs() < 1e-4, "{summary}");
        assert!((summary.spin_up_s - (1.5 + 0.75 + 1.5)).abs() < 1e-4, "{summary}");
    }

    /// A check numbers the moves, to find their lines and tools. The job must make the same steps at the same times
    /// without these numbers.
    #[test]
    fn marks_change_nothing_of_the_job() {
        let short: String = (1..400).map(|i| format!("N{i} G1 X{}\n", f64::from(i) * 0.003)).collect();
        let text = format!("G21 F300 T1 M6\n{short}T2 M6\nG2 X3 I2\nG0 X0\n");
        let mut check =
            Check::new(Simulator::new(crate::Options::default()), JobText::new(io::Cursor::new(text.clone())));
        while !check.advance(1000) {}
        let mut plain = Simulator::new(crate::Options::default());
        plain.begin_job();
        plain.load_job(JobText::new(io::Cursor::new(text)));
        assert!(plain.run_until_idle());
        let digest = |simulator: &Simulator| simulator.trace().digest().time_hash();
        assert_eq!(digest(check.simulator()), digest(&plain));
        assert!(check.simulator().trace().events() > 500);
    }

    /// A move keeps its tool and line, even if the last line is read while the machine is still in its first move.
    #[test]
    fn a_move_keeps_its_tool_and_line_however_many_lines_follow() {
        let text = format!("G21 G91 T5 M6\nG1 X1 F60\n{}", "F60\n".repeat(70_000));
        let mut simulator = Simulator::new(crate::Options::default());
        simulator.meter_mut().draw(crate::path::Drawing::new([0.0; 3], 0.0));
        let mut check = Check::new(simulator, JobText::new(io::Cursor::new(text)));
        while !check.advance(u32::MAX) {}
        let summary = check.summary("a.nc", 0.0);
        let tools: Vec<u32> = summary.tools.iter().filter(|row| row.feed_s > 0.0).map(|row| row.tool).collect();
        assert_eq!(tools, [5], "{summary}");
        let drawing = check.simulator_mut().meter_mut().take_drawing().expect("a drawing");
        let lines: Vec<u32> = drawing.points().iter().skip(1).map(|point| point.mark.line).collect();
        assert!(lines.iter().all(|line| *line == 2), "{lines:?}");
    }

    #[test]
    fn a_job_in_pieces_is_the_same_job() {
        let text = "G21 G91\nG1 X3 Y1 F600\nbad\nG2 X2 I1\nM0\nG0 Z1\n";
        let summary = |rounds| {
            let mut check = Check::new(Simulator::new(crate::Options::default()), JobText::new(text.as_bytes()));
            while !check.advance(rounds) {}
            assert_eq!(check.consumed(), text.len() as u64);
            check.summary("a.nc", 0.0)
        };
        let whole = summary(u32::MAX);
        assert_eq!((whole.errors.len(), whole.notes.len(), whole.complete), (1, 1, true));
        assert_eq!(summary(1), whole);
        assert_eq!(summary(7), whole);
    }
}
