//! The links to the hosts, UART and USB. Splits received bytes into realtime commands and line bytes, queues them for
//! `control`, and sends replies to the active host (the host whose lines are accepted).
//!
//! ```text
//!  USART ──▶ link ───┐                                   ┌─▶ USART
//!                    ├─▶ realtime, lines   replies ───────┤
//!  USB   ──▶ link ───┘                                   └─▶ USB
//! ```
//! Both links are always read. Realtime commands are accepted from both, lines only from the link of the active host.
//! The active host can change when the machine has nothing to do, when the active host disconnects, and with a reset.
//! When a reset arrives, this task first requests a stop of the step task. After that it queues bytes and decides which
//! host is active.

use crate::boards::{self, Incoming, Port, SerialPort, UsbPort};
use crate::shared::{self, ASKED, CONTROL, SERIAL, Wake};
use core::sync::atomic::{AtomicU32, Ordering};
use oxmill_controller::messages::{Chunk, LINE_MESSAGES, LineByte, LineBytes, REALTIME_DEPTH, REPLIES_DEPTH, Realtime};
use oxmill_controller::protocol::link::{AMBIGUOUS_US, MOST_HELD};
use oxmill_controller::{HostArbiter, LineSender, Link, Queues};
use rtic_sync::channel::{Receiver, Sender};
use rtic_sync::signal::SignalWriter;

/// Size of a USB packet in bytes.
const PACKET: usize = 64;
/// How many received line bytes the link of the UART can keep while the queue to `control` is full. More would not
/// help, because a UART cannot make its sender wait.
const UART_HELD: usize = 1;

/// Maximum burst of "other" bytes: realtime commands and ignored bytes. Line bytes need no such limit, because the room
/// in their queue limits them. Without this limit, a host or noise on a wire could use all of the processor time by
/// sending other bytes without end.
const MOST_OTHERS: u32 = 128;
/// Period in µs. Each time it has passed, one more other byte may be processed, up to `MOST_OTHERS`.
const OTHER_US: u32 = 200;
/// Maximum number of bytes that are processed one at a time in `SINGLY_US` µs, from a link that cannot make its sender
/// wait. (Plain text is processed several bytes at a time and does not count.) The limit leaves processor time to
/// `control`. It is high enough for lines of 15 characters with CR LF at 1 Mbaud. A host that counts characters loses
/// no bytes by it, because such a host never sends more bytes than there is room for.
const MOST_SINGLY: usize = 12;
/// Length, in µs, of the period in which at most `MOST_SINGLY` bytes are processed one at a time.
const SINGLY_US: u32 = 800;
/// A `!` in a comment can be text or a feed hold. It becomes a feed hold only after this many runs of the serial task
/// without a further byte. Runs are about 500 µs apart.
const QUIET_RUNS: u8 = 16;

/// Link number of the USART.
const UART: usize = 0;
/// Link number of USB.
const USB: usize = 1;

/// The senders of the queues to `control`, and the limits on how many received bytes are processed.
struct ToControl {
    /// `true` if the link being read cannot make its sender wait. If the queue then has no room for a reset, hold or
    /// door command, the command is kept outside the queue ("deferred", [`shared::defer`]).
    may_defer: bool,
    /// `true` if no reply waits or is partly sent, and the previous run of the task left no received bytes unread.
    flushed: bool,
    realtime: Sender<'static, Realtime, REALTIME_DEPTH>,
    lines: Sender<'static, LineBytes, LINE_MESSAGES>,
    line_sender: LineSender,
    /// Line bytes queued in this run.
    bytes_queued: u32,
    /// How many other bytes (realtime commands and ignored bytes) may still be processed now, at most `MOST_OTHERS`.
    others: u32,
    /// Time in clock ticks up to which [`ToControl::allow_others`] has increased `others`.
    others_since: u32,
    /// `true` if a run of the task reached a limit and left bytes unread, so that the task must be called again. The
    /// next run clears it.
    leaves_unread: bool,
    left_unread: SignalWriter<'static, ()>,
}

impl ToControl {
    /// Increases `others` by one for each `OTHER_US` that has passed, up to `MOST_OTHERS`.
    fn allow_others(&mut self) {
        let more = boards::clock_ticks().wrapping_sub(self.others_since) / (OTHER_US * boards::CLOCK_TICKS_PER_US);
        self.others = MOST_OTHERS.min(self.others.saturating_add(more));
        self.others_since = self.others_since.wrapping_add(more * OTHER_US * boards::CLOCK_TICKS_PER_US);
    }

    /// Queues the line bytes gathered in this run. Returns whether a message was queued for `control`.
    fn flush(&mut self) -> bool {
        let Self { lines, line_sender, .. } = self;
        // The queue may contain only a limited number of partly filled messages. If `control` has emptied the queue,
        // `flush` counts them from 0 again.
        line_sender.is_waiting() && line_sender.flush(lines.is_empty(), |message| lines.try_send(message).is_ok())
    }
}

/// Adds to a count that only this task writes, so a separate load and store suffice.
fn count(counter: &AtomicU32, by: u32) {
    counter.store(counter.load(Ordering::Relaxed).wrapping_add(by), Ordering::Relaxed);
}

impl Queues for ToControl {
    fn realtime(&mut self, command: Realtime) -> bool {
        count(&SERIAL.activity, 1);
        let queued = !shared::has_deferred() && self.realtime.try_send(command).is_ok();
        let deferred = !queued && self.may_defer && shared::defer(command);
        if deferred {
            boards::call_step();
        }
        queued || deferred
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
        !self.may_defer
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

    fn speaks_grblhal(&self) -> bool {
        CONTROL.speaks_grblhal.load(Ordering::Relaxed)
    }
}

/// A link and the port that it reads and writes.
struct Ported<P> {
    port: P,
    link: Link,
    open: bool,
    /// Number of bytes processed one at a time since `singly_since`.
    singly: usize,
    /// Start of the period for which `singly` counts, in clock ticks.
    singly_since: u32,
    /// Time in clock ticks of the first run of the task in which no byte followed a `!` that may be text.
    quiet_since: u32,
    /// Number of runs since `quiet_since` in which no byte followed the `!`; 0 after any byte.
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

    /// Checks whether a host has connected or disconnected. Returns whether there is news for `control`.
    fn look(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &ToControl) -> bool {
        let mut news = false;
        // Check twice, because one host can disconnect and another can connect between two calls of `look`.
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

    /// Reads received bytes as far as there is room. Returns whether there is news for `control`.
    fn receive(&mut self, arbiter: &mut HostArbiter, other: &mut Link, queues: &mut ToControl) -> bool {
        queues.may_defer = !P::WAITS;
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
            // `others` does not count line bytes, because the room in their queue limits them. On a link that cannot
            // make its sender wait, `others` does not count characters of comments either, because `singly` limits
            // them. A host that counts characters counts them, too.
            let is_other = queues.bytes_queued == queued && (P::WAITS || !self.link.is_in_comment());
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
        // After a run that reached a limit, the port must not receive more until the bytes that this run left unread
        // have been read.
        self.port.allow(if limited { 0 } else { self.link.room() });
        if self.link.is_ambiguous() && !limited && (!P::WAITS || self.link.room() >= PACKET) {
            news |= self.await_rest(arbiter, queues);
        }
        news
    }

    /// Turns a `!` that may be text into a feed hold, if no byte has followed it for `AMBIGUOUS_US` and in
    /// `QUIET_RUNS` runs of the task. Call while such a `!` is the last byte received. Returns whether there is news
    /// for `control`. The time alone is not enough: it can pass during a stall of the processor, while bytes from the
    /// time of the stall are still unread.
    #[cold]
    fn await_rest(&mut self, arbiter: &mut HostArbiter, queues: &mut ToControl) -> bool {
        let now = boards::clock_ticks();
        if self.quiet_runs == 0 {
            self.quiet_since = now;
        }
        self.quiet_runs = self.quiet_runs.saturating_add(1);
        let has_waited = now.wrapping_sub(self.quiet_since) >= AMBIGUOUS_US * boards::CLOCK_TICKS_PER_US;
        if !has_waited || self.quiet_runs < QUIET_RUNS {
            // Request another call of this task, even if no byte arrives.
            queues.left_unread.write(());
            return false;
        }
        self.link.take_as_command();
        self.link.pass_on(arbiter, queues)
    }

    /// Sends the error answers to lines that the link has refused, as far as the port takes them. Returns `false` while
    /// some remain.
    fn refuse(&mut self) -> bool {
        let Self { port, link, .. } = self;
        link.refuse(|byte| port.send(byte))
    }
}

/// State of the serial task.
pub struct Serial {
    arbiter: HostArbiter,
    uart: Ported<SerialPort>,
    usb: Ported<UsbPort>,
    queues: ToControl,
    replies: Receiver<'static, Chunk, REPLIES_DEPTH>,
    sending: Chunk,
    sent: usize,
    /// Link number that `sending` is for.
    sending_to: usize,
    wake: Wake,
}

impl Serial {
    /// Creates the task, with nothing received and nothing to send.
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
                may_defer: false,
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

    /// Runs the task. Called when bytes have been received or a port has room to send, and by `control` when there is a
    /// reply to send or room in the queues. Not inlined, so that the image contains it once and not in each of two
    /// vectors.
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
        // The counts may be updated after the bytes are queued, because the tasks that take the bytes or read the
        // counts do not preempt this task.
        let queued = core::mem::take(&mut queues.bytes_queued);
        count(&SERIAL.activity, queued);
        count(&SERIAL.bytes_queued, queued);
        news |= queues.flush();
        let held = uart.link.held() + usb.link.held();
        // One more byte counts as received in two cases: a `HOST_CHANGED` must be queued before line bytes that wait,
        // or a command waits for room while no line byte waits.
        let is_stuck = held == 0 && (uart.link.is_waiting() || usb.link.is_waiting());
        let held = (held + usize::from(held > 0 && arbiter.is_host_change_due() || is_stuck)) as u32;
        SERIAL.bytes_received.store(SERIAL.bytes_queued.load(Ordering::Relaxed).wrapping_add(held), Ordering::Relaxed);
        news |= self.send();
        if news {
            self.wake.write(());
        }
    }

    /// Sends as much as the ports take. Returns whether the queue of replies was full and has room again.
    fn send(&mut self) -> bool {
        let mut room = false;
        let (uart, usb) = (self.uart.refuse(), self.usb.refuse());
        let active = self.arbiter.active_link();
        let to_usb = active == USB;
        if self.sending_to != active {
            // The active host has changed, so the remaining part of a reply to the previous one is dropped.
            self.sent = self.sending.as_bytes().len();
        }
        let mut more = false;
        // An error answer to a refused line of another host can be partly sent on this port. Send no reply before it is
        // complete.
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
                self.sending_to = active;
                // If the queue was full, `control` may be waiting for room: wake it.
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
