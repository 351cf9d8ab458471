//! The splitter: picks realtime commands out of the received bytes, wherever they stand. Lives in the serial task.

use crate::messages::{LineByte, Realtime};

/// What a received byte was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Received {
    /// A command that acts at once.
    Realtime(Realtime),
    /// Part of a line.
    Line(LineByte),
    /// Neither: a byte of 0x80 and above that is no command is thrown away, as Grbl does.
    Nothing,
}

/// Splits a byte stream. Keeps the epoch of line bytes: see [`LineByte`].
#[derive(Clone, Debug, Default)]
pub struct Splitter {
    epoch: u16,
}

impl Splitter {
    /// A splitter at the start of the stream.
    pub const fn new() -> Self {
        Self { epoch: 0 }
    }

    /// The epoch of the next line byte.
    pub fn epoch(&self) -> u16 {
        self.epoch
    }

    /// Takes the next byte.
    pub fn push(&mut self, byte: u8) -> Received {
        match command(byte) {
            Some(command) => {
                if matches!(command, Realtime::Reset | Realtime::Stop | Realtime::JogCancel) {
                    self.epoch = self.epoch.wrapping_add(1);
                }
                Received::Realtime(command)
            }
            None if byte >= 0x80 => Received::Nothing,
            None => Received::Line(LineByte { byte, epoch: self.epoch, damaged: false }),
        }
    }
}

/// The realtime command of a byte (Grbl 1.1 interface, realtime commands).
pub const fn command(byte: u8) -> Option<Realtime> {
    Some(match byte {
        0x18 => Realtime::Reset,
        0x19 => Realtime::Stop,
        b'?' => Realtime::Status,
        b'~' => Realtime::CycleStart,
        b'!' => Realtime::FeedHold,
        0x84 => Realtime::SafetyDoor,
        0x85 => Realtime::JogCancel,
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn commands_are_picked_out_in_mid_line() {
        let mut splitter = Splitter::new();
        let mut line = Vec::new();
        let mut commands = Vec::new();
        for byte in *b"G1?X\x85!\x192\xC3\n" {
            match splitter.push(byte) {
                Received::Realtime(c) => commands.push(c),
                Received::Line(b) => line.push((b.byte, b.epoch)),
                Received::Nothing => {}
            }
        }
        assert_eq!(commands, [Realtime::Status, Realtime::JogCancel, Realtime::FeedHold, Realtime::Stop]);
        assert_eq!(line, [(b'G', 0), (b'1', 0), (b'X', 0), (b'2', 2), (b'\n', 2)]);
    }

    #[test]
    fn every_high_byte_is_a_command_or_nothing() {
        let mut splitter = Splitter::new();
        for byte in 0x80..=0xFF {
            assert!(!matches!(splitter.push(byte), Received::Line(_)));
        }
    }
}
