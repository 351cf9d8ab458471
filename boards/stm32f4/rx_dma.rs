//! Received bytes while the processor is stalled by a flash operation: `shelter` has DMA copy what a USART receives
//! into RAM meanwhile; `Taken` gives the bytes out afterwards.
//!
//! ```text
//!  USART ──byte──▶ interrupt ──▶ serial task           always
//!  USART ──byte──▶ DMA ──▶ SHELTER ──▶ serial task     while flash is written or erased
//! ```
//! At 115200 baud a byte comes every 87 us and the USART holds one; a written word may take 100 us, an erase half a
//! second. What holds: a host that keeps to the flow control (at most the 255 bytes that `Bf:` counts are under way) loses
//! nothing, and besides there is room for 64 realtime commands (`REALTIME_DEPTH`). A host that sends more than 512 bytes in that time
//! overruns the USART, which is reported like any other loss.
//!
//! Names: Received bytes while the processor is stalled by a flash operation: `shelter` has a DMA stream (`par`,
//! `m0ar`, `ndtr`) copy what a USART receives into RAM, up to `ROOM` bytes, while the `work` is done, and notes their
//! `END`; `Taken` gives them out afterwards. `Sheltered` names the stream of each USART. It reads and writes the
//! `RegisterBlock` raw (`w`, `CR`, `LIFCR`, `HIFCR`), a stream of DMA1 or `DMA2` by `switch_on`, and its atomics are
//! `Relaxed`.

use core::sync::atomic::{AtomicU8, AtomicUsize, Ordering, compiler_fence};
use stm32f4xx_hal::{
    pac,
    rcc::{Enable, Rcc},
    serial::Instance,
};

const ROOM: usize = 512;
static BYTES: [AtomicU8; ROOM] = [const { AtomicU8::new(0) }; ROOM];
/// How many of them were received. Written while no task runs, and by `serial`.
static END: AtomicUsize = AtomicUsize::new(0);

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

/// USART registers: offsets of data and control 3, and the bit of control 3 that lets DMA fetch what is received.
const DATA: usize = 0x04;
const CONTROL_3: usize = 0x14;
const DMA_RECEIVES: u32 = 1 << 6;

/// CR of a stream: on; memory address counts up; channel 4. All else 0: peripheral to memory, bytes, once.
const STREAM_ON: u32 = 1;
const STREAM: u32 = 1 << 10 | 4 << 25;

/// A whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers the register takes; safe because the stream
        // can only write to the part of `BYTES` that it is given, whose atomics may change at any moment.
        unsafe { $register.bits($bits) }
    }};
}

/// Works with the DMA standing in for the serial task. No task runs meanwhile.
pub fn shelter<U: Sheltered>(work: &mut dyn FnMut()) {
    critical_section::with(|_| {
        let usart = U::PTR as usize;
        let stream = U::dma().st(U::STREAM);
        let begin = END.load(Ordering::Relaxed);
        let room = ROOM - begin;
        let memory = BYTES.as_ptr() as usize + begin;
        // Flags of an earlier use would keep the stream from starting; all of its flags are cleared by ones.
        clear_flags::<U>();
        stream.par().write(|w| raw!(w, (usart + DATA) as u32));
        stream.m0ar().write(|w| raw!(w, memory as u32));
        stream.ndtr().write(|w| raw!(w, room as u32));
        stream.cr().write(|w| raw!(w, STREAM));
        if room > 0 {
            stream.cr().write(|w| raw!(w, STREAM | STREAM_ON));
        }
        set_receiver(usart, true);
        work();
        set_receiver(usart, false);
        stream.cr().write(|w| raw!(w, STREAM));
        // It ends the byte that it is at.
        while stream.cr().read().bits() & STREAM_ON != 0 {}
        let left = stream.ndtr().read().bits() as usize;
        compiler_fence(Ordering::SeqCst);
        END.store(ROOM - left.min(room), Ordering::Relaxed);
        clear_flags::<U>();
    });
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

fn set_receiver(usart: usize, dma: bool) {
    let control = (usart + CONTROL_3) as *mut u32;
    // SAFETY: unsafe because the USART belongs to the serial task; safe because that task does not run meanwhile and
    // never writes this register.
    unsafe {
        let before = control.read_volatile();
        control.write_volatile(if dma { before | DMA_RECEIVES } else { before & !DMA_RECEIVES });
    }
}

/// The serial task's way to what was sheltered.
#[derive(Default)]
pub struct Taken(usize);

impl Taken {
    /// The next byte, in the order of their coming; all of them are older than what the USART holds.
    #[inline]
    pub fn next(&mut self) -> Option<u8> {
        let end = END.load(Ordering::Relaxed);
        if end == 0 {
            return None;
        }
        let byte = BYTES.get(self.0)?.load(Ordering::Relaxed);
        self.0 += 1;
        if self.0 >= end {
            self.0 = 0;
            END.store(0, Ordering::Relaxed);
        }
        Some(byte)
    }
    /// Whether [`Taken::append`] may be called.
    #[inline]
    pub fn has_room(&self) -> bool {
        END.load(Ordering::Relaxed) < ROOM
    }

    /// Keeps a byte behind the others.
    #[inline]
    pub fn append(&mut self, byte: u8) {
        let end = END.load(Ordering::Relaxed);
        if let Some(place) = BYTES.get(end) {
            place.store(byte, Ordering::Relaxed);
            END.store(end + 1, Ordering::Relaxed);
        }
    }
}
