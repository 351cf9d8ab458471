//! A UART by an interrupt for each byte, at the priority of the inputs, for boards on which DMA2 has both the edges of the steps
//! and the only streams of this USART: it must do nothing for APB2 while it puts out steps (`chain`).
//!
//! ```text
//!  USART ──▶ interrupt ──▶ buffer
//!  USART ──▶ DMA ────────▶ buffer      while flash is written or erased: nothing moves then
//!  USART ◀── interrupt ◀── queue ◀── serial task
//! ```
//! A USART holds a byte for as long as the next one takes to come: 87 us at 115,200 baud, the most that such a board allows
//! (`$931`). The longest run of the step task and what else is at the priority of the inputs take less.

use super::dma::{CR, EN, MEMORY_COUNTS, NDTR, await_off, clear_flags, program, stream};
use super::registers::{read, write};
use super::usart::{CR_1, CR_3, DATA, SR, UartInput, UartOutput, Usart, join, set_baud};
use crate::calls::is_stop;
use crate::uart_receiver::{Buffer, ByteSource, ReceivedBytes, SLOTS, UartReceiver};
use core::sync::atomic::AtomicU16;
use cortex_m::{peripheral::NVIC, singleton};
use rtic_sync::channel::{Channel, Receiver, Sender};
use rtic_sync::signal::Signal;
use stm32f4xx_hal::{
    pac,
    rcc::{BusClock, Enable, Rcc},
    serial::{Rx, Tx},
};

/// Messages to the serial task. A line that comes slowly takes one for each 200 us; what finds no room waits in the buffer.
const MESSAGES: usize = 6;
/// Bytes that wait to be sent.
const SENT: usize = 16;

// SR
const FRAMING: u32 = 1 << 1;
const NOISE: u32 = 1 << 2;
const DAMAGED: u32 = FRAMING | NOISE;
const OVERRUN: u32 = 1 << 3;
const ARRIVED: u32 = 1 << 5;
const SEND_FREE: u32 = 1 << 7;
// CR1
const CALL_WHEN_COME: u32 = 1 << 5;
const CALL_WHEN_FREE: u32 = 1 << 7;
// CR3
const DMA_RECEIVES: u32 = 1 << 6;

/// The receiver's stream (reference manuals, "DMA2 request mapping"), on channel 4: half-words, once.
const DMA: usize = 0x4002_6400;
const STREAM: usize = 2;
const RECEIVES: u32 = 4 << 25 | MEMORY_COUNTS | 1 << 11 | 1 << 13;
const USART: usize = 0x4001_1000;
const VECTOR: pac::Interrupt = pac::Interrupt::USART1;

/// What fills the buffer, and what sends.
pub struct ByInterrupt {
    _rx: Rx<pac::USART1>,
    buffer: &'static Buffer,
    /// Hz of its bus.
    clock: u32,
    /// The slot of the next byte.
    place: usize,
    /// Bytes are missing before it.
    is_behind_loss: bool,
    /// DMA has fetched a damaged byte.
    is_damaged: bool,
    sent: Receiver<'static, u8, SENT>,
}

/// What the tasks at the priority of the inputs have of it.
pub type Input = UartInput<ByInterrupt, MESSAGES>;
/// What the serial task has of it.
pub type InterruptPort = Usart<Queue, MESSAGES>;

/// Takes the USART over from the HAL. It listens after [`Input::start`]. Not within the set-up, whose stack would have its buffers as well.
#[inline(never)]
pub fn by_interrupt((tx, rx): (Tx<pac::USART1>, Rx<pac::USART1>), rcc: &mut Rcc) -> (Input, InterruptPort) {
    pac::DMA2::enable(rcc);
    let (Some(buffer), Some(queue), Some(messages), Some(hurry)) = (
        singleton!(: Buffer = [const { AtomicU16::new(0) }; SLOTS]),
        singleton!(: Channel<u8, SENT> = Channel::new()),
        singleton!(: Channel<ReceivedBytes, MESSAGES> = Channel::new()),
        singleton!(: Signal<u32> = Signal::new()),
    ) else {
        unreachable!("set up twice")
    };
    let (bytes, sent) = queue.split();
    let clock = pac::USART1::clock(&rcc.clocks).raw();
    let (place, is_behind_loss, is_damaged) = (0, false, false);
    let source = ByInterrupt { _rx: rx, buffer, clock, place, is_behind_loss, is_damaged, sent };
    join(UartReceiver::new(source, buffer), Queue { _tx: tx, bytes }, messages, hurry)
}

impl Input {
    /// Begins to listen, at this rate.
    pub fn start(&mut self, baud: u32) {
        let source = self.receiver.source();
        set_baud(USART, source.clock, baud);
        source.prepare();
        write(USART + CR_1, read(USART + CR_1) | CALL_WHEN_COME);
    }

    /// The interrupt: a byte has come, or may go; or the processor has stood, and DMA has received meanwhile.
    #[inline]
    pub fn on_interrupt(&mut self) {
        let stood = read(USART + CR_3) & DMA_RECEIVES != 0;
        if stood {
            self.receiver.source().end_of_dma();
        }
        let mut status = read(USART + SR);
        if stood && status & DAMAGED != 0 {
            // It is not known which of the bytes that DMA has fetched: they are refused at the next look, and this one with them.
            self.receiver.source().is_damaged = true;
            if status & ARRIVED == 0 {
                let _ = read(USART + DATA);
            }
            status &= !DAMAGED;
        }
        if status & (ARRIVED | OVERRUN) != 0 {
            let byte = read(USART + DATA) as u8;
            if status & DAMAGED != 0 {
                self.receiver.source().is_behind_loss = true;
            } else if status & ARRIVED != 0 {
                self.put(byte);
            }
            // The byte that has been read came before the one that is lost.
            if status & OVERRUN != 0 {
                self.receiver.source().is_behind_loss = true;
            }
        }
        if status & SEND_FREE != 0 {
            self.receiver.source().send();
        }
    }

    fn put(&mut self, byte: u8) {
        let ByInterrupt { place, is_behind_loss, .. } = *self.receiver.source();
        let has_room = self.receiver.put(byte, place, is_behind_loss);
        let source = self.receiver.source();
        source.is_behind_loss = !has_room;
        if has_room {
            source.place += 1;
            source.prepare();
        }
        if is_stop(byte) && self.look().stop {
            self.pass_on(true);
            crate::call_serial();
        }
    }
}

impl ByInterrupt {
    /// Sees to it that DMA goes on at the slot of the next byte, if it has to.
    fn prepare(&self) {
        let memory = self.buffer.get(self.place..).unwrap_or_default();
        program(DMA, STREAM, USART + DATA, memory.as_ptr() as usize, memory.len());
    }

    /// DMA receives no longer.
    fn end_of_dma(&mut self) {
        write(USART + CR_3, read(USART + CR_3) & !DMA_RECEIVES);
        let at = stream(DMA, STREAM);
        write(at + CR, RECEIVES);
        // It ends the byte that it is at.
        await_off(at);
        let before = self.place;
        self.place = SLOTS - (read(at + NDTR) as usize).min(SLOTS);
        if self.place != before && core::mem::take(&mut self.is_behind_loss) {
            // DMA marks no byte as behind a loss: those that it has fetched are refused.
            self.is_damaged = true;
        }
        clear_flags(DMA, STREAM);
        self.prepare();
    }

    /// The data register is free for a byte that waits to be sent. At the end of what waits the serial task is called: it may have more.
    fn send(&mut self) {
        let control = read(USART + CR_1);
        let is_sending = control & CALL_WHEN_FREE != 0;
        match if self.sent.is_empty() { None } else { self.sent.try_recv().ok() } {
            Some(byte) => {
                write(USART + DATA, u32::from(byte));
                if !is_sending {
                    write(USART + CR_1, control | CALL_WHEN_FREE);
                }
            }
            None if is_sending => {
                write(USART + CR_1, control & !CALL_WHEN_FREE);
                crate::call_serial();
            }
            None => {}
        }
    }
}

impl ByteSource for ByInterrupt {
    const IS_CIRCULAR: bool = false;

    #[inline(always)]
    fn place(&self) -> usize {
        self.place
    }

    #[inline(always)]
    fn is_damaged(&self) -> bool {
        self.is_damaged
    }

    fn clear_damage(&mut self) {
        self.is_damaged = false;
    }

    fn begin_anew(&mut self) -> bool {
        // While DMA receives, the interrupt that ends it is pending.
        let can = read(USART + CR_3) & DMA_RECEIVES == 0;
        if can && self.place > 0 {
            self.place = 0;
            self.prepare();
        }
        can
    }
}

/// Has DMA receive until the interrupt, which follows, ends it: for an operation of the flash memory, which stalls the
/// processor. Interrupts are off, and nothing moves.
pub fn receive_by_dma() {
    let at = stream(DMA, STREAM);
    if read(at + NDTR) != 0 {
        write(at + CR, RECEIVES | EN);
    }
    write(USART + CR_3, read(USART + CR_3) | DMA_RECEIVES);
    NVIC::pend(VECTOR);
}

/// The serial task's end of what is sent.
pub struct Queue {
    _tx: Tx<pac::USART1>,
    bytes: Sender<'static, u8, SENT>,
}

impl UartOutput for Queue {
    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        self.bytes.try_send(byte).is_ok()
    }

    /// The interrupt sends, if the data register is free, and is called when it is.
    fn begin(&mut self) {
        if !self.bytes.is_empty() {
            NVIC::pend(VECTOR);
        }
    }
}
