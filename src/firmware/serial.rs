//! The links to the host: received bytes are split into realtime commands and bytes of lines, answers are sent.
//!
//! ```text
//!  USART ──▶ intake ─┐                                   ┌─▶ USART
//!                    ├─▶ realtime, lines   replies ─floor─┤
//!  USB   ──▶ intake ─┘                                   └─▶ USB
//! ```
//! Both links are listened to at once. Realtime commands act from either; lines are taken from the one that has the floor:
//! it changes when the machine has nothing to do, when its holder goes, and with a reset. A reset stops the step task
//! from here, before anyone has queued or decided anything.

use crate::boards::{Incoming, Port, SerialPort, UsbPort};
use crate::crossing::{self, HEARD, HOSTS_CAME, HOSTS_WENT, LINE_BYTES_IN, Owed, RX_HELD, SERIAL_ASKED, Wake};
use core::sync::atomic::{AtomicU32, Ordering};
use oxmill_controller::messages::{Chunk, LINES_DEPTH, LineByte, REALTIME_DEPTH, REPLIES_DEPTH, Realtime};
use oxmill_controller::{Floor, Intake, Queues, REFUSAL, Received, Splitter};
use rtic_sync::channel::{Receiver, Sender};

/// Line bytes of a USB host that are kept beyond the queue: two packets more than the one that must always fit.
const USB_HELD: usize = 3 * 64;
/// A UART's sender does not wait: the queue is all that it may fill.
const UART_HELD: usize = 1;

/// Number of the USART among the links, and of USB.
const UART: usize = 0;
const USB: usize = 1;

/// The ends of the queues to `control`.
struct ToControl {
    /// What finds no room may be owed: the link that is being read cannot wait.
    may_owe: bool,
    realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
    lines: Sender<'static, LineByte, LINES_DEPTH>,
}

/// Adds 1 to a count whose only writer is this task.
fn count(counter: &AtomicU32) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(1), Ordering::Relaxed);
}

impl Queues for ToControl {
    fn realtime(&mut self, command: Realtime) -> bool {
        count(&HEARD);
        let queued = !Owed::blocks(command) && self.realtime.try_send(command).is_ok();
        let owed = !queued && self.may_owe && Owed::add(command);
        if owed {
            crate::pend_step();
        }
        queued || owed
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let queued = self.lines.try_send(byte).is_ok();
        if queued {
            count(&HEARD);
            count(&LINE_BYTES_IN);
        }
        queued
    }

    fn waits(&self) -> bool {
        !self.may_owe
    }
}

/// What a link needs of the rest of the task to receive.
struct Room<'a, const OTHER: usize> {
    splitter: &'a mut Splitter,
    queues: &'a mut ToControl,
    /// The other link.
    other: &'a mut Intake<OTHER>,
    /// No answer is half sent.
    flushed: bool,
}

impl<const OTHER: usize> Room<'_, OTHER> {
    fn is_free(&self) -> bool {
        self.flushed && crossing::is_free()
    }
}

/// One link.
struct Link<P, const HELD: usize> {
    number: usize,
    port: P,
    intake: Intake<HELD>,
    open: bool,
    /// What is left of the refusals to be sent: so many, less so many bytes of the first.
    refusals: u8,
    refused_bytes: usize,
}

impl<P: Port, const HELD: usize> Link<P, HELD> {
    fn new(number: usize, port: P) -> Self {
        Link { number, port, intake: Intake::new(), open: false, refusals: 0, refused_bytes: 0 }
    }

    /// Asks for the floor. A line that the other host has begun and left there ends as a damaged one.
    fn claim<const OTHER: usize>(&self, floor: &mut Floor, firm: bool, room: &mut Room<OTHER>) -> bool {
        let before = floor.holder();
        let granted = floor.claim(self.number, room.is_free(), firm);
        if granted && before != self.number && !room.other.is_between_lines() {
            room.other.cut_off(room.splitter.epoch());
            room.other.pass_on(room.queues);
        }
        granted
    }

    /// Looks whether a host has come or gone. Whether there is news for `control`.
    fn look<const OTHER: usize>(&mut self, floor: &mut Floor, room: &mut Room<OTHER>) -> bool {
        let open = self.port.poll();
        if open == core::mem::replace(&mut self.open, open) {
            return false;
        }
        if open {
            // Another host's job goes on, and this one is not greeted in its midst.
            if self.claim(floor, true, room) {
                HOSTS_CAME.fetch_add(1, Ordering::Relaxed);
            }
        } else {
            self.intake.cut_off(room.splitter.epoch());
            self.refusals = 0;
            self.refused_bytes = 0;
            if floor.holder() == self.number {
                HOSTS_WENT.fetch_add(1, Ordering::Relaxed);
            }
            floor.leave(self.number);
        }
        true
    }

    /// Fetches what has come, as far as there is room. Whether there is news for `control`.
    fn receive<const OTHER: usize>(&mut self, floor: &mut Floor, room: &mut Room<OTHER>) -> bool {
        room.queues.may_owe = !P::WAITS;
        let mut news = self.intake.pass_on(room.queues);
        while self.intake.room() > 0 || !P::WAITS {
            let byte = match self.port.receive() {
                Incoming::Nothing => break,
                Incoming::Lost => {
                    self.intake.lose();
                    continue;
                }
                Incoming::Byte(byte) => byte,
            };
            let received = room.splitter.push(byte);
            match received {
                Received::Realtime(command) => {
                    if command == Realtime::Reset {
                        crossing::ask_for_stop();
                        crate::pend_step();
                        floor.seize(self.number);
                    }
                    if matches!(command, Realtime::Reset | Realtime::Stop) {
                        self.intake.begin_anew();
                        room.other.begin_anew();
                    }
                    self.claim(floor, false, room);
                }
                Received::Line(line) => {
                    if !self.claim(floor, true, room) {
                        if matches!(line.byte, b'\n' | b'\r') {
                            self.refusals = self.refusals.saturating_add(1);
                        }
                        continue;
                    }
                }
                Received::Nothing => {}
            }
            news |= self.intake.take(received, room.queues);
        }
        self.port.allow(self.intake.room());
        news
    }

    /// Sends what the host is refused. `false` while there is more of it.
    fn refuse(&mut self) -> bool {
        while self.refusals > 0 {
            let Some(byte) = REFUSAL.get(self.refused_bytes) else {
                self.refused_bytes = 0;
                self.refusals -= 1;
                continue;
            };
            if !self.port.send(*byte) {
                return false;
            }
            self.refused_bytes += 1;
        }
        true
    }
}

/// Everything the task owns.
pub struct Serial {
    splitter: Splitter,
    floor: Floor,
    uart: Link<SerialPort, UART_HELD>,
    usb: Link<UsbPort, USB_HELD>,
    queues: ToControl,
    replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
    sending: Chunk,
    sent: usize,
    wake: Wake,
}

impl Serial {
    /// Nothing received, nothing to send.
    pub fn new(
        uart: SerialPort,
        usb: UsbPort,
        realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
        lines: Sender<'static, LineByte, LINES_DEPTH>,
        replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
        wake: Wake,
    ) -> Serial {
        Serial {
            splitter: Splitter::new(),
            floor: Floor::new(),
            uart: Link::new(UART, uart),
            usb: Link::new(USB, usb),
            queues: ToControl { may_owe: false, realtime, lines },
            replies,
            sending: Chunk { len: 0, bytes: [0; 15] },
            sent: 0,
            wake,
        }
    }

    /// Called for a received byte or packet, for a sender that has become free, and by `control` (an answer to send; room
    /// in the queues).
    pub fn run(&mut self) {
        SERIAL_ASKED.store(false, Ordering::Relaxed);
        let Serial { splitter, floor, uart, usb, queues, .. } = self;
        let flushed = self.sent >= self.sending.as_bytes().len();
        let mut room = Room { splitter, queues, other: &mut usb.intake, flushed };
        let mut news = uart.receive(floor, &mut room);
        let mut room = Room { splitter, queues, other: &mut uart.intake, flushed };
        news |= usb.look(floor, &mut room);
        news |= usb.receive(floor, &mut room);
        RX_HELD.store(uart.intake.is_waiting() || usb.intake.is_waiting(), Ordering::Relaxed);
        news |= self.send();
        if news {
            self.wake.write(());
        }
    }

    /// Sends as much as the ports take. Whether room has come about in the queue of answers.
    fn send(&mut self) -> bool {
        let mut room = false;
        let (uart, usb) = (self.uart.refuse(), self.usb.refuse());
        let to_usb = self.floor.holder() == USB;
        let mut more = false;
        // A refusal is not torn by an answer.
        let clear = if to_usb { usb } else { uart };
        loop {
            if !clear {
                break;
            }
            let Some(byte) = self.sending.as_bytes().get(self.sent).copied() else {
                let Ok(chunk) = self.replies.try_recv() else { break };
                self.sending = chunk;
                self.sent = 0;
                room = true;
                continue;
            };
            let taken = if to_usb { self.usb.port.send(byte) } else { self.uart.port.send(byte) };
            if !taken {
                more = true;
                break;
            }
            self.sent += 1;
        }
        self.uart.port.call_when_free(!uart || more && !to_usb);
        self.usb.port.call_when_free(!usb || more && to_usb);
        room
    }
}
