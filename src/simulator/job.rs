//! `run`: a file through the controller, in simulated time, and the report about it.

use crate::command_line::{Dialect, MachineOptions, Run};
use crate::files::{self, Output, Role};
use crate::fittings::Fittings;
use crate::path::Drawing;
use crate::plot;
use crate::simulator::{Options, Simulator};
use crate::store::Store;
use crate::summary::{AlarmReport, Extents, LineError, Summary};
use crate::text::{self, JobText, Said};
use crate::trace::Csv;
use anyhow::{Context, Result, anyhow, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use oxmill_controller::error::Error;
use oxmill_controller::messages::Realtime;
use oxmill_controller::settings::{Key, SCALARS};
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::time::Instant;

/// Rounds of the virtual clock between looks at the progress: some 10 ms of the host.
const ROUNDS: u32 = 4096;
/// Errors that the report keeps. The others are counted.
const KEPT_ERRORS: usize = 1000;
/// Messages of the controller, and notes of the simulator, that the report keeps. The others are counted.
const KEPT_MESSAGES: usize = 50;

/// What a power cut ordered on the command line leaves of the word under way.
const HALF_WORD: u32 = 0xFFFF;

/// Says so if an ordered power cut has come.
pub fn check_power(simulator: &Simulator) -> Result<()> {
    if simulator.power_is_gone() {
        bail!("the power was cut, as ordered, at operation {} of the flash", simulator.store().operations());
    }
    Ok(())
}

/// Refuses a job on settings that may not be the machine's: it would be locked.
fn check_store(simulator: &Simulator, store: Option<&Path>) -> Result<()> {
    if simulator.controller().is_store_damaged() {
        let name = store.unwrap_or(Path::new("store")).display();
        bail!(
            "the settings in {name} were damaged, and some may be lost: motion is locked. Look at them and confirm them with \
             `oxmill serve --stdio --store {name}`: $$, and two seconds later $X"
        );
    }
    Ok(())
}

/// A simulator as the options describe it, its settings applied.
pub fn power_up(options: &MachineOptions) -> Result<Simulator> {
    let mut store = options.store.as_deref().map_or_else(|| Ok(Store::in_memory()), Store::open)?;
    if let Some(operations) = options.cut_power {
        store.cut_power_after(operations, HALF_WORD);
    }
    let fittings = options.machine.as_deref().map_or_else(|| Ok(Fittings::default()), Fittings::read)?;
    let mut simulator = Simulator::new(Options { board: options.board(), store, fittings, keep_steps: false });
    simulator.run_until_idle();
    let mut lines = Vec::new();
    if let Some(path) = &options.settings {
        let text = files::read(path, files::TEXT)
            .with_context(|| format!("cannot read the settings file {}", path.display()))?;
        for (index, line) in String::from_utf8_lossy(&text).lines().enumerate() {
            // Comments and blank lines may stand between the settings, as in a dump that someone edited.
            let setting = line.split([';', '#', '(']).next().unwrap_or_default().trim();
            if !setting.is_empty() {
                lines.push((format!("line {} of {}", index + 1, path.display()), setting.to_owned()));
            }
        }
    }
    lines.extend(options.set.iter().map(|setting| (format!("--set {setting}"), setting.trim().to_owned())));
    if let Some(dialect) = options.dialect {
        let number = SCALARS[Key::Dialect as usize].number;
        lines.push((format!("--dialect {}", dialect.name()), format!("${number}={}", dialect.setting())));
    }
    for (origin, setting) in lines {
        apply_setting(&mut simulator, &origin, &setting)?;
    }
    Ok(simulator)
}

fn apply_setting(simulator: &mut Simulator, origin: &str, setting: &str) -> Result<()> {
    let assignment = setting.strip_prefix('$').unwrap_or(setting);
    // The wire has realtime commands, none of which a setting can need.
    let plain = assignment.bytes().all(|byte| byte.is_ascii_graphic() && !b"?!~".contains(&byte) || byte == b' ');
    if !plain || !assignment.contains('=') {
        bail!("{origin} is not of the form $n=v");
    }
    simulator.take_output();
    simulator.send(format!("${assignment}\n"));
    simulator.run_until_idle();
    check_power(simulator)?;
    for answer in simulator.take_output().lines() {
        if let Some(code) = answer.strip_prefix("error:").and_then(|code| code.parse().ok()) {
            bail!("{origin} was refused with error:{code}: {}", error_text(code));
        }
    }
    Ok(())
}

/// The setting of the dialect, by name.
pub fn dialect(simulator: &Simulator) -> &'static str {
    let value = simulator.controller().settings().whole(Key::Dialect);
    let all = [Dialect::Grbl, Dialect::Oxmill, Dialect::Seed];
    all.into_iter().find(|d| u32::from(d.setting()) == value).map_or("?", Dialect::name)
}

/// Carries out `run`. The result is whether the job went without a fault.
pub fn run(options: &Run) -> Result<bool> {
    let started = Instant::now();
    for path in &options.plot {
        plot::format_of(path)?;
    }
    files::check_apart(&roles(options))?;
    let name = if options.job.as_os_str() == "-" { "standard input".into() } else { options.job.display().to_string() };
    let (reader, length) = text::open(&options.job).with_context(|| format!("cannot read the job {name}"))?;
    let plots = options.plot.iter().map(|path| output(path, "drawing")).collect::<Result<Vec<_>>>()?;
    let trace = options.trace.as_deref().map(|path| output(path, "trace")).transpose()?;
    let mut simulator = power_up(&options.machine)?;
    check_store(&simulator, options.machine.store.as_deref())?;
    let origin = simulator.clock().now();
    if let Some(trace) = trace {
        let path = trace.path().display().to_string();
        let csv = trace.begin().and_then(|file| Csv::new(file, simulator.board().step_clock_hz, origin));
        let csv = csv.with_context(|| format!("cannot write the trace {path}"))?;
        simulator.trace_mut().write_csv(csv);
    }
    if !options.plot.is_empty() {
        let start = simulator.meter().millimetres(simulator.machine().position());
        let seconds = simulator.clock().seconds(origin);
        simulator.meter_mut().draw(Drawing::new(start, seconds));
    }

    let progress = progress_bar(length);
    let outcome = run_text(&mut simulator, JobText::new(reader), &progress);
    progress.finish_and_clear();
    check_power(&simulator)?;
    let mut job = simulator.unload_job().context("the job was lost")?;
    // Whatever fails from here on, the summary is printed first.
    let mut outcome = outcome;
    let failure = job.failure().map(|e| anyhow!(e).context(format!("cannot read the job {name} to its end")));
    outcome.complete &= failure.is_none();
    let mut failures = Vec::from_iter(failure);
    failures.extend(simulator.trace_mut().finish().context("cannot write the trace to its end").err());
    let summary = summarise(&simulator, &job, outcome, origin, base_name(&options.job), started);
    print(&summary, options.json)?;
    if let Some(drawing) = simulator.meter_mut().take_drawing() {
        failures.extend(plots.into_iter().filter_map(|plot| plot::write(plot, &drawing, &summary).err()));
    }
    let mut failures = failures.into_iter();
    let Some(first) = failures.next() else { return Ok(summary.is_good()) };
    for other in failures {
        eprintln!("oxmill: {other:#}");
    }
    Err(first)
}

/// The files of a run and what they are for.
fn roles(options: &Run) -> Vec<Role<'_>> {
    let job = (options.job.as_os_str() != "-").then_some(options.job.as_path());
    let machine = &options.machine;
    let read =
        [(job, "the job"), (machine.settings.as_deref(), "--settings"), (machine.machine.as_deref(), "--machine")];
    let written = [(machine.store.as_deref(), "--store"), (options.trace.as_deref(), "--trace")];
    let written = written.into_iter().chain(options.plot.iter().map(|path| (Some(path.as_path()), "--plot")));
    let read = read.into_iter().map(|file| (file, false));
    let role = |((path, name), written): ((Option<_>, _), _)| path.map(|path| Role { path, name, written });
    read.chain(written.map(|file| (file, true))).filter_map(role).collect()
}

fn output(path: &Path, name: &str) -> Result<Output> {
    Output::open(path).with_context(|| format!("cannot write the {name} {}", path.display()))
}

fn print(summary: &Summary, json: bool) -> Result<()> {
    let text = if json { serde_json::to_string_pretty(summary)? + "\n" } else { summary.to_string() };
    match io::stdout().write_all(text.as_bytes()) {
        // A reader that has seen enough, such as `head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written.context("cannot write the summary")?,
    }
    Ok(())
}

fn base_name(path: &Path) -> String {
    if path.as_os_str() == "-" {
        return "standard input".into();
    }
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}

/// What became of a job.
#[derive(Debug, Default)]
struct Outcome {
    errors: Vec<LineError>,
    more_errors: u64,
    messages: Vec<String>,
    more_messages: u64,
    notes: Vec<String>,
    more_notes: u64,
    alarm: Option<AlarmReport>,
    complete: bool,
}

impl Outcome {
    fn hear(&mut self, job: &mut JobText) {
        for said in job.said() {
            match said {
                Said::Error { line, code, text } => self.refused(line, code, error_text(code), text),
                Said::Message(text) if self.messages.len() < KEPT_MESSAGES => self.messages.push(text),
                Said::Message(_) => self.more_messages += 1,
            }
        }
    }

    fn refused(&mut self, line: u64, code: u8, text: &str, source: String) {
        if self.errors.len() < KEPT_ERRORS {
            self.errors.push(LineError { line, code, text: text.into(), source });
        } else {
            self.more_errors += 1;
        }
    }

    /// A subroutine, loop or condition that has not come to its end with the file: what is in it was not carried out, or
    /// not as it was meant.
    fn look_for_open_block(&mut self, since: Option<u32>, job: &JobText) {
        if let Some((line, source)) = since.and_then(|line| job.opener(line)) {
            let source = source.to_owned();
            self.refused(line, Error::FlowSyntax.code(), "the program ended within the block that begins here", source);
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

fn run_text(simulator: &mut Simulator, job: JobText, progress: &ProgressBar) -> Outcome {
    let mut outcome = Outcome::default();
    simulator.begin_job();
    simulator.take_output();
    simulator.load_job(job);
    let mut round = 0_u32;
    loop {
        if simulator.unfetched() > 0 {
            simulator.take_output();
            let is_open = simulator.controller().open_since().is_some();
            if let Some(job) = simulator.job_mut() {
                outcome.hear(job);
                if !is_open {
                    job.forget_openers();
                }
            }
        }
        if outcome.alarm.is_none()
            && let Some(alarm) = simulator.controller().alarm()
        {
            let line = simulator.job().and_then(JobText::oldest_unanswered);
            outcome.alarm = Some(AlarmReport { code: alarm.code(), text: alarm.text().into(), line });
            if let Some(job) = simulator.job_mut() {
                job.stop();
            }
        }
        if simulator.is_idle() {
            break;
        }
        if simulator.controller().is_paused() {
            let line = simulator.job().and_then(JobText::oldest_unanswered).unwrap_or_default();
            outcome.note(format!("line {line} paused the program; cycle start was pressed at once"));
            simulator.press(Realtime::CycleStart);
            continue;
        }
        if !simulator.advance_once(u64::MAX) && simulator.unfetched() == 0 {
            if outcome.alarm.is_none() {
                let line = simulator.job().and_then(JobText::oldest_unanswered).unwrap_or_default();
                outcome.note(format!("line {line} waits for something that will not come"));
            }
            break;
        }
        round += 1;
        if round.is_multiple_of(ROUNDS)
            && let Some(job) = simulator.job()
        {
            progress.set_position(job.consumed());
            progress.set_message(crate::summary::clock_time(simulator.clock().seconds(simulator.clock().now())));
        }
    }
    simulator.take_output();
    let open_since = simulator.controller().open_since();
    if let Some(job) = simulator.job_mut() {
        outcome.hear(job);
        outcome.look_for_open_block(open_since, job);
        outcome.complete = outcome.alarm.is_none() && job.is_used_up();
    }
    outcome
}

fn progress_bar(length: Option<u64>) -> ProgressBar {
    // Standard error may be a terminal while standard output goes to a file: the bar is for the person who waits.
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = length.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
    bar.set_draw_target(ProgressDrawTarget::stderr());
    ProgressStyle::with_template(progress_template(length.is_some())).map_or(bar.clone(), |style| bar.with_style(style))
}

/// No time to go: it would have to be told from the part of the file that was read, and a line may take a second or a day.
fn progress_template(length_is_known: bool) -> &'static str {
    if length_is_known {
        "{bar:40} {percent:>3} % of the file read, {msg} of machine time in {elapsed}"
    } else {
        "{spinner} {msg} of machine time in {elapsed}"
    }
}

fn summarise(
    simulator: &Simulator,
    job: &JobText,
    outcome: Outcome,
    origin: u64,
    name: String,
    started: Instant,
) -> Summary {
    let (clock, trace, machine) = (simulator.clock(), simulator.trace(), simulator.machine());
    let measured = simulator.meter().measured();
    let (low, high) = machine.extents();
    // The step counter began at 0 at power-up; homing may have given the place another name since.
    let here = simulator.machine_position();
    let counted = simulator.meter().millimetres(machine.position());
    let named = |steps: [i32; 3]| {
        let place = simulator.meter().carriages_mm(steps);
        std::array::from_fn(|axis| round(place[axis] - counted[axis] + here[axis]))
    };
    Summary {
        job: name,
        board: simulator.board().name.into(),
        dialect: dialect(simulator).into(),
        step_clock_hz: simulator.board().step_clock_hz,
        lines: job.lines(),
        tape_marks: job.tape_marks(),
        errors: outcome.errors,
        more_errors: outcome.more_errors,
        alarm: outcome.alarm,
        complete: outcome.complete,
        notes: outcome.notes,
        more_notes: outcome.more_notes,
        messages: outcome.messages,
        more_messages: outcome.more_messages,
        forecast_s: clock.seconds(clock.now() - origin),
        duration_s: clock.seconds(trace.duration()),
        moving_s: clock.seconds(simulator.busy_ticks()),
        position_mm: here,
        work_position_mm: simulator.work_position(),
        steps: machine.position().map(i64::from),
        pulses: machine.pulses(),
        step_events: trace.events(),
        distance_mm: round(measured.distance),
        rapid_distance_mm: round(measured.rapid_distance),
        extents_mm: Extents { min: named(low), max: named(high) },
        peak_speed_mm_s: round(measured.speed),
        peak_acceleration_mm_s2: round(measured.acceleration),
        peak_axis_speed_mm_s: measured.axis_speed.map(round),
        peak_axis_acceleration_mm_s2: measured.axis_acceleration.map(round),
        trace_hash: format!("{:016x}", trace.digest().time_hash()),
        order_hash: format!("{:016x}", trace.digest().order_hash()),
        host_s: started.elapsed().as_secs_f64(),
    }
}

/// To a nanometre: what lies beyond is the arithmetic's, not the machine's.
fn round(value: f64) -> f64 {
    (value * 1e6).round() / 1e6
}

fn error_text(code: u8) -> &'static str {
    oxmill_controller::error::Error::ALL
        .iter()
        .find(|error| error.code() == code)
        .map_or("an error without a description", |error| error.text())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_names_no_time_that_is_not_known() {
        for length_is_known in [true, false] {
            let template = progress_template(length_is_known);
            assert!(ProgressStyle::with_template(template).is_ok());
            assert!(!template.contains("eta") && template.contains("{elapsed}"), "{template}");
        }
    }

    #[test]
    fn the_lists_of_a_report_are_bounded() {
        let text = "bad\n".repeat(KEPT_ERRORS + 5);
        let mut job = JobText::new(io::Cursor::new(text));
        while job.next_byte().is_some() {}
        let answers = "[MSG:x]\r\nerror:9\r\n".repeat(KEPT_ERRORS + 5);
        job.answered(answers.as_bytes());
        let mut outcome = Outcome::default();
        outcome.hear(&mut job);
        assert_eq!((outcome.errors.len(), outcome.more_errors), (KEPT_ERRORS, 5));
        assert_eq!(outcome.messages.len() as u64 + outcome.more_messages, KEPT_ERRORS as u64 + 5);
        for _ in 0..KEPT_MESSAGES + 3 {
            outcome.note("paused".into());
        }
        assert_eq!((outcome.notes.len(), outcome.more_notes), (KEPT_MESSAGES, 3));
    }
}
