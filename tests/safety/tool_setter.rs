//! Tool changes with a tool setter (`$918=2`), and interruptions at any time. Two rules hold away from the work: the
//! tool may go down only in a probing move, and the spindle must be off. No unmeasured tool may count as measured.

use super::bench::{AXES, Bench, STEPS, assert_place};

const SETTINGS: &str = "$22=1 $24=300 $25=1500 $26=10 $20=1 $110=3000 $111=3000 $112=3000 $120=500 $121=500 $122=500 \
                        $130=60 $131=60 $132=60 $342=30 $343=60 $344=600 $394=0.2 $918=2";
/// Position for tool changes, mm.
const CHANGE: [f64; AXES] = [-5.0, -6.0, -5.0];
/// X and Y of the setter, mm.
const SETTER: [f64; 2] = [-10.0, -20.0];
/// Position of the work, mm.
const WORK: [f64; AXES] = [-30.0, -31.0, -20.0];
/// Z at which the setter closes for the first tool, mm.
const TOUCHED: f64 = -25.0;
/// Length of the second tool minus that of the first, mm.
const LONGER: f64 = 5.0;
/// Interval at which [`Mill::look`] checks the machine, s.
const LOOK: f64 = 0.002;
/// Position tolerance, mm: ten times the distance that the tool covers between two checks while it probes slowly
/// (`$343`).
const EXACT: f64 = 0.02;

#[derive(Clone)]
struct Mill {
    bench: Bench,
    /// Offset from the step count to machine coordinates, mm.
    zero: [f64; AXES],
    /// Z at which the setter closes for the current tool, mm.
    closes: f64,
    closed: bool,
    said: Vec<String>,
}

fn machine() -> String {
    let mut text = format!("steps_per_mm = [{STEPS}, {STEPS}, {STEPS}]\n");
    for letter in ["x", "y", "z"] {
        text += &format!("[[switch]]\naxis = \"{letter}\"\nat_mm = 2\nside = \"positive\"\n");
    }
    text
}

fn words(place: [f64; AXES]) -> String {
    format!("X{} Y{} Z{}", place[0], place[1], place[2])
}

impl Mill {
    /// Returns a homed machine above the work. The tool change position (G30) and the setter's position (G59.3) are
    /// stored.
    fn homed() -> Mill {
        let mut bench = Bench::new(&machine(), SETTINGS);
        assert_eq!(bench.ask("$H"), ["ok"]);
        bench.settle();
        let (reported, place) = (bench.reported(), bench.place());
        let zero = std::array::from_fn(|axis| (reported[axis] - f64::from(place[axis])) / STEPS);
        bench.carry_out(&format!("G53 G0 {}", words(CHANGE)));
        bench.carry_out("G30.1");
        bench.carry_out(&format!("G10 L2 P9 X{} Y{}", SETTER[0], SETTER[1]));
        bench.carry_out(&format!("G53 G0 {}", words(WORK)));
        Mill { bench, zero, closes: TOUCHED, closed: false, said: Vec::new() }
    }

    /// Returns a homed machine whose first tool has been loaded and measured, with the tool's tip on the work at Z 0,
    /// and with spindle and coolant on.
    fn new() -> Mill {
        let mut mill = Mill::homed();
        mill.bench.send("T1 M6\n");
        mill.go_on();
        mill.bench.carry_out(&format!("G53 G0 {}", words(WORK)));
        mill.bench.carry_out("G92 Z0");
        mill.bench.carry_out("M3 S500 M8");
        mill.closes = TOUCHED + LONGER;
        mill.said.clear();
        mill
    }

    fn place(&self) -> [f64; AXES] {
        let place = self.bench.place();
        std::array::from_fn(|axis| f64::from(place[axis]) / STEPS + self.zero[axis])
    }

    /// Lets a short time pass, and opens or closes the setter according to the tool's position. Checks that the tool is
    /// down only at the work and at the setter, and that the spindle is off away from the work.
    fn look(&mut self) {
        self.bench.wait(LOOK);
        let place = self.place();
        let near = |x: f64, y: f64| (place[0] - x).abs() < EXACT && (place[1] - y).abs() < EXACT;
        let over_setter = near(SETTER[0], SETTER[1]);
        let closed = over_setter && place[2] <= self.closes;
        if closed != self.closed {
            self.closed = closed;
            self.bench.pin(&format!("probe {}", u8::from(closed)));
        }
        assert!(place[2] > self.closes - 0.5 || !over_setter, "{place:?} is in the setter");
        assert!(
            over_setter || near(WORK[0], WORK[1]) || place[2] > CHANGE[2] - EXACT,
            "{place:?} is low away from the work: {}",
            self.bench.status()
        );
        if !near(WORK[0], WORK[1]) {
            assert_eq!(self.spindle(), "0", "the spindle is off away from the work");
        }
        self.said.extend(self.bench.read());
    }

    /// Runs the tool change to its end. Sends `~` whenever the machine waits for the operator.
    fn go_on(&mut self) {
        let end = self.bench.seconds() + 120.0;
        while !self.said.iter().any(|line| line == "ok" || line.starts_with("error:")) {
            assert!(self.bench.seconds() < end, "no end: {:?} {}", self.said, self.bench.status());
            self.look();
            if matches!(self.bench.state().as_str(), "Hold:0" | "Door:0") {
                self.assert_held();
                self.bench.send("~");
            }
        }
        while self.bench.state() != "Idle" {
            assert!(self.bench.seconds() < end, "{:?} {}", self.said, self.bench.status());
            self.look();
        }
    }

    /// Checks that the drivers are on while the machine waits for the operator to load a tool, even after the idle
    /// delay (`$1`).
    fn assert_held(&mut self) {
        self.bench.wait(0.1);
        let asks = |text: &str| self.said.last().is_some_and(|line| line.starts_with(text));
        let place = self.place();
        let is_there = (0..2).all(|axis| (place[axis] - CHANGE[axis]).abs() < EXACT);
        if asks("[MSG:First tool") || asks("[MSG:Tool change") && is_there {
            assert!(self.bench.mill.outputs().is_some_and(|outputs| outputs.drivers), "{place:?}");
        }
    }

    /// Returns the spindle speed in the status report, for example `500`.
    fn spindle(&mut self) -> String {
        let status = self.bench.status();
        let fields = status.trim_end_matches('>').split('|');
        let speeds = fields.into_iter().find_map(|field| field.strip_prefix("FS:")).expect("speeds");
        speeds.split_once(',').expect("two speeds").1.to_string()
    }

    fn tool_length(&mut self) -> f64 {
        let said = self.bench.ask("$#");
        let line = said.iter().find_map(|line| line.strip_prefix("[TLO:")).expect("a length");
        line.trim_end_matches(']').parse().expect("a number")
    }

    #[track_caller]
    fn assert_changed(&mut self, what: &str) {
        assert_eq!(self.said.iter().filter(|line| line.as_str() == "ok").count(), 1, "{what}: {:?}", self.said);
        let place = self.place();
        let expected = [WORK[0], WORK[1], WORK[2] + LONGER];
        for axis in 0..AXES {
            assert!((place[axis] - expected[axis]).abs() < EXACT, "{what}: at {place:?}");
        }
        assert_eq!(self.spindle(), "500", "{what}: the spindle turns again");
        let length = self.tool_length();
        assert!((length - LONGER).abs() < EXACT, "{what}: length {length}");
        let reported = self.bench.reported();
        let place = self.place().map(|mm| (mm * STEPS).round() as i32);
        assert_place(reported, place, what);
    }

    /// Checks the state after an interrupted change: the position must be right or not trusted, and no unmeasured tool
    /// may count as measured.
    fn assert_safe(&mut self, what: &str) {
        self.bench.wait(2.0);
        self.said.extend(self.bench.read());
        let place = self.place();
        // A soft stop (0x19) leaves the spindle as it was. The spindle was off, except if the tool was already back
        // over the work.
        let is_back = what.starts_with("soft") && (place[0] - WORK[0]).abs() < EXACT && self.tool_length() > 1.0;
        assert!(is_back || self.spindle() == "0", "{what}: {}", self.bench.status());
        let trusted = self.bench.mill.controller().is_trusted();
        if trusted {
            let reported = self.bench.reported();
            let place = self.place().map(|mm| (mm * STEPS).round() as i32);
            assert_place(reported, place, what);
        }
        self.bench.pin("probe 0");
        self.closed = false;
        if self.bench.state() == "Alarm" {
            self.bench.ask("$X");
        }
        if !trusted {
            let said = self.bench.ask("T2 M6");
            assert!(said.iter().any(|line| line == "ok" || line == "error:130"), "{what}: {said:?}");
            // After the error, a message that the job was ended can arrive.
            self.bench.wait(0.1);
            self.bench.read();
            assert_eq!(self.bench.ask("$H"), ["ok"], "{what}");
            self.bench.settle();
        }
        self.bench.carry_out("G53 G0 Z-2");
        self.bench.send("T2 M6\n");
        self.bench.wait(3.0);
        let said = self.bench.read();
        match said.first().map(String::as_str) {
            Some("ok") => {
                let length = self.tool_length();
                assert!((length - LONGER).abs() < EXACT, "{what}: not measured anew, and length {length}");
            }
            first => assert_eq!(first, Some("[MSG:Tool change T2]"), "{what}: {said:?}"),
        }
    }
}

/// Returns copies of the machine, taken at intervals during a tool change. In each copy, the machine has not yet
/// answered the line of the tool change.
fn moments(mill: &Mill) -> Vec<Mill> {
    let mut mill = mill.clone();
    mill.bench.send("T2 M6\n");
    let mut moments = Vec::new();
    let mut looks = 0;
    while !mill.said.iter().any(|line| line == "ok") {
        if looks % 60 == 0 {
            moments.push(mill.clone());
        }
        mill.look();
        looks += 1;
        if looks % 100 == 99 && mill.bench.state() == "Hold:0" {
            moments.push(mill.clone());
            mill.bench.send("~");
        }
    }
    assert!(moments.len() > 30, "only {} moments", moments.len());
    moments
}

#[test]
fn the_work_zero_stays_true_for_a_longer_tool() {
    let mut mill = Mill::new();
    mill.bench.send("T2 M6\n");
    mill.go_on();
    mill.assert_changed("undisturbed");
    // Back to the first, shorter tool.
    mill.said.clear();
    mill.closes = TOUCHED;
    mill.bench.send("T1 M6\n");
    mill.go_on();
    assert!((mill.place()[2] - WORK[2]).abs() < EXACT, "{:?}", mill.place());
}

#[test]
fn a_hold_or_a_door_at_any_moment_changes_nothing() {
    for (number, moment) in moments(&Mill::new()).into_iter().enumerate() {
        for (way, begin, end) in [("hold", "hold 1", "hold 0"), ("door", "door 1", "door 0")] {
            let mut mill = moment.clone();
            mill.bench.pin(begin);
            (0..300).for_each(|_| mill.look());
            mill.bench.pin(end);
            (0..20).for_each(|_| mill.look());
            mill.go_on();
            mill.assert_changed(&format!("{way} at moment {number}"));
        }
    }
}

#[test]
fn an_end_at_any_moment_leaves_no_tool_that_was_not_measured() {
    for (number, moment) in moments(&Mill::new()).into_iter().enumerate() {
        for (way, byte) in [("reset", "\x18"), ("soft stop", "\x19")] {
            let mut mill = moment.clone();
            mill.bench.send(byte);
            mill.assert_safe(&format!("{way} at moment {number}"));
        }
        let mut mill = moment.clone();
        mill.bench.pin("estop 1");
        mill.bench.wait(0.1);
        mill.bench.pin("estop 0");
        mill.bench.send("\x18");
        mill.assert_safe(&format!("emergency stop at moment {number}"));
    }
}

#[test]
fn a_host_that_takes_over_learns_what_the_change_waits_for() {
    let mut mill = Mill::homed();
    mill.bench.send("T1 M6\n");
    let mut waits = 0;
    while !mill.said.iter().any(|line| line == "ok") {
        mill.look();
        let question = mill.said.last().filter(|line| line.starts_with("[MSG:")).cloned();
        let is_asked = mill.bench.state() == "Hold:0";
        let mut bench = mill.bench.clone();
        bench.mill.disconnect();
        bench.mill.connect();
        let told: Vec<String> = bench.read().into_iter().filter(|line| line.starts_with("[MSG:")).collect();
        let expected: Vec<String> = question.filter(|_| is_asked).into_iter().collect();
        assert_eq!(told, expected, "{:?} {}", mill.said, mill.bench.status());
        if is_asked {
            waits += 1;
            mill.bench.send("~");
        }
    }
    assert_eq!(waits, 2);
}
