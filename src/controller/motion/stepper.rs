//! The step generator: turns blocks and segments into step bits and moments, one call for each tick.
//!
//! One threshold serves all axes. A tick takes each axis' own rate (times the units the tick advances) off what is left
//! until its next step; an axis with less than that left steps and gets the threshold added. On a line the rate is the axis'
//! steps, and all begin with half the threshold, so each stays within half a step of the straight line, and after the whole
//! block all have half of it again:
//!
//! ```text
//!  what is left of Y for (X, Y) = (10, 3), threshold 10, in steps of X      1 2 3 4 5 6 7 8 9 10
//!                                                                       Y     ^       ^     ^
//! ```
//! A chord of an arc begins and ends between steps, at f and g of a step beside them ([`Leg`]). An axis with n steps has taken
//! ⌈f + (n + g - f)·u/M - 1/2⌉ of them after u of M units: none at the start and n at the end, for f and g are less than a
//! half, and always within half a step of the true chord. In sevenths of a step that is the same arithmetic, with 7·M as the
//! threshold, 7·n + 7·g - 7·f as the rate, and 7·f·M less at the start.
//!
//! It promises: never a step without a segment; a queue that runs dry stops the pulses at once and is reported; after a
//! stop nothing moves until the matching `Resume`; the position is exact at any tick. It leaves the acceleration to
//! `planner` and `segment`, pulse widths and direction set-up to the task that writes the pins.
//!
//! What a tick costs bounds the step rate of a machine. So what can be computed when a message is loaded is computed
//! there, a tick within a segment touches the first words of the state only and divides nothing, and no position is
//! counted: it follows from how far the block has come.

use super::measure::{Measure, advance, inverse, parts_beyond, signed_add, steps_and_rest};
use crate::axes::PerAxis;
use crate::messages::{INTERVAL_FRACTION_BITS, Leg, Segment, StepEvent, ToStep};
use core::sync::atomic::{Ordering, compiler_fence};

/// Finest smoothing: a tick advances one unit.
pub const MAX_LEVEL: u8 = 4;
/// Places of an interval's lowest bit in the fraction of [`Stepper::moment`].
const FRACTION_SHIFT: u32 = 32 - INTERVAL_FRACTION_BITS;
/// Interval, in fixed point, at which braking ends: some milliseconds for a tick are a crawl, and sums stay in 32 bits.
const LONGEST_BRAKING: f32 = (1_u32 << 30) as f32;

/// What to do at a tick.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// Axes to step now, bit 0 for X.
    pub steps: u8,
    /// Direction levels for the *next* step (bit set = negative), to be written once this pulse has ended. They change
    /// with the first tick of a segment only.
    pub directions: u8,
    /// Step-clock ticks to the next one; 0 = at rest.
    pub interval: u32,
    /// A segment has begun with this tick, and its power and directions hold from now on.
    pub begins: bool,
    /// The queue ran dry at speed; the report is at [`Stepper::underrun_event`].
    pub underrun: bool,
}

/// A segment, ready to run.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Piece<const N: usize> {
    /// What a tick takes off.
    increments: [u32; N],
    /// Ticks until one that does more than to step.
    plain_ticks: u32,
    /// Ticks left after these, none of which is plain: while the probe is waited for all, otherwise the last. No tick left
    /// = at rest.
    rare_ticks: u32,
    /// In fixed point, to the next tick, and its change from tick to tick.
    interval: u32,
    ramp: i32,
    /// Units that a tick advances.
    units_per_tick: u32,
    /// Units of the block at the end of the segment.
    end_units: u32,
    power: u16,
    last: bool,
    new_block: bool,
}

/// A block, ready to run.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Course<const N: usize> {
    /// How far the true start of each axis is beyond the rounded one, in parts of the threshold.
    beyond: [u32; N],
    /// What a unit takes off.
    rates: [u32; N],
    threshold: u32,
    /// Units of the whole block.
    total: u32,
    /// Units at which it is entered; 0 = at its start.
    entered: u32,
    directions: u8,
    /// Position at the start of the block and at its end.
    base: [i32; N],
    end: [i32; N],
}

/// State of the step task. The order is that of use: a tick within a segment needs the first part only.
#[derive(Clone, Debug)]
#[repr(C)]
pub struct Stepper<const N: usize> {
    /// What is left until the next step of each axis: 0 to `threshold` - 1.
    left: [u32; N],
    piece: Piece<N>,
    /// Of the current block.
    threshold: u32,
    directions: u8,
    /// Which of `courses` is that of the current block; the other is that of the next.
    odd: bool,
    /// Moment of the next tick, 32 bits of step-clock ticks before 32 of their fraction.
    moment: u64,
    /// A state of the probe is waited for.
    is_watching: bool,
    /// The state it is to have.
    watched: bool,

    begun: u32,
    is_next: bool,
    /// The probe has been seen at the last tick, and where that was has not been noted yet.
    unnoted: bool,
    next_piece: Piece<N>,
    courses: [Course<N>; 2],
    /// Parts of the axes of the block that is being told of.
    legs: [Leg; N],
    gate_shut: bool,
    stops: u16,
    /// How to brake at a contact: units per square of a clock.
    braking: f32,
    /// Braking after a contact.
    brakes: bool,
    /// Where the probe has been seen.
    touched: Contact<N>,
}

impl<const N: usize> Piece<N> {
    const REST: Self = Self {
        increments: [0; N],
        plain_ticks: 0,
        rare_ticks: 0,
        interval: 0,
        ramp: 0,
        units_per_tick: 0,
        end_units: 0,
        power: 0,
        last: true,
        new_block: false,
    };

    #[inline]
    fn ticks(&self) -> u32 {
        self.plain_ticks.wrapping_add(self.rare_ticks)
    }
}

impl<const N: usize> Course<N> {
    const NOWHERE: Self = Self {
        beyond: [0; N],
        rates: [0; N],
        threshold: 0,
        total: 0,
        entered: 0,
        directions: 0,
        base: [0; N],
        end: [0; N],
    };

    /// What is left until the next step of each axis at the start: half a step but for what is done of it.
    #[inline(always)]
    fn first(&self) -> [u32; N] {
        self.beyond.map(|beyond| (self.threshold / 2).wrapping_sub(beyond))
    }

    /// Net steps. Steps taken × threshold = rate × units + left - what was left first, to the last bit; so the quotient
    /// needs no division: below 2^32 it is the product with the inverse of the threshold's odd part.
    #[inline(never)]
    fn position(&self, left: &[u32; N], units: u32) -> PerAxis<i32, N> {
        let Course { rates, threshold, directions, base, .. } = self;
        let mut position = *base;
        if *threshold == 0 {
            return PerAxis(position);
        }
        let even = threshold.trailing_zeros();
        let inverse = inverse(threshold >> even);
        let lefts = left.iter().zip(self.first());
        for (bit, (value, (rate, (left, first)))) in position.iter_mut().zip(rates.iter().zip(lefts)).enumerate() {
            let sum = advance(*rate, units).wrapping_add(u64::from(*left));
            let whole = sum.wrapping_sub(u64::from(first));
            let taken = ((whole >> even) as u32).wrapping_mul(inverse);
            *value = signed_add(*value, taken, directions >> bit & 1 != 0);
        }
        PerAxis(position)
    }
}

/// The countdown of `K` axes, each with what is left until its next step and with its increment, over as many ticks as there
/// are words: for each the word of the axes that step. What is left of each axis after them.
#[inline(always)]
fn count_down<const K: usize>(
    axes: [(u32, u32); K],
    threshold: u32,
    of_steps: &[u32; 8],
    words: &mut [u32],
) -> [u32; 3] {
    let mut axes = axes;
    for word in words {
        let mut steps = 0_usize;
        for (bit, (left, increment)) in axes.iter_mut().enumerate() {
            // As in `step_axes`: the sign says whether the axis steps.
            *left = left.wrapping_sub(*increment);
            if (*left as i32) < 0 {
                *left = left.wrapping_add(threshold);
                steps |= 1 << bit;
            }
        }
        *word = of_steps.get(steps & 7).copied().unwrap_or(0);
    }
    let mut left = [0; 3];
    for (slot, (new, _)) in left.iter_mut().zip(axes) {
        *slot = new;
    }
    left
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
            left: [0; N],
            piece: Piece::REST,
            threshold: 0,
            directions: 0,
            odd: false,
            moment: 0,
            is_watching: false,
            watched: false,
            begun: 0,
            is_next: false,
            unnoted: false,
            next_piece: Piece::REST,
            courses: [Course::NOWHERE; 2],
            legs: [Leg::on_steps(0); N],
            gate_shut: false,
            stops: 0,
            braking: 0.0,
            brakes: false,
            touched: Contact::START,
        }
    }

    /// Whether there is room for one more message. The step task loads as long as this holds and messages are there, then
    /// calls [`Stepper::tick`]: a new block needs two or three messages, all other segments one.
    #[inline]
    pub fn wants(&self) -> bool {
        !self.is_next || self.unnoted
    }

    /// Takes a message; only while [`Stepper::wants`].
    #[inline]
    pub fn load(&mut self, message: ToStep) {
        if self.unnoted {
            self.note_touch();
        }
        if self.gate_shut {
            if let ToStep::Resume { stops } = message {
                self.gate_shut = stops != self.stops;
            }
            return;
        }
        match message {
            ToStep::Segment(segment) => self.load_segment(&segment),
            ToStep::Block { legs, directions } => {
                for (own, new) in self.legs.iter_mut().zip(legs) {
                    *own = new;
                }
                self.load_block(directions);
            }
            ToStep::BlockRest { legs } => {
                for (own, new) in self.legs.iter_mut().skip(3).zip(legs) {
                    *own = new;
                }
            }
            ToStep::Reenter { units } => {
                if let Some(next) = self.course_mut(true) {
                    next.entered = units;
                }
            }
            ToStep::Watch { probe, braking } => {
                self.is_watching = probe.is_some();
                self.watched = probe == Some(true);
                self.braking = braking;
                if self.is_watching {
                    self.look_at_all();
                }
            }
            ToStep::Resume { .. } => {}
        }
    }

    /// The course of the current block, or that of the next.
    #[inline(always)]
    fn course(&self, next: bool) -> &Course<N> {
        self.courses.get(usize::from(self.odd != next)).unwrap_or(&Course::NOWHERE)
    }

    /// The same to be changed.
    #[inline(always)]
    fn course_mut(&mut self, next: bool) -> Option<&mut Course<N>> {
        self.courses.get_mut(usize::from(self.odd != next))
    }

    #[inline]
    fn load_block(&mut self, directions: u8) {
        let legs = self.legs;
        // One that is left before its end is seen to in `begin_block`.
        let base = self.course(false).end;
        let Some(next) = self.course_mut(true) else { return };
        next.entered = 0;
        next.directions = directions;
        next.base = base;
        for (bit, ((end, base), leg)) in next.end.iter_mut().zip(base).zip(legs).enumerate() {
            *end = signed_add(base, leg.steps(), directions >> bit & 1 != 0);
        }
        // One after the other, as in `step_axes`.
        compiler_fence(Ordering::SeqCst);
        let measure = Measure::of(&legs);
        next.threshold = measure.threshold;
        next.total = measure.total;
        for (rate, leg) in next.rates.iter_mut().zip(legs) {
            *rate = measure.rate(leg);
        }
    }

    /// What is left of [`Stepper::load_block`], so that no message takes too long.
    #[inline(always)]
    fn finish_block(&mut self) {
        let legs = self.legs;
        let Some(next) = self.course_mut(true) else { return };
        for (beyond, leg) in next.beyond.iter_mut().zip(legs) {
            *beyond = parts_beyond(next.total, leg);
        }
    }

    #[inline]
    fn load_segment(&mut self, segment: &Segment) {
        let new_block = segment.flags & Segment::FLAG_NEW_BLOCK != 0;
        if new_block {
            self.finish_block();
        }
        let course = self.course(new_block);
        let units = if new_block { course.entered } else { self.piece.end_units };
        let mut increments = [0; N];
        let mut units_per_tick = 0;
        if segment.flags & Segment::FLAG_WAIT == 0 {
            let shift = MAX_LEVEL - segment.level.min(MAX_LEVEL);
            increments = course.rates.map(|rate| rate << shift);
            units_per_tick = 1 << shift;
            debug_assert!(units & (units_per_tick - 1) == 0, "a tick of {units_per_tick} units begins at {units}");
        }
        let ticks = u32::from(segment.ticks.max(1));
        self.next_piece = Piece {
            increments,
            plain_ticks: ticks.wrapping_sub(1),
            rare_ticks: 1,
            interval: segment.interval,
            ramp: segment.ramp,
            units_per_tick,
            end_units: units.wrapping_add(ticks.wrapping_mul(units_per_tick)),
            power: segment.power,
            last: segment.flags & Segment::FLAG_LAST != 0,
            new_block,
        };
        self.is_next = true;
    }

    /// The next tick; from rest the first makes no step and gives the interval to the one that does.
    #[inline]
    pub fn tick(&mut self) -> Tick {
        if self.unnoted {
            self.note_touch();
        }
        let steps = self.step_axes();
        match self.piece.plain_ticks.checked_sub(1) {
            Some(left) => {
                self.piece.plain_ticks = left;
                self.set_out(steps)
            }
            None => self.rare_tick(steps),
        }
    }

    /// Plain ticks in a row, as many as there is room for or as the segment has left: for each its steps, as the entry of
    /// `table` that belongs to them (bit 0 for X), and its moment. How many.
    ///
    /// All steps come first and then all moments, so that the state of each loop stays in registers. What follows is as
    /// if [`Stepper::tick`] had been called as often.
    #[inline(always)]
    pub fn plain_ticks(&mut self, table: &[u32; 8], words: &mut [u32], moments: &mut [u32]) -> usize {
        const { assert!(N <= 3, "a table of eight words is for three axes") };
        let count = words.len().min(moments.len()).min(self.piece.plain_ticks as usize);
        let (Some(words), Some(moments)) = (words.get_mut(..count), moments.get_mut(..count)) else { return 0 };
        self.piece.plain_ticks = self.piece.plain_ticks.wrapping_sub(count as u32);
        self.steps_into(table, words);
        self.moments_into(moments);
        count
    }

    /// The steps of plain ticks. An axis that steps at each of them (the dominant one, when a tick is a whole step) needs no
    /// countdown, one that never steps neither: the loop counts for as many axes as are left.
    #[inline(always)]
    fn steps_into(&mut self, table: &[u32; 8], words: &mut [u32]) {
        let mut always = 0_usize;
        let mut counting = [(0_usize, 0_u32, 0_u32); 3];
        let mut count = 0_usize;
        for (axis, (left, increment)) in self.left.iter().zip(&self.piece.increments).enumerate() {
            if *increment == self.threshold {
                always |= 1 << axis;
            } else if *increment != 0
                && let Some(slot) = counting.get_mut(count)
            {
                *slot = (axis, *left, *increment);
                count += 1;
            }
        }
        // Of the steps of the counting axes, one bit each in their order: the word with all axes.
        let of_counting: [u32; 8] = core::array::from_fn(|steps| {
            let all = counting.iter().enumerate().take(count);
            let axes = all.fold(always, |axes, (bit, (axis, ..))| axes | (steps >> bit & 1) << axis);
            table.get(axes & 7).copied().unwrap_or(0)
        });
        let threshold = self.threshold;
        let [a, b, c] = counting.map(|(_, left, increment)| (left, increment));
        let left = match count {
            0 => {
                words.fill(table.get(always & 7).copied().unwrap_or(0));
                return;
            }
            // For one counting axis a loop of its own would save little: the other one takes nothing off.
            1 | 2 => count_down([a, b], threshold, &of_counting, words),
            _ => count_down([a, b, c], threshold, &of_counting, words),
        };
        for ((axis, ..), new) in counting.iter().zip(left).take(count) {
            if let Some(left) = self.left.get_mut(*axis) {
                *left = new;
            }
        }
    }

    #[inline(always)]
    fn moments_into(&mut self, moments: &mut [u32]) {
        let (mut moment, mut interval, ramp) = (self.moment, self.piece.interval, self.piece.ramp);
        for at in moments {
            *at = (moment >> 32) as u32;
            moment = moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT);
            interval = interval.wrapping_add_signed(ramp);
        }
        (self.moment, self.piece.interval) = (moment, interval);
    }

    /// Whether the next tick is one for [`Stepper::plain_ticks`].
    #[inline(always)]
    pub fn has_plain(&self) -> bool {
        self.piece.plain_ticks != 0
    }

    /// The least and the greatest interval, in whole step-clock ticks rounded down, between the ticks of the segment from
    /// the next tick on.
    #[inline]
    pub fn intervals(&self) -> (u32, u32) {
        let Piece { interval, ramp, .. } = self.piece;
        // Exact in 32 bits, as each interval is.
        let last = interval.wrapping_add((ramp as u32).wrapping_mul(self.piece.ticks().wrapping_sub(1)));
        let (least, greatest) = if last < interval { (last, interval) } else { (interval, last) };
        (least >> INTERVAL_FRACTION_BITS, greatest >> INTERVAL_FRACTION_BITS)
    }

    /// The least time from one step of the fastest axis to its next one in the segment, in step-clock ticks: several ticks at low rates.
    #[inline]
    pub fn step_interval(&self) -> u32 {
        let (least, _) = self.intervals();
        let level =
            u32::from(MAX_LEVEL).wrapping_sub(self.piece.units_per_tick.trailing_zeros().min(u32::from(MAX_LEVEL)));
        least.wrapping_shl(level)
    }

    /// Whether the next tick ends a segment that another one is to follow, and that one is not here yet: the tick would be
    /// an underrun.
    #[inline]
    pub fn lacks_segment(&self) -> bool {
        self.piece.ticks() == 1 && !self.is_next && !self.piece.last && !self.brakes && !self.unnoted
    }

    /// What a tick does after its steps with which a segment may end or motion begin or end, or at which the probe is waited for.
    #[inline(always)]
    fn rare_tick(&mut self, steps: u8) -> Tick {
        if self.piece.rare_ticks > 1 {
            self.piece.rare_ticks = self.piece.rare_ticks.wrapping_sub(1);
            return self.set_out(steps);
        }
        if self.is_next {
            self.begin_segment();
            return Tick { begins: true, ..self.set_out(steps) };
        }
        self.piece.rare_ticks = 0;
        if self.brakes && self.brake() {
            return self.set_out(steps);
        }
        let underrun = self.run_out();
        Tick { steps, directions: self.directions, interval: 0, begins: false, underrun }
    }

    /// The DDA (Bresenham's algorithm): each axis counts down to its next step by its increment.
    #[inline(always)]
    fn step_axes(&mut self) -> u8 {
        let mut minus_steps = 0_i32;
        let threshold = self.threshold as i32;
        // The last axis first: each doubles the bits of those before it.
        for (left, increment) in self.left.iter_mut().zip(&self.piece.increments).rev() {
            // Both are at most the threshold, which is at most 2^30, and some parts of a step more, or are as little below 0.
            // So the sign says whether the axis steps, and without a branch: all bits of `stepping` are those of a sign. No
            // axis steps twice in a tick, which advances a step of the dominant axis at most, and begins at a multiple of
            // what it advances: with as many steps it makes one in each of these, wherever its ends are, and with less its
            // true way is shorter, too.
            let rest = left.wrapping_sub(*increment) as i32;
            let stepping = rest >> 31;
            *left = rest.wrapping_add(threshold & stepping) as u32;
            minus_steps = minus_steps.wrapping_mul(2).wrapping_add(stepping);
            // One axis after the other: all at once they need more registers than an interrupt gets for nothing.
            compiler_fence(Ordering::SeqCst);
        }
        minus_steps.wrapping_neg() as u8
    }

    /// Sets the moment of the next tick.
    #[inline(always)]
    fn set_out(&mut self, steps: u8) -> Tick {
        let now = self.moment();
        let interval = self.piece.interval;
        self.moment = self.moment.wrapping_add(u64::from(interval) << FRACTION_SHIFT);
        self.piece.interval = interval.wrapping_add_signed(self.piece.ramp);
        let interval = self.moment().wrapping_sub(now);
        Tick { steps, directions: self.directions, interval, begins: false, underrun: false }
    }

    /// Spindle or laser power of the segment.
    #[inline]
    pub fn power(&self) -> u16 {
        self.piece.power
    }

    /// Directions of the next step, as in [`Tick::directions`].
    #[inline]
    pub fn directions(&self) -> u8 {
        self.directions
    }

    /// Whether the next tick is the last of its segment, or begins to move: it takes up what has been fetched.
    #[inline(always)]
    pub fn ends_segment(&self) -> bool {
        self.piece.ticks() <= 1
    }

    /// Whether an axis steps at the next tick.
    #[inline]
    pub fn steps_next(&self) -> bool {
        // As in `step_axes`.
        self.left.iter().zip(&self.piece.increments).any(|(left, increment)| (left.wrapping_sub(*increment) as i32) < 0)
    }

    /// The moment of the next tick, on the step clock (wrapping); that of the last one at rest.
    #[inline(always)]
    pub fn moment(&self) -> u32 {
        (self.moment >> 32) as u32
    }

    /// Sets the moment of the next tick: of the first after a rest, or of one that is put off, with all that come after it. The
    /// fraction of a clock tick stays.
    pub fn begin_at(&mut self, moment: u32) {
        self.moment = u64::from(moment) << 32 | u64::from(self.moment as u32);
    }

    /// No segment has followed: rest, and whether it is a fault.
    #[cold]
    fn run_out(&mut self) -> bool {
        let underrun = !self.piece.last;
        if underrun {
            self.shut();
        }
        self.piece.increments = [0; N];
        underrun
    }

    /// Makes the prefetched segment the current one.
    #[inline(always)]
    fn begin_segment(&mut self) {
        self.is_next = false;
        if self.next_piece.new_block {
            self.begin_block();
        }
        self.piece = self.next_piece;
        self.begun = self.begun.wrapping_add(1);
        if self.is_watching {
            self.look_at_all();
        }
    }

    /// The probe is waited for: no tick is plain.
    #[inline]
    fn look_at_all(&mut self) {
        self.piece.rare_ticks = self.piece.ticks();
        self.piece.plain_ticks = 0;
    }

    #[inline(always)]
    fn begin_block(&mut self) {
        if self.piece.end_units != self.course(false).total {
            self.leave_midst();
        }
        self.odd = !self.odd;
        // The fields themselves and not `Course::first`: built for size, an array in between is copied three times.
        let course = self.courses.get(usize::from(self.odd)).unwrap_or(&Course::NOWHERE);
        let Course { beyond, threshold, entered, directions, .. } = course;
        for (left, beyond) in self.left.iter_mut().zip(beyond) {
            *left = (threshold / 2).wrapping_sub(*beyond);
        }
        (self.threshold, self.directions) = (*threshold, *directions);
        if *entered != 0 {
            self.enter_midst();
        }
    }

    /// The block before was left before its end, for a detour.
    #[cold]
    fn leave_midst(&mut self) {
        // With this tick its segment has ended.
        self.piece.rare_ticks = 0;
        let position = self.position().0;
        if let Some(next) = self.course_mut(true) {
            for ((base, end), position) in next.base.iter_mut().zip(next.end.iter_mut()).zip(position) {
                *end = end.wrapping_sub(*base).wrapping_add(position);
                *base = position;
            }
        }
    }

    /// Brings all axes to where they were when the block was left at these units.
    #[cold]
    fn enter_midst(&mut self) {
        let mut left = self.left;
        let Some(course) = self.course_mut(false) else { return };
        let Course { rates, threshold, entered, directions, .. } = *course;
        let first = course.first();
        let axes = course.base.iter_mut().zip(course.end.iter_mut()).zip(rates.iter().zip(first));
        for (bit, (left, ((base, end), (rate, first)))) in left.iter_mut().zip(axes).enumerate() {
            let (taken, rest) = steps_and_rest(*rate, first, threshold, entered);
            *left = rest;
            for place in [base, end] {
                *place = signed_add(*place, taken, directions >> bit & 1 == 0);
            }
        }
        self.left = left;
    }

    /// Units of the block advanced by now.
    fn units(&self) -> u32 {
        self.piece.end_units.wrapping_sub(self.piece.ticks().wrapping_mul(self.piece.units_per_tick))
    }

    /// Stops at once, forgets everything and shuts the gate until [`ToStep::Resume`] with this count of stops.
    ///
    /// `undone` are the net steps of ticks that have been made ahead of their time and will not come out: the position is
    /// that without them.
    pub fn stop(&mut self, undone: [i32; N]) -> StepEvent<N> {
        let moving = self.piece.ticks() != 0 || undone.iter().any(|steps| *steps != 0);
        self.shut();
        self.take_back(undone);
        StepEvent::Stopped { stops: self.stops, moving, position: self.position() }
    }

    /// So many segments, those begun last, have not come out.
    pub fn take_back_segments(&mut self, undone: u32) {
        self.begun = self.begun.wrapping_sub(undone);
    }

    /// After a stop or an underrun: these net steps have not come out, so the position is that without them.
    pub fn take_back(&mut self, undone: [i32; N]) {
        if let Some(course) = self.course_mut(false) {
            for ((base, end), undone) in course.base.iter_mut().zip(course.end.iter_mut()).zip(undone) {
                *base = base.wrapping_sub(undone);
                *end = *base;
            }
        }
    }

    /// The report that belongs to a [`Tick::underrun`].
    pub fn underrun_event(&self) -> StepEvent<N> {
        StepEvent::Underrun { stops: self.stops, position: self.position() }
    }

    /// Whether [`Stepper::probe`] is to be called after each tick.
    #[inline]
    pub fn is_watching(&self) -> bool {
        self.is_watching
    }

    /// Looks at the probe; whether it has the awaited state for the first time. Then the place is latched, what is queued is
    /// void, and braking begins with the next tick; the report is at [`Stepper::probed_event`].
    #[inline]
    pub fn probe(&mut self, active: bool) -> bool {
        let touched = self.is_watching && self.watched == active;
        if touched {
            self.is_watching = false;
            self.unnoted = true;
        }
        touched
    }

    /// Keeps the place of the contact, throws away what is queued, and begins to brake. The tick that sees the contact has
    /// no time for that. Every call that would change something, or would tell of the gate, comes by here first.
    #[cold]
    fn note_touch(&mut self) {
        self.unnoted = false;
        self.touched = self.contact();
        self.gate_shut = true;
        self.is_next = false;
        self.piece.last = true;
        self.brakes = self.piece.rare_ticks != 0;
        if self.brakes {
            // The tick that is under way is the last of its segment.
            self.piece.end_units = self.units().wrapping_add(self.piece.units_per_tick);
            self.piece.rare_ticks = 1;
            self.piece.ramp = 0;
        }
    }

    /// Begins the next tick of a ramp down; `false` when there is nothing left to brake.
    ///
    /// A tick of `u` units at the interval T is a speed v = u/T, and v² falls by 2·a·u from tick to tick: with k = a·T²/u
    /// the next interval is T / sqrt(1 - 2k), of which the first terms of the series are taken. The last tick of the ramp
    /// is the one that would take all of v².
    #[cold]
    fn brake(&mut self) -> bool {
        let interval = self.piece.interval as f32 / (1 << INTERVAL_FRACTION_BITS) as f32;
        let k = self.braking * interval * interval / self.piece.units_per_tick as f32;
        let next = self.piece.interval as f32 * (1.0 + k * (1.0 + k * (1.5 + k * 2.5)));
        let ends = self.piece.end_units >= self.course(false).total;
        // Not a number where the tick advances no units: a crawl, which stops where it is.
        self.brakes = !ends && k < 0.5 && next < LONGEST_BRAKING;
        if self.brakes {
            self.piece.end_units = self.piece.end_units.wrapping_add(self.piece.units_per_tick);
            self.piece.interval = next as u32;
            self.piece.rare_ticks = 1;
        }
        self.brakes
    }

    /// The report that belongs to [`Stepper::probe`].
    pub fn probed_event(&mut self) -> StepEvent<N> {
        if self.unnoted {
            self.note_touch();
        }
        StepEvent::Probed { position: self.touched.position() }
    }

    #[cold]
    fn shut(&mut self) {
        if self.unnoted {
            self.note_touch();
        }
        self.is_watching = false;
        self.brakes = false;
        let base = self.position().0;
        if let Some(course) = self.course_mut(false) {
            *course = Course { base, end: base, ..Course::NOWHERE };
        }
        self.threshold = 0;
        self.left = [0; N];
        self.piece = Piece::REST;
        self.moment = u64::from(self.moment()) << 32;
        self.is_next = false;
        self.gate_shut = true;
        self.stops = self.stops.wrapping_add(1);
    }

    /// Whether a stop has not been answered yet.
    #[inline]
    pub fn is_shut(&self) -> bool {
        self.gate_shut || self.unnoted
    }

    /// Whether a segment runs.
    #[inline(always)]
    pub fn is_moving(&self) -> bool {
        self.piece.ticks() != 0
    }

    /// Whether there is nothing left to do.
    #[inline]
    pub fn is_idle(&self) -> bool {
        self.piece.ticks() == 0 && (!self.is_next || self.unnoted)
    }

    /// Segments begun since power-up (wrapping).
    #[inline]
    pub fn segments_begun(&self) -> u32 {
        self.begun
    }

    /// Net steps of each axis since power-up (wrapping), all steps of the ticks so far included.
    pub fn position(&self) -> PerAxis<i32, N> {
        self.course(false).position(&self.left, self.units())
    }

    #[inline(always)]
    fn contact(&self) -> Contact<N> {
        Contact { course: *self.course(false), left: self.left, units: self.units() }
    }
}

/// All that a position follows from, so that no tick has to count and a probe's tick not to compute.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
struct Contact<const N: usize> {
    course: Course<N>,
    left: [u32; N],
    units: u32,
}

impl<const N: usize> Contact<N> {
    const START: Self = Self { course: Course::NOWHERE, left: [0; N], units: 0 };

    fn position(&self) -> PerAxis<i32, N> {
        self.course.position(&self.left, self.units)
    }
}

#[cfg(test)]
mod tests {
    use super::super::UNITS_PER_STEP;
    use super::super::measure::tests::{defined, legs};
    use super::*;
    use proptest::prelude::*;

    fn enter(stepper: &mut Stepper<3>, legs: [Leg; 3], directions: u8, units: u32, ticks: u32, level: u8) {
        stepper.load(ToStep::Block { legs, directions });
        if units != 0 {
            stepper.load(ToStep::Reenter { units });
        }
        let flags = Segment::FLAG_NEW_BLOCK;
        let ticks = ticks as u16;
        stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level, flags }));
        assert_eq!(stepper.tick().steps, 0);
    }

    fn signed(taken: i128, directions: u8, axis: usize) -> i32 {
        signed_add(0, taken as u32, directions >> axis & 1 != 0)
    }

    proptest! {
        /// At every tick of blocks one after the other: one step of an axis at most, what is left in range, the place that
        /// of the definition and of the pulses.
        #[test]
        fn ticks_step_along_true_chords(
            chords in prop::collection::vec((legs(300), 0_u8..8), 1..4), level in 0_u8..=4,
        ) {
            let mut stepper: Stepper<3> = Stepper::new();
            let load = |stepper: &mut Stepper<3>, legs: [Leg; 3], directions| {
                stepper.load(ToStep::Block { legs, directions });
                let ticks = (Measure::of(&legs).total >> (MAX_LEVEL - level)) as u16;
                let flags = Segment::FLAG_NEW_BLOCK | Segment::FLAG_LAST;
                stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level, flags }));
            };
            load(&mut stepper, chords[0].0, chords[0].1);
            prop_assert_eq!(stepper.tick().steps, 0);
            let (mut base, mut counted) = ([0; 3], [0; 3]);
            for (at, (legs, directions)) in chords.iter().enumerate() {
                let total = Measure::of(legs).total;
                let units_per_tick = 1 << (MAX_LEVEL - level);
                for units in (units_per_tick..=total).step_by(units_per_tick as usize) {
                    if let (true, Some((next, directions))) = (units == total, chords.get(at + 1)) {
                        load(&mut stepper, *next, *directions);
                    }
                    let steps = stepper.tick().steps;
                    for axis in 0..3 {
                        prop_assert!(stepper.left[axis] < stepper.threshold);
                        counted[axis] += signed(i128::from(steps >> axis & 1), *directions, axis);
                        let taken = defined(legs[axis], total, units);
                        prop_assert_eq!(counted[axis], base[axis] + signed(taken, *directions, axis));
                    }
                    prop_assert_eq!(stepper.position().0, counted);
                    if units % UNITS_PER_STEP == 0 {
                        prop_assert_eq!(defined(legs[0], total, units), i128::from(units / UNITS_PER_STEP));
                    }
                }
                for (axis, base) in base.iter_mut().enumerate() {
                    *base += signed(i128::from(legs[axis].steps()), *directions, axis);
                }
                prop_assert_eq!(counted, base);
            }
        }

        /// A batch equals its ticks made one by one: the same steps, the same moments, and the same state behind them.
        #[test]
        fn a_batch_equals_its_ticks(
            legs in legs(3000), level in 0_u8..=4, ramp in -300_i32..300, part in prop::collection::vec(0_usize..70, 1..12),
            table in prop::array::uniform8(any::<u32>()), start in any::<u32>(),
        ) {
            let total = Measure::of(&legs).total;
            let ticks = (total >> (MAX_LEVEL - level)).clamp(1, 60_000) as u16;
            let mut single: Stepper<3> = Stepper::new();
            single.load(ToStep::Block { legs, directions: 5 });
            let flags = Segment::FLAG_NEW_BLOCK | Segment::FLAG_LAST;
            single.load(ToStep::Segment(Segment { interval: 1 << 21, ramp, ticks, power: 0, level, flags }));
            single.begin_at(start);
            single.tick();
            let mut batch = single.clone();
            for room in part {
                let (mut words, mut moments) = ([9; 70], [9; 70]);
                let made = batch.plain_ticks(&table, &mut words[..room], &mut moments[..room]);
                prop_assert_eq!(made, room.min(single.piece.plain_ticks as usize));
                for (word, at) in words.into_iter().zip(moments).take(made) {
                    prop_assert_eq!(at, single.moment());
                    let (least, greatest) = single.intervals();
                    let tick = single.tick();
                    prop_assert_eq!(word, table[usize::from(tick.steps)]);
                    prop_assert!((least..=greatest + 1).contains(&tick.interval));
                }
                prop_assert_eq!(format!("{single:?}"), format!("{batch:?}"));
            }
        }

        /// A stop of ticks that were made ahead leaves the position at those that came out.
        #[test]
        fn what_is_undone_is_not_counted(
            chords in prop::collection::vec((legs(60), 0_u8..8), 1..4), done in 0_usize..300, ahead in 0_usize..80,
        ) {
            let mut stepper: Stepper<3> = Stepper::new();
            let mut waiting = chords.iter().peekable();
            let (mut out, mut undone, mut directions) = ([0; 3], [0; 3], 0);
            for at in 0..done + ahead {
                if stepper.wants() && let Some((legs, directions)) = waiting.next() {
                    stepper.load(ToStep::Block { legs: *legs, directions: *directions });
                    let ticks = (Measure::of(legs).total >> MAX_LEVEL).max(1) as u16;
                    let flags = Segment::FLAG_NEW_BLOCK | if waiting.peek().is_none() { Segment::FLAG_LAST } else { 0 };
                    stepper.load(ToStep::Segment(Segment { interval: 1 << 20, ramp: 0, ticks, power: 0, level: 0, flags }));
                }
                let tick = stepper.tick();
                let net = if at < done { &mut out } else { &mut undone };
                for (axis, net) in net.iter_mut().enumerate() {
                    *net += signed(i128::from(tick.steps >> axis & 1), directions, axis);
                }
                directions = tick.directions;
            }
            let StepEvent::Stopped { position, .. } = stepper.stop(undone) else { unreachable!() };
            prop_assert_eq!(position.0, out);
            prop_assert_eq!(stepper.position().0, out);
            // The next block begins there.
            stepper.load(ToStep::Resume { stops: 1 });
            enter(&mut stepper, [Leg::on_steps(5); 3], 0, 0, 5, 0);
            for _ in 0..4 { stepper.tick(); }
            prop_assert_eq!(stepper.position().0, out.map(|place| place + 4));
        }

        /// The position of a block that was not entered at its start is that of the steps before.
        #[test]
        fn the_position_needs_no_division(
            legs in legs(Measure::MOST_STEPS), line in any::<bool>(), way in 0.0..1.0_f64, back in 0_u8..8,
        ) {
            let legs = if line { legs.map(|leg| Leg::on_steps(leg.steps() * 7)) } else { legs };
            let total = Measure::of(&legs).total;
            let units = (f64::from(total) * way) as u32;
            let mut stepper: Stepper<3> = Stepper::new();
            enter(&mut stepper, legs, back, units, 9, 4);
            prop_assert_eq!(stepper.position(), PerAxis([0; 3]));
            stepper.tick();
            for (axis, leg) in legs.into_iter().enumerate() {
                let (before, after) = (defined(leg, total, units), defined(leg, total, units + 1));
                prop_assert_eq!(stepper.position().0[axis], signed(after - before, back, axis));
                let course = stepper.course(false);
                prop_assert_eq!(course.base[axis], -signed(before, back, axis));
                prop_assert_eq!(course.end[axis], signed(i128::from(leg.steps()) - before, back, axis));
            }
        }

        /// A block that is left before its end for another, and entered again.
        #[test]
        fn a_detour_leads_back(legs in legs(300), way in 0.0..1.0_f64, back in 0_u8..8, detour in legs(20)) {
            let total = Measure::of(&legs).total;
            let units = ((f64::from(total) * way) as u32).max(1);
            let there = Measure::of(&detour).total;
            let mut stepper: Stepper<3> = Stepper::new();
            enter(&mut stepper, legs, back, 0, units, 4);
            // Blocks are loaded ahead: each is begun by the last tick of the one before.
            let run_to_end = |stepper: &mut Stepper<3>| while stepper.piece.ticks() > 1 { stepper.tick(); };
            run_to_end(&mut stepper);
            stepper.load(ToStep::Block { legs: detour, directions: 0 });
            let flags = Segment::FLAG_NEW_BLOCK;
            let segment = |units: u32| Segment { interval: 1 << 20, ramp: 0, ticks: units as u16, power: 0, level: 4, flags };
            stepper.load(ToStep::Segment(segment(there)));
            stepper.tick();
            let left: [i32; 3] = std::array::from_fn(|axis| signed(defined(legs[axis], total, units), back, axis));
            prop_assert_eq!(stepper.position().0, left);
            run_to_end(&mut stepper);
            stepper.load(ToStep::Block { legs, directions: back });
            stepper.load(ToStep::Reenter { units });
            stepper.load(ToStep::Segment(segment((total - units).max(1))));
            stepper.tick();
            run_to_end(&mut stepper);
            stepper.tick();
            for axis in 0..3 {
                let whole = signed(i128::from(legs[axis].steps()), back, axis) + detour[axis].steps() as i32;
                prop_assert_eq!(stepper.position().0[axis], whole);
            }
        }
    }
}
