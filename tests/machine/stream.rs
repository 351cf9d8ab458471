//! Long and hostile streams: every line is answered, and every pulse is accounted for.

use super::host::{CARVER, CARVER_STEPS};
use super::rig::Rig;
use oxmill_test_support::{Random, numbers};
use std::collections::VecDeque;
use std::fmt::Write;

fn number(random: &mut Random) -> String {
    match random.below(12) {
        0 => "0".into(),
        1 => format!("-{}", random.below(3)),
        2 => format!(".{}", random.below(1000)),
        3 => format!("{}.", random.below(4)),
        4 => format!("+{}.{}", random.below(2), random.below(100_000_000)),
        5 => random.of(&["1.2.3", "", "-", "1e3", "99999999999999999999", "--1", "0x10", "#1", "nan"]).into(),
        _ => format!("{}{}.{:03}", random.of(&["", "-"]), random.below(3), random.below(1000)),
    }
}

/// Returns a random line, without its end.
fn line(random: &mut Random) -> String {
    let mut line = String::new();
    match random.below(20) {
        // Short moves and arcs, as most lines of a job are.
        0..=7 => {
            line += random.of(&["G0", "G1", "", "G1", "g1", "N7G1", "G53 G0", "G90 G0", "G91 G1"]);
            for letter in ["X", "Y", "Z"] {
                if random.below(2) == 0 {
                    write!(line, " {letter}{}.{:02}", random.below(2), random.below(100)).unwrap();
                }
            }
            if random.below(3) == 0 {
                write!(line, "F{}", 600 + random.below(9000)).unwrap();
            }
        }
        8 | 9 => {
            line += random.of(&["G2", "G3", "G17 G2", "G18 G3", "G19 G2"]);
            for letter in ["X", "Y", "Z", "I", "J", "K", "R"] {
                if random.below(3) == 0 {
                    write!(line, "{letter}{}.{}", random.below(2), random.below(10)).unwrap();
                }
            }
        }
        10 => {
            line += random.of(&[
                "G4 P0.01",
                "G4 P0",
                "G21",
                "G90",
                "G91",
                "G17",
                "G54",
                "G55",
                "G94",
                "G93",
                "M3 S500",
                "M4 S100",
                "M5",
                "M8",
                "M9",
                "G40",
                "G49",
                "G61",
                "G80",
                "G92 X0 Y0",
                "G92.1",
                "G10 L2 P1 X0 Y0 Z0",
                "G10 L20 P2 X1",
                "G28.1",
                "G30.1",
                "M1",
                "T3",
                "S1000",
                "G43.1 Z0.1",
                "M30",
                "M2",
                "",
                "(remark)",
                "F-1",
                "F",
                "F1.2.3",
                "F1e3",
                "F 900",
                "G1F",
                "F0",
            ]);
        }
        11 => {
            line += random.of(&[
                "$",
                "$$",
                "$#",
                "$G",
                "$I",
                "$N",
                "$X",
                "$C",
                "$10=1",
                "$11=0.01",
                "$900=1",
                "$1=25",
                "$H",
                "$J=G91X0.1F1000",
                "$J=G91 X-0.1 Y.05 F2000",
                "$J=X",
                "$999=1",
                "$N1=",
                "$RST=",
                "$10=",
                "$X=1",
            ]);
        }
        12 => {
            for _ in 0..random.below(120) {
                // Printable characters, except `!`, `?` and `~`, which act at once.
                let byte = b' ' + random.below(94) as u8;
                line.push(if matches!(byte, b'!' | b'?') { '.' } else { char::from(byte) });
            }
        }
        13 => {
            let length = random.below(400) as usize;
            line += &"X1".repeat(length / 2);
        }
        _ => {
            // No F words: at F0.01 the stream would take days of virtual time.
            for _ in 0..1 + random.below(6) {
                line += random.of(&["G", "M", "X", "Y", "Z", "S", "P", "L", "I", "J", "K", "N", "R", "T", "(", ")"]);
                line += &number(random);
            }
        }
    }
    line
}

/// Maximum number of bytes in flight: the line queue holds 255, and bytes beyond that would delay a realtime command
/// sent after them.
const ON_THE_WAY: usize = 240;

/// A machine that receives a stream of lines, and what the host has counted in its answers.
struct Stream {
    rig: Rig,
    /// Lengths of the lines sent and not yet answered.
    open: VecDeque<usize>,
    answered: usize,
    dropped: usize,
    errors: usize,
    alarms: usize,
    unread: String,
}

impl Stream {
    fn read(&mut self) {
        self.unread.push_str(&self.rig.take_output());
        while let Some(end) = self.unread.find("\r\n") {
            let line: String = self.unread.drain(..end + 2).collect();
            let line = line.trim_end();
            if line == "ok" || line.starts_with("error:") {
                assert!(self.open.pop_front().is_some(), "an answer too many: {line}");
                self.answered += 1;
                self.errors += usize::from(line != "ok");
            } else if line.starts_with("Grbl ") {
                // The controller sends a greeting after a reset, at the end of `$C` and after `$RST`. It has dropped
                // the unanswered lines.
                self.dropped += self.open.len();
                self.open.clear();
            } else if line.starts_with("ALARM:") {
                self.alarms += 1;
            }
        }
    }

    /// Sends a line, after waiting until there is room for it.
    fn send(&mut self, bytes: &[u8]) {
        if self.open.iter().sum::<usize>() + bytes.len() > ON_THE_WAY {
            self.drain();
        }
        self.open.push_back(bytes.len());
        self.rig.send(bytes);
        self.read();
    }

    /// Lets time pass until all lines are answered, and resumes a machine that waits.
    fn drain(&mut self) {
        for _ in 0..100 {
            let (unread, open) = (&mut self.unread, self.open.len());
            let mut answers = 0;
            self.rig.run_until(5.0, |rig| {
                if rig.output_len() > 0 {
                    let text = rig.take_output();
                    answers += text.lines().filter(|l| *l == "ok" || l.starts_with("error:")).count();
                    unread.push_str(&text);
                }
                answers >= open
            });
            self.read();
            if self.open.is_empty() {
                return;
            }
            // Not all lines are answered: the machine waits in a hold or after M0, so resume it.
            self.rig.send(b"~");
        }
        panic!("{} lines are never answered: {}", self.open.len(), self.rig.status());
    }

    fn reset(&mut self) {
        self.rig.send(b"\x18");
        let unread = &mut self.unread;
        let greeted = self.rig.run_until(5.0, |rig| {
            unread.push_str(&rig.take_output());
            unread.contains("Grbl 1.1h")
        });
        assert!(greeted, "no greeting after a reset");
        self.read();
        assert!(self.open.is_empty());
    }

    /// Checks that the reported position equals the position that the step pulses make.
    fn account(&mut self) {
        let report = {
            self.rig.send(b"?");
            self.unread.push_str(&self.rig.take_output());
            let at = self.unread.rfind('<').expect("a report");
            self.unread[at..].lines().next().expect("a line").to_string()
        };
        self.read();
        let place = numbers::<3>(&report, "MPos").expect("a machine position");
        // During a move the report can be ahead of the pulses, by at most the segment in progress.
        if !report.starts_with("<Run") && !report.starts_with("<Jog") && !report.starts_with("<Hold:1") {
            for (axis, mm) in place.iter().enumerate() {
                let steps = mm * CARVER_STEPS;
                assert!((steps - self.rig.place[axis] as f64).abs() < 0.05, "{report} but {:?}", self.rig.place);
            }
        }
    }
}

/// 100,000 lines, valid and invalid, with realtime bytes between and within them. The controller must not panic or
/// hang, and must answer each line once, unless a reset has dropped the line.
#[test]
fn any_stream_is_answered_line_by_line() {
    const LINES: usize = 100_000;
    let mut random = Random(0x0005_EED0_F0A1_1CE5);
    let mut rig = Rig::with(CARVER);
    rig.keep_trace = false;
    let mut stream =
        Stream { rig, open: VecDeque::new(), answered: 0, dropped: 0, errors: 0, alarms: 0, unread: String::new() };
    let mut resets = 0;
    for number in 0..LINES {
        let mut bytes = line(&mut random).into_bytes();
        bytes.push(b'\n');
        // Insert a realtime byte at any position of the line, at the latest directly before the line end.
        if bytes.len() < ON_THE_WAY && random.below(8) == 0 {
            let command = match random.below(16) {
                0..=3 => b'?',
                4 => b'!',
                5 | 6 => b'~',
                7 => 0x85,
                8 => 0xA0,
                9 => 0x9E,
                _ => 0x90 + random.below(14) as u8,
            };
            let at = random.below(bytes.len() as u64) as usize;
            bytes.insert(at, command);
        }
        stream.send(&bytes);
        if random.below(4) == 0 {
            stream.rig.run_for(random.below(40) as f64 / 1000.0);
            stream.read();
        }
        if random.below(300) == 0 {
            resets += 1;
            stream.reset();
        }
        if random.below(30) == 0 {
            stream.send(b"\n");
            stream.send(b"$X\n");
        }
        if number % 50 == 0 || number + 1 == LINES {
            stream.drain();
        }
        if number % 500 == 0 {
            stream.account();
        }
    }
    stream.account();
    assert!(resets > 200 && stream.alarms > 20, "{resets} resets, {} alarms", stream.alarms);
    assert!(stream.errors > LINES / 10 && stream.errors < LINES * 9 / 10, "{} errors", stream.errors);
    assert!(stream.dropped < LINES / 20, "{} lines dropped", stream.dropped);
    assert!(stream.answered + stream.dropped >= LINES);
    assert!(stream.rig.place != [0; 3]);
}

/// A million increments of a thousandth add up to exactly a thousand.
#[test]
fn a_million_thousandths_make_a_thousand() {
    let mut rig = Rig::with("$0=5\n$100=80\n$110=60000\n$120=5000\n");
    rig.keep_trace = false;
    rig.send(b"G21 G91\nG1 X0.001 F60000\n");
    let mut answers = 0;
    let chunk = "G1 X0.001\n".repeat(1000);
    let mut count = |rig: &mut Rig| {
        let text = rig.take_output();
        assert!(!text.contains("error") && !text.contains("ALARM"), "{text}");
        answers += text.matches("ok\r\n").count();
    };
    rig.send("G1 X0.001\n".repeat(999).as_bytes());
    for _ in 1..1000 {
        rig.send(chunk.as_bytes());
        assert!(rig.run_until(1000.0, |rig| rig.waiting() < 1000));
        count(&mut rig);
    }
    rig.settle();
    count(&mut rig);
    assert_eq!(answers, 1_000_001);
    assert_eq!(rig.place, [80_000, 0, 0]);
    assert!(rig.status().starts_with("<Idle|MPos:1000.000,0.000,0.000|"));
    // The position is exact and not only rounded to the nearest step: the return move makes the same number of steps.
    rig.carry_out("G90 X0");
    assert_eq!(rig.place, [0, 0, 0]);
}
