//! The format of the entries in a page of the recording: a tag, then numbers in little-endian order.

use super::page::ROOM;
use crate::messages::{CrashKind, Noted, Standing, Stopping};
use crate::units::Coordinate;

/// Tags: the first byte of an entry. Only printable characters and line ends of a line are entries of one byte without
/// a tag.
pub(super) mod tag {
    pub const BYTE: u8 = 0x80;
    pub const TIME: u8 = 0x81;
    pub const COMMAND: u8 = 0x82;
    pub const INPUTS: u8 = 0x83;
    pub const STEP: u8 = 0x84;
    pub const STORED: u8 = 0x85;
    pub const STORE_FAILED: u8 = 0x86;
    pub const CONNECTED: u8 = 0x87;
    pub const DISCONNECTED: u8 = 0x88;
    pub const MORE: u8 = 0x89;
    pub const DAMAGED: u8 = 0x8A;
    pub const CUT: u8 = 0x8B;
    pub const REST: u8 = 0x8C;
    pub const STANDING: u8 = 0x8D;
    pub const POWER_UP: u8 = 0x8E;
    pub const ENDED: u8 = 0x8F;
}

/// The bytes of an entry after its tag.
pub(super) type Rest = heapless::Vec<u8, ROOM>;

// The following functions have many callers but rarely run. They are not inlined, to save flash.

#[inline(never)]
pub(super) fn put_bytes(out: &mut Rest, bytes: &[u8]) {
    for byte in bytes {
        let _ = out.push(*byte);
    }
}

#[inline(never)]
pub(super) fn put_word(out: &mut Rest, word: u32) {
    put_bytes(out, &word.to_le_bytes());
}

#[inline(never)]
pub(super) fn put_axes(out: &mut Rest, axes: &[i32]) {
    let _ = out.push(axes.len() as u8);
    for axis in axes {
        put_word(out, *axis as u32);
    }
}

/// A decoded entry.
pub(super) enum Found {
    Time(u64),
    Text(u8),
    Noted(Noted),
}

/// Unread bytes of an entry.
pub(super) struct Bytes<'a>(pub(super) &'a [u8]);

impl Bytes<'_> {
    pub(super) fn some<const COUNT: usize>(&mut self) -> Option<[u8; COUNT]> {
        let (some, rest) = self.0.split_first_chunk()?;
        self.0 = rest;
        Some(*some)
    }

    #[inline(never)]
    fn byte(&mut self) -> Option<u8> {
        self.some().map(|[byte]| byte)
    }

    #[inline(never)]
    pub(super) fn word(&mut self) -> Option<u32> {
        self.some().map(u32::from_le_bytes)
    }

    #[inline(never)]
    fn axes(&mut self) -> Option<heapless::Vec<i32, { Standing::AXES }>> {
        let count = usize::from(self.byte()?);
        let mut axes = heapless::Vec::new();
        for _ in 0..count {
            axes.push(self.word()? as i32).ok()?;
        }
        Some(axes)
    }
}

/// Decodes the entry with this tag; `rest`: the bytes after the tag. Returns how many of these bytes the entry has,
/// and the decoded entry. `None` if the entry is incomplete or unknown.
pub(super) fn decode(tag: u8, rest: &[u8]) -> Option<(usize, Found)> {
    let mut bytes = Bytes(rest);
    let found = match tag {
        0..0x80 => Found::Text(tag),
        tag::BYTE => Found::Text(bytes.byte()?),
        tag::TIME => {
            let mut passed = 0;
            for shift in (0..64).step_by(7) {
                let digit = bytes.byte()?;
                passed |= u64::from(digit & 0x7F) << shift;
                if digit < 0x80 {
                    break;
                }
            }
            Found::Time(passed)
        }
        tag::COMMAND => Found::Noted(Noted::Command(bytes.byte()?)),
        tag::INPUTS => Found::Noted(Noted::Inputs { active: bytes.word()?, tripped: bytes.word()? }),
        tag::STEP => {
            let stopping = *Stopping::ALL.get(usize::from(bytes.byte()?))?;
            Found::Noted(Noted::Step(stopping, bytes.axes()?))
        }
        tag::STORED | tag::STORE_FAILED => Found::Noted(Noted::Stored(tag == tag::STORED)),
        tag::CONNECTED => Found::Noted(Noted::Connected),
        tag::DISCONNECTED => Found::Noted(Noted::Disconnected),
        tag::MORE => Found::Noted(Noted::More),
        tag::DAMAGED => Found::Noted(Noted::Damaged),
        tag::CUT => Found::Noted(Noted::Cut),
        tag::REST => Found::Noted(Noted::Rest { counters: bytes.axes()?, blocks: bytes.word()? }),
        tag::STANDING => Found::Noted(standing(&mut bytes)?),
        tag::POWER_UP => Found::Noted(Noted::PowerUp),
        tag::ENDED => {
            let kind = bytes.byte()?;
            let mut word = || bytes.word();
            let place = [word()? as i32, word()? as i32, word()? as i32];
            Found::Noted(Noted::Ended { crash: CrashKind::ALL.get(usize::from(kind)).copied(), place, line: word()? })
        }
        _ => return None,
    };
    Some((rest.len() - bytes.0.len(), found))
}

#[inline(never)]
fn standing(bytes: &mut Bytes<'_>) -> Option<Noted> {
    let flags = bytes.byte()?;
    let (tool, active, blocks) = (bytes.word()?, bytes.word()?, bytes.word()?);
    let (mut counters, mut place) = (heapless::Vec::new(), heapless::Vec::new());
    for _ in 0..bytes.byte()? {
        counters.push(bytes.word()? as i32).ok()?;
        place.push(Coordinate(bytes.some().map(i64::from_le_bytes)?)).ok()?;
    }
    let mut words = heapless::Vec::new();
    for _ in 0..bytes.byte()? {
        words.push(bytes.byte()?).ok()?;
    }
    let bit = |n: u8| flags >> n & 1 != 0;
    let (trusted, locked, inches) = (bit(0), bit(1), bit(2));
    Some(Noted::Standing {
        standing: Standing { counters, place, trusted, locked, inches, tool, active, words },
        blocks,
    })
}
