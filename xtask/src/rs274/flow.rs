//! Random programs with parameters, expressions, names, O words and moves of A. They also have G93, G90.1, messages,
//! stops, block delete, and computed G and M numbers.
//!
//! A statement is one line or a whole construct, such as a loop. Statements with a line that Oxmill rejects are
//! omitted, but the last statement of a batch can have one: `rs274` must then reject the same line. Between other
//! lines, also within constructs, there are lines that show the machine's state.
//!
//! Not generated, because the book lists them as differences (see also `expressions`):
//!
//! * a label used for two constructs: in LinuxCNC each label belongs to one construct
//! * a call of a subroutine that does not exist or comes later: `rs274` reads on to the end of the file and names
//!   another line
//! * a name that is first set in the same line: 0 in LinuxCNC
//! * setting a parameter of the machine other than #5420 and on: LinuxCNC allows it
//! * anything that needs more memory or a deeper nesting than Oxmill has, or a result that is too large for it:
//!   LinuxCNC has no such limits
//! * `break` and `continue` in a `repeat`: LinuxCNC rejects them
//! * `do` after a `break` in a `while`: in `rs274` the `break` also ends the next `do` after one pass
//! * `continue` in a `do` within another loop: in the last pass of the `do`, `rs274` then never leaves the loop
//! * `#<_value>` other than after a call: `rs274` also sets it at the definition of a subroutine
//! * a G number with more than two decimals, such as G0.004: Oxmill, like Grbl, rounds it to hundredths
//! * `#5401` and on: Oxmill shows the active tool offset, LinuxCNC the offset of the tool in the spindle, active or not
//! * the spindle after M6: LinuxCNC stops it, so M3 is written in the same line
//! * a message in a line with words: `rs274` sends it before the words act, so it shows the earlier values
//! * `#<_feed>` in G93, or after a change of the unit in which F was set: LinuxCNC keeps the number of F
//! * F in a line with G20 or G21, for the same reason
//! * a change of units under a tool offset
//! * M6 after a change of offsets, unless X, Y and Z have moved since: at M6, the simulated machine in `rs274` forgets
//!   such a change
//! * G53 with G91
//!
//! Rotations are generated in `programs`.

use super::expressions::{self, NAMED, NUMBERED, POINTER};
use super::programs::Batch;
use super::runner::Runner;
use super::{Event, Outcome, PLACES_MARK};
use oxmill_controller::error::Error;
use oxmill_test_support::Random;

/// First lines of every program. They reset what the previous program has changed, and set the parameters that
/// expressions use.
const BEGIN: &[&str] = &[
    "G49",
    "G21 G90 G17 G94 G98 G40 G80 G61 G91.1",
    "G54 G92.1 F300 S1000 M3",
    "G10 L2 P1 X0 Y0 Z0 A0",
    "G10 L2 P2 X0 Y0 Z0 A0",
    "G10 L2 P6 X0 Y0 Z0 A0",
    "G10 L2 P9 X0 Y0 Z0 A0",
    "G10 L1 P1 X0 Y0 Z0",
    "G10 L1 P2 X0 Y0 Z0",
    "#1=1.5 #2=-2.71713 #3=3 #4=0 #5=7.13135",
    "#31=[10.1 + 0.2] #32=-12 #33=.5 #34=99.31317 #35=-0.00731",
    "#<u>=4.71711 #<v>=-5 #<_g>=6.5 #<_h k>=-8.19191",
    "#30=0 #29=0 #28=0 #40=33",
    "G0 X0.31713 Y0.13577 Z0.71117 A7.13135",
    "T1 M6 M3",
    "G28.1",
    "G30.1",
];
/// Start of a subroutine: sets its local parameters.
const OWN: &str = "#<u>=#1 #<v>=[#2 + 1.31713] #4=#3";
/// Parameters that show the machine's state. A state line prints some of them.
const STATE: [&str; 30] = [
    "#5420",
    "#5421",
    "#5422",
    "#5423",
    "#<_a>",
    "#<_abs_a>",
    "#5164",
    "#5184",
    "#5214",
    "#5224",
    "#5220",
    "#5210",
    "#5400",
    "#<_x>",
    "#<_y>",
    "#<_abs_x>",
    "#<_abs_z>",
    "#<_metric>",
    "#<_imperial>",
    "#<_absolute>",
    "#<_incremental>",
    "#<_motion_mode>",
    "#<_plane>",
    "#<_coord_system>",
    "#<_ijk_absolute_mode>",
    "#<_spindle_on>",
    "#<_flood>",
    "#<_current_tool>",
    "#<_selected_tool>",
    "#<_call_level>",
];
/// Parameters with stored positions, in the unit of the machine: mm in Oxmill, inches in `rs274`.
const PLACES: [&str; 12] =
    ["#5161", "#5162", "#5183", "#5211", "#5212", "#5213", "#5221", "#5222", "#5223", "#5241", "#5322", "#5383"];
/// Maximum number of statements that are tried at the end of a batch to find one that Oxmill rejects.
const MORE: usize = 60;
/// Positions beyond this, mm, can be out of Oxmill's range.
const FAR: f64 = 10_000.0;
/// Maximum line length: statements with longer lines are not generated, because `rs274` truncates lines at another
/// length than Oxmill.
const LONGEST: usize = 200;
/// Maximum message length: longer messages are omitted, because Oxmill truncates them.
const LONGEST_MESSAGE: usize = 80;
/// Maximum nesting of constructs, not counting those in subroutines that are called.
const NESTED: u32 = 2;
/// Planes: the word, the axes, the letters of the centre.
const PLANES: [(&str, [char; 3], [char; 2]); 3] =
    [("G17", ['X', 'Y', 'Z'], ['I', 'J']), ("G18", ['Z', 'X', 'Y'], ['K', 'I']), ("G19", ['Y', 'Z', 'X'], ['J', 'K'])];

/// A statement with a rejected line: all its lines, its events up to the rejected line, and the rejected line.
struct Refused {
    lines: Vec<String>,
    events: Vec<Event>,
    line: String,
}

struct Writer {
    random: Random,
    runner: Runner,
    batch: Batch,
    refused: Option<Refused>,
    /// `true`: the batch may have `do` loops, but no `break` in a `while`. In `rs274` such a `break` also ends the next
    /// `do`.
    has_do: bool,
    /// Number of labels used so far.
    labels: u64,
    /// Labels of the subroutines that can be called.
    subroutines: Vec<String>,
}

/// Returns a batch of `programs` random programs in sequence. If a statement with a rejected line was found, it is the
/// last one. `deletes_blocks`: lines that start with a slash are skipped.
pub fn batch(seed: u64, programs: usize, deletes_blocks: bool) -> Batch {
    let outcome = Outcome { events: Vec::new(), of: Vec::new(), refused: None };
    let mut writer = Writer {
        random: Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1),
        runner: Runner::new(deletes_blocks),
        batch: Batch { lines: Vec::new(), outcome },
        refused: None,
        has_do: false,
        labels: 0,
        subroutines: Vec::new(),
    };
    writer.has_do = writer.percent(50);
    let between_marks = writer.percent(30);
    if between_marks {
        writer.put(vec!["%".into()]);
    }
    for _ in 0..programs {
        for line in BEGIN {
            assert!(writer.put(vec![(*line).into()]), "Oxmill refuses {line}");
        }
        for _ in 0..6 + writer.random.below(12) {
            writer.statement();
        }
    }
    for _ in 0..MORE {
        if writer.refused.is_some() {
            break;
        }
        writer.statement();
    }
    writer.end(between_marks)
}

/// Returns a line in a form in which the lines of both interpreters can be compared: without blanks, comments and the
/// slash of block delete, in upper case.
pub fn without_blanks(line: &str) -> String {
    let mut text = String::new();
    let mut in_comment = false;
    for letter in line.chars() {
        match letter {
            '(' => in_comment = true,
            ')' => in_comment = false,
            ';' if !in_comment => break,
            '/' if text.is_empty() => {}
            _ if in_comment || letter.is_whitespace() => {}
            _ => text.push(letter.to_ascii_uppercase()),
        }
    }
    text
}

impl Writer {
    fn percent(&mut self, share: u64) -> bool {
        self.random.below(100) < share
    }

    fn end(self, between_marks: bool) -> Batch {
        let mut batch = self.batch;
        match self.refused {
            Some(refused) => {
                batch.lines.extend(refused.lines);
                let at = batch.lines.len() - 1;
                batch.outcome.of.extend(refused.events.iter().map(|_| at));
                batch.outcome.events.extend(refused.events);
                batch.outcome.refused = Some(refused.line);
            }
            None => batch.lines.push(if between_marks { "%" } else { "M2" }.into()),
        }
        batch
    }

    /// Adds a statement to the program if Oxmill accepts it; returns whether it did.
    fn put(&mut self, lines: Vec<String>) -> bool {
        if lines.iter().any(|line| line.len() > LONGEST || line.starts_with('(') && line.len() > LONGEST_MESSAGE) {
            return false;
        }
        let lines: Vec<String> = lines.into_iter().map(|line| self.spelled(line)).collect();
        let mut runner = self.runner.clone();
        let (mut events, mut of) = (Vec::new(), Vec::new());
        for (at, line) in lines.iter().enumerate() {
            let result = runner.run(line, &mut events);
            of.resize(events.len(), self.batch.lines.len() + at);
            match result {
                // The statement is left out: its move is so short that rounding would decide if there is a move at all.
                _ if runner.mill.is_doubtful() => return false,
                Ok(()) => {}
                Err(refusal) => {
                    let is_far = runner.mill.work().iter().any(|mm| mm.abs() > FAR);
                    let by_limit = matches!(
                        refusal.error,
                        Error::OutOfMemory | Error::TooDeep | Error::EndlessLoop | Error::InvalidResult
                    ) || is_far && refusal.error == Error::InvalidTarget;
                    if !by_limit {
                        let line = without_blanks(&refusal.line);
                        self.refused = Some(Refused { lines, events, line });
                    }
                    return false;
                }
            }
        }
        self.refused = None;
        self.runner = runner;
        self.batch.lines.extend(lines);
        self.batch.outcome.events.extend(events);
        self.batch.outcome.of.extend(of);
        true
    }

    /// Returns a line, sometimes in another spelling: in lower case, with a comment, more blanks or a line number.
    fn spelled(&mut self, line: String) -> String {
        if line.starts_with(['(', '%', '/']) || !self.percent(12) {
            return line;
        }
        match self.random.below(5) {
            0 => line.to_lowercase(),
            1 => format!("{line} (beside, #1)"),
            2 => format!("{line} ; (to the end"),
            3 => format!("  {}", line.replace(' ', "  ")),
            _ => format!("N{} {line}", self.random.below(99_999)),
        }
    }

    fn label(&mut self) -> String {
        self.labels += 1;
        let number = self.labels;
        match self.random.below(4) {
            0 => format!("o<part {number}>"),
            1 => format!("o00{number}"),
            _ => format!("o{number}"),
        }
    }

    fn statement(&mut self) {
        let lines = match self.random.below(100) {
            0..=5 => self.units(),
            6..=13 => self.offsets(),
            14..=16 => self.tools(),
            17..=18 => self.stops(),
            19..=22 => self.deleted(),
            23..=25 => self.wrong(),
            26..=32 => self.subroutine(),
            _ => self.inner(NESTED),
        };
        self.put(lines);
        if self.percent(50) {
            let state = self.state();
            self.put(vec![state]);
        }
    }

    /// Returns a statement that can occur at the top level and within constructs, including subroutines.
    fn inner(&mut self, depth: u32) -> Vec<String> {
        match self.random.below(if depth == 0 { 70 } else { 100 }) {
            0..=17 => vec![self.assignment()],
            18..=33 => vec![self.motion()],
            34..=41 => vec![self.state()],
            42..=46 => self.inverse_time(),
            47..=52 => self.arc(),
            53..=56 => self.cycle(),
            57..=58 => vec![format!("G4 P[ABS[{}] MOD 2]", expressions::value(&mut self.random))],
            59..=65 => vec![self.selectors()],
            66..=69 => self.call(),
            70..=82 => self.condition(depth),
            _ => self.repetition(depth),
        }
    }

    fn body(&mut self, depth: u32) -> Vec<String> {
        let mut lines = Vec::new();
        for _ in 0..1 + self.random.below(3) {
            lines.extend(self.inner(depth - 1));
        }
        lines
    }

    fn axes(&mut self) -> String {
        let mut words = String::new();
        while words.is_empty() {
            for axis in ["X", "Y", "Z"] {
                if self.percent(45) {
                    words += &format!(" {axis}{}", expressions::length(&mut self.random));
                }
            }
            // A can also be the only axis word.
            if self.percent(20) {
                words += &format!(" A{}", expressions::length(&mut self.random));
            }
        }
        words
    }

    fn assignment(&mut self) -> String {
        let random = &mut self.random;
        let mut line = String::new();
        for _ in 0..1 + random.below(2) {
            let value = expressions::value(random);
            let target = match random.below(12) {
                0..=5 => random.of(&NUMBERED).to_owned(),
                6..=9 => random.of(&NAMED).to_owned(),
                10 => format!("#{POINTER}"),
                _ => format!("#[{POINTER} - 1]"),
            };
            line += &format!("{target} = {value} ");
        }
        // An assignment takes effect only after the whole line has been read. So the motion uses the values before the
        // assignment, although the assignment is earlier in the line.
        if random.below(5) == 0 {
            line += &format!("G0 X{}", expressions::length(random));
        }
        if random.below(12) == 0 { format!("{POINTER}={}", 32 + random.below(4)) } else { line }
    }

    fn motion(&mut self) -> String {
        let (word, axes) =
            (self.random.of(&["G0", "G1", "G[0 + 1]", "G0 ", "G1 ", "G80 G0", "G[#40 * 0]"]), self.axes());
        format!("{word}{axes}")
    }

    fn state(&mut self) -> String {
        let random = &mut self.random;
        if random.below(6) == 0 {
            let [a, b, c] = std::array::from_fn(|_| random.of(&PLACES));
            return format!("(DEBUG,{PLACES_MARK} {a} {b} {c})");
        }
        let mut line = random.of(&["(DEBUG,state", "(debug, state", "(PRINT,state"]).to_owned();
        for _ in 0..2 + random.below(3) {
            let shown = match random.below(8) {
                0..=1 => random.of(&NUMBERED),
                2 => random.of(&NAMED),
                3 => random.of(&["#<_feed>", "#<_rpm>", "#<_nobody>"]),
                _ => random.of(&STATE),
            };
            line += &format!(" {shown}");
        }
        if random.below(20) == 0 { format!("(MSG,state {})", random.below(1000)) } else { line + ")" }
    }

    /// Returns moves and arcs in G93, sometimes without the required time.
    fn inverse_time(&mut self) -> Vec<String> {
        let mut lines = vec!["G93".to_owned()];
        for _ in 0..1 + self.random.below(3) {
            let axes = self.axes();
            let rate = match self.random.below(20) {
                0 => String::new(),
                1..=10 => format!(" F{}", 1 + self.random.below(30)),
                _ => format!(" F[ABS[{}] + 0.71713]", expressions::value(&mut self.random)),
            };
            lines.push(match self.random.below(8) {
                0 => format!("G0{axes}"),
                1..=2 => {
                    format!("G17 G{} I{} J3.1{rate}", 2 + self.random.below(2), expressions::plain(&mut self.random))
                }
                3 => {
                    format!("G17 G3 I3 Z{} P{}{rate}", expressions::length(&mut self.random), 1 + self.random.below(3))
                }
                _ => format!("G1{axes}{rate}"),
            });
        }
        if self.percent(3) {
            lines.push("G17 G81 X1 Z[#5422 - 1] R#5422 F3".into());
        }
        if self.percent(20) {
            lines.push("(DEBUG,state #<_inverse_time> #<_units_per_minute>)".into());
        }
        lines.push("G94".into());
        lines.push(format!("F{}", 100 + self.random.below(400)));
        lines
    }

    /// Returns an arc in any plane, with the centre relative to the start or, after G90.1, in program coordinates.
    fn arc(&mut self) -> Vec<String> {
        let plane = self.random.below(3) as usize;
        let (word, [first, second, third], [i, j]) = PLANES[plane];
        let parameter = |axis: char| ["#5420", "#5421", "#5422"][axis as usize - 'X' as usize];
        let (here_first, here_second) = (parameter(first), parameter(second));
        let random = &mut self.random;
        let (a, b) = (expressions::length(random), expressions::plain(random));
        let turn = random.of(&["G2", "G3"]);
        let helix =
            if random.below(3) == 0 { format!(" {third}{}", expressions::length(random)) } else { String::new() };
        let helix = if random.below(5) == 0 { format!("{helix} A{}", expressions::length(random)) } else { helix };
        let turns = if random.below(4) == 0 { format!(" P[1 + {}]", random.below(3)) } else { String::new() };
        let arc = match random.below(6) {
            // A full circle.
            0..=1 => format!("{turn} {i}{a} {j}{b}{helix}{turns}"),
            // Half a circle. `#<_absolute>` is 1 in G90 and 0 in G91, so the same text gives the right end in both
            // modes.
            2..=3 => format!(
                "{turn} {first}[{here_first} * #<_absolute> + 2 * {a}] {second}[{here_second} * #<_absolute> + 2 * {b}]{helix} {i}{a} {j}{b}{turns}"
            ),
            4 => format!(
                "{turn} {first}[{here_first} * #<_absolute> + {b}]{helix} R{}[0.9 * {b}]",
                random.of(&["", "-"])
            ),
            _ => {
                let centre = format!("{i}[{here_first} + {a}] {j}[{here_second} + {b}]");
                let mut lines = vec![format!("{word} G90.1")];
                lines.push(format!("{turn} {centre}{helix}{turns}"));
                if random.below(3) == 0 {
                    lines.push(format!("(DEBUG,state #<_ijk_absolute_mode> {here_first})"));
                }
                if random.below(12) == 0 {
                    // After G90.1 both centre words are required.
                    lines.push(format!("{turn} {i}[{here_first} + {a}]"));
                }
                lines.push("G91.1".into());
                return lines;
            }
        };
        vec![format!("{word} {arc}")]
    }

    fn cycle(&mut self) -> Vec<String> {
        let random = &mut self.random;
        let word = random.of(&["G81", "G82", "G83", "G73", "G85", "G89"]);
        let extra = match word {
            "G82" | "G89" => " P[1 / 8]",
            "G83" | "G73" => " Q[1 + 0.31713]",
            _ => "",
        };
        let retract = random.of(&["G98 ", "G99 ", ""]);
        let (x, r, z) = (expressions::length(random), expressions::plain(random), expressions::plain(random));
        let times = random.of(&["", "", " L2", " L[1 + 2]"]);
        // Rarely, an A word is added. A cycle cannot have one, so Oxmill rejects such a line.
        let turn = if random.below(40) == 0 { " A#1" } else { "" };
        vec![
            "G17".into(),
            format!(
                "{retract}{word} X{x} R[#5422 * #<_absolute> + {r} - 20] Z[[#5422 + {r} - 20] * #<_absolute> - {z}]{extra}{times}{turn}"
            ),
            random.of(&["G80", "G80", "G1 X#5420", "G0 Z#5422"]).into(),
        ]
    }

    /// Returns G and M words whose numbers are computed.
    fn selectors(&mut self) -> String {
        let random = &mut self.random;
        match random.below(12) {
            0..=1 => "G[90 + #30 * 0]".into(),
            2..=3 => random.of(&["G91", "G90"]).into(),
            4 => format!("G[54 + {}]", random.below(3)),
            5 => "G[59 + 3 / 10]".into(),
            6 => random.of(&["M[7 + 1]", "M[2 * 4]", "M9", "M[10 - 1]"]).into(),
            7 => format!("S[100 + ABS[{}] MOD 900]", expressions::value(random)),
            8 => format!("M[{} + 1] S[#32 * #32 + 5]", random.of(&["2", "3", "4"])),
            9 => random.of(&["G61", "G64 P[0.1 + 0.02]", "G61.1", "G[60 + 1]"]).into(),
            10 => format!("T[1 + {}]", random.below(2)),
            _ => format!("F[ABS[{}] + 50]", expressions::value(random)),
        }
    }

    fn condition(&mut self, depth: u32) -> Vec<String> {
        let label = self.label();
        let mut lines = vec![format!("{label} if {}", expressions::condition(&mut self.random))];
        lines.extend(self.body(depth));
        for _ in 0..self.random.below(3) {
            lines.push(format!("{label} elseif {}", expressions::condition(&mut self.random)));
            lines.extend(self.body(depth));
        }
        if self.percent(50) {
            lines.push(format!("{label} else"));
            lines.extend(self.body(depth));
        }
        lines.push(format!("{label} endif"));
        lines
    }

    /// Returns a loop that counts its passes in a parameter of its own, so that it ends.
    fn repetition(&mut self, depth: u32) -> Vec<String> {
        let label = self.label();
        let counter = format!("#{}", 28 + depth);
        let most = 1 + self.random.below(4);
        let mut body = self.body(depth);
        let kind = match self.random.below(4) {
            2 if !self.has_do => 0,
            kind => kind,
        };
        if kind < 3 && self.percent(45) {
            let inner = self.label();
            let word = match kind {
                2 => "break",
                _ if self.has_do => "continue",
                _ => self.random.of(&["break", "continue"]),
            };
            let condition = format!("[{counter} EQ {}]", 1 + self.random.below(3));
            let cut = [format!("{inner} if {condition}"), format!("{label} {word}"), format!("{inner} endif")];
            body.splice(0..0, cut);
            let state = self.state();
            body.push(state);
        }
        let count = format!("{counter}=[{counter} + 1]");
        let more = match self.random.below(3) {
            0 => format!(" AND {}", expressions::condition(&mut self.random)),
            _ => String::new(),
        };
        let mut lines = vec![format!("{counter}=0")];
        match kind {
            0..=1 => {
                lines.extend([format!("{label} while [{counter} LT {most}{more}]"), count]);
                lines.extend(body);
                lines.push(format!("{label} endwhile"));
            }
            2 => {
                lines.extend([format!("{label} do"), count]);
                lines.extend(body);
                lines.push(format!("{label} while [{counter} LT {most}{more}]"));
            }
            _ => {
                let times = match self.random.below(4) {
                    0 => format!("[{most}]"),
                    1 => format!("[{most} - 2]"),
                    // Both interpreters round the count to the nearest integer, and a half to the even one.
                    2 => format!("[{}.{}]", self.random.below(4), 1 + self.random.below(9)),
                    _ => format!("[ABS[{}] MOD 4]", expressions::value(&mut self.random)),
                };
                lines.extend([format!("{label} repeat {times}"), count]);
                lines.extend(body);
                lines.push(format!("{label} endrepeat"));
            }
        }
        lines
    }

    fn arguments(&mut self) -> String {
        (0..self.random.below(4)).map(|_| format!(" [{}]", expressions::chain(&mut self.random, 1))).collect()
    }

    /// Returns a call of one of the subroutines, sometimes followed by a line that uses its result. Without a
    /// subroutine, returns a line that shows the state.
    fn call(&mut self) -> Vec<String> {
        if self.subroutines.is_empty() {
            return vec![self.state()];
        }
        let at = self.random.below(self.subroutines.len() as u64) as usize;
        let label = self.subroutines[at].clone();
        let mut lines = vec![format!("{label} call{}", self.arguments())];
        match self.random.below(3) {
            0 => lines.push("(DEBUG,state #<_value> #<_value_returned> #<_call_level> #1 #5 #<u>)".into()),
            1 => lines.push("#5=[#<_value> MOD 17.31713 + #<_value_returned>]".into()),
            _ => {}
        }
        lines
    }

    /// Adds a subroutine, possibly recursive, and a call of it to the program. Returns a line that shows the state.
    fn subroutine(&mut self) -> Vec<String> {
        let label = self.label();
        let mut lines = vec![format!("{label} sub"), OWN.into()];
        lines.extend(self.body(NESTED));
        if self.percent(40) {
            let inner = self.label();
            lines.push(format!("{inner} if {}", expressions::condition(&mut self.random)));
            let value = if self.percent(70) {
                format!(" [{}]", expressions::chain(&mut self.random, 1))
            } else {
                String::new()
            };
            lines.push(format!("{label} return{value}"));
            lines.push(format!("{inner} endif"));
            lines.extend(self.body(1));
        }
        let calls_itself = self.percent(20);
        if calls_itself {
            let inner = self.label();
            lines.extend([
                // Without the upper limits the recursion could be too deep, because the body can change #3.
                format!("{inner} if [#3 GT 0 AND #3 LT 4 AND #<_call_level> LT 4]"),
                format!("{label} call [#1 / 2] [#2 + #3] [#3 - 1]"),
                "#5=[#<_value> / 2 + #3]".into(),
                format!("{inner} endif"),
            ]);
        }
        let value = self.random.of(&["", "", " [#1 + #2]", " [#5 MOD 9.31713]", " [FIX[#1]]"]);
        lines.push(format!("{label} endsub{value}"));
        let last = if calls_itself { format!(" [{}]", self.random.below(4)) } else { String::new() };
        let arguments: String = (0..2).map(|_| format!(" [{}]", expressions::chain(&mut self.random, 1))).collect();
        lines.push(format!("{label} call{arguments}{last}"));
        lines.push("(DEBUG,state #<_value> #<_value_returned> #1 #2 #5 #<u> #<v> #<_g>)".into());
        if self.put(lines) {
            self.subroutines.push(label);
        }
        vec![self.state()]
    }

    /// Returns a change of units with a new F.
    fn units(&mut self) -> Vec<String> {
        let (unit, feed) = if self.percent(40) { ("G20", 5) } else { ("G21", 200) };
        vec!["G49".into(), unit.into(), format!("F{}", feed + self.random.below(200))]
    }

    fn offsets(&mut self) -> Vec<String> {
        let axes = self.axes();
        let system = self.random.of(&["P1", "P2", "P6", "P9", "P0", "P[1 + 1]"]);
        vec![match self.random.below(12) {
            0..=2 => format!("G10 L2 {system}{axes}"),
            3..=4 => format!("G10 L[4 * 5] {system}{axes}"),
            5..=6 => format!("G92{axes}"),
            7 => format!("G52{axes}"),
            8 => self.random.of(&["G92.1", "G92.2", "G92.3"]).into(),
            9 => self.random.of(&["G28.1", "G30.1"]).into(),
            _ => self.random.of(&["G28", "G30", "G90 G53 G0 X[1 + 0.31713]", "G90 G53 G1 Y#33"]).into(),
        }]
    }

    fn tools(&mut self) -> Vec<String> {
        let random = &mut self.random;
        let tool = 1 + random.below(2);
        let length = expressions::length(random);
        match random.below(8) {
            0..=1 => vec![format!("G10 L1 P[{tool}] Z{length}")],
            2..=3 => vec![format!("G43 H[{tool} + 0]"), "(DEBUG,state #5422 #<_abs_z> #<_tool_offset>)".into()],
            4 => vec![format!("G43.1 Z{length}")],
            5 => vec!["G49".into()],
            _ => {
                let (x, y, z) = (expressions::length(random), expressions::length(random), expressions::plain(random));
                vec![format!("G0 X{x} Y{y} Z{z}"), format!("#3={tool}"), "T#3 M[3 + 3] M3".into()]
            }
        }
    }

    fn stops(&mut self) -> Vec<String> {
        vec![self.random.of(&["M0", "M1", "M60", "M[0]", "M01"]).into()]
    }

    fn deleted(&mut self) -> Vec<String> {
        let mut lines = match self.random.below(3) {
            0 => vec![self.assignment()],
            1 => vec![self.motion()],
            _ => self.condition(1),
        };
        for line in &mut lines {
            line.insert(0, '/');
        }
        lines
    }

    /// Returns a statement with a line that should be rejected, sometimes within an `if` or a `repeat`.
    fn wrong(&mut self) -> Vec<String> {
        const ALONE: [&str; 22] = [
            "G0 X[1 / 0]",
            "#31=[1 / [#1 - #1]]",
            "G0 X#<nobody>",
            "#31=SQRT[-1]",
            "#31=LN[0]",
            "#31=ASIN[2]",
            "#31=ACOS[-1.5]",
            "#31=[[0 - 2.5] ** 0.5]",
            "#5420=1",
            "#0=1",
            "#31=#[0-1]",
            "G0 X[1 + 2",
            "G0 X1 + 2]",
            "G0 X[1 FOO 2]",
            "G0 X[]",
            "G0 X#",
            "#31=",
            "G[0.55] X1",
            "G4 P[0 - 1]",
            "M[3.5]",
            "o9999 endif",
            "o9999 endwhile",
        ];
        let within = self.random.of(&["", "", "if [1]", "repeat [2]"]);
        let line = match self.random.below(6) {
            0 => self.random.of(&["G18", "G19"]).into(),
            _ => self.random.of(&ALONE).to_owned(),
        };
        if line.starts_with("G1") && line.len() == 3 {
            return vec![line, "G5 X1 Y1 I1 J1 P1 Q1".into()];
        }
        if within.is_empty() || line.starts_with('o') {
            return vec![line];
        }
        let label = self.label();
        let end = if within.starts_with("if") { "endif" } else { "endrepeat" };
        vec![format!("{label} {within}"), self.motion(), line, format!("{label} {end}")]
    }
}
