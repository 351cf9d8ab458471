//! Time-stamps every edge at three input pins without the CPU: at each edge a timer captures its count, and DMA writes
//! this count to memory.
//!
//! ```text
//!  PB6 ── TIM4 channel 1 ── DMA1 stream 0 ──▶ first line
//!  PB7 ── TIM4 channel 2 ── DMA1 stream 3 ──▶ second line
//!  PB8 ── TIM4 channel 3 ── DMA1 stream 7 ──▶ third line
//! ```
//! TIM4 counts the same clock as the step timer, so a count is a tick of the step clock (10 to 12 ns), and errors of
//! that clock are not visible here. TIM4 has 16 bits and wraps every 650 to 780 us, so a difference of two counts is
//! known only modulo 2^16. A filter accepts a new level at an input after four equal samples, one per tick. It delays
//! rising and falling edges equally.
//!
//! All STM32F4 parts of these boards have these pins, channels and streams (RM0383, RM0368, RM0390: DMA request
//! mapping, and the data sheets' tables of alternate functions).

use core::sync::atomic::{AtomicU16, Ordering, fence};
use oxmill_boards::pac;

/// Maximum number of edges recorded for a line (an input pin with its wire); later edges are lost.
pub const DEPTH: usize = 2048;
/// Numbers of the three input pins on port B, one for each line.
const PINS: [u32; 3] = [6, 7, 8];
/// Numbers of the three streams of DMA1, one for each line.
const STREAMS: [usize; 3] = [0, 3, 7];
/// Alternate function of these pins that connects them to TIM4.
const FUNCTION: u32 = 2;

static EDGES: [[AtomicU16; DEPTH]; 3] = [const { [const { AtomicU16::new(0) }; DEPTH] }; 3];

/// Writes a whole register as a number.
macro_rules! raw {
    ($register:expr, $bits:expr) => {{
        // SAFETY: unsafe because the device crate cannot know which numbers a register takes; safe because each number
        // is explained where it is written, and the only address of memory among them is that of a static that has room
        // for all counts that DMA writes.
        unsafe { $register.bits($bits) }
    }};
}

/// Recorder of the edges on the three lines.
pub struct Capture {
    timer: pac::TIM4,
    dma: pac::DMA1,
}

/// The edges recorded on a line: for each, the 16-bit count of TIM4.
#[derive(Clone, Copy)]
pub struct Edges(&'static [AtomicU16]);

impl Edges {
    /// Returns the number of recorded edges, at most [`DEPTH`].
    pub fn count(&self) -> usize {
        self.0.len()
    }

    /// Returns the count of the timer at an edge. `edge`: index from 0, less than [`Edges::count`].
    pub fn at(&self, edge: usize) -> u16 {
        self.0[edge].load(Ordering::Relaxed)
    }
}

impl Capture {
    /// Makes the pins inputs of the timer, with pull-downs, and starts the timer.
    pub fn new(timer: pac::TIM4, dma: pac::DMA1, port: &pac::GPIOB, rcc: &pac::RCC) -> Capture {
        rcc.apb1enr().modify(|_, w| w.tim4en().set_bit());
        rcc.ahb1enr().modify(|_, w| w.dma1en().set_bit());
        // An enabled clock starts after two bus cycles; reading the register back waits for them.
        let _ = rcc.ahb1enr().read();
        for pin in PINS {
            let two = 2 * pin;
            port.pupdr().modify(|r, w| raw!(w, r.bits() & !(0b11 << two) | 0b10 << two));
            let four = 4 * (pin % 8);
            if pin < 8 {
                port.afrl().modify(|r, w| raw!(w, r.bits() & !(0xF << four) | FUNCTION << four));
            } else {
                port.afrh().modify(|r, w| raw!(w, r.bits() & !(0xF << four) | FUNCTION << four));
            }
            port.moder().modify(|r, w| raw!(w, r.bits() & !(0b11 << two) | 0b10 << two));
        }
        timer.arr().write(|w| raw!(w, 0xFFFF));
        // CCxS = 1: the channel's own pin. ICxF = 2: four equal samples.
        timer.ccmr1_input().write(|w| raw!(w, 0x2121));
        timer.ccmr2_input().write(|w| raw!(w, 0x0021));
        // CCxE with CCxP and CCxNP: both edges.
        timer.ccer().write(|w| raw!(w, 0x0BBB));
        timer.cr1().write(|w| w.cen().set_bit());
        Capture { timer, dma }
    }

    /// Returns the timer's present count, in ticks of the step clock.
    pub fn now(&self) -> u16 {
        self.timer.cnt().read().bits() as u16
    }

    /// Discards earlier edges and starts recording.
    pub fn start(&mut self) {
        self.timer.dier().write(|w| raw!(w, 0));
        let sources = [self.timer.ccr1().as_ptr(), self.timer.ccr2().as_ptr(), self.timer.ccr3().as_ptr()];
        for stream in STREAMS {
            let stream = self.dma.st(stream);
            stream.cr().write(|w| raw!(w, 0));
            while stream.cr().read().bits() & 1 != 0 {}
        }
        // Clears all flags of all streams.
        self.dma.lifcr().write(|w| raw!(w, 0x0F7D_0F7D));
        self.dma.hifcr().write(|w| raw!(w, 0x0F7D_0F7D));
        for ((stream, source), edges) in STREAMS.into_iter().zip(sources).zip(&EDGES) {
            let stream = self.dma.st(stream);
            stream.par().write(|w| raw!(w, source as u32));
            stream.m0ar().write(|w| raw!(w, edges.as_ptr() as u32));
            stream.ndtr().write(|w| raw!(w, DEPTH as u32));
            // Channel 2; 16 bits from the register to 16 bits of memory, with incrementing memory address; enable.
            stream.cr().write(|w| raw!(w, 2 << 25 | 1 << 13 | 1 << 11 | 1 << 10 | 1));
        }
        // Clears the flags of captures that DMA did not fetch.
        self.timer.sr().write(|w| raw!(w, 0));
        // DMA requests of channels 1 to 3.
        self.timer.dier().write(|w| raw!(w, 0b111 << 9));
    }

    /// Ends recording and returns the edges of the three lines. Returns `None` if an edge arrived before DMA had
    /// fetched the previous one, or if there were too many edges.
    pub fn stop(&mut self) -> Option<[Edges; 3]> {
        let flags = self.timer.sr().read().bits();
        self.timer.dier().write(|w| raw!(w, 0));
        fence(Ordering::SeqCst);
        let mut lines = [Edges(&[]); 3];
        for ((line, stream), edges) in lines.iter_mut().zip(STREAMS).zip(&EDGES) {
            let left = self.dma.st(stream).ndtr().read().bits() as usize;
            *line = Edges(&edges[..DEPTH - left.min(DEPTH)]);
        }
        // CCxOF: a capture was overwritten before DMA had fetched it. CCxIF: a capture was not fetched, because DMA had
        // reached the end of its memory.
        (flags & (0b111 << 9 | 0b111 << 1) == 0).then_some(lines)
    }
}
