//! The link to the host: received bytes are split into realtime commands and bytes of lines, answers are sent.
//!
//! A reset stops the step task from here, before anyone has queued or decided anything.

use crate::boards::{BACK_PRESSURE, Incoming, SerialPort};
use crate::crossing::{self, LINE_BYTES_IN, Owed, RX_HELD, SERIAL_ASKED, Wake};
use core::sync::atomic::Ordering;
use oxmill_controller::messages::{Chunk, LINES_DEPTH, LineByte, REALTIME_DEPTH, REPLIES_DEPTH, Realtime};
use oxmill_controller::{Received, Splitter};
use rtic_sync::channel::{Receiver, Sender};

/// Everything the task owns.
pub struct Serial {
    port: SerialPort,
    splitter: Splitter,
    realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
    lines: Sender<'static, LineByte, LINES_DEPTH>,
    replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
    /// Bytes were lost; the next byte of a line will say so.
    lost: bool,
    /// Received, split, and without room in its queue; nothing more is fetched meanwhile.
    held: Option<Received>,
    sending: Chunk,
    sent: usize,
    wake: Wake,
}

impl Serial {
    /// Nothing received, nothing to send.
    pub fn new(
        port: SerialPort,
        realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
        lines: Sender<'static, LineByte, LINES_DEPTH>,
        replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
        wake: Wake,
    ) -> Serial {
        let sending = Chunk { len: 0, bytes: [0; 15] };
        Serial {
            port,
            splitter: Splitter::new(),
            realtime,
            lines,
            replies,
            lost: false,
            held: None,
            sending,
            sent: 0,
            wake,
        }
    }

    /// Called for a received byte, for a sender that has become free, and by `control` (an answer to send; room in the
    /// line queue).
    pub fn run(&mut self) {
        SERIAL_ASKED.store(false, Ordering::Relaxed);
        let received = self.receive();
        let sent = self.send();
        if received || sent {
            self.wake.write(());
        }
    }

    /// Fetches what has come. Whether there is news for `control`.
    fn receive(&mut self) -> bool {
        let mut news = false;
        if let Some(held) = self.held.take() {
            news |= self.pass_on(held);
        }
        while self.held.is_none() {
            match self.port.receive() {
                Incoming::Nothing => break,
                Incoming::Lost => {
                    self.lost = true;
                }
                Incoming::Byte(byte) => {
                    let received = self.splitter.push(byte);
                    if received == Received::Realtime(Realtime::Reset) {
                        crossing::ask_for_stop();
                        crate::pend_step();
                    }
                    news |= self.pass_on(received);
                }
            }
        }
        if self.held.is_some() {
            self.port.quiet();
        }
        RX_HELD.store(self.held.is_some(), Ordering::Relaxed);
        news
    }

    /// Queues what was received. Without room it is held where the link has back-pressure, otherwise reported as lost:
    /// a UART would overwrite the next byte anyway, and realtime commands must get past.
    fn pass_on(&mut self, received: Received) -> bool {
        let queued = match received {
            Received::Nothing => return false,
            Received::Realtime(command) => {
                let queued = !Owed::blocks(command) && self.realtime.try_send(command).is_ok();
                let owed = !queued && !BACK_PRESSURE && Owed::add(command);
                if owed {
                    crate::pend_step();
                }
                queued || owed
            }
            Received::Line(byte) => {
                let queued = self.lines.try_send(LineByte { damaged: self.lost, ..byte }).is_ok();
                if queued {
                    self.lost = false;
                    LINE_BYTES_IN.store(LINE_BYTES_IN.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
                }
                queued
            }
        };
        if !queued {
            if BACK_PRESSURE {
                self.held = Some(received);
            } else {
                self.lost = true;
            }
        }
        queued
    }

    /// Sends as much as the port takes. Whether room has come about in the queue of answers.
    fn send(&mut self) -> bool {
        let mut room = false;
        loop {
            let Some(byte) = self.sending.as_bytes().get(self.sent).copied() else {
                match self.replies.try_recv() {
                    Ok(chunk) => {
                        self.sending = chunk;
                        self.sent = 0;
                        room = true;
                        continue;
                    }
                    Err(_) => {
                        self.port.call_when_free(false);
                        return room;
                    }
                }
            };
            if !self.port.send(byte) {
                self.port.call_when_free(true);
                return room;
            }
            self.sent += 1;
        }
    }
}
