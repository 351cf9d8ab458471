//! Hardware-timed step output: timers and DMA write each event to the GPIO ports at its time, without the CPU. The step
//! task fills a ring of events; TIM5 keeps the time, DMA1 loads the time of the next event, TIM1 times the pulse, and
//! DMA2 writes the words to the ports.
//!
//! ```text
//!  TIM5 (32 bits, runs freely)             TIM1 (one pulse, started by TIM5)
//!   CC1 ─┬─TRGO─┬────────────────────────▶ CC1, CC3 ─▶ DMA2 ─▶ BSRR   step on, directions
//!        │      │                          CC2, CC4 ─▶ DMA2 ─▶ BSRR   step off, $0 later
//!        │      │                          TIM8 (the same, only for ports that have directions and no steps)
//!        │      └────────────────────────▶ CC2, CC4 ─▶ DMA2 ─▶ BSRR   directions
//!        └─▶ DMA1 S2 ─▶ TIM5_CCR1: the time of the next event
//!   CC2, CC3: calls at a set time   CC4: calls by software
//!        CC3 ─▶ DMA1 S0 ─▶ TIM3_CCRx: the laser's power, at the step that begins its segment
//! ```
//! Each port has its own compare channels, and a stream of DMA2 for each channel (`streams`):
//!
//! ```text
//!                                         step on, directions    step off
//!  the only port with steps               TIM1 CC1, S1           TIM1 CC4, S4
//!  the first of two ports with steps      TIM1 CC1, S1           TIM1 CC2, S2
//!  the second of two ports with steps     TIM1 CC3, S6           TIM1 CC4, S4
//!  the first port with directions alone   TIM8 CC4, S7
//!  the second port with directions alone  TIM8 CC2, S3
//! ```
//! In some images TIM8 makes the pulses in place of TIM1 ([`Map::TIM8_MAKES_PULSES`]). Then TIM1 can make the PWM of a
//! spindle on pin A8, and there are no ports with directions alone:
//!
//! ```text
//!                                         step on, directions    step off
//!  the first port with steps              TIM8 CC1, S2           TIM8 CC2, S3
//!  the second port with steps             TIM8 CC3, S4           TIM8 CC4, S7
//! ```
//! Event times are absolute, so errors do not accumulate. The ring entry after the last committed event holds a time
//! one tick before that event. When DMA1 loads this time, it has just passed, so TIM5 reaches it again only after
//! almost 2^32 ticks. The output therefore stops by itself if the program commits no more events, for whatever reason.
//!
//! A port with directions alone (no steps) has no pulse to end, so one stream is enough for it. TIM8 triggers this
//! stream, because all streams that serve TIM1 are in use. TIM8 triggers it `DIRECTION_LEAD` ticks before TIM1
//! triggers the streams of the ports with steps. So DMA2 is free again when a pulse begins or ends.
//!
//! While the program watches a probe, it outputs the events one by one and must not queue them. For each event, the
//! CPU (in place of DMA1) writes the time to CCR1, and CC1 interrupts after the event. Everything else works as for
//! queued events.
//!
//! Hardware constraints, all checked by the models of `tests/virtual_board`:
//!
//! * ES0287 2.2.11 (F411): DMA2 must write GPIO through its memory port and must not serve APB2 meanwhile. The rings
//!   are therefore configured as an incrementing "peripheral".
//! * DMA1 fetches one word ahead, so the time of event n must be in the ring before event n - 2 is output.
//! * TIM1 and TIM8 must be clocked while the processor sleeps, or they ignore their trigger; `step_pins` enables these
//!   clocks for sleep.
//! * TIM1 and TIM8 ignore a trigger while they count. DMA2 then lags behind TIM5 by one event. The counts of the
//!   streams show this.
//! * A stream that is switched on serves a request left from earlier output. So `begin` first resets TIM1 and TIM8,
//!   which clears such requests.
//! * A stream to a peripheral fetches its word when it is enabled, not at the request. So the laser's stream is
//!   enabled again for each power, and only one change of power can be scheduled at a time. A power takes effect as
//!   soon as DMA writes it to TIM3.
//! * DMA1 cannot reach TIM1. If TIM1 makes the PWM, the step task writes each power when it is called for that power.
//!   So a power can be late by a run of the step task.
//!
//! This module was tested only in emulation, not yet on hardware.

use super::dma::{
    self, CIRCULAR, CR, HISR, LISR, MEMORY_COUNTS, NDTR, PERIPHERAL_COUNTS, SERVED_CYCLES, TO_PERIPHERAL, VERY_HIGH,
    WORDS, stream, switch_on,
};
use super::registers::{Map, bsrr_of, read, timer::*, write};
use super::step::Pwm;
use crate::contract::{COMBINATIONS, Due, Free};
use core::marker::PhantomData;
use core::sync::atomic::{Ordering, compiler_fence};

/// Number of slots of the ring. The slot after the last event holds no event. It holds the time that stops the output.
const RING: usize = 128;
/// Maximum number of committed events that have not been output ([`crate::StepOutput::DEPTH`]). The number is limited,
/// because a stop counts all cancelled events. To count this many takes less time than two bytes on the UART.
pub(super) const DEPTH: usize = 96;
/// Number of ticks from the start of a timer to its first edge. Without ports that have directions alone, this edge is
/// the leading edge of the pulse. With such ports, TIM8 outputs their directions at this edge, and the leading edge of
/// the pulse comes [`DIRECTION_LEAD`] ticks later.
const EDGE_COUNT: u32 = 1;
/// DMA2 writes to ports with directions alone this many ticks before it writes to ports with steps. The lead covers
/// the time that DMA2 needs: about 12 cycles for the first port with directions alone, and 8 for the second.
const DIRECTION_LEAD: u32 = 20;
/// When `begin` enables the trigger of TIM1, more than this many ticks must be left before the first event.
const LISTENS_TICKS: u32 = 48;
/// If too little time is left before the first event, `begin` delays all events so that this many ticks are left, and
/// tries again. One attempt takes at most this long.
const AGAIN_TICKS: u32 = 2_200;
/// The DMA request of a scheduled time may be imminent or in progress from this many ticks before that time until this
/// many ticks after it. Even at the maximum step rate, events are about 90 ticks apart.
const NEAR_TICKS: u32 = 48;
/// If an event is late by more than this many ticks, the output counts as stuck.
const STANDS_TICKS: i32 = 500;
/// If the event counts of the DMA streams differ, they are compared this many more times. The output has failed only
/// if they differ each time.
const MORE_LOOKS: u32 = 8;

/// Error flags of streams 0 to 3 in LISR. In HISR, the same bits are those of streams 4 to 7.
const ERRORS: u32 = dma::errors(&[0, 1, 2, 3]);
const MOMENT_ERRORS: u32 = dma::errors(&[MOMENTS]);

/// Stream of DMA1 that loads the event times, and its channel.
const MOMENTS: usize = 2;
const MOMENTS_CHANNEL: u32 = 6 << 25;
/// Stream of DMA1 that writes the laser's power, and its channel. Its priority is lower than that of [`MOMENTS`].
const BEAM: usize = 0;
const BEAM_CHANNEL: u32 = 6 << 25;

/// An advanced timer, TIM1 or TIM8, that TIM5 starts.
struct Slave {
    /// Address of its registers.
    base: usize,
    /// SMCR: TIM5 is selected as the trigger, but triggers have no effect (SMS = 000).
    ignored: u32,
    /// Its bit in the reset register of APB2.
    reset: u32,
    /// Channel of its compare events on DMA2.
    channel: u32,
}

impl Slave {
    /// Returns TIM1, started by its trigger input ITR0 (TS = 000). ITR0 is TIM5 in the table "TIMx internal trigger
    /// connection" of TIM1_SMCR: RM0368 (F401; table 50), RM0383 (F411), RM0390 (F446), RM0090 (F407; table 94),
    /// RM0402 (F412). All five have the same row for TIM1: TIM5, TIM2, TIM3, TIM4. Source: drivers that cite these
    /// tables, as the manuals themselves were not available; not yet confirmed on hardware.
    const fn tim1<M: Map>() -> Slave {
        Slave { base: M::TIM1, ignored: 0, reset: 1, channel: 6 << 25 }
    }

    /// Returns TIM8, started by its trigger input ITR3 (TS = 011), which is TIM5 in the same tables.
    const fn tim8<M: Map>() -> Slave {
        Slave { base: M::TIM8, ignored: 0b011 << 4, reset: 1 << 1, channel: 7 << 25 }
    }

    /// Returns the timer of the step pulses.
    const fn of_pulses<M: Map>() -> Slave {
        if M::TIM8_MAKES_PULSES { Slave::tim8::<M>() } else { Slave::tim1::<M>() }
    }

    #[inline(always)]
    fn ignore_trigger(&self) {
        write(self.base + SMCR, self.ignored);
    }

    /// Makes the timer start at its trigger (SMS = 110).
    #[inline(always)]
    fn obey_trigger(&self) {
        write(self.base + SMCR, self.ignored | 0b110);
    }
}

/// Streams of DMA2 for a port, and the DMA request bits of the compare channels that trigger them.
struct Streams {
    /// Number of the stream that writes steps and directions when a pulse begins.
    on: usize,
    /// Number of the stream that ends the pulse; `None` for a port with directions alone.
    off: Option<usize>,
    /// Bits of DIER that enable the DMA requests of these streams: in the timer of the step pulses or, if the port has
    /// only direction pins, in TIM8.
    requests: u32,
}

/// Returns the streams of the port with the index `port`. The ports below `step_ports` have steps, the others
/// directions alone (reference manuals, "DMA2 request mapping"). Stream 5 stays free: it receives from `USART1` while
/// flash is written.
const fn streams<M: Map>(port: usize, step_ports: usize) -> Streams {
    match (port, step_ports) {
        (0, _) if M::TIM8_MAKES_PULSES => Streams { on: 2, off: Some(3), requests: 1 << 9 | 1 << 10 },
        (1, 2) if M::TIM8_MAKES_PULSES => Streams { on: 4, off: Some(7), requests: 1 << 11 | 1 << 12 },
        (0, 1) => Streams { on: 1, off: Some(4), requests: 1 << 9 | 1 << 12 },
        (0, _) => Streams { on: 1, off: Some(2), requests: 1 << 9 | 1 << 10 },
        (1, 2) => Streams { on: 6, off: Some(4), requests: 1 << 11 | 1 << 12 },
        // The first and the second port with directions alone.
        _ if port == step_ports => Streams { on: 7, off: None, requests: 1 << 12 },
        _ => Streams { on: 3, off: None, requests: 1 << 10 },
    }
}

/// CR1 of TIM1 and TIM8: one-pulse mode.
const ONE_PULSE: u32 = 1 << 3;
/// CR2 of TIM5: the compare event of channel 1 is the trigger output (MMS = 011).
#[cfg(feature = "stm32f4")]
pub(super) const COMPARE_PULSE: u32 = 0b011 << 4;
/// DIER of TIM5: DMA request of channel 1, for the next event time.
const ASKS_FOR_MOMENT: u32 = 1 << 9;
/// DIER of TIM5: DMA request of channel 3, for the laser's power.
const ASKS_FOR_POWER: u32 = 1 << 11;
/// DIER of TIM5: the interrupts that are always enabled.
pub(super) const CALLS: u32 = Due::MORE.0 | Due::MARK.0 | Due::CALLED.0;
/// RCC: offset of the reset register of APB2.
const APB2RSTR: usize = 0x24;

/// Memory that DMA reads. It must not move while DMA is on.
#[repr(C, align(4))]
pub struct Rings<const P: usize> {
    /// For each port, the BSRR words of the events.
    words: [[u32; RING]; P],
    /// The times of the events.
    moments: [u32; RING],
    /// For each port, the BSRR word that ends all of its pulses.
    off: [u32; P],
    /// The compare value that DMA1 writes to the PWM's timer at the time set by [`Chain::mark_at`].
    power: u32,
}

impl<const P: usize> Rings<P> {
    /// Initial contents: no events, power 0.
    pub const EMPTY: Self = Rings { words: [[0; RING]; P], moments: [0; RING], off: [0; P], power: 0 };
}

/// Step output by timers and DMA on `P` ports. The first `S` of them have steps, the others have directions alone.
pub(super) struct Chain<M, const S: usize, const P: usize> {
    rings: &'static mut Rings<P>,
    ports: [usize; P],
    /// Slot of the next event to be committed.
    head: usize,
    /// Length of a pulse in ticks of its timer.
    pulse: u32,
    /// Where the power is written.
    pwm: Pwm,
    /// The power that the step task writes at the time set by [`Chain::mark_at`], if DMA1 cannot write it.
    waiting: Option<u32>,
    /// The output has been started by [`Chain::begin`], and not been ended since.
    begun: bool,
    /// Each event is output by an interrupt of its own.
    one_by_one: bool,
    /// With `one_by_one`: an event has been committed and is not output yet.
    pending: bool,
    /// Number of event times that DMA1 has counted when CCR1 holds the first one. The number is 1 if DMA1 counts a
    /// word when it writes the word, and 2 if DMA1 counts a word when it fetches the word. The manual leaves this open
    /// (DMA_SxNDTR), so each `begin` measures it.
    first_moments: usize,
    map: PhantomData<M>,
}

/// Stops TIM1, TIM8 and the DMA streams: after this no pulse begins, and DMA writes no edge and no power. Only for a
/// program that is about to end, because step counts are lost.
#[cfg(feature = "stm32f4")]
#[inline(never)]
pub(super) fn cut<M: Map, const S: usize, const P: usize>() {
    let pulses = const { Slave::of_pulses::<M>() };
    pulses.ignore_trigger();
    write(pulses.base + CR1, 0);
    if P > S {
        let directions = const { Slave::tim8::<M>() };
        directions.ignore_trigger();
        write(directions.base + CR1, 0);
    }
    let of_ports = (0..P).flat_map(|port| {
        let Streams { on, off, .. } = streams::<M>(port, S);
        [Some(on), off].into_iter().flatten().map(|number| stream(M::DMA2, number))
    });
    let streams = core::iter::once(stream(M::DMA1, BEAM)).chain(of_ports);
    for stream in streams.clone() {
        write(stream + CR, 0);
    }
    streams.for_each(dma::await_off);
}

impl<M: Map, const S: usize, const P: usize> Chain<M, S, P> {
    /// Number of slots of the ring that stay free. One is the slot after the last event. With several ports, the slot
    /// before the tail stays free, too. The tail is the next slot that the first port outputs. The other ports may
    /// still have to output their words in the slot before it.
    const SPARE: usize = if P > 1 { 2 } else { 1 };
    /// The timer of the step pulses.
    const PULSES: Slave = Slave::of_pulses::<M>();
    /// The timer of the ports with directions alone, if there are such ports.
    const DIRECTIONS: Slave = {
        assert!(P == S || !M::TIM8_MAKES_PULSES, "TIM8 cannot serve both the pulses and ports with directions alone");
        Slave::tim8::<M>()
    };

    pub(super) const fn new(ports: [usize; P], pwm: Pwm, rings: &'static mut Rings<P>) -> Self {
        Chain {
            rings,
            ports,
            head: 0,
            pulse: 1,
            pwm,
            waiting: None,
            begun: false,
            one_by_one: false,
            pending: false,
            first_moments: 1,
            map: PhantomData,
        }
    }

    /// Sets, for each port, the BSRR word that ends all pulses. Call at rest.
    pub(super) fn set_off(&mut self, off: [u32; P]) {
        self.rings.off = off;
    }

    /// Sets the length of a pulse in ticks of its timer. Call at rest.
    pub(super) fn set_pulse(&mut self, ticks: u32) {
        self.pulse = ticks;
    }

    /// Returns the reasons for the call of the step task and clears them.
    #[inline(always)]
    pub(super) fn take(&mut self) -> Due {
        let mut due = Due(read(M::TIM5 + SR));
        if !self.one_by_one {
            // Queued events also set the flag `OUT`, but do not call the task. The flag must not be cleared here,
            // because DMA1 may be about to serve the request that the same event has raised.
            due = Due(due.0 & !Due::OUT.0);
        }
        if due.has(Due::MARK) {
            // The event that sets the flag `MARK` also raises the DMA request for a power. This request must be served
            // before the flag is cleared.
            self.keep_power();
        }
        // Writing 0 clears a flag, writing 1 leaves it unchanged.
        write(M::TIM5 + SR, !due.0);
        if due.has(Due::OUT) {
            self.pending = false;
        }
        due
    }

    /// Calls the step task with [`Due::MORE`] at `moment`. Replaces an earlier call of this kind, even if its time has
    /// come meanwhile.
    #[inline(always)]
    pub(super) fn call_at(&mut self, moment: u32) {
        write(M::TIM5 + CCR2, moment);
        write(M::TIM5 + SR, !Due::MORE.0);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 {
            write(M::TIM5 + EGR, Due::MORE.0);
        }
    }

    /// Calls the step task with [`Due::MARK`] at `moment`; with `power`, the same compare event makes DMA1 write the
    /// power. If DMA1 does not reach the PWM's timer, [`Chain::take`] writes the power.
    ///
    /// Each use of this function must raise exactly one compare event, and so exactly one DMA request. The flag is
    /// therefore cleared while CCR3 holds a time that has just passed, at which no compare event can occur. If `moment`
    /// passes before it is in CCR3, the flag stays clear. Software then generates the compare event, which raises the
    /// same request.
    pub(super) fn mark_at(&mut self, moment: u32, power: Option<u32>) {
        self.keep_power();
        write(M::TIM5 + CCR3, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::MARK.0);
        if !self.pwm.is_in_reach {
            self.waiting = power;
        } else if let Some(power) = power {
            self.rings.power = power;
            // `power` must be in memory before `switch_on`, because the stream fetches it as soon as it is on.
            compiler_fence(Ordering::SeqCst);
            let how = CIRCULAR | WORDS | BEAM_CHANNEL | TO_PERIPHERAL;
            switch_on(M::DMA1, BEAM, self.pwm.compare, &raw const self.rings.power as usize, RING, how);
            write(M::TIM5 + DIER, read(M::TIM5 + DIER) | ASKS_FOR_POWER);
        }
        write(M::TIM5 + CCR3, moment);
        if read(M::TIM5 + CNT).wrapping_sub(moment) as i32 >= 0 && read(M::TIM5 + SR) & Due::MARK.0 == 0 {
            write(M::TIM5 + EGR, Due::MARK.0);
            // `await_served` cannot derive the time of this request from CCR3, so wait here.
            cortex_m::asm::delay(SERVED_CYCLES);
        }
        if self.waiting.is_some() && read(M::TIM5 + SR) & Due::MARK.0 != 0 {
            // `moment` has passed: write the power now, not at the next call.
            self.keep_power();
        }
    }

    /// Cancels the change of power that [`Chain::mark_at`] has scheduled, even if its time has come.
    pub(super) fn drop_power(&mut self) {
        self.waiting = None;
        self.keep_power();
    }

    /// Ends the change of power that [`Chain::mark_at`] has scheduled. If its time has come, the power is written;
    /// otherwise the change is cancelled. First waits until an imminent DMA request has been served. A request that is
    /// disabled half-way, or whose stream is off, would stay pending and output the next power too early.
    #[inline(never)]
    pub(super) fn keep_power(&mut self) {
        if let Some(power) = self.waiting.take()
            && read(M::TIM5 + SR) & Due::MARK.0 != 0
        {
            write(self.pwm.compare, power);
        }
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
        self.output_by(0)
    }

    /// Returns the slot of the next event that a port will output.
    #[inline(always)]
    fn output_by(&self, port: usize) -> usize {
        RING.wrapping_sub(read(stream(M::DMA2, streams::<M>(port, S).on) + NDTR) as usize) % RING
    }

    #[inline(always)]
    pub(super) fn ahead(&self) -> usize {
        match (self.begun, self.one_by_one) {
            (false, _) => self.head,
            (true, true) => usize::from(self.pending),
            (true, false) => self.head.wrapping_sub(self.tail()) % RING,
        }
    }

    /// Returns the free slots for the next events: for their times, and for their words at the last port. With several
    /// ports, the caller writes the combination of steps of each event in place of its word, and [`Chain::translate`]
    /// replaces it by the words of all ports.
    #[inline(always)]
    pub(super) fn free<'a>(&'a mut self, table: &'a [u32; COMBINATIONS]) -> Free<'a> {
        let room = if self.one_by_one {
            1 - usize::from(self.pending)
        } else {
            // `max`: at least one slot, so that a first event can be generated even if `DEPTH` is 1.
            (DEPTH.max(Self::SPARE) + 1 - Self::SPARE).saturating_sub(self.ahead())
        };
        let end = (self.head + room).min(RING);
        let words = self.rings.words.last_mut().and_then(|words| words.get_mut(self.head..end)).unwrap_or_default();
        let moments = self.rings.moments.get_mut(self.head..end).unwrap_or_default();
        Free { table, words, moments }
    }

    /// For several ports: writes the words of each port into the next `events` slots, in place of the combinations of
    /// steps.
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

    /// With `one_by_one`: schedules the event that has just been committed. Returns the ticks by which the event had to
    /// be delayed, because it was late; otherwise 0.
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

    /// Returns the deadline for the commit of an event that is due at `next`. DMA1 fetches the time of event n when
    /// event n - 2 is output, so event n must be committed before event n - 2 is due. This also applies before the
    /// output has started.
    #[inline(always)]
    pub(super) fn joins_until(&self, next: u32) -> u32 {
        let is_alone = self.one_by_one || !self.begun && self.head < 2;
        if is_alone { next } else { self.moment_before(1) }
    }

    /// Disables the DMA request for event times, and sets CCR1 to a time that has just passed, so that CC1 raises no
    /// compare event before the next time is loaded.
    fn expect_no_moment(&mut self) {
        write(M::TIM5 + DIER, CALLS);
        write(M::TIM5 + CCR1, read(M::TIM5 + CNT).wrapping_sub(1));
        write(M::TIM5 + SR, !Due::OUT.0);
        compiler_fence(Ordering::SeqCst);
    }

    /// Waits until no DMA request of a compare channel is in progress or about to come. `channel`: offset of the
    /// compare register. The wait is shorter than the time between two scheduled times of a channel.
    fn await_served(&self, channel: usize) {
        let moment = read(M::TIM5 + channel);
        // Each iteration takes at least a tick, so this number of iterations is enough.
        for _ in 0..3 * NEAR_TICKS {
            if (read(M::TIM5 + CNT).wrapping_sub(moment).wrapping_add(NEAR_TICKS)) >= 2 * NEAR_TICKS {
                return;
            }
        }
    }

    /// Starts the output of the committed events. Returns the ticks by which all of these events were delayed, if it
    /// was too late for the first one; otherwise 0.
    pub(super) fn begin(&mut self, one_by_one: bool) -> u32 {
        self.begun = true;
        self.one_by_one = one_by_one;
        self.pending = one_by_one;
        // A reset clears the pending DMA requests of the timers.
        write(M::RCC + APB2RSTR, Self::PULSES.reset | if P > S { Self::DIRECTIONS.reset } else { 0 });
        write(M::RCC + APB2RSTR, 0);
        let edge = if P > S { EDGE_COUNT + DIRECTION_LEAD } else { EDGE_COUNT };
        let off = edge + self.pulse;
        for (register, value) in [(CCR1, edge), (CCR3, edge), (CCR2, off), (CCR4, off), (ARR, off + 1)] {
            write(Self::PULSES.base + register, value);
        }
        write(Self::PULSES.base + CR1, ONE_PULSE);
        if P > S {
            for (register, value) in [(CCR2, EDGE_COUNT), (CCR4, EDGE_COUNT), (ARR, EDGE_COUNT + 1)] {
                write(Self::DIRECTIONS.base + register, value);
            }
            write(Self::DIRECTIONS.base + CR1, ONE_PULSE);
        }
        self.ignore_triggers();
        self.expect_no_moment();
        let mut requests = (0, 0);
        for port in 0..P {
            let Streams { on, off, requests: own } = streams::<M>(port, S);
            let (Some(words), Some(low)) = (self.rings.words.get(port), self.rings.off.get(port)) else { return 0 };
            let pins = self.ports.get(port).copied().map_or(0, bsrr_of::<M>);
            let timer = if port < S { Self::PULSES } else { Self::DIRECTIONS };
            let common = CIRCULAR | WORDS | VERY_HIGH | timer.channel;
            switch_on(M::DMA2, on, words.as_ptr() as usize, pins, RING, common | PERIPHERAL_COUNTS);
            if let Some(off) = off {
                switch_on(M::DMA2, off, core::ptr::from_ref(low) as usize, pins, RING, common);
            }
            *if port < S { &mut requests.0 } else { &mut requests.1 } |= own;
        }
        if one_by_one {
            self.enable_requests(requests);
            self.obey_triggers();
            write(M::TIM5 + DIER, CALLS | Due::OUT.0);
            return self.set_moment(self.moment_at(0));
        }
        let how = CIRCULAR | WORDS | VERY_HIGH | MOMENTS_CHANNEL | TO_PERIPHERAL | MEMORY_COUNTS;
        let (mut put_off, mut again) = (0_u32, AGAIN_TICKS);
        loop {
            switch_on(M::DMA1, MOMENTS, M::TIM5 + CCR1, self.rings.moments.as_ptr() as usize, RING, how);
            cortex_m::asm::delay(SERVED_CYCLES);
            // Generate a compare event by software: DMA1 then loads the time of the first event. No pulse starts,
            // because TIM1 still ignores its trigger.
            write(M::TIM5 + DIER, CALLS | ASKS_FOR_MOMENT);
            write(M::TIM5 + EGR, Due::OUT.0);
            cortex_m::asm::delay(SERVED_CYCLES);
            // The count is valid only if the time of the first event has not come yet. Otherwise the loop counts again.
            let counted = self.moments_counted();
            let is_fetched_ahead = counted == 2 && read(M::TIM5 + CCR1) == self.moment_at(0);
            self.first_moments = if is_fetched_ahead { 2 } else { 1 };
            self.enable_requests(requests);
            let left = self.moment_at(0).wrapping_sub(read(M::TIM5 + CNT));
            if left as i32 > LISTENS_TICKS as i32 {
                self.obey_triggers();
                return put_off;
            }
            // It is too late for the first event: its time has passed, or would pass before the trigger of TIM1 is
            // enabled. No event has been output yet, so delay all events and try again.
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

    /// Makes the timers of pulses and of directions ignore their trigger. The timer of the pulses comes first. If an
    /// event occurs between the two stores, its directions are output, but its steps are not. With the other order,
    /// its steps could be output without its directions, which would be wrong.
    #[inline(always)]
    fn ignore_triggers(&self) {
        Self::PULSES.ignore_trigger();
        if P > S {
            Self::DIRECTIONS.ignore_trigger();
        }
    }

    /// Makes the timers of pulses and of directions start at their trigger.
    fn obey_triggers(&self) {
        if P > S {
            Self::DIRECTIONS.obey_trigger();
        }
        Self::PULSES.obey_trigger();
    }

    /// Enables DMA requests. `pulse`: bits of DIER for the timer of the pulses. `directions`: bits of DIER for the
    /// timer of the ports with directions alone.
    fn enable_requests(&self, (pulse, directions): (u32, u32)) {
        write(Self::PULSES.base + DIER, pulse);
        if P > S {
            write(Self::DIRECTIONS.base + DIER, directions);
        }
    }

    /// Returns true if the output has failed: the event counters disagree, a stream reports an error, or the output is
    /// stuck. While an event is being output, the counters differ for a short time, which is no failure.
    #[inline(always)]
    pub(super) fn fault(&self) -> bool {
        if !self.begun {
            return false;
        }
        if self.one_by_one {
            // If TIM1 has missed a trigger, DMA2 has not written the words of an event although TIM5 has reported that
            // event as output.
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

    /// Returns whether DMA2 still has to output the word of a committed event, at any port.
    #[inline(always)]
    fn lags(&self) -> bool {
        (0..P).any(|port| self.output_by(port) != self.head)
    }

    /// Returns whether the output is stuck: the time of the next event has passed long ago.
    #[inline(always)]
    fn stands(&self) -> bool {
        let tail = self.tail();
        let since = read(M::TIM5 + CNT).wrapping_sub(self.moment_at(tail)) as i32;
        since > STANDS_TICKS && tail != self.head && tail == self.tail()
    }

    /// Returns true if the counts differ in each of [`MORE_LOOKS`] comparisons. The output of an event makes them
    /// differ in at most two comparisons in a row. After a fault they never agree again.
    #[cold]
    #[inline(never)]
    fn still_disagree(&self) -> bool {
        (0..MORE_LOOKS).all(|_| !self.counts_agree())
    }

    /// Returns the number of event times that DMA1 has counted, modulo the size of the ring.
    #[inline(always)]
    fn moments_counted(&self) -> usize {
        RING.wrapping_sub(read(stream(M::DMA1, MOMENTS) + NDTR) as usize) % RING
    }

    /// Returns whether the counts of the streams agree. Without a fault, they disagree only while an event is being
    /// output. They agree if:
    ///
    /// * DMA1 has counted `first_moments` more event times than there were edges;
    /// * all ports have output the same number of edges;
    /// * at most one end of a pulse has not been output yet.
    #[inline(always)]
    fn counts_agree(&self) -> bool {
        let left = |number| read(stream(M::DMA2, number) + NDTR) as usize;
        let edges = left(streams::<M>(0, S).on);
        let mut agree = (self.moments_counted() + edges) % RING == self.first_moments;
        for port in 0..P {
            let Streams { on, off, .. } = streams::<M>(port, S);
            agree &= port == 0 || left(on) == edges;
            agree &= off.is_none_or(|off| left(off).wrapping_sub(edges) % RING <= 1);
        }
        agree
    }

    /// Empties the ring and returns the number of events that were not output. Calls `each` with the words of each
    /// such event. Call after [`Chain::silence`]; `tail` is the slot that it returned.
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

    /// Ends the output, and with `dark` sets the power to 0. Returns the slot of the first event that was not output,
    /// and whether the output has failed.
    #[inline(always)]
    pub(super) fn silence(&mut self, dark: bool) -> (usize, bool) {
        if !self.begun {
            return (0, false);
        }
        self.ignore_triggers();
        // Disable the DMA requests of TIM5. First wait until imminent requests have been served: a request that is
        // disabled half-way would stay pending. The requests for event times come first, because `keep_power` can wait
        // for the request for power. During that wait, more than one request for an event time could come.
        self.await_served(CCR1);
        write(M::TIM5 + DIER, read(M::TIM5 + DIER) & ASKS_FOR_POWER | CALLS);
        if dark {
            self.drop_power();
            write(self.pwm.compare, 0);
        } else {
            self.keep_power();
        }
        cortex_m::asm::delay(SERVED_CYCLES);
        let tail = self.tail();
        let mut fault = false;
        for port in 1..P {
            let left = read(stream(M::DMA2, streams::<M>(port, S).on) + NDTR) as usize;
            let ahead = (RING - tail).wrapping_sub(left) % RING;
            // If an event occurred between the two stores of `ignore_triggers`, only the ports of TIM8 have output it.
            fault |= ahead > usize::from(port >= S);
        }
        fault |= (read(M::DMA2 + LISR) | read(M::DMA2 + HISR)) & ERRORS != 0;
        if !self.one_by_one {
            // DMA1 must have counted `first_moments` more event times than there were edges. It may have counted one
            // more, if a compare event came after TIM1 was made to ignore its trigger.
            let more = self.moments_counted().wrapping_sub(tail).wrapping_sub(self.first_moments) % RING;
            fault |= more > 1 || read(M::DMA1 + LISR) & MOMENT_ERRORS != 0;
        }
        write(stream(M::DMA1, MOMENTS) + CR, 0);
        (tail, fault)
    }
}
