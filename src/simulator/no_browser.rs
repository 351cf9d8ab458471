//! Keeps browsers away from ports that take lines, because any web page can make a browser send a request to a port of
//! this computer, and the request could contain G-code. If the first line of a connection is an HTTP request or the
//! beginning of TLS, a browser has sent the line. Reading then fails. Up to then, only realtime commands before that
//! line have been passed on.

use std::io::{self, ErrorKind, Read};

/// Beginning of an encrypted connection (RFC 8446, 5.1). The bytes after it are arbitrary and could be taken for
/// realtime commands.
const TLS: &[u8] = b"\x16\x03";
/// A first line of more bytes than this counts as a request, because web addresses can be long. No line that the
/// firmware accepts is so long.
const LONGEST_LINE: usize = 1024;

/// Maximum length of an HTTP method. A page cannot use a longer one without a preflight request (OPTIONS), which is
/// recognized.
const LONGEST_METHOD: usize = 64;

/// Wraps the reader of a connection. Reads fail if the first line is what a browser would send: an HTTP request, or the
/// beginning of TLS. A line longer than `LONGEST_LINE` counts as a request.
pub struct NoBrowser<R> {
    reader: R,
    /// The first line so far, while it can still become an HTTP request or the beginning of TLS.
    first: Option<Vec<u8>>,
    /// Harmless bytes from `reader` that `read` has not returned yet.
    passed: Vec<u8>,
}

impl<R: Read> NoBrowser<R> {
    /// Wraps a reader from which nothing has been read.
    pub fn new(reader: R) -> Self {
        Self { reader, first: Some(Vec::new()), passed: Vec::new() }
    }
}

/// Returns whether a first line comes from a browser. Such a line is the beginning of TLS, or an HTTP request
/// `METHOD TARGET HTTP/1.1` (RFC 9112, 3). The method can have any name, because a page can choose the name. Returns
/// `None` if more bytes are needed to decide.
fn is_request(first: &[u8]) -> Option<bool> {
    if first.starts_with(TLS) {
        return Some(true);
    }
    if TLS.starts_with(first) {
        return None;
    }
    let line = first.split(|byte| *byte == b'\n').next().unwrap_or(first);
    let method = line.split(|byte| *byte == b' ').next().unwrap_or(line);
    let is_text = line.iter().all(|byte| (b' '..=b'~').contains(byte) || *byte == b'\r');
    if !is_text || method.len() > LONGEST_METHOD || method.iter().any(|byte| b"\"(),/:;<=>?@[\\]{}".contains(byte)) {
        return Some(false);
    }
    // The target of a browser's request begins with a slash, even if a page has chosen a method such as `G1`. So
    // `G1 X5` is no request. Other targets (`*`, or addresses for a proxy) occur only with methods that have no
    // digits.
    let target = line.get(method.len() + 1);
    if method.iter().any(u8::is_ascii_digit) && target.is_some_and(|begin| *begin != b'/') {
        return Some(false);
    }
    if line.len() < first.len() {
        let version = line.trim_ascii_end().rsplit(|byte| *byte == b' ').next().unwrap_or(line);
        return Some(version.len() == 8 && version.starts_with(b"HTTP/"));
    }
    (line.len() > LONGEST_LINE).then_some(true)
}

/// Returns whether a byte is a Grbl realtime command, which is executed without a line.
pub fn is_realtime(byte: u8) -> bool {
    b"!?~\x18".contains(&byte) || byte >= 0x80
}

impl<R: Read> Read for NoBrowser<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let (Some(first), true) = (&mut self.first, self.passed.is_empty()) {
            let mut piece = [0; 256];
            let length = self.reader.read(&mut piece)?;
            first.extend_from_slice(&piece[..length]);
            let realtime = first.iter().take_while(|byte| is_realtime(**byte)).count();
            self.passed.extend(first.drain(..realtime));
            match is_request(first) {
                Some(true) => return Err(ErrorKind::InvalidData.into()),
                None if length > 0 => {}
                _ => {
                    self.passed.append(first);
                    self.first = None;
                }
            }
        }
        if self.passed.is_empty() {
            return self.reader.read(buffer);
        }
        let length = self.passed.len().min(buffer.len());
        buffer[..length].copy_from_slice(&self.passed[..length]);
        self.passed.drain(..length);
        Ok(length)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A reader that returns one of its pieces with each read.
    struct Pieces(Vec<&'static [u8]>);

    impl Read for Pieces {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            if self.0.is_empty() {
                return Ok(0);
            }
            let (piece, rest) = self.0[0].split_at(self.0[0].len().min(buffer.len()));
            buffer[..piece.len()].copy_from_slice(piece);
            self.0[0] = rest;
            self.0.retain(|piece| !piece.is_empty());
            Ok(piece.len())
        }
    }

    fn read(pieces: &[&'static [u8]]) -> io::Result<Vec<u8>> {
        let (mut reader, mut all, mut buffer) = (NoBrowser::new(Pieces(pieces.to_vec())), Vec::new(), [0; 64]);
        loop {
            match reader.read(&mut buffer)? {
                0 => return Ok(all),
                length => all.extend_from_slice(&buffer[..length]),
            }
        }
    }

    #[test]
    fn a_request_is_refused_however_it_is_cut() {
        let long = [b"GET /".as_slice(), &[b'a'; LONGEST_LINE]].concat().leak();
        for first in [
            &[b"POST / HTTP/1.1\r\n\r\nG0 X9\n" as &[u8]][..],
            &[b"P", b"U", b"T", b" /", b" HTTP", b"/1.0\r", b"\n"],
            &[b"patch / HTTP/1.1\r\n"],
            &[b"G0 /?X1 HTTP/1.1\n"],
            &[b"~", b"! / HTTP/1.1\n"],
            &[long],
            &[b"\x16", b"\x03\x01\x18"],
        ] {
            let mut passed = vec![];
            let mut reader = NoBrowser::new(Pieces(first.to_vec()));
            let (mut buffer, mut refused) = ([0; 64], false);
            while !refused {
                match reader.read(&mut buffer) {
                    Ok(0) => break,
                    Ok(length) => passed.extend_from_slice(&buffer[..length]),
                    Err(_) => refused = true,
                }
            }
            assert!(refused && passed.iter().all(|byte| is_realtime(*byte)), "{first:?}: {passed:?}");
        }
    }

    #[test]
    fn hosts_are_read_byte_by_byte() {
        for pieces in [
            &[b"G" as &[u8], b"0X1\n", b"GET / HTTP/1.1\r\n"][..],
            &[b"?"],
            &[b"?", b"!", b"$$\n"],
            &[b"G0 X10", b" (a HTTP/1.1)\n"],
            &[b"(a HTTP/1.1)\n"],
            &[b"probe 1\n", b"steps\n"],
            &[b"P"],
            &[],
        ] {
            assert_eq!(read(pieces).unwrap(), pieces.concat(), "{pieces:?}");
        }
    }

    #[test]
    fn realtime_commands_do_not_wait_for_a_line() {
        let mut reader = NoBrowser::new(Pieces(vec![b"?", b"\x18!", b"$X"]));
        let mut buffer = [0; 8];
        assert_eq!(reader.read(&mut buffer).unwrap(), 1);
        assert_eq!(reader.read(&mut buffer).unwrap(), 2);
        // A realtime command within a line is passed on before the line ends, too.
        let mut reader = NoBrowser::new(Pieces(vec![b"G1 ", b"X", b"!", b"~"]));
        for read in [b"G1 X" as &[u8], b"!", b"~"] {
            let length = reader.read(&mut buffer).unwrap();
            assert_eq!(&buffer[..length], read);
        }
    }
}
