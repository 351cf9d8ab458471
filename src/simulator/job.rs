//! `run`: a file through the controller, in simulated time, and the report about it.

use crate::command_line::{Dialect, MachineOptions, Run};
use crate::file;
use crate::fittings::Fittings;
use crate::path::Drawing;
use crate::plot;
use crate::pump::{Options, Simulator};
use crate::store::Store;
use crate::summary::{AlarmReport, Extents, LineError, Summary};
use crate::text::{self, JobText, Said};
use crate::trace::Csv;
use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use oxmill_controller::messages::Realtime;
use oxmill_controller::settings::{Key, SCALARS};
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::time::Instant;

/// Rounds of the virtual clock between looks at the progress: some 10 ms of the host.
const ROUNDS: u32 = 4096;
/// Messages of the controller that the report keeps.
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
        let text = file::read(path, file::TEXT)
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
    let name = if options.job.as_os_str() == "-" { "standard input".into() } else { options.job.display().to_string() };
    let (reader, length) = text::open(&options.job).with_context(|| format!("cannot read the job {name}"))?;
    let mut simulator = power_up(&options.machine)?;
    check_store(&simulator, options.machine.store.as_deref())?;
    let origin = simulator.clock().now();
    if let Some(path) = &options.trace {
        let csv = Csv::create(path, simulator.board().step_clock_hz, origin)
            .with_context(|| format!("cannot write the trace {}", path.display()))?;
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
    if let Some(error) = job.failure() {
        return Err(error).with_context(|| format!("cannot read the job {name} to its end"));
    }
    simulator.trace_mut().finish().context("cannot write the trace to its end")?;
    let summary = summarise(&simulator, &job, outcome, origin, base_name(&options.job), started);

    if let Some(drawing) = simulator.meter_mut().take_drawing() {
        for path in &options.plot {
            plot::write(path, &drawing, &summary).with_context(|| format!("cannot draw {}", path.display()))?;
        }
    }
    let text = if options.json { serde_json::to_string_pretty(&summary)? + "\n" } else { summary.to_string() };
    match io::stdout().write_all(text.as_bytes()) {
        // A reader that has seen enough, such as `head`.
        Err(error) if error.kind() == io::ErrorKind::BrokenPipe => {}
        written => written.context("cannot write the summary")?,
    }
    Ok(summary.is_good())
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
    messages: Vec<String>,
    notes: Vec<String>,
    alarm: Option<AlarmReport>,
    complete: bool,
}

impl Outcome {
    fn hear(&mut self, job: &mut JobText) {
        for said in job.said() {
            match said {
                Said::Error { line, code, text } => {
                    self.errors.push(LineError { line, code, text: error_text(code).into(), source: text });
                }
                Said::Message(text) if self.messages.len() < KEPT_MESSAGES => self.messages.push(text),
                Said::Message(_) => {}
            }
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
            if let Some(job) = simulator.job_mut() {
                outcome.hear(job);
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
            outcome.notes.push(format!("line {line} paused the program; cycle start was pressed at once"));
            simulator.press(Realtime::CycleStart);
            continue;
        }
        if !simulator.advance_once(u64::MAX) && simulator.unfetched() == 0 {
            if outcome.alarm.is_none() {
                let line = simulator.job().and_then(JobText::oldest_unanswered).unwrap_or_default();
                outcome.notes.push(format!("line {line} waits for something that will not come"));
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
    if let Some(job) = simulator.job_mut() {
        outcome.hear(job);
        outcome.complete = outcome.alarm.is_none() && job.is_used_up();
    }
    outcome
}

fn progress_bar(length: Option<u64>) -> ProgressBar {
    // Standard error may be a terminal while standard output goes to a file: the bar is for the person who waits.
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let (bar, style) = match length {
        Some(length) => (
            ProgressBar::new(length),
            ProgressStyle::with_template("{bar:40} {percent:>3} % of the file, {msg} of machine time, {eta} to go"),
        ),
        None => (ProgressBar::new_spinner(), ProgressStyle::with_template("{spinner} {msg} of machine time")),
    };
    bar.set_draw_target(ProgressDrawTarget::stderr());
    style.map_or(bar.clone(), |style| bar.with_style(style))
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
        alarm: outcome.alarm,
        complete: outcome.complete,
        notes: outcome.notes,
        messages: outcome.messages,
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
