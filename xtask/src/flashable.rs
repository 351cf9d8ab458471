//! Splits an image into the stretches of flash that a flashing tool writes, and writes them as Intel HEX, which most
//! tools accept. The settings sectors lie between the two stretches of an image. No file has a byte for them, so the
//! settings survive when new firmware is flashed.
//!
//! ```text
//!  sector 0   vector table      ┐
//!  settings   ──────────────    ├ BOARD.hex, BOARD.dfu (the program first)
//!  program    code, data        ┘
//! ```

use crate::Failure;
use crate::elf::{self, Elf};
use std::collections::BTreeMap;
use std::fmt::Write;
use std::ops::Range;

/// Number of data bytes per row of Intel HEX.
const ROW: usize = 16;
/// Value of erased flash, used for gaps within a stretch.
const ERASED: u8 = 0xFF;

/// A contiguous range of flash: its first address, and the bytes from there on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Stretch {
    pub address: u32,
    pub bytes: Vec<u8>,
}

/// Returns the image's stretches before and after the settings sectors; `None` if segments overlap or are cut off.
pub fn stretches(elf: &Elf<'_>, settings: &Range<u32>) -> Option<Vec<Stretch>> {
    let mut segments = elf::segments(elf)?;
    segments.sort_by_key(|(stored, _)| *stored);
    let mut found: Vec<Stretch> = Vec::new();
    for (stored, bytes) in segments {
        match found.last_mut() {
            Some(last)
                if last.address < settings.start && stored < settings.start
                    || last.address >= settings.end && stored >= settings.end =>
            {
                let at = (stored - last.address) as usize;
                if at < last.bytes.len() {
                    return None;
                }
                last.bytes.resize(at, ERASED);
                last.bytes.extend_from_slice(bytes);
            }
            _ => found.push(Stretch { address: stored, bytes: bytes.to_vec() }),
        }
    }
    Some(found)
}

/// Returns the text of an Intel HEX file (records of the types 00, 01 and 04).
pub fn hex(stretches: &[Stretch]) -> String {
    let mut text = String::new();
    let mut row = |address: u16, kind: u8, bytes: &[u8]| {
        let [high, low] = address.to_be_bytes();
        let head = [bytes.len() as u8, high, low, kind];
        let sum = head.iter().chain(bytes).fold(0_u8, |sum, byte| sum.wrapping_add(*byte));
        text.push(':');
        for byte in head.iter().chain(bytes).chain([&sum.wrapping_neg()]) {
            // Writing to a string cannot fail.
            let _ = write!(text, "{byte:02X}");
        }
        text.push('\n');
    };
    let mut upper = None;
    for stretch in stretches {
        let mut address = stretch.address;
        let mut rest = &stretch.bytes[..];
        while !rest.is_empty() {
            if upper != Some(address >> 16) {
                upper = Some(address >> 16);
                row(0, 4, &((address >> 16) as u16).to_be_bytes());
            }
            // A row has only the low 16 bits of its address, so it must not cross a boundary of 64 KiB.
            let length = rest.len().min(ROW).min(0x1_0000 - (address & 0xFFFF) as usize);
            row(address as u16, 0, &rest[..length]);
            rest = &rest[length..];
            address += length as u32;
        }
    }
    row(0, 1, &[]);
    text
}

/// Reads Intel HEX; returns each byte by its address.
pub fn parse(text: &str) -> Result<BTreeMap<u32, u8>, Failure> {
    let mut memory = BTreeMap::new();
    let (mut upper, mut ended) = (0_u32, false);
    for (number, line) in text.lines().enumerate() {
        let fail = |why: &str| format!("line {} of the hex file {why}", number + 1);
        let digits = line.strip_prefix(':').ok_or_else(|| fail("has no colon"))?;
        let bytes: Option<Vec<u8>> =
            (0..digits.len()).step_by(2).map(|i| u8::from_str_radix(digits.get(i..i + 2)?, 16).ok()).collect();
        let bytes = bytes.ok_or_else(|| fail("is no hexadecimal"))?;
        if bytes.iter().fold(0_u8, |sum, byte| sum.wrapping_add(*byte)) != 0 {
            return Err(fail("has a wrong checksum"));
        }
        let [length, high, low, kind, ref data @ .., _] = bytes[..] else { return Err(fail("is cut off")) };
        if ended || usize::from(length) != data.len() {
            return Err(fail("is out of place or has a wrong length"));
        }
        match (kind, data) {
            (0, _) => {
                let address = upper << 16 | u32::from(u16::from_be_bytes([high, low]));
                for (offset, byte) in data.iter().enumerate() {
                    if memory.insert(address + offset as u32, *byte).is_some() {
                        return Err(fail("writes a byte again"));
                    }
                }
            }
            (1, _) => ended = true,
            (4, &[high, low]) => upper = u32::from(u16::from_be_bytes([high, low])),
            _ => return Err(fail("is of an unknown type")),
        }
    }
    if ended { Ok(memory) } else { Err("the hex file has no end".into()) }
}

/// Checks that a hex file has exactly the bytes of the stretches, and none in the settings sectors.
pub fn check(text: &str, stretches: &[Stretch], settings: &Range<u32>) -> Result<(), Failure> {
    let memory = parse(text)?;
    if let Some((address, _)) = memory.range(settings.clone()).next() {
        return Err(format!("the hex file has a byte at {address:#010x}, in the settings sectors"));
    }
    let wanted: BTreeMap<u32, u8> =
        stretches.iter().flat_map(|s| s.bytes.iter().enumerate().map(|(i, b)| (s.address + i as u32, *b))).collect();
    if memory == wanted { Ok(()) } else { Err("the hex file is not what the image is".into()) }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Range<u32> = 0x0800_4000..0x0800_C000;

    fn stretch(address: u32, length: usize) -> Stretch {
        Stretch { address, bytes: (0..length).map(|i| (i * 7 + i / 256) as u8).collect() }
    }

    #[test]
    fn a_known_row() {
        let text = hex(&[Stretch { address: 0x0800_0010, bytes: vec![0x01, 0x02, 0xFF] }]);
        assert_eq!(text, ":020000040800F2\n:030010000102FFEB\n:00000001FF\n");
    }

    #[test]
    fn hex_reads_back_across_64_kib() {
        let image = [stretch(0x0800_0000, 408), stretch(0x0800_FFF5, 0x1_2345)];
        let text = hex(&image);
        check(&text, &image, &SETTINGS).unwrap();
        assert!(check(&text, &image[..1], &SETTINGS).is_err());
        assert!(parse(&text.replacen("04", "05", 1)).is_err());
        assert!(parse(text.trim_end_matches(":00000001FF\n")).is_err());
    }

    #[test]
    fn a_byte_in_the_settings_sectors_is_seen() {
        for address in [SETTINGS.start, SETTINGS.end - 1, SETTINGS.start - 4] {
            let image = [stretch(address, 8)];
            assert!(check(&hex(&image), &image, &SETTINGS).unwrap_err().contains("settings"), "{address:#x}");
        }
        let image = [stretch(SETTINGS.start - 8, 8), stretch(SETTINGS.end, 8)];
        check(&hex(&image), &image, &SETTINGS).unwrap();
    }

    #[test]
    fn an_image_is_split_around_the_settings_and_gaps_are_filled() {
        let file = elf::file(&[(0x0800_C010, b"data"), (0x0800_0000, b"vectors"), (0x0800_C000, b"program")], &[]);
        let found = stretches(&elf::parse(&file).unwrap(), &SETTINGS).unwrap();
        let program = b"program\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFF\xFFdata".to_vec();
        assert_eq!(
            found,
            [
                Stretch { address: 0x0800_0000, bytes: b"vectors".to_vec() },
                Stretch { address: 0x0800_C000, bytes: program }
            ]
        );
        let overlapping = elf::file(&[(0x0800_C000, b"program"), (0x0800_C002, b"x")], &[]);
        assert!(stretches(&elf::parse(&overlapping).unwrap(), &SETTINGS).is_none());
    }
}
