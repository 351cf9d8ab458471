//! Random programs of all kinds of words. Each program is run line by line, and then twice as a stream with
//! disturbances: holds, overrides, open doors, single blocks. All runs must end with the same answers, position,
//! state and offsets, and take the same path. Machines with backlash have it in the simulated drives and in the
//! settings.
//!
//! `OXMILL_DISTURBED=N` plays N programs on each machine instead of the default few; `OXMILL_DISTURBED_SEED` sets the
//! first seed.

use super::bench::{AXES, Bench, STEPS};
use oxmill_test_support::Random;
use std::collections::{HashSet, VecDeque};

const MACHINE: &str = r#"
    steps_per_mm = [250, 250, 250]
    switch = [
        { axis = "x", at_mm = 2, side = "positive" },
        { axis = "y", at_mm = 2, side = "positive" },
        { axis = "z", at_mm = 2, side = "positive" },
    ]
    plate = { axis = "z", at_mm = -27, side = "negative" }
"#;
const SETTINGS: &str = "$0=1 $22=1 $24=600 $25=3000 $26=1 $110=6000 $111=5000 $112=4000 $120=900 $121=700 $122=500 $130=60 \
                        $131=60 $132=60 $20=1 $392=0.05 $393=0.02";
const BELTS: &str = "$904=1";
const TURNS: &str = "$930=4";
/// Backlash of each drive: the setting (`$160` to `$162`), and the same distance in the simulated machine, mm. The
/// distances are 5, 8 and 10 steps.
const BACKLASH: [(&str, f64); AXES] = [("$160=0.02", 0.02), ("$161=0.032", 0.032), ("$162=0.04", 0.04)];
/// Settings of each machine, and `true` if it parks its tool. Parking moves leave the path, so the path of such a
/// machine is not compared.
const MACHINES: [(&str, bool); 11] = [
    ("", false),
    ("$220=9000 $221=8000 $222=7000", false),
    ("$32=1", false),
    ("$10=3 $919=1", false),
    ("$41=1 $56=0.3 $57=600 $58=-3 $59=2000", true),
    ("$41=1 $57=900 $58=-8 $59=3000 $222=3000", true),
    ("$904=1", false),
    ("$160=0.02 $161=0.032 $162=0.04", false),
    ("$904=1 $160=0.02 $161=0.032 $220=5000 $919=1", false),
    ("$930=4 $103=100 $113=9000 $123=900 $133=0", false),
    ("$930=4 $103=100 $113=9000 $123=900 $133=0 $162=0.04 $223=4000 $41=1 $56=0.3 $57=600 $58=-3 $59=2000", true),
];
const BEGIN: [&str; 4] = ["G10 L2 P1 X-30 Y-30 Z-20", "G10 L2 P2 X-28 Y-31 Z-21", "G0 X0 Y0 Z0", "F1000"];
/// Minimum number of lines of a program.
const LINES: usize = 40;
/// Maximum duration of a line, s.
const LONGEST: f64 = 30.0;
/// Edge of the cells by which paths are compared, steps. Each position of a disturbed run must lie in a cell that the
/// undisturbed run passes, or in a neighbouring cell. The edge is long enough for the braking distance of a probe,
/// which depends on its speed.
const CELL: i32 = 10;
/// Edge of the cells for paths with rounded corners (G64 P), which differ by up to 0.1 mm.
const ROUNDED_CELL: i32 = 30;

const TOOLS_AND_PLACES: &str =
    "G49|G43.2 H1|G43.2 H2|M61 Q2|M6 T3|T1 M6|G92.2|G92.3|G28.1|G30.1|G30|G53 G0 Z-2|G53 G0 X-20 Y-20";
const PINS_AND_OVERRIDES: &str = "M62 P0|M63 P0|M64 P0|M65 P0|M66 P0 L3 Q0.05|M66 P0 L0|M56 P0|M56|M50 P0|M50 P1|M51 P0|M51 P1|M53 P0|\
                                  #1=5\nG91 G1 X[#1/10]\nG90|(MSG, x)|G64|G64 P0.05 Q0.01";

fn mm(random: &mut Random, reach: u64) -> f64 {
    let scale = [0.05, 0.5, 1.0][random.below(3) as usize];
    (random.below(reach * 2000) as f64 / 1000.0 - reach as f64) * scale
}

/// Returns random lines with tools, saved states, subroutines, inverse time, moves shorter than a step, pins, overrides
/// and NURBS. `a`: an A word or nothing.
fn more_lines(r: &mut Random, a: &str, feed: u64) -> Vec<String> {
    let text = match r.below(8) {
        0 => format!("G10 L1 P{} Z{:.3}|T{} G43", 1 + r.below(3), mm(r, 2), 1 + r.below(3)),
        1 => r.of(&TOOLS_AND_PLACES.split('|').collect::<Vec<_>>()).to_string(),
        2 => format!("M70|G91 G1 X{:.3}{a} F{feed}|{}", mm(r, 3), r.of(&["M72", "M72", "M71"])),
        3 => format!("O7 SUB\nM73\nG91 G1 X{:.3}{a} F{feed}\nG20 G1 Y0.01\nO7 ENDSUB|O7 CALL|O7 CALL", mm(r, 2)),
        4 => {
            let inverse = format!("G93|G1 X{:.3} Y{:.3}{a} F{}", mm(r, 9), mm(r, 9), 10 + r.below(300));
            format!("{inverse}|G91 G1 X{:.4}{a} F4000|G90 G94|F{feed}", mm(r, 1))
        }
        5 => {
            let short = |i| {
                format!(
                    "G91 G1 X{:.4} Y{:.4}{} F{feed}|",
                    0.02 * mm(r, 1),
                    0.02 * mm(r, 1),
                    ["", a][usize::from(i % 2 == 1)]
                )
            };
            (0..8).map(short).collect::<String>() + "G90"
        }
        6 => r.of(&PINS_AND_OVERRIDES.split('|').collect::<Vec<_>>()).to_string(),
        _ => {
            let [x, y, u, v] = std::array::from_fn(|_| mm(r, 5));
            format!("G5.2 X{x:.2} Y{y:.2} P1 L3|X{u:.2} Y{v:.2} P2|X{y:.2} Y{u:.2} P1|G5.3|G1 X1 F{feed}")
        }
    };
    text.split('|').map(str::to_string).collect()
}

/// Returns lines that belong together. If one of them fails on this machine, [`program`] leaves all of them out.
fn lines(random: &mut Random, turns: bool) -> Vec<String> {
    let r = random;
    let a = if turns && r.below(2) == 0 { format!(" A{:.2}", mm(r, 40)) } else { String::new() };
    let feed = 200 + r.below(4500);
    let one = |line: &str| vec![line.to_string()];
    let relative = |line: String| vec!["G91".to_string(), line, "G90".to_string()];
    match r.below(28) {
        20.. => more_lines(r, &a, feed),
        0..=3 => vec![format!("G1 X{:.3} Y{:.3} Z{:.3}{a} F{feed}", mm(r, 12), mm(r, 12), mm(r, 12))],
        4 => vec![format!("G0 X{:.3} Y{:.3} Z{:.3}{a}", mm(r, 12), mm(r, 12), mm(r, 12))],
        5 => relative(format!("G{} X{:.3} Y{:.3} R8{a} F{feed}", 2 + r.below(2), mm(r, 5), mm(r, 5))),
        6 => {
            let (i, j, turns) = (mm(r, 5), mm(r, 5), 1 + r.below(3));
            vec![match turns {
                3 => format!("G{} I{:.3} F{feed}", if j < 0.0 { 12 } else { 13 }, 0.01 + i.abs()),
                _ => format!("G2 I{i:.3} J{j:.3} P{turns} F{feed}"),
            }]
        }
        7 => (0..12).map(|i| format!("G1 X{:.3} Y{:.3} F{feed}", 0.4 * f64::from(i), f64::from(i).sin())).collect(),
        8 => relative(format!(
            "G5 X{:.2} Y{:.2} I{:.2} J{:.2} P1 Q{:.2} F{feed}",
            mm(r, 8),
            mm(r, 8),
            mm(r, 5),
            mm(r, 5),
            mm(r, 5)
        )),
        9 | 10 => {
            let cycle =
                r.of(&["G81", "G82 P0.02", "G83 Q0.7", "G73 Q0.7", "G85", "G89 P0.02", "G86 P0.02", "G88 P0.02"]);
            let hole = format!(
                "{} {cycle} X{:.2} Y{:.2} R{:.2} Z-7 F{feed}",
                r.of(&["G98", "G99"]),
                mm(r, 8),
                mm(r, 8),
                mm(r, 5)
            );
            vec!["M3 S500".into(), hole, format!("X{:.2}", mm(r, 4)), "G80".into()]
        }
        11 | 12 => {
            let word = r.of(&["G38.3", "G38.5"]);
            let probe = format!("{word} X{:.2} Z{:.3} F{}", mm(r, 4), mm(r, 10), 60 + r.below(240));
            vec![probe, format!("G1 X{:.3} Y{:.3} Z{:.3} F{feed}", mm(r, 8), mm(r, 8), mm(r, 5).abs())]
        }
        13 => one(r.of(&["G64 P0.1", "G64 P0.02", "G61", "G61.1"])),
        14 => vec![if r.below(2) == 0 {
            "G69".into()
        } else {
            format!("G68 X{:.1} Y{:.1} R{:.1}", mm(r, 5), mm(r, 5), mm(r, 60))
        }],
        15 => vec![if r.below(2) == 0 {
            "G50".into()
        } else {
            format!("G51 X{:.1} P{:.1}", mm(r, 5), 0.5 + 0.1 * r.below(10) as f64)
        }],
        16 => vec![format!("G43.1 Z{:.3}", mm(r, 3))],
        17 => vec![format!("{}{:.3}", r.of(&["G92 X", "G52 Y", "G10 L20 P0 Z"]), mm(r, 3))],
        18 => one(r.of(&["M3 S400", "M4 S800", "M5", "M8", "M9", "S900", "M0", "M1", "G55", "G54", "G92.1", "G28 Z5"])),
        _ => {
            one(r.of(&["G4 P0.02", "M49", "M48", "G20", "G21", "G21", "O1 REPEAT [2]\nG91 G1 X0.2\nG90\nO1 ENDREPEAT"]))
        }
    }
}

/// Returns the backlash of each drive of a machine with these settings, mm.
fn backlash_of(settings: &str) -> [f64; AXES] {
    BACKLASH.map(|(setting, mm)| if settings.contains(setting) { mm } else { 0.0 })
}

/// Returns the tool position according to the parts that the motors drive, in steps.
fn tool(bench: &Bench, settings: &str) -> [f64; AXES] {
    let [x, y, z, ..] = bench.mill.fittings().driven_mm().map(|mm| mm * STEPS);
    if settings.contains(BELTS) { [0.5 * (x + y), 0.5 * (x - y), z] } else { [x, y, z] }
}

#[derive(Clone)]
struct Mill {
    bench: Bench,
    settings: &'static str,
    /// Offset from the step count to machine coordinates, steps.
    zero: [f64; AXES],
    answers: Vec<String>,
    sent: usize,
    alarm: bool,
    /// State and number of step events at the last check, and `true` if nothing has been sent since that check.
    before: (String, u64, bool),
    /// Everything sent, for diagnosis.
    log: String,
}

impl Mill {
    fn new(settings: &'static str) -> Mill {
        let kinematics = if settings.contains(BELTS) { "kinematics = \"corexy\"" } else { "" };
        let mm = backlash_of(settings);
        let backlash = if mm == [0.0; AXES] { String::new() } else { format!("backlash_mm = {mm:?}") };
        let machine = format!("{kinematics}\n{backlash}\n{MACHINE}");
        let mut bench = Bench::new(&machine, &format!("{SETTINGS} {settings}"));
        bench.carry_out("$H");
        let (reported, place) = (bench.reported(), tool(&bench, settings));
        let zero = std::array::from_fn(|axis| reported[axis] - place[axis]);
        bench.mill.begin_job();
        let before = (String::new(), 0, false);
        Mill { bench, zero, answers: Vec::new(), sent: 0, alarm: false, before, settings, log: settings.into() }
    }

    fn hear(&mut self) {
        for line in self.bench.read() {
            self.alarm |= line.starts_with("ALARM");
            if line == "ok" || line.starts_with("error:") {
                self.answers.push(line);
            }
        }
    }

    /// Sends a line if it fits into the machine's receive buffer; returns whether it did.
    fn line(&mut self, line: &str) -> bool {
        let fits = self.bench.mill.unread() + line.len() < self.bench.mill.board().received_bytes;
        if fits {
            self.log += &format!("\n{line}");
            self.bench.send(format!("{line}\n"));
            self.sent += line.lines().count();
            self.before.2 = false;
        }
        fits
    }

    fn byte(&mut self, byte: u8) {
        self.log += &format!(" {:.4}:{byte:#x}", self.bench.seconds());
        self.bench.send([byte]);
        self.before.2 = false;
    }

    fn pin(&mut self, pin: &str) {
        self.log += &format!(" {:.4}:{pin}", self.bench.seconds());
        self.bench.pin(pin);
        self.before.2 = false;
    }

    fn is_held(&mut self) -> bool {
        matches!(self.bench.state().as_str(), "Hold:0" | "Door:0")
    }

    /// Compares the reported position with the position of the tool. With belts the tool can be at a half step.
    fn assert_place(&mut self) {
        let (reported, place) = (self.bench.reported(), tool(&self.bench, self.settings));
        let half = if self.settings.contains(BELTS) { 0.51 } else { 0.01 };
        for axis in 0..AXES {
            let off = reported[axis] - self.zero[axis] - place[axis];
            assert!(off.abs() < half, "reported {reported:?}, is {place:?}: {}", self.log);
        }
    }

    /// Lets time pass and reads the answers. Checks that a machine at rest in a hold or at a door has made no step,
    /// that laser and spindle are off where they must be, and that the reported position agrees with the steps.
    fn pass(&mut self, milliseconds: u64) {
        self.bench.wait(milliseconds as f64 / 1000.0);
        self.hear();
        let (state, mill) = (self.bench.state(), &self.bench.mill);
        let events = mill.trace().events();
        let rests = matches!(state.as_str(), "Hold:0" | "Door:0" | "Door:1");
        let moved = rests && self.before == (state.clone(), self.before.1, true) && self.before.1 != events;
        assert!(!moved, "steps in {state}: {}", self.log);
        let dark = mill.power() == 0 || !(self.log.starts_with("$32=1") || state.starts_with("Door"));
        assert!(!rests || dark, "power in {state}: {}", self.log);
        if !mill.is_stepping() {
            self.assert_place();
        }
        self.before = (state, events, true);
    }

    /// Runs until all lines are done, resuming whatever waits for the operator. Returns `false` after an alarm or a
    /// timeout.
    fn finish(&mut self) -> bool {
        let end = self.bench.seconds() + LONGEST;
        while !self.alarm && (self.answers.len() < self.sent || !self.bench.mill.is_idle()) {
            if self.bench.seconds() > end {
                return false;
            }
            self.pass(20);
            if self.is_held() {
                self.byte(b'~');
            }
        }
        !self.alarm
    }

    fn disturb(&mut self, random: &mut Random) {
        match random.below(10) {
            0..=2 => {
                self.byte(b'!');
                for _ in 0..random.below(8) {
                    self.pass(random.below(30));
                    if random.below(3) == 0 {
                        self.byte(0x9E);
                    }
                }
            }
            3 => self.byte(0x84),
            4 => {
                self.pin("door 1");
                for _ in 0..random.below(15) {
                    self.pass(random.below(40));
                }
                self.pin("door 0");
            }
            5 | 6 => (0..random.below(8)).for_each(|_| self.byte(0x90 + random.below(14) as u8)),
            7 => self.byte(0x89),
            8 => {
                self.pin("hold 1");
                self.pass(random.below(100));
                self.pin("hold 0");
                self.pin("start 1");
                self.pin("start 0");
            }
            _ => self.byte(0x85),
        }
        (0..random.below(12)).for_each(|_| self.pass(random.below(30)));
        self.byte(b'~');
    }

    /// Returns the answers to `$G` (modal state) and `$#` (offsets) after the program.
    fn left(&mut self) -> Vec<String> {
        [self.bench.ask("$G"), self.bench.ask("$#")].concat()
    }

    fn cells(&self, edge: i32) -> HashSet<[i32; AXES]> {
        self.bench
            .mill
            .trace()
            .kept()
            .iter()
            .map(|record| record.position.map(|place| place.div_euclid(edge)))
            .collect()
    }
}

/// Returns a program that the machine can carry out, and the machine after running it line by line.
fn program(homed: &Mill, random: &mut Random) -> (Vec<String>, Mill) {
    let mut mill = homed.clone();
    let mut program = Vec::new();
    let mut next: Vec<String> = BEGIN.map(str::to_string).into();
    while program.len() < LINES {
        let mut copy = mill.clone();
        if next.iter().all(|line| copy.line(line) && copy.finish()) {
            program.append(&mut next);
            mill = copy;
        }
        next = lines(random, homed.settings.contains(TURNS));
    }
    (program, mill)
}

/// Asserts that two machines have ended at the same position. A path with rounded corners can leave out a reversal
/// that is shorter than a step. Then a motor stands at the other end of its backlash, although the tool is at the same
/// position.
fn assert_same_place(mill: &Mill, alone: &Mill, seed: u64) {
    let (place, expected) = (tool(&mill.bench, mill.settings), tool(&alone.bench, alone.settings));
    let (motors, motors_alone) = (mill.bench.place(), alone.bench.place());
    for axis in 0..AXES {
        let apart = f64::from((motors[axis] - motors_alone[axis]).abs());
        let same =
            (place[axis] - expected[axis]).abs() < 0.01 && apart < backlash_of(mill.settings)[axis] * STEPS + 0.01;
        assert!(same, "{seed}: tool {place:?}, alone {expected:?}; motors {motors:?}, {motors_alone:?}: {}", mill.log);
    }
}

fn session(seed: u64, homed: &Mill, parks: bool) {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let (program, mut alone) = program(homed, &mut random);
    let edge = if program.iter().any(|line| line.starts_with("G64 P")) { ROUNDED_CELL } else { CELL };
    let path = alone.cells(edge);
    for _ in 0..2 {
        let mut mill = homed.clone();
        let mut waiting: VecDeque<&String> = program.iter().collect();
        while let Some(line) = waiting.front() {
            if mill.line(line) {
                waiting.pop_front();
            } else {
                mill.pass(1 + random.below(30));
            }
            if random.below(10) == 0 {
                mill.disturb(&mut random);
            }
            if mill.is_held() {
                mill.byte(b'~');
            }
        }
        while !mill.finish() {
            assert!(!mill.alarm, "{seed}: {}", mill.log);
        }
        assert_eq!(mill.answers, alone.answers, "{seed}: {}", mill.log);
        assert_same_place(&mill, &alone, seed);
        assert_eq!(mill.left(), alone.clone().left(), "{seed}: {}", mill.log);
        let beside = |cell: &[i32; AXES]| {
            (0..27).any(|i| path.contains(&[cell[0] + i / 9 - 1, cell[1] + i / 3 % 3 - 1, cell[2] + i % 3 - 1]))
        };
        let off = mill.cells(edge).into_iter().find(|cell| !parks && !beside(cell));
        let off = off.map(|cell| cell.map(|place| f64::from(place * edge) / STEPS));
        assert_eq!(off, None, "{seed}: off the path, {}", mill.log);
    }
    alone.pass(1);
}

#[test]
fn a_disturbed_program_ends_as_it_does_alone() {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (programs, first) = (number("OXMILL_DISTURBED", 6), number("OXMILL_DISTURBED_SEED", 1));
    for (settings, parks) in MACHINES {
        let homed = Mill::new(settings);
        (first..first + programs).for_each(|seed| session(seed, &homed, parks));
    }
}
