//! The report of `check` on one screen: verdict, first rejected lines with advice, alarm, messages, times by tool, and
//! extents. Long lists are truncated, with the number of further entries.

use crate::advice::PRINTER;
use crate::boards;
use crate::check::NO_TOOLS;
use crate::summary::{Summary, clock_time, counted};
use anstyle::{AnsiColor, Style};
use oxmill_controller::axes::Axis;
use std::fmt;

/// Maximum number of rejected lines in the report.
const SHOWN_ERRORS: usize = 8;

const GOOD: Style = AnsiColor::Green.on_default().bold();
const BAD: Style = AnsiColor::Red.on_default().bold();
const WARNING: Style = AnsiColor::Yellow.on_default();
const FAINT: Style = Style::new().dimmed();

/// Formats a summary for one screen of a terminal, with colours.
#[derive(Clone, Copy, Debug)]
pub struct ShortReport<'a>(pub &'a Summary);

impl fmt::Display for ShortReport<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self(summary) = self;
        let (style, verdict) = verdict(summary);
        writeln!(
            f,
            "{style}{verdict}{style:#}: {}{}, {}",
            summary.job,
            // The simulator's own board needs no mention.
            if summary.board == boards::DESK.name { String::new() } else { format!(" on {}", summary.board) },
            counted(summary.lines, "line")
        )?;
        let mut shown: Vec<&str> = Vec::new();
        // This advice is about the whole program, so it comes first.
        let is_of_printer = summary.errors.iter().any(|error| error.advice == PRINTER);
        if is_of_printer {
            writeln!(f, "  {PRINTER}")?;
        }
        for error in summary.errors.iter().take(SHOWN_ERRORS) {
            writeln!(f, "  line {}: {}", error.line, error.source)?;
            writeln!(f, "    {BAD}error:{}{BAD:#} {}", error.code, error.text)?;
            // Show the same advice only once, at the first error that has it.
            let is_new = !shown.contains(&error.advice.as_str()) && !is_of_printer;
            if is_new && !error.advice.is_empty() {
                writeln!(f, "    {FAINT}{}{FAINT:#}", error.advice)?;
                shown.push(&error.advice);
            }
        }
        if summary.error_count() > SHOWN_ERRORS as u64 {
            writeln!(f, "  and {} more", summary.error_count() - SHOWN_ERRORS as u64)?;
        }
        if let Some(alarm) = &summary.alarm {
            let place = alarm.line.map_or(String::new(), |line| format!(" at line {line}"));
            writeln!(f, "  {BAD}ALARM:{}{BAD:#}{place}: {}", alarm.code, alarm.text)?;
            writeln!(f, "    {FAINT}{}{FAINT:#}", alarm.advice)?;
        }
        for warning in summary.warnings.iter().take(SHOWN_ERRORS) {
            writeln!(f, "  {WARNING}warning, line {}{WARNING:#}: {}", warning.line, warning.text)?;
        }
        if summary.warning_count() > SHOWN_ERRORS as u64 {
            writeln!(f, "  and {} more warnings", summary.warning_count() - SHOWN_ERRORS as u64)?;
        }
        for note in summary.notes.iter().take(SHOWN_ERRORS) {
            writeln!(f, "  {WARNING}note{WARNING:#}: {note}")?;
        }
        // Omit the message that no tool is in the table, because the warning about G43 says more. Also omit the message
        // of a normal end.
        let is_shown = |message: &String| !message.starts_with(NO_TOOLS) && message != "[MSG:Pgm End]";
        let messages = summary.messages.iter().zip(&summary.message_lines).filter(|(message, _)| is_shown(message));
        for (message, line) in messages.take(SHOWN_ERRORS) {
            let place = if *line > 0 { format!("line {line}: ") } else { String::new() };
            writeln!(f, "  {place}{message}")?;
        }
        // A program for another kind of machine has no time and no extents worth showing.
        if is_of_printer {
            return Ok(());
        }
        if !summary.errors.is_empty() {
            writeln!(
                f,
                "  {FAINT}The rest is about the job without the refused lines. The corrected job will differ.{FAINT:#}"
            )?;
        }
        writeln!(f, "  time     {}", clock_time(summary.forecast_s))?;
        writeln!(f, "           {}", summary.parts())?;
        for tool in summary.several_tools().iter().take(SHOWN_ERRORS) {
            writeln!(f, "           {tool}")?;
        }
        if let Some(more) = summary.several_tools().len().checked_sub(SHOWN_ERRORS).filter(|more| *more > 0) {
            writeln!(f, "           and {more} more tools")?;
        }
        for (axis, ends) in summary.extents_mm.rows() {
            let title = if axis == Axis::X { "extents" } else { "" };
            writeln!(f, "  {title:<9}{ends} (machine coordinates)")?;
        }
        Ok(())
    }
}

fn verdict(summary: &Summary) -> (Style, String) {
    if summary.alarm.is_some() {
        (BAD, "ends in an alarm".into())
    } else if !summary.errors.is_empty() {
        let warnings = if_any(", ", summary.warning_count(), "warning");
        (BAD, format!("{} refused{warnings}", counted(summary.error_count(), "line")))
    } else if !summary.complete {
        (BAD, "not taken to the end".into())
    } else {
        let warnings = if_any(", with ", summary.warning_count(), "warning");
        let notes = if_any(", with ", summary.notes.len() as u64 + summary.more_notes, "note");
        (GOOD, format!("every line is accepted{warnings}{notes}"))
    }
}

/// Returns a count with its noun after `before`, such as `, with 2 notes`; an empty text if the count is 0.
fn if_any(before: &str, count: u64, noun: &str) -> String {
    if count == 0 { String::new() } else { format!("{before}{}", counted(count, noun)) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::summary::Warning;
    use crate::summary::tests::example;

    #[test]
    fn the_report_fits_on_a_screen_whatever_happened() {
        let mut summary = example();
        summary.errors = vec![summary.errors[0].clone(); 1000];
        summary.messages = vec!["[MSG:x]".into(); 50];
        summary.message_lines = vec![3; 50];
        summary.warnings = vec![Warning { line: 3, text: "holds".into() }; 1000];
        let text = ShortReport(&summary).to_string();
        assert!(text.contains("1000 lines refused") && text.contains("and 992 more"), "{text}");
        assert!(text.contains("line 3") && text.contains("and 992 more warnings"), "{text}");
        assert!(text.lines().count() <= 50, "{text}");
        assert!(text.contains("without the refused lines"));
    }

    #[test]
    fn a_good_job_has_no_red() {
        let mut summary = example();
        summary.errors.clear();
        let text = ShortReport(&summary).to_string();
        assert!(text.contains("every line is accepted") && !text.contains(&BAD.to_string()), "{text}");
        assert!(text.contains("1 h 2 min 6 s") && text.contains("-2.000"), "{text}");
    }
}
