//! Random programs of the words that Oxmill and LinuxCNC share.
//!
//! Lines that Oxmill rejects are omitted, with one exception: a batch can end with a rejected line, and then `rs274`
//! must reject it, too. Not generated, because the book lists them as differences:
//!
//! * G88
//! * a change of offsets, of the plane, or of G98 and G99 within a series of cycles
//! * a change of rotation while G92 is active: LinuxCNC then loses its position
//! * arcs and cycles in another plane than the plane of a rotation
//! * pecks smaller than the clearance of peck cycles
//! * G53 with G91
//! * a change of units, or M70, while a tool offset is active
//! * a tool offset along A

use super::Outcome;
use super::ours::Mill;
use oxmill_controller::error::Error;

/// Start of every program: resets the state that the previous one has left.
const BEGIN: &[&str] = &[
    "G49",
    "G21 G90 G17 G94 G98 G40 G80 G61",
    "G54 G92.1 F300 S1000",
    "G10 L2 P1 X0 Y0 Z0 A0 R0",
    "G10 L2 P2 X0 Y0 Z0 A0 R0",
    "G10 L2 P6 X0 Y0 Z0 A0 R0",
    "G10 L2 P9 X0 Y0 Z0 A0 R0",
    "G10 L1 P1 X0 Y0 Z0 A0",
    "G10 L1 P2 X0 Y0 Z0 A0",
    "G10 L1 P7 X0 Y0 Z0 A0",
    "T1 M6 M3",
    "G53 G0 X0 Y0 Z0 A0",
    "G28.1",
    "G30.1",
    "M70",
];

/// Maximum number of statements that are tried at the end of a batch to find one that Oxmill rejects.
const MORE: usize = 60;

pub struct Batch {
    pub lines: Vec<String>,
    pub outcome: Outcome,
}

struct Writer {
    random: u64,
    mill: Mill,
    inches: bool,
    incremental: bool,
    plane: usize,
    /// `inches`, `incremental` and `plane` at the most recent M70, which saves them. M72 restores them.
    kept: (bool, bool, usize),
    /// `true` after M61, which names the tool in the spindle. Then no G43 without H is generated: `rs274` looks up a
    /// tool's offset only at M6.
    is_tool_named: bool,
    /// Number of subroutines written so far; each is named after its number.
    subroutines: usize,
    batch: Batch,
    refused: Option<String>,
}

/// Returns a batch of `programs` random programs in sequence. Its last line is a line that Oxmill rejects, if the
/// generator has found one; otherwise M2.
pub fn batch(seed: u64, programs: usize) -> Batch {
    let outcome = Outcome { events: Vec::new(), of: Vec::new(), refused: None };
    let mut writer = Writer {
        random: seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1,
        mill: Mill::new(),
        inches: false,
        incremental: false,
        plane: 0,
        kept: (false, false, 0),
        is_tool_named: false,
        subroutines: 0,
        batch: Batch { lines: Vec::new(), outcome },
        refused: None,
    };
    for _ in 0..programs {
        for line in BEGIN {
            // If the machine is very near the target of G53, rounding decides if there is a move. So it moves away
            // first.
            if !writer.put((*line).into()) && line.starts_with("G53") {
                writer.put("G53 G0 X9 Y9 Z9 A9".into());
                writer.put((*line).into());
            }
        }
        writer.is_tool_named = false;
        (writer.inches, writer.incremental, writer.plane, writer.kept) = (false, false, 0, (false, false, 0));
        for _ in 0..8 + writer.below(25) {
            writer.statement();
        }
    }
    for _ in 0..MORE {
        if writer.refused.is_some() {
            break;
        }
        writer.statement();
    }
    let mut batch = writer.batch;
    match writer.refused {
        Some(line) => {
            batch.lines.push(line.clone());
            batch.outcome.refused = Some(line);
        }
        None => batch.lines.push("M2".into()),
    }
    batch
}

impl Writer {
    fn next(&mut self) -> u64 {
        // xorshift64*
        self.random ^= self.random >> 12;
        self.random ^= self.random << 25;
        self.random ^= self.random >> 27;
        self.random.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11
    }

    fn below(&mut self, n: u64) -> u64 {
        self.next() % n
    }

    fn percent(&mut self, share: u64) -> bool {
        self.below(100) < share
    }

    fn one_of<'a>(&mut self, all: &[&'a str]) -> &'a str {
        all[self.below(all.len() as u64) as usize]
    }

    /// Returns a random length from `least` to `most` mm, as a number in the program's unit.
    fn length(&mut self, least: f64, most: f64) -> String {
        let share = self.below(2001) as f64 / 2000.0;
        let mm = least + (most - least) * share;
        if self.inches { format!("{:.3}", mm / 25.4) } else { format!("{mm:.2}") }
    }

    fn coordinate(&mut self) -> String {
        if self.incremental { self.length(-10.0, 10.0) } else { self.length(-40.0, 40.0) }
    }

    /// Returns words of some of the axes, at least one.
    fn axes(&mut self) -> String {
        let words = self.linear_axes();
        if self.percent(25) { format!("{words} A{}", self.degrees()) } else { words }
    }

    /// Returns words of some of the axes X, Y and Z, at least one.
    fn linear_axes(&mut self) -> String {
        let mut words = String::new();
        while words.is_empty() {
            for axis in ["X", "Y", "Z"] {
                if self.percent(45) {
                    words += &format!(" {axis}{}", self.coordinate());
                }
            }
        }
        words
    }

    /// Returns an angle, which does not depend on the unit of length.
    fn degrees(&mut self) -> String {
        format!("{:.2}", (self.below(2001) as f64 - 1000.0) / if self.incremental { 20.0 } else { 2.0 })
    }

    /// Adds a line to the program if Oxmill accepts it; returns whether it did.
    fn put(&mut self, line: String) -> bool {
        let before = self.mill.clone();
        match self.mill.run(&line) {
            Ok(_) if self.mill.is_doubtful() => {
                self.mill = before;
                false
            }
            Ok(events) => {
                let at = self.batch.lines.len();
                self.batch.outcome.of.extend(events.iter().map(|_| at));
                self.batch.outcome.events.extend(events);
                self.batch.lines.push(line);
                self.refused = None;
                true
            }
            // Only Oxmill rejects this line: `rs274` accepts arcs and cycles in another plane than the plane of a
            // rotation. So the line cannot end the batch.
            Err(Error::NotInRotatedPlane) => false,
            Err(_) => {
                self.refused = Some(line);
                false
            }
        }
    }

    /// Clears G92 if it is active while a coordinate system is rotated. Called before a line that can change the
    /// rotation, because LinuxCNC loses its position if G92 is active then.
    fn before_rotation(&mut self) {
        if self.mill.is_rotated_under_g92() {
            self.put("G92.1".into());
        }
    }

    fn statement(&mut self) {
        match self.below(100) {
            0..=19 => {
                let (modal, word, axes) = (self.modal(), self.one_of(&["G0", "G1"]), self.axes());
                self.put(format!("{modal}{word}{axes}"));
            }
            20..=27 => {
                let axes = self.axes();
                self.put(axes.trim().into());
            }
            28..=41 => self.arc(),
            42 => self.spline(),
            43 => self.control_points(),
            44..=63 => self.cycle(),
            64..=67 => {
                let plane = self.below(3) as usize;
                if self.put(format!("G{}", 17 + plane)) {
                    self.plane = plane;
                }
            }
            68..=70 => {
                let inches = self.percent(50);
                self.put("G49".into());
                if self.put(if inches { "G20" } else { "G21" }.into()) {
                    self.inches = inches;
                }
            }
            71..=74 => {
                let incremental = self.percent(50);
                if self.put(if incremental { "G91" } else { "G90" }.into()) {
                    self.incremental = incremental;
                }
            }
            75..=76 => {
                let time = self.below(2000) as f64 / 1000.0;
                self.put(format!("G4 P{time}"));
            }
            77..=84 => self.offsets(),
            85..=88 => self.places(),
            89..=94 => self.tools(),
            95 => self.keep(),
            96 => self.subroutine(),
            97 => self.pins(),
            _ => {
                let line = self.one_of(&[
                    "G80",
                    "G61",
                    "G64",
                    "G64 P0.1",
                    "G64 P0.02 Q0.01",
                    "G64 P0 Q0.1",
                    "G61.1",
                    "M48",
                    "M49",
                    "M50 P0",
                    "M51",
                    "M8",
                    "M9",
                    "F500",
                    "S200",
                ]);
                self.put(line.into());
            }
        }
    }

    /// Returns a modal word that can precede a motion.
    fn modal(&mut self) -> String {
        let which = self.below(20);
        if which < 3 {
            self.before_rotation();
        }
        match which {
            0 => "G54 ".into(),
            1 => "G55 ".into(),
            2 => "G59.3 ".into(),
            3 => "G49 ".into(),
            4 => "G43 H1 ".into(),
            5 => "G80 ".into(),
            6 => "G64 ".into(),
            7 => self.offset_acts().into(),
            _ => String::new(),
        }
    }

    /// Returns a word that clears, suspends or restores the offset of G92; it acts before the motion in the same line.
    fn offset_acts(&mut self) -> &'static str {
        ["G92.1 ", "G92.2 ", "G92.3 "][self.below(3) as usize]
    }

    fn plane_axes(&self) -> [usize; 3] {
        [[0, 1, 2], [2, 0, 1], [1, 2, 0]][self.plane]
    }

    fn arc(&mut self) {
        const AXES: [char; 3] = ['X', 'Y', 'Z'];
        const CENTRES: [char; 3] = ['I', 'J', 'K'];
        let [first, second, third] = self.plane_axes();
        let word = self.one_of(&["G2", "G3"]);
        let unit = if self.inches { 25.4 } else { 1.0 };
        let [x, y, z, _] = self.mill.work();
        let work = [x, y, z].map(|mm| mm / unit);
        let angle = self.below(6283) as f64 / 1000.0;
        let radius = (1.0 + self.below(1500) as f64 / 100.0) / unit;
        let (i, j) = (radius * angle.cos(), radius * angle.sin());
        let helix = if self.percent(30) { format!(" {}{}", AXES[third], self.coordinate()) } else { String::new() };
        let helix = if self.percent(20) { format!("{helix} A{}", self.degrees()) } else { helix };
        let turns = if self.percent(15) { format!(" P{}", 1 + self.below(4)) } else { String::new() };
        let to = |axis: usize, by: f64, incremental: bool| if incremental { by } else { work[axis] + by };
        let incremental = self.incremental;
        let line = match self.below(4) {
            0 => format!("{word}{helix} {}{i:.5} {}{j:.5}{turns}", CENTRES[first], CENTRES[second]),
            1 => {
                // The longer the chord relative to the radius, the more the centre depends on the rounding of the end
                // point. So the chord is shorter than 0.9 of the diameter.
                let share = 0.1 + self.below(80) as f64 / 100.0;
                let (a, b) = (2.0 * radius * share * angle.cos(), 2.0 * radius * share * angle.sin());
                let sign = if self.percent(30) { "-" } else { "" };
                format!(
                    "{word} {}{:.5} {}{:.5}{helix} R{sign}{radius:.5}",
                    AXES[first],
                    to(first, a, incremental),
                    AXES[second],
                    to(second, b, incremental)
                )
            }
            _ => {
                let turned = 0.1 + self.below(6000) as f64 / 1000.0;
                // From the centre, the start is at -(i, j).
                let (a, b) = (i - i * turned.cos() + j * turned.sin(), j - i * turned.sin() - j * turned.cos());
                format!(
                    "{word} {}{:.5} {}{:.5}{helix} {}{i:.5} {}{j:.5}{turns}",
                    AXES[first],
                    to(first, a, incremental),
                    AXES[second],
                    to(second, b, incremental),
                    CENTRES[first],
                    CENTRES[second]
                )
            }
        };
        self.put(line);
    }

    /// Writes splines in a row, and a move that shows where they end: for a spline `rs274` prints only the number of
    /// control points.
    fn spline(&mut self) {
        let mut smooth = false;
        for _ in 0..1 + self.below(3) {
            let is_cubic = self.percent(70);
            let mut line = String::from(if is_cubic { "G5" } else { "G5.1" });
            let axes: &[&str] = if self.percent(3) { &["X", "Z"] } else { &["X", "Y"] };
            for axis in axes {
                if self.percent(85) {
                    line += &format!(" {axis}{}", self.coordinate());
                }
            }
            if !(is_cubic && smooth && self.percent(50)) {
                let (i, j) = (self.length(-20.0, 20.0), self.length(-20.0, 20.0));
                line += &format!(" I{i}");
                if self.percent(98) {
                    line += &format!(" J{j}");
                }
            }
            if is_cubic {
                let (p, q) = (self.length(-20.0, 20.0), self.length(-20.0, 20.0));
                line += &format!(" P{p}");
                if self.percent(98) {
                    line += &format!(" Q{q}");
                }
            }
            if !self.put(line) {
                break;
            }
            smooth = is_cubic;
        }
        let (axis, to) = (self.one_of(&["X", "Y", "Z"]), self.coordinate());
        let word = self.one_of(&["G0", "G1"]);
        self.put(format!("{word} {axis}{to}"));
    }

    /// Writes control points, one per line, and a move that shows where their curve ends.
    fn control_points(&mut self) {
        let order = 3 + self.below(3);
        let points = order - 1 + self.below(6);
        // If the first line has a point, `rs274` uses the weight of that point for the start. So the first line here
        // has no point.
        let weight = 1 + self.below(3);
        if !self.put(format!("G5.2 P{weight} L{order}")) {
            return;
        }
        for _ in 0..points {
            let (x, y, weight) = (self.coordinate(), self.coordinate(), 1 + self.below(40));
            self.put(format!("X{x} Y{y} P{}", weight as f64 / 10.0));
            if self.percent(10) {
                self.put("F400".into());
            }
        }
        self.put("G5.3".into());
        let (axis, to) = (self.one_of(&["X", "Y", "Z"]), self.coordinate());
        let word = self.one_of(&["G0", "G1"]);
        self.put(format!("{word} {axis}{to}"));
    }

    /// Writes a series of cycles, and a motion that ends it.
    fn cycle(&mut self) {
        const AXES: [char; 3] = ['X', 'Y', 'Z'];
        let [first, second, third] = self.plane_axes();
        let unit = if self.inches { 25.4 } else { 1.0 };
        let word = self.one_of(&["G73", "G81", "G82", "G83", "G85", "G86", "G89"]);
        let pecks = matches!(word, "G73" | "G83");
        let dwells = matches!(word, "G82" | "G86" | "G89");
        let here = if self.incremental { 0.0 } else { self.mill.work()[third] };
        let r = here + self.below(200) as f64 / 10.0 - 15.0;
        let depth = self.below(100) as f64 / 10.0;
        let z = if self.incremental { -depth } else { r - depth };
        let number = |mm: f64| if unit == 1.0 { format!("{mm:.2}") } else { format!("{:.4}", mm / unit) };
        let retract = self.one_of(&["G98 ", "G99 ", ""]);
        for at in 0..1 + self.below(5) {
            let begins = at == 0;
            let mut line = if begins { format!("{retract}{word}") } else { String::new() };
            if begins && self.percent(20) {
                line = format!("G80 {line}");
            }
            if begins && self.percent(5) {
                line = format!("{}{line}", self.offset_acts());
            }
            for axis in [first, second] {
                if self.percent(60) {
                    line += &format!(" {}{}", AXES[axis], self.coordinate());
                }
            }
            if begins && self.percent(97) || self.percent(15) {
                line += &format!(" {}{}", AXES[third], number(z));
            }
            if begins && self.percent(97) || self.percent(10) {
                line += &format!(" R{}", number(r));
            }
            if pecks && (begins && self.percent(97) || self.percent(10)) {
                // The depth must not be an integer number of pecks: by rounding, `rs274` would add a peck of zero
                // depth.
                line += &format!(" Q{}37", self.length(0.5, 5.0));
            }
            if dwells && (begins && self.percent(97) || self.percent(10)) {
                line += &format!(" P{}", self.below(100) as f64 / 100.0);
            }
            if self.percent(20) {
                line += &format!(" L{}", 1 + self.below(4));
            }
            if !self.put(line.trim().into()) && begins {
                return;
            }
        }
        let end = self.one_of(&["G80", "G0", "G1"]);
        let axes = self.axes();
        // If the motion that should end the series is rejected, G80 must end it, because a change of plane can follow.
        if end == "G80" || !self.put(format!("{end}{axes}")) {
            self.put("G80".into());
        }
    }

    fn offsets(&mut self) {
        let axes = self.axes();
        let system = self.one_of(&["P1", "P2", "P6", "P9", "P0"]);
        let angle = self.one_of(&["30", "-45", "90", "12.5", "180", "271.25", "-0.37", "0"]);
        let which = self.below(12);
        if matches!(which, 0 | 9..) {
            self.before_rotation();
        }
        if which >= 9 && self.mill.has_g92() {
            self.put("G92.1".into());
        }
        let line = match which {
            9 => format!("G10 L2 {system} R{angle}"),
            10 | 11 => format!("G10 L2 {system}{axes} R{angle}"),
            0 => self.one_of(&["G54", "G55", "G59", "G59.3"]).into(),
            1 => format!("G10 L2 {system}{axes}"),
            2 => format!("G10 L20 {system}{axes}"),
            3 => format!("G92{axes}"),
            4 => "G92.1".into(),
            5 => "G92.2".into(),
            6 => "G92.3".into(),
            7 => format!("G52{axes}"),
            _ => "G92".into(),
        };
        self.put(line);
    }

    fn places(&mut self) {
        let axes = self.axes();
        let line = match self.below(8) {
            0 => "G28".into(),
            1 => format!("G28{axes}"),
            2 => "G30".into(),
            3 => format!("G30{axes}"),
            4 => "G28.1".into(),
            5 => "G30.1".into(),
            _ if self.incremental => "G28".into(),
            6 => format!("G53 G0{axes}"),
            _ => format!("G53 G1{axes}"),
        };
        self.put(line);
    }

    fn tools(&mut self) {
        let axes = self.linear_axes();
        let tool = self.one_of(&["1", "2", "7"]);
        let l = self.one_of(&["L1", "L10", "L11"]);
        let which = self.below(10);
        if matches!(which, 3 | 8) {
            self.rapid_xyz();
            self.is_tool_named = false;
        }
        let line = match which {
            0 | 1 => format!("G10 {l} P{tool}{axes}"),
            2 => format!("T{tool}"),
            3 => format!("T{tool} M6 M3"),
            4 if !self.is_tool_named => "G43".into(),
            4 => format!("G43 H{tool}"),
            5 => format!("G43 H{tool}"),
            6 => format!("G43.2 H{tool}"),
            7 => format!("G43.1{axes}"),
            8 => format!("T{tool} M6 M3 G43 G0{axes}"),
            _ => "G49".into(),
        };
        self.put(line);
    }

    /// Writes a rapid of X, Y and Z. Needed before M6 and M61, because there the simulated machine in `rs274` forgets
    /// a change of offsets since the last move.
    fn rapid_xyz(&mut self) {
        let (x, y, z) = (self.coordinate(), self.coordinate(), self.coordinate());
        self.put(format!("G0 X{x} Y{y} Z{z}"));
    }

    /// Writes words for program outputs and inputs, on lines of their own and on lines with a move, and invalid ones.
    fn pins(&mut self) {
        let (number, x, value) = (self.below(5), self.coordinate(), self.below(200) as f64 / 10.0 - 5.0);
        let word = self.one_of(&["M62", "M63", "M64", "M65"]);
        let wait = self.below(5);
        let line = match self.below(20) {
            0..=5 => format!("{word} P{number}"),
            6..=8 => format!("{word} P{number} G0 X{x}"),
            9 => format!("{word} G4 P{number}"),
            10..=12 => format!("M67 E{number} Q{value}"),
            13..=14 => format!("M68 E{number} Q{value} G0 X{x}"),
            15 => format!("M66 P{number} L{wait} Q{value}"),
            16 => format!("M66 E{number} L{wait} Q1"),
            17 => format!("M66 P{number}"),
            18 => {
                self.rapid_xyz();
                self.is_tool_named = true;
                let tool = self.one_of(&["1", "2", "7"]);
                format!("M61 Q{tool}")
            }
            _ => self
                .one_of(&[
                    "M62",
                    "M66 P0 E0",
                    "M66",
                    "M67 Q1",
                    "M64 P1 Q1",
                    "M62 P1 E1",
                    "M64 P0 M65",
                    "M61",
                    "M61 Q-1",
                ])
                .into(),
        };
        self.put(line);
    }

    /// Writes a subroutine that saves the state of its caller, and calls of it. None of its lines can be rejected.
    fn subroutine(&mut self) {
        self.put("G49".into());
        self.before_rotation();
        self.subroutines += 1;
        let label = format!("o{}", self.subroutines);
        let now = (self.inches, self.incremental, self.plane);
        let mut lines = vec![format!("{label} sub")];
        for _ in 0..1 + self.below(6) {
            let keeps = self.one_of(&["M73", "M73", "M73", "M70", "M71"]);
            let modal =
                self.one_of(&["G20", "G21", "G90", "G91", "G17", "G18", "G61", "G64 P0.1", "F200", "S50", "M8"]);
            match self.below(4) {
                0 => lines.push(keeps.into()),
                1 => {
                    let x = self.coordinate();
                    lines.push(format!("{} X{x}", ["G0", "G1"][self.below(2) as usize]));
                }
                _ => {
                    match modal {
                        "G20" => self.inches = true,
                        "G21" => self.inches = false,
                        "G90" => self.incremental = false,
                        "G91" => self.incremental = true,
                        _ => {}
                    }
                    lines.push(modal.into());
                }
            }
        }
        (self.inches, self.incremental, self.plane) = now;
        // The subroutine can change units, distance mode and plane for its caller. The last lines below restore them.
        let back = |on: bool, words: [&str; 2]| words[usize::from(on)].to_string();
        let word = if self.percent(30) { "return" } else { "endsub" };
        if word == "return" {
            lines.push(format!("{label} return"));
        }
        lines.push(format!("{label} endsub"));
        for _ in 0..1 + self.below(2) {
            lines.push(format!("{label} call"));
        }
        lines.push(format!("G1 X{}", self.coordinate()));
        lines.push(back(self.inches, ["G21", "G20"]));
        lines.push(back(self.incremental, ["G90", "G91"]));
        lines.push(format!("G{}", 17 + self.plane));
        for line in lines {
            self.put(line);
        }
    }

    fn keep(&mut self) {
        self.put("G49".into());
        self.before_rotation();
        let now = (self.inches, self.incremental, self.plane);
        if self.percent(50) {
            if self.put("M70".into()) {
                self.kept = now;
            }
        } else if self.kept.0 == self.inches && self.put("M72".into()) {
            (self.inches, self.incremental, self.plane) = self.kept;
        }
    }
}
