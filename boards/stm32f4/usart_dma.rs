//! A UART by DMA in both directions: no byte costs an interrupt, and none is lost while the processor stands still.
//!
//! ```text
//!  USART ──▶ DMA, circular ──▶ buffer
//!  USART ◀── DMA ◀── one half; the serial task fills the other, and is called at the end of a half
//! ```
//! DMA reads no status. That a byte was damaged is told by the interrupt line of the USART (EIE), whose vector is not enabled: its
//! pending bit stays until it is cleared, whoever clears the flags by reading the data register. It is set before DMA fetches the byte.
//! So what had come before the bit was found clear is good; else all that has come since the look before, and up to the next,
//! is doubted (`uart_receiver`).

use super::dma::{CIRCULAR, HISR, MEMORY_COUNTS, NDTR, SERVED_CYCLES, TO_PERIPHERAL, clear_flags, stream, switch_on};
use super::registers::{read, write};
use super::usart::{CR_3, DATA, SR, UartInput, UartOutput, Usart, join, set_baud};
use crate::uart_receiver::{Buffer, ByteSource, ReceivedBytes, SLOTS, UartReceiver};
use core::sync::atomic::{AtomicU16, Ordering, fence};
use cortex_m::{peripheral::NVIC, singleton};
use rtic_sync::{channel::Channel, signal::Signal};
use stm32f4xx_hal::{
    pac,
    rcc::{BusClock, Enable, Rcc},
    serial::{Rx, Tx},
};

/// Messages to the serial task. Between two calls at 1 Mbaud four are filled; a line that comes slowly takes one for each 200 us.
const MESSAGES: usize = 12;
/// Bytes of a half.
const HALF: usize = 64;

/// SR: a byte is in the data register.
const ARRIVED: u32 = 1 << 5;
/// CR3: errors pend; DMA receives and sends.
const BY_DMA: u32 = 1 | 1 << 6 | 1 << 7;
/// CR of the streams: channel 4; half-words, circular, before what is sent; bytes, a call at the end.
const CHANNEL: u32 = 4 << 25;
const RECEIVES: u32 = CHANNEL | CIRCULAR | MEMORY_COUNTS | 1 << 11 | 1 << 13 | 1 << 16;
const SENDS: u32 = CHANNEL | TO_PERIPHERAL | MEMORY_COUNTS | 1 << 4;

/// The streams of USART2, which nothing else uses (reference manuals, "DMA1 request mapping"): the vector of the one that sends is that
/// of the serial task.
const DMA: usize = 0x4002_6000;
const RECEIVER: usize = 5;
const SENDER: usize = 6;
/// The end of what that stream sends (HISR, TCIF6).
const SENT: u32 = 1 << 21;
const USART: usize = 0x4000_4400;
/// The vector that stays masked.
const VECTOR: pac::Interrupt = pac::Interrupt::USART2;

/// The receiving half.
pub struct ByDma {
    _rx: Rx<pac::USART2>,
    buffer: &'static Buffer,
    /// Hz of its bus.
    clock: u32,
}

/// What the task of the inputs has of it.
pub type Input = UartInput<ByDma, MESSAGES>;
/// What the serial task has of it.
pub type DmaPort = Usart<Halves, MESSAGES>;

/// Takes the USART over from the HAL. It listens after [`Input::start`]. Not within the set-up, whose stack would have its buffers as well.
#[inline(never)]
pub fn by_dma((tx, rx): (Tx<pac::USART2>, Rx<pac::USART2>), rcc: &mut Rcc) -> (Input, DmaPort) {
    pac::DMA1::enable(rcc);
    let (Some(buffer), Some(halves), Some(messages), Some(hurry)) = (
        singleton!(: Buffer = [const { AtomicU16::new(0) }; SLOTS]),
        singleton!(: [[u8; HALF]; 2] = [[0; HALF]; 2]),
        singleton!(: Channel<ReceivedBytes, MESSAGES> = Channel::new()),
        singleton!(: Signal<u32> = Signal::new()),
    ) else {
        unreachable!("set up twice")
    };
    let source = ByDma { _rx: rx, buffer, clock: pac::USART2::clock(&rcc.clocks).raw() };
    let output = Halves { _tx: tx, halves, half: 0, filled: 0, sends: false };
    join(UartReceiver::new(source, buffer), output, messages, hurry)
}

impl Input {
    /// Begins to listen, at this rate.
    pub fn start(&mut self, baud: u32) {
        let source = self.receiver.source();
        set_baud(USART, source.clock, baud);
        let memory = source.buffer.as_ptr() as usize;
        switch_on(DMA, RECEIVER, USART + DATA, memory, SLOTS, RECEIVES);
        write(USART + CR_3, read(USART + CR_3) | BY_DMA);
        NVIC::unpend(VECTOR);
    }
}

impl ByteSource for ByDma {
    const IS_CIRCULAR: bool = true;

    #[inline(always)]
    fn place(&self) -> usize {
        let place = SLOTS.wrapping_sub(read(stream(DMA, RECEIVER) + NDTR) as usize);
        if place < SLOTS { place } else { 0 }
    }

    #[inline(always)]
    fn is_damaged(&self) -> bool {
        NVIC::is_pending(VECTOR)
    }

    fn clear_damage(&mut self) {
        // A byte that DMA has not fetched yet is left to it, and the flags to the next look.
        if read(USART + SR) & ARRIVED == 0 {
            let _ = read(USART + DATA);
        }
        NVIC::unpend(VECTOR);
    }

    fn settle(&self) {
        cortex_m::asm::delay(SERVED_CYCLES);
    }
}

/// The sending half: one half of its memory is sent, the other one filled.
pub struct Halves {
    _tx: Tx<pac::USART2>,
    halves: &'static mut [[u8; HALF]; 2],
    /// The half that is being filled, and its bytes.
    half: usize,
    filled: usize,
    sends: bool,
}

impl UartOutput for Halves {
    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        if self.filled >= HALF {
            self.begin();
        }
        let slot = self.halves.get_mut(self.half).and_then(|half| half.get_mut(self.filled));
        let has_room = slot.is_some();
        if let Some(slot) = slot {
            *slot = byte;
            self.filled += 1;
        }
        has_room
    }

    /// Sends the half that is being filled, if the other one is out.
    fn begin(&mut self) {
        // Not the count: it may come to its end before the last byte is out.
        if read(DMA + HISR) & SENT != 0 {
            self.sends = false;
            clear_flags(DMA, SENDER);
        }
        if !self.sends
            && self.filled > 0
            && let Some(half) = self.halves.get(self.half)
        {
            // DMA reads what has been written.
            fence(Ordering::SeqCst);
            let memory = half.as_ptr() as usize;
            switch_on(DMA, SENDER, USART + DATA, memory, self.filled, SENDS);
            (self.half, self.filled, self.sends) = (1 - self.half, 0, true);
        }
    }
}
