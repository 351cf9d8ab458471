//! Fanuc's modal calls: after `G66 P1001 A5`, each line that moves an axis is followed by a call of the subprogram with
//! these arguments, up to `G67` or the end of the program.
//!
//! ```text
//!  G66 P1001 A5 ──▶ [G65 P1001 A5] is kept
//!  X10          ──▶ X10, then the kept call          also in loops and in subprograms called by M98
//!  G67          ──▶ the call is forgotten
//! ```
//! The lines of the called subprogram do not trigger the call again. The arguments are plain numbers, so each call
//! gets the same values. A refused line ends the modal call, so that the machine does not drill at positions that the
//! program did not intend.

/// Maximum length of the stored call, in bytes.
const LONGEST: usize = 80;

/// The modal call of G66, or none.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct ModalCall {
    /// The call, as a line with G65; empty if there is none.
    line: heapless::Vec<u8, LONGEST>,
    /// Number of calls with arguments that were active when G66 was read. Only lines at this level trigger the modal
    /// call.
    level: u8,
    /// `true` if the call comes next, because the previous line moves an axis.
    is_due: bool,
}

impl ModalCall {
    #[inline]
    pub fn is_active(&self) -> bool {
        !self.line.is_empty()
    }

    /// Stores the call with the arguments of a G66 at this level of calls. If the arguments are too long, stores no
    /// call and returns `false`.
    pub fn begin(&mut self, arguments: &[u8], level: u8) -> bool {
        self.end();
        self.level = level;
        let kept = [b"G65", arguments].iter().try_for_each(|part| self.line.extend_from_slice(part)).is_ok();
        if !kept {
            self.end();
        }
        kept
    }

    /// Returns the call, as a line with G65, if it is due, and clears `is_due`; `None` if no call is due.
    pub fn take_due(&mut self) -> Option<heapless::Vec<u8, LONGEST>> {
        core::mem::take(&mut self.is_due).then(|| self.line.clone())
    }

    pub fn level(&self) -> u8 {
        self.level
    }

    /// Forgets the stored call, even if it is due.
    pub fn end(&mut self) {
        self.line.clear();
        self.is_due = false;
    }

    /// Examines each line before it runs. `level`: the present level of calls. Ends the modal call if the line has
    /// G67, or if `level` is lower than at the G66. If the line moves an axis, the call becomes due and runs after the
    /// line.
    #[inline(never)]
    pub fn look_at(&mut self, line: &[u8], level: u8) {
        if level < self.level || level == self.level && has_g_word(line, &[670]) {
            self.end();
        }
        self.is_due = self.is_active() && level == self.level && moves(line);
    }
}

/// Returns whether a line moves an axis. Such a line has an axis word or the centre of an arc, and no G word that
/// gives these words another meaning, as G92 does.
fn moves(line: &[u8]) -> bool {
    words(line).any(|(letter, _)| matches!(letter, b'X' | b'Y' | b'Z' | b'A' | b'I' | b'J' | b'K'))
        && !has_g_word(line, &[40, 100, 431, 510, 520, 650, 660, 680, 920])
}

/// Returns whether a line has one of these G words, in tenths: 431 is G43.1.
fn has_g_word(line: &[u8], tenths: &[u32]) -> bool {
    words(line).any(|(letter, rest)| {
        let (whole, fraction) = rest.split_at(rest.iter().take_while(|byte| byte.is_ascii_digit()).count());
        let tenth =
            fraction.strip_prefix(b".").and_then(|digits| digits.first()).filter(|digit| digit.is_ascii_digit());
        let digits = whole.iter().chain([tenth.unwrap_or(&b'0')]);
        let number =
            digits.fold(0_u32, |number, digit| number.saturating_mul(10).saturating_add(u32::from(digit - b'0')));
        letter == b'G' && !whole.is_empty() && tenths.contains(&number)
    })
}

/// Returns the words of a line outside brackets and names: for each word its letter, and the text after the letter.
fn words(line: &[u8]) -> impl Iterator<Item = (u8, &[u8])> {
    let (mut depth, mut before) = (0_usize, b' ');
    line.iter().enumerate().filter_map(move |(at, byte)| {
        match byte {
            b'[' | b'<' => depth += 1,
            b']' | b'>' => depth = depth.saturating_sub(1),
            _ => {}
        }
        // A letter that follows a letter, a sign or `=` begins no word: it belongs to the name of a function.
        let is_within = before.is_ascii_uppercase() || matches!(before, b'=' | b'+' | b'-');
        let begins = depth == 0 && byte.is_ascii_uppercase() && !is_within;
        before = *byte;
        begins.then(|| (*byte, line.get(at + 1..).unwrap_or_default()))
    })
}

#[cfg(test)]
mod tests {
    use super::{has_g_word, moves};

    #[test]
    fn lines_that_move_an_axis() {
        for line in
            ["X10", "G1Y2F100", "G2I5", "G0X[#1+2]", "XSIN[30]", "X-ABS[#1]", "N10G91Z-1", "G43H1Z5", "G81X1Y2Z-3R1"]
        {
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
        assert!(has_g_word(b"G40G067G80", &[670]) && !has_g_word(b"G6.7", &[670]) && !has_g_word(b"G[67]", &[670]));
    }
}
