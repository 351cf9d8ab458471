//! The UART to the host. Its interrupt does nothing but put what has come into a ring and call the serial task where that
//! has something to do. The `Usart` is that task's port: it takes the bytes, sends, and listens at the rate that its
//! `BaudGuard` says. While a flash operation stalls the processor, `shelter` has DMA fill the same ring.
//!
//! ```text
//!  USART ──byte──▶ on_interrupt ──▶ ring ──▶ serial task      always
//!  USART ──byte──▶ DMA ───────────▶ ring ──▶ serial task      while flash is written or erased
//! ```
//! A USART holds one byte, and at 1 Mbaud the next one comes 10 us later; a run of the step task may take 50 us. So this
//! interrupt alone has a higher priority than that task: some 60 cycles for each byte, and edges, which timers and DMA
//! put out, wait for neither. (DMA alone would not do: the one stream that the receiver of USART2 can have puts out the
//! steps of a Nucleo.)
//!
//! A written word of flash may stall the processor for 100 us, an erase for half a second. What holds: a host that keeps to the
//! flow control (at most the 255 bytes that `Bf:` counts are under way) loses nothing, and besides there is room for 64
//! realtime commands (`REALTIME_DEPTH`). A host that sends more than 512 bytes in that time overruns the USART, which is
//! reported like any other loss.
//!
//! Names: the interrupt is `on_interrupt`, the ring `RECEIVED`, the bytes that are not text `is_urgent`. `shelter` sets a
//! stream up (`par`, `m0ar`, `ndtr`) while the `work` is done; `Sheltered` names the stream of each USART. Registers are
//! read and written raw (`SR`, `DATA`, `BRR`, `CR_1`, `CR_3`), the stream's through the `RegisterBlock` of DMA1 or `DMA2`
//! (`switch_on`, `LIFCR`, `HIFCR`).

use super::registers::{read, write};
use crate::baud::BaudGuard;
use crate::received::{Error, Next, Received};
use crate::{Incoming, Port, clock_ticks};
use core::sync::atomic::{AtomicBool, Ordering, compiler_fence};
use stm32f4xx_hal::{
    pac,
    prelude::*,
    rcc::{BusClock, Enable, Rcc},
    serial::{Instance, Rx, RxListen, Tx, TxListen},
};

static RECEIVED: Received = Received::new();
/// The end of a line or a `?` has come.
static MAKES_SENSE: AtomicBool = AtomicBool::new(false);

/// Bytes of text that may wait in the ring for the end of their line.
const GATHERED: u32 = 32;

/// Registers of a USART.
const SR: usize = 0x00;
const DATA: usize = 0x04;
const BRR: usize = 0x08;
const CR_1: usize = 0x0C;
const CR_3: usize = 0x14;
// SR
const FRAMING: u32 = 1 << 1;
const NOISE: u32 = 1 << 2;
const OVERRUN: u32 = 1 << 3;
const ARRIVED: u32 = 1 << 5;
const SEND_FREE: u32 = 1 << 7;
// CR1
const CALL_WHEN_FREE: u32 = 1 << 7;
const ON: u32 = 1 << 13;
// CR3
const DMA_RECEIVES: u32 = 1 << 6;

/// Keeps what the USART has received, and calls the serial task if that has something to do: for text alone it has not
/// before the end of the line, or some bytes of it. The highest priority of all tasks.
#[inline(always)]
pub fn on_interrupt<U: Sheltered>() {
    let usart = U::PTR as usize;
    let status = read(usart + SR);
    let mut calls = false;
    if status & (ARRIVED | OVERRUN) != 0 {
        let byte = read(usart + DATA) as u8;
        if status & (FRAMING | NOISE) != 0 {
            RECEIVED.miss(if status & FRAMING != 0 { Error::Garbled } else { Error::Lost });
            calls = true;
        } else if status & ARRIVED != 0 {
            calls = is_urgent(byte) | RECEIVED.keep(byte).is_none_or(|waiting| waiting >= GATHERED);
        }
        // The byte that has been read came before the one that is lost.
        if status & OVERRUN != 0 {
            RECEIVED.miss(Error::Lost);
            calls = true;
        }
    }
    if status & SEND_FREE != 0 {
        let control = read(usart + CR_1);
        if control & CALL_WHEN_FREE != 0 {
            write(usart + CR_1, control & !CALL_WHEN_FREE);
            calls = true;
        }
    }
    if calls {
        crate::call_serial();
    }
}

/// Whether a byte is more than text of a line.
#[inline(always)]
fn is_urgent(byte: u8) -> bool {
    if matches!(byte, b'\n' | b'\r' | b'?') {
        MAKES_SENSE.store(true, Ordering::Relaxed);
        return true;
    }
    !(b' '..=b'}').contains(&byte) || byte == b'!'
}

/// A USART whose receiver has a DMA stream (reference manual, "DMA request mapping").
pub trait Sheltered: Instance {
    /// The stream; each of them has the receiver on channel 4.
    const STREAM: usize;
    /// The controller.
    fn dma() -> &'static pac::dma2::RegisterBlock;
    /// Switches the controller on.
    fn switch_on(rcc: &mut Rcc);
}

macro_rules! sheltered {
    ($usart:ident, $dma:ident, $stream:literal) => {
        impl Sheltered for pac::$usart {
            const STREAM: usize = $stream;

            fn dma() -> &'static pac::dma2::RegisterBlock {
                // SAFETY: unsafe because the controller is reached without owning it; safe because `shelter` touches one
                // stream of it, which nothing else uses while nothing moves: the step outputs, which have one of them in
                // common on a Nucleo (DMA1 S5), set all of theirs up at each begin.
                unsafe { &*pac::$dma::ptr() }
            }

            fn switch_on(rcc: &mut Rcc) {
                pac::$dma::enable(rcc);
            }
        }
    };
}

sheltered!(USART1, DMA2, 2);
sheltered!(USART2, DMA1, 5);

/// CR of a stream: on; memory address counts up; channel 4. All else 0: peripheral to memory, bytes, once.
const STREAM_ON: u32 = 1;
const STREAM: u32 = 1 << 10 | 4 << 25;

/// A whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers the register takes; safe because the stream
        // can only write to the part of the ring that it is given, whose atomics may change at any moment.
        unsafe { $register.bits($bits) }
    }};
}

/// Works with the DMA standing in for the interrupt. No task runs meanwhile.
pub fn shelter<U: Sheltered>(work: &mut dyn FnMut()) {
    critical_section::with(|_| {
        let usart = U::PTR as usize;
        let stream = U::dma().st(U::STREAM);
        let (memory, room) = RECEIVED.place();
        // Flags of an earlier use would keep the stream from starting; all of its flags are cleared by ones.
        clear_flags::<U>();
        stream.par().write(|w| raw!(w, (usart + DATA) as u32));
        stream.m0ar().write(|w| raw!(w, memory as u32));
        stream.ndtr().write(|w| raw!(w, room));
        stream.cr().write(|w| raw!(w, STREAM));
        if room > 0 {
            stream.cr().write(|w| raw!(w, STREAM | STREAM_ON));
        }
        write(usart + CR_3, read(usart + CR_3) | DMA_RECEIVES);
        work();
        write(usart + CR_3, read(usart + CR_3) & !DMA_RECEIVES);
        stream.cr().write(|w| raw!(w, STREAM));
        // It ends the byte that it is at.
        while stream.cr().read().bits() & STREAM_ON != 0 {}
        let left = stream.ndtr().read().bits();
        compiler_fence(Ordering::SeqCst);
        RECEIVED.placed(room - left.min(room));
        clear_flags::<U>();
    });
    // Ends of lines may be among them.
    MAKES_SENSE.store(true, Ordering::Relaxed);
}

fn clear_flags<U: Sheltered>() {
    // Four streams share a register; their flags of six bits stand at 0, 6, 16 and 22 (LIFCR, HIFCR).
    let shift = [0, 6, 16, 22][U::STREAM % 4];
    let flags = 0x3D << shift;
    if U::STREAM < 4 {
        U::dma().lifcr().write(|w| raw!(w, flags));
    } else {
        U::dma().hifcr().write(|w| raw!(w, flags));
    }
}

/// The serial task's end of a USART.
pub struct Usart<U: Instance> {
    tx: Tx<U>,
    _rx: Rx<U>,
    /// Hz of its bus.
    clock: u32,
    guard: BaudGuard,
}

impl<U: Sheltered + BusClock> Usart<U> {
    /// Begins to listen.
    pub fn new((tx, mut rx): (Tx<U>, Rx<U>), rcc: &Rcc) -> Self {
        rx.listen();
        Usart { tx, _rx: rx, clock: U::clock(&rcc.clocks).raw(), guard: BaudGuard::new() }
    }

    /// Changes to a rate. What is being sent is garbled.
    fn listen_at(&mut self, baud: u32) {
        let usart = U::PTR as usize;
        critical_section::with(|_| {
            let control = read(usart + CR_1);
            write(usart + CR_1, control & !ON);
            // Sixteen samples a bit: the register is the quotient, in sixteenths of sixteen.
            write(usart + BRR, (self.clock + baud / 2) / baud);
            write(usart + CR_1, control);
        });
    }
}

impl<U: Sheltered + BusClock> Port for Usart<U> {
    const WAITS: bool = false;

    fn set_baud(&mut self, baud: u32) {
        self.guard.choose(baud);
        self.listen_at(baud);
    }

    #[inline]
    fn receive(&mut self) -> Incoming {
        match RECEIVED.next() {
            Next::Byte(byte) => Incoming::Byte(byte),
            Next::Nothing => Incoming::Nothing,
            Next::Missing(error) => {
                if error == Error::Garbled
                    && let Some(baud) = self.guard.garbled(clock_ticks())
                {
                    self.listen_at(baud);
                }
                Incoming::Lost
            }
        }
    }

    #[inline]
    fn fetched(&self) -> &[u8] {
        RECEIVED.ready()
    }

    #[inline]
    fn pass(&mut self, count: usize) {
        RECEIVED.pass(count);
    }

    /// Every byte is fetched at once.
    #[inline]
    fn allow(&mut self, _room: usize) {
        if self.guard.is_settled() {
            return;
        }
        if MAKES_SENSE.swap(false, Ordering::Relaxed) {
            self.guard.heard(clock_ticks());
        } else if let Some(baud) = self.guard.home_again(clock_ticks()) {
            self.listen_at(baud);
        }
    }

    /// Sends a byte if the data register is free.
    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        self.tx.write(byte).is_ok()
    }

    /// Whether to be called when the data register becomes free.
    #[inline]
    fn call_when_free(&mut self, wanted: bool) {
        if wanted { self.tx.listen() } else { self.tx.unlisten() }
    }
}
