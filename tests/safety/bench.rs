//! Test bench: the simulator in process, with its unread output and the position that its pulses make.

use oxmill_simulator::{Fittings, Options, Simulator, boards};
use oxmill_test_support::numbers;
use std::time::Duration;

pub const AXES: usize = oxmill_controller::axes::LINEAR;
/// Step clock, Hz.
pub const HZ: u64 = boards::DESK.step_clock_hz as u64;
/// Steps/mm of all machines here; a step is 0.004 mm, so a report shows positions exactly.
pub const STEPS: f64 = 250.0;
/// Virtual seconds to wait for an answer before the test fails.
const PATIENCE: f64 = 1000.0;
/// Interval at which [`Bench::read_until`] checks the output, s.
const LOOK: f64 = 0.005;

#[derive(Clone)]
pub struct Bench {
    pub mill: Simulator,
    /// Output that [`Bench::read`] has not returned yet.
    unread: String,
}

/// Returns the setting that a lock message names.
#[track_caller]
pub fn locking(message: &str) -> String {
    let name = message.strip_prefix("[MSG:Motion is locked until you correct this setting: ");
    name.and_then(|name| name.strip_suffix(']')).unwrap_or_else(|| panic!("{message}")).to_string()
}

impl Bench {
    /// Returns a machine with this hardware (TOML) and these `$n=v` settings, separated by blanks.
    pub fn new(machine: &str, settings: &str) -> Bench {
        let fittings = if machine.is_empty() { Fittings::default() } else { Fittings::parse(machine).unwrap() };
        let mill = Simulator::new(Options { keep_steps: true, fittings, ..Options::default() });
        let mut bench = Bench { mill, unread: String::new() };
        assert_eq!(bench.read(), ["", "Grbl 1.1h ['$' for help]"]);
        for line in settings.split_whitespace() {
            bench.set(line);
        }
        bench
    }

    /// Sends a setting. If the settings are unusable afterwards, returns the setting that the lock message names,
    /// otherwise `None`.
    #[track_caller]
    pub fn set(&mut self, line: &str) -> Option<String> {
        let said = self.ask(line);
        match said.as_slice() {
            [ok] if ok == "ok" => None,
            [ok, message] if ok == "ok" => Some(locking(message)),
            _ => panic!("{line}: {said:?}"),
        }
    }

    /// Returns the complete lines that have not been read yet.
    pub fn read(&mut self) -> Vec<String> {
        self.unread.push_str(&self.mill.take_output());
        let end = self.unread.rfind('\n').map_or(0, |at| at + 1);
        let rest = self.unread.split_off(end);
        let text = std::mem::replace(&mut self.unread, rest);
        text.split_terminator("\r\n").map(str::to_string).collect()
    }

    pub fn send(&mut self, bytes: impl AsRef<[u8]>) {
        self.mill.send(bytes);
    }

    /// Lets virtual time pass.
    pub fn wait(&mut self, seconds: f64) {
        self.mill.run_for(Duration::from_secs_f64(seconds));
    }

    /// Sends a line and waits for its `ok` or `error`; returns all lines received until then.
    pub fn ask(&mut self, line: &str) -> Vec<String> {
        self.send(format!("{line}\n"));
        self.read_until(line, |said| said.iter().any(|l| l == "ok" || l.starts_with("error:")))
    }

    /// Reads lines until `enough` accepts them, and returns them. `what`: name of this wait in the message of a
    /// failure.
    #[track_caller]
    pub fn read_until(&mut self, what: &str, enough: impl Fn(&[String]) -> bool) -> Vec<String> {
        let end = self.seconds() + PATIENCE;
        let mut said = self.read();
        while !enough(&said) {
            assert!(self.seconds() < end, "{what:?}: only {said:?}, {}", self.status());
            self.wait(LOOK);
            said.extend(self.read());
        }
        said
    }

    /// Sends a line, expects `ok` and waits until the machine is idle.
    #[track_caller]
    pub fn carry_out(&mut self, line: &str) {
        assert_eq!(self.ask(line), ["ok"], "{line}");
        self.settle();
    }

    /// Waits until nothing moves and no answer is pending.
    #[track_caller]
    pub fn settle(&mut self) {
        assert!(self.mill.run_until_idle(), "never idle: {}", self.status());
    }

    /// Returns the virtual seconds since power-up.
    pub fn seconds(&self) -> f64 {
        self.mill.clock().now() as f64 / HZ as f64
    }

    /// Returns the status report; other lines stay unread.
    pub fn status(&mut self) -> String {
        self.unread.push_str(&self.mill.take_output());
        self.mill.send("?");
        let report = self.mill.take_output();
        let at = report.find('<').unwrap_or_else(|| panic!("no report but {report:?}"));
        self.unread.push_str(&report[..at]);
        let (line, rest) = report[at..].split_once("\r\n").expect("a whole line");
        self.unread.push_str(rest);
        line.to_string()
    }

    /// Returns the state from a status report, such as `Idle` or `Hold:0`.
    pub fn state(&mut self) -> String {
        let status = self.status();
        status.trim_start_matches('<').split(['|', '>']).next().expect("a state").to_string()
    }

    pub fn pin(&mut self, line: &str) {
        assert_eq!(self.mill.pin_line(line), "ok", "{line}");
    }

    /// Returns the position that the pulses make, in steps.
    pub fn place(&self) -> [i32; AXES] {
        self.mill.machine().position()
    }

    /// Returns the reported machine position, in steps.
    pub fn reported(&mut self) -> [f64; AXES] {
        let status = self.status();
        numbers::<AXES>(&status, "MPos").unwrap_or_else(|| panic!("no MPos in {status}")).map(|mm| mm * STEPS)
    }
}

/// Asserts that two positions in steps are equal. They can be compared exactly, because a report with three decimals
/// shows a step of 0.004 mm exactly.
#[track_caller]
pub fn assert_place(reported: [f64; AXES], steps: [i32; AXES], what: &str) {
    for axis in 0..AXES {
        assert!((reported[axis] - f64::from(steps[axis])).abs() < 0.01, "{what}: reported {reported:?}, is {steps:?}");
    }
}
