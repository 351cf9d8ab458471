//! The links to the host, UART and USB: received bytes are split into realtime commands and bytes of lines and queued
//! for `control`, and answers are sent to the host that has the machine.
//!
//! ```text
//!  USART ──▶ link ───┐                                   ┌─▶ USART
//!                    ├─▶ realtime, lines   replies ─floor─┤
//!  USB   ──▶ link ───┘                                   └─▶ USB
//! ```
//! Both links are listened to at once. Realtime commands act from either; lines are taken from the one that has the floor:
//! it changes when the machine has nothing to do, when its holder goes, and with a reset. A reset stops the step task
//! from here, before anyone has queued or decided anything.

use crate::boards::{self, Incoming, Port, SerialPort, UsbPort};
use crate::shared::{self, ASKED, CONTROL, SERIAL, Wake};
use core::sync::atomic::{AtomicU32, Ordering};
use oxmill_controller::messages::{Chunk, LINE_MESSAGES, LineByte, LineBytes, REALTIME_DEPTH, REPLIES_DEPTH, Realtime};
use oxmill_controller::protocol::link::{AMBIGUOUS_US, MOST_HELD};
use oxmill_controller::{HostArbiter, LineSender, Link, Queues};
use rtic_sync::channel::{Receiver, Sender};
use rtic_sync::signal::SignalWriter;

/// Bytes of a USB packet.
const PACKET: usize = 64;
/// A UART's sender does not wait: the queue is all that it may fill.
const UART_HELD: usize = 1;

/// Bytes that are not queued as parts of lines which are taken at once, and how many microseconds make up for one of them: a host, or
/// noise on a wire, that sends them without end is not to take all of the processor.
const MOST_OTHERS: u32 = 128;
const OTHER_US: u32 = 200;
/// Bytes of a link that cannot wait which are taken one by one in so many µs, as they are no plain text: more than lines of 15
/// characters that end by CR LF have in that time at 1 Mbaud, and so few that `control` gets on with its work. A host that counts what it sends has no
/// more under way than there is room for.
const MOST_SINGLY: usize = 12;
const SINGLY_US: u32 = 800;
/// Runs in which nothing comes behind a `!` that may be text, before it is a command: some 500 us apart.
const QUIET_RUNS: u8 = 16;

/// Number of the USART among the links, and of USB.
const UART: usize = 0;
const USB: usize = 1;

/// The ends of the queues to `control`.
struct ToControl {
    /// What finds no room may be owed: the link that is being read cannot wait.
    may_owe: bool,
    /// No answer waits, or is half sent.
    flushed: bool,
    realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
    lines: Sender<'static, LineBytes, LINE_MESSAGES>,
    line_sender: LineSender,
    /// Line bytes queued in this run.
    bytes_queued: u32,
    /// Bytes that are no parts of lines that may still be taken, and since when one has been made up for.
    others: u32,
    others_since: u32,
    /// Others have come that may not be taken yet, and the task is to be called again.
    leaves_unread: bool,
    left_unread: SignalWriter<'static, ()>,
}

impl ToControl {
    /// Counts what may be taken again of bytes that are no parts of lines.
    fn allow_others(&mut self) {
        let more = boards::clock_ticks().wrapping_sub(self.others_since) / (OTHER_US * boards::CLOCK_TICKS_PER_US);
        self.others = MOST_OTHERS.min(self.others.saturating_add(more));
        self.others_since = self.others_since.wrapping_add(more * OTHER_US * boards::CLOCK_TICKS_PER_US);
    }

    /// No more bytes come in this run. Whether there is news for `control`.
    fn flush(&mut self) -> bool {
        let Self { lines, line_sender, .. } = self;
        // To the sender a queue is empty only when the receiver is done with its last message.
        line_sender.is_waiting() && line_sender.flush(lines.is_empty(), |message| lines.try_send(message).is_ok())
    }
}

/// Adds to a count whose only writer is this task.
fn count(counter: &AtomicU32, by: u32) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(by), Ordering::Relaxed);
}

impl Queues for ToControl {
    fn realtime(&mut self, command: Realtime) -> bool {
        count(&SERIAL.heard, 1);
        let queued = !shared::owes() && self.realtime.try_send(command).is_ok();
        let owed = !queued && self.may_owe && shared::owe(command);
        if owed {
            boards::call_step();
        }
        queued || owed
    }

    fn line(&mut self, byte: LineByte) -> bool {
        let Self { lines, line_sender, .. } = self;
        let queued = line_sender.push(byte, |message| lines.try_send(message).is_ok());
        self.bytes_queued += u32::from(queued);
        queued
    }

    fn text(&mut self, epoch: u16, bytes: &[u8]) -> usize {
        let Self { lines, line_sender, .. } = self;
        let queued = line_sender.extend(epoch, bytes, |message| lines.try_send(message).is_ok());
        self.bytes_queued += queued as u32;
        queued
    }

    fn waits(&self) -> bool {
        !self.may_owe
    }

    fn is_free(&self) -> bool {
        self.flushed && self.bytes_queued == 0 && shared::is_free()
    }

    fn stop(&mut self) {
        shared::ask_for_stop();
        boards::call_step();
    }

    fn ignored(&mut self) {
        count(&SERIAL.bytes_ignored, 1);
    }

    fn reads_characters(&self) -> bool {
        CONTROL.reads_characters.load(Ordering::Relaxed)
    }
}

/// A link and its port.
struct Ported<P> {
    port: P,
    link: Link,
    open: bool,
    /// Bytes taken one by one, and since when they are counted.
    singly: usize,
    singly_since: u32,
    /// Since when, and in how many runs, nothing has come behind a `!` that may be text.
    quiet_since: u32,
    quiet_runs: u8,
}

impl<P: Port> Ported<P> {
    const fn new(number: usize, port: P, may_hold: usize) -> Self {
        Ported {
            port,
            link: Link::new(number, may_hold),
            open: false,
            singly: 0,
            singly_since: 0,
            quiet_since: 0,
            quiet_runs: 0,
        }
    }

    /// Looks whether a host has come or gone. Whether there is news for `control`.
    fn look(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &ToControl) -> bool {
        let mut news = false;
        // One host may go and another come at the same moment.
        for _ in 0..2 {
            let open = self.port.poll();
            if open == core::mem::replace(&mut self.open, open) {
                break;
            }
            news = true;
            if open {
                if self.link.came(arbiter, other, queues) {
                    SERIAL.hosts_came.fetch_add(1, Ordering::Relaxed);
                }
            } else if self.link.went(arbiter) {
                SERIAL.hosts_went.store(arbiter.gone(), Ordering::Relaxed);
            }
        }
        news
    }

    /// Fetches what has come, as far as there is room. Whether there is news for `control`.
    fn receive(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut ToControl) -> bool {
        queues.may_owe = !P::WAITS;
        let mut news = self.link.pass_on(arbiter, queues);
        if boards::clock_ticks().wrapping_sub(self.singly_since) >= SINGLY_US * boards::CLOCK_TICKS_PER_US {
            (self.singly, self.singly_since) = (0, boards::clock_ticks());
        }
        let mut limited = false;
        while self.link.room() > 0 || !P::WAITS {
            let text = self.link.take_text(self.port.fetched(), arbiter, queues);
            self.port.pass(text);
            news |= text > 0;
            if text > 0 {
                continue;
            }
            let queued = queues.bytes_queued;
            match self.port.receive() {
                Incoming::Nothing => break,
                Incoming::Lost => {
                    self.link.lose();
                    news |= self.link.pass_on(arbiter, queues);
                }
                Incoming::Byte(byte) => news |= self.link.take(byte, arbiter, other, queues),
            }
            // Of lines no more is queued than there is room for, however they end. Where a link cannot wait, what is taken one by one is
            // limited anyway, and the characters of remarks come from a host that counts them.
            let is_other = queues.bytes_queued == queued && (P::WAITS || !self.link.is_in_remark());
            queues.others = queues.others.saturating_sub(u32::from(is_other));
            self.singly += 1;
            self.quiet_runs = 0;
            let is_long = !P::WAITS && self.singly >= MOST_SINGLY;
            limited = (is_long || queues.others == 0 && is_other) && !self.port.is_urgent();
            if limited {
                queues.leaves_unread = true;
                queues.left_unread.write(());
                break;
            }
        }
        // Until the rest has been taken there is no room for more.
        self.port.allow(if limited { 0 } else { self.link.room() });
        if self.link.is_ambiguous() && !limited && (!P::WAITS || self.link.room() >= PACKET) {
            news |= self.await_rest(arbiter, queues);
        }
        news
    }

    /// The last byte is a `!` that may be text, and the host could send more. Whether it is a command by now: where the processor has
    /// stood, the rest may have come and not been looked at, so time alone does not tell.
    #[cold]
    fn await_rest(&mut self, arbiter: &mut HostArbiter, queues: &mut ToControl) -> bool {
        let now = boards::clock_ticks();
        if self.quiet_runs == 0 {
            self.quiet_since = now;
        }
        self.quiet_runs = self.quiet_runs.saturating_add(1);
        let has_waited = now.wrapping_sub(self.quiet_since) >= AMBIGUOUS_US * boards::CLOCK_TICKS_PER_US;
        if !has_waited || self.quiet_runs < QUIET_RUNS {
            // To be called again, though nothing comes.
            queues.left_unread.write(());
            return false;
        }
        self.link.take_as_command();
        self.link.pass_on(arbiter, queues)
    }

    /// Sends what the host is refused. `false` while there is more of it.
    fn refuse(&mut self) -> bool {
        let Self { port, link, .. } = self;
        link.refuse(|byte| port.send(byte))
    }
}

/// Everything the task owns.
pub struct Serial {
    arbiter: HostArbiter,
    uart: Ported<SerialPort>,
    usb: Ported<UsbPort>,
    queues: ToControl,
    replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
    sending: Chunk,
    sent: usize,
    /// Whom it is for.
    sending_to: usize,
    wake: Wake,
}

impl Serial {
    /// Nothing received, nothing to send.
    pub fn new(
        uart: SerialPort,
        usb: UsbPort,
        realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
        lines: Sender<'static, LineBytes, LINE_MESSAGES>,
        replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
        (wake, left_unread): (Wake, SignalWriter<'static, ()>),
    ) -> Serial {
        Serial {
            arbiter: HostArbiter::new(),
            uart: Ported::new(UART, uart, UART_HELD),
            usb: Ported::new(USB, usb, MOST_HELD),
            queues: ToControl {
                may_owe: false,
                flushed: true,
                realtime,
                lines,
                line_sender: LineSender::default(),
                bytes_queued: 0,
                others: MOST_OTHERS,
                others_since: 0,
                leaves_unread: false,
                left_unread,
            },
            replies,
            sending: Chunk { len: 0, bytes: [0; 15] },
            sent: 0,
            sending_to: UART,
            wake,
        }
    }

    /// Called for received bytes or a packet, for room to send, and by `control` (an answer to send; room
    /// in the queues). Once in the image, and not in each of two vectors.
    #[inline(never)]
    pub fn run(&mut self) {
        ASKED.serial.store(false, Ordering::Relaxed);
        let Serial { arbiter, uart, usb, queues, .. } = self;
        queues.flushed = self.sent >= self.sending.as_bytes().len()
            && self.replies.is_empty()
            && !core::mem::take(&mut queues.leaves_unread);
        queues.allow_others();
        let mut news = uart.receive(arbiter, &mut usb.link, queues);
        news |= usb.look(arbiter, &mut uart.link, queues);
        news |= usb.receive(arbiter, &mut uart.link, queues);
        // What takes them out, or reads the counts, does not preempt this task.
        let queued = core::mem::take(&mut queues.bytes_queued);
        count(&SERIAL.heard, queued);
        count(&SERIAL.bytes_queued, queued);
        news |= queues.flush();
        let held = uart.link.held() + usb.link.held();
        let is_stuck = held == 0 && (uart.link.is_waiting() || usb.link.is_waiting());
        let held = (held + usize::from(held > 0 && arbiter.owes_cut() || is_stuck)) as u32;
        SERIAL.bytes_received.store(SERIAL.bytes_queued.load(Ordering::Relaxed).wrapping_add(held), Ordering::Relaxed);
        news |= self.send();
        if news {
            self.wake.write(());
        }
    }

    /// Sends as much as the ports take. Whether room has come about in the queue of answers.
    fn send(&mut self) -> bool {
        let mut room = false;
        let (uart, usb) = (self.uart.refuse(), self.usb.refuse());
        let holder = self.arbiter.holder();
        let to_usb = holder == USB;
        if self.sending_to != holder {
            // The rest of a line that another host has begun to get is nothing to this one.
            self.sent = self.sending.as_bytes().len();
        }
        let mut more = false;
        // A refusal is not torn by an answer.
        let clear = if to_usb { usb } else { uart };
        loop {
            if !clear {
                break;
            }
            let text = self.sending.as_bytes().get(self.sent..).unwrap_or_default();
            if text.is_empty() {
                let was_full = self.replies.is_full();
                let Ok(chunk) = self.replies.try_recv() else { break };
                self.sending = chunk;
                self.sent = 0;
                self.sending_to = holder;
                // Whoever found it full waits to be woken.
                room |= was_full;
                continue;
            }
            let taken = if to_usb { self.usb.port.send_text(text) } else { self.uart.port.send_text(text) };
            if taken == 0 {
                more = true;
                break;
            }
            self.sent += taken;
        }
        self.uart.port.call_when_free(!uart || more && !to_usb);
        self.usb.port.call_when_free(!usb || more && to_usb);
        room
    }
}
