//! Reads recordings and compares them with the answers of a machine. Shared by the tests of the simulator and of the
//! firmware in QEMU.

use super::{differences, rules};
use serde_json::Value;
use std::fmt;

/// One record, a line of JSON in the file. `kind`: `boot`, `line`, `raw`, `rt`, `pin`, `wait` or `idle`. `send`: the
/// bytes sent, or the pin and its level. `acked`: `true` if `ok` or `error` came. `wait`: a pause, s.
pub struct Record {
    pub n: u64,
    pub kind: String,
    pub send: Vec<u8>,
    pub reply: Vec<String>,
    pub acked: bool,
    pub wait: f64,
}

/// Reads all records from the text of a recording (JSON lines).
pub fn read(text: &str) -> Vec<Record> {
    text.lines()
        .map(|line| {
            let value: Value = serde_json::from_str(line).expect("a recording is JSON lines");
            let text = |key: &str| value[key].as_str().unwrap_or_default().to_string();
            Record {
                n: value["n"].as_u64().expect("n"),
                kind: text("kind"),
                // A byte above 0x7F was recorded as the character with the same code.
                send: text("send").chars().map(|c| c as u32 as u8).collect(),
                reply: value["reply"]
                    .as_array()
                    .map(|lines| lines.iter().map(|l| l.as_str().expect("a line").to_string()).collect())
                    .unwrap_or_default(),
                acked: value["acked"].as_bool().unwrap_or(false),
                wait: value["wait"].as_f64().unwrap_or(0.0),
            }
        })
        .collect()
}

/// Returns the lines that are not empty.
pub fn lines(text: &str) -> Vec<String> {
    text.split("\r\n").filter(|line| !line.is_empty()).map(str::to_string).collect()
}

/// Returns the number of `ok` and `error` lines.
#[allow(dead_code, reason = "in QEMU the host inside the machine counts")]
pub fn answers(text: &str) -> usize {
    lines(text).iter().filter(|line| *line == "ok" || line.starts_with("error:")).count()
}

/// Results of the comparison so far: the numbers of records whose answers are equal to the recorded ones, accepted by
/// a rule, or listed as a difference. `other`: a message for each record with other answers.
#[derive(Clone)]
pub struct Tally {
    pub equal: usize,
    pub by_rule: usize,
    pub listed: usize,
    pub other: Vec<String>,
    used: Vec<bool>,
}

impl Tally {
    pub fn new() -> Tally {
        Tally { equal: 0, by_rule: 0, listed: 0, other: Vec::new(), used: vec![false; differences::DIFFERENCES.len()] }
    }

    /// Compares the machine's output `said` with the answers in a record, and counts the result.
    pub fn judge(&mut self, group: &str, record: &Record, said: &str) {
        let got = lines(said);
        let listed = differences::DIFFERENCES.iter().position(|d| d.group == group && d.n == record.n);
        if got == record.reply {
            self.equal += 1;
        } else if let Some(index) = listed {
            let difference = &differences::DIFFERENCES[index];
            self.used[index] = true;
            if difference.answers.is_none_or(|answers| answers == got) {
                self.listed += 1;
            } else {
                self.other.push(format!("{group} {}: listed, but answered {got:?}", record.n));
            }
        } else if rules::equal(differences::is_stopped(group, record.n), &record.reply, &got) {
            self.by_rule += 1;
        } else {
            let send = String::from_utf8_lossy(&record.send);
            self.other.push(format!(
                "{group} {} {} {send:?}\n    recorded {:?}\n    answered {got:?}",
                record.n, record.kind, record.reply
            ));
        }
    }

    /// Returns the listed differences that have not occurred, each as its group and number.
    #[allow(dead_code, reason = "the firmware in QEMU is asked for a part only")]
    pub fn unused(&self) -> Vec<String> {
        let unused = differences::DIFFERENCES.iter().zip(&self.used).filter(|(_, used)| !**used);
        unused.map(|(d, _)| format!("{} {}", d.group, d.n)).collect()
    }
}

impl fmt::Display for Tally {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        let Tally { equal, by_rule, listed, other, .. } = self;
        write!(
            out,
            "{equal} equal, {by_rule} equal but for wall time, {listed} listed differences, {} other",
            other.len()
        )
    }
}
