//! Detects files that cannot be a job: empty files, binary files and UTF-16 text. Looks only at the first bytes, before
//! any line is read.

/// Checks that a file can be a job. `begin`: its first bytes. `is_all`: `true` if these are the whole file.
///
/// # Errors
/// If the bytes are UTF-16 or binary, or if the file is empty. The error says what the file is and what to do.
pub fn refuse(begin: &[u8], is_all: bool) -> Result<(), &'static str> {
    if is_utf16(begin) {
        return Err("it is UTF-16 text, and a machine reads one byte for each character: save it as UTF-8 or ASCII");
    }
    if is_binary(begin) {
        return Err(
            "it is a binary file, and G-code is plain text: is it compressed, or the project of a CAM program?",
        );
    }
    let blank = |byte: &u8| byte.is_ascii_whitespace();
    if is_all && begin.strip_prefix(b"\xEF\xBB\xBF").unwrap_or(begin).iter().all(blank) {
        return Err("it is empty: there is no line for a machine in it");
    }
    Ok(())
}

/// Returns whether the text has a UTF-16 byte order mark, or looks like ASCII in UTF-16. Such text has a 0 in nearly
/// every second byte: in nine tenths of the even or of the odd bytes, and in none of the other half.
fn is_utf16(begin: &[u8]) -> bool {
    if begin.starts_with(b"\xFF\xFE") || begin.starts_with(b"\xFE\xFF") {
        return true;
    }
    let pairs = begin.as_chunks::<2>().0;
    let zeros = |side: usize| pairs.iter().filter(|pair| pair[side] == 0).count();
    let (first, second) = (zeros(0), zeros(1));
    pairs.len() >= 2 && first.min(second) == 0 && first.max(second) * 10 >= pairs.len() * 9
}

/// Returns whether there is a 0 byte, or more than one control character per 20 bytes on average.
fn is_binary(begin: &[u8]) -> bool {
    // Text files may contain the control characters of a paper tape reader (0x11 to 0x14) and the DOS end of file
    // (0x1A).
    let is_control = |byte: &&u8| matches!(byte, 0..=8 | 0x0E..=0x10 | 0x15..=0x19 | 0x1B..=0x1F | 0x7F);
    begin.contains(&0) || begin.iter().filter(is_control).count() * 20 > begin.len()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_no_text_is_named() {
        let refused = |begin: &[u8]| refuse(begin, true).err();
        let utf16 = |order: fn(u16) -> [u8; 2], text: &str| text.encode_utf16().flat_map(order).collect::<Vec<u8>>();
        for text in ["\u{FEFF}G20\r\nG1 X1\r\n", "G20\r\nG1 X1\r\n", "\u{FEFF}(原点)\n"] {
            assert!(refused(&utf16(u16::to_le_bytes, text)).unwrap().contains("UTF-16"), "{text}");
            assert!(refused(&utf16(u16::to_be_bytes, text)).unwrap().contains("UTF-16"), "{text}");
        }
        let random: Vec<u8> = (0..4000_u32).map(|n| (n.wrapping_mul(2_654_435_761) >> 24) as u8).collect();
        for binary in [&random[..], b"PK\x03\x04\x14\x00\x08\x08", b"\x7FELF\x02\x01\x01\0\0\0", b"G0\0X1"] {
            assert!(refused(binary).unwrap().contains("binary"), "{binary:?}");
        }
        for empty in [&b""[..], b"\n \r\n\t", b"\xEF\xBB\xBF", b"\xEF\xBB\xBF\r\n"] {
            assert!(refused(empty).unwrap().contains("empty"), "{empty:?}");
        }
        for text in [
            &b"G0\n"[..],
            b"%\n",
            b"(a)",
            b"\x12G0 X1\r\nM30\r\n\x1A",
            "(Äußere Kontur 切削)\n".as_bytes(),
            b"(Stra\xDFe)\n",
        ] {
            assert_eq!(refused(text), None, "{text:?}");
        }
        assert_eq!(refuse(b"\n", false), Ok(()), "more may come");
    }
}
