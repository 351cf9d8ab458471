//! Finds realtime commands in the received bytes, anywhere in a line. `command` maps a byte to its command,
//! `command_of_grblhal` does the same for the commands that only `$900=3` has, and `byte_of` is the inverse. A byte
//! that is no command is part of a line or ignored (`Received`). The serial task calls these functions.

use crate::image::FULL_IMAGE;
use crate::messages::Realtime;
use crate::protocol::queues::Queues;

/// Classification of a received byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A command that acts immediately.
    Realtime(Realtime),
    /// No realtime command: the byte belongs to a line.
    Line(u8),
    /// A byte from 0x80 up that is no command. It is dropped, as in Grbl.
    Nothing,
}

impl Received {
    /// Classifies a byte as [`Received::of`] does. If hosts are answered like grblHAL (`$900=3`), also finds the
    /// commands that only grblHAL has.
    pub(super) fn in_dialect(byte: u8, queues: &impl Queues) -> Received {
        match Received::of(byte) {
            Received::Nothing if FULL_IMAGE && queues.speaks_grblhal() => {
                command_of_grblhal(byte).map_or(Received::Nothing, Received::Realtime)
            }
            received => received,
        }
    }

    /// Classifies a byte, independently of its position in a line.
    pub fn of(byte: u8) -> Received {
        match command(byte) {
            Some(command) => Received::Realtime(command),
            None if byte >= 0x80 => Received::Nothing,
            None => Received::Line(byte),
        }
    }
}

/// Returns whether a byte is ordinary text of a line: it is printable ASCII, is no command, and neither starts nor ends
/// a comment.
#[inline]
#[allow(clippy::indexing_slicing, reason = "there is one for each byte")]
pub const fn is_plain(byte: u8) -> bool {
    KINDS[byte as usize] == PLAIN
}

/// Returns whether a byte is plain ([`is_plain`]) or an LF.
#[inline]
#[allow(clippy::indexing_slicing, reason = "there is one for each byte")]
pub const fn is_plain_or_lf(byte: u8) -> bool {
    KINDS[byte as usize] != OTHER
}

const OTHER: u8 = 0;
const LF: u8 = 1;
const PLAIN: u8 = 2;

/// For each byte, whether it is ordinary text (`PLAIN`), an LF, or any other byte.
#[allow(clippy::indexing_slicing, reason = "the compiler computes it")]
const KINDS: [u8; 256] = {
    let mut kinds = [OTHER; 256];
    let mut byte = b' ';
    while byte <= b'}' {
        kinds[byte as usize] = if matches!(byte, b'!' | b'?' | b'(' | b')' | b';') { OTHER } else { PLAIN };
        byte += 1;
    }
    kinds[b'\n' as usize] = LF;
    kinds
};

/// Returns the realtime command of a byte (Grbl 1.1 interface, realtime commands).
pub const fn command(byte: u8) -> Option<Realtime> {
    Some(match byte {
        0x18 => Realtime::Reset,
        0x19 => Realtime::Stop,
        b'?' => Realtime::Status,
        b'~' => Realtime::CycleStart,
        b'!' => Realtime::FeedHold,
        0x84 => Realtime::SafetyDoor,
        0x85 => Realtime::JogCancel,
        0x89 => Realtime::SingleBlock,
        0x90 => Realtime::FeedReset,
        0x91 => Realtime::FeedUp10,
        0x92 => Realtime::FeedDown10,
        0x93 => Realtime::FeedUp1,
        0x94 => Realtime::FeedDown1,
        0x95 => Realtime::RapidFull,
        0x96 => Realtime::RapidHalf,
        0x97 => Realtime::RapidQuarter,
        0x99 => Realtime::SpindleReset,
        0x9A => Realtime::SpindleUp10,
        0x9B => Realtime::SpindleDown10,
        0x9C => Realtime::SpindleUp1,
        0x9D => Realtime::SpindleDown1,
        0x9E => Realtime::SpindleStop,
        0xA0 => Realtime::FloodToggle,
        0xA1 => Realtime::MistToggle,
        _ => return None,
    })
}

/// Returns the realtime command of a byte that is a command only with `$900=3` (hosts are answered like grblHAL).
pub const fn command_of_grblhal(byte: u8) -> Option<Realtime> {
    Some(match byte {
        0x80 => Realtime::Status,
        0x81 => Realtime::CycleStart,
        0x82 => Realtime::FeedHold,
        0x83 => Realtime::ParserState,
        0x87 => Realtime::FullStatus,
        0x88 => Realtime::OptionalStop,
        0xA3 => Realtime::ToolReady,
        _ => return None,
    })
}

/// Returns the byte of a realtime command, for the recorder. If two bytes have the same command, such as `?` and 0x80,
/// returns the lower one.
pub fn byte_of(wanted: Realtime) -> u8 {
    let of = |byte: &u8| command(*byte).or(if FULL_IMAGE { command_of_grblhal(*byte) } else { None });
    (0..=u8::MAX).find(|byte| of(byte) == Some(wanted)).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::HOST_CHANGED;

    #[test]
    fn commands_are_picked_out_in_mid_line() {
        let mut line = Vec::new();
        let mut commands = Vec::new();
        for byte in *b"G1?X\x85!\x192\xC3\n" {
            match Received::of(byte) {
                Received::Realtime(c) => commands.push(c),
                Received::Line(b) => line.push(b),
                Received::Nothing => {}
            }
        }
        assert_eq!(commands, [Realtime::Status, Realtime::JogCancel, Realtime::FeedHold, Realtime::Stop]);
        assert_eq!(line, b"G1X2\n");
    }

    #[test]
    fn plain_bytes_are_those_of_lines_that_end_none() {
        for byte in 0..=0xFF {
            let of_line = Received::of(byte) == Received::Line(byte) && !b"();".contains(&byte);
            assert_eq!(is_plain(byte), of_line && (b' '..=b'}').contains(&byte), "{byte:#x}");
        }
    }

    #[cfg(feature = "full")]
    #[test]
    fn no_byte_of_grblhal_has_another_command() {
        for byte in 0..=0xFF {
            let Some(of_grblhal) = command_of_grblhal(byte) else { continue };
            assert_eq!((command(byte), Received::of(byte)), (None, Received::Nothing), "{byte:#x}");
            let lowest = byte_of(of_grblhal);
            assert_eq!(command(lowest).or(command_of_grblhal(lowest)), Some(of_grblhal));
        }
        assert_eq!([byte_of(Realtime::Status), byte_of(Realtime::FullStatus)], [b'?', 0x87]);
    }

    #[test]
    fn every_high_byte_is_a_command_or_nothing() {
        for byte in 0x80..=0xFF {
            assert!(!matches!(Received::of(byte), Received::Line(_)));
        }
        assert!(!matches!(Received::of(HOST_CHANGED), Received::Line(_)), "no host can send it");
    }
}
