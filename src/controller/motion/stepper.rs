//! The step generator: turns blocks and segments into step bits and intervals, one call for each expiry of the timer.
//!
//! One threshold serves all axes. A tick adds to each axis' counter its own steps (times the units the tick advances); an
//! axis whose counter passes the threshold steps and takes the threshold off. All counters begin at half the threshold,
//! so each axis stays within half a step of the straight line, and after the whole block every counter is back at half:
//!
//! ```text
//!  counter of Y for (X, Y) = (10, 3), threshold 10, in steps of X       1 2 3 4 5 6 7 8 9 10
//!                                                                  Y      ^       ^     ^
//! ```
//! It promises: never a step without a segment; a queue that runs dry stops the pulses at once and is reported; after a
//! stop nothing moves until the matching `Resume`; the position is exact at any tick. It leaves the acceleration to
//! `planner` and `segment`, pulse widths and direction set-up to the task that writes the pins.

use crate::axes::PerAxis;
use crate::messages::{INTERVAL_FRACTION_BITS, Segment, StepEvent, ToStep, UNITS_PER_STEP};

/// Mask of the fraction of an interval.
const FRACTION_MASK: u32 = (1 << INTERVAL_FRACTION_BITS) - 1;
/// Finest smoothing: a tick advances one unit.
pub const MAX_LEVEL: u8 = 4;
/// Interval, in fixed point, at which braking ends: some milliseconds for a tick are a crawl, and sums stay in 32 bits.
const LONGEST_BRAKING: f32 = (1_u32 << 30) as f32;

/// What to do at an expiry of the step timer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Axes to step now, bit 0 for X.
    pub steps: u8,
    /// Direction levels for the *next* step (bit set = negative), to be written once this pulse has ended.
    pub directions: u8,
    /// Step-clock ticks to the next call; 0 = at rest, the timer may stop.
    pub interval: u32,
    /// Spindle or laser power from now on.
    pub power: u16,
    /// The queue ran dry at speed; the report is at [`Stepper::underrun_event`].
    pub underrun: bool,
}

/// State of the step task. The steady tick touches the first ten words only.
#[derive(Clone, Debug)]
pub struct Stepper<const N: usize> {
    counters: [u32; N],
    increments: [u32; N],
    threshold: u32,
    interval: u32,
    ramp: i32,
    carry: u32,
    /// Ticks left in the segment; 0 = at rest.
    ticks: u32,
    power: u16,
    directions: u8,
    last: bool,
    /// Units that the current segment advances at each tick, and how many ticks it had.
    units_per_tick: u32,
    segment_ticks: u32,
    /// Units of the block before the current segment.
    block_units: u32,
    steps: [u32; N],
    dominant: u32,
    /// Position at the start of the block.
    base: [i32; N],
    next_segment: Option<Segment>,
    next_steps: [u32; N],
    next_directions: u8,
    next_units: u32,
    gate_shut: bool,
    stops: u8,
    begun: u32,
    /// State of the probe that is waited for, and how to brake then: units per square of a clock.
    watch: Option<bool>,
    braking: f32,
    /// Braking after a contact.
    brakes: bool,
}

/// Steps that an axis has taken after `units` of a block in which it takes `steps` and the dominant axis `dominant`.
///
/// The counter is half the threshold + steps × units, less a threshold for each step taken, and stays within
/// 1..=threshold; so the quotient is exact.
#[inline]
pub(crate) fn steps_taken(steps: u32, dominant: u32, units: u32) -> u32 {
    if dominant == 0 {
        return 0;
    }
    let threshold = dominant.wrapping_mul(UNITS_PER_STEP);
    let sum = u64::from(steps) * u64::from(units) + u64::from(threshold / 2) - 1;
    match u32::try_from(sum) {
        Ok(small) => small / threshold,
        Err(_) => (sum / u64::from(threshold)) as u32,
    }
}

impl<const N: usize> Default for Stepper<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Stepper<N> {
    /// At rest, at position 0, gate open.
    pub const fn new() -> Self {
        Self {
            counters: [0; N],
            increments: [0; N],
            threshold: 0,
            interval: 0,
            ramp: 0,
            carry: 0,
            ticks: 0,
            power: 0,
            directions: 0,
            last: true,
            units_per_tick: 0,
            segment_ticks: 0,
            block_units: 0,
            steps: [0; N],
            dominant: 0,
            base: [0; N],
            next_segment: None,
            next_steps: [0; N],
            next_directions: 0,
            next_units: 0,
            gate_shut: false,
            stops: 0,
            begun: 0,
            watch: None,
            braking: 0.0,
            brakes: false,
        }
    }

    /// Whether there is room for one more message. The step task loads as long as this holds and messages are there, then
    /// calls [`Stepper::tick`]: a new block needs two or three messages, all other segments one.
    #[inline]
    pub fn wants(&self) -> bool {
        self.next_segment.is_none()
    }

    /// Takes a message; only while [`Stepper::wants`].
    #[inline]
    pub fn load(&mut self, message: ToStep) {
        if self.gate_shut {
            if let ToStep::Resume { stops } = message {
                self.gate_shut = stops != self.stops;
            }
            return;
        }
        match message {
            ToStep::Segment(segment) => self.next_segment = Some(segment),
            ToStep::Block { steps, directions } => {
                for (own, new) in self.next_steps.iter_mut().zip(steps) {
                    *own = new;
                }
                self.next_directions = directions;
            }
            ToStep::BlockRest { steps } => {
                for (own, new) in self.next_steps.iter_mut().skip(3).zip(steps) {
                    *own = new;
                }
            }
            ToStep::Reenter { units } => self.next_units = units,
            ToStep::Watch { probe, braking } => {
                self.watch = probe;
                self.braking = braking;
            }
            ToStep::Resume { .. } => {}
        }
    }

    /// One expiry of the step timer; from rest the first call makes no step and gives the interval to the first.
    #[inline]
    pub fn tick(&mut self) -> Tick {
        let mut steps = 0;
        if self.ticks != 0 {
            let threshold = self.threshold;
            for (bit, (counter, increment)) in self.counters.iter_mut().zip(self.increments).enumerate() {
                let sum = counter.wrapping_add(increment);
                if sum > threshold {
                    steps |= 1 << bit;
                    *counter = sum.wrapping_sub(threshold);
                } else {
                    *counter = sum;
                }
            }
            self.ticks -= 1;
        }
        if self.ticks == 0 && !self.begin_segment() {
            let underrun = !self.last;
            if underrun {
                self.shut();
            }
            return Tick { steps, directions: self.directions, interval: 0, power: self.power, underrun };
        }
        let due = self.interval.wrapping_add(self.carry);
        self.carry = due & FRACTION_MASK;
        self.interval = self.interval.wrapping_add_signed(self.ramp);
        let interval = due >> INTERVAL_FRACTION_BITS;
        Tick { steps, directions: self.directions, interval, power: self.power, underrun: false }
    }

    /// Makes the prefetched segment the current one; `false` if there is none.
    fn begin_segment(&mut self) -> bool {
        let Some(segment) = self.next_segment.take() else { return self.brakes && self.brake() };
        let level = segment.level.min(MAX_LEVEL);
        if segment.flags & Segment::FLAG_NEW_BLOCK != 0 {
            self.begin_block();
        } else {
            self.block_units = self.units();
        }
        if segment.flags & Segment::FLAG_WAIT != 0 {
            self.increments = [0; N];
            self.units_per_tick = 0;
        } else {
            let shift = MAX_LEVEL - level;
            self.increments = self.steps.map(|steps| steps << shift);
            self.units_per_tick = 1 << shift;
        }
        self.interval = segment.interval;
        self.ramp = segment.ramp;
        self.ticks = u32::from(segment.ticks.max(1));
        self.segment_ticks = self.ticks;
        self.power = segment.power;
        self.last = segment.flags & Segment::FLAG_LAST != 0;
        self.begun = self.begun.wrapping_add(1);
        true
    }

    fn begin_block(&mut self) {
        if self.units() == self.dominant.wrapping_mul(UNITS_PER_STEP) {
            // The usual case: the block before was run to its end.
            let directions = self.directions;
            for (bit, (base, steps)) in self.base.iter_mut().zip(self.steps).enumerate() {
                *base = signed_add(*base, steps, directions >> bit & 1 != 0);
            }
        } else {
            self.base = self.position().0;
        }
        self.steps = self.next_steps;
        self.directions = self.next_directions;
        self.dominant = self.steps.iter().fold(0, |most, steps| most.max(*steps));
        self.threshold = self.dominant.wrapping_mul(UNITS_PER_STEP);
        self.counters = [self.threshold / 2; N];
        self.block_units = 0;
        if self.next_units != 0 {
            self.enter_midst();
        }
    }

    /// Brings the counters to where they were when the block was left at `next_units`.
    fn enter_midst(&mut self) {
        let units = core::mem::take(&mut self.next_units);
        self.block_units = units;
        let (half, threshold, dominant, directions) =
            (self.threshold / 2, u64::from(self.threshold), self.dominant, self.directions);
        let axes = self.counters.iter_mut().zip(self.base.iter_mut()).zip(self.steps);
        for (bit, ((counter, base), steps)) in axes.enumerate() {
            let taken = steps_taken(steps, dominant, units);
            let sum = u64::from(half) + u64::from(steps) * u64::from(units);
            *counter = sum.wrapping_sub(u64::from(taken) * threshold) as u32;
            *base = signed_add(*base, taken, directions >> bit & 1 == 0);
        }
    }

    /// Units of the block advanced by now.
    fn units(&self) -> u32 {
        let ticks_done = self.segment_ticks.wrapping_sub(self.ticks);
        self.block_units.wrapping_add(ticks_done.wrapping_mul(self.units_per_tick))
    }

    /// Stops at once, forgets everything and shuts the gate until [`ToStep::Resume`] with this count of stops.
    pub fn stop(&mut self) -> StepEvent<N> {
        let moving = self.ticks != 0;
        self.shut();
        StepEvent::Stopped { stops: self.stops, moving, position: self.position() }
    }

    /// The report that belongs to a [`Tick::underrun`].
    pub fn underrun_event(&self) -> StepEvent<N> {
        StepEvent::Underrun { stops: self.stops, position: self.position() }
    }

    /// Whether [`Stepper::probe`] is to be called after each tick.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.watch.is_some()
    }

    /// Looks at the probe. The first time it has the awaited state the place is latched, what is queued is void, and
    /// braking begins with the next tick.
    pub fn probe(&mut self, active: bool) -> Option<StepEvent<N>> {
        if self.watch != Some(active) {
            return None;
        }
        self.watch = None;
        let position = self.position();
        self.gate_shut = true;
        self.next_segment = None;
        self.next_units = 0;
        self.last = true;
        if self.ticks != 0 {
            // The tick that is under way is the last of its segment.
            self.block_units = self.units();
            self.segment_ticks = 1;
            self.ticks = 1;
            self.ramp = 0;
            self.brakes = true;
        }
        Some(StepEvent::Probed { position })
    }

    /// Begins the next tick of a ramp down; `false` when there is nothing left to brake.
    ///
    /// A tick of `u` units at the interval T is a speed v = u/T, and v² falls by 2·a·u from tick to tick: with k = a·T²/u
    /// the next interval is T / sqrt(1 - 2k), of which the first terms of the series are taken. The last tick of the ramp
    /// is the one that would take all of v².
    #[cold]
    fn brake(&mut self) -> bool {
        let units = self.units();
        let interval = self.interval as f32 / (1 << INTERVAL_FRACTION_BITS) as f32;
        let k = self.braking * interval * interval / self.units_per_tick as f32;
        let next = self.interval as f32 * (1.0 + k * (1.0 + k * (1.5 + k * 2.5)));
        let ends = units >= self.dominant.wrapping_mul(UNITS_PER_STEP);
        // Not a number where the tick advances no units: a crawl, which stops where it is.
        self.brakes = !ends && k < 0.5 && next < LONGEST_BRAKING;
        if self.brakes {
            self.block_units = units;
            self.interval = next as u32;
            self.ticks = 1;
        }
        self.brakes
    }

    fn shut(&mut self) {
        self.watch = None;
        self.brakes = false;
        self.base = self.position().0;
        self.steps = [0; N];
        self.dominant = 0;
        self.threshold = 0;
        self.counters = [0; N];
        self.increments = [0; N];
        self.block_units = 0;
        self.segment_ticks = 0;
        self.ticks = 0;
        self.carry = 0;
        self.power = 0;
        self.last = true;
        self.next_segment = None;
        self.next_units = 0;
        self.gate_shut = true;
        self.stops = self.stops.wrapping_add(1);
    }

    /// Whether a stop has not been answered yet.
    #[inline]
    pub fn is_shut(&self) -> bool {
        self.gate_shut
    }

    /// Whether there is nothing left to do.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.ticks == 0 && self.next_segment.is_none()
    }

    /// Segments begun since power-up (wrapping).
    #[inline]
    pub fn segments_begun(&self) -> u32 {
        self.begun
    }

    /// Net steps of each axis since power-up (wrapping), all steps of the ticks so far included.
    ///
    /// Derived from the progress within the block, so that no tick has to count.
    pub fn position(&self) -> PerAxis<i32, N> {
        let units = self.units();
        let mut position = self.base;
        for (bit, (value, steps)) in position.iter_mut().zip(self.steps).enumerate() {
            let taken = steps_taken(steps, self.dominant, units);
            *value = signed_add(*value, taken, self.directions >> bit & 1 != 0);
        }
        PerAxis(position)
    }
}

/// `value` plus or minus `steps`.
#[inline]
pub(crate) fn signed_add(value: i32, steps: u32, negative: bool) -> i32 {
    if negative { value.wrapping_sub_unsigned(steps) } else { value.wrapping_add_unsigned(steps) }
}
