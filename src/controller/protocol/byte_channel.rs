//! Carries bytes of lines from the serial task to the control task: [`LineSender`] packs them into messages, and
//! [`LineReader`] takes them out.
//!
//! ```text
//!  link ──byte──▶ LineSender ──message──▶ queue ──▶ LineReader ──byte──▶ controller
//!                    │ full, of another epoch, or: no more bytes now, and few messages are on the way that are not full
//! ```
//! A queue has room for a number of messages. So that [`LINES_DEPTH`](crate::messages::LINES_DEPTH) bytes fit also from a link
//! that brings them one at a time, at most [`MOST_PARTIAL`] messages of them go out before they are full; after these, bytes
//! wait until a message is full or the queue has been emptied. Bytes of another epoch begin a message, for which there is room
//! with every line. A host that comes or goes costs two of them.

use crate::messages::{LineByte, LineBytes, MOST_PARTIAL};

/// The sending side.
#[derive(Clone, Copy, Debug)]
pub struct LineSender {
    gathered: LineBytes,
    /// Messages sent before they were full since the queue was last seen empty.
    partial: usize,
}

/// Nothing gathered.
impl Default for LineSender {
    #[inline]
    fn default() -> Self {
        Self { gathered: LineBytes::EMPTY, partial: 0 }
    }
}

impl LineSender {
    /// Takes a byte. `send` queues a message if there is room. `false`: no room, nothing done.
    #[inline]
    pub fn push(&mut self, byte: LineByte, send: impl FnOnce(LineBytes) -> bool) -> bool {
        if self.gathered.push(byte) {
            return true;
        }
        let sent = send(self.gathered);
        if sent {
            self.gathered = LineBytes::EMPTY;
            self.gathered.push(byte);
        }
        sent
    }

    /// Takes undamaged bytes of an epoch, as many of them as there is room for. Gives how many.
    #[inline]
    pub fn extend(&mut self, epoch: u16, bytes: &[u8], mut send: impl FnMut(LineBytes) -> bool) -> usize {
        let mut count = 0;
        while let Some(left) = bytes.get(count..).filter(|left| !left.is_empty()) {
            let taken = self.gathered.extend(epoch, left);
            count += taken;
            if taken == 0 {
                if !send(self.gathered) {
                    break;
                }
                self.gathered = LineBytes::EMPTY;
            }
        }
        count
    }

    /// There are no more bytes now: what is gathered is sent, unless it has to wait. `is_empty`: nothing is in the queue. Whether
    /// it has been sent.
    #[inline]
    pub fn flush(&mut self, is_empty: bool, send: impl FnOnce(LineBytes) -> bool) -> bool {
        if is_empty {
            self.partial = 0;
        }
        let is_full = self.gathered.len() == LineBytes::MOST;
        if self.gathered.is_empty() || !is_full && self.partial == MOST_PARTIAL || !send(self.gathered) {
            return false;
        }
        self.gathered = LineBytes::EMPTY;
        self.partial += usize::from(!is_full);
        true
    }

    /// Whether bytes wait: for more of them, for room, or until the queue has been emptied.
    #[inline]
    pub fn is_waiting(&self) -> bool {
        !self.gathered.is_empty()
    }
}

/// The receiving side.
#[derive(Clone, Copy, Debug)]
pub struct LineReader {
    message: LineBytes,
    next: usize,
}

/// Nothing received.
impl Default for LineReader {
    #[inline]
    fn default() -> Self {
        Self { message: LineBytes::EMPTY, next: 0 }
    }
}

impl LineReader {
    /// The epoch and the bytes that come next, as far as they have been received and are none that loss has damaged.
    #[inline]
    pub fn ahead(&self) -> (u16, &[u8]) {
        self.message.undamaged(self.next)
    }

    /// So many of these have been taken.
    #[inline]
    pub fn pass(&mut self, count: usize) {
        self.next += count;
    }

    /// The next byte, which stays. `receive` takes a message out of the queue if there is one.
    #[inline]
    pub fn peek(&mut self, receive: impl FnOnce() -> Option<LineBytes>) -> Option<LineByte> {
        if let Some(byte) = self.message.get(self.next) {
            return Some(byte);
        }
        self.message = receive()?;
        self.next = 0;
        self.message.get(0)
    }

    /// The next byte. `receive` takes a message out of the queue if there is one.
    #[inline]
    pub fn next(&mut self, receive: impl FnOnce() -> Option<LineBytes>) -> Option<LineByte> {
        let byte = self.peek(receive)?;
        self.next += 1;
        Some(byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::messages::{LINE_MESSAGES, LINES_DEPTH};
    use proptest::prelude::*;
    use std::collections::VecDeque;

    /// Both sides and the queue between them.
    #[derive(Default)]
    struct Crossing {
        line_sender: LineSender,
        queue: VecDeque<LineBytes>,
        reader: LineReader,
    }

    impl Crossing {
        fn push(&mut self, byte: LineByte) -> bool {
            let queue = &mut self.queue;
            self.line_sender.push(byte, |message| send(queue, message))
        }

        fn extend(&mut self, epoch: u16, bytes: &[u8]) -> usize {
            let queue = &mut self.queue;
            self.line_sender.extend(epoch, bytes, |message| send(queue, message))
        }

        fn flush(&mut self) {
            let (is_empty, queue) = (self.queue.is_empty(), &mut self.queue);
            self.line_sender.flush(is_empty, |message| send(queue, message));
        }

        /// As `control` reads: once the queue is empty, the serial task is called for what waits.
        fn read(&mut self) -> Option<LineByte> {
            let byte = self.reader.next(|| self.queue.pop_front());
            if byte.is_none() && self.line_sender.is_waiting() {
                self.flush();
                return self.reader.next(|| self.queue.pop_front());
            }
            byte
        }
    }

    fn send(queue: &mut VecDeque<LineBytes>, message: LineBytes) -> bool {
        let room = queue.len() < LINE_MESSAGES;
        if room {
            queue.push_back(message);
        }
        room
    }

    #[test]
    fn a_message_is_no_larger_than_five_words() {
        assert_eq!(size_of::<LineBytes>(), 20);
    }

    proptest! {
        /// Bytes come out as they went in, and a full queue refuses without losing one.
        #[test]
        fn bytes_cross_in_their_order(
            steps in proptest::collection::vec((0_u8..10, any::<u8>(), 0_u16..3, any::<bool>()), 0..2000),
        ) {
            let (mut crossing, mut expected) = (Crossing::default(), VecDeque::new());
            for (step, byte, epoch, damaged) in steps {
                match step {
                    0 => crossing.flush(),
                    1..4 => prop_assert_eq!(crossing.read(), expected.pop_front()),
                    4 => {
                        let bytes = [byte; 40];
                        let taken = crossing.extend(epoch, bytes.get(..usize::from(byte % 40)).unwrap());
                        expected.extend((0..taken).map(|_| LineByte { byte, epoch, damaged: false }));
                    }
                    5 => {
                        let (epoch, ahead) = crossing.reader.ahead();
                        for byte in ahead {
                            prop_assert_eq!(Some(LineByte { byte: *byte, epoch, damaged: false }), expected.pop_front());
                        }
                        let count = ahead.len();
                        crossing.reader.pass(count);
                    }
                    _ => {
                        let byte = LineByte { byte, epoch, damaged };
                        if crossing.push(byte) {
                            expected.push_back(byte);
                        }
                    }
                }
            }
            while let Some(byte) = expected.pop_front() {
                prop_assert_eq!(crossing.read(), Some(byte));
            }
            prop_assert_eq!(crossing.read(), None);
        }

        /// As many bytes fit as senders are told, however they arrive and whatever has been read before them.
        #[test]
        fn all_bytes_that_are_promised_fit(
            before in proptest::collection::vec((any::<bool>(), any::<bool>()), 0..600),
            flushes in proptest::collection::vec(any::<bool>(), LINES_DEPTH),
            always in any::<bool>(),
            line in prop_oneof![Just(LINES_DEPTH), 8_usize..40],
        ) {
            let mut crossing = Crossing::default();
            let (mut inside, mut sent) = (0, 0);
            // Behind each line comes a jog cancel, or none ever comes.
            let mut next = || {
                sent += 1;
                LineByte { byte: b'1', epoch: ((sent - 1) / line) as u16, damaged: false }
            };
            for (reads, flushes) in before {
                if reads {
                    inside -= usize::from(crossing.read().is_some());
                } else if inside < LINES_DEPTH {
                    prop_assert!(crossing.push(next()));
                    inside += 1;
                }
                if flushes {
                    crossing.flush();
                }
            }
            for flushes in flushes.into_iter().skip(inside) {
                prop_assert!(crossing.push(next()), "{inside}");
                inside += 1;
                if flushes || always {
                    crossing.flush();
                }
            }
            prop_assert_eq!(inside, LINES_DEPTH);
        }
    }
}
