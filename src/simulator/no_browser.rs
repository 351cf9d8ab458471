//! A port that takes lines must not take those of a browser: any web page that somebody visits can have one send a request to a
//! port of this computer, with lines of G-code in it. The first bytes of a browser are told from those of a host, and nothing
//! of such a connection is passed on.

use std::io::{self, ErrorKind, Read};

/// How the requests begin that a browser sends before it has asked this side. A line of G-code never does: after a letter there is
/// a value. The last one is an encrypted connection, whose bytes may be realtime commands.
const REQUESTS: [&[u8]; 10] =
    [b"GET ", b"POST ", b"HEAD ", b"OPTIONS ", b"PUT ", b"DELETE ", b"PATCH ", b"CONNECT ", b"TRACE ", b"\x16\x03"];

/// A reader that fails if a browser writes to it.
pub struct NoBrowser<R> {
    reader: R,
    /// The first bytes, as long as a request may begin with them.
    held: Option<Vec<u8>>,
}

impl<R: Read> NoBrowser<R> {
    /// Nothing has been read.
    pub fn new(reader: R) -> Self {
        Self { reader, held: Some(Vec::new()) }
    }

    /// Whether the first bytes are those of a request, as soon as they tell.
    fn is_request(first: &[u8]) -> Option<bool> {
        if REQUESTS.iter().any(|request| first.starts_with(request)) {
            return Some(true);
        }
        let open = REQUESTS.iter().any(|request| request.starts_with(first));
        (!open).then_some(false)
    }
}

impl<R: Read> Read for NoBrowser<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while let Some(held) = &mut self.held {
            // No more than fits: what has been read is given out at once.
            let room = buffer.len().saturating_sub(held.len());
            let length = self.reader.read(&mut buffer[..room])?;
            held.extend_from_slice(&buffer[..length]);
            match Self::is_request(held) {
                Some(true) => return Err(ErrorKind::InvalidData.into()),
                None if length > 0 => {}
                _ => {
                    let first = std::mem::take(held);
                    self.held = None;
                    buffer[..first.len()].copy_from_slice(&first);
                    return Ok(first.len());
                }
            }
        }
        self.reader.read(buffer)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Gives its pieces one by one.
    struct Pieces(Vec<&'static [u8]>);

    impl Read for Pieces {
        fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
            if self.0.is_empty() {
                return Ok(0);
            }
            let piece = self.0.remove(0);
            buffer[..piece.len()].copy_from_slice(piece);
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
        for first in
            [&[b"POST / HTTP/1.1\r\n\r\nG0 X9\n" as &[u8]][..], &[b"P", b"U", b"T", b" /"], &[b"\x16", b"\x03\x01\x18"]]
        {
            assert!(read(first).is_err(), "{first:?}");
        }
    }

    #[test]
    fn hosts_are_read_byte_by_byte() {
        for pieces in [&[b"G" as &[u8], b"0X1\n", b"GET "][..], &[b"?"], &[b"GE", b"!"], &[b"P"], &[]] {
            assert_eq!(read(pieces).unwrap(), pieces.concat(), "{pieces:?}");
        }
    }

    #[test]
    fn bytes_that_tell_nothing_are_no_end() {
        let mut reader = NoBrowser::new(Pieces(vec![b"G", b"0"]));
        assert_eq!(reader.read(&mut [0; 8]).unwrap(), 2);
    }
}
