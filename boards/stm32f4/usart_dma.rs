//! UART by DMA in both directions. Bytes need no interrupts, and no byte is lost while the processor is stalled.
//!
//! ```text
//!  USART ──▶ DMA, circular ──▶ buffer
//!  USART ◀── DMA ◀── one half; the serial task fills the other, and is called at the end of a half
//! ```
//! Damaged bytes: DMA does not read the status register, so the pending bit of the USART's interrupt reports the
//! damage. A damaged byte raises the interrupt line (EIE) before DMA fetches the byte. The vector of this line is
//! masked. So the pending bit stays set until software clears it, even after a read of the data register has cleared
//! the error flags.
//!
//! The receiver checks the pending bit at each look (reading of the buffer). If the bit is clear, all bytes that
//! arrived before are good. Otherwise the receiver treats all bytes from the previous look up to the next look as
//! damaged (`uart_receiver`).

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

/// Capacity of the queue of messages to the serial task. At 1 Mbaud, four messages are filled between two calls of the
/// serial task. A line that arrives slowly takes one message per 200 us.
const MESSAGES: usize = 12;
/// Size of each half of the send buffer, bytes.
const HALF: usize = 64;

/// SR: the data register holds a received byte.
const ARRIVED: u32 = 1 << 5;
/// CR3: errors raise the interrupt line; DMA receives and sends.
const BY_DMA: u32 = 1 | 1 << 6 | 1 << 7;
/// CR of the streams: channel 4.
const CHANNEL: u32 = 4 << 25;
/// CR of the receiving stream: half-words, circular, with a higher priority than sending.
const RECEIVES: u32 = CHANNEL | CIRCULAR | MEMORY_COUNTS | 1 << 11 | 1 << 13 | 1 << 16;
/// CR of the sending stream: bytes, with an interrupt at the end of the transfer.
const SENDS: u32 = CHANNEL | TO_PERIPHERAL | MEMORY_COUNTS | 1 << 4;

/// The streams of USART2, which nothing else uses (reference manuals, "DMA1 request mapping"). The serial task uses the
/// vector of the sending stream.
const DMA: usize = 0x4002_6000;
const RECEIVER: usize = 5;
const SENDER: usize = 6;
/// The sending stream has transferred all its bytes (HISR, TCIF6).
const SENT: u32 = 1 << 21;
/// Address of USART2.
const USART: usize = 0x4000_4400;
/// The vector whose pending bit reports damaged bytes; it stays masked.
const VECTOR: pac::Interrupt = pac::Interrupt::USART2;

/// The receiving part of the UART: DMA writes all received bytes into the buffer.
pub struct ByDma {
    _rx: Rx<pac::USART2>,
    buffer: &'static Buffer,
    /// Clock of the USART's bus, Hz.
    clock: u32,
}

/// The receiver, for the task of the inputs.
pub type Input = UartInput<ByDma, MESSAGES>;
/// The UART, for the serial task.
pub type DmaPort = Usart<Halves, MESSAGES>;

/// Takes the USART over from the HAL. Receiving starts with [`Input::start`]. Not inlined into the set-up, because the
/// stack frame of the set-up would then include the initial values of the buffers created here.
#[inline(never)]
pub fn start((tx, rx): (Tx<pac::USART2>, Rx<pac::USART2>), rcc: &mut Rcc) -> (Input, DmaPort) {
    pac::DMA1::enable(rcc);
    let (Some(buffer), Some(halves), Some(messages), Some(hurry)) = (
        singleton!(: Buffer = [const { AtomicU16::new(0) }; SLOTS]),
        singleton!(: [[u8; HALF]; 2] = [[0; HALF]; 2]),
        singleton!(: Channel<ReceivedBytes, MESSAGES> = Channel::new()),
        singleton!(: Signal<u32> = Signal::new()),
    ) else {
        unreachable!()
    };
    let source = ByDma { _rx: rx, buffer, clock: pac::USART2::clock(&rcc.clocks).raw() };
    let output = Halves { _tx: tx, halves, half: 0, filled: 0, sends: false };
    join(UartReceiver::new(source, buffer), output, messages, hurry)
}

/// Does nothing: DMA also receives while a flash operation stalls the processor.
pub fn before_stall() {}

/// Does nothing: `before_stall` has changed nothing.
pub fn after_stall() {}

impl Input {
    /// Starts receiving at this baud rate.
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
        // A read of the data register clears the error flags. But if a received byte is in the register, DMA must read
        // it. The flags are then cleared at the next look (reading of the buffer).
        if read(USART + SR) & ARRIVED == 0 {
            let _ = read(USART + DATA);
        }
        NVIC::unpend(VECTOR);
    }

    fn settle(&self) {
        cortex_m::asm::delay(SERVED_CYCLES);
    }
}

/// The sending part of the UART: DMA sends one half of the buffer while the serial task fills the other.
pub struct Halves {
    _tx: Tx<pac::USART2>,
    halves: &'static mut [[u8; HALF]; 2],
    /// The half being filled, and the number of bytes in it.
    half: usize,
    filled: usize,
    /// DMA is sending the other half.
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

    /// Sends the half being filled, if the other one has been sent.
    fn begin(&mut self) {
        // The flag of the completed transfer shows that the other half has been sent. NDTR is no proof: it may reach 0
        // before the last byte is transferred.
        if read(DMA + HISR) & SENT != 0 {
            self.sends = false;
            clear_flags(DMA, SENDER);
        }
        if !self.sends
            && self.filled > 0
            && let Some(half) = self.halves.get(self.half)
        {
            // The half must be written before DMA reads it.
            fence(Ordering::SeqCst);
            let memory = half.as_ptr() as usize;
            switch_on(DMA, SENDER, USART + DATA, memory, self.filled, SENDS);
            (self.half, self.filled, self.sends) = (1 - self.half, 0, true);
        }
    }
}
