//! A machine on the bench: the simulator in process, what it said, and where its pulses have brought it.

use oxmill_simulator::{Fittings, Options, Simulator, boards};
use oxmill_test_support::numbers;
use std::time::Duration;

pub const AXES: usize = oxmill_controller::axes::LINEAR;
/// Step clock.
pub const HZ: u64 = boards::DESK.step_clock_hz as u64;
/// Steps/mm of all machines here; a step is 0.004 mm, so that a report shows it exactly.
pub const STEPS: f64 = 250.0;
/// Virtual seconds after which an answer is missed.
const PATIENCE: f64 = 1000.0;
/// Between two looks while something is waited for, s.
const LOOK: f64 = 0.005;

#[derive(Clone)]
pub struct Bench {
    pub mill: Simulator,
    /// What has been said and not been read.
    unread: String,
}

/// The setting that a message names.
#[track_caller]
pub fn locking(message: &str) -> String {
    let name = message.strip_prefix("[MSG:Motion is locked until this setting is mended: ");
    name.and_then(|name| name.strip_suffix(']')).unwrap_or_else(|| panic!("{message}")).to_string()
}

impl Bench {
    /// A machine fitted so (TOML) with these `$n=v` lines.
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

    /// Sends a setting, which may make the set one that cannot be run. The setting that is named then.
    #[track_caller]
    pub fn set(&mut self, line: &str) -> Option<String> {
        let said = self.ask(line);
        match said.as_slice() {
            [ok] if ok == "ok" => None,
            [ok, message] if ok == "ok" => Some(locking(message)),
            _ => panic!("{line}: {said:?}"),
        }
    }

    /// The answer lines that have come.
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

    /// Sends a line and waits for its `ok` or `error`; everything that came until then.
    pub fn ask(&mut self, line: &str) -> Vec<String> {
        self.send(format!("{line}\n"));
        self.read_until(line, |said| said.iter().any(|l| l == "ok" || l.starts_with("error:")))
    }

    /// Waits until what was said is enough.
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

    /// Sends a line, expects `ok` and waits for the end of what it does.
    #[track_caller]
    pub fn carry_out(&mut self, line: &str) {
        assert_eq!(self.ask(line), ["ok"], "{line}");
        self.settle();
    }

    /// Waits until nothing moves and nothing is owed.
    #[track_caller]
    pub fn settle(&mut self) {
        assert!(self.mill.run_until_idle(), "never idle: {}", self.status());
    }

    /// Seconds since power-up.
    pub fn seconds(&self) -> f64 {
        self.mill.clock().now() as f64 / HZ as f64
    }

    /// The status report; other lines that wait stay unread.
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

    /// The first field of the status report.
    pub fn state(&mut self) -> String {
        let status = self.status();
        status.trim_start_matches('<').split(['|', '>']).next().expect("a state").to_string()
    }

    pub fn pin(&mut self, line: &str) {
        assert_eq!(self.mill.pin_line(line), "ok", "{line}");
    }

    /// Where the pulses have brought the machine.
    pub fn place(&self) -> [i32; AXES] {
        self.mill.machine().position()
    }

    /// The machine position as reported, in steps.
    pub fn reported(&mut self) -> [f64; AXES] {
        let status = self.status();
        numbers::<AXES>(&status, "MPos").unwrap_or_else(|| panic!("no MPos in {status}")).map(|mm| mm * STEPS)
    }
}

/// Whether places in steps are the same; a report of three decimals shows a step of 0.004 mm exactly.
#[track_caller]
pub fn assert_place(reported: [f64; AXES], steps: [i32; AXES], what: &str) {
    for axis in 0..AXES {
        assert!((reported[axis] - f64::from(steps[axis])).abs() < 0.01, "{what}: reported {reported:?}, is {steps:?}");
    }
}
