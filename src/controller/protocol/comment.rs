//! `CommentTracker`: tracks whether a received line is within a comment, `(..)` or `; ..`, and assembles the UTF-8
//! characters of the comment. Within a comment, the bytes of a multi-byte character are text and not realtime commands.
//! For example, 0x84 opens the door elsewhere, but the `Ä` of `(Äußere Kontur)` is 0xC3 0x84. Runs in the serial task,
//! one instance per link.
//!
//! ```text
//!  C3 84            text: the character Ä
//!  E3 84 41         no character: 0x84 is a command after all, and acts before the A
//!  C2 91            a command: some senders put 0xC2 before their override bytes
//!  C3 84 outside    a command: only a comment contains text
//! ```
//! A multi-byte character has no bytes below 0x80. So 0x18 and 0x19 act anywhere, and [`Link`](super::link::Link)
//! decides about a `!` or `~` in a comment.

use heapless::Vec;

/// Maximum number of bytes of an incomplete UTF-8 character: a complete one has at most four.
const MOST_BEGUN: usize = 3;

/// The part of the line to which the next byte belongs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum LinePart {
    Words,
    /// A comment in parentheses. The number counts the nested `(` that are still open: each of them needs its own `)`
    /// before another `)` can end the comment.
    Parentheses(u8),
    /// A comment after `;`, up to the line end.
    Semicolon,
}

/// The comment in the line being received.
#[derive(Clone, Debug)]
pub struct CommentTracker {
    part: LinePart,
    /// The bytes received so far of a UTF-8 character that is not complete.
    begun: Vec<u8, MOST_BEGUN>,
}

impl CommentTracker {
    /// The state at the start of a line: outside of a comment, and no character is incomplete.
    pub const NONE: CommentTracker = CommentTracker { part: LinePart::Words, begun: Vec::new() };

    /// Returns whether the next byte belongs to a comment.
    #[inline]
    pub fn is_inside(&self) -> bool {
        self.part != LinePart::Words
    }

    /// Returns whether the bytes of a UTF-8 character have begun to arrive and are not complete.
    #[inline]
    pub fn has_begun_character(&self) -> bool {
        !self.begun.is_empty()
    }

    /// Takes a byte of the line, and tracks whether the line is within a comment after this byte. `nests` returns
    /// whether nested parentheses are counted, by the same rule as in the line filter. It is called only for a `(`
    /// within a comment.
    pub fn follow(&mut self, byte: u8, nests: impl FnOnce() -> bool) {
        self.part = match (self.part, byte) {
            (_, b'\n' | b'\r') => LinePart::Words,
            (LinePart::Words, b'(') => LinePart::Parentheses(0),
            (LinePart::Words, b';') => LinePart::Semicolon,
            (LinePart::Parentheses(depth), b'(') if nests() => LinePart::Parentheses(depth.saturating_add(1)),
            (LinePart::Parentheses(0), b')') => LinePart::Words,
            (LinePart::Parentheses(depth), b')') => LinePart::Parentheses(depth - 1),
            (part, _) => part,
        };
    }

    /// Leaves the comment. Called if the line has ended, or if bytes were lost, because the end of the comment may be
    /// among the lost bytes. After that, the bytes of an incomplete character count as single bytes: see
    /// [`CommentTracker::break_off`].
    pub fn leave(&mut self) {
        self.part = LinePart::Words;
    }

    /// Removes and returns the bytes of the incomplete character if `byte` does not continue it. They form no
    /// character, so each of them counts by itself and may be a command.
    pub fn break_off(&mut self, byte: u8) -> Vec<u8, MOST_BEGUN> {
        if self.is_inside() && continues(&self.begun, byte) { Vec::new() } else { core::mem::take(&mut self.begun) }
    }

    /// Takes a byte that starts or continues a UTF-8 character of a comment, and returns `false` for any other byte.
    /// Call it after [`CommentTracker::break_off`]. `reads` returns `true` if the dialect recognises such characters.
    pub fn takes(&mut self, byte: u8, reads: impl FnOnce() -> bool) -> bool {
        let Some(lead) = self.begun.first() else {
            let begins = matches!(byte, 0xC3..=0xF4) && self.is_inside() && reads();
            return begins && self.begun.push(byte).is_ok();
        };
        if self.begun.len() + 1 == length(*lead) {
            self.begun.clear();
            return true;
        }
        self.begun.push(byte).is_ok()
    }
}

/// Returns the length in bytes of the character that starts with `lead`.
fn length(lead: u8) -> usize {
    match lead {
        0..=0xDF => 2,
        0xE0..=0xEF => 3,
        _ => 4,
    }
}

/// Returns whether a byte continues an incomplete character (Unicode 16, table 3-7: shortest form only, no surrogates,
/// up to U+10FFFF).
fn continues(begun: &[u8], byte: u8) -> bool {
    match begun {
        [0xE0] => matches!(byte, 0xA0..=0xBF),
        [0xED] => matches!(byte, 0x80..=0x9F),
        [0xF0] => matches!(byte, 0x90..=0xBF),
        [0xF4] => matches!(byte, 0x80..=0x8F),
        [] => false,
        _ => matches!(byte, 0x80..=0xBF),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Returns the bytes that do not belong to UTF-8 characters in comments, as a link passes them on.
    fn alone(bytes: &[u8]) -> std::vec::Vec<u8> {
        let mut comment = CommentTracker::NONE;
        let mut alone = std::vec::Vec::new();
        for byte in bytes {
            alone.extend(comment.break_off(*byte));
            if !comment.takes(*byte, || true) {
                alone.push(*byte);
                comment.follow(*byte, || true);
            }
        }
        alone
    }

    #[test]
    fn characters_of_a_comment_are_text() {
        assert_eq!(alone("(Äußere Kontur é 切削 😀)".as_bytes()), b"(uere Kontur   )");
        assert_eq!(alone("G1 ; Größe à\nÄ".as_bytes()), b"G1 ; Gre \n\xC3\x84");
        assert_eq!(alone("(a)Ä(Ä)".as_bytes()), b"(a)\xC3\x84()");
        assert_eq!(alone("(a (b (Ä)) Ä)Ä".as_bytes()), b"(a (b ()) )\xC3\x84");
    }

    #[test]
    fn what_is_no_character_keeps_its_bytes_in_their_order() {
        for bytes in [
            &b"(\xE3\x84A"[..],
            b"(\xE3\xF0\x9F\x98!",
            b"(\xC2\x84",
            b"(\x84\x85",
            b"(\xC3!\x84",
            b"(\xC0\x84",
            b"(\xE0\x84\x84",
            b"(\xED\xA0\x84",
            b"(\xF0\x84\x84\x84",
            b"(\xF4\x90\x84\x84",
            b"(\xF5\x84\x84\x84",
            b"(\xE3\x84\n\x84",
        ] {
            assert_eq!(alone(bytes), bytes, "{}", bytes.escape_ascii());
        }
        assert_eq!(alone(b"(\xC3\xC3\x84"), b"(\xC3");
    }

    #[test]
    fn a_character_ends_with_its_comment() {
        let mut comment = CommentTracker::NONE;
        comment.follow(b'(', || true);
        assert!(comment.takes(0xE3, || true) && comment.takes(0x84, || true) && comment.has_begun_character());
        comment.leave();
        assert_eq!(comment.break_off(0x84), [0xE3, 0x84]);
        assert!(!comment.takes(0x84, || true) && !comment.has_begun_character());
    }

    proptest! {
        /// The recognised characters of a comment are those from U+00C0 up that the standard library finds.
        #[test]
        fn characters_are_those_of_utf8(bytes in proptest::collection::vec(prop_oneof![
            0x80_u8.., Just(0xC3), Just(0xE0), Just(0xE3), Just(0xED), Just(0xF0), Just(0xF4), 0x80_u8..0xC0, 0x80_u8..0xC0, b'a'..=b'c'
        ], 0..60)) {
            let mut expected = b"(".to_vec();
            for chunk in bytes.utf8_chunks() {
                let is_text = |character: &char| !character.is_ascii() && *character >= '\u{C0}';
                let kept: String = chunk.valid().chars().filter(|character| !is_text(character)).collect();
                expected.extend(kept.as_bytes());
                expected.extend(chunk.invalid());
            }
            expected.push(b'\n');
            prop_assert_eq!(alone(&[b"(", bytes.as_slice(), b"\n"].concat()), expected);
        }
    }
}
