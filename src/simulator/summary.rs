//! The result of a job: errors, alarm, messages, times, distances, extents, peaks and digests. Written as JSON, or as
//! text for users.

use crate::tool_times::ToolTime;
use oxmill_controller::axes::Axis;
use serde::Serialize;
use std::fmt;

/// A rejected line: a reply `error:N` with its explanation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LineError {
    /// Line number in the file, from 1.
    pub line: u64,
    /// Number of the error, as in `error:N`.
    pub code: u8,
    /// Column of the word that `text` names, in characters from 1; `None` if it names no word of the line.
    pub column: Option<u64>,
    /// What is wrong: the controller's message about the line if there was one, otherwise the explanation of `code`.
    pub text: String,
    /// The line, without blanks at its ends, cut off after 120 characters.
    pub source: String,
    /// What the user can do about the error.
    pub advice: String,
}

/// A line that is accepted but may not do what was intended.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Warning {
    /// Line number in the file, from 1.
    pub line: u64,
    /// What the line does.
    pub text: String,
}

/// The alarm that ended a job.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct AlarmReport {
    /// Number of the alarm, as in `ALARM:N`.
    pub code: u8,
    /// What the alarm means, for users.
    pub text: String,
    /// Line number of the oldest line that was unanswered at the time of the alarm, if any.
    pub line: Option<u64>,
    /// What the user can do about the alarm.
    pub advice: String,
}

/// The range of machine coordinates that was reached, in mm or degrees.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Extents {
    /// Minimum position of each axis.
    pub min: Vec<f64>,
    /// Maximum position of each axis.
    pub max: Vec<f64>,
}

impl Extents {
    /// Returns each axis with its range as text.
    pub fn rows(&self) -> impl Iterator<Item = (Axis, String)> {
        Axis::ALL.into_iter().zip(self.min.iter().zip(&self.max)).map(|(axis, (low, high))| {
            let unit = if axis.is_rotary() { "deg" } else { "mm" };
            (axis, format!("{} {low:>10.3} to {high:>10.3} {unit}", char::from(axis.letter())))
        })
    }
}

/// The complete report of a job. Field names do not change, for programs that read the JSON. Lists of axes have one
/// entry per axis in use (`$930`). Entries of A are in degrees, and distances that involve A count a degree as a
/// millimetre.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[allow(missing_docs, reason = "names and units say it; the others are explained")]
pub struct Summary {
    pub job: String,
    pub board: String,
    pub dialect: String,
    pub step_clock_hz: u32,
    /// Number of lines of the file.
    pub lines: u64,
    /// Number of tape marks in the file: lines that contain only `%`, or only `%` and comments.
    pub tape_marks: u64,
    /// The first errors, at most 1000.
    pub errors: Vec<LineError>,
    /// Number of errors beyond those in `errors`.
    pub more_errors: u64,
    /// Lines that may not do what was intended, at most 1000.
    pub warnings: Vec<Warning>,
    /// Number of warnings beyond those in `warnings`.
    pub more_warnings: u64,
    pub alarm: Option<AlarmReport>,
    /// `true` if every line was read and answered, even if with an error, and no alarm occurred.
    pub complete: bool,
    /// Notes of the simulator, such as a pause that it ended; at most 50.
    pub notes: Vec<String>,
    /// Number of notes beyond those in `notes`.
    pub more_notes: u64,
    /// Messages of the controller, at most 50.
    pub messages: Vec<String>,
    /// For each of `messages`, the line number in the file of the line that caused it; 0 if no line did.
    pub message_lines: Vec<u64>,
    /// Number of messages beyond those in `messages`.
    pub more_messages: u64,
    /// Time from the first line until the machine is at rest. A board needs this time if its link always delivers lines
    /// early enough.
    pub forecast_s: f64,
    /// Time from the first step to the last.
    pub duration_s: f64,
    /// Part of `duration_s` during which the step task was busy.
    pub moving_s: f64,
    /// Part of `forecast_s` in moves at feed: all moves except rapids.
    pub feed_s: f64,
    /// Part of `forecast_s` in rapids.
    pub rapid_s: f64,
    /// Part of `forecast_s` without motion: dwells, spindle delays, tool changes.
    pub standing_s: f64,
    /// Part of `standing_s` for G4 and the dwells of canned cycles.
    pub dwell_s: f64,
    /// Part of `standing_s` for the spindle to spin up or to stop.
    pub spin_up_s: f64,
    /// Times at feed, in rapids, in dwells and for the spindle, by tool in the order of use.
    pub tools: Vec<ToolTime>,
    /// Machine position at the end.
    pub position_mm: Vec<f64>,
    /// Work position at the end.
    pub work_position_mm: Vec<f64>,
    /// Net steps of each motor during the job.
    pub steps: Vec<i64>,
    /// Number of step pulses of each motor, both directions added up.
    pub pulses: Vec<u64>,
    /// Number of step events. Simultaneous pulses of several axes are one event.
    pub step_events: u64,
    pub distance_mm: f64,
    pub rapid_distance_mm: f64,
    pub extents_mm: Extents,
    /// Ends of the travel of X, Y and Z after homing, in machine coordinates. They follow from the settings.
    pub travel_mm: Extents,
    /// Maximum path speed, averaged over a few milliseconds or more. What rounding to steps may have added is
    /// subtracted.
    pub peak_speed_mm_s: f64,
    /// Maximum change of path speed per time (on ramps), averaged and reduced like `peak_speed_mm_s`. Excludes the
    /// acceleration across the path in curves and corners.
    pub peak_acceleration_mm_s2: f64,
    /// Maximum speed of each axis, averaged and reduced like `peak_speed_mm_s`.
    pub peak_axis_speed_mm_s: Vec<f64>,
    /// Maximum acceleration of each axis on ramps: the change of path speed per time, times the share of the axis in
    /// the path's direction.
    pub peak_axis_acceleration_mm_s2: Vec<f64>,
    /// Hash over (time in step-clock ticks, step bits, direction bits) of each step event.
    pub trace_hash: String,
    /// Hash over the step and direction bits in their order, without the times.
    pub order_hash: String,
    /// Time that the computer needed for the simulation, in seconds.
    pub host_s: f64,
}

impl Summary {
    /// Returns the number of all errors, including those beyond the list `errors`.
    pub fn error_count(&self) -> u64 {
        self.errors.len() as u64 + self.more_errors
    }

    /// Returns the number of all warnings, including those beyond the list `warnings`.
    pub fn warning_count(&self) -> u64 {
        self.warnings.len() as u64 + self.more_warnings
    }

    /// Returns the parts of the forecast as a line of text: time at feed, in rapids and standing.
    pub fn parts(&self) -> String {
        let parts = [("at feed", self.feed_s), ("in rapids", self.rapid_s), ("standing", self.standing_s)];
        let standing = [("dwell", self.dwell_s), ("spindle", self.spin_up_s)];
        let standing: Vec<_> = standing.iter().filter(|(_, seconds)| *seconds > 0.0).map(named_time).collect();
        let parts = parts.iter().map(named_time).collect::<Vec<_>>().join(", ");
        if standing.is_empty() { parts } else { format!("{parts} ({})", standing.join(", ")) }
    }

    /// Returns a line for each tool if there are several tools, otherwise nothing.
    pub fn several_tools(&self) -> Vec<String> {
        let line = |row: &ToolTime| {
            let parts = [
                ("at feed", row.feed_s),
                ("in rapids", row.rapid_s),
                ("dwell", row.dwell_s),
                ("spindle", row.spin_up_s),
            ];
            let parts: Vec<_> = parts.iter().filter(|(_, seconds)| *seconds > 0.0).map(named_time).collect();
            format!("T{}: {}", row.tool, parts.join(", "))
        };
        if self.tools.len() > 1 { self.tools.iter().map(line).collect() } else { Vec::new() }
    }

    /// Returns whether every line was accepted, no alarm occurred and the job was completed.
    pub fn is_good(&self) -> bool {
        self.errors.is_empty() && self.alarm.is_none() && self.complete
    }
}

fn named_time((name, seconds): &(&str, f64)) -> String {
    format!("{} {name}", clock_time(*seconds))
}

/// Maximum number of errors, and of warnings, in the text for users.
const SHOWN_ERRORS: usize = 20;

impl fmt::Display for Summary {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let row = |f: &mut fmt::Formatter<'_>, name: &str, text: String| writeln!(f, "  {name:<14}{text}");
        writeln!(f, "{} on {} ({} MHz step clock)", self.job, self.board, f64::from(self.step_clock_hz) / 1e6)?;
        let tape = match self.tape_marks {
            0 => String::new(),
            1 => ", 1 of them a tape mark (%) that was left out".into(),
            marks => format!(", {marks} of them tape marks (%) that were left out"),
        };
        row(f, "lines", format!("{}{tape}", self.lines))?;
        let ended = match (self.complete, &self.alarm) {
            (_, Some(alarm)) => {
                let place = alarm.line.map_or(String::new(), |line| format!(" at line {line}"));
                format!("ALARM:{}{place}: {}", alarm.code, alarm.text)
            }
            (true, None) => "taken to the end".into(),
            (false, None) => "not taken to the end".into(),
        };
        row(f, "job", ended)?;
        // Show equal consecutive messages once, with their number: the same reason can lead to many errors.
        for (message, times) in runs(&self.messages) {
            row(f, "message", if times > 1 { format!("{message} ({times} times)") } else { message.into() })?;
        }
        if self.more_messages > 0 {
            row(f, "", format!("and {}", counted(self.more_messages, "more message")))?;
        }
        row(f, "errors", if self.errors.is_empty() { "none".into() } else { self.error_count().to_string() })?;
        for error in self.errors.iter().take(SHOWN_ERRORS) {
            let column = error.column.map_or(String::new(), |column| format!(", column {column}"));
            writeln!(f, "    line {}{column}: error:{} ({}): {}", error.line, error.code, error.text, error.source)?;
        }
        if self.error_count() > SHOWN_ERRORS as u64 {
            writeln!(f, "    and {} more", self.error_count() - SHOWN_ERRORS as u64)?;
        }
        if self.warning_count() > 0 {
            row(f, "warnings", self.warning_count().to_string())?;
        }
        for warning in self.warnings.iter().take(SHOWN_ERRORS) {
            writeln!(f, "    line {}: {}", warning.line, warning.text)?;
        }
        if self.warning_count() > SHOWN_ERRORS as u64 {
            writeln!(f, "    and {} more", self.warning_count() - SHOWN_ERRORS as u64)?;
        }
        row(f, "forecast", format!("{} from the first line to rest", clock_time(self.forecast_s)))?;
        let (first_to_last, moving) = (clock_time(self.duration_s), clock_time(self.moving_s));
        row(f, "duration", format!("{first_to_last} from the first step to the last, moving for {moving}"))?;
        row(f, "", self.parts())?;
        for tool in self.several_tools() {
            row(f, "", tool)?;
        }
        let cutting = self.distance_mm - self.rapid_distance_mm;
        row(f, "distance", format!("{:.3} mm, {:.3} mm of it at feed", self.distance_mm, cutting))?;
        for (axis, ends) in self.extents_mm.rows() {
            row(f, if axis == Axis::X { "extents" } else { "" }, ends)?;
        }
        row(
            f,
            "ends at",
            format!("machine {}, work {} mm", place_text(&self.position_mm), place_text(&self.work_position_mm)),
        )?;
        let steps = self.steps.iter().map(i64::to_string).collect::<Vec<_>>().join(", ");
        row(f, "steps", format!("net {steps}; {} step events", self.step_events))?;
        row(
            f,
            "peaks",
            format!(
                "{:.1} mm/min, {:.1} mm/s2 along the path",
                self.peak_speed_mm_s * 60.0,
                self.peak_acceleration_mm_s2
            ),
        )?;
        row(
            f,
            "",
            format!(
                "{}: {} mm/min; {} mm/s2",
                self.extents_mm
                    .rows()
                    .map(|(axis, _)| char::from(axis.letter()).to_string())
                    .collect::<Vec<_>>()
                    .join(", "),
                list(self.peak_axis_speed_mm_s.iter().map(|v| v * 60.0)),
                list(self.peak_axis_acceleration_mm_s2.iter().copied())
            ),
        )?;
        row(f, "hashes", format!("trace {}, order {}", self.trace_hash, self.order_hash))?;
        for note in &self.notes {
            row(f, "note", note.clone())?;
        }
        if self.more_notes > 0 {
            row(f, "", format!("and {}", counted(self.more_notes, "more note")))?;
        }
        let faster = if self.host_s > 0.0 { self.forecast_s / self.host_s } else { 0.0 };
        row(f, "simulated in", format!("{:.2} s, {faster:.0} times faster than the machine", self.host_s))
    }
}

fn place_text(place: &[f64]) -> String {
    place.iter().map(|v| format!("{v:.3}")).collect::<Vec<_>>().join(", ")
}

fn list(values: impl Iterator<Item = f64>) -> String {
    values.map(|v| format!("{v:.1}")).collect::<Vec<_>>().join(", ")
}

/// Formats a number of items, such as `1 line` or `3 lines`. `name`: the singular.
pub fn counted(number: u64, name: &str) -> String {
    format!("{number} {name}{}", if number == 1 { "" } else { "s" })
}

/// Returns runs of equal consecutive texts, with their lengths.
fn runs(texts: &[String]) -> impl Iterator<Item = (&str, usize)> {
    texts.chunk_by(|a, b| a == b).map(|run| (run[0].as_str(), run.len()))
}

/// Formats a duration, such as `1.500 s`, `1 min 35.0 s` or `1 h 2 min 6 s`. Rounds before it splits, so that 1 min
/// 59.98 s becomes 2 min 0.0 s.
pub fn clock_time(seconds: f64) -> String {
    let tenths = (seconds * 10.0).round();
    if (seconds * 1000.0).round() < 60_000.0 {
        return format!("{seconds:.3} s");
    }
    if tenths < 36_000.0 {
        let minutes = (tenths / 600.0).floor();
        return format!("{minutes:.0} min {:.1} s", (tenths - minutes * 600.0) / 10.0);
    }
    let whole = seconds.round();
    let (hours, minutes) = ((whole / 3600.0).floor(), (whole / 60.0).floor());
    format!("{hours:.0} h {:.0} min {:.0} s", minutes - hours * 60.0, whole - minutes * 60.0)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    pub(crate) fn example() -> Summary {
        Summary {
            job: "a.nc".into(),
            board: "desk".into(),
            dialect: "oxmill".into(),
            step_clock_hz: 100_000_000,
            lines: 3,
            tape_marks: 0,
            more_errors: 0,
            warnings: vec![],
            more_warnings: 0,
            more_notes: 0,
            more_messages: 0,
            errors: vec![LineError {
                line: 2,
                code: 20,
                column: Some(4),
                text: "unknown".into(),
                source: "G1 Q1".into(),
                advice: "".into(),
            }],
            alarm: None,
            complete: true,
            notes: vec![],
            messages: vec![],
            message_lines: vec![],
            forecast_s: 3725.5,
            duration_s: 3700.0,
            moving_s: 3699.0,
            feed_s: 3600.0,
            rapid_s: 99.0,
            standing_s: 26.5,
            dwell_s: 20.0,
            spin_up_s: 6.5,
            tools: vec![ToolTime { tool: 1, feed_s: 3600.0, rapid_s: 99.0, dwell_s: 20.0, spin_up_s: 6.5 }],
            position_mm: vec![1.0, -2.0, 0.0],
            work_position_mm: vec![0.0; 3],
            steps: vec![250, -500, 0],
            pulses: vec![250, 500, 0],
            step_events: 500,
            distance_mm: 2.5,
            rapid_distance_mm: 0.5,
            extents_mm: Extents { min: vec![0.0, -2.0, 0.0], max: vec![1.0, 0.0, 0.0] },
            travel_mm: Extents { min: vec![-200.0; 3], max: vec![0.0; 3] },
            peak_speed_mm_s: 10.0,
            peak_acceleration_mm_s2: 10.0,
            peak_axis_speed_mm_s: vec![5.0, 10.0, 0.0],
            peak_axis_acceleration_mm_s2: vec![5.0, 10.0, 0.0],
            trace_hash: "00ff".into(),
            order_hash: "ff00".into(),
            host_s: 1.0,
        }
    }

    #[test]
    fn the_json_has_the_promised_fields() {
        let json = serde_json::to_value(example()).unwrap();
        for name in [
            "lines",
            "errors",
            "alarm",
            "duration_s",
            "position_mm",
            "work_position_mm",
            "steps",
            "distance_mm",
            "extents_mm",
            "trace_hash",
            "order_hash",
            "step_clock_hz",
            "board",
        ] {
            assert!(json.get(name).is_some(), "{name}");
        }
        assert_eq!(json["errors"][0]["line"], 2);
        assert_eq!(json["errors"][0]["code"], 20);
        assert!(json["errors"][0]["text"].is_string());
        assert_eq!(json["extents_mm"]["min"][1], -2.0);
        assert!(json["alarm"].is_null());
    }

    #[test]
    fn warnings_are_shown_and_make_no_job_bad() {
        let mut summary = example();
        summary.errors.clear();
        assert!(!summary.to_string().contains("warnings"));
        summary.warnings = vec![Warning { line: 3, text: "holds".into() }; 25];
        summary.more_warnings = 2;
        let text = summary.to_string();
        assert!(
            text.contains("  warnings      27\n    line 3: holds\n") && text.contains("    and 7 more\n"),
            "{text}"
        );
        assert!(summary.is_good());
    }

    #[test]
    fn only_a_flawless_job_is_good() {
        let mut summary = example();
        assert!(!summary.is_good());
        summary.errors.clear();
        assert!(summary.is_good());
        summary.complete = false;
        assert!(!summary.is_good());
    }

    #[test]
    fn lists_that_were_cut_short_are_counted_whole() {
        let mut summary = example();
        summary.errors = vec![summary.errors[0].clone(); 1000];
        summary.more_errors = 234;
        summary.messages = ["[MSG:a]", "[MSG:a]", "[MSG:b]"].map(String::from).to_vec();
        summary.more_messages = 1;
        let text = summary.to_string();
        assert!(text.contains("  errors        1234\n") && text.contains("    and 1214 more\n"), "{text}");
        assert!(text.contains("[MSG:a] (2 times)\n") && text.contains("and 1 more message\n"), "{text}");
        assert!(text.find("[MSG:a]") < text.find("error:20"), "the reason comes before what it led to");
    }

    #[test]
    fn people_read_times() {
        assert_eq!(clock_time(1.5), "1.500 s");
        assert_eq!(clock_time(95.0), "1 min 35.0 s");
        assert_eq!(clock_time(3725.5), "1 h 2 min 6 s");
        assert_eq!(clock_time(59.9996), "1 min 0.0 s");
        assert_eq!(clock_time(599.98), "10 min 0.0 s");
        assert_eq!(clock_time(3599.97), "1 h 0 min 0 s");
        assert_eq!(clock_time(7199.6), "2 h 0 min 0 s");
        assert!(example().to_string().contains("line 2, column 4: error:20 (unknown): G1 Q1"));
        assert!(example().to_string().contains("26.500 s standing (20.000 s dwell, 6.500 s spindle)"));
    }

    #[test]
    fn several_tools_have_a_line_each() {
        let mut summary = example();
        assert!(summary.several_tools().is_empty());
        summary.tools.push(ToolTime { tool: 12, rapid_s: 3.0, ..ToolTime::default() });
        assert_eq!(summary.several_tools()[1], "T12: 3.000 s in rapids");
        let text = summary.to_string();
        assert!(text.contains("T1: 60 min 0.0 s at feed") || text.contains("T1: 1 h 0 min 0 s at feed"), "{text}");
    }
}
