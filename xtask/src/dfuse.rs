//! DfuSe files (`.dfu`, ST's UM0391). A tool such as dfu-util sends them to the USB boot loader in an STM32's ROM,
//! which writes them to flash. A file contains several stretches (contiguous ranges) of flash with their addresses. So
//! one command of the tool writes all stretches, in the order of the file.

use crate::Failure;
use crate::flashable::Stretch;

/// Size of the header of a file, bytes. The header of the target follows; the only target here is the flash.
const PREFIX: usize = 11;
/// Size of the header of the target, bytes. The elements follow: address, size and bytes of each stretch.
const TARGET_PREFIX: usize = 274;
/// Size of a target's name field, bytes.
const NAME: usize = 255;
/// End of every DFU file, before the checksum: any device version, ST's boot loader (0483:DF11), version 1.1a of the
/// format, the signature, and the length of the suffix.
const SUFFIX: [u8; 12] = [0xFF, 0xFF, 0x11, 0xDF, 0x83, 0x04, 0x1A, 0x01, b'U', b'F', b'D', 16];

/// Returns a file with one target, the flash. Its elements are the stretches, highest address first, so the stretch
/// with the vector table is last. Tools write elements in file order: until the last one is written, a blank chip has
/// no vector table and cannot start the half-written program.
pub fn file(name: &str, stretches: &[Stretch]) -> Vec<u8> {
    let mut ordered: Vec<&Stretch> = stretches.iter().collect();
    ordered.sort_by_key(|stretch| std::cmp::Reverse(stretch.address));
    let mut elements = Vec::new();
    for stretch in &ordered {
        elements.extend(stretch.address.to_le_bytes());
        elements.extend((stretch.bytes.len() as u32).to_le_bytes());
        elements.extend(&stretch.bytes);
    }
    let mut file = b"DfuSe\x01".to_vec();
    file.extend(((PREFIX + TARGET_PREFIX + elements.len()) as u32).to_le_bytes());
    file.push(1);
    // Alternate setting 0 is the flash; the following flag says that the target has a name.
    file.extend(b"Target\x00\x01\x00\x00\x00");
    let mut field = name.as_bytes().to_vec();
    field.resize(NAME, 0);
    file.extend(field);
    file.extend((elements.len() as u32).to_le_bytes());
    file.extend((ordered.len() as u32).to_le_bytes());
    file.extend(elements);
    file.extend(SUFFIX);
    let sum = checksum(&file);
    file.extend(sum.to_le_bytes());
    file
}

/// Returns the CRC-32 of DFU, which lacks the final inversion.
fn checksum(bytes: &[u8]) -> u32 {
    !crc32fast::hash(bytes)
}

/// Reads a file with one target; returns its elements in file order.
pub fn parse(file: &[u8]) -> Result<Vec<Stretch>, Failure> {
    let fail = |why: &str| format!("the .dfu file {why}");
    let (body, sum) = file.split_last_chunk::<4>().ok_or_else(|| fail("is cut off"))?;
    if checksum(body) != u32::from_le_bytes(*sum) {
        return Err(fail("has a wrong checksum"));
    }
    let body = body.strip_suffix(&SUFFIX).ok_or_else(|| fail("has no suffix for ST's boot loader"))?;
    let size = (body.len() as u32).to_le_bytes();
    let rest = strip(body, &[b"DfuSe\x01", &size, &[1]]).ok_or_else(|| fail("does not begin as it should"))?;
    let rest = strip(rest, &[b"Target\x00\x01\x00\x00\x00"]).ok_or_else(|| fail("has no target for the flash"))?;
    let (_, rest) = rest.split_at_checked(NAME).ok_or_else(|| fail("is cut off"))?;
    let (size, rest) = word(rest).ok_or_else(|| fail("is cut off"))?;
    let (count, mut rest) = word(rest).ok_or_else(|| fail("is cut off"))?;
    if size as usize != rest.len() {
        return Err(fail("has a target of a wrong size"));
    }
    let mut elements = Vec::new();
    for _ in 0..count {
        let (stretch, behind) = element(rest).ok_or_else(|| fail("has an element that is cut off"))?;
        elements.push(stretch);
        rest = behind;
    }
    if rest.is_empty() { Ok(elements) } else { Err(fail("has something behind its elements")) }
}

/// Returns the bytes after `parts`; `None` if `bytes` does not begin with `parts`.
fn strip<'a>(bytes: &'a [u8], parts: &[&[u8]]) -> Option<&'a [u8]> {
    parts.iter().try_fold(bytes, |rest, part| rest.strip_prefix(*part))
}

fn word(bytes: &[u8]) -> Option<(u32, &[u8])> {
    let (word, rest) = bytes.split_first_chunk::<4>()?;
    Some((u32::from_le_bytes(*word), rest))
}

fn element(bytes: &[u8]) -> Option<(Stretch, &[u8])> {
    let (address, rest) = word(bytes)?;
    let (size, rest) = word(rest)?;
    let (bytes, rest) = rest.split_at_checked(size as usize)?;
    Some((Stretch { address, bytes: bytes.to_vec() }, rest))
}

/// Checks a `.dfu` file. Its elements must be exactly `stretches`, and there must be two. The element with the vector
/// table, which starts at the address `vectors`, must be last.
pub fn check(file: &[u8], stretches: &[Stretch], vectors: u32) -> Result<(), Failure> {
    let elements = parse(file)?;
    let mut sorted = elements.clone();
    sorted.sort_by_key(|stretch| stretch.address);
    match &elements[..] {
        _ if sorted != stretches => Err("the .dfu file is not what the image is".into()),
        [_, last] if last.address == vectors => Ok(()),
        _ => Err("the .dfu file does not have two elements with the vector table in the last".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::process::Command;

    const VECTORS: u32 = 0x0800_0000;

    fn image() -> [Stretch; 2] {
        let bytes = |length: u32| (0..length).map(|i| (i * 7 + i / 256) as u8).collect();
        [Stretch { address: VECTORS, bytes: bytes(404) }, Stretch { address: 0x0801_0000, bytes: bytes(70_001) }]
    }

    /// The expected offsets come from the tables of UM0391, not from the code that writes the file.
    #[test]
    fn the_file_is_laid_out_as_the_format_says() {
        let file = file("a board", &image());
        let word = |at: usize| u32::from_le_bytes(file[at..at + 4].try_into().unwrap());
        assert_eq!(file.len(), 11 + 274 + 8 + 70_001 + 8 + 404 + 16);
        assert_eq!(file[..6], *b"DfuSe\x01");
        assert_eq!(word(6) as usize, file.len() - 16);
        assert_eq!(file[10], 1);
        assert_eq!(file[11..17], *b"Target");
        assert_eq!((file[17], word(18)), (0, 1));
        assert_eq!(file[22..30], *b"a board\0");
        assert_eq!((word(277) as usize, word(281)), (8 + 70_001 + 8 + 404, 2));
        assert_eq!((word(285), word(289)), (0x0801_0000, 70_001));
        let last = 285 + 8 + 70_001;
        assert_eq!((word(last), word(last + 4)), (VECTORS, 404));
        let suffix = &file[file.len() - 16..];
        assert_eq!(suffix[2..12], [0x11, 0xDF, 0x83, 0x04, 0x1A, 0x01, b'U', b'F', b'D', 16]);
    }

    #[test]
    fn a_file_reads_back_and_damage_is_seen() {
        let file = file("a board", &image());
        check(&file, &image(), VECTORS).unwrap();
        for at in [0, 7, 11, 17, 280, 282, 290, 5000, file.len() - 17, file.len() - 9, file.len() - 1] {
            let mut damaged = file.clone();
            damaged[at] ^= 0x10;
            assert!(parse(&damaged).unwrap_err().contains("checksum"), "{at}");
            let body = damaged.len() - 4;
            let sum = checksum(&damaged[..body]);
            damaged[body..].copy_from_slice(&sum.to_le_bytes());
            assert!(at > body || check(&damaged, &image(), VECTORS).is_err(), "{at}");
        }
        assert!(parse(&file[..file.len() - 1]).is_err());
        assert!(parse(&[]).is_err());
    }

    #[test]
    fn two_elements_with_the_vector_table_last_are_required() {
        let [vectors, program] = image();
        let one = [vectors.clone()];
        assert!(check(&file("x", &one), &one, VECTORS).is_err());
        assert!(check(&file("x", &image()), &one, VECTORS).is_err());
        let other = [program, Stretch { address: 0x0802_F000, bytes: vec![1] }];
        assert!(check(&file("x", &other), &other, VECTORS).is_err());
        let wrong_way = Stretch { address: VECTORS - 4, ..vectors };
        let low = [wrong_way, image()[0].clone()];
        assert!(check(&file("x", &low), &low, VECTORS).is_err());
    }

    /// Needs `dfu-suffix`, a program of dfu-util. `.ci/run` installs dfu-util.
    #[test]
    fn dfu_util_takes_the_suffix() {
        let path = std::env::temp_dir().join(format!("oxmill-{}.dfu", std::process::id()));
        let judged = |bytes: &[u8]| {
            std::fs::write(&path, bytes).unwrap();
            Command::new("dfu-suffix").arg("--check").arg(&path).output().expect("Debian's package dfu-util").status
        };
        let mut file = file("a board", &image());
        assert!(judged(&file).success());
        file[100] ^= 1;
        assert!(!judged(&file).success());
        std::fs::remove_file(&path).unwrap();
    }
}
