//! Conversations with the firmware in QEMU that need its tasks and interrupts, which the simulator does not have.

use crate::jobs::{read_until, wait_until_idle};
use crate::{Failure, QEMU_BOARD, cargo, image, qemu, root};
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(1200);

/// Connections to the board's host port and to the test stand.
struct Lines {
    host: TcpStream,
    stand: TcpStream,
}

type Test = fn(&mut Lines) -> Result<(), Failure>;

/// Runs all conversations, each with a machine that has just been powered up.
pub fn all() -> Result<(), Failure> {
    let image = image::build(QEMU_BOARD)?;
    let tests: [(&str, Test); 14] = [
        ("a_panic_in_mid_job_is_played_again_on_the_desk", recorded_failure),
        ("hold_and_reset_in_motion_are_played_again_on_the_desk", recorded_stops),
        ("a_panic_is_told_after_the_reset_and_locks", panics),
        ("a_fault_is_told_after_the_reset_and_locks", faults),
        ("a_control_task_that_hangs_is_found_and_told", control_hangs),
        ("the_watchdog_resets_a_processor_that_hangs", everything_hangs),
        ("a_line_of_every_kind_is_answered", every_kind),
        ("settings_are_there_again_after_a_reset_of_the_machine", settings),
        ("reboot_restarts_with_the_stored_settings", reboots),
        ("a_flood_of_lines_behind_a_dwell_loses_nothing", flood),
        ("a_hold_brakes_and_a_resume_goes_on_to_the_end", hold_and_resume),
        ("a_host_that_says_nothing_more_is_missed", silence),
        ("a_reset_in_motion_stops_for_good_and_raises_an_alarm", reset_in_motion),
        ("a_reset_drops_what_came_before_it_and_nothing_after", reset_between_lines),
    ];
    println!("\nrunning {} conversations with the firmware on QEMU", tests.len());
    let mut failed = 0;
    let mut deepest = Stack { used: 0, size: 0 };
    for (name, test) in tests {
        let begin = Instant::now();
        match converse(&image.path, test) {
            Ok(stack) => {
                println!("conversation {name} ... ok ({:.1} s)", begin.elapsed().as_secs_f32());
                if stack.used > deepest.used {
                    deepest = stack;
                }
            }
            Err(why) => {
                println!("conversation {name} ... FAILED\n  {why}");
                failed += 1;
            }
        }
    }
    println!("conversation result: {} passed; {failed} failed", tests.len() - failed);
    println!("stack: {} of {} bytes used at most\n", deepest.used, deepest.size);
    if failed > 0 {
        return Err(format!("{failed} conversations failed"));
    }
    // Some stack must be left for paths that no conversation has taken.
    ensure(deepest.used <= deepest.size / 4 * 3, || "more than three quarters of the stack are used".into())
}

/// Maximum stack use so far, and size of the stack, bytes.
struct Stack {
    used: u32,
    size: u32,
}

fn converse(elf: &Path, test: Test) -> Result<Stack, Failure> {
    let (_qemu, host, stand) = qemu::live(elf)?;
    let mut lines = Lines { host, stand };
    test(&mut lines)?;
    lines.stack()
}

impl Lines {
    fn send(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.host.write_all(bytes).map_err(|error| error.to_string())
    }

    /// Reads from the host port until `wanted` has arrived; returns everything that was read.
    fn expect(&mut self, wanted: &str) -> Result<String, Failure> {
        read_until(&mut self.host, LIMIT, |text| text.contains(wanted))
    }

    fn status(&mut self) -> Result<String, Failure> {
        self.send(b"?")?;
        self.expect(">\r\n")
    }

    /// Requests the status until it contains `state`. Fails at an alarm, unless `state` is one.
    fn wait_for(&mut self, state: &str) -> Result<String, Failure> {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            let status = self.status()?;
            if status.contains("<Alarm|") && !state.contains("Alarm") {
                return Err(format!("an alarm instead of {state}: {status}"));
            }
            if status.contains(state) {
                return Ok(status);
            }
        }
        Err(format!("the state never became {state}"))
    }

    /// Waits until a motion in progress has passed this X position, mm.
    fn wait_until_beyond(&mut self, millimetres: f64) -> Result<(), Failure> {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            let status = self.wait_for("<Run|")?;
            let x = status.split("MPos:").nth(1).and_then(|rest| rest.split(',').next()?.parse::<f64>().ok());
            if x.is_some_and(|x| x >= millimetres) {
                return Ok(());
            }
        }
        Err(format!("X never came to {millimetres}"))
    }

    fn report(&mut self) -> Result<String, Failure> {
        self.ask_stand(b"r")
    }

    fn ask_stand(&mut self, question: &[u8]) -> Result<String, Failure> {
        self.stand.write_all(question).map_err(|error| error.to_string())?;
        read_until(&mut self.stand, LIMIT, |text| text.ends_with('\n'))
    }

    fn stack(&mut self) -> Result<Stack, Failure> {
        let answer = self.ask_stand(b"s")?;
        let numbers = answer.trim().strip_prefix("stack=").and_then(|rest| rest.split_once(" of "));
        numbers
            .and_then(|(used, size)| Some(Stack { used: used.parse().ok()?, size: size.parse().ok()? }))
            .ok_or_else(|| format!("the test stand reports {answer}"))
    }
}

/// Makes the firmware fail during motion. The byte `way` tells the test stand how: `P` is a panic, `F` is a fault, `C`
/// hangs the control task, `H` hangs everything. After the restart, the welcome must contain `message`, motion must be
/// locked, and `$RC` must list all parts of `record`.
fn failure(lines: &mut Lines, way: &[u8], message: &str, record: &[&str]) -> Result<(), Failure> {
    lines.send(b"G21G91G1X50F600\n")?;
    lines.wait_until_beyond(1.0)?;
    lines.stand.write_all(way).map_err(|error| error.to_string())?;
    let welcome = lines.expect("to unlock]\r\n")?;
    ensure(welcome.contains("Grbl 1.1h") && welcome.contains(message), || format!("after the failure: {welcome}"))?;
    // A host that has not noticed the failure continues its job: this line must be rejected.
    lines.send(b"G1X-5\n")?;
    lines.expect("error:9\r\n")?;
    let report = lines.report()?;
    ensure(report.contains("steps=0,0,0"), || format!("it moves after a failure: {report}"))?;
    lines.send(b"$RC\n")?;
    let told = lines.expect("ok\r\n")?;
    ensure(record.iter().all(|part| told.contains(part)), || format!("the record: {told}"))?;
    // After `$RC` the failure is not reported again, and the machine works.
    lines.send(b"\x18")?;
    let welcome = lines.expect("to unlock]\r\n")?;
    ensure(!welcome.contains("failure"), || format!("told again: {welcome}"))?;
    lines.send(b"$X\nG21G91G1X1F600\n")?;
    lines.expect("ok\r\nok\r\n")?;
    wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    ensure(report.contains("steps=250,0,0"), || report)
}

/// Returns the machine's recording, as a terminal would log it.
fn listing(lines: &mut Lines) -> Result<String, Failure> {
    lines.send(b"$REC\n")?;
    read_until(&mut lines.host, LIMIT, |text| text.ends_with("[REC:end]\r\nok\r\n"))
}

/// Replays a log in the simulator; returns the output.
fn played(name: &str, log: &str) -> Result<String, Failure> {
    let folder = root().join("target/recordings");
    let file = folder.join(name);
    let written = std::fs::create_dir_all(&folder).and_then(|()| std::fs::write(&file, log));
    written.map_err(|error| format!("{}: {error}", file.display()))?;
    let mut replay = cargo();
    replay.args(["run", "--quiet", "--locked", "--package", "oxmill", "--", "replay"]).arg(&file);
    let output = replay.output().map_err(|error| error.to_string())?;
    // Exit status 1: the replay has an alarm, which the board also had.
    ensure(matches!(output.status.code(), Some(0 | 1)), || {
        format!("the replay parts: {}", String::from_utf8_lossy(&output.stderr))
    })?;
    Ok(String::from_utf8_lossy(&output.stdout).into_owned())
}

/// The firmware fails during a job. The replay of its recording in the simulator must end at the same line and
/// position.
fn recorded_failure(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91\nN10G1X4F600\nN20Y3\nN30G2X2Y2I2\nN40G1X4Y-1F900\nN50X30\nN60Y-4\n")?;
    lines.wait_until_beyond(14.0)?;
    lines.stand.write_all(b"P").map_err(|error| error.to_string())?;
    let welcome = lines.expect("to unlock]\r\n")?;
    ensure(welcome.contains("line 50") && welcome.contains("$REC what came in"), || welcome.clone())?;
    // The recording must not change in two cases: a host that has not noticed the failure continues its job, or a host
    // sends queries and jogs.
    lines.send(b"X5\n$RC\n$X\n")?;
    let unlocked = |text: &str| text.contains("Caution: Unlocked") && text.ends_with("ok\r\n");
    let told = read_until(&mut lines.host, LIMIT, unlocked)?;
    lines.send(b"$J=G91X-1F600\n")?;
    lines.expect("ok\r\n")?;
    wait_until_idle(&mut lines.host)?;
    let log = format!("{welcome}{told}{}", listing(lines)?);
    let place = told.split_once("[LAST:").and_then(|(_, rest)| rest.split_once("|Ln:50]"));
    let (place, _) = place.ok_or_else(|| format!("the record: {told}"))?;
    let end = format!("panic N50 {}", place.replace(',', " "));
    ensure(log.contains(&format!("ended {end}]")), || format!("no {end} in {log}"))?;
    let said = played("panic_in_mid_job.log", &log)?;
    ensure(said.contains(&format!("arrives at the place and line of the failure ({end})")), || said)?;
    // The next program overwrites the recording of the failure.
    lines.send(b"N1G0Y1\n")?;
    lines.expect("ok\r\n")?;
    wait_until_idle(&mut lines.host)?;
    let log = listing(lines)?;
    ensure(!log.contains("panic") && log.contains(" state ") && log.contains("N1G0Y1"), || log.clone())?;
    played("after_panic.log", &log).map(|_| ())
}

/// A session without a failure, in which motion is held, overridden, and interrupted by a reset. The simulator must be
/// able to replay its recording.
fn recorded_stops(lines: &mut Lines) -> Result<(), Failure> {
    hold_and_resume(lines)?;
    lines.send(b"\x91G90G1X0Y0F900\n")?;
    lines.expect("ok")?;
    wait_until_idle(&mut lines.host)?;
    lines.send(b"G91G1X50Y7F600\nX-50\n")?;
    lines.wait_until_beyond(2.0)?;
    lines.send(b"\x18")?;
    lines.expect("to unlock]")?;
    lines.send(b"$X\nG91G1X-1F600\n")?;
    lines.expect("ok\r\nok")?;
    wait_until_idle(&mut lines.host)?;
    let log = listing(lines)?;
    ensure(log.contains(" cut-off "), || log.clone())?;
    played("stops.log", &log).map(|_| ())
}

fn panics(lines: &mut Lines) -> Result<(), Failure> {
    failure(lines, b"P", "(panic)", &["[RESET:software]", "[CRASH:panic:mod.rs:", ": wanted by the (test stand)]"])
}

fn faults(lines: &mut Lines) -> Result<(), Failure> {
    failure(lines, b"F", "(fault)", &["[RESET:software]", "[CRASH:fault:at 0x000"])
}

fn control_hangs(lines: &mut Lines) -> Result<(), Failure> {
    failure(lines, b"C", "(stuck task)", &["[RESET:software]", "[CRASH:stuck task:control]"])
}

fn everything_hangs(lines: &mut Lines) -> Result<(), Failure> {
    failure(lines, b"H", "(watchdog)", &["[RESET:watchdog]\r\nok"])
}

/// Each kind of line takes a different path through the controller, and some paths need much stack.
fn every_kind(lines: &mut Lines) -> Result<(), Failure> {
    let kinds = [
        ("$$", "ok"),
        ("$#", "ok"),
        ("$G", "ok"),
        ("$I", "ok"),
        ("$N", "ok"),
        ("$", "ok"),
        ("$110=2000", "ok"),
        ("$N0=G10L2P9X1(remark)", "ok"),
        ("G21G91G17", "ok"),
        ("M3S300", "ok"),
        ("G2X2Y2I1J1F600", "ok"),
        ("G18G3X1Z1R3", "ok"),
        ("G93G1X1F60", "ok"),
        ("G94G90F500.5G1X1.25Y-3Z0.5", "ok"),
        ("G10L20P3X0Y0", "ok"),
        ("G92X1", "ok"),
        ("G28.1", "ok"),
        ("G53G0X1", "ok"),
        ("G43.1Z1", "ok"),
        ("G4P0.01", "ok"),
        ("M5", "ok"),
        ("$J=G91X0.5F400", "ok"),
        ("G91G38.3Z-0.5F300", "ok"),
        ("G1X", "error:"),
        ("G999", "error:"),
        ("M30", "ok"),
        ("$C", "ok"),
        ("G2X5Y5R9F100", "ok"),
        ("$C", "ok"),
        ("$RST=#", "ok"),
    ];
    for (line, answer) in kinds {
        wait_until_idle_or_checking(lines)?;
        lines.send(format!("{line}\n").as_bytes())?;
        let answers = read_until(&mut lines.host, LIMIT, |text| {
            text.lines().any(|l| l == "ok" || l.starts_with("error:")) && text.ends_with("\r\n")
        })?;
        ensure(answers.contains(answer) && !answers.contains("ALARM"), || format!("{line}: {answers}"))?;
    }
    Ok(())
}

fn wait_until_idle_or_checking(lines: &mut Lines) -> Result<(), Failure> {
    let begin = Instant::now();
    while begin.elapsed() < LIMIT {
        let status = lines.status()?;
        if ["<Idle|", "<Check|"].iter().any(|state| status.contains(state)) {
            return Ok(());
        }
        if status.contains("ALARM") || status.contains("<Alarm|") {
            return Err(status);
        }
    }
    Err("the machine did not come to rest".into())
}

fn ensure(condition: bool, why: impl FnOnce() -> String) -> Result<(), Failure> {
    if condition { Ok(()) } else { Err(why()) }
}

fn flood(lines: &mut Lines) -> Result<(), Failure> {
    // Some 2,500 bytes: ten times the capacity of the queue for line bytes.
    let mut text = b"G4P1\n".to_vec();
    text.extend(b"(comment)\n".repeat(250));
    lines.send(&text)?;
    let answers = read_until(&mut lines.host, LIMIT, |text| text.matches("ok\r\n").count() >= 251)?;
    ensure(!answers.contains("error") && !answers.contains("lost"), || format!("answers: {answers}"))
}

/// Writes more settings records than both sectors hold together, so that the log moves from one sector to the other and
/// back.
fn settings(lines: &mut Lines) -> Result<(), Failure> {
    const RECORDS: usize = 3_000;
    let mut text = b"$N1=G17\n$I=mill 7\nG10L2P2X1.5Y-2\n$100=123.5\n".to_vec();
    for i in 0..RECORDS {
        text.extend(format!("$101={}\n", 100 + i).bytes());
    }
    lines.send(&text)?;
    let answers = read_until(&mut lines.host, LIMIT, |text| text.matches("ok\r\n").count() >= 4 + RECORDS)?;
    ensure(!answers.contains("error") && !answers.contains("MSG"), || format!("answers: {answers}"))?;
    lines.stand.write_all(b"R").map_err(|error| error.to_string())?;
    let welcome = lines.expect(">G17:ok\r\n")?;
    ensure(welcome.contains("Grbl"), || format!("after the reset: {welcome}"))?;
    lines.send(b"$$\n")?;
    let listing = lines.expect("ok\r\n")?;
    ensure(listing.contains("$100=123.500\r\n$101=3099.000\r\n"), || listing)?;
    lines.send(b"$#\n")?;
    let parameters = lines.expect("ok\r\n")?;
    ensure(parameters.contains("[G55:1.500,-2.000,0.000]"), || parameters)?;
    lines.send(b"$I\n")?;
    let info = lines.expect("ok\r\n")?;
    ensure(info.contains("MILL7"), || info)
}

fn reboots(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"$100=123.5\nG92X5\n$REBOOT\n")?;
    lines.expect("ok\r\nok\r\nok\r\n")?;
    lines.expect("Grbl 1.1h")?;
    lines.send(b"$RC\n")?;
    let cause = lines.expect("ok\r\n")?;
    ensure(cause.contains("[RESET:software]"), || cause)?;
    lines.send(b"$$\n$#\n")?;
    let listings = lines.expect("[PRB:")?;
    ensure(listings.contains("$100=123.500\r\n") && listings.contains("[G92:0.000,0.000,0.000]"), || listings)
}

fn hold_and_resume(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X8Y2F600\n")?;
    lines.expect("ok")?;
    lines.wait_until_beyond(2.0)?;
    lines.send(b"!")?;
    lines.wait_for("<Hold:0|")?;
    let (first, second) = (lines.report()?, lines.report()?);
    ensure(first == second, || format!("steps in a hold: {first} {second}"))?;
    lines.send(b"~")?;
    let status = wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    ensure(status.contains("MPos:8.000,2.000,0.000"), || status)?;
    ensure(report.contains("steps=2000,500,0"), || report)
}

/// Any byte restarts the host timeout (`$922`), even a byte without a meaning, such as 0xFE.
fn silence(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"$922=2\n")?;
    lines.expect("ok\r\n")?;
    let mut writer = lines.host.try_clone().map_err(|error| error.to_string())?;
    lines.send(b"G4P10\n")?;
    let is_over = AtomicBool::new(false);
    let answer = thread::scope(|scope| {
        scope.spawn(|| {
            while !is_over.load(Ordering::Relaxed) && writer.write_all(&[0xFE]).is_ok() {
                thread::sleep(Duration::from_millis(5));
            }
        });
        let answer = lines.expect("\n");
        is_over.store(true, Ordering::Relaxed);
        answer
    })?;
    ensure(answer == "ok\r\n", || answer)?;
    lines.send(b"G4P10\n")?;
    let answer = lines.expect("\n")?;
    ensure(answer == "[MSG:The host is silent]\r\n", || answer)?;
    lines.wait_for("<Hold:0|")?;
    lines.send(b"\x18")?;
    lines.expect("Grbl")?;
    Ok(())
}

fn reset_in_motion(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X50F600\nX-50\n")?;
    lines.wait_until_beyond(2.0)?;
    lines.send(b"\x18")?;
    let answers = lines.expect("to unlock]")?;
    ensure(answers.contains("ALARM:3"), || format!("answers: {answers}"))?;
    let (first, status, second) = (lines.report()?, lines.wait_for("<Alarm|")?, lines.report()?);
    ensure(first == second, || format!("steps after a reset: {first} {second}"))?;
    // The reported position must match the pulses that were output: 250 steps/mm.
    let steps: f64 = second
        .split("steps=")
        .nth(1)
        .and_then(|rest| rest.split(',').next()?.parse().ok())
        .ok_or_else(|| format!("the test stand reports {second}"))?;
    ensure(status.contains(&format!("MPos:{:.3},", steps / 250.0)), || format!("{status} {second}"))?;
    lines.send(b"$X\nG1X-1F600\n")?;
    lines.expect("ok\r\nok")?;
    wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    // The reset has restored G90, so the machine must reach the absolute target, wherever it started.
    ensure(report.contains("steps=-250,0,0"), || format!("{second} {report}"))
}

fn reset_between_lines(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X1F600\n")?;
    lines.expect("ok")?;
    wait_until_idle(&mut lines.host)?;
    lines.send(b"G91G1X5F600\x18G91G1X1F600\n")?;
    // The welcome message and the answer after it can arrive together.
    read_until(&mut lines.host, LIMIT, |text| {
        text.split_once("Grbl").is_some_and(|(_, rest)| rest.contains("ok\r\n"))
    })?;
    wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    ensure(report.contains("steps=500,0,0"), || report)
}
