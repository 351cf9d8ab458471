//! The UART to the host. Its interrupt does nothing but put what has come into a ring and call the serial task where that
//! has something to do: text alone waits for the end of its line. It calls at once for a command that stops the machine, and
//! for all else once in 800 us, so that no flood of bytes takes all of the processor. The `Usart` is that task's port: it
//! takes the bytes, and puts answers into another ring, from which the interrupt sends. While a flash operation stalls the processor, `shelter` has DMA fill the first ring.
//!
//! ```text
//!  USART ──byte──▶ on_interrupt ──▶ ring ──▶ serial task      always
//!  USART ──byte──▶ DMA ───────────▶ ring ──▶ serial task      while flash is written or erased
//!  USART ◀──byte── on_interrupt ◀── ring ◀── serial task
//! ```
//! A USART holds one byte, and at 1 Mbaud the next one comes 10 us later; a run of the step task may take 50 us. So this
//! interrupt alone has a higher priority than that task: some 180 cycles for each byte, and edges, which timers and DMA
//! put out, wait for neither. (DMA alone would not do: the one stream that the receiver of USART2 can have puts out the
//! steps of a Nucleo.)
//!
//! A written word of flash may stall the processor for 100 us, an erase for half a second. What holds: a host that keeps to the
//! flow control (at most the 255 bytes that `Bf:` counts are under way) loses nothing, and besides there is room for 64
//! realtime commands (`REALTIME_DEPTH`). A host that sends more than 512 bytes in that time overruns the USART, which is
//! reported like any other loss.

use super::registers::{read, write};
use crate::calls::{call_soon, is_stop};
use crate::received::{Call, Next, Received};
use crate::sent::Sent;
use crate::{Incoming, Port};
use core::sync::atomic::{AtomicBool, Ordering::Relaxed, Ordering::SeqCst, fence};
use stm32f4xx_hal::{
    pac,
    rcc::{BusClock, Enable, Rcc},
    serial::{Instance, Rx, RxListen, Tx, TxListen},
};

static RECEIVED: Received = Received::new();
static SENT: Sent = Sent::new();
/// The serial task has more to send, and is called when there is room.
static IS_WAITING: AtomicBool = AtomicBool::new(false);

/// Bytes that are still to be sent when the task is called for more.
const FEW: u32 = 16;

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
const CALLS: u32 = 0b1_1111 << 4;
const CALL_WHEN_FREE: u32 = 1 << 7;
const ON: u32 = 1 << 13;
// CR3
const DMA_RECEIVES: u32 = 1 << 6;
/// An error calls while DMA receives.
const CALL_WHEN_DISTURBED: u32 = 1;

/// Keeps what the USART has received. The highest priority of all tasks.
#[inline(always)]
pub fn on_interrupt<U: Sheltered>() {
    let usart = U::PTR as usize;
    let status = read(usart + SR);
    if status & (ARRIVED | OVERRUN) != 0 {
        let byte = read(usart + DATA) as u8;
        if status & (FRAMING | NOISE) != 0 {
            RECEIVED.miss();
            call_soon();
        } else if status & ARRIVED != 0 {
            keep(byte);
        }
        // The byte that has been read came before the one that is lost.
        if status & OVERRUN != 0 {
            RECEIVED.miss();
            call_soon();
        }
    }
    if status & SEND_FREE != 0 {
        let control = read(usart + CR_1);
        if control & CALL_WHEN_FREE != 0 {
            match SENT.take() {
                Some(byte) => write(usart + DATA, u32::from(byte)),
                None => write(usart + CR_1, control & !CALL_WHEN_FREE),
            }
            if IS_WAITING.load(Relaxed) && SENT.waiting() <= FEW {
                IS_WAITING.store(false, Relaxed);
                crate::call_serial();
            }
        }
    }
}

#[inline(always)]
fn keep(byte: u8) {
    match RECEIVED.hear(byte) {
        Call::AtOnce => crate::call_serial(),
        Call::Soon => call_soon(),
        Call::NotYet => {}
    }
}

#[inline(never)]
fn keep_unheard(byte: u8) {
    RECEIVED.keep(byte, is_stop(byte));
}

/// What is left of a byte where one of several was disturbed: no line but an empty one is carried out that has one of them.
fn refused(byte: u8) -> u8 {
    if is_stop(byte) || matches!(byte, b'\n' | b'\r') { byte } else { REFUSED }
}

const REFUSED: u8 = b'@';

/// A USART whose receiver has a DMA stream (reference manual, "DMA request mapping").
pub trait Sheltered: Instance {
    /// The stream; each of them has the receiver on channel 4.
    const STREAM: usize;
    /// The interrupt.
    const CALLED: pac::Interrupt;
    /// The controller.
    fn dma() -> &'static pac::dma2::RegisterBlock;
    /// Switches the controller on.
    fn switch_on(rcc: &mut Rcc);
}

macro_rules! sheltered {
    ($usart:ident, $dma:ident, $stream:literal) => {
        impl Sheltered for pac::$usart {
            const STREAM: usize = $stream;
            const CALLED: pac::Interrupt = pac::Interrupt::$usart;

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
    // What waits is taken before, all of it and what comes meanwhile: moving it would take longer than a byte does to come, and where
    // it is much there may be little room behind it.
    critical_section::with(|_| RECEIVED.hurry());
    crate::call_serial();
    cortex_m::asm::dsb();
    cortex_m::asm::isb();
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
        // The manual does not say whether a byte that DMA fetches takes its error flags with it. If it does, the call of its error is still
        // pending afterwards, as nothing else of the USART calls meanwhile.
        let (control, receiving) = (read(usart + CR_1), read(usart + CR_3));
        write(usart + CR_1, control & !CALLS);
        // The bus may take its time: what is read back has arrived.
        let _ = read(usart + CR_1);
        pac::NVIC::unpend(U::CALLED);
        write(usart + CR_3, receiving | DMA_RECEIVES | CALL_WHEN_DISTURBED);
        work();
        write(usart + CR_3, receiving);
        let has_called = pac::NVIC::is_pending(U::CALLED);
        write(usart + CR_1, control);
        stream.cr().write(|w| raw!(w, STREAM));
        // It ends the byte that it is at.
        while stream.cr().read().bits() & STREAM_ON != 0 {}
        let count = room - stream.ndtr().read().bits().min(room);
        fence(SeqCst);
        // DMA reads no status: somewhere among these bytes, or behind them, one was disturbed. Its mark goes with the byte that
        // waits, or would be taken for that of the next; at once, or a byte that comes meanwhile would go, too.
        let status = read(usart + SR);
        if has_called || status & (FRAMING | NOISE) != 0 {
            let byte = refused(read(usart + DATA) as u8);
            RECEIVED.placed_disturbed(count, refused);
            // The last of them may have become the end of a line: what comes behind is refused up to its own.
            if status & ARRIVED != 0 {
                keep_unheard(byte);
            }
            keep_unheard(REFUSED);
            if status & OVERRUN != 0 {
                RECEIVED.miss();
            }
        } else {
            RECEIVED.placed(count);
        }
        clear_flags::<U>();
    });
    crate::call_serial();
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
}

impl<U: Sheltered + BusClock> Usart<U> {
    /// Begins to listen.
    pub fn new((tx, mut rx): (Tx<U>, Rx<U>), rcc: &Rcc) -> Self {
        rx.listen();
        Usart { tx, _rx: rx, clock: U::clock(&rcc.clocks).raw() }
    }
}

impl<U: Sheltered + BusClock> Port for Usart<U> {
    const WAITS: bool = false;

    /// Before anything is sent, and before the interrupt is enabled.
    fn set_baud(&mut self, baud: u32) {
        let usart = U::PTR as usize;
        let control = read(usart + CR_1);
        write(usart + CR_1, control & !ON);
        // Sixteen samples a bit: the quotient has four bits of fraction, and so has the register.
        write(usart + BRR, (self.clock + baud / 2) / baud);
        write(usart + CR_1, control);
        // What has come so far came at another rate, perhaps.
        let _ = (read(usart + SR), read(usart + DATA));
        RECEIVED.clear();
    }

    #[inline]
    fn receive(&mut self) -> Incoming {
        match RECEIVED.next() {
            Next::Byte(byte) => Incoming::Byte(byte),
            Next::Missing => Incoming::Lost,
            Next::Nothing => Incoming::Nothing,
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

    #[inline]
    fn is_urgent(&self) -> bool {
        RECEIVED.has_stop()
    }

    /// Every byte is fetched at once.
    #[inline]
    fn allow(&mut self, _room: usize) {}

    /// Puts a byte behind those that wait to be sent, if there is room.
    #[inline]
    fn send(&mut self, byte: u8) -> bool {
        SENT.put(byte)
    }

    #[inline]
    fn call_when_free(&mut self, wanted: bool) {
        IS_WAITING.store(wanted, Relaxed);
        if wanted || SENT.waiting() > 0 {
            self.tx.listen();
        }
    }
}
