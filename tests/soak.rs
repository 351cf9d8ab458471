//! Plays a long job with everything that happens in a day at the machine. Lines of every kind come as fast as the
//! receive buffer takes them, with holds, overrides, reports, stops and resets among them. Hosts close the port and
//! reconnect, or are silent for too long. Inputs stop the machine. `$924` to `$928` select the reactions.
//!
//! Four conditions must hold. Each line is answered once. Whenever the machine comes to rest, the motors have made
//! exactly the steps of the program. After a stop or a reset, the reported position is that of the motors, and the
//! program continues from there. Memory does not grow.
//!
//! `OXMILL_SOAK=N` plays N lines instead of 3,000; `OXMILL_SOAK_SEED` sets the seed.

use oxmill_simulator::{Options, Simulator};
use oxmill_test_support::program::{AXES, Program, SETTINGS, STEPS_PER_MM};
use oxmill_test_support::{Random, numbers};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// Maximum virtual time until all answers have arrived at the end of a chunk (the lines between two rests).
const PATIENCE: Duration = Duration::from_secs(600);
/// Tolerated growth of the process, KiB: memory that the allocator keeps.
const GROWTH: u64 = 4_096;
/// Settings that enable the host timeouts of jobs (`$922`) and jogs (`$923`), and hard limits.
const WATCHES: [&str; 3] = ["$922=0.3", "$923=0.2", "$21=1"];
/// Reactions (values of `$924` to `$928`) that keep the position. After a host timeout they keep the job, too.
const CONTROLLED: [&str; 4] = ["1", "2", "4", "5"];
/// Inputs that stop the machine: the name in the pin protocol, the setting that selects the reaction, and the alarm.
const FAULTS: [(&str, &str, &str); 3] =
    [("limit x", "$924", "ALARM:1"), ("estop", "$925", "ALARM:101"), ("fault", "$926", "ALARM:102")];

/// How often each kind of event has occurred; printed with failures and at the end.
#[derive(Default, Debug)]
struct Counts {
    lines: u64,
    rests: u64,
    reports: u64,
    holds: u64,
    overrides: u64,
    stops: u64,
    resets: u64,
    resets_in_motion: u64,
    hosts: u64,
    silences: u64,
    jogs: u64,
    faults: u64,
}

struct Soak {
    mill: Simulator,
    random: Random,
    program: Program,
    /// Lines that have not been sent.
    waiting: VecDeque<String>,
    sent: u64,
    answered: u64,
    half: String,
    counts: Counts,
}

impl Soak {
    fn new(seed: u64) -> Soak {
        let mut soak = Soak {
            mill: Simulator::new(Options::default()),
            random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
            program: Program { place: [0; AXES], relative: false },
            waiting: VecDeque::new(),
            sent: 0,
            answered: 0,
            half: String::new(),
            counts: Counts::default(),
        };
        soak.hear();
        for line in SETTINGS.iter().copied().chain(WATCHES) {
            soak.waiting.push_back(line.into());
        }
        soak.settings();
        soak.counts = Counts::default();
        soak
    }

    /// Sends waiting lines as long as they fit into the machine's receive buffer, as a sender that counts characters
    /// does.
    fn send(&mut self) {
        while let Some(line) = self.waiting.front() {
            if self.mill.unread() + line.len() + 1 > self.mill.board().received_bytes {
                return;
            }
            self.mill.send(format!("{line}\n"));
            self.waiting.pop_front();
            self.sent += 1;
            self.counts.lines += 1;
        }
    }

    /// Returns the complete lines received since the last call, and counts the `ok` among them.
    fn hear(&mut self) -> Vec<String> {
        self.half.push_str(&self.mill.take_output());
        let mut heard = Vec::new();
        while let Some((line, rest)) = self.half.split_once("\r\n") {
            assert!(!line.starts_with("error:") && !line.starts_with("ALARM"), "{line} {}", self.told());
            self.answered += u64::from(line == "ok");
            self.counts.silences += u64::from(line == "[MSG:The host is silent]");
            heard.push(line.to_owned());
            self.half = rest.to_owned();
        }
        heard
    }

    fn told(&self) -> String {
        format!("after {} lines, {:?}", self.counts.lines, self.counts)
    }

    fn wait(&mut self, milliseconds: u64) {
        self.mill.run_for(Duration::from_millis(milliseconds));
        self.hear();
    }

    fn report(&mut self) -> String {
        self.hear();
        self.mill.send("?");
        let heard = self.hear();
        self.counts.reports += 1;
        let report = heard.iter().find(|line| line.starts_with('<')).cloned();
        report.unwrap_or_else(|| panic!("no report but {heard:?} {}", self.told()))
    }

    fn place(&self) -> [i64; AXES] {
        self.mill.machine().position().map(i64::from)
    }

    /// Sends the remaining lines, waits until all are answered and the machine is idle, and compares the motors'
    /// position with the program's.
    fn finish(&mut self) {
        let begun = self.mill.clock().now();
        let patience = PATIENCE.as_secs() * u64::from(self.mill.board().step_clock_hz);
        while !self.waiting.is_empty() || self.answered < self.sent || !self.mill.is_idle() {
            self.send();
            self.wait(20);
            self.go_on();
            let waited = self.mill.clock().now() - begun;
            assert!(waited < patience, "no end: {} {}", self.report(), self.told());
        }
        assert_eq!(self.answered, self.sent, "answers {}", self.told());
        assert_eq!(self.place(), self.program.place, "steps {}", self.told());
        self.agree();
        self.counts.rests += 1;
    }

    /// Checks that the reported position is that of the motors.
    fn agree(&mut self) {
        let report = self.report();
        let reported =
            numbers::<AXES>(&report, "MPos").expect("a position").map(|mm| (mm * STEPS_PER_MM).round() as i64);
        assert_eq!(reported, self.place(), "{report} {}", self.told());
    }

    /// Resumes the job if it waits. Called repeatedly, because a first `~` can arrive while the machine still brakes,
    /// and because the machine can also be held by a host timeout (`$928`).
    fn go_on(&mut self) {
        let rests = !self.mill.is_stepping() && !self.mill.is_idle();
        if self.mill.controller().is_paused() || rests && self.report().starts_with("<Door:0") {
            self.mill.send("~");
        }
    }

    /// Triggers a random event during a job: a report, hold, door, jog cancel or override.
    fn disturb(&mut self) {
        match self.random.below(12) {
            0 | 1 => {
                let report = self.report();
                assert!(report.ends_with('>'), "{report}");
            }
            2..=4 => {
                self.mill.send("!");
                self.counts.holds += 1;
                let time = self.random.below(150);
                self.wait(time);
                self.mill.send("~");
            }
            5 => {
                self.mill.send([0x84]);
                self.counts.holds += 1;
                self.wait(300);
                self.mill.send("~");
            }
            // Jog cancel; without a jog it has no effect.
            6 => self.mill.send([0x85]),
            _ => {
                let byte =
                    [0x90, 0x91, 0x92, 0x93, 0x94, 0x95, 0x96, 0x97, 0x99, 0x9A, 0x9B][self.random.below(11) as usize];
                self.mill.send([byte]);
                self.counts.overrides += 1;
            }
        }
    }

    /// Interrupts the job by a reset (0x18) or a stop (0x19). Afterwards the generated program continues from the
    /// position at which the machine has come to rest.
    fn interrupt(&mut self, byte: u8) {
        let moving = self.mill.is_stepping();
        self.mill.send([byte]);
        // At this byte the machine drops the lines that it has received and not started. It still answers the line in
        // progress, possibly late because a spindle spins up.
        self.mill.run_for(Duration::from_millis(500));
        self.half.push_str(&self.mill.take_output());
        while byte != 0x18 && !self.mill.is_idle() {
            self.go_on();
            self.mill.run_for(Duration::from_millis(20));
        }
        self.half.push_str(&self.mill.take_output());
        let heard = std::mem::take(&mut self.half);
        assert!(!heard.contains("error:"), "{heard} {}", self.told());
        if byte == 0x18 {
            self.counts.resets += 1;
            let alarm = heard.contains("ALARM:3");
            assert!(!alarm || moving, "{heard} {}", self.told());
            self.counts.resets_in_motion += u64::from(alarm);
            self.mill.send("$X\n");
            self.wait(50);
        } else {
            self.counts.stops += 1;
        }
        self.waiting.clear();
        (self.sent, self.answered) = (0, 0);
        let place = self.place();
        self.mill.run_for(Duration::from_millis(100));
        assert_eq!(place, self.place(), "it moves after {byte:#x} {}", self.told());
        self.program = Program { place, relative: false };
        self.waiting.push_back("G90".into());
        self.agree();
    }

    /// Activates an input of [`FAULTS`]: the machine stops with the reaction that the input's setting selects. Then
    /// resets. The position must be kept, and the job continues from there.
    fn fault(&mut self) {
        let (pin, _, alarm) = FAULTS[self.random.below(3) as usize];
        self.hear();
        assert_eq!(self.mill.pin_line(&format!("{pin} 1")), "ok");
        // Braking takes at most 0.2 s: from 100 mm/s at 500 mm/s².
        self.mill.run_for(Duration::from_millis(400));
        let heard = self.mill.take_output();
        assert!(heard.lines().any(|line| line == alarm), "{heard} {}", self.told());
        self.agree();
        assert_eq!(self.mill.pin_line(&format!("{pin} 0")), "ok");
        self.counts.faults += 1;
        self.interrupt(0x18);
    }

    /// Starts a jog at rest. Then the host is silent, so the host timeout ends the jog.
    fn jog(&mut self) {
        // The machine may be in a hold that came at the end of the job.
        for _ in 0..100 {
            if self.report().starts_with("<Idle") {
                break;
            }
            self.mill.send("~");
            self.wait(100);
        }
        let (silences, begun) = (self.counts.silences, self.place()[0]);
        // Jog towards the middle of the program's range.
        let by = self.random.below(11) as i64 * if begun > 0 { -1 } else { 1 };
        self.mill.send(format!("$J=G91 X{by} F1500\n"));
        self.wait(1_000);
        self.half.clear();
        (self.sent, self.answered) = (0, 0);
        // The jog covers 5 mm until the host timeout, and less than 1 mm more while it brakes.
        let moved = (self.place()[0] - begun) as f64 / STEPS_PER_MM;
        let ends = by.abs() < 6 || self.counts.silences == silences + 1 && moved.abs() < by.abs() as f64;
        assert!(ends, "{moved} mm of a jog by {by} mm {}", self.told());
        assert!(self.mill.is_idle(), "{} {}", self.report(), self.told());
        self.agree();
        self.program.place = self.place();
        self.counts.jogs += 1;
    }

    /// Selects random reactions to the inputs of [`FAULTS`] and to a missing host (`$928`). Call while the machine is
    /// at rest.
    fn settings(&mut self) {
        for (_, setting, _) in FAULTS {
            let reactions = if setting == "$925" { &CONTROLLED[..2] } else { &CONTROLLED };
            self.waiting.push_back(format!("{setting}={}", self.random.of(reactions)));
        }
        self.waiting.push_back(format!("$928={}", self.random.of(&CONTROLLED)));
        self.finish();
    }

    /// Sends a chunk (a random number of program lines) with random events between the lines, and waits for its end.
    fn chunk(&mut self) {
        if self.random.below(4) == 0 {
            self.settings();
        }
        if self.random.below(8) == 0 {
            self.jog();
        }
        for _ in 0..1 + self.random.below(60) {
            self.program.lines(&mut self.random, &mut self.waiting);
        }
        while !self.waiting.is_empty() {
            self.send();
            let time = 1 + self.random.below(60);
            self.wait(time);
            self.go_on();
            if self.random.below(12) == 0 {
                self.disturb();
            }
            if self.random.below(900) == 0 {
                let byte = if self.random.below(3) == 0 { 0x19 } else { 0x18 };
                self.interrupt(byte);
            }
            if self.random.below(500) == 0 {
                self.fault();
            }
        }
        // The host waits for all answers and closes the port while the machine still moves.
        if self.random.below(8) == 0 {
            while self.answered < self.sent {
                self.wait(10);
                self.go_on();
            }
            self.mill.disconnect();
            let time = self.random.below(100);
            self.wait(time);
            self.mill.connect();
            self.counts.hosts += 1;
        }
        self.finish();
    }
}

/// Returns the memory of this process, KiB: current and maximum. `None` if the system does not report it.
fn memory() -> Option<[u64; 2]> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let field = |name: &str| {
        let line = text.lines().find_map(|line| line.strip_prefix(name))?;
        line.split_whitespace().next()?.parse().ok()
    };
    Some([field("VmRSS:")?, field("VmHWM:")?])
}

#[test]
fn a_long_job_keeps_every_step() {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (lines, seed) = (number("OXMILL_SOAK", 3_000), number("OXMILL_SOAK_SEED", 1));
    let mut soak = Soak::new(seed);
    let (begun, mut early) = (Instant::now(), None);
    while soak.counts.lines < lines {
        soak.chunk();
        if early.is_none() && soak.counts.lines >= lines / 10 {
            early = memory();
        }
    }
    let late = memory();
    let seconds = soak.mill.clock().now() / u64::from(soak.mill.board().step_clock_hz);
    println!("{:?} in {:.1} s; the machine: {seconds} s", soak.counts, begun.elapsed().as_secs_f64());
    println!("memory, KiB now and at most: after a tenth {early:?}, at the end {late:?}");
    if let (Some([early, _]), Some([_, most])) = (early, late) {
        assert!(most <= early + GROWTH, "memory grows from {early} to {most} KiB");
    }
    let Counts { rests, reports, holds, overrides, hosts, resets, silences, jogs, faults, .. } = soak.counts;
    assert!(
        [rests, reports, holds, overrides, hosts, resets, silences, jogs, faults].iter().all(|count| *count > 0),
        "{:?}",
        soak.counts
    );
}
