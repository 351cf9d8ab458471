//! Formats lines as a post-processor does: motion words and coordinates are written only when they change.

use std::io::{Result, Write};

/// Axis letters in the order in which they are written.
const LETTERS: [char; 3] = ['X', 'Y', 'Z'];

/// Output of a program, with the modal state after the lines written so far.
pub struct Writer<'a> {
    out: &'a mut dyn Write,
    decimals: u32,
    numbering: Option<u32>,
    separator: &'static str,
    modal: &'static str,
    place: [Option<i64>; 3],
    feed: Option<i64>,
}

impl<'a> Writer<'a> {
    /// Returns a writer that writes coordinates with `decimals` decimal places. Its functions take coordinates as
    /// integers in units of the last place: with 3 decimals, 1500 is written as `1.5`.
    pub fn new(out: &'a mut dyn Write, decimals: u32) -> Self {
        Self { out, decimals, numbering: None, separator: " ", modal: "", place: [None; 3], feed: None }
    }

    /// Omits blanks between words.
    pub fn compact(mut self) -> Self {
        self.separator = "";
        self
    }

    /// Numbers lines N10, N20, ...
    pub fn numbered(mut self) -> Self {
        self.numbering = Some(10);
        self
    }

    /// Writes a line unchanged. Its effect on positions and motion words is unknown, so the next line writes
    /// coordinates and motion word in full.
    pub fn text(&mut self, line: &str) -> Result<()> {
        self.modal = "";
        self.place = [None; 3];
        self.line(line)
    }

    pub fn comment(&mut self, text: &str) -> Result<()> {
        self.line(&format!("({text})"))
    }

    /// Writes a straight move with the word `motion`, such as `G1`, to the given coordinates. Writes nothing if no
    /// coordinate changes. `feed`: in tenths of mm/min or inch/min.
    pub fn line_to(&mut self, motion: &'static str, to: [Option<i64>; 3], feed: Option<i64>) -> Result<()> {
        let mut words = self.motion_word(motion);
        let before = words.len();
        self.push_place(&mut words, to, false);
        if words.len() == before {
            return Ok(());
        }
        self.push_feed(&mut words, feed);
        self.modal = motion;
        self.line(&words.join(self.separator))
    }

    /// Writes an arc in the XY plane to the point `to`; with a Z it is a helix. `centre`: I and J, the centre relative
    /// to the start of the arc. `feed`: in tenths of mm/min or inch/min.
    pub fn arc_to(
        &mut self,
        motion: &'static str,
        to: [Option<i64>; 3],
        centre: [i64; 2],
        feed: Option<i64>,
    ) -> Result<()> {
        // Every arc line has its motion word, because some interpreters do not treat the motion word of an arc as
        // modal.
        let mut words = vec![motion.to_string()];
        self.push_place(&mut words, to, true);
        for (letter, value) in ['I', 'J'].into_iter().zip(centre) {
            words.push(format!("{letter}{}", decimal(value, self.decimals)));
        }
        self.push_feed(&mut words, feed);
        self.modal = motion;
        self.line(&words.join(self.separator))
    }

    fn motion_word(&self, motion: &'static str) -> Vec<String> {
        if self.modal == motion { Vec::new() } else { vec![motion.to_string()] }
    }

    fn push_place(&mut self, words: &mut Vec<String>, to: [Option<i64>; 3], repeat: bool) {
        for axis in 0..3 {
            let Some(value) = to[axis] else { continue };
            if repeat || self.place[axis] != Some(value) {
                words.push(format!("{}{}", LETTERS[axis], decimal(value, self.decimals)));
                self.place[axis] = Some(value);
            }
        }
    }

    fn push_feed(&mut self, words: &mut Vec<String>, feed: Option<i64>) {
        if feed.is_some() && feed != self.feed {
            words.push(format!("F{}", decimal(feed.unwrap_or(0), 1)));
            self.feed = feed;
        }
    }

    fn line(&mut self, text: &str) -> Result<()> {
        if let Some(number) = self.numbering.as_mut() {
            write!(self.out, "N{number}{}", self.separator)?;
            *number += 10;
        }
        writeln!(self.out, "{text}")
    }
}

/// Formats an integer as a number with `places` decimal places: with 3 places, 1500 becomes `1.5`. Removes trailing
/// zeros and keeps the point.
pub fn decimal(value: i64, places: u32) -> String {
    let one = 10_i64.pow(places);
    let sign = if value < 0 { "-" } else { "" };
    let digits = format!("{:0width$}", value.abs() % one, width = places as usize);
    format!("{sign}{}.{}", value.abs() / one, digits.trim_end_matches('0'))
}

/// Returns the integer nearest to the square root of `n`.
pub fn square_root(n: i64) -> i64 {
    let mut root = n.isqrt();
    // Rounded to nearest: (root + 1/2)² = root² + root + 1/4.
    if n - root * root > root {
        root += 1;
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn decimals_have_a_point_and_no_trailing_zeros() {
        assert_eq!(decimal(1_500, 3), "1.5");
        assert_eq!(decimal(-1, 3), "-0.001");
        assert_eq!(decimal(20_000, 4), "2.");
        assert_eq!(decimal(0, 3), "0.");
    }

    #[test]
    fn only_changed_words_are_written() {
        let mut text = Vec::new();
        let mut w = Writer::new(&mut text, 3);
        w.line_to("G1", [Some(1_000), Some(0), None], Some(6_000)).unwrap();
        w.line_to("G1", [Some(1_000), Some(500), None], Some(6_000)).unwrap();
        w.line_to("G1", [Some(1_000), Some(500), None], Some(6_000)).unwrap();
        assert_eq!(String::from_utf8(text).unwrap(), "G1 X1. Y0. F600.\nY0.5\n");
    }
}
