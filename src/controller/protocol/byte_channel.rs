//! Carries line bytes from the serial task to the control task: [`LineSender`] packs them into messages, and
//! [`LineReader`] unpacks them.
//!
//! ```text
//!  link ──byte──▶ LineSender ──message──▶ queue ──▶ LineReader ──byte──▶ controller
//!                    │ sends when full, at a new epoch, or when no more bytes are available (with a limit)
//! ```
//! The queue has room for a limited number of messages. A message can be sent although it still has room for bytes, but
//! at most [`MOST_PARTIAL`] times. So [`LINES_DEPTH`](crate::messages::LINES_DEPTH) bytes fit even if they arrive one
//! at a time. After that many such messages, bytes wait until their message is full or the queue is empty.
//!
//! Bytes of another epoch (after a reset, stop or jog cancel) begin a new message. The queue has room for this even
//! if every line begins a new epoch. Each host that connects or disconnects uses up two messages: its `HOST_CHANGED`
//! has another epoch than the bytes before and after it.

use crate::messages::{LineByte, LineBytes, MOST_PARTIAL};

/// Sending side of the channel, in the serial task: packs line bytes into messages.
#[derive(Clone, Copy, Debug)]
pub struct LineSender {
    gathered: LineBytes,
    /// Number of messages sent although they had room for more bytes, counted since the queue was last empty.
    partial: usize,
}

impl Default for LineSender {
    #[inline]
    fn default() -> Self {
        Self { gathered: LineBytes::EMPTY, partial: 0 }
    }
}

impl LineSender {
    /// Takes a byte. `send` puts a message into the queue, and returns whether there was room for it. Returns `false`
    /// if the byte was not taken, because there was no room.
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

    /// Takes bytes from the front of `bytes`, as long as there is room. All of them are undamaged and belong to
    /// `epoch`. Returns how many were taken.
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

    /// Sends the bytes taken so far, unless the limit of partial messages makes them wait. Call it when no more bytes
    /// have arrived. `is_empty`: the queue is empty. Returns whether a message was sent.
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

    /// Returns whether bytes that were taken have not been sent yet. They wait for more bytes, for room in the queue,
    /// or until the queue is empty.
    #[inline]
    pub fn is_waiting(&self) -> bool {
        !self.gathered.is_empty()
    }
}

/// Receiving side of the channel, in the control task: takes line bytes out of messages.
#[derive(Clone, Copy, Debug)]
pub struct LineReader {
    message: LineBytes,
    next: usize,
}

impl Default for LineReader {
    #[inline]
    fn default() -> Self {
        Self { message: LineBytes::EMPTY, next: 0 }
    }
}

impl LineReader {
    /// Returns the epoch and the remaining bytes of the message being read. Returns no bytes if the message contains a
    /// damaged byte.
    #[inline]
    pub fn ahead(&self) -> (u16, &[u8]) {
        self.message.undamaged(self.next)
    }

    /// Skips `count` of the bytes that [`LineReader::ahead`] returned.
    #[inline]
    pub fn pass(&mut self, count: usize) {
        self.next += count;
    }

    /// Returns the next byte without removing it. `receive` takes a message from the queue if there is one.
    #[inline]
    pub fn peek(&mut self, receive: impl FnOnce() -> Option<LineBytes>) -> Option<LineByte> {
        if let Some(byte) = self.message.get(self.next) {
            return Some(byte);
        }
        self.message = receive()?;
        self.next = 0;
        self.message.get(0)
    }

    /// Removes and returns the next byte. `receive` takes a message from the queue if there is one.
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

        /// Reads as `control` does: if the queue is empty, the serial task is called to send the bytes that wait.
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
        /// Bytes come out as they went in. If the queue is full, a byte is not taken, and none of the bytes taken
        /// earlier is lost.
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

        /// `LINES_DEPTH` bytes always fit, however they arrive and whatever was read before.
        #[test]
        fn all_bytes_that_are_promised_fit(
            before in proptest::collection::vec((any::<bool>(), any::<bool>()), 0..600),
            flushes in proptest::collection::vec(any::<bool>(), LINES_DEPTH),
            always in any::<bool>(),
            line in prop_oneof![Just(LINES_DEPTH), 8_usize..40],
        ) {
            let mut crossing = Crossing::default();
            let (mut inside, mut sent) = (0, 0);
            // The epoch changes after every `line` bytes, as if each line had this length and were followed by a jog
            // cancel.
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
