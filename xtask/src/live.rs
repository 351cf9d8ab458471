//! Conversations with the firmware in QEMU that need its tasks and interrupts: what the simulator has no part in.

use crate::jobs::{read_until, wait_until_idle};
use crate::{Failure, QEMU_BOARD, image, qemu};
use std::io::Write;
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};

const LIMIT: Duration = Duration::from_secs(60);

/// The host's line and the test stand's.
struct Lines {
    host: TcpStream,
    stand: TcpStream,
}

type Test = fn(&mut Lines) -> Result<(), Failure>;

/// All of them, each with a machine that was just switched on.
pub fn all() -> Result<(), Failure> {
    let image = image::build(QEMU_BOARD)?;
    let tests: [(&str, Test); 5] = [
        ("settings_are_there_again_after_a_reset_of_the_machine", settings),
        ("a_flood_of_lines_behind_a_dwell_loses_nothing", flood),
        ("a_hold_brakes_and_a_resume_goes_on_to_the_end", hold_and_resume),
        ("a_reset_in_motion_stops_for_good_and_raises_an_alarm", reset_in_motion),
        ("a_reset_drops_what_came_before_it_and_nothing_after", reset_between_lines),
    ];
    println!("\nrunning {} conversations with the firmware on QEMU", tests.len());
    let mut failed = 0;
    for (name, test) in tests {
        match once(&image.path, test) {
            Ok(()) => println!("conversation {name} ... ok"),
            Err(why) => {
                println!("conversation {name} ... FAILED\n  {why}");
                failed += 1;
            }
        }
    }
    println!("conversation result: {} passed; {failed} failed\n", tests.len() - failed);
    if failed == 0 { Ok(()) } else { Err(format!("{failed} conversations failed")) }
}

fn once(elf: &Path, test: Test) -> Result<(), Failure> {
    let (_qemu, host, stand) = qemu::live(elf)?;
    test(&mut Lines { host, stand })
}

impl Lines {
    fn send(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        self.host.write_all(bytes).map_err(|error| error.to_string())
    }

    /// Reads until a text has come.
    fn expect(&mut self, wanted: &str) -> Result<String, Failure> {
        read_until(&mut self.host, LIMIT, |text| text.contains(wanted))
    }

    fn status(&mut self) -> Result<String, Failure> {
        self.send(b"?")?;
        self.expect(">\r\n")
    }

    /// Asks until the status begins so.
    fn wait_for(&mut self, state: &str) -> Result<String, Failure> {
        let begin = Instant::now();
        while begin.elapsed() < LIMIT {
            let status = self.status()?;
            if status.contains(state) {
                return Ok(status);
            }
        }
        Err(format!("the state never became {state}"))
    }

    /// Lets a motion that has begun go on until X is at least here.
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
        self.stand.write_all(b"r").map_err(|error| error.to_string())?;
        read_until(&mut self.stand, LIMIT, |text| text.ends_with('\n'))
    }
}

fn hold_on(condition: bool, why: impl FnOnce() -> String) -> Result<(), Failure> {
    if condition { Ok(()) } else { Err(why()) }
}

fn flood(lines: &mut Lines) -> Result<(), Failure> {
    // Ten times what the line queue holds.
    let mut text = b"G4P1\n".to_vec();
    text.extend(b"(comment)\n".repeat(250));
    lines.send(&text)?;
    let answers = read_until(&mut lines.host, LIMIT, |text| text.matches("ok\r\n").count() >= 251)?;
    hold_on(!answers.contains("error") && !answers.contains("lost"), || format!("answers: {answers}"))
}

/// More records than the two sectors hold together, so that the log has moved from one to the other and back.
fn settings(lines: &mut Lines) -> Result<(), Failure> {
    const RECORDS: usize = 3_000;
    let mut text = b"$N1=G17\n$I=mill 7\nG10L2P2X1.5Y-2\n$100=123.5\n".to_vec();
    for i in 0..RECORDS {
        text.extend(format!("$101={}\n", 100 + i).bytes());
    }
    lines.send(&text)?;
    let answers = read_until(&mut lines.host, LIMIT, |text| text.matches("ok\r\n").count() >= 4 + RECORDS)?;
    hold_on(!answers.contains("error") && !answers.contains("MSG"), || format!("answers: {answers}"))?;
    lines.stand.write_all(b"R").map_err(|error| error.to_string())?;
    let welcome = lines.expect(">G17:ok\r\n")?;
    hold_on(welcome.contains("Grbl"), || format!("after the reset: {welcome}"))?;
    lines.send(b"$$\n")?;
    let listing = lines.expect("ok\r\n")?;
    hold_on(listing.contains("$100=123.500\r\n$101=3099.000\r\n"), || listing)?;
    lines.send(b"$#\n")?;
    let parameters = lines.expect("ok\r\n")?;
    hold_on(parameters.contains("[G55:1.500,-2.000,0.000]"), || parameters)?;
    lines.send(b"$I\n")?;
    let info = lines.expect("ok\r\n")?;
    hold_on(info.contains("MILL7"), || info)
}

fn hold_and_resume(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X8Y2F600\n")?;
    lines.expect("ok")?;
    lines.wait_until_beyond(2.0)?;
    lines.send(b"!")?;
    lines.wait_for("<Hold:0|")?;
    let (first, second) = (lines.report()?, lines.report()?);
    hold_on(first == second, || format!("steps in a hold: {first} {second}"))?;
    lines.send(b"~")?;
    let status = wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    hold_on(status.contains("MPos:8.000,2.000,0.000"), || status)?;
    hold_on(report.contains("steps=2000,500,0"), || report)
}

fn reset_in_motion(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X50F600\nX-50\n")?;
    lines.wait_until_beyond(2.0)?;
    lines.send(b"\x18")?;
    let answers = lines.expect("to unlock]")?;
    hold_on(answers.contains("ALARM:3"), || format!("answers: {answers}"))?;
    let (first, status, second) = (lines.report()?, lines.wait_for("<Alarm|")?, lines.report()?);
    hold_on(first == second, || format!("steps after a reset: {first} {second}"))?;
    // The position reported is the position of the pulses: 250 steps/mm.
    let steps: f64 = second
        .split("steps=")
        .nth(1)
        .and_then(|rest| rest.split(',').next()?.parse().ok())
        .ok_or_else(|| format!("the test stand reports {second}"))?;
    hold_on(status.contains(&format!("MPos:{:.3},", steps / 250.0)), || format!("{status} {second}"))?;
    lines.send(b"$X\nG1X-1F600\n")?;
    lines.expect("ok\r\nok")?;
    wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    // The reset has brought G90 back: an absolute place is reached from wherever the machine was stopped.
    hold_on(report.contains("steps=-250,0,0"), || format!("{second} {report}"))
}

fn reset_between_lines(lines: &mut Lines) -> Result<(), Failure> {
    lines.send(b"G21G91G1X1F600\n")?;
    lines.expect("ok")?;
    wait_until_idle(&mut lines.host)?;
    lines.send(b"G91G1X5F600\x18G91G1X1F600\n")?;
    lines.expect("Grbl")?;
    lines.expect("ok")?;
    wait_until_idle(&mut lines.host)?;
    let report = lines.report()?;
    hold_on(report.contains("steps=500,0,0"), || report)
}
