//! The UART to the host: [`Usart`] for the serial task, and [`UartInput`] for the task `inputs` (without DMA also for
//! the task `uart`, which has the same priority). The board chooses how bytes are transferred: by DMA (`usart_dma`) or
//! by an interrupt (`usart_interrupt`).
//!
//! ```text
//!  UART ──▶ UartInput ──messages──▶ Usart ──▶ serial task
//!  UART ◀── UartOutput ◀─────────── Usart ◀── serial task
//! ```
//! Received bytes do not interrupt the step task. Guarantee: a host that respects the flow control loses no byte, at
//! any baud rate that the board allows (`$931`). This holds during the longest run of the step task, and while flash
//! stalls the processor: 100 us for the write of a word, half a second for an erase.
//!
//! A host that respects the flow control has at most 255 bytes of lines in flight, as `Bf:` in the status report
//! allows, and 64 realtime commands (`REALTIME_DEPTH`). If a host exceeds these limits, any loss is reported.

use super::registers::{read, write};
use crate::uart_receiver::{ByteSource, Look, ReceivedBytes, UartReceiver};
use crate::{Incoming, Port};
use rtic_sync::channel::{Channel, Receiver, Sender};
use rtic_sync::signal::{Signal, SignalReader, SignalWriter};

/// Registers of a USART. They are raw for two reasons. DMA reads and writes the data register without the HAL. At an
/// overrun, the HAL drops the byte in the data register, which arrived before the overrun and may be a command that
/// stops the machine.
pub(super) const SR: usize = 0x00;
pub(super) const DATA: usize = 0x04;
const BRR: usize = 0x08;
pub(super) const CR_1: usize = 0x0C;
pub(super) const CR_3: usize = 0x14;
// CR1: the USART is on (UE).
const ON: u32 = 1 << 13;

/// Sets the baud rate; call before anything is sent. Drops a byte that was received before, because it may have been
/// sent at another rate.
pub(super) fn set_baud(usart: usize, clock: u32, baud: u32) {
    let control = read(usart + CR_1);
    write(usart + CR_1, control & !ON);
    // BRR is clock / baud, rounded: the USART takes sixteen samples per bit, and BRR has four fractional bits.
    write(usart + BRR, (clock + baud / 2) / baud);
    write(usart + CR_1, control);
    let _ = (read(usart + SR), read(usart + DATA));
}

/// The UART's receiver, used by the task `inputs` and, if the UART has no DMA, also by the task `uart` of the same
/// priority. Sends the received bytes as messages to the serial task.
pub struct UartInput<S, const N: usize> {
    pub(super) receiver: UartReceiver<S>,
    messages: Sender<'static, ReceivedBytes, N>,
    /// Number of messages sent (wrapping).
    sent: u32,
    /// Signal to the serial task: the number of the newest message that may contain a command that stops the machine.
    /// Messages are numbered as `sent` counts them.
    hurry: SignalWriter<'static, u32>,
}

impl<S: ByteSource, const N: usize> UartInput<S, N> {
    /// Reads received bytes and sends each message that is full to the serial task.
    #[inline(always)]
    pub fn look(&mut self) -> Look {
        let (messages, sent) = (&mut self.messages, &mut self.sent);
        self.receiver.look(|message| send(messages, sent, message))
    }

    /// Sends the bytes read so far to the serial task. `calls`: `true` if the caller calls the serial task right
    /// afterwards.
    pub fn pass_on(&mut self, calls: bool) {
        if calls && self.receiver.has_stop() {
            // The command that stops the machine is in the message being filled, which is number `sent` + 1, or in an
            // earlier one.
            self.hurry.write(self.sent.wrapping_add(1));
        }
        let (messages, sent) = (&mut self.messages, &mut self.sent);
        self.receiver.pass_on(calls, |message| send(messages, sent, message));
    }
}

fn send<const N: usize>(
    messages: &mut Sender<'static, ReceivedBytes, N>,
    sent: &mut u32,
    message: ReceivedBytes,
) -> bool {
    let is_sent = messages.try_send(message).is_ok();
    *sent = sent.wrapping_add(is_sent.into());
    is_sent
}

/// The sending part of a UART.
pub trait UartOutput {
    /// Queues a byte for sending. Returns false if the queue is full.
    fn send(&mut self, byte: u8) -> bool;
    /// Starts sending the queued bytes. The serial task is called when there is space again.
    fn begin(&mut self);
}

/// The UART as the serial task uses it. Received bytes come in messages, and `T` sends bytes.
pub struct Usart<T, const N: usize> {
    messages: Receiver<'static, ReceivedBytes, N>,
    /// Number of messages taken out of `messages` so far (wrapping).
    taken: u32,
    hurry: SignalReader<'static, u32>,
    /// Number of the newest message that may contain a command that stops the machine. Messages are numbered as
    /// `taken` counts them.
    hurries_to: u32,
    /// The message being read.
    message: ReceivedBytes,
    /// Index of the next byte in `message`.
    next: usize,
    output: T,
}

/// Creates the [`UartInput`] of the task `inputs` and the [`Usart`] of the serial task, connected by `messages` and
/// `hurry`. Call once.
pub(super) fn join<S: ByteSource, T, const N: usize>(
    receiver: UartReceiver<S>,
    output: T,
    messages: &'static mut Channel<ReceivedBytes, N>,
    hurry: &'static Signal<u32>,
) -> (UartInput<S, N>, Usart<T, N>) {
    let (sender, messages) = messages.split();
    let (writer, hurry) = hurry.split();
    let input = UartInput { receiver, messages: sender, sent: 0, hurry: writer };
    let message = ReceivedBytes::EMPTY;
    (input, Usart { messages, taken: 0, hurry, hurries_to: 0, message, next: 0, output })
}

impl<T, const N: usize> Usart<T, N> {
    /// Takes the next message if the present one has been read completely.
    #[inline]
    fn fetch(&mut self) {
        if self.message.from(self.next).is_empty() && !self.messages.is_empty() {
            self.message = self.messages.try_recv().unwrap_or(ReceivedBytes::EMPTY);
            self.taken = self.taken.wrapping_add(1);
            self.next = 0;
        }
    }
}

impl<T: UartOutput, const N: usize> Port for Usart<T, N> {
    const WAITS: bool = false;

    #[inline]
    fn receive(&mut self) -> Incoming {
        self.fetch();
        if core::mem::take(&mut self.message.is_behind_loss) {
            return Incoming::Lost;
        }
        let Some(byte) = self.message.from(self.next).first().copied() else { return Incoming::Nothing };
        self.next += 1;
        Incoming::Byte(byte)
    }

    #[inline]
    fn fetched(&mut self) -> &[u8] {
        self.fetch();
        if self.message.is_behind_loss { &[] } else { self.message.from(self.next) }
    }

    #[inline]
    fn pass(&mut self, count: usize) {
        self.next += count;
    }

    #[inline]
    fn is_urgent(&mut self) -> bool {
        self.hurries_to = self.hurry.try_read().unwrap_or(self.hurries_to);
        let left = self.hurries_to.wrapping_sub(self.taken) as i32;
        if left < 0 {
            // Keep `hurries_to` just below `taken`. Otherwise an old value would seem to be above `taken` after
            // `taken` has wrapped.
            self.hurries_to = self.taken.wrapping_sub(1);
            return false;
        }
        left > 0 || !self.message.from(self.next).is_empty()
    }

    /// Does nothing: a UART cannot make its sender wait, so every byte is fetched at once.
    #[inline]
    fn allow(&mut self, _room: usize) {}

    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        self.output.send(byte)
    }

    /// Starts sending. The serial task is called when there is space, even without `_wanted`.
    #[inline]
    fn call_when_free(&mut self, _wanted: bool) {
        self.output.begin();
    }
}
