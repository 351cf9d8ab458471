//! Runs jobs on the firmware in QEMU and in the simulator, and compares the motion of the motors.
//!
//! * preloaded: the job lies in RAM, so its bytes are never late. All times, steps and directions must equal the
//!   simulator's; a digest (hash) of them is compared. The motors must be busy as long as the simulator forecasts, to
//!   the tick.
//! * streamed: the job is sent over a TCP port with character counting, as a sender does. The speeds then depend on
//!   when lines arrive, so only the answers and the final position must be right.
//!
//! In the streamed job `axes.nc`, in which only one axis moves at a time, the order of the steps must also be the same.
//! In other jobs the slower of the two runs can be smoothed more finely, which changes the order. For them the result
//! of the comparison is only printed.

use crate::qemu::{self, Preload};
use crate::{Failure, QEMU_BOARD, cargo, image, root};
use std::collections::VecDeque;
use std::fs;
use std::io::{ErrorKind, Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::thread;
use std::time::{Duration, Instant};

/// Maximum number of bytes that a sender keeps in flight: Grbl's receive buffer, which every sender assumes.
const WINDOW: usize = 127;
/// Maximum duration of one job.
const LIMIT: Duration = Duration::from_secs(300);

/// Maximum size of an example that runs in QEMU, bytes.
const LARGEST_EXAMPLE: u64 = 1024;

/// File stem of the job in which only one axis moves at a time. Smoothing cannot change its order of steps, so the
/// streamed run must have the same order as the simulator.
const ONE_AXIS_AT_A_TIME: &str = "axes";

/// The steps of a run: a digest (hash) of their times, a digest of their order, and the net steps of X, Y and Z.
#[derive(Debug, PartialEq, Eq)]
struct Steps {
    time: String,
    order: String,
    net: [i64; 3],
    /// Time during which the motors were busy, ticks of the step clock. In the simulator's result it is the forecast.
    busy: u64,
}

/// Returns the `.nc` files in a folder that are smaller than `below` bytes, sorted by path.
fn job_files(folder: &str, below: u64) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> = fs::read_dir(root().join(folder))
        .into_iter()
        .flatten()
        .filter_map(|entry| entry.ok().map(|e| e.path()))
        .filter(|path| path.extension().is_some_and(|e| e == "nc"))
        .filter(|path| fs::metadata(path).is_ok_and(|m| m.len() < below))
        .collect();
    files.sort();
    files
}

/// Compares all jobs on QEMU with the simulator: `cargo xtask jobs`, and a part of `cargo test-target`.
pub fn compare_all() -> Result<(), Failure> {
    let image = image::build(QEMU_BOARD)?;
    // The jobs of tests/jobs are run preloaded and streamed. The examples take minutes of machine time, so only the
    // small ones are run, and only preloaded.
    let made = job_files("tests/jobs", u64::MAX);
    let mut examples = job_files("examples", LARGEST_EXAMPLE);
    // `drilling.nc` needs the dialect of `$900=2`, but the jobs here run with the default settings. `house.nc` takes
    // ten minutes at its feeds.
    examples.retain(|file| !file.ends_with("drilling.nc") && !file.ends_with("house.nc"));
    let files: Vec<(&PathBuf, bool)> =
        made.iter().map(|f| (f, true)).chain(examples.iter().map(|f| (f, false))).collect();
    if !made.iter().any(|file| file.file_stem().is_some_and(|stem| stem == ONE_AXIS_AT_A_TIME)) {
        return Err("tests/jobs/axes.nc is missing".into());
    }
    if examples.is_empty() {
        return Err("there are no jobs to compare: examples is missing".into());
    }
    let mut failures = Vec::new();
    println!("\nrunning {} jobs on QEMU and in the simulator", files.len());
    for (file, streamed) in files.iter().copied() {
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let begin = Instant::now();
        let outcome = simulate(file).and_then(|expected| {
            compare_preloaded(&image.path, file, &expected)?;
            if streamed { compare_streamed(&image.path, file, &expected) } else { Ok(()) }
        });
        match outcome {
            Ok(()) => println!("job {name} ... ok ({:.1} s)", begin.elapsed().as_secs_f32()),
            Err(why) => {
                println!("job {name} ... FAILED\n  {why}");
                failures.push(name);
            }
        }
    }
    println!("job result: {} passed; {} failed\n", files.len() - failures.len(), failures.len());
    if failures.is_empty() { Ok(()) } else { Err(format!("jobs failed: {}", failures.join(", "))) }
}

/// `cargo qemu --job FILE`: runs a job from RAM in QEMU, and prints the firmware's output and the test stand's report.
pub fn show(file: &Path) -> Result<(), Failure> {
    let image = image::build(QEMU_BOARD)?;
    let (answers, report) = run_preloaded(&image.path, file)?;
    print!("{answers}{report}");
    Ok(())
}

fn compare_preloaded(elf: &Path, file: &Path, expected: &Steps) -> Result<(), Failure> {
    let (answers, report) = run_preloaded(elf, file)?;
    refuse_errors(&answers)?;
    let steps = parse_report(&report)?;
    if &steps == expected { Ok(()) } else { Err(format!("preloaded: QEMU {steps:?}, simulator {expected:?}")) }
}

fn compare_streamed(elf: &Path, file: &Path, expected: &Steps) -> Result<(), Failure> {
    let (_qemu, mut host, mut stand) = qemu::streamed(elf)?;
    let text = job_text(file)?;
    stream(&mut host, &text)?;
    let status = wait_until_idle(&mut host)?;
    stand.write_all(b"r").map_err(|error| error.to_string())?;
    let report = read_until(&mut stand, Duration::from_secs(60), |text| text.ends_with('\n'))?;
    let steps = parse_report(&report)?;
    // Where one axis moves at a time, smoothing cannot change the order.
    if file.file_stem().is_some_and(|stem| stem == ONE_AXIS_AT_A_TIME) && steps.order != expected.order {
        return Err(format!("streamed: QEMU {steps:?}, simulator {expected:?}: another order of steps"));
    }
    if steps.net == expected.net {
        let order = if steps.order == expected.order { "the same" } else { "another" };
        println!("  streamed: {status}, {order} order of steps");
        Ok(())
    } else {
        Err(format!("streamed: QEMU {:?} ({status}), simulator {:?}", steps.net, expected.net))
    }
}

/// Returns the text of a job as the firmware gets it. Lines that start with `%` are removed, as the simulator does with
/// tape marks. Each character that is not ASCII is replaced by a point.
fn job_text(file: &Path) -> Result<Vec<u8>, Failure> {
    let bytes = fs::read(file).map_err(|error| format!("{}: {error}", file.display()))?;
    let text = String::from_utf8_lossy(&bytes);
    let mut out = Vec::new();
    for line in text.lines().filter(|line| !line.starts_with('%')) {
        out.extend(line.chars().map(|c| if c.is_ascii() { c as u8 } else { b'.' }));
        out.push(b'\n');
    }
    Ok(out)
}

fn run_preloaded(elf: &Path, file: &Path) -> Result<(String, String), Failure> {
    let text = job_text(file)?;
    let folder = root().join("target/jobs");
    let path = folder.join(file.file_name().unwrap_or_default());
    let written = fs::create_dir_all(&folder).and_then(|()| fs::write(&path, &text));
    written.map_err(|error| format!("{}: {error}", path.display()))?;
    qemu::preloaded(elf, Preload::Job, &path, LIMIT)
}

fn refuse_errors(answers: &str) -> Result<(), Failure> {
    match answers.lines().find(|line| line.starts_with("error:") || line.starts_with("ALARM:")) {
        None => Ok(()),
        Some(line) => Err(format!("the firmware answered `{line}`")),
    }
}

/// Parses the report that the test stand sends after a run: `time=... order=... steps=x,y,z busy=n`.
fn parse_report(report: &str) -> Result<Steps, Failure> {
    let field = |name: &str| report.split_whitespace().find_map(|word| word.strip_prefix(name));
    let parse = || {
        let mut net = field("steps=")?.split(',').map(|n| n.parse().ok());
        let net = [net.next()??, net.next()??, net.next()??];
        let busy = field("busy=")?.parse().ok()?;
        Some(Steps { time: field("time=")?.into(), order: field("order=")?.into(), net, busy })
    };
    parse().ok_or_else(|| format!("the test stand reports `{report}`"))
}

/// Runs a job in the simulator with the profile of QEMU's board.
fn simulate(file: &Path) -> Result<Steps, Failure> {
    let output = cargo()
        .args(["run", "--quiet", "--locked", "--release", "--package", "oxmill", "--", "run"])
        .arg(file)
        .args(["--board", QEMU_BOARD, "--json"])
        .output()
        .map_err(|error| error.to_string())?;
    if !output.status.success() {
        return Err(format!("the simulator fails: {}", String::from_utf8_lossy(&output.stderr)));
    }
    let summary: serde_json::Value = serde_json::from_slice(&output.stdout).map_err(|error| error.to_string())?;
    let text = |name: &str| summary[name].as_str().map(str::to_owned);
    let parse = || {
        let net = summary["steps"].as_array()?;
        let net = [net.first()?.as_i64()?, net.get(1)?.as_i64()?, net.get(2)?.as_i64()?];
        let busy = summary["forecast_s"].as_f64()? * summary["step_clock_hz"].as_f64()?;
        Some(Steps { time: text("trace_hash")?, order: text("order_hash")?, net, busy: busy.round() as u64 })
    };
    parse().ok_or_else(|| format!("the simulator's summary lacks hashes or steps: {summary}"))
}

/// Sends a job with character counting and waits for the answer to every line.
fn stream(host: &mut TcpStream, text: &[u8]) -> Result<(), Failure> {
    let mut on_their_way = VecDeque::new();
    let mut unread = String::new();
    let begin = Instant::now();
    host.set_read_timeout(Some(Duration::from_millis(20))).map_err(|error| error.to_string())?;
    let lines: Vec<&[u8]> = text.split_inclusive(|byte| *byte == b'\n').collect();
    let (mut next, mut answered) = (0, 0);
    while answered < lines.len() {
        while next < lines.len() && on_their_way.iter().sum::<usize>() + lines[next].len() <= WINDOW {
            host.write_all(lines[next]).map_err(|error| error.to_string())?;
            on_their_way.push_back(lines[next].len());
            next += 1;
        }
        read_some(host, &mut unread)?;
        while let Some(end) = unread.find('\n') {
            let line: String = unread.drain(..=end).collect();
            match line.trim_end() {
                "ok" => {
                    on_their_way.pop_front();
                    answered += 1;
                }
                line => refuse_errors(line).map_err(|why| format!("line {}: {why}", answered + 1))?,
            }
        }
        if begin.elapsed() > LIMIT {
            return Err(format!("streamed: only {answered} of {} lines were answered in {LIMIT:?}", lines.len()));
        }
    }
    Ok(())
}

/// Polls until the machine reports Idle twice in a row: a line that has just been answered can start its motion after
/// the first report.
pub(crate) fn wait_until_idle(host: &mut TcpStream) -> Result<String, Failure> {
    let begin = Instant::now();
    let mut idle_before = false;
    loop {
        host.write_all(b"?").map_err(|error| error.to_string())?;
        let status = read_until(host, Duration::from_secs(60), |text| text.ends_with(">\r\n"))?;
        let idle = status.contains("<Idle|");
        if idle && idle_before {
            return Ok(status.trim().to_owned());
        }
        idle_before = idle;
        if status.contains("<Alarm|") {
            return Err(format!("streamed: an alarm instead of rest: {status}"));
        }
        // Polls are rare, because every report costs the board work.
        thread::sleep(Duration::from_millis(50));
        if begin.elapsed() > LIMIT {
            return Err(format!("streamed: not idle after {LIMIT:?}: {status}"));
        }
    }
}

pub(crate) fn read_until(
    stream: &mut TcpStream,
    limit: Duration,
    complete: impl Fn(&str) -> bool,
) -> Result<String, Failure> {
    stream.set_read_timeout(Some(Duration::from_millis(20))).map_err(|error| error.to_string())?;
    let begin = Instant::now();
    let mut text = String::new();
    while !complete(&text) {
        read_some(stream, &mut text)?;
        if begin.elapsed() > limit {
            return Err(format!("no complete answer within {limit:?}, only `{text}`"));
        }
    }
    Ok(text)
}

fn read_some(stream: &mut TcpStream, text: &mut String) -> Result<(), Failure> {
    let mut bytes = [0; 4096];
    match stream.read(&mut bytes) {
        Ok(0) => Err("QEMU has closed the line".into()),
        Ok(n) => {
            text.push_str(&String::from_utf8_lossy(&bytes[..n]));
            Ok(())
        }
        Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => Ok(()),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn reports_are_read() {
        let steps = parse_report("time=00ff order=0a steps=1,-2,3 busy=9\n").unwrap();
        assert_eq!(steps, Steps { time: "00ff".into(), order: "0a".into(), net: [1, -2, 3], busy: 9 });
        assert!(parse_report("time=00ff").is_err());
    }
}
