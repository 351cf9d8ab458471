//! The UART to the host: what the serial task has of it, [`Usart`], and what the tasks at the priority of the inputs have of it,
//! [`UartInput`]. How bytes come and go depends on the board: by DMA (`usart_dma`), or by an interrupt (`usart_interrupt`).
//!
//! ```text
//!  UART ──▶ UartInput ──messages──▶ Usart ──▶ serial task
//!  UART ◀── UartOutput ◀─────────── Usart ◀── serial task
//! ```
//! No byte waits for the step task in vain, and none interrupts it: at any rate that a board allows (`$931`), what comes in the
//! longest run of that task is kept. A written word of flash may stall the processor for 100 us, an erase for half a
//! second. What holds: a host that keeps to the flow control (at most the 255 bytes that `Bf:` counts are under way) loses nothing,
//! and besides there is room for 64 realtime commands (`REALTIME_DEPTH`). Any other loss is reported.

use super::registers::{read, write};
use crate::uart_receiver::{ByteSource, Look, ReceivedBytes, UartReceiver};
use crate::{Incoming, Port};
use rtic_sync::channel::{Channel, Receiver, Sender};
use rtic_sync::signal::{Signal, SignalReader, SignalWriter};

/// Registers of a USART. The HAL sets it up; here they are raw, as DMA reads and writes the data register past the HAL, which also
/// drops the byte beside an overrun: it may be one that stops the machine.
pub(super) const SR: usize = 0x00;
pub(super) const DATA: usize = 0x04;
const BRR: usize = 0x08;
pub(super) const CR_1: usize = 0x0C;
pub(super) const CR_3: usize = 0x14;
// CR1
const ON: u32 = 1 << 13;

/// Another rate, before anything is sent. What has come so far came at another one, perhaps, and is dropped.
pub(super) fn set_baud(usart: usize, clock: u32, baud: u32) {
    let control = read(usart + CR_1);
    write(usart + CR_1, control & !ON);
    // Sixteen samples a bit: the quotient has four bits of fraction, and so has the register.
    write(usart + BRR, (clock + baud / 2) / baud);
    write(usart + CR_1, control);
    let _ = (read(usart + SR), read(usart + DATA));
}

/// What the tasks at the priority of the inputs have of a UART: what has come, as messages to the serial task.
pub struct UartInput<S, const N: usize> {
    pub(super) receiver: UartReceiver<S>,
    messages: Sender<'static, ReceivedBytes, N>,
    /// How many messages have been sent (wrapping).
    sent: u32,
    hurry: SignalWriter<'static, u32>,
}

impl<S: ByteSource, const N: usize> UartInput<S, N> {
    /// Looks at what has come.
    #[inline(always)]
    pub fn look(&mut self) -> Look {
        let (messages, sent) = (&mut self.messages, &mut self.sent);
        self.receiver.look(|message| send(messages, sent, message))
    }

    /// Sends what has come to the serial task. `calls`: the caller calls it.
    pub fn pass_on(&mut self, calls: bool) {
        if calls && self.receiver.has_stop() {
            // It is in the message that is being filled, or in one before it.
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

/// How a UART sends.
pub trait UartOutput {
    /// Puts a byte behind those that wait to be sent, if there is room.
    fn send(&mut self, byte: u8) -> bool;
    /// What has been put is sent, and the serial task is called when there is room again.
    fn begin(&mut self);
}

/// What the serial task has of a UART.
pub struct Usart<T, const N: usize> {
    messages: Receiver<'static, ReceivedBytes, N>,
    /// How many have been taken (wrapping).
    taken: u32,
    /// Up to which one a command that stops the machine may be among them.
    hurry: SignalReader<'static, u32>,
    hurries_to: u32,
    /// The message that is being read, and how far.
    message: ReceivedBytes,
    next: usize,
    output: T,
}

/// Both ends, with what joins them. To be called once.
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
    /// The next message, if this one has been read.
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
            // One behind, so that the count of messages never comes round to it.
            self.hurries_to = self.taken.wrapping_sub(1);
            return false;
        }
        left > 0 || !self.message.from(self.next).is_empty()
    }

    /// Every byte is fetched at once.
    #[inline]
    fn allow(&mut self, _room: usize) {}

    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        self.output.send(byte)
    }

    /// It calls in any case.
    #[inline]
    fn call_when_free(&mut self, _wanted: bool) {
        self.output.begin();
    }
}
