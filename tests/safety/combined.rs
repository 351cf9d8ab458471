//! Machines of every kind (belts, backlash, two motors on an axis, a rotary axis, jerk limits, laser, parking) home,
//! jog, probe and run programs, and are interrupted while they do. Requirements:
//! * The reported position is the tool's position, and no move leaves the travel.
//! * A machine at rest makes no steps, and every state has a way out.
//! * At the end the machine can home and move.
//!
//! `OXMILL_COMBINED=N` plays N sessions on each machine instead of the default few; `OXMILL_COMBINED_SEED` sets the
//! first seed.

use super::bench::Bench;
use oxmill_test_support::Random;
use std::fmt::Write;

const SETTINGS: &str = "$0=1 $22=1 $24=60 $25=3000 $26=1 $27=1 $110=6000 $111=5000 $112=4000 $120=900 $121=700 $122=500 \
                        $130=60 $131=60 $132=60 $20=1 $40=1 $392=0.05 $393=0.02";
const SWITCHES: &str = r#"
    steps_per_mm = [250, 250, 250, 250]
    plate = { axis = "z", at_mm = -20, side = "negative" }
    [[switch]]
    axis = "x"
    at_mm = 2
    side = "positive"
    [[switch]]
    axis = "y"
    at_mm = 3
    side = "positive"
    [[switch]]
    axis = "z"
    at_mm = 4
    side = "positive"
"#;
/// Positions of the switches, mm.
const AT: [f64; 3] = [2.0, 3.0, 4.0];
const TRAVEL: f64 = 60.0;
const BELTS: &str = "kinematics = \"corexy\"\n";
const BACKLASH: &str = "backlash_mm = [0.1, 0.06, 0.08, 0]\n";
const TAKEN_UP: &str = "$160=0.1 $161=0.06 $162=0.08";
const TURNS: &str = "$930=4 $103=250 $113=9000 $123=900 $133=0";
const PARKS: &str = "$41=1 $56=0.3 $57=900 $58=-3 $59=2000";
/// Hardware of an X axis with two motors, TOML. [`RACKED`]: the second motor starts 0.3 mm ahead of the first one.
/// [`SECOND`]: the second motor has its own switch.
const RACKED: &str = "racked_mm = 0.3\n";
const SECOND: &str = "[[switch]]\naxis = \"x\"\nat_mm = 2\nside = \"positive\"\nsecond_motor = true\n";
/// Machines. Each entry has two TOML texts that come before [`SWITCHES`] in the description of the hardware, then a
/// TOML text that comes after it, then three texts of settings.
const MACHINES: [([&str; 2], &str, [&str; 3]); 10] = [
    (["", ""], "", ["", "", ""]),
    ([BACKLASH, ""], "", [TAKEN_UP, "$43=2", ""]),
    ([BELTS, ""], "", ["$904=1", PARKS, "$42=0"]),
    (["", ""], "", [TURNS, PARKS, "$901=1 $919=1 $912=1"]),
    ([RACKED, ""], SECOND, ["$905=1 $907=1", "", ""]),
    ([RACKED, BACKLASH], SECOND, ["$905=1 $907=1", TAKEN_UP, ""]),
    ([BELTS, BACKLASH], "", ["$904=1", TAKEN_UP, "$220=9000 $221=8000 $222=7000 $45=1 $46=2"]),
    ([BACKLASH, ""], "", [TURNS, TAKEN_UP, "$223=9000 $220=5000"]),
    ([BELTS, ""], "", ["$904=1", "$32=1", "$44=3 $45=4"]),
    ([BACKLASH, ""], "", [TAKEN_UP, PARKS, "$923=0.05 $924=2"]),
];
/// Number of actions per session.
const ACTIONS: u64 = 60;
/// Maximum time until the machine is idle again, s.
const LONGEST: f64 = 200.0;

struct Mill {
    bench: Bench,
    turns: bool,
    belts: bool,
    has_backlash: bool,
    /// State and number of step events at the last check, and `true` if nothing has been sent since that check.
    before: (String, u64, bool),
    /// Everything sent and received, for diagnosis.
    log: String,
}

fn mm(random: &mut Random, reach: u64) -> f64 {
    let scale = [0.05, 0.5, 1.0][random.below(3) as usize];
    (random.below(reach * 2000) as f64 / 1000.0 - reach as f64) * scale
}

fn motion(r: &mut Random, turns: bool) -> String {
    let feed = 200 + r.below(4500);
    let a = if turns && r.below(2) == 0 { format!("A{:.2}", mm(r, 40)) } else { String::new() };
    let (x, y, z) = (mm(r, 12), mm(r, 12), mm(r, 12));
    match r.below(11) {
        0 | 1 => format!("G90 G1 X{x:.3} Y{y:.3} Z{z:.3} {a} F{feed}"),
        2 => format!("G91 G1 X{:.4} Y{:.4} {a} F{feed}", 0.1 * x, 0.1 * y),
        3 => format!("G90 G0 X{:.3} Y{y:.3} {a}", 3.0 * x),
        4 => format!("G91 G2 X{:.3} Y{:.3} R8 {a} F{feed}", 0.4 * x, 0.4 * y),
        5 => format!("G2 I{:.3} J{:.3} P{} F{feed}", 0.4 * x, 0.4 * y, 1 + r.below(3)),
        6 => format!("G91 G5 X{x:.2} Y{y:.2} I{z:.2} J{:.2} P1 Q{:.2} F{feed}", mm(r, 5), mm(r, 5)),
        7 => format!("G93 G91 G1 X{:.4} {a} F{}", 0.1 * x, 100 + r.below(4000)),
        8 => {
            let cycle = r.of(&["G81", "G82 P0.01", "G83 Q1", "G73 Q1", "G85", "G89 P0.01"]);
            format!("G99 {cycle} X{x:.2} Y{y:.2} R{:.2} Z-7 F{feed}", 0.4 * z)
        }
        _ => format!("G90 G38.{} X{:.2} Z{z:.3} F{}", 2 + r.below(4), 0.3 * x, 60 + r.below(500)),
    }
}

fn jog(r: &mut Random, turns: bool) -> String {
    let (mode, reach) = [("G91", 3), ("G90", 12), ("G53", 70), ("G91", 70), ("G91 G20", 2)][r.below(5) as usize];
    let axis = r.of(&["X", "Y", "Z", if turns { "A" } else { "X" }]);
    let more = if r.below(2) == 0 && axis != "Y" { format!("Y{:.3}", mm(r, reach)) } else { String::new() };
    format!("$J={mode} {axis}{:.3} {more} F{}", mm(r, reach), 200 + r.below(4500))
}

const WORDS: &str = "G64 P0.1|G61|G61.1|G68 R30|G69|G51 P1.5|G50|G93|G94|M48|M49|G43.1 Z1|G49|G92 X1|G92.1|G92.2|G92.3|\
                     G52 Y1|G10 L20 P0 Z0|G28.1|G28|G30 X1|G28 Z0|G54|G55|G80|M3 S400|M4 S800|M5|M8|M9|M0|M1|M2|M30|M56 P0|M56|\
                     M6 T1|M62 P0|M63 P0|M66 P0 L3 Q0.2|M66 P0 L0|M70|M72|M73|G53 G0 Z-1|G53 G0 X-1 Y-1|G90|G91|G20|G21|G17|\
                     G18|T2|G999|M52 P0|M50 P0|G4 P0.05|G4 P1|O1 REPEAT [3]\nG91 G1 X0.2\nO1 ENDREPEAT|\
                     O2 SUB\nG91 G1 X-0.3 F900\nO2 ENDSUB|O2 CALL";
const COMMANDS: &str = "$H|$HX|$HY|$HZ|$HA|$X|$C|$SLP|$#|$G|$$|$I|$RST=#|$23=0|$21=1|$21=0|$40=0|$40=1|$120=500|$110=4000|\
                        $220=0|$220=3000|$41=0|$41=1|$56=1|$11=0.1|$N0=G91 G1 X-0.1 F500|$N0=|$N1=M8|$N1=";

fn line(r: &mut Random, turns: bool) -> String {
    match r.below(12) {
        0..=4 => motion(r, turns),
        5 | 6 => jog(r, turns),
        7..=9 => r.of(&WORDS.split('|').collect::<Vec<_>>()).to_string(),
        _ => r.of(&COMMANDS.split('|').collect::<Vec<_>>()).to_string(),
    }
}

impl Mill {
    fn new(([before, more], behind, settings): ([&str; 2], &str, [&str; 3])) -> Mill {
        let settings = settings.join(" ");
        let mut bench = Bench::new(&format!("{before}{more}{SWITCHES}{behind}"), &format!("{SETTINGS} {settings}"));
        bench.carry_out("$H");
        let (turns, belts) = (settings.contains("$930=4"), settings.contains("$904=1"));
        let has_backlash = settings.contains("$160");
        let mut mill = Mill { bench, turns, belts, has_backlash, before: (String::new(), 0, false), log: settings };
        mill.assert_place();
        mill.bench.carry_out("G10 L2 P1 X-30 Y-30 Z-15");
        mill
    }

    /// Returns the reported position, mm, and the report.
    fn reported(&mut self) -> ([f64; 3], String) {
        let status = self.bench.status();
        let at = status.find("MPos:").expect("a place") + 5;
        let mut places = status[at..].split(['|', '>', ',']).map(|place| place.parse().expect("a number"));
        (std::array::from_fn(|_| places.next().expect("three places")), status)
    }

    /// Returns the actual position of the tool, computed from the parts that the motors drive, relative to the
    /// switches, mm.
    fn tool(&self) -> [f64; 3] {
        let [mut x, mut y, z, ..] = self.bench.mill.fittings().driven_mm();
        if self.belts {
            (x, y) = (0.5 * (x + y), 0.5 * (x - y));
        }
        [x - AT[0], y - AT[1], z - AT[2]]
    }

    /// Compares the reported position with the actual position of a machine at rest. The two can differ for two
    /// reasons. Backlash may not have been taken up when a motion was stopped. With belts, a step of one motor moves
    /// the tool by half a step along two axes.
    fn assert_place(&mut self) {
        let ((reported, status), tool) = (self.reported(), self.tool());
        let off = if self.has_backlash { 0.1701 } else { [0.0021, 0.0101][usize::from(self.belts)] };
        for axis in 0..3 {
            assert!((reported[axis] - tool[axis]).abs() < off, "{status}, tool {tool:?} {}", self.log);
        }
    }

    /// Checks that the tool is within its travel. With belts, a motor that takes up its backlash moves the tool along
    /// both X and Y. So a move along one of these axes can push the tool out of the travel of the other axis, by up to
    /// half of the backlash.
    fn assert_in_travel(&mut self) {
        let drag = if self.belts && self.has_backlash { 0.08 } else { 0.0 } + 0.003;
        let (reported, status) = self.reported();
        let inside = reported.iter().all(|place| (-TRAVEL - drag..=drag).contains(place));
        assert!(inside, "{status} {}", self.log);
    }

    fn send(&mut self, line: &str) {
        if self.bench.mill.unread() + line.len() + 2 < self.bench.mill.board().received_bytes {
            write!(self.log, "\n{:.4} {line}", self.bench.seconds()).unwrap();
            self.bench.send(format!("{line}\n"));
            self.before.2 = false;
        }
    }

    fn byte(&mut self, byte: u8) {
        write!(self.log, " {:.4}:{byte:#x}", self.bench.seconds()).unwrap();
        self.bench.send([byte]);
        self.before.2 = false;
    }

    fn pin(&mut self, pin: &str) {
        write!(self.log, " {:.4}:{pin}", self.bench.seconds()).unwrap();
        self.bench.pin(pin);
        self.before.2 = false;
    }

    /// Lets time pass and returns the state. Checks that a machine at rest has made no step, that the tool is within
    /// its travel, and that the reported position is the actual one.
    fn pass(&mut self, milliseconds: u64) -> String {
        self.bench.wait(milliseconds as f64 / 1000.0);
        for said in self.bench.read() {
            write!(self.log, " <{said}>").unwrap();
        }
        let (state, events) = (self.bench.state(), self.bench.mill.trace().events());
        let rests = ["Hold:0", "Door:0", "Door:1", "Alarm", "Sleep", "Check"].contains(&state.as_str());
        let moved = rests && self.before == (state.clone(), self.before.1, true) && self.before.1 != events;
        assert!(!moved, "steps in {state} {}", self.log);
        if state != "Home" {
            if self.bench.mill.controller().is_trusted() {
                self.assert_in_travel();
            }
            if !self.bench.mill.is_stepping() {
                self.assert_place();
            }
        }
        self.before = (state.clone(), events, true);
        state
    }

    fn disturb(&mut self, r: &mut Random) {
        match r.below(14) {
            0..=2 => self.byte(b'!'),
            3 => self.byte(0x84),
            4 => {
                self.pin("door 1");
                (0..r.below(15)).for_each(|_| drop(self.pass(r.below(40))));
                self.pin("door 0");
            }
            5 => (0..r.below(8)).for_each(|_| self.byte(0x90 + r.below(16) as u8)),
            6 => self.byte(0x89),
            7 => self.byte(0x19),
            8 => self.byte(0x18),
            9..=11 => self.byte(0x85),
            12 => {
                self.byte(b'!');
                self.pass(r.below(30));
                self.byte(0x9E);
            }
            _ => {}
        }
        (0..r.below(8)).for_each(|_| drop(self.pass(r.below(30))));
        if r.below(3) > 0 {
            self.byte(b'~');
        }
    }

    fn unlock(&mut self) {
        self.byte(0x18);
        self.pass(50);
        self.send("$X");
    }

    /// Brings the machine to Idle: by waiting, by `~`, or by a reset with `$X`.
    fn come_out(&mut self) {
        let end = self.bench.seconds() + LONGEST;
        loop {
            match self.pass(20).as_str() {
                "Idle" if self.bench.mill.is_idle() => return,
                "Hold:0" | "Door:0" => self.byte(b'~'),
                "Alarm" | "Sleep" => self.unlock(),
                "Check" => self.send("$C"),
                _ => {}
            }
            assert!(self.bench.seconds() < end, "never idle: {} {}", self.bench.status(), self.log);
        }
    }

    fn carry_out(&mut self, line: &str) {
        let said = self.bench.ask(line);
        assert!(said.last().is_some_and(|last| last == "ok"), "{line}: {said:?} {}", self.log);
        self.bench.settle();
    }

    /// Restores the machine's own settings, which the session can have changed. Then homes, and checks that the machine
    /// reaches a position to the step.
    fn assert_sound(&mut self, settings: [&str; 3]) {
        for line in settings.join(" ").split_whitespace().chain("$N0= $N1= $21=0 $923=0 $902=0 $20=0".split(' ')) {
            self.carry_out(line);
        }
        let a = if self.turns { " A-10" } else { "" };
        self.carry_out(&format!("$J=G53 G90 G21 X-10 Y-10 Z-10{a} F9000"));
        for line in ["$20=1", "$902=1", "$H"] {
            self.carry_out(line);
        }
        assert_eq!(self.bench.state(), "Idle", "{}", self.log);
        self.assert_place();
        for line in ["G92.1", "G54 G90 G94 G21 G69 G50 G49", "G53 G0 X-10 Y-11 Z-12", "G53 G0 X-10.5 Y-10.5 Z-11"] {
            self.carry_out(line);
        }
        let off = [0.003, 0.0061][usize::from(self.belts)];
        let tool = self.tool();
        for (place, meant) in tool.into_iter().zip([-10.5, -10.5, -11.0]) {
            assert!((place - meant).abs() < off, "{tool:?} {}", self.log);
        }
    }
}

fn session(machine: ([&str; 2], &str, [&str; 3]), seed: u64) {
    let mut random = Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1);
    let mut mill = Mill::new(machine);
    write!(mill.log, " seed {seed}").unwrap();
    for _ in 0..ACTIONS {
        match random.below(10) {
            0..=5 => {
                let text = line(&mut random, mill.turns);
                mill.send(&text);
            }
            6 | 7 => drop(mill.pass([1, 10, 50, 300][random.below(4) as usize])),
            8 => mill.disturb(&mut random),
            _ => match mill.pass(1).as_str() {
                "Alarm" if random.below(3) == 0 => mill.unlock(),
                "Check" => mill.send("$C"),
                _ => {}
            },
        }
    }
    mill.byte(b'~');
    mill.come_out();
    mill.unlock();
    mill.come_out();
    mill.assert_sound(machine.2);
}

#[test]
fn machines_of_every_build_are_disturbed() {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (sessions, first) = (number("OXMILL_COMBINED", 8), number("OXMILL_COMBINED_SEED", 1));
    for machine in MACHINES {
        (first..first + sessions).for_each(|seed| session(machine, seed));
    }
}
