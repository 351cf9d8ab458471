//! Fanuc's modal calls: from `G66 P1001 A5` on, each line that moves an axis is followed by a call of the subprogram with
//! these arguments, up to `G67` or the end of the program.
//!
//! ```text
//!  G66 P1001 A5 ──▶ [G65 P1001 A5] is kept
//!  X10          ──▶ X10, then the kept call          also in loops and in subprograms called by M98
//!  G67          ──▶ the call is forgotten
//! ```
//! Guarantees: the lines of the called subprogram call nothing. The arguments are plain numbers, so each call gets the
//! same ones. A refused line in running text ends the modal call, so that the machine does not drill where the program
//! did not mean to.

/// Maximum length of the kept call.
const LONGEST: usize = 80;

/// A modal call.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ModalCall {
    /// The call, as a line with G65; empty if there is none.
    line: heapless::Vec<u8, LONGEST>,
    /// Number of active calls with arguments where G66 was read. Lines at other levels call nothing.
    level: u8,
    /// The call comes next, because the line before it has moved an axis.
    is_due: bool,
}

impl ModalCall {
    /// Whether there is a modal call.
    #[inline]
    pub fn is_active(&self) -> bool {
        !self.line.is_empty()
    }

    /// Keeps a call with these arguments of G66, made at a level of calls. Returns whether it fits.
    pub fn begin(&mut self, arguments: &[u8], level: u8) -> bool {
        self.end();
        self.level = level;
        let kept = [b"G65", arguments].iter().try_for_each(|part| self.line.extend_from_slice(part)).is_ok();
        if !kept {
            self.end();
        }
        kept
    }

    /// Returns the call, if it comes next. It comes only once.
    pub fn take_due(&mut self) -> Option<heapless::Vec<u8, LONGEST>> {
        core::mem::take(&mut self.is_due).then(|| self.line.clone())
    }

    /// Forgets the call.
    pub fn end(&mut self) {
        self.line.clear();
        self.is_due = false;
    }

    /// Takes note of a line that comes next, at a level of calls.
    #[inline(never)]
    pub fn look_at(&mut self, line: &[u8], level: u8) {
        if level < self.level || level == self.level && has_g_word(line, &[67]) {
            self.end();
        }
        self.is_due = self.is_active() && level == self.level && moves(line);
    }
}

/// Whether a line moves an axis: it has an axis word or the centre of an arc, and no word that gives these another
/// meaning.
fn moves(line: &[u8]) -> bool {
    words(line).any(|(letter, _)| matches!(letter, b'X' | b'Y' | b'Z' | b'A' | b'I' | b'J' | b'K'))
        && !has_g_word(line, &[4, 10, 51, 52, 65, 66, 68, 92])
}

/// Whether a line has a G word with one of these whole numbers, with or without a fraction.
fn has_g_word(line: &[u8], numbers: &[u32]) -> bool {
    words(line).any(|(letter, rest)| {
        let digits = rest.iter().take_while(|byte| byte.is_ascii_digit());
        let number =
            digits.fold(0_u32, |number, digit| number.saturating_mul(10).saturating_add(u32::from(digit - b'0')));
        letter == b'G' && rest.first().is_some_and(u8::is_ascii_digit) && numbers.contains(&number)
    })
}

/// Returns the words of a line that are in no bracket and no name: the letter, and the text after it.
fn words(line: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let (mut depth, mut before) = (0_usize, b' ');
    line.iter().enumerate().filter_map(move |(at, byte)| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        // Letters after a letter are those of a function.
        let begins = depth == 0 && byte.is_ascii_uppercase() && !before.is_ascii_uppercase();
        before = *byte;
        begins.then(|| (*byte, line.get(at + 1..).unwrap_or_default()))
    })
}

#[cfg(test)]
mod tests {
    use super::{has_g_word, moves};

    #[test]
    fn lines_that_move_an_axis() {
        for line in ["X10", "G1Y2F100", "G2I5", "G0X[#1+2]", "XSIN[30]", "N10G91Z-1", "G81X1Y2Z-3R1"] {
            assert!(moves(line.as_bytes()), "{line}");
        }
        for line in [
            "",
            "M3S1000",
            "G4X1",
            "G10L2P1X0",
            "G92X0",
            "G52X5",
            "F[X1]",
            "#<X>=5",
            "FSIN[30]",
            "G65P1X5",
            "G68X1Y1R30",
        ] {
            assert!(!moves(line.as_bytes()), "{line}");
        }
        assert!(has_g_word(b"G40G067G80", &[67]) && !has_g_word(b"G6.7", &[67]) && !has_g_word(b"G[67]", &[67]));
    }
}
