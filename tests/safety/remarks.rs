//! Tests G-code comments with UTF-8 characters while the machine moves. Lines arrive in one piece or byte by byte, some
//! with a stop byte. No byte of a character may act as a feed hold, door or override command. Every line must be
//! answered, and no stop byte may be lost. A `!` in a comment acts as a feed hold only if no byte follows within 20 ms.
//!
//! `OXMILL_REMARKS=N` plays N conversations (each 1 to 5 lines) instead of 200; `OXMILL_REMARKS_SEED` sets the first
//! seed.

use super::bench::{Bench, STEPS};
use oxmill_test_support::Random;

/// Characters of one to four bytes. Some contain a byte with the value of a realtime command.
const TEXT: [&str; 22] = [
    "Ä", "Ö", "Ü", "ä", "ö", "ß", "à", "á", "é", "ñ", "Å", "Ł", "Ж", "切", "削", "原", "点", "、", "😀", "𐀄", "e", " ",
];
const WORDS: [&str; 8] = ["G1 X0.5", "G0 Y1", "G21", "", "G90", "N20 G1 Z-0.1", "F600", "S100"];
/// Message that the machine sends once for nested parentheses.
const NESTED: &str = "[MSG:Nested parentheses: the comment ends at the matching ) here, at the first ) in Grbl]";
/// Realtime commands. They act anywhere, with two exceptions in a comment: `~` is text there, and `!` is text if
/// another byte follows within 20 ms.
const STOPS: [u8; 5] = [0x84, b'!', 0x18, 0x19, b'~'];

/// Lines that a host sends while the machine moves, with at most one stop byte (one of [`STOPS`]) among them.
struct Conversation {
    bytes: Vec<u8>,
    lines: usize,
    stop: Option<u8>,
    /// Index of the stop byte in `bytes`; unused without a stop byte.
    at: usize,
    /// `true` if `at` is in a comment.
    is_in_comment: bool,
    /// `true` if the stop byte splits a character. Then the remaining bytes of the character may act as commands.
    breaks: bool,
}

impl Conversation {
    fn new(random: &mut Random) -> Self {
        let mut text = String::new();
        let lines = 1 + random.below(5) as usize;
        for _ in 0..lines {
            let words = random.of(&WORDS);
            let mut comment = String::new();
            for _ in 0..random.below(8) {
                comment += random.of(&TEXT);
            }
            text += &match random.below(6) {
                0 => format!("({comment}){words}"),
                4 => format!("{words} ({comment} ({comment}) {comment})"),
                5 => format!("({comment} ({comment}({comment})) {comment}){words}"),
                1 => format!("{words} ({comment}"),
                2 => format!("{words};{comment}"),
                _ => format!("{words} ({comment}) ; ({comment})"),
            };
            text += random.of(&["\n", "\r\n"]);
        }
        let stop = (random.below(2) == 0).then(|| STOPS[random.below(STOPS.len() as u64) as usize]);
        let mut at = random.below(text.len() as u64) as usize;
        // Inside a character, a stop byte of 0x80 or more could form another character together with the bytes around
        // it. A `~` would split the character, and the rest of the character could act as a command. So move such a
        // stop byte to the start of the character.
        while stop.is_some_and(|stop| !stop.is_ascii() || stop == b'~') && !text.is_char_boundary(at) {
            at -= 1;
        }
        let breaks = stop.is_some() && !text.is_char_boundary(at);
        let line = text.as_bytes()[..at].rsplit(|byte| *byte == b'\n').next().unwrap_or_default();
        let count = |wanted: u8| line.iter().filter(|byte| **byte == wanted).count();
        let is_in_comment = (count(b';') > 0 || count(b'(') > count(b')')) && line.last() != Some(&b'\r');
        let mut bytes = text.into_bytes();
        if let Some(stop) = stop {
            bytes.insert(at, stop);
        }
        Self { bytes, lines, stop, at, is_in_comment, breaks }
    }

    /// Sends the conversation to a machine in a long move, and checks the machine's state and answers.
    fn play(&self, mut bench: Bench, sending: Sending, what: &str) {
        let what = format!("{what}, {sending:?}: {:?}", self.bytes.escape_ascii().to_string());
        let (first, rest) = self.bytes.split_at(if sending == Sending::Stops { self.at + 1 } else { self.bytes.len() });
        for piece in first.chunks(if sending == Sending::Bytes { 1 } else { self.bytes.len() }) {
            bench.send(piece);
            bench.wait(0.0002);
        }
        if !rest.is_empty() {
            bench.wait(0.03);
            bench.send(rest);
        }
        bench.wait(0.2);
        let (status, mut said) = (bench.status(), bench.read());
        said.retain(|line| line != NESTED);
        let is = |state: &str| assert!(status.starts_with(state), "{what}: {status} {said:?}");
        match self.stop {
            Some(0x84) => is("<Door:"),
            Some(0x19) => {
                // Without the stop the long move would take another 10 s. The lines after the stop move only a little.
                bench.wait(15.0);
                assert!(f64::from(bench.place()[0]) < 10.0 * STEPS, "{what}: {status}");
            }
            Some(b'!') if self.is_in_comment && sending != Sending::Stops => {
                // If the stop byte splits a character, the rest of the character may act as a command.
                if !self.breaks {
                    is("<Run");
                    assert_eq!(said, vec!["ok"; self.lines], "{what}");
                }
            }
            Some(b'!') if self.breaks => assert!(!status.starts_with("<Run"), "{what}: {status}"),
            Some(b'!') => is("<Hold:"),
            Some(0x18) => assert!(said.iter().any(|line| line.starts_with("Grbl ")), "{what}: {said:?}"),
            _ => is("<Run"),
        }
        if self.stop.is_none_or(|stop| stop == b'~') {
            assert_eq!(said, vec!["ok"; self.lines], "{what}");
            // A report without the field `Ov:` means that the overrides have not changed.
            let overrides = status.split_once("|Ov:").is_none_or(|(_, told)| told.starts_with("100,100,100"));
            assert!(overrides && status.contains("FS:600,0") && !status.contains("A:"), "{what}: {status}");
        }
    }
}

/// How a conversation is sent: in one piece, byte by byte, or with a pause.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Sending {
    InOne,
    Bytes,
    /// The host pauses for 30 ms after the stop byte, long enough for a `!` in a comment to act.
    Stops,
}

#[test]
fn characters_of_remarks_are_no_commands_and_no_stop_is_lost() {
    let number = |name: &str, default: u64| {
        std::env::var(name).map_or(default, |text| text.parse().unwrap_or_else(|_| panic!("{name} is a number")))
    };
    let (conversations, first) = (number("OXMILL_REMARKS", 200), number("OXMILL_REMARKS_SEED", 1));
    let mut moving = Bench::new("", "$110=3000 $120=500");
    moving.send("G91 G1 X100 F600\n");
    moving.wait(0.1);
    moving.read();
    for seed in first..first + conversations {
        let conversation = Conversation::new(&mut Random(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1));
        for sending in [Sending::InOne, Sending::Bytes, Sending::Stops] {
            if sending == Sending::Stops && conversation.stop.is_none() {
                continue;
            }
            conversation.play(moving.clone(), sending, &format!("conversation {seed}"));
        }
    }
    println!("{conversations} conversations");
}

/// A `!` in a comment acts when no byte has followed for 20 ms; each byte restarts this time. A `~` in a comment never
/// resumes the machine, even if a pause follows it.
#[test]
fn a_pause_is_counted_from_the_last_byte() {
    let mut bench = Bench::new("", "$110=3000 $120=500");
    bench.send("G91 G1 X100 F600\n");
    bench.wait(0.1);
    bench.send("(a!");
    bench.wait(0.019);
    bench.send(")\n(b!");
    bench.wait(0.019);
    assert!(bench.status().starts_with("<Run"));
    bench.wait(0.3);
    assert!(bench.status().starts_with("<Hold:0"));
    bench.send("~) (c~");
    bench.wait(0.3);
    assert!(bench.status().starts_with("<Hold:0"), "a `~` in a remark is text");
    bench.send(")~\n");
    bench.wait(0.1);
    assert!(bench.status().starts_with("<Run"));
}
