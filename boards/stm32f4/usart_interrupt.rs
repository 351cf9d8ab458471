//! UART with an interrupt for each byte, at the priority of the inputs. Used on boards where only DMA2 could serve the
//! USART. DMA2 outputs the step edges there, and must not serve APB2, the bus of the USART, at the same time
//! (`chain`).
//!
//! ```text
//!  USART ──▶ interrupt ──▶ buffer
//!  USART ──▶ DMA ────────▶ buffer      only while flash is written or erased: the machine is at rest then
//!  USART ◀── interrupt ◀── queue ◀── serial task
//! ```
//! A USART holds a byte until the next one has arrived: 87 us at 115,200 baud, the maximum rate of a board with this
//! UART (`$931`). The longest run of the step task, plus the other work at the priority of the inputs, takes less.

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

/// Capacity of the queue of messages to the serial task. A line that arrives slowly takes one message per 200 us.
/// While the queue is full, bytes wait in the receive buffer.
const MESSAGES: usize = 6;
/// Capacity of the queue of bytes to be sent.
const SENT: usize = 16;

// SR: framing error and noise, a lost byte, a received byte, room for a byte to be sent.
const FRAMING: u32 = 1 << 1;
const NOISE: u32 = 1 << 2;
const DAMAGED: u32 = FRAMING | NOISE;
const OVERRUN: u32 = 1 << 3;
const ARRIVED: u32 = 1 << 5;
const SEND_FREE: u32 = 1 << 7;
// CR1: interrupts when a byte has arrived (RXNEIE), and when a byte can be sent (TXEIE).
const CALL_WHEN_COME: u32 = 1 << 5;
const CALL_WHEN_FREE: u32 = 1 << 7;
// CR3, in which no other bits are set: interrupt at an error (EIE), DMA receives (DMAR).
const CALL_AT_ERROR: u32 = 1 << 0;
const DMA_RECEIVES: u32 = 1 << 6;

/// The receiving stream (reference manuals, "DMA2 request mapping"): channel 4, half-words, not circular. The step
/// output never uses this stream.
const DMA: usize = 0x4002_6400;
const STREAM: usize = 5;
const RECEIVES: u32 = 4 << 25 | MEMORY_COUNTS | 1 << 11 | 1 << 13;
const USART: usize = 0x4001_1000;
const VECTOR: pac::Interrupt = pac::Interrupt::USART1;

/// State of the UART's interrupt, which fills the receive buffer and sends queued bytes.
pub struct ByInterrupt {
    _rx: Rx<pac::USART1>,
    buffer: &'static Buffer,
    /// Clock of the USART's bus, Hz.
    clock: u32,
    /// Index of the slot for the next received byte.
    place: usize,
    /// Bytes were lost before the next byte that will be put into the buffer.
    is_behind_loss: bool,
    /// One of the bytes that DMA has fetched may be damaged.
    is_damaged: bool,
    /// The queue of bytes to be sent; the serial task fills it.
    sent: Receiver<'static, u8, SENT>,
}

/// The receiver, for the tasks `inputs` and `uart`, which have the same priority.
pub type Input = UartInput<ByInterrupt, MESSAGES>;
/// The UART, for the serial task.
pub type InterruptPort = Usart<Queue, MESSAGES>;

/// Takes the USART over from the HAL. Receiving starts with [`Input::start`]. Not inlined into the set-up, because the
/// stack frame of the set-up would then include the initial values of the buffers created here.
#[inline(never)]
pub fn start((tx, rx): (Tx<pac::USART1>, Rx<pac::USART1>), rcc: &mut Rcc) -> (Input, InterruptPort) {
    pac::DMA2::enable(rcc);
    let (Some(buffer), Some(queue), Some(messages), Some(hurry)) = (
        singleton!(: Buffer = [const { AtomicU16::new(0) }; SLOTS]),
        singleton!(: Channel<u8, SENT> = Channel::new()),
        singleton!(: Channel<ReceivedBytes, MESSAGES> = Channel::new()),
        singleton!(: Signal<u32> = Signal::new()),
    ) else {
        unreachable!()
    };
    let (bytes, sent) = queue.split();
    let clock = pac::USART1::clock(&rcc.clocks).raw();
    let (place, is_behind_loss, is_damaged) = (0, false, false);
    let source = ByInterrupt { _rx: rx, buffer, clock, place, is_behind_loss, is_damaged, sent };
    join(UartReceiver::new(source, buffer), Queue { _tx: tx, bytes }, messages, hurry)
}

impl Input {
    /// Starts receiving at this baud rate.
    pub fn start(&mut self, baud: u32) {
        let source = self.receiver.source();
        set_baud(USART, source.clock, baud);
        source.prepare();
        write(USART + CR_1, read(USART + CR_1) | CALL_WHEN_COME);
    }

    /// Handles the UART's interrupt. It has three causes: a byte has arrived, the next byte can be sent, or a flash
    /// operation has ended. During a flash operation the processor is stalled and DMA receives.
    #[inline]
    pub fn on_interrupt(&mut self) {
        let control = read(USART + CR_3);
        let stood = control & DMA_RECEIVES != 0;
        if stood {
            self.receiver.source().end_of_dma();
        }
        let mut status = read(USART + SR);
        if stood && (control & CALL_AT_ERROR != 0 || status & DAMAGED != 0) {
            // It is unknown which of the bytes that DMA fetched is damaged. So all of them are refused when they are
            // read from the buffer. The byte that is in the data register now is refused, too.
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
            // Note an overrun only after the byte just read, because that byte arrived before the lost one.
            if status & OVERRUN != 0 {
                self.receiver.source().is_behind_loss = true;
            }
        }
        if status & SEND_FREE != 0 {
            self.receiver.source().send();
        }
    }

    /// Writes a received byte into the buffer. Passes a command that stops the machine on at once.
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
    /// Programs the DMA stream to write to the slot for the next byte. The stream is switched on only for a flash
    /// operation.
    fn prepare(&self) {
        let memory = self.buffer.get(self.place..).unwrap_or_default();
        program(DMA, STREAM, USART + DATA, memory.as_ptr() as usize, memory.len());
    }

    /// Ends receiving by DMA after a flash operation: sets `place` to the slot after the bytes that DMA has written,
    /// and lets the interrupt fetch the next bytes.
    fn end_of_dma(&mut self) {
        write(USART + CR_3, 0);
        write(USART + CR_1, read(USART + CR_1) | CALL_WHEN_COME | CALL_WHEN_FREE);
        let at = stream(DMA, STREAM);
        write(at + CR, RECEIVES);
        // Wait until DMA has written a byte that is in progress.
        await_off(at);
        let before = self.place;
        self.place = SLOTS - (read(at + NDTR) as usize).min(SLOTS);
        if self.place != before && core::mem::take(&mut self.is_behind_loss) {
            // Bytes are missing before those that DMA fetched. DMA cannot mark the gap, so the fetched bytes are
            // refused instead.
            self.is_damaged = true;
        }
        clear_flags(DMA, STREAM);
        self.prepare();
    }

    /// Sends the next queued byte; called when the data register is free. When the queue has become empty, calls the
    /// serial task, which may have more bytes.
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
        // While DMA receives, the buffer must not restart. The interrupt that ends receiving by DMA is already pending.
        let can = read(USART + CR_3) & DMA_RECEIVES == 0;
        if can && self.place > 0 {
            self.place = 0;
            self.prepare();
        }
        can
    }
}

/// Lets DMA receive during a flash operation, which stalls the processor. Call with interrupts off and the machine at
/// rest. Until [`after_stall`], only a damaged byte makes the interrupt of the UART pending, so the pending bit
/// records the damage. The error flags would not be enough: the manuals do not say whether a read by DMA clears them,
/// so they may be gone afterwards.
pub fn before_stall() {
    write(USART + CR_1, read(USART + CR_1) & !(CALL_WHEN_COME | CALL_WHEN_FREE));
    let in_doubt = read(USART + CR_3) & CALL_AT_ERROR != 0;
    if in_doubt || read(USART + SR) & DAMAGED != 0 {
        NVIC::pend(VECTOR);
    } else {
        NVIC::unpend(VECTOR);
    }
    let at = stream(DMA, STREAM);
    if read(at + NDTR) != 0 {
        write(at + CR, RECEIVES | EN);
    }
    write(USART + CR_3, DMA_RECEIVES | CALL_AT_ERROR);
}

/// Records in CR3 whether a byte was damaged while the processor was stalled: clears `CALL_AT_ERROR` if no byte was.
/// Then makes the interrupt of the UART pending. This interrupt ends receiving by DMA.
pub fn after_stall() {
    if !NVIC::is_pending(VECTOR) {
        write(USART + CR_3, DMA_RECEIVES);
    }
    NVIC::pend(VECTOR);
}

/// The sending side of the queue of bytes to be sent, for the serial task.
pub struct Queue {
    _tx: Tx<pac::USART1>,
    bytes: Sender<'static, u8, SENT>,
}

impl UartOutput for Queue {
    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        self.bytes.try_send(byte).is_ok()
    }

    /// Makes the interrupt of the UART pending. The interrupt sends a byte at once if the data register is free,
    /// otherwise as soon as the register becomes free.
    fn begin(&mut self) {
        if !self.bytes.is_empty() {
            NVIC::pend(VECTOR);
        }
    }
}
