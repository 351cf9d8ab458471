//! Hardware-timed step output: timers and DMA write each event to the GPIO ports at its time, without the CPU. The step
//! task fills a ring of events; TIM5 keeps the time, DMA1 loads the time of the next event, TIM1 times the pulse, and
//! DMA2 writes the words to the ports.
//!
//! ```text
//!  TIM5 (32 bits, runs freely)                 TIM1 (one pulse, started by TIM5)
//!   CC1 ─┬─TRGO──────────────────────────────▶ CC1 (CC3) ─▶ DMA2 ─▶ BSRR   step on, directions; second port
//!        │                                     CC4 (CC2) ─▶ DMA2 ─▶ BSRR   step off, $0 later; of two ports the first
//!        └─▶ DMA1 S2 ─▶ TIM5_CCR1: the time of the next event
//!   CC2, CC3: calls at a set time   CC4: calls by software
//!        CC3 ─▶ DMA1 S0 ─▶ TIM3_CCR2: the laser's power, at the step that begins its segment
//! ```
//! Event times are absolute, so errors do not accumulate. The ring entry after the last committed event holds a time
//! that has just passed, which the counter reaches only after 2^32 ticks. So if nothing is committed, for any reason,
//! the pulses end by themselves.
//!
//! While a probe is watched, events must not be queued: they are output one by one. Then the CPU writes CCR1, and CC1
//! interrupts. Nothing else differs.
//!
//! Hardware constraints, all checked by the models of `tests/virtual_board`:
//!
//! * ES0287 2.2.11 (F411): DMA2 must write GPIO through its memory port and must not serve APB2 meanwhile. The rings
//!   are therefore configured as an incrementing "peripheral".
//! * DMA1 fetches one word ahead: the time of an event must be in the ring before the event two before it is output.
//! * TIM1 must be clocked while the processor sleeps, or it ignores its trigger; `step_pins` enables that clock.
//! * TIM1 ignores a trigger while it counts. DMA2 then lags TIM5 by one event, which the streams' counts reveal.
//! * A stale request would be served at once: TIM1 is reset before each `begin`.
//! * A stream to a peripheral fetches its word when it is enabled. The laser's stream is therefore re-enabled for each
//!   power, and one power is armed at a time. A write to TIM3 takes effect at once.
//!
//! Tested in emulation only, not yet on hardware.

use super::dma::{
    self, CIRCULAR, CR, HISR, LISR, MEMORY_COUNTS, NDTR, PERIPHERAL_COUNTS, SERVED_CYCLES, TO_PERIPHERAL, VERY_HIGH,
    WORDS, stream, switch_on,
};
use super::registers::{Map, bsrr_of, read, timer::*, write};
use crate::contract::{COMBINATIONS, Due, Free};
use core::marker::PhantomData;
use core::sync::atomic::{Ordering, compiler_fence};

/// Slots of the ring. The slot after the last event stays free.
const RING: usize = 128;
/// Maximum number of events ahead ([`crate::StepOutput::DEPTH`]). A stop counts up to this many cancelled events, in
/// less time than two bytes of the UART take. With 1, all boards would use one interrupt for each event.
pub(super) const DEPTH: usize = 96;
/// Ticks of TIM1 from its start to the leading edge of the pulse. The trailing edge follows after the pulse length.
const EDGE_COUNT: u32 = 1;
/// Minimum ticks from the last reading of TIM5 to the first event, so that TIM1 listens for its trigger in time.
const LISTENS_TICKS: u32 = 48;
/// Upper bound, in ticks, of one more attempt in `begin`, including delaying all times of the ring.
const AGAIN_TICKS: u32 = 2_200;
/// Ticks around a scheduled time within which its DMA request may be under way. At the maximum rate, events are about
/// 90 ticks apart.
const NEAR_TICKS: u32 = 48;
/// An event that is this many ticks late will never be output.
const STANDS_TICKS: i32 = 500;
/// Number of repeated comparisons of the counts. Counts that differ are a fault only if they differ in all of these,
/// too.
const MORE_LOOKS: u32 = 8;

/// Error flags of streams 0 to 3. In both flag registers of DMA2, they cover streams 0 to 7.
const ERRORS: u32 = dma::errors(&[0, 1, 2, 3]);
/// Error flags of the stream [`MOMENTS`].
const MOMENT_ERRORS: u32 = dma::errors(&[MOMENTS]);

/// Stream of DMA1 that loads the event times, and its channel.
const MOMENTS: usize = 2;
const MOMENTS_CHANNEL: u32 = 6 << 25;
/// Stream of DMA1 that writes the laser's power, and its channel. Its priority is lower than that of [`MOMENTS`].
const BEAM: usize = 0;
const BEAM_CHANNEL: u32 = 6 << 25;
/// Channel of TIM1's compare events on DMA2.
const EDGES_CHANNEL: u32 = 6 << 25;

/// Streams of DMA2 for a port, `on` for the edge and `off` for the end of the pulse, and the DMA request bits of TIM1's
/// compare channels that trigger them. With one port, stream 2 stays free: it is the UART receiver's on a Black Pill.
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

/// SMCR of TIM1: TIM5 is the trigger (TS = 000) and is ignored.
///
/// ITR0 of TIM1 is TIM5 in the table "TIMx internal trigger connection" of TIM1_SMCR: RM0368 (F401; table 50), RM0383
/// (F411), RM0390 (F446), RM0090 (F407; table 94). All four have the same row for TIM1: TIM5, TIM2, TIM3, TIM4. Source:
/// drivers that cite these tables, as the manuals themselves were not available; not yet confirmed on hardware.
const IGNORED: u32 = 0;
/// SMCR of TIM1: TIM5 starts it (SMS = 110).
const STARTS: u32 = IGNORED | 0b110;
/// CR1 of TIM1: one-pulse mode.
const ONE_PULSE: u32 = 1 << 3;
/// CR2 of TIM5: the compare event of channel 1 is the trigger output (MMS = 011).
#[cfg(feature = "stm32f4")]
pub(super) const COMPARE_PULSE: u32 = 0b011 << 4;
/// DIER of TIM5: DMA request of channel 1.
const ASKS_FOR_MOMENT: u32 = 1 << 9;
/// DIER of TIM5: DMA request of channel 3.
const ASKS_FOR_POWER: u32 = 1 << 11;
/// DIER of TIM5: the interrupts that are always enabled.
pub(super) const CALLS: u32 = Due::MORE.0 | Due::MARK.0 | Due::CALLED.0;
/// RCC: offset of the reset register of APB2, and the bit of TIM1 in it.
const APB2RSTR: usize = 0x24;
const TIM1_RESET: u32 = 1;

/// Memory that DMA reads; it must stay at its address.
#[repr(C, align(4))]
pub struct Rings<const P: usize> {
    /// The words of the events, for each port.
    words: [[u32; RING]; P],
    /// The times of the events.
    moments: [u32; RING],
    /// For each port: the word that ends all pulses.
    off: [u32; P],
    /// The next compare value of the PWM.
    power: u32,
}

impl<const P: usize> Rings<P> {
    /// Empty.
    pub const EMPTY: Self = Rings { words: [[0; RING]; P], moments: [0; RING], off: [0; P], power: 0 };
}

/// Step output by timers and DMA on `P` ports.
pub(super) struct Chain<M, const P: usize> {
    rings: &'static mut Rings<P>,
    ports: [usize; P],
    /// Slot of the next event to be committed.
    head: usize,
    /// Length of a pulse in ticks of TIM1.
    pulse: u32,
    /// Output has started.
    begun: bool,
    /// Each event is output by an interrupt of its own.
    one_by_one: bool,
    /// With `one_by_one`: an event has been committed and is not output yet.
    pending: bool,
    /// Number of event times that DMA1 has counted when the first is in CCR1: 1, or 2 if it counts a word when fetching
    /// it. The manual leaves this open (DMA_SxNDTR), so each `begin` measures it.
    first_moments: usize,
    map: PhantomData<M>,
}

/// Stops TIM1 and the DMA streams: after this no pulse begins, and DMA writes no edge and no power. For a program that
/// ends: step counts are lost.
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
    /// Slots that stay free: the one after the last event, and with several ports one more, of which only the first
    /// port's word may have been output.
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

    /// Sets the word of each port that ends all pulses. Call at rest.
    pub(super) fn set_off(&mut self, off: [u32; P]) {
        self.rings.off = off;
    }

    /// Sets the length of a pulse in ticks of TIM1. Call at rest.
    pub(super) fn set_pulse(&mut self, ticks: u32) {
        self.pulse = ticks;
    }

    /// Returns the reasons for the call of the step task and clears them.
    #[inline(always)]
    pub(super) fn take(&mut self) -> Due {
        let mut due = Due(read(M::TIM5 + SR));
        if !self.one_by_one {
            // Queued events raise this flag, too, and DMA1 may be about to serve its request: leave it alone.
            due = Due(due.0 & !Due::OUT.0);
        }
        if due.has(Due::MARK) {
            // Likewise, let the request for power be served before the flag is cleared.
            self.keep_power();
        }
        // Flags are cleared by writing 0; a 1 leaves them alone.
        write(M::TIM5 + SR, !due.0);
        if due.has(Due::OUT) {
            self.pending = false;
        }
        due
    }

    /// Schedules the call `MORE`. A pending one is cancelled, even if its time has come meanwhile.
    #[inline(always)]
    pub(super) fn call_at(&mut self, moment: u32) {
        write(M::TIM5 + CCR2, moment);
        write(M::TIM5 + SR, !Due::MORE.0);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 {
            write(M::TIM5 + EGR, Due::MORE.0);
        }
    }

    /// Schedules the call `MARK`; with `power`, the same compare event makes DMA1 write the power.
    ///
    /// Each mark must raise exactly one event and thus one request. The flag is therefore cleared while no event can
    /// occur. If `moment` passed before it was set, so that the flag stays clear, software generates the event, which
    /// raises the same request.
    pub(super) fn mark_at(&mut self, moment: u32, power: Option<u32>) {
        self.keep_power();
        write(M::TIM5 + CCR3, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::MARK.0);
        if let Some(power) = power {
            self.rings.power = power;
            // The write must precede the next line: the stream fetches the word when it is switched on.
            compiler_fence(Ordering::SeqCst);
            let how = CIRCULAR | WORDS | BEAM_CHANNEL | TO_PERIPHERAL;
            switch_on(M::DMA1, BEAM, M::TIM3 + CCR2, &raw const self.rings.power as usize, RING, how);
            write(M::TIM5 + DIER, read(M::TIM5 + DIER) | ASKS_FOR_POWER);
        }
        write(M::TIM5 + CCR3, moment);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 && read(M::TIM5 + SR) & Due::MARK.0 == 0 {
            write(M::TIM5 + EGR, Due::MARK.0);
            // `await_served` cannot derive the time of this request from CCR3, so wait here.
            cortex_m::asm::delay(SERVED_CYCLES);
        }
    }

    /// Disarms the power stream: DMA writes no power after this. A request that is imminent is served first: a request
    /// that was withdrawn half-way, or that no stream serves, would stay pending and trigger the next power too early.
    #[inline(never)]
    pub(super) fn keep_power(&mut self) {
        let asks = read(M::TIM5 + DIER);
        if asks & ASKS_FOR_POWER != 0 {
            self.await_served(CCR3);
            write(M::TIM5 + DIER, asks & !ASKS_FOR_POWER);
            write(stream(M::DMA1, BEAM) + CR, 0);
        }
    }

    /// Returns the slot of the next event to be output.
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

    /// Returns the free slots for times and for words of the last port. With several ports the words hold steps until
    /// [`Chain::translate`].
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

    /// For several ports: replaces the steps in the next `events` slots by the words of each port.
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
        // The ring must be written before DMA reads it.
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

    /// With `one_by_one`: schedules the event that has just been committed. Returns the ticks by which it was late and
    /// has been delayed.
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

    /// DMA1 fetches the time of an event when the event two before it is output: an event must be committed before
    /// then, also if output has not started yet.
    #[inline(always)]
    pub(super) fn joins_until(&self, next: u32) -> u32 {
        let is_alone = self.one_by_one || !self.begun && self.head < 2;
        if is_alone { next } else { self.moment_before(1) }
    }

    /// Disables the request for event times, and sets CCR1 so that none arises before the next time is loaded.
    fn expect_no_moment(&mut self) {
        write(M::TIM5 + DIER, CALLS);
        write(M::TIM5 + CCR1, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::OUT.0);
        compiler_fence(Ordering::SeqCst);
    }

    /// Waits until no request of a compare channel is under way or imminent. Scheduled times are further apart than
    /// this takes.
    fn await_served(&self, channel: usize) {
        let moment = read(M::TIM5 + channel);
        // One iteration takes at least a tick.
        for _ in 0..3 * NEAR_TICKS {
            if (read(M::TIM5 + CNT).wrapping_sub(moment).wrapping_add(NEAR_TICKS)) >= 2 * NEAR_TICKS {
                return;
            }
        }
    }

    /// Starts the output of the committed events. Returns the ticks by which all of them were delayed because it was
    /// too late for the first.
    pub(super) fn begin(&mut self, one_by_one: bool) -> u32 {
        self.begun = true;
        self.one_by_one = one_by_one;
        self.pending = one_by_one;
        // Clears pending requests of TIM1.
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
            // Software requests the first time; DMA loads it like all others. TIM1 is not listening yet.
            write(M::TIM5 + DIER, CALLS | ASKS_FOR_MOMENT);
            write(M::TIM5 + EGR, Due::OUT.0);
            cortex_m::asm::delay(SERVED_CYCLES);
            // Valid only before the time of the first event; if it has passed, the loop repeats.
            let counted = self.moments_counted();
            let is_fetched_ahead = counted == 2 && read(M::TIM5 + CCR1) == self.moment_at(0);
            self.first_moments = if is_fetched_ahead { 2 } else { 1 };
            write(M::TIM1 + DIER, requests);
            let left = self.moment_at(0).wrapping_sub(read(M::TIM5 + CNT));
            if left as i32 > LISTENS_TICKS as i32 {
                write(M::TIM1 + SMCR, STARTS);
                return put_off;
            }
            // The time of the first event has passed, or would pass before TIM1 listens. No event has been output:
            // delay all of them and try again.
            self.await_served(CCR1);
            write(stream(M::DMA1, MOMENTS) + CR, 0);
            self.expect_no_moment();
            let by = again.wrapping_sub(left);
            // Each attempt allows more time, so that the loop ends.
            again = again.wrapping_add(AGAIN_TICKS);
            for moment in &mut self.rings.moments {
                *moment = moment.wrapping_add(by);
            }
            put_off = put_off.wrapping_add(by);
        }
    }

    /// Returns whether the counters of events disagree or have failed. Counts that differ while an event is output
    /// agree right after it.
    #[inline(always)]
    pub(super) fn fault(&self) -> bool {
        if !self.begun {
            return false;
        }
        if self.one_by_one {
            // TIM1 missed a trigger: the words of an event that counts as output are still in the ring.
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

    /// Returns whether DMA2 has not output the word of every committed event.
    #[inline(always)]
    fn lags(&self) -> bool {
        self.tail() != self.head
    }

    /// Returns whether the output is stuck: the time of the next event has passed long ago.
    #[inline(always)]
    fn stands(&self) -> bool {
        let tail = self.tail();
        let since = read(M::TIM5 + CNT).wrapping_sub(self.moment_at(tail)) as i32;
        since > STANDS_TICKS && tail != self.head && tail == self.tail()
    }

    /// Returns whether repeated comparisons all differ. An event that is output during a comparison affects that one
    /// and at most the next; counts that differ permanently never agree.
    #[cold]
    #[inline(never)]
    fn still_disagree(&self) -> bool {
        (0..MORE_LOOKS).all(|_| !self.counts_agree())
    }

    /// Returns the number of event times that DMA1 has counted, modulo the ring.
    #[inline(always)]
    fn moments_counted(&self) -> usize {
        RING.wrapping_sub(read(stream(M::DMA1, MOMENTS) + NDTR) as usize) % RING
    }

    /// Returns whether the counts are those of a pause between two events: DMA1 is `first_moments` times ahead of the
    /// edges, all ports have the same number of edges, and at most one end of a pulse is outstanding.
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

    /// Call after [`Chain::silence`], with its `tail`. Calls `each` with the words of each event that was not output,
    /// and returns the number of these events.
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

    /// Ends the output, and with `dark` the power. Returns the slot of the first event that was not output, and whether
    /// the counts disagree.
    #[inline(always)]
    pub(super) fn silence(&mut self, dark: bool) -> (usize, bool) {
        if !self.begun {
            return (0, false);
        }
        write(M::TIM1 + SMCR, IGNORED);
        // Let requests raised just before be served: a request of TIM5 that is withdrawn half-way would stay pending.
        // The request for event times comes first, since more than one would arise while a change of power is awaited.
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
            // DMA1 is as far ahead of the events as at `begin`, or one more if the next match came after TIM1 had
            // stopped listening.
            let more = self.moments_counted().wrapping_sub(tail).wrapping_sub(self.first_moments) % RING;
            fault |= more > 1 || read(M::DMA1 + LISR) & MOMENT_ERRORS != 0;
        }
        write(stream(M::DMA1, MOMENTS) + CR, 0);
        (tail, fault)
    }
}
