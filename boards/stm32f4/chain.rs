//! Edges by timers and DMA: an event is written to the ports at its moment, whatever the processor is doing. The step
//! task fills a ring of events; TIM5 counts the time, DMA1 fetches the next moment, TIM1 times the pulse, and DMA2
//! writes the words to the ports.
//!
//! ```text
//!  TIM5 (32 bits, runs freely)                 TIM1 (one pulse, started by TIM5)
//!   CC1 ─┬─TRGO──────────────────────────────▶ CC1 (CC3) ─▶ DMA2 ─▶ BSRR   step on, directions; second port
//!        │                                     CC4 (CC2) ─▶ DMA2 ─▶ BSRR   step off, $0 later; of two ports the first
//!        └─▶ DMA1 S2 ─▶ TIM5_CCR1: the moment of the next event
//!   CC2, CC3: calls at a moment   CC4: calls by software
//!        CC3 ─▶ DMA1 S0 ─▶ TIM3_CCR2: the power of a beam at the step that begins its segment
//! ```
//! Moments are absolute, so no error adds up; and an event that was not committed in time has no moment: behind the last one
//! is a moment that is just past, which the counter comes to after 2^32 ticks. So pulses end by themselves when nothing
//! is committed, whatever the reason.
//!
//! Events that must not wait for each other (a probe is watched) are put out one by one: then the processor writes CCR1, and
//! CC1 calls it. Nothing else differs.
//!
//! What the parts demand, all of it held by the models of `tests/virtual_board`:
//!
//! * GPIO is written through DMA2's memory port, and DMA2 does nothing for APB2 meanwhile: ES0287 2.2.11 (F411). So
//!   rings are read as a "peripheral" that counts up.
//! * DMA1 fetches a word ahead: the moment of an event must be in the ring before the one but one before it is out.
//! * TIM1 must be clocked while the processor sleeps (`step_pins` sees to it), or it ignores its trigger.
//! * TIM1 ignores a trigger while it counts. Its counter would then be one event behind TIM5: the streams' counts differ.
//! * A request from before would be served at once: TIM1 is reset before each begin.
//! * A stream to a peripheral holds the next word from the moment it is on: that of the beam is switched on once more for each power, and one
//!   power is armed at a time. What is written to TIM3 at its moment acts at once.
//!
//! Emulated; no bench has confirmed it yet.

use super::dma::{
    self, CIRCULAR, CR, HISR, LISR, MEMORY_COUNTS, NDTR, PERIPHERAL_COUNTS, SERVED_CYCLES, TO_PERIPHERAL, VERY_HIGH,
    WORDS, stream, switch_on,
};
use super::registers::{Map, bsrr_of, read, timer::*, write};
use crate::contract::{COMBINATIONS, Due, Free};
use core::marker::PhantomData;
use core::sync::atomic::{Ordering, compiler_fence};

/// Places of the ring. That behind the last event stays free.
const RING: usize = 128;
/// Events that can be ahead, [`crate::StepOutput::DEPTH`]: a stop counts as many in less time than two bytes of the UART take.
/// 1 is the way back to an interrupt for each event, on all boards.
pub(super) const DEPTH: usize = 96;
/// Ticks of TIM1 from its start to the edge; the pulse ends so many later.
const EDGE_COUNT: u32 = 1;
/// Ticks between the last look at the time and the first moment, at least: TIM1 listens before it comes.
const LISTENS_TICKS: u32 = 48;
/// More ticks than it takes to begin once more, with all moments of the ring put off.
const AGAIN_TICKS: u32 = 2_200;
/// Ticks from a moment within which its request may be under way. At the greatest rate moments are some 90 apart.
const NEAR_TICKS: u32 = 48;
/// Ticks after which an event that is not out never will be.
const STANDS_TICKS: i32 = 500;
/// Looks at the counts that must all differ, besides the first.
const MORE_LOOKS: u32 = 8;

/// Error flags of four streams, and of that of the moments.
const ERRORS: u32 = dma::errors(&[0, 1, 2, 3]);
const MOMENT_ERRORS: u32 = dma::errors(&[MOMENTS]);

/// The stream of the moments, and its channel.
const MOMENTS: usize = 2;
const MOMENTS_CHANNEL: u32 = 6 << 25;
/// The stream of the beam's power, and its channel. It waits for that of the moments.
const BEAM: usize = 0;
const BEAM_CHANNEL: u32 = 6 << 25;
/// Channel of TIM1's compare events.
const EDGES_CHANNEL: u32 = 6 << 25;

/// Streams of DMA2 for a port, and the compare channels of TIM1 that ask them: of the edge and of the end of the pulse.
/// With one port stream 2, the receiver's on a Black Pill, stays free.
struct Streams {
    on: usize,
    off: usize,
    requests: u32,
}

const fn streams(port: usize, ports: usize) -> Streams {
    match (port, ports) {
        (0, 1) => Streams { on: 1, off: 4, requests: 1 << 9 | 1 << 12 },
        (0, _) => Streams { on: 1, off: 2, requests: 1 << 9 | 1 << 10 },
        _ => Streams { on: 6, off: 4, requests: 1 << 11 | 1 << 12 },
    }
}

/// SMCR of TIM1: TIM5 is its trigger (TS = 000), which starts it (SMS = 110) or is ignored.
///
/// ITR0 of TIM1 is TIM5 in the table "TIMx internal trigger connection" of TIM1_SMCR: RM0368 (F401; table 50), RM0383 (F411),
/// RM0390 (F446), RM0090 (F407; table 94). All four have the same row for TIM1: TIM5, TIM2, TIM3, TIM4. Taken from drivers that cite
/// these tables, as the manuals themselves were not at hand; no bench has confirmed it yet.
const IGNORED: u32 = 0;
const STARTS: u32 = IGNORED | 0b110;
/// CR1 of TIM1: one pulse.
const ONE_PULSE: u32 = 1 << 3;
/// CR2 of TIM5: its event of channel 1 is the trigger output (MMS = 011).
#[cfg(feature = "stm32f4")]
pub(super) const COMPARE_PULSE: u32 = 0b011 << 4;
/// DIER of TIM5: the DMA request of channel 1.
const ASKS_FOR_MOMENT: u32 = 1 << 9;
/// DIER of TIM5: the DMA request of channel 3.
const ASKS_FOR_POWER: u32 = 1 << 11;
/// DIER of TIM5: what calls at any time.
pub(super) const CALLS: u32 = Due::MORE.0 | Due::MARK.0 | Due::CALLED.0;
/// RCC: reset of APB2, TIM1's bit.
const APB2RSTR: usize = 0x24;
const TIM1_RESET: u32 = 1;

/// What DMA reads, at an address that stays.
#[repr(C, align(4))]
pub struct Rings<const P: usize> {
    /// For each port.
    words: [[u32; RING]; P],
    moments: [u32; RING],
    /// All pulses end.
    off: [u32; P],
    /// The next compare value of the PWM.
    power: u32,
}

impl<const P: usize> Rings<P> {
    /// Empty.
    pub const EMPTY: Self = Rings { words: [[0; RING]; P], moments: [0; RING], off: [0; P], power: 0 };
}

/// The chain on `P` ports.
pub(super) struct Chain<M, const P: usize> {
    rings: &'static mut Rings<P>,
    ports: [usize; P],
    /// Where the next event goes.
    head: usize,
    /// Length of a pulse in ticks of TIM1.
    pulse: u32,
    /// Events are put out.
    begun: bool,
    one_by_one: bool,
    /// One by one: an event has been committed and is not out.
    pending: bool,
    /// Moments that DMA1 has counted when the first is written: 1, or 2 if it counts a word when it fetches it. Of that the manual
    /// leaves a doubt (DMA_SxNDTR), so the part is asked at each begin.
    first_moments: usize,
    map: PhantomData<M>,
}

/// No pulse begins after this, and DMA writes no edge and no power. For a program that ends: nothing is counted any more.
#[cfg(feature = "stm32f4")]
#[inline(never)]
pub(super) fn cut<M: Map>() {
    write(M::TIM1 + SMCR, 0);
    write(M::TIM1 + CR1, 0);
    let streams = [(M::DMA1, BEAM), (M::DMA2, 1), (M::DMA2, 2), (M::DMA2, 4), (M::DMA2, 6)];
    for (dma, number) in streams {
        write(stream(dma, number) + CR, 0);
    }
    for (dma, number) in streams {
        dma::await_off(stream(dma, number));
    }
}

impl<M: Map, const P: usize> Chain<M, P> {
    /// Places that stay free: that behind the last event, and the one of which only the first port's word may be out.
    const SPARE: usize = if P > 1 { 2 } else { 1 };

    pub(super) const fn new(ports: [usize; P], rings: &'static mut Rings<P>) -> Self {
        Chain {
            rings,
            ports,
            head: 0,
            pulse: 1,
            begun: false,
            one_by_one: false,
            pending: false,
            first_moments: 1,
            map: PhantomData,
        }
    }

    /// At rest: the word of each port that ends all pulses, and their length.
    pub(super) fn set_off(&mut self, off: [u32; P]) {
        self.rings.off = off;
    }

    pub(super) fn set_pulse(&mut self, ticks: u32) {
        self.pulse = ticks;
    }

    /// What the step task has been called for.
    #[inline(always)]
    pub(super) fn take(&mut self) -> Due {
        let mut due = Due(read(M::TIM5 + SR));
        if !self.one_by_one {
            // Events that follow by themselves raise the flag, too, and DMA1 may be about to take it for its request.
            due = Due(due.0 & !Due::OUT.0);
        }
        if due.has(Due::MARK) {
            // The same: its request is served before the flag goes.
            self.keep_power();
        }
        // Flags are cleared by writing 0; a 1 leaves them alone.
        write(M::TIM5 + SR, !due.0);
        if due.has(Due::OUT) {
            self.pending = false;
        }
        due
    }

    /// Sets the moment of the call for more. The moment before, if it has come meanwhile, calls no more.
    #[inline(always)]
    pub(super) fn call_at(&mut self, moment: u32) {
        write(M::TIM5 + CCR2, moment);
        write(M::TIM5 + SR, !Due::MORE.0);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 {
            write(M::TIM5 + EGR, Due::MORE.0);
        }
    }

    /// The same of a mark; with a power, its event makes DMA1 write it.
    ///
    /// There is one event for each moment, and so one request: the flag is cleared while none can come, and where the moment has passed
    /// before it was set, as the flag tells, the event is made by hand. It asks for the same word.
    pub(super) fn mark_at(&mut self, moment: u32, power: Option<u32>) {
        self.keep_power();
        write(M::TIM5 + CCR3, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::MARK.0);
        if let Some(power) = power {
            self.rings.power = power;
            // DMA reads what has been written: the word is fetched as the stream is switched on.
            compiler_fence(Ordering::SeqCst);
            let how = CIRCULAR | WORDS | BEAM_CHANNEL | TO_PERIPHERAL;
            switch_on(M::DMA1, BEAM, M::TIM3 + CCR2, &raw const self.rings.power as usize, RING, how);
            write(M::TIM5 + DIER, read(M::TIM5 + DIER) | ASKS_FOR_POWER);
        }
        write(M::TIM5 + CCR3, moment);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 && read(M::TIM5 + SR) & Due::MARK.0 == 0 {
            write(M::TIM5 + EGR, Due::MARK.0);
            // Of this request no moment tells.
            cortex_m::asm::delay(SERVED_CYCLES);
        }
    }

    /// DMA writes no power after this. A request that is about to come is served before: one that is taken back half-way, or that no
    /// stream takes, would stay, and the next power come too soon.
    #[inline(never)]
    pub(super) fn keep_power(&mut self) {
        let asks = read(M::TIM5 + DIER);
        if asks & ASKS_FOR_POWER != 0 {
            self.await_served(CCR3);
            write(M::TIM5 + DIER, asks & !ASKS_FOR_POWER);
            write(stream(M::DMA1, BEAM) + CR, 0);
        }
    }

    /// Where the event is that comes next.
    #[inline(always)]
    fn tail(&self) -> usize {
        RING.wrapping_sub(read(stream(M::DMA2, streams(0, P).on) + NDTR) as usize) % RING
    }

    #[inline(always)]
    pub(super) fn ahead(&self) -> usize {
        match (self.begun, self.one_by_one) {
            (false, _) => self.head,
            (true, true) => usize::from(self.pending),
            (true, false) => self.head.wrapping_sub(self.tail()) % RING,
        }
    }

    /// Places for words of the last port, or for what is to become words (see `translate`), and for moments.
    #[inline(always)]
    pub(super) fn free<'a>(&'a mut self, table: &'a [u32; COMBINATIONS]) -> Free<'a> {
        let room = if self.one_by_one {
            1 - usize::from(self.pending)
        } else {
            (DEPTH + 1 - Self::SPARE).saturating_sub(self.ahead())
        };
        let end = (self.head + room).min(RING);
        let words = self.rings.words.last_mut().and_then(|words| words.get_mut(self.head..end)).unwrap_or_default();
        let moments = self.rings.moments.get_mut(self.head..end).unwrap_or_default();
        Free { table, words, moments }
    }

    /// Where words lie on several ports, an event holds the steps until it is committed: then each port gets its word.
    #[inline(always)]
    pub(super) fn translate(&mut self, tables: &[[u32; COMBINATIONS]; P], events: usize) {
        for at in (self.head..RING).take(events) {
            let steps = self.rings.words.last().and_then(|words| words.get(at)).copied().unwrap_or(0) as usize;
            for (words, table) in self.rings.words.iter_mut().zip(tables) {
                if let Some(word) = words.get_mut(at) {
                    *word = table.get(steps % COMBINATIONS).copied().unwrap_or(0);
                }
            }
        }
    }

    #[inline(always)]
    pub(super) fn commit(&mut self, events: usize) -> u32 {
        let last = self.moment_at(self.head.wrapping_add(events).wrapping_sub(1));
        self.head = self.head.wrapping_add(events) % RING;
        if let Some(behind) = self.rings.moments.get_mut(self.head) {
            *behind = last.wrapping_sub(1);
        }
        // DMA reads what has been written.
        compiler_fence(Ordering::SeqCst);
        if self.begun && self.one_by_one {
            self.pending = true;
            return self.set_moment(last);
        }
        0
    }

    #[inline(always)]
    fn moment_at(&self, place: usize) -> u32 {
        self.rings.moments.get(place % RING).copied().unwrap_or(0)
    }

    /// One by one: the moment of the event that has just been committed. Gives the ticks by which it was too late.
    #[inline(always)]
    fn set_moment(&mut self, moment: u32) -> u32 {
        write(M::TIM5 + CCR1, moment);
        let late = read(M::TIM5 + CNT).wrapping_sub(moment) as i32;
        if late >= 0 && read(M::TIM5 + SR) & Due::OUT.0 == 0 {
            let soon = read(M::TIM5 + CNT).wrapping_add(SERVED_CYCLES);
            write(M::TIM5 + CCR1, soon);
            return soon.wrapping_sub(moment);
        }
        0
    }

    #[inline(always)]
    pub(super) fn moment_before(&self, left: usize) -> u32 {
        if self.begun && self.ahead() <= left {
            return read(M::TIM5 + CNT);
        }
        self.moment_at(self.head.wrapping_sub(left).wrapping_sub(1))
    }

    /// DMA1 fetches the moment of an event when the one but one before it comes out: so it will, once events are begun.
    #[inline(always)]
    pub(super) fn joins_until(&self, next: u32) -> u32 {
        let is_alone = self.one_by_one || !self.begun && self.head < 2;
        if is_alone { next } else { self.moment_before(1) }
    }

    /// No request for a moment, and none before there is a moment again.
    fn expect_no_moment(&mut self) {
        write(M::TIM5 + DIER, CALLS);
        write(M::TIM5 + CCR1, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::OUT.0);
        compiler_fence(Ordering::SeqCst);
    }

    /// Waits until no request of a compare channel is under way, nor soon will be: moments are further apart than this takes.
    fn await_served(&self, channel: usize) {
        let moment = read(M::TIM5 + channel);
        // A look takes a tick at least.
        for _ in 0..3 * NEAR_TICKS {
            if (read(M::TIM5 + CNT).wrapping_sub(moment).wrapping_add(NEAR_TICKS)) >= 2 * NEAR_TICKS {
                return;
            }
        }
    }

    /// Gives the ticks by which all events had to be put off, as the first was not to be had in time.
    pub(super) fn begin(&mut self, one_by_one: bool) -> u32 {
        self.begun = true;
        self.one_by_one = one_by_one;
        self.pending = one_by_one;
        // Whatever TIM1 may still ask for is forgotten.
        write(M::RCC + APB2RSTR, TIM1_RESET);
        write(M::RCC + APB2RSTR, 0);
        let off = EDGE_COUNT + self.pulse;
        for (register, value) in [(CCR1, EDGE_COUNT), (CCR3, EDGE_COUNT), (CCR2, off), (CCR4, off), (ARR, off + 1)] {
            write(M::TIM1 + register, value);
        }
        write(M::TIM1 + SMCR, IGNORED);
        write(M::TIM1 + CR1, ONE_PULSE);
        self.expect_no_moment();
        let mut requests = 0;
        for port in 0..P {
            let Streams { on, off, requests: own } = streams(port, P);
            let (Some(words), Some(low)) = (self.rings.words.get(port), self.rings.off.get(port)) else { return 0 };
            let pins = self.ports.get(port).copied().map_or(0, bsrr_of::<M>);
            let common = CIRCULAR | WORDS | VERY_HIGH | EDGES_CHANNEL;
            switch_on(M::DMA2, on, words.as_ptr() as usize, pins, RING, common | PERIPHERAL_COUNTS);
            switch_on(M::DMA2, off, core::ptr::from_ref(low) as usize, pins, RING, common);
            requests |= own;
        }
        if one_by_one {
            write(M::TIM1 + DIER, requests);
            write(M::TIM1 + SMCR, STARTS);
            write(M::TIM5 + DIER, CALLS | Due::OUT.0);
            return self.set_moment(self.moment_at(0));
        }
        let how = CIRCULAR | WORDS | VERY_HIGH | MOMENTS_CHANNEL | TO_PERIPHERAL | MEMORY_COUNTS;
        let (mut put_off, mut again) = (0_u32, AGAIN_TICKS);
        loop {
            switch_on(M::DMA1, MOMENTS, M::TIM5 + CCR1, self.rings.moments.as_ptr() as usize, RING, how);
            cortex_m::asm::delay(SERVED_CYCLES);
            // The first moment comes by DMA as all others do, asked for by hand; TIM1 does not listen yet.
            write(M::TIM5 + DIER, CALLS | ASKS_FOR_MOMENT);
            write(M::TIM5 + EGR, Due::OUT.0);
            cortex_m::asm::delay(SERVED_CYCLES);
            // Before the first moment comes, or this is done once more.
            let counted = self.moments_counted();
            let is_fetched_ahead = counted == 2 && read(M::TIM5 + CCR1) == self.moment_at(0);
            self.first_moments = if is_fetched_ahead { 2 } else { 1 };
            write(M::TIM1 + DIER, requests);
            let left = self.moment_at(0).wrapping_sub(read(M::TIM5 + CNT));
            if left as i32 > LISTENS_TICKS as i32 {
                write(M::TIM1 + SMCR, STARTS);
                return put_off;
            }
            // It has passed, or would before TIM1 listens: nothing has come out, and all of it comes later by as much.
            self.await_served(CCR1);
            write(stream(M::DMA1, MOMENTS) + CR, 0);
            self.expect_no_moment();
            let by = again.wrapping_sub(left);
            // Whatever this takes, it comes to an end.
            again = again.wrapping_add(AGAIN_TICKS);
            for moment in &mut self.rings.moments {
                *moment = moment.wrapping_add(by);
            }
            put_off = put_off.wrapping_add(by);
        }
    }

    /// Whether the parts that count events disagree, or have failed. What differs while an event comes out agrees right after.
    #[inline(always)]
    pub(super) fn fault(&self) -> bool {
        if !self.begun {
            return false;
        }
        if self.one_by_one {
            // A trigger that TIM1 has missed: the event that was out has left its words behind.
            return !self.pending && self.lags() && (0..MORE_LOOKS).all(|_| self.lags());
        }
        if self.stands() {
            return true;
        }
        if (read(M::DMA2 + LISR) | read(M::DMA2 + HISR)) & ERRORS != 0 || read(M::DMA1 + LISR) & MOMENT_ERRORS != 0 {
            return true;
        }
        !self.counts_agree() && self.still_disagree()
    }

    #[inline(always)]
    fn lags(&self) -> bool {
        self.tail() != self.head
    }

    /// The moment of the event that comes next has passed.
    #[inline(always)]
    fn stands(&self) -> bool {
        let tail = self.tail();
        let since = read(M::TIM5 + CNT).wrapping_sub(self.moment_at(tail)) as i32;
        since > STANDS_TICKS && tail != self.head && tail == self.tail()
    }

    /// An event that comes out during a look makes that one differ, and the next at most. Counts that differ for good never agree.
    #[cold]
    #[inline(never)]
    fn still_disagree(&self) -> bool {
        (0..MORE_LOOKS).all(|_| !self.counts_agree())
    }

    /// Moments that DMA1 has counted, modulo the ring.
    #[inline(always)]
    fn moments_counted(&self) -> usize {
        RING.wrapping_sub(read(stream(M::DMA1, MOMENTS) + NDTR) as usize) % RING
    }

    /// Between two events: as many moments more than edges as at the begin, as many edges on all ports, and one end of a pulse less at
    /// most.
    #[inline(always)]
    fn counts_agree(&self) -> bool {
        let left = |number| read(stream(M::DMA2, number) + NDTR) as usize;
        let edges = left(streams(0, P).on);
        let mut agree = (self.moments_counted() + edges) % RING == self.first_moments;
        for port in 0..P {
            let Streams { on, off, .. } = streams(port, P);
            agree &= port == 0 || left(on) == edges;
            agree &= left(off).wrapping_sub(edges) % RING <= 1;
        }
        agree
    }

    /// After [`Chain::silence`], which gives the tail: how many events were not out. Has `each` see the words of those on each port.
    pub(super) fn undone(&mut self, tail: usize, mut each: impl FnMut(&[u32; P])) -> usize {
        let mut events = 0;
        let mut at = tail;
        while at != self.head % RING {
            let mut words = [0; P];
            for (word, ring) in words.iter_mut().zip(&self.rings.words) {
                *word = ring.get(at).copied().unwrap_or(0);
            }
            each(&words);
            events += 1;
            at = (at + 1) % RING;
        }
        (self.begun, self.one_by_one, self.pending) = (false, false, false);
        self.head = 0;
        events
    }

    /// Ends what has been begun, and power if it is to be dark: where the event is that did not come out any more, and whether the
    /// counts disagree.
    #[inline(always)]
    pub(super) fn silence(&mut self, dark: bool) -> (usize, bool) {
        if !self.begun {
            return (0, false);
        }
        write(M::TIM1 + SMCR, IGNORED);
        // A request that came right before is served: one of TIM5 that is taken back half-way would stay. First that for moments, of
        // which more than one would come while a change of power is awaited.
        self.await_served(CCR1);
        write(M::TIM5 + DIER, read(M::TIM5 + DIER) & ASKS_FOR_POWER | CALLS);
        self.keep_power();
        if dark {
            write(M::TIM3 + CCR2, 0);
        }
        cortex_m::asm::delay(SERVED_CYCLES);
        let tail = self.tail();
        let mut fault = false;
        for port in 1..P {
            fault |= read(stream(M::DMA2, streams(port, P).on) + NDTR) as usize % RING != (RING - tail) % RING;
        }
        fault |= (read(M::DMA2 + LISR) | read(M::DMA2 + HISR)) & ERRORS != 0;
        if !self.one_by_one {
            // As many more than events as at the begin; one more, if the next match came after TIM1 had ceased to listen.
            let more = self.moments_counted().wrapping_sub(tail).wrapping_sub(self.first_moments) % RING;
            fault |= more > 1 || read(M::DMA1 + LISR) & MOMENT_ERRORS != 0;
        }
        write(stream(M::DMA1, MOMENTS) + CR, 0);
        (tail, fault)
    }
}
