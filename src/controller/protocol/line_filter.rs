//! Filters a line byte by byte as Grbl does: removes blanks and comments, converts letters to capitals, and ends the
//! line at CR or LF. Keeps the line's last comment in parentheses, which can be a message: `(MSG, ...)`. Marks a line
//! that is too long.

use crate::image::FULL_IMAGE;

/// This byte replaces the text of a line in which a nested comment has not ended, because it is unknown which text
/// should be executed. A line of only this byte is an error in every dialect.
pub const OPEN_COMMENT: u8 = b')';
/// Maximum length of a line in Grbl's dialect, in bytes, without blanks and comments.
pub const GRBL_LENGTH: usize = 79;
/// Maximum length of a line in Oxmill's dialects, in bytes, without blanks and comments.
pub const LENGTH: usize = 256;

/// Maximum number of bytes kept of a comment in parentheses, including its keyword (`MSG,`). Excess bytes are cut off.
pub const MESSAGE_LENGTH: usize = 80;

/// Maximum number of bytes kept of a line that block delete skips: enough for a line number and an O number, or for
/// M30.
const DELETED_LENGTH: u8 = 40;

/// Whether this build reports by how many bytes a line is too long.
const COUNTS_EXCESS: bool = cfg!(feature = "reasons");

/// What a byte completed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pushed {
    /// No line yet: more bytes must follow.
    More,
    /// A line: see [`Line::text`].
    Complete,
    /// A line that was too long or damaged; its text is invalid.
    TooLong,
}

/// How lines are filtered in a dialect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct LineRules {
    /// Maximum length of a line, in bytes, without blanks and comments.
    pub length: usize,
    /// Whether CR LF is one line end (in Grbl it is two).
    pub merge_crlf: bool,
    /// Whether a comment may contain pairs of parentheses (in Grbl the first `)` ends it).
    pub nested_comments: bool,
    /// Whether a slash after a bracket or `#` is kept, because it is a division or an error there. If the slash were
    /// dropped, `[1/2]` would become `[12]`.
    pub expressions: bool,
    /// Whether lines are skipped that begin with a slash, or with a line number and a slash. A slash elsewhere is
    /// then kept, and is an error. (In Grbl a slash is dropped, and the rest of the line is executed.)
    pub block_delete: bool,
}

/// A line being received.
#[derive(Clone, Debug)]
pub struct Line {
    /// The text: the first `len` bytes are valid. This is no `Vec`, because a `Vec` would write its length to memory
    /// for each byte.
    text: [u8; LENGTH],
    len: usize,
    comment: Comment,
    /// The latest comment in parentheses, as far as it fits.
    comment_text: heapless::Vec<u8, MESSAGE_LENGTH>,
    overflow: bool,
    /// Number of bytes that did not fit; takes no memory in builds that do not report it.
    excess: [u16; COUNTS_EXCESS as usize],
    /// A comment of the line contained parentheses.
    nested: bool,
    /// Bytes of the line were lost.
    damaged: bool,
    after_cr: bool,
    /// The fast path ([`Line::push_plain`]) is allowed while the line is shorter than this; 0 disables it.
    plain: u8,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Comment {
    None,
    /// In a comment in parentheses. The number counts the inner `(` that are still open: each of them needs its own `)`
    /// before another `)` can end the comment.
    Parentheses(u8),
    /// As `Parentheses`, but at least one inner pair of parentheses has been closed.
    Nested(u8),
    /// In a comment after `;`, up to the end of the line.
    Semicolon,
    /// After a dropped slash. If the number of a block-delete switch (1 to 9) follows, it is dropped, too.
    Slash,
    /// A line that is skipped. This many of its first bytes are kept in place of the text.
    Deleted(u8),
}

impl Default for Line {
    fn default() -> Self {
        Self::new()
    }
}

/// The text for each byte that the fast path can take: digits, letters (as capitals), points, minus signs and blanks.
/// 0 for all other bytes.
#[allow(clippy::indexing_slicing, reason = "the compiler computes it")]
const PLAIN: [u8; 256] = {
    let mut plain = [0; 256];
    let mut byte = 0_u8;
    while byte < 128 {
        if byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b' ') {
            plain[byte as usize] = byte.to_ascii_uppercase();
        }
        byte += 1;
    }
    plain
};

impl Line {
    /// Creates an empty line.
    pub const fn new() -> Self {
        Self {
            text: [0; LENGTH],
            len: 0,
            comment: Comment::None,
            comment_text: heapless::Vec::new(),
            overflow: false,
            excess: [0; COUNTS_EXCESS as usize],
            nested: false,
            damaged: false,
            after_cr: false,
            plain: 0,
        }
    }

    /// Returns the text received so far: in capitals, without blanks and comments.
    pub fn text(&self) -> &[u8] {
        self.text.get(..self.len).unwrap_or_default()
    }

    /// Returns the first words of a line that block delete skips. Empty for any other line, and in the small firmware
    /// image.
    pub fn deleted(&self) -> &[u8] {
        let Comment::Deleted(kept) = self.comment else { return &[] };
        match self.text.get(..usize::from(kept)).unwrap_or_default() {
            // Leave out the number of the block-delete switch.
            [b'1'..=b'9', words @ ..] => words,
            words => words,
        }
    }

    /// Returns the message for the operator in the line's comment, if any. The `bool` is `true` if the message shows
    /// values of parameters: for `(PRINT, ...)` and `(DEBUG, ...)`, but not for `(MSG, ...)`.
    pub fn message(&self) -> Option<(bool, &[u8])> {
        let comma = self.comment_text.iter().position(|byte| *byte == b',')?;
        let (word, text) = self.comment_text.split_at_checked(comma)?;
        let words = [(b"MSG".as_slice(), false), (b"PRINT", true), (b"DEBUG", true)];
        let (_, has_values) = words.iter().find(|(says, _)| word.trim_ascii().eq_ignore_ascii_case(says))?;
        Some((*has_values, text.get(1..)?.trim_ascii()))
    }

    /// Returns whether nothing of the line has arrived yet. Blanks do not count as a part of the line. Comments, lost
    /// bytes and bytes beyond the maximum length count.
    pub fn is_empty(&self) -> bool {
        self.len == 0 && self.comment == Comment::None && !self.overflow
    }

    /// Discards the line: the next byte begins a new one.
    pub fn clear(&mut self) {
        self.len = 0;
        self.comment_text.clear();
        self.comment = Comment::None;
        self.overflow = false;
        self.nested = false;
        self.damaged = false;
    }

    /// Enables the fast path for text if `plain` is `true` and the line already has text. Disables it otherwise. Call
    /// it after each [`Line::push`], and when the fast path must be disabled.
    #[inline]
    pub fn expect_plain(&mut self, plain: bool) {
        self.expect_line(plain && self.len > 0);
    }

    /// Like [`Line::expect_plain`], but can also enable the fast path for a line that has no text yet.
    #[inline]
    pub fn expect_line(&mut self, plain: bool) {
        let in_text = plain && self.comment == Comment::None && !self.after_cr;
        self.plain = if in_text { GRBL_LENGTH as u8 } else { 0 };
    }

    /// Returns whether the fast path is enabled and an LF would complete the line.
    #[inline]
    pub fn ends_plain(&self) -> bool {
        self.plain > 0 && !self.overflow
    }

    /// Returns whether a comment of the line contained parentheses.
    pub fn has_nested_comment(&self) -> bool {
        self.nested
    }

    /// Returns whether the line cannot contain a message, because its latest comment in parentheses is empty or
    /// missing.
    #[inline]
    pub fn has_no_comment(&self) -> bool {
        self.comment_text.is_empty()
    }

    /// Marks the line as damaged by lost bytes: it will not be executed. Returns whether this is the first loss in the
    /// line.
    pub fn damage(&mut self) -> bool {
        self.overflow = true;
        // After the loss, an LF can belong to another line than the CR before it.
        self.after_cr = false;
        !core::mem::replace(&mut self.damaged, true)
    }

    /// Records that something other than text, such as a reset, came after the most recent line end. If that line end
    /// was a CR, an LF that arrives next is then not the second half of a CR LF.
    pub fn separate(&mut self) {
        self.after_cr = false;
    }

    /// Fast path of [`Line::push`] for an ordinary byte, if [`Line::expect_line`] allows it. Returns whether the byte
    /// was taken.
    #[inline]
    pub fn push_plain(&mut self, byte: u8) -> bool {
        self.push_plain_text(&[byte]) > 0
    }

    /// Like `push_plain` for several bytes, from the front. Returns how many were taken.
    #[inline]
    pub fn push_plain_text(&mut self, bytes: &[u8]) -> usize {
        let most = usize::from(self.plain);
        let mut len = self.len;
        let mut taken = 0;
        for byte in bytes {
            match PLAIN.get(usize::from(*byte)) {
                Some(text @ b'!'..) if len < most => {
                    if let Some(place) = self.text.get_mut(len) {
                        *place = *text;
                    }
                    len += 1;
                }
                // Blanks count as taken, but are not stored.
                Some(b' ') if most > 0 => {}
                _ => break,
            }
            taken += 1;
        }
        self.len = len;
        taken
    }

    /// Takes the next byte. `rules` is called only for the few bytes whose treatment depends on the rules. After
    /// `Complete` or `TooLong` the caller reads the text and then calls [`Line::clear`].
    #[inline]
    pub fn push(&mut self, byte: u8, rules: impl Fn() -> LineRules) -> Pushed {
        let second_of_crlf = byte == b'\n' && self.after_cr && rules().merge_crlf;
        self.after_cr = byte == b'\r';
        if self.comment == Comment::Slash && byte > b' ' {
            self.comment = Comment::None;
            if matches!(byte, b'1'..=b'9') {
                return Pushed::More;
            }
        }
        match byte {
            b'\n' if second_of_crlf => return Pushed::More,
            b'\n' | b'\r' => {
                if matches!(self.comment, Comment::Nested(_)) {
                    self.refuse_comment();
                }
                return if self.overflow { Pushed::TooLong } else { Pushed::Complete };
            }
            _ if self.comment != Comment::None => self.push_comment(byte, rules()),
            b'(' => {
                self.comment = Comment::Parentheses(0);
                self.comment_text.clear();
            }
            b';' => self.comment = Comment::Semicolon,
            0..=b' ' => {}
            b'/' if self.drops_slash(&rules()) => {}
            _ => {
                let full = self.len >= GRBL_LENGTH && self.len >= rules().length;
                match self.text.get_mut(self.len) {
                    Some(place) if !full => {
                        *place = byte.to_ascii_uppercase();
                        self.len += 1;
                    }
                    _ if COUNTS_EXCESS => self.overflows(),
                    _ => self.overflow = true,
                }
            }
        }
        Pushed::More
    }

    #[cold]
    fn overflows(&mut self) {
        let before = if self.overflow { self.excess } else { [0; COUNTS_EXCESS as usize] };
        self.excess = before.map(|excess| excess.saturating_add(1));
        self.overflow = true;
    }

    /// Returns two lengths for a line that is too long: its own, without blanks and comments, and the allowed one.
    /// `None` if bytes of the line were lost, or if this build does not count the excess.
    pub fn lengths(&self) -> Option<(usize, usize)> {
        let excess = self.excess.first().filter(|_| !self.damaged)?;
        Some((self.len + usize::from(*excess), self.len))
    }

    /// Returns whether a slash is dropped. If the slash begins the line and block delete is on, the rest of the line
    /// is skipped, too. In Grbl only the slash is dropped.
    #[inline(never)]
    fn drops_slash(&mut self, rules: &LineRules) -> bool {
        let begins = match self.text().split_first() {
            None => true,
            Some((first, number)) => *first == b'N' && number.iter().all(u8::is_ascii_digit),
        };
        if begins && rules.block_delete {
            self.len = 0;
            self.comment = if FULL_IMAGE { Comment::Deleted(0) } else { Comment::Semicolon };
        } else if begins && rules.expressions {
            self.comment = Comment::Slash;
        }
        let divides = rules.expressions && self.text().iter().any(|byte| matches!(byte, b'[' | b'#'));
        begins || !divides && !rules.block_delete
    }

    /// Invalidates a line whose nested comment has not ended: it is unknown where the comment should end and which
    /// text should be executed. Replaces the text by [`OPEN_COMMENT`], which is an error in every dialect.
    #[inline(never)]
    fn refuse_comment(&mut self) {
        if let Some(place) = self.text.first_mut() {
            *place = OPEN_COMMENT;
            self.len = 1;
        }
    }

    /// Takes a byte within a comment or within a line that is skipped. A comment with more than 255 open parentheses
    /// ends too soon.
    fn push_comment(&mut self, byte: u8, rules: LineRules) {
        if FULL_IMAGE && let Comment::Deleted(kept) = &mut self.comment {
            if byte > b' '
                && *kept < DELETED_LENGTH
                && let Some(place) = self.text.get_mut(usize::from(*kept))
            {
                *place = byte.to_ascii_uppercase();
                *kept += 1;
            }
            return;
        }
        let ends = byte == b')' && matches!(self.comment, Comment::Parentheses(0) | Comment::Nested(0));
        if !ends && self.comment != Comment::Semicolon {
            // Excess bytes are dropped.
            let _ = self.comment_text.push(byte);
        }
        self.comment = match (self.comment, byte) {
            (Comment::Parentheses(depth), b'(') if rules.nested_comments => {
                Comment::Parentheses(depth.saturating_add(1))
            }
            (Comment::Nested(depth), b'(') => Comment::Nested(depth.saturating_add(1)),
            (Comment::Parentheses(0) | Comment::Nested(0), b')') => Comment::None,
            (Comment::Parentheses(depth) | Comment::Nested(depth), b')') => {
                self.nested = true;
                Comment::Nested(depth - 1)
            }
            (comment, _) => comment,
        };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const OXMILL: LineRules =
        LineRules { length: LENGTH, merge_crlf: true, nested_comments: false, expressions: true, block_delete: false };
    const GRBL: LineRules = LineRules {
        length: GRBL_LENGTH,
        merge_crlf: false,
        nested_comments: false,
        expressions: false,
        block_delete: false,
    };
    const SEED: LineRules = LineRules { nested_comments: true, ..OXMILL };

    fn lines(bytes: &[u8], rules: LineRules) -> Vec<String> {
        let mut line = Line::new();
        let mut all = Vec::new();
        for byte in bytes {
            match line.push(*byte, || rules) {
                Pushed::More => continue,
                Pushed::Complete => all.push(String::from_utf8(line.text().to_vec()).unwrap()),
                Pushed::TooLong => all.push("too long".into()),
            }
            line.clear();
        }
        all
    }

    #[test]
    fn blanks_comments_and_slashes_vanish() {
        assert_eq!(lines(b" g0 (in) x0 (a(b) ;y\n", OXMILL), ["G0X0"]);
        assert_eq!(lines(b"G0X0(;)Y0\nG0X0;(Y1\n/G0\nG0 (open X5\n", OXMILL), ["G0X0Y0", "G0X0", "G0", "G0"]);
        assert_eq!(lines(b"(a(b)c) G0\n", OXMILL), ["C)G0"]);
        assert_eq!(lines(b"(a(b)c) G0\n((G1\nG2 ;(\nX(()))Y\n", SEED), ["G0", "", "G2", "X)Y"]);
    }

    #[test]
    fn a_comment_within_a_comment_has_to_end() {
        let text = b"(a (b) G1\n(a) G0\n(a (b) (c) G1\n(a (b)) G2\nG1 (a (b)\r(a G1\n(a (b) ; c) G3\n(a (b) G1\r\nG4\n";
        assert_eq!(lines(text, SEED), [")", "G0", ")", "G2", ")", "", "G3", ")", "G4"]);
        assert_eq!(lines(b"(a (b) G1\n(a (b)) G2\n", OXMILL), ["G1", ")G2"]);
        let mut line = Line::new();
        for byte in b"(MSG, flat (end) mill) G0" {
            line.push(*byte, || SEED);
        }
        assert_eq!(line.message(), Some((false, b"flat (end) mill".as_slice())));
        assert!(line.has_nested_comment());
    }

    #[test]
    fn a_byte_that_is_taken_in_brief_is_taken_as_always() {
        for byte in 0..=u8::MAX {
            let mut line = Line::new();
            line.push(b'G', || OXMILL);
            let mut other = line.clone();
            line.expect_plain(true);
            let taken = line.push_plain(byte);
            assert_eq!(taken, byte.is_ascii_alphanumeric() || matches!(byte, b'.' | b'-' | b' '), "{byte}");
            if taken {
                assert_eq!(other.push(byte, || OXMILL), Pushed::More);
                assert_eq!((line.text(), line.comment, line.after_cr), (other.text(), other.comment, other.after_cr));
            }
        }
        // The fast path is not taken in a comment, before a line has begun, or where the line might become too long.
        let brief = |text: &[u8]| {
            let mut line = Line::new();
            for byte in text {
                line.push(*byte, || OXMILL);
            }
            line.expect_plain(true);
            line.push_plain(b'1')
        };
        assert!(!brief(b"") && !brief(b"G(") && !brief(b"G;") && brief(b"G"));
        assert!(brief(&[b'0'; 78]) && !brief(&[b'0'; 79]));
    }

    #[test]
    fn a_slash_behind_a_bracket_divides() {
        assert_eq!(lines(b"/x[1/2]\n/G0 /X1\n#1=4/2\n", OXMILL), ["X[1/2]", "G0X1", "#1=4/2"]);
        assert_eq!(lines(b"x[1/2]\n", GRBL), ["X[12]"]);
    }

    #[test]
    fn block_delete() {
        let delete = LineRules { block_delete: true, ..OXMILL };
        assert_eq!(lines(b"/G0 X1\n / N5 G0 X1\nG0 /X1\n(a) /G1\n", delete), ["", "", "G0/X1", ""]);
        assert_eq!(
            lines(b"N5 /G0 X1\nN5/2 X1\n/1\nG0\nN5G0/X1\nX[1/2]\n", delete),
            ["", "", "", "G0", "N5G0/X1", "X[1/2]"]
        );
        assert_eq!(
            lines(b"/G0 X1\n/9G0X1\n/ 2 G0\nN5 /3G0\n/0\n/12\n/\n1\n", OXMILL),
            ["G0X1", "G0X1", "G0", "N5G0", "0", "2", "", "1",]
        );
        assert_eq!(lines(b"/(3) 1\n/1(;)G0\n//1G0\nG0/1\n", OXMILL), ["1", "G0", "G0", "G01"]);
        assert_eq!(lines(b"/2G0\nN5/2X1\n", GRBL), ["2G0", "N52X1"]);
    }

    #[cfg(feature = "full")]
    #[test]
    fn the_first_words_of_a_deleted_line_are_kept() {
        let deleted = |text: &[u8]| {
            let mut line = Line::new();
            for byte in text {
                line.push(*byte, || LineRules { block_delete: true, ..OXMILL });
            }
            assert!(line.text().is_empty() || line.deleted().is_empty());
            String::from_utf8(line.deleted().to_vec()).unwrap()
        };
        for (text, words) in [
            (&b"/o1001 (A)"[..], "O1001(A)"),
            (b"/2 N5 O1", "N5O1"),
            (b"N5 / :7", ":7"),
            (b"/", ""),
            (b"O1001", ""),
            (b"; /O1001", ""),
        ] {
            assert_eq!(deleted(text), words);
        }
        assert_eq!(deleted(&[b'/'; 300]).len(), usize::from(DELETED_LENGTH));
    }

    #[test]
    fn messages() {
        let message = |text: &[u8]| {
            let mut line = Line::new();
            for byte in text {
                line.push(*byte, || OXMILL);
            }
            line.message().map(|(values, text)| (values, String::from_utf8(text.to_vec()).unwrap()))
        };
        assert_eq!(message(b"G0 (MSG, Insert the 3 mm tool) X1"), Some((false, "Insert the 3 mm tool".into())));
        assert_eq!(message(b"(print,a,b)"), Some((true, "a,b".into())));
        assert_eq!(message(b"( Debug , c )"), Some((true, "c".into())));
        assert_eq!(message(b"(MSG, a) (a remark)"), None);
        assert_eq!(message(b"(a, MSG b)"), None);
        assert_eq!(message(b"G1 ;MSG,a"), None);
        assert_eq!(message(&[b"(MSG,".as_slice(), &[b'x'; 200]].concat()).unwrap().1.len(), MESSAGE_LENGTH - 4);
        let mut line = Line::new();
        for byte in b"(MSG,a)" {
            line.push(*byte, || OXMILL);
        }
        line.clear();
        assert_eq!(line.message(), None);
    }

    #[test]
    fn line_ends_by_dialect() {
        assert_eq!(lines(b"G21\r\nG90\rG94\n\n", OXMILL), ["G21", "G90", "G94", ""]);
        assert_eq!(lines(b"G21\r\nG90\n", GRBL), ["G21", "", "G90"]);
    }

    #[test]
    fn length_is_counted_after_filtering() {
        let fits = [b"N".as_slice(), &[b'0'; 78], b" (comment)\n"].concat();
        assert_eq!(lines(&fits, GRBL)[0].len(), 79);
        let long = [b"N".as_slice(), &[b'0'; 79], b"\nG0\n"].concat();
        assert_eq!(lines(&long, GRBL), ["too long", "G0"]);
        assert_eq!(lines(&long, OXMILL)[0].len(), 80);
    }
}
