//! The host side of the tests: sends lines as a sender program does and reads the answers.

use super::oracle::AXES;
use super::rig::Rig;
use oxmill_test_support::numbers;

/// Virtual seconds to wait for an answer before the test fails.
const PATIENCE: f64 = 3600.0;

/// Settings of a machine for carving: 80 steps/mm, 6000 mm/min, 500 mm/s².
pub const CARVER: &str = "$100=80\n$101=80\n$102=80\n$110=6000\n$111=6000\n$112=6000\n$120=500\n$121=500\n$122=500\n";
/// Steps per mm of [`CARVER`].
pub const CARVER_STEPS: f64 = 80.0;

impl Rig {
    /// Returns a machine whose greeting has been read, with these `$n=v` lines applied.
    pub fn with(settings: &str) -> Rig {
        let mut rig = Rig::new();
        assert_eq!(rig.read_lines(), ["", "Grbl 1.1h ['$' for help]"]);
        for line in settings.lines() {
            // Only the first line of the answer is compared. Settings are sent one by one, so together they can be
            // unusable for a while. Then a message follows the `ok`.
            assert_eq!(rig.ask(line).first().map(String::as_str), Some("ok"), "{line}");
        }
        rig
    }

    /// Returns the received lines, without their line ends.
    pub fn read_lines(&mut self) -> Vec<String> {
        let text = self.take_output();
        assert!(text.is_empty() || text.ends_with("\r\n"), "half a line: {text:?}");
        text.split_terminator("\r\n").map(str::to_string).collect()
    }

    /// Sends one line and waits for its `ok` or `error`; returns all lines received until then.
    pub fn ask(&mut self, line: &str) -> Vec<String> {
        self.send(format!("{line}\n").as_bytes());
        let mut text = String::new();
        let answered = self.run_until(PATIENCE, |rig| {
            if rig.output_len() > 0 {
                text.push_str(&rig.take_output());
            }
            is_answered(&text)
        });
        assert!(answered, "no answer to {line:?}, only {text:?}");
        text.lines().map(str::to_string).collect()
    }

    /// Waits until nothing moves and no answer is pending.
    pub fn settle(&mut self) {
        assert!(self.run_until(PATIENCE, |rig| rig.is_idle()), "never idle");
    }

    /// Sends one line, expects `ok` and waits until the machine is idle.
    pub fn carry_out(&mut self, line: &str) {
        assert_eq!(self.ask(line), ["ok"], "{line}");
        self.settle();
    }

    /// Streams a whole program and waits for its end. Returns the answer to each line.
    pub fn run_program(&mut self, text: &str) -> Vec<String> {
        let mut answers: Vec<String> = Vec::new();
        for line in text.lines() {
            self.send(format!("{line}\n").as_bytes());
            // Keep a few lines in flight, as a sender that counts characters does.
            if self.output_len() > 0 {
                answers.extend(self.read_lines());
            }
            self.run_until(PATIENCE, |rig| rig.waiting() < 200);
        }
        self.settle();
        answers.extend(self.read_lines());
        answers.retain(|line| line == "ok" || line.starts_with("error:"));
        answers
    }

    /// Streams a program in which every line must be accepted.
    pub fn run_clean(&mut self, text: &str) {
        let answers = self.run_program(text);
        for (number, (line, answer)) in text.lines().zip(&answers).enumerate() {
            assert_eq!(answer, "ok", "line {}: {line}", number + 1);
        }
        assert_eq!(answers.len(), text.lines().count());
    }

    /// Requests a status report and returns its line.
    pub fn status(&mut self) -> String {
        self.send(b"?");
        let lines = self.read_lines();
        let report = lines.iter().find(|line| line.starts_with('<')).unwrap_or_else(|| panic!("no report: {lines:?}"));
        report.clone()
    }

    /// Requests a status report and returns one of its positions, mm. `name`: `MPos` or `WPos`.
    pub fn reported(&mut self, name: &str) -> [f64; AXES] {
        let report = self.status();
        numbers(&report, name).unwrap_or_else(|| panic!("no {name} in {report}"))
    }

    /// Returns the position according to the counted pulses, mm.
    pub fn place_mm(&self, steps_per_mm: f64) -> [f64; AXES] {
        self.place.map(|steps| steps as f64 / steps_per_mm)
    }
}

/// Returns whether a text contains an `ok` or an `error` as a whole line.
fn is_answered(text: &str) -> bool {
    text.ends_with('\n') && text.lines().any(|line| line == "ok" || line.starts_with("error:"))
}

/// Asserts that two positions agree within `slack`, in mm.
#[track_caller]
pub fn assert_near(found: [f64; AXES], expected: [f64; AXES], slack: f64) {
    for axis in 0..AXES {
        assert!((found[axis] - expected[axis]).abs() <= slack, "{found:?} instead of {expected:?}");
    }
}
