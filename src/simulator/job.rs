//! The commands `run`, `check`, `plot`, `replay` and `resume`. Each command reads its files, powers up a simulator and
//! lets it run. Then it writes the results: summary, trace, recording, drawings or a program. Each returns how it ended
//! ([`Ending`]), for the exit status.

use crate::board_replay;
use crate::check::Check;
use crate::command_line::{CheckJob, MachineOptions, Millimetres, PlotJob, Replay, ResumeJob, Run, WorkZero};
use crate::file_kind;
use crate::files::{self, Output, Role};
use crate::homed::home;
use crate::import_dump::is_said_around_settings;
use crate::machine::linear;
use crate::path::Drawing;
use crate::plot;
use crate::power_up::{SettingRefused, apply_setting};
use crate::recording::{Input, RecordedJob, Recorder, Recording};
use crate::resume::{Begin, ResumeRequest};
use crate::short_report::ShortReport;
use crate::simulator::{Options, Simulator};
use crate::store::Store;
use crate::summary::Summary;
use crate::text::JobText;
use crate::trace::Csv;
use anyhow::{Context, Error, Result, anyhow, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use oxmill_controller::units::{Coordinate, Decimal};
use std::cell::RefCell;
use std::io::{self, IsTerminal, Write};
use std::path::Path;
use std::rc::Rc;
use std::time::Instant;

/// Number of rounds of [`Check::advance`] between updates of the progress display: about 10 ms on the host.
const ROUNDS: u32 = 4096;

/// Bits of a flash word that are already programmed when the power cut of `--cut-power` interrupts the write: the lower
/// half.
const HALF_WORD: u32 = 0xFFFF;

/// Maximum size of a recording, in bytes.
const RECORDING: usize = 1 << 30;

/// Maximum size of a job for `resume`, in bytes.
const JOB: usize = 1 << 30;

/// Error message when a running machine stops because its recording cannot be written.
pub const UNRECORDED: &str = "cannot write the recording";

/// Returns an error if the power cut of `--cut-power` has happened.
pub fn check_power(simulator: &Simulator) -> Result<()> {
    if simulator.power_is_gone() {
        bail!("the power was cut, as ordered, at operation {} of the flash", simulator.store().operations());
    }
    Ok(())
}

/// Returns an error if the stored settings were damaged. Motion is then locked, so no job can run.
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

/// Powers up a simulator as the options describe it and applies the settings of the command line. If `recorded`, also
/// returns a recorder, which records from power-up on. The recorder keeps its text in memory until [`begin_recording`]
/// gives it a file.
pub fn power_up(options: &MachineOptions, recorded: bool) -> Result<(Simulator, Option<Recorder>)> {
    let (mut simulator, machine) = fitted(options)?;
    let mut recorder = begin_recorder(&mut simulator, &machine, options, recorded)?;
    apply_settings(&mut simulator, &mut recorder, &settings(options)?)?;
    Ok((simulator, recorder))
}

/// Powers up a simulator like a board that was set up earlier: the settings of the command line are stored first, and
/// then the board starts with them. So it is locked if homing is on, and it executes its startup lines.
pub fn power_up_as_board(options: &MachineOptions, recorded: bool) -> Result<(Simulator, Option<Recorder>)> {
    let (mut simulator, machine) = fitted(options)?;
    let settings = settings(options)?;
    apply_settings(&mut simulator, &mut None, &settings)?;
    // Power up again, so that the board starts with these settings. But a second power-up would cancel a power cut of
    // `--cut-power`, and damage must first be confirmed by the user.
    if !(settings.is_empty() || options.cut_power.is_some() || simulator.controller().is_store_damaged()) {
        simulator = simulator.powered_again().context("the settings are lost")?;
    }
    let recorder = begin_recorder(&mut simulator, &machine, options, recorded)?;
    Ok((simulator, recorder))
}

/// Returns a simulator with its settings store and the machine's hardware (switches, probe plate and so on), and the
/// text of the machine description.
fn fitted(options: &MachineOptions) -> Result<(Simulator, String)> {
    let mut store = options.store.as_deref().map_or_else(|| Ok(Store::in_memory()), Store::open)?;
    if let Some(operations) = options.cut_power {
        store.cut_power_after(operations, HALF_WORD);
    }
    let machine = options.machine.as_deref().map(files::read_machine).transpose()?;
    let (fittings, machine) = machine.unwrap_or_default();
    let mut simulator = Simulator::new(Options { board: options.board(), store, fittings, keep_steps: false });
    simulator.run_until_idle();
    Ok((simulator, machine))
}

fn begin_recorder(
    simulator: &mut Simulator,
    machine: &str,
    options: &MachineOptions,
    recorded: bool,
) -> Result<Option<Recorder>> {
    if recorded && options.cut_power.is_some() {
        bail!("a power cut cannot be recorded");
    }
    Ok(recorded.then(|| Recorder::begin(simulator, machine)))
}

/// Returns the settings of `--settings`, `--set` and `--dialect`, each as (origin for error messages, setting). The
/// dialect comes last, so that `--dialect` overrides a dialect in the settings file.
fn settings(options: &MachineOptions) -> Result<Vec<(String, String)>> {
    let mut lines = Vec::new();
    if let Some(path) = &options.settings {
        let text = files::read(path, files::TEXT)
            .and_then(|text| file_kind::refuse(&text, false).map(|()| text).map_err(io::Error::other))
            .with_context(|| format!("cannot read the settings file {}", path.display()))?;
        let text = String::from_utf8_lossy(&text).replace("\r\n", "\n");
        for (index, line) in files::without_mark(&text).split(['\n', '\r']).enumerate() {
            // Comments and blank lines may be between the settings, as in an edited dump.
            let setting = line.split([';', '#', '(']).next().unwrap_or_default().trim();
            if !setting.is_empty() && !is_said_around_settings(line) {
                lines.push((format!("line {} of {}", index + 1, path.display()), setting.to_owned()));
            }
        }
    }
    lines.extend(options.set.iter().map(|setting| (format!("--set {setting}"), setting.trim().to_owned())));
    lines.extend(options.dialect.map(|dialect| (format!("--dialect {}", dialect.name()), dialect.assignment())));
    Ok(lines)
}

/// Applies settings in their order. The dialect decides which values a setting accepts, and `--dialect` comes last. So
/// a refused setting is tried once more after all others. There is no second try if a later entry sets the same
/// number, because the second try would undo that entry. The refusal is then an error.
fn apply_settings(
    simulator: &mut Simulator,
    recorder: &mut Option<Recorder>,
    settings: &[(String, String)],
) -> Result<()> {
    let number =
        |setting: &str| setting.trim_start_matches('$').split('=').next().map(|number| number.trim().to_owned());
    let mut refused = Vec::new();
    for (index, (origin, setting)) in settings.iter().enumerate() {
        let Err(why) = apply(simulator, recorder, setting)? else { continue };
        let later = settings.get(index + 1..).unwrap_or_default();
        if later.is_empty() || later.iter().any(|(_, other)| number(other) == number(setting)) {
            bail!("{origin} {why}");
        }
        refused.push((origin, setting));
    }
    for (origin, setting) in refused {
        apply(simulator, recorder, setting)?.map_err(|why| anyhow!("{origin} {why}"))?;
    }
    Ok(())
}

/// Applies a setting and records it. The inner `Err`: the controller refused the setting. The outer `Err`: the
/// recording cannot be written, or the power was cut.
fn apply(
    simulator: &mut Simulator,
    recorder: &mut Option<Recorder>,
    setting: &str,
) -> Result<Result<(), SettingRefused>> {
    if let Some(recorder) = recorder {
        let line = format!("${}\n", setting.strip_prefix('$').unwrap_or(setting));
        recorder.input(simulator, &Input::Host(line.into_bytes())).context(UNRECORDED)?;
    }
    let applied = apply_setting(simulator, setting);
    if applied == Err(SettingRefused::PowerGone) {
        check_power(simulator)?;
    }
    Ok(applied)
}

/// How a command ended; `main` turns it into the exit status.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Ending {
    /// All went well: exit status 0.
    Good,
    /// The job has rejected lines, ended in an alarm, or was not completed; or the file to import or to check has
    /// faults: exit status 1.
    Faulty,
    /// The replay differs from the recording, or cannot be compared with it: exit status 3.
    OtherSteps,
}

impl Ending {
    fn of(summary: &Summary) -> Self {
        if summary.is_good() { Self::Good } else { Self::Faulty }
    }
}

/// Format of the printed summary.
#[derive(Clone, Copy, Debug)]
enum Form {
    Whole,
    /// A summary that fits on one screen.
    Short,
    Json,
}

/// Runs `oxmill check`: simulates a job and prints a summary that fits on one screen, or JSON.
///
/// # Errors
/// If a file cannot be read, or a setting is rejected.
pub fn check(options: CheckJob) -> Result<Ending> {
    let CheckJob { job, json, start, machine } = options;
    let form = if json { Form::Json } else { Form::Short };
    carry_out_job(&Run { job, json, plot: Vec::new(), trace: None, record: None, start, machine }, form)
}

/// Runs `oxmill plot`: simulates a job, draws it into files, and prints a summary that fits on one screen.
///
/// # Errors
/// If a file cannot be read or written, or a setting is rejected.
pub fn plot(options: PlotJob) -> Result<Ending> {
    let PlotJob { job, output, start, machine } = options;
    carry_out_job(&Run { job, json: false, plot: output, trace: None, record: None, start, machine }, Form::Short)
}

/// Runs `oxmill run`: simulates a job, writes the files that the options name (drawings, trace, recording), and prints
/// the whole summary.
///
/// # Errors
/// If a file cannot be read or written, or a setting is rejected.
pub fn run(options: &Run) -> Result<Ending> {
    carry_out_job(options, if options.json { Form::Json } else { Form::Whole })
}

/// Runs `oxmill replay`: plays a recording and compares the steps. If they differ, the result is
/// [`Ending::OtherSteps`], even if the job also has faults: the recorded job can have had the same faults.
///
/// # Errors
/// If the recording cannot be read or played.
pub fn replay(options: &Replay) -> Result<Ending> {
    let started = Instant::now();
    let path = options.recording.display();
    let files = [(&options.recording, "the recording", false)].into_iter();
    let files = files.chain(options.trace.iter().map(|path| (path, "--trace", true)));
    files::check_apart(&files.map(|(path, name, written)| Role { path, name, written }).collect::<Vec<_>>())?;
    let trace = options.trace.as_deref().map(|path| output(path, "trace")).transpose()?;
    let text = files::read(&options.recording, RECORDING)
        .map(|bytes| String::from_utf8_lossy(&bytes).into_owned())
        .with_context(|| format!("cannot read the recording {path}"))?;
    let recording = Recording::parse(&text).map_err(|why| anyhow!("{path}, {why}"))?;
    let mut simulator = recording.power_up().map_err(|why| anyhow!("{path}: {why}"))?;
    if let Some(trace) = trace {
        begin_trace(&mut simulator, trace)?;
    }
    let mut notes = Vec::new();
    let length = recording.job().map_or_else(|| recording.length(), |job| job.len() as u64);
    let progress = progress_bar(Some(length), "the recording");
    let (mut check, same) = play(&recording, simulator, &progress, &mut notes);
    progress.finish_and_clear();
    let traced = check.simulator_mut().trace_mut().finish().context("cannot write the trace to its end");
    let summary = check.summary(&base_name(&options.recording), started.elapsed().as_secs_f64());
    print(&summary, if options.json { Form::Json } else { Form::Whole })?;
    if !options.json {
        let notes: String = notes.iter().map(|note| format!("  replay        {note}\n")).collect();
        files::print(io::stdout(), notes.as_bytes()).context("cannot write the summary")?;
    }
    if let Err(why) = &same {
        files::eprint_line(&format!("oxmill: {path}: {why}"));
    }
    traced?;
    Ok(if same.is_ok() { Ending::of(&summary) } else { Ending::OtherSteps })
}

/// Runs `oxmill resume`: writes a program that continues a job at a given line. The first lines of the program restore
/// the state. These lines are also listed on standard error.
///
/// # Errors
/// If a file cannot be read or written, a setting is rejected, or the job cannot continue at that line.
pub fn resume(options: &ResumeJob) -> Result<Ending> {
    let name = options.job.display().to_string();
    let output_role = options.output.as_deref().map(|path| Role { path, name: "--output", written: true });
    let job_role = Role { path: &options.job, name: "the job", written: false };
    let roles = [job_role].into_iter().chain(output_role).chain(machine_roles(&options.machine, None));
    files::check_apart(&roles.collect::<Vec<_>>())?;
    let job = files::read(&options.job, JOB).and_then(|job| {
        file_kind::refuse(&job, true).map_err(io::Error::other)?;
        Ok(job)
    });
    let job = job.with_context(|| format!("cannot read the job {name}"))?;
    let file = options.output.as_deref().map(|path| output(path, "program")).transpose()?;
    let (simulator, _) = power_up(&options.machine, false)?;
    check_store(&simulator, options.machine.store.as_deref())?;
    let begin = match (options.begin.line, options.begin.number) {
        (Some(line), _) => Begin::Line(line),
        (None, number) => Begin::Number(number.unwrap_or_default()),
    };
    let plunge = options.plunge.map(|Millimetres(feed)| Decimal(feed));
    let clearance = options.clearance.map(|Millimetres(height)| Coordinate(height));
    let request = ResumeRequest { begin, clearance, plunge, spin_up: options.spin_up };
    let resumed = crate::resume::resume(&simulator, &base_name(&options.job), &job, &request);
    let resumed = resumed.map_err(|why| anyhow!("{name} cannot go on there: {why}"))?;
    match file {
        Some(file) => file.begin().and_then(|mut file| file.write_all(&resumed.program)),
        None => files::print(io::stdout(), &resumed.program),
    }
    .context("cannot write the program")?;
    let (line, lines) = (resumed.line, resumed.lines);
    files::eprint_line(&format!(
        "oxmill: reset and home the machine first. The program runs these lines, then line {line} of {lines} and the rest:"
    ));
    for line in &resumed.prologue {
        files::eprint_line(&format!("  {line}"));
    }
    Ok(Ending::Good)
}

/// Plays a recording to its end and shows the progress: in bytes if it records a job, otherwise in ticks of the step
/// clock. `notes` receives the remarks of a board's replay. Returns the played machine, and an error text if it differs
/// from the recording.
fn play(
    recording: &Recording,
    mut simulator: Simulator,
    progress: &ProgressBar,
    notes: &mut Vec<String>,
) -> (Check, Result<(), String>) {
    if let Some(job) = recording.job() {
        let begun = recording.play(&mut simulator, |_| {}, |_| {});
        let mut check = Check::new(simulator, JobText::new(io::Cursor::new(job.to_vec())));
        carry_out(&mut check, progress);
        let same = begun.and_then(|()| recording.compare_end(check.simulator()));
        return (check, same);
    }
    let (clock, mut said) = (*simulator.clock(), String::new());
    let pass = |ticks| {
        progress.set_position(ticks);
        progress.set_message(machine_time(clock.seconds(ticks)));
    };
    let same = if recording.is_of_board() {
        let arrival = board_replay::play(recording, &mut simulator, |text| said.push_str(text), pass);
        notes.extend(arrival.notes);
        arrival.parted.map_or(Ok(()), Err)
    } else {
        recording.play(&mut simulator, |text| said.push_str(text), pass).and_then(|()| recording.check_compared())
    };
    if recording.is_of_board() {
        // Do not run until idle: what a board did after the end of its recording is unknown, so nothing can be
        // compared.
        return (Check::of(simulator, clock.now(), &said), same);
    }
    // Finish what the last inputs have started.
    simulator.run_until_idle();
    said.push_str(&simulator.take_output());
    (Check::of(simulator, clock.now(), &said), same)
}

/// Empties the file and writes the recording into it, from power-up on. Call after everything else that can fail, so
/// that a failed start does not destroy an older recording.
pub fn begin_recording(recorder: &mut Option<Recorder>, file: Option<Output>) -> Result<()> {
    let (Some(recorder), Some(file)) = (recorder, file) else { return Ok(()) };
    let path = file.path().display().to_string();
    let written = file.begin().and_then(|file| recorder.write_to(Box::new(io::BufWriter::new(file))));
    written.with_context(|| format!("cannot write the recording {path}"))
}

/// Writes a row for each step event from here on. Empties the file first.
fn begin_trace(simulator: &mut Simulator, file: Output) -> Result<()> {
    let path = file.path().display().to_string();
    let (axes, origin) = (simulator.controller().settings().axes_in_use(), simulator.clock().now());
    let csv = file.begin().and_then(|file| Csv::new(file, simulator.board().step_clock_hz, origin, axes));
    let csv = csv.with_context(|| format!("cannot write the trace {path}"))?;
    simulator.trace_mut().write_csv(csv);
    Ok(())
}

fn carry_out_job(options: &Run, form: Form) -> Result<Ending> {
    let started = Instant::now();
    for path in &options.plot {
        plot::format_of(path)?;
    }
    files::check_apart(&roles(options))?;
    let name = if options.job.as_os_str() == "-" { "standard input".into() } else { options.job.display().to_string() };
    let (reader, length) = files::open_text(&options.job).with_context(|| format!("cannot read the job {name}"))?;
    let plots = options.plot.iter().map(|path| output(path, "drawing")).collect::<Result<Vec<_>>>()?;
    let trace = options.trace.as_deref().map(|path| output(path, "trace")).transpose()?;
    let record = options.record.as_deref().map(|path| output(path, "recording")).transpose()?;
    let (mut simulator, mut recorder) = power_up(&options.machine, record.is_some())?;
    check_store(&simulator, options.machine.store.as_deref())?;
    if let Some(WorkZero(place)) = options.start.work_zero {
        home(&mut simulator, place).map_err(|why| anyhow!("--work-zero: {why}"))?;
    }
    begin_recording(&mut recorder, record)?;
    let origin = simulator.clock().now();
    if let Some(trace) = trace {
        begin_trace(&mut simulator, trace)?;
    }
    if !options.plot.is_empty() {
        let start = simulator.meter().millimetres(simulator.machine().motors());
        let seconds = simulator.clock().seconds(origin);
        simulator.meter_mut().draw(Drawing::new(linear(start), seconds));
    }

    let recorder = recorder.map(|recorder| Rc::new(RefCell::new(recorder)));
    if let Some(recorder) = &recorder {
        recorder.borrow_mut().input(&simulator, &Input::Job).context(UNRECORDED)?;
    }
    let job = match &recorder {
        Some(recorder) => JobText::new(RecordedJob::new(reader, recorder.clone())),
        None => JobText::new(reader),
    };
    let progress = progress_bar(length, "the file read");
    let mut check = Check::new(simulator, job);
    carry_out(&mut check, &progress);
    progress.finish_and_clear();
    check_power(check.simulator())?;
    // If anything fails from here on, the summary is still printed first.
    let mut failures = Vec::from_iter(reading_failure(&mut check, &name));
    failures.extend(check.simulator_mut().trace_mut().finish().context("cannot write the trace to its end").err());
    if let Some(recorder) = recorder {
        let mut recorder = recorder.borrow_mut();
        let written = recorder.end(check.simulator());
        failures.extend(written.context("cannot write the recording to its end").err());
    }
    let summary = check.summary(&base_name(&options.job), started.elapsed().as_secs_f64());
    print(&summary, form)?;
    if let Some(drawing) = check.simulator_mut().meter_mut().take_drawing() {
        failures.extend(plots.into_iter().filter_map(|plot| plot::write(plot, &drawing, &summary).err()));
    }
    let mut failures = failures.into_iter();
    let Some(first) = failures.next() else { return Ok(Ending::of(&summary)) };
    for other in failures {
        files::eprint_line(&format!("oxmill: {other:#}"));
    }
    Err(first)
}

/// Runs a job to its end and shows the progress.
fn carry_out(check: &mut Check, progress: &ProgressBar) {
    while !check.advance(ROUNDS) {
        progress.set_position(check.consumed());
        progress.set_message(machine_time(check.seconds()));
    }
}

/// If the job could not be read to its end, marks the report as incomplete and returns the error.
fn reading_failure(check: &mut Check, name: &str) -> Option<Error> {
    let failure = check.simulator_mut().job_mut().and_then(JobText::failure)?;
    check.cut_short();
    Some(anyhow!(failure).context(format!("cannot read the job {name} to its end")))
}

/// Returns the files that a run reads and writes, for [`files::check_apart`].
fn roles(options: &Run) -> Vec<Role<'_>> {
    let job = (options.job.as_os_str() != "-").then_some(options.job.as_path());
    let plots = options.plot.iter().map(|path| Role { path, name: "--plot", written: true });
    let others = [(job, "the job", false), (options.trace.as_deref(), "--trace", true)];
    let others = others.into_iter().filter_map(|(path, name, written)| Some(Role { path: path?, name, written }));
    let machine = machine_roles(&options.machine, options.record.as_deref());
    others.chain(machine).chain(plots).collect()
}

/// Returns the files that the machine options name, and the file of the recording (`record`), for
/// [`files::check_apart`].
pub fn machine_roles<'a>(machine: &'a MachineOptions, record: Option<&'a Path>) -> Vec<Role<'a>> {
    let files = [
        (machine.settings.as_deref(), "--settings", false),
        (machine.machine.as_deref(), "--machine", false),
        (machine.store.as_deref(), "--store", true),
        (record, "--record", true),
    ];
    files.into_iter().filter_map(|(path, name, written)| Some(Role { path: path?, name, written })).collect()
}

/// Opens a file for output. `name`: what the file will contain, such as `trace`, for the error message.
///
/// # Errors
/// If it cannot be opened.
pub fn output(path: &Path, name: &str) -> Result<Output> {
    Output::open(path).with_context(|| format!("cannot write the {name} {}", path.display()))
}

fn print(summary: &Summary, form: Form) -> Result<()> {
    let text = match form {
        Form::Whole => summary.to_string(),
        Form::Short => ShortReport(summary).to_string(),
        Form::Json => serde_json::to_string_pretty(summary)? + "\n",
    };
    // Without a terminal, or with NO_COLOR, the stream removes the colours.
    files::print(anstream::stdout(), text.as_bytes()).context("cannot write the summary")
}

fn base_name(path: &Path) -> String {
    if path.as_os_str() == "-" {
        return "standard input".into();
    }
    // Control characters could act on a terminal, and are invalid in XML.
    path.file_name().unwrap_or(path.as_os_str()).to_string_lossy().replace(char::is_control, "?")
}

/// Returns a progress bar up to `length`, or a spinner if the length is unknown. `what`: what 100 % stands for, such as
/// "the file read". The bar shows this text after the percentage.
fn progress_bar(length: Option<u64>, what: &str) -> ProgressBar {
    // The bar goes to standard error, which can be a terminal even if standard output is a file.
    if !std::io::stderr().is_terminal() {
        return ProgressBar::hidden();
    }
    let bar = length.map_or_else(ProgressBar::new_spinner, ProgressBar::new);
    bar.set_draw_target(ProgressDrawTarget::stderr());
    ProgressStyle::with_template(&progress_template(length.map(|_| what)))
        .map_or(bar.clone(), |style| bar.with_style(style))
}

/// Returns the machine time as text for `{msg}` of the progress bar. The blank at its end is a part of the text,
/// because `{msg}` is empty before the first update.
fn machine_time(seconds: f64) -> String {
    format!("{} of machine time ", crate::summary::clock_time(seconds))
}

/// Returns the template of the progress bar. The bar shows no remaining time: one line of a job can take a second or a
/// day, so the share of the file that was read tells nothing about it.
fn progress_template(share_of: Option<&str>) -> String {
    let share = share_of.map_or("{spinner}".into(), |what| format!("{{bar:40}} {{percent:>3}} % of {what},"));
    share + " {msg}in {elapsed}"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn progress_names_no_time_that_is_not_known() {
        for share_of in [Some("the file read"), None] {
            let template = progress_template(share_of);
            assert!(ProgressStyle::with_template(&template).is_ok());
            assert!(!template.contains("eta") && template.contains("{elapsed}"), "{template}");
        }
    }

    /// The progress of a recorded job is counted in bytes, and the progress of a recorded host session in time.
    #[test]
    fn a_recording_shows_its_progress() {
        let begin = "oxmill recording 1\nboard desk 1000000\nbegin 1000000\n";
        let host = "1000000 connect\n2000000 host G1 X1 F60\\n\n4000000 disconnect\n".to_owned();
        let job = format!("1000000 job\n{}", "job G1 X1 F6000\\n\njob G1 X0\\n\n".repeat(2000));
        for (text, job) in [(host, false), (job, true)] {
            let recording = Recording::parse(&format!("{begin}{text}")).unwrap();
            let length = recording.job().map_or(recording.length(), |job| job.len() as u64);
            assert_eq!(length, if job { 2000 * 18 } else { 3_000_000 });
            let progress = ProgressBar::hidden();
            let (_, same) = play(&recording, recording.power_up().unwrap(), &progress, &mut Vec::new());
            // The comparison fails because neither recording contains the final motor positions.
            assert!(same.is_err(), "{same:?}");
            let position = progress.position();
            assert!(if job { (1..=length).contains(&position) } else { position == length }, "{position} of {length}");
            assert!(!progress.message().is_empty());
        }
    }
}
