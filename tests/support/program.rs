//! Generates programs of any length for long runs: lines of every kind, and the position in steps after them.

use crate::Random;
use std::collections::VecDeque;
use std::fmt::Write;

/// Number of axes that the programs move: X, Y and Z.
pub const AXES: usize = 3;
/// Settings of the machine. A step is 0.004 mm, so three decimals can specify every step.
pub const SETTINGS: [&str; 11] = [
    "$100=250",
    "$101=250",
    "$102=250",
    "$110=6000",
    "$111=5000",
    "$112=3000",
    "$120=900",
    "$121=700",
    "$122=500",
    "$24=300",
    "$25=2000",
];
/// Steps/mm of each axis after [`SETTINGS`].
pub const STEPS_PER_MM: f64 = 250.0;
/// Maximum distance of positions from the origin, in steps.
const REACH: i64 = 2_500;

/// State of a program: the position in steps, and the modal state that the next line depends on.
#[derive(Clone)]
pub struct Program {
    /// Position in steps from the origin.
    pub place: [i64; AXES],
    /// `true` while G91 (relative positions) is active, `false` while G90 is.
    pub relative: bool,
}

impl Program {
    /// Chooses a target in the axes of a bit mask (bit 0: X), moves `place` there, and returns the words for it.
    fn target(&mut self, random: &mut Random, axes: u64) -> String {
        let mut words = String::new();
        for (axis, letter) in ['X', 'Y', 'Z'].into_iter().enumerate() {
            if axes >> axis & 1 == 0 {
                continue;
            }
            let farthest = [4, 40, 400, 1_200][random.below(4) as usize];
            let by = random.below(2 * farthest + 1) as i64 - farthest as i64;
            let to = (self.place[axis] + by).clamp(-REACH, REACH);
            let steps = if self.relative { to - self.place[axis] } else { to };
            self.place[axis] = to;
            // A position in whole steps needs exactly three decimals.
            let _ = write!(words, "{letter}{}{}.{:03}", sign(steps), steps.abs() * 4 / 1000, steps.abs() * 4 % 1000);
        }
        words
    }

    /// Appends a random line, or several lines that belong together, such as a loop. Appends nothing if the choice is a
    /// drilling cycle while G91 is active.
    pub fn lines(&mut self, random: &mut Random, lines: &mut VecDeque<String>) {
        let axes = 1 + random.below(7);
        match random.below(20) {
            0 => {
                self.relative = !self.relative;
                lines.push_back(if self.relative { "G91".into() } else { "G90".into() });
            }
            1..=4 => lines.push_back(format!("G0 {}", self.target(random, axes))),
            5..=11 => {
                let feed = 200 + random.below(5_000);
                lines.push_back(format!("G1 {} F{feed}", self.target(random, axes)));
            }
            12 | 13 => {
                // A full circle, which ends where it starts.
                let sense = 2 + random.below(2);
                lines.push_back(format!("G17 G{sense} I0.{} J-0.{} F3000", 1 + random.below(9), random.below(9)));
            }
            14 => {
                lines.push_back(random.of(&["M3 S500", "M5", "M8", "M9", "(a remark)", "G4 P0.01", "", "F900"]).into())
            }
            15 => {
                lines.push_back("G1 F2400".into());
                for _ in 0..5 + random.below(20) {
                    lines.push_back(self.target(random, axes));
                }
            }
            16 => {
                // A loop; its step is chosen so that all passes stay within the range.
                let turns = 1 + random.below(4);
                let by = random.below(9) as i64 - 4;
                let mode = if self.relative { "G91" } else { "G90" };
                let to = (self.place[0] + by * turns as i64).clamp(-REACH, REACH);
                let by = (to - self.place[0]) / turns as i64;
                self.place[0] += by * turns as i64;
                let mm = format!("{}0.{:03}", sign(by), by.abs() * 4);
                for line in [format!("#1={turns}"), "O1 WHILE [#1 GT 0]".into(), format!("G91 G1 X{mm} F1500")] {
                    lines.push_back(line);
                }
                for line in ["#1=[#1-1]", "O1 ENDWHILE", mode] {
                    lines.push_back(line.into());
                }
            }
            17 => {
                // A drilling cycle. After it, only X and Y have changed.
                if self.relative {
                    return;
                }
                let words = self.target(random, 3);
                let z = self.place[2];
                let mm =
                    |steps: i64| format!("{}{}.{:03}", sign(steps), steps.abs() * 4 / 1000, steps.abs() * 4 % 1000);
                lines.push_back(format!("G98 G81 {words} Z{} R{} F2000", mm(z - 50), mm(z)));
                lines.push_back("G80".into());
            }
            _ => {
                let axis = 1 << random.below(3);
                lines.push_back(format!("G1 {} F1800", self.target(random, axis)));
            }
        }
    }
}

fn sign(steps: i64) -> &'static str {
    if steps < 0 { "-" } else { "" }
}
